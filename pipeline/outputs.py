"""The outputs of a case: single numbers, by the names of their columns in results.csv."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from phantomnode.pipeline.case import variants
from phantomnode.pipeline.schema import Case

SCALARS = (
    "energy_error_max", "smallest_J", "stable_step_min", "internal_energy_max", "hourglass_energy_max",
    "steps", "dt", "dt_stable", "end_time", "wall_s", "step_loop_s", "element_updates_per_s",
)  # fmt: skip
COUNTS = (
    "grid_cells", "elements", "cut", "doubled", "nodes", "phantom_nodes", "relocated_nodes", "smallest_fraction",
    "contact_points",
)  # fmt: skip
ENERGIES = ("kinetic", "internal", "hourglass", "contact", "external_work", "friction", "damping")
CASE_COLUMNS = ("case", "folder", "status", "reason", "hash")
FIXED = frozenset({*CASE_COLUMNS, *SCALARS})
"""Names that no axis can have."""


def known_outputs(case: Case) -> Iterator[str]:
    """Names of the outputs that a case has when it has run with its variants, in the order of results.csv.

    Those of a variant begin with ``variant.NAME.``.
    """
    yield from _own_outputs(case)
    for name, variant in variants(case).items():
        yield from (f"variant.{name}.{output}" for output in _own_outputs(variant))


def _own_outputs(case: Case) -> Iterator[str]:
    """The outputs of a case without its variants."""
    for pair in case.contact:
        yield f"peak_contact_force.{pair}"
        yield f"largest_penetration.{pair}"
        yield f"contact_phases.{pair}"
        yield from (f"contact_impulse.{pair}.{axis}" for axis in "xy")
    yield from (f"peak_reaction.{boundary}" for boundary in case.boundary)
    for body in case.body:
        yield f"highest_von_mises.{body}"
        yield from (f"momentum.{body}.reaction.{axis}" for axis in "xy")
        yield from (f"velocity.{body}.{when}.{axis}" for when in ("start", "end") for axis in "xy")
        yield f"mass.{body}"
    yield from SCALARS
    yield from (f"energies.{energy}" for energy in ENERGIES)
    yield from (f"counts.{count}" for count in COUNTS)


UNITS = {
    "peak_contact_force": "N/m", "peak_reaction": "N/m", "largest_penetration": "m", "contact_impulse": "N s/m",
    "velocity": "m/s", "highest_von_mises": "Pa", "momentum": "N s/m", "mass": "kg/m",
    "energies": "J/m", "internal_energy_max": "J/m", "hourglass_energy_max": "J/m",
    "stable_step_min": "s", "dt": "s", "dt_stable": "s", "end_time": "s", "wall_s": "s", "step_loop_s": "s",
    "element_updates_per_s": "1/s",
}  # fmt: skip
"""By the first word of an output; what is not here is a plain number. Per metre of thickness."""


KEY_UNITS = {
    "cell": "m", "radius": "m", "outer": "m", "inner": "m", "centre": "m", "low": "m", "high": "m", "move": "m",
    "rotate": "degrees", "end": "s", "step": "s", "E": "Pa", "rho": "kg/m^3", "initial_velocity": "m/s",
    "displacement": "m", "velocity": "m/s", "acceleration": "m/s^2", "gravity": "m/s^2", "pressure": "Pa",
    "traction": "Pa", "penalty": "Pa/m", "times_E": "1/m", "times_auto": "",
}  # fmt: skip
"""By the last word of a key of the case, without places in lists and what an axis of a vector is called."""


def unit_of_key(key: str) -> str:
    """The unit of a key of the case, as "body.ring.initial_velocity.1"; "" of a plain number or a choice."""
    words = [word for word in key.split(".") if not word.isdigit() and word not in ("x", "y", "value")]
    return KEY_UNITS.get(words[-1], "") if words else ""


def unit_of(name: str) -> str:
    """The unit of one of :func:`known_outputs`, "" of a plain number."""
    words = name.split(".")
    return UNITS.get(words[2] if words[0] == "variant" else words[0], "")


def in_words(name: str) -> str:
    """A name with spaces: "peak_contact_force.landing" is "peak contact force, landing"."""
    return ", ".join(part.replace("_", " ") for part in name.split("."))


def named(name: str, unit: str) -> str:
    """A name and its unit, where it has one."""
    return f"{name}, {unit}" if unit else name


def with_unit(name: str) -> str:
    """An output as it is called in pictures and tables: "peak_contact_force.landing, N/m"."""
    return named(name, unit_of(name))


def wall_time(figures: Mapping[str, Any]) -> float | None:
    """Wall time of a case with its variants, s; None where it has not ended."""
    runs = [figures, *figures.get("variant", {}).values()]
    times = [run["wall_s"] for run in runs if "wall_s" in run]
    return sum(times) if times else None


def output_of(figures: Mapping[str, Any], name: str) -> float | int | None:
    """An output of a run.

    Parameters
    ----------
    figures : mapping
        The content of summary.json; under ``variant``, by name, those of the variants.
    name : str
        One of :func:`known_outputs` (names in a case hold no dots). The parts of a vector are x and y; of a list
        the length is taken.

    Returns
    -------
    float, int or None
        None where the run has not come so far, or where it is not finite.
    """
    value: Any = figures
    for key in name.split("."):
        if isinstance(value, Mapping):
            value = value.get(key)
        elif value is not None:
            value = value["xy".index(key)]
    return len(value) if isinstance(value, list | tuple) else value
