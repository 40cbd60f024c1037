"""The stable step of deformed states: exact for a square element, equal to the estimate where undeformed."""

from __future__ import annotations

from decimal import Decimal, localcontext

import numpy as np
import pytest
from statics import one_body
from test_elements import grid

from phantomnode.solver.current_step import (
    ITERATIONS,
    StepMonitor,
    Stiffness,
    fastest_of_elements,
    fastest_rate,
    largest_growth,
    principal_tangent,
    step_rate,
    stiffness_at_start,
    tangent_eigenvalue,
    undeformed_eigenvalues,
)
from phantomnode.solver.hencky import first_piola
from phantomnode.solver.kinds import shared_kinds
from phantomnode.solver.model import CutElements, of_each_kind
from phantomnode.solver.q4 import as_points, one_point_elements
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


def twin_tangent(larger, smaller, j):
    """A1111, A2222, A1122, A1212, A1221 with 50 digits, by the quotients of the module's docstring."""
    with localcontext(prec=50):
        first, second, j, lame, shear = (Decimal(float(value)) for value in (larger, smaller, j, LAME, SHEAR))
        one, two = (lame * j.ln() + shear * square.ln() for square in (first, second))
        wave = lame + 2 * shear
        across = shear / first, (shear - one) / j
        if first != second:
            across = (one - two) / (first - second), (second * one - first * two) / (j * (first - second))
        return [float(a) for a in ((wave - one) / first, (wave - two) / second, lame / j, *across)]


@pytest.mark.twin("current_step.principal_tangent")
@pytest.mark.parametrize("apart", [0.0, 1e-15, 1e-12, 1e-8, 1e-5, 1e-3, 0.1, 1.0, 30.0])
def test_tangent_in_principal_axes_agrees_with_fifty_digits(apart):
    """Also where the stretches nearly agree, and their quotient would lose all digits of a double."""
    for smaller in (0.2, 1.0, 1.7):
        larger = smaller * (1.0 + apart)
        j = np.sqrt(larger * smaller)
        expected = twin_tangent(larger, smaller, j)
        scale = np.abs(expected).max()  # of the largest: some of them are differences
        np.testing.assert_allclose(
            principal_tangent(larger, smaller, j, LAME, SHEAR), expected, rtol=0, atol=1e-13 * scale
        )


def twin_eigenvalue(h, metric):
    """The power method of as many steps on the matrix of X -> A : (X G) in principal axes."""
    f = np.eye(2) + np.reshape(h, (2, 2))
    c = f.T @ f
    angle = 0.5 * np.arctan2(2.0 * c[0, 1], c[0, 0] - c[1, 1])
    axes = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    g = axes.T @ np.array([[metric[0], metric[2]], [metric[2], metric[1]]]) @ axes
    larger, j = axes[:, 0] @ c @ axes[:, 0], np.linalg.det(f)
    a11, a22, a12, same, cross = twin_tangent(larger, j * j / larger, j)
    a = np.array([[a11, 0, 0, a12], [0, same, cross, 0], [0, cross, same, 0], [a12, 0, 0, a22]])
    times_g, x = np.kron(np.eye(2), g), np.array([1.0, 0.4, 0.3, 0.8])
    for _ in range(ITERATIONS):
        t = times_g @ x
        value = t @ a @ t / (t @ x)
        x = a @ t / np.linalg.norm(a @ t)
    return value


@pytest.mark.twin("current_step.tangent_eigenvalue")
@pytest.mark.parametrize("kind", DEFORMED)
def test_tangent_eigenvalue_agrees_with_the_numpy_twin(kind):
    h = DEFORMED[kind]
    for metric in ((1.0, 1.0, 0.0), (3.0, 1.0, 0.7)):
        found = tangent_eigenvalue(*h, LAME, SHEAR, *metric)
        assert found == pytest.approx(twin_eigenvalue(h, metric), rel=1e-13)


@pytest.mark.twin("current_step.undeformed_eigenvalues")
def test_eigenvalues_without_displacement_agree_with_the_numpy_twin():
    metric = np.array([(1.0, 1.0, 0.0), (3.0, 1.0, 0.7)])
    found = undeformed_eigenvalues(np.full(2, LAME), np.full(2, SHEAR), metric)
    np.testing.assert_allclose(found, [twin_eigenvalue(np.zeros(4), row) for row in metric], rtol=1e-13)


