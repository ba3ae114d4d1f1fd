"""``insemu fit --regress``: temperature, time and other regressors estimated together with the noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from insemu.cli.covariates import Request
    from insemu.fit import RegressedFit
    from insemu.records import Series


def fit_regressors(request: Request, regress: str) -> None:
    """Fit every axis with its regressors, print or write what was found.

    Parameters
    ----------
    request : Request
    regress : str
        Regressors (:func:`insemu.covariates.regressors_of`).

    Raises
    ------
    InputError
        See :func:`insemu.fit.fit_regressed`; a regressor that the file does not have; nothing left to fit.
    """
    from insemu.covariates import regressors_of
    from insemu.errors import InputError
    from insemu.fit import fit_regressed
    from insemu.noise import NoiseModel
    from insemu.report import render_regressed

    series, there = request.opened()
    used = regressors_of(regress, there, len(series[0]), 1.0 / series[0].rate_hz, "--regress")
    series = [s for s in series if s.name not in used]
    if not series:
        raise InputError("every column is a regressor, expected one to fit", where=request.file)

    def fit(s: Series) -> RegressedFit:
        return fit_regressed(
            s, used, NoiseModel.parse(request.model, s.unit), tau_from=request.tau[0], tau_to=request.tau[1]
        )

    request.give(request.fitted(series, fit), _show, render_regressed)


def _show(console: Console, axis: str, found: RegressedFit) -> None:
    """The coefficients as a table."""
    from insemu.cli.printing import print_table
    from insemu.report import coefficient_rows

    print_table(console, f"{axis}: regressors, {found.explained:.1%} of the variance", *coefficient_rows(found))
