"""The plane arrangement of noded segments: half-edges, the order around each vertex, faces.

Half-edge 2k runs along segment k, half-edge 2k + 1 against it (its twin). The face of a half-edge is on its
left. After noding this is pure topology: nothing here compares floats that could disagree.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from phantomnode.geometry.noding import Pieces, cross

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Arrangement:
    """Segments (each once) and their half-edges.

    Attributes
    ----------
    vertices : (v, 2) int64
        Lattice points.
    ends : (s, 2) int64
        Vertices of each segment, lower number first.
    piece_segment : (k,) int64
        The segment of each noded piece.
    piece_forward : (k,) bool
        Whether the piece runs along its segment (from the lower vertex number).
    """

    vertices: Ints
    ends: Ints
    piece_segment: Ints
    piece_forward: NDArray[np.bool_]

    @classmethod
    def of(cls, pieces: Pieces) -> Arrangement:
        """Unite coinciding pieces into segments."""
        forward = pieces.ends[:, 0] < pieces.ends[:, 1]
        count = max(len(pieces.vertices), 1)
        code, segment = np.unique(
            pieces.ends.min(axis=1) * count + pieces.ends.max(axis=1), return_inverse=True
        )
        return cls(pieces.vertices, np.column_stack(np.divmod(code, count)), segment, forward)

    @property
    def half_edges(self) -> int:
        """Number of half-edges, two a segment."""
        return 2 * len(self.ends)

    @cached_property
    def origin(self) -> Ints:
        """(h,) The vertex at which each half-edge starts."""
        return np.ascontiguousarray(self.ends.reshape(-1))

    @cached_property
    def next(self) -> Ints:
        """(h,) The half-edge that follows along the face on the left: the first one clockwise from the twin."""
        direction = self.vertices[self.origin[self._twin]] - self.vertices[self.origin]
        angle = np.arctan2(direction[:, 1], direction[:, 0])
        order = np.lexsort([angle, self.origin])
        rank = np.empty_like(order)
        rank[order] = np.arange(len(order))
        degree = np.bincount(self.origin, minlength=len(self.vertices))
        first = np.cumsum(degree) - degree
        v = self.origin[self._twin]
        clockwise = first[v] + (rank[self._twin] - first[v] - 1) % degree[v]
        return np.asarray(order[clockwise])

    @cached_property
    def _twin(self) -> Ints:
        return np.arange(self.half_edges) ^ 1

    @cached_property
    def cycles(self) -> list[list[int]]:
        """The half-edges around each face, in order; numbered as in :attr:`face`."""
        following = self.next.tolist()
        seen = bytearray(self.half_edges)
        cycles = []
        for start in range(self.half_edges):
            if seen[start]:
                continue
            cycle, h = [], start
            while not seen[h]:
                seen[h] = 1
                cycle.append(h)
                h = following[h]
            cycles.append(cycle)
        return cycles

    @cached_property
    def face(self) -> Ints:
        """(h,) The face on the left of each half-edge."""
        face = np.empty(self.half_edges, dtype=np.int64)
        lengths = [len(cycle) for cycle in self.cycles]
        order = np.fromiter(chain.from_iterable(self.cycles), np.int64, self.half_edges)
        face[order] = np.repeat(np.arange(len(lengths)), lengths)
        return face

    @cached_property
    def doubled_areas(self) -> Ints:
        """(f,) Twice the area of each face in square lattice units: exact for every face within one cell."""
        anchor = np.array([self.origin[cycle[0]] for cycle in self.cycles])
        base = self.vertices[anchor[self.face]]
        a = self.vertices[self.origin] - base
        b = self.vertices[self.origin[self._twin]] - base
        total = np.zeros(len(self.cycles), dtype=np.int64)
        np.add.at(total, self.face, cross(a, b))
        return total


def components(count: int, first: Ints, second: Ints) -> tuple[int, Ints]:
    """Connected components of ``count`` things joined in pairs: their number, and the one of each thing."""
    graph = coo_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(count, count))
    number, label = connected_components(graph, directed=False)
    return int(number), label.astype(np.int64)
