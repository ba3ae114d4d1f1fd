"""The linear twin of an experiment: the errors of all designs to first order, under the draws of a flight or under draws of its own.

For one design and one reference the transition, the gains and the noise of the error are the same in all realizations to first order. Under the very
errors that a realization draws the twin gives what the filter's error would be if it were linear (:meth:`LinearTwin.realization`). Where
the truth consists of noise models, everything between two ends of outages is one map with one draw (:mod:`insemu.evaluate.segments`): the true states
and the errors of all designs move together, so that designs are compared under common draws (:meth:`LinearTwin.draw`), and mean squares need no draw.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from insemu import earth, rotation
from insemu.augment import Augmentation, augment
from insemu.errors import InputError
from insemu.evaluate.comparison import analysable
from insemu.evaluate.covariance import updates, with_true_states
from insemu.evaluate.emulated import EmulatedWorld
from insemu.evaluate.errors import navigation_error
from insemu.evaluate.experiment import Experiment
from insemu.evaluate.held import HELD
from insemu.evaluate.segments import Joint, Segments
from insemu.evaluate.world import stream
from insemu.filters import Intervals, LinearErrors, LooselyCoupledEKF, carried, gains_along, transitions
from insemu.noise import RC
from insemu.records import AXES, GnssRecord
from insemu.strapdown import NavState, mechanize_array, trajectory_of

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class LinearTwin:
    """The linear error systems of all designs of an experiment that have one.

    Parameters
    ----------
    experiment : Experiment
        Of an emulated world.

    Attributes
    ----------
    intervals : Intervals
        The reference between fixes and ends of outages, the same for all designs.
    designs : dict of str to LinearErrors
    stated : dict of str to (outages,) array
        Horizontal standard deviation that each design states at the ends of the outages, m.
    noise : dict of str to (f, 6, 6) array
        Covariance of the noise of every fix.
    left_out : str
        What the twin does not do that the full filter does, in words.

    Raises
    ------
    InputError
        A recorded drive, a recorded truth or deterministic effects, or no design with a linear twin.
    """

    def __init__(self, experiment: Experiment) -> None:
        able, self.left_out = analysable(experiment, removes_means=True)
        if not able:
            raise InputError(self.left_out, where=str(experiment.file or "scenario"))
        world, s = experiment.world, experiment.scenario
        assert isinstance(world, EmulatedWorld) and s.truth is not None
        self.experiment, self.world = experiment, world
        self._start, self._record = NavState.of(world.reference), world.imu.as_increments()
        fixes = world.recording(0, ideal=True).gnss
        assert fixes is not None
        self._fixes = GnssRecord(fixes.t, fixes.llh, fixes.vel_ned)
        t = self._record.t
        ends = np.array([start + duration for start, duration in world.outage_windows])
        self.ends = np.searchsorted(t, ends - 1e-9).clip(0, t.size - 1).astype(np.int64)
        models = {axis: m.at_rate(world.rate_hz) for axis, m in s.truth.models().items()}
        self.truth: Augmentation = augment(models, 1.0 / world.rate_hz)
        self.truth.require_constant("the linear twin")
        filters = {name: experiment.ekf(name) for name in able}
        events = filters[able[0]].events(t, self._fixes)
        self.epoch = events.epoch
        nodes = np.unique(np.concatenate([self.epoch, self.ends]))
        self._nav: Array
        self.intervals: Intervals
        self._nav, self.intervals = HELD.get((world.key, nodes.tobytes()), lambda: self._along(nodes), t.size)
        self._kept = self._fixes.rows(np.isin(self._fixes.t, events.t))
        self._designs(filters, 9 + max(ekf.augmentation.m for ekf in filters.values()))

    def _along(self, nodes: Ints) -> tuple[Array, Intervals]:
        """The reference at all rows, and cut at the nodes."""
        nav = mechanize_array(self._record, self._start, gravity=self.world.gravity)
        return nav, Intervals.of(self._record, nav, self.world.gravity, nodes)

    def _designs(self, filters: dict[str, LooselyCoupledEKF], n: int) -> None:
        """The systems of all designs, in arrays of one width."""
        s, record, nav, intervals = self.experiment.scenario, self._record, self._nav, self.intervals
        sigma = (s.gnss.position_sigma, s.gnss.velocity_sigma or (0.0, 0.0, 0.0))
        constants = augment({axis: RC(sigma=1.0) for axis in AXES}, 1.0 / self.world.rate_hz)
        rates = None
        if any((ekf.augmentation.driver >= 0).any() for ekf in filters.values()):
            rates = intervals.projected(np.hstack([record.gyro, record.accel]) / record.widths(0.0))
        k, f, d = len(intervals.F), self.epoch.size, len(filters)
        self._transition, self._M = np.zeros((k, d, n, n)), np.zeros((f, d, n, n))
        self._N, self._K = np.zeros((f, d, n, 6)), np.zeros((f, d, n, 6))
        self.designs: dict[str, LinearErrors] = {}
        self.stated: dict[str, Array] = {}
        self.noise: dict[str, Array] = {}
        self._arm: dict[str, Array] = {}
        for i, (name, ekf) in enumerate(filters.items()):
            own = carried(intervals, ekf.augmentation, rates)
            start = (self._start, s.initial.sigma)
            gains, P = gains_along(ekf, record, nav, self._fixes, start, self.ends, (intervals, own))
            joint = replace(with_true_states(ekf.augmentation, constants), white=self.truth.white)
            M, K, self.noise[name] = updates(ekf, gains, record, nav, joint, self._fixes, sigma)
            nb = ekf.layout.n
            self._transition[:, i, :nb, :nb] = transitions(intervals, own)
            self._M[:, i, :nb, :nb], self._N[:, i, :nb], self._K[:, i, :nb] = M[:, :nb, :nb], M[:, :nb, nb:], K[:, :nb]
            self.designs[name] = LinearErrors(
                intervals, self._transition[:, i, :nb, :nb], self.epoch, self._M[:, i, :nb, :nb], self._N[:, i, :nb], self._K[:, i, :nb]
            )  # fmt: skip
            self._arm[name] = -rotation.dcm_from_quaternion(nav[self.epoch, 6:10]) @ rotation.skew(ekf.lever_arm)
            self.stated[name] = np.sqrt(P[:, 0, 0] + P[:, 1, 1])
            del own, gains, M, K  # before the next design needs as much

    @property
    def rng(self) -> np.random.Generator:
        """The stream of linear draws of the scenario's seed."""
        return stream(self.experiment.scenario.seed, "linear")

    def realization(self, index: int) -> dict[str, Array]:
        """Navigation errors (outages, 9) at the ends of the outages under the draws of one realization of the full filter."""
        recording = self.world.recording(index)
        start, _ = self.world.start(index, recording.imu)
        one, true = recording.imu.as_increments(), self._record
        axes = np.hstack([one.gyro - true.gyro, one.accel - true.accel]) / true.widths(0.0)
        assert recording.gnss is not None
        drive = self.intervals.drive(axes)
        # the rate at a fix is carried on from the last two steps: with a lever arm its error in the velocity is that of both
        before = axes[np.maximum(self.epoch - 1, 1)]
        found = self.under(
            [start], drive[None], axes[None, self.epoch], before[None], [recording.gnss], list(self.designs)
        )
        return {name: errors[0] for name, errors in found.items()}

    def under(
        self,
        starts: Sequence[NavState],
        drive: Array,
        axes: Array,
        before: Array,
        fixes: Sequence[GnssRecord],
        designs: Sequence[str],
    ) -> dict[str, Array]:
        """Navigation errors (realizations, outages, 9) at the ends of the outages under given errors of the sensors.

        Parameters
        ----------
        starts : sequence of NavState
            Where the filters start.
        drive : (realizations, k, 9) array
            See :meth:`insemu.filters.LinearErrors.respond`.
        axes, before : (realizations, f, 6) arrays
            Errors of the axes in the steps that end at the fixes, and in those before.
        fixes : sequence of GnssRecord
        designs : sequence of str
        """
        true = trajectory_of(np.zeros(1), self._start.to_array()[None], "start")
        initial = np.concatenate(
            [navigation_error(trajectory_of(np.zeros(1), s.to_array()[None], "start"), true) for s in starts]
        )
        noise = np.zeros((len(fixes), len(self._kept), 6))
        for r, each in enumerate(fixes):
            one = each.rows(np.isin(each.t, self._kept.t))
            noise[r, :, :3] = earth.position_difference(one.llh, self._kept.llh)
            if one.vel_ned is not None and self._kept.vel_ned is not None:
                noise[r, :, 3:] = np.nan_to_num(
                    one.vel_ned - self._kept.vel_ned
                )  # NaN of speed and course, which nothing uses
        out = {}
        for name in designs:
            moved = noise.copy()
            moved[:, :, 3:] -= np.einsum("fij,rfj->rfi", self._arm[name], 0.5 * (axes - before)[:, :, :3])
            out[name] = self.designs[name].respond(initial, drive, axes, moved, self.ends)
        return out

    @cached_property
    def segments(self) -> Segments:
        """All designs and the truth from end to end of the outages."""
        s = self.experiment.scenario
        assert s.truth is not None
        steps = len(self._record) - 1
        length = 0 if s.truth.record is None else round(s.truth.record * self.world.rate_hz)
        own = carried(self.intervals, self.truth, sums=length > 0)
        joint = Joint(
            self.intervals, self.epoch, self._transition, self._M, self._N, self._K, list(self.noise.values())
        )
        return Segments.of(joint, (self.truth, own), s.initial.sigma.to_array(), self.ends, (length, steps))

    def draw(self, realizations: int, rng: np.random.Generator) -> dict[str, Array]:
        """Navigation errors (realizations, outages, 9) at the ends of the outages, each realization a draw of its own.

        Parameters
        ----------
        realizations : int
        rng : Generator
        """
        drawn = self.segments.draw(realizations, rng)
        return {name: drawn[:, d] for d, name in enumerate(self.designs)}

    def mean_square(self) -> dict[str, Array]:
        """Mean-square error matrices (outages, 9, 9) at the ends of the outages, without drawing anything."""
        found = self.segments.mean_square()
        return {name: found[:, d] for d, name in enumerate(self.designs)}
