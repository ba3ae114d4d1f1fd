"""Realizations flown, kept and gathered: every realization is one independent work item.

Finished items are kept under the experiment's digest, so an interrupted run goes on where it stopped, whatever the number of workers. Of more than
:data:`FULL` realizations what is finished is added up on the way (:mod:`insemu.evaluate.tally`), and only a chosen few stay with all their epochs.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from insemu.augment import NAVIGATION
from insemu.compiled import wait_for_kernels
from insemu.evaluate.dataset import of_bytes, of_realizations, to_bytes
from insemu.evaluate.experiment import Experiment
from insemu.evaluate.provenance import surroundings
from insemu.evaluate.results import DesignInfo, Results
from insemu.evaluate.tally import BASE, Ladder, Tally, pieces, tally
from insemu.lanes import LANES
from insemu.noise import axis_unit
from insemu.work import Files, stream_items

if TYPE_CHECKING:
    import xarray as xr


Progress = Callable[[int, int, str], None]

#: Realizations after which a first answer is given.
PREVIEWED = 2
#: Most realizations that all stay with all their epochs.
FULL = 48
#: Realizations under way or waiting for their turn, per worker: what bounds the memory.
AHEAD = 3
#: Samples of realizations that fly side by side: their records, and what the filter takes of them, are in memory at the same time.
SAMPLES = 1_000_000


def silent(done: int, total: int, label: str) -> None:
    """Progress that says nothing.

    Parameters
    ----------
    done, total : int
        Realizations.
    label : str
        What is being done.
    """


@dataclass(frozen=True)
class Resources:
    """What realizations are flown with.

    Parameters
    ----------
    workers : int
        Threads (the compiled filter frees the GIL); one is the thread that calls.
    executor : Executor, optional
        Any ``concurrent.futures`` executor instead, for example a cluster's; the experiment must be picklable there.
    cache : path, optional
        Folder in which finished realizations are kept and looked for.
    progress : callable
        Called with (done, total, label).
    say : callable
        Given in words what kept realizations are not taken.
    """

    workers: int = 1
    executor: Executor | None = None
    cache: Path | None = None
    progress: Progress = silent
    say: Callable[[str], None] = lambda text: None


#: The thread that calls.
ALONE = Resources()


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
    resources: Resources = ALONE,
    preview: Callable[[Results], None] | None = None,
) -> Results:
    """Run every realization and collect.

    Parameters
    ----------
    experiment : Experiment
    realizations : int, optional
        Number to run; default the scenario's.
    resources : Resources
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
                preview(collected(experiment, dict(enumerate(there)), time.perf_counter() - started))

    if total <= FULL:
        soon = 0 if preview is None else PREVIEWED
        flown = fly(experiment, range(total), resources, done=done, soon=soon)
        return collected(experiment, dict(enumerate(flown)), time.perf_counter() - started)
    whole = condensed(experiment, range(total), resources, done=done)
    assert whole is not None
    few = sorted(chosen(whole, list(experiment.beliefs)))
    again = fly(experiment, few, replace(resources, progress=silent))  # the same numbers to the bit
    return collected(experiment, dict(zip(few, again, strict=True)), time.perf_counter() - started, whole)


