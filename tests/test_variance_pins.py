"""Variances, spectra and findings of small signals, as they are."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, get_args

import numpy as np
import pytest
from numpy.typing import NDArray

from insemu import variance as v
from insemu.noise import AR1, DR, GM, QN, RW, WN
from insemu.variance import allan, edof, filtered, filters, findings, gaps, robust, wavelet
from tests.pins import differences, kept, numbers, plain
from tests.wavelet_oracles import model_covariance_of_filter

Array = NDArray[np.float64]
RATE = 20.0


@cache
def _signal(kind: str, n: int = 1200) -> Array:
    white = numbers(n, 3)
    walk = np.cumsum(numbers(n, 5))
    quantized = np.diff(numbers(n + 1, 7))
    x = {
        "white": white,
        "walk": white + 0.1 * walk,
        "quantized": quantized + 0.05 * white,
        "drift": white + 2e-2 * np.arange(n) + 0.02 * walk,
        "flat": white + 0.05 * walk - 0.05 * np.convolve(walk, np.ones(60) / 60.0, "same"),
        "spikes": white + 25.0 * (np.arange(n) % 97 == 11),
        "counts": np.round(2.0 * white) * 0.25,
    }.get(kind)
    if x is None:
        x = _signal(kind.removesuffix(" lost"), n).copy()
        x[n // 5 : n // 4] = np.nan
        x[n // 2 :: 41] = np.nan
    return x


KINDS = ("white", "walk", "quantized", "drift", "flat", "spikes")
MODELS = {
    "white": WN(0.1),
    "quantized": QN(1e-3) + WN(0.02),
    "slow": WN(0.1) + GM(0.2, 0.05) + RW(0.01),
    "fast": GM(1.0, 8.0) + AR1(-0.4, 0.3, RATE),
}
SCALES = 2.0 ** np.arange(1, 8)


def _noise(kind: str, *, drift: bool = False) -> edof.NoiseType:
    curve = v.wavelet_variance(_signal(kind), RATE)
    return edof.noise_type(curve.scale_samples, curve.value, 1200, drift=drift)


def _curve(kind: str, **given: Any) -> Any:
    return plain(v.wavelet_variance(_signal(kind), RATE, **given))


def _curves() -> dict[str, Callable[[], Any]]:
    out: dict[str, Callable[[], Any]] = {}
    for kind in (*KINDS, "walk lost", "white lost", "drift lost"):
        lost = kind.endswith(" lost")
        out[f"wavelet {kind}"] = lambda kind=kind, lost=lost: _curve(kind, gaps=lost)
        out[f"wavelet d4 {kind}"] = lambda kind=kind, lost=lost: _curve(kind, gaps=lost, filter="d4", confidence=0.9)
        out[f"allan {kind}"] = lambda kind=kind, lost=lost: v.allan_variance(_signal(kind), RATE, gaps=lost)
        out[f"readings {kind}"] = lambda kind=kind, lost=lost: v.read_curve(
            v.allan_variance(_signal(kind), RATE, gaps=lost), "rad/s"
        )
    for kind in KINDS:
        out[f"robust {kind}"] = lambda kind=kind: v.robust_wavelet_variance(_signal(kind), RATE)
        out[f"robust fixed {kind}"] = lambda kind=kind: v.robust_wavelet_variance(
            _signal(kind), RATE, adaptive=False, efficiency=0.8, levels=5, confidence=0.8
        )
        out[f"contaminated {kind}"] = lambda kind=kind: v.compare_with_robust(
            v.wavelet_variance(_signal(kind), RATE, levels=7), v.robust_wavelet_variance(_signal(kind), RATE, levels=7)
        )
        out[f"noise type {kind}"] = lambda kind=kind: (_noise(kind), _noise(kind, drift=True))
        out[f"octaves {kind}"] = lambda kind=kind: (
            edof.octave_correlation(_noise(kind), 2.0 ** np.arange(9)),
            v.correlated_octaves(2.0 ** np.arange(9), v.wavelet_variance(_signal(kind), RATE).value[:9], 1200),
        )
        for order in (2, 3):
            for averaged in (False, True):
                out[f"scatter {kind} {order} {averaged}"] = lambda kind=kind, order=order, averaged=averaged: (
                    edof.scatter_of_noise(_noise(kind), SCALES, 1200, order=order, averaged=averaged),
                    edof.scatter_of_noise(
                        _noise(kind), SCALES, 1200, order=order, averaged=averaged, stride=SCALES // 2
                    ),
                )
        out[f"scatter d4 {kind}"] = lambda kind=kind: filtered.scatter_of_filter(_noise(kind), "d4", 6, 1200)
    for option in ("eta3", "normal"):
        out[f"wavelet intervals {option}"] = lambda option=option: _curve("walk", intervals=option)
    out["wavelet own edof"] = lambda: _curve("walk", levels=3, edof=[5.0, 9.0, 200.0])
    return out


def _allans() -> dict[str, Callable[[], Any]]:
    out: dict[str, Callable[[], Any]] = {}
    for kind in get_args(allan.Kind):
        for grid in get_args(allan.Grid):
            out[f"grid {kind} {grid}"] = lambda kind=kind, grid=grid: _or_refused(
                lambda: allan.averaging_grid(1200, kind, grid)  # type: ignore[arg-type]
            )
        for signal in ("walk", "drift", "quantized"):
            out[f"allan {kind} {signal}"] = lambda kind=kind, signal=signal: _or_refused(
                lambda: v.allan_variance(_signal(signal), RATE, kind=kind, grid=[1, 2, 3, 7, 20, 100])  # type: ignore[arg-type]
            )
    for intervals in get_args(allan.AllanIntervals):
        out[f"allan intervals {intervals}"] = lambda intervals=intervals: _or_refused(
            lambda: v.allan_variance(_signal("walk"), RATE, intervals=intervals, confidence=0.68)
        )
    out["relative error"] = lambda: v.relative_error(1200, [1, 2, 8, 100, 500])
    return out


def _or_refused(call: Callable[[], Any]) -> Any:
    try:
        return plain(call())
    except ValueError as error:
        return f"{type(error).__name__}: {error}"


def _spectra() -> dict[str, Callable[[], Any]]:
    out: dict[str, Callable[[], Any]] = {}
    for method in ("welch", "multitaper", "periodogram"):
        out[f"psd {method}"] = lambda method=method: _or_refused(lambda: v.psd(_signal("walk"), RATE, method=method))
        out[f"psd short {method}"] = lambda method=method: _or_refused(
            lambda: v.psd(_signal("walk")[:333], RATE, method=method, segment=64, bandwidth=3.0, confidence=0.9)
        )
    whole = lambda: v.psd(_signal("walk"), RATE)  # noqa: E731
    out |= {
        "psd decades": lambda: (v.average_frequencies(whole()), v.average_frequencies(whole(), 3)),
        "psd octaves": lambda: v.average_octaves(whole(), RATE),
        "psd one-sided": lambda: whole().psd_one_sided,
        "psd of a curve": lambda: v.octave_psd(v.wavelet_variance(_signal("walk"), RATE)),
        "autocorrelation": lambda: (
            v.autocorrelation(_signal("walk"), RATE),
            v.autocorrelation(_signal("walk"), RATE, max_lag_s=3.0),
        ),
    }
    return out


def _models() -> dict[str, Callable[[], Any]]:
    out: dict[str, Callable[[], Any]] = {}
    for name, model in MODELS.items():
        stationary = model.stationary if hasattr(model, "stationary") else True
        out[f"expected {name}"] = lambda model=model: [
            v.expected_variance(model, f, SCALES, 1.0 / RATE) for f in ("haar", "d4", "la8")
        ]
        if stationary:
            gamma = lambda lags, model=model: model.autocovariance(lags, 1.0 / RATE)  # noqa: E731
            out[f"level 1 {name}"] = lambda gamma=gamma: v.level1_autocovariance(300, autocovariance=gamma)
            out[f"covariance {name}"] = lambda gamma=gamma: (
                v.model_covariance(v.level1_autocovariance(300, autocovariance=gamma)),
                v.model_covariance(
                    v.level1_autocovariance(300, autocovariance=gamma), levels=4, n_samples=200, drift_per_sample=0.01
                ),
            )
            out[f"edof {name}"] = lambda gamma=gamma, model=model: [
                v.model_edof(
                    v.level1_autocovariance(300, autocovariance=gamma),
                    model.wavelet_variance(SCALES[:6], 1.0 / RATE),
                    drift_per_sample=slope,
                )
                for slope in (0.0, 0.01)
            ]
            out[f"covariance d4 {name}"] = lambda gamma=gamma: model_covariance_of_filter(
                gamma, 200, filter="d4", levels=3
            )
        out[f"filter covariance {name}"] = lambda model=model: v.filter_covariance(
            WN(0.0) + model, "d4", SCALES[:5], 600, 1.0 / RATE
        )
    out["covariance of a signal"] = lambda: (
        v.wv_covariance(_signal("walk")),
        v.wv_covariance(_signal("walk"), filter="d4", levels=4),
    )
    out["level 1 of a spectrum"] = lambda: (
        v.level1_autocovariance(200, psd=lambda f: MODELS["slow"].psd(f, 1.0 / RATE), rate_hz=RATE),
        v.level1_autocovariance(
            200, increments=lambda lags: np.where(np.asarray(lags) == 0, 2.0, -0.3 / (1.0 + np.abs(lags)))
        ),
    )
    out["filters"] = lambda: {name: filters.modwt_filters(name) for name in filters.FILTERS}
    out["biweight"] = lambda: [robust.biweight_constants(e) for e in (0.4, 0.6, 0.8, 0.99)]
    return out


def _rest() -> dict[str, Callable[[], Any]]:
    value, freedom = np.array([1.0, 2.0, 0.5]), np.array([1.5, 12.0, 400.0])
    scatter = edof.Scatter(freedom, np.array([1.0, 1.7, 3.0]), np.array([0.0, -0.6, 0.9]))
    pieces = [1, 2, 60, 500, 37, 600]

    def pushed() -> Any:
        found = v.HaarAccumulator(levels=9, full_overlap=3)
        for piece in np.split(_signal("walk"), np.cumsum(pieces)[:-1]):
            found.push(piece)
        return found.result()

    def streamed(**given: Any) -> Any:
        return v.stream_wavelet_variance(iter(np.split(_signal("walk"), np.cumsum(pieces)[:-1])), RATE, **given)

    return {
        "interval": lambda: [
            edof.chi_square_interval(value, freedom, 0.9, kind)  # type: ignore[arg-type]
            for kind in ("edof", "eta3", "normal")
        ],
        "interval of a scatter": lambda: edof.chi_square_interval(value, freedom, 0.9, scatter=scatter),
        "eta3": lambda: (v.eta3(SCALES, 100), v.eta3(SCALES, 100, 8)),
        "levels": lambda: [wavelet.max_levels(n, length) for n in (2, 7, 8, 100, 1024) for length in (2, 4, 8)],
        "coefficients": lambda: (
            v.wavelet_coefficients(_signal("walk")[:70]),
            v.wavelet_coefficients(_signal("walk")[:90], filter="d4", levels=2),
        ),
        "pieces": pushed,
        "stream": lambda: (streamed(), streamed(levels=5, intervals="eta3", confidence=0.8)),
        "long stream": lambda: v.stream_wavelet_variance(
            iter(np.split(_signal("walk", 40_000), [1, 4097, 9000, 9001, 30_000])), RATE, full_overlap=4096
        ),
        "cross": lambda: [
            v.wavelet_covariance(_signal("walk"), _signal("walk") * 0.3 + _signal("quantized"), RATE, **given)
            for given in ({}, {"filter": "d4", "levels": 4, "confidence": 0.8})  # type: ignore[arg-type]
        ],
        "cross of strangers": lambda: v.wavelet_covariance(_signal("white"), _signal("quantized"), RATE),
        "same model": lambda: [
            v.same_model(v.wavelet_variance(_signal("walk"), RATE), v.wavelet_variance(_signal(other), RATE))
            for other in ("walk", "white", "flat")
        ],
        "gaps": lambda: (
            gaps.haar_with_gaps(_signal("walk lost"), 0.1, 8),
            gaps.filter_with_gaps(_signal("walk lost"), 0.1, "d4", gaps.haar_with_gaps(_signal("walk lost"), 0.1, 8)),  # type: ignore[arg-type]
            gaps.haar_with_gaps(_signal("quantized lost"), 0.0, 8),
        ),
        "characterised": lambda: {
            kind: v.characterise(_signal(kind, 4000), RATE, name="gyro_x", unit="rad/s").to_json()
            for kind in ("walk", "spikes", "counts", "flat lost")
        },
        "characterised otherwise": lambda: [
            v.characterise(_signal("spikes"), RATE, unit="m/s^2", from_robust=True).to_json(),
            v.characterise(_signal("walk"), RATE, filter="d4").to_json(),
            str(v.characterise(_signal("walk"), RATE, name="a", unit="rad/s")),
        ],
        "characterised stream": lambda: v.characterise_stream(
            lambda: iter(np.array_split(_signal("walk", 4000), 7)), RATE, name="b", unit="rad/s", keep=2500
        ).to_json(),
        "durations": lambda: [v.duration(s) for s in (1e-3, 0.5, 1.0, 59.0, 61.0, 3599.0, 3601.0, 9e4, 4e5, 1e8)],
    }


def _said() -> dict[str, Callable[[], Any]]:
    """What is said of signals with something in them, and what is refused."""
    n = 8192
    white = lambda: numbers(n, 11)  # noqa: E731
    t = np.arange(n) / RATE
    made: dict[str, Callable[[], Array]] = {
        "nothing": white,
        "warm-up": lambda: white() + 3.0 * np.exp(-t / 20.0),
        "shift": lambda: white() + 2.0 * (t > 300.0),
        "louder": lambda: white() * (1.0 + (t > 250.0) * (t < 310.0)),
        "counts": lambda: np.round(0.7 * white()) * 0.01,
        "fine counts": lambda: np.round(40.0 * white()) * 0.01,
        "saturated": lambda: np.clip(white(), -1.5, 2.0),
        "saturated counts": lambda: np.clip(np.round(3.0 * white()), -4.0, 5.0),
        "stuck": lambda: np.where((t > 100.0) & (t < 103.0), 0.25, white()),
        "constant": lambda: np.full(n, 0.5),
        "tone": lambda: white() + 0.3 * np.sin(2.0 * np.pi * 6.1 * t),
        "tones": lambda: white() + sum(0.4 * np.sin(2.0 * np.pi * f * t) for f in (4.4, 6.1, 7.7, 9.2)),
    }
    out: dict[str, Callable[[], Any]] = {
        f"finding {name}": lambda signal=signal: (
            findings.stationarity(signal(), RATE, "rad/s"),
            findings.resolution(signal(), "rad/s"),
            findings.lines(signal(), RATE, "rad/s"),
        )
        for name, signal in made.items()
    }
    x = np.arange(20.0)
    x[[3, 11, 12]] = np.nan
    axes = [f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"]
    out |= {
        "finding missing": lambda: (
            findings.missing_values(x, RATE),
            findings.missing_values(np.ones(3), RATE),
            findings.longest_good_part([x, np.ones(20)], [15, 6]),
            findings.gap_report([(5, 0.3), (9, 2.0), (12, 0.2)], RATE),
        ),
        "finding units": lambda: [
            findings.unit_report(
                dict(zip(axes, (*turn, *pull), strict=True)), dict.fromkeys(axes, white), dict.fromkeys(axes, said)
            )
            for turn in ((1e-3, 2e-3, -1e-3), (0.1, 0.3, 4.0))
            for pull in ((0.0, 0.1, -9.81), (0.0, 0.0, 1.0), (0.0, 0.0, 32.0), (0.0, 0.0, 981.0), (0.0, 0.0, 9.3))
            for white in (1e-4, 0.5)
            for said in ("", "rad/s")
        ],
    }
    y = _signal("white")
    calls: dict[str, Callable[[], Any]] = {
        "confidence": lambda: v.wavelet_variance(y, RATE, confidence=1.0),
        "no confidence": lambda: v.wavelet_variance(y, RATE, confidence=0.0),
        "intervals": lambda: v.wavelet_variance(y, RATE, intervals="x"),  # type: ignore[arg-type]
        "filter": lambda: v.wavelet_variance(y, RATE, filter="d5"),
        "levels": lambda: v.wavelet_variance(y, RATE, levels=0),
        "many levels": lambda: v.wavelet_variance(y, RATE, levels=20),
        "rate": lambda: v.wavelet_variance(y, 0.0),
        "two columns": lambda: v.wavelet_variance(np.ones((4, 2)), RATE),
        "short": lambda: v.wavelet_variance(np.ones(1), RATE),
        "missing": lambda: v.wavelet_variance(_signal("white lost"), RATE),
        "edof": lambda: v.wavelet_variance(y, RATE, edof=[1.0]),
        "efficiency": lambda: v.robust_wavelet_variance(y, RATE, efficiency=1.0),
        "grid": lambda: v.allan_variance(y, RATE, grid=[0, 3]),
        "long grid": lambda: v.allan_variance(y, RATE, grid=[5000]),
        "grid name": lambda: v.allan_variance(y, RATE, grid="x"),  # type: ignore[arg-type]
        "kind": lambda: v.allan_variance(y, RATE, kind="x"),  # type: ignore[arg-type]
        "method": lambda: v.psd(y, RATE, method="x"),  # type: ignore[arg-type]
        "segment": lambda: v.psd(y, RATE, segment=3),
        "long segment": lambda: v.psd(y, RATE, segment=5000),
        "decade": lambda: v.average_frequencies(v.psd(y, RATE), 0),
        "lag": lambda: v.autocorrelation(y, RATE, max_lag_s=100.0),
        "short lag": lambda: v.autocorrelation(y, RATE, max_lag_s=0.01),
        "constant": lambda: v.autocorrelation(np.ones(50), RATE),
        "same of other rates": lambda: v.same_model(v.wavelet_variance(y, RATE), v.wavelet_variance(y, 2.0 * RATE)),
        "same of short": lambda: v.same_model(v.wavelet_variance(y[:6], RATE), v.wavelet_variance(y, RATE)),
        "constant cross": lambda: v.wavelet_covariance(y, np.ones(y.size), RATE),
        "other scales": lambda: v.compare_with_robust(
            v.wavelet_variance(y, RATE, levels=3), v.robust_wavelet_variance(y, RATE)
        ),
        "lags of a model": lambda: v.model_covariance(np.ones(10), n_samples=50),
        "kind of numbers": lambda: v.wavelet_variance(np.array(["a", "b", "c"]), RATE),  # type: ignore[arg-type]
        "grid of lost": lambda: v.allan_variance(_signal("white lost"), RATE, gaps=True, grid="all"),
        "intervals of allan": lambda: v.allan_variance(y, RATE, intervals="x"),  # type: ignore[arg-type]
        "overlap": lambda: v.stream_wavelet_variance(iter([y]), RATE, full_overlap=5000),
        "small overlap": lambda: v.stream_wavelet_variance(iter([y]), RATE, full_overlap=2048),
        "bandwidth": lambda: v.psd(y, RATE, method="multitaper", bandwidth=0.5),
        "lengths": lambda: v.wavelet_covariance(y, y[1:], RATE),
        "robust of lost": lambda: v.characterise(_signal("white lost"), RATE, from_robust=True),
        "signals": lambda: v.expected_variance(WN(0.1) + DR(1.0), "la8", SCALES),
        "model": lambda: v.level1_autocovariance(100),
        "two models": lambda: v.level1_autocovariance(
            100, autocovariance=lambda k: k * 0.0, increments=lambda k: k * 0.0
        ),
    }
    out |= {f"refused {name}": lambda call=call: _or_refused(call) for name, call in calls.items()}
    return out


CASES = {**_curves(), **_allans(), **_spectra(), **_models(), **_rest(), **_said()}
KEPT = kept("variance")


@pytest.mark.parametrize("name", CASES)
def test_a_result_is_as_it_was(name: str) -> None:
    assert not differences(plain(CASES[name]()), KEPT.get(name))


def test_refusals_are_refusals() -> None:
    for name, said in KEPT.items():
        if name.startswith("refused "):
            assert str(said).startswith("InputError: "), name
