"""Variants: how their keys are merged into the case, and that all of them are prepared before the first step."""

from __future__ import annotations

from pathlib import Path

import pytest

from phantomnode.pipeline import cli
from phantomnode.pipeline.case import case_from_table, variants
from phantomnode.pipeline.merging import NAMED, merged
from phantomnode.pipeline.schema import Case, Output

CASE = """
time = { end = 3e-4 }
[material.steel]
E = 210e9
nu = 0.3
rho = 7800.0
[body.slab]
geometry = { rectangle = { low = [-0.2, 0.0005], high = [0.2, 0.2005] } }
grid = { kind = "cartesian", cell = 0.05 }
material = "steel"
initial_velocity = [0.0, -5.0]
[contact.c]
slave = "slab.outer"
master = "pin"
[rigid.pin]
geometry = { circle = { centre = [0.0, -0.1], radius = 0.1 } }
"""


@pytest.mark.parametrize(
    ("table", "changes", "both"),
    [
        ({"a": 1, "b": {"c": 2, "d": 3}}, {"b": {"c": 5}}, {"a": 1, "b": {"c": 5, "d": 3}}),
        (  # another shape in the same place
            {"circle": {"centre": [0, 0], "radius": 1}, "move": [1, 0]},
            {"polygon": {"points": []}},
            {"polygon": {"points": []}, "move": [1, 0]},
        ),
        (  # what belongs to the file goes with it
            {"file": "a.dxf", "unit": "mm", "layers": ["x"], "scale": 2.0},
            {"circle": {"centre": [0, 0], "radius": 1}},
            {"circle": {"centre": [0, 0], "radius": 1}, "scale": 2.0},
        ),
        ({"file": "a.dxf", "unit": "mm"}, {"file": "b.dxf"}, {"file": "b.dxf", "unit": "mm"}),
        ({"function": "x", "x": [0, 1]}, {"polyline": 1}, {"polyline": 1}),
        (
            {"on": "a.top", "pressure": 1.0, "follower": True},
            {"velocity": {"x": 1}},
            {"on": "a.top", "velocity": {"x": 1}},
        ),
        ({"displacement": {"x": 0, "y": 0}}, {"displacement": {"y": 1}}, {"displacement": {"x": 0, "y": 1}}),
        ({"penalty": {"times_E": 10}}, {"penalty": {"value": 1e9}}, {"penalty": {"value": 1e9}}),
        (
            {"kind": "cartesian", "cell": 0.1, "box": 1},
            {"kind": "polar", "counts": 2},
            {"kind": "polar", "counts": 2},
        ),
        (
            {"kind": "cartesian", "cell": 0.1, "aligned": True},
            {"counts": [2, 2]},
            {"kind": "cartesian", "counts": [2, 2], "aligned": True},
        ),
    ],
)
def test_a_variant_changes_keys_and_replaces_what_is_of_another_kind(table, changes, both) -> None:
    assert merged(table, changes) == both


def test_names_that_users_give_are_of_no_kind() -> None:
    """Boundaries called displacement and pressure, bodies called ring and circle, a grid cell: none is lost."""
    import typing

    table = {
        "boundary": {
            "displacement": {"on": "ring.left", "displacement": {"x": 0}},
            "file": {"pressure": 1.0},
        },
        "body": {"ring": {"material": "value"}, "kind": {"material": "times_E"}},
        "grid": {"cell": {"kind": "cartesian", "cell": 0.1}},
        "output": {"profile": {"circle": {"quantity": "J"}}},
    }
    changes = {
        "boundary": {"pressure": {"on": "ring.top", "pressure": 1.0}},
        "body": {"circle": {"material": "value"}, "kind": {"material": "value"}},
        "grid": {"counts": {"kind": "polar"}},
        "output": {"profile": {"ring": {"quantity": "J"}}},
    }
    both = merged(table, changes)
    assert {path: [*both[path]] for path in table} == {
        "boundary": ["displacement", "file", "pressure"],
        "body": ["ring", "kind", "circle"],
        "grid": ["cell", "counts"],
        "output": ["profile"],
    }
    assert [*both["output"]["profile"]] == ["circle", "ring"] and both["body"]["kind"] == {
        "material": "value"
    }
    hints = typing.get_type_hints(Case) | {f"output.{k}": v for k, v in typing.get_type_hints(Output).items()}
    named = {name for name, hint in hints.items() if typing.get_origin(hint) is dict}
    assert {".".join(path) for path in NAMED} == named


def test_a_variant_can_have_another_obstacle() -> None:
    import tomllib

    table = tomllib.loads(CASE)
    wedge = {"polygon": {"points": [[0.0, 0.0], [-0.1, -0.1], [0.1, -0.1]]}}
    table["variant"] = {"wedge": {"rigid": {"pin": {"geometry": wedge}}}}
    geometry = variants(case_from_table(table))["wedge"].rigid["pin"].geometry
    assert geometry.circle is None and geometry.polygon is not None


def test_check_tells_of_variants_and_run_prepares_them_before_a_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("case.toml").write_text(CASE + "[variant.fine.body.slab.grid]\ncell = 0.025\n")
    assert cli.app(["check", "case.toml"], result_action="return_value") == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith(("variant", "fine"))]
    assert len(lines) == 2 and "about 1 s" in lines[1]
    Path("case.toml").write_text(CASE + "[variant.deep.rigid.pin.geometry.circle]\ncentre = [0.0, -0.05]\n")
    for command in (["check", "case.toml"], ["run", "case.toml", "--out", "out"]):
        assert cli.app(command, result_action="return_value") == 2
        assert "variant.deep: contact.c: slab.outer and pin overlap" in capsys.readouterr().err
    assert not Path("out").exists()
