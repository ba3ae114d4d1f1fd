"""What the truth would have gained on held-out fixes: the refined model with the true effects, by the filter that believes in it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.foreign.sensors import Hidden
from insemu.gap import Finding, GapReport, Nominal
from insemu.gap.beliefs.refined import refined_nominal
from insemu.gap.drive import FIRST, Flown
from insemu.gap.problems import drive_without
from insemu.gap.problems.findings import with_effect
from insemu.gap.problems.joint_estimate import scene_under_colour
from insemu.gap.verdict import Value
from insemu.records import Recording


def gained(
    measured: Recording,
    nominal: Nominal,
    report: GapReport,
    hidden: Sequence[Hidden],
    truths: Sequence[Mapping[str, float]],
    share: float,
) -> float:
    """Log score that the truth gains over the nominal model, nats per fix of the last part of a recording; NaN where it would know the future.

    Parameters
    ----------
    measured, nominal : Recording, Nominal
        What was looked at, and what was believed of it.
    report : GapReport
        Of it: its form is taken, not what it says.
    hidden, truths : sequences
        Effects, and their parameters by the names of findings.
    share : float
        Share of the recording that is not scored.
    """
    start, end = float(measured.imu.t[0]), float(measured.imu.t[-1])
    cut = start + share * (end - start)
    # which fixes are outliers is told of the same fixes that are scored, and nobody knows beforehand when a step begins or ends
    if any(
        h.effect in FIRST or t.get("start", start) + t.get("duration", 0.0) > cut
        for h, t in zip(hidden, truths, strict=True)
    ):
        return math.nan
    told = tuple(_as_finding(h, t) for h, t in zip(hidden, truths, strict=True))
    refined = dict(report.nominal)
    for finding in told:
        refined = with_effect(refined, finding)
    true = refined_nominal(nominal, replace(report, findings=told, refined=refined), measured.imu.dt)
    (after, fixes), (before, _) = (_score(measured, model, cut) for model in (true, nominal))
    return (after - before) / fixes


def _as_finding(h: Hidden, truth: Mapping[str, float]) -> Finding:
    """A hidden effect as a finding that is right."""
    axes = (h.axis[0],) if h.axis and h.sensor in ("gyro", "accel") else (h.axis,) if h.axis else ()
    if h.effect == "gnss_correlated_noise":
        axes = ("north", "east", "down")
    values = tuple(Value(name, v, v, v, "") for name, v in truth.items())
    return Finding(h.effect, "", h.sensor, axes, values, 1.0, 0.0, ())


def _score(measured: Recording, model: Nominal, cut: float) -> tuple[float, int]:
    """Log-likelihood of the fixes after a time, and their number."""
    scene = scene_under_colour(Flown.of(*drive_without(measured, model.parted())).prepared)
    whole, noise = scene.surrogate, scene.noise
    factor, colour = (None, None) if noise is None else (noise.factor, noise.colour)
    late = whole.log_likelihood(factor, colour) - whole.until(cut).log_likelihood(factor, colour)
    return late, int(np.count_nonzero(whole.t > cut))
