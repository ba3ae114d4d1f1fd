"""What an experiment found, labelled: errors, predicted sigmas and NEES per design, realization and epoch, with its manifest."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.evaluate.consistency import BLOCKS, nees_verdicts, nis_verdict, whiteness_verdicts
from insemu.evaluate.dataset import labelled
from insemu.evaluate.errors import (
    GROUPS,
    PairedComparison,
    bootstrap_mean,
    paired_ratio,
    within_outage,
)
from insemu.evaluate.tally import DURING, Ladder, Tally, end_index, tally
from insemu.evaluate.verdict import Verdict
from insemu.noise import NoiseModel
from insemu.records import Trajectory
from insemu.shown import Shown, count_of, few, finite

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DesignInfo:
    """What a design carries."""

    states: int
    state_names: tuple[str, ...]
    belief: Mapping[str, NoiseModel]


@dataclass(frozen=True, repr=False)
class Results(Shown):
    """Errors of designs in realizations of one scenario.

    Parameters
    ----------
    title : str
        Of the scenario.
    digest : str
        Identity of the experiment.
    seed : int
    data : xarray.Dataset
        What :data:`insemu.evaluate.dataset.VARIABLES` lists, per design, for every realization or, of more than :data:`FULL`, for those
        whose numbers the coordinate ``realization`` holds; coordinate ``time`` holds the output epochs, s.
    designs : mapping
        Name to :class:`DesignInfo`, in the order of the first axis.
    outages : sequence of (start_s, duration_s)
    truth : Trajectory
        Reference at the output epochs.
    timing : mapping
        ``filter_epochs``, and ``wall_seconds``, which no other file than ``timing.json`` holds.
    manifest : mapping
        Resolved scenario, seed, versions, git revision.
    published : mapping
        Figure of the outage table to design to a paper's value per outage, None where it has none; the first figure is the headline.
    budgets : mapping
        Design to an error budget per outage (:func:`~insemu.evaluate.comparison.error_budgets`); empty where none was made.
    nees_dof : int
        Number of navigation states that have a reference.
    tally : Tally, optional
        What is kept of all realizations; made from ``data`` unless given.
    """

    title: str
    digest: str
    seed: int
    data: xr.Dataset
    designs: Mapping[str, DesignInfo]
    outages: Sequence[tuple[float, float]]
    truth: Trajectory
    timing: Mapping[str, float]
    manifest: Mapping[str, Any] = field(default_factory=dict)
    published: Mapping[str, Mapping[str, Sequence[float | None]]] = field(default_factory=dict)
    nees_dof: int = 9
    budgets: Mapping[str, Sequence[Mapping[str, Any]]] = field(default_factory=dict)
    tally: Tally | None = None

    @cached_property
    def total(self) -> Tally:
        """What is kept of all realizations."""
        if self.tally is not None:
            return self.tally
        ladder = Ladder()
        arrays = {str(k): v.to_numpy() for k, v in self.data.data_vars.items() if "realization" in v.dims}
        for r in range(self.data.sizes["realization"]):
            ladder.push(tally({k: v[:, r] for k, v in arrays.items()}, self.t, self.outages))
        return ladder.total()

    def __str__(self) -> str:
        head = f"{self.title}: {count_of(len(self.designs), 'design')}, {count_of(self.realizations, 'realization')}, seed {self.seed}"
        return few([head, *(f"  {line}" for line in map(_row_words, outage_rows(self)))])

    def to_dataframe(self) -> pd.DataFrame:
        """One row per design and outage: the figures of ``outages.csv``."""
        import pandas as pd

        rows = pd.DataFrame(outage_rows(self))
        return rows.set_index(["design", "outage"]) if len(rows) else rows

    def to_xarray(self) -> xr.Dataset:
        """Errors, stated deviations and NEES by design, realization and time; of many realizations for some, which the labels name."""
        return self.data

    @property
    def runs(self) -> xr.Dataset:
        """Values of every realization: errors at the ends of the outages, largest ones in between, sums of the innovations."""
        return self.total.runs_dataset(self.names)

    @property
    def statistics(self) -> xr.Dataset:
        """Statistics over all realizations at every epoch: moments, quantiles, coverage, NEES."""
        return self.total.statistics_dataset(self.names, self.t)

    def __getitem__(self, name: str) -> Array:
        """A variable of the dataset as an array, (design, realization, ...)."""
        return self.data[name].to_numpy()

    def __contains__(self, name: str) -> bool:
        return name in self.data

    def with_data(self, arrays: Mapping[str, ArrayLike], designs: Mapping[str, DesignInfo] | None = None) -> Results:
        """The results with some variables in place of, or besides, their own; ``designs`` where their number changes."""
        import xarray as xr

        chosen = self.designs if designs is None else designs
        kept = {} if designs is not None else {str(name): self.data[name] for name in self.data.data_vars}
        given = labelled(arrays, ("design", "realization"), {"design": list(chosen), "time": self.t})
        return replace(self, data=xr.Dataset({**kept, **given.data_vars}), designs=chosen, tally=None)

    @property
    def t(self) -> Array:
        """Output epochs, s."""
        return self["time"]

    @property
    def error(self) -> Array:
        """Navigation errors, (design, realization, time, 9)."""
        return self["error"]

    @property
    def sigma(self) -> Array:
        """Standard deviations that the filters state, (design, realization, time, 9)."""
        return self["sigma"]

    @property
    def nees(self) -> Array:
        """NEES of the nine navigation states, (design, realization, time)."""
        return self["nees"]

    @property
    def smoothed(self) -> bool:
        """Whether the runs were smoothed backwards too."""
        return "smoothed_error" in self

    @property
    def realizations(self) -> int:
        """Number of realizations."""
        return self.total.count

    @property
    def nis(self) -> Array:
        """Mean normalised innovation squared per degree of freedom over accepted fixes, (design, realization)."""
        return np.asarray(self.total.runs["nis"] / np.maximum(1, self.total.runs["dof"]))

    @property
    def headline_figure(self) -> str:
        """The figure of the outage table that tables show: the first that was published, else the mean error at outage end."""
        return next(iter(self.published), "planimetric_end_m")

    @property
    def names(self) -> list[str]:
        """Design names, in order."""
        return list(self.designs)

    def planimetric(self, design: str) -> Array:
        """Horizontal position error of the realizations in ``data``, (realization, time), m."""
        e = self.error[self.names.index(design)]
        return np.asarray(np.hypot(e[..., 0], e[..., 1]))

    def end_index(self, outage: int) -> int:
        """Index of the last epoch of an outage."""
        return end_index(self.t, self.outages[outage])

    def middle_index(self, outage: int) -> int:
        """Index of the epoch nearest the middle of an outage."""
        start, duration = self.outages[outage]
        return int(np.argmin(np.abs(self.t - start - 0.5 * duration)))

    def planimetric_ends(self, design: str) -> Array:
        """Horizontal position error at the ends of the outages, (realizations, outages), m."""
        e = self.total.runs["end_error"][self.names.index(design)]
        return np.asarray(np.hypot(e[..., 0], e[..., 1]))

    def pooled_end(self, design: str) -> Array:
        """Planimetric error at outage end averaged over the outages, one value per realization, m."""
        return np.asarray(self.planimetric_ends(design).mean(axis=1))

    def comparison(self, one: str, other: str) -> PairedComparison:
        """Paired comparison of the pooled planimetric errors at outage end."""
        return paired_ratio(self.pooled_end(one), self.pooled_end(other))

    def to_dataset(self) -> xr.Dataset:
        """The labelled arrays with the reference, for NetCDF and for further work with xarray."""
        import xarray as xr

        reference = xr.DataArray(self.truth.llh, dims=("time", "llh"), attrs={"units": "rad, rad, m"})
        data = self.data.assign(reference_llh=reference)
        if "observability" in data:  # hardly differs between realizations
            mean = self.total.sums["observability"] / self.total.count
            data["observability"] = (("design", "time", "state"), mean, data["observability"].attrs)
        manifest = json.dumps(self.manifest, default=str)
        return data.assign_attrs(title=self.title, digest=self.digest, seed=self.seed, manifest=manifest)


def outage_table(results: Results) -> dict[str, list[dict[str, Any]]]:
    """Per design and outage: the figures of ``summary.json`` (SI; attitude in degrees as its key says).

    ``planimetric_mean_m`` averages over epochs and realizations of the outage; ``planimetric_max_m`` and ``north_max_m``, ``east_max_m``,
    ``down_max_m`` average the largest error of each realization; ``predicted_sigma_end_m`` is the root of the mean stated horizontal
    variance. With a smoother, ``smoothed`` holds its own figures together with the filter's in the middle of the outage, where a smoother is worst.
    """
    table: dict[str, list[dict[str, Any]]] = {}
    for d, name in enumerate(results.names):
        rows = []
        for k, (start, duration) in enumerate(results.outages):
            inside = within_outage(results.t, start, duration)
            end = results.end_index(k)
            total, error = results.total, results.total.runs["end_error"][d, :, k]
            at_end_runs = runs_of(results, name, k, "planimetric_end_m")
            at_end = bootstrap_mean(at_end_runs)
            row = {
                "start_s": start,
                "duration_s": duration,
                "planimetric_end_m": {
                    "mean": at_end.mean,
                    "ci95": [at_end.low, at_end.high],
                    "per_realization": at_end_runs.tolist(),
                },
                **{f: float(runs_of(results, name, k, f).mean()) for f in DURING},
                "altimetric_end_m": float(np.abs(error[:, 2]).mean()),
                "predicted_sigma_end_m": float(np.sqrt(total.mean("sigma_square", d)[end, :2].sum())),
                "velocity_end_m_s": float(np.linalg.norm(error[:, 3:6], axis=1).mean()),
                "attitude_end_deg": float(np.rad2deg(np.linalg.norm(error[:, 6:9], axis=1)).mean()),
                "coverage_3sigma": _coverage(total.mean("inside", d)[inside]),
                "nees_per_dof": float(total.mean("nees", d)[inside].mean() / 9.0) if inside.any() else float("nan"),
            }
            if results.smoothed:
                row["smoothed"] = _smoothed_row(results, d, k)
            rows.append(row)
        table[name] = rows
    return table


def _row_words(row: Mapping[str, Any]) -> str:
    error, stated = row["planimetric_end_m"], row["predicted_sigma_end_m"]
    return f"{row['design']}, outage {row['outage']}: {error:.3g} m at its end, states {stated:.3g} m: {row['verdict']}"


def outage_rows(results: Results) -> list[dict[str, Any]]:
    """The rows of the headline table, one per design and outage, from which terminal, page and ``outages.csv`` are made.

    Every figure of :func:`outage_table` under a name of its own, with the number of states, the verdict on the NEES at the end of the outage
    and, under ``published``, what was published of the headline figure (None: nothing).
    """
    rows = []
    for name, outages in outage_table(results).items():
        found = {v.subject: v.word for v in consistency(results, name)}
        for k, row in enumerate(outages):
            flat: dict[str, Any] = {"design": name, "outage": k + 1}
            for key, value in row.items():
                if key == "planimetric_end_m":
                    flat |= {key: value["mean"], f"{key}_low": value["ci95"][0], f"{key}_high": value["ci95"][1]}
                elif key == "smoothed":
                    flat |= {f"smoothed_{n}": v for n, v in value.items() if not isinstance(v, dict)}
                    flat |= {f"smoothed_coverage_3sigma_{g}": v for g, v in value["coverage_3sigma"].items()}
                elif isinstance(value, dict):
                    flat |= {f"{key}_{g}": v for g, v in value.items()}
                else:
                    flat[key] = value
            printed = results.published.get(results.headline_figure, {}).get(name, ())
            flat["states"] = results.designs[name].states
            flat["verdict"] = found.get(f"the filter at {results.t[results.end_index(k)]:g} s", "")
            flat["published"] = printed[k] if k < len(printed) else None
            rows.append(flat)
    return rows


def _coverage(inside: Array) -> dict[str, float]:
    """Shares inside three sigma of shares (epochs, 9); 1 without epochs."""
    return {g: float(inside[:, s].mean()) if inside.size else 1.0 for g, s in GROUPS.items()}


def _smoothed_row(results: Results, design: int, outage: int) -> dict[str, Any]:
    """Filter and smoother during one outage, horizontally: rms errors and stated sigma in the middle, largest errors, coverage, NEES."""
    inside, middle = within_outage(results.t, *results.outages[outage]), results.middle_index(outage)
    total = results.total

    def rms(squares: str) -> float:
        return float(np.sqrt(total.mean(squares, design)[middle, :2].sum()))

    def mean(figure: str) -> float:
        return float(total.runs[f"smoothed_{figure}"][design, :, outage].mean())

    return {
        "filter_middle_rms_m": rms("error_square"),
        "middle_rms_m": rms("smoothed_square"),
        "predicted_sigma_middle_m": rms("smoothed_sigma_square"),
        "planimetric_mean_m": mean("planimetric_mean_m"),
        "planimetric_max_m": mean("planimetric_max_m"),
        "altimetric_max_m": mean("down_max_m"),
        "coverage_3sigma": _coverage(total.mean("smoothed_inside", design)[inside]),
        "nees_per_dof": float(total.mean("smoothed_nees", design)[inside].mean() / 9.0)
        if inside.any()
        else float("nan"),
    }


def figure_of(row: Mapping[str, Any], figure: str) -> float:
    """One figure of an outage row, a mean over realizations."""
    value = row[figure]
    return float(value["mean"] if isinstance(value, Mapping) else value)


def published_cells(results: Results, figure: str) -> list[tuple[str, int, float, float]]:
    """Every published cell of a figure: design, outage (from 0), our value, theirs."""
    table = outage_table(results)
    return [
        (name, k, figure_of(table[name][k], figure), value)
        for name, values in results.published.get(figure, {}).items()
        for k, value in enumerate(values[: len(results.outages)])
        if value is not None
    ]


def kendall(ours: Sequence[float], theirs: Sequence[float]) -> float:
    """Kendall's rank correlation (tau-b)."""
    a, b = (np.sign(np.subtract.outer(x, x)) for x in (np.asarray(ours), np.asarray(theirs)))
    with np.errstate(invalid="ignore"):  # all equal: not defined
        return float((a * b).sum() / np.sqrt((a**2).sum() * (b**2).sum()))


