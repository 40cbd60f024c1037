"""A prepared case small enough to be checked by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import settings

from phantomnode.geometry.bilinear import gradients, shape, to_local
from phantomnode.geometry.curves import Curve, Region
from phantomnode.geometry.doubling import BoundarySegments, CutMesh
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.pipeline.case import case_from_table
from phantomnode.pipeline.prepare import Body, Boundary, Pair, Prepared
from phantomnode.solver.cut_elements import fragment_elements
from phantomnode.solver.model import Contact, Model
from phantomnode.solver.q4 import one_point_elements
from phantomnode.solver.timestep import StepEstimate

# A change is judged by the same generated examples as the one before.
settings.register_profile("same", derandomize=True)
settings.load_profile("same")

LAME, SHEAR, RHO, PENALTY = 2.0e9, 1.0e9, 1000.0, 1e9

GAUSS = 0.5 + np.array([-1.0, 1.0]) / np.sqrt(12.0)
NO_SEGMENTS = BoundarySegments(
    np.zeros((0, 2, 2)), *(np.zeros(0, np.int64),), np.zeros((0, 2, 2)), *(np.zeros(0, np.int64),) * 2,
    np.zeros(0, np.int8), np.zeros(0, np.int64),
)  # fmt: skip


def mesh_of(xy, quads, cut, triangles, real):
    """A CutMesh whose cut elements have the given triangles (element, corners)."""
    grid = BackgroundGrid(np.array(xy), np.array(quads))
    corners = np.array([t for _, t in triangles]).reshape(-1, 3, 2)
    owner = np.array([e for e, _ in triangles], dtype=np.int64)
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    pieces = 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    area = np.where(cut, np.bincount(owner, pieces, len(quads)), grid.areas)
    m = len(quads)
    mesh = CutMesh(
        grid.xy, np.arange(len(xy)), np.array(real), grid.quads, np.arange(m), area,
        (area / grid.areas)[np.array(cut)], np.array(cut), np.zeros(m, np.int64), corners, owner, NO_SEGMENTS,
    )  # fmt: skip
    return grid, mesh


def polygon(*points):
    ring = np.array([*points, points[0]])
    return Region(Curve(ring, np.zeros(len(points))))


def body_of(name, region, grid, mesh, node, uncut, cut):
    n, c = len(mesh.xy), int(mesh.cut.sum())
    return Body(
        name, (region,), (), grid, 0, mesh, slice(node, node + n), slice(uncut, uncut + len(mesh.cut) - c),
        slice(cut, cut + c), RHO,
    )  # fmt: skip


@pytest.fixture
def handmade() -> Prepared:
    """Four cells of 0.5 m, the last cut by x + y = 1.75, above a floor of one cell; node 8 is a phantom."""
    axis = np.array([0.0, 0.5, 1.0])
    xy = [(x, y) for y in axis for x in axis]
    quads = [(0, 1, 4, 3), (1, 2, 5, 4), (3, 4, 7, 6), (4, 5, 8, 7)]
    pentagon = [(0.5, 0.5), (1.0, 0.5), (1.0, 0.75), (0.75, 1.0), (0.5, 1.0)]
    fan = [(3, (pentagon[0], pentagon[k], pentagon[k + 1])) for k in (1, 2, 3)]
    block_grid, block = mesh_of(xy, quads, [False] * 3 + [True], fan, [True] * 8 + [False])
    floor_xy = [(-1.0, -1.0), (2.0, -1.0), (2.0, 0.0), (-1.0, 0.0)]
    floor_grid, floor = mesh_of(floor_xy, [(0, 1, 2, 3)], [False], [], [True] * 4)
    outline = polygon((0.0, 0.0), (1.0, 0.0), (1.0, 0.75), (0.75, 1.0), (0.0, 1.0))
    bodies = (
        body_of("block", outline, block_grid, block, 0, 0, 0),
        body_of("floor", polygon(*floor_xy), floor_grid, floor, 9, 3, 1),
    )
    model = model_of(bodies)
    pair = Pair(
        "landing", "block.bottom", "floor.top", np.array([quads[0], quads[1]]),
        np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)), np.tile([0.0, 1.0, 0.0, 0.0], (2, 1)), slice(0, 4), 2,
    )  # fmt: skip
    table = {
        "title": "A block lands",
        "time": {"end": 1e-2},
        "material": {"soft": {"E": 2.5e9, "nu": 0.25, "rho": RHO}},
        "body": {
            name: {
                "geometry": {"rectangle": {"low": [0.0, 0.0], "high": [1.0, 1.0]}},
                "grid": {"kind": "cartesian", "cell": 0.5},
                "material": "soft",
                "initial_velocity": [0.0, -2.0 if name == "block" else 0.0],
            }
            for name in ("block", "floor")
        },
    }
    return Prepared(
        case_from_table(table), bodies, (pair,), (Boundary("base", (-1, 0), np.array([9, 10])),), model,
        Still(), StepEstimate(1e-4, 1e4, 1e4, 2), 1e-4, ("a warning [with brackets]",),
    )  # fmt: skip


class Still:
    """No motion."""

    channels = ()

    def increments(self, first_step, steps, dt):
        return np.zeros((steps, 1))


def model_of(bodies) -> Model:
    """Elements of both bodies, two Gauss points on each bottom edge of the block."""
    x = np.vstack([body.mesh.xy for body in bodies])
    nodes = [body.nodes.start + body.mesh.elements for body in bodies]
    cut = [body.mesh.cut for body in bodies]
    uncut = np.vstack([n[~c] for n, c in zip(nodes, cut, strict=True)])
    elements = one_point_elements(uncut, x[uncut], LAME, SHEAR, RHO, 0.1)
    mesh = bodies[0].mesh
    middle = np.array([[4.0, 1.0, 1.0], [1.0, 4.0, 1.0], [1.0, 1.0, 4.0]]) / 6.0
    points = np.einsum("gk,tkd->tgd", middle, mesh.triangles).reshape(-1, 2)
    owner = np.repeat(mesh.elements[3][None], len(points), axis=0)
    area = float(mesh.area[3])
    cut_elements = fragment_elements(
        mesh.elements[3:], np.array([0, len(points)]), gradients(x[owner], to_local(x[owner], points)),
        np.full(len(points), area / len(points)), LAME, SHEAR, RHO,
    )  # fmt: skip
    mass = np.zeros(len(x))
    for group in (elements, cut_elements):
        np.add.at(mass, group.nodes, np.repeat(0.25 * group.mass[:, None], 4, axis=1))
    channel = np.full((len(x), 2), -1, dtype=np.int32)
    channel[[9, 10], 1] = 0
    bottom = np.repeat(nodes[0][:2], 2, axis=0)
    edge = np.column_stack([2.0 * np.tile(GAUSS, 2) - 1.0, np.full(4, -1.0)])
    contact = Contact(
        bottom, shape(edge), np.full(4, 0.25), np.array([0, 4]), nodes[1],
        np.array([[0.0, 0.0, 1.0, 0.0]]), np.array([[0.0, 0.0, 0.0, 1.0]]), np.array([-1]), np.array([-1]),
        np.array([0, 1]), np.array([PENALTY]), np.array([0.5]), np.zeros(4),
    )  # fmt: skip
    return Model(x, mass, np.zeros((0, 2)), channel, 1, elements, cut_elements, contact)


@pytest.fixture
def frame_of(handmade):
    """Frames of the hand-made case: everything zero but what is given."""
    from phantomnode.solver.explicit import Frame
    from phantomnode.solver.model import Energies

    def build(step=0, **given):
        zero = {
            "time": step * handmade.dt,
            "step": step,
            "u": np.zeros((13, 2)),
            "v": handmade.velocity,
            "energies": Energies(0.0, 0.0, 0.0, 0.0, 0.0),
            "energy_error": 0.0,
            "reaction": np.zeros(1),
            "pair_force": np.zeros((1, 2)),
            "pair_impulse": np.zeros((1, 2)),
            "pair_peak": np.zeros(1),
            "gap": np.full(4, -1e300),
            "normal": np.zeros((4, 2)),
            "smallest_j": 1.0,
            "state": None,
            "initial_energy": 0.0,
            "largest_energy": 0.0,
        }
        return Frame(**(zero | given))

    return build
