"""Charts of ``insemu characterise``: variances with the slopes that were read, spectra, means over time, correlations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from insemu.report.charts import GREY, INK, RED, Chart, Line, View, band, positive
from insemu.report.style import COLOURS
from insemu.units import conversion
from insemu.variance import FLICKER, octave_psd

if TYPE_CHECKING:
    from insemu.formats import NamedCurve
    from insemu.variance import AllanVariance, AxisReport, Reading, WaveletVariance

Array = NDArray[np.float64]
#: Abscissae and values of a line.
Curve = tuple[Array, Array]

_SHOWN = {"rad/s": "deg/h", "m/s^2": "mg"}
#: Units that manufacturers' logs have, those of other sensors too.
_MAKERS = {"rad/s": "deg/s", "m/s^2": "g"}
_SLOPES = {"Q": -1.0, "N": -0.5, "B": 0.0, "K": 0.5, "R": 1.0}
#: Intervals of fewer equivalent degrees of freedom reach over decades and say nothing.
LEAST_EDOF = 1.5


def plain(unit: str) -> str:
    """A unit as a reader writes it."""
    return unit.replace("sqrt(h)", "√h").replace("sqrt(Hz)", "√Hz").replace("^2", "²").replace("h^1.5", "h^(3/2)")


def _factor(unit: str, shown_by_unit: dict[str, str] = _SHOWN) -> tuple[float, str]:
    shown = shown_by_unit.get(unit)
    return (conversion(unit, shown), shown) if shown else (1.0, unit or "unit of the file")


def groups(axes: Sequence[AxisReport]) -> list[tuple[str, list[AxisReport]]]:
    """Columns by sensor: gyroscopes, accelerometers, the rest by unit."""
    names = {"rad/s": "Gyroscopes", "m/s^2": "Accelerometers"}
    units = sorted({a.unit for a in axes}, key=lambda u: (["rad/s", "m/s^2"].index(u) if u in names else 2, u))
    return [
        (
            names.get(u, "Signal" if len(units) == 1 else f"Columns in {u or 'unknown unit'}"),
            [a for a in axes if a.unit == u],
        )
        for u in units
    ]


def _line(name: str, value: float, tau: Array) -> Array:
    factor = {"Q": np.sqrt(3.0), "N": 1.0, "B": FLICKER, "K": 1.0 / np.sqrt(3.0), "R": 1.0 / np.sqrt(2.0)}[name]
    return np.asarray(factor * value * tau ** _SLOPES[name])


def _placed(curves: Sequence[Curve], *, log: bool) -> tuple[Array, list[Array]]:
    """Curves over all their abscissae together; between its own points a curve is interpolated, outside it is not known."""
    whole = np.unique(np.concatenate([x for x, _ in curves])) if curves else np.zeros(0)
    out = []
    for x, y in curves:
        if np.array_equal(x, whole):
            out.append(y)
            continue
        known = np.isfinite(y)
        if not known.any():
            out.append(np.full(whole.size, np.nan))
            continue
        scale, back = (np.log, np.exp) if log else (np.asarray, np.asarray)
        out.append(back(np.interp(scale(whole), scale(x[known]), scale(y[known]), left=np.nan, right=np.nan)))
    return whole, out


def _with_interval(
    axis: AxisReport, curve: AllanVariance | WaveletVariance, shown: Callable[[Array], Array], colour: str, at: int
) -> tuple[list[Line], list[Curve]]:
    """The lines of a variance with its interval, of which ``at`` stand in front, and where they are."""
    known = curve.edof >= LEAST_EDOF
    low, high = (np.where(known, shown(positive(bound)), np.nan) for bound in (curve.low, curve.high))
    value = shown(positive(curve.value))
    name = f"{axis.name}: 95 %"
    lines = [Line(axis.name, value, colour), *band(name, (low, high), colour, at + 1, axis.name)]
    return lines, [(curve.tau_s, y) for y in (value, low, high)]


def _view(name: str, y_label: str, lines: Sequence[Line], curves: Sequence[Curve], *, printed: bool = True) -> View:
    """A logarithmic view of lines that have abscissae of their own."""
    x, values = _placed(curves, log=True)
    return View(
        name,
        y_label,
        [replace(line, y=y) for line, y in zip(lines, values, strict=True)],
        log_y=True,
        printed=printed,
        x=x,
    )


def allan_chart(axes: Sequence[AxisReport], of: str = "") -> Chart:
    """Allan deviations with their intervals: the axes of each sensor side by side, and each axis with the slopes that were read from it.

    Parameters
    ----------
    axes : sequence of AxisReport
        With a value above zero each.
    of : str
        Sensor, for the chart's name.
    """
    views = []
    for title, members in groups(axes):
        if len(members) > 1:
            views.append(_overview(title, members))
    views += [_slopes(axis) for axis in axes]
    caption = "Allan deviation with 95 % intervals; of an axis also the straight parts and what was read from them."
    return Chart(
        _name_of_pair("Allan deviation", of), caption, None, "averaging time (s)", views, log_x=True, group="scale"
    )


def _overview(title: str, members: Sequence[AxisReport]) -> View:
    factor, unit = _factor(members[0].unit)
    lines: list[Line] = []
    curves: list[Curve] = []
    for k, axis in enumerate(members):
        more, where = _with_interval(
            axis, axis.allan, lambda v: factor * np.sqrt(v), COLOURS[k % len(COLOURS)], len(lines)
        )
        lines, curves = lines + more, curves + where
    return _view(title, f"Allan deviation ({unit})", lines, curves, printed=False)


def _slopes(axis: AxisReport) -> View:
    """One axis, with the straight lines that were read over the range they were read from."""
    factor, unit = _factor(axis.unit)
    lines, curves = _with_interval(axis, axis.allan, lambda v: factor * np.sqrt(v), INK, 0)
    labels = []
    read: list[tuple[str, Reading]] = [(n, r) for n, r in axis.readings.items() if n in _SLOPES]
    for k, (name, r) in enumerate(read):
        ends = np.array([r.tau_from_s, np.sqrt(r.tau_from_s * r.tau_to_s), r.tau_to_s])
        level = factor * _line(name, r.si_value, ends)
        said = f"{name} {r.value:.3g} {plain(r.unit)}"
        lines.append(Line(said, level, COLOURS[k % len(COLOURS)], width=3.0))
        curves.append((ends, level))
        labels.append((float(ends[1]), float(level[1]), said))
    return replace(_view(axis.name, f"Allan deviation ({unit})", lines, curves), labels=labels)


def wavelet_chart(members: Sequence[AxisReport], of: str, beside: Sequence[NamedCurve] = ()) -> Chart:
    """Wavelet variance of all columns of a sensor, plain and robust, with curves of other sensors behind them.

    Parameters
    ----------
    members : sequence of AxisReport
        Columns of one unit, with a value above zero each.
    of : str
        Sensor.
    beside : sequence of NamedCurve
        Of other sensors.
    """
    factor, unit = _factor(members[0].unit, _MAKERS if beside else _SHOWN)
    gyro = {"rad/s": True, "m/s^2": False}.get(members[0].unit)
    lines: list[Line] = []
    curves: list[Curve] = []
    for other in (c for c in beside if gyro is None or c.is_gyro in (gyro, None)):
        first = "other sensors"
        lines.append(Line(other.label if lines else first, other.value, GREY, width=0.8, of=first if lines else ""))
        curves.append((other.tau_s, positive(other.value)))
    for k, axis in enumerate(members):
        colour = COLOURS[k % len(COLOURS)]
        more, where = _with_interval(axis, axis.wavelet, lambda v: factor**2 * v, colour, len(lines))
        lines, curves = lines + more, curves + where
        if axis.robust is not None and axis.robust.contaminated:
            robust = factor**2 * positive(np.where(axis.robust.protected, axis.robust.value, np.nan))
            lines.append(Line(f"{axis.name}, robust (protected)", robust, colour, dashed=True))
            curves.append((axis.robust.tau_s, robust))
    caption = "Haar wavelet variance (half the Allan variance at half the scale)."
    if beside:
        caption += " Grey: wavelet variances of other sensors from the file given, in that file's units."
    view = _view(of, f"wavelet variance (({plain(unit)})²)", lines, curves)
    return Chart(_name_of_pair("Wavelet variance", of), caption, None, "scale (s)", [view], log_x=True, group="scale")


def spectrum_chart(members: Sequence[AxisReport], of: str) -> Chart:
    """One-sided root PSD of the columns of a sensor: averaged periodograms side by side, and each with octave levels from the wavelet variance.

    Parameters
    ----------
    members : sequence of AxisReport
        Columns of one unit.
    of : str
        Sensor.
    """
    factor, unit = _factor(members[0].unit)
    label = f"root of the PSD ({plain(unit)}/√Hz)"
    lines: list[Line] = []
    curves: list[Curve] = []
    views = []
    for k, axis in enumerate(members):
        octave = octave_psd(axis.wavelet)
        level = np.where(octave.edof >= LEAST_EDOF, factor * np.sqrt(positive(octave.psd_one_sided)), np.nan)
        own, where = [Line("octaves of the wavelet variance", level, RED, dashed=True)], [(octave.f_hz, level)]
        if axis.spectrum is not None:
            level = factor * np.sqrt(positive(axis.spectrum.psd_one_sided))
            lines.append(Line(axis.name, level, COLOURS[k % len(COLOURS)]))
            curves.append((axis.spectrum.f_hz, level))
            own, where = [Line("Welch, averaged over frequency", level, INK), *own], [curves[-1], *where]
        views.append(_view(axis.name, label, own, where))
    if len(lines) > 1:
        views.insert(0, _view(of, label, lines, curves, printed=False))
    caption = (
        "Root of the one-sided power spectral density; of an axis also the octave levels from the wavelet variance."
    )
    return Chart(_name_of_pair("Spectrum", of), caption, None, "frequency (Hz)", views, log_x=True, group="frequency")


def trend_chart(members: Sequence[AxisReport], of: str) -> Chart:
    """Block means over time about the median of the record's second half: warm-up and level shifts are seen here.

    Parameters
    ----------
    members : sequence of AxisReport
        Columns of one unit.
    of : str
        Sensor.
    """
    factor, unit = _factor(members[0].unit)
    label = f"block mean ({unit})"
    curves = []
    for axis in members:
        level = float(np.median(axis.trend[axis.trend.size // 2 :])) if axis.trend.size else 0.0
        curves.append((axis.trend_t / 60.0, factor * (axis.trend - level)))
    views = _beside_and_alone(members, of, label, curves)
    return Chart(
        _name_of_pair("Over time", of),
        "Block means over time, less the median of the second half: warm-up and level shifts are seen here.",
        None,
        "time (min)",
        views,
    )


def correlation_chart(members: Sequence[AxisReport], of: str) -> Chart:
    """Autocorrelation of the columns of a sensor: de-noised side by side, and each before and after de-noising.

    Parameters
    ----------
    members : sequence of AxisReport
        Columns of one unit, each with its correlation.
    of : str
        Sensor.
    """
    views = []
    for axis in members:
        c = axis.correlation
        lines = [Line("as it is", c["raw"], COLOURS[0]), Line("after wavelet de-noising", c["de-noised"], COLOURS[1])]
        views.append(View(axis.name, "autocorrelation", lines, x=c["lag_s"]))
    caption = "Autocorrelation before and after wavelet de-noising (db4, six octaves, soft, SURE): the rest is the slow noise."
    return Chart(_name_of_pair("Correlation", of), caption, None, "lag (s)", views, group="lag")


def _beside_and_alone(members: Sequence[AxisReport], of: str, label: str, curves: Sequence[Curve]) -> list[View]:
    """A view of all columns, and one of each for paper."""
    alone = [View(a.name, label, [Line(a.name, y, COLOURS[0])], x=x) for a, (x, y) in zip(members, curves, strict=True)]
    if len(members) == 1:
        return alone
    x, values = _placed(curves, log=False)
    lines = [Line(a.name, y, COLOURS[k % len(COLOURS)]) for k, (a, y) in enumerate(zip(members, values, strict=True))]
    return [View(of, label, lines, x=x, printed=False), *alone]


def _name_of_pair(name: str, of: str) -> str:
    return f"{name}, {of[:1].lower()}{of[1:]}" if of else name
