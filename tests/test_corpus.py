"""Real files, by the hundred: those that come with gmsh, and a folder that PHANTOMNODE_CORPUS names.

The folder holds an index.csv with the columns file and status_of_a_first_importer: ok, partial, refuse or fail.
"""

from __future__ import annotations

import csv
import os
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import shapely

from phantomnode import run
from phantomnode.geometry.curves import Geometry, Region, diagonal
from phantomnode.geometry.errors import GeometryError, NoUnitError, OutlineError
from phantomnode.geometry.readers import read_geometry
from phantomnode.geometry.walls import thinnest_wall
from phantomnode.pipeline.adoption import cell_for
from phantomnode.pipeline.case import case_from_table
from phantomnode.pipeline.prepare import prepare

pytestmark = pytest.mark.slow

LONGEST = 30.0
"""Seconds a file may take."""

ENOUGH = 0.9
"""Part of the files that a first importer read, wholly or in part, that give regions."""

BY_GMSH = {".geo", ".step", ".stp", ".brep", ".igs", ".iges", ".msh", ".geo_unrolled", ".xao"}


class Outcome(NamedTuple):
    """How reading a file ended."""

    kind: str  # regions, curves or refusal
    seconds: float
    said: str
    geometry: Geometry | None


def corpus() -> Path:
    folder = os.environ.get("PHANTOMNODE_CORPUS", "")
    if not folder:
        pytest.skip("PHANTOMNODE_CORPUS does not name a folder of CAD files")
    if not (Path(folder) / "index.csv").is_file():
        pytest.skip(f"PHANTOMNODE_CORPUS={folder} holds no index.csv")
    return Path(folder)


def indexed(folder: Path) -> list[tuple[Path, str]]:
    """The files and what a first importer made of them."""
    with (folder / "index.csv").open(newline="", encoding="utf-8") as index:
        rows = list(csv.DictReader(index))
    return [(folder / row["file"], row["status_of_a_first_importer"]) for row in rows]


def of_gmsh() -> list[Path]:
    """The CAD files that gmsh's wheel brings."""
    folder = Path(sys.prefix) / "share" / "doc" / "gmsh"
    return sorted(path for path in folder.rglob("*") if path.suffix.lower() in BY_GMSH)


def read(path: Path) -> Geometry:
    """A file in its own unit, or in millimetres where it has none.

    Where outlines of several layers cross and nothing else is there, the message asks to choose among the layers:
    the one of the longest curve is taken.
    """
    try:
        return read_geometry(path)
    except NoUnitError:
        return read_geometry(path, "mm")
    except OutlineError as error:
        longest = max(error.geometry.curves, key=lambda curve: float(curve.lengths.sum()))
        if len({curve.name for curve in error.geometry.curves}) < 2:
            raise
        return read_geometry(path, layers=[longest.name])


def outcome(path: Path) -> Outcome:
    """How a file ends; anything but geometry or a message is an error of this test."""
    began = time.perf_counter()
    try:
        geometry = read(path)
    except GeometryError as error:
        return Outcome("refusal", time.perf_counter() - began, str(error), None)
    seconds = time.perf_counter() - began
    return Outcome("regions" if geometry.regions else "curves", seconds, "; ".join(geometry.notes), geometry)


def polygons(geometry: Geometry) -> Iterator[Any]:
    """The regions as polygons within a millionth of their size."""
    for region in geometry.regions:
        rings = [loop.polyline(1e-6 * diagonal([loop])) for loop in region.loops]
        yield shapely.Polygon(rings[0], rings[1:])


def check(path: Path, found: Outcome) -> None:
    """One of three ends, in time, said in words, with valid polygons."""
    assert found.seconds < LONGEST, path
    if found.geometry is None:
        assert path.name in found.said and "Traceback" not in found.said, found.said
        return
    assert found.geometry.regions or found.geometry.curves, path
    for polygon in polygons(found.geometry):
        assert polygon.is_valid and polygon.area > 0.0, path


