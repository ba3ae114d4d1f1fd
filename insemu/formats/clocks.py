"""Clocks of the field: GPS time, seconds of the week, UTC, and stamps whose unit nobody wrote down."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.stamps import SECOND, Origin, counted
from insemu.units import parse_unit, scaled_unit

Array = NDArray[np.float64]

#: GPS time began at 1980-01-06 00:00 UTC; s since 1970.
GPS_EPOCH = 315_964_800.0
WEEK = 604_800.0
#: First days (UTC) from which GPS time is so many seconds ahead of UTC (IERS Bulletin C).
_LEAPS = (
    "1981-07", "1982-07", "1983-07", "1985-07", "1988-01", "1990-01", "1991-01", "1992-07", "1993-07", "1994-07",
    "1996-01", "1997-07", "1999-01", "2006-01", "2009-01", "2012-07", "2015-07", "2017-01",
)  # fmt: skip
_LEAP_STARTS = np.array([datetime.strptime(d, "%Y-%m").replace(tzinfo=UTC).timestamp() for d in _LEAPS])

#: Clocks that are known by name; "" is a clock of the device's own.
CLOCKS: Mapping[str, str] = {
    "": "the device's own clock",
    "gps": "GPS time (s since 1980-01-06)",
    "sow": "GPS seconds of the week",
    "unix": "UTC (s since 1970)",
}


def leap_seconds(unix: float) -> int:
    """How many seconds GPS time is ahead of UTC.

    >>> leap_seconds(1_700_000_000.0)
    18
    """
    return int(np.searchsorted(_LEAP_STARTS, unix, side="right"))


def utc_of(origin: Origin) -> float | None:
    """When time 0 was, in UTC s since 1970; None where the clock does not tell."""
    if origin.clock == "unix":
        return origin.ns / SECOND
    if origin.clock != "gps":
        return None
    gps = origin.ns / SECOND + GPS_EPOCH
    return gps - leap_seconds(gps - leap_seconds(gps))


def seconds_of_date(text: str, where: str) -> float:
    """A date as s since 1970 (UTC, which is meant where it states no zone).

    Raises
    ------
    InputError
        No date of ISO 8601.

    >>> seconds_of_date("2025-11-29T07:06:40Z", "start")
    1764400000.0
    """
    try:
        when = datetime.fromisoformat(text.strip().replace("Z", "+00:00"))
    except ValueError:
        raise InputError(f"is '{text[:40]}', expected a date such as 2024-05-01T12:00:00Z", where=where) from None
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()


def start_said(origin: Origin) -> str:
    """When time 0 was, in words; "" of a device's own clock that counts from 0.

    >>> start_said(Origin(1_764_400_000_000_000_000, "unix"))
    'time 0 is 2025-11-29 07:06:40 UTC, GPS time 18 s ahead'
    """
    seconds = origin.ns / SECOND
    utc = utc_of(origin)
    if utc is not None and 0.0 <= utc < 4.2e9:
        when = datetime.fromtimestamp(utc, UTC).strftime("%Y-%m-%d %H:%M:%S")
        return f"time 0 is {when} UTC, GPS time {leap_seconds(utc)} s ahead"
    clock = CLOCKS[origin.clock]
    return f"time 0 is {seconds:.15g} s of {clock}" if origin.ns or origin.clock else ""


def converted(t: Array, given: str, wanted: str, near: float) -> tuple[Array, str]:
    """Turn times of one clock into another's.

    Parameters
    ----------
    t : (n,) array
        s.
    given, wanted : str
        Keys of :data:`CLOCKS`.
    near : float
        A time of the wanted clock near the first of ``t``: it tells the week.

    Returns
    -------
    (n,) array, str
        Times in s; what was done, "" where nothing was.

    Raises
    ------
    InputError
        An unknown clock.
    """
    for name in (given, wanted):
        if name not in CLOCKS:
            raise InputError(f"unknown clock '{name}', expected one of: gps, sow, unix")
    if given == wanted == "sow" and t.size:
        weeks = np.round((near - float(t[0])) / WEEK)
        return t + weeks * WEEK, f"{int(weeks)} GPS week(s) added: the week ended in between" if weeks else ""
    if given == wanted or not given or not wanted or not t.size:
        return t, ""
    done = []
    if given == "unix":
        leap = leap_seconds(float(t[0]))
        t, given = t - GPS_EPOCH + leap, "gps"
        done.append(f"UTC turned into GPS time with {leap} leap seconds")
    if wanted == "unix":
        if given == "sow":
            week = np.round((near - GPS_EPOCH - float(t[0])) / WEEK)
            t = t + week * WEEK
        leap = leap_seconds(float(t[0]) + GPS_EPOCH)
        return t + GPS_EPOCH - leap, f"GPS time turned into UTC with {leap} leap seconds"
    if given == "gps" and wanted == "sow":
        week = np.round((float(t[0]) - near) / WEEK)
        t = t - week * WEEK
        done.append(f"GPS week {int(week)} removed")
    elif given == "sow" and wanted == "gps":
        week = np.round((near - float(t[0])) / WEEK)
        t = t + week * WEEK
        done.append(f"GPS week {int(week)} added")
    return t, "; ".join(done)


#: Calendars that count days, and where 1970 is in each (d): their days of 2000 to 2040 do not meet.
_DAYS = (("Excel", 25_569.0), ("modified Julian", 40_587.0), ("MATLAB", 719_529.0), ("Julian", 2_440_587.5))
#: s since 1970 of 2000 and 2040; longest step of a stamp in days that would be none in s.
_YEARS, _LONGEST_DAY_STEP = (9.46e8, 2.21e9), 1.2e-4


def calendar_days(first: float) -> tuple[str, float]:
    """Which calendar's day a stamp in days is, and where 1970 is in it, d; "" and 0 where it is none of 2000 to 2040."""
    return next(((n, z) for n, z in _DAYS if _YEARS[0] < (first - z) * 86_400.0 < _YEARS[1]), ("", 0.0))


