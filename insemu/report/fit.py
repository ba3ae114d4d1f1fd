"""The page of fitted noise models: a verdict per axis, the curve taken apart, what is left per scale, the spectrum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from insemu.fit import FitResult
from insemu.noise import process_label
from insemu.records import Series
from insemu.report import page
from insemu.report.charts import GREY, INK, RED, Chart, Line, View, band, familiar, positive
from insemu.report.style import COLOURS
from insemu.variance import average_frequencies, expected_variance, longest_good_part, psd, wavelet_variance

if TYPE_CHECKING:
    from insemu.fit import Ranking

#: Samples that a spectrum needs.
LEAST_OF_SPECTRUM = 64
#: Draws under the decomposition.
DRAWS = 20
#: Different models that the answer names.
MOST_TOLD = 3


def drawable(result: FitResult) -> bool:
    """Whether there is a model to draw."""
    return result.converged or bool(np.isfinite(result.fitted).all())


def decomposition(results: Mapping[str, FitResult], rng: np.random.Generator) -> Chart:
    """Wavelet deviation with its intervals, the model and each of its processes, and the range of draws from the model, axis by axis.

    Parameters
    ----------
    results : mapping of axis to FitResult
        With the curves that were fitted.
    rng : Generator
    """
    views = []
    for (axis, result), child in zip(results.items(), rng.spawn(len(results)), strict=True):
        curve = result.curve
        assert curve is not None
        lines = [Line("signal", np.sqrt(positive(curve.value)), INK, points=True, width=4.0)]
        interval = (np.sqrt(positive(edge)) for edge in (curve.low, curve.high))
        lines += band(f"{curve.confidence:.0%} interval", interval, INK, 1, of="signal")
        if drawable(result):
            lines.append(Line("model", np.sqrt(positive(result.fitted)), RED, width=2.2))
            for i, (index, p) in enumerate(result.model.indexed()):
                part = expected_variance(p, curve.filter, curve.scale_samples, result.dt)
                if (part > 0).any():
                    name = process_label(p.symbol, index)
                    lines.append(Line(name, np.sqrt(positive(part)), COLOURS[i % len(COLOURS)], dashed=True))
            drawn = [
                np.sqrt(wavelet_variance(x, result.rate_hz, filter=curve.filter, intervals="eta3").value)
                for x in (result.model.simulate(result.n_samples, result.dt, one) for one in child.spawn(DRAWS))
            ]
            edges = (positive(edge(drawn, axis=0)) for edge in (np.min, np.max))
            lines += band(f"range of {DRAWS} draws from the model", edges, GREY, len(lines))
        title = f"{axis}: {result.structure} by {result.method}"
        lines, unit = familiar(lines, result.unit)
        views.append(View(title, f"wavelet deviation ({unit})", lines, log_y=True, x=curve.tau_s))
    caption = "Wavelet deviation of the signal with its interval, the model, each of its processes, and what draws from the model look like."
    return Chart("Wavelet deviation", caption, None, "scale (s)", views, log_x=True, group="scale")


def residuals(results: Mapping[str, FitResult]) -> Chart:
    """What is left per scale, axis by axis."""
    views = []
    for axis, result in results.items():
        curve = result.curve
        assert curve is not None
        lines = [Line("signal / model - 1", result.scale_residuals(), INK)]
        spread, scales = result.details.get("curve_covariance"), result.details.get("scales")
        if spread is not None and scales is not None:
            used = np.isin(curve.scale_samples, scales)
            band = np.full(len(curve), np.nan)
            band[used] = 1.96 * np.sqrt(np.diag(spread)) / result.fitted[used]
            lines += [Line("95 % under the model", -band, RED, width=0.0)]
            lines += [Line("95 %, high", band, RED, width=0.0, fill_to=1, of=lines[1].label)]
        views.append(View(axis, "signal / model - 1", lines, x=curve.tau_s))
    caption = "What the model leaves at each scale, and where 95 % of what chance leaves would lie."
    return Chart("Residuals", caption, None, "scale (s)", views, log_x=True, group="scale")


def spectrum(results: Mapping[str, FitResult], series: Mapping[str, Series]) -> Chart:
    """PSD of the signal in bands with intervals, and the model's over it, axis by axis."""
    views = []
    for axis, s in series.items():
        result = results[axis]
        start, stop = longest_good_part([s.values], []) if s.missing else (0, len(s))
        if stop - start < LEAST_OF_SPECTRUM:
            continue
        averaged = average_frequencies(psd(s.values[start:stop], s.rate_hz))
        lines = [Line("signal (Welch)", np.sqrt(averaged.psd), INK)]
        interval = (positive(np.sqrt(edge)) for edge in (averaged.low, averaged.high))
        lines += band("95 % interval", interval, INK, 1, of="signal (Welch)")
        if drawable(result):
            lines.append(Line("model", np.sqrt(positive(result.model.psd(averaged.f_hz, result.dt))), RED, width=2.2))
        lines, unit = familiar(lines, f"{result.unit or 'unit'}/sqrt(Hz)")
        views.append(View(axis, f"root of the two-sided PSD ({unit})", lines, log_y=True, x=averaged.f_hz))
    caption = "Power spectral density of the signal with its interval, and of the model."
    if any(s.missing for s in series.values()):
        caption += " Of a signal with missing samples: of its longest part without."
    return Chart("Spectrum", caption, None, "frequency (Hz)", views, log_x=True, group="frequency")


