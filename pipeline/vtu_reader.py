"""Reads what this program wrote: unstructured grids (.vtu) and time series of them (.pvd), without VTK."""

from __future__ import annotations

import struct
import zlib
from base64 import b64decode
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
HEADERS = {"UInt32": "I", "UInt64": "Q"}


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
    """One grid as this program writes it: a single piece, its arrays in line, in base64, packed by zlib or not.

    Raises
    ------
    CaseError
        Where the file is missing, damaged or written otherwise.
    """
    try:
        root = ElementTree.parse(path).getroot()
        piece = root.find("UnstructuredGrid/Piece")
        if piece is None:
            raise ValueError("no piece of an unstructured grid")
        sections = {tag: _section(root, piece, tag) for tag in ("PointData", "CellData", "Points", "Cells")}
        cells = sections["Cells"]
        return Grid(
            sections["Points"]["Points"], cells["connectivity"], cells["offsets"], cells["types"],
            sections["PointData"], sections["CellData"],
        )  # fmt: skip
    except FileNotFoundError:
        raise CaseError(f"{path}: the series names this file, and it is not there") from None
    except (ElementTree.ParseError, KeyError, ValueError, struct.error, zlib.error) as error:
        raise CaseError(f"{path}: cannot be read as a frame of this program ({error})") from error


def _section(root: ElementTree.Element, piece: ElementTree.Element, tag: str) -> dict[str, Array]:
    """The arrays of points or cells by their names."""
    found = piece.find(tag)
    return {} if found is None else {array.attrib["Name"]: _array(root, array) for array in found}


def _array(root: ElementTree.Element, array: ElementTree.Element) -> Array:
    """One array, (k,) or (k, c)."""
    if array.attrib["format"] != "binary":
        raise ValueError(f"{array.attrib['Name']} stands as {array.attrib['format']}, not in line in base64")
    order = "<" if root.attrib["byte_order"] == "LittleEndian" else ">"
    header = order + HEADERS[root.attrib.get("header_type", "UInt32")]
    content = _content((array.text or "").strip(), header, root.attrib.get("compressor"))
    values = np.frombuffer(content, dtype=order + TYPES[array.attrib["type"]])
    width = int(array.attrib.get("NumberOfComponents", 1))
    return values.reshape(-1, width) if width > 1 else values


def _content(text: str, header: str, compressor: str | None) -> bytes:
    """The bytes of an array: behind their number, or in blocks behind the sizes of these."""
    size = struct.calcsize(header)
    if compressor is None:
        raw = b64decode(text)
        return raw[size : size + struct.unpack_from(header, raw)[0]]
    if compressor != "vtkZLibDataCompressor":
        raise ValueError(f"packed by {compressor}; this reader knows vtkZLibDataCompressor")
    blocks = struct.unpack_from(header, b64decode(text[:24]))[0]
    length = -(-(3 + blocks) * size // 3) * 4  # the sizes are a base64 text of their own
    sizes = struct.unpack(f"{header[0]}{3 + blocks}{header[1]}", b64decode(text[:length]))[3:]
    packed, ends = b64decode(text[length:]), np.cumsum((0, *sizes))
    return b"".join(zlib.decompress(packed[a:b]) for a, b in zip(ends[:-1], ends[1:], strict=True))
