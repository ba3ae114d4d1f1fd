"""A recording as the filters take it: the span without gaps, fixes with standard deviations, one clock, and a start."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu import earth
from insemu.errors import InputError
from insemu.evaluate import BRIDGED_S
from insemu.filters import Alignment, LooselyCoupledEKF, cut, with_standard_deviations
from insemu.filters import start as start_of
from insemu.intake import Card
from insemu.lost import restored
from insemu.records import AidRecord, GnssRecord, ImuRecord, InitialState, Recording
from insemu.stamps import OWN, Origin
from insemu.strapdown import NavState
from insemu.units import STANDARD_GRAVITY

Array = NDArray[np.float64]

#: Lags of the velocities behind the positions that are tried, s.
LAGS = np.arange(-40, 41) * 0.0125
#: Velocities are left out where they fit the positions at another time than their own, with less than this share of what is left at their own.
LAGGING = 0.7
#: Shortest span that is solved, s.
SHORTEST = 60.0


@dataclass(frozen=True)
class Drive:
    """What is solved.

    Parameters
    ----------
    imu : ImuRecord
        In the axes of the file, on the clock of the fixes as far as it is known.
    gnss : GnssRecord
        Fixes within the IMU data, with standard deviations.
    lever_arm : (3,) array
        IMU to antenna as given, m.
    source : str
    said : tuple of str
        What was assumed and done.
    stated : bool
        Whether the standard deviations of the positions are the receiver's own.
    clock : float
        Seconds that were taken off the stamps of the IMU.
    scatter : (float, float)
        Scatter of positions and velocities over their standard deviations, as the innovations show it; outages are held against fixes of it.
    settled : float, optional
        When outages may begin, s.
    aids, known
        Further measurements; an initial state of the file.
    start : Alignment, optional
        Where the filters start.
    origin : Origin
        When time 0 was.
    measured : GnssRecord, optional
        The fixes as they were recorded.
    recorded : float
        Seconds that the IMU was recorded for.
    """

    imu: ImuRecord
    gnss: GnssRecord
    lever_arm: Array
    source: str
    said: tuple[str, ...] = ()
    stated: bool = True
    clock: float = 0.0
    scatter: tuple[float, float] = (1.0, 1.0)
    settled: float | None = None
    aids: tuple[AidRecord, ...] = ()
    known: InitialState | None = None
    start: Alignment | None = None
    origin: Origin = OWN
    measured: GnssRecord | None = None
    recorded: float = 0.0

    @property
    def unsolved(self) -> float:
        """Share of the recording before the start and beside the stretch that is solved."""
        return max(0.0, 1.0 - (float(self.imu.t[-1]) - self.aligned.t) / self.recorded) if self.recorded else 0.0

    @property
    def aligned(self) -> Alignment:
        """The start; :meth:`started` was called."""
        assert self.start is not None
        return self.start

    def started(self, card: Card | None = None) -> Drive:
        """The same with a start.

        Raises
        ------
        InputError
            No way to start; where the card knows another mounting, with the map that says it.
        """
        try:
            return replace(
                self, start=start_of(self.imu, self.gnss, known=self.known, lever_arm=self.lever_arm, gravity="normal")
            )
        except InputError as error:
            turned = [line.mend for line in card.lines if line.topic == "axes" and line.mend] if card else []
            hint = f"; the axes of the IMU look turned, {turned[0]} tells the heading by the course" if turned else ""
            raise InputError(error.message + hint, where=self.source) from None

    def alone(self) -> tuple[Recording, NavState, tuple[str, ...]]:
        """The IMU from the start on less the biases found there, with the fixes to hold it against; the state there; and what was done, in words."""
        a, bias = self.aligned, self.aligned.bias_beyond()
        recording = Recording(cut(self.imu, a), self.gnss, None, self.source, origin=self.origin)
        gyro, accel = (
            ", ".join(f"{v:.4g}" for v in x) for x in (np.degrees(bias[:3]) * 3600.0, 1e3 * bias[3:] / STANDARD_GRAVITY)
        )
        taken = f"started at {a.t:.6g} s; taken off there: {gyro} deg/h of the gyroscopes x, y, z, {accel} mg of the accelerometers"
        return recording, a.state, (*self.said, taken)

    def shifted(self, late: float) -> Drive:
        """The same with the stamps of the IMU ``late`` seconds earlier, without a start."""
        known = None if self.known is None else replace(self.known, t=self.known.t - late)
        imu = replace(self.imu, t=self.imu.t - late)
        inside = (self.gnss.t > imu.t[0]) & (self.gnss.t <= imu.t[-1])
        aids = tuple(a.later(-late) for a in self.aids)  # on the clock of the IMU
        gnss = self.gnss.rows(inside)
        return replace(self, imu=imu, gnss=gnss, aids=aids, clock=self.clock + late, known=known, start=None)

    def reference(self) -> GnssRecord:
        """The fixes that outages are held against, with the standard deviations of their scatter."""
        g, (position, velocity) = self.gnss, self.scatter
        return replace(
            g,
            pos_std_ned=None if g.pos_std_ned is None else position * g.pos_std_ned,
            vel_std_ned=None if g.vel_std_ned is None else velocity * g.vel_std_ned,
        )

    def flown(self, ekf: LooselyCoupledEKF) -> tuple[ImuRecord, GnssRecord]:
        """IMU from the start on, less the bias that a filter does not know better, and the fixes after the start."""
        imu = cut(self.imu, self.aligned, ekf.augmentation.turn_on_sigma())
        return imu, self.gnss.rows(self.gnss.t > self.aligned.t)


def prepared(recording: Recording, lever_arm: ArrayLike = (0.0, 0.0, 0.0)) -> Drive:
    """Make a drive of a recording.

    Parameters
    ----------
    recording : Recording
    lever_arm : (3,) array_like
        IMU to antenna in the axes of the recording, m.

    Raises
    ------
    InputError
        No fixes, too few of them, or no stretch of IMU data long enough.
    """
    recording = recording.as_measured()
    where = recording.source
    if recording.gnss is None:
        raise InputError("has no GNSS fixes; name the file that does with --gnss", where=where)
    said = list(recording.notes)
    imu, lost = restored(recording.imu)
    for each in lost:
        said.append(
            f"{int(each.rows.sum())} samples of the IMU are lost, where {'rows repeat the row before' if each.held else 'stamps skip them'}: they "
            "are filled in by the samples around them"
        )
    imu = _without_gaps(imu, said, where)
    gnss = recording.gnss
    inside = (gnss.t > imu.t[0]) & (gnss.t <= imu.t[-1]) & np.isfinite(gnss.llh).all(axis=1)
    if inside.sum() < 10:
        raise InputError(f"has {int(inside.sum())} fixes within its IMU data, expected at least 10", where=where)
    lag = velocity_lag(gnss.rows(inside))
    if lag is not None:
        said.append(
            f"the velocities of the fixes are {abs(lag):.3g} s {'late' if lag > 0 else 'early'} against their positions (means over the time "
            "before their stamps are): they are left out"
        )
        gnss = gnss.without_velocity()
    known, assumed = with_standard_deviations(gnss)
    said += assumed.values()
    return Drive(
        imu,
        known.rows(inside),
        np.array(np.broadcast_to(np.asarray(lever_arm, dtype=np.float64), (3,))),
        where,
        tuple(said),
        gnss.pos_std_ned is not None,
        aids=recording.aids,
        known=recording.initial,
        origin=recording.origin,
        measured=recording.gnss,
        recorded=float(recording.imu.t[-1] - recording.imu.t[0]),
    )


def _without_gaps(imu: ImuRecord, said: list[str], where: str) -> ImuRecord:
    """The longest stretch without a gap that no filter crosses."""
    edges = np.flatnonzero(np.diff(imu.t) > BRIDGED_S)
    starts, ends = np.append(0, edges + 1), np.append(edges, len(imu) - 1)
    k = int(np.argmax(imu.t[ends] - imu.t[starts]))
    part = imu.rows(slice(int(starts[k]), int(ends[k]) + 1))
    if len(part) < 2 or part.t[-1] - part.t[0] < SHORTEST:
        raise InputError(f"has no {SHORTEST:g} s of IMU data without a gap of more than {BRIDGED_S:g} s", where=where)
    if edges.size:
        said.append(
            f"the IMU has {edges.size} gap(s) of more than {BRIDGED_S:g} s: the longest stretch without one is solved, from {part.t[0]:.6g} to "
            f"{part.t[-1]:.6g} s"
        )
    return part


def velocity_lag(gnss: GnssRecord) -> float | None:
    """By how much velocities are late against the positions, s; None where they fit best at their own time, or nothing tells.

    The derivative of a spline through the positions at ``t - lag`` is held against the velocity at ``t``.
    """
    if gnss.vel_ned is None:
        return None
    good = np.isfinite(gnss.vel_ned[:, :2]).all(axis=1)
    t, v = gnss.t[good], gnss.vel_ned[good, :2]
    if t.size < 30:
        return None
    way = scipy.interpolate.CubicSpline(t, earth.position_difference(gnss.llh[good], gnss.llh[good][0])[:, :2])
    inside = (t > t[0] + LAGS[-1]) & (t < t[-1] - LAGS[-1])
    left = np.array([np.median(np.abs(v[inside] - way(t[inside] - lag, 1))) for lag in LAGS])
    k = int(np.argmin(left))
    return float(LAGS[k]) if left[k] < LAGGING * left[LAGS.size // 2] else None
