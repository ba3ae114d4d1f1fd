"""How often the default intervals of the wavelet variance hold the truth, scale by scale, over many seeds.

    python benchmarks/variance_coverage.py [--seeds 10] [--series 1000] [--samples 8192]

Every (seed, model, scale with more than 8 degrees of freedom) is one cell: the share of so many series whose 95 % interval holds the model's
wavelet variance. Printed: the share over all seeds, and how many cells are outside the bounds that 0.1 % of right ones would leave, beside how
many that should be. A halved interval is scored too, which must fail.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy import stats

from insemu.noise import GM, QN, RW, WN
from insemu.variance import level1_autocovariance, model_edof, wavelet_variance

MODELS = {
    "WN": WN(N=1.0),
    "GM": GM(sigma=1.0, beta=0.02),
    "RW + WN": WN(N=1.0) + RW(K=0.02),
    "WN + fast GM": WN(N=1.0) + GM(sigma=1.0, beta=0.5),
    "slow GM": GM(sigma=1.0, beta=0.001),
    "WN + faint RW": WN(N=1.0) + RW(K=0.003),
    "QN + WN + GM": QN(Q=1.0) + WN(N=0.1) + GM(sigma=0.05, beta=0.01),
}


def main(seeds: int, series: int, n: int) -> None:
    low, high = stats.binom.ppf([0.0005, 0.9995], series, 0.95) / series
    print(f"{n} samples, {seeds} seeds of {series} series; bounds of a cell {100 * low:.1f} to {100 * high:.1f} %")
    cells = outside = 0
    expected = 0.0
    wrong = float(
        stats.binom.cdf(round(low * series) - 1, series, 0.95) + stats.binom.sf(round(high * series), series, 0.95)
    )
    for name, model in MODELS.items():
        scale = 2 ** np.arange(1, int(np.log2(n)) + (n & (n - 1) > 0))
        truth = model.wavelet_variance(scale, 1.0)
        freedom = model_edof(level1_autocovariance(n, psd=lambda f, m=model: m.psd(f, 1.0)), truth)  # type: ignore[misc]
        known = freedom > 8.0
        share, halved = np.empty((seeds, known.sum())), np.empty((seeds, known.sum()))
        for seed in range(seeds):
            rng = np.random.default_rng(seed)
            curves = [wavelet_variance(model.simulate(n, 1.0, rng)) for _ in range(series)]
            value, below, above = (
                np.array([getattr(c, key)[known] for c in curves]) for key in ("value", "low", "high")
            )
            right = truth[known]
            share[seed] = np.mean((below <= right) & (right <= above), axis=0)
            halved[seed] = np.mean(
                (value - 0.5 * (value - below) <= right) & (right <= value + 0.5 * (above - value)), axis=0
            )
        bad = int(((share < low) | (share > high)).sum())
        cells, outside, expected = cells + share.size, outside + bad, expected + wrong * share.size
        print(
            f"\n{name}: {bad} of {share.size} cells outside; halved intervals: {100 * np.mean(halved < low):.0f} % of cells fail"
        )
        print("  scale              " + " ".join(f"{s:6d}" for s in scale[known]))
        print("  degrees of freedom " + " ".join(f"{f:6.0f}" for f in freedom[known]))
        print("  covered, all, %    " + " ".join(f"{100 * c:6.2f}" for c in share.mean(axis=0)))
        print("  lowest seed        " + " ".join(f"{100 * c:6.1f}" for c in share.min(axis=0)))
        print("  highest seed       " + " ".join(f"{100 * c:6.1f}" for c in share.max(axis=0)), flush=True)
    print(f"\n{outside} of {cells} cells outside, {expected:.1f} expected of exact intervals")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--series", type=int, default=1000)
    parser.add_argument("--samples", type=int, default=8192)
    arguments = parser.parse_args()
    main(arguments.seeds, arguments.series, arguments.samples)
