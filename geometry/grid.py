"""Background grids: quadrilateral cells that need not fit any geometry."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class BackgroundGrid:
    """Quadrilateral cells.

    Attributes
    ----------
    xy : (n, 2) float64, metres
        Node positions.
    quads : (m, 4) int64
        Nodes of each cell, counter-clockwise.
    shape : (int, int) or None
        Cells in the first and the second direction where the grid is structured (cell number =
        j * shape[0] + i); None where it is not.
    """

    xy: Floats
    quads: Ints
    shape: tuple[int, int] | None = None

    @cached_property
    def edges(self) -> Ints:
        """(e, 2) Every cell edge once, lower node number first, sorted."""
        ends = np.stack([self.quads, np.roll(self.quads, -1, axis=1)], axis=-1).reshape(-1, 2)
        return np.unique(np.sort(ends, axis=1), axis=0)

    @cached_property
    def areas(self) -> Floats:
        """(m,) Area of each cell, m^2."""
        d1 = self.xy[self.quads[:, 2]] - self.xy[self.quads[:, 0]]
        d2 = self.xy[self.quads[:, 3]] - self.xy[self.quads[:, 1]]
        return np.asarray(0.5 * (d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]))

    @cached_property
    def node_size(self) -> Floats:
        """(n,) Length of the shortest cell edge at each node, metres: the local h."""
        length = np.hypot(*(self.xy[self.edges[:, 1]] - self.xy[self.edges[:, 0]]).T)
        size = np.full(len(self.xy), np.inf)
        for end in (0, 1):
            np.minimum.at(size, self.edges[:, end], length)
        return size

    @cached_property
    def cell_size(self) -> float:
        """Length of the longest cell edge, metres."""
        return float(np.max(np.hypot(*(self.xy[self.edges[:, 1]] - self.xy[self.edges[:, 0]]).T)))
