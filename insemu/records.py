"""Typed sampled data, checked on the way in: signals, IMU and GNSS records, trajectories.

All arrays are read-only float64, time first, SI units and radians. Times are seconds on one common clock from the origin of the recording
and strictly increasing. An :class:`ImuRecord` has one row for each of its time stamps: row k describes the interval ``(t[k-1], t[k]]``, so row 0,
the interval before the record starts, is never integrated (emulated records repeat row 1 there).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError
from insemu.guards import LARGEST, finite, frozen, frozen_times, latitudes
from insemu.rotation import dcm_from_rpy, rpy_from_dcm
from insemu.sample_times import beat
from insemu.stamps import OWN, SECOND, Origin, counted

Array = NDArray[np.float64]
ImuKind = Literal["increment", "mean", "sample"]

#: The six sensor axes in the order of every (..., 6) array.
AXES = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
#: Stamps that stray from an even beat by no more than this share of it are jitter of the stamps and not of the sampling.
JITTER = 0.02
#: Column names of the same axes in files.
COLUMNS = ("gx", "gy", "gz", "ax", "ay", "az")


@dataclass(frozen=True)
class Series:
    """A scalar signal at a constant rate.

    Parameters
    ----------
    values : (n,) array
        Samples in SI (``unit``).
    rate_hz : float
        Sampling rate in Hz, positive.
    unit : str
        ``"rad/s"``, ``"m/s^2"`` or ``""`` where unknown.
    name : str
        For example ``"gyro_x"``; appears in tables and messages.
    gaps : bool
        Whether samples may be missing: values that are not finite.

    Raises
    ------
    InputError
        Wrong shape, a value that is not finite, a rate that is not positive.
    """

    values: Array
    rate_hz: float
    unit: str = ""
    name: str = "signal"
    gaps: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", frozen(self.values, self.name, (None,), finite=not self.gaps))
        if not (finite(self.rate_hz) and 1.0 / LARGEST < self.rate_hz < LARGEST):
            raise InputError(f"{self.name} has a rate of {self.rate_hz} Hz, expected a positive number")

    @property
    def dt(self) -> float:
        """Sampling interval in seconds."""
        return 1.0 / self.rate_hz

    @property
    def missing(self) -> int:
        """Number of samples that are missing."""
        return int(np.count_nonzero(~np.isfinite(self.values))) if self.gaps else 0

    def complete(self, what: str) -> Series:
        """Itself; raises :class:`~insemu.errors.InputError` where samples are missing that ``what`` needs."""
        if self.missing:
            raise InputError(
                f"{self.name}: {self.missing} of {len(self)} samples are missing, and {what} needs all of them; "
                "wavelet moments (gmwm without robust) do without"
            )
        return self

    def __len__(self) -> int:
        return self.values.size

    def __repr__(self) -> str:
        return f"Series {self.name}: {len(self)} samples at {self.rate_hz:g} Hz, {self.unit or 'unit unknown'}"


class _Timed:
    """Rows at times: prints as what it is, how much of it, and when."""

    t: Array

    def __len__(self) -> int:
        return self.t.size

    def rows(self, keep: slice | NDArray[np.bool_] | NDArray[np.intp]) -> Self:
        """Some of the rows: a slice, a mask (n,), or their numbers."""
        return replace(self, **{k: v[keep] for k, v in vars(self).items() if isinstance(v, np.ndarray)})  # type: ignore[type-var]

    def __repr__(self) -> str:
        kind = getattr(self, "kind", "")
        return f"{type(self).__name__}: {self.t.size} {kind + ' ' if kind else ''}rows from {self.t[0]:g} to {self.t[-1]:g} s"


@dataclass(frozen=True)
class Sampling:
    """How a sensor makes a sample of its true signals.

    Parameters
    ----------
    average : {"interval", "instant"}
        Mean over the sampling interval, or value at the stamp.
    bandwidth : float, optional
        -3 dB of its low-pass (second order), Hz; none where not given.
    stamp : {"start", "middle", "end"}
        Where in its interval the stamp of an average lies.
    """

    average: Literal["interval", "instant"] = "interval"
    bandwidth: float | None = None
    stamp: Literal["start", "middle", "end"] = "end"

    def __post_init__(self) -> None:
        for name, known in (("average", ("interval", "instant")), ("stamp", ("start", "middle", "end"))):
            if getattr(self, name) not in known:
                raise InputError(f"sampling: {name} is '{getattr(self, name)}', expected one of: {', '.join(known)}")
        if self.bandwidth is not None and not (finite(self.bandwidth) and self.bandwidth > 0):
            raise InputError(f"sampling: bandwidth is {self.bandwidth}, expected a positive number of Hz")


@dataclass(frozen=True, repr=False)
class ImuRecord(_Timed):
    """Six axes of inertial data on one clock.

    Parameters
    ----------
    t : (n,) array
        Time stamps in s. Row k of the data belongs to the interval ``(t[k-1], t[k]]``.
    gyro, accel : (n, 3) arrays
        Angular rate with respect to inertial space and specific force in body axes (forward-right-down): rad/s and m/s^2, or
        rad and m/s for ``kind="increment"``.
    kind : {"increment", "mean", "sample"}
        Integral over the preceding interval, average over it, or value at the stamp.
    temperature : (n,) array, optional
        Sensor temperature in degC.
    sampling : Sampling, optional
        How the sensor samples, where somebody says so; ``kind`` is what the values are taken for.
    """

    t: Array
    gyro: Array
    accel: Array
    kind: ImuKind = "sample"
    temperature: Array | None = None
    sampling: Sampling | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "t", frozen_times(self.t, "IMU time"))
        n = self.t.size
        object.__setattr__(self, "gyro", frozen(self.gyro, "gyro", (n, 3)))
        object.__setattr__(self, "accel", frozen(self.accel, "accel", (n, 3)))
        if self.kind not in get_args(ImuKind):
            raise InputError(f"imu_kind is '{self.kind}', expected one of: {', '.join(get_args(ImuKind))}")
        if self.temperature is not None:
            object.__setattr__(self, "temperature", frozen(self.temperature, "temperature", (n,)))
        if n < 2:
            raise InputError(f"the IMU has {n} sample(s), expected at least two")

    @cached_property
    def dt(self) -> float:
        """Sampling interval in s: the slope of the stamps over the samples that they count (:func:`insemu.sample_times.beat`)."""
        return beat(self.t)

    def as_increments(self) -> ImuRecord:
        """Return the record as integrals over the preceding intervals (``kind="increment"``).

        Means are multiplied by the interval; samples are integrated by the trapezoid rule, the best that two values at the ends
        of an interval allow. Row 0 repeats row 1.
        """
        if self.kind == "increment":
            return self
        step = np.diff(self.t)[:, None]

        def integrate(rate: Array) -> Array:
            inner = rate[1:] * step if self.kind == "mean" else 0.5 * (rate[1:] + rate[:-1]) * step
            first = inner[:1] if inner.size else rate[:1] * 0.0
            return np.concatenate([first, inner])

        return replace(self, gyro=integrate(self.gyro), accel=integrate(self.accel), kind="increment")

    def widths(self, jitter: float = JITTER) -> Array:
        """What turns rates into the record's values, (n, 1): 1, or for increments the interval in s.

        An IMU samples by its own clock: increments between stamps that merely jitter, by less than this share of the sampling interval, all
        span the same time. Without ``jitter`` (0) every one spans what its stamps say, as in emulated data.
        """
        if self.kind != "increment":
            return np.ones((len(self), 1))
        step = np.diff(self.t, prepend=2 * self.t[0] - self.t[min(1, len(self) - 1)])
        return np.asarray(np.where(np.abs(step / self.dt - 1.0) < jitter, self.dt, step)[:, None])

    def gaps(self, longer_than: float) -> list[tuple[float, float]]:
        """Steps of more than so many seconds, as (start, length) in s."""
        step = np.diff(self.t)
        return [(float(self.t[k]), float(step[k])) for k in np.flatnonzero(step > longer_than)]

    def rates(self) -> Array:
        """Angular rate and specific force whatever the kind, (n, 6) in rad/s and m/s^2."""
        return np.asarray(np.hstack([self.gyro, self.accel]) / self.widths())

    def with_rates(self, rates: ArrayLike) -> ImuRecord:
        """The same record, of the same kind, with other rates and forces (n, 6)."""
        values = np.asarray(rates, dtype=np.float64) * self.widths()
        return replace(self, gyro=values[:, :3], accel=values[:, 3:])

    def repeated(self) -> NDArray[np.bool_]:
        """Rows that repeat the row before in all six channels, (n,): the recorder read a sample twice."""
        same = np.all((np.diff(self.gyro, axis=0) == 0.0) & (np.diff(self.accel, axis=0) == 0.0), axis=1)
        return np.concatenate([[False], same])


@dataclass(frozen=True, repr=False)
class GnssRecord(_Timed):
    """GNSS fixes of the antenna.

    Parameters
    ----------
    t : (n,) array
        Time of validity in s on the IMU's clock.
    llh : (n, 3) array
        Latitude rad, longitude rad, ellipsoidal height m. A row of NaN is "no position at this epoch".
    vel_ned : (n, 3) array, optional
        Earth-relative velocity in m/s; NaN rows are "no velocity", NaN down alone is one of speed and course.
    pos_std_ned, vel_std_ned : (n, 3) arrays, optional
        Standard deviations in m and m/s, as stated by the receiver.
    """

    t: Array
    llh: Array
    vel_ned: Array | None = None
    pos_std_ned: Array | None = None
    vel_std_ned: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "t", frozen_times(self.t, "GNSS time"))
        n = self.t.size
        object.__setattr__(self, "llh", frozen(self.llh, "gnss_llh", (n, 3), finite=False))
        latitudes(self.llh, "gnss_llh")
        for name in ("vel_ned", "pos_std_ned", "vel_std_ned"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen(getattr(self, name), f"gnss_{name}", (n, 3), finite=False))
        for name in ("llh", "vel_ned"):
            rows = None if getattr(self, name) is None else np.isinf(getattr(self, name)).any(axis=1)
            if rows is not None and rows.any():
                raise InputError(
                    f"gnss_{name} row {int(np.argmax(rows))} is infinite, expected numbers, or NaN for none"
                )
        for name in ("pos_std_ned", "vel_std_ned"):
            if getattr(self, name) is not None and (getattr(self, name) < 0.0).any():
                k = int(np.argmax((getattr(self, name) < 0.0).any(axis=1)))
                raise InputError(f"gnss_{name} row {k} is negative, expected standard deviations")

    def with_sigma(self, position: ArrayLike | None, velocity: ArrayLike | None) -> GnssRecord:
        """The same fixes with standard deviations (m, m/s; scalar or north, east, down) where the record states none; None leaves it so."""
        out, n = self, len(self)
        if out.pos_std_ned is None and position is not None:
            out = replace(out, pos_std_ned=np.array(np.broadcast_to(position, (n, 3)), dtype=np.float64))
        if out.vel_ned is not None and out.vel_std_ned is None and velocity is not None:
            out = replace(out, vel_std_ned=np.array(np.broadcast_to(velocity, (n, 3)), dtype=np.float64))
        return out

    def without_velocity(self) -> GnssRecord:
        """Positions alone."""
        return replace(self, vel_ned=None, vel_std_ned=None)

    def without_positions(self, t: ArrayLike) -> GnssRecord:
        """The same fixes, positions missing at some of their times (k,), s."""
        return replace(self, llh=np.where(np.isin(self.t, t)[:, None], np.nan, self.llh))

    def without_velocities(self, t: ArrayLike) -> GnssRecord:
        """The same fixes, velocities missing at some of their times (k,), s."""
        if self.vel_ned is None:
            return self
        return replace(self, vel_ned=np.where(np.isin(self.t, t)[:, None], np.nan, self.vel_ned))

    def with_velocities_at(self, t: ArrayLike) -> GnssRecord:
        """The same positions and velocities, these at other times (n,) in s: rows of their own, NaN where a row lacks the one or the other."""
        t = np.asarray(t, dtype=float)
        velocity = [x for x in (self.vel_ned, self.vel_std_ned) if x is not None]
        # times that agree to a microsecond are one fix
        times, at = np.unique(np.round(np.concatenate([self.t, t]), 6), return_inverse=True)
        own, moved = at[: len(self)], at[len(self) :]
        times[moved], times[own] = t, self.t

        def placed(x: Array | None, rows: NDArray[np.intp]) -> Array | None:
            if x is None:
                return None
            out = np.full((times.size, 3), np.nan)
            out[rows] = x
            return out

        keep = np.zeros(times.size, dtype=bool)
        keep[own[np.isfinite(self.llh).all(axis=1)]] = True
        keep[moved[np.all([np.isfinite(x[:, :2]).all(axis=1) for x in velocity], axis=0)]] = bool(velocity)
        llh = placed(self.llh, own)
        assert llh is not None
        std = placed(self.pos_std_ned, own)
        return GnssRecord(times, llh, placed(self.vel_ned, moved), std, placed(self.vel_std_ned, moved)).rows(keep)


@dataclass(frozen=True, repr=False)
class RawRecord(_Timed):
    """Raw observations of a GNSS receiver: pseudoranges and range rates to s satellites, less the satellites' clocks.

    Parameters
    ----------
    t : (n,) array
        True time of reception in s on the IMU's clock.
    names : tuple of str
        Satellites, for example ``G05``.
    range, rate : (n, s) arrays
        m and m/s, with bias and drift of the receiver's clock; NaN: not observed.
    range_std, rate_std : (n, s) arrays
        Standard deviations as stated by the receiver, m and m/s.
    place, velocity : (n, s, 3) arrays
        Where the satellite was at transmission, in Earth axes as they stood at reception, m; its derivative by the time of reception, m/s.
    """

    t: Array
    names: tuple[str, ...]
    range: Array
    rate: Array
    range_std: Array
    rate_std: Array
    place: Array
    velocity: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "t", frozen_times(self.t, "raw GNSS time"))
        shape = (self.t.size, len(self.names))
        for name in ("range", "rate", "range_std", "rate_std"):
            object.__setattr__(self, name, frozen(getattr(self, name), f"raw {name}", shape, finite=False))
        for name in ("place", "velocity"):
            object.__setattr__(self, name, frozen(getattr(self, name), f"raw {name}", (*shape, 3)))


@dataclass(frozen=True, repr=False)
class Trajectory(_Timed):
    """Position, velocity and attitude nodes of the IMU.

    Parameters
    ----------
    t : (n,) array
        Time in s.
    llh : (n, 3) array
        Latitude rad, longitude rad, ellipsoidal height m.
    vel_ned : (n, 3) array
        Earth-relative velocity, m/s.
    rpy : (n, 3) array
        Roll, pitch, heading in rad; ``C_nb = Rz(heading) Ry(pitch) Rx(roll)``.
    """

    t: Array
    llh: Array
    vel_ned: Array
    rpy: Array
    name: str = field(default="trajectory", compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "t", frozen_times(self.t, "trajectory time"))
        n = self.t.size
        for attribute in ("llh", "vel_ned", "rpy"):
            object.__setattr__(self, attribute, frozen(getattr(self, attribute), f"trajectory {attribute}", (n, 3)))
        latitudes(self.llh, "trajectory llh")


@dataclass(frozen=True)
class InitialState:
    """Where the IMU was at one time, known from elsewhere.

    Parameters
    ----------
    t : float
        s, on the IMU's clock.
    llh, vel_ned, rpy : (3,) arrays
        As in a :class:`Trajectory`; the attitude is that of the axes of the file.
    sigma : (9,) array
        Standard deviations of position (m), velocity (m/s), attitude (rad), north, east, down.
    """

    t: float
    llh: Array
    vel_ned: Array
    rpy: Array
    sigma: Array

    def __post_init__(self) -> None:
        if not finite(self.t):
            raise InputError(f"the time of the initial state is {self.t}, expected a finite number of seconds")
        for name, size in (("llh", 3), ("vel_ned", 3), ("rpy", 3), ("sigma", 9)):
            object.__setattr__(self, name, frozen(getattr(self, name), f"initial {name}", (size,)))
        if not (self.sigma >= 0).all():
            raise InputError(f"initial sigma is {self.sigma.tolist()}, expected nine numbers that are not negative")


@dataclass(frozen=True, repr=False)
class AidRecord(_Timed):
    """A measurement beside IMU and fixes: a known standstill, and what :mod:`insemu.filters.aids` offers.

    Parameters
    ----------
    kind : str
        Which aid; its components are named in ``insemu.filters.aids``.
    t : (n,) array
        Time of validity in s on the IMU's clock.
    values, std : (n, rows) arrays
        Measured values and their standard deviations; NaN or infinite: that component is not used.
    settings : tuple of float
        Constants of the aid, for example where it is mounted.
    since : (n,) array, optional
        Where the measurement is a mean: times from which on it was taken, s.
    """

    kind: str
    t: Array
    values: Array
    std: Array
    settings: tuple[float, ...] = ()
    since: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "t", frozen_times(self.t, f"{self.kind} time"))
        n = self.t.size
        for name in ("values", "std"):
            object.__setattr__(self, name, frozen(getattr(self, name), f"{self.kind} {name}", (n, None), finite=False))
        if self.std.shape != self.values.shape:
            raise InputError(f"{self.kind} std has shape {self.std.shape}, expected {self.values.shape}")
        if self.since is not None:
            object.__setattr__(self, "since", frozen(self.since, f"{self.kind} since", (n,)))

    def later(self, seconds: float) -> AidRecord:
        """The measurements with stamps that are so many seconds later."""
        return replace(self, t=self.t + seconds, since=None if self.since is None else self.since + seconds)

    def without(self, times: Array) -> AidRecord:
        """The measurements of other times than these, s."""
        return self.rows(~np.isin(self.t, times))


@dataclass(frozen=True)
class Reading:
    """How a recording was read from files, which says how far its units and axes were stated.

    Parameters
    ----------
    kind : str
        What the files were taken for.
    taken, assumed, notes : tuple of str
        Which columns became what; what nobody said; what was done.
    units : mapping of str to str
        Units that were taken, by role.
    repeated, missing : int
        Rows that were left out.
    accepted : bool
        Whether somebody declared that the recording is right although it contradicts physics.
    """

    kind: str
    taken: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    repeated: int = 0
    missing: int = 0
    accepted: bool = False


@dataclass(frozen=True)
class Preparation:
    """What was done to a recording before it was written: who looks for what is wrong with it looks at it as it was measured.

    Parameters
    ----------
    imu_late : float
        Seconds that were taken off the stamps of the IMU.
    gnss : GnssRecord, optional
        The fixes as they were recorded, with the standard deviations that they state and those that were left out since.
    said : tuple of str
        What was assumed, done and left out, in words.
    """

    imu_late: float = 0.0
    gnss: GnssRecord | None = None
    said: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not np.isfinite(self.imu_late):
            raise InputError(f"{self.imu_late} s were subtracted from the stamps of the IMU, expected a finite number")


@dataclass(frozen=True)
class Recording:
    """What was measured (or emulated) on one drive or flight: IMU, GNSS and, where there is one, a reference.

    Parameters
    ----------
    imu : ImuRecord
        Inertial data in the body axes of the file.
    gnss : GnssRecord, optional
        Fixes of the antenna.
    reference : Trajectory, optional
        Reference position, velocity and attitude of the IMU (``ref_*``), possibly at another rate.
    source : str
        File or folder it came from; appears in messages.
    aids : tuple of AidRecord
        Further measurements.
    initial : InitialState, optional
        Where a filter may start; found by alignment where it is not given.
    origin : Origin
        When time 0 was. What is read counts from the second in which its first IMU row lies, or from the origin that the file states.
    remarks : tuple of str
        What was found and done when it was read.
    preparation : Preparation, optional
        What was done to it before it was written.
    reading : Reading, optional
        How it was read, where it comes from files.
    """

    imu: ImuRecord
    gnss: GnssRecord | None = None
    reference: Trajectory | None = None
    source: str = "recording"
    aids: tuple[AidRecord, ...] = ()
    initial: InitialState | None = None
    origin: Origin = OWN
    remarks: tuple[str, ...] = ()
    preparation: Preparation | None = None
    reading: Reading | None = field(default=None, compare=False)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done when it was read, without what intake found."""
        return self.remarks if self.reading is None else self.reading.notes

    def as_measured(self) -> Recording:
        """The recording before its preparation: fixes as they were recorded, the IMU on its own clock."""
        done = self.preparation
        if done is None:
            return self
        return replace(self.imu_later(done.imu_late), gnss=done.gnss or self.gnss, preparation=None)

    def imu_later(self, seconds: float) -> Recording:
        """The same with stamps of the IMU, and of what is on its clock, that are so many seconds later."""
        if not seconds:
            return self
        first = None if self.initial is None else replace(self.initial, t=self.initial.t + seconds)
        imu = replace(self.imu, t=self.imu.t + seconds)
        return replace(self, imu=imu, aids=tuple(a.later(seconds) for a in self.aids), initial=first)

    def turned(self, C: Array) -> Recording:
        """The same with IMU and initial state in other axes: ``C`` (3, 3) turns vectors from those of the file into these."""
        imu, first = self.imu, self.initial
        if np.array_equal(C, np.eye(3)):
            return self
        if first is not None:
            first = replace(first, rpy=rpy_from_dcm(dcm_from_rpy(first.rpy) @ C.T))
        return replace(self, imu=replace(imu, gyro=imu.gyro @ C.T, accel=imu.accel @ C.T), initial=first)

    def from_start(self) -> Recording:
        """The same recording with times from the second of its first IMU row, where its clock began longer before than it lasts."""
        if not self.imu.t[0] > self.imu.t[-1] - self.imu.t[0]:
            return self
        first, t = counted(self.imu.t)

        def moved(times: Array) -> Array:
            start, since = counted(times)
            return since + (start - first) / SECOND

        gnss, reference, initial, done = self.gnss, self.reference, self.initial, self.preparation
        if done is not None and done.gnss is not None:
            done = replace(done, gnss=replace(done.gnss, t=moved(done.gnss.t)))
        return replace(
            self,
            preparation=done,
            imu=replace(self.imu, t=t),
            gnss=None if gnss is None else replace(gnss, t=moved(gnss.t)),
            reference=None if reference is None else replace(reference, t=moved(reference.t)),
            aids=tuple(replace(a, t=moved(a.t), since=None if a.since is None else moved(a.since)) for a in self.aids),
            initial=None if initial is None else replace(initial, t=float(moved(np.array([initial.t]))[0])),
            origin=replace(self.origin, ns=self.origin.ns + first),
        )
