"""The files of a case are read at the same time, each once, and nothing is left reading."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import ezdxf
import pytest

from phantomnode.geometry import child
from phantomnode.pipeline import drawings
from phantomnode.pipeline.case import Case, case_from_table
from phantomnode.pipeline.drawings import Drawings
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.prepare import prepare


class Watched(child.Child):
    """A child that is counted."""

    begun = 0
    reading = 0
    most = 0

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        Watched.begun += 1
        Watched.reading += 1
        Watched.most = max(Watched.most, Watched.reading)

    def end(self) -> None:
        super().end()
        Watched.reading -= 1


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> type[Watched]:
    Watched.begun = Watched.reading = Watched.most = 0
    monkeypatch.setattr("phantomnode.geometry.readers.Child", Watched)
    return Watched


def circle(path: Path, radius: float = 10.0) -> None:
    document = ezdxf.new("R2010", units=4)
    document.modelspace().add_circle((0, 0), radius)
    document.saveas(path)


def case_of(folder: Path, *files: str) -> Case:
    """A body for each file, in a row."""
    grid = {"kind": "cartesian", "cell": 0.004}
    bodies = {
        f"b{k}": {"geometry": {"file": file, "move": [0.1 * k, 0.0]}, "grid": grid, "material": "steel"}
        for k, file in enumerate(files)
    }
    material = {"steel": {"E": 1e9, "nu": 0.3, "rho": 1e3}}
    return case_from_table({"time": {"end": 1.0}, "material": material, "body": bodies}, folder)


def test_all_files_are_read_at_the_same_time_and_one_that_two_bodies_share_once(
    tmp_path: Path, watched: type[Watched]
) -> None:
    for k in range(3):
        circle(tmp_path / f"{k}.dxf", 10.0 + k)
    prepared = prepare(case_of(tmp_path, "0.dxf", "1.dxf", "0.dxf", "2.dxf"))
    radii = [1e-2, 1.1e-2, 1e-2, 1.2e-2]
    for body, radius in zip(prepared.bodies, radii, strict=True):
        assert 0.5 * (body.regions[0].box[1] - body.regions[0].box[0]) == pytest.approx([radius] * 2)
    assert (watched.begun, watched.most, watched.reading) == (3, 3, 0)


def test_not_more_than_some_read_at_a_time(
    tmp_path: Path, watched: type[Watched], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drawings, "AT_ONCE", 2)
    for k in range(4):
        circle(tmp_path / f"{k}.dxf")
    assert len(prepare(case_of(tmp_path, *(f"{k}.dxf" for k in range(4)))).bodies) == 4
    assert (watched.begun, watched.most, watched.reading) == (4, 2, 0)


def test_a_file_that_fails_is_named_with_its_key_and_the_others_are_ended(
    tmp_path: Path, watched: type[Watched]
) -> None:
    circle(tmp_path / "0.dxf")
    circle(tmp_path / "2.dxf")
    (tmp_path / "1.dxf").write_text("0\nSECTION\n")
    with pytest.raises(CaseError, match=r"body\.b1\.geometry: .*1\.dxf: "):
        prepare(case_of(tmp_path, "0.dxf", "1.dxf", "2.dxf"))
    assert (watched.begun, watched.reading) == (3, 0)


def test_a_file_that_is_gone_when_it_is_asked_for_is_told_then(
    tmp_path: Path, watched: type[Watched]
) -> None:
    circle(tmp_path / "0.dxf")
    circle(tmp_path / "1.dxf")
    case = case_of(tmp_path, "0.dxf", "1.dxf")
    (tmp_path / "1.dxf").unlink()
    with Drawings(case) as files:
        files.read_ahead()
        assert files.geometry(case.body["b0"].geometry).regions
    with pytest.raises(CaseError, match=r"body\.b1\.geometry: .*1\.dxf: no such file"):
        prepare(case)
    assert watched.reading == 0
