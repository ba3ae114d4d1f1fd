"""Nats of log evidence: explanations of a log at rest, linear models of innovations, noise of the fixes."""

from insemu.gap.evidence.band import Band
from insemu.gap.evidence.kernels import toeplitz_whiten
from insemu.gap.evidence.linear import log_mean_exp, regression_evidence
from insemu.gap.evidence.model import (
    Component,
    Explanation,
    Likelihood,
    Regressors,
    fit,
)
from insemu.gap.evidence.modes import Free, laplace
from insemu.gap.evidence.rolloff import DEPTH, Rolloff
from insemu.gap.evidence.surrogate import Colour, Surrogate

__all__ = [
    "DEPTH",
    "Band",
    "Colour",
    "Component",
    "Explanation",
    "Free",
    "Likelihood",
    "Regressors",
    "Rolloff",
    "Surrogate",
    "fit",
    "laplace",
    "log_mean_exp",
    "regression_evidence",
    "toeplitz_whiten",
]
