from __future__ import annotations

import dataclasses
import io
import json
import os
import signal
from pathlib import Path

import meshio
import numpy as np
import pytest
from rich.console import Console

from phantomnode.pipeline import prepare as prepare_module
from phantomnode.pipeline.census import count, step_set_by
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.fields import Fields
from phantomnode.pipeline.observer import Ending
from phantomnode.pipeline.preflight import steps_of, text_report
from phantomnode.pipeline.results import open_results
from phantomnode.pipeline.run import check, run
from phantomnode.pipeline.summary import Clock, summarize
from phantomnode.pipeline.tally import Tally, crossing_time

CONTRACT = {
    "version", "status", "case", "steps", "dt", "dt_set_by", "end_time", "wall_s", "step_loop_s",
    "element_updates_per_s", "counts", "area", "mass", "energies", "energy_error_max", "peak_contact_force",
}  # fmt: skip


@pytest.fixture
def prepared(handmade, monkeypatch):
    """The hand-made case, which ``run`` and ``check`` find prepared."""
    monkeypatch.setattr(prepare_module, "prepare", lambda case: handmade, raising=False)
    return handmade


def tallied(handmade, frames):
    tally = Tally(handmade)
    for frame in frames:
        tally.frame(frame)
    return tally


def test_counts_of_the_handmade_case(handmade):
    assert count(handmade) == {
        "grid_cells": 5, "elements": 5, "cut": 1, "doubled": 0, "nodes": 13, "phantom_nodes": 1,
        "relocated_nodes": 0, "smallest_fraction": 0.875, "contact_points": 4,
    }  # fmt: skip


def test_contact_phases_are_told_apart(handmade, frame_of):
    """Open, closed twice, open for 6 steps of 0.1 ms, closed to the end; a wave crosses 1 m in 0.5 ms."""
    forces = [0.0, 1.0, 2.0, *[0.0] * 5, 3.0]
    tally = tallied(handmade, [frame_of(k, pair_force=np.array([[0.0, f]])) for k, f in enumerate(forces)])
    dt = handmade.dt
    assert crossing_time(handmade, handmade.bodies[0]) == pytest.approx(5e-4, rel=1e-14)
    assert tally.phases(0) == tally.touches(0) == [(dt, 2 * dt), (8 * dt, 8 * dt)]


def test_chatter_is_one_phase(handmade, frame_of):
    """Breaks of 2 and 4 steps, 0.2 and 0.4 ms, are over before a wave has crossed the block."""
    forces = [1.0, 0.0, 2.0, 0.0, 0.0, 0.0, 3.0, 0.0]
    tally = tallied(handmade, [frame_of(k, pair_force=np.array([[f, 0.0]])) for k, f in enumerate(forces)])
    assert len(tally.touches(0)) == 3
    assert tally.phases(0) == [(0.0, 6 * handmade.dt)]


def test_never_in_contact_has_no_phase(handmade, frame_of):
    assert tallied(handmade, [frame_of(0), frame_of(1)]).phases(0) == []


@pytest.mark.parametrize(("impulse", "error"), [(3.0, 0.0), (3.3, 0.3 / 3.3), (0.0, 1.0)])
def test_momentum_balance(handmade, frame_of, impulse, error):
    """The block's velocity changes by 3 m/s; the impulse per mass is given."""
    block, floor = handmade.bodies
    mass = handmade.model.mass[block.nodes].sum()
    v = handmade.velocity.copy()
    v[block.nodes] += (0.0, 3.0)
    end = frame_of(5, v=v, pair_impulse=np.array([[0.0, impulse * mass]]))
    tally = tallied(handmade, [frame_of(0), end])
    # Sums of nine masses: rounding only.
    assert tally.momentum(block).error == pytest.approx(error, abs=1e-14)
    np.testing.assert_allclose(tally.momentum(floor).impulse, [0.0, -impulse * mass])
    # The floor is held in y; along x nothing happens. It stays at rest: what holds it gives back what it gets.
    assert tally.momentum(floor).error == 0.0
    np.testing.assert_allclose(tally.momentum(floor).reaction, [0.0, impulse * mass])
    np.testing.assert_array_equal(tally.momentum(block).reaction, 0.0)


def test_gravity_belongs_to_the_balance(handmade, frame_of):
    block = handmade.bodies[0]
    load = handmade.model.mass[:, None] * np.array([0.0, -10.0])
    heavy = dataclasses.replace(handmade, model=handmade.model._replace(load=load))
    end = frame_of(5, v=handmade.velocity + (0.0, -10.0 * 5 * handmade.dt))
    # A product of the time 5 dt with 1000s of kg m/s: rounding of the difference of velocities, 2e-16/5e-3.
    assert tallied(heavy, [frame_of(0), end]).momentum(block).error < 1e-12


