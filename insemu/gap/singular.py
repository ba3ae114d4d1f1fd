"""Candidates of a static log that no smooth spectrum shows: lines, outliers, switching levels, a lattice of output counts, held samples."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from insemu.gap import kernel
from insemu.gap.candidates import AxisState, Weighed, added, gauss_markov, register, white_noise
from insemu.gap.evidence import Component, Explanation, Free, Likelihood, fit, laplace, level, log_mean_exp
from insemu.gap.reduced import reduce_again
from insemu.gap.verdict import Value
from insemu.noise import BI, GM, QN, RW, WN, Process

Array = NDArray[np.float64]


#: A candidate this far below nothing is not looked at more closely, nats.
LOST_NATS = 4.0
#: Share of the median power below which a spectrum is not whitened.
LEAST_POWER = 1e-3
#: Samples at either end that the whitening of a steep spectrum spoils, because a discrete transform is periodic.
WRAPPED = 32
#: Pieces of a moving sensor's record whose noise around a line is their own.
LINE_PIECES = 32
#: Ordinates of a piece on either side of a line that say what the noise is there.
NEAR_LINE = 12
#: Largest share of samples that are outliers.
MOST_WILD = 0.1


def _spectral_weight(explanation: Explanation, n: int, dt: float) -> tuple[Array, Array]:
    f = np.arange(1, n // 2 + 1) / (n * dt)
    return f, explanation.psd(f, dt)


def _memo(state: AxisState, key: str, make: object) -> Array:
    assert callable(make)
    if key not in state.memory:
        state.memory[key] = make()
    return state.memory[key]


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
        y = np.fft.rfft(data.values - data.values.mean())
        f, S = _spectral_weight(state.explanation, n, data.dt)
        # beyond an output filter there is nothing but what leaks there: it must not be blown up
        least = LEAST_POWER * float(np.median(S))
        steep = bool((S < least).any())
        S = np.maximum(S, least)
        gain = np.zeros(y.size)
        lowest = data.f[0] if data.f.size else 0.0
        gain[1:] = np.where(f >= lowest, np.sqrt(data.dt / S), 0.0)
        out = np.asarray(np.fft.irfft(y * gain, n)) / math.sqrt(max(1.0 - 2.0 * lowest * data.dt, 0.1))
        if steep:
            out[:WRAPPED] = out[-WRAPPED:] = 0.0  # where the last sample meets the first
        return out

    return _memo(state, "whitened", make)


def cleaned(state: AxisState, values: Array, effect: str, explanation: Explanation | None = None) -> AxisState:
    """The axis after something was taken out of its samples, refitted."""
    data = reduce_again(state.data, values)
    fitted = fit(Likelihood(data), explanation or state.explanation)
    return replace(state, data=data, fitted=fitted, named=(*state.named, effect), memory={})


#: Frequencies at which a line is looked for, per independent one.
FINER = 4


# -- lines ------------------------------------------------------------------------------------------------------------------------


def vibration_line(state: AxisState) -> list[Weighed]:
    """A sinusoid: full-resolution scan, complex amplitude integrated out, frequency paid for."""
    data = state.data
    if not data.f.size:
        return []
    n, dt = data.values.size, data.dt
    y = data.values - data.values.mean()
    m = FINER * n
    spectrum = np.abs(np.fft.rfft(y, m)) ** 2 * (dt / n)
    f = np.arange(spectrum.size) / (m * dt)
    inside = (f >= data.f[0]) & (f < 0.5 / dt * (1.0 - 4.0 / n))
    S = state.explanation.psd(f[inside], dt)
    # beyond an output filter there is nothing but what leaks there, and no line stands out of that
    least = LEAST_POWER * float(np.median(S))
    ratio = np.zeros(spectrum.size)
    ratio[inside] = spectrum[inside] / np.maximum(S, least)
    k = int(np.argmax(ratio))
    # a line between two frequencies of the grid is worth what it is at its own
    peak = max(float(ratio[k]), _height(y, dt, f[k]) / max(float(state.explanation.psd(f[[k]], dt)[0]), least))
    looked = float(inside.sum()) / FINER
    gain = _line_gain(peak, looked)
    if gain < 0.0:
        return [Weighed("vibration_line", "", gain, (), state)]
    frequency, a, b = _sinusoid(y, dt, f[k], 1.0 / (n * dt))
    if not data.differences.size:
        # how loud a moving sensor is changes with the motion
        gain = min(gain, _line_gain(_steady_power(y, dt, frequency), looked))
        if gain < 0.0:
            return []
    amplitude = math.hypot(a, b)
    t = np.arange(n) * dt
    rest = data.values - a * np.cos(2.0 * math.pi * frequency * t) - b * np.sin(2.0 * math.pi * frequency * t)
    sigma = math.sqrt(2.0 * float(state.explanation.psd(np.array([frequency]), dt)[0]) / (n * dt))
    df = math.sqrt(6.0) / math.pi * sigma / amplitude / (n * dt)
    values = (
        Value("amplitude", amplitude, amplitude - 1.96 * sigma, amplitude + 1.96 * sigma, data.unit),
        Value("frequency", frequency, frequency - 1.96 * df, frequency + 1.96 * df, "Hz"),
    )
    return [Weighed("vibration_line", "", gain, values, cleaned(state, rest, "vibration_line"))]


def _height(y: Array, dt: float, f0: float) -> float:
    """Periodogram at the best frequency near ``f0``."""
    _, a, b = _sinusoid(y, dt, f0, 1.0 / (y.size * dt))
    return 0.25 * (a * a + b * b) * y.size * dt


def _line_gain(peak: float, looked: float) -> float:
    """Evidence of a line whose periodogram stands ``peak`` times above its surroundings, at the best of ``looked`` frequencies.

    Bayes factor of one frequency with a complex Gaussian amplitude of variance rho, averaged over rho; frequencies count alike.
    """
    rho = np.geomspace(0.3, 1e6, 40)
    return log_mean_exp(peak * rho / (1.0 + rho) - np.log1p(rho)) - math.log(looked)


def _steady_power(y: Array, dt: float, f: float) -> float:
    """Squared amplitude of a steady sinusoid over its variance, each piece of the record weighed by its own noise around the frequency.

    Noise alone gives an exponential variable of mean one; what is loud in a few pieces only counts little.
    """
    length = y.size // LINE_PIECES
    pieces = y[: LINE_PIECES * length].reshape(LINE_PIECES, length)
    t = np.arange(LINE_PIECES * length).reshape(LINE_PIECES, length) * dt
    near = [k for k in range(-NEAR_LINE, NEAR_LINE + 1) if abs(k) > 2]
    turned = pieces * np.exp(-2j * math.pi * f * t)
    around = np.exp(-2j * math.pi * np.outer(near, np.arange(length) / length))
    noise = np.mean(np.abs(turned @ around.T) ** 2, axis=1) + 1e-300
    return float(np.abs(np.sum(turned.sum(axis=1) / noise)) ** 2 / np.sum(1.0 / noise))


def _sinusoid(y: Array, dt: float, f0: float, resolution: float) -> tuple[float, float, float]:
    """Least-squares frequency near ``f0`` with its cosine and sine amplitudes."""
    t = np.arange(y.size) * dt

    def project(f: float) -> complex:
        return complex(np.dot(y, np.exp(-2j * math.pi * f * t)))

    h = 0.25 * resolution
    f = f0
    for _ in range(3):  # parabola through the periodogram's top
        low, mid, high = (abs(project(f + d)) ** 2 for d in (-h, 0.0, h))
        bend = low - 2.0 * mid + high
        if bend >= 0:
            break
        f += float(np.clip(0.5 * h * (low - high) / bend, -h, h))
        h *= 0.3
    z = project(f) * 2.0 / y.size
    return f, z.real, -z.imag


# -- outliers ---------------------------------------------------------------------------------------------------------------------


def outliers(state: AxisState) -> list[Weighed]:
    """Heavy tails: a small share of samples with a larger spread, against a Gaussian whose level is free as a nominal one is."""
    if "outliers" in state.named or not state.data.f.size:
        return []
    if lattice(state.data.values) > 3.0 * state.white / math.sqrt(state.data.dt):
        return []  # counts wider than the noise are no Gaussian with tails
    r = np.abs(whitened(state))
    edges = np.concatenate([np.linspace(0.0, 6.0, 241), np.geomspace(6.2, max(7.0, 1.01 * float(r.max())), 60)])
    count = np.histogram(r, edges)[0].astype(np.float64)
    square = np.histogram(r, edges, weights=r * r)[0]
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
    gain = best.evidence - max(wide.evidence, null.evidence)
    if other_level > 0.0:
        gain += min(other_level, max((w.gain for w in white_noise(state)), default=0.0))
        if best.evidence < wide.evidence:
            return []
    s, e, k = (math.exp(v) for v in best.x)
    if e > MOST_WILD:
        return []  # two kinds of noise in turns, as a vehicle that stops and goes has, are no outliers
    sd = np.sqrt(np.diag(best.covariance))
    # the spread of what was added, as the table of effects states it
    size = s * math.sqrt(max(k * k - 1.0, 0.01)) * fitted_n / math.sqrt(state.data.dt)
    values = (
        Value("probability", e, e * math.exp(-1.96 * sd[1]), e * math.exp(1.96 * sd[1]), "1"),
        Value("sigma", size, size * math.exp(-1.96 * sd[2]), size * math.exp(1.96 * sd[2]), state.data.unit),
    )
    if gain < 0.0:
        return [Weighed("outliers", "", gain, values, state)]
    signed = whitened(state)
    odds = math.log(e / (1.0 - e) / k) + 0.5 * signed**2 / s**2 * (1.0 - 1.0 / k**2)
    wild = odds > 0.0
    if not state.data.differences.size:
        return _wild_in_motion(state, gain, signed, wild, s)
    # a wild sample is shrunk to the size of its neighbours, so that the level of the rest is what is left
    values_clean = state.data.values.copy()
    values_clean[wild] -= (1.0 - 1.0 / k) * signed[wild] * fitted_n / math.sqrt(state.data.dt)
    return [Weighed("outliers", "", gain, values, cleaned(state, values_clean, "outliers"))]


#: Residuals of a moving sensor beyond this are single samples that stand out, where so many of them look like one, and what counts beside them.
EVIDENT, ALIKE, BESIDE = 10.0, 0.8, 5.0


def evident_outliers(state: AxisState) -> Weighed | None:
    """Outliers of a moving sensor so large that every other look at its spectrum would see them; ``None`` where there are no three of them.

    A single sample shows in the residual against its neighbours with twice the size and the opposite sign of what it leaves on either side.
    """
    r = whitened(state)
    size = np.abs(r)
    inner = np.arange(1, r.size - 1)
    at = inner[(size[1:-1] > EVIDENT) & (size[1:-1] >= size[:-2]) & (size[1:-1] > size[2:])]
    if at.size < 3 or float(np.mean(size > BESIDE)) > 3.0 * MOST_WILD:
        return None
    beside = -(r[at - 1] + r[at + 1]) / r[at]
    if float(np.mean(np.abs(beside - 1.0) < 0.5)) < ALIKE:
        return None
    found = _wild_in_motion(state, 0.0, r, size > BESIDE, 1.0)
    if not found:
        return None
    share, sigma = (v.value for v in found[0].values)
    unit = state.data.values[1:-1] - 0.5 * (state.data.values[2:] + state.data.values[:-2])
    v = (sigma / (1.4826 * float(np.median(np.abs(unit))))) ** 2 + 1.0
    top = r[at]
    gain = float(np.sum(0.5 * top**2 * (1.0 - 1.0 / v))) + at.size * (math.log(share) - 0.5 * math.log(v))
    return replace(found[0], gain=gain)


def _wild_in_motion(state: AxisState, gain: float, r: Array, wild: NDArray[np.bool_], s: float) -> list[Weighed]:
    """Outliers of a moving sensor, whose samples are held against their neighbours.

    One outlier shows in three residuals, so that only the largest of neighbours counts; share and size are those of a normal distribution of which
    only what lies beyond the least of them is seen.
    """
    size = np.abs(r)
    top = wild.copy()
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
    found = minimize_scalar(score, bounds=(math.log(0.02 * mean), math.log(2.0 * mean)), method="bounded")
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
    return [Weighed("outliers", "", gain, given, cleaned(state, values, "outliers"))]


# -- switching levels -------------------------------------------------------------------------------------------------------------

#: Switches per block of the block lengths at which switching is looked for, and the most blocks.
SWITCHES_PER_BLOCK, MOST_SWITCHING_BLOCKS = (0.05, 0.25), 12_000
#: What two levels must be worth over a Gaussian process of the same spectrum before their path is taken out of the samples, nats.
RESOLVED_NATS = 6.0
#: Log prior odds of a level that switches against a Gauss-Markov process: burst noise is the rarer of the two.
RARER = 0.7


@dataclass(frozen=True)
class _Switching:
    """Two levels over block means of one length, against the Gaussian process of the same second moments."""

    block: int
    excess: float
    x: Array
    sigma: Array
    path: Array


def telegraph(state: AxisState) -> list[Weighed]:
    """A level that jumps between two values at random times (telegraph or burst noise).

    Its spectrum is that of a Gauss-Markov process of rate ``beta = 2 rate``, and second moments are all that a spectrum and a Gaussian
    likelihood see. So it is worth what that process is worth, plus what the switching likelihood of block means says beyond the Gaussian
    one of the same moments on the same means, less the odds of being the rarer of the two.
    """
    data = state.data
    if "telegraph" in state.named or state.explanation.regressors:
        return []  # levels and drifts of known shape are not told apart sample by sample
    twin = next(iter(gauss_markov(state)), None)
    if twin is None or twin.gain < -LOST_NATS:
        return []
    component = twin.state.explanation.components[-1]
    sigma, rate = component.process.parameters["sigma"], 0.5 * component.process.parameters["beta"]
    shortest = max(data.dt, data.duration_s / MOST_SWITCHING_BLOCKS)
    lengths = {max(1, round(max(share / rate, shortest) / data.dt)) for share in SWITCHES_PER_BLOCK}
    found = [s for s in (_switching(state, block, sigma, rate) for block in sorted(lengths)) if s is not None]
    if not found:
        return []
    best = max(found, key=lambda s: s.excess)
    gain = twin.gain + best.excess - RARER
    a, rate = math.exp(best.x[0]), math.exp(best.x[1])
    values = tuple(
        Value(name, v, v * math.exp(-1.96 * s), v * math.exp(1.96 * s), unit)
        for name, v, s, unit in zip(("amplitude", "rate"), (a, rate), best.sigma, (data.unit, "1/s"), strict=True)
    )
    if gain < 0.0 or best.excess < RESOLVED_NATS:
        # no single level stands out: the second moments are what can be taken into account
        components = (*twin.state.explanation.components[:-1], replace(component, effect="telegraph"))
        fitted = replace(twin.state.fitted, explanation=replace(twin.state.explanation, components=components))
        return [Weighed("telegraph", "", gain, values, added(state, fitted, "telegraph"))]
    levels = np.repeat(a * (2.0 * best.path - 1.0), best.block)
    levels = np.concatenate([levels, np.full(data.values.size - levels.size, levels[-1])])
    return [Weighed("telegraph", "levels", gain, values, cleaned(state, data.values - levels, "telegraph"))]


def _switching(state: AxisState, block: int, sigma: float, rate: float) -> _Switching | None:
    """Switching against Gaussian likelihood at one block length, each at its own optimum near what the spectrum says."""
    data = state.data
    count = data.values.size // block
    length = block * data.dt
    if count < 60 or rate * length > 1.0:
        return None
    y = data.values[: count * block].reshape(count, block).mean(axis=1)
    y = y - np.median(y)
    phi, q = _background(state, length)
    # what is fast compared with a block counts as white at the level that it has there
    f = np.array([0.25 / length])
    fast = float(state.explanation.psd(f, data.dt)[0]) - sum(float(p.psd(f, data.dt)[0]) for p in _slow(state, length))
    white = max(fast, 0.1 * state.white**2) / length
    p0 = (10.0 * float(np.std(y))) ** 2
    path = np.empty(count)
    # both are free in one box around the spectrum's answer; a memory near the log's length leaves only sigma^2 beta determined, and the spread
    # of the means then says which sigma is meant
    spread = float(np.std(y))
    starts = ((sigma, rate), (spread, min(rate * max((sigma / spread) ** 2, 1.0), 0.5 / length)))
    box = [(min(column) / 5.0, max(column) * 5.0) for column in zip(*starts, strict=True)]
    free = (Free("amplitude", *box[0]), Free("rate", *box[1]))

    def prior(x: Array) -> float:
        return sum(f.log_density(v) for f, v in zip(free, x, strict=True))

    def switching(x: Array) -> float:
        stay = 0.5 * (1.0 + math.exp(-2.0 * length * math.exp(x[1])))
        return kernel.switching_log_likelihood(y, white, phi, q, p0, math.exp(x[0]), stay, path) + prior(x)

    def gaussian(x: Array) -> float:
        stay = 0.5 * (1.0 + math.exp(-2.0 * length * math.exp(x[1])))
        return kernel.gauss_markov_log_likelihood(y, white, phi, q, p0, math.exp(x[0]), stay) + prior(x)

    grid = [np.log([s * a, r * b]) for s, r in starts for a in (0.6, 0.9, 1.3) for b in (0.2, 0.5, 1.0, 2.0)]
    levels = laplace(switching, max(grid, key=switching), free)
    smooth = laplace(gaussian, max(grid, key=gaussian), free)
    switching(levels.x)
    forward = path.copy()
    stay = 0.5 * (1.0 + math.exp(-2.0 * length * math.exp(levels.x[1])))
    kernel.switching_log_likelihood(y[::-1].copy(), white, phi, q, p0, math.exp(levels.x[0]), stay, path)
    both = _smoothed(y, forward, path[::-1], math.exp(levels.x[0]), white)
    return _Switching(block, levels.evidence - smooth.evidence, levels.x, np.sqrt(np.diag(levels.covariance)), both)


def _smoothed(y: Array, forward: Array, backward: Array, amplitude: float, white: float) -> Array:
    """Probability of the upper level given all data, from the filters run either way; each saw the sample itself, which counts once."""

    def odds(p: Array) -> Array:
        q = np.clip(p, 1e-12, 1.0 - 1e-12)
        return np.asarray(np.log(q / (1.0 - q)))

    middle = float(np.mean(y - amplitude * (2.0 * forward - 1.0)))
    own = 2.0 * amplitude * (y - middle) / white
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(odds(forward) + odds(backward) - own, -40.0, 40.0))))


def _slow(state: AxisState, length: float) -> list[Process]:
    """Processes of the explanation that remember more than a few blocks."""
    slow: list[Process] = []
    for c in state.explanation.components:
        p = c.process
        if isinstance(p, RW | BI) or (isinstance(p, GM) and p.parameters["beta"] * length < 3.0):
            slow.append(p)
    return slow


def _background(state: AxisState, length: float) -> tuple[float, float]:
    """Transition and driving variance per block of a first-order background that stands for the explanation's slow processes."""
    q = 0.0
    for p in _slow(state, length):
        if isinstance(p, RW):
            q += p.parameters["K"] ** 2 * length
        elif isinstance(p, GM):
            q += 2.0 * p.parameters["sigma"] ** 2 * -math.expm1(-p.parameters["beta"] * length)
        elif isinstance(p, BI):
            q += p.parameters["B"] ** 2 * 0.9
    return 1.0, q


