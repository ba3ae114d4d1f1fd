"""What a finding is worth in metres: horizontal position error at the end of a minute without fixes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from insemu.effects import EFFECTS, Column, FixGeometry, Motion
from insemu.filters import FilterResult
from insemu.gap.drive.preparation import Prepared
from insemu.gap.drive.signatures import Loop, built_up
from insemu.gap.verdict import Finding
from insemu.noise import WN, NoiseModel

Array = NDArray[np.float64]

#: m/s^2: a tenth of a percent does not matter here.
GRAVITY = 9.81
#: Length of an outage and time from the start of one to that of the next, s.
OUTAGE_S, APART_S = 60.0, 30.0


def white_levels(beliefs: Mapping[str, NoiseModel]) -> dict[str, float]:
    """Density of the white noise of every axis."""
    return {
        name: math.sqrt(sum(p.parameters["N"] ** 2 for p in model if isinstance(p, WN)))
        for name, model in beliefs.items()
    }


def worth_in_noise(finding: Finding, believed: Mapping[str, float] | None = None) -> float:
    """Standard deviation of the position, m, that an effect of the IMU's own signal adds in an outage; NaN where it has none.

    The error's autocovariance is integrated twice for an accelerometer and, times gravity, three times for a gyroscope (Titterton and
    Weston 2004, chapter 12, without Schuler's oscillation, which a minute does not see). Of several axes the root of the sum of squares.

    Parameters
    ----------
    finding : Finding
    believed : mapping of axis to number, optional
        Densities of the white noise that was believed: of another level only what goes beyond that counts.
    """
    if finding.sensor not in ("gyro", "accel"):
        return math.nan
    t = np.linspace(0.0, OUTAGE_S, 241)
    left = OUTAGE_S - t
    weight = left if finding.sensor == "accel" else 0.5 * GRAVITY * left**2
    step = np.full(t.size, t[1])
    step[[0, -1]] *= 0.5
    given = {v.name: v.value for v in finding.parameters}
    total = 0.0
    for a in finding.axes or ("",):
        own = {k.removesuffix(f"_{a}"): v for k, v in given.items() if k.endswith(f"_{a}") or "_" not in k}
        if finding.effect == "white_noise" and "N" in own:
            nominal = (believed or {}).get(f"{finding.sensor}_{a}", 0.0)
            total += abs(own["N"] ** 2 - nominal**2) * float(step @ weight**2)
        elif (signal := _covariance(finding.effect, own, t)) is not None:
            total += float((step * weight) @ signal @ (step * weight))
        else:
            return math.nan
    return math.sqrt(max(total, 0.0))


def _covariance(effect: str, p: Mapping[str, float], t: Array) -> Array | None:
    """Covariance of an effect's signal in an outage, which begins with what a filter has not learnt: nothing of a walk or a ramp before it."""
    try:
        if effect == "random_walk":
            return np.asarray(p["K"] ** 2 * np.minimum(t[:, None], t[None, :]))
        if effect == "gauss_markov":
            return np.asarray(p["sigma"] ** 2 * np.exp(-p["beta"] * np.abs(t[:, None] - t[None, :])))
        if effect == "telegraph":
            return np.asarray(p["amplitude"] ** 2 * np.exp(-2.0 * p["rate"] * np.abs(t[:, None] - t[None, :])))
        if effect in ("turn_on_bias", "flicker"):
            size = p["value"] if effect == "turn_on_bias" else p["B"]
            return np.full((t.size, t.size), size**2)
        if effect == "ramp":
            return np.asarray(np.outer(p["R"] * t, p["R"] * t))
    except KeyError:
        pass
    return None


def worth_of_settled(prepared: Prepared, finding: Finding) -> float:
    """What a finding of known shape, settled before the search, is worth in metres: :func:`worth_in_motion` along the nominal filter's run.

    NaN for one without columns.
    """
    effect = EFFECTS[finding.effect]
    if prepared.result.nodes is None or not effect.does("columns"):
        return math.nan
    loop, motion = Loop.of(prepared.result), prepared.motion
    at = FixGeometry.of(motion, prepared.result.fixes.t, prepared.lever_arm, prepared.nominal.mounting)
    values = {v.name: v.value for v in finding.parameters}
    columns = [c for c in effect.columns(motion, at) if c.label in values]
    return worth_in_motion(loop, motion, columns, [values[c.label] for c in columns])


