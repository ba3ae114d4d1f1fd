"""Aids: measurements beside the fixes, one file each.

A module in this folder is read when the package is: its ``AID`` (:class:`~insemu.filters.aid.Aid`) is known by name from then on to the compiled
filter, its filterpy twin, scenarios (``aids``) and recording files, and nothing else has to name it.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pkgutil import iter_modules
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.filters.aid import SETTINGS, Aid
from insemu.filters.aids.standstill import Standstill
from insemu.records import AidRecord

__all__ = ["AIDS", "CODES", "Standstill", "aid_jacobian", "fill_aid"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: All kinds of aids by name.
AIDS: dict[str, Aid] = {
    aid.name: aid for aid in (import_module(f"{__name__}.{found.name}").AID for found in iter_modules(__path__))
}
#: What stands for each in the compiled loop, from 1 on (0 is a fix).
CODES = {name: k for k, name in enumerate(AIDS, start=1)}


@njit(nogil=True)
def _none(kind: int, *given: Any) -> None:
    """No aid has this code."""


def _either(code: int, fill: Callable[..., None], rest: Callable[..., None]) -> Callable[..., None]:
    """One aid, or the rest: compiled code cannot look a function up in a table."""

    @njit(nogil=True)
    def chosen(kind: int, *given: Any) -> None:
        if kind == code:
            fill(*given)
        else:
            rest(kind, *given)

    return chosen


_fill = _none
for _name, _aid in AIDS.items():
    _fill = _either(CODES[_name], _aid.fill, _fill)


@njit(cache=True, nogil=True)
def fill_aid(
    kind: int,
    nav: Array,
    nav_before: Array,
    dt: float,
    tau: float,
    mean_rate: Array,
    count: int,
    white: Array,
    c_of: Array,
    axis: Ints,
    z: Array,
    settings: Array,
    nu: Array,
    H: Array,
    R: Array,
) -> None:
    """Innovation (measured minus predicted), Jacobian of the prediction, and added noise of one aid.

    Parameters
    ----------
    kind : int
        Code of the aid, :data:`CODES`.
    nav, nav_before : (13,) arrays
        State at this epoch and at the one before, ``dt`` seconds earlier.
    dt, tau : float
        s; the aid was valid ``tau`` seconds before this epoch, less than ``dt``.
    mean_rate, count : (3,) array, int
        Corrected angular rate averaged since ``AidRecord.since``, rad/s, and over how many samples.
    white, c_of, axis
        See :func:`insemu.filters.measurements.fill_fix`.
    z : (w,) array
        Measured values.
    settings : (SETTINGS,) array
        Constants of the aid, for example a lever arm.
    nu, H, R : (w,), (w, n), (w, w) arrays
        Overwritten; the variances of the record are added to ``R`` afterwards.
    """
    nu[:] = 0.0
    H[:, :] = 0.0
    R[:, :] = 0.0
    _fill(kind, nav, nav_before, dt, tau, mean_rate, count, white, c_of, axis, z, settings, nu, H, R)


def aid_jacobian(aid: AidRecord, nav: Array) -> Array:
    """What each row of an aid moves by errors of the navigation, (rows, 9).

    Parameters
    ----------
    aid : AidRecord
        Of which kind and settings count.
    nav : (10,) array
        Navigation state.
    """
    w = len(AIDS[aid.kind].rows)
    settings, state = np.zeros(SETTINGS), np.zeros(13)
    settings[: len(aid.settings)], state[:10] = aid.settings, nav
    nu, H, R = np.empty(w), np.empty((w, 9)), np.empty((w, w))
    none, nobody = np.zeros(0), np.zeros(0, dtype=np.int64)
    fill_aid(
        CODES[aid.kind],
        state,
        state,
        1.0,
        0.0,
        np.zeros(3),
        1,
        np.zeros(6),
        none,
        nobody,
        np.zeros(w),
        settings,
        nu,
        H,
        R,
    )
    return H
