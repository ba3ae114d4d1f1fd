"""Readings off the curve, spectra and correlations."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import yaml

from insemu.denoise import denoise
from insemu.errors import InputError
from insemu.noise import BI, DR, GM, QN, RW, WN
from insemu.units import conversion
from insemu.variance import (
    allan_variance,
    autocorrelation,
    average_frequencies,
    average_octaves,
    expected_variance,
    octave_psd,
    psd,
    read_curve,
    wavelet_variance,
)
from tests.shared_data import shared


@pytest.mark.parametrize(
    ("model", "present", "absent"),
    [
        (WN(N=1e-3), {"N": 1e-3}, "QBKR"),
        (RW(K=1e-4), {"K": 1e-4}, "QNR"),
        (QN(Q=1e-3) + WN(N=1e-4), {"Q": 1e-3}, "KR"),
        (WN(N=1e-3) + RW(K=1e-3), {"N": 1e-3, "K": 1e-3, "B": None}, "QR"),
        (WN(N=1e-2) + RW(K=3e-3), {"N": 1e-2, "K": 3e-3}, "QR"),
        (WN(N=1e-3) + GM(sigma=1e-3, beta=0.2), {"N": 1e-3}, "QKR"),
        (WN(N=1e-3) + DR(R=1e-5), {"N": 1e-3, "R": 1e-5}, "QK"),
        (WN(N=1e-4) + BI(B=1e-3).approximation(8, 0.1, 3000.0)[0], {"B": 1e-3}, "QKR"),
    ],
    ids=str,
)
def test_what_is_there_is_read_and_what_is_not_is_not(
    model: Any, present: dict[str, float | None], absent: str
) -> None:
    x = model.simulate(200_000, 0.01, np.random.default_rng(30))
    readings = read_curve(allan_variance(x, 100.0))
    for name, value in present.items():
        assert name in readings
        r = readings[name]
        assert r.low < r.value < r.high and r.tau_from_s < r.tau_to_s
        if value is not None:
            assert 0.9 < r.si_value / value < 1.1 or r.low < value < r.high
    assert not set(absent) & set(readings)


def test_a_gauss_markov_of_0664_b_reads_back_as_0617_b() -> None:
    b = 1e-3
    x = (WN(N=1e-5) + GM(sigma=0.664 * b, beta=1.0 / 2.0)).simulate(400_000, 0.1, np.random.default_rng(31))
    found = read_curve(allan_variance(x, 10.0))
    # the hump of the model itself
    m = np.unique(np.geomspace(1, 4000, 500).astype(int))
    top = np.sqrt(GM(sigma=0.664 * b, beta=0.5).allan_variance(m, 0.1).max()) / 0.664
    assert abs(top / b - 0.617) < 0.002
    assert found["Tc"].low < 2.0 < found["Tc"].high


def test_units_are_those_of_datasheets() -> None:
    x = (WN(N=1e-3) + RW(K=1e-3)).simulate(100_000, 0.01, np.random.default_rng(32))
    gyro, accel = read_curve(allan_variance(x, 100.0), "rad/s"), read_curve(allan_variance(x, 100.0), "m/s^2")
    assert (gyro["N"].unit, gyro["K"].unit, accel["N"].unit) == ("deg/sqrt(h)", "deg/h*sqrt(Hz)", "ug/sqrt(Hz)")
    np.testing.assert_allclose(gyro["N"].value, np.rad2deg(gyro["N"].si_value) * 60.0)
    np.testing.assert_allclose(accel["K"].value, accel["K"].si_value / 9.80665e-6)


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
def test_the_published_sensor_reads_back() -> None:
    """Table 4 of Quinchia et al. 2013, simulated for 7 h: N within 1 %; K and B within their 95 % intervals as often as that says."""
    published = yaml.safe_load(shared("published/quinchia2013.yaml").read_text())
    inside: dict[str, list[bool]] = {"K": [], "B": []}
    print("axis      N printed -> read      B printed, closed form -> read       K printed -> read")
    for axis, table in published["table_4_allan"].items():
        unit, one = ("m/s^2", 1.0) if axis.startswith("acc") else ("rad/s", np.pi / 180)
        own = "m/s" if axis.startswith("acc") else "deg"
        printed = {"N": f"{own}/sqrt(h)", "B": f"{own}/h", "K": f"{own}/h^1.5"}
        N, B, K = table["N"][0] * one / 60, table["B"][0] * one / 3600, table.get("K", [0.0])[0] * one / 3600**1.5
        model = WN(N=N) + GM(sigma=0.664 * B, beta=1.0 / published["table_5"]["correlation_time_s"][axis])
        model = model + RW(K=K) if K else model
        m = np.unique(np.geomspace(1, 200_000, 3000).astype(int))
        curve = model.allan_variance(m, 0.01)
        slope = np.gradient(np.log(curve), np.log(m))
        lowest = float(np.sqrt(curve[int(np.argmax((slope[1:] >= 0) & (slope[:-1] < 0)))]) / 0.664 / one * 3600)
        for seed in (1, 2, 3):
            x = model.simulate(7 * 360_000, 0.01, np.random.default_rng(seed))
            r = {
                name: replace(v, value=v.value * factor, low=v.low * factor, high=v.high * factor)
                for name, v in read_curve(allan_variance(x, 100.0), unit).items()
                for factor in (conversion(v.unit, printed.get(name, v.unit)),)
            }
            assert abs(r["N"].value / table["N"][0] - 1.0) < 0.01
            inside["B"].append(r["B"].low <= lowest <= r["B"].high)
            if K:
                inside["K"].append(r["K"].low <= table["K"][0] <= r["K"].high)
            k_text = f"{table['K'][0]:8.2f} -> {r['K'].value:.2f} [{r['K'].low:.2f}, {r['K'].high:.2f}]" if K else ""
            print(
                f"{axis:7s} {table['N'][0]:8.3f} -> {r['N'].value:8.4f}   {table['B'][0]:8.3f}, {lowest:8.3f} -> {r['B'].value:8.3f} "
                f"[{r['B'].low:.3f}, {r['B'].high:.3f}]   {k_text}"
            )
    # binomial bounds at 0.1 %: of 9 at most 3 outside, of 18 at most 5
    assert len(inside["K"]) - sum(inside["K"]) <= 3
    assert len(inside["B"]) - sum(inside["B"]) <= 5


MODEL = WN(N=0.3) + GM(sigma=1.0, beta=0.5)


@pytest.mark.parametrize("method", ["welch", "multitaper", "periodogram"])
def test_spectra_have_the_models_density_and_the_signals_power(method: Any) -> None:
    x = MODEL.simulate(100_000, 0.01, np.random.default_rng(33))
    s = psd(x, 100.0, method=method)
    high = s.f_hz > 1.0
    np.testing.assert_allclose(np.mean(s.psd[high] / MODEL.psd(s.f_hz[high], 0.01)), 1.0, rtol=0.02)
    np.testing.assert_allclose(2.0 * s.psd.sum() * s.f_hz[0], x.var(), rtol=0.02)
    bands = average_frequencies(s, 5)
    inside = (bands.low < MODEL.psd(bands.f_hz, 0.01)) & (MODEL.psd(bands.f_hz, 0.01) < bands.high)
    assert inside[bands.f_hz > 2.0].mean() > 0.7
    octaves = average_octaves(s, 100.0)
    np.testing.assert_allclose(octaves.psd[-4:], MODEL.psd(octaves.f_hz, 0.01)[-4:], rtol=0.06)


def test_octave_levels_of_the_wavelet_variance_are_densities() -> None:
    x = WN(N=0.3).simulate(100_000, 0.01, np.random.default_rng(34))
    s = octave_psd(wavelet_variance(x, 100.0))
    np.testing.assert_allclose(s.psd[-6:], 0.09, rtol=0.06)
    np.testing.assert_allclose(s.psd_one_sided, 2.0 * s.psd)


def test_autocorrelation_is_the_models_and_de_noising_takes_its_spike_away() -> None:
    x = MODEL.simulate(200_000, 0.01, np.random.default_rng(35))
    a = autocorrelation(x, 100.0, max_lag_s=2.0)
    np.testing.assert_allclose(a.covariance[1:], MODEL.autocovariance(np.arange(1, 201), 0.01), atol=0.15)
    assert a.correlation[1] < 0.2
    assert autocorrelation(denoise(x, 6), 100.0, max_lag_s=2.0).correlation[1] > 0.95
    direct = np.array([np.dot(x[: x.size - k] - x.mean(), x[k:] - x.mean()) for k in (0, 7)]) / x.size
    np.testing.assert_allclose(a.covariance[[0, 7]], direct, rtol=1e-9)


def test_bad_options_are_refused() -> None:
    x = np.arange(100.0) % 7
    for call, said in (
        (lambda: psd(x, method="lomb"), "expected one of: welch"),  # type: ignore[arg-type]
        (lambda: psd(x, segment=500), "segment is 500"),
        (lambda: autocorrelation(x, max_lag_s=100.0), "max_lag_s"),
        (lambda: autocorrelation(np.ones(50)), "constant"),
    ):
        with pytest.raises(InputError, match=said):
            call()


@pytest.mark.parametrize(("filter", "above"), [("haar", 0.65), ("d6", 0.09), ("la8", 0.06)])
def test_a_level_of_an_octave_leaks_as_its_filter_does(filter: str, above: float) -> None:
    """Level over the octave's mean density: 1 for white noise, more where the spectrum falls by f^-2."""
    scales, rate = 2 ** np.arange(4, 9), 100.0
    for process, expected in ((WN(0.1), 0.0), (RW(0.1), above)):
        level = scales * expected_variance(process, filter, scales, 1.0 / rate) / rate
        mean = [process.psd(np.linspace(rate / (2 * s), rate / s, 4001), 1.0 / rate).mean() for s in scales]
        np.testing.assert_allclose(level / mean - 1.0, expected, atol=0.01)
