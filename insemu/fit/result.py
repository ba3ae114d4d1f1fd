"""What every estimator returns: parameters with uncertainty, how well they fit, and what to beware of."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy  # whose parts are imported when they are used
import yaml
from numpy.typing import NDArray

from insemu import units
from insemu.errors import InputError
from insemu.noise import NoiseModel, Parameter, Spread, process_label
from insemu.shown import Shown, p_words
from insemu.variance import WaveletVariance
from insemu.whole import put

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]


#: A model whose test of fit has a smaller p-value is contradicted by the data.
LEAST_P = 0.05


@dataclass(frozen=True)
class Estimate:
    """One estimated parameter.

    Parameters
    ----------
    process, index, name : str, int, str
        ``GM``, 2, ``beta``: the second GM's inverse correlation time.
    value : float
        SI.
    unit : str
        SI unit.
    standard_error : float
        NaN where there is none (at the edge of what is possible, or not identifiable).
    low, high : float
        Confidence interval; NaN where there is none.
    free : bool
        False for a value that was given and held.
    """

    process: str
    index: int
    name: str
    value: float
    unit: str
    standard_error: float = math.nan
    low: float = math.nan
    high: float = math.nan
    free: bool = True

    @property
    def label(self) -> str:
        """For tables: ``GM2.beta``, ``AR1#1.phi``."""
        return f"{process_label(self.process, self.index)}.{self.name}"


#: A process is not determined where the standard error of a parameter is more than so many times its value.
SEVERAL = 3.0
#: Ratio of the ends of an interval from which it says nothing.
UNDETERMINED = 1e6


@dataclass(frozen=True)
class GoodnessOfFit:
    """A test of the model against the curve: a chi-square statistic, its degrees of freedom, its p-value, the scales that it used (s)."""

    statistic: float
    dof: int
    p_value: float
    tau_s: Array


@dataclass(frozen=True)
class Criterion:
    """Expected squared distance (in the weights' metric) to the wavelet variance of a record not seen, with its standard error."""

    value: float
    standard_error: float
    penalty: float


