"""An axis of a log at rest as the candidates see it, and what all of them share.

Each candidate is a function ``(AxisState) -> list[AxisHypothesis]``; a user's own joins through :func:`register`. Grids only find where to
start: every candidate is refined before it is compared (an unrefined one names the wrong effect).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.gap.data.log import Reduced, reduce_again
from insemu.gap.evidence.band import Band
from insemu.gap.evidence.model import (
    Component,
    Explanation,
    Fitted,
    Likelihood,
    fit,
)
from insemu.gap.evidence.modes import Free
from insemu.gap.evidence.rolloff import HALF_POWER
from insemu.gap.hypothesis import Hypothesis
from insemu.gap.policy import rules
from insemu.gap.verdict import Value
from insemu.noise import WN, Process

Array = NDArray[np.float64]
#: A start that refines to so many nats less than nothing ends a candidate: the next ones are worse.
HOPELESS = 4.0


@dataclass(frozen=True)
class AxisState:
    """What is known about one axis so far.

    Parameters
    ----------
    data : Reduced
        The reduced log, cleaned of what was named before (lines, outliers).
    fitted : Fitted
        The current explanation.
    temperature : (n,) array, optional
        degC at the samples.
    original : Reduced, optional
        Before cleaning; ``None`` where nothing was cleaned.
    named : tuple of str
        Effects named so far.
    """

    data: Reduced
    fitted: Fitted
    temperature: Array | None = None
    named: tuple[str, ...] = ()
    memory: dict[str, Any] = field(default_factory=dict, repr=False, compare=False)

    @property
    def likelihood(self) -> Likelihood:
        """A fresh likelihood of this axis."""
        return Likelihood(self.data)

    @property
    def explanation(self) -> Explanation:
        """The current explanation."""
        return self.fitted.explanation

    @property
    def white(self) -> float:
        """Density of the current white noise; where there is none, of the spectrum's median."""
        total = sum(c.process.parameters["N"] ** 2 for c in self.explanation.components if isinstance(c.process, WN))
        return (
            math.sqrt(total)
            if total > 0
            else math.sqrt(float(np.median(self.data.power)) if self.data.power.size else 1e-30)
        )

    def block_sigma(self) -> float:
        """Standard deviation of a block mean from white noise alone."""
        return self.white / math.sqrt(self.data.block_s)


AxisHypothesis = Hypothesis[AxisState]
Candidate = Callable[[AxisState], list[AxisHypothesis]]
CANDIDATES: dict[str, Candidate] = {}


def register(effect: str, candidate: Candidate) -> None:
    """Add a candidate to the catalogue under an effect id (a user's own, or a replacement)."""
    CANDIDATES[effect] = candidate


def amplitudes(top: float, count: int = 10) -> Array:
    """Amplitudes to start from, up to the largest that the log admits."""
    return top * np.geomspace(1.0 / rules().amplitude_range, 1.0, count)


def amplitude(name: str, top: float) -> Free:
    """A free amplitude up to the largest that the log admits."""
    return Free(name, top / rules().amplitude_range, top)


def spread_of(state: AxisState) -> float:
    """Largest slow excursion that the log could hold, in its unit."""
    d = state.data.differences
    wander = np.concatenate([[0.0], np.cumsum(d)])
    return 10.0 * max(float(np.std(wander)), state.block_sigma())