# -- output counts and held samples -----------------------------------------------------------------------------------------------


#: Largest share of different values among the samples of a lattice.
MOST_VALUES = 0.8


def lattice(values: Array) -> float:
    """Step of the lattice that all values lie on, or 0 where there is none (floating-point resolution does not count)."""
    sample = np.sort(values[: min(values.size, 200_000)])
    steps = np.diff(sample)
    steps = steps[steps > 1e-7 * max(float(np.ptp(sample)), float(np.max(np.abs(sample))))]
    if not steps.size or steps.size > MOST_VALUES * sample.size:
        return 0.0
    step = float(np.min(steps))
    gaps = steps / step
    # where values hardly repeat, only a gap that is a whole number of steps to the end tells a lattice from a crowd
    tolerance = 0.02 * np.maximum(1.0, gaps) if steps.size <= 0.2 * sample.size else 0.05
    near = np.abs(gaps - np.round(gaps)) < tolerance
    return float(np.median(steps[gaps < 1.5])) if np.all(near) and np.mean(gaps < 1.5) > 0.1 else 0.0


#: A lattice finer than this share of the samples' noise adds 0.02 % to their variance and is the digits of a file.
MATERIAL_LSB = 0.05


def output_counts(state: AxisState) -> list[Weighed]:
    """Samples that lie on a lattice: rounding to an output LSB. A continuous signal would never do so, so the evidence is the odds of that."""
    if "quantization" in state.named or not state.data.f.size:
        return []
    step = lattice(state.data.values)
    if step < MATERIAL_LSB * state.white / math.sqrt(state.data.dt):
        return []  # none, or no more than the digits of a file
    if any(isinstance(c.process, QN) and c.effect == "nominal" for c in state.explanation.components):
        return []
    # each sample of a lattice of step LSB is worth log(LSB / resolution of the storage); single precision is the least there is
    resolution = max(float(np.max(np.abs(state.data.values))), step) * 2.0**-24
    gain = state.data.values.size * max(math.log(step / resolution), 0.0)
    values = (Value("lsb", step, step, step, state.data.unit),)
    # the rounding itself is white noise of variance LSB^2 / 12, less where the noise is too small to spread it evenly
    density = step * math.sqrt(state.data.dt / 12.0)
    rounding = Component(WN(density), (Free("N", density / 3.0, density * 1.2, 0.05),), "quantization")
    fitted = fit(state.likelihood, state.explanation.with_component(rounding))
    return [Weighed("quantization", "output counts", gain, values, added(state, fitted, "quantization"))]


