"""One prepared drive: what lies between a recording and everyone who flies a filter on it.

What is stated of a drive is put on it, what is not is assumed once, and where a filter starts is found in one way. All that was assumed, done and
left out is said in the same words, whoever asks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError
from insemu.filters import BRIDGED_S, Alignment, How, LooselyCoupledEKF, cut, start, with_standard_deviations
from insemu.intake import Card, velocity_lag
from insemu.lost import FILLED_IN, restored
from insemu.records import AidRecord, GnssRecord, ImuRecord, InitialState, Preparation, Recording, Trajectory
from insemu.rotation import dcm_from_rpy
from insemu.stamps import Origin
from insemu.strapdown import NavState
from insemu.units import STANDARD_GRAVITY

Array = NDArray[np.float64]

#: Velocities that lag are left out where less than this share of their misfit to the positions is left at the lag: then positions tell more.
LAGGING = 0.7
#: Steps that are longer than so many usual ones are gaps.
SKIPPED = 2.5
#: Share of a recording from which it is said that it is left out, and why.
LEFT_OUT = 0.05
#: Fixes within the IMU data at least.
FEWEST = 10


@dataclass(frozen=True)
class Stated:
    """What is stated of a drive in addition to its recording, and what is asked of it.

    Parameters
    ----------
    lever_arm : (3,) array_like
        IMU to antenna in the axes of the vehicle, m.
    mounting : (3,) array_like
        Roll, pitch, heading of the rotation from the axes of the IMU to those of the vehicle, rad.
    imu_late : float
        By how much the stamps of the IMU are late against those of the fixes, s.
    begin, end : float, optional
        The part that is asked for, s on the clock of the fixes.
    position_sigma, velocity_sigma : array_like, optional
        Standard deviations of fixes that state none, scalar or north, east, down, m and m/s.
    with_velocity : bool
        Whether the filters use the velocities of the fixes.
    how : {"auto", "rest", "motion"}
        See :func:`insemu.filters.start`.
    gravity : str
        See :mod:`insemu.earth`.
    corrected : bool
        Whether lost samples of the IMU are filled in and velocities that lag are left out; else both stay for those who look for them or weigh them.
    shortest : float
        Shortest stretch of IMU data that is of use, s.
    where : str
        What an error names; the source of the recording where it is empty.
    """

    lever_arm: ArrayLike = (0.0, 0.0, 0.0)
    mounting: ArrayLike = (0.0, 0.0, 0.0)
    imu_late: float = 0.0
    begin: float | None = None
    end: float | None = None
    position_sigma: ArrayLike | None = None
    velocity_sigma: ArrayLike | None = None
    with_velocity: bool = True
    how: How = "auto"
    gravity: str = "normal"
    corrected: bool = True
    shortest: float = 60.0
    where: str = ""


@dataclass(frozen=True)
class Drive:
    """A recording as the filters take it.

    Parameters
    ----------
    imu : ImuRecord
        In the axes of the vehicle as far as the mounting is stated, on the clock of the fixes as far as it is known.
    gnss : GnssRecord
        Fixes with standard deviations.
    measured : Recording
        As it was given, less what lies outside the stretch that is flown.
    stated : Stated
    said : tuple of str
        What was assumed and done.
    assumed : mapping of str to str
        What of it are standard deviations of ``positions`` and ``velocities``, in words.
    clock : float
        Seconds that were subtracted from the stamps of the IMU.
    scatter : (float, float)
        Scatter of positions and velocities over their standard deviations, as the innovations show it; outages are held against fixes of it.
    settled : float, optional
        When outages may begin, s.
    aids, known
        Further measurements; an initial state of the file.
    start : Alignment, optional
        Where the filters start.
    recorded : float
        Seconds that the IMU was recorded for, in the part that is asked for.
    """

    imu: ImuRecord
    gnss: GnssRecord
    measured: Recording
    stated: Stated = Stated()
    said: tuple[str, ...] = ()
    assumed: Mapping[str, str] = field(default_factory=dict)
    clock: float = 0.0
    scatter: tuple[float, float] = (1.0, 1.0)
    settled: float | None = None
    aids: tuple[AidRecord, ...] = ()
    known: InitialState | None = None
    start: Alignment | None = None
    recorded: float = 0.0

    @classmethod
    def of(cls, recording: Recording, stated: Stated = Stated()) -> Drive:
        """A recording with fixes in the axes of the vehicle, with standard deviations; all of it, on its own clock.

        Parameters
        ----------
        recording : Recording
        stated : Stated
        """
        assert recording.gnss is not None
        gnss, assumed = with_standard_deviations(recording.gnss, stated.position_sigma, stated.velocity_sigma)
        if not stated.with_velocity:  # they still tell the way at the start
            assumed.pop("velocities", None)
        turned = recording.turned(dcm_from_rpy(np.asarray(stated.mounting, dtype=np.float64)))
        said, seconds = tuple(assumed.values()), float(turned.imu.t[-1] - turned.imu.t[0])
        drive = cls(turned.imu, gnss, recording, stated, said, assumed, recorded=seconds)
        return replace(drive, aids=turned.aids, known=turned.initial)

    @property
    def source(self) -> str:
        """Where it was read from."""
        return self.measured.source

    @property
    def origin(self) -> Origin:
        """When time 0 was."""
        return self.measured.origin

    @property
    def lever_arm(self) -> Array:
        """IMU to antenna (3,) as stated, m."""
        return np.array(np.broadcast_to(np.asarray(self.stated.lever_arm, dtype=np.float64), (3,)))

    @property
    def unsolved(self) -> float:
        """Share of the recording before the start and outside the stretch that is flown."""
        return max(0.0, 1.0 - (float(self.imu.t[-1]) - self.aligned.t) / self.recorded) if self.recorded else 0.0

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was assumed, done and left out, in words."""
        return (*self.said, *self.left_out)

    @property
    def left_out(self) -> tuple[str, ...]:
        """How much of the recording no filter flies, and why, where it is more than :data:`LEFT_OUT`; nothing before the start is known."""
        gaps = [said for said in self.said if "longest stretch" in said]
        return () if self.start is None else left_out(self.imu, self.gnss, self.start.t, self.recorded, gaps)

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
        s = self.stated
        try:
            found = start(self.imu, self.gnss, how=s.how, known=self.known, lever_arm=self.lever_arm, gravity=s.gravity)
        except InputError as error:
            turned = [line.mend for line in card.lines if line.topic == "axes" and line.mend] if card else []
            hint = f"; the axes of the IMU look turned, {turned[0]} tells the heading by the course" if turned else ""
            raise InputError(error.message + hint, where=s.where or self.source) from None
        return replace(self, start=found)

    def recording(self, reference: Trajectory | None = None) -> Recording:
        """The prepared drive as a recording that can be written, with what was done to it; ``reference`` instead of its own."""
        done = Preparation(self.clock, self.measured.gnss, self.remarks)
        return Recording(
            self.imu, self.gnss, reference or self.measured.reference, self.source, self.aids, self.known, self.origin, preparation=done
        )  # fmt: skip

    def alone(self) -> tuple[Recording, NavState, tuple[str, ...]]:
        """The IMU from the start on less the biases found there, with the fixes to hold it against; the state there; and what was done, in words."""
        a, bias = self.aligned, self.aligned.bias_beyond()
        recording = Recording(cut(self.imu, a), self.gnss, None, self.source, origin=self.origin)
        gyro, accel = (
            ", ".join(f"{v:.4g}" for v in x) for x in (np.degrees(bias[:3]) * 3600.0, 1e3 * bias[3:] / STANDARD_GRAVITY)
        )
        taken = f"started at {a.t:.6g} s; subtracted there: {gyro} deg/h of the gyroscopes x, y, z, {accel} mg of the accelerometers"
        return recording, a.state, (*self.remarks, taken)

    def shifted(self, late: float) -> Drive:
        """The same with the stamps of the IMU ``late`` seconds earlier, without a start."""
        moved = replace(self.recording(), gnss=None).imu_later(-late)
        inside = (self.gnss.t >= moved.imu.t[0]) & (self.gnss.t <= moved.imu.t[-1])
        return replace(
            self, imu=moved.imu, gnss=self.gnss.rows(inside), aids=moved.aids, clock=self.clock + late, known=moved.initial, start=None
        )  # fmt: skip

    def scattered(self) -> GnssRecord:
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