def best_of(
    state: AxisState, effect: str, variant: str, starts: Iterable[Explanation], refine: int = 2, apart: float = 1.5
) -> list[AxisHypothesis]:
    """Refine the most promising of many starting points and weigh the best.

    Parameters
    ----------
    state : AxisState
        The axis with its current explanation.
    effect, variant : str
        Catalogue id, and which of its shapes.
    starts : iterable of Explanation
        Starting points, ranked by their log posterior.
    refine : int
        How many of them are refined at most.
    apart : float
        Least distance of two of these in the logarithm of some parameter.

    Returns
    -------
    list of AxisHypothesis
        One, or none where there is no start.
    """
    likelihood = state.likelihood
    starts = list(starts)
    order = np.argsort(-np.array(likelihood.log_posteriors(starts)), kind="stable")
    chosen: list[Explanation] = []
    for explanation in (starts[k] for k in order):
        # a neighbour of a chosen start leads to the same optimum
        if all(np.max(np.abs(explanation.start() - other.start())) > apart for other in chosen):
            chosen.append(explanation)
        if len(chosen) == refine:
            break
    fits: list[Fitted] = []
    for e in chosen:
        fits.append(fit(likelihood, e, fits))
        if fits[0].evidence < state.fitted.evidence - HOPELESS:
            break  # the most promising one leads to nothing
    if not fits:
        return []
    best = max(fits, key=lambda f: f.evidence)
    return [
        Hypothesis(
            effect,
            best.evidence - state.fitted.evidence,
            values_of(best, effect, state.data.unit),
            added(state, best, effect),
            variant,
        )
    ]


def added(state: AxisState, fitted: Fitted, effect: str) -> AxisState:
    """The axis with an explanation that holds one more effect.

    Parameters
    ----------
    state : AxisState
        The axis before.
    fitted : Fitted
        The new explanation at its optimum.
    effect : str
        Catalogue id of the effect that it holds in addition.
    """
    return replace(state, fitted=fitted, named=(*state.named, effect), memory={})


#: Names of the table of effects for parameters whose process calls them otherwise.
_TABLE_NAMES = {
    ("vibration_band", "sigma"): "rms",
    ("vibration_band", "f"): "frequency",
    ("vibration_band", "ratio"): "bandwidth",
}


def values_of(fitted: Fitted, effect: str, unit: str) -> tuple[Value, ...]:
    """Parameters that an effect brought in, with intervals; the last component of that effect counts.

    Parameters
    ----------
    fitted : Fitted
        The explanation at its optimum.
    effect : str
        Catalogue id of the effect.
    unit : str
        SI unit of the axis.
    """
    out: list[Value] = []
    k = 0
    for c in fitted.explanation.components:
        meta = {p.name: p.unit_for(unit) for p in c.process.PARAMETERS}
        mine = [
            Value.positive(
                _TABLE_NAMES.get((effect, f.name), f.name),
                getattr(c.process, f.name),
                float(fitted.sigma[k + i]),
                meta.get(f.name, ""),
            )
            for i, f in enumerate(c.free)
        ]
        k += len(c.free)
        if c.effect == effect:
            out = mine
            if isinstance(c.process, Band):
                f0 = c.process.parameters["f"]
                out = [
                    v if v.name != "bandwidth" else Value(v.name, v.value * f0, v.low * f0, v.high * f0, "Hz")
                    for v in out
                ]
    if fitted.explanation.rolloff is not None and effect == fitted.explanation.rolloff.effect:
        low_pass = fitted.explanation.rolloff
        half = HALF_POWER.get(low_pass.kind, 1.0)
        out = [
            Value.positive(
                "cutoff" if f.name == "corner" else f.name,
                v * half if f.name == "corner" else v,
                float(fitted.sigma[k + i]),
                "Hz" if f.name == "corner" else "1",
            )
            for i, (f, v) in enumerate(zip(low_pass.free, low_pass.values, strict=True))
        ]
    return tuple(out)


def process_starts(
    state: AxisState, effect: str, make: Callable[[float], Process], free: Sequence[Free], amplitudes: Array
) -> list[Explanation]:
    """The current explanation with one process more, at each of these amplitudes.

    Parameters
    ----------
    state : AxisState
        The axis with its current explanation.
    effect : str
        Catalogue id of the effect that the process stands for.
    make : callable
        Makes the process of an amplitude.
    free : sequence of Free
        Its free parameters with their priors.
    amplitudes : (k,) array
        In the unit of the process's amplitude.
    """
    base = state.explanation
    return [base.with_component(Component(make(a), tuple(free), effect)) for a in amplitudes]