def test_every_file_ends_in_one_of_three_ways_and_most_give_regions() -> None:
    counts: Counter[tuple[str, str]] = Counter()
    missed = []
    for path, status in indexed(corpus()):
        found = outcome(path)
        check(path, found)
        counts[status, found.kind] += 1
        print(f"{status:8} {found.kind:8} {found.seconds:5.1f} s  {path.name}: {found.said}")
        if status in ("ok", "partial") and found.kind != "regions":
            missed.append(path.name)
    print(dict(counts), "missed:", missed)
    wanted = sum(n for (status, _), n in counts.items() if status in ("ok", "partial"))
    assert len(missed) <= (1.0 - ENOUGH) * wanted, missed


def test_every_file_of_gmsh_ends_in_one_of_three_ways() -> None:
    files = of_gmsh()
    if not files:
        pytest.skip("gmsh brought no examples")
    counts: Counter[str] = Counter()
    for path in files:
        found = outcome(path)
        check(path, found)
        counts[found.kind] += 1
        print(f"{found.kind:8} {found.seconds:5.1f} s  {path.name}: {found.said[:300]}")
    print(dict(counts))


CONFIRMED = (
    "trimesh__models__2D__LM2.dxf", "trimesh__models__2D__apu-mount.DXF", "trimesh__models__2D__cycloidal.dxf",
    "trimesh__models__2D__single_arc.dxf", "cadquery__doc__vslot-2020_1.dxf", "cadquery__tests__testdata__1001.dxf",
    "cadquery__tests__testdata__genshi.dxf", "dxf2gcode-plasma__dxf__ATT00079.dxf",
    "dxf2gcode-plasma__dxf__Lueftergitter_R14.dxf", "dxf__test__resources__issue29.dxf",
    "cad_to_shapely==0.3.3__example_files__200ub22_R12dxf_linesandarcs.dxf",
    "cad_to_shapely==0.3.3__example_files__hollow_section_mirrored_arcs.dxf",
)  # fmt: skip
"""Drawings whose area is found again without any code of this project."""


def flattened(path: Path, sagitta: float) -> list[np.ndarray]:
    """Every curve of the model space as ezdxf itself flattens it."""
    from ezdxf import disassemble

    from phantomnode.geometry.dxf_load import load, quiet

    lines = []
    with quiet():
        document, _ = load(path.read_bytes())
        drawn = [entity for entity in document.modelspace() if entity.dxftype() != "DIMENSION"]
        for entity in disassemble.recursive_decompose(drawn):
            kind = entity.dxftype()
            parts = entity.virtual_entities() if kind in ("LWPOLYLINE", "POLYLINE") else [entity]
            for part in parts:
                if part.dxftype() == "LINE":
                    points = [part.dxf.start, part.dxf.end]
                elif part.dxftype() in ("ARC", "CIRCLE", "ELLIPSE", "SPLINE"):
                    points = list(part.flattening(sagitta))
                else:
                    continue
                lines.append(np.array([tuple(point)[:2] for point in points]))
    return lines


def even_odd_area(lines: list[np.ndarray], snap: float) -> float:
    """The area of the points from which a ray to the right meets the lines an odd number of times.

    Nothing is joined or nested: the lines divide the plane into faces, and a point in each is asked.
    """
    network = shapely.unary_union(shapely.MultiLineString([np.round(line / snap) * snap for line in lines]))
    faces = shapely.get_parts(shapely.polygonize(shapely.get_parts(network)))
    segments = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in lines])
    total = 0.0
    for face in faces:
        x, y = shapely.get_coordinates(face.representative_point())[0]
        (x0, y0), (x1, y1) = segments[:, 0].T, segments[:, 1].T
        crossing = (y0 > y) != (y1 > y)
        at = x0[crossing] + (y - y0[crossing]) * (x1 - x0)[crossing] / (y1 - y0)[crossing]
        total += face.area * (np.count_nonzero(at > x) % 2)
    return total


