"""Intake: what a file was taken for and whether physics agrees, before anything is computed from it.

:func:`examine` makes the card of a recording, of a log at rest or of whatever was opened; :meth:`~insemu.intake.card.Card.check` refuses what
contradicts physics with the command that mends it.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from insemu import formats
from insemu.errors import InputError
from insemu.formats import Log, Opened, start_said
from insemu.intake import checks, receiver, tried
from insemu.intake import fixes as fixed
from insemu.intake.card import Card, Level, Line
from insemu.intake.fixes import vehicle_axes
from insemu.intake.motion import track_of
from insemu.intake.receiver import velocity_lag
from insemu.records import AXES, AidRecord, ImuRecord, Reading, Recording
from insemu.variance import missing_values, unit_report

__all__ = [
    "Card",
    "Level",
    "Line",
    "card_of",
    "examine",
    "found_in",
    "recording_of",
    "take",
    "track_of",
    "vehicle_axes",
    "velocity_lag",
]

_Data = TypeVar("_Data")

#: Rows of a log that are looked at for its units.
_ROWS = 1 << 20


def examine(data: Opened | Recording | Log, kind: str = "") -> Card:
    """Make the intake card.

    Parameters
    ----------
    data : Opened, Recording or Log
        What was read.
    kind : str
        What it was taken for; the reader's name where it is known.

    Returns
    -------
    Card
    """
    with np.errstate(all="ignore"):  # absurd numbers make absurd findings, not warnings of a library
        if isinstance(data, Log):
            return Card(data.source, kind or "static log", tuple(_log_lines(data)))
        found = _opened(data, kind)
        card = tried.tried(found, lambda opened: _examined(opened, kind))
        return card.accepted() if found.accepted else card


def _opened(data: Opened | Recording, kind: str) -> Opened:
    """A recording as what was opened; one that is in memory is read again from a file of our own layout."""
    if isinstance(data, Opened):
        return data
    how = data.reading or Reading(kind or "recording", notes=data.remarks)
    return Opened(
        data.source,
        imu=data.imu,
        gnss=data.gnss,
        reference=data.reference,
        aids=data.aids,
        origin=data.origin,
        **vars(how),
    )


def _examined(data: Opened, kind: str) -> Card:
    lines = [Line("taken", "ok", text) for text in data.taken]
    lines += [Line("assumed", "assumed", text) for text in data.assumed]
    lines += [Line("start", "ok", text) for text in [start_said(data.origin)] if text]
    lines += [Line("done", "odd" if "left out" in text else "ok", text) for text in data.notes]
    unstated = {role for role in ("gyro", "accel", "vel") for a in data.assumed if a.startswith(role)}
    found = receiver.agreement(data.gnss) if data.gnss is not None else None
    if data.imu is not None:
        lines += _imu_lines(data, data.imu, found, unstated)
    if data.gnss is not None:
        opposite = fixed.upright(data.imu, data.gnss, found) if data.imu is not None else 0.0
        lines += receiver.fixes(data.gnss, found, "vel" in unstated, opposite)
    if data.reference is not None:
        t = data.reference.t
        lines.append(
            Line(
                "reference",
                "ok",
                f"{t.size} rows at {1 / np.median(np.diff(t)):.4g} Hz from {t[0]:.6g} to {t[-1]:.6g} s",
            )
        )
        if data.gnss is not None:
            lines += fixed.against_reference(data.gnss, data.reference)
    lines += [_aid_line(aid) for aid in data.aids if len(aid)]
    return Card(data.source, kind or data.kind, tuple(lines))


def _aid_line(aid: AidRecord) -> Line:
    """How many measurements an aid has, how often and how good."""
    rate = f" at {1.0 / np.median(np.diff(aid.t)):.3g} Hz" if len(aid) > 1 else ""
    sigma = ", ".join(f"{s:.3g}" for s in np.median(aid.std, axis=0))
    return Line(aid.kind, "ok", f"{len(aid)} measurements{rate}, stated standard deviations {sigma} (SI, median)")


def _imu_lines(data: Opened, imu: ImuRecord, found: receiver.Agreement | None, unstated: set[str]) -> list[Line]:
    counts = {"repeated": data.repeated, "missing": data.missing}
    lines = checks.timing(imu.t, counts) + checks.repeats(imu) + checks.columns(imu)
    push, gnss = None, data.gnss
    if gnss is None:
        lines += checks.check_moved_rest(imu.t, imu.rates())
    motion: list[Line] = []
    if gnss is not None:
        apart = fixed.together(imu, gnss, "fixes")
        lines += apart
        if not fixed.refused(apart):
            turn, push = fixed.against_fixes(imu, gnss, found)
            motion, stands = fixed.weighed(imu, gnss, found, data.units, turn)
            lines += motion or fixed.offset(turn)
            if not stands:  # what is read wrongly says nothing about axes
                return lines + [x for x in checks.force(imu, False) if x.level == "wrong" and "--map" not in x.mend]
            lines += fixed.slope(turn)
    lines += checks.force(imu, any(x.topic == "motion" and x.level == "ok" for x in motion))
    if data.reference is not None:
        lines += fixed.together(imu, data.reference, "reference")
    if not any(x.level == "ok" for x in motion):
        lines += checks.rates_alone(imu, "gyro" in unstated)
    lines += checks.axes(imu, push)
    return lines


def _log_lines(log: Log) -> list[Line]:
    """Lines about a log at rest: rate, gaps, what is not a number, and the units by what a sensor at rest reads."""
    seconds = len(log) / log.rate_hz
    lines = [
        Line(
            "taken",
            "ok",
            ", ".join(f"{n} ({u or 'no unit'})" for n, u in zip(log.names, log.stated_units, strict=True)),
        )
    ]
    lines += [Line("done", "ok", text) for text in log.remarks]
    if log.t is not None:
        lines += checks.timing(log.t, {}, moving=False)
    else:
        lines.append(Line("rate", "ok", f"{len(log)} samples at {log.rate_hz:.6g} Hz ({seconds:.4g} s)"))
    if log.rate_hz > checks.RATES[1]:
        lines.append(Line("rate", "odd", f"{log.rate_hz:.6g} Hz is faster than any IMU"))
    means, white, stated = {}, {}, {}
    for name, unit, column in zip(log.names, log.stated_units, log.columns, strict=True):
        axis = formats.AXIS_OF_COLUMN.get(name, name)
        part = np.asarray(column[:_ROWS], dtype=np.float64)
        lines += [Line("rows", "odd", f"{name}: {text}") for text in missing_values(part, log.rate_hz)]
        part = part[np.abs(part) < 1e100]  # beyond that no square is a number
        if part.size > 3:
            means[axis], stated[axis] = float(part.mean()), unit
            third = np.diff(part, n=3)
            white[axis] = float(1.4826 * np.median(np.abs(third - np.median(third)))) / np.sqrt(20.0 * log.rate_hz)
    if any(x.topic in ("gaps", "rows") and x.level == "odd" for x in lines):
        text = "missing samples are left out of wavelet moments, where they have degrees of freedom less; nothing is filled in"
        lines.append(Line("missing", "assumed", text))
    said: dict[str, list[str]] = {}
    for axis, texts in unit_report(means, white, stated).items():
        for text in texts:
            said.setdefault(text.removeprefix("units: "), []).append(axis)
    for text, names in said.items():
        lines.append(_unit_line(text, names, stated))
    if not any("assumed" in t or "values" in t for t in said) and set(AXES) & set(means):
        lines.append(
            Line("units", "ok", "size of gravity and of the rates are those of a sensor at rest in the stated units")
        )
    return lines


def _unit_line(text: str, names: list[str], stated: dict[str, str]) -> Line:
    """A finding about units: assumed, odd, or wrong where the file stated no unit and the assumed one cannot be."""
    of = ", ".join(names)
    if "is assumed" in text or "raw counts" in text:
        return Line("units", "assumed", f"{of}: {text}")
    unit = "m/s^2" if "already" in text else next((u for u in ("deg/s", "mg", "g") if text.endswith(f"in {u}")), "")
    sensor = "gyro" if names[0].startswith("gyro") else "accel"
    contradicted = bool(unit) and all(stated[n].strip() in ("", "-") for n in names)
    gravity = sensor == "accel" and unit in ("g", "mg", "m/s^2")
    level: Level = "wrong" if contradicted or gravity else "odd"
    return Line("units", level, f"{of}: {text}", f'--map "{sensor}_unit={unit}"' if unit else "")


def card_of(path: str | Path, *, rate_hz: float | None = None) -> Card:
    """Read a file by the doors of :mod:`insemu.formats` and make its card.

    Raises
    ------
    InputError
        As :func:`insemu.formats.read`.
    FileNotFoundError
        No such file.
    """
    if formats.layout_of(path) == "log":
        return examine(formats.read_log(path, rate_hz=rate_hz))
    return examine(formats.opened(path))


def take(
    path: str | Path,
    *,
    gnss: str | Path | None = None,
    truth: str | Path | None = None,
    maps: tuple[str, str, str] = ("", "", ""),
) -> tuple[Opened | Log, Card]:
    """The one door for files whose kind nobody says: what they hold and the card, which may refuse it.

    Parameters
    ----------
    path, gnss, truth, maps
        As of :func:`insemu.formats.open_files`.

    Returns
    -------
    Opened or Log, Card
        A log where the file is one of our own and no IMU (fewer than six columns).

    Raises
    ------
    InputError, FileNotFoundError
        As :func:`insemu.formats.open_files`.
    """
    alone = not (gnss or truth or any(maps))
    if alone and formats.layout_of(path) == "log":
        log = formats.read_log(path)
        if len(log.names) < len(AXES):
            return log, examine(log)
    found = formats.open_files(path, gnss=gnss or None, truth=truth or None, maps=maps)
    return found, examine(found)


def recording_of(found: Opened | Log) -> Recording:
    """The recording of what :func:`take` found; raises :class:`~insemu.errors.InputError` where there is no IMU."""
    if isinstance(found, Log):
        raise InputError(f"holds {', '.join(found.names)} and no IMU, expected six axes", where=found.source)
    return found.recording()


def found_in(data: _Data, card: Card) -> _Data:
    """Data with what intake found as its remarks; those that carry none as they are."""
    return replace(data, remarks=card.remarks) if isinstance(data, Recording) else data