@dataclass(frozen=True, repr=False)
class FitResult(Shown):
    """A fitted noise model; the same type for every method.

    Parameters
    ----------
    name : str
        Axis (``gyro_x``) or column.
    method : str
        ``gmwm``, ``em``, ``mli``, ``slopes``, ``burg``.
    structure : NoiseModel
        What was asked for; parameters with a value were held.
    model : NoiseModel
        What was found.
    rate_hz, n_samples, unit
        Of the signal.
    parameters : tuple of Estimate
        In the order of the model.
    covariance : (p, p) array
        Of the free parameters, in their order.
    curve : WaveletVariance or None
        The empirical curve.
    fitted : (J,) array
        The model's wavelet variance at the curve's scales.
    objective : float
        What the method minimised (for GMWM the weighted squared distance) or, for likelihoods, minus the log-likelihood.
    converged : bool
    warnings : tuple of str
        What to beware of, in plain words.
    test, criterion
        Goodness of fit and selection criterion, where computed.
    details : mapping
        What is special to the method: likelihood traces, chosen orders.
    """

    name: str
    method: str
    structure: NoiseModel
    model: NoiseModel
    rate_hz: float
    n_samples: int
    unit: str
    parameters: tuple[Estimate, ...]
    covariance: Array
    curve: WaveletVariance | None
    fitted: Array
    objective: float
    converged: bool
    warnings: tuple[str, ...] = ()
    test: GoodnessOfFit | None = None
    criterion: Criterion | None = None
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def dt(self) -> float:
        """Sampling interval, s."""
        return 1.0 / self.rate_hz

    def __getitem__(self, label: str) -> Estimate:
        """The estimate with a label such as ``GM2.beta``."""
        for e in self.parameters:
            if e.label == label:
                return e
        raise KeyError(f"{label}; there are {', '.join(e.label for e in self.parameters)}")

    def scale_residuals(self) -> Array:
        """Empirical minus fitted over the fitted wavelet variance, per scale."""
        if self.curve is None:
            raise InputError(f"{self.name}: a {self.method} fit without a wavelet variance has no residuals per scale")
        return np.asarray(self.curve.value / self.fitted - 1.0)

    @property
    def bears(self) -> bool:
        """Whether nothing speaks against the model: it converged, and its test of fit, where there is one, is passed."""
        return self.converged and (self.test is None or self.test.p_value >= LEAST_P)

    @property
    def verdict(self) -> str:
        """Whether the data bear the model, in words."""
        if not self.converged:
            return "not converged"
        if self.test is None:
            return "not tested"
        said = "compatible with the data" if self.bears else "contradicted by the data"
        return f"{said} ({p_words(self.test.p_value)})"

    @property
    def words(self) -> str:
        """The model with its values in datasheet units, in one line."""
        return ", ".join(f"{e.label} {_familiar(e)}" for e in self.parameters)

    def __str__(self) -> str:
        head = f"{self.name}: {self.structure} by {self.method}, {self.n_samples} samples at {self.rate_hz:g} Hz: {self.verdict}"
        rows = self.rows()
        lines = [
            f"  {label:<12} {value:<28} {interval}  {familiar}".rstrip()
            for label, value, interval, familiar in rows[:8]
        ]
        return "\n".join([head, *lines, *([f"  and {len(rows) - 8} more (.rows())"] if len(rows) > 8 else [])])

    def to_dataframe(self) -> pd.DataFrame:
        """One row per parameter: SI value, standard error, interval, and what datasheets call it."""
        import pandas as pd

        keys = ("value", "standard_error", "low", "high", "unit", "free")
        rows = [[getattr(e, key) for key in keys] + [_familiar(e)] for e in self.parameters]
        return pd.DataFrame(rows, index=[e.label for e in self.parameters], columns=[*keys, "datasheet"])

    def to_json(self) -> dict[str, Any]:
        """The stable machine-readable form of one axis; numbers that do not exist are None."""
        tau = self.curve.tau_s if self.curve is not None else np.zeros(0)
        out: dict[str, Any] = {
            "model": str(self.structure),
            "method": self.method,
            "parameters": [
                {
                    "process": e.process,
                    "index": e.index,
                    "name": e.name,
                    "value": e.value,
                    "unit": e.unit,
                    "standard_error": _number(e.standard_error),
                    "interval": [_number(e.low), _number(e.high)],
                    "fixed": not e.free,
                }
                for e in self.parameters
            ],
            "objective": _number(self.objective),
            "converged": self.converged,
            "warnings": list(self.warnings),
            "fitted_wavelet_variance": {"tau_s": tau.tolist(), "value": self.fitted.tolist()},
            "rate_hz": self.rate_hz,
            "n_samples": self.n_samples,
        }
        if "weighting" in self.details:
            out["weighting"] = self.details["weighting"]
        if self.curve is not None:
            out["empirical_wavelet_variance"] = {
                "tau_s": tau.tolist(),
                "value": self.curve.value.tolist(),
                "low": [_number(v) for v in self.curve.low],
                "high": [_number(v) for v in self.curve.high],
            }
        if self.test is not None:
            out["goodness_of_fit"] = {
                "statistic": self.test.statistic,
                "dof": self.test.dof,
                "p_value": self.test.p_value,
            }
        if self.criterion is not None:
            out["criterion"] = {"value": self.criterion.value, "standard_error": _number(self.criterion.standard_error)}
        return out

    def rows(self) -> list[tuple[str, str, str, str]]:
        """For a table: parameter, value with standard error and interval in datasheet units, and the SI value with the discrete view."""
        out = []
        discrete = discrete_view(self.model, self.dt)
        for e in self.parameters:
            factor, unit = units.datasheet(1.0, e.unit)
            shown, error, ends = factor * e.value, factor * e.standard_error, (factor * e.low, factor * e.high)
            if e.name == "beta":  # the correlation time is what people know, to first order in the error
                shown, error, ends, unit = (
                    1.0 / e.value,
                    e.standard_error / e.value**2,
                    (1.0 / e.high, 1.0 / e.low),
                    "s",
                )
            spread = f" ± {error:.2g}" if math.isfinite(error) else ""
            value = f"{'Tc ' * (e.name == 'beta')}{shown:.4g}{spread} {_plain(unit)}".strip()
            known = math.isfinite(ends[0]) and math.isfinite(ends[1])
            interval = f"{ends[0]:.4g} … {ends[1]:.4g}" if known else ("held" if not e.free else "–")
            interval = "not determined" if known and ends[1] > UNDETERMINED * ends[0] > 0.0 else interval
            si = f"{e.value:.4g} {e.unit}" if unit != e.unit else ""
            out.append((e.label, value, interval, ", ".join(t for t in (si, discrete.get(e.label)) if t)))
        return out


