"""What the samples of an IMU show by themselves: stamps with gaps, values that pile up at a full scale; and the record with both repaired."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.gap.data.counts import lattice, pile_evidence
from insemu.gap.policy import rules
from insemu.gap.verdict import Finding, Member, Value
from insemu.lost import Filled, Lost, as_noise, drawn, restored, runs
from insemu.noise import WN, NoiseModel
from insemu.records import ImuRecord
from insemu.sample_times import beat

Array = NDArray[np.float64]

#: Samples on either side of a clipped stretch that say how the signal goes on.
NEIGHBOURS = 12
#: Stretches that tell how the signal changes around them, and the most whose uncertainty is carried on.
TELLING, CARRIED = 60, 200
_SENSORS = (("gyro", "rad/s"), ("accel", "m/s^2"))


@dataclass(frozen=True)
class Repaired:
    """An IMU record after what its samples show was named and repaired.

    Parameters
    ----------
    imu : ImuRecord
        With what fills a gap best, for a filter.
    heard : ImuRecord
        With lost samples that are as noisy as the others, for a spectrum.
    findings : tuple of Finding
    filled : tuple of Filled
        Stretches whose uncertainty is carried one by one.
    loss : (6,) array
        White noise that all other stretches add to an axis, squared: (rad/s)^2/Hz and (m/s^2)^2/Hz.
    noise : mapping of effect to (6,) array
        That of all stretches of an effect, in the same unit.
    """

    imu: ImuRecord
    heard: ImuRecord
    findings: tuple[Finding, ...]
    filled: tuple[Filled, ...] = ()
    loss: Array = field(default_factory=lambda: np.zeros(6))
    noise: Mapping[str, Array] = field(default_factory=dict)


def repair(imu: ImuRecord, without: tuple[str, ...] = (), filled: tuple[str, ...] = ()) -> Repaired:
    """Name lost samples and saturation and repair the record: gaps and clipped stretches filled in.

    Parameters
    ----------
    imu : ImuRecord
    without : tuple of str
        Effects that are not looked for.
    filled : tuple of str
        Effects of which the noise that is believed holds already what filling leaves open.
    """
    findings: list[Finding] = []
    clipping: list[Filled] = []
    lost: tuple[Lost, ...] = ()
    counts = _counts(imu)  # of what was recorded: a bridge lies on no lattice
    if "quantization" not in without:
        findings += _lattices(imu, counts)
    if "dropped_samples" not in without:
        imu, lost = restored(imu, rules().stray, rules().longest_gap_s)
        findings += [_lost(each) for each in lost]
    if "saturation" not in without:
        for first, (sensor, unit) in zip((0, 3), _SENSORS, strict=True):
            values = np.array(getattr(imu, sensor))
            widths = imu.widths()
            rates = values / widths
            for k, axis in enumerate("xyz"):
                found = clipped(rates[:, k], counts[sensor][axis])
                if found is None:
                    continue
                limit, at, nats = found
                rates[:, k], around = unclipped(imu.t, rates[:, k], at)
                clipping += [Filled(first + k, *stretch) for stretch in around]
                value = Value("limit", limit, limit, limit, unit)
                findings.append(_finding("saturation", sensor, (axis,), (value,), nats))
                imu = replace(imu, gyro=rates * widths) if sensor == "gyro" else replace(imu, accel=rates * widths)
    stretches = [] if "dropped_samples" in filled else [s for each in lost for s in each.stretches]
    clipping = [] if "saturation" in filled else clipping
    duration = float(imu.t[-1] - imu.t[0])
    carried, loss = _carried(imu, clipping, stretches)
    noise = {"saturation": as_noise(clipping, duration), "dropped_samples": as_noise(stretches, duration)}
    heard = drawn(imu, lost, np.random.default_rng(len(imu)))
    return Repaired(imu, heard, tuple(sorted(findings, key=lambda s: -s.nats)), carried, loss, noise)


def _carried(imu: ImuRecord, clipping: list[Filled], lost: list[Filled]) -> tuple[tuple[Filled, ...], Array]:
    """The stretches that are carried one by one, least certain first beside the noise of their axis, and the white noise of the others.

    Errors over lost samples are as good as white noise where there are many of them.
    """
    noise = np.array([_noise(x) for x in imu.rates().T]) + 1e-300
    many = lost if len(lost) > CARRIED else []
    ranked = sorted(clipping if many else [*clipping, *lost], key=lambda c: -c.sigma / noise[c.axis])
    return tuple(ranked[:CARRIED]), as_noise([*ranked[CARRIED:], *many], float(imu.t[-1] - imu.t[0]))


def _counts(imu: ImuRecord) -> dict[str, dict[str, float]]:
    """Finding of the lattice that the samples of each axis lie on, by sensor; 0 where there is none."""
    widths = imu.widths()
    # the increment over a gap is short of what was lost or holds several
    steady = np.abs(np.diff(imu.t) / imu.dt - 1.0) < 0.05
    out = {}
    for sensor, _ in _SENSORS:
        rates = (np.array(getattr(imu, sensor)) / widths)[1:]
        out[sensor] = {axis: lattice(rates[steady, k]) for k, axis in enumerate("xyz")}
    return out


def _lattices(imu: ImuRecord, counts: dict[str, dict[str, float]]) -> list[Finding]:
    """Axes whose samples lie on a lattice of output counts."""
    widths = imu.widths()
    out = []
    for sensor, unit in _SENSORS:
        rates = np.array(getattr(imu, sensor)) / widths
        steps = counts[sensor]
        # finer than that it is the digits of a file
        least = rules().material_lsb * np.array([_noise(rates[:, k]) for k in range(3)])
        on = tuple(axis for axis, low in zip("xyz", least, strict=True) if steps[axis] > low)
        if not on:
            continue
        names = {axis: "lsb" if len(on) == 1 else f"lsb_{axis}" for axis in on}
        values = tuple(Value(names[a], steps[a], steps[a], steps[a], unit) for a in on)
        # as for a log at rest: each sample is worth log(LSB / resolution of the storage)
        top = np.max(np.abs(rates), axis=0)
        nats = sum(
            len(imu) * max(math.log(steps[a] / (max(top["xyz".index(a)], steps[a]) * 2.0**-24)), 0.0) for a in on
        )
        out.append(_finding("quantization", sensor, on, values, nats))
    return out


def coarse(beliefs: dict[str, NoiseModel], findings: Sequence[Finding], dt: float) -> set[str]:
    """Axes whose output counts are coarse beside their white noise.

    Parameters
    ----------
    beliefs : mapping of axis to NoiseModel
        Believed noise.
    findings : sequence of Finding
        Those of the effect ``quantization`` state the counts, SI.
    dt : float
        Sampling interval, s.
    """
    out = set()
    for s in findings:
        if s.effect == "quantization":
            for axis, v in zip(s.axes, s.parameters, strict=True):
                name = f"{s.sensor}_{axis}"
                white = sum(p.parameters["N"] ** 2 for p in beliefs[name] if isinstance(p, WN))
                if v.value > rules().coarse_lsb * math.sqrt(white / dt):
                    out.add(name)
    return out


def with_counts(beliefs: dict[str, NoiseModel], findings: Sequence[Finding], dt: float) -> dict[str, NoiseModel]:
    """Beliefs with the white noise that rounding to output counts adds, LSB^2 / 12 per sample.

    Parameters
    ----------
    beliefs : mapping of axis to NoiseModel
        Believed noise; a model without white noise stays as it is.
    findings : sequence of Finding
        Those of the effect ``quantization`` state the counts (LSB), SI.
    dt : float
        Sampling interval, s.
    """
    out = dict(beliefs)
    for s in findings:
        if s.effect == "quantization":
            for axis, v in zip(s.axes, s.parameters, strict=True):
                name = f"{s.sensor}_{axis}"
                out[name] = louder(out[name], v.value**2 / 12.0 * dt)
    return out


def louder(model: NoiseModel, more: float) -> NoiseModel:
    """A model with more white noise, ``more`` the square of its density; one without white noise stays as it is."""
    whites = [p for p in model if isinstance(p, WN)]
    if not whites or more == 0.0:
        return model
    level = math.sqrt(whites[0].parameters["N"] ** 2 + more)
    return NoiseModel(tuple(WN(level) if p is whites[0] else p for p in model))


def advanced(imu: ImuRecord, sensor: str, by: float) -> ImuRecord:
    """The record with the samples of one sensor set forward in time; the last ones hold.

    Parameters
    ----------
    imu : ImuRecord
        The record.
    sensor : str
        ``gyro`` or ``accel``.
    by : float
        s.
    """
    from scipy.interpolate import CubicSpline

    values = getattr(imu, sensor)
    at = np.minimum(imu.t + by, imu.t[-1])
    if imu.kind != "increment":
        moved = CubicSpline(imu.t, values)(at)
    else:
        # the same angle or velocity, gathered between later instants
        edges = np.concatenate([[2 * imu.t[0] - imu.t[1]], imu.t])
        total = np.concatenate([np.zeros((1, 3)), np.cumsum(values, axis=0)])
        inside = np.minimum(edges + by, edges[-1])
        moved = np.diff(CubicSpline(edges, total)(inside), axis=0)
        moved[inside[1:] >= edges[-1]] = values[-1]
    return replace(imu, gyro=moved) if sensor == "gyro" else replace(imu, accel=moved)


def _finding(effect: str, sensor: str, axes: tuple[str, ...], values: tuple[Value, ...], nats: float) -> Finding:
    return Finding(effect, "samples", sensor, axes, values, 0.999, nats, (Member(effect, sensor, axes, nats),))


def _lost(lost: Lost) -> Finding:
    """Lost samples as a finding: share of samples that begin a burst, mean length of a burst."""
    share, length = lost.bursts / lost.rows.size, float(lost.rows.sum()) / lost.bursts
    spread = 1.96 / math.sqrt(lost.bursts)
    values = (
        Value("probability", share, share * math.exp(-spread), share * math.exp(spread), "1"),
        Value("burst", length, max(1.0, length * math.exp(-spread)), length * math.exp(spread), "1"),
    )
    finding = _finding("dropped_samples", "imu", (), values, lost.nats)
    return replace(finding, variant="held" if lost.held else "samples")


def clipped(rates: Array, step: float = 0.0) -> tuple[float, NDArray[np.bool_], float] | None:
    """Full scale at which values pile up, which samples lie there, and the evidence in nats; None where there is no pile.

    Noise never repeats an extreme value exactly. On a lattice of output counts, ``step`` apart, it does; there the pile is held against the two
    counts inside of it.
    """
    noise = 1.4826 * float(np.median(np.abs(np.diff(rates)))) + 1e-300
    at = np.zeros(rates.size, dtype=bool)
    limits, nats = [], 0.0
    for side in (1.0, -1.0):
        x = side * rates
        top = float(x.max())
        pile = x > top - 0.5 * step if step > 0.0 else x >= top - 1e-9 * abs(top)
        count = int(pile.sum())
        if count < rules().fewest_clipped or count >= 0.5 * rates.size or not top > 0.0:
            continue
        if step > 0.0:
            evidence = pile_evidence(*(int(np.sum(np.abs(x - top + k * step) < 0.5 * step)) for k in range(3)))
            if evidence < rules().pile_nats:
                continue
        else:
            evidence = count * max(1.0, math.log(noise / (top * 2.0**-24)))
        at |= pile
        limits.append(top)
        nats += evidence
    if not limits or max(limits) > 1.2 * min(limits):
        return None
    return float(np.mean(limits)), at, nats


def _noise(rates: Array) -> float:
    """Standard deviation of the samples about whatever smooth motion they follow."""
    return 1.4826 * float(np.median(np.abs(np.diff(rates, 3)))) / math.sqrt(20.0)


def unclipped(t: Array, rates: Array, at: NDArray[np.bool_]) -> tuple[Array, list[tuple[float, float, float]]]:
    """Clipped stretches filled in by what the samples around them say, and start (s), end (s) and uncertainty of the integral of each.

    The signal's rate of change is taken for a random walk, its strength and the samples' noise for the most likely ones around all
    stretches together (a cubic smoothing spline: Wahba 1978); that every clipped sample lies outside of the limit is held against the
    integral of its stretch.

    Parameters
    ----------
    t, rates : (n,) arrays
    at : (n,) array of bool
        Samples at the full scale.
    """
    dt = beat(t)
    noise = _noise(rates) ** 2 + 1e-300
    stretches = []
    for first, last in zip(*runs(at), strict=True):
        near = np.arange(max(0, first - NEIGHBOURS), min(rates.size, last + NEIGHBOURS))
        known = ~at[near]
        if min((known & (near < first)).sum(), (known & (near >= last)).sum()) >= 3:
            x = (t[near] - t[near[0]]) / dt
            trend = np.polynomial.Polynomial.fit(x[known], rates[near[known]], 1)(x)
            stretches.append((first, last, near, known, x, trend))
    if not stretches:
        return rates, []

    def covariances(x: Array, known: NDArray[np.bool_], y: Array) -> tuple[Array, Array]:
        low, high = np.minimum(x[:, None], x[None, :]), np.maximum(x[:, None], x[None, :])
        wide = 1e4 * max(float(np.mean(y[known] ** 2)), noise)
        return low**2 * (high / 2.0 - low / 6.0), wide * (1.0 + (x / x[-1])[:, None] * (x / x[-1])[None, :])

    prepared = [
        (first, last, near, known, trend, rates[near] - trend, *covariances(x, known, rates[near] - trend))
        for first, last, near, known, x, trend in stretches
    ]

    some_of = prepared[:: math.ceil(len(prepared) / TELLING)]

    def log_likelihood(q: float, r: float) -> float:
        total = 0.0
        for _, _, _, known, _, y, bent, straight in some_of:
            some = np.ix_(known, known)
            L = np.linalg.cholesky(q * bent[some] + straight[some] + r * np.eye(int(known.sum())))
            z = np.linalg.solve(L, y[known])
            total -= 0.5 * float(z @ z) + float(np.sum(np.log(np.diag(L))))
        return total

    grid = [(noise * q, noise * r) for q in np.geomspace(1e-6, 1e4, 21) for r in (0.1, 0.3, 1.0, 3.0)]
    q, r = max(grid, key=lambda x: log_likelihood(*x))
    out, said = rates.copy(), []
    for first, last, near, known, trend, y, bent, straight in prepared:
        hidden = (near >= first) & (near < last)
        full = q * bent + straight
        gain = np.linalg.solve(full[np.ix_(known, known)] + r * np.eye(int(known.sum())), full[np.ix_(known, hidden)]).T
        mean = gain @ y[known] + trend[hidden]
        spread = full[np.ix_(hidden, hidden)] - gain @ full[np.ix_(known, hidden)]
        side = math.copysign(1.0, rates[first])
        beyond = float(np.sum(side * (mean - rates[first:last])))
        weight = spread.sum(axis=1)
        own = max(float(weight.sum()), 0.0)
        both = own + r * (last - first)
        # moments of a normal above zero
        alpha = beyond / math.sqrt(both)
        ratio = math.exp(-0.5 * alpha**2 - 0.5 * math.log(2.0 * math.pi) - float(scipy.special.log_ndtr(alpha)))
        out[first:last] = mean + side * weight * ratio / math.sqrt(both)
        own -= own**2 / both * ratio * (ratio + alpha)
        said.append((float(t[first]) - dt, float(t[last - 1]), math.sqrt(max(own, 0.0)) * dt))
    return out, said


#: Samples over which the scatter about the neighbours is taken.
SCATTER_SAMPLES = 256


def spikes(values: Array) -> Array:
    """By how much single samples stand out from the two on either side of them, zero elsewhere.

    A filter would spread them over their neighbours.
    """
    padded = np.pad(values, 2, mode="edge")
    n = values.size
    a, b, c, d = (padded[k : k + n] for k in (0, 1, 3, 4))
    # the middle two of the four neighbours
    one = np.maximum(np.minimum(a, b), np.minimum(c, d))
    other = np.minimum(np.maximum(a, b), np.maximum(c, d))
    away: Array = values - 0.5 * (one + other)
    size = np.abs(away)
    # pieces of nearly equal length, the longer ones first
    count = max(1, n // SCATTER_SAMPLES)
    short, more = divmod(n, count)
    long = more * (short + 1)
    parts = size[:long].reshape(more, short + 1), size[long:].reshape(count - more, short)
    pieces = np.concatenate([np.median(part, axis=1) for part in parts])
    local = np.repeat(pieces, np.where(np.arange(count) < more, short + 1, short))
    return np.where(size > rules().alone / 0.6745 * np.maximum(local, np.median(pieces)), away, 0.0)


def without_motion(values: Array, dt: float, corner: float, whole: bool = False) -> Array:
    """A signal without what is slower than ``corner`` Hz, its ends left out.

    Manoeuvres are a billion times stronger than the noise a few Hz above them; no taper alone keeps them out of a spectrum.

    Parameters
    ----------
    values : (n,) array
        Samples.
    dt : float
        Sampling interval, s.
    corner : float
        Corner of the high-pass, Hz.
    whole : bool
        Whether the ends are kept.
    """
    sections = scipy.signal.butter(6, corner, "highpass", fs=1.0 / dt, output="sos")
    edge = 0 if whole else min(round(6.0 / (corner * dt)), values.size // 20)
    single = spikes(values)
    out = scipy.signal.sosfiltfilt(sections, values - single) + single
    return np.ascontiguousarray(out[edge : out.size - edge])
