"""Speed of fitting against a plain scipy implementation in the same run, and against published times of the R packages.

``python benchmarks/fit.py`` prints a table; ``--long`` fits 100 hours at 400 Hz by integrated maximum likelihood instead,
and prints the memory that took.
Times are the best of three after compilation, one core, automatic start, wavelet variance included.
"""

from __future__ import annotations

import math
import resource
import time
from collections.abc import Callable, Iterator

import numpy as np
import typer
from scipy import optimize, signal

from insemu.fit import fit
from insemu.fit.likelihood import Stream, fit_mli_pieces
from insemu.noise import GM, RW, WN, NoiseModel

N, RATE = 1_000_000, 100.0
THREE = GM(1e-3, 0.02) + GM(2e-3, 1.0) + GM(5e-3, 30.0)
#: R packages gmwm/simts on a machine of this class, in seconds, as quoted in the project's brief for N = 1e6.
QUOTED = {"3 GM": 2.7, "3 GM + WN + RW": 3.1, "3 GM robust": 4.7}


def plain_wavelet_variance(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Haar MODWT variance by cumulated sums, one pass of numpy per scale."""
    sums = np.concatenate([[0.0], np.cumsum(x - x.mean())])
    scale, value = [], []
    m = 1
    while 2 * m * 2 <= x.size:
        w = (sums[2 * m :] - 2 * sums[m:-m] + sums[: -2 * m]) / (2 * m)
        scale.append(2 * m)
        value.append(np.mean(w * w))
        m *= 2
    return np.array(scale), np.array(value)


def plain_gmwm(x: np.ndarray, model: NoiseModel, starts: int = 12) -> float:
    """The same estimator with scipy alone: closed forms, Nelder-Mead in logarithms from random starts, the best of them."""
    scale, value = plain_wavelet_variance(x)
    width = value / np.sqrt(x.size / scale)
    rng = np.random.default_rng(1)
    names = [(k, meta.name) for k, p in enumerate(model) for meta in p.parameters_meta()]

    def at(theta: np.ndarray) -> NoiseModel:
        parts = list(model)
        for (k, name), v in zip(names, np.exp(np.clip(theta, -40, 20)), strict=True):
            parts[k] = parts[k].with_parameters({name: float(v)})
        return NoiseModel(tuple(parts))

    def cost(theta: np.ndarray) -> float:
        return float(np.sum(((value - at(theta).wavelet_variance(scale, 1 / RATE)) / width) ** 2))

    best = math.inf
    for _ in range(starts):
        start = []
        for _, name in names:
            if name == "beta":
                start.append(rng.uniform(math.log(RATE / x.size), math.log(RATE)))
            else:
                start.append(0.5 * math.log(value[0]) + rng.uniform(-4, 0))
        found = optimize.minimize(cost, start, method="Nelder-Mead", options={"maxfev": 2000, "maxiter": 2000})
        best = min(best, float(found.fun))
    return best


def best_of(call: Callable[[], object], repeats: int = 3) -> float:
    call()
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        call()
        times.append(time.perf_counter() - started)
    return min(times)


def long_record() -> None:
    """100 hours at 400 Hz, drawn and fitted in pieces of a quarter of an hour."""
    rate, hours, piece = 400.0, 100, 360_000
    count = int(hours * 3600 * rate) // piece
    truth = WN(1.05e-4) + GM.of_driving_density(1.26e-6, 1 / 530.5)
    phi, q = GM.of_driving_density(1.26e-6, 1 / 530.5).discrete(1 / rate)
    drawing = 0.0

    def pieces() -> Iterator[np.ndarray]:
        nonlocal drawing
        rng = np.random.default_rng(1)
        state = truth.processes[1].parameters["sigma"] * rng.standard_normal(1)
        for _ in range(count):
            started = time.perf_counter()
            slow, state = signal.lfilter([1.0], [1.0, -phi], math.sqrt(q) * rng.standard_normal(piece), zi=state)
            x = slow + 1.05e-4 * math.sqrt(rate) * rng.standard_normal(piece)
            drawing += time.perf_counter() - started
            yield x

    started = time.perf_counter()
    result = fit_mli_pieces(Stream(pieces(), count * piece, rate, "rad/s"), NoiseModel.parse("WN() + GM()"))
    seconds = time.perf_counter() - started - drawing
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(
        f"100 h at 400 Hz ({count * piece / 1e6:.0f} million samples) by integrated maximum likelihood: {seconds:.1f} s"
    )
    print(f"   (drawing the signal took {drawing:.1f} s more); peak memory of the process {peak:.2f} GiB")
    print("   " + ", ".join(f"{e.label} {e.value:.4g} ± {e.standard_error:.2g}" for e in result.parameters))


def main(long: bool = typer.Option(False, "--long", help="100 hours at 400 Hz instead.")) -> None:
    if long:
        long_record()
        return
    rng = np.random.default_rng(1)
    x3 = THREE.simulate(N, 1 / RATE, rng)
    x5 = (THREE + WN(1e-4) + RW(1e-5)).simulate(N, 1 / RATE, rng)
    hit = rng.random(N) < 0.01
    bad = x3 + np.where(hit, 9 * x3.std() * rng.standard_normal(N), 0.0)
    cases: list[tuple[str, np.ndarray, str, dict[str, object]]] = [
        ("3 GM", x3, "3*GM()", {}),
        ("3 GM + WN + RW", x5, "3*GM() + WN() + RW()", {}),
        ("3 GM robust", bad, "3*GM()", {"robust": True}),
    ]
    print(f"{'N = 1e6':18s}{'insemu (s)':>12s}{'scipy only (s)':>16s}{'ratio':>8s}{'R, quoted (s)':>16s}{'ratio':>8s}")
    for label, x, model, options in cases:
        structure = NoiseModel.parse(model)
        ours = best_of(lambda: fit(x, structure, rate_hz=RATE, **options))  # noqa: B023
        if options:
            theirs = math.nan
        else:
            filled = NoiseModel(
                tuple(p.with_parameters({meta.name: 1.0 for meta in p.parameters_meta()}) for p in structure)
            )
            started = time.perf_counter()
            plain_gmwm(x, filled)
            theirs = time.perf_counter() - started
        ratio = f"{theirs / ours:8.0f}" if math.isfinite(theirs) else f"{'-':>8s}"
        other = f"{theirs:16.2f}" if math.isfinite(theirs) else f"{'-':>16s}"
        print(f"{label:18s}{ours:12.3f}{other}{ratio}{QUOTED[label]:16.1f}{QUOTED[label] / ours:8.0f}", flush=True)


if __name__ == "__main__":
    typer.run(main)
