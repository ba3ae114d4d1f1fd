"""IMUs in one log, distinguished by the names of its columns."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from insemu.errors import InputError
from insemu.records import AXES, COLUMNS, Series

_SHORT = dict(zip(COLUMNS, AXES, strict=True))
#: An axis in a column's name, with what stands before and after it.
_AXIS = re.compile(rf"^(.*?)(?<![a-z])({'|'.join((*AXES, *COLUMNS))})(?![a-z])(.*)$", re.IGNORECASE)


def by_unit(series: Sequence[Series], where: str) -> dict[str, dict[str, Series]]:
    """The axes of every IMU in a log: ``gx_1``, ``imu2_gyro_x`` and ``gyro_x@left`` name an axis and an IMU.

    Parameters
    ----------
    series : sequence of Series
        Columns; those that name no axis are left out.
    where : str
        File, for messages.

    Returns
    -------
    dict of unit to dict of axis to Series
        The unit of columns that name an axis alone is ``imu``.

    Raises
    ------
    InputError
        No axis of an IMU, or one twice.
    """
    out: dict[str, dict[str, Series]] = {}
    for s in series:
        found = _AXIS.match(s.name)
        if found is None:
            continue
        before, name, after = found.groups()
        axis = _SHORT.get(name.lower(), name.lower())
        unit = (before + after).strip("_@./:- ") or "imu"
        if axis in out.setdefault(unit, {}):
            raise InputError(f"has the {axis} of '{unit}' twice", where=where)
        out[unit][axis] = replace(s, name=axis)
    if not out:
        raise InputError(
            f"has no column of an IMU, expected names such as {COLUMNS[0]}_1 or imu1_{AXES[0]}", where=where
        )
    return out
