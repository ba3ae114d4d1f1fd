"""A noise model from a signal, with uncertainty and rank.

One door, :func:`fit`; every method returns a :class:`FitResult`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from insemu.errors import InputError, nearest
from insemu.fit.covariance import covariance_of_curve, model_covariance
from insemu.fit.following import Followed, FollowingFit, Segment, fit_following, followed
from insemu.fit.indirect import bootstrap_intervals, check_bootstrap
from insemu.fit.likelihood import LARGE, fit_mli_pieces
from insemu.fit.online import Alarm, OnlineFit, Update
from insemu.fit.regressors import Coefficient, RegressedFit, fit_regressed
from insemu.fit.result import LEAST_P, Criterion, Estimate, FitResult, GoodnessOfFit, save
from insemu.fit.robust import cleaned_curve
from insemu.fit.runs import Choice, RunsFit, choose_model, fit_runs
from insemu.fit.selection import RANK_DOF, Ranking, prediction_distance, select_axes, wic
from insemu.fit.together import fit_together
from insemu.noise import NoiseModel, Process
from insemu.records import Series
from insemu.variance import WaveletVariance, wavelet_variance

Method = Literal[
    "gmwm",
    "indirect",
    "em",
    "mli",
    "slopes",
    "psd-slopes",
    "hadamard-slopes",
    "total-slopes",
    "autocorrelation",
    "burg",
]

__all__ = [
    "LARGE",
    "LEAST_P",
    "RANK_DOF",
    "Alarm",
    "Choice",
    "Coefficient",
    "Criterion",
    "Estimate",
    "FitResult",
    "Followed",
    "FollowingFit",
    "GoodnessOfFit",
    "Method",
    "OnlineFit",
    "Ranking",
    "RegressedFit",
    "RunsFit",
    "Segment",
    "Update",
    "bootstrap_intervals",
    "check_bootstrap",
    "choose_model",
    "cleaned_curve",
    "covariance_of_curve",
    "fit",
    "fit_following",
    "fit_mli_pieces",
    "fit_regressed",
    "fit_runs",
    "fit_together",
    "followed",
    "model_covariance",
    "prediction_distance",
    "save",
    "select_axes",
    "wic",
]


def fit(
    signal: Series | WaveletVariance | ArrayLike,
    model: NoiseModel | Process | str,
    method: Method = "gmwm",
    *,
    rate_hz: float | None = None,
    unit: str | None = None,
    name: str | None = None,
    robust: bool = False,
    wavelet: str = "haar",
    **options: Any,
) -> FitResult:
    """Fit a noise model to a signal.

    Parameters
    ----------
    signal : Series, (n,) array or WaveletVariance
        Signal at rest, for ``gmwm`` with missing samples where it says so (or its wavelet variance, for ``gmwm``).
    model : NoiseModel, Process or str
        Structure such as ``"2*GM() + WN()"``; parameters that have a value are held.
    method : {"gmwm", "indirect", "em", "mli", "slopes", "psd-slopes", "hadamard-slopes", "total-slopes", "autocorrelation", "burg"}
        Wavelet moments, the same by simulation (needs ``rng``), constrained expectation-maximization, integrated maximum likelihood, slopes
        of the Allan variance, of the PSD, of the Hadamard and of the total variance, the autocorrelation, Burg's autoregression.
    robust : bool
        Of ``gmwm`` and ``indirect``: use the robust wavelet variance, at the ``efficiency`` that is given.
    wavelet : str
        Of ``gmwm``: filter of the wavelet variance, a name of :data:`insemu.variance.filters.FILTERS`.
    rate_hz, unit, name
        Of an array; a :class:`~insemu.records.Series` carries them.
    **options
        Of the method, see :func:`insemu.fit.gmwm.fit_curve`, :func:`insemu.fit.indirect.fit_indirect`,
        :func:`insemu.fit.em.fit_em`, :func:`insemu.fit.likelihood.fit_mli`,
        :func:`insemu.fit.slopes.fit_slopes`, :func:`insemu.fit.autocorrelation.fit_autocorrelation`,
        :func:`insemu.fit.burg.fit_burg`.

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
        if method != "gmwm":
            raise InputError(f"method '{method}' needs the signal itself, not its wavelet variance")
        efficiency = getattr(signal, "efficiency", 1.0)
        return fit_curve(
            signal,
            _model(model, unit or ""),
            unit=unit or "",
            name=name or "signal",
            **{"efficiency": efficiency, **options},
        )
    series = as_series(signal, rate_hz, unit, name)
    asked = _model(model, series.unit)
    if wavelet != "haar" and (method != "gmwm" or robust):
        raise InputError(f"wavelet '{wavelet}' belongs to gmwm without robust, not to '{method}'")
    if robust or method != "gmwm":
        series = series.complete("the robust wavelet variance" if robust else f"the method '{method}'")
    if method == "gmwm":
        if robust:
            return _fit_robust(series, asked, options)
        return fit_curve(
            wavelet_variance(series.values, series.rate_hz, filter=wavelet, gaps=series.gaps),
            asked,
            unit=series.unit,
            name=series.name,
            **options,
        )
    if method == "indirect":
        from insemu.fit.indirect import fit_indirect

        return fit_indirect(series, asked, robust=robust, **options)
    if robust:
        raise InputError(f"robust belongs to gmwm, not to '{method}'")
    if method == "em":
        from insemu.fit.em import fit_em

        return fit_em(series, asked, **options)
    if method == "mli":
        from insemu.fit.likelihood import fit_mli

        return fit_mli(series, asked, **options)
    if method.endswith("slopes"):
        from insemu.fit.slopes import fit_slopes

        source = method.removesuffix("slopes").removesuffix("-") or "allan"
        return fit_slopes(series, asked, source=source, **options)  # type: ignore[arg-type]
    if method == "autocorrelation":
        from insemu.fit.autocorrelation import fit_autocorrelation

        return fit_autocorrelation(series, asked, **options)
    from insemu.fit.burg import fit_burg

    return fit_burg(series, asked, **options)


