"""Aids: measurements beside the fixes, one file each.

A module in this folder is read when the package is: its ``AID`` (:class:`~insemu.filters.aid.Aid`) is known by name from then on to the compiled
filter, its filterpy twin, scenarios (``aids``) and recording files, and nothing else has to name it.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pkgutil import iter_modules

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit
from insemu.filters.aid import SETTINGS, Aid
from insemu.filters.aids.standstill import Standstill
from insemu.filters.measurements import fill_fix
from insemu.filters.rows import Moment, Rows
from insemu.filters.satellites import fill_satellite
from insemu.records import AidRecord

__all__ = ["AIDS", "CODES", "SATELLITE", "Standstill", "aid_jacobian", "fill_rows"]

Array = NDArray[np.float64]

#: All kinds of aids by name.
AIDS: dict[str, Aid] = {
    aid.name: aid for aid in (import_module(f"{__name__}.{found.name}").AID for found in iter_modules(__path__))
}
#: What stands for each in the compiled loop, from 1 on (0 is a fix).
CODES = {name: k for k, name in enumerate(AIDS, start=1)}
#: Code of raw observations of one satellite.
SATELLITE = 1 + len(AIDS)


def _choice() -> Callable[..., None]:
    """One branch for each kind, a fix for what has no code of its own: compiled code cannot look a function up in a table."""
    kinds = {SATELLITE: fill_satellite, **{CODES[name]: aid.fill for name, aid in AIDS.items()}}
    known = {f"fill_{code}": fill for code, fill in kinds.items()} | {"fill_fix": fill_fix}
    given = "(moment, z, settings, rows)"
    branches = "".join(f"\n if kind == {code}: return fill_{code}{given}" for code in kinds)
    exec(f"def chosen(kind, moment, z, settings, rows):{branches}\n fill_fix{given}", known)
    return njit(nogil=True)(known["chosen"])


_fill = _choice()


@njit(cache=True, nogil=True)
def fill_rows(kind: int, moment: Moment, z: Array, settings: Array, rows: Rows) -> None:
    """Rows of one fix, satellite or aid.

    Parameters
    ----------
    kind : int
        :data:`~insemu.filters.measurements.FIX`, :data:`SATELLITE`, or the code of an aid (:data:`CODES`).
    moment : Moment
    z : (w,) array
        Measured values.
    settings : (SETTINGS,) array
        Constants of the aid, for example a lever arm, or the motion of the satellite.
    rows : Rows
        Overwritten.
    """
    rows.nu[:] = 0.0
    rows.H[:, :] = 0.0
    rows.R[:, :] = 0.0
    _fill(kind, moment, z, settings, rows)


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
    still, none, nobody = np.zeros(3), np.zeros(0), np.zeros(0, dtype=np.int64)
    moment = Moment(
        state, state, 1.0, 0.0, still, still, still, 1, np.zeros(6), none, nobody, still, -1, -1, none, -1, none
    )
    rows = Rows(np.empty(w), np.empty((w, 9)), np.empty((w, w)))
    fill_rows(CODES[aid.kind], moment, np.zeros(w), settings, rows)
    return rows.H
