"""The page of a gap: disagreement, suspect, evidence, refined model, agreement."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from insemu.effects import AID_KINDS, EFFECTS
from insemu.report.charts import Chart, asset
from insemu.report.gap_charts import evidence_chart, innovation_chart, shrink_chart, spectrum_chart, wavelet_chart
from insemu.report.page import Block, Card, Code, Folded, Items, Page, Section, Table, Text
from insemu.report.static import save
from insemu.units import datasheet

if TYPE_CHECKING:
    from insemu.gap import Finding, GapReport, Interval, Value, Where


def effect_name(effect: str) -> str:
    """The field's words for an effect id."""
    return EFFECTS[effect].name if effect in EFFECTS else effect.replace("_", " ")


#: The field's words for the sensors.
SENSORS = {"gyro": "gyroscope", "accel": "accelerometer", "gnss": "GNSS", "imu": "IMU"}


def sensor_axes(sensor: str, axes: Sequence[str]) -> str:
    """Sensor and axes in words."""
    return f"{SENSORS.get(sensor, sensor)} {', '.join(axes)}".strip()


def _subject(finding: Finding) -> str:
    return _placed_name(finding.effect, finding.sensor, finding.axes)


def _placed_name(effect: str, sensor: str, axes: Sequence[str]) -> str:
    if sensor == "imu":  # an effect of the whole IMU or of timing needs no place
        return effect_name(effect)
    if sensor in AID_KINDS and effect in EFFECTS and len(EFFECTS[effect].sensors) == 1:  # its name says of which aid
        return ", ".join([effect_name(effect), *axes])
    return f"{effect_name(effect)} of the {sensor_axes(sensor, axes)}"


def _in_one_place(finding: Finding) -> bool:
    """Whether all members of a class are on the axes of the finding."""
    return all((m.sensor, m.axes) == (finding.sensor, finding.axes) for m in finding.members)


def _class_names(finding: Finding) -> list[str]:
    """The members of a class in words, each with its axes where these are not all the same."""
    if _in_one_place(finding):
        return [effect_name(m.effect) for m in finding.members]
    return [_placed_name(m.effect, m.sensor, m.axes) for m in finding.members]


#: What to do about an effect; ``{}`` stands for its first parameters.
_ACTIONS = dict(line.split(" | ") for line in asset("actions.txt").splitlines() if line)


def shown_value(value: Value) -> Value:
    """A parameter in the unit of datasheets."""
    factor, unit = datasheet(1.0, value.unit)
    return replace(value.scaled(factor), unit="" if unit == "1" else unit)


def finding_action(finding: Finding, assumed: Sequence[str] = ()) -> str:
    """What to do about a finding, in one line; values in units of datasheets.

    Parameters
    ----------
    finding : Finding
    assumed : sequence of str
        ``assumed`` of the report: what the fixes do not state is not called stated.
    """
    shown = [shown_value(v) for v in finding.parameters[:3] if v.name != "follows"]
    # of a vector the component alone: "value_x" is x, "rpy_roll" roll
    values = ", ".join(
        f"{v.name.removeprefix('value_').removeprefix('rpy_')} {v.value:.3g} {v.unit}".strip() for v in shown
    )
    follows = ", going with what the receiver states" if _follows(finding) else ""
    if finding.effect in ("expression", "expression_step"):
        target, _, term = finding.axes[0].partition(" = ")
        since = "".join(f" after {v.value:.0f} s" for v in shown if v.name == "start")
        return f"find what makes it, or take it off: {target} = {shown[0].value:.3g} {shown[0].unit} * ({term}){since}"
    text = _ACTIONS.get(finding.effect, "model or calibrate it: {}")
    from insemu.gap import HALF_SAMPLE

    if finding.variant == HALF_SAMPLE:
        text = 'read the samples as means over the interval before the stamp (--map "kind=mean"), or shift the stamps by half a sample: {}'
    if any(part in said for said in assumed for part in ("positions", "velocities") if part in text):
        text = text.replace("stated", "assumed")
    return text.format(values, follows=follows)


