"""The rim of cells, and segments in order along surfaces."""

from __future__ import annotations

import numpy as np

from phantomnode.pipeline.outlines import chains, open_edges


def directed(points):
    points = np.array(points, dtype=float)
    return np.stack([points[:-1], points[1:]], axis=1)


def test_the_rim_of_a_quadrilateral_and_a_triangle_leaves_out_what_they_share():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [2.0, 0.0]])
    rim = open_edges([np.array([[0, 1, 2, 3]]), np.array([[1, 4, 2]])], points)
    assert {tuple(sorted(edge)) for edge in rim.tolist()} == {(0, 1), (2, 3), (0, 3), (1, 4), (2, 4)}


def test_of_an_edge_beside_a_shorter_one_what_is_left_is_open():
    """An outline that leaves a grid line at a re-entrant corner: a triangle beside a part of a whole cell's edge."""
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [2.0, 0.0], [1.0, 0.5], [2.0, 1.0]])
    cell = np.array([[0, 1, 2, 3]])
    for triangles, left in (
        ([[1, 4, 5]], {(5, 2)}),
        ([[2, 5, 6]], {(1, 5)}),
        ([[1, 4, 5], [2, 5, 6]], set()),
    ):
        rim = {tuple(edge) for edge in open_edges([cell, np.array(triangles)], points).tolist()}
        assert left == rim & {(1, 2), (1, 5), (5, 1), (2, 5), (5, 2)} and len(rim - left) == 3 + 2 * len(
            triangles
        )


def test_shuffled_segments_of_a_circle_make_one_closed_chain():
    angle = np.linspace(0.0, 2.0 * np.pi, 41)
    ends = directed(np.column_stack([np.cos(angle), np.sin(angle)]))
    mixed = np.random.default_rng(5).permutation(40)
    (chain,) = chains(ends[mixed].astype(np.float32).astype(float))
    assert chain.closed
    assert np.all(np.diff(mixed[chain.order]) % 40 == 1)


def test_two_open_pieces_come_longest_first():
    ends = np.concatenate([directed([(5, 0), (6, 0)]), directed([(0, 0), (1, 0), (2, 0)])[::-1]])
    long, short = chains(ends)
    assert (long.order.tolist(), long.closed) == ([2, 1], False)
    assert (short.order.tolist(), short.closed) == ([0], False)


def test_the_faces_of_a_crack_on_one_place_stay_apart():
    line = [(0.0, 0.0), (1.0, 0.1), (2.0, 0.0), (3.0, 0.2)]
    found = chains(np.concatenate([directed(line), directed(line[::-1])]))
    # Around the tip the chain may go on with the other face, but never between two segments of a face.
    assert sorted(found[0].order.tolist()) == [0, 1, 2, 3, 4, 5]
    assert np.count_nonzero(np.diff(found[0].order) != 1) <= 1


def test_no_segments_make_no_chain():
    assert chains(np.zeros((0, 2, 2))) == []
