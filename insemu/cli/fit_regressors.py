"""``insemu fit-regressors``: temperature, time and other regressors estimated together with the noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console

from insemu.cli.covariates import CovariateArguments
from insemu.cli.options import option

if TYPE_CHECKING:
    from insemu.fit import RegressedFit
    from insemu.records import Series


class FitRegressorsArguments(CovariateArguments):
    """Of ``insemu fit-regressors``."""

    regressors: str = option("--regressors", ...)


def command(args: FitRegressorsArguments) -> None:
    """Estimate what a signal follows (temperature, time) together with its noise (gmwm)."""
    from insemu.covariates import regressors_of
    from insemu.errors import InputError
    from insemu.fit import fit_regressed
    from insemu.noise import NoiseModel
    from insemu.report.regressors import render_regressed

    series, there = args.opened()
    used = regressors_of(args.regressors, there, len(series[0]), 1.0 / series[0].rate_hz, "--regressors")
    series = [s for s in series if s.name not in used]
    if not series:
        raise InputError("every column is a regressor, expected one to fit", where=args.log)

    def fit(s: Series) -> RegressedFit:
        return fit_regressed(s, used, NoiseModel.parse(args.model, s.unit), **args.scales.limits)

    args.give(args.fitted(series, fit), _show, render_regressed)


def _show(console: Console, axis: str, found: RegressedFit) -> None:
    """The coefficients as a table."""
    from insemu.cli.printing import print_table
    from insemu.report.regressors import coefficient_rows

    print_table(
        console, f"{axis}: regressors, {found.explained:.1%} of the variance", *coefficient_rows(found), groups=True
    )
