"""Regressors estimated together with the noise model: coverage of both.

``python -m tests.regressor_experiments [N] [--model gm|walk] [--hours H]``: of N emulated logs of two hours with a warm-up, how often 95 %
intervals hold the coefficients of temperature and time and the parameters of the noise; beside them the coefficients of ordinary least
squares with white errors. 400 logs tell a coverage to 2 points (95 %), in some 2 CPU min; a hundred only to 4.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy import linalg, stats

from insemu.fit import fit_regressed
from insemu.noise import GM, RW, WN, NoiseModel
from insemu.records import Series

RATE_HZ = 10.0
#: Coefficients: rad/s per K, rad/s per s.
TRUE = {"temperature": 2e-5, "time": -3e-8}
MODELS = {"gm": WN(N=2e-4) + GM(sigma=1e-4, Tc=100.0), "walk": WN(N=2e-4) + RW(K=4e-6)}


def signal_of(model: NoiseModel, samples: int, rng: np.random.Generator) -> tuple[Series, dict[str, np.ndarray]]:
    """A log that warms up by 15 K in a quarter of an hour, with the slow changes of a room, and its regressors."""
    t = np.arange(samples) / RATE_HZ
    temperature = 25.0 + 15.0 * (1.0 - np.exp(-t / 900.0)) + np.sin(2 * np.pi * (t / 1500.0 + rng.random()))
    columns = {"temperature": temperature, "time": t}
    x = model.simulate(samples, 1.0 / RATE_HZ, rng) + sum(TRUE[k] * v for k, v in columns.items())
    return Series(np.asarray(x), RATE_HZ, "rad/s", "gyro_x"), columns


def main() -> None:
    """Print the coverage."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", nargs="?", type=int, default=400)
    parser.add_argument("--model", choices=sorted(MODELS), default="gm")
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--seed", type=int, default=18)
    given = parser.parse_args()
    truth, samples = MODELS[given.model], round(3600 * given.hours * RATE_HZ)
    asked = NoiseModel(tuple(p.with_parameters(dict.fromkeys(p.given)) for p in truth))
    held: dict[str, list[bool]] = {}
    for number in range(given.count):
        series, columns = signal_of(truth, samples, np.random.default_rng([given.seed, number]))
        found = fit_regressed(series, columns, asked)
        for c in found.coefficients:
            held.setdefault(f"coefficient of {c.name}", []).append(c.low <= TRUE[c.name] <= c.high)
        for index, p in truth.indexed():
            for name, value in p.parameters.items():
                e = found.result[f"{p.symbol}{index}.{name}"]
                held.setdefault(e.label, []).append(bool(e.low <= value <= e.high))
        X = np.column_stack([np.ones(samples), *columns.values()])
        b, left, *_ = linalg.lstsq(X, series.values)
        error = np.sqrt(np.diag(linalg.inv(X.T @ X)) * left / (samples - X.shape[1]))
        for k, name in enumerate(columns):
            inside = abs(b[k + 1] - TRUE[name]) < 1.96 * error[k + 1]
            held.setdefault(f"ordinary least squares, {name}", []).append(bool(inside))
    print(f"{truth}, {given.count} logs of {given.hours:g} h at {RATE_HZ:g} Hz: 95 % intervals that hold the truth")
    for name, inside in held.items():
        n, k = len(inside), sum(inside)
        low, high = stats.binomtest(k, n).proportion_ci(method="wilson")
        print(f"  {name:<36} {k} of {n} ({k / n:.1%}, {low:.1%} to {high:.1%})")


if __name__ == "__main__":
    main()
