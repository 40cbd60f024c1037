"""The stable step of the deformed state, cheap enough for every sample of a run.

The largest eigenvalue of each element, known for the undeformed state (timestep.py), is taken to grow with that of
its stiffest integration point: of A(F) : (. G), with the tangent A = dP/dF and the metric G of the gradients,
the sum of g_I g_I^T. In the principal axes of F the tangent of an isotropic law is known in closed form,

    A_iijj = (dtau_i/dln l_j - tau_i d_ij)/(l_i l_j),  A_ijij = (tau_i - tau_j)/(l_i^2 - l_j^2),
    A_ijji = (l_j^2 tau_i - l_i^2 tau_j)/(l_i l_j (l_i^2 - l_j^2)),

the geometric stiffness included (R. W. Ogden, Non-Linear Elastic Deformations, 1984, section 6.1.4). Exact for one
square element in homogeneous deformation; for others an estimate to look at, not a guard. Penalty springs count as
all closed, viscosity as at the start.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.kernels import kernel
from phantomnode.solver.model import V_LAME, V_SHEAR, VOLUME, CutElements, Elements, Model, of_each_kind
from phantomnode.solver.q4 import as_points, displacement_gradient, element_gradient
from phantomnode.solver.timestep import contact_by_element, element_rates

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ITERATIONS = 12
"""Steps of the power method on four numbers: Rayleigh's quotient is then right to 1 % even in long cells."""


class Stiffness(NamedTuple):
    """What the stiffness of integration points was at the start, and that of the elements that they belong to.

    metric (p, 3) G11, G22, G12, 1/m^2; start (p,) largest eigenvalue undeformed, Pa/m^2; widest (p,) the bound
    2 (lambda + mu) |G| on it, over it; frequency2 (e,) and contact2 (e,) of the elements and of the penalty springs
    at them, 1/s^2; viscosity (e,), 1/s.
    """

    metric: Floats
    start: Floats
    widest: Floats
    frequency2: Floats
    contact2: Floats
    viscosity: Floats


class StepMonitor:
    """The stable step at any displacement.

    Parameters
    ----------
    model : Model
    speed : float, m/s
        As for :func:`phantomnode.solver.timestep.stable_step`.
    """

    def __init__(self, model: Model, speed: float = 0.0) -> None:
        frequency2, viscosity = element_rates(model, speed)
        rates = frequency2, contact_by_element(model), viscosity
        m = len(model.elements.kind)
        uncut, cut = ([rate[part] for rate in rates] for part in (slice(m), slice(m, None)))
        self._points = [(model.cut_elements, stiffness_at_start(model.cut_elements, *cut))]
        self._elements: tuple[Elements, Stiffness] | None = None
        if len(model.full.weight):
            self._points.append((model.full, stiffness_at_start(model.full, *uncut)))
        else:
            kinds = as_points(of_each_kind(model.elements))
            self._elements = model.elements, stiffness_at_start(kinds, *uncut)
        self._last: tuple[Floats, float] | None = None

    def at(self, u: Floats) -> float:
        """The stable step at (n, 2) displacements, s; without a part that is kept for safety.

        Several who ask for one and the same array, which must not change in between, wait for it once.
        """
        if self._last is not None and self._last[0] is u:
            return self._last[1]
        fastest, u_now = 0.0, np.asfortranarray(u)
        if self._elements is not None:
            fastest = fastest_of_elements(*self._elements, u_now, fastest)
        for points, at_start in self._points:
            fastest = fastest_rate(points, at_start, u_now, fastest)
        self._last = u, 1.0 / fastest if fastest > 0.0 else math.inf
        return self._last[1]


