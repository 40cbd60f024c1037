"""Contact against a NumPy twin by complex steps; self contact: the gradient by differences, no jump."""

from __future__ import annotations

import numpy as np
import pytest
from test_contact import PENALTY, forces_at, quad_contact

from phantomnode.solver.contact import contact_energy
from phantomnode.solver.model import Contact


def folded(rng, n=40, rough=0.01):
    """A closed curve of n nodes that is folded so that it runs through itself, each segment with two points."""
    angle = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    # A long flat loop, run clockwise: the material is outside, as around a hole; its faces overlap here and there.
    y = np.column_stack([np.cos(angle), 0.04 * np.sin(angle)]) + rough * rng.uniform(-1, 1, (n, 2))
    x = np.column_stack([np.cos(angle), -np.sin(angle)])
    length = np.full(n, np.hypot(*(x[1] - x[0])))
    a, b = np.arange(n), (np.arange(n) + 1) % n
    nodes, unit = np.column_stack([a, b, b, b]), np.eye(4)
    start, end = np.repeat(unit[:1], n, axis=0), np.repeat(unit[1:2], n, axis=0)
    at = np.array([0.21, 0.79])
    along = length[0] * np.arange(n)
    contact = Contact(
        np.repeat(nodes, 2, axis=0), (start[:, None] * (1 - at)[:, None] + end[:, None] * at[:, None]).reshape(-1, 4),
        np.repeat(length / 2, 2), np.array([0, 2 * n]), nodes, start, end, (a - 1) % n, b, np.array([0, n]),
        np.array([PENALTY]), np.array([0.15]), np.zeros(2 * n), exclusion=np.array([3 * length[0]]),
        slave_place=np.column_stack([np.zeros(2 * n), (along[:, None] + at * length[0]).reshape(-1)]),
        master_place=np.column_stack([np.zeros(n), along + length / 2, length / 2, np.full(n, length.sum())]),
    )  # fmt: skip
    return contact, x, y - x


def along_curve(contact, s, t, g):
    """Distance from slave point g to the place t on segment s along their closed curve, m; infinite on two curves."""
    if len(contact.exclusion) == 0:
        return np.inf
    _, middle, half, length = contact.master_place[s]
    apart = middle + (2.0 * t - 1.0) * half - contact.slave_place[g, 1]
    apart = apart if np.real(apart) > 0.0 else -apart
    return apart if np.real(apart) < 0.5 * length else length - apart


def closest_place(contact, g, p, a, b):
    """Of the segments (a, b) that point g may see, the nearest to p: number, place from 0 to 1, and distance."""
    d = b - a
    t = np.sum((p - a) * d, axis=1) / np.sum(d * d, axis=1)
    foot = np.where((t <= 0.0)[:, None], a, np.where((t >= 1.0)[:, None], b, a + t[:, None] * d))
    distance = np.hypot(*(p - foot).T)
    centre = np.array([along_curve(contact, s, 0.5, g) for s in range(len(a))])
    if len(contact.exclusion):
        distance[centre + contact.master_place[:, 2] < contact.exclusion[0]] = np.inf
    s = int(np.argmin(distance))
    return s, float(np.clip(t[s], 0.0, 1.0)), distance[s]


def depth_on(contact, g, s, t, sign, p, a, b):
    """Depth of p at a vertex (sign +-1, t = 0 or 1) or over the line of segment s (sign 0), less the recess.

    Analytic, so complex p, a, b do.
    """
    d = b - a
    if sign:
        r = p - (a if t == 0.0 else b)
        depth = sign * np.sqrt(r @ r)
    else:
        t = ((p - a) @ d) / (d @ d)
        depth = ((a - p) @ np.array([d[1], -d[0]])) / np.sqrt(d @ d)
    apart = along_curve(contact, s, t, g)
    recess = contact.reach[0] * (2.0 - apart / contact.exclusion[0]) if apart != np.inf else 0.0
    return depth - contact.offset[g] - (recess if np.real(recess) > 0.0 else 0.0)


def twin(contact, y):
    """Contact of one pair with the nodes at y: forces, gaps, and which points close, (3, g) flags:
    inside a segment, on a vertex, where the surface recedes.

    The forces are derivatives of eps w g^2/2 by the complex step, which has no cancellation.
    """
    points = len(contact.slave_weight)
    force, gap, kind = np.zeros_like(y), np.full(points, -np.inf), np.zeros((3, points), dtype=bool)
    a, b = (
        np.einsum("si,sia->sa", shape, y[contact.master_nodes])
        for shape in (contact.start_shape, contact.end_shape)
    )
    turned = (b - a)[:, ::-1] * [1.0, -1.0]
    normal = turned / np.hypot(*turned.T)[:, None]
    for g, weight in enumerate(contact.slave_weight):
        p = contact.slave_shape[g] @ y[contact.slave_nodes[g]]
        s, t, distance = closest_place(contact, g, p, a, b)
        if distance > contact.reach[0]:
            continue
        sign, neighbour = 0.0, contact.following[s] if t == 1.0 else contact.previous[s]
        if t in (0.0, 1.0) and neighbour >= 0:
            sign = np.sign(((b if t == 1.0 else a)[s] - p) @ (normal[s] + normal[neighbour]))
        where = contact, g, s, t, sign
        depth = depth_on(*where, p, a[s], b[s])
        if depth <= 0.0:
            continue
        gap[g] = depth
        kind[:, g] = sign == 0.0, sign != 0.0, along_curve(contact, s, t, g) < 2.0 * np.sum(contact.exclusion)
        steps = 1e-40j * np.eye(6).reshape(6, 3, 2)
        slope = [np.imag(depth_on(*where, *(np.array([p, a[s], b[s]]) + h))) / 1e-40 for h in steps]
        pulls = -contact.penalty[0] * weight * depth * np.reshape(slope, (3, 2))
        np.add.at(force, contact.slave_nodes[g], np.outer(contact.slave_shape[g], pulls[0]))
        np.add.at(force, contact.master_nodes[s], np.outer(contact.start_shape[s], pulls[1]))
        np.add.at(force, contact.master_nodes[s], np.outer(contact.end_shape[s], pulls[2]))
    return force, gap, kind


