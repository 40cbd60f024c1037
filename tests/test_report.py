"""Report pages: what they say, what they hold, and that they work in a real browser without a network."""

from __future__ import annotations

import base64
import csv
import gzip
import io
import json
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
from small_run import TABLE, small_run

from phantomnode import open_results
from phantomnode.pipeline.cases_page import asked_of, compared_cases, table_of
from phantomnode.pipeline.cli import app
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.packing import packed, quantised
from phantomnode.pipeline.page_charts import overlay
from phantomnode.pipeline.report import write_report
from phantomnode.pipeline.run_page import _missed
from phantomnode.pipeline.trust import findings, trusted
from phantomnode.pipeline.view_data import BUDGET, _solid, chosen, view_data

LIMIT = 8_000_000
"""Bytes of a page, at most."""
WIDE, PHONE = {"width": 1280, "height": 900}, {"width": 390, "height": 844}


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    return small_run(tmp_path_factory.mktemp("report") / "small")


@pytest.fixture(scope="module")
def run_report(run_folder):
    (page,) = write_report([run_folder], run_folder)
    return page


@pytest.fixture(scope="module")
def batch(run_folder, tmp_path_factory):
    """A folder as a batch of four cases leaves it: one that failed, one that kept not all of its checks."""
    folder = tmp_path_factory.mktemp("batch") / "study"
    rows = []
    for number, (speed, cell) in enumerate([(5, 0.003), (10, 0.003), (5, 0.002), (10, 0.002)]):
        name = f"speed={speed}_cell={cell}"
        shutil.copytree(
            run_folder, folder / name, ignore=shutil.ignore_patterns("fields", "contact", "checkpoint")
        )
        row = {"case": name, "folder": name, "status": "done", "reason": "", "hash": str(number)}
        row |= {
            "speed": speed,
            "cell": cell,
            "peak_contact_force.landing": 100.0 * speed + number,
            "steps": 90,
        }
        if number == 1:
            summary = json.loads((folder / name / "summary.json").read_text())
            summary["checks"][0]["passed"] = False
            (folder / name / "summary.json").write_text(json.dumps(summary))
        if number == 3:
            (folder / name / "summary.json").unlink()
            row |= {
                "status": "failed",
                "reason": "body <disc> lies outside",
                "peak_contact_force.landing": "",
                "steps": "",
            }
        rows.append(row)
    with (folder / "results.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(rows)
    return folder


def data_of(page):
    text = page.read_text(encoding="utf-8")
    found = re.search(r'<script id="data" type="application/json">(.*?)</script>', text, re.S)
    return json.loads(found[1])


def unpacked(array):
    """What the page's script does, in NumPy."""
    planes = np.frombuffer(gzip.decompress(base64.b64decode(array["data"])), np.uint8)
    dtype = np.dtype("<" + array["type"])
    return planes.reshape(dtype.itemsize, -1).T.copy().view(dtype).reshape(array["shape"])


class TestData:
    def test_arrays_come_back_as_they_were(self):
        for values in (np.arange(7, dtype=np.uint16), np.array([[1.5, np.nan], [-2e30, 0.0]], np.float32)):
            np.testing.assert_array_equal(unpacked(packed(values)), values)

    def test_quantised_values_are_right_to_half_a_step(self):
        values = np.linspace(-3.0, 5.0, 999)
        back = -3.0 + 8.0 * quantised(values, -3.0, 5.0) / 65535
        np.testing.assert_allclose(back, values, atol=0.5 * 8.0 / 65535 * (1 + 1e-9))
        assert np.all(quantised(np.full(3, 2.0), 2.0, 2.0) == 0)

    def test_the_view_holds_the_frames_of_the_files(self, run_folder):
        results = open_results(run_folder)
        view = view_data(results)
        assert view["times"] == results.times.tolist() and view["every"] == 1
        low, high = np.array(view["box"])
        frame, number = results.frame("peak"), view["start"]
        points = low + (high - low) * unpacked(view["points"])[number] / 65535
        np.testing.assert_allclose(points, frame.points, atol=np.max(high - low) / 65535)
        stress = view["fields"][0]
        least, most = stress["range"]
        shown = least + (most - least) * unpacked(stress["values"])[number] / 65535
        in_unit = frame.values("von_mises") * shown.max() / frame.values("von_mises").max()
        np.testing.assert_allclose(shown, in_unit, atol=(most - least) / 65535)

    def test_solid_sides_of_obstacles_are_triangles_that_know_their_segment(self):
        """A wedge beside an L, both closed, and an open floor; the floor's strip is as wide as asked for."""
        wedge = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 1.0]])
        corner = np.array([[3.0, 0.0], [5.0, 0.0], [5.0, 1.0], [4.0, 1.0], [4.0, 2.0], [3.0, 2.0]])
        closed = [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in (wedge, corner)]
        ends = np.concatenate([*closed, [[[6.0, -1.0], [0.0, -1.0]]]])
        solid = {name: unpacked(array) for name, array in _solid(ends, 0.1).items()}
        points = solid["points"][solid["triangles"].reshape(-1, 3)]
        a, b = np.moveaxis(points[:, 1:] - points[:, :1], 1, 0)
        area = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()
        assert area == pytest.approx(0.5 + 3.0 + 0.6, rel=1e-6)
        assert [*np.unique(solid["segments"])] == [0, 3, 9] and len(solid["segments"]) == 3 + 6 + 4
        assert _solid(np.zeros((0, 2, 2)), 0.1) is None

    def test_what_is_too_large_loses_fields_then_frames_then_the_view(self):
        small = chosen(60, 20_000, 10_000, 5_000)
        assert small.stride == 1 and len(small.fields) == 5
        fewer = chosen(60, 400_000, 90_000, 60_000)
        assert fewer.fields == ("von_mises",) or fewer.stride > 1
        assert 60 // fewer.stride >= 15
        huge = chosen(60, 2_000_000, 600_000, 400_000)
        assert huge.fields == ("von_mises",) and huge.stride > 10
        assert chosen(60, BUDGET, 10, 10) is None


