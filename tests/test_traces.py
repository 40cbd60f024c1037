"""Master segments divided until they follow the shape functions of their cells."""

from __future__ import annotations

import numpy as np
import pytest
from physics import cartesian, prepared_case, rectangle

from phantomnode.geometry.bilinear import shape, to_local
from phantomnode.pipeline.surfaces import closed_surface
from phantomnode.pipeline.traces import CHORD, MOST_PIECES, traces


def block(*points, cell=0.25, relocation=0.0):
    """A unit block that a polyline splits; the chosen segments are those of its lower half."""
    case = prepared_case(
        {"block": rectangle((0.0, 0.0), (1.0, 1.0), cartesian(cell))},
        1e-3,
        interface={"line": {"body": "block", "geometry": {"polyline": {"points": points}}}},
        relocation={"distance": relocation},
    )
    mesh = case.bodies[0].mesh
    below = np.flatnonzero(mesh.segments.side == -1)
    chosen = closed_surface(mesh.segments, below, np.zeros(0, dtype=int))
    number = np.full(len(mesh.segments.ends) + 1, -1)
    number[chosen] = np.arange(len(chosen))
    return mesh, chosen, number[mesh.segments.following[chosen]]


def test_segments_along_grid_lines_stay_whole():
    """Shape functions are linear along an edge, and across a rectangle parallel to one."""
    for y in (0.5, 0.6):
        mesh, chosen, following = block([-0.1, y], [1.1, y])
        pieces = traces(mesh, chosen, following)
        np.testing.assert_array_equal(pieces.segment, np.arange(len(chosen)))
        np.testing.assert_array_equal(pieces.following, following)
        np.testing.assert_array_equal(pieces.part, np.tile([0.0, 1.0], (len(chosen), 1)))


@pytest.mark.parametrize("relocation", [0.0, 0.1])
def test_pieces_follow_the_shape_functions(relocation):
    """Halfway along each piece the shape functions are within CHORD of the mean of its ends."""
    mesh, chosen, following = block([-0.1, 0.42], [1.1, 0.50], relocation=relocation)
    pieces = traces(mesh, chosen, following)
    count = np.bincount(pieces.segment)[pieces.segment]
    assert len(pieces.segment) > len(chosen) and np.any((1 < count) & (count < MOST_PIECES))
    ends = mesh.segments.ends[chosen][pieces.segment]
    middle = pieces.part.mean(axis=1)[:, None]
    corners = mesh.xy[mesh.elements[mesh.segments.element[chosen]]][pieces.segment]
    exact = shape(to_local(corners, (1.0 - middle) * ends[:, 0] + middle * ends[:, 1]))
    off = np.abs(exact - 0.5 * (pieces.start + pieces.end)).max(axis=1)
    # 1.1: in a distorted cell the shape functions are not quite quadratic along the line.
    assert off[count < MOST_PIECES].max() < 1.1 * CHORD and off.max() < 4e-3


def test_the_diagonal_of_a_cell_is_divided_most():
    """There the middle has a quarter of each node, the chord a half of two; eighths are within 0.4 %."""
    mesh, chosen, following = block([-0.1, -0.1], [1.1, 1.1])
    pieces = traces(mesh, chosen, following)
    assert np.bincount(pieces.segment).max() == MOST_PIECES
    inside = pieces.part[:, 0] == 0.5
    np.testing.assert_allclose(pieces.start[inside], 0.25, atol=1e-6)  # the lattice


def test_pieces_are_one_closed_chain_that_joins_to_the_bit():
    mesh, chosen, following = block([-0.1, 0.3], [1.1, 0.8])
    pieces = traces(mesh, chosen, following)
    s, seen = 0, []
    while s not in seen:
        seen.append(s)
        s = int(pieces.following[s])
    assert s == 0 and sorted(seen) == list(range(len(pieces.segment)))
    same = pieces.segment[pieces.following] == pieces.segment
    np.testing.assert_array_equal(pieces.end[same], pieces.start[pieces.following][same])
    whole = shape(mesh.segments.local[chosen].reshape(-1, 2)).reshape(-1, 2, 4)
    np.testing.assert_array_equal(pieces.start[pieces.part[:, 0] == 0.0], whole[:, 0])
    np.testing.assert_array_equal(pieces.end[pieces.part[:, 1] == 1.0], whole[:, 1])


def test_an_open_surface_ends_with_its_last_piece():
    mesh, chosen, _ = block([-0.1, 0.3], [1.1, 0.8])
    pieces = traces(mesh, chosen[:2], np.array([1, -1]))
    assert pieces.following[-1] == -1 and np.count_nonzero(pieces.following < 0) == 1