def _familiar(e: Estimate) -> str:
    """A value as datasheets have it."""
    if e.name == "beta":
        return f"Tc = {1.0 / e.value:.4g} s"
    value, unit = units.datasheet(e.value, e.unit)
    return f"{value:.4g} {_plain(unit)}".strip()


def _plain(unit: str) -> str:
    return "" if unit == "1" else unit


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def discrete_view(model: NoiseModel, dt: float) -> dict[str, str]:
    """The parametrisation of the GMWM literature, per sample: variances of white noise, of random-walk steps, phi and innovation variance."""
    return {
        f"{p.symbol}{index}.{name}": text for index, p in model.indexed() for name, text in p.per_sample(dt).items()
    }


def unit_of(parameter: Parameter, signal_unit: str) -> str:
    """SI unit of a parameter; where the signal's is not known, only what does not depend on it."""
    return parameter.unit_for(signal_unit) if signal_unit or "{u}" not in parameter.unit else ""


def estimates(
    model: NoiseModel, free: list[tuple[int, str]], covariance: Array, unit: str, confidence: float = 0.95
) -> tuple[Estimate, ...]:
    """Estimates of all parameters of a model with standard errors and intervals.

    Positive parameters get intervals that are symmetric on a logarithmic scale, correlation coefficients on Fisher's; both stay where the
    parameter can be.

    Parameters
    ----------
    model : NoiseModel
        Specified.
    free : list of (process number, parameter name)
    covariance : (p, p) array
        Of the free parameters.
    unit : str
        SI unit of the signal.
    confidence : float
        Of the intervals.
    """
    z = float(scipy.special.ndtri(0.5 + 0.5 * confidence))
    place = {key: i for i, key in enumerate(free)}
    out = []
    for k, (index, p) in enumerate(model.indexed()):
        for meta in p.parameters_meta():
            value = p.parameters[meta.name]
            at = place.get((k, meta.name))
            error = math.sqrt(covariance[at, at]) if at is not None and covariance[at, at] >= 0 else math.nan
            low = high = math.nan
            if math.isfinite(error):
                if meta.positive and value > 0:
                    spread = min(z * error / value, 700.0)
                    low, high = value * math.exp(-spread), value * math.exp(spread)
                elif meta.domain == "correlation":
                    spread = z * error / max(1.0 - value**2, 1e-300)
                    low, high = math.tanh(math.atanh(value) - spread), math.tanh(math.atanh(value) + spread)
                else:
                    low, high = value - z * error, value + z * error
            si = unit_of(meta, unit)
            out.append(Estimate(p.symbol, index, meta.name, value, si, error, low, high, free=at is not None))
    return tuple(out)


def not_determined(parameters: Sequence[Estimate]) -> list[str]:
    """Processes (``GM1``) with a free parameter whose standard error is several times its value, or that alone has none."""
    free = [e for e in parameters if e.free]
    if not any(math.isfinite(e.standard_error) for e in free):
        return []  # a method without standard errors
    weak = [e for e in free if not e.standard_error <= SEVERAL * abs(e.value)]
    return list(dict.fromkeys(process_label(e.process, e.index) for e in weak))


