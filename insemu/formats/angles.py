"""Units of latitudes and longitudes, and what is no latitude."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.formats.columns import ColumnMap, resolve
from insemu.formats.table import Table

Array = NDArray[np.float64]

#: Latitudes and longitudes whose digits are degrees and minutes.
DIGITS = ("ddmm", "dd.mm")


def place_unit(used: ColumnMap, table: Table, names: list[str]) -> str:
    """Unit of latitude and longitude: as said; where nobody says, that of numbers which are none in degrees; "" for the one that is stated.

    Parameters
    ----------
    used : ColumnMap
    table : Table
    names : list of str
        Columns of the table.
    """
    if "pos_unit" in used.settings:
        return used.settings["pos_unit"]
    if not {"lat", "lon"} <= set(used.picks):
        return ""
    found = [resolve(r, used.picks[r], names, table.name)[0] for r in ("lat", "lon")]
    if any(pick.unit is not None or table.units.get(names[k]) for k, pick in found):
        return ""
    lat, lon = (np.abs(np.asarray(table.columns[names[k]], dtype=np.float64)) for k, _ in found)
    largest = float(np.nanmax(lat, initial=0.0))
    if largest <= 90.0 or not np.isfinite(largest):
        return ""
    if largest > 1e6 and float(np.nanmax(lon, initial=0.0)) <= 1.8e9:
        return "1e-7 deg"
    minutes = all(bool((np.mod(v[np.isfinite(v)], 100.0) < 60.0).all()) for v in (lat, lon))
    return "ddmm" if largest <= 9000.0 and float(np.nanmax(lon, initial=0.0)) <= 18000.0 and minutes else ""


def digits(values: NDArray[Any], unit: str) -> Array:
    """Degrees of numbers whose digits are degrees and minutes (NMEA's ``ddmm.mmmm``), or whose decimals are (``dd.mmmmmm``)."""
    v = np.abs(np.asarray(values, dtype=np.float64)) / (100.0 if unit == "ddmm" else 1.0)
    whole = np.trunc(v + 1e-12)
    return np.asarray(np.copysign(whole + (v - whole) / 0.6, values))


def check_latitude(llh: Array, where: str) -> None:
    """Refuse latitudes beyond the pole with what would make them right."""
    largest = np.nanmax(np.abs(llh[:, 0]), initial=0.0)
    if largest <= np.pi / 2 + 1e-12:
        return
    degrees, other = np.rad2deg(largest), np.nanmax(np.abs(llh[:, 1]), initial=0.0)
    if other <= np.pi / 2 and degrees <= 360.0:  # the only reading that is one
        hint = 'latitude and longitude are swapped: --map "latlon=swapped"'
    elif largest <= 90.0 and other <= 360.0:
        hint = 'the unit is degrees, not rad: --map "pos_unit=deg"'
    elif degrees <= 90e7:
        hint = 'is it in 1e-7 deg? --map "pos_unit=1e-7 deg"'
    else:
        hint = "another unit (the setting pos_unit)"
    raise InputError(f"a latitude of {degrees:.6g} deg is beyond 90; {hint}", where=where)