class TestTrust:
    @pytest.fixture
    def figures(self, run_folder):
        return json.loads((run_folder / "summary.json").read_text())

    def test_a_sound_run_is_trusted_with_its_numbers(self, figures):
        found = findings(figures)
        assert trusted(found)
        subjects = [finding.subject for finding in found]
        assert subjects[0] == "End"
        assert {
            "Energy balance",
            "Momentum balance",
            "Hourglass energy",
            "Deformed elements",
            "Penetration",
        } <= {*subjects}
        assert {"Time step", "Mesh"} <= {*subjects}
        assert f"{figures['counts']['phantom_nodes']} of" in next(
            f.text for f in found if f.subject == "Mesh"
        )

    @pytest.mark.parametrize(
        ("change", "subject", "word"),
        [
            (
                {"status": "stopped", "reason": "an element inverted", "advice": "Crush less"},
                "End",
                "an element inverted",
            ),
            ({"stable_step_min": 1e-12}, "Time step", "not stable"),
            ({"warnings": ["body disc: coarse"]}, "Warning", "body disc: coarse"),
            ({"added_mass": {"disc": 0.9}}, "Mass scaling", "at most"),
        ],
    )
    def test_what_is_not_sound_is_said(self, figures, change, subject, word):
        figures |= change
        found = findings(figures)
        assert not trusted(found)
        assert any(f.subject == subject and word in f.text and not f.passed for f in found)

    def test_a_check_that_is_not_kept_says_what_to_do(self, figures):
        figures["checks"][0] |= {"passed": False, "value": 0.2}
        (bad,) = [f for f in findings(figures) if not f.passed]
        assert (
            bad.subject == "Energy balance"
            and "20 %" in bad.text
            and "To do: take a smaller step" in bad.text
        )


