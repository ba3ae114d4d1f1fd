"""The Allan family: overlapping, non-overlapping, modified, Hadamard and total variances with equivalent degrees of freedom.

Averaging time is ``tau = m / rate``. The Allan variance at ``m`` is twice the Haar wavelet variance at scale ``2 m`` samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError
from insemu.variance import _kernel
from insemu.variance.edof import (
    NORMAL_ABOVE,
    WHITE,
    NoiseType,
    Scatter,
    check_confidence,
    chi_square_interval,
    noise_type,
    scatter_of_noise,
)
from insemu.variance.wavelet import WaveletVariance, check_rate, check_signal, max_levels, wavelet_variance

Array = NDArray[np.float64]
Kind = Literal["overlapping", "non-overlapping", "modified", "hadamard", "overlapping-hadamard", "total"]
Grid = Literal["octave", "decade", "all"]
AllanIntervals = Literal["edof", "normal", "clusters"]

#: Samples of the record that one term of each kind spans, in units of m (total: any).
_SPAN: dict[str, int] = {
    "overlapping": 2,
    "non-overlapping": 2,
    "modified": 3,
    "hadamard": 3,
    "overlapping-hadamard": 3,
    "total": 1,
}


@dataclass(frozen=True)
class AllanVariance:
    """An Allan-type variance curve; arrays have one entry per averaging time, shortest first.

    Parameters
    ----------
    m : (J,) int array
        Samples averaged.
    tau_s : (J,) array
        Averaging time ``m / rate`` in s.
    value, low, high : (J,) arrays
        Variance (not deviation) and its confidence interval, in the signal's unit squared.
    edof : (J,) array
        Equivalent degrees of freedom.
    n_samples : int
        Length of the record.
    rate_hz, kind, confidence
        How it was made.
    """

    m: NDArray[np.int64]
    tau_s: Array
    value: Array
    low: Array
    high: Array
    edof: Array
    n_samples: int
    rate_hz: float = 1.0
    kind: Kind = "overlapping"
    confidence: float = 0.95

    def __len__(self) -> int:
        return len(self.value)

    @property
    def deviation(self) -> Array:
        """Square root of the variance."""
        return np.sqrt(self.value)


def averaging_grid(n_samples: int, kind: Kind = "overlapping", grid: Grid = "octave") -> NDArray[np.int64]:
    """Return the numbers of samples to average: powers of two, 1-2-4 per decade, or all that leave at least two terms.

    Parameters
    ----------
    n_samples : int
        Length of the record.
    kind : str
        As in :func:`allan_variance`.
    grid : str
        ``octave``, ``decade`` or ``all``.
    """
    most = _largest(n_samples, kind)
    if grid == "octave":
        m = 2 ** np.arange(int(np.log2(max(most, 1))) + 1, dtype=np.int64)
    elif grid == "decade":
        m = np.unique([k * 10**d for d in range(19) for k in (1, 2, 4) if k * 10**d <= most]).astype(np.int64)
    elif grid == "all":
        m = np.arange(1, most + 1, dtype=np.int64)
    else:
        raise InputError(f"grid is '{grid}', expected one of: {', '.join(get_args(Grid))}")
    return m[m <= most]


def _largest(n_samples: int, kind: Kind) -> int:
    """Largest m with at least two terms."""
    span = _SPAN[kind]
    if kind in ("non-overlapping", "hadamard"):
        return max(n_samples // (span + 1), 1)
    return max((n_samples - 1) // span, 1)


def relative_error(n_samples: int, m: ArrayLike) -> Array:
    """Return the relative error of an Allan deviation by the number of independent clusters (equation (15) of Quinchia et al. 2013).

    ``1 / sqrt(2 (N / m - 1))``; a rule of thumb that does not depend on the noise.

    Examples
    --------
    >>> round(float(relative_error(360_000, 60_000)), 3)
    0.316
    """
    return np.asarray(1.0 / np.sqrt(2.0 * (n_samples / np.asarray(m, dtype=float) - 1.0)))


def allan_variance(
    x: ArrayLike,
    rate_hz: float = 1.0,
    *,
    kind: Kind = "overlapping",
    grid: Grid | ArrayLike = "octave",
    confidence: float = 0.95,
    intervals: AllanIntervals = "edof",
    gaps: bool = False,
) -> AllanVariance:
    """Return an Allan-type variance of a signal (a rate, not its integral).

    Parameters
    ----------
    x : (n,) array
        Signal: angular rate, specific force, fractional frequency.
    rate_hz : float
        Sampling rate.
    kind : str
        ``"overlapping"``, ``"non-overlapping"``, ``"modified"``, ``"hadamard"``, ``"overlapping-hadamard"``, ``"total"``. The Hadamard
        kinds do not see a linear drift; ``total`` is steadier at the longest times and biased low there for coloured noise.
    grid : str or (J,) int array
        ``"octave"``, ``"decade"`` (1, 2, 4 per decade), ``"all"``, or the numbers of samples to average.
    confidence : float
        Level of the intervals.
    intervals : {"edof", "normal", "clusters"}
        Chi-square with equivalent degrees of freedom of the noise type read from the curve; asymptotic normal (NaN below 100 degrees
        of freedom); or :func:`relative_error` as one standard deviation of the deviation.
    gaps : bool
        Take what is not finite for missing samples, as :func:`~insemu.variance.wavelet.wavelet_variance`; overlapping, by octaves.

    Raises
    ------
    InputError
        A bad signal or option; an averaging time that leaves fewer than two terms.

    Notes
    -----
    Definitions of NIST SP 1065 (Riley 2008); equation (13) of Quinchia et al. 2013 is the overlapping one.
    """
    if kind not in get_args(Kind):
        raise InputError(f"kind is '{kind}', expected one of: {', '.join(get_args(Kind))}")
    if intervals not in get_args(AllanIntervals):
        raise InputError(f"intervals is '{intervals}', expected one of: {', '.join(get_args(AllanIntervals))}")
    rate_hz = check_rate(rate_hz)
    check_confidence(confidence)
    values = check_signal(x, finite=not gaps)
    if gaps and not np.isfinite(values).all():
        if kind != "overlapping" or not (isinstance(grid, str) and grid == "octave") or intervals == "clusters":
            raise InputError("a signal with missing samples has the overlapping variance by octaves only")
        return of_haar(wavelet_variance(values, rate_hz, confidence=confidence, intervals=intervals, gaps=True))
    n = values.size
    m = averaging_grid(n, kind, grid) if isinstance(grid, str) else _given_grid(grid, n, kind)  # type: ignore[arg-type]
    haar = wavelet_variance(values, intervals="eta3") if max_levels(n) else None
    octaves = isinstance(grid, str) and grid == "octave"
    if kind == "overlapping" and octaves and haar is not None:
        m = haar.scale_samples // 2
        value = 2.0 * haar.value
    else:
        value = _values(values, m, kind)
    noise = noise_type(haar.scale_samples, haar.value, n) if haar is not None else WHITE
    scatter = _scatter(noise, m, n, kind)
    edof = scatter.edof
    if intervals == "clusters":
        half = relative_error(n, m)
        low, high = value * np.maximum(1.0 - half, 0.0) ** 2, value * (1.0 + half) ** 2
    else:
        low, high = chi_square_interval(value, edof, confidence, intervals, scatter=scatter)
    return AllanVariance(m, m / rate_hz, value, low, high, edof, n, rate_hz, kind, confidence)


def of_haar(curve: WaveletVariance) -> AllanVariance:
    """The overlapping Allan variance that a Haar wavelet variance is half of."""
    m = curve.scale_samples // 2
    value, low, high = 2.0 * curve.value, 2.0 * curve.low, 2.0 * curve.high
    return AllanVariance(
        m,
        m / curve.rate_hz,
        value,
        low,
        high,
        curve.edof,
        curve.n_samples,
        curve.rate_hz,
        confidence=curve.confidence,
    )


def _given_grid(grid: ArrayLike, n: int, kind: Kind) -> NDArray[np.int64]:
    m = np.atleast_1d(np.asarray(grid))
    if m.ndim != 1 or m.dtype.kind not in "iu" or (m < 1).any():
        raise InputError(f"grid is {grid!r}, expected whole numbers of samples from 1 on")
    most = _largest(n, kind)
    if (m > most).any():
        raise InputError(f"averages of {int(m.max())} samples asked for, expected at most {most} ({kind}, {n} samples)")
    return np.unique(m).astype(np.int64)


def _values(values: Array, m: NDArray[np.int64], kind: Kind) -> Array:
    # the running sum of the centred signal: no difference below sees the mean
    s = np.empty(values.size + 1)
    s[0] = 0.0
    np.cumsum(values - values.mean(), out=s[1:])
    out = np.empty(m.size)
    for index, step in enumerate(m.tolist()):
        if kind in ("overlapping", "non-overlapping"):
            stride = 1 if kind == "overlapping" else step
            terms = (s.size - 2 * step - 1) // stride + 1
            out[index] = _kernel.second_differences(s, step, stride) / (2.0 * terms * step**2)
        elif kind in ("hadamard", "overlapping-hadamard"):
            stride = 1 if kind == "overlapping-hadamard" else step
            terms = (s.size - 3 * step - 1) // stride + 1
            out[index] = _kernel.second_differences(s[step:] - s[:-step], step, stride) / (6.0 * terms * step**2)
        elif kind == "modified":
            terms = s.size - 3 * step + 1
            sums = np.concatenate([[0.0], np.cumsum(s)])
            moving = sums[step:] - sums[:-step]
            out[index] = _kernel.second_differences(moving, step, 1) / (2.0 * terms * float(step) ** 4)
        else:
            continued = np.pad(s, step - 1, mode="reflect", reflect_type="odd")
            out[index] = _kernel.second_differences(continued, step, 1) / (2.0 * (s.size - 2) * step**2)
    return out


def _scatter(noise: NoiseType, m: NDArray[np.int64], n: int, kind: Kind) -> Scatter:
    """How the estimates scatter at every m; where there are many, at a hundred of them and interpolated (it is smooth)."""
    if not noise.parts:
        return Scatter(np.ones(m.size), np.ones(m.size), np.zeros(m.size))
    if m.size > 150:
        some = np.unique(np.round(np.geomspace(1, m.size, 100)).astype(int)) - 1
        few = _scatter(noise, m[some], n, kind)
        at, of = np.log(m), np.log(m[some])
        return Scatter(
            np.exp(np.interp(at, of, np.log(few.edof))), np.interp(at, of, few.skew), np.interp(at, of, few.follows)
        )
    if kind == "total":
        return _scatter_of_total(noise, m, n)
    order = 2 if kind in ("overlapping", "non-overlapping") else 3
    stride = m if kind in ("non-overlapping", "hadamard") else None
    return scatter_of_noise(noise, 2 * m, n, order=order, averaged=kind == "modified", stride=stride)


def _scatter_of_total(noise: NoiseType, m: NDArray[np.int64], n: int) -> Scatter:
    """Total variance: ``b N / m - c`` with the published b, c of white, flicker and random-walk noise, between them by the local slope.

    NIST SP 1065, table 7 (Howe and Greenhall): (1.5, 0), (1.17, 0.22), (0.93, 0.36).
    """
    steps = m.astype(float)
    slope = np.log2(noise.variance(1.1 * steps) / noise.variance(steps / 1.1)) / np.log2(1.21)
    b = np.interp(slope, [-1.0, 0.0, 1.0], [1.5, 1.16832, 0.92715])
    c = np.interp(slope, [-1.0, 0.0, 1.0], [0.0, 0.22236, 0.35806])
    # at short times reflecting the ends adds nothing to the overlapping estimate
    overlapping = scatter_of_noise(noise, 2 * np.minimum(m, max(n // 2, 1)), n)
    edof = np.where(16 * m <= n, overlapping.edof, np.maximum(b * n / m - c, 1.0))
    return Scatter(edof, np.where(16 * m <= n, overlapping.skew, 1.0), np.zeros(m.size))


__all__ = ["NORMAL_ABOVE", "AllanVariance", "allan_variance", "averaging_grid", "relative_error"]
