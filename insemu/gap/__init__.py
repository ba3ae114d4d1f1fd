"""Where simulation and measurement disagree: find the missing effect, name it, add it, show the gap shrink.

``find_gap`` holds a static log or a recording against what is believed and answers with a :class:`GapReport`; :func:`register` adds a
candidate of one's own. :func:`check` emulates recordings from a model along a measured drive and says where the measured one stands among them.
"""

from insemu.gap.beliefs.nominal import Nominal, load_nominal
from insemu.gap.beliefs.refined import refined_nominal, write_refined
from insemu.gap.candidates.axis import register
from insemu.gap.data.sources import StaticLog, from_its_start, load_measured
from insemu.gap.experiment import NextExperiment, design, promise_text, write_experiment
from insemu.gap.policy import Policy, rules
from insemu.gap.predictive import Check, check, kept
from insemu.gap.problems.aids import is_judged
from insemu.gap.problems.rest import find_static_gap
from insemu.gap.session import applied, find_gap, with_only
from insemu.gap.verdict import HALF_SAMPLE, Finding, GapReport, Interval, Member, Value, Where

__all__ = [
    "HALF_SAMPLE",
    "Check",
    "Finding",
    "GapReport",
    "Interval",
    "Member",
    "NextExperiment",
    "Nominal",
    "Policy",
    "StaticLog",
    "Value",
    "Where",
    "applied",
    "check",
    "design",
    "find_gap",
    "find_static_gap",
    "from_its_start",
    "is_judged",
    "kept",
    "load_measured",
    "load_nominal",
    "promise_text",
    "refined_nominal",
    "register",
    "rules",
    "with_only",
    "write_experiment",
    "write_refined",
]