def held_samples(state: AxisState) -> list[Weighed]:
    """Samples that repeat their predecessor exactly: dropped and filled by holding the last one."""
    if {"dropped_samples", "quantization"} & set(state.named):
        return []
    y = state.data.values
    step = lattice(y)
    if step >= MATERIAL_LSB * state.white / math.sqrt(state.data.dt):
        return []  # counts repeat by themselves
    held = np.flatnonzero(np.diff(y) == 0.0) + 1
    held = held[(y[held] < y.max()) & (y[held] > y.min())]  # a full scale repeats by itself
    share = held.size / y.size
    resolution = max(2.0**-24 * float(np.max(np.abs(y))), step)
    chance = min(1.0, resolution / (state.white / math.sqrt(state.data.dt)))
    if held.size < 3 or share < 10.0 * chance:
        return []
    gain = held.size * math.log(share / chance)
    sd = 1.0 / math.sqrt(held.size)
    values = (Value("probability", share, share * math.exp(-1.96 * sd), share * math.exp(1.96 * sd), "1"),)
    mended = np.interp(np.arange(y.size), np.delete(np.arange(y.size), held), np.delete(y, held))
    return [Weighed("dropped_samples", "held", gain, values, cleaned(state, mended, "dropped_samples"))]


def pile_evidence(piled: int, one: int, two: int) -> float:
    """Evidence in nats that the outermost count of a lattice holds a pile, from how often it and the two inside of it occur.

    The logarithm of the frequencies is concave without one: a tail falls off faster and faster; two standard deviations of what is
    extrapolated are granted.
    """
    most = one * min(1.0, one / max(two, 1)) if one else 1.0
    most *= 1.0 + 2.0 * math.sqrt(4.0 / max(one, 1) + 1.0 / max(two, 1))
    return piled * math.log(piled / most) - (piled - most) if piled > most else 0.0


