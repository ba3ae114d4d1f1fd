"""The blind trial of the gap workflow: the emulator hides effects, :mod:`insemu.gap` looks for them, the answers are scored.

Only this package knows what was hidden and what was said; :mod:`insemu.gap` sees the recording and the beliefs alone.
"""

from benchmarks.trial.run import Job, Kind, Plan, Trial, catalogue_of, known_effects, run_trial
from benchmarks.trial.score import (
    DEFINITIONS,
    Score,
    calibration,
    confusion,
    for_20_nats,
    held_out_ratio,
    interval,
    mean_class_size,
    power,
    score_trials,
)

__all__ = [
    "DEFINITIONS",
    "Job",
    "Kind",
    "Plan",
    "Score",
    "Trial",
    "calibration",
    "catalogue_of",
    "confusion",
    "for_20_nats",
    "held_out_ratio",
    "interval",
    "known_effects",
    "mean_class_size",
    "power",
    "run_trial",
    "score_trials",
]
