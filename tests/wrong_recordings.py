"""Recordings that are right, and recordings that are declared wrongly on purpose, each with what the card must say.

python -m tests.wrong_recordings [ROUNDS]    on other stretches with other noise than the tests: how many are named, how many right ones refused
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from insemu import earth, rotation
from insemu.emulate import built_in, gnss_fixes, ideal_imu
from insemu.formats import Opened
from insemu.intake import examine
from insemu.records import GnssRecord, ImuRecord


@lru_cache(maxsize=16)
def flown(
    which: str = "urban_drive_1", start: float = 0.0, seconds: float = 240.0, rate: float = 50.0, fixes: float = 1.0,
    sigma: float = 0.5, velocity: bool = True, grade: float = 1.0, kind: str = "mean", seed: int = 1, ahead: float = 0.0,
    referenced: bool = False,
) -> Opened:  # fmt: skip
    """A stretch of a built-in drive or flight with an IMU of a grade (1: consumer MEMS) and a receiver, its antenna some metres ahead."""
    rng = np.random.default_rng(seed)
    path = built_in(which)
    ideal = ideal_imu(path, rate, kind="mean", span=(start, start + seconds))
    imu, n = ideal.imu, ideal.imu.t.size
    gyro = imu.gyro + grade * (
        np.deg2rad(0.01) * np.sqrt(rate) * rng.standard_normal((n, 3)) + np.deg2rad(0.3) * rng.standard_normal(3)
    )
    accel = imu.accel + grade * (2e-3 * np.sqrt(rate) * rng.standard_normal((n, 3)) + 0.05 * rng.standard_normal(3))
    if kind == "increment":
        gyro, accel = gyro / rate, accel / rate
    gnss = gnss_fixes(
        ideal.reference,
        fixes,
        (sigma, sigma, 1.5 * sigma),
        (0.1, 0.1, 0.15) if velocity else None,
        (ahead, 0.0, 0.0),
        rng=rng,
    )
    reference = ideal.reference if referenced else None
    return Opened("a.npz", "recording", ImuRecord(imu.t, gyro, accel, kind), gnss, reference)  # type: ignore[arg-type]


Spoil = Callable[[Opened], Opened]
#: How much later a round's stretches begin than the round's before, s.
STRETCH_S = 15.0


@dataclass(frozen=True)
class Wrong:
    """One way to declare a recording wrongly.

    Parameters
    ----------
    name : str
    base : dict
        Options of :func:`flown`.
    spoil : callable
    says : str
        Part of the mending command that the card must give, or of its text.
    """

    name: str
    base: dict[str, object]
    spoil: Spoil
    says: str


def _imu(change: Callable[[ImuRecord], ImuRecord]) -> Spoil:
    return lambda o: replace(o, imu=change(o.imu))  # type: ignore[arg-type]


def _gnss(change: Callable[[GnssRecord], GnssRecord]) -> Spoil:
    return lambda o: replace(o, gnss=change(o.gnss))  # type: ignore[arg-type]


def scaled(gyro: float = 1.0, accel: float = 1.0) -> Spoil:
    return _imu(lambda i: replace(i, gyro=i.gyro * gyro, accel=i.accel * accel))


def as_increments() -> Spoil:
    return _imu(lambda i: replace(i, gyro=i.gyro * i.dt, accel=i.accel * i.dt))


def as_rates() -> Spoil:
    return _imu(lambda i: replace(i, gyro=i.gyro / i.dt, accel=i.accel / i.dt))


def mounted(*rpy: float) -> Spoil:
    C = rotation.dcm_from_rpy(np.deg2rad(rpy))  # IMU to vehicle
    return _imu(lambda i: replace(i, gyro=i.gyro @ C, accel=i.accel @ C))


def late(seconds: float) -> Spoil:
    return _gnss(lambda g: replace(g, t=g.t + seconds))


def delayed(seconds: float, sensor: str) -> Spoil:
    def change(i: ImuRecord) -> ImuRecord:
        values = getattr(i, sensor)
        return replace(i, **{sensor: np.column_stack([np.interp(i.t - seconds, i.t, c) for c in values.T])})

    return _imu(change)


def moved(*ned: float) -> Spoil:
    return _gnss(lambda g: replace(g, llh=earth.move(g.llh, np.array(ned))))


def swapped() -> Spoil:
    return _gnss(lambda g: replace(g, llh=g.llh[:, [1, 0, 2]]))


def in_radians() -> Spoil:
    return _gnss(lambda g: replace(g, llh=g.llh * [np.pi / 180, np.pi / 180, 1.0]))


def velocities(columns: tuple[int, int, int], signs: tuple[float, float, float], scale: float = 1.0) -> Spoil:
    def change(g: GnssRecord) -> GnssRecord:
        assert g.vel_ned is not None
        return replace(g, vel_ned=g.vel_ned[:, list(columns)] * np.array(signs) * scale)

    return _gnss(change)


def gap(seconds: float) -> Spoil:
    def change(i: ImuRecord) -> ImuRecord:
        middle = 0.5 * (i.t[0] + i.t[-1])
        keep = (i.t < middle) | (i.t >= middle + seconds)
        return replace(i, t=i.t[keep], gyro=i.gyro[keep], accel=i.accel[keep], temperature=None)

    return _imu(change)


def closed_up(seconds: float) -> Spoil:
    """Rows of the IMU that are lost while its stamps go on evenly."""

    def change(i: ImuRecord) -> ImuRecord:
        middle = 0.5 * (i.t[0] + i.t[-1])
        keep = (i.t < middle) | (i.t >= middle + seconds)
        return replace(i, t=i.t[: keep.sum()], gyro=i.gyro[keep], accel=i.accel[keep], temperature=None)

    return _imu(change)


def rounded(decimals: int) -> Spoil:
    return _gnss(
        lambda g: replace(
            g, llh=np.column_stack([np.deg2rad(np.round(np.rad2deg(g.llh[:, :2]), decimals)), g.llh[:, 2]])
        )
    )


def held_back(rows: int) -> Spoil:
    """Velocities of an earlier fix."""
    return _gnss(lambda g: replace(g, vel_ned=g.vel_ned[np.maximum(np.arange(len(g)) - rows, 0)]))  # type: ignore[index]


def mirror(axis: int) -> Spoil:
    signs = np.where(np.arange(3) == axis, -1.0, 1.0)
    return _imu(lambda i: replace(i, gyro=i.gyro * signs))


def stamps(factor: float) -> Spoil:
    return _imu(lambda i: replace(i, t=i.t * factor))


#: What takes that long to be told, s.
LONG = {"seconds": 240.0}
POSITIONS = {"velocity": False} | LONG
PHONE = {"velocity": False, "sigma": 2.0, "grade": 3.0} | LONG
FLIGHT = {"which": "turbulent_uav"} | LONG
WRONG: tuple[Wrong, ...] = (
    Wrong("gyro in deg/s", {}, scaled(gyro=180 / np.pi), "gyro_unit=deg/s"),
    Wrong("gyro in deg/s, positions only", POSITIONS, scaled(gyro=180 / np.pi), "gyro_unit=deg/s"),
    Wrong("gyro in deg/s, phone", PHONE, scaled(gyro=180 / np.pi), "the rates are in deg/s"),
    Wrong(
        "gyro in deg/s, drone", {"which": "turbulent_uav", "start": 60.0}, scaled(gyro=180 / np.pi), "gyro_unit=deg/s"
    ),
    Wrong("gyro converted twice", {}, scaled(gyro=np.pi / 180), "gyro_unit=57.29578 rad/s"),
    Wrong("gyro in mrad/s", {}, scaled(gyro=1000.0), "gyro_unit=mrad/s"),
    Wrong("accelerometer in g", {}, scaled(accel=1 / 9.80665), "accel_unit=g"),
    Wrong("accelerometer in mg", POSITIONS, scaled(accel=1000 / 9.80665), "the forces are in mg"),
    Wrong("accelerometer in mm/s^2", {}, scaled(accel=1000.0), "accel_unit=mm/s^2"),
    Wrong("accelerometer converted twice", {}, scaled(accel=9.80665), "accel_unit=0.1019716 m/s^2"),
    Wrong("accelerometer in counts", {}, scaled(accel=4096 / 9.80665), "accel_unit="),
    Wrong("both sensors converted", {}, scaled(180 / np.pi, 1 / 9.80665), "gyro_unit=deg/s"),
    Wrong("increments as rates", {}, as_increments(), "kind=increment"),
    Wrong("increments as rates, 200 Hz", {"rate": 200.0, "seconds": 120.0}, as_increments(), "kind=increment"),
    Wrong("rates as increments", {"kind": "increment"}, as_rates(), "kind=sample"),
    Wrong("increments as rates, positions only", POSITIONS, as_increments(), "kind=increment"),
    Wrong("forward-left-up", {}, mounted(180, 0, 0), "axes=FLU"),
    Wrong("right-forward-up", {}, mounted(180, 0, 90), "axes=RFU"),
    Wrong("yaw 90", {}, mounted(0, 0, 90), "mount=0.|axes=RBD"),
    Wrong("yaw 180", {}, mounted(0, 0, 180), "axes=BLD"),
    Wrong("yaw -90, positions only", POSITIONS, mounted(0, 0, -90), "axes=LFD"),
    Wrong("yaw 180, phone", PHONE, mounted(0, 0, 180), "axes=BLD"),
    Wrong("roll 90", {}, mounted(90, 0, 0), "axes="),
    Wrong("roll -90", {}, mounted(-90, 0, 0), "axes="),
    Wrong("pitch 90", {}, mounted(0, 90, 0), "mount=|axes="),
    Wrong("pitch 180", {}, mounted(0, 180, 0), "axes="),
    Wrong("upside down, flight", {"which": "turbulent_uav", "start": 60.0}, mounted(180, 0, 0), "axes="),
    Wrong("gyro z the wrong way", {}, mirror(2), "gyro_axes=x y -z"),
    Wrong("latitude and longitude swapped", {}, swapped(), "latlon=swapped"),
    Wrong("latitude and longitude swapped, positions only", POSITIONS, swapped(), "latlon=swapped"),
    Wrong("latitude in radians", {}, in_radians(), "pos_unit=rad"),
    Wrong("latitude in radians, positions only", POSITIONS, in_radians(), "pos_unit=rad"),
    Wrong("velocities east, north, up", {}, velocities((1, 0, 2), (1, 1, -1)), "velocity=enu"),
    Wrong(
        "third velocity up, flight",
        FLIGHT,
        velocities((0, 1, 2), (1, 1, -1)),
        "velocity=neu",
    ),
    Wrong(
        "third velocity up, helicopter",
        {"which": "helicopter_mapping"} | LONG,
        velocities((0, 1, 2), (1, 1, -1)),
        "velocity=neu",
    ),
    Wrong("velocities in knots", {}, velocities((0, 1, 2), (1, 1, 1), 3600 / 1852), "vel_unit=knots"),
    Wrong("heights above sea level", {"referenced": True}, moved(0.0, 0.0, 47.0), "gnss_move=0 0 -4"),
    Wrong("another datum", {"referenced": True, "ahead": 1.5}, moved(80.0, -120.0, 0.0), "gnss_move=-8|gnss_move=-79"),
    Wrong("fixes late by 0.6 s", FLIGHT, late(0.6), "gnss_shift=-0."),
    Wrong("fixes late by 0.6 s, few turns", LONG, late(0.6), "nothing here distinguishes: the fixes are 0.6"),
    Wrong("gyroscope late by 0.4 s", FLIGHT, delayed(0.4, "gyro"), "gyro_shift=-0."),
    Wrong("accelerometer early by 0.4 s", FLIGHT, delayed(-0.4, "accel"), "accel_shift=+0."),
    Wrong("accelerometer late by 0.8 s", FLIGHT, delayed(0.8, "accel"), "accel_shift=-0.8|accel_shift=-0.7"),
    Wrong("fixes late by 2 s, positions only", POSITIONS, late(2.0), "gnss_shift=-"),
    Wrong("fixes early by 18 s (leap seconds)", {}, late(-18.0), "gnss_shift=+1"),
    Wrong("fixes on another clock", {}, late(1.4e9), "not one clock"),
    Wrong(
        "20 s of the IMU lost without stamps",
        FLIGHT,
        closed_up(20.0),
        "s on the IMU predicts the velocities",
    ),
    Wrong("positions of four decimals", LONG, rounded(4), "4 decimals of a degree: steps of 11 m"),
    Wrong(
        "velocities of the fix before",
        FLIGHT,
        held_back(1),
        "the velocities come 1.0|the velocities come 0.9",
    ),
    Wrong("a gap of 3 s in the IMU", {}, gap(3.0), "3."),
    Wrong("stamps in ms taken as s", {}, stamps(1000.0), "time_unit=ms"),
)


def right(again: int = 0) -> dict[str, Opened]:
    """Forty recordings that are right: vehicles, rates, receivers, grades, mountings that are on purpose."""
    out: dict[str, Opened] = {}
    ways = (
        "urban_drive_1",
        "urban_drive_2",
        "urban_motorway",
        "turbulent_uav",
        "helicopter_mapping",
        "survey",
        "lemniscate",
        "static",
    )
    kinds: dict[str, dict[str, object]] = {
        "": {"seconds": 150.0},
        ", positions only": {"seconds": 150.0, "sigma": 2.0, "velocity": False, "grade": 3.0, "seed": 2},
        ", increments, later": {
            "start": 100.0, "seconds": 120.0, "rate": 100.0, "fixes": 4.0, "sigma": 0.02, "grade": 0.1, "kind": "increment", "seed": 3,
        },
        ", 20 Hz": {"seconds": 150.0, "rate": 20.0, "fixes": 0.5, "sigma": 5.0, "grade": 2.0, "seed": 4},
    }  # fmt: skip
    for which in ways:
        for name, options in kinds.items():
            out[f"{which}{name}"] = flown(which, **_other(options, again))  # type: ignore[arg-type]
        out[f"{which}, no fixes"] = replace(out[which], gnss=None)
    return out


def _other(options: dict[str, object], again: int) -> dict[str, object]:
    """The options of another stretch of the same way with other noise; 0: as they are."""
    start, seed = float(str(options.get("start", 0.0))), int(str(options.get("seed", 1)))
    return options | {"start": start + STRETCH_S * again, "seed": seed + 1000 * again} if again else options


def named(wrong: Wrong, again: int = 0) -> tuple[bool, str]:
    """Whether the card of a wrong recording says what it must, and the card."""
    card = examine(wrong.spoil(flown(**_other(wrong.base, again))))  # type: ignore[arg-type]
    pattern = "|".join(re.escape(part) for part in wrong.says.split("|"))
    return re.search(pattern, card.text(("odd", "wrong"))) is not None, card.text()


def main(rounds: int) -> None:
    """Print, for every round, how many wrong recordings are named and how many right ones are refused or odd."""
    for again in range(1, rounds + 1):
        missed = [wrong.name for wrong in WRONG if not named(wrong, again)[0]]
        cards = {name: examine(data) for name, data in right(again).items()}
        refused, odd = ([n for n, card in cards.items() if card.of(word)] for word in ("wrong", "odd"))
        print(
            f"round {again}: {len(WRONG) - len(missed)} of {len(WRONG)} wrong recordings named"
            f"{'; not ' + ', '.join(missed) if missed else ''}; of {len(cards)} right ones {len(refused)} refused"
            f"{' (' + ', '.join(refused) + ')' if refused else ''}, {len(odd)} odd{' (' + ', '.join(odd) + ')' if odd else ''}",
            flush=True,
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
