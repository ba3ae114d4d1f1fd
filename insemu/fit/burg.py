"""Burg's autoregression, after wavelet de-noising where wanted (Quinchia et al. 2013, sections 4.2 and 5.3).

Burg's recursion minimises forward and backward prediction errors together and gives reflection coefficients below one, so the polynomial
is stationary as long as its digits are kept. Printed to a few decimals it may not be (the polynomials of Quinchia et al. 2013, Table 2, are a case in
point), which is said here, and such a process is refused wherever a filter would take it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu.denoise import Rule, denoise
from insemu.errors import InputError
from insemu.fit.result import FitResult, estimates
from insemu.noise import AR, AR1, NoiseModel
from insemu.records import Series
from insemu.variance import wavelet_variance

Array = NDArray[np.float64]


def burg(x: ArrayLike, order: int) -> tuple[Array, Array]:
    """Coefficients of autoregressions of every order up to ``order``.

    Parameters
    ----------
    x : (n,) array
        Signal without its mean.
    order : int
        The highest.

    Returns
    -------
    coefficients : (order, order) array
        Row p - 1 has the p coefficients of ``x_k = sum a_i x_(k-i) + w_k``.
    variance : (order + 1,) array
        Innovation variance of every order, 0 included.

    Raises
    ------
    InputError
        An order that is not between 1 and half of the record's length.
    """
    values = np.asarray(x, dtype=np.float64)
    if not 1 <= order <= values.size // 2:
        raise InputError(f"order is {order}, expected 1 to {values.size // 2} for {values.size} samples")
    forward, backward = values[1:].copy(), values[:-1].copy()
    variance = np.empty(order + 1)
    variance[0] = float(values @ values) / values.size
    coefficients = np.zeros((order, order))
    a = np.zeros(0)
    for p in range(order):
        energy = float(forward @ forward + backward @ backward)
        r = 2.0 * float(forward @ backward) / energy if energy > 0 else 0.0
        a = np.concatenate([a - r * a[::-1], [r]])
        coefficients[p, : p + 1] = a
        variance[p + 1] = variance[p] * (1.0 - r) * (1.0 + r)
        if p + 1 < order:
            forward, backward = (forward - r * backward)[1:], (backward - r * forward)[:-1]
    return coefficients, variance


def choose_order(variance: Array, n: int) -> tuple[int, Array]:
    """Order with the least corrected Akaike criterion, and the criterion of orders 1, 2, ..."""
    orders = np.arange(1, variance.size)
    with np.errstate(divide="ignore"):
        criterion = n * np.log(variance[1:]) + 2.0 * orders * n / np.maximum(n - orders - 1, 1)
    return int(orders[np.argmin(criterion)]), criterion


def _notes(fitted: AR | AR1, coefficients: Array, radius: float, denoised: str) -> list[str]:
    """What to beware of in an autoregression whose outermost pole has this modulus."""
    notes: list[str] = []
    if radius >= 1.0:
        assert isinstance(fitted, AR)
        notes.append(
            f"the polynomial is not stationary (a pole of modulus {radius:.9f}); it is refused by filters. The nearest stationary one is "
            f"{[float(f'{v:.9g}') for v in fitted.stabilised().ar if v is not None]}"
        )
    digits = 3
    while digits < 16 and _radius(np.round(coefficients, digits)) >= 1.0:
        digits += 1
    if digits > 3 and radius < 1.0:
        notes.append(
            f"printed to fewer than {digits} decimals the polynomial is not stationary (a pole of modulus {radius:.9f})"
        )
    if denoised:
        notes.append(
            f"{denoised} first: the process describes the rest, not the signal's white noise, and standard "
            "errors that take it for white-driven are too small"
        )
    return notes


def fit_burg(
    series: Series,
    model: NoiseModel,
    *,
    denoise_levels: int = 0,
    denoise_rule: Rule = "sure",
    wavelet: str = "db4",
    choose: bool = False,
    confidence: float = 0.95,
) -> FitResult:
    """Fit an autoregression by Burg's method.

    Parameters
    ----------
    series : Series
    model : NoiseModel
        One ``AR(p)`` or ``AR1()``; the order is the highest one where ``choose`` is set.
    denoise_levels : int
        Octaves that are de-noised first (6 and 7 in Quinchia et al. 2013).
    denoise_rule : {"sure", "universal", "approximation", "packets"}
        What becomes of their details, see :func:`insemu.denoise.denoise`. Table 2 of Quinchia et al. 2013 comes from ``"approximation"``.
    wavelet : str
        Of the de-noising.
    choose : bool
        Choose the order by the corrected Akaike criterion.
    confidence : float
        Of the intervals.

    Raises
    ------
    InputError
        Another model; bad options.
    """
    if len(model) != 1 or not isinstance(model.processes[0], AR | AR1):
        raise InputError(f"Burg's method fits one autoregression, not {model}; expected AR(p) or AR1()")
    asked = model.at_rate(series.rate_hz).processes[0]
    assert isinstance(asked, AR | AR1)
    x = np.array(series.values)
    x -= x.mean()
    if denoise_levels:
        x = denoise(x, denoise_levels, wavelet=wavelet, rule=denoise_rule)
        x -= x.mean()
    if not x.any():
        raise InputError(f"{series.name} is constant; there is nothing to fit")
    n = x.size
    highest = len(asked.ar) if isinstance(asked, AR) else 1
    coefficients, variance = burg(x, highest)
    criteria = choose_order(variance, n)
    order = criteria[0] if choose else highest
    a, sigma2 = coefficients[order - 1, :order], float(variance[order])
    fitted: AR | AR1
    if isinstance(asked, AR1):
        fitted = replace(asked, phi=float(np.clip(a[0], -1 + 1e-15, 1 - 1e-15)), sigma2=sigma2)
    else:
        fitted = AR(tuple(float(v) for v in a), sigma2=sigma2, rate_hz=series.rate_hz)
    radius = abs(float(a[0])) if isinstance(fitted, AR1) else fitted.spectral_radius
    stationary = radius < 1.0
    what = "left out" if denoise_rule == "approximation" else f"de-noised by the rule '{denoise_rule}'"
    notes = _notes(fitted, a, radius, f"{denoise_levels} octaves were {what}" if denoise_levels else "")
    structure = NoiseModel((asked if isinstance(asked, AR1) or not choose else AR.of_order(order),))
    whole = NoiseModel((fitted,))
    covariance = (
        _covariance(a, sigma2, n, isinstance(asked, AR1)) if stationary else np.full((order + 1, order + 1), np.nan)
    )
    free = [(0, meta.name) for meta in fitted.parameters_meta()]
    curve = wavelet_variance(series.values, series.rate_hz)
    if stationary:
        values = whole.wavelet_variance(curve.scale_samples, series.dt)
    else:
        values = np.full(len(curve), np.nan)
    return FitResult(
        name=series.name,
        method="burg",
        structure=structure,
        model=whole,
        rate_hz=series.rate_hz,
        n_samples=n,
        unit=series.unit,
        parameters=estimates(whole, free, covariance, series.unit, confidence),
        covariance=covariance,
        curve=curve,
        fitted=values,
        objective=sigma2,
        converged=stationary,
        warnings=tuple(notes),
        details={
            "criterion": criteria[1],
            "order": order,
            "innovation_variance": variance,
            "spectral_radius": radius,
            "free": free,
        },
    )


def _radius(a: Array) -> float:
    """Largest modulus of the poles of a polynomial."""
    return float(np.max(np.abs(np.roots(np.concatenate([[1.0], -a]))), initial=0.0))


def _covariance(a: Array, sigma2: float, n: int, single: bool) -> Array:
    """Large-sample covariance ``sigma^2 R^-1 / n`` of the coefficients, and ``2 sigma^4 / n`` of the innovation variance."""
    p = a.size
    process = (
        AR1(float(a[0]), sigma2, rate_hz=1.0) if single else AR(tuple(float(v) for v in a), sigma2=sigma2, rate_hz=1.0)
    )
    out = np.zeros((p + 1, p + 1))
    try:
        gamma = process.autocovariance(np.arange(p), 1.0)
        out[:p, :p] = sigma2 * np.linalg.inv(scipy.linalg.toeplitz(gamma)) / n
    except (np.linalg.LinAlgError, InputError):
        out[:p, :p] = np.nan
    out[p, p] = 2.0 * sigma2**2 / n
    out[:p, :p][np.diag_indices(p)] = np.where(np.diag(out)[:p] >= 0, np.diag(out)[:p], math.nan)
    return out
