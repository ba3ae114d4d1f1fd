"""Slow errors of the fixes that go with what the receiver states, as the error of its own filter does."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from insemu import earth
from insemu.effects.gnss import gauss_markov
from insemu.emulate import gnss_fixes
from insemu.errors import InputError
from insemu.gap.evidence import fixes
from insemu.gap.evidence.surrogate import Colour, Surrogate
from insemu.records import Recording
from tests.test_gap_dynamic import LEVER, flown, nominal_run, recording, use
from tests.test_gap_fixes import looked

Array = NDArray[np.float64]
#: Fixes that a receiver does without satellites in the tests, and how far it may move meanwhile, m^2 per fix.
SHADED, MOVED = (range(60, 72), range(150, 158)), 0.3**2


def by_kalman(n: int, runs: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Errors (n, runs) of a receiver's scalar Kalman filters from their start on, and the variances (n,) that they state, m and m^2."""
    P, error = 3.0**2, 3.0 * rng.standard_normal(runs)
    errors, stated = np.empty((n, runs)), np.empty(n)
    for k in range(n):
        moved = MOVED if any(k in shade for shade in SHADED) else 0.02**2
        noise = 1e6 if any(k in shade for shade in SHADED) else 0.8**2
        error, P = error + np.sqrt(moved) * rng.standard_normal(runs), P + moved
        gain = P / (P + noise)
        error, P = error - gain * (error + np.sqrt(noise) * rng.standard_normal(runs)), (1.0 - gain) * P
        errors[k], stated[k] = error, P
    return errors, stated


def stating(made: Recording, error: Array, sigma: Array) -> Recording:
    """A recording with another error (n, 3) of its positions, m, and what is stated of it."""
    assert made.gnss is not None
    return replace(made, gnss=replace(made.gnss, llh=earth.move(made.gnss.llh, error), pos_std_ned=sigma))


def test_the_memory_is_that_of_a_kalman_filter() -> None:
    """Shaded, settling and at rest: the variance that its errors have together with those a fix before."""
    errors, P = by_kalman(200, 40000, np.random.default_rng(1))
    middle = float(np.median(P))
    # at rest the variance grows by what the vehicle may move
    tau = 1.0 / math.log1p(0.02**2 / middle)
    s = replace(Surrogate.of(nominal_run()[0]), t=np.arange(200.0), stated=np.tile(P[:, None] / middle, (1, 6)))
    phi, drive, first = s.memory(Colour(np.full(6, math.sqrt(middle)), tau, follows=True))
    assert first[0] == pytest.approx(P[0])
    # of 40,000 runs a covariance scatters by sqrt(2 / 40,000) of itself: six of that
    np.testing.assert_allclose(phi[1:, 0] * P[:-1], np.mean(errors[1:] * errors[:-1], axis=1), rtol=0.04)
    np.testing.assert_allclose(phi[1:, 0] ** 2 * P[:-1] + drive[1:, 0], P[1:], rtol=1e-12)


def test_emulated_errors_are_those_that_the_search_believes() -> None:
    sigma = np.sqrt(by_kalman(120, 1, np.random.default_rng(2))[1])
    stated, t = np.tile(sigma[:, None], (1, 3)), np.arange(120.0)
    drawn = np.stack([gauss_markov(t, 0.5, 20.0, np.random.default_rng(k), stated) for k in range(4000)])[:, :, 0]
    s = replace(Surrogate.of(nominal_run()[0]), t=t, stated=np.tile((sigma**2 / np.median(sigma**2))[:, None], (1, 6)))
    phi, _, _ = s.memory(Colour(np.full(6, 0.5), 20.0, follows=True))
    variance = 0.25 * s.stated[:, 0]
    # of 4,000 draws a variance scatters by sqrt(2 / 4,000) of itself: five of that
    np.testing.assert_allclose(np.mean(drawn**2, axis=0), variance, rtol=0.12)
    np.testing.assert_allclose(
        np.mean(drawn[:, 1:] * drawn[:, :-1], axis=0), phi[1:, 0] * variance[:-1], rtol=0.12, atol=0.02 * variance.max()
    )


