"""Everything that is said about one column of a static log: curves, readings and findings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from insemu.denoise import denoise
from insemu.errors import InputError
from insemu.shown import Shown, few
from insemu.variance import findings as judge
from insemu.variance.allan import AllanVariance, allan_variance, of_haar
from insemu.variance.reading import Reading, read_curve
from insemu.variance.robust import Contamination, RobustWaveletVariance, compare_with_robust, robust_wavelet_variance
from insemu.variance.spectrum import Spectrum, autocorrelation, average_frequencies, psd
from insemu.variance.wavelet import WaveletVariance, stream_wavelet_variance, wavelet_variance

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

#: Names of readings in the order of tables.
READINGS = ("Q", "N", "B", "K", "R", "Tc")


@dataclass(frozen=True, repr=False)
class AxisReport(Shown):
    """What is known about one column.

    Parameters
    ----------
    name, unit : str
        Column name and SI unit.
    rate_hz : float
        Sampling rate.
    samples : int
        Samples that were used.
    wavelet, robust, allan
        Curves; ``robust`` is None where the record is too long for it.
    contamination : Contamination, optional
        Plain against robust curve.
    readings : dict
        Coefficients that are visible.
    findings : list of str
        What is wrong or worth knowing.
    spectrum : Spectrum, optional
        PSD averaged over frequency.
    trend_t, trend : arrays
        Block means over time, for the eye.
    correlation : dict
        ``"lag_s"``, ``"raw"`` and ``"de-noised"`` autocorrelation (six octaves of db4, soft, SURE), some hundred lags.
    """

    name: str
    unit: str
    rate_hz: float
    samples: int
    wavelet: WaveletVariance
    robust: RobustWaveletVariance | None
    allan: AllanVariance
    contamination: Contamination | None
    readings: dict[str, Reading]
    findings: list[str] = field(default_factory=list)
    spectrum: Spectrum | None = None
    trend_t: Array = field(default_factory=lambda: np.empty(0))
    trend: Array = field(default_factory=lambda: np.empty(0))
    correlation: dict[str, Array] = field(default_factory=dict)

    def __str__(self) -> str:
        count = f"{len(self.findings)} findings" if self.findings else "nothing wrong was found"
        head = f"{self.name}: {self.samples} samples at {self.rate_hz:g} Hz: {count}"
        read = (f"  {n} {r.value:.4g} ({r.low:.4g} to {r.high:.4g}) {r.unit}" for n, r in self.readings.items())
        return few([head, *read, *(f"  {finding}" for finding in self.findings)])

    def to_dataframe(self) -> pd.DataFrame:
        """One row per reading, in datasheet units, with its interval."""
        import pandas as pd

        rows = [(r.value, r.low, r.high, r.unit, r.tau_from_s, r.tau_to_s) for r in self.readings.values()]
        return pd.DataFrame(
            rows, index=list(self.readings), columns=["value", "low", "high", "unit", "tau_from_s", "tau_to_s"]
        )

    @property
    def not_visible(self) -> list[str]:
        """Readings whose slope is not there."""
        return [name for name in READINGS if name not in self.readings]

    def to_json(self) -> dict[str, Any]:
        """Return the machine-readable form (SI; readings in datasheet units)."""
        readings = {
            name: {
                "value": r.value,
                "low": r.low,
                "high": r.high,
                "unit": r.unit,
                "tau_from_s": r.tau_from_s,
                "tau_to_s": r.tau_to_s,
                **({"note": r.note} if r.note else {}),
            }
            for name, r in self.readings.items()
        }
        robust = None
        if self.robust is not None and self.contamination is not None:
            robust = _curve(self.robust) | {
                "protected": [bool(p) for p in self.robust.protected],
                "contaminated": self.contamination.contaminated,
            }
        return {
            "unit": self.unit,
            "rate_hz": self.rate_hz,
            "samples": self.samples,
            "wavelet_variance": _curve(self.wavelet),
            "robust_wavelet_variance": robust,
            "allan_variance": _curve(self.allan),
            "readings": readings,
            "not_visible": self.not_visible,
            "findings": list(self.findings),
        }


def grouped_findings(axes: Sequence[AxisReport]) -> list[tuple[str, str]]:
    """Return ``(columns, finding)``, a finding that several columns share once."""
    of: dict[str, list[str]] = {}
    for axis in axes:
        for finding in axis.findings:
            of.setdefault(finding, []).append(axis.name)
    return [(", ".join(names), finding) for finding, names in of.items()]


def duration(seconds: float) -> str:
    """A duration as people say it.

    Examples
    --------
    >>> duration(84.0), duration(3600.0), duration(36000.0)
    ('84 s', '60 min', '10 h')
    """
    for limit, unit, name in ((120.0, 1.0, "s"), (7200.0, 60.0, "min")):
        if seconds < limit:
            return f"{seconds / unit:.3g} {name}"
    return f"{seconds / 3600.0:.3g} h"


#: Of a signal with missing samples: its longest complete part is examined for outliers from so many samples on.
LEAST_PART = 2048


def _curve(curve: WaveletVariance | AllanVariance) -> dict[str, list[float | None]]:
    def numbers(values: Array) -> list[float | None]:
        return [float(v) if np.isfinite(v) else None for v in values]

    return {key: numbers(getattr(curve, key)) for key in ("tau_s", "value", "low", "high", "edof")}


def characterise(
    x: Array, rate_hz: float, *, name: str = "signal", unit: str = "", from_robust: bool = False, filter: str = "haar"
) -> AxisReport:
    """Return curves, readings and findings of a signal in memory.

    Parameters
    ----------
    x : (n,) array
        Signal; samples that are not finite are missing. Curves and readings are then of all samples that are there, everything else is of the
        longest part without missing ones, and there is no robust curve where that part is shorter than :data:`LEAST_PART` samples.
    rate_hz : float
        Sampling rate.
    name, unit : str
        Column and SI unit.
    from_robust : bool
        Read the coefficients off the robust curve (of a signal without missing samples).
    filter : str
        Wavelet filter of the curve that is reported; outliers are judged by the Haar filter.

    Raises
    ------
    InputError
        A signal that cannot be used.
    """
    wavelet = wavelet_variance(x, rate_hz, gaps=True)
    whole, part = wavelet.lost is None, x
    if not whole:
        if from_robust:
            raise InputError(f"{name} has missing samples; the robust curve needs all of them (leave out --robust)")
        start, stop = judge.longest_good_part([x], [])
        part = np.ascontiguousarray(x[start:stop])
    robust, contamination = None, None
    if whole or part.size >= LEAST_PART:
        own = wavelet if whole else wavelet_variance(part, rate_hz)
        robust = robust_wavelet_variance(part, rate_hz, levels=len(own))
        contamination = compare_with_robust(own, robust)
    allan = allan_variance(x, rate_hz, gaps=True)
    readings = read_curve(of_haar(robust) if from_robust and robust is not None else allan, unit)
    found = judge.stationarity(part, rate_hz, unit) + judge.resolution(x[np.isfinite(x)], unit)
    if contamination is not None and robust is not None and contamination.contaminated:
        worst = int(np.nanargmax(np.where(contamination.significant & robust.protected, contamination.ratio, np.nan)))
        open_scales = robust.tau_s[~robust.protected]
        limit = f"; from {open_scales[0]:.3g} s on also the robust curve is not protected" if open_scales.size else ""
        found.append(
            f"outliers: heavy tails raise the plain wavelet variance up to {contamination.ratio[worst]:.3g} times the robust one "
            f"(at {wavelet.tau_s[worst]:.3g} s){limit}"
        )
    found += judge.lines(part, rate_hz, unit)
    reported = wavelet if filter == "haar" else wavelet_variance(x, rate_hz, filter=filter, gaps=True)
    spectrum = average_frequencies(psd(part, rate_hz), 12) if part.size >= 64 else None
    trend_t, trend = _trend(x, rate_hz)
    return AxisReport(
        name,
        unit,
        rate_hz,
        x.size,
        reported,
        robust,
        allan,
        contamination,
        readings,
        found,
        spectrum,
        trend_t,
        trend,
        _correlation(part, rate_hz),
    )


def characterise_stream(
    chunks: Callable[[], Iterable[Array]], rate_hz: float, *, name: str = "signal", unit: str = "", keep: int = 1 << 22
) -> AxisReport:
    """Return curves and readings of a record too long for memory, in one pass; robust curve and findings are of its first ``keep`` samples.

    Parameters
    ----------
    chunks : callable
        Returns an iterator over the pieces of the signal.
    rate_hz, name, unit
        As in :func:`characterise`.
    keep : int
        Samples held in memory.
    """
    head: list[Array] = []
    held = 0

    def watch() -> Iterable[Array]:
        nonlocal held
        for piece in chunks():
            if held < keep:
                head.append(np.array(piece[: keep - held]))
                held += head[-1].size
            yield piece

    wavelet = stream_wavelet_variance(watch(), rate_hz)
    part = characterise(np.concatenate(head), rate_hz, name=name, unit=unit)
    allan = of_haar(wavelet)
    notes = [
        f"long record: findings and the spectrum are of the first {held} of {wavelet.n_samples} samples",
        *part.findings,
    ]
    return AxisReport(
        name,
        unit,
        rate_hz,
        wavelet.n_samples,
        wavelet,
        None,
        allan,
        None,
        read_curve(allan, unit),
        notes,
        part.spectrum,
        part.trend_t,
        part.trend,
        part.correlation,
    )


def _correlation(x: Array, rate_hz: float) -> dict[str, Array]:
    """Autocorrelation before and after de-noising, up to a tenth of the record and at most ten minutes."""
    reach = min(0.1 * x.size / rate_hz, 600.0)
    if x.size < 1024 or x.max() == x.min():
        return {}
    raw = autocorrelation(x, rate_hz, max_lag_s=reach)
    smooth = denoise(x, 6)
    if smooth.max() == smooth.min():
        return {}
    clean = autocorrelation(smooth, rate_hz, max_lag_s=reach)
    lags = np.unique(np.round(np.linspace(0, raw.lag_s.size - 1, 400)).astype(int))
    return {"lag_s": raw.lag_s[lags], "raw": raw.correlation[lags], "de-noised": clean.correlation[lags]}


def _trend(x: Array, rate_hz: float, blocks: int = 300) -> tuple[Array, Array]:
    width = max(1, x.size // blocks)
    count = x.size // width
    blocks_of = x[: count * width].reshape(count, width)
    there = np.isfinite(blocks_of)
    kept = there.any(axis=1)
    means = np.where(there, blocks_of, 0.0)[kept].sum(axis=1) / there[kept].sum(axis=1)
    t = np.asarray((np.flatnonzero(kept) + 0.5) * width / rate_hz, dtype=np.float64)
    return t, np.asarray(means, dtype=np.float64)
