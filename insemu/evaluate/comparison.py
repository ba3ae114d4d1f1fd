"""Designs compared: paired under common random numbers, or by covariance analysis without drawing anything."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from insemu.covariates import needed
from insemu.errors import InputError, found_at, nearest
from insemu.evaluate.covariance import CovarianceAnalysis, analyse
from insemu.evaluate.emulated import EmulatedWorld
from insemu.evaluate.errors import PairedComparison, paired_ratio
from insemu.evaluate.experiment import Experiment
from insemu.evaluate.results import Results
from insemu.evaluate.stretched import StretchedWorld
from insemu.filters import LooselyCoupledEKF
from insemu.scenario import Design, Scenario, shipped_designs
from insemu.strapdown import NavState
from insemu.work import run_items


@dataclass(frozen=True)
class ComparisonRow:
    """One design at the end of one outage, together with the base.

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
    one_run : float or None
        Standard deviation of the paired differences over the base's mean: how far the ratio of a single run scatters.
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
    one_run: float | None

    @property
    def pair(self) -> PairedComparison | None:
        """The comparison with the base; None for the base itself."""
        return None if self.ratio is None else PairedComparison(self.ratio, self.low, self.high, self.p_value)

    def to_dict(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


def with_designs(scenario: Scenario, designs: Sequence[str]) -> Scenario:
    """The scenario with these designs only, in this order: its own, or else those that come with insemu.

    Raises
    ------
    InputError
        A design that neither has, or one that the scenario lacks the signals for.
    """
    if not designs:
        return scenario
    chosen = {}
    for name in designs:
        if name not in scenario.designs and name not in shipped_designs():
            raise InputError(
                f"no design '{name}'" + nearest(name, [*scenario.designs, *shipped_designs()]), where="--designs"
            )
        chosen[name] = scenario.designs.get(name) or Design.model_validate(name)
        with found_at("--designs"):
            scenario.check_design(name, chosen[name])
    return scenario.model_copy(update={"designs": chosen})


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
            name: results.pooled_end(name) if outage is None else results.planimetric_ends(name)[:, outage]
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
                    spread / float(b.mean()) if pair and v.size > 1 else None,
                )
            )
    return rows


def analysable(experiment: Experiment, *, removes_means: bool = False) -> tuple[list[str], str]:
    """Designs of which a covariance analysis can be made; and, in words, why not of the others and what it leaves out (empty: nothing).

    Parameters
    ----------
    experiment : Experiment
    removes_means : bool
        Whether the analysis takes the mean off the records as the emulator does.
    """
    s = experiment.scenario
    if not isinstance(experiment.world, EmulatedWorld) or s.truth is None:
        return [], "found a recording; the analysis needs an emulated world and its truth"
    if isinstance(experiment.world, StretchedWorld):
        return [], "found a flight that is flown in stretches; the analysis needs it as a whole"
    if s.truth.recorded is not None or s.truth.effects:
        return [], "found a recorded truth or deterministic effects; the analysis needs noise models only"
    if needed(s.truth.models().values()):
        return [], "found a truth whose levels follow a covariate; the analysis needs constant ones"
    if s.aids:
        return [], "found aids; the analysis knows no measurement but the fixes"
    able: list[str] = []
    left_out: dict[str, str] = {}
    for name, design in s.designs.items():
        made = experiment.filter(name)
        if not isinstance(made, LooselyCoupledEKF) or not made.first_order:
            left_out[name] = f"the filter {design.filter}"
        elif design.options.prefilter is not None:
            left_out[name] = "a prefilter"
        elif made.augmentation.laws:
            left_out[name] = "levels that follow a covariate"
        elif made.augmentation.thermal:
            left_out[name] = "states that follow the temperature"
        else:
            able.append(name)
    notes = []
    if left_out:
        notes.append("left out: " + ", ".join(f"{name} ({why})" for name, why in left_out.items()))
    gated = [name for name in able if s.designs[name].options.gate is not None]
    if gated:
        notes.append(f"the gate of {', '.join(gated)} plays no part: the analysis takes every fix")
    if s.truth.spread:
        notes.append("the spread between sensors (truth.spread) is no part of the analysis")
    if s.truth.record is not None and not removes_means:
        notes.append("the mean removed from the records (truth.record) is no part of the analysis")
    return able, "; ".join(notes)


def analyse_designs(experiment: Experiment, *, workers: int = 1) -> dict[str, CovarianceAnalysis]:
    """Covariance analysis of every design that allows it, with an error budget at the end of every outage.

    Parameters
    ----------
    experiment : Experiment
    workers : int
        Threads: the compiled loops free the GIL.

    Raises
    ------
    InputError
        The truth is recorded or has deterministic effects, or no design allows it.
    """
    able, reason = analysable(experiment)
    if not able:
        raise InputError(reason, where=str(experiment.file or "scenario"))
    s, world = experiment.scenario, experiment.world
    assert isinstance(world, EmulatedWorld) and s.truth is not None
    fixes = world.recording(0, ideal=True).gnss
    assert fixes is not None
    ends = [start + duration for start, duration in world.outage_windows]
    plain = type(fixes)(fixes.t, fixes.llh, fixes.vel_ned)  # the filter's own sigmas, not those of perfect fixes
    truth = {axis: m.at_rate(experiment.rate_hz) for axis, m in s.truth.models().items()}

    def analysed(name: str) -> CovarianceAnalysis:
        return analyse(
            experiment.ekf(name),
            truth,
            world.imu,
            plain,
            NavState.of(world.reference),
            s.initial.sigma,
            true_gnss_sigma=(s.gnss.position_sigma, s.gnss.velocity_sigma or (0.0, 0.0, 0.0)),
            at=tuple(world.output_times),
            budget_at=ends,
            budget_states=("pos_n", "pos_e"),
        )

    with ThreadPoolExecutor(max_workers=max(1, workers)) as pool:
        return run_items({name: name for name in able}, analysed, pool=pool)


def outage_budgets(
    analyses: Mapping[str, CovarianceAnalysis], windows: Sequence[tuple[float, float]], by: str = "process"
) -> dict[str, list[dict[str, Any]]]:
    """Error budgets as plain data: per design and outage ``start_s, duration_s, rms_m, predicted_sigma_m`` and ``parts_rms_m``.

    The parts add up as squares to ``rms_m``.

    Parameters
    ----------
    analyses : mapping of design to CovarianceAnalysis
    windows : sequence of (start_s, duration_s)
        The outages, each with a budget at its end.
    by : {"process", "axis", "source"}
        What the parts are.
    """
    out: dict[str, list[dict[str, Any]]] = {}
    for name, a in analyses.items():
        out[name] = []
        for budget, (start, duration) in zip(a.budgets, windows, strict=True):
            at = int(np.argmin(np.abs(a.t - budget.t)))
            out[name].append(
                {
                    "start_s": start,
                    "duration_s": duration,
                    "rms_m": budget.rms(),
                    "predicted_sigma_m": float(np.hypot(a.sigma[at, 0], a.sigma[at, 1])),
                    "parts_rms_m": {key: float(np.sqrt(value)) for key, value in budget.shares(by).items()},
                }
            )
    return out
