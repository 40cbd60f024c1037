"""The Hencky law in closed form: Kirchhoff stress and energy from the displacement gradient, plane strain.

W = lambda/2 (ln J)^2 + mu |ln V|^2, with B = F F^T = V^2, gives tau = lambda ln J I + mu ln B. In the plane
ln B = ln J I + (atanh(s/m)/s) dev B with m = tr(B)/2 and s = sqrt(m^2 - J^2) = |dev B|, so no eigenvectors
are needed. By the half-angle formula s/(m + J) = tanh(atanh(s/m)/2), and with y = s^2/(m + J)^2,
z = (J - 1)/(J + 1)

    ln B = ln J I + [2/(m + J)] S(y) dev B,    ln J = 2 z S(z^2),
    S(y) = atanh(sqrt y)/sqrt y = sum y^k/(2k + 1).

The paper's Taylor series of ln B (section 2.1) diverges once an eigenvalue of B exceeds 2; this form is
exact for every J > 0. B - I is formed from the displacement gradient H = F - I, so that small strains lose
no digits.
"""

from __future__ import annotations

import math

from phantomnode.kernels import kernel

SERIES_LIMIT = 0.09
"""Up to here the series of S is summed: its rest, y^13/27/(1 - y), is below 2e-15."""


@kernel(inline="always")
def atanh_series(y: float) -> float:
    """S(y) = atanh(sqrt y)/sqrt y for 0 <= y <= SERIES_LIMIT, without a logarithm or a square root."""
    y2 = y * y
    y4 = y2 * y2
    low = (1.0 + y * (1.0 / 3.0)) + y2 * (1.0 / 5.0 + y * (1.0 / 7.0))
    middle = (1.0 / 9.0 + y * (1.0 / 11.0)) + y2 * (1.0 / 13.0 + y * (1.0 / 15.0))
    high = (1.0 / 17.0 + y * (1.0 / 19.0)) + y2 * ((1.0 / 21.0 + y * (1.0 / 23.0)) + y2 * (1.0 / 25.0))
    return low + y4 * (middle + y4 * high)


@kernel(inline="always")
def strain_measures(
    h11: float, h12: float, h21: float, h22: float
) -> tuple[float, float, float, float, float, float]:
    """What ln B is made of: (B11 - B22)/2, B12, 1/(m + J), y, z and J - 1, from H = F - I."""
    # B - I, term by term, and J - 1: nothing of order one is subtracted.
    b11 = 2.0 * h11 + h11 * h11 + h12 * h12
    b22 = 2.0 * h22 + h21 * h21 + h22 * h22
    b12 = h12 + h21 + h11 * h21 + h12 * h22
    j1 = h11 + h22 + (h11 * h22 - h12 * h21)
    half = 0.5 * (b11 - b22)
    inverse = 1.0 / (2.0 + 0.5 * (b11 + b22) + j1)
    y = (half * half + b12 * b12) * (inverse * inverse)
    return half, b12, inverse, y, j1 / (2.0 + j1), j1


@kernel
def logarithm(h11: float, h12: float, h21: float, h22: float) -> tuple[float, float, float, float]:
    """Logarithm of B = F F^T from the displacement gradient H = F - I.

    Returns
    -------
    log_j, d, c12, j : float
        ln B = log_j I + [[d, c12], [c12, -d]]; and J = det F. All but J are NaN or infinite where J <= 0.
    """
    half, b12, inverse, y, z, j1 = strain_measures(h11, h12, h21, h22)
    j = (1.0 + h11) * (1.0 + h22) - h12 * h21  # 1 + j1 would lose the digits of a small one
    if y <= SERIES_LIMIT and z * z <= SERIES_LIMIT:
        log_j = 2.0 * z * atanh_series(z * z)
        factor = 2.0 * atanh_series(y) * inverse
    elif j > 0.0:
        root = math.sqrt(y)
        log_j = math.log1p(j1) if j1 > -0.5 else math.log(j)
        factor = 2.0 * (math.atanh(root) / root if root > 0.0 else 1.0) * inverse
    else:
        log_j, factor = math.nan, math.nan
    return log_j, factor * half, factor * b12, j


@kernel
def kirchhoff(
    h11: float, h12: float, h21: float, h22: float, lame: float, shear: float
) -> tuple[float, float, float, float]:
    """Kirchhoff stress tau = lambda ln J I + mu ln B (Eq. 5) from the displacement gradient.

    Parameters
    ----------
    h11, h12, h21, h22 : float
        H = F - I, that is du_i/dX_j.
    lame, shear : float, Pa
        lambda and mu.

    Returns
    -------
    tau11, tau22, tau12 : float, Pa
        Out of the plane tau33 = lambda ln J.
    j : float
        det F; the stress is NaN where it is not positive.
    """
    log_j, d, c12, j = logarithm(h11, h12, h21, h22)
    mean = (lame + shear) * log_j
    return mean + shear * d, mean - shear * d, shear * c12, j


@kernel
def energy_density(h11: float, h12: float, h21: float, h22: float, lame: float, shear: float) -> float:
    """Stored energy W = lambda/2 (ln J)^2 + mu |ln V|^2 per reference volume, J/m^3."""
    log_j, d, c12, _ = logarithm(h11, h12, h21, h22)
    return 0.5 * (lame + shear) * log_j * log_j + 0.5 * shear * (d * d + c12 * c12)


@kernel
def hencky_strain(h11: float, h12: float, h21: float, h22: float) -> tuple[float, float, float]:
    """Hencky strain ln V = (ln B)/2: its components 11, 22, 12 (Eq. 4)."""
    log_j, d, c12, _ = logarithm(h11, h12, h21, h22)
    return 0.5 * (log_j + d), 0.5 * (log_j - d), 0.5 * c12


@kernel
def cauchy(
    h11: float, h12: float, h21: float, h22: float, lame: float, shear: float
) -> tuple[float, float, float, float]:
    """Cauchy stress sigma = tau/J, Pa: its components 11, 22, 33, 12."""
    log_j, d, c12, j = logarithm(h11, h12, h21, h22)
    mean = (lame + shear) * log_j
    return (mean + shear * d) / j, (mean - shear * d) / j, lame * log_j / j, shear * c12 / j


@kernel(inline="always")
def pull_back(
    t11: float, t22: float, t12: float, h11: float, h12: float, h21: float, h22: float, j: float
) -> tuple[float, float, float, float]:
    """P = tau F^-T: P11, P12, P21, P22, in the unit of tau."""
    f11, f22, inverse = 1.0 + h11, 1.0 + h22, 1.0 / j
    return (
        (t11 * f22 - t12 * h12) * inverse,
        (t12 * f11 - t11 * h21) * inverse,
        (t12 * f22 - t22 * h12) * inverse,
        (t22 * f11 - t12 * h21) * inverse,
    )


@kernel
def first_piola(
    h11: float, h12: float, h21: float, h22: float, lame: float, shear: float
) -> tuple[float, float, float, float]:
    """First Piola-Kirchhoff stress P = tau F^-T, Pa: P11, P12, P21, P22."""
    t11, t22, t12, j = kirchhoff(h11, h12, h21, h22, lame, shear)
    return pull_back(t11, t22, t12, h11, h12, h21, h22, j)
