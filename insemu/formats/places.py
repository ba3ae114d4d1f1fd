"""Positions, velocities and attitudes of mapped tables: fixes, and the reference."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from insemu import earth, rotation
from insemu.errors import InputError
from insemu.formats.angles import check_latitude
from insemu.formats.assemble import Columns, Story, numbers_of, timed
from insemu.formats.axes import axes_matrix
from insemu.records import GnssRecord, Trajectory
from insemu.units import parse

Array = NDArray[np.float64]

#: Standard deviation (horizontal, m) that a quality of fix stands for where the receiver states none.
QUALITY_SIGMA = {1: 5.0, 2: 1.0, 3: 5.0, 4: 0.02, 5: 0.5, 9: 1.0}


def positions(part: Columns, story: Story) -> Array | None:
    """Latitude, longitude (rad) and height (m) of a table, from any of its forms."""
    v = part.values
    if "lat" in v and "lon" in v:
        height = v.get("height")
        if height is None:
            story.assumed.append(f"height 0 m: {part.table.name} has none")
            height = np.zeros(part.t.size)
        first, second = ("lon", "lat") if part.settings.get("latlon") == "swapped" else ("lat", "lon")
        sign = {"south": (-1.0, 1.0), "west": (1.0, -1.0)}.get(part.settings.get("latlon", ""), (1.0, 1.0))
        llh = np.column_stack([sign[0] * v[first], sign[1] * v[second], height])
        check_latitude(llh, part.table.name)
        return llh
    if "ecef" in v:
        import pymap3d

        rows = np.full_like(v["ecef"], np.nan)
        good = np.isfinite(v["ecef"]).all(axis=1) & (np.linalg.norm(np.nan_to_num(v["ecef"]), axis=1) > 1.0)
        if good.any():
            rows[good] = np.column_stack(pymap3d.ecef2geodetic(*v["ecef"][good].T, deg=False))
        return rows
    local = v["ned"] if "ned" in v else v["enu"][:, [1, 0, 2]] * [1.0, 1.0, -1.0] if "enu" in v else None
    if local is None:
        return None
    if "origin" in part.settings:
        given = numbers_of(part.settings["origin"], 3, f"{part.table.name}: origin")
    else:
        given = np.zeros(3)
        story.assumed.append(
            f"the local coordinates of {part.table.name} begin at 0 deg N, 0 deg E, 0 m (--map 'origin=48.1 11.5 500' says where)"
        )
    return np.asarray(earth.ned_to_llh(local, given * [np.pi / 180, np.pi / 180, 1.0]))


def _velocity(part: Columns) -> Array | None:
    """Velocity north, east, down from any of its forms; the setting ``velocity`` says the frame against what the file states."""
    role = next((r for r in ("vel_ned", "vel_enu", "vel_neu") if r in part.values), None)
    if role is None:
        return _over_ground(part)
    v, frame = part.values[role], part.settings.get("velocity", role.removeprefix("vel_"))
    if frame == "enu":
        return np.asarray(v[:, [1, 0, 2]] * [1.0, 1.0, -1.0])
    return np.asarray(v * [1.0, 1.0, -1.0]) if frame == "neu" else v


#: A receiver leaves the course out, or repeats the last one, where its motion is noise: below this speed a repeated course is none, m/s. There the
#: course of a velocity of 0.05 m/s is noise of 3 deg: two written to 0.1 deg are equal by chance once in a hundred.
HELD_COURSE = 1.0
#: Without a course a receiver that is slower than this stands, m/s.
STANDING = 0.2


def _over_ground(part: Columns) -> Array | None:
    """Velocity north and east from speed and course, NaN down; where nothing tells the course, zero at rest and NaN in motion.

    Noise of the course is that of the velocity over the speed (NMEA receivers take both from one velocity), so that north and east are as
    uncertain at any speed and not correlated.
    """
    if "speed" not in part.values or "course" not in part.values:
        return None
    speed, course = part.values["speed"], part.values["course"]
    held = (np.diff(course, prepend=np.nan) == 0.0) & (speed < HELD_COURSE)
    course = np.where(held, np.where(speed < STANDING, 0.0, np.nan), course)
    course = np.where(np.isnan(course) & (speed < STANDING), 0.0, course)
    return np.column_stack([speed * np.cos(course), speed * np.sin(course), np.full(speed.size, np.nan)])


def _sigmas(part: Columns, story: Story) -> tuple[Array | None, Array | None]:
    v = part.values
    position = v.get("pos_std_ned", v["pos_std_enu"][:, [1, 0, 2]] if "pos_std_enu" in v else None)
    if position is None and "pos_std_h" in v:
        h = v["pos_std_h"]
        position = np.column_stack([h / np.sqrt(2.0), h / np.sqrt(2.0), v.get("pos_std_v", 1.5 * h)])
    if position is None and "quality" in v:
        horizontal = np.array([QUALITY_SIGMA.get(int(q), np.nan) if np.isfinite(q) else np.nan for q in v["quality"]])
        position = np.column_stack([horizontal, horizontal, 1.5 * horizontal])
        story.assumed.append("standard deviations from the quality of each fix: single 5 m, float 0.5 m, fixed 0.02 m")
    if position is not None:  # 0 is how files say that nothing is known
        position = np.where(position == 0.0, np.nan, np.abs(position))
    velocity = v.get("vel_std_ned", v["vel_std_enu"][:, [1, 0, 2]] if "vel_std_enu" in v else None)
    if velocity is None and "vel_std_h" in v:
        velocity = np.tile(v["vel_std_h"][:, None], (1, 3))
    return position, None if velocity is None else np.abs(velocity)


def gnss_of(part: Columns, story: Story) -> GnssRecord:
    """Fixes of a table; rows that repeat the position before (of a log at the IMU's rate) are left out."""
    llh = positions(part, story)
    assert llh is not None
    velocity = _velocity(part)
    if velocity is None and "speed" in part.values:
        story.notes.append("speed over ground without a course is no velocity: it is not kept")
    position_std, velocity_std = _sigmas(part, story)
    known = np.isfinite(llh).all(axis=1) & ~((llh[:, 0] == 0.0) & (llh[:, 1] == 0.0))
    if "gyro" in part.values or "accel" in part.values:
        changed = np.concatenate([[True], (np.diff(llh, axis=0) != 0).any(axis=1)])
        known &= changed
    rows = np.flatnonzero(known)
    if not rows.size:
        raise InputError("holds no position", where=part.table.name)
    if part.t.size - rows.size and "gyro" not in part.values:
        story.notes.append(
            f"fixes: {part.t.size - rows.size} of {part.t.size} rows hold no position; they were left out"
        )
    order, t = timed(part.t[rows], (llh[rows],), story, "fixes")
    rows = rows[order]

    def cut(values: Array | None) -> Array | None:
        return None if values is None or not np.isfinite(values[rows]).any() else values[rows]

    if "gnss_shift" in part.settings:
        t = t + parse(part.settings["gnss_shift"], "s")
    llh = llh[rows]
    if "gnss_move" in part.settings:
        llh = earth.move(llh, np.array(numbers_of(part.settings["gnss_move"], 3, f"{part.table.name}: gnss_move")))
    return GnssRecord(t, llh, cut(velocity), cut(position_std), cut(velocity_std))


def attitude(part: Columns) -> Array | None:
    """Roll, pitch and heading in rad, from angles or a quaternion; None where there is neither."""
    v = part.values
    if "rpy" in v:
        return v["rpy"]
    if {"roll", "pitch", "heading"} <= set(v):
        return np.column_stack([v["roll"], v["pitch"], v["heading"]])
    q = (
        v["quaternion"]
        if "quaternion" in v
        else v["quaternion_xyzw"][:, [3, 0, 1, 2]]
        if "quaternion_xyzw" in v
        else None
    )
    if q is None:
        return None
    size = np.linalg.norm(q, axis=1)
    good = np.isfinite(size) & (size > 0.5)
    q = np.where(good[:, None], q / np.where(good, size, 1.0)[:, None], [1.0, 0.0, 0.0, 0.0])
    C = rotation.dcm_from_quaternion(q)
    if part.settings.get("attitude", "enu" if "enu" in v else "ned") == "enu":  # body axes to FRD, local axes to NED
        body = axes_matrix(part.settings.get("axes") or "FLU")
        C = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]) @ C @ body.T
    rpy = np.array(rotation.rpy_from_dcm(C))
    rpy[~good] = np.nan
    return rpy


