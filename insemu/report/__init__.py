"""Figures and one self-contained HTML page, for experiments, signals, fits and gaps."""

from insemu.report.budget import budget_lines, render_budgets
from insemu.report.characterise import render_characterisation
from insemu.report.experiment import render_experiment
from insemu.report.fit import render_fits
from insemu.report.gap import (
    draw_gap,
    effect_name,
    finding_action,
    finding_metres,
    gap_headline,
    render_gap,
    sensor_axes,
)
from insemu.report.tables import (
    FIGURES,
    SMOOTHED,
    beside,
    consistency_lines,
    pooled_rank_line,
    rank_lines,
    short_headline,
    shown_beside,
    smoother_rows,
    variant_caption,
    variant_rows,
)
from insemu.report.track import check_figure, draw_track

__all__ = [
    "FIGURES",
    "SMOOTHED",
    "beside",
    "budget_lines",
    "check_figure",
    "consistency_lines",
    "draw_gap",
    "draw_track",
    "effect_name",
    "finding_action",
    "finding_metres",
    "gap_headline",
    "pooled_rank_line",
    "rank_lines",
    "render_budgets",
    "render_characterisation",
    "render_experiment",
    "render_fits",
    "render_gap",
    "sensor_axes",
    "short_headline",
    "shown_beside",
    "smoother_rows",
    "variant_caption",
    "variant_rows",
]
