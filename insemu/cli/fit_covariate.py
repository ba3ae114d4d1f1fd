"""``insemu fit-covariate``: levels that follow temperature, speed, rate, force, vibration or a column."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console

from insemu.cli.options import DRAWS, argument, option
from insemu.cli.printing import print_boxed

if TYPE_CHECKING:
    from insemu.fit import FollowingFit
    from insemu.noise import NoiseModel
    from insemu.records import Series


def command(
    log: str = argument("LOG", "Log at rest or drive, with the covariate next to the signals."),
    model: str = option("--model", ...),
    covariate: str = option(
        "--covariate",
        "",
        "What all levels follow: temperature, speed, rate, force, vibration or a column; not needed where the model says it: "
        '"WN(follows=temperature) + GM()".',
    ),
    segments: int = option("--segments", 12, min=2, max=DRAWS),
    columns: list[str] | None = option("--columns", None),
    rate: str = option("--rate", ""),
    skip: str = option("--skip", "0 s"),
    tau_from: str = option("--tau-from", ""),
    tau_to: str = option("--tau-to", ""),
    out: str = option("--output", "", "Write the models as YAML that a scenario reads."),
    page: str = option("--page", ""),
    as_json: bool = option("--json", False),
) -> None:
    """Fit a noise model whose levels follow a covariate, over segments of a log or drive (gmwm)."""
    from insemu.cli.covariates import Request
    from insemu.covariates import checked, needed
    from insemu.fit import fit_following
    from insemu.report.following import render_following

    request = Request(log, model, rate, skip, columns, tau_from, tau_to, out, page, as_json)
    series, found = request.opened()

    def fit(s: Series) -> FollowingFit:
        asked = followed(model, s.unit, covariate)
        checked(needed([asked]), found, log)
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
    from insemu.report.following import following_answer, segment_rows

    for line in following_answer(fitted):
        console.print(line, highlight=False)
    print_boxed(console, f"{axis}: segment by segment", *segment_rows(fitted))
