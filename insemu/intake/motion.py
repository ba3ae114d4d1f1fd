"""What an IMU and fixes say about each other, whatever the mounting, units and clocks: turn, speed-up, time offset.

The rate about the vertical is the rate along the mean specific force; it is held against the change of the course of the fixes. The level part
of the specific force is held against the change of their velocity along and across the track, which gives size and direction (the mounting's
yaw). All are regressions over intervals of about a second, so that they need no start, no filter and no model of noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.records import GnssRecord, ImuRecord, Trajectory

Array = NDArray[np.float64]

#: Interval of the regressions, s; slowest speed whose course is used, m/s; largest time offset that is searched for, s.
STEP, SLOWEST, FARTHEST = 1.0, 2.0, 25.0
#: The rate of turn at a stamp is that over this time before and after it, s: shorter than a turn, longer than vibration.
RATE_S = 0.25
#: An antenna is so far ahead of the IMU or behind it (one standard deviation), m: cars, vans and multirotors.
LEVER = 1.0
#: Most intervals that are used, spread over the record.
MOST = 1500


@dataclass(frozen=True)
class Track:
    """Velocities over the ground at times, a step (s) apart or closer, each the mean over a span (s): 0 of a receiver's own."""

    t: Array
    velocity: Array
    step: float = STEP
    span: float = 0.0


@dataclass(frozen=True)
class Turn:
    """Course of the fixes on the turn of the gyroscope.

    Parameters
    ----------
    slope : float
        Course by gyroscope: 1 where all is right.
    correlation : float
        At the best time offset, with its sign.
    shift : float
        s to add to the stamps of the fixes.
    gain_nats : float
        Log-likelihood of that offset over none.
    arm_nats : float
        The same where an antenna ahead of the IMU, which turns before it does, is allowed for as well.
    intervals : int
        How many were used.
    turned : float
        Root mean square of the turn in an interval, rad.
    """

    slope: float
    correlation: float
    shift: float
    gain_nats: float
    arm_nats: float
    intervals: int
    turned: float

    @property
    def ratio(self) -> float:
        """Slope over its standard error."""
        return _t_ratio(self.correlation, self.intervals)


@dataclass(frozen=True)
class Push:
    """Change of velocity of the fixes on the level specific force: size (1 where all is right), yaw of the mounting (rad), correlation."""

    gain: float
    yaw: float
    correlation: float
    intervals: int

    @property
    def ratio(self) -> float:
        """Gain over its standard error."""
        return _t_ratio(self.correlation, self.intervals)


def _t_ratio(correlation: float, count: int) -> float:
    return float(abs(correlation) * np.sqrt(max(count - 2, 0) / max(1.0 - correlation**2, 1e-12)))


def scatter(gnss: GnssRecord | Trajectory) -> Array:
    """Standard deviation of the white part of the positions (3,), m: third differences hold no smooth motion."""
    good = np.isfinite(gnss.llh).all(axis=1)
    if good.sum() < 9:
        return np.zeros(3)
    offset = earth.position_difference(gnss.llh[good], gnss.llh[good][0])
    third = np.diff(offset, n=3, axis=0)
    return np.asarray(1.4826 * np.median(np.abs(third), axis=0) / np.sqrt(20.0))


def positions_track(gnss: GnssRecord | Trajectory) -> Track:
    """Velocities from differences of positions, so far apart that their scatter hardly turns the course (8 s at most)."""
    good = np.isfinite(gnss.llh).all(axis=1)
    t, llh = gnss.t[good], gnss.llh[good]
    if t.size < 3:
        return Track(np.empty(0), np.empty((0, 3)))
    moved = earth.position_difference(llh[1:], llh[:-1])
    speed = max(float(np.quantile(np.linalg.norm(moved[:, :2], axis=1) / np.diff(t), 0.7)), 0.1)
    step = float(np.clip(60.0 * scatter(gnss)[:2].max() / speed, STEP, 8.0))
    keep = every(t, step)
    t, llh = t[keep], llh[keep]
    dt = np.diff(t)
    close = dt <= max(3.0 * step, 2.5 * float(np.median(dt)) if dt.size else 0.0)
    moved = earth.position_difference(llh[1:], llh[:-1])
    span = float(np.median(dt)) if dt.size else step
    return Track((0.5 * (t[1:] + t[:-1]))[close], (moved / dt[:, None])[close], step, span)


