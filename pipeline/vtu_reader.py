"""Reads what this program wrote: unstructured grids (.vtu) and time series of them (.pvd), without VTK."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.errors import CaseError

Array = NDArray[np.generic]

TYPES = {
    "Float32": "f4", "Float64": "f8", "Int8": "i1", "Int32": "i4", "Int64": "i8", "UInt8": "u1",
    "UInt32": "u4", "UInt64": "u8",
}  # fmt: skip
APPENDED = b'<AppendedData encoding="raw">\n_'


class Grid(NamedTuple):
    """One unstructured grid.

    Attributes
    ----------
    points : (p, 3) floats, m
    connectivity : (c,) integers
        Points of all cells behind each other.
    offsets : (m,) integers
        Where the points of each cell end in it.
    types : (m,) integers
        VTK's numbers of the kinds of cells.
    point_data, cell_data : dict of str to (p,), (p, k), (m,) or (m, k) arrays
    """

    points: Array
    connectivity: Array
    offsets: Array
    types: Array
    point_data: dict[str, Array]
    cell_data: dict[str, Array]

    def cells(self, kind: int) -> NDArray[np.int64]:
        """(r, k) Points of each cell of one of VTK's kinds, in the order of the file."""
        chosen = np.flatnonzero(self.types == kind)
        if len(chosen) == 0:
            return np.zeros((0, 0), dtype=np.int64)
        sizes = np.diff(self.offsets.astype(np.int64), prepend=0)
        count = int(sizes[chosen[0]])
        first = self.offsets[chosen].astype(np.int64) - count
        return np.asarray(self.connectivity[first[:, None] + np.arange(count)], dtype=np.int64)


def read_pvd(path: Path) -> list[tuple[float, Path]]:
    """The times, s, and files of a series, in its order.

    Raises
    ------
    CaseError
        Where the file is missing or is no series.
    """
    try:
        entries = ElementTree.parse(path).getroot().iter("DataSet")
        return [(float(entry.attrib["timestep"]), path.parent / entry.attrib["file"]) for entry in entries]
    except FileNotFoundError:
        raise CaseError(f"{path}: there is no such file; is {path.parent} the folder of a run?") from None
    except (ElementTree.ParseError, KeyError, ValueError) as error:
        raise CaseError(f"{path}: is no series of frames ({error}); run the case again") from error


def read_vtu(path: Path) -> Grid:
    """One grid as this program writes it: a single piece, its arrays appended in binary, packed or not.

    Raises
    ------
    CaseError
        Where the file is missing, damaged or written otherwise.
    """
    try:
        text, mark, binary = path.read_bytes().partition(APPENDED)
        if not mark:
            raise ValueError("its arrays are not appended in binary")
        root = ElementTree.fromstring(text + b"</VTKFile>")
        piece = root.find("UnstructuredGrid/Piece")
        if piece is None:
            raise ValueError("no piece of an unstructured grid")
        arrays = Arrays(memoryview(binary), root)
        sections = {tag: arrays.of(piece, tag) for tag in ("PointData", "CellData", "Points", "Cells")}
        cells = sections["Cells"]
        return Grid(
            sections["Points"]["Points"], cells["connectivity"], cells["offsets"], cells["types"],
            sections["PointData"], sections["CellData"],
        )  # fmt: skip
    except FileNotFoundError:
        raise CaseError(f"{path}: the series names this file, and it is not there") from None
    except (ElementTree.ParseError, KeyError, ValueError, zlib.error, RuntimeError) as error:
        raise CaseError(f"{path}: cannot be read as a frame of this program ({error})") from error


class Arrays:
    """The arrays behind the XML of a file.

    Parameters
    ----------
    binary : memoryview
        What is appended, from the first array on.
    root : Element
        The XML.
    """

    def __init__(self, binary: memoryview, root: ElementTree.Element) -> None:
        self._binary = binary
        self._order = "<" if root.attrib["byte_order"] == "LittleEndian" else ">"
        self._header = np.dtype(self._order + TYPES[root.attrib.get("header_type", "UInt32")])
        self._unpack = _unpacker(root.attrib.get("compressor"))

    def of(self, piece: ElementTree.Element, tag: str) -> dict[str, Array]:
        """The arrays of points or cells by their names."""
        found = piece.find(tag)
        return {} if found is None else {array.attrib["Name"]: self._array(array) for array in found}

    def _array(self, array: ElementTree.Element) -> Array:
        """One array, (k,) or (k, c)."""
        content = self._content(int(array.attrib["offset"]))
        values = np.frombuffer(content, dtype=self._order + TYPES[array.attrib["type"]])
        width = int(array.attrib.get("NumberOfComponents", 1))
        return values.reshape(-1, width) if width > 1 else values

    def _content(self, offset: int) -> bytes | memoryview:
        """The bytes of an array: behind their number, or in blocks behind the sizes of these."""
        first = self._sizes(offset, 1)[0]
        if self._unpack is None:
            return self._piece(offset + self._header.itemsize, first)
        whole, last, *sizes = self._sizes(offset + self._header.itemsize, 2 + first)
        lengths = [whole] * (first - 1) + [last or whole]
        starts = offset + (3 + first) * self._header.itemsize + np.cumsum((0, *sizes[:-1]))
        pieces = zip(starts, sizes, lengths, strict=True)
        return b"".join(self._unpack(self._piece(start, size), length) for start, size, length in pieces)

    def _sizes(self, offset: int, count: int) -> list[int]:
        return [
            int(n) for n in np.frombuffer(self._piece(offset, count * self._header.itemsize), self._header)
        ]

    def _piece(self, start: int, size: int) -> memoryview:
        if start + size > len(self._binary):
            raise ValueError("it is cut short")
        return self._binary[start : start + size]


def _unpacker(compressor: str | None) -> Callable[[memoryview, int], bytes] | None:
    """What gives the bytes of a block, of a known length; None where they stand as they are."""
    if compressor == "vtkZLibDataCompressor":
        return lambda packed, length: zlib.decompress(packed, bufsize=length)
    if compressor == "vtkLZ4DataCompressor":
        if find_spec("lz4") is None:
            raise ValueError('it is packed by LZ4: pip install "phantomnode[lz4]"')
        from lz4.block import decompress

        return lambda packed, length: bytes(decompress(packed, uncompressed_size=length))
    if compressor is not None:
        raise ValueError(f"packed by {compressor}; this reader knows zlib and LZ4")
    return None
