"""What a filter gave in one world: errors against what it states, realization by realization."""

from __future__ import annotations

import math
import shutil
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.evaluate import ALONE, EmulatedWorld, Experiment, Resources, chi_square_bounds, fly
from insemu.filters import NotYet
from insemu.strapdown import NavState

Array = NDArray[np.float64]
#: What foreign code may raise on data that it cannot filter; anything else is an error of the program, not a finding.
FAILS = (InputError, ArithmeticError, ValueError, RuntimeError, np.linalg.LinAlgError)


@dataclass(frozen=True)
class Flights:
    """Realizations of one filter in one world, without those in which it failed.

    Parameters
    ----------
    experiment : Experiment
    t : (o,) array
        Epochs at which it was judged, s.
    error, sigma : (r, o, 9) arrays
        Navigation errors and their stated standard deviations.
    nees : (r, o, 4) array
        Per degree of freedom: all nine, position, velocity, attitude.
    nis, dof : float, int
        Sum of normalised innovations squared over all realizations, and its degrees of freedom.
    epochs : int
        Of one realization.
    failed : mapping of realization to str
        What it said.
    pending : int
        Realizations whose estimates another program has yet to make.
    """

    experiment: Experiment
    t: Array
    error: Array
    sigma: Array
    nees: Array
    nis: float
    dof: int
    epochs: int
    failed: dict[int, str] = field(default_factory=dict)
    pending: int = 0

    @classmethod
    def of(cls, experiment: Experiment, count: int, resources: Resources = ALONE) -> Flights:
        """Fly realizations 0 to ``count``, or take them from where they are kept."""
        cache = resources.cache
        if cache is not None and len(list((cache / experiment.digest).glob("*"))) != count:
            # the rest alone would fly in other groups, and differ in the last digits
            shutil.rmtree(cache / experiment.digest, ignore_errors=True)
        failed: dict[int, str] = {}
        pending = 0
        try:
            items = list(fly(experiment, range(count), resources))
        except FAILS:  # one that fails hides the others
            items = []
            for k in range(count):
                try:
                    items.append(experiment.realization(k))
                except NotYet:
                    pending += 1
                except FAILS as error:
                    failed[k] = str(error)
        t = experiment.world.output_times
        arrays = [{str(k): v.to_numpy()[0] for k, v in item.data_vars.items()} for item in items]

        def stacked(name: str, *shape: int) -> Array:
            return np.stack([a[name] for a in arrays]) if arrays else np.empty((0, *shape))

        blocks = np.moveaxis(stacked("block_nees", 3, t.size)[:, :3], 1, 2)
        nees = np.concatenate([stacked("nees", t.size)[..., None] / 9.0, blocks], axis=2)
        return cls(
            experiment,
            t,
            stacked("error", t.size, 9),
            stacked("sigma", t.size, 9),
            nees,
            float(sum(a["nis"] for a in arrays)),
            int(sum(a["dof"] for a in arrays)),
            max((int(a["epochs"]) for a in arrays), default=0),
            failed,
            pending,
        )

    @property
    def runs(self) -> int:
        """Realizations in which the filter gave an estimate."""
        return len(self.error)

    def row(self, when: float) -> int:
        """The epoch nearest to a time."""
        return int(np.argmin(np.abs(self.t - when)))


@dataclass(frozen=True)
class Drift:
    """Horizontal error at the end of an outage, against the bound.

    Parameters
    ----------
    start, duration : float
        s.
    rms, bound : float
        Root mean square, and the least that any filter reaches, m.
    ratio, low, high : float
        Size of the errors in units of the bound, ``sqrt(mean of e' B^-1 e / 2)``, with the exact interval where errors are a multiple of it.
    """

    start: float
    duration: float
    rms: float
    bound: float
    ratio: float
    low: float
    high: float


def drifts(flights: Flights, bound: Experiment, confidence: float = 0.95) -> list[Drift]:
    """Errors at the end of every outage against the posterior Cramér-Rao bound.

    The covariance of the filter that knows the noise, linearized along the true motion, is the bound of the linear problem (Tichavský et al.
    1998).

    Parameters
    ----------
    flights : Flights
    bound : Experiment
        Of the same world, whose design is the extended Kalman filter.
    confidence : float
        Of the intervals.
    """
    world = bound.world
    if not world.outage_windows or not flights.runs:
        return []
    assert isinstance(world, EmulatedWorld)
    ends = np.array([start + duration for start, duration in world.outage_windows])
    ideal = world.recording(0, ideal=True)
    assert ideal.gnss is not None
    fixes = type(ideal.gnss)(
        ideal.gnss.t, ideal.gnss.llh, ideal.gnss.vel_ned
    )  # the filter's sigmas, not those of perfect fixes
    known = bound.filter("filter", covariance_at=ends)
    run = known.run(ideal.imu, fixes, NavState.of(world.reference), bound.scenario.initial.sigma)
    out, dof = [], 2 * flights.runs
    many, few = (dof / x for x in chi_square_bounds(0.5 * (1.0 - confidence), dof))
    for (start, duration), end in zip(world.outage_windows, ends, strict=True):
        B = run.covariance[np.argmin(np.abs(run.covariance_t - end)), :2, :2]
        e = flights.error[:, flights.row(end), :2]
        square = float(np.mean(np.einsum("ri,ri->r", e, np.linalg.solve(B, e.T).T))) / 2.0
        rms = math.sqrt(float(np.mean((e**2).sum(axis=1))))
        out.append(
            Drift(
                start, duration, rms, math.sqrt(float(np.trace(B))), *(math.sqrt(square * x) for x in (1.0, few, many))
            )
        )
    return out


def converged(flights: Flights, within: tuple[float, float, float]) -> int:
    """Realizations that end within limits of tilt, heading (rad) and horizontal position (m)."""
    last = np.abs(flights.error[:, -1])
    tilt, heading, position = within
    good = (last[:, 6:8].max(axis=1) < tilt) & (last[:, 8] < heading) & (np.hypot(last[:, 0], last[:, 1]) < position)
    return int(good.sum())


def cost(experiment: Experiment) -> float:
    """CPU seconds that an epoch takes, of one realization that was flown before; NaN where the filter fails on it."""
    recording, _ = experiment.world.realized(0)
    begun: Any = experiment.world.start(0, recording.imu)
    made = experiment.filter("filter", output_every=round(experiment.rate_hz))
    started = time.process_time()
    try:
        run = made.run(recording.imu, recording.gnss, *begun)
    except FAILS:
        return math.nan
    return (time.process_time() - started) / max(run.epochs, 1)
