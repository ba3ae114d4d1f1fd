"""What is known besides noise, before a recording is searched: taken off where it has numbers, taken out of the samples where it was drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from insemu import rotation
from insemu.effects import EffectUse, added_signal, compensated, having, lever_arm_of
from insemu.gap.beliefs.nominal import Nominal
from insemu.gap.candidates.axis import CANDIDATES, AxisState, state_of
from insemu.gap.data.log import reduce
from insemu.gap.data.sources import StaticLog
from insemu.gap.evidence.band import Band
from insemu.gap.evidence.model import Component, Explanation
from insemu.gap.evidence.modes import level
from insemu.gap.evidence.rolloff import DEPTH, Rolloff
from insemu.gap.evidence.surrogate import Colour, FixNoise
from insemu.noise import WN, NoiseModel
from insemu.records import AXES, Recording, Series, Trajectory
from insemu.strapdown import trajectory_of

Array = NDArray[np.float64]

#: By effect which of the positions and of the velocities that there are, in order of time, (k,).
Told = Mapping[str, NDArray[np.int64]]

#: Effects that a candidate takes out of the samples: what was drawn is nobody's to know beforehand.
TAKEN_OUT = having("drawn")


def of_axis(effects: Sequence[EffectUse], name: str) -> tuple[EffectUse, ...]:
    """The effects that act on an axis such as ``gyro_x``."""
    sensor, _, axis = name.rpartition("_")
    out = []
    for use in effects:
        if use.sensor not in (sensor, "imu") or axis not in "xyz":
            continue
        sizes = [v["xyz".index(axis)] for k, v in use.values.items() if len(v) == 3 and k != "beta"]
        if not sizes or any(sizes):
            out.append(use)
    return tuple(out)


def starting_explanation(model: NoiseModel, known: Sequence[EffectUse], dt: float) -> Explanation:
    """The belief with its vibration and its low-pass, every level free as a nominal one is.

    Parameters
    ----------
    model : NoiseModel
        Believed noise of the axis.
    known : sequence of EffectUse
        Known effects of the axis; others than ``vibration_band`` and ``decimation_filter`` change nothing here.
    dt : float
        Sampling interval, s.
    """
    explanation = Explanation.nominal(model)
    for use in known:
        if use.id == "vibration_band" and max(use["rms"]) > 0.0:
            band = Band(max(use["rms"]), use.scalar("frequency"), use.scalar("bandwidth") / use.scalar("frequency"))
            free = tuple(level(p.name, band.parameters[p.name]) for p in band.PARAMETERS)
            explanation = explanation.with_component(Component(band, free))
    low_pass = next((use for use in known if use.id == "decimation_filter"), None)
    if low_pass is None:
        return explanation
    cutoff, taps = low_pass.scalar("cutoff"), low_pass.scalar("taps")
    if cutoff <= 0.0 and taps < 1.5:
        return explanation
    kind, values = (
        ("butterworth", (cutoff, low_pass.scalar("order")))
        if cutoff > 0.0
        else ("moving average", (1.0 / (taps * dt),))
    )
    free = tuple(level(name, value) for name, value in zip(("corner", "order"), values, strict=False))
    whites = [p.parameters["N"] ** 2 for p in model if isinstance(p, WN)]
    return replace(explanation, rolloff=Rolloff(kind, values, free, floor=DEPTH * sum(whites)))


def known_on_axis(known: Sequence[EffectUse]) -> tuple[str, ...]:
    """Effects of an axis that are not asked for again."""
    return tuple(dict.fromkeys(use.id for use in known if use.id in ("quantization", *TAKEN_OUT)))


def without_drawn(state: AxisState, known: Sequence[EffectUse]) -> AxisState:
    """The axis after its known outliers, levels, lines and lost samples were taken out."""
    for use in known:
        if use.id not in TAKEN_OUT:
            continue
        tried = [w for w in CANDIDATES[use.id](state) if w.effect == use.id]
        best = max(tried, key=lambda w: w.nats, default=None)
        state = best.change if best is not None and best.nats > 0.0 else replace(state, named=(*state.named, use.id))
    return state


def static_without(log: StaticLog, nominal: Nominal) -> tuple[StaticLog, dict[str, tuple[EffectUse, ...]]]:
    """A static log less what is known, and what is known of each axis.

    Raises
    ------
    InputError
        A known effect of temperature where none was recorded.
    """
    known: Mapping[str, tuple[EffectUse, ...]] = {s.name: of_axis(nominal.effects, s.name) for s in log.axes}
    axes = []
    for s in log.axes:
        mine = known[s.name]
        values = np.array(s.values)
        if s.name in AXES and mine:
            t: Array = np.arange(len(s), dtype=np.float64) * s.dt
            sensor = s.name.partition("_")[0]
            values -= added_signal([u for u in mine if u.sensor == sensor], t, log.temperature)[
                :, AXES.index(s.name) % 3
            ]
            if any("shape" in use.effect.traits for use in mine):
                values -= (
                    values.mean()
                )  # where such a law is zero is a convention, so that the constant is not known with it
        if any(use.id in TAKEN_OUT for use in mine) and s.name in nominal.beliefs:
            series = Series(values, s.rate_hz, s.unit, s.name)
            state = state_of(reduce(series), starting_explanation(nominal.beliefs[s.name], mine, s.dt), log.temperature)
            values = np.asarray(without_drawn(state, mine).data.values)
        axes.append(Series(values, s.rate_hz, s.unit, s.name))
    return replace(log, axes=tuple(axes)), dict(known)


def drive_without(
    recording: Recording, nominal: Nominal, gone: Told | None = None, *, filled: bool = False
) -> tuple[Recording, Nominal]:
    """A drive or flight less what is known, and the nominal model as it is then: its lever arm and the noise of its fixes put right.

    Parameters
    ----------
    recording : Recording
        As it was measured.
    nominal : Nominal
        What is known.
    gone : mapping of effect to (k,) array of int, optional
        Which of the positions and of the velocities that there are, in order of time, are known to be outliers (:func:`struck_out`); else as
        many of them as are known are found.
    filled : bool
        Whether known lost samples are filled in; a search does so where it looks at the samples, which says how uncertain that is.

    Raises
    ------
    InputError
        See :func:`insemu.effects.compensated`.
    """
    effects = nominal.effects
    g = nominal.gnss
    changes: dict[str, object] = {"lever_arm": tuple(lever_arm_of(effects, g.lever_arm))}
    fixes = recording.gnss
    sigmas = (
        ()
        if fixes is None
        else (("position", fixes.pos_std_ned, g.position_sigma), ("velocity", fixes.vel_std_ned, g.velocity_sigma))
    )
    for what, stated, believed in sigmas:
        if stated is None and believed is not None:
            sigma = np.array(believed, dtype=float)
            for use in effects:
                sigma = use.effect.true_sigma(use, what, sigma) if use.effect.does("true_sigma") else sigma
            changes[f"{what}_sigma"] = tuple(float(s) for s in sigma)
    moved = replace(nominal, gnss=g.model_copy(update=changes))
    motion = recording.reference or (lambda rest: _estimated(rest, moved))
    taken = [
        use for use in effects if (filled or not use.effect.does("restored")) and "widened" not in use.effect.traits
    ]
    out = compensated(recording, taken, trajectory=motion, lever_arm=moved.gnss.lever_arm)
    if gone is None:
        return _without_outliers(out, moved, colour_of(effects)), moved
    return _struck_out(out, {k: _stamps(out, k)[at] for k, at in gone.items()}), moved


def in_imu_axes(recording: Recording, nominal: Nominal) -> tuple[Recording, Nominal]:
    """A recording and its nominal model from :func:`drive_without`, both in body axes, back in the axes of the IMU.

    Errors of a sensor are in its own axes: there they are looked for and named, and taken off before the mounting is.
    """
    C = np.eye(3)
    for use in nominal.effects:
        if use.effect.does("turn"):
            C = use.effect.turn(use) @ C
    if np.allclose(C, np.eye(3), atol=1e-12):
        return recording, nominal
    imu, reference = recording.imu, recording.reference
    imu = replace(imu, gyro=imu.gyro @ C, accel=imu.accel @ C)
    if reference is not None:
        reference = replace(reference, rpy=rotation.rpy_from_dcm(rotation.dcm_from_rpy(reference.rpy) @ C))
    gnss = nominal.gnss.model_copy(update={"lever_arm": tuple(C.T @ np.array(nominal.gnss.lever_arm))})
    roll, pitch, yaw = (float(x) for x in rotation.rpy_from_dcm(C))
    return replace(recording, imu=imu, reference=reference), replace(nominal, gnss=gnss, mounting=(roll, pitch, yaw))


def _estimated(recording: Recording, nominal: Nominal) -> Trajectory:
    """Motion as the nominal filter sees it."""
    from insemu.gap.drive.preparation import flown_once

    result = flown_once(recording, nominal)
    return trajectory_of(result.t, result.nav, "estimate")


def _without_outliers(recording: Recording, nominal: Nominal, colour: Colour | None) -> Recording:
    """A recording without the positions and velocities that are more likely known outliers than not, as the nominal filter sees them."""
    from insemu.gap.drive.fix_outliers import FIRST, always, by_filter, known_outliers, outlying, under_colour
    from insemu.gap.drive.preparation import fast_parts, prepare

    if recording.gnss is None or not any(use.id in FIRST for use in nominal.effects):
        return recording
    prepared = replace(prepare(recording, nominal, fast_parts(recording, nominal), {}), factors=np.ones(6))
    look = by_filter(lambda gnss: prepared.again(gnss=gnss).result, prepared.gnss)
    if colour is not None:
        loud, noise = FixNoise(np.ones(6), colour).split(prepared.surrogate.sigma())
        look = always(under_colour(prepared.again(factors=loud).surrogate, noise))
    return _struck_out(recording, outlying(look, known_outliers(nominal.effects, prepared.gnss)))


def _struck_out(recording: Recording, gone: Mapping[str, Array]) -> Recording:
    """A recording without the positions and velocities of some times."""
    from insemu.gap.drive.fix_outliers import without

    return recording if recording.gnss is None else replace(recording, gnss=without(recording.gnss, gone))


def struck_out(whole: Recording, recording: Recording) -> dict[str, NDArray[np.int64]]:
    """Which of the positions and of the velocities of a recording are no more in another, by effect, as :func:`drive_without` takes them.

    Parameters
    ----------
    whole, recording : Recording
        With all of them, and without the outliers; with the same stamps.
    """
    from insemu.gap.drive.fix_outliers import FIRST

    return which({k: np.setdiff1d(_stamps(whole, k), _stamps(recording, k)) for k in FIRST}, whole)


def which(gone: Mapping[str, Array], recording: Recording) -> dict[str, NDArray[np.int64]]:
    """Which of the positions and of the velocities of a recording have some times.

    Parameters
    ----------
    gone : mapping of effect to (k,) array
        The times, s.
    recording : Recording
    """
    return {k: np.flatnonzero(np.isin(_stamps(recording, k), t)) for k, t in gone.items()}


def all_outliers(whole: Recording, first: Told, then: Told) -> dict[str, NDArray[np.int64]]:
    """Which of the positions and of the velocities of a recording were classified as outliers: some at first, then others among those that were left.

    Parameters
    ----------
    whole : Recording
        With all of them.
    first, then : mapping of effect to (k,) array of int
        As :func:`drive_without` takes them.
    """
    out = dict(first)
    for effect, at in then.items():
        left = np.delete(np.arange(_stamps(whole, effect).size), first.get(effect, np.zeros(0, dtype=np.int64)))
        out[effect] = np.union1d(out.get(effect, np.zeros(0, dtype=np.int64)), left[at])
    return out


def _stamps(recording: Recording, effect: str) -> Array:
    """Times (k,) of the positions, or of the velocities, that there are, s: of those of which an effect makes outliers."""
    from insemu.gap.drive.fix_outliers import FIRST

    gnss = recording.gnss
    values = None if gnss is None else gnss.llh if FIRST[effect] == 0 else gnss.vel_ned
    return np.zeros(0) if gnss is None or values is None else gnss.t[np.isfinite(values).all(axis=1)]


def colour_of(effects: Sequence[EffectUse]) -> Colour | None:
    """Known coloured noise of the fixes."""
    use = next((u for u in effects if u.id == "gnss_correlated_noise"), None)
    return None if use is None else Colour.of(use)
