"""Short physics that turns a preset's few numbers into spectra: roads and rails through a half car, gusts through airframes, waves through a hull.

Every part gives terms: a one-sided density of an input (a road's height, a gust, a wave) and the response (m, 6) of the axes to it, as a perfect IMU
feels it. Terms are independent; axes that answer the same term are coherent, with the phase of their responses.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.units import STANDARD_GRAVITY as G

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Term = tuple[Array, Complex]

#: ISO 8608:2016, table C.1: Gd(n0) in m^3 at n0 = 0.1 cycles/m, the geometric means of the classes; the waviness is 2.
ROADS = {name: 16e-6 * 4.0**k for k, name in enumerate("ABCDEFGH")}
N0 = 0.1
#: Contact length of a tyre over which the road is averaged, m.
PATCH = 0.15
#: Wavelength in tracks at which the two tracks of a road lose half of their coherence (isotropic roughness; Kamash and Robson 1978).
TRACK_WAVES = 4.0
#: ERRI B176 (Claus and Schiehlen 1998): corner wavenumbers in rad/m, and Ap, Aa in m rad of good and of poor track.
RAIL_LOW, RAIL_HIGH = 0.0206, 0.8246
RAILS = {"low": (4.032e-7, 2.119e-7), "high": (1.080e-6, 6.125e-7)}
_FOOT = 0.3048
#: Slowest airspeed for which a gust spectrum is asked, m/s.
_LEAST_AIR = 3.0


def felt(f: Array, **moves: Complex) -> Complex:
    """Rates and specific force (m, 6) of displacements (surge, sway, heave up, m) and angles (roll, pitch, yaw, rad) per unit of input.

    Parameters
    ----------
    f : (m,) array
        Hz.
    **moves : (m,) complex arrays
    """
    w = 2.0 * np.pi * f
    zero = np.zeros(f.shape, complex)
    surge, sway, heave, roll, pitch, yaw = (
        moves.get(k, zero) for k in ("surge", "sway", "heave", "roll", "pitch", "yaw")
    )
    rates = [1j * w * x for x in (roll, pitch, yaw)]
    forces = [-w * w * surge + G * pitch, -w * w * sway - G * roll, w * w * heave]
    return np.stack([*rates, *forces], axis=1)


def second_order(f: Array, frequency: float, damping: float) -> Complex:
    """``w0^2 / (w0^2 - w^2 + 2 i z w0 w)``.

    Parameters
    ----------
    f : (m,) array
        Hz.
    frequency, damping : float
        Hz, share of the critical one.
    """
    r = f / frequency
    return np.asarray(1.0 / (1.0 - r * r + 2j * damping * r))


@dataclass(frozen=True)
class _Axle:
    """A quarter car: motion of the body and of the wheel over that of the road."""

    body: Complex
    wheel: Complex

    @classmethod
    def of(cls, f: Array, body_hz: float, damping: float, wheel_hz: float, ratio: float) -> _Axle:
        w, wb = 2.0 * np.pi * f, 2.0 * np.pi * body_hz
        spring = wb * wb + 2j * damping * wb * w
        tyre = ratio * (2.0 * np.pi * wheel_hz) ** 2
        over = spring / (spring - w * w)
        wheel = tyre / (tyre + spring - ratio * w * w - spring * over)
        return cls(np.asarray(over * wheel), np.asarray(wheel))


def road(f: Array, v: float, p: Mapping[str, Any]) -> list[Term]:
    """A half car (independent axles) on a road of ISO 8608: pitch follows heave by the wheelbase.

    Parameters
    ----------
    f : (m,) array
    v : float
        m/s.
    p : mapping
        ``roughness`` (class A to H or m^3), ``body`` [Hz, damping], ``wheel`` [Hz, mass ratio], ``roll`` [Hz, damping], ``wheelbase``, ``track``,
        ``height`` of the reference point above the roll axis in m; ``through`` and ``twist``: shares of the wheels' acceleration that arrive
        as accelerations (3) and as angular accelerations per metre (3), each by its own way through the structure.
    """
    if v < 0.1:
        return []
    level = ROADS[p["roughness"]] if isinstance(p["roughness"], str) else float(p["roughness"])
    n = f / v
    height = level * N0**2 / np.maximum(n, 0.01) ** 2 / v * np.sinc(n * PATCH) ** 2
    return _rolling(f, v, p, height, 0.5 ** (n * p["track"] * TRACK_WAVES), None)


def rail(f: Array, v: float, p: Mapping[str, Any]) -> list[Term]:
    """Irregularities of a track (ERRI B176) through bogies and secondary springs; keys of :func:`road`, ``roughness`` being low or high.

    Parameters
    ----------
    f : (m,) array
    v : float
    p : mapping
    """
    if v < 0.1:
        return []
    if p["roughness"] not in RAILS:
        raise InputError(f"roughness of a rail is '{p['roughness']}', expected low or high")
    k = 2.0 * np.pi * f / v
    # two-sided in rad/m to one-sided in Hz
    shape = 2.0 * np.pi / v * 2.0 * RAIL_HIGH**2 / ((k**2 + RAIL_LOW**2) * (k**2 + RAIL_HIGH**2))
    return _rolling(f, v, p, RAILS[p["roughness"]][0] * shape, np.full(f.shape, 0.8), RAILS[p["roughness"]][1] * shape)


def _rolling(
    f: Array, v: float, p: Mapping[str, Any], height: Array, coherence: Array, sideways: Array | None
) -> list[Term]:
    """Both tracks alike, both tracks against each other, the track's alignment, and what comes through the structure."""
    w, base, track = 2.0 * np.pi * f, float(p["wheelbase"]), float(p["track"])
    axle = _Axle.of(f, *p["body"], *p["wheel"])
    later = np.exp(-1j * w * base / v)
    both, against = 0.5 * (1.0 + later), (1.0 - later) / base
    leaned = second_order(f, *p["roll"]) * axle.wheel * 2.0 / track * both
    out = [
        (height * 0.5 * (1.0 + coherence), felt(f, heave=axle.body * both, pitch=axle.body * against)),
        (height * 0.5 * (1.0 - coherence), felt(f, roll=leaned, sway=leaned * p["height"])),
    ]
    if sideways is not None:
        swung = second_order(f, *p["roll"])
        out.append(
            (sideways, felt(f, sway=swung * both, yaw=swung * against, roll=-swung * both / max(p["height"], 0.5)))
        )
    jolts = height * np.abs(w * w * axle.wheel) ** 2
    for k in range(3):
        for share, column, turn in ((p["through"][k], 3 + k, 1.0), (p["twist"][k], k, 1.0 / np.maximum(w, 1e-9))):
            response = np.zeros((f.size, 6), complex)
            response[:, column] = share * turn
            out.append((jolts, response))
    return out


