"""Monte Carlo to first order: the linear twin of an experiment, thousands of realizations as matrix products.

For one design and one reference the transition, the gains and the noise of the error are the same in all realizations to first order. Under the very
errors that a realization draws the twin gives what the filter's error would be if it were linear (:meth:`LinearTwin.realization`). Where
the truth consists of noise models, the rows between two epochs collapse into one map with one draw (:meth:`LinearTwin.draw`): the true states
and the errors of all designs move together, so that designs are compared under common draws.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu import earth, rotation
from insemu.augment import Augmentation, augment
from insemu.compiled import wait_for_kernels
from insemu.errors import InputError
from insemu.evaluate.comparison import analysable
from insemu.evaluate.covariance import beside, on_ideal_data, updates
from insemu.evaluate.emulated import EmulatedWorld
from insemu.evaluate.errors import navigation_error
from insemu.evaluate.experiment import Experiment
from insemu.evaluate.world import stream
from insemu.filters import LinearErrors, driven, error_maps, step_matrices
from insemu.noise import RC
from insemu.records import AXES, GnssRecord
from insemu.strapdown import NavState, mechanize_array, trajectory_of

Array = NDArray[np.float64]

#: Realizations that are drawn at a time.
BATCH = 2000


@dataclass(frozen=True)
class Interval:
    """All rows between two epochs in one map: the true states, what each axis has summed up, then errors and estimates of every design.

    Parameters
    ----------
    transition : mapping of design to (n, n) array
        Of a design's own errors and estimates.
    effect : (designs + 6, m) array
        Of the true states at the start on the sums and on all designs' errors.
    phi : (m, m) array
        Transition of the true states.
    root : (m + 6 + designs, k) array
        Times a standard normal vector: what noise adds.
    fixes : sequence of int
        Numbers of the fixes at its end.
    end : int
        Its last row.
    """

    transition: Mapping[str, Array]
    effect: Array
    phi: Array
    root: Array
    fixes: Sequence[int]
    end: int


class LinearTwin:
    """The linear error systems of all designs of an experiment that have one.

    Parameters
    ----------
    experiment : Experiment
        Of an emulated world.

    Attributes
    ----------
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
        fixes = world.recording(0, ideal=True).gnss
        assert fixes is not None
        self._fixes = GnssRecord(fixes.t, fixes.llh, fixes.vel_ned)
        record = world.imu.as_increments()
        self._start = NavState.of(world.reference)
        t = record.t
        ends = np.array([start + duration for start, duration in world.outage_windows])
        self.ends = np.searchsorted(t, ends - 1e-9).clip(0, t.size - 1).astype(np.int64)
        self.designs: dict[str, LinearErrors] = {}
        self.stated: dict[str, Array] = {}
        self.noise: dict[str, Array] = {}
        self._arm: dict[str, Array] = {}
        _ = experiment.beliefs  # models are fitted while another process may be compiling the filter
        wait_for_kernels()
        constants = augment({axis: RC(sigma=1.0) for axis in AXES}, 1.0 / world.rate_hz)
        models = {axis: m.at_rate(world.rate_hz) for axis, m in s.truth.models().items()}
        self.truth: Augmentation = augment(models, 1.0 / world.rate_hz)
        self.truth.require_constant("the linear twin")
        sigma = (s.gnss.position_sigma, s.gnss.velocity_sigma or (0.0, 0.0, 0.0))
        for name in able:
            ekf = experiment.ekf(name)
            nav = mechanize_array(record, self._start, gravity=ekf.gravity)
            if not self.designs:
                F, B = step_matrices(t, error_maps(record, nav, ekf.gravity))
            ekf, run = on_ideal_data(ekf, record, nav, self._fixes, self._start, s.initial.sigma, t[self.ends])
            belief, nb = ekf.augmentation, 9 + ekf.augmentation.m
            joint = replace(beside(belief, constants), white=self.truth.white)
            M, K, self.noise[name] = updates(ekf, run, record, nav, joint, self._fixes, sigma)
            C = belief.output(np.hstack(belief.sensed(record)) / record.widths())
            C = C if C.ndim == 3 else C[None]
            self.designs[name] = LinearErrors(
                F, B, C, belief.Phi, run.fixes.epoch, M[:, :nb, :nb].copy(), M[:, :nb, nb:].copy(), K[:, :nb].copy()
            )
            l0, l1, l2 = ekf.lever_arm
            cross = np.array([[0.0, -l2, l1], [l2, 0.0, -l0], [-l1, l0, 0.0]])
            self._arm[name] = -rotation.dcm_from_quaternion(nav[run.fixes.epoch, 6:10]) @ cross
            P = run.covariance[np.searchsorted(run.covariance_t, t[self.ends])]
            self.stated[name] = np.sqrt(P[:, 0, 0] + P[:, 1, 1])
        self._epoch, self._kept = run.fixes.epoch, self._fixes.rows(np.isin(self._fixes.t, run.fixes.t))

    @property
    def rng(self) -> np.random.Generator:
        """The stream of linear draws of the scenario's seed."""
        return stream(self.experiment.scenario.seed, "linear")

    def realization(self, index: int) -> dict[str, Array]:
        """Navigation errors (outages, 9) at the ends of the outages under the draws of one realization of the full filter."""
        recording = self.world.recording(index)
        start, _ = self.world.start(index, recording.imu)
        moved, true_start = (
            trajectory_of(np.zeros(1), state.to_array()[None], "start") for state in (start, self._start)
        )
        initial = navigation_error(moved, true_start)[0]
        one, true = recording.imu.as_increments(), self.world.imu.as_increments()
        axes = np.hstack([one.gyro - true.gyro, one.accel - true.accel]) / true.widths(0.0)
        assert recording.gnss is not None
        fixes, ideal = recording.gnss.rows(np.isin(recording.gnss.t, self._kept.t)), self._kept
        noise = np.zeros((len(fixes), 6))
        noise[:, :3] = earth.position_difference(fixes.llh, ideal.llh)
        if fixes.vel_ned is not None and ideal.vel_ned is not None:
            noise[:, 3:] = fixes.vel_ned - ideal.vel_ned
        # the rate at a fix is carried on from the last two steps: with a lever arm its error in the velocity is that of both
        rows = self._epoch
        change = 0.5 * (axes[rows] - axes[np.maximum(rows - 1, 1)])[:, :3]
        out = {}
        for name, system in self.designs.items():
            moved_noise = noise.copy()
            moved_noise[:, 3:] -= np.einsum("fij,fj->fi", self._arm[name], change)
            out[name] = system.respond(initial, axes, moved_noise, self.ends)
        return out

    def draw(self, realizations: int, rng: np.random.Generator) -> dict[str, Array]:
        """Navigation errors (realizations, outages, 9) at the ends of the outages, each realization a draw of its own.

        Parameters
        ----------
        realizations : int
        rng : Generator
        """
        intervals, removed = [self._placed(i) for i in self._intervals()], self._constants()
        noise = {name: [self._there(root_of(v)) for v in values] for name, values in self.noise.items()}
        out = {name: np.empty((realizations, self.ends.size, 9)) for name in self.designs}
        for first in range(0, realizations, BATCH):
            size = min(BATCH, realizations - first)
            self._batch(intervals, removed, noise, rng, {n: v[first : first + size] for n, v in out.items()})
        return out

    def _there(self, values: Array) -> Any:
        """Where matrix products are made: the experiment's GPU, or here."""
        return values if (gpu := self.experiment.gpu) is None else gpu.there(values)

    def _here(self, values: Any) -> Array:
        gpu = self.experiment.gpu
        return np.asarray(values) if gpu is None else gpu.here(values)

    def _placed(self, interval: Interval) -> Interval:
        """An interval's matrices where products are made."""
        matrices = {k: self._there(v) for k, v in interval.transition.items()}
        effect, phi, root = (self._there(v) for v in (interval.effect, interval.phi, interval.root))
        return replace(interval, transition=matrices, effect=effect, phi=phi, root=root)

    def _batch(
        self,
        intervals: Sequence[Interval],
        constant: Mapping[str, Array],
        noise_of: Mapping[str, Sequence[Any]],
        rng: np.random.Generator,
        out: Mapping[str, Array],
    ) -> None:
        """Fill arrays (realizations, outages, 9)."""
        size = len(next(iter(out.values())))
        truth, seen = self.truth, self.truth.output()
        initial = self.experiment.scenario.initial.sigma.to_array()[:, None] * rng.standard_normal((9, size))
        z = {name: np.vstack([initial, np.zeros((system.size - 9, size))]) for name, system in self.designs.items()}
        first = root_of(truth.P0)
        s = first @ rng.standard_normal((first.shape[1], size))
        summed = np.zeros((6, size))
        before, after, length = self.pieces
        for p, (transition, root) in enumerate(before):
            mine = slice(p, None, len(before))
            y = transition @ np.vstack([s[:, mine], summed[:, mine]])
            y += root @ rng.standard_normal((root.shape[1], y.shape[1]))
            s[:, mine], summed[:, mine] = y[: truth.m], y[truth.m :]
        there = self._there
        seen, s, summed = there(seen), there(s), there(summed)
        z = {name: there(v) for name, v in z.items()}
        gains = {name: tuple(there(v) for v in (d.M, d.N, d.K)) for name, d in self.designs.items()}
        for interval in intervals:
            noise = interval.root @ there(rng.standard_normal((interval.root.shape[1], size)))
            added = interval.effect @ s + noise[truth.m :]
            s = interval.phi @ s + noise[: truth.m]
            summed += added[:6]
            at = 6
            for name, system in self.designs.items():
                z[name] = interval.transition[name] @ z[name] + added[at : at + system.size]
                at += system.size
            for f in interval.fixes:
                drawn = there(rng.standard_normal((6, size)))
                for name, (M, N, K) in gains.items():
                    fixed = noise_of[name][f]
                    z[name] = M[f] @ z[name] + N[f] @ (seen @ s) + K[f] @ (fixed @ drawn[: fixed.shape[1]])
            for o in np.flatnonzero(self.ends == interval.end):
                for name in self.designs:
                    out[name][:, o] = self._here(z[name][:9]).T
        s, summed = self._here(s), self._here(summed)
        for p, (transition, root) in enumerate(after):  # the mean of the whole record is taken off its pieces
            mine = slice(p, None, len(after))
            y = transition @ np.vstack([s[:, mine], summed[:, mine]])
            y += root @ rng.standard_normal((root.shape[1], y.shape[1]))
            for name, response in constant.items():
                out[name][mine] -= np.einsum("oca,ar->roc", response, y[truth.m :] / length)

    def _intervals(self) -> list[Interval]:
        """The maps from epoch to epoch: fixes, ends of outages, the end."""
        truth, seen = self.truth, self.truth.output()
        last = len(self.world.imu) - 1
        nodes = np.unique(np.concatenate([[0], self._epoch, self.ends, [last]]))
        driving = root_of(truth.Q)
        out = []
        for a, b in pairwise(nodes):
            parts = {name: system.between(int(a), int(b)) for name, system in self.designs.items()}
            count = int(b - a)
            gain = np.concatenate([np.tile(np.eye(6), (count, 1, 1)), *(g for _, g in parts.values())], axis=1)
            effect = np.empty((count + 1, gain.shape[1], truth.m))
            driven(gain, seen, truth.Phi, effect)
            own = [np.eye(truth.m)]
            for _ in range(count):
                own.append(truth.Phi @ own[-1])
            states = np.stack(own[:count][::-1]) @ driving
            noise = np.concatenate([states, effect[1:] @ driving], axis=1)
            white = np.concatenate([np.zeros((count, truth.m, 6)), gain * np.sqrt(truth.white)], axis=1)
            L = np.concatenate([noise, white], axis=2).transpose(1, 0, 2).reshape(noise.shape[1], -1)
            transitions = {name: transition for name, (transition, _) in parts.items()}
            fixes = [int(f) for f in np.flatnonzero(self._epoch == b)]
            out.append(Interval(transitions, effect[0], own[count], root_of(L @ L.T), fixes, int(b)))
        return out

    def _constants(self) -> dict[str, Array]:
        """What a constant error of each axis does at the ends of the outages, (outages, 9, 6)."""
        n, fixes = len(self.world.imu), self._epoch.size
        out = {}
        for name, system in self.designs.items():
            columns = [
                system.respond(np.zeros(9), np.tile(unit, (n, 1)), np.zeros((fixes, 6)), self.ends)
                for unit in np.eye(6)
            ]
            out[name] = np.stack(columns, axis=2)
        return out

    @cached_property
    def pieces(self) -> tuple[list[tuple[Array, Array]], list[tuple[Array, Array]], int]:
        """Maps of true states and sums over what lies before and after each piece of a record, and the record's length; empty without records."""
        assert self.experiment.scenario.truth is not None
        record_s, steps = self.experiment.scenario.truth.record, len(self.world.imu) - 1
        if record_s is None:
            return [], [], 0
        length = round(record_s * self.world.rate_hz)
        places = range(length // steps)
        before = [summed(self.truth, p * steps) for p in places]
        return before, [summed(self.truth, length - (p + 1) * steps) for p in places], length


def summed(truth: Augmentation, count: int) -> tuple[Array, Array]:
    """Map (m + 6, m + 6) of the true states and of the sums of the axis errors over so many samples, and the root of the noise that it adds."""
    C, m = truth.output(), truth.m
    step = np.block([[truth.Phi, np.zeros((m, 6))], [C @ truth.Phi, np.eye(6)]])
    cross = C @ truth.Q
    Q = np.block([[truth.Q, cross.T], [cross, cross @ C.T + np.diag(truth.white)]])
    transition, noise = np.eye(m + 6), np.zeros((m + 6, m + 6))
    while count:
        if count & 1:
            transition, noise = step @ transition, step @ noise @ step.T + Q
        step, Q = step @ step, step @ Q @ step.T + Q
        count >>= 1
    return transition, root_of(noise)


def root_of(covariance: Array) -> Array:
    """A matrix whose product with its transpose is the covariance, (n, rank)."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    some = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(some, some))
    kept = values > 1e-14 * max(values[-1], 1e-300) if values.size else values > 0
    return np.asarray(scale[:, None] * vectors[:, kept] * np.sqrt(values[kept]))
