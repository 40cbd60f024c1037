"""Corners of a master between the points of the slave: found where they are sharp, told how deep they stand."""

from __future__ import annotations

import numpy as np
import pytest
from test_pairs import body, prepared_of

from phantomnode.pipeline.corners import deepest_corner, master_corners
from phantomnode.pipeline.gaps import initial_gaps
from phantomnode.pipeline.summary import run_checks
from phantomnode.pipeline.tally import Tally

WEDGE = {"polyline": {"points": [[1.0, -0.6], [0.13, -0.02], [-1.0, -0.5]]}}


def over(obstacle, **more):
    """A square of 0.8 m, its lower side at y = 0, above an obstacle with the material on its left."""
    block = body({"rectangle": {"low": [-0.4, 0.0], "high": [0.4, 0.8]}}, 0.1, aligned=True)
    return prepared_of(
        body={"block": block},
        rigid={"below": {"geometry": obstacle, **more}},
        contact={"landing": {"slave": "block.bottom", "master": "below"}},
    )


def moved(prepared, dx, dy):
    u = np.zeros_like(prepared.model.x)
    u[prepared.bodies[0].nodes] = (dx, dy)
    return u


@pytest.mark.parametrize(
    ("dx", "dy", "deep"),
    [
        (0.0, 0.0, 0.0),  # 0.02 above it
        (0.0, -0.05, 0.03),
        (0.013, -0.08, 0.06),  # between other points
        (0.6, -0.05, 0.0),  # beside the side that feels it
        (0.0, -0.3, 0.0),  # deeper than contact reaches: on the other side of the body, or through it
    ],
)
def test_a_wedge_is_seen_between_the_points_of_the_slave(dx, dy, deep):
    prepared = over(WEDGE)
    corners = master_corners(prepared, 0)
    assert len(corners.nodes) == 1
    found = deepest_corner(corners, prepared.model.x, moved(prepared, dx, dy))
    assert found == pytest.approx(deep, abs=1e-12)


@pytest.mark.parametrize(
    ("obstacle", "count"),
    [
        ({"circle": {"centre": [0.0, -0.5], "radius": 0.45}}, 0),  # flattened to chords
        ({"polyline": {"points": [[1.0, -0.1], [0.0, -0.2], [-1.0, -0.1]]}}, 0),  # a valley
        ({"polyline": {"points": [[1.0, -0.1], [0.0, -0.05], [-1.0, -0.1]]}}, 0),  # blunt
        (WEDGE, 1),
    ],
)
def test_only_sharp_corners_that_stick_out_count(obstacle, count):
    assert len(master_corners(over(obstacle), 0).nodes) == count


def test_the_summary_counts_corners(frame_of):
    prepared = over(WEDGE)
    tally = Tally(prepared)
    points = len(prepared.model.contact.slave_weight)
    for step, down in enumerate((0.0, -0.05, -0.03)):
        tally.frame(
            frame_of(
                step,
                u=moved(prepared, 0.0, down),
                v=0.0 * prepared.model.x,
                gap=np.full(points, -1.0),
                reaction=np.zeros(prepared.model.channels),
            )  # fmt: skip
        )
    assert tally.penetration[0] == pytest.approx(0.03, abs=1e-12)
    check = next(c for c in run_checks(prepared, tally) if c.name == "penetration over cell size")
    assert check.value == pytest.approx(0.3, abs=1e-11) and not check.passed and "count = 4" in check.advice
    assert initial_gaps(prepared)[0].distance == pytest.approx(0.02, abs=1e-12)  # from the corner to the side


def test_self_contact_has_no_corners_of_another():
    square = body({"rectangle": {"low": [0.0, 0.0], "high": [1.0, 1.0]}}, 0.1, aligned=True)
    prepared = prepared_of(body={"a": square}, contact={"own": {"slave": "a.outer", "master": "a.outer"}})
    assert len(master_corners(prepared, 0).nodes) == 0
