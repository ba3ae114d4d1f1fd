"""The blind trial of the gap workflow: the emulator hides effects, :mod:`insemu.gap` looks for them, the answers are scored.

``check`` emulates recordings from a model along a measured drive and says where the measured one stands among them.

Only this room knows what was hidden and what was said; :mod:`insemu.gap` sees the recording and the beliefs alone.
"""

from insemu.trial.predictive import Check, check, kept
from insemu.trial.run import Job, Kind, Plan, Trial, catalogue_of, known_effects, run_trial
from insemu.trial.score import (
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
    "Check",
    "Job",
    "Kind",
    "Plan",
    "Score",
    "Trial",
    "calibration",
    "catalogue_of",
    "check",
    "confusion",
    "for_20_nats",
    "held_out_ratio",
    "interval",
    "kept",
    "known_effects",
    "mean_class_size",
    "power",
    "run_trial",
    "score_trials",
]
