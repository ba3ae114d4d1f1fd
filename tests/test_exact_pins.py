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
    out["long"] = lambda: [
        findings.resolution(big, "rad/s"),
        findings.resolution(big / 30.0, ""),
        findings.resolution(np.clip(big, -20, 25), "rad/s"),
    ]
    return out


CASES = _cases()
KEPT = kept("exact")


@pytest.mark.parametrize("name", CASES)
def test_a_reading_is_as_it_was(name: str) -> None:
    assert not differences(plain(CASES[name]()), KEPT.get(name))
