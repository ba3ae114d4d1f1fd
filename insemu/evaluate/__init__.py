"""Errors against the filter's own bounds, per outage and over many realizations; designs compared under common random numbers."""

from insemu.evaluate.ahead import effort
from insemu.evaluate.comparison import (
    ComparisonRow,
    analysable,
    analyse_designs,
    compare,
    outage_budgets,
    with_designs,
)
from insemu.evaluate.consistency import (
    chi_square_bounds,
    lag_products,
    nees_verdicts,
    nis_test,
    nis_verdict,
    smallest_found,
    whiteness_verdicts,
)
from insemu.evaluate.control import Controlled, control, planimetric, previewed
from insemu.evaluate.covariance import CovarianceAnalysis
from insemu.evaluate.emulated import EmulatedWorld
from insemu.evaluate.errors import (
    COMPONENTS,
    bootstrap_mean,
    navigation_error,
    paired_ratio,
    share_interval,
    within_outage,
)
from insemu.evaluate.experiment import Experiment, World
from insemu.evaluate.folder import CACHE, MARKER, check_not_fewer, finish, only_writer, resolved, write, write_summary
from insemu.evaluate.netcdf import write_netcdf
from insemu.evaluate.provenance import changed, differences, surroundings
from insemu.evaluate.regression import Alteration, Baseline, Change, check, smallest_detectable, trial
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
from insemu.evaluate.running import ALONE, Resources, chosen, fly, fly_part, run_experiment
from insemu.evaluate.shards import Shard, check_complete, note, noted
from insemu.evaluate.standings import Standing, answer, gnss_in_outages
from insemu.evaluate.sweep import Row, Sweep, best_of, conditions, front
from insemu.evaluate.twin import LinearTwin
from insemu.evaluate.until import Goal, Look, looks
from insemu.evaluate.verdict import MEAN_SQUARE, Verdict
from insemu.evaluate.ways import ways_of_run
from insemu.evaluate.world import input_files

__all__ = [
    "ALONE",
    "CACHE",
    "COMPONENTS",
    "MARKER",
    "MEAN_SQUARE",
    "Alteration",
    "Baseline",
    "Change",
    "ComparisonRow",
    "Controlled",
    "CovarianceAnalysis",
    "EmulatedWorld",
    "Experiment",
    "Goal",
    "LinearTwin",
    "Look",
    "Resources",
    "Results",
    "Row",
    "Shard",
    "Standing",
    "Sweep",
    "Verdict",
    "World",
    "analysable",
    "analyse_designs",
    "answer",
    "best_of",
    "bootstrap_mean",
    "changed",
    "check",
    "check_complete",
    "check_not_fewer",
    "chi_square_bounds",
    "chosen",
    "compare",
    "conditions",
    "consistency_words",
    "control",
    "differences",
    "effort",
    "figure_of",
    "finish",
    "fly",
    "fly_part",
    "front",
    "gnss_in_outages",
    "input_files",
    "kendall",
    "lag_products",
    "looks",
    "navigation_error",
    "nees_verdicts",
    "nis_test",
    "nis_verdict",
    "note",
    "noted",
    "only_writer",
    "outage_budgets",
    "outage_rows",
    "outage_table",
    "paired_ratio",
    "planimetric",
    "previewed",
    "published_cells",
    "rank_agreement",
    "resolved",
    "run_experiment",
    "share_interval",
    "single_run_agreement",
    "smallest_detectable",
    "smallest_found",
    "summary",
    "surroundings",
    "trial",
    "verdicts",
    "ways_of_run",
    "whiteness_verdicts",
    "with_designs",
    "within_outage",
    "write",
    "write_netcdf",
    "write_summary",
]