def reference_of(part: Columns, story: Story) -> Trajectory:
    """The truth of a table: position and attitude, and velocity (from the positions where there is none).

    Raises
    ------
    InputError
        No attitude, or no usable row.
    """
    llh, rpy, velocity = positions(part, story), attitude(part), _velocity(part)
    if llh is None or rpy is None:
        raise InputError(
            "has no position and attitude, which a truth needs; give fixes with --gnss. "
            f"Columns: {', '.join(list(part.table.columns)[:12])}",
            where=part.table.name,
        )
    good = np.isfinite(llh).all(axis=1) & np.isfinite(rpy).all(axis=1)
    if velocity is not None:
        good &= np.isfinite(velocity).all(axis=1)
    rows = np.flatnonzero(good)
    order, t = timed(part.t[rows], (llh[rows],), story, "reference")
    rows = rows[order]
    if rows.size < 2:
        raise InputError(f"has {rows.size} usable row(s) of truth, expected at least 2", where=part.table.name)
    llh = llh[rows]
    if velocity is None:
        offset = earth.position_difference(llh, np.tile(llh[0], (t.size, 1)))
        velocity = np.gradient(offset, t, axis=0)
        story.notes.append("velocities of the truth are differences of its positions")
    else:
        velocity = velocity[rows]
    return Trajectory(t, llh, velocity, rpy[rows], "reference")


def has_position(part: Columns) -> bool:
    """Whether a table holds positions."""
    return bool({"lat", "ecef", "ned", "enu"} & set(part.values))