class TestPages:
    def test_a_run_page_is_one_small_file_that_names_no_other(self, run_report):
        text = run_report.read_text(encoding="utf-8")
        assert len(text.encode()) < LIMIT
        head = re.sub(r"<script.*?</script>", "", text, flags=re.S)
        assert not re.findall(r'(?:src|href)="(?!data:)', head)
        assert "A &lt;small&gt; disc &amp; a floor" in head and "<small>" not in head
        assert "Can be trusted" in head and "Where it comes from" in head

    def test_it_says_what_was_run(self, run_report):
        text = run_report.read_text(encoding="utf-8")
        assert "rubber: E = 50 MPa" in text and "disc.outer on floor.top, no friction, penalty auto" in text
        assert "displacement x = 0, y = 0 on floor.bottom" in text

    def test_a_run_that_has_not_ended_has_a_page(self, run_folder, tmp_path):
        folder = tmp_path / "underway"
        shutil.copytree(run_folder, folder)
        (folder / "summary.json").unlink()
        (page,) = write_report([folder], folder)
        text = page.read_text(encoding="utf-8")
        assert "Look before you trust it" in text and "has not ended" in text

    def test_a_batch_page_has_every_case_and_what_went_wrong(self, batch):
        (page,) = write_report([batch], batch)
        text = page.read_text(encoding="utf-8")
        assert "3 of 4 cases are done" in text and "1 of them want a look" in text
        assert "failed: body &lt;disc&gt; lies outside" in text and "speed: 5, 10" in text
        comparison = data_of(page)["comparison"]
        assert [axis["name"] for axis in comparison["axes"]] == ["speed", "cell"]
        force = comparison["outputs"][0]
        assert force == {"name": "peak_contact_force.landing, N/m", "values": [500.0, 1001.0, 502.0, None]}
        assert len(page.read_bytes()) < LIMIT

    def test_a_batch_page_shows_what_the_sweep_asks_for(self, batch, tmp_path):
        """Its title, its outputs first, axes with units, pictures in words; without a copy its folder's name."""
        assert asked_of(batch).title == batch.name
        folder = tmp_path / "asked"
        shutil.copytree(batch, folder)
        (folder / "batch.toml").write_text(
            'title = "Falls"\noutputs = ["steps", "counts.cut"]\n'
            '[axis.speed]\nkey = "body.disc.initial_velocity.1"\nvalues = [5, 10]\n'
            '[axis.cell]\nkey = "body.disc.grid.cell"\nvalues = [0.002]\nnames = ["fine"]\n'
            '[plot.force]\nx = "speed"\ny = "peak_contact_force.landing"\n'
        )
        asked = asked_of(folder)
        assert asked.title == "Falls" and asked.units == {"speed": "m/s"}
        assert asked.plots == {"force": "peak contact force, landing over speed"}
        assert asked.keys["speed"] == " (body.disc.initial_velocity.1)"
        (page,) = write_report([folder], folder)
        comparison = data_of(page)["comparison"]
        assert [axis["name"] for axis in comparison["axes"]] == ["speed, m/s", "cell"]
        assert comparison["outputs"][0]["name"] == "steps"
        assert "<title>Falls" in page.read_text(encoding="utf-8")

    def test_cases_keep_their_values_and_doubts(self, batch):
        cases = compared_cases(batch)
        assert cases[2].inputs == {"speed": 5, "cell": 0.002}
        assert [case.doubts for case in cases] == [(), ("energy error",), (), None]

    def test_a_force_between_the_frames_is_told(self, run_folder, tmp_path):
        results = open_results(run_folder)
        assert _missed(results, "landing") == ""
        few = tmp_path / "few"
        shutil.copytree(run_folder, few)
        history = results.history
        peak = int(np.argmax(np.hypot(history["contact.landing.fx"], history["contact.landing.fy"])))
        lines = (few / "history.csv").read_text().splitlines()
        column = lines[0].split(",").index("contact.landing.fy")
        row = lines[1 + peak].split(",")
        row[column] = "1e9"  # a blow that no frame has seen: its time is no frame's
        between = next(
            k for k in range(len(history.time)) if np.abs(results.times - history.time[k]).min() > 1e-5
        )
        row[0] = lines[1 + between].split(",")[0]
        lines[1 + between] = ",".join(row)
        (few / "history.csv").write_text("\n".join(lines) + "\n")
        assert "the largest force, 1 GN/m at " in _missed(open_results(few), "landing")

    def test_a_case_that_ends_in_contact_or_with_a_warning_is_told_apart(self, batch, tmp_path):
        """In the table and the first line of the page; a warning counts as a check that is not kept."""
        folder = tmp_path / "ends"
        shutil.copytree(batch, folder)
        for case, change in (
            (0, {"bearing_at_end": ["landing"]}),
            (1, {"still_closing": ["landing"], "bearing_at_end": []}),
            (2, {"warnings": ["bodies a and b may meet"]}),
        ):
            path = compared_cases(folder)[case].folder / "summary.json"
            path.write_text(json.dumps(json.loads(path.read_text()) | change))
        cases = compared_cases(folder)
        assert [case.end for case in cases] == [
            "ends in contact",
            "ends while still closing",
            cases[2].end,
            "",
        ]
        assert cases[2].doubts == ("warning",)
        rows = [[cell.text for cell in row] for row in table_of(cases, folder).rows]
        assert "kept; ends in contact" in rows[0] and "energy error; ends while still closing" in rows[1]
        (page,) = write_report([folder], folder)
        text = page.read_text(encoding="utf-8")
        assert "2 of them want a look. " in text and "1 of them: ends while still closing." in text
        assert f'href="{cases[0].folder.name}/' in text  # its page, or its folder where it has none

    def test_runs_beside_each_other(self, run_folder, tmp_path):
        shutil.copytree(run_folder, tmp_path / "other")
        (page,) = write_report([run_folder, tmp_path / "other", run_folder], tmp_path / "both")
        assert page.name == "comparison.html"
        assert "2 of 2 cases are done" in page.read_text(encoding="utf-8")

    def test_histories_of_runs_are_laid_over_each_other(self, run_folder):
        laid = overlay({"a": run_folder, "b": run_folder, "none": run_folder / "fields"})
        history = open_results(run_folder).history
        assert [run["name"] for run in laid["runs"]] == ["a", "b"]
        assert laid["columns"][0] == "kinetic, J/m" and "contact.landing.fy, N/m" in laid["columns"]
        np.testing.assert_allclose(unpacked(laid["runs"][1]["values"][0]), history["kinetic"], rtol=1e-6)
        np.testing.assert_allclose(unpacked(laid["runs"][0]["x"]), 1e3 * history.time, rtol=1e-6)
        assert overlay({"a": run_folder}) is None

    def test_variants_get_pages_and_links_to_them(self, run_folder, tmp_path):
        folder = tmp_path / "main"
        shutil.copytree(run_folder, folder)
        shutil.copytree(run_folder, folder / "variants" / "softer")
        page, variant = write_report([folder], folder)
        assert variant == folder / "variants" / "softer" / "report.html" and variant.is_file()
        text = page.read_text(encoding="utf-8")
        assert 'href="variants/softer/report.html"' in text and "one row in" not in text
        assert [run["name"] for run in data_of(page)["overlay"]["runs"]] == ["main", "softer"]

    def test_a_batch_beside_a_run_is_refused(self, batch, run_folder, tmp_path):
        with pytest.raises(CaseError, match="name it alone"):
            write_report([batch, run_folder], tmp_path)

    def test_the_command_says_where_the_page_is(self, run_folder, tmp_path, capsys):
        assert app(["report", str(run_folder), "--out", str(tmp_path)], result_action="return_value") == 0
        assert f"report    {tmp_path / 'report.html'}" in capsys.readouterr().out


