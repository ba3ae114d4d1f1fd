"""The page of a transfer: does it help, the factor on every level, the judge, the reasons."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from insemu.report.charts import GREY, INK, Chart, Line, View, strokes
from insemu.report.page import Card, Items, Page, Section, Table
from insemu.report.style import COLOURS
from insemu.transfer import Transfer

#: Standard deviations that a gain must be away from zero to be called one.
CERTAIN = 1.96
Cells = tuple[list[str], list[list[str]]]


def transfer_word(found: Transfer) -> tuple[str, str]:
    """Whether the transferred model is better than the static one, and the tone of a card."""
    gain, sd = next(j for j in found.judged if j.name == "transferred").gain
    if abs(gain) <= CERTAIN * sd:
        return "no better for certain", "warn"
    return ("better", "good") if gain > 0 else ("worse", "bad")


def transfer_answer(found: Transfer) -> str:
    """Whether the factors help, in one sentence."""
    by = {j.name: j for j in found.judged}
    own, hand = by["transferred"], by["by hand"]
    word = transfer_word(found)[0]
    return (
        f"{'Take the transferred' if word == 'better' else 'Keep the static'} model: the transferred one is {word} in {own.outages} outages that "
        f"the factors were not fitted on: {own.gain[0]:+.2f} nats per outage (standard deviation {own.gain[1]:.2f}); "
        f"a factor of 10 by hand {hand.gain[0]:+.2f}."
    )


def factor_rows(found: Transfer) -> Cells:
    """Header and rows: the factor on every level."""
    rows = [
        [f.name, f"{f.value:.3g}", f"{f.low:.3g} to {f.high:.3g}", "" if f.decisive else "the drive cannot tell"]
        for f in found.factors
    ]
    return ["level", "factor", "95 % interval", ""], rows


def constant_rows(found: Transfer) -> Cells:
    """Header and rows: constants of the IMU that were tuned together with the factors."""
    rows = [[c.name, f"{c.value:+.2e}", f"{c.sigma:.1e}", f"{c.before:.1e}"] for c in found.constants]
    return ["constant (1 or rad)", "estimate", "standard deviation", "before the drive"], rows


def judged_rows(found: Transfer) -> Cells:
    """Header and rows: how every belief stood in the outages."""
    rows = [[j.name, f"{j.metres:.1f}", f"{j.inside:.0%}", f"{j.score:.2f}"] for j in found.judged]
    return ["belief", "horizontal, m rms", "inside 95 %", "log density of the end"], rows


def reason_rows(found: Transfer) -> Cells:
    """Header and rows: what of every factor a named effect explains, and what is left."""
    rows = []
    for name, rest in found.rest.items():
        parts = sorted(((s.shares[name], s.finding.effect) for s in found.reasons), reverse=True)
        whole = next(f.value for f in found.factors if f.name == name)
        rows.append(
            [name, f"{whole:.2g}", ", ".join(f"{e} {share:.2g}" for share, e in parts) or "none named", f"{rest:.2g}"]
        )
    return ["level", "factor", "explained by", "rest"], rows


def _chart(found: Transfer) -> Chart:
    at = [float(k) for k in range(len(found.factors))]
    words = [f"{f.name}: {f.value:.3g} ({f.low:.3g} to {f.high:.3g})" for f in found.factors]
    x, y, said = strokes(at, [(f.low, f.high) for f in found.factors], words)
    lines = [
        Line("95 % interval", np.array(y), COLOURS[0], width=3.0, x=x, text=said),
        Line("factor", [f.value for f in found.factors], INK, points=True, width=5.0, x=at, text=words),
        Line("static model", [1.0, 1.0], GREY, dashed=True, x=[-0.5, at[-1] + 0.5], text=["static model"] * 2),
    ]
    ticks = [(p, f.name.replace(" ", "\n")) for p, f in zip(at, found.factors, strict=True)]
    view = View("Factors", "factor on the level", lines, log_y=True, ticks=ticks)
    caption = "By what the noise of the drive exceeds each level of the static model, with 95 % intervals; 1 is the static model."
    return Chart("Factors", caption, None, "level", [view], group="factors")


def render_transfer(found: Transfer, path: str | Path, source: str) -> Path:
    """Write the page.

    Parameters
    ----------
    found : Transfer
    path : path
        HTML file.
    source : str
        The drive.
    """
    word, tone = transfer_word(found)
    cards = [
        Card(
            j.name,
            f"{j.metres:.1f} m rms",
            word.capitalize() if j.name == "transferred" else f"{j.gain[0]:+.2f} nats per outage",
            tone if j.name == "transferred" else "plain",
            [f"{j.inside:.0%} of the ends inside their 95 % ellipsoid"],
        )
        for j in found.judged
    ]
    sections = [
        Section(
            "Factors",
            [_chart(found), Table(*factor_rows(found)), *([Items(list(found.assumed))] if found.assumed else [])],
        ),
        Section(
            "The judge",
            [
                Table(
                    *judged_rows(found), "At the end of outages that the factors were not fitted on. Nats: log density."
                )
            ],
        ),
    ]
    if found.constants:
        caption = (
            "Scale factors and misalignments at the end of the drive, by the filter whose innovations gave the factors."
        )
        sections.insert(1, Section("Constants", [Table(*constant_rows(found), caption)]))
    if found.rest:
        caption = "Each factor is the product of what the named effects explain and the rest."
        sections.append(Section("Reasons", [Table(*reason_rows(found), caption, left=3, wrap=True)]))
    return Page(
        f"A static model on a drive: {Path(source).name}",
        sections,
        kind="transfer",
        source=source,
        answer=transfer_answer(found),
        cards=cards,
    ).write(path)
