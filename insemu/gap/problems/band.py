"""What an IMU shows above its motion: its effects axis by axis, the delay of its low-pass, and processes that reach into the band."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from insemu.effects import having
from insemu.gap.beliefs.nominal import Nominal
from insemu.gap.candidates.axis import CANDIDATES, AxisState, state_of, whitened
from insemu.gap.candidates.outliers import evident_outliers
from insemu.gap.candidates.shapes import PROCESSES, Change
from insemu.gap.candidates.tones import wandering, without_tones
from insemu.gap.data.log import Reduced, unheard
from insemu.gap.data.samples import Repaired, advanced
from insemu.gap.drive.preparation import Prepared, fixes_score, prepare
from insemu.gap.evidence.model import Component, Explanation
from insemu.gap.evidence.modes import Free
from insemu.gap.hypothesis import Found, Hypothesis
from insemu.gap.policy import rules
from insemu.gap.problems.findings import AxisResult, with_process
from insemu.gap.problems.known_effects import known_on_axis, of_axis, starting_explanation, without_drawn
from insemu.gap.problems.rest import search_axis
from insemu.gap.verdict import Finding, InBand, Value
from insemu.noise import WN, NoiseModel
from insemu.records import Recording

#: Candidates of the fast band; the others need a sensor at rest.
FAST = having("fast") | {"outliers"}

#: What a tone of one axis is called that changes its frequency.
WANDERING = "a tone whose frequency wanders"


def fast_effects(
    parts: dict[str, Reduced],
    nominal: Nominal,
    threshold: float,
    without: Collection[str],
    progress: Callable[[str], None],
    beside: Mapping[str, Sequence[Component]] | None = None,
    clipped: Collection[str] = (),
) -> list[tuple[str, AxisResult]]:
    """Effects that the IMU shows above its motion, axis by axis, ``beside`` what else is known to be there.

    What is left of a clipped stretch after it was filled in looks like outliers, so axes that were ``clipped`` are not asked for them.

    Parameters
    ----------
    parts : mapping of axis to Reduced
        The part of each axis above the motion.
    nominal : Nominal
        What is believed.
    threshold : float
        Evidence that an effect must exceed, nats.
    without : collection of str
        Effects taken out of the catalogue.
    progress : callable
        Told what is being done.
    beside : mapping of axis to sequence of Component, optional
        Processes found elsewhere that reach into the band.
    clipped : collection of str
        Axes with clipped stretches.
    """
    out = []
    excluded = {name for name in CANDIDATES if name not in FAST} | set(without)
    moving = wandering(parts)
    for name, data in parts.items():
        if not data.f.size:
            continue
        given = of_axis(nominal.effects, name)
        explanation = starting_explanation(nominal.beliefs[name], given, data.dt)
        for component in (beside or {}).get(name, ()):
            explanation = explanation.with_component(component)
        if name in moving:
            # no stationary process explains it, and what the search would name instead only chases it
            state = state_of(data, explanation)
            low, high = moving[name]
            out.append((name, AxisResult(state, state, (), f"{WANDERING}, {low:.3g} to {high:.3g} Hz")))
            continue
        start = state_of(data, explanation)
        left_out = (*excluded, *(("outliers",) if name in clipped else ()))
        evident = evident_outliers(start) if "outliers" not in left_out else None
        if evident is not None and _struck(evident, data, parts, nominal):
            data, left_out, evident = evident.change.data, (*left_out, "outliers"), None
        elif evident is not None:
            # first of all: they raise the whole spectrum, and differently from piece to piece
            progress(f"{name}: outliers {evident.nats:.1f} nats")
            data, left_out = evident.change.data, (*left_out, "outliers")
        named = tuple(n for n in known_on_axis(given) if n == "quantization")
        quiet = without_tones(data, state_of(data, explanation).explanation)
        state = without_drawn(state_of(quiet, explanation, named=named), given)
        result = search_axis(state, threshold=threshold, without=left_out, progress=progress, outsiders=False)
        if evident is not None and not any(use.id == "outliers" for use in given):
            first = Found(evident, (evident,))
            result = replace(result, start=start, found=(first, *result.found))
        out.append((name, result))
    return out


def without_its_vibration(
    fast: list[tuple[str, AxisResult]], parts: dict[str, Reduced]
) -> tuple[list[tuple[str, AxisResult]], dict[str, Reduced]]:
    """Results and band of the axes without those that only vibrate, where most of the others shake: too weakly to exceed every level of noise.

    A sensor's own noise must then exceed a vibration by as much as it must exceed nothing elsewhere: what shakes faster than half of the samples
    rises with the frequency as quantization does.

    Parameters
    ----------
    fast : list of (axis, AxisResult)
        From :func:`fast_effects`.
    parts : mapping of axis to Reduced
        The part of each axis above the motion.
    """
    if sum(data.shaking is not None for data in parts.values()) < rules().shaking_axes:
        return fast, parts
    moving = {}
    for name, r in fast:
        vibrations = [_vibration(f) for f in r.found]
        if vibrations and None not in vibrations:
            data, (rms, middle, width) = parts[name], _band_of([v for v in vibrations if v is not None])
            low, high = (float(np.clip(middle + k * width, data.f[0], data.f[-1])) for k in (-0.5, 0.5))
            moving[name] = replace(unheard(data), shaking=InBand(name, rms, data.unit, low, high, 0.0))
    return [(name, r) for name, r in fast if name not in moving], {**parts, **moving}


def _vibration(found: Found[AxisState]) -> Hypothesis[AxisState] | None:
    """The vibration that explains what was found as well, or less well by no more than an effect needs."""
    band = (h for h in (found.chosen, *found.ranked) if h.effect == "vibration_band")
    return next((h for h in band if h.nats > found.chosen.nats - rules().fast_nats), None)


def _band_of(vibrations: Sequence[Hypothesis[AxisState]]) -> tuple[float, float, float]:
    """Root mean square of vibrations together, and frequency and bandwidth (Hz) of the strongest."""
    each = [{v.name: v.value for v in h.values} for h in vibrations]
    top = max(each, key=lambda v: v["rms"])
    return math.sqrt(sum(v["rms"] ** 2 for v in each)), top["frequency"], top["bandwidth"]


def _struck(outliers: Hypothesis[AxisState], data: Reduced, parts: Mapping[str, Reduced], nominal: Nominal) -> bool:
    """Whether most outliers of an axis come with a jolt on another one: the vehicle was struck, the sensor is well."""
    at = np.flatnonzero(outliers.change.data.values != data.values) - data.values.size // 2
    struck = np.zeros(at.size, dtype=bool)
    for name, other in parts.items():
        if name == data.name or not (other.f.size or other.shaking):
            continue
        r = np.abs(whitened(state_of(other, Explanation.nominal(nominal.beliefs[name])))) > rules().beside
        near = np.clip(at[:, None] + other.values.size // 2 + np.arange(-2, 3), 0, r.size - 1)
        struck |= r[near].any(axis=1)
    return bool(struck.mean() > 0.5)


def without_delay(
    recording: Recording,
    nominal: Nominal,
    parts: dict[str, Reduced],
    levels: dict[str, float],
    fast: Mapping[str, AxisResult],
    repaired: Repaired,
    prepared: Prepared | None = None,
) -> tuple[Prepared, Recording, dict[str, float]]:
    """The nominal filter on sensors set forward by the delay of the low-pass that the fast band shows, and that delay, s per sensor.

    ``prepared`` is that filter without any, where it has run. A low-pass may be causal (it delays) or its delay may have been taken off in the
    unit already; the innovations say which.

    Parameters
    ----------
    recording : Recording
        A drive or flight.
    nominal : Nominal
        What is believed.
    parts : mapping of axis to Reduced
        The part of each axis above the motion.
    levels : mapping of axis to float
        White-noise densities that were named as an effect, unit/sqrt(Hz).
    fast : mapping of axis to AxisResult
        What the fast band shows.
    repaired : Repaired
        The IMU record as its samples were repaired.
    prepared : Prepared, optional
        The nominal filter on the recording as it is.

    Raises
    ------
    InputError
        The nominal filter cannot run on the recording; see :func:`insemu.gap.drive.preparation.prepare`.
    """
    best = prepared or prepare(recording, nominal, parts, levels, repaired)
    late: dict[str, float] = {}
    for sensor in ("gyro", "accel"):
        roll = [fast[f"{sensor}_{a}"].end.explanation.rolloff for a in "xyz" if f"{sensor}_{a}" in fast]
        delays = [r.delay(recording.imu.dt) for r in roll if r is not None]
        if not delays:
            continue
        delay = float(np.median(delays))
        moved = replace(recording, imu=advanced(recording.imu, sensor, delay))
        tried = prepare(moved, nominal, parts, levels, repaired)
        if fixes_score(tried.result.fixes) > fixes_score(best.result.fixes):
            best, recording, late[sensor] = tried, moved, delay
    return best, recording, late


def with_delay(finding: Finding, delay: float) -> Finding:
    """A low-pass with the delay in s that was taken off its sensor; as uncertain as the cutoff that it follows from."""
    if finding.effect != "decimation_filter":
        return finding
    ratios = [
        (v.value / v.high, v.value / v.low) for v in finding.parameters if v.name.startswith("cutoff") and v.low > 0.0
    ]
    low, high = (min(r[0] for r in ratios), max(r[1] for r in ratios)) if ratios else (1.0, 1.0)
    return replace(finding, parameters=(*finding.parameters, Value("delay", delay, delay * low, delay * high, "s")))


def again_with_processes(
    fast: list[tuple[str, AxisResult]],
    found: Sequence[Found[Change]],
    parts: dict[str, Reduced],
    nominal: Nominal,
    threshold: float,
    without: Collection[str],
    clipped: Collection[str],
) -> list[tuple[str, AxisResult]]:
    """What the band above the motion shows where a slow process that was found since reaches into it.

    Parameters
    ----------
    fast : list of (axis, AxisResult)
        From :func:`fast_effects`.
    found : sequence of Found
        What the search of the innovations found.
    parts : mapping of axis to Reduced
        The part of each axis above the motion.
    nominal : Nominal
        What is believed.
    threshold : float
        Evidence that an effect must exceed, nats.
    without, clipped : collection of str
        Effects taken out of the catalogue; axes with clipped stretches.
    """
    beside: dict[str, list[Component]] = {}
    for f in found:
        for axis in f.chosen.axes if f.chosen.effect in PROCESSES else ():
            process = with_process(
                NoiseModel(()), f.chosen.effect, {v.name: v.value for v in f.chosen.values}
            ).processes[0]
            # knots tell the slow part; how much of it reaches above the motion is another matter
            size = PROCESSES[f.chosen.effect]
            value = process.parameters[size]
            free = (Free(size, value / rules().leak, value * rules().leak),)
            beside.setdefault(f"{f.chosen.sensor}_{axis}", []).append(Component(process, free))
    touched = set(beside) & {name for name, r in fast if r.found}
    if not touched:
        return fast
    some = {name: data for name, data in parts.items() if name in touched}
    fresh = dict(fast_effects(some, nominal, threshold, without, lambda _: None, beside, clipped))
    return [(name, fresh.get(name, r)) for name, r in fast]


def white_level(result: AxisResult) -> float | None:
    """White noise of an axis next to what its fast band was found to hold; None where the nominal model describes the band, or nothing does.

    A low-pass takes from the band and a vibration adds to it, and neither says anything of the noise at the rate of the motion.
    """
    if not result.found or result.outsider:
        return None
    parts = (c for c in result.end.explanation.components if c.effect in ("nominal", "white_noise"))
    return next((c.process.parameters["N"] for c in parts if isinstance(c.process, WN)), None)


def vibrates(result: AxisResult) -> bool:
    """Whether a vibration is among the effects of an axis, and not one that a later effect replaced."""
    return any(f.chosen.effect.startswith("vibration") for f in result.found)