def prepared(recording: Recording, stated: Stated = Stated()) -> Drive:
    """Make a drive of a recording.

    Parameters
    ----------
    recording : Recording
        What was done to it before it was written stays, and is said.
    stated : Stated

    Raises
    ------
    InputError
        No fixes, too few of them, or no stretch of IMU data long enough.
    """
    where = recording.source
    if recording.gnss is None:
        raise InputError("has no GNSS fixes; name the file that does with --gnss", where=where)
    said = [*recording.notes, *(recording.preparation.said if recording.preparation else ())]
    imu, lost = restored(recording.imu)
    done = FILLED_IN if stated.corrected else "stay so (a design that compensates dropped_samples flies them filled in)"
    said += [f"{each.said}: they {done}" for each in lost]
    late, measured = stated.imu_late, recording
    recording = (replace(recording, imu=imu) if stated.corrected else recording).imu_later(-late)
    imu = _asked(recording.imu, stated, where)
    recorded = float(imu.t[-1] - imu.t[0])
    imu = _without_gaps(imu, stated.shortest, said, where)
    gnss = recording.gnss
    assert gnss is not None
    inside = (gnss.t >= imu.t[0]) & (gnss.t <= imu.t[-1]) & np.isfinite(gnss.llh).all(axis=1)
    if inside.sum() < FEWEST:
        raise InputError(f"has {int(inside.sum())} fixes within its IMU data, expected at least {FEWEST}", where=where)
    lag, share = velocity_lag(gnss.rows(inside)) if stated.with_velocity else (0.0, 1.0)
    if lag:
        dropped = stated.corrected and share < LAGGING
        said.append(
            f"the velocities of the fixes are {abs(lag):.3g} s {'late' if lag > 0 else 'early'} against their positions (means over the time "
            f"before their stamps are): they {'are left out' if dropped else 'stay'}"
        )
        gnss = gnss.without_velocity() if dropped else gnss
    drive = Drive.of(replace(recording, imu=imu, gnss=gnss), stated)
    flown = (measured.imu.t >= imu.t[0] + late) & (measured.imu.t <= imu.t[-1] + late)
    measured = replace(measured, imu=measured.imu if flown.all() else measured.imu.rows(flown))
    return replace(
        drive, gnss=drive.gnss.rows(inside), said=(*said, *drive.said), clock=late, measured=measured, recorded=recorded
    )


