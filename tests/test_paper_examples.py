"""Coarse versions of the paper's examples 4.1 to 4.3, a physical number each; 4.3 and 4.4 are in test_cases too."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from phantomnode.pipeline.case import load_case
from phantomnode.pipeline.run import run
from phantomnode.pipeline.sweep import load_study

Columns = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def history(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Columns]:
    """The columns of history.csv of a bundled case with some keys set."""

    def histories(name: str, *overrides: str) -> Columns:
        folder = tmp_path_factory.mktemp("example") / "results"
        summary = run(load_case(name, ("output.fields.count=1", *overrides)), folder)
        assert summary.status == "done"
        file = folder / "history.csv"
        header = file.read_text().partition("\n")[0].split(",")
        return dict(zip(header, np.loadtxt(file, delimiter=",", skiprows=1).T, strict=True))

    return histories


@pytest.mark.parametrize("mesh", ["cells_11", "quads_coarse"])
def test_the_compressed_block_bears_what_a_conforming_mesh_does(history, mesh: str) -> None:
    """4.1 at 100 E. Static, nine-node elements whose mesh fits the interface: 1.3314e9 N/m; measured 0.1 % off."""
    rows = history("block_contact", f"body.block.grid={mesh}")
    held = rows["time"] > 0.1
    force, reaction = rows["contact.halves.fy"][held].mean(), rows["reaction.base.fy"][held].mean()
    assert force == pytest.approx(1.3314e9, rel=0.01)
    assert abs(reaction) == pytest.approx(force, rel=1e-4)  # nothing swings any more


def test_the_pushed_half_rings_bear_what_finer_ones_do(history) -> None:
    """4.2 at the end of the push: 1.808e8 N/m on 5 x 80 cells; 5 x 20 (a crown of 7.7 cm chords) is 0.7 % below.

    The means over 2 ms leave out what rings after the sudden start of the push.
    """
    rows = history("curved_bodies", "time.end=0.1")
    late = rows["time"] > 0.098
    assert rows["contact.crowns.fy"][late].mean() == pytest.approx(1.808e8, rel=0.02)
    assert abs(rows["contact.crowns.fx"][late].mean()) < 1e-3 * 1.808e8  # the bodies are mirror images


def test_the_severe_wave_is_climbed(history) -> None:
    """4.3 with waves of 0.1 m: 40 x 20 cells hold 130 MJ/m with crest on crest, and these 5 % less.

    The lower half gives way to the right at its free end: the peak comes 3 ms after 0.08 s, on 40 x 20 cells too.
    """
    rows = history(
        "wavy_block", "interface.wave.geometry.function='0.5 + 0.1*sin(5*pi*x/2)'", "time.step='auto'",
        "body.block.grid.counts=[20, 10]", "time.end=0.09",
    )  # fmt: skip
    crest = np.argmax(rows["internal"])
    assert rows["time"][crest] == pytest.approx(0.083, abs=0.003)
    assert rows["internal"][crest] == pytest.approx(130e6, rel=0.08)
    assert abs(rows["energy_error"][-1]) < 1e-3


@pytest.mark.parametrize(
    ("name", "cases"),
    [("split_block_wave", 3), ("block_contact", 15), ("curved_bodies", 12), ("wavy_block", 6)],
)
def test_the_sweeps_have_the_papers_meshes_and_penalties(name: str, cases: int) -> None:
    assert len(load_study(name).points) == cases


def test_every_reader_is_used_by_an_example() -> None:
    folder = Path(load_case("block_contact").folder).parent
    kinds = {file.suffix for file in folder.glob("*/*.*")}
    assert {".dxf", ".step", ".brep", ".geo_unrolled", ".msh"} <= kinds
