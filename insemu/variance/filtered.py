"""Wavelet variances of any filter from a spectrum: their expectation, covariance and scatter over a finite record.

A coefficient of octave j is the signal through a filter of squared gain ``|H_j(f)|^2`` (Percival and Walden 2000, section 8.3; equation (5) of
Stebler et al. 2014). Its variance is the integral of the gain times the spectrum, its autocovariance that integral's cosine transform, and
the variance of the mean square of M coefficients is ``2 / M^2 sum_k (M - |k|) s_k^2``. An octave sees frequencies near ``2^-j`` only, so all of
it is taken at the same points of ``x = 2^j f``, up to :data:`HIGHEST` and with lags in steps of ``2^j / (2 HIGHEST)`` samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError
from insemu.noise import PROCESSES, NoiseModel, Process
from insemu.noise.compiled import callback_of
from insemu.variance.edof import NoiseType, Scatter, octave_correlation
from insemu.variance.filters import modwt_filters

Array = NDArray[np.float64]

#: Highest frequency of an octave in units of one over its scale: beyond, the filters' gain is below 1e-4 of its peak.
HIGHEST = 16.0
#: Time constants of a Markov noise, or scales if they are shorter, after which its coefficients are uncorrelated.
TAIL = 12.0
#: Bins per factor of two of the frequency, where a spectrum is integrated many times in a search.
BINS_PER_OCTAVE = 24


@dataclass(frozen=True)
class Octave:
    """One octave of a filter.

    Parameters
    ----------
    j : int
        From 1.
    f : (k,) array
        Frequencies in cycles per sample, evenly from 0.
    gain : (k,) array
        Squared gain there, the first just next to 0.
    weight : (k,) array
        Weights of the integral over both signs of the frequency.
    stride : float
        Samples between the lags of the transform.
    reach : int
        Samples that a coefficient sees.
    """

    j: int
    f: Array
    gain: Array
    weight: Array
    stride: float
    reach: int

    def lags(self, spectrum: Array) -> Array:
        """Autocovariance of the coefficients at multiples of the stride, of the spectrum that the signal has at ``f``."""
        seen = self.gain * spectrum
        return np.asarray(scipy.fft.irfft(seen, norm="forward") * self.f[1])


@lru_cache(maxsize=64)
def octave(filter: str, j: int) -> Octave:
    """The octave ``j`` (from 1) of a filter by name."""
    h, _ = modwt_filters(filter)
    scale = 1 << j
    stride = max(1.0, scale / (2.0 * HIGHEST))
    reach = (scale - 1) * (h.size - 1) + 1
    count = scipy.fft.next_fast_len(int(2.2 * (reach + TAIL * scale) / stride) + 16, real=True)
    count += count % 2
    f = np.arange(count // 2 + 1) / (count * stride)
    gain = _gain(filter, j, _beside_zero(f))
    weight = np.full(f.size, 2.0 * f[1])
    weight[0] = weight[-1] = f[1]
    for a in (f, gain, weight):
        a.setflags(write=False)
    return Octave(j, f, gain, weight, stride, reach)


def _gain(filter: str, j: int, f: Array) -> Array:
    """Squared gain of an octave at frequencies in cycles per sample."""
    h, g = modwt_filters(filter)
    gain = np.abs(_response(h, f * (1 << (j - 1)))) ** 2
    for i in range(j - 1):
        gain *= np.abs(_response(g, f * (1 << i))) ** 2
    return gain


def _beside_zero(f: Array) -> Array:
    """Even frequencies from 0 on, the first of which is moved a little: a random walk is infinite there, and a filter of one vanishing moment
    lets through a finite share of it.
    """
    out = f.copy()
    out[0] = 1e-3 * f[1]
    return out


def _response(taps: Array, f: Array) -> NDArray[np.complex128]:
    return np.asarray(np.polynomial.polynomial.polyval(np.exp(-2j * np.pi * f), taps), dtype=np.complex128)


def _spectrum(process: Process | NoiseModel, at: Octave, dt: float = 1.0) -> Array:
    """Spectrum in unit^2 per cycle and sample, where the gain is taken."""
    return np.asarray(process.psd(_beside_zero(at.f) / dt, dt) / dt, dtype=np.float64)


def expected_variance(model: Process | NoiseModel, filter: str, scale_samples: ArrayLike, dt: float = 1.0) -> Array:
    """Wavelet variance of a process at scales of a filter.

    Parameters
    ----------
    model : Process or NoiseModel
        Specified.
    filter : str
        Name of the filter.
    scale_samples : (J,) array of int
        Scales 2^j in samples.
    dt : float
        Sampling interval, s.

    Returns
    -------
    (J,) array
        unit^2.

    Raises
    ------
    InputError
        A process of one draw (ramp, sinusoid, constant), which has no spectrum, and another filter than Haar.
    """
    if filter == "haar":
        return model.wavelet_variance(scale_samples, dt)
    refuse_signals(model, filter)
    return np.array([np.sum(at.weight * at.gain * _spectrum(model, at, dt)) for at in _octaves(filter, scale_samples)])


def refuse_signals(model: Process | NoiseModel, filter: str) -> None:
    """Raise ``InputError`` for a process of one draw where another filter than Haar is asked for."""
    for p in (model,) if isinstance(model, Process) else model:
        if p.single_draw and filter != "haar":
            raise InputError(f"{p.symbol} has no spectrum and cannot be fitted with the filter '{filter}'; use haar")


def _octaves(filter: str, scale_samples: ArrayLike) -> list[Octave]:
    return [octave(filter, round(math.log2(s))) for s in np.atleast_1d(np.asarray(scale_samples, dtype=np.float64))]


def filter_covariance(
    model: NoiseModel, filter: str, scale_samples: ArrayLike, n_samples: int, dt: float = 1.0
) -> Array:
    """Covariance matrix of a filter's wavelet variances under a model over a record.

    On the diagonal the sum over the lags of the record; off it the limit of long records, equation (15) of Stebler et al. 2014.

    Parameters
    ----------
    model : NoiseModel
        Specified.
    filter : str
        Name of the filter, not Haar.
    scale_samples : (J,) array of int
        Scales 2^j in samples, ascending.
    n_samples : int
        Length of the record.
    dt : float
        Sampling interval, s.

    Returns
    -------
    (J, J) array
        unit^4.
    """
    refuse_signals(model, filter)
    grids = _octaves(filter, scale_samples)
    spectra = [_spectrum(model, at, dt) for at in grids]
    out = np.empty((len(grids), len(grids)))
    for i, (at, spectrum) in enumerate(zip(grids, spectra, strict=True)):
        out[i, i] = _variance_of_mean(at.lags(spectrum), at, n_samples)
        for k in range(i + 1, len(grids)):
            other = grids[k]
            # the longer octave passes lower frequencies: both gains on its grid
            near = _gain(filter, at.j, _beside_zero(other.f))
            both = np.sum(other.weight * near * other.gain * spectra[k] ** 2)
            out[i, k] = out[k, i] = 2.0 * both / max(n_samples - at.reach + 1, 1)
    return out


@lru_cache(maxsize=64)
def _bins(filter: str, scale: int) -> tuple[Array, Array]:
    """Frequencies and weights (squared gain included) of an octave, gathered in narrow bins: a quadrature for smooth spectra."""
    at = octave(filter, round(math.log2(scale)))
    f, weight = _beside_zero(at.f), at.weight * at.gain
    which = np.maximum(np.floor(np.log2(f * scale) * BINS_PER_OCTAVE).astype(np.int64), -8 * BINS_PER_OCTAVE)
    _, at_bin = np.unique(which, return_inverse=True)
    total = np.bincount(at_bin, weight)
    centre: Array = np.bincount(at_bin, weight * f) / np.maximum(total, 1e-300)
    keep = total > 0.0
    return centre[keep], np.asarray(total[keep], dtype=np.float64)


def curve_address(process: Process, filter: str, dt: float) -> tuple[int, object]:
    """As :meth:`insemu.noise.Process.curve_address` for another filter than Haar: an address and what must be kept with it.

    Parameters
    ----------
    process : Process
    filter : str
        Name of the filter.
    dt : float
        Sampling interval, s.
    """
    refuse_signals(process, filter)
    structure = process.with_parameters(dict.fromkeys(process.given))
    known: dict[bytes, Array] = {}  # a process without shapes has one curve

    def derived(m: Array, shapes: Array) -> Array:
        key = m.tobytes()
        if key in known:
            return known[key]
        unit = structure.of_coordinates(1.0, [float(v) for v in shapes], dt)
        nodes = [_bins(filter, int(2.0 * v)) for v in m]
        ends = np.cumsum([f.size for f, _ in nodes])[:-1]
        density = unit.psd(np.concatenate([f for f, _ in nodes]) / dt, dt) / dt
        out = np.array([w @ s for (_, w), s in zip(nodes, np.split(density, ends), strict=True)])
        if not shapes.size:
            known[key] = out
        return out

    return callback_of(derived)


def _variance_of_mean(s: Array, at: Octave, n_samples: int) -> float:
    count = n_samples - at.reach + 1
    lags = at.stride * np.arange(s.size // 2)
    weight = np.maximum(1.0 - lags / count, 0.0) * at.stride
    squares = weight * s[: lags.size] ** 2
    # a stride of samples stands for each of its lags, and lag zero for itself and half a stride on either side
    return float(2.0 / count * (2.0 * squares.sum() - squares[0]))


@lru_cache(maxsize=1024)
def _unit(kind: str, tc: float, filter: str, j: int) -> tuple[float, Array]:
    """Variance and autocovariance of a unit component through an octave."""
    process = PROCESSES[kind]().of_coordinates(1.0, (-np.log(tc),) if kind == "GM" else (), 1.0)
    at = octave(filter, j)
    s = at.lags(_spectrum(process, at))[: at.f.size]
    s.setflags(write=False)
    return float(s[0]), s


@lru_cache(maxsize=64)
def unit_curves(filter: str, octaves: tuple[int, ...], components: tuple[tuple[str, float], ...]) -> Array:
    """Wavelet variances (octaves, components) of unit components; a ramp leaves none in filters with two vanishing moments.

    Parameters
    ----------
    filter : str
        Name of the filter.
    octaves : tuple of int
        From 1.
    components : tuple of (kind, time constant in samples)
    """
    return np.array(
        [[0.0 if kind == "DR" else _unit(kind, tc, filter, j)[0] for kind, tc in components] for j in octaves]
    )


def scatter_of_filter(noise: NoiseType, filter: str, levels: int, n_samples: int) -> Scatter:
    """How the wavelet variances of a filter scatter for a noise, over a finite record.

    Parameters
    ----------
    noise : NoiseType
    filter : str
        Name of the filter.
    levels : int
        Octaves 1 ... ``levels``.
    n_samples : int
        Length of the record.
    """
    parts = [(k, part) for k, part in enumerate(noise.parts) if part[0] != "DR"]
    edof, skew = np.ones(levels), np.ones(levels)
    slopes = np.zeros((levels, len(parts)))
    for j in range(1, levels + 1) if parts else ():
        at = octave(filter, j)
        units = np.array([_unit(kind, tc, filter, j)[1] for _, (kind, tc, _) in parts])
        weights = np.array([w for _, (_, _, w) in parts])

        # long octaves see next to nothing of quantization noise: only the shape counts, and squares must not underflow
        if not (level := weights @ units[:, 0]) > 0.0:
            continue
        units = units / level

        def freedom(w: Array, at: Octave = at, units: Array = units) -> float:
            s = w @ units
            return float(2.0 * s[0] ** 2 / _variance_of_mean(np.concatenate([s, s]), at, n_samples))

        edof[j - 1] = freedom(weights)
        for k in range(len(parts)):
            step = np.zeros(len(parts))
            step[k] = 1e-3 * weights[k]
            slopes[j - 1, k] = (np.log(freedom(weights + step)) - np.log(freedom(weights - step))) / (2.0 * step[k])
        # third cumulant of a mean of squares in the limit of long records, over that of a chi-square
        seen = at.gain * sum(w / level * _spectrum_of(kind, tc, filter, j) for _, (kind, tc, w) in parts)
        one, two, three = (float(np.sum(at.weight * seen**power)) for power in (1, 2, 3))
        skew[j - 1] = three**2 * one**2 / two**4
    follows = np.zeros(levels)
    if parts and noise.moves.shape[1] == levels:
        each = slopes @ noise.moves[[k for k, _ in parts]]
        spread = np.sqrt(2.0 / np.maximum(edof, 1.0))
        follows = (
            np.sum(each * octave_correlation(noise, np.exp2(np.arange(levels, dtype=np.float64))) * spread, axis=1)
            / spread
        )
    return Scatter(np.maximum(edof, 1.0), np.clip(skew, 1.0, 4.0), np.clip(follows, -1.0, 1.0))


@lru_cache(maxsize=1024)
def _spectrum_of(kind: str, tc: float, filter: str, j: int) -> Array:
    process = PROCESSES[kind]().of_coordinates(1.0, (-np.log(tc),) if kind == "GM" else (), 1.0)
    return _spectrum(process, octave(filter, j))
