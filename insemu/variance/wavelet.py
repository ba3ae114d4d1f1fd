"""Wavelet variance with intervals: the variance of a signal octave by octave.

Scale is ``tau_j = 2^j`` samples; the Haar wavelet variance there is half the Allan variance at averages of ``m = 2^(j-1)`` samples.
Coefficients that would reach beyond the record are left out, so estimates are unbiased (equation (9) of Stebler et al. 2014). Missing samples:
:mod:`insemu.variance.gaps`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError
from insemu.variance import _kernel
from insemu.variance import gaps as with_gaps
from insemu.variance.edof import (
    Intervals,
    Scatter,
    check_confidence,
    chi_square_interval,
    eta3,
    noise_type,
    scatter_of_noise,
)
from insemu.variance.filtered import scatter_of_filter, unit_curves
from insemu.variance.filters import modwt_filters

Array = NDArray[np.float64]

#: Samples at the beginning of a record whose median is subtracted, so that an offset costs no digits.
ORIGIN_SAMPLES = 255
#: Scales of a record in memory up to this many samples use every coefficient (longer ones: see :func:`stream_wavelet_variance`).
IN_MEMORY_OVERLAP = 1 << 23


@dataclass(frozen=True)
class WaveletVariance:
    """A wavelet variance curve; arrays have one entry per scale, shortest first.

    Parameters
    ----------
    scale_samples : (J,) int array
        Scales ``2^j`` in samples.
    tau_s : (J,) array
        The same in seconds, ``2^j / rate``.
    value, low, high : (J,) arrays
        Variance and its confidence interval, in the signal's unit squared.
    edof : (J,) array
        Equivalent degrees of freedom of ``value``.
    n_coefficients : (J,) int array
        Coefficients that entered, boundary left out.
    n_samples : int
        Length of the record.
    rate_hz, filter, intervals, confidence
        How it was made.
    lost : (n,) bool array, optional
        Samples that are missing; None of a complete record.
    inflation : (J,) array, optional
        Variance of ``value`` over that of a complete record of as many samples; None of a complete record.
    white_scatter : float
        Variance (unit^4) of the white part of the signal beyond that of a record of as many samples: what rejecting outliers costs.
    """

    scale_samples: NDArray[np.int64]
    tau_s: Array
    value: Array
    low: Array
    high: Array
    edof: Array
    n_coefficients: NDArray[np.int64]
    n_samples: int
    rate_hz: float = 1.0
    filter: str = "haar"
    intervals: Intervals = "edof"
    confidence: float = 0.95
    lost: NDArray[np.bool_] | None = None
    inflation: Array | None = None
    white_scatter: float = 0.0

    def __len__(self) -> int:
        return len(self.value)


def max_levels(n_samples: int, filter_length: int = 2) -> int:
    """Number of octaves of a record: the largest J with at least two coefficients that do not reach beyond it."""
    levels = 0
    while ((1 << (levels + 1)) - 1) * (filter_length - 1) + 1 < n_samples:
        levels += 1
    return levels


def check_signal(x: ArrayLike, name: str = "signal", *, finite: bool = True) -> Array:
    """Return a one-dimensional float64 signal, or raise :class:`~insemu.errors.InputError` saying what is wrong with it.

    ``finite=False`` leaves values that are not finite to be found by the caller.

    Parameters
    ----------
    x : array_like
    name : str
        For messages.
    finite : bool
        Whether values that are not finite are refused.
    """
    values = np.asarray(x)
    if values.dtype.kind not in "fiu":
        raise InputError(f"{name} has type {values.dtype}, expected real numbers")
    if values.ndim != 1:
        raise InputError(f"{name} has shape {values.shape}, expected (n,)")
    values = np.ascontiguousarray(values, dtype=np.float64)
    if values.size < 3:
        raise InputError(f"{name} has {values.size} samples, expected at least 3")
    # one reduction finds NaN and infinity; the slower search for the place runs only then
    if finite and not np.isfinite(values.sum()) and not np.isfinite(values).all():
        first = int(np.argmin(np.isfinite(values)))
        raise InputError(f"{name} is not finite at sample {first} ({values[first]}); expected finite numbers")
    return values


def check_rate(rate_hz: float) -> float:
    """Return the rate, or raise :class:`~insemu.errors.InputError` where it is not a positive number."""
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise InputError(f"rate is {rate_hz} Hz, expected a positive number")
    return float(rate_hz)


def check_levels(levels: int | None, possible: int, n_samples: int) -> int:
    """Return the number of octaves to compute (all by default).

    Parameters
    ----------
    levels : int or None
        Octaves that are asked for.
    possible : int
        Octaves that the record allows.
    n_samples : int
        Length of the record.
    """
    if possible < 1:
        raise InputError(f"a record of {n_samples} samples is too short for one octave of this filter")
    if levels is None:
        return possible
    if not 1 <= levels <= possible:
        raise InputError(f"levels is {levels}, expected 1 to {possible} for a record of {n_samples} samples")
    return int(levels)


@dataclass(frozen=True)
class Asked:
    """What is asked of a curve: rate in Hz, filter, kind and level of the intervals."""

    rate_hz: float
    filter: str = "haar"
    intervals: Intervals = "edof"
    confidence: float = 0.95

    def __post_init__(self) -> None:
        check_rate(self.rate_hz)
        check_confidence(self.confidence)

    def curve(
        self, value: Array, used: NDArray[np.int64], n_samples: int, edof: Array, scatter: Scatter | None
    ) -> WaveletVariance:
        """A curve with its intervals.

        Parameters
        ----------
        value : (J,) array
            Variances, unit^2.
        used : (J,) array of int
            Coefficients of each octave.
        n_samples : int
            Length of the record.
        edof : (J,) array
            Degrees of freedom.
        scatter : Scatter, optional
            How the estimates scatter, where that is known.
        """
        scale = 2 ** np.arange(1, len(value) + 1, dtype=np.int64)
        low, high = chi_square_interval(value, edof, self.confidence, self.intervals, scatter=scatter)
        made = (scale, scale / self.rate_hz, value, low, high, edof, used, n_samples)
        return WaveletVariance(*made, float(self.rate_hz), self.filter, self.intervals, self.confidence)


def wavelet_variance(
    x: ArrayLike,
    rate_hz: float = 1.0,
    *,
    filter: str = "haar",
    confidence: float = 0.95,
    intervals: Intervals = "edof",
    edof: ArrayLike | None = None,
    levels: int | None = None,
    gaps: bool = False,
) -> WaveletVariance:
    """Return the wavelet variance of a signal.

    Parameters
    ----------
    x : (n,) array
        Signal in any unit; an offset is harmless.
    rate_hz : float
        Sampling rate.
    filter : str
        ``"haar"`` or another name of :data:`insemu.variance.filters.FILTERS`.
    confidence : float
        Level of the intervals.
    intervals : {"edof", "eta3", "normal"}
        Chi-square with equivalent degrees of freedom of the noise type (default); with the ideal band-pass's degrees of freedom, which
        cover too much; asymptotic normal, NaN where there are fewer than 100 degrees of freedom.
    edof : (J,) array, optional
        Degrees of freedom to use instead of those of the noise type: those of a model, see
        :func:`insemu.variance.covariance.model_edof`.
    levels : int, optional
        Number of octaves; all that the record allows by default.
    gaps : bool
        Take what is not finite for missing samples: see :mod:`insemu.variance.gaps`. Octaves in which fewer than
        two coefficients are there are left out.

    Raises
    ------
    InputError
        A signal that is too short, not one-dimensional or not finite; an unknown filter; bad options.

    Notes
    -----
    Equations (3)-(9) of Stebler et al. 2014; with gaps, Mondal and Percival 2010.

    Examples
    --------
    >>> curve = wavelet_variance([0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0], rate_hz=2.0)
    >>> curve.tau_s.tolist(), curve.value.tolist()
    ([1.0, 2.0], [0.25, 0.0])
    """
    asked = Asked(rate_hz, filter, intervals, confidence)
    h, g = modwt_filters(filter)
    # what is not finite shows in the first octave of the fast path, without a pass of its own
    fast = h.size == 2
    if gaps and not np.isfinite(whole := check_signal(x, finite=False)).all():
        if edof is not None:
            raise InputError("a signal with missing samples has its own degrees of freedom only")
        return _of_gaps(whole, asked, levels)
    values = check_signal(x, finite=not fast)
    count = check_levels(levels, max_levels(values.size, h.size), values.size)
    if fast:
        value, used = _haar_variance(values, count)
        if not np.isfinite(value[0]):
            check_signal(values)
    else:
        pairs = [(float(np.mean(w * w)), w.size) for w in _coefficients(values, h, g, count)]
        value, used = np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs], dtype=np.int64)
    return _finish(value, used, values.size, asked, edof)


def _of_gaps(x: Array, asked: Asked, levels: int | None) -> WaveletVariance:
    """The curve of a signal with missing samples."""
    lost = ~np.isfinite(x)
    there = int(np.count_nonzero(~lost))
    if there < 3:
        raise InputError(f"signal has {there} samples that are finite, expected at least 3")
    length = modwt_filters(asked.filter)[0].size
    count = check_levels(levels, max_levels(x.size, length), x.size)
    origin = _middle_of_first(x, lost)
    curve = with_gaps.haar_with_gaps(x, origin, count)
    if curve is not None and asked.filter != "haar":
        curve = with_gaps.filter_with_gaps(x, origin, asked.filter, curve)
    if curve is None:
        raise InputError(f"of {x.size} samples {x.size - there} are missing: no octave has two coefficients")
    edof, scatter = curve.scatter.edof, curve.scatter if asked.intervals == "edof" else None
    if asked.intervals == "eta3":
        scale = 2.0 ** np.arange(1, curve.value.size + 1, dtype=np.float64)
        edof = np.maximum(eta3(scale, x.size, length) / curve.inflation, 1.0)
    made = asked.curve(curve.value, curve.terms, x.size, edof, scatter)
    return replace(made, lost=lost, inflation=curve.inflation)


def _middle_of_first(x: Array, lost: NDArray[np.bool_]) -> float:
    """Median of the first samples that are there; looks through the whole signal only where its beginning has fewer."""
    for size in (4 * ORIGIN_SAMPLES, x.size):
        there = x[:size][~lost[:size]]
        if there.size >= ORIGIN_SAMPLES:
            break
    return float(np.median(there[:ORIGIN_SAMPLES]))


def _finish(
    value: Array, used: NDArray[np.int64], n_samples: int, asked: Asked, edof: ArrayLike | None = None
) -> WaveletVariance:
    """The curve of moments of a complete record."""
    count, filter = len(value), asked.filter
    scale = 2 ** np.arange(1, count + 1, dtype=np.int64)
    length = modwt_filters(filter)[0].size
    scatter: Scatter | None = None
    if edof is not None:
        freedom = np.asarray(edof, dtype=float)
        if freedom.shape != (count,) or not (freedom > 0).all():
            raise InputError(f"edof has shape {freedom.shape}, expected {count} positive numbers, one per scale")
    elif asked.intervals == "eta3":
        freedom = eta3(scale.astype(float), n_samples, length)
    else:
        if length > 2:
            octaves = tuple(range(1, count + 1))
            noise = noise_type(scale, value, n_samples, unit_curves=lambda kinds: unit_curves(filter, octaves, kinds))
            scatter = scatter_of_filter(noise, filter, count, n_samples)
        else:
            scatter = scatter_of_noise(noise_type(scale, value, n_samples), scale, n_samples)
        freedom = scatter.edof
    return asked.curve(value, used, n_samples, freedom, scatter)


def _read_only(values: Array) -> Array:
    """A view that cannot be written to, as the values of a series: one signature, so that the loop is compiled once."""
    view = values.view()
    view.setflags(write=False)
    return view


def _haar_variance(values: Array, levels: int) -> tuple[Array, NDArray[np.int64]]:
    """Haar MODWT variances of a record in memory in one chunked pass."""
    full = IN_MEMORY_OVERLAP
    sums = np.zeros(levels)
    # the median of the first samples: an outlier there must not become the origin
    origin = float(np.median(values[:ORIGIN_SAMPLES]))
    _kernel.haar_push(_read_only(values), origin, 1, _kernel.haar_state(levels, full), sums, full)
    counts = _kernel.haar_counts(values.size, levels, full)
    return 0.25 * sums / counts, counts


def _coefficients(values: Array, h: Array, g: Array, levels: int) -> Iterable[Array]:
    """MODWT coefficients of each octave without those that reach beyond the record."""
    v = values - values[0]
    for j in range(levels):
        step = 1 << j
        n = v.size - step * (h.size - 1)
        w, smooth = np.zeros(n), np.zeros(n)
        for tap in range(h.size):
            piece = v[(h.size - 1 - tap) * step : (h.size - 1 - tap) * step + n]
            w += h[tap] * piece
            smooth += g[tap] * piece
        yield w
        v = smooth


def wavelet_coefficients(x: ArrayLike, *, filter: str = "haar", levels: int | None = None) -> list[Array]:
    """Return the MODWT wavelet coefficients of each octave, boundary left out (equation (6) of Stebler et al. 2014).

    Entry ``j - 1`` has shape ``(n - L_j + 1,)`` with ``L_j = (2^j - 1)(L - 1) + 1``.

    Parameters
    ----------
    x : (n,) array
        Signal.
    filter : str
        Name of the filter.
    levels : int, optional
        Octaves; all by default.

    Raises
    ------
    InputError
        As :func:`wavelet_variance`.
    """
    values = check_signal(x)
    h, g = modwt_filters(filter)
    return list(_coefficients(values, h, g, check_levels(levels, max_levels(values.size, h.size), values.size)))


def stream_wavelet_variance(
    chunks: Iterable[ArrayLike],
    rate_hz: float = 1.0,
    *,
    confidence: float = 0.95,
    intervals: Intervals = "edof",
    levels: int = 40,
    full_overlap: int = _kernel.FULL_OVERLAP,
    progress: Callable[[int], None] | None = None,
) -> WaveletVariance:
    """Return the Haar MODWT wavelet variance of a record of any length, in one pass and bounded memory.

    Parameters
    ----------
    chunks : iterable of (k,) arrays
        Successive pieces of the signal, of any lengths: slices of a memory map, parts of a file.
    rate_hz, confidence, intervals
        As in :func:`wavelet_variance`.
    levels : int
        The most octaves to keep.
    full_overlap : int
        Scales up to this many samples (a power of two) use every coefficient and equal :func:`wavelet_variance` exactly; longer ones use
        coefficients on a grid of at least ``full_overlap / 2`` positions per scale: the same precision, in bounded memory.
    progress : callable, optional
        Called with the number of samples read so far.

    Raises
    ------
    InputError
        A value that is not finite (with its sample number), a piece of wrong shape, fewer than three samples.
    """
    asked = Asked(rate_hz, "haar", intervals, confidence)
    if full_overlap < 2 * _kernel.CHUNK or full_overlap & (full_overlap - 1):
        raise InputError(f"full_overlap is {full_overlap}, expected a power of two of at least {2 * _kernel.CHUNK}")
    accumulator = HaarAccumulator(levels, full_overlap)
    for piece in chunks:
        accumulator.push(piece)
        if progress is not None:
            progress(accumulator.n_samples)
    value, used = accumulator.result()
    return _finish(value, used, accumulator.n_samples, asked)


def curve_of_moments(value: Array, used: NDArray[np.int64], n_samples: int, rate_hz: float) -> WaveletVariance:
    """The Haar curve of moments that were summed elsewhere (:class:`HaarAccumulator`, several stretches of one signal).

    Parameters
    ----------
    value : (J,) array
        Variances, unit^2.
    used : (J,) array of int
        Coefficients of each octave.
    n_samples : int
        Samples of all stretches.
    rate_hz : float
        Sampling rate.
    """
    return _finish(value, used, n_samples, Asked(rate_hz))


class HaarAccumulator:
    """Sums of squared Haar MODWT coefficients of a signal that arrives in pieces.

    Memory is one window of ``full_overlap`` samples at most, whatever the length of the record.

    Parameters
    ----------
    levels : int
        The most octaves to keep.
    full_overlap : int
        Longest scale with a coefficient at every sample.
    """

    def __init__(self, levels: int = 40, full_overlap: int = _kernel.FULL_OVERLAP) -> None:
        self.full_overlap = full_overlap
        self.n_samples = 0
        self._most = levels
        self._sums = np.zeros(levels)
        self._state = _kernel.haar_state(levels, full_overlap)
        self._rest = np.empty(0)
        self._origin: float | None = None
        self._pushed = 0

    def push(self, piece: ArrayLike) -> None:
        """Add the next samples; raises :class:`~insemu.errors.InputError` for values that are not finite."""
        values = np.asarray(piece)
        if values.ndim != 1 or values.dtype.kind not in "fiu":
            raise InputError(f"a piece has shape {values.shape} and type {values.dtype}, expected (k,) real numbers")
        if values.size == 0:
            return
        if self._origin is None:
            middle = float(np.median(values[:ORIGIN_SAMPLES]))
            self._origin = middle if np.isfinite(middle) else 0.0
            # before the first sample the running sum is zero: an origin in front stands for it
            self._rest = np.array([self._origin])
        self.n_samples += values.size
        values = np.concatenate([self._rest, values], dtype=np.float64)
        whole = values.size - values.size % _kernel.CHUNK
        if whole:
            self._run(values[:whole])
        self._rest = values[whole:].copy()

    def _run(self, values: Array) -> None:
        assert self._origin is not None
        _kernel.haar_push(_read_only(values), self._origin, self._pushed, self._state, self._sums, self.full_overlap)
        # what is not finite shows in the first octave, without a pass of its own
        if not np.isfinite(self._sums[0]) and not np.isfinite(values).all():
            first = int(np.argmin(np.isfinite(values)))
            raise InputError(
                f"signal is not finite at sample {self._pushed + first - 1} ({values[first]}); expected finite numbers"
            )
        self._pushed += values.size

    def result(self) -> tuple[Array, NDArray[np.int64]]:
        """Return the variances and numbers of coefficients of all octaves of what was pushed; ends the accumulation."""
        if self.n_samples < 3:
            raise InputError(f"signal has {self.n_samples} samples, expected at least 3")
        if self._rest.size:
            self._run(self._rest)
            self._rest = self._rest[:0]
        levels = min(max_levels(self.n_samples), self._most)
        counts = _kernel.haar_counts(self.n_samples, levels, self.full_overlap)
        return 0.25 * self._sums[:levels] / counts, counts
