"""A matrix of scenarios: every combination of some values, or a Latin hypercube of ranges, as one experiment with one table."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from insemu import yamlfile
from insemu.errors import InputError
from insemu.evaluate.control import previewed
from insemu.evaluate.experiment import Experiment
from insemu.evaluate.results import Results
from insemu.evaluate.running import ALONE, Progress, Resources, run_experiment, silent
from insemu.evaluate.standings import MATERIAL, standings
from insemu.evaluate.twin import LinearTwin
from insemu.scenario import Scenario, load
from insemu.units import conversion
from insemu.work import Files

#: Most points of one sweep.
MOST = 10_000
_KEY = re.compile(r"\s*(?P<key>[A-Za-z_][^=,\[\]]*?)\s*=\s*")
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_RANGE = re.compile(
    rf"(?P<low>{_NUMBER})\s*(?P<unit>[^.,\d]*?)\s*\.\.\s*(?P<high>{_NUMBER})\s*(?P<other>[^,]*?)\s*(?P<log>\blog)?\s*(?=,|$)"
)


@dataclass(frozen=True)
class Factor:
    """A key of the scenario and what it takes.

    Parameters
    ----------
    key : str
        As :func:`insemu.scenario.with_changes` reads it.
    values : sequence of plain data
        Empty for a range.
    low, high : float
        Of a range, in ``unit``.
    unit : str
    log : bool
        Whether the range is even on a logarithmic scale.
    """

    key: str
    values: tuple[Any, ...] = ()
    low: float = math.nan
    high: float = math.nan
    unit: str = ""
    log: bool = False

    def at(self, share: float) -> Any:
        """The value at a share (0 to 1) of the way through the list or the range."""
        if self.values:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        if self.log:
            value = self.low * (self.high / self.low) ** share
        else:
            value = self.low + share * (self.high - self.low)
        return f"{value:.6g} {self.unit}".strip() if self.unit else float(f"{value:.6g}")


def factors(text: str) -> list[Factor]:
    """Read ``sensor=[ADIS16470, BMI088],outage=[30 s, 60 s],gnss.position_sigma=2 cm..1 m log``.

    Raises
    ------
    InputError
        Anything else, an empty list, or a key that stands twice.
    """
    out: list[Factor] = []
    rest = text.strip()
    while rest:
        found = _KEY.match(rest)
        if found is None:
            raise _expected(rest)
        rest = rest[found.end() :]
        if rest.startswith("["):
            end = _closing(rest)
            values = yamlfile.parse(rest[: end + 1], "--over").data
            if not values:
                raise InputError(f"{found['key']}: found an empty list, expected values", where="--over")
            factor, rest = Factor(found["key"], tuple(values)), rest[end + 1 :].lstrip()
        else:
            spelled = _RANGE.match(rest)
            if spelled is None:
                raise _expected(rest)
            factor, rest = _range(found["key"], spelled), rest[spelled.end() :]
        if rest and not rest.startswith(","):
            raise _expected(rest)
        rest = rest[1:].strip()
        if factor.key in (f.key for f in out):
            raise InputError(f"the key '{factor.key}' stands twice", where="--over")
        out.append(factor)
    if not out:
        raise _expected(text)
    return out


def _expected(found: str) -> InputError:
    return InputError(
        f"found '{found[:60]}', expected KEY=[VALUE, VALUE] or KEY=LOW..HIGH, for example outage=[30 s, 60 s],sensor=[ADIS16470, BMI088]",
        where="--over",
    )


def _closing(text: str) -> int:
    """Index of the bracket that closes the first one."""
    depth = 0
    for k, c in enumerate(text):
        depth += (c in "[{") - (c in "]}")
        if depth == 0:
            return k
    raise InputError(f"found '{text[:60]}', expected a closing bracket", where="--over")


def _range(key: str, found: re.Match[str]) -> Factor:
    unit, other = found["unit"].strip(), found["other"].strip()
    low, high = float(found["low"]), float(found["high"])
    if other and unit and other != unit:
        high *= conversion(other, unit)
    unit = unit or other
    if not low < high or (found["log"] and low <= 0):
        raise InputError(
            f"{key}: found {found[0].strip()}, expected a range from low to high"
            + (" above 0" if found["log"] else ""),
            where="--over",
        )
    return Factor(key, (), low, high, unit, bool(found["log"]))


def points(given: Sequence[Factor], latin: int, seed: int) -> list[dict[str, Any]]:
    """The points of a sweep: key to value each.

    Parameters
    ----------
    given : sequence of Factor
    latin : int
        Points of a Latin hypercube (McKay, Beckman and Conover 1979): every range is cut into as many parts, each of which is met once;
        values of a list are met equally often. 0: the grid of all combinations.
    seed : int

    Raises
    ------
    InputError
        A range in a grid, or more than :data:`MOST` points.
    """
    if latin > MOST:
        raise InputError(f"found {latin} points, expected at most {MOST}", where="--latin")
    if latin:
        from scipy.stats import qmc

        shares = qmc.LatinHypercube(len(given), seed=np.random.default_rng(seed)).random(latin)
        return [{f.key: f.at(float(s)) for f, s in zip(given, row, strict=True)} for row in shares]
    if (ranged := next((f.key for f in given if not f.values), None)) is not None:
        raise InputError(
            f"{ranged}: found a range, expected a list of values, or --latin N for N points within ranges",
            where="--over",
        )
    if (count := math.prod(len(f.values) for f in given)) > MOST:
        raise InputError(f"makes {count} points, expected at most {MOST}; --latin N takes N of them", where="--over")
    return [
        dict(zip((f.key for f in given), values, strict=True))
        for values in itertools.product(*(f.values for f in given))
    ]


@dataclass(frozen=True)
class Row:
    """One design at one point.

    Parameters
    ----------
    point : int
        From 1.
    values : mapping of key to str
    design : str
    states : int
    error_m : float
        Mean planimetric error at outage end over realizations and outages, m.
    low_m, high_m : float or None
        Its 95 % interval.
    quantile_95_m : float
        Of the error at outage end over realizations and outages, m.
    stated_m : float
        Root mean square of the stated horizontal standard deviation there, m.
    knows : str
        ``yes``, ``optimistic`` or ``pessimistic``.
    by : str
        What the errors are of: ``flights``, ``linear`` realizations, or ``coarse`` runs at long steps (a design that is not linear).
    why : str
        Why a design is not linear; empty otherwise.
    """

    point: int
    values: Mapping[str, str]
    design: str
    states: int
    error_m: float
    low_m: float | None
    high_m: float | None
    quantile_95_m: float
    stated_m: float
    knows: str
    by: str
    why: str

    def flat(self) -> dict[str, Any]:
        """As a line of a table."""
        plain = asdict(self)
        values = plain.pop("values")
        return {"point": plain.pop("point"), **values, **plain}


@dataclass(frozen=True)
class Sweep:
    """A matrix of scenarios, checked.

    Parameters
    ----------
    scenario : Scenario
        The one that is varied.
    file : path
    given : sequence of Factor
    points : sequence of mapping
    scenarios : sequence of Scenario
        One per point.
    linear : int
        Realizations to first order instead of flights; 0: flights.
    """

    scenario: Scenario
    file: str | Path
    given: Sequence[Factor]
    points: Sequence[Mapping[str, Any]]
    scenarios: Sequence[Scenario] = field(repr=False)
    linear: int = 0

    @classmethod
    def of(
        cls, file: str | Path, text: str, *, latin: int = 0, linear: int = 0, overrides: Mapping[str, Any] | None = None
    ) -> Sweep:
        """Read and check all points; nothing is flown.

        Parameters
        ----------
        file : path
        text : str
            What :func:`factors` reads.
        latin, linear : int
        overrides : mapping, optional
            Top-level keys of every scenario.

        Raises
        ------
        InputError
            Of the file, the text, or the first point that is no scenario.
        """
        base = load(file, overrides=overrides)
        given = factors(text)
        made = points(given, latin, base.seed)
        scenarios = []
        for k, point in enumerate(made, start=1):
            try:
                scenarios.append(load(file, overrides=overrides, changes=point))
            except InputError as error:
                said = ", ".join(f"{key}={value}" for key, value in point.items())
                raise InputError(error.message, where=f"--over, point {k} ({said}): {error.where}") from None
        return cls(base, file, given, made, scenarios, linear)

    def labels(self, point: int) -> dict[str, str]:
        """What the keys take at a point (from 0), in words."""
        return {
            key: value if isinstance(value, str) else json.dumps(value) for key, value in self.points[point].items()
        }

    def rows(
        self,
        folder: Path,
        resources: Resources = ALONE,
        *,
        progress: Callable[[int, int], Progress] = lambda done, total: silent,
    ) -> Iterator[list[Row]]:
        """Fly point after point, or take what is kept, and yield the rows of each.

        Parameters
        ----------
        folder : path
            Where finished points and, until a point is finished, its realizations are kept.
        resources : Resources
            Without folder and progress.
        progress : callable
            Given the number of points that are done and of all; gives the progress of the next one.
        """
        for k, scenario in enumerate(self.scenarios):
            step = progress(k, len(self.scenarios))
            experiment = Experiment(scenario, self.file)
            what = f"{experiment.digest}-{'linear-' * bool(self.linear)}{self.linear or experiment.realizations}"
            kept: Files[list[dict[str, Any]]] = Files(folder, what, _encoded, json.loads, resources.say)
            if (found := kept.get(what)) is None:
                if self.linear:
                    found = _linear_rows(experiment, self.linear, step)
                else:
                    here = replace(resources, cache=folder / "flying", progress=step)
                    found = _flown_rows(run_experiment(experiment, resources=here))
                kept.put(what, found)
                _forget(folder / "flying" / experiment.digest)
            yield [Row(k + 1, self.labels(k), **row) for row in found]


def _encoded(rows: list[dict[str, Any]]) -> bytes:
    return json.dumps(rows).encode()


def _forget(cache: Path) -> None:
    """Realizations of a point whose rows are kept."""
    if cache.is_dir():
        for file in cache.iterdir():
            file.unlink()
        cache.rmdir()


def _flown_rows(results: Results) -> list[dict[str, Any]]:
    return [
        {
            "design": s.design,
            "states": s.states,
            "error_m": s.error_m,
            "low_m": s.low_m,
            "high_m": s.high_m,
            "quantile_95_m": float(np.quantile(results.planimetric_ends(s.design), 0.95)),
            "stated_m": s.stated_m,
            "knows": s.knows,
            "by": "flights",
            "why": "",
        }
        for s in standings(results)
    ]


def _linear_rows(experiment: Experiment, realizations: int, step: Progress) -> list[dict[str, Any]]:
    step(0, realizations, "models")
    _ = experiment.beliefs
    step(0, realizations, "linear errors")
    twin = LinearTwin(experiment)
    step(0, realizations, "realizations")
    out, preview = [], previewed(twin, realizations)
    for name, stated_at in twin.stated.items():
        figures = preview.figures_of(name)
        stated = float(np.sqrt((stated_at**2).mean()))
        factor = figures.rms / stated
        knows = "yes" if 1.0 / MATERIAL <= factor <= MATERIAL else "optimistic" if factor > 1.0 else "pessimistic"
        out.append({
            "design": name, "states": twin.designs[name].size, "error_m": figures.mean.value, "low_m": figures.mean.low,
            "high_m": figures.mean.high, "quantile_95_m": figures.quantile_95, "stated_m": stated, "knows": knows, "by": figures.by,
            "why": preview.beyond[name].reason if name in preview.beyond else "",
        })  # fmt: skip
    return out


def conditions(sweep: Sweep) -> list[str]:
    """Keys that are given by the mission; the others (sensor and designs) are what one chooses."""
    return [f.key for f in sweep.given if f.key != "sensor" and not f.key.startswith("designs.")]


def best_of(rows: Sequence[Row]) -> Row:
    """The row to take: of those that know their error the smallest one, or one with fewer states that the data cannot tell from it.

    Where none knows its error it is the smallest error of all.
    """
    honest = [r for r in rows if r.knows == "yes"]
    best = min(honest or rows, key=lambda r: r.error_m)
    near = [r for r in honest if r.low_m is not None and best.high_m is not None and r.low_m <= best.high_m]
    return min(near or [best], key=lambda r: (r.states, r.error_m))


def front(rows: Sequence[Row]) -> list[Row]:
    """The Pareto front of error against states: rows to which no other is better in both, by states."""
    out: list[Row] = []
    for row in sorted(rows, key=lambda r: (r.states, r.error_m)):
        if not out or row.error_m < out[-1].error_m:
            out = [r for r in out if r.states < row.states] + [row]
    return out
