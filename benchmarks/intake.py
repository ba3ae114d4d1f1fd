"""What ``insemu open`` says of files as users have them and of recordings spoilt on purpose; every command that it prints is applied.

python -m benchmarks.intake [cases] [spoils] [right] [lags]      the first three without a name

`lags` calibrates what is said of late velocities and late sensors: what is found of lags that are known, and of none.
"""

from __future__ import annotations

import re
import sys
import tarfile
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy

from insemu import earth, rotation
from insemu.errors import InputError
from insemu.formats import Opened, open_files, write
from insemu.intake import Card, examine, take, velocity_lag
from insemu.records import GnssRecord, ImuRecord, Recording
from tests.shared_data import shared
from tests.wrong_recordings import flown, right

_COMMAND = re.compile(r"""--(gnss-map|truth-map|map) ["']([^"']+)["']|--(rate) '([^']+)'""")
Spoil = Callable[[ImuRecord, GnssRecord], tuple[ImuRecord, GnssRecord]]


# ------------------------------------------------------------------------------------------------------------------------ truth


def turned(a: ImuRecord, b: ImuRecord) -> str:
    """How an IMU differs from the right one whatever the common rotation of its axes; "" where it does not."""
    a = replace(a, t=a.t - a.t[0] + b.t[0])  # a clock of its own begins where the record begins
    span = max(a.t[0], b.t[0]) + 0.05, min(a.t[-1], b.t[-1]) - 0.05
    if span[1] - span[0] < 0.8 * (b.t[-1] - b.t[0]):
        return f"{a.t[-1] - a.t[0]:.6g} s of {b.t[-1] - b.t[0]:.6g} s"
    edges = np.arange(*span, 0.5)  # means: the phase of a vibration is no part of a reading
    values = []
    for i in (a, b):
        sums = np.cumsum(i.rates() * np.diff(i.t, prepend=i.t[0])[:, None], axis=0)
        values.append(np.diff([np.interp(edges, i.t, c) for c in sums.T], axis=1).T / 0.5)
    one, two = (np.vstack([v[:, :3] * 30.0, v[:, 3:]]) for v in values)
    u, _, vt = np.linalg.svd(two.T @ one)
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    for k, name in ((slice(0, 3), "gyro"), (slice(3, 6), "accel")):
        x, y = values[0][:, k] @ turn.T, values[1][:, k]
        slope = float((x * y).sum() / max(float((y * y).sum()), 1e-12))
        if abs(slope - 1.0) > (0.04 if not k.start else 0.015):
            return f"{name} {slope:.3f} times"
        off = np.linalg.norm(x - y) / max(np.linalg.norm(y - (0.0 if k.start else y.mean(axis=0))), 1e-12)
        if off > (0.35 if not k.start else 0.12):
            return f"{name} off by {100 * off:.0f} %"
    return ""


def displaced(a: GnssRecord | None, b: GnssRecord | None) -> str:
    """How fixes differ from the right ones; "" where they do not."""
    if a is None or b is None:
        return "" if a is None and b is None else "fixes missing"
    if len(a) < 0.15 * len(b):  # phones write every fifth
        return f"{len(a)} of {len(b)} fixes"
    llh = np.column_stack([np.interp(a.t, b.t, c) for c in b.llh.T])
    away = np.quantile(np.linalg.norm(earth.position_difference(a.llh, llh), axis=1), 0.9)
    if away > 5.0:
        return f"positions {away:.3g} m off"
    if a.vel_ned is not None and b.vel_ned is not None:
        vel = np.column_stack([np.interp(a.t, b.t, c) for c in b.vel_ned.T])
        apart = np.nanquantile(np.linalg.norm(a.vel_ned - vel, axis=1), 0.9)
        if apart > 1.0:
            return f"velocities {apart:.3g} m/s off"
    return ""