def test_what_is_not_finite_is_null(handmade, frame_of, tmp_path):
    tally = tallied(handmade, [frame_of(0, smallest_j=np.nan)])
    summary = summarize(handmade, tally, Ending("stopped", "r", "a", None), Clock(1.0, 0.0), tmp_path)
    summary.write()
    figures = json.loads((tmp_path / "summary.json").read_text())
    assert figures["smallest_J"] is None and not summary.trusted


def test_limits_that_are_not_kept_are_named(handmade, frame_of, tmp_path):
    deep = np.array([0.15, -1e300, -1e300, -1e300])  # 0.3 of the cell
    tally = tallied(handmade, [frame_of(0), frame_of(1, energy_error=0.02, largest_energy=1.0, gap=deep)])
    summary = summarize(handmade, tally, Ending("done", "", "", None), Clock(1.0, 1.0), tmp_path)
    failed = {check.name for check in summary.checks if not check.passed}
    assert failed == {"energy error", "penetration over cell size"}


def test_run_writes_everything(prepared, handmade, tmp_path):
    out = tmp_path / "results"
    screen = Console(file=io.StringIO(), width=100)
    summary = run(prepared.case, out, console=screen, command=("phantomnode", "run", "a b"))
    figures = json.loads((out / "summary.json").read_text())
    assert set(figures) >= CONTRACT
    assert (summary.status, figures["status"], figures["steps"]) == ("done", "done", 100)
    assert {path.name for path in out.iterdir()} == {
        "case.toml", "summary.json", "history.csv", "fields.pvd", "fields", "contact.pvd", "contact",
        "run.log", "peak.png", "manifest.json",
    }  # fmt: skip
    # 60 frames after the start; 100 steps for 2000 rows.
    assert len(list((out / "fields").iterdir())) == len(list((out / "contact").iterdir())) == 61
    assert len((out / "history.csv").read_text().splitlines()) == 102
    assert all(meshio.read(path).points.size for path in (out / "fields").iterdir())
    assert figures["momentum"]["block"]["error"] < 1e-3
    assert figures["peak_contact_force"]["landing"] > 0.0
    # The second way: a row of the history a step, by the trapezoid rule; the force of a row belongs to the half step
    # before it, so that the last half step of it is missed.
    history = open_results(out).history
    force = np.column_stack([history[f"reaction.base.f{axis}"] for axis in "xy"])
    missed = 0.5 * handmade.dt * np.abs(force).max()
    given = np.trapezoid(force, history.time, axis=0)
    np.testing.assert_allclose(figures["momentum"]["floor"]["reaction"], given, atol=1.01 * missed)
    assert np.abs(given).max() > 5.0 * missed
    stresses = [open_results(out).frame(float(time)) for time in open_results(out).times]
    for number, name in enumerate(("block", "floor")):
        highest = max(f.values("von_mises")[f.cell("body") == number].max() for f in stresses)
        assert figures["highest_von_mises"][name] == highest > 0.0
    assert len(figures["contact_phases"]["landing"]) >= 1
    log = (out / "run.log").read_text()
    assert "phantomnode run 'a b'" in log and "a warning [with brackets]" in log and "status: done" in log
    shown = screen.file.getvalue()
    assert "paraview" in shown and "energy error" in shown and "100%" in shown


def test_a_second_run_leaves_nothing_of_the_first(prepared, tmp_path):
    run(prepared.case, tmp_path / "out")
    few = prepared.case.output.model_copy(
        update={"fields": prepared.case.output.fields.model_copy(update={"count": 2})}
    )
    object.__setattr__(prepared, "case", prepared.case.model_copy(update={"output": few}))
    run(prepared.case, tmp_path / "out")
    assert len(list((tmp_path / "out" / "fields").iterdir())) == 3


def test_two_runs_are_the_same_to_the_bit(prepared, tmp_path):
    for name in ("a", "b"):
        run(prepared.case, tmp_path / name)
    for file in ("history.csv", "fields/fields_00060.vtu", "contact/contact_00030.vtu", "fields.pvd"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_guard_stops_and_the_last_good_state_is_there(prepared, tmp_path):
    """A step beyond the stable one: the energy guard, or an inverted element, ends the run."""
    object.__setattr__(prepared, "dt", 5e-4)
    summary = run(prepared.case, tmp_path / "out")
    figures = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary.status, figures["status"]) == ("stopped", "stopped") and not summary.trusted
    assert figures["reason"] and figures["advice"]
    last = sorted((tmp_path / "out" / "fields").iterdir())[-1]
    assert meshio.read(last).field_data is not None
    rows = (tmp_path / "out" / "history.csv").read_text().splitlines()
    assert float(rows[-1].split(",")[0]) == figures["end_time"]
    assert "stopped" in (tmp_path / "out" / "run.log").read_text()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_run_with_its_state_written(prepared, tmp_path, monkeypatch, number):
    before = signal.getsignal(number)
    take = Tally.frame

    def frame(self, frame):
        take(self, frame)
        if frame.step == 10:
            os.kill(os.getpid(), number)

    monkeypatch.setattr(Tally, "frame", frame)
    summary = run(prepared.case, tmp_path / "out")
    assert summary.status == "interrupted" and summary.figures["steps"] < 100
    rows = (tmp_path / "out" / "history.csv").read_text().splitlines()
    assert float(rows[-1].split(",")[0]) == summary.figures["end_time"]
    assert signal.getsignal(number) is before


