"""A Gauss-Markov noise read off the autocorrelation, after de-noising where wanted (Quinchia et al. 2013, sections 4.1 and 5.2).

The autocovariance of a Gauss-Markov noise is ``sigma^2 exp(-t / Tc)`` (equation (11)). A straight line through its logarithm, from the first lag
that white noise does not reach to where it has fallen by ``e``, gives both. Anything else in the signal bends the line: the method is for
comparison with figures read in this way.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from insemu.denoise import Rule, denoise
from insemu.errors import InputError
from insemu.fit.result import FitResult
from insemu.fit.slopes import Read, around, assembled
from insemu.noise import GM, WN, NoiseModel
from insemu.records import Series
from insemu.variance import autocorrelation

Array = NDArray[np.float64]

#: Lags that the line goes through.
_LAGS = 12
#: A relative standard error above which a figure is not given: its interval would span more than a decade.
UNREAD = 0.6


def fit_autocorrelation(
    series: Series, model: NoiseModel, *, denoise_levels: int = 0, denoise_rule: Rule = "sure", wavelet: str = "db4"
) -> FitResult:
    """Read a Gauss-Markov noise off the autocorrelation.

    Parameters
    ----------
    series : Series
    model : NoiseModel
        ``GM()``, or ``GM() + WN()``: white noise then is what the variance has more at lag 0.
    denoise_levels : int
        Octaves that are de-noised first; the line begins where the noise of the longest of them ends.
    denoise_rule : {"sure", "universal", "approximation", "packets"}
        What becomes of their details, see :func:`insemu.denoise.denoise`.
    wavelet : str
        Of the de-noising.

    Raises
    ------
    InputError
        Another model, or one with given values; a record too short for the lags.
    """
    kinds = sorted(p.symbol for p in model)
    if kinds not in (["GM"], ["GM", "WN"]) or any(v is not None for p in model for v in p.given.values()):
        raise InputError(f"the autocorrelation gives one Gauss-Markov noise, not {model}; expected GM() or GM() + WN()")
    n, dt = len(series), series.dt
    x = np.asarray(series.values) - float(np.mean(series.values))
    smooth = denoise(x, denoise_levels, rule=denoise_rule, wavelet=wavelet)
    first = 2 * 2**denoise_levels if denoise_levels else int("WN" in kinds)
    most = n // 4
    if first + _LAGS >= most:
        raise InputError(
            f"{series.name} has {n} samples, expected at least {4 * (first + _LAGS) + 4} for {denoise_levels} octaves"
        )
    covariance = autocorrelation(smooth, series.rate_hz, max_lag_s=most * dt).covariance
    found = _line(covariance, first, dt, n)
    if found is None:
        level = math.sqrt(float(x @ x) / n * dt)
        alone: dict[str, Read] = {
            "GM": (GM(0.0, 1.0 / (n * dt)), {}, "GM: no correlation; its variance is set to zero"),
            "WN": (WN(level), {"N": around(level, math.sqrt(0.5 / n))}, ""),
        }
        return assembled(series, model, [alone[p.symbol] for p in model], "autocorrelation", {})
    lags, sigma2, beta = found
    white = max(float(x @ x) / n + _lost(sigma2, beta, n * dt) - sigma2, 0.0) * dt if "WN" in kinds else 0.0
    t = np.asarray(lags * dt, dtype=np.float64)
    errors = _errors(t, sigma2, beta, white, n * dt, 2**denoise_levels * dt)
    if errors.max() > UNREAD:
        raise InputError(
            f"{series.name}: white noise hides the autocorrelation: correlation time {1.0 / beta:.3g} s with a standard error of {errors[1]:.0%}, "
            f"variance {errors[0]:.0%}; expected at most {UNREAD:.0%}. De-noise first, or fit by the method gmwm"
        )
    sigma = math.sqrt(sigma2)
    spread = {"sigma": around(sigma, 0.5 * errors[0]), "beta": around(beta, errors[1])}
    note = ""
    if beta * n * dt < 20.0:
        note = "GM: its correlation time is more than a twentieth of the record; the autocorrelation knows little of it"
    level = math.sqrt(white)
    share = math.hypot(math.sqrt(2.0 / n), errors[0] * sigma2 * dt / white) if white else math.nan
    read: dict[str, Read] = {
        "GM": (GM(sigma, beta), spread, note),
        "WN": (
            WN(level),
            {"N": around(level, 0.5 * share)} if white else {},
            "" if white else "WN: its N is set to zero",
        ),
    }
    return assembled(series, model, [read[p.symbol] for p in model], "autocorrelation", {"lag_s": t})


def _line(covariance: Array, first: int, dt: float, n: int) -> tuple[NDArray[np.int64], float, float] | None:
    """Lags, variance and inverse correlation time of the line; the mean that was removed is put back."""
    lost = 0.0
    lags = np.zeros(0, dtype=np.int64)
    sigma2 = beta = 0.0
    for _ in range(6):
        raised = covariance + lost
        if raised[first] <= 0:
            return None
        below = np.flatnonzero(raised[first:] < raised[first] / math.e)
        end = first + (int(below[0]) if below.size else raised.size - 1 - first)
        lags = np.unique(np.linspace(first, max(end - 1, first + 1), _LAGS).round().astype(np.int64))
        if (raised[lags] <= 0).any():
            return None
        slope, intercept = np.polyfit(lags * dt, np.log(raised[lags]), 1)
        if slope >= 0:
            return None
        sigma2, beta = math.exp(float(intercept)), -float(slope)
        lost = _lost(sigma2, beta, n * dt)
    return lags, sigma2, beta


def _lost(sigma2: float, beta: float, duration: float) -> float:
    """Variance of the mean of a Gauss-Markov noise over a record, which removing it subtracts the autocovariance."""
    x = beta * duration
    return 2.0 * sigma2 * (x - 1.0 + math.exp(-x)) / x**2


def _errors(t: Array, sigma2: float, beta: float, white: float, duration: float, coarse: float) -> Array:
    """Relative standard errors of variance and inverse correlation time of the line through the lags ``t``.

    Bartlett's covariance of the estimates at two lags (integrals of products of autocovariances over the record), for the noise and for white
    noise of density ``white`` that is correlated over ``coarse``.
    """
    apart, together = np.abs(np.subtract.outer(t, t)), np.add.outer(t, t)

    def product(d: Array) -> Array:
        return np.asarray(np.exp(-beta * d) * (1.0 / beta + d))

    own = sigma2**2 * (product(apart) + product(together))
    mixed = 2.0 * white * sigma2 * (np.exp(-beta * apart) + np.exp(-beta * together))
    noise = white**2 / coarse * (apart < coarse)
    covariance = (own + mixed + noise) / duration
    relative = covariance / np.outer(np.exp(-beta * t), np.exp(-beta * t)) / sigma2**2
    line = np.linalg.pinv(np.column_stack([np.ones_like(t), -t]))
    spread = np.sqrt(np.diag(line @ relative @ line.T))
    return np.array([spread[0], spread[1] / beta])
