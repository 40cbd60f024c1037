"""The same case gives the same files to the bit: at any number of threads, and however its mesh file is numbered."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.numbering import renumbered
from phantomnode.geometry.readers import read_geometry

SEED = 20
"""Of the crooked grid and of the shuffled numbers."""

CASE = """
time = {{ end = 1.5e-4 }}
[material.soft]
E = 1e9
nu = 0.3
rho = 1000.0
[body.disc]
geometry = {{ circle = {{ centre = [0.0, 0.50001], radius = 0.5 }} }}
grid = {{ file = "{grid}", unit = "m" }}
material = "soft"
initial_velocity = [5.0, -10.0]
[body.floor]
geometry = {{ rectangle = {{ low = [-0.613, -0.217], high = [0.613, 0.0] }} }}
grid = {{ kind = "cartesian", cell = 0.05 }}
material = "soft"
[interface.crack]
body = "disc"
geometry = {{ file = "crack.msh", unit = "m" }}
[contact.impact]
slave = "disc.outer"
master = "floor.outer"
friction = 0.3
[contact.crack]
slave = "crack.plus"
master = "crack.minus"
friction = 0.2
[output]
fields = {{ count = 2 }}
history = {{ count = 20 }}
"""

RUNS = """
import sys
from phantomnode.pipeline.case import load_case
from phantomnode.pipeline.run import run
from phantomnode.solver import explicit, layout
prepare_layout, layout.STRIP_ELEMENTS = explicit.prepare_layout, int(sys.argv[1])
def told(model, threads):
    made = prepare_layout(model, threads)
    print(made.threads)
    return made
explicit.prepare_layout = told
for line in sys.argv[2:]:
    case, folder, threads, *overrides = line.split("|")
    run(load_case(case, tuple(overrides)), folder, threads=int(threads))
"""
"""Runs cases with strips of at least so many elements and says how many threads took part in their steps."""

RUBBING = ("contact.impact.fy", "contact.impact.tx", "contact.crack.tx", "friction")
"""Columns of the history that are not zero where there are contact and friction."""


def crooked(cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and cells of a grid over the disc, turned by 0.3 rad and with its nodes up to 0.2 of a cell away."""
    line = np.linspace(-0.53, 0.53, cells + 1)
    x, y = np.meshgrid(line, line)
    away = np.random.default_rng(SEED).uniform(-0.2, 0.2, (2, *x.shape)) * (line[1] - line[0])
    x, y = x + away[0], y + away[1]
    xy = np.column_stack(
        [(np.cos(0.3) * x - np.sin(0.3) * y).ravel(), (np.sin(0.3) * x + np.cos(0.3) * y).ravel() + 0.5]
    )
    first = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    return xy, np.column_stack([first, first + 1, first + cells + 2, first + cells + 1])