def left_out(
    imu: ImuRecord, gnss: GnssRecord, begins: float, recorded: float | None = None, gaps: Sequence[str] = ()
) -> tuple[str, ...]:
    """How much of a recording no filter flies, and why, in words, where it is more than :data:`LEFT_OUT`.

    Parameters
    ----------
    imu, gnss : records
        The stretch that is flown, and its fixes.
    begins : float
        Where the filter starts, s.
    recorded : float, optional
        Seconds that were recorded; those of ``imu`` where they are not given.
    gaps : sequence of str
        Why other stretches are left out.
    """
    before, end = begins - float(imu.t[0]), float(imu.t[-1])
    share = 1.0 - (end - begins) / (recorded or end - float(imu.t[0]))
    if share <= LEFT_OUT:
        return ()
    no_fix = float(gnss.t[0]) >= begins - 1.0
    first = (
        f"the first {before:.3g} s, {'in which there is no fix' if no_fix else 'in which nothing tells the heading'}"
    )
    return (f"{100.0 * share:.2g} % of the recording are not solved: {'; '.join([first] * (before > 1.0) + [*gaps])}",)


def _asked(imu: ImuRecord, stated: Stated, where: str) -> ImuRecord:
    """The part of the IMU data that is asked for."""
    low = -np.inf if stated.begin is None else stated.begin
    keep = (imu.t >= low) & (imu.t <= (np.inf if stated.end is None else stated.end))
    if keep.sum() < 2:
        raise InputError("the span from start to end holds no IMU data", where=stated.where or where)
    return imu if keep.all() else imu.rows(keep)


def _without_gaps(imu: ImuRecord, shortest: float, said: list[str], where: str) -> ImuRecord:
    """The longest stretch without a gap that no filter crosses."""
    steps = np.diff(imu.t)
    edges = np.flatnonzero(steps > BRIDGED_S)
    starts, ends = np.append(0, edges + 1), np.append(edges, len(imu) - 1)
    k = int(np.argmax(imu.t[ends] - imu.t[starts]))
    part = imu.rows(slice(int(starts[k]), int(ends[k]) + 1)) if edges.size else imu
    if len(part) < 2 or part.t[-1] - part.t[0] < shortest:
        raise InputError(f"has no {shortest:g} s of IMU data without a gap of more than {BRIDGED_S:g} s", where=where)
    if edges.size:
        said.append(
            f"the IMU has {edges.size} gap(s) of more than {BRIDGED_S:g} s: the longest stretch without one is solved, from {part.t[0]:.6g} to "
            f"{part.t[-1]:.6g} s"
        )
    crossed = [seconds for _, seconds in part.gaps(SKIPPED * part.dt)]
    if crossed:
        said.append(f"{len(crossed)} gap(s) in the IMU data, up to {max(crossed):.2g} s, are each crossed in one step")
    return part