def _follows(finding: Finding) -> bool:
    """Whether slow errors of the fixes go with what the receiver states."""
    return any(v.name == "follows" for v in finding.parameters)


#: Findings on the first screen of a terminal and of a page, which folds the others, and names in the sentence above them.
FIRST_SCREEN, FEW_NAMES = 6, 3
#: Findings of one effect among those that are folded from which on they are counted apart.
MANY = 3
#: Rows of the tables of statistics.
LOOKED_AT = 12
#: Scatter of the positions from fix to fix over what is believed below which they were filtered: RTK without a filter reaches 0.38 (rtkexp_drive),
#: filters 0.007 to 0.02 (u-blox, UAV; ``python -m tests.real_gaps``).
FILTERED = 0.1


def finding_metres(finding: Finding) -> str:
    """What a finding is worth at the end of a minute without fixes, in words; a dash where nobody says."""
    return f"{finding.metres:.3g}" if math.isfinite(finding.metres) else "-"


def finding_nees(report: GapReport, finding: Finding) -> str:
    """NEES per degree of freedom without a finding, in words; a dash where nobody says.

    Parameters
    ----------
    report : GapReport
    finding : Finding
    """
    nees = report.nees(finding)
    return f"{nees:.3g}" if math.isfinite(nees) else "-"


def gap_headline(report: GapReport) -> str:
    """The verdict in one sentence."""
    if report.verdict == "nothing missing":
        return "Nothing is missing: the recording is what the nominal model predicts."
    if report.verdict == "unexplained":
        names = list(dict.fromkeys(_subject(s) for _, s in report.numbered()))
        extra = f" What was named explains part of it: {_few(names)}." if names else ""
        return "The recording holds something that no effect of the catalogue explains." + extra
    settings = [finding_action(s, report.assumed) for s in report.findings if s.is_setting]
    # levels alone are what the model lacks; together with anything else they are said as settings, first
    found = [s for s in report.findings if not s.is_setting] or report.findings
    ahead = f"Set first: {'; '.join(settings)}. " if settings and len(found) < len(report.findings) else ""
    first = found[0]
    # those worth most first; the others are counted, every one stands in the table
    names = list(dict.fromkeys(_subject(s) for _, s in report.numbered() if s in found))
    doubted = sum(s.doubtful for s in found)
    doubt = f" Something unexplained is in the place of {doubted} of {len(found)}." if doubted else ""
    if first.is_class:
        or_names = " or ".join(_class_names(first))
        rest = [n for n in names if n != _subject(first)]
        besides = f" Besides: {_few(rest)}." if rest else ""
        where = (
            f"The {sensor_axes(first.sensor, first.axes)} has" if _in_one_place(first) else "Missing from the model:"
        )
        return f"{ahead}{where} {or_names}: this recording cannot distinguish them. What would: {first.would_separate}.{besides}{doubt}"
    return f"{ahead}Missing from the model: {_few(names)}.{doubt}"


def folded_said(report: GapReport) -> str:
    """How many findings the first screen has no room for, and of what many of them are; empty where there are none."""
    rest = [s for _, s in report.numbered()[FIRST_SCREEN:]]
    many = [(effect, k) for effect, k in Counter(s.effect for s in rest).most_common() if k >= MANY]
    return f"{len(rest)} more" + "".join(f", {k} of them: {effect_name(effect)}" for effect, k in many) if rest else ""


def _few(names: Sequence[str]) -> str:
    """The first of some names, and how many more there are."""
    more = len(names) - FEW_NAMES
    return "; ".join(names[:FEW_NAMES]) + (f"; and {more} more" if more > 0 else "")


