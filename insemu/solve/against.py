"""A solved recording against a scenario of the same recording: the same outages, the same reference, the designs of both."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from pathlib import Path

import numpy as np

from insemu.errors import InputError
from insemu.evaluate import Experiment
from insemu.scenario import load
from insemu.solve.outages import Outages, cut_everywhere
from insemu.solve.solution import Solution


@dataclass(frozen=True)
class Comparison:
    """Outages that begin at the same seconds, of the solution and of every design of the scenario.

    Parameters
    ----------
    solved : Outages
    designs : dict of design to Outages
    """

    solved: Outages
    designs: dict[str, Outages]


def compare_with(solution: Solution, scenario: str | Path, *, workers: int = 1) -> Comparison:
    """Score the designs of a scenario by the outages of a solution.

    The scenario's own outages are left out, its mounting, clock, lever arm and start are its own. The reference is the same: the fixes,
    with their stated variance subtracted.

    Parameters
    ----------
    solution : Solution
    scenario : path
        With the same recording.
    workers : int
        Threads.

    Raises
    ------
    InputError
        A scenario of another recording, or without one.
    """
    read = load(scenario)
    read = read.model_copy(update={"gnss": read.gnss.model_copy(update={"outages": ()}), "smoother": False})
    if read.recording is None:
        raise InputError("has no recording, expected one of the recording that is solved", where=str(scenario))
    experiment = Experiment(read, scenario)
    world = experiment.world
    flown = world.recording(0)
    assert flown.gnss is not None
    start, sigma = world.start(0, flown.imu)
    fixes = getattr(world, "gnss", flown.gnss)
    found: dict[str, Outages] = {}
    for name in read.designs:
        ekf = experiment.ekf(name)
        ekf = ekf.with_options(store="fixes", node_every=1.0, output_every=ekf.options.covariance_every * 100)
        known = experiment.compensated(name, flown, start, sigma)
        assert known.gnss is not None
        imu = world.imu_for(known.imu, ekf)
        run = ekf.run(imu, experiment.believed(name, known.gnss), start, sigma, aids=known.aids)
        found[name] = cut_everywhere(ekf, run, imu, fixes, workers=workers)
    same = _at_the_same(solution.taken.outages, *found.values())
    if not same[0].start.size:
        raise InputError("no outage of the solution lies in this scenario's time", where=str(scenario))
    return Comparison(same[0], dict(zip(found, same[1:], strict=True)))


def _at_the_same(*each: Outages) -> list[Outages]:
    """The outages of each that begin at seconds at which one of every other begins; of two within a second the first."""
    seconds = [np.unique(np.round(o.start), return_index=True) for o in each]
    common = reduce(np.intersect1d, [own for own, _ in seconds])
    out = []
    for o, (own, first) in zip(each, seconds, strict=True):
        kept = np.zeros(o.start.size, dtype=bool)
        kept[first[np.isin(own, common)]] = True
        out.append(o.rows(kept))
    return out