def condensed(
    experiment: Experiment,
    span: range,
    resources: Resources,
    done: Callable[[xr.Dataset], None] = lambda item: None,
) -> Tally | None:
    """Fly realizations that follow each other, and add them up; what is complete takes the place of its parts among what is kept.

    Parameters
    ----------
    experiment : Experiment
    span : range
    resources, done
        As in :func:`fly`.

    Returns
    -------
    Tally
        Of all of them; None where the first is not the experiment's.
    """
    cache, say, progress = resources.cache, resources.say, resources.progress
    parts, whole = (None, None) if cache is None else (kept(experiment, cache, say), nodes(experiment, cache, say))

    def made(size: int, first: int, node: Tally) -> None:
        if parts is not None and whole is not None:
            whole.put(_node(size, first), node)
            for r in range(first, first + size, size // BASE):
                parts.drop(_node(size // BASE, r))

    def held(size: int, first: int) -> bool:
        return whole is not None and whole.get(_node(size, first)) is not None

    plan = pieces(span, held)
    missing = [first for size, first in plan if size == 1]
    before = len(span) - len(missing)
    here = replace(resources, progress=lambda done, _, what: progress(before + done, len(span), what))
    flown = fly(experiment, missing, here, done=done)
    ladder, t = Ladder(span.start, made), experiment.world.output_times
    for size, first in plan:
        if size == 1:
            item = {str(k): v.to_numpy() for k, v in next(flown).data_vars.items() if v.dtype.kind in "fiu"}
            ladder.push(tally(item, t, experiment.world.outage_windows))
        else:
            assert whole is not None
            node = whole.get(_node(size, first))
            assert node is not None  # it was there a moment ago
            ladder.push(node)
    flown.close()
    return None if span.start else ladder.total()


def fly_part(experiment: Experiment, span: range, resources: Resources) -> None:
    """Fly a part of an experiment's realizations for those who gather all of them later, and keep it.

    Parameters
    ----------
    experiment : Experiment
    span : range
    resources : Resources
    """
    if experiment.realizations > FULL:
        condensed(experiment, span, resources)
    else:
        for _ in fly(experiment, span, resources):
            pass


def chosen(whole: Tally, designs: Sequence[str]) -> dict[int, str]:
    """The realizations that stay with all their epochs, and why: the first, and of every design the worst and the median one.

    Parameters
    ----------
    whole : Tally
    designs : sequence of str
    """
    error = whole.runs["end_error"]
    out = {0: "the first"}
    if error.shape[2]:
        for name, size in zip(designs, np.hypot(error[..., 0], error[..., 1]).mean(axis=2), strict=True):
            order = np.argsort(size, kind="stable")
            for number, word in ((order[-1], "largest"), (order[(order.size - 1) // 2], "median")):
                told = f"{word} error of {name}"
                out[int(number)] = f"{out[int(number)]}, {told}" if int(number) in out else told
    return out


def fly(
    experiment: Experiment,
    realizations: Sequence[int],
    resources: Resources = ALONE,
    *,
    done: Callable[[xr.Dataset], None] = lambda item: None,
    soon: int = 0,
) -> Generator[xr.Dataset]:
    """Fly some realizations, or take them from where they are kept, and yield them in their order; few are held at a time.

    Parameters
    ----------
    experiment : Experiment
    realizations : sequence of int
    resources : Resources
    done : callable
        Given every realization as it is there, in any order.
    soon : int
        Realizations at the beginning that wait for no other.
    """
    workers, progress, cache, say = resources.workers, resources.progress, resources.cache, resources.say
    progress(0, len(realizations), "preparing")
    for name in experiment.beliefs:  # fits are made once, before the workers, and whatever is wrong with them is said
        experiment.filter(name)
    wait_for_kernels()
    finished = 0

    def step(items: list[xr.Dataset]) -> None:
        nonlocal finished
        for item in items:
            finished += 1
            progress(finished, len(realizations), "flying")
            done(item)

    alone = None if cache is None else kept(experiment, cache, say)
    store = None if alone is None else _Together(alone)
    with ExitStack() as stack:
        pool = resources.executor
        if (
            pool is None and workers > 1
        ):  # one worker is this thread: what was freed here is used again, another thread has memory of its own
            pool = stack.enter_context(ThreadPoolExecutor(max_workers=workers))
        width = max(workers, getattr(pool, "width", 1))
        is_kept = (lambda r: False) if alone is None else (lambda r: _node(1, r) in alone)
        together = [
            group
            for part in (realizations[:soon], realizations[soon:])
            for group in groups(part, is_kept, most(experiment), width)
        ]
        keys = {" ".join(_node(1, r) for r in group): group for group in together}
        window = AHEAD * width
        for _, items in stream_items(keys, experiment.side_by_side, pool=pool, store=store, done=step, window=window):
            yield from items


class _Together:
    """What is kept of realizations, one by one, for groups of them; a key holds the names of all."""

    def __init__(self, kept: Files[xr.Dataset]) -> None:
        self._kept = kept

    def get(self, key: str) -> list[xr.Dataset] | None:
        """Return a finished group, or None."""
        found = []
        for name in key.split():
            if (item := self._kept.get(name)) is None:
                return None
            found.append(item)
        return found

    def put(self, key: str, result: list[xr.Dataset]) -> None:
        """Keep a finished group."""
        for name, item in zip(key.split(), result, strict=True):
            self._kept.put(name, item)


def most(experiment: Experiment) -> int:
    """Realizations that fly side by side at most: as many as there are lanes, fewer where long records would fill the memory."""
    return max(1, min(LANES, int(SAMPLES / experiment.samples)))


def groups(
    realizations: Sequence[int], is_kept: Callable[[int], bool], size: int, width: int = 1
) -> list[tuple[int, ...]]:
    """Realizations in the groups that fly side by side, in their order.

    What is kept already comes alone. The rest is cut so that every worker has as many groups of the same size.

    Parameters
    ----------
    realizations : sequence of int
    is_kept : callable
        Whether one is kept already.
    size : int
        Most of a group.
    width : int
        Workers.
    """
    out: list[tuple[int, ...]] = []
    for there, alike in groupby(realizations, is_kept):
        members = list(alike)
        count = 1 if there else -(-len(members) // (width * -(-len(members) // (width * size))))
        out += [tuple(members[k : k + count]) for k in range(0, len(members), count)]
    return out


def _node(size: int, first: int) -> str:
    """Name of what is kept of so many realizations from this one on."""
    return f"{first:05d}" if size == 1 else f"{first:05d}+{size}"


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


def nodes(experiment: Experiment, cache: Path, say: Callable[[str], None] = lambda text: None) -> Files[Tally]:
    """Where sums over finished realizations are kept.

    Parameters
    ----------
    experiment : Experiment
    cache : path
    say : callable
        Told in words of what is not taken.
    """
    return Files(cache / experiment.digest, experiment.digest, Tally.to_bytes, Tally.of_bytes, say)


def not_kept(experiment: Experiment, cache: Path) -> list[int]:
    """Realizations that are neither kept alone nor in a sum.

    Parameters
    ----------
    experiment : Experiment
    cache : path
    """
    alone, sums = kept(experiment, cache), nodes(experiment, cache)
    plan = pieces(range(experiment.realizations), lambda size, first: _node(size, first) in sums)
    return [first for size, first in plan if size == 1 and _node(1, first) not in alone]


def collected(
    experiment: Experiment, items: Mapping[int, xr.Dataset], seconds: float, whole: Tally | None = None
) -> Results:
    """The results of realizations that were flown.

    Parameters
    ----------
    experiment : Experiment
    items : mapping of number to Dataset
        What :meth:`Experiment.realization` gave.
    seconds : float
        How long it took.
    whole : Tally, optional
        What is kept of all of them; made from the items unless given.
    """
    s = experiment.scenario
    data = of_realizations(items)
    designs = {}
    for d, (name, belief) in enumerate(experiment.beliefs.items()):
        n = int(data["states"][d])
        behind = [str(x) for x in data["state_name"].to_numpy()[d][: n - 9]]
        designs[name] = DesignInfo(n, (*NAVIGATION, *behind), belief.models)
    timing = {
        "filter_epochs": int((data if whole is None else whole.runs)["epochs"].sum()),
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
        manifest=manifest_of(experiment),
        published=s.published.figures if s.published else {},
        nees_dof=experiment.world.compared,
        tally=whole,
    )