@pytest.fixture(scope="module")
def browser():
    """A real Chromium: the system's, or the one that playwright brought."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as started:
        path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
        if path is None:
            try:
                path = started.chromium.executable_path
            except playwright.Error:
                pytest.skip("there is no Chromium")
        # A machine without a graphics card draws WebGL in software.
        options = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        try:
            chromium = started.chromium.launch(executable_path=path, args=options)
        except playwright.Error as error:
            pytest.skip(f"Chromium does not start: {error.message.splitlines()[0]}")
        yield chromium
        chromium.close()


class Opened:
    """A page in a browser without a network, and what it complained of or asked for."""

    def __init__(self, browser, file, size):
        self.page = browser.new_context(viewport=size, offline=True).new_page()
        self.complaints, self.requests = [], []
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(file.as_uri())
        self.page.wait_for_selector("html[data-ready=yes]", timeout=60_000)

    def quiet(self):
        """Whether it loaded nothing but itself, and said nothing."""
        others = [url for url in self.requests if not url.startswith(("data:", "blob:"))]
        return self.complaints == [] and len(others) == 1

    def fits(self):
        """Whether nothing is wider than the screen."""
        return self.page.evaluate(
            "document.documentElement.scrollWidth <= document.documentElement.clientWidth"
        )

    def pixels(self, selector):
        """(h, w, 3) What an element looks like."""
        from PIL import Image

        shot = self.page.locator(selector).first.screenshot()
        return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)


def coloured(pixels):
    """Share of the pixels that are neither white nor grey."""
    return np.mean(np.ptp(pixels, axis=-1) > 40)


@pytest.mark.browser
class TestInABrowser:
    @pytest.mark.parametrize("size", [WIDE, PHONE], ids=["wide", "phone"])
    def test_a_run_page_loads_alone_and_draws(self, browser, run_report, size):
        opened = Opened(browser, run_report, size)
        assert opened.quiet(), (opened.complaints, opened.requests)
        assert opened.fits()
        assert coloured(opened.pixels("#canvas")) > 0.03
        charts = opened.page.locator("#histories .uplot").count()
        assert charts >= 6
        assert (
            coloured(opened.pixels("#histories .u-over")) > 0.0
            or coloured(opened.pixels("#histories canvas")) > 0.001
        )

    def test_the_view_follows_time_field_and_pointer(self, browser, run_report):
        opened = Opened(browser, run_report, WIDE)
        page, before = opened.page, opened.pixels("#canvas")
        page.evaluate("document.getElementById('time').value = 0; document.getElementById('time').oninput()")
        early = opened.pixels("#canvas")
        assert np.mean(np.any(before != early, axis=-1)) > 0.01
        assert page.locator("#clock").text_content() == "t = 0 ms"
        page.select_option("#field", label="velocity, magnitude, m/s")
        assert np.mean(np.any(opened.pixels("#canvas") != early, axis=-1)) > 0.01
        box = page.locator("#canvas").bounding_box()
        page.evaluate("window.phantomnodeView.fit()")
        x, y = page.evaluate(
            "(() => { const v = window.phantomnodeView, c = v.renderer.getActiveCamera(), q = v.quads, p = v.flat;"
            "const m = [0, 1].map((a) => [0, 1, 2, 3].reduce((s, j) => s + p[2 * q[j] + a] / 4, 0));"
            "const k = v.place.getBoundingClientRect().height / 2 / c.getParallelScale(), f = c.getFocalPoint();"
            "return [(m[0] - f[0]) * k, -(m[1] - f[1]) * k]; })()"
        )
        page.mouse.move(box["x"] + box["width"] / 2 + x, box["y"] + box["height"] / 2 + y)
        assert "velocity, magnitude, m/s: 5 at" in page.locator("#under").text_content()
        page.mouse.wheel(0, -300)
        page.wait_for_timeout(300)
        assert opened.complaints == []

    def test_the_view_shows_where_a_moving_obstacle_is_solid(self, browser, tmp_path):
        """A wedge under the disc, grey within its outline, goes down by 4.8 mm, in a view of some 60 mm."""
        wedge = {"polygon": {"points": [[-0.01, -0.02], [0.01, -0.02], [0.0, -0.001]]}}
        pair = {"slave": "disc.outer", "master": "wedge"}
        table = {
            **TABLE,
            "body": {"disc": TABLE["body"]["disc"]},
            "boundary": {},
            "contact": {"landing": pair},
        }
        table["rigid"] = {"wedge": {"geometry": wedge, "displacement": {"y": "-4*t"}}}
        folder = small_run(tmp_path / "wedge", table)
        (page,) = write_report([folder], folder)
        opened, rows = Opened(browser, page, WIDE), []
        for frame in (0, 6):
            opened.page.evaluate(f"const t = document.getElementById('time'); t.value = {frame}; t.oninput()")
            grey = np.all(np.abs(opened.pixels("#canvas").astype(int) - 219) <= 2, axis=-1)
            assert grey.mean() > 0.005
            rows.append(np.flatnonzero(grey.mean(axis=1) > 0.02)[0] / len(grey))
        assert 0.06 < rows[1] - rows[0] < 0.11
        assert opened.quiet(), (opened.complaints, opened.requests)

    def test_a_batch_page_draws_every_output(self, browser, batch):
        (page,) = write_report([batch], batch)
        opened = Opened(browser, page, PHONE)
        assert opened.quiet() and opened.fits()
        opened.page.select_option("#axis", label="cell")
        opened.page.select_option("#output", label="steps")
        opened.page.check("#log-x")
        opened.page.select_option("#column", label="contact.landing.fy, N/m")
        opened.page.wait_for_selector("#overlay .u-title:has-text('contact.landing.fy')")
        assert coloured(opened.pixels("#overlay canvas")) > 0.001
        assert opened.page.locator("#comparison .u-title").text_content() == "steps"
        assert coloured(opened.pixels("#comparison canvas")) > 0.0002
        assert opened.complaints == []

    @pytest.mark.slow
    def test_ring_impact_and_a_batch_of_it(self, browser, tmp_path):
        """The bundled case in full, and two cases of a sweep, as a user runs them."""
        sweep = tmp_path / "sweep.toml"
        sweep.write_text(
            'base = "ring_impact"\nset = { "time.end" = 2e-3, "output.fields.count" = 4 }\n'
            '[axis.speed]\nkey = "body.ring.initial_velocity.1"\nvalues = [-50.0, -80.0]\n'
        )
        commands = [
            ["run", "ring_impact", "--out", tmp_path / "ring"],
            ["batch", sweep, "--out", tmp_path / "both"],
        ]
        for command in commands:
            subprocess.run([sys.executable, "-m", "phantomnode", *map(str, command)], check=True)
        for folder in ("ring", "both"):
            page, *_ = write_report([tmp_path / folder], tmp_path / folder)
            assert page.stat().st_size < LIMIT
            for size in (WIDE, PHONE):
                opened = Opened(browser, page, size)
                assert opened.quiet() and opened.fits(), (opened.complaints, opened.requests)
                assert coloured(opened.pixels("#canvas" if folder == "ring" else "#overlay canvas")) > 0.001
