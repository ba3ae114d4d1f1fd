"""What large runs cost: the linear twin against full flights, agreement of the two, and the width of the control variate's interval.

Table III with 24 or, with an argument, so many full flights. Run: .venv/bin/python benchmarks/scale.py [FLIGHTS]
"""

from __future__ import annotations

import resource
import sys
import time
from pathlib import Path

import numpy as np

from insemu.evaluate import Experiment, LinearTwin, analyse_designs, planimetric
from insemu.evaluate.control import controlled
from insemu.scenario import load

SCENARIO = Path(__file__).parents[1] / "scenarios" / "table3_synthetic.yaml"
LINEAR = 10_000


def main(flights: int) -> None:
    experiment = Experiment(load(SCENARIO, overrides={"smoother": False}), SCENARIO)
    for name in experiment.beliefs:
        experiment.filter(name)
    experiment.realization(0)  # compiles
    full, memory = [], []
    started = time.process_time()
    at = None
    costs = []
    for r in range(flights):
        before = time.process_time()
        flown = experiment.realization(r)["error"]
        costs.append(time.process_time() - before)
        memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
        if at is None:
            ends = [start + duration for start, duration in experiment.world.outage_windows]
            at = np.searchsorted(flown["time"].to_numpy(), np.array(ends) - 1e-9)
        full.append(flown.to_numpy()[:, at])
    per_flight = (time.process_time() - started) / flights
    half = flights // 2
    print(
        f"full flight of {len(experiment.beliefs)} designs: {per_flight:.2f} CPU s; second half of {flights} over the first "
        f"{np.median(costs[half:]) / np.median(costs[:half]):.2f}, memory {memory[half]:.0f} then {memory[-1]:.0f} MiB"
    )
    started = time.process_time()
    twin = LinearTwin(experiment)
    made = time.process_time() - started
    paired = [twin.realization(r) for r in range(flights)]
    started = time.process_time()
    drawn = twin.draw(LINEAR, twin.rng)
    seconds = made + time.process_time() - started
    print(
        f"{LINEAR} linear realizations: {seconds:.1f} CPU s ({made:.1f} to make the twin), "
        f"{LINEAR * per_flight / seconds:.0f} times cheaper than as many full flights"
    )
    exact = analyse_designs(experiment)
    print(
        "design, outage: mean of full flights, of linear; 95 % quantiles; rms of full, linear, exact (without the removed mean); correlation; "
        "width of the plain interval at equal cost over the control variate's"
    )
    narrower = 0
    for d, name in enumerate(experiment.beliefs):
        for k in range(len(at)):
            ours = planimetric(np.stack(full)[:, d, k])
            linear = planimetric(drawn[name][:, k])
            found = controlled(ours, planimetric(np.stack([p[name][k] for p in paired])), linear)
            a = exact[name]
            i = int(np.argmin(np.abs(a.t - experiment.world.imu.t[twin.ends[k]])))
            equal = found.plain_mean.width * np.sqrt(flights / (flights + seconds / per_flight))
            narrower += equal >= 3.0 * found.mean.width
            print(
                f"{name}, {k + 1}: {ours.mean():.1f} +- {1.96 * ours.std(ddof=1) / np.sqrt(flights):.1f}, {linear.mean():.1f}; "
                f"{np.quantile(ours, 0.95):.0f}, {np.quantile(linear, 0.95):.0f}; "
                f"{np.sqrt((ours**2).mean()):.0f}, {np.sqrt((linear**2).mean()):.0f}, {np.hypot(*a.rms[i, :2]):.0f}; "
                f"{found.correlation:.4f}; {equal / found.mean.width:.1f}"
            )
    print(f"at least three times narrower at equal cost: {narrower} of {3 * len(at)} cells")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 24)
