"""Motion definition files: the CSV of initial state and commands that the field's simulators read.

Two header lines and two blocks, as in gnss-ins-sim: initial latitude, longitude (deg), altitude (m), velocity in
vehicle axes (m/s), yaw, pitch, roll (deg); then one command per row: type, yaw, pitch, roll, vx, vy, vz, duration
(s), GPS visibility (0 or 1).

==== ==========================================================================================
type meaning of the six numbers
==== ==========================================================================================
1    rates: deg/s of the Euler angles and m/s^2 of the velocity in vehicle axes, for the duration
2    absolute attitude and absolute velocity at the end
3    changes of attitude and velocity
4    absolute attitude, change of velocity
5    change of attitude, absolute velocity
==== ==========================================================================================

Those simulators jump between rates; here every command is a quintic over its duration (type 1: constant rates between
smooth ramps, with the same total), so that the path has an acceleration everywhere.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from insemu import rotation
from insemu.emulate.flight import Flight
from insemu.emulate.motion import Leg, smoothstep, steady
from insemu.emulate.path import KNOT_S, SmoothPath
from insemu.emulate.table import KNOT_BYTES, check_size, number, rows_of, text_of
from insemu.errors import InputError

Array = NDArray[np.float64]

#: Largest height in m, speed in m/s and turn in rad that a command may ask for: beyond them Euler angles and map coordinates mean nothing.
HIGHEST, FASTEST, MOST_TURN = 1e8, 1e4, 2e4
_INITIAL = ("latitude", "longitude", "altitude", "vx", "vy", "vz", "yaw", "pitch", "roll")
_COMMAND = ("type", "yaw", "pitch", "roll", "vx", "vy", "vz", "duration", "visibility")


def _numbers(row: list[str], names: tuple[str, ...], where: str) -> list[float]:
    cells = [c.strip() for c in row]
    while cells and not cells[-1]:
        cells.pop()
    if len(cells) != len(names):
        raise InputError(f"{len(cells)} cells, expected {len(names)} ({', '.join(names)})", where=where)
    return [number(cell, name, where) for cell, name in zip(cells, names, strict=True)]


def read_motion(path: str | Path) -> Flight:
    """Read a motion definition file.

    Raises
    ------
    InputError
        With file and line: cells that are no numbers, an unknown command type, a duration that is not positive, no
        commands.
    """
    path = Path(path)
    rows = [(k, row) for k, row in rows_of(text_of(path, "motion"), str(path)) if not _is_header(row)]
    if len(rows) < 2:
        raise InputError("expected one row of initial values and at least one command", where=str(path))
    line, first = rows[0]
    initial = _numbers(first, _INITIAL, f"{path}:{line}")
    if abs(initial[0]) > 90:
        raise InputError(
            f"an initial latitude of {initial[0]:g} deg; are latitude and longitude swapped?", where=f"{path}:{line}"
        )
    if abs(initial[1]) > 360 or abs(initial[2]) > HIGHEST:
        raise InputError(
            f"an initial longitude of {initial[1]:g} deg at {initial[2]:g} m is no place", where=f"{path}:{line}"
        )
    deg = np.pi / 180.0
    state = np.array(
        [initial[8] * deg, initial[7] * deg, initial[6] * deg, *initial[3:6]]
    )  # roll, pitch, yaw, velocity
    commands: list[tuple[Array, float, bool, bool]] = []
    for line, row in rows[1:]:
        where = f"{path}:{line}"
        kind, yaw, pitch, roll, vx, vy, vz, duration, visible = _numbers(row, _COMMAND, where)
        if not duration > 0:
            raise InputError(f"a duration of {duration:g} s, expected a positive number", where=where)
        angles, velocity = np.array([roll, pitch, yaw]) * deg, np.array([vx, vy, vz])
        if kind == 1:
            change = np.concatenate([angles, velocity]) * duration
        elif kind in (2, 3, 4, 5):
            change = np.concatenate(
                [
                    angles - state[:3] if kind in (2, 4) else angles,
                    velocity - state[3:] if kind in (2, 5) else velocity,
                ]
            )
            if kind in (2, 4):  # the short way round
                change[[0, 2]] = (change[[0, 2]] + np.pi) % (2 * np.pi) - np.pi
        else:
            raise InputError(f"command type {kind:g}, expected 1, 2, 3, 4 or 5", where=where)
        if abs(state[1] + change[1]) > 85 * deg:
            raise InputError("a pitch beyond 85 deg, where Euler angles fail", where=where)
        if np.abs(state[3:] + change[3:]).max() > FASTEST:
            raise InputError(f"a velocity beyond {FASTEST:g} m/s", where=where)
        if np.abs(change[:3]).max() > MOST_TURN:
            raise InputError(f"a turn of more than {MOST_TURN / (2 * np.pi):.0f} revolutions", where=where)
        commands.append((change, duration, kind == 1, visible != 0))
        state = state + change
    check_size(sum(c[1] for c in commands) / KNOT_S, KNOT_BYTES, f"{path}: the motion")
    return _fly(path.stem, initial, commands)


def _is_header(row: list[str]) -> bool:
    try:
        float(row[0])
    except ValueError:
        return any(c.isalpha() for c in row[0])
    return False


def _fly(name: str, initial: list[float], commands: list[tuple[Array, float, bool, bool]]) -> Flight:
    deg = np.pi / 180.0
    total = sum(duration for _, duration, _, _ in commands)
    t = np.linspace(0.0, total, max(int(np.ceil(total / KNOT_S)), 8) + 1)
    start = np.array([initial[8] * deg, initial[7] * deg, initial[6] * deg, *initial[3:6]])
    values = np.tile(start, (t.size, 1))
    legs, outages, begin = [], [], 0.0
    for k, (change, duration, rates, visible) in enumerate(commands):
        tau = t - begin
        if rates:
            ramp = min(1.0, duration / 4.0)
            share = steady(tau, duration, ramp)
            values += np.where(tau[:, None] > 0, share[:, None] / (duration - ramp), 0.0) * change
        else:
            values += smoothstep(tau / duration)[:, None] * change
        legs.append(Leg(f"command {k + 1}", begin, begin + duration, bool(change[2] == 0.0)))
        if not visible:
            outages.append((begin, duration))
        begin += duration
    rpy, body = values[:, :3], values[:, 3:]
    ned = np.einsum("nij,nj->ni", rotation.dcm_from_rpy(rpy), body)
    origin = np.array([initial[0] * deg, initial[1] * deg, initial[2]])
    path = SmoothPath.from_velocity(t, ned * np.array([1.0, 1.0, -1.0]), rpy, origin, name)
    return Flight(path, "car", tuple(legs), tuple(outages))
