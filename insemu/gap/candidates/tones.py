"""Tones in the band above the motion: what a vehicle hums, what a sensor's line is, and what wanders."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from insemu.gap.data.log import Reduced, reduce_again
from insemu.gap.evidence.model import Explanation
from insemu.gap.policy import rules

Array = NDArray[np.float64]


def without_tones(data: Reduced, explanation: Explanation) -> Reduced:
    """The axis without tones that come in company: a line of the sensor stands alone, what a vehicle hums does not.

    A tone counts where the periodogram stands out by more than noise does anywhere; a single one, or one that towers over the others, stays.
    So does a band of noise, however strong.
    """
    n, dt = data.values.size, data.dt
    z = np.fft.rfft(data.values - data.values.mean())
    f = np.arange(z.size) / (n * dt)
    inside = (f >= data.f[0]) & (f <= data.f[-1])
    ratio = np.zeros(z.size)
    power = np.abs(z) ** 2 * dt / n
    ratio[inside] = power[inside] / np.maximum(explanation.psd(f[inside], dt), _steady(data, f, power)[inside])
    limit = math.log(n) + 6.0
    loud = np.flatnonzero(ratio > limit)
    if not loud.size:
        return data
    first = int(np.argmax(ratio))
    # sidelobes of the loudest fall with the square of the distance
    apart = np.abs(loud - first)
    others = loud[(apart > 3) & (ratio[loud] > 4.0 * ratio[first] / np.maximum(apart, 1.0) ** 2)]
    if not others.size or float(ratio[others].max()) < 0.1 * ratio[first]:
        return data
    z[loud] *= np.sqrt(1.0 / ratio[loud])
    return reduce_again(data, np.fft.irfft(z, n))


def _steady(data: Reduced, f: Array, power: Array) -> Array:
    """PSD at the ordinates of the periodogram where it is noise: even over a bin, and the same from piece to piece; zero elsewhere."""
    edges = np.searchsorted(f, np.concatenate([data.f[:1], 0.5 * (data.f[1:] + data.f[:-1]), data.f[-1:]]))
    out = np.zeros(f.size)
    for k, (first, last) in enumerate(pairwise(edges)):
        if last - first < 8:
            continue
        even = float(np.median(power[first:last])) / math.log(2.0)
        spread = math.sqrt(2.1 / (last - first) + 2.0 / float(data.dof[k]))
        if abs(math.log(even / data.power[k])) < 3.0 * spread + 0.05:
            out[first:last] = data.power[k]
    return out


def loudest(data: Reduced) -> tuple[Array, Array]:
    """Frequency of the loudest ordinate in every piece of an axis (Hz), and its height above the median of the piece."""
    length = max(16, round(rules().tone_piece_s / data.dt))
    count = data.values.size // length
    if not data.f.size or count < rules().tone_pieces:
        return np.zeros(0), np.zeros(0)
    pieces = data.values[: count * length].reshape(count, length)
    window = np.hanning(length)
    power = np.abs(np.fft.rfft((pieces - pieces.mean(axis=1, keepdims=True)) * window, axis=1)) ** 2
    f = np.arange(power.shape[1]) / (length * data.dt)
    inside = (f >= data.f[0]) & (f <= data.f[-1])
    f, power = f[inside], power[:, inside]
    # the shape of the spectrum is what the pieces have in common
    shape = np.median(power, axis=0)
    ratio = power / np.maximum(shape, 1e-300)
    ratio *= math.log(2.0) / np.maximum(np.median(ratio, axis=1, keepdims=True), 1e-300)
    top = np.argmax(ratio, axis=1)
    return np.asarray(f[top]), ratio[np.arange(count), top]


def wandering(parts: Mapping[str, Reduced]) -> dict[str, tuple[float, float]]:
    """Axes on which a tone changes its frequency steadily, and from where to where in Hz.

    Only a tone of one axis alone: what the vehicle hums as its engine speeds up reaches several axes at once.
    """
    seen = {name: loudest(data) for name, data in parts.items()}
    out = {}
    for name, (f, height) in seen.items():
        loud = np.flatnonzero(height > rules().tone_loud)
        if loud.size < max(rules().tone_share * f.size, rules().tone_pieces // 2):
            continue
        way = f[loud]
        near = np.diff(loud) <= 3
        step = np.diff(way)[near]
        variance = float(np.var(way))
        spacing = 1.0 / rules().tone_piece_s
        # a few pieces may be led astray by something else
        if (
            not near.any()
            or np.median(step**2) > 2.0 * rules().tone_smooth * variance
            or math.sqrt(12.0 * variance) < rules().tone_way * spacing
        ):
            continue
        followed = [
            float(np.mean((g[loud] - way) ** 2 <= (2.0 * spacing) ** 2))
            for other, (g, h) in seen.items()
            if other != name and g.size == f.size and np.median(h[loud]) > 0.5 * rules().tone_loud
        ]
        if not followed or max(followed) < rules().tone_shared:
            out[name] = (float(way[0]), float(way[-1]))
    return out
