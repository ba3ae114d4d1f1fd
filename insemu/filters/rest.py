"""Whether the vehicle stands still: the one place that decides it.

A gyroscope that shows a constant rate either turns or has a bias, and a quiet signal does not tell which. What tells is

* the specific force: where its direction in the body stays, the body does not turn about a horizontal axis, however large the rate that is shown,
* the size: about the vertical, a rate below :data:`STILL_RATE` is taken for a bias,
* the fixes: where another quiet stretch, with motion between, shows the same rate, or where the bias is known (from the drive, for example).

A steady turn about the vertical that none of them tells from a bias (a turntable) is quiet but no rest: it levels, and says nothing about the
bias about the vertical.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.records import GnssRecord, ImuRecord, Recording

Array = NDArray[np.float64]

#: Spreads are judged over blocks of so many seconds.
BLOCK_S = 0.5
#: A rate about the vertical below this is taken for a bias, rad/s: below what a turntable or a manoeuvre turns at, above the bias that is left of
#: most calibrated sensors.
STILL_RATE = np.deg2rad(0.2)
#: No gyroscope has a bias above this, rad/s.
LARGEST_BIAS = np.deg2rad(5.0)
#: Standard deviation of a bias of which nothing is known, rad/s (consumer MEMS, uncalibrated).
BIAS_SIGMA = np.deg2rad(2.0)
#: The direction of the specific force may turn at this rate without being called a turn, rad/s (a bias of the accelerometer that settles).
DIRECTION_RATE = np.deg2rad(0.1)
#: Means over half a second of a vehicle at rest scatter by no more than this together with white noise, rad/s and m/s^2.
STEADY = (np.deg2rad(0.1), 0.03)
#: Rates of two quiet stretches that are this close are the same, rad/s (in-run changes of consumer MEMS).
SAME_RATE = np.deg2rad(0.05)
#: Between two quiet stretches of the same rate the vehicle moved when a fix was faster than this, m/s.
MOVED_SPEED = 1.0


@dataclass(frozen=True)
class Quiet:
    """A stretch in which the IMU does not stir.

    Parameters
    ----------
    start, end : float
        s.
    rate : (3,) array
        Mean angular rate, rad/s.
    down : (3,) array
        Direction of gravity in body axes.
    scatter : float
        Standard deviation of the mean rate of an axis, rad/s.
    still : bool
        Whether it is a rest: a turn about the vertical is excluded.
    """

    start: float
    end: float
    rate: Array
    down: Array
    scatter: float
    still: bool

    def bias(self) -> tuple[Array, Array]:
        """Bias of the gyroscope as this stretch tells it (the Earth's rate is in it), (3,), and its covariance (3, 3).

        What would pass for a rest is not distinguished from a bias: the bounds of the tests are three standard deviations.
        """
        vertical = np.outer(self.down, self.down)
        across = self.scatter**2 + (DIRECTION_RATE / 2.6) ** 2
        value = self.rate if self.still else self.rate - vertical @ self.rate
        along = self.scatter**2 + (STILL_RATE / 2.6) ** 2 if self.still else BIAS_SIGMA**2
        return value, across * (np.eye(3) - vertical) + along * vertical


#: Largest horizontal speed of a fix at rest, m/s.
QUIET_SPEED = 0.3
#: Half-second spreads of rate and specific force up to this multiple of the quietest tenth of the record count as quiet.
QUIET_FACTOR = 3.0


def quiet_stretches(
    imu: ImuRecord,
    gnss: GnssRecord | None = None,
    *,
    shortest: float = 2.0,
    bias: tuple[Array, Array] | None = None,
) -> list[Quiet]:
    """Stretches in which the IMU does not stir and no fix moves, each with whether it is a rest.

    Parameters
    ----------
    imu : ImuRecord
    gnss : GnssRecord, optional
        Where it has velocities, faster fixes rule rest out.
    shortest : float
        Shortest stretch, s.
    bias : (value (3,), covariance (3, 3)), optional
        What is known of the gyroscope's bias, rad/s.
    """
    rates = imu.rates()
    n = max(2, round(BLOCK_S / imu.dt))
    count = len(imu) // n
    if count < 4:
        return []
    blocks = rates[: count * n].reshape(count, n, 6)
    spread = blocks.std(axis=1)
    size = np.stack([np.linalg.norm(spread[:, :3], axis=1), np.linalg.norm(spread[:, 3:], axis=1)], axis=1)
    start, end = imu.t[: count * n : n], imu.t[n - 1 : count * n : n]
    fast = _fast(0.5 * (start + end), gnss, QUIET_SPEED)
    slow = size[~fast] if (~fast).sum() >= 4 else size
    still = (size <= QUIET_FACTOR * np.quantile(slow, 0.1, axis=0)).all(axis=1) & ~fast
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(np.int8), [0]]))).reshape(-1, 2)
    found = []
    for a, b in edges:
        if end[b - 1] - start[a] >= shortest:
            stretch = _judged(
                blocks[a:b].mean(axis=1), spread[a:b].mean(axis=0) / np.sqrt(n), float(start[a]), float(end[b - 1])
            )
            if stretch is not None:
                found.append(stretch)
    return _rests_by_rate(found, gnss, bias)


def _fast(t: Array, gnss: GnssRecord | None, speed: float) -> NDArray[np.bool_]:
    """(k,) Whether the fixes about the times ``t`` are faster than ``speed``."""
    if gnss is None or gnss.vel_ned is None:
        return np.zeros(t.size, dtype=bool)
    known = np.isfinite(gnss.vel_ned[:, :2]).all(axis=1)
    if not known.any():
        return np.zeros(t.size, dtype=bool)
    return np.asarray(np.interp(t, gnss.t[known], np.linalg.norm(gnss.vel_ned[known, :2], axis=1)) > speed)


def _judged(means: Array, white: Array, start: float, end: float) -> Quiet | None:
    """A stretch from its block means (k, 6) and what white noise makes of them (6,).

    None where the means wander, the specific force turns, or the rate is beyond any bias.
    """
    k = len(means)
    scatter_of = means.std(axis=0)
    if (scatter_of > np.repeat(STEADY, 3) + 3.0 * white).any():
        return None
    rate, force = means[:, :3].mean(axis=0), means[:, 3:].mean(axis=0)
    size = float(np.linalg.norm(force))
    if float(np.abs(rate).max()) > LARGEST_BIAS or not size > 0.0:
        return None
    down = -force / size
    at = (np.arange(k) - 0.5 * (k - 1)) * (end - start) / k
    slope = at @ (means[:, 3:] - force) / float(at @ at) / size
    left = means[:, 3:] - force - np.outer(at, slope * size)
    noise = float(np.sqrt((left**2).sum() / max(3 * (k - 2), 1))) / size / float(np.sqrt(at @ at))
    turned = float(np.linalg.norm(slope - (slope @ down) * down))
    if turned > DIRECTION_RATE + 3.0 * noise:
        return None
    scatter = float(np.sqrt(np.mean(means[:, :3].var(axis=0, ddof=1)) / k))
    return Quiet(start, end, rate, down, scatter, abs(float(rate @ down)) <= STILL_RATE)


def _rests_by_rate(found: Sequence[Quiet], gnss: GnssRecord | None, bias: tuple[Array, Array] | None) -> list[Quiet]:
    """Quiet stretches, those called rests whose rate about the vertical is a known bias, or that of another stop."""
    out = []
    for q in found:
        still = q.still
        if bias is not None:
            sigma = float(np.sqrt(q.down @ bias[1] @ q.down + q.scatter**2))
            excess = abs(float((q.rate - bias[0]) @ q.down))
            if 3.0 * sigma < STILL_RATE:
                still = excess <= STILL_RATE
        if not still and gnss is not None and gnss.vel_ned is not None:
            for other in found:
                first, last = sorted((q, other), key=lambda s: s.start)
                between = (gnss.t > first.end) & (gnss.t < last.start)
                moved = bool(_fast(gnss.t[between], gnss, MOVED_SPEED).any()) if between.any() else False
                close = float(np.abs(q.rate - other.rate).max()) <= SAME_RATE + 3.0 * float(
                    np.hypot(q.scatter, other.scatter)
                )
                still = still or (moved and close)
        out.append(replace(q, still=still))
    return out


def rests(
    imu: ImuRecord, gnss: GnssRecord | None = None, *, bias: tuple[Array, Array] | None = None, shortest: float = 2.0
) -> list[tuple[float, float]]:
    """When the vehicle stands still, as (start, end) in s; see :func:`quiet_stretches` for the arguments.

    Parameters
    ----------
    imu : ImuRecord
    gnss : GnssRecord, optional
        Where it has velocities, faster fixes rule rest out.
    bias : (value (3,), covariance (3, 3)), optional
        What is known of the gyroscope's bias, rad/s.
    shortest : float
        Shortest rest, s.
    """
    return [(q.start, q.end) for q in quiet_stretches(imu, gnss, shortest=shortest, bias=bias) if q.still]


#: A recording whose fixes stay this close to their median, m, and this slow, m/s, or within their own noise, was made at rest.
REST_RADIUS, REST_SPEED = 3.0, 0.5
#: Fixes that wander no further than this, m, are at rest too where the IMU does not stir.
WANDER = 50.0
#: Means over a second of an IMU that does not stir change by less than this, rad/s and m/s^2, nine times out of ten.
STIR = (0.01, 0.1)


def never_moves(recording: Recording) -> bool:
    """Whether the fixes of a recording say that nothing moved from its first to its last second.

    Parameters
    ----------
    recording : Recording
    """
    gnss = recording.gnss
    if gnss is None:
        return True
    known = np.isfinite(gnss.llh).all(axis=1)
    if not known.any():
        return True
    middle = np.median(gnss.llh[known], axis=0)
    away = earth.position_difference(gnss.llh[known], middle)
    if float(np.max(np.abs(away))) < WANDER and _does_not_stir(recording.imu):
        return True
    noise = 0.0 if gnss.pos_std_ned is None else float(np.nanmax(gnss.pos_std_ned))
    if float(np.max(np.abs(np.median(away[: away.shape[0] // 10 + 1], axis=0)))) > max(REST_RADIUS, noise):
        return False
    if float(np.max(np.abs(away))) > max(REST_RADIUS, 6.0 * noise):
        return False
    if gnss.vel_ned is None:
        return True
    spread = 0.0 if gnss.vel_std_ned is None else float(np.nanmax(gnss.vel_std_ned))
    speeds = np.abs(gnss.vel_ned[np.isfinite(gnss.vel_ned)])
    return not speeds.size or float(speeds.max()) < max(REST_SPEED, 6.0 * spread)


def _does_not_stir(imu: ImuRecord) -> bool:
    """A drift of the IMU's own is slow, a vehicle is not."""
    count = max(1, round(1.0 / imu.dt))
    rows = len(imu) // count * count
    if rows < 10 * count:
        return False
    means = imu.rates()[:rows].reshape(-1, count, 6).mean(axis=1)
    changes = np.quantile(np.abs(np.diff(means, axis=0)), 0.9, axis=0)
    return bool(changes[:3].max() <= STIR[0] and changes[3:].max() <= STIR[1])
