"""Whole runs of bundled cases as a user starts them, and where the time of their loops goes."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.case import load_case
from phantomnode.pipeline.preflight import steps_of
from phantomnode.pipeline.prepare import Prepared, prepare
from phantomnode.solver.explicit import Frame, frames
from phantomnode.solver.model import NO_POINTS, Contact, Model, State

from .measure import Figure, Plan, Process, alternating, duration, medians, python
from .stepping import from_state

Floats = NDArray[np.float64]

INSTANTS = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Where the loop is looked at, in parts of the run."""

LOOKED_AT = 1000
"""Steps that are timed at each of them."""

STILL = 1e-30
"""A step, s, in which nothing moves by as much as rounding."""

QUIET = ("output.fields.count=1", "output.history.count=1")
"""Hardly any output."""

PERCENT = ("output.fields.count=100", "output.history.count=100")
"""Output every 1 % of the steps."""


def command_line(name: str, overrides: Sequence[str]) -> tuple[Process, dict[str, Any]]:
    """``phantomnode run`` in a process of its own; the process and its summary.json."""
    with tempfile.TemporaryDirectory() as folder:
        options = [word for override in overrides for word in ("--set", override)]
        process = python("-m", "phantomnode", "run", name, "--out", folder, "--overwrite", *options)
        return process, json.loads((Path(folder) / "summary.json").read_text())


def whole(name: str, overrides: Sequence[str], plan: Plan) -> Iterator[Figure]:
    """The process, its loop, and what its output takes."""
    runs, quiet, loops = [], [], []
    for _ in range(plan.processes):
        process, summary = command_line(name, overrides)
        runs.append(process.seconds)
        loops.append(summary["step_loop_s"])
        quiet.append(command_line(name, (*overrides, *QUIET))[0].seconds)
    counts = summary["counts"]
    note = f"{summary['steps']} steps, {counts['elements']} elements, {counts['cut']} of them cut"
    yield duration(f"{name}, whole process", runs, note)
    yield Figure(f"{name}, its loop", None, float(np.median(loops)), "s", "with its frames, without output")
    shipped, least = medians(runs), medians(quiet)
    part = (100.0 * (a - b) / a for a, b in zip(shipped, least, strict=True))
    yield Figure(f"{name}, output", *part, "% of process", "as shipped, against two frames")


def output_share(name: str, overrides: Sequence[str], plan: Plan) -> Figure:
    """What output every 1 % of the steps adds to a whole process."""
    with_output, without = [], []
    for _ in range(plan.processes):
        with_output.append(command_line(name, (*overrides, *PERCENT))[0].seconds)
        without.append(command_line(name, (*overrides, *QUIET))[0].seconds)
    more, less = medians(with_output), medians(without)
    added = (100.0 * (a / b - 1.0) for a, b in zip(more, less, strict=True))
    return Figure(f"{name}, output every 1 %", *added, "% more", "than with two frames")


def shares(name: str, overrides: Sequence[str], step: Sequence[str], plan: Plan) -> Iterator[Figure]:
    """The rate of element updates in the loop and the loop's parts [a], at some instants of the run.

    ``step`` are overrides of the time step with which the run is led to these instants.
    """
    prepared = prepare(load_case(name, overrides))
    frames_at = instants(prepare(load_case(name, [*overrides, *step])))
    steps = plan.sized(LOOKED_AT, least=2)
    costs = np.mean([part_costs(prepared, frame.state, steps, plan) for frame in frames_at], axis=0)
    model = prepared.model
    updates = 1e-6 * steps * (len(model.elements.nodes) + len(model.cut_elements.nodes)) / float(costs[0])
    yield Figure(f"{name}, its loop", updates, None, "M updates/s", "[a]; cut elements count as one")
    parts = 100.0 * np.append(costs[:-1] - costs[1:], costs[-1]) / costs[0]
    for label, part in zip(PARTS, parts, strict=True):
        yield Figure(f"{name}, {label}", float(part), None, "% of loop", "[a]")


PARTS = ("search, other", "contact", "cut elements", "uncut elements", "motion")
"""What one of :func:`part_costs` has and the next one has not."""


def part_costs(prepared: Prepared, state: State, steps: int, plan: Plan) -> Floats:
    """(5,) CPU seconds of some steps: of the run itself, standing still, without contact, cut, all elements.

    Standing still is a step so short that nothing moves: the same forces are worked out in each.
    """
    first = round(float(state.clock[0]) / prepared.dt)
    moving = np.ascontiguousarray(prepared.motion.increments(first, steps, prepared.dt))
    actions = [from_state(prepared.model, state, prepared.dt, moving)]
    for model in thinned(prepared.model):
        actions.append(from_state(model, state, STILL, np.zeros_like(moving)))
    return np.array([medians(runs).cpu for runs in alternating(actions, plan.repeats)])


def instants(prepared: Prepared) -> list[Frame]:
    """Frames at those parts of a run."""
    at = np.unique(np.rint(np.array(INSTANTS) * steps_of(prepared)).astype(np.int64))
    stream = frames(prepared.model, prepared.velocity, prepared.dt, at, prepared.motion, np.inf)
    return list(stream)


def thinned(model: Model) -> tuple[Model, Model, Model, Model]:
    """A model; without contact; without cut elements, too; without any element."""
    apart = model._replace(contact=without_points(model.contact))
    uncut = apart._replace(cut_elements=NO_POINTS)
    return model, apart, uncut, uncut._replace(elements=model.elements.some(slice(0)))


def without_points(contact: Contact) -> Contact:
    """The contact pairs without slave points."""
    fields = ("slave_nodes", "slave_shape", "slave_weight", "offset", "slave_place", "slave_jump")
    none = {name: getattr(contact, name)[:0] for name in fields}
    return contact._replace(slave_first=np.zeros_like(contact.slave_first), **none)


def ring_impact(plan: Plan) -> Iterator[Figure]:
    """A ring thrown onto an obstacle, as shipped."""
    end = [] if plan.scale == 1.0 else [f"time.end={0.018 * plan.scale}"]
    yield from whole("ring_impact", end, plan)
    yield output_share("ring_impact", end, plan)
    yield from shares("ring_impact", end, [], plan)


def wavy_block(plan: Plan) -> Iterator[Figure]:
    """A block dragged over its lower half: 1e9 element updates, in contact all along."""
    end = [] if plan.scale == 1.0 else [f"time.end={0.2 * plan.scale}"]
    yield from whole("wavy_block", end, plan)
    yield from shares("wavy_block", end, ["time.step='auto'"], plan)
