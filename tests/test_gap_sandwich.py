"""Evidence and intervals where what is left of the innovations is not independent, as in every real recording."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.stats
from numpy.typing import NDArray
from scipy.signal import lfilter

from benchmarks.foreign import sensors
from benchmarks.foreign.judge import taken
from insemu.gap.candidates.robust import doubted_last, excess_of, is_lasting, too_much
from insemu.gap.candidates.shapes import bank, linear_hypotheses
from insemu.gap.candidates.unexplained import Unexplained
from insemu.gap.drive.preparation import Flown
from insemu.gap.drive.scene import Scene
from insemu.gap.evidence.linear import Field
from insemu.gap.evidence.sandwich import STRETCHES, excess
from insemu.gap.policy import rules

Array = NDArray[np.float64]
T = np.arange(3000.0)
#: Autocorrelation of errors that hang together for about ten fixes.
RHO = 0.9


def hanging(rng: np.random.Generator, n: int) -> Array:
    """Autoregressive errors (n,) of variance one."""
    white = math.sqrt(1.0 - RHO**2) * rng.standard_normal(n + 200)
    return np.asarray(lfilter([1.0], [1.0, -RHO], white)[200:])


def turning(rng: np.random.Generator) -> Array:
    """A shape (3000,) that goes on for some fixes at a time, as one that goes with turns does."""
    return np.repeat(rng.choice([-1.0, 0.0, 1.0], T.size // 15), 15)


def test_independent_errors_leave_evidence_as_it_is() -> None:
    runs = 400
    above = 0
    for seed in range(runs):
        rng = np.random.default_rng([31, seed])
        above += excess(turning(rng), rng.standard_normal(T.size), T, 1.0) > 1.0
    # each division may say so by chance once in twenty times: as many or more once in a thousand runs of this test
    assert above <= scipy.stats.binom.ppf(0.999, runs, len(STRETCHES) * rules().doubt)


def test_errors_that_hang_together_widen_intervals_to_what_they_are() -> None:
    """A shape that turns every 15 fixes hardly averages errors that hang together for ten."""
    runs, size = 300, 0.2
    plain = robust = 0
    for seed in range(runs):
        rng = np.random.default_rng([32, seed])
        shape = turning(rng)
        y = size * shape + hanging(rng, T.size)
        information = float(shape @ shape)
        found = float(shape @ y) / information
        off = abs(found - size) * math.sqrt(information) / 1.96
        factor = excess(shape, y - found * shape, T, 1.0)
        plain += off < 1.0
        robust += off < math.sqrt(factor)
    # the variance of a sum of 15 such errors is 9.5 times that of 15 independent ones: 1.96 of theirs hold 0.48, and 300 runs scatter by 0.03
    assert plain < 0.6 * runs
    # 0.95, less four times what 300 runs scatter by and what a factor that is sure leaves out
    assert robust > 0.88 * runs


def test_one_stretch_of_a_shape_says_little() -> None:
    """Whatever is left there, it may be chance: the factor is over what a single square reaches once in twenty times."""
    shape = np.where((T >= 1000.0) & (T < 1010.0), 1.0, 0.0)
    left = np.where(shape > 0.0, 2.0, 0.0)
    most = float(np.sum(shape * left)) ** 2 / float(shape @ shape)
    assert excess(shape, left, T, 1.0) == pytest.approx(most / scipy.stats.chi2.isf(rules().doubt, 1.0))
    assert excess(shape, 0.5 * left, T, 1.0) == pytest.approx(
        max(1.0, 0.25 * most / scipy.stats.chi2.isf(rules().doubt, 1.0))
    )
    assert excess(0.0 * shape, left, T, 1.0) == 1.0


@pytest.mark.slow(reason="a whole search of a drive, whose parts have quick tests")
def test_an_effect_that_holds_in_places_only_is_not_held() -> None:
    """A drive whose innovations follow a scale factor all along, and one that they follow both ways in turns: as much evidence, not as sure."""
    scene = Scene.of(Flown.of(*taken(sensors.draw_world(500046, 360.0, True), ())).prepared)
    data, rng = scene.field(None), np.random.default_rng(33)
    own = next(v for v in bank(scene) if v.effect == "scale_factor" and v.sensor == "accel" and len(v.axes) == 1)
    shape = data.G[:, own.index[0]] / np.linalg.norm(data.G[:, own.index[0]])
    noise = math.sqrt(data.variance) * rng.standard_normal(data.y.size)
    turns = np.where(np.floor(scene.rows_t / 8.0) % 2 == 0, 40.0, -28.0)
    rows = np.ones(data.y.size, dtype=bool)
    for y, sure in ((noise + 12.0 * shape, True), (noise + turns * shape, False)):
        of = Field(y, data.G, data.variance)
        (h,) = linear_hypotheses(scene, [own], of, [], set())
        assert is_lasting(h) and h.nats > 6.0
        beside = Unexplained(scene, of, rows, [])
        (kept,) = doubted_last(beside, [h], 3.0)
        assert (kept is h) == sure
        assert (excess_of(beside, h) < 1.5) == sure
        assert kept.nats == pytest.approx(h.nats if sure else h.nats - too_much(beside, h))
