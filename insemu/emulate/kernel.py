"""Compiled loops of the emulator: the inverse of the mechanization step."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.earth import RATE, scalar_gravity
from insemu.strapdown import scalar_coning_factor, step

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def _solve3(m: Array, b: Array, x: Array) -> None:
    """Solve a well-conditioned 3 x 3 system by cofactors."""
    c0 = m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]
    c1 = m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2]
    c2 = m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]
    inverse = 1.0 / (m[0, 0] * c0 + m[0, 1] * c1 + m[0, 2] * c2)
    b0, b1, b2 = b[0] * inverse, b[1] * inverse, b[2] * inverse
    x[0] = c0 * b0 + (m[0, 2] * m[2, 1] - m[0, 1] * m[2, 2]) * b1 + (m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]) * b2
    x[1] = c1 * b0 + (m[0, 0] * m[2, 2] - m[0, 2] * m[2, 0]) * b1 + (m[0, 2] * m[1, 0] - m[0, 0] * m[1, 2]) * b2
    x[2] = c2 * b0 + (m[0, 1] * m[2, 0] - m[0, 0] * m[2, 1]) * b1 + (m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]) * b2


@njit(cache=True, nogil=True)
def _to_body(q: Array, x: float, y: float, z: float, out: Array) -> None:
    """Rotate a vector by the inverse of the quaternion at the end of ``q`` (a navigation state)."""
    qw, qx, qy, qz = q[6], q[7], q[8], q[9]
    tx = y * qz - z * qy + qw * x
    ty = z * qx - x * qz + qw * y
    tz = x * qy - y * qx + qw * z
    out[0] = x + 2.0 * (ty * qz - tz * qy)
    out[1] = y + 2.0 * (tz * qx - tx * qz)
    out[2] = z + 2.0 * (tx * qy - ty * qx)


@njit(cache=True, nogil=True)
def _rotation_to(a: Array, b: Array, zx: float, zy: float, zz: float, out: Array) -> None:
    """Rotation vector, in the body axes of ``a``, from the attitude of ``a`` to that of ``b`` (quaternions at 6:10).

    ``zeta`` is the small rotation of the NED frame meanwhile.
    """
    # r = exp(zeta) q_b to second order: exact to rounding for |zeta| below 1e-5
    hx, hy, hz = 0.5 * zx, 0.5 * zy, 0.5 * zz
    hw = 1.0 - 0.5 * (hx * hx + hy * hy + hz * hz)
    bw, bx, by, bz = b[6], b[7], b[8], b[9]
    rw = hw * bw - hx * bx - hy * by - hz * bz
    rx = hw * bx + hx * bw + hy * bz - hz * by
    ry = hw * by - hx * bz + hy * bw + hz * bx
    rz = hw * bz + hx * by - hy * bx + hz * bw
    aw, ax, ay, az = a[6], -a[7], -a[8], -a[9]
    dw = aw * rw - ax * rx - ay * ry - az * rz
    dx = aw * rx + ax * rw + ay * rz - az * ry
    dy = aw * ry - ax * rz + ay * rw + az * rx
    dz = aw * rz + ax * ry - ay * rx + az * rw
    if dw < 0.0:
        dw, dx, dy, dz = -dw, -dx, -dy, -dz
    s2 = dx * dx + dy * dy + dz * dz
    if s2 < 1e-4:
        factor = 2.0 + s2 * (1.0 / 3.0 + s2 * (3.0 / 20.0 + s2 * (5.0 / 56.0 + s2 * 35.0 / 576.0)))  # 2 asin(s) / s
    else:
        s = math.sqrt(s2)
        factor = 2.0 * math.atan2(s, dw) / s
    out[0], out[1], out[2] = factor * dx, factor * dy, factor * dz


@njit(cache=True, nogil=True)
def invert(
    t: Array, target: Array, gravity: int, passes: int, gyro: Array, accel: Array, nav: Array, begin: int
) -> None:
    """Find the increments that the mechanization turns into given velocities and attitudes.

    Deadbeat: every interval starts from the state that the mechanization itself has reached with the increments found
    so far, so rounding never accumulates and ``nav`` is what the mechanization returns for these increments, to the
    last bit.

    Parameters
    ----------
    t : (n,) array
        Times, s.
    target : (n, 10) array
        Navigation states asked for; of rows 1.. only velocity and attitude count.
    gravity : int
        One of :data:`insemu.earth.GRAVITY_CODES`.
    passes : int
        Corrections by the step itself after the analytic guess.
    gyro, accel : (n, 3) arrays
        Increments, overwritten from row ``begin`` on; row 0 repeats row 1.
    nav : (n, 10) array
        States reached, overwritten from row ``begin`` on.
    begin : int
        First row that is looked for: 1, or 2 where an inversion goes on from two rows that are known.
    """
    n = t.size
    if begin == 1:
        for i in range(10):
            nav[0, i] = target[0, i]
    state = np.empty(10)
    m = np.empty((3, 3))
    rhs, u, phi, zb, e = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for k in range(begin, n):
        here = nav[k - 1]
        goal = target[k]
        dt = t[k] - t[k - 1]
        first = k == 1
        c = 0.0 if first else scalar_coning_factor(dt, t[k - 1] - t[k - 2])
        px, py, pz = gyro[k - 1, 0], gyro[k - 1, 1], gyro[k - 1, 2]
        wx, wy, wz = accel[k - 1, 0], accel[k - 1, 1], accel[k - 1, 2]
        if first:
            px = py = pz = wx = wy = wz = 0.0

        # a guess: the Earth of a sphere, the mean velocity
        sl, cl = math.sin(here[0]), math.cos(here[0])
        r = 1.0 / (6.37e6 + here[2])
        vn, ve, vd = 0.5 * (here[3] + goal[3]), 0.5 * (here[4] + goal[4]), 0.5 * (here[5] + goal[5])
        tn, te = ve * r, -vn * r
        td = -tn * sl / cl
        on, oe, od = 2.0 * RATE * cl + tn, te, -2.0 * RATE * sl + td
        zx, zy, zz = (RATE * cl + tn) * dt, te * dt, (-RATE * sl + td) * dt
        _rotation_to(here, goal, zx, zy, zz, phi)
        # phi = (I + c [p x]) a
        m[0, 0] = m[1, 1] = m[2, 2] = 1.0
        m[0, 1], m[0, 2], m[1, 0], m[1, 2], m[2, 0], m[2, 1] = -c * pz, c * py, c * pz, -c * px, -c * py, c * px
        dtheta = gyro[k]
        _solve3(m, phi, dtheta)
        ax, ay, az = dtheta[0], dtheta[1], dtheta[2]
        g = scalar_gravity(sl, here[2], gravity)
        _to_body(
            here,
            goal[3] - here[3] + dt * (oe * vd - od * ve),
            goal[4] - here[4] + dt * (od * vn - on * vd),
            goal[5] - here[5] + dt * (on * ve - oe * vn) - g * dt,
            rhs,
        )
        _to_body(here, zx, zy, zz, zb)
        rx, ry, rz = ax - zb[0], ay - zb[1], az - zb[2]
        # rhs = (I + k1 [r x] + k2 [r x]^2 + c [p x]) u + c w x a
        r2 = rx * rx + ry * ry + rz * rz
        k1 = 0.5 - r2 * (1.0 / 24.0 - r2 / 720.0)
        k2 = 1.0 / 6.0 - r2 * (1.0 / 120.0 - r2 / 5040.0)
        sx, sy, sz = k1 * rx + c * px, k1 * ry + c * py, k1 * rz + c * pz
        m[0, 0], m[1, 1], m[2, 2] = 1.0 + k2 * (rx * rx - r2), 1.0 + k2 * (ry * ry - r2), 1.0 + k2 * (rz * rz - r2)
        m[0, 1], m[0, 2] = -sz + k2 * rx * ry, sy + k2 * rx * rz
        m[1, 0], m[1, 2] = sz + k2 * rx * ry, -sx + k2 * ry * rz
        m[2, 0], m[2, 1] = -sy + k2 * rx * rz, sx + k2 * ry * rz
        rhs[0] -= c * (wy * az - wz * ay)
        rhs[1] -= c * (wz * ax - wx * az)
        rhs[2] -= c * (wx * ay - wy * ax)
        dvel = accel[k]
        _solve3(m, rhs, dvel)

        # the step says what is still missing
        if first:
            gyro_prev, accel_prev, dt_prev = dtheta, dvel, dt
        else:
            gyro_prev, accel_prev, dt_prev = gyro[k - 1], accel[k - 1], t[k - 1] - t[k - 2]
        for _ in range(passes):
            for i in range(state.size):  # an assignment of slices would compile three seconds of messages
                state[i] = here[i]
            step(state, dtheta, dvel, gyro_prev, accel_prev, dt, dt_prev, gravity)
            _to_body(here, goal[3] - state[3], goal[4] - state[4], goal[5] - state[5], e)
            _solve3(m, e, u)
            _rotation_to(state, goal, 0.0, 0.0, 0.0, phi)
            for i in range(3):
                dvel[i] += u[i]
                dtheta[i] += phi[i]
        for i in range(state.size):
            state[i] = here[i]
        step(state, dtheta, dvel, gyro_prev, accel_prev, dt, dt_prev, gravity)
        for i in range(state.size):
            nav[k, i] = state[i]
    for i in range(3 if begin == 1 else 0):
        gyro[0, i], accel[0, i] = gyro[1, i], accel[1, i]
