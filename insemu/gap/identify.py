"""The one door: a nominal model and what was measured, whichever kind it is."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from insemu import rotation
from insemu.errors import InputError
from insemu.gap.known import drive_without, finite, static_without
from insemu.gap.nominal import Nominal
from insemu.gap.refined import joined, refined_nominal, uses_of
from insemu.gap.sources import StaticLog
from insemu.gap.static_log import THRESHOLD, find_static_gap
from insemu.gap.timing import find_offset
from insemu.gap.vehicle import Mounted, find_mounting
from insemu.gap.verdict import GapReport, Interval, Step, Value, VerdictName
from insemu.noise import NoiseModel
from insemu.records import AXES, Recording

#: Passes in which effects too large for a linear signature are taken off and estimated again.
MOST_PASSES = 3
#: Smallest value of an effect that is taken off before the rest is looked for, by effect and parameter.
LARGE = {
    "imu_gnss_time_offset": 0.02,
    "scale_factor": 0.01,
    "scale_asymmetry": 0.01,
    "misalignment": 0.01,
}


def find_gap(
    measured: StaticLog | Recording,
    nominal: Nominal,
    *,
    rng: np.random.Generator,
    threshold: float = THRESHOLD,
    without: Collection[str] = (),
    hold_out: bool = True,
    progress: Callable[[str], None] | None = None,
) -> GapReport:
    """Find, name and add what the nominal model lacks.

    What the nominal model knows besides noise is taken off first. A drive with a ``vehicle`` is asked for its mounting angles; effects
    too large for a linear signature are taken off and the search is repeated, until what is left is small.

    Parameters
    ----------
    measured : StaticLog or Recording
        A log at rest, or a drive or flight with fixes.
    nominal : Nominal
        What is believed.
    rng : Generator
        For simulated nominal data.
    threshold : float
        Nats that an effect must be worth.
    without : collection of str
        Effects taken out of the catalogue.
    hold_out : bool
        Whether to score on data that was not used for naming.
    progress : callable, optional
        Told what is being done.

    Raises
    ------
    InputError
        Data or beliefs that cannot be used.
    """
    nominal = nominal.parted()
    if isinstance(measured, StaticLog):
        log, known = static_without(measured, nominal)
        return find_static_gap(
            log.axes,
            nominal.beliefs,
            rng=rng,
            temperature=measured.temperature,
            threshold=threshold,
            without=without,
            hold_out=hold_out,
            source=measured.source,
            progress=progress,
            known=known,
        )
    return _drive(measured, nominal, rng, threshold, without, hold_out, progress or (lambda _: None))


@dataclass(frozen=True)
class _Pass:
    """One pass: what was found with some effects taken off."""

    mounted: Mounted | None
    report: GapReport
    large: tuple[Step, ...]


def _drive(
    measured: Recording,
    nominal: Nominal,
    rng: np.random.Generator,
    threshold: float,
    without: Collection[str],
    hold_out: bool,
    say: Callable[[str], None],
) -> GapReport:
    from insemu.gap.dynamic import find_dynamic_gap

    now = nominal
    passes: list[_Pass] = []
    early: list[Step] = []
    check(measured, nominal)
    if "imu_gnss_time_offset" not in without:
        late = find_offset(*drive_without(measured, now), say)
        if late is not None:
            early.append(late)
            now = replace(now, effects=joined(now.effects, uses_of(late)))
    for turn in range(MOST_PASSES):
        recording, moved = drive_without(measured, now)
        mounted = None
        if now.vehicle is not None and "mounting" not in without:
            mounted = find_mounting(recording, moved, threshold, say)
            if mounted.step is not None:
                now = replace(now, effects=joined(now.effects, uses_of(mounted.step)))
                recording, moved = drive_without(measured, now)
        skip = (*without, *(() if "mounting" in without else ("mounting",)))
        report = find_dynamic_gap(
            recording, moved, rng=rng, threshold=threshold, without=skip, hold_out=hold_out, progress=say
        )
        large = tuple(s for s in report.steps if _is_large(s)) if turn < MOST_PASSES - 1 else ()
        passes.append(_Pass(mounted, report, large))
        if not large:
            break
        say("taking off what is too large for a linear signature")
        for step in large:
            now = replace(now, effects=joined(now.effects, uses_of(step, measured.imu.dt)))
    out = _together(passes, early, nominal, measured)
    return replace(out, curves={**out.curves, "drive": _pictures(measured, nominal, out)}) if hold_out else out


def _is_large(step: Step) -> bool:
    limit = LARGE.get(step.effect)
    return limit is not None and any(abs(v.value) > limit for v in step.parameters) and not step.is_class


def check(measured: Recording, nominal: Nominal) -> None:
    """Raise ``InputError`` where a belief is missing or there are no fixes."""
    missing = [a for a in AXES if a not in nominal.beliefs]
    if missing:
        raise InputError(
            f"no noise model is believed for {', '.join(missing)}; a recording with fixes needs all six axes"
        )
    if measured.gnss is None:
        raise InputError("has no GNSS fixes, expected a drive or flight with fixes or a static log", where=measured.source)


def _together(passes: list[_Pass], early: list[Step], nominal: Nominal, measured: Recording) -> GapReport:
    """One report of all passes: what was taken off on the way and what the last one found."""
    first, last = passes[0], passes[-1]
    steps = list(last.report.steps)
    for step in (*early, *(step for p in passes[:-1] for step in p.large)):
        steps = _added_up(steps, step)
    mountings = [p.mounted for p in passes if p.mounted is not None and p.mounted.step is not None]
    if mountings:
        steps.append(_one_mounting(mountings))
    steps.sort(key=lambda s: -s.gain_nats)
    where, after = first.report.where, last.report.after
    before_index, after_index, held = first.report.gap_before, last.report.gap_after, last.report.held_out
    if len(passes) > 1:
        held = _sum([p.report.held_out for p in passes])
    met = next((p.mounted for p in passes if p.mounted is not None), None)
    if met is not None:
        end = next(p.mounted for p in reversed(passes) if p.mounted is not None)
        where = tuple(sorted((*where, *met.where), key=lambda w: w.p_value))
        after = tuple(sorted((*after, *end.after), key=lambda w: w.p_value))
        if met.dof and math.isfinite(before_index.value):
            fixes = met.dof / 2
            gain, sd = met.gain
            held = _sum([held, Interval(gain / fixes, (gain - 1.96 * sd) / fixes, (gain + 1.96 * sd) / fixes)])
            # the motion across the vehicle and the innovations count alike
            before_index = _mean(before_index, met.chi_square[0] / met.dof, met.dof)
            after_index = _mean(after_index, (end.chi_square if end.dof else met.chi_square)[1] / met.dof, met.dof)
    verdict: VerdictName = last.report.verdict
    if verdict == "nothing missing" and steps:
        verdict = "class" if steps[0].is_class else "named"
    refined = {name: _as_believed(last.report.refined[name], nominal.beliefs[name], measured) for name in last.report.refined}
    return replace(
        last.report,
        verdict=verdict,
        steps=tuple(steps),
        where=where,
        after=after,
        gap_before=before_index,
        gap_after=after_index,
        held_out=held,
        nominal=dict(nominal.beliefs),
        refined=refined,
    )


def _as_believed(refined: NoiseModel, believed: NoiseModel, measured: Recording) -> NoiseModel:
    """A refined model with the processes that only the filter needed turned back into what was believed."""
    span = float(measured.imu.t[-1] - measured.imu.t[0])
    carried = finite(believed, measured.imu.dt, span)
    made = [p for p in carried if p not in set(believed)]
    gone = [p for p in believed if p not in set(carried)]
    return NoiseModel((*(p for p in refined if p not in made), *gone)) if made else refined


def _added_up(steps: list[Step], earlier: Step) -> list[Step]:
    """The steps with what an earlier pass took off added: to the same effect where it was found again, else as its own."""
    out = []
    used = False
    for s in steps:
        if not used and (s.effect, s.sensor) == (earlier.effect, earlier.sensor):
            known = {v.name: v.value for v in earlier.parameters}
            values = tuple(_shifted(v, known.get(v.name, 0.0)) for v in s.parameters)
            rest = tuple(v for v in earlier.parameters if v.name not in {x.name for x in values})
            axes = tuple(dict.fromkeys((*s.axes, *earlier.axes)))
            out.append(replace(s, parameters=(*values, *rest), axes=axes, gain_nats=earlier.gain_nats))
            used = True
        else:
            out.append(s)
    return out if used else [*out, earlier]


def _shifted(v: Value, by: float) -> Value:
    return Value(v.name, v.value + by, v.low + by, v.high + by, v.unit)


def _one_mounting(found: list[Mounted]) -> Step:
    """Mounting angles of all passes as one."""
    C = np.eye(3)
    for m in found:
        C = rotation.dcm_from_rpy(m.rpy) @ C
    step, last = found[0].step, found[-1].step
    assert step is not None and last is not None
    rpy = rotation.rpy_from_dcm(C)
    values = []
    for k, v in enumerate(last.parameters):
        half = 0.5 * (v.high - v.low)
        values.append(Value(v.name, float(rpy[k]), float(rpy[k]) - half, float(rpy[k]) + half, v.unit))
    return replace(step, parameters=tuple(values))


def _sum(items: list[Interval]) -> Interval:
    some = [i for i in items if math.isfinite(i.value)]
    if not some:
        return items[0]
    value = sum(i.value for i in some)
    half = math.sqrt(sum((0.5 * (i.high - i.low)) ** 2 for i in some))
    return Interval(value, value - half, value + half)


def _mean(index: Interval, other: float, dof: int) -> Interval:
    half = math.hypot(0.5 * (index.high - index.low), 1.96 * math.sqrt(2.0 / dof) * other) / 2.0
    value = 0.5 * (index.value + other)
    return Interval(value, value - half, value + half)


def _pictures(measured: Recording, nominal: Nominal, report: GapReport) -> dict[str, Any]:
    """Whitened innovations of the nominal and of the refined model: what the page draws before and after."""
    from insemu.gap.preparation import fast_parts, prepare
    from insemu.gap.signatures import Loop
    from insemu.gap.vehicle import Sideways

    out: dict[str, Any] = {}
    models = {"before": nominal, "after": refined_nominal(nominal, report, measured.imu.dt).parted()}
    for name, model in models.items():
        recording, moved = drive_without(measured, model)
        prepared = prepare(recording, moved, fast_parts(recording), {})
        loop = Loop.of(prepared.result)
        y = np.where(loop.use, loop.y.reshape(-1, 6), np.nan)
        out[name] = {"t": prepared.result.fixes.t, "y": y}
        if nominal.vehicle is not None:
            s = Sideways.of(prepared)
            out[name]["across"] = (s.t, s.u)
    return out