def saturation(state: AxisState) -> list[Weighed]:
    """Samples pile up at the largest or smallest value: clipped at the full scale.

    A continuous signal never takes its extreme value twice. On a lattice of output counts the logarithm of the frequencies is concave, which
    bounds the outermost from the next two inside; the evidence of a pile is its Poisson ratio to that bound.
    """
    if "saturation" in state.named or not state.data.differences.size:
        return []
    y = state.data.values
    step = lattice(y)
    if step > 0.0 and float(np.ptp(y)) < 5.5 * step:
        return []  # too few levels to tell a pile from a peak
    resolution = 2.0**-24 * float(np.max(np.abs(y)))
    chance = min(1.0, resolution / (state.white / math.sqrt(state.data.dt)))
    gain, limits = 0.0, []
    for sign in (1.0, -1.0):
        x = sign * y
        top = float(np.max(x))
        # wider than rounding, narrower than a count
        width = 0.5 * step if step > 0.0 else 4.0 * resolution
        piled = int(np.sum(x > top - width))
        if step > 0.0:
            one, two = (int(np.sum(np.abs(x - top + k * step) < width)) for k in (1, 2))
            here = pile_evidence(piled, one, two)
        else:
            here = piled * math.log(piled / y.size / chance) if piled >= 3 and piled / y.size > 10.0 * chance else 0.0
        if here > 0.0:
            gain += here
            limits.append(top)
    if not limits:
        return []
    limit = float(np.mean(np.abs(limits)))
    gain -= math.log(y.size)  # any value could have been the limit
    values = (Value("limit", limit, limit - resolution, limit + resolution, state.data.unit),)
    return [Weighed("saturation", "", gain, values, replace(state, named=(*state.named, "saturation"), memory={}))]


register("saturation", saturation)
register("vibration_line", vibration_line)
register("outliers", outliers)
register("telegraph", telegraph)
register("quantization_output", output_counts)
register("dropped_samples", held_samples)
