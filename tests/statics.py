"""Static equilibrium of a prepared case, by other means than stepping: an oracle for loads and supports."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import spsolve

from phantomnode.geometry.bilinear import shape, to_local
from phantomnode.pipeline.case import case_from_table
from phantomnode.pipeline.elements import THREE_POINTS
from phantomnode.pipeline.prepare import prepare
from phantomnode.solver.layout import prepare_layout
from phantomnode.solver.leapfrog import advance, initial_state
from phantomnode.solver.stress import cut_stress, element_stress
from phantomnode.solver.timestep import _strain_stiffness

YOUNG, NU, RHO = 1e10, 0.3, 7800.0

RING = {"ring": {"centre": [0.013, 0.007], "outer": 0.5, "inner": 0.25}}
PLATE = {"polygon": {"points": [[0.0, 0.0], [0.91, 0.13], [0.8, 0.77], [-0.1, 0.6]]}}


def cartesian(cell, **more):
    return {"kind": "cartesian", "cell": cell, **more}


def prepared_case(**tables):
    """A case of one material "m" (E = 10 GPa, nu = 0.3) from the tables beside it."""
    material = {"m": {"E": YOUNG, "nu": NU, "rho": RHO}}
    return prepare(case_from_table({"time": {"end": 1e-3}, "material": material, **tables}))


def one_body(geometry, grid, **tables):
    """A case of one body "part"."""
    return prepared_case(body={"part": {"geometry": geometry, "grid": grid, "material": "m"}}, **tables)


def loaded_plate():
    """A tilted plate with everything at once: follower, dead pressure, traction, gravity(t), weak and strong."""
    return one_body(
        PLATE,
        cartesian(0.17),
        gravity=["3e4*t/1e-3", -9.81],
        boundary={
            "push": {"on": "part.outer", "pressure": "2e8*sin(2000*t)**2"},
            "dead": {"on": "part.outer", "pressure": "1e8*sin(1500*t)**2", "follower": False},
            "pull": {"on": "part.outer", "traction": {"x": "3e7*(1 - cos(900*t))", "y": 0.0}},
            "hold": {"on": "part.outer", "displacement": {"y": "1e-3*sin(700*t)**2"}, "penalty": {"times_E": 10.0}},
            "grip": {
                "on": {"body": "part", "box": [[-0.11, 0.2], [0.05, 0.7]]},
                "velocity": {"x": "0.4*sin(2000*t)"},
            },
        },
    )  # fmt: skip


def forces(model, u, value=None, held=None):
    """(n, 2) Forces on the nodes at a displacement, for given values of the loads and supports."""
    layout = prepare_layout(model)
    state = initial_state(model, np.zeros_like(model.x), layout)
    state.u[:] = u
    state.value[:] = 0.0 if value is None else value
    state.held[:] = 0.0 if held is None else held
    advance(model, layout, state, 0.0, np.zeros((0, model.channels)))
    return state.force


def stiffness(model):
    """(2n, 2n) Stiffness of small strain with hourglass control and weak supports, sparse."""
    e, cut, held = model.elements, model.cut_elements, model.supports
    whole = e.volume[:, None, None] * _strain_stiffness(e.gradient, e.lame, e.shear)
    whole += e.hourglass[:, None, None] * np.einsum("mi,mj,ab->miajb", e.gamma, e.gamma, np.eye(2)).reshape(
        -1, 8, 8
    )
    owner = np.repeat(np.arange(len(cut.lame)), np.diff(cut.first))
    points = cut.weight[:, None, None] * _strain_stiffness(cut.gradient, cut.lame[owner], cut.shear[owner])
    on = held.channel >= 0
    springs = np.einsum("p,pi,pj,pa,ab->piajb", held.stiffness, held.shape, held.shape, on, np.eye(2))
    rows, columns, values = [], [], []
    for nodes, blocks in (
        (e.nodes, whole),
        (cut.nodes[owner], points),
        (held.nodes, springs.reshape(-1, 8, 8)),
    ):
        dof = (2 * nodes[:, :, None] + np.arange(2)).reshape(-1, 8)
        rows.append(np.repeat(dof, 8, axis=1).ravel())
        columns.append(np.tile(dof, (1, 8)).ravel())
        values.append(blocks.ravel())
    size = 2 * len(model.x)
    entries = (np.concatenate(rows), np.concatenate(columns))
    return coo_array((np.concatenate(values), entries), shape=(size, size)).tocsr()


def linear_equilibrium(model, value=None, springs=0.0):
    """(n, 2) Displacement of small-strain equilibrium; what is not held floats without rigid motion.

    springs (2n, 2n) is added to the stiffness.
    """
    free = np.flatnonzero((model.channel < 0).ravel())
    matrix = (stiffness(model) + springs)[free][:, free]
    weight = np.repeat(model.mass, 2)[free]
    # A shift far below the lowest mode holds rigid bodies and, without a load on them, moves nothing.
    matrix = matrix + diags_array(weight * (1e-9 * np.min(matrix.diagonal() / weight)))
    u = np.zeros(2 * len(model.x))
    load = forces(model, np.zeros_like(model.x), value).ravel()[free]
    u[free] = spsolve(matrix.tocsc(), load)
    return u.reshape(-1, 2)


def equilibrium(model, value, u, steps=8):
    """(n, 2) Displacement of equilibrium at finite strain: Newton's method, the load in equal steps."""
    free = np.flatnonzero((model.channel < 0).ravel())
    u = u.copy()

    def residual(at, load):
        full = u.copy()
        full.ravel()[free] = at
        return forces(model, full, load).ravel()[free]

    at = u.ravel()[free]
    for step in range(1, steps + 1):
        load = np.asarray(value) * step / steps
        for _ in range(30):
            out = residual(at, load)
            columns = [residual(at + 1e-7 * unit, load) for unit in np.eye(len(free))]
            tangent = (np.array(columns).T - out[:, None]) / 1e-7
            change = np.linalg.solve(tangent, -out)
            at = at + change
            if np.max(np.abs(change)) < 1e-10 * max(np.max(np.abs(at)), 1e-3):
                break
        else:
            raise AssertionError("no equilibrium found")
    full = u.copy()
    full.ravel()[free] = at
    return full


