"""What an effect hidden in a drive or flight is worth, measured with the whole filter on a twin of the recording.

A shaped effect is worth half the squared whitened difference between the innovations of the recording and of its twin without the effect; nothing
here reads a signature. A random process is worth what the filter that believes in it scores above the one that does not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.trial.drives import Stage, scaled
from benchmarks.trial.hidden import Hidden
from insemu.effects import EFFECTS, EffectUse, having
from insemu.filters import FilterResult
from insemu.gap import rules
from insemu.gap.drive import Prepared
from insemu.gap.evidence import Colour, Surrogate
from insemu.noise import BI, GM, RW

Array = NDArray[np.float64]
#: No shaped effect is made larger than this many datasheet scales: what the motion does not show stays hidden.
LARGEST = 30.0
#: Slow processes with one size.
_DRAWN = having("process")
#: Effects that shift the innovations by something of known shape; with those whose covariance is known they can be measured.
_SHAPED = frozenset(e.id for e in EFFECTS.values() if e.size and e.id not in _DRAWN) | {"earth_rate"}
_MEASURED = _SHAPED | _DRAWN | {"gnss_noise_level", "gnss_velocity_noise", "gnss_correlated_noise"}


def paid(half_square: float) -> float:
    """Expected evidence of a shaped effect whose signal is worth ``half_square`` nats, its one number paid for."""
    return half_square - 0.5 * math.log1p(2.0 * half_square)


def whitened_difference(a: FilterResult, b: FilterResult) -> float:
    """Half the squared difference of two runs' innovations, whitened with the first one's covariance: nats."""
    total = 0.0
    _, here, there = np.intersect1d(a.fixes.t, b.fixes.t, return_indices=True)
    for k, j in zip(here, there, strict=True):
        rows = np.isfinite(a.fixes.innovation[k]) & np.isfinite(b.fixes.innovation[j])
        d = (b.fixes.innovation[j] - a.fixes.innovation[k])[rows]
        if d.size:
            total += 0.5 * float(d @ np.linalg.solve(a.fixes.S[k][np.ix_(rows, rows)], d))
    return total


def size_effect(
    s: Stage, clean: Callable[[], Prepared], use: EffectUse, hidden: Hidden, target: float
) -> tuple[EffectUse, Hidden]:
    """Give an effect the size at which it is worth ``target`` nats in this recording, or as large as it may get.

    A random process is sized by its own draw, which the trial repeats; its evidence is less than its signal's, so the target is raised.

    Parameters
    ----------
    s : Stage
        The recording.
    clean : callable
        Makes the nominal filter's run on the recording with nothing hidden.
    use : EffectUse
        The effect at its datasheet scale.
    hidden : Hidden
        What will be scored.
    target : float
        nats.
    """
    if not use.effect.size:
        return use, replace(hidden, nats=_level_nats(s, use))
    without = clean()
    half = whitened_difference(without.result, without.on(s.record((use,))).result)
    if not half > 0.0:
        return use, replace(hidden, nats=0.0)
    wanted = target if use.id not in _DRAWN else 3.0 * target + 10.0
    factor = min(math.sqrt(wanted / half), LARGEST)
    sized = scaled(use, factor)
    if use.id in _DRAWN:
        return sized, replace(hidden, strength=factor)
    # half - log(1 + 2 half) / 2 = 20 at half = 21.9
    return sized, replace(hidden, strength=factor, nats=paid(half * factor**2), scales_for_20=math.sqrt(21.9 / half))


def _level_nats(s: Stage, use: EffectUse) -> float:
    """Expected evidence of a level beyond its tolerance, n / 2 (r - 1 - log r), the level itself paid for; of a line, its frequency paid for."""
    if use.id == "vibration_line":
        axis = int(np.argmax(use["amplitude"]))
        n = s.truth[f"{use.sensor}_{'xyz'[axis]}"].processes[0].parameters["N"]
        span = float(s.imu.t[-1] - s.imu.t[0])
        half = span * (use["amplitude"][axis] / (2.0 * n)) ** 2
        return max(half - math.log(0.5 * len(s.imu)) - math.log1p(half), 0.0)
    count, edge = s.rate_hz * float(s.imu.t[-1] - s.imu.t[0]), 1.0 + rules().tolerance
    if use.id in ("gnss_noise_level", "gnss_velocity_noise"):
        # innovations hold more than the noise of the fixes, so this is an upper bound that a third of it stands for
        true, stated = (s.sigma, s.stated[0]) if use.id == "gnss_noise_level" else (s.sigma_v, s.stated[1])
        r = (np.maximum(np.array(use["factor"]) * true / stated / edge, 1.0)) ** 2
        return float(np.sum(0.5 * count * (r - 1.0 - np.log(r)))) / 3.0
    if use.id == "white_noise":
        axis = int(np.argmax(use["N"]))
        n = s.truth[f"{use.sensor}_{'xyz'[axis]}"].processes[0].parameters["N"]
        believed = s.nominal.beliefs[f"{use.sensor}_{'xyz'[axis]}"].processes[0].parameters["N"]
        ratio = max((n**2 + use["N"][axis] ** 2) / (edge * believed) ** 2, 1.0)
        return float(0.25 * len(s.imu) * (ratio - 1.0 - math.log(ratio)))
    return math.nan


def drawn_outliers(s: Stage, uses: Sequence[EffectUse], k: int) -> float:
    """What the outliers that were drawn add to the evidence, nats, the noise of their axis and everything else known; three numbers paid for.

    Parameters
    ----------
    s : Stage
        The recording.
    uses : sequence of EffectUse
        Every hidden effect.
    k : int
        Which of them are the outliers.
    """
    own = uses[k]
    axis = int(np.argmax(own["sigma"]))
    name, sigma = f"{own.sensor}_{'xyz'[axis]}", own["sigma"][axis]
    # as many draws of everything, so that only the outliers differ
    none = replace(own, values={**own.values, "sigma": tuple(1e-12 * v for v in own["sigma"])})
    some = [
        u for u in uses if u.inertial and u.id not in ("saturation", "quantization", "dropped_samples", "clock_drift")
    ]
    made, without = (s.record([v if u is own else u for u in some]).imu for v in (own, none))
    d = (getattr(made, own.sensor) - getattr(without, own.sensor))[:, axis] / made.widths()[:, 0]
    level = s.truth[name].processes[0].parameters["N"] ** 2
    level += sum(u["N"][axis] ** 2 for u in uses if u.id == "white_noise" and u.sensor == own.sensor)
    variance = level / made.dt
    wide, p = 1.0 + sigma**2 / variance, own.scalar("probability")
    x2 = d[np.abs(d) > 1e-6 * sigma] ** 2 / variance + 1.0
    share = math.log(p / (1.0 - p)) - 0.5 * math.log(wide) + 0.5 * x2 * (1.0 - 1.0 / wide)
    # ordinary samples pay for the outliers that they might be; those are four standard deviations wide at most
    paid_for = len(made) * p * (1.0 - math.erf(4.0 / math.sqrt(2.0 * wide)))
    gain = float(np.sum(np.log1p(np.exp(np.minimum(share, 700.0))))) - paid_for
    return max(gain - 3.0, 0.0)


def oracle(s: Stage, clean: Prepared, seen: Prepared, uses: Sequence[EffectUse], cut: float) -> float:
    """What knowing the truth is worth after ``cut``, nats per fix; NaN for effects that this does not cover (the fast ones and outliers).

    Shaped effects: the twin without them. Random processes of the IMU: the filter that believes in them. Levels of the fixes: the filter with the
    true ones. Coloured fixes: the surrogate with the true process.

    Parameters
    ----------
    clean, seen : Prepared
        The nominal filter on the twin in which nothing is hidden, and on the recording.
    cut : float
        s.
    """
    if not uses or any(u.id not in _MEASURED for u in uses):
        return math.nan
    knowing, colour = _knowing(clean, uses)
    best = knowing.on(s.record([u for u in uses if u.id not in _SHAPED])).result
    fixes = int(np.sum(seen.result.fixes.t > cut))
    return (_score(best, colour, cut) - _score(seen.result, None, cut)) / max(fixes, 1)


def _knowing(clean: Prepared, uses: Sequence[EffectUse]) -> tuple[Prepared, Colour | None]:
    """The filter that knows the processes and the levels of effects, not yet run, and the colour of the fixes."""
    beliefs = dict(clean.beliefs)
    factors = np.ones(6)
    colour = None
    for u in uses:
        if u.id in _DRAWN:
            k = int(np.argmax(u[u.effect.size]))
            value = u[u.effect.size][k]
            name = f"{u.sensor}_{'xyz'[k]}"
            process = (
                RW(value) if u.id == "random_walk" else BI(value) if u.id == "flicker" else GM(value, u["beta"][k])
            )
            beliefs[name] = beliefs[name] + process
        elif u.id == "gnss_noise_level":
            factors[:3] = u["factor"]
        elif u.id == "gnss_velocity_noise":
            factors[3:] = u["factor"]
        elif u.id == "gnss_correlated_noise":
            colour = Colour.of(u)
    return replace(clean, beliefs=beliefs, factors=clean.factors * factors), colour


def worth_beside(s: Stage, clean: Callable[[], Prepared], uses: Sequence[EffectUse], k: int) -> float:
    """What effect ``k`` is expected to add beside the other hidden ones, nats; NaN where it is none of those that can be measured.

    The filter knows the processes, levels and colours of the others, and how each of their shapes shifts the innovations but not how much:
    what lies in those directions counts for nothing. Effects of the samples alone are left out; they are seen there.

    Parameters
    ----------
    s : Stage
        The recording.
    clean : callable
        Makes the nominal filter's run on the recording with nothing hidden.
    uses : sequence of EffectUse
        Every hidden effect.
    k : int
        Which of them is meant.
    """
    if uses[k].id not in _MEASURED:
        return math.nan
    own = uses[k]
    some = [u for u in uses if u.id in _MEASURED]
    random = [u for u in some if u.id not in _SHAPED]
    knowing, colour = _knowing(clean(), [u for u in random if u is not own])
    base = knowing.on(s.record(random))
    surrogate = Surrogate.of(base.result)
    nu = base.result.fixes.innovation

    def shift(u: EffectUse) -> Array:
        fixes = knowing.on(s.record([*random, u])).result.fixes
        _, here, there = np.intersect1d(base.result.fixes.t, fixes.t, return_indices=True)
        rows = np.zeros_like(nu)
        rows[here] = np.nan_to_num(fixes.innovation[there] - nu[here])
        return white(rows)

    def white(rows: Array) -> Array:
        return np.asarray(surrogate.whiten(rows[:, :, None], None, colour)[0].ravel())

    directions = [shift(u) for u in some if u.id in _SHAPED and u is not own]
    basis = np.linalg.qr(np.stack(directions, axis=1))[0] if directions else np.zeros((nu.size, 0))
    if own.id in _SHAPED:
        d = shift(own)
        return paid(0.5 * float(d @ d - np.sum((basis.T @ d) ** 2)))
    full, both = _knowing(clean(), random)
    gain = _score(full.on(s.record(random)).result, both) - _score(base.result, colour)
    # shapes of unknown size follow some of what the process did
    return max(gain - 0.5 * float(np.sum((basis.T @ white(np.nan_to_num(nu))) ** 2)) - 3.0, 0.0)


def _score(result: FilterResult, colour: Colour | None, after: float = -math.inf) -> float:
    """Log score of the fixes of a run after a time, their colour known."""
    total = 0.0
    for k in np.flatnonzero(result.fixes.t > after):
        rows = np.isfinite(result.fixes.innovation[k])
        v, S = result.fixes.innovation[k][rows], result.fixes.S[k][np.ix_(rows, rows)]
        if v.size:
            total -= 0.5 * (float(v @ np.linalg.solve(S, v)) + float(np.linalg.slogdet(S)[1]))
    if colour is not None:
        whole = Surrogate.of(result)
        total += whole.log_likelihood(None, colour) - whole.log_likelihood()
        if math.isfinite(after):
            early = whole.until(after)
            total -= early.log_likelihood(None, colour) - early.log_likelihood()
    return total
