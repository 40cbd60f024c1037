"""Cracks with tips inside a body: opening against Sneddon's closed form, closing with contact of the faces."""

from __future__ import annotations

from typing import NamedTuple

import meshio
import numpy as np
import pytest
from scipy.sparse import coo_array, diags_array
from statics import NU, YOUNG, forces, linear_equilibrium, one_body, rate, stiffness

from phantomnode.geometry.bilinear import shape
from phantomnode.pipeline.pairing import LEAST_JUMP
from phantomnode.pipeline.run import march
from phantomnode.pipeline.tally import Tally
from phantomnode.solver.contact import reference_length
from phantomnode.solver.timestep import stable_step

STRESS = 1e6
CRACK = {"body": "part", "geometry": {"polyline": {"points": [[-1.0, 0.0], [1.0, 0.0]]}}}
"""Half-length a = 1 m; its tips stand on cell edges, and it runs through the middle of its row of cells."""


def plate(folder, cells, half_width, **tables):
    """A plate with the crack of 2 a on a grid of ``cells`` to a around it, coarser further away, pulled in y."""
    x = list(np.arange(int(1.5 * cells) + 1) / cells)
    while x[-1] < half_width:
        x.append(x[-1] + 1.1 ** (len(x) - int(1.5 * cells)) / cells)
    x = np.concatenate([-np.array(x[:0:-1]), x])
    y = x + 0.5 / cells
    n = len(x)
    corners = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    points = np.column_stack([np.repeat(x, n), np.tile(y, n), np.zeros(n * n)])
    quads = np.column_stack([corners, corners + n, corners + n + 1, corners + 1])
    tags = {"gmsh:physical": [np.zeros(len(quads), int)], "gmsh:geometrical": [np.zeros(len(quads), int)]}
    mesh = meshio.Mesh(points, [("quad", quads)], cell_data=tags)
    meshio.write(folder / "grid.msh", mesh, file_format="gmsh22", binary=False)
    rise = tables.pop("rise", "1")
    return one_body(
        {"rectangle": {"low": [float(x[0]), float(y[0])], "high": [float(x[-1]), float(y[-1])]}},
        {"file": str(folder / "grid.msh"), "unit": "m"},
        interface={"crack": CRACK},
        boundary={
            "up": {"on": "part.top", "traction": {"y": f"{STRESS}*{rise}"}},
            "down": {"on": "part.bottom", "traction": {"y": f"{-STRESS}*{rise}"}},
        },
        **tables,
    )


def opening(prepared, u, at=0.5):
    """Places x along the crack and the jump of the normal displacement at the part ``at`` of each segment."""
    mesh = prepared.bodies[0].mesh
    faces = []
    for side in (1, -1):
        on = np.flatnonzero(mesh.segments.side == side)
        t = at if side == 1 else 1.0 - at  # the faces run against each other
        here = (1.0 - t) * shape(mesh.segments.local[on, 0]) + t * shape(mesh.segments.local[on, 1])
        moved = np.einsum("si,sia->sa", here, u[mesh.elements[mesh.segments.element[on]]])
        start, end = mesh.segments.ends[on, 0], mesh.segments.ends[on, 1]
        along = end - start
        into = np.column_stack([-along[:, 1], along[:, 0]]) / np.hypot(*along.T)[:, None]
        x = ((1.0 - t) * start + t * end)[:, 0]
        order = np.argsort(x)
        faces.append((x[order], np.sum(moved * into, axis=1)[order]))
    np.testing.assert_allclose(faces[0][0], faces[1][0], atol=1e-9)
    return faces[0][0], faces[0][1] + faces[1][1]


def sneddon(x):
    """Opening of a crack in an infinite plate, plane strain: 4 (1 - nu^2) s/E sqrt(a^2 - x^2).

    I. N. Sneddon, The distribution of stress in the neighbourhood of a crack in an elastic solid, Proc. R.
    Soc. Lond. A 187 (1946) 229-260.
    """
    return 4.0 * (1.0 - NU**2) * STRESS / YOUNG * np.sqrt(np.maximum(1.0 - x**2, 0.0))


