"""The page of a gap: disagreement, suspect, evidence, refined model, agreement."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure as MplFigure

from insemu.effects import EFFECTS
from insemu.report.page import Block, Code, Figure, Items, Section, Table, Text, render
from insemu.report.style import COLOURS, style

if TYPE_CHECKING:
    from insemu.gap import Finding, GapReport, Interval, Where


def effect_name(effect: str) -> str:
    """The field's words for an effect id."""
    return EFFECTS[effect].name if effect in EFFECTS else effect.replace("_", " ")


#: The field's words for the sensors.
SENSORS = {"gyro": "gyroscope", "accel": "accelerometer", "gnss": "GNSS", "imu": "IMU"}


def sensor_axes(sensor: str, axes: Sequence[str]) -> str:
    """Sensor and axes in words."""
    return f"{SENSORS.get(sensor, sensor)} {', '.join(axes)}".strip()


def _subject(finding: Finding) -> str:
    where = sensor_axes(finding.sensor, finding.axes)
    # an effect of the whole IMU or of timing needs no place
    return effect_name(finding.effect) if finding.sensor == "imu" else f"{effect_name(finding.effect)} of the {where}"


#: What to do about an effect; ``{}`` stands for its first parameters.
_ACTIONS = {
    "white_noise": "set the white noise to {}",
    "random_walk": "add a random walk of {}",
    "gauss_markov": "add a Gauss-Markov process of {}",
    "flicker": "add bias instability of {}",
    "quantization": "add quantization of {}",
    "telegraph": "add telegraph noise of {}; no calibration takes it off",
    "turn_on_bias": "take the bias off: {}",
    "ramp": "take the drift off: {}",
    "scale_factor": "correct the scale factor: {}",
    "misalignment": "correct the misalignment: {}",
    "temperature": "calibrate over temperature: {}",
    "vibration_line": "damp the mount or filter: {}",
    "vibration_band": "damp the mount or raise the white noise: {}",
    "outliers": "reject single samples: {}",
    "saturation": "use a wider range: {}",
    "dropped_samples": "repair the logger: {}",
    "decimation_filter": "model the low-pass: {}",
    "imu_gnss_time_offset": "shift the stamps by {}",
    "clock_drift": "correct the clock by {}",
    "lever_arm": "correct the lever arm by {}",
    "mounting": "turn the IMU's axes by {}",
    "gnss_noise_level": "multiply the stated standard deviations of the positions by {}",
    "gnss_velocity_noise": "multiply the stated standard deviations of the velocities by {}",
    "gnss_correlated_noise": "add slow errors to the fixes: {}",
    "gnss_outliers": "gate the fixes: {}",
    "gnss_multipath_step": "leave these fixes out: {}",
}


def finding_action(finding: Finding) -> str:
    """What to do about a finding, in one line."""
    values = ", ".join(
        f"{v.name} {v.value:.3g} {v.unit if v.unit != '1' else ''}".strip() for v in finding.parameters[:3]
    )
    return _ACTIONS.get(finding.effect, "model or calibrate it: {}").format(values)


def finding_metres(finding: Finding) -> str:
    """What a finding is worth at the end of a minute without fixes, in words; a dash where nobody says."""
    return f"{finding.metres:.3g}" if math.isfinite(finding.metres) else "-"


def gap_headline(report: GapReport) -> str:
    """The verdict in one sentence."""
    if report.verdict == "nothing missing":
        return "Nothing is missing: the recording is what the nominal model predicts."
    if report.verdict == "unexplained":
        extra = (
            f" What was named explains part of it: {'; '.join(_subject(s) for s in report.findings)}."
            if report.findings
            else ""
        )
        return "The recording holds something that no effect of the catalogue explains." + extra
    first = report.findings[0]
    sure = [_subject(s) for s in report.findings if not s.doubtful]
    doubted = [_subject(s) for s in report.findings if s.doubtful]
    more = f" Beside something unexplained in the same place: {'; '.join(dict.fromkeys(doubted))}." if doubted else ""
    if first.is_class:
        names = " or ".join(effect_name(m.effect) for m in first.members)
        rest = (f" Besides: {'; '.join(sure[1:])}." if len(sure) > 1 else "") + more
        where = sensor_axes(first.sensor, first.axes)
        return (
            f"The {where} has {names}: this recording cannot tell them apart. What would: {first.would_separate}.{rest}"
        )
    return f"Missing from the model: {'; '.join(dict.fromkeys(sure))}.{more}"


