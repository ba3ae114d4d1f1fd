"""Designs compared: paired under common random numbers, or by covariance analysis without drawing anything."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from insemu.errors import InputError, nearest
from insemu.evaluate.covariance import CovarianceAnalysis, analyse
from insemu.evaluate.errors import paired_ratio
from insemu.evaluate.experiment import Experiment
from insemu.evaluate.results import Results
from insemu.evaluate.world import World
from insemu.filters import InitialSigma
from insemu.scenario import Scenario
from insemu.strapdown import NavState


@dataclass(frozen=True)
class ComparisonRow:
    """One design at the end of one outage, beside the base.

    Parameters
    ----------
    outage : int or None
        From 1; None: all outages pooled.
    design : str
    rank : int
        By the mean, 1 is the smallest error.
    mean_m : float
        Mean planimetric error over realizations.
    ratio, low, high, p_value : float
        Mean over the base's mean, its 95 % bootstrap interval over paired realizations, and the p-value of equal means; None for the base
        itself or a single realization.
    effect_size : float or None
        Mean of the paired differences over their standard deviation: 0.2 small, 0.8 large.
    """

    outage: int | None
    design: str
    rank: int
    mean_m: float
    ratio: float | None
    low: float | None
    high: float | None
    p_value: float | None
    effect_size: float | None

    def to_dict(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


def with_designs(scenario: Scenario, designs: Sequence[str]) -> Scenario:
    """The scenario with these designs only, in this order.

    Raises
    ------
    InputError
        A design that the scenario does not have.
    """
    for name in designs:
        if name not in scenario.designs:
            raise InputError(f"no design '{name}'" + nearest(name, scenario.designs), where="--designs")
    if not designs:
        return scenario
    return scenario.model_copy(update={"designs": {name: scenario.designs[name] for name in designs}})


def compare(results: Results, base: str | None = None) -> list[ComparisonRow]:
    """Compare all designs of an experiment, at the end of every outage and pooled.

    Parameters
    ----------
    results : Results
        All designs flew the same data.
    base : str, optional
        Design that the others are measured against; the first unless given.
    """
    base = base or results.names[0]
    if base not in results.designs:
        raise InputError(f"no design '{base}'" + nearest(base, results.names), where="--base")
    rows = []
    for outage in [*range(len(results.outages)), None]:
        values = {
            name: results.pooled_end(name)
            if outage is None
            else results.planimetric(name)[:, results.end_index(outage)]
            for name in results.names
        }
        order = sorted(values, key=lambda name: float(values[name].mean()))
        for name in results.names:
            v, b = values[name], values[base]
            pair = None if name == base else paired_ratio(v, b)
            spread = float((v - b).std(ddof=1)) if v.size > 1 else 0.0
            rows.append(
                ComparisonRow(
                    None if outage is None else outage + 1,
                    name,
                    order.index(name) + 1,
                    float(v.mean()),
                    pair.ratio if pair else None,
                    pair.low if pair else None,
                    pair.high if pair else None,
                    pair.p_value if pair else None,
                    float((v - b).mean() / spread) if pair and spread > 0 else None,
                )
            )
    return rows


def analyse_designs(
    experiment: Experiment, states: Sequence[str] = ("pos_n", "pos_e")
) -> dict[str, CovarianceAnalysis]:
    """Covariance analysis of every design of a scenario, with an error budget at the end of every outage.

    Raises
    ------
    InputError
        The truth is recorded or has deterministic effects: there is no covariance to propagate.
    """
    s, world = experiment.scenario, experiment.world
    where = str(experiment.file or "scenario")
    if not isinstance(world, World) or s.truth is None:
        raise InputError("found a recording; the analysis needs an emulated world and its truth", where=where)
    if s.truth.recorded is not None or s.truth.uses():
        raise InputError(
            "found a recorded truth or deterministic effects; the analysis needs noise models only", where=where
        )
    fixes = world.recording(0, ideal=True).gnss
    assert fixes is not None
    i = s.initial
    sigma = InitialSigma(i.position_sigma, i.velocity_sigma, (i.tilt_sigma, i.tilt_sigma, i.heading_sigma))
    ends = [start + duration for start, duration in world.outage_windows]
    plain = type(fixes)(fixes.t, fixes.llh, fixes.vel_ned)  # the filter's own sigmas, not those of perfect fixes
    truth = {axis: m.at_rate(experiment.rate_hz) for axis, m in s.truth.models().items()}
    start = NavState.of(world.reference)
    times = tuple(world.output_times)
    return {
        name: analyse(
            experiment.filter(name),
            truth,
            world.imu,
            plain,
            start,
            sigma,
            at=times,
            budget_at=ends,
            budget_states=states,
        )
        for name in experiment.beliefs
    }


def horizontal_rms(analysis: CovarianceAnalysis) -> np.ndarray:
    """True rms horizontal error over time, m: (o,)."""
    return np.asarray(np.sqrt(analysis.rms[:, 0] ** 2 + analysis.rms[:, 1] ** 2))
