"""A case becomes a model: surfaces and their names, held nodes, overlaps, shared grids, prescribed motions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from phantomnode.pipeline.case import case_from_table
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.motion import Channel
from phantomnode.pipeline.prepare import Prepared, prepare

RHO = 1000.0


def prepared(bodies: dict[str, Any], **tables: Any) -> Prepared:
    table = {
        "time": {"end": 1e-2},
        "material": {"soft": {"E": 1e9, "nu": 0.3, "rho": RHO}},
        "body": {name: {"material": "soft", **body} for name, body in bodies.items()},
        **tables,
    }
    return prepare(case_from_table(table))


def block(low: tuple[float, float], high: tuple[float, float], **grid: Any) -> dict[str, Any]:
    """A rectangle on a grid that is aligned unless another is given."""
    aligned = {"kind": "cartesian", "cell": 0.25, "aligned": True}
    return {"geometry": {"rectangle": {"low": low, "high": high}}, "grid": aligned | grid}


SPLIT = {"mid": {"body": "block", "geometry": {"polyline": {"points": [[-1.0, 0.6], [2.0, 0.6]]}}}}
UPPER, LOWER = block((0.0, 1.0), (1.0, 2.0)), block((-0.5, 0.0), (1.5, 1.0))


def contact(slave: str, master: str, **more: Any) -> dict[str, Any]:
    return {"pair": {"slave": slave, "master": master, "penalty": {"value": 1e10}, **more}}


def segments_of(case: Prepared) -> tuple[np.ndarray, np.ndarray]:
    """Start and end of every master segment in the model, (s, 2) each."""
    c = case.model.contact
    x = case.model.x[c.master_nodes]
    return np.einsum("si,sia->sa", c.start_shape, x), np.einsum("si,sia->sa", c.end_shape, x)


def points_of(case: Prepared) -> np.ndarray:
    c = case.model.contact
    return np.einsum("gi,gia->ga", c.slave_shape, case.model.x[c.slave_nodes])


# --- names -----------------------------------------------------------------------------------------------


def test_a_side_is_the_slave_and_the_whole_outline_the_master() -> None:
    """The slave is the named side alone; the master closes around its body, or points fall off its end."""
    pair = contact("upper.bottom", "lower.top", corners=False)
    case = prepared({"upper": UPPER, "lower": LOWER}, contact=pair)
    points, c = points_of(case), case.model.contact
    assert np.allclose(points[:, 1], 1.0, atol=1e-6) and len(points) == 2 * 4  # two Gauss points an edge
    assert c.slave_weight.sum() == pytest.approx(1.0)
    start, end = segments_of(case)
    assert np.hypot(*(end - start).T).sum() == pytest.approx(6.0)  # 2 x 1 block
    assert sorted(c.following) == list(range(len(start)))
    assert np.array_equal(c.following[c.previous], np.arange(len(start)))
    assert np.allclose(start[c.following], end, atol=1e-12)


def test_both_faces_of_an_interface() -> None:
    """A cut right across makes two loops; the master closes around its own half."""
    case = prepared(
        {"block": block((0, 0), (1, 1))}, interface=SPLIT, contact=contact("mid.plus", "mid.minus")
    )
    assert np.allclose(points_of(case)[:, 1], 0.6, atol=1e-6)
    start, end = segments_of(case)
    assert start[:, 1].max() == pytest.approx(0.6, abs=1e-6)  # minus: the right of the curve, below
    assert np.hypot(*(end - start).T).sum() == pytest.approx(2.0 + 2 * 0.6, rel=1e-6)
    slave = case.model.contact.slave_nodes
    assert not set(slave.ravel()) & set(case.model.contact.master_nodes.ravel())


def test_the_master_of_a_crack_is_its_named_face_alone() -> None:
    """Both faces of a crack are on one loop with each other: the slave must not be its own master."""
    crack = {"mid": {"body": "block", "geometry": {"polyline": {"points": [[-1.0, 0.6], [0.6, 0.6]]}}}}
    case = prepared(
        {"block": block((0, 0), (1, 1))}, interface=crack, contact=contact("mid.plus", "mid.minus")
    )
    start, end = segments_of(case)
    assert np.allclose([start[:, 1], end[:, 1]], 0.6, atol=1e-6)
    assert np.count_nonzero(case.model.contact.following < 0) == 1


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("lower.topp", 'did you mean "lower.top"'),
        ("lower.inner", "the parts of lower are: boundary, outer, bottom, right, top, left"),
    ],
)
def test_an_unknown_part_is_refused_with_those_that_exist(place: str, message: str) -> None:
    with pytest.raises(CaseError, match=message):
        prepared({"upper": UPPER, "lower": LOWER}, contact=contact("upper.bottom", place))


def test_an_interface_of_which_nothing_is_left_is_refused() -> None:
    small = {"mid": {"body": "block", "geometry": {"polyline": {"points": [[0.55, 0.6], [0.65, 0.6]]}}}}
    with pytest.raises(CaseError, match="nothing is left"):
        prepared({"block": block((0, 0), (1, 1))}, interface=small, contact=contact("mid.plus", "mid.minus"))


# --- boundaries ------------------------------------------------------------------------------------------


def test_a_held_side_holds_real_and_phantom_nodes_alike() -> None:
    """The cut at y = 0.6 doubles the nodes at (0, 0.5) and (0, 0.75): four nodes there, all held."""
    held = {"wall": {"on": "block.left", "displacement": {"x": 0.0}}}
    case = prepared({"block": block((0, 0), (1, 1))}, interface=SPLIT, boundary=held)
    nodes = case.boundaries[0].nodes
    assert np.array_equal(np.flatnonzero(case.model.channel[:, 0] >= 0), nodes)
    assert np.all(case.model.channel[:, 1] < 0)
    y, real = case.model.x[nodes, 1], case.bodies[0].mesh.real[nodes]
    assert sorted(np.round(y, 9)) == [0.0, 0.25, 0.5, 0.5, 0.75, 0.75, 1.0]
    assert sorted(np.round(y[~real], 9)) == [0.5, 0.75]


def test_a_box_holds_the_nodes_drawn_on_its_sides() -> None:
    held = {"wall": {"on": {"body": "block", "box": [[0.25, 0.0], [0.5, 0.25]]}, "velocity": {"y": 1.0}}}
    case = prepared({"block": block((0, 0), (1, 1))}, boundary=held)
    assert np.all(case.model.x[case.boundaries[0].nodes] >= 0.25 * np.array([1, 0]) - 1e-9)
    assert len(case.boundaries[0].nodes) == 4


@pytest.mark.parametrize(
    ("held", "message"),
    [
        (
            {"a": {"on": {"body": "block", "box": [[3, 3], [4, 4]]}, "velocity": {"x": 0.0}}},
            "no node of block",
        ),
        (
            {
                "a": {"on": "block.left", "velocity": {"x": 0.0}},
                "b": {"on": "block.outer", "velocity": {"x": 0.0}},
            },
            "already moved in x by boundary.a",
        ),
        ({"a": {"on": "block.left", "displacement": {"x": 0.1}}}, "let it start from 0"),
    ],
)
def test_boundaries_that_cannot_be_are_refused(held: dict[str, Any], message: str) -> None:
    with pytest.raises(CaseError, match=message):
        prepared({"block": block((0, 0), (1, 1))}, boundary=held)


def test_a_side_through_the_inside_of_cells_is_held_by_springs_unless_they_are_refused() -> None:
    body = block((0.1, 0.1), (0.9, 0.9), aligned=False)
    held = {"on": "block.left", "displacement": {"x": 0.0}}
    case = prepared({"block": body}, boundary={"a": held})
    assert case.boundaries[0].kind == "weak" and np.all(case.model.channel < 0)
    with pytest.raises(CaseError, match="no node\\s+stands to be held"):
        prepared({"block": body}, boundary={"a": {**held, "weak": False}})


# --- overlaps, grids -------------------------------------------------------------------------------------


def test_an_overlap_at_the_start_is_refused_or_measured_from() -> None:
    sunk = block((0.0, 0.95), (1.0, 1.95))
    with pytest.raises(CaseError, match="overlap at the start by 0.05 m"):
        prepared({"upper": sunk, "lower": LOWER}, contact=contact("upper.bottom", "lower.top"))
    case = prepared(
        {"upper": sunk, "lower": LOWER}, contact=contact("upper.bottom", "lower.top", overlap="offset")
    )
    offset = case.model.contact.offset
    assert np.allclose(offset[case.pairs[0].points], 0.05, rtol=1e-6)
    below, above = (slice(*case.model.contact.slave_first[k : k + 2]) for k in case.pairs[0].corners)
    assert np.allclose(offset[below], 0.01 * 0.25) and np.allclose(
        offset[above], 0.05 + 0.01 * 0.25, rtol=1e-6
    )


def test_surfaces_that_only_touch_have_no_offset() -> None:
    case = prepared({"upper": UPPER, "lower": LOWER}, contact=contact("upper.bottom", "lower.top"))
    assert not case.model.contact.offset[case.pairs[0].points].any()


def test_bodies_on_a_shared_grid_have_nodes_of_their_own() -> None:
    bodies = {
        "left": {**block((0.1, 0.1), (0.6, 0.9)), "grid": "common"},
        "right": {**block((0.6, 0.1), (1.3, 0.9)), "grid": "common"},
    }
    grid = {"common": {"kind": "cartesian", "cell": 0.25, "box": [[0, 0], [1.5, 1]]}}
    case = prepared(bodies, grid=grid)
    left, right = case.bodies
    assert left.nodes.stop == right.nodes.start and right.nodes.stop == len(case.model.x)
    assert case.model.mass[left.nodes].sum() == pytest.approx(RHO * 0.5 * 0.8, rel=1e-6)  # the lattice
    assert case.model.mass[right.nodes].sum() == pytest.approx(RHO * 0.7 * 0.8, rel=1e-6)


# --- motions ---------------------------------------------------------------------------------------------

DT = 1e-3


def position(channel: Channel, steps: int) -> np.ndarray:
    return np.cumsum(channel.increments(0, steps, DT))


def test_a_displacement_is_met_at_every_step() -> None:
    t = DT * np.arange(1, 1001)
    made = position(Channel("displacement", lambda t: np.sin(3.0 * t)), 1000)
    assert np.allclose(made, np.sin(3.0 * t), atol=1e-13)  # a thousand sums of rounding


def test_a_velocity_is_integrated_by_the_midpoint_rule() -> None:
    """Error of the rule: dt^2 / 24 times the change of the slope of v, at most 3 over the run."""
    t = DT * np.arange(1, 1001)
    made = position(Channel("velocity", lambda t: np.cos(3.0 * t)), 1000)
    assert np.abs(made - np.sin(3.0 * t) / 3.0).max() < 3.1 * DT**2 / 24.0


def test_a_constant_acceleration_goes_on_from_the_initial_velocity() -> None:
    """Half a kick at first: the central difference scheme is exact for a parabola."""
    t = DT * np.arange(1, 1001)
    made = position(Channel("acceleration", lambda t: np.full_like(t, -9.81), 2.0), 1000)
    assert np.allclose(made, 2.0 * t - 0.5 * 9.81 * t**2, atol=1e-12)


@pytest.mark.parametrize("kind", ["displacement", "velocity", "acceleration"])
def test_increments_do_not_depend_on_how_a_run_is_divided(kind: Any) -> None:
    """To the bit, also when a piece is asked for again (a start, a resumed run)."""

    def channel() -> Channel:
        return Channel(kind, lambda t: np.sin(7.0 * t), 0.3)

    whole = channel().increments(0, 1000, DT)
    pieces, once = channel(), channel()
    pieces.increments(0, 1, DT)
    cuts = [0, 1, 2, 77, 500, 999, 1000]
    made = [pieces.increments(a, b - a, DT) for a, b in zip(cuts[:-1], cuts[1:], strict=True)]
    assert np.array_equal(np.concatenate(made), whole)
    assert np.array_equal(once.increments(600, 400, DT), whole[600:])
    assert np.array_equal(pieces.increments(40, 60, DT), whole[40:100])
