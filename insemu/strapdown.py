"""Strapdown mechanization in the local NED frame, and the dynamics of its errors.

The navigation state of one epoch is a plain array ``nav`` of :data:`NAV_SIZE` numbers, so that compiled loops (this
module's, the filter's, the emulator's) share one :func:`step`::

    nav[0:3]   latitude rad, longitude rad, ellipsoidal height m
    nav[3:6]   velocity with respect to the Earth, north, east, down, m/s
    nav[6:10]  quaternion of C_nb, scalar part first

Per step: two-sample coning and sculling correction from the previous increment (Savage 1998; Groves 2013, section
5.5), the exact rotation term of the velocity increment, Earth rate, transport rate, Coriolis acceleration and gravity
at the middle of the step, and the trapezoid of the velocities for the position.

Errors are estimate minus truth: position in metres north, east, down by the radii at the place, velocity, and the
rotation vector phi with ``C_est = (I + [phi x]) C_true``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu import earth, rotation
from insemu.compiled import njit
from insemu.earth import E2, RATE, scalar_gravity, scalar_gravity_slopes, scalar_radii
from insemu.errors import InputError
from insemu.lanes import any_of, where
from insemu.records import ImuRecord, Trajectory
from insemu.rotation import scalar_half_trig, scalar_wrapped

Array = NDArray[np.float64]

#: Length of a navigation state.
NAV_SIZE = 10


@njit(cache=True, nogil=True)
def scalar_coning_factor(dt: float, dt_prev: float) -> float:
    """Factor of ``dtheta_prev x dtheta``: rate and specific force linear in time over both intervals, 1/12 where they
    are equal.

    Zero after an interval less than a fifth as long: a line through a short interval says nothing about a long one
    (dropped samples).
    """
    ratio = dt / dt_prev
    if ratio > 5.0:
        return 0.0
    return ratio * ratio / (6.0 * (1.0 + ratio))


@njit(cache=True, nogil=True)
def step(
    nav: Array,
    dtheta: Array,
    dvel: Array,
    dtheta_prev: Array,
    dvel_prev: Array,
    dt: float,
    dt_prev: float,
    gravity: int,
) -> None:
    """Advance a navigation state by one IMU interval, in place (compiled; call it from compiled loops).

    Parameters
    ----------
    nav : (10,) array
        State at the start of the interval, overwritten by the state at its end; see the module for the layout. Three more
        numbers, where there are, keep what rounding left of latitude, longitude and height (the place is the sum): the last
        digit of a latitude is 0.7 nm, too coarse where two implementations are to agree in every digit that matters.
    dtheta, dvel : (3,) arrays
        Integrals of angular rate (with respect to inertial space, rad) and specific force (m/s) in body axes over the
        interval, without any coning or sculling correction.
    dtheta_prev, dvel_prev : (3,) arrays
        The same over the interval before. For the first interval pass ``dtheta`` and ``dvel`` themselves: the
        correction then vanishes.
    dt, dt_prev : float
        Durations of the two intervals, s.
    gravity : int
        One of :data:`insemu.earth.GRAVITY_CODES`.
    """
    lat, lon, h = nav[0], nav[1], nav[2]
    vn, ve, vd = nav[3], nav[4], nav[5]
    qw, qx, qy, qz = nav[6], nav[7], nav[8], nav[9]
    ax, ay, az = dtheta[0], dtheta[1], dtheta[2]
    ux, uy, uz = dvel[0], dvel[1], dvel[2]
    px, py, pz = dtheta_prev[0], dtheta_prev[1], dtheta_prev[2]
    wx, wy, wz = dvel_prev[0], dvel_prev[1], dvel_prev[2]

    c = scalar_coning_factor(dt, dt_prev)
    fx = ax + c * (py * az - pz * ay)
    fy = ay + c * (pz * ax - px * az)
    fz = az + c * (px * ay - py * ax)

    # the Earth at the middle of the interval (the predicted place is good to micrometres)
    h_mid = h - 0.5 * vd * dt
    d = 0.5 * vn * dt / (6.37e6 + h)
    s0, c0 = math.sin(lat), math.cos(lat)
    sl = s0 + d * (c0 - 0.5 * d * s0)
    cl = c0 - d * (s0 + 0.5 * d * c0)
    rm, rn = scalar_radii(sl)
    im, ie = 1.0 / (rm + h_mid), 1.0 / (rn + h_mid)
    tan = sl / cl
    g = scalar_gravity(sl, h_mid, gravity)
    en, ed = RATE * cl, -RATE * sl
    tn, te = ve * ie, -vn * im
    td = -tn * tan

    # rotation of the body with respect to NED: with it a vehicle at rest stays at rest exactly, whatever the step
    zx, zy, zz = (en + tn) * dt, te * dt, (ed + td) * dt
    tx, ty, tz = zy * qz - zz * qy + qw * zx, zz * qx - zx * qz + qw * zy, zx * qy - zy * qx + qw * zz
    rx = ax - (zx + 2.0 * (ty * qz - tz * qy))
    ry = ay - (zy + 2.0 * (tz * qx - tx * qz))
    rz = az - (zz + 2.0 * (tx * qy - ty * qx))

    # velocity increment in the body axes of the start of the interval
    a2 = rx * rx + ry * ry + rz * rz
    k1 = 0.5 - a2 * (1.0 / 24.0 - a2 * (1.0 / 720.0 - a2 * (1.0 / 40320.0 - a2 / 3628800.0)))
    k2 = 1.0 / 6.0 - a2 * (1.0 / 120.0 - a2 * (1.0 / 5040.0 - a2 * (1.0 / 362880.0 - a2 / 39916800.0)))
    if any_of(a2 >= 0.02):
        large = max(a2, 0.02)
        angle = math.sqrt(large)
        k1 = where(a2 >= 0.02, (1.0 - math.cos(angle)) / large, k1)
        k2 = where(a2 >= 0.02, (angle - math.sin(angle)) / (large * angle), k2)
    xx, xy, xz = ry * uz - rz * uy, rz * ux - rx * uz, rx * uy - ry * ux
    sx = ux + k1 * xx + k2 * (ry * xz - rz * xy) + c * (py * uz - pz * uy + wy * az - wz * ay)
    sy = uy + k1 * xy + k2 * (rz * xx - rx * xz) + c * (pz * ux - px * uz + wz * ax - wx * az)
    sz = uz + k1 * xz + k2 * (rx * xy - ry * xx) + c * (px * uy - py * ux + wx * ay - wy * ax)

    # to NED by the attitude at the start: s + 2 q_v x (q_v x s + w s)
    tx = qy * sz - qz * sy + qw * sx
    ty = qz * sx - qx * sz + qw * sy
    tz = qx * sy - qy * sx + qw * sz
    gx = sx + 2.0 * (qy * tz - qz * ty)
    gy = sy + 2.0 * (qz * tx - qx * tz)
    gz = sz + 2.0 * (qx * ty - qy * tx)

    # velocity at the middle: half of an explicit step
    on, oe, od = 2.0 * en + tn, te, 2.0 * ed + td
    vn_mid = vn + 0.5 * (gx - dt * (oe * vd - od * ve))
    ve_mid = ve + 0.5 * (gy - dt * (od * vn - on * vd))
    vd_mid = vd + 0.5 * (gz + dt * (g - (on * ve - oe * vn)))
    tn, te = ve_mid * ie, -vn_mid * im
    td = -tn * tan
    on, oe, od = 2.0 * en + tn, te, 2.0 * ed + td
    zx, zy, zz = (en + tn) * dt, te * dt, (ed + td) * dt  # rotation of the NED frame

    vn1 = vn + gx - dt * (oe * vd_mid - od * ve_mid)
    ve1 = ve + gy - dt * (od * vn_mid - on * vd_mid)
    vd1 = vd + gz - dt * (on * ve_mid - oe * vn_mid) + g * dt

    dlat, dlon, dh = 0.5 * dt * (vn + vn1) * im, 0.5 * dt * (ve + ve1) * ie / cl, -0.5 * dt * (vd + vd1)
    if nav.size > NAV_SIZE:
        dlat, dlon, dh = dlat + nav[10], dlon + nav[11], dh + nav[12]
    lat1, lon1, h1 = lat + dlat, lon + dlon, h + dh
    if nav.size > NAV_SIZE:
        nav[10], nav[11], nav[12] = dlat - (lat1 - lat), dlon - (lon1 - lon), dh - (h1 - h)
    nav[0] = lat1
    nav[1] = scalar_wrapped(lon1)
    nav[2] = h1
    nav[3], nav[4], nav[5] = vn1, ve1, vd1

    # q <- exp(-zeta) q exp(phi) = q exp(-zeta_b) exp(phi). The two small rotations meet first: at rest they cancel
    # and the attitude stays as it is to the last bit, while rounding of two large products would drift the same way
    # at every step
    tx, ty, tz = zy * qz - zz * qy + qw * zx, zz * qx - zx * qz + qw * zy, zx * qy - zy * qx + qw * zz
    ex = zx + 2.0 * (ty * qz - tz * qy)
    ey = zy + 2.0 * (tz * qx - tx * qz)
    ez = zz + 2.0 * (tx * qy - ty * qx)
    cw, cs = scalar_half_trig(fx * fx + fy * fy + fz * fz)
    bx, by, bz = cs * fx, cs * fy, cs * fz
    zw, zs = scalar_half_trig(ex * ex + ey * ey + ez * ez)
    ex, ey, ez = zs * ex, zs * ey, zs * ez
    dx = zw * bx - cw * ex - (ey * bz - ez * by)
    dy = zw * by - cw * ey - (ez * bx - ex * bz)
    dz = zw * bz - cw * ez - (ex * by - ey * bx)
    dw = zw * cw + ex * bx + ey * by + ez * bz
    less = -(dx * dx + dy * dy + dz * dz) / (1.0 + dw)  # dw - 1 without cancellation
    rw = qw + (qw * less - qx * dx - qy * dy - qz * dz)
    rx = qx + (qw * dx + qx * less + qy * dz - qz * dy)
    ry = qy + (qw * dy - qx * dz + qy * less + qz * dx)
    rz = qz + (qw * dz + qx * dy - qy * dx + qz * less)
    short = 0.5 * (1.0 - (rw * rw + rx * rx + ry * ry + rz * rz))  # one Newton step to unit length
    if any_of(abs(short) > 1e-15):
        short = where(abs(short) > 1e-15, short, 0.0)
        rw, rx, ry, rz = rw + short * rw, rx + short * rx, ry + short * ry, rz + short * rz
    nav[6], nav[7], nav[8], nav[9] = rw, rx, ry, rz


@njit(cache=True, nogil=True)
def correct(nav: Array, error: Array) -> None:
    """Take an estimated error off a navigation state, in place (compiled): ``nav <- nav - error``.

    Parameters
    ----------
    nav : (10,) array
        Navigation state.
    error : (n >= 9,) array
        Position error (metres north, east, down), velocity error, attitude error phi (estimate minus truth).
    """
    rm, rn = scalar_radii(math.sin(nav[0]))
    h = nav[2]
    nav[1] -= error[1] / ((rn + h) * math.cos(nav[0]))
    nav[0] -= error[0] / (rm + h)
    nav[2] += error[2]
    nav[3] -= error[3]
    nav[4] -= error[4]
    nav[5] -= error[5]
    # C_true = exp(-[phi x]) C_est
    px, py, pz = error[6], error[7], error[8]
    cw, cs = scalar_half_trig(px * px + py * py + pz * pz)
    bx, by, bz = -cs * px, -cs * py, -cs * pz
    w, x, y, z = nav[6], nav[7], nav[8], nav[9]
    nav[6] = cw * w - bx * x - by * y - bz * z
    nav[7] = cw * x + bx * w + by * z - bz * y
    nav[8] = cw * y - bx * z + by * w + bz * x
    nav[9] = cw * z + bx * y - by * x + bz * w


@njit(cache=True, nogil=True)
def fill_dynamics(nav: Array, f_n: Array, gravity: int, f: Array) -> None:
    """Write the continuous dynamics of the nine navigation errors into ``f`` (9, 9) (compiled).

    ``x' = F x`` for x = (position error in metres north, east, down; velocity error; phi); the errors of the sensors
    enter as ``v' += C_nb df`` and ``phi' += C_nb dw``.

    Parameters
    ----------
    nav : (10,) array
        Navigation state to linearise about.
    f_n : (3,) array
        Specific force in NED, m/s^2.
    gravity : int
        One of :data:`insemu.earth.GRAVITY_CODES`.
    f : (9, 9) array
        Overwritten.
    """
    f[:, :] = 0.0
    h, vn, ve, vd = nav[2], nav[3], nav[4], nav[5]
    sl, cl = math.sin(nav[0]), math.cos(nav[0])
    rm, rn = scalar_radii(sl)
    x = 1.0 - E2 * sl * sl
    rm_lat, rn_lat = 3.0 * rm * E2 * sl * cl / x, rn * E2 * sl * cl / x
    m, e = 1.0 / (rm + h), 1.0 / (rn + h)
    tan = sl / cl

    # position: derivatives of the metres themselves, so the moving radii appear
    f[0, 3] = 1.0
    f[0, 0] = -vd * m
    f[0, 2] = vn * m
    f[1, 4] = 1.0
    slope = rn_lat * cl - sl / e  # of (R_N + h) cos(lat) with latitude
    f[1, 1] = (slope * vn * m - cl * vd) * e / cl
    f[1, 0] = -ve * slope * e / cl * m
    f[1, 2] = ve * e
    f[2, 5] = 1.0

    # derivatives of the Earth rate and the transport rate with the errors, columns (N m, D m, v_N, v_E)
    en_n, ed_n = -RATE * sl * m, -RATE * cl * m
    tn, te = ve * e, -vn * m
    td = -tn * tan
    tn_n, tn_d, tn_ve = -tn * e * rn_lat * m, tn * e, e
    te_n, te_d, te_vn = -te * m * rm_lat * m, te * m, -m
    td_n, td_d, td_ve = -tn_n * tan - tn / (cl * cl) * m, -tn_d * tan, -e * tan

    # velocity: -[f_n x] phi + gravity - (2 w_ie + w_en) x v
    f[3, 7], f[3, 8] = f_n[2], -f_n[1]
    f[4, 6], f[4, 8] = -f_n[2], f_n[0]
    f[5, 6], f[5, 7] = f_n[1], -f_n[0]
    on, oe, od = 2.0 * RATE * cl + tn, te, -2.0 * RATE * sl + td
    f[3, 4], f[3, 5] = od, -oe
    f[4, 3], f[4, 5] = -od, on
    f[5, 3], f[5, 4] = oe, -on
    dn, dd = 2.0 * en_n + tn_n, 2.0 * ed_n + td_n
    f[3, 0], f[4, 0], f[5, 0] = dd * ve - te_n * vd, dn * vd - dd * vn, te_n * vn - dn * ve
    f[3, 2], f[4, 2], f[5, 2] = td_d * ve - te_d * vd, tn_d * vd - td_d * vn, te_d * vn - tn_d * ve
    f[3, 3], f[5, 3] = -te_vn * vd, f[5, 3] + te_vn * vn
    f[3, 4], f[4, 4], f[5, 4] = f[3, 4] + td_ve * ve, tn_ve * vd - td_ve * vn, f[5, 4] - tn_ve * ve
    g_lat, g_h = scalar_gravity_slopes(sl, cl, h, gravity)
    f[5, 0] += g_lat * m
    f[5, 2] -= g_h

    # attitude: -w_in x phi - dw_in
    wn, we, wd = RATE * cl + tn, te, -RATE * sl + td
    f[6, 7], f[6, 8] = wd, -we
    f[7, 6], f[7, 8] = -wd, wn
    f[8, 6], f[8, 7] = we, -wn
    f[6, 0], f[7, 0], f[8, 0] = -en_n - tn_n, -te_n, -ed_n - td_n
    f[6, 2], f[7, 2], f[8, 2] = -tn_d, -te_d, -td_d
    f[7, 3] = -te_vn
    f[6, 4], f[8, 4] = -tn_ve, -td_ve


@njit(cache=True, nogil=True)
def fill_transition(f: Array, dt: float, phi: Array) -> None:
    """Write ``I + F dt + (F dt)^2 / 2`` into ``phi`` (9, 9) (compiled): the transition of the errors over one step.

    Parameters
    ----------
    f : (n, n) array
        Continuous dynamics, of :func:`fill_dynamics` with n = 9.
    dt : float
        Duration of the step, s.
    phi : (n, n) array
        Overwritten.
    """
    n = f.shape[0]
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                if f[i, k] != 0.0:
                    total += f[i, k] * f[k, j]
            phi[i, j] = f[i, j] * dt + 0.5 * dt * dt * total
        phi[i, i] += 1.0


@njit(cache=True, nogil=True)
def _run(t: Array, gyro: Array, accel: Array, nav: Array, gravity: int, hold_vertical: bool, out: Array) -> None:
    n = t.size
    out[0] = nav
    h0, vd0 = nav[2], nav[5]
    turn, push, turn_before, push_before = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for k in range(1, n):
        previous = max(k - 1, 1)
        turn[:], push[:], turn_before[:], push_before[:] = gyro[k], accel[k], gyro[previous], accel[previous]
        dt = t[k] - t[k - 1]
        dt_prev = t[previous] - t[previous - 1]
        step(nav, turn, push, turn_before, push_before, dt, dt_prev, gravity)
        if hold_vertical:
            nav[2], nav[5] = h0, vd0
        out[k] = nav


@dataclass(frozen=True)
class NavState:
    """Position, velocity and attitude at one epoch.

    Parameters
    ----------
    llh : (3,) array
        Latitude rad, longitude rad, ellipsoidal height m.
    vel_ned : (3,) array
        m/s.
    rpy : (3,) array
        Roll, pitch, heading, rad.
    """

    llh: Array
    vel_ned: Array
    rpy: Array

    @classmethod
    def of(cls, trajectory: Trajectory, index: int = 0) -> NavState:
        """State of a trajectory at one of its rows."""
        return cls(trajectory.llh[index], trajectory.vel_ned[index], trajectory.rpy[index])

    def to_array(self) -> Array:
        """As the (10,) array that :func:`step` advances."""
        return np.concatenate([self.llh, self.vel_ned, rotation.quaternion_from_rpy(self.rpy)]).astype(np.float64)


def mechanize_array(
    imu: ImuRecord,
    initial: NavState | Trajectory | ArrayLike,
    *,
    gravity: str = "normal",
    vertical: Literal["free", "held"] = "free",
) -> Array:
    """Navigate an IMU record; as :func:`mechanize`, but return the (n, 10) navigation states.

    Parameters
    ----------
    imu : ImuRecord
        Of any kind.
    initial : NavState, Trajectory or (10,) array_like
        State at ``imu.t[0]``: of a trajectory its first row, of an array in the layout of this module.
    gravity : {"normal", "free_air_first_order"}
        See :mod:`insemu.earth`.
    vertical : {"free", "held"}
        As :func:`mechanize`.

    Returns
    -------
    (n, 10) array
        One row per IMU row, in the layout of this module.

    Raises
    ------
    InputError
        As :func:`mechanize`; an initial state of another shape.
    """
    if len(imu) < 2:
        raise InputError(f"the IMU record has {len(imu)} row(s), expected at least two")
    if vertical not in ("free", "held"):
        raise InputError(f"vertical is '{vertical}', expected 'free' or 'held'")
    record = imu.as_increments()
    if isinstance(initial, Trajectory):
        initial = NavState.of(initial)
    nav = initial.to_array() if isinstance(initial, NavState) else np.array(initial, dtype=np.float64)
    if nav.shape != (NAV_SIZE,):
        raise InputError(f"the initial state has shape {nav.shape}, expected ({NAV_SIZE},)")
    if not abs(nav[0]) < np.deg2rad(89.9):
        raise InputError(
            f"the initial latitude is {np.rad2deg(nav[0]):.6g} deg, expected one within 89.9 deg of the equator"
        )
    out = np.empty((len(record), NAV_SIZE))
    _run(record.t, record.gyro, record.accel, nav, earth.gravity_code(gravity), vertical == "held", out)
    if not np.isfinite(out[-1]).all():
        raise InputError("navigation diverged (the states are not finite); is the IMU record in rad/s and m/s^2?")
    return out


def trajectory_of(t: ArrayLike, nav: Array, name: str = "navigation") -> Trajectory:
    """Turn (n, 10) navigation states into a :class:`~insemu.records.Trajectory`.

    Parameters
    ----------
    t : (n,) array_like
        Times, s.
    nav : (n, 10) array
        Navigation states in the layout of this module.
    name : str
        Of the trajectory.
    """
    return Trajectory(
        np.asarray(t, dtype=float), nav[:, 0:3], nav[:, 3:6], rotation.rpy_from_quaternion(nav[:, 6:10]), name
    )


def mechanize(
    imu: ImuRecord,
    initial: NavState | Trajectory,
    *,
    gravity: str = "normal",
    vertical: Literal["free", "held"] = "free",
) -> Trajectory:
    """Navigate an IMU record from an initial state (dead reckoning).

    Parameters
    ----------
    imu : ImuRecord
        Any kind; means and samples are first turned into increments
        (:meth:`~insemu.records.ImuRecord.as_increments`). The step from row k-1 to row k uses ``t[k] - t[k-1]``.
    initial : NavState or Trajectory
        State at ``imu.t[0]``; of a trajectory its first row.
    gravity : {"normal", "free_air_first_order"}
        See :mod:`insemu.earth`.
    vertical : {"free", "held"}
        ``held`` keeps height and vertical velocity at their initial values (the free vertical channel is unstable).

    Returns
    -------
    Trajectory
        One row per IMU row.

    Raises
    ------
    InputError
        Fewer than two rows, an unknown option, a place at a pole, or states that overflow.
    """
    nav = mechanize_array(imu, initial, gravity=gravity, vertical=vertical)
    return trajectory_of(imu.t, nav, "dead reckoning")


def error_dynamics(state: NavState | ArrayLike, f_n: ArrayLike, *, gravity: str = "normal") -> Array:
    """Continuous dynamics ``F`` (9, 9) of the navigation errors; see :func:`fill_dynamics`.

    Parameters
    ----------
    state : NavState or (10,) array
        State to linearise about.
    f_n : (3,) array_like
        Specific force in NED, m/s^2.
    gravity : {"normal", "free_air_first_order"}
        See :mod:`insemu.earth`.
    """
    nav = state.to_array() if isinstance(state, NavState) else np.array(state, dtype=np.float64)
    f = np.empty((9, 9))
    fill_dynamics(nav, np.array(f_n, dtype=np.float64), earth.gravity_code(gravity), f)
    return f


def transition(f: ArrayLike, dt: float) -> Array:
    """Discrete transition of the errors over ``dt`` seconds to second order; see :func:`fill_transition`."""
    f = np.array(f, dtype=np.float64)
    phi = np.empty_like(f)
    fill_transition(f, float(dt), phi)
    return phi


def navigation_errors(estimate: Array, truth: Array) -> Array:
    """Errors (n, 9) of (n, 10) navigation states: position in metres NED, velocity, phi (estimate minus truth)."""
    position = earth.position_difference(estimate[:, 0:3], truth[:, 0:3])
    phi = rotation.vector_from_quaternion(
        rotation.quaternion_product(estimate[:, 6:10], rotation.quaternion_conjugate(truth[:, 6:10]))
    )
    return np.concatenate([position, estimate[:, 3:6] - truth[:, 3:6], phi], axis=1)
