"""Results in ParaView itself, where pvbatch is installed; and the script that shows them, where it is not."""

from __future__ import annotations

import ast
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from phantomnode.pipeline import cli, paraview
from phantomnode.pipeline.case import bundled_cases, load_case
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.paraview import SCRIPT, open_paraview, view_of, write_script
from phantomnode.pipeline.results import Results, open_results
from phantomnode.pipeline.run import run
from phantomnode.pipeline.vtkhdf import write_vtkhdf
from phantomnode.pipeline.vtu_reader import read_pvd

LOOK = Path(__file__).with_name("look_in_paraview.py")
SHORT = {
    "ring_impact": ("time.end=8e-4",),
    "ring_impact/polar": ("time.end=8e-4",),
    "wavy_block": ("body.block.grid.counts=[40, 20]", "time.step='auto'", "time.end=0.01"),
    "split_block_wave": (),
}
"""So much of the bundled cases that there is something to see; of those not named here the first 200 steps."""

needs_pvbatch = pytest.mark.skipif(
    shutil.which("pvbatch") is None, reason="ParaView's pvbatch is not installed (apt-get install paraview)"
)


@pytest.fixture(scope="module")
def short_runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Results]:
    """Every bundled case, shortened."""
    folder = tmp_path_factory.mktemp("runs")
    return {name: short_run(name, folder / name.replace("/", "_")) for name in bundled_cases()}


def short_run(name: str, out: Path) -> Results:
    few = ("output.fields.count=4", "output.history.count=20")
    case = load_case(name, (*SHORT.get(name, ()), *few))
    if name not in SHORT:
        from phantomnode.pipeline.prepare import prepare

        table = [f"time.end={min(case.time.end, 200 * prepare(case).dt)!r}", "output.profile={}"]
        case = load_case(name, (*few, *table))
    run(case, out)
    return open_results(out)


def pvbatch(*arguments: str | Path, timeout: float = 300.0) -> str:
    """Run pvbatch, with a virtual screen where there is none."""
    # ParaView opens the screen several times; one that starts anew when nobody looks is not there for a moment.
    server = ["xvfb-run", "-a", "--server-args=-screen 0 1600x1200x24 -noreset"]
    command = [*([] if os.environ.get("DISPLAY") else server), "pvbatch", *map(str, arguments)]
    # ParaView has a Python of its own: ours must not shine through.
    clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, env=clean)
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr[-3000:]
    return done.stdout


@pytest.mark.paraview
@needs_pvbatch
def test_paraview_shows_every_bundled_case_as_its_files_have_it(short_runs, tmp_path: Path) -> None:
    """Times, cells, ranges, components and warping, as ParaView sees them, against our own reader."""
    answer = tmp_path / "seen.json"
    pvbatch(LOOK, answer, *(results.path for results in short_runs.values()))
    seen = json.loads(answer.read_text())
    for results in short_runs.values():
        fields, contact = seen[str(results.path)]["fields"], seen[str(results.path)].get("contact")
        np.testing.assert_array_equal(fields["times"], results.times)
        for look, time in zip(fields["frames"], (results.times[0], results.times[-1]), strict=True):
            frame = results.frame(float(time))
            assert look["cells"] == len(frame.quads) + len(frame.triangles)
            for name in ("von_mises", "J", "body", "side", "fraction"):
                assert look["ranges"][name] == pytest.approx(span(frame.cell(name)), rel=1e-6)
            assert look["ranges"]["stress XX"] == pytest.approx(span(frame.cell("stress")[:, 0]), rel=1e-6)
            back = frame.reference  # what a warp by -1 times the displacement leads to
            box = [*back.min(axis=0), *back.max(axis=0)]
            assert look["warped back"] == pytest.approx(box, rel=1e-5, abs=1e-6 * np.ptp(back))
        assert fields["components"] == ["XX", "YY", "ZZ", "XY", "YZ", "XZ"]
        assert (contact is not None) == bool(results.pairs)
        if contact is not None:
            lines = results.contact("end")
            np.testing.assert_array_equal(contact["times"], results.times)
            assert contact["cells"] == len(lines.ends)
            assert contact["pressure"] == pytest.approx(span(lines.cell_data["pressure"]), rel=1e-6)


