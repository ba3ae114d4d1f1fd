"""Arrays of six IMUs: weights for the metres at the ends of outages against every other weighting.

``python -m tests.array_experiments [N] [--kind mixed|spread|alike] [--hours H]``: of N emulated arrays the mean square at the end of an
outage under each weighting, over that of equal weights: computed from the true models of the units with the filter that each weighting
gets (no Monte Carlo), median with its 95 % interval (binomial), and the largest.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy import stats

from insemu.array import EQUAL, METRES, ArrayFit, Flight, quadratic, weigh
from insemu.noise import GM, WN, NoiseModel, axis_unit
from insemu.records import AXES, Series
from insemu.scenario import Scenario, load
from insemu.scenario.shipped import located

UNITS, RATE_HZ = 6, 10.0
#: White noise and slow process of a unit: rad/s and m/s^2.
TYPICAL = {"gyro": (1.7e-4, 1.4e-4, 200.0), "accel": (2e-3, 5e-3, 100.0)}
#: By kind: standard deviation of the logarithm of each level between units, and by what factor two families differ (in opposite ways).
KINDS = {"alike": (0.0, 1.0), "spread": (0.35, 1.0), "mixed": (0.2, 2.0)}
#: One outage of a minute, at the end of a flight of six.
END = 361.0


def flight() -> Flight:
    """The drive of the shipped scenario up to its first outage, at the rate of the logs."""
    path = located("shared_process")
    s: Scenario = load(path)
    assert s.trajectory is not None
    trajectory = s.trajectory.model_copy(update={"rate": RATE_HZ, "duration": END})
    return Flight(
        s.model_copy(
            update={"trajectory": trajectory, "gnss": s.gnss.model_copy(update={"outages": s.gnss.outages[:1]})}
        ),
        path,
    )


def drawn(kind: str, rng: np.random.Generator) -> dict[str, list[NoiseModel]]:
    """True models of the units, by axis."""
    sd, factor = KINDS[kind]
    out: dict[str, list[NoiseModel]] = {}
    for axis in AXES:
        N, sigma, Tc = TYPICAL[axis.partition("_")[0]]
        out[axis] = []
        for k in range(UNITS):
            f = factor if k % 2 else 1.0 / factor
            a, b = np.exp(sd * rng.standard_normal(2))
            out[axis].append(WN(N=N * a * f) + GM(sigma=sigma * b / f, Tc=Tc))
    return out


def logs_of(truth: dict[str, list[NoiseModel]], hours: float, rng: np.random.Generator) -> dict[str, dict[str, Series]]:
    """What the units record at rest."""
    n = round(3600.0 * hours * RATE_HZ)
    return {
        f"imu{k}": {a: Series(truth[a][k].simulate(n, 1.0 / RATE_HZ, rng), RATE_HZ, axis_unit(a), a) for a in AXES}
        for k in range(UNITS)
    }


def true_squares(found: ArrayFit, truth: dict[str, list[NoiseModel]], on: Flight) -> dict[str, float]:
    """Mean square at the end of the outage under the true models, each weighting with its own filter, m^2."""
    return {
        w.name: quadratic(on.response(w.models), truth, {}, on.own).mean_square(w.weights) for w in found.weightings
    }


def median_interval(x: np.ndarray) -> tuple[float, float, float]:
    """Median with its binomial 95 % interval."""
    x = np.sort(x)
    k = int(stats.binom.ppf(0.025, x.size, 0.5))
    return float(np.median(x)), float(x[max(k - 1, 0)]), float(x[min(x.size - k, x.size - 1)])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", nargs="?", type=int, default=20)
    parser.add_argument("--kind", choices=sorted(KINDS), default="mixed")
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--seed", type=int, default=18)
    given = parser.parse_args()
    on, rows, inside = flight(), [], []
    for number in range(given.count):
        rng = np.random.default_rng([given.seed, number])
        truth = drawn(given.kind, rng)
        found = weigh(logs_of(truth, given.hours, rng), "WN() + GM()", on, rng=rng)
        square = true_squares(found, truth, on)
        rows.append({name: v / square[EQUAL] for name, v in square.items()})
        ours = found[METRES]
        inside.append(ours.low <= rows[-1][METRES] <= ours.high)
        print(
            f"{number}: "
            + ", ".join(f"{name} {v:.3f}" for name, v in rows[-1].items())
            + f"; said {ours.ratio:.3f} ({ours.low:.3f} to {ours.high:.3f})",
            flush=True,
        )
    print(
        f"{given.kind}, {given.count} arrays of {UNITS}, logs of {given.hours:g} h: mean square over that of equal weights"
    )
    for name in rows[0]:
        x = np.array([r[name] for r in rows])
        middle, low, high = median_interval(x)
        print(f"  {name:<22} median {middle:.3f} ({low:.3f} to {high:.3f}), largest {x.max():.3f}")
        if name not in (EQUAL, METRES):
            middle, low, high = median_interval(np.array([r[METRES] / r[name] for r in rows]))
            print(f"  {'':<22} ours over it: median {middle:.3f} ({low:.3f} to {high:.3f})")
    print(f"  the interval holds the true ratio in {sum(inside)} of {len(inside)}")


if __name__ == "__main__":
    main()
