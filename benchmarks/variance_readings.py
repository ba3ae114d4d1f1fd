"""What is read off simulated Allan curves, over many seeds: the sensor of Table 4 of Quinchia et al. (2013), and sums with and without a walk.

    python benchmarks/variance_readings.py PATH/published/quinchia2013.yaml [--seeds 20]

First part: 7 h at 100 Hz; how often N is within 1 %, and how often N, K and B (against the minimum of the model's closed form) are inside their
95 % intervals. Second part: 2000 s at 100 Hz; how often K is read where there is one and where there is none.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import yaml

from insemu.noise import GM, QN, RW, WN
from insemu.variance import Reading, allan_variance, read_curve


def lowest(model: object) -> float:
    """Minimum of the closed-form Allan deviation over 0.664."""
    m = np.unique(np.geomspace(1, 200_000, 3000).astype(int))
    curve = model.allan_variance(m, 0.01)  # type: ignore[attr-defined]
    slope = np.gradient(np.log(curve), np.log(m))
    return float(np.sqrt(curve[int(np.argmax((slope[1:] >= 0) & (slope[:-1] < 0)))]) / 0.664)


def tally(found: list[Reading], truth: float) -> str:
    inside = sum(r.low <= truth <= r.high for r in found)
    return (
        f"{inside:3d} of {len(found):3d}, {np.median([r.si_value for r in found]) / truth:6.3f}"
        if found
        else "not read".center(19)
    )


def table4(path: Path, seeds: int) -> None:
    published = yaml.safe_load(path.read_text())
    print(f"Table 4, 7 h, {seeds} seeds          inside of read, median over truth")
    print(f"{'axis':8s} {'N within 1 %':>12s}  {'N':>19s}  {'B':>19s}  {'K':>19s}")
    for axis, row in published["table_4_allan"].items():
        one = 1.0 if axis.startswith("acc") else np.pi / 180
        N, B, K = row["N"][0] * one / 60, row["B"][0] * one / 3600, row.get("K", [0.0])[0] * one / 3600**1.5
        model = WN(N=N) + GM(sigma=0.664 * B, beta=1.0 / published["table_5"]["correlation_time_s"][axis])
        model = model + RW(K=K) if K else model
        read = []
        for seed in range(seeds):
            x = model.simulate(7 * 360_000, 0.01, np.random.default_rng(seed))
            read.append(read_curve(allan_variance(x, 100.0)))
        found = {name: [r[name] for r in read if name in r] for name in "NBK"}
        close = sum(abs(r.si_value / N - 1.0) < 0.01 for r in found["N"])
        last = tally(found["K"], K) if K else f"none, read in {len(found['K'])}"
        print(
            f"{axis:8s} {close:6d} of {seeds:2d}  {tally(found['N'], N)}  {tally(found['B'], lowest(model))}  {last}",
            flush=True,
        )


def walks(seeds: int) -> None:
    cases = {
        "WN": (WN(N=1e-3), 0.0),
        "WN + GM, 5 s": (WN(N=1e-3) + GM(sigma=1e-3, beta=0.2), 0.0),
        "QN + WN": (QN(Q=1e-3) + WN(N=1e-4), 0.0),
        "WN 1e-3 + RW 1e-3": (WN(N=1e-3) + RW(K=1e-3), 1e-3),
        "WN 1e-2 + RW 3e-3": (WN(N=1e-2) + RW(K=3e-3), 3e-3),
        "QN + WN + RW": (QN(Q=1e-3) + WN(N=1e-2) + RW(K=3e-3), 3e-3),
        "WN 1e-2 + RW 1e-3": (WN(N=1e-2) + RW(K=1e-3), 1e-3),
    }
    print(f"\n2000 s at 100 Hz, {seeds} seeds: K")
    for name, (model, K) in cases.items():
        read = [
            read_curve(allan_variance(model.simulate(200_000, 0.01, np.random.default_rng(s)), 100.0))
            for s in range(seeds)
        ]
        found = [r["K"] for r in read if "K" in r]
        print(
            f"{name:20s} read in {len(found):3d} of {seeds}"
            + (f"; inside, median over truth {tally(found, K)}" if K else "")
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("published", type=Path)
    parser.add_argument("--seeds", type=int, default=20)
    arguments = parser.parse_args()
    table4(arguments.published, arguments.seeds)
    walks(3 * arguments.seeds)