@pytest.mark.twin("current_step.largest_growth", "current_step.step_rate")
def test_the_quick_bound_and_the_rate_agree_with_numpy():
    for h in DEFORMED.values():
        least = np.linalg.svd(np.eye(2) + np.reshape(h, (2, 2)))[1].min()
        growth = least**-3.0 if least < 1.0 else (1.0 + 2.0 * np.log(least)) / least**2
        assert largest_growth(*h) == pytest.approx(growth, rel=1e-13)
    for frequency2, viscosity in ((4.0, 0.0), (4.0, 3.0), (1e12, 1e7)):
        roots = np.roots([0.25 * frequency2, 0.5 * viscosity, -1.0])
        assert step_rate(frequency2, viscosity) == pytest.approx(1.0 / roots.max(), rel=1e-13)


@pytest.mark.twin("current_step.fastest_rate")
def test_the_fastest_of_some_elements_agrees_with_numpy():
    """Elements of one to three points; what is quick to rule out is ruled out."""
    rng = np.random.default_rng(3)
    nodes, first = np.array([[0, 1, 2, 3], [1, 4, 5, 2], [4, 6, 7, 5]]), np.array([0, 1, 4, 6])
    gradient, owner = rng.normal(size=(6, 4, 2)), np.repeat([0, 1, 2], [1, 3, 2])
    metric = np.einsum("pia,pib->pab", gradient, gradient)
    metric = np.ascontiguousarray(metric[:, [0, 1, 0], [0, 1, 1]])
    start = np.array([twin_eigenvalue(np.zeros(4), row) for row in metric])
    widest = 2.0 * (LAME + SHEAR) * np.trace(np.einsum("pia,pib->pab", gradient, gradient), axis1=1, axis2=2)
    frequency2, contact2, viscosity = rng.uniform(1, 2, (3, 3))
    moduli = np.full(3, LAME), np.full(3, SHEAR)
    points = CutElements(nodes.astype(np.uint32), first, gradient, np.ones(6), *moduli, np.ones(3))
    stiffness = Stiffness(metric, start, widest / start, frequency2, contact2, viscosity)
    for size in (0.0, 0.05, 0.1):
        u = size * rng.uniform(-1, 1, (8, 2))
        h = np.einsum("pia,pib->pab", u[nodes[owner]], gradient).reshape(-1, 4)
        growth = np.array([twin_eigenvalue(*of) for of in zip(h, metric, strict=True)]) / start
        square, slowing = (growth * frequency2[owner] + contact2[owner]), viscosity[owner]
        rates = 0.25 * (slowing + np.sqrt(slowing**2 + 4.0 * square))
        assert fastest_rate(points, stiffness, u, 0.0) == pytest.approx(rates.max(), rel=1e-13)
        assert fastest_rate(points, stiffness, u, 99.0) == 99.0


@pytest.mark.twin("current_step.faster", "current_step.fastest_of_elements")
def test_uncut_elements_are_as_fast_as_their_points():
    """The same elements of two kinds and of one each, and as integration points."""
    x, quads = grid(6, 5, 0.2)
    x[:14] = grid(6, 1)[0]
    own = one_point_elements(quads, x[quads], LAME, SHEAR, 1.0)
    shared = shared_kinds(own, x)
    assert shared.constants.shape[1] == 1 + 24
    rates = np.random.default_rng(4).uniform(1, 2, (3, 30))
    u = 0.05 * np.random.default_rng(5).uniform(-1, 1, x.shape)
    points = as_points(own)
    expected = fastest_rate(points, stiffness_at_start(points, *rates), u, 0.0)
    for elements in (own, shared):
        stiffness = stiffness_at_start(as_points(of_each_kind(elements)), *rates)
        assert fastest_of_elements(elements, stiffness, u, 0.0) == pytest.approx(expected, rel=1e-12)
        assert fastest_of_elements(elements, stiffness, u, 99.0) == 99.0


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
