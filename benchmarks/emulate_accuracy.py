"""How exact the emulator is: every acceptance figure of emulation and mechanization, measured and printed.

Run ``python benchmarks/emulate_accuracy.py`` (about a minute). Parts that need shared reference data say so where it is absent. Exit code 1
where a figure misses its limit.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pymap3d
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.signal import welch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from insemu import earth, rotation, strapdown
from insemu.emulate import TRAJECTORIES, Flight, Track, built_in, ideal_imu, navigation_error, smooth_track
from insemu.emulate.drives import drives
from insemu.emulate.reckon import dead_reckon
from insemu.emulate.track import held_out_distance, turn_rate
from insemu.emulate.trajectory import turbulent_uav
from insemu.formats import read_recording
from insemu.records import ImuRecord, Recording, Trajectory

Array = NDArray[np.float64]
missed: list[str] = []


def say(name: str, value: float, unit: str, limit: float | None = None, *, least: bool = False) -> None:
    """Print a figure beside its limit."""
    verdict = ""
    if limit is not None:
        good = value >= limit if least else value <= limit
        verdict = f"  {'at least' if least else 'at most'} {limit:g}: {'holds' if good else 'MISSED'}"
        if not good:
            missed.append(name)
    print(f"  {name:<58}{value:>12.4g} {unit:<6}{verdict}")


def shared(relative: str) -> Path | None:
    root = Path(os.environ.get("INSEMU_SHARED", Path(__file__).resolve().parents[2] / "shared"))
    path = root / relative
    if not path.exists():
        print(f"  (absent: {relative}; set INSEMU_SHARED)")
        return None
    return path


def largest(errors: Array) -> tuple[float, float]:
    return float(np.linalg.norm(errors[:, :3], axis=1).max()), float(np.linalg.norm(errors[:, 6:], axis=1).max())


def exact() -> None:
    print("\nexact mode, 100 Hz, 20 minutes (or the whole flight): mechanization against its reference")
    flights = [built_in(name) for name in TRAJECTORIES]
    sources = [(f.name, f.path) for f in flights]
    drive = shared("real/rtkexp_drive.npz")
    if drive is not None:
        gnss = read_recording(drive).gnss
        sources.append(("path of rtkexp_drive", smooth_track(gnss).path))
    for name, path in sources:
        ideal = ideal_imu(path, span=(path.start, min(path.end, path.start + 1200.0)))
        nav = strapdown.mechanize(ideal.imu, ideal.reference)
        position = np.linalg.norm(earth.position_difference(nav.llh, ideal.reference.llh), axis=1).max()
        say(f"{name}: position", position, "m", 1e-6)
        say(f"{name}: attitude", np.abs(rotation.attitude_difference(nav.rpy, ideal.reference.rpy)).max(), "rad", 1e-9)
        say(f"{name}: distance from the requested path", ideal.path_distance_m, "m")


def continuous() -> None:
    print("\ncontinuous mode, increments, our mechanization, 20 minutes (or the whole drive)")
    limits = {"urban_drive_1": 0.010, "urban_drive_2": 0.010, "turbulent_uav": 0.050}
    for name in TRAJECTORIES:
        path = built_in(name).path
        span = (path.start, min(path.end, path.start + 1200.0))
        at = {}
        for rate in (50.0, 100.0, 200.0):
            ideal = ideal_imu(path, rate, mode="continuous", span=span)
            at[rate] = largest(navigation_error(ideal))[0]
        say(f"{name}: largest position error at 100 Hz", at[100.0], "m", limits.get(name))
        if name != "static":  # at rest there is nothing but rounding
            for coarse in (50.0, 100.0):
                factor = at[coarse] / at[2 * coarse]
                say(
                    f"{name}: {coarse:g} to {2 * coarse:g} Hz divides by (order {np.log2(factor):.1f})",
                    factor,
                    "",
                    3.5,
                    least=True,
                )


def turbulence() -> None:
    print(
        "\nhow turbulent the turbulent UAV is: rms of the angular rate, deg/s, by band (0.1-0.5, 0.5-2, 2-10 Hz) and axis"
    )
    flights = {"ours": ideal_imu(built_in("turbulent_uav").path, mode="continuous").imu.gyro[10000:110000]}
    file = shared("fixtures/inertial/uav_100hz.npz")
    if file is not None:
        flights["fixture uav_100hz"] = np.load(file)["gyro_incr"]
    for name, gyro in flights.items():
        f, psd = welch(np.rad2deg(100.0 * gyro), 100.0, nperseg=4096, axis=0)
        rms = [
            np.sqrt(psd[(f >= low) & (f < high)].sum(axis=0) * f[1])
            for low, high in ((0.1, 0.5), (0.5, 2.0), (2.0, 10.0))
        ]
        print(f"  {name:<20}" + "   ".join("/".join(f"{x:.1f}" for x in band) for band in rms))
    light = np.rad2deg(1.9 * 0.77 / np.sqrt(100.0 * 2.0))
    say("roll rate of light Dryden turbulence, span 2 m at 100 m", light, "deg/s")
    path = turbulent_uav(2.0).path
    at = [largest(navigation_error(ideal_imu(path, r, mode="continuous")))[0] for r in (100.0, 200.0)]
    say("twice the gusts (moderate): largest position error at 100 Hz", at[0], "m")
    say("twice the gusts (moderate): at 200 Hz", at[1], "m")


def fixtures() -> None:
    print("\nincrements made by another program, first-order free-air gravity")
    for name, limit in (("car", 0.020), ("uav", 0.065)):
        file = shared(f"fixtures/inertial/{name}_100hz.npz")
        if file is None:
            continue
        data = np.load(file)
        llh = data["lla"].copy()
        llh[:, :2] = np.deg2rad(llh[:, :2])
        reference = Trajectory(data["time"], llh, data["vel_ned"], np.deg2rad(data["rph"]))
        imu = ImuRecord(data["time"], data["gyro_incr"], data["accel_incr"], "increment")
        result = dead_reckon(Recording(imu, None, reference, name), gravity="free_air_first_order")
        say(f"{name}_100hz: largest position error", result.max_position_error_m, "m", limit)
        say(f"{name}_100hz: largest attitude error", result.max_attitude_error_rad, "rad")


def at_rest(
    hours: float, rate: float, lat: float, tilt: Array
) -> tuple[ImuRecord, strapdown.NavState, strapdown.NavState]:
    t = np.arange(round(hours * 3600 * rate) + 1) / rate
    rpy, h = np.array([0.02, -0.03, 0.7]), 200.0
    c = rotation.dcm_from_rpy(rpy)
    gyro = np.broadcast_to(c.T @ earth.earth_rate(lat) / rate, (t.size, 3))
    accel = np.broadcast_to(c.T @ [0, 0, -float(earth.gravity(lat, h))] / rate, (t.size, 3))
    level = strapdown.NavState(np.array([lat, 0.1, h]), np.zeros(3), rpy)
    tilted = strapdown.NavState(level.llh, level.vel_ned, rotation.rpy_from_dcm(rotation.dcm_from_vector(tilt) @ c))
    return ImuRecord(t, gyro, accel, "increment"), level, tilted


def rest() -> None:
    print("\nat rest, height and vertical velocity held")
    for lat in (0.8, -0.3):
        imu, level, _ = at_rest(24.0, 100.0, lat, np.zeros(3))
        nav = strapdown.mechanize_array(imu, level, vertical="held")
        off = earth.position_difference(nav[:, :3], level.llh)
        say(
            f"horizontal drift in 24 h at 100 Hz, latitude {lat:g} rad", np.hypot(off[:, 0], off[:, 1]).max(), "m", 1e-3
        )
    for lat in (0.0, 0.3):
        for axis in (0, 1):
            phi = np.array([0.0, 1e-5, 0.0]) if axis == 0 else np.array([1e-5, 0.0, 0.0])
            imu, level, tilted = at_rest(3.0, 1.0, lat, phi)
            v = strapdown.mechanize(imu, tilted, vertical="held").vel_ned[:, axis]
            t = imu.t
            slow = [np.ones_like(t), np.cos(earth.RATE * t), np.sin(earth.RATE * t)]
            foucault = np.cos(earth.RATE * np.sin(lat) * t)
            radius = float(earth.radii(lat)[axis]) + level.llh[2]
            expected = 2 * np.pi * np.sqrt(radius / float(earth.gravity(lat, level.llh[2])))

            def misfit(
                period: float, t: Array = t, v: Array = v, slow: list[Array] = slow, f: Array = foucault
            ) -> float:
                w = 2 * np.pi / period
                basis = np.column_stack([*slow, f * np.cos(w * t), f * np.sin(w * t)])
                return float(np.linalg.lstsq(basis, v, rcond=None)[1][0])

            period = minimize_scalar(misfit, bracket=(0.99 * expected, 1.01 * expected)).x
            name = f"Schuler period, {'north' if axis == 0 else 'east'}, latitude {lat:g} rad: off by"
            say(name, 100 * abs(period / expected - 1), "%", 0.1)


def inverse_error(llh: Array, ecef: Array) -> float:
    """Largest distance in m between the places of ``llh`` in extended precision and ``ecef``, beyond half of the angles' spacing."""
    lat, lon, h = llh.T.astype(np.longdouble)
    f = np.longdouble(1e9) / np.longdouble(298257223563)
    s, c, b = np.sin(lat), np.cos(lat), earth.A * (1 - f)
    rn = earth.A**2 / np.sqrt((earth.A * c) ** 2 + (b * s) ** 2)
    p = (rn + h) * c
    place = np.stack([p * np.cos(lon), p * np.sin(lon), (rn * (b / earth.A) ** 2 + h) * s], axis=1)
    distance = np.linalg.norm((place - ecef).astype(float), axis=1)
    spacing = earth.A * np.spacing(np.abs(llh[:, :2])) * np.column_stack([np.ones_like(llh[:, 0]), np.cos(llh[:, 0])])
    return float((distance - 0.5 * np.hypot(*spacing.T)).max())


