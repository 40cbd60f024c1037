"""The Hencky law: closed forms, an eigenvalue twin, accuracy over the whole range, and its own gradient."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

from phantomnode.solver.hencky import (
    SERIES_LIMIT,
    atanh_series,
    cauchy,
    energy_density,
    first_piola,
    hencky_strain,
    kirchhoff,
    logarithm,
    pull_back,
    strain_measures,
)

YOUNG, NU = 1e10, 0.3
LAME = YOUNG * NU / ((1 + NU) * (1 - 2 * NU))
SHEAR = YOUNG / (2 * (1 + NU))
EPS = np.finfo(float).eps


def rotation(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s], [s, c]])


def h_of(f):
    """The displacement gradient as the four numbers that the kernels take."""
    return tuple((np.asarray(f) - np.eye(2)).ravel().tolist())


def twin_log(f):
    """ln B by eigenvalues and eigenvectors, with NumPy alone."""
    values, vectors = np.linalg.eigh(f @ f.T)
    return vectors @ np.diag(np.log(values)) @ vectors.T


def test_uniaxial_plane_strain_with_free_side():
    # Closed forms given to seven digits, hence 1e-7.
    for stretch, stress, side in (
        (1.5, 3.534179e9, 0.8404896),
        (2.0, 5.125862e9, 0.7429971),
        (3.0, 6.444101e9, 0.6244813),
    ):
        s11, s22, _, s12 = cauchy(*h_of(np.diag([stretch, side])), LAME, SHEAR)
        assert s11 == pytest.approx(stress, rel=2e-7)
        assert abs(s22) < 2e-7 * stress and s12 == 0.0


def test_confined_stretch_and_simple_shear():
    s11, s22, s33, _ = cauchy(*h_of(np.diag([1.5, 1.0])), LAME, SHEAR)
    assert (s11, s22, s33) == pytest.approx((3.638789e9, 1.559481e9, 1.559481e9), rel=2e-7)
    s11, _, _, s12 = cauchy(0.0, 1.0, 0.0, 0.0, LAME, SHEAR)
    assert (s12, s11) == pytest.approx((3.310838e9, 1.655419e9), rel=2e-7)
    s11, _, _, s12 = cauchy(0.0, 2.0, 0.0, 0.0, LAME, SHEAR)
    assert (s12, s11) == pytest.approx((4.794040e9, 4.794040e9), rel=2e-7)


@pytest.mark.parametrize("angle", [0.1, 0.5 * np.pi, 2.0, np.pi, 4.0, 6.0])
def test_rotation_gives_no_stress(angle):
    # The entries of the rotation are rounded to EPS/2, so the strain cannot be less than a few of them.
    assert max(np.abs(cauchy(*h_of(rotation(angle)), LAME, SHEAR))) < 4 * EPS * YOUNG


@pytest.mark.twin("hencky.atanh_series")
def test_the_series_of_atanh():
    for y in np.linspace(0.0, SERIES_LIMIT, 50)[1:]:
        root = np.sqrt(np.longdouble(y))
        assert atanh_series(y) == pytest.approx(float(np.arctanh(root) / root), rel=1e-13)
    assert atanh_series(0.0) == 1.0


@pytest.mark.twin("hencky.strain_measures", "hencky.pull_back")
def test_strain_measures_and_the_pull_back():
    """From the smallest to large strains, each relative to itself; the reference in fractions, without rounding."""
    rng = np.random.default_rng(9)
    for size in (1e-15, 1e-12, 1e-8, 1e-4, 0.3):
        h = size * rng.uniform(-1, 1, 4)
        f11, f12, f21, f22 = (
            Fraction(i) + Fraction(entry) for i, entry in zip((1, 0, 0, 1), h.tolist(), strict=True)
        )
        j, b11, b22, b12 = f11 * f22 - f12 * f21, f11**2 + f12**2, f21**2 + f22**2, f11 * f21 + f12 * f22
        half, m = (b11 - b22) / 2, (b11 + b22) / 2
        y, z = (half**2 + b12**2) / (m + j) ** 2, (j - 1) / (j + 1)
        expected = [float(v) for v in (half, b12, 1 / (m + j), y, z, j - 1)]
        assert strain_measures(*h) == pytest.approx(expected, rel=1e-13, abs=0.0)
        tau = rng.normal(size=(2, 2))
        tau += tau.T
        piola = pull_back(tau[0, 0], tau[1, 1], tau[0, 1], *h, float(j))
        np.testing.assert_allclose(
            np.reshape(piola, (2, 2)),
            tau @ np.linalg.inv(np.eye(2) + h.reshape(2, 2)).T,
            rtol=0,
            atol=1e-13 * np.abs(tau).max(),
        )


def extended(h):
    """F of the rounded H in extended precision."""
    return np.eye(2, dtype=np.longdouble) + np.reshape(h, (2, 2))


def extended_log(h):
    """ln B in extended precision from the rounded H itself: the angle of the axes, both eigenvalues without loss."""
    f = extended(h)
    b, j = f @ f.T, f[0, 0] * f[1, 1] - f[0, 1] * f[1, 0]
    angle = 0.5 * np.arctan2(2 * b[0, 1], b[0, 0] - b[1, 1])
    axes = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    large = axes[:, 0] @ b @ axes[:, 0]
    return axes @ np.diag(np.log([large, j * j / large])) @ axes.T


@pytest.mark.twin("hencky.logarithm")
def test_logarithm_from_tiny_to_huge_strains():
    """Eigenvalues of B from 1e-3 to 1e3, in any direction, rotated as well: 1e-13 of the largest component."""
    rng = np.random.default_rng(3)
    for _ in range(500):
        stretch = np.exp(0.5 * np.log(1e3) * rng.uniform(-1, 1, 2))
        axes, turn = rotation(rng.uniform(0, 7)), rotation(rng.uniform(0, 7))
        f = axes @ np.diag(stretch) @ axes.T @ turn
        exact = axes @ np.diag(2 * np.log(stretch)) @ axes.T
        log_j, d, c12, j = logarithm(*h_of(f))
        got = np.array([[log_j + d, c12], [c12, log_j - d]])
        assert np.abs(got - extended_log(h_of(f))).max() < 1e-13 * np.abs(exact).max()
        # Rounding of F itself moves a small eigenvalue by up to EPS times the condition of F (1e3 at most).
        assert np.abs(got - exact).max() < 1e-12 * max(1.0, np.abs(exact).max())
        # J to the products whose difference it is, up to 1e3 of it: an ulp of H moves it by as much.
        f = extended(h_of(f))
        products = f[0, 0] * f[1, 1], f[0, 1] * f[1, 0]
        assert abs(j - (products[0] - products[1])) < 1e-13 * np.abs(products).sum()


def test_small_strains_lose_no_digits():
    for strain in (1e-3, 1e-6, 1e-10, 1e-14):
        log_j, d, _, _ = logarithm(strain, 0.0, 0.0, 0.0)
        assert log_j + d == pytest.approx(2.0 * math.log1p(strain), rel=4 * EPS)
        # Infinitesimal shear: tau12 = 2 mu e12, to the order of the strain squared.
        assert kirchhoff(0.0, strain, 0.0, 0.0, LAME, SHEAR)[2] == pytest.approx(
            SHEAR * strain, rel=strain**2 + 4 * EPS
        )


def test_series_and_closed_form_agree_where_they_meet():
    """y = 0.09 at tanh(ln(stretch)) = 0.3 for an isochoric stretch; z^2 = 0.09 at J = 13/7."""
    for f in (np.diag([np.exp(np.arctanh(0.3)), np.exp(-np.arctanh(0.3))]), np.diag([13 / 7, 1.0])):
        below, above = f - 1e-9 * np.eye(2), f + 1e-9 * np.eye(2)
        jump = np.array(logarithm(*h_of(above))) - np.array(logarithm(*h_of(below)))
        slope = np.array(logarithm(*h_of(above + 1e-9 * np.eye(2)))) - np.array(logarithm(*h_of(above)))
        # Twice the step, so twice the difference; the rest of the series is below 2e-15.
        np.testing.assert_allclose(jump, 2 * slope, atol=1e-14)


@pytest.mark.twin(
    "hencky.kirchhoff", "hencky.first_piola", "hencky.hencky_strain", "hencky.cauchy", "hencky.energy_density"
)
def test_stress_agrees_with_the_eigenvalue_twin():
    rng = np.random.default_rng(5)
    for _ in range(200):
        f = np.eye(2) + 0.4 * rng.uniform(-1, 1, (2, 2))
        log_b, j = twin_log(f), np.linalg.det(f)
        tau = LAME * np.log(j) * np.eye(2) + SHEAR * log_b
        t11, t22, t12, _ = kirchhoff(*h_of(f), LAME, SHEAR)
        # Of E: eigh has EPS times the condition (about 100) of the worst sample.
        np.testing.assert_allclose([[t11, t12], [t12, t22]], tau, atol=1e-13 * YOUNG)
        np.testing.assert_allclose(
            np.reshape(first_piola(*h_of(f), LAME, SHEAR), (2, 2)),
            tau @ np.linalg.inv(f).T,
            atol=1e-13 * YOUNG,
        )
        np.testing.assert_allclose(hencky_strain(*h_of(f)), (0.5 * log_b)[[0, 1, 0], [0, 1, 1]], atol=1e-13)
        np.testing.assert_allclose(
            cauchy(*h_of(f), LAME, SHEAR),
            [tau[0, 0] / j, tau[1, 1] / j, LAME * np.log(j) / j, tau[0, 1] / j],
            atol=1e-13 * YOUNG / j,
        )
        energy = 0.5 * LAME * np.log(j) ** 2 + 0.25 * SHEAR * np.sum(log_b**2)
        assert energy_density(*h_of(f), LAME, SHEAR) == pytest.approx(energy, abs=1e-13 * YOUNG)


def test_piola_stress_is_the_gradient_of_the_energy():
    rng = np.random.default_rng(7)
    step = 1e-5
    for scale in (1e-4, 0.3, 0.6):
        f = np.eye(2) + scale * rng.uniform(-1, 1, (2, 2))
        numerical = np.zeros(4)
        for k in range(4):
            change = np.zeros(4)
            change[k] = step
            up, down = (energy_density(*(h_of(f) + sign * change), LAME, SHEAR) for sign in (1, -1))
            numerical[k] = (up - down) / (2 * step)
        # Central differences: step^2 times third derivatives (of order 10 E), and EPS W / step.
        np.testing.assert_allclose(first_piola(*h_of(f), LAME, SHEAR), numerical, atol=100 * step**2 * YOUNG)


def test_objectivity():
    f = np.array([[1.4, 0.5], [-0.2, 0.8]])
    turn = rotation(1.1)
    a, b = (kirchhoff(*h_of(g), LAME, SHEAR) for g in (f, turn @ f))
    tau, turned = (np.array([[t[0], t[2]], [t[2], t[1]]]) for t in (a, b))
    np.testing.assert_allclose(turned, turn @ tau @ turn.T, atol=20 * EPS * YOUNG)


@pytest.mark.parametrize("f", [np.diag([0.0, 1.0]), np.diag([-0.5, 1.0]), np.diag([-1.0, 3.0])])
def test_no_stress_is_made_up_for_an_inverted_point(f):
    t11, _, _, j = kirchhoff(*h_of(f), LAME, SHEAR)
    assert math.isnan(t11) and j <= 0.0
