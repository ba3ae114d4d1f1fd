"""Foreign recordings through ``insemu gap``.

python -m benchmarks.foreign --recordings 40 --workers 2 --log results/foreign.jsonl      # all kinds in turns; goes on where it stopped
python -m benchmarks.foreign --kinds none --recordings 100 --seed 1000                      # nothing hidden, every vehicle shakes
python -m benchmarks.foreign --recordings 75 --trained 400 --examples results/examples.jsonl  # beside a classifier that learned from 400 others
python -m benchmarks.foreign --write results/foreign --recordings 6                         # the files: recording, belief, what is hidden
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress

from benchmarks.foreign.baselines import judgement
from benchmarks.foreign.flights import AIRCRAFT
from benchmarks.foreign.judge import KINDS, Job, answer, drawn, scores, write
from benchmarks.foreign.motion import RATE, VEHICLES
from benchmarks.foreign.sensors import Logger
from benchmarks.foreign.trained import learned
from insemu.work import Lines, processes, run_items


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw, look, count."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.foreign", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=["none", "one", "two", "three", "outside"])
    parser.add_argument("--recordings", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=360.0, help="length of a recording")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--no-vibration", action="store_true", help="nothing shakes the vehicles but their own way of moving"
    )
    parser.add_argument(
        "--hold-out", action="store_true", help="score on the last third as well (about twice the time)"
    )
    parser.add_argument("--no-baselines", action="store_true")
    parser.add_argument(
        "--trained", type=int, default=0, help="recordings from which a classifier learns first, one more baseline"
    )
    parser.add_argument("--examples", type=Path, help="keep what it learns from in this file and go on from there")
    parser.add_argument(
        "--vehicles", nargs="+", choices=[*VEHICLES, *AIRCRAFT], default=list(VEHICLES), metavar="VEHICLE",
        help=f"what moves, in turns of chance: {', '.join(VEHICLES)}; flown by JSBSim: {', '.join(AIRCRAFT)}",
    )  # fmt: skip
    usual, how = Logger(), parser.add_argument_group("how it is recorded")
    how.add_argument("--imu-hz", type=int, default=usual.imu_hz, help="a divisor of 1000")
    how.add_argument("--fix-hz", type=float, default=usual.fix_hz, help="of every receiver instead of 1 or 4")
    how.add_argument("--no-velocities", action="store_true", help="receivers give positions alone")
    how.add_argument("--tunnels", type=int, default=usual.tunnels, help="stretches of 30 s without fixes")
    how.add_argument("--lost", type=float, default=usual.lost, help="share of the rows of the IMU that never came")
    how.add_argument("--repeated", type=float, default=usual.repeated, help="share that repeats the row before")
    how.add_argument("--jitter", type=float, default=usual.jitter, help="stamps of the IMU stray by up to this, s")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--log", type=Path, help="keep finished recordings in this file and go on from there")
    parser.add_argument("--write", type=Path, help="write the recordings to this folder instead of looking at them")
    parser.add_argument("--wrong", action="store_true", help="list the recordings that were answered wrongly")
    given = parser.parse_args(arguments)
    if given.trained and given.no_baselines:
        parser.error("--trained is one of the baselines that --no-baselines leaves out")
    if given.examples and not given.trained:
        parser.error("--examples keeps what --trained learns from, which is not asked for")
    if given.imu_hz < 1 or RATE % given.imu_hz:
        parser.error(f"--imu-hz is {given.imu_hz}, expected a divisor of {RATE}")
    logger = Logger(
        given.imu_hz, given.fix_hz, not given.no_velocities, given.tunnels, given.lost, given.repeated, given.jitter
    )
    jobs = [
        Job(
            given.kinds[k % len(given.kinds)],
            given.seed + k,
            given.seconds,
            not given.no_vibration,
            given.hold_out,
            not given.no_baselines,
            logger,
            tuple(given.vehicles),
        )
        for k in range(given.recordings)
    ]
    if given.write:
        given.write.mkdir(parents=True, exist_ok=True)
        for job in jobs:
            write(given.write / f"{job.kind}-{job.seed}", *drawn(job))
        return
    store: Lines[dict[str, Any]] | None = None
    if given.log:
        store = Lines(given.log, lambda a: {"answer": a}, lambda line: dict(line["answer"]), "foreign recordings")
    with Progress(console=Console(stderr=True)) as progress, processes(given.workers) as pool:
        task = progress.add_task("recordings", total=len(jobs))
        found = run_items(
            {job.key: job for job in jobs}, answer, pool=pool, store=store, done=lambda _: progress.advance(task)
        )
        forest = learned(given.trained, given.seconds, given.examples, pool) if given.trained else None
    answers: list[dict[str, Any]] = [json.loads(json.dumps(a)) for a in found.values()]
    for a in answers if forest else ():
        if forest and a["baselines"]:
            named = forest.named(a["baselines"]["features"])
            a["baselines"]["forest"] = judgement(named, [(h["effect"], h["sensor"]) for h in a["hidden"]])
    for label, figure in scores(answers):
        print(f"{label:68s} {figure}")
    for a in answers if given.wrong else ():
        named = [f"{s['effect']} {s['sensor']} {''.join(s['axes'])} {s['gain_nats']:.0f}" for s in a["findings"]]
        hidden = [f"{h['effect']} {h['sensor']} {h['axis']} {h['nats']:.0f}" for h in a["hidden"]]
        exact = sorted(k for r in a["right"] for k, v in enumerate(r) if v) == list(range(len(hidden)))
        if not exact or len(named) != len(hidden) or (not hidden and a["verdict"] != "nothing missing"):
            print(f"{a['kind']}-{a['seed']} {a['vehicle']}: hidden {hidden}; {a['verdict']}: {named} {a['remainder']}")


if __name__ == "__main__":
    main()
