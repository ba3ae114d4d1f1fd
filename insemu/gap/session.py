"""The one door: a nominal model and what was measured, whichever kind it is."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any

import numpy as np

from insemu import rotation
from insemu.blas import on_one_thread
from insemu.effects import adds, join_of, joined
from insemu.errors import InputError
from insemu.gap.beliefs.nominal import Nominal
from insemu.gap.beliefs.refined import refined_nominal, uses_of
from insemu.gap.candidates.mounting import Mounted, find_mounting
from insemu.gap.candidates.shapes import EQUATIONS
from insemu.gap.candidates.signs import check_signs
from insemu.gap.candidates.timing import find_times
from insemu.gap.data.sources import StaticLog
from insemu.gap.drive.preparation import Flown, Prepared
from insemu.gap.holdout import scored
from insemu.gap.policy import Policy, rules, under
from insemu.gap.problems.aids import AidReport, check_aids, find_aid_effects
from insemu.gap.problems.findings import with_effect
from insemu.gap.problems.joint_estimate import MOST_TURNS, gauss_newton_step
from insemu.gap.problems.known_effects import all_outliers, drive_without, in_imu_axes, static_without, struck_out
from insemu.gap.problems.rest import find_static_gap
from insemu.gap.verdict import Finding, GapReport, judged, with_half_sample, with_held_out
from insemu.gap.worth import worth_of_early, worth_of_mounting
from insemu.prepared import left_out
from insemu.records import AXES, Recording

#: How often the search of a drive runs once more about what is strong, at the most.
MOST_PASSES = 2


@on_one_thread
def find_gap(
    measured: StaticLog | Recording,
    nominal: Nominal,
    *,
    rng: np.random.Generator,
    without: Collection[str] = (),
    hold_out: bool = True,
    pictures: bool = True,
    progress: Callable[[str], None] | None = None,
    flown: Flown | None = None,
    policy: Policy | None = None,
    pool: Executor | None = None,
) -> GapReport:
    """Find, name and add what the nominal model lacks.

    What the nominal model knows besides noise is taken off first; so are a time offset too large for a linear signature and, where the nominal
    model has a ``vehicle``, wrong mounting angles. A recording that was prepared (``solved.npz``) is looked at as it was measured.

    Parameters
    ----------
    measured : StaticLog or Recording
        A log at rest, or a drive or flight with fixes.
    nominal : Nominal
        What is believed.
    rng : Generator
        For simulated nominal data.
    without : collection of str
        Effects taken out of the catalogue.
    hold_out : bool
        Whether to score on data that was not used for naming.
    pictures : bool
        Whether to work out what the page draws of a drive before and after.
    progress : callable, optional
        Told what is being done.
    flown : Flown, optional
        The nominal filter's run on a drive or flight, where it is there already; of a nominal model in whose ``effects`` there is nothing.
    policy : Policy, optional
        The constants of the search; those in force where it is not given.
    pool : Executor, optional
        One process of it scores on held-out fixes of a drive or flight, while this one goes on; the answer is the same.

    Raises
    ------
    InputError
        Data or beliefs that cannot be used.
    """
    believed, assumed = nominal.parted(), tuple[str, ...]()
    if isinstance(measured, Recording):
        believed, drive = believed.on(measured)
        measured = drive.measured  # what was taken off beforehand is a finding
        assumed = tuple(dict.fromkeys((*drive.said, *measured.remarks)))
    with under(policy):
        report = _find(measured, believed, rng, without, hold_out, pictures, progress or (lambda _: None), flown, pool)
    return replace(report, assumed=(*assumed, *report.assumed))


def _find(
    measured: StaticLog | Recording,
    nominal: Nominal,
    rng: np.random.Generator,
    without: Collection[str],
    hold_out: bool,
    pictures: bool,
    progress: Callable[[str], None],
    flown: Flown | None,
    pool: Executor | None,
) -> GapReport:
    if isinstance(measured, StaticLog):
        log, known = static_without(measured, nominal)
        report = find_static_gap(
            log.axes,
            nominal.beliefs,
            rng=rng,
            temperature=measured.temperature,
            missing=measured.missing,
            without=without,
            hold_out=hold_out,
            source=measured.source,
            progress=progress,
            known=known,
        )
    else:
        report = _drive(
            measured,
            nominal,
            rng,
            without,
            hold_out,
            hold_out and pictures,
            progress,
            flown,
            pool,
        )
    return with_held_out(report)


def _drive(
    measured: Recording,
    nominal: Nominal,
    rng: np.random.Generator,
    without: Collection[str],
    hold_out: bool,
    pictures: bool,
    say: Callable[[str], None],
    flown: Flown | None,
    pool: Executor | None,
) -> GapReport:
    from insemu.gap.problems.drive import find_dynamic_gap

    check(measured, nominal)
    now = nominal
    early: list[Finding] = []

    def taken(finding: Finding) -> Nominal:
        early.append(finding)
        return replace(now, effects=joined(now.effects, uses_of(finding)))

    say("running the nominal filter")
    first = flown = flown or Flown.of(*drive_without(measured, now))
    recording, moved = first.recording, first.nominal
    check_signs(first, say)
    for late in find_times(first, without, say):
        now, flown = taken(replace(late, metres=worth_of_early(first.prepared, late))), None
    if early:
        recording, moved = drive_without(measured, now)
    mounted = None
    if now.vehicle is not None and "mounting" not in without:
        mounted = find_mounting(recording, moved, say)
        if mounted.finding is not None:
            worth = worth_of_mounting(first.prepared, mounted.finding)
            now, flown = taken(replace(mounted.finding, metres=worth)), None
            recording, moved = drive_without(measured, now)
    if recording.aids:
        flown = flown or Flown.of(recording, moved)
        check_aids(flown.prepared, flown.recording.aids, measured.source)
    # by the innovations alone the mounting hides in the attitude
    skip = tuple(dict.fromkeys((*without, "mounting")))
    own_axes = in_imu_axes(recording, moved)
    if own_axes[0] is not recording:
        (recording, moved), flown = own_axes, None
    scores = pool if hold_out else None
    report, held_out = find_dynamic_gap(
        recording, moved, rng=rng, without=skip, progress=say, flown=flown, came=first if early else None, pool=scores
    )
    known = struck_out(drive_without(measured, now, {})[0], recording)
    report = replace(report, outliers=all_outliers(measured, known, report.outliers))
    out = _with_early(report, early, mounted, nominal)
    assert measured.gnss is not None
    out = replace(out, assumed=left_out(measured.imu, measured.gnss, float(first.prepared.imu.t[0])))

    def search(recording: Recording, moved: Nominal) -> GapReport:
        return find_dynamic_gap(recording, moved, rng=rng, without=skip, progress=say)[0]

    out, refined = _further_passes(measured, nominal, out, search, [s.effect for s in early], say)
    if mounted is not None and len(out.findings) > (mounted.finding is not None):
        flown_as = refined or _refined(measured, nominal, out)
        out, refined = _mounted_again(out, flown_as, mounted, first.prepared, say), None
    out = replace(out, findings=tuple(with_half_sample(s, measured.imu) for s in out.findings))
    if hold_out:
        say("scoring on held-out fixes")
        out = scored(out, held_out(), mounted, early)
    if not (pictures or measured.aids):
        return out
    after = Flown.of(*(refined or _refined(measured, nominal, out))) if out.findings else first
    if measured.aids:
        out = _with_aids(out, find_aid_effects(after.prepared, after.recording.aids, without, say, hold_out=hold_out))
    if not pictures:
        return out
    return replace(out, curves={**out.curves, "drive": _pictures(first, after, nominal)})


def _with_aids(report: GapReport, looked: AidReport) -> GapReport:
    """A report with what was found of the aids behind what IMU and fixes show: these are not judged by aids."""
    alone = report.verdict == "nothing missing" and looked.findings
    return replace(
        report,
        verdict=judged(looked.findings, "") if alone else report.verdict,
        findings=(*report.findings, *looked.findings),
        aids_held_out=looked.held_out,
        where=tuple(sorted((*report.where, *looked.where), key=lambda w: w.p_value)),
        after=tuple(sorted((*report.after, *looked.after), key=lambda w: w.p_value)),
    )


def _mounted_again(
    report: GapReport,
    refined: tuple[Recording, Nominal],
    mounted: Mounted,
    prepared: Prepared,
    say: Callable[[str], None],
) -> GapReport:
    """A report whose mounting angles are those that the filter shows when it flies everything that was found.

    They were estimated before the search, against a heading that a drifting clock or a scale factor moved.
    """
    before = next((s for s in report.findings if s.effect == "mounting"), None)
    more = find_mounting(*refined, say, known=before is not None)
    if more.finding is None:
        return report
    finding = more.finding
    if before is not None:
        turned = rotation.dcm_from_rpy(more.rpy) @ rotation.dcm_from_rpy([v.value for v in before.parameters])
        angles = zip(finding.parameters, rotation.rpy_from_dcm(turned), strict=True)
        finding = replace(before, parameters=tuple(v.shifted(float(angle) - v.value) for v, angle in angles))
    finding = replace(finding, metres=worth_of_mounting(prepared, finding))
    findings = sorted([*(s for s in report.findings if s is not before), finding], key=lambda s: -s.nats)
    after = [w for w in report.after if w not in mounted.after]
    return replace(
        report, findings=tuple(findings), after=tuple(sorted((*after, *more.after), key=lambda w: w.p_value))
    )


def _further_passes(
    measured: Recording,
    nominal: Nominal,
    report: GapReport,
    search: Callable[[Recording, Nominal], GapReport],
    early: Collection[str],
    say: Callable[[str], None],
) -> tuple[GapReport, tuple[Recording, Nominal] | None]:
    """A report after further passes about what is strong, and the recording with its nominal model less all of it where the last pass flew that.

    A pass corrects what the one before left, which is less each time. Where it is more, the correction before led astray and is taken back.
    """
    before, worth = report, _bending(report.findings)
    for turn in range(MOST_PASSES):
        if not _bends(report.findings):
            return report, None
        report, refined = _joint_estimate(measured, nominal, report, say)
        say(f"the refined model against the recording, {turn + 1}")
        more = search(*in_imu_axes(*refined))
        corrected = _merged_pass(report, more, early)
        if corrected is report:
            return report, refined
        corrected = replace(corrected, outliers=all_outliers(measured, report.outliers, more.outliers))
        remains = _bending(more.findings)
        if remains > worth + rules().lead:
            say("the correction before is taken back: it left more than there was")
            return before, None
        before, report, worth = report, corrected, remains
    return _joint_estimate(measured, nominal, report, say) if _bends(report.findings) else (report, None)


def _joint_estimate(
    measured: Recording, nominal: Nominal, report: GapReport, say: Callable[[str], None]
) -> tuple[GapReport, tuple[Recording, Nominal]]:
    """A report whose numbers are those of all its effects at once, and the recording with its nominal model less all of it.

    Steps that no longer explain more end it; a step after which more is left than before is taken back.
    """
    now = _refined(measured, nominal, report)
    before, gain = (report, now), math.inf
    try:
        for _ in range(MOST_TURNS):
            step = gauss_newton_step(*in_imu_axes(*now), report.findings)
            say(f"all numbers together: {step.gain:.1f} nats")
            if step.gain > gain:
                return before
            if step.gain < rules().lead:
                break
            before, gain = (report, now), step.gain
            report = replace(report, findings=tuple(s for s in map(_pruned, step.findings) if s is not None))
            now = _refined(measured, nominal, report)
    except InputError:  # no filter runs on a recording less these numbers
        return before
    # which fixes are outliers is estimated again next to the new numbers
    again = drive_without(measured, _refined_nominal(measured, nominal, report))
    gone = struck_out(_refined(measured, nominal, replace(report, outliers={}))[0], again[0])
    return replace(report, outliers=gone), again


def _refined(measured: Recording, nominal: Nominal, report: GapReport) -> tuple[Recording, Nominal]:
    """A recording less what is known and what was found in it, and the nominal model as it is then."""
    return drive_without(measured, _refined_nominal(measured, nominal, report), report.outliers)


def _refined_nominal(measured: Recording, nominal: Nominal, report: GapReport) -> Nominal:
    return refined_nominal(nominal, report, measured.imu.dt).parted()


def _bending(findings: Sequence[Finding]) -> float:
    """What effects of the fixes and of timing are worth together, nats: strong ones lead a filter astray, in which the rest was seen."""
    return sum(s.nats for s in findings if s.sensor in ("gnss", "imu"))


def _bends(findings: Sequence[Finding]) -> bool:
    """Whether effects of the fixes and of timing are so strong that it is looked again."""
    return _bending(findings) >= rules().strong_nats


def applied(report: GapReport, which: Sequence[int]) -> GapReport:
    """The report with some of its findings only, by the numbers under which they are shown: what the refined model is then written from.

    Parameters
    ----------
    report : GapReport
    which : sequence of int
        Numbers as of :meth:`GapReport.numbered`.

    Raises
    ------
    InputError
        A number that is no finding's.
    """
    wrong = [n for n in which if not 1 <= n <= len(report.findings)]
    if wrong:
        raise InputError(f"there is no finding {wrong[0]}, expected 1 to {len(report.findings)}", where="--apply")
    return with_only(report, [f for n, f in report.numbered() if n in which])


def with_only(report: GapReport, findings: Collection[Finding]) -> GapReport:
    """The report with some of its findings only, in its own order."""
    findings = tuple(f for f in report.findings if any(f is g for g in findings))
    refined = dict(report.nominal)
    for finding in findings:
        refined = with_effect(refined, finding)
    return replace(report, findings=findings, refined=refined)


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


def _with_early(report: GapReport, early: list[Finding], mounted: Mounted | None, nominal: Nominal) -> GapReport:
    """The report of the search with what was taken off before it."""
    findings = list(report.findings)
    for finding in early:
        findings = _added_up(findings, finding)
    findings.sort(key=lambda s: -s.nats)
    where, after = report.where, report.after
    if mounted is not None:
        where = tuple(sorted((*where, *mounted.where), key=lambda w: w.p_value))
        after = tuple(sorted((*after, *mounted.after), key=lambda w: w.p_value))
    return replace(
        report,
        verdict=judged(findings, report.remainder, [s.effect for s in early]),
        findings=tuple(findings),
        where=where,
        after=after,
        nominal=dict(nominal.beliefs),
    )


def _added_up(findings: list[Finding], earlier: Finding) -> list[Finding]:
    """The findings with what was taken off before: added to the same effect where it was found again, else as its own."""
    known = {v.name: v.value for v in earlier.parameters}
    for k, s in enumerate(findings):
        if (s.effect, s.sensor) == (earlier.effect, earlier.sensor):
            values = tuple(v.shifted(known.get(v.name, 0.0)) for v in s.parameters)
            # a doubt about the little that was found again is none about what was early
            both = replace(
                s, parameters=values, nats=s.nats + earlier.nats, confidence=max(s.confidence, earlier.confidence),
                doubtful=earlier.doubtful, members=earlier.members, metres=_larger(s.metres, earlier.metres),
            )  # fmt: skip
            return [*findings[:k], both, *findings[k + 1 :]]
    return [*findings, earlier]


def _merged_pass(report: GapReport, more: GapReport, early: Collection[str]) -> GapReport:
    """A report with what the recording still says once its effects are known; the same object where that is nothing new."""
    findings = list(report.findings)
    changed = False
    for m in [part for f in more.findings for part in _by_owner(f, report.findings)]:
        if _is_level(m):
            findings, changed = _multiplied(findings, m), True
            continue
        alike = [i for i, s in enumerate(findings) if _same_effect(s, m)]
        k = next((i for i in alike if _share(findings[i], m)), alike[0] if alike else None)
        if k is None and m.sensor not in ("gnss", "imu") and not adds(m.effect):
            continue  # what the IMU shows above its motion was searched once; more of it would only chase what changes with time
        if k is None:
            findings.append(m)
        elif m.sensor in ("gnss", "imu") or adds(m.effect):
            findings[k] = _corrected(findings[k], m)
        else:
            continue  # more of a process that is named
        changed = True
    changed = changed or (bool(report.remainder) and not more.remainder)
    if not changed:
        return report
    findings = sorted((s for s in map(_pruned, findings) if s is not None), key=lambda s: -s.nats)
    if not more.remainder:
        findings = [_confirmed(s) for s in findings]
    return replace(
        report,
        verdict=judged(findings, more.remainder, early),
        findings=tuple(findings),
        after=more.after,
        remainder=more.remainder,
    )


def _by_owner(new: Finding, findings: Sequence[Finding]) -> list[Finding]:
    """A later finding in parts, where numbers of one effect stand in several earlier findings: each part corrects its own."""
    owners = [s for s in findings if _same_effect(s, new) and _share(s, new)]
    if len(owners) < 2:
        return [new]
    parts, left = [], list(new.parameters)
    for k, s in enumerate(owners):
        mine = [v for v in left if v.name in _names(s) or (k == 0 and not any(v.name in _names(o) for o in owners))]
        left = [v for v in left if v not in mine]
        axes = tuple(a for a in new.axes if any(v.name.endswith(f"_{a}") for v in mine)) or new.axes
        parts.append(replace(new, parameters=tuple(mine), axes=axes))
    return [p for p in parts if p.parameters]


def _is_level(finding: Finding) -> bool:
    """Whether a finding is one factor of several axes."""
    return any(v.name == "factor" and join_of(finding.effect, v.name) == "product" for v in finding.parameters)


def _multiplied(findings: Sequence[Finding], new: Finding) -> list[Finding]:
    """Findings with a later pass's level: a factor of some axes multiplies theirs, and stands by itself on the others."""
    out, left = [], list(new.axes)
    for s in findings:
        inside = tuple(a for a in s.axes if a in left) if _same_effect(s, new) else ()
        outside = tuple(a for a in s.axes if a not in inside)
        if inside:
            out.append(replace(_corrected(s, replace(new, axes=inside)), axes=inside))
            left = [a for a in left if a not in inside]
        if outside or not inside:
            out.append(replace(s, axes=outside) if inside else s)
    return [*out, replace(new, axes=tuple(left))] if left else out


