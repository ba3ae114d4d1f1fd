"""Rotations: Euler angles, direction cosines, quaternions, rotation vectors.

Euler angles are roll, pitch, heading in rad with ``C_nb = Rz(heading) Ry(pitch) Rx(roll)``; roll and heading come
back in (-pi, pi]. Quaternions are (w, x, y, z), Hamilton product, with ``v_n = q v_b q*``. Public functions broadcast
over leading axes; functions whose names start with ``scalar_`` are compiled, work on one rotation and write into
their last argument.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.compiled import njit
from insemu.lanes import any_of, where

Array = NDArray[np.float64]


def skew(v: ArrayLike) -> Array:
    """Matrix ``[v x]`` with ``[v x] w = v x w``; (..., 3) to (..., 3, 3)."""
    v = np.asarray(v, dtype=float)
    m = np.zeros((*v.shape[:-1], 3, 3))
    m[..., 0, 1], m[..., 0, 2] = -v[..., 2], v[..., 1]
    m[..., 1, 0], m[..., 1, 2] = v[..., 2], -v[..., 0]
    m[..., 2, 0], m[..., 2, 1] = -v[..., 1], v[..., 0]
    return m


def dcm_from_rpy(rpy: ArrayLike) -> Array:
    """``C_nb`` of roll, pitch, heading; (..., 3) to (..., 3, 3)."""
    rpy = np.asarray(rpy, dtype=float)
    angles = np.ascontiguousarray(np.moveaxis(rpy, -1, 0))
    sr, sp, sh = np.sin(angles)
    cr, cp, ch = np.cos(angles)
    c = np.empty((*rpy.shape[:-1], 3, 3))
    c[..., 0, 0], c[..., 0, 1], c[..., 0, 2] = ch * cp, ch * sp * sr - sh * cr, ch * sp * cr + sh * sr
    c[..., 1, 0], c[..., 1, 1], c[..., 1, 2] = sh * cp, sh * sp * sr + ch * cr, sh * sp * cr - ch * sr
    c[..., 2, 0], c[..., 2, 1], c[..., 2, 2] = -sp, cp * sr, cp * cr
    return c


def rpy_from_dcm(c: ArrayLike) -> Array:
    """Roll, pitch, heading of ``C_nb``; (..., 3, 3) to (..., 3)."""
    c = np.asarray(c, dtype=float)
    roll = np.arctan2(c[..., 2, 1], c[..., 2, 2])
    # two-argument form: keeps all digits of the pitch near +-90 deg
    pitch = np.arctan2(-c[..., 2, 0], np.hypot(c[..., 2, 1], c[..., 2, 2]))
    heading = np.arctan2(c[..., 1, 0], c[..., 0, 0])
    return np.stack([roll, pitch, heading], axis=-1)


def quaternion_from_rpy(rpy: ArrayLike) -> Array:
    """Quaternion of ``C_nb`` of roll, pitch, heading; (..., 3) to (..., 4), scalar part first."""
    half = 0.5 * np.asarray(rpy, dtype=float)
    sr, sp, sh = np.moveaxis(np.sin(half), -1, 0)
    cr, cp, ch = np.moveaxis(np.cos(half), -1, 0)
    return np.stack(
        [
            ch * cp * cr + sh * sp * sr,
            ch * cp * sr - sh * sp * cr,
            ch * sp * cr + sh * cp * sr,
            sh * cp * cr - ch * sp * sr,
        ],
        axis=-1,
    )


def rpy_from_quaternion(q: ArrayLike) -> Array:
    """Roll, pitch, heading of a quaternion; (..., 4) to (..., 3)."""
    return rpy_from_dcm(dcm_from_quaternion(q))


def dcm_from_quaternion(q: ArrayLike) -> Array:
    """``C_nb`` of a unit quaternion; (..., 4) to (..., 3, 3)."""
    w, x, y, z = np.moveaxis(np.asarray(q, dtype=float), -1, 0)
    c = np.empty((*w.shape, 3, 3))
    c[..., 0, 0], c[..., 0, 1], c[..., 0, 2] = w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)
    c[..., 1, 0], c[..., 1, 1], c[..., 1, 2] = 2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)
    c[..., 2, 0], c[..., 2, 1], c[..., 2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z
    return c


def quaternion_from_dcm(c: ArrayLike) -> Array:
    """Unit quaternion of a rotation matrix, scalar part not negative; (..., 3, 3) to (..., 4)."""
    c = np.asarray(c, dtype=float)
    # four times the outer product q q', of which the row with the largest diagonal is the best conditioned
    k = np.empty((*c.shape[:-2], 4, 4))
    d0, d1, d2 = c[..., 0, 0], c[..., 1, 1], c[..., 2, 2]
    k[..., 0, 0], k[..., 1, 1] = 1 + d0 + d1 + d2, 1 + d0 - d1 - d2
    k[..., 2, 2], k[..., 3, 3] = 1 - d0 + d1 - d2, 1 - d0 - d1 + d2
    k[..., 0, 1] = k[..., 1, 0] = c[..., 2, 1] - c[..., 1, 2]
    k[..., 0, 2] = k[..., 2, 0] = c[..., 0, 2] - c[..., 2, 0]
    k[..., 0, 3] = k[..., 3, 0] = c[..., 1, 0] - c[..., 0, 1]
    k[..., 1, 2] = k[..., 2, 1] = c[..., 1, 0] + c[..., 0, 1]
    k[..., 1, 3] = k[..., 3, 1] = c[..., 0, 2] + c[..., 2, 0]
    k[..., 2, 3] = k[..., 3, 2] = c[..., 2, 1] + c[..., 1, 2]
    best = np.argmax(np.diagonal(k, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(k, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., :1] < 0, -q, q))


def quaternion_product(p: ArrayLike, q: ArrayLike) -> Array:
    """Hamilton product ``p q``; (..., 4)."""
    a, b, c, d = np.moveaxis(np.asarray(p, dtype=float), -1, 0)
    w, x, y, z = np.moveaxis(np.asarray(q, dtype=float), -1, 0)
    return np.stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ],
        axis=-1,
    )


def quaternion_conjugate(q: ArrayLike) -> Array:
    """Inverse of a unit quaternion; (..., 4)."""
    return np.asarray(np.asarray(q, dtype=float) * np.array([1.0, -1.0, -1.0, -1.0]))


def quaternion_from_vector(phi: ArrayLike) -> Array:
    """Quaternion of a rotation vector (exponential map); (..., 3) to (..., 4)."""
    phi = np.asarray(phi, dtype=float)
    angle = np.linalg.norm(phi, axis=-1, keepdims=True)
    return np.concatenate([np.cos(0.5 * angle), 0.5 * phi * np.sinc(0.5 * angle / np.pi)], axis=-1)


def vector_from_quaternion(q: ArrayLike) -> Array:
    """Rotation vector of a unit quaternion (logarithm), angle at most pi; (..., 4) to (..., 3)."""
    q = np.asarray(q, dtype=float)
    q = np.where(q[..., :1] < 0, -q, q)
    s = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(s, q[..., :1])
    # angle / s tends to 2 / w
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.where(s > 1e-12, angle / s, 2.0 / q[..., :1])
    return np.asarray(factor * q[..., 1:])


def dcm_from_vector(phi: ArrayLike) -> Array:
    """Rotation matrix ``exp([phi x])``; (..., 3) to (..., 3, 3)."""
    return dcm_from_quaternion(quaternion_from_vector(phi))


def vector_from_dcm(c: ArrayLike) -> Array:
    """Rotation vector of a rotation matrix (logarithm), angle at most pi; (..., 3, 3) to (..., 3)."""
    return vector_from_quaternion(quaternion_from_dcm(c))


def attitude_difference(rpy: ArrayLike, reference_rpy: ArrayLike) -> Array:
    """Attitude error ``phi`` in NED with ``C = exp([phi x]) C_reference``; (..., 3), rad."""
    estimate, truth = quaternion_from_rpy(rpy), quaternion_from_rpy(reference_rpy)
    return vector_from_quaternion(quaternion_product(estimate, quaternion_conjugate(truth)))


@njit(cache=True, nogil=True)
def scalar_half_trig(phi2: float) -> tuple[float, float]:
    """``(cos(phi/2), sin(phi/2)/phi)`` of a squared angle, by series to rounding where the angle is below 0.14 rad."""
    x = 0.25 * phi2
    c = 1.0 - x * (0.5 - x * (1.0 / 24.0 - x * (1.0 / 720.0 - x / 40320.0)))
    s = 0.5 * (1.0 - x * (1.0 / 6.0 - x * (1.0 / 120.0 - x * (1.0 / 5040.0 - x / 362880.0))))
    if any_of(phi2 >= 0.02):
        angle = math.sqrt(max(phi2, 0.02))
        c = where(phi2 >= 0.02, math.cos(0.5 * angle), c)
        s = where(phi2 >= 0.02, math.sin(0.5 * angle) / angle, s)
    return c, s


@njit(cache=True, nogil=True)
def scalar_wrapped(angle: float) -> float:
    """An angle of less than 3 pi within plus and minus pi, rad."""
    if any_of(abs(angle) > math.pi):
        angle = angle - where(angle > math.pi, 2.0 * math.pi, where(angle < -math.pi, -2.0 * math.pi, 0.0))
    return angle


@njit(cache=True, nogil=True)
def scalar_dcm(q: Array, c: Array) -> None:
    """Write ``C_nb`` (3, 3) of the unit quaternion ``q`` (4,) into ``c``."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    c[0, 0] = w * w + x * x - y * y - z * z
    c[0, 1] = 2.0 * (x * y - w * z)
    c[0, 2] = 2.0 * (x * z + w * y)
    c[1, 0] = 2.0 * (x * y + w * z)
    c[1, 1] = w * w - x * x + y * y - z * z
    c[1, 2] = 2.0 * (y * z - w * x)
    c[2, 0] = 2.0 * (x * z - w * y)
    c[2, 1] = 2.0 * (y * z + w * x)
    c[2, 2] = w * w - x * x - y * y + z * z


@njit(cache=True, nogil=True)
def scalar_dcm_from_rpy(rpy: Array, c: Array) -> None:
    """Write the matrix of roll, pitch, heading (3,) into ``c`` (3, 3), as :func:`dcm_from_rpy`."""
    cr, cp, ch = math.cos(rpy[0]), math.cos(rpy[1]), math.cos(rpy[2])
    sr, sp, sh = math.sin(rpy[0]), math.sin(rpy[1]), math.sin(rpy[2])
    c[0, 0], c[0, 1], c[0, 2] = cp * ch, sr * sp * ch - cr * sh, cr * sp * ch + sr * sh
    c[1, 0], c[1, 1], c[1, 2] = cp * sh, sr * sp * sh + cr * ch, cr * sp * sh - sr * ch
    c[2, 0], c[2, 1], c[2, 2] = -sp, sr * cp, cr * cp
