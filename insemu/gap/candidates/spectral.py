"""What shapes the spectrum of an axis: vibration as a band or a line, and the low-pass of the output."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from insemu.gap.candidates.axis import (
    LEAST_POWER,
    AxisHypothesis,
    AxisState,
    amplitude,
    best_of,
    cleaned,
)
from insemu.gap.evidence.band import Band
from insemu.gap.evidence.linear import log_mean_exp
from insemu.gap.evidence.model import Component
from insemu.gap.evidence.modes import Free
from insemu.gap.evidence.rolloff import DEPTH, HALF_POWER, Rolloff
from insemu.gap.hypothesis import Hypothesis, Later
from insemu.gap.policy import rules
from insemu.gap.verdict import Value

Array = NDArray[np.float64]


def vibration_band(state: AxisState) -> list[AxisHypothesis]:
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
        amplitude("sigma", 30.0 * state.white / math.sqrt(data.dt)),
        Free("f", lowest, 0.97 * nyquist),
        Free("ratio", 0.003, rules().highest_bandwidth),  # wider is no resonance
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


def decimation_filter(state: AxisState) -> list[AxisHypothesis]:
    """A low-pass of the output that the nominal model lacks."""
    if state.explanation.rolloff is not None or not state.data.f.size:
        return []
    nyquist = 0.5 / state.data.dt
    out = []
    order = Free("order", 0.6, rules().highest_order)
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


#: Pieces of a moving sensor's record whose noise around a line is their own.
LINE_PIECES = 32
#: Ordinates of a piece on either side of a line that say what the noise is there.
NEAR_LINE = 12
#: Sums of the turned signal in which the frequency of a line is refined.
SUMS = 4096
#: Frequencies at which a line is looked for, per independent one.
FINER = 4
#: Relative width of the cells of a periodogram of which the largest ordinate is kept.
CELL = 1e-3


def vibration_line(state: AxisState) -> list[AxisHypothesis]:
    """A sinusoid: full-resolution scan, complex amplitude integrated out, frequency paid for."""
    data = state.data
    if not data.f.size:
        return []
    n, dt = data.values.size, data.dt
    y = data.values - data.values.mean()
    m = FINER * n
    f, top, count = data.remembered("line", lambda: _cells(y, m, dt, float(data.f[0]), 0.5 / dt * (1.0 - 4.0 / n)))
    if not f.size:
        return []
    # beyond an output filter there is nothing but what leaks there, and no line stands out of that
    S = state.explanation.psd(f, dt)
    order = np.argsort(S)
    half = np.searchsorted(np.cumsum(count[order]), 0.5 * count.sum())
    least = LEAST_POWER * float(S[order[half]])
    ratio = top / np.maximum(S, least)
    k = int(np.argmax(ratio))
    at = float(f[k])
    # a line between two frequencies of the grid is worth what it is at its own
    peak = max(float(ratio[k]), _height(y, dt, at) / max(float(S[k]), least))
    looked = float(count.sum()) / FINER
    nats = _line_nats(peak, looked)
    if nats < 0.0:
        return [Hypothesis("vibration_line", nats, (), state)]
    frequency, a, b = _sinusoid(y, dt, at, 1.0 / (n * dt))
    if not data.differences.size:
        # how loud a moving sensor is changes with the motion
        nats = min(nats, _line_nats(_steady_power(y, dt, frequency), looked))
        if nats < 0.0:
            return []
    amplitude = math.hypot(a, b)

    def without() -> AxisState:
        turn = 2.0 * math.pi * frequency * dt * np.arange(n)
        return cleaned(state, data.values - a * np.cos(turn) - b * np.sin(turn), "vibration_line")

    sigma = math.sqrt(2.0 * float(state.explanation.psd(np.array([frequency]), dt)[0]) / (n * dt))
    df = math.sqrt(6.0) / math.pi * sigma / amplitude / (n * dt)
    values = (
        Value.normal("amplitude", amplitude, sigma, data.unit),
        Value.normal("frequency", frequency, df, "Hz"),
    )
    return [Hypothesis("vibration_line", nats, values, Later(without))]


def _cells(y: Array, m: int, dt: float, low: float, high: float) -> Array:
    """The largest ordinates of a periodogram in cells so narrow that no density moves within one.

    Parameters
    ----------
    y : (n,) array
    m : int
        Samples that it is filled up to with zeros.
    dt : float
        Sampling interval, s.
    low, high : float
        Frequencies between which they lie, Hz.

    Returns
    -------
    (3, k) array
        Frequency (Hz) and value (unit^2/Hz) of the largest ordinate of each cell, and how many it has.
    """
    z = np.fft.rfft(y, m)
    spectrum = (z.real**2 + z.imag**2) * (dt / y.size)
    first = max(math.ceil(low * m * dt - 1e-9), 1)
    last = min(math.ceil(high * m * dt - 1e-9), spectrum.size)
    if last <= first:
        return np.zeros((3, 0))
    # single ordinates as long as they are further apart than a cell is wide
    edges = np.unique(np.geomspace(first, last, math.ceil(math.log(last / first) / CELL) + 2).astype(np.int64))
    edges = edges[edges < last]
    top = np.maximum.reduceat(spectrum[:last], edges)
    count = np.diff(np.append(edges, last))
    cell = np.repeat(np.arange(edges.size), count)
    best = np.flatnonzero(spectrum[first:last] == top[cell])
    at = np.zeros(edges.size)
    at[cell[best]] = first + best
    return np.stack([at / (m * dt), top, count])


def _height(y: Array, dt: float, f0: float) -> float:
    """Periodogram at the best frequency near ``f0``."""
    _, a, b = _sinusoid(y, dt, f0, 1.0 / (y.size * dt))
    return 0.25 * (a * a + b * b) * y.size * dt


def _line_nats(peak: float, looked: float) -> float:
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
    # turned back by the first guess the signal is slow: near that frequency sums of a few hundred samples say it all
    block = max(1, y.size // SUMS)
    turn = -2j * math.pi * f0 * dt
    whole = y.size // block * block
    inside = np.exp(turn * np.arange(block))
    turned = y[:whole].reshape(-1, block) @ inside
    if whole < y.size:
        turned = np.append(turned, y[whole:] @ inside[: y.size - whole])
    turned = turned * np.exp((turn * block) * np.arange(turned.size))
    t = np.minimum(np.arange(turned.size) * block + 0.5 * (block - 1), y.size - 1.0) * dt

    def project(f: float) -> complex:
        return complex(np.dot(turned, np.exp(-2j * math.pi * (f - f0) * t)))

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
