"""Lost samples: where stamps skip them or rows repeat, and what the samples around them leave open; the one filling of logs at rest and of drives."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.records import ImuRecord
from insemu.sample_times import beat, samples

Array = NDArray[np.float64]

#: Samples to either side that a lost sample is drawn from.
NEAR = 12
#: Width of the parabola that follows the slow part of a log at rest, and of a drive, whose motion bends it within a tenth of a second.
REST_S, MOTION_S = 1.0, 0.08
#: Fewest samples over which the parabola of a log at rest is wide: a narrower one follows the noise, of which lost samples then get too little
#: (standard deviation 0.57 of the true one at 6, 0.84 at 10, 0.99 at 20 samples; tests/test_gap_dynamic.py).
REST_SAMPLES = 2.0 * NEAR
#: Fewest samples that a parabola goes through, on each side of a lost one where there are two.
FEWEST = 6
#: White noise that keeps the equations solvable, of the variance that the parabola leaves: motion is some thousand times the noise.
RIDGE = 1e-6
#: Fewest repeated samples that are called lost, how many times what chance repeats there must be, and the largest share of lost samples: with more
#: there is too little next to a gap to fill it by. Those of a log at rest and of a drive.
FEWEST_REPEATS, ABOVE_CHANCE, MOST_LOST = 3, 10.0, 0.1
#: Share of the sampling interval that a stamp may stray before it says nothing of lost samples, and the longest gap that is filled, s.
STRAY, LONGEST_S = 0.25, 0.5
#: Share of steps that must be whole intervals: stamps that stray more often say nothing.
WHOLE_STEPS = 0.98
#: What is done with lost samples, in words.
FILLED_IN = "are filled in by the samples around them"
#: Sides of a real gap on which one of the same length is tried, :data:`NEAR` samples from it.
BESIDE = (-1, 1)


@dataclass(frozen=True)
class Filled:
    """A stretch of an axis that was filled in: axis (0..5), when (s), and how uncertain its integral is (rad or m/s)."""

    axis: int
    start: float
    end: float
    sigma: float


@dataclass(frozen=True)
class Lost:
    """Samples that a record lost, filled in.

    Parameters
    ----------
    held : bool
        Whether rows repeated the row before; else stamps skipped them.
    rows : (n,) array of bool
        Which rows of the restored record were lost.
    nats : float
        How surprising it is where nothing is lost.
    stretches : tuple of Filled
        How uncertain they are; none where what was lost is in the row that follows.
    """

    held: bool
    rows: NDArray[np.bool_]
    nats: float
    stretches: tuple[Filled, ...]

    @property
    def said(self) -> str:
        """How many there are and what shows it, in words."""
        shown = "rows repeat the row before" if self.held else "stamps skip them"
        return f"{int(self.rows.sum())} samples of the IMU are lost, where {shown}"

    @property
    def bursts(self) -> int:
        """Runs of lost samples."""
        return int(runs(self.rows)[0].size)


def restored(imu: ImuRecord, stray: float = STRAY, longest: float = LONGEST_S) -> tuple[ImuRecord, tuple[Lost, ...]]:
    """A record with what its recorder lost filled in by the samples around it, and what that was.

    Stamps that skip samples, and rows that repeat the row before on all six axes more often than chance would: the recorder read a sample twice and
    missed another. Up to :data:`NEAR` samples after a lost one say what it was, so that a filter in real time would be as late.

    Parameters
    ----------
    imu : ImuRecord
    stray : float
        Share of the sampling interval that a stamp may stray before it says nothing of lost samples.
    longest : float
        Longest gap that is filled, s.
    """
    out: list[Lost] = []
    for step in (_bridged, _let_go):
        found = step(imu, stray, longest)
        if found is not None:
            imu, lost = found
            out.append(lost)
    return imu, tuple(out)


def drawn(imu: ImuRecord, lost: Iterable[Lost], rng: np.random.Generator) -> ImuRecord:
    """A restored record with lost samples as noisy as the others, for a spectrum; what integrates errs least by their means.

    Parameters
    ----------
    imu : ImuRecord
        Of :func:`restored`.
    lost : iterable of Lost
        What it filled in.
    rng : Generator
    """
    gone = np.zeros(len(imu), dtype=np.bool_)
    for each in lost:
        gone |= each.rows
    return _filled(imu, gone, rng) if gone.any() else imu


def as_noise(stretches: Iterable[Filled], duration: float) -> Array:
    """The white noise (6,) that errors over stretches make on each axis in ``duration`` s, squared: (rad/s)^2/Hz and (m/s^2)^2/Hz."""
    total = np.zeros(6)
    for s in stretches:
        total[s.axis] += s.sigma**2
    return total / duration


def _bridged(imu: ImuRecord, stray: float, longest: float) -> tuple[ImuRecord, Lost] | None:
    step, dt = np.diff(imu.t), imu.dt
    missing = samples(imu.t, dt).astype(np.int64) - 1
    close = np.abs(step / dt - 1.0 - missing) < stray
    gaps = np.flatnonzero((missing > 0) & close & (step < longest))
    if (
        not gaps.size
        or (close & (missing == 0)).sum() + gaps.size < WHOLE_STEPS * step.size
        or gaps.size > MOST_LOST * step.size
    ):
        return None
    n = step.size + int(missing[gaps].sum())
    # a stamp that is missing is surprising by its share alone
    nats = gaps.size * (1.0 - math.log(gaps.size / n))
    lost = np.zeros(step.size, dtype=np.int64)
    lost[gaps] = missing[gaps]
    at, empty = places(lost)
    t = np.interp(np.arange(empty.size), at, imu.t)
    # what a row after a gap holds: the increment of one interval, the others lost, or of the whole gap; whichever fits its neighbours
    share = np.ones((len(imu), 1))
    share[gaps + 1] = missing[gaps, None] + 1.0
    columns: list[Array] = []
    stretches: list[Filled] = []
    for first, measured in ((0, imu.gyro), (3, imu.accel)):
        values, whole = np.array(measured), False
        if imu.kind == "increment":
            neighbours = 0.5 * (values[gaps] + values[np.minimum(gaps + 2, len(imu) - 1)])
            one, all_of_it = (
                float(np.sum(np.abs(values[gaps + 1] - neighbours * factor))) for factor in (1.0, share[gaps + 1])
            )
            whole = all_of_it < one
            values /= share if whole else 1.0
        columns.append(filled(values, empty, MOTION_S / dt))
        if whole:  # what was lost is known but for how it went about
            _keep_sums(columns[-1], empty)
        else:
            stretches += _stretches(columns[-1], empty, t, imu.kind, first)
    temperature = None if imu.temperature is None else np.interp(t, imu.t, imu.temperature)
    return ImuRecord(t, columns[0], columns[1], imu.kind, temperature), Lost(False, empty, nats, tuple(stretches))


def _let_go(imu: ImuRecord, stray: float, longest: float) -> tuple[ImuRecord, Lost] | None:
    held = imu.repeated()
    begin, end = runs(held)
    dt = imu.dt
    if begin.size < FEWEST_REPEATS or held.sum() > MOST_LOST * held.size or np.max(end - begin) * dt > longest:
        return None
    # output counts repeat by themselves: on all axes at once as often as each does where not all of them do
    values = np.hstack([imu.gyro, imu.accel])[~held]
    chance = float(np.prod(np.maximum(np.mean(np.diff(values, axis=0) == 0.0, axis=0), 1.0 / len(values))))
    share = begin.size / held.size
    if share < ABOVE_CHANCE * chance:
        return None
    imu = _filled(imu, held)
    stretches = [
        s for first, values in ((0, imu.gyro), (3, imu.accel)) for s in _stretches(values, held, imu.t, imu.kind, first)
    ]
    return imu, Lost(True, held, begin.size * math.log(share / chance), tuple(stretches))


def _filled(imu: ImuRecord, gone: NDArray[np.bool_], rng: np.random.Generator | None = None) -> ImuRecord:
    """A record with the samples of some rows drawn, or with their means."""
    width = MOTION_S / imu.dt
    return replace(
        imu, gyro=filled(imu.gyro[~gone], gone, width, rng), accel=filled(imu.accel[~gone], gone, width, rng)
    )


def _stretches(values: Array, empty: NDArray[np.bool_], t: Array, kind: str, first: int) -> list[Filled]:
    """The filled gaps of a sensor whose axes begin at ``first``, with how uncertain their integrals are."""
    dt = beat(t)
    wrong = missed(values, empty, MOTION_S / dt)
    wrong *= 1.0 if kind == "increment" else dt
    begin, end = runs(empty)
    return [
        Filled(first + k, float(t[a - 1]), float(t[b - 1]), float(s))
        for a, b, each in zip(begin, end, wrong, strict=True)
        for k, s in enumerate(each)
    ]


def _keep_sums(filled_in: Array, empty: NDArray[np.bool_]) -> None:
    """Move each gap with the row behind it, which holds the mean of the whole gap, so that their sum is what was measured; in place."""
    for a, b in zip(*runs(empty), strict=True):
        rows = slice(a, b + 1)
        filled_in[rows] += filled_in[b] - filled_in[rows].mean(axis=0)


def places(lost: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Where the m samples of a log belong, (m,), and which of all n places are empty, given how many were lost before each but the first."""
    at = np.concatenate([[0], np.cumsum(1 + lost)])
    missing = np.ones(int(at[-1]) + 1, dtype=np.bool_)
    missing[at] = False
    return at, missing


