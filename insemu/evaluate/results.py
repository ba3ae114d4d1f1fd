"""What an experiment found, labelled: errors, predicted sigmas and NEES per design, realization and epoch, with its manifest."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import kendalltau

from insemu.evaluate.consistency import BLOCKS
from insemu.evaluate.errors import (
    COMPONENT_UNITS,
    COMPONENTS,
    GROUPS,
    PairedComparison,
    bootstrap_mean,
    paired_ratio,
    within_outage,
)
from insemu.noise import NoiseModel
from insemu.records import AXES, Trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DesignInfo:
    """What a design carries."""

    states: int
    state_names: tuple[str, ...]
    belief: Mapping[str, NoiseModel]


@dataclass(frozen=True)
class Results:
    """Errors of designs in realizations of one scenario.

    Parameters
    ----------
    title : str
        Of the scenario.
    digest : str
        Identity of the experiment.
    seed : int
    t : (time,) array
        Output epochs, s.
    error, sigma : (design, realization, time, 9) arrays
        Navigation errors (estimate minus truth) and the filter's standard deviations; components in state order, SI.
    nees : (design, realization, time) array
        Normalised squared error of the nine navigation states.
    designs : mapping
        Name to :class:`DesignInfo`, in the order of the first axis.
    outages : sequence of (start_s, duration_s)
    truth : Trajectory
        Reference at the output epochs.
    timing : mapping
        ``filter_epochs``, ``filter_seconds``, ``wall_seconds``.
    manifest : mapping
        Resolved scenario, seed, versions, git revision.
    published : mapping
        Design to a paper's figure per outage; ``published_figure`` says which figure of the outage table it is.
    nis : (design, realization) array
        Mean normalised innovation squared per degree of freedom over accepted fixes.
    block_nees : (design, realization, block, time) array, optional
        NEES per degree of freedom of the blocks :data:`insemu.evaluate.consistency.BLOCKS`; NaN where the truth is not known.
    axis_error, axis_sigma : (design, realization, time, 6) arrays, optional
        Estimated minus true error of every sensor axis apart from white noise, and its stated standard deviation, rad/s and m/s^2.
    """

    title: str
    digest: str
    seed: int
    t: Array
    error: Array
    sigma: Array
    nees: Array
    nis: Array
    designs: Mapping[str, DesignInfo]
    outages: Sequence[tuple[float, float]]
    truth: Trajectory
    timing: Mapping[str, float]
    manifest: Mapping[str, Any] = field(default_factory=dict)
    published: Mapping[str, Sequence[float]] = field(default_factory=dict)
    published_figure: str = "planimetric_end_m"
    block_nees: Array | None = None
    axis_error: Array | None = None
    axis_sigma: Array | None = None

    @property
    def realizations(self) -> int:
        """Number of realizations."""
        return self.error.shape[1]

    @property
    def names(self) -> list[str]:
        """Design names, in order."""
        return list(self.designs)

    def planimetric(self, design: str) -> Array:
        """Horizontal position error, (realization, time), m."""
        e = self.error[self.names.index(design)]
        return np.hypot(e[..., 0], e[..., 1])

    def end_index(self, outage: int) -> int:
        """Index of the last epoch of an outage."""
        start, duration = self.outages[outage]
        return int(np.flatnonzero(self.t <= start + duration + 1e-9)[-1])

    def pooled_end(self, design: str) -> Array:
        """Planimetric error at outage end averaged over the outages, one value per realization, m."""
        p = self.planimetric(design)
        return p[:, [self.end_index(k) for k in range(len(self.outages))]].mean(axis=1)

    def comparison(self, one: str, other: str) -> PairedComparison:
        """Paired comparison of the pooled planimetric errors at outage end."""
        return paired_ratio(self.pooled_end(one), self.pooled_end(other))

    def to_dataset(self) -> xr.Dataset:
        """The labelled arrays, for NetCDF and for further work with xarray."""
        dims = ("design", "realization", "time")
        data = xr.Dataset(
            {
                "error": ((*dims, "component"), self.error, {"long_name": "navigation error, estimate minus truth"}),
                "sigma": ((*dims, "component"), self.sigma, {"long_name": "standard deviation the filter states"}),
                "nees": (
                    dims,
                    self.nees,
                    {"long_name": "normalised squared error of the nine navigation states", "units": "1"},
                ),
                "reference_llh": (("time", "llh"), self.truth.llh, {"units": "rad, rad, m"}),
            },
            coords={
                "design": self.names,
                "realization": np.arange(self.realizations),
                "time": ("time", self.t, {"units": "s"}),
                "component": list(COMPONENTS),
                "component_unit": ("component", list(COMPONENT_UNITS)),
            },
        )
        if self.block_nees is not None:
            data["block_nees"] = (
                ("design", "realization", "block", "time"),
                self.block_nees,
                {"long_name": "NEES per degree of freedom", "units": "1"},
            )
            data = data.assign_coords(block=list(BLOCKS))
        for name, values in (("axis_error", self.axis_error), ("axis_sigma", self.axis_sigma)):
            if values is not None:
                data[name] = (
                    (*dims, "axis"),
                    values,
                    {"long_name": "of the estimated sensor error without white noise"},
                )
                data = data.assign_coords(axis=list(AXES))
        data.attrs = {
            "title": self.title,
            "digest": self.digest,
            "seed": self.seed,
            "manifest": json.dumps(self.manifest, default=str),
        }
        return data


def outage_table(results: Results) -> dict[str, list[dict[str, Any]]]:
    """Per design and outage: the figures of ``summary.json`` (SI; attitude in degrees as its key says).

    ``planimetric_mean_m`` averages over epochs and realizations of the outage; ``planimetric_max_m`` averages the largest error of each
    realization; ``predicted_sigma_end_m`` is the root of the mean stated horizontal variance.
    """
    table: dict[str, list[dict[str, Any]]] = {}
    for d, name in enumerate(results.names):
        rows = []
        for k, (start, duration) in enumerate(results.outages):
            inside = within_outage(results.t, start, duration)
            end = results.end_index(k)
            error, sigma = results.error[d], results.sigma[d]
            horizontal = np.hypot(error[..., 0], error[..., 1])
            at_end = bootstrap_mean(horizontal[:, end])
            known = np.where(np.isnan(error[:, inside]), np.nan, 1.0)
            covered = known * (np.abs(error[:, inside]) <= 3.0 * sigma[:, inside])
            rows.append(
                {
                    "start_s": start,
                    "duration_s": duration,
                    "planimetric_end_m": {
                        "mean": at_end.mean,
                        "ci95": [at_end.low, at_end.high],
                        "per_realization": horizontal[:, end].tolist(),
                    },
                    "planimetric_mean_m": float(horizontal[:, inside].mean()) if inside.any() else 0.0,
                    "planimetric_max_m": float(horizontal[:, inside].max(axis=1).mean()) if inside.any() else 0.0,
                    "altimetric_end_m": float(np.abs(error[:, end, 2]).mean()),
                    "predicted_sigma_end_m": float(np.sqrt((sigma[:, end, :2] ** 2).sum(axis=1).mean())),
                    "velocity_end_m_s": float(np.linalg.norm(error[:, end, 3:6], axis=1).mean()),
                    "attitude_end_deg": float(np.rad2deg(np.linalg.norm(error[:, end, 6:9], axis=1)).mean()),
                    "coverage_3sigma": {
                        g: float(covered[..., s].mean()) if inside.any() else 1.0 for g, s in GROUPS.items()
                    },
                    "nees_per_dof": float(results.nees[d][:, inside].mean() / 9.0) if inside.any() else float("nan"),
                }
            )
        table[name] = rows
    return table


def headline(results: Results, row: Mapping[str, Any]) -> float:
    """The figure of an outage row that stands beside what was published (else the mean planimetric error at outage end), m."""
    if results.published_figure == "planimetric_mean_m":
        return float(row["planimetric_mean_m"])
    return float(row["planimetric_end_m"]["mean"])


def rank_agreement(results: Results) -> list[float]:
    """Kendall's tau between our ranking of the published designs and the paper's, per outage; empty for fewer than three designs."""
    names = [name for name in results.names if name in results.published]
    if len(names) < 3:
        return []
    table = outage_table(results)
    taus = []
    for k in range(min(len(results.outages), *(len(results.published[n]) for n in names))):
        ours = [headline(results, table[n][k]) for n in names]
        taus.append(float(kendalltau(ours, [results.published[n][k] for n in names]).statistic))
    return taus


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
            "nees_per_dof": float(results.nees[d].mean() / 9.0),
            "nees_per_dof_by_block": blocks_of(results, d),
            "nis_per_dof": float(results.nis[d].mean()),
        }
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
        "timing": dict(results.timing),
    }
    return dict(finite(document))


def blocks_of(results: Results, design: int) -> dict[str, float]:
    """Mean NEES per degree of freedom of every block that could be judged, over realizations and epochs."""
    if results.block_nees is None:
        return {}
    values = results.block_nees[design]
    return {name: float(np.nanmean(values[:, i])) for i, name in enumerate(BLOCKS) if np.isfinite(values[:, i]).any()}


def finite(document: Any) -> Any:
    """The same document with NaN (an error that has no reference) as None, which JSON can say."""
    if isinstance(document, dict):
        return {k: finite(v) for k, v in document.items()}
    if isinstance(document, list | tuple):
        return [finite(v) for v in document]
    return None if isinstance(document, float) and not np.isfinite(document) else document


def verdicts(results: Results) -> list[str]:
    """What the pooled planimetric errors at outage end say, in words, every design against the first."""
    if not results.outages:
        return []
    first, *others = results.names
    lines = []
    for name in others:
        c = results.comparison(name, first)
        if c.low is None:
            lines.append(
                f"{name} against {first}: ratio {c.ratio:.2f}; one realization cannot say whether that is chance."
            )
        elif c.different:
            word = "smaller" if c.ratio < 1 else "larger"
            lines.append(
                f"{name}: planimetric error at outage end {abs(1 - c.ratio):.0%} {word} than {first}'s "
                f"(ratio {c.ratio:.2f}, 95 % {c.low:.2f} to {c.high:.2f}, paired bootstrap p {c.p_value:.2g})."
            )
        else:
            lines.append(
                f"{name}: the data show no planimetric difference from {first} "
                f"(ratio {c.ratio:.2f}, 95 % {c.low:.2f} to {c.high:.2f}, paired bootstrap p {c.p_value:.2g})."
            )
    return lines


def write(results: Results, out: Path) -> None:
    """Write ``summary.json``, ``outages.csv``, ``errors.nc`` and ``manifest.json`` into a folder."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "summary.json").write_text(json.dumps(summary(results), indent=1), encoding="utf-8")
    (out / "manifest.json").write_text(json.dumps(results.manifest, indent=1, default=str), encoding="utf-8")
    results.to_dataset().to_netcdf(out / "errors.nc", engine="h5netcdf")
    with (out / "outages.csv").open("w", newline="", encoding="utf-8") as stream:
        rows = csv.writer(stream)
        header_written = False
        for name, outages in outage_table(results).items():
            for k, row in enumerate(outages):
                flat: dict[str, Any] = {"design": name, "outage": k + 1}
                for key, value in row.items():
                    if key == "planimetric_end_m":
                        flat |= {key: value["mean"], f"{key}_low": value["ci95"][0], f"{key}_high": value["ci95"][1]}
                    elif isinstance(value, dict):
                        flat |= {f"{key}_{g}": v for g, v in value.items()}
                    else:
                        flat[key] = value
                if not header_written:
                    rows.writerow(flat)
                    header_written = True
                rows.writerow(flat.values())
