from __future__ import annotations

import os

import pytest

from phantomnode.pipeline.files import reach_disk, write_atomically


def test_new_and_replaced(tmp_path):
    path = tmp_path / "a.txt"
    write_atomically(path, "first")
    write_atomically(path, "größer")
    assert path.read_text(encoding="utf-8") == "größer"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_bytes_as_they_are(tmp_path):
    path = tmp_path / "a.bin"
    write_atomically(path, bytes(range(256)))
    assert path.read_bytes() == bytes(range(256))


def test_failure_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    """A disk that fills up while the bytes are written."""
    path = tmp_path / "a.txt"
    write_atomically(path, "old")

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_atomically(path, "new")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_a_file_that_need_not_be_durable_waits_for_no_disk(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(os, "fsync", synced.append)
    write_atomically(tmp_path / "a.txt", "x", durable=False)
    assert (tmp_path / "a.txt").read_text() == "x" and not synced
    reach_disk(tmp_path / "a.txt")
    assert len(synced) == 2  # the file, and its name in the folder


def test_missing_folder_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_atomically(tmp_path / "no" / "a.txt", "x")


def test_readable_by_others_as_the_umask_says(tmp_path):
    before = os.umask(0o027)
    try:
        write_atomically(tmp_path / "a.txt", "x")
        assert os.umask(0o027) == 0o027
    finally:
        os.umask(before)
    assert (tmp_path / "a.txt").stat().st_mode & 0o777 == 0o640