def width_at_rest(dt: float) -> float:
    """Samples over which the parabola of a log at rest is wide, given its sampling interval, s."""
    return max(REST_S / dt, REST_SAMPLES)


def filled(values: Array, missing: NDArray[np.bool_], width: float, rng: np.random.Generator | None = None) -> Array:
    """Signals with their lost samples drawn from what the ones around them leave open, or with the mean of that.

    A parabola through the neighbours follows what is slow; the autocovariance of what it leaves decides how far a lost sample follows those
    next to it and how much it is drawn. Interpolated samples would be too smooth: the noise of a log that lost many would look coloured, and that
    of a drive too small. What integrates the samples errs least by their mean.

    Parameters
    ----------
    values : (m, k) array
        The samples that are there, of k signals.
    missing : (n,) array of bool
        Which places are empty; m of them are not.
    width : float
        Samples over which the parabola is wide: the standard deviation of its Gaussian weights.
    rng : Generator, optional
        To draw with; without it the mean is taken.

    Returns
    -------
    (n, k) array
    """
    out = np.zeros((missing.size, values.shape[1]))
    out[~missing] = values
    if missing.any():
        slow = _slow(out, (~missing).astype(np.float64), max(width, 0.5 * NEAR))
        for column, mean in zip(out.T, slow.T, strict=True):
            _draw(column, mean, missing, rng)
    return out


