"""Whether a run can be trusted, in plain words: each check with its figure, its limit and what it means."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from phantomnode.pipeline.drawing import moment

AREA = 0.01
"""Difference between the areas as cut and by the drawing, over the latter, that is worth a look."""
ADDED = 0.05
"""Added mass over the whole that changes the answer: the limit of the run's own warning."""


CELLS_ADVISED, THROUGH_WALL = 4, 2.0
"""Cells through a wall with which bending is right to some per cent, and the fewest that pass without a word: below
them the one point of an element sees no bending, which hourglass control alone resists."""


SAFE = 0.85
"""Of the smallest stable step: what the automatic step takes of the first one."""

SPANS = 6
"""Phases of contact that are told one by one."""


class Finding(NamedTuple):
    """One answer: whether it is as it should be, what was looked at, and the answer with its numbers."""

    passed: bool
    subject: str
    text: str


def findings(figures: dict[str, Any]) -> list[Finding]:
    """What the summary of a run says about it, the end of the run first.

    Parameters
    ----------
    figures : dict
        The content of summary.json.
    """
    checks = [_check(check) for check in figures.get("checks", ())]
    return [_end(figures), *checks, *beyond_checks(figures)]


def beyond_checks(figures: dict[str, Any]) -> list[Finding]:
    """What is looked at beside the run's own checks: its step, the mesh, warnings, added mass."""
    step = [_step(figures)] if "stable_step_min" in figures else []
    return [*step, *_mesh(figures), *_added_mass(figures)]


def doubtful(figures: dict[str, Any]) -> tuple[str, ...]:
    """What of a run wants a look, in a word or two each: checks that it did not keep, and what else was found."""
    checks = tuple(check["name"] for check in figures.get("checks", ()) if not check["passed"])
    found = beyond_checks(figures) if checks or "checks" in figures else []
    return checks + tuple(dict.fromkeys(finding.subject.lower() for finding in found if not finding.passed))


def open_end(figures: dict[str, Any]) -> str:
    """That a run ends before contact does, or has none, in a few words for a table; else ""."""
    if figures.get("still_closing"):
        return "ends while still closing"
    if figures.get("bearing_at_end"):
        return "ends in contact"
    return "never touches" if figures.get("never_touches") else ""


def remarks(figures: dict[str, Any]) -> list[str]:
    """What the verdict says besides: pairs that still close or bear at the end of a run, and that never touch."""
    closing, never = figures.get("still_closing", ()), figures.get("never_touches", ())
    bearing = [name for name in figures.get("bearing_at_end", ()) if name not in closing]
    found = []
    if closing:
        found.append(f"ends while {' and '.join(closing)} still closes")
    if bearing:
        found.append(f"ends with {' and '.join(bearing)} in contact")
    if never:
        found.append(f"{' and '.join(never)} never touches")
    return found


def contact_spans(figures: dict[str, Any], pair: str) -> str:
    """When a pair is in contact: "405.4 µs to 3.825 ms, 5.04 ms to the end"."""
    phases = figures["contact_phases"][pair]
    spans = [f"{moment(start)} to {moment(end)}" for start, end in phases[:SPANS]]
    if phases and len(phases) <= SPANS and pair in figures.get("bearing_at_end", ()):
        spans[-1] = f"{moment(phases[-1][0])} to the end"
    more = f" and {len(phases) - SPANS} more" if len(phases) > SPANS else ""
    return ", ".join(spans) + more


def trusted(found: list[Finding]) -> bool:
    """Whether all is as it should be."""
    return all(finding.passed for finding in found)


def percent(value: float) -> str:
    """A share for people to read: "0.43 %", "2e-11 %"."""
    return f"{100.0 * value:.3g} %"


def _end(figures: dict[str, Any]) -> Finding:
    when = moment(figures["end_time"])
    if figures["status"] == "done":
        return Finding(True, "End", f"The run came to its end at {when}, after {figures['steps']} steps.")
    advice = figures["advice"]
    text = f"The run was {figures['status']} at {when}: {figures['reason']}."
    return Finding(False, "End", f"{text} To do: {advice}." if advice else text)


