"""Master segments that follow the displacement of the cut elements they lie in.

Along a straight line through a cell the bilinear shape functions are linear only where the line follows an
edge; along the diagonal of a square they miss the chord between its ends by a quarter. A master surface of
whole segments, straight between their displaced ends, would then push other nodes than the slave points beside
it, which take the shape functions at their own place: the total force errs by several per cent on steep
interfaces, and the pressure is rough. Segments are therefore divided until the chord is near enough; each piece
is a master segment like any other, so that the contact law stays the gradient of an energy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.bilinear import shape, to_local
from phantomnode.geometry.doubling import CutMesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CHORD = 5e-4
"""How far shape functions may be from the chord of a piece: a twentieth of a per cent of a nodal force."""

MOST_PIECES = 8
"""Pieces of a segment at most: across the whole diagonal of a cell shape functions are then within 0.4 %."""


@dataclass(frozen=True)
class Traces:
    """The pieces of some boundary segments, one segment behind the other.

    Attributes
    ----------
    segment : (m,) int64
        The segment of each piece, counted among those that were given.
    part : (m, 2) float64
        Where each piece begins and ends on its segment, 0 to 1.
    start, end : (m, 4) float64
        Shape functions at its ends.
    following : (m,) int64
        The piece that follows, -1 at a free end.
    """

    segment: Ints
    part: Floats
    start: Floats
    end: Floats
    following: Ints


def traces(mesh: CutMesh, chosen: Ints, following: Ints) -> Traces:
    """Divide boundary segments where shape functions are not linear along them.

    Parameters
    ----------
    mesh : CutMesh
    chosen : (s,) int64
        Numbers in ``mesh.segments``.
    following : (s,) int64
        The one of them that follows each, counted among the chosen ones; -1 at a free end.
    """
    segments = mesh.segments
    corners = mesh.xy[mesh.elements[segments.element[chosen]]]
    ends = shape(segments.local[chosen].reshape(-1, 2)).reshape(-1, 2, 4)
    middle = shape(to_local(corners, segments.ends[chosen].mean(axis=1)))
    bend = np.abs(middle - ends.mean(axis=1)).max(axis=1)
    count = np.clip(np.ceil(np.sqrt(bend / CHORD)), 1, MOST_PIECES).astype(np.int64)

    first = np.concatenate([[0], np.cumsum(count)])
    segment = np.repeat(np.arange(len(chosen)), count)
    number = np.arange(first[-1]) - first[segment]
    part = np.stack([number, number + 1], axis=1) / count[segment, None]
    a, b = np.moveaxis(segments.ends[chosen][segment], 1, 0)
    at = [shape(to_local(corners[segment], (1.0 - t) * a + t * b)) for t in part.T[:, :, None]]
    opens, closes = number == 0, number == count[segment] - 1
    at[0][opens], at[1][closes] = ends[:, 0], ends[:, 1]  # to the bit, as the neighbours have them
    inner = np.arange(1, first[-1] + 1)
    outer = np.where(following >= 0, first[following], -1)
    return Traces(segment, part, at[0], at[1], np.where(closes, outer[segment], inner))
