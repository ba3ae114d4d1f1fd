"""Figures and one self-contained HTML page, for experiments, signals, fits and gaps."""

from insemu.report.array import array_answer, render_array, weight_rows, weighting_rows
from insemu.report.budget import budget_lines, render_budgets
from insemu.report.characterise import characterise_answer, characterise_rows, render_characterisation
from insemu.report.comparison import (
    COLUMNS,
    comparison_answer,
    comparison_rows,
    regression_answer,
    render_comparison,
    render_regression,
)
from insemu.report.experiment import render_experiment
from insemu.report.fit import fits_answer, render_fits
from insemu.report.following import following_answer, render_following, segment_rows
from insemu.report.gap import (
    draw_gap,
    effect_name,
    finding_action,
    finding_metres,
    finding_nees,
    gap_headline,
    is_better,
    ranked,
    render_gap,
    sensor_axes,
    shaking_said,
    shown_value,
)
from insemu.report.plotting import plot
from insemu.report.predictive import render_check
from insemu.report.regressors import coefficient_rows, render_regressed
from insemu.report.serve import server
from insemu.report.solve import (
    calibration_lines,
    compared_rows,
    consistency_words_of,
    outage_rows_of,
    render_solution,
    solve_answer,
    solve_rows,
)
from insemu.report.sweep import SWEPT, render_sweep, sweep_answer, sweep_rows
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
from insemu.report.track import check_figure, draw_track, render_reckoning
from insemu.report.transfer import (
    constant_rows,
    factor_rows,
    judged_rows,
    reason_rows,
    render_transfer,
    transfer_answer,
)

__all__ = [
    "COLUMNS",
    "FIGURES",
    "SMOOTHED",
    "SWEPT",
    "array_answer",
    "beside",
    "budget_lines",
    "calibration_lines",
    "characterise_answer",
    "characterise_rows",
    "check_figure",
    "coefficient_rows",
    "compared_rows",
    "comparison_answer",
    "comparison_rows",
    "consistency_lines",
    "consistency_words_of",
    "constant_rows",
    "draw_gap",
    "draw_track",
    "effect_name",
    "factor_rows",
    "finding_action",
    "finding_metres",
    "finding_nees",
    "fits_answer",
    "following_answer",
    "gap_headline",
    "is_better",
    "judged_rows",
    "outage_rows_of",
    "plot",
    "pooled_rank_line",
    "rank_lines",
    "ranked",
    "reason_rows",
    "regression_answer",
    "render_array",
    "render_budgets",
    "render_characterisation",
    "render_check",
    "render_comparison",
    "render_experiment",
    "render_fits",
    "render_following",
    "render_gap",
    "render_reckoning",
    "render_regressed",
    "render_regression",
    "render_solution",
    "render_sweep",
    "render_transfer",
    "segment_rows",
    "sensor_axes",
    "server",
    "shaking_said",
    "short_headline",
    "shown_beside",
    "shown_value",
    "smoother_rows",
    "solve_answer",
    "solve_rows",
    "sweep_answer",
    "sweep_rows",
    "transfer_answer",
    "variant_caption",
    "variant_rows",
    "weight_rows",
    "weighting_rows",
]
