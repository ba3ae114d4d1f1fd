"""The gap of a drive or flight: signatures against the whole filter, evidence against dense algebra, naming end to end."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

from insemu.effects import EffectUse
from insemu.emulate import built_in, corrupt, gnss_fixes, ideal_imu
from insemu.errors import InputError
from insemu.filters import FilterOptions, FilterResult, InitialSigma, run_filter
from insemu.gap import Nominal, find_gap
from insemu.gap.innovations import Field, gauss_markov_root, random_walk_root
from insemu.gap.signatures import Loop, Motion, columns_response, deterministic_columns, fix_columns, knot_response
from insemu.gap.surrogate import Surrogate
from insemu.noise import RW, WN, NoiseModel
from insemu.records import AXES, GnssRecord, ImuRecord, Recording, Trajectory
from insemu.scenario import Gnss, Initial

BELIEF = {a: NoiseModel((WN(1e-4), RW(1e-6)) if a.startswith("gyro") else (WN(1e-3), RW(1e-5))) for a in AXES}
LEVER = (0.5, 0.1, -1.0)
DURATION = 240.0


@functools.cache
def ideal() -> tuple[ImuRecord, Trajectory]:
    made = ideal_imu(built_in("lemniscate"), 100.0, span=(0.0, DURATION))
    return made.imu, made.reference


def recording(*effects: EffectUse, seed: int = 3) -> Recording:
    imu, reference = ideal()
    one, two = np.random.default_rng(seed).spawn(2)
    temperature = 25.0 + 10.0 * np.sin(imu.t / DURATION * 5.0)
    made = corrupt(imu, BELIEF, one, effects=effects, reference=reference, temperature=temperature).imu
    fixes = gnss_fixes(reference, 1.0, (0.05, 0.05, 0.1), (0.05, 0.05, 0.05), LEVER, rng=two, effects=effects)
    return Recording(made, fixes, reference)


def flown(r: Recording) -> FilterResult:
    assert r.gnss is not None
    assert r.reference is not None
    sigma = InitialSigma(0.1, 0.05, (0.005, 0.005, 0.01))
    return run_filter(
        r.imu,
        r.gnss,
        r.reference,
        sigma,
        BELIEF,
        lever_arm=LEVER,
        options=FilterOptions(store="fixes", node_every=10.0),
    )


def use(**mapping: object) -> EffectUse:
    return EffectUse.from_mapping(mapping)


@functools.cache
def nominal_run() -> tuple[FilterResult, Motion, Loop]:
    r = recording()
    result = flown(r)
    return result, Motion.of(r.imu, result), Loop.of(result)


SIGNATURES = {
    "gyro scale": (use(effect="scale_factor", sensor="gyro", value=[0, 0, 1e-3]), "value_z", 1e-3),
    "accelerometer scale": (use(effect="scale_factor", sensor="accel", value=[1e-3, 0, 0]), "value_x", 1e-3),
    "misalignment": (use(effect="misalignment", sensor="accel", value=[0, 0, 1e-3, 0, 0, 0]), "value_yx", 1e-3),
    "temperature": (use(effect="temperature", sensor="accel", c1=[0, 1e-4, 0]), "c1_y", 1e-4),
    "lever arm": (use(effect="lever_arm", value=[0.05, 0, 0]), "value_x", 0.05),
    "Earth rate": (use(effect="earth_rate", fraction=1.0), "fraction", 1.0),
    "gravity": (use(effect="gravity", offset=1e-3), "offset", 1e-3),
}


@pytest.mark.parametrize("name", SIGNATURES)
def test_a_signature_is_the_finite_difference_of_the_whole_filter(name: str) -> None:
    effect, label, value = SIGNATURES[name]
    result, motion, loop = nominal_run()
    columns = deterministic_columns(motion) + fix_columns(motion, result.fixes.t, np.array(LEVER))
    j = next(i for i, c in enumerate(columns) if (c.effect, c.sensor, c.label) == (effect.id, effect.sensor, label))
    G, _ = columns_response(loop, motion, [columns[j]])
    changed = flown(recording(effect))
    difference = np.einsum(
        "kij,kj->ki", loop.white, np.nan_to_num(changed.fixes.innovation - result.fixes.innovation)
    ).ravel()
    predicted = loop.whiten(G)[:, 0] * value
    assert np.corrcoef(difference, predicted)[0, 1] > 0.998
    assert (difference @ predicted) / (predicted @ predicted) == pytest.approx(1.0, abs=0.01)


def test_knots_of_a_constant_are_the_constant() -> None:
    _, motion, loop = nominal_run()
    columns = [c for c in deterministic_columns(motion) if c.effect == "turn_on_bias"]
    G, ramp = columns_response(loop, motion, columns)
    knots = np.linspace(motion.t[0], motion.t[-1], 7)
    slow = knot_response(loop, motion, ramp, knots)
    for axis in range(6):
        np.testing.assert_allclose(
            slow[:, :, 7 * axis : 7 * axis + 7].sum(axis=2),
            G[:, :, axis],
            rtol=1e-9,
            atol=1e-9 * np.abs(G[:, :, axis]).max(),
        )


def test_surrogate_with_the_nominal_noise_is_the_nominal_likelihood() -> None:
    result, _, loop = nominal_run()
    expected = -0.5 * float(loop.y @ loop.y)
    for k in range(len(result.fixes)):
        expected -= 0.5 * float(np.linalg.slogdet(result.fixes.S[k])[1])
    s = Surrogate.of(result)
    # the noise of the gyros on the lever arm correlates the components of a velocity fix by a thousandth; the surrogate leaves that out
    assert s.log_likelihood() == pytest.approx(expected, abs=0.05)
    assert s.log_likelihood(np.full(6, 3.0)) < s.log_likelihood() - 50.0


def test_log_factor_is_the_ratio_of_dense_gaussians() -> None:
    rng = np.random.default_rng(1)
    G, y = rng.standard_normal((40, 5)), rng.standard_normal(40)
    data = Field(y, G)
    root = rng.standard_normal((3, 2))
    other = np.diag([0.3, 2.0])
    C = np.eye(40) + G[:, :3] @ root @ root.T @ G[:, :3].T + G[:, 3:] @ other @ other.T @ G[:, 3:].T
    expected = -0.5 * np.linalg.slogdet(C)[1] - 0.5 * y @ np.linalg.solve(C, y) + 0.5 * y @ y
    got = data.log_factor([(np.arange(3), root), (np.array([3, 4]), other)])
    assert got == pytest.approx(expected, rel=1e-10)


def test_roots_have_the_covariance_of_their_process() -> None:
    t = np.array([0.0, 10.0, 30.0, 60.0])
    R = random_walk_root(t)
    np.testing.assert_allclose(R @ R.T, np.minimum(t[:, None], t[None, :]))
    M = gauss_markov_root(t, 20.0)
    np.testing.assert_allclose(M @ M.T, np.exp(-np.abs(t[:, None] - t[None, :]) / 20.0), atol=1e-8)


def believed(rng: np.random.Generator) -> Nominal:
    wrong = {
        a: NoiseModel(
            tuple(p.with_parameters({n: v * rng.uniform(0.85, 1.17) for n, v in p.parameters.items()}) for p in m)
        )
        for a, m in BELIEF.items()
    }
    gnss = Gnss(position_sigma=(0.05, 0.05, 0.1), velocity_sigma=(0.05,) * 3, lever_arm=LEVER)
    return Nominal(
        wrong,
        gnss,
        Initial(position_sigma=(0.1,) * 3, velocity_sigma=(0.05,) * 3, tilt_sigma=0.005, heading_sigma=0.01),
    )


def test_a_nominal_flight_lacks_nothing() -> None:
    report = find_gap(recording(seed=4), believed(np.random.default_rng(4)), rng=np.random.default_rng(1))
    assert report.verdict == "nothing missing", report.steps
    assert report.gap_before.low < 1.0 < report.gap_before.high


def test_a_wrong_lever_arm_is_named_and_the_gap_closes() -> None:
    report = find_gap(
        recording(use(effect="lever_arm", value=[0.3, 0, 0]), seed=5),
        believed(np.random.default_rng(5)),
        rng=np.random.default_rng(1),
    )
    assert report.steps[0].effect == "lever_arm"
    assert report.steps[0].sensor == "gnss"
    x = next(p for p in report.steps[0].parameters if p.name == "value_x")
    assert x.low < 0.3 < x.high
    assert report.held_out.value > 0.05
    assert abs(report.gap_after.value - 1.0) < abs(report.gap_before.value - 1.0)
    assert math.isfinite(report.to_json()["gap_index"]["after"]["value"])


def test_a_recording_that_cannot_be_started_says_why() -> None:
    r = recording()
    assert r.gnss is not None
    still = GnssRecord(r.gnss.t, r.gnss.llh, np.zeros((len(r.gnss), 3)), r.gnss.pos_std_ned, r.gnss.vel_std_ned)
    with pytest.raises(InputError, match="never moves faster than"):
        find_gap(Recording(r.imu, still), believed(np.random.default_rng(1)), rng=np.random.default_rng(1))
    with pytest.raises(InputError, match="no noise model is believed for accel_x"):
        find_gap(r, Nominal({a: BELIEF[a] for a in AXES[:3]}), rng=np.random.default_rng(1))
