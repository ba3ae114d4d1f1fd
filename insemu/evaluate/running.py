"""Realizations flown, kept and gathered: every realization is one independent work item.

Finished items are kept under the experiment's digest, so an interrupted run goes on where it stopped, whatever the number of workers.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import xarray as xr

from insemu.augment import NAVIGATION
from insemu.compiled import wait_for_kernels
from insemu.evaluate.dataset import of_bytes, of_realizations, to_bytes
from insemu.evaluate.experiment import Experiment
from insemu.evaluate.provenance import surroundings
from insemu.evaluate.results import DesignInfo, Results
from insemu.noise import axis_unit
from insemu.work import Files, stream_items

Progress = Callable[[int, int, str], None]

#: Realizations after which a first answer is given.
PREVIEWED = 2


def silent(done: int, total: int, label: str) -> None:
    """Progress that says nothing.

    Parameters
    ----------
    done, total : int
        Realizations.
    label : str
        What is being done.
    """


def manifest_of(experiment: Experiment) -> dict[str, Any]:
    """What a result needs to be a result: resolved scenario, digest, seed, and what else it depends on."""
    return {
        "scenario": experiment.scenario.model_dump(mode="json"),
        "scenario_file": str(experiment.file) if experiment.file else None,
        "digest": experiment.digest,
        "seed": experiment.scenario.seed,
        **surroundings(experiment.world.files),
        "ideal_imu_distance_m": experiment.world.path_distance_m,
        "warnings": list(experiment.warnings),
        "intake": None if (card := experiment.world.card) is None else card.to_json(),
        "beliefs": {
            name: {axis: m.to_list(axis_unit(axis)) for axis, m in b.models.items()}
            for name, b in experiment.beliefs.items()
        },
    }


def run_experiment(
    experiment: Experiment,
    *,
    realizations: int | None = None,
    workers: int = 1,
    executor: Executor | None = None,
    cache: Path | None = None,
    progress: Progress = silent,
    say: Callable[[str], None] = lambda text: None,
    preview: Callable[[Results], None] | None = None,
) -> Results:
    """Run every realization and collect.

    Parameters
    ----------
    experiment : Experiment
    realizations : int, optional
        Number to run; default the scenario's.
    workers : int
        Threads (the compiled filter frees the GIL).
    executor : Executor, optional
        Any ``concurrent.futures`` executor instead, for example a cluster's; the experiment must be picklable there.
    cache : path, optional
        Folder in which finished realizations are kept and looked for.
    progress : callable
        Called with (done, total, label).
    say : callable
        Told in words of kept realizations that are not taken.
    preview : callable, optional
        Given the results of the first :data:`PREVIEWED` realizations that are there, where more will follow.

    Returns
    -------
    Results
    """
    started = time.perf_counter()
    total = experiment.realizations if realizations is None or experiment.scenario.recording else realizations
    there: list[xr.Dataset] = []

    def done(item: xr.Dataset) -> None:
        if preview is not None and len(there) < PREVIEWED < total:
            there.append(item)
            if len(there) == PREVIEWED:
                preview(collected(experiment, there, time.perf_counter() - started))

    flown = fly(
        experiment, range(total), workers=workers, executor=executor, cache=cache, progress=progress, say=say, done=done
    )
    return collected(experiment, list(flown), time.perf_counter() - started)


def fly(
    experiment: Experiment,
    realizations: Sequence[int],
    *,
    workers: int = 1,
    executor: Executor | None = None,
    cache: Path | None = None,
    progress: Progress = silent,
    say: Callable[[str], None] = lambda text: None,
    done: Callable[[xr.Dataset], None] = lambda item: None,
) -> Iterator[xr.Dataset]:
    """Fly some realizations, or take them from where they are kept, and yield them in their order; few are held at a time.

    Parameters
    ----------
    experiment : Experiment
    realizations : sequence of int
    workers, executor, cache, progress, say
        As in :func:`run_experiment`.
    done : callable
        Told of every realization as it is there, in any order.
    """
    progress(0, len(realizations), "preparing")
    for name in experiment.beliefs:  # fits are made once, before the workers, and whatever is wrong with them is said
        experiment.filter(name)
    wait_for_kernels()
    finished = 0

    def step(item: xr.Dataset) -> None:
        nonlocal finished
        finished += 1
        progress(finished, len(realizations), "flying")
        done(item)

    store = None if cache is None else kept(experiment, cache, say)
    keys = {f"{r:05d}": r for r in realizations}
    with ExitStack() as stack:
        pool = executor or stack.enter_context(ThreadPoolExecutor(max_workers=max(1, workers)))
        for _, item in stream_items(keys, experiment.realization, pool=pool, store=store, done=step):
            yield item


def kept(experiment: Experiment, cache: Path, say: Callable[[str], None] = lambda text: None) -> Files[xr.Dataset]:
    """Where finished realizations of an experiment are kept.

    Parameters
    ----------
    experiment : Experiment
    cache : path
    say : callable
        Told in words of what is not taken.
    """
    return Files(cache / experiment.digest, experiment.digest, to_bytes, of_bytes, say)


def collected(experiment: Experiment, items: Sequence[xr.Dataset], seconds: float) -> Results:
    """The results of realizations that were flown.

    Parameters
    ----------
    experiment : Experiment
    items : sequence of Dataset
        What :meth:`Experiment.realization` gave.
    seconds : float
        How long it took.
    """
    s = experiment.scenario
    data = of_realizations(items)
    designs = {}
    for d, (name, belief) in enumerate(experiment.beliefs.items()):
        n = int(data["states"][d])
        behind = [str(x) for x in data["state_name"].to_numpy()[d][: n - 9]]
        designs[name] = DesignInfo(n, (*NAVIGATION, *behind), belief.models)
    timing = {
        "filter_epochs": int(data["epochs"].sum()),
        "filter_seconds": float(data["seconds"].sum()),
        "wall_seconds": seconds,
    }
    return Results(
        title=s.title,
        digest=experiment.digest,
        seed=s.seed,
        data=data,
        designs=designs,
        outages=experiment.world.outage_windows,
        truth=experiment.world.truth_at_outputs,
        timing=timing,
        manifest=manifest_of(experiment) | {"timing": timing},
        published=s.published.figures if s.published else {},
        nees_dof=experiment.world.compared,
    )
