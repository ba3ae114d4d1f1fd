"""The climb to a posterior mode with derivatives: where it ends, what it weighs, and what is shared between starts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import linalg, signal

from insemu.gap.candidates.spectral import _cells
from insemu.gap.data.log import reduce
from insemu.gap.evidence import kernels
from insemu.gap.evidence.band import Band
from insemu.gap.evidence.model import Component, Explanation, Likelihood, fit
from insemu.gap.evidence.modes import NONE, Free, Slope, ascend, laplace, level
from insemu.gap.evidence.rolloff import Rolloff, gains
from insemu.gap.evidence.shapes import derivatives
from insemu.noise import BI, GM, RW, WN, NoiseModel, Process
from insemu.records import Series

Array = NDArray[np.float64]
WIDE = (Free("a", 0.01, 100.0), Free("b", 0.01, 100.0))


def variances(x: Array, free: tuple[Free, ...]) -> Slope:
    """Two variances and their estimates, coupled; the information is what the curvature is where both agree."""
    z = x - np.array([0.4, -0.7])
    value = float(-200.0 * np.sum(2.0 * z + np.exp(-2.0 * z)) - 30.0 * z[0] * z[1])
    gradient = -400.0 * (1.0 - np.exp(-2.0 * z)) - 30.0 * z[::-1]
    value += sum(f.log_density(v) for f, v in zip(free, x, strict=True))
    gradient = gradient + np.array([f.slope(v) for f, v in zip(free, x, strict=True)])
    return Slope(value, gradient, 800.0 * np.eye(2))


@pytest.mark.parametrize("free", [WIDE, (level("a", math.exp(0.1)), Free("b", 0.01, 100.0))], ids=["inside", "edge"])
@pytest.mark.parametrize("start", [(3.0, -3.0), (-2.0, 2.0)])
def test_a_climb_with_derivatives_ends_where_one_without_does(
    free: tuple[Free, ...], start: tuple[float, float]
) -> None:
    x0 = np.array(start)
    found = ascend(lambda x: variances(x, free), x0, free)
    expected = laplace(lambda x: variances(x, free).value, x0, free)
    np.testing.assert_allclose(found.x, expected.x, atol=1e-3)
    assert variances(found.x, free).gradient == pytest.approx(np.zeros(2), abs=0.02)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=0.02, atol=1e-6)
    assert found.evidence == pytest.approx(expected.evidence, abs=0.01)


def test_a_climb_ends_at_a_known_mode_that_it_comes_near() -> None:
    first = ascend(lambda x: variances(x, WIDE), np.array([3.0, -3.0]), WIDE)
    looks = []

    def look(x: Array) -> Slope:
        looks.append(x)
        return variances(x, WIDE)

    assert ascend(look, np.array([-2.0, 2.0]), WIDE, [first]) is first
    known = len(looks)
    again = ascend(look, np.array([-2.0, 2.0]), WIDE)
    assert again is not first and known < len(looks) - known


def test_where_there_is_no_posterior_a_climb_is_worth_nothing() -> None:
    assert ascend(lambda _: None, np.zeros(2), WIDE).log_posterior == NONE


def test_starts_share_what_their_common_parts_contribute() -> None:
    rng = np.random.default_rng(3)
    data = reduce(Series(WN(1e-3).simulate(40_000, 0.1, rng), 10.0, "rad/s", "gyro_x"))
    base = Explanation.nominal(NoiseModel((WN(1e-3), RW(1e-5))))
    free = (Free("sigma", 1e-8, 1.0), Free("beta", 1e-4, 1.0))
    starts = [base.with_component(Component(GM(a, 0.01), free, "gauss_markov")) for a in (1e-6, 1e-4)]
    starts.append(
        Explanation(base.components, Rolloff("exponential", (2.0,), (Free("corner", 0.1, 5.0),), floor=1e-11))
    )
    likelihood = Likelihood(data)
    got = likelihood.log_posteriors(starts)
    for value, e in zip(got, starts, strict=True):
        prior = sum(f.log_density(v) for f, v in zip(e.free, e.start(), strict=True))
        assert value == pytest.approx(likelihood.low(e) + likelihood.high(e) + prior, rel=1e-12)
    assert len(set(got)) == 3


def test_a_fit_ends_where_the_posterior_is_flat() -> None:
    rng = np.random.default_rng(4)
    truth = WN(1e-3) + GM(1e-3, 0.05)
    data = reduce(Series(truth.simulate(40_000, 0.1, rng), 10.0, "rad/s", "gyro_x"))
    free = (Free("sigma", 1e-6, 1.0), Free("beta", 1e-4, 1.0))
    start = Explanation.nominal(NoiseModel((WN(1.1e-3),))).with_component(
        Component(GM(1e-5, 0.5), free, "gauss_markov")
    )
    likelihood = Likelihood(data)
    found = fit(likelihood, start)
    slope = likelihood.along(start).slope(found.mode.x)
    assert slope is not None
    # what one more step would gain
    assert 0.5 * float(slope.gradient @ found.covariance @ slope.gradient) < 1e-3
    assert found.mode.x[1:] == pytest.approx(np.log([1e-3, 0.05]), abs=0.5)


def test_a_band_has_the_density_of_its_autoregression() -> None:
    band, dt = Band(2.0, 10.0, 0.01), 0.01
    phi1, phi2, variance = band.coefficients(dt)
    f = np.concatenate([[0.0], np.geomspace(0.05, 49.9, 200), [10.0]])
    z = np.exp(-2j * np.pi * f * dt)
    expected = variance * dt / np.abs(1.0 - phi1 * z - phi2 * z**2) ** 2
    np.testing.assert_allclose(band.psd(f, dt), expected, rtol=1e-9)
    assert float(band.psd(0.0, dt)) == pytest.approx(expected[0], rel=1e-9)


@pytest.mark.parametrize(
    "process", [GM(1e-3, 0.05), RW(2e-5), BI(1e-4), Band(1e-3, 3.5, 0.5)], ids=lambda p: type(p).__name__
)
def test_slope_and_bend_are_derivatives_of_the_posterior(process: Process) -> None:
    rng = np.random.default_rng(5)
    data = reduce(Series((WN(1e-3) + GM(1e-3, 0.05)).simulate(20_000, 0.1, rng), 10.0, "rad/s", "gyro_x"))
    free = [Free(name, 0.1 * v, 10.0 * v) for name, v in process.parameters.items()]
    explanation = Explanation.nominal(NoiseModel((WN(1e-3),))).with_component(Component(process, tuple(free), "any"))
    along = Likelihood(data).along(explanation)
    x = explanation.start() + 0.02
    here, bend, h, steps = along.slope(x), along.bend(x), 1e-4, np.eye(x.size)
    assert here is not None and bend is not None
    assert here.value == pytest.approx(along(x), rel=1e-12)
    moved = [(along(x + h * e) - along(x - h * e)) / (2.0 * h) for e in steps]
    np.testing.assert_allclose(here.gradient, moved, rtol=1e-4, atol=1e-4 * np.abs(moved).max())
    slopes = [(along.slope(x + h * e), along.slope(x - h * e)) for e in steps]
    bent = np.array([(b.gradient - a.gradient) / (2.0 * h) for a, b in slopes if a and b])
    np.testing.assert_allclose(bend, bent, rtol=2e-3, atol=2e-3 * np.abs(bent).max())


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("butterworth", (12.0, 3.0)),
        ("exponential", (4.0,)),
        ("moving average", (20.0,)),
        ("triangular window", (30.0,)),
    ],
)
def test_gains_of_low_passes_come_with_their_derivatives(kind: str, values: tuple[float, ...]) -> None:
    dt, f, m = 0.01, np.concatenate([[0.0], np.geomspace(0.1, 49.9, 60)]), len(values)
    turn = np.exp(-2j * np.pi * f * dt)
    if kind == "butterworth":
        expected = np.abs(signal.freqz(*signal.butter(3, values[0], fs=1.0 / dt), worN=f, fs=1.0 / dt)[1]) ** 2
    elif kind == "exponential":
        phi = np.exp(-2.0 * np.pi * values[0] * dt)
        expected = np.abs((1.0 - phi) / (1.0 - phi * turn)) ** 2
    else:
        expected = np.sinc(f / values[0]) ** (2 if kind == "moving average" else 4)
    got = gains(kind, values, f, dt)
    np.testing.assert_allclose(got[0], expected, rtol=1e-9, atol=1e-13)
    # by differences of a step of 1e-4: its square and rounding over its square
    numeric = derivatives(lambda x: gains(kind, np.exp(x).tolist(), f, dt)[0], np.log(values).tolist())
    np.testing.assert_allclose(got[1 : 1 + m], numeric[1 : 1 + m], atol=1e-7)
    np.testing.assert_allclose(got[1 + m :], numeric[1 + m :], atol=1e-5)


def test_a_corner_at_half_the_rate_moves_no_gain() -> None:
    got = gains("butterworth", (49.95, 2.0), np.array([10.0, 49.0]), 0.01)
    assert (got[0] > 0.9).all() and not got[[1, 3, 4]].any() and got[[2, 5]].any()


def test_toeplitz_kernels_solve_what_the_matrix_does() -> None:
    n, rng = 60, np.random.default_rng(6)
    gamma = 0.9 ** np.arange(n) + 0.5 * (np.arange(n) == 0)
    C = linalg.toeplitz(gamma)
    rows = rng.standard_normal((3, n))
    solved, diagonals, white = np.empty((3, n)), np.empty(n), np.empty((n, 3))
    logdet = kernels.toeplitz_solve(gamma, rows, solved, diagonals)
    inverse = np.linalg.inv(C)
    np.testing.assert_allclose(solved, rows @ inverse, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(diagonals, [np.trace(inverse, k) for k in range(n)], rtol=1e-8, atol=1e-10)
    assert logdet == pytest.approx(np.linalg.slogdet(C)[1], rel=1e-12)
    assert kernels.toeplitz_whiten(gamma, np.ascontiguousarray(rows.T), white) == pytest.approx(logdet, rel=1e-12)
    np.testing.assert_allclose(white.T @ white, rows @ inverse @ rows.T, rtol=1e-9, atol=1e-10)


def test_cells_keep_the_largest_ordinates() -> None:
    n, dt = 30_000, 0.01
    y = np.random.default_rng(7).standard_normal(n) + 0.2 * np.sin(2.0 * np.pi * 12.3456 * dt * np.arange(n))
    f, top, count = _cells(y, 4 * n, dt, 0.05, 49.9)
    spectrum = np.abs(np.fft.rfft(y, 4 * n)) ** 2 * dt / n
    every = np.arange(spectrum.size) / (4 * n * dt)
    inside = (every >= 0.05) & (every < 49.9)
    assert count.sum() == inside.sum() and top.max() == pytest.approx(spectrum[inside].max(), rel=1e-12)
    assert f[np.argmax(top)] == pytest.approx(12.3456, abs=1.0 / (n * dt))
    np.testing.assert_allclose(top, spectrum[np.round(f * 4 * n * dt).astype(int)])
    slope = (1.0 / every[inside]) ** 2
    found, exact = np.max(top * f**2), np.max(spectrum[inside] / slope)
    assert found == pytest.approx(exact, rel=2e-3)


def test_values_that_are_not_checked_make_the_same_process() -> None:
    free = GM(1.0, 0.1)
    assert free.level.name == "sigma"
    moved = free.unchecked({"beta": 0.3})
    assert moved == GM(1.0, 0.3) and free == GM(1.0, 0.1)
    assert np.array_equal(moved.psd(np.array([0.1, 1.0]), 0.1), GM(1.0, 0.3).psd(np.array([0.1, 1.0]), 0.1))
