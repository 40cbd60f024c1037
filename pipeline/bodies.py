"""Each body of a case on its way from a drawing to a cut mesh."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry import grid as grids
from phantomnode.geometry import mapped, shapes
from phantomnode.geometry.curves import Curve, Geometry, Region, diagonal
from phantomnode.geometry.cut import cut
from phantomnode.geometry.doubling import CutMesh, double
from phantomnode.geometry.errors import GeometryError, OutlineError
from phantomnode.geometry.fans import centroid_fans
from phantomnode.geometry.findings import complaint, open_ends
from phantomnode.geometry.grid import BackgroundGrid
from phantomnode.geometry.noding import Lattice
from phantomnode.geometry.relocate import relocate
from phantomnode.geometry.units import size_note
from phantomnode.pipeline.drawings import Drawings
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.expressions import ExpressionError, parse
from phantomnode.pipeline.schema import Case
from phantomnode.pipeline.shapes import (
    BodyGeometry,
    CartesianGrid,
    CurveGeometry,
    FileGrid,
    MappedGrid,
    PolarGrid,
)

Floats = NDArray[np.float64]
Texts = tuple[str, ...]

CHORD_ERROR = 1e-6
"""A function y(x) is followed by straight lines within this part of its width."""


@dataclass(frozen=True)
class CutBody:
    """One body cut out of its background grid, before it joins the model.

    Attributes
    ----------
    regions : tuple of Region
        Its outlines, placed.
    interfaces : tuple of (str, Curve)
        The curves inside it with the names of their interfaces.
    grid : BackgroundGrid
        After relocation.
    relocated : int
        Number of relocated grid nodes.
    mesh : CutMesh
    notes : tuple of str
        What was mended in the drawing, and what of it does not count.
    warnings : tuple of str
        What the grid is too coarse for, and a size that was hardly meant.
    """

    regions: tuple[Region, ...]
    interfaces: tuple[tuple[str, Curve], ...]
    grid: BackgroundGrid
    relocated: int
    mesh: CutMesh
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


def cut_body(case: Case, name: str, drawings: Drawings) -> CutBody:
    """Read, place, relocate, cut and double one body.

    Raises
    ------
    CaseError
        With the key of the body, grid or interface at fault.
    """
    with at(case, f"body.{name}.geometry"):
        regions, notes, doubts = _regions(drawings, case.body[name].geometry)
    interfaces: list[tuple[str, Curve]] = []
    for label, interface in case.interface.items():
        if interface.body == name:
            with at(case, f"interface.{label}.geometry"):
                curves, more = curves_of(drawings, interface.geometry, regions)
                interfaces += [(label, curve) for curve in curves]
                notes += more
    with at(case, f"body.{name}.grid"):
        grid = grids.check(background_grid(case, name, regions, drawings))
    with at(case, f"body.{name}"):
        curves = tuple(curve for _, curve in interfaces)
        loops = [loop for region in regions for loop in region.loops]
        relocation = relocate(grid, [*loops, *curves], case.relocation.distance)
        mesh = double(relocation.grid, cut(relocation.grid, regions, curves, Lattice.of(grid)))
    if case.integration.cut == 1:
        triangles, owner = centroid_fans(mesh.triangles, mesh.triangle_element)
        mesh = replace(mesh, triangles=triangles, triangle_element=owner)
    told, warnings = (
        tuple(f"body {name}: {text}" for text in texts)
        for texts in (notes, (*doubts, *mesh.notes, *_resolution(mesh, len(loops), interfaces)))
    )
    moved = int(np.count_nonzero(relocation.fate.moved))
    return CutBody(regions, tuple(interfaces), relocation.grid, moved, mesh, told, warnings)


FEW = 10
"""Elements that are no body."""
COARSE = 0.6
"""A body of which more than this part of the elements is cut is hardly thicker than a cell."""


def _resolution(mesh: CutMesh, loops: int, interfaces: list[tuple[str, Curve]]) -> list[str]:
    """Warnings of a body that its grid hardly resolves, and of interfaces that cut nothing."""
    notes = []
    if len(mesh.cut) < FEW:
        notes.append(f"it has {len(mesh.cut)} elements: are the cell and the unit of its drawing right")
    elif mesh.cut.mean() > COARSE:
        notes.append(
            f"{mesh.cut.sum()} of its {len(mesh.cut)} elements are cut: it is hardly thicker than a cell; "
            "use smaller cells"
        )
    names = dict.fromkeys(name for name, _ in interfaces)
    on = {interfaces[k - loops][0] for k in mesh.segments.curve[mesh.segments.side != 0]}
    notes += [
        f"interface {name} cuts nothing: it lies outside or within one cell"
        for name in names
        if name not in on
    ]
    return notes


@contextmanager
def at(case: Case, key: str) -> Iterator[None]:
    """Say at which key of the case a geometry or expression failed."""
    try:
        yield
    except (GeometryError, ExpressionError) as error:
        raise CaseError(f"{case.name}: {key}: {error}") from error


def _regions(drawings: Drawings, geometry: BodyGeometry) -> tuple[tuple[Region, ...], Texts, Texts]:
    """The outlines of a body, placed, with the reader's notes and its doubts about the size."""
    source = _drawing(drawings, geometry)
    doubt = size_note(diagonal([*(r.outer for r in source.regions), *source.curves]), source.unit)
    if not source.regions:
        raise OutlineError(
            f"there is no closed outline, and a body needs one; {open_ends(source.curves, source.unit)}",
            source,
        )
    if geometry.region is not None:
        source = replace(source, regions=_chosen(source, geometry.region))
    elif source.wrong:
        raise OutlineError(complaint(source.findings, source.unit), source)
    elif geometry.file is not None and source.curves:
        note = f"{len(source.curves)} curves of {geometry.file} are no part of an outline and are left out"
        source = replace(source, notes=(*source.notes, note))
    placed = shapes.placed(replace(source, curves=()), geometry.move, geometry.rotate, geometry.scale)
    notes = tuple(note for note in source.notes if note != doubt)
    return placed.regions, notes, (doubt,) if doubt in source.notes else ()


