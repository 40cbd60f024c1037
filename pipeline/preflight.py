"""The report of ``check``: what a case became, and what running it will take."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from phantomnode.geometry.doubling import CutMesh
from phantomnode.pipeline.census import Wall, areas, doubled_cells, pair_penalty, step_set_by, wall
from phantomnode.pipeline.closing import apart, closing_velocity, flies_on, meeting_time
from phantomnode.pipeline.coarse import coarse_slaves
from phantomnode.pipeline.drawing import moment
from phantomnode.pipeline.gaps import Gap, initial_gaps
from phantomnode.pipeline.prepare import Body, Floats, Prepared
from phantomnode.pipeline.scaling import added_mass
from phantomnode.pipeline.trust import CELLS_ADVISED, THROUGH_WALL

if TYPE_CHECKING:
    from rich.console import RenderableType

UNCUT_COST, POINT_COST, CONTACT_COST = 4e-8, 5e-8, 3e-8
"""Wall time of an uncut element, an integration point of a cut one and a slave point in one step, s; of the
order that one core takes, for an estimate."""


CELL_BYTES = {
    ("zlib", "float32"): 60.0, ("lz4", "float32"): 78.0, ("none", "float32"): 126.0,
    ("zlib", "float64"): 116.0, ("lz4", "float64"): 140.0, ("none", "float64"): 220.0,
}  # fmt: skip
"""Bytes of a frame for each cell that is drawn, measured with tests/benchmarks; LINE_BYTES for a slave segment."""

LINE_BYTES = 60.0

PAIR_COLUMNS = (
    "contact", "slave", "master", "segments", "points", "corners", "penalty, Pa/m", "friction", "gap, m", "meets at",
)  # fmt: skip

MANY = 20.0
"""Cells through a wall from which on it is none: the body is massive."""

PROCESS_BYTES, NODE_BYTES = 2.7e8, 520.0
"""Memory of a run that is tiny, and beyond the model's own arrays for each node: the cut meshes, the states of the
run and of the frames on their way, output and its pictures; measured with tests/benchmarks."""


def steps_of(prepared: Prepared) -> int:
    """Number of steps to the end of the case; the last one may reach past it by less than a step."""
    return max(1, int(np.ceil(prepared.case.time.end / prepared.dt - 1e-9)))


def estimated_time(prepared: Prepared) -> float:
    """Wall time of the steps, s, on one core of today; good to a factor of two or three."""
    model = prepared.model
    step = (
        UNCUT_COST * len(model.elements.nodes)
        + POINT_COST * len(model.cut_elements.weight)
        + CONTACT_COST * len(model.contact.slave_weight)
    )
    return steps_of(prepared) * step


def estimated_memory(prepared: Prepared) -> float:
    """Bytes of a whole run at its peak; good to a quarter."""
    return (
        PROCESS_BYTES
        + sum(array.nbytes for array in _arrays(prepared.model))
        + NODE_BYTES * len(prepared.model.x)
    )


def step_place(prepared: Prepared) -> Floats:
    """(2,) The middle of the material of the element that sets the stable step, m."""
    model, number = prepared.model, prepared.estimate.element
    uncut = len(model.elements.nodes)
    if number < uncut:
        return np.asarray(model.x[model.elements.nodes[number]].mean(axis=0))
    body = next(each for each in prepared.bodies if number - uncut < each.cut_elements.stop)
    cut = np.flatnonzero(body.mesh.cut)
    return element_place(body.mesh, int(cut[number - uncut - body.cut_elements.start]))


def element_place(mesh: CutMesh, element: int) -> Floats:
    """(2,) The middle of the material of an element of a body, m."""
    own = mesh.triangles[mesh.triangle_element == element]
    if len(own) == 0:
        return np.asarray(mesh.xy[mesh.elements[element]].mean(axis=0))
    a, b = own[:, 1] - own[:, 0], own[:, 2] - own[:, 0]
    area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return np.asarray(np.average(own.mean(axis=1), axis=0, weights=area))


def estimated_disk(prepared: Prepared) -> float:
    """Bytes of the results, most of them frames; good to a fifth where everything moves, less is written before."""
    output, steps = prepared.case.output, steps_of(prepared)
    way = output.fields.compression, output.fields.precision
    drawn = len(prepared.model.elements.nodes) + sum(len(body.mesh.triangles) for body in prepared.bodies)
    frame = 2000.0 + CELL_BYTES[way] * drawn
    frame += LINE_BYTES * sum(len(pair.segment_nodes) for pair in prepared.pairs)
    rows, row = min(output.history.count, steps) + 1, 15.0 * (12 + 16 * len(prepared.bodies))
    checkpoints = 2.0 * 9 * 8 * len(prepared.model.x)
    picture = 2e5
    return (min(output.fields.count, steps) + 1) * frame + rows * row + checkpoints + picture


def threads_told(prepared: Prepared, asked: int, used: int) -> str:
    """Why fewer threads take part in the steps than were asked for, in a line."""
    from phantomnode.solver.layout import STRIP_ELEMENTS

    if prepared.xfem is not None:
        why = "classic X-FEM runs on one"
    elif len(prepared.model.full.weight):
        why = 'integration.uncut = "full" runs on one'
    else:
        why = (
            f"each needs {2 * STRIP_ELEMENTS:,} uncut elements, of {len(prepared.model.elements.kind):,} here"
        )
    return f"threads   {used} of {asked}: {why}"


def variant_row(name: str, variant: Prepared) -> tuple[str, ...]:
    """What a variant of a case would take: its name, steps, the step, time on one core, and what is doubtful."""
    steps, needed = f"{steps_of(variant)}", f"about {_duration(estimated_time(variant))}"
    return name, steps, f"{variant.dt:.4g} s", needed, "; ".join(_advice(variant))


def report(prepared: Prepared, variants: Sequence[tuple[str, ...]] = ()) -> RenderableType:
    """The preflight report: bodies, contact pairs, boundaries, the step and what the run will take.

    ``variants`` are those of the case, rows of :func:`variant_row`.
    """
    from rich.console import Group

    walls, gaps = [wall(body) for body in prepared.bodies], _gaps(prepared)
    parts: list[RenderableType] = [
        _table(("body", "", *(b.name for b in prepared.bodies)), _body_rows(prepared, walls))
    ]
    if prepared.pairs:
        parts.append(
            _table(
                PAIR_COLUMNS,
                _pair_rows(prepared, gaps),
            )
        )
    if prepared.boundaries:
        parts.append(_table(("boundary", "nodes", "holds"), _boundary_rows(prepared)))
    parts.append(_table(("run", ""), _run_rows(prepared)))
    if variants:
        parts.append(_table(("variant", "steps", "step", "time", "to look at"), iter(variants)))
    notes = (f"note    {_escaped(text)}" for text in prepared.notes)
    warnings = (f"[yellow]warning[/] {_escaped(text)}" for text in _advice(prepared, walls, gaps))
    return Group(*parts, *notes, *warnings)


def _gaps(prepared: Prepared) -> list[tuple[Gap | None, float]]:
    """The gap of each pair, and when it closes."""
    return [(gap, _meets(prepared, number, gap)) for number, gap in enumerate(initial_gaps(prepared))]


def _advice(
    prepared: Prepared, walls: list[Wall] | None = None, gaps: list[tuple[Gap | None, float]] | None = None
) -> list[str]:
    """What wants a look before the run; ``walls`` and ``gaps`` are found unless given."""
    return [
        *prepared.warnings,
        *_thin_walls(prepared, walls or [wall(body) for body in prepared.bodies]),
        *coarse_slaves(prepared),
        *_never_or_late(prepared, _gaps(prepared) if gaps is None else gaps),
    ]


def _meets(prepared: Prepared, number: int, gap: Gap | None) -> float:
    """When a pair meets by the first velocities, s; infinite where it never does."""
    return np.inf if gap is None else meeting_time(prepared, number, gap)


def _never_or_late(prepared: Prepared, gaps: list[tuple[Gap | None, float]]) -> Iterator[str]:
    """A warning of each pair that, by the first velocities, never meets or meets after the end of the run."""
    end = prepared.case.time.end
    if not flies_on(prepared):
        return  # gravity, a load or a motion of its own may bring a body there, or earlier
    for number, (pair, (gap, time)) in enumerate(zip(prepared.pairs, gaps, strict=True)):
        if end < time < np.inf:
            yield f"contact {pair.name}: the two meet at {moment(time)}, after the end of the run, {moment(end)}"
        elif (
            time == np.inf
            and gap is not None
            and apart(prepared, gap)
            and closing_velocity(prepared, number).any()
        ):
            yield f"contact {pair.name}: by their first velocities the two never meet: something must turn them"


def _thin_walls(prepared: Prepared, walls: list[Wall]) -> Iterator[str]:
    """A warning of each body whose walls take fewer cells than bend right."""
    for body, (thickness, cells) in zip(prepared.bodies, walls, strict=True):
        if cells < THROUGH_WALL:
            yield (
                f"body {body.name}: {cells:.2g} cells go through its thinnest wall, {thickness:.3g} m; "
                f"{CELLS_ADVISED} bend right (cell = {thickness / CELLS_ADVISED:.2g})"
            )


def text_report(prepared: Prepared) -> str:
    """The same as plain text, for run.log."""
    from io import StringIO

    from rich.console import Console

    console = Console(file=StringIO(), width=110, no_color=True, highlight=False)
    console.print(report(prepared))
    return console.file.getvalue()  # type: ignore[attr-defined, no-any-return]


def _body_rows(prepared: Prepared, walls: list[Wall]) -> Iterator[tuple[str, ...]]:
    """One row a figure, one column a body."""
    bodies = prepared.bodies

    def row(name: str, unit: str, values: list[str]) -> tuple[str, ...]:
        return (name, unit, *values)

    yield row("area by CAD", "m^2", [f"{areas(body)['cad']:.8g}" for body in bodies])
    yield row("area as cut", "m^2", [f"{areas(body)['cut']:.8g}" for body in bodies])
    yield row("difference", "", [f"{areas(b)['cut'] / areas(b)['cad'] - 1.0:.1e}" for b in bodies])
    yield row("mass", "kg/m", [f"{prepared.model.mass[body.nodes].sum():.6g}" for body in bodies])
    added = [added_mass(body, prepared.model) for body in bodies]
    if any(added):
        yield row("of it added", "kg/m", [f"{mass:.3g}" for mass in added])
    yield row("grid cells", "", [str(body.grid.cell_count) for body in bodies])
    yield row("thinnest wall", "m", [f"{each.thickness:.3g}" if each.cells < MANY else "-" for each in walls])
    yield row(
        "cells through it", "", [f"{each.cells:.2g}" if each.cells < MANY else "many" for each in walls]
    )
    yield row("elements", "", [str(len(body.mesh.elements)) for body in bodies])
    yield row("cut", "", [str(np.count_nonzero(body.mesh.cut)) for body in bodies])
    yield row("cells doubled", "", [str(doubled_cells(body)) for body in bodies])
    yield row("connected parts", "", [str(_parts(body)) for body in bodies])
    yield row("nodes", "", [str(len(body.mesh.xy)) for body in bodies])
    yield row("phantom nodes", "", [str(np.count_nonzero(~body.mesh.real)) for body in bodies])
    yield row("nodes relocated", "", [str(body.relocated) for body in bodies])
    yield row("smallest fraction", "of a cell", [f"{body.mesh.fraction.min():.3g}" for body in bodies])


def _pair_rows(prepared: Prepared, gaps: list[tuple[Gap | None, float]]) -> Iterator[tuple[str, ...]]:
    """One row a pair, with its gap and the time at which it meets."""
    first = prepared.model.contact.slave_first
    for pair, (gap, time) in zip(prepared.pairs, gaps, strict=True):
        corners = sum(int(first[k + 1] - first[k]) for k in pair.corners)
        counts = str(len(pair.segment_nodes)), str(pair.points.stop - pair.points.start), str(corners)
        stiffness = f"{pair_penalty(prepared, pair):.4g}" + (" (two passes)" if len(pair.passes) == 2 else "")
        apart = "-" if gap is None else f"{gap.distance:.3g}"  # self contact has none
        meets = moment(time) if time < np.inf else "-"
        yield pair.name, pair.slave, pair.master, *counts, stiffness, f"{pair.friction:g}", apart, meets


def _boundary_rows(prepared: Prepared) -> Iterator[tuple[str, ...]]:
    for boundary in prepared.boundaries:
        held = " and ".join(
            axis for axis, channel in zip("xy", boundary.channels, strict=True) if channel >= 0
        )
        what = {
            "held": held,
            "weak": f"{held}, by springs of {boundary.penalty:.4g} Pa/m",
            "load": "nothing: a load",
        }
        obstacle = boundary.name in prepared.case.rigid
        yield boundary.name, str(len(boundary.nodes)), "a rigid obstacle" if obstacle else what[boundary.kind]


def _run_rows(prepared: Prepared) -> Iterator[tuple[str, ...]]:
    place = ""
    if prepared.xfem is None:
        place = " at ({:.4g}, {:.4g}) m".format(*step_place(prepared))
    stable = prepared.estimate.dt / prepared.case.time.safety
    yield "stable step", f"{stable:.4g} s, set by {_escaped(step_set_by(prepared))}{place}"
    yield "step taken", f"{prepared.dt:.4g} s"
    yield "steps", f"{steps_of(prepared)} to {prepared.case.time.end:g} s"
    yield "time needed", f"about {_duration(estimated_time(prepared))} on one core"
    yield "memory", f"about {_bytes(estimated_memory(prepared))} at the peak"
    frames = min(prepared.case.output.fields.count, steps_of(prepared)) + 1
    yield "disk", f"about {_bytes(estimated_disk(prepared))}, for {frames} frames and two checkpoints"


def _table(columns: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> RenderableType:
    from rich.table import Table

    table = Table(*columns, box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for row in rows:
        table.add_row(*row)
    table.add_row()
    return table


def _parts(body: Body) -> int:
    """Number of connected parts of a body."""
    return len(np.unique(body.mesh.component))


def _arrays(value: Any) -> Iterator[np.ndarray[Any, Any]]:
    """All arrays in nested tuples."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from _arrays(item)


def _bytes(size: float) -> str:
    """A size that people read: "3.2 MB"."""
    for unit in ("kB", "MB", "GB"):
        size /= 1e3
        if size < 999.5:
            return f"{size:.2g} {unit}" if size < 10.0 else f"{size:.0f} {unit}"
    return f"{size / 1e3:.2g} TB"


def _duration(seconds: float) -> str:
    """A time that people read: "40 s", "3.5 min", "2.1 h"."""
    if seconds < 90.0:
        return f"{max(seconds, 1.0):.0f} s"
    return f"{seconds / 60.0:.1f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


def _escaped(text: str) -> str:
    from rich.markup import escape

    return escape(text)
