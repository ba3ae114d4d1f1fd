"""What was found of a drive, estimated once more with all of it at once, on the recording less what it is said to be."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu.gap.beliefs.nominal import Nominal
from insemu.gap.candidates.shapes import EQUATIONS
from insemu.gap.data.samples import repair, with_counts
from insemu.gap.drive.preparation import Prepared, fast_parts, prepare
from insemu.gap.drive.scene import ARMS, TERMS, Scene, Window
from insemu.gap.evidence.fixes import LEVEL_ROWS, NED, joint_noise
from insemu.gap.evidence.surrogate import FixNoise
from insemu.gap.problems.known_effects import colour_of
from insemu.gap.verdict import Finding, Value
from insemu.records import AXES, Recording

Array = NDArray[np.float64]
#: Times that all of it is estimated together at the most: a bound, so that it ends.
MOST_TURNS = 4


def scene_under_colour(prepared: Prepared) -> Scene:
    """The scene of a recording, under the colour of its fixes that is known."""
    scene = Scene.of(prepared)
    scene = scene.trimmed(scene.always) if scene.always else scene
    colour = colour_of(prepared.nominal.effects)
    if colour is None:
        return scene
    loud, noise = FixNoise(np.ones(6), colour, known=True).split(scene.surrogate.sigma())
    scene = scene.rebuilt(factors=scene.original.factors * loud)
    moved = scene.original.factors / scene.original.levels
    return scene.coloured(joint_noise(scene.surrogate, noise, moved).noise)


@dataclass(frozen=True)
class JointStep:
    """What a recording less its findings still says of them.

    Parameters
    ----------
    gain : float
        What better numbers explain, nats, less what they would explain of noise.
    findings : tuple of Finding
        With these numbers.
    """

    gain: float
    findings: tuple[Finding, ...]


def gauss_newton_step(recording: Recording, nominal: Nominal, findings: Sequence[Finding]) -> JointStep:
    """What a recording less its findings says of their numbers, all at once.

    Numbers that were found one after the other, each beside columns of the others, are not those of all effects as they act. Here the filter
    flies what they leave, and a step of Gauss and Newton follows.

    Parameters
    ----------
    recording : Recording
        Less what was found, in the axes of the IMU.
    nominal : Nominal
        As it is then.
    findings : sequence of Finding
        What was found.

    Raises
    ------
    InputError
        A recording on which the nominal filter cannot run.
    """
    repaired = repair(recording.imu, filled=nominal.filled)
    nominal = replace(nominal, beliefs=with_counts(nominal.beliefs, repaired.findings, recording.imu.dt))
    recording = replace(recording, imu=repaired.imu)
    parts = fast_parts(replace(recording, imu=repaired.heard), nominal)
    found = list(findings)
    scene = scene_under_colour(prepare(recording, nominal, parts, {}, repaired))
    steps = {k: window for k, s in enumerate(found) if (window := _window(scene, s)) is not None}
    scene = scene.with_windows(tuple(steps.values()))
    owners = _columns(scene, found, list(steps))
    gain = 0.0
    if owners:
        index = np.array(list(owners))
        # what is found wrong with a number is of its own size, or of the datasheet's
        wide = [
            max(scene.columns[j].scale if j < scene.catalogue else 0.0, abs(value))
            for j, (_, _, value) in owners.items()
        ]
        blocks = [(index, np.diag(wide)), *scene.always]
        _, mean, covariance = scene.data.posterior(blocks)
        own = slice(0, index.size)
        mean, covariance = mean[own], covariance[own, own]
        gain = 0.5 * (float(mean @ np.linalg.solve(covariance, mean)) - index.size)
        for j, m, sd in zip(owners, mean, np.sqrt(np.diag(covariance)), strict=True):
            k, name, value = owners[j]
            column = scene.columns[j] if j < scene.catalogue else None
            now = value + float(m)
            found[k] = _with_value(found[k], name, *(column.parameter(now, float(sd)) if column else (now, float(sd))))
    factors = scene.original.factors * (1.0 if scene.noise is None else scene.noise.factor)
    for k, s in enumerate(found):
        if s.effect in LEVEL_ROWS:
            rows = [LEVEL_ROWS[s.effect] + NED.index(a) for a in s.axes]
            by = math.exp(float(np.mean(np.log(factors[rows]))))
            found[k] = replace(s, parameters=tuple(v.scaled(by) if v.name == "factor" else v for v in s.parameters))
    return JointStep(gain, tuple(found))


def _window(scene: Scene, finding: Finding) -> Window | None:
    """Place, start and end (s) of a step in a scene; ``None`` of another effect."""
    at = {v.name: v.value for v in finding.parameters}
    if finding.effect == "gnss_multipath_step":
        return NED.index(finding.axes[0]), at["start"], at["start"] + at["duration"]
    if finding.effect == "bias_step":
        return 3 + AXES.index(f"{finding.sensor}_{finding.axes[0]}"), at["start"], math.inf
    if finding.effect == "lever_arm_step":
        return ARMS + "xyz".index(finding.axes[0]), at["start"], math.inf
    if finding.effect == "expression_step":
        places = {(c.sensor, c.axes): k for k, c in enumerate(scene.changing.columns)}
        return TERMS + places[finding.sensor, finding.axes], at["start"], math.inf
    return None


def _columns(scene: Scene, findings: Sequence[Finding], steps: Sequence[int]) -> dict[int, tuple[int, str, float]]:
    """By column of a scene the finding that it belongs to, its parameter and the coefficient that this has.

    Parameters
    ----------
    scene : Scene
        With a window for each of the steps.
    findings : sequence of Finding
    steps : sequence of int
        Which of them are steps in the positions.
    """
    owners: dict[int, tuple[int, str, float]] = {}
    for k, s in enumerate(findings):
        for v in s.parameters:
            own = (s.effect, s.sensor, v.name, s.axes if s.effect in EQUATIONS else ())
            j = next(
                (
                    j
                    for j, c in enumerate(scene.columns[: scene.catalogue])
                    if (c.effect, c.sensor, c.label, c.axes if c.effect in EQUATIONS else ()) == own
                ),
                None,
            )
            if j is None or j in owners:
                continue
            owners[j] = (k, v.name, v.value ** scene.columns[j].power)
    for j, k in enumerate(steps, scene.width - len(steps)):
        owners[j] = (k, "value", next(v.value for v in findings[k].parameters if v.name == "value"))
    return owners


def _with_value(finding: Finding, name: str, value: float, sd: float) -> Finding:
    """A finding with another value of one of its numbers, as sure as a standard deviation says."""
    parameters = tuple(Value.normal(name, value, sd, v.unit) if v.name == name else v for v in finding.parameters)
    return replace(finding, parameters=parameters)
