"""Expectation-maximization, integrated likelihood, slopes, Burg, indirect inference, robust fits: truths, laws and refusals."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import linalg, stats

from insemu.errors import InputError
from insemu.fit import fit
from insemu.fit.burg import burg, choose_order
from insemu.fit.em import StateSpace, expectation_maximization, fit_em, maximise
from insemu.fit.gmwm import Weights, fit_curve
from insemu.fit.indirect import bootstrap_intervals, match_curve
from insemu.fit.likelihood import Stream, _Problem, fit_mli_pieces, integrate, sampling_pattern
from insemu.fit.robust import _change, _Prediction, rejection_limit
from insemu.fit.selection import wic
from insemu.noise import AR, AR1, BI, DR, GM, QN, RW, WN, NoiseModel, NotStationary
from insemu.records import Series
from insemu.variance import wavelet_variance
from tests.shared_data import shared


def within(result, label, truth, sigmas=4.5):
    e = result[label]
    assert math.isfinite(e.standard_error) and e.standard_error > 0
    assert abs(e.value - truth) < sigmas * e.standard_error, f"{label}: {e.value} ± {e.standard_error}, truth {truth}"
    assert e.standard_error < 0.5 * abs(truth)  # and the error is not bought by a huge bound


# -- expectation-maximization ---------------------------------------------------------------------------------------------------------


def a_space(rng):
    n = 2
    Phi = np.array([[0.7, 0.1], [0.0, 0.9]])
    Q = np.diag([0.5, 0.1])
    true, false = np.ones((n, n), dtype=bool), np.zeros((n, n), dtype=bool)
    free_Phi = false.copy()
    free_Phi[0, 0] = free_Phi[1, 1] = True
    return StateSpace(
        Phi, Q, np.array([1.0, 0.5]), np.array([0.02, 0.0]), 0.3, np.zeros(n), np.eye(n),
        free_Phi, np.eye(n, dtype=bool), np.array([False, True]), np.array([True, False]), True, np.array([True, True]) & true[0],
    )  # fmt: skip


def test_em_never_lowers_the_likelihood_and_keeps_fixed_entries():
    rng = np.random.default_rng(1)
    space = a_space(rng)
    x, y = np.zeros(2), np.empty(400)
    for k in range(400):
        x = space.Phi @ x + space.u + np.sqrt(np.diag(space.Q)) * rng.standard_normal(2)
        y[k] = space.H @ x + math.sqrt(0.3) * rng.standard_normal()
    start = replace(space, Phi=np.array([[0.3, 0.1], [0.0, 0.5]]), Q=np.diag([2.0, 0.01]), R=2.0, u=np.zeros(2))
    found = expectation_maximization(start, y, iterations=60, tolerance=0.0)
    steps = np.diff(found.trace)
    assert (steps > -1e-8 * np.abs(found.trace[1:])).all()
    assert found.trace[-1] - found.trace[0] > 10
    assert found.space.Phi[0, 1] == 0.1 and found.space.Phi[1, 0] == 0.0
    assert found.space.Q[0, 1] == 0.0 and found.space.H[0] == 1.0 and found.space.u[1] == 0.0
    assert not found.stopped


def test_the_update_is_the_maximum_of_the_expected_likelihood():
    # at the update of a free entry, the gradient of the likelihood at the old point has the same sign as the move
    rng = np.random.default_rng(2)
    model = GM(1.0, 0.2) + WN(0.5)
    result = fit_em(Series(model.simulate(1500, 1.0, rng), 1.0, "", "y"), NoiseModel((GM(), WN())), tolerance=1e-10)
    space = result.details["space"]
    y = model.simulate(1500, 1.0, np.random.default_rng(2))
    y = y - result.details["offset"] - 0.0
    again, _ = maximise(space, y - y.mean() + y.mean())
    # a converged point is a fixed point
    assert_allclose(again.Phi, space.Phi, rtol=2e-3)
    assert_allclose(again.Q, space.Q, rtol=2e-3)


def test_em_finds_what_was_simulated_and_says_how_well():
    rng = np.random.default_rng(3)
    truth = GM(0.5, 0.02) + WN(0.3)
    result = fit(truth.simulate(8000, 1.0, rng), "GM() + WN()", "em", rate_hz=1.0)
    within(result, "GM1.sigma", 0.5)
    within(result, "GM1.beta", 0.02)
    within(result, "WN1.N", 0.3)
    assert result.converged and result.details["trace"].size > 2


def test_em_removes_a_ramp_and_reports_a_stop_short_of_the_top():
    rng = np.random.default_rng(4)
    truth = WN(0.2) + RW(0.02) + DR(0.003)
    series = Series(truth.simulate(3000, 1.0, rng), 1.0, "", "y")
    structure = NoiseModel((WN(), RW(), DR()))
    good = fit_em(series, structure, start=WN(0.5) + RW(1e-3) + DR(0.0))
    assert good.converged
    assert abs(good["WN1.N"].value - 0.2) < 0.02
    assert abs(good["DR1.R"].value - 0.003) < 0.003
    early = fit_em(series, structure, start=WN(5.0) + RW(10.0) + DR(0.0), tolerance=1e-2)
    assert not early.converged
    assert any("higher likelihood" in w for w in early.warnings)


def test_em_fits_autoregressions_of_higher_order():
    rng = np.random.default_rng(5)
    truth = NoiseModel((AR((1.2, -0.5), sigma2=1.0, rate_hz=1.0), WN(0.5)))
    result = fit(truth.simulate(6000, 1.0, rng), "AR(2) + WN()", "em", rate_hz=1.0, tolerance=1e-8)
    assert_allclose([result["AR1.ar_1"].value, result["AR1.ar_2"].value], [1.2, -0.5], atol=0.12)


# -- integrated maximum likelihood ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pattern", ["uniform", "log"])
@pytest.mark.parametrize("bias", [False, True])
def test_integrated_likelihood_equals_the_dense_gaussian(pattern, bias):
    rng = np.random.default_rng(6)
    model, n, dt = WN(0.1) + GM(0.5, 2.0) + RW(0.2, sigma0=0.4) + QN(0.01), 120, 0.1
    x = model.simulate(n, dt, rng) + 0.7
    at = sampling_pattern(n, pattern, 17)
    y = integrate(x, at, dt)
    assert_allclose(y.sum(), dt * x[: at[-1]].sum(), rtol=1e-12)
    # covariance of the samples from the block, then of their sums
    block = model.block(dt)
    C = np.zeros((n, n))
    P = np.array(block.P0)
    for i in range(n):
        P = block.Phi @ P @ block.Phi.T + block.Q
        row = P @ block.c
        for j in range(i, n):
            C[i, j] = C[j, i] = block.c @ row
            row = block.Phi @ row
    C += np.eye(n) * block.white
    A = np.zeros((at.size, n))
    for k, (lo, hi) in enumerate(zip([0, *at[:-1]], at, strict=True)):
        A[k, lo:hi] = dt
    S, one = A @ C @ A.T, A.sum(axis=1)
    expected = -0.5 * (np.linalg.slogdet(2 * np.pi * S)[1] + y @ np.linalg.solve(S, y))
    constant = 0.0
    if bias:
        weight = one @ np.linalg.solve(S, one)
        constant = one @ np.linalg.solve(S, y) / weight
        expected += 0.5 * constant**2 * weight - 0.5 * math.log(weight)
    got, found = _Problem(y, at, dt, bias).likelihood(model)
    assert_allclose(got, expected, rtol=1e-9)
    assert_allclose(found, constant, rtol=1e-7, atol=1e-12)


def test_powers_of_the_samples_tend_to_the_balanced_exponential():
    beta, q, N, span = 0.02, 1e-3, 0.05, 40.0
    F = np.array([[-beta, 0.0], [1.0, 0.0]])
    # equations (14), (18) and (21) of the paper
    big = linalg.expm(np.block([[-F, np.diag([q**2, N**2])], [np.zeros((2, 2)), F.T]]) * span)
    Phi = big[2:, 2:].T
    Qd = Phi @ big[:2, 2:]
    # the increment's variance from a stationary start, against sums of many short samples
    P = np.diag([q**2 / (2 * beta), 0.0])
    expected = (Phi @ P @ Phi.T + Qd)[1, 1]
    model, dt = WN(N) + GM.of_driving_density(q, beta), span / 4000
    at = np.array([4000, 8000])
    problem = _Problem(np.zeros(2), at, dt, False)
    # log-likelihood of two zeros: minus half the log-determinant
    C = np.zeros((2, 2))
    C[0, 0] = C[1, 1] = expected
    C[0, 1] = C[1, 0] = (Phi @ (Phi @ P @ Phi.T + Qd))[1, 0] * 0 + _cross(beta, q, span)
    assert_allclose(problem.likelihood(model)[0], -0.5 * np.linalg.slogdet(2 * np.pi * C)[1], rtol=2e-3)


def _cross(beta, q, span):
    """Covariance of the integrals of a GM over two adjacent spans."""
    return q**2 / (2 * beta) * ((1 - math.exp(-beta * span)) / beta) ** 2


@pytest.mark.parametrize("options", [{}, {"integrated": False}], ids=["integrated", "direct"])
def test_maximum_likelihood_finds_what_was_simulated(options):
    rng = np.random.default_rng(7)
    truth = WN(1e-3) + GM(2e-3, 0.05)
    x = truth.simulate(40000, 0.1, rng) + 0.3
    result = fit(x, "WN() + GM()", "mli", rate_hz=10.0, **options)
    assert result.converged
    within(result, "WN1.N", 1e-3)
    within(result, "GM1.sigma", 2e-3)
    within(result, "GM1.beta", 0.05)
    assert abs(result.details["bias"] - 0.3) < 5e-3


def test_a_record_in_pieces_gives_the_same_as_in_memory():
    rng = np.random.default_rng(17)
    x = (WN(1e-3) + GM(2e-3, 0.05)).simulate(30001, 0.1, rng) + 9.8
    structure = NoiseModel((WN(), GM()))
    whole = fit(x, structure, "mli", rate_hz=10.0, points=3000)
    parts = fit_mli_pieces(Stream(np.array_split(x, [7, 5000, 5001, 20000]), x.size, 10.0), structure, points=3000)
    assert parts.n_samples == x.size
    for e in whole.parameters:
        assert_allclose(parts[e.label].value, e.value, rtol=2e-3)  # the search stops at a hundredth of a standard error


def test_maximum_likelihood_holds_given_values_and_takes_other_models():
    rng = np.random.default_rng(8)
    truth = WN(1e-3) + RW(2e-4) + QN(1e-4)
    x = truth.simulate(20000, 0.1, rng)
    result = fit(x, "WN(N=1e-3) + RW() + QN()", "mli", rate_hz=10.0)
    assert result["WN1.N"].value == 1e-3 and not result["WN1.N"].free
    within(result, "RW1.K", 2e-4)


# -- slopes ---------------------------------------------------------------------------------------------------------------------------


def test_slopes_give_the_formulas_of_the_paper():
    rng = np.random.default_rng(9)
    x = (WN(1e-2) + RW(1e-2)).simulate(200000, 0.01, rng)
    result = fit(x, "WN() + RW()", "slopes", rate_hz=100.0)
    assert_allclose(result["WN1.N"].value, 1e-2, rtol=0.03)
    assert_allclose(result["RW1.K"].value, 1e-2, rtol=0.3)
    by_psd = fit(x, "WN() + RW()", "psd-slopes", rate_hz=100.0)
    assert_allclose(by_psd["WN1.N"].value, 1e-2, rtol=0.03)
    assert_allclose(by_psd["RW1.K"].value, 1e-2, rtol=0.3)
    flicker = fit(BI(0.02).simulate(200000, 0.01, rng), "GM()", "slopes", rate_hz=100.0)
    # sigma_GM = 0.664 B
    assert_allclose(flicker["GM1.sigma"].value, 0.664 * 0.02, rtol=0.15)


def test_slopes_that_are_not_there_are_zero_and_said():
    result = fit(WN(0.1).simulate(50000, 0.01, np.random.default_rng(0)), "WN() + RW() + GM()", "slopes", rate_hz=100.0)
    assert result["RW1.K"].value == 0.0 and result["GM1.sigma"].value == 0.0
    assert not result.converged and any("RW" in w for w in result.warnings)


# -- Burg -----------------------------------------------------------------------------------------------------------------------------


def test_burg_finds_coefficients_and_order():
    rng = np.random.default_rng(10)
    truth = AR((1.5, -0.6), sigma2=2.0, rate_hz=1.0)
    x = truth.simulate(20000, 1.0, rng)
    result = fit(x, "AR(2)", "burg", rate_hz=1.0)
    within(result, "AR1.ar_1", 1.5)
    within(result, "AR1.ar_2", -0.6)
    within(result, "AR1.sigma2", 2.0)
    coefficients, variance = burg(x - x.mean(), 8)
    assert choose_order(variance, x.size)[0] in (2, 3)
    assert (np.diff(variance) <= 0).all()
    # every order is stationary, and the recursion agrees with a direct one-step fit to the order of 1/n
    for p in range(1, 9):
        assert np.abs(np.roots(np.concatenate([[1.0], -coefficients[p - 1, :p]]))).max() < 1.0
    one = fit(x, "AR1()", "burg", rate_hz=1.0)
    assert_allclose(one["AR1#1.phi"].value, 1.5 / 1.6, rtol=5e-3)


def test_denoised_autoregressions_say_that_their_digits_matter():
    x = (WN(1e-3) + GM(2e-3, 0.01)).simulate(60000, 0.01, np.random.default_rng(11))
    result = fit(x, "AR(3)", "burg", rate_hz=100.0, denoise_levels=6)
    assert any("de-noised" in w for w in result.warnings)
    radius = result.details["spectral_radius"]
    assert radius < 1.0
    if np.abs(np.roots([1.0, *(-np.round(v, 3) for v in result.model.processes[0].ar)])).max() >= 1.0:
        assert any("decimals" in w for w in result.warnings)


@pytest.mark.parametrize(
    ("axis", "model", "levels"),
    [
        ("acc_y", "WN(N=0.045 m/s/sqrt(h)) + GM(sigma=3.022 m/s/h, Tc=7.26 s) + RW(K=24.95 m/s/h^1.5)", 6),
        ("gyro_z", "WN(N=2.164 deg/sqrt(h)) + GM(sigma=21.06 deg/h, Tc=735.17 s)", 7),
    ],
)
def test_the_approximation_gives_the_rows_that_the_paper_prints(axis, model, levels):
    """Tables 4 and 5 simulated (an hour), levels of Table 7: rows of Table 2 within 25 % of the innovation variance and 0.01."""
    import yaml

    table = yaml.safe_load(shared("published/quinchia2013.yaml").read_text())["table_2_burg_after_db4_6_levels"]
    unit = "rad/s" if "gyro" in axis else "m/s^2"
    x = NoiseModel.parse(model, unit).simulate(360_000, 0.01, np.random.default_rng(13))
    for order in (1, 3):
        printed = table[f"ar{order}"][axis]
        for rule in ("approximation", "sure"):
            found = fit(x, f"AR({order})", "burg", rate_hz=100.0, denoise_levels=levels, denoise_rule=rule)
            ar = found.model.processes[0]
            close = abs(ar.sigma2 / printed["b0_squared"] - 1.0) < 0.25
            assert close == (rule == "approximation")
            if rule == "approximation":
                assert_allclose([-a for a in ar.ar], printed["a"], atol=0.01)


def test_published_polynomials_that_are_not_stationary_do_not_enter():
    import yaml

    table = yaml.safe_load((shared("published/quinchia2013.yaml")).read_text())["table_2_burg_after_db4_6_levels"][
        "ar3"
    ]
    refused = 0
    for entry in table.values():
        p = AR(tuple(-a for a in entry["a"]), sigma2=entry["b0_squared"], rate_hz=100.0)
        if p.spectral_radius >= 1.0:
            refused += 1
            with pytest.raises(NotStationary, match="not stationary"):
                p.block(0.01)
    assert refused >= 1


# -- robust, indirect, bootstrap ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("size", "share", "normal"),
    [(10.0, 0.05, True), (5.0, 0.05, False), (5.0, 0.1, False)],
    ids=["most of them moderate", "of one size", "every tenth"],
)
def test_outliers_do_not_move_a_robust_fit(size, share, normal):
    """The fit of the same record without outliers is met, the plain fit is not."""
    rng = np.random.default_rng(12)
    truth = WN(1e-2) + GM(5e-3, 0.1)
    x = truth.simulate(1 << 15, 1.0, rng)
    hit = rng.random(x.size) < share
    drawn = rng.standard_normal(x.size)
    bad = x + hit * size * x.std() * (drawn if normal else np.sign(drawn))
    plain, robust, clean = (
        fit(v, "WN() + GM()", rate_hz=1.0, robust=r) for v, r in ((bad, False), (bad, True), (x, False))
    )
    assert plain["WN1.N"].value > 1.5 * 1e-2
    for label in ("WN1.N", "GM1.sigma", "GM1.beta"):
        found, without = robust[label], clean[label]
        # what the outliers leave open is what the two standard errors differ by, and what is rejected at this efficiency
        assert abs(found.value - without.value) < 2.5 * found.standard_error, label
        assert found.standard_error < 2.0 * without.standard_error, label
    assert_allclose(robust["WN1.N"].value, 1e-2, rtol=0.02)
    outliers = robust.details["outliers"]
    # outliers below two and a half standard deviations cannot be told from noise
    assert 0.75 * hit.mean() < outliers.share < 1.1 * hit.mean()
    assert outliers.rejected[hit].mean() > 0.75
    assert any("rejected as outliers" in w for w in robust.warnings)
    assert outliers.rejected.mean() > 2.0 * outliers.expected


@pytest.mark.parametrize("share", [0.0, 0.1])
def test_the_correction_of_a_robust_curve_is_that_of_white_noise(share):
    """White noise of 2, outliers of four standard deviations: what a limit takes from the shortest octave, by quadrature."""
    model, limit, n = NoiseModel((WN(np.sqrt(2.0)),)), 2.37, 1 << 15
    size = 2.5 * 1.25**2  # the third of the amplitudes
    shares = np.zeros(17)
    shares[[0, 3]] = 1.0 - share, share
    change, variance = _change(_Prediction(model, 1.0, 1.0), model, shares, 1.0, limit, n, 1.0)
    z = np.linspace(-limit, limit, 20001)
    # those that are seen suggest as many for each unit of size among smaller ones
    width = 2.5 * (1.25**2.5 - 1.25**-0.5)
    small = share / width * 2.5
    inside = {
        a: float(np.sum(z * z * stats.norm.pdf(z - a)) * (z[1] - z[0])) for a in (0.0, size, *np.linspace(0.0, 2.5, 41))
    }
    mean_of_small = np.mean(list(inside.values())[2:])
    chance = np.array([1.0 - share - small, share, small])
    expected = 0.5 * 2.0 * (1.0 - chance @ [inside[0.0], inside[size], mean_of_small])
    # a sample is predicted by 4096 others, so that the residual is larger by one in 8192, and so are samples that are put in
    assert change[0] == pytest.approx(expected, abs=5.0 * np.sqrt(variance) + 2e-3 * abs(expected))
    # drawn without its expectation it would scatter by what the limit costs in two such signals
    assert variance < (0.7 if share else 0.2) * (1.0 / 0.6 - 1.0) * 2.0 / n / 2.0


def test_a_clean_record_costs_the_efficiency_that_is_asked_for():
    """The limit of rejection against draws: the variance of samples within it, made consistent, by fixed-point iteration."""
    rng = np.random.default_rng(3)
    z = rng.standard_normal((3000, 400))
    for efficiency in (0.6, 0.9):
        limit = rejection_limit(efficiency)
        inside = np.abs(rng.standard_normal(2_000_000))
        share = np.mean(inside[inside < limit] ** 2)
        deviation = np.ones(z.shape[0])
        for _ in range(40):
            kept = np.abs(z) < limit * deviation[:, None]
            deviation = np.sqrt((z**2 * kept).sum(axis=1) / kept.sum(axis=1) / share)
        found = (2.0 / z.shape[1]) / np.var(deviation**2)
        # 3,000 draws know a variance to 2.6 %
        assert_allclose(found, efficiency, rtol=3 * 0.026 + 0.02)
    for wrong in (0.2, 1.0):
        with pytest.raises(InputError, match="efficiency"):
            rejection_limit(wrong)


def test_indirect_inference_agrees_with_the_closed_form():
    rng = np.random.default_rng(13)
    x = (WN(0.1) + RW(0.05)).simulate(8000, 0.1, rng)
    closed = fit(x, "WN() + RW()", rate_hz=10.0)
    simulated = fit(x, "WN() + RW()", "indirect", rate_hz=10.0, rng=np.random.default_rng(1), replicates=20)
    for label in ("WN1.N", "RW1.K"):
        e = simulated[label]
        # the simulation's own scatter is a fifth of the standard error's square
        assert abs(e.value - closed[label].value) < 2.5 * math.sqrt(1 / 20) * e.standard_error
        assert_allclose(e.standard_error, closed[label].standard_error, rtol=0.6)


def test_a_model_without_closed_form_is_fitted_by_simulation():
    # white noise rounded to a step: only its simulation is known
    def simulate(theta, n, dt, rng):
        return np.round(math.exp(theta[0]) * rng.standard_normal(n) / 0.5) * 0.5

    x = simulate(np.array([math.log(0.8)]), 5000, 1.0, np.random.default_rng(2))
    found = match_curve(wavelet_variance(x), simulate, [0.0], rng=np.random.default_rng(3), replicates=5, step=0.02)
    assert abs(math.exp(found.theta[0]) - 0.8) < 0.04
    assert 0.002 < math.sqrt(found.covariance[0, 0]) < 0.05


def test_bootstrap_and_asymptotics_agree_where_the_record_is_long():
    rng = np.random.default_rng(14)
    result = fit((WN(0.1) + RW(0.05)).simulate(20000, 0.1, rng), "WN() + RW()", rate_hz=10.0, weighting="asymptotic")
    booted = bootstrap_intervals(result, 150, np.random.default_rng(4))
    for label in ("WN1.N", "RW1.K"):
        # 150 replicates: standard error of a standard deviation 6 %
        assert_allclose(booted[label].standard_error, result[label].standard_error, rtol=0.3)
        assert booted[label].low < result[label].value < booted[label].high
    one, other = wic(result), wic(result, bootstrap=150, rng=np.random.default_rng(5))
    # with efficient weights the optimism is the number of parameters
    assert_allclose(one.penalty, 4.0, rtol=0.05)
    assert abs(other.penalty - one.penalty) < 2.0


def test_weights_by_bootstrap_are_those_of_the_closed_form():
    rng = np.random.default_rng(15)
    x = (WN(0.1) + RW(0.05)).simulate(4000, 0.1, rng)
    curve = wavelet_variance(x, 10.0)
    structure = NoiseModel((WN(), RW()))
    closed = fit_curve(curve, structure, weighting=Weights("asymptotic", steps=1))
    weights = Weights("bootstrap", steps=1, replicates=400, rng=np.random.default_rng(6))
    drawn = fit_curve(curve, structure, weighting=weights)
    assert_allclose(drawn["WN1.N"].value, closed["WN1.N"].value, rtol=5e-3)
    assert abs(drawn["RW1.K"].value - closed["RW1.K"].value) < closed["RW1.K"].standard_error


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda x: fit(x, "WN() + QN()", "em", rate_hz=1.0), "QN"),
        (lambda x: fit(x, "WN() + BI()", "mli", rate_hz=1.0), "BI"),
        (lambda x: fit(x, "WN()", "mli", rate_hz=1.0, pattern="odd"), "pattern"),
        (lambda x: fit(x, "2*GM()", "slopes", rate_hz=1.0), "separate"),
        (lambda x: fit(x, "AR(2)", "slopes", rate_hz=1.0), "cannot be read off"),
        (lambda x: fit(x, "WN()", "burg", rate_hz=1.0), "AR"),
        (lambda x: fit(x, "WN()", "em", rate_hz=1.0, robust=True), "robust"),
        (lambda x: fit(x, "WN()", "em", rate_hz=1.0, start=NoiseModel((RW(1.0),))), "structure"),
        (lambda x: fit(x, "AR1()", "em", rate_hz=1.0, ramp="maybe"), "ramp"),
        (lambda x: bootstrap_intervals(fit(x, "AR(1)", "burg", rate_hz=1.0), 50, np.random.default_rng(0)), "gmwm"),
        (lambda x: fit(wavelet_variance(x), "AR1()", "em"), "signal itself"),
    ],
)
def test_refusals_name_the_reason(call, words):
    with pytest.raises(InputError, match=words):
        call(np.random.default_rng(0).standard_normal(512))


def test_ar1_is_taken_by_em_and_likelihood():
    truth = AR1(0.95, 0.1, rate_hz=1.0)
    x = NoiseModel((truth, WN(0.5))).simulate(6000, 1.0, np.random.default_rng(16))
    for method in ("em", "mli"):
        result = fit(x, "AR1() + WN()", method, rate_hz=1.0)
        within(result, "AR1#1.phi", 0.95)


@pytest.mark.parametrize(
    ("method", "model"),
    [(m, "WN() + GM()") for m in ("gmwm", "em", "mli", "slopes", "autocorrelation")] + [("burg", "AR(2)")],
)
def test_what_any_method_finds_is_written_as_json(method: str, model: str) -> None:
    rng = np.random.default_rng(3)
    signal = GM(sigma=2e-3, beta=1.0).simulate(4000, 0.01, rng) + 1e-3 * rng.standard_normal(4000)
    document = fit(Series(signal, 0.01, "rad/s"), model, method=method).to_json()
    assert json.loads(json.dumps(document, allow_nan=False)) == document
