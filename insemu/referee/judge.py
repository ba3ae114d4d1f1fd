"""What is said of a filter: tests whose false alarms are counted together over all worlds, and what each would have found.

Half of the false-alarm rate belongs to NEES of groups of states at a few epochs and NIS of all innovations, in the worlds in which the filter is
given the truth. The other half belongs to every component at every epoch, and finds where an inconsistency begins. Of either half, all tests in all
worlds share it in equal parts (Bonferroni), so a right filter is accused in at most that share of pages. Bounds are exact where errors are normal:
the sum over independent realizations is chi-square.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.evaluate import (
    ALONE,
    COMPONENTS,
    MEAN_SQUARE,
    Resources,
    Verdict,
    chi_square_bounds,
    nees_verdicts,
    nis_verdict,
    share_interval,
    smallest_found,
)
from insemu.filters import FAMILIES, named_filter
from insemu.referee.flights import Drift, Flights, converged, cost, drifts
from insemu.referee.worlds import World, starts, worlds
from insemu.shown import count_of

Array = NDArray[np.float64]

#: Groups that are judged by NEES, in the order of :attr:`Flights.nees`, and their number of states.
GROUPS = {"all nine": 9, "position": 3, "velocity": 3, "attitude": 3}
#: Probability with which a stated level is found.
POWER = 0.9
#: A start has converged where tilt, heading (rad) and horizontal position (m) are within these at the end: well above what any world leaves
#: of a right filter, far below the starts.
WITHIN = (math.radians(2.0), math.radians(5.0), 5.0)
#: Realizations, false-alarm rate and seed unless given.
REALIZATIONS, FALSE_ALARM, SEED = 48, 0.01, 1


@dataclass(frozen=True)
class Inconsistency:
    """The first epoch and component at which errors are not what is stated.

    Parameters
    ----------
    t : float
        s from the start.
    component : str
        Of :data:`insemu.evaluate.COMPONENTS`.
    factor : float
        Actual over stated standard deviation.
    """

    t: float
    component: str
    factor: float

    def __str__(self) -> str:
        return f"{self.component.replace('_', ' ')} at {self.t:g} s, {self.factor:.2f} times the stated sigma"


@dataclass(frozen=True)
class Judged:
    """One filter in one world.

    Parameters
    ----------
    world : World
    flights : Flights
    tests : sequence of Verdict
    power : mapping
        Group, ``innovations`` or ``component`` to the smallest shares by which sigma is too small and too large that the world finds.
    first : Inconsistency, optional
    drifts : sequence of Drift
    """

    world: World
    flights: Flights
    tests: Sequence[Verdict]
    power: Mapping[str, tuple[float, float]]
    first: Inconsistency | None
    drifts: Sequence[Drift]

    @property
    def found(self) -> bool:
        """Whether anything is wrong."""
        return bool(self.flights.failed) or self.first is not None or any(not v.passed for v in self.tests)

    @property
    def finds(self) -> tuple[float, float]:
        """Shares by which all sigmas together have to be too small, or too large, to be found with :data:`POWER` in this world."""
        few, many = zip(*self.power.values(), strict=True)
        return min(few), min(many)

    @property
    def what(self) -> list[str]:
        """What is wrong, in words."""
        out = []
        if self.flights.failed:
            k, said = next(iter(self.flights.failed.items()))
            out.append(f"failed in {len(self.flights.failed)} realizations, first in {k}: {said}")
        out += [str(v) for v in self.tests if not v.passed]
        return [*out, f"first inconsistency: {self.first}"] if self.first else out


@dataclass(frozen=True)
class Judgement:
    """One filter in all worlds.

    Parameters
    ----------
    name : str
    rows : sequence of Judged
    starts : mapping of str to (count, of)
        Realizations that converge, by the standard deviation of tilt and heading at the start.
    false_alarm : float
        Of all tests together.
    seconds_per_epoch : float
        CPU; not the same twice, and on no page.
    """

    name: str
    rows: Sequence[Judged]
    starts: Mapping[str, tuple[int, int]]
    false_alarm: float
    seconds_per_epoch: float = field(compare=False)

    @property
    def right(self) -> list[Judged]:
        """Worlds in which the filter is given the truth."""
        return [r for r in self.rows if not r.world.wrong]

    @property
    def accused(self) -> list[Judged]:
        """Those of them in which something is wrong."""
        return [r for r in self.right if r.found]

    @property
    def verdict(self) -> str:
        """One sentence: what was found, or what would have been."""
        right, accused = self.right, self.accused
        if accused:
            found = [r for r in accused if r.first is not None]
            words = f"{self.name} does not state its errors in {len(accused)} of {count_of(len(right), 'world')}"
            first = min(found, key=lambda r: r.first.t if r.first else 0.0, default=None)
            return f"{words}: {', '.join(r.world.name for r in accused)}." + (
                f" First in {first.world.name}: {first.first}." if first else ""
            )
        if not right:
            return f"{self.name} was flown in worlds with wrong models only."
        least = max(r.finds[0] for r in right)
        return (
            f"No difference between the errors of {self.name} and what it states was found in {count_of(len(right), 'world')}. All sigmas "
            f"{100 * least:.0f} % too small would have been found in each of them with {100 * POWER:.0f} %."
        )

    def to_json(self) -> dict[str, Any]:
        """As plain data, without what is not the same twice."""
        rows = [
            {
                "world": r.world.name, "says": r.world.says, "given_wrong": dict(r.world.tuning), "realizations": r.flights.runs,
                "failed": {str(k): v for k, v in r.flights.failed.items()}, "found": r.found,
                "tests": [{**asdict(v), "passed": v.passed} for v in r.tests],
                "finds": {k: {"too_small": a, "too_large": b if math.isfinite(b) else None} for k, (a, b) in r.power.items()},
                "first_inconsistency": None if r.first is None else asdict(r.first), "drifts": [asdict(d) for d in r.drifts],
            }
            for r in self.rows
        ]  # fmt: skip
        begun = {
            sigma: {"converged": k, "of": n, "interval95": share_interval(k, n)}
            for sigma, (k, n) in self.starts.items()
        }
        return {
            "filter": self.name, "verdict": self.verdict, "false_alarm": self.false_alarm, "power": POWER, "worlds": rows, "starts": begun
        }  # fmt: skip


def judged(
    world: World, flights: Flights, drift: Sequence[Drift], shares: tuple[float, float], *, correlated: bool = True
) -> Judged:
    """Judge what a filter gave in one world.

    Parameters
    ----------
    world : World
    flights : Flights
    drift : sequence of Drift
    shares : (float, float)
        False-alarm rate of one test of groups or innovations, and of one component at one epoch.
    correlated : bool
        Whether the filter states a whole covariance. Of variances alone a sum over components is no chi-square, so each is judged by itself.
    """
    tests: list[Verdict] = []
    power: dict[str, tuple[float, float]] = {}
    runs = flights.runs
    if not runs:
        return Judged(world, flights, tests, power, None, drift)
    rows = looked_at(flights)
    if correlated:
        for k, (name, dof) in enumerate(GROUPS.items()):
            found = nees_verdicts(
                dof * flights.nees[:, rows, k].mean(axis=0), runs, dof, subject=name, at=list(flights.t[rows] - flights.t[0]),
                confidence=1.0 - shares[0] * len(rows),
            )  # fmt: skip
            tests += found
            power[name] = smallest_found((found[0].low, found[0].high), runs * dof, POWER)
    if flights.dof:
        tests.append(nis_verdict(flights.nis, flights.dof, confidence=1.0 - shares[0]))
        power["innovations"] = smallest_found((tests[-1].low, tests[-1].high), flights.dof, POWER)
    low, high = (x / runs for x in chi_square_bounds(0.5 * shares[1], runs))
    with np.errstate(divide="ignore", invalid="ignore"):
        square = ((flights.error / flights.sigma) ** 2).mean(axis=0)
    outside = ~((square >= min(low, 1.0 - MEAN_SQUARE)) & (square <= max(high, 1.0 + MEAN_SQUARE)))
    power["component"] = smallest_found((low, high), runs, POWER)
    began = None
    if outside.any():
        first = int(np.argmax(outside.any(axis=1)))
        z = np.where(outside[first], np.abs(np.log(square[first])), -1.0)
        c = int(np.argmax(np.nan_to_num(z, nan=np.inf)))
        began = Inconsistency(float(flights.t[first] - flights.t[0]), COMPONENTS[c], float(np.sqrt(square[first, c])))
    return Judged(world, flights, tests, power, began, drift)


def looked_at(flights: Flights) -> list[int]:
    """Epochs of the tests of groups: after a third, two thirds and the whole, and at the ends of the outages."""
    t = flights.t
    ends = [start + duration for start, duration in flights.experiment.world.outage_windows]
    return sorted({flights.row(when) for when in (*(t[0] + np.ptp(t) * np.array([1, 2, 3]) / 3), *ends)})


def referee(
    filters: Sequence[str],
    *,
    names: Sequence[str] = (),
    realizations: int | None = None,
    seed: int | None = None,
    false_alarm: float | None = None,
    resources: Resources = ALONE,
    progress: Callable[[str, str], None] = lambda filter, world: None,
) -> list[Judgement]:
    """Fly filters through the worlds, and judge what they state.

    Parameters
    ----------
    filters : sequence of str
        As :func:`insemu.filters.named_filter` takes them; all that come with insemu unless given.
    names : sequence of str
        Worlds; all unless given.
    realizations : int, optional
        :data:`REALIZATIONS` unless given.
    seed : int, optional
        The same seed gives the same answer to the byte; :data:`SEED` unless given.
    false_alarm : float, optional
        Probability that anything is said against a right filter; :data:`FALSE_ALARM` unless given.
    resources : Resources
        What is kept of the realizations lets an interrupted call go on; estimates of other programs are read anew.
    progress : callable
        Called with filter and world before each.

    Raises
    ------
    InputError
        No such filter or world; estimates that another program has yet to make.
    """
    realizations = realizations or REALIZATIONS
    seed = SEED if seed is None else seed
    false_alarm = FALSE_ALARM if false_alarm is None else false_alarm
    if not 0.0 < false_alarm < 1.0:
        raise InputError(f"false_alarm is {false_alarm!r}, expected a probability between 0 and 1")
    chosen, out = worlds(names), []
    for given in filters or [*FAMILIES, "ukf"]:
        label, filter, settings, correlated = named_filter(given)
        flown: dict[str, Flights] = {}
        drift: dict[str, list[Drift]] = {}
        for world in [*chosen, *starts().values()]:
            progress(label, world.name)
            own = replace(resources, cache=None) if filter == "files" else resources
            flights = Flights.of(world.experiment(filter, settings, seed), realizations, own)
            flown[world.name] = flights
            if world in chosen:
                drift[world.name] = drifts(flights, world.experiment("ekf", {}, seed))
        pending = sum(f.pending for f in flown.values())
        if pending:
            raise InputError(
                f"{pending} of {len(flown) * realizations} estimates are missing; expected estimate.csv in each of its folders",
                where=given,
            )
        right = [flown[w.name] for w in chosen if not w.wrong and flown[w.name].runs]
        few = sum((len(GROUPS) * len(looked_at(f)) if correlated else 0) + (f.dof > 0) for f in right)
        shares = 0.5 * false_alarm / max(few, 1), 0.5 * false_alarm / max(sum(9 * f.t.size for f in right), 1)
        rows = [judged(w, flown[w.name], drift[w.name], shares, correlated=correlated) for w in chosen]
        begun = {sigma: (converged(flown[w.name], WITHIN), realizations) for sigma, w in starts().items()}
        out.append(Judgement(label, rows, begun, false_alarm, cost(flown[chosen[0].name].experiment)))
    return out
