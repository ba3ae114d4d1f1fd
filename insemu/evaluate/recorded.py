"""A recorded drive or flight as the world of an experiment: outages cut in, errors against a reference or the withheld fixes."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from insemu import earth, rotation
from insemu.emulate import Outage, antenna, state_at
from insemu.errors import InputError
from insemu.evaluate.consistency import nees
from insemu.evaluate.errors import navigation_error
from insemu.evaluate.world import Estimate, Scored, input_files, major_axis
from insemu.filters import (
    Alignment,
    InitialSigma,
    LooselyCoupledEKF,
    NavigationFilter,
    Standstill,
    cut,
    rests,
)
from insemu.formats import read_recording
from insemu.intake import Card, examine
from insemu.prepared import Drive, Stated, prepared
from insemu.records import ImuRecord, Recording, Trajectory
from insemu.scenario import Scenario
from insemu.strapdown import NavState

Array = NDArray[np.float64]


class RecordedWorld:
    """The recorded side of a scenario.

    Errors are against the recording's reference where it has one (``dependent`` or not, the scenario's notes say), else against the fixes:
    during an outage against those that were withheld, at the antenna. Attitude errors are NaN then.

    Parameters
    ----------
    scenario : Scenario
        With a recording.
    file : path, optional
        Where it was read from.

    Raises
    ------
    InputError
        No GNSS, an outage outside the recording, or no way to start.
    """

    def __init__(self, scenario: Scenario, file: str | Path | None = None) -> None:
        assert scenario.recording is not None
        self.scenario, self.file, self.source = scenario, file, scenario.recording
        self.files = input_files(scenario, file)
        self.path_distance_m = 0.0
        self.measured = read_recording(self.files[self.source.file])
        self.drive = self._prepared()
        self.vehicle_imu, self.gnss, self.reference = self.drive.imu, self.drive.gnss, self.measured.reference
        self.warnings = tuple(f"{self.source.file}: {said}" for said in self.drive.said)

    def _prepared(self, *, corrected: bool = False) -> Drive:
        """The recording as the scenario states it."""
        s, g = self.source, self.scenario.gnss
        sigmas = {k: getattr(g, k) for k in ("position_sigma", "velocity_sigma") if k in g.model_fields_set}
        stated = Stated(g.lever_arm, s.mounting, s.imu_time_offset, s.start, s.end, **sigmas)
        where, believed = f"{self.file or 'scenario'}: recording", g.velocity_sigma is not None
        asked = replace(stated, with_velocity=believed, how=s.alignment, gravity=s.gravity, corrected=corrected)
        return prepared(self.measured, replace(asked, shortest=0.0, where=where))

    @cached_property
    def card(self) -> Card:
        """What the recording was taken for, in vehicle axes and on the scenario's clock."""
        held = replace(self.measured, imu=self.vehicle_imu, gnss=self.gnss, source=self.source.file)
        return examine(replace(held, remarks=self.measured.notes))

    @cached_property
    def alignment(self) -> Alignment:
        """Where the filters start."""
        drive = self.drive.started()
        self.warnings += tuple(f"{self.source.file}: {said}" for said in drive.left_out)
        return drive.aligned

    @property
    def rate_hz(self) -> float:
        """Nominal IMU rate."""
        return 1.0 / self.vehicle_imu.dt

    @property
    def gravity(self) -> str:
        """Gravity model of the filters."""
        return self.source.gravity

    @cached_property
    def standstill(self) -> Standstill | None:
        """Rests that GNSS shows outside the outages, where the scenario asks for zero-velocity updates."""
        if not self.source.zero_velocity_updates:
            return None
        clear = [
            (a, b)
            for a, b in rests(self.vehicle_imu, self.gnss, bias=self.alignment.known_bias)
            if a >= self.alignment.t and not any(s < b and a < s + d for s, d in self.outage_windows)
        ]
        return Standstill(clear) if clear else None

    @cached_property
    def outage_windows(self) -> list[tuple[float, float]]:
        """Outages as (start_s, duration_s) on the recording's clock."""
        out = []
        for k, given in enumerate(self.scenario.gnss.outages):
            if given.start_s < self.gnss.t[0] or given.end_s > self.gnss.t[-1]:
                raise InputError(
                    f"outage {k + 1} from {given.start_s:g} to {given.end_s:g} s is not inside the fixes "
                    f"({self.gnss.t[0]:g} to {self.gnss.t[-1]:g} s)",
                    where=f"{self.file or 'scenario'}: gnss.outages.{k}",
                )
            out.append((given.start_s, given.duration_s))
        return sorted(out)

    def recording(self, realization: int) -> Recording:
        """The IMU from the start of the filters, in vehicle axes, the bias at rest taken off; and the fixes that the outages leave."""
        gnss = self.gnss
        if self.scenario.gnss.velocity_sigma is None:  # not to be believed, for example because it is late
            gnss = gnss.without_velocity()
        withheld = np.zeros(len(gnss), dtype=bool)
        for start, duration in self.outage_windows:
            withheld |= Outage(start, duration).covers(gnss.t)
        kept = gnss.rows((gnss.t > self.alignment.t) & ~withheld)
        imu = cut(self.vehicle_imu, self.alignment)
        return Recording(
            imu, kept, self.reference, self.source.file, self.drive.aids, self.drive.known, self.drive.origin
        )

    def imu_for(self, imu: ImuRecord, ekf: NavigationFilter) -> ImuRecord:
        """The data of :meth:`recording` as one filter flies them: a bias that it knows better than the alignment is put back."""
        if not isinstance(ekf, LooselyCoupledEKF):
            return imu
        back = self.alignment.bias_beyond() - self.alignment.bias_beyond(ekf.augmentation.turn_on_sigma())
        step = np.diff(imu.t, prepend=2 * imu.t[0] - imu.t[1])[:, None]
        return replace(imu, gyro=imu.gyro + back[:3] * step, accel=imu.accel + back[3:] * step)

    def restored(self, recording: Recording) -> Recording:
        """The recording with what its raw file shows to be lost filled in."""
        whole = self._prepared(corrected=True).imu
        first = int(np.searchsorted(whole.t, self.vehicle_imu.t[self.alignment.row]))
        return replace(recording, imu=cut(whole, replace(self.alignment, row=first)))

    def realized(self, realization: int) -> tuple[Recording, None]:
        """The recording; nobody knows what its sensors really did."""
        return self.recording(realization), None

    def start(self, realization: int, imu: ImuRecord) -> tuple[NavState, InitialSigma]:
        """Where alignment says that the vehicle is."""
        return self.alignment.state, self.alignment.sigma

    @cached_property
    def output_times(self) -> Array:
        """Epochs of the reference, at most four a second, or of the fixes."""
        if self.reference is None:
            return self.gnss.t[self.gnss.t > self.alignment.t]
        t = self.reference.t
        t = t[(t > self.alignment.t) & (t <= self.vehicle_imu.t[-1])]
        step = max(1, round(0.25 / float(np.median(np.diff(t)))))
        return np.asarray(t[::step])

    @cached_property
    def truth_at_outputs(self) -> Trajectory:
        """The reference at the output epochs; of fixes alone the antenna's way, without attitude."""
        t = self.output_times
        if self.reference is not None:
            llh, vel, q, _ = state_at(self.reference, t)
            return Trajectory(t, llh, vel, rotation.rpy_from_quaternion(q), self.reference.name)
        k = np.searchsorted(self.gnss.t, t)
        vel = self.gnss.vel_ned[k] if self.gnss.vel_ned is not None else np.zeros((t.size, 3))
        return Trajectory(t, self.gnss.llh[k], np.nan_to_num(vel), np.zeros((t.size, 3)), "fixes")

    @property
    def compared(self) -> int:
        """Navigation errors that have a reference: all nine, or position and velocity of fixes (five of speed and course), or position alone."""
        if self.reference is not None:
            return 9
        if self.scenario.gnss.velocity_sigma is None or self.gnss.vel_ned is None or self.gnss.vel_std_ned is None:
            return 3
        return 3 + int(np.isfinite(self.gnss.vel_ned).any(axis=0).sum())

    def score(self, run: Estimate, times: Array) -> Scored:
        """Errors of a run at the output epochs; the covariance of the fixes is added where they are what it is compared with.

        NEES is scaled so that a consistent filter has 9, however few errors have a reference.
        """
        t, used = self.output_times, self.compared
        # at the nearest row, moved by its velocity: between two rows a fix may lie, which the covariance knows of and an interpolation does not
        nav = run.nav[np.searchsorted(run.t, times - 1e-9)]
        rpy = rotation.rpy_from_quaternion(nav[:, 6:10])
        estimate = Trajectory(t, earth.move(nav[:, :3], nav[:, 3:6] * (t - times)[:, None]), nav[:, 3:6], rpy)
        P = run.covariance.copy()
        if self.reference is not None:
            error = navigation_error(estimate, self.truth_at_outputs)
        else:
            fixes = self.gnss.rows(np.isin(self.gnss.t, t))
            llh, vel = antenna(estimate, t, self.scenario.gnss.lever_arm)
            error = np.full((t.size, 9), np.nan)
            error[:, :3] = earth.position_difference(llh, fixes.llh)
            assert fixes.pos_std_ned is not None
            R = fixes.pos_std_ned**2
            if used > 3:
                assert fixes.vel_ned is not None and fixes.vel_std_ned is not None
                error[:, 3:6] = vel - fixes.vel_ned
                R = np.concatenate([R, fixes.vel_std_ned**2], axis=1)
            P[:, :used, :used] += np.eye(used) * R[:, None, :used]
        sigma = np.sqrt(np.einsum("tii->ti", P))
        return Scored(
            error, sigma, nees(np.nan_to_num(error[:, :used]), P[:, :used, :used]) * 9.0 / used, major_axis(P)
        )