def geodesy() -> None:
    print("\nWGS-84")
    rng = np.random.default_rng(1)
    llh = np.column_stack(
        [np.arcsin(rng.uniform(-1, 1, 2000)), rng.uniform(-np.pi, np.pi, 2000), rng.uniform(-1e3, 2e4, 2000)]
    )
    theirs = np.column_stack(pymap3d.geodetic2ecef(*llh.T, deg=False))
    say("to Earth-fixed axes, against pymap3d", np.abs(earth.llh_to_ecef(llh) - theirs).max(), "m", 1e-9)
    back = earth.ecef_to_llh(theirs)
    say("from Earth-fixed axes, beyond the last digit of the angles", inverse_error(back, theirs), "m", 1e-9)
    peer = np.column_stack(pymap3d.ecef2geodetic(*theirs.T, deg=False))
    say("the same of pymap3d itself", inverse_error(peer, theirs), "m")
    origin = np.array([0.8, 0.2, 350.0])
    near = earth.ned_to_llh(rng.uniform(-5e3, 5e3, (500, 3)), origin)
    east, north, up = pymap3d.geodetic2enu(*near.T, *origin, deg=False)
    off = np.abs(earth.llh_to_ned(near, origin) - np.column_stack([north, east, -up])).max()
    say("into the local frame, against pymap3d", off, "m", 1e-9)
    ned = rng.uniform(-5e3, 5e3, (500, 3))
    theirs = np.column_stack(pymap3d.enu2ecef(ned[:, 1], ned[:, 0], -ned[:, 2], *origin, deg=False))
    say("out of the local frame, against pymap3d", np.abs(earth.ned_to_ecef(ned, origin) - theirs).max(), "m", 1e-9)
    lat = np.linspace(-np.pi / 2, np.pi / 2, 181)
    for height, limit in ((0.0, 1e-9), (1e4, 1e-6)):
        off = np.abs(earth.gravity(lat, height) - earth.normal_gravity_exact(lat, height)[:, 2]).max()
        say(f"normal gravity at {height:g} m against the closed form", off, "m/s^2", limit)


