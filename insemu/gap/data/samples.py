"""What the samples of an IMU show by themselves: stamps with gaps, values that pile up at a full scale; and the record with both mended."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray
from scipy.special import log_ndtr

from insemu.gap.data.counts import lattice, pile_evidence
from insemu.gap.data.lost import ABOVE_CHANCE, FEWEST_REPEATS, MOST_LOST, MOTION_S, filled, missed, places, runs
from insemu.gap.policy import rules
from insemu.gap.verdict import Finding, Member, Value
from insemu.noise import WN, NoiseModel
from insemu.records import ImuRecord

Array = NDArray[np.float64]

#: Samples on either side of a clipped stretch that say how the signal goes on.
NEIGHBOURS = 12
#: Stretches that tell how the signal changes around them, and the most whose uncertainty is carried on.
TELLING, CARRIED = 60, 200
_SENSORS = (("gyro", "rad/s"), ("accel", "m/s^2"))


@dataclass(frozen=True)
class Filled:
    """A stretch at the full scale, or lost, that was filled in: axis (0..5), when (s), and how uncertain its integral is (rad or m/s)."""

    axis: int
    start: float
    end: float
    sigma: float


@dataclass(frozen=True)
class Mended:
    """An IMU record after what its samples show was named and mended.

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


def mend(imu: ImuRecord, without: tuple[str, ...] = ()) -> Mended:
    """Name dropped samples and saturation and mend the record: gaps bridged, clipped stretches filled in."""
    findings: list[Finding] = []
    clipping: list[Filled] = []
    lost: list[Filled] = []
    gone = np.zeros(len(imu), dtype=np.bool_)
    counts = _counts(imu)  # of what was recorded: a bridge lies on no lattice
    if "quantization" not in without:
        findings += _lattices(imu, counts)
    if "dropped_samples" not in without:
        bridged = _bridge(imu)
        if bridged is not None:
            imu, gone, finding, lost = bridged
            findings.append(finding)
        let_go = _let_go(imu)
        if let_go is not None:
            imu, held, finding, more = let_go
            findings.append(finding)
            gone, lost = gone | held, lost + more
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
    carried, loss = _carried(imu, clipping, lost)
    noise = {"saturation": _as_noise(imu, clipping), "dropped_samples": _as_noise(imu, lost)}
    heard = _filled(imu, gone, np.random.default_rng(gone.size)) if gone.any() else imu
    return Mended(imu, heard, tuple(sorted(findings, key=lambda s: -s.nats)), carried, loss, noise)


def _filled(imu: ImuRecord, gone: NDArray[np.bool_], rng: np.random.Generator | None = None) -> ImuRecord:
    """A record with the samples of some rows drawn, or with their means."""
    width = MOTION_S / float(np.median(np.diff(imu.t)))
    return replace(
        imu, gyro=filled(imu.gyro[~gone], gone, width, rng), accel=filled(imu.accel[~gone], gone, width, rng)
    )


def _carried(imu: ImuRecord, clipping: list[Filled], lost: list[Filled]) -> tuple[tuple[Filled, ...], Array]:
    """The stretches that are carried one by one, least certain first beside the noise of their axis, and the white noise of the others.

    Errors over lost samples are as good as white noise where there are many of them.
    """
    noise = np.array([_noise(x) for x in imu.rates().T]) + 1e-300
    many = lost if len(lost) > CARRIED else []
    ranked = sorted(clipping if many else [*clipping, *lost], key=lambda c: -c.sigma / noise[c.axis])
    return tuple(ranked[:CARRIED]), _as_noise(imu, [*ranked[CARRIED:], *many])


def _as_noise(imu: ImuRecord, stretches: Sequence[Filled]) -> Array:
    """The white noise (6,) that errors over stretches make on each axis, squared."""
    total = np.zeros(6)
    for s in stretches:
        total[s.axis] += s.sigma**2
    return total / float(imu.t[-1] - imu.t[0])


def _counts(imu: ImuRecord) -> dict[str, dict[str, float]]:
    """Finding of the lattice that the samples of each axis lie on, by sensor; 0 where there is none."""
    widths = imu.widths()
    # the increment over a gap is short of what was lost or holds several
    steady = np.abs(np.diff(imu.t) / np.median(np.diff(imu.t)) - 1.0) < 0.05
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