def rank_agreement(results: Results, figure: str | None = None) -> list[float]:
    """Kendall's tau between our ranking of the published designs and the paper's, per outage; of fewer than three designs none.

    Parameters
    ----------
    results : Results
    figure : str, optional
        A published figure; the first unless given.
    """
    cells = published_cells(results, figure or results.headline_figure)
    taus = []
    for k in sorted({c[1] for c in cells}):
        ours, theirs = zip(*[c[2:] for c in cells if c[1] == k], strict=True)
        if len(ours) >= 3:
            taus.append(kendall(ours, theirs))
    return taus


def single_run_agreement(results: Results, figure: str | None = None) -> Array:
    """How well one run knows the order: Kendall's tau between its ranking of the published designs and that of the other runs' means.

    Parameters
    ----------
    results : Results
    figure : str, optional
        A published figure; the first unless given.

    Returns
    -------
    (outages * realizations,) array
        Empty for fewer than three designs or two realizations. What one drive of a paper can show at best.
    """
    figure = figure or results.headline_figure
    names = [name for name in results.published.get(figure, {}) if name in results.designs]
    if len(names) < 3 or results.realizations < 2:
        return np.zeros(0)
    taus = []
    for k in range(len(results.outages)):
        values = np.stack([runs_of(results, name, k, figure) for name in names])
        total = values.sum(axis=1)
        taus += [kendall(list(v), list(total - v)) for v in values.T]
    return np.array([tau for tau in taus if not np.isnan(tau)])


