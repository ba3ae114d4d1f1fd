"""Correlation times that follow a covariate: what is written, drawn, fitted and carried by the filter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from insemu import rotation
from insemu.augment import augment, true_states
from insemu.emulate import corrupt
from insemu.errors import InputError
from insemu.filters import InitialSigma, LooselyCoupledEKF
from insemu.filters.reference import reference_run
from insemu.fit import fit_following
from insemu.gap import find_static_gap
from insemu.noise import AR, AR1, GM, WN, Follows, NoiseModel, load, save
from insemu.noise.chain import sections, slower
from insemu.records import Series
from insemu.report.following import following_answer
from insemu.strapdown import NavState
from tests import filter_cases as cases
from tests.following_experiments import RATE, SLOPE, TEMPERATURE, TIMES, N, coverage, structure_of
from tests.test_following import a_drive

WARM = Follows("temperature", 0.05, 25.0, what="time")
PROCESSES = {
    "GM": GM(1e-3, 0.2, follows=WARM),
    "AR1": AR1(0.9, 1e-6, 10.0, follows=WARM),
    "negative AR1": AR1(-0.6, 1e-6, 10.0, follows=WARM),
    "AR(1)": AR((0.9,), sigma2=1e-6, rate_hz=10.0, follows=WARM),
    "pair": AR((1.5, -0.7), sigma2=1e-6, rate_hz=10.0, follows=WARM),
    "three": AR((2.4, -1.97, 0.56), sigma2=1e-6, rate_hz=10.0, follows=WARM),
}


@pytest.mark.parametrize("name", PROCESSES)
def test_text_and_files_hold_it(name, tmp_path):
    model = NoiseModel((PROCESSES[name],))
    assert NoiseModel.parse(str(model), "rad/s") == model
    save({"gyro_x": model}, tmp_path / "m.yaml")
    assert load(tmp_path / "m.yaml")["gyro_x"] == model
    assert model.to_list("rad/s")[0]["what"] == "time"


@pytest.mark.parametrize("name", PROCESSES)
@pytest.mark.parametrize("factor", [0.2, 1.0, 4.0])
def test_poles_forget_as_slowly_as_it_says(name, factor):
    p = PROCESSES[name]
    slow = p.slowed(factor)
    assert slow.follows is None
    before, after = (np.linalg.eigvals(q.block(0.1).Phi) for q in (replace(p, follows=None), slow))
    np.testing.assert_allclose(np.sort(np.log(np.abs(after))), np.sort(np.log(np.abs(before)) / factor), rtol=1e-6)
    np.testing.assert_allclose(np.sort(np.angle(after)), np.sort(np.angle(before)), atol=1e-6)
    # what the filter carries at this gain is the same process
    block, (Phi, drive, scale) = slow.carried(0.1), p.timed(np.array([factor]), 0.1)
    np.testing.assert_allclose(block.Phi, Phi[0], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(block.Q, scale[0] ** 2 * np.outer(drive, drive), rtol=1e-9)
    np.testing.assert_allclose(block.autocovariance(np.arange(50)), slow.autocovariance(np.arange(50), 0.1), rtol=1e-6)
    x = 25.0 + np.log(factor) / 0.05
    assert p.under({"temperature": x}) == p.slowed(float(WARM.gain(x)))


def test_what_drives_a_chain_does_not_move():
    poles = [0.5, 0.9, 0.8 + 0.3j, 0.8 - 0.3j]
    Phi, drive, c = sections(poles, np.array([0.5, 1.0, 3.0]))
    for k, factor in enumerate((0.5, 1.0, 3.0)):
        one, same_drive, same_c = sections(slower(poles, factor), np.ones(1))
        np.testing.assert_allclose(one[0], Phi[k], rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose([*same_drive, *same_c], [*drive, *c], rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("WN(N=1, follows=speed, what=time)", "no correlation times"),
        ("RW(K=1, follows=speed, what=time)", "expected GM, AR1 or AR"),
        ("MA(1, follows=speed, what=time)", "no correlation times"),
        ("GM(follows=speed, what=tine)", "did you mean 'time'"),
        ("GM(what=time)", "without 'follows'"),
    ],
)
def test_bad_laws_are_refused(text, says):
    with pytest.raises(InputError, match=says):
        NoiseModel.parse(text)


def test_a_gain_ends_at_four_hundred():
    np.testing.assert_allclose(WARM.gain([-1e9, 25.0, 1e9]), [np.exp(-6.0), 1.0, np.exp(6.0)])


@pytest.mark.parametrize("name", PROCESSES)
def test_draws_have_the_coefficients_of_their_time(name):
    p, n = PROCESSES[name], 200_000
    x = np.repeat([25.0, 45.0], n // 2)
    drawn = NoiseModel((p,)).simulate(n, 0.1, np.random.default_rng(1), {"temperature": x})
    for part, factor in ((drawn[: n // 2], 1.0), (drawn[n // 2 + 1000 :], np.exp(1.0))):
        slow = p.slowed(factor)
        lags = np.arange(2)
        expected = slow.autocovariance(lags, 0.1)
        found = np.array([np.mean(part[: part.size - k] * part[k:]) for k in lags])
        spread = np.sqrt(2.0 * np.sum(slow.autocovariance(np.arange(-5000, 5001), 0.1) ** 2) / part.size)
        assert np.all(np.abs(found - expected) < 4.5 * spread)
    whole = NoiseModel((p,)).simulate(300, 0.1, np.random.default_rng(2), {"temperature": np.full(300, 25.0)})
    assert np.isfinite(whole).all()


def test_the_state_goes_on_where_the_coefficient_changes():
    x = np.repeat([25.0, 145.0], 1000)  # for ever, nearly: the value at the change stays
    drawn = NoiseModel((GM(1.0, 0.01, follows=WARM),)).simulate(2000, 0.1, np.random.default_rng(3), {"temperature": x})
    assert np.ptp(drawn[1000:1100]) < 0.1 and abs(drawn[1000] - drawn[999]) < 0.1 < np.std(drawn)


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
@pytest.mark.parametrize("name", TIMES)
@pytest.mark.parametrize("slope", [SLOPE, 0.0])
def test_a_fit_finds_the_slope(name, slope):
    truth = NoiseModel.parse(TIMES[name].format(b=slope))
    x = truth.simulate(N, 1.0 / RATE, np.random.default_rng(5), {"temperature": TEMPERATURE})
    found = fit_following(
        Series(x, RATE, "rad/s", "gyro_x"), {"temperature": TEMPERATURE}, NoiseModel.parse(structure_of(truth))
    )
    (label,) = found.p_values
    e = found.result[f"{label}.slope"]
    assert abs(e.value - slope) < 0.75 * (e.high - e.low) < 0.01
    assert found.p_values[label] < 1e-12 if slope else found.p_values[label] > 0.01
    assert found.result.test.p_value > 1e-3
    np.testing.assert_allclose(found.result.fitted[:8], found.result.curve.value[:8], rtol=0.15)
    said = following_answer(found)[0]
    assert f"{label}.Tc changes by a factor of" in said
    assert ("it follows" if slope else "no sign") in said
    warm = max(found.segments, key=lambda s: s.covariate["temperature"])
    cold = min(found.segments, key=lambda s: s.covariate["temperature"])
    assert warm.low[label] < warm.level[label] < warm.high[label]
    if slope:
        assert warm.low[label] > cold.high[label]


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
@pytest.mark.parametrize("name", TIMES)
def test_intervals_hold_the_slope(name):
    # below 7 of 12 (9 of 12) once in 10,000 where intervals hold 95 %
    inside, rejected = coverage(TIMES[name], SLOPE, 12)
    assert min(inside.values()) >= 8 / 12 and rejected <= 4 / 12
    inside, _ = coverage(TIMES[name], 0.0, 12, seed=1802)
    assert min(v for k, v in inside.items() if k.endswith("slope")) >= 8 / 12


LAWS = {
    "gyro": NoiseModel.parse(
        "WN(N=5e-4, follows=speed, slope=1, law=power, at=10) + GM(sigma=3e-4, beta=0.05, follows=temperature, slope=0.05, at=25, what=time)"
    ),
    "accel": NoiseModel.parse(
        "WN(N=1e-3) + GM(sigma=5e-3, beta=0.02, follows=rate, slope=2, what=time) + AR(ar=[1.6, -0.65], sigma2=1e-6, follows=speed, slope=-0.1,"
        " at=10, what=time) + AR1(phi=0.9, sigma2=1e-6, follows=temperature, slope=-0.02, at=30)"
    ),
}


def test_the_compiled_filter_follows_as_the_reference_does():
    _, imu, gnss, start = a_drive(8.0)
    ekf = LooselyCoupledEKF(LAWS, cases.DT)
    a = ekf.run(imu, gnss, start, cases.START_SIGMA)
    b = reference_run(ekf, imu, gnss, start, cases.START_SIGMA)
    np.testing.assert_allclose(a.sigma, b.sigma, rtol=2e-4)  # linear between the nodes of a table
    np.testing.assert_allclose(a.nav[:, 3:6], b.nav[:, 3:6], atol=1e-6)
    plain = {axis: NoiseModel(tuple(replace(p, follows=None) for p in m)) for axis, m in LAWS.items()}
    other = LooselyCoupledEKF(plain, cases.DT).run(imu, gnss, start, cases.START_SIGMA)
    assert np.max(np.abs(other.sigma / a.sigma - 1.0)) > 0.5
    sparse = ekf.with_options(covariance_every=5, output_every=5).run(imu, gnss, start, cases.START_SIGMA)
    np.testing.assert_allclose(sparse.sigma[-1], a.sigma[-1], rtol=0.01)
    stored = ekf.with_options(store="fixes").run(imu, gnss, start, cases.START_SIGMA)
    np.testing.assert_allclose(stored.sigma[-1], a.sigma[-1], rtol=1e-12)


def test_a_constant_covariate_is_the_model_under_it():
    road = cases.drive(10.0)
    rng = np.random.default_rng(3)
    gnss, start = cases.fixes(road, rng), cases.start(road, rng)
    imu = replace(road.imu, temperature=np.full(len(road.imu), 45.0))
    law = dict.fromkeys(
        ("gyro", "accel"), WN(1e-3) + GM(1e-3, 0.1, follows=WARM) + AR((1.6, -0.65), sigma2=1e-6, follows=WARM)
    )
    under = {a: m.at_rate(1.0 / cases.DT).under({"temperature": 45.0}) for a, m in law.items()}
    a, b = (LooselyCoupledEKF(m, cases.DT).run(imu, gnss, start, cases.START_SIGMA) for m in (law, under))
    np.testing.assert_allclose(a.sigma, b.sigma, rtol=1e-4)


def test_a_filter_that_follows_knows_its_error():
    """Attitude after 20 s without fixes while the sensor warms by 40 K and its gyroscopes' correlation times grow: NEES per component."""
    road = cases.drive(20.0)
    t = road.imu.t
    imu = replace(road.imu, temperature=25.0 + 40.0 * (t - t[0]) / 20.0)
    gyro = GM(2e-3, 5.0, follows=replace(WARM, slope=0.08))
    truth = {"gyro": NoiseModel((gyro,)), "accel": NoiseModel((WN(1e-5),))}
    plain = truth | {"gyro": NoiseModel((replace(gyro, follows=None),))}
    filters = [LooselyCoupledEKF(m, cases.DT) for m in (truth, plain)]
    start = NavState(road.nav[0, :3], road.nav[0, 3:6], rotation.rpy_from_quaternion(road.nav[0, 6:10]))
    nees = np.zeros((40, 2))
    for k, rng in enumerate(np.random.default_rng(7).spawn(40)):
        got = corrupt(imu, truth, rng, temperature=imu.temperature).imu
        for j, ekf in enumerate(filters):
            a = ekf.run(got, None, start, InitialSigma(1e-3, 1e-4, (1e-6, 1e-6, 1e-6)))
            C, true = (rotation.dcm_from_quaternion(q) for q in (a.nav[-1, 6:10], road.nav[-1, 6:10]))
            wrong = C @ true.T - np.eye(3)
            e = np.array([wrong[2, 1], wrong[0, 2], wrong[1, 0]])
            nees[k, j] = e @ np.linalg.solve(a.final_covariance[6:9, 6:9], e) / 3.0
    follows, constant = nees.mean(axis=0)
    # 120 components: 1 within 0.39 at three standard deviations
    assert 0.61 < follows < 1.39 and constant > 3.0


