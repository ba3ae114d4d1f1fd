"""What an IMU says between two times, in the body axes at the first: attitude, velocity, place, and their derivatives by the biases.

Preintegration (Lupton and Sukkarieh 2012): none of it depends on the attitude, the velocity or the place at the start, so that one pass over the
samples serves all that are tried.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.records import ImuRecord

Array = NDArray[np.float64]

#: Where the parts of :class:`Integrals` stand in a row of the compiled pass.
_Q, _T, _V, _P, _V_BG, _P_BG, _P_BA, _ALL = 0, 9, 18, 21, 24, 33, 42, 51


@njit(cache=True, nogil=True)
def _turn(Q: Array, angles: Array, turn: Array, dt: float) -> None:
    """Carry an attitude, the first nine numbers of ``Q``, over one step of angle increments (3,) while the local frame turns at ``turn``, rad/s."""
    x = angles[0] - (Q[0] * turn[0] + Q[3] * turn[1] + Q[6] * turn[2]) * dt
    y = angles[1] - (Q[1] * turn[0] + Q[4] * turn[1] + Q[7] * turn[2]) * dt
    z = angles[2] - (Q[2] * turn[0] + Q[5] * turn[1] + Q[8] * turn[2]) * dt
    size2 = x * x + y * y + z * z
    once, twice = 1.0, 0.5
    if size2 > 1e-12:
        size = math.sqrt(size2)
        once, twice = math.sin(size) / size, (1.0 - math.cos(size)) / size2
    for r in (0, 3, 6):
        # a row times the matrix of a cross product is the row crossed with the vector
        a, b, c = Q[r + 1] * z - Q[r + 2] * y, Q[r + 2] * x - Q[r] * z, Q[r] * y - Q[r + 1] * x
        Q[r] += once * a + twice * (b * z - c * y)
        Q[r + 1] += once * b + twice * (c * x - a * z)
        Q[r + 2] += once * c + twice * (a * y - b * x)


@njit(cache=True, nogil=True)
def _chain(angles: Array, turn: Array, dt: Array, out: Array) -> None:
    """Attitudes (n, 9) relative to the first; arguments as in :func:`attitudes`."""
    out[0] = np.array([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    for k in range(1, angles.shape[0]):
        out[k] = out[k - 1]
        _turn(out[k], angles[k], turn, dt[k])


def attitudes(angles: Array, turn: Array, dt: Array) -> Array:
    """Attitudes (n, 3, 3) relative to the first.

    Parameters
    ----------
    angles : (n, 3) array
        Angle increments, rad.
    turn : (3,) array
        Rate of the local frame in the first axes, rad/s.
    dt : (n,) array
        Steps, s.
    """
    out = np.empty((len(angles), 9))
    _chain(np.ascontiguousarray(angles), turn, np.ascontiguousarray(dt), out)
    return out.reshape(-1, 3, 3)


@njit(cache=True, nogil=True)
def _integrate(t: Array, gyro: Array, accel: Array, bias: Array, turn: Array, k: Array, share: Array) -> Array:
    """Rows (f, :data:`_ALL`) at the ``share`` of the step that ends at sample ``k`` (f,), ascending."""
    out = np.empty((k.size, _ALL))
    s, before = np.zeros(_ALL), np.zeros(_ALL)
    s[0] = s[4] = s[8] = 1.0
    w, dv = np.empty(3), np.empty(3)
    at = 0
    for n in range(1, k[-1] + 1):
        dt = t[n] - t[n - 1]
        before[:] = s
        for i in range(3):
            w[i] = gyro[n, i] - bias[i] * dt
        _turn(s, w, turn, dt)
        for i in range(3):
            dv[i] = 0.0
            for j in range(3):
                mid = 0.5 * (s[_Q + 3 * i + j] + before[_Q + 3 * i + j])
                dv[i] += mid * (accel[n, j] - bias[3 + j] * dt)
                s[_T + 3 * i + j] += mid * dt
                s[_P_BA + 3 * i + j] -= (before[_T + 3 * i + j] + 0.5 * mid * dt) * dt
            s[_V + i] += dv[i]
            s[_P + i] += (before[_V + i] + 0.5 * dv[i]) * dt
        for i in range(3):
            a, b = (i + 1) % 3, (i + 2) % 3
            for j in range(3):
                more = dv[a] * before[_T + 3 * b + j] - dv[b] * before[_T + 3 * a + j]
                s[_V_BG + 3 * i + j] += more
                s[_P_BG + 3 * i + j] += (before[_V_BG + 3 * i + j] + 0.5 * more) * dt
        while at < k.size and k[at] == n:
            for i in range(_ALL):
                out[at, i] = (1.0 - share[at]) * before[i] + share[at] * s[i]
            at += 1
    return out


@dataclass(frozen=True)
class Integrals:
    """What the IMU says between the start of a stretch and each fix (f fixes), in the body axes at the start.

    ``Q`` (f, 3, 3) attitude, ``T`` its integral; ``velocity``, ``place`` (f, 3) integrals of the specific force; ``v_bg``, ``p_bg``, ``v_ba``,
    ``p_ba`` (f, 3, 3) their derivatives by the biases of gyroscopes and accelerometers; ``arm``, ``swing`` (f, 3) of the antenna; ``bias`` (6,)
    what was removed.
    """

    Q: Array
    T: Array
    velocity: Array
    place: Array
    v_bg: Array
    p_bg: Array
    p_ba: Array
    arm: Array
    swing: Array
    bias: Array

    @property
    def v_ba(self) -> Array:
        """Derivative of the velocity by the accelerometers' biases."""
        return -self.T

    @classmethod
    def of(cls, r: ImuRecord, at: Array, bias: Array, turn: Array, lever_arm: Array) -> Integrals:
        """Integrate a record of increments, less ``bias`` (6,), to the times ``at`` (f,), ascending; ``turn`` (3,) as in :func:`attitudes`."""
        k = np.searchsorted(r.t, at).clip(1, len(r) - 1)
        step = (r.t[k] - r.t[k - 1])[:, None]
        out = _integrate(r.t, r.gyro, r.accel, bias, turn, k, (at - r.t[k - 1]) / step[:, 0])
        Q, T, v_bg, p_bg, p_ba = (out[:, j : j + 9].reshape(-1, 3, 3) for j in (_Q, _T, _V_BG, _P_BG, _P_BA))
        near = r.gyro[np.stack([k, np.minimum(k + 1, len(r) - 1)])].mean(axis=0) / step - bias[:3]
        swing = np.einsum("kij,kj->ki", Q, np.cross(near - turn @ Q, lever_arm))
        return cls(Q, T, out[:, _V:_P], out[:, _P:_V_BG], v_bg, p_bg, p_ba, Q @ lever_arm, swing, bias)
