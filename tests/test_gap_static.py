"""The gap of a static log: likelihoods against brute force, naming, false alarms, the report's face."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy.linalg import toeplitz
from scipy.signal import butter, lfilter

from insemu.errors import InputError
from insemu.gap import Policy, find_static_gap, load_nominal
from insemu.gap.candidates.axis import CANDIDATES, state_of
from insemu.gap.candidates.noise import turn_on_bias
from insemu.gap.checks.rest import axis_tests
from insemu.gap.data.counts import lattice
from insemu.gap.data.log import block_differences, difference_covariance, reduce
from insemu.gap.data.sources import static_of
from insemu.gap.evidence import kernels
from insemu.gap.evidence.band import Band
from insemu.gap.evidence.linear import regression_evidence, stationary_score
from insemu.gap.evidence.model import Component, Explanation, Likelihood, Regressors
from insemu.gap.evidence.modes import Free
from insemu.gap.evidence.rolloff import Rolloff
from insemu.gap.problems.findings import is_doubtful, remainder
from insemu.gap.problems.rest import reweighted, search_axis, weigh_all
from insemu.gap.threshold import Tail, certain, tail_of, threshold_of
from insemu.gap.verdict import Finding, Member, Where
from insemu.noise import BI, GM, QN, RC, RW, WN, NoiseModel
from insemu.records import ImuRecord, Recording, Series

DT, N = 0.05, 36_000


def log_of(values: np.ndarray, name: str = "gyro_x") -> Series:
    return Series(values, 1.0 / DT, "rad/s", name)


def test_the_posterior_along_the_parameters_is_that_of_the_explanation_there() -> None:
    rng = np.random.default_rng(5)
    data = reduce(log_of(WN(1e-3).simulate(N, DT, rng)))
    base = Explanation.nominal(NoiseModel((WN(1.1e-3), RW(1e-6), BI(1e-6), RC(1e-3))))
    free = (Free("sigma", 1e-6, 1.0), Free("beta", 1e-4, 5.0))
    fixed = Component(GM(1e-5, 0.02), ())
    full = replace(
        base.with_component(Component(GM(2e-5, 0.1), free)).with_component(fixed),
        rolloff=Rolloff("butterworth", (6.0, 2.0), (Free("corner", 0.3, 10.0), Free("order", 0.6, 12.0))),
    )
    column = np.full((data.differences.size, 1), data.block_s)
    drifting = replace(base, regressors=(Regressors("ramp", ("R",), column, np.array([1e-7])),))
    for explanation in (base, full, drifting):
        at = Likelihood(data).along(explanation)
        for _ in range(3):
            x = explanation.start() + 0.05 * rng.standard_normal(explanation.start().size)
            assert at(x) == pytest.approx(Likelihood(data).log_posterior(explanation.at(x)), rel=1e-12)


@pytest.mark.parametrize("process", [WN(1e-3), QN(2e-4), RW(3e-4), GM(2e-3, 1 / 30), GM(2e-3, 1e-6), BI(1e-3)])
def test_block_difference_covariance_equals_the_one_propagated_sample_by_sample(process) -> None:
    block, count = 8, 5
    if isinstance(process, BI):
        # first differences of flicker samples have the fourth difference of t^2 ln|t| as covariance; sum them up
        def g(t: int) -> float:
            return t * t * math.log(abs(t)) if t else 0.0

        def steps(k: int) -> float:
            total = sum(c * g(k + j) for j, c in zip(range(-2, 3), (1, -4, 6, -4, 1), strict=True))
            return total / (2 * math.pi) * process.B**2

        n = block * (count + 1)
        weights = [np.convolve(np.ones(block), np.ones(block)) / block] * (count + 1)
        gamma = toeplitz([steps(k) for k in range(n + block)])
        full = np.zeros((count, n + block))
        for k in range(count):
            full[k, k * block : k * block + 2 * block - 1] = weights[0]
        expected = (full @ gamma @ full.T)[0]
    else:
        n = block * (count + 1)
        b = process.block(DT)
        Phi, c = b.Phi, b.c
        P0 = b.P0 if b.n else np.zeros((0, 0))
        cov = np.zeros((n, n))
        P = P0.copy()
        for i in range(n):
            if i:
                P = Phi @ P @ Phi.T + b.Q
            cross = P.copy()
            for j in range(i, n):
                cov[i, j] = cov[j, i] = float(c @ cross @ c) if b.n else 0.0
                cross = Phi @ cross
            cov[i, i] += b.white
        A = np.zeros((count, n))
        for k in range(count):
            A[k, k * block : (k + 1) * block] = -1.0 / block
            A[k, (k + 1) * block : (k + 2) * block] = 1.0 / block
        expected = (A @ cov @ A.T)[0]
    got = difference_covariance(process, block, DT, count)
    np.testing.assert_allclose(got, expected, rtol=1e-7, atol=1e-9 * abs(expected[0]))


def test_toeplitz_whitening_is_the_dense_gaussian() -> None:
    rng = np.random.default_rng(1)
    gamma = difference_covariance(WN(1e-3), 200, DT, 40) + difference_covariance(RW(1e-4), 200, DT, 40)
    X = rng.standard_normal((40, 3))
    out = np.empty_like(X)
    logdet = kernels.toeplitz_whiten(gamma, X, out)
    C = toeplitz(gamma)
    np.testing.assert_allclose(out.T @ out, X.T @ np.linalg.solve(C, X), rtol=1e-9)
    assert logdet == pytest.approx(np.linalg.slogdet(C)[1], rel=1e-12)
    assert math.isnan(kernels.toeplitz_whiten(np.array([1.0, 2.0]), X[:2].copy(), out[:2].copy()))


def test_switching_likelihood_without_switching_is_the_scalar_kalman_filter() -> None:
    rng = np.random.default_rng(2)
    y = np.cumsum(rng.standard_normal(200)) * 0.1 + rng.standard_normal(200)
    expected, m, v = 0.0, 0.0, 4.0
    for k, value in enumerate(y):
        if k:
            v += 0.01
        s = v + 1.0
        expected += -0.5 * (math.log(2 * math.pi * s) + (value - m) ** 2 / s)
        m, v = m + v / s * (value - m), v / s
    got = kernels.switching_log_likelihood(kernels.BlockMeans(y, 1.0, 1.0, 0.01, 4.0), 0.0, 0.9, np.empty(200))
    assert got == pytest.approx(expected, rel=1e-12)


def test_gaussian_twin_of_switching_levels_is_the_dense_gaussian() -> None:
    rng = np.random.default_rng(2)
    y = rng.standard_normal(40)
    white, q, p0, a, stay = 0.7, 0.02, 5.0, 0.8, 0.9
    k = np.arange(40)
    C = (
        p0
        + q * np.minimum(k[:, None], k[None, :])
        + a**2 * (2 * stay - 1) ** np.abs(k[:, None] - k[None, :])
        + white * np.eye(40)
    )
    expected = -0.5 * (np.linalg.slogdet(2 * np.pi * C)[1] + y @ np.linalg.solve(C, y))
    assert kernels.gauss_markov_log_likelihood(kernels.BlockMeans(y, white, 1.0, q, p0), a, stay) == pytest.approx(
        expected, rel=1e-10
    )


def test_regression_evidence_is_the_ratio_of_marginal_likelihoods() -> None:
    rng = np.random.default_rng(3)
    G, y, scale = rng.standard_normal((30, 2)), rng.standard_normal(30), np.array([0.5, 2.0])
    factors = []
    for c in (0.1, 0.3, 1.0, 3.0, 10.0):
        C = np.eye(30) + (G * (c * scale) ** 2) @ G.T
        factors.append(-0.5 * np.linalg.slogdet(C)[1] - 0.5 * y @ np.linalg.solve(C, y) + 0.5 * y @ y)
    expected = math.log(np.mean(np.exp(factors)))
    assert regression_evidence(G.T @ G, G.T @ y, scale) == pytest.approx(expected, rel=1e-9)


def test_white_spectrum_statistic_has_its_stated_degrees_of_freedom() -> None:
    rng = np.random.default_rng(4)
    z = []
    for _ in range(10):
        r = reduce(log_of(WN(1e-3).simulate(N, DT, rng)))
        z.append((r.power / 1e-6 - 1.0) * np.sqrt(r.dof / 2.0))
    z = np.concatenate(z)
    # 2,000 standardised bins: their variance is within 4.5 standard errors of 1 (skewness of small bins allowed for)
    assert abs(z.var() - 1.0) < 0.2
    assert abs(z.mean()) < 0.1
    assert abs((1.3 * z).var() - 1.0) > 0.2  # the same test sees a spread that is 30 % off


CASES = {
    "random_walk": lambda rng: RW(1e-4).simulate(N, DT, rng),
    "gauss_markov": lambda rng: GM(1.2e-3, 1 / 20).simulate(N, DT, rng),
    "flicker": lambda rng: BI(8e-4).simulate(N, DT, rng),
    "ramp": lambda rng: 4e-6 * DT * np.arange(N),
    "vibration_line": lambda rng: 8e-4 * np.sin(2 * np.pi * 3.3 * DT * np.arange(N)),
    "vibration_band": lambda rng: Band(2e-3, 4.0, 0.1).simulate(N, DT, rng),
    "telegraph": lambda rng: 8e-4 * (2.0 * (np.cumsum(rng.random(N) < DT / 30.0) % 2) - 1.0),
    "outliers": lambda rng: np.where(rng.random(N) < 0.001, 0.05 * rng.standard_normal(N), 0.0),
    "white_noise": lambda rng: WN(1e-3).simulate(N, DT, rng),
}


@pytest.mark.parametrize("effect", CASES)
def test_a_strong_hidden_effect_is_named_although_the_level_is_wrong(effect: str) -> None:
    rng = np.random.default_rng(list(CASES).index(effect) + 11)
    y = WN(1e-3).simulate(N, DT, rng) + CASES[effect](rng)
    state = state_of(
        reduce(log_of(y)), Explanation.nominal(NoiseModel((WN(1e-3 * 1.15 if effect != "white_noise" else 0.95e-3),)))
    )
    ranked = weigh_all(state)
    assert ranked[0].effect == effect, [(w.effect, round(w.nats, 1)) for w in ranked[:4]]
    assert ranked[0].nats > 10.0


@pytest.mark.parametrize(("f", "ratio"), [(2.27, 0.08), (5.11, 0.04), (7.93, 0.02)])
def test_a_narrow_band_is_found_wherever_it_lies(f: float, ratio: float) -> None:
    rng = np.random.default_rng(23)
    y = WN(1e-3).simulate(N, DT, rng) + Band(9e-4, f, ratio).simulate(N, DT, rng)
    state = state_of(reduce(log_of(y)), Explanation.nominal(NoiseModel((WN(1.1e-3),))))
    (found,) = CANDIDATES["vibration_band"](state)
    assert found.nats > 20.0
    assert found.values[1].value == pytest.approx(f, abs=0.1 * ratio * f + 0.02)


def test_estimates_of_a_gauss_markov_process_bracket_the_truth() -> None:
    rng = np.random.default_rng(21)
    y = WN(1e-3).simulate(N, DT, rng) + GM(1.2e-3, 1 / 20).simulate(N, DT, rng)
    ranked = weigh_all(state_of(reduce(log_of(y)), Explanation.nominal(NoiseModel((WN(1e-3),)))))
    values = {v.name: v for v in ranked[0].values}
    assert values["sigma"].low < 1.2e-3 < values["sigma"].high
    assert values["beta"].low < 1 / 20 < values["beta"].high
    assert values["sigma"].unit == "rad/s"


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
def test_nominal_logs_with_wrong_levels_are_not_flagged() -> None:
    rng = np.random.default_rng(5)
    worst = -math.inf
    for k in range(6):
        truth = NoiseModel((WN(1e-3), RW(2e-5)) if k % 2 else (WN(1e-3),))
        belief = NoiseModel(
            tuple(p.with_parameters({n: v * rng.uniform(0.82, 1.2) for n, v in p.parameters.items()}) for p in truth)
        )
        ranked = weigh_all(state_of(reduce(log_of(truth.simulate(N, DT, rng))), Explanation.nominal(belief)))
        worst = max(worst, ranked[0].nats)
    assert worst < 3.0


def test_tests_of_disagreement_are_calibrated_and_see_a_wrong_model() -> None:
    rng = np.random.default_rng(6)
    p = []
    for _ in range(6):
        y = WN(1e-3).simulate(N, DT, rng)
        p += [
            value
            for _, _, value in axis_tests(state_of(reduce(log_of(y)), Explanation.nominal(NoiseModel((WN(1e-3),)))))
        ]
    p = np.array(p)
    # about 50 p-values: more than a fifth below 0.05 has a probability under 1e-4
    assert np.mean(p < 0.05) < 0.2
    assert p.min() > 1e-6
    t = DT * np.arange(N)
    sweep = 2e-3 * np.sin(2 * np.pi * (2.0 * t + 0.5 * 5.0 / t[-1] * t * t))
    y = WN(1e-3).simulate(N, DT, rng) + sweep
    found = {
        name: value
        for name, _, value in axis_tests(state_of(reduce(log_of(y)), Explanation.nominal(NoiseModel((WN(1e-3),)))))
    }
    assert found["stationarity"] < 1e-6


def test_temperature_is_named_with_its_shape_and_a_held_out_gain() -> None:
    rng = np.random.default_rng(7)
    T = 25.0 + 15.0 * np.sin(2 * np.pi * DT * np.arange(N) / 900.0)
    y = WN(1e-3).simulate(N, DT, rng) + 1e-4 * (T - 25.0)
    report = find_static_gap([log_of(y)], {"gyro_x": NoiseModel((WN(1e-3),))}, rng=rng, temperature=T)
    assert report.verdict in ("named", "class")
    assert report.findings[0].effect == "temperature"
    assert report.held_out.low > 0.0
    c1 = next(v for v in report.findings[0].parameters if v.name == "c1")
    assert c1.low < 1e-4 < c1.high
    assert report.gap_after.low < 1.0 < report.gap_after.high
    assert report.gap_before.low > 1.0


def test_temperature_is_named_before_the_random_walk_that_could_follow_it() -> None:
    rng = np.random.default_rng(17)
    T = 25.0 + 20.0 * np.sin(2 * np.pi * DT * np.arange(N) / 1500.0)
    slow = RW(1e-4).simulate(N, DT, rng)
    y = WN(1e-3).simulate(N, DT, rng) + 2e-4 * (T - 25.0) + 1e-5 * (T - 25.0) ** 2 + slow
    state = state_of(reduce(log_of(y)), Explanation.nominal(NoiseModel((WN(1e-3),))), T)
    fast = ("vibration_band", "vibration_line", "decimation_filter", "outliers", "quantization")
    assert weigh_all(state, fast)[0].effect == "random_walk"  # by evidence alone the walk comes first
    found = [f.chosen for f in search_axis(state, without=fast, outsiders=False).found]
    assert [w.effect for w in found] == ["temperature", "random_walk"]
    assert found[0].variant == "cubic"
    c1, c2 = (next(v for v in found[0].values if v.name == n) for n in ("c1", "c2"))
    assert c1.low < 2e-4 + 2e-5 * (np.mean(T) - 25.0) < c1.high
    assert c2.low < 1e-5 < c2.high


def test_a_gauss_markov_process_is_not_led_by_telegraph_noise() -> None:
    led = 0
    for seed in range(4):
        rng = np.random.default_rng([31, seed])
        y = WN(1e-3).simulate(N, DT, rng) + GM(4e-4, 1 / 30).simulate(N, DT, rng)
        state = state_of(reduce(log_of(y)), Explanation.nominal(NoiseModel((WN(1.1e-3),))))
        gains = {e: max(w.nats for w in CANDIDATES[e](state)) for e in ("gauss_markov", "telegraph")}
        led += gains["telegraph"] > gains["gauss_markov"]
    assert led == 0


def test_samples_clipped_at_the_full_scale_are_saturation_on_a_lattice_or_not() -> None:
    rng = np.random.default_rng(18)
    y = WN(1e-3).simulate(N, DT, rng)
    state = state_of(reduce(log_of(y)), Explanation.nominal(NoiseModel((WN(1e-3),))))
    assert not CANDIDATES["saturation"](state)
    for lsb in (0.0, 2e-3):
        counts = np.round(y / lsb) * lsb if lsb else y
        state = state_of(reduce(log_of(np.clip(counts, -0.006, 0.006))), Explanation.nominal(NoiseModel((WN(1e-3),))))
        (found,) = CANDIDATES["saturation"](state)
        assert found.nats > 20.0
        assert found.values[0].value == pytest.approx(0.006, rel=1e-6)
        state = state_of(reduce(log_of(counts)), Explanation.nominal(NoiseModel((WN(1e-3),))))
        assert all(w.nats < 3.0 for w in CANDIDATES["saturation"](state))


def test_clipped_samples_are_not_held_ones() -> None:
    y = np.minimum(WN(1e-3).simulate(N, DT, np.random.default_rng(19)), 0.01)
    state = state_of(reduce(log_of(y)), Explanation.nominal(NoiseModel((WN(1e-3),))))
    assert CANDIDATES["saturation"](state)[0].nats > 20.0
    assert not CANDIDATES["dropped_samples"](state)
    y[::50] = y[1::50][: y[::50].size]  # each of them repeated by the next
    held = state_of(reduce(log_of(y)), Explanation.nominal(NoiseModel((WN(1e-3),))))
    assert CANDIDATES["dropped_samples"](held)[0].values[0].value == pytest.approx(0.02, rel=0.1)


def test_turn_on_bias_is_what_the_rotation_of_the_earth_cannot_be() -> None:
    rng = np.random.default_rng(19)
    y = WN(1e-3).simulate(N, DT, rng)
    belief = Explanation.nominal(NoiseModel((WN(1e-3),)))
    assert turn_on_bias(state_of(reduce(log_of(y + 7.2e-5)), belief))[0].nats < 0.0
    found, walk = turn_on_bias(state_of(reduce(log_of(y + 5e-4)), belief))
    assert found.nats > walk.nats + 3.0 > 13.0
    assert found.values[0].low < 5e-4 < found.values[0].high
    assert not turn_on_bias(state_of(reduce(log_of(y + 5e-4)), Explanation.nominal(NoiseModel((WN(1e-3), RC(1e-3))))))
    assert not turn_on_bias(state_of(reduce(log_of(y + 5e-4, "accel_x")), belief))


def test_a_walk_too_weak_to_be_named_is_the_rival_of_a_turn_on_bias() -> None:
    belief = Explanation.nominal(NoiseModel((WN(1e-3),)))
    alone, beyond = [], []
    for seed in range(30):
        rng = np.random.default_rng([26, seed])
        y = WN(1e-3).simulate(N, DT, rng) + RW(5e-6).simulate(N, DT, rng)
        bias, walk = turn_on_bias(state_of(reduce(log_of(y)), belief))
        alone.append(bias.nats)
        beyond.append(bias.nats - walk.nats)
    # the mean alone would often call it a bias
    assert max(alone) > 3.0
    assert max(beyond) < 3.0


def test_samples_that_the_stamps_skip_are_filled_and_named() -> None:
    rng = np.random.default_rng(20)
    n = 12_000
    t, keep = DT * np.arange(n), rng.random(n) > 0.01
    y = np.stack([WN(1e-3).simulate(n, DT, rng) for _ in range(3)], axis=1)
    imu = ImuRecord(t[keep], y[keep], 100.0 * y[keep], "mean")
    log = static_of(Recording(imu=imu, source="x"))
    assert log.missing is not None
    np.testing.assert_array_equal(np.flatnonzero(log.missing), np.flatnonzero(~keep[: log.missing.size]))
    report = find_static_gap(
        log.axes[:1], {"gyro_x": NoiseModel((WN(1e-3),))}, rng=rng, missing=log.missing, hold_out=False
    )
    assert [(s.effect, s.sensor) for s in report.findings] == [("dropped_samples", "imu")]
    share = report.findings[0].parameters[0]
    assert share.low < 0.01 < share.high
    half = rng.random(n) > 0.4
    with pytest.raises(InputError, match="expected at most 20%"):
        static_of(Recording(imu=ImuRecord(t[half], y[half], y[half], "mean"), source="x"))


def test_what_remains_unexplained_is_said_and_takes_no_name_back() -> None:
    step = Finding(
        "temperature", "cubic", "gyro", ("x",), (), 0.99, 900.0, (Member("temperature", "gyro", ("x",), 900.0),)
    )
    walk = replace(step, effect="random_walk", members=(Member("random_walk", "gyro", ("x",), 50.0),))
    band = replace(step, effect="vibration_band")
    left = [Where("whiteness", "gyro", "x", 10.0, 1e-9)]
    assert not is_doubtful(step, left, {})
    assert is_doubtful(walk, left, {})
    assert not is_doubtful(replace(walk, axes=("y",)), left, {})
    assert not is_doubtful(band, left, {})
    assert is_doubtful(band, [Where("stationarity", "gyro", "x", 10.0, 1e-9)], {})
    assert remainder(left, {}) == "whiteness at 10 s on gyro x (p 1e-09)"
    assert remainder([], {}) == ""


def test_a_steep_output_filter_leaves_no_disagreement_behind() -> None:
    rng = np.random.default_rng(24)
    b, c = butter(2, 0.7)
    y = lfilter(b, c, WN(1e-3).simulate(N, DT, rng))
    state = state_of(reduce(log_of(y)), Explanation.nominal(NoiseModel((WN(1.1e-3),))))
    best = max(CANDIDATES["decimation_filter"](state), key=lambda w: w.nats)
    values = {v.name: v.value for v in best.values}
    assert values["cutoff"] == pytest.approx(7.0, rel=0.05)
    assert min(p for _, _, p in axis_tests(best.change)) > 1e-6


def test_bins_that_no_model_fits_do_not_bend_the_others() -> None:
    rng = np.random.default_rng(22)
    data = reduce(log_of(WN(1e-3).simulate(N, DT, rng)))
    loud = replace(
        data, power=np.where(data.f > 5.0, data.power * (1.5 + 0.5 * np.sin(40.0 * np.log(data.f))), data.power)
    )
    state = state_of(loud, Explanation.nominal(NoiseModel((WN(1e-3),))))
    bent, kept = (s.explanation.components[0].process.parameters["N"] for s in (state, reweighted(state)))
    assert abs(kept / 1e-3 - 1.0) < 0.5 * abs(bent / 1e-3 - 1.0)


def test_out_of_catalogue_telegraph_noise_is_not_confidently_misnamed() -> None:
    rng = np.random.default_rng(8)
    y = WN(1e-3).simulate(N, DT, rng) + CASES["telegraph"](rng)
    report = find_static_gap(
        [log_of(y)], {"gyro_x": NoiseModel((WN(1e-3),))}, rng=rng, without=("telegraph",), hold_out=False
    )
    assert report.verdict == "unexplained"


def test_two_axes_two_effects_and_the_json_of_the_issue() -> None:
    rng = np.random.default_rng(9)
    x = WN(1e-3).simulate(N, DT, rng) + RW(2e-4).simulate(N, DT, rng)
    z = WN(1e-3).simulate(N, DT, rng) + CASES["vibration_line"](rng)
    beliefs = {a: NoiseModel((WN(1e-3),)) for a in ("gyro_x", "gyro_z")}
    report = find_static_gap([log_of(x), log_of(z, "gyro_z")], beliefs, rng=rng, hold_out=False)
    found = {(s.effect, s.axes) for s in report.findings}
    assert ("vibration_line", ("z",)) in found
    assert any(axes == ("x",) for _, axes in found)
    assert len(found) == 2
    face = json.loads(json.dumps(report.to_json(), allow_nan=False))
    assert set(face) >= {"verdict", "steps", "where", "gap_index", "held_out"}
    assert set(face["steps"][0]) >= {
        "effect",
        "sensor",
        "axes",
        "parameters",
        "confidence",
        "gain_nats",
        "class",
        "would_separate",
    }
    assert set(face["steps"][0]["parameters"][0]) == {"name", "value", "low", "high", "unit"}
    assert set(face["where"][0]) == {"statistic", "sensor", "axis", "scale_s", "p_value"}
    assert set(face["gap_index"]) == {"before", "after"}
    assert set(face["held_out"]) == {"gain_nats_per_fix", "low", "high"}


def test_output_counts_are_seen_and_a_continuous_signal_has_none() -> None:
    rng = np.random.default_rng(10)
    y = WN(1e-3).simulate(20_000, DT, rng)
    assert lattice(y) == 0.0
    assert lattice(np.round(y / 2e-3) * 2e-3) == pytest.approx(2e-3, rel=1e-9)
    assert lattice((np.round(y / 2e-3) * 2e-3).astype(np.float32).astype(float)) == pytest.approx(2e-3, rel=1e-3)


def test_bad_input_says_what_is_wrong(tmp_path) -> None:
    rng = np.random.default_rng(1)
    good = log_of(rng.standard_normal(2000))
    with pytest.raises(InputError, match="no noise model is believed for the axis 'gyro_x'"):
        find_static_gap([good], {}, rng=rng)
    with pytest.raises(InputError, match="expected at least 480"):
        find_static_gap([log_of(rng.standard_normal(100))], {"gyro_x": NoiseModel((WN(1.0),))}, rng=rng)
    with pytest.raises(InputError, match="is constant"):
        find_static_gap([log_of(np.ones(2000))], {"gyro_x": NoiseModel((WN(1.0),))}, rng=rng)
    path = tmp_path / "b.yaml"
    path.write_text(yaml.safe_dump({"belief": {"gyro": "WN(N=1e-3)"}, "gnnss": {}}))
    with pytest.raises(InputError, match="unknown key 'gnnss'"):
        load_nominal(path)


def test_likelihood_prefers_the_truth_to_a_wrong_level() -> None:
    rng = np.random.default_rng(12)
    likelihood = Likelihood(reduce(log_of(WN(1e-3).simulate(N, DT, rng))))
    at = {
        n: likelihood.low(e) + likelihood.high(e)
        for n in (0.9e-3, 1e-3, 1.1e-3)
        for e in (Explanation.nominal(NoiseModel((WN(n),))),)
    }
    assert max(at, key=at.get) == 1e-3


def test_block_differences_drop_an_incomplete_block() -> None:
    np.testing.assert_allclose(block_differences(np.arange(11.0), 5), [5.0])


def test_threshold_of_a_data_set_is_exceeded_as_often_as_stated() -> None:
    rng = np.random.default_rng(8)
    tails = [tail_of(-0.3 + 0.9 * rng.exponential(size=4000)) for _ in range(6)]
    t = threshold_of(tails, 0.0)
    best = (-0.3 + 0.9 * rng.exponential(size=(20_000, 6))).max(axis=1)
    assert np.mean(best > t) == pytest.approx(0.02, abs=0.006)
    assert threshold_of(tails[:1], 0.0) < t < certain(6)
    assert threshold_of(tails, 9.0) == 9.0
    # however few the draws, no tail falls off more slowly than Markov's bound
    assert tail_of(np.array([0.0, 0.0, 0.0, 30.0])).excess <= 1.0
    assert Tail(0.0, 0.5).exceeds(-1.0) == 0.25


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
def test_a_weak_effect_must_beat_the_best_of_simulated_nominal_logs() -> None:
    rng = np.random.default_rng(3)
    axes = [log_of(WN(1e-3).simulate(6000, DT, rng), f"gyro_{a}") for a in "xyz"]
    beliefs = {s.name: NoiseModel((WN(1e-3),)) for s in axes}
    plain = find_static_gap(axes, beliefs, rng=rng, hold_out=False, policy=Policy(least_nats=-0.5), calibrate=False)
    assert plain.findings  # at half a nat below nothing there is always something
    calibrated = find_static_gap(axes, beliefs, rng=rng, hold_out=False, policy=Policy(least_nats=-0.5))
    assert calibrated.threshold_nats > 0.0
    assert all(s.nats >= calibrated.threshold_nats for s in calibrated.findings)


@pytest.mark.parametrize("regressors", [0, 2])
def test_the_likelihood_of_a_stationary_vector_has_its_derivatives_by_the_autocovariance(regressors: int) -> None:
    rng = np.random.default_rng(21)
    n = 40
    gamma = 0.8 ** np.arange(n) + 0.3 * (np.arange(n) == 0)
    rows, scales = rng.standard_normal((1 + regressors, n)), np.array([0.3, 2.0])[:regressors]
    rows[0] += rows[1:].sum(axis=0)

    def value(g: np.ndarray) -> float:
        C = toeplitz(g)
        y, G = rows[0], rows[1:].T
        plain = float(-0.5 * np.linalg.slogdet(C)[1] - 0.5 * y @ np.linalg.solve(C, y))
        return plain + (
            regression_evidence(G.T @ np.linalg.solve(C, G), G.T @ np.linalg.solve(C, y), scales) if regressors else 0.0
        )

    known = stationary_score(gamma, rows, scales)
    assert known is not None and known[0] == pytest.approx(value(gamma), rel=1e-12)
    slopes = [(value(gamma + 1e-6 * e) - value(gamma - 1e-6 * e)) / 2e-6 for e in np.eye(n)]
    assert known[1] == pytest.approx(np.array(slopes), abs=1e-6)
    assert stationary_score(np.array([1.0, 2.0, 0.0]), rows[:, :3], scales) is None


@pytest.mark.parametrize(("low_pass", "ramp"), [(False, False), (True, False), (False, True)])
def test_a_climb_knows_the_derivatives_of_what_it_climbs(low_pass: bool, ramp: bool) -> None:
    rng = np.random.default_rng(22)
    data = reduce(log_of(WN(1e-3).simulate(N, DT, rng) + GM(1e-3, 0.05).simulate(N, DT, rng)))
    wide = (Free("sigma", 1e-6, 1.0), Free("beta", 1e-4, 1.0))
    band = (Free("sigma", 1e-6, 1.0), Free("f", 0.1, 10.0), Free("ratio", 0.003, 0.6))
    explanation = Explanation.nominal(NoiseModel((WN(1.1e-3), RW(1e-5))))
    explanation = explanation.with_component(Component(GM(8e-4, 0.04), wide, "gauss_markov"))
    explanation = explanation.with_component(Component(Band(1e-3, 1.0, 0.1), band, "vibration_band"))
    if low_pass:
        free = (Free("corner", 0.1, 20.0), Free("order", 0.6, 12.0))
        explanation = replace(explanation, rolloff=Rolloff("butterworth", (2.0, 2.0), free, floor=1e-11))
    if ramp:
        regressor = Regressors("ramp", ("R",), np.full((data.differences.size, 1), 10.0), np.array([1e-6]))
        explanation = replace(explanation, regressors=(regressor,))
    along, x = Likelihood(data).along(explanation), explanation.start() + 0.01
    x[0] += 0.5  # outside of the tolerance, where the prior has a slope
    known = along.slope(x)
    assert known is not None and known.value == pytest.approx(along(x), rel=1e-12)
    slopes = np.array([(along(x + 1e-5 * e) - along(x - 1e-5 * e)) / 2e-5 for e in np.eye(x.size)])
    assert known.gradient == pytest.approx(slopes, rel=1e-3, abs=1e-2)