def _gusts(f: Array, v: float, p: Mapping[str, Any]) -> tuple[Array, Array, Array, Array]:
    """Dryden gusts (MIL-F-8785C 3.7.2, MIL-HDBK-1797A) below 1000 feet along, across, vertical (m/s)^2/Hz, and of rolling, (rad/s)^2/Hz."""
    v = max(v, _LEAST_AIR, 0.5 * p["wind"])
    feet = np.clip(p["height"] / _FOOT, 10.0, 1000.0)
    low = 0.177 + 0.000823 * feet
    w, sigma_w = 2.0 * np.pi * f, 0.1 * p["wind"]
    sigma_u, long, tall = sigma_w / low**0.4, _FOOT * feet / low**1.2, _FOOT * feet
    u = sigma_u**2 * 2.0 * long / (np.pi * v) / (1.0 + (long * w / v) ** 2)
    y, z = (long * w / v) ** 2, (tall * w / v) ** 2
    across = sigma_u**2 * long / (np.pi * v) * (1.0 + 3.0 * y) / (1.0 + y) ** 2
    up = sigma_w**2 * tall / (np.pi * v) * (1.0 + 3.0 * z) / (1.0 + z) ** 2
    b = p["span"]
    roll = (
        sigma_w**2
        / (v * tall)
        * 0.8
        * (np.pi * tall / (4.0 * b)) ** (1.0 / 3.0)
        / (1.0 + (4.0 * b * w / (np.pi * v)) ** 2)
    )
    return tuple(np.asarray(2.0 * np.pi * x) for x in (u, across, up, roll))  # type: ignore[return-value]


