"""VTK's XML files: unstructured grids (.vtu) as bytes and back, and time series of them (.pvd).

Arrays are appended to the XML as they are, in binary. Compressed by zlib they are what ParaView, pyvista and meshio
all read (meshio knows no LZ4); ISA-L's encoder is three times as fast as that of the zlib library and packs
floating-point numbers better. The data stand in the reverse order of their tags: meshio finds an array by its offset,
the first tag that has it, and gives offsets anew while it goes along. What stays the same from frame to frame is
encoded once (:func:`data_array`, :func:`cells`).
"""

from __future__ import annotations

import hashlib
import os
import zlib
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import cache
from html import escape
from pathlib import Path
from time import monotonic
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.checkpoint import Damaged, Tree
from phantomnode.pipeline.files import reach_disk, sha256_of, write_atomically

Floats = NDArray[np.float64]
Numbers = NDArray[np.int32] | NDArray[np.int64]
Array = NDArray[np.generic]

VTK_LINE, VTK_TRIANGLE, VTK_QUAD = 3, 5, 9

TYPES = {"<f4": "Float32", "<f8": "Float64", "<i4": "Int32", "|u1": "UInt8"}
"""VTK's names of the types that are stored."""

COMPRESSORS = {"zlib": "vtkZLibDataCompressor", "lz4": "vtkLZ4DataCompressor"}
"""VTK's names of what unpacks the arrays."""


class Encoding(NamedTuple):
    """How arrays are stored: the type of their floating-point numbers, and what packs them."""

    precision: Literal["float32", "float64"] = "float32"
    compression: Literal["none", "zlib", "lz4"] = "zlib"


SMALL_AND_FAST = Encoding()
"""What is taken unless the user says something else."""


class Encoded(NamedTuple):
    """A stored array: the attributes of its tag, and its bytes, in pieces."""

    attributes: str
    pieces: tuple[bytes, ...]


BEGINNING = 8
"""Bytes of an array that are packed as a block of their own: more than the three that ISA-L begins with."""

Packable = Array | Encoded | Future[Encoded]
"""An array, or what is stored of it, or will be."""


class Cells(NamedTuple):
    """Cells of one or several kinds: their number, and the arrays of their points, offsets and types."""

    number: int
    arrays: tuple[Encoded, ...]


def cells(*blocks: tuple[int, Numbers], encoding: Encoding = SMALL_AND_FAST) -> Cells:
    """Cells from blocks of (VTK type, (m, k) points of each cell), in order."""
    sizes = np.concatenate([np.full(len(block), block.shape[1]) for _, block in blocks])
    types = np.concatenate([np.full(len(block), kind, dtype=np.uint8) for kind, block in blocks])
    arrays = {
        "connectivity": np.concatenate([block.ravel() for _, block in blocks]),
        "offsets": np.cumsum(sizes),
        "types": types,
    }
    return Cells(len(types), tuple(data_array(name, array, encoding) for name, array in arrays.items()))


def vectors(plane: Floats) -> Floats:
    """(k, 3) Vectors from their (k, 2) components in the plane: VTK knows only three dimensions."""
    both = np.zeros((len(plane), 3))
    both[:, :2] = plane
    return both


def data_array(name: str, values: Array, encoding: Encoding = SMALL_AND_FAST) -> Encoded:
    """A named array, (k,) or (k, c), as it is stored: integers as int32 (bytes as they are)."""
    kinds = {"f": {"float32": "<f4", "float64": "<f8"}[encoding.precision], "u": "|u1"}
    stored = np.ascontiguousarray(values, dtype=kinds.get(values.dtype.kind, "<i4"))
    components = f' NumberOfComponents="{stored.shape[1]}"' if stored.ndim == 2 else ""
    attributes = f'type="{TYPES[stored.dtype.str]}" Name="{name}"{components}'
    if encoding.compression == "none":
        return Encoded(attributes, (_sizes(stored.nbytes), stored.tobytes()))
    packed = {"lz4": _lz4, "zlib": _zlib}[encoding.compression](stored)
    # Blocks, their size, that of a last one that is shorter (there is none), and the size of each when packed.
    return Encoded(attributes, (_sizes(1, stored.nbytes, 0, sum(map(len, packed))), *packed))


def _sizes(*numbers: int) -> bytes:
    return np.array(numbers, dtype="<u8").tobytes()


def _zlib(stored: Array) -> tuple[bytes, ...]:
    if stored.dtype.kind != "f":
        # Integers are the same in all frames: 40 ms once, for 0.2 MB less in each frame of 1e5 cells.
        return (zlib.compress(stored.tobytes(), 3),)
    from isal import isal_zlib

    # ISA-L files the third byte of what it begins with under the hash of an address (igzip_icf_body_h1_gr_bt.asm,
    # write_first_byte), so that it misses a match in one process of thousands, and a resumed run would have other
    # bytes. Its routine for the ends of blocks does not: it gets the first bytes.
    packer = isal_zlib.compressobj(1)
    content = stored.reshape(-1).view(np.uint8)
    first = packer.compress(content[:BEGINNING]) + packer.flush(isal_zlib.Z_SYNC_FLUSH)
    return first, packer.compress(content[BEGINNING:]), packer.flush()


def _lz4(stored: Array) -> tuple[bytes, ...]:
    import lz4.block

    return (lz4.block.compress(stored, store_size=False),)