def test_it_whitens_what_it_made() -> None:
    colour = Colour(np.array([0.3, 0.3, 0.4, 0.0, 0.0, 0.0]), 20.0, follows=True)
    plain = recording()
    assert plain.gnss is not None
    n = len(plain.gnss)
    stated = 0.1 * np.sqrt(by_kalman(n, 1, np.random.default_rng(3))[1])[:, None] * np.ones(3)
    rng = np.random.default_rng(4)
    error = gauss_markov(plain.gnss.t, colour.sigma[:3], colour.tau, rng, stated)
    s = Surrogate.of(flown(stating(plain, error, stated)))
    _, value = s.whiten(s.nu[:, :, None], None, colour)
    # what the fixes scatter without it is 0.05 m, and the filter believes more where more is stated
    assert value > s.whiten(s.nu[:, :, None], None, colour._replace(follows=False))[1] + 20.0
    assert value > s.log_likelihood() + 20.0


def test_receivers_that_state_always_the_same_have_one_kind() -> None:
    assert len(fixes._colours(Surrogate.of(nominal_run()[0]))) == 1


@pytest.mark.slow(reason="a whole search of a drive, whose parts have quick tests")
def test_the_error_of_a_receiver_s_filter_is_named_and_no_steps() -> None:
    """It jumps where satellites come back: a step was named there, beside a slow error three times as large as most of it."""
    made = recording()
    assert made.gnss is not None
    n, rng = len(made.gnss), np.random.default_rng(5)
    errors, P = by_kalman(n, 3, rng)
    made = stating(made, errors, np.sqrt(P)[:, None] * np.ones(3))
    report = looked(made)
    named = {f.effect: f for f in report.findings}
    colour = {p.name: p for p in named["gnss_correlated_noise"].parameters}
    assert colour["follows"].value == 1.0
    assert set(named) == {"gnss_correlated_noise", "gnss_noise_level"} and report.verdict == "named"


def test_an_error_cannot_follow_a_standard_deviation_of_zero() -> None:
    with pytest.raises(InputError, match="zero"):
        gauss_markov(np.arange(3.0), 1.0, 1.0, np.random.default_rng(0), np.zeros((3, 3)))


def test_it_is_stationary_where_always_the_same_is_stated() -> None:
    effect = use(effect="gnss_correlated_noise", sigma=[0.3, 0.3, 0.4], tau=20.0, follows=1)
    constant = use(effect="gnss_correlated_noise", sigma=[0.3, 0.3, 0.4], tau=20.0)
    one, two = (recording(e).gnss.llh for e in (effect, constant))  # type: ignore[union-attr]
    # sums of some hundred steps, in metres: far below the eps of a position
    assert np.abs(earth.position_difference(one, two)).max() < 1e-8


def received(white: float, seed: int) -> Recording:
    """A flight whose receiver gives what its filters make of it, with white noise of a share of what it states."""
    made, rng = recording(), np.random.default_rng(seed)
    assert made.reference is not None
    made = replace(made, gnss=gnss_fixes(made.reference, 1.0, (1e-3,) * 3, (0.05,) * 3, LEVER, rng=rng))
    errors, P = by_kalman(len(made.gnss), 3, rng)  # type: ignore[arg-type]
    sigma = np.sqrt(P)[:, None] * np.ones(3)
    return stating(made, errors + white * sigma * rng.standard_normal(sigma.shape), sigma)


@pytest.mark.parametrize(
    "seed",
    [
        1,
        pytest.param(2, marks=pytest.mark.slow(reason="another case of a quick test")),
        pytest.param(3, marks=pytest.mark.slow(reason="another case of a quick test")),
    ],
)
@pytest.mark.slow(reason="a whole search of a drive, whose parts have quick tests")
def test_a_level_that_was_named_before_a_colour_is_asked_again_beside_it(seed: int) -> None:
    """It kept within its tolerance of what it was without the colour, for the horizontal axes and the height apart, with an interval as narrow."""
    report = looked(received(0.1, seed))
    (level,) = (f for f in report.findings if f.effect == "gnss_noise_level")
    (colour,) = (f for f in report.findings if f.effect == "gnss_correlated_noise")
    assert level.axes == colour.axes == ("north", "east", "down") and len(report.findings) == 2
    assert level.parameters[0].low < 0.1 < level.parameters[0].high
