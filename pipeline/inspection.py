"""``phantomnode inspect``: what a geometry file holds, in words and as a picture."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from phantomnode.geometry.curves import Geometry, diagonal, part_names
from phantomnode.geometry.errors import NoUnitError, OutlineError
from phantomnode.geometry.findings import HEALED, WRONG, open_ends
from phantomnode.geometry.limits import TIME_LIMIT
from phantomnode.geometry.readers import read_geometry
from phantomnode.geometry.units import metres, size_note
from phantomnode.geometry.walls import thinnest_wall

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

MOST_ROWS = 40
"""Regions and curves that are listed, in the order of their numbers."""


@dataclass(frozen=True)
class Inspection:
    """A geometry file that was read as far as it can be.

    Attributes
    ----------
    path : Path
    geometry : Geometry
    has_unit : bool
        Whether the file or the user says a unit; where not, the numbers stand as if they were metres.
    refusal : str or None
        Why no body can be made of it as it is.
    """

    path: Path
    geometry: Geometry
    has_unit: bool
    refusal: str | None


def inspect_file(
    path: Path,
    unit: str | None = None,
    *,
    layers: Sequence[str] = (),
    without_layers: Sequence[str] = (),
    trust_scripts: bool = False,
    face: str | int | None = None,
    section: tuple[str, float] | None = None,
    time_limit: float = TIME_LIMIT,
) -> Inspection:
    """Read a file as :func:`phantomnode.geometry.readers.read_geometry` does, also where outlines cross.

    Raises
    ------
    GeometryError
        Where it cannot be read at all.
    """
    has_unit, refusal = True, None

    def read(unit: str | None) -> Geometry:
        return read_geometry(
            path, unit, layers=layers, without_layers=without_layers, trust_scripts=trust_scripts, face=face,
            section=section, time_limit=time_limit,
        )  # fmt: skip

    try:
        try:
            geometry = read(unit)
        except NoUnitError:
            has_unit = False
            geometry = read("m")
    except OutlineError as error:
        geometry, refusal = error.geometry, str(error)
    return Inspection(path, geometry, has_unit, refusal)


def report(found: Inspection) -> RenderableType:
    """Layers, regions, curves, what was mended and what is wrong, as tables."""
    from rich.console import Group
    from rich.text import Text

    geometry, unit = found.geometry, _unit(found)
    parts: list[RenderableType] = [Text(line) for line in _head(found)]
    parts.append(Text())
    if geometry.contents:
        parts.append(_table(("layer", "state", "holds"), _layer_rows(geometry)))
    if geometry.regions:
        columns = (
            "region",
            "outline",
            f"area, {unit}^2",
            f"size, {unit}",
            f"from, {unit}",
            f"wall, {unit}",
            "holes",
            "lines",
            "arcs",
            "parts",
        )
        parts.append(_table(columns, _region_rows(geometry, found.has_unit)))
    if geometry.curves:
        headings = ("curve", "name", f"length, {unit}", f"from, {unit}", f"to, {unit}")
        parts.append(_table(headings, _curve_rows(geometry, found.has_unit)))
    parts += [Text(line) for line in _findings(found)]
    return Group(*parts)


def _unit(found: Inspection) -> str:
    return found.geometry.unit if found.has_unit else "units"


def _head(found: Inspection) -> Iterator[str]:
    """Format, unit, size and counts."""
    geometry = found.geometry
    every = [*(loop for region in geometry.regions for loop in region.loops), *geometry.curves]
    boxes = np.array([curve.box for curve in every])
    width, height = boxes[:, 1].max(axis=0) - boxes[:, 0].min(axis=0)
    factor = metres(geometry.unit)
    yield f"{found.path}: {geometry.format}"
    if found.has_unit:
        yield f"unit {geometry.unit}, size {width / factor:.6g} x {height / factor:.6g} {geometry.unit}" + (
            "" if geometry.unit == "m" else f" ({width:.6g} x {height:.6g} m)"
        )
    else:
        yield f'no unit is said: give one (unit = "mm"); size {width:.6g} x {height:.6g} units'
    holes = sum(len(region.holes) for region in geometry.regions)
    counts = ((len(geometry.regions), "region"), (holes, "hole"), (len(geometry.curves), "other curve"))
    regions, inner, others = (f"{count} {name}{'' if count == 1 else 's'}" for count, name in counts)
    yield f"{regions} with {inner}, {others}"


def _layer_rows(geometry: Geometry) -> Iterator[tuple[str, ...]]:
    for layer in geometry.contents:
        yield layer.name, layer.state, ", ".join(f"{count} {kind}" for kind, count in layer.kinds)


def _region_rows(geometry: Geometry, has_unit: bool) -> Iterator[tuple[str, ...]]:
    factor = metres(geometry.unit) if has_unit else 1.0
    for k, region in enumerate(geometry.regions[:MOST_ROWS]):
        low, high = region.box / factor
        bulges = np.concatenate([loop.bulges for loop in region.loops])
        arcs = int(np.count_nonzero(bulges))
        wall = thinnest_wall([region]) / factor
        yield (
            str(k + 1), region.name or region.outer.name or "-", f"{region.area / factor**2:.8g}",
            f"{high[0] - low[0]:.6g} x {high[1] - low[1]:.6g}", f"({low[0]:.6g}, {low[1]:.6g})",
            f"{wall:.3g}" if np.isfinite(wall) else "-", str(len(region.holes)),
            str(len(bulges) - arcs), str(arcs), ", ".join(part_names((region,))),
        )  # fmt: skip
    if len(geometry.regions) > MOST_ROWS:
        yield (f"and {len(geometry.regions) - MOST_ROWS} more", *("",) * 9)


def _curve_rows(geometry: Geometry, has_unit: bool) -> Iterator[tuple[str, ...]]:
    factor = metres(geometry.unit) if has_unit else 1.0
    for k, curve in enumerate(geometry.curves[:MOST_ROWS]):
        (x0, y0), (x1, y1) = curve.points[[0, -1]] / factor + 0.0
        yield (
            str(k + 1), curve.name, f"{float(curve.lengths.sum()) / factor:.6g}", f"({x0:.6g}, {y0:.6g})",
            "closed" if curve.closed else f"({x1:.6g}, {y1:.6g})",
        )  # fmt: skip
    if len(geometry.curves) > MOST_ROWS:
        yield (f"and {len(geometry.curves) - MOST_ROWS} more", *("",) * 4)


def _findings(found: Inspection) -> Iterator[str]:
    """Every finding in full, and the notes of the reader."""
    geometry = found.geometry
    doubt = size_note(diagonal([*(r.outer for r in geometry.regions), *geometry.curves]), geometry.unit)
    healed = tuple(HEALED.values())
    for note in geometry.notes:
        # What was mended follows in full; a size means nothing without a unit.
        if not any(what in note for what in healed) and (found.has_unit or note != doubt):
            yield f"note      {note}"
    for title, kinds in (("mended", HEALED), ("problem", WRONG)):
        for kind, what in kinds.items():
            hits = [finding for finding in geometry.findings if finding.kind == kind]
            if hits:
                yield f"{title:9} {len(hits)} {what}"
                for finding in sorted(hits, key=lambda f: -f.size):
                    yield f"            {finding.told(geometry.unit, _unit(found))}"
    gaps = [finding.size for finding in geometry.findings if finding.kind == "gap"]
    if gaps:
        factor = metres(geometry.unit)
        yield f"          ends up to {max(gaps) / factor:.2g} {_unit(found)} apart were joined"
    if not geometry.regions:
        where = open_ends(geometry.curves, geometry.unit, _unit(found))
        yield f"problem   there is no closed outline, and a body needs one; {where}"
    if found.refusal is not None or geometry.wrong:
        yield "problem   no body can be made of crossing outlines: take layers or one region"


def _table(columns: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> Table:
    from rich.table import Table
    from rich.text import Text

    table = Table(*columns, box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    table.add_row()
    return table
