"""``insemu fit --covariate``: levels that follow temperature, speed, rate, force, vibration or a column."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rich.console import Console

    from insemu.fit import FitResult, FollowingFit
    from insemu.noise import NoiseModel
    from insemu.records import Series

#: Segments that a log is cut into unless the user says how many.
SEGMENTS = 12


def alone(given: Mapping[str, object], option: str, what: str) -> None:
    """Raise ``InputError`` where an option of ``fit`` is given that another one does not go with.

    Parameters
    ----------
    given : mapping
        Name of the option to what it was given.
    option : str
        With which they do not go.
    what : str
        What is fitted by gmwm with the Haar filter only.
    """
    from insemu.errors import InputError

    usual = {"method": "gmwm", "wavelet": "haar"}
    wrong = [name for name, value in given.items() if value and value != usual.get(name)]
    if wrong:
        named = "several files" if wrong[0] == "files" else f"--{wrong[0]}"
        raise InputError(f"found {named}; {what} are fitted to one log by gmwm with the Haar filter", where=option)


def chosen_axes(series: list[Series], columns: list[str] | None, file: str) -> list[Series]:
    """Those that are asked for by name of column or axis; all where nothing is."""
    from insemu.cli.logs import column_names
    from insemu.errors import InputError, nearest
    from insemu.formats import AXIS_OF_COLUMN

    wanted = column_names(columns)
    if wanted is None:
        return series
    names = [AXIS_OF_COLUMN.get(w, w) for w in wanted]
    unknown = [w for w in names if w not in [s.name for s in series]]
    if unknown:
        raise InputError(f"has no column '{unknown[0]}'" + nearest(unknown[0], [s.name for s in series]), where=file)
    return [s for s in series if s.name in names]


def fit_covariate(
    file: str,
    model: str,
    covariate: str,
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
    """Fit every axis in segments with their covariates, print or write what was found.

    Parameters
    ----------
    file : str
        Log or recording.
    model : str
        Structure; where no process says what it follows, all follow the covariate.
    covariate : str
        ``NAME``, ``NAME:SEGMENTS``, or nothing where the model says what is followed.
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

    Raises
    ------
    InputError
        See :func:`insemu.fit.fit_following`; a covariate that the file does not have.
    """
    import json

    from rich.console import Console

    from insemu import units
    from insemu.cli.printing import counting
    from insemu.covariates import checked, needed
    from insemu.errors import InputError
    from insemu.fit import fit_following, save
    from insemu.logs import open_with_covariates

    name, _, count = covariate.partition(":")
    if count and not count.isdecimal():
        raise InputError(f"found '{count}' segments, expected a whole number as in temperature:12", where="--covariate")
    series, found = open_with_covariates(file, units.parse(rate, "Hz") if rate else None, units.parse(skip, "s"))
    series = chosen_axes(series, columns, file)
    console = Console(stderr=as_json)
    results: dict[str, FollowingFit] = {}
    with counting(Console(stderr=True), "fitting", len(series)) as finished:
        for s in series:
            asked = followed(model, s.unit, name)
            checked(needed([asked]), found, file)
            try:
                results[s.name] = fit_following(
                    s, found, asked, segments=int(count) if count else SEGMENTS, tau_from=tau[0], tau_to=tau[1]
                )
            except InputError as error:
                raise InputError(error.message, where=error.where or s.name) from None
            finished(s.name)
    if as_json:
        typer.echo(json.dumps({"axes": {a: f.to_json() for a, f in results.items()}}, indent=1))
    else:
        for axis, fitted in results.items():
            show(console, {axis: fitted.result})
            _show(console, axis, fitted)
    if out:
        save({axis: f.result for axis, f in results.items()}, out)
        console.print(f"models: {out}")
    if page:
        from insemu.report import render_following

        console.print(f"page: {render_following(results, page, source=file)}")


def followed(text: str, unit: str, covariate: str) -> NoiseModel:
    """The structure; where no process says what it follows, all noise follows the covariate."""
    from dataclasses import replace

    from insemu.errors import InputError
    from insemu.noise import Follows, NoiseModel

    try:
        asked = NoiseModel.parse(text, unit)
    except InputError as error:
        raise InputError(error.message, where="--model") from None
    if covariate and all(p.follows is None for p in asked):
        asked = NoiseModel(tuple(p if p.single_draw else replace(p, follows=Follows(covariate)) for p in asked))
    return asked


def _show(console: Console, axis: str, fitted: FollowingFit) -> None:
    """What every level follows in words, the segments."""
    from rich.table import Table

    from insemu.report import following_answer, segment_rows

    for line in following_answer(fitted):
        console.print(line, highlight=False)
    heading, rows = segment_rows(fitted)
    table = Table(title=f"{axis}: segment by segment", title_justify="left")
    for cell in heading:
        table.add_column(cell)
    for row in rows:
        table.add_row(*row)
    console.print(table)