def clock_digits(stamps: NDArray[Any]) -> Array | None:
    """Seconds of the day of stamps whose digits are hours, minutes and seconds (``HHMMSS``, ``HHMMSS.sss``, ``HHMMSSsss``), else None.

    Only where a minute passes: within one the stamps count seconds (or ms) themselves.

    >>> clock_digits(np.array([93059980, 93059990, 93100000])).tolist()
    [34259.98, 34259.99, 34260.0]
    """
    for unit in (1, 1000):
        clock = np.asarray(stamps, dtype=np.float64)
        if clock.size < 3 or clock[0] < 100 * unit or clock.max() >= 240_000 * unit:
            continue
        whole = np.floor(clock / unit)
        seconds = np.mod(whole, 100.0)
        minutes = np.mod(np.floor(whole / 100.0), 100.0)
        if seconds.max() >= 60.0 or minutes.max() >= 60.0 or not (np.diff(minutes) != 0.0).any():
            continue
        day = np.floor(whole / 10_000.0) * 3600.0 + minutes * 60.0 + seconds
        return np.asarray(np.round(day + (clock - whole * unit) / unit, 9))
    return None


#: Units of stamps, by s; tried in this order where nobody says.
_STAMP_UNITS = (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))
#: Rates that an IMU or a receiver has, Hz.
_RATES = (0.05, 2.0e4)


