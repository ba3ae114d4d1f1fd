"""Known shapes in a log at rest: a ramp, and a bias that follows the temperature."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from insemu.effects import lagged
from insemu.errors import InputError
from insemu.gap.candidates.axis import (
    AxisHypothesis,
    AxisState,
    added,
)
from insemu.gap.data.log import Reduced, block_differences, reduce_again
from insemu.gap.evidence.linear import log_mean_exp
from insemu.gap.evidence.model import Likelihood, Regressors, fit
from insemu.gap.hypothesis import Hypothesis
from insemu.gap.policy import rules
from insemu.gap.verdict import Value

Array = NDArray[np.float64]


def regression(
    state: AxisState,
    effect: str,
    variant: str,
    names: Sequence[str],
    rebuild: Callable[[Reduced, Array | None], Array],
    scales: Array,
    unit: Sequence[str],
) -> list[AxisHypothesis]:
    """Signals of known shape beside the current explanation, their coefficients integrated out.

    Parameters
    ----------
    state : AxisState
        The axis with its current explanation.
    effect, variant : str
        Catalogue id, and which of its shapes.
    names : sequence of str
        Names of the k coefficients.
    rebuild : callable
        Makes the (blocks - 1, k) columns of a reduced log and its temperature (degC): block-mean differences of the signals.
    scales : (k,) array
        Prior standard deviations of the coefficients.
    unit : sequence of str
        Units of the coefficients.
    """
    regressors = Regressors(effect, tuple(names), rebuild(state.data, state.temperature), scales, rebuild)
    explanation = replace(state.explanation, regressors=(*state.explanation.regressors, regressors))
    likelihood = state.likelihood
    fitted = fit(likelihood, explanation)
    mean, covariance = likelihood.coefficients(fitted.explanation)
    k = len(names)
    sigma = np.sqrt(np.diag(covariance))[-k:]
    values = tuple(Value.normal(n, m, s, u) for n, m, s, u in zip(names, mean[-k:], sigma, unit, strict=True))
    return [Hypothesis(effect, fitted.evidence - state.fitted.evidence, values, added(state, fitted, effect), variant)]


def ramp(state: AxisState) -> list[AxisHypothesis]:
    """A drift in proportion to time."""
    data = state.data

    def column(where: Reduced, _: Array | None) -> Array:
        return np.full((where.differences.size, 1), where.block_s)

    scale = np.array([3.0 * state.block_sigma() / data.duration_s])
    return regression(state, "ramp", "", ("R",), column, scale, (f"{data.unit}/s",))


#: Shapes of a thermal bias.
THERMAL_SHAPES = ("linear", "cubic", "lagged", "cubic and lagged")
#: Thermal time constants that the lagged shapes try.
LAGS = 10


def temperature(state: AxisState) -> list[AxisHypothesis]:
    """A bias that follows the temperature: linearly, as a cubic, or through a thermal lag."""
    if state.temperature is None or "temperature" in state.named:
        return []
    data, T = state.data, state.temperature
    spread = float(np.std(T))
    if not spread > 1e-3:
        return []
    centre = float(np.mean(T))
    # each power is scaled so that its contribution at the edge of the range is as plausible as the linear one's
    size = 3.0 * max(state.block_sigma(), 0.1 * float(np.std(np.cumsum(data.differences))))
    scales = size / np.array([spread**k for k in (1, 2, 3)])
    names = ("c1", "c2", "c3")
    units = tuple(f"{data.unit}/K" + (f"^{k}" if k > 1 else "") for k in (1, 2, 3))
    reference = Value("T0", centre, centre, centre, "degC")

    def rebuilt(which: tuple[int, ...], lag: float) -> Callable[[Reduced, Array | None], Array]:
        def columns(where: Reduced, temperature_c: Array | None) -> Array:
            if temperature_c is None:
                raise InputError("the temperature effect needs the temperature of the data that it is to predict")
            d = temperature_c - centre
            seen = lagged(d, where.dt, lag)
            return block_differences(np.stack([_power(seen, k + 1) for k in which], axis=1), where.block)

        return columns

    def weigh(variant: str, which: tuple[int, ...], lag: float = 0.0) -> AxisHypothesis:
        chosen = list(which)
        w = regression(
            state, "temperature", variant, [names[k] for k in which], rebuilt(which, lag), scales[chosen],
            [units[k] for k in which],
        )[0]  # fmt: skip
        d = T - centre
        seen = lagged(d, data.dt, lag)
        signal = sum((v.value * _power(seen, k + 1) for v, k in zip(w.values, which, strict=True)), np.zeros(T.size))
        w = less(w, state, signal)
        return replace(w, values=(*w.values, reference))

    likelihood = state.likelihood

    def quick(which: tuple[int, ...], lag: float) -> float:
        """Evidence of a time constant at the present parameters of the noise, up to a constant."""
        own = Regressors("temperature", names, rebuilt(which, lag)(data, T), scales[list(which)])
        base = state.explanation
        return likelihood.low(replace(base, regressors=(*base.regressors, own)))

    out = [weigh("linear", (0,)), weigh("cubic", (0, 1, 2))]
    shapes: tuple[tuple[str, tuple[int, ...]], ...] = (("lagged", (0,)), ("cubic and lagged", (0, 1, 2)))
    for shape, which in shapes:
        grid = np.geomspace(data.block_s, rules().longest_lag * data.duration_s, LAGS)
        tried = [quick(which, float(lag)) for lag in grid]
        k = int(np.argmax(tried))
        top, lag, ratio = tried[k], float(grid[k]), float(grid[1] / grid[0])
        paid = top - log_mean_exp(tried)  # the time constant is paid for
        for _ in range(4):
            ratio = math.sqrt(ratio)
            top, lag = max([(top, lag), *((quick(which, lag * r), lag * r) for r in (1.0 / ratio, ratio))])
        best = weigh(shape, which, lag)
        values = (*best.values, Value("lag", lag, lag / ratio, lag * ratio, "s"))
        out.append(replace(best, nats=best.nats - paid, values=values))
    odds = dict(zip(THERMAL_SHAPES, rules().thermal_odds, strict=True))
    return [replace(w, nats=w.nats + math.log(odds[w.variant])) for w in out]


def _power(x: Array, k: int) -> Array:
    """Integer power by products: a general one takes ten times as long."""
    return x if k == 1 else np.asarray(x * _power(x, k - 1))


def less(w: AxisHypothesis, state: AxisState, signal: Array) -> AxisHypothesis:
    """A named signal taken out of the samples too, so that its fast part is explained as well; worth what the spectrum gains.

    Parameters
    ----------
    w : AxisHypothesis
        With the signal among its regressors.
    state : AxisState
        The axis before.
    signal : (n,) array
        In the unit of the axis.
    """
    if not state.data.f.size:
        return w
    apart = reduce_again(state.data, state.data.values - signal)
    explanation = w.change.explanation
    before, after = Likelihood(state.data).high(explanation), Likelihood(apart).high(explanation)
    if not after > before:
        return w
    data = replace(apart, differences=state.data.differences)  # the block band keeps the regressors
    fitted = fit(Likelihood(data), explanation)
    return replace(w, nats=w.nats + after - before, what=replace(w.change, data=data, fitted=fitted))
