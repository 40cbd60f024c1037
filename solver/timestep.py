"""The stable time step of elements, cut cells and contact together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.solver.contact import reference_length
from phantomnode.solver.model import Contact, CutElements, Elements, Model, of_each_kind
from phantomnode.solver.surface_loads import support_stiffness

Floats = NDArray[np.float64]

CHUNK = 4096
"""Elements whose stiffness is looked at at once: 64 numbers each, and for each of the points of cut ones."""


class StepEstimate(NamedTuple):
    """A safe time step, dt = safety * 2 (sqrt(1 + xi^2) - xi)/sqrt(element_frequency^2 + contact_frequency^2).

    dt, s; element_frequency, rad/s, of the element that limits the step, alone; contact_frequency, rad/s, of the
    penalty springs at its nodes, with every slave point of contact closed; element: its number (uncut elements
    first, then cut ones); xi: the part of critical damping that viscosity gives that element.
    """

    dt: float
    element_frequency: float
    contact_frequency: float
    element: int
    xi: float = 0.0


def stable_step(model: Model, safety: float = 0.85, speed: float = 0.0) -> StepEstimate:
    """A time step that is safe with every slave point closed.

    The largest eigenvalue of the assembled stiffness by the lumped mass is at most the largest one of any
    element with its own mass, plus what contact springs add at its nodes (Rayleigh's quotient, element by
    element, with the springs shared among the elements of a node by their mass). The step of the elements
    alone (Eq. 21) is 2.5 to 26 times too long once contact closes. With viscous forces
    half a step behind, M - dt/2 C - dt^2/4 K must be positive, which is held element by element likewise.

    Parameters
    ----------
    model : Model
    safety : float
        What is kept for the stiffening under finite strain.
    speed : float, m/s
        The largest difference of velocity over one element that the quadratic bulk viscosity is to meet.

    Raises
    ------
    ValueError
        Where the model has no element.
    """
    stiffness2, viscosity = element_rates(model, speed)
    if not np.max(stiffness2, initial=0.0) > 0.0:
        raise ValueError("the model has no element that could limit the time step")
    contact2 = contact_by_element(model)
    shortest, element = np.inf, 0
    for start in range(0, len(viscosity), CHUNK):
        part = slice(start, start + CHUNK)
        steps = _step_of(stiffness2[part] + contact2[part], viscosity[part])
        if np.min(steps) < shortest:
            shortest, element = float(np.min(steps)), start + int(np.argmin(steps))
    frequency = np.sqrt(stiffness2[element] + contact2[element])
    return StepEstimate(
        dt=safety * shortest,
        element_frequency=float(np.sqrt(stiffness2[element])),
        contact_frequency=float(np.sqrt(contact2[element])),
        element=element,
        xi=float(0.5 * viscosity[element] / frequency),
    )


def _step_of(frequency2: Floats, viscosity: Floats) -> Floats:
    """The step at which dt^2 w^2/4 + dt c/2 = 1, s, from w^2, 1/s^2, and c, 1/s."""
    return np.asarray(4.0 / (viscosity + np.sqrt(viscosity**2 + 4.0 * frequency2)))


def element_rates(model: Model, speed: float = 0.0) -> tuple[Floats, Floats]:
    """Largest eigenvalues of stiffness, 1/s^2, and viscosity, 1/s, of each element with its own lumped mass.

    Parameters
    ----------
    model : Model
    speed : float, m/s
        See :func:`stable_step`.

    Returns
    -------
    stiffness, viscosity : (e,) float64
        Uncut elements first, then cut ones.
    """
    m, count = len(model.elements.mass), len(model.elements.mass) + len(model.cut_elements.mass)
    stiffness, viscosity = np.empty(count), np.zeros(count)
    if len(model.full.weight):
        stiffness[:m] = cut_eigenvalues(model.full)
    else:
        _set_uncut_eigenvalues(model.elements, stiffness[:m])
    stiffness[m:] = cut_eigenvalues(model.cut_elements)
    if len(model.damping.bulk.weight):
        mass = np.concatenate([model.elements.mass, model.cut_elements.mass])
        viscosity += _bulk_rates(model, mass, speed)
    if len(model.damping.hourglass):
        viscosity[:m] += _hourglass_rates(model)
    return stiffness, viscosity


def contact_by_element(model: Model) -> Floats:
    """(e,) The largest of :func:`contact_rates` at the nodes of each element, uncut elements first, 1/s^2."""
    if len(model.contact.slave_weight) == 0 and len(model.supports.stiffness) == 0:
        return np.zeros(len(model.elements.mass) + len(model.cut_elements.mass))
    rates, largest = contact_rates(model), []
    for nodes in (model.elements.nodes, model.cut_elements.nodes):
        largest.append(rates[nodes[:, 0]])
        for corner in nodes.T[1:]:
            np.maximum(largest[-1], rates[corner], out=largest[-1])
    return np.concatenate(largest)


def _bulk_rates(model: Model, mass: Floats, speed: float) -> Floats:
    """(e,) Largest eigenvalue of the bulk viscosity of each element with its mass, 1/s.

    A point adds w c g g^T with the gradients g; the quadratic part counts by its slope, twice its secant, at a
    velocity jump ``speed`` over L: quadratic * 2 speed/L, where quadratic/L = b2^2 rho L.
    """
    bulk = model.damping.bulk
    count = np.diff(bulk.first)
    owner = np.repeat(np.arange(len(mass)), count)
    slope = bulk.linear + 2.0 * bulk.quadratic * speed / bulk.length
    trace = np.bincount(owner, bulk.weight * np.einsum("pia,pia->p", bulk.gradient, bulk.gradient), len(mass))
    return np.asarray(slope * trace / (0.25 * mass))


def _strain_stiffness(gradient: Floats, lame: Floats, shear: Floats) -> Floats:
    """(p, 8, 8) lambda N_I,i N_J,j + mu (N_I,j N_J,i + N_I,k N_J,k d_ij): B^T D B of small strain, Pa/m^2."""
    p = len(gradient)
    volumetric = np.einsum("pia,pjb->piajb", gradient, gradient)
    laplace = np.einsum("pik,pjk,ab->piajb", gradient, gradient, np.eye(2))
    shearing = np.swapaxes(volumetric, 2, 4) + laplace
    stiffness = lame[:, None, None, None, None] * volumetric + shear[:, None, None, None, None] * shearing
    return np.asarray(stiffness.reshape(p, 8, 8))


def _hourglass_rates(model: Model) -> Floats:
    """(m,) Eigenvalue of the hourglass viscosity of each uncut element with its mass, 1/s."""
    e, gamma = model.elements, of_each_kind(model.elements).gamma
    square = np.einsum("ki,ki->k", gamma, gamma)
    return np.asarray(model.damping.hourglass * square[e.kind] / (0.25 * e.mass))


def _set_uncut_eigenvalues(elements: Elements, eigenvalues: Floats) -> None:
    """Largest eigenvalue of each uncut element with its own mass, 1/s^2, from those of the kinds."""
    kinds = of_each_kind(elements)
    largest = np.zeros(len(kinds.kind))
    for start in range(0, len(largest), CHUNK):
        e = kinds.some(slice(start, start + CHUNK))
        stiffness = e.volume[:, None, None] * _strain_stiffness(e.gradient, e.lame, e.shear)
        mode = np.einsum("mi,mj,ab->miajb", e.gamma, e.gamma, np.eye(2)).reshape(-1, 8, 8)
        stiffness += e.hourglass[:, None, None] * mode
        largest[start : start + CHUNK] = np.linalg.eigvalsh(stiffness)[:, -1]
    np.divide(largest[elements.kind], elements.mass, out=eigenvalues)
    eigenvalues *= 4.0


def cut_eigenvalues(cut: CutElements) -> Floats:
    """(c,) Largest eigenvalue of each element of integration points with its own mass, 1/s^2."""
    eigenvalues = np.zeros(len(cut.lame))
    for start in range(0, len(cut.lame), CHUNK):
        stop = min(start + CHUNK, len(cut.lame))
        points = slice(cut.first[start], cut.first[stop])
        owner = np.repeat(np.arange(stop - start), np.diff(cut.first[start : stop + 1]))
        moduli = cut.lame[start + owner], cut.shear[start + owner]
        at_points = cut.weight[points, None, None] * _strain_stiffness(cut.gradient[points], *moduli)
        stiffness = np.zeros((stop - start, 8, 8))
        np.add.at(stiffness, owner, at_points)
        quarter = 0.25 * cut.mass[start:stop, None, None]
        eigenvalues[start:stop] = np.linalg.eigvalsh(stiffness / quarter)[:, -1]
    return eigenvalues


def contact_rates(model: Model) -> Floats:
    """(n,) Bound on what the penalty springs add to the eigenvalues at each node, 1/s^2, with all points closed.

    A point adds eps w to the stiffness of its slave and of its master side. (a - b)^2 <= (1 + q) a^2 + (1 + 1/q)
    b^2 parts the two for any q > 0; that of the ratio of the sides makes their sum of it. A side that is rigid does
    not swing, and nothing is to be parted there. Rows of shape functions bound each side. Beside the tip of a crack
    the nodes that both faces have in common feel nothing of a point, and the part J of the shape functions that is
    left squares with the weight w/J to no more than w. Weak supports have one side only.
    """
    contact, n = model.contact, len(model.mass)
    penalty, length = _spring_stiffness(contact), reference_length(contact)
    one_sided = _one_sided(model)
    held = _by_mass(model, np.max(support_stiffness(model.supports, n), axis=1))
    parted, alone = (
        [_by_mass(model, rows(model, np.where(one_sided == which, penalty, 0.0), length)) for rows in SIDES]
        for which in (False, True)
    )
    slave, master = parted
    found = alone[0] + alone[1] + held
    if not np.max(slave, initial=0.0) > 0.0 or not np.max(master) > 0.0:
        return np.asarray(slave + master + found)
    ratio = np.max(master) / np.max(slave)
    return np.asarray((1.0 + ratio) * slave + (1.0 + 1.0 / ratio) * master + found)


def _one_sided(model: Model) -> NDArray[np.bool_]:
    """(k,) Whether the points of a pass or its masters belong to a rigid obstacle, whose nodes have no mass."""
    contact = model.contact
    sides = (contact.slave_nodes, contact.slave_first), (contact.master_nodes, contact.master_first)
    return np.array(
        [
            any(not np.any(model.mass[nodes[first[k] : first[k + 1]]] > 0.0) for nodes, first in sides)
            for k in range(len(contact.penalty))
        ],
        dtype=bool,
    )


def _by_mass(model: Model, rows: Floats) -> Floats:
    """(n,) Over the nodal masses; zero on the nodes of rigid obstacles, which have none and do not swing."""
    heavy = model.mass > 0.0
    return np.where(heavy, rows / np.where(heavy, model.mass, 1.0), 0.0)


def _slave_rows(model: Model, penalty: Floats, length: Floats) -> Floats:
    """(n,) Sum of eps w N_I over the slave points, N/m^2."""
    contact, rows = model.contact, np.zeros(len(model.mass))
    by_point = np.repeat(penalty, np.diff(contact.slave_first)) * length
    np.add.at(rows, contact.slave_nodes, by_point[:, None] * contact.slave_shape)
    return rows


def _master_rows(model: Model, penalty: Floats, length: Floats) -> Floats:
    """(n,) Bound on the sum of eps w N_I over the slave points, wherever they stand on the master, N/m^2.

    It is the integral of N_I and what points can weigh more. Each lies within its share of the segment, so that
    w N_I is more than the integral over it by w times the variation of N_I there at most: in all by the heaviest
    point times the variation along the master. Or else N_I is the sum of its values at vertices times their hats,
    over each of which points weigh what it is long and at most one point more. The lesser of the two counts: the
    first where a segment is in many pieces, the second where N_I is one hat. At a free end, beyond which points
    may stand, all of one point is added, and N_I falls to zero and once more as far.

    Points that stand alone, at corners, weigh together no more than the crowd of them that one node can meet, and
    N_I is at no place of a segment more than at one of its ends.
    """
    contact, n = model.contact, len(model.mass)
    start, end, nodes = contact.start_shape, contact.end_shape, contact.master_nodes
    crowd = contact.crowd if len(contact.crowd) else np.zeros(len(penalty))
    lining = np.where(crowd > 0.0, 0.0, penalty)
    along = np.einsum("si,sia->sa", end - start, model.x[nodes])
    segments, points = np.diff(contact.master_first), np.diff(contact.slave_first)
    heaviest = np.zeros(len(penalty))
    np.maximum.at(heaviest, np.repeat(np.arange(len(penalty)), points), length)
    half, heavier = (np.repeat(k, segments)[:, None] for k in (0.5 * lining, lining * heaviest))
    opens, closes = ((link < 0)[:, None] for link in (contact.previous, contact.following))
    integral, hats, variation = np.zeros((3, n))
    np.add.at(integral, nodes, half * np.hypot(*along.T)[:, None] * (start + end))
    np.add.at(hats, nodes, heavier * (np.where(opens, 1.0, 0.5) * start + np.where(closes, 1.0, 0.5) * end))
    ends = np.where(opens, 2.0 * start, 0.0) + np.where(closes, 2.0 * end, 0.0)
    np.add.at(variation, nodes, heavier * (np.abs(end - start) + ends))
    found = integral + np.minimum(hats, variation)
    for k in np.flatnonzero(penalty * crowd):
        masters, largest = slice(*contact.master_first[k : k + 2]), np.zeros(n)
        np.maximum.at(largest, nodes[masters], np.maximum(start, end)[masters])
        found += penalty[k] * crowd[k] * largest
    return np.asarray(found)


SIDES = (_slave_rows, _master_rows)


def _spring_stiffness(contact: Contact) -> Floats:
    """(k,) Stiffness of the springs of each pair over any direction and in any state of friction, Pa/m.

    The normal and the tangential spring of a point act across each other, so that the stiffer one bounds both
    as long as it sticks. Where it slips, the friction mu eps g follows the gap along n, and the tangent
    eps (n n^T + mu t n^T) is not symmetric. No eigenvalue of the whole is larger, in absolute value, than the
    largest |x* K x| of unit mass, to which that tangent gives its numerical radius, eps (1 + sqrt(1 + mu^2))/2.
    """
    if len(contact.friction) == 0:
        return contact.penalty
    tangential = np.where(contact.friction > 0.0, contact.tangential_penalty, 0.0)
    return np.maximum(0.5 * contact.penalty * (1.0 + np.sqrt(1.0 + contact.friction**2)), tangential)
