"""The checks of fixes against the IMU and a reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.intake.card import Line
from insemu.intake.checks import NEAR, SQUARE, believed, mounting, near
from insemu.intake.explained import DECLARED, FEWEST, Windows
from insemu.intake.motion import (
    Push,
    Track,
    Turn,
    positions_track,
    push_of,
    thinned,
    turn_of,
    turns,
    up_of,
    velocity_track,
)
from insemu.intake.receiver import RATIO, Agreement, agreement, swapped_track
from insemu.intake.weighed import Turning, Weighing
from insemu.records import GnssRecord, ImuRecord, Trajectory

Array = NDArray[np.float64]

#: Shortest time offset that is named, s, and the log-likelihood that it must gain.
OFFSET, OFFSET_NATS = 0.15, 25.0
#: The same together with a lever arm, which is one number more: chi-square of 12 with one degree of freedom, 1 in 2,000.
ARM_NATS = 6.0
#: Constant between fixes and reference, m, above which it is named, and the fewest fixes: no antenna is so far from an IMU, no standalone fix is off
#: that far on the mean.
FAR_APART, FEWEST_APART = 15.0, 20
#: Correlation from which the course follows the heading.
FOLLOWS = 0.9


# --------------------------------------------------------------------------------------------------------- IMU against fixes


def together(imu: ImuRecord, gnss: GnssRecord | Trajectory, what: str) -> list[Line]:
    """Whether the fixes lie in the time of the IMU.

    Parameters
    ----------
    imu : ImuRecord
    gnss : GnssRecord or Trajectory
    what : str
        What it is called: "fixes" or "reference".

    Returns
    -------
    list of Line
        Empty where more than half of the rows lie in the time of the IMU.
    """
    inside = (gnss.t >= imu.t[0]) & (gnss.t <= imu.t[-1])
    if inside.any():
        share = float(inside.mean())
        return (
            []
            if share > 0.5
            else [Line("clock", "odd", f"only {100 * share:.0f} % of the {what} lie in the time of the IMU")]
        )
    apart = float(gnss.t[0] - imu.t[0])
    spans = (
        f"the {what} run from {gnss.t[0]:.6g} to {gnss.t[-1]:.6g} s, the IMU from {imu.t[0]:.6g} to {imu.t[-1]:.6g} s"
    )
    text = f"{spans}: they do not overlap, not one clock"
    weeks = apart / 604_800.0
    if abs(weeks - round(weeks)) * 604_800.0 < 3600.0 and round(weeks):
        return [
            Line(
                "clock",
                "wrong",
                f"{text}, {round(weeks)} GPS week(s) apart",
                f'--map "gnss_shift={-round(weeks) * 604800} s"',
            )
        ]
    if what != "fixes":
        return [Line("clock", "wrong", text)]
    mend = f'--map "gnss_shift={-apart:.6f} s"'
    return [Line("clock", "wrong", f"{text} (if both begin together; else say the clock of each file)", mend)]


def against_reference(gnss: GnssRecord, reference: Trajectory) -> list[Line]:
    """A constant between the fixes and the reference: another datum, or heights above sea level.

    What the clock does goes with the velocity, which is fitted together with the constant: on a straight way at one speed nothing tells them apart.

    Parameters
    ----------
    gnss : GnssRecord
    reference : Trajectory
    """
    inside = (gnss.t >= reference.t[0]) & (gnss.t <= reference.t[-1]) & np.isfinite(gnss.llh).all(axis=1)
    if inside.sum() < FEWEST_APART:
        return []
    t = gnss.t[inside]

    def then(columns: Array) -> Array:
        return np.stack([np.interp(t, reference.t, column) for column in columns.T], axis=1)

    away = earth.position_difference(gnss.llh[inside], then(reference.llh))
    velocity = then(reference.vel_ned)
    apart, spread, left = np.zeros(3), np.zeros(3), away
    for _ in range(2):  # the second time without those that are far off
        keep = (np.abs(left) <= 5.0 * spread).all(axis=1) if spread.any() else np.ones(t.size, dtype=bool)
        # one time offset and three constants
        G = np.zeros((3 * int(keep.sum()), 4))
        for k in range(3):
            G[k::3, k] = 1.0
        G[:, 3] = velocity[keep].ravel()
        own, *_ = np.linalg.lstsq(G, away[keep].ravel(), rcond=1e-9)
        left = away - own[:3] - own[3] * velocity
        spread = np.asarray(1.4826 * np.median(np.abs(left), axis=0) + 1e-3, dtype=np.float64)
        apart = np.asarray(own[:3], dtype=np.float64)
    # on a straight way at one speed a time offset is any constant: that direction is wide, and not zero
    doubt = np.sqrt(np.diag(np.linalg.inv(G.T @ G + 1e-6 * np.eye(4)))[:3]) * spread
    plain = np.abs(apart) > np.maximum(FAR_APART, 5.0 * (spread + doubt))
    if not plain.any():
        return []
    what = "another datum"
    if plain.tolist() == [False, False, True]:
        what = "heights above sea level and heights above the ellipsoid, or another datum"
    sides = (("north of", "south of"), ("east of", "west of"), ("below", "above"))
    where = ", ".join(f"{abs(apart[k]):.1f} m {sides[k][int(apart[k] < 0.0)]}" for k in np.flatnonzero(plain))
    text = f"all along the fixes lie {where} it, the antenna's place included (scatter {spread.max():.2g} m): {what}"
    move = " ".join(f"{-x:.1f}" if far else "0" for x, far in zip(apart, plain, strict=True))
    return [Line("reference", "wrong", text, f'--map "gnss_move={move}"')]


def offset(turn: Turn | None) -> list[Line]:
    """Time offset between fixes and IMU, from the turns that both see."""
    if turn is None or not believed(turn):
        return [Line("clock", "assumed", "IMU and fixes share one clock: too little turning to see an offset")]
    if abs(turn.shift) < OFFSET or turn.gain_nats < OFFSET_NATS:
        return [
            Line(
                "clock",
                "ok",
                f"turns of fixes and gyroscope coincide (offset {turn.shift:+.2f} s, correlation {turn.correlation:.2f})",
            )
        ]
    if turn.arm_nats < ARM_NATS:
        said = f"turns of the fixes come {turn.shift:+.2f} s from those of the gyroscope; an antenna ahead of the IMU explains it as well as a clock"
        return [Line("clock", "ok", said)]
    leap = ", as many as the leap seconds of UTC" if abs(abs(turn.shift) - 18.0) < 0.6 else ""
    late = "late" if turn.shift < 0 else "early"
    evidence = f"turns; correlation {turn.correlation:.2f}, {turn.gain_nats:.0f} nats"
    text = f"the fixes are {abs(turn.shift):.2f} s {late} against the IMU{leap} ({evidence})"
    return [Line("clock", "odd", text, f'--map "gnss_shift={turn.shift:+.2f} s"')]


def slope(turn: Turn | None) -> list[Line]:
    """Turns of the fixes that are another multiple of the gyroscope's than 1."""
    if turn is None or not believed(turn) or near(abs(turn.slope), 1.0, NEAR):
        return []
    text = f"the course turns {turn.slope:.2f} times as much as the gyroscope says ({turn.intervals} intervals, correlation {turn.correlation:.2f})"
    return [Line("angular rate", "odd", text)]