def wing(f: Array, v: float, p: Mapping[str, Any]) -> list[Term]:
    """Gusts through short period, Dutch roll and roll subsidence of an aeroplane (Etkin 1972, chapter 13, two degrees of freedom each).

    Parameters
    ----------
    f : (m,) array
    v : float
        m/s; aerodynamic rates grow with it.
    p : mapping
        ``wind`` (at 6 m, m/s), ``height`` m, ``span`` m, ``speed`` m/s at which the following hold: ``pitch`` [Hz, damping], ``yaw`` [Hz, damping],
        ``heave`` (Z_w), ``side`` (Y_v) and ``roll`` (L_p), 1/s.
    """
    if v < 0.4 * p["speed"]:
        return []  # on the ground
    w, scale = 2.0 * np.pi * f, v / p["speed"]
    s = 1j * w
    lag = 1.0 / (1.0 + s * p["span"] / (2.0 * v))
    u, across, up, roll = _gusts(f, v, p)
    hz, z = p["pitch"][0] * scale, p["pitch"][1]
    mode = second_order(f, hz, z)
    turning = lag * mode / v  # the nose follows the wind: angle over gust
    freely = lag * (1.0 - mode) / (s * s)
    hz_yaw, z_yaw = p["yaw"][0] * scale, p["yaw"][1]
    follow = lag * second_order(f, hz_yaw, z_yaw) / v
    aside = lag * (1.0 - second_order(f, hz_yaw, z_yaw)) / (s * s)
    rolling = 1.0 / (1.0 + s / (p["roll"] * scale)) / s
    drag = 0.1 * p["heave"] * scale * lag / (s * s) * s / (s + 2.0 * np.pi * 0.2)
    return [
        (up, felt(f, heave=p["heave"] * scale * freely, pitch=-turning)),
        (across, felt(f, sway=p["side"] * scale * aside, yaw=-follow, roll=0.5 * follow)),
        (roll, felt(f, roll=rolling * (s / (s + 2.0 * np.pi * 0.1)))),
        (u, felt(f, surge=drag)),
    ]


def rotorcraft(f: Array, v: float, p: Mapping[str, Any]) -> list[Term]:
    """Gusts on what hangs under rotors and leans against the wind: in body axes it feels the drag alone.

    Parameters
    ----------
    f : (m,) array
    v : float
    p : mapping
        ``wind``, ``height``, ``span``; ``drag`` and ``heave`` 1/s; ``hold`` [Hz, damping] of the position loop, ``attitude`` [Hz, damping] of the
        attitude loop; ``moment``: angular acceleration per gust, rad/s^2 per m/s; ``yaw``: share of it about the vertical.
    """
    s = 2j * np.pi * f
    out: list[Term] = []
    u, across, up, _ = _gusts(f, v, p)
    free = 1.0 - second_order(f, *p["hold"])
    lag = 1.0 / (1.0 + s * p["span"] / (2.0 * max(v, _LEAST_AIR)))
    moved, lean = p["drag"] * lag * free / (s * s), p["drag"] * lag * (1.0 - free) / G
    out += [(u, felt(f, surge=moved, pitch=lean)), (across, felt(f, sway=moved, roll=-lean))]
    out.append((up, felt(f, heave=p["heave"] * lag * free / (s * s))))
    turned = p["moment"] * lag * second_order(f, *p["attitude"]) / (2.0 * np.pi * p["attitude"][0]) ** 2
    return [*out, (up, felt(f, roll=turned)), (up, felt(f, pitch=turned)), (up, felt(f, yaw=p["yaw"] * turned))]


