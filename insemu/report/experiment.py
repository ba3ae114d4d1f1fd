"""The page of an experiment: question, table, verdict, figures, beliefs, variants, and how it was made."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml

from insemu.evaluate import Results, Standing, answer, verdicts
from insemu.noise import NoiseModel, axis_unit
from insemu.report import budget
from insemu.report.charts import Ledger
from insemu.report.experiment_charts import (
    bounds_chart,
    end_chart,
    error_chart,
    flight_chart,
    many,
    nees_chart,
    outage_charts,
    smoother_chart,
)
from insemu.report.page import Block, Card, Code, Folded, Items, Page, Section, Table, Text
from insemu.report.tables import (
    FIGURES,
    SMOOTHED,
    consistency_lines,
    full_headline,
    log_distance,
    page_headline,
    pooled_rank_line,
    published_table,
    rank_lines,
    smoother_rows,
    variant_caption,
    variant_rows,
    with_published,
)
from insemu.shown import count_of
from insemu.units import datasheet


def _tables(results: Results) -> list[Block]:
    caption = (
        f"Planimetric error at outage end, mean over {count_of(results.realizations, 'realization')} with its interval by bootstrap over them; "
        "what the filter states there; altitude; cover: errors inside 3 sigma during the outage. Verdict: on the NEES at the end of the outage."
    )
    if many(results):
        header, rows = full_headline(results)
        count, names = len(results.outages), iter(rows)
        named = [
            [name, *next(names)[1:]] for name in results.names for _ in range(count)
        ]  # sorted, every row needs its design
        chosen = "A click on a heading sorts, one on an outage draws it. " + caption
        order = [header.index(column) for column in ("design", "outage")]
        order += [k for k, column in enumerate(header) if k not in order and column != "states"]
        rows = [[row[k] for k in order] for row in named]
        return [
            Ledger(
                [header[k] for k in order],
                rows,
                chosen,
                2,
                outage_charts(results),
                list(range(count)) * len(results.names),
            )
        ]
    more = "Means over the realizations; altitude, velocity and attitude at the end of the outage."
    detail = Table(*full_headline(results), more, left=1)
    return [Table(*page_headline(results), caption, left=1), Folded("Every figure of every outage", [detail])]


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
    main: Results,
    variants: Mapping[str, Results],
    folder: Path,
    *,
    text: Mapping[str, str] | None = None,
    pictures: bool = True,
) -> Path:
    """Write ``index.html``, and its figures as PNG and SVG files.

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
    pictures : bool
        Whether the figures are written as files, too.

    Returns
    -------
    Path
        The page.
    """
    text = text or {}
    said = answer(main)
    differences = Folded("Differences between the designs", [Items(verdicts(main))])
    sections = [Section("Every outage", [*_tables(main), differences]), Section("Flight", [flight_chart(main)])]
    if main.outages:
        sections += _accuracy(main)
    if variants:
        sections.append(_variants(main, variants))
    if main.published:
        sections.append(_published(main, variants, text.get("source", "")))
    sections.append(Section("What each design believes", [Folded("Every parameter", _beliefs(main))]))
    sections.append(Section("How it was made", _made(main, text.get("notes", ""))))
    return Page(
        main.title,
        sections,
        kind="run",
        source=str(main.manifest.get("scenario_file", "")),
        answer=said.sentence if said else "",
        lead=" ".join(
            part for part in (text.get("question", ""), f"{count_of(main.realizations, 'realization')}.") if part
        ),
        cards=[_card(s, main) for s in said.standings] if said else (),
    ).write(folder / "index.html", pictures=pictures)


def _accuracy(main: Results) -> list[Section]:
    """What is said of outages: error growth, consistency, the smoother, the budget."""
    bounds = (
        "Bounds hold for all epochs (lags) of a design together at 99 %. NEES: per degree of freedom, in the middle and at the end of every "
        "outage (the smoother's in the middle), mean over realizations; NIS: over all accepted fixes."
    )
    judged = Folded("NEES, NIS and their bounds in words", [Items(consistency_lines(main)), Text(bounds)])
    sections = [
        Section("Error growth", [error_chart(main), end_chart(main)]),
        Section("Does the filter know its error?", [bounds_chart(main), nees_chart(main), judged]),
    ]
    if main.smoothed:
        rows = smoother_rows(main)
        table = Ledger(*rows, SMOOTHED, 2) if many(main) else Table(*rows, SMOOTHED, left=2)
        sections.append(Section("Smoothed", [table, smoother_chart(main)]))
    if main.budgets:
        note = (
            "By covariance analysis of truth and belief together; nothing was drawn. Parts add up as squares. A mean removed from the records "
            "(truth.record) is not part of it."
        )
        told = Items(budget.budget_lines(main.budgets))
        sections.append(Section("Where the metres come from", [told, budget.budget_chart(main.budgets), Text(note)]))
    return sections


def _variants(main: Results, variants: Mapping[str, Results]) -> Section:
    words = [f"{name}: {line}" for name, r in variants.items() for line in (*verdicts(r), *rank_lines(r))]
    table = Table(*variant_rows(main, variants), variant_caption(main), left=2)
    return Section("Variants", [Folded(f"{len(variants)} variants of the scenario", [table, Items(words)])])


def _published(main: Results, variants: Mapping[str, Results], source: str) -> Section:
    lead = f"{source} The rms of ln(ours / published) over its cells is {log_distance(main):.2f}."
    tables = [
        Table(*published_table(results, figure), f"{label}: {FIGURES[figure]}, m", left=2)
        for label, results in with_published(main, variants)
        for figure in results.published
    ]
    ranks = (*rank_lines(main), *pooled_rank_line(main, variants))
    return Section("Beside the published table", [Text(lead), Folded("Ours and theirs", [*map(Text, ranks), *tables])])


def _made(main: Results, notes: str) -> list[Block]:
    """How the results came about."""
    manifest = main.manifest
    made: list[Block] = [Text(part.strip()) for part in notes.split("\n\n") if part.strip()]
    made += [Text(f"Warning: {warning}.") for warning in manifest.get("warnings", ())]
    by = [f"Seed {main.seed}", f"digest {main.digest}", f"insemu {manifest.get('insemu')}"]
    by += [f"revision {manifest['git']}"] if manifest.get("git") else []
    path = ""
    if manifest.get("scenario", {}).get("trajectory"):  # a recording asks for no path
        path = f" The emulated path is within {1e3 * float(manifest.get('ideal_imu_distance_m', np.nan)):.3g} mm of the requested one."
    made.append(
        Text(
            f"{count_of(main.realizations, 'realization')}, {main.timing['filter_epochs']:,} filter epochs. {', '.join(by)}.{path}"
        )
    )
    scenario = yaml.safe_dump(manifest.get("scenario", {}), sort_keys=False, allow_unicode=True)
    return [*made, Folded("The resolved scenario", [Code(scenario)])]


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
