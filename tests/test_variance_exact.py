"""Readings of curves that are exact: what was put into a curve is what is read from it, with no draw in between."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from insemu import variance as v
from insemu.noise import BI, DR, GM, QN, RW, WN, NoiseModel
from insemu.variance import findings, reading, robust
from insemu.variance.allan import AllanVariance
from insemu.variance.characterise import _correlation, _trend
from insemu.variance.robust import _core, _heavy, _scale
from tests.pins import numbers

DT = 0.01


def curve(model: NoiseModel, octaves: int = 17, *, most: float = 4000.0) -> AllanVariance:
    """The Allan variance of a model at octaves of a record of two more; degrees of freedom fall as the number of averages."""
    m = 2 ** np.arange(octaves, dtype=np.int64)
    n = 4 << octaves
    edof = np.minimum(most, np.maximum(n / m / 2.0, 1.0))
    value = model.allan_variance(m, DT)
    return AllanVariance(m, m * DT, value, 0.9 * value, 1.1 * value, edof, n, 1.0 / DT)


EXACT: dict[str, tuple[NoiseModel, dict[str, float]]] = {
    "white": (NoiseModel((WN(2e-4),)), {"N": 2e-4}),
    "walk": (NoiseModel((RW(3e-5),)), {"K": 3e-5}),
    "rounding": (NoiseModel((QN(4e-6),)), {"Q": 4e-6}),
    "drift": (WN(2e-4) + DR(1e-4), {"N": 2e-4, "R": 1e-4}),
    "white and walk": (WN(2e-4) + RW(3e-5), {"N": 2e-4, "K": 3e-5}),
    "rounding and white": (QN(4e-5) + WN(2e-4), {"Q": 4e-5, "N": 2e-4}),
    "rounding, white and walk": (QN(4e-5) + WN(2e-4) + RW(1e-5), {"Q": 4e-5, "N": 2e-4, "K": 1e-5}),
}


@pytest.mark.parametrize("name", EXACT)
def test_exact_power_laws_are_read_back(name: str) -> None:
    """IEEE Std 952: 3 Q^2 / tau^2, N^2 / tau, K^2 tau / 3, R^2 tau^2 / 2."""
    model, wanted = EXACT[name]
    found = v.read_curve(curve(model))
    assert set(wanted) <= set(found) <= {*wanted, "B", "Tc"}
    for key, value in wanted.items():
        np.testing.assert_allclose(found[key].si_value, value, rtol=5e-3)
        assert found[key].low <= found[key].value * (1 + 1e-9) and found[key].high >= found[key].value * (1 - 1e-9)
        assert found[key].high / found[key].low < 2.0


@pytest.mark.parametrize("size", [1e-3, 1e-6, 1e3])
def test_intervals_do_not_depend_on_the_size_of_the_signal(size: float) -> None:
    """Of quiet sensors the squares are below any absolute tolerance."""
    one = curve(QN(4e-5) + WN(2e-4) + RW(1e-5))
    other = AllanVariance(
        one.m, one.tau_s, size**2 * one.value, one.low, one.high, one.edof, one.n_samples, one.rate_hz
    )
    big, small = v.read_curve(one), v.read_curve(other)
    assert set(big) == set(small) >= {"Q", "N", "K"}
    for key in ("Q", "N", "K"):
        a, b = big[key], small[key]
        np.testing.assert_allclose(np.array([b.value, b.low, b.high]) / size, [a.value, a.low, a.high], rtol=3e-4)


def test_units_of_readings() -> None:
    """1 rad/s is 206264.806 deg/h; a square root of an hour is 60 of a second; a micro-g is 9.80665e-6 m/s^2."""
    c = curve(QN(4e-5) + WN(2e-4) + RW(1e-5))
    si, gyro, accel = (v.read_curve(c, unit) for unit in ("", "rad/s", "m/s^2"))
    deg, ug = 180.0 / np.pi, 1e6 / 9.80665
    factors = {"Q": (deg, 1.0), "N": (deg * 60.0, ug), "K": (deg * 3600.0, ug)}
    units = {
        "Q": ("1*s", "deg", "m/s"),
        "N": ("1/sqrt(Hz)", "deg/sqrt(h)", "ug/sqrt(Hz)"),
        "K": ("1*sqrt(Hz)", "deg/h*sqrt(Hz)", "ug*sqrt(Hz)"),
    }
    for key, pair in factors.items():
        assert tuple(r[key].unit for r in (si, gyro, accel)) == units[key]
        for other, factor in zip((gyro, accel), pair, strict=True):
            np.testing.assert_allclose(
                [other[key].value, other[key].low, other[key].high],
                factor * np.array([si[key].value, si[key].low, si[key].high]),
            )
            assert other[key].si_value == si[key].si_value == si[key].value


def test_a_hump_is_read_as_its_highest_point() -> None:
    """The Allan deviation of a Gauss-Markov noise is at most 0.6174 sigma, at 1.8926 Tc; B divides the flat by 0.664."""
    sigma, tc = 3e-4, 20.0
    found = v.read_curve(curve(WN(2e-5) + GM(sigma, 1.0 / tc), 19))
    assert {"N", "Tc"} <= set(found)
    np.testing.assert_allclose(found["Tc"].value, tc, rtol=0.1)
    assert found["Tc"].unit == "s" and found["Tc"].note == "from the hump at 1.89 Tc"
    assert found["Tc"].low < tc < found["Tc"].high
    flicker = v.read_curve(curve(WN(2e-4) + BI(1e-4), 19))
    np.testing.assert_allclose(flicker["B"].si_value, 1e-4, rtol=0.05)
    np.testing.assert_allclose(reading.FLICKER, np.sqrt(2 * np.log(2) / np.pi), rtol=1e-12)
    m = np.arange(1, 4000)
    height = np.sqrt(NoiseModel((GM(1.0, 1e-3),)).allan_variance(m, 1.0))
    np.testing.assert_allclose(
        [m[np.argmax(height)] / 1000.0, height.max()], [reading.GM_PEAK_TIME, reading.GM_PEAK], rtol=1e-3
    )


def test_too_little_is_not_read() -> None:
    c = curve(NoiseModel((WN(1.0),)), 3)
    assert v.read_curve(c) == {}
    assert reading._above_white(c, c.tau_s[0], 0.0)
    white = curve(NoiseModel((WN(1.0),)), 9)
    assert not reading._above_white(white, white.tau_s[5], float(white.value[5]))
    assert reading._above_white(curve(WN(1.0) + RW(30.0), 9), white.tau_s[8], 1e9)


def _spans(*runs: tuple[int, int], size: int = 80) -> Any:
    out = np.zeros(size, dtype=bool)
    for a, b in runs:
        out[a : b + 1] = True
    return out


def test_straight_parts_are_runs_of_some_octaves() -> None:
    assert reading._spans(_spans((0, 8), (10, 17), (70, 79)), 1.0) == [(0, 8), (70, 79)]
    assert reading._spans(_spans((0, 16)) & _spans((5, 40)), 1.0) == [(5, 16)]
    assert reading._spans(_spans((3, 10)), 1.0) == [] and reading._spans(_spans((3, 11)), 1.0) == [(3, 11)]


def test_the_trend_is_means_of_blocks_and_the_correlation_goes_up_to_a_tenth_of_the_record() -> None:
    x = np.arange(1000.0)
    x[[4, 7]] = np.nan
    x[9:12] = np.nan
    t, means = _trend(x, 10.0)
    k = np.delete(np.arange(333), 3)  # of width 3; the fourth has no sample
    np.testing.assert_allclose(t, (3 * k + 1.5) / 10.0)
    wanted = 3.0 * k + 1.0
    wanted[1], wanted[2] = (3.0 + 5.0) / 2.0, (6.0 + 8.0) / 2.0
    np.testing.assert_allclose(means, wanted)
    assert _trend(np.ones(10), 1.0, 3)[0].tolist() == [1.5, 4.5, 7.5]
    y = numbers(9000, 4) + np.sin(np.arange(9000) / 80.0)
    found = _correlation(y, 100.0)
    assert (found["lag_s"][0], found["raw"][0], found["de-noised"][0], found["lag_s"].size) == (0.0, 1.0, 1.0, 400)
    np.testing.assert_allclose(found["lag_s"][-1], 9.0)
    # a sine of period 2 pi 80 samples; without its white noise it is nearly a cosine
    at = int(np.argmin(np.abs(found["lag_s"] - 1.6 * np.pi)))
    assert found["de-noised"][at] > 0.9 > 0.5 > found["raw"][at] > 0.25
    assert _correlation(y[:1023], 100.0) == {} and _correlation(np.ones(2000), 1.0) == {}
    assert set(_correlation(y[:1024], 100.0)) == {"lag_s", "raw", "de-noised"}
    np.testing.assert_allclose(_correlation(np.tile(y, 2), 1.0)["lag_s"][-1], 600.0)


# ---------------------------------------------------------------------------------------------------------------------- robust


def test_curves_differ_where_their_ratio_is_beyond_what_the_efficiency_explains() -> None:
    """Hausman: the variance of the difference of two estimates is the difference of their variances, 2 (1 - e) / edof of logarithms."""
    x = numbers(2000, 3)
    plain, other = v.wavelet_variance(x, levels=4), v.robust_wavelet_variance(x, levels=4)
    edof, share = np.array([50.0, 100.0, 200.0, 400.0]), 0.6
    other = replace(
        other, edof=edof, efficiency=share, contaminated=True, protected=np.array([True, True, True, False])
    )
    bound = np.exp(3.3 * np.sqrt(2.0 * (1.0 - share) / edof))
    for times, wanted in ((bound * 1.001, True), (bound * 0.999, False), (0.999 / bound, True), (1.001 / bound, False)):
        found = v.compare_with_robust(replace(plain, value=times * other.value), other)
        np.testing.assert_allclose(found.ratio, times)
        assert found.significant.tolist() == [wanted] * 4
        assert found.contaminated == bool(wanted and times[0] > 1)
    alone = np.array([1.0, 1.0, 1.0, 3.0])  # the only octave that differs is not protected
    assert not v.compare_with_robust(replace(plain, value=alone * other.value), other).contaminated
    small = replace(other, edof=1e6 * edof)
    for factor, wanted in ((1.051, True), (1.049, False)):
        assert v.compare_with_robust(replace(plain, value=factor * other.value), small).contaminated == wanted
        assert not v.compare_with_robust(
            replace(plain, value=factor * other.value), replace(small, contaminated=False)
        ).contaminated


def test_heavy_tails_are_more_values_far_out_than_gaussian_ones() -> None:
    n = 2000
    even = ndtri((np.arange(n) + 0.5) / n)
    assert not _heavy(even, 1.0, 2) and _heavy(1.5 * even, 1.0, 2) and not _heavy(1.5 * even, 2.25, 2)
    limit = math.sqrt(2.0 * math.log(n) + 2.0 * math.log(1e4))
    for factor, wanted in ((1.001, True), (0.999, False)):
        assert _heavy(np.append(even[1:], factor * limit), 1.0, 2) == wanted
    quiet = np.clip(even, -2.0, 2.0)
    for at, beyond in ((3.2, 3.0), (3.7, 3.5), (4.2, 4.0)):
        expected = 2.0 * ndtr(-beyond) * n
        most = math.floor(1.05 * expected + 5.0 * math.sqrt(max(expected, 1.0) * 2) + 4.0 * 2)
        for count, wanted in ((most, False), (most + 1, True)):
            x = quiet.copy()
            x[:count] = -at
            lower = [b for b in (3.0, 3.5) if b < beyond]
            fits = all(
                count <= 1.05 * 2 * ndtr(-b) * n + 5 * math.sqrt(max(2 * ndtr(-b) * n, 1.0) * 2) + 8 for b in lower
            )
            assert _heavy(x, 1.0, 2) == wanted or not fits
    assert (
        not _heavy(np.full(99, 9.0), 1.0, 2)
        and _heavy(np.full(100, 9.0), 1.0, 2)
        and not _heavy(np.full(100, 9.0), 0.0, 2)
    )


def test_scales_of_gaussian_values_are_their_variance() -> None:
    even = 3.0 * ndtri((np.arange(20_000) + 0.5) / 20_000)
    for efficiency in (0.4, 0.6, 0.95):
        c, k = robust.biweight_constants(efficiency)
        s2 = _scale(even, c, k)
        np.testing.assert_allclose(s2, 9.0, rtol=2e-3)
        weight = np.maximum(1.0 - even**2 / (c * c * s2), 0.0) ** 2
        np.testing.assert_allclose(np.sum(weight * even**2) / np.sum(weight), k * s2, rtol=1e-6)
    np.testing.assert_allclose(_core(even, 9.0), 9.0, rtol=2e-3)
    np.testing.assert_allclose(_core(np.append(even, [1e3] * 50), 9.0), 9.0, rtol=2e-3)
    assert _scale(np.array([0.0, 0.0, 0.0, 4.0]), 3.0, 0.6) == 4.0  # more than half are equal


@pytest.mark.parametrize(
    ("magnitude", "reason"),
    [
        (0.981 * 9.80665, None), (1.019 * 9.80665, None), (0.979 * 9.80665, "expected 9.8 m/s^2"), (1.021 * 9.80665, "expected 9.8 m/s^2"),
        (0.91, "the values are in g"), (1.09, "the values are in g"), (0.89, "expected 9.8 m/s^2"), (1.11, "expected 9.8 m/s^2"),
        (0.91 * 96.17, "the values were m/s^2 already, not g"), (1.09 * 96.17, "the values were m/s^2 already, not g"),
        (0.89 * 96.17, "expected 9.8 m/s^2"), (1.11 * 96.17, "expected 9.8 m/s^2"),
        (901.0, "the values are in mg"), (1099.0, "the values are in mg"), (899.0, "expected 9.8 m/s^2"), (1101.0, "expected 9.8 m/s^2"),
        (0.49, "gravity was removed or the sensor fell"), (0.51, "expected 9.8 m/s^2"),
    ],
)  # fmt: skip
def test_gravity_tells_the_unit_of_accelerometers(magnitude: float, reason: str | None) -> None:
    axes = ("accel_x", "accel_y", "accel_z")
    means = dict(zip(axes, magnitude * np.array([0.6, 0.0, -0.8]), strict=True))
    found = findings.unit_report(means, {}, dict.fromkeys(axes, "m/s^2"))
    for axis in axes:
        if reason is None:
            assert found[axis] == []
        else:
            assert len(found[axis]) == 1 and found[axis][0].endswith(reason)


@pytest.mark.parametrize(
    ("rate", "noise", "count"), [(0.19, 0.0, 0), (-0.21, 0.0, 1), (0.0, 19.9, 0), (0.0, 20.1, 1), (0.3, 30.0, 1)]
)
def test_rates_and_noise_that_no_gyroscope_has_are_said(rate: float, noise: float, count: int) -> None:
    found = findings.unit_report({"gyro_y": rate}, {"gyro_y": np.deg2rad(noise) / 60.0}, {"gyro_y": "rad/s"})
    assert len(found["gyro_y"]) == count
    assert all("the values may be in deg/s" in line for line in found["gyro_y"])


def test_the_range_of_block_means_goes_up_to_a_time() -> None:
    blocks = np.array([0.0, 1.0, 5.0, -2.0, *[9.0] * 252])
    running = np.concatenate([[0.0], np.cumsum(np.repeat(blocks, 4))])
    for until, wanted in ((0.0, 1.0), (0.8, 5.0), (1.2, 7.0)):  # of 0.4 s each; the block that a time ends in counts
        assert findings._range(running, 10.0, until) == wanted
