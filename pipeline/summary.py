"""summary.json, and the table that answers whether a run can be trusted."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from phantomnode import __version__
from phantomnode.pipeline.census import areas, count, pair_penalty, placed, step_set_by, wall
from phantomnode.pipeline.drawing import moment
from phantomnode.pipeline.fields import Highest
from phantomnode.pipeline.files import write_atomically
from phantomnode.pipeline.observer import Ending
from phantomnode.pipeline.prepare import Prepared
from phantomnode.pipeline.scaling import added_mass
from phantomnode.pipeline.tally import Tally, pair_bodies, small_elements
from phantomnode.pipeline.trust import beyond_checks, contact_spans, remarks

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

ENERGY_ERROR = 0.01
"""A run that loses 1 % of its largest energy is to be looked at; with the automatic step a sound one stays
below 0.1 % and the energy error falls with the square of the step."""
MOMENTUM_ERROR = 1e-3
"""Contact forces are opposite to rounding, so that the impulse misses m dv only by the last half step."""
SMALLEST_J = 0.5
"""Hencky's law follows experiments for stretches of 0.7 to 1.3 (Anand, J. Appl. Mech. 46, 1979): 0.7 squared. What is
squeezed to less, mostly by a tip or in coarse cells, answers otherwise in smaller cells."""
PENETRATION = 0.25
"""Of the cell size: penalties of 1..10 E/h, which are sound, give less up to pressures of E/4, and the search
follows a point as deep as one cell."""
COARSE = 1.5
"""Times as large as those of the master: with such cells a body is better not the slave."""
UNSTRESSED = 1e-9
"""Of the largest energy of a run: bodies that store less are not strained but by rounding."""
HOURGLASS = 0.1
"""Of the largest internal energy: the usual limit for one-point elements."""


class Check(NamedTuple):
    """One line of the verdict: a figure, its limit, whether it keeps it, and what to do where it does not."""

    name: str
    value: float
    limit: float
    passed: bool
    advice: str


class Clock(NamedTuple):
    """Wall times, s: of the whole run, and of the steps alone (compiling included in a first run)."""

    wall: float
    steps: float


@dataclass(frozen=True)
class Summary:
    """The result of a run.

    Attributes
    ----------
    status : str
        "done", "stopped" (by a guard) or "interrupted".
    path : Path
        The results folder.
    figures : dict
        The content of summary.json.
    checks : tuple of Check
        What the verdict rests on; empty where the run ended before its first frame.
    """

    status: str
    path: Path
    figures: dict[str, Any]
    checks: tuple[Check, ...]

    @property
    def trusted(self) -> bool:
        """Whether the run came to its end, kept every limit, and nothing else is doubtful."""
        return self.status == "done" and all(check.passed for check in self.checks) and not self.doubts

    @property
    def doubts(self) -> list[str]:
        """What else than the checks wants a look, of a run that came to its end."""
        if self.status != "done":
            return []
        found = beyond_checks(self.figures)
        return [f"{finding.subject}: {finding.text}" for finding in found if not finding.passed]

    def write(self) -> None:
        """Write summary.json."""
        text = json.dumps(_plain(self.figures), indent=2, allow_nan=False, ensure_ascii=False)
        write_atomically(self.path / "summary.json", text + "\n")


def summarize(
    prepared: Prepared,
    tally: Tally,
    ending: Ending,
    clock: Clock,
    path: Path,
    source: Mapping[str, Any] | None = None,
    highest: Sequence[Highest] = (),
) -> Summary:
    """Everything that summary.json holds, from a run that has ended.

    ``source`` is where it comes from, ``highest`` has the highest stress of each body in the frames.
    """
    case, last = prepared.case, tally.last
    counts = count(prepared)
    steps = last.step if last is not None else 0
    figures: dict[str, Any] = {
        "version": __version__,
        **(source or {}),
        "status": ending.status,
        "reason": ending.reason,
        "advice": ending.advice,
        "case": case.name,
        "title": case.title,
        "steps": steps,
        "dt": prepared.dt,
        "dt_set_by": step_set_by(prepared),
        "dt_stable": prepared.estimate.dt,
        "end_time": last.time if last is not None else 0.0,
        "wall_s": clock.wall,
        "step_loop_s": clock.steps,
        "element_updates_per_s": steps * counts["elements"] / clock.steps if clock.steps > 0.0 else 0.0,
        "counts": counts,
        "area": {body.name: areas(body) for body in prepared.bodies},
        "thinnest_wall": {body.name: wall(body)._asdict() for body in prepared.bodies},
        "mass": {body.name: float(prepared.model.mass[body.nodes].sum()) for body in prepared.bodies},
        "added_mass": {body.name: added_mass(body, prepared.model) for body in prepared.bodies},
        "warnings": list(prepared.warnings),
        "notes": list(prepared.notes),
    }
    checks: tuple[Check, ...] = ()
    if last is not None:
        checks = run_checks(prepared, tally)
        figures |= outcome(prepared, tally)
        closing = [pair.name for k, pair in enumerate(prepared.pairs) if tally.still_closing(k)]
        # One that was stopped is told what to do for that.
        figures["still_closing"] = closing if ending.status == "done" else []
        figures["never_touches"] = _never_touching(prepared, tally) if ending.status == "done" else []
        figures["bearing_at_end"] = [pair.name for k, pair in enumerate(prepared.pairs) if tally.bearing(k)]
        named = [(body.name, one) for body, one in zip(prepared.bodies, highest, strict=False)]
        figures["highest_von_mises"] = {name: one.stress for name, one in named}
        figures["highest_von_mises_at"] = {
            name: {"time": one.time, "place": one.place} for name, one in named
        }
        figures["checks"] = [check._asdict() for check in checks]
    return Summary(ending.status, path, figures, checks)


def outcome(prepared: Prepared, tally: Tally) -> dict[str, Any]:
    """What came out of the run; it has at least one frame."""
    assert tally.first is not None and tally.last is not None
    last, momenta = tally.last, {body.name: tally.momentum(body) for body in prepared.bodies}
    velocities = {body.name: tally.velocity(body) for body in prepared.bodies}
    pairs = list(enumerate(pair.name for pair in prepared.pairs))
    return {
        "energies": last.energies._asdict(),
        "energies_start": tally.first.energies._asdict(),
        "energy_error_max": tally.energy_error_max,
        "hourglass_energy_max": tally.hourglass_max,
        "internal_energy_max": tally.internal_max,
        "alpha": {"elements": len(small_elements(prepared)), "energy_max": tally.alpha_energy_max},
        "smallest_J": tally.smallest_j,
        "stable_step_min": tally.stable_step,
        "peak_reaction": {
            boundary.name: float(peak)
            for boundary, peak in zip(prepared.boundaries, tally.peak_reaction, strict=True)
        },
        "peak_contact_force": {name: float(last.pair_peak[k]) for k, name in pairs},
        "slave": {pair.name: pair.slave for pair in prepared.pairs},
        "contact_impulse": {name: last.pair_impulse[k] for k, name in pairs},
        "penalty": {pair.name: pair_penalty(prepared, pair) for pair in prepared.pairs},
        "obstacles": {rigid.name: placed(rigid) for rigid in prepared.rigids},
        "contact_phases": {name: tally.phases(k) for k, name in pairs},
        "contact_touches": {name: tally.touches(k) for k, name in pairs},
        "largest_penetration": {name: float(tally.penetration[k]) for k, name in pairs},
        "momentum": {
            name: {
                "start": m.start,
                "end": m.end,
                "impulse": m.impulse,
                "error": m.error,
                "reaction": m.reaction,
            }
            for name, m in momenta.items()
        },
        "velocity": {name: {"start": start, "end": end} for name, (start, end) in velocities.items()},
    }


def run_checks(prepared: Prepared, tally: Tally) -> tuple[Check, ...]:
    """The figures by which a run is judged, worst body or pair of each."""
    limit = min(ENERGY_ERROR, prepared.case.guard.energy_error)
    stored = max(tally.internal_max, UNSTRESSED * tally.largest_energy)
    checks = [
        _below(
            "energy error",
            tally.energy_error_max,
            limit,
            "take a smaller step (--set time.step=...); if the error stays, look at the contact pairs",
        ),
        _below(
            "hourglass over internal energy",
            tally.hourglass_max / stored if stored > 0.0 else 0.0,
            HOURGLASS,
            "take smaller cells where the body bends",
        ),
        Check(
            "smallest J",
            tally.smallest_j,
            SMALLEST_J,
            tally.smallest_j >= SMALLEST_J,
            "an element is squeezed to less than the law or a cell can follow: run it with half the cells there and "
            "compare, or take a load that crushes less",
        ),
    ]
    errors = [error for body in prepared.bodies if (error := tally.momentum(body).error) is not None]
    if errors:
        advice = "a body gains momentum that nothing gives it: please report the case"
        checks.append(_below("momentum error", max(errors), MOMENTUM_ERROR, advice))
    if prepared.pairs:
        cells = np.array([_cells(prepared, k) for k in range(len(prepared.pairs))])  # of slave and master
        worst = int(np.argmax(tally.penetration / cells.min(axis=1)))
        deepest = tally.penetration[worst] / cells[worst].min()
        advice = _stiffer(prepared, worst, float(deepest))
        if cells[worst, 0] > COARSE * cells[worst, 1]:
            pair = prepared.pairs[worst]
            other = "; or passes = 2" if len(pair.passes) == 1 else ""
            advice = f"make {pair.master} the slave of {pair.name}: its cells are smaller{other}"
        elif tally.corner_depth[worst] == tally.penetration[worst]:
            felt = bool(prepared.pairs[worst].corners)
            cure = advice if felt else "leave out corners = false"
            advice = f"a sharp corner of the master sank in between two points of the slave: {cure}"
        checks.append(_below("penetration over cell size", float(deepest), PENETRATION, advice))
    return tuple(checks)


def _stiffer(prepared: Prepared, number: int, deepest: float) -> str:
    """The penalty that would leave half of what is allowed, the overlap being as it is times the penalty; to type."""
    pair = prepared.pairs[number]
    wanted = pair_penalty(prepared, pair) * max(deepest / (0.5 * PENETRATION), 1.0)
    return f"take a stiffer penalty (--set contact.{pair.name}.penalty={{value={wanted:.2g}}})"


def verdict(summary: Summary) -> RenderableType:
    """The panel shown at the end of a run: can it be trusted, and where the results are."""
    from rich.console import Group
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    figures, table = summary.figures, Table(box=None, pad_edge=False, show_header=False)
    for check in summary.checks:
        mark = Text("PASS", "bold green") if check.passed else Text("WARN", "bold yellow")
        sign = "above" if check.name == "smallest J" else "below"
        table.add_row(mark, check.name, f"{check.value:.3g}", f"({sign} {check.limit:g})")
    lines: list[RenderableType] = [table] if summary.checks else []
    lines += [Text(f"  {check.name}: {check.advice}") for check in summary.checks if not check.passed]
    lines += [Text(doubt, "yellow") for doubt in summary.doubts]
    if figures["reason"]:
        lines += [Text(f"{summary.status}: {figures['reason']}", "bold red")]
        # The command that goes on with a run is printed below, in one line, to be copied.
        lines += [Text(figures["advice"])] if summary.status == "stopped" else []
    lines += [Text(line) for line in highlights(figures)]
    lines += [Text(line) for line in _where(summary)]
    style = "green" if summary.trusted else "yellow" if summary.status == "done" else "red"
    heading = figures["title"] or figures["case"]
    return Panel(Group(*lines), title=f"{heading}: {summary.status}, {_heading(summary)}", border_style=style)


def highlights(figures: dict[str, Any]) -> list[str]:
    """What came out of a run in a few lines of text."""
    lines = []
    for name, phases in figures.get("contact_phases", {}).items():
        word = "phase" if len(phases) == 1 else "phases"
        never = (
            "never touches" if not any(figures["contact_impulse"][name]) else "touches between two samples"
        )
        spans = f"{len(phases)} {word} {contact_spans(figures, name)}" if phases else never
        lines.append(f"contact   {name}: {spans}")
        if phases:
            x, y = figures["contact_impulse"][name]
            lines.append(f"          impulse on {figures['slave'][name]} ({x:.4g}, {y:.4g}) N s/m")
            peak, depth = figures["peak_contact_force"][name], figures["largest_penetration"][name]
            lines.append(f"          peak force of a step {peak:.4g} N/m, overlap at most {depth:.3g} m")
        if name in figures.get("still_closing", ()):
            lines.append("          the two still move towards each other: time.end comes before they part")
    for name, velocity in figures.get("velocity", {}).items():
        start, end = (f"({v[0]:.4g}, {v[1]:.4g})" for v in (velocity["start"], velocity["end"]))
        lines.append(f"velocity  {name}: {start} -> {end} m/s, centre of mass")
    stresses = figures.get("highest_von_mises", {})
    for name, stress in ((name, stress) for name, stress in stresses.items() if stress):
        at = figures["highest_von_mises_at"][name]
        place = "({:.4g}, {:.4g})".format(*at["place"])
        text = f"von Mises up to {stress:.4g} Pa at {moment(at['time'])}, in {place} m of the undeformed body"
        lines.append(f"stress    {name}: {text}")
    lines.append(
        f"steps     {figures['steps']} of {figures['dt']:.3g} s in {figures['step_loop_s']:.1f} s "
        f"({figures['element_updates_per_s'] / 1e6:.1f} million element updates/s), "
        f"{figures['wall_s']:.1f} s in all"
    )
    return lines


def _below(name: str, value: float, limit: float, advice: str) -> Check:
    """A check that a figure keeps below its limit."""
    return Check(name, value, limit, value <= limit, advice)


def _cells(prepared: Prepared, pair: int) -> tuple[float, float]:
    """Sizes of the median cells of slave and master, m, on which a penetration is small or not.

    An obstacle has none; that of the slave stands for it.
    """
    slave, master = pair_bodies(prepared, pair)
    return slave.grid.typical_size, (master or slave).grid.typical_size


def _never_touching(prepared: Prepared, tally: Tally) -> list[str]:
    """Pairs of different bodies, or of one and an obstacle, that have borne no force."""
    last, sides = tally.last, (pair_bodies(prepared, k) for k in range(len(prepared.pairs)))
    assert last is not None
    return [
        pair.name
        for k, (pair, (slave, master)) in enumerate(zip(prepared.pairs, sides, strict=True))
        if slave is not master and not np.any(last.pair_impulse[k])
    ]


def _plain(value: Any) -> Any:
    """Numbers and lists that JSON knows; what is not finite becomes null."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list | np.ndarray):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def show(console: Console, summary: Summary) -> None:
    """Print the verdict: a panel on a terminal, plain lines that nothing wraps in a log."""
    if console.is_terminal:
        console.print(verdict(summary))
        return
    title = summary.figures["title"] or summary.figures["case"]
    heading = f"{title}: {summary.status}, {_heading(summary)}"
    for line in (heading, *verdict_lines(summary), *_where(summary)):
        console.print(line, soft_wrap=True, markup=False, highlight=False)


def verdict_lines(summary: Summary) -> list[str]:
    """The verdict as lines of text, for logs."""
    figures = summary.figures
    lines = [f"status: {summary.status}", *(text for text in (figures["reason"], figures["advice"]) if text)]
    for item in summary.checks:
        word = "PASS" if item.passed else f"WARN ({item.advice})"
        lines.append(f"{item.name}: {item.value:.3g} (limit {item.limit:g}) {word}")
    return [*lines, *summary.doubts, *highlights(figures)]


def _where(summary: Summary) -> list[str]:
    """Where the results are, and how to look at them."""
    path = summary.path
    return [
        f"results   {path}",
        f"look at   {path / 'peak.png'}, the stress when most energy is stored",
        f"          phantomnode report {path}",
        f"          paraview {path / 'fields.pvd'}",
    ]


def _heading(summary: Summary) -> str:
    word = "can be trusted" if summary.trusted else "look before you trust it"
    return "; ".join([word, *(remarks(summary.figures) if summary.status == "done" else ())])
