"""Figures and page of fitted noise models: the curve taken apart, what is left per scale, draws from the model, the spectrum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from insemu.fit import FitResult, process_label
from insemu.records import Series
from insemu.report import page
from insemu.report.style import COLOURS, style
from insemu.variance import average_frequencies, expected_variance, psd, wavelet_variance

if TYPE_CHECKING:
    from insemu.fit import Ranking

#: Draws under the decomposition.
DRAWS = 20


def decomposition(result: FitResult, rng: np.random.Generator, draws: int = DRAWS) -> Figure:
    """Wavelet deviation with its intervals, the model and each of its processes, draws from the model; below, what is left per scale.

    Parameters
    ----------
    result : FitResult
        With the curve that was fitted.
    rng : Generator
    draws : int
        Signals drawn from the model.
    """
    assert result.curve is not None
    curve = result.curve
    tau = curve.tau_s
    with style():
        figure, (top, bottom) = plt.subplots(2, 1, figsize=(8.6, 6.6), height_ratios=(3, 1), sharex=True)
        drawable = result.converged or np.isfinite(result.fitted).all()
        if drawable:
            for i, child in enumerate(rng.spawn(draws)):
                x = result.model.simulate(result.n_samples, result.dt, child)
                drawn = wavelet_variance(x, result.rate_hz, filter=curve.filter, intervals="eta3")
                top.plot(
                    drawn.tau_s,
                    np.sqrt(drawn.value),
                    color="#B9C1CA",
                    lw=0.6,
                    zorder=1,
                    label=f"{draws} draws from the model" if i == 0 else None,
                )
        low, high = np.sqrt(np.maximum(curve.low, 0.0)), np.sqrt(curve.high)
        value = np.sqrt(curve.value)
        top.errorbar(
            tau,
            value,
            yerr=np.abs(np.vstack([value - low, high - value])),
            fmt="o",
            ms=4,
            color="#1c2430",
            capsize=2,
            lw=1,
            label=f"signal, {curve.confidence:.0%} intervals",
            zorder=4,
        )
        if drawable:
            top.plot(tau, np.sqrt(result.fitted), color="#D00000", lw=2, label="model", zorder=3)
        dt = result.dt
        for i, (index, p) in enumerate(result.model.indexed()):
            if not drawable:
                break
            part = expected_variance(p, curve.filter, curve.scale_samples, dt)
            if (part > 0).any():
                name = process_label(p.symbol, index)
                top.plot(tau, np.sqrt(part), "--", color=COLOURS[i % len(COLOURS)], lw=1.3, label=name, zorder=2)
        bottom_of_plot = 0.3 * np.sqrt(np.min(curve.value))
        top.set(xscale="log", yscale="log", ylabel=f"wavelet deviation ({result.unit or 'unit'})")
        top.set_ylim(bottom_of_plot, 3.0 * float(np.max(value)))
        top.set_title(f"{result.name}: {result.structure} by {result.method}")
        top.legend(loc="best", ncols=2)
        if drawable:
            _residuals(bottom, result)
        bottom.set(xlabel="scale (s)", ylabel="signal / model − 1")
        return figure


def _residuals(axes: Axes, result: FitResult) -> None:
    assert result.curve is not None
    curve = result.curve
    spread = result.details.get("curve_covariance")
    scales = result.details.get("scales")
    if spread is not None and scales is not None:
        used = np.isin(curve.scale_samples, scales)
        band = 1.96 * np.sqrt(np.diag(spread)) / result.fitted[used]
        axes.fill_between(
            curve.tau_s[used], -band, band, color="#D00000", alpha=0.12, lw=0, label="95 % under the model"
        )
        axes.legend(loc="upper left")
    axes.axhline(0.0, color="#D00000", lw=1)
    axes.plot(curve.tau_s, result.scale_residuals(), "o-", color="#1c2430", ms=4, lw=1)
    inner = np.abs(result.scale_residuals()[: max(len(curve) - 2, 1)]).max()
    axes.set_ylim(-max(1.3 * inner, 0.15), max(1.3 * inner, 0.15))


def spectrum(result: FitResult, series: Series) -> Figure:
    """PSD of the signal in bands, with intervals, and the model's over it."""
    averaged = average_frequencies(psd(series.values, series.rate_hz))
    with style():
        figure, axes = plt.subplots(figsize=(8.6, 4.2))
        axes.fill_between(
            averaged.f_hz, np.sqrt(averaged.low), np.sqrt(averaged.high), color="#B9C1CA", alpha=0.6, lw=0
        )
        axes.plot(averaged.f_hz, np.sqrt(averaged.psd), color="#1c2430", lw=1, label="signal (Welch), 95 % interval")
        if np.isfinite(result.fitted).all():
            axes.plot(
                averaged.f_hz, np.sqrt(result.model.psd(averaged.f_hz, result.dt)), color="#D00000", lw=2, label="model"
            )
        unit = f"{result.unit or 'unit'}/sqrt(Hz)"
        axes.set(xscale="log", yscale="log", xlabel="frequency (Hz)", ylabel=f"root of the two-sided PSD ({unit})")
        axes.set_title(f"{result.name}: spectrum")
        axes.legend(loc="best")
        return figure


