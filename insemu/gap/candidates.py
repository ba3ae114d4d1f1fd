"""Candidates for a static log: what could be missing, each weighed in nats against the current explanation.

Each candidate is a function ``(AxisState) -> list[Weighed]``; a user's own joins through :func:`register`. Grids only find where to
start: every candidate is refined before it is compared (an unrefined one names the wrong effect).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.effects import EFFECTS
from insemu.errors import InputError
from insemu.gap.band import Band
from insemu.gap.evidence import (
    DEPTH,
    PRIOR_SCALES,
    Component,
    Explanation,
    Fitted,
    Free,
    Likelihood,
    Regressors,
    Rolloff,
    fit,
    log_mean_exp,
)
from insemu.gap.reduced import Reduced, block_differences, reduce_again
from insemu.gap.verdict import Value
from insemu.noise import BI, GM, QN, RC, RW, WN, Process

Array = NDArray[np.float64]

#: Ratio of the largest to the smallest amplitude that a prior admits.
AMPLITUDE_RANGE = 1e5
#: A candidate whose best start refines to so much less than nothing is not tried from the others, nats.
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


@dataclass(frozen=True)
class Weighed:
    """A candidate after refinement.

    Parameters
    ----------
    effect, variant : str
        Catalogue id, and which of its shapes.
    gain : float
        Nats of evidence over the current explanation.
    values : tuple of Value
        Its parameters.
    state : AxisState
        The axis with the effect added.
    """

    effect: str
    variant: str
    gain: float
    values: tuple[Value, ...]
    state: AxisState


Candidate = Callable[[AxisState], "list[Weighed]"]
CANDIDATES: dict[str, Candidate] = {}


def register(effect: str, candidate: Candidate) -> None:
    """Add a candidate to the catalogue under an effect id (a user's own, or a replacement)."""
    CANDIDATES[effect] = candidate


def _amplitudes(top: float, count: int = 10) -> Array:
    return top * np.geomspace(1.0 / AMPLITUDE_RANGE, 1.0, count)


def _amplitude(name: str, top: float) -> Free:
    return Free(name, top / AMPLITUDE_RANGE, top)


def _spread(state: AxisState) -> float:
    """Largest slow excursion that the log could hold, in its unit."""
    d = state.data.differences
    wander = np.concatenate([[0.0], np.cumsum(d)])
    return 10.0 * max(float(np.std(wander)), state.block_sigma())


def _log_normal(name: str, value: float, sigma: float, unit: str) -> Value:
    return Value(name, value, value * math.exp(-1.96 * sigma), value * math.exp(1.96 * sigma), unit)


def best_of(
    state: AxisState, effect: str, variant: str, starts: Iterable[Explanation], refine: int = 2, apart: float = 1.5
) -> list[Weighed]:
    """Refine the most promising of many starting points and weigh the best."""
    likelihood = state.likelihood
    scored = sorted(((likelihood.log_posterior(e), i, e) for i, e in enumerate(starts)), key=lambda item: -item[0])
    chosen: list[Explanation] = []
    for _, _, explanation in scored:
        # a neighbour of a chosen start leads to the same optimum
        if all(np.max(np.abs(explanation.start() - other.start())) > apart for other in chosen):
            chosen.append(explanation)
        if len(chosen) == refine:
            break
    fits: list[Fitted] = []
    for e in chosen:
        fits.append(fit(likelihood, e))
        if fits[0].evidence < state.fitted.evidence - HOPELESS:
            break  # the most promising one leads to nothing
    if not fits:
        return []
    best = max(fits, key=lambda f: f.evidence)
    return [
        Weighed(
            effect,
            variant,
            best.evidence - state.fitted.evidence,
            values_of(best, effect, state.data.unit),
            added(state, best, effect),
        )
    ]


def added(state: AxisState, fitted: Fitted, effect: str) -> AxisState:
    """The axis with an explanation that holds one more effect."""
    return replace(state, fitted=fitted, named=(*state.named, effect), memory={})


#: Names of the table of effects for parameters whose process calls them otherwise.
_TABLE_NAMES = {
    ("vibration_band", "sigma"): "rms",
    ("vibration_band", "f"): "frequency",
    ("vibration_band", "ratio"): "bandwidth",
}


def values_of(fitted: Fitted, effect: str, unit: str) -> tuple[Value, ...]:
    """Parameters that an effect brought in, with intervals; the last component of that effect counts."""
    out: list[Value] = []
    k = 0
    for c in fitted.explanation.components:
        meta = {p.name: p.unit_for(unit) for p in c.process.PARAMETERS}
        mine = [
            _log_normal(
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
            _log_normal(
                "cutoff" if f.name == "corner" else f.name,
                v * half if f.name == "corner" else v,
                float(fitted.sigma[k + i]),
                "Hz" if f.name == "corner" else "1",
            )
            for i, (f, v) in enumerate(zip(low_pass.free, low_pass.values, strict=True))
        ]
    return tuple(out)


def _process_starts(
    state: AxisState, effect: str, make: Callable[[float], Process], free: Sequence[Free], amplitudes: Array
) -> list[Explanation]:
    base = state.explanation
    return [base.with_component(Component(make(a), tuple(free), effect)) for a in amplitudes]


# -- processes --------------------------------------------------------------------------------------------------------------------


def white_noise(state: AxisState) -> list[Weighed]:
    """The white noise's level is further off than a nominal level may be."""
    base = state.explanation
    index = next(
        (i for i, c in enumerate(base.components) if isinstance(c.process, WN) and c.effect == "nominal"), None
    )
    if index is None:
        top = 10.0 * state.white
        free = (_amplitude("N", top),)
        return best_of(
            state, "white_noise", "level", _process_starts(state, "white_noise", WN, free, _amplitudes(top)), 1
        )
    c = base.components[index]
    n0 = c.process.parameters["N"]
    starts = []
    for factor in (0.3, 0.6, 1.0, 1.6, 3.0, 6.0):
        wide = Component(WN(n0 * factor), (Free("N", n0 / 30.0, n0 * 30.0),), "white_noise")
        starts.append(replace(base, components=(*base.components[:index], wide, *base.components[index + 1 :])))
    return best_of(state, "white_noise", "level", starts, 1)


def random_walk(state: AxisState) -> list[Weighed]:
    """A random walk that the explanation lacks, or more of it."""
    top = _spread(state) / math.sqrt(10.0 * state.data.block_s)
    return best_of(
        state,
        "random_walk",
        "",
        _process_starts(state, "random_walk", RW, (_amplitude("K", top),), _amplitudes(top, 16)),
    )


def flicker(state: AxisState) -> list[Weighed]:
    """Bias instability."""
    top = _spread(state)
    return best_of(
        state, "flicker", "", _process_starts(state, "flicker", BI, (_amplitude("B", top),), _amplitudes(top, 16))
    )


def gauss_markov(state: AxisState) -> list[Weighed]:
    """A first-order Gauss-Markov process of any correlation time between four samples and half the log."""
    if "gauss_markov" not in state.memory:
        state.memory["gauss_markov"] = _gauss_markov(state)
    return list(state.memory["gauss_markov"])


def _gauss_markov(state: AxisState) -> list[Weighed]:
    data = state.data
    fastest, slowest = 4.0 * data.dt, 0.5 * data.duration_s
    top = max(_spread(state), 10.0 * state.white / math.sqrt(data.dt * 4.0))
    free = (_amplitude("sigma", top), Free("beta", 1.0 / slowest, 1.0 / fastest))
    starts: list[Explanation] = []
    for time in np.geomspace(fastest * 1.5, slowest / 1.5, 10):
        # only amplitudes whose spectrum at the corner is not far from the white noise's can matter or fit
        middle = state.white / math.sqrt(2.0 * time)
        for a in middle * np.geomspace(0.1, 300.0, 9):
            starts.append(state.explanation.with_component(Component(GM(a, 1.0 / time), free, "gauss_markov")))
    return best_of(state, "gauss_markov", "", starts, 3)


def quantization_noise(state: AxisState) -> list[Weighed]:
    """Quantization of the integrated output: a spectrum that rises with the square of the frequency."""
    top = 10.0 * state.white * math.sqrt(state.data.dt)
    return best_of(
        state,
        "quantization",
        "integrated",
        _process_starts(state, "quantization", QN, (_amplitude("Q", top),), _amplitudes(top, 14)),
        1,
    )


def vibration_band(state: AxisState) -> list[Weighed]:
    """Vibration coloured by a resonance."""
    data = state.data
    if not data.f.size:
        return []
    nyquist = 0.5 / data.dt
    # a moving sensor's spectrum begins where its motion ends; at rest slower than ten blocks is a slow process, and buildings sway at 0.5 Hz
    lowest = 10.0 * data.f[0] if data.differences.size else max(1.1 * data.f[0], 0.02 * nyquist)
    if lowest > 0.8 * nyquist:
        return []
    S = state.explanation.psd(data.f, data.dt)
    free = (
        _amplitude("sigma", 30.0 * state.white / math.sqrt(data.dt)),
        Free("f", lowest, 0.97 * nyquist),
        Free("ratio", 0.003, 0.6),  # wider is no resonance
    )
    # where the excess over a window as wide as the band stands out most, for each width
    excess = state.explanation.seen(data) / S - 1.0
    weighted = np.concatenate([[0.0], np.cumsum(data.counted * excess)])
    total = np.concatenate([[0.0], np.cumsum(data.counted)])
    starts = []
    for ratio in (0.01, 0.03, 0.1, 0.35):
        first = np.searchsorted(data.f, data.f * (1.0 - 0.5 * ratio))
        last = np.searchsorted(data.f, data.f * (1.0 + 0.5 * ratio), side="right")
        counted = np.maximum(total[last] - total[first], 1e-9)
        score = (weighted[last] - weighted[first]) / np.sqrt(2.0 * counted)
        score[(data.f < lowest) | (data.f > 0.95 * nyquist)] = -np.inf
        for _ in range(2):
            k = int(np.argmax(score))
            if not score[k] > 0.0:
                break
            f0, height = float(data.f[k]), float((weighted[last[k]] - weighted[first[k]]) / counted[k])
            for factor in (0.7, 1.4, 3.0):
                sigma = math.sqrt(factor * height * float(S[k]) * ratio * f0 * math.pi)
                band = Component(Band(sigma, f0, ratio), free, "vibration_band")
                starts.append(state.explanation.with_component(band))
            score[np.abs(np.log(data.f / f0)) < ratio] = -np.inf
    return best_of(state, "vibration_band", "", starts, 3, apart=0.4)


#: Frequency at which a window halves the power, times its length (two of them for the triangular one).
HALF_POWER = {"moving average": 0.44295, "triangular window": 0.31894}


def decimation_filter(state: AxisState) -> list[Weighed]:
    """A low-pass of the output that the nominal model lacks."""
    if state.explanation.rolloff is not None or not state.data.f.size:
        return []
    nyquist = 0.5 / state.data.dt
    out = []
    order = Free("order", 0.6, 12.0)
    floor = DEPTH * state.white**2
    for kind, highest in (
        # no cutoff beyond what the samples show: a slope that gentle is no filter's
        ("moving average", 0.98 / HALF_POWER["moving average"]),
        ("triangular window", 0.98 / HALF_POWER["triangular window"]),
        ("exponential", 0.98),
        ("butterworth", 0.98),
    ):
        free = (Free("corner", 0.03 * nyquist, highest * nyquist), *((order,) if kind == "butterworth" else ()))
        orders: tuple[tuple[float, ...], ...] = ((1.0,), (2.0,), (4.0,), (8.0,)) if kind == "butterworth" else ((),)
        corners = nyquist * np.geomspace(0.05, 0.95 * highest, 14)
        starts = [
            replace(state.explanation, rolloff=Rolloff(kind, (c, *o), free, floor=floor))
            for c in corners
            for o in orders
        ]
        tried = best_of(state, "decimation_filter", kind, starts, 1)
        out += [w for w in tried if all(v.value < nyquist if v.name == "cutoff" else v.value > 0.5 for v in w.values)]
    return out


# -- known shapes -----------------------------------------------------------------------------------------------------------------


def _regression(
    state: AxisState,
    effect: str,
    variant: str,
    names: Sequence[str],
    rebuild: Callable[[Reduced, Array | None], Array],
    scales: Array,
    unit: Sequence[str],
) -> list[Weighed]:
    regressors = Regressors(effect, tuple(names), rebuild(state.data, state.temperature), scales, rebuild)
    explanation = replace(state.explanation, regressors=(*state.explanation.regressors, regressors))
    likelihood = state.likelihood
    fitted = fit(likelihood, explanation)
    mean, covariance = likelihood.coefficients(fitted.explanation)
    k = len(names)
    sigma = np.sqrt(np.diag(covariance))[-k:]
    values = tuple(
        Value(n, float(m), float(m - 1.96 * s), float(m + 1.96 * s), u)
        for n, m, s, u in zip(names, mean[-k:], sigma, unit, strict=True)
    )
    return [Weighed(effect, variant, fitted.evidence - state.fitted.evidence, values, added(state, fitted, effect))]


def ramp(state: AxisState) -> list[Weighed]:
    """A drift in proportion to time."""
    data = state.data

    def column(where: Reduced, _: Array | None) -> Array:
        return np.full((where.differences.size, 1), where.block_s)

    scale = np.array([3.0 * state.block_sigma() / data.duration_s])
    return _regression(state, "ramp", "", ("R",), column, scale, (f"{data.unit}/s",))


def mean_spread(explanation: Explanation, white: float, duration_s: float, dt: float) -> float:
    """Standard deviation of the mean of a log from the noise of an explanation."""
    T = duration_s
    variance = white**2 / T
    for c in explanation.components:
        p = c.process.parameters
        if isinstance(c.process, RW):
            variance += p["K"] ** 2 * T  # it began before the log, a log's length earlier counted from its middle
        elif isinstance(c.process, GM):
            x = p["beta"] * T
            variance += p["sigma"] ** 2 * 2.0 / x**2 * (x + math.expm1(-x))
        elif isinstance(c.process, BI):
            variance += p["B"] ** 2 * math.log(T / dt) / math.pi  # between one sample and the log
    return math.sqrt(variance)


def unbiased_log_density(mean: float, spread: Array) -> Array:
    """Log density of a gyroscope's mean at rest that holds noise of this spread and any part of the rotation of the Earth."""
    beyond = max(abs(mean) - earth.RATE, 0.0)
    return np.asarray(-0.5 * (beyond / spread) ** 2 - np.log(math.sqrt(2.0 * math.pi) * spread + 2.0 * earth.RATE))


def bias_gain(mean: float, spread: float) -> float:
    """Nats by which a turn-on bias explains a gyroscope's mean at rest better than noise and the rotation of the Earth do."""
    scale = EFFECTS["turn_on_bias"].scale("value", "gyro")
    wide = [math.hypot(spread, c * scale) for c in PRIOR_SCALES]
    biased = log_mean_exp([-0.5 * (mean / s) ** 2 - math.log(math.sqrt(2.0 * math.pi) * s) for s in wide])
    return biased - float(unbiased_log_density(mean, np.array([spread]))[0])


def turn_on_bias(state: AxisState) -> list[Weighed]:
    """A constant error of a gyroscope, its mean at rest more than the rotation of the Earth can be, and the random walk that is its rival.

    An accelerometer at rest shows gravity in an unknown attitude, so its bias is not looked for. Weighed after everything else, because how well
    the mean of the log is known follows from the slow processes that were found.
    """
    data, explanation = state.data, state.explanation
    believed = any(isinstance(c.process, RC) for c in explanation.components)
    if not data.name.startswith("gyro") or believed or explanation.regressors:
        return []
    mean, T = float(np.mean(data.values)), data.duration_s
    sigma = mean_spread(explanation, state.white, T, data.dt)
    off = 1.96 * math.hypot(sigma, earth.RATE / math.sqrt(3.0))
    values = (Value("value", mean, mean - off, mean + off, data.unit),)
    named = replace(state, named=(*state.named, "turn_on_bias"))
    out = [Weighed("turn_on_bias", "", bias_gain(mean, sigma), values, named)]
    if any(isinstance(c.process, RW) for c in explanation.components):
        return out
    # the rival: a walk, which carries the mean away even where the block means are not enough to name it
    walks = _amplitudes(_spread(state) / math.sqrt(10.0 * data.block_s), 40)
    free = (_amplitude("K", float(walks[-1])),)
    likelihood = state.likelihood
    starts = [explanation.with_component(Component(RW(float(k)), free, "random_walk")) for k in walks]
    seen = np.array([likelihood.low(e) + likelihood.high(e) for e in starts])
    carried = seen + unbiased_log_density(mean, np.hypot(sigma, walks * math.sqrt(T)))
    null = float(unbiased_log_density(mean, np.array([sigma]))[0])
    rival = log_mean_exp(carried) - likelihood.low(explanation) - likelihood.high(explanation) - null
    p = np.exp(carried - carried.max())
    p /= p.sum()
    centre = float(p @ np.log(walks))
    width = math.sqrt(float(p @ (np.log(walks) - centre) ** 2) + math.log(walks[1] / walks[0]) ** 2 / 12.0)
    meta = RW.PARAMETERS[0]
    values = (_log_normal("K", math.exp(centre), width, meta.unit_for(data.unit)),)
    fitted = fit(likelihood, starts[int(np.argmax(carried))])
    return [*out, Weighed("random_walk", "", rival, values, added(state, fitted, "random_walk"))]


#: Prior weight of each shape of a thermal bias.
THERMAL_SHAPES = {"linear": 0.5, "cubic": 0.2, "lagged": 0.2, "cubic and lagged": 0.1}
#: Thermal time constants that the lagged shapes try, from a block to this share of the log, and their number.
LONGEST_LAG, LAGS = 0.3, 10


def temperature(state: AxisState) -> list[Weighed]:
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
            seen = lowpass(d, where.dt, lag) if lag > 0.0 else d
            return block_differences(np.stack([_power(seen, k + 1) for k in which], axis=1), where.block)

        return columns

    def weigh(variant: str, which: tuple[int, ...], lag: float = 0.0) -> Weighed:
        chosen = list(which)
        w = _regression(
            state, "temperature", variant, [names[k] for k in which], rebuilt(which, lag), scales[chosen],
            [units[k] for k in which],
        )[0]  # fmt: skip
        d = T - centre
        seen = lowpass(d, data.dt, lag) if lag > 0.0 else d
        signal = sum((v.value * _power(seen, k + 1) for v, k in zip(w.values, which, strict=True)), np.zeros(T.size))
        w = _less(w, state, signal)
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
        grid = np.geomspace(data.block_s, LONGEST_LAG * data.duration_s, LAGS)
        tried = [quick(which, float(lag)) for lag in grid]
        k = int(np.argmax(tried))
        top, lag, ratio = tried[k], float(grid[k]), float(grid[1] / grid[0])
        paid = top - log_mean_exp(tried)  # the time constant is paid for
        for _ in range(4):
            ratio = math.sqrt(ratio)
            top, lag = max([(top, lag), *((quick(which, lag * r), lag * r) for r in (1.0 / ratio, ratio))])
        best = weigh(shape, which, lag)
        values = (*best.values, Value("lag", lag, lag / ratio, lag * ratio, "s"))
        out.append(replace(best, gain=best.gain - paid, values=values))
    return [replace(w, gain=w.gain + math.log(THERMAL_SHAPES[w.variant])) for w in out]


def _power(x: Array, k: int) -> Array:
    """Integer power by products: a general one takes ten times as long."""
    return x if k == 1 else np.asarray(x * _power(x, k - 1))


def _less(w: Weighed, state: AxisState, signal: Array) -> Weighed:
    """A named signal taken out of the samples too, so that its fast part is explained as well; worth what the spectrum gains."""
    if not state.data.f.size:
        return w
    apart = reduce_again(state.data, state.data.values - signal)
    explanation = w.state.explanation
    before, after = Likelihood(state.data).high(explanation), Likelihood(apart).high(explanation)
    if not after > before:
        return w
    data = replace(apart, differences=state.data.differences)  # the block band keeps the regressors
    fitted = fit(Likelihood(data), explanation)
    return replace(w, gain=w.gain + after - before, state=replace(w.state, data=data, fitted=fitted))


def lowpass(x: Array, dt: float, lag: float) -> Array:
    """A first-order lag that starts settled."""
    from scipy.signal import lfilter

    phi = math.exp(-dt / lag)
    return np.asarray(x[0] + lfilter([1.0 - phi], [1.0, -phi], x - x[0]))


def _initial() -> None:
    for effect, candidate in (
        ("white_noise", white_noise),
        ("random_walk", random_walk),
        ("gauss_markov", gauss_markov),
        ("flicker", flicker),
        ("quantization", quantization_noise),
        ("ramp", ramp),
        ("vibration_band", vibration_band),
        ("decimation_filter", decimation_filter),
        ("temperature", temperature),
    ):
        register(effect, candidate)


_initial()


def state_of(
    data: Reduced, explanation: Explanation, temperature_c: Array | None = None, named: tuple[str, ...] = ()
) -> AxisState:
    """Fit an explanation to an axis."""
    return AxisState(data, fit(Likelihood(data), explanation), temperature_c, named)
