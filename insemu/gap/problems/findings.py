"""From what was found on the axes of a log to findings as they are reported: joined over axes, doubted, in words."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu.effects import EFFECTS, EffectUse, having
from insemu.gap.candidates.axis import AxisState
from insemu.gap.candidates.shapes import PROCESSES
from insemu.gap.evidence.band import Band
from insemu.gap.hypothesis import Found, Hypothesis, class_of
from insemu.gap.policy import rules
from insemu.gap.problems.known_effects import of_axis
from insemu.gap.verdict import Finding, Member, Value, Where
from insemu.noise import BI, DR, GM, QN, RW, SIN, WN, NoiseModel, Process

VARYING = "vibration that changes with time"
#: Effects whose shape in time is known.
KNOWN_SHAPES = having("shape")
SLOW, FAST = having("slow"), having("fast")
#: What disturbs single samples or pieces of a log.
UNTIDY = having("samples")
#: Tests of the fast band; all others look at block means.
_FAST_TESTS = frozenset({"spectrum", "stationarity", "noise level over time", "tails"})
#: Effects that are read off the samples or go with a signal that was recorded beside them: nothing unexplained can stand in for them.
_PLAIN = having("evident")
_SENSORS = ("gyro", "accel")


def taken_out(w: Hypothesis[AxisState]) -> bool:
    """Whether an effect was taken out of the samples rather than added to the explanation."""
    if w.effect == "telegraph":
        return w.variant == "levels"
    return w.effect in having("drawn", "samples") or w.variant == "output counts"


@dataclass(frozen=True)
class AxisResult:
    """One axis: start, end, the effects between, and structure outside the catalogue that ended its search."""

    start: AxisState
    end: AxisState
    found: tuple[Found[AxisState], ...]
    outsider: str = ""

    def taken_out(self) -> tuple[str, ...]:
        """Effects that held-out data must have taken out of their samples too."""
        effects = (f.chosen.effect for f in self.found if taken_out(f.chosen))
        return tuple(e for e in effects if e not in ("quantization", "saturation"))


def is_doubtful(finding: Finding, failed: Sequence[Where], outsiders: Mapping[tuple[str, str], str]) -> bool:
    """Whether something that no candidate explains sits where a finding was named: the same axis, the same band.

    Parameters
    ----------
    finding : Finding
    failed : sequence of Where
        Tests that the final model fails.
    outsiders : mapping of (sensor, axis) to str
        Structure outside the catalogue, in words.
    """
    if finding.effect in _PLAIN or finding.variant in ("output counts", "levels"):
        return False
    axes = {(finding.sensor, a) for a in finding.axes or ("",)}
    fast = finding.effect in FAST or finding.effect in UNTIDY - {"telegraph"}
    if any(place in axes and (fast or what != VARYING) for place, what in outsiders.items()):
        return True
    return any(
        (w.sensor, w.axis) in axes and not w.statistic.startswith("cross_axis") and fast == (w.statistic in _FAST_TESTS)
        for w in failed
    )


def rejected(tests: Sequence[Where]) -> list[Where]:
    """The tests of a final model, corrected for their number, that it does not pass."""
    return [w for w in tests if w.p_value < rules().omnibus]


def remainder(failed: Sequence[Where], outsiders: Mapping[tuple[str, str], str]) -> str:
    """What is left unexplained, in words; empty where nothing is."""
    places: dict[str, list[str]] = {}
    for place, what in outsiders.items():
        places.setdefault(what, []).append(" ".join(place).strip())
    parts = [f"{what} on {', '.join(axes)}" for what, axes in places.items()]
    for w in failed:
        scale = f" at {w.scale_s:.3g} s" if w.scale_s is not None else ""
        parts.append(f"{w.statistic}{scale} on {w.sensor} {w.axis} (p {w.p_value:.1g})".replace("  ", " "))
    return "; ".join(parts)


def gaps_of(missing: NDArray[np.bool_]) -> tuple[Finding, ...]:
    """Samples that the stamps skip, as a finding: share of samples that start a gap, mean length of a gap."""
    lost = int(missing.sum())
    if not lost:
        return ()
    bursts = int(np.sum(missing[1:] & ~missing[:-1])) + int(missing[0])
    share, length = bursts / missing.size, lost / bursts
    sd = 1.0 / math.sqrt(bursts)
    burst = Value.normal("burst", length, length * sd, "1")
    values = (Value.positive("probability", share, sd, "1"), replace(burst, low=max(1.0, burst.low)))
    # every gap is seen in the stamps; against stamps that skip once in the whole log by accident
    nats = bursts * max(math.log(share * missing.size), 0.0) + 1.0
    if nats < rules().least_nats:
        return ()
    own = Member("dropped_samples", "imu", (), nats)
    return (Finding("dropped_samples", "time stamps", "imu", (), values, 1.0, nats, (own,)),)


def refined_model(result: AxisResult) -> NoiseModel:
    """The noise model of an axis with the stochastic effects that were found; deterministic ones are in the findings."""
    dt = result.end.data.dt
    believed = (c.process for c in result.end.explanation.components)
    processes: list[Process] = [p.autoregression(dt) if isinstance(p, Band) else p for p in believed]
    for f in result.found:
        given = {v.name: v.value for v in f.chosen.values}
        if f.chosen.effect == "vibration_line":
            processes.append(SIN(given["amplitude"], given["frequency"]))
        elif f.chosen.effect == "ramp":
            processes.append(DR(given["R"]))
        elif f.chosen.effect == "telegraph" and f.chosen.variant == "levels":
            # the second-order twin: what a linear filter can carry of it
            processes.append(GM(given["amplitude"], 2.0 * given["rate"]))
    return NoiseModel(tuple(processes))


def split_axis(name: str) -> tuple[str, str]:
    """Sensor and axis of a column name: ``gyro_x`` -> ``("gyro", "x")``; other names are their own sensor."""
    sensor, _, axis = name.rpartition("_")
    return (sensor, axis) if sensor in _SENSORS and axis in "xyz" else (name, "")


def would_separate(effects: Collection[str], duration_s: float) -> str:
    """The recording that would tell a class apart, in words."""
    names = set(effects)
    if len(names) < 2:
        return ""
    seconds = 10.0 * duration_s
    longer = f"{seconds / 3600.0:.3g} h" if seconds >= 3600.0 else f"{seconds / 60.0:.3g} min"
    if "temperature" in names:
        return "a log in which the temperature goes up and down again, so that it does not run along with time"
    if names <= SLOW:
        return (
            f"a static log of at least {longer} (ten times as long): the processes part at the longest averaging times"
        )
    if names <= FAST:
        return (
            "a log at a higher sampling rate, or without the output filter: the processes part above the present band"
        )
    return f"a static log at a higher rate and of at least {longer}"


def _shapes(items: Sequence[tuple[str, Found[AxisState], AxisResult]]) -> str:
    """Shape of an effect; where axes differ, with the axes of each."""
    by_shape: dict[str, list[str]] = {}
    for axis, f, _ in items:
        by_shape.setdefault(f.chosen.variant, []).append(axis)
    if len(by_shape) == 1:
        return next(iter(by_shape))
    return ", ".join(f"{shape or 'plain'} ({' '.join(axes)})" for shape, axes in by_shape.items())


def merged(results: Mapping[str, AxisResult]) -> tuple[Finding, ...]:
    """Findings of all axes; the same effect on several axes of a sensor is one finding, with a parameter set per axis.

    A second process of the same kind on an axis is a finding of its own.
    """
    groups: dict[tuple[str, str, int], list[tuple[str, Found[AxisState], AxisResult]]] = {}
    for name, r in results.items():
        sensor, axis = split_axis(name)
        seen: dict[str, int] = {}
        for f in r.found:
            occurrence = seen[f.chosen.effect] = seen.get(f.chosen.effect, 0) + 1
            groups.setdefault((f.chosen.effect, sensor, occurrence), []).append((axis, f, r))
    findings = []
    for (effect, sensor, _), items in groups.items():
        axes = tuple(dict.fromkeys(a for a, _, _ in items if a))
        values = tuple(
            replace(v, name=v.name if len(items) == 1 or not a else f"{v.name}_{a}")
            for a, f, _ in items
            for v in f.chosen.values
        )
        # a rival explains the finding only where it stands in for it on every axis; what it is worth there adds up
        names = set.intersection(*({w.effect for w in f.ranked} for _, f, _ in items)) - {effect}
        nats = {n: sum(w.nats for _, f, _ in items for w in f.ranked if w.effect == n) for n in names}
        nats[effect] = sum(f.chosen.nats for _, f, _ in items)
        rivals = [Member(n, sensor, axes, g) for n, g in sorted(nats.items(), key=lambda item: (-item[1], item[0]))]
        own = next(k for k, m in enumerate(rivals) if m.effect == effect)
        members, others, confidence = class_of(rivals, own)
        duration = items[0][2].start.data.duration_s
        findings.append(
            Finding(
                effect, _shapes(items), sensor, axes, values, confidence, nats[effect], members,
                would_separate([m.effect for m in members], duration), others,
            )
        )  # fmt: skip
    return tuple(sorted(findings, key=lambda s: -s.nats))


# -- of a drive ---------------------------------------------------------------------------------------------------------------------


def with_process(model: NoiseModel, effect: str, given: Mapping[str, float]) -> NoiseModel:
    """A model with a slow process of a named effect.

    Parameters
    ----------
    model : NoiseModel
        The noise of the axis.
    effect : str
        ``random_walk``, ``gauss_markov`` or ``flicker``.
    given : mapping of str to float
        Parameters of the process, SI: ``K``; ``sigma`` and ``beta``; ``B``.
    """
    if effect == "random_walk":
        return model + RW(given["K"])
    return model + (GM(given["sigma"], given["beta"]) if effect == "gauss_markov" else BI(given["B"]))


def unknown_part(finding: Finding, known: Sequence[EffectUse]) -> Finding | None:
    """A finding that was read off the samples, less the axes of which it is known; ``None`` where it is known of all."""
    if finding.sensor not in ("gyro", "accel"):
        return None if finding.effect in {use.id for use in known} else finding
    new = [
        k
        for k, a in enumerate(finding.axes)
        if finding.effect not in {use.id for use in of_axis(known, f"{finding.sensor}_{a}")}
    ]
    if not new:
        return None
    if len(new) == len(finding.axes):
        return finding
    return replace(
        finding, axes=tuple(finding.axes[k] for k in new), parameters=tuple(finding.parameters[k] for k in new)
    )


def joined(findings: list[Finding]) -> list[Finding]:
    """Findings of one effect that share a number as one: their values are those of everything together already."""
    out: list[Finding] = []
    for s in findings:
        own = {v.name: v.value for v in s.parameters}
        k = next(
            (k for k, o in enumerate(out) if (o.effect, o.sensor) == (s.effect, s.sensor) and _shares(o, own)), None
        )
        if k is None:
            out.append(s)
            continue
        first = out[k]
        known = {v.name for v in first.parameters}
        out[k] = replace(
            first,
            axes=tuple(dict.fromkeys((*first.axes, *s.axes))),
            parameters=(*first.parameters, *(v for v in s.parameters if v.name not in known)),
            nats=first.nats + s.nats,
            metres=math.hypot(first.metres, s.metres),
        )
    return out


def _shares(finding: Finding, numbers: Mapping[str, float]) -> bool:
    """Whether a finding has some of these numbers by name, and the same values of all of those."""
    both = [math.isclose(v.value, numbers[v.name], rel_tol=1e-9) for v in finding.parameters if v.name in numbers]
    return bool(both) and all(both)


def with_effect(models: dict[str, NoiseModel], finding: Finding) -> dict[str, NoiseModel]:
    """The beliefs with a stochastic effect added to its axes."""
    if finding.sensor not in ("gyro", "accel"):
        return models
    out = dict(models)
    given = {v.name: v.value for v in finding.parameters}
    for axis in finding.axes:
        name = f"{finding.sensor}_{axis}"

        def value(key: str, axis: str = axis) -> float:
            return given[key] if key in given else given[f"{key}_{axis}"]

        if finding.effect in PROCESSES:
            parameters = {p.name for p in EFFECTS[finding.effect].parameters}
            out[name] = with_process(out[name], finding.effect, {key: value(key) for key in parameters})
        elif finding.effect == "quantization" and finding.variant == "integrated":
            out[name] = out[name] + QN(value("Q"))
        elif finding.effect == "white_noise":
            out[name] = NoiseModel(tuple(WN(value("N")) if isinstance(p, WN) else p for p in out[name]))
    return out
