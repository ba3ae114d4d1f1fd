"""Errors under dynamics from a reference IMU: what was put on comes back, with the time offset, the mounting and the lever arm."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from insemu import scenario
from insemu.cli import main
from insemu.emulate import Mounting, built_in, difference, ideal_imu
from insemu.errors import InputError
from insemu.evaluate import Experiment
from insemu.formats import write
from insemu.noise import GM, WN
from insemu.records import ImuRecord, Recording
from insemu.stamps import SECOND, Origin

RPY = np.radians([4.0, -7.0, 31.0])
ARM = (0.4, -0.2, 0.3)
LATE = 0.0374
GYRO, ACCEL = WN(N=2e-4) + GM(sigma=1e-3, Tc=20.0), WN(N=2e-3) + GM(sigma=2e-2, Tc=30.0)


def pair(seconds: float = 300.0, **given: object) -> tuple[ImuRecord, ImuRecord, np.ndarray]:
    """A unit at 100 Hz and a reference at 200 Hz on one drive, and the unit's errors."""
    path = built_in("turbulent_uav")
    span = (0.0, seconds)
    mount = Mounting(ARM, tuple(RPY))
    unit = ideal_imu(path, 100.0, kind="mean", mounting=mount, span=span).imu
    better = ideal_imu(path, 200.0, kind="increment", span=span).imu
    rng = np.random.default_rng(8)
    errors = np.stack([m.simulate(len(unit), 0.01, rng) for m in (*[GYRO] * 3, *[ACCEL] * 3)], axis=1)
    errors += np.array([0.01, -0.02, 0.005, 0.1, 0.05, -0.2])
    unit = replace(unit.with_rates(unit.rates() + errors), t=unit.t + LATE)
    noise = np.sqrt(200.0) * rng.standard_normal((len(better), 6)) * np.repeat([1e-6, 2e-5], 3)
    return unit, better.with_rates(better.rates() + noise), errors


def test_the_errors_that_were_put_on_come_back() -> None:
    """Offset, mounting and lever arm within five of their standard deviations; what is left of the difference is below a tenth of the errors."""
    unit, better, errors = pair()
    found = difference(unit, better)
    angles = Mounting(ARM, tuple(found.rpy)).dcm() @ Mounting(ARM, tuple(RPY)).dcm().T
    turn = np.array([angles[2, 1], angles[0, 2], angles[1, 0]])
    missed = np.concatenate([[found.offset_s - LATE], turn, found.lever_arm - ARM])
    assert (
        np.abs(missed) < 5.0 * np.concatenate([found.sigma[:1], [found.sigma[1:4].max()] * 3, found.sigma[4:]])
    ).all()
    assert abs(missed[0]) < 1e-3 and np.abs(turn).max() < 2e-3 and np.abs(missed[4:]).max() < 0.02
    rows = np.searchsorted(unit.t, found.t - 1e-6)
    left = found.values - errors[rows]
    ratio = (left - left.mean(axis=0)).std(axis=0) / errors[rows].std(axis=0)
    assert ratio.max() < 0.1, ratio


def test_lost_samples_are_filled_in_and_said() -> None:
    """With 2 % of the unit's and 1 % of the reference's samples lost, what is found moves by less than its standard deviation."""
    unit, better, _ = pair()
    rng = np.random.default_rng(2)
    whole = difference(unit, better)
    keep = [rng.random(len(imu)) > share for imu, share in ((unit, 0.02), (better, 0.01))]
    for kept in keep:
        kept[[0, -1]] = True  # no stamp skips those
    found = difference(unit.rows(keep[0]), better.rows(keep[1]))
    assert found.values.shape == whole.values.shape
    assert abs(found.offset_s - whole.offset_s) < whole.sigma[0]
    assert (np.abs(found.lever_arm - whole.lever_arm) < whole.sigma[4:]).all()
    for said, name, kept in zip(found.said, ("unit", "reference"), keep, strict=True):
        assert said.startswith(
            f"{name}: {int((~kept).sum())} samples of the IMU are lost, where stamps skip them: they are filled in"
        )


def test_without_common_motion_or_turns_nothing_is_taken_for_errors() -> None:
    unit, better, _ = pair(100.0)
    with pytest.raises(InputError, match="turn rates of unit and reference correlate by"):
        difference(unit, better.with_rates(np.roll(better.rates(), 9000, axis=0)), search_s=2.0)
    still = ideal_imu(built_in("static"), 100.0, kind="mean", span=(0.0, 100.0)).imu
    rng = np.random.default_rng(1)
    one, two = (still.with_rates(still.rates() + 1e-3 * rng.standard_normal((len(still), 6))) for _ in range(2))
    with pytest.raises(InputError, match="correlate by"):
        difference(one, two)
    with pytest.raises(InputError, match=r"the unit has 1 gap\(s\), the first of 1\.01 s"):
        difference(unit.rows(np.r_[0:5000, 5100 : len(unit)].__array__()), better)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="have 20 s in common"):
        difference(unit, better.rows(slice(0, 4000 + round(200 * LATE))))


def test_a_scenario_takes_the_file_as_its_errors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    unit, better, errors = pair(200.0)
    late = unit.t >= 40.0  # the unit is switched on 40 s after the reference, on one clock
    for name, imu, start in (("unit", unit.rows(late), 40), ("reference", better, 0)):
        clock = Origin((1_764_400_000 + start) * SECOND, "unix")
        write(tmp_path / f"{name}.npz", Recording(replace(imu, t=imu.t - start), origin=clock))
    arguments = [
        "errors",
        str(tmp_path / "unit.npz"),
        str(tmp_path / "reference.npz"),
        "-o",
        str(tmp_path / "errors.npz"),
    ]
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 0
    assert "time offset 37." in capsys.readouterr().out
    (tmp_path / "s.yaml").write_text(
        """
title: errors under dynamics
seed: 1
realizations: 2
trajectory: {builtin: urban_drive_1, rate: 100 Hz, duration: 60 s}
truth: {recorded: {files: [errors.npz], remove_mean: piece}}
gnss: {rate: 1 Hz, position_sigma: 1 m, velocity_sigma: 0.1 m/s}
designs:
  white: {gyro: WN(N=2e-4 rad/s/sqrt(Hz)), accel: WN(N=2e-3 m/s^2/sqrt(Hz))}
"""
    )
    world = Experiment(scenario.load(tmp_path / "s.yaml"), tmp_path / "s.yaml").world
    piece = world.pieces.piece(1)[0][1:]
    want = errors[late][len(piece) : 2 * len(piece)]
    assert piece.shape == want.shape
    for axis in range(6):
        assert np.corrcoef(piece[:, axis], want[:, axis])[0, 1] > 0.99
