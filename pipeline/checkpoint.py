"""Checkpoints: all that a run needs to go on to the same bits, in files that tell whether they are whole.

A file is a line with its SHA-256, then an archive of NumPy arrays (.npz) with all else as JSON. It is written when
everything that it refers to is on the disk, and two are kept: should the newer one be damaged, the older serves.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.files import remove_parts, write_atomically

if TYPE_CHECKING:
    from phantomnode.solver.explicit import Frame

FOLDER = "checkpoint"
PATTERN = "step_*.checkpoint"
KEPT = 2
"""How many are kept."""

MAGIC = b"phantomnode checkpoint 1 "
VALUES = "values.json"

Tree = dict[str, Any]
"""Values by name: numbers, texts, lists of them, arrays, and trees."""


class Identity(NamedTuple):
    """To which runs a checkpoint belongs.

    case: hash of the resolved case; version: of phantomnode; code: what stands for the sources of the solver and
    what compiles them; model: hash of the arrays of the model.
    """

    case: str
    version: str
    code: str
    model: str


class Damaged(ValueError):
    """A checkpoint, or a file that it refers to, does not hold what it held; the text says which."""


def identity(case: str, model: Any) -> Identity:
    """The identity of a run now, from the hash of its case and its model."""
    import phantomnode
    from phantomnode import solver
    from phantomnode.kernels import package_key

    code = package_key(Path(str(solver.__file__)).parent)
    return Identity(case, phantomnode.__version__, code, _digest(model))


def _digest(model: Any) -> str:
    """SHA-256 of a NamedTuple of arrays, numbers and the like."""
    digest = hashlib.sha256()

    def add(value: Any) -> None:
        if isinstance(value, tuple):
            for item in value:
                add(item)
        elif isinstance(value, np.ndarray):
            digest.update(f"{value.dtype.str}{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).data)
        else:
            digest.update(repr(value).encode())

    add(model)
    return digest.hexdigest()


def packed(tree: Tree) -> bytes:
    """A tree as the content of a checkpoint."""
    arrays: dict[str, np.ndarray[Any, Any]] = {}

    def plain(value: Any, place: str) -> Any:
        if isinstance(value, np.ndarray):
            arrays[place] = value
            return {"array": place}
        if isinstance(value, dict):
            return {"tree": {key: plain(item, f"{place}/{key}") for key, item in value.items()}}
        return value

    values = plain(tree, "")
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr(VALUES, json.dumps(values))
        for place, array in arrays.items():
            with archive.open(f"{place}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, array, allow_pickle=False)
    body = content.getvalue()
    return MAGIC + hashlib.sha256(body).hexdigest().encode() + b"\n" + body


def unpacked(content: bytes) -> Tree:
    """The tree in a checkpoint.

    Raises
    ------
    Damaged
        Where it is not what was written.
    """
    head, _, body = content.partition(b"\n")
    if head != MAGIC + hashlib.sha256(body).hexdigest().encode():
        raise Damaged("is damaged or cut short")
    with zipfile.ZipFile(io.BytesIO(body)) as archive:

        def whole(value: Any) -> Any:
            if not isinstance(value, dict):
                return value
            if "array" in value:
                with archive.open(f"{value['array']}.npy") as file:
                    return np.lib.format.read_array(file, allow_pickle=False)
            return {key: whole(item) for key, item in value["tree"].items()}

        tree: Tree = whole(json.loads(archive.read(VALUES)))
    return tree


def frame_tree(frame: Frame, *, resumable: bool) -> Tree:
    """A frame as a tree; without its state where no run goes on from it."""
    tree = {**frame._asdict(), "energies": list(frame.energies)}
    tree["state"] = frame.state._asdict() if resumable else {}
    return tree


def shown(frame: Frame) -> Frame:
    """A frame to look at, without the state from which a run could go on: two thirds of its memory."""
    return frame_of(frame_tree(frame, resumable=False))


def frame_of(tree: Tree) -> Frame:
    """The frame in a tree."""
    from phantomnode.solver.explicit import Frame
    from phantomnode.solver.model import Energies, State

    state = State(**tree["state"]) if tree["state"] else None
    return Frame(**{**tree, "energies": Energies(*tree["energies"]), "state": state})


def write_checkpoint(folder: Path, step: int, tree: Tree) -> None:
    """Write the checkpoint of a step into a results folder, and remove all but the last two.

    Raises
    ------
    OSError
        Where it cannot be written; those before it are still there.
    """
    place = folder / FOLDER
    place.mkdir(exist_ok=True)
    write_atomically(place / f"step_{step:012d}.checkpoint", packed(tree))
    for old in checkpoints(folder)[KEPT:]:
        old.unlink(missing_ok=True)


def checkpoints(folder: Path) -> list[Path]:
    """The checkpoints of a results folder, the last one first."""
    return sorted((folder / FOLDER).glob(PATTERN), reverse=True)


def remove_checkpoints(folder: Path) -> None:
    """Remove all checkpoints of a results folder."""
    remove_parts(folder / FOLDER)
    for file in checkpoints(folder):
        file.unlink()


def good_checkpoints(
    folder: Path, expected: Identity, tell: Callable[[str], None]
) -> Iterator[tuple[Path, Tree]]:
    """The checkpoints of a run that are whole, the last one first.

    Raises
    ------
    CaseError
        Where one is of another case, or was written by another version.
    """
    for file in checkpoints(folder):
        try:
            tree = unpacked(file.read_bytes())
        except Damaged as damage:
            tell(f"{file}: {damage}; the checkpoint before it is taken")
            continue
        refuse_foreign(file, Identity(*tree["identity"]), expected)
        yield file, tree


def refuse_foreign(file: Path, found: Identity, expected: Identity) -> None:
    """Refuse the checkpoint of another case or version.

    Raises
    ------
    CaseError
        Saying what differs and what to do.
    """
    again = "take another --out, or --overwrite to start again"
    if found.case != expected.case:
        raise CaseError(
            f"{file}: is of another case (hash {found.case[:12]}, this one {expected.case[:12]}): a key or a file of "
            f"the case was changed since; go on with {file.parent.parent / 'case.toml'}, or {again}"
        )
    if (found.version, found.code) != (expected.version, expected.code):
        raise CaseError(
            f"{file}: was written by phantomnode {found.version} with other sources or another compiler "
            f"({found.code}, now {expected.version}, {expected.code}); go on with that, or {again}"
        )
    if found.model != expected.model:
        raise CaseError(
            f"{file}: this machine makes another model of the same case (another version of a library of geometry?); "
            f"go on where it was written, or {again}"
        )
