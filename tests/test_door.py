"""One door: Python and the commands run the same intake and say the same."""

from __future__ import annotations

import json
import tarfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import insemu as ins
from insemu import formats
from insemu.cli import main
from insemu.errors import InputError
from insemu.records import Recording
from tests.file_samples import drive
from tests.shared_data import shared


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    return int(stop.value.code or 0)


def in_degrees(data: Recording) -> Recording:
    return replace(data, imu=replace(data.imu, gyro=np.degrees(data.imu.gyro)))


def emulated(tmp_path: Path) -> Path:
    return formats.write(tmp_path / "drive.npz", drive())


#: A log of ArduPilot, a text of Xsens, a table of Excel, rates where increments are usual (refused), and a sensor that is moved.
CASES = ("F01_ardupilot.log", "F05_xsens_mt.txt", "F10_excel_de.csv", "F08_kfgins_rates.txt", "F22_static_moved.csv")


@pytest.mark.parametrize("name", [*CASES, "emulated"])
def test_python_and_the_command_give_the_same_card(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if name == "emulated":
        path = emulated(tmp_path)
    else:
        with tarfile.open(shared(f"cases/{name}.tar.xz")) as archive:
            archive.extractall(tmp_path, filter="data")
        (path,) = (p for p in tmp_path.rglob(f"{name}*") if p.is_file())
    card = ins.examine(path)
    code = run("open", path, "--json")
    shown = capsys.readouterr()
    assert card.to_json() == json.loads(shown.out)
    assert bool(card.of("wrong")) == (code == 2)
    if code:
        with pytest.raises(InputError) as refused:
            ins.read(path)
        assert shown.err.strip().endswith(str(refused.value))
    elif isinstance(found := ins.read(path), Recording):
        assert found.remarks == card.remarks
        assert [str(x) for x in ins.examine(found).lines] == [str(x) for x in card.lines]


def test_rates_in_degrees_end_in_one_refusal_everywhere(tmp_path: Path) -> None:
    data = in_degrees(drive())
    path = formats.write(tmp_path / "degrees.npz", data)
    said = []
    for call in (
        lambda: ins.read(path),
        lambda: ins.solve(path),
        lambda: ins.solve(data),
        lambda: ins.find_gap({"gyro_x": ins.NoiseModel((ins.WN(N=1e-4),))}, path),
        lambda: ins.find_gap({"gyro_x": ins.NoiseModel((ins.WN(N=1e-4),))}, data),
        lambda: ins.fit(data, "WN()"),
        lambda: ins.select(path, "WN()"),
    ):
        with pytest.raises(InputError, match="the rates are in deg/s") as refused:
            call()
        said.append(refused.value.message.split("motion:")[1].split(". Mend")[0].split("; take")[0])
    assert len(set(said)) == 1, said


def test_a_recording_that_is_declared_right_is_taken(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = formats.write(tmp_path / "degrees.npz", in_degrees(drive()))
    assert run("open", path) == 2
    assert "contradictions=accepted" in capsys.readouterr().err
    assert run("open", path, "--map", "contradictions=accepted", "--save-map") == 0
    assert "accepted as declared" in capsys.readouterr().out
    found = ins.read(path)  # by the map beside it, and so does every command
    assert isinstance(found, Recording)
    assert any("accepted as declared" in text for text in found.remarks)
    assert not ins.examine(found).of("wrong")
    with pytest.raises(InputError, match="expected one of: accepted"):
        ins.read(path, map="contradictions=yes")


def test_what_intake_finds_is_said_once_by_what_uses_a_recording(tmp_path: Path) -> None:
    data = drive()
    assert data.gnss is not None
    plain = replace(data, gnss=replace(data.gnss, pos_std_ned=None, vel_std_ned=None))
    found = ins.read(formats.write(tmp_path / "plain.npz", plain))
    assert isinstance(found, Recording)
    assert any(text.startswith("sigma: ") for text in found.remarks)
    assert not any(text.startswith("sigma: ") for text in found.notes)  # the card says it again
