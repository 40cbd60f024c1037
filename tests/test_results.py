"""Results as arrays, and the pictures, films and tables made from them."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections import defaultdict

import numpy as np
import pytest
import shapely
from small_run import TABLE, small_run

from phantomnode import open_results
from phantomnode.pipeline.cli import app
from phantomnode.pipeline.curve_pictures import (
    HISTORIES,
    bearing_times,
    draw_history,
    draw_pressure,
    energies,
    of_tip,
    unrolled,
)
from phantomnode.pipeline.drawing import readable
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.field_pictures import joint_limits, limits_of, map_of
from phantomnode.pipeline.film import write_film
from phantomnode.pipeline.frames import FieldsFrame
from phantomnode.pipeline.outlines import solid_sides
from phantomnode.pipeline.plot import parse_time, picture, plot_files
from phantomnode.pipeline.quantities import QUANTITIES, quantity
from phantomnode.pipeline.results import Surface
from phantomnode.pipeline.vtu_reader import read_pvd, read_vtu


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    return open_results(small_run(tmp_path_factory.mktemp("results") / "small"))


@pytest.fixture(scope="module")
def peak(results):
    return results.frame("peak")


def meshio_or_skip():
    return pytest.importorskip("meshio")


class TestFiles:
    def test_every_array_is_what_meshio_reads(self, results):
        meshio = meshio_or_skip()
        for series in ("fields", "contact"):
            _, file = read_pvd(results.path / f"{series}.pvd")[3]
            ours, theirs = read_vtu(file), meshio.read(file)
            np.testing.assert_array_equal(ours.points, theirs.points)
            for name, values in theirs.point_data.items():
                np.testing.assert_array_equal(ours.point_data[name], values)
            for name, blocks in theirs.cell_data.items():
                np.testing.assert_array_equal(ours.cell_data[name], np.concatenate(blocks))
            assert set(ours.cell_data) == set(theirs.cell_data)
            for block in theirs.cells:
                kind = {"quad": 9, "triangle": 5, "line": 3}[block.type]
                np.testing.assert_array_equal(ours.cells(kind), block.data)

    def test_a_frame_that_is_cut_short_is_named(self, results, tmp_path):
        _, file = read_pvd(results.path / "fields.pvd")[0]
        short = tmp_path / "short.vtu"
        short.write_bytes(file.read_bytes()[:-400])
        with pytest.raises(CaseError, match=r"short\.vtu: cannot be read as a frame"):
            read_vtu(short)

    def test_a_compressor_that_is_not_known_is_named(self, results, tmp_path):
        _, file = read_pvd(results.path / "fields.pvd")[0]
        other = tmp_path / "other.vtu"
        other.write_bytes(file.read_bytes().replace(b"vtkZLibDataCompressor", b"vtkLZMADataCompressor"))
        with pytest.raises(CaseError, match="packed by vtkLZMADataCompressor"):
            read_vtu(other)

    def test_pyvista_gets_the_same_frame(self, results, peak):
        pytest.importorskip("pyvista")
        data = results.dataset("peak")
        assert data.n_cells == len(peak.cell("body"))
        np.testing.assert_array_equal(data.cell_data["von_mises"], peak.cell("von_mises"))


class TestArrays:
    def test_the_history_holds_the_columns_and_the_balance(self, results):
        assert results.history.time[-1] == pytest.approx(1.2e-3, rel=1e-3)
        kept = energies(results.history)["sum less external work"]
        assert np.ptp(kept) < 1e-3 * kept[0]
        with pytest.raises(KeyError, match="did you mean 'kinetic'"):
            results.history["kinetik"]

    def test_times_are_found_by_number_and_by_name(self, results):
        assert len(results.times) == 7
        assert (results.nearest("start"), results.nearest("end"), results.nearest(0.39e-3)) == (0, 6, 2)
        internal = np.interp(results.times, results.history.time, results.history["internal"])
        assert internal[results.nearest("peak")] == internal.max()
        with pytest.raises(CaseError, match="start, peak, end"):
            results.nearest("middle")
        with pytest.raises(CaseError, match="frames go from 0 to 0.0012 s; 10 s, in seconds, is beyond"):
            results.frame(10)

    def test_reference_positions_are_those_of_the_first_frame(self, results, peak):
        # Files hold float32: the sum of the roundings of positions and displacements of 0.03 m.
        np.testing.assert_allclose(peak.reference, results.frame("start").points, atol=1e-8)

    def test_every_field_has_one_value_a_cell(self, peak):
        for name in QUANTITIES:
            assert peak.values(name).shape == peak.cell("body").shape, name

    def test_fields_agree_with_each_other(self, peak):
        first, second = peak.values("principal_max"), peak.values("principal_min")
        np.testing.assert_allclose(
            first + second, peak.values("stress_xx") + peak.values("stress_yy"), atol=1.0
        )
        zz = peak.values("stress_zz")
        mises = np.sqrt(0.5 * ((first - second) ** 2 + (second - zz) ** 2 + (zz - first) ** 2))
        np.testing.assert_allclose(mises, peak.values("von_mises"), rtol=1e-4, atol=1.0)  # float32 stresses

    def test_pressure_along_the_surface_has_the_force_of_the_history(self, results):
        arc, pressure = results.pressure("landing", "peak", filtered=False)
        along = results.surface("landing")
        assert along.closed and np.all(np.diff(arc) > 0.0)
        assert along.length == pytest.approx(2.0 * np.pi * 0.02, rel=5e-3)  # a polygon in the circle
        contact = results.contact("peak")
        ends = contact.ends[along.order]
        length = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
        normal = contact.of_pair(0, "normal")[along.order, 1]
        row = int(np.argmin(np.abs(results.history.time - contact.time)))
        assert np.sum(pressure * length * normal) == pytest.approx(
            results.history["contact.landing.fy"][row], rel=1e-4
        )

    def test_what_is_missing_is_named(self, results, tmp_path, monkeypatch):
        with pytest.raises(CaseError, match="no contact pair 'lading'; there are: landing"):
            results.surface("lading")
        with pytest.raises(CaseError, match=r"no field \(did you mean 'von_mises'\?\)"):
            quantity("von_misses")
        with pytest.raises(CaseError, match="holds no results of a run"):
            open_results(tmp_path)
        monkeypatch.chdir(tmp_path)
        for name in ("mine", "mine-2", "minerals"):
            (tmp_path / "results" / name).mkdir(parents=True)
            (tmp_path / "results" / name / "history.csv").write_text("time\n")
            os.utime(tmp_path / "results" / name / "history.csv", (len(name), len(name)))
        with pytest.raises(CaseError, match=r"results.mine, results.mine-2, results.minerals$"):
            open_results("results")
        with pytest.raises(CaseError, match=r"did you mean results.mine-2\?"):
            open_results(tmp_path / "mine")
        (tmp_path / "results.csv").write_text("case\n")
        with pytest.raises(CaseError, match="holds a batch; open one of its cases"):
            open_results(tmp_path)

    def test_a_notebook_shows_title_checks_and_picture(self, results):
        page = results._repr_html_()
        assert "A &lt;small&gt; disc &amp; a floor" in page
        assert "energy error" in page and "data:image/png;base64," in page
        assert "small" in repr(results)
        assert results.plot("energies")._repr_png_().startswith(b"\x89PNG")


@pytest.fixture(scope="module")
def onto_a_plane(tmp_path_factory):
    """The disc falls on a rigid plane that is far longer than it."""
    table = {key: value for key, value in TABLE.items() if key != "boundary"}
    table["body"] = {"disc": TABLE["body"]["disc"]}
    table["rigid"] = {
        "plane": {"geometry": {"polyline": {"points": [[-5.0, 0.0], [5.0, 0.0]]}}, "side": "right"}
    }
    table["contact"] = {"landing": {"slave": "disc.outer", "master": "plane"}}
    return open_results(small_run(tmp_path_factory.mktemp("rigid") / "plane", table))


class TestObstacles:
    def test_they_are_in_the_frames_and_in_no_pair(self, onto_a_plane):
        frame = onto_a_plane.frame("peak")
        places = frame.obstacles.reshape(-1, 2)
        np.testing.assert_allclose([places.min(axis=0), places.max(axis=0)], [[-5.0, 0.0], [5.0, 0.0]])
        assert len(onto_a_plane.frame("peak").values("J")) == len(frame.cell("body"))
        assert onto_a_plane.surface("landing").length == pytest.approx(2.0 * np.pi * 0.02, rel=5e-3)

    def test_a_picture_shows_them_and_still_the_bodies(self, onto_a_plane):
        axes = onto_a_plane.plot("von_mises").axes[0]
        (low, high), (bottom, _) = axes.get_xlim(), axes.get_ylim()
        assert -0.05 < low < -0.02 and 0.02 < high < 0.05 and bottom < 0.0
        assert any(np.ptp(line[:, 0]) > 9.0 for c in axes.collections for line in segments_of(c))


def segments_of(collection):
    return collection.get_segments() if hasattr(collection, "get_segments") else []


class TestPictures:
    def test_readable_units(self):
        assert readable(np.array([2.5e8, np.nan]), "Pa") == (1e-6, "MPa")
        assert readable(4.5e-3, "s") == (1e3, "ms")
        assert readable(50.0, "m/s") == (1.0, "m/s")
        assert readable(0.0, "Pa") == (1.0, "Pa")

    def test_colours_are_about_zero_for_signed_and_about_one_for_ratios(self):
        values = np.array([-2.0, 1.0, 1.5])
        low, high = limits_of(values, QUANTITIES["stress_xx"])
        assert low == -high and high == pytest.approx(2.0, rel=1e-2)
        low, high = limits_of(np.array([0.98, 1.01]), QUANTITIES["J"])
        assert low + high == pytest.approx(2.0)
        assert limits_of(np.abs(values), QUANTITIES["von_mises"]).low == 0.0

    def test_a_signed_field_on_one_side_of_zero_takes_all_colours(self):
        what = QUANTITIES["displacement_y"]
        sunk = limits_of(np.linspace(-2.0, 0.0, 5001), what)
        assert sunk == pytest.approx((-2.0, 0.0), abs=0.01) and map_of(sunk, what) == "turbo"
        assert joint_limits([sunk, limits_of(np.zeros(3), what)], what) == sunk  # at the start of a film
        about_zero = joint_limits([sunk, (0.0, 1.0)], what)
        assert about_zero.low == -about_zero.high and map_of(about_zero, what) == "RdBu_r"
        assert map_of((0.9, 1.1), QUANTITIES["J"]) == "RdBu_r"

    def test_a_field_is_drawn_on_equal_axes_with_unit_and_time(self, results):
        figure = results.plot("von_mises", "peak")
        axes, bar = figure.axes
        assert axes.get_aspect() == 1.0
        assert bar.get_ylabel().startswith("von Mises stress, ") and bar.get_ylabel().endswith("Pa")
        assert "t = " in axes.get_title()

    def test_a_field_that_is_zero_has_a_colour_bar_from_zero_to_one(self, results):
        bar = results.plot("von_mises", "start").axes[1]
        assert bar.get_ylim() == (0.0, 1.0) and bar.get_ylabel() == "von Mises stress, Pa"

    def test_pressure_is_drawn_around_the_contact_not_at_the_seam(self, results):
        axes = draw_pressure(results, "landing", ["peak"]).axes[0]
        low, high = axes.get_xlim()
        x, y = axes.lines[0].get_xdata(), axes.lines[0].get_ydata()
        on = x[y > 0.0]
        assert low < on.min() and on.max() < high
        assert np.ptp(on) < 0.5 * np.nanmax(x)

    @pytest.mark.parametrize("what", HISTORIES)
    def test_histories_have_a_unit_and_finite_curves(self, results, what):
        for axes in draw_history(results, what).axes:
            assert axes.get_ylabel()
            assert all(np.all(np.isfinite(line.get_ydata())) for line in axes.lines) and axes.lines

    def test_a_column_of_the_history_is_a_picture(self, results):
        figure = picture(results, "contact.landing.iy")
        assert figure.axes[0].get_ylabel() == "contact.landing.iy, N s/m"

    def test_level_sets_show_the_relocated_nodes_and_where_they_were(self, results):
        figure = picture(results, "level_set")
        body = results.prepared.bodies[0]
        dots = [line for line in figure.axes[0].lines if line.get_label() == "relocated nodes"]
        assert len(dots[0].get_xdata()) == body.relocated > 0

    def test_nodes_show_every_real_and_phantom_node(self, results):
        marks = {line.get_label(): len(line.get_xdata()) for line in picture(results, "nodes").axes[0].lines}
        counts = results.summary["counts"]
        phantom = counts["phantom_nodes"]
        assert marks[f"phantom nodes ({phantom})"] == phantom > 0
        real = counts["nodes"] - phantom
        assert marks[f"real nodes ({real})"] == real

    def test_files_are_named_after_what_they_show_and_the_same_each_time(self, results, tmp_path):
        (first, said), (other, _) = plot_files(results, ["J"], [0.39e-3, "end"], tmp_path)
        assert re.fullmatch(r"plot\.J\.40\d[.\d]*us\.png", first.name) and other.name == "plot.J.1.2ms.png"
        assert "390 µs: no frame; drawn is the nearest, 40" in said
        for name in ("a.svg", "b.svg"):
            plot_files(results, ["energies"], ["end"], tmp_path / name)
        assert b"<svg" in (tmp_path / "a.svg").read_bytes()
        assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()

    @pytest.mark.parametrize("first", [0, 3, 7])
    def test_arc_length_counts_from_the_lowest_place_wherever_a_surface_is_cut(self, first):
        """A square of eight segments, counter-clockwise; only the middles of the lower side and of the left bear."""
        corners = np.array([[0, 0], [1, 0], [2, 0], [2, 1], [2, 2], [1, 2], [0, 2], [0, 1]], dtype=float)
        ends = np.roll(np.stack([corners, np.roll(corners, -1, axis=0)], axis=1), -first, axis=0)
        arc, zero = np.arange(8) + 0.5, np.zeros(8, dtype=int)
        along = Surface(np.arange(8), arc, zero, True, ends, ends[0, 0], 8.0)
        middle = ends.mean(axis=1)
        touched = (middle[:, 1] == 0.0) | ((middle[:, 0] == 0.0) & (middle[:, 1] < 1.0))
        cut, order = unrolled(along, touched)
        assert cut.start.tolist() == [0.0, 0.0]
        assert np.all(np.diff(cut.arc) > 0.0)
        place = dict(zip(map(tuple, middle[order]), cut.arc, strict=True))
        assert place[0.5, 0.0] == pytest.approx(0.5) and place[1.5, 0.0] == pytest.approx(1.5)
        assert place[0.0, 0.5] == pytest.approx(-0.5)  # on the other side of the lowest place

    def test_obstacles_show_where_they_are_solid(self):
        """Closed: the inside; open, or solid outside: strips on the left."""
        square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float)
        ends = np.stack([square, np.roll(square, -1, axis=0)], axis=1)
        (inside,) = solid_sides(ends, 0.1)
        assert abs(shapely.Polygon(inside).area) == pytest.approx(1.0)
        strips = [shapely.Polygon(side) for side in solid_sides(ends[::-1, ::-1], 0.1)]
        assert len(strips) == 4 and not any(strip.intersects(shapely.Point(0.5, 0.5)) for strip in strips)
        (floor,) = solid_sides(np.array([[[2.0, 0.0], [-2.0, 0.0]]]), 0.1)
        assert shapely.Polygon(floor).bounds == pytest.approx((-2.0, -0.1, 2.0, 0.0))

    def test_without_a_time_fields_are_at_the_peak_and_pressure_while_it_bears(self, results, tmp_path):
        (_, field), (_, pressure) = plot_files(results, ["J", "contact_pressure"], [], tmp_path)
        assert "the frame of the largest internal energy" in field and pressure == ""
        times = bearing_times(results, "landing")
        assert len(times) > 1 and all(
            results.contact(time).of_pair(0, "pressure").max() > 0.0 for time in times
        )

    def test_pictures_do_not_take_each_others_names(self, results, tmp_path):
        options = {"times": ["peak"], "out": tmp_path}
        files = [file.name for file, _ in plot_files(results, ["contact_pressure", "impulses"], **options)]
        files += [file.name for file, _ in plot_files(results, ["contact_pressure"], ["end"], tmp_path)]
        files += [
            file.name for file, _ in plot_files(results, ["contact_pressure"], [], tmp_path, pair="landing")
        ]
        assert len({*files}) == 4 and "plot.contact_pressure.landing.png" in files
        assert {file.name for file in tmp_path.iterdir()} == {*files}

    def test_nothing_is_drawn_where_one_name_is_wrong(self, results, tmp_path):
        with pytest.raises(CaseError, match="--what impuls: is no picture .did you mean 'impulses'"):
            plot_files(results, ["J", "impuls"], [], tmp_path)
        assert not any(tmp_path.iterdir())

    def test_smoothing_keeps_what_is_even_and_mixes_only_neighbours(self, results, peak):
        """The second way: a loop over the cells about each corner."""
        cells = [*peak.quads, *peak.triangles]
        np.testing.assert_allclose(peak.smoothed(np.full(len(cells), 3.0)), 3.0, rtol=1e-14)
        area = [shapely.Polygon(peak.points[cell]).area for cell in cells]
        values, about = peak.values("von_mises"), defaultdict(list)
        for number, cell in enumerate(cells):
            for corner in cell:
                about[corner].append(number)
        for number in (0, len(peak.quads) - 1, len(cells) - 1):
            means = [np.average(values[about[c]], weights=np.take(area, about[c])) for c in cells[number]]
            assert peak.smoothed(values)[number] == pytest.approx(np.mean(means), rel=1e-9)
        bars = [axes.get_ylabel() for axes in picture(results, "von_mises", smooth=True).axes]
        assert any("smoothed" in label for label in bars)

    def test_what_a_tip_bears_is_said_to_depend_on_the_cells(self):
        assert "depends on the cells" in of_tip([np.zeros(9), np.eye(9)[4]])
        assert of_tip([np.zeros(9)]) == "" == of_tip([np.eye(9)[4], np.ones(9)])

    def test_times_as_people_write_them(self):
        assert parse_time("4.5 ms") == pytest.approx(4.5e-3)
        assert parse_time("0.25") == 0.25 and parse_time("3us") == pytest.approx(3e-6)
        assert parse_time("peak") == "peak"
        with pytest.raises(CaseError, match="--time soon: write seconds"):
            parse_time("soon")

    def test_what_cannot_be_drawn_is_said_in_one_line(self, results, capsys):
        def line(*options):
            assert app(["plot", str(results.path), *options], result_action="return_value") == 2
            return capsys.readouterr().err

        assert "did you mean 'von_mises'?" in line("--what", "von_misses")
        assert "pictures end in .png, .svg, .pdf" in line("--out", "picture.bmp")
        assert "--zoom 0 0 1 0: write x0 y0 x1 y1" in line("--zoom", "0", "0", "1", "0")
        assert "--range 5 1: the first value must be below" in line("--range", "5", "1")
        assert "--time nan: write seconds" in line("--time", "nan")
        assert "--time 5: frames go from 0 to 0.0012" in line("--time", "5")
        assert "no contact pair 'x'" in line("--what", "contact_pressure", "--pair", "x")

    def test_the_command_line_says_where_pictures_are(self, results, tmp_path, capsys):
        target = tmp_path / "new" / "mises.png"
        assert app(["plot", str(results.path), "--out", str(target)], result_action="return_value") == 0
        assert f"picture   {target}" in capsys.readouterr().out
        assert target.read_bytes().startswith(b"\x89PNG")


class TestFilms:
    def test_a_gif_has_all_frames_of_the_size_asked_for(self, results, tmp_path):
        from PIL import Image

        film = write_film(results, "velocity", tmp_path / "v.gif", fps=10, width=300)
        with Image.open(film) as image:
            assert image.n_frames == len(results.times)
            assert abs(image.size[0] - 300) <= 2
            assert image.info["duration"] == 100
        assert [file.name for file in tmp_path.iterdir()] == ["v.gif"]

    def test_an_mp4_without_ffmpeg_says_what_to_install(self, results, tmp_path, monkeypatch):
        monkeypatch.setattr(shutil, "which", lambda name: None)
        monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
        with pytest.raises(CaseError, match=r'pip install "phantomnode\[film\]"'):
            write_film(results, out=tmp_path / "v.mp4")

    def test_an_mp4_is_written_where_ffmpeg_is(self, results, tmp_path):
        if not shutil.which("ffmpeg"):
            pytest.importorskip("imageio_ffmpeg", reason="there is no ffmpeg")
        film = write_film(results, out=tmp_path / "v.mp4", width=301)
        assert film.read_bytes()[4:8] == b"ftyp"

    @pytest.mark.parametrize(("option", "value"), [("fps", 0), ("width", 10)])
    def test_numbers_that_cannot_be_are_refused(self, results, option, value):
        with pytest.raises(CaseError, match=f"--{option} {value}: must lie between"):
            write_film(results, **{option: value})


def test_results_are_read_without_the_solver(results):
    """Reading and plotting results loads neither numba nor gmsh: a picture comes in a second."""
    code = (
        "import sys, phantomnode; r = phantomnode.open_results(sys.argv[1]); r.frame('end').values('von_mises'); "
        "r.plot('energies'); print([m for m in ('numba', 'gmsh', 'pyvista', 'vtkmodules') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(results.path)],
        capture_output=True,
        text=True,
        env=os.environ,
        check=True,
    )
    assert done.stdout.strip() == "[]"


def test_a_run_that_has_not_ended_can_be_looked_at(results, tmp_path):
    folder = tmp_path / "underway"
    shutil.copytree(results.path, folder)
    (folder / "summary.json").unlink()
    underway = open_results(folder)
    assert "not ended" in repr(underway)
    assert isinstance(underway.frame("end"), FieldsFrame)
    assert json.dumps(underway.summary) == "{}"