def shaking_said(report: GapReport) -> str:
    """How the vehicle shakes above its motion, in one sentence; empty where it does not."""
    parts = []
    for sensor, unit, scale in (("gyro", "deg/s", 180.0 / math.pi), ("accel", "m/s^2", 1.0)):
        own = [b for b in report.band if b.axis.startswith(sensor)]
        if own:
            sizes = ", ".join(f"{b.axis[-1]} {b.rms * scale:.3g}" for b in own)
            low, high = min(b.low for b in own), max(b.high for b in own)
            parts.append(f"{SENSORS[sensor]} {sizes} {unit} rms between {low:.0f} and {high:.0f} Hz")
    between = ""
    if any(report.unresolved):
        white = EFFECTS["white_noise"]
        gyro, accel = (
            "{:.3g} {}".format(*datasheet(math.sqrt(report.unresolved[k]), white.unit("N", sensor)))
            for k, sensor in ((0, "gyro"), (3, "accel"))
        )
        between = (
            f" What is faster than the samples leaves white noise of {gyro} and {accel} in what a filter integrates: sample faster, damp the mount, "
            "or believe as much, which the design of a refined scenario does."
        )
    return f"The vehicle shakes, which is no finding: {'; '.join(parts)}.{between}" if parts or between else ""


def filtered_said(report: GapReport) -> str:
    """That positions come from a filter in the receiver, in two sentences; empty where they do not.

    Independent fixes scatter from one to the next by their whole error, except for the part that lasts.
    """
    levels = [
        (v.value, s.axes)
        for s in report.findings
        if s.effect == "gnss_noise_level"
        for v in s.parameters
        if v.value < FILTERED
    ]
    slow = [s for s in report.findings if s.effect == "gnss_correlated_noise"]
    times = [v.value for s in slow for v in s.parameters if v.name == "tau"]
    stated = ", going with what it states" if any(_follows(s) for s in slow) else ""
    if not levels or not times:
        return ""
    sizes = ", ".join(f"{', '.join(axes)} {level:.3g}" for level, axes in levels)
    return (
        "The positions come from a filter in the receiver: from fix to fix they scatter by a small part of the believed standard deviations "
        f"({sizes}), and their errors last {max(times):.3g} s{stated}. "
        "Such a filter may use an IMU too: to judge an IMU, log fixes that are not filtered."
    )


def burst_said(report: GapReport) -> str:
    """Which few of the fixes that were not used for naming carry a large part of the gap index, in a sentence; empty where there are none."""
    if (b := report.burst) is None:
        return ""
    when = f"the fixes from {b.start:.1f} to {b.end:.1f} s" if b.end > b.start else f"the fix at {b.start:.1f} s"
    part = report.gap_after.value - b.without.value
    return (
        f"Of the gap index after, {part:.3f} comes from {when} ({b.what} up to {b.largest:.1f} standard deviations off); "
        f"without {'them' if b.end > b.start else 'it'} it is {_interval(b.without)}."
    )


def _number(x: float) -> str:
    return f"{x:.4g}"


def _interval(i: Interval) -> str:
    return "not scored" if not np.isfinite(i.value) else f"{i.value:.3f} [{i.low:.3f}, {i.high:.3f}]"


def _where_table(entries: Sequence[Where], caption: str) -> Table:
    entries = entries[:LOOKED_AT]
    rows = [
        [
            w.statistic.replace("_", " "),
            f"{w.sensor} {w.axis}".strip(),
            "" if w.scale_s is None else _number(w.scale_s),
            f"{w.p_value:.2g}",
        ]
        for w in entries
    ]
    strong = frozenset(k for k, w in enumerate(entries) if w.p_value < 0.01)
    return Table(("statistic", "axis", "scale, s", "corrected p"), rows, caption, left=2, strong=strong)


def _kind(w: Where) -> tuple[str, str]:
    """Sensor, and what was looked at in words that leave out components, axes and scales."""
    words = w.statistic.replace("_", " ")
    for component in ("position ", "velocity "):
        words = words.removeprefix(component) if words.startswith(component + "innovation") else words
    return w.sensor, "correlation between axes" if words.startswith("cross axis") else words