def likelihood_trace(results: Mapping[str, FitResult]) -> Chart:
    """Log-likelihood against iteration, as the distance from where the search ended."""
    views = []
    for axis, result in results.items():
        trace = np.asarray(result.details["trace"])
        lines = [Line("log-likelihood below the last", np.maximum(trace[-1] - trace[:-1], 1e-12), COLOURS[0])]
        views.append(View(axis, "log-likelihood below the last", lines, log_y=True, x=np.arange(1, trace.size)))
    return Chart(
        "Likelihood",
        "The likelihood climbs until the stopping rule is met.",
        None,
        "iteration",
        views,
        group="iteration",
    )


def _charts(results: Mapping[str, FitResult], series: Sequence[Series], rng: np.random.Generator) -> list[page.Block]:
    curved = {axis: r for axis, r in results.items() if r.curve is not None}
    traced = {axis: r for axis, r in results.items() if np.size(r.details.get("trace", ())) > 1}
    heard = {s.name: s for s in series if s.name in results}
    out: list[page.Block] = [decomposition(curved, rng)] if curved else []
    fitted = {axis: r for axis, r in curved.items() if drawable(r)}
    out += [residuals(fitted)] if fitted else []
    drawn = spectrum(results, heard)
    out += [drawn] if drawn.views else []
    return out + ([likelihood_trace(traced)] if traced else [])


def parameters_table(result: FitResult, caption: str = "") -> page.Table:
    """Every parameter with its error and interval."""
    header = ("parameter", "estimate ± standard error", "95 % interval", "SI and discrete")
    return page.Table(header, result.rows(), left=4, caption=caption)


def verdict_cards(results: Mapping[str, FitResult], values: Mapping[str, str] | None = None) -> list[page.Card]:
    """One card an axis: the model (or what ``values`` says of the axis), whether the data bear it, its parameters."""
    return [
        page.Card(
            axis,
            values[axis] if values else str(r.structure),
            r.verdict[:1].upper() + r.verdict[1:],
            "good" if r.bears else "bad",
            [r.words],
        )
        for axis, r in results.items()
    ]


def _detail(axis: str, result: FitResult, ranking: Ranking | None) -> page.Folded:
    """Everything about one axis."""
    blocks: list[page.Block] = [parameters_table(result, f"{result.n_samples} samples at {result.rate_hz:g} Hz")]
    if result.test is not None:
        blocks.append(
            page.Text(
                f"Test of fit: chi-square {result.test.statistic:.2f} on {result.test.dof} degrees of freedom: {result.verdict}."
            )
        )
    if ranking is not None:
        blocks += [page.Text(ranking.verdict), ranking_table(ranking)]
    if result.warnings:
        blocks.append(page.Items([f"Beware: {w}." for w in result.warnings]))
    return page.Folded(f"{axis}: {result.structure}, every parameter" + (" and candidate" if ranking else ""), blocks)


