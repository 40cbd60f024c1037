"""The files of a case are read at the same time, each once, and nothing is left reading."""

from __future__ import annotations

import errno
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import ezdxf
import pytest

from phantomnode.geometry import child
from phantomnode.geometry.readers import geometry_reading
from phantomnode.pipeline import drawings
from phantomnode.pipeline.case import Case, case_from_table
from phantomnode.pipeline.drawings import Drawings
from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.prepare import prepare


class Watched(child.Child):
    """A child that is counted, and seen to end."""

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
        assert self._process.poll() is not None and not Path(self._folder.name).exists()
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
    tmp_path: Path, watched: type[Watched], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drawings, "AT_ONCE", 4)
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


def test_a_file_that_is_asked_for_late_is_not_taken_for_slow(tmp_path: Path) -> None:
    circle(tmp_path / "0.dxf")
    with geometry_reading(tmp_path / "0.dxf", time_limit=2.0) as reading:
        time.sleep(2.5)  # as long as the bodies before it take to cut
        assert reading.result().regions


def test_what_keeps_a_process_from_starting_is_told_with_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def started(*_: object) -> None:
        raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    circle(tmp_path / "0.dxf")
    monkeypatch.setattr(child, "_started", started)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    with pytest.raises(
        CaseError, match=r"body\.b0\.geometry: .*0\.dxf: no process can be started to read it"
    ):
        prepare(case_of(tmp_path, "0.dxf"))
    assert not [*(tmp_path / "temporary").iterdir()]


def test_a_time_limit_without_a_file_is_refused(tmp_path: Path) -> None:
    circle(tmp_path / "0.dxf")
    with pytest.raises(CaseError, match="time_limit belongs to a file"):
        changed = {"circle": {"centre": [0.0, 0.0], "radius": 1.0}, "time_limit": 3.0}
        table = case_of(tmp_path, "0.dxf").model_dump(mode="json", exclude_unset=True)
        table["body"]["b0"]["geometry"] = changed
        case_from_table(table, tmp_path)
