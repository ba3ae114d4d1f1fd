"""``insemu fit-covariate``: levels that follow temperature, speed, rate, force, vibration or a column."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console

from insemu.cli.covariates import CovariateArguments
from insemu.cli.options import DRAWS, option
from insemu.cli.printing import print_boxed

if TYPE_CHECKING:
    from insemu.fit import FollowingFit
    from insemu.noise import NoiseModel
    from insemu.records import Series


class FitCovariateArguments(CovariateArguments):
    """Of ``insemu fit-covariate``."""

    covariate: str = option(
        "--covariate",
        "",
        "What all levels follow: temperature, speed, rate, force, vibration or a column; not needed where the model says it: "
        '"WN(follows=temperature) + GM()".',
    )
    segments: int = option("--segments", 12, min=2, max=DRAWS)


def command(args: FitCovariateArguments) -> None:
    """Fit a noise model whose levels follow a covariate, over segments of a log or drive (gmwm)."""
    from insemu.covariates import checked, needed
    from insemu.fit import fit_following
    from insemu.report.following import render_following

    series, found = args.opened()

    def fit(s: Series) -> FollowingFit:
        asked = followed(args.model, s.unit, args.covariate)
        checked(needed([asked]), found, args.log)
        return fit_following(s, found, asked, segments=args.segments, **args.scales.limits)

    args.give(args.fitted(series, fit), _show, render_following)


def followed(text: str, unit: str, covariate: str) -> NoiseModel:
    """The structure; where no process says what it follows, all noise follows the covariate."""
    from dataclasses import replace

    from insemu.errors import found_at
    from insemu.noise import Follows, NoiseModel

    with found_at("--model"):
        asked = NoiseModel.parse(text, unit)
    if covariate and all(p.follows is None for p in asked):
        asked = NoiseModel(tuple(p if p.single_draw else replace(p, follows=Follows(covariate)) for p in asked))
    return asked


def _show(console: Console, axis: str, fitted: FollowingFit) -> None:
    """What every level follows in words, the segments."""
    from insemu.report.following import following_answer, segment_rows

    for line in following_answer(fitted):
        console.print(line, highlight=False)
    print_boxed(console, f"{axis}: segment by segment", *segment_rows(fitted))
