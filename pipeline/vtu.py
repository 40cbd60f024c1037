"""VTK's XML files: unstructured grids (.vtu) as bytes, and time series of them (.pvd).

VTK builds each file in memory and Python writes the bytes: on a full disk VTK's own file writer would end
the process. Arrays stand in line, in base64, compressed by zlib at level 1: what ParaView, pyvista and meshio
all read. meshio knows no LZ4, and mistakes some raw appended arrays for others (its _parse_raw_binary looks
offsets up among those that it has already changed); base64 costs a third in size and no time.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from phantomnode.pipeline.files import write_atomically

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Array = NDArray[np.generic]

VTK_LINE, VTK_TRIANGLE, VTK_QUAD = 3, 5, 9


class Cells(NamedTuple):
    """Cells of one or several kinds: their points one after another.

    connectivity (c,) int64; offsets (m + 1,) int64, where each cell begins; types (m,) uint8, VTK's numbers.
    """

    connectivity: Ints
    offsets: Ints
    types: NDArray[np.uint8]


def cells(*blocks: tuple[int, Ints]) -> Cells:
    """Cells from blocks of (VTK type, (m, k) points of each cell), in order."""
    sizes = np.concatenate([np.full(len(block), block.shape[1]) for _, block in blocks])
    return Cells(
        np.concatenate([block.ravel() for _, block in blocks]).astype(np.int64),
        np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        np.concatenate([np.full(len(block), kind, dtype=np.uint8) for kind, block in blocks]),
    )


def vectors(plane: Floats) -> Floats:
    """(k, 3) Vectors from their (k, 2) components in the plane: VTK knows only three dimensions."""
    return np.column_stack([plane, np.zeros(len(plane))])


def vtu_bytes(
    points: Floats,
    grid: Cells,
    point_data: Mapping[str, Array],
    cell_data: Mapping[str, Array],
    time: float | None = None,
) -> bytes:
    """One unstructured grid as the content of a .vtu file (float32, zlib, base64).

    Parameters
    ----------
    points : (p, 2) float64, metres
    grid : Cells
    point_data, cell_data : mapping of str to (p,) or (p, k), (m,) or (m, k) arrays
        Floats are stored as float32, integers as int32.
    time : float, s, optional
        Stored as the field data ``TimeValue``, which ParaView takes as the file's own time.

    Raises
    ------
    RuntimeError
        Where VTK refuses to write.
    """
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonCore import vtkDoubleArray, vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkUnstructuredGrid
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    data = vtkUnstructuredGrid()
    places = vtkPoints()
    places.SetData(numpy_to_vtk(vectors(points).astype(np.float32), deep=True))
    data.SetPoints(places)
    faces = vtkCellArray()
    faces.SetData(
        numpy_to_vtkIdTypeArray(grid.offsets, deep=True),
        numpy_to_vtkIdTypeArray(grid.connectivity, deep=True),
    )
    data.SetCells(numpy_to_vtk(grid.types, deep=True), faces)
    for attributes, arrays in ((data.GetPointData(), point_data), (data.GetCellData(), cell_data)):
        for name, values in arrays.items():
            kind = np.int32 if np.issubdtype(values.dtype, np.integer) else np.float32
            array = numpy_to_vtk(np.ascontiguousarray(values, dtype=kind), deep=True)
            array.SetName(name)
            attributes.AddArray(array)
    if time is not None:
        clock = vtkDoubleArray()
        clock.SetName("TimeValue")
        clock.InsertNextValue(time)
        data.GetFieldData().AddArray(clock)
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetInputData(data)
    writer.WriteToOutputStringOn()
    writer.SetDataModeToBinary()
    writer.SetCompressorTypeToZLib()
    writer.SetCompressionLevel(1)
    if not writer.Write():
        raise RuntimeError("VTK could not write an unstructured grid")
    content = writer.GetOutputString()
    return content if isinstance(content, bytes) else content.encode()


class Series:
    """A .pvd file and its folder of .vtu files: complete, and readable by ParaView, after every frame.

    Parameters
    ----------
    path : Path
        The .pvd file; its frames go to the folder beside it that has its name without the ending.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.folder = path.with_suffix("")
        self.folder.mkdir(exist_ok=True)
        self._entries: list[str] = []

    def add(self, time: float, content: bytes) -> Path:
        """Write the next frame (the bytes of a .vtu) at a time in seconds, then the .pvd anew."""
        frame = self.folder / f"{self.path.stem}_{len(self._entries):05d}.vtu"
        write_atomically(frame, content)
        name = quoteattr(f"{self.folder.name}/{frame.name}")
        self._entries.append(f'    <DataSet timestep="{time!r}" group="" part="0" file={name}/>\n')
        write_atomically(
            self.path,
            '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n'
            "  <Collection>\n" + "".join(self._entries) + "  </Collection>\n</VTKFile>\n",
        )
        return frame
