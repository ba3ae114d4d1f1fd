"""``insemu fit-regressors``: temperature, time and other regressors estimated together with the noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console

from insemu.cli.options import argument, option

if TYPE_CHECKING:
    from insemu.fit import RegressedFit
    from insemu.records import Series


def command(
    log: str = argument("LOG", "Log at rest or drive, with the regressors next to the signals."),
    model: str = option("--model", ...),
    regressors: str = option("--regressors", ...),
    columns: list[str] | None = option("--columns", None),
    rate: str = option("--rate", ""),
    skip: str = option("--skip", "0 s"),
    tau_from: str = option("--tau-from", ""),
    tau_to: str = option("--tau-to", ""),
    out: str = option("--output", "", "Write the models as YAML that a scenario reads."),
    page: str = option("--page", ""),
    as_json: bool = option("--json", False),
) -> None:
    """Estimate what a signal follows (temperature, time) together with its noise (gmwm)."""
    from insemu.cli.covariates import Request
    from insemu.covariates import regressors_of
    from insemu.errors import InputError
    from insemu.fit import fit_regressed
    from insemu.noise import NoiseModel
    from insemu.report.regressors import render_regressed

    request = Request(log, model, rate, skip, columns, tau_from, tau_to, out, page, as_json)
    series, there = request.opened()
    used = regressors_of(regressors, there, len(series[0]), 1.0 / series[0].rate_hz, "--regressors")
    series = [s for s in series if s.name not in used]
    if not series:
        raise InputError("every column is a regressor, expected one to fit", where=log)

    def fit(s: Series) -> RegressedFit:
        return fit_regressed(s, used, NoiseModel.parse(model, s.unit), tau_from=request.tau[0], tau_to=request.tau[1])

    request.give(request.fitted(series, fit), _show, render_regressed)


def _show(console: Console, axis: str, found: RegressedFit) -> None:
    """The coefficients as a table."""
    from insemu.cli.printing import print_table
    from insemu.report.regressors import coefficient_rows

    print_table(
        console, f"{axis}: regressors, {found.explained:.1%} of the variance", *coefficient_rows(found), groups=True
    )
