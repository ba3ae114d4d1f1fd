"""Readings of exact curves and findings of long signals, as they are."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from insemu import variance as v
from insemu.noise import BI, DR, GM, QN, RW, WN, NoiseModel
from insemu.variance import findings, reading
from insemu.variance.edof import NoiseType
from tests.pins import differences, kept, numbers, plain
from tests.test_variance_exact import EXACT, curve

MODELS: dict[str, NoiseModel] = {
    **{name: model for name, (model, _) in EXACT.items()},
    "hump": WN(2e-5) + GM(3e-4, 1 / 20.0),
    "two humps": WN(2e-5) + GM(3e-4, 1 / 5.0) + GM(8e-4, 1 / 300.0),
    "flicker": WN(2e-4) + BI(1e-4),
    "flicker and walk": WN(2e-4) + BI(1e-4) + RW(1e-6),
    "hidden hump": WN(2e-4) + GM(1e-4, 1 / 50.0) + RW(4e-6),
    "all": QN(4e-6) + WN(2e-4) + GM(1e-4, 1 / 50.0) + RW(4e-6) + DR(1e-7),
    "slow hump": WN(2e-5) + GM(3e-4, 1 / 300.0),
    "slower hump": WN(2e-5) + GM(3e-3, 1 / 3000.0),
    "flat first": NoiseModel((GM(1e-3, 1 / 0.05),)),
}


def _cases() -> dict[str, Callable[[], Any]]:
    out: dict[str, Callable[[], Any]] = {}
    for name, model in MODELS.items():
        for octaves, most in ((11, 1e4), (16, 300.0)):
            out[f"{name} {octaves}"] = lambda model=model, octaves=octaves, most=most: v.read_curve(
                curve(model, octaves, most=most), "rad/s"
            )
    out["ends"] = lambda: [
        reading._end(lambda x: (x / 0.3) ** 2, a, reach, tail)
        for a in (1.0, 5.0)
        for reach in (0.5, 3.0)
        for tail in (0.025, 0.975)
    ]
    target, beside = numbers(12, 3), np.abs(np.column_stack([numbers(12, 4), numbers(12, 5)]))
    out["likely"] = lambda: [
        reading._likely(target, beside, 6.0 * target + size * beside[:, 0] + numbers(12, 6)) for size in (0.0, 4.0)
    ]
    out["octaves"] = lambda: [
        v.octave_psd(v.wavelet_variance(numbers(500, 3), 20.0)),
        NoiseType([("WN", 0.0, 1.0), ("GM", 5.0, 2.0)], np.zeros((2, 0))).variance(np.array([1.0, 2.0, 8.0])),
    ]
    big = np.round(30.0 * numbers(450_001, 9))
    out["total"] = lambda: [
        v.allan_variance(numbers(1024, 3), kind="total", grid=[1, 2, 63, 64, 65, 128, 256, 400, 500, 512]),
        v.allan_variance(np.cumsum(numbers(1024, 3)), kind="total", grid=[1, 2, 63, 64, 65, 128, 256, 400, 500, 512]),
    ]
    out["long"] = lambda: [
        findings.resolution(big, "rad/s"),
        findings.resolution(big / 30.0, ""),
        findings.resolution(np.clip(big, -20, 25), "rad/s"),
    ]
    return out


SIZES = (0.3, 0.42, 0.6, 0.8, 1.1, 1.5, 2.1, 3.0, 4.2)


def _graded() -> dict[str, Callable[[], Any]]:
    """Disturbances of growing size: a bound that moved by half names another one first."""
    n, rate = 8192, 20.0
    x, t = numbers(n, 21), np.arange(n) / rate
    step = (np.arange(n) > 3000) * 1.0
    made: dict[str, Callable[[float], Any]] = {
        "warm-up": lambda a: x + 1.5 * a * np.exp(-t / 12.0),
        "shift": lambda a: x + 0.25 * a * step,
        "louder": lambda a: x * (1.0 + 0.12 * a * (t > 100.0) * (t < 130.0)),
        "counts": lambda a: np.round(x / a) * a,
        "saturated": lambda a: np.clip(x, -3.2 + 0.25 * a, 3.3 - 0.2 * a),
        "saturated counts": lambda a: np.clip(np.round(3.0 * x), -9.5 + 1.2 * a, 20.0),
        "stuck": lambda a: np.where((t > 50.0) & (t < 50.0 + 0.9 * a), 0.25, x),
        "tone": lambda a: x + 0.06 * a * np.sin(2.0 * np.pi * 6.1 * t),
        "wandering tone": lambda a: x + 0.3 * a * np.sin(2.0 * np.pi * 6.1 * (t + 0.02 * a * np.sin(0.3 * t))),
        "outliers": lambda a: x + 3.0 * a * (np.arange(n) % 701 == 11),
        "many outliers": lambda a: x + 8.0 * (numbers(n, 5) > 3.2 - 0.4 * a),
    }
    out: dict[str, Callable[[], Any]] = {
        f"graded {name}": lambda signal=signal: [
            [findings.stationarity(y, rate, "rad/s"), findings.resolution(y, ""), findings.lines(y, rate, "rad/s")]
            for y in map(signal, SIZES)
        ]
        for name, signal in made.items()
        if "outliers" not in name
    }
    for name in ("outliers", "many outliers", "counts", "shift"):
        out[f"graded robust {name}"] = lambda signal=made[name]: [
            (
                r.value,
                r.edof,
                r.efficiency,
                r.contaminated,
                r.protected,
                v.compare_with_robust(v.wavelet_variance(y), r),
            )
            for y in map(signal, SIZES)
            for r in (v.robust_wavelet_variance(y),)
        ]
    mixed: dict[str, Callable[[float], NoiseModel]] = {
        "walk": lambda a: WN(2e-4) + RW(3e-6 * a),
        "hump": lambda a: WN(2e-4) + GM(6e-5 * a, 1 / 20.0),
        "hump and walk": lambda a: WN(2e-4) + GM(1e-4, 1 / (20.0 * a**2)) + RW(3e-6),
        "flicker": lambda a: WN(2e-4) + BI(6e-5 * a),
        "rounding": lambda a: QN(2e-6 * a) + WN(2e-4),
        "drift": lambda a: WN(2e-4) + DR(4e-7 * a),
    }
    for name, model in mixed.items():
        out[f"graded {name}"] = lambda model=model: [
            {key: (r.value, r.low, r.high, r.note) for key, r in v.read_curve(curve(m, 14)).items()}
            for m in map(model, SIZES)
        ]
    other = numbers(n, 33)

    def likeness(a: float) -> list[Any]:
        same = v.same_model(v.wavelet_variance(x), v.wavelet_variance((1.0 + 0.02 * a) * other[:3000]))
        both = [
            v.wavelet_covariance(x[:2000], (0.03 * a * x + other)[:2000], rate, filter=f).__dict__
            for f in ("haar", "d4")
        ]
        return [same.__dict__, *both]

    out["graded likeness"] = lambda: [likeness(a) for a in SIZES[::2]]
    return out


CASES = _cases() | _graded()
KEPT = kept("exact")


@pytest.mark.parametrize("name", CASES)
def test_a_reading_is_as_it_was(name: str) -> None:
    assert not differences(plain(CASES[name]()), KEPT.get(name))
