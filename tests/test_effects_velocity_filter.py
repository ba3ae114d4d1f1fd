"""Velocities that the receiver smooths: emulated, undone, recognized at any time constant, and not taken for an error of a sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.trial.drives import stage
from insemu.effects import EFFECTS, EffectUse, FixGeometry, compensated
from insemu.effects.motion import behind_low_pass
from insemu.emulate import built_in, gnss_fixes, ideal_imu
from insemu.errors import InputError
from insemu.gap import find_gap
from insemu.gap.beliefs.refined import refined_nominal
from insemu.gap.drive.preparation import Flown, Prepared
from insemu.gap.drive.scene import Scene
from insemu.gap.drive.signatures import Loop, columns_response
from insemu.gap.evidence.surrogate import Surrogate
from insemu.gap.problems import drive_without
from insemu.records import GnssRecord, Recording


def use(*tau: float) -> EffectUse:
    return EffectUse.from_mapping({"effect": "gnss_velocity_filter", "tau": list(tau)})


@pytest.fixture(scope="module")
def ideal():
    made = ideal_imu(built_in("lemniscate"), 50.0, span=(0.0, 120.0), mode="continuous")
    return made.imu, made.reference


ARM = (1.2, -0.3, 0.8)


def fixes(reference, *effects: EffectUse) -> GnssRecord:
    return gnss_fixes(reference, 4.0, 0.0, 0.0, ARM, rng=np.random.default_rng(1), effects=effects)


@pytest.mark.parametrize(("tau", "f"), [(0.3, 0.5), (1.5, 0.1)])
def test_a_low_pass_of_first_order_is_damped_and_late_as_the_books_say(tau, f) -> None:
    t = np.arange(0.0, 60.0, 0.01)
    w = 2.0 * np.pi * f
    out = behind_low_pass(np.sin(w * t), 0.01, tau)
    gain, late = 1.0 / np.hypot(1.0, w * tau), np.arctan(w * tau) / w
    rested = t > 10.0 * tau
    np.testing.assert_allclose(out[rested], gain * np.sin(w * (t[rested] - late)), atol=1e-3)
    np.testing.assert_array_equal(behind_low_pass(t, 0.01, 0.0), t)


def test_a_component_alone_is_smoothed(ideal) -> None:
    reference = ideal[1]
    plain, slow = fixes(reference), fixes(reference, use(0.5, 0.0, 0.0))
    np.testing.assert_array_equal(plain.llh, slow.llh)
    np.testing.assert_array_equal(plain.vel_ned[:, 1:], slow.vel_ned[:, 1:])
    # what is behind a low-pass is behind by its slope times the time constant
    slope = np.gradient(slow.vel_ned[:, 0], slow.t)
    behind = (plain.vel_ned - slow.vel_ned)[:, 0]
    assert np.abs(behind).max() > 0.1
    np.testing.assert_allclose(behind[2:-2], 0.5 * slope[2:-2], atol=0.03 * np.abs(behind).max())


def test_it_is_taken_off_along_the_accelerations(ideal) -> None:
    imu, reference = ideal
    it = use(0.8, 1.6, 0.0)
    plain, slow = fixes(reference), fixes(reference, it)
    back = compensated(Recording(imu, slow), [it], trajectory=reference, lever_arm=ARM).gnss
    before, after = (np.abs(g.vel_ned - plain.vel_ned)[2:-2].max() for g in (slow, back))
    assert after < 0.02 * before
    # the antenna swings about the IMU
    bare = compensated(Recording(imu, slow), [it], trajectory=reference).gnss
    assert np.abs(bare.vel_ned - plain.vel_ned)[2:-2].max() > 0.05 * before
    none = Recording(imu, plain.without_velocity())
    assert compensated(none, [it], trajectory=reference, lever_arm=ARM).gnss is none.gnss
    with pytest.raises(InputError, match="gnss_velocity_filter"):
        compensated(Recording(imu, slow), [it])


def test_a_biased_accelerometer_moves_no_velocity(ideal) -> None:
    imu, reference = ideal
    it = use(0.0, 0.0, 2.0)
    slow = fixes(reference, it)
    biased = replace(imu, accel=imu.accel + np.array([0.0, 0.0, 0.05]) * imu.dt)
    plain, moved = (
        compensated(Recording(i, slow), [it], trajectory=reference, lever_arm=ARM).gnss for i in (imu, biased)
    )
    assert np.abs(moved.vel_ned - plain.vel_ned).max() < 0.1 * 0.05 * 2.0


def test_rows_without_a_velocity_stay_as_they_are(ideal) -> None:
    imu, reference = ideal
    it = use(0.8, 0.0, 0.0)
    slow = fixes(reference, it)
    every = replace(slow, vel_ned=np.where(np.arange(len(slow))[:, None] % 2, np.nan, slow.vel_ned))
    back = compensated(Recording(imu, every), [it], trajectory=reference, lever_arm=ARM).gnss
    assert np.isnan(back.vel_ned[1::2]).all() and np.isfinite(back.vel_ned[::2]).all()


@pytest.fixture(scope="module")
def drive():
    """Four minutes in the air, fixes with velocities: a car hardly climbs."""
    return stage(61, 4.0, 50.0, track="uav")


@pytest.mark.parametrize("tau", [0.1, 1.0])
def test_its_signature_is_the_finite_difference_of_the_whole_filter(drive, tau) -> None:
    prepared = Flown.of(drive.record(), drive.nominal).prepared
    loop, motion = Loop.of(prepared.result), prepared.motion
    fixes = FixGeometry.of(motion, prepared.result.fixes.t, prepared.lever_arm)
    effect = EFFECTS["gnss_velocity_filter"]
    column = effect.about(effect.columns(motion, fixes)[0], tau, motion, fixes)
    changed = prepared.again(gnss=drive.record((use(0.0, 0.0, tau),)).gnss).result.fixes
    moved = np.nan_to_num(changed.innovation - prepared.result.fixes.innovation)
    difference = np.einsum("kij,kj->ki", loop.white, moved).ravel()
    predicted = loop.whiten(columns_response(loop, motion, [column]))[:, 0] * tau
    assert np.corrcoef(difference, predicted)[0, 1] > 0.99
    assert (difference @ predicted) / (predicted @ predicted) == pytest.approx(1.0, abs=0.03)


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
@pytest.mark.parametrize("tau", [0.2, 1.5])
def test_smoothed_vertical_velocities_are_named_with_their_time_constant(drive, tau) -> None:
    recording = drive.record((use(0.0, 0.0, tau),))
    report = find_gap(recording, drive.nominal, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    first = report.findings[0]
    assert (first.effect, first.axes) == ("gnss_velocity_filter", ("down",))
    assert report.verdict == "named"
    (value,) = first.parameters
    assert value.low - 0.1 * tau < tau < value.high + 0.1 * tau
    known = refined_nominal(drive.nominal, report, recording.imu.dt)
    again = find_gap(recording, known, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    assert "gnss_velocity_filter" not in [f.effect for f in again.findings]
    assert again.verdict != "unexplained"


def test_stamps_move_only_what_the_receiver_made_of_a_smoothed_velocity(drive) -> None:
    """On a real drive a time offset of 11 ms was seen as 5.6: what the velocity is behind is put right along the IMU, and moves with its stamps."""
    smoothed, late = use(0.0, 0.0, 0.5), 0.02  # one sample
    offset = EffectUse.from_mapping({"effect": "imu_gnss_time_offset", "offset": late})
    known = replace(drive.nominal, effects=(smoothed,)).parted()
    still, moved = (
        Flown.of(*drive_without(drive.record((smoothed, *more)), known)).prepared for more in ((), (offset,))
    )
    # behind the start of the low-pass
    there = Surrogate.of(still.result).use[:, 5] == 1
    there[:60] = False
    difference = np.nan_to_num(moved.result.fixes.innovation - still.result.fixes.innovation)[there, 5]

    def predicted(prepared: Prepared) -> np.ndarray:
        scene = Scene.of(prepared)
        j = next(k for k, c in enumerate(scene.columns) if c.effect == "imu_gnss_time_offset")
        return late * columns_response(scene.loop, scene.motion, [scene.columns[j]])[there, 5, 0]

    own, whole = predicted(still), predicted(replace(still, nominal=drive.nominal))
    assert np.corrcoef(difference, own)[0, 1] > 0.95
    assert (difference @ own) / (own @ own) == pytest.approx(1.0, abs=0.05)
    assert (difference @ whole) / (whole @ whole) < 0.8