def stiffness_at_start(
    points: CutElements, frequency2: Floats, contact2: Floats, viscosity: Floats
) -> Stiffness:
    """That of integration points; the rates are those of all elements that are made of them, in their order."""
    owner = np.repeat(np.arange(len(points.lame)), np.diff(points.first))
    g = np.einsum("pia,pib->pab", points.gradient, points.gradient)
    metric = np.ascontiguousarray(np.column_stack([g[:, 0, 0], g[:, 1, 1], g[:, 0, 1]]))
    moduli = points.lame[owner], points.shear[owner]
    start = undeformed_eigenvalues(*moduli, metric)
    longest = 0.5 * (metric[:, 0] + metric[:, 1]) + np.hypot(
        0.5 * (metric[:, 0] - metric[:, 1]), metric[:, 2]
    )
    bound = 2.0 * (moduli[0] + moduli[1]) * longest
    rates = (np.ascontiguousarray(rate) for rate in (frequency2, contact2, viscosity))
    return Stiffness(metric, start, bound / start, *rates)


@kernel
def undeformed_eigenvalues(lame: Floats, shear: Floats, metric: Floats) -> Floats:
    """(p,) Of :func:`tangent_eigenvalue` without displacement, Pa/m^2; metric (p, 3)."""
    found = np.empty(len(lame))
    for p in range(len(lame)):
        g11, g22, g12 = metric[p, 0], metric[p, 1], metric[p, 2]
        found[p] = tangent_eigenvalue(0.0, 0.0, 0.0, 0.0, lame[p], shear[p], g11, g22, g12)
    return found


@kernel
def fastest_rate(points: CutElements, stiffness: Stiffness, u: Floats, fastest: float) -> float:
    """The largest 1/dt of these elements and of what was found before, 1/s; infinite where J <= 0."""
    for e in range(len(points.lame)):
        for p in range(points.first[e], points.first[e + 1]):
            h = displacement_gradient(points.nodes[e], points.gradient[p], u)
            fastest = faster(h, points.lame[e], points.shear[e], stiffness, p, e, fastest)
    return fastest


@kernel
def fastest_of_elements(elements: Elements, stiffness: Stiffness, u: Floats, fastest: float) -> float:
    """The same of uncut elements, whose points are those of their kinds."""
    c = elements.constants
    for e in range(len(elements.kind)):
        k = elements.kind[e]
        h = element_gradient(elements, e, u)
        fastest = faster(
            h, c[V_LAME, k] / c[VOLUME, k], c[V_SHEAR, k] / c[VOLUME, k], stiffness, k, e, fastest
        )
    return fastest


@kernel(inline="always")
def faster(
    h: tuple[float, float, float, float], lame: float, shear: float,
    stiffness: Stiffness, p: int, e: int, fastest: float,
) -> float:  # fmt: skip
    """The larger one of a rate and that of point p of element e at H = F - I, 1/s."""
    h11, h12, h21, h22 = h
    frequency2, contact2, viscosity = stiffness.frequency2[e], stiffness.contact2[e], stiffness.viscosity[e]
    growth = stiffness.widest[p] * largest_growth(h11, h12, h21, h22)
    if step_rate(growth * frequency2 + contact2, viscosity) <= fastest:
        return fastest  # most points: what follows costs ten times as much
    g11, g22, g12 = stiffness.metric[p, 0], stiffness.metric[p, 1], stiffness.metric[p, 2]
    growth = tangent_eigenvalue(h11, h12, h21, h22, lame, shear, g11, g22, g12) / stiffness.start[p]
    return max(fastest, step_rate(growth * frequency2 + contact2, viscosity))


@kernel
def step_rate(frequency2: float, viscosity: float) -> float:
    """1/dt of the step at which dt^2 w^2/4 + dt c/2 = 1, 1/s."""
    return 0.25 * (viscosity + math.sqrt(viscosity * viscosity + 4.0 * frequency2))


