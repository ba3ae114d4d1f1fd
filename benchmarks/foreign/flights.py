"""Flights of JSBSim, a flight dynamics model that others wrote: aeroplanes in turbulent air, held on their way by a plain autopilot.

``pip install jsbsim`` brings the program and the data of its aeroplanes. It integrates the motion; what an IMU sees follows from that by the
differences of :mod:`benchmarks.foreign.motion`.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from benchmarks.foreign.motion import DT, Array, Ride, draw_origin, ecef, geodetic, laid_on, matrices, plane, steps

#: Speed (knots of calibrated airspeed) and height (m) at which each is flown: from a light aeroplane to a fighter and an airliner.
AIRCRAFT = {
    "c172p": (95.0, 900.0),
    "DHC6": (130.0, 1500.0),
    "T38": (300.0, 2500.0),
    "A4": (300.0, 2500.0),
    "f16": (300.0, 2500.0),
    "A320": (250.0, 3000.0),
}
FOOT = 0.3048
#: Wind at 20 ft, ft/s, between light and moderate turbulence, and the severity (of seven) of its tables above that.
WIND, SEVERITY = (5.0, 30.0), (1, 2, 3)
#: Milliseconds between two commands of the autopilot.
CONTROLLED = 20


def flight(rng: np.random.Generator, aircraft: str, seconds: float, shake: tuple[float, float] | None) -> Ride:
    """Draw a flight; what shakes the body besides the air is laid on top as it is on other rides.

    Parameters
    ----------
    rng : Generator
    aircraft : str
        One of :data:`AIRCRAFT`.
    seconds : float
    shake : (2,) tuple, optional
        Root mean square of the vibration, m/s^2 and rad/s.
    """
    lat, lon, _ = draw_origin(rng)
    place, rpy, speed, origin = flown(aircraft, seconds, int(rng.integers(2**31)), float(lat), float(lon))
    place, rpy, measured = laid_on(rng, place, rpy, speed, shake, "fixed_wing")
    return Ride(place, rpy, origin, measured)


@lru_cache(maxsize=4)
def flown(aircraft: str, seconds: float, seed: int, lat: float, lon: float) -> tuple[Array, Array, Array, Array]:
    """Way (n, 3) and angles (n, 3) in the start's tangent plane, speed (n,), and the start: m, rad, m/s; latitude, longitude (rad), height (m).

    Parameters
    ----------
    aircraft : str
    seconds : float
    seed : int
        Of the turbulence and of the commands.
    lat, lon : float
        Of the start, rad.
    """
    import jsbsim

    rng = np.random.default_rng(seed)
    knots, height = AIRCRAFT[aircraft]
    n = round(seconds / DT)
    t = np.arange(n) * DT
    # commands that are slow enough for an airliner
    bank = steps(rng, t, 25.0, np.array([0.0, 0.0, 0.35, -0.35, 0.6, -0.6]))
    climb = steps(rng, t, 40.0, height + np.array([-60.0, -30.0, 0.0, 30.0, 60.0]))
    jsbsim.FGJSBBase().debug_lvl = 0
    sim = jsbsim.FGFDMExec(None)
    sim.set_debug_level(0)
    sim.load_model(aircraft)
    sim.disable_output()  # some of them write their states to a file in the working folder
    sim.set_dt(DT)
    sim["ic/lat-geod-deg"], sim["ic/long-gc-deg"] = math.degrees(lat), math.degrees(lon)
    sim["ic/h-sl-ft"], sim["ic/vc-kts"] = height / FOOT, knots
    sim["ic/psi-true-deg"], sim["ic/gamma-deg"] = rng.uniform(0.0, 360.0), 0.0
    sim["simulation/randomseed"] = seed % 10**6
    sim.run_ic()
    sim["propulsion/set-running"] = -1
    sim["simulation/do_simple_trim"] = 1
    sim["atmosphere/turb-type"] = 3
    sim["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = rng.uniform(*WIND)
    sim["atmosphere/turbulence/milspec/severity"] = int(rng.choice(SEVERITY))
    states = [f"position/ecef-{a}-ft" for a in "xyz"] + [f"attitude/{a}-rad" for a in ("phi", "theta", "psi")]
    read = [sim.get_property_manager().get_node(name) for name in states]
    level, elevator, aileron = (
        sim[f"{k}"] for k in ("attitude/theta-rad", "fcs/elevator-cmd-norm", "fcs/aileron-cmd-norm")
    )
    pushed = pulled = 0.0
    out = np.empty((n, 6))
    for k in range(n):
        out[k] = [node.get_double_value() for node in read]
        if k % CONTROLLED == 0:
            short = knots - sim["velocities/vc-kts"]
            pushed = float(np.clip(pushed + 4e-5 * short, -0.6, 0.6))
            sim["fcs/throttle-cmd-norm"] = float(np.clip(0.6 + 0.02 * short + pushed, 0.0, 1.0))
            roll, rate = sim["attitude/phi-rad"], sim["velocities/p-rad_sec"]
            sim["fcs/aileron-cmd-norm"] = float(np.clip(aileron + (bank[k] - roll) - 0.3 * rate, -1.0, 1.0))
            below = climb[k] - sim["position/h-sl-ft"] * FOOT
            nose = level + float(np.clip(0.01 * below - 0.02 * sim["velocities/h-dot-fps"] * FOOT, -0.2, 0.2))
            low = nose - sim["attitude/theta-rad"]
            pulled = float(np.clip(pulled + 6e-3 * low, -0.3, 0.3))
            pull = 2.0 * low + pulled - 0.6 * sim["velocities/q-rad_sec"]
            sim["fcs/elevator-cmd-norm"] = float(np.clip(elevator - pull, -1.0, 1.0))
        sim.run()
    xyz = out[:, :3] * FOOT
    origin = geodetic(xyz[:1])[0]
    axes = plane(origin[0], origin[1])
    place = (xyz - ecef(origin)) @ axes
    return (
        place,
        _in_plane(out[:, 3:], geodetic(xyz), axes),
        np.linalg.norm(np.gradient(place, DT, axis=0), axis=1),
        origin,
    )


def _in_plane(rpy: Array, llh: Array, axes: Array) -> Array:
    """Angles about the local level turned into angles about the start's tangent plane."""
    s, c, so, co = np.sin(llh[:, 0]), np.cos(llh[:, 0]), np.sin(llh[:, 1]), np.cos(llh[:, 1])
    zero = np.zeros_like(s)
    local = np.moveaxis(np.array([[-s * co, -so, -c * co], [-s * so, co, -c * so], [c, zero, -s]]), 2, 0)
    m = axes.T @ local @ matrices(rpy)
    roll, pitch = np.arctan2(m[:, 2, 1], m[:, 2, 2]), -np.arcsin(m[:, 2, 0])
    return np.stack([roll, pitch, np.unwrap(np.arctan2(m[:, 1, 0], m[:, 0, 0]))], axis=1)
