"""Errors against the filter's own bounds, per outage and over many realizations; designs compared under common random numbers."""

from insemu.evaluate.errors import COMPONENTS, bootstrap_mean, navigation_error, paired_ratio, within_outage
from insemu.evaluate.experiment import Experiment, run_experiment
from insemu.evaluate.folder import write
from insemu.evaluate.results import (
    Results,
    consistency_words,
    figure_of,
    kendall,
    outage_rows,
    outage_table,
    published_cells,
    rank_agreement,
    single_run_agreement,
    summary,
    verdicts,
)

__all__ = [
    "COMPONENTS",
    "Experiment",
    "Results",
    "bootstrap_mean",
    "consistency_words",
    "figure_of",
    "kendall",
    "navigation_error",
    "outage_rows",
    "outage_table",
    "paired_ratio",
    "published_cells",
    "rank_agreement",
    "run_experiment",
    "single_run_agreement",
    "summary",
    "verdicts",
    "within_outage",
    "write",
]