def _names(finding: Finding) -> set[str]:
    return {v.name for v in finding.parameters}


def _share(one: Finding, other: Finding) -> bool:
    """Whether two findings have a number in common."""
    return bool(_names(one) & _names(other))


def _same_effect(one: Finding, other: Finding) -> bool:
    """Whether two findings are of one thing: the same effect of the same sensor, on the same axes and at the same time where it has one."""
    if (one.effect, one.sensor) != (other.effect, other.sensor):
        return False
    if one.effect in EQUATIONS and one.axes != other.axes:
        return False
    here, there = ({v.name: v for v in s.parameters if v.name in ("start", "duration")} for s in (one, other))
    # an interval may be wide where the best is not: what does not act at the same times is another one
    return not here or (
        one.axes == other.axes
        and all(v.low <= there[n].value <= v.high and there[n].low <= v.value <= there[n].high for n, v in here.items())
    )


def _corrected(old: Finding, new: Finding) -> Finding:
    """A finding with a later pass's correction: values add up, factors multiply, of colour the larger stands."""
    known = {v.name: v for v in old.parameters}
    values = {v.name: v for v in old.parameters}
    for v in new.parameters:
        was = known.get(v.name)
        if was is None:
            values[v.name] = v
        elif join_of(new.effect, v.name) == "product":
            values[v.name] = v.scaled(was.value)
        elif join_of(new.effect, v.name) == "sum":
            values[v.name] = v.shifted(was.value)
    axes = tuple(dict.fromkeys((*old.axes, *new.axes)))
    return replace(old, axes=axes, parameters=tuple(values.values()))


