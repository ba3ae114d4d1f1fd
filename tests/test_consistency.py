"""Consistency tests against draws whose answer is known, each with a negative twin."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from insemu.augment import Extras, augment
from insemu.emulate import TrueStates
from insemu.errors import InputError
from insemu.evaluate import consistency as c
from insemu.filters import FilterOptions, FixTable, LooselyCoupledEKF, run_filter
from insemu.noise import GM, RC, WN
from tests import filter_cases as cases
from tests.budget import binomial, binomial_power, statistical
from tests.consistency_of_runs import consistency_report, coverage_test, pooled_coverage, whiteness_test

SHAPE = (60, 12)


@pytest.fixture
def draws():
    rng = np.random.default_rng(11)
    A = rng.standard_normal((9, 9)) + 3 * np.eye(9)
    P = np.broadcast_to(A @ A.T, (*SHAPE, 9, 9))
    return rng.standard_normal((*SHAPE, 9)) @ A.T, P


def fixes_of(y, S=None):
    """A table of fixes with given innovations (f, 6) and unit covariance."""
    f = len(y)
    S = np.broadcast_to(np.eye(6), (f, 6, 6)) if S is None else S
    nis = np.einsum("fi,fij,fj->f", y, np.linalg.inv(S), y)
    return FixTable(np.arange(f) * 1.0, np.arange(f), np.zeros(f, int), y, S, nis, np.full(f, 6), np.ones(f, bool))


def test_nees_of_draws_from_the_covariance_is_chi_square(draws):
    e, P = draws
    v = c.nees(e, P)
    assert v.mean() == pytest.approx(9, rel=0.1)
    assert all(t.passed for t in c.nees_test(v, 9, confidence=0.9999))


@pytest.mark.parametrize(("scale", "word"), [(0.5, "overconfident"), (2.0, "pessimistic")])
def test_a_wrong_covariance_is_found_and_named(draws, scale, word):
    e, P = draws
    verdicts = c.nees_test(c.nees(e, scale**2 * P), 9, subject="all", at=np.arange(12.0))
    assert {t.word for t in verdicts} == {word}
    assert f"NEES/dof of all at 0 s: {verdicts[0].value:.4g}" in str(verdicts[0]) and word in str(verdicts[0])


def test_states_without_uncertainty_are_left_out_epoch_by_epoch(draws):
    e, P = draws[0][:, 0].copy(), draws[1][:, 0].copy()
    gone = np.zeros((len(e), 9), dtype=bool)
    gone[1::3, 2] = gone[2::3, 4:7] = gone[5] = True
    P[gone] = 0.0
    P.transpose(0, 2, 1)[gone] = 0.0
    e[7, 0] = np.nan
    found = c.nees_per_dof(e, P)
    for k, row in enumerate(gone):
        left = np.ix_(~row, ~row)
        told = np.nan if row.all() else e[k, ~row] @ np.linalg.inv(P[k][left]) @ e[k, ~row] / np.sum(~row)
        assert found[k] == pytest.approx(told, rel=1e-9, nan_ok=True)


@statistical(2e-5, 1, power=binomial_power(400, 0.01, 2e-5, 1, 0.05))  # bounds at 95 % instead of 99 %
def test_bounds_hold_their_confidence():
    """Of 400 families of a consistent filter 1 % at most fail."""
    rng = np.random.default_rng(2)
    failed = sum(not all(t.passed for t in c.nees_test(rng.chisquare(3, (20, 15)), 3)) for _ in range(400))
    assert failed <= binomial(400, 0.01, 2e-5)[1]


def test_innovations_are_judged_by_size_and_colour():
    rng = np.random.default_rng(3)
    y = rng.standard_normal((800, 6))
    assert c.nis_test(fixes_of(y), confidence=0.9999).passed
    assert all(t.passed for t in whiteness_test([fixes_of(y[:400]), fixes_of(y[400:])], confidence=0.9999))
    assert c.nis_test(fixes_of(1.2 * y)).word == "overconfident"
    coloured = y + 0.3 * np.vstack([y[:1], y[:-1]])
    verdicts = whiteness_test(fixes_of(coloured / np.sqrt(1.09)))
    assert verdicts[0].word == "correlated" and verdicts[0].value == pytest.approx(0.3 / 1.09, abs=0.05)
    assert "the model is incomplete" in str(verdicts[0])


@pytest.mark.parametrize("lean", [1.0, -1.0])
def test_what_is_certain_and_small_is_said_as_that(lean):
    """The bounds of 48,000 innovations are those of a normal distribution to 1e-4; a difference inside 2 % is outside of them."""
    dof = 48_000
    z = 2.5758293035489  # of 99 %, two-sided; the mean of chi-squares varies by 2 / dof
    bound = z * np.sqrt(2.0 / dof)
    inside, small, large = (c.nis_verdict((1.0 + lean * x) * dof, dof) for x in (0.9 * bound, 0.0199, 0.0201))
    assert inside.high - 1.0 == pytest.approx(bound, abs=2e-4) and bound < 0.0199
    assert inside.passed and small.passed and not large.passed
    assert "the difference is certain, but smaller than what moves a decision (2 %)" in str(small)
    assert "says nothing of what no fix sees" in str(inside)
    assert f"innovations are {'larger' if lean > 0 else 'smaller'} than the filter states" in str(large)
    assert not any("knows its error" in str(v) or "surer" in str(v) for v in (inside, small, large))
    one, two = c.nees_verdicts([3 * (1.0 + lean * 0.0199), 3 * (1.0 + lean * 0.0201)], dof, 3)
    assert one.passed and "certain" in str(one) and not two.passed and "the filter is" in str(two)


def test_a_coverage_within_a_hundredth_moves_no_decision():
    """Of 40,000 errors 94.6 % and 94.2 % lie inside the 95.45 % of two sigma: both far outside the binomial bounds (0.1 % a standard deviation)."""
    verdicts = []
    for share in (0.946, 0.942):
        e = np.full(40_000, 1.0)
        e[: round(e.size * (1.0 - share))] = 3.0
        e = np.random.default_rng(1).permutation(e).reshape(200, 200, 1)
        verdicts += coverage_test(e, np.ones_like(e), names=("a",), factor=2.0)
    small, large = verdicts
    assert max(v.low for v in verdicts) > 0.946 and small.value == pytest.approx(0.946)
    assert small.passed and "certain" in str(small) and "(1 %)" in str(small)
    assert large.word == "overconfident" and "surer than it should be" in str(large)


def test_innovations_are_whitened_by_their_covariance():
    rng = np.random.default_rng(4)
    A = rng.standard_normal((6, 6)) + 3 * np.eye(6)
    y = rng.standard_normal((3000, 6)) @ A.T
    white = c.normalised_innovations(fixes_of(y, np.broadcast_to(A @ A.T, (3000, 6, 6))))
    np.testing.assert_allclose(white.T @ white / 3000, np.eye(6), atol=0.1)


def test_coverage_is_judged_by_runs():
    rng = np.random.default_rng(5)
    e = rng.standard_normal((200, 50, 2)) * 0.5 + rng.standard_normal((200, 1, 2)) * np.sqrt(0.75)  # correlated epochs
    sigma = np.ones_like(e)
    sigma[..., 1] = 0.5
    good, bad = coverage_test(e, sigma, names=("a", "b"))
    assert good.passed and bad.word == "overconfident"
    wide = coverage_test(e[..., :1], 3 * sigma[..., :1], names=("a",), factor=1.0)[0]
    assert wide.word == "pessimistic"
    with pytest.raises(InputError, match=r"expected \(runs, epochs, 1\)"):
        coverage_test(e, sigma, names=("a",))


def test_pooled_coverage_has_an_interval():
    rng = np.random.default_rng(6)
    e = rng.standard_normal((100, 200, 6))
    share, low, high = pooled_coverage(e, np.ones_like(e), rng=rng)
    assert low < share < high and low < 0.9973 < high
    assert pooled_coverage(e, 0.5 * np.ones_like(e), rng=rng)[2] < 0.95


def test_bad_covariances_are_refused():
    with pytest.raises(InputError, match="not positive"):
        c.nees(np.ones(2), np.diag([1.0, 0.0]))
    with pytest.raises(InputError, match="singular"):
        c.nees(np.ones(2), np.ones((2, 2)))
    with pytest.raises(InputError, match="expected"):
        c.nees(np.ones(3), np.eye(2))
    with pytest.raises(InputError, match="no accepted fix"):
        c.nis_test(fixes_of(np.zeros((0, 6))))


def test_a_report_of_flown_filters_passes_and_its_negative_twin_does_not():
    road, at, runs = cases.drive(30.0), (1.0, 12.0, 20.0, 30.0), 24
    half = {
        "gyro": WN(N=2.5e-4) + GM(sigma=1.5e-4, beta=0.01),
        "accel": WN(N=5e-4) + GM(sigma=2.5e-3, beta=0.02),
    }

    def report(belief):
        ekf = LooselyCoupledEKF(belief, cases.DT, options=FilterOptions(covariance_at=at, output_every=100))
        errors, covariances, tables = [], [], []
        for i in range(runs):
            rng = np.random.default_rng(40 + i)
            imu = cases.corrupt(road.imu, cases.MODEL_15, rng)
            r = ekf.run(imu, cases.fixes(road, rng, outages=((12.0, 20.0),)), cases.start(road, rng), cases.START_SIGMA)
            rows = np.searchsorted(r.t, np.array(at) - 1e-9)
            errors.append(cases.strapdown.navigation_errors(r.nav[rows], road.nav[rows * 100]))
            covariances.append(r.covariance[:, :9, :9])
            tables.append(r.fixes)
        return consistency_report(np.array(errors), np.array(covariances), tables, at=at, confidence=0.9999)

    good = report(cases.MODEL_15)
    assert all(v.passed for v in good), [str(v) for v in good if not v.passed]
    assert sum(v.word == "overconfident" for v in report(half)) > 4


def test_observability_tells_what_the_fixes_taught():
    road = cases.drive(30.0)
    rng = np.random.default_rng(1)
    imu, gnss, start = cases.corrupt(road.imu, cases.MODEL_15, rng), cases.fixes(road, rng), cases.start(road, rng)
    options = FilterOptions(output_every=100)
    with_fixes = run_filter(imu, gnss, start, cases.START_SIGMA, cases.MODEL_15, options=options)
    without = run_filter(imu, None, start, cases.START_SIGMA, cases.MODEL_15, options=options)
    share = c.observability(with_fixes.sigma, without.sigma)
    assert share[-1, :3].min() > 0.99
    assert ((share[-1] > -1e-9) & (share[-1] < 1)).all()
    np.testing.assert_array_equal(share[0], 0)
    with pytest.raises(InputError, match="shape"):
        c.observability(with_fixes.sigma, without.sigma[:3])


def test_bounds_are_quantiles_of_a_family():
    """Each test of a family of m has the m-th part of one in a hundred, half of it on each side (scipy.stats)."""
    m, runs, dof = 12, 60, 9
    chi_square = stats.chi2.ppf([0.005 / m, 1.0 - 0.005 / m], runs * dof) / (runs * dof)
    for v in c.nees_verdicts(np.full(m, 9.0), runs, dof):
        assert (v.low, v.high) == pytest.approx(chi_square, rel=1e-9)
    nis = c.nis_verdict(500.0, 500)
    assert (nis.low, nis.high) == pytest.approx(stats.chi2.ppf([0.005, 0.995], 500) / 500, rel=1e-9)
    counts = [400, 300, 200, 100]
    for v, n in zip(c.whiteness_verdicts(np.zeros(4), counts), counts, strict=True):
        assert (-v.low, v.high) == pytest.approx(stats.norm.isf([0.005 / 4] * 2) / np.sqrt(n), rel=1e-9)
    e = np.random.default_rng(7).standard_normal((200, 40, 3))
    for v in coverage_test(e, np.ones_like(e), names=("a", "b", "c"), factor=2.0):
        inside = stats.binom(v.count, stats.chi2.cdf(4.0, 1))
        assert (v.low, v.high) == pytest.approx(inside.ppf([0.005 / 3, 1.0 - 0.005 / 3]) / v.count, rel=1e-9)
        assert v.count > 4000  # the epochs do not depend on each other


def test_groups_of_states_share_the_confidence_of_a_report(draws):
    """Position, velocity and attitude at twelve epochs: 36 tests of NEES."""
    report = consistency_report(*draws, [fixes_of(np.random.default_rng(1).standard_normal((50, 6)))], at=range(12))
    found = [v for v in report if v.test == "NEES/dof"]
    assert len(found) == 36
    expected = stats.chi2.ppf([0.005 / 36, 1.0 - 0.005 / 36], 3 * SHAPE[0]) / (3 * SHAPE[0])
    for v in found:
        assert (v.low, v.high) == pytest.approx(expected, rel=1e-9)


def test_fully_correlated_states_count_as_what_moves_them():
    """Three states of two sources, of unequal size: the sum of squares of the sources over two; independent states in other epochs over three."""
    rng = np.random.default_rng(12)
    mixed = np.array([[1.0, 0.0], [0.4, 2.0], [-0.7, 1.5]])
    z = rng.standard_normal((6, 3))
    full = np.column_stack([mixed, [0.0, 0.5, 3.0]])
    apart = np.array([True, False, False, True, False, False])
    e = np.where(apart[:, None], z @ full.T, z[:, :2] @ mixed.T)
    P = np.where(apart[:, None, None], full @ full.T, mixed @ mixed.T)
    expected = np.where(apart, (z**2).sum(axis=1) / 3.0, (z[:, :2] ** 2).sum(axis=1) / 2.0)
    assert c.nees_per_dof(e, P) == pytest.approx(expected, rel=1e-6)
    assert c.nees_per_dof(e[1:3], P[1:3]) == pytest.approx(expected[1:3], rel=1e-6)


def test_errors_of_the_axes_are_sums_of_states_and_blocks_their_squares():
    """A bias on each axis and a scale factor of the gyroscopes, which counts at the measured rate: written out axis by axis."""
    a = augment({"gyro": RC(sigma=0.1), "accel": RC(sigma=1.0)}, 0.01, Extras(gyro_scale=1e-3))
    names, rng = a.layout.names[9:], np.random.default_rng(13)
    m, rows = len(names), np.array([0, 2])
    estimate, true, rates, axes = (rng.standard_normal((3, n)) for n in (m, m, 6, 6))
    root = rng.standard_normal((2, 9 + m, 9 + m))
    P = root @ root.transpose(0, 2, 1)
    result = SimpleNamespace(imu_states=estimate)
    given = (result, a, rows, P, rates[rows])
    found = c.sensor_errors(*given, TrueStates(axes[rows], true[rows], names))
    C = np.zeros((2, 6, m))
    for i, axis in enumerate(f"{triad}_{letter}" for triad in ("gyro", "accel") for letter in "xyz"):
        C[:, i, names.index(f"{axis}.RC1")] = 1.0
        if i < 3:
            C[:, i, names.index(f"{axis}.scale")] = rates[rows, i]
    expected = np.array([C[k] @ estimate[row] - axes[row] for k, row in enumerate(rows)])
    np.testing.assert_allclose(found.axes, expected, rtol=1e-12)
    spread = np.array([C[k] @ P[k, 9:, 9:] @ C[k].T for k in range(2)])
    np.testing.assert_allclose(found.axes_covariance, spread, rtol=1e-9)
    np.testing.assert_allclose(found.states, (estimate - true)[rows])
    assert np.isnan(c.sensor_errors(*given, TrueStates(axes[rows], true[rows], names[::-1])).states).all()
    errors = rng.standard_normal((2, 9))
    blocks = c.block_nees(errors, P, found)
    for k in range(2):
        parts = [(errors[k, s], P[k][s, s]) for s in (slice(0, 3), slice(3, 6), slice(6, 9))]
        parts += [(expected[k, s], spread[k][s, s]) for s in (slice(0, 3), slice(3, 6))]
        parts += [((estimate - true)[rows[k]], P[k, 9:, 9:])]
        assert blocks[:, k] == pytest.approx([e @ np.linalg.inv(S) @ e / e.size for e, S in parts], rel=1e-6)
    assert np.isnan(c.block_nees(errors, P)[3:]).all()
