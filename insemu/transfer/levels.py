"""Factors on a few noise levels that maximise the likelihood of the innovations of a drive."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from insemu.augment import Extras, augment, with_turn_on
from insemu.errors import InputError
from insemu.filters import (
    FilterOptions,
    FilterResult,
    FixTable,
    InitialSigma,
    Innovations,
    LooselyCoupledEKF,
    likeliest,
    uncertainty,
)
from insemu.noise import NoiseModel, Process
from insemu.records import AXES, GnssRecord, ImuRecord
from insemu.strapdown import NavState

Array = NDArray[np.float64]

#: 95 % of static levels are right to this factor before a drive is seen: the prior of every factor is log-normal around 1.
PRIOR_FACTOR = 10.0
#: An interval wider than this from end to end says nothing that a choice could rest on.
TOO_WIDE = 10.0
#: A factor nearer to 1 than this has no reasons to be looked for.
WORTH_REASONS = 1.5
#: Stamps this near to each other are the same, s.
SAME_S = 1e-3
#: Seconds between updates of the covariance.
COVARIANCE_S = 0.05


@dataclass(frozen=True)
class Factor:
    """One level: the factor on it with its 95 % interval, and whether the drive tells it."""

    name: str
    value: float
    low: float
    high: float

    @property
    def decisive(self) -> bool:
        """Whether the interval is narrow enough to rest a choice on."""
        return self.high <= TOO_WIDE * self.low

    @property
    def asks(self) -> bool:
        """Whether there is something to explain: a factor with a narrow interval, far from 1, and not 1 by its interval."""
        far = max(self.value, 1.0 / self.value) > WORTH_REASONS
        return self.decisive and far and not self.low <= 1.0 <= self.high


@dataclass(frozen=True)
class Constant:
    """One constant of the IMU, estimated with the factors: its value with standard deviations after and before the drive (SI)."""

    name: str
    value: float
    sigma: float
    before: float


@dataclass(frozen=True)
class Levels:
    """A drive, a belief, and the run of a filter for any factors on the belief's levels.

    Parameters
    ----------
    imu, gnss : ImuRecord, GnssRecord
        From the filter's start; the fixes with standard deviations.
    start : (NavState, InitialSigma)
    beliefs : mapping of axis to NoiseModel
        Static models of the six axes.
    lever_arm : (3,) array
        m, body axes.
    extras : Extras
        Constants of the IMU that the filter estimates beside: the likelihood of the factors is then that of noise and constants together.
    """

    imu: ImuRecord
    gnss: GnssRecord
    start: tuple[NavState, InitialSigma]
    beliefs: dict[str, NoiseModel]
    lever_arm: Array
    extras: Extras = field(default_factory=Extras)

    def __post_init__(self) -> None:
        if missing := [a for a in AXES if a not in self.beliefs]:
            raise InputError(f"no noise model of {', '.join(missing)}, expected one for each of the six axes")
        object.__setattr__(self, "beliefs", with_turn_on(self.beliefs))

    @property
    def names(self) -> tuple[str, ...]:
        """The levels that have a factor: white and slow noise and turn-on bias of each sensor where there are any, and the fixes' sigmas."""
        found = [name for sensor in ("gyro", "accel") for name in self._groups(sensor)]
        return (*found, "fixes position", *(("fixes velocity",) if self.gnss.vel_std_ned is not None else ()))

    def _groups(self, sensor: str) -> list[str]:
        kinds = [self._kind(p) for a in AXES if a.startswith(sensor) for p in self.beliefs[a]]
        return [f"{sensor} {kind}" for kind in ("white", "slow", "turn-on") if kind in kinds]

    def _kind(self, process: Process) -> str:
        if process.single_draw:
            return "turn-on"
        return "slow" if process.remembers(self.imu.dt) else "white"

    def thinned(self, interval: float) -> Levels:
        """The same with fixes at least ``interval`` s apart: errors of fixes that last for seconds are then nearly independent."""
        t = self.gnss.t
        kept, last = np.zeros(t.size, dtype=bool), -math.inf
        for k in range(t.size):
            if t[k] - last >= interval - SAME_S:
                kept[k], last = True, t[k]
        return replace(self, gnss=self.gnss.rows(kept))

    def scaled(self, factors: Sequence[float]) -> dict[str, NoiseModel]:
        """The belief with factors on its levels, in the order of :attr:`names`."""
        by = dict(zip(self.names, factors, strict=True))
        return {
            axis: NoiseModel(tuple(p.scaled(by[f"{axis.partition('_')[0]} {self._kind(p)}"]) for p in model))
            for axis, model in self.beliefs.items()
        }

    def fixes(self, factors: Sequence[float], withheld: NDArray[np.bool_] | None = None) -> FixTable:
        """Innovations of the filter with factors on its levels.

        Parameters
        ----------
        factors : sequence of float
            In the order of :attr:`names`.
        withheld : (f,) array of bool, optional
            Fixes that the filter does not get.
        """
        return self._run(factors, withheld).fixes

    def constants(self, factors: Sequence[float]) -> tuple[Constant, ...]:
        """The constants of :attr:`extras` at the end of the drive, with factors on the levels in the order of :attr:`names`."""
        run, P0 = self._run(factors, None), self._filter(factors).augmentation.P0
        noise = augment(self.beliefs, self.imu.dt).layout.names
        own = [k for k, name in enumerate(run.layout.names) if name not in noise]
        return tuple(
            Constant(
                run.layout.names[k],
                float(run.imu_states[-1, k - 9]),
                float(run.sigma[-1, k]),
                math.sqrt(P0[k - 9, k - 9]),
            )
            for k in own
        )

    def _filter(self, factors: Sequence[float]) -> LooselyCoupledEKF:
        every = max(1, round(COVARIANCE_S / self.imu.dt))
        rows = every * max(1, len(self.imu) // every)
        options = FilterOptions(covariance_every=every, output_every=rows, extras=self.extras)
        return LooselyCoupledEKF(self.scaled(factors), self.imu.dt, lever_arm=self.lever_arm, options=options)

    def _run(self, factors: Sequence[float], withheld: NDArray[np.bool_] | None) -> FilterResult:
        """The filter with factors on its levels, as :meth:`fixes` takes them."""
        by = dict(zip(self.names, factors, strict=True))
        gnss = self.gnss
        if gnss.pos_std_ned is not None:
            gnss = replace(gnss, pos_std_ned=gnss.pos_std_ned * by["fixes position"])
        if gnss.vel_std_ned is not None:
            gnss = replace(gnss, vel_std_ned=gnss.vel_std_ned * by["fixes velocity"])
        if withheld is not None:
            gnss = gnss.rows(~withheld)
        return self._filter(factors).run(self.imu, gnss, *self.start)


@dataclass(frozen=True)
class Estimate:
    """Log factors with their covariance, and the log posterior there."""

    names: tuple[str, ...]
    log: Array
    covariance: Array
    value: float

    @property
    def factors(self) -> tuple[Factor, ...]:
        """The factors with 95 % intervals."""
        half = 1.96 * np.sqrt(np.diag(self.covariance))
        return tuple(
            Factor(name, math.exp(x), math.exp(x - h), math.exp(x + h))
            for name, x, h in zip(self.names, self.log.tolist(), half.tolist(), strict=True)
        )


def estimated(levels: Levels, scored: Sequence[tuple[float, float]] = (), at: Array | None = None) -> Estimate:
    """The most likely factors under log-normal priors around the static levels, by Fisher scoring.

    Parameters
    ----------
    levels : Levels
    scored : sequence of (from, to)
        Spans in s whose fixes count, all where there are none; the filter uses every fix.
    at : (p,) array, optional
        Log factors to begin at.

    Returns
    -------
    Estimate
        With the covariance of :func:`insemu.filters.uncertainty`.

    Raises
    ------
    InputError
        No fix in the spans.
    """
    sd = math.log(PRIOR_FACTOR) / 1.96

    def run(log: Array) -> Innovations:
        table = Innovations.of(levels.fixes(np.exp(log).tolist()))
        inside = np.full(table.t.size, not scored)
        for start, end in scored:
            inside |= (table.t >= start) & (table.t < end)
        if not inside.any():
            raise InputError(f"has no fix in the spans that are scored, from {scored[0][0]:g} s")
        return table.rows(inside)

    found = likeliest(run, np.zeros(len(levels.names)) if at is None else np.array(at), sd)
    return Estimate(levels.names, found.x, uncertainty(run, found, sd), found.value)
