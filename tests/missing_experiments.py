"""Wavelet moments of records with missing samples: coverage of 95 % intervals and speed beside complete records.

``python -m tests.missing_experiments --draws 100`` prints the tables behind "Missing samples" of the page on variances;
``--only coverage``, ``--only speed``.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from insemu.fit import fit
from insemu.noise import NoiseModel
from insemu.records import Series
from insemu.variance import wavelet_variance
from insemu.variance.gaps import LEAST_SHARE, POSITIONS

Array = NDArray[np.float64]

#: Models of the draws, with the structure that is fitted.
MODELS = {
    "WN(N=0.01)": "WN()",
    "GM(sigma=0.02, Tc=2 s) + WN(N=0.01)": "GM() + WN()",
    "RW(K=0.01) + WN(N=0.01)": "RW() + WN()",
}
RATE = 100.0
#: Share of samples that are missing.
SHARE = 0.3


def lost(kind: str, n: int, rng: np.random.Generator, *, mean: float = 200.0) -> NDArray[np.bool_]:
    """Samples that are missing: each by chance (``single``), or in stretches of geometric length (``stretches``).

    Parameters
    ----------
    kind : str
    n : int
        Samples.
    rng : Generator
    mean : float
        Mean length of a stretch, samples.
    """
    if kind == "single":
        return rng.random(n) < SHARE
    out = np.zeros(n, dtype=bool)
    while out.mean() < SHARE:
        start = rng.integers(n)
        out[start : start + rng.geometric(1.0 / mean)] = True
    return out


def covariance(model: NoiseModel, n: int) -> Array:
    """Covariance (n, n) of the samples of stationary processes, and of random walks that began at the first sample."""
    place = np.arange(n)
    out = np.zeros((n, n))
    for p in model:
        if p.stationary:
            out += p.autocovariance(place, 1.0 / RATE)[np.abs(np.subtract.outer(place, place))]
        else:
            out += p.block(1.0 / RATE).Q[0, 0] * np.minimum.outer(place, place)
    return out


def coefficients(missing: NDArray[np.bool_], octave: int) -> csr_array:
    """Weights (coefficients, n) of the samples that are there in the coefficients of one octave, from 0."""
    half = 1 << octave
    first = np.arange(0, missing.size + 1 - 2 * half, max(half // POSITIONS, 1))
    columns = first[:, None] + np.arange(2 * half)
    there = ~missing[columns]
    number = there.reshape(-1, 2, half).sum(axis=2)
    good = (number >= LEAST_SHARE * half).all(axis=1)
    weights = there[good] * np.repeat([-0.5, 0.5], half) / np.repeat(number[good], half, axis=1)
    ends = np.arange(0, weights.size + 1, 2 * half)
    return csr_array((weights.ravel(), columns[good].ravel(), ends), shape=(len(weights), missing.size))


def coverage(
    text: str, kind: str, draws: int, n: int, seed: int, filter: str = "haar"
) -> tuple[float, int, float, int]:
    """Share of scales, and of parameters, whose 95 % interval holds the truth, each with its number.

    Parameters
    ----------
    text : str
        Model with values, a key of :data:`MODELS`.
    kind : str
        Of :func:`lost`, or ``none``.
    draws, n, seed : int
        Records, their length in samples, seed.
    filter : str
        Wavelet filter.
    """
    model = NoiseModel.parse(text, "")
    truth = {f"{p.symbol}{i}.{k}": v for i, p in model.indexed() for k, v in p.parameters.items()}
    scales, parameters = [], []
    for child in np.random.default_rng(seed).spawn(draws):
        x = model.simulate(n, 1.0 / RATE, child)
        if kind != "none":
            x[lost(kind, n, child)] = np.nan
        curve = wavelet_variance(x, RATE, gaps=True, filter=filter)
        if filter == "haar":
            expected = model.wavelet_variance(curve.scale_samples, 1.0 / RATE)
            scales += list((curve.low <= expected) & (expected <= curve.high))
        result = fit(Series(x, RATE, gaps=True), MODELS[text], wavelet=filter)
        parameters += [e.low <= truth[e.label] <= e.high for e in result.parameters if np.isfinite(e.low)]
    return float(np.mean(scales)) if scales else np.nan, len(scales), float(np.mean(parameters)), len(parameters)


def seconds(x: Array) -> float:
    """Least time of a fit out of five, s."""
    times = []
    for _ in range(5):
        begin = time.perf_counter()
        fit(Series(x, RATE, gaps=True), "GM() + WN()")
        times.append(time.perf_counter() - begin)
    return min(times)


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--samples", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=("coverage", "speed"))
    parser.add_argument("--filter", default="haar")
    given = parser.parse_args()
    if given.only != "speed":
        print(f"{given.draws} records of {given.samples} samples, {SHARE:.0%} missing, filter {given.filter}")
        print(f"{'model':38} {'missing':10} {'scales':>16} {'parameters':>16}")
        for text in MODELS:
            for kind in ("none", "single", "stretches"):
                a, n, b, m = coverage(text, kind, given.draws, given.samples, given.seed, given.filter)
                print(f"{text:38} {kind:10} {100 * a:6.1f} % of {n:5} {100 * b:6.1f} % of {m:5}", flush=True)
    if given.only != "coverage":
        model = NoiseModel.parse("GM(sigma=0.003, Tc=20 s) + WN(N=0.01)", "")
        for n in (100_000, 1_000_000):
            rng = np.random.default_rng(given.seed)
            x = model.simulate(n, 1.0 / RATE, rng)
            whole = seconds(x)
            for kind in ("single", "stretches"):
                y = np.where(lost(kind, n, rng, mean=500.0), np.nan, x)
                took = seconds(y)
                print(
                    f"{n} samples, {kind}: fit in {1e3 * took:.0f} ms, complete {1e3 * whole:.0f} ms: {took / whole:.2f}"
                )


if __name__ == "__main__":
    main()
