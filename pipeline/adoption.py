"""``phantomnode new NAME --from FILE``: a case for a drawing, with the names in it filled in."""

from __future__ import annotations

import re
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from phantomnode.geometry.curves import Geometry, Region, part_names
from phantomnode.geometry.errors import OutlineError
from phantomnode.geometry.findings import complaint, open_ends
from phantomnode.geometry.limits import TIME_LIMIT
from phantomnode.geometry.readers import read_geometry
from phantomnode.geometry.walls import thinnest_wall
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.starter import make_new

HEAD = """\
#:schema ./case.schema.json
# {what} of {file} {falls} on a rigid plane. See what it becomes:   phantomnode check {folder}
# Then run it:                                        phantomnode run {folder}
#
# Units are SI (m, s, kg, Pa), plane strain, forces per metre of thickness.
{remarks}
title = "{file} falls on a plane"
# The end: {fall} ms of fall, and {waves} ms in which waves cross the part eight times. A stocky part has bounced
# off by then; one with thin walls still bends: let it run longer where you want to see that.
time = {{ end = {end:g} }}                    # s; the step is found automatically

[material.steel]
E = 210e9                                   # Young's modulus, Pa; elastic only: nothing yields
nu = 0.3                                    # Poisson's ratio, below 0.5
rho = 7800.0                                # density, kg/m^3
"""

BODY = """
# {name}: {size}; parts: {parts}
[body.{name}]
geometry = {{ {geometry} }}
grid = {{ kind = "cartesian", cell = {cell:g} }}{space}# m; {through}
material = "steel"
initial_velocity = [0.0, -{speed:g}]             # m/s
"""

FLOOR = """
[rigid.floor]                               # an obstacle without a mesh, on the left of its curve
geometry = {{ polyline = {{ points = [[{right:g}, {height:.10g}], [{left:g}, {height:.10g}]] }} }}
"""

CONTACT = """
[contact.{name}_on_floor]
slave = "{name}.outer"                      # any of the parts above
master = "floor"
"""

BETWEEN = """
# Bodies that share no contact pass through each other. Where two of them meet:
# [contact.{one}_on_{other}]
# slave = "{one}.outer"
# master = "{other}.outer"
"""

FAR_APART = """\
# The regions lie far above each other: most of the time is fall. Take one of them (leave out the other bodies with
# their contacts), or bring them down: geometry = { ..., move = [0.0, -0.1] }, in m.
"""

OUTPUT = """
[output]
fields = { count = 40 }                     # pictures for ParaView: open fields.pvd
history = { count = 500 }                   # rows of history.csv
"""

SPEED = 10.0
"""Of the fall, m/s: small against waves in steel, so that the impact is mild."""

WAVE = 5900.0
"""Speed of pressure waves in steel, m/s."""

WAVES = 8.0
"""Ways of a wave across the part that a run takes after the fall."""

LONG = 4.0
"""Times as long as the waves take: a fall that is most of a run."""

MOST_BODIES = 8
"""Regions that become bodies, the largest first."""

MOST_CELLS = 8_000
"""Cells on the material of a body: a case to begin with runs in less than a minute."""

MOST_IN_BOX = 400_000
"""Cells in the box of a body, most of them empty where its walls are thin."""

ENOUGH = 4
"""Cells through a wall that bends right."""


def write_case_for(
    folder: Path,
    file: Path,
    unit: str | None = None,
    layers: Sequence[str] = (),
    without_layers: Sequence[str] = (),
    face: str | int | None = None,
    section: tuple[str, float] | None = None,
    time_limit: float = TIME_LIMIT,
) -> Path:
    """Write a case in which the regions of a geometry file fall on a rigid plane, into a new folder.

    Parameters
    ----------
    folder : Path
        Made, with its parents; an empty one is used. It gets a copy of the file.
    file : Path
    unit : str, optional
        Unit of the file; its own unless given.
    layers, without_layers : sequence of str
        Layers of a DXF drawing that alone count, or that do not.
    face : str or int, optional
    section : (str, float), optional
        What to take of a 3D part, as :func:`phantomnode.geometry.readers.read_geometry` does.
    time_limit : float, s

    Raises
    ------
    CaseError, GeometryError
        If the folder holds anything already, or no body can be made of the file.
    """
    geometry = read_geometry(
        file, unit, layers=layers, without_layers=without_layers, face=face, section=section,
        time_limit=time_limit,
    )  # fmt: skip
    if geometry.wrong:
        raise OutlineError(f"{file}: {complaint(geometry.findings, geometry.unit)}", geometry)
    if not geometry.regions:
        raise CaseError(
            f"{file}: there is no closed outline, and a body needs one; "
            f"{open_ends(geometry.curves, geometry.unit)}; look: phantomnode inspect {file}"
        )
    wanted = {
        "layers": layers,
        "without_layers": without_layers,
        "face": face,
        "section": section,
        "time_limit": None if time_limit == TIME_LIMIT else time_limit,
    }
    text = _case(folder, file.name, geometry, wanted)
    make_new(folder)
    shutil.copyfile(file, folder / file.name)
    (folder / "case.toml").write_text(text, encoding="utf-8")
    return folder


