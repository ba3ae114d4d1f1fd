"""A filter design held against a recorded baseline: accuracy and consistency, with a stated false-alarm rate.

A baseline keeps, per design, figures of every realization. New figures are compared by Student's t: paired where the same realizations
were flown again (the same seed), Welch's where the draws differ. All figures of all designs form one family (Bonferroni), so that an
unchanged design is reported with the stated probability. What the test can see is said too: the smallest change of each figure, and of each
parameter of a belief, that it finds with 80 % probability.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.evaluate.experiment import Experiment
from insemu.evaluate.results import Results
from insemu.evaluate.running import Resources, run_experiment
from insemu.filters import FilterParts
from insemu.noise import NoiseModel
from insemu.whole import put

Array = NDArray[np.float64]

#: Relative changes below this are taken as rounding or platform, not as a change of the design.
FLOOR = 1e-3
POWER = 0.8


def figures(results: Results, design: str) -> dict[str, Array]:
    """The figures that are held: one value per realization each.

    ``planimetric_end_m.k``, ``altimetric_end_m.k``, ``attitude_end_rad.k`` and ``stated_sigma_end_m.k`` at the end of outage k, and
    ``stated_sigma_heading_rad``, ``nis_per_dof`` and ``log_nees`` over the whole run.
    """
    d = results.names.index(design)
    runs = {name: values[d] for name, values in results.total.runs.items()}
    out: dict[str, Array] = {}
    for k in range(len(results.outages)):
        e, s = runs["end_error"][:, k], runs["end_sigma"][:, k]
        out[f"planimetric_end_m.{k + 1}"] = np.hypot(e[:, 0], e[:, 1])
        out[f"altimetric_end_m.{k + 1}"] = np.abs(e[:, 2])
        out[f"attitude_end_rad.{k + 1}"] = np.linalg.norm(e[:, 6:9], axis=-1)
        out[f"stated_sigma_end_m.{k + 1}"] = np.hypot(s[:, 0], s[:, 1])
    out["stated_sigma_position_m"] = runs["stated_position"]
    out["stated_sigma_heading_rad"] = runs["stated_heading"]
    out["nis_per_dof"] = np.asarray(results.nis[d])
    out["log_nees"] = runs["log_nees"]
    return out


@dataclass(frozen=True)
class Baseline:
    """Figures of an accepted version.

    Parameters
    ----------
    scenario, digest : str
        What was flown.
    seed : int
    figures : mapping of design to (mapping of figure to (realizations,) array)
    """

    scenario: str
    digest: str
    seed: int
    figures: Mapping[str, Mapping[str, Array]]

    @classmethod
    def of(cls, results: Results) -> Baseline:
        """The baseline that these results make."""
        return cls(results.title, results.digest, results.seed, {d: figures(results, d) for d in results.names})

    def write(self, path: str | Path) -> None:
        """Write as JSON."""
        document = {
            "insemu_baseline": 1,
            "scenario": self.scenario,
            "digest": self.digest,
            "seed": self.seed,
            "figures": {d: {k: v.tolist() for k, v in f.items()} for d, f in self.figures.items()},
        }
        put(path, json.dumps(document, indent=1) + "\n")

    @classmethod
    def read(cls, path: str | Path) -> Baseline:
        """Read what :meth:`write` wrote.

        Raises
        ------
        InputError
            Not such a file.
        """
        try:
            d = json.loads(Path(path).read_text(encoding="utf-8"))
            held = {n: {k: np.array(v, dtype=np.float64) for k, v in f.items()} for n, f in d["figures"].items()}
            return cls(str(d["scenario"]), str(d["digest"]), int(d["seed"]), held)
        except (json.JSONDecodeError, UnicodeDecodeError, KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(f"not a baseline written by insemu regress record ({error})", where=str(path)) from None


@dataclass(frozen=True)
class Change:
    """One figure of one design, then and now.

    Parameters
    ----------
    design, figure : str
    before, now : float
        Means over realizations.
    t, threshold : float
        Student's statistic and what it had to exceed.
    detectable : float
        Smallest change of the mean that is found with 80 % probability.
    """

    design: str
    figure: str
    before: float
    now: float
    t: float
    threshold: float
    detectable: float

    @property
    def significant(self) -> bool:
        """Whether the change is larger than chance (and than rounding)."""
        return abs(self.t) > self.threshold and abs(self.now - self.before) > FLOOR * abs(self.before)

    def __str__(self) -> str:
        part = (self.now / self.before - 1.0) * 100 if self.before else math.nan
        return (
            f"{self.design}: {self.figure} was {self.before:.4g}, is {self.now:.4g} ({part:+.2g} %; t = {self.t:.1f}, allowed "
            f"{self.threshold:.1f})"
        )


def check(results: Results, baseline: Baseline, *, false_alarm: float = 0.01) -> list[Change]:
    """Compare results with a baseline, figure by figure.

    Parameters
    ----------
    results : Results
    baseline : Baseline
    false_alarm : float
        Probability that an unchanged set of designs is reported at all.

    Returns
    -------
    list of Change
        All figures; the significant ones are regressions (or improvements: both are changes that want a new baseline).

    Raises
    ------
    InputError
        A design or an outage of the baseline that the results do not have, fewer than two realizations.
    """
    if not 0.0 < false_alarm < 1.0:
        raise InputError(f"false_alarm is {false_alarm!r}, expected a probability between 0 and 1")
    now = {d: figures(results, d) for d in results.names}
    missing = [d for d in baseline.figures if d not in now]
    if missing:
        raise InputError(f"the baseline has the design '{missing[0]}', the scenario has: {', '.join(now)}")
    count = sum(len(f) for f in baseline.figures.values())
    out = []
    for design, held in baseline.figures.items():
        for name, before in held.items():
            if name not in now[design]:
                raise InputError(f"the baseline has the figure '{name}' of '{design}', the results do not")
            after = now[design][name]
            if min(before.size, after.size) < 2:
                raise InputError("a baseline needs at least two realizations")
            paired = baseline.seed == results.seed and before.size == after.size
            if paired:
                d = after - before
                error, dof = float(d.std(ddof=1) / math.sqrt(d.size)), float(d.size - 1)
            else:
                va, vb = after.var(ddof=1) / after.size, before.var(ddof=1) / before.size
                error = float(math.sqrt(va + vb))
                dof = float((va + vb) ** 2 / max(va**2 / (after.size - 1) + vb**2 / (before.size - 1), 1e-300)) or 1.0
            # a t distribution with few degrees of freedom, or a spread near zero: never less than the floor's own scale
            error = max(error, 1e-12 * abs(float(before.mean())), 1e-300)
            threshold = -float(scipy.special.stdtrit(max(dof, 1.0), 0.5 * false_alarm / count))
            gap = float(after.mean() - before.mean())
            detectable = max(
                (threshold + float(scipy.special.stdtrit(max(dof, 1.0), POWER))) * error,
                FLOOR * abs(float(before.mean())),
            )
            out.append(
                Change(design, name, float(before.mean()), float(after.mean()), gap / error, threshold, detectable)
            )
    return out


# -- what the test can see ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Alteration:
    """One parameter of what a filter believes, multiplied.

    Parameters
    ----------
    triad : str
        ``gyro``, ``accel`` or ``gnss``.
    parameter : str
        ``WN1.N``, ``GM1.sigma``, ... of a triad; ``position`` or ``velocity`` of GNSS.
    factor : float
    """

    triad: str
    parameter: str
    factor: float

    def __str__(self) -> str:
        return f"{self.triad} {self.parameter}"

    def belief(self, models: Mapping[str, NoiseModel]) -> dict[str, NoiseModel]:
        """The belief with the parameter multiplied on every axis of the triad."""
        out = dict(models)
        for axis in out:
            if axis.startswith(self.triad):
                parts = []
                for index, p in models[axis].indexed():
                    symbol, _, name = self.parameter.partition(".")
                    hit = symbol == f"{p.symbol}{index}" and name in p.parameters
                    parts.append(p.with_parameters({name: p.parameters[name] * self.factor}) if hit else p)
                out[axis] = NoiseModel(tuple(parts))
        return out


class AlteredExperiment(Experiment):
    """An experiment whose designs believe something slightly wrong; the world stays as it is."""

    def __init__(self, original: Experiment, alteration: Alteration) -> None:
        self.__dict__.update(original.__dict__)
        self._alteration = alteration
        self.__dict__["beliefs"] = original.beliefs  # fitted once
        self._held = {}  # filters of the original believe what it does

    def altered(self, design: str, parts: FilterParts) -> FilterParts:
        """What a filter is made of, altered."""
        a = self._alteration
        position, velocity = parts.gnss_sigma
        if a.triad == "gnss":
            position = position * (a.factor if a.parameter == "position" else 1.0)
            velocity = velocity * (a.factor if a.parameter == "velocity" else 1.0)
        return replace(
            parts,
            belief=a.belief(parts.belief),
            gnss_sigma=(position, velocity),
            options=replace(parts.options, imposed_gnss_sigma=a.triad == "gnss"),
        )


def alterations(experiment: Experiment, design: str, factor: float) -> list[Alteration]:
    """Every parameter of a design's belief, and the GNSS sigmas, multiplied by a factor.

    Parameters
    ----------
    experiment : Experiment
    design : str
    factor : float
    """
    out: list[Alteration] = []
    models = experiment.beliefs[design].models
    for triad in ("gyro", "accel"):
        seen: list[str] = []
        for axis in models:
            if axis.startswith(triad):
                for index, p in models[axis].indexed():
                    if p.symbol not in ("AR", "ARMA", "MA"):
                        seen += [f"{p.symbol}{index}.{name}" for name, value in p.parameters.items() if value]
        out += [Alteration(triad, name, factor) for name in dict.fromkeys(seen) if not name.endswith(".phi")]
    out.append(Alteration("gnss", "position", factor))
    if experiment.scenario.gnss.velocity_sigma is not None:
        out.append(Alteration("gnss", "velocity", factor))
    return out


#: Relative change of a parameter that is tried.
TRIED = 0.1


def smallest_detectable(
    experiment: Experiment,
    baseline: Baseline,
    design: str,
    *,
    false_alarm: float = 0.01,
    workers: int = 1,
) -> dict[str, float]:
    """Smallest relative change of each believed parameter that a check with other draws finds with 80 % probability.

    Each parameter is changed by a tenth over two realizations; what that does to the figures is compared with what each figure can
    show, and taken as linear.

    Parameters
    ----------
    experiment : Experiment
    baseline : Baseline
    design : str
    false_alarm : float
        Of the check, for all figures together.
    workers : int

    Returns
    -------
    dict of parameter to relative change
        ``inf`` where no figure moves.
    """
    count = sum(len(f) for f in baseline.figures.values())
    held = baseline.figures[design]
    plain = figures(run_experiment(experiment, realizations=2, resources=Resources(workers=workers)), design)
    out = {}
    for a in alterations(experiment, design, 1.0 + TRIED):
        moved = figures(
            run_experiment(AlteredExperiment(experiment, a), realizations=2, resources=Resources(workers=workers)),
            design,
        )
        best = math.inf
        for name, before in held.items():
            n = before.size
            error = float(before.std(ddof=1)) * math.sqrt(2.0 / n)
            visible = (
                float(scipy.special.ndtri(POWER)) - float(scipy.special.stdtrit(2 * n - 2, 0.5 * false_alarm / count))
            ) * error
            visible = max(visible, FLOOR * abs(float(before.mean())))
            shift = abs(float((moved[name] - plain[name]).mean()))
            if shift > 1e-9 * abs(float(before.mean())):
                best = min(best, TRIED * visible / shift)
        out[str(a)] = best
    return out


def assert_unchanged(
    scenario: str | Path, baseline: str | Path, *, false_alarm: float = 0.01, workers: int = 1
) -> None:
    """Fly a scenario and fail, with a readable difference, where its designs changed against a baseline; for use in pytest.

    Parameters
    ----------
    scenario, baseline : path
    false_alarm : float
        Probability that an unchanged set of designs is reported at all.
    workers : int

    Raises
    ------
    AssertionError
        A figure changed by more than chance.
    InputError
        See :func:`check`.
    """
    from insemu.scenario import load

    held = Baseline.read(baseline)
    results = run_experiment(Experiment(load(str(scenario)), str(scenario)), resources=Resources(workers=workers))
    changed = [c for c in check(results, held, false_alarm=false_alarm) if c.significant]
    if changed:
        raise AssertionError("the designs changed against the baseline:\n" + "\n".join(f"  {c}" for c in changed))


def trial(
    make: Any,
    baseline: Baseline,
    cases: Sequence[Alteration | None],
    trials: int,
    *,
    false_alarm: float = 0.01,
    workers: int = 1,
) -> dict[str, int]:
    """How often each case is reported, flown with other draws each time.

    Parameters
    ----------
    make : callable
        ``make(seed) -> Experiment``.
    baseline : Baseline
    cases : sequence of Alteration or None
        None: nothing altered, only other draws.
    trials : int

    Returns
    -------
    dict of case to number of trials in which a change was reported
    """
    out: dict[str, int] = {}
    for number in range(trials):
        original = make(baseline.seed + 1 + number)
        for case in cases:
            flown = original if case is None else AlteredExperiment(original, case)
            results = run_experiment(flown, resources=Resources(workers=workers))
            label = "other draws" if case is None else f"{case} x {case.factor:g}"
            caught = any(c.significant for c in check(results, baseline, false_alarm=false_alarm))
            out[label] = out.get(label, 0) + caught
    return out
