"""The blind trial of the gap workflow: the emulator hides effects, :mod:`insemu.gap` looks for them, the answers are scored.

Only this room knows what was hidden and what was said; :mod:`insemu.gap` sees the recording and the beliefs alone.
"""

from insemu.trial.run import Job, Plan, Trial, catalogue_of, known_effects, run_trial
from insemu.trial.score import DEFINITIONS, Score, interval, score_trials

__all__ = [
    "DEFINITIONS",
    "Job",
    "Plan",
    "Score",
    "Trial",
    "catalogue_of",
    "interval",
    "known_effects",
    "run_trial",
    "score_trials",
]
