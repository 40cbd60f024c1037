"""Fields for ParaView: what a frame of 1e5 cells takes, and how large it is."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from phantomnode.pipeline.case import load_case
from phantomnode.pipeline.fields import Fields
from phantomnode.pipeline.prepare import Prepared, prepare
from phantomnode.pipeline.schema import FieldFrames
from phantomnode.solver.explicit import Frame, frames

from .measure import Figure, Plan, clocked, medians, spread

CELLS, FRAMES, STATES = 1e5, 100, 10
"""Cells of the two bodies, frames that are written, and states of the run that they show in turns."""

ENDS = 1.2e-3
"""s: the ring has been in contact for 0.8 ms, and waves are everywhere."""

ENCODINGS = {
    "as shipped": {},
    "lz4": {"compression": "lz4"},
    "not compressed": {"compression": "none"},
    "float64": {"precision": "float64"},
}


def output(plan: Plan) -> Iterator[Figure]:
    """Frames of ring_impact by each encoding, the disk included."""
    prepared, states = ring(plan)
    count = max(len(states), plan.sized(FRAMES))
    for name, keys in ENCODINGS.items():
        yield from frames_written(prepared, states, count, name, FieldFrames(count=count, **keys))


def ring(plan: Plan) -> tuple[Prepared, list[Frame]]:
    """ring_impact with so many cells, and some of its states."""
    part = np.sqrt(plan.sized(CELLS) / CELLS)
    cells = (f"body.ring.grid.cell={1.92e-3 / part}", f"body.obstacle.grid.cell={3.66e-3 / part}")
    prepared = prepare(load_case("ring_impact", (f"time.end={ENDS}", *cells)))
    at = np.linspace(0.5, 1.0, STATES) * ENDS / prepared.dt
    stream = frames(
        prepared.model, prepared.velocity, prepared.dt, np.unique(at.astype(np.int64)), prepared.motion, 0.05
    )
    return prepared, list(stream)


def frames_written(
    prepared: Prepared, states: list[Frame], count: int, name: str, fields: FieldFrames
) -> Iterator[Figure]:
    """Time and size of a frame."""
    case = prepared.case.model_copy(
        update={"output": prepared.case.output.model_copy(update={"fields": fields})}
    )
    chosen = replace(prepared, case=case)
    with tempfile.TemporaryDirectory() as folder:
        files = Fields(chosen, Path(folder), frozenset())
        files.take(states[0])
        runs = [
            clocked(lambda number=number: files.take(states[number % len(states)]))
            for number in range(1, count)
        ]
        files.reach_disk()
        size = sum(file.stat().st_size for file in Path(folder).glob("*/*.vtu")) / count
        content = bytes(int(size))
        written = [
            clocked(lambda number=number: Path(folder, f"{number}").write_bytes(content))
            for number in range(count)
        ]
    cells = len(prepared.model.elements.nodes) + len(prepared.model.cut_elements.weight) // 3
    cpu, wall = medians(runs)
    yield Figure(f"a frame, {name}", 1e3 * cpu, 1e3 * wall, "ms", f"{cells} cells", spread(runs))
    yield Figure(f"a frame, {name}", None, 1e-6 * size, "MB")
    cpu, wall = medians(written)
    yield Figure(
        f"a file of that size, {name}", 1e3 * cpu, 1e3 * wall, "ms", "the system alone", spread(written)
    )
