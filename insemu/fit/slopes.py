"""Slopes of the Allan variance or of the PSD read as a model: N to white noise, B and Tc to a Gauss-Markov noise, K to random walk.

The graphical method of Quinchia et al. 2013 (section 4.3-4.4, equations (27)-(30)), which other methods are compared with. It reads each
straight part for itself, so that a part which never dominates is not there, and it cannot separate two correlation times.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.fit.result import Estimate, FitResult, unit_of
from insemu.noise import GM, NoiseModel, Process
from insemu.records import Series
from insemu.variance import FLICKER, Reading, allan_variance, average_frequencies, psd, read_curve, wavelet_variance

Array = NDArray[np.float64]
Source = Literal["allan", "psd"]

#: Standard error and interval of the parameters of a process.
Errors = dict[str, tuple[float, float, float]]

#: Processes whose level a slope gives; a GM is read off a flat part or hump.
STRAIGHT = ("WN", "QN", "RW", "DR", "BI")


def fit_slopes(series: Series, model: NoiseModel, *, source: Source = "allan") -> FitResult:
    """Read the parameters of a model off the slopes.

    Parameters
    ----------
    series : Series
    model : NoiseModel
        At most one each of WN, QN, RW, DR, BI and GM. A GM has ``sigma = 0.664 B`` and the correlation time of the flat part or hump.
    source : {"allan", "psd"}
        Where slopes are read: overlapping Allan variance (-1, 0, 1 for N, B, K) or averaged PSD (0, -1, -2).

    Returns
    -------
    FitResult
        Standard errors from the readings' intervals; a coefficient whose slope is not visible is zero, with a warning.

    Raises
    ------
    InputError
        A process that has no slope, or one that appears twice.
    """
    if source not in get_args(Source):
        raise InputError(f"source is '{source}', expected one of: {', '.join(get_args(Source))}")
    kinds = [p.symbol for p in model]
    for kind in kinds:
        if kind not in (*STRAIGHT, "GM"):
            raise InputError(
                f"{kind} has no slope of its own; expected a sum of {', '.join(STRAIGHT)} and GM (or use gmwm)"
            )
        if kinds.count(kind) > 1:
            raise InputError(f"slopes cannot tell {kinds.count(kind)} {kind} apart; expected one of each (or use gmwm)")
    read = (
        read_curve(allan_variance(series.values, series.rate_hz), series.unit)
        if source == "allan"
        else _read_psd(series)
    )
    notes: list[str] = []
    parts: list[Process] = []
    errors: list[Errors] = []
    for p in model:
        found, spread, note = (p, {}, "") if p.specified else _read_off(p, read, series)
        parts.append(found)
        errors.append(spread)
        notes += [note] if note else []
    fitted = NoiseModel(tuple(parts))
    curve = wavelet_variance(series.values, series.rate_hz)
    parameters = []
    for k, (index, p) in enumerate(fitted.indexed()):
        for meta in p.parameters_meta():
            error, low, high = errors[k].get(meta.name, (math.nan, math.nan, math.nan))
            unit = unit_of(meta, series.unit)
            free = not model.processes[k].specified
            parameters.append(
                Estimate(p.symbol, index, meta.name, p.parameters[meta.name], unit, error, low, high, free)
            )
    values = fitted.wavelet_variance(curve.scale_samples, series.dt)
    objective = float(np.sum((np.log(np.maximum(values, 1e-300)) - np.log(curve.value)) ** 2))
    variances = np.array([e.standard_error**2 for e in parameters if e.free])
    return FitResult(
        name=series.name,
        method="slopes",
        structure=model,
        model=fitted,
        rate_hz=series.rate_hz,
        n_samples=len(series),
        unit=series.unit,
        parameters=tuple(parameters),
        covariance=np.diag(variances),
        curve=curve,
        fitted=values,
        objective=objective,
        converged=not any("set to zero" in note for note in notes),
        warnings=tuple(notes),
        details={"source": source, "readings": read},
    )


def _read_off(p: Process, read: Mapping[str, Reading], series: Series) -> tuple[Process, Errors, str]:
    """A process with the values that the slopes give, the errors of its parameters, and what is to be said of them."""
    if isinstance(p, GM):
        B, Tc = read.get("B"), read.get("Tc")
        if B is None or Tc is None:
            return (
                GM(0.0, 1.0 / series.dt / len(series)),
                {},
                "GM: no flat part or hump is visible; its variance is set to zero",
            )
        sigma, beta = FLICKER * B.si_value, 1.0 / Tc.si_value
        spread = {"sigma": _relative(B, sigma)}
        if Tc.low > 0 and math.isfinite(Tc.high):
            low, high = beta * Tc.value / Tc.high, beta * Tc.value / Tc.low
            spread["beta"] = ((high - low) / 3.92, low, high)
        return GM(sigma, beta), spread, f"GM: its correlation time was read at the {Tc.note}" if Tc.note else ""
    name = p.level.name
    found = read.get(name)
    if found is None:
        zero = p.with_parameters({name: 0.0})
        return zero, {}, f"{p.symbol}: no part of the curve has its slope; its {name} is set to zero"
    note = f"{p.symbol}: {found.note}" if found.note else ""
    return p.with_parameters({name: found.si_value}), {name: _relative(found, found.si_value)}, note


def _relative(reading: Reading, value: float) -> tuple[float, float, float]:
    """Standard error and interval of a reading carried to another unit."""
    low, high = value * reading.low / reading.value, value * reading.high / reading.value
    return (high - low) / 3.92, low, high


def _read_psd(series: Series) -> dict[str, Reading]:
    """N, B and K from the straight parts of the averaged PSD: N^2, B^2 / (2 pi f), K^2 / (2 pi f)^2 (two-sided)."""
    averaged = average_frequencies(psd(series.values, series.rate_hz), per_decade=8)
    f, level, edof = averaged.f_hz, averaged.psd, averaged.edof
    # the first bins of a window leak, the last fold
    use = (f > 4.0 * f[0]) & (f < 0.35 * series.rate_hz)
    if use.sum() < 6:
        return {}
    f, level, edof = f[use], level[use], edof[use]
    x, y = np.log(f), np.log(level)
    slope = np.array([_local_slope(x, y, edof, i) for i in range(f.size)])
    out: dict[str, Reading] = {}
    for name, power, factor in (
        ("N", 0.0, 1.0),
        ("B", -1.0, 1.0 / (2.0 * math.pi)),
        ("K", -2.0, 1.0 / (2.0 * math.pi) ** 2),
    ):
        span = _longest(np.abs(slope - power) < 0.3)
        if span is None:
            continue
        at = slice(*span)
        weight = edof[at]
        square = math.exp(float(np.average(y[at] - power * x[at], weights=weight))) / factor
        value = math.sqrt(square)
        error = value * math.sqrt(0.5 / float(weight.sum()))
        out[name] = replace(
            _blank(name, series.unit),
            value=value,
            si_value=value,
            low=value - 1.96 * error,
            high=value + 1.96 * error,
            tau_from_s=1.0 / f[at][-1],
            tau_to_s=1.0 / f[at][0],
        )
        if name == "B":
            # the middle of the part that falls by 1/f, as an averaging time
            middle = math.exp(-0.5 * (x[at][0] + x[at][-1])) / (2.0 * math.pi)
            out["Tc"] = Reading(
                "Tc", middle, math.nan, math.nan, "s", middle, 1.0 / f[at][-1], 1.0 / f[at][0], "middle of the 1/f part"
            )
    return out


def _blank(name: str, unit: str) -> Reading:
    return Reading(name, 0.0, 0.0, 0.0, unit, 0.0, 0.0, 0.0)


def _local_slope(x: Array, y: Array, weight: Array, i: int) -> float:
    near = slice(max(i - 3, 0), i + 4)
    a, b, w = x[near], y[near], weight[near]
    mean = np.average(a, weights=w)
    return float(np.sum(w * (a - mean) * b) / np.sum(w * (a - mean) ** 2))


def _longest(inside: NDArray[np.bool_]) -> tuple[int, int] | None:
    """The longest run of at least four."""
    best: tuple[int, int] | None = None
    start = None
    for i, value in enumerate([*inside.tolist(), False]):
        if value and start is None:
            start = i
        elif not value and start is not None:
            if i - start >= 4 and (best is None or i - start > best[1] - best[0]):
                best = start, i
            start = None
    return best
