"""Lost samples: where the stamps skip them, and what the samples around them leave open; the one filling of logs at rest and of drives."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz

Array = NDArray[np.float64]

#: Samples to either side that a lost sample is drawn from.
NEAR = 12
#: Width of the parabola that follows the slow part of a log at rest, and of a drive, whose motion bends it within a tenth of a second.
REST_S, MOTION_S = 1.0, 0.08
#: Fewest samples that a parabola goes through, on each side of a lost one where there are two.
FEWEST = 6
#: White noise that keeps the equations solvable, of the variance that the parabola leaves: motion is some thousand times the noise.
RIDGE = 1e-6
#: Fewest repeated samples that are called lost, how many times what chance repeats there must be, and the largest share of lost samples: with more
#: there is too little beside a gap to fill it by. Those of a log at rest and of a drive.
FEWEST_REPEATS, ABOVE_CHANCE, MOST_LOST = 3, 10.0, 0.1
#: Sides of a real gap on which one of the same length is tried, :data:`NEAR` samples from it.
BESIDE = (-1, 1)


def places(lost: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Where the m samples of a log belong, (m,), and which of all n places are empty, given how many were lost before each but the first."""
    at = np.concatenate([[0], np.cumsum(1 + lost)])
    missing = np.ones(int(at[-1]) + 1, dtype=np.bool_)
    missing[at] = False
    return at, missing


def filled(values: Array, missing: NDArray[np.bool_], width: float, rng: np.random.Generator | None = None) -> Array:
    """Signals with their lost samples drawn from what the ones around them leave open, or with the mean of that.

    A parabola through the neighbours follows what is slow; the autocovariance of what it leaves decides how far a lost sample follows those
    beside it and how much it is drawn. Interpolated samples would be too smooth: the noise of a log that lost many would look coloured, and that
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
        for column in out.T:
            _draw(column, missing, max(width, 0.5 * NEAR), rng)
    return out


def missed(whole: Array, missing: NDArray[np.bool_], width: float) -> Array:
    """By how much sums over gaps filled with the mean are wrong, by gaps of the same length beside them where nothing was lost.

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
        Standard deviation of the sum over each gap, unit of the signals; a gap's own trials count beside the mean of those of its length, as one
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


def _draw(x: Array, missing: NDArray[np.bool_], width: float, rng: np.random.Generator | None) -> None:
    """Draw the lost samples of one signal in place, and once more by the autocovariance of the whole signal."""
    slow = _slow(x, (~missing).astype(np.float64), width)
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
        r[0] += RIDGE * r[0] + max(-2.0 * float(np.linalg.eigvalsh(toeplitz(r))[0]), 0.0)
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


def _slow(x: Array, present: Array, width: float) -> Array:
    """The value of a local parabola at every place, wider where too few samples are there."""
    from scipy.signal import fftconvolve

    centre = float(x @ present / present.sum())
    y, out = (x - centre) * present, np.zeros(x.size)
    left = np.ones(x.size, dtype=np.bool_)
    while left.any():
        half = int(np.ceil(3.0 * width))
        u = np.arange(-half, half + 1) / width
        weight = np.exp(-0.5 * u * u)
        # a convolution turns the kernel round: places later than one's own come with the sign of those before
        m = [fftconvolve(present, weight * (-u) ** j, "same") for j in range(5)]
        b = [fftconvolve(y, weight * (-u) ** j, "same") for j in range(3)]
        total = np.concatenate([[0.0], np.cumsum(present)])
        k = np.arange(x.size)
        before = total[k] - total[np.maximum(k - half, 0)]
        after = total[np.minimum(k + half + 1, x.size)] - total[k + 1]
        enough = (before >= FEWEST) & (after >= FEWEST)
        enough |= ((k < half) | (k >= x.size - half)) & (before + after >= 2 * FEWEST)
        at = np.flatnonzero(left & (enough | (2 * half > x.size)))
        if at.size:
            M = np.stack([np.stack([m[i + j][at] for j in range(3)], axis=-1) for i in range(3)], axis=-2)
            M += 1e-9 * m[0][at][:, None, None] * np.eye(3)
            out[at] = np.linalg.solve(M, np.stack([c[at] for c in b], axis=-1)[..., None])[:, 0, 0]
            left[at] = False
        width *= 2.0
    return out + centre
