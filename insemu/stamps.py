"""Stamps of the field as seconds from a whole second, and the origin that a recording counts from.

A float64 holds seconds since 1970 to 0.24 us and stamps in ns since then to 256 ns. Stamps that are whole numbers or decimals are therefore
counted in integers before anything is subtracted, and every recording counts float64 seconds from the second in which it begins.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Nanoseconds in a second.
SECOND = 1_000_000_000
#: Beyond this many units in the last decimal a float64 no longer tells neighbouring decimals apart by more than its own rounding.
_MOST = 2.0**51
#: Stamps that are looked at before all of them are.
_FEW = 1000


@dataclass(frozen=True)
class Origin:
    """When time 0 of a recording was.

    Parameters
    ----------
    ns : int
        Nanoseconds on the clock.
    clock : str
        Key of :data:`insemu.formats.clocks.CLOCKS`; "" where it is not known.
    """

    ns: int = 0
    clock: str = ""


#: A clock of the device's own that counts from its 0 s.
OWN = Origin()


def counted(stamps: NDArray[Any], unit_s: float = 1.0) -> tuple[int, Array]:
    """Count stamps from the second in which the first one lies.

    Parameters
    ----------
    stamps : (n,) array
        Whole numbers, floats, or dates (``datetime64``: ns since 1970); NaN or NaT where one is missing.
    unit_s : float
        Their unit in s.

    Returns
    -------
    int
        The last whole second that is not after the first stamp, in ns.
    (n,) array
        Seconds from it, NaN where a stamp is missing: without any rounding but the last where the stamps are whole numbers of a unit, or
        decimals that a float64 still tells apart; of others the differences are those of the floats.

    Examples
    --------
    >>> counted(np.array([1_764_400_000_005_000_000, 1_764_400_000_010_000_000]), 1e-9)
    (1764400000000000000, array([0.005, 0.01 ]))
    >>> counted(np.array([1764400000.005, 1764400000.010]))
    (1764400000000000000, array([0.005, 0.01 ]))
    """
    if stamps.dtype.kind == "M":
        found, unit_s = stamps.astype("datetime64[ns]"), 1e-9
        missing = np.isnat(found)
        nanoseconds = found.view(np.int64)
        if not missing.any():
            return counted(nanoseconds, unit_s)
        out = np.full(stamps.size, np.nan)
        if missing.all():
            return 0, out
        first, out[~missing] = counted(nanoseconds[~missing], unit_s)
        return first, out
    if stamps.dtype.kind in "iu":
        stamps = stamps.astype(np.int64) if stamps.size and int(stamps.max()) < 2**62 else stamps
        return _whole(stamps, Fraction(str(unit_s)) * SECOND)
    x = np.asarray(stamps, dtype=np.float64)
    good = np.isfinite(x)
    if not good.all():
        out = np.full(x.size, np.nan)
        if not good.any():
            return 0, out
        first, out[good] = counted(x[good], unit_s)
        return first, out
    if not x.size:
        return 0, x
    unit = Fraction(str(unit_s)) * SECOND
    decimals = _decimals(x, unit)
    if decimals is not None:
        whole, digits = decimals
        return _whole(whole, unit / 10**digits)
    start = _second(Fraction(float(x[0])) * unit)
    if unit_s == 1.0:
        return start, x - start // SECOND
    return start, (x - x[0]) * unit_s + float((Fraction(float(x[0])) * unit - start) / SECOND)


def _second(ns: Fraction) -> int:
    """The whole second at or before a time, in ns."""
    return int(ns // SECOND) * SECOND


def _whole(stamps: NDArray[Any], unit: Fraction) -> tuple[int, Array]:
    """Whole numbers of a unit, in ns, from the second of the first; floats have none that are not exact."""
    if not stamps.size:
        return 0, np.zeros(0)
    first = int(stamps[0])
    start = _second(first * unit)
    per = SECOND / unit  # units in a second
    whole = per.denominator == 1
    since = start * per / SECOND if whole else Fraction(first)  # the second in units
    exact = stamps.dtype.kind == "i" and whole and -(2**62) < int(stamps.min()) and int(stamps.max()) < 2**62
    steps = stamps - int(since) if exact else np.asarray(stamps, dtype=np.float64) - float(since)
    if whole:
        return start, np.asarray(steps / float(per), dtype=np.float64)
    return start, np.asarray(steps * float(unit / SECOND) + float((first * unit - start) / SECOND), dtype=np.float64)


def _decimals(x: Array, unit: Fraction) -> tuple[Array, int] | None:
    """Stamps as whole numbers of a decimal, and which, none beyond ns; None where they are no decimals."""
    largest = max(-float(x.min()), float(x.max()))
    for digits in range(10):
        tens = 10.0**digits
        if largest * tens >= _MOST or (unit / 10**digits).denominator != 1:
            return None
        for part in (x[:_FEW], x):  # the floats nearest to whole numbers of a tenth, a hundredth, ...
            whole = np.rint(part * tens)
            if not np.array_equal(whole / tens, part):
                break
        else:
            return whole, digits
    return None
