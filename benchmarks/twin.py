"""What realizations to first order cost, and whether they agree with flights.

Run: .venv/bin/python benchmarks/twin.py [--flights N] [--linear N] [--point N]
Each row prints what was asked for, whether it is met, and the numbers behind it. CPU seconds and memory are those of commands in processes of their
own, with compiled kernels; a sweep point is what one point more costs.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import stdtrit

from insemu.evaluate import Experiment, Resources, run_experiment
from insemu.scenario import load

SCENARIO = Path(__file__).parents[1] / "scenarios" / "table3_synthetic.yaml"
#: Values of the key that is swept; the second command has the first one only.
SWEPT = ("2 cm", "5 cm", "10 cm", "20 cm", "50 cm")


def row(what: str, met: bool, said: str) -> None:
    print(f"{'met ' if met else 'OPEN'} {what}: {said}", flush=True)


def cost(*arguments: str) -> tuple[float, float, str]:
    """CPU seconds, largest memory in MB and standard output of one command."""
    code = (
        "import resource, subprocess, sys\n"
        "done = subprocess.run([sys.executable, '-m', 'insemu', *sys.argv[1:]], capture_output=True, text=True)\n"
        "used = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
        "print(used.ru_utime + used.ru_stime, used.ru_maxrss, done.returncode)\n"
        "print(done.stdout or done.stderr)\n"
    )
    said = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True).stdout
    figures, _, output = said.partition("\n")
    seconds, kib, failed = figures.split()
    if failed != "0":
        raise SystemExit(output)
    return float(seconds), float(kib) * 1024 / 1e6, output


def agreement(rows: list[dict[str, Any]], flights: int) -> None:
    """Means of the preview within the joint intervals of flights and preview, nine cells together at 95 % (Bonferroni)."""
    experiment = Experiment(load(SCENARIO, overrides={"smoother": False}), SCENARIO)
    results = run_experiment(
        experiment, realizations=flights, resources=Resources(workers=len(os.sched_getaffinity(0)))
    )
    share = float(stdtrit(flights - 1, 1.0 - 0.025 / len(rows)))
    held = 0
    for r in rows:
        full = results.planimetric_ends(r["design"])[:, r["outage"] - 1]
        own, other = full.std(ddof=1) / np.sqrt(flights), (r["ci95_m"][1] - r["ci95_m"][0]) / 3.92
        off = abs(full.mean() - r["mean_m"])
        inside = bool(off <= share * np.hypot(own, other))
        held += inside
        print(
            f"  {r['design']}, {r['outage']} ({r['by']}): flights {full.mean():.0f} +- {1.96 * own:.0f} m, preview {r['mean_m']:.0f} +- "
            f"{1.96 * other:.0f}; rms {np.sqrt((full**2).mean()):.0f}, {r['rms_m']:.0f}{'' if inside else '  OUTSIDE'}"
        )
    row(
        "means within the joint intervals of flights and preview",
        held == len(rows),
        f"{held} of {len(rows)}, {flights} flights",
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--flights", type=int, default=48)
    parser.add_argument("--linear", type=int, default=10_000)
    parser.add_argument("--point", type=int, default=200, help="linear realizations of a sweep point")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as kept:
        run = ["run", str(SCENARIO), "--linear", str(given.linear), "--json", "--output"]
        cost(*run, f"{kept}/first")  # compiles
        seconds, memory, output = cost(*run, f"{kept}/run")
        document = json.loads(output)
        row(f"--linear {given.linear} on Table III: at most 10 CPU s", seconds <= 10, f"{seconds:.1f}")
        row("and 500 MB", memory <= 500, f"{memory:.0f}")
        beyond = document["not_linear"]
        named = {r["design"] for r in document["rows"] if r["by"] != "linear"} == set(beyond)
        row(
            "every design is linear, or named as not",
            named,
            "; ".join(f"{k}: {v}" for k, v in beyond.items()) or "all linear",
        )
        used = [
            cost("sweep", str(SCENARIO), "--over", f"gnss.position_sigma=[{', '.join(values)}]", "--linear", str(given.point), "--json",
                 "--output", f"{kept}/sweep{len(values)}")[0]
            for values in (SWEPT[:1], SWEPT)
        ]  # fmt: skip
        point = (used[1] - used[0]) / (len(SWEPT) - 1)
        row(
            f"a point of a sweep with {given.point}: at most 1 CPU s",
            point <= 1,
            f"{point:.2f}; one point alone {used[0]:.1f}",
        )
    agreement(document["rows"], given.flights)
    print(f"load {os.getloadavg()[0]:.1f} on {len(os.sched_getaffinity(0))} cores, this process {_self():.0f} CPU s")


def _self() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
