"""When samples were taken, from the stamps that a logger wrote: one model of rounding, jitter, late reception, repeated stamps, a wandering
rate, losses, counters that wrap and clocks that are set.

A sensor samples by its own clock, evenly or with a rate that wanders slowly, and rows come in the order in which it sampled. A stamp is the time
of a sample and an error: rounded to the digits of the file, scattered, or late by what lay between sensor and logger. The count of samples is
known up to losses, so the clock is a line (or a line whose rate wanders) through all stamps over the count, and losses are steps of the stamps
against it that nothing makes up for. Every row is used.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.errors import InputError

Array = NDArray[np.float64]

#: Steps that differ by less than this share are even: their median is the sampling interval.
_EVEN = 1e-6
#: Stamps that scatter by less than this share of the interval (1 sigma) are the times of their samples.
PRECISE = 5e-3
#: Scatter of stamps (1 sigma, sampling intervals) up to which a step alone tells how many samples it spans: six of its sigmas make half of one.
_CLEAR = 0.06
#: Root mean square distance of steps from whole intervals up to which these are no scatter: losses, however regular (chance has 0.29).
_WHOLE = 0.1
#: Scatter of a level of stamps at which it tells so; a jump of the level by more is a loss, if one over twice as many rows is, too.
_LEVEL, _JUMP = 0.12, 0.55
#: Fewer rows than these say nothing of their stamps but whether they rise.
FEW = 32
#: Fewest and most rows over which a level is taken on either side, rows over which the interval is taken first, rounds of counting.
_NARROWEST, _WIDEST, _BLOCK, _ROUNDS = 8, 2000, 64, 12
#: A row comes at most so many rows late; who goes back for longer was set, or wrapped.
LATE_ROWS = 16
#: Shortest stretch of samples, and of time in s, over which a rate may wander where stamps scatter.
_SHORTEST, _SHORTEST_S = 64, 1.0
#: Delays are one-sided where the upper half of the scatter is so many times the lower one; share of stamps below the line that follows the
#: least delayed.
_SKEWED, _LEAST = 2.0, 0.02
#: Share of rows with the stamp of the row before from which stamps are those of blocks, and the resolution (s) from which a clock is taken to
#: have cut its digits off.
_SHARED, _CUT = 0.2, 1.0
#: Share of stamps that go back from which a column is no time.
_BACK = 0.3
#: Where counters and calendars begin again: powers of two and ten of their unit, and s.
_BITS, _TENS, _CALENDAR = (8, 16, 24, 31, 32), (3, 6, 9), (60.0, 3600.0, 43_200.0, 86_400.0, 604_800.0)


@dataclass(frozen=True)
class SampleTimes:
    """What stamps say.

    Parameters
    ----------
    rows : (m,) array
        Rows in the order of their samples; only those that a logger wrote twice are not among them.
    t : (m,) array
        When they were taken, s, strictly increasing.
    interval : float
        Sampling interval, s.
    sigma : float
        Standard deviation of a stamp about its sample, s; 0 where stamps are taken as they are.
    lost : int
        Samples that are missing between the rows.
    said : tuple of str
        What was found and done.
    """

    rows: NDArray[np.intp]
    t: Array
    interval: float
    sigma: float = 0.0
    lost: int = 0
    said: tuple[str, ...] = ()


# ---------------------------------------------------------------------------------------------------------------- counting


def beat(t: Array) -> float:
    """Sampling interval of an IMU in s: the slope of its stamps over the samples that they count, NaN of fewer than two.

    Stamps that are rounded (to ms, at 104 Hz) have no step that is the interval, and neither have stamps that jitter or samples that are lost.

    Examples
    --------
    >>> round(1.0 / beat(np.round(np.arange(10_000) / 104.0, 3)), 3)
    104.0
    """
    return _counted(t)[0]


def samples(t: Array, interval: float) -> Array:
    """How many sampling intervals every step spans, (n-1,): a step is long because samples are lost if those around it do not make up for it.

    Parameters
    ----------
    t : (n,) array
        Stamps that do not go back, s.
    interval : float
        Sampling interval, s.
    """
    spans = np.diff(t) / interval
    stray = _stray(spans, _resolution(t) / interval)
    count, late = _by_steps(spans, stray)
    return count if stray < _CLEAR else _by_levels(t / interval, count, late, stray)


def _counted(t: Array) -> tuple[float, Array | None]:
    """The sampling interval, s, and how many of them every step spans; None of stamps that are even."""
    if t.size < 2:
        return float("nan"), None
    step = np.diff(t)
    interval = float(np.median(step))
    if step.size < 3 or (interval > 0.0 and float(np.abs(step - interval).max()) <= _EVEN * interval):
        return interval, None
    if not (_resolution(t) < _WHOLE * interval and _whole(step / interval)):
        interval = _first_interval(t)
    count = step
    if not interval > 0.0:
        return interval, None
    for _ in range(2):
        count = samples(t, interval)
        at = np.concatenate([[0.0], np.cumsum(count)])
        at -= at.mean()
        interval = float(at @ (t - t.mean()) / (at @ at))
    return interval, count


def _first_interval(t: Array) -> float:
    """The interval from blocks of rows, s: a lost sample or a long gap spoils few of them, and within one a shared stamp does not matter."""
    rising = max(int(np.count_nonzero(np.diff(t) > 0.0)), 1)
    block = int(max(_BLOCK, 20.0 * (t.size - 1) / rising))
    if t.size <= 4 * block:
        block = 1 if rising > 0.95 * (t.size - 1) else t.size - 1
    return float(np.median(t[block:] - t[:-block])) / block


def _whole(spans: Array) -> bool:
    """Whether steps are whole numbers of intervals, one at least, each by itself."""
    return bool(spans.min() > 0.5) and float(np.sqrt(np.mean((spans - np.rint(spans)) ** 2))) < _WHOLE


def _stray(spans: Array, resolution: float) -> float:
    """Scatter of single stamps about their samples, in intervals: what a step has too much and the next one too little, or the resolution.

    Steps of a sensor that is read late and then waits for a whole interval have nothing of it, whatever they scatter: their stamps are right.
    """
    if spans.size < FEW:
        return 0.0
    left = spans - np.rint(spans) if _whole(spans) else np.clip(spans, -4.0, 4.0)
    left = left - left.mean()
    near, far = (float(np.mean(left[k:] * left[:-k])) for k in (1, 3))  # those further away share what wanders
    whole = 1.0 / resolution if resolution else 0.0  # an interval of whole units is not rounded
    rounding = resolution / np.sqrt(12.0) if abs(whole - round(whole)) > 1e-3 * whole else 0.0
    return float(np.sqrt(max(max(far, 0.0) - near, rounding**2)))


def _by_steps(spans: Array, stray: float) -> tuple[Array, NDArray[np.bool_]]:
    """Samples of every step by its own length and those next to it, and which rows (n,) came late in one go."""
    clear = stray < _CLEAR
    count = np.maximum(np.rint(spans), 1.0) if clear else np.ones(spans.size)
    late = np.zeros(spans.size + 1, dtype=np.bool_)
    long = np.flatnonzero(spans > (1.5 if clear else max(1.5 + 6.0 * stray, 4.0 * float(np.quantile(spans, 0.99)))))
    # rows that were held up follow each other at once; one with too early a stamp comes at once, before a long step
    if long.size:
        short = np.flatnonzero(spans < 0.5)
        breaks = np.append(np.setdiff1d(np.arange(spans.size), short), spans.size)
        after = breaks[np.searchsorted(breaks, long + 1)]
        first = np.where(long > 0, np.append(-1, breaks)[np.searchsorted(breaks, long)] + 1, long)
        first = np.where(np.isin(first - 1, long), long, first)  # short steps behind another long one are its own
        total = np.concatenate([[0.0], np.cumsum(spans)])
        count[long] = np.maximum(np.rint(total[after] - total[first]) - (after - first - 1), 1.0)
        for k, end in zip(long.tolist(), after.tolist(), strict=True):
            late[k + 1 : end] = True
            count[k + 1 : end] = 1.0
    return count, late


def _by_levels(t: Array, count: Array, late: NDArray[np.bool_], stray: float) -> Array:
    """Samples of every step where stamps scatter by much of an interval (their unit): by the levels of many stamps before and after it."""
    steps, rows = np.diff(t), np.arange(t.size)
    blocks = 2.5 * t.size / max(int(np.count_nonzero(steps > 0.0)), 1)  # whole ones that share a stamp
    wide = int(np.clip(np.ceil(max(2.0 * (stray / _LEVEL) ** 2, 15.0 * stray, blocks)), _NARROWEST, _WIDEST))
    before = np.inf
    for _ in range(_ROUNDS):
        if t.size < 5 * wide:
            break
        n = np.concatenate([[0.0], np.cumsum(count)])
        left = t - _line(n, t, 20.0 * wide, np.where(late, 1e-9, 1.0))
        left = np.interp(rows, rows[~late], left[~late])
        # means, the least late or the least early: whichever scatters least
        spread, side = min((_spread(_jumps(left, wide, side))[0], side) for side in (0, 1, -1))
        if spread > 1.5 * _LEVEL and spread < 0.8 * before and wide < _WIDEST:  # stamps that are late together
            wide, before = min(_WIDEST, 2 * wide), spread
            continue
        jump, wider = (x - _spread(x)[1] for x in (_jumps(left, wide, side), _jumps(left, 2 * wide, side)))
        size = np.where(jump * wider > 0.0, np.minimum(np.abs(jump), np.abs(wider)), 0.0)
        top = scipy.ndimage.maximum_filter1d(size, 2 * wide + 1)
        changed, last = False, -wide
        for k in np.flatnonzero((size > max(_JUMP, 4.0 * spread)) & (size == top)).tolist():
            if k - last < wide:  # one jump of the least is as high over many rows
                continue
            last = k
            more, near = np.sign(jump[k]) * max(round(size[k]), 1), slice(max(k - wide // 2, 0), k + wide // 2 + 1)
            # the longest step near the top of the jump; what is too many is subtracted from the largest count
            at = near.start + int(np.argmax(steps[near] if more > 0.0 else count[near]))
            new = max(count[at] + more, 1.0)
            changed |= bool(new != count[at])
            count[at] = new
        if not changed:
            break
    return count


def _spread(jump: Array) -> tuple[float, float]:
    """Standard deviation and middle of jumps, by their lower quarter: losses are above."""
    low, high = np.quantile(jump, [0.05, 0.25])
    spread = float(high - low) / 0.97
    return spread, float(high) + 0.674 * spread


def _jumps(left: Array, width: int, side: int) -> Array:
    """By how much the level rises at every step, (n-1,): that of so many rows after it less that of those before; 0 near the ends.

    The level is their mean, the least (side 1) or the largest of them (-1).
    """
    k = np.arange(width, left.size - width + 1)
    if side:
        least = side * scipy.ndimage.minimum_filter1d(
            side * left, width, origin=-(width // 2), mode="nearest"
        )  # of rows k ... k + width - 1
        before, after = least[k - width], least[np.minimum(k, left.size - 1)]
    else:
        total = np.concatenate([[0.0], np.cumsum(left)])
        before, after = (total[k] - total[k - width]) / width, (total[k + width] - total[k]) / width
    out = np.zeros(left.size - 1)
    inside = k <= left.size - 1
    out[k[inside] - 1] = (after - before)[inside]
    return out


#: Stamps are counted in so many bins an interval for their periodogram, whose peak is looked for within this share of the rate.
_BINS, _NEAR = 8, 0.05
#: Losses that are weighed at a time, at most so many at one step; what a stamp before its sample costs, nats an interval; least share of losses.
_AHEAD, _AT_ONCE, _EARLY, _RARE = 24, 3, 50.0, 1e-4


def _by_delays(t: Array, interval: float, count: Array, stray: float) -> Array:
    """Samples of every step where each stamp has a delay of its own, exponential: the likeliest losses (Viterbi 1967), at the interval at which
    stamps are most in step (the peak of their periodogram). Where more is lost than that weighs at every step, the samples as given.
    """
    if t[-1] - t[0] > (1.0 + _AT_ONCE) * t.size * interval:
        return count
    bins = np.bincount(((t - t[0]) * (_BINS / interval)).astype(np.int64)).astype(np.float64)
    size = scipy.fft.next_fast_len(4 * bins.size)
    power = np.abs(scipy.fft.rfft(bins - bins.mean(), size))
    near = np.arange(int(size * (1.0 - _NEAR) / _BINS), min(int(size * (1.0 + _NEAR) / _BINS) + 2, power.size))
    x = t / interval * float(near[np.argmax(power[near])]) * _BINS / size - np.arange(t.size)
    share = max(float(count.sum() - count.size) / t.size, _RARE)
    return 1.0 + _likeliest_losses(x - x[:_WIDEST].min(), stray, float(np.log(share)))[1:]


@njit(cache=True, nogil=True)
def _likeliest_losses(x: Array, scale: float, rare: float) -> Array:
    """Losses before every row (n,) from stamps in intervals less one a row and the least delay, the scale of delays and the logarithm of a loss."""
    n = x.size
    score, new = np.full(_AHEAD, -1e300), np.empty(_AHEAD)
    back, moved = np.zeros((n, _AHEAD), np.int8), np.zeros(n, np.int64)
    base, score[0] = 0, 0.0
    for k in range(n):
        for w in range(_AHEAD):
            best, lost = score[w], 0
            for j in range(1, min(_AT_ONCE, w) + 1 if k else 0):
                if score[w - j] + j * rare > best:
                    best, lost = score[w - j] + j * rare, j
            delay = x[k] - base - w
            new[w] = best - (delay / scale if delay >= 0.0 else -_EARLY * delay)
            back[k, w] = lost
        top = int(np.argmax(new))
        moved[k] = max(top - _AHEAD // 2, 0)
        base += moved[k]
        for w in range(_AHEAD):
            score[w] = new[w + moved[k]] - new[top] if w + moved[k] < _AHEAD else -1e300
    out, at = np.zeros(n), int(np.argmax(score))
    for k in range(n - 1, -1, -1):
        at += moved[k]
        out[k] = back[k, at]
        at -= back[k, at]
    return out


# --------------------------------------------------------------------------------------------------------------- the clock


def _line(n: Array, t: Array, every: float, weight: Array | None = None) -> Array:
    """Least squares of a cubic spline with a knot every so many counts, a straight line where that is more than half of all; at the counts."""
    parts = int((n[-1] - n[0]) / every)
    w = np.ones(n.size) if weight is None else weight
    x = n - n[0]
    straight = np.polynomial.Polynomial.fit(x, t, 1, w=np.sqrt(w))(x)
    if parts < 2:
        return np.asarray(straight)
    x, y = x * (parts / x[-1]), t - straight
    at = np.minimum(x.astype(np.int64), parts - 1)
    f = x - at
    basis = (
        (1.0 - f) ** 3 / 6.0,
        (3.0 * f - 6.0) * f * f / 6.0 + 2.0 / 3.0,
        ((3.0 - 3.0 * f) * f + 3.0) * f / 6.0 + 1.0 / 6.0,
        f**3 / 6.0,
    )
    bands, right = np.zeros((4, parts + 3)), np.zeros(parts + 3)
    for i in range(4):
        right[i : i + parts] += np.bincount(at, w * basis[i] * y, parts)
        for j in range(i, 4):
            bands[3 - j + i, j : j + parts] += np.bincount(at, w * basis[i] * basis[j], parts)
    # bends cost a little, so that a knot within a gap is where its neighbours put it
    cost = 1e-7 * float(bands[3].mean())
    bands[3] += 1e-9 * cost
    second = (1.0, -2.0, 1.0)
    for i in range(3):
        for j in range(i, 3):
            bands[3 - j + i, j : j + parts + 1] += cost * second[i] * second[j]
    nodes = scipy.linalg.solveh_banded(bands, right)
    return np.asarray(straight + sum(nodes[at + i] * basis[i] for i in range(4)))


def _clock(n: Array, t: Array, interval: float, late: NDArray[np.bool_]) -> tuple[Array, float]:
    """The line through the stamps, bent as often as it pays (Schwarz's criterion, errors that hang together counted as fewer), and how often."""
    weight = np.where(late, 1e-9, 1.0)
    every, best, chosen = 2.0 * (n[-1] - n[0]), np.inf, (t, np.inf)
    distinct = 1.0 + np.count_nonzero(np.diff(t) > 0.0)
    whole, floor = 0.0, 0.5 * PRECISE * interval
    shortest = max(_SHORTEST * max(1.0, (n[-1] - n[0]) / n.size), _SHORTEST_S / interval)  # of rows that are there
    while True:
        line = _line(n, t, every, weight)
        left = (t - line)[~late]
        limit = 6.0 * max(1.4826 * float(np.median(np.abs(left - np.median(left)))), floor)
        left = np.clip(left - np.median(left), -limit, limit)
        square = float(left @ left) + left.size * floor**2  # what is less is no reason for a bend
        rho = float(np.clip(left[1:] @ left[:-1] / square, 0.0, 0.995))
        count = min(left.size * (1.0 - rho) / (1.0 + rho), distinct)
        bends = max(1.0, (n[-1] - n[0]) / every)
        whole = whole or square
        score = count * np.log(square / whole) + bends * np.log(max(count, 2.0))
        if score < best and (np.diff(line) > 0.0).all():
            best, chosen = score, (line, every)
        every /= 4.0 if every < n[-1] - n[0] else 8.0
        if every < shortest:
            return chosen


def _side(t: Array, left: Array, shared: float) -> int:
    """On which side of their samples stamps lie: 1 late ones (the least delayed tell the clock), -1 digits that are cut off, 0 either."""
    if shared > _SHARED:
        return -1 if _resolution(t) >= _CUT else 1
    low, middle, high = np.quantile(left, [0.05, 0.5, 0.95])
    return int(high - middle > _SKEWED * (middle - low))


def _envelope(n: Array, t: Array, every: float, late: NDArray[np.bool_], side: int) -> Array:
    """The line along the least delayed stamps: least squares in which errors on either side weigh differently (Newey and Powell, 1987)."""
    share = _LEAST if side > 0 else 1.0 - _LEAST
    weight, line = np.where(late, 1e-9, 1.0), t
    for _ in range(20):
        line = _line(n, t, every, weight)
        new = np.where(late, 1e-9, np.where(t > line, share, 1.0 - share))
        if np.array_equal(new, weight):
            break
        weight = new
    return line + float(np.quantile(t - line, 0.5 * share if side > 0 else 0.5 * (1.0 + share)))


def sample_times(stamps: Array, same: NDArray[np.bool_] | None = None) -> SampleTimes:
    """When the samples of an IMU were taken.

    Parameters
    ----------
    stamps : (n,) array
        s, in the order of the file, as :func:`continuous` gives them.
    same : (n,) array of bool, optional
        Which rows hold the values of the row before: with its stamp, too, they are that row once more.

    Examples
    --------
    >>> found = sample_times(np.round(np.arange(10_000) / 104.0, 3))
    >>> round(1.0 / found.interval, 4), found.said[0]
    (104.0, 'the stamps are rounded to 1 ms: samples are put at 104 Hz through all of them, a stamp strays by 0.29 ms')
    """
    rows, said = in_order(stamps, same)
    t = stamps if np.array_equal(rows, np.arange(stamps.size)) else stamps[rows]
    if t.size < FEW:
        rows = rows[np.unique(t, return_index=True)[1]]
        left_out = t.size - rows.size
        if left_out > 0.5 * t.size:
            raise InputError(
                f"only {rows.size} of {t.size} stamps rise; is another column the time (--map 'time=...')?"
            )
        said += (f"{left_out} of {t.size} row(s) share a stamp with another; one of them is used",) * bool(left_out)
        t = stamps[rows] if left_out else t
    interval, count = _counted(t)
    if count is None or t.size < 3:
        return SampleTimes(rows, t, interval, said=said)
    lost = int(count.sum() - count.size)
    found = SampleTimes(rows, t, interval, lost=lost, said=said)
    step = np.diff(t)
    shared = float(np.mean(step == 0.0))
    resolution = _resolution(t) / interval
    if _stray(step / interval - count + 1.0, resolution) < PRECISE and step.min() > 0.0:
        return found
    stray = _stray(step / interval, resolution)
    late = _by_steps(step / interval, stray)[1]
    line, side, sigma = _put(t, count, interval, late, shared)
    if stray > _CLEAR and shared < _SHARED:
        again = _by_delays(t, interval, count, stray)
        other = _put(t, again, interval, late, shared)
        if other[1] > 0 and other[2] < sigma:
            count, (line, side, sigma) = again, other
    interval = float(line[-1] - line[0]) / float(count.sum())
    found = replace(found, t=line, interval=interval, sigma=sigma, lost=int(count.sum() - count.size))
    return replace(found, said=(*_told(found, t - line, t, side), *said))


def _put(t: Array, count: Array, interval: float, late: NDArray[np.bool_], shared: float) -> tuple[Array, int, float]:
    """Samples on the clock of so many to every step, on which side of them stamps lie, and by how much they scatter, s."""
    n = np.concatenate([[0.0], np.cumsum(count)])
    line, every = _clock(n, t, interval, late)
    side = _side(t, (t - line)[~late], shared)
    if side:
        line = _envelope(n, t, every, late, side)
    if not (np.diff(line) > 0.0).all():
        line = _line(n, t, np.inf)
    left = t - line
    return line, side, float(np.std(np.clip(left, *np.quantile(left, [0.001, 0.999]))))


def _told(found: SampleTimes, left: Array, stamps: Array, side: int) -> list[str]:
    """What the stamps are, in words."""
    resolution, shared = _resolution(stamps), int(np.count_nonzero(np.diff(stamps) == 0.0))
    rate, ms = f"{1.0 / found.interval:.6g} Hz", 1e3
    out = []
    if found.sigma < PRECISE * found.interval:
        pass
    elif side < 0:
        out.append(
            f"the stamps have a resolution of {resolution:g} s, cut off: samples are put at {rate}, each within the time that its stamp names"
        )
    elif side:
        out.append(
            f"the stamps are late by up to {ms * float(np.quantile(left, 0.99)):.3g} ms, as on reception: samples are put at {rate} along the least "
            "delayed; a delay that all have is one of the clock"
        )
    elif abs(np.sqrt(12.0) * found.sigma - resolution) < 0.3 * resolution:
        out.append(
            f"the stamps are rounded to {ms * resolution:g} ms: samples are put at {rate} through all of them, a stamp strays by "
            f"{ms * found.sigma:.2g} ms"
        )
    else:
        out.append(
            f"the stamps scatter by {ms * found.sigma:.2g} ms about a clock of {rate}: samples are put on it; if the sensor was read at these "
            "times and has no clock of its own, they are that uncertain"
        )
    if shared:
        out.append(f"{shared} row(s) have the stamp of the row before: each is a sample of its own")
    return out


def _resolution(t: Array) -> float:
    """The largest of 1e-6 s to 60 s that all stamps are multiples of; 0 where they are of none."""
    for q in (60.0, 1.0, 0.1, 0.01, 1e-3, 1e-4, 1e-5, 1e-6):
        part = t / q
        if (np.abs(part - np.rint(part)) < 1e-3).all():
            return q
    return 0.0


# ------------------------------------------------------------------------------------------------------ order, wraps, settings


def in_order(t: Array, same: NDArray[np.bool_] | None = None) -> tuple[NDArray[np.intp], tuple[str, ...]]:
    """Rows in the order of their samples without those that a logger wrote twice, and what was done.

    Rows come in that order, and stamps that go back scatter; unless those of the file put in order scatter far less: then rows came late.

    Parameters
    ----------
    t : (n,) array
        Stamps as :func:`continuous` gives them, s.
    same : (n,) array of bool, optional
        Which rows hold the values of the row before.

    Returns
    -------
    (m,) array, tuple of str

    Raises
    ------
    InputError
        Stamps that are no times: three of ten and more go back, or they are all the same.
    """
    said = []
    rows = np.arange(t.size)
    if t.size < 2:
        return rows, ()
    behind = int(np.count_nonzero(t[1:] < np.maximum.accumulate(t)[:-1]))
    if behind > _BACK * t.size or (t.size > 2 and t.min() == t.max()):
        raise InputError(
            f"{behind} of {t.size} stamps go back and {np.unique(t).size} are different; is another column the time (--map 'time=...')?"
        )
    if behind:
        ordered = np.sort(t)
        if _about_lines(ordered, ordered != t) < 0.5 * _about_lines(t, ordered != t):
            rows = np.argsort(t, kind="stable")
            said.append(f"{behind} row(s) came after later ones: they are put where their stamps say")
    if same is not None:
        shared = np.concatenate([[False], np.diff(t) == 0.0])
        twice = shared & same
        if twice.any() and np.mean(same[shared]) > 10.0 * np.mean(same[~shared]):
            rows = rows[~twice[rows]]
            said.append(f"{int(twice.sum())} row(s) repeat the one before, stamp and values: each is used once")
    return rows, tuple(said)


def _about_lines(t: Array, at: NDArray[np.bool_]) -> float:
    """Scatter of stamps about lines through so many rows each, s: of those stretches that have some of the rows ``at``."""
    block = min(FEW, t.size)
    first = np.arange(0, t.size - block + 1, block)
    first = first[np.add.reduceat(at[: first[-1] + block], first) > 0]
    if not first.size:
        return 0.0
    blocks = t[first[:, None] + np.arange(block)]
    x = np.arange(block) - 0.5 * (block - 1)
    blocks = blocks - blocks.mean(axis=1)[:, None]
    return float(np.median((blocks - (blocks @ x / (x @ x))[:, None] * x).std(axis=1)))


def continuous(t: Array, unit_s: float = 1.0) -> tuple[Array, tuple[str, ...]]:
    """Stamps of a counter or calendar that begins again, or of a clock that was set back, as one rising time.

    Parameters
    ----------
    t : (n,) array
        Stamps in s, in the order of the file.
    unit_s : float
        Unit in which the file counts, s: counters wrap at powers of two or ten of it, calendars after a minute, an hour, a day, a week.

    Returns
    -------
    (n,) array, tuple of str
        s; what was done. A row that alone lies elsewhere is put between its neighbours. Rows that come a few rows late stay as they are.

    Examples
    --------
    >>> continuous(np.array([65.533, 65.534, 65.535, 0.000, 0.001] + [0.001 * k for k in range(2, 40)]), 1e-3)[1]
    ('the stamps begin again after 65.536 s, 1 time(s): they are one rising time',)
    """
    step = np.diff(t)
    if step.size < 3 or step.min() >= 0.0:
        return t, ()
    rising = step[step > 0.0]
    interval = max(float(np.median(rising)) if rising.size else 0.0, 1e-12)
    said = []
    middle = 0.5 * (t[2:] + t[:-2])
    alone = (
        np.flatnonzero(
            (np.abs(t[1:-1] - middle) > 4.0 * interval) & (np.abs(t[2:] - t[:-2] - 2.0 * interval) < interval)
        )
        + 1
    )
    if alone.size:
        t = t.copy()
        t[alone] = middle[alone - 1]
        said.append(f"{alone.size} stamp(s) lie far from those next to them: they are put between them")
        step = np.diff(t)
    ahead = scipy.ndimage.maximum_filter1d(t, LATE_ROWS, origin=-(LATE_ROWS // 2), mode="nearest")[1:]
    highest = scipy.ndimage.maximum_filter1d(t, LATE_ROWS, origin=(LATE_ROWS - 1) // 2, mode="nearest")[:-1]
    falls = np.flatnonzero((step < 0.0) & (ahead < highest))
    if not falls.size:
        return t, tuple(said)
    moduli = sorted({*(unit_s * 2.0**k for k in _BITS), *(unit_s * 10.0**k for k in _TENS), *_CALENDAR})
    added = np.zeros(t.size)
    wraps: dict[float, int] = {}
    for k in falls.tolist():
        fall = -float(step[k])
        size = next((m for m in moduli if 0.0 <= m - fall <= max(2.0 * interval, min(100.0 * interval, 0.02 * m))), 0.0)
        wraps[size] = wraps.get(size, 0) + 1
        added[k + 1] = size or fall + interval
        if not size:
            said.append(
                f"the clock was set back by {fall:.6g} s at row {k + 1}: the rows behind go on one interval later"
            )
    said += [
        f"the stamps begin again after {m:.10g} s, {n} time(s): they are one rising time" for m, n in wraps.items() if m
    ]
    return t + np.cumsum(added), tuple(said)
