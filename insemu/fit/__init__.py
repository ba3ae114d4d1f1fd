"""A noise model from a signal, with uncertainty and rank.

One door, :func:`fit`; every method returns a :class:`FitResult`.
"""

from __future__ import annotations

from insemu.fit.covariance import covariance_of_curve, model_covariance
from insemu.fit.estimator import Estimator, Method, bootstrapped, fit
from insemu.fit.following import Followed, FollowingFit, Segment, fit_following, followed
from insemu.fit.indirect import check_bootstrap
from insemu.fit.likelihood import LARGE, Stream, fit_mli_pieces
from insemu.fit.online import Alarm, OnlineFit, Update
from insemu.fit.regressors import Coefficient, RegressedFit, fit_regressed
from insemu.fit.result import LEAST_P, Criterion, Estimate, FitResult, GoodnessOfFit, save
from insemu.fit.robust import cleaned_curve
from insemu.fit.runs import Choice, RunsFit, choose_model, fit_runs
from insemu.fit.selection import RANK_DOF, Ranking, prediction_distance, select_axes, wic
from insemu.fit.together import fit_together

__all__ = [
    "LARGE",
    "LEAST_P",
    "RANK_DOF",
    "Alarm",
    "Choice",
    "Coefficient",
    "Criterion",
    "Estimate",
    "Estimator",
    "FitResult",
    "Followed",
    "FollowingFit",
    "GoodnessOfFit",
    "Method",
    "OnlineFit",
    "Ranking",
    "RegressedFit",
    "RunsFit",
    "Segment",
    "Stream",
    "Update",
    "bootstrapped",
    "check_bootstrap",
    "choose_model",
    "cleaned_curve",
    "covariance_of_curve",
    "fit",
    "fit_following",
    "fit_mli_pieces",
    "fit_regressed",
    "fit_runs",
    "fit_together",
    "followed",
    "model_covariance",
    "prediction_distance",
    "save",
    "select_axes",
    "wic",
]