def outage_windows(flights: Sequence[Flight]) -> list[dict[str, float | str]]:
    """Duration, mean speed and turn of every outage window of the drives, together with the printed ones.

    Returns
    -------
    list of dict
        ``drive, outage, start_s, duration_s, speed_kmh, turn_deg`` and ``printed_duration_s, printed_speed_kmh,
        printed_turn``; the turn is the largest change of course within the window.
    """
    rows: list[dict[str, float | str]] = []
    for flight in flights:
        for w, (start, duration) in zip(drives()[flight.name]["outages"], flight.outages, strict=True):
            t = np.linspace(start, start + duration, int(duration * 100) + 1)
            v = flight.path.vel_ned(t)
            course = np.unwrap(np.arctan2(v[:, 1], v[:, 0]))
            speed = np.hypot(v[:, 0], v[:, 1])
            rows.append(
                {
                    "drive": flight.name,
                    "outage": float(w["number"]),
                    "start_s": start,
                    "duration_s": duration,
                    "speed_kmh": float(3.6 * np.trapezoid(speed, t) / duration),
                    "turn_deg": float(np.rad2deg(np.ptp(course))),
                    "printed_duration_s": w["duration_s"],
                    "printed_speed_kmh": w["speed_kmh"],
                    "printed_turn": w["turn"],
                }
            )
    return rows


