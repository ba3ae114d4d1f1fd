"""``insemu fit --regress``: temperature, time and other regressors estimated together with the noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rich.console import Console

    from insemu.fit import FitResult, RegressedFit


def fit_regressors(
    file: str,
    model: str,
    regress: str,
    rate: str,
    skip: str,
    columns: list[str] | None,
    tau: tuple[float, float],
    *,
    show: Callable[[Console, Mapping[str, FitResult]], None],
    out: str,
    page: str,
    as_json: bool,
) -> None:
    """Fit every axis with its regressors, print or write what was found.

    Parameters
    ----------
    file : str
        Log or recording.
    model : str
        Structure.
    regress : str
        Regressors (:func:`insemu.covariates.regressors_of`).
    rate, skip : str
        Sampling rate of a log that does not say it, and what is left out at the start.
    columns : list of str or None
        Axes that are fitted.
    tau : (float, float)
        Scales to use, s.
    show : callable
        Prints the parameters of a fit.
    out, page : str
        Model file and page to write, or nothing.
    as_json : bool
        Print JSON on standard output.
    """
    import json

    from rich.console import Console

    from insemu import units
    from insemu.cli.following import chosen_axes
    from insemu.covariates import regressors_of
    from insemu.errors import InputError
    from insemu.fit import fit_regressed, save
    from insemu.logs import open_with_covariates
    from insemu.noise import NoiseModel

    series, there = open_with_covariates(file, units.parse(rate, "Hz") if rate else None, units.parse(skip, "s"))
    series = chosen_axes(series, columns, file)
    used = regressors_of(regress, there, len(series[0]), 1.0 / series[0].rate_hz, "--regress")
    series = [s for s in series if s.name not in used]
    if not series:
        raise InputError("every column is a regressor, expected one to fit", where=file)
    console = Console(stderr=as_json)
    results: dict[str, RegressedFit] = {}
    with Console(stderr=True).status("fitting") as status:
        for k, s in enumerate(series):
            status.update(f"{s.name}: axis {k + 1} of {len(series)}")
            try:
                results[s.name] = fit_regressed(
                    s, used, NoiseModel.parse(model, s.unit), tau_from=tau[0], tau_to=tau[1]
                )
            except InputError as error:
                raise InputError(error.message, where=error.where or s.name) from None
    if as_json:
        plain = {"axes": {a: f.to_json() for a, f in results.items()}}
        typer.echo(json.dumps(plain, indent=1, allow_nan=False))
    else:
        for axis, found in results.items():
            show(console, {axis: found.result})
            _show(console, axis, found)
    if out:
        save({axis: f.result for axis, f in results.items()}, out)
        console.print(f"models: {out}")
    if page:
        from insemu.report import render_regressed

        console.print(f"page: {render_regressed(results, page, source=file)}")


def _show(console: Console, axis: str, found: RegressedFit) -> None:
    """The coefficients as a table."""
    from insemu.cli.printing import print_table
    from insemu.report import coefficient_rows

    print_table(console, f"{axis}: regressors, {found.explained:.1%} of the variance", *coefficient_rows(found))
