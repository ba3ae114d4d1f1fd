"""Errors against the filter's own bounds, per outage and over many realizations; designs compared under common random numbers."""

from insemu.evaluate.comparison import (
    ComparisonRow,
    analysable,
    analyse_designs,
    compare,
    outage_budgets,
    with_designs,
)
from insemu.evaluate.covariance import CovarianceAnalysis
from insemu.evaluate.emulated import EmulatedWorld
from insemu.evaluate.errors import COMPONENTS, bootstrap_mean, navigation_error, paired_ratio, within_outage
from insemu.evaluate.experiment import Experiment, run_experiment
from insemu.evaluate.folder import CACHE, check_not_fewer, finish, only_writer, put, resolved, write
from insemu.evaluate.regression import Alteration, Baseline, check, smallest_detectable, trial
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
from insemu.evaluate.standings import Standing, answer
from insemu.evaluate.world import World

__all__ = [
    "CACHE",
    "COMPONENTS",
    "Alteration",
    "Baseline",
    "ComparisonRow",
    "CovarianceAnalysis",
    "EmulatedWorld",
    "Experiment",
    "Results",
    "Standing",
    "World",
    "analysable",
    "analyse_designs",
    "answer",
    "bootstrap_mean",
    "check",
    "check_not_fewer",
    "compare",
    "consistency_words",
    "figure_of",
    "finish",
    "kendall",
    "navigation_error",
    "only_writer",
    "outage_budgets",
    "outage_rows",
    "outage_table",
    "paired_ratio",
    "published_cells",
    "put",
    "rank_agreement",
    "resolved",
    "run_experiment",
    "single_run_agreement",
    "smallest_detectable",
    "summary",
    "trial",
    "verdicts",
    "with_designs",
    "within_outage",
    "write",
]