class Points:
    """Where to integrate over the first body: 2x2 points of uncut elements, all points of cut ones.

    x (p, 2), m; weight (p,), m^2; nodes (p, 4), shape (p, 4); stress is known at ``stress_x``.
    """

    def __init__(self, prepared):
        model, mesh = prepared.model, prepared.bodies[0].mesh
        s = np.array([-1.0, 1.0]) / np.sqrt(3.0)
        square = shape(np.array([(a, b) for a in s for b in s]))
        uncut = mesh.elements[~mesh.cut]
        cut_x = np.einsum("pk,tka->tpa", THREE_POINTS, mesh.triangles).reshape(-1, 2)
        cut_nodes = np.repeat(mesh.elements[mesh.triangle_element], 3, axis=0)
        self.nodes = np.concatenate([np.repeat(uncut, 4, axis=0), cut_nodes])
        self.shape = np.concatenate(
            [np.tile(square, (len(uncut), 1)), shape(to_local(mesh.xy[cut_nodes], cut_x))]
        )
        self.x = np.einsum("pi,pia->pa", self.shape, mesh.xy[self.nodes])
        cut_weight = model.cut_elements.weight
        self.weight = np.concatenate([np.repeat(model.elements.volume / 4, 4), cut_weight])
        self.stress_x = np.concatenate([mesh.xy[uncut].mean(axis=1), cut_x])
        self.stress_weight = np.concatenate([model.elements.volume, cut_weight])
        self._model = model

    def displacement(self, u):
        """(p, 2) displacement at ``x``."""
        return np.einsum("pi,pia->pa", self.shape, u[self.nodes])

    def stress(self, u):
        """(q, 3) Cauchy stress xx, yy, xy at ``stress_x``."""
        whole, cut = element_stress(self._model.elements, u)[0], cut_stress(self._model.cut_elements, u)[0]
        return np.concatenate([whole, cut])[:, [0, 1, 3]]


def norm(field, weight):
    """L2 norm of (p, c) values."""
    return float(np.sqrt(np.sum(weight[:, None] * field**2)))


def rate(sizes, errors):
    """Slope of log error over log size."""
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])