def _fit_robust(series: Series, asked: NoiseModel, options: dict[str, Any]) -> FitResult:
    from insemu.fit.gmwm import fit_curve
    from insemu.fit.robust import EFFICIENCY, cleaned_curve

    given = dict(options)
    efficiency = float(given.pop("efficiency", EFFICIENCY))
    cleaned = cleaned_curve(series, asked, efficiency)
    result = fit_curve(cleaned.curve, asked, unit=series.unit, name=series.name, **given)
    details = {**result.details, "robust_efficiency": efficiency, "outliers": cleaned.outliers}
    return replace(result, warnings=(*result.warnings, cleaned.outliers.note(series.rate_hz)), details=details)


def as_series(signal: Series | ArrayLike, rate_hz: float | None, unit: str | None, name: str | None) -> Series:
    """A signal with its rate, unit and name.

    Parameters
    ----------
    signal : Series or (n,) array
    rate_hz : float, optional
        Sampling rate; a series carries it.
    unit, name : str, optional
        Of the signal; a series carries them.

    Raises
    ------
    InputError
        An array without a rate, or values that cannot be used.
    """
    if isinstance(signal, Series):
        return Series(
            signal.values,
            rate_hz or signal.rate_hz,
            unit if unit is not None else signal.unit,
            name or signal.name,
            signal.gaps,
        )
    if rate_hz is None:
        raise InputError("an array does not say its sampling rate; give rate_hz")
    return Series(np.asarray(signal), rate_hz, unit or "", name or "signal")


def _model(model: NoiseModel | Process | str, unit: str) -> NoiseModel:
    if isinstance(model, str):
        return NoiseModel.parse(model, unit)
    return NoiseModel((model,)) if isinstance(model, Process) else model