def test_results_do_not_go_where_a_file_is(prepared, tmp_path):
    (tmp_path / "out").write_text("mine")
    with pytest.raises(CaseError, match="this is a file"):
        run(prepared.case, tmp_path / "out")
    assert (tmp_path / "out").read_text() == "mine"


def test_results_do_not_overwrite_the_case_file(prepared):
    with pytest.raises(CaseError, match="own folder"):
        run(prepared.case, prepared.case.folder)


def test_a_case_at_fault_leaves_nothing(handmade, tmp_path, monkeypatch):
    def refuse(case):
        raise CaseError("no cells in the body")

    monkeypatch.setattr(prepare_module, "prepare", refuse, raising=False)
    with pytest.raises(CaseError, match="no cells"):
        run(handmade.case, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_check_reports_and_draws(prepared, tmp_path):
    screen = Console(file=io.StringIO(), width=140)
    check(prepared.case, tmp_path, console=screen)
    assert (tmp_path / "preview.png").read_bytes().startswith(b"\x89PNG")
    assert sum(len(block.data) for block in meshio.read(tmp_path / "preview.vtu").cells) == 7
    text = screen.file.getvalue()
    for word in (
        "area as cut",
        "0.96875",
        "landing",
        "base",
        "uncut element of body block",
        "[with brackets]",
    ):
        assert word in text


def test_report_as_text_has_no_escapes(handmade):
    assert "\x1b" not in text_report(handmade)


@pytest.mark.parametrize(("dt", "steps"), [(1e-4, 100), (0.99e-4, 102), (1.0, 1), (1e-2 / 3.0, 3)])
def test_steps_reach_the_end(handmade, dt, steps):
    """Also where end / dt is whole but for rounding."""
    assert steps_of(dataclasses.replace(handmade, dt=dt)) == steps


def test_live_bar_on_a_terminal(prepared, tmp_path):
    screen = Console(file=io.StringIO(), width=140, force_terminal=True)
    run(prepared.case, tmp_path / "out", console=screen)
    shown = screen.file.getvalue()
    assert "steps/s" in shown and "of 10 ms" in shown
    assert screen._live_stack == []


def test_a_full_disk_is_an_error_and_gives_the_terminal_back(prepared, tmp_path, monkeypatch):
    def full(self, frame):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Fields, "take", full)
    screen = Console(file=io.StringIO(), width=140, force_terminal=True)
    with pytest.raises(OSError, match="No space left"):
        run(prepared.case, tmp_path / "out", console=screen)
    assert screen._live_stack == []
    assert not (tmp_path / "out" / "summary.json").exists()


def test_what_sets_the_step(handmade):
    automatic = "an uncut element of body block, with contact (1.41 times as long without)"
    assert step_set_by(handmade) == automatic
    cut = dataclasses.replace(handmade, estimate=handmade.estimate._replace(element=4, contact_frequency=0.0))
    assert step_set_by(cut) == "a cut element of body block"
    time = handmade.case.time.model_copy(update={"step": 1e-5})
    given = dataclasses.replace(handmade, case=handmade.case.model_copy(update={"time": time}))
    assert step_set_by(given) == f"the case (stable: 0.0001 s by {automatic})"


@pytest.mark.parametrize(
    ("block", "floor", "closing"),
    [
        ((0.0, -1.0), (0.0, 0.0), True),  # still falls on the floor below
        ((0.0, 1.0), (0.0, 0.0), False),  # bounces off
        ((0.0, -1.0), (0.0, -2.0), False),  # the floor flees
        ((5.0, 0.0), (0.0, 0.0), False),  # slides along
    ],
)
def test_whether_bodies_still_close_at_the_end(handmade, frame_of, block, floor, closing):
    tally = Tally(handmade)
    v = np.zeros_like(handmade.model.x)
    for body, speed in zip(handmade.bodies, (block, floor), strict=True):
        v[body.nodes] = speed
    tally.frame(frame_of(0, u=0.0 * v, v=v))
    assert not tally.still_closing(0)  # nothing has touched
    tally.frame(frame_of(1, u=0.0 * v, v=v, pair_impulse=np.array([[0.0, 3.0]])))
    assert tally.still_closing(0) is closing
    for status, named in (("done", ["landing"] if closing else []), ("stopped", [])):
        summary = summarize(handmade, tally, Ending(status, "r", "a", None), Clock(1.0, 1.0), Path())
        assert summary.figures["still_closing"] == named  # a run that was stopped is told what to do for that
