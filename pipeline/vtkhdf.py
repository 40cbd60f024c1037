"""All frames of a run in one file each for bodies and contact: VTKHDF, for ParaView 5.12 or later.

A series of .vtu files is whole at any moment of a run, which one growing HDF5 file is not: so these are made of the
frames, afterwards. Cells are the same in all frames and stand in the file once.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.files import reach_disk
from phantomnode.pipeline.results import Results
from phantomnode.pipeline.vtu_reader import Array, Grid, read_pvd, read_vtu

CHUNK = 1 << 16
"""Rows that are packed together."""


def write_vtkhdf(results: Results) -> list[Path]:
    """Write fields.vtkhdf and, where there are contact pairs, contact.vtkhdf into the folder of a run.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    CaseError
        Where h5py is not installed, or a frame cannot be read.
    """
    try:
        import h5py
    except ImportError:
        raise CaseError('VTKHDF needs h5py: pip install "phantomnode[vtkhdf]"') from None
    written = []
    for name in ("fields", "contact") if results.pairs else ("fields",):
        series = read_pvd(results.path / f"{name}.pvd")
        if not series:
            raise CaseError(f"{results.path}: no frame is written yet")
        path = results.path / f"{name}.vtkhdf"
        part = path.with_name(f".{path.name}.part")
        try:
            with h5py.File(part, "w") as file:
                _write(file.create_group("VTKHDF"), series)
            reach_disk(part)
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
        written.append(path)
    return written


def _write(root: Any, series: list[tuple[float, Path]]) -> None:
    """One temporal unstructured grid of a single part, version 2.0 of the format."""
    first = read_vtu(series[0][1])
    points, cells, steps = len(first.points), len(first.types), len(series)
    root.attrs["Version"] = np.array([2, 0])
    root.attrs["Type"] = np.bytes_("UnstructuredGrid")  # of fixed length, as the reader wants it
    for name, count in (("Points", points), ("Cells", cells), ("ConnectivityIds", len(first.connectivity))):
        root[f"NumberOf{name}"] = np.array([count])
    _put(root, "Connectivity", first.connectivity.astype(np.int64))
    _put(root, "Offsets", np.concatenate([[0], first.offsets]).astype(np.int64))
    _put(root, "Types", first.types.astype(np.uint8))
    stacks = {"Points": _stack(root, "Points", first.points, steps)}
    for kind, data in (("PointData", first.point_data), ("CellData", first.cell_data)):
        group = root.create_group(kind)
        stacks |= {f"{kind}/{name}": _stack(group, name, values, steps) for name, values in data.items()}
    for number, (_, path) in enumerate(series):
        for name, values in _arrays(read_vtu(path), first, path):
            stacks[name][number * len(values) : (number + 1) * len(values)] = values
    _write_steps(root, [time for time, _ in series], points, cells)


def _write_steps(root: Any, times: list[float], points: int, cells: int) -> None:
    """The times, and where in the arrays each step begins; all steps share the cells."""
    group, number = root.create_group("Steps"), np.arange(len(times))
    group.attrs["NSteps"] = len(times)
    group["Values"] = np.array(times)
    group["PartOffsets"], group["NumberOfParts"] = 0 * number, np.ones_like(number)
    group["PointOffsets"] = points * number
    for name in ("CellOffsets", "ConnectivityIdOffsets"):
        group[name] = np.zeros((len(times), 1), dtype=np.int64)
    for kind, rows in (("PointData", points), ("CellData", cells)):
        offsets = group.create_group(f"{kind}Offsets")
        for name in root[kind]:
            offsets[name] = rows * number


def _arrays(grid: Grid, first: Grid, path: Path) -> Iterator[tuple[str, Array]]:
    """What a frame adds: its points and fields."""
    if not np.array_equal(grid.connectivity, first.connectivity):
        raise CaseError(f"{path}: has other cells than the first frame; run the case again")
    yield "Points", grid.points
    yield from ((f"PointData/{name}", values) for name, values in grid.point_data.items())
    yield from ((f"CellData/{name}", values) for name, values in grid.cell_data.items())


def _stack(group: Any, name: str, values: Array, steps: int) -> Any:
    """An array for such values of all steps, one behind the other."""
    shape = (steps * len(values), *values.shape[1:])
    chunk = (min(CHUNK, max(len(values), 1)), *values.shape[1:])
    return group.create_dataset(name, shape, values.dtype, chunks=chunk, compression="gzip", compression_opts=1,
                                shuffle=True)  # fmt: skip


def _put(group: Any, name: str, values: Array) -> None:
    group.create_dataset(name, data=values, compression="gzip", compression_opts=4, shuffle=True)
