"""The whole filter at long steps: what the linear twin leaves out, for a fiftieth of a flight's time.

An experiment's designs fly the same motion at a rate of some hertz: the ideal signals are those of the reference at every k-th row, and the errors
of the axes are the sums of the full record's over k rows. What is nonlinear in the filter (large angles, gains that follow its own estimates, gates)
stays; only what happens within a step is lost. The errors of a realization are summed (:meth:`CoarseTwin.realization`), or the sums
are drawn by themselves (:meth:`CoarseTwin.draws`), which have the same distribution; the linear twin takes the same draws
(:meth:`CoarseTwin.linear`).

Source: Giles (2008), Multilevel Monte Carlo path simulation (a coarse path and a fine one under the same draws).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.emulate import ideal_imu
from insemu.errors import InputError
from insemu.evaluate.errors import navigation_error
from insemu.evaluate.experiment import Experiment
from insemu.evaluate.segments import even_root, summed, through_outside
from insemu.evaluate.twin import LinearTwin
from insemu.evaluate.world import stream
from insemu.filters import FilterResult, InitialSigma, LooselyCoupledEKF
from insemu.lanes import LANES
from insemu.records import GnssRecord, ImuRecord
from insemu.strapdown import NavState, trajectory_of

Array = NDArray[np.float64]

#: Longest step, s. On Table III errors at outage ends correlate with those of flights to 0.9997 or better at 0.2 s, to 0.99 at 0.5 s (8 flights).
STEP = 0.2
#: Runs whose errors are drawn at a time: as many as fly at a time.
BATCH = LANES


@dataclass(frozen=True)
class Drawn:
    """What one run errs by.

    Parameters
    ----------
    sums : (steps, 6) array
        Errors of the axes summed over the steps, rad and m/s.
    fixes : GnssRecord
    start : (NavState, InitialSigma)
    """

    sums: Array
    fixes: GnssRecord
    start: tuple[NavState, InitialSigma]


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
        self._imu = ideal_imu(r.rows(at), kind="increment", gravity=world.gravity).imu
        self._truth = r.rows(ends)
        rng = np.random.default_rng(0)  # only their standard deviations are asked for
        self._stated, self._fixes = world.fixes(rng), world.fixes(rng, ideal=True)
        self._filters = {name: _slower(linear.experiment, name, world.rate_hz / self.rows) for name in designs}
        transition, noise = summed(linear.truth, self.rows)
        self._step = transition, even_root(noise)
        behind, noise = summed(linear.truth, len(world.imu) - 1 - int(ends[-1]))
        self._rest = behind, even_root(noise)

    def realization(self, index: int) -> dict[str, Array]:
        """Navigation errors (outages, 9) at the ends of the outages under the draws of one realization of the experiment."""
        recording = self.world.recording(index)
        one, true = recording.imu.as_increments(), self.world.imu.as_increments()
        errors = np.hstack([one.gyro - true.gyro, one.accel - true.accel])
        assert recording.gnss is not None
        last = int(self._linear.ends[-1])
        sums = errors[1 : last + 1].reshape(-1, self.rows, 6).sum(axis=1)
        drawn = Drawn(sums, recording.gnss, self.world.start(index, recording.imu))
        return {name: found[0] for name, found in self.flown([drawn], list(self._filters)).items()}

    def draws(self, first: int, last: int) -> list[Drawn]:
        """The errors of some runs, each by its own stream of the scenario's seed.

        Parameters
        ----------
        first, last : int
            Numbers of the runs, the last one excluded.
        """
        seed = self._linear.experiment.scenario.seed
        streams = [stream(seed, "coarse", run) for run in range(first, last)]
        return [
            Drawn(sums, self._drawn(rng), self.world.moved_start(rng))
            for sums, rng in zip(self._sums(streams, first), streams, strict=True)
        ]

    def flown(self, draws: Sequence[Drawn], designs: Sequence[str]) -> dict[str, Array]:
        """Navigation errors (runs, outages, 9) at the ends of the outages.

        Parameters
        ----------
        draws : sequence of Drawn
            With the same standard deviations at the start.
        designs : sequence of str

        Raises
        ------
        InputError
            A filter that diverges.
        """
        imus, starts, sigma = (
            [self._sensed(one.sums) for one in draws],
            [one.start[0] for one in draws],
            draws[0].start[1],
        )
        out = {}
        for name in designs:
            fixes = [self._linear.experiment.believed(name, one.fixes) for one in draws]
            runs = self._filters[name].run_many(imus, fixes, starts, sigma)
            out[name] = np.stack([self._errors(name, run) for run in runs])
        return out

    def draw(self, runs: int, designs: Sequence[str], first: int = 0) -> dict[str, Array]:
        """Navigation errors (runs, outages, 9) at the ends of the outages, each run with draws of its own.

        Parameters
        ----------
        runs : int
        designs : sequence of str
        first : int
            Number of the first run.
        """
        ends = [*range(first, first + runs, BATCH), first + runs]
        parts = [self.flown(self.draws(a, b), designs) for a, b in pairwise(ends)]
        return {name: np.concatenate([part[name] for part in parts]) for name in designs}

    def linear(self, draws: Sequence[Drawn], designs: Sequence[str]) -> dict[str, Array]:
        """What the linear twin makes of the same draws, (runs, outages, 9).

        Parameters
        ----------
        draws : sequence of Drawn
        designs : sequence of str
        """
        twin, width = self._linear, self.rows / self.world.rate_hz
        drive, now, before = [], [], []
        for one in draws:
            axes = np.zeros((len(self.world.imu), 6))
            axes[1 : int(twin.ends[-1]) + 1] = np.repeat(one.sums / width, self.rows, axis=0)
            drive.append(twin.intervals.drive(axes))
            now.append(axes[twin.epoch])
            before.append(
                axes[np.maximum(twin.epoch - self.rows, 1)]
            )  # the rate at a fix is carried on from the last two steps
        starts, fixes = [one.start[0] for one in draws], [one.fixes for one in draws]
        return twin.under(starts, np.stack(drive), np.stack(now), np.stack(before), fixes, designs)

    def _drawn(self, rng: np.random.Generator) -> GnssRecord:
        """Fixes with errors of their own, as the emulator makes them."""
        stated, ideal = self._stated, self._fixes
        assert stated.pos_std_ned is not None
        llh = earth.move(ideal.llh, stated.pos_std_ned * rng.standard_normal(stated.pos_std_ned.shape))
        if stated.vel_std_ned is None or ideal.vel_ned is None:
            return replace(stated, llh=llh)
        moved = ideal.vel_ned + stated.vel_std_ned * rng.standard_normal(stated.vel_std_ned.shape)
        return replace(stated, llh=llh, vel_ned=moved)

    def _sums(self, streams: Sequence[np.random.Generator], first: int) -> Array:
        """Errors of the axes summed over the steps, rad and m/s, (runs, steps, 6); runs take the pieces of a record by turns."""
        parts, m = self._linear.segments, self._linear.truth.m
        transition, noise = self._step
        steps = len(self._imu) - 1
        behind, tail = self._rest
        place = np.arange(first, first + len(streams)) % max(len(parts.before), 1)
        xi = [
            np.stack([rng.standard_normal(shape) for rng in streams])
            for shape in (m, m + 6, (steps, m + 6), m + 6, m + 6)
        ]
        y = np.zeros((len(streams), m + 6))
        y[:, :m] = xi[0] @ even_root(parts.first[:m, :m]).T
        if parts.length:
            y = through_outside(y, xi[1], place, parts.before, parts.roots[0])
        w = xi[2] @ noise.T
        s = _chain(y[:, :m], transition[:m, :m], w[..., :m])
        out = s[:, :-1] @ transition[m:, :m].T + w[..., m:]
        if parts.length:  # the mean of the whole record is subtracted from its pieces
            y = np.hstack([s[:, -1], y[:, m:] + out.sum(axis=1)])
            y = y @ behind.T + xi[3] @ tail.T
            y = through_outside(y, xi[4], place, parts.after, parts.roots[1])
            out -= self.rows * y[:, None, m:] / parts.length
        return out / self.world.rate_hz

    def _sensed(self, sums: Array) -> ImuRecord:
        """The signals with given sums of the axes' errors (steps, 6)."""
        errors = np.vstack([sums[:1], sums])
        return replace(self._imu, gyro=self._imu.gyro + errors[:, :3], accel=self._imu.accel + errors[:, 3:])

    def _errors(self, name: str, run: FilterResult | InputError) -> Array:
        """Navigation errors (outages, 9) of a flight."""
        if isinstance(run, InputError):
            raise run
        at = np.searchsorted(run.t, self._truth.t - 1e-9)
        return navigation_error(trajectory_of(self._truth.t, run.nav[at], name), self._truth)


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


def _chain(first: Array, transition: Array, added: Array) -> Array:
    """States (runs, steps + 1, m) that move by one transition, with what is added (runs, steps, m): in blocks side by side, which are then joined."""
    runs, steps, m = added.shape
    size = math.isqrt(steps) + 1
    blocks = -(-steps // size)
    padded = np.zeros((runs, blocks * size, m))
    padded[:, :steps] = added
    own = padded.reshape(runs, blocks, size, m)
    powers = np.empty((size, m, m))
    powers[0] = transition
    for k in range(1, size):
        own[:, :, k] += own[:, :, k - 1] @ transition.T
        powers[k] = transition @ powers[k - 1]
    starts = np.empty((runs, blocks, m))
    at = first
    for k in range(blocks):
        starts[:, k] = at
        at = own[:, k, -1] + at @ powers[-1].T
    own += np.einsum("kij,rbj->rbki", powers, starts, optimize=True)
    return np.concatenate([first[:, None], padded[:, :steps]], axis=1)
