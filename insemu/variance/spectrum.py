"""Power spectral densities and autocorrelation of static signals.

Densities are two-sided, in unit^2/Hz at frequencies in Hz (0 < f <= rate / 2), and named ``_one_sided`` where they are not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError
from insemu.variance.edof import check_confidence
from insemu.variance.wavelet import WaveletVariance, check_rate, check_signal

Array = NDArray[np.float64]
Method = Literal["welch", "multitaper", "periodogram"]


@dataclass(frozen=True)
class Spectrum:
    """A power spectral density.

    Parameters
    ----------
    f_hz : (k,) array
        Frequencies, increasing, without 0.
    psd : (k,) array
        Two-sided density in unit^2/Hz; twice that, one-sided, is :attr:`psd_one_sided`.
    low, high : (k,) arrays
        Chi-square interval.
    edof : (k,) array
        Equivalent degrees of freedom of each value.
    method : str
        How it was made.
    confidence : float
        Level of the interval.
    """

    f_hz: Array
    psd: Array
    low: Array
    high: Array
    edof: Array
    method: str
    confidence: float = 0.95

    @property
    def psd_one_sided(self) -> Array:
        """Density with all power at positive frequencies."""
        return 2.0 * self.psd


def _spectrum(f: Array, psd: Array, edof: Array, method: str, confidence: float) -> Spectrum:
    tail = 0.5 * (1.0 - check_confidence(confidence))
    return Spectrum(
        f,
        psd,
        edof * psd / scipy.special.chdtri(edof, tail),
        edof * psd / scipy.special.chdtri(edof, 1.0 - tail),
        edof,
        method,
        confidence,
    )


def psd(
    x: ArrayLike,
    rate_hz: float = 1.0,
    *,
    method: Method = "welch",
    segment: int | None = None,
    bandwidth: float = 4.0,
    confidence: float = 0.95,
) -> Spectrum:
    """Return the two-sided power spectral density of a signal.

    Parameters
    ----------
    x : (n,) array
        Signal; its mean is removed.
    rate_hz : float
        Sampling rate.
    method : {"welch", "multitaper", "periodogram"}
        Welch: Hann windows of ``segment`` samples, half overlapped (default: about eight of them, at most 2^20 samples). Multitaper:
        ``2 bandwidth - 1`` Slepian tapers of time-bandwidth ``bandwidth``, nearly free of leakage. Periodogram: one transform.
    segment : int, optional
        Length of a Welch segment.
    bandwidth : float
        Time-bandwidth product of the multitaper.
    confidence : float
        Level of the chi-square interval.

    Raises
    ------
    InputError
        A bad signal or option.

    Notes
    -----
    Equation (12) of Quinchia et al. 2013; multitaper after Percival & Walden 1993.
    """
    if method not in get_args(Method):
        raise InputError(f"method is '{method}', expected one of: {', '.join(get_args(Method))}")
    rate_hz = check_rate(rate_hz)
    values = check_signal(x)
    values = values - values.mean()
    n = values.size
    if method == "welch":
        length = min(n, 1 << 20, max(8, 2 * n // 9)) if segment is None else int(segment)
        if not 8 <= length <= n:
            raise InputError(f"segment is {length} samples, expected 8 to {n}")
        f, power = scipy.signal.welch(
            values, rate_hz, window="hann", nperseg=length, noverlap=length // 2, detrend="constant"
        )
        pieces = 1 + (n - length) // (length - length // 2)
        # half-overlapped Hann segments are correlated by 1/6 of their amplitude: (1/6)^2 of their power
        edof = 2.0 * pieces / (1.0 + 2.0 * (1.0 - 1.0 / pieces) / 36.0)
        return _spectrum(f[1:], _two_sided(power, length)[1:], np.full(f.size - 1, edof), method, confidence)
    f = scipy.fft.rfftfreq(n, 1.0 / rate_hz)
    if method == "periodogram":
        power = np.abs(scipy.fft.rfft(values)) ** 2 / (n * rate_hz)
        return _spectrum(f[1:], power[1:], np.full(f.size - 1, 2.0), method, confidence)
    if not 1.5 <= bandwidth <= n / 4:
        raise InputError(f"bandwidth is {bandwidth}, expected 1.5 to {n / 4:g}")
    tapers = scipy.signal.windows.dpss(n, bandwidth, Kmax=int(2 * bandwidth) - 1)
    power = np.mean([np.abs(scipy.fft.rfft(values * taper)) ** 2 for taper in tapers], axis=0) / rate_hz
    return _spectrum(f[1:], power[1:], np.full(f.size - 1, 2.0 * len(tapers)), method, confidence)


def _two_sided(power: Array, length: int) -> Array:
    """Undo the doubling of scipy's one-sided density (not doubled at 0 and at half the rate)."""
    out = 0.5 * power
    out[0] *= 2.0
    if length % 2 == 0:
        out[-1] *= 2.0
    return out