def runs_of(results: Results, design: str, outage: int, figure: str) -> Array:
    """A figure of one outage, run by run.

    Parameters
    ----------
    results : Results
    design : str
    outage : int
        From 0.
    figure : str
        ``planimetric_end_m`` or one of :data:`DURING`.

    Returns
    -------
    (realizations,) array
    """
    if figure == "planimetric_end_m":
        return results.planimetric_ends(design)[:, outage]
    return np.asarray(results.total.runs[figure][results.names.index(design), :, outage])


#: What the sensor blocks are called in words.
SENSOR_NAMES = {"gyro": "gyroscope errors", "accel": "accelerometer errors"}


def consistency(results: Results, design: str) -> list[Verdict]:
    """Does a design know its error? NEES in the middle and at the end of every outage (and of the smoother in the middle), NIS, whiteness.

    Where the truth is known, so are the errors of the estimated gyroscope and accelerometer errors, per axis and apart from white noise:
    their NEES at the same epochs.

    Each kind of test has its own family at 99 %; see :mod:`insemu.evaluate.consistency`.
    """
    d = results.names.index(design)
    out: list[Verdict] = []
    at = sorted({f(k) for k in range(len(results.outages)) for f in (results.middle_index, results.end_index)})
    total, n = results.total, results.realizations
    scale = results.nees_dof / 9.0  # NEES is kept scaled to nine
    if at:
        values = total.mean("nees", d)[at] * scale
        out += nees_verdicts(values, n, results.nees_dof, subject="the filter", at=list(results.t[at]))
    if at and results.smoothed:
        middles = sorted({results.middle_index(k) for k in range(len(results.outages))})
        values = total.mean("smoothed_nees", d)[middles] * scale
        out += nees_verdicts(values, n, results.nees_dof, subject="the smoother", at=list(results.t[middles]))
    if at and "block_nees" in total.sums:
        for block, axes in (("gyro", slice(0, 3)), ("accel", slice(3, 6))):
            values, known = (total.sums[f"block_{what}"][d, BLOCKS.index(block), at] for what in ("nees", "known"))
            carried = int((total.sums["axis_carried"][d][at, axes] == n).all(axis=0).sum())
            if (known == n).all() and carried:
                subject = f"the {SENSOR_NAMES[block]}"
                out += nees_verdicts(values / n * carried, n, carried, subject=subject, at=list(results.t[at]))
    if total.runs["dof"][d].sum() > 0:
        out.append(nis_verdict(float(total.runs["nis"][d].sum()), int(total.runs["dof"][d].sum())))
    products, count = (total.runs[name][d].sum(axis=0) for name in ("lag_sum", "lag_count"))
    if (count > 0).all():
        out += whiteness_verdicts(products, count)
    return out