def _bridge(imu: ImuRecord) -> tuple[ImuRecord, NDArray[np.bool_], Finding, list[Filled]] | None:
    step = np.diff(imu.t)
    dt = float(np.median(step))
    steady = np.abs(step / dt - 1.0) < rules().stray
    missing = np.round(step / dt).astype(int) - 1
    gaps = np.flatnonzero(
        (missing > 0) & (np.abs(step / dt - np.round(step / dt)) < rules().stray) & (step < rules().longest_gap_s)
    )
    if not gaps.size or steady.sum() + gaps.size < 0.98 * step.size or gaps.size > MOST_LOST * step.size:
        return None
    n = step.size + int(missing[gaps].sum())
    # a stamp that is missing is surprising by its share alone
    nats = gaps.size * (1.0 - math.log(gaps.size / n))
    finding = _lost(gaps.size, int(missing[gaps].sum()), n, nats, "samples")
    bridged = np.zeros(step.size, dtype=np.int64)
    bridged[gaps] = missing[gaps]
    at, empty = places(bridged)
    t = np.interp(np.arange(empty.size), at, imu.t)
    # what a row after a gap holds: the increment of one interval, the others lost, or of the whole gap; whichever fits its neighbours
    share = np.ones((len(imu), 1))
    share[gaps + 1] = missing[gaps, None] + 1.0
    columns: dict[str, Array] = {}
    stretches: list[Filled] = []
    for first, (name, _) in zip((0, 3), _SENSORS, strict=True):
        values_in, whole = np.array(getattr(imu, name)), False
        if imu.kind == "increment":
            neighbours = 0.5 * (values_in[gaps] + values_in[np.minimum(gaps + 2, len(imu) - 1)])
            lost, held = (
                float(np.sum(np.abs(values_in[gaps + 1] - neighbours * factor))) for factor in (1.0, share[gaps + 1])
            )
            whole = held < lost
            values_in /= share if whole else 1.0
        columns[name] = filled(values_in, empty, MOTION_S / dt)
        if whole:  # what was lost is known but for how it went about
            _keep_sums(columns[name], empty)
        else:
            stretches += _stretches(columns[name], empty, t, imu.kind, first)
    temperature = None if imu.temperature is None else np.interp(t, imu.t, imu.temperature)
    return ImuRecord(t, columns["gyro"], columns["accel"], imu.kind, temperature), empty, finding, stretches


def _let_go(imu: ImuRecord) -> tuple[ImuRecord, NDArray[np.bool_], Finding, list[Filled]] | None:
    """Rows that repeat the row before on all axes: the recorder read a sample twice and lost another; they are filled as gaps are."""
    held = imu.repeated()
    begin, end = runs(held)
    dt = float(np.median(np.diff(imu.t)))
    count = int(held.sum())
    if begin.size < FEWEST_REPEATS or count > MOST_LOST * held.size or np.max(end - begin) * dt > rules().longest_gap_s:
        return None
    # output counts repeat by themselves: on all axes at once as often as each does where not all of them do
    values = np.hstack([imu.gyro, imu.accel])[~held]
    chance = float(np.prod(np.maximum(np.mean(np.diff(values, axis=0) == 0.0, axis=0), 1.0 / len(values))))
    share = begin.size / held.size
    if share < ABOVE_CHANCE * chance:
        return None
    nats = begin.size * math.log(share / chance)
    imu = _filled(imu, held)
    stretches = [
        s for first, values in ((0, imu.gyro), (3, imu.accel)) for s in _stretches(values, held, imu.t, imu.kind, first)
    ]
    return imu, held, _lost(begin.size, count, held.size, nats, "held"), stretches


def _lost(bursts: int, lost: int, n: int, nats: float, variant: str) -> Finding:
    """Lost samples as a finding: share of samples that begin a burst, mean length of a burst."""
    share, length, spread = bursts / n, lost / bursts, 1.96 / math.sqrt(bursts)
    values = (
        Value("probability", share, share * math.exp(-spread), share * math.exp(spread), "1"),
        Value("burst", length, max(1.0, length * math.exp(-spread)), length * math.exp(spread), "1"),
    )
    return replace(_finding("dropped_samples", "imu", (), values, nats), variant=variant)


def _stretches(values: Array, empty: NDArray[np.bool_], t: Array, kind: str, first: int) -> list[Filled]:
    """The filled gaps of a sensor whose axes begin at ``first``, with how uncertain their integrals are."""
    dt = float(np.median(np.diff(t)))
    wrong = missed(values, empty, MOTION_S / dt)
    wrong *= 1.0 if kind == "increment" else dt
    begin, end = runs(empty)
    return [
        Filled(first + k, float(t[a - 1]), float(t[b - 1]), float(s))
        for a, b, each in zip(begin, end, wrong, strict=True)
        for k, s in enumerate(each)
    ]


def _keep_sums(filled_in: Array, empty: NDArray[np.bool_]) -> None:
    """Move each gap with the row behind it, which holds the mean of the whole gap, so that their sum is what was measured; in place."""
    for a, b in zip(*runs(empty), strict=True):
        rows = slice(a, b + 1)
        filled_in[rows] += filled_in[b] - filled_in[rows].mean(axis=0)


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
    dt = float(np.median(np.diff(t)))
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
        ratio = math.exp(-0.5 * alpha**2 - 0.5 * math.log(2.0 * math.pi) - float(log_ndtr(alpha)))
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
    beside = np.sort(np.stack([padded[k : k + n] for k in (0, 1, 3, 4)]), axis=0)
    away: Array = values - 0.5 * (beside[1] + beside[2])
    pieces = [np.median(np.abs(p)) for p in np.array_split(away, max(1, n // SCATTER_SAMPLES))]
    local = np.repeat(pieces, [p.size for p in np.array_split(away, len(pieces))])
    return np.where(np.abs(away) > rules().alone / 0.6745 * np.maximum(local, np.median(pieces)), away, 0.0)


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