def fits_answer(results: Mapping[str, FitResult]) -> str:
    """What the fits say together, in one sentence."""
    bad = [axis for axis, r in results.items() if not r.bears]
    named = _models(results)
    tested = [axis for axis, r in results.items() if r.test is not None or not r.converged]
    if not tested:
        return f"{named}; this method does not test whether the data bear {'them' if len(results) > 1 else 'it'}."
    if not bad:
        return f"{named}: the data bear {'it' if len(tested) == 1 else 'the model on every axis'}."
    rest = f" and bear it on the other {len(tested) - len(bad)}" if len(bad) < len(tested) else ""
    return f"{named}: the data contradict the model on {', '.join(bad)}{rest}."


def _models(results: Mapping[str, FitResult]) -> str:
    """Which model on which axes; their number where the sentence would be long."""
    axes: dict[str, list[str]] = {}
    for axis, r in results.items():
        axes.setdefault(str(r.structure), []).append(axis)
    if len(axes) == 1:
        model, on = next(iter(axes.items()))
        return f"{model} on {on[0] if len(on) == 1 else 'both axes' if len(on) == 2 else f'all {len(on)} axes'}"
    if len(axes) > MOST_TOLD:
        return f"{len(axes)} models on {len(results)} axes"
    return ", ".join(f"{model} on {', '.join(on)}" for model, on in axes.items())


def render_fits(
    results: Mapping[str, FitResult],
    path: str | Path,
    *,
    series: Sequence[Series] = (),
    rankings: Mapping[str, Ranking] | None = None,
    rng: np.random.Generator,
    source: str = "",
) -> Path:
    """Write one self-contained page: a card and a row per axis, charts with a switch for the axis, detail folded.

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
    source : str
        The log that was fitted.

    Returns
    -------
    Path
    """
    ranked = rankings or {}
    rows = [(axis, str(r.structure), r.words, r.verdict) for axis, r in results.items()]
    sections = [
        page.Section("Every axis", [page.Table(("axis", "model", "values", "verdict"), rows, left=4)]),
        page.Section("Signal and model", _charts(results, series, rng)),
        page.Section("Detail", [_detail(axis, r, ranked.get(axis)) for axis, r in results.items()]),
    ]
    word = "Chosen" if ranked else "Fitted"
    return page.Page(
        f"{word} noise models" + (f" of {Path(source).name}" if source else ""),
        sections,
        kind="select" if ranked else "fit",
        source=source,
        answer=fits_answer(results),
        cards=verdict_cards(results),
    ).write(path)


def ranking_rows(
    ranking: Ranking, most: int = 12, *, unknown: str = "-"
) -> tuple[Sequence[str], Sequence[Sequence[str]], int]:
    """Header and rows of the best candidates, and the row of the chosen one, which is always among them.

    Parameters
    ----------
    ranking : Ranking
    most : int
        Rows, unless the chosen one comes after them.
    unknown : str
        What stands for a p-value that there is not.
    """
    listed = [c for c in ranking.candidates if not c.vanished][:most]
    if ranking.chosen not in listed:
        listed.append(ranking.chosen)
    rows = [
        (
            str(c.structure),
            str(c.parameters),
            f"{c.criterion.value:.1f} ± {c.criterion.standard_error:.1f}",
            f"{c.objective:.1f}",
            f"{c.p_value:.2g}" if np.isfinite(c.p_value) else unknown,
        )
        for c in listed
    ]
    header = ("model", "parameters", "criterion ± standard error", "distance", "p of the test of fit")
    return header, rows, next(k for k, c in enumerate(listed) if c is ranking.chosen)


def ranking_table(ranking: Ranking) -> page.Table:
    """The best candidates; the chosen one is set in bold."""
    header, rows, chosen = ranking_rows(ranking)
    said = f"{len(ranking.candidates)} candidates by the wavelet information criterion; the chosen one is set in bold"
    return page.Table(header, rows, said, strong=frozenset({chosen}))
