"""Figures and page of ``insemu characterise``: variance panels with the slopes that were read, spectra, means over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as MplFigure
from numpy.typing import NDArray

from insemu.report.charts import Chart, Line, View
from insemu.report.page import Block, Card, Figure, Folded, Items, Section, Table, Text, render
from insemu.report.style import COLOURS, style
from insemu.units import conversion
from insemu.variance import FLICKER, duration, grouped_findings

if TYPE_CHECKING:
    from insemu.formats import NamedCurve
    from insemu.variance import AxisReport

Array = NDArray[np.float64]

_SHOWN = {"rad/s": "deg/h", "m/s^2": "mg"}
#: Readings that the answer tells: white noise, flat part, random walk.
MAIN = ("N", "B", "K")
_SLOPES = {"Q": -1.0, "N": -0.5, "B": 0.0, "K": 0.5, "R": 1.0}


def _factor(unit: str) -> tuple[float, str]:
    shown = _SHOWN.get(unit)
    return (conversion(unit, shown), shown) if shown else (1.0, unit or "unit of the file")


def _groups(axes: Sequence[AxisReport]) -> list[tuple[str, list[AxisReport]]]:
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


def _grid(axes: Sequence[AxisReport], height: float) -> tuple[MplFigure, list[tuple[Axes, AxisReport]]]:
    """One panel per column; a row never mixes sensors and panels of a sensor share their scales."""
    rows: list[list[AxisReport]] = []
    for _, members in _groups(axes):
        rows.extend(members[k : k + 3] for k in range(0, len(members), 3))
    width = max(len(r) for r in rows)
    figure, panels = plt.subplots(
        len(rows), width, figsize=(3.7 * width + 0.6, height * len(rows) + 0.3), squeeze=False
    )
    placed = []
    for i, row in enumerate(rows):
        for k in range(width):
            if k < len(row):
                placed.append((panels[i][k], row[k]))
            else:
                panels[i][k].set_visible(False)
    return figure, placed


def _share_limits(placed: Sequence[tuple[Axes, AxisReport]]) -> None:
    for unit in {a.unit for _, a in placed}:
        members = [p for p, a in placed if a.unit == unit]
        low = min(p.get_ylim()[0] for p in members)
        high = max(p.get_ylim()[1] for p in members)
        for panel in members:
            panel.set_ylim(low, high)


def allan_panels(axes: Sequence[AxisReport]) -> MplFigure:
    """Allan deviation of every column with its interval; the slopes that were read are drawn over the range they were read from."""
    with style():
        figure, placed = _grid(axes, 3.0)
        for panel, axis in placed:
            factor, unit = _factor(axis.unit)
            curve = axis.allan
            good = curve.value > 0
            deviation = factor * np.sqrt(curve.value)
            panel.loglog(
                curve.tau_s[good], deviation[good], "o-", ms=3, color=COLOURS[0], lw=1.1, label="Allan deviation"
            )
            low, high = factor * np.sqrt(np.maximum(curve.low, 0.0)), factor * np.sqrt(curve.high)
            # the last octaves may reach over decades: the band is cut where it says nothing
            usable = good & (curve.edof >= 1.5)
            panel.fill_between(
                curve.tau_s[usable], low[usable], high[usable], color=COLOURS[0], alpha=0.18, lw=0, label="95 %"
            )
            for k, (name, reading) in enumerate((n, r) for n, r in axis.readings.items() if n != "Tc"):
                tau = np.array([reading.tau_from_s, reading.tau_to_s])
                line = factor * _line(name, reading.si_value, tau)
                colour = COLOURS[1 + k % 4]
                panel.loglog(tau, line, color=colour, lw=2.4, alpha=0.9, solid_capstyle="butt")
                middle = float(np.exp(np.log(tau).mean()))
                panel.annotate(
                    f"{name} {reading.value:.3g} {_pretty(reading.unit)}",
                    (middle, float(factor * _line(name, reading.si_value, np.array([middle]))[0])),
                    xytext=(4, 7) if name != "B" else (0, -13),
                    textcoords="offset points",
                    fontsize=7.5,
                    color=colour,
                    ha="left" if name != "B" else "center",
                )
            panel.set(title=axis.name, xlabel="averaging time (s)", ylabel=f"deviation ({unit})")
        _share_limits(placed)
        placed[0][0].legend(loc="lower left")
    return figure


def _line(name: str, value: float, tau: Array) -> Array:
    factor = {"Q": np.sqrt(3.0), "N": 1.0, "B": FLICKER, "K": 1.0 / np.sqrt(3.0), "R": 1.0 / np.sqrt(2.0)}[name]
    return np.asarray(factor * value * tau ** _SLOPES[name])


def _pretty(unit: str) -> str:
    return (
        unit.replace("sqrt(h)", "√h")
        .replace("sqrt(Hz)", "√Hz")
        .replace("^2", "²")
        .replace("h^1.5", "h$^{1.5}$")
        .replace("*", "·")
    )


def wavelet_overlay(axes: Sequence[AxisReport], beside: Sequence[NamedCurve] = ()) -> MplFigure:
    """Wavelet variance of all columns of a sensor in one panel, plain and robust, curves of other sensors behind them."""
    groups = _groups(axes)
    with style():
        figure, panels = plt.subplots(1, len(groups), figsize=(5.4 * len(groups), 4.2), squeeze=False)
        for panel, (title, members) in zip(panels[0], groups, strict=True):
            # beside other sensors in the units that manufacturers' logs have
            shown = {"rad/s": "deg/s", "m/s^2": "g"}.get(members[0].unit, "") if beside else ""
            factor, unit = (conversion(members[0].unit, shown), shown) if shown else _factor(members[0].unit)
            gyro = {"rad/s": True, "m/s^2": False}.get(members[0].unit)
            others = [c for c in beside if gyro is None or c.is_gyro in (gyro, None)]
            for k, curve in enumerate(others):
                good = curve.value > 0
                panel.loglog(
                    curve.tau_s[good],
                    curve.value[good],
                    color="#9AA5B1",
                    lw=0.7,
                    label="other sensors, their own units" if k == 0 else None,
                )
            for k, axis in enumerate(members):
                w = axis.wavelet
                good, known = w.value > 0, (w.value > 0) & (w.edof >= 1.5)
                colour = COLOURS[k % len(COLOURS)]
                panel.loglog(w.tau_s[good], factor**2 * w.value[good], "o-", ms=3, color=colour, label=axis.name)
                panel.fill_between(
                    w.tau_s[known], factor**2 * w.low[known], factor**2 * w.high[known], color=colour, alpha=0.15, lw=0
                )
                if axis.robust is not None and axis.robust.contaminated:
                    r = axis.robust
                    use = (r.value > 0) & r.protected
                    panel.loglog(
                        r.tau_s[use],
                        factor**2 * r.value[use],
                        "--",
                        color=colour,
                        lw=1.1,
                        label=f"{axis.name}, robust (protected)",
                    )
            panel.set(title=title, xlabel="scale 2$^j$ / rate (s)", ylabel=f"wavelet variance ({_pretty(unit)})²")
            panel.legend(loc="best", fontsize=7.5)
    return figure


def spectra(axes: Sequence[AxisReport]) -> MplFigure:
    """One-sided root PSD of every column: averaged periodograms, and octave levels from the wavelet variance."""
    from insemu.variance import octave_psd

    with style():
        figure, placed = _grid(axes, 2.7)
        for panel, axis in placed:
            factor, unit = _factor(axis.unit)
            if axis.spectrum is not None:
                s = axis.spectrum
                panel.loglog(
                    s.f_hz,
                    factor * np.sqrt(s.psd_one_sided),
                    color=COLOURS[0],
                    lw=1.2,
                    label="Welch, averaged over frequency",
                )
            octave = octave_psd(axis.wavelet)
            good = (octave.psd > 0) & (octave.edof >= 1.5)
            panel.loglog(
                octave.f_hz[good],
                factor * np.sqrt(octave.psd_one_sided[good]),
                "s",
                ms=3.5,
                color=COLOURS[1],
                label="octaves of the wavelet variance",
            )
            panel.set(title=axis.name, xlabel="frequency (Hz)", ylabel=f"{_pretty(unit)}/√Hz, one-sided")
        _share_limits(placed)
        placed[0][0].legend(loc="best", fontsize=7.5)
    return figure


def trends(axes: Sequence[AxisReport]) -> MplFigure:
    """Block means over time about the median of the record's second half: warm-up and level shifts are seen here."""
    with style():
        figure, placed = _grid(axes, 2.2)
        for panel, axis in placed:
            factor, unit = _factor(axis.unit)
            t = axis.trend_t / 60.0
            level = float(np.median(axis.trend[axis.trend.size // 2 :])) if axis.trend.size else 0.0
            panel.plot(t, factor * (axis.trend - level), color=COLOURS[0], lw=0.9)
            panel.set(title=axis.name, xlabel="time (min)", ylabel=f"mean − later median ({unit})")
    return figure


def correlations(axes: Sequence[AxisReport]) -> MplFigure:
    """Autocorrelation of every column, before and after de-noising."""
    with style():
        figure, placed = _grid(axes, 2.2)
        for panel, axis in placed:
            if axis.correlation:
                lag = axis.correlation["lag_s"]
                panel.plot(lag, axis.correlation["raw"], color=COLOURS[0], lw=1.0, label="as it is")
                panel.plot(
                    lag, axis.correlation["de-noised"], color=COLOURS[1], lw=1.2, label="after wavelet de-noising"
                )
            panel.set(title=axis.name, xlabel="lag (s)", ylabel="autocorrelation", ylim=(-0.4, 1.05))
        if placed[0][0].lines:
            placed[0][0].legend(loc="best", fontsize=7.5)
    return figure


def covariance_check(tau: Array, theory: Array, drawn: Array, draws: int, title: str) -> MplFigure:
    """Asymptotic against drawn covariance of wavelet variances: standard deviations and correlations (Figs. 3 and 4 of Stebler et al. 2014).

    Parameters
    ----------
    tau : (J,) array
        Scales in samples.
    theory, drawn : (J, J) arrays
        Covariances.
    draws : int
        Number of draws behind ``drawn``.
    title : str
        Process and length.
    """
    with style():
        figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4.2))
        left.loglog(tau, np.sqrt(np.diag(theory)), "-", color=COLOURS[0], label="theory, exact finite-record sum")
        left.loglog(
            tau,
            np.sqrt(np.diag(drawn)),
            "o",
            color=COLOURS[1],
            ms=5,
            mfc="none",
            label=f"{draws:,} draws".replace(",", " "),
        )
        left.set(xlabel="scale (samples)", ylabel="standard deviation of the wavelet variance", title=title)
        left.legend()
        a = theory / np.sqrt(np.outer(np.diag(theory), np.diag(theory)))
        b = drawn / np.sqrt(np.outer(np.diag(drawn), np.diag(drawn)))
        for k in range(len(tau)):
            right.semilogx(tau, a[k], "-", color=COLOURS[k % len(COLOURS)], lw=1.2)
            right.semilogx(tau, b[k], "o", color=COLOURS[k % len(COLOURS)], ms=4, mfc="none")
        right.set(
            xlabel="scale (samples)",
            ylabel="correlation with each scale",
            title="Correlations: lines theory, rings draws",
        )
    return figure


def allan_chart(axes: Sequence[AxisReport]) -> Chart | None:
    """Allan deviations with their intervals, a view for each sensor; None where columns differ in rate or length."""
    tau = axes[0].allan.tau_s
    if any(not np.array_equal(a.allan.tau_s, tau) for a in axes):
        return None
    views = []
    for title, members in _groups(axes):
        lines: list[Line] = []
        for k, axis in enumerate(members):
            factor, unit = _factor(axis.unit)
            curve, colour = axis.allan, COLOURS[k % len(COLOURS)]
            known = (curve.value > 0) & (curve.edof >= 1.5)
            low, high = (
                factor * np.sqrt(np.where(known & (bound > 0), bound, np.nan)) for bound in (curve.low, curve.high)
            )
            at = len(lines)
            lines += [
                Line(axis.name, factor * np.sqrt(np.where(curve.value > 0, curve.value, np.nan)), colour),
                Line(f"{axis.name}: 95 %", low, colour, width=0.0, of=axis.name),
                Line(f"{axis.name}: 95 % high", high, colour, width=0.0, fill_to=at + 1, of=axis.name),
            ]
        views.append(View(title, f"Allan deviation ({unit})", lines, log_y=True))
    caption = "Allan deviation with 95 % intervals. Hover to read values; a click on a name in the legend switches it."
    return Chart("Allan deviation", caption, tau, "averaging time (s)", views, log_x=True, group="scale")


def _card(axis: AxisReport) -> Card:
    """What an axis is, in one card."""
    read = [
        f"{name} {r.value:.3g} {_plain(r.unit)} ({r.low:.3g} to {r.high:.3g})"
        for name, r in axis.readings.items()
        if name in MAIN
    ]
    value = read[0].partition(" (")[0] if read else "No straight part to read"
    absent = [name for name in axis.not_visible if name in MAIN]
    notes = [*read, *axis.findings[:1], f"Not visible in this record: {', '.join(absent)}" if absent else ""]
    return Card(
        axis.name, value, verdict_of(axis).capitalize(), "warn" if axis.findings else "good", [n for n in notes if n]
    )


def verdict_of(axis: AxisReport) -> str:
    """Whether something is wrong with an axis, in a few words."""
    count = len(axis.findings)
    return f"{count} finding{'s' if count > 1 else ''}" if count else "nothing wrong found"


def characterise_answer(axes: Sequence[AxisReport]) -> str:
    """The main readings of each kind of sensor, the range of its axes, and how much is wrong, in one sentence."""
    told = []
    for title, members in _groups(axes):
        parts = []
        for name in MAIN:
            known = [a.readings[name] for a in members if name in a.readings]
            if known:
                low, high = f"{min(r.value for r in known):.3g}", f"{max(r.value for r in known):.3g}"
                parts.append(f"{name} {low if low == high else f'{low} to {high}'} {_plain(known[0].unit)}")
        told.append(f"{title}: {', '.join(parts) or 'no straight part to read'}")
    found = len(grouped_findings(axes))
    wrong = f"{found} finding{'s' if found > 1 else ''} to look at" if found else "nothing wrong was found"
    return f"{'. '.join(told)}; {wrong}."


def characterise_rows(axes: Sequence[AxisReport]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the table for the terminal: an axis, its verdict, and what was read with intervals."""
    header = ["axis", "verdict", "reading", "value", "95 % interval", "unit", "read from (s)"]
    rows = []
    for axis in axes:
        first = [axis.name, verdict_of(axis)]
        if not axis.readings:
            rows.append([*first, "none", "", "", "", ""])
        for k, (name, r) in enumerate(axis.readings.items()):
            values = [
                f"{r.value:.4g}",
                f"{r.low:.4g} to {r.high:.4g}",
                r.unit,
                f"{r.tau_from_s:.3g} to {r.tau_to_s:.3g}",
            ]
            rows.append([*(first if k == 0 else ("", "")), name, *values])
    return header, rows


def _plain(unit: str) -> str:
    return unit.replace("sqrt(h)", "√h").replace("sqrt(Hz)", "√Hz").replace("^2", "²").replace("h^1.5", "h^(3/2)")


def _readings_table(axes: Sequence[AxisReport]) -> list[Block]:
    """What was read, and what was not."""
    rows = [
        [
            axis.name,
            name,
            f"{r.value:.4g}",
            f"{r.low:.4g} to {r.high:.4g}",
            r.unit,
            f"{r.tau_from_s:.3g} to {r.tau_to_s:.3g}",
            r.note,
        ]
        for axis in axes
        for name, r in axis.readings.items()
    ]
    table = Table(["axis", "reading", "value", "95 %", "unit", "read from (s)", "note"], rows, left=2)
    absent: dict[str, list[str]] = {}
    for axis in axes:
        if axis.not_visible:
            absent.setdefault(", ".join(axis.not_visible), []).append(axis.name)
    said = [f"Not visible in this record: {names} ({', '.join(of)})." for names, of in absent.items()]
    return [*([table] if rows else []), *([Items(said)] if said else [])]


def _comparison_table(axes: Sequence[AxisReport]) -> Table:
    rows = []
    for axis in axes:
        if axis.robust is None or axis.contamination is None or not axis.robust.contaminated:
            continue
        for k, tau in enumerate(axis.robust.tau_s):
            rows.append(
                [
                    axis.name,
                    f"{tau:.4g}",
                    f"{axis.contamination.ratio[k] * axis.robust.value[k]:.4g}",
                    f"{axis.robust.value[k]:.4g}",
                    f"{axis.contamination.ratio[k]:.3g}",
                    "yes" if axis.contamination.significant[k] else "",
                    "" if axis.robust.protected[k] else "not protected",
                ]
            )
    return Table(["axis", "scale (s)", "plain (SI²)", "robust (SI²)", "ratio", "significant", "robust curve"], rows)


def render_characterisation(
    axes: Sequence[AxisReport],
    folder: str | Path,
    *,
    source: str,
    beside: Sequence[NamedCurve] = (),
    overlay: bool = True,
) -> Path:
    """Write figures (PNG) and the page ``index.html`` into a folder; returns the page's path.

    Parameters
    ----------
    axes : sequence of AxisReport
        One per column, at least one.
    folder : path
        Made where it does not exist.
    source : str
        File that was characterised.
    beside : sequence of NamedCurve
        Wavelet variances of other sensors to be drawn beside.
    overlay : bool
        Whether the wavelet variances are drawn even without them.
    """
    folder = Path(folder)
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    varied = [
        axis for axis in axes if (axis.allan.value > 0).any()
    ]  # a constant column has nothing to draw on logarithmic axes
    drawings: list[tuple[str, MplFigure, str]] = []
    if varied:
        caption = "Allan deviation with 95 % intervals; straight parts and what was read from them."
        drawings.append(("allan", allan_panels(varied), caption))
    if varied and (overlay or beside):
        caption = "Haar wavelet variance by sensor (half the Allan variance at half the scale)."
        if beside:
            caption += " Grey: wavelet variances of other sensors from the file given, in that file's units."
        drawings.append(("wavelet", wavelet_overlay(varied, beside), caption))
    drawings.append(("trend", trends(axes), "Block means over time: warm-up and level shifts are seen here."))
    if varied:
        caption = "Root power spectral density, one-sided; squares are octave levels from the wavelet variance."
        drawings.append(("psd", spectra(varied), caption))
    if any(axis.correlation for axis in axes):
        caption = "Autocorrelation before and after wavelet de-noising (db4, six octaves, soft, SURE): what is left is the slow noise."
        drawings.append(("correlation", correlations(axes), caption))
    figures = {}
    for name, drawing, caption in drawings:
        figures[name] = Figure.of(drawing, caption)
        (folder / "figures" / f"{name}.png").write_bytes(figures[name].png)
    first = axes[0]
    length = duration(first.samples / first.rate_hz)
    lead = f"{source}: {len(axes)} column(s), {first.samples} samples at {first.rate_hz:g} Hz ({length})."
    findings = [f"{names}: {finding}" for names, finding in grouped_findings(axes)]
    chart = allan_chart(varied) if varied else None
    sections = [
        *(
            [Section("Allan deviation", [*([chart] if chart else []), _picture(figures["allan"], chart)])]
            if varied
            else []
        ),
        Section("Findings", [Items(findings) if findings else Text("Nothing wrong was found.")]),
        Section(
            "Readings",
            [
                Text(
                    "Units are those of datasheets. B is the flat part over 0.664; the flat part of a Gauss-Markov noise of standard "
                    "deviation s is at 0.617 s at most, so a model fitted with s = 0.664 B reads back as 0.617 B."
                ),
                *_readings_table(axes),
            ],
        ),
        *([Section("Wavelet variance", [figures["wavelet"]])] if "wavelet" in figures else []),
    ]
    comparison = _comparison_table(axes)
    if comparison.rows:
        text = "Columns with tails heavier than Gaussian. Where bad steps touch more than half of the coefficients, nothing protects the estimate."
        sections.append(Section("Plain against robust", [Text(text), comparison]))
    sections.append(Section("Over time", [figures["trend"]]))
    if varied:
        sections.append(Section("Spectrum", [figures["psd"]]))
    if "correlation" in figures:
        sections.append(Section("Correlation", [figures["correlation"]]))
    return render(
        f"Characterisation of {Path(source).name}",
        sections,
        folder / "index.html",
        kind="characterise",
        source=source,
        answer=characterise_answer(axes),
        lead=lead,
        cards=[_card(axis) for axis in axes],
    )


def _picture(figure: Figure, chart: Chart | None) -> Figure | Folded:
    """The static figure, folded where a chart shows the same."""
    return Folded("The lines that were read, axis by axis", [figure]) if chart else figure
