"""One door to all estimators: of one signal, or of every axis of a log."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from insemu.errors import InputError, nearest
from insemu.fit.gmwm import Weighting, Weights, fit_curve
from insemu.fit.indirect import bootstrap_intervals
from insemu.fit.likelihood import Pattern
from insemu.fit.result import FitResult
from insemu.fit.selection import wic
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


@dataclass(frozen=True, kw_only=True)
class Estimator:
    """A method with its options, for every axis of a log.

    Parameters
    ----------
    method : str
        See :func:`fit`.
    robust : bool
        Use the wavelet variance that outliers cannot move (gmwm, indirect).
    wavelet : str
        Filter of the wavelet variance (gmwm).
    weighting : str
        Of gmwm, see :func:`insemu.fit.gmwm.fit_curve`.
    pattern : str
        Of mli.
    start : NoiseModel or str, optional
        Values to start from (gmwm, em, mli).
    tau_from, tau_to : float
        Scales to use (gmwm), s.
    seed : int
        Of bootstrap and draws.
    """

    method: Method = "gmwm"
    robust: bool = False
    wavelet: str = "haar"
    weighting: Weighting = "auto"
    pattern: Pattern = "uniform"
    start: NoiseModel | str | None = None
    tau_from: float = 0.0
    tau_to: float = math.inf
    seed: int = 0

    def generators(self, count: int) -> list[np.random.Generator]:
        """One for each axis, whatever the order in which threads come to it."""
        return np.random.default_rng(self.seed).spawn(count)

    def options(self, unit: str, rng: np.random.Generator) -> dict[str, Any]:
        """Options of the method for an axis of this unit."""
        out: dict[str, Any] = {}
        if self.method == "gmwm":
            out |= {"weighting": Weights(self.weighting, rng=rng), "tau_from": self.tau_from, "tau_to": self.tau_to}
        elif self.method == "mli":
            out["pattern"] = self.pattern
        elif self.method == "indirect":
            out["rng"] = rng
        if self.start:
            out["start"] = NoiseModel.parse(self.start, unit) if isinstance(self.start, str) else self.start
        return out

    def fit(
        self,
        series: Sequence[Series],
        model: NoiseModel | Process | str,
        *,
        workers: int = 1,
        progress: Callable[[str], None] = lambda name: None,
        own: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> dict[str, FitResult]:
        """Fit every axis; the name of the axis goes in front of what is wrong with it.

        Parameters
        ----------
        series : sequence of Series
        model : NoiseModel, Process or str
        workers : int
            Axes at a time.
        progress : callable
            Given the name of an axis when it is finished.
        own : mapping of axis to mapping, optional
            Options of one axis.
        """
        models = {s.unit: _model(model, s.unit) for s in series}
        if any(p.shared for m in models.values() for p in m):
            return self._together(series, models)

        def one(s: Series, rng: np.random.Generator) -> FitResult:
            try:
                given = {"robust": self.robust, "wavelet": self.wavelet, **self.options(s.unit, rng)}
                result = fit(s, models[s.unit], self.method, **given | dict((own or {}).get(s.name, {})))
            except InputError as error:
                known = error.where or error.message.startswith(s.name)
                raise InputError(error.message, where=error.where if known else s.name) from None
            progress(s.name)
            return result

        with ThreadPoolExecutor(max_workers=min(workers, len(series))) as pool:
            found = pool.map(one, series, self.generators(len(series)))
            return {s.name: r for s, r in zip(series, found, strict=True)}

    def _together(self, series: Sequence[Series], models: Mapping[str, NoiseModel]) -> dict[str, FitResult]:
        """Axes whose model has shared processes."""
        if self.method != "gmwm" or self.robust or self.start or self.wavelet != "haar":
            raise InputError(
                "a model with shared processes is fitted by gmwm with the Haar filter, without robust and start",
                where="model",
            )
        return fit_together(
            series, {s.name: models[s.unit] for s in series}, tau_from=self.tau_from, tau_to=self.tau_to
        )


def bootstrapped(item: tuple[FitResult, int, np.random.Generator]) -> FitResult:
    """A fit with intervals and criterion from simulated signals: (fit, number of signals, generator)."""
    result, count, rng = item
    return replace(bootstrap_intervals(result, count, rng), criterion=wic(result, bootstrap=count, rng=rng))


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