def hull(f: Array, v: float, p: Mapping[str, Any]) -> list[Term]:
    """JONSWAP waves (Hasselmann 1973, peak 3.3) met on the bow quarter, through a hull that averages them over its length.

    Parameters
    ----------
    f : (m,) array
        Hz, of encounter.
    v : float
        m/s.
    p : mapping
        ``waves`` [significant height m, peak period s]; ``length`` m; ``heave`` and ``roll`` [Hz, damping]; ``wind`` m/s, which only drifts it.
    """
    height, period = p["waves"]
    along = v * np.sqrt(0.5) / G
    # w_e = w + w^2 v cos / g
    we = 2.0 * np.pi * f
    w = we if along < 1e-6 else (np.sqrt(1.0 + 4.0 * along * we) - 1.0) / (2.0 * along)
    density = _jonswap(w, height, period) / (1.0 + 2.0 * along * w) * 2.0 * np.pi
    k = w * w / G
    averaged = np.exp(-0.5 * (k * np.sqrt(0.5) * p["length"] / np.pi) ** 2)
    heave = averaged * second_order(f, *p["heave"])
    slope = k * np.sqrt(0.5)
    roll = slope * averaged * second_order(f, *p["roll"])
    around = 1j * averaged
    return [
        (
            density,
            felt(
                f, heave=heave, pitch=-1j * slope * heave, roll=-1j * roll, surge=around * np.sqrt(0.5), sway=around * np.sqrt(0.5),
                yaw=0.3 * slope * averaged + 0j,
            ),
        )
    ]  # fmt: skip


def _jonswap(w: Array, height: float, period: float) -> Array:
    """m^2 s, one-sided in rad/s, scaled to its significant height."""

    def shape(w: Array) -> Array:
        x = np.maximum(w * period / (2.0 * np.pi), 1e-3)
        peak = np.exp(-0.5 * ((x - 1.0) / np.where(x < 1.0, 0.07, 0.09)) ** 2)
        return np.asarray(x**-5.0 * np.exp(-1.25 * x**-4.0) * 3.3**peak)

    grid = np.linspace(0.01, 40.0, 40_000) / period
    return np.asarray(shape(w) * (height**2 / 16.0) / np.trapezoid(shape(grid), grid))


def mode(f: Array, v: float, p: Mapping[str, Any]) -> list[Term]:
    """A resonance of structure, limb or mount that something broad drives: the axes' root mean squares, each by itself.

    Parameters
    ----------
    f : (m,) array
    v : float
    p : mapping
        ``at`` [Hz, damping]; ``accel`` (3) m/s^2, ``gyro`` (3) rad/s; ``standing``: share while the vehicle stands.
    """
    shape = np.abs(second_order(f, *p["at"]) * (f / p["at"][0])) ** 2
    share = p.get("standing", 1.0) if v < 0.1 else 1.0
    shape = shape * share**2 / np.trapezoid(shape, f)
    out: list[Term] = []
    for k, rms in enumerate((*p["gyro"], *p["accel"])):
        response = np.zeros((f.size, 6), complex)
        response[:, k] = rms
        out.append((shape, response))
    return out


#: How many numbers each key of what rolls takes; 0 for a name.
_ROLLING = {
    "roughness": 0,
    "body": 2,
    "wheel": 2,
    "roll": 2,
    "wheelbase": 1,
    "track": 1,
    "height": 1,
    "through": 3,
    "twist": 3,
}


#: Parts of a preset that give terms, and the numbers that each takes: 1, or how many.
PARTS: Mapping[str, tuple[Callable[[Array, float, Mapping[str, Any]], list[Term]], Mapping[str, int]]] = {
    "road": (road, _ROLLING),
    "rail": (rail, _ROLLING),
    "wing": (
        wing,
        {"wind": 1, "height": 1, "span": 1, "speed": 1, "pitch": 2, "yaw": 2, "heave": 1, "side": 1, "roll": 1},
    ),
    "rotorcraft": (
        rotorcraft,
        {"wind": 1, "height": 1, "span": 1, "drag": 1, "heave": 1, "hold": 2, "attitude": 2, "moment": 1, "yaw": 1},
    ),
    "hull": (hull, {"waves": 2, "length": 1, "heave": 2, "roll": 2, "wind": 1}),
    "mode": (mode, {"at": 2, "accel": 3, "gyro": 3, "standing": 1}),
}
