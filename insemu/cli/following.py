"""``insemu fit --covariate``: levels that follow temperature, speed, rate, force, vibration or a column."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from insemu.cli.covariates import Request
    from insemu.fit import FollowingFit
    from insemu.noise import NoiseModel
    from insemu.records import Series

#: Segments that a log is cut into unless the user says how many.
SEGMENTS = 12


def fit_covariate(request: Request, covariate: str) -> None:
    """Fit every axis in segments with their covariates, print or write what was found.

    Parameters
    ----------
    request : Request
        Where no process of its structure says what it follows, all follow the covariate.
    covariate : str
        ``NAME``, ``NAME:SEGMENTS``, or nothing where the model says what is followed.

    Raises
    ------
    InputError
        See :func:`insemu.fit.fit_following`; a covariate that the file does not have.
    """
    from insemu.covariates import checked, needed
    from insemu.errors import InputError
    from insemu.fit import fit_following
    from insemu.report import render_following

    name, _, count = covariate.partition(":")
    if count and not count.isdecimal():
        raise InputError(f"found '{count}' segments, expected a whole number as in temperature:12", where="--covariate")
    series, found = request.opened()

    def fit(s: Series) -> FollowingFit:
        asked = followed(request.model, s.unit, name)
        checked(needed([asked]), found, request.file)
        segments = int(count) if count else SEGMENTS
        return fit_following(s, found, asked, segments=segments, tau_from=request.tau[0], tau_to=request.tau[1])

    request.give(request.fitted(series, fit), _show, render_following)


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
