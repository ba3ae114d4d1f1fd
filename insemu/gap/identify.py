"""The one door: a nominal model and what was measured, whichever kind it is."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any

import numpy as np

from insemu.errors import InputError
from insemu.gap.known import drive_without, static_without
from insemu.gap.nominal import Nominal
from insemu.gap.refined import joined, refined_nominal, uses_of
from insemu.gap.sources import StaticLog
from insemu.gap.static_log import THRESHOLD, find_static_gap
from insemu.gap.timing import find_offset
from insemu.gap.vehicle import Mounted, find_mounting
from insemu.gap.verdict import GapReport, Interval, Step, Value, VerdictName
from insemu.records import AXES, Recording


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

    What the nominal model knows besides noise is taken off first; so are a time offset too large for a linear signature and, where the nominal
    model has a ``vehicle``, wrong mounting angles.

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
            missing=measured.missing,
            threshold=threshold,
            without=without,
            hold_out=hold_out,
            source=measured.source,
            progress=progress,
            known=known,
        )
    return _drive(measured, nominal, rng, threshold, without, hold_out, progress or (lambda _: None))


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

    check(measured, nominal)
    now = nominal
    early: list[Step] = []

    def taken(step: Step) -> Nominal:
        early.append(step)
        return replace(now, effects=joined(now.effects, uses_of(step)))

    if "imu_gnss_time_offset" not in without:
        late = find_offset(*drive_without(measured, now), say)
        now = taken(late) if late is not None else now
    recording, moved = drive_without(measured, now)
    mounted = None
    if now.vehicle is not None and "mounting" not in without:
        mounted = find_mounting(recording, moved, threshold, say)
        if mounted.step is not None:
            now = taken(mounted.step)
            recording, moved = drive_without(measured, now)
    # by the innovations alone the mounting hides in the attitude
    skip = tuple(dict.fromkeys((*without, "mounting")))
    report = find_dynamic_gap(
        recording, moved, rng=rng, threshold=threshold, without=skip, hold_out=hold_out, progress=say
    )
    out = _together(report, early, mounted, nominal)
    return replace(out, curves={**out.curves, "drive": _pictures(measured, nominal, out)}) if hold_out else out


def check(measured: Recording, nominal: Nominal) -> None:
    """Raise ``InputError`` where a belief is missing or there are no fixes."""
    missing = [a for a in AXES if a not in nominal.beliefs]
    if missing:
        raise InputError(
            f"no noise model is believed for {', '.join(missing)}; a recording with fixes needs all six axes"
        )
    if measured.gnss is None:
        raise InputError(
            "has no GNSS fixes, expected a drive or flight with fixes or a static log", where=measured.source
        )


def _together(report: GapReport, early: list[Step], mounted: Mounted | None, nominal: Nominal) -> GapReport:
    """The report of the search with what was taken off before it."""
    steps = list(report.steps)
    for step in early:
        steps = _added_up(steps, step)
    steps.sort(key=lambda s: -s.gain_nats)
    where, after, held = report.where, report.after, report.held_out
    before_index, after_index = report.gap_before, report.gap_after
    if mounted is not None:
        where = tuple(sorted((*where, *mounted.where), key=lambda w: w.p_value))
        after = tuple(sorted((*after, *mounted.after), key=lambda w: w.p_value))
        if mounted.dof and math.isfinite(before_index.value):
            fixes = mounted.dof / 2
            gain, sd = mounted.gain
            held = _sum([held, Interval(gain / fixes, (gain - 1.96 * sd) / fixes, (gain + 1.96 * sd) / fixes)])
            # the motion across the vehicle and the innovations count alike
            before_index = _mean(before_index, mounted.chi_square[0] / mounted.dof, mounted.dof)
            after_index = _mean(after_index, mounted.chi_square[1] / mounted.dof, mounted.dof)
    verdict: VerdictName = report.verdict
    if verdict == "nothing missing" and steps:
        verdict = "class" if steps[0].is_class else "named"
    return replace(
        report,
        verdict=verdict,
        steps=tuple(steps),
        where=where,
        after=after,
        gap_before=before_index,
        gap_after=after_index,
        held_out=held,
        nominal=dict(nominal.beliefs),
    )


def _added_up(steps: list[Step], earlier: Step) -> list[Step]:
    """The steps with what was taken off before: added to the same effect where it was found again, else as its own."""
    known = {v.name: v.value for v in earlier.parameters}
    for k, s in enumerate(steps):
        if (s.effect, s.sensor) == (earlier.effect, earlier.sensor):
            values = tuple(_shifted(v, known.get(v.name, 0.0)) for v in s.parameters)
            both = replace(s, parameters=values, gain_nats=s.gain_nats + earlier.gain_nats)
            return [*steps[:k], both, *steps[k + 1 :]]
    return [*steps, earlier]


def _shifted(v: Value, by: float) -> Value:
    return Value(v.name, v.value + by, v.low + by, v.high + by, v.unit)


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
    parts = fast_parts(measured)
    for name, model in models.items():
        recording, moved = drive_without(measured, model)
        prepared = prepare(recording, moved, parts, {})
        loop = Loop.of(prepared.result)
        y = np.where(loop.use, loop.y.reshape(-1, 6), np.nan)
        out[name] = {"t": prepared.result.fixes.t, "y": y}
        if nominal.vehicle is not None:
            s = Sideways.of(prepared)
            out[name]["across"] = (s.t, s.u)
    return out