def _looked_at(report: GapReport) -> Table:
    """How many statistics of each kind were looked at, and how many of them disagree."""
    kinds = dict.fromkeys(_kind(w) for w in (*report.where, *report.after))

    def cells(entries: Sequence[Where]) -> tuple[str, str, bool]:
        if not entries:
            return "", "", False
        off = sum(w.p_value < 0.01 for w in entries)
        return f"{off} of {len(entries)}", f"{min(w.p_value for w in entries):.2g}", off > 0

    rows, strong = [], []
    for k, (sensor, kind) in enumerate(sorted(kinds)):
        before = cells([w for w in report.where if _kind(w) == (sensor, kind)])
        after = cells([w for w in report.after if _kind(w) == (sensor, kind)])
        rows.append([kind, SENSORS.get(sensor, sensor), *before[:2], *after[:2]])
        strong += [k] if before[2] else []
    header = ("statistic", "sensor", "nominal: disagree", "smallest p", "refined: disagree", "smallest p")
    return Table(header, rows, "Everything that was looked at", left=2, strong=frozenset(strong))


def _axes_with_findings(report: GapReport) -> list[str]:
    axes = [n for n, c in report.curves.items() if "tau_s" in c]
    named = [f"{s.sensor}_{a}" if a else s.sensor for s in report.findings for a in (s.axes or ("",))]
    return ([n for n in dict.fromkeys(named) if n in axes] or axes)[:4]


def _evidence(report: GapReport) -> list[Block]:
    """Nats of every finding's rivals."""
    rivals = []
    for finding in report.findings[:6]:
        members = [*finding.members, *finding.runners_up][:6]
        # the title says where the finding is
        names = [
            f"the same, {sensor_axes(m.sensor, m.axes)}"
            if m.effect == finding.effect and (m.sensor, m.axes) != (finding.sensor, finding.axes)
            else effect_name(m.effect)
            for m in members
        ]
        inside = [k < len(finding.members) for k in range(len(members))]
        rivals.append((_subject(finding), [(n, m.nats, i) for n, m, i in zip(names, members, inside, strict=True)]))
    return [evidence_chart(rivals)] if rivals else []


def _shrink(report: GapReport) -> list[Block]:
    """How far the gap index falls with each effect, as a chart and as a table."""
    if len(report.shrink) < 2:
        return []
    words = ["nominal model", *("; ".join(_placed_name(*a) for a in s.added) for s in report.shrink[1:])]
    rows = [[str(k), f"{s.index:.3g}", w] for k, (w, s) in enumerate(zip(words, report.shrink, strict=True))]
    return [shrink_chart(report), Table(("step", "gap index", "added"), rows, "Steps of the chart", left=3, wrap=True)]


def _pictures(report: GapReport, after: bool) -> list[Block]:
    """The charts of disagreement, with the nominal model or with the refined one."""
    names = _axes_with_findings(report)
    out: list[Block] = [wavelet_chart(report, names, "refined" if after else "nominal")] if names else []
    return out + ([innovation_chart(report, "after" if after else "before")] if "drive" in report.curves else [])


def draw_gap(report: GapReport, folder: str | Path, name: str) -> list[Path]:
    """Write the page's pictures as PNG and SVG files ``NAME_shrink``, ``NAME_before``, ``NAME_evidence`` and ``NAME_after`` (``NAME_before_2`` ...).

    Parameters
    ----------
    report : GapReport
    folder : path
        Made where it does not exist.
    name : str
        What the file names begin with.

    Returns
    -------
    list of Path
        What was written.
    """
    groups: dict[str, Sequence[Block]] = {
        "shrink": _shrink(report),
        "before": _pictures(report, False),
        "evidence": _evidence(report),
        "after": _pictures(report, True),
    }
    charts = [
        replace(chart, name=when if k == 0 else f"{when} {k + 1}")
        for when, members in groups.items()
        for k, chart in enumerate(c for c in members if isinstance(c, Chart))
    ]
    return save(charts, Path(folder), prefix=f"{name}_")