def consistency_words(results: Results, design: str) -> list[str]:
    """What :func:`consistency` found, one phrase per kind of test."""
    found = consistency(results, design)
    lines = []
    families = (
        ("NEES of the filter", [v for v in found if v.test == "NEES/dof" and v.subject.startswith("the filter")]),
        ("NEES of the smoother", [v for v in found if v.test == "NEES/dof" and v.subject.startswith("the smoother")]),
        *(
            (f"NEES of the {name}", [v for v in found if v.test == "NEES/dof" and v.subject.startswith(f"the {name}")])
            for name in SENSOR_NAMES.values()
        ),
        ("NIS", [v for v in found if v.test == "NIS/dof"]),
        ("innovations", [v for v in found if v.test == "whiteness"]),
    )
    for name, family in families:
        if not family:
            continue
        low, high = min(v.value for v in family), max(v.value for v in family)
        span = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
        words = sorted({v.word for v in family if not v.passed})
        bad = sum(not v.passed for v in family)
        if name == "innovations":
            what = "white" if not words else f"correlated at {bad} of {len(family)} lags"
            lines.append(f"{name} {what} (mean products at lags 1 to 5 {span}, bound {family[0].high:.2g})")
            continue
        outside = any(not v.low <= v.value <= v.high for v in family)
        small = "consistent: what differs is smaller than what moves a decision"
        verdict = " and ".join(words) if words else small if outside else "consistent"
        if words and len(family) > 1:
            verdict += f" at {bad} of {len(family)} epochs"
        lines.append(f"{name} {span} ({family[0].low:.2f} to {family[0].high:.2f} expected): {verdict}")
    d = results.names.index(design)
    runs = results.total.runs
    if "rejected" in runs and runs["rejected"][d].any():
        rejected, fixes = (runs[name][d].mean() for name in ("rejected", "fixes"))
        lines.append(f"the gate rejected {rejected:.3g} of {fixes:.0f} fixes a run")
    return lines