def every(t: Array, step: float) -> NDArray[np.intp]:
    """First row of every step of time, however long the record pauses.

    Parameters
    ----------
    t : (n,) array
        Stamps, s.
    step : float
        s.

    Returns
    -------
    (k,) array of int
    """
    return np.flatnonzero(np.diff(np.floor((t - t[0] + 1e-6) / step), prepend=-1.0) > 0.0)


def velocity_track(gnss: GnssRecord | Trajectory) -> Track | None:
    """Velocities of the receiver; None where it gives none."""
    if gnss.vel_ned is None:
        return None
    good = np.isfinite(gnss.vel_ned[:, :2]).all(axis=1)
    return Track(gnss.t[good], gnss.vel_ned[good]) if good.sum() >= 3 else None


def track_of(gnss: GnssRecord | Trajectory) -> Track:
    """Velocities of the receiver, or of its positions where it gives none."""
    return velocity_track(gnss) or positions_track(gnss)


def up_of(imu: ImuRecord) -> tuple[Array, float]:
    """Mean direction of the specific force in the IMU's axes (up, of a vehicle that stays level), and how steady it is (0 to 1)."""
    count = max(1, round(STEP / imu.dt))
    rows = max(len(imu) // count * count, count)
    means = (
        imu.accel[:rows][: len(imu) // count * count].reshape(-1, count, 3).mean(axis=1)
        if len(imu) >= count
        else imu.accel
    )
    size = np.linalg.norm(means, axis=1)
    units = means[size > 0] / size[size > 0, None]
    mean = units.mean(axis=0) if units.size else np.zeros(3)
    length = float(np.linalg.norm(mean))
    return (mean / length if length > 0 else np.array([0.0, 0.0, -1.0])), length


def _cumulated(imu: ImuRecord) -> tuple[Array, Array]:
    """Integrals of the gyroscope and the accelerometer over time, in the units in which they were declared."""
    dt = np.diff(imu.t, prepend=imu.t[0] - imu.dt)[:, None]
    dt = np.minimum(dt, 10.0 * imu.dt)
    width = 1.0 if imu.kind == "increment" else dt
    return np.cumsum(imu.gyro * width, axis=0), np.cumsum(imu.accel * width, axis=0)


def _at(t: Array, table: Array, when: Array) -> Array:
    return np.column_stack([np.interp(when, t, table[:, k]) for k in range(table.shape[1])])


def _intervals(track: Track, imu: ImuRecord, margin: float) -> NDArray[np.intp]:
    """First rows of pairs of velocities about a step apart, moving, inside the IMU's time by a margin, at most :data:`MOST`."""
    speed = np.hypot(track.velocity[:, 0], track.velocity[:, 1])
    dt = np.diff(track.t)
    good = (speed[1:] > SLOWEST) & (speed[:-1] > SLOWEST) & (dt < 5.0 * track.step)
    good &= (track.t[:-1] > imu.t[0] + margin) & (track.t[1:] < imu.t[-1] - margin)
    rows = np.flatnonzero(good)
    return rows if rows.size <= MOST else rows[:: -(-rows.size // MOST)]


def thinned(track: Track) -> Track:
    """The track at about one velocity per step."""
    if track.t.size < 2:
        return track
    keep = every(track.t, track.step)
    return replace(track, t=track.t[keep], velocity=track.velocity[keep])


def turn_of(imu: ImuRecord, track: Track) -> Turn | None:
    """Hold the turn of the fixes' course against the gyroscope; None without enough of it."""
    track = thinned(track)
    margin = min(FARTHEST, 0.2 * (imu.t[-1] - imu.t[0]))
    rows = _intervals(track, imu, 0.0)
    if rows.size < 8:
        return None
    course = np.arctan2(track.velocity[:, 1], track.velocity[:, 0])
    change = (np.diff(course)[rows] + np.pi) % (2.0 * np.pi) - np.pi
    up, _ = up_of(imu)
    angle = -_cumulated(imu)[0] @ up  # clockwise from above, as the course
    start, end = track.t[:-1][rows], track.t[1:][rows]

    speed = np.hypot(track.velocity[:, 0], track.velocity[:, 1])
    weight = np.minimum(np.minimum(speed[1:], speed[:-1])[rows], 10.0 * SLOWEST)  # the course of slow fixes is noise

    def parts(shift: float) -> tuple[Array, Array]:
        inside = (start + shift >= imu.t[0]) & (end + shift <= imu.t[-1])
        if inside.sum() < max(8, 0.6 * rows.size):
            return np.zeros(rows.size), np.zeros(rows.size)
        x = np.interp(end + shift, imu.t, angle) - np.interp(start + shift, imu.t, angle)
        return x * inside * weight, inside * weight

    def lever(when: Array, speed: Array) -> Array:
        """Course of an antenna 1 m ahead of the IMU against that of the IMU, rad."""
        return np.asarray(
            (np.interp(when + RATE_S, imu.t, angle) - np.interp(when - RATE_S, imu.t, angle)) / (2.0 * RATE_S * speed)
        )

    def unexplained(shift: float, keep: NDArray[np.bool_], spread: float) -> float:
        """Sum of squares that the turn, a drift and a lever arm of :data:`LEVER` leave."""
        x, w = parts(shift)
        arm = lever(end + shift, speed[1:][rows]) - lever(start + shift, speed[:-1][rows])
        table = np.column_stack([x, (end - start) * w, arm * w])[keep & (w > 0)]
        y = np.append((change * w)[keep & (w > 0)], 0.0)
        table = np.vstack([table, [0.0, 0.0, spread / LEVER]])
        return float(np.sum((y - table @ np.linalg.lstsq(table, y, rcond=None)[0]) ** 2))

    def fit(shift: float) -> tuple[float, float, NDArray[np.bool_]]:
        x, w = parts(shift)
        return _slope(x, change * w, (end - start) * w, w > 0)

    coarse = np.arange(-margin, margin + 1e-9, 0.25)
    best = float(coarse[int(np.argmax([abs(fit(s)[1]) for s in coarse]))])
    fine = np.arange(best - 0.25, best + 0.25 + 1e-9, 0.02)
    found = [fit(s) for s in fine]
    k = int(np.argmax([abs(f[1]) for f in found]))
    slope, correlation, keep = found[k]
    # without an offset, on the same intervals: those that the offset leaves out count as well, for they may be what speaks against it
    both = [parts(at) for at in (0.0, float(fine[k]))]
    same = (both[0][1] > 0) & (both[1][1] > 0)
    without, with_it = (_partial(x, change * w, (end - start) * w, same)[1] for x, w in both)
    gain = 0.5 * same.sum() * np.log(max(1e-12, 1.0 - without**2) / max(1e-12, 1.0 - with_it**2))
    count = int(keep.sum())
    x, w = parts(float(fine[k]))
    spread = float(np.std((change * w - slope * x)[keep]))
    near = float(fine[k]) + np.arange(-1.0, 1.0 + 1e-9, 0.1)  # an arm moves the best offset
    smallest = min(unexplained(float(shift), keep, spread) for shift in near)
    beside = 0.5 * count * np.log(max(unexplained(0.0, keep, spread), 1e-300) / max(smallest, 1e-300))
    turned = float(np.sqrt(np.mean(change**2)))
    return Turn(slope, correlation, float(fine[k]), float(gain), float(beside), count, turned)


def turns(imu: ImuRecord, track: Track, shift: float) -> tuple[Array, Array, Array]:
    """Changes of course (n,) and the integrals of the rates over the same intervals (n, 3), both times the speed, m/s; the intervals, s times m/s.

    Parameters
    ----------
    imu : ImuRecord
    track : Track
    shift : float
        s to add to the track's stamps.
    """
    track = thinned(track)
    rows = _intervals(track, imu, abs(shift) + 0.1)
    course = np.arctan2(track.velocity[:, 1], track.velocity[:, 0])
    change = (np.diff(course)[rows] + np.pi) % (2.0 * np.pi) - np.pi
    sums, when = _cumulated(imu)[0], track.t + shift
    angle = np.diff(_at(imu.t, sums, when), axis=0)[rows]
    speed = np.hypot(track.velocity[:, 0], track.velocity[:, 1])
    weight = np.minimum(np.minimum(speed[1:], speed[:-1])[rows], 10.0 * SLOWEST)
    return change * weight, angle * weight[:, None], np.diff(track.t)[rows] * weight


def _partial(x: Array, y: Array, other: Array, keep: NDArray[np.bool_]) -> tuple[float, float]:
    """Slope of y on x and their correlation, beside another regressor."""
    x, y, other = x[keep], y[keep], other[keep]
    power = float(other @ other)
    if power > 0.0:
        x, y = x - other * (other @ x) / power, y - other * (other @ y) / power
    xx, yy = float(x @ x), float(y @ y)
    if xx <= 0.0 or yy <= 0.0:
        return 0.0, 0.0
    return float(x @ y) / xx, float(x @ y) / float(np.sqrt(xx * yy))


def _median(values: Array) -> float:
    """The median of a few hundred finite numbers, of which ``np.median`` spends most of its time on checks."""
    low, high = (values.size - 1) // 2, values.size // 2
    part = np.partition(values, (low, high))
    return 0.5 * float(part[low] + part[high])


def _slope(x: Array, y: Array, other: Array, keep: NDArray[np.bool_]) -> tuple[float, float, NDArray[np.bool_]]:
    """Slope of y on x beside another regressor and their correlation, the worst rows left out; and the rows that were used."""
    slope = correlation = 0.0
    for _ in range(3):
        if keep.sum() < 8:
            return 0.0, 0.0, keep
        slope, correlation = _partial(x, y, other, keep)
        rest = y - slope * x
        power = float(other[keep] @ other[keep])
        rest = rest - other * (float(other[keep] @ rest[keep]) / power if power > 0.0 else 0.0)
        spread = 1.4826 * _median(np.abs(rest[keep]))
        wider = (np.abs(rest) <= max(4.0 * spread, 1e-9)) & (other != 0.0)
        if wider.sum() < 0.7 * keep.sum():
            break
        keep = wider
    return slope, correlation, keep


def push_of(imu: ImuRecord, track: Track, shift: float = 0.0) -> Push | None:
    """Hold the level specific force against the change of velocity; None without enough of it.

    Parameters
    ----------
    imu : ImuRecord
    track : Track
    shift : float
        s to add to the track's stamps.
    """
    track = thinned(track)
    track = replace(track, t=track.t + shift)
    rows = _intervals(track, imu, 0.0)
    if rows.size < 8:
        return None
    up, _ = up_of(imu)
    forward = np.cross(up, [0.0, 1.0, 0.0] if abs(up[1]) < 0.9 else [0.0, 0.0, 1.0])
    # level axes nearest the sensor's own x: forward = x without its vertical part where that is long enough
    if abs(up[0]) < 0.9:
        forward = np.array([1.0, 0.0, 0.0]) - up[0] * up
    forward = forward / np.linalg.norm(forward)
    right = np.cross(-up, forward)
    sums = _at(imu.t, _cumulated(imu)[1], track.t)
    dt = np.diff(track.t)[rows]
    force = (np.diff(sums, axis=0)[rows]) / dt[:, None]
    z = force @ forward + 1j * (force @ right)
    v = track.velocity
    speed = np.hypot(v[:, 0], v[:, 1])
    course = np.arctan2(v[:, 1], v[:, 0])
    turning = (np.diff(course)[rows] + np.pi) % (2.0 * np.pi) - np.pi
    middle = 0.5 * (speed[1:] + speed[:-1])[rows]
    a = np.diff(speed)[rows] / dt + 1j * middle * turning / dt
    keep = np.ones(a.size, dtype=bool)
    correlation, factor = 0.0, 0j
    for _ in range(3):
        zc, ac = z[keep] - z[keep].mean(), a[keep] - a[keep].mean()
        power = float(np.vdot(zc, zc).real)
        if power <= 0.0 or keep.sum() < 8:
            return None
        factor = np.vdot(zc, ac) / power
        correlation = float(abs(np.vdot(zc, ac)) / np.sqrt(power * max(float(np.vdot(ac, ac).real), 1e-300)))
        residual = np.abs(a - a[keep].mean() - factor * (z - z[keep].mean()))
        keep = residual <= max(4.0 * float(np.median(residual[keep])), 1e-9)
    return Push(float(abs(factor)), float(np.angle(factor)), correlation, int(keep.sum()))