def windows() -> None:
    print("\noutage windows of the urban drives beside tables 9 and 10 of Quinchia et al. (2013)")
    print(f"  {'outage':<8}{'start':>8}{'duration':>10}{'printed':>9}{'km/h':>9}{'printed':>9}{'turn':>9}   printed")
    rows = outage_windows([built_in(name) for name in ("urban_drive_1", "urban_drive_2")])
    for r in rows:
        print(
            f"  {r['outage']:<8.0f}{r['start_s']:>6.0f} s{r['duration_s']:>8.0f} s{r['printed_duration_s']:>7.0f} s{r['speed_kmh']:>9.2f}"
            f"{r['printed_speed_kmh']:>9.2f}{r['turn_deg']:>5.0f} deg   {r['printed_turn']}"
        )
    say(
        "largest difference of speed",
        max(100 * abs(float(r["speed_kmh"]) / float(r["printed_speed_kmh"]) - 1) for r in rows),
        "%",
        5.0,
    )
    say(
        "largest difference of duration",
        max(abs(float(r["duration_s"]) - float(r["printed_duration_s"])) for r in rows),
        "s",
        0.0,
    )


def track() -> None:
    print("\nrecorded track rtkexp_drive: a third of the fixes left out")
    file = shared("real/rtkexp_drive.npz")
    if file is None:
        return
    recorded = Track.of(read_recording(file).gnss, "rtkexp_drive")
    without = Track(recorded.t, recorded.llh, None, None, recorded.pos_std, recorded.vel_std, recorded.name)
    for name, given in (("position and velocity", recorded), ("position only", without)):
        distance = held_out_distance(given)
        say(f"{name}: median distance", float(np.median(distance)), "m", 0.1)
        say(f"{name}: 95th percentile", float(np.percentile(distance, 95)), "m")
    path = smooth_track(recorded).path
    t = np.arange(path.start, path.end, 0.05)
    k = path.kinematics(t)
    say("largest speed", float(np.hypot(k.vel_ned[:, 0], k.vel_ned[:, 1]).max()), "m/s", 20.0)
    say("largest turn rate", float(np.rad2deg(np.abs(turn_rate(path, t)).max())), "deg/s", 60.0)
    say("largest acceleration", float(np.linalg.norm(k.acc_ned, axis=1).max()), "m/s^2", 6.0)


def main() -> int:
    for part in (exact, continuous, turbulence, fixtures, rest, geodesy, windows, track):
        part()
    print("\n" + ("every figure holds" if not missed else "missed: " + "; ".join(missed)))
    return 1 if missed else 0


if __name__ == "__main__":
    raise SystemExit(main())