def summary(results: Results) -> dict[str, Any]:
    """The machine-readable face: every figure of the table."""
    table = outage_table(results)
    designs = {}
    for d, name in enumerate(results.names):
        pooled = bootstrap_mean(results.pooled_end(name)) if results.outages else None
        designs[name] = {
            "states": results.designs[name].states,
            "state_names": list(results.designs[name].state_names),
            "outages": table[name],
            "pooled_planimetric_end_m": None
            if pooled is None
            else {"mean": pooled.mean, "ci95": [pooled.low, pooled.high]},
            "nees_per_dof": float(results.total.mean("nees", d).mean() / 9.0),
            "nees_per_dof_by_block": blocks_of(results, d),
            "nis_per_dof": float(results.nis[d].mean()),
            "rejected_fixes": results.total.runs["rejected"][d].tolist() if "rejected" in results else None,
            "observability_end": observability_end(results, name),
            "consistency": [{**asdict(v), "passed": v.passed} for v in consistency(results, name)],
        }
        if name in results.budgets:
            designs[name]["error_budget"] = list(results.budgets[name])
    comparisons = []
    names = results.names
    for i, one in enumerate(names):
        for other in names[:i]:
            if results.outages:
                c = results.comparison(one, other)
                comparisons.append(
                    {"design": one, "against": other, "ratio": c.ratio, "ci95": [c.low, c.high], "p_value": c.p_value}
                )
    document = {
        "scenario": results.title,
        "digest": results.digest,
        "seed": results.seed,
        "realizations": results.realizations,
        "designs": designs,
        "comparisons": comparisons,
        "filter_epochs": results.timing["filter_epochs"],
    }
    if results.manifest.get("intake"):
        document["intake"] = results.manifest["intake"]
    return dict(finite(document))