def _case(folder: Path, file: str, geometry: Geometry, wanted: Mapping[str, Any]) -> str:
    """The text of the case file."""
    order = sorted(range(len(geometry.regions)), key=lambda k: -geometry.regions[k].area)[:MOST_BODIES]
    names = _names([geometry.regions[k] for k in order])
    boxes = np.array([geometry.regions[k].box for k in order])
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    walls = [thinnest_wall([geometry.regions[k]]) for k in order]
    cells = [cell_for(geometry.regions[k], wall) for k, wall in zip(order, walls, strict=True)]
    gap = 0.5 * min(cells)
    fall = max(float(box[0, 1] - low[1]) for box in boxes) + gap
    waves = WAVES * float(np.max(high - low)) / WAVE
    end = _rounded_up(fall / SPEED + waves)
    options = f'file = "{file}", unit = "{geometry.unit}"' + "".join(
        f", {key} = {_value(chosen)}" for key, chosen in wanted.items() if chosen
    )
    several = len(order) > 1
    remarks = _remarks(geometry, len(order))
    if fall / SPEED > LONG * waves:
        remarks += FAR_APART
    parts = [
        HEAD.format(
            what=f"{len(order)} regions" if several else "The outline", falls="fall" if several else "falls",
            file=file, folder=folder, end=end, remarks=remarks,
            fall=f"{1e3 * fall / SPEED:.2g}", waves=f"{1e3 * waves:.2g}",
        )
    ]  # fmt: skip
    for k, name, cell, wall in zip(order, names, cells, walls, strict=True):
        region = geometry.regions[k]
        width, height = region.box[1] - region.box[0]
        parts.append(
            BODY.format(
                name=name, size=f"{width:.6g} x {height:.6g} m", parts=", ".join(part_names((region,))), cell=cell,
                space=" " * max(1, 8 - len(f"{cell:g}")), through=_through(cell, wall),
                geometry=options + (f", region = {k + 1}" if len(geometry.regions) > 1 else ""), speed=SPEED,
            )
        )  # fmt: skip
    margin = float(high[0] - low[0])
    parts.append(FLOOR.format(left=low[0] - margin, right=high[0] + margin, height=low[1] - gap))
    parts += [CONTACT.format(name=name) for name in names]
    if several:
        parts.append(BETWEEN.format(one=names[0], other=names[1]))
    return "".join((*parts, OUTPUT))


def _value(chosen: Any) -> str:
    """A choice of layers, a face, a section or a time as TOML."""
    if isinstance(chosen, tuple) and isinstance(chosen[-1], float):
        return f'{{ axis = "{chosen[0]}", at = {chosen[1]!r} }}'
    if isinstance(chosen, int | float):
        return repr(chosen)
    return _quoted(chosen) if isinstance(chosen, str) else f"[{', '.join(map(_quoted, chosen))}]"


def _remarks(geometry: Geometry, bodies: int) -> str:
    """What the drawing holds beside the bodies, as comments."""
    lines = [f"# {note}" for note in geometry.notes]
    if len(geometry.regions) > bodies:
        lines.append(
            f"# {len(geometry.regions) - bodies} smaller regions are left out: phantomnode inspect lists them."
        )
    if geometry.curves:
        lines.append(
            f"# {len(geometry.curves)} curves are no outline; one across a body can split it ([interface.NAME])."
        )
    return "".join(line + "\n" for line in lines)


def _names(regions: Sequence[Region]) -> list[str]:
    """A name for each region that a table can have: its own, that of its layer, or "part", numbered."""
    names: list[str] = []
    for region in regions:
        own = re.sub(r"\W+", "_", region.name or region.outer.name, flags=re.ASCII).strip("_").lower()
        name = base = own[:30] if own[:1].isalpha() else "part"
        number = 1
        while name in (*names, "floor"):
            number += 1
            name = f"{base}_{number}"
        names.append(name)
    return names


def cell_for(region: Region, wall: float) -> float:
    """A cell, m: four to the thinnest wall or the mean width of the region, as far as the number of cells allows."""
    length = float(sum(loop.lengths.sum() for loop in region.loops))
    width, height = region.box[1] - region.box[0]
    return _rounded_down(
        max(
            min(2.0 * region.area / length, wall) / ENOUGH,
            float(np.sqrt(region.area / MOST_CELLS)),
            float(np.sqrt(width * height / MOST_IN_BOX)),
        )
    )


def _through(cell: float, wall: float) -> str:
    """How many cells go through the thinnest wall, and what it would take to have enough."""
    if wall > 2.0 * ENOUGH * cell:
        return "smaller cells are truer, and take longer: half the size eight times"
    told = f"{wall / cell:.2g} through the thinnest wall, {wall:.2g} m"
    if wall >= ENOUGH * cell:
        return told
    return f"{told} ({ENOUGH} bend right: {(ENOUGH * cell / wall) ** 3:.2g} times the time)"


def _rounded_down(value: float) -> float:
    """The value to two digits, no more than it is."""
    rounded, last = _rounded(value), 10.0 ** (np.floor(np.log10(value)) - 1.0)
    return _rounded(rounded - last) if rounded > value * (1.0 + 1e-9) else rounded


def _rounded_up(value: float) -> float:
    """The value to two digits, no less than it is."""
    rounded, last = _rounded(value), 10.0 ** (np.floor(np.log10(value)) - 1.0)
    return _rounded(rounded + last) if rounded < value * (1.0 - 1e-9) else rounded


def _rounded(value: float) -> float:
    """The value to two digits."""
    return float(f"{value:.1e}")


def _quoted(text: str) -> str:
    """A TOML string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
