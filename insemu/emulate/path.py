"""Smooth paths: position and attitude as splines of time, with their exact derivatives.

A path is the truth between the samples. Its map coordinates (metres north, east and up of an origin, linear in
latitude, longitude and height) are piecewise polynomials with continuous acceleration, its roll, pitch and heading
with continuous angular acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu import earth, rotation
from insemu.effects import LONGEST_ARM
from insemu.errors import InputError
from insemu.records import Trajectory

Array = NDArray[np.float64]

#: Spacing of the knots of paths that are made from motion profiles, s. A spline repeats the motion around the rate of its knots: with quintics and
#: 40 knots a second, 3 Hz and 0.02 rad come back at 37 Hz with less than 1e-7 rad/s, a millionth of a car's own turn rates.
KNOT_S = 0.025
_DEGREE = 5


class Curve(Protocol):
    """Three functions of time: a :class:`~scipy.interpolate.PPoly`, or what goes through one several times."""

    @property
    def x(self) -> Array:
        """Times of its pieces, s; the first and the last are its span."""

    def __call__(self, t: ArrayLike, nu: int = 0) -> Array:
        """Values (n, 3) at times (n,) in s, or their derivatives of an order."""


@dataclass(frozen=True)
class Kinematics:
    """Everything about the motion at some times, rows of (n, 3) arrays in SI.

    ``llh`` position; ``vel_ned`` Earth-relative velocity; ``acc_ned`` its time derivative; ``rpy`` Euler angles
    (heading not wrapped); ``w_nb_b`` rate of the body with respect to NED in body axes and ``alpha_nb_b`` its time
    derivative.
    """

    llh: Array
    vel_ned: Array
    acc_ned: Array
    rpy: Array
    w_nb_b: Array
    alpha_nb_b: Array


@dataclass(frozen=True)
class SmoothPath:
    """A twice differentiable path of a vehicle.

    Parameters
    ----------
    position : Curve
        Metres north, east, up of the origin as functions of time in s.
    attitude : Curve
        Roll, pitch, heading in rad.
    origin : (3,) array
        Latitude rad, longitude rad, height m where the map coordinates are zero.
    name : str
        Appears in tables.
    highest : float
        Highest frequency of the motion, Hz: what an average over an interval has to follow.
    """

    position: Curve
    attitude: Curve
    origin: Array
    name: str = "path"
    highest: float = 0.1 / KNOT_S

    @classmethod
    def from_velocity(
        cls, t: ArrayLike, vel_map: ArrayLike, rpy: ArrayLike, origin: ArrayLike, name: str
    ) -> SmoothPath:
        """Integrate velocity nodes: quintic splines through at least six of them, so that the acceleration and three of its rates are continuous.

        Parameters
        ----------
        t : (n,) array_like
            s.
        vel_map : (n, 3) array_like
            North, east, up, m/s.
        rpy : (n, 3) array_like
            Roll, pitch, heading, rad, not wrapped.
        origin : (3,) array_like
            Latitude rad, longitude rad, height m at the first node.
        name : str
        """
        t = np.asarray(t, dtype=float)
        velocity = _through(t, np.asarray(vel_map, dtype=float), at_rest=_at_rest(vel_map))
        attitude = _through(t, np.asarray(rpy, dtype=float))
        return cls(velocity.antiderivative(), attitude, np.asarray(origin, dtype=float), name)

    @property
    def start(self) -> float:
        """First time, s."""
        return float(self.position.x[0])

    @property
    def end(self) -> float:
        """Last time, s."""
        return float(self.position.x[-1])

    @property
    def duration(self) -> float:
        """Length in s."""
        return self.end - self.start

    def _scale(self) -> tuple[float, float]:
        rm, rn = earth.radii(self.origin[0])
        return float(rm + self.origin[2]), float((rn + self.origin[2]) * np.cos(self.origin[0]))

    def _check(self, t: ArrayLike) -> Array:
        t = np.atleast_1d(np.asarray(t, dtype=float))
        if t.size and (t.min() < self.start - 1e-9 or t.max() > self.end + 1e-9):
            raise InputError(
                f"time {t.min() if t.min() < self.start else t.max():.6g} s is outside the path '{self.name}' "
                f"({self.start:.6g} to {self.end:.6g} s)"
            )
        return np.asarray(np.clip(t, self.start, self.end))

    def llh(self, t: ArrayLike) -> Array:
        """Position (n, 3) in rad, rad, m at times (n,)."""
        scale_n, scale_e = self._scale()
        p = self.position(self._check(t))
        lon = self.origin[1] + p[:, 1] / scale_e
        return np.stack(
            [self.origin[0] + p[:, 0] / scale_n, (lon + np.pi) % (2 * np.pi) - np.pi, self.origin[2] + p[:, 2]], axis=1
        )

    def vel_ned(self, t: ArrayLike) -> Array:
        """Earth-relative velocity (n, 3) in m/s at times (n,)."""
        return self._vel_ned(self._check(t), self.llh(t))

    def _vel_ned(self, t: Array, llh: Array) -> Array:
        scale_n, scale_e = self._scale()
        d, (rm, rn) = self.position(t, 1), earth.radii(llh[:, 0])
        return np.stack(
            [(rm + llh[:, 2]) * d[:, 0] / scale_n, (rn + llh[:, 2]) * np.cos(llh[:, 0]) * d[:, 1] / scale_e, -d[:, 2]],
            axis=1,
        )

    def rpy(self, t: ArrayLike) -> Array:
        """Roll, pitch, heading (n, 3) in rad at times (n,), heading not wrapped."""
        return np.asarray(self.attitude(self._check(t)))

    def sample(self, t: ArrayLike) -> Trajectory:
        """Nodes of position, velocity and attitude at times (n,); roll and heading in (-pi, pi]."""
        t = np.asarray(t, dtype=float)
        rpy, llh = self.rpy(t), self.llh(t)
        rpy[:, [0, 2]] = np.pi - (np.pi - rpy[:, [0, 2]]) % (2 * np.pi)
        return Trajectory(t, llh, self._vel_ned(self._check(t), llh), rpy, self.name)

    def kinematics(self, t: ArrayLike) -> Kinematics:
        """Exact derivatives of the path at times (n,)."""
        t = self._check(t)
        scale_n, scale_e = self._scale()
        llh = self.llh(t)
        lat, h = llh[:, 0], llh[:, 2]
        d, dd = self.position(t, 1), self.position(t, 2)
        lat1, lon1, h1 = d[:, 0] / scale_n, d[:, 1] / scale_e, d[:, 2]
        lat2, lon2, h2 = dd[:, 0] / scale_n, dd[:, 1] / scale_e, dd[:, 2]
        rm, rn = earth.radii(lat)
        s, c = np.sin(lat), np.cos(lat)
        x = 1.0 - earth.E2 * s * s
        rm1, rn1 = 3.0 * rm * earth.E2 * s * c / x * lat1, rn * earth.E2 * s * c / x * lat1
        vel = np.stack([(rm + h) * lat1, (rn + h) * c * lon1, -h1], axis=1)
        acc = np.stack(
            [
                (rm + h) * lat2 + (rm1 + h1) * lat1,
                (rn + h) * c * lon2 + ((rn1 + h1) * c - (rn + h) * s * lat1) * lon1,
                -h2,
            ],
            axis=1,
        )
        rpy, r1, r2 = self.attitude(t), self.attitude(t, 1), self.attitude(t, 2)
        w, alpha = euler_rates(rpy, r1, r2)
        return Kinematics(llh, vel, acc, rpy, w, alpha)


def _through(t: Array, nodes: Array, *, at_rest: bool = False) -> scipy.interpolate.PPoly:
    """Quintic spline through nodes (n, k); with ``at_rest`` two derivatives vanish at both ends."""
    ends = [(1, np.zeros(nodes.shape[1])), (2, np.zeros(nodes.shape[1]))]
    # from the first node, so that what stays is constant to the last bit
    spline = scipy.interpolate.make_interp_spline(
        t, nodes - nodes[0], k=_DEGREE, bc_type=(ends, ends) if at_rest else None
    )
    made = pieces_of(spline)
    made.c[-1] += nodes[0]
    made.c[-1, 0] = nodes[0]  # rest is rest without rounding
    return made


def pieces_of(spline: scipy.interpolate.BSpline) -> scipy.interpolate.PPoly:
    """Polynomial pieces of a B-spline (coefficients (count, k)) between its knots, without the empty ones of repeated ends."""
    degree = spline.k
    x = spline.t[degree : -degree or None]
    c = np.empty((degree + 1, x.size - 1, spline.c.shape[1]))
    factorial = 1.0
    for m in range(degree + 1):
        factorial *= max(m, 1)
        # from inside every piece: Taylor at its middle, shifted to its left end below
        c[degree - m] = spline(0.5 * (x[:-1] + x[1:]), nu=m) / factorial
    return scipy.interpolate.PPoly(_shift(c, -0.5 * np.diff(x)), x)


def _shift(c: Array, by: Array) -> Array:
    """Coefficients (highest power first) of polynomials about a point moved by ``by``: repeated Horner (Taylor
    shift).
    """
    out = c.copy()
    degree = c.shape[0] - 1
    for i in range(degree):
        for j in range(1, degree + 1 - i):
            out[j] += by[:, None] * out[j - 1]
    return out


def _at_rest(vel: ArrayLike) -> bool:
    v = np.asarray(vel, dtype=float)
    return bool(np.all(v[:2] == 0.0) and np.all(v[-2:] == 0.0))


def euler_rates(rpy: Array, first: Array, second: Array) -> tuple[Array, Array]:
    """Body rate with respect to NED, in body axes, and its derivative.

    Parameters
    ----------
    rpy, first, second : (n, 3) arrays
        Euler angles in rad and their first and second time derivatives.

    Returns
    -------
    w, alpha : (n, 3) arrays
        rad/s and rad/s^2.
    """
    sr, cr = np.sin(rpy[:, 0]), np.cos(rpy[:, 0])
    sp, cp = np.sin(rpy[:, 1]), np.cos(rpy[:, 1])
    r1, p1, h1 = first.T
    r2, p2, h2 = second.T
    w = np.stack([r1 - h1 * sp, p1 * cr + h1 * sr * cp, -p1 * sr + h1 * cr * cp], axis=1)
    alpha = np.stack(
        [
            r2 - h2 * sp - h1 * cp * p1,
            p2 * cr - p1 * sr * r1 + h2 * sr * cp + h1 * (cr * r1 * cp - sr * sp * p1),
            -p2 * sr - p1 * cr * r1 + h2 * cr * cp + h1 * (-sr * r1 * cp - cr * sp * p1),
        ],
        axis=1,
    )
    return w, alpha


@dataclass(frozen=True)
class Mounting:
    """Where and how an IMU sits in its vehicle.

    Parameters
    ----------
    lever_arm : (3,) tuple
        From the vehicle's reference point to the IMU, vehicle axes (forward, right, down), m.
    rpy : (3,) tuple
        Roll, pitch, yaw of the IMU with respect to the vehicle in rad; ``C_vb`` takes IMU to vehicle axes.
    """

    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("lever_arm", "rpy"):
            value = tuple(float(x) for x in getattr(self, name))
            if len(value) != 3 or not np.isfinite(value).all():
                raise InputError(f"mounting {name} is {value}, expected three finite numbers")
            if name == "lever_arm" and max(map(abs, value)) > LONGEST_ARM:
                raise InputError(
                    f"mounting {name} is {value} m, which is implausible, expected at most {LONGEST_ARM:g} m"
                )
            object.__setattr__(self, name, value)

    @property
    def is_identity(self) -> bool:
        """Whether IMU and vehicle coincide."""
        return not any(self.lever_arm) and not any(self.rpy)

    def dcm(self) -> Array:
        """``C_vb`` (3, 3), IMU to vehicle axes."""
        return rotation.dcm_from_rpy(self.rpy)


@dataclass(frozen=True)
class SensorMotion:
    """What a perfect IMU at a mounting feels at some times, (n, 3) arrays: ``w_ib_b`` rad/s, ``f_ib_b`` m/s^2, and
    its own motion.
    """

    llh: Array
    vel_ned: Array
    rpy: Array
    w_ib_b: Array
    f_ib_b: Array


def sensor_motion(path: SmoothPath, t: ArrayLike, mounting: Mounting, gravity: str = "normal") -> SensorMotion:
    """True angular rate and specific force of an IMU on a path.

    Parameters
    ----------
    path : SmoothPath
        Motion of the vehicle's reference point.
    t : (n,) array_like
        Times, s.
    mounting : Mounting
        Lever arm and mounting angles.
    gravity : {"normal", "free_air_first_order"}
        See :mod:`insemu.earth`.

    Returns
    -------
    SensorMotion
        Groves 2013, sections 5.3 to 5.5 read backwards: ``w_ib = w_nb + w_ie + w_en``,
        ``f = v' - g + (2 w_ie + w_en) x v``; the lever arm adds its velocity and acceleration in Earth-fixed axes.
    """
    k = path.kinematics(t)
    c_nv = rotation.dcm_from_rpy(k.rpy)

    def to_body(x: Array) -> Array:
        return np.asarray(np.einsum("nji,nj->ni", c_nv, x))

    def to_ned(x: Array) -> Array:
        return np.asarray(np.einsum("nij,nj->ni", c_nv, x))

    lat = k.llh[:, 0]
    w_ie = earth.earth_rate(lat)
    w_en = earth.transport_rate(k.llh, k.vel_ned)
    arm = np.asarray(mounting.lever_arm)
    llh, vel = k.llh, k.vel_ned
    coriolis = np.cross(2.0 * w_ie + w_en, vel)
    acceleration = k.acc_ned + coriolis  # without gravity; in NED axes of the reference point
    if arm.any():
        # rate of the vehicle with respect to the Earth and its derivative, in vehicle axes; d(w_en)/dt by its own
        # kinematics
        w_ev = k.w_nb_b + to_body(w_en)
        w_en_dot = _transport_acceleration(k)
        alpha = k.alpha_nb_b + to_body(w_en_dot) - np.cross(k.w_nb_b, to_body(w_en))
        tangential = np.cross(w_ev, arm)
        vel = vel + to_ned(tangential)
        # relative to the turning Earth: w' x l + w x (w x l) + 2 w_ie x (w x l)
        extra = np.cross(alpha, arm) + np.cross(w_ev, tangential) + 2.0 * np.cross(to_body(w_ie), tangential)
        acceleration = acceleration + to_ned(extra)
        # the arm is metres: the place moves along the ellipsoid exactly through Earth-fixed axes
        ned = to_ned(np.broadcast_to(arm, vel.shape))
        moved = earth.llh_to_ecef(llh) + np.einsum("nij,nj->ni", earth.dcm_en(lat, llh[:, 1]), ned)
        llh_new = earth.ecef_to_llh(moved)
        # into the NED axes of the IMU's own place
        turn = np.einsum("nji,njk->nik", earth.dcm_en(llh_new[:, 0], llh_new[:, 1]), earth.dcm_en(lat, llh[:, 1]))
        llh = llh_new
        vel = np.einsum("nij,nj->ni", turn, vel)
        acceleration = np.einsum("nij,nj->ni", turn, acceleration)
        c_nv = turn @ c_nv
    c_nb = c_nv @ mounting.dcm()
    g = np.zeros_like(vel)
    g[:, 2] = earth.gravity(llh[:, 0], llh[:, 2], gravity)
    f_b = np.einsum("nji,nj->ni", c_nb, acceleration - g)
    w_b = (k.w_nb_b + np.einsum("nji,nj->ni", rotation.dcm_from_rpy(k.rpy), w_ie + w_en)) @ mounting.dcm()
    return SensorMotion(llh, vel, rotation.rpy_from_dcm(c_nb), w_b, f_b)


def _transport_acceleration(k: Kinematics) -> Array:
    """Time derivative of the components of ``w_en`` in NED, (n, 3)."""
    lat, h = k.llh[:, 0], k.llh[:, 2]
    rm, rn = earth.radii(lat)
    vn, ve, vd = k.vel_ned.T
    an, ae, _ = k.acc_ned.T
    s, c = np.sin(lat), np.cos(lat)
    x = 1.0 - earth.E2 * s * s
    lat1 = vn / (rm + h)
    rm1 = 3.0 * rm * earth.E2 * s * c / x * lat1 - vd
    rn1 = rn * earth.E2 * s * c / x * lat1 - vd
    east = ve / (rn + h)
    east1 = (ae - east * rn1) / (rn + h)
    north1 = -(an - vn / (rm + h) * rm1) / (rm + h)
    return np.stack([east1, north1, -east1 * s / c - east * lat1 / c**2], axis=1)
