"""Positions that a receiver filters: emulated, undone, recognized at any time constant."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.foreign import judge
from benchmarks.foreign.judge import drawn, taken
from benchmarks.trial.drives import stage
from insemu import earth
from insemu.effects import EFFECTS, Column, EffectUse, FixGeometry, compensated, steady
from insemu.effects.motion import acceleration_along
from insemu.emulate import built_in, gnss_fixes, ideal_imu
from insemu.errors import InputError
from insemu.gap import find_gap
from insemu.gap.beliefs.refined import refined_nominal
from insemu.gap.drive.preparation import Flown
from insemu.gap.drive.signatures import Loop, columns_response
from insemu.records import GnssRecord, Recording

ARM = (1.2, -0.3, 0.8)


def use(*tau: float) -> EffectUse:
    return EffectUse.from_mapping({"effect": "gnss_position_filter", "tau": list(tau)})


@pytest.fixture(scope="module")
def ideal():
    made = ideal_imu(built_in("lemniscate"), 50.0, span=(0.0, 120.0), mode="continuous")
    return made.imu, made.reference


def fixes(reference, *effects: EffectUse) -> GnssRecord:
    return gnss_fixes(reference, 4.0, 0.0, 0.0, ARM, rng=np.random.default_rng(1), effects=effects)


def behind(reference, *tau: float) -> tuple[GnssRecord, np.ndarray]:
    plain, tracked = fixes(reference), fixes(reference, use(*tau))
    np.testing.assert_array_equal(plain.vel_ned, tracked.vel_ned)
    return plain, earth.position_difference(plain.llh, tracked.llh)


def test_a_tracker_is_behind_by_the_acceleration(ideal) -> None:
    """A short one by its time constant squared times the acceleration (Kalata 1984), and not at all where the velocity stays."""
    plain, moved = behind(ideal[1], 0.2, 0.0, 0.0)
    assert np.abs(moved[:, 1:]).max() < 1e-6
    expected = 0.2**2 * np.gradient(plain.vel_ned[:, 0], plain.t)
    assert np.abs(expected).max() > 0.01
    late = np.interp(plain.t - 2.0 * 0.2, plain.t, expected)  # two low-passes
    np.testing.assert_allclose(moved[4:-2, 0], late[4:-2], atol=0.05 * np.abs(expected).max())


def test_a_tracker_step_by_step_gives_the_same(ideal) -> None:
    """Position and velocity of its own, both corrected by the error of its prediction."""
    reference, tau, step = ideal[1], 0.8, 0.002
    plain, moved = behind(reference, 0.0, tau, 0.0)
    fine = np.arange(reference.t[0], reference.t[-1], step)
    way = gnss_fixes(reference, 50.0, 0.0, 0.0, ARM, rng=np.random.default_rng(1))
    east = np.interp(fine, way.t, earth.position_difference(way.llh, way.llh[:1])[:, 1])
    state, speed, out = east[0], way.vel_ned[0, 1], np.empty_like(east)
    for k, true in enumerate(east):
        state += speed * step
        error = true - state
        state, speed = state + 2.0 * step / tau * error, speed + step / tau**2 * error
        out[k] = state
    expected = np.interp(plain.t, fine, east - out)
    rested = plain.t > 10.0 * tau
    np.testing.assert_allclose(moved[rested, 1], expected[rested], atol=0.02 * np.abs(expected).max())


def test_it_is_taken_off_along_the_accelerations(ideal) -> None:
    imu, reference = ideal
    it = use(0.8, 1.6, 0.3)
    plain, tracked = fixes(reference), fixes(reference, it)
    back = compensated(Recording(imu, tracked), [it], trajectory=reference, lever_arm=ARM).gnss
    before, after = (np.abs(earth.position_difference(plain.llh, g.llh))[8:-2].max() for g in (tracked, back))
    assert before > 0.5 and after < 0.03 * before
    with pytest.raises(InputError, match="gnss_position_filter"):
        compensated(Recording(imu, tracked), [it])


@pytest.mark.parametrize("tau", [0.2, 1.5])
def test_its_signature_is_the_finite_difference_of_the_whole_filter(tau) -> None:
    drive = stage(61, 4.0, 50.0, track="uav")
    prepared = Flown.of(drive.record(), drive.nominal).prepared
    loop, motion = Loop.of(prepared.result), prepared.motion
    at = FixGeometry.of(motion, prepared.result.fixes.t, prepared.lever_arm)
    effect = EFFECTS["gnss_position_filter"]
    columns = effect.columns(motion, at)
    assert {c.axes for c in columns} == {("north", "east"), ("down",)}
    column = effect.about(columns[0], tau**2, motion, at)
    changed = prepared.again(gnss=drive.record((use(tau, tau, 0.0),)).gnss).result.fixes
    moved = np.nan_to_num(changed.innovation - prepared.result.fixes.innovation)
    there = np.arange(len(moved)) > 10.0 * tau / np.median(np.diff(at.t))  # behind the start of the tracker
    difference = np.einsum("kij,kj->ki", loop.white, moved)[there].ravel()
    predicted = tau**2 * loop.whiten(columns_response(loop, motion, [column])).reshape(len(moved), 6)[there].ravel()
    assert np.corrcoef(difference, predicted)[0, 1] > 0.98
    assert (difference @ predicted) / (predicted @ predicted) == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow(reason="a whole search on a drive of another simulator")
def test_filtered_positions_of_another_simulator_are_named_with_their_time_constant() -> None:
    world, (hidden,), _ = drawn(judge.Job("rarer", 20, 240.0, True))
    assert hidden.effect == "gnss_position_filter"
    measured, nominal = taken(world, (hidden,))
    report = find_gap(measured, nominal, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    first = report.findings[0]
    assert (first.effect, first.axes) == ("gnss_position_filter", ("north", "east"))
    (value,) = first.parameters
    assert value.low < hidden.values["value"] < value.high and first.metres > 0.1
    known = refined_nominal(nominal, report, measured.imu.dt).parted()
    again = find_gap(measured, known, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    assert again.verdict == "nothing missing"


def test_the_drift_of_an_acceleration_does_not_begin_with_one_sample() -> None:
    """Its first sample, noise included, stood for 20 s."""
    t = np.arange(6000) * 0.01
    acceleration = np.random.default_rng(1).standard_normal((t.size, 3))
    acceleration[0] = 8.0
    vel = np.cumsum(acceleration, axis=0) * 0.01  # as measured: nothing drifts
    along = acceleration_along(t, acceleration, vel)
    np.testing.assert_allclose(along[100:], steady(acceleration, 0.01)[100:], atol=1e-9)


@pytest.mark.parametrize(
    ("coefficient", "sd", "value", "of_value"), [(0.09, 0.006, 0.3, 0.01), (-0.01, 0.04, 0.0, 0.1)]
)
def test_a_coefficient_of_a_power_is_told_as_its_parameter(coefficient, sd, value, of_value) -> None:
    column = Column.of(EFFECTS["gnss_position_filter"], "gnss", "tau", ()).raised(2.0)
    assert column.scale == pytest.approx(0.2**2)
    assert column.parameter(coefficient, sd) == pytest.approx((value, of_value))
