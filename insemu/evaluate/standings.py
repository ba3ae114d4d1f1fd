"""The answer of an experiment in one sentence: which design to take, how far it drifts, and whether it knows its error."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from insemu.evaluate.consistency import nees_test
from insemu.evaluate.errors import bootstrap_mean
from insemu.evaluate.results import Results

#: A filter whose errors are within this factor of what it states knows its error, however many realizations could tell the difference.
MATERIAL = 1.1

Knows = Literal["yes", "optimistic", "pessimistic"]


@dataclass(frozen=True)
class Standing:
    """How one design did at the ends of the outages.

    Parameters
    ----------
    design : str
    states : int
    error_m : float
        Mean planimetric error at outage end over realizations and outages, m.
    low_m, high_m : float or None
        Its 95 % bootstrap interval; None for a single realization.
    stated_m : float
        Root mean square of the stated horizontal standard deviation there, m.
    knows : str
        ``yes``, ``optimistic`` (errors larger than stated) or ``pessimistic``, by NEES of the navigation states at the ends of all outages.
    factor : float
        Root-mean-square planimetric error there over what is stated.
    but : tuple of (float, float)
        Where ``knows`` is ``yes`` over all outages: outages (start, s) that contradict it by themselves, and there the root-mean-square error over
        what is stated. Certain at the level of the NEES test, and more than :data:`MATERIAL`.
    """

    design: str
    states: int
    error_m: float
    low_m: float | None
    high_m: float | None
    stated_m: float
    knows: Knows
    factor: float
    but: tuple[tuple[float, float], ...] = ()

    @property
    def interval(self) -> str:
        """The interval in words, empty for a single realization."""
        return "" if self.low_m is None or self.high_m is None else f"{self.low_m:.3g} to {self.high_m:.3g}"

    @property
    def exceptions(self) -> str:
        """Outages whose errors are not those that the design states, in words; empty where there are none."""
        if not self.but:
            return ""
        starts = [f"{start:g}" for start, _ in self.but]
        factors = [f"{factor:.2g}" for _, factor in self.but]
        return f" over all outages, but not after the outage at {' and '.join(starts)} s (errors {' and '.join(factors)} times the stated)"

    @property
    def verdict(self) -> str:
        """Whether the design knows its error, in words."""
        if self.knows == "yes":
            return f"knows its error{self.exceptions}"
        factor = self.factor if self.knows == "optimistic" else 1.0 / self.factor
        if factor < MATERIAL:
            return f"{self.knows}, though not in the horizontal position"
        return f"{self.knows} by a factor of {factor:.{1 if factor < 10 else 0}f}"


@dataclass(frozen=True)
class Answer:
    """What an experiment says.

    Parameters
    ----------
    sentence : str
    take : str
        The recommended design.
    standings : sequence of Standing
        In the order of the designs.
    """

    sentence: str
    take: str
    standings: Sequence[Standing]


def standings(results: Results) -> list[Standing]:
    """How every design did; empty without outages."""
    if not results.outages:
        return []
    ends = [results.end_index(k) for k in range(len(results.outages))]
    out = []
    for d, name in enumerate(results.names):
        pooled = bootstrap_mean(results.pooled_end(name))
        stated = math.sqrt(float(results.total.mean("sigma_square", d)[ends, :2].sum(axis=-1).mean()))
        values = results.total.runs["end_nees"][d]
        known = values[np.isfinite(values).all(axis=1)]
        factor = math.sqrt(float((results.planimetric_ends(name) ** 2).mean())) / stated
        states = results.designs[name].states
        knows, ratios = _knows(known, results.nees_dof)
        but = tuple((results.outages[k][0], ratio) for k, ratio in ratios.items())
        out.append(Standing(name, states, pooled.mean, pooled.low, pooled.high, stated, knows, factor, but))
    return out


def _knows(values: NDArray[np.float64], dof: int) -> tuple[Knows, dict[int, float]]:
    """Verdict on NEES values (realizations, epochs), which are scaled to nine states; where it is ``yes``, the epochs that contradict it."""
    if not values.size:
        return "yes", {}
    ratio = math.sqrt(float(values.mean()) / 9.0)
    tests = nees_test(values * dof / 9.0, dof)
    if all(v.passed for v in tests) or _is_small(ratio):
        each = {k: math.sqrt(v.value) for k, v in enumerate(tests) if not v.passed}
        return "yes", {k: factor for k, factor in each.items() if not _is_small(factor)}
    return "optimistic" if ratio > 1.0 else "pessimistic", {}


def _is_small(ratio: float) -> bool:
    """Whether errors are as stated up to :data:`MATERIAL`."""
    return 1.0 / MATERIAL <= ratio <= MATERIAL


def answer(results: Results) -> Answer | None:
    """Say which design to take; None without outages.

    Of the designs that know their error the one with the smallest planimetric error at outage end is taken; one with fewer states is
    preferred where the data show no difference. Where none knows its error, the smallest error is named with that warning.

    Parameters
    ----------
    results : Results
    """
    found = standings(results)
    if not found:
        return None
    honest = [s for s in found if s.knows == "yes"]
    best = min(honest or found, key=lambda s: s.error_m)
    for s in sorted(honest, key=lambda s: s.states):
        if (
            s.states < best.states
            and results.realizations > 1
            and not results.comparison(s.design, best.design).different
        ):
            best = s
            break
    duration = _durations(results)
    span = f" ({best.interval})" if best.interval else ""
    if len(found) == 1:
        sentence = f"{best.design}: {best.error_m:.3g} m {duration}{span}; "
        sentence += (
            f"it {best.verdict}." if best.knows == "yes" else f"it is {best.verdict} (states {best.stated_m:.3g} m)."
        )
        return Answer(sentence, best.design, found)
    if best.knows == "yes":
        sentence = f"Take {best.design}: {best.error_m:.3g} m {duration}{span}, and it {best.verdict};"
    else:
        sentence = f"No design knows its error. The smallest is {best.design}: {best.error_m:.3g} m {duration}{span}, stated {best.stated_m:.3g} m."
    others = [s for s in found if s is not best]
    worst = max(others, key=lambda s: (s.knows != "yes", s.error_m))
    if worst.knows == "yes":
        sentence += f" {worst.design} drifts {worst.error_m:.3g} m."
    else:
        sentence += f" {worst.design} drifts {worst.error_m:.3g} m and states {worst.stated_m:.3g}."
    return Answer(sentence, best.design, found)


def _durations(results: Results) -> str:
    """How long the outages are, and what they leave."""
    lengths = sorted({duration for _, duration in results.outages})
    span = f"{lengths[0]:g}" if len(lengths) == 1 else f"{lengths[0]:g} to {lengths[-1]:g}"
    return f"after {span} s {gnss_in_outages(results)}"


def gnss_in_outages(results: Results) -> str:
    """What the outages of the scenario leave of the satellites, for a sentence."""
    gnss = results.manifest.get("scenario", {}).get("gnss", {})
    kinds = {_satellites_in(outage) for outage in gnss.get("outages", ())}
    if gnss.get("areas") or gnss.get("random_outages"):
        kinds.add("")
    if not any(kinds):
        return "without GNSS"
    partly = f"with {' or '.join(sorted(kinds - {''}))} only"
    return f"without GNSS or {partly}" if "" in kinds else partly


def _satellites_in(outage: Mapping[str, Any]) -> str:
    """The satellites that one outage leaves; nothing of a total one."""
    count, sectors = outage.get("satellites"), outage.get("sectors")
    where = f"satellites above {math.degrees(outage['elevation']):g} deg" if outage.get("elevation") is not None else ""
    if sectors:
        where = f"{where or 'satellites'} outside {len(sectors)} shaded sector{'s' * (len(sectors) > 1)}"
    if count == 0 or (count is None and not where):
        return ""
    return f"at most {count} {where or 'satellites'}" if count else where
