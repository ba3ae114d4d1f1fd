"""Where a filter starts: on a reference, at rest, or on the track of the first motion.

At rest gravity gives the level, and the Earth's rate the heading where the gyroscopes are good enough for it (gyro-compassing). A MEMS gyroscope
does not feel the Earth's rotation: its heading comes from GNSS velocity once the vehicle moves forward, and the gyroscopes carry it back
to the start of the record (Groves 2013, sections 5.6 and 16.2); for that the IMU is turned into vehicle axes by its mounting first.

This is the coarse alignment. The fine one is the filter itself, run through the rest with zero-velocity and zero-rate updates
(:class:`~insemu.filters.ekf.Standstill`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu import earth, rotation
from insemu.errors import InputError
from insemu.filters.options import InitialSigma
from insemu.filters.rest import Quiet, quiet_stretches
from insemu.records import GnssRecord, ImuRecord, Trajectory
from insemu.strapdown import NavState

Array = NDArray[np.float64]

#: Below this speed a track says nothing about the heading, m/s.
TRACK_SPEED = 3.0
#: Standard deviation of roll and pitch at rest: what a bias of the accelerometers of 9 mg does, rad.
REST_TILT = np.deg2rad(0.5)
#: Standard deviation of a recorded velocity that states none, m/s.
UNSTATED_VELOCITY = 0.3
#: Standard deviation of a vertical velocity that is not recorded, m/s (a tenth of 10 m/s up a steep road).
CLIMB = 1.0
#: Where the fixes have no velocities: times to either side, s, over which positions are taken for a parabola.
TRACK_REACH = (1.0, 2.0, 4.0, 8.0)
#: A position is an outlier at the start beyond so many standard deviations, metres and a share of the way between two fixes, all added up: fixes
#: state too little, stamps and velocities lag.
JUMP_SIGMAS, JUMP_LEAST, JUMP_SHARE = 10.0, 3.0, 0.3
#: A heading that is carried back from the first motion to a rest may have become uncertain by this much, rad.
LARGEST_HEADING_SIGMA = np.deg2rad(15.0)

#: A bias this many standard deviations from what is believed contradicts it.
CONTRADICTED = 5.0


@dataclass(frozen=True)
class Alignment:
    """Where and how a filter starts.

    Parameters
    ----------
    t : float
        Time of the start, s; row ``row`` of the IMU record.
    row : int
    state : NavState
    sigma : InitialSigma
    bias, bias_sigma : (6,) arrays
        Biases of gyroscopes and accelerometers and their standard deviations, rad/s and m/s^2; NaN where nothing tells them.
    standstill : tuple of (start, end)
        Intervals at rest, s.
    """

    t: float
    row: int
    state: NavState
    sigma: InitialSigma
    bias: Array
    bias_sigma: Array
    standstill: tuple[tuple[float, float], ...]

    @property
    def known_bias(self) -> tuple[Array, Array] | None:
        """The gyroscope bias and its covariance (3, 3), as :func:`~insemu.filters.rest.rests` takes them; None where nothing told it."""
        if np.isnan(self.bias[:3]).any():
            return None
        return self.bias[:3], np.diag(self.bias_sigma[:3] ** 2)

    def bias_beyond(self, believed: Array | None = None) -> Array:
        """The part of the biases that is subtracted from the data of a filter, (6,), rad/s and m/s^2; zero where nothing tells it.

        A bias that is found to ``s`` and believed to be within ``b`` of zero at the start is most likely the share ``b^2 / (b^2 + s^2)`` of what
        was found: of a sensor that is better than the alignment can see, almost nothing. A bias that contradicts the belief is removed
        wholly.

        Parameters
        ----------
        believed : (6,) array, optional
            Standard deviation of the turn-on bias as the filter believes it, rad/s and m/s^2; where it is NaN or left out the filter knows of
            none, and all of the bias is removed.
        """
        found = np.nan_to_num(self.bias)
        if believed is None:
            return found
        own, total = believed**2, believed**2 + np.nan_to_num(self.bias_sigma) ** 2
        likely = np.abs(found) <= CONTRADICTED * np.sqrt(total)  # not where it is NaN
        return np.asarray(np.where(likely, found * own / np.maximum(total, np.finfo(float).tiny), found))


def level(f_b: ArrayLike) -> tuple[float, float]:
    """Roll and pitch (rad) of a body at rest from its mean specific force (m/s^2) in body axes."""
    fx, fy, fz = np.asarray(f_b, dtype=np.float64)
    return float(np.arctan2(-fy, -fz)), float(np.arctan2(fx, np.hypot(fy, fz)))


def cut(imu: ImuRecord, start: Alignment, believed: Array | None = None) -> ImuRecord:
    """The record from an alignment on, as increments, less the biases found there.

    Parameters
    ----------
    imu : ImuRecord
    start : Alignment
    believed : (6,) array, optional
        As in :meth:`Alignment.bias_beyond`.
    """
    r = imu.as_increments()
    step = np.diff(r.t, prepend=2 * r.t[0] - r.t[1])[:, None]
    off = start.bias_beyond(believed)
    return replace(r, gyro=r.gyro - off[:3] * step, accel=r.accel - off[3:] * step).rows(slice(start.row, None))


#: Standard deviations that are assumed at least where the fixes state none, m and m/s: data tell the noise, not errors that last.
LEAST_POSITION, LEAST_VELOCITY = 0.1, 0.05


def sigma_of_fixes(gnss: GnssRecord) -> GnssRecord:
    """The fixes with standard deviations from their own scatter where they state none.

    Third differences of positions (first of velocities' second) leave noise and the vehicle's jerk; what lasts longer than a few fixes is not
    seen, so that no less than :data:`LEAST_POSITION` and :data:`LEAST_VELOCITY` is taken.
    """

    def scatter(values: Array, least: float) -> Array:
        known = np.isfinite(values)
        present = known.any(axis=0)  # of speed and course no component down
        third = np.diff(values[known[:, present].all(axis=1)][:, present], n=3, axis=0)
        out = np.where(present, 10.0 * least, np.nan)
        if len(third) >= 5:  # 1, 3, 3, 1: variances add up to 20
            out[present] = np.maximum(1.4826 * np.median(np.abs(third), axis=0) / np.sqrt(20.0), least)
        return out

    known = np.isfinite(gnss.llh).all(axis=1)
    place = None
    if gnss.pos_std_ned is None and known.any():
        place = scatter(earth.position_difference(gnss.llh, gnss.llh[known][0]), LEAST_POSITION)
    velocity = None if gnss.vel_ned is None else scatter(np.asarray(gnss.vel_ned), LEAST_VELOCITY)
    return gnss.with_sigma(place, velocity)


def with_standard_deviations(
    gnss: GnssRecord, position: ArrayLike | None = None, velocity: ArrayLike | None = None
) -> tuple[GnssRecord, dict[str, str]]:
    """The fixes with standard deviations: their own, else those that are given, else those of their scatter.

    Parameters
    ----------
    gnss : GnssRecord
    position, velocity : array_like, optional
        Given standard deviations, scalar or north, east, down, m and m/s.

    Returns
    -------
    GnssRecord, dict of str
        The fixes, and what was assumed of ``positions`` and ``velocities``, in words.
    """
    known = gnss.with_sigma(position, velocity)
    out, said = sigma_of_fixes(known), dict[str, str]()
    for name, what, unit in (("pos_std_ned", "positions", "m"), ("vel_std_ned", "velocities", "m/s")):
        if getattr(known, name) is None and (value := getattr(out, name)) is not None:
            parts = {d: v for d, v in zip(("north", "east", "down"), value[0], strict=True) if np.isfinite(v)}
            said[what] = (
                f"the fixes state no standard deviations of their {what}: {', '.join(f'{v:.2g}' for v in parts.values())} {unit} {', '.join(parts)} "
                "are assumed from their scatter"
            )
    return out, said


def align_at_rest(
    imu: ImuRecord, llh: Array, rest: tuple[float, float], *, heading: float | None = None, heading_sigma: float = np.pi
) -> Alignment:
    """Coarse alignment over a rest: level from gravity, heading given or from the Earth's rate.

    Parameters
    ----------
    imu : ImuRecord
    llh : (3,) array
        Position, rad, rad, m.
    rest : (start, end)
        s; the start of the filter is its end.
    heading, heading_sigma : float, optional
        rad; without a heading it is found by gyro-compassing, with a sigma from the scatter of the rates.

    Raises
    ------
    InputError
        Fewer than ten samples in the rest.
    """
    r = imu.as_increments()
    inside = (r.t > rest[0]) & (r.t <= rest[1])
    inside[0] = False
    if inside.sum() < 10:
        raise InputError(
            f"{int(inside.sum())} samples between {rest[0]:g} and {rest[1]:g} s, expected at least 10 at rest"
        )
    rates = r.rates()[inside]
    rate, force = rates[:, :3], rates[:, 3:]
    roll, pitch = level(force.mean(axis=0))
    tenths = rates[: len(rates) // 10 * 10].reshape(10, -1, 6).mean(axis=1).std(axis=0, ddof=1) / np.sqrt(10)
    wander, tilt_noise = tenths[:3], tenths[3:]
    if heading is None:
        leveled = rotation.dcm_from_rpy(np.array([roll, pitch, 0.0])) @ rate.mean(axis=0)
        heading = float(np.arctan2(-leveled[1], leveled[0]))
        heading_sigma = float(min(np.pi, np.linalg.norm(wander) / (earth.RATE * np.cos(llh[0]))))
    rpy = np.array([roll, pitch, heading])
    C = rotation.dcm_from_rpy(rpy)
    bias = rate.mean(axis=0) - C.T @ earth.earth_rate(float(llh[0]))
    tilt = max(float(np.linalg.norm(tilt_noise)) / 9.8, np.deg2rad(0.2))
    row = int(np.flatnonzero(inside)[-1])
    state = NavState(np.asarray(llh, dtype=np.float64), np.zeros(3), rpy)
    sigma = InitialSigma(1.0, 0.05, (tilt, tilt, max(heading_sigma, np.deg2rad(0.2))))
    return Alignment(float(r.t[row]), row, state, sigma, *_of_gyro(bias, wander), (rest,))


def _of_gyro(bias: Array, sigma: Array) -> tuple[Array, Array]:
    """Biases and standard deviations (6,) of an alignment that tells nothing of the accelerometers' (3,)."""
    nothing = np.full(3, np.nan)
    return np.concatenate([bias, nothing]), np.concatenate([sigma, nothing])


@dataclass(frozen=True)
class Track:
    """The motion of the antenna at one fix.

    Parameters
    ----------
    fix : int
        Which fix.
    velocity, slope : (3,) arrays
        North, east, down: m/s, and its change, m/s^2.
    velocity_sigma : (3,) array
    slope_sigma : float
    """

    fix: int
    velocity: Array
    slope: Array
    velocity_sigma: Array
    slope_sigma: float = 0.0

    @property
    def course(self) -> float:
        """Direction of the horizontal velocity, rad."""
        return float(np.arctan2(self.velocity[1], self.velocity[0]))

    @property
    def speed(self) -> float:
        """Horizontal speed, m/s."""
        return float(np.hypot(self.velocity[0], self.velocity[1]))


def first_track(gnss: GnssRecord, inside: NDArray[np.bool_], min_speed: float) -> Track | None:
    """The first fix at which the motion tells a course: of velocities where the record has them, else of a parabola through the positions.

    Parameters
    ----------
    gnss : GnssRecord
        With standard deviations of its positions.
    inside : (n,) array of bool
        Fixes that may be used.
    min_speed : float
        m/s; of positions also ten times what the speed is uncertain by.
    """
    beside = gnss.vel_ned is not None and bool(np.isfinite(gnss.vel_ned[inside, :2]).all(axis=1).any())
    return _of_velocities(gnss, inside, min_speed) if beside else _of_positions(gnss, inside, min_speed)


def _of_velocities(gnss: GnssRecord, inside: NDArray[np.bool_], min_speed: float) -> Track | None:
    assert gnss.vel_ned is not None
    good = inside & np.isfinite(gnss.vel_ned[:, :2]).all(axis=1)
    moving = np.flatnonzero(good & ~_jumps(gnss) & (np.hypot(gnss.vel_ned[:, 0], gnss.vel_ned[:, 1]) > min_speed))
    if not moving.size:
        return None
    k = int(moving[0])
    near = np.flatnonzero(good & (np.abs(gnss.t - gnss.t[k]) < 1.1))
    velocity = np.nan_to_num(gnss.vel_ned)
    slope = np.polyfit(gnss.t[near] - gnss.t[k], velocity[near], 1)[0] if near.size > 1 else np.zeros(3)
    sigma = gnss.vel_std_ned[k] if gnss.vel_std_ned is not None else np.full(3, UNSTATED_VELOCITY)
    return Track(k, velocity[k], slope, np.where(np.isfinite(gnss.vel_ned[k]), sigma, CLIMB))


def _jumps(gnss: GnssRecord) -> NDArray[np.bool_]:
    """Positions (n,) that lie far from both neighbours, carried by the velocities: no place to start."""
    assert gnss.vel_ned is not None and gnss.pos_std_ned is not None
    dt = np.diff(gnss.t)[:, None]
    way = earth.position_difference(gnss.llh[1:], gnss.llh[:-1]) - 0.5 * dt * (gnss.vel_ned[1:] + gnss.vel_ned[:-1])
    sigma = np.hypot(gnss.pos_std_ned[1:], gnss.pos_std_ned[:-1])
    usual = JUMP_SIGMAS * sigma + JUMP_LEAST + JUMP_SHARE * dt * np.abs(gnss.vel_ned[1:])
    far = np.any(np.abs(way) > usual, axis=1)  # no jump where a neighbour is unknown
    out = np.zeros(len(gnss), dtype=bool)
    out[1:-1] = far[:-1] & far[1:]
    return out


def _of_positions(gnss: GnssRecord, inside: NDArray[np.bool_], min_speed: float) -> Track | None:
    """A parabola over the shortest time that tells the course, up to 8 s to either side."""
    assert gnss.pos_std_ned is not None
    for k in np.flatnonzero(inside):
        for reach in TRACK_REACH:
            near = np.flatnonzero(inside & (np.abs(gnss.t - gnss.t[k]) <= reach))
            d = gnss.t[near] - gnss.t[k]
            if near.size < 5 or not d.min() < 0.0 < d.max():
                continue
            A = np.column_stack([np.ones(d.size), d, 0.5 * d * d])
            path = earth.position_difference(gnss.llh[near], gnss.llh[k])
            spread = np.linalg.inv(A.T @ A)
            shape = spread @ A.T @ path
            speed = float(np.hypot(*shape[1, :2]))
            if speed < min_speed:
                continue
            misfit = np.sqrt(np.sum((path - A @ shape) ** 2, axis=0) / max(d.size - 3, 1))
            noise = np.maximum(misfit, gnss.pos_std_ned[k])
            sigma = noise * np.sqrt(spread[1, 1])
            if near.size > 5:  # a way that is no parabola: what a cubic makes of the velocity
                sigma = np.hypot(sigma, np.polynomial.polynomial.polyfit(d, path, 3)[1] - shape[1])
            bend = float(np.max(noise)) * float(np.sqrt(spread[2, 2]))
            if speed < 10.0 * float(np.max(sigma[:2])) or bend > 1.0:
                continue
            return Track(int(k), shape[1], shape[2], sigma, bend)
    return None


#: Least standard deviations of a start that is levelled in motion and headed along the track, rad.
MOTION_TILT, MOTION_HEADING = 0.035, 0.09
#: Least standard deviations of a start on a fix, m and m/s.
FIX_POSITION, FIX_VELOCITY = 0.05, 0.1


def on_reference(imu: ImuRecord, reference: Trajectory) -> tuple[ImuRecord, NavState]:
    """A start on the reference, at its first epoch or that of the IMU: the record from there on, and the state.

    Parameters
    ----------
    imu : ImuRecord
    reference : Trajectory
        Interpolated at the first epoch of the record that it covers.

    Returns
    -------
    imu : ImuRecord
        From the start on.
    state : NavState
        At its first epoch.
    """
    first = int(np.searchsorted(imu.t, max(imu.t[0], reference.t[0])))
    imu = imu.rows(slice(first, None)) if first else imu
    columns = np.hstack([reference.llh, reference.vel_ned, np.unwrap(reference.rpy, axis=0)])
    at = np.array([np.interp(imu.t[0], reference.t, column) for column in columns.T])
    return imu, NavState(at[:3], at[3:6], at[6:])


def on_track(
    imu: ImuRecord, gnss: GnssRecord, track: Track, lever_arm: Array
) -> tuple[ImuRecord, NavState, InitialSigma]:
    """A start on the fixes, levelled by the specific force less the track's acceleration, headed along the track.

    The start is as uncertain as what it comes from; a vehicle that crabs or carries an angle of attack is off by degrees.

    Parameters
    ----------
    imu : ImuRecord
        In vehicle axes.
    gnss : GnssRecord
        With standard deviations of its positions.
    track : Track
        See :func:`first_track`.
    lever_arm : (3,) array
        IMU to antenna, m.

    Returns
    -------
    (ImuRecord, NavState, InitialSigma)
        The record from the start on, the state there, and its standard deviations.
    """
    assert gnss.pos_std_ned is not None
    k = track.fix
    first = int(np.searchsorted(imu.t, gnss.t[k]))
    imu = imu.rows(slice(first, None)) if first else imu
    span = imu.as_increments()
    count = max(2, int(0.5 / imu.dt))
    velocity, slope, heading = track.velocity, track.slope, track.course
    force = span.accel[1:count].mean(axis=0) / imu.dt
    along = float(slope[0] * np.cos(heading) + slope[1] * np.sin(heading))
    across = float(-slope[0] * np.sin(heading) + slope[1] * np.cos(heading))
    g = float(earth.gravity(gnss.llh[k, 0], gnss.llh[k, 2]))
    up = force - np.array([along, across, 0.0])
    roll, pitch = float(np.arctan2(-up[1], -up[2])), float(np.arcsin(np.clip(up[0] / g, -1.0, 1.0)))
    rpy = np.array([roll, pitch, heading])
    late = float(imu.t[0] - gnss.t[k])
    arm = rotation.dcm_from_rpy(rpy) @ lever_arm
    llh = earth.move(gnss.llh[k], velocity * late - arm)
    position = np.hypot(FIX_POSITION, gnss.pos_std_ned[k] + MOTION_HEADING * np.linalg.norm(arm))
    # the velocity of the antenna swings about the IMU's
    swing = float(np.linalg.norm(np.cross(span.gyro[1:count].mean(axis=0) / imu.dt, lever_arm)))
    vel_sigma = np.sqrt(FIX_VELOCITY**2 + track.velocity_sigma**2 + swing**2)
    turn = max(MOTION_HEADING, float(np.max(track.velocity_sigma[:2])) / track.speed)
    tilt = float(np.hypot(MOTION_TILT, track.slope_sigma / g))
    state = NavState(llh, velocity + slope * late, rpy)
    return imu, state, InitialSigma(position, vel_sigma, (tilt, tilt, turn))


def align(
    imu: ImuRecord, gnss: GnssRecord, *, lever_arm: ArrayLike = (0.0, 0.0, 0.0), min_speed: float = TRACK_SPEED
) -> Alignment:
    """Find a start for a filter from raw data of a vehicle that drives forward.

    With a rest before the first motion it is the start of that rest: level and gyroscope bias from it, heading from the first course above
    ``min_speed`` carried back by the gyroscopes. Otherwise it is the first fix above ``min_speed``; see :func:`on_track`.

    Parameters
    ----------
    imu : ImuRecord
        In vehicle axes.
    gnss : GnssRecord
        With velocities, or positions alone.
    lever_arm : (3,)
        IMU to antenna in vehicle axes, m.
    min_speed : float
        Speed from which the course is taken for the heading, m/s.

    Raises
    ------
    InputError
        Never as fast as that, or a rest after which the heading cannot be carried back.
    """
    fixes = sigma_of_fixes(gnss)
    inside = (fixes.t >= imu.t[0]) & (fixes.t <= imu.t[-1]) & np.isfinite(fixes.llh).all(axis=1)
    track = first_track(fixes, inside, min_speed)
    if track is None:
        raise InputError(f"alignment needs a fix faster than {min_speed:g} m/s, and one that tells its course")
    quiet = quiet_stretches(imu, gnss)
    before = [q for q in quiet if q.start < fixes.t[track.fix]]
    still = tuple((q.start, q.end) for q in quiet if q.still)
    if before:
        return _from_rest(imu, fixes, inside, track, before[0], still, np.asarray(lever_arm, dtype=np.float64))
    cut_imu, state, sigma = on_track(imu, fixes, track, np.asarray(lever_arm, dtype=np.float64))
    row = len(imu) - len(cut_imu)
    nothing = np.full(6, np.nan)
    return Alignment(float(imu.t[row]), row, state, sigma, nothing, nothing, still)


def _from_rest(
    imu: ImuRecord,
    gnss: GnssRecord,
    inside: NDArray[np.bool_],
    track: Track,
    quiet: Quiet,
    still: tuple[tuple[float, float], ...],
    lever_arm: Array,
) -> Alignment:
    """A start at rest, its heading the first course less what the gyroscopes turned until then; arguments as in :func:`align`."""
    increments = imu.as_increments()
    coarse = align_at_rest(imu, gnss.llh[track.fix], (quiet.start, quiet.end), heading=0.0)
    roll, pitch, _ = coarse.state.rpy
    row = int(np.searchsorted(imu.t, max(quiet.start, float(gnss.t[inside][0]))))
    end = int(np.searchsorted(imu.t, gnss.t[track.fix]))
    rate = earth.earth_rate(float(gnss.llh[track.fix, 0]))
    mean, covariance = quiet.bias()
    moving_s = float(imu.t[end] - max(imu.t[row], quiet.end)) if quiet.still else float(imu.t[end] - imu.t[row])
    turned = increments.gyro[row + 1 : end + 1].sum(axis=0) - mean * (imu.t[end] - imu.t[row])
    # rate of the heading of a nearly level vehicle: (q sin(roll) + r cos(roll)) / cos(pitch)
    by_heading = np.array([0.0, np.sin(roll), np.cos(roll)]) / np.cos(pitch)
    drift = float(np.sqrt(by_heading @ covariance @ by_heading)) * max(moving_s, 0.0)
    # a course of positions is a mean over seconds in which the vehicle gathers speed and may turn
    caution = 1.0 if gnss.vel_ned is not None else 2.0
    slip = caution * float(np.max(track.velocity_sigma[:2])) / track.speed
    heading_sigma = float(np.sqrt(slip**2 + np.deg2rad(1.0) ** 2 + drift**2))
    if heading_sigma > LARGEST_HEADING_SIGMA:
        raise InputError(
            f"between {quiet.start:g} and {quiet.end:g} s the IMU is quiet and shows {np.rad2deg(quiet.rate @ quiet.down):.2g} deg/s about the "
            "vertical, a steady turn or a bias: the heading cannot be carried back to it (alignment 'motion' does without)"
        )
    heading = track.course - float(by_heading @ turned)
    rpy = np.array([roll, pitch, (heading + np.pi) % (2.0 * np.pi) - np.pi])
    C = rotation.dcm_from_rpy(rpy)
    fix = int(np.flatnonzero(inside & (gnss.t >= imu.t[row] - 1e-9))[0])
    assert gnss.pos_std_ned is not None
    return Alignment(
        float(imu.t[row]),
        row,
        NavState(earth.move(gnss.llh[fix], -C @ lever_arm), np.zeros(3), rpy),
        InitialSigma(np.maximum(gnss.pos_std_ned[fix], 0.05), 0.05, (REST_TILT, REST_TILT, heading_sigma)),
        *_of_gyro(mean - C.T @ rate, np.sqrt(np.diag(covariance))),
        still,
    )