def _pruned(finding: Finding) -> Finding | None:
    """A finding less what a correction took back: parameters whose interval holds zero, levels that are nominal."""
    if any(v.name == "factor" and abs(math.log(v.value)) < math.log1p(rules().tolerance) for v in finding.parameters):
        return None
    if not adds(finding.effect) and finding.effect != "lever_arm":
        return finding
    kept = tuple(
        v for v in finding.parameters if not v.low < 0.0 < v.high or join_of(finding.effect, v.name) == "equal"
    )
    if not any(join_of(finding.effect, v.name) != "equal" for v in kept):
        return None
    shown = {v.name.partition("_")[2][:1] for v in kept}
    axes = tuple(a for a in finding.axes if a in shown) or finding.axes
    return replace(finding, parameters=kept, axes=axes)


def _confirmed(finding: Finding) -> Finding:
    """A finding's confidence once its model agrees with the recording: its share of its class."""
    gains = [m.nats for m in finding.members] or [finding.nats]
    own = next((m.nats for m in finding.members if m.effect == finding.effect), gains[0])
    own_share = math.exp(own - float(np.logaddexp.reduce([*gains, min(own, 0.0)])))
    return replace(finding, confidence=max(finding.confidence, own_share), doubtful=False)


def _larger(one: float, other: float) -> float:
    """The larger of two numbers that may be missing (NaN)."""
    return float(np.fmax(one, other))


def _pictures(first: Flown, after: Flown, nominal: Nominal) -> dict[str, Any]:
    """Whitened innovations of the nominal and of the refined model: what the page draws before and after."""
    from insemu.gap.candidates.mounting import Sideways
    from insemu.gap.drive.signatures import Loop

    out: dict[str, Any] = {}
    for name, prepared in (("before", first.prepared), ("after", after.prepared)):
        loop = Loop.of(prepared.result)
        y = np.where(loop.use, loop.y.reshape(-1, 6), np.nan)
        out[name] = {"t": prepared.result.fixes.t, "y": y}
        if nominal.vehicle is not None:
            s = Sideways.of(prepared)
            out[name]["across"] = (s.t, s.u)
    return out