class Miss(NamedTuple):
    """How far an opening is from Sneddon's, but for ``square`` in parts of the largest opening.

    crossings: the largest at the cell edges that the crack crosses, tips included; square: the root of the mean
    square at the middles of all segments, in parts of that of the opening; tip: the largest at the middles of the
    two segments at the tips; chord: how far the middle of the straight line between two points of the closed
    form is from it there.
    """

    crossings: float
    square: float
    tip: float
    chord: float


def miss(prepared, u):
    """The opening against the closed form from tip to tip."""
    crossings = []
    for end in (0.0, 1.0):
        x, found = opening(prepared, u, end)
        crossings.append(np.abs(found - sneddon(x)).max())
    x, found = opening(prepared, u)
    wrong, tips = found - sneddon(x), np.array([0, -1])
    size = 1.0 - np.abs(x[tips])  # half a segment
    chord = np.abs(0.5 * sneddon(1.0 - 2.0 * size) - sneddon(x[tips])).max()
    square = np.sqrt(np.sum(wrong**2) / np.sum(sneddon(x) ** 2))
    largest = np.array([max(crossings), np.abs(wrong[tips]).max(), chord]) / sneddon(0.0)
    return Miss(largest[0], float(square), largest[1], largest[2])


def test_a_crack_opens_as_in_the_closed_form(tmp_path):
    """A plate of 32 x 32 half-lengths: being finite opens it by a few tenths of a percent (1 + 0.6 (a/W)^2).

    Within 3 % of the largest opening at 40 cells a half-length at every cell edge that the crack crosses, from
    tip to tip, and within 3 % by the mean square over the middles of all segments. Between two crossings the
    jump is (bilinear) a straight line, and the square root at the tip is not: in the middle of the last segment a
    line through the exact opening misses 0.207 sqrt(h/a), 4.6 %. There the miss may be 2 % more than that.
    """
    sizes, found = [1 / 10, 1 / 20, 1 / 40], []
    for cells in (10, 20, 40):
        prepared = plate(tmp_path, cells, 16.0)
        u = linear_equilibrium(prepared.model, [STRESS, -STRESS])
        left, load = (forces(prepared.model, at, [STRESS, -STRESS]) for at in (u, 0.0 * u))
        assert np.abs(left).max() < 2e-3 * np.abs(load).max()  # finite strain at the tips
        found.append(miss(prepared, u))
    x, jump = opening(prepared, u)
    assert len(x) == 2 * cells and jump[cells] == pytest.approx(sneddon(x[cells]), rel=0.005)
    # Measured: crossings 3.8, 2.7, 1.9 %; mean square 5.4, 2.7, 1.3 %; middle at the tip 11.3, 7.9, 5.6 %, of
    # which the straight line makes 9.4, 6.6, 4.6 %. The middle of the crack is right to 0.1 %.
    assert found[-1].crossings < 0.03 and found[-1].square < 0.03
    assert all(each.tip < each.chord + 0.02 for each in found)
    # The square root leaves rate 1/2 beside the tips, and rate 1 all along.
    assert rate(sizes, [each.crossings for each in found]) > 0.45
    assert rate(sizes, [each.square for each in found]) > 0.9


@pytest.mark.slow
def test_a_crack_opens_as_in_the_closed_form_in_an_explicit_run(tmp_path):
    """The same by mass damping near the lowest mode, compared at the same places with the same bounds."""
    prepared = plate(
        tmp_path,
        40,
        12.0,
        time={"end": 0.12},
        damping={"mass": 250.0},
        rise="ramp(t, 0, 0.03)",
        output={"history": {"count": 20}, "fields": {"count": 1}},
    )
    tally = Tally(prepared)
    ending, _ = march(prepared, [tally])
    assert ending.status == "done" and tally.last is not None
    found = miss(prepared, tally.last.u)
    assert found.crossings < 0.03 and found.square < 0.03 and found.tip < found.chord + 0.02
    assert tally.energy_error_max < 1e-3


