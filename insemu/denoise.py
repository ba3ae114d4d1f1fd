"""Wavelet de-noising: details of the first octaves shrunk by a threshold or left out, the approximation kept.

With a static signal it leaves the slow errors for an autocorrelation or an AR model to be seen in; with a dynamic one it must stop at the
octave where the vehicle's motion begins (Quinchia et al. 2013, sections 4.5, 5.2 and 5.6; table 7 uses db4, soft, SURE, 6 or 7 levels at 100 Hz).

Wavelet packets, which that paper proposes, adapt the decomposition to the signal: an octave is divided into narrower bands where that tells motion
from noise better (rule "packets").
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import pywt
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError, nearest

Array = NDArray[np.float64]
Rule = Literal["sure", "universal", "approximation", "packets"]
Mode = Literal["soft", "hard"]
Noise = Literal["per-level", "white"]


def sure_threshold(details: ArrayLike) -> float:
    """Return the threshold that minimises Stein's unbiased estimate of the risk of soft shrinkage, for details of unit noise.

    The risk of shrinking ``n`` coefficients by ``t`` is ``n - 2 #{|d| <= t} + sum min(d^2, t^2)`` (Donoho and Johnstone 1995); it is
    least at one of the ``|d|``.

    Examples
    --------
    >>> sure_threshold([0.1, -0.2, 0.05, 8.0])
    0.2
    """
    squares = np.sort(np.abs(np.asarray(details, dtype=float)).ravel() ** 2)
    n = squares.size
    k = np.arange(1, n + 1)
    risk = n - 2.0 * k + np.cumsum(squares) + (n - k) * squares
    return float(np.sqrt(squares[int(np.argmin(risk))]))


def denoise(
    x: ArrayLike,
    levels: int,
    *,
    wavelet: str = "db4",
    rule: Rule = "sure",
    mode: Mode = "soft",
    noise: Noise = "per-level",
) -> Array:
    """Return the signal with the noise of its shortest octaves reduced.

    Parameters
    ----------
    x : (n,) or (n, k) array
        Signal; several columns are treated one by one.
    levels : int
        Octaves whose details are shrunk; 0 returns the signal.
    wavelet : str
        A discrete wavelet of PyWavelets, such as ``"db4"``.
    rule : {"sure", "universal", "approximation", "packets"}
        Threshold: least estimated risk per level (default), or ``sqrt(2 ln n)``; or keep the approximation only, no details; or
        least estimated risk per band of the wavelet packets whose decomposition has the least risk (Coifman and Wickerhauser 1992), the
        noise of an octave being the median over its narrowest bands, which a vibration in some of them does not raise.
    mode : {"soft", "hard"}
        Shrink towards zero, or keep or kill.
    noise : {"per-level", "white"}
        Where the noise's standard deviation comes from: the median absolute detail of each level, or of the first level only.

    Raises
    ------
    InputError
        A signal that is not finite or too short for the levels, an unknown wavelet or option.
    """
    for name, value, known in (
        ("rule", rule, get_args(Rule)),
        ("mode", mode, get_args(Mode)),
        ("noise", noise, get_args(Noise)),
    ):
        if value not in known:
            raise InputError(f"{name} is '{value}', expected one of: {', '.join(known)}")
    signal = np.asarray(x, dtype=np.float64)
    if signal.ndim not in (1, 2) or signal.shape[0] == 0:
        raise InputError(f"signal has shape {signal.shape}, expected (n,) or (n, k)")
    if not np.isfinite(signal).all():
        raise InputError(
            f"signal has {int((~np.isfinite(signal)).sum())} value(s) that are not finite; expected finite numbers"
        )
    if wavelet not in pywt.wavelist(kind="discrete"):
        raise InputError(f"unknown wavelet '{wavelet}'" + nearest(wavelet, pywt.wavelist(kind="discrete")))
    n = signal.shape[0]
    most = pywt.dwt_max_level(n, pywt.Wavelet(wavelet).dec_len)
    if not 0 <= levels <= most:
        raise InputError(f"levels is {levels}, expected 0 to {most} for {n} samples and {wavelet}")
    if levels == 0:
        return signal.copy()
    if signal.ndim == 2:
        return np.column_stack(
            [_denoise(signal[:, k], levels, wavelet, rule, mode, noise) for k in range(signal.shape[1])]
        )
    return _denoise(signal, levels, wavelet, rule, mode, noise)


def _denoise(signal: Array, levels: int, wavelet: str, rule: Rule, mode: Mode, noise: Noise) -> Array:
    # the offset (gravity) is taken out so that the ends, continued by reflection, do not ring at its size
    offset = float(signal.mean())
    approximation, *details = pywt.wavedec(signal - offset, wavelet, mode="symmetric", level=levels)
    # the octave j of "levels" may be divided until its bands are as narrow as the approximation's
    depths = list(range(levels)) if rule == "packets" else [0] * levels
    sigmas = [_deviation_of_bands(d, wavelet, depth) for d, depth in zip(details, depths, strict=True)]
    if noise == "white":
        sigmas = [sigmas[-1]] * levels
    shrunk = [
        _divided(d / sigma, wavelet, depth, mode, d.size)[1] * sigma
        if rule == "packets" and sigma > 0.0
        else _shrunk(d, sigma, rule, mode)
        for d, sigma, depth in zip(details, sigmas, depths, strict=True)
    ]
    return np.asarray(pywt.waverec([approximation, *shrunk], wavelet, mode="symmetric")[: signal.size]) + offset


def _shrunk(d: Array, sigma: float, rule: Rule, mode: Mode) -> Array:
    """The details of one octave after the rule."""
    if rule == "approximation":
        return np.zeros_like(d)
    if sigma == 0.0:
        return d
    t = sure_threshold(d / sigma) if rule == "sure" else float(np.sqrt(2.0 * np.log(d.size)))
    return np.asarray(pywt.threshold(d, t * sigma, mode=mode))


def _divided(d: Array, wavelet: str, depth: int, mode: Mode, octave: int) -> tuple[float, Array]:
    """Least estimated risk of a band in unit noise, divided up to ``depth`` times or not, and its coefficients after shrinkage.

    Parameters
    ----------
    d : (n,) array
        Coefficients of the band.
    wavelet : str
    depth : int
        How often it may still be divided.
    mode : {"soft", "hard"}
    octave : int
        Coefficients of the whole octave, for the threshold of a band that holds little but noise (Donoho and Johnstone 1995: the least
        estimate of the risk finds a poor one there).
    """
    sparse = np.mean(d * d) - 1.0 <= np.log2(d.size) ** 1.5 / np.sqrt(d.size)
    t = float(np.sqrt(2.0 * np.log(octave))) if sparse else sure_threshold(d)
    risk = float(d.size - 2.0 * np.count_nonzero(np.abs(d) <= t) + np.sum(np.minimum(d * d, t * t)))
    whole = risk, np.asarray(pywt.threshold(d, t, mode=mode))
    if depth == 0:
        return whole
    halves = [_divided(half, wavelet, depth - 1, mode, octave) for half in pywt.dwt(d, wavelet, mode="symmetric")]
    together = halves[0][0] + halves[1][0]
    if together >= risk:
        return whole
    return together, np.asarray(pywt.idwt(halves[0][1], halves[1][1], wavelet, mode="symmetric")[: d.size])


def _deviation_of_bands(d: Array, wavelet: str, depth: int) -> float:
    """Standard deviation of the noise in an octave: the median over the bands into which it is divided ``depth`` times."""
    bands = [d]
    for _ in range(depth):
        bands = [half for band in bands for half in pywt.dwt(band, wavelet, mode="symmetric")]
    return float(np.median([_deviation(band) for band in bands]))


def delayed_approximation(x: ArrayLike, levels: int, delay: int, *, wavelet: str = "db4") -> Array:
    """Return the approximation of a signal as a filter in real time knows it: every sample from those up to ``delay`` later.

    The rule "approximation" of :func:`denoise` is linear, so the sample ``delay`` before the end of a sliding window, continued by
    reflection, is one finite impulse response. Without delay it is causal.

    Parameters
    ----------
    x : (n,) array
        Signal, taken as constant before its first sample and after its last.
    levels : int
        Octaves whose details are left out, 1 and more.
    delay : int
        Samples, 0 and more.
    wavelet : str
        A discrete wavelet of PyWavelets.

    Raises
    ------
    InputError
        Unknown wavelet, levels below 1, a delay that is negative or reaches past the filter's middle.
    """
    from scipy.signal import oaconvolve

    if wavelet not in pywt.wavelist(kind="discrete"):
        raise InputError(f"unknown wavelet '{wavelet}'" + nearest(wavelet, pywt.wavelist(kind="discrete")))
    if not 1 <= levels <= 12:
        raise InputError(f"levels is {levels}, expected 1 to 12")
    window = 2**levels * 2 * pywt.Wavelet(wavelet).dec_len
    if not 0 <= delay <= window // 2:
        raise InputError(
            f"delay is {delay} samples, expected 0 to {window // 2} for {levels} levels of {wavelet} (longer changes nothing)"
        )
    # the response at one place to an impulse at every other
    bands = pywt.wavedec(np.eye(window), wavelet, mode="symmetric", level=levels, axis=1)
    response = pywt.waverec([bands[0], *map(np.zeros_like, bands[1:])], wavelet, mode="symmetric", axis=1)
    taps = response[:, window - 1 - delay]
    signal = np.asarray(x, dtype=np.float64)
    offset = float(signal[0])
    padded = np.pad(signal - offset, (window - 1 - delay, delay), mode="edge")
    return np.asarray(oaconvolve(padded, taps[::-1], mode="valid")) + offset * float(taps.sum())


def outstanding(x: Array, levels: int, *, noise: Array | None = None) -> Array:
    """Return what stands out of white noise at any time and octave, about the median: all that is left of an axis at rest is a constant.

    Every coefficient, those of the approximation too, is kept or killed at ``sqrt(2 ln n)`` deviations of the noise (Donoho and Johnstone
    1994): those of the first octave, or of what is known of the noise where that is less, as where the first octave holds vibration.

    Parameters
    ----------
    x : (n, k) array
        Finite signals, treated one by one.
    levels : int
        Octaves, 1 and more.
    noise : (k,) array, optional
        Standard deviations of the white noise of each signal.
    """
    out, most = np.empty_like(x), np.full(x.shape[1], np.inf) if noise is None else noise
    for k in range(x.shape[1]):
        offset = float(np.median(x[:, k]))
        # periodic, so that the coefficients of the ends scatter as all others do
        all_of_it = pywt.wavedec(x[:, k] - offset, "db4", mode="periodization", level=levels)
        least = min(_deviation(all_of_it[-1]), float(most[k])) * float(np.sqrt(2.0 * np.log(x.shape[0])))
        kept = [pywt.threshold(c, least, mode="hard") for c in all_of_it]
        out[:, k] = pywt.waverec(kept, "db4", mode="periodization")[: x.shape[0]] + offset
    return out


def _deviation(details: Array) -> float:
    return float(np.median(np.abs(details)) / 0.6744897501960817)