def test_what_cannot_be_is_refused():
    shared = GM(1.0, 0.1, follows=WARM, shared="warmth")
    with pytest.raises(InputError, match="shared, and its correlation times follow temperature"):
        augment({"gyro": shared}, 0.01)
    found = augment({"gyro": GM(1.0, 0.1, follows=WARM)}, 0.01)
    with pytest.raises(InputError, match="constant correlation time, found a correlation time that follows temp"):
        found.require_constant("the budget")
    x = Series(np.random.default_rng(1).standard_normal(1000), 1.0, "rad/s", "gyro_x")
    with pytest.raises(InputError, match="insemu gap of a log at rest takes constant noise"):
        find_static_gap([x], {"gyro_x": NoiseModel((GM(1.0, 0.1, follows=WARM),))}, rng=np.random.default_rng(1))
    with pytest.raises(InputError, match="no slope by which the time follows"):
        augment({"gyro": GM(1.0, 0.1, follows=Follows("speed", what="time"))}, 0.01)


def test_true_states_of_a_chain_that_moves_are_not_told():
    model = NoiseModel((PROCESSES["pair"], PROCESSES["GM"]))
    parts = model.simulate_components(100, 0.1, np.random.default_rng(1), covariates={"temperature": np.zeros(100)})
    states = true_states(model, parts, 0.1)
    assert np.isnan(states[:2]).all() and np.array_equal(states[2], parts[1])
