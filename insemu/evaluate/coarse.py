"""The whole filter at long steps: what the linear twin leaves out, for a fiftieth of a flight's time.

An experiment's designs fly the same motion at a rate of some hertz: the ideal signals are those of the reference at every k-th row, and the errors
of the axes are the sums of the full record's over k rows. What is nonlinear in the filter (large angles, gains that follow its own estimates, gates)
stays; only what happens within a step is lost. The errors of a realization are summed (:meth:`CoarseTwin.realization`), or the sums
are drawn by themselves (:meth:`CoarseTwin.draw`), which have the same distribution.

Source: Giles (2008), Multilevel Monte Carlo path simulation (a coarse path and a fine one under the same draws).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.emulate import ideal_imu
from insemu.evaluate.errors import navigation_error
from insemu.evaluate.experiment import Experiment
from insemu.evaluate.twin import LinearTwin, root_of, summed
from insemu.evaluate.world import stream
from insemu.filters import InitialSigma, LooselyCoupledEKF
from insemu.records import GnssRecord, ImuRecord, Trajectory
from insemu.strapdown import NavState, trajectory_of

Array = NDArray[np.float64]

#: Longest step, s. On Table III errors at outage ends correlate with those of flights to 0.9997 or better at 0.2 s, to 0.99 at 0.5 s (8 flights).
STEP = 0.2
#: Realizations whose errors are drawn at a time.
BATCH = 64


class CoarseTwin:
    """The filters of an experiment's designs, flown at long steps.

    Parameters
    ----------
    linear : LinearTwin
        Of the experiment.
    designs : sequence of str
        Those that are wanted, of ``linear.designs``.

    Attributes
    ----------
    rows : int
        Rows of the IMU in a step; 1 where the ends of the outages share no longer one.
    """

    def __init__(self, linear: LinearTwin, designs: Sequence[str]) -> None:
        self._linear, self.world = linear, linear.world
        world, ends = linear.world, linear.ends
        shared, most = math.gcd(*(int(k) for k in ends)), max(1, int(STEP * world.rate_hz + 1e-9))
        self.rows = next(k for k in range(most, 0, -1) if shared % k == 0)
        at, r = np.arange(0, ends[-1] + 1, self.rows), world.reference
        self._imu = ideal_imu(
            Trajectory(r.t[at], r.llh[at], r.vel_ned[at], r.rpy[at], r.name), kind="increment", gravity=world.gravity
        ).imu
        self._truth = Trajectory(r.t[ends], r.llh[ends], r.vel_ned[ends], r.rpy[ends], r.name)
        self._stated, self._fixes = world.fixes(self.rng), world.fixes(self.rng, ideal=True)
        self._filters = {name: _slower(linear.experiment, name, world.rate_hz / self.rows) for name in designs}

    @property
    def rng(self) -> np.random.Generator:
        """The stream of coarse draws of the scenario's seed."""
        return stream(self._linear.experiment.scenario.seed, "coarse")

    def realization(self, index: int) -> dict[str, Array]:
        """Navigation errors (outages, 9) at the ends of the outages under the draws of one realization of the experiment."""
        recording = self.world.recording(index)
        one, true = recording.imu.as_increments(), self.world.imu.as_increments()
        errors = np.hstack([one.gyro - true.gyro, one.accel - true.accel])
        assert recording.gnss is not None
        last = int(self._linear.ends[-1])
        sums = errors[1 : last + 1].reshape(-1, self.rows, 6).sum(axis=1)
        return self._flown(sums, recording.gnss, *self.world.start(index, recording.imu))

    def draw(self, realizations: int, rng: np.random.Generator) -> dict[str, Array]:
        """Navigation errors (realizations, outages, 9) at the ends of the outages, each realization a draw of its own.

        Parameters
        ----------
        realizations : int
        rng : Generator
        """
        out = {name: np.empty((realizations, len(self._truth), 9)) for name in self._filters}
        for first in range(0, realizations, BATCH):
            size = min(BATCH, realizations - first)
            sums = self._sums(size, rng)
            for k in range(size):
                found = self._flown(sums[:, :, k], self._drawn(rng), *self.world.moved_start(rng))
                for name, errors in found.items():
                    out[name][first + k] = errors
        return out

    def _drawn(self, rng: np.random.Generator) -> GnssRecord:
        """Fixes with errors of their own, as the emulator makes them."""
        stated, ideal = self._stated, self._fixes
        assert stated.pos_std_ned is not None
        llh = earth.move(ideal.llh, stated.pos_std_ned * rng.standard_normal(stated.pos_std_ned.shape))
        if stated.vel_std_ned is None or ideal.vel_ned is None:
            return replace(stated, llh=llh)
        moved = ideal.vel_ned + stated.vel_std_ned * rng.standard_normal(stated.vel_std_ned.shape)
        return replace(stated, llh=llh, vel_ned=moved)

    def _sums(self, size: int, rng: np.random.Generator) -> Array:
        """Errors of the axes summed over the steps, rad and m/s, (steps, 6, realizations)."""
        truth, dt = self._linear.truth, 1.0 / self.world.rate_hz
        before, after, length = self._linear.pieces
        driving = root_of(truth.P0)
        y = np.zeros((truth.m + 6, size))
        y[: truth.m] = driving @ rng.standard_normal((driving.shape[1], size))
        _move(y, before, rng)
        transition, noise = summed(truth, self.rows)
        out = np.empty((len(self._imu) - 1, 6, size))
        total = y[truth.m :].copy()
        for k in range(len(out)):
            y = transition[:, : truth.m] @ y[: truth.m] + noise @ rng.standard_normal((noise.shape[1], size))
            out[k] = y[truth.m :]
            total += out[k]
        if length:  # the mean of the whole record is taken off its pieces
            y[truth.m :] = total
            for rest in ([summed(truth, len(self.world.imu) - 1 - int(self._linear.ends[-1]))], after):
                _move(y, rest, rng)
            out -= self.rows * y[truth.m :] / length
        return out * dt

    def _flown(self, sums: Array, fixes: GnssRecord, start: NavState, sigma: InitialSigma) -> dict[str, Array]:
        """Errors of every design with given sums of the axes' errors (steps, 6)."""
        errors = np.vstack([sums[:1], sums])
        imu: ImuRecord = replace(self._imu, gyro=self._imu.gyro + errors[:, :3], accel=self._imu.accel + errors[:, 3:])
        out = {}
        for name, ekf in self._filters.items():
            run = ekf.run(imu, self._linear.experiment.believed(name, fixes), start, sigma)
            at = np.searchsorted(run.t, self._truth.t - 1e-9)
            out[name] = navigation_error(trajectory_of(self._truth.t, run.nav[at], name), self._truth)
        return out


def _slower(experiment: Experiment, design: str, rate_hz: float) -> LooselyCoupledEKF:
    """A design's filter for another rate of the IMU."""
    one = experiment.ekf(design)
    belief = {axis: m.at_rate(rate_hz) for axis, m in experiment.beliefs[design].models.items()}
    return LooselyCoupledEKF(
        belief,
        1.0 / rate_hz,
        lever_arm=one.lever_arm,
        gravity=one.gravity,
        gnss_sigma=one.gnss_sigma,
        options=replace(one.options, covariance_every=1, output_every=1, covariance_at=(), store="none"),
    )


def _move(y: Array, pieces: Sequence[tuple[Array, Array]], rng: np.random.Generator) -> None:
    """Take true states and sums (m + 6, realizations) through what lies beside a piece of the record, realizations by turns at each place."""
    for p, (transition, noise) in enumerate(pieces):
        mine = slice(p, None, len(pieces))
        width = y[:, mine].shape[1]
        y[:, mine] = transition @ y[:, mine] + noise @ rng.standard_normal((noise.shape[1], width))