def stamp_unit(t: NDArray[np.float64] | NDArray[np.int64], name: str = "", fastest: float = 5.0) -> tuple[str, str]:
    """Unit of stamps from their size and step, and the evidence.

    Parameters
    ----------
    t : (n,) array
        Stamps in an unknown unit.
    name : str
        Of the column; ``time_us`` and the like decide.
    fastest : float
        A step of 2 and more is one of the smallest unit that makes a rate above this, Hz; infinite for fixes, which may be slow.

    Returns
    -------
    str, str
        Unit and evidence. Seconds where nothing tells.

    >>> stamp_unit(np.arange(100) * 10_000_000)[0]
    'ns'
    """
    low = name.lower().rstrip("]) ")
    for unit, _ in _STAMP_UNITS[1:]:
        if low.endswith(("_" + unit, "[" + unit, "(" + unit)) or low == unit:
            return unit, f"the column is called '{name}'"
    for word, unit in (
        ("nano", "ns"),
        ("micro", "us"),
        ("milli", "ms"),
        ("nsec", "ns"),
        ("usec", "us"),
        ("msec", "ms"),
    ):
        if word in low:
            return unit, f"the column is called '{name}'"
    size = float(np.abs(t[0])) if t.size else 0.0
    for unit, factor in _STAMP_UNITS:
        if unit != "s" and 6.0e8 < size * factor < 4.2e9:
            return unit, f"the first stamp, {size:.6g}, is a date in {unit}"
    step = float(np.median(np.diff(t.astype(np.float64)))) if t.size > 1 else 0.0
    if step <= 0.0:
        return "s", "nothing tells"
    calendar = calendar_days(size)[0]
    if calendar and step < _LONGEST_DAY_STEP:
        return "day", f"the first stamp, {size:.9g}, is a day of the {calendar} calendar"
    if size and 6.0e8 < size < 4.2e9:
        return "s", f"the first stamp, {size:.6g}, is a date in s"
    likely = [(u, 1.0 / (step * f)) for u, f in _STAMP_UNITS if _RATES[0] <= 1.0 / (step * f) <= _RATES[1]]
    if step < 1.0 and likely and likely[0][0] == "s":
        return "s", f"a step of {step:.6g} s is {1.0 / step:.6g} Hz"
    fast = [(u, r) for u, r in likely if r >= fastest]
    if step >= 2.0 and fast:
        unit, rate = fast[0]
        return unit, f"a step of {step:.6g} is {rate:.6g} Hz in {unit}"
    if step > 1.0 / _RATES[0] and likely:
        unit, rate = likely[0]
        return unit, f"a step of {step:.6g} is {rate:.6g} Hz in {unit}"
    return "s", f"a step of {step:.6g} s"


def read_stamps(
    stamps: NDArray[Any], name: str, unit: str, where: str, fastest: float = 5.0
) -> tuple[int, Array, float, str]:
    """Stamps as they are in a file as seconds: counts of any unit, days of a calendar, digits of a clock, dates.

    Parameters
    ----------
    stamps : (n,) array
        Numbers, or ``datetime64``; NaN where one is missing.
    name, unit : str
        Of the column; "" for a unit that nobody states, which the numbers then decide.
    where : str
        Place, for the message.
    fastest : float
        As of :func:`stamp_unit`.

    Returns
    -------
    int, (n,) array, float, str
        The second of the first stamp in ns, s from it, the unit in s, and what was assumed.

    Raises
    ------
    InputError
        A unit that is none of time.
    """
    assumed = ""
    if stamps.dtype.kind == "M":
        return *counted(stamps), 1.0, ""
    finite = stamps[np.isfinite(stamps)] if stamps.dtype.kind == "f" else stamps
    if not unit:
        clock = clock_digits(finite) if finite.size == stamps.size else None
        if clock is not None:
            said = f"stamps are hours, minutes and seconds: the digits of {name} read so pass every minute evenly"
            return *counted(clock), 1.0, said
        unit, evidence = stamp_unit(finite, name, fastest)
        assumed = f"stamps in {unit}: {evidence}" if unit != "s" else ""
    factor = scaled_unit(unit)
    if factor.dimension != parse_unit("s").dimension:
        raise InputError(f"the times have the unit '{unit}', expected s, ms, us or ns", where=where)
    start, t = counted(stamps, factor.factor)
    if unit == "day" and t.size:
        start -= round(calendar_days(start / SECOND / factor.factor)[1] * factor.factor) * SECOND
    return start, t, factor.factor, assumed