def state_of(
    data: Reduced, explanation: Explanation, temperature_c: Array | None = None, named: tuple[str, ...] = ()
) -> AxisState:
    """Fit an explanation to an axis.

    Parameters
    ----------
    data : Reduced
        The reduced log of the axis.
    explanation : Explanation
        Start of the fit.
    temperature_c : (n,) array, optional
        Temperature at the samples, degC.
    named : tuple of str
        Effects that count as named already.
    """
    return AxisState(data, fit(Likelihood(data), explanation), temperature_c, named)


#: Share of the median power below which a spectrum is not whitened.
LEAST_POWER = 1e-3
#: Variance above the block band over that of the innovations from which a sample is mostly memory of the one before.
MEMORY = 2.0
#: Samples at either end that the whitening of a steep spectrum spoils, because a discrete transform is periodic.
WRAPPED = 32


def _spectral_weight(explanation: Explanation, n: int, dt: float) -> tuple[Array, Array]:
    f = np.arange(1, n // 2 + 1) / (n * dt)
    return f, explanation.psd(f, dt)


def memo(state: AxisState, key: str, make: Callable[[], Array]) -> Array:
    """What is computed once for an axis.

    Parameters
    ----------
    state : AxisState
        The axis; it remembers the answer.
    key : str
        Name of the answer.
    make : callable
        Computes it, where it is not remembered.
    """
    if key not in state.memory:
        state.memory[key] = make()
    return np.asarray(state.memory[key])


def whitened(state: AxisState) -> Array:
    """Residuals of the samples above the block band, divided by the explanation's spectrum: unit variance where it is right."""

    def make() -> Array:
        data = state.data
        n = data.values.size
        if not data.differences.size:
            # a moving sensor: each sample against its neighbours, which no smooth motion notices
            x = data.values
            r = np.zeros(n)
            r[1:-1] = x[1:-1] - 0.5 * (x[2:] + x[:-2])
            return r / (1.4826 * max(float(np.median(np.abs(r))), 1e-300))
        y = data.remembered("transform", lambda: np.fft.rfft(data.values - data.values.mean()))
        f, S = _spectral_weight(state.explanation, n, data.dt)
        # beyond an output filter there is nothing but what leaks there: it must not be blown up
        least = LEAST_POWER * float(np.median(S))
        # noise that is mostly memory jumps where the last sample meets the first, by many of its innovations
        band = S[f >= (data.f[0] if data.f.size else 0.0)]
        steep = bool((S < least).any() or band.mean() > MEMORY * np.exp(np.mean(np.log(np.maximum(band, 1e-300)))))
        S = np.maximum(S, least)
        gain = np.zeros(y.size)
        lowest = data.f[0] if data.f.size else 0.0
        gain[1:] = np.where(f >= lowest, np.sqrt(data.dt / S), 0.0)
        out = np.asarray(np.fft.irfft(y * gain, n)) / math.sqrt(max(1.0 - 2.0 * lowest * data.dt, 0.1))
        if steep:
            out[:WRAPPED] = out[-WRAPPED:] = 0.0  # where the last sample meets the first
        return out

    return memo(state, "whitened", make)


def cleaned(state: AxisState, values: Array, effect: str, explanation: Explanation | None = None) -> AxisState:
    """The axis after something was taken out of its samples, refitted.

    Parameters
    ----------
    state : AxisState
        The axis before.
    values : (n,) array
        Its samples without the effect, SI.
    effect : str
        Catalogue id of the effect.
    explanation : Explanation, optional
        Start of the fit; the current explanation where it is not given.
    """
    data = reduce_again(state.data, values)
    fitted = fit(Likelihood(data), explanation or state.explanation)
    return replace(state, data=data, fitted=fitted, named=(*state.named, effect), memory={})