def _found(report: GapReport, order: Sequence[tuple[int, Finding]]) -> Table:
    """Findings with their numbers: what to do, how sure that is, and what it is worth."""
    rows = [
        [
            f"{number}. {effect_name(s.effect)}" + (f" ({s.variant})" if s.variant else ""),
            sensor_axes(s.sensor, s.axes),
            finding_action(s, report.assumed),
            f"{s.nats:.1f}",
            f"{s.confidence:.3f}",
            finding_metres(s),
            finding_nees(report, s),
        ]
        for number, s in order
    ]
    heads = (
        "effect",
        "axes",
        "what to do",
        "evidence, nats",
        "confidence",
        "m after 60 s without fixes",
        "NEES then",
    )
    return Table(heads, rows, left=3, wrap=True)


def _estimates(findings: Sequence[Finding]) -> Table:
    """Parameters with their intervals."""
    rows = [
        [
            effect_name(s.effect),
            sensor_axes(s.sensor, s.axes),
            v.name,
            _number(v.value),
            f"{_number(v.low)} to {_number(v.high)}",
            v.unit,
        ]
        for s in findings
        for v in map(shown_value, s.parameters)
    ]
    return Table(("effect", "axes", "parameter", "value", "95 % interval", "unit"), rows, "Estimates", left=3)


def _suspects(report: GapReport, names: Sequence[str]) -> list[Section]:
    """What was found, how sure that is, what it is worth, and the evidence for it."""
    order = report.numbered()
    said = filtered_said(report)
    suspects: list[Block] = [
        *map(Text, report.assumed),
        *([Text(said)] if said else []),
        _found(report, order[:FIRST_SCREEN]),
    ]
    if rest := order[FIRST_SCREEN:]:
        suspects.append(Folded(folded_said(report), [_found(report, rest)]))
    classes = [s for s in report.findings if s.is_class]
    if classes:
        suspects.append(Text("Effects that this recording cannot distinguish:"))
        suspects.append(
            Items(
                [
                    f"{' / '.join(_class_names(s))}"
                    + (f" ({sensor_axes(s.sensor, s.axes)})" if _in_one_place(s) else "")
                    + f": what would separate them is {s.would_separate}."
                    for s in classes
                ]
            )
        )
    if confusable := [s for s in report.findings if s.confusable]:
        suspects.append(
            Text("In a repetition of this recording with other noise, these would stand within three nats of the best:")
        )
        suspects.append(
            Items(
                [
                    f"beside {effect_name(s.effect)} ({sensor_axes(s.sensor, s.axes)}): "
                    + ", ".join(
                        f"{effect_name(c.effect)}, {sensor_axes(c.sensor, ())} ({c.share:.0%})"
                        for c in s.confusable[:6]
                    )
                    for s in confusable
                ]
            )
        )
    suspects.append(_estimates([s for _, s in order[:FIRST_SCREEN]]))
    if rest:
        suspects.append(Folded("Estimates of the others", [_estimates([s for _, s in rest])]))
    out = [Section("What was found", suspects)]
    pictures = _evidence(report)
    if heard := [n for n in names if report.curves[n].get("f")]:
        pictures.append(spectrum_chart(report, heard))
    return [*out, Section("The evidence", pictures)]