def differs(got: Opened | None, want: Opened) -> str:
    if got is None or (got.imu is None and want.imu is not None):
        return "no IMU"
    if want.imu is None or got.imu is None:
        r = got.reference
        return displaced(got.gnss or (GnssRecord(r.t, r.llh, r.vel_ned) if r is not None else None), want.gnss)
    late = float(want.imu.t[0] - got.imu.t[0])
    fixes = None if got.gnss is None else replace(got.gnss, t=got.gnss.t + late)
    return turned(got.imu, want.imu) or displaced(fixes, want.gnss)


def commands(card: Card | None, error: str) -> list[dict[str, str]]:
    """Every command that is printed, as the options that it adds."""
    texts = [x.mend for x in card.lines if x.mend] if card is not None else [error]
    out = []
    for text in texts:
        for part in re.split(r"; or |insemu open ", text):
            found = {k or r: v or w for k, v, r, w in _COMMAND.findall(part)}
            if found and found not in out:
                out.append(found)
    return out


def coarse(command: dict[str, str]) -> dict[str, str]:
    """A command with its numbers to the next ten: a mounting moves by some tenths of a degree with any spoil."""
    return {
        k: re.sub(r"-?\d+(\.\d+)?", lambda m: f"{10.0 * round(float(m[0]) / 10.0):g}", v) for k, v in command.items()
    }


def opened(path: Path, gnss: str, options: dict[str, str]) -> tuple[Opened | None, Card | None, str]:
    line = ", ".join(x for x in (options.get("map", ""), f"rate={options['rate']}" if "rate" in options else "") if x)
    try:
        found, card = take(path, gnss=gnss, maps=(line, options.get("gnss-map", ""), ""))
        return found, card, ""
    except InputError as error:
        return None, None, str(error)


def judged(
    path: Path,
    gnss: str,
    want: Opened | None,
    quiet: tuple[str, ...] = (),
    about: str = "",
    known: list[dict[str, str]] | None = None,
) -> tuple[str, str]:
    """The verdict about a file and what is behind it: the words of the card and of every command applied."""
    found, card, error = opened(path, gnss, {})
    said = [str(x) for x in card.lines if x.level in ("odd", "wrong") and x.topic not in quiet] if card else [error]
    given = [c for c in commands(card, error) if coarse(c) not in [coarse(k) for k in known or []]]
    told = " | ".join(said)
    good = want is not None and not differs(found, want) if found is not None else False
    wrong = []
    for options in given:
        got, after, left = opened(path, gnss, options)
        why = left or (differs(got, want) if want is not None else "") or "; ".join(str(x) for x in after.of("wrong"))  # type: ignore[union-attr]
        if want is None:
            why = why or "nothing makes this right"
        if why:
            wrong.append(f"{options} -> {why[:160]}")
    if wrong:
        return "false command", f"{told[:300]} || {' || '.join(wrong)}"
    refused = card is None or bool(card.of("wrong"))
    if good and (said or not about):
        return ("false accusation" if refused else "right"), told[:300]
    if not said:
        open_ = (
            [str(x) for x in card.of("assumed") if "not checkable" in x.text and re.search(about, str(x))]
            if card and about
            else []
        )
        return ("said not to be checked", " | ".join(open_)) if open_ else ("silent", "")
    return ("said with a command" if given else "said"), told[:400]


# ------------------------------------------------------------------------------------------------------------------------ cases

#: IMU file, file of fixes, and what is right: "" (as the common base), "log", or why nothing can make it right.
CASES: tuple[tuple[str, str, str], ...] = (
    ("F01_ardupilot.log", "", ""), ("F03_novatel_span.asc", "", ""), ("F05_xsens_mt.txt", "", ""),
    ("F08_kfgins_rates.txt", "", ""), ("F09_kfgins_imu.txt", "F09_kfgins_gnss_zero_std.txt", ""),
    ("F10_excel_de.csv", "", ""), ("F12_excel_de_latin1.csv", "", ""), ("F14_sensorlogger_gravity", "", ""),
    ("F15_sensorlogger_linear_only", "", "never"), ("F17_bursts.csv", "", ""), ("F18_sbg_us_wrap.csv", "", ""),
    ("F19_week_rollover_imu.csv", "F19_week_rollover_gnss.csv", ""), ("F21_clipped.csv", "", "never"),
    ("F22_static_moved.csv", "", "moved"), ("F23_mpu6050_counts.csv", "", "rest"), ("F24_tiny_10s.csv", "", "rest"),
    ("F26_excel_serial.csv", "", ""), ("F28_negated_accel.csv", "F28_gnss.csv", ""), ("F29_one_file_blank.csv", "", ""),
    ("F31_imu.csv", "F31_ddmm.csv", ""), ("F31_imu.csv", "F32_e7.csv", ""), ("F33_rtklib_comma.pos", "", "fixes"),
    ("F34_imu_echo.csv", "F34_navsatfix_nofix.csv", ""), ("F35_ie_export.txt", "", "fixes"), ("F37_two_imus.csv", "", ""),
    ("F39_imu_boot.csv", "F28_gnss.csv", ""),
)  # fmt: skip


