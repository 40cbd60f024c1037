"""Sweep files: axes into values, values into cases with names, and what is refused before anything runs."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from phantomnode.pipeline.axes import Axis, Samples, axis_values
from phantomnode.pipeline.case import bundled_cases, case_from_table
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.names import LONGEST, unique_names
from phantomnode.pipeline.outputs import known_outputs, output_of, unit_of, unit_of_key
from phantomnode.pipeline.sweep import load_study

SPEED = {"key": "body.part.initial_velocity.1", "values": [-10.0, -20.0]}
CELL = {"key": "body.part.grid.cell", "values": [0.5, 0.25, 0.2]}


def values_of(samples: Samples | None = None, **axis: Any) -> list[Any]:
    return axis_values("a", Axis.model_validate({"key": "time.end", **axis}), samples)


@pytest.fixture
def sweep(tmp_path: Path):
    """Writes a small case and a sweep of it, and loads the sweep."""
    case = {
        "time": {"end": 1e-3},
        "material": {"soft": {"E": 1e9, "nu": 0.3, "rho": 1000.0}},
        "body": {
            "part": {
                "geometry": {"rectangle": {"low": [0.0, 0.0], "high": [1.0, 1.0]}},
                "grid": {"kind": "cartesian", "cell": 0.5},
                "material": "soft",
                "initial_velocity": [0.0, -1.0],
            }
        },
    }
    (tmp_path / "case.toml").write_text(tomli_w.dumps(case))

    def load(**table: Any):
        (tmp_path / "sweep.toml").write_text(tomli_w.dumps({"axis": {"speed": SPEED}, **table}))
        return load_study(tmp_path)

    return load


@pytest.mark.parametrize(
    ("axis", "found"),
    [
        ({"values": [1, "auto", [0.0, 1.0]]}, [1, "auto", [0.0, 1.0]]),
        ({"linspace": {"first": 0.1, "last": 0.5, "count": 5}}, [0.1, 0.2, 0.3, 0.4, 0.5]),
        ({"linspace": {"first": 10, "last": 40, "count": 4}, "integer": True}, [10, 20, 30, 40]),
        ({"logspace": {"first": 10.0, "last": 1000.0, "count": 3}}, [10.0, 100.0, 1000.0]),
        ({"logspace": {"first": -1, "last": -100, "count": 3}}, [-1.0, -10.0, -100.0]),
        ({"range": {"first": 0.0, "last": 0.3, "step": 0.1}}, [0.0, 0.1, 0.2, 0.3]),
        ({"range": {"first": 5, "last": 1, "step": -3}, "integer": True}, [5, 2]),
    ],
)
def test_values_of_an_axis(axis: dict[str, Any], found: list[Any]) -> None:
    values = values_of(**axis)
    assert values == found and [type(v) for v in values] == [type(f) for f in found]


def test_random_values_follow_the_seed_and_the_name_and_keep_their_limits() -> None:
    many, span = Samples(count=2000, seed=3), {"low": 1.0, "high": 100.0}
    uniform, log = values_of(many, uniform=span), values_of(many, loguniform=span)
    assert uniform == values_of(many, uniform=span) != values_of(Samples(count=2000, seed=4), uniform=span)
    axis = Axis.model_validate({"key": "time.end", "uniform": span})
    assert axis_values("other", axis, many) != uniform
    assert min(uniform + log) >= 1.0 and max(uniform + log) <= 100.0
    # Means of 2000 values: three standard errors are 1.9, and 0.09 of the logarithm.
    assert np.mean(uniform) == pytest.approx(50.5, abs=1.9)
    assert np.mean(np.log(log)) == pytest.approx(np.log(10.0), abs=0.09)
    normal = values_of(many, normal={"mean": 5.0, "deviation": 2.0})
    assert (np.mean(normal), np.std(normal)) == pytest.approx((5.0, 2.0), abs=0.14)


def test_axes_are_crossed_and_the_last_varies_fastest(sweep) -> None:
    study = sweep(axis={"speed": SPEED, "cell": CELL})
    assert [tuple(p.values.values()) for p in study.points] == [
        (speed, cell) for speed in SPEED["values"] for cell in CELL["values"]
    ]
    last = study.points[-1]
    assert last.name == "speed=-20_cell=0.2"
    assert last.case.body["part"].initial_velocity == (0.0, -20.0)
    assert last.case.body["part"].grid.cell == 0.2
    assert len({point.hash for point in study.points}) == 6


def test_zipped_axes_go_together_and_one_value_can_set_several_keys(sweep) -> None:
    both = {"keys": ["time.end", "time.safety"], "values": [0.5, 0.25]}
    study = sweep(axis={"speed": SPEED, "cell": CELL, "both": both}, zip=[["speed", "both"]])
    assert len(study.points) == 6
    assert {(p.values["speed"], p.values["both"]) for p in study.points} == {(-10.0, 0.5), (-20.0, 0.25)}
    assert all(p.case.time.end == p.case.time.safety == p.values["both"] for p in study.points)


def test_random_axes_go_together_and_cross_the_others(sweep) -> None:
    end = {"key": "time.end", "uniform": {"low": 1e-3, "high": 2e-3}}
    gravity = {"key": "gravity.1", "normal": {"mean": -9.81, "deviation": 0.1}}
    base = {"set": {"gravity": [0.0, 0.0]}, "samples": {"count": 4, "seed": 1}}
    study = sweep(axis={"speed": SPEED, "end": end, "gravity": gravity}, **base)
    assert len(study.points) == 8
    assert len({(p.values["end"], p.values["gravity"]) for p in study.points}) == 4


def test_a_sweep_of_a_bundled_case_and_keys_of_every_case(sweep) -> None:
    axis = {"speed": {**SPEED, "key": "body.ring.initial_velocity.1"}}
    study = sweep(base="ring_impact", set={"time.end": 1e-3}, axis=axis)
    assert study.points[0].case.time.end == 1e-3 and study.points[0].case.name == "ring_impact"
    assert study.points[0].case.path("ring.dxf").is_file()


def test_names_of_values_stand_in_their_places_in_folders_and_tables(sweep) -> None:
    cell = {**CELL, "names": ["coarse", "coarse", "fine"]}
    study = sweep(
        axis={"speed": {**SPEED, "values": [-1.0, -2.0, -3.0]}, "cell": cell}, zip=[["speed", "cell"]]
    )
    assert [p.name for p in study.points] == [
        "speed=-1_cell=coarse",
        "speed=-2_cell=coarse",
        "speed=-3_cell=fine",
    ]
    assert [p.values["cell"] for p in study.points] == ["coarse", "coarse", "fine"]
    assert [p.case.grid_of("part").cell for p in study.points] == [0.5, 0.25, 0.2]


def test_the_bundled_sweep_has_24_cases_and_is_no_case() -> None:
    study = load_study("ring_impact")
    assert len(study.points) == 24 and study.name == "ring_impact_sweep"
    assert not [name for name in bundled_cases() if "sweep" in name]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"axes": {}}, "axes: unknown key (did you mean 'axis'?); the sweep knows title, base, set, axis, zip"),
        ({"axis": {"a": {"key": "time.ennd", "values": [1.0]}}}, "time.ennd: unknown key (did you mean 'end'?)"),
        ({"axis": {"a": {"key": "tine.end", "values": [1.0]}}}, "axis.a: tine.end: unknown key 'tine'"),
        ({"set": {"body.prt.material": "a"}}, "set.\"body.prt.material\": there is no body 'prt'"),
        ({"axis": {"a": {"key": "time.end", "values": [1.0, -1.0]}}}, "case a=-1: time.end = -1.0: must be greater"),
        ({"axis": {"a": {"key": "time.end", "valuess": [1.0]}}}, "axis.a.valuess: unknown key (did you mean"),
        ({"axis": {"a": {"key": "time.end"}}}, "axis.a: exactly one of values, linspace"),
        ({"axis": {"a": {"values": [1.0]}}}, "axis.a: exactly one of key, keys"),
        ({"axis": {"a": {"key": "time.end", "values": []}}}, "axis.a.values = []: needs at least 1 entry"),
        ({"axis": {}}, "axis"),
        ({"axis": {"a b": SPEED}}, "axis: 'a b' cannot be a name"),
        ({"axis": {"status": SPEED}}, "axis.status: results.csv has a column of that name"),
        ({"axis": {"a": SPEED, "b": SPEED}}, "axis.b: body.part.initial_velocity.1 is set by axis a already"),
        ({"axis": {"a": {"key": "time.end", "values": [1.0, 1.0]}}}, "two cases are the same"),
        ({"axis": {"a": {"keys": ["time.end", "time.end"], "values": [1.0]}}}, "one of them stands twice"),
        ({"zip": [["speed", "cell"]]}, "zip: there is no axis 'cell'; there are speed"),
        ({"axis": {"speed": SPEED, "cell": CELL}, "zip": [["speed", "cell"]]}, "speed has 2, cell has 3"),
        ({"samples": {"count": 3}}, "samples is given, but no axis"),
        ({"axis": {"a": {"key": "time.end", "uniform": {"low": 1, "high": 2}}}}, "axis a is random: add samples"),
        ({"axis": {"a": {"key": "time.end", "uniform": {"low": 2, "high": 2}}}}, "must be below high"),
        ({"axis": {"a": {"key": "time.end", "loguniform": {"low": 0, "high": 2}}}}, "must be greater than 0"),
        ({"axis": {"a": {"key": "time.end", "logspace": {"first": -1, "last": 1, "count": 3}}}}, "the same sign"),
        ({"axis": {"a": {"key": "time.end", "linspace": {"first": 1, "last": 2, "count": 1}}}}, "must be at least 2"),
        ({"axis": {"a": {"key": "time.end", "range": {"first": 1, "last": 2, "step": -1}}}}, "do not lead from 1"),
        ({"axis": {"a": {"key": "time.end", "range": {"first": 0, "last": 1, "step": 1e-9}}}}, "more than 100000"),
        ({"base": "ring_impct"}, "no bundled case of that name (did you mean 'ring_impact'?)"),
        ({"outputs": ["energy_eror_max"]}, "there is no such output (did you mean 'energy_error_max'?)"),
        ({"plot": {"p": {"x": "sped", "y": "dt"}}}, "plot.p.x: no axis 'sped' (did you mean 'speed'?)"),
        ({"plot": {"p": {"x": "speed", "y": "dtt"}}}, 'plot.p.y = "dtt": there is no such output'),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_with_its_key(sweep, table: dict[str, Any], message: str) -> None:
    with pytest.raises(CaseError) as refused:
        sweep(**table)
    assert message in str(refused.value) and "sweep.toml: " in str(refused.value)
    assert ": :" not in str(refused.value)


def test_names_are_safe_unlike_each_other_and_not_too_long() -> None:
    plain = [{"file": "a/b c.dxf"}, {"file": "a:b*c.dxf"}, {"file": ["x", 1.5]}, {"file": {"times_E": 10}}]
    names = unique_names(plain)
    assert names[2:] == ["file=x+1.5", "file=times_E-10"]
    assert names[0].startswith("file=a-b-c.dxf~") and names[0] != names[1]
    capitals = unique_names([{"a": "Steel"}, {"a": "steel"}])
    assert capitals[0].lower() != capitals[1].lower()
    close = unique_names([{"a": 0.1234567}, {"a": 0.1234568}])
    assert close[0] != close[1]
    (long,) = unique_names([{f"axis{n}": "x" * 30 for n in range(9)}])
    assert len(long) == LONGEST + 7


def test_every_output_is_in_the_summary_of_a_run(tmp_path: Path) -> None:
    from phantomnode.pipeline.one_case import WARM_UP
    from phantomnode.pipeline.run import run

    case = case_from_table(tomllib.loads(WARM_UP))
    run(case, tmp_path)
    figures = json.loads((tmp_path / "summary.json").read_text())
    found = {name: output_of(figures, name) for name in known_outputs(case)}
    assert all(isinstance(value, int | float) for value in found.values()), found
    assert unit_of("variant.soft.peak_contact_force.landing") == "N/m" and unit_of("counts.cut") == ""
    assert found["velocity.disc.start.y"] == pytest.approx(-50.0) and found["contact_phases.landing"] == 0


@pytest.mark.parametrize(
    ("key", "unit"),
    [
        ("body.ring.initial_velocity.1", "m/s"),
        ("body.ring.grid.cell", "m"),
        ("boundary.base.velocity.y", "m/s"),
        ("contact.a.penalty.times_E", "1/m"),
        ("contact.a.penalty.value", "Pa/m"),
        ("contact.a.friction", ""),
        ("method", ""),
    ],
)
def test_keys_have_units(key, unit):
    assert unit_of_key(key) == unit
