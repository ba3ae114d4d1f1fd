"""Asymptotic covariance of wavelet variances against draws, white noise of 1000 samples (Figs. 3 and 4 of the GMWM paper).

    python benchmarks/variance_covariance.py [--draws 100000] [--figure results/gallery/wavelet_variance_covariance.png]

Prints, for scales with N_j / 2^j >= 8, how far theory is from the draws; acceptance is 10 % for variances and 0.05 for correlations.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from insemu.report.style import COLOURS, pyplot, style
from insemu.variance import level1_autocovariance, model_covariance, wavelet_variance


def covariance_check(tau: np.ndarray, theory: np.ndarray, drawn: np.ndarray, draws: int, title: str):
    """Asymptotic against drawn covariance of wavelet variances: standard deviations and correlations (Figs. 3 and 4 of Stebler et al. 2014).

    Parameters
    ----------
    tau : (J,) array
        Scales in samples.
    theory, drawn : (J, J) arrays
        Covariances.
    draws : int
        Number of draws behind ``drawn``.
    title : str
        Process and length.
    """
    with style():
        figure, (left, right) = pyplot().subplots(1, 2, figsize=(10.5, 4.2))
        left.loglog(tau, np.sqrt(np.diag(theory)), "-", color=COLOURS[0], label="theory, exact finite-record sum")
        left.loglog(
            tau,
            np.sqrt(np.diag(drawn)),
            "o",
            color=COLOURS[1],
            ms=5,
            mfc="none",
            label=f"{draws:,} draws".replace(",", " "),
        )
        left.set(xlabel="scale (samples)", ylabel="standard deviation of the wavelet variance", title=title)
        left.legend()
        a = theory / np.sqrt(np.outer(np.diag(theory), np.diag(theory)))
        b = drawn / np.sqrt(np.outer(np.diag(drawn), np.diag(drawn)))
        for k in range(len(tau)):
            right.semilogx(tau, a[k], "-", color=COLOURS[k % len(COLOURS)], lw=1.2)
            right.semilogx(tau, b[k], "o", color=COLOURS[k % len(COLOURS)], ms=4, mfc="none")
        right.set(
            xlabel="scale (samples)",
            ylabel="correlation with each scale",
            title="Correlations: lines theory, rings draws",
        )
    return figure


def main(draws: int, figure: str, n: int = 1000) -> None:
    rng = np.random.default_rng(13)
    values = np.array([wavelet_variance(rng.standard_normal(n), intervals="eta3").value for _ in range(draws)])
    theory = model_covariance(level1_autocovariance(n, autocovariance=lambda k: np.where(k == 0, 1.0, 0.0)))
    drawn = np.cov(values.T)
    scale = 2 ** np.arange(1, len(theory) + 1)
    use = (n - scale + 1) / scale >= 8
    a, b = (c / np.sqrt(np.outer(np.diag(c), np.diag(c))) for c in (theory, drawn))
    print(f"white noise, {n} samples, {draws} draws, scales {scale[use].tolist()}")
    print("variance, drawn / theory:", np.round(np.diag(drawn)[use] / np.diag(theory)[use], 4).tolist())
    print(f"largest difference of a correlation: {np.abs(a - b)[np.ix_(use, use)].max():.4f}")
    print("all scales, variance, drawn / theory:", np.round(np.diag(drawn) / np.diag(theory), 4).tolist())
    if figure:
        path = Path(figure)
        path.parent.mkdir(parents=True, exist_ok=True)
        drawing = covariance_check(scale.astype(float), theory, drawn, draws, f"White noise, {n} samples")
        drawing.savefig(path, dpi=110)
        print(f"figure: {path}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=100_000)
    parser.add_argument("--figure", default="results/gallery/wavelet_variance_covariance.png")
    arguments = parser.parse_args()
    main(arguments.draws, arguments.figure)
