"""history.csv: energies, forces and the motion of every body over time."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from phantomnode.pipeline.boundaries import Boundary
from phantomnode.pipeline.checkpoint import Damaged, Tree
from phantomnode.pipeline.contacts import Pair
from phantomnode.pipeline.files import GrowingFile
from phantomnode.pipeline.observer import Ending, Sampled
from phantomnode.pipeline.prepare import Body, Floats, Prepared

if TYPE_CHECKING:
    from phantomnode.solver.explicit import Frame

ENERGIES = ("kinetic", "internal", "hourglass", "contact", "external_work")
DISSIPATED = ("friction", "damping")


class History(Sampled):
    """Writes one line of history.csv at each sample, at once, so that a run can be watched.

    Numbers are written with ``repr``: read back, they are the same float64 to the bit. SI units, forces and
    energies per metre of thickness. ``contact.NAME.fx`` is the force on the slave, ``reaction.NAME.fx`` the
    force that a boundary exerts (0 in a direction that it leaves free; of a load its resultant), ``body.NAME.ux``
    the displacement of the centre of mass; then the impulses ``contact.NAME.ix`` since the start, the energies
    dissipated so far, and of pairs with friction the part ``contact.NAME.tx`` of the force that is tangential.
    Last, of each body the centre of mass ``cx, cy``, momentum ``px, py`` and angular momentum ``l`` about the
    origin; then the smallest J, and the stable step of the deformed state (an estimate, nothing kept for safety).

    Parameters
    ----------
    prepared : Prepared
    path : Path
        The .csv file; replaced where it is there.
    steps : frozenset of int
        The steps to write.
    saved : dict or None
        Go on from what :meth:`saved` gave; the lines written since are dropped.

    Raises
    ------
    Damaged
        Where the file does not hold the lines that it held then.
    """

    def __init__(
        self, prepared: Prepared, path: Path, steps: frozenset[int], saved: Tree | None = None
    ) -> None:
        super().__init__(steps)
        self._prepared = prepared
        if saved is None:
            self._file = GrowingFile(path, f"{','.join(columns(prepared))}\n".encode())
            return
        self._seen = saved["seen"]
        self._file = _continued(path, saved)

    def take(self, frame: Frame) -> None:
        """Write one line, and let it reach the file."""
        line = ",".join(repr(float(value)) for value in row(self._prepared, frame))
        self._file.add(f"{line}\n".encode())

    def finish(self, ending: Ending) -> None:
        """Write the last frame where it is not there yet; then all lines are on the disk."""
        super().finish(ending)
        self._file.reach_disk()

    def saved(self) -> Tree:
        """What the file holds so far."""
        return {"seen": self._seen, "size": self._file.size, "sha256": self._file.sha256}

    def reach_disk(self) -> None:
        """Wait until the disk holds the lines so far; may be called from another thread."""
        self._file.reach_disk()

    def close(self) -> None:
        """Give the file back, also after an error; closing twice is fine."""
        self._file.close()


def _continued(path: Path, saved: Tree) -> GrowingFile:
    """The file with the lines that it held, and no others."""
    content = path.read_bytes()[: saved["size"]] if path.is_file() else b""
    if hashlib.sha256(content).hexdigest() != saved["sha256"]:
        raise Damaged(f"{path} is missing, was cut short or changed since")
    return GrowingFile(path, content, there=True)


def columns(prepared: Prepared) -> list[str]:
    """Names of the columns, in order."""
    return [
        "time",
        *ENERGIES,
        "energy_error",
        *(f"contact.{pair.name}.f{axis}" for pair in prepared.pairs for axis in "xy"),
        *(f"reaction.{boundary.name}.f{axis}" for boundary in prepared.boundaries for axis in "xy"),
        *(f"body.{body.name}.{value}" for body in prepared.bodies for value in ("ux", "uy", "vx", "vy")),
        *(f"contact.{pair.name}.i{axis}" for pair in prepared.pairs for axis in "xy"),
        *DISSIPATED,
        *(f"contact.{pair.name}.t{axis}" for pair in prepared.pairs if pair.friction > 0.0 for axis in "xy"),
        *(f"body.{body.name}.{value}" for body in prepared.bodies for value in ("cx", "cy", "px", "py", "l")),
        "smallest_j",
        "stable_step",
    ]


def row(prepared: Prepared, frame: Frame) -> list[float]:
    """The values of one line, in the order of :func:`columns`."""
    energies = frame.energies
    values = [frame.time, *(getattr(energies, name) for name in ENERGIES), frame.energy_error]
    values.extend(frame.pair_force.ravel())
    for boundary in prepared.boundaries:
        values.extend(boundary_force(boundary, frame))
    for body in prepared.bodies:
        mass = prepared.model.mass[body.nodes]
        values.extend(centre(mass, frame.u[body.nodes]))
        values.extend(centre(mass, frame.v[body.nodes]))
    values.extend(frame.pair_impulse.ravel())
    values.extend(getattr(energies, name) for name in DISSIPATED)
    for pair in prepared.pairs:
        if pair.friction > 0.0:
            values.extend(tangential_force(prepared, pair, frame))
    for body in prepared.bodies:
        values.extend(motion_of(prepared, body, frame))
    return [*values, frame.smallest_j, prepared.stable_step(frame.u)]


def motion_of(prepared: Prepared, body: Body, frame: Frame) -> tuple[float, ...]:
    """Centre of mass, m, momentum, kg m/s, and angular momentum about the origin, kg m^2/s, of a body."""
    nodes, mass = body.nodes, prepared.model.mass[body.nodes]
    x, v = prepared.model.x[nodes] + frame.u[nodes], frame.v[nodes]
    spin = float(mass @ (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0]))
    return (*centre(mass, x), *(mass @ v), spin)


def tangential_force(prepared: Prepared, pair: Pair, frame: Frame) -> Floats:
    """(2,) Friction of a pair on its slave, N/m; what the points of the master feel is on the master."""
    contact = prepared.model.contact
    first, sign = contact.slave_first, contact.sign if len(contact.sign) else np.ones(len(contact.penalty))
    passes = (*pair.passes, *pair.corners)
    return np.asarray(sum(sign[k] * frame.tangential[first[k] : first[k + 1]].sum(axis=0) for k in passes))


def boundary_force(boundary: Boundary, frame: Frame) -> Floats:
    """(2,) Force that a boundary exerts on its body, N/m: reactions, springs or the resultant of its load."""
    held = [frame.reaction[channel] if channel >= 0 else 0.0 for channel in boundary.channels]
    return np.asarray(held + frame.applied[list(boundary.rows)].sum(axis=0))


def centre(mass: Floats, nodal: Floats) -> Floats:
    """(2,) Mass-weighted mean of (n, 2) nodal vectors with (n,) masses."""
    return np.asarray(mass @ nodal / mass.sum())
