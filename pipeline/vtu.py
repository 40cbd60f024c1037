"""VTK's XML files: unstructured grids (.vtu) as bytes, and time series of them (.pvd).

Arrays stand in line, in base64, compressed by zlib: what ParaView, pyvista and meshio all read. meshio knows no
LZ4, and mistakes some raw appended arrays for others (its _parse_raw_binary looks offsets up among those that it
has already changed); base64 costs a third in size and no time. Of floating-point numbers zlib packs runs of one
byte and codes the rest: to look for longer repetitions doubles the time and saves a twelfth. What stays the same
from frame to frame is encoded once (:func:`data_array`, :func:`cells`).
"""

from __future__ import annotations

import hashlib
import zlib
from base64 import b64encode
from collections.abc import Mapping
from html import escape
from pathlib import Path
from time import monotonic
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.checkpoint import Damaged, Tree
from phantomnode.pipeline.files import reach_disk, sha256_of, write_atomically

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Array = NDArray[np.generic]

VTK_LINE, VTK_TRIANGLE, VTK_QUAD = 3, 5, 9

TYPES = {"<f4": "Float32", "<i4": "Int32", "|u1": "UInt8"}
"""VTK's names of the types that are stored."""


SMALL = 1 << 16
"""Arrays up to so many bytes are not compressed: a small model takes its steps faster than that."""


class Cells(NamedTuple):
    """Cells of one or several kinds: their number, and the XML of their points, offsets and types."""

    number: int
    xml: bytes


def cells(*blocks: tuple[int, Ints]) -> Cells:
    """Cells from blocks of (VTK type, (m, k) points of each cell), in order."""
    sizes = np.concatenate([np.full(len(block), block.shape[1]) for _, block in blocks])
    types = np.concatenate([np.full(len(block), kind, dtype=np.uint8) for kind, block in blocks])
    arrays = (
        _data_array("connectivity", np.concatenate([block.ravel() for _, block in blocks]).astype("<i4")),
        _data_array("offsets", np.cumsum(sizes).astype("<i4")),
        _data_array("types", types),
    )
    return Cells(len(types), b"".join(arrays))


def vectors(plane: Floats) -> Floats:
    """(k, 3) Vectors from their (k, 2) components in the plane: VTK knows only three dimensions."""
    return np.column_stack([plane, np.zeros(len(plane))])


def data_array(name: str, values: Array) -> bytes:
    """The XML of a named array, (k,) or (k, c): floats as float32, integers as int32."""
    return _data_array(name, values.astype("<i4" if np.issubdtype(values.dtype, np.integer) else "<f4"))


def _data_array(name: str, values: Array) -> bytes:
    """The XML of an array of one of the ``TYPES``, compressed as one block."""
    content = np.ascontiguousarray(values).tobytes()
    strategy = zlib.Z_RLE if values.dtype.kind == "f" else zlib.Z_DEFAULT_STRATEGY
    squeeze = zlib.compressobj(1 if len(content) > SMALL else 0, strategy=strategy)
    packed = squeeze.compress(content) + squeeze.flush()
    # Blocks, their size, that of a last one that is shorter (there is none), and the size of each when packed.
    header = np.array([1, len(content), 0, len(packed)], dtype="<u8").tobytes()
    components = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
    start = f'<DataArray type="{TYPES[values.dtype.str]}" Name="{name}"{components} format="binary">'
    return b"".join([start.encode(), b64encode(header), b64encode(packed), b"</DataArray>\n"])


