"""Emulated flights that are too long to be held: the ideal signals lie in a temporary file, everything else is made stretch by stretch."""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import lcm
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu import covariates
from insemu.emulate import Following, TrueStates, corrupt, ideal_stretches
from insemu.errors import InputError
from insemu.evaluate.emulated import MAX_SAMPLES, EmulatedWorld
from insemu.evaluate.world import OUTPUT_INTERVAL, stream
from insemu.noise import BI, check_held
from insemu.records import ImuRecord, Trajectory
from insemu.scenario import Scenario

Array = NDArray[np.float64]

#: Intervals of a stretch at most: ten minutes at 200 Hz.
STRETCH = 1 << 17
#: Rows of the reference that are kept before and after each fix: what its interpolation looks at.
_AROUND = 2


@dataclass(frozen=True)
class Stretch:
    """A part of one realization.

    Parameters
    ----------
    imu : ImuRecord
        What the sensors give; the last row of a stretch is the first of the next.
    rows : (k,) array of int
        Rows of the IMU at output epochs that the stretch before does not have.
    outputs : slice
        Which output epochs these are.
    true : TrueStates
        Of the axes at these rows.
    """

    imu: ImuRecord
    rows: NDArray[np.intp]
    outputs: slice
    true: TrueStates


class StretchedWorld(EmulatedWorld):
    """The emulated side of a scenario whose flight is longer than :data:`~insemu.evaluate.emulated.MAX_SAMPLES`.

    ``reference`` holds the rows at output epochs and around fixes only; there is no ``imu``: see :meth:`stretches`.

    Raises
    ------
    InputError
        What needs a flight as a whole: effects, recorded errors, areas, aids, a smoother, what designs do with a whole record.
    """

    def __getattr__(self, name: str) -> Any:
        if name == "imu":
            raise InputError(
                f"a flight of {self.count:.3g} samples is flown in stretches, and this needs it as a whole; expected at most {MAX_SAMPLES:g}",
                where=f"{self._name}: trajectory",
            )
        raise AttributeError(name)

    def __getstate__(self) -> dict[str, Any]:
        """For another process, which makes the signals there again."""
        return {k: v for k, v in super().__getstate__().items() if k not in ("_file", "_lock", "reference")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._fly()

    def _refuse(self) -> None:
        """Say what this scenario has that needs the flight as a whole."""
        s, truth = self.scenario, self.truth
        found = {
            "trajectory.begin": bool(self.source.begin),
            "truth.recorded": truth.recorded is not None,
            "truth.effects": bool(truth.effects),
            "truth.temperature": truth.temperature is not None,
            "levels that follow a covariate": bool(covariates.needed(truth.models().values())),
            "gnss.areas": bool(s.gnss.areas),
            "gnss.raw": s.gnss.raw is not None,
            "aids": bool(s.aids),
            "smoother": s.smoother,
        }
        for name, design in s.designs.items():
            o = design.options
            found |= {
                f"designs.{name}.filter": design.filter is not None,
                f"designs.{name}.prefilter": o.prefilter is not None,
                f"designs.{name}.compensate": bool(o.compensate),
                f"designs.{name}.zero_updates": o.zero_updates is not None,
                f"states for the installation of designs.{name}": o.states.lever_arm > 0 or o.states.latency > 0,
            }
        if any(found.values()):
            raise InputError(
                f"a flight of {self.count:.3g} samples is flown in stretches, which is not possible with "
                f"{', '.join(k for k, there in found.items() if there)}; expected at most {MAX_SAMPLES:g} samples with that",
                where=f"{self._name}: trajectory",
            )
        for process in (p for model in truth.models().values() for p in model if isinstance(p, BI)):
            check_held(self.count, process.symbol)

    def _fly(self) -> None:
        """Write the ideal signals to the file, and keep what is asked for of the reference."""
        source, loaded = self.source, self._loaded()
        self.flight, self.track, self.warnings = loaded.flight, loaded.track, loaded.warnings
        self._refuse()
        fixes = (
            self._t(0)
            + np.arange(1, int(self.count / source.rate * self.scenario.gnss.rate + 1e-6) + 1) / self.scenario.gnss.rate
        )
        around = self._row(fixes)[:, None] + np.arange(-_AROUND, _AROUND + 1)
        keep = np.unique(np.concatenate([around.ravel().clip(0, self.count), self.output_rows, [0, self.count]]))
        self._file, self._lock = tempfile.TemporaryFile(prefix="insemu-flight-"), Lock()
        weakref.finalize(self, self._file.close)
        self.path_distance_m, done = 0.0, 0
        parts = ideal_stretches(
            self.flight.path, source.rate, STRETCH, end_s=self._end, mode=source.mode, kind=source.kind,
            mounting=source.mounting, gravity=source.gravity,
            sampling=source.imu,
        )  # fmt: skip
        llh, vel, rpy = np.empty((3, keep.size, 3))
        for ideal in parts:
            own = slice(1 if done else 0, None)  # the last row of a stretch is the first of the next
            try:
                self._file.write(np.hstack([ideal.imu.gyro[own], ideal.imu.accel[own]]).data)
                self._file.flush()
            except OSError as error:
                raise InputError(
                    f"the signals of the flight, {self.count * 48 / 1e6:.3g} MB, cannot be written ({error.strerror}); TMPDIR names another folder",
                    where=tempfile.gettempdir(),
                ) from None
            a, b = np.searchsorted(keep, [done, done + len(ideal.imu)])
            rows, r = keep[a:b] - done, ideal.reference
            llh[a:b], vel[a:b], rpy[a:b] = r.llh[rows], r.vel_ned[rows], r.rpy[rows]
            self.path_distance_m = max(self.path_distance_m, ideal.path_distance_m)
            done += len(ideal.imu) - 1
        self.reference = Trajectory(self._t(keep), llh, vel, rpy, self.flight.name)

    # -- the clock, known without any signal ----------------------------------------------------------------------------------------

    @property
    def _end(self) -> float:
        """Where the flight ends on the clock of its path, s."""
        path, duration = self.flight.path, self.source.duration
        return path.end if duration is None else min(path.end, path.start + duration)

    @cached_property
    def count(self) -> int:
        """Intervals of the IMU."""
        return int(np.floor((self._end - self.flight.path.start) * self.source.rate + 1e-6))

    def _t(self, rows: ArrayLike) -> Array:
        return np.minimum(self.flight.path.start + np.asarray(rows) / self.source.rate, self._end)

    def _row(self, times: Array) -> NDArray[np.intp]:
        """First row at or after times (k,), to a millionth of an interval as the filter takes it."""
        return np.ceil((times - self.flight.path.start) * self.source.rate - 1e-6).astype(np.intp)

    @property
    def _span(self) -> tuple[float, float]:
        return float(self._t(0)), float(self._t(self.count))

    @cached_property
    def output_rows(self) -> NDArray[np.intp]:
        """Rows of the IMU at which errors are evaluated."""
        start, end = self._span
        ends = [begin + duration for begin, duration in self.outage_windows]
        asked = np.concatenate([np.arange(start, end + 1e-9, OUTPUT_INTERVAL), ends])
        return np.unique(self._row(asked - 1e-6).clip(0, self.count))

    @cached_property
    def output_times(self) -> Array:
        """Epochs at which errors are evaluated: every second, and the end of every outage."""
        return self._t(self.output_rows)

    @cached_property
    def bounds(self) -> list[int]:
        """Rows at which stretches begin and end: where there is a fix, so that the filter hands over just after an update."""
        every = lcm(*(d.options.covariance_every for d in self.scenario.designs.values()))
        at = self._row(self.fixes(stream(self.scenario.seed, "gnss", 0), ideal=True).t)
        at, out = at[at % every == 0], [0]
        while self.count - out[-1] > STRETCH:
            most = out[-1] + STRETCH
            last = at[np.searchsorted(at, most, side="right") - 1] if at.size else 0
            out.append(int(last) if last > out[-1] + STRETCH // 2 else most - most % every)
        return [*out, self.count]

    def stretches(self, realization: int) -> Iterator[Stretch]:
        """What the sensors give in one realization, stretch after stretch.

        Parameters
        ----------
        realization : int
        """
        truth, seed, dt = self.truth, self.scenario.seed, 1.0 / self.source.rate
        length = self.count if truth.record is None else round(truth.record * self.source.rate)
        if length < self.count:
            raise InputError(f"the record of {truth.record:g} s is shorter than the flight of {self.count * dt:g} s")
        record, place = divmod(realization, length // self.count)
        models = {axis: model.at_rate(self.source.rate) for axis, model in self.sensor(record).items()}
        errors = Following(
            models, lambda axis: stream(seed, "truth", record, axis), dt, self.count, length, place, centred=truth.record is not None
        )  # fmt: skip
        outputs = 0
        for first, last in zip(self.bounds[:-1], self.bounds[1:], strict=True):
            drawn, slow = errors(last - first)
            # row 0 of the flight belongs to an interval before it, which nothing integrates; it takes the first sample
            drawn, slow = (np.concatenate([x[:1], x]) for x in (drawn, slow))
            own = np.flatnonzero(self.output_rows[outputs:] <= last).size
            rows = self.output_rows[outputs : outputs + own] - first
            imu = corrupt(self._ideal(first, last), None, stream(seed, "effects", realization), errors=drawn).imu
            yield Stretch(imu, rows, slice(outputs, outputs + own), TrueStates(slow[rows], None, ()))
            outputs += own

    def _ideal(self, first: int, last: int) -> ImuRecord:
        """Ideal signals of some rows."""
        values = np.empty((last - first + 1, 6))
        with self._lock:
            self._file.seek(first * 48)
            self._file.readinto(values.data)
        return ImuRecord(
            self._t(np.arange(first, last + 1)),
            values[:, :3],
            values[:, 3:],
            self.source.kind,
            sampling=self.source.imu,
        )


def emulated_world(scenario: Scenario, file: str | Path | None = None) -> EmulatedWorld:
    """The emulated side of a scenario, held as a whole or, where that would be too much, in stretches."""
    source = scenario.trajectory
    long = source is not None and source.duration is not None and source.duration * source.rate > MAX_SAMPLES
    return StretchedWorld(scenario, file) if long else EmulatedWorld(scenario, file)
