"""GNSS fixes along a trajectory: antenna, noise, outages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu import earth, rotation
from insemu.effects import LONGEST_ARM, EffectUse, FixErrors, Signals
from insemu.emulate.table import SAMPLE_BYTES, check_size
from insemu.errors import InputError
from insemu.records import GnssRecord, Trajectory

Array = NDArray[np.float64]
#: Most random outages of a flight.
MOST_OUTAGES = 1e5
#: Times at which a trajectory is interpolated at a time.
_AT_A_TIME = 1 << 14


@dataclass(frozen=True)
class Outage:
    """No fixes for ``start_s < t <= start_s + duration_s``; a duration of zero is no outage. Of raw observations some may be left.

    Parameters
    ----------
    start_s, duration_s : float
    satellites : int, optional
        So many are left at most, the highest.
    elevation : float, optional
        Those above it are left, rad.
    sectors : sequence of (from, to, elevation)
        Between two azimuths, from the first clockwise to the second, those above an elevation, rad: the houses of a street.
    """

    start_s: float
    duration_s: float
    satellites: int | None = None
    elevation: float | None = None
    sectors: tuple[tuple[float, float, float], ...] = ()

    def __post_init__(self) -> None:
        if self.satellites is not None and self.satellites < 0:
            raise InputError(f"an outage leaves {self.satellites} satellites, expected none or more")
        if not (np.isfinite(self.start_s) and np.isfinite(self.duration_s) and self.duration_s >= 0):
            raise InputError(
                f"outage from {self.start_s} s for {self.duration_s} s: expected finite numbers and no negative duration"
            )

    @property
    def total(self) -> bool:
        """Whether it leaves no observation."""
        return not self.satellites and self.elevation is None and not self.sectors

    def horizon(self, azimuth: ArrayLike) -> Array:
        """Lowest elevation of what is left at azimuths of any shape, rad."""
        out = np.full(np.shape(azimuth), -np.pi if self.elevation is None else self.elevation)
        for first, last, height in self.sectors:
            inside = np.mod(np.asarray(azimuth) - first, 2.0 * np.pi) <= np.mod(last - first, 2.0 * np.pi)
            out = np.where(inside, np.maximum(out, height), out)
        return out

    @property
    def end_s(self) -> float:
        """Time of the last fix that is missing, at the latest."""
        return self.start_s + self.duration_s

    def covers(self, t: ArrayLike) -> NDArray[np.bool_]:
        """Which times lie in the outage."""
        t = np.asarray(t, dtype=float)
        # a microsecond of slack: fix times are sums of rounded periods
        return np.asarray((t > self.start_s + 1e-6) & (t <= self.end_s + 1e-6))


@dataclass(frozen=True)
class AreaOutage:
    """No fixes within a circle on the ground: a tunnel, a wood, a street between high houses.

    Parameters
    ----------
    latitude, longitude : float
        Centre, rad.
    radius : float
        m.
    """

    latitude: float
    longitude: float
    radius: float

    def __post_init__(self) -> None:
        if not (np.isfinite([self.latitude, self.longitude, self.radius]).all() and self.radius >= 0):
            raise InputError("an outage area needs a finite place and a radius of zero or more")
        if abs(self.latitude) > np.pi / 2:
            raise InputError(f"an outage area has a latitude of {np.rad2deg(self.latitude):g} deg")

    def covers(self, llh: ArrayLike) -> NDArray[np.bool_]:
        """Which positions (n, 3) lie in the area."""
        difference = earth.position_difference(llh, np.array([self.latitude, self.longitude, 0.0]))
        return np.asarray(np.hypot(difference[..., 0], difference[..., 1]) < self.radius)


def random_outages(
    start_s: float, end_s: float, *, per_hour: float, mean_s: float, rng: np.random.Generator, clear_s: float = 0.0
) -> tuple[Outage, ...]:
    """Draw outages: Poisson starts, exponential durations, none in the first ``clear_s`` seconds; those that touch
    are joined.

    Parameters
    ----------
    start_s, end_s : float
        Span of the trajectory, s.
    per_hour : float
        Mean number per hour.
    mean_s : float
        Mean duration, s.
    rng : numpy.random.Generator
        Its seed belongs to the scenario, so all designs and realizations meet the same outages.
    clear_s : float
        Time without outages at the start.
    """
    if not (per_hour >= 0 and mean_s > 0 and end_s > start_s and clear_s >= 0):
        raise InputError("random outages need a rate of zero or more, a positive mean duration and a span")
    span = max(0.0, end_s - start_s - clear_s)
    if per_hour * span / 3600.0 > MOST_OUTAGES:
        raise InputError(f"{per_hour:g} outages per hour over {span:g} s are more than {MOST_OUTAGES:g}")
    count = rng.poisson(per_hour * span / 3600.0)
    begins = np.sort(start_s + clear_s + span * rng.random(count))
    lengths = rng.exponential(mean_s, count)
    out: list[Outage] = []
    for begin, length in zip(begins, lengths, strict=True):
        end = min(begin + length, end_s)
        if out and begin <= out[-1].end_s:
            out[-1] = Outage(out[-1].start_s, max(end, out[-1].end_s) - out[-1].start_s)
        else:
            out.append(Outage(float(begin), float(end - begin)))
    return tuple(out)


def state_at(trajectory: Trajectory, t: ArrayLike) -> tuple[Array, Array, Array, Array]:
    """Position, velocity, quaternion and ``w_nb_b`` of a trajectory at times between its nodes.

    Cubic Hermite interpolation of the position, quadratic of the velocity that belongs to it, rotation at constant
    rate of the attitude; at a node the node itself.

    Returns
    -------
    llh (n, 3), vel_ned (n, 3), q (n, 4), w_nb_b (n, 3)
    """
    t, last = np.asarray(t, dtype=float), len(trajectory) - 1
    k = np.clip(np.searchsorted(trajectory.t, t + 1e-9, side="right") - 1, 0, last - 1)
    parts = []
    for first in range(0, max(t.size, 1), _AT_A_TIME):
        own = slice(first, first + _AT_A_TIME)
        # what these times look at; of no time at all two nodes
        near = np.unique(np.append((k[own, None] + np.arange(-1, 3)).clip(0, last), [0, 1]))
        parts.append(_between(trajectory.rows(near), t[own], np.searchsorted(near, k[own])))
    llh, v, q, w = (np.concatenate(found) for found in zip(*parts, strict=True))
    return llh, v, q, w


def _between(trajectory: Trajectory, t: Array, k: NDArray[np.intp]) -> tuple[Array, Array, Array, Array]:
    """The states at times (n,) after nodes (n,); of the nodes that do not follow each other nothing is used."""
    nodes = trajectory.t
    dt = nodes[k + 1] - nodes[k]
    u = np.clip((t - nodes[k]) / dt, 0.0, 1.0)
    u = np.where(np.abs(u) * dt < 1e-9, 0.0, np.where(np.abs(1.0 - u) * dt < 1e-9, 1.0, u))[:, None]
    h = dt[:, None]
    v0, v1 = trajectory.vel_ned[k], trajectory.vel_ned[k + 1]
    p1 = earth.position_difference(trajectory.llh[k + 1], trajectory.llh[k])
    # metres by the radii at node k; the velocities are metres at the place itself, which differs by 1e-7 of the step
    p = p1 * u**2 * (3 - 2 * u) + h * (v0 * u * (1 - u) ** 2 - v1 * u**2 * (1 - u))
    llh = earth.move(trajectory.llh[k], p)
    v = p1 / h * 6 * u * (1 - u) + v0 * (1 - u) * (1 - 3 * u) + v1 * u * (3 * u - 2)
    at_end = u[:, 0] == 1.0
    llh[at_end], v[at_end] = trajectory.llh[k[at_end] + 1], v1[at_end]

    # rates at a node are those of the intervals next to it
    last = nodes.size - 2
    before, after = np.maximum(k - 1, 0), np.minimum(k + 1, last)
    needed = np.zeros(nodes.size, dtype=bool)
    for row in (before, k, after):
        needed[row] = needed[row + 1] = True
    at, q = np.cumsum(needed) - 1, rotation.quaternion_from_rpy(trajectory.rpy[needed])
    turn = rotation.vector_from_quaternion(rotation.quaternion_product(rotation.quaternion_conjugate(q[:-1]), q[1:]))
    rate = turn / np.diff(nodes[needed])[:, None]
    here = rate[at[k]]
    attitude = rotation.quaternion_product(q[at[k]], rotation.quaternion_from_vector(u * turn[at[k]]))
    w = 0.5 * (rate[at[before]] + here) * (1 - u) + 0.5 * (here + rate[at[after]]) * u
    return llh, v, attitude, w


def antenna(trajectory: Trajectory, t: ArrayLike, lever_arm: ArrayLike) -> tuple[Array, Array]:
    """True motion of an antenna.

    Parameters
    ----------
    trajectory : Trajectory
        Of the IMU.
    t : (n,) array
        s.
    lever_arm : (3,) or (n, 3) array
        From the IMU to the antenna in body axes, m.

    Returns
    -------
    llh (n, 3) rad, rad, m and vel_ned (n, 3) m/s
    """
    llh, vel, q, w_nb = state_at(trajectory, t)
    arm = np.asarray(lever_arm, dtype=float)
    if not arm.any():
        return llh, vel
    c = rotation.dcm_from_quaternion(q)
    w_eb = w_nb + np.einsum("nji,nj->ni", c, earth.transport_rate(llh, vel))
    beside = c @ arm if arm.ndim == 1 else np.einsum("nij,nj->ni", c, arm)
    return earth.move(llh, beside), vel + np.einsum("nij,nj->ni", c, np.cross(w_eb, arm))


def _three(value: ArrayLike, name: str, *, without_down: bool = False) -> Array:
    array = np.broadcast_to(np.asarray(value, dtype=float), (3,)).copy()
    if not np.isfinite(array[: 2 if without_down and np.isnan(array[2]) else 3]).all():
        raise InputError(f"{name} is {array.tolist()}, expected one or three finite numbers")
    return array


def gnss_fixes(
    trajectory: Trajectory,
    rate_hz: float = 1.0,
    pos_sigma_ned: ArrayLike = (0.01, 0.01, 0.02),
    vel_sigma_ned: ArrayLike | None = (0.01, 0.01, 0.02),
    lever_arm: ArrayLike = (0.0, 0.0, 0.0),
    outages: Sequence[Outage | AreaOutage] = (),
    *,
    rng: np.random.Generator,
    effects: Sequence[EffectUse] = (),
) -> GnssRecord:
    """Emulate the fixes of a receiver.

    Parameters
    ----------
    trajectory : Trajectory
        Reference of the IMU (its nodes).
    rate_hz : float
        Fixes per second; the first comes one period after the start of the trajectory.
    pos_sigma_ned, vel_sigma_ned : float or (3,)
        Standard deviations of white noise, m and m/s, which the receiver also states; ``vel_sigma_ned=None`` for no
        velocity, NaN down for speed and course.
    lever_arm : (3,)
        From the IMU to the antenna in body axes, m.
    outages : sequence of Outage or AreaOutage
        When, or where, there is no fix.
    rng : numpy.random.Generator
        Position, velocity and every effect draw from their own children, for all epochs, so an outage does not change
        the fixes outside of it and an effect added at the end does not change the others.
    effects : sequence of EffectUse
        Those of the sensor ``gnss`` act; the others are passed over.

    Raises
    ------
    InputError
        Negative sigma, a rate that is not positive, an outage past the end of the trajectory, outages that leave no
        fix.
    """
    sigma = _three(pos_sigma_ned, "the position sigma")
    sigma_v = None if vel_sigma_ned is None else _three(vel_sigma_ned, "the velocity sigma", without_down=True)
    for name, values in (("position", sigma), ("velocity", sigma_v)):
        if values is not None and (values < 0).any():
            raise InputError(f"the {name} sigma is {values.tolist()}, expected zero or more")
    t = fix_times(trajectory, rate_hz)
    for outage in outages:
        if isinstance(outage, Outage):
            check_outage(outage, trajectory)
    arm = _three(lever_arm, "the lever arm")
    if np.linalg.norm(arm) > LONGEST_ARM:
        raise InputError(
            f"a lever arm of {np.linalg.norm(arm):.4g} m is implausible, expected metres, at most {LONGEST_ARM:g} m"
        )
    fixes, place, keep = _fixes(trajectory, t, sigma, sigma_v, arm, rng, effects)
    for outage in outages:
        keep = keep & ~(outage.covers(t) if isinstance(outage, Outage) else outage.covers(place))
    if not keep.any():
        raise InputError("the outages leave no fix at all")
    return fixes.rows(keep)


def fixes_at(
    trajectory: Trajectory,
    t: Array,
    pos_sigma_ned: Array,
    vel_sigma_ned: Array | None,
    lever_arm: ArrayLike,
    *,
    rng: np.random.Generator,
    effects: Sequence[EffectUse] = (),
) -> GnssRecord:
    """Emulate fixes at given times, as :func:`gnss_fixes` does at a rate; those before or after the trajectory are left out.

    Parameters
    ----------
    trajectory : Trajectory
        Reference of the IMU.
    t : (n,) array
        Stamps, s.
    pos_sigma_ned, vel_sigma_ned : (n, 3) or (3,) arrays
        Standard deviations of white noise, m and m/s, of every fix or of all; no velocity: None.
    lever_arm : (3,)
        From the IMU to the antenna in body axes, m.
    rng : numpy.random.Generator
    effects : sequence of EffectUse
        Those of the sensor ``gnss`` act.
    """
    arm = _three(lever_arm, "the lever arm")
    fixes, _, inside = _fixes(trajectory, np.asarray(t, dtype=float), pos_sigma_ned, vel_sigma_ned, arm, rng, effects)
    return fixes.rows(inside)


def _fixes(
    trajectory: Trajectory,
    t: Array,
    sigma: Array,
    sigma_v: Array | None,
    arm: Array,
    rng: np.random.Generator,
    effects: Sequence[EffectUse],
) -> tuple[GnssRecord, Array, NDArray[np.bool_]]:
    """Fixes at times (n,), true places of the antenna, and which of them lie on the trajectory."""
    of_position, of_velocity = rng.spawn(2)
    own = [use for use in effects if use.sensor == "gnss"]

    def signals() -> Signals:
        _, vel, q, rate = state_at(trajectory, np.clip(t, trajectory.t[0], trajectory.t[-1]))
        return Signals(t, vel, rotation.rpy_from_dcm(rotation.dcm_from_quaternion(q)), rate)

    errors = FixErrors(t, sigma, sigma_v, of_position, of_velocity, signals)
    for use, child in zip(own, rng.spawn(len(own)), strict=True):
        use.effect.inject_fixes(errors, use, child)
    valid = t - errors.latency
    keep = (valid >= trajectory.t[0] - 1e-9) & (valid <= trajectory.t[-1] + 1e-9)
    inside = np.clip(valid, trajectory.t[0], trajectory.t[-1])
    place, vel = antenna(trajectory, inside, arm + errors.arm_at(inside))
    if errors.velocity_lag or errors.velocity_window:
        vel = _lagging(trajectory, valid - errors.velocity_lag, errors.velocity_window, arm, errors)
    tau, error = errors.velocity_tau, errors.position()
    if tau.any():
        smooth = _filtered(trajectory, valid - errors.velocity_lag, tau, arm, errors)
        vel = np.where(tau > 0.0, smooth, vel)
    if errors.position_tau.any():
        error = error - _filtered(trajectory, valid, errors.position_tau, arm, errors, behind=True)
    llh, stated = earth.move(place, error), errors.stated()
    if sigma_v is None:
        return GnssRecord(t, llh, None, stated), place, keep
    return GnssRecord(t, llh, vel + errors.velocity(), stated, errors.stated_velocity()), place, keep


def _filtered(
    trajectory: Trajectory, t: Array, tau: Array, arm: Array, errors: FixErrors, behind: bool = False
) -> Array:
    """Velocities (n, 3) of the antenna at times (n,) behind a low-pass of first order with time constants (3,) in s; zero where that is zero.

    Or what the positions of a critically damped tracker of these time constants are ``behind``, m: the time constant times the low-pass of
    what the velocity is ahead of its own.
    """
    steps = len(trajectory) - 1
    fine = np.linspace(trajectory.t[0], trajectory.t[-1], steps + 1)
    vel, out = antenna(trajectory, fine, arm + errors.arm_at(fine))[1], np.zeros((t.size, 3))
    for k in np.flatnonzero(tau > 0.0):
        b, a = scipy.signal.bilinear([1.0], [tau[k], 1.0], steps / (fine[-1] - fine[0]))
        slow, _ = scipy.signal.lfilter(b, a, vel[:, k], zi=scipy.signal.lfilter_zi(b, a) * vel[0, k])
        if behind:
            slow = tau[k] * scipy.signal.lfilter(b, a, vel[:, k] - slow)
        out[:, k] = np.interp(t, fine, slow)
    return out


def _lagging(trajectory: Trajectory, middle: Array, window: float, arm: Array, errors: FixErrors) -> Array:
    """Velocities (n, 3) of the antenna at times (n,), or their means over a window in s about these: the way over it, divided by it."""
    inside = np.clip(middle, trajectory.t[0], trajectory.t[-1])
    arm = arm + errors.arm_at(inside)
    if window == 0.0:
        return antenna(trajectory, inside, arm)[1]
    first, last = (np.clip(middle + s * 0.5 * window, trajectory.t[0], trajectory.t[-1]) for s in (-1.0, 1.0))
    way = earth.position_difference(antenna(trajectory, last, arm)[0], antenna(trajectory, first, arm)[0])
    return np.asarray(way / np.maximum(last - first, 1e-9)[:, None])


def fix_times(trajectory: Trajectory, rate_hz: float) -> Array:
    """Epochs of the fixes: ``t[0] + k / rate_hz`` for k = 1, 2, ..., up to the end."""
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise InputError(f"the GNSS rate is {rate_hz} Hz, expected a positive number")
    check_size((trajectory.t[-1] - trajectory.t[0]) * rate_hz, SAMPLE_BYTES, f"fixes at {rate_hz:g} Hz")
    count = int(np.floor((trajectory.t[-1] - trajectory.t[0]) * rate_hz + 1e-6))
    if count < 1:
        raise InputError(f"a trajectory of {trajectory.t[-1] - trajectory.t[0]:g} s has no fix at {rate_hz:g} Hz")
    return np.asarray(np.minimum(trajectory.t[0] + np.arange(1, count + 1) / rate_hz, trajectory.t[-1]))


def check_outage(outage: Outage, trajectory: Trajectory) -> None:
    """Raise ``InputError`` where an outage does not lie inside a trajectory."""
    if outage.start_s < trajectory.t[0] - 1e-6 or outage.end_s > trajectory.t[-1] + 1e-6:
        raise InputError(
            f"the outage from {outage.start_s:g} to {outage.end_s:g} s is not inside the trajectory "
            f"({trajectory.t[0]:g} to {trajectory.t[-1]:g} s)"
        )
