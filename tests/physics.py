"""What the proofs of the physics share: materials, tables of cases, runs of a whole case without files."""

from __future__ import annotations

import numpy as np

from phantomnode.pipeline.case import case_from_table
from phantomnode.pipeline.fields import contact_lines
from phantomnode.pipeline.prepare import prepare
from phantomnode.solver.explicit import frames

YOUNG, NU, RHO = 1e10, 0.3, 7800.0
SHEAR = YOUNG / (2.0 * (1.0 + NU))
LAME = 2.0 * SHEAR * NU / (1.0 - 2.0 * NU)
SPEED = np.sqrt((LAME + 2.0 * SHEAR) / RHO)
MATERIAL = {"soft": {"E": YOUNG, "nu": NU, "rho": RHO}}


def cartesian(cell, aligned=True, **more):
    return {"kind": "cartesian", "cell": cell, "aligned": aligned, **more}


def rectangle(low, high, grid, **more):
    shape = {"rectangle": {"low": list(low), "high": list(high)}}
    return {"geometry": shape, "grid": grid, "material": "soft", **more}


def disc(centre, radius, cell, **more):
    shape = {"circle": {"centre": list(centre), "radius": radius}}
    return {"geometry": shape, "grid": cartesian(cell, aligned=False), "material": "soft", **more}


def smooth(value, duration):
    """A ramp from 0 to ``value`` whose velocity and acceleration start and end at 0, so that little rings."""
    s = f"min(t/{duration:g},1)"
    return f"{float(value)!r}*{s}**3*(10-15*{s}+6*{s}**2)"


def prepared_case(bodies, end, **more):
    return prepare(case_from_table({"time": {"end": end}, "material": MATERIAL, "body": bodies, **more}))


def run_frames(prepared, count, first=0.0, **more):
    """Up to ``count`` + 1 frames, evenly spread from time ``first`` to the end of the case."""
    steps = round(prepared.case.time.end / prepared.dt)
    at = np.unique(np.linspace(np.ceil(first / prepared.dt), steps, count + 1).astype(int))
    return frames(prepared.model, prepared.velocity, prepared.dt, at, prepared.motion, 0.05, **more)


def held_frames(prepared, since):
    """Frames of the hold of a quasi-static case: averages over them are free of what still rings."""
    return list(run_frames(prepared, 100, since))


def mean_force(held, pair=0):
    return np.mean([frame.pair_force[pair] for frame in held], axis=0)


def mean_pressure(prepared, held, pair=0):
    """Middle x, m, and pressure, Pa per current length, of each slave segment as they are written out."""
    lines = [contact_lines(prepared, pair, frame) for frame in held]
    return lines[-1].ends.mean(axis=1)[:, 0], np.mean([line.pressure for line in lines], axis=0)


def mean_point_pressure(prepared, held, pair=0):
    """Pressure at each slave point, Pa per current length of its segment (Eq. 25)."""
    surface, contact = prepared.pairs[pair], prepared.model.contact
    shapes = surface.end_shape - surface.start_shape
    length = np.hypot(*np.einsum("si,sia->as", shapes, prepared.model.x[surface.segment_nodes]))
    pressures = []
    for frame in held:
        x = (prepared.model.x + frame.u)[surface.segment_nodes]
        stretch = np.hypot(*np.einsum("si,sia->as", shapes, x)) / length
        nominal = contact.penalty[pair] * np.maximum(frame.gap[surface.points], 0.0)
        pressures.append(nominal / np.repeat(stretch, surface.points_per_segment))
    return np.mean(pressures, axis=0)


def momentum(prepared, frame):
    """Linear, kg m/s, and angular momentum about the origin, kg m^2/s, per metre of thickness."""
    mass, (x, y), (vx, vy) = prepared.model.mass, (prepared.model.x + frame.u).T, frame.v.T
    return mass @ frame.v, mass @ (x * vy - y * vx)


def total_energy(frame):
    e = frame.energies
    return e.kinetic + e.internal + e.hourglass + e.contact - e.external_work