def _number(x: float) -> str:
    return f"{x:.4g}"


def _interval(i: Interval) -> str:
    return "not scored" if not np.isfinite(i.value) else f"{i.value:.3f} [{i.low:.3f}, {i.high:.3f}]"


def _where_table(entries: Sequence[Where], caption: str, count: int = 12) -> Table:
    rows = [
        [
            w.statistic.replace("_", " "),
            f"{w.sensor} {w.axis}".strip(),
            "" if w.scale_s is None else _number(w.scale_s),
            f"{w.p_value:.2g}",
        ]
        for w in entries[:count]
    ]
    strong = frozenset(k for k, w in enumerate(entries[:count]) if w.p_value < 0.01)
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


def _axis_words(name: str) -> str:
    sensor, _, axis = name.rpartition("_")
    return f"{ {'gyro': 'gyroscope', 'accel': 'accelerometer'}.get(sensor, sensor) } {axis}"


def _pictures(report: GapReport, after: bool) -> list[Block]:
    """The figures of disagreement, with the nominal model or with the refined one."""
    names = _axes_with_findings(report)
    model, when = ("refined", "after") if after else ("nominal", "before")
    out: list[Block] = []
    if names:
        out.append(
            Figure.of(
                wavelet_figure(report, names, model), f"Wavelet deviation of the recording and of the {model} model."
            )
        )
    if "drive" in report.curves:
        text = f"Innovations of the filter with the {model} model. In grey what nineteen of twenty keep to where model and drive agree."
        out.append(Figure.of(innovation_figure(report, when), text))
    return out


def wavelet_figure(report: GapReport, names: Sequence[str], model: str) -> MplFigure:
    """Wavelet deviation of the recording and of a model (``nominal`` or ``refined``); limits are those of both models.

    Parameters
    ----------
    report : GapReport
    names : sequence of str
        Axes, keys of ``report.curves``; one panel each.
    model : {"nominal", "refined"}
    """
    with style():
        figure, panels = plt.subplots(1, len(names), figsize=(4.2 * len(names), 3.3), squeeze=False)
        for axis, name in zip(panels[0], names, strict=True):
            c = report.curves[name]
            tau = np.asarray(c["tau_s"])
            colour = COLOURS[1] if model == "nominal" else COLOURS[0]
            axis.loglog(tau, np.sqrt(c[model]), "-", color=colour, label=model)
            what, label = (
                ("measured", "measured")
                if model == "nominal"
                else ("measured_after", "measured, known effects taken off")
            )
            axis.loglog(tau, np.sqrt(c[what]), "o", ms=4, color=COLOURS[6], label=label)
            every = np.sqrt(np.concatenate([c["measured"], c["measured_after"], c["nominal"], c["refined"]]))
            axis.set_ylim(0.6 * every[every > 0].min(), 1.7 * every.max())
            axis.set_title(_axis_words(name))
            axis.set_xlabel("scale, s")
            axis.set_ylabel(f"wavelet deviation, {c['unit']}")
        panels[0][0].legend()
    return figure


def spectrum_figure(report: GapReport, names: Sequence[str]) -> MplFigure:
    """PSD measured, nominal and refined."""
    with style():
        figure, panels = plt.subplots(1, len(names), figsize=(4.2 * len(names), 3.3), squeeze=False)
        for axis, name in zip(panels[0], names, strict=True):
            c = report.curves[name]
            if c["f"]:
                axis.loglog(c["f"], np.sqrt(c["power"]), color=COLOURS[6], lw=0.7, label="measured")
                axis.loglog(c["f"], np.sqrt(c["nominal_psd"]), "--", color=COLOURS[1], label="nominal")
                axis.loglog(c["f"], np.sqrt(c["refined_psd"]), color=COLOURS[0], label="refined")
            axis.set_title(_axis_words(name))
            axis.set_xlabel("frequency, Hz")
            axis.set_ylabel(f"root of the two-sided PSD, {c['unit']}/sqrt(Hz)")
        panels[0][0].legend()
    return figure


