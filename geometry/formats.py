"""What a file is, by what is in it, and whether it is whole."""

from __future__ import annotations

import re
from dataclasses import dataclass

from phantomnode.geometry.dxf_load import BINARY, is_whole
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.scripts import cleaned

WORDS = {
    "step": "STEP", "iges": "IGES", "brep": "BREP", "xao": "XAO", "msh": "gmsh mesh", "geo": "gmsh script",
    "dxf": "DXF", "svg": "SVG", "wkt": "WKT", "geojson": "GeoJSON",
}  # fmt: skip
SUFFIXES = {"step": ".step", "iges": ".igs", "brep": ".brep", "xao": ".xao", "msh": ".msh", "geo": ".geo"}

_FOREIGN = (
    (rb"AC10\d\d", "a DWG drawing: save it as DXF"),
    (rb"%PDF|%!PS", "a PDF or PostScript drawing: export DXF"),
    (rb"solid\s", "an STL surface, which is 3D: export the outline as DXF or STEP"),
    (
        rb"\s*(?>//[^\n]*\n\s*)*View\s*\"|\$PostFormat",
        "a gmsh post-processing view, which holds results: save the geometry",
    ),
    (rb"# vtk|(?s:.{0,200})<VTKFile", "a VTK file: save the outline as DXF or STEP, or the mesh as .msh"),
    (rb"PK\x03\x04|\x1f\x8b", "a compressed archive: unpack it"),
)
"""Other formats, by how they begin, and what to do instead."""

_WKT = (
    r"(SRID=\d+;\s*)?((MULTI)?(POLYGON|LINESTRING|POINT)|GEOMETRYCOLLECTION|CIRCULARSTRING|(COMPOUND|MULTI)CURVE|"
    r"CURVEPOLYGON|MULTISURFACE)\s*(Z|M|ZM)?\s*(\(|EMPTY)"
)

_SCRIPT = re.compile(
    r"^\s*(SetFactory|Point|Line|Circle|Ellipse|Spline|BSpline|Bezier|Curve|Rectangle|Disk|Surface|Plane|Physical|"
    r"Merge|Include|SystemCall|NonBlockingSystemCall|For|If|Macro|Function|DefineConstant|Exit|Printf|Print|Geometry|Mesh|"
    r"\w+\s*=)[^;]{0,2000};",
    re.MULTILINE,
)

_ENDS = {"step": "END-ISO-10303-21;", "xao": "</XAO>", "msh": "$EndElements"}
"""What a whole file of each kind holds near its end."""


@dataclass(frozen=True)
class File:
    """A file that was read and recognised."""

    kind: str
    content: bytes

    @property
    def text(self) -> str:
        """The content as text; these formats are ASCII but for names and comments."""
        return self.content.decode("utf-8", errors="replace")


def recognised(content: bytes) -> File:
    """The content with its kind, after making sure that it is whole."""
    if not content.strip():
        raise GeometryError("the file is empty")
    file = File(_kind(content), content)
    _check_whole(file)
    return file


def _kind(content: bytes) -> str:
    """Which format the content is."""
    head = content[:4000].decode("utf-8-sig", errors="replace").lstrip()
    first = content.split(b"\n", 1)[0].rstrip(b"\r")
    if head.startswith("ISO-10303-21"):
        return "step"
    if head.startswith(("$MeshFormat", "$Comments")):
        return "msh"
    if "<XAO" in head[:1000]:
        return "xao"
    if "DBRep_DrawableShape" in head[:1000] or head.startswith("CASCADE Topology"):
        return "brep"
    if len(first) >= 73 and first[72:73] == b"S" and first[73:80].strip().isdigit():
        return "iges"
    if content.startswith(BINARY) or re.match(r"(?>999[^\S\n]*\n[^\n]*\n\s*)*0\s*\n\s*SECTION\b", head):
        return "dxf"
    if "<svg" in head and re.match(r"<(\?xml|!DOCTYPE|!--|svg\b)", head):
        return "svg"
    if re.match(_WKT, head, re.IGNORECASE) and "{" not in head:  # as in "Point(1) = {...};" of a script
        return "wkt"
    if head.startswith("{") and '"type"' in head:
        return "geojson"
    for pattern, what in _FOREIGN:
        if re.match(pattern, content):
            raise GeometryError(f"this is {what}")
    if b"\0" not in content and _SCRIPT.search(cleaned(content.decode("utf-8", errors="replace"))):
        return "geo"
    raise GeometryError(
        "the content is of no known kind; geometry is read from DXF, SVG, STEP, IGES, BREP, XAO, "
        "gmsh scripts (.geo), gmsh meshes (.msh), WKT and GeoJSON"
    )


def _check_whole(file: File) -> None:
    """Refuse a file whose end is missing: gmsh and ezdxf read the rest without a word."""
    tail = file.content[-20_000:].decode("utf-8", errors="replace")
    whole = True
    if file.kind in _ENDS:
        whole = (
            _ENDS[file.kind].upper() in file.text.upper()
            if file.kind == "msh"
            else _ENDS[file.kind].upper() in tail.upper()
        )
    elif file.kind == "iges":
        whole = _iges_is_whole(file.text)
    elif file.kind == "dxf":
        whole = is_whole(file.content)
    elif file.kind == "brep":
        # The last line of a BREP file is the location of the root shape, after the table of shapes.
        whole = "TShapes" in file.text and re.search(r"\n[+-]\d+ \d+\s*(\n0\s*)?$", tail) is not None
    if not whole:
        raise GeometryError(f"the end of this {WORDS[file.kind]} file is missing or damaged; export it again")


def _iges_is_whole(text: str) -> bool:
    """Whether the last line counts the lines of every section as they are."""
    lines = [line for line in text.splitlines() if len(line) > 72]
    counted = dict(re.findall(r"([SGDP])\s*(\d+)", lines[-1][:72])) if lines[-1][72] == "T" else {}
    return bool(counted) and all(
        int(number) == sum(line[72] == section for line in lines) for section, number in counted.items()
    )