def weighed(
    imu: ImuRecord, gnss: GnssRecord, found: Agreement | None, units: Mapping[str, str], turn: Turn | None
) -> tuple[list[Line], bool]:
    """What all readings of the IMU say together with the fixes, and whether the declared one stands.

    Parameters
    ----------
    imu : ImuRecord
    gnss : GnssRecord
    found : Agreement, optional
        Of :func:`agreement`.
    units : mapping of str to str
        Declared units of ``gyro`` and ``accel``.
    turn : Turn, optional
        What turns say of the clocks.

    Returns
    -------
    list of Line, bool
        No line where the motion tells nothing.
    """
    track = best_track(gnss, found)
    if track.velocity.size and np.isnan(track.velocity[:, 2]).any():  # of speed and course: heights tell how it climbs
        place = positions_track(gnss)
        up = np.interp(track.t, place.t, place.velocity[:, 2]) if place.t.size else 0.0
        track = replace(track, velocity=np.column_stack([track.velocity[:, :2], np.broadcast_to(up, track.t.shape)]))
    windows = Windows(imu, track)
    if windows.count < FEWEST:
        return [], True
    turning = None
    if turn is not None and believed(turn) and abs(turn.correlation) > FOLLOWS:
        shift = turn.shift if turn.gain_nats > OFFSET_NATS else 0.0
        turning = Turning(turns(imu, track, shift), up_of(imu)[0], shift, turn.slope)
    others = {}
    if track.span and (swapped := swapped_track(gnss)) is not None and (there := Windows(imu, swapped)).count >= FEWEST:
        there.floor = windows.floor
        others["latlon=swapped"] = there.explain()
    return Weighing(windows, imu.kind, imu.dt, units, track.span == 0.0, turning, others).lines()