def missed(whole: Array, missing: NDArray[np.bool_], width: float) -> Array:
    """By how much sums over gaps filled with the mean are wrong, by gaps of the same length next to them where nothing was lost.

    Parameters
    ----------
    whole : (n, k) array
        Signals as :func:`filled` gives them.
    missing : (n,) array of bool
        Which samples were lost.
    width : float
        As of :func:`filled`.

    Returns
    -------
    (g, k) array
        Standard deviation of the sum over each gap, unit of the signals; a gap's own trials count with the mean of those of its length, as one
        more. Zero where no gap of that length fits in anywhere.
    """
    first, last = runs(missing)
    length = last - first
    square, count = np.zeros((first.size, whole.shape[1])), np.zeros(first.size)
    for side in BESIDE:  # one at a time: as many as there are
        tried, taken = np.zeros_like(missing), missing.copy()
        trials: list[tuple[int, int, int]] = []
        for k, (a, b) in enumerate(zip(first, last, strict=True)):
            start, end = (int(v) + side * (int(length[k]) + NEAR) for v in (a, b))
            if start >= NEAR and end <= missing.size - NEAR and not taken[start - NEAR : end + NEAR].any():
                tried[start:end] = taken[start:end] = True
                trials.append((k, start, end))
        total = np.cumsum(filled(whole[~tried], tried, width) - whole, axis=0)
        for k, start, end in trials:
            square[k] += (total[end - 1] - total[start - 1]) ** 2
            count[k] += 1.0
    for alike in (length == n for n in np.unique(length)):
        mean = square[alike].sum(axis=0) / max(1.0, float(count[alike].sum()))
        square[alike] = (square[alike] + mean) / (count[alike] + 1.0)[:, None]
    return np.asarray(np.sqrt(square))