@pytest.mark.parametrize("name", CONFIRMED)
def test_areas_are_found_again_by_polygonizing_what_ezdxf_flattens(name: str) -> None:
    from phantomnode.geometry.units import metres

    geometry = read(corpus() / name)
    factor = metres(geometry.unit)
    boxes = np.array([region.box for region in geometry.regions]) / factor
    size = float(np.hypot(*(boxes[:, 1].max(axis=0) - boxes[:, 0].min(axis=0))))
    area = sum(region.area for region in geometry.regions) / factor**2
    again = even_odd_area(flattened(corpus() / name, 1e-7 * size), 1e-7 * size)
    length = sum(float(loop.lengths.sum()) for region in geometry.regions for loop in region.loops) / factor
    # Either side flattens free-form curves, within 1e-6 and 1e-7 of the drawing's size along their length.
    assert abs(area - again) < 1.1e-6 * size * length, (area, again)
    assert abs(area / again - 1.0) < 1e-4


STEPS = 200
MET_AFTER = 20
"""Steps of a run, and those until the plane is met."""

SPEED = 10.0
"""m/s"""

SAFETY = 0.25
"""Of the stable step. A point that has met the plane by w at the end of a step has an energy of penalty w^2/2 that it
was not given: an error in proportion to the square of the step, for all points of a flat side at once."""


def falling(path: Path, geometry: Geometry) -> dict[str, Any]:
    """A case in which the largest region of a file falls on a rigid plane."""
    number = max(range(len(geometry.regions)), key=lambda k: geometry.regions[k].area)
    region = geometry.regions[number]
    part: dict[str, Any] = {
        "geometry": {"file": str(path), "unit": geometry.unit, "region": number + 1},
        "grid": {"kind": "cartesian", "cell": cell_for(region, thinnest_wall([region]))},
        "material": "rubber",
        "initial_velocity": [0.0, -SPEED],
    }
    if any(layer.state == "not asked for" for layer in geometry.contents):
        part["geometry"]["layers"] = [layer.name for layer in geometry.contents if not layer.state]
    return {
        "title": path.name,
        "time": {"end": 1.0, "safety": SAFETY},
        "material": {"rubber": {"E": 50e6, "nu": 0.4, "rho": 1100.0}},
        "body": {"part": part},
        "rigid": {"floor": floor(geometry.regions[number], 0.0)},
        "contact": {"landing": {"slave": "part.outer", "master": "floor"}},
        "output": {"fields": {"count": 1}, "history": {"count": 20}},
    }


def floor(region: Region, gap: float) -> dict[str, Any]:
    """A plane below a region; the obstacle is on the left of its curve."""
    (left, bottom), (right, _) = region.box
    margin = float(right - left)
    points = [[right + margin, bottom - gap], [left - margin, bottom - gap]]
    return {"geometry": {"polyline": {"points": points}}}


def test_a_body_of_every_readable_file_falls_on_a_rigid_plane(tmp_path: Path) -> None:
    errors: dict[str, float] = {}
    for k, (path, _) in enumerate(indexed(corpus())):
        found = outcome(path)
        if found.kind == "regions":
            assert found.geometry is not None
            errors[path.name] = fallen(path, found.geometry, tmp_path / str(k))
    good = [name for name, error in errors.items() if error < 1e-3]
    print(f"{len(good)} of {len(errors)} bodies keep their energy to 1e-3")
    assert len(good) >= 20


def fallen(path: Path, geometry: Geometry, folder: Path) -> float:
    """The largest error of the energy of a fall, over the largest energy."""
    region = max(geometry.regions, key=lambda region: region.area)
    table = falling(path, geometry)
    step = prepare(case_from_table(table)).dt
    table["rigid"]["floor"] = floor(region, MET_AFTER * step * SPEED)
    table["time"] = {"end": STEPS * step, "step": step}
    summary = run(case_from_table(table), folder)
    force, error = summary.figures["peak_contact_force"]["landing"], summary.figures["energy_error_max"]
    print(f"{error:.1e}  {force:.3g} N/m  {path.name}", flush=True)
    assert force > 0.0
    return float(error)