SHAPES = {
    "interior": {"polyline": {"points": [[-0.5, 0.013], [0.5, 0.013]]}},
    "on a grid line": {"polyline": {"points": [[-0.5, 0.0], [0.5, 0.0]]}},
    "ends within edges": {"polyline": {"points": [[-0.53, 0.0], [0.515, 0.0]]}},
    "edge": {"polyline": {"points": [[-2.2, 0.013], [-1.4, 0.013]]}},
    "slanted": {"polyline": {"points": [[-0.5, -0.1], [0.5, 0.13]]}},
    "short tip segments": {"polyline": {"points": [[-0.31, -0.30995], [0.31, 0.31005]]}},
    "curved": {"function": "0.1*cos(3*x)", "x": [-0.6, 0.6]},
}
"""In a block of 4 m x 2 m on cells of 0.1 m. The faces of one that ends within edges are held together up to the
nodes before. The one with short tip segments runs beside the diagonals of cells; without relocation its first and
last segments are 7e-4 cells long."""

UNMOVED = {"short tip segments": {"relocation": {"distance": 0.0}}}


def block(geometry, stress, on, cell=0.1, penalty="auto", points=None, low=(-2.0, -1.0), **tables):
    """A block with a crack under the same normal traction, Pa or a function of time, on some of its sides."""
    towards = {"top": {"y": 1}, "bottom": {"y": -1}, "left": {"x": -1}, "right": {"x": 1}}
    contact = {"slave": "crack.minus", "master": "crack.plus", "penalty": penalty, "points": points or {}}
    return one_body(
        {"rectangle": {"low": list(low), "high": [-low[0], -low[1]]}},
        {"kind": "cartesian", "cell": cell},
        interface={"crack": {"body": "part", "geometry": geometry}},
        contact={"faces": contact},
        boundary={
            side: {
                "on": f"part.{side}",
                "traction": {axis: f"{sign}*{stress}" for axis, sign in towards[side].items()},
            }
            for side in on
        },
        **tables,
    )


def squeezed(geometry, stress, on=("top", "bottom"), **tables):
    """Such a block, brought to rest by mass damping."""
    prepared = block(
        geometry, f"{stress}*ramp(t, 0, 0.02)", on, time={"end": 0.04}, damping={"mass": 1500.0}, **tables
    )
    tally = Tally(prepared)
    ending, _ = march(prepared, [tally])
    assert ending.status == "done" and tally.energy_error_max < 1e-4
    return prepared, tally.last