def likelihood_trace(result: FitResult) -> Figure:
    """Log-likelihood against iteration, as the distance from where the search ended."""
    trace = np.asarray(result.details["trace"])
    with style():
        figure, axes = plt.subplots(figsize=(8.6, 3.2))
        axes.plot(np.arange(1, trace.size), np.maximum(trace[-1] - trace[:-1], 1e-12), color=COLOURS[0])
        axes.set(yscale="log", xlabel="iteration", ylabel="log-likelihood below the last")
        axes.set_title(f"{result.name}: trace of the likelihood")
        return figure


def render_fits(
    results: Mapping[str, FitResult],
    path: str | Path,
    *,
    series: Sequence[Series] = (),
    rankings: Mapping[str, Ranking] | None = None,
    rng: np.random.Generator,
) -> Path:
    """Write one self-contained page with a section per axis.

    Parameters
    ----------
    results : mapping
        Axis to fit.
    path : path
        HTML file.
    series : sequence of Series, optional
        The signals, for their spectra.
    rankings : mapping, optional
        What was chosen from.
    rng : Generator
        For the draws.

    Returns
    -------
    Path
    """
    by_name = {s.name: s for s in series}
    sections = []
    for axis, result in results.items():
        blocks: list[page.Block] = []
        if rankings is not None and axis in rankings:
            blocks.append(page.Text(rankings[axis].verdict))
            blocks.append(ranking_table(rankings[axis]))
        blocks.append(
            page.Table(
                ("parameter", "estimate ± standard error", "95 % interval", "datasheet and discrete"),
                result.rows(),
                left=4,
                caption=f"{result.n_samples} samples at {result.rate_hz:g} Hz",
            )
        )
        if result.test is not None:
            fits = (
                "the model is compatible with the data"
                if result.test.p_value >= 0.05
                else "the data contradict the model"
            )
            blocks.append(
                page.Text(
                    f"Test of fit: chi-square {result.test.statistic:.2f} on {result.test.dof} degrees of freedom, "
                    f"p = {result.test.p_value:.3g}: {fits}."
                )
            )
        if result.warnings:
            blocks.append(page.Items([f"Beware: {w}." for w in result.warnings]))
        if result.curve is not None:
            blocks.append(
                page.Figure.of(
                    decomposition(result, rng),
                    f"{axis}: wavelet deviation of the signal, the model, its processes, and {DRAWS} signals drawn from the model; "
                    "below, what is left per scale.",
                )
            )
        if axis in by_name:
            blocks.append(
                page.Figure.of(spectrum(result, by_name[axis]), f"{axis}: power spectral density of signal and model.")
            )
        if "trace" in result.details and np.size(result.details["trace"]) > 1:
            blocks.append(
                page.Figure.of(
                    likelihood_trace(result), f"{axis}: the likelihood climbs until the stopping rule is met."
                )
            )
        sections.append(page.Section(axis, blocks))
    return page.render("Fitted noise models", sections, path)


def ranking_table(ranking: Ranking, most: int = 12) -> page.Table:
    """The best candidates by criterion, and the chosen one."""
    listed = [c for c in ranking.candidates if not c.vanished][:most]
    if ranking.chosen not in listed:
        listed.append(ranking.chosen)
    strong = frozenset(i for i, c in enumerate(listed) if c is ranking.chosen)
    rows = [
        (
            str(c.structure),
            str(c.parameters),
            f"{c.criterion.value:.1f} ± {c.criterion.standard_error:.1f}",
            f"{c.objective:.1f}",
            f"{c.p_value:.2g}" if np.isfinite(c.p_value) else "–",
        )
        for c in listed
    ]
    return page.Table(
        ("model", "parameters", "criterion ± standard error", "distance", "p of the test of fit"),
        rows,
        strong=strong,
        caption=f"{len(ranking.candidates)} candidates by the wavelet information criterion; the chosen one is set in bold",
    )
