"""Kernels of loads and weak supports: NumPy twins, gradients of energies, areas and lengths."""

from __future__ import annotations

import numpy as np
import pytest
from statics import PLATE, RING, cartesian, forces, loaded_plate, one_body

from phantomnode.pipeline.quadrature import surface_points
from phantomnode.solver.model import Loads
from phantomnode.solver.surface_loads import add_loads, add_support_forces, load_power, support_energy


@pytest.fixture(scope="module")
def loaded():
    return loaded_plate()


def random_field(model, size, seed=0):
    return size * np.random.default_rng(seed).uniform(-1.0, 1.0, model.x.shape)


def twin_of_loads(loads: Loads, value, x, u):
    """Forces and resultants of all rows in NumPy."""
    force, applied = np.zeros_like(x), np.zeros((loads.rows, 2))
    f = loads.coefficient * value[loads.row]
    np.add.at(force, (loads.node, loads.axis), f)
    np.add.at(applied, (loads.row, loads.axis), f)
    line = np.einsum("qi,qia->qa", loads.point_slope, (x + u)[loads.point_nodes])
    at_points = value[loads.point_row][:, None] * np.column_stack([-line[:, 1], line[:, 0]])
    np.add.at(force, loads.point_nodes, loads.point_shape[:, :, None] * at_points[:, None])
    np.add.at(applied, loads.point_row, at_points)
    return force, applied, at_points


@pytest.mark.twin("surface_loads.add_loads", "surface_loads.load_power")
def test_load_kernels_agree_with_numpy(loaded):
    model = loaded.model
    loads, u, v = model.loads, random_field(model, 0.05), random_field(model, 3.0, 1)
    value = np.random.default_rng(2).uniform(-1e8, 1e8, loads.rows)
    force, applied = np.ones_like(u), np.full((loads.rows, 2), 7.0)
    at_points = np.full((len(loads.point_row), 2), 7.0)
    add_loads(loads, value, model.x, u, force, applied, at_points)
    expected = twin_of_loads(loads, value, model.x, u)
    scale = np.abs(expected[0]).max()
    np.testing.assert_allclose(force - 1.0, expected[0], atol=1e-13 * scale)
    np.testing.assert_allclose(applied, expected[1], atol=1e-13 * np.abs(applied).max())
    np.testing.assert_allclose(at_points, expected[2], atol=1e-13 * np.abs(at_points).max())
    power = expected[0] * v
    assert load_power(loads, value, at_points, v) == pytest.approx(
        power.sum(), abs=1e-13 * np.abs(power).sum()
    )


@pytest.mark.twin("surface_loads.add_support_forces")
def test_support_kernel_is_the_gradient_of_its_energy_and_agrees_with_numpy(loaded):
    supports, u = loaded.model.supports, random_field(loaded.model, 1e-3)
    held = np.random.default_rng(5).uniform(-1e-3, 1e-3, loaded.model.channels)
    force, reaction = np.zeros_like(u), np.full(loaded.model.channels, 7.0)
    add_support_forces(supports, held, u, force, reaction)
    on = supports.channel >= 0
    assert on[:, 1].all() and not on[:, 0].any()
    here = np.einsum("pi,pi->p", supports.shape, u[supports.nodes][:, :, 1])
    pull = -supports.stiffness * (here - held[supports.channel[:, 1]])
    expected = np.zeros_like(u)
    np.add.at(expected[:, 1], supports.nodes, supports.shape * pull[:, None])
    np.testing.assert_allclose(force, expected, atol=1e-13 * np.abs(expected).max())
    for channel in np.unique(supports.channel[:, 1]):
        mine = pull[
            supports.channel[:, 1] == channel
        ]  # pushes and pulls: of their sizes, not of what is left
        assert reaction[channel] == pytest.approx(mine.sum(), abs=1e-13 * np.abs(mine).sum())
    direction = random_field(loaded.model, 1e-3, 3)
    change = [support_energy(supports, held, u + s * direction) for s in (-1.0, 1.0)]  # quadratic: exact
    assert (change[1] - change[0]) / 2.0 == pytest.approx(-np.sum(force * direction), rel=1e-11)


def test_a_follower_pressure_on_a_closed_curve_is_the_gradient_of_the_area_and_has_no_resultant():
    model = one_body(RING, cartesian(0.13), boundary={"p": {"on": "part.outer", "pressure": 1.0}}).model
    loads, pressure = model.loads, 3e6

    def enclosed(u):
        here = (model.x + u)[loads.point_nodes]
        point = np.einsum("qi,qia->qa", loads.point_shape, here)
        line = np.einsum("qi,qia->qa", loads.point_slope, here)
        return 0.5 * np.sum(point[:, 0] * line[:, 1] - point[:, 1] * line[:, 0])

    assert enclosed(0.0 * model.x) == pytest.approx(np.pi * 0.25, rel=0.02)
    u, direction = random_field(model, 0.02), random_field(model, 1.0, 4)
    force, applied = np.zeros_like(u), np.zeros((1, 2))
    add_loads(loads, np.array([pressure]), model.x, u, force, applied, np.zeros((len(loads.point_row), 2)))
    size = np.abs(force).sum()
    assert np.abs(applied).max() < 1e-13 * size
    here = model.x + u
    assert abs(np.sum(here[:, 0] * force[:, 1] - here[:, 1] * force[:, 0])) < 1e-13 * size
    change = enclosed(u + 1e-3 * direction) - enclosed(u - 1e-3 * direction)  # quadratic: exact
    assert np.sum(force * direction) == pytest.approx(-pressure * change / 2e-3, rel=1e-10)


def test_surface_points_measure_lengths_and_reproduce_places(loaded):
    body = loaded.bodies[0]
    chosen = np.arange(len(body.mesh.segments.ends))
    points = surface_points(body, chosen)
    ends = body.mesh.segments.ends
    assert points.length.sum() == pytest.approx(body.regions[0].outer.lengths.sum(), rel=1e-6)  # lattice
    np.testing.assert_allclose(points.shape.sum(axis=1), 1.0, atol=1e-14)
    line = np.einsum("qi,qia->qa", points.slope, body.mesh.xy[points.nodes])
    np.testing.assert_allclose(line, np.repeat(0.5 * (ends[:, 1] - ends[:, 0]), 2, axis=0), atol=1e-14)
    place = np.einsum("qi,qia->qa", points.shape, body.mesh.xy[points.nodes]).reshape(-1, 2, 2).mean(axis=1)
    np.testing.assert_allclose(place, ends.mean(axis=1), atol=1e-14)


def test_dead_and_follower_pressure_agree_on_the_undeformed_body():
    tables = {"p": {"on": "part.outer", "pressure": 1.0}}
    follower = one_body(PLATE, cartesian(0.17), boundary=tables).model
    tables["p"]["follower"] = False
    dead = one_body(PLATE, cartesian(0.17), boundary=tables).model
    zero = np.zeros_like(dead.x)
    one, other = forces(follower, zero, [1e6]), forces(dead, zero, [1e6])
    np.testing.assert_allclose(one, other, atol=1e-10 * np.abs(one).max())
    moved = random_field(dead, 0.02)
    with_load, without = forces(dead, moved, [1e6]), forces(dead, moved, [0.0])
    np.testing.assert_allclose(with_load - without, other, atol=1e-6 * np.abs(other).max())  # dead: as before