def average_frequencies(spectrum: Spectrum, per_decade: int = 10) -> Spectrum:
    """Return the density averaged over bands of equal width in log frequency (frequency averaging of Quinchia et al. 2013, section 5.4).

    Each band's frequency is the mean of its own; the degrees of freedom add.
    """
    if per_decade < 1:
        raise InputError(f"per_decade is {per_decade}, expected at least 1")
    band = np.floor(np.log10(spectrum.f_hz) * per_decade + 1e-9).astype(int)
    return _average(spectrum, (band - band.min()).astype(np.int64), f"{spectrum.method}, averaged")


def average_octaves(spectrum: Spectrum, rate_hz: float) -> Spectrum:
    """Return the density averaged over the octaves ``rate / 2^(j+1) < f <= rate / 2^j`` that wavelet variances see."""
    j = np.floor(np.log2(rate_hz / spectrum.f_hz) + 1e-12).astype(int)
    return _average(spectrum, (j.max() - j).astype(np.int64), f"{spectrum.method}, octaves")


def _average(spectrum: Spectrum, band: NDArray[np.int64], method: str) -> Spectrum:
    count = np.bincount(band).astype(float)
    used = count > 0
    f = np.bincount(band, spectrum.f_hz)[used] / count[used]
    value = np.bincount(band, spectrum.psd)[used] / count[used]
    edof: Array = np.bincount(band, spectrum.edof)[used].astype(np.float64)
    if spectrum.method == "multitaper":  # neighbouring frequencies share the tapers' band
        edof = np.maximum(edof / spectrum.edof[0] * 2.0, spectrum.edof[0])
    elif spectrum.method == "welch":  # a Hann window correlates the power of neighbours by 4/9 and of next ones by 1/36
        edof = np.maximum(edof / (1.0 + 2.0 * (4.0 / 9.0 + 1.0 / 36.0)), spectrum.edof[0])
    return _spectrum(f, value, edof, method, spectrum.confidence)


def octave_psd(curve: WaveletVariance) -> Spectrum:
    """Return the PSD level of each octave from a wavelet variance, ``2^j v_j / rate`` (equations (31)-(33) of Stebler et al. 2014).

    The level of octave j stands for the band ``rate / 2^(j+1)`` to ``rate / 2^j`` and is given at its centre. It is exact where the spectrum is flat,
    as filters leak: where the spectrum falls by ``f^-2`` it is 65 % above the octave's mean with Haar, 9 % with d6, 6 % with la8.
    """
    factor = curve.scale_samples / curve.rate_hz
    f = 0.75 * curve.rate_hz / curve.scale_samples
    order = np.argsort(f)
    spectrum = _spectrum(
        f[order],
        (factor * curve.value)[order],
        curve.edof[order],
        f"octaves of the {curve.filter} wavelet",
        curve.confidence,
    )
    return replace(spectrum, low=(factor * curve.low)[order], high=(factor * curve.high)[order])


@dataclass(frozen=True)
class Autocorrelation:
    """Autocovariance and autocorrelation of a signal.

    Parameters
    ----------
    lag_s : (k,) array
        Lags in s, from 0.
    covariance : (k,) array
        In unit^2.
    correlation : (k,) array
        Covariance over its value at lag 0.
    white_bound : float
        Correlations of white noise stay within plus and minus this, 95 % of them.
    """

    lag_s: Array
    covariance: Array
    correlation: Array
    white_bound: float


def autocorrelation(x: ArrayLike, rate_hz: float = 1.0, *, max_lag_s: float | None = None) -> Autocorrelation:
    """Return the (biased, positive definite) autocovariance of a signal about its mean, by fast transforms.

    Give it :func:`insemu.denoise.denoise` of a signal for the correlation that remains when white noise is reduced (Quinchia et al. 2013, 5.2).

    Parameters
    ----------
    x : (n,) array
        Signal.
    rate_hz : float
        Sampling rate.
    max_lag_s : float, optional
        Longest lag, s; the whole record by default.

    Raises
    ------
    InputError
        A bad signal; a lag longer than the record.
    """
    rate_hz = check_rate(rate_hz)
    values = check_signal(x)
    n = values.size
    most = n - 1 if max_lag_s is None else round(max_lag_s * rate_hz)
    if not 1 <= most < n:
        raise InputError(f"max_lag_s is {max_lag_s}, expected {1 / rate_hz:g} to {(n - 1) / rate_hz:g} s")
    transform = scipy.fft.rfft(values - values.mean(), scipy.fft.next_fast_len(n + most, real=True))
    covariance = scipy.fft.irfft(np.abs(transform) ** 2, scipy.fft.next_fast_len(n + most, real=True))[: most + 1] / n
    if covariance[0] <= 0.0:
        raise InputError("the signal is constant and has no autocorrelation")
    return Autocorrelation(
        np.arange(most + 1) / rate_hz, covariance, covariance / covariance[0], 1.96 / float(np.sqrt(n))
    )
