"""Single samples that stand out: a mixture on the whitened samples of a log at rest, neighbours on those of a moving sensor."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.gap.candidates.axis import (
    AxisHypothesis,
    AxisState,
    cleaned,
    whitened,
)
from insemu.gap.candidates.noise import white_noise
from insemu.gap.data.counts import lattice
from insemu.gap.evidence.modes import Free, laplace, level
from insemu.gap.hypothesis import Hypothesis, Later
from insemu.gap.policy import rules
from insemu.gap.verdict import Value
from insemu.noise import WN

Array = NDArray[np.float64]
#: Steps in which the sizes of residuals up to 6 are counted.
STEPS = 240


def outliers(state: AxisState) -> list[AxisHypothesis]:
    """Heavy tails: a small share of samples with a larger spread, against a Gaussian whose level is free as a nominal one is."""
    if "outliers" in state.named or not state.data.f.size:
        return []
    if lattice(state.data.values) > 3.0 * state.white / math.sqrt(state.data.dt):
        return []  # counts wider than the noise are no Gaussian with tails
    r = np.abs(whitened(state))
    # in equal steps up to 6, then in growing ones up to the largest
    growing = np.concatenate([[6.0], np.geomspace(6.2, max(7.0, 1.01 * float(r.max())), 60)])
    place = (r * (STEPS / 6.0)).astype(np.int64)
    far = np.flatnonzero(place >= STEPS)
    place[far] = STEPS + np.maximum(np.searchsorted(growing, r[far], side="right") - 1, 0)
    count = np.asarray(np.bincount(place), dtype=np.float64)
    square = np.asarray(np.bincount(place, weights=r * r), dtype=np.float64)
    if not state.data.differences.size:
        # neighbours share noise: these residuals are worth 1 / (1 + 2 (2/3)^2 + 2 (1/6)^2) independent ones each
        count, square = count / 1.944, square / 1.944
    use = count > 0
    count, x2 = count[use], square[use] / count[use]
    c = next((c for c in state.explanation.components if isinstance(c.process, WN)), None)
    fitted_n = state.white
    box = next((f for f in c.free if f.name == "N"), None) if c else None
    box = box or level("N", fitted_n)
    spread = Free("spread", box.low / fitted_n, box.high / fitted_n, box.edge)
    free = (spread, Free("share", 1e-6, 0.2), Free("ratio", 2.5, 300.0))

    def gaussian(x: Array) -> float:
        s2 = math.exp(2.0 * x[0])
        return float(-0.5 * np.sum(count * (math.log(s2) + x2 / s2))) + spread.log_density(x[0])

    def mixture(x: Array) -> float:
        s2, e, k2 = math.exp(2.0 * x[0]), math.exp(min(x[1], -0.7)), math.exp(2.0 * x[2])
        narrow = math.log1p(-e) - 0.5 * x2 / s2
        wide = math.log(e) - 0.5 * math.log(k2) - 0.5 * x2 / (s2 * k2)
        value = float(np.sum(count * (np.logaddexp(narrow, wide) - 0.5 * math.log(s2))))
        return value + sum(f.log_density(v) for f, v in zip(free, x, strict=True))

    start = min(max(0.0, math.log(spread.low)), math.log(spread.high))
    null = laplace(gaussian, np.array([start]), free[:1])
    grid = [
        np.array([s, math.log(e), math.log(k)])
        for s in (start, -0.1)
        for e in np.geomspace(1e-5, 0.1, 7)
        for k in (3.0, 6.0, 15.0, 50.0)
    ]
    grid.sort(key=lambda x: -mixture(x))
    best = max((laplace(mixture, x, free) for x in grid[:2]), key=lambda m: m.evidence)
    # heavy tails are what a Gaussian of any level cannot do; what another level alone is worth is counted as the spectrum counts it
    broad = Free("spread", spread.low / 30.0, spread.high * 30.0)
    wide = laplace(lambda x: gaussian(x) - spread.log_density(x[0]) + broad.log_density(x[0]), null.x, (broad,))
    other_level = wide.evidence - null.evidence
    nats = best.evidence - max(wide.evidence, null.evidence)
    if other_level > 0.0:
        nats += min(other_level, max((w.nats for w in white_noise(state)), default=0.0))
        if best.evidence < wide.evidence:
            return []
    s, e, k = (math.exp(v) for v in best.x)
    if e > rules().most_outliers:
        return []  # two kinds of noise in turns, as a vehicle that stops and goes has, are no outliers
    sd = np.sqrt(np.diag(best.covariance))
    # the spread of what was added, as the table of effects states it
    size = s * math.sqrt(max(k * k - 1.0, 0.01)) * fitted_n / math.sqrt(state.data.dt)
    values = (
        Value.positive("probability", e, sd[1], "1"),
        Value.positive("sigma", size, sd[2], state.data.unit),
    )
    if nats < 0.0:
        return [Hypothesis("outliers", nats, values, state)]
    signed = whitened(state)
    odds = math.log(e / (1.0 - e) / k) + 0.5 * signed**2 / s**2 * (1.0 - 1.0 / k**2)
    outlying = odds > 0.0
    if not state.data.differences.size:
        return _outliers_in_motion(state, nats, signed, outlying, s)
    # an outlying sample is shrunk to the size of its neighbours, so that the level of the rest is what is left
    values_clean = state.data.values.copy()
    values_clean[outlying] -= (1.0 - 1.0 / k) * signed[outlying] * fitted_n / math.sqrt(state.data.dt)
    return [Hypothesis("outliers", nats, values, Later(lambda: cleaned(state, values_clean, "outliers")))]


def evident_outliers(state: AxisState) -> AxisHypothesis | None:
    """Outliers of a moving sensor so large that every other look at its spectrum would see them; ``None`` where there are no three of them.

    A single sample shows in the residual against its neighbours with twice the size and the opposite sign of what it leaves on either side.
    """
    r = whitened(state)
    size = np.abs(r)
    inner = np.arange(1, r.size - 1)
    at = inner[(size[1:-1] > rules().evident) & (size[1:-1] >= size[:-2]) & (size[1:-1] > size[2:])]
    if at.size < 3 or float(np.mean(size > rules().beside)) > 3.0 * rules().most_outliers:
        return None
    beside = -(r[at - 1] + r[at + 1]) / r[at]
    if float(np.mean(np.abs(beside - 1.0) < 0.5)) < rules().alike:
        return None
    found = _outliers_in_motion(state, 0.0, r, size > rules().beside, 1.0)
    if not found:
        return None
    share, sigma = (v.value for v in found[0].values)
    unit = state.data.values[1:-1] - 0.5 * (state.data.values[2:] + state.data.values[:-2])
    v = (sigma / (1.4826 * float(np.median(np.abs(unit))))) ** 2 + 1.0
    top = r[at]
    nats = float(np.sum(0.5 * top**2 * (1.0 - 1.0 / v))) + at.size * (math.log(share) - 0.5 * math.log(v))
    return replace(found[0], nats=nats)


def _outliers_in_motion(
    state: AxisState, nats: float, r: Array, outlying: NDArray[np.bool_], s: float
) -> list[AxisHypothesis]:
    """Outliers of a moving sensor, whose samples are held against their neighbours.

    One outlier shows in three residuals, so that only the largest of neighbours counts; share and size are those of a normal distribution of which
    only what lies beyond the least of them is seen.
    """
    size = np.abs(r)
    top = outlying.copy()
    top[1:] &= size[1:] >= size[:-1]
    top[:-1] &= size[:-1] > size[1:]
    at = np.flatnonzero(top)
    if at.size < 2:
        return []
    least, squares = float(size[at].min()), float(np.sum(r[at] ** 2))

    def seen(v: float) -> float:
        return math.erfc(least / math.sqrt(2.0 * v))

    def score(log_v: float) -> float:
        v = math.exp(log_v)
        return 0.5 * squares / v + at.size * (0.5 * log_v + math.log(max(seen(v), 1e-300)))

    mean = squares / at.size
    found = scipy.optimize.minimize_scalar(
        score, bounds=(math.log(0.02 * mean), math.log(2.0 * mean)), method="bounded"
    )
    v = math.exp(float(found.x))
    share = at.size / (r.size * seen(v))
    off = 1.96 / math.sqrt(at.size)
    values = state.data.values.copy()
    raw = np.zeros(r.size)
    raw[1:-1] = values[1:-1] - 0.5 * (values[2:] + values[:-2])
    unit = float(np.median(np.abs(raw[at]) / size[at]))
    sigma = unit * math.sqrt(max(v - s * s, 0.01))
    # shrunk to the size of its neighbours, as at rest
    values[at] -= (1.0 - min(s / math.sqrt(v), 1.0)) * raw[at]
    given = (
        Value("probability", share, share * math.exp(-off), share * math.exp(off), "1"),
        Value(
            "sigma",
            sigma,
            sigma * math.exp(-off / math.sqrt(2.0)),
            sigma * math.exp(off / math.sqrt(2.0)),
            state.data.unit,
        ),
    )
    return [Hypothesis("outliers", nats, given, Later(lambda: cleaned(state, values, "outliers")))]
