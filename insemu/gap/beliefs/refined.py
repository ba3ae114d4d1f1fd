"""The refined model: what was found, written in the form that the nominal model had, for emulator and filter alike.

Noise joins the noise models; everything else becomes an entry of the table of effects (:class:`insemu.effects.EffectUse`), which the emulator
injects and a filter takes off (:mod:`insemu.effects.compensation`).
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from insemu.effects import EFFECTS, Effect, EffectParameter, EffectUse, Stage, having, joined
from insemu.filters import AIDS, AidUse
from insemu.gap.beliefs.nominal import REFINED, Nominal
from insemu.gap.data.samples import louder
from insemu.gap.data.sources import StaticLog
from insemu.gap.evidence.rolloff import HALF_POWER
from insemu.gap.verdict import Finding, GapReport
from insemu.noise import AR, BI, DR, GM, SIN, WN, NoiseModel, Process, axis_unit, save
from insemu.records import AXES, Recording
from insemu.whole import put

#: Points of a temperature profile that a scenario is given.
MOST_POINTS = 200
#: Gauss-Markov processes that stand for flicker in a filter, and the longest averaging time at which they do, s.
FLICKER_TERMS, FLICKER_SPAN = 4, 3600.0
#: Standard deviation of a row of an aid that is not used, SI: large enough to say nothing, small enough for digits.
UNUSED = 1e6
#: Probability that a good fix is rejected, for a filter that has to live with outliers.
GATE = 1e-4


# -- from what was found to entries of the table of effects ---------------------------------------------------------------------------------


def uses_of(finding: Finding, dt: float = 0.01) -> tuple[EffectUse, ...]:
    """A finding as entries of the table of effects, with its estimates.

    Parameters
    ----------
    finding : Finding
    dt : float
        Sampling interval, s: a moving average is written in samples.

    Returns
    -------
    tuple of EffectUse
        Empty for an effect that the table does not have (a user's own). Where axes differ in a number that an entry has only once, one for
        each axis.
    """
    effect = EFFECTS.get(finding.effect)
    if effect is not None and effect.sensors == ("imu",):
        finding = replace(finding, sensor="imu")  # seen on a sensor, but the whole IMU has it
    if effect is None or finding.sensor not in effect.sensors:
        return ()
    given = {p.name: p.value for p in finding.parameters}
    if finding.effect == "decimation_filter":
        return _low_pass(finding, given, dt)
    # a number that an entry has once may differ from axis to axis
    apart = any(p.size == 1 and f"{p.name}_{a}" in given for p in effect.parameters for a in finding.axes)
    out = []
    for axes in [(a,) for a in finding.axes] if apart else [finding.axes]:
        values = {}
        for p in effect.parameters:
            numbers = _numbers(effect, p, given, axes)
            if numbers is not None:
                values[p.name] = numbers
        if all(p.name in values or p.default is not None for p in effect.parameters):
            written = axes[0] if "equation" in effect.traits else ""
            out.append(EffectUse(effect.id, finding.sensor, values, written))
    return tuple(out)


def _numbers(
    effect: Effect, p: EffectParameter, given: Mapping[str, float], axes: Sequence[str]
) -> tuple[float, ...] | None:
    """All numbers of a parameter; axes that were not found have the value that does nothing."""
    if p.size == 1:
        value = next((given[f"{p.name}_{a}"] for a in axes if f"{p.name}_{a}" in given), given.get(p.name))
        return None if value is None else (_in_bounds(p, value),)
    if p.size > 3:
        return tuple(float(given.get(label, 0.0)) for label in p.labels(effect.axes))
    if not any(name in given for name in (p.name, *p.labels(effect.axes))):
        return None
    whole = not axes or not set(axes) <= set(effect.axes)
    out = [
        given.get(f"{p.name}_{a}", given.get(p.name, p.nothing)) if whole or a in axes else p.nothing
        for a in effect.axes
    ]
    if p.name == "beta":  # the axes without the process still need a rate
        some = next(v for v in out if v != p.nothing)
        out = [v if v != p.nothing else some for v in out]
    return tuple(_in_bounds(p, float(v)) for v in out)


def _in_bounds(p: EffectParameter, value: float) -> float:
    return max(float(value), 0.0) if p.positive else float(value)


def _low_pass(finding: Finding, given: Mapping[str, float], dt: float) -> tuple[EffectUse, ...]:
    cutoffs = [v for k, v in given.items() if k.startswith("cutoff")]
    orders = [v for k, v in given.items() if k.startswith("order")]
    if not cutoffs:
        return ()
    cutoff = float(np.median(cutoffs))
    if finding.variant in HALF_POWER:
        length = HALF_POWER[finding.variant] / cutoff
        use = EffectUse(finding.effect, finding.sensor, {"taps": (float(max(1, round(length / dt))),)})
        return (use, use) if finding.variant == "triangular window" else (use,)
    order = (
        1.0 if finding.variant == "exponential" else float(max(1, round(float(np.median(orders))))) if orders else 2.0
    )
    return (EffectUse(finding.effect, finding.sensor, {"cutoff": (min(cutoff, 0.499 / dt),), "order": (order,)}),)


# -- noise ------------------------------------------------------------------------------------------------------------------------------------


def refined_effects(nominal: Nominal, report: GapReport, dt: float = 0.01) -> tuple[EffectUse, ...]:
    """Known effects and those found, less what the refined noise models hold.

    Parameters
    ----------
    nominal : Nominal
        With the effects that were known before.
    report : GapReport
        What was found.
    dt : float
        Sampling interval of the IMU, s.
    """
    found: list[EffectUse] = []
    for finding in report.findings:
        if finding.effect in having("noise") or (finding.effect == "quantization" and finding.variant == "integrated"):
            continue
        effect = EFFECTS.get(finding.effect)
        held = effect.process if effect is not None and effect.stage is Stage.NOISE else None
        if held is not None:
            models = [report.refined.get(f"{finding.sensor}_{a}") for a in finding.axes]
            if models and all(m is not None and any(isinstance(p, held) for p in m) for m in models):
                continue
        found += uses_of(finding, dt)
    return joined(nominal.effects, found)


def true_noise(nominal: Nominal, report: GapReport) -> dict[str, NoiseModel]:
    """The refined noise of every axis, for an emulator: without the stand-ins of what the effects hold."""
    out = {**nominal.beliefs, **report.refined}
    for finding in report.findings:
        given = {p.name: p.value for p in finding.parameters}
        for a in finding.axes:
            name = f"{finding.sensor}_{a}"
            if name not in out:
                continue
            if finding.effect == "ramp":
                out[name] = _less(out[name], lambda p: isinstance(p, DR))
            elif finding.effect == "telegraph":
                size = given.get("amplitude", given.get(f"amplitude_{a}"))
                out[name] = _less(out[name], lambda p, s=size: isinstance(p, GM) and p.parameters["sigma"] == s)
    return out


def filter_noise(nominal: Nominal, report: GapReport, dt: float) -> dict[str, NoiseModel]:
    """The refined noise of every axis, for a filter: a ramp is compensated, of fast vibration only its slow part matters, lost samples are noise.

    Parameters
    ----------
    nominal : Nominal
        What was believed.
    report : GapReport
        What was found; its ``refined`` models take the place of the believed ones.
    dt : float
        Sampling interval of the IMU, s.

    Returns
    -------
    dict of axis to NoiseModel
    """
    out = {}
    models = {**nominal.beliefs, **report.refined}
    for white in (report.unresolved, *(finding.white for finding in report.findings)):
        for name, more in zip(AXES, white, strict=False):
            models[name] = louder(models[name], more)
    for name, model in models.items():
        old = set(nominal.beliefs.get(name, ()))
        bands = [p for p in model if isinstance(p, AR) and p not in old]
        rest = [p for p in model if not (p in bands or (isinstance(p, SIN | DR) and p not in old))]
        density = sum(float(p.psd(np.zeros(1), dt)[0]) for p in bands)
        if density > 0.0:
            k = next((k for k, p in enumerate(rest) if isinstance(p, WN)), None)
            level = float(np.sqrt(density + (rest[k].parameters["N"] ** 2 if k is not None else 0.0)))
            rest = [WN(level), *(p for i, p in enumerate(rest) if i != k)]
        parts: list[Process] = []
        for p in rest:
            parts += p.approximation(FLICKER_TERMS, 10.0 * dt, FLICKER_SPAN)[0] if isinstance(p, BI) else (p,)
        out[name] = NoiseModel(tuple(parts))
    return out


def _less(model: NoiseModel, gone: Any) -> NoiseModel:
    rest = tuple(p for p in model if not gone(p))
    return NoiseModel(rest) if rest else model


def refined_nominal(nominal: Nominal, report: GapReport, dt: float = 0.01) -> Nominal:
    """The nominal model with what was found; :func:`insemu.gap.find_gap` on the same recording finds nothing more.

    Parameters
    ----------
    nominal : Nominal
        What was believed.
    report : GapReport
        What :func:`insemu.gap.find_gap` found with it.
    dt : float
        Sampling interval of the IMU, s.
    """
    return replace(nominal, beliefs=true_noise(nominal, report), effects=refined_effects(nominal, report, dt))


# -- writing ----------------------------------------------------------------------------------------------------------------------------------


def write_refined(
    nominal: Nominal, report: GapReport, path: str | Path, measured: StaticLog | Recording | None = None
) -> Path:
    """Write the refined model in the form that the nominal one had.

    A belief file gets the noise and the effects. A scenario gets them as its ``truth``, and a design ``refined`` beside its own, which carries the
    refined noise and takes the effects off (or gates, or widens what it believes of the fixes): ``insemu run`` takes it as it is. A noise-model
    file stays one as long as noise is all that was found, and becomes a belief file otherwise.

    Parameters
    ----------
    nominal : Nominal
    report : GapReport
    path : path
    measured : StaticLog or Recording, optional
        Gives the sampling interval and, for effects of temperature, the temperature.
    """
    path = Path(path)
    dt = _interval(measured)
    effects = refined_effects(nominal, report, dt)
    noise = true_noise(nominal, report)
    if nominal.kind == "noise" and not effects:
        save({**nominal.beliefs, **noise}, path)
        return path
    models = {a: m.to_list(axis_unit(a)) for a, m in noise.items() if a in AXES}
    kept = {k: v for k, v in nominal.raw.items() if k not in ("belief", "truth", "effects", "variants", "axes")}
    if nominal.kind == "noise":
        kept = {}
    notes = "\n".join([str(kept.pop("notes", "")), *_found(report)]).strip() + "\n"
    if nominal.kind == "scenario":
        document = {**kept, "notes": notes, **_scenario(nominal, report, measured, models, effects, path.parent)}
    else:
        document = {**kept, "notes": notes, "belief": models}
        if effects:
            document["effects"] = [use.to_mapping() for use in effects]
    put(path, yaml.safe_dump(plain(document), sort_keys=False, allow_unicode=True, width=140))
    return path


def _found(report: GapReport) -> list[str]:
    lines = [f"refined against {report.source}: {report.verdict}"]
    for s in report.findings:
        values = ", ".join(f"{v.name} {v.value:.4g} [{v.low:.4g}, {v.high:.4g}] {v.unit}".strip() for v in s.parameters)
        lines.append(f"  {s.effect} of {s.sensor} {', '.join(s.axes)} ({s.nats:.1f} nats): {values}")
    return lines


def _scenario(
    nominal: Nominal,
    report: GapReport,
    measured: StaticLog | Recording | None,
    models: Mapping[str, Any],
    effects: Sequence[EffectUse],
    folder: Path,
) -> dict[str, Any]:
    """The sections of a refined scenario that change."""
    raw = {k: _moved(v, Path(nominal.source).parent, folder) for k, v in nominal.raw.items()}
    designs = {name: _explicit(design, nominal) for name, design in raw.get("designs", {}).items()}
    first: Any = next(iter(designs.values()), {})
    options = dict(first.get("options", {})) if isinstance(first, Mapping) else {}
    own = [use for use in effects if use.effect.compensable]
    dt = _interval(measured)
    belief = {a: m.to_list(axis_unit(a)) for a, m in filter_noise(nominal, report, dt).items() if a in AXES}
    out: dict[str, Any] = {}
    if "recording" in raw:
        source = {"file": raw["recording"]} if isinstance(raw["recording"], str) else dict(raw["recording"])
        # where a recording's section has a key of its own the effect goes there, once for every design
        for use in list(own):
            if use.id == "mounting":
                source["mounting"] = list(use["rpy"])
                own.remove(use)
            elif use.id == "imu_gnss_time_offset":
                source["imu_time_offset"] = use.scalar("offset")
                own.remove(use)
        rest = [use for use in effects if not use.effect.compensable and use.id != "gnss_correlated_noise"]
        if rest:
            source["known"] = [use.to_mapping() for use in rest]
        out["recording"] = source
    else:
        old = raw.get("truth", {})
        kept = {k: v for k, v in old.items() if k not in ("gyro", "accel", "effects", *AXES)}
        truth = {**kept, **models}
        if effects:
            truth["effects"] = [use.to_mapping() for use in effects]
        if any(use.effect.needs_temperature for use in effects) and "temperature" not in truth:
            profile = _temperature(measured)
            if profile:
                truth["temperature"] = profile
        out["truth"] = truth
        out["trajectory"] = raw["trajectory"]
        given = {kind: use for kind, use in _aids(measured).items() if any(u.sensor == kind for u in effects)}
        if given:
            out["aids"] = {**given, **raw.get("aids", {})}
    if own:
        options["compensate"] = [use.to_mapping() for use in own]
    shares = [use.scalar("probability") for use in effects if "outlying" in use.effect.traits]
    if shares:
        options.setdefault("gate", GATE)
        if measured is not None and (fixes := getattr(measured, "gnss", None)) is not None:
            options.setdefault("gate_timeout", _patience(max(shares), fixes.t))
    coloured = next((use for use in effects if use.id == "gnss_correlated_noise"), None)
    if coloured is not None:
        white = np.prod([use["factor"] for use in own if use.id == "gnss_noise_level"], axis=0) * _stated(
            nominal, measured
        )
        options["compensate"] = [*options.get("compensate", []), _as_level(white, coloured).to_mapping()]
    out["designs"] = {**designs, REFINED: {**belief, **({"options": options} if options else {})}}
    if "fits" in raw:
        out["fits"] = raw["fits"]
    return out


def _patience(share: float, t: NDArray[np.float64]) -> float:
    """For how long fixes are rejected, s: so many outliers in a row are as rare as a good fix that is rejected, and the filter is what is wrong."""
    many = max(1, math.ceil(math.log(GATE) / math.log(min(share, 0.5))))
    return float((many - 0.5) * np.median(np.diff(t)))


def _explicit(design: Any, nominal: Nominal) -> Any:
    """A design that carried the truth's models still carries the nominal ones: the truth is another now."""
    if not isinstance(design, Mapping):
        return design
    out: dict[str, Any] = {}
    for key, source in design.items():
        if key in ("gyro", "accel", *AXES) and isinstance(source, Mapping) and source.get("truth"):
            for axis in [a for a in AXES if a == key or a.startswith(f"{key}_")]:
                out.setdefault(axis, nominal.beliefs[axis].to_list(axis_unit(axis)))
        else:
            out[key] = source
    return out


def _stated(nominal: Nominal, measured: StaticLog | Recording | None) -> NDArray[np.float64]:
    """Standard deviations (3,) of the positions as the recording states them, in the middle, or as they are believed, m."""
    gnss = measured.gnss if isinstance(measured, Recording) else None
    if isinstance(measured, Recording):
        nominal, _ = nominal.on(measured)
    stated = None if gnss is None else gnss.pos_std_ned
    return np.array(nominal.gnss.position_sigma) if stated is None else np.nanmedian(stated, axis=0)


def _as_level(white: NDArray[np.float64], coloured: EffectUse) -> EffectUse:
    """Coloured noise of the fixes for a filter without states for it: as large as the whole error, over its white part (3,)."""
    factor = np.hypot(1.0, np.array(coloured["sigma"]) / white)
    return EffectUse("gnss_noise_level", "gnss", {"factor": tuple(float(f) for f in factor)})


def _interval(measured: StaticLog | Recording | None) -> float:
    if isinstance(measured, StaticLog):
        return 1.0 / measured.axes[0].rate_hz
    return measured.imu.dt if measured is not None else 0.01


def _aids(measured: StaticLog | Recording | None) -> dict[str, dict[str, Any]]:
    """The aids of a recording as a scenario has them; a row that is not used is as good as none."""
    out = {}
    for record in measured.aids if isinstance(measured, Recording) else ():
        if record.kind in AIDS and len(record) > 1:
            sigma = np.median(np.where(np.isfinite(record.std) & (record.std > 0.0), record.std, UNUSED), axis=0)
            rate = 1.0 / float(np.median(np.diff(record.t)))
            size = sum(count for _, count in (AIDS[record.kind].settings or {}).values())
            settings = (*record.settings, *[0.0] * size)[:size]
            use = AidUse(AIDS[record.kind], rate, tuple(sigma.tolist()), settings)
            out[record.kind] = use.to_mapping()
    return out


def _temperature(measured: StaticLog | Recording | None) -> dict[str, list[float]] | None:
    """The recorded temperature as a scenario's profile."""
    if measured is None:
        return None
    if isinstance(measured, StaticLog):
        degc = measured.temperature
        t = None if degc is None else np.arange(degc.size) / measured.axes[0].rate_hz
    else:
        degc, t = measured.imu.temperature, measured.imu.t - measured.imu.t[0]
    if degc is None or t is None:
        return None
    k: NDArray[np.int64] = np.unique(np.linspace(0, degc.size - 1, min(MOST_POINTS, degc.size)).astype(np.int64))
    return {"t": [round(float(x), 6) for x in t[k]], "degc": [round(float(x), 4) for x in degc[k]]}


_PATHS = frozenset({"waypoints", "track", "motion", "file", "files", "recording"})


def _moved(value: Any, old: Path, new: Path, key: str = "") -> Any:
    """A section whose relative paths still lead to the same files from another folder."""
    if isinstance(value, Mapping):
        return {k: _moved(v, old, new, str(k)) for k, v in value.items()}
    if isinstance(value, list):
        return [_moved(v, old, new, key) for v in value]
    if isinstance(value, str) and key in _PATHS and not value.startswith("shared:") and not Path(value).is_absolute():
        target = old / value
        return os.path.relpath(target.resolve(), new.resolve()) if target.exists() else value
    return value


def plain(value: Any) -> Any:
    """The same in what YAML knows: lists, numbers and text."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return value.item() if isinstance(value, np.generic) else value
