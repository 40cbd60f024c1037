"""The hash of a case, and a run that can be repeated from its folder alone."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from phantomnode.pipeline.case import Case, case_from_table, load_case
from phantomnode.pipeline.provenance import case_hash, write_case
from phantomnode.pipeline.run import run
from phantomnode.pipeline.starter import write_starter


@pytest.fixture
def starter(tmp_path: Path) -> Path:
    """A case with a drawing."""
    return write_starter(tmp_path / "disc")


def test_labels_do_not_change_the_hash(starter: Path) -> None:
    first = case_hash(load_case(starter))
    assert case_hash(load_case(starter, ["title='other'", "name='other'"])) == first
    shutil.copytree(starter, starter.parent / "elsewhere")
    assert case_hash(load_case(starter.parent / "elsewhere")) == first


@pytest.mark.parametrize(
    "change", ["time.end=1e-3", "output.fields.count=7", "body.disc.initial_velocity=[0.0, -1.0]"]
)
def test_what_changes_the_outcome_changes_the_hash(starter: Path, change: str) -> None:
    assert case_hash(load_case(starter, [change])) != case_hash(load_case(starter))


def test_the_content_of_a_drawing_belongs_to_the_hash(starter: Path) -> None:
    first = case_hash(load_case(starter))
    drawing = starter / "disc.dxf"
    drawing.write_text(drawing.read_text() + "\n")
    assert case_hash(load_case(starter)) != first


def two_drawings(folder: Path) -> Case:
    """Two files of the same name in two folders; a variant takes the one for the other."""
    body = {"grid": {"kind": "cartesian", "cell": 0.1}, "material": "soft"}
    return case_from_table(
        {
            "time": {"end": 1.0},
            "material": {"soft": {"E": 1e6, "nu": 0.3, "rho": 1e3}},
            "body": {
                name: {"geometry": {"file": f"{name}/part.dxf", "unit": "mm"}, **body} for name in ("a", "b")
            },
            "variant": {
                "same": {"body": {"b": {"geometry": {"file": "a/part.dxf"}}}},
                "bad": {"method": "xfem"},
            },
        },
        folder,
    )


def test_files_of_one_name_are_both_kept(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "part.dxf").write_text(name)
    out = tmp_path / "out"
    out.mkdir()
    write_case(two_drawings(tmp_path), out)
    again = load_case(out)
    assert [body.geometry.file for body in again.body.values()] == ["part.dxf", "part-2.dxf"]
    assert [again.path(f"part{k}.dxf").read_text() for k in ("", "-2")] == ["a", "b"]
    assert again.variant["same"]["body"]["b"]["geometry"]["file"] == "part.dxf"
    assert case_hash(again) == case_hash(two_drawings(tmp_path))


def test_a_run_is_repeated_from_its_folder_alone(starter: Path, tmp_path: Path) -> None:
    few = ("time.end=2e-4", "output.fields.count=2")
    first = run(load_case(starter, few), tmp_path / "first", command=("phantomnode", "run"))
    shutil.rmtree(starter)
    moved = (tmp_path / "first").rename(tmp_path / "moved")
    again = run(load_case(moved), tmp_path / "again")
    for file in ("history.csv", "fields.pvd", "fields/fields_00002.vtu", "contact/contact_00001.vtu"):
        assert (moved / file).read_bytes() == (tmp_path / "again" / file).read_bytes()
    figures = json.loads((moved / "summary.json").read_text())
    assert figures["case_hash"] == again.figures["case_hash"] == first.figures["case_hash"]
    source = figures["provenance"]
    assert source["command"] == ["phantomnode", "run"] and source["threads"] == 1
    assert source["packages"]["numba"] and source["machine"]["cores"] >= 1
