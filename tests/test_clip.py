"""What is drawn: cells that belong together share points, sides of an interface do not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import pyvista
import shapely

from phantomnode.pipeline.case import case_from_table, load_case
from phantomnode.pipeline.census import areas
from phantomnode.pipeline.clip import ClippedBodies, cell_labels
from phantomnode.pipeline.fields import BodiesFile
from phantomnode.pipeline.outlines import open_edges
from phantomnode.pipeline.preflight import steps_of
from phantomnode.pipeline.prepare import prepare
from phantomnode.pipeline.run import frames_of
from phantomnode.pipeline.stopping import Stopping

SLANTED = {
    "kind": "mapped",
    "bottom": {"polyline": {"points": [[-0.2, -0.1], [1.3, -0.2]]}},
    "right": {"polyline": {"points": [[1.3, -0.2], [1.2, 1.2]]}},
    "top": {"polyline": {"points": [[-0.1, 1.1], [1.2, 1.2]]}},
    "left": {"polyline": {"points": [[-0.2, -0.1], [-0.1, 1.1]]}},
    "counts": [13, 11],
}


@pytest.mark.parametrize("relocation", [0.0, 0.1])
def test_the_outline_drawn_is_the_boundary_and_both_sides_of_interfaces(relocation: float) -> None:
    """On slanted cells cut corners lie beside the edge by the lattice (2e-7 h), and are one point all the same."""
    table = {
        "time": {"end": 1e-3},
        "relocation": {"distance": relocation},
        "material": {"soft": {"E": 1e9, "nu": 0.3, "rho": 1000.0}},
        "body": {
            "block": {
                "geometry": {"rectangle": {"low": [0.0, 0.0], "high": [1.0, 1.0]}},
                "grid": SLANTED,
                "material": "soft",
            }
        },
        "interface": {
            "joint": {"body": "block", "geometry": {"polyline": {"points": [[0.0, 0.4], [1.0, 0.61]]}}}
        },
    }
    prepared = prepare(case_from_table(table))
    clipped = ClippedBodies.of(prepared)
    points = clipped.interpolate(prepared.model.x)
    ends = points[open_edges([clipped.quads, clipped.triangles], points)]
    length = np.hypot(*(ends[:, 1] - ends[:, 0]).T).sum()
    assert length == pytest.approx(4.0 + 2.0 * np.hypot(1.0, 0.21), rel=1e-5)


CASES = {
    "ring_impact": ("body.ring.grid.cell=0.025", "body.obstacle.grid.cell=0.05"),
    "split_block_wave": (),
    "wavy_block": ("body.block.grid.counts=[20, 10]",),
}


def polygons_of(clipped: ClippedBodies, points: np.ndarray) -> np.ndarray:
    """All cells drawn."""
    return np.concatenate([shapely.polygons(points[ring]) for ring in (clipped.quads, clipped.triangles)])


def loose(cells: np.ndarray) -> float:
    """What overlaps and what gapes between cells that belong together, as parts of their area."""
    area = shapely.area(cells).sum()
    whole = shapely.union_all(cells)
    assert whole.geom_type == "Polygon"
    holes = np.array([shapely.area(shapely.polygons(ring)) for ring in whole.interiors])
    gaps = holes[holes < shapely.area(cells).max()]  # the hole of a ring is no gap
    return float(abs(area - whole.area) + gaps.sum()) / area


@pytest.mark.parametrize("name", CASES)
def test_the_cells_drawn_cover_the_bodies_once(name: str, tmp_path: Path) -> None:
    """At the start, as a frame in double precision has them: 1e-10 is the rounding of 1e3 areas."""
    case = load_case(name, (*CASES[name], 'output.fields.precision="float64"'))
    prepared = prepare(case)
    clipped, labels = ClippedBodies.of(prepared), cell_labels(prepared.bodies)
    frame = next(frames_of(prepared, np.array([0, 1]), 1, None, Stopping()))
    (tmp_path / "a.vtu").write_bytes(b"".join(BodiesFile(prepared).vtu(frame)))
    written = pyvista.read(tmp_path / "a.vtu")
    cells = polygons_of(clipped, np.asarray(written.points)[:, :2])
    for number, body in enumerate(prepared.bodies):
        own = labels.body == number
        assert shapely.area(cells[own]).sum() == pytest.approx(body.mesh.area.sum(), rel=1e-10)
        if body.name != "ring":  # chords stand for its circles
            assert shapely.area(cells[own]).sum() == pytest.approx(areas(body)["cad"], rel=1e-10)
        for side in np.unique(labels.side[own]):
            assert loose(cells[own & (labels.side == side)]) < 1e-10


def test_no_cracks_between_connected_cells_after_a_long_drag() -> None:
    """wavy_block at its end, coarsely: the halves are bent and have slid apart by half their length."""
    prepared = prepare(load_case("wavy_block", (*CASES["wavy_block"], "time.step='auto'")))
    *_, last = frames_of(prepared, np.array([0, steps_of(prepared)]), 1, None, Stopping())
    clipped, labels = ClippedBodies.of(prepared), cell_labels(prepared.bodies)
    cells = polygons_of(clipped, clipped.interpolate(prepared.model.x + last.u))
    assert np.unique(labels.side).tolist() == [0, 1]
    for side in (0, 1):
        assert loose(cells[labels.side == side]) < 1e-10
    assert np.abs(last.u[:, 0]).max() > 0.99
