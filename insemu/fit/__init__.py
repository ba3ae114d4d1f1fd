"""A noise model from a signal, with uncertainty and rank.

One door, :func:`fit`; every method returns a :class:`FitResult`.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from insemu.errors import InputError, nearest
from insemu.fit.result import Criterion, Estimate, FitResult, GoodnessOfFit, kalibr, save
from insemu.noise import NoiseModel, Process
from insemu.records import Series
from insemu.variance import WaveletVariance, wavelet_variance

Method = Literal["gmwm"]

__all__ = ["Criterion", "Estimate", "FitResult", "GoodnessOfFit", "Method", "fit", "kalibr", "save"]


def fit(
    signal: Series | WaveletVariance | ArrayLike,
    model: NoiseModel | Process | str,
    method: Method = "gmwm",
    *,
    rate_hz: float | None = None,
    unit: str | None = None,
    name: str | None = None,
    **options: Any,
) -> FitResult:
    """Fit a noise model to a signal.

    Parameters
    ----------
    signal : Series, (n,) array or WaveletVariance
        Signal at rest (or its Haar wavelet variance, for ``gmwm``).
    model : NoiseModel, Process or str
        Structure such as ``"2*GM() + WN()"``; parameters that have a value are held.
    method : {"gmwm"}
        Estimator.
    rate_hz, unit, name
        Of an array; a :class:`~insemu.records.Series` carries them.
    **options
        Of the method, see :func:`insemu.fit.gmwm.fit_curve`.

    Raises
    ------
    InputError
        A signal, model or option that cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> from insemu.noise import WN
    >>> x = WN(N=0.1).simulate(1024, 0.01, np.random.default_rng(1))
    >>> result = fit(x, "WN()", rate_hz=100.0)
    >>> abs(result["WN1.N"].value - 0.1) < 4 * result["WN1.N"].standard_error
    True
    """
    if method not in get_args(Method):
        raise InputError(f"method is '{method}'" + nearest(str(method), get_args(Method)))
    from insemu.fit.gmwm import fit_curve

    if isinstance(signal, WaveletVariance):
        asked = _model(model, unit or "")
        return fit_curve(signal, asked, unit=unit or "", name=name or "signal", **options)
    series = as_series(signal, rate_hz, unit, name)
    asked = _model(model, series.unit)
    curve = wavelet_variance(series.values, series.rate_hz)
    return fit_curve(curve, asked, unit=series.unit, name=series.name, **options)


def as_series(signal: Series | ArrayLike, rate_hz: float | None, unit: str | None, name: str | None) -> Series:
    """A signal with its rate, unit and name.

    Raises
    ------
    InputError
        An array without a rate, or values that cannot be used.
    """
    if isinstance(signal, Series):
        return Series(
            signal.values, rate_hz or signal.rate_hz, unit if unit is not None else signal.unit, name or signal.name
        )
    if rate_hz is None:
        raise InputError("an array does not say its sampling rate; give rate_hz")
    return Series(np.asarray(signal), rate_hz, unit or "", name or "signal")


def _model(model: NoiseModel | Process | str, unit: str) -> NoiseModel:
    if isinstance(model, str):
        return NoiseModel.parse(model, unit)
    return NoiseModel((model,)) if isinstance(model, Process) else model