def runs(inside: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where the stretches of an array begin, and the places behind their ends."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8)))
    return edges[::2], edges[1::2]


def _draw(x: Array, slow: Array, missing: NDArray[np.bool_], rng: np.random.Generator | None) -> None:
    """Draw the lost samples of one signal in place around its slow part, and once more by the autocovariance of the whole signal."""
    counted = ~missing
    for _ in range(2):
        fast = np.where(counted, x - slow, 0.0)
        # of a signal with holes, taken lag by lag, it need not be one of anything; of the whole one, with its ends, it is
        pairs = _lagged(counted.astype(np.float64)) if not counted.all() else np.full(2 * NEAR + 1, float(x.size))
        r = _lagged(fast) / np.maximum(pairs, 1.0)
        if not r[0] > 0.0:
            x[missing] = slow[missing]
            return
        # a little white noise keeps the equations solvable
        r[0] += RIDGE * r[0] + max(-2.0 * float(np.linalg.eigvalsh(scipy.linalg.toeplitz(r))[0]), 0.0)
        _draw_by(r, x, slow, fast, missing, rng)
        counted = np.ones(x.size, dtype=np.bool_)


def _lagged(x: Array) -> Array:
    return np.array([float(x[k:] @ x[: x.size - k]) for k in range(2 * NEAR + 1)])


def _draw_by(
    r: Array, x: Array, slow: Array, fast: Array, missing: NDArray[np.bool_], rng: np.random.Generator | None
) -> None:
    known: dict[bytes, tuple[Array, float]] = {}
    there = ~missing
    for k in map(int, np.flatnonzero(missing)):
        near = np.arange(max(0, k - NEAR), min(x.size, k + NEAR + 1))
        near = near[there[near]]
        key = (near - k).tobytes()
        if key not in known:
            weights = np.linalg.solve(r[np.abs(near[:, None] - near[None, :])], r[np.abs(near - k)])
            known[key] = weights, float(np.sqrt(max(r[0] - weights @ r[np.abs(near - k)], 0.0)))
        weights, spread = known[key]
        fast[k] = weights @ fast[near] + (0.0 if rng is None else spread * rng.standard_normal())
        x[k] = slow[k] + fast[k]
        there[k] = True


def _slow(values: Array, present: Array, width: float) -> Array:
    """The values (n, k) of local parabolas at every place, wider where too few samples are there."""
    from scipy.signal import fftconvolve

    n = present.size
    centre = np.array([float(x @ present / present.sum()) for x in values.T])
    y, out = [(x - c) * present for x, c in zip(values.T, centre, strict=True)], np.zeros(values.shape)
    left = np.ones(n, dtype=np.bool_)
    while left.any():
        half = int(np.ceil(3.0 * width))
        u = np.arange(-half, half + 1) / width
        weight = np.exp(-0.5 * u * u)
        # a convolution turns the kernel round: places later than one's own come with the sign of those before
        m = [fftconvolve(present, weight * (-u) ** j, "same") for j in range(5)]
        total = np.concatenate([[0.0], np.cumsum(present)])
        k = np.arange(n)
        before = total[k] - total[np.maximum(k - half, 0)]
        after = total[np.minimum(k + half + 1, n)] - total[k + 1]
        enough = (before >= FEWEST) & (after >= FEWEST)
        enough |= ((k < half) | (k >= n - half)) & (before + after >= 2 * FEWEST)
        at = np.flatnonzero(left & (enough | (2 * half > n)))
        if at.size:
            M = np.stack([np.stack([m[i + j][at] for j in range(3)], axis=-1) for i in range(3)], axis=-2)
            M += 1e-9 * m[0][at][:, None, None] * np.eye(3)
            b = [[fftconvolve(x, weight * (-u) ** j, "same")[at] for x in y] for j in range(3)]
            out[at] = np.linalg.solve(M, np.moveaxis(np.array(b), -1, 0))[:, 0, :]
            left[at] = False
        width *= 2.0
    return np.asarray(out + centre)