@kernel
def largest_growth(h11: float, h12: float, h21: float, h22: float) -> float:
    """Bound on the largest eigenvalue of A over 2 (lambda + mu), from the smaller stretch l alone.

    By row sums, with -tau_i <= -2 (lambda + mu) ln l and J >= l^2: (1 - ln l)/l^2 <= 1/l^3 below 1; beyond,
    where a tension of ln J/J counts in A_ijji, (1 + 2 ln l)/l^2.
    """
    c11 = (1.0 + h11) * (1.0 + h11) + h21 * h21
    c22 = (1.0 + h22) * (1.0 + h22) + h12 * h12
    c12 = (1.0 + h11) * h12 + h21 * (1.0 + h22)
    j = (1.0 + h11) * (1.0 + h22) - h12 * h21
    if not j > 0.0:
        return math.inf
    larger = 0.5 * (c11 + c22) + math.sqrt(0.25 * (c11 - c22) * (c11 - c22) + c12 * c12)
    smaller = j * j / larger
    return 1.0 / (smaller * math.sqrt(smaller)) if smaller < 1.0 else (1.0 + math.log(smaller)) / smaller


@kernel
def principal_tangent(
    larger: float, smaller: float, j: float, lame: float, shear: float
) -> tuple[float, float, float, float, float]:
    """A1111, A2222, A1122, A1212 = A2121 and A1221 of the Hencky law from the squares of the stretches and J, Pa."""
    log_j, difference = math.log(j), larger - smaller
    tau1 = lame * log_j + shear * math.log(larger)
    tau2 = lame * log_j + shear * math.log(smaller)
    a11, a22 = (lame + 2.0 * shear - tau1) / larger, (lame + 2.0 * shear - tau2) / smaller
    # tau1 - tau2 = mu ln(l1^2/l2^2): no digit is lost where the stretches are nearly equal.
    same = shear * math.log1p(difference / smaller) / difference if difference > 0.0 else shear / smaller
    return a11, a22, lame / j, same, (smaller * same - tau2) / j


@kernel
def tangent_eigenvalue(
    h11: float, h12: float, h21: float, h22: float,
    lame: float, shear: float, g11: float, g22: float, g12: float,
) -> float:  # fmt: skip
    """Largest eigenvalue of X -> A : (X G), Pa/m^2, at H = F - I; infinite where J <= 0.

    By the power method; Rayleigh's quotient is that of the product X . (Y G), in which the map is symmetric.
    """
    c11 = (1.0 + h11) * (1.0 + h11) + h21 * h21
    c22 = (1.0 + h22) * (1.0 + h22) + h12 * h12
    c12 = (1.0 + h11) * h12 + h21 * (1.0 + h22)
    j = (1.0 + h11) * (1.0 + h22) - h12 * h21
    if not j > 0.0:
        return math.inf
    half = 0.5 * (c11 - c22)
    radius = math.sqrt(half * half + c12 * c12)
    larger = 0.5 * (c11 + c22) + radius
    a11, a22, a12, same, cross = principal_tangent(larger, j * j / larger, j, lame, shear)
    # G in the principal axes of C, turned by half the angle of (half, c12).
    cos2, sin2 = (half / radius, c12 / radius) if radius > 0.0 else (1.0, 0.0)
    middle, split = 0.5 * (g11 + g22), 0.5 * (g11 - g22)
    along, g3 = split * cos2 + g12 * sin2, g12 * cos2 - split * sin2
    g1, g2 = middle + along, middle - along
    x11, x22, x12, x21, value = 1.0, 0.8, 0.4, 0.3, 0.0
    for _ in range(ITERATIONS):
        t11, t12 = x11 * g1 + x12 * g3, x11 * g3 + x12 * g2
        t21, t22 = x21 * g1 + x22 * g3, x21 * g3 + x22 * g2
        p11, p22 = a11 * t11 + a12 * t22, a12 * t11 + a22 * t22
        p12, p21 = same * t12 + cross * t21, cross * t12 + same * t21
        value = (t11 * p11 + t22 * p22 + t12 * p12 + t21 * p21) / (
            t11 * x11 + t22 * x22 + t12 * x12 + t21 * x21
        )
        size = math.sqrt(p11 * p11 + p22 * p22 + p12 * p12 + p21 * p21)
        x11, x22, x12, x21 = p11 / size, p22 / size, p12 / size, p21 / size
    return value
