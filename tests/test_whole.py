"""Whole files and folders: what is read is the old or the new one, and what was refused leaves nothing."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from insemu import formats
from insemu.records import Recording
from insemu.whole import clear_partials, put, replacing, replacing_folder
from tests import file_samples


def test_a_failure_leaves_the_old_file_and_no_new_folder(tmp_path: Path) -> None:
    put(tmp_path / "there" / "a", "old")
    for target in (tmp_path / "there" / "a", tmp_path / "new" / "deep" / "a"):
        with pytest.raises(RuntimeError), replacing(target) as partial:
            partial.write_text("half")
            raise RuntimeError
    assert (tmp_path / "there" / "a").read_text() == "old"
    assert sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*")) == ["there", os.path.join("there", "a")]


def test_a_failure_leaves_the_old_folder(tmp_path: Path) -> None:
    for name in ("mark", "old.npy", "own.txt"):
        put(tmp_path / "out" / name, "old")
    with pytest.raises(RuntimeError), replacing_folder(tmp_path / "out", "mark", ("*.npy",)) as partial:
        (partial / "mark").write_text("half")
        raise RuntimeError
    assert {p.name: p.read_text() for p in (tmp_path / "out").iterdir()} == dict.fromkeys(
        ("mark", "old.npy", "own.txt"), "old"
    )
    with replacing_folder(tmp_path / "out", "mark", ("*.npy",)) as partial:
        (partial / "mark").write_text("new")
    assert {p.name: p.read_text() for p in (tmp_path / "out").iterdir()} == {"mark": "new", "own.txt": "old"}
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_the_current_folder_can_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    with replacing_folder(".", "mark") as partial:
        (partial / "mark").write_text("new")
    assert Path("mark").read_text() == "new"


@pytest.mark.parametrize("name", [".", "..", "/", "folder"])
def test_a_folder_is_not_replaced_by_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    with pytest.raises(IsADirectoryError, match="irectory"):
        put(name, "text")
    assert [p.name for p in tmp_path.rglob("*")] == ["folder"]


def test_files_of_an_earlier_recording_are_not_read_with_the_new_one(tmp_path: Path) -> None:
    drive = file_samples.drive(20.0)
    assert drive.gnss is not None and drive.reference is not None
    formats.write(tmp_path / "rec", drive)
    put(tmp_path / "rec" / "notes.txt", "own")
    formats.write(tmp_path / "rec", replace(drive, reference=None, initial=None, aids=()))
    found = formats.read(tmp_path / "rec")
    assert isinstance(found, Recording)
    assert found.reference is None and found.initial is None
    np.testing.assert_array_equal(found.imu.gyro, drive.imu.gyro)
    assert (tmp_path / "rec" / "notes.txt").read_text() == "own"


def test_what_a_killed_writer_left_is_cleared(tmp_path: Path) -> None:
    put(tmp_path / ".a.csv.123.partial.csv", "half")
    put(tmp_path / "rec" / ".b.7.partial" / "imu.csv", "half")
    put(tmp_path / "rec" / ".partial.notes", "own")
    clear_partials(tmp_path)
    assert [p.name for p in (tmp_path / "rec").iterdir()] == [".partial.notes"]
    assert [p.name for p in tmp_path.iterdir()] == ["rec"]
