"""The checks of the card: each looks at one thing and says what it found, with the evidence.

Bounds are physical or generous: a record that is right must never be refused, so a finding is "wrong" only where one explanation fits far
better than what was declared (a factor of 57.3, of 9.8, of the sampling interval, a mirrored turn), and "odd" where it may be on purpose.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from insemu import rotation
from insemu.formats import round_rate
from insemu.intake.card import Line
from insemu.intake.motion import Push, Turn, up_of
from insemu.records import ImuRecord
from insemu.sample_times import beat, samples

Array = NDArray[np.float64]

G, G_STANDARD = 9.8, 9.80665
#: A step of more than this many intervals is a gap (as in static logs).
GAP = 1.5
#: Slowest and fastest IMU, Hz, that anybody fuses with GNSS.
RATES = (1.0, 2.0e4)
#: Share by which a factor may differ from 1 before it is named, and from a known factor to be recognised.
NEAR, KNOWN = 0.25, 0.2
#: Slope over its standard error from which a regression is believed; fewest intervals for that.
BELIEVED, FEWEST = 8.0, 20
#: Correlation of the turn of gravity with the gyroscope's from which their ratio is believed.
TILTED = 0.8
#: Shortest record of which it is asked whether it was moved, s; a second moves that spreads by so many times the median second.
REST_SECONDS, MOVED = 60, 10.0
#: Means of a second at rest differ by the white noise in them, less than so many times.
RESTS = 5.0
#: Longest part of a record at rest in which it is moved; more is a drive.
HANDLED = 0.2
#: Size of the mean specific force, in units of gravity, up to which a manoeuvre explains it (a 3-g turn all the time).
MANOEUVRE = 4.0
#: A rail: rows at an extreme, their share, and how many times the rows of the next value (counts thin out to their ends).
RAIL_ROWS, RAIL_SHARE, RAIL_OVER = 20, 2e-4, 3
#: A median rate that no vehicle keeps, rad/s; longest time for which six values stay the same by chance of counts, s; rows looked at for blocks.
SPIN, FROZEN, BLOCK_ROWS = 10.0, 1.0, 100_000
#: Departure from a right angle, deg, below which axes are named after it.
SQUARE = 25.0


def near(value: float, wanted: float, share: float = KNOWN) -> bool:
    """Whether a positive value is another one within a share.

    Parameters
    ----------
    value : float
        Not negative.
    wanted : float
        In the same unit; nothing is near to one that is not positive.
    share : float
        Factor less one by which the two may differ either way.
    """
    return bool(wanted > 0 and abs(np.log(max(value, 1e-300) / wanted)) < np.log1p(share))


def believed(found: Turn | Push | None, ratio: float = BELIEVED) -> bool:
    """Whether a regression says anything."""
    return found is not None and found.ratio > ratio and found.intervals >= FEWEST


# --------------------------------------------------------------------------------------------------------------------- time


def timing(t: Array, counts: Mapping[str, int], *, moving: bool = True) -> list[Line]:
    """Rate, jitter, gaps, and rows that were left out on the way in (``repeated``, ``missing``).

    Parameters
    ----------
    t : (n,) array
        s.
    counts : mapping
        Rows left out, by the reason.
    moving : bool
        Whether a long gap loses the motion, so that one of its sides is what can be used. Fits of a log at rest take gaps.
    """
    step = np.diff(t)
    dt = beat(t)
    rate = round_rate(1.0 / dt)
    out = []
    text = f"{t.size} samples at {rate:.6g} Hz in {t[-1] - t[0]:.6g} s"
    spread = float(np.quantile(np.abs(step - dt), 0.9)) / dt
    text += f", steps within {100 * spread:.2g} %" if spread > 1e-3 else ", even steps"
    if not RATES[0] <= rate <= RATES[1]:
        unit = next((u for u, f in (("ns", 1e-9), ("us", 1e-6), ("ms", 1e-3)) if 20.0 <= rate / f <= RATES[1]), None)
        hint = f"the stamps look like {unit}" if unit else "no IMU has that rate"
        out.append(Line("rate", "wrong", f"{text}; {hint}", f'--map "time_unit={unit}"' if unit else ""))
    else:
        out.append(Line("rate", "odd" if spread > 0.5 else "ok", text))
    spans = samples(t, dt)
    gaps = np.flatnonzero((step > GAP * dt + 1e-9) & (spans > 1.0))
    lost = int((spans[gaps] - 1.0).sum())
    if gaps.size and spread <= 0.5:
        k = int(gaps[np.argmax(step[gaps])])
        text = f"{gaps.size} gap(s), {lost} of {t.size + lost} samples lost, the longest {step[k]:.4g} s, {t[k] - t[0]:.6g} s after the start"
        long = moving and step[k] > max(0.5, 5.0 * dt)
        out.append(Line("gaps", "odd", text + (": nothing measures what happened in it" if long else "")))
    repeated, missing = (counts.get(k, 0) for k in ("repeated", "missing"))
    if repeated or missing:
        out.append(
            Line(
                "rows",
                "odd",
                f"left out: {repeated} that share a stamp, {missing} without a number",
            )
        )
    return out


def check_moved_rest(t: Array, values: Array) -> list[Line]:
    """Whether a record that is mostly at rest was moved: stretches of a second that move many times as much as the others, and do not come back.

    Parameters
    ----------
    t : (n,) array
        s.
    values : (n, k) array
        Signals.
    """
    count = max(2, round(1.0 / beat(t)))
    n = len(values) // count
    if n < REST_SECONDS:
        return []
    blocks = values[: n * count].reshape(n, count, -1)
    spread = blocks.std(axis=1)
    usual = np.median(spread, axis=0)
    moving = (spread > MOVED * np.maximum(usual, 1e-300)).any(axis=1)
    means = blocks[~moving].mean(axis=1)
    if (np.quantile(np.abs(np.diff(means, axis=0)), 0.95, axis=0) > RESTS * usual / np.sqrt(count)).any():
        return []  # it was never at rest
    rows = np.flatnonzero(moving)
    if rows.size < 2 or rows[-1] - rows[0] + 1 > HANDLED * n or not (usual > 0.0).all():
        return []
    first, last = float(t[rows[0] * count]), float(t[min((rows[-1] + 1) * count, t.size - 1)])
    text = (
        f"at rest, and moved between {first:.4g} and {last:.4g} s: noise and drift of the whole are those of the motion"
    )
    keep = f"to={first - 1.0:.6g} s" if first - t[0] > t[-1] - last else f"from={last + 1.0:.6g} s"
    return [Line("rest", "odd", text, f'--map "{keep}"')]


def repeats(imu: ImuRecord) -> list[Line]:
    """Rows that hold the same six numbers as the row before."""
    same = int(imu.repeated().sum())
    if same < 0.002 * len(imu):
        return []
    return [
        Line(
            "rows",
            "odd",
            f"{same} of {len(imu)} ({same / len(imu):.1%}) repeat the six values of the row before; others were lost",
        )
    ]


# -------------------------------------------------------------------------------------------------------------------- units


def magnitude(imu: ImuRecord) -> float:
    """Median size of one-second means of the specific force, in the declared unit of a rate."""
    dt = imu.dt
    count = max(1, round(1.0 / dt))
    rate = imu.rates()[:, 3:]
    rows = len(imu) // count * count
    means = rate[:rows].reshape(-1, count, 3).mean(axis=1) if rows >= count and rows else rate
    return float(np.median(np.linalg.norm(means, axis=1)))


#: Size of gravity where the numbers are in another unit than declared: size, unit to declare, what it is.
_GRAVITIES = (
    (1.0, "g", "the values are in g"),
    (1000.0, "mg", "the values are in mg"),
    (9806.65, "mm/s^2", "the values are in mm/s^2"),
    (32.17, "ft/s^2", "the values are in ft/s^2"),
    (980.665, "cm/s^2", "the values are in cm/s^2"),
    (G * 9.80665, "m/s^2", "the values were m/s^2 already, not g"),
    (9.80665e-3 * G, "m/s^2", "the values were m/s^2 already, not mg"),
)


def force(imu: ImuRecord, explained: bool) -> list[Line]:
    """The size of the specific force: rates or increments, and the unit of the accelerometer.

    Parameters
    ----------
    imu : ImuRecord
    explained : bool
        Whether the motion of the fixes agrees with it: then any size is right.
    """
    size, dt = magnitude(imu), imu.dt
    kind = "increments" if imu.kind == "increment" else "rates"
    said = f"|f| is {size:.4g} m/s^2 (median of 1-s means), {kind} in the declared unit"
    if explained:
        return [Line("specific force", "ok", f"{said}, as the motion of the fixes asks for")]
    if 0.9 * G < size < 1.1 * G:
        return [Line("specific force", "ok" if 0.98 * G < size < 1.02 * G else "odd", said)]
    if imu.kind != "increment" and near(size, G * dt, 0.15):
        text = f"|f| is {size:.4g} = 9.8 x {dt:.4g} s: the rows are increments, not rates"
        return [Line("specific force", "wrong", text, '--map "kind=increment"')]
    if imu.kind == "increment" and near(size * dt, G, 0.15):
        text = f"|f| x dt is {size * dt:.4g}: the rows are rates, not increments"
        return [Line("specific force", "wrong", text, '--map "kind=sample"')]
    fits = sorted((abs(np.log(size / wanted)), unit, what) for wanted, unit, what in _GRAVITIES)
    if fits[0][0] < np.log1p(0.1):
        text = f"|f| is {size:.4g}, expected 9.8 m/s^2; {fits[0][2]}"
        return [
            Line("specific force", "wrong", text, f'--map "accel_unit={fits[0][1]}{" s" * (imu.kind == "increment")}"')
        ]
    if size < 3.0:
        return [Line("specific force", "wrong", f"|f| is {size:.3g} m/s^2, expected 9.8: gravity was removed, which no navigation filter undoes",
                     "record the accelerometer with gravity (TotalAcceleration, AccelerometerUncalibrated)")]  # fmt: skip
    if 0.5 * G < size < MANOEUVRE * G:
        text = f"|f| is {size:.4g} m/s^2, expected 9.8: scale factor, or a manoeuvre all the time"
        return [Line("specific force", "odd", text)]
    scale = f"{G / size:.4g} m/s^2"
    text = f"|f| is {size:.4g}, expected 9.8 m/s^2; one count would be {scale} at rest"
    power = 2.0 ** round(np.log2(size))
    if power >= 1024.0 and near(size, power, 0.03):
        text, scale = f"|f| is {size:.5g}: counts of which {power:.0f} are 1 g", f"{G_STANDARD / power:.9g} m/s^2"
    return [Line("specific force", "wrong", text, f'--map "accel_unit={scale}"')]


def columns(imu: ImuRecord) -> list[Line]:
    """Columns that hold no signal: one value throughout, a rail, a value that stays, rates that no gyroscope measures, rows in reversed blocks."""
    out = []
    for sensor, block in (("gyroscope", imu.gyro), ("accelerometer", imu.accel)):
        for axis, values in zip("xyz", block.T, strict=True):
            name = f"{axis} of the {sensor}"
            low, high = float(values.min()), float(values.max())
            if low == high:
                out.append(
                    Line(
                        "columns",
                        "odd",
                        f"{name} is {low:.4g} in every row: a dead axis, another column, or a simulation without noise",
                    )
                )
                continue
            for edge in (low, high):
                inside = values[values != edge]
                at, beside = (
                    values.size - inside.size,
                    int(np.sum(inside == (inside.min() if edge == low else inside.max()))),
                )
                if at >= RAIL_ROWS and at > RAIL_SHARE * values.size and at > RAIL_OVER * beside:
                    text = f"{name} is at {edge:.5g} in {at} rows ({at / values.size:.1%}), its extreme: saturated, or clipped"
                    out.append(Line("columns", "odd", text))
    rates = imu.rates()[:, :3]
    mean = np.abs(np.median(rates, axis=0))
    spun = int(np.argmax(mean))
    if mean[spun] > SPIN and np.std(rates[:, spun]) < 0.2 * mean[spun]:
        text = f"{'xyz'[spun]} of the gyroscope stays about {mean[spun]:.3g} rad/s: no rate of a vehicle, another column (a temperature?)"
        out.append(Line("columns", "wrong", text))
    same = imu.repeated()
    if same.any():
        edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(int), [0]])))
        runs = edges[1::2] - edges[::2]
        longest = int(np.argmax(runs))
        seconds = float(runs[longest] * imu.dt)
        if seconds > FROZEN:
            at_s = float(imu.t[edges[2 * longest]] - imu.t[0])
            out.append(
                Line(
                    "columns",
                    "odd",
                    f"all six values stay the same for {seconds:.3g} s, {at_s:.4g} s after the start: frozen",
                )
            )
    return out + _blocks(imu)


def _blocks(imu: ImuRecord) -> list[Line]:
    """Rows that come in blocks of turned order: steps are larger between blocks than inside, every so many rows."""
    values = np.hstack(
        [imu.gyro / max(float(np.std(imu.gyro)), 1e-300), imu.accel / max(float(np.std(imu.accel)), 1e-300)]
    )
    step = np.minimum((np.diff(values[:BLOCK_ROWS], axis=0) ** 2).sum(axis=1), 10.0)
    for width in range(2, 65):
        n = step.size // width
        if n < 200:
            break
        by = step[: n * width].reshape(n, width)
        mean = by.mean(axis=0)
        k = int(np.argmax(mean))
        rest = np.delete(mean, k)
        error = float(by[:, k].std() / np.sqrt(n))
        if mean[k] > 1.5 * rest.max() and mean[k] - rest.mean() > 8.0 * error and rest.max() < 1.5 * rest.min():
            text = f"steps between rows are {mean[k] / rest.mean():.2g} times as large every {width} rows: blocks of rows in another order"
            return [Line("order of rows", "odd", text)]
    return []


def rates_alone(imu: ImuRecord, unstated: bool) -> list[Line]:
    """The unit of the gyroscope without fixes that tell: rates that no vehicle and no sensor at rest has.

    Parameters
    ----------
    imu : ImuRecord
    unstated : bool
        Whether the unit of the gyroscope was assumed because nobody states it.
    """
    rate = imu.rates()[:, :3]
    size = float(np.sqrt(np.median((rate**2).sum(axis=1))))
    tilt = _tilt_ratio(imu)
    if tilt is not None and near(tilt, 180 / np.pi, 0.5):
        text = f"gravity turns {tilt:.3g} times less in its axes than the gyroscope says: the values are in deg/s, not rad/s"
        return [Line("angular rate", "wrong", text, '--map "gyro_unit=deg/s"')]
    if tilt is not None and near(tilt, np.pi / 180, 0.5):
        text = f"gravity turns {1 / tilt:.3g} times more in its axes than the gyroscope says: the values are in rad/s, not deg/s"
        return [Line("angular rate", "wrong", text, '--map "gyro_unit=rad/s"')]
    if size > SPIN:
        text = f"the median rate is {size:.3g} rad/s: counts, or another unit; say what one is worth (the setting gyro_unit, such as 0.0076 deg/s)"
        return [Line("angular rate", "wrong", text)]
    noise = _fast_noise(rate) * np.sqrt(imu.dt)
    if noise * 180 / np.pi * 60 > 20.0:
        text = f"white noise of {np.rad2deg(noise) * 60:.3g} deg/sqrt(h) is more than a gyroscope has: deg/s?"
        return [Line("angular rate", "wrong" if unstated else "odd", text, '--map "gyro_unit=deg/s"')]
    said = f"median size {size:.3g} rad/s ({np.rad2deg(size):.3g} deg/s); not checkable: no motion of fixes to hold it against"
    if tilt is not None and near(tilt, 1.0, 0.5):
        return [Line("angular rate", "ok", f"gravity turns in its axes as the gyroscope says (ratio {tilt:.2f})")]
    return [Line("angular rate", "assumed", said)]


def _fast_noise(values: Array) -> float:
    """Standard deviation of the fastest part, of the quietest axis: third differences hold no motion."""
    third = np.diff(values, n=3, axis=0)
    return (
        float(np.min(1.4826 * np.median(np.abs(third - np.median(third, axis=0)), axis=0))) / np.sqrt(20.0)
        if len(third)
        else 0.0
    )


def _tilt_ratio(imu: ImuRecord) -> float | None:
    """How many times more the gyroscope turns than gravity does in its axes; None where the attitude hardly changes."""
    count = max(1, round(1.0 / imu.dt))
    n = len(imu) // count
    if n < 10:
        return None
    rows = n * count
    f = imu.accel[:rows].reshape(n, count, 3).mean(axis=1)
    angle = imu.rates()[:rows, :3].reshape(n, count, 3).sum(axis=1) * imu.dt
    u = f / np.maximum(np.linalg.norm(f, axis=1), 1e-12)[:, None]
    seen = np.diff(u, axis=0)
    said = -np.cross(0.5 * (angle[1:] + angle[:-1]), 0.5 * (u[1:] + u[:-1]))
    moved, power = float((seen**2).sum()), float((said**2).sum())
    if power <= 0.0 or np.sqrt(moved / len(seen)) < np.deg2rad(3.0):
        return None
    correlation = float((seen * said).sum()) / np.sqrt(moved * power)
    return float(power / (seen * said).sum()) if correlation > TILTED else None


# ---------------------------------------------------------------------------------------------------------------------- axes


_NAMES = {(0.0, 0.0, 0.0): "FRD", (180.0, 0.0, 0.0): "FLU", (180.0, 0.0, 90.0): "RFU"}


def axes(imu: ImuRecord, push: Push | None) -> list[Line]:
    """Where the sensor's axes point: up from gravity, forward from speeding up and turning.

    Parameters
    ----------
    imu : ImuRecord
    push : Push or None
        What the fixes say.
    """
    up, steady = up_of(imu)
    if steady < 0.9:
        return [
            Line(
                "axes",
                "ok",
                f"gravity wanders over the axes (mean direction {steady:.2f}): hand-held or flying, no mounting is guessed",
            )
        ]
    k = int(np.argmax(np.abs(up)))
    axis = ("-" if up[k] < 0 else "") + "xyz"[k]
    tilt = float(np.rad2deg(np.arccos(min(1.0, abs(up[k])))))
    z_down = k == 2 and up[2] < 0
    said = f"gravity says that {axis} points up ({tilt:.1f} deg off)"
    known = believed(push)
    if not known:
        if z_down:
            return [Line("axes", "ok", f"{said}: z down, as forward-right-down; nothing says where x points")]
        mend = '--map "axes=FLU"' if k == 2 else '--map "mount=ROLL PITCH YAW"'
        what = "z up: forward-left-up, east-north-up, or mounted upside down" if k == 2 else "mounted on its side"
        return [Line("axes", "odd", f"{said}, {what}; forward-right-down is expected", mend)]
    assert push is not None
    roll, pitch, yaw = mounting(up, push.yaw)
    ahead = f"x points {np.rad2deg(push.yaw):.0f} deg right of forward (correlation {push.correlation:.2f})"
    evidence = f"{said}; speeding up and turning say that {ahead}"
    square = tuple(float(90 * round(v / 90)) % 360 for v in (roll, pitch, yaw))
    off = max(abs((v - s + 180) % 360 - 180) for v, s in zip((roll, pitch, yaw), square, strict=True))
    if z_down and abs(np.rad2deg(push.yaw)) < SQUARE:
        return [Line("axes", "ok", f"{evidence}: forward-right-down")]
    square = tuple((v + 180) % 360 - 180 for v in square)
    name = _name_of(up, push.yaw) if off < SQUARE else ""
    text = f"{evidence}: roll {roll:.0f}, pitch {pitch:.0f}, yaw {yaw:.0f} deg from the IMU to the vehicle" + (
        f" ({name})" if name else ""
    )
    mend = f'--map "axes={name}"' if name and off < 10.0 else f'--map "mount={roll:.1f} {pitch:.1f} {yaw:.1f}"'
    return [Line("axes", "odd", text, mend)]


def mounting(up: Array, yaw: float) -> tuple[float, float, float]:
    """Roll, pitch and yaw (deg) from IMU to vehicle axes of an up direction and the direction of x."""
    forward = np.array([1.0, 0.0, 0.0]) - up[0] * up
    if abs(up[0]) >= 0.9:
        forward = np.cross(up, [0.0, 1.0, 0.0])
    forward = forward / np.linalg.norm(forward)
    level = np.stack([forward, np.cross(-up, forward), -up])
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    rpy = np.rad2deg(rotation.rpy_from_dcm(turn @ level))
    return float(rpy[0]), float(rpy[1]), float(rpy[2])


def _name_of(up: Array, yaw: float) -> str:
    """Letters of axes that are nearly square to the vehicle's: where x, y and z point."""
    C = rotation.dcm_from_rpy(np.deg2rad(mounting(up, yaw)))
    letters = ""
    for column in C.T:
        k = int(np.argmax(np.abs(column)))
        letters += ("FRD" if column[k] > 0 else "BLU")[k]
    return letters if len({"FRDBLU".index(c) % 3 for c in letters}) == 3 else ""