def vtu_bytes(
    points: Floats,
    grid: Cells,
    point_data: Mapping[str, Array],
    cell_data: Mapping[str, Array | bytes],
    time: float | None = None,
) -> bytes:
    """One unstructured grid as the content of a .vtu file.

    Parameters
    ----------
    points : (p, 2) float64, metres
    grid : Cells
    point_data, cell_data : mapping of str to (p,) or (p, k), (m,) or (m, k) arrays
        Or to their XML, from :func:`data_array`.
    time : float, s, optional
        Stored as the field data ``TimeValue``, which ParaView takes as the file's own time.
    """
    clock = (
        '<FieldData><DataArray type="Float64" Name="TimeValue" NumberOfTuples="1" format="ascii">'
        f"{float(time)!r}</DataArray></FieldData>\n"
        if time is not None
        else ""
    )
    start = (
        '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
        f'header_type="UInt64" compressor="vtkZLibDataCompressor">\n<UnstructuredGrid>\n{clock}'
        f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{grid.number}">\n'
    )
    return b"".join(
        [
            start.encode(),
            *_section("PointData", point_data),
            *_section("CellData", cell_data),
            *_section("Points", {"Points": vectors(points)}),
            b"<Cells>\n",
            grid.xml,
            b"</Cells>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>\n",
        ]
    )


def _section(tag: str, arrays: Mapping[str, Array | bytes]) -> list[bytes]:
    """The XML of the arrays of points or cells, between its tags."""
    encoded = [
        values if isinstance(values, bytes) else data_array(name, values) for name, values in arrays.items()
    ]
    return [f"<{tag}>\n".encode(), *encoded, f"</{tag}>\n".encode()]


class Series:
    """A .pvd file and its folder of .vtu files: complete, and readable by ParaView, after every frame.

    To wait for the disk at every file takes longer than to compute it; so that is done once a second, and at the
    end by :meth:`reach_disk`.

    Parameters
    ----------
    path : Path
        The .pvd file; its frames go to the folder beside it that has its name without the ending.
    saved : dict or None
        Go on from what :meth:`saved` gave; the frames written since are removed.

    Raises
    ------
    Damaged
        Where a frame is not what it was then.
    """

    def __init__(self, path: Path, saved: Tree | None = None) -> None:
        self.path = path
        self.folder = path.with_suffix("")
        self.folder.mkdir(exist_ok=True)
        self._times: list[float] = []
        self._digests: list[str] = []
        self._in_memory: list[Path] = []
        self._waited = monotonic()
        if saved is not None:
            self._restore(saved)

    def add(self, time: float, content: bytes) -> Path:
        """Write the next frame (the bytes of a .vtu) at a time in seconds, then the .pvd anew."""
        frame = self._frame(len(self._times))
        write_atomically(frame, content, durable=False)
        self._in_memory.append(frame)
        self._times.append(time)
        self._digests.append(hashlib.sha256(content).hexdigest())
        self._write_index()
        if monotonic() > self._waited + 1.0:
            self.reach_disk()
        return frame

    def reach_disk(self) -> None:
        """Wait until the disk holds the frames so far and the .pvd."""
        if self._in_memory:
            for file in (*self._in_memory, self.path):
                reach_disk(file)
        self._in_memory.clear()
        self._waited = monotonic()

    def saved(self) -> Tree:
        """What the series holds so far."""
        return {"times": list(self._times), "sha256": list(self._digests)}

    def digests(self) -> dict[Path, str]:
        """SHA-256 of the frames so far."""
        return {self._frame(number): digest for number, digest in enumerate(self._digests)}

    def _restore(self, saved: Tree) -> None:
        for number, digest in enumerate(saved["sha256"]):
            frame = self._frame(number)
            if not frame.is_file() or sha256_of(frame) != digest:
                raise Damaged(f"{frame} is missing or was changed since")
        self._times, self._digests = list(saved["times"]), list(saved["sha256"])
        self._write_index()  # before the frames go that it must not name any more
        self._in_memory.append(self.path)
        kept = {self._frame(number) for number in range(len(self._times))}
        for frame in self.folder.glob(f"{self.path.stem}_*.vtu"):
            if frame not in kept:
                frame.unlink()

    def _frame(self, number: int) -> Path:
        return self.folder / f"{self.path.stem}_{number:05d}.vtu"

    def _write_index(self) -> None:
        entries = (
            f'    <DataSet timestep="{time!r}" group="" part="0" '
            f'file="{escape(f"{self.folder.name}/{self._frame(number).name}")}"/>\n'
            for number, time in enumerate(self._times)
        )
        write_atomically(
            self.path,
            '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n'
            "  <Collection>\n" + "".join(entries) + "  </Collection>\n</VTKFile>\n",
            durable=False,
        )