def shuffled(xy: np.ndarray, elements: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same mesh under other numbers: of nodes, of elements and, for cells, of the corner that they begin with."""
    random = np.random.default_rng(SEED)
    order = random.permutation(len(xy))
    elements = np.argsort(order)[elements][random.permutation(len(elements))]
    if elements.shape[1] == 4:
        turn = random.integers(0, 4, (len(elements), 1))
        elements = np.take_along_axis(elements, (turn + np.arange(4)) % 4, axis=1)
        backward = random.random(len(elements)) < 0.5
        elements[backward] = elements[backward][:, ::-1]
    return xy[order], elements


def write_mesh(path: Path, xy: np.ndarray, elements: np.ndarray) -> None:
    """A gmsh file (2.2) of lines or quadrilaterals."""
    kind = {2: 1, 4: 3}[elements.shape[1]]
    nodes = [f"{k} {float(x)!r} {float(y)!r} 0" for k, (x, y) in enumerate(xy, 1)]
    cells = [f"{k} {kind} 2 1 1 {' '.join(map(str, cell + 1))}" for k, cell in enumerate(elements, 1)]
    path.write_text(
        "\n".join(
            ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$Nodes", str(len(nodes)), *nodes, "$EndNodes", "$Elements",
             str(len(cells)), *cells, "$EndElements", ""]
        )
    )  # fmt: skip


def write_case(folder: Path, cells: int, change=lambda xy, elements: (xy, elements)) -> Path:
    """A disc with a crack that slides over a floor, on a mesh file."""
    folder.mkdir()
    x = np.linspace(0.31, -0.33, 12)  # from the right to the left: not the way of the coordinates
    line = np.column_stack([x, 0.1 + 0.1 * x**2])
    write_mesh(folder / "grid.msh", *change(*crooked(cells)))
    write_mesh(folder / "crack.msh", *change(line, np.column_stack([np.arange(11), np.arange(1, 12)])))
    case = folder / "case.toml"
    case.write_text(CASE.format(grid="grid.msh"))
    return case


def run_all(*orders: tuple[str | Path, Path, int, *tuple[str, ...]], strip: int) -> list[str]:
    """Run cases into folders by so many threads, with overrides; how many took part in each ("None" for one)."""
    lines = ["|".join(map(str, order)) for order in orders]
    environment = {**os.environ, "NUMBA_NUM_THREADS": "4"}
    done = subprocess.run(
        [sys.executable, "-c", RUNS, str(strip), *lines],
        env=environment, capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def digests(folder: Path) -> dict[str, str]:
    """sha256 of the history and of the last fields and contact lines of a run that ended as it should."""
    assert json.loads((folder / "summary.json").read_text())["status"] == "done"
    files = [folder / "history.csv"]
    files += [sorted(folder.glob(f"{kind}/*.vtu"))[-1] for kind in ("fields", "contact")]
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def forces(folder: Path, *names: str) -> np.ndarray:
    """The largest values of some columns of a history."""
    rows = np.genfromtxt(folder / "history.csv", delimiter=",", names=True, deletechars="")
    return np.array([np.abs(rows[name]).max() for name in names])


def test_files_are_the_same_at_any_number_of_threads(tmp_path: Path) -> None:
    case = write_case(tmp_path / "case", 70)
    folders = [tmp_path / str(threads) for threads in (1, 2, 4)]
    took_part = run_all(*((case, folder, int(folder.name)) for folder in folders), strip=100)
    assert took_part == ["None", "2", "4"]
    assert np.all(forces(folders[0], *RUBBING) > 0.0)
    one, two, four = map(digests, folders)
    assert one == two == four


def test_the_ring_impact_is_the_same_at_any_number_of_threads(tmp_path: Path) -> None:
    coarse = (
        "body.ring.grid.cell=0.025", "body.obstacle.grid.cell=0.05", "time.end=0.003", "output.fields.count=2",
        "output.history.count=50",
    )  # fmt: skip
    folders = [tmp_path / str(threads) for threads in (1, 2, 4)]
    orders = [("ring_impact", folder, int(folder.name), *coarse) for folder in folders]
    assert run_all(*orders, strip=40) == ["None", "2", "4"]
    assert forces(folders[0], "contact.ring_on_obstacle.fy") > 0.0
    one, two, four = map(digests, folders)
    assert one == two == four


def test_files_are_the_same_whatever_the_numbers_in_the_mesh_file(tmp_path: Path) -> None:
    """One thread on the mesh as it was written, four on the shuffled one."""
    plain, mixed = write_case(tmp_path / "case", 40), write_case(tmp_path / "mixed", 40, shuffled)
    assert (plain.parent / "grid.msh").read_bytes() != (mixed.parent / "grid.msh").read_bytes()
    took_part = run_all((plain, tmp_path / "1", 1), (mixed, tmp_path / "4", 4), strip=40)
    assert took_part == ["None", "4"]
    assert np.all(forces(tmp_path / "1", *RUBBING) > 0.0)
    assert digests(tmp_path / "1") == digests(tmp_path / "4")


def test_the_outline_of_a_mesh_is_the_same_whatever_its_numbers(tmp_path: Path) -> None:
    mesh = crooked(6)
    write_mesh(tmp_path / "plain.msh", *mesh)
    write_mesh(tmp_path / "mixed.msh", *shuffled(*mesh))
    (plain,), (mixed,) = (read_geometry(tmp_path / f"{name}.msh", "m").regions for name in ("plain", "mixed"))
    assert np.array_equal(plain.outer.points, mixed.outer.points) and len(plain.outer.points) == 25


def test_cells_between_straight_lines_stand_in_rows() -> None:
    """Each cell from its lower left corner on, although the lines are crooked by rounding."""
    line = np.arange(5.0) / 5.0
    x, y = np.meshgrid(line, line)
    y = y * (1.0 + np.random.default_rng(SEED).choice([-1e-16, 0.0, 2.3e-16], y.shape))
    first = (np.arange(4)[:, None] * 5 + np.arange(4)).ravel()
    quads = np.column_stack([first, first + 1, first + 6, first + 5])
    xy, numbered = renumbered(*shuffled(np.column_stack([x.ravel(), y.ravel()]), quads))
    assert np.array_equal(numbered, quads)
    assert np.array_equal(xy, np.column_stack([x.ravel(), y.ravel()]))


def test_a_mesh_with_two_nodes_at_one_place_is_refused() -> None:
    """Two cells side by side that are not joined: nothing but their numbers tells the nodes between them apart."""
    left = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    with pytest.raises(GeometryError, match=r"2 nodes lie where another one does, the first at \(1, 0\) m"):
        renumbered(np.vstack([left, left + (1.0, 0.0)]), np.arange(8).reshape(2, 4))
