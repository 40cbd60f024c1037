"""Very many cells in a picture: as pixels, at the resolution at which it is drawn.

A polygon costs matplotlib a kilobyte and some 20 microseconds; a million of them are no longer told apart by the
eye. Here each pixel takes the colour of the cell at its centre, in numbers alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.artist import allow_rasterization
from matplotlib.backend_bases import RendererBase
from matplotlib.collections import Collection
from matplotlib.transforms import Bbox, Transform
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CELLS, SAMPLES = 1 << 16, 1 << 21
"""Cells, and places in them, that are looked at together: what is needed in between stays small."""

FEW = 8
"""Above this number of pixels across, cells are taken as if they were as large as the next power of two."""


class PaintedCells(Collection):
    """Quadrilaterals or triangles, (m, k, 2), painted without edges; else as matplotlib's ``PolyCollection``."""

    def __init__(self, polygons: Floats, **style: Any) -> None:
        super().__init__(**style)
        self._polygons = polygons

    def set_verts(self, polygons: Floats) -> None:
        """Other places of the same cells."""
        self._polygons = np.asarray(polygons)
        self.stale = True

    def get_datalim(self, transData: Transform) -> Bbox:
        """The box of all cells."""
        points = self._polygons.reshape(-1, 2)
        return Bbox.null() if len(points) == 0 else Bbox([points.min(axis=0), points.max(axis=0)])

    @allow_rasterization  # type: ignore[untyped-decorator]
    def draw(self, renderer: RendererBase) -> None:
        """Paint the pixels of the axes."""
        if not self.get_visible() or len(self._polygons) == 0:
            return
        self.update_scalarmappable()
        colours = np.round(255.0 * np.asarray(self.get_facecolor())).astype(np.uint8)
        assert self.axes is not None  # an artist is drawn by its axes
        frame = self.axes.bbox
        low = np.floor(frame.min)
        width, height = (np.ceil(frame.max) - low).astype(np.int64)
        place: Any = self.get_transform()
        cell = np.full((height, width), -1, dtype=np.int64)
        for start in range(0, len(self._polygons), CELLS):
            some = self._polygons[start : start + CELLS]
            paint(place.transform(some.reshape(-1, 2)).reshape(some.shape) - low, start, cell)
        image = np.zeros((height, width, 4), dtype=np.uint8)
        painted = cell >= 0
        image[painted] = colours[cell[painted]] if len(colours) > 1 else colours[0]
        context = renderer.new_gc()
        context.set_clip_rectangle(frame)
        renderer.draw_image(context, float(low[0]), float(low[1]), image)
        context.restore()


def paint(corners: Floats, first: int, cell: Ints) -> None:
    """Write the numbers of cells into the pixels that they cover.

    Parameters
    ----------
    corners : (m, k, 2) float64
        Of convex quadrilaterals or triangles, in pixels: x to the right, y up.
    first : int
        The number of the first of them.
    cell : (height, width) int64
        Written to; row 0 is the lowest. Of cells that share a pixel the last one has it.
    """
    height, width = cell.shape
    low, high = corners.min(axis=1), corners.max(axis=1)
    seen = np.flatnonzero(np.all((high >= 0.0) & (low < (width, height)), axis=1))
    longest = np.max(
        np.hypot(*np.moveaxis(np.roll(corners[seen], -1, axis=1) - corners[seen], -1, 0)), axis=1
    )
    # Places no more than a pixel apart; few different numbers of them, so that cells are done many at once.
    across = np.maximum(np.ceil(longest), 1.0)
    across = np.where(across > FEW, 2.0 ** np.ceil(np.log2(across)), across).astype(np.int64)
    for count in np.unique(across):
        weights = _places(int(count), corners.shape[1])
        for some in _parts(seen[across == count], len(weights)):
            pixel = np.floor(np.einsum("pk,mki->mpi", weights, corners[some])).astype(np.int64)
            inside = np.all((pixel >= 0) & (pixel < (width, height)), axis=-1)
            owner = np.broadcast_to(first + some[:, None], inside.shape)
            cell[pixel[inside][:, 1], pixel[inside][:, 0]] = owner[inside]


def _parts(cells: Ints, places: int) -> Iterator[Ints]:
    """The cells in parts of no more than ``SAMPLES`` places, or one by one."""
    step = max(1, SAMPLES // places)
    return (cells[start : start + step] for start in range(0, len(cells), step))


def _places(count: int, corners: int) -> Floats:
    """(p, corners) Weights of the corners at count x count places of a quadrilateral, half of them of a triangle."""
    s, t = (a.ravel() for a in np.meshgrid(*(np.linspace(0.0, 1.0, count + 1),) * 2))
    if corners == 4:
        return np.stack([(1.0 - s) * (1.0 - t), s * (1.0 - t), s * t, (1.0 - s) * t], axis=1)
    s, t = s[s + t <= 1.0 + 1e-12], t[s + t <= 1.0 + 1e-12]
    return np.stack([1.0 - s - t, s, t], axis=1)