def innovation_figure(report: GapReport, when: str) -> MplFigure:
    """Normalised innovations against time and their autocorrelation, with the ``before`` or the ``after`` model; limits are those of both."""
    both = report.curves["drive"]
    c = both[when]
    across = "across" in c
    t, y = np.asarray(c["t"]), np.asarray(c["y"])
    limit = 1.05 * max(4.0, *(float(np.nanpercentile(np.abs(both[k]["y"]), 99.8)) for k in ("before", "after")))
    with style():
        figure, panels = plt.subplots(1, 4 if across else 3, figsize=(16.0 if across else 12.0, 3.2), squeeze=False)
        for axis, first, what in ((panels[0][0], 0, "position"), (panels[0][1], 3, "velocity")):
            axis.axhspan(-2.0, 2.0, color="#E9ECEF", zorder=0)
            for k, name in enumerate(("north", "east", "down")):
                axis.plot(t, y[:, first + k], ".", ms=2.5, color=COLOURS[k], label=name)
            axis.set_ylim(-limit, limit)
            axis.set_title(f"{what} innovations")
            axis.set_xlabel("time, s")
            axis.set_ylabel("innovation / its standard deviation")
        panels[0][0].legend(markerscale=3, ncol=3, loc="upper right")
        axis = panels[0][2]
        lags = np.arange(1, 31)
        finding = float(np.median(np.diff(t)))
        axis.axhspan(-2.0 / np.sqrt(t.size), 2.0 / np.sqrt(t.size), color="#E9ECEF", zorder=0)
        for k, name in enumerate(("pos. north", "pos. east", "pos. down", "vel. north", "vel. east", "vel. down")):
            z = y[:, k]
            if np.isfinite(z).sum() < 60:
                continue
            rho = [np.nanmean(z[j:] * z[:-j]) / np.nanmean(z * z) for j in lags]
            axis.plot(lags * finding, rho, "-" if k < 3 else "--", lw=1.1, color=COLOURS[k % 3], label=name)
        axis.set_ylim(-0.5, 1.0)
        axis.set_title("autocorrelation")
        axis.set_xlabel("lag, s")
        axis.set_ylabel("correlation")
        axis.legend(ncol=2)
        if across:
            axis = panels[0][3]
            when_t, u = c["across"]
            axis.axhline(0.0, color=COLOURS[6], lw=0.8)
            for k, name in ((1, "sideways"), (2, "down")):
                axis.plot(when_t, np.degrees(np.arctan2(u[:, k], u[:, 0])), ".", ms=2.5, color=COLOURS[k], label=name)
            every = [
                np.degrees(np.arctan2(b["across"][1][:, k], b["across"][1][:, 0]))
                for b in both.values()
                for k in (1, 2)
            ]
            top = 1.1 * max(3.0, *(float(np.percentile(np.abs(e), 99.0)) for e in every if e.size))
            axis.set_ylim(-top, top)
            axis.set_title("direction of travel in vehicle axes")
            axis.set_xlabel("time, s")
            axis.set_ylabel("angle to the forward axis, deg")
            axis.legend(markerscale=3)
    return figure


def evidence_figure(findings: Sequence[Finding]) -> MplFigure:
    """Nats of every rival, finding by finding."""
    with style():
        figure, panels = plt.subplots(len(findings), 1, figsize=(7.5, 1.0 + 1.2 * len(findings)), squeeze=False)
        for axis, finding in zip(panels[:, 0], findings, strict=True):
            rivals = [*finding.members, *finding.runners_up][:6]
            inside = {m.effect for m in finding.members}
            colours = [COLOURS[0] if m.effect in inside else COLOURS[6] for m in rivals]
            axis.barh(
                [effect_name(m.effect) for m in rivals][::-1], [m.nats for m in rivals][::-1], color=colours[::-1]
            )
            axis.set_title(_subject(finding))
        panels[-1, 0].set_xlabel("evidence, nats (blue: within 3 of the best)")
    return figure


