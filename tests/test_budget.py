"""The statistical tests keep to one budget of false alarms, and drawing anew really draws anew."""

from __future__ import annotations

import numpy as np
import pytest

from tests.budget import (
    BUDGET,
    FRESH,
    binomial,
    binomial_power,
    chi_square,
    chi_square_power,
    collected,
    files,
    statistical,
)


def test_all_shares_together_are_within_the_budget(all_collected: list[pytest.Item]) -> None:
    here = {i.nodeid: i.function.stated for i in all_collected if hasattr(getattr(i, "function", None), "stated")}  # type: ignore[attr-defined]
    # a run of some files asks a process that collects all of them
    stated = here if set(files()) == {name.split("::")[0] for name in here} else collected()
    assert len(stated) > 40
    assert 0.0 < sum(s.share for s in stated.values()) <= BUDGET
    weak = [name for name, s in stated.items() if not (0 < s.share < 1 and s.cells >= 1 and s.power >= 0.8)]
    assert weak == []


def test_bounds_have_their_size_and_power() -> None:
    rng = np.random.default_rng(1)
    low, high = chi_square(40, 0.1, 2)
    right, loud = rng.chisquare(40, 20_000) / 40, 1.5 * rng.chisquare(40, 20_000) / 40
    assert np.mean((right < low) | (right > high)) == pytest.approx(0.05, abs=0.008)
    assert np.mean((loud < low) | (loud > high)) == pytest.approx(chi_square_power(40, 0.1, 2, 1.5), abs=0.015)
    least, most = binomial(200, 0.95, 0.1, 2)
    right, short = rng.binomial(200, 0.95, 20_000), rng.binomial(200, 0.9, 20_000)
    assert np.mean((right < least) | (right > most)) <= 0.05
    assert np.mean((short < least) | (short > most)) == pytest.approx(binomial_power(200, 0.95, 0.1, 2, 0.9), abs=0.015)


RNG = np.random.default_rng


def test_fresh_seeds_reach_every_generator_of_a_test(monkeypatch: pytest.MonkeyPatch) -> None:
    @statistical(1e-6, power=1.0)
    def draws() -> list[float]:
        child = np.random.SeedSequence(5).spawn(1)[0]
        return [np.random.default_rng(5).random(), RNG(5).random(), RNG(child).random(), RNG([5, 6]).random()]

    plain = draws()
    assert plain == draws()
    monkeypatch.setenv(FRESH, "3")
    fresh = draws()
    assert fresh == draws() and all(a != b for a, b in zip(plain[:3], fresh[:3], strict=True))
    monkeypatch.delenv(FRESH)
    assert draws() == plain
