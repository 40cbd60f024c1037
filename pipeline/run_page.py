"""The page of one run: what was run, whether it can be trusted, what came out, in pictures and charts."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from phantomnode.pipeline.curve_pictures import bearing_times, draw_pressure
from phantomnode.pipeline.drawing import moment, readable
from phantomnode.pipeline.field_pictures import draw_field
from phantomnode.pipeline.messages import shown
from phantomnode.pipeline.packing import Packed
from phantomnode.pipeline.page_charts import history_charts, pressure_charts
from phantomnode.pipeline.pages import Picture, Table, picture_in, picture_of, render, titled
from phantomnode.pipeline.results import Results
from phantomnode.pipeline.trust import Finding, contact_spans, findings, remarks, trusted
from phantomnode.pipeline.view_data import view_data

NO_PART = 1e-4
"""Of the largest part of some vectors: a part that is smaller is none, for people."""

FAR_MORE = 1.3
"""Times the largest contact force in a frame: a larger one between frames is worth a word."""

UNENDED = Finding(
    False,
    "End",
    "The run has not ended: it is under way, or was killed; phantomnode run DIR --resume goes on with it.",
)


def run_page(
    results: Results, drawn: Sequence[Path] = (), variants: Table | None = None, laid: Packed | None = None
) -> str:
    """The page.

    Parameters
    ----------
    results : Results
    drawn : sequence of Path
        Figures and profiles of the run and its variants.
    variants : Table, optional
        The run and its variants beside each other.
    laid : dict, optional
        Their histories over each other, of :func:`phantomnode.pipeline.page_charts.overlay`.

    Raises
    ------
    CaseError
        Where a file of the results cannot be read.
    """
    figures = results.summary
    found = findings(figures) if figures else [UNENDED]
    view = view_data(results)
    times = view["times"] if view else [float(results.times[results.nearest("peak")])]
    data = {
        "view": view,
        "start": view["start"] if view else 0,
        "histories": history_charts(results),
        "overlay": laid,
        "pressures": pressure_charts(results, times),
    }
    return render(
        "run.html",
        data,
        title=results.title,
        trusted=trusted(found),
        status=f"Run {figures.get('status', 'not ended')}",
        lead=_lead(found, remarks(figures)),
        bodies=list(_bodies(results)),
        acting=list(_acting(results)),
        findings=found,
        outcome=list(_outcome(figures)),
        view=view is not None,
        view_every=view["every"] if view else 1,
        frames=len(results.times),
        pictures=[*_pictures(results), *(picture_in(file, titled(file)) for file in drawn)],
        variants=variants,
        overlay_note=laid["note"] if laid else "",
        timings=list(_timings(figures)),
        provenance=list(_provenance(results)),
        case_file=(results.path / "case.toml").read_text(encoding="utf-8"),
    )


def _lead(found: list[Finding], besides: Sequence[str]) -> str:
    """What is to be looked at, in one line, and what the verdict says besides."""
    bad = [finding.subject.lower() for finding in found if not finding.passed]
    text = f"To look at: {', '.join(bad)}." if bad else "Every check is kept; the figures are below."
    return f"{text} The run: {'; '.join(besides)}." if besides else text


def _bodies(results: Results) -> Iterator[dict[str, str]]:
    """Each body in a sentence or two."""
    figures, table = results.summary, results.table
    for name, body in table["body"].items():
        material = table["material"][body["material"]]
        stiff, unit = readable(material["E"], "Pa")
        text = (
            f"{_shape(body['geometry'])}; {body['material']}: E = {material['E'] * stiff:g} {unit}, "
            f"ν = {material['nu']:g}, ρ = {material['rho']:g} kg/m³; {_grid(table, body)}"
        )
        if any(body["initial_velocity"]):
            text += "; starts at ({:g}, {:g}) m/s".format(*body["initial_velocity"])
        if "area" in figures:
            text += f"; {figures['area'][name]['cut']:.5g} m², {figures['mass'][name]:.5g} kg a metre of thickness"
        yield {"name": name, "text": f"{text}."}


def _shape(geometry: dict[str, Any]) -> str:
    """Where the outline comes from."""
    if "file" in geometry:
        return f"outline from {geometry['file']}"
    return next(kind for kind in ("rectangle", "circle", "ring", "polygon") if kind in geometry)


def _grid(table: dict[str, Any], body: dict[str, Any]) -> str:
    """The grid of a body."""
    grid = body["grid"]
    if isinstance(grid, str):
        grid = table["grid"][grid]
    if "file" in grid:
        return f"grid from {grid['file']}"
    size = f"cells of {shown(grid['cell'])} m" if "cell" in grid else f"{shown(grid.get('counts'))} cells"
    return f"{grid['kind']} grid, {size}"


def _acting(results: Results) -> Iterator[str]:
    """Contact pairs, obstacles, boundaries, gravity."""
    table, figures = results.table, results.summary
    for name, pair in table.get("contact", {}).items():
        rubbing = f"friction {pair['friction']:g}" if pair["friction"] else "no friction"
        stiff = f" ({figures['penalty'][name]:.4g} Pa/m)" if name in figures.get("penalty", {}) else ""
        yield f"Contact {name}: {pair['slave']} on {pair['master']}, {rubbing}, penalty {_penalty(pair)}{stiff}."
    for name in table.get("rigid", {}):
        yield f"Rigid obstacle {name}{_place(figures.get('obstacles', {}).get(name))}."
    for name, boundary in table.get("boundary", {}).items():
        kinds = ("displacement", "velocity", "acceleration", "traction", "pressure")
        kind = next(kind for kind in kinds if kind in boundary)
        yield f"Boundary {name}: {kind} {_directions(boundary[kind])} on {_words(boundary['on'])}."
    if any(table.get("gravity", ())):
        yield f"Gravity {shown(table['gravity'])} m/s²."
    method = "phantom nodes" if table.get("method", "phantom") == "phantom" else "classic X-FEM"
    yield f"To {moment(table['time']['end'])}, by {method}, in plane strain; all forces are per metre of thickness."


def _place(obstacle: dict[str, Any] | None) -> str:
    """Where an obstacle is: its kind, and its box."""
    if obstacle is None:
        return ""
    kind = "closed" if obstacle["closed"] else "an open curve"
    extent = max(high - low for low, high in zip(obstacle["low"], obstacle["high"], strict=True))
    low, high = (_vector(obstacle[end], extent) for end in ("low", "high"))
    return f": {kind}, from {low} to {high} m"


def _penalty(pair: dict[str, Any]) -> str:
    """The penalty of a pair: "auto", "100 E", "1e+12 Pa/m"."""
    penalty = pair.get("penalty", "auto")
    if isinstance(penalty, str):
        return penalty
    if "times_auto" in penalty:
        return f"{penalty['times_auto']:g} times auto"
    return f"{penalty['times_E']:g} E" if "times_E" in penalty else f"{penalty['value']:g} Pa/m"


def _directions(value: Any) -> str:
    """Values in x and y, or a single one: "x = 0, y = -0.1*t"."""
    if isinstance(value, dict) and "t" not in value:
        return ", ".join(f"{axis} = {_words(one)}" for axis, one in value.items())
    return _words(value)


def _words(value: Any) -> str:
    """A value of a case: text without its quotes, numbers in a few digits."""
    if isinstance(value, str):
        return value
    return f"{value:g}" if isinstance(value, int | float) else shown(_short(value))


def _short(value: Any) -> Any:
    """A value of a case, its numbers without the digits of rounding: 0.015 for 0.015000000000000001."""
    if isinstance(value, dict):
        return {key: _short(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_short(one) for one in value]
    return float(f"{value:.7g}") if isinstance(value, float) else value


def _vector(vector: Sequence[float], largest: float) -> str:
    """The two parts of a vector, without what is only rounding beside the largest one: "(0, -20)"."""
    return "({:.4g}, {:.4g})".format(*(part if abs(part) > NO_PART * largest else 0.0 for part in vector))


def _largest(*vectors: Sequence[float]) -> float:
    return max(abs(part) for vector in vectors for part in vector)


def _outcome(figures: dict[str, Any]) -> Iterator[str]:
    """Contact phases, forces, velocities and stresses."""
    for name, phases in figures.get("contact_phases", {}).items():
        peak, unit = readable(figures["peak_contact_force"][name], "N/m")
        touches = len(figures["contact_touches"][name])
        breaks = f" (in {touches} touches; breaks that end before a wave has crossed the slave's body do not count)"
        none = "touches between two samples" if any(figures["contact_impulse"][name]) else "never touches"
        touched = f"touches {contact_spans(figures, name)}" if phases else none
        yield f"{name} {touched}{breaks if touches > len(phases) else ''}."
        if phases:
            impulse, slave = figures["contact_impulse"][name], figures.get("slave", {}).get(name, "the slave")
            yield (
                f"{name}: impulse on {slave} {_vector(impulse, _largest(impulse))} N s/m; peak force "
                f"{figures['peak_contact_force'][name] * peak:.4g} {unit}, that of a single step: compare runs by "
                f"their impulses. The two overlap by at most {_depth(figures, name)}."
            )
        if name in figures.get("still_closing", ()):
            yield f"{name}: the two still move towards each other at the end; a larger time.end shows the rebound."
    for name, peak_force in figures.get("peak_reaction", {}).items():
        if name in figures.get("obstacles", {}):
            continue  # it bears what its contact pairs give it
        factor, unit = readable(peak_force, "N/m")
        yield f"Reaction at {name}: at most {peak_force * factor:.4g} {unit} in the rows of the history."
    for name, momentum in figures.get("momentum", {}).items():
        reaction = momentum.get("reaction", (0.0, 0.0))
        if any(reaction):
            yield f"{name}: impulse of what holds or moves it {_vector(reaction, _largest(reaction))} N s/m."
    for name, velocity in figures.get("velocity", {}).items():
        largest = _largest(*velocity.values())
        start, end = (_vector(velocity[when], largest) for when in ("start", "end"))
        yield f"{name}: velocity of the centre of mass {start} m/s at the start, {end} m/s at the end."
    yield from _stresses(figures)


def _stresses(figures: dict[str, Any]) -> Iterator[str]:
    """The highest stress of each body, and what it does not say."""
    named = [(name, stress) for name, stress in figures.get("highest_von_mises", {}).items() if stress]
    for name, stress in named:
        factor, unit = readable(stress, "Pa")
        at = figures["highest_von_mises_at"][name]
        place = "({:.4g}, {:.4g})".format(*at["place"])
        yield (
            f"{name}: von Mises stress up to {stress * factor:.4g} {unit}, at {moment(at['time'])}, in {place} m of "
            "the undeformed body."
        )
    if named:
        yield (
            "Stresses are means of cells, as drawn, in the frames that are written. Under a tip, beside a notch or "
            "where round bodies touch they grow with smaller cells: compare runs of two sizes. The law is elastic at "
            "any stress: compare them with the yield stress of the material."
        )


def _depth(figures: dict[str, Any], pair: str) -> str:
    """How deep a pair penetrates, with a unit."""
    factor, unit = readable(figures["largest_penetration"][pair], "m")
    return f"{figures['largest_penetration'][pair] * factor:.3g} {unit}"


def _pictures(results: Results) -> Iterator[Picture]:
    """The bodies at the peak, and the contact pressures at some times."""
    frame = results.frame("peak")
    caption = f"von Mises stress at {moment(frame.time)}, the frame of the largest internal energy"
    yield picture_of(draw_field(frame, "von_mises", results.title), caption)
    for pair in results.pairs:
        if times := bearing_times(results, pair):
            yield picture_of(
                draw_pressure(results, pair, times), f"Contact pressure of {pair}{_missed(results, pair)}"
            )


def _missed(results: Results, pair: str) -> str:
    """That the largest force of a pair is between frames, where none of them has nearly as much."""
    history = results.history
    size = np.hypot(history[f"contact.{pair}.fx"], history[f"contact.{pair}.fy"])
    seen = float(np.interp(results.times, history.time, size).max())
    if size.max() <= FAR_MORE * seen:
        return ""
    factor, unit = readable(float(size.max()), "N/m")
    when = moment(float(history.time[np.argmax(size)]))
    return (
        f"; the largest force, {size.max() * factor:.3g} {unit} at {when}, is between the frames: more of them "
        "(output.fields.count) would show it"
    )


def _timings(figures: dict[str, Any]) -> Iterator[str]:
    """Wall times and rates."""
    if not figures:
        yield "They are known when the run has ended."
        return
    counts, rate = figures["counts"], figures["element_updates_per_s"]
    yield (
        f"{figures['wall_s']:.3g} s in all, {figures['step_loop_s']:.3g} s of them {figures['steps']} steps "
        "(the first run of a version compiles the kernels)."
    )
    yield f"{rate / 1e6:.3g} million element updates a second, on {figures['provenance']['threads']} thread(s)."
    yield f"{counts['elements']} elements, {counts['nodes']} nodes, {counts['contact_points']} contact points."


def _provenance(results: Results) -> Iterator[tuple[str, str]]:
    """Version, command, machine, packages, hash."""
    figures = results.summary
    if figures:
        source = figures["provenance"]
        yield "version", f"phantomnode {figures['version']}"
        if source["command"]:
            yield "command", shlex.join(source["command"])
        yield "case", f"{figures['case']}, SHA-256 {figures['case_hash']}"
        machine = source["machine"]
        yield "machine", f"{machine['processor']}, {machine['cores']} cores, {machine['system']}"
        packages = ", ".join(f"{name} {version}" for name, version in source["packages"].items())
        yield "packages", f"Python {source['python']}, {packages}"
        if figures["resumed_at"]:
            yield "resumed at", ", ".join(moment(time) for time in figures["resumed_at"])
    yield "folder", results.path.resolve().name