def draw_gap(report: GapReport, folder: str | Path, name: str) -> list[Path]:
    """Write the page's pictures as PNG files ``NAME_before.png``, ``NAME_evidence.png`` and ``NAME_after.png`` (``NAME_before_2.png`` ...).

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
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    evidence: list[Block] = [Figure.of(evidence_figure(report.findings[:6]), "")] if report.findings else []
    out = []
    for when, blocks in (
        ("before", _pictures(report, after=False)),
        ("evidence", evidence),
        ("after", _pictures(report, after=True)),
    ):
        for k, block in enumerate(b for b in blocks if isinstance(b, Figure)):
            path = folder / (f"{name}_{when}.png" if k == 0 else f"{name}_{when}_{k + 1}.png")
            path.write_bytes(block.png)
            out.append(path)
    return out


def _suspects(report: GapReport, names: Sequence[str]) -> list[Section]:
    """What was found, how sure that is, what it is worth, and the evidence for it."""
    rows = [
        [
            effect_name(s.effect),
            s.variant,
            sensor_axes(s.sensor, s.axes),
            f"{s.nats:.1f}",
            f"{s.confidence:.3f}",
            finding_metres(s),
            finding_action(s),
        ]
        for s in report.findings
    ]
    heads = ("effect", "shape", "axes", "evidence, nats", "confidence", "m after 60 s without fixes", "what to do")
    suspects: list[Block] = [Table(heads, rows, left=3)]
    classes = [s for s in report.findings if s.is_class]
    if classes:
        suspects.append(Text("Effects that this recording cannot tell apart:"))
        suspects.append(
            Items(
                [
                    f"{' / '.join(effect_name(m.effect) for m in s.members)} ({sensor_axes(s.sensor, s.axes)}): "
                    f"what would separate them is {s.would_separate}."
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
    values = [
        [
            effect_name(s.effect),
            sensor_axes(s.sensor, s.axes),
            v.name,
            _number(v.value),
            f"{_number(v.low)} to {_number(v.high)}",
            v.unit,
        ]
        for s in report.findings
        for v in s.parameters
    ]
    suspects.append(
        Table(("effect", "axes", "parameter", "value", "95 % interval", "unit"), values, "Estimates", left=3)
    )
    out = [Section("The suspect", suspects)]
    pictures: list[Block] = [
        Figure.of(evidence_figure(report.findings[:6]), "Evidence of the named effects and their rivals.")
    ]
    if names and any(report.curves[n].get("f") for n in names):
        pictures.append(Figure.of(spectrum_figure(report, names), "Spectrum: measured, nominal, refined."))
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
    sections = [
        Section(
            "Where they disagree",
            [
                Text(
                    "Each statistic compares the recording with the nominal model, whose noise levels may be off by 20 %. The p-values are corrected "
                    "for how many were looked at (Holm); below 0.01 is in bold."
                ),
                _where_table(report.where, "Nominal model, most significant first"),
                *_pictures(report, after=False),
                _looked_at(report),
            ],
        )
    ]
    if report.findings:
        sections += _suspects(report, names)
    if refined:
        sections.append(Section("The refined model", [Code(refined)]))
    index = Table(
        ("", "before", "after"),
        [["gap index (reduced chi-square, 1 is agreement)", _interval(report.gap_before), _interval(report.gap_after)]],
        f"On data that was not used for naming. Gain of log score: {_interval(report.held_out)} nats per fix (per block of a static log).",
    )
    left = [Text(f"Left unexplained beside what was named: {report.remainder}.")] if report.remainder else []
    sections.append(
        Section(
            "Agreement",
            [
                index,
                *left,
                *_pictures(report, after=True),
                _where_table(report.after, "Refined model, most significant first"),
            ],
        )
    )
    return render(
        "The gap between simulation and measurement",
        sections,
        folder / "index.html",
        lead=gap_headline(report),
        footer=report.source,
    )