def blocks_of(results: Results, design: int) -> dict[str, float]:
    """Mean NEES per degree of freedom of every block that could be judged, over realizations and epochs."""
    sums = results.total.sums
    if "block_nees" not in sums:
        return {}
    values, known = (sums[f"block_{what}"][design].sum(axis=1) for what in ("nees", "known"))
    return {name: float(values[i] / known[i]) for i, name in enumerate(BLOCKS) if known[i]}


def observability_end(results: Results, design: str) -> dict[str, float]:
    """Share of each sensor state's variance that the fixes have removed by the last epoch; over time it stands in ``errors.nc``."""
    if "observability" not in results.total.sums:
        return {}
    last = results.total.mean("observability", results.names.index(design))[-1]
    names = results.designs[design].state_names[9:]
    return {name: float(v) for name, v in zip(names, last, strict=False) if np.isfinite(v)}


def verdicts(results: Results) -> list[str]:
    """What the pooled planimetric errors at outage end say, in words, every design against the first."""
    if not results.outages:
        return []
    first, *others = results.names
    lines = []
    for name in others:
        c = results.comparison(name, first)
        if c.low is None:
            lines.append(f"{name} against {first}: {c.interval}; one realization cannot say whether that is chance.")
        elif c.different:
            change = f"{abs(1 - c.ratio):.0%} {'smaller' if c.ratio < 1 else 'larger'} than {first}'s"
            if c.ratio >= 2.0:
                change = f"{c.ratio:.3g} times {first}'s"
            lines.append(
                f"{name}: planimetric error at outage end {change} ({c.interval}, paired bootstrap p {c.p_value:.2g})."
            )
        elif c.same:  # a p-value says nothing here: with enough realizations any difference is sure
            lines.append(
                f"{name}: planimetric error at outage end the same as {first}'s within {100 * c.within:.2g} % ({c.interval})."
            )
        else:
            lines.append(
                f"{name}: the data show no planimetric difference from {first}; one of {c.within:.0%} is not ruled out ({c.interval})."
            )
    return lines
