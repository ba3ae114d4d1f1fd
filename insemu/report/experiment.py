"""The page of an experiment: question, table, verdict, figures, beliefs, variants, and how it was made."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml

from insemu.evaluate import Results, Standing, answer, put, verdicts
from insemu.noise import NoiseModel, axis_unit
from insemu.report import budget, figures
from insemu.report.experiment_charts import error_chart, nees_chart
from insemu.report.page import Block, Card, Code, Figure, Folded, Items, Section, Table, Text, render
from insemu.report.tables import (
    FIGURES,
    SMOOTHED,
    beside,
    consistency_lines,
    full_headline,
    log_distance,
    pooled_rank_line,
    rank_lines,
    shown_beside,
    smoother_rows,
    variant_caption,
    variant_rows,
)
from insemu.units import datasheet


def _table(results: Results) -> Table:
    caption = (
        f"Planimetric errors, means over {results.realizations} realizations; intervals by bootstrap over realizations. Altitude, velocity, "
        "attitude and stated sigma at the end of the outage; cover is the share of errors inside 3 sigma during it. Verdict: on the NEES at "
        "the end of the outage."
    )
    return Table(*full_headline(results), caption, left=1)


def _model_rows(axis: str, model: NoiseModel) -> list[list[str]]:
    unit = axis_unit(axis)
    rows = []
    for index, process in model.indexed():
        for meta in process.parameters_meta():
            value, shown = datasheet(process.parameters[meta.name], meta.unit_for(unit))
            rows.append([axis, f"{process.symbol}{index}", meta.name, f"{value:.4g}", shown])
    return rows


def _beliefs(results: Results) -> list[Block]:
    blocks: list[Block] = []
    for name, info in results.designs.items():
        rows: list[list[str]] = []
        shown: dict[NoiseModel, str] = {}
        for axis, model in info.belief.items():
            if model in shown:
                continue
            same = [a for a, m in info.belief.items() if m == model]
            shown[model] = axis
            label = axis if len(same) == 1 else ", ".join(same)
            rows += [[label if i == 0 else "", *row[1:]] for i, row in enumerate(_model_rows(axis, model))]
        blocks.append(
            Table(["axes", "process", "parameter", "value", "unit"], rows, f"{name} ({info.states} states)", left=3)
        )
    return blocks


def render_experiment(
    main: Results, variants: Mapping[str, Results], folder: Path, *, text: Mapping[str, str] | None = None
) -> Path:
    """Write ``index.html`` and the figures as PNG files.

    Parameters
    ----------
    main : Results
        The scenario as it stands.
    variants : mapping
        Name to the results of the scenario's variants.
    folder : path
        Where to write.
    text : mapping, optional
        ``question``, ``notes`` and ``source`` of the scenario.

    Returns
    -------
    Path
        The page.
    """
    text = text or {}
    drawn = _drawn(main)
    folder.mkdir(parents=True, exist_ok=True)
    for name, picture in drawn.items():
        put(folder / f"{name}.png", picture.png)
    said = answer(main)
    differences = Folded("Differences between the designs", [Items(verdicts(main))])
    sections = [Section("Every outage", [_table(main), differences]), Section("Flight", [drawn["flight"]])]
    if main.outages:
        sections += _accuracy(main, drawn)
    if variants:
        sections.append(_variants(main, variants))
    if main.published:
        sections.append(_published(main, variants, text.get("source", "")))
    sections.append(Section("What each design believes", _beliefs(main)))
    sections.append(Section("How it was made", _made(main, text.get("notes", ""))))
    return render(
        main.title,
        sections,
        folder / "index.html",
        answer=said.sentence if said else "",
        lead=" ".join(part for part in (text.get("question", ""), f"{main.realizations} realizations.") if part),
        cards=[_card(s, main) for s in said.standings] if said else (),
        footer=f"Made by insemu {main.manifest.get('insemu')}.",
    )


def _drawn(main: Results) -> dict[str, Figure]:
    """The figures by name."""
    last = len(main.outages)
    pictures = {
        "flight": (
            figures.flight(main),
            "Reference flight with its outages; close view of the last outage with every design's track.",
        )
    }
    if main.outages:
        pictures["error_growth"] = (
            figures.error_growth(main),
            "Root-mean-square error over all realizations, per design.",
        )
        pictures["against_bounds"] = (
            figures.against_bounds(main),
            f"Outage {last}, one column per design: errors of one realization and the 3-sigma bound that its filter states; thin grey lines are "
            "all realizations. The planimetric error is a length, its bound 3 times the root of the stated horizontal variance.",
        )
        pictures["end_errors"] = (
            figures.end_errors(main),
            "Planimetric error at outage end: dots are realizations, circles their mean with its 95 % interval, bars the sigma that the "
            "filter states, crosses what was published.",
        )
    pictures["consistency"] = (
        figures.consistency(main),
        "Normalised squared error of the nine navigation states; 1 is a filter that knows its error.",
    )
    if main.outages and main.smoothed:
        pictures["smoothing"] = (
            figures.smoothing(main),
            "Errors north in the longest outage, filtered (left) and smoothed (right), with the 3-sigma band that each states; scales differ.",
        )
    if main.budgets:
        pictures["budget"] = (budget.budget_bars(main.budgets), budget.BARS)
    return {name: Figure.of(figure, caption) for name, (figure, caption) in pictures.items()}


def _accuracy(main: Results, drawn: Mapping[str, Figure]) -> list[Section]:
    """What is said of outages: error growth, consistency, the smoother, the budget."""
    bounds = (
        "Bounds hold for all epochs (lags) of a design together at 99 %. NEES: per degree of freedom, in the middle and at the end of every "
        "outage (the smoother's in the middle), mean over realizations; NIS: over all accepted fixes."
    )
    nees = nees_chart(main, png=drawn["consistency"].png)
    judged: list[Block] = [Items(consistency_lines(main)), Text(bounds), drawn["against_bounds"], nees]
    sections = [
        Section("Error growth", [error_chart(main, png=drawn["error_growth"].png), drawn["end_errors"]]),
        Section("Does the filter know its error?", judged),
    ]
    if "smoothing" in drawn:
        sections.append(Section("Smoothed", [Table(*smoother_rows(main), SMOOTHED, left=2), drawn["smoothing"]]))
    if "budget" in drawn:
        note = (
            "By covariance analysis of truth and belief together; nothing was drawn. Parts add up as squares. A mean removed from the records "
            "(truth.record) is not part of it."
        )
        told = Items(budget.budget_lines(main.budgets))
        sections.append(Section("Where the metres come from", [told, drawn["budget"], Text(note)]))
    return sections


def _variants(main: Results, variants: Mapping[str, Results]) -> Section:
    blocks: list[Block] = [Table(*variant_rows(main, variants), variant_caption(main), left=2)]
    for name, results in variants.items():
        blocks.append(Items([f"{name}: {line}" for line in (*verdicts(results), *rank_lines(results))]))
    return Section("Variants", blocks)


def _published(main: Results, variants: Mapping[str, Results], source: str) -> Section:
    lead = f"{source} The rms of ln(ours / published) over its cells is {log_distance(main):.2f}."
    tables = [
        Table(*beside(results, figure), f"{label}: {FIGURES[figure]}, m", left=2)
        for label, results in shown_beside(main, variants)
        for figure in results.published
    ]
    ranks = (*rank_lines(main), *pooled_rank_line(main, variants))
    return Section("Beside the published table", [Text(lead), *map(Text, ranks), *tables])


def _made(main: Results, notes: str) -> list[Block]:
    """How the results came about."""
    manifest = main.manifest
    made: list[Block] = [Text(part.strip()) for part in notes.split("\n\n") if part.strip()]
    made += [Text(f"Warning: {warning}.") for warning in manifest.get("warnings", ())]
    wall, epochs = main.timing["wall_seconds"], main.timing["filter_epochs"]
    made.append(
        Text(
            f"{main.realizations} realizations, {epochs:,} filter epochs, {main.timing['filter_seconds']:.1f} s in the filters, {wall:.1f} s in "
            f"all. Seed {main.seed}, digest {main.digest}, insemu {manifest.get('insemu')}, revision {manifest.get('git')}. The emulated path "
            f"is within {1e3 * float(manifest.get('ideal_imu_distance_m', np.nan)):.3g} mm of the requested one."
        )
    )
    scenario = yaml.safe_dump(manifest.get("scenario", {}), sort_keys=False, allow_unicode=True)
    return [*made, Code(scenario, "The resolved scenario:")]


def _card(s: Standing, results: Results) -> Card:
    """The verdict on one design."""
    notes = [f"{s.states} states; states {s.stated_m:.3g} m"]
    budgets = results.budgets.get(s.design)
    if budgets:
        parts = ", ".join(f"{key} {value:.3g} m" for key, value in list(budgets[-1]["parts_rms_m"].items())[:3])
        notes.append(f"Largest parts: {parts}")
    value = f"{s.error_m:.3g} m" + (f" ({s.interval})" if s.interval else "")
    verdict = s.verdict[:1].upper() + s.verdict[1:]
    return Card(s.design, value, verdict, {"yes": "good", "optimistic": "bad", "pessimistic": "warn"}[s.knows], notes)