def worth_of_mounting(prepared: Prepared, finding: Finding) -> float:
    """Root mean square of the horizontal position error, m, at the end of a minute in which only the vehicle's motion aids the filter.

    A filter that holds the motion across the vehicle at zero goes off its way by the yaw of the wrong mounting.

    Parameters
    ----------
    prepared : Prepared
        The nominal filter's run.
    finding : Finding
        A mounting.
    """
    yaw = next((v.value for v in finding.parameters if v.name == "rpy_yaw"), math.nan)
    t, vel = prepared.motion.t, prepared.motion.vel
    way = np.concatenate([[0.0], np.cumsum(np.diff(t) * np.linalg.norm(vel[1:, :2], axis=1))])
    starts = np.arange(t[0] + OUTAGE_S, t[-1] - OUTAGE_S, APART_S)
    if not starts.size:
        return math.nan
    ways = np.interp(starts + OUTAGE_S, t, way) - np.interp(starts, t, way)
    return float(abs(math.sin(yaw)) * np.sqrt(np.mean(ways**2)))


def stated_in_outages(result: FilterResult) -> float:
    """Horizontal standard deviation, m, that a filter states at the end of a minute without fixes: root mean square over starts all along a run.

    The covariance of the stored run is carried on by its own transitions and noise, without the fixes.
    """
    nodes, fixes = result.nodes, result.fixes
    if nodes is None:
        return math.nan
    t, step = result.t[nodes.epoch], nodes.Phi
    fixed = np.searchsorted(nodes.epoch, fixes.epoch)
    starts = [int(k) for k in np.searchsorted(t, np.arange(t[0] + OUTAGE_S, t[-1] - OUTAGE_S, APART_S))]
    ends = []
    for k in starts:
        last = int(np.searchsorted(t, t[k] + OUTAGE_S))
        if last >= t.size or not np.any((fixed > k) & (fixed <= last)):
            continue
        P = nodes.P_after[k]
        for j in range(k + 1, last + 1):
            driven = nodes.P_before[j] - step[j] @ nodes.P_after[j - 1] @ step[j].T
            P = step[j] @ P @ step[j].T + driven
        ends.append(float(P[0, 0] + P[1, 1]))
    return math.sqrt(sum(ends) / len(ends)) if ends else math.nan


def worth_in_motion(
    loop: Loop,
    motion: Motion,
    columns: Sequence[Column],
    values: Sequence[float],
    starts: Sequence[float] | None = None,
) -> float:
    """Root mean square of the horizontal position error, m, that coefficients of some columns leave at the end of outages all along a drive.

    The filter in the loop carries the effect up to the outage and has no fix from there on.

    Parameters
    ----------
    loop : Loop
        The filter.
    motion : Motion
        Of the IMU.
    columns : sequence of Column
    values : sequence of float
        Their coefficients.
    starts : sequence of float, optional
        Of the outages, s; every 30 s after the first minute where they are not given.
    """
    fixes, nodes = loop.result.fixes, loop.result.nodes
    assert nodes is not None and fixes.K is not None and fixes.H is not None
    D, _, M = built_up(loop, motion, columns)
    drive, error = np.einsum("kjs,j->ks", D, values), M @ np.asarray(values)
    t = motion.t[nodes.epoch]
    H = np.where(loop.use[:, :, None], np.nan_to_num(fixes.H), 0.0)
    K = np.where(loop.use[:, None, :], np.nan_to_num(fixes.K), 0.0)
    at = loop.result.fixes_of_nodes()
    e = np.zeros(nodes.Phi.shape[1])
    flying: list[tuple[float, Array]] = []
    ends: list[float] = []
    waiting = list(np.arange(t[0] + OUTAGE_S, t[-1], APART_S) if starts is None else starts)
    for k in range(1, t.size):
        flying = [(end, nodes.Phi[k] @ x) for end, x in flying]
        e = nodes.Phi[k] @ e
        for x in (e, *(x for _, x in flying)):
            x[:9] += drive[k]
        ends += [float(x[0] ** 2 + x[1] ** 2) for end, x in flying if t[k] >= end]
        flying = [(end, x) for end, x in flying if t[k] < end]
        for j in at.get(k, ()):
            e = e + K[j] @ np.where(loop.use[j], error[j] - H[j] @ e, 0.0)
        if waiting and t[k] >= waiting[0]:
            flying.append((waiting.pop(0) + OUTAGE_S, e.copy()))
    return math.sqrt(sum(ends) / len(ends)) if ends else math.nan