@pytest.mark.twin("contact.add_contact_forces")
def test_self_contact_agrees_with_the_numpy_twin():
    """Random folds, interiors and vertices, before and in the recess: 1e-13 of the largest force."""
    seen = np.zeros(3)
    for seed in range(24):
        rng = np.random.default_rng(seed)
        contact, x, u = folded(rng, rough=0.01 if seed % 2 else 0.04)
        contact = contact._replace(offset=rng.uniform(0.0, 0.01, len(contact.offset)))
        force, _, gap, _ = forces_at(contact, x, u)
        expected, depth, kind = twin(contact, x + u)
        assert np.abs(force - expected).max() < 1e-13 * np.abs(expected).max()
        np.testing.assert_array_equal(gap > 0.0, depth > 0.0)
        np.testing.assert_allclose(gap[gap > 0.0], depth[gap > 0.0], atol=1e-13 * depth.max())
        seen += [*np.sum(kind[:2], axis=1), np.sum(kind[0] & kind[2])]
    assert np.all(seen > 15)  # inside, on vertices, inside where the surface recedes


def test_contact_of_two_bodies_agrees_with_the_numpy_twin():
    """On distorted elements: interiors, vertices, free ends."""
    seen = np.zeros(2)
    for seed in range(40):
        rng = np.random.default_rng(seed)
        contact, x = quad_contact(rng)
        u = 0.05 * rng.uniform(-1, 1, x.shape)
        force, pair_force, gap, _ = forces_at(contact, x, u)
        expected, depth, kind = twin(contact, x + u)
        assert np.abs(force - expected).max() < 1e-13 * np.abs(expected).max()
        np.testing.assert_array_equal(gap > 0.0, depth > 0.0)
        np.testing.assert_allclose(
            pair_force[0], expected[4:].sum(axis=0), atol=1e-13 * np.abs(expected).max()
        )
        seen += np.sum(kind[:2], axis=1)
    assert np.all(seen > 15)


@pytest.mark.parametrize("rough", [0.01, 0.04])
@pytest.mark.parametrize("seed", range(20))
def test_self_contact_is_the_gradient_of_its_energy(seed, rough):
    """Across the fold, at its crease, where the neighbourhood of a point begins to be seen, at vertices."""
    rng = np.random.default_rng(seed)
    contact, x, u = folded(rng, rough=rough)
    direction, step = rng.normal(size=x.shape), 3e-6
    force, pair_force, gap, _ = forces_at(contact, x, u)

    def energy(k):
        return contact_energy(contact, forces_at(contact, x, u + k * step * direction)[2])

    # Fourth order: what is left is EPS energy/step, 1e-9 of the largest force; a kink within the step would show.
    slope = (energy(-2) - 8.0 * energy(-1) + 8.0 * energy(1) - energy(2)) / (12.0 * step)
    assert np.sum(gap > 0.0) > 5
    assert abs(slope + np.sum(force * direction)) < 1e-7 * np.abs(force).max()
    assert np.abs(force.sum(axis=0)).max() < 1e-13 * np.abs(force).sum()
    y = x + u
    assert abs(np.sum(y[:, 0] * force[:, 1] - y[:, 1] * force[:, 0])) < 1e-13 * np.abs(force).sum()


def test_self_contact_has_no_jump_where_the_neighbourhood_begins():
    """A fold runs along the curve like a tread: points come to see each other, and cease to, at some depth."""
    contact, x, _ = folded(np.random.default_rng(1))
    angle = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    places = [
        np.column_stack([np.cos(angle + s), 0.04 * np.sin(angle + s)]) for s in np.linspace(0.0, 0.6, 6001)
    ]
    seen = [forces_at(contact, x, y - x) for y in places]
    energies = np.array([contact_energy(contact, gap) for _, _, gap, _ in seen])
    work = [
        -0.5 * np.sum((a[0] + b[0]) * (there - here))
        for a, b, here, there in zip(seen, seen[1:], places, places[1:], strict=False)
    ]
    # Trapezium; where a normal turns at a vertex the force jumps within one of 6000 steps.
    np.testing.assert_allclose(energies[1:] - energies[0], np.cumsum(work), atol=1e-3 * energies[0])
    closed = [int(np.sum(gap > 0.0)) for _, _, gap, _ in seen]
    assert min(closed) < max(closed)
