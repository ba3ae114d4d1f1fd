"""How vehicles move and shake, on a millisecond grid, written on numpy alone: nothing here comes from the package that is judged.

A ride is a path in the tangent plane of its start (north, east, down), attitudes with respect to that plane, and what shakes the body on top of both.
Everything that an IMU and an antenna see follows from it by differences in Earth-centred, Earth-fixed axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RATE = 1000
DT = 1.0 / RATE
VEHICLES = ("car", "train", "walker", "boat", "fixed_wing", "quadrotor")
#: WGS-84: semi-major axis m, flattening, rate rad/s, and Somigliana's constants.
A, F, OMEGA = 6378137.0, 1.0 / 298.257223563, 7.292115e-5
GE, GP, GM = 9.7803253359, 9.8321849378, 3.986004418e14


@dataclass(frozen=True)
class Ride:
    """A moving body, n milliseconds.

    Parameters
    ----------
    place : (n, 3) array
        Of the IMU, m north, east, down of the start.
    rpy : (n, 3) array
        Roll, pitch and yaw in the start's tangent plane, rad.
    origin : (3,) array
        Latitude, longitude (rad), height (m) of the start.
    shaking : dict
        Root mean squares of what was laid on top: m/s^2 and rad/s.
    """

    place: Array
    rpy: Array
    origin: Array
    shaking: dict[str, float]


def low_pass(x: Array, seconds: float, times: int = 3) -> Array:
    """Repeated moving average along the first axis, ends held."""
    width = max(1, round(seconds * RATE))
    for _ in range(times):
        padded = np.concatenate([np.repeat(x[:1], width, axis=0), x, np.repeat(x[-1:], width, axis=0)])
        total = np.cumsum(padded, axis=0)
        x = (total[width:] - total[:-width])[width // 2 : width // 2 + x.shape[0]] / width
    return x


def later(x: Array, seconds: float) -> Array:
    """A signal so much later, its first value held."""
    k = round(seconds * RATE)
    return np.concatenate([np.full(k, x[0]), x[:-k]])


def coloured(rng: np.random.Generator, n: int, low: float, high: float, integrate: int = 0) -> Array:
    """Unit-variance noise between two frequencies (Hz), then integrated in the frequency domain so often."""
    m = 1 << (n - 1).bit_length()
    f = np.fft.rfftfreq(m, DT)
    gain = 1.0 / (1.0 + (low / np.maximum(f, 1e-9)) ** 8) / (1.0 + (f / high) ** 8)
    z = np.fft.rfft(rng.standard_normal(m)) * np.sqrt(gain)
    z /= float(np.std(np.fft.irfft(z, m)[:n]))
    z[0], z[1:] = 0.0, z[1:] / (2j * np.pi * f[1:]) ** integrate
    return np.fft.irfft(z, m)[:n]


def ride(rng: np.random.Generator, vehicle: str, seconds: float, shake: tuple[float, float] | None) -> Ride:
    """Draw a ride.

    Parameters
    ----------
    rng : Generator
    vehicle : str
        One of :data:`VEHICLES`.
    seconds : float
    shake : (2,) tuple, optional
        Root mean square of the vibration, m/s^2 and rad/s; none: only what belongs to the way of moving.
    """
    t = np.arange(round(seconds * RATE)) * DT
    speed, heading, climb, roll, pitch, crab = _PATHS[vehicle](rng, t)
    way = heading + crab
    velocity = np.stack([speed * np.cos(way), speed * np.sin(way), -climb], axis=1)
    rpy = np.stack([roll, pitch, heading], axis=1)
    place, rpy, measured = laid_on(rng, np.cumsum(velocity, axis=0) * DT, rpy, speed, shake, vehicle)
    return Ride(place, rpy, draw_origin(rng), measured)


def draw_origin(rng: np.random.Generator) -> Array:
    """Latitude, longitude (rad) and height (m) of a start."""
    return np.array([rng.uniform(-1.1, 1.1), rng.uniform(-3.0, 3.0), rng.uniform(20.0, 600.0)])


def laid_on(
    rng: np.random.Generator, place: Array, rpy: Array, speed: Array, shake: tuple[float, float] | None, vehicle: str
) -> tuple[Array, Array, dict[str, float]]:
    """A way and its angles with what shakes the body on top, at an IMU away from where the body turns about, and the root mean squares.

    Parameters
    ----------
    rng : Generator
    place, rpy : (n, 3) arrays
        m and rad.
    speed : (n,) array
        m/s.
    shake : (2,) tuple, optional
        Root mean square of the vibration, m/s^2 and rad/s.
    vehicle : str
        What it moves like.
    """
    n = speed.size
    t, shaken = np.arange(n) * DT, rpy
    measured = {"accel": 0.0, "gyro": 0.0}
    if shake is not None:
        loud = speed / max(float(np.max(speed)), 1e-9)
        if vehicle in ("car", "train", "walker"):
            level = 0.15 + 0.85 * loud
        else:
            level = 0.7 + 0.3 * low_pass(np.abs(coloured(rng, n, 0.02, 0.3)), 0.5)
        moved, turned = _shaken(rng, t, level, loud, rotor=vehicle in ("fixed_wing", "quadrotor", "boat"))
        a = np.diff(moved, 2, axis=0) / DT**2
        w = np.diff(turned, axis=0) / DT
        factor = shake[0] / float(np.sqrt(np.mean(a**2))), shake[1] / float(np.sqrt(np.mean(w**2)))
        place, shaken = place + factor[0] * moved, rpy + factor[1] * turned
        measured = {"accel": shake[0], "gyro": shake[1]}
    # the IMU does not sit where the vehicle turns about; what shakes it is stated where it sits
    off = rng.normal(0.0, (0.5, 0.3, 0.2))
    return place + rotate(rpy, off) - rotate(rpy[:1], off), shaken, measured


def _shaken(rng: np.random.Generator, t: Array, level: Array, loud: Array, rotor: bool) -> tuple[Array, Array]:
    """Displacement and turn of a body that a machine and the way shake: a few sources, each felt by all axes, and a little of each axis alone."""
    n = t.size
    moved, turned = np.zeros((n, 3)), np.zeros((n, 3))
    base = rng.uniform(22.0, 45.0)
    spin = base * (1.0 + 0.03 * coloured(rng, n, 0.01, 0.5)) if rotor else base * (0.35 + 0.65 * low_pass(loud, 1.0))
    phase = 2.0 * np.pi * np.cumsum(spin) * DT
    for harmonic in (1, 2, 3):
        w = 2.0 * np.pi * base * harmonic
        to_move, to_turn = rng.normal(size=(2, 3)) / harmonic
        tone = np.sin(harmonic * phase + rng.uniform(0.0, 2.0 * np.pi))
        moved += np.outer(level * tone / w**2, to_move)
        turned += np.outer(level * np.sin(harmonic * phase + rng.uniform(0.0, 2.0 * np.pi)) / w, to_turn)
    for _ in range(3):
        centre = rng.uniform(9.0, 60.0)
        low, high = centre / rng.uniform(1.1, 2.0), centre * rng.uniform(1.1, 2.0)
        to_move, to_turn = rng.normal(size=(2, 3))
        noise = rng.integers(2**32)
        moved += np.outer(level * coloured(np.random.default_rng(noise), n, low, high, 2), to_move)
        turned += np.outer(level * coloured(np.random.default_rng(noise), n, low, high, 1), to_turn)
    for axis in range(3):
        moved[:, axis] += 0.3 * level * coloured(rng, n, 8.0, 120.0, 2)
        turned[:, axis] += 0.3 * level * coloured(rng, n, 8.0, 120.0, 1)
    return moved, turned


_Path = tuple[Array, Array, Array, Array, Array, Array]


def steps(rng: np.random.Generator, t: Array, mean_s: float, values: Array) -> Array:
    """A value that is drawn anew after random times."""
    out = np.zeros(t.size)
    at = 0.0
    while at < t[-1]:
        out[t >= at] = rng.choice(values)
        at += rng.exponential(mean_s) + 0.3 * mean_s
    return out


def _car(rng: np.random.Generator, t: Array) -> _Path:
    speed = low_pass(steps(rng, t, 20.0, np.array([0.0, 6.0, 9.0, 13.0, 16.0, 22.0])), 2.5)
    speed[: 5 * RATE] = np.maximum(speed[: 5 * RATE], 8.0)
    speed = low_pass(speed, 1.0)
    turn = low_pass(steps(rng, t, 9.0, np.array([0.0, 0.0, 0.02, -0.02, 0.3, -0.3])), 0.7)
    turn = low_pass(turn * np.minimum(speed / 8.0, 1.0) * np.minimum(1.0, 14.0 / np.maximum(speed, 1.0)), 0.1)
    heading = rng.uniform(-3.0, 3.0) + np.cumsum(turn) * DT
    slope = low_pass(0.03 * coloured(rng, t.size, 0.002, 0.03), 1.0)
    bump = low_pass(coloured(rng, t.size, 0.5, 4.0), 0.02)
    rough = 0.003 * np.minimum(speed / 10.0, 2.0)
    a = np.gradient(speed, DT)
    return (
        speed,
        heading,
        speed * slope,
        low_pass(-0.006 * speed * turn, 0.2) + rough * bump,
        slope - low_pass(0.008 * a, 0.2) + rough * later(bump, 0.15),
        -0.01 * low_pass(speed * turn / 9.8, 0.2),
    )


def _train(rng: np.random.Generator, t: Array) -> _Path:
    speed = low_pass(steps(rng, t, 70.0, np.array([12.0, 25.0, 40.0, 0.0])), 8.0)
    speed[: 10 * RATE] = np.maximum(speed[: 10 * RATE], 12.0)
    speed = low_pass(speed, 6.0)
    turn = low_pass(steps(rng, t, 25.0, np.array([0.0, 0.01, -0.01, 0.02, -0.02])), 4.0)
    turn = low_pass(turn * np.minimum(speed / 20.0, 1.0), 0.2)
    heading = rng.uniform(-3.0, 3.0) + np.cumsum(turn) * DT
    # joints every 25 m, and a body that sways
    joint = 2.0 * np.pi * np.cumsum(speed) * DT / 25.0
    sway = 0.002 * np.minimum(speed / 20.0, 1.5) * low_pass(coloured(rng, t.size, 0.4, 1.5), 0.02)
    slope = low_pass(0.01 * coloured(rng, t.size, 0.002, 0.02), 3.0)
    return (
        speed,
        heading,
        speed * slope,
        low_pass(speed * turn / 9.8 * 0.6, 1.0) + sway,
        slope + 3e-4 * np.sin(joint),
        sway,
    )


def _walker(rng: np.random.Generator, t: Array) -> _Path:
    speed = low_pass(steps(rng, t, 25.0, np.array([0.0, 1.1, 1.4, 1.7])), 0.6)
    stride = 2.0 * np.pi * 0.9 * np.cumsum(0.15 + 0.85 * np.minimum(speed / 1.3, 1.2)) * DT
    active = low_pass(np.minimum(speed / 1.2, 1.0), 0.1)
    turn = low_pass(steps(rng, t, 8.0, np.array([0.0, 0.0, 0.4, -0.4, 1.0])), 0.5) * active
    heading = rng.uniform(-3.0, 3.0) + np.cumsum(turn) * DT + 0.06 * active * np.sin(stride)
    bob = 0.025 * active * 2.0 * np.gradient(stride, DT) * np.cos(2.0 * stride)
    speed = low_pass(np.maximum(speed + 0.12 * active * np.sin(2.0 * stride + 0.7), 0.0), 0.03)
    roll = 0.05 * active * np.sin(stride + 0.3) + 0.02 * low_pass(coloured(rng, t.size, 0.05, 0.6), 0.2)
    pitch = 0.04 * active * np.sin(2.0 * stride) + 0.05 + 0.02 * low_pass(coloured(rng, t.size, 0.05, 0.6), 0.2)
    return speed, heading, bob, roll, pitch, 0.03 * active * np.cos(stride)


def _boat(rng: np.random.Generator, t: Array) -> _Path:
    speed = 4.0 + low_pass(steps(rng, t, 40.0, np.array([0.0, 2.0, 5.0])), 4.0)
    turn = low_pass(steps(rng, t, 15.0, np.array([0.0, 0.0, 0.08, -0.08, 0.15])), 2.0)
    heading = rng.uniform(-3.0, 3.0) + np.cumsum(turn) * DT + 0.03 * coloured(rng, t.size, 0.06, 0.2)
    heave = 0.4 * coloured(rng, t.size, 0.08, 0.25)
    roll = 0.08 * coloured(rng, t.size, 0.1, 0.3) + 0.2 * turn
    return speed, heading, heave, roll, 0.04 * coloured(rng, t.size, 0.1, 0.3), 0.05 * coloured(rng, t.size, 0.03, 0.2)


def _fixed_wing(rng: np.random.Generator, t: Array) -> _Path:
    speed = rng.uniform(17.0, 45.0) + 2.0 * coloured(rng, t.size, 0.02, 0.2) + 0.3 * coloured(rng, t.size, 0.2, 3.0)
    bank = low_pass(steps(rng, t, 14.0, np.array([0.0, 0.0, 0.35, -0.35, 0.6, -0.6])), 1.2)
    turn = 9.8 * np.tan(bank) / speed
    climb = low_pass(steps(rng, t, 30.0, np.array([0.0, 0.0, 2.0, -2.0])), 3.0) + 0.4 * coloured(rng, t.size, 0.1, 2.0)
    heading = rng.uniform(-3.0, 3.0) + np.cumsum(turn) * DT
    gust = coloured(rng, t.size, 0.1, 4.0)
    crab = rng.uniform(-0.04, 0.04) + 0.01 * coloured(rng, t.size, 0.05, 1.0)
    return speed, heading, climb, bank + 0.02 * gust, 0.04 + climb / speed + 0.01 * later(gust, 0.3), crab


def _quadrotor(rng: np.random.Generator, t: Array) -> _Path:
    north, east, up = (
        low_pass(steps(rng, t, 8.0, np.array(v)), 1.3)
        for v in ([0.0, 4.0, -4.0, 8.0, -8.0], [0.0, 4.0, -4.0, 8.0, -8.0], [0.0, 0.0, 1.5, -1.5])
    )
    north += 0.25 * coloured(rng, t.size, 0.2, 2.0)
    east += 0.25 * coloured(rng, t.size, 0.2, 2.0)
    heading = (
        rng.uniform(-3.0, 3.0) + np.cumsum(low_pass(steps(rng, t, 10.0, np.array([0.0, 0.0, 0.5, -0.5])), 0.8)) * DT
    )
    an, ae = low_pass(np.gradient(north, DT), 0.05), low_pass(np.gradient(east, DT), 0.05)
    forward, right = an * np.cos(heading) + ae * np.sin(heading), ae * np.cos(heading) - an * np.sin(heading)
    wobble = 0.01 * coloured(rng, t.size, 0.5, 6.0)
    speed = np.hypot(north, east)
    crab = np.unwrap(np.arctan2(east, north)) - heading
    return speed, heading, up, np.arctan2(right, 9.8) + wobble, -np.arctan2(forward, 9.8) + later(wobble, 0.25), crab


_PATHS = {
    "car": _car,
    "train": _train,
    "walker": _walker,
    "boat": _boat,
    "fixed_wing": _fixed_wing,
    "quadrotor": _quadrotor,
}


# -- geometry -------------------------------------------------------------------------------------------------------------------------


def matrices(rpy: Array) -> Array:
    """Rotations (n, 3, 3) from body to the plane that the angles are about."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy).T, np.cos(rpy).T
    rows = [
        [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
        [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
        [-sp, sr * cp, cr * cp],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def rotate(rpy: Array, vector: Array) -> Array:
    """A body vector in the plane, (n, 3)."""
    return matrices(rpy) @ vector


def plane(lat: float, lon: float) -> Array:
    """Columns: north, east and down in Earth-centred axes."""
    s, c, so, co = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    return np.array([[-s * co, -so, -c * co], [-s * so, co, -c * so], [c, 0.0, -s]])


def ecef(llh: Array) -> Array:
    """Earth-centred position (m) of latitude, longitude (rad) and height (m)."""
    lat, lon, h = llh
    n = A / np.sqrt(1.0 - F * (2.0 - F) * np.sin(lat) ** 2)
    return np.array(
        [
            (n + h) * np.cos(lat) * np.cos(lon),
            (n + h) * np.cos(lat) * np.sin(lon),
            (n * (1.0 - F) ** 2 + h) * np.sin(lat),
        ]
    )


def geodetic(xyz: Array) -> Array:
    """Latitude, longitude (rad) and height (m) of Earth-centred positions (k, 3), iterated to the last digits."""
    x, y, z = np.atleast_2d(xyz).T
    e2, p = F * (2.0 - F), np.hypot(x, y)
    lat = np.arctan2(z, p * (1.0 - e2))
    for _ in range(8):
        n = A / np.sqrt(1.0 - e2 * np.sin(lat) ** 2)
        lat = np.arctan2(z + e2 * n * np.sin(lat), p)
    n = A / np.sqrt(1.0 - e2 * np.sin(lat) ** 2)
    h = p * np.cos(lat) + z * np.sin(lat) - A**2 / n
    return np.stack([lat, np.arctan2(y, x), h], axis=1)


def gravity(xyz: Array) -> Array:
    """Normal gravity (k, 3) in Earth-centred axes, along the ellipsoid's normal, to second order in height."""
    lat, lon, h = geodetic(xyz).T
    s2 = np.sin(lat) ** 2
    surface = GE * (1.0 + (A * (1.0 - F) * GP / (A * GE) - 1.0) * s2) / np.sqrt(1.0 - F * (2.0 - F) * s2)
    m = OMEGA**2 * A**2 * A * (1.0 - F) / GM
    g = surface * (1.0 - 2.0 / A * (1.0 + F + m - 2.0 * F * s2) * h + 3.0 * h**2 / A**2)
    down = -np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=1)
    return g[:, None] * down


@dataclass(frozen=True)
class Sensed:
    """What ideal sensors of a ride see.

    Parameters
    ----------
    t : (n,) array
        Ends of the milliseconds, s.
    rate, force : (n, 3) arrays
        Means over each millisecond in body axes, rad/s and m/s^2.
    place : (n, 3) array
        Earth-centred, m, less ``start``; velocities likewise.
    velocity : (n, 3) array
    attitude : (n, 3, 3) array
        Body to Earth-centred axes.
    start : (3,) array
    """

    t: Array
    rate: Array
    force: Array
    place: Array
    velocity: Array
    attitude: Array
    start: Array


def sense(ride: Ride) -> Sensed:
    """Ideal rates and specific forces by differences; positions stay small numbers, so that second differences keep their digits."""
    axes = plane(ride.origin[0], ride.origin[1])
    start = ecef(ride.origin)
    place = ride.place @ axes.T
    attitude = axes @ matrices(ride.rpy)
    velocity = np.gradient(place, DT, axis=0)
    acceleration = np.zeros_like(place)
    acceleration[1:-1] = np.diff(place, 2, axis=0) / DT**2
    acceleration[[0, -1]] = acceleration[[1, -2]]
    spin = np.array([0.0, 0.0, OMEGA])
    # gravity changes over metres, not over milliseconds
    few = np.arange(0, place.shape[0] + 49, 50).clip(max=place.shape[0] - 1)
    own = gravity(start + place[few])
    at = np.arange(place.shape[0])
    g = np.stack([np.interp(at, few, column) for column in own.T], axis=1)
    force = acceleration + 2.0 * np.cross(spin, velocity) - g
    body = np.einsum("nji,nj->ni", attitude, force)
    step = np.einsum("nji,njk->nik", attitude[:-1], attitude[1:])
    rate = rotation_vectors(step) / DT
    middle = 0.5 * (attitude[:-1] + attitude[1:])
    rate += np.einsum("nji,j->ni", middle, spin)
    t = np.arange(place.shape[0]) * DT
    return Sensed(t[1:], rate, 0.5 * (body[1:] + body[:-1]), place[1:], velocity[1:], attitude[1:], start)


def rotation_vectors(step: Array) -> Array:
    """Vectors of small rotations (n, 3, 3)."""
    skew = 0.5 * np.stack(
        [step[:, 2, 1] - step[:, 1, 2], step[:, 0, 2] - step[:, 2, 0], step[:, 1, 0] - step[:, 0, 1]], axis=1
    )
    size = np.linalg.norm(skew, axis=1, keepdims=True)
    return skew * np.where(size > 1e-12, np.arcsin(np.minimum(size, 1.0)) / np.maximum(size, 1e-12), 1.0)