def base(folder: Path) -> Opened:
    """The common base of the cases: rightly read from the pair whose clock only passes the end of the week."""
    return open_files(folder / "F19_week_rollover_imu.csv", gnss=folder / "F19_week_rollover_gnss.csv")


def cases(folder: Path) -> Iterator[tuple[str, str, str]]:
    """Name, verdict and evidence of each case."""
    for packed in sorted(shared("cases/README.md").parent.glob("*.tar.xz")):
        with tarfile.open(packed) as archive:
            archive.extractall(folder, filter="data")
    truth = base(folder)
    rest, moved = (
        open_files(folder / "F24_tiny_10s.csv"),
        open_files(folder / "F22_static_moved.csv", maps=("to=300 s", "", "")),
    )
    for name, gnss, kind in CASES:
        want: Opened | None = truth if gnss or name[:3] in ("F01", "F03", "F14", "F29") else replace(truth, gnss=None)
        if kind == "fixes":
            want = replace(truth, imu=None)
        want = {"never": None, "rest": rest, "moved": moved}.get(kind, want)
        verdict, why = judged(folder / name, str(folder / gnss) if gnss else "", want)
        yield f"{name} {gnss}".strip(), verdict, why


# ----------------------------------------------------------------------------------------------------------------------- spoils


def _gyro(change: Callable[[np.ndarray, ImuRecord], np.ndarray]) -> Spoil:
    return lambda i, g: (replace(i, gyro=change(i.gyro.copy(), i)), g)


def _accel(change: Callable[[np.ndarray, ImuRecord], np.ndarray]) -> Spoil:
    return lambda i, g: (replace(i, accel=change(i.accel.copy(), i)), g)


def _llh(change: Callable[[np.ndarray, GnssRecord], np.ndarray]) -> Spoil:
    return lambda i, g: (i, replace(g, llh=change(g.llh.copy(), g)))


def _vel(change: Callable[[np.ndarray, GnssRecord, ImuRecord], np.ndarray]) -> Spoil:
    return lambda i, g: (i, g if g.vel_ned is None else replace(g, vel_ned=change(g.vel_ned.copy(), g, i)))


def _put(values: np.ndarray, axis: int, column: np.ndarray | float) -> np.ndarray:
    values[:, axis] = column
    return values


