"""Where a run begins: at time 0 in an empty folder, or at the last good checkpoint of a run before."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from phantomnode.pipeline.checkpoint import Damaged, Identity, Tree, checkpoints, frame_of, good_checkpoints
from phantomnode.pipeline.fields import Fields
from phantomnode.pipeline.folder import empty_folder, refuse_other_case, reopen_folder
from phantomnode.pipeline.history import History
from phantomnode.pipeline.observer import sample_steps
from phantomnode.pipeline.preflight import steps_of
from phantomnode.pipeline.prepare import Prepared
from phantomnode.pipeline.profile import ProfileWriter, Stations
from phantomnode.pipeline.tally import Tally

if TYPE_CHECKING:
    from phantomnode.solver.explicit import Frame


class Past(NamedTuple):
    """What went before a run that goes on: wall times, s, of the whole and of the steps; the steps it began at."""

    wall: float = 0.0
    steps: float = 0.0
    resumed_at: tuple[int, ...] = ()


class Start(NamedTuple):
    """The observers of a run, as they stand where it begins; the frame it goes on from, None at the start."""

    tally: Tally
    history: History
    fields: Fields
    profiles: dict[str, ProfileWriter]
    past: Past
    frame: Frame | None


def new_start(prepared: Prepared, lines: Mapping[str, Stations], folder: Path) -> Start:
    """Begin at time 0, in an emptied folder."""
    empty_folder(prepared.case, folder)
    return _observers(prepared, lines, folder, None)


def resumed_start(
    prepared: Prepared, lines: Mapping[str, Stations], folder: Path, own: Identity, notes: list[str]
) -> Start:
    """Begin at the last good checkpoint; at time 0 where there is none.

    Parameters
    ----------
    prepared : Prepared
    lines : mapping of str to Stations
        Of the profiles.
    folder : Path
        Of the results. What was written behind the checkpoint is taken out.
    own : Identity
        Of this run.
    notes : list of str
        Grows by what is to be told.

    Raises
    ------
    CaseError
        Where the checkpoints are of another case or version.
    """
    refuse_other_case(prepared.case, folder)
    for file, tree in good_checkpoints(folder, own, notes.append):
        try:
            start = _observers(prepared, lines, folder, tree)
        except Damaged as damage:
            notes.append(f"{file}: {damage}; the checkpoint before it is taken")
            continue
        reopen_folder(folder)
        for later in checkpoints(folder):
            if later > file:
                later.unlink()
        assert start.frame is not None
        notes.append(f"goes on at t = {start.frame.time:.6g} s, step {start.frame.step}")
        return start
    notes.append(f"{folder}: holds no checkpoint to go on from; the run begins at its start")
    return new_start(prepared, lines, folder)


def _observers(prepared: Prepared, lines: Mapping[str, Stations], folder: Path, tree: Tree | None) -> Start:
    """The observers at time 0 or as a checkpoint says."""
    steps, output = steps_of(prepared), prepared.case.output
    files: Tree = tree["files"] if tree is not None else {}
    fields = Fields(prepared, folder, sample_steps(steps, output.fields.count), files.get("fields"))
    profiles = {
        name: ProfileWriter(prepared, name, line, folder, files.get(f"profile.{name}"))
        for name, line in lines.items()
    }
    tally, samples = Tally(prepared), sample_steps(steps, output.history.count)
    # Last: nothing can fail behind it, and it holds its file open.
    history = History(
        prepared, folder / "history.csv", samples, tree["history"] if tree is not None else None
    )
    if tree is None:
        return Start(tally, history, fields, profiles, Past(), None)
    tally.restore(tree["tally"])
    frame = frame_of(tree["frame"])
    past = Past(tree["wall"], tree["steps"], (*tree["resumed_at"], frame.step))
    return Start(tally, history, fields, profiles, past, frame)