def render_gap(report: GapReport, folder: str | Path, refined: str = "") -> Path:
    """Write ``index.html``.

    Parameters
    ----------
    report : GapReport
    folder : path
        Created where absent.
    refined : str
        Text of the refined model's file, shown on the page.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    names = _axes_with_findings(report)
    looked = Folded(
        "Everything that was looked at",
        [
            Text(
                "Each statistic compares the recording with the nominal model, whose noise levels may be off by 20 %. The p-values are corrected "
                "for how many were looked at (Holm); below 0.01 is in bold."
            ),
            _where_table(report.where, "Nominal model, most significant first"),
            _where_table(report.after, "Refined model, most significant first"),
            _looked_at(report),
        ],
    )
    index = Table(
        ("", "before", "after"),
        [["gap index (reduced chi-square, 1 is agreement)", _interval(report.gap_before), _interval(report.gap_after)]],
        f"On data that was not used for naming. Gain of log score in nats per fix (per block of a static log): {_interval(report.held_out)}. "
        + burst_said(report),
    )
    left = [Text(f"Unexplained by what was named: {report.remainder}.")] if report.remainder else []
    if said := shaking_said(report):
        left.append(Text(said))
    sections = [
        *([Section("How the gap shrinks", shrink)] if (shrink := _shrink(report)) else []),
        *(_suspects(report, names) if report.findings else []),
        Section("Where they disagree", [*_pictures(report, after=False), looked]),
        Section("Agreement with the refined model", [index, *left, *_pictures(report, after=True)]),
        *([Section("The refined model", [Folded("refined.yaml", [Code(refined)])])] if refined else []),
    ]
    return Page(
        f"The gap between simulation and measurement: {Path(report.source).name}",
        sections,
        kind="gap",
        source=report.source,
        answer=gap_headline(report),
        cards=[_better(report), *(_card(report, n, s) for n, s in report.numbered()[:FIRST_SCREEN])],
    ).write(folder / "index.html")


def gap_charts(report: GapReport) -> list[Chart]:
    """The charts of disagreement with the nominal model."""
    return [chart for chart in _pictures(report, after=False) if isinstance(chart, Chart)]


def is_better(report: GapReport) -> tuple[str, str, str]:
    """Whether the refined model is better on data that was not used for naming: the word, the figures, and ``good``, ``warn`` or ``bad``."""
    before, after, gain = report.gap_before, report.gap_after, report.held_out
    figures = f"gap index {before.value:.3g} to {after.value:.3g}" if math.isfinite(after.value) else "no index"
    if not report.findings:
        return "nothing was added", figures, "plain"
    aids = [f"{k} {g.value:+.3g} nats per block [{g.low:.3g}, {g.high:.3g}]" for k, g in report.aids_held_out.items()]
    if all(s.sensor in AID_KINDS for s in report.findings):
        if not aids:
            return "not scored", f"the fixes, whose {figures}, judge no aid", "plain"
        gains = report.aids_held_out.values()
        worse, better = any(g.high < 0.0 for g in gains), all(g.low > 0.0 for g in gains)
        word, tone = ("no", "bad") if worse else ("yes", "good") if better else ("not shown", "warn")
        return word, "; ".join(aids), tone
    if not math.isfinite(gain.value):
        return "not scored", figures, "plain"
    per = "fix" if math.isfinite(report.stated_60s) else "block"
    figures = "; ".join([f"{figures}; {gain.value:+.3g} nats per {per} [{gain.low:.3g}, {gain.high:.3g}]", *aids])
    if gain.low > 0.0:
        return "yes", figures, "good"
    return ("no", figures, "bad") if gain.high < 0.0 else ("not shown", figures, "warn")


def _better(report: GapReport) -> Card:
    word, figures, tone = is_better(report)
    return Card(
        "Is the refined model better?", word[:1].upper() + word[1:], figures, tone, ["On data not used for naming."]
    )


def _card(report: GapReport, number: int, finding: Finding) -> Card:
    metres = (
        f"{finding_metres(finding)} m after 60 s without fixes" if math.isfinite(finding.metres) else "Metres not known"
    )
    sure = f"{finding.nats:.1f} nats, confidence {finding.confidence:.3f}"
    tone = "warn" if finding.is_class or finding.doubtful else "bad"
    return Card(f"{number}. {_subject(finding)}", metres, sure, tone, [finding_action(finding, report.assumed)])
