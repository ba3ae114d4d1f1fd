"""Which effects a recording cannot tell apart."""

from __future__ import annotations

import numpy as np
import pytest

from insemu.gap.candidates.shapes import Variant
from insemu.gap.confusion import Repetitions
from insemu.gap.evidence.linear import Block, Field
from insemu.gap.policy import rules

ROWS = 400
KEYS = ("twin", "half", "far")


def field(rng: np.random.Generator) -> Field:
    """An effect, a rival of the same shape, one that shares half of it and one that shares nothing."""
    Q = np.linalg.qr(rng.standard_normal((ROWS, 3)))[0]
    half = np.sqrt(0.5) * (Q[:, 0] + Q[:, 1])
    return Field(rng.standard_normal(ROWS), np.stack([Q[:, 0], Q[:, 0], half, Q[:, 2]], axis=1))


def variants() -> list[Variant]:
    unit, amplitudes = (((), np.array([[3.0]])),), np.array(rules().prior_scales)
    return [Variant(k, "gyro", (), "", np.array([i]), unit, amplitudes) for i, k in enumerate(("own", *KEYS))]


def shares(nats: float, given: tuple[Block, ...] = ()) -> dict[str, float]:
    rng = np.random.default_rng(1)
    repeated = Repetitions.of(field(rng), rng, 400)
    out = repeated.shares(variants(), np.array([0]), np.array([np.sqrt(2.0 * nats)]), given)
    return {effect: share for (effect, _), share in out.items()}


def test_a_twin_is_always_confused_and_what_shares_nothing_never() -> None:
    found = shares(20.0)
    assert found["own"] == found["twin"] > 0.99
    assert found["far"] == 0.0


@pytest.mark.parametrize(("nats", "low", "high"), [(8.0, 0.15, 0.36), (20.0, 0.01, 0.12), (60.0, 0.0, 0.0)])
def test_a_rival_that_shares_half_is_confused_less_the_stronger_the_effect(
    nats: float, low: float, high: float
) -> None:
    # it is behind by half the nats, with a variance of twice that: below 3 in 0.36, 0.06 and none of the repetitions, less where it
    # is worth nothing itself
    assert low <= shares(nats)["half"] <= high


def test_where_nothing_is_worth_three_nats_nothing_is_found() -> None:
    assert max(shares(0.0).values()) < 0.05


def test_what_is_known_already_is_no_rival() -> None:
    known: Block = (np.array([2]), np.array([[100.0]]))
    assert shares(40.0, (known,))["half"] < 0.02 < shares(8.0)["half"]