def _chosen(source: Geometry, region: str | int) -> tuple[Region, ...]:
    """The region of a number, or those of a name (their own, or that of the layer of their outline)."""
    if isinstance(region, int):
        if not 1 <= region <= len(source.regions):
            raise GeometryError(
                f"there is no region {region}; there are {len(source.regions)}, counted from 1"
            )
        return (source.regions[region - 1],)
    found = tuple(r for r in source.regions if region in (r.name, r.outer.name))
    if not found:
        names = sorted({name for r in source.regions for name in (r.name, r.outer.name) if name})
        raise GeometryError(
            f"no region is named {region!r}; there are {len(source.regions)}, which can be taken by number"
            f"{', or by a name: ' + ', '.join(names) if names else ''}"
        )
    return found


def _drawing(drawings: Drawings, geometry: BodyGeometry) -> Geometry:
    """A body's geometry before it is placed."""
    if geometry.file is not None:
        return drawings.geometry(geometry)
    if geometry.rectangle is not None:
        return Geometry((shapes.rectangle(geometry.rectangle.low, geometry.rectangle.high),))
    if geometry.circle is not None:
        return Geometry((shapes.circle(geometry.circle.centre, geometry.circle.radius),))
    if geometry.ring is not None:
        ring = geometry.ring
        return Geometry((shapes.ring(ring.centre, ring.outer, ring.inner),))
    assert geometry.polygon is not None  # the schema asks for exactly one source
    return Geometry((shapes.polygon(geometry.polygon.points),))


def curves_of(
    drawings: Drawings, geometry: CurveGeometry, regions: tuple[Region, ...] = ()
) -> tuple[tuple[Curve, ...], tuple[str, ...]]:
    """The curves of an interface, placed, with the reader's notes."""
    notes: tuple[str, ...] = ()
    if geometry.file is not None:
        drawing = drawings.geometry(geometry)
        if drawing.wrong:
            raise OutlineError(complaint(drawing.findings, drawing.unit), drawing)
        loops = tuple(loop for region in drawing.regions for loop in region.loops)
        curves, notes = (*drawing.curves, *loops), drawing.notes
    elif geometry.polyline is not None:
        curves = (shapes.polyline(geometry.polyline.points),)
    elif geometry.rectangle is not None:
        curves = (shapes.rectangle(geometry.rectangle.low, geometry.rectangle.high).outer,)
    elif geometry.circle is not None:
        curves = (shapes.circle(geometry.circle.centre, geometry.circle.radius).outer,)
    elif geometry.polygon is not None:
        curves = (shapes.polygon(geometry.polygon.points).outer,)
    else:
        assert geometry.function is not None  # the schema asks for exactly one source
        curves = (_graph(geometry.function, geometry.x, regions),)
    placed = shapes.placed(Geometry((), curves), geometry.move, geometry.rotate, geometry.scale)
    return placed.curves, notes


def _graph(function: str, span: tuple[float, float] | None, regions: tuple[Region, ...]) -> Curve:
    """The curve y = f(x) over a span, by default the width of the body."""
    if span is None:
        if not regions:
            raise GeometryError(
                "x = [first, last] must be given: there is no body whose width could be taken"
            )
        boxes = np.array([region.box for region in regions])
        span = (float(boxes[:, 0, 0].min()), float(boxes[:, 1, 0].max()))
    return shapes.graph(parse(function, "x"), span[0], span[1], CHORD_ERROR * (span[1] - span[0]))


def background_grid(case: Case, name: str, regions: tuple[Region, ...], drawings: Drawings) -> BackgroundGrid:
    """The background grid of a body, before its nodes are relocated."""
    grid = case.grid_of(name)
    if isinstance(grid, CartesianGrid):
        boxes = np.array([region.box for region in regions])
        low, high = grid.box or (boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0))
        return grids.cartesian(low, high, cell=grid.spacing, counts=grid.counts, aligned=grid.aligned)
    if isinstance(grid, PolarGrid):
        return mapped.polar(grid.centre, radii=grid.radii, angles=grid.angles, counts=grid.counts)
    if isinstance(grid, MappedGrid):
        bottom, right, top, left = (
            _one_curve(drawings, side) for side in (grid.bottom, grid.right, grid.top, grid.left)
        )
        return mapped.mapped(bottom, right, top, left, grid.counts)
    assert isinstance(grid, FileGrid)
    return drawings.quads(grid)


def _one_curve(drawings: Drawings, geometry: CurveGeometry) -> Curve:
    """The one curve of a side of a mapped grid."""
    curves, _ = curves_of(drawings, geometry)
    if len(curves) != 1:
        raise GeometryError(f"a side of a mapped grid is one curve, but {len(curves)} were found")
    return curves[0]
