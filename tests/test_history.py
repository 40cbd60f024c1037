from __future__ import annotations

import csv

import numpy as np
import pytest

from phantomnode.pipeline.history import History, columns
from phantomnode.pipeline.observer import Ending, sample_steps
from phantomnode.solver.model import Energies

CONTRACT = (
    "time,kinetic,internal,hourglass,contact,external_work,energy_error,contact.landing.fx,contact.landing.fy,"
    "reaction.base.fx,reaction.base.fy,body.block.ux,body.block.uy,body.block.vx,body.block.vy,"
    "body.floor.ux,body.floor.uy,body.floor.vx,body.floor.vy"
)


def read(path):
    with path.open(newline="") as file:
        return [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]


def test_columns_begin_as_the_contract_says(handmade):
    assert ",".join(columns(handmade)).startswith(CONTRACT + ",")


def test_values_come_back_to_the_bit(handmade, frame_of, tmp_path):
    history = History(handmade, tmp_path / "history.csv", frozenset({0, 7}))
    u = np.zeros((13, 2))
    u[:9] = (0.1, -0.3)
    frame = frame_of(
        7,
        u=u,
        energies=Energies(1.0 / 3.0, 2e-17, 3.0, 4.0, 5.0),
        energy_error=0.1 + 0.2,
        reaction=np.array([np.pi]),
        pair_force=np.array([[1e300, -1.0]]),
        pair_impulse=np.array([[0.25, 0.5]]),
    )
    history.frame(frame_of(0))
    history.frame(frame)
    history.finish(Ending("done", "", "", frame))
    rows = read(tmp_path / "history.csv")
    assert len(rows) == 2
    last = rows[1]
    assert last["kinetic"] == 1.0 / 3.0 and last["internal"] == 2e-17 and last["energy_error"] == 0.1 + 0.2
    assert (last["reaction.base.fx"], last["reaction.base.fy"]) == (0.0, np.pi)
    assert (last["contact.landing.fx"], last["contact.landing.iy"]) == (1e300, 0.5)
    # A rigid displacement is the centre's, whatever the masses; mean of 9 numbers: rounding only.
    assert last["body.block.uy"] == pytest.approx(-0.3, rel=1e-15)
    assert last["body.block.vy"] == pytest.approx(-2.0, rel=1e-15)


def test_every_line_is_in_the_file_at_once(handmade, frame_of, tmp_path):
    history = History(handmade, tmp_path / "history.csv", frozenset({0}))
    history.frame(frame_of(0))
    assert len(read(tmp_path / "history.csv")) == 1
    history.finish(Ending("interrupted", "", "", None))


def test_last_good_frame_of_a_stopped_run_is_written_once(handmade, frame_of, tmp_path):
    history = History(handmade, tmp_path / "history.csv", frozenset({0, 10}))
    assert history.due(10) and not history.due(3)
    history.frame(frame_of(0))
    history.finish(Ending("stopped", "why", "what to do", frame_of(3)))
    assert [row["time"] for row in read(tmp_path / "history.csv")] == [0.0, 3 * handmade.dt]


@pytest.mark.parametrize(
    ("steps", "count", "samples"),
    [(10, 5, {0, 2, 4, 6, 8, 10}), (3, 2000, {0, 1, 2, 3}), (1, 1, {0, 1}), (7, 2, {0, 4, 7})],
)
def test_samples_hold_the_start_and_the_end(steps, count, samples):
    assert sample_steps(steps, count) == samples
