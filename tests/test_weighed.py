"""Readings of a recording weighed together: commands that are given make it right, what nothing makes right gets none."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from insemu import rotation
from insemu.formats import Opened, open_files, write
from insemu.formats.names import english
from insemu.intake import examine, receiver
from insemu.intake.explained import _carried
from insemu.records import GnssRecord, ImuRecord, Recording
from tests.wrong_recordings import flown

UAV = {"which": "turbulent_uav", "start": 30.0, "seconds": 150.0, "sigma": 0.05, "seed": 5}


def spoilt(folder: Path, change: Callable[[ImuRecord], ImuRecord]) -> tuple[Opened, Opened]:
    good = flown(**UAV)  # type: ignore[arg-type]
    assert good.imu is not None
    return good, open_files(write(folder / "a.npz", Recording(change(good.imu), good.gnss)))


@pytest.mark.parametrize(
    ("change", "settings"),
    [
        (lambda i: replace(i, gyro=i.gyro[:, [1, 0, 2]]), {"gyro_axes": "y x z"}),
        (lambda i: replace(i, accel=-i.accel), {"accel_axes": "-x -y -z"}),
        (lambda i: replace(i, accel=i.accel * [1.0, -1.0, 1.0]), {"accel_axes": "x -y z"}),
    ],
)
def test_the_command_that_is_given_makes_the_recording_right(
    tmp_path: Path, change: Callable[[ImuRecord], ImuRecord], settings: dict[str, str]
) -> None:
    good, wrong = spoilt(tmp_path, change)
    (line,) = [x for x in examine(wrong).of("wrong") if x.topic == "motion"]
    assert wrong.again is not None and line.mend == wrong.again.options(settings)
    mended = wrong.again.read(settings)
    assert not examine(mended).of("wrong")
    np.testing.assert_allclose(mended.imu.gyro, good.imu.gyro)  # type: ignore[union-attr]
    np.testing.assert_allclose(mended.imu.accel, good.imu.accel)  # type: ignore[union-attr]


def test_fixes_of_another_drive_get_no_command(tmp_path: Path) -> None:
    good, other = flown(**UAV), flown("urban_drive_2", start=20.0, seconds=150.0)  # type: ignore[arg-type]
    assert good.imu is not None and other.gnss is not None
    fixes = replace(other.gnss, t=other.gnss.t - other.gnss.t[0] + good.imu.t[0])
    card = examine(open_files(write(tmp_path / "a.npz", Recording(good.imu, fixes))))
    assert card.of("wrong") and not any(x.mend for x in card.of("wrong"))


def test_names_of_other_languages_are_known() -> None:
    assert english("Beschleunigung Z") == "acceleration Z" and english("acc_z") == "acc_z"


def test_a_binary_dataflash_log_is_read(tmp_path: Path) -> None:
    def form(kind: int, size: int, name: str, types: str, labels: str) -> bytes:
        return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, size, name.encode(), types.encode(), labels.encode())

    rows = [b"\xa3\x95\x82" + struct.pack("<QB6f", 10_000 * k, 0, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8) for k in range(20)]
    labels = "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"
    head = form(0x80, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns") + form(0x82, 36, "IMU", "QBffffff", labels)
    (tmp_path / "a.bin").write_bytes(head + b"".join(rows))
    found = open_files(tmp_path / "a.bin")
    assert found.imu is not None and len(found.imu) == 20
    np.testing.assert_allclose(found.imu.gyro[0], [0.1, 0.2, 0.3], rtol=1e-6)


def test_an_outage_is_no_jump_of_the_positions_and_a_jump_is() -> None:
    """A round trip of 60 s without fixes: velocities at both ends do not say where the vehicle is meanwhile."""
    t = np.concatenate([np.arange(0.0, 100.0), np.arange(160.0, 260.0)])
    angle = 0.05 * t
    north, east = 200.0 * np.sin(angle), 200.0 * (1.0 - np.cos(angle))
    llh = np.column_stack([0.8 + north / 6.38e6, 0.1 + east / (6.39e6 * np.cos(0.8)), np.zeros(t.size)])
    vel = np.column_stack([10.0 * np.cos(angle), 10.0 * np.sin(angle), np.zeros(t.size)])
    assert not any("jump" in line.text for line in receiver.steps(GnssRecord(t, llh, vel)))
    llh[150:, 0] += 190.0 / 6.38e6
    assert any("jump by 1" in line.text for line in receiver.steps(GnssRecord(t, llh, vel)))


def test_windows_are_carried_as_matrix_products_say() -> None:
    rng, h = np.random.default_rng(6), 0.05
    turns, forces = 0.3 * rng.standard_normal((4, 30, 3)), rng.standard_normal((4, 30, 3))
    V, bent, A, C = _carried(turns, forces, h)
    for w in range(4):
        v, b, a, c = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3)), np.eye(3)
        for k in range(30):
            middle = c @ (np.eye(3) + 0.5 * rotation.skew(turns[w, k]))
            moved, later = middle @ forces[w, k], a + h * middle
            v, b, a, c = (
                v + moved,
                b + rotation.skew(moved) @ (0.5 * (a + later)),
                later,
                c @ rotation.dcm_from_vector(turns[w, k]),
            )
        # sums of 30 products of a few units: some hundred eps
        for found, expected in zip((V, bent, A, C), (v, b, a, c), strict=True):
            np.testing.assert_allclose(found[w, -1], expected, atol=1e-12)
