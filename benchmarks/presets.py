"""The vehicles that come with the package, as their IMU feels them: ``python benchmarks/presets.py [--picture FILE] [--speed]``.

Each preset goes round a block at its cruising speed; of what a perfect IMU samples at 100 Hz while it moves the root mean square in two bands is
printed for six axes, heading less course, and the root mean square of the jerk below 8 Hz. ``--real`` prints the same of the recordings with
motion of the shared data. ``--picture`` draws heading less course, jerk and spectra; ``--speed`` prints epochs per CPU second.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt, welch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from insemu.emulate import (
    VEHICLES,
    Command,
    Moving,
    SmoothPath,
    ideal_imu,
    origin_at,
    path_of,
    preset_file,
    profile,
    read_vehicle,
)
from insemu.units import STANDARD_GRAVITY
from tests.shared_data import root

Array = NDArray[np.float64]

RATE = 100.0
BANDS = ((2.0, 8.0), (8.0, 30.0))
#: Cruising speed of each preset, m/s.
CRUISE = {
    "car": 15.0, "truck": 18.0, "tractor": 4.0, "train": 35.0, "fixed_wing": 22.0, "multirotor": 8.0, "helicopter": 30.0, "boat": 7.0,
    "walker": 1.4, "hand": 1.4,
}  # fmt: skip
ROADS = "ABCD"
#: Quantities of a gyroscope and of an accelerometer as printed.
UNITS = np.array([np.rad2deg(1.0)] * 3 + [1e3 / STANDARD_GRAVITY] * 3)


def block(preset: str) -> SmoothPath:
    """Ten minutes round a block at the cruising speed; what flies climbs first."""
    kind, cruise = VEHICLES[preset], CRUISE[preset]
    turn = max(6.0, 0.5 * np.pi * max(cruise / (0.25 * kind.max_lateral), 1.0 / (0.4 * kind.max_turn_rate)) + 4.0)
    climb = 60.0 if kind.lean is None else 0.0
    commands = [Command(20.0), Command(60.0, speed=cruise, climb=climb)]
    while sum(c.duration_s for c in commands) < 540.0 - turn - 40.0:
        commands += [Command(40.0), Command(turn, turn=0.5 * np.pi)]
    commands += [Command(60.0, speed=0.0, climb=-climb), Command(20.0)]
    return path_of(profile(commands), kind, origin_at(46.5, 6.6, 400.0), "block")


def cases() -> Iterator[tuple[str, str, dict[str, object]]]:
    """Name as printed, preset, conditions."""
    for name in CRUISE:
        for road in ROADS if name == "car" else ("",):
            yield f"{name} {road}".strip(), name, {"roughness": road} if road else {}


def moved(preset: str, conditions: dict[str, object], seed: int = 1) -> tuple[SmoothPath, float]:
    """The path of a preset, and the speed above which it counts."""
    vehicle = read_vehicle(preset_file(preset), conditions)
    return Moving(vehicle, seed).on(block(preset)), 0.9 * CRUISE[preset]


def signals(path: SmoothPath, least: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    """What a perfect IMU samples (n, 6), heading less course (n,), and where it moves."""
    made = ideal_imu(path, RATE, mode="continuous", kind="sample")
    r = made.reference
    speed = np.hypot(r.vel_ned[:, 0], r.vel_ned[:, 1])
    off = r.rpy[:, 2] - np.arctan2(r.vel_ned[:, 1], r.vel_ned[:, 0])
    return np.hstack([made.imu.gyro, made.imu.accel]), (off + np.pi) % (2.0 * np.pi) - np.pi, speed > least


def bands(x: Array, rate: float, moving: NDArray[np.bool_]) -> Array:
    """Root mean squares (bands, 6) in deg/s and mg while it moves."""
    out = []
    for low, high in BANDS:
        high = min(high, 0.45 * rate)
        passed = sosfiltfilt(butter(4, (low, high), "bandpass", fs=rate, output="sos"), x - x.mean(axis=0), axis=0)
        out.append(np.sqrt(np.mean(passed[moving] ** 2, axis=0)) * UNITS)
    return np.array(out)


def row(name: str, found: Array, off: float | None = None, jerk: float | None = None) -> str:
    """One line of the table."""
    cells = ["  ".join(f"{v:5.1f}" for v in found[b, 3:]) for b in (0, 1)] + [
        "  ".join(f"{v:5.2f}" for v in found[b, :3]) for b in (0, 1)
    ]
    rest = "" if off is None or jerk is None else f" | {off:5.1f} | {jerk:5.1f}"
    return f"{name:<16s} | " + " | ".join(cells) + rest


def jerk_of(x: Array, moving: NDArray[np.bool_]) -> float:
    """Root mean square of the derivative of the specific force below 8 Hz, m/s^3, over the axes together."""
    low = sosfiltfilt(butter(4, 8.0, fs=RATE, output="sos"), x[:, 3:], axis=0)
    return float(np.sqrt(np.mean((np.gradient(low, 1.0 / RATE, axis=0)[moving] ** 2).sum(axis=1))))


def table() -> None:
    """Print every preset."""
    print(
        "specific force 2-8 Hz, 8-30 Hz (mg, x y z) | angular rate 2-8 Hz, 8-30 Hz (deg/s) | heading less course (deg rms) | jerk (m/s^3 rms)"
    )
    for name, preset, conditions in cases():
        x, off, moving = signals(*moved(preset, conditions))
        print(
            row(
                name, bands(x, RATE, moving), float(np.rad2deg(np.sqrt(np.mean(off[moving] ** 2)))), jerk_of(x, moving)
            ),
            flush=True,
        )


def real() -> None:
    """Print the recordings with motion."""
    folder = root()
    for name, least in (("rtkexp_drive", 3.0), ("ublox_mixed_nominal", 3.0), ("thor75_uav_flight", 12.0)):
        data = np.load(folder / "real" / f"{name}.npz")
        t, x = data["imu_t"], data["imu"]
        velocity = data["gnss_vel_ned"] if "gnss_vel_ned" in data else data["gnss_vel_neu"]
        speed = np.interp(t, data["gnss_t"], np.hypot(velocity[:, 0], velocity[:, 1]))
        rate = round(1.0 / float(np.median(np.diff(t))), 1)
        print(row(name, bands(x, rate, speed > least)))


def speed() -> None:
    """Print how fast both layers are made."""
    for preset in ("car", "multirotor"):
        for rate in (100.0, 200.0):
            ideal_imu(moved(preset, {})[0], rate)  # compiled
            best = np.inf
            for _ in range(3):
                path = moved(preset, {})[0]
                started = time.process_time()
                ideal = ideal_imu(path, rate)
                best = min(best, time.process_time() - started)
            print(
                f"{preset} at {rate:g} Hz: {len(ideal.imu) / best:,.0f} epochs per CPU second, path within {1e3 * ideal.path_distance_m:.3f} mm"
            )


def picture(file: str) -> None:
    """Draw heading less course, jerk and spectra of every preset."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(len(CRUISE), 3, figsize=(11.0, 1.7 * len(CRUISE)), constrained_layout=True)
    for line, preset in zip(axes, CRUISE, strict=True):
        x, off, moving = signals(*moved(preset, {}))
        line[0].hist(np.rad2deg(off[moving]), bins=80, density=True)
        line[0].set_ylabel(preset.replace("_", " "))
        low = sosfiltfilt(butter(4, 8.0, fs=RATE, output="sos"), x[:, 5])
        line[1].plot(
            np.arange(1000) / RATE,
            np.gradient(low, 1.0 / RATE)[np.flatnonzero(moving)[0] + np.arange(3000, 4000)],
            lw=0.7,
        )
        for k, name in ((3, "forward"), (4, "right"), (5, "down")):
            f, density = welch(x[moving, k], RATE, nperseg=1024)
            line[2].loglog(f[1:], np.sqrt(density[1:]) / STANDARD_GRAVITY * 1e3, lw=0.8, label=name)
    axes[0, 0].set_title("heading less course (deg)")
    axes[0, 1].set_title("vertical jerk (m/s³), 10 s")
    axes[0, 2].set_title("specific force (mg/√Hz) over Hz")
    axes[0, 2].legend(fontsize=7)
    figure.savefig(file)


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--picture", default="", help="file to draw")
    options.add_argument("--real", action="store_true", help="the recordings instead")
    options.add_argument("--speed", action="store_true", help="epochs per CPU second instead")
    given = options.parse_args()
    if given.picture:
        picture(given.picture)
    elif given.real:
        real()
    elif given.speed:
        speed()
    else:
        table()