def upright(imu: ImuRecord, gnss: GnssRecord, found: Agreement | None) -> float:
    """Nats that the IMU gives to the declared vertical velocity over its opposite; 0 where it does not have to tell.

    Parameters
    ----------
    imu : ImuRecord
    gnss : GnssRecord
    found : Agreement, optional
    """
    track = best_track(gnss, found)
    if found is None or track.span or not near(-found.climbing, 1.0, RATIO):
        return 0.0
    windows = Windows(imu, track)
    if windows.count < FEWEST:
        return 0.0
    return windows.explain().nats - windows.explain(replace(DECLARED, down=-1.0)).nats


def best_track(gnss: GnssRecord, found: Agreement | None) -> Track:
    """The velocities that the checks of the IMU are made with: the receiver's where they fit its positions."""
    own = velocity_track(gnss)
    fits = found is None or found.best == "latlon=swapped" or (found.residual < 0.3 and near(found.scale, 1.0, NEAR))
    if own is not None and fits:
        return own
    return positions_track(gnss)


def against_fixes(imu: ImuRecord, gnss: GnssRecord, found: Agreement | None) -> tuple[Turn | None, Push | None]:
    """Turn and push of the fixes on the IMU, at the best time offset.

    Parameters
    ----------
    imu : ImuRecord
    gnss : GnssRecord
    found : Agreement, optional
        Of :func:`agreement`; decides whose velocities are used, those of the receiver or those of the positions.

    Returns
    -------
    Turn or None, Push or None
        None where too few fixes or too little motion tells.
    """
    track = best_track(gnss, found)
    if thinned(track).t.size < 10:
        return None, None
    turn = turn_of(imu, track)
    shift = turn.shift if turn is not None and believed(turn) else 0.0
    return turn, push_of(imu, track, shift)


def vehicle_axes(imu: ImuRecord, gnss: GnssRecord | None) -> tuple[tuple[float, float, float] | None, str]:
    """Roll, pitch and yaw (rad) from the IMU to the axes of its vehicle as gravity and the fixes tell them, and what was found, in words.

    None where the axes are forward-right-down already, or where nothing tells them.

    Parameters
    ----------
    imu : ImuRecord
    gnss : GnssRecord, optional
    """
    up, steady = up_of(imu)
    push = against_fixes(imu, gnss, agreement(gnss))[1] if gnss is not None else None
    if push is None or steady < 0.9 or not believed(push):
        return None, "axes as recorded: nothing says how the IMU is mounted"
    if up[2] < -np.cos(np.deg2rad(SQUARE)) and abs(np.rad2deg(push.yaw)) < SQUARE:
        return None, "axes forward, right, down as recorded"
    roll, pitch, yaw = mounting(up, push.yaw)
    words = f"turned from the IMU's axes to the vehicle's by roll {roll:.0f}, pitch {pitch:.0f}, yaw {yaw:.0f} deg"
    return (float(np.deg2rad(roll)), float(np.deg2rad(pitch)), float(np.deg2rad(yaw))), words


def refused(lines: Sequence[Line]) -> bool:
    """Whether any line is wrong."""
    return any(line.level == "wrong" for line in lines)
