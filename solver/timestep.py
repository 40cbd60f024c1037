"""The stable time step of elements, cut cells and contact together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.solver.model import Contact, CutElements, Elements, Model

Floats = NDArray[np.float64]

CHUNK = 65536
"""Elements whose stiffness is looked at at once: 64 numbers each."""


class StepEstimate(NamedTuple):
    """A safe time step, dt = safety * 2 / sqrt(element_frequency^2 + contact_frequency^2).

    dt, s; element_frequency, rad/s, of the stiffest element alone; contact_frequency, rad/s, of the penalty
    springs with every slave point closed; element: its number (uncut elements first, then cut ones).
    """

    dt: float
    element_frequency: float
    contact_frequency: float
    element: int


def stable_step(model: Model, safety: float = 0.85) -> StepEstimate:
    """A time step that is safe with every slave point closed.

    The largest eigenvalue of the assembled stiffness by the lumped mass is at most the largest one of any
    element with its own mass, plus that of the contact springs (Rayleigh's quotient, term by term). The
    step of the elements alone (Eq. 21) is 2.5 to 26 times too long once contact closes.

    Parameters
    ----------
    model : Model
    safety : float
        What is kept for the stiffening under finite strain.

    Raises
    ------
    ValueError
        Where the model has no element.
    """
    uncut = _uncut_eigenvalue(model.elements)
    cut = _cut_eigenvalue(model.cut_elements)
    element2, element = max(uncut, (cut[0], cut[1] + len(model.elements.volume)))
    if not element2 > 0.0:
        raise ValueError("the model has no element that could limit the time step")
    contact2 = _contact_eigenvalue(model)
    dt = safety * 2.0 / np.sqrt(element2 + contact2)
    return StepEstimate(float(dt), float(np.sqrt(element2)), float(np.sqrt(contact2)), element)


def _strain_stiffness(gradient: Floats, lame: Floats, shear: Floats) -> Floats:
    """(p, 8, 8) lambda N_I,i N_J,j + mu (N_I,j N_J,i + N_I,k N_J,k d_ij): B^T D B of small strain, Pa/m^2."""
    p = len(gradient)
    volumetric = np.einsum("pia,pjb->piajb", gradient, gradient)
    laplace = np.einsum("pik,pjk,ab->piajb", gradient, gradient, np.eye(2))
    shearing = np.swapaxes(volumetric, 2, 4) + laplace
    stiffness = lame[:, None, None, None, None] * volumetric + shear[:, None, None, None, None] * shearing
    return np.asarray(stiffness.reshape(p, 8, 8))


def _uncut_eigenvalue(elements: Elements) -> tuple[float, int]:
    """Largest eigenvalue of an uncut element with its own mass, 1/s^2, and the number of the element."""
    best = (0.0, 0)
    for start in range(0, len(elements.volume), CHUNK):
        block = _some(elements, np.arange(start, min(start + CHUNK, len(elements.volume))))
        quarter = 0.25 * block.mass
        # Elements of one kind (most of a structured grid) have the same stiffness: look at each kind once.
        kinds = _kinds(
            np.column_stack(
                [
                    block.gradient.reshape(-1, 8) * np.sqrt(block.lame * block.volume / quarter)[:, None],
                    block.gradient.reshape(-1, 8) * np.sqrt(block.shear * block.volume / quarter)[:, None],
                    block.gamma * np.sqrt(block.hourglass / quarter)[:, None],
                ]
            )
        )
        e = _some(block, kinds)
        stiffness = e.volume[:, None, None] * _strain_stiffness(e.gradient, e.lame, e.shear)
        mode = np.einsum("mi,mj,ab->miajb", e.gamma, e.gamma, np.eye(2)).reshape(-1, 8, 8)
        stiffness += e.hourglass[:, None, None] * mode
        largest = np.linalg.eigvalsh(stiffness / quarter[kinds, None, None])[:, -1]
        k = int(np.argmax(largest))
        best = max(best, (float(largest[k]), start + int(kinds[k])))
    return best


def _some(elements: Elements, which: NDArray[np.intp]) -> Elements:
    """The elements of these numbers."""
    return Elements._make(field[which] for field in elements)


def _kinds(features: Floats) -> NDArray[np.intp]:
    """The first row of every kind of rows that agree to rounding, by their product with a fixed vector."""
    weights = np.random.default_rng(0).uniform(1.0, 2.0, features.shape[1])
    key = features @ weights / np.max(np.abs(features) @ weights)
    return np.unique(np.round(key, 10), return_index=True)[1]


def _cut_eigenvalue(cut: CutElements) -> tuple[float, int]:
    """Largest eigenvalue of a cut element with its own mass, 1/s^2, and its number among the cut ones."""
    if len(cut.lame) == 0:
        return 0.0, 0
    owner = np.repeat(np.arange(len(cut.lame)), np.diff(cut.first))
    at_points = _strain_stiffness(cut.gradient, cut.lame[owner], cut.shear[owner])
    at_points *= cut.weight[:, None, None]
    stiffness = np.zeros((len(cut.lame), 8, 8))
    np.add.at(stiffness, owner, at_points)
    largest = np.linalg.eigvalsh(stiffness / (0.25 * cut.mass)[:, None, None])[:, -1]
    return float(np.max(largest)), int(np.argmax(largest))


def _contact_eigenvalue(model: Model) -> float:
    """Bound on the largest eigenvalue of the penalty springs, 1/s^2, with every slave point closed.

    A point adds eps w to the stiffness of its slave and of its master side, (a - b)^2 <= 2 a^2 + 2 b^2
    parts the two, rows of shape functions bound each, and the points over a master segment are as long as
    the segment.
    """
    contact = model.contact
    stiffness = np.zeros(len(model.mass))
    penalty = _spring_stiffness(contact)
    slave_penalty = np.repeat(penalty, np.diff(contact.slave_first))
    by_point = 2.0 * slave_penalty * contact.slave_weight
    np.add.at(stiffness, contact.slave_nodes, by_point[:, None] * contact.slave_shape)
    corners = model.x[contact.master_nodes]
    along = np.einsum("si,sia->sa", contact.end_shape - contact.start_shape, corners)
    by_segment = 2.0 * np.repeat(penalty, np.diff(contact.master_first)) * np.hypot(*along.T)
    middle = 0.5 * (contact.start_shape + contact.end_shape)
    np.add.at(stiffness, contact.master_nodes, by_segment[:, None] * middle)
    heavy = model.mass > 0.0  # the nodes of rigid obstacles have none, and do not swing
    return float(np.max(stiffness[heavy] / model.mass[heavy], initial=0.0))


def _spring_stiffness(contact: Contact) -> Floats:
    """(k,) Stiffness of the springs of each pair over any direction, Pa/m.

    The normal and the tangential spring of a point act across each other, so that the stiffer one bounds both
    as long as it sticks. Where it slips, the friction mu eps g follows the gap: the norm of that matrix, with the
    rows (eps, 0) and (mu eps, 0), is eps sqrt(1 + mu^2).
    """
    if len(contact.friction) == 0:
        return contact.penalty
    tangential = np.where(contact.friction > 0.0, contact.tangential_penalty, 0.0)
    return np.maximum(contact.penalty * np.sqrt(1.0 + contact.friction**2), tangential)
