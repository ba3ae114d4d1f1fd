"""Error signals of an IMU in motion: what it recorded less what a better one recorded on the same mount (Stebler et al. 2014, section VI).

Time offset, mounting and the distance between the two are found by least squares on means of :data:`BLOCK` seconds, with the biases as
unknowns that are not removed: shift the reference's integrals in time, turn them, add what the lever arm sees. The difference is then taken at
the unit's own rate. It holds the reference's errors, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu import rotation
from insemu.errors import InputError
from insemu.lost import FILLED_IN, filled, restored, width_at_rest
from insemu.records import ImuRecord

Array = NDArray[np.float64]

#: Length of the means that are compared, s: longer than most vibration, shorter than a vehicle's turns.
BLOCK = 0.1
#: Shortest common record, s, and parts of it that are estimated one by one for the standard deviations.
SHORTEST, PARTS = 60.0, 10
#: Largest standard deviations of the time offset (samples) and of the mounting (rad) of which a difference is made.
OFFSET_SIGMA, MOUNTING_SIGMA = 0.5, 0.02
#: Correlation of the two turn rates below which the recordings are not of one motion.
LEAST_CORRELATION = 0.5
_STEPS = 8


@dataclass(frozen=True)
class Differenced:
    """Errors of a unit against a reference.

    Parameters
    ----------
    t : (n,) array
        Stamps of the unit that the reference covers, s.
    values : (n, 6) array
        Unit less reference, rad/s and m/s^2, axes of the unit.
    rate_hz : float
        Of the unit.
    offset_s : float
        Seconds that the stamps of the unit are late against the reference's.
    rpy : (3,) array
        Roll, pitch, yaw of the unit with respect to the reference, rad.
    lever_arm : (3,) array
        From the reference to the unit, in axes of the reference, m.
    sigma : (7,) array
        Standard deviations of the time offset, the three angles of a small turn, the lever arm.
    correlation : float
        Of the magnitudes of the two turn rates at that offset.
    said : tuple of str
        What was done with lost samples.
    """

    t: Array
    values: Array
    rate_hz: float
    offset_s: float
    rpy: Array
    lever_arm: Array
    sigma: Array
    correlation: float
    said: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Fit:
    offset: float
    turn: Array
    arm: Array


class _Reference:
    """Integrals of a reference as splines, and what they say of any interval."""

    def __init__(self, imu: ImuRecord) -> None:
        record = imu.as_increments()
        integral = np.cumsum(np.hstack([record.gyro, record.accel]), axis=0)
        self.first, self.last = float(imu.t[0]), float(imu.t[-1])
        self.integral = scipy.interpolate.CubicSpline(imu.t, integral - integral[0])

    def means(self, start: Array, end: Array) -> tuple[Array, Array, Array]:
        """Mean rate and force over intervals, mean angular acceleration; (n, 3) each."""
        width = (end - start)[:, None]
        mean = (self.integral(end) - self.integral(start)) / width
        turned = (self.integral(end, 1)[:, :3] - self.integral(start, 1)[:, :3]) / width
        return mean[:, :3], mean[:, 3:], turned

    def seen(self, fit: _Fit, start: Array, end: Array) -> Array:
        """What a perfect unit would show over intervals of its own clock, (n, 6)."""
        rate, force, turned = self.means(start - fit.offset, end - fit.offset)
        force = force + np.cross(turned, fit.arm) + np.cross(rate, np.cross(rate, fit.arm))
        return np.hstack([rate @ fit.turn.T, force @ fit.turn.T])


def difference(unit: ImuRecord, reference: ImuRecord, *, search_s: float = 10.0) -> Differenced:
    """Error signals of a unit under dynamics, from a reference on the same rigid mount; lost samples of both are filled in.

    Parameters
    ----------
    unit, reference : ImuRecord
        Of any kind and rate; overlapping in time to within ``search_s``, with enough turns to see the mounting.
    search_s : float
        Largest time offset that is searched for, s.

    Returns
    -------
    Differenced

    Raises
    ------
    InputError
        Gaps, too short, no common motion, or a motion that does not tell time offset or mounting.
    """
    unit, lost = restored(unit)
    reference, skipped = restored(reference)
    for name, imu in (("unit", unit), ("reference", reference)):
        gaps = imu.gaps(1.5 * imu.dt)
        if gaps:
            raise InputError(
                f"the {name} has {len(gaps)} gap(s), the first of {gaps[0][1]:.3g} s at {gaps[0][0]:.6g} s"
            )
    source = _Reference(reference)
    inside = _covered(unit, source, 0.0)
    start, correlation = _coarse(unit.rows(inside), source, search_s)
    inside = _covered(unit, source, abs(start) + 2.0 * BLOCK)
    blocks = _blocks(unit.rows(inside))
    fit = _solve(source, *blocks, _Fit(start, _attitude(source, *blocks, start), np.zeros(3)))
    sigma = _scatter(source, *blocks, fit)
    if sigma[0] > OFFSET_SIGMA * unit.dt or sigma[1:4].max() > MOUNTING_SIGMA:
        raise InputError(
            f"the motion tells the time offset to {1e3 * sigma[0]:.2g} ms and the mounting to {np.degrees(sigma[1:4].max()):.2g} deg (1 sigma), "
            f"expected {1e3 * OFFSET_SIGMA * unit.dt:.2g} ms and {np.degrees(MOUNTING_SIGMA):.2g} deg: more turns about all axes"
        )
    inside = _covered(unit, source, 0.0, fit.offset)
    used, gone = unit.rows(inside), np.any([each.rows[inside] for each in lost] or np.zeros((1, inside.sum())), axis=0)
    values = used.rates() - source.seen(fit, used.t - unit.dt, used.t)
    return Differenced(
        used.t,
        filled(values[~gone], gone, width_at_rest(unit.dt)),  # errors hold no motion
        1.0 / unit.dt,
        fit.offset,
        rotation.rpy_from_dcm(fit.turn.T),
        fit.arm,
        sigma,
        correlation,
        tuple(
            f"{name}: {x.said}: they {FILLED_IN}" for name, of in (("unit", lost), ("reference", skipped)) for x in of
        ),
    )


def _covered(unit: ImuRecord, source: _Reference, margin: float, offset: float = 0.0) -> NDArray[np.bool_]:
    t = unit.t - offset
    inside = np.asarray((t - unit.dt >= source.first + margin) & (t <= source.last - margin))
    if inside.sum() * unit.dt < SHORTEST:
        raise InputError(
            f"unit and reference have {inside.sum() * unit.dt:.4g} s in common, expected {SHORTEST:g} s at least"
        )
    return inside


def _blocks(unit: ImuRecord) -> tuple[Array, Array, Array]:
    """Means of the unit over blocks (n, 6), with their starts and ends."""
    size = max(1, round(BLOCK / unit.dt))
    count = len(unit) // size
    values = unit.rates()[: count * size].reshape(count, size, 6).mean(axis=1)
    end = unit.t[size - 1 : count * size : size]
    return end - size * unit.dt, end, values


def _coarse(unit: ImuRecord, source: _Reference, search_s: float) -> tuple[float, float]:
    """Time offset at which the magnitudes of the turn rates correlate best, to the unit's interval, and that correlation."""
    from scipy.signal import correlate

    own = np.linalg.norm(unit.rates()[:, :3], axis=1)
    at = np.arange(len(unit)) * unit.dt + unit.t[0]
    other = np.linalg.norm(source.means(at - unit.dt, at)[0], axis=1)
    own, other = own - own.mean(), other - other.mean()
    scale = float(np.linalg.norm(own) * np.linalg.norm(other))
    if scale == 0.0:
        raise InputError("one of the two recordings does not turn; expected the same motion in both")
    far = min(int(search_s / unit.dt), len(unit) // 2)
    middle = len(unit) - 1
    product = correlate(own, other, method="fft")[middle - far : middle + far + 1]
    best = int(np.argmax(product))
    found = float(product[best]) / scale
    if found < LEAST_CORRELATION:
        raise InputError(
            f"the turn rates of unit and reference correlate by {found:.2f} at best, expected {LEAST_CORRELATION:g} at least: one motion within "
            f"{search_s:g} s"
        )
    return (best - far) * unit.dt, found


def _attitude(source: _Reference, start: Array, end: Array, values: Array, offset: float) -> Array:
    """Turn from the reference's axes to the unit's, by the singular vectors of the products of both."""
    rate, force, _ = source.means(start - offset, end - offset)
    total = np.zeros((3, 3))
    for theirs, own in ((rate, values[:, :3]), (force, values[:, 3:])):
        total += own.T @ theirs / float(np.linalg.norm(own) * np.linalg.norm(theirs))
    u, _, v = np.linalg.svd(total)
    return np.asarray(u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v)


def _solve(source: _Reference, start: Array, end: Array, values: Array, fit: _Fit) -> _Fit:
    """Gauss-Newton steps for offset, turn, arm and six biases; the triads weighed by what is left of them."""
    step_s = 0.1 * BLOCK
    for _ in range(_STEPS):
        seen = source.seen(fit, start, end)
        left = values - seen
        left = left - left.mean(axis=0)
        weights = np.repeat([1.0 / max(float(left[:, k : k + 3].std()), 1e-12) for k in (0, 3)], 3)
        later, sooner = (
            source.seen(_Fit(fit.offset + s, fit.turn, fit.arm), start, end) for s in (0.5 * step_s, -0.5 * step_s)
        )
        columns = [(later - sooner) / step_s]
        for k in range(3):  # a small turn of what is seen
            axis = np.eye(3)[k]
            columns.append(np.hstack([np.cross(axis, seen[:, :3]), np.cross(axis, seen[:, 3:])]))
        for k in range(3):
            columns.append(source.seen(_Fit(fit.offset, fit.turn, fit.arm + np.eye(3)[k]), start, end) - seen)
        design = np.stack([(c - c.mean(axis=0)) * weights for c in columns], axis=-1).reshape(-1, 7)
        move = np.linalg.lstsq(design, (left * weights).ravel(), rcond=1e-9)[0]
        turn = rotation.dcm_from_vector(move[1:4]) @ fit.turn
        fit = _Fit(fit.offset + float(move[0]), turn, fit.arm + move[4:])
        if np.abs(move).max() < 1e-9:
            break
    return fit


def _scatter(source: _Reference, start: Array, end: Array, values: Array, fit: _Fit) -> Array:
    """Standard deviations (7,) from the same estimate with each part of the record left out (the jackknife)."""
    part = np.arange(len(start)) * PARTS // len(start)
    moves = []
    for k in range(PARTS):
        keep = part != k
        one = _solve(source, start[keep], end[keep], values[keep], fit)
        small = rotation.vector_from_dcm(one.turn @ fit.turn.T)
        moves.append(np.concatenate([[one.offset], small, one.arm]))
    spread = np.array(moves)
    return np.asarray(np.sqrt((PARTS - 1) * np.var(spread, axis=0)))
