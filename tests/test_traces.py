"""Master segments divided until they follow the shape functions of their cells."""

from __future__ import annotations

import numpy as np
import pytest
from physics import cartesian, prepared_case, rectangle

from phantomnode.geometry.bilinear import shape, to_local
from phantomnode.pipeline.contact_tables import SlavePoints
from phantomnode.pipeline.pairing import point_rule
from phantomnode.pipeline.surfaces import closed_surface
from phantomnode.pipeline.traces import CHORD, MOST_PIECES, balanced, mean_shape, traces

GAUSS = point_rule(SlavePoints(rule="gauss", count=2))


def pieces_of(mesh, chosen, following, rule=GAUSS):
    return traces(mesh, chosen, following, *rule)


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
        pieces = pieces_of(mesh, chosen, following)
        np.testing.assert_array_equal(pieces.segment, np.arange(len(chosen)))
        np.testing.assert_array_equal(pieces.following, following)
        np.testing.assert_array_equal(pieces.part, np.tile([0.0, 1.0], (len(chosen), 1)))


@pytest.mark.parametrize("relocation", [0.0, 0.1])
def test_pieces_follow_the_shape_functions(relocation):
    """Halfway along each piece the shape functions are within CHORD of the mean of its ends.

    1.1: in a distorted cell they are not quite quadratic along the line; where few pieces have inner ends, those are
    moved by up to twice the miss of a chord.
    """
    mesh, chosen, following = block([-0.1, 0.42], [1.1, 0.50], relocation=relocation)
    pieces = pieces_of(mesh, chosen, following)
    count = np.bincount(pieces.segment)[pieces.segment]
    assert len(pieces.segment) > len(chosen) and np.any((1 < count) & (count < MOST_PIECES))
    ends = mesh.segments.ends[chosen][pieces.segment]
    middle = pieces.part.mean(axis=1)[:, None]
    corners = mesh.xy[mesh.elements[mesh.segments.element[chosen]]][pieces.segment]
    exact = shape(to_local(corners, (1.0 - middle) * ends[:, 0] + middle * ends[:, 1]))
    off = np.abs(exact - 0.5 * (pieces.start + pieces.end)).max(axis=1)
    assert off[count < MOST_PIECES].max() < 1.1 * CHORD and off.max() < 4e-3


def by_rule(pieces, count, rule):
    """(s, 4) Sum over slave points of the shape functions on the pieces of each segment."""
    total = np.zeros((count, 4))
    for place, weight in zip(*rule, strict=True):
        low, high = pieces.part.T
        here = (low <= place) & ((place < high) | (high == 1.0))
        t = ((place - low) / (high - low))[here, None]
        total[pieces.segment[here]] += weight * ((1.0 - t) * pieces.start[here] + t * pieces.end[here])
    return total


@pytest.mark.parametrize("rule", [("gauss", 2), ("gauss", 3), ("gauss", 4), ("newton-cotes", 3)], ids=str)
@pytest.mark.parametrize("relocation", [0.0, 0.1])
def test_points_on_both_sides_have_the_mean_of_the_shape_functions(rule, relocation):
    """A constant pressure then pushes each node with its part; linear fields are what they were.

    1e-12: of 1. Inner ends stay where they are to the lattice, and shape functions in 0..1.
    """
    rule = point_rule(SlavePoints(rule=rule[0], count=rule[1]))
    mesh, chosen, following = block([-0.1, 0.13], [1.1, 0.86], relocation=relocation)
    pieces = pieces_of(mesh, chosen, following, rule)
    corners, ends = mesh.xy[mesh.elements[mesh.segments.element[chosen]]], mesh.segments.ends[chosen]
    mean = mean_shape(corners, ends)
    bent = np.bincount(pieces.segment) > 1
    np.testing.assert_allclose(by_rule(pieces, len(chosen), rule)[bent], mean[bent], rtol=0, atol=1e-12)
    places = ends[:, :1] + rule[0][:, None] * (ends[:, 1:] - ends[:, :1])
    each = np.repeat(corners, len(rule[0]), axis=0)
    plain = shape(to_local(each, places.reshape(-1, 2))).reshape(-1, len(rule[0]), 4)
    moved = balanced(plain, corners, ends, *rule)
    cubic = (
        abs(rule[1] @ rule[0] ** 4 - 0.2) > 1e-3
    )  # rules of a higher degree are right to 1e-9 in crooked cells
    crooked = cubic and relocation > 0.0
    assert np.array_equal(moved, plain) != crooked
    np.testing.assert_allclose(np.einsum("g,sgi->si", rule[1], moved), mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(np.einsum("sgi,sia->sga", moved, corners), places, rtol=0, atol=1e-12)
    at = np.einsum("pi,pia->pa", pieces.start, corners[pieces.segment])
    along = ends[pieces.segment, 0] + pieces.part[:, :1] * (ends[pieces.segment, 1] - ends[pieces.segment, 0])
    np.testing.assert_allclose(at, along, rtol=0, atol=1e-7)
    for shapes in (pieces.start, pieces.end, moved):
        np.testing.assert_allclose(shapes.sum(axis=-1), 1.0, rtol=0, atol=1e-12)
        assert shapes.min() > -1e-6 and shapes.max() < 1.0 + 1e-6


def test_a_rule_of_one_point_moves_nothing():
    """It does not sum quadratic shape functions in any cell; nothing hides that."""
    rule = point_rule(SlavePoints(rule="gauss", count=1))
    mesh, chosen, following = block([-0.1, 0.3], [1.1, 0.8])
    pieces = pieces_of(mesh, chosen, following, rule)
    ends = mesh.segments.ends[chosen][pieces.segment]
    corners = mesh.xy[mesh.elements[mesh.segments.element[chosen]]][pieces.segment]
    exact = shape(
        to_local(corners, (1.0 - pieces.part[:, :1]) * ends[:, 0] + pieces.part[:, :1] * ends[:, 1])
    )
    np.testing.assert_allclose(pieces.start, exact, atol=1e-6)  # the lattice


def test_the_diagonal_of_a_cell_is_divided_most():
    """There the middle has a quarter of each node, the chord a half of two; eighths are within 0.4 %."""
    mesh, chosen, following = block([-0.1, -0.1], [1.1, 1.1])
    pieces = pieces_of(mesh, chosen, following)
    assert np.bincount(pieces.segment).max() == MOST_PIECES
    inside = pieces.part[:, 0] == 0.5
    # In between the points the chords miss the mean of 0.004; the middle is moved by 0.86 times that.
    np.testing.assert_allclose(pieces.start[inside], 0.25, atol=4e-3)


def test_pieces_are_one_closed_chain_that_joins_to_the_bit():
    mesh, chosen, following = block([-0.1, 0.3], [1.1, 0.8])
    pieces = pieces_of(mesh, chosen, following)
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
    pieces = pieces_of(mesh, chosen[:2], np.array([1, -1]))
    assert pieces.following[-1] == -1 and np.count_nonzero(pieces.following < 0) == 1
