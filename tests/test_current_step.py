"""The stable step of deformed states: exact for a square element, equal to the estimate where undeformed."""

from __future__ import annotations

import numpy as np
import pytest
from statics import one_body

from phantomnode.solver.current_step import StepMonitor, largest_growth, principal_tangent, tangent_eigenvalue
from phantomnode.solver.hencky import first_piola
from phantomnode.solver.timestep import stable_step

LAME, SHEAR = 5.769230769e9, 3.846153846e9

DEFORMED = {
    "none": (0.0, 0.0, 0.0, 0.0),
    "compressed": (-0.3, 0.0, 0.0, -0.1),
    "stretched": (0.5, 0.0, 0.0, -0.2),
    "sheared": (0.0, 0.8, 0.0, 0.0),
    "equally stretched": (0.2, 0.0, 0.0, 0.2),
    "turned by 90 degrees": (-1.0, -1.0, 1.0, -1.0),
    "crushed and turned": (-0.6, -0.5, 0.3, -0.4),
}


def tangent(h):
    """(4, 4) dP/dF in the order 11, 12, 21, 22, by central differences of the law."""
    rows = []
    for unit in np.eye(4):
        ahead, back = (first_piola(*(np.array(h) + s * 1e-6 * unit), LAME, SHEAR) for s in (1.0, -1.0))
        rows.append((np.array(ahead) - back) / 2e-6)
    return np.array(rows).T


def largest_eigenvalue(h, metric):
    """Of X -> A : (X G) as a matrix."""
    g = np.array([[metric[0], metric[2]], [metric[2], metric[1]]])
    return float(np.max(np.linalg.eigvals(tangent(h) @ np.kron(np.eye(2), g)).real))


@pytest.mark.parametrize("kind", DEFORMED)
def test_tangent_eigenvalue_agrees_with_the_law_differentiated(kind):
    h = DEFORMED[kind]
    for metric in ((1.0, 1.0, 0.0), (3.0, 1.0, 0.7)):
        expected = largest_eigenvalue(h, metric)
        found = tangent_eigenvalue(*h, LAME, SHEAR, *metric)
        assert found == pytest.approx(expected, rel=2e-3) and found <= expected * (1 + 1e-6)


def test_rotation_changes_nothing_and_inversion_is_told():
    c, s = np.cos(0.7), np.sin(0.7)
    f = np.array([[0.8, 0.3], [-0.1, 1.2]])
    turned = np.array([[c, -s], [s, c]]) @ f
    one, other = (
        tangent_eigenvalue(*(a - np.eye(2)).ravel(), LAME, SHEAR, 2.0, 1.0, 0.3) for a in (f, turned)
    )
    assert one == pytest.approx(other, rel=1e-12)
    assert np.isinf(tangent_eigenvalue(-2.0, 0.0, 0.0, 0.0, LAME, SHEAR, 1.0, 1.0, 0.0))
    assert np.isinf(largest_growth(-1.0, 0.0, 0.0, 0.0))


def test_equal_stretches_are_the_limit_of_unequal_ones():
    at = principal_tangent(1.3, 1.3, 1.3, LAME, SHEAR)
    near = principal_tangent(1.3, 1.3 * (1 - 1e-5), 1.3 * np.sqrt(1 - 1e-5), LAME, SHEAR)
    np.testing.assert_allclose(near, at, atol=2e-5 * (LAME + 2 * SHEAR))  # squares differ by 1e-5


def test_the_quick_bound_is_never_below_the_eigenvalue():
    random = np.random.default_rng(1)
    for _ in range(2000):
        f = np.eye(2) + random.uniform(-1.0, 1.0, (2, 2)) * random.uniform(0.0, 2.0)
        if np.linalg.det(f) < 0.05:
            continue
        h = (f - np.eye(2)).ravel()
        bound = 2.0 * (LAME + SHEAR) * largest_growth(*h)
        assert tangent_eigenvalue(*h, LAME, SHEAR, 1.0, 1.0, 0.0) <= bound * (1 + 1e-12)


@pytest.mark.parametrize("relocation", [0.0, 0.1])
def test_the_undeformed_step_is_the_estimate(relocation):
    case = one_body(
        {"circle": {"centre": [0.013, 0.007], "radius": 0.5}},
        {"kind": "cartesian", "cell": [0.09, 0.13]},
        relocation={"distance": relocation},
        boundary={"hold": {"on": "part.outer", "displacement": {"x": 0.0}}},
    )
    limit = stable_step(case.model, safety=1.0).dt
    assert StepMonitor(case.model).at(0.0 * case.model.x) == pytest.approx(limit, rel=1e-12)
    assert case.stable_step(0.0 * case.model.x) == pytest.approx(limit, rel=1e-12)


@pytest.mark.parametrize("kind", DEFORMED)
def test_square_elements_in_homogeneous_deformation(kind):
    """dt^2 = 4/w^2 with w^2 = 4 |A(F)|/(rho h^2): the whole of G = I/h^2 and a quarter of the mass."""
    case = one_body(
        {"rectangle": {"low": [0.0, 0.0], "high": [1.0, 0.5]}},
        {"kind": "cartesian", "cell": 0.25, "aligned": True},
        hourglass=0.0,
    )
    gradient = np.array(DEFORMED[kind]).reshape(2, 2)
    eigenvalue = largest_eigenvalue(DEFORMED[kind], (1.0, 1.0, 0.0)) / 0.25**2
    expected = 2.0 / np.sqrt(4.0 * eigenvalue / 7800.0)
    assert case.stable_step(case.model.x @ gradient.T) == pytest.approx(expected, rel=1e-3)


def test_the_element_that_is_crushed_sets_the_step():
    case = one_body(
        {"rectangle": {"low": [0.0, 0.0], "high": [1.0, 0.5]}},
        {"kind": "cartesian", "cell": 0.25, "aligned": True},
    )
    u = np.zeros_like(case.model.x)
    steps = []
    for crush in (0.0, 0.05, 0.1, 0.2):
        u[np.isclose(case.model.x[:, 0], 1.0), 0] = -crush
        steps.append(case.stable_step(u.copy()))
    assert np.all(np.diff(steps) < 0.0)
    u[np.isclose(case.model.x[:, 0], 1.0), 0] = -0.3
    assert case.stable_step(u) == 0.0  # turned inside out