def _high_passed(w: np.ndarray, i: ImuRecord) -> np.ndarray:
    width = max(1, round(10.0 / i.dt))
    total = np.vstack([np.zeros(3), np.cumsum(w, axis=0)])
    at = np.arange(len(w))
    low, high = np.maximum(at - width // 2, 0), np.minimum(at + width // 2, len(w))
    return w - (total[high] - total[low]) / (high - low)[:, None]


def _gravity_removed(f: np.ndarray, i: ImuRecord) -> np.ndarray:
    width = max(1, round(2.0 / i.dt))
    total = np.vstack([np.zeros(3), np.cumsum(f, axis=0)])
    at = np.arange(len(f))
    low, high = np.maximum(at - width // 2, 0), np.minimum(at + width // 2, len(f))
    mean = (total[high] - total[low]) / (high - low)[:, None]
    return f - 9.8 * mean / np.linalg.norm(mean, axis=1, keepdims=True)


def _late(f: np.ndarray, i: ImuRecord) -> np.ndarray:
    return np.column_stack([np.interp(i.t - 0.3, i.t, c) for c in f.T])


def _course(v: np.ndarray, g: GnssRecord, i: ImuRecord) -> np.ndarray:
    return np.column_stack([np.hypot(v[:, 0], v[:, 1]), np.arctan2(v[:, 1], v[:, 0]) % (2 * np.pi), 0.0 * v[:, 0]])


def _body(v: np.ndarray, g: GnssRecord, i: ImuRecord) -> np.ndarray:
    return np.column_stack([np.hypot(v[:, 0], v[:, 1]), 0.02 * v[:, 0], v[:, 2]])


def _grid(v: np.ndarray, g: GnssRecord, i: ImuRecord) -> np.ndarray:
    return v @ rotation.dcm_from_rpy(np.deg2rad([0.0, 0.0, 8.0])).T


def _ddmm(llh: np.ndarray, g: GnssRecord) -> np.ndarray:
    degrees = np.rad2deg(llh[:, :2])
    whole = np.trunc(degrees)
    llh[:, :2] = np.deg2rad(whole + (degrees - whole) * 0.6)  # 45 deg 0.27 min becomes 45.0027
    return llh


def _held(llh: np.ndarray, g: GnssRecord) -> np.ndarray:
    middle = 0.5 * (g.t[0] + g.t[-1])
    rows = (g.t >= middle) & (g.t < middle + 30.0)
    llh[rows] = llh[np.argmax(rows)]
    return llh


def _jump(llh: np.ndarray, g: GnssRecord) -> np.ndarray:
    rows = g.t > 0.6 * g.t[-1] + 0.4 * g.t[0]
    llh[rows] = earth.move(llh[rows], np.array([150.0, 116.6, 0.0]))
    return llh


def _other(i: ImuRecord, g: GnssRecord) -> tuple[ImuRecord, GnssRecord]:
    other = flown("urban_drive_2", start=20.0, seconds=float(g.t[-1] - g.t[0]) + 2.0, seed=77).gnss
    assert other is not None
    t = g.t[0] + other.t - other.t[0]
    return i, replace(other, t=t)


def _sigmas(i: ImuRecord, g: GnssRecord) -> tuple[ImuRecord, GnssRecord]:
    std = g.pos_std_ned if g.pos_std_ned is not None else np.full((len(g), 3), 2.0)
    return i, replace(g, pos_std_ned=100.0 * std)


def _closed_up(i: ImuRecord, g: GnssRecord) -> tuple[ImuRecord, GnssRecord]:
    middle = 0.5 * (i.t[0] + i.t[-1])
    rows = (i.t < middle) | (i.t >= middle + 20.0)
    return replace(i, t=i.t[: rows.sum()], gyro=i.gyro[rows], accel=i.accel[rows]), g


def _frozen(i: ImuRecord, g: GnssRecord) -> tuple[ImuRecord, GnssRecord]:
    middle = 0.5 * (i.t[0] + i.t[-1])
    rows = (i.t >= middle) & (i.t < middle + 10.0)
    first = int(np.argmax(rows))
    gyro, accel = i.gyro.copy(), i.accel.copy()
    gyro[rows], accel[rows] = gyro[first], accel[first]
    return replace(i, gyro=gyro, accel=accel), g


def _reversed(i: ImuRecord, g: GnssRecord) -> tuple[ImuRecord, GnssRecord]:
    n = len(i) // 10 * 10
    order = np.arange(n).reshape(-1, 10)[:, ::-1].ravel()
    return ImuRecord(i.t[:n], i.gyro[order], i.accel[order], i.kind), g


SPOILS: dict[str, Spoil] = {
    "gyro x and y swapped": _gyro(lambda w, i: w[:, [1, 0, 2]]),
    "gyro times 2": _gyro(lambda w, i: 2.0 * w),
    "gyro times 0.5": _gyro(lambda w, i: 0.5 * w),
    "gyro times 1.1": _gyro(lambda w, i: 1.1 * w),
    "gyro in rpm": _gyro(lambda w, i: w * 30.0 / np.pi),
    "gyro in deg/h": _gyro(lambda w, i: w * np.rad2deg(3600.0)),
    "gyro in rev/s": _gyro(lambda w, i: w / (2.0 * np.pi)),
    "gyro z clipped": _gyro(lambda w, i: _put(w, 2, np.clip(w[:, 2], *np.deg2rad([-10.0, 10.0])))),
    "gyro z zero": _gyro(lambda w, i: _put(w, 2, 0.0)),
    "gyro z is temperature": _gyro(lambda w, i: _put(w, 2, 25.0 + 3.0 * np.linspace(0, 1, len(w)) + 0.02 * np.sin(np.arange(len(w))))),
    "gyro negated": _gyro(lambda w, i: -w),
    "gyro high-passed": _gyro(_high_passed),
    "accel y negated": _accel(lambda f, i: f * [1.0, -1.0, 1.0]),
    "accel negated": _accel(lambda f, i: -f),
    "accel times 2": _accel(lambda f, i: 2.0 * f),
    "accel times 1.03": _accel(lambda f, i: 1.03 * f),
    "accel in ft/s^2": _accel(lambda f, i: f / 0.3048),
    "accel in gal": _accel(lambda f, i: 100.0 * f),
    "accel without gravity": _accel(_gravity_removed),
    "accel clipped": _accel(lambda f, i: np.clip(f, -9.0, 9.0)),
    "accel late": _accel(_late),
    "accel forward-left-up": _accel(lambda f, i: f * [1.0, -1.0, -1.0]),
    "velocity speed, course": _vel(_course),
    "velocity of the body": _vel(_body),
    "velocity in km/h": _vel(lambda v, g, i: 3.6 * v),
    "velocity in cm/s": _vel(lambda v, g, i: 100.0 * v),
    "velocity zero": _vel(lambda v, g, i: 0.0 * v),
    "velocity grid north": _vel(_grid),
    "longitude negated": _llh(lambda x, g: x * [1.0, -1.0, 1.0]),
    "ddmm as degrees": _llh(_ddmm),
    "heights in feet": _llh(lambda x, g: x / [1.0, 1.0, 0.3048]),
    "heights negated": _llh(lambda x, g: x * [1.0, 1.0, -1.0]),
    "sigmas times 100": _sigmas,
    "positions held": _llh(_held),
    "position jumps": _llh(_jump),
    "another drive": _other,
    "stamps 1 % long": lambda i, g: (replace(i, t=i.t[0] + 1.01 * (i.t - i.t[0])), g),
    "fixes 0.2 s late": lambda i, g: (i, replace(g, t=g.t + 0.2)),
    "IMU frozen": _frozen,
    "blocks reversed": _reversed,
    "gyro y negated": _gyro(lambda w, i: w * [1.0, -1.0, 1.0]),
    "gyro z negated": _gyro(lambda w, i: w * [1.0, 1.0, -1.0]),
    "gyro x y z as y z x": _gyro(lambda w, i: w[:, [1, 2, 0]]),
    "gyro in deg/s": _gyro(lambda w, i: np.rad2deg(w)),
    "gyro in mrad/s": _gyro(lambda w, i: 1000.0 * w),
    "gyro late": _gyro(_late),
    "accel x negated": _accel(lambda f, i: f * [-1.0, 1.0, 1.0]),
    "accel z negated": _accel(lambda f, i: f * [1.0, 1.0, -1.0]),
    "accel x and y swapped": _accel(lambda f, i: f[:, [1, 0, 2]]),
    "accel in g": _accel(lambda f, i: f / 9.80665),
    "accel in mg": _accel(lambda f, i: f / 9.80665e-3),
    "accel x zero": _accel(lambda f, i: _put(f, 0, 0.0)),
    "velocity east, north": _vel(lambda v, g, i: v[:, [1, 0, 2]]),
    "velocity up": _vel(lambda v, g, i: v * [1.0, 1.0, -1.0]),
    "velocity in knots": _vel(lambda v, g, i: v / 0.514444),
    "velocity one fix late": _vel(lambda v, g, i: v[np.maximum(np.arange(len(v)) - 1, 0)]),
    "latitude negated": _llh(lambda x, g: x * [-1.0, 1.0, 1.0]),
    "latitude and longitude swapped": _llh(lambda x, g: x[:, [1, 0, 2]]),
    "positions of 1e-4 deg": _llh(lambda x, g: np.column_stack([np.deg2rad(np.round(np.rad2deg(x[:, :2]), 4)), x[:, 2]])),
    "stamps half": lambda i, g: (replace(i, t=i.t[0] + 0.5 * (i.t - i.t[0])), g),
    "fixes 18 s late": lambda i, g: (i, replace(g, t=g.t + 18.0)),
    "IMU closed up over 20 s": _closed_up,
}  # fmt: skip


def _about(name: str) -> str:
    """What a line must be about that says that such a spoil was not checked."""
    topics = {
        "height": "height",
        "sigma": "sigma",
        "fixes": "clock",
        "velocity": "velocity",
        "accel": "accel|force|motion",
        "gyro": "gyro|rate|motion",
    }
    return next((v for k, v in topics.items() if name.startswith(k)), "nothing")


def _cut(found: Opened, seconds: float) -> Opened:
    assert found.imu is not None and found.gnss is not None
    i, g = found.imu, found.gnss
    a, b = i.t < i.t[0] + seconds, g.t < i.t[0] + seconds
    cut = GnssRecord(
        g.t[b],
        g.llh[b],
        None if g.vel_ned is None else g.vel_ned[b],
        None if g.pos_std_ned is None else g.pos_std_ned[b],
        None if g.vel_std_ned is None else g.vel_std_ned[b],
    )
    return replace(found, imu=ImuRecord(i.t[a], i.gyro[a], i.accel[a], i.kind), gnss=cut, reference=None)


def drives(folder: Path) -> Iterator[tuple[str, Opened]]:
    """Six right drives: two real, one of another simulator, a base of the cases, two emulated."""
    yield "rtkexp", _cut(open_files(shared("real/rtkexp_drive.npz")), 400.0)
    yield "ublox", _cut(open_files(shared("real/ublox_mixed_nominal.npz")), 400.0)
    yield "logger", open_files(shared("cases/logger/drive.npz"))
    yield "urban", flown("urban_drive_1", rate=100.0, seconds=400.0)
    yield "uav", flown("turbulent_uav", start=30.0, seconds=300.0, sigma=0.05, seed=5)
    yield "helicopter", flown("helicopter_mapping", seconds=300.0, sigma=1.0, seed=6)


def spoils(folder: Path, only: str = "") -> Iterator[tuple[str, str, str]]:
    """Name, verdict and evidence of each spoil of each drive."""
    for drive, good in drives(folder):
        assert good.imu is not None and good.gnss is not None
        clean = write(folder / "clean.npz", Recording(good.imu, good.gnss))
        card = examine(open_files(clean))
        yield f"{drive}: as it is", "false accusation" if card.of("wrong") else "right", card.text(("odd", "wrong"))
        quiet = tuple(x.topic for x in card.of("odd"))
        want = open_files(clean)
        for name, spoil in SPOILS.items():
            if only and only not in name:
                continue
            try:
                path = write(folder / "spoilt.npz", Recording(*spoil(good.imu, good.gnss)))
            except InputError as error:  # a record that no file can become
                yield f"{drive}: {name}", "said", str(error)
                continue
            verdict, why = judged(path, "", want, quiet, _about(name), commands(card, ""))
            # a spoil that stays within the tolerances of `differs`: what is said of it is true
            words = {"right": "said" if why else "silent", "false accusation": "said with a command"}
            yield f"{drive}: {name}", words.get(verdict, verdict), why


def rights(folder: Path) -> Iterator[tuple[str, str, str]]:
    """Name, verdict and the words of each right recording."""
    for name, data in right().items():
        card = examine(data)
        verdict = "false accusation" if card.of("wrong") else "odd" if card.of("odd") else "right"
        yield name, verdict, card.text(("odd", "wrong"))


# -------------------------------------------------------------------------------------------------------------------- lags

#: Lags that are put on velocities and on one sensor, s.
OF_VELOCITIES, OF_SENSORS = (0.0, 0.1, 0.3, -0.5, 1.0, 2.0), (0.0, 0.1, -0.3, 0.5, 0.8)
#: Length of the pieces in which no lag should be found, s.
PIECE_S = 40.0


def _velocities_late(g: GnssRecord, lag: float) -> GnssRecord:
    """The same fixes with velocities that are late, from a spline."""
    assert g.vel_ned is not None
    g = g.rows(np.isfinite(g.vel_ned).all(axis=1))
    way = scipy.interpolate.CubicSpline(g.t, g.vel_ned)
    g = g.rows((g.t - lag > g.t[0]) & (g.t - lag < g.t[-1]))
    return replace(g, vel_ned=way(g.t - lag))


def lags(folder: Path) -> Iterator[tuple[str, str, str]]:
    """Name, verdict and what is found of each lag of the velocities and of each sensor of right recordings."""
    whole = right() | {n: open_files(shared(f"real/{n}.npz")) for n in ("rtkexp_drive", "ublox_mixed_nominal")}
    moving = {k: v for k, v in whole.items() if v.gnss is not None and v.gnss.vel_ned is not None and "static" not in k}
    for name, data in moving.items():
        g, imu = data.gnss, data.imu
        assert g is not None and imu is not None
        own = velocity_lag(g)[0]  # a real receiver has one
        for lag in OF_VELOCITIES:
            found, _ = velocity_lag(_velocities_late(g, lag))
            verdict = (
                "velocities: not found"
                if not found
                else "velocities: right"
                if abs(found - own - lag) < 0.2
                else "velocities: wrong"
            )
            yield (
                f"{name}, velocities {lag:+.1f} s",
                "velocities: none" if found == own and not lag else verdict,
                f"{found:+.2f}",
            )
        if not own:
            for begin in np.arange(g.t[0], g.t[-1] - PIECE_S, 0.5 * PIECE_S):
                found, _ = velocity_lag(g.rows((g.t >= begin) & (g.t < begin + PIECE_S)))
                yield f"{name}, from {begin:.0f} s", "pieces: found" if found else "pieces: none", f"{found:+.2f}"
        for lag in OF_SENSORS:
            late = (
                imu
                if not lag
                else replace(imu, accel=np.column_stack([np.interp(imu.t - lag, imu.t, c) for c in imu.accel.T]))
            )
            lines = [str(x) for x in examine(replace(data, imu=late)).lines if "accelerometer comes" in x.text]
            said = re.search(r"accelerometer comes ([\d.]+) s (late|early)", " ".join(lines))
            found = 0.0 if said is None else float(said[1]) * (1.0 if said[2] == "late" else -1.0)
            verdict = (
                "sensor: right"
                if abs(found - lag) < 0.1 and (found != 0.0 or not lag)
                else "sensor: not found"
                if not found
                else "sensor: wrong"
            )
            yield f"{name}, accelerometer {lag:+.1f} s", verdict, f"{found:+.2f}"


def main(arguments: list[str]) -> None:
    """Print a line for each and the sums."""
    only = next((a.removeprefix("only=") for a in arguments if a.startswith("only=")), "")
    parts = {"cases": cases, "spoils": lambda f: spoils(f, only), "right": rights, "lags": lags}
    for part in [a for a in arguments if a in parts] or list(parts)[:3]:
        counts: Counter[str] = Counter()
        with tempfile.TemporaryDirectory() as folder:
            for name, verdict, why in parts[part](Path(folder)):
                counts[verdict] += 1
                print(f"{verdict:20s} {name}: {why}".replace(folder, "").replace("\n", " "), flush=True)
        print(
            f"-- {part}: {sum(counts.values())}: " + ", ".join(f"{n} {k}" for k, n in counts.most_common()), flush=True
        )


if __name__ == "__main__":
    main(sys.argv[1:])