TOLD: dict[str, tuple[str, Callable[[float, float], str]]] = {
    "energy error": (
        "Energy balance",
        lambda value, limit: (
            f"Kinetic, internal, hourglass and contact energy less the work done from outside stay the same to "
            f"{percent(value)} of the largest energy in the run (limit {percent(limit)})."
        ),
    ),
    "momentum error": (
        "Momentum balance",
        lambda value, limit: (
            "The momentum of each body that is not held changes by the impulses on it, to "
            f"{percent(value)} (limit {percent(limit)})."
        ),
    ),
    "hourglass over internal energy": (
        "Hourglass energy",
        lambda value, limit: (
            f"Elements with one integration point bend against an artificial stiffness; it took at most "
            f"{percent(value)} of the largest internal energy (limit {percent(limit)})."
        ),
    ),
    "smallest J": (
        "Deformed elements",
        lambda value, limit: (
            f"The most compressed element kept {percent(value)} of its area (the elastic law and a cell follow down "
            f"to {percent(limit)})."
        ),
    ),
    "penetration over cell size": (
        "Penetration",
        lambda value, limit: (
            f"Bodies in contact overlap by at most {percent(value)} of a cell, the smaller of the two sides (limit "
            f"{percent(limit)}), at the points of the slave and at sharp corners of either."
        ),
    ),
}
"""The checks of the summary: what they look at, and how to say it."""


def _check(check: dict[str, Any]) -> Finding:
    """One of the checks by which the run itself is judged."""
    value, limit, passed = check["value"], check["limit"], bool(check["passed"])
    if check["name"] not in TOLD or value is None:
        text = f"{value if value is not None else 'not finite'} (limit {limit})."
        subject = check["name"].capitalize()
    else:
        subject, told = TOLD[check["name"]]
        text = told(value, limit)
    return Finding(passed, subject, text if passed else f"{text} To do: {check['advice']}.")


def _step(figures: dict[str, Any]) -> Finding:
    """The time step against the stable one, at the start and in the deformed state."""
    step, least = figures["dt"], figures["stable_step_min"]
    text = (
        f"Steps of {moment(step)}, set by: {figures['dt_set_by']}. In the deformed state the stable step fell to "
        f"{moment(least)}, {least / step:.3g} times the step taken."
    )
    if least >= step:
        return Finding(True, "Time step", text)
    cure = f"--set time.step={SAFE * least:.2g}"
    return Finding(False, "Time step", f"{text} Some steps were not stable: take a smaller one ({cure}).")


def _mesh(figures: dict[str, Any]) -> Iterator[Finding]:
    """What the grid makes of the drawing."""
    off = {name: abs(area["cut"] / area["cad"] - 1.0) for name, area in figures["area"].items()}
    worst = max(off, key=lambda name: off[name])
    counts = figures["counts"]
    text = (
        f"The bodies as cut have the area of the drawing to {percent(off[worst])} ({worst}). "
        f"{counts['cut']} of {counts['elements']} elements are cut; the smallest fragment is "
        f"{percent(counts['smallest_fraction'])} of its cell, which the step allows for; "
        f"{counts['phantom_nodes']} of {counts['nodes']} nodes are phantom nodes, "
        f"{counts['relocated_nodes']} were moved onto curves."
    )
    passed = off[worst] <= AREA
    yield Finding(passed, "Mesh", text if passed else f"{text} To do: take smaller cells.")
    yield from _walls(figures)
    for warning in figures["warnings"]:
        yield Finding(False, "Warning", f"{warning}.")
    for note in figures.get("notes", ()):
        yield Finding(True, "Drawing", f"{note}.")


def _walls(figures: dict[str, Any]) -> Iterator[Finding]:
    """Bodies with walls through which few cells go."""
    for name, wall in figures.get("thinnest_wall", {}).items():
        if wall["cells"] is None or wall["cells"] >= CELLS_ADVISED:
            continue
        text = (
            f"{wall['cells']:.2g} cells go through the thinnest wall of {name}, {wall['thickness']:.3g} m; "
            f"{CELLS_ADVISED} bend right."
        )
        passed = wall["cells"] >= THROUGH_WALL
        yield Finding(
            passed, "Walls", text if passed else f"{text} To do: smaller cells, if bending matters."
        )


def _added_mass(figures: dict[str, Any]) -> Iterator[Finding]:
    """Mass scaling, where there is any."""
    shares = {
        name: mass / figures["mass"][name] for name, mass in figures["added_mass"].items() if mass > 0.0
    }
    if shares:
        worst = max(shares, key=lambda name: shares[name])
        text = f"Mass was added for a larger step: at most {percent(shares[worst])} of a body ({worst})."
        yield Finding(shares[worst] <= ADDED, "Mass scaling", text)
