"""The filter on a GPU against this machine's cores: the same numbers, and how many flights a second.

Run: .venv/bin/python benchmarks/gpu.py [--flights N]; needs the extra ``gpu`` and a GPU.
"""

from __future__ import annotations

import argparse
import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from insemu.compiled import wait_for_kernels
from insemu.evaluate import Experiment, run_experiment
from insemu.filters import GPU_THREADS, Gpu, gpu
from insemu.scenario import load

SCENARIO = Path(__file__).parents[1] / "scenarios" / "table3_reading_b.yaml"
#: Flights side by side, for the time that the GPU takes alone.
SIDE_BY_SIDE = (1, 64, 512, 1024)
#: Realizations whose numbers are compared.
COMPARED = 4


def experiment_of(device: Gpu | None) -> Experiment:
    experiment = Experiment(load(SCENARIO, overrides={"smoother": False}), SCENARIO, device)
    for name in experiment.beliefs:
        experiment.filter(name)
    return experiment


def same_numbers(here: Experiment, there: Experiment) -> None:
    """Largest difference of what a realization gives, relative to the largest of its kind."""
    worst, at = 0.0, ""
    for k in range(COMPARED):
        one, other = here.realization(k), there.realization(k)
        for name in one.data_vars:
            a, b = one[name].to_numpy(), other[name].to_numpy()
            if a.dtype.kind != "f" or name in ("seconds",):
                continue
            scale = np.nanmax(np.abs(a), initial=0.0)
            off = float(np.nanmax(np.abs(a - b), initial=0.0) / scale) if scale else 0.0
            worst, at = max((worst, at), (off, str(name)))
    print(f"largest relative difference of {COMPARED} realizations, all designs, all values: {worst:.1e} ({at})")


class Listening(Gpu):
    """A GPU that remembers the last flight of each design."""

    def __init__(self) -> None:
        super().__init__()
        self.heard: dict[bytes, tuple[gpu.Design, gpu.Flight]] = {}

    def fly(self, design: gpu.Design, flight: gpu.Flight) -> gpu.Flown:
        self.heard[design.key] = design, flight
        return super().fly(design, flight)


def alone(device: Listening) -> None:
    """Seconds of one list of flights, copies included."""
    for design, flight in device.heard.values():
        said = []
        for count in SIDE_BY_SIDE:
            flights = [flight] * count
            device.fly_all(design, flights[:1])
            started = time.perf_counter()
            device.fly_all(design, flights)
            seconds = time.perf_counter() - started
            said.append(f"{count}: {seconds:.2f} s (kernel {device.kernel_s:.2f})")
        print(f"  {design.n} states, {design.t.size - 1} epochs: " + ", ".join(said), flush=True)


def throughput(here: Experiment, there: Experiment, flights: int, threads: list[int]) -> None:
    cores = len(os.sched_getaffinity(0))
    base = 0.0
    for experiment, many in ((here, cores), *((there, n) for n in threads)):
        run_experiment(experiment, realizations=2)
        with ThreadPoolExecutor(many) as pool:
            started, used = time.perf_counter(), time.process_time()
            run_experiment(experiment, realizations=flights, workers=many, executor=pool)
            seconds, cpu = time.perf_counter() - started, time.process_time() - used
        base = base or seconds
        print(
            f"{flights} realizations of {len(here.beliefs)} designs, {many} threads on {cores} cores"
            f"{' and the GPU' if experiment is there else ''}: {seconds:.1f} s ({cpu:.0f} CPU s), {base / seconds:.2f} times as fast",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--flights", type=int, default=384)
    parser.add_argument("--threads", type=int, nargs="*", default=[GPU_THREADS])
    given = parser.parse_args()
    device = Listening()
    print(device.name)
    here, there = experiment_of(None), experiment_of(device)
    wait_for_kernels()
    same_numbers(here, there)
    throughput(here, there, given.flights, given.threads)
    alone(device)


if __name__ == "__main__":
    main()
