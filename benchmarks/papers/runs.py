"""Scenarios flown for the papers' tables of outages."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.papers.exhibit import Cell
from insemu.evaluate import CACHE, Experiment, Resources, Results, run_experiment, within_outage
from insemu.scenario import load

#: Where flown realizations are kept; set by the command.
FOLDER = Path("results/papers")


@dataclass(frozen=True)
class Run:
    """Horizontal errors of every design, (realizations, outages) in m; of the whole run what else is asked."""

    mean: dict[str, np.ndarray]
    largest: dict[str, np.ndarray]
    end: dict[str, np.ndarray]
    results: Results


def scenario_run(path: str, variant: str | None = None) -> Run:
    """Fly a scenario (or take what was flown before)."""
    experiment = Experiment(load(path, variant=variant), path)
    results = run_experiment(experiment, resources=Resources(cache=FOLDER / CACHE))
    mean, largest, end = {}, {}, {}
    for d, name in enumerate(results.names):
        inside = [results.error[d][:, within_outage(results.t, *o), :2] for o in results.outages]
        size = [np.linalg.norm(e, axis=2) for e in inside]
        mean[name] = np.stack([e.mean(axis=1) for e in size], axis=1)
        largest[name] = np.stack([e.max(axis=1) for e in size], axis=1)
        at = [results.end_index(k) for k in range(len(results.outages))]
        end[name] = np.linalg.norm(results.error[d][:, at, :2], axis=2)
    return Run(mean, largest, end, results)


def outage_content(run: Run, rows: list[dict]) -> list[Cell]:
    """Cells of a table of [mean, largest] errors per design and outage: a drive of the paper within the middle 95 % of ours."""
    cells = []
    for k, row in enumerate(rows):
        for name, figures in row.items():
            if name in run.mean:
                for label, printed, values in zip(
                    ("mean", "largest"), figures, (run.mean[name][:, k], run.largest[name][:, k]), strict=True
                ):
                    low, high = np.percentile(values, [2.5, 97.5])
                    what = f"{row['speed_kmh']:g} km/h, {row['duration_s']} s, {name}, {label}"
                    cells.append(Cell(what, printed, float(values.mean()), float(low), float(high), "m"))
    return cells
