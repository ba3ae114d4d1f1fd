"""What the comparison of two drives says: the answer, tables and a page; and what a recording tells of its vehicle."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

import numpy as np

from insemu.drives import ALIKE_DB, Comparison, LearnedVehicle, unit_of
from insemu.records import AXES
from insemu.report.page import Card, Items, Page, Section, Table, Text

Cells = tuple[list[str], list[list[str]]]
#: Bands in which the motion of a vehicle is shown, Hz.
SHOWN = ((0.5, 2.0), (2.0, 8.0), (8.0, 30.0))


def drives_word(found: Comparison) -> tuple[str, str]:
    """Whether an emulated drive can be distinguished from a recorded one, and the tone of a card."""
    if found.everything.low > 0.75:
        return "easily distinguished from", "bad"
    return ("distinguished from", "warn") if found.everything.low > 0.5 else ("not distinguished from", "good")


def drives_answer(found: Comparison) -> str:
    """The answer in one sentence."""
    bands = f"; {found.alike} of {len(found.bands)} bands within {ALIKE_DB:g} dB" if found.bands else ""
    return (
        f"The emulated drive is {drives_word(found)[0]} the recorded one: area under the curve {found.powers} by powers of bands, "
        f"{found.everything} by everything (0.5: no difference, 1: always a difference){bands}."
    )


def telling_rows(found: Comparison) -> Cells:
    """Header and rows: single features, the most telling first."""

    def cell(value: float) -> str:
        return "" if np.isnan(value) else f"{value:.3g}"

    rows = [[t.name, t.unit, f"{t.area:.2f}", cell(t.recorded), cell(t.emulated), cell(t.noise)] for t in found.telling]
    return ["feature", "unit", "area", "recorded", "emulated", "sensor's noise, at most"], rows


def band_rows(found: Comparison) -> Cells:
    """Header and rows: every axis of every regime, its bands in dB with the recorded root mean square."""
    rows, header = [], ["regime", "axis"]
    for (regime, axis), bands in groupby(found.bands, key=lambda b: (b.regime, b.axis)):
        line = list(bands)
        header = ["regime", "axis", *(f"{b.low:g} to {b.high:.3g} Hz" for b in line)]
        rows.append([regime, axis, *(f"{b.db:+.1f} ({b.recorded:.2g} {b.unit})" for b in line)])
    return header, rows


def render_drives(found: Comparison, path: str | Path, recorded: str, emulated: str) -> Path:
    """Write the page of a comparison.

    Parameters
    ----------
    found : Comparison
    path : path
        HTML file.
    recorded, emulated : str
        The files.
    """
    word, tone = drives_word(found)
    cards = [
        Card("powers of bands", str(found.powers), word.capitalize(), tone),
        Card("everything", str(found.everything), word.capitalize(), tone),
    ]
    words = (
        "Boosted trees see windows of 4 s and say which of two is emulated; the area under their curve is how often they are right. "
        "Root mean squares are of the windows, regimes with equal weights; a feature's own area is below 0.5 where the emulated drive shows less."
    )
    header, rows = (
        ["regime", "recorded, s", "emulated, s"],
        [[k, f"{a:g}", f"{b:g}"] for k, (a, b) in found.seconds.items()],
    )
    caption = f"Emulated over recorded power in dB and the recorded root mean square, in regimes of 30 s or more; equal: within {ALIKE_DB:g} dB."
    sections = [
        Section(
            "What gives it away",
            [Text(words), Items([t.words for t in found.telling[:3]]), Table(*telling_rows(found), left=2)],
        ),
        Section("Bands by regime", [Table(*band_rows(found), caption, left=2)]),
        Section("Regimes", [Table(header, rows)]),
        Section("What was assumed", [Items(list(found.said))]),
    ]
    title = f"{Path(emulated).name} against {Path(recorded).name}"
    return Page(
        title, sections, kind="compare-drives", source=recorded, answer=drives_answer(found), cards=cards
    ).write(path)


def vehicle_rows(found: LearnedVehicle) -> Cells:
    """Header and rows: root mean squares of the vehicle's own motion by regime and axis, with standard deviations."""
    spectrum = found.vehicle.spectrum
    rows = []
    for k, r in enumerate(spectrum.regimes):
        for a, axis in enumerate(AXES):
            size, unit = unit_of(a)
            cells = []
            for low, high in SHOWN:
                inside = (spectrum.frequencies >= low) & (spectrum.frequencies <= high)
                share = 0.0 if r.density_sigma is None else np.sqrt(np.mean(r.density_sigma[inside, a] ** 2))
                rms = spectrum.rms(k, low, high)[a] / size
                cells.append(f"{rms:.3g} +- {50 * share:.0f} %" if inside.any() else "")
            rows.append([r.name, f"{found.seconds[r.name]:.0f} s", axis, unit, *cells])
    return ["regime", "seen", "axis", "unit", *(f"{a:g} to {b:g} Hz" for a, b in SHOWN)], rows


def vehicle_lines(found: LearnedVehicle) -> list[str]:
    """What else was found, and what the recording cannot tell."""
    out = [*found.said]
    s = found.sideslip
    if s is not None:
        out.append(
            f"sideslip without turns {np.rad2deg(s.sigma):.2g} deg over {s.time:.2g} s; rear axle {s.axle[0]:.2g} m behind (sigma {s.axle[1]:.2g}); "
            f"nose into the bend by {np.rad2deg(s.compliance[0]):.2g} deg per m/s^2 (sigma {np.rad2deg(s.compliance[1]):.2g})"
        )
    if found.vehicle.jerk is not None:
        out.append(f"jerk density of its path {found.vehicle.jerk:g} m/s^3 per sqrt(Hz)")
    levels = found.vehicle.spectrum.levels
    if levels is not None:
        spread = float(np.sqrt(np.mean(np.var(levels.log, axis=0)))) * 10.0 / np.log(10.0)
        out.append(f"levels of bands and axes spread by {spread:.1f} dB over {len(levels.motion)} moments")
    return out + [f"cannot tell: {text}" for text in found.vehicle.spectrum.unknown]
