"""What large runs cost, row by row: growth, workers, the linear twin against full flights, shards, kills.

Run: .venv/bin/python benchmarks/scale.py [PART ...] [--flights N] [--most N] [--kills N]; parts: growth, workers, twin, shards, kills; default all.
Each row prints what was asked for, what was found, and the numbers behind it.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, wait
from contextlib import ExitStack
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import yaml
from scipy.stats import binom

from insemu.cluster import cluster
from insemu.compiled import wait_for_kernels
from insemu.evaluate import (
    CACHE,
    Experiment,
    LinearTwin,
    Resources,
    analyse_designs,
    previewed,
    run_experiment,
    write,
)
from insemu.evaluate.control import control
from insemu.evaluate.running import FULL
from insemu.scenario import load

SCENARIO = Path(__file__).parents[1] / "scenarios" / "table3_reading_b.yaml"
LINEAR = 10_000
#: Rounds in which one process, a cluster of one and of two take turns (a ratio of one round is uncertain by 0.1 to 0.2 on a shared machine); turns
#: of two ways that tell what a cluster costs.
ROUNDS, TURNS = 12, 16
#: Flights that the control variate helps; the spread of a flight alone is that of all flights.
HELPED = 50
#: Realizations of the flight that shows what twenty minutes take (one node of 64, one of 8), and its motion.
PILOT, LONG = 72, {"builtin": "helicopter_mapping", "rate": "10 Hz"}
#: A short flight with three designs, of which thousands can be flown.
SHORT: dict[str, Any] = {
    "title": "a short flight",
    "seed": 3,
    "trajectory": {"builtin": "helicopter_mapping", "rate": "50 Hz", "duration": "60 s"},
    "truth": {"gyro": "WN(N=0.03 deg/s/sqrt(Hz)) + GM(sigma=30 deg/h, Tc=40 s)", "accel": "WN(N=90 ug/sqrt(Hz))"},
    "gnss": {"position_sigma": "5 cm", "outages": [{"start": "40 s", "duration": "10 s"}]},
    "designs": {
        "white": {"gyro": "WN(N=0.1 deg/s/sqrt(Hz))", "accel": {"truth": True}},
        "wide": {"gyro": "WN(N=0.3 deg/s/sqrt(Hz))", "accel": {"truth": True}},
        "full": {"gyro": {"truth": True}, "accel": {"truth": True}},
    },
}


def row(what: str, met: bool, said: str) -> None:
    print(f"{'met ' if met else 'OPEN'} {what}: {said}", flush=True)


def scenario(folder: Path, **changes: Any) -> Path:
    path = folder / "short.yaml"
    path.write_text(yaml.safe_dump(SHORT | changes, sort_keys=False), encoding="utf-8")
    return path


def size_of(folder: Path) -> float:
    """MB of all files."""
    return sum(f.stat().st_size for f in folder.rglob("*") if f.is_file()) / 1e6


def private() -> float:
    """Memory of this process alone, without the pages of libraries that processes share, MiB."""
    text = Path("/proc/self/status").read_text(encoding="ascii")
    return float(text.split("RssAnon:")[1].split()[0]) / 1024


class Watched:
    """The largest memory of this process alone, looked at every 20 ms from when it is made."""

    def __init__(self) -> None:
        self.most = 0.0
        threading.Thread(target=self._look, daemon=True).start()

    def _look(self) -> None:
        while True:
            self.most = max(self.most, private())
            time.sleep(0.02)


def grown(path: str, count: int, folder: str) -> None:
    """One run in a process of its own: CPU seconds per realization, largest memory, disk."""
    watched = Watched()
    experiment = Experiment(load(path), path)
    for name in experiment.beliefs:
        experiment.filter(name)
    wait_for_kernels()
    run_experiment(experiment, realizations=1)  # loads what is compiled
    before = private()
    started = time.process_time()
    results = run_experiment(experiment, realizations=count, resources=Resources(workers=1, cache=Path(folder) / CACHE))
    _ = results.total
    flown = time.process_time() - started
    write(results, Path(folder))
    resident = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    found = {"cost": flown / count, "before": before, "peak": watched.most, "resident": resident}
    print(json.dumps(found | {"disk": size_of(Path(folder)), "epochs": results.t.size}))


def _grown(path: Path, count: int, folder: Path) -> dict[str, float]:
    """A run in a process of its own, see :func:`grown`."""
    command = [sys.executable, __file__, "grown", str(path), str(count), str(folder / str(count))]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    found: dict[str, float] = json.loads(said.splitlines()[-1])
    return found


def growth(most: int) -> None:
    """Cost, memory and disk from 24 realizations on, and what they come to at 10,000 flights of 20 minutes."""
    found = {}
    with tempfile.TemporaryDirectory() as kept:
        path = scenario(Path(kept))
        for count in sorted({24, 240, most}):
            found[count] = _grown(path, count, Path(kept))
            print(f"  {count} realizations: " + ", ".join(f"{k} {v:.4g}" for k, v in found[count].items()), flush=True)
    low, high = found[24], found[most]
    row(
        "cost per realization flat within 10 %",
        high["cost"] < 1.1 * low["cost"],
        f"{high['cost'] / low['cost']:.3f} of that of 24 at {most}",
    )
    row(
        "memory flat within 10 %",
        high["peak"] < 1.1 * low["peak"],
        f"{low['peak']:.0f} MiB at 24, {high['peak']:.0f} at {most}",
    )
    print("  sampled at 10 Hz, the epochs of 20 min x 3 designs and 3 outages:")
    with tempfile.TemporaryDirectory() as kept:
        outages = [{"start": f"{k} min", "duration": "60 s"} for k in (7, 11, 15)]
        path = scenario(Path(kept), trajectory=LONG, gnss=SHORT["gnss"] | {"outages": outages})
        long = _grown(path, PILOT, Path(kept))
        print(f"  {PILOT} realizations: " + ", ".join(f"{k} {v:.4g}" for k, v in long.items()), flush=True)
        with xr.open_dataset(Path(kept) / str(PILOT) / "errors.nc", group="runs") as runs:
            each = runs.nbytes / PILOT  # bytes of the values that every realization adds
        node = max(f.stat().st_size for f in (Path(kept) / str(PILOT) / CACHE).glob("*/*+*"))
    held = sum(int(digit) for digit in np.base_repr(LINEAR, 8))  # nodes that 10,000 realizations end in
    disk = (
        long["disk"] + ((held - 2) * node + 2 * each * LINEAR + 300 * LINEAR) / 1e6
    )  # in nodes and in errors.nc; 300 bytes in summary.json
    row(
        "10,000 x 20 min x 3 designs under 200 MB on disk",
        disk < 200,
        f"{disk:.0f} MB: {each / 1e3:.2f} kB each, {held} nodes of at most {node / 1e6:.1f} MB",
    )
    with tempfile.TemporaryDirectory() as kept:  # what so many realizations add, on flights of a minute
        outages = [{"start": f"{k} s", "duration": "3 s"} for k in (20, 35, 50)]
        trajectory = SHORT["trajectory"] | {"rate": LONG["rate"]}
        path = scenario(Path(kept), trajectory=trajectory, gnss=SHORT["gnss"] | {"outages": outages})
        few, many = (_grown(path, count, Path(kept)) for count in (PILOT, LINEAR))
    added = many["peak"] - few["peak"]
    print(f"  {LINEAR} flights of a minute take {added:.0f} MiB more than {PILOT}", flush=True)
    memory = (long["peak"] + added) * 2**20 / 1e6
    row(
        "and under 300 MB of a process's own memory",
        memory < 300,
        f"{memory:.0f} MB; resident with shared libraries {long['resident']:.0f} MiB",
    )
    with tempfile.TemporaryDirectory() as kept:
        full = _grown(SCENARIO, FULL + 1, Path(kept))
    row(
        "Table III at 100 Hz, records of 4 h: under 300 MB of a process's own memory",
        full["peak"] * 2**20 / 1e6 < 300,
        f"{full['peak'] * 2**20 / 1e6:.0f} MB at its peak, {full['cost']:.2f} CPU s each",
    )


_own: list[Experiment] = []


def _made(path: Path) -> None:
    _own.append(Experiment(load(path), path))
    _alone(1)


def _alone(count: int) -> None:
    for k in range(count):
        _own[0].realization(k)


def workers(count: int) -> None:
    """See :func:`throughput`; on flights of twenty minutes, which large runs fly, and of ten, of which a cluster takes a larger share."""
    for trajectory in (LONG, SHORT["trajectory"] | {"duration": "10 min"}):
        throughput(trajectory | {"rate": "100 Hz"}, count)


def throughput(trajectory: dict[str, Any], count: int) -> None:
    """Throughput of one and two processes of a cluster, of two processes without one, and what the cluster costs beside the work.

    A processor's speed wanders by a tenth within minutes, so they take turns: for the cost of a cluster many, first one and then the other in
    front. A turn is a run of ``count``: in turns of four, the way of the first and the last one counts, too. Two processes that know nothing
    of each other tell what the machine's second core is worth.
    """
    with ExitStack() as stack:
        kept = stack.enter_context(tempfile.TemporaryDirectory())
        one = stack.enter_context(cluster("local", 1))
        path = scenario(Path(kept), trajectory=trajectory)
        experiment = Experiment(load(path), path)
        minutes = float(np.ptp(experiment.world.imu.t)) / 60.0
        ways = {"here": Resources(), "one": Resources(executor=one)}

        def seconds(name: str, many: int) -> float:
            started = time.perf_counter()
            if name in ways:
                run_experiment(experiment, realizations=many, resources=ways[name])
            else:
                wait([process.submit(_alone, many // 2) for process in apart])
            return time.perf_counter() - started

        for name in ways:  # kernels and inputs get there
            seconds(name, 2)
        pairs = np.array(
            [
                [seconds(name, count) for name in ("here", "one")[:: 1 - 2 * (k % 2)]][:: 1 - 2 * (k % 2)]
                for k in range(TURNS)
            ]
        )
        flight = np.median(pairs[:, 0]) / count
        ratios = 100 * np.log(pairs[:, 1] / pairs[:, 0])
        cost, error = ratios.mean(), ratios.std(ddof=1) / np.sqrt(TURNS)
        row(
            f"Dask costs less than 3 % at one realization of {minutes:.0f} min in a task",
            bool(cost < 3),
            f"{cost:+.1f} %, standard error {error:.1f}, of {flight:.2f} s",
        )
        ways["two"] = {"workers": 2, "executor": stack.enter_context(cluster("local", 2))}
        apart = [
            stack.enter_context(ProcessPoolExecutor(1, get_context("spawn"), initializer=_made, initargs=(path,)))
            for _ in range(2)
        ]
        for name in ("two", "apart"):
            seconds(name, 4)
        names = ("here", "apart", "two", "one")  # what is compared lies side by side
        rounds = np.array(
            [[seconds(name, count) for name in names[:: 1 - 2 * (k % 2)]][:: 1 - 2 * (k % 2)] for k in range(ROUNDS)]
        )
        middle = dict(zip(names, np.median(rounds, axis=0), strict=True))
        print(
            f"  {count} realizations, {ROUNDS} rounds: here {middle['here']:.2f} s, one {middle['one']:.2f}, two {middle['two']:.2f}, "
            f"apart {middle['apart']:.2f}; load {os.getloadavg()[0]:.1f}"
        )
        gains = np.log(rounds[:, [3, 0]] / rounds[:, [2, 1]])
        (more, own), (error, own_error) = np.exp(gains.mean(axis=0)), gains.std(axis=0, ddof=1) / np.sqrt(ROUNDS)
        row(
            f"a second worker gives at least 1.8 times the throughput with flights of {minutes:.0f} min",
            bool(more >= 1.8),
            f"{more:.2f}, standard error {more * error:.2f}; two processes without a cluster {own:.2f}, standard error {own * own_error:.2f}",
        )


def twin(flights: int) -> None:
    """The linear twin and the control variate on Table III."""
    experiment = Experiment(load(SCENARIO, overrides={"smoother": False}), SCENARIO)
    for name in experiment.beliefs:
        experiment.filter(name)
    experiment.realization(0)  # compiles
    few = min(HELPED, flights)
    started = time.process_time()
    with tempfile.TemporaryDirectory() as kept:
        results = run_experiment(experiment, realizations=flights, resources=Resources(cache=Path(kept)))
        per_flight = (time.process_time() - started) / flights
        first = run_experiment(experiment, realizations=few, resources=Resources(cache=Path(kept)))
    started = time.process_time()
    linear = LinearTwin(experiment)
    made = time.process_time() - started
    started = time.process_time()
    preview = previewed(linear, LINEAR)
    seconds = made + time.process_time() - started
    started = time.process_time()
    cells_of = control(first, linear, linear.draw(LINEAR, linear.rng))
    helping = made + time.process_time() - started
    print(
        f"  {flights} flights {flights * per_flight:.0f} CPU s, preview {seconds:.0f}, help for {few} {helping:.0f}",
        flush=True,
    )
    for name, beyond in preview.beyond.items():
        print(f"  {name} is not linear: {beyond.reason}")
    times = LINEAR * per_flight / seconds
    row(
        f"{LINEAR} linear realizations at least 60 times cheaper",
        times >= 60,
        f"{times:.0f} times: {seconds:.1f} CPU s, a flight of {len(experiment.beliefs)} designs {per_flight:.2f}",
    )
    exact = analyse_designs(experiment)
    print(
        "  design, outage: mean of flights, of linear; 95 % quantiles; rms of flights, linear, exact; correlation; "
        "plain interval at equal cost over the helped one"
    )
    narrower = expected = agree = cells = 0
    for name in experiment.beliefs:
        full = results.planimetric_ends(name)
        for k in range(full.shape[1]):
            ours, told = full[:, k], preview.figures_of(name, k)
            found = cells_of[name][k]
            i = int(np.argmin(np.abs(exact[name].t - experiment.world.imu.t[linear.ends[k]])))
            # of flights alone for all that time: by the spread of all flights, and by that which the cheap runs tell
            own, equal = (
                2 * 1.96 * spread / np.sqrt(few + helping / per_flight) for spread in (ours.std(ddof=1), found.spread)
            )
            narrower += own >= 3.0 * found.mean.width
            expected += equal >= 3.0 * found.mean.width
            cells += 1
            error = np.hypot(ours.std(ddof=1) / np.sqrt(flights), told.mean.width / 3.92)
            q = told.quantile_95
            quantile = _quantile_interval(ours)
            inside = quantile[0] <= q <= quantile[1]
            agree += (
                abs(ours.mean() - told.mean.value) < 2.77 * error and inside
            )  # 95 % of nine cells together for the means (Bonferroni)
            print(
                f"  {name}, {k + 1}: {ours.mean():.1f} +- {1.96 * ours.std(ddof=1) / np.sqrt(flights):.1f}, {told.mean.value:.1f}; "
                f"{np.quantile(ours, 0.95):.0f} ({quantile[0]:.0f} to {quantile[1]:.0f}), {q:.0f}; "
                f"{np.sqrt((ours**2).mean()):.0f}, {told.rms:.0f}, {np.hypot(*exact[name].rms[i, :2]):.0f}; "
                f"{found.correlation:.4f} {found.by if found.used else 'refused'}; "
                f"{own / found.mean.width:.1f} (cheap runs' spread: {equal / found.mean.width:.1f})"
            )
    row(
        "means and 95 % quantiles agree with full flights",
        agree == cells,
        f"{agree} of {cells} cells, {flights} flights",
    )
    row(
        "the control variate's interval is at most a third at equal cost in 7 of 9 cells",
        narrower >= 7,
        f"{narrower} of {cells} by the spread of the {flights} flights, {expected} by the spread that the cheap runs tell; {few} flights helped",
    )


def _quantile_interval(values: np.ndarray) -> tuple[float, float]:
    """Order statistics that hold the 95 % quantile of nine cells together with 95 % (binomial, Bonferroni)."""
    ordered, n = np.sort(values), values.size
    low, high = binom.ppf([0.025 / 9, 1 - 0.025 / 9], n, 0.95).astype(int)
    return float(ordered[max(low - 1, 0)]), float(ordered[min(high, n - 1)])


def figures(folder: Path) -> str:
    return (folder / "summary.json").read_text(encoding="utf-8")


def insemu(*arguments: str) -> int:
    return subprocess.run([sys.executable, "-m", "insemu", *arguments], capture_output=True, check=False).returncode


def shards() -> None:
    """Seven shards in random order, one twice, one killed and repeated; a missing one is named."""
    with tempfile.TemporaryDirectory() as kept:
        path, plain, out = scenario(Path(kept), realizations=70), Path(kept) / "plain", Path(kept) / "out"
        insemu("run", str(path), "--output", str(plain))
        order = [1, 2, 3, 4, 5, 6, 7, 4]
        random.Random(1).shuffle(order)
        late, killed = order.pop(), None
        for k in order:
            if k == order[2] and killed is None:
                killed = subprocess.Popen(
                    [sys.executable, "-m", "insemu", "run", str(path), "--shard", f"{k}/7", "--output", str(out)],
                    stderr=subprocess.DEVNULL,
                )
                while not list((out / CACHE).glob(f"*/{k - 1:04d}*")) and killed.poll() is None:
                    time.sleep(0.02)
                killed.kill()
                killed.wait()
            insemu("run", str(path), "--shard", f"{k}/7", "--output", str(out))
        said = subprocess.run(
            [sys.executable, "-m", "insemu", "merge", str(out)], capture_output=True, text=True, check=False
        )
        named = late in order or (said.returncode == 2 and f"{late}/7" in said.stderr)
        insemu("run", str(path), "--shard", f"{late}/7", "--output", str(out))
        merged = insemu("merge", str(out))
        row(
            "shards in any order, one twice, one killed: the plain run's bytes",
            merged == 0 and named and figures(plain) == figures(out),
            f"order {order}, then {late}",
        )


def below(process: int) -> list[int]:
    """Processes that a process started, by any of its threads, and those that they started."""
    found: list[int] = []
    for thread in Path(f"/proc/{process}/task").glob("*"):
        try:
            found += map(int, (thread / "children").read_text(encoding="ascii").split())
        except OSError:  # it ended meanwhile
            continue
    return [k for child in found for k in (child, *below(child))]


def kills(count: int) -> None:
    """kill -9 of workers and of the client at random moments; the same command until it ends."""
    rng = random.Random(7)
    with tempfile.TemporaryDirectory() as kept:
        path, plain, out = scenario(Path(kept), realizations=400), Path(kept) / "plain", Path(kept) / "out"
        insemu("run", str(path), "--output", str(plain))
        command = [
            sys.executable,
            "-m",
            "insemu",
            "run",
            str(path),
            "--cluster",
            "local",
            "--workers",
            "4",
            "--output",
            str(out),
        ]
        left = {"worker": count - count // 3, "client": count // 3}
        starts = 0
        client: subprocess.Popen[bytes] | None = None
        while client is None or client.poll() is None or client.returncode != 0:
            if client is None or client.poll() is not None:
                client = subprocess.Popen(
                    command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True
                )
                starts += 1
            time.sleep(rng.uniform(1.0, 6.0))
            kinds = [kind for kind, n in left.items() if n]
            if not kinds or client.poll() is not None:
                if client.poll() == 0 and kinds:  # it ended before all kills: from the start, with what is left
                    shutil.rmtree(out)
                    client = None
                continue
            kind = rng.choice(kinds)
            workers_ = [p for p in below(client.pid) if b"spawn_main" in _command(p)]
            if kind == "worker" and not workers_:
                continue
            _kill(rng.choice(workers_) if kind == "worker" else client.pid)
            left[kind] -= 1
            if kind == "client":
                client.wait()
                for p in workers_:
                    _kill(p)
        same = figures(plain) == figures(out)
        row(
            f"{count} times kill -9 of workers and client of 4: the same bytes",
            same,
            f"{count - count // 3} workers, {count // 3} clients, {starts} starts",
        )


def _command(process: int) -> bytes:
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:
        return b""


def _kill(process: int) -> None:
    try:
        os.kill(process, signal.SIGKILL)
    except ProcessLookupError:
        pass


def main() -> None:
    if sys.argv[1:2] == ["grown"]:
        grown(sys.argv[2], int(sys.argv[3]), sys.argv[4])
        return
    parser = argparse.ArgumentParser()
    parser.add_argument("parts", nargs="*")
    parser.add_argument("--flights", type=int, default=400, help="full flights of Table III")
    parser.add_argument("--most", type=int, default=2400, help="realizations of the longest run of growth")
    parser.add_argument("--count", type=int, default=24, help="realizations of the runs with one and two workers")
    parser.add_argument("--kills", type=int, default=20)
    given = parser.parse_args()
    parts: dict[str, Callable[[], None]] = {
        "growth": lambda: growth(given.most),
        "workers": lambda: workers(given.count),
        "twin": lambda: twin(given.flights),
        "shards": shards,
        "kills": lambda: kills(given.kills),
    }
    for name in given.parts or parts:
        parts[name]()


if __name__ == "__main__":
    main()
