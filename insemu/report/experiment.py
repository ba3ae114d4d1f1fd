"""The page of an experiment: question, table, verdict, figures, beliefs, variants, and how it was made."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml

from insemu.evaluate import Results, outage_table, verdicts
from insemu.evaluate.answer import Standing, answer
from insemu.noise import NoiseModel, axis_unit
from insemu.report import budget, figures
from insemu.report.experiment_charts import error_chart, nees_chart
from insemu.report.page import Block, Card, Code, Figure, Folded, Items, Section, Table, Text, render
from insemu.report.tables import (
    FIGURES,
    SMOOTHED,
    beside,
    consistency_lines,
    log_distance,
    pooled_rank_line,
    published_value,
    rank_lines,
    short,
    shown_beside,
    smoother_rows,
    variant_caption,
    variant_rows,
)
from insemu.units import datasheet


def _table(results: Results) -> Table:
    place = {"planimetric_mean_m": 6, "planimetric_max_m": 7}.get(results.headline_figure, 5)
    header = [
        "design",
        "states",
        "outage",
        "at end m",
        "95 %",
        "mean m",
        "max m",
        "altitude m",
        "velocity m/s",
        "attitude deg",
    ]
    header += ["stated sigma m", "cover position %", "velocity %", "attitude %", "NEES/dof"]
    if results.published:
        header.insert(place, "published")
    body: list[list[str]] = []
    for name, outages in outage_table(results).items():
        for k, row in enumerate(outages):
            p, c = row["planimetric_end_m"], row["coverage_3sigma"]
            cells = [
                name if k == 0 else "",
                str(results.designs[name].states) if k == 0 else "",
                f"{row['start_s'] / 60:.3g} min, {row['duration_s']:g} s",
                f"{p['mean']:.3g}",
                "" if p["ci95"][0] is None else f"{p['ci95'][0]:.3g} to {p['ci95'][1]:.3g}",
                f"{row['planimetric_mean_m']:.3g}",
                f"{row['planimetric_max_m']:.3g}",
                f"{row['altimetric_end_m']:.3g}",
                f"{row['velocity_end_m_s']:.3g}",
                f"{row['attitude_end_deg']:.3g}",
                f"{row['predicted_sigma_end_m']:.3g}",
                *(f"{100 * c[g]:.1f}" for g in ("position", "velocity", "attitude")),
                short(row["nees_per_dof"]),
            ]
            if results.published:
                cells.insert(place, published_value(results, name, k))
            body.append(cells)
    caption = (
        f"Planimetric errors, means over {results.realizations} realizations; intervals by bootstrap over realizations. Altitude, velocity, "
        "attitude and stated sigma at the end of the outage; cover is the share of errors inside 3 sigma during it."
    )
    return Table(header, body, caption, left=1)


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
            f"Outage {last}: north errors of one realization and the 3-sigma band that its filter states; thin grey lines are all realizations.",
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
    if main.outages and main.smoothed is not None:
        pictures["smoothing"] = (
            figures.smoothing(main),
            "Errors north in the longest outage, filtered (left) and smoothed (right), with the 3-sigma band that each states; scales differ.",
        )
    if main.budgets:
        pictures["budget"] = (budget.budget_bars(main.budgets), budget.BARS)
    drawn = {name: Figure.of(figure, caption) for name, (figure, caption) in pictures.items()}
    folder.mkdir(parents=True, exist_ok=True)
    for name, picture in drawn.items():
        (folder / f"{name}.png").write_bytes(picture.png)

    said = answer(main)
    nees = nees_chart(main, png=drawn["consistency"].png)
    sections = [
        Section("Every outage", [_table(main), Folded("Differences between the designs", [Items(verdicts(main))])]),
        Section("Flight", [drawn["flight"]]),
    ]
    if main.outages:
        sections += [
            Section("Error growth", [error_chart(main, png=drawn["error_growth"].png), drawn["end_errors"]]),
            Section(
                "Does the filter know its error?",
                [
                    Items(consistency_lines(main)),
                    Text(
                        "Bounds hold for all epochs (lags) of a design together at 99 %. NEES: per degree of freedom, in the middle and at "
                        "the end of every outage (the smoother's in the middle), mean over realizations; NIS: over all accepted fixes."
                    ),
                    drawn["against_bounds"],
                    nees,
                ],
            ),
        ]
    if "smoothing" in drawn:
        header, body = smoother_rows(main)
        sections.append(Section("Smoothed", [Table(header, body, SMOOTHED, left=2), drawn["smoothing"]]))
    if "budget" in drawn:
        sections.append(
            Section(
                "Where the metres come from",
                [
                    Items(budget.budget_lines(main.budgets)),
                    drawn["budget"],
                    Text(
                        "By covariance analysis of truth and belief together; nothing was drawn. Parts add up as squares. A mean removed from the "
                        "records (truth.record) is not part of it."
                    ),
                ],
            )
        )
    if variants:
        header, body = variant_rows(main, variants)
        blocks: list[Block] = [Table(header, body, variant_caption(main), left=2)]
        for name, results in variants.items():
            blocks.append(Items([f"{name}: {line}" for line in (*verdicts(results), *rank_lines(results))]))
        sections.append(Section("Variants", blocks))
    if main.published:
        distance = log_distance(main)
        sections.append(
            Section(
                "Beside the published table",
                [
                    Text(f"{text.get('source', '')} The rms of ln(ours / published) over its cells is {distance:.2f}."),
                    *(Text(line) for line in (*rank_lines(main), *pooled_rank_line(main, variants))),
                    *(
                        Table(*beside(results, figure), f"{label}: {FIGURES[figure]}, m", left=2)
                        for label, results in shown_beside(main, variants)
                        for figure in results.published
                    ),
                ],
            )
        )
    sections.append(Section("What each design believes", _beliefs(main)))
    manifest = main.manifest
    made: list[Block] = []
    if text.get("notes"):
        made += [Text(part.strip()) for part in text["notes"].split("\n\n") if part.strip()]
    made += [Text(f"Warning: {warning}.") for warning in manifest.get("warnings", ())]
    wall, epochs = main.timing["wall_seconds"], main.timing["filter_epochs"]
    made.append(
        Text(
            f"{main.realizations} realizations, {epochs:,} filter epochs, {main.timing['filter_seconds']:.1f} s in the filters, {wall:.1f} s in "
            f"all. Seed {main.seed}, digest {main.digest}, insemu {manifest.get('insemu')}, revision {manifest.get('git')}. The emulated path "
            f"is within {1e3 * float(manifest.get('ideal_imu_distance_m', np.nan)):.3g} mm of the requested one."
        )
    )
    made.append(
        Code(
            yaml.safe_dump(manifest.get("scenario", {}), sort_keys=False, allow_unicode=True),
            "The resolved scenario, SI units:",
        )
    )
    sections.append(Section("How it was made", made))
    return render(
        main.title,
        sections,
        folder / "index.html",
        answer=said.sentence if said else "",
        lead=" ".join(part for part in (text.get("question", ""), f"{main.realizations} realizations.") if part),
        cards=[_card(s, main) for s in said.standings] if said else (),
        footer=f"Made by insemu {manifest.get('insemu')}.",
    )


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
