"""What a finding is worth in metres: horizontal position error at the end of a minute without fixes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.effects import EFFECTS, Column, FixGeometry, Motion, aid_corrected, first_axis, on_axes
from insemu.filters import FilterOptions, FilterResult, run_filter
from insemu.gap.beliefs.refined import uses_of
from insemu.gap.drive.preparation import Prepared, for_filter, scaled_fixes
from insemu.gap.drive.signatures import Loop, built_up, ramps
from insemu.gap.verdict import Finding
from insemu.noise import WN, NoiseModel
from insemu.records import AXES, AidRecord

Array = NDArray[np.float64]

#: m/s^2: a tenth of a percent does not matter here.
GRAVITY = 9.81
#: Length of an outage and time from the start of one to that of the next, s.
OUTAGE_S, APART_S = 60.0, 30.0
#: Time from one outage to the next in which aids are worth something, s: outages and as long with fixes.
AIDED_APART_S = 2.0 * OUTAGE_S


def white_levels(beliefs: Mapping[str, NoiseModel]) -> dict[str, float]:
    """Density of the white noise of every axis."""
    return {
        name: math.sqrt(sum(p.parameters["N"] ** 2 for p in model if isinstance(p, WN)))
        for name, model in beliefs.items()
    }


@dataclass(frozen=True)
class Outage:
    """How the position at the end of a minute without fixes follows the signals of the IMU in it.

    Parameters
    ----------
    t, width : (k,) arrays
        Middles of spans since the last fix, and their widths, s.
    weight : (k, 6, d) array
        Position in d horizontal directions that a unit signal of an axis (gyroscopes, then accelerometers) over a span leaves at the end: m per
        rad/s or m/s^2.
    """

    t: Array
    width: Array
    weight: Array


def at_rest() -> list[Outage]:
    """An outage of which the attitude is not known: each accelerometer lies in the horizontal plane, each gyroscope tilts it.

    An accelerometer's error is integrated twice and, times gravity, a gyroscope's three times (Titterton and Weston 2004, chapter 12, without
    Schuler's oscillation, which a minute does not see).
    """
    t = np.linspace(0.0, OUTAGE_S, 241)
    width = np.full(t.size, t[1])
    width[[0, -1]] *= 0.5
    left = (OUTAGE_S - t) * width
    tilting = 0.5 * GRAVITY * (OUTAGE_S - t) * left
    return [Outage(t, width, np.repeat(np.stack([tilting, left], axis=1), 3, axis=1)[:, :, None])]


def outages_along(loop: Loop, motion: Motion) -> list[Outage]:
    """Outages all along a drive, every 30 s after the first minute; none of a short one.

    Parameters
    ----------
    loop : Loop
        The filter, whose transitions carry an error on.
    motion : Motion
        Of the IMU.
    """
    nodes = loop.result.nodes
    assert nodes is not None
    ramp = ramps(loop, motion)
    t, out = motion.t[nodes.epoch], []
    for start in _starts(t):
        first = int(np.searchsorted(t, start))
        last = min(int(np.searchsorted(t, t[first] + OUTAGE_S)), t.size - 1)
        onward, weight = np.eye(2, 9), np.zeros((last - first, 6, 2))
        for k in range(last, first, -1):
            weight[k - first - 1] = ramp[k, :6] @ onward.T
            onward = onward @ nodes.Phi[k, :9, :9]
        ends = t[first : last + 1] - t[first]
        out.append(Outage(0.5 * (ends[1:] + ends[:-1]), np.diff(ends), weight))
    return out


def _starts(t: Array) -> Array:
    """Starts of the outages that end within times (n,), s: every 30 s after the first minute."""
    return np.arange(t[0] + OUTAGE_S, t[-1] - OUTAGE_S, APART_S)


def worth_in_noise(
    finding: Finding, believed: Mapping[str, float] | None = None, outages: Sequence[Outage] | None = None
) -> float:
    """Standard deviation of the position, m, that an effect of the IMU's own signal adds in an outage; NaN where it has none.

    The error's autocovariance is carried to the end of the outage. Of several axes the root of the sum of squares, of several outages the root
    mean square.

    Parameters
    ----------
    finding : Finding
    believed : mapping of axis to number, optional
        Densities of the white noise that was believed: of another level only what goes beyond that counts.
    outages : sequence of Outage, optional
        From :func:`outages_along`; :func:`at_rest` where they are not given.
    """
    outages = at_rest() if outages is None else outages
    if finding.sensor not in ("gyro", "accel") or not outages:
        return math.nan
    given = {v.name: v.value for v in finding.parameters}
    total = 0.0
    for a in finding.axes or ("x",):
        own = {k.removesuffix(f"_{a}"): v for k, v in given.items() if k.endswith(f"_{a}") or "_" not in k}
        name = f"{finding.sensor}_{a}"
        for outage in outages:
            w = outage.weight[:, AXES.index(name)]
            if finding.effect == "white_noise" and "N" in own:
                more = abs(own["N"] ** 2 - (believed or {}).get(name, 0.0) ** 2)
                total += more * float(np.sum(w**2 / outage.width[:, None]))
            elif (signal := _covariance(finding.effect, own, outage.t)) is not None:
                total += float(np.sum(w * (signal @ w)))
            else:
                return math.nan
    return math.sqrt(max(total, 0.0) / len(outages))


def worth_of_white(noise: Array, outages: Sequence[Outage]) -> float:
    """Standard deviation of the position, m, that white noise of the six axes adds in an outage, its densities squared; NaN without any."""
    if not outages or not noise.any():
        return math.nan
    total = sum(float(noise @ np.einsum("kad,k->a", o.weight**2, 1.0 / o.width)) for o in outages)
    return math.sqrt(total / len(outages))


def with_white(finding: Finding, noise: Array, outages: Sequence[Outage]) -> Finding:
    """A finding with the white noise that it adds to the axes, and what that is worth.

    Parameters
    ----------
    finding : Finding
    noise : (6,) array
        Densities squared: (rad/s)^2/Hz and (m/s^2)^2/Hz.
    outages : sequence of Outage
    """
    return replace(finding, metres=worth_of_white(noise, outages), white=tuple(noise.tolist()))


def _covariance(effect: str, p: Mapping[str, float], t: Array) -> Array | None:
    """Covariance of an effect's signal in an outage, which begins with what a filter has not learnt: nothing of a walk or a ramp before it."""
    try:
        if effect == "random_walk":
            return np.asarray(p["K"] ** 2 * np.minimum(t[:, None], t[None, :]))
        if effect == "gauss_markov":
            return np.asarray(p["sigma"] ** 2 * np.exp(-p["beta"] * np.abs(t[:, None] - t[None, :])))
        if effect == "telegraph":
            return np.asarray(p["amplitude"] ** 2 * np.exp(-2.0 * p["rate"] * np.abs(t[:, None] - t[None, :])))
        if effect in ("turn_on_bias", "bias_step", "flicker"):
            size = p["B"] if effect == "flicker" else p["value"]
            return np.full((t.size, t.size), size**2)
        if effect == "ramp":
            return np.asarray(np.outer(p["R"] * t, p["R"] * t))
    except KeyError:
        pass
    return None


def worth_of_early(prepared: Prepared, finding: Finding) -> float:
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


def worth_of_added(loop: Loop, motion: Motion, finding: Finding) -> float:
    """What an error is worth in metres that a sensor adds whatever it senses: :func:`worth_in_motion` of it as it is.

    Parameters
    ----------
    loop, motion : Loop, Motion
        The filter, and the motion of the IMU.
    finding : Finding
    """
    first = first_axis(finding.sensor)
    columns = [
        Column(u.id, u.sensor, "", (), 1.0, "", on_axes(u.effect.added(u, motion.t, motion.temperature), first))
        for u in uses_of(finding)
    ]
    return worth_in_motion(loop, motion, columns, [1.0] * len(columns))


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
    starts = _starts(t)
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
    starts = [int(k) for k in np.searchsorted(t, _starts(t))]
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
    D, M = built_up(loop, motion, columns)
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
        ends += [float(x[0] ** 2 + x[1] ** 2) for end, x in flying if t[k] > end]
        flying = [(end, nodes.Phi[k] @ x) for end, x in flying if t[k] <= end]
        e = nodes.Phi[k] @ e
        for x in (e, *(x for _, x in flying)):
            x[:9] += drive[k]
        for j in at.get(k, ()):
            e = e + K[j] @ np.where(loop.use[j], error[j] - H[j] @ e, 0.0)
        if waiting and t[min(k + 1, t.size - 1)] > waiting[0]:
            flying.append((waiting.pop(0) + OUTAGE_S, e.copy()))
    return math.sqrt(sum(ends) / len(ends)) if ends else math.nan


def worth_of_aids(
    prepared: Prepared, aids: Sequence[AidRecord], findings: Sequence[Finding], struck: Mapping[str, Array]
) -> list[Finding]:
    """Findings about aids with metres at the end of outages of a minute in which the filter has the aids: with everything known but this finding.

    Parameters
    ----------
    prepared : Prepared
        The filter that uses no aid.
    aids : sequence of AidRecord
        Less what is known of them.
    findings : sequence of Finding
        About these.
    struck : mapping of str to array
        Times of outliers by kind of aid, s, which are left out where they are known.
    """
    if not findings:
        return []
    t = prepared.imu.t
    starts = np.arange(t[0] + OUTAGE_S, t[-1] - OUTAGE_S, AIDED_APART_S)
    if not starts.size:
        return list(findings)
    gnss = prepared.gnss
    off = np.zeros(len(gnss), dtype=bool)
    for start in starts:
        off |= (gnss.t > start) & (gnss.t <= start + OUTAGE_S)
    gnss = scaled_fixes(gnss.rows(~off), prepared.factors)
    ends = np.searchsorted(t, starts + OUTAGE_S)
    span = float(t[-1] - t[0])
    beliefs = {name: for_filter(model, prepared.imu.dt, span) for name, model in prepared.beliefs.items()}

    def flown(known: Sequence[Finding]) -> FilterResult:
        uses = [use for finding in known for use in uses_of(finding, prepared.imu.dt)]
        outlying = {s.sensor for s in known if s.effect == "aid_outliers"}
        kept = [aid.without(struck[aid.kind]) if aid.kind in outlying else aid for aid in aids]
        uses += [use for use in prepared.nominal.effects if "widened" in use.effect.traits]
        corrected = [aid_corrected(aid, [u for u in uses if u.sensor == aid.kind], float(t[0])) for aid in kept]
        options = FilterOptions(covariance_at=tuple(t[ends]))
        return run_filter(
            prepared.imu, gnss, *prepared.start, beliefs, lever_arm=prepared.lever_arm, options=options, aids=corrected
        )

    best = flown(findings)
    out = []
    for k, finding in enumerate(findings):
        one = flown([s for i, s in enumerate(findings) if i != k])
        metres = np.hypot(*earth.position_difference(one.nav[ends, :3], best.nav[ends, :3])[:, :2].T)
        stated = np.einsum("kii->k", one.covariance[:, :2, :2])
        nees = 1.0 + float(np.mean(metres**2)) / max(float(np.mean(stated)), 1e-12)
        out.append(replace(finding, metres=float(np.sqrt(np.mean(metres**2))), aided_nees=nees))
    return out