ALL_ROUND = ("top", "bottom", "left", "right")
PRESSURE = 1e7
PARTS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Where the jump of each segment is looked at: its ends, where the crack crosses cell edges, and between."""


def overlaps(prepared, gap, u):
    """Largest overlap at the slave points, and along the whole crack, in units of pressure/eps."""
    unit = PRESSURE / prepared.model.contact.penalty[0]
    along = max(-opening(prepared, u, at)[1].min() for at in PARTS)
    return gap.max() / unit, along / unit


@pytest.mark.parametrize(
    ("kind", "points"),
    [
        *((kind, {}) for kind in SHAPES),
        ("on a grid line", {"count": 1}),
        ("slanted", {"count": 4}),
        ("interior", {"rule": "newton-cotes", "count": 3}),
    ],
)
def test_the_faces_of_a_closed_crack_do_not_overlap_by_more_than_pressure_over_penalty(kind, points):
    """Under the same pressure from all sides, which any crack bears as pressure on its faces alone.

    At each slave point and at every place along the crack, tips included: 0.996 to 0.998 of p/eps, because the body
    around the tips, which cannot part, bears a little for the faces. (In a block only twice as long as the crack it
    leaves their middle more, 1.0006 p on any grid.) At the mouth of the edge crack, about whose tip the body turns,
    the pressure is 1.0043 p; on grids of a half, a quarter and an eighth with the same penalty 1.0047, 1.0048 and
    1.0049 p, so that it is the body's. The facets of the curved one: see below. One point a segment does not
    see how the faces swing about it from edge to edge, 1.0016 here, and is held to what it sees.
    """
    prepared, frame = squeezed(SHAPES[kind], -PRESSURE, ALL_ROUND, points=points, **UNMOVED.get(kind, {}))
    # Newton-Cotes points stand on the two tips, too, which have nothing to open.
    ends = 2 * (points.get("rule") == "newton-cotes") + 4 * (kind == "ends within edges")
    assert np.count_nonzero(frame.gap <= 0.0) <= ends
    most = {"edge": 1.0049, "curved": 1.003}.get(kind, 1.0)
    at_points, along = overlaps(prepared, frame.gap, frame.u)
    assert 0.99 < at_points <= most and 0.99 < along
    assert along <= most or points.get("count") == 1
    # Where the tips do not bear, the pressure is that from outside.
    force, length = np.hypot(*frame.pair_force[0]), np.hypot(*chord(prepared))
    assert force == pytest.approx(PRESSURE * length, rel=0.06)


def test_the_short_tip_segments_are_short():
    prepared = block(SHAPES["short tip segments"], 1.0, (), **UNMOVED["short tip segments"])
    segments = prepared.bodies[0].mesh.segments
    lengths = np.hypot(*np.diff(segments.ends[segments.side == 1], axis=1)[:, 0].T) / 0.1
    assert lengths[[0, -1]] == pytest.approx(np.sqrt(0.5) * 1e-3, rel=1e-3) and lengths[1] > 1.4


def chord(prepared):
    """From one end of the crack to the other, m: the pressure on a crooked face adds up to that on its chord."""
    segments = prepared.bodies[0].mesh.segments
    return np.sum(np.diff(segments.ends[segments.side == 1], axis=1), axis=(0, 1))


def closed_equilibrium(prepared):
    """Overlap at the slave points and displacement at small strain, with all springs of the faces closed."""
    model, contact = prepared.model, prepared.model.contact
    x = np.einsum("gi,gia->ga", contact.slave_shape, model.x[contact.slave_nodes])
    a, b = (
        np.einsum("si,sia->sa", shapes, model.x[contact.master_nodes])
        for shapes in (contact.start_shape, contact.end_shape)
    )
    d = b - a
    t = np.clip(np.sum((x[:, None] - a) * d, axis=2) / np.sum(d * d, axis=1), 0.0, 1.0)
    s = np.argmin(np.sum((x[:, None] - a - t[..., None] * d) ** 2, axis=2), axis=1)
    t = t[np.arange(len(s)), s][:, None]
    on_master = (1.0 - t) * contact.start_shape[s] + t * contact.end_shape[s]
    nodes = np.hstack([contact.slave_nodes, contact.master_nodes[s]])
    into = np.column_stack([-d[s, 1], d[s, 0]]) / np.hypot(*d[s].T)[:, None]
    parts = np.hstack([contact.slave_shape, -on_master])[:, :, None] * into[:, None]
    columns = (2 * nodes[:, :, None] + np.arange(2)).ravel()
    rows = np.repeat(np.arange(len(x)), 16)
    overlap = coo_array((parts.ravel(), (rows, columns)), shape=(len(x), 2 * len(model.x))).tocsr()
    springs = contact.penalty[0] * overlap.T @ diags_array(contact.slave_weight) @ overlap
    u = linear_equilibrium(model, prepared.motion.values(0, 1, 1.0)[0], springs)
    return overlap @ u.ravel(), u


def test_the_facets_of_a_curved_crack_do_neither_on_finer_cells():
    """By equilibrium at the same penalty: 1.0022, 1.0002 and 0.9993 of p/eps on cells of 0.1, 0.05 and 0.025 m."""
    found = []
    for cell in (0.1, 0.05, 0.025):
        prepared = block(SHAPES["curved"], -PRESSURE, ALL_ROUND, cell, {"value": 1e12})
        found.append(max(overlaps(prepared, *closed_equilibrium(prepared))))
    assert found[0] < 1.003 and found[2] < found[1] < found[0] and found[2] <= 1.0


def test_no_closed_crack_overlaps_by_more_than_pressure_over_penalty_wherever_it_lies():
    """24 cracks at random places, in random directions, a quarter along cell edges or diagonals, by equilibrium.

    With the penalty of 5 E/h that is automatic nowhere; with stiffer ones, of up to 100 E/h, by at most 3e-3, next to
    tips: the change from p/eps to nothing takes less than a cell then, and the pressure swings about p by so much.
    """
    rng, worst = np.random.default_rng(1), {True: 0.0, False: 0.0}
    for number in range(24):
        middle, angle = rng.uniform(-0.05, 0.05, 2), rng.uniform(0.0, np.pi)
        if number % 4 == 0:
            middle, angle = 0.05 * np.round(middle / 0.05), 0.25 * np.pi * rng.integers(4)
        half = rng.uniform(0.2, 0.42) * np.array([np.cos(angle), np.sin(angle)])
        geometry = {"polyline": {"points": [list(middle - half), list(middle + half)]}}
        for automatic in (True, False):
            stiff = 5.0 if automatic else 10.0 ** rng.uniform(1.0, 2.0)
            penalty = {"value": stiff * YOUNG / 0.05}
            prepared = block(geometry, -PRESSURE, ALL_ROUND, 0.05, penalty, low=(-1.0, -1.0))
            gap, u = closed_equilibrium(prepared)
            worst[automatic] = max(worst[automatic], *overlaps(prepared, gap, u))
    assert worst[True] <= 1.0 and worst[False] < 1.005


def test_what_slides_overlaps_by_more_only_as_long_as_cells_are_coarse():
    """Pressed from above alone, the slopes slide, without friction, and facets that slide roughen the pressure.

    The penalty is the same on all grids. The slanted crack is to bear p cos^2 (the sliding of a straight crack adds
    nothing across it), the crest of the curved one 1.062 p: what its middle bears on the finest grid.
    """
    sizes, more = [0.05, 0.025, 0.0125], {"slanted": [], "curved": []}
    for kind, borne in (("slanted", np.cos(np.arctan(0.23)) ** 2), ("curved", 1.062)):
        for cell in sizes:
            penalty = {"value": 1e12}
            prepared = block(SHAPES[kind], -PRESSURE, ("top", "bottom"), cell, penalty)
            gap, u = closed_equilibrium(prepared)
            more[kind].append(overlaps(prepared, gap, u)[1] - borne)
        middle = -opening(prepared, u)[1][len(opening(prepared, u)[1]) // 2] * 1e12 / PRESSURE
        assert middle == pytest.approx(borne, rel=5e-3)
    # Measured: 0.111, 0.066, 0.020 and 0.221, 0.088, 0.029.
    assert rate(sizes, more["slanted"]) > 1.0 and rate(sizes, more["curved"]) > 1.0
    assert more["slanted"][-1] < 0.03 and more["curved"][-1] < 0.04


@pytest.mark.parametrize("kind", SHAPES)
def test_the_faces_of_a_crack_pressed_from_above_bear_what_is_across_them(kind):
    """Straight ones as above. On slopes no shear: the force is less by cos^2, its vertical part by another cosine."""
    prepared, frame = squeezed(SHAPES[kind], -PRESSURE, **UNMOVED.get(kind, {}))
    length = reference_length(prepared.model.contact)
    at_points, along = overlaps(prepared, frame.gap, frame.u)
    if kind in ("interior", "on a grid line", "ends within edges", "edge"):
        assert max(at_points, along) <= (1.0049 if kind == "edge" else 1.0)
    assert np.average(frame.gap, weights=length) < PRESSURE / prepared.model.contact.penalty[0]
    slope = {"slanted": np.cos(np.arctan(0.23)) ** 3, "short tip segments": 0.5**1.5, "curved": 0.95}.get(
        kind, 1.0
    )
    assert -frame.pair_force[0, 1] == pytest.approx(PRESSURE * length.sum() * slope, rel=0.06)


THROUGH = {"polyline": {"points": [[-1.2, 0.013], [1.2, 0.1]]}}
CLOSED = {"circle": {"centre": [0.0, 0.01], "radius": 0.3}}
ANGLE = {"polyline": {"points": [[-0.5, 0.013], [0.02, 0.013], [0.02, 0.4]]}}


@pytest.mark.parametrize(
    ("geometry", "tips"),
    [
        *((SHAPES[kind], 2) for kind in ("interior", "slanted", "curved")),
        (SHAPES["edge"], 1),
        (ANGLE, 2),
        (THROUGH, 0),
        (CLOSED, 0),
    ],
)
def test_only_points_beside_tips_are_stiffer(geometry, tips):
    """By 1/J, where J is what the nodes that the faces do not have in common add up to at a point."""
    low = (-2.0, -0.5) if geometry is SHAPES["edge"] else (-1.0, -0.5)
    prepared = block(geometry, 0.0, (), low=low)
    contact, segments = prepared.model.contact, prepared.bodies[0].mesh.segments
    on = segments.side == -1
    length = 0.5 * np.repeat(np.hypot(*np.diff(segments.ends[on], axis=1)[:, 0].T), 2)
    np.testing.assert_allclose(reference_length(contact), length, rtol=1e-14)
    common = set(contact.slave_nodes.ravel()) & set(contact.master_nodes.ravel())
    apart = ~np.isin(contact.slave_nodes, list(common))
    expected = np.sum(contact.slave_shape, axis=1, where=apart)
    stiffer = np.count_nonzero(expected < 1.0 - 1e-12)
    assert 2 * tips <= stiffer <= 4 * tips  # those of one segment beside each tip, or of two
    if not tips:
        assert len(contact.slave_jump) == 0
        return
    np.testing.assert_allclose(contact.slave_jump, np.maximum(expected, LEAST_JUMP), rtol=1e-12)


@pytest.mark.parametrize("kind", SHAPES)
@pytest.mark.parametrize("count", [1, 2])
def test_the_step_is_safe_with_stiff_springs_all_along_a_crack(kind, count):
    """All points closed (an overlap of 1e-9 m to begin with); springs far stiffer than the body: 1.12 to 1.85.

    2.29 with one point a segment at the mouth of an edge crack, where the master ends and the point may stand beyond.
    """
    low = (-2.0, -0.4) if kind == "edge" else (-1.0, -0.4)
    tables = UNMOVED.get(kind, {})
    springs = {"penalty": {"times_E": 1e6}, "points": {"count": count}}
    model = block(SHAPES[kind], 0.0, (), low=low, **springs, **tables).model
    pressed = model.contact._replace(offset=np.full(len(model.contact.slave_weight), -1e-9))
    model = model._replace(contact=pressed)
    whole, step = stiffness(model).toarray(), 1e-10
    for k in np.unique(np.concatenate([pressed.slave_nodes, pressed.master_nodes])):
        for axis in (0, 1):
            u = np.zeros_like(model.x)
            u[k, axis] = step
            whole[:, 2 * k + axis] = (forces(model, -u) - forces(model, u)).ravel() / (2.0 * step)
    scale = 1.0 / np.sqrt(np.repeat(model.mass, 2))
    largest = np.abs(np.linalg.eigvals(scale[:, None] * whole * scale)).max()
    assert (
        1.0
        < 2.0 / np.sqrt(largest) / stable_step(model, safety=1.0).dt
        < (2.3 if (kind, count) == ("edge", 1) else 2.0)
    )


@pytest.mark.parametrize("kind", ["interior", "edge", "slanted"])
def test_the_faces_of_an_opening_crack_are_free(kind):
    prepared, frame = squeezed(SHAPES[kind], 1e7)
    assert not np.any(frame.pair_force) and not np.any(frame.gap > 0.0)
    assert frame.energies.contact == 0.0
    assert np.all(opening(prepared, frame.u)[1] > 0.0)