def allan_interval(result: FitResult, confidence: float = 0.95) -> dict[str, list[float]]:
    """Averaging times from 1 s to a third of the record, and the interval of the fitted Allan deviation there, to first order in the parameters.

    Parameters
    ----------
    result : FitResult
    confidence : float
        Of the interval; parameters without a covariance add nothing to it.

    Returns
    -------
    dict of "tau_s", "low", "high" to list of float
        s and the unit of the signal; empty lists for a record of less than 3 s.
    """
    last, first = result.n_samples // 3, max(1, math.ceil(result.rate_hz))
    if last < first:
        return {"tau_s": [], "low": [], "high": []}
    m = np.unique(np.round(np.geomspace(first, last, 1 + 2 * math.ceil(math.log2(last / first) + 1))))
    here = result.model.allan_variance(m, result.dt)
    free = [e for e in result.parameters if e.free]
    slopes = np.zeros((len(free), m.size))
    processes = list(result.model)
    place = {process_label(p.symbol, index): k for k, (index, p) in enumerate(result.model.indexed())}
    for row, e in zip(slopes, free, strict=True):
        k, step = place[process_label(e.process, e.index)], 1e-5 * abs(e.value)
        if step > 0.0 and e.name in processes[k].parameters:  # a slope of a covariate leaves the curve at its reference
            moved = processes[k].with_parameters({e.name: e.value + step})
            row[:] = (moved.allan_variance(m, result.dt) - processes[k].allan_variance(m, result.dt)) / step
    known = np.nan_to_num(result.covariance, nan=0.0, posinf=0.0, neginf=0.0)
    spread = np.sqrt(np.maximum(np.einsum("ik,ij,jk->k", slopes, known, slopes), 0.0)) / here
    z = float(scipy.special.ndtri(0.5 + 0.5 * confidence))
    ends = (np.sqrt(here * np.exp(sign * np.minimum(z * spread, 50.0))) for sign in (-1.0, 1.0))
    low, high = (x.tolist() for x in ends)
    return {"tau_s": (m * result.dt).tolist(), "low": low, "high": high}


# -- files --------------------------------------------------------------------------------------------------------------------------------


def save(results: Mapping[str, FitResult], path: str | Path, spreads: Mapping[str, Spread] | None = None) -> None:
    """Write fits as YAML: the models that a scenario (and :func:`insemu.noise.load`) reads, and next to them what the fit said of them.

    Parameters
    ----------
    results : mapping of axis to FitResult
    path : path
    spreads : mapping of axis to Spread, optional
        How the parameters change between runs.
    """
    axes: dict[str, dict[str, Any]] = {}
    for axis, r in results.items():
        axes[axis] = {
            "unit": r.unit,
            "model": r.model.to_list(r.unit),
            "fit": {
                "structure": str(r.structure),
                "method": r.method,
                "rate_hz": r.rate_hz,
                "n_samples": r.n_samples,
                "objective": _number(r.objective),
                "converged": r.converged,
                "warnings": list(r.warnings),
                "standard_errors": {e.label: _number(e.standard_error) for e in r.parameters},
                "intervals": {e.label: [_number(e.low), _number(e.high)] for e in r.parameters},
                "not_determined": not_determined(r.parameters),
                "allan_deviation": allan_interval(r),
            }
            | (
                {"test": {"statistic": r.test.statistic, "dof": r.test.dof, "p_value": r.test.p_value}}
                if r.test
                else {}
            ),
        }
        if spreads and axis in spreads:
            axes[axis]["spread"] = spreads[axis].to_mapping()
    document = {"insemu_noise_models": 1, "axes": axes}
    put(path, yaml.safe_dump(document, sort_keys=False, allow_unicode=True))
