"""The bilinear map of a four-node cell: shape functions, gradients, and its inverse.

Corners run counter-clockwise from (-1, -1); local coordinates (xi, eta) lie in [-1, 1].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.errors import GeometryError

Floats = NDArray[np.float64]

XI = np.array([-1.0, 1.0, 1.0, -1.0])
ETA = np.array([-1.0, -1.0, 1.0, 1.0])


def shape(local: Floats) -> Floats:
    """(k, 4) Shape functions N_I at (k, 2) local coordinates."""
    xi, eta = local[:, :1], local[:, 1:]
    return np.asarray(0.25 * (1.0 + XI * xi) * (1.0 + ETA * eta))


def local_gradients(local: Floats) -> Floats:
    """(k, 4, 2) Derivatives of N_I by (xi, eta) at (k, 2) local coordinates."""
    xi, eta = local[:, :1], local[:, 1:]
    return np.stack([0.25 * XI * (1.0 + ETA * eta), 0.25 * ETA * (1.0 + XI * xi)], axis=-1)


def gradients(corners: Floats, local: Floats) -> Floats:
    """(k, 4, 2) Derivatives of N_I by (x, y), 1/m, in cells of (k, 4, 2) corners at (k, 2) local points."""
    by_local = local_gradients(local)
    jacobian = np.einsum("kia,kib->kab", by_local, corners)  # d x_b / d xi_a
    return np.asarray(np.linalg.solve(jacobian, by_local.transpose(0, 2, 1)).transpose(0, 2, 1))


def to_global(corners: Floats, local: Floats) -> Floats:
    """(k, 2) Points at (k, 2) local coordinates of cells with (k, 4, 2) corners, metres."""
    return np.asarray(np.einsum("ki,kia->ka", shape(local), corners))


def to_local(corners: Floats, points: Floats) -> Floats:
    """(k, 2) Local coordinates of (k, 2) points in cells of (k, 4, 2) corners (Newton's method).

    Raises
    ------
    GeometryError
        Where the iteration does not converge (a point far outside its cell, or a folded cell).
    """
    local = np.zeros((len(points), 2))
    if len(points) == 0:
        return local
    # Seen from a corner: far from the origin, coordinates have too few digits for a small cell.
    corners, points = corners - corners[:, :1], points - corners[:, 0]
    size = np.ptp(corners, axis=1).max(axis=1)
    for _ in range(30):
        residual = points - to_global(corners, local)
        jacobian = np.einsum("kia,kib->kba", local_gradients(local), corners)  # d x_b / d xi_a
        step = np.linalg.solve(jacobian, residual[..., None])[..., 0]
        local = local + step
        if np.all(np.abs(step) < 1e-14):
            break
    miss = np.max(np.abs(points - to_global(corners, local)) / size[:, None], initial=0.0)
    if not miss < 1e-12:
        raise GeometryError(f"a point could not be located in its grid cell (miss {miss:.1e} of its size)")
    return local
