"""Numbers of the pages that are formulas, computed from the formulas (numpy and scipy alone) and, where insemu has them too, held against it.

``python -m tests.closed_forms`` prints them; exit code 1 where insemu says something else.
"""

from __future__ import annotations

import sys

import numpy as np
import pywt
from scipy.optimize import minimize_scalar
from scipy.stats import chi2, norm

from insemu.evaluate import share_interval
from insemu.noise import BI, GM, NoiseModel
from insemu.units import scaled_unit


def gauss_markov(x: float) -> float:
    """Allan variance of a Gauss-Markov process of unit variance at ``x = tau / Tc`` (IEEE Std 952, annex C)."""
    return 2.0 / x * (1.0 - (3.0 - 4.0 * np.exp(-x) + np.exp(-2.0 * x)) / (2.0 * x))


def octave_excess(name: str, level: int = 7) -> float:
    """PSD level that a wavelet variance gives to an octave of a spectrum f^-2, over the octave's mean (Percival and Walden 2000, section 8.5)."""
    wavelet = pywt.Wavelet(name)

    def gain(filt: list[float], f: np.ndarray) -> np.ndarray:
        return np.asarray(np.abs(np.exp(-2j * np.pi * np.outer(f, np.arange(len(filt)))) @ np.array(filt)) ** 2 / 2.0)

    f = (np.arange(2**20) + 0.5) / 2**21
    whole = gain(wavelet.dec_hi, f * 2 ** (level - 1))
    for octave in range(level - 1):
        whole *= gain(wavelet.dec_lo, f * 2**octave)
    variance = 2.0 * np.mean(whole * f**-2.0) * 0.5
    return float(2.0**level * variance / (2.0 ** (2 * level + 1)) - 1.0)


def main() -> int:
    """Print the numbers."""
    wrong = []

    def same(what: str, ours: float, formula: float, relative: float) -> None:
        print(f"  insemu: {ours:.6g}")
        if not abs(ours - formula) <= relative * abs(formula):
            wrong.append(what)

    flat = np.sqrt(2.0 * np.log(2.0) / np.pi)
    print(f"flat Allan deviation of flicker: sqrt(2 ln 2 / pi) = {flat:.4f}")
    same("flicker", float(np.sqrt(NoiseModel((BI(B=1.0),)).allan_variance([10_000], dt=1e-3)[0])), float(flat), 1e-3)
    top = minimize_scalar(lambda x: -gauss_markov(x), bounds=(0.5, 5.0), method="bounded", options={"xatol": 1e-10})
    hump = float(np.sqrt(gauss_markov(top.x)))
    print(
        f"hump of a Gauss-Markov process: {hump:.4f} sigma at {top.x:.4f} Tc; {hump:.3f}; read as a flat part: {hump / flat:.4f} sigma"
    )
    same(
        "hump", float(np.sqrt(NoiseModel((GM(1.0, 1.0),)).allan_variance([round(top.x * 1e4)], dt=1e-4)[0])), hump, 1e-3
    )
    print(f"sigma of the Gauss-Markov process whose top is the flat part: 1 / {hump:.3f}")
    print(f"inside 3 sigma: {100 * (1 - 2 * norm.sf(3)):.2f} %, {100 * (1 - 2 * norm.sf(3)):.1f} %")
    print(f"degrees in a radian: {180 / np.pi:.1f}")
    hour = float(np.sqrt(3600.0))
    print(
        f"1 ug/sqrt(Hz): {9.80665e-6 * hour:.3g} m/s/sqrt(h); 1 mg: {9.80665e-3 * 3600.0:.1f} m/s/h; 1 deg/h*sqrt(Hz): {hour:.0f} deg/h^1.5"
    )
    same("unit", scaled_unit("ug/sqrt(Hz)").factor / scaled_unit("m/s/sqrt(h)").factor, 9.80665e-6 * hour, 1e-12)
    eta = (
        3.0 * 10.0 / 2.0 - 2.0
    )  # degrees of freedom of overlapping averages of a tenth of a record of white noise (Riley 2008, table 5)
    low, high = eta / chi2.ppf([0.975, 0.025], eta)
    print(
        f"95 % interval of an Allan deviation at a tenth of the record: {np.sqrt(low):.2f} to {np.sqrt(high):.2f} of it"
    )
    for name, known in (("db1", "Haar"), ("db3", "d6"), ("sym4", "la8")):
        print(f"level of an octave where the spectrum falls by f^-2, {known}: {100 * octave_excess(name):.0f} % high")
    print(
        f"speed on a linear path 6 km north of its origin at 45 deg: {100 * 6e3 / 6.37e6:.1f} % by the cosine of the latitude"
    )
    most = 1.0 - 0.025 ** (1.0 / 24.0)  # Clopper and Pearson 1934
    print(f"share of which 24 draws show none, 95 %: up to {100 * most:.1f} %")
    same("interval of a share", share_interval(0, 24)[1], most, 1e-9)
    return _show(wrong)


def _show(wrong: list[str]) -> int:
    for what in wrong:
        print(f"insemu does not agree: {what}")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
