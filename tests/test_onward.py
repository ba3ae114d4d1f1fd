"""Draws in pieces: the numbers of a whole draw, whatever the lengths of the pieces."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from insemu.errors import InputError
from insemu.noise import AR, AR1, ARMA, BI, GM, MA, WN, NoiseModel, onward
from insemu.noise.process import PROCESSES

DT, N = 0.01, 3000
#: One of every family.
EACH = (
    *NoiseModel.parse(
        "WN(N=0.1) + QN(Q=0.01) + GM(sigma=0.3, Tc=2 s) + RW(K=0.2) + DR(R=0.1) + RC(sigma=2) + SIN(alpha=1, f=0.7 Hz) + BI(B=0.1) + "
        "PWC(sigma=1, T=0.073 s) + GM2(sigma=1, Tc=0.3 s)"
    ),
    AR1(0.9, 0.2, 100.0),
    AR((1.2, -0.5), sigma2=0.1, rate_hz=100.0),
    MA(ma=(0.5, 0.2), sigma2=0.3, rate_hz=100.0),
    ARMA((0.9,), (0.4,), 0.1, 100.0),
)


def drawn(source: onward.Source, ends: list[int]) -> np.ndarray:
    out = np.full(N, np.nan)
    for first, last in pairwise([0, *ends, N]):
        source(out[first:last])
    return out


def test_every_family_is_here() -> None:
    own = {symbol for symbol, family in PROCESSES.items() if family.__module__.startswith("insemu.")}
    assert {p.symbol for p in EACH} == own


@pytest.mark.parametrize("ends", [[1], [7, 7, 8, 1000], list(range(100, N, 100))])
def test_pieces_are_the_whole(ends: list[int]) -> None:
    """Copied arithmetic on copied numbers: equal to the bit, except that the processes of a sum are added in their own order."""
    whole: list[np.ndarray] = []
    NoiseModel(EACH).simulate(N, DT, np.random.default_rng(3), each=lambda place, part: whole.append(part.copy()))
    for source, one, process in zip(
        onward.sources(NoiseModel(EACH), N, DT, np.random.default_rng(3)), whole, NoiseModel(EACH), strict=True
    ):
        np.testing.assert_array_equal(drawn(source, ends), one, err_msg=process.symbol)


@pytest.mark.parametrize("ends", [[1], [999, 1000]])
def test_a_block_goes_on(ends: list[int]) -> None:
    """What a state block draws, white noise and states, does not depend on the pieces either."""
    block = (GM(1.0, 0.5) + WN(0.3)).block(DT)
    one, two = (onward.of_block(block, N, np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(drawn(one, ends), drawn(two, []))


def test_what_is_not_drawn_in_pieces_is_refused() -> None:
    with pytest.raises(InputError, match="BI is drawn as a whole"):
        BI(0.1).source(onward.MOST_HELD + 1, DT, np.random.default_rng(1))
    follows = NoiseModel.parse("WN(N=1, follows=temperature, slope=0.1, at=20)")
    with pytest.raises(InputError, match="follows a covariate"):
        onward.sources(follows, 10, DT, np.random.default_rng(1))