@pytest.mark.paraview
@needs_pvbatch
@pytest.mark.parametrize("name", bundled_cases())
def test_the_script_draws_a_picture(short_runs, tmp_path: Path, name: str) -> None:
    """The end of every bundled case, after its folder was moved: there are stress and outlines to be seen."""
    results = short_runs[name]
    script = write_script(results)
    moved = tmp_path / "moved"
    shutil.copytree(script.parent, moved)
    pvbatch(moved / SCRIPT, tmp_path / "picture.png", repr(float(results.times[-1])))
    from matplotlib.image import imread

    picture = imread(tmp_path / "picture.png")[..., :3]
    assert picture.shape == (1000, 1600, 3)
    flat = picture.reshape(-1, 3)
    white, black = (flat > 0.99).all(axis=1).mean(), (flat < 0.01).all(axis=1).mean()
    assert 0.4 < white < 0.95 and black > 1e-4
    assert len(np.unique(np.round(flat * 16), axis=0)) > 60  # a colour map


@pytest.fixture(scope="module")
def ring(tmp_path_factory: pytest.TempPathFactory) -> Results:
    return short_run("ring_impact", tmp_path_factory.mktemp("one") / "ring")


def test_one_file_holds_all_frames_as_vtk_reads_them(ring: Results) -> None:
    """VTKHDF against the series of .vtu files that it was made of."""
    vtk = pytest.importorskip("vtk")
    pyvista = pytest.importorskip("pyvista")
    for path in write_vtkhdf(ring):
        reader = vtk.vtkHDFReader()
        reader.SetFileName(str(path))
        reader.UpdateInformation()
        series = read_pvd(path.with_suffix(".pvd"))
        assert reader.GetHasTemporalData() and reader.GetNumberOfSteps() == len(series) == 5
        for number, (time, file) in enumerate(series):
            reader.SetStep(number)
            reader.Update()
            assert reader.GetTimeValue() == time
            one, other = pyvista.wrap(reader.GetOutput()), pyvista.read(file)
            np.testing.assert_array_equal(one.points, other.points)
            np.testing.assert_array_equal(one.cells, other.cells)
            np.testing.assert_array_equal(one.celltypes, other.celltypes)
            for mine, theirs in ((one.cell_data, other.cell_data), (one.point_data, other.point_data)):
                assert set(mine.keys()) == set(theirs.keys())
                for name in mine:
                    np.testing.assert_array_equal(mine[name], theirs[name])


def test_without_h5py_there_is_advice(ring: Results, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(CaseError, match=r"phantomnode\[vtkhdf\]"):
        write_vtkhdf(ring)


def test_the_script_holds_the_ranges_of_the_run(ring: Results, monkeypatch) -> None:
    results = ring
    assert cli.app(["paraview", str(results.path)], result_action="return_value") == 0
    tree = ast.parse((results.path / SCRIPT).read_text(encoding="utf-8"))
    held = {
        node.targets[0].id: ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant | ast.Tuple)
        and isinstance(node.targets[0], ast.Name)
    }  # fmt: skip
    view = view_of(results)
    assert held["STRESS"] == view.stress > 1e8  # Pa: the speed of 50 m/s gives rho c v = 4.5e8
    assert (
        held["PRESSURE"]
        == view.pressure
        == max(float(results.contact(float(time)).cell_data["pressure"].max()) for time in results.times)
    )
    assert (
        held["LOW"][0] <= 0.0 and held["HIGH"][0] >= 1.0 and held["HIGH"][1] == pytest.approx(1.32, abs=0.05)
    )
    assert Path(held["FOLDER"]) == results.path.resolve() and held["CONTACT"] is True
    monkeypatch.setattr(paraview, "LOOKED_AT", 1)
    assert view_of(results).pressure == view.pressure  # also where few frames are looked at for the stress


def test_where_paraview_is_missing_or_has_no_screen_it_says_so(tmp_path: Path, monkeypatch) -> None:
    script = tmp_path / SCRIPT
    monkeypatch.setattr("shutil.which", lambda name: None)
    with pytest.raises(CaseError, match=f"no program paraview.*--script={script}"):
        open_paraview(script)
    if sys.platform == "linux":
        monkeypatch.setattr("shutil.which", lambda name: "/usr/bin/paraview")
        monkeypatch.delenv("DISPLAY", raising=False)
        monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
        with pytest.raises(CaseError, match="no screen.*pvbatch"):
            open_paraview(script)


def span(values: np.ndarray) -> list[float]:
    return [float(np.min(values)), float(np.max(values))]
