"""What a static log says about its noise, reduced to the statistics that the evidence reads.

Below half the block rate: differences of block means (10 s as a rule), whose exact covariance every process gives, so
that random walks and drifts need no window and leak nowhere. Above: a sine-multitaper spectrum averaged into narrow bins, for Whittle's
likelihood. Below the split the same multitaper likelihood would leak (Riedel and Sidorenko 1995 for the tapers and their bias).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.gap.verdict import InBand
from insemu.noise import Process
from insemu.records import Series

Array = NDArray[np.float64]

#: Sine tapers, bins per octave.
TAPERS, BINS_PER_OCTAVE = 6, 32
#: Length of a block, s: below half its rate the likelihood is exact. A short log has at least so many blocks, a long one at most: the cost grows
#: with their square.
BLOCK_S, FEWEST_BLOCKS, MOST_BLOCKS = 10.0, 120, 500
#: Longest shape (frequencies, samples of a taper) that is remembered: full-resolution spectra are read once.
MOST_REMEMBERED = 8192


@dataclass(frozen=True)
class Reduced:
    """One axis of a static log, reduced.

    Parameters
    ----------
    name, unit : str
        Axis and its SI unit.
    dt : float
        Sampling interval, s.
    values : (n,) array
        The samples.
    block : int
        Samples per block.
    differences : (blocks - 1,) array
        Differences of consecutive block means.
    f, power, dof : (bins,) arrays
        Frequency (Hz), two-sided PSD (unit^2/Hz) and chi-square degrees of freedom of each bin above ``1 / (2 block dt)``.
    weight : (bins,) array, optional
        Share of its degrees of freedom that a bin counts where no model describes the spectrum to their precision.
    shaking : InBand, optional
        What was taken for the vehicle's motion.
    quiet : (bins,) array, optional
        PSD of a moving sensor in the quietest third of its record.
    """

    name: str
    unit: str
    dt: float
    values: Array
    block: int
    differences: Array
    f: Array
    power: Array
    dof: Array
    weight: Array | None = None
    shaking: InBand | None = None
    quiet: Array | None = None
    _memory: dict[str, NDArray[Any]] = field(default_factory=dict, init=False, repr=False, compare=False)

    def remembered(self, name: str, make: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """What follows from the samples alone, worked out once.

        Parameters
        ----------
        name : str
            Of the answer.
        make : callable
            Works it out.
        """
        if name not in self._memory:
            self._memory[name] = make()
        return self._memory[name]

    def weighed(self, weight: Array) -> Reduced:
        """The same samples, with bins that count only so far (k,); what follows from the samples is kept."""
        out = replace(self, weight=weight)
        out._memory.update(self._memory)
        return out

    @property
    def counted(self) -> Array:
        """Degrees of freedom that the likelihood counts."""
        return self.dof if self.weight is None else self.dof * self.weight

    @property
    def block_s(self) -> float:
        """Length of a block, s."""
        return self.block * self.dt

    @property
    def duration_s(self) -> float:
        """Length of the log, s."""
        return self.values.size * self.dt


def block_length(n: int, dt: float) -> int:
    """Samples per block: 10 s, shorter for short logs (at least 120 blocks), longer for long ones (at most 500)."""
    wanted = max(1, round(BLOCK_S / dt))
    return int(min(max(wanted, math.ceil(n / MOST_BLOCKS)), max(1, n // FEWEST_BLOCKS)))


def block_differences(values: Array, block: int) -> Array:
    """Differences of consecutive means of ``block`` samples; an incomplete last block is left out."""
    count = values.shape[0] // block
    means = values[: count * block].reshape(count, block, *values.shape[1:]).mean(axis=1)
    return np.asarray(np.diff(means, axis=0))


def reduce(series: Series, block: int | None = None) -> Reduced:
    """Reduce one axis.

    Parameters
    ----------
    series : Series
        At least 240 samples.
    block : int, optional
        Samples per block, for a piece that is to be reduced as the whole was.
    """
    y = np.asarray(series.values)
    block = block or block_length(y.size, series.dt)
    f, power, dof = spectrum(y, series.dt, 0.5 / (block * series.dt))
    return Reduced(series.name, series.unit, series.dt, y, block, block_differences(y, block), f, power, dof)


def spectrum(y: Array, dt: float, lowest: float) -> tuple[Array, Array, Array]:
    """Sine-multitaper PSD above ``lowest`` Hz in narrow bins: centres, two-sided PSD, degrees of freedom.

    Parameters
    ----------
    y : (n,) array
        Samples; their mean is taken off.
    dt : float
        Sampling interval, s.
    lowest : float
        Lowest frequency, Hz.

    Returns
    -------
    f, power, dof : (bins,) arrays
        Hz, unit^2/Hz and chi-square degrees of freedom; empty where no bin lies above ``lowest``.
    """
    n = y.size
    flat = y - y.mean()
    power = np.zeros(n // 2 + 1)
    # the tapers of the many short pieces of a moving record are remembered and taken together, those of a long log one by one
    for tapers in (_tapers(n),) if n <= MOST_REMEMBERED else (taper[None] for taper in _each_taper(n)):
        spectra = scipy.fft.rfft(flat * tapers, axis=1)
        for squares in spectra.real**2 + spectra.imag**2:
            power += squares * (dt / TAPERS)
    bins = _bins(n, dt, lowest)
    if bins is None:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    first, count, _ = bins
    total = np.add.reduceat(power, first)[: count.size]
    centre, dof = spectrum_bins(n, dt, lowest)
    return centre, total / count, dof


def _each_taper(n: int) -> Iterator[Array]:
    angle = np.pi * np.arange(1, n + 1) / (n + 1)
    before, taper, turn = np.zeros(n), math.sqrt(2.0 / (n + 1)) * np.sin(angle), 2.0 * np.cos(angle)
    for _ in range(TAPERS):
        yield taper
        before, taper = taper, turn * taper - before  # sines of the multiples of an angle follow from each other


@lru_cache(maxsize=8)
def _tapers(n: int) -> Array:
    return np.array(list(_each_taper(n)))


def reduce_again(data: Reduced, values: Array) -> Reduced:
    """Reduce changed samples of an axis as the axis itself was; one without a block band stays without."""
    if data.differences.size:
        again = reduce(Series(values, 1.0 / data.dt, data.unit, data.name), data.block)
        return replace(again, weight=data.weight)
    f, power, dof = moving_spectrum(values, data.dt, float(data.f[0]))
    return replace(data, values=values, f=f, power=power, dof=dof)


def unheard(data: Reduced) -> Reduced:
    """The axis without its spectrum: nothing that it shows there is to be explained."""
    none = np.zeros(0)
    return replace(data, f=none, power=none, dof=none)


def moving_spectrum(y: Array, dt: float, lowest: float, pieces: int = 32) -> tuple[Array, Array, Array]:
    """Multitaper PSD of a moving sensor: the median over pieces of the record, so that single manoeuvres do not count.

    Parameters
    ----------
    y : (n,) array
        Samples.
    dt : float
        Sampling interval, s.
    lowest : float
        Lowest frequency, Hz.
    pieces : int
        Number of pieces of equal length.

    Returns
    -------
    f, power, dof : (bins,) arrays
        As those of :func:`spectrum`; empty where a piece is too short for a bin.
    """
    return moving_spectra(y, dt, lowest, pieces)[:3]


def moving_spectra(y: Array, dt: float, lowest: float, pieces: int = 32) -> tuple[Array, Array, Array, Array]:
    """The same, and behind it the mean PSD of the quietest third of the pieces.

    Parameters
    ----------
    y, dt, lowest, pieces
        As :func:`moving_spectrum` says.
    """
    length = y.size // pieces
    parts = [spectrum(y[k * length : (k + 1) * length], dt, lowest) for k in range(pieces)]
    f, _, dof = parts[0]
    if not f.size:
        return f, f, f, f
    each = np.stack([p for _, p, _ in parts])
    # median of a mean of chi-squares over its mean (Wilson and Hilferty), and what the median keeps of the information
    power = np.median(each, axis=0) / (1.0 - 2.0 / (9.0 * np.maximum(dof, 2.0 * TAPERS))) ** 3
    quietest = np.argsort(np.log(np.maximum(each, 1e-300)) @ dof)[: max(1, pieces // 3)]
    return f, power, dof * pieces * (2.0 / math.pi), each[quietest].mean(axis=0)


def spectrum_bins(n: int, dt: float, lowest: float) -> tuple[Array, Array]:
    """Centres (Hz) and degrees of freedom of the bins of :func:`spectrum`.

    Parameters
    ----------
    n : int
        Number of samples.
    dt : float
        Sampling interval, s.
    lowest : float
        Lowest frequency, Hz.

    Returns
    -------
    f, dof : (bins,) arrays
        Empty where no bin lies above ``lowest``.
    """
    bins = _bins(n, dt, lowest)
    if bins is None:
        return np.zeros(0), np.zeros(0)
    return bins[2], 2.0 * bins[1] / overlap(n)


@lru_cache(maxsize=32)
def _bins(n: int, dt: float, lowest: float) -> tuple[NDArray[np.intp], Array, Array] | None:
    """First ordinate, count and centre of each bin, from ``lowest`` (at least clear of the tapers' width) up to Nyquist, exclusive."""
    step = 1.0 / (n * dt)
    start = max(math.ceil(lowest / step), TAPERS)
    stop = (n - 1) // 2 - TAPERS  # the last ordinates mirror each other through the tapers
    if stop - start < 8:
        return None
    octaves = math.log2(stop / start)
    edges = start * 2.0 ** (np.arange(0, math.ceil(octaves * BINS_PER_OCTAVE)) / BINS_PER_OCTAVE)
    first = np.unique(np.round(edges).astype(np.intp))
    first = first[first < stop]
    last = np.append(first[1:], stop)
    keep = last > first
    first, last = first[keep], last[keep]
    centre = 0.5 * (first + last - 1) * step
    return np.append(first, stop), (last - first).astype(np.float64), centre


def overlap(n: int) -> float:
    """Ordinates that one independent ordinate is worth, for averages much wider than the tapers: n sum of squared mean weights."""
    return _overlap(min(n, 4096))


@lru_cache(maxsize=4)
def _overlap(n: int) -> float:
    t = np.arange(1, n + 1)
    weights = np.mean([2.0 / (n + 1) * np.sin(np.pi * k * t / (n + 1)) ** 2 for k in range(1, TAPERS + 1)], axis=0)
    return float(n * np.sum(weights**2))


def scale_of(process: Process) -> float:
    """What multiplies the density and the covariance of a process: the square of its level, or the level where it is a variance."""
    return process.parameters[process.level.name] ** (2 // process.level.power)


def of_unit_level(process: Process) -> Process:
    """The process with its level at one."""
    return process.with_parameters({process.level.name: 1.0})


def density(process: Process, f: Array, dt: float) -> Array:
    """Two-sided PSD of a process; its shape is remembered, because a search asks for it thousands of times at changing levels.

    Parameters
    ----------
    process : Process
    f : (k,) array
        Hz.
    dt : float
        Sampling interval, s.

    Returns
    -------
    (k,) array
        unit^2/Hz.
    """
    if f.size > MOST_REMEMBERED:
        return process.psd(f, dt)
    remembered = _unit_density if process.shape_parameters else _lasting_density
    return scale_of(process) * remembered(of_unit_level(process), f.tobytes(), dt)


def difference_covariance(process: Process, block: int, dt: float, count: int) -> Array:
    """Autocovariance of the differences of consecutive block means, its shape remembered as that of :func:`density` is.

    Parameters
    ----------
    process : Process
    block : int
        Samples per block.
    dt : float
        Sampling interval, s.
    count : int
        Lags 0 ... ``count - 1``, in blocks.

    Returns
    -------
    (count,) array
        unit^2.
    """
    remembered = _unit_covariance if process.shape_parameters else _lasting_covariance
    return scale_of(process) * remembered(of_unit_level(process), block, dt, count)


def _psd_of(unit: Process, f: bytes, dt: float) -> Array:
    out = unit.psd(np.frombuffer(f), dt)
    out.setflags(write=False)
    return out


def _covariance_of(unit: Process, block: int, dt: float, count: int) -> Array:
    out = unit.difference_covariance(block, dt, count)
    out.setflags(write=False)
    return out


# shapes that a search moves come and go; those of a level alone stay
_lasting_density, _unit_density = lru_cache(maxsize=64)(_psd_of), lru_cache(maxsize=64)(_psd_of)
_lasting_covariance, _unit_covariance = lru_cache(maxsize=64)(_covariance_of), lru_cache(maxsize=64)(_covariance_of)
