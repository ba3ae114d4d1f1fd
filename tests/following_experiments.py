"""Experiments behind the claims about noise that follows a covariate.

``python -m tests.following_experiments NAME [--logs N]`` prints a table; the tests assert on the same functions. Seeds are fixed.
"""

from __future__ import annotations

import time
from collections import defaultdict

import numpy as np
import typer

from insemu.fit import fit_following
from insemu.noise import NoiseModel
from insemu.records import Series

app = typer.Typer(add_completion=False, no_args_is_help=True)

#: An hour at 10 Hz while the sensor warms by 30 K and cools again.
RATE, N = 10.0, 36_000
TEMPERATURE = 25.0 + 15.0 * np.sin(2.0 * np.pi * np.arange(N) / N)
#: Models by name: one level follows, two follow, a walk follows.
TRUTH = {
    "white noise follows": "WN(N=1e-3, follows=temperature, slope={b}, at=25) + GM(sigma=5e-4, beta=0.05)",
    "both follow": "WN(N=1e-3, follows=temperature, slope={b}, at=25) + GM(sigma=1e-3, beta=0.2, follows=temperature, slope={b}, at=25)",
    "random walk follows": "WN(N=1e-3) + RW(K=1e-3, follows=temperature, slope={b}, at=25)",
}
#: Slope of the logarithm of the level, 1/K: a factor of 2.5 over the range.
SLOPE = 0.03


def structure_of(model: NoiseModel) -> str:
    """The model without its values."""
    return " + ".join(f"{p.symbol}({'follows=temperature, at=25' if p.follows else ''})" for p in model)


def coverage(text: str, slope: float, logs: int, seed: int = 1801) -> tuple[dict[str, float], float]:
    """How often intervals hold the truth, by parameter, and how often the test of fit rejects at 5 %."""
    truth = NoiseModel.parse(text.format(b=slope))
    asked = NoiseModel.parse(structure_of(truth))
    inside: dict[str, list[bool]] = defaultdict(list)
    rejected = []
    for rng in np.random.default_rng(seed).spawn(logs):
        x = truth.simulate(N, 1.0 / RATE, rng, {"temperature": TEMPERATURE})
        found = fit_following(Series(x, RATE, "rad/s", "gyro_x"), {"temperature": TEMPERATURE}, asked)
        true = {(p.symbol, i): {**p.parameters, "slope": slope} for i, p in truth.indexed()}
        for e in found.result.parameters:
            inside[e.label].append(e.low <= true[e.process, e.index][e.name] <= e.high)
        test = found.result.test
        rejected.append(test is not None and test.p_value < 0.05)
    return {k: float(np.mean(v)) for k, v in inside.items()}, float(np.mean(rejected))


@app.command("coverage")
def print_coverage(logs: int = 200) -> None:
    """Coverage of 95 % intervals; at slope 0 that of the slope is how often "does not follow" is accepted at 5 %."""
    for name, text in TRUTH.items():
        for slope in (SLOPE, 0.0):
            began = time.process_time()
            inside, rejected = coverage(text, slope, logs)
            shares = ", ".join(f"{k} {100 * v:.1f} %" for k, v in inside.items())
            each = (time.process_time() - began) / logs
            print(
                f"{name}, b = {slope:g} 1/K: {shares}; test of fit rejects {100 * rejected:.1f} %; {each:.2f} CPU s each"
            )


if __name__ == "__main__":
    app()