def vtu_pieces(
    points: Floats,
    grid: Cells,
    point_data: Mapping[str, Packable],
    cell_data: Mapping[str, Packable],
    time: float | None = None,
    encoding: Encoding = SMALL_AND_FAST,
    points_as: Encoding | None = None,
) -> list[bytes]:
    """One unstructured grid as the content of a .vtu file, in pieces.

    Parameters
    ----------
    points : (p, 3) floats, metres
    grid : Cells
    point_data, cell_data : mapping of str to (p,) or (p, k), (m,) or (m, k) arrays
        Or to what :func:`data_array` made of them or :func:`packed_soon` makes of them, with the same compression.
    time : float, s, optional
        Stored as the field data ``TimeValue``, which ParaView takes as the file's own time.
    encoding : Encoding
        How arrays are stored.
    points_as : Encoding, optional
        How points are stored, where that differs.
    """
    clock = (
        '<FieldData><DataArray type="Float64" Name="TimeValue" NumberOfTuples="1" format="ascii">'
        f"{float(time)!r}</DataArray></FieldData>\n"
        if time is not None
        else ""
    )
    begun: dict[str, list[Encoded | Future[Encoded]]] = {
        "PointData": _begun(point_data, encoding),
        "CellData": _begun(cell_data, encoding),
        "Points": [packed_soon("Points", points, points_as or encoding)],
    }
    sections = {
        name: [packed.result() if isinstance(packed, Future) else packed for packed in arrays]
        for name, arrays in begun.items()
    }
    sections["Cells"] = list(grid.arrays)
    offset, tags, contents = 0, list[str](), list[bytes]()
    for section, arrays in reversed(sections.items()):
        tags.append(f"</{section}>\n")
        for array in reversed(arrays):
            tags.append(f'<DataArray {array.attributes} format="appended" offset="{offset}"/>\n')
            contents += array.pieces
            offset += sum(map(len, array.pieces))
        tags.append(f"<{section}>\n")
    packer = f' compressor="{COMPRESSORS[encoding.compression]}"' if encoding.compression != "none" else ""
    start = (
        '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
        f'header_type="UInt64"{packer}>\n<UnstructuredGrid>\n{clock}'
        f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{grid.number}">\n{"".join(reversed(tags))}'
        '</Piece>\n</UnstructuredGrid>\n<AppendedData encoding="raw">\n_'
    )
    return [start.encode(), *contents, b"\n</AppendedData>\n</VTKFile>\n"]


def packed_soon(name: str, values: Array, encoding: Encoding = SMALL_AND_FAST) -> Future[Encoded]:
    """What :func:`data_array` returns or raises, in another thread; the values must stay until it is there."""
    return _threads().submit(data_array, name, values, encoding)


def _begun(arrays: Mapping[str, Packable], encoding: Encoding) -> list[Encoded | Future[Encoded]]:
    """The arrays of points or cells, on their way to what is stored."""
    return [
        values if isinstance(values, Encoded | Future) else packed_soon(name, values, encoding)
        for name, values in arrays.items()
    ]


@cache
def _threads() -> ThreadPoolExecutor:
    """Threads for what does not need Python's lock: two to pack arrays and one to hash and write a file."""
    return ThreadPoolExecutor(3, thread_name_prefix="packing")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_threads.cache_clear)  # a fork has no threads


class Series:
    """A .pvd file and its folder of .vtu files: complete, and readable by ParaView, after every frame.

    A frame is written in another thread, while the next one is made; what fails there is raised by whatever is asked
    of the series next. To wait for the disk at every file takes longer than to compute it; so that is done once a
    second, and at the end by :meth:`reach_disk`.

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
        self._writing: Future[None] | None = None
        self._buffer = bytearray()  # kept: fresh memory for each frame takes the system as long as to fill it
        if saved is not None:
            self._restore(saved)

    def add(self, time: float, pieces: Sequence[bytes]) -> None:
        """Write the next frame (the pieces of a .vtu) at a time in seconds, then the .pvd anew."""
        self._wait()
        self._writing = _threads().submit(self._write, time, self._joined(pieces))

    def _write(self, time: float, content: memoryview) -> None:
        """In the thread: a frame, then the .pvd that names it."""
        frame = self._frame(len(self._times))
        digest = hashlib.sha256(content).hexdigest()
        write_atomically(frame, content, durable=False)
        self._in_memory.append(frame)
        self._times.append(time)
        self._digests.append(digest)
        self._write_index()
        if monotonic() > self._waited + 1.0:
            self._reach_disk()

    def _wait(self) -> None:
        """Until the frame that is underway is written; raise what kept it from that."""
        if self._writing is not None:
            writing, self._writing = self._writing, None
            writing.result()

    def _joined(self, pieces: Sequence[bytes]) -> memoryview:
        """The pieces one behind the other, until the next frame."""
        size = sum(map(len, pieces))
        if size > len(self._buffer):
            self._buffer = bytearray(size + size // 8)
        content, end = memoryview(self._buffer), 0
        for piece in pieces:
            begin, end = end, end + len(piece)
            content[begin:end] = piece
        return content[:size]

    def reach_disk(self) -> None:
        """Wait until the disk holds the frames so far and the .pvd."""
        self._wait()
        self._reach_disk()

    def _reach_disk(self) -> None:
        if self._in_memory:
            for file in (*self._in_memory, self.path):
                reach_disk(file)
        self._in_memory.clear()
        self._waited = monotonic()

    def close(self) -> None:
        """Leave no thread behind that writes, also after an error elsewhere."""
        if self._writing is not None:
            wait([self._writing])

    def saved(self) -> Tree:
        """What the series holds so far."""
        self._wait()
        return {"times": list(self._times), "sha256": list(self._digests)}

    def digests(self) -> dict[Path, str]:
        """SHA-256 of the frames so far."""
        self._wait()
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
