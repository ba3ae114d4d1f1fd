"""Velocities of the fixes that are older than their positions: emulated, taken off, recognized, and settled beside a large time offset."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.trial.drives import stage
from insemu import earth
from insemu.effects import EffectUse, FixGeometry, Motion, compensated
from insemu.emulate import built_in, gnss_fixes, ideal_imu
from insemu.gap import find_gap
from insemu.gap.candidates.timing import find_times
from insemu.gap.drive.preparation import Flown
from insemu.gap.worth import worth_of_early
from insemu.records import GnssRecord, Recording


def use(**values: object) -> EffectUse:
    return EffectUse.from_mapping({"effect": "gnss_velocity_lag", **values})


@pytest.fixture(scope="module")
def ideal():
    made = ideal_imu(built_in("lemniscate"), 50.0, span=(0.0, 120.0), mode="continuous")
    return made.imu, made.reference


def fixes(reference, *effects: EffectUse) -> GnssRecord:
    return gnss_fixes(reference, 4.0, 0.0, 0.0, rng=np.random.default_rng(1), effects=effects)


def test_a_lag_is_the_velocity_of_an_earlier_time(ideal) -> None:
    reference = ideal[1]
    plain, late = fixes(reference), fixes(reference, use(lag="250 ms"))
    np.testing.assert_array_equal(plain.llh, late.llh)
    # a quarter of a second late at 4 Hz: the velocity of the fix before
    np.testing.assert_allclose(late.vel_ned[1:], plain.vel_ned[:-1], atol=1e-9)
    assert np.abs(late.vel_ned - plain.vel_ned).max() > 0.05


def test_a_mean_over_the_time_before_the_stamp_is_the_difference_of_positions(ideal) -> None:
    reference = ideal[1]
    plain, mean = fixes(reference), fixes(reference, use(lag="125 ms", window="250 ms"))
    way = earth.position_difference(plain.llh[1:], plain.llh[:-1]) / 0.25
    np.testing.assert_allclose(mean.vel_ned[1:], way, atol=1e-5)


def test_it_is_taken_off_by_stamps_of_its_own(ideal) -> None:
    imu, reference = ideal
    it = use(lag="100 ms")
    back = compensated(Recording(imu, fixes(reference, it)), [it]).gnss
    position, velocity = np.isfinite(back.llh).all(axis=1), np.isfinite(back.vel_ned).all(axis=1)
    assert not (position & velocity).any()
    plain = fixes(reference)
    np.testing.assert_array_equal(back.llh[position], plain.llh)
    np.testing.assert_array_equal(back.t[position], plain.t)
    np.testing.assert_allclose(back.t[velocity], plain.t - 0.1, atol=1e-12)
    # what is stamped with its own time is what the vehicle did then
    k = np.searchsorted(reference.t, back.t[velocity][3:] - 1e-6)
    expected = reference.vel_ned[k]
    assert np.abs(back.vel_ned[velocity][3:] - expected).max() < 2e-2
    assert np.abs(plain.vel_ned[3:] - expected).max() > 5e-2
    # a whole period late: rows fall together again
    whole = compensated(Recording(imu, fixes(reference, use(lag="250 ms"))), [use(lag="250 ms")]).gnss
    assert len(whole) == len(plain) + 1
    no_velocity = Recording(imu, plain.without_velocity())
    assert compensated(no_velocity, [it]).gnss is no_velocity.gnss


@pytest.fixture(scope="module")
def drive():
    """Four minutes by car, fixes with velocities."""
    return stage(61, 4.0, 50.0, track="car")


def recorded(drive, offset: float, lag: float) -> Recording:
    late = EffectUse.from_mapping({"effect": "imu_gnss_time_offset", "offset": offset})
    return drive.record(tuple(([late] if offset else []) + ([use(lag=lag)] if lag else [])))


@pytest.mark.slow(reason="a whole search behind two faults of time")
def test_both_faults_of_time_are_settled_before_the_search(drive) -> None:
    first = Flown.of(recorded(drive, 0.25, 0.3), drive.nominal)
    offset, lag = find_times(first)
    assert (offset.effect, lag.effect) == ("imu_gnss_time_offset", "gnss_velocity_lag")
    assert offset.parameters[0].value == pytest.approx(0.25, abs=0.02)
    assert lag.parameters[0].value == pytest.approx(0.3, abs=0.03)
    assert worth_of_early(first.prepared, lag) > 0.1
    assert find_times(first, ("imu_gnss_time_offset",)) == []
    assert [f.effect for f in find_times(first, ("gnss_velocity_lag",))] in ([], ["imu_gnss_time_offset"])
    alone = find_times(Flown.of(recorded(drive, 0.25, 0.0), drive.nominal))
    assert [f.effect for f in alone] == ["imu_gnss_time_offset"]


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
def test_a_small_lag_is_named_by_its_signature(drive) -> None:
    report = find_gap(
        recorded(drive, 0.0, 0.15), drive.nominal, rng=np.random.default_rng(1), hold_out=False, pictures=False
    )
    assert report.findings[0].effect == "gnss_velocity_lag"
    assert report.verdict == "named"
    (lag,) = report.findings[0].parameters
    assert lag.low - 0.02 < 0.15 < lag.high + 0.02


def test_an_antenna_that_swings_between_fixes_is_ahead_by_its_own_acceleration() -> None:
    """Yaw to and fro at 2.3 Hz under fixes at 1 Hz: a difference from fix to fix would alias, here the derivative of the swing is known."""
    dt, amplitude, w = 0.01, 0.1, 2.0 * np.pi * 2.3
    t = np.arange(0.0, 30.0, dt)
    yaw, rate = amplitude * np.sin(w * t), amplitude * w * np.cos(w * (t - 0.5 * dt))
    zero, rates = np.zeros((t.size, 3)), np.column_stack([np.zeros(t.size), np.zeros(t.size), rate])
    C = np.array([[[np.cos(a), -np.sin(a), 0.0], [np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]] for a in yaw])
    # at the pole the rotation of the Earth is about the same axis; its 7e-5 rad/s are far below the swing
    llh = np.tile([np.pi / 2.0 - 1e-3, 0.0, 0.0], (t.size, 1))
    motion = Motion(t, C, rates, zero, zero, zero, llh, None, np.arange(2))
    at = t[300:2700:100]
    moved = FixGeometry.of(motion, at, [2.0, 0.0, 0.0]).change_per_second
    angle, turn, spin = (amplitude * f for f in (np.sin(w * at), w * np.cos(w * at), -(w**2) * np.sin(w * at)))
    along, across = np.column_stack([np.cos(angle), np.sin(angle)]), np.column_stack([-np.sin(angle), np.cos(angle)])
    swing = 2.0 * (spin[:, None] * across - turn[:, None] ** 2 * along)
    # gravity of a motion without forces is what is left of the acceleration
    fall = FixGeometry.of(motion, at, [0.0, 0.0, 0.0]).change_per_second[:, 3:5]
    np.testing.assert_allclose(moved[:, 3:5] - fall, swing, atol=0.1 * np.abs(swing).max())
