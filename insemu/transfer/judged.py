"""Held-out outages as the judge of a belief: how likely was the fix that ended each of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.augment import Extras
from insemu.errors import InputError
from insemu.filters import log_density
from insemu.transfer.levels import Estimate, Levels, estimated

Array = NDArray[np.float64]

#: Length of an outage, and time with fixes before the next, s.
OUTAGE_S, BETWEEN_S = 30.0, 30.0
#: Length of the stretches that are fitted and judged in turns, s. The first minute is fitted always: it tells the turn-on bias.
TURN_S = 120.0
#: Later starts of the whole pattern, s: with both, every second of a drive lies in an outage once.
SHIFTS = (0.0, 30.0)
#: Nothing is cut before the filter had so many seconds of fixes.
LEARNT_S = 60.0
#: Intervals between the fixes that factors are fitted on, s; 0: all fixes. Receivers smooth, and errors that last for seconds make sigmas look
#: too large and the IMU too noisy, the more the shorter the interval (ublox_mixed_nominal: sigma of position times 0.05 at all fixes, 1.5 at 20 s).
INTERVALS = (0.0, 5.0, 20.0)
#: The hand factor that a fitted one is held against.
BY_HAND = 10.0


@dataclass(frozen=True)
class Judged:
    """How a belief stood in outages that its factors were not chosen on.

    Parameters
    ----------
    name : str
    outages : int
    score : float
        Mean log density of the position that ended an outage.
    gain : (value, sd)
        Its mean difference to the static belief and the standard deviation of that mean, nats per outage.
    metres : float
        Root mean square of the horizontal error at the end, m.
    inside : float
        Share of ends inside their 95 % ellipsoid.
    """

    name: str
    outages: int
    score: float
    gain: tuple[float, float]
    metres: float
    inside: float


Spans = Sequence[tuple[float, float]]


def outages_of(levels: Levels, spans: Spans, shift: float) -> list[tuple[float, float]]:
    """Outages (start, end) inside spans.

    Parameters
    ----------
    levels : Levels
    spans : sequence of (from, to)
        s.
    shift : float
        Of the first outage of every span against the first that is possible, s.
    """
    t = levels.gnss.t
    out = []
    for start, end in spans:
        first = max(start, float(t[0]) + LEARNT_S) + shift
        starts = np.arange(first, min(end, float(t[-1])) - OUTAGE_S, OUTAGE_S + BETWEEN_S)
        out += [(float(s), float(s) + OUTAGE_S) for s in starts]
    return out


def ends(levels: Levels, factors: Sequence[float], outages: Sequence[tuple[float, float]]) -> Array:
    """Log density and squared normalised error of the position that ended each outage, and its horizontal error in m, (o, 3).

    Parameters
    ----------
    levels : Levels
    factors : sequence of float
    outages : sequence of (start, end)
        s.
    """
    t = levels.gnss.t
    withheld = np.zeros(t.size, dtype=bool)
    for a, b in outages:
        withheld |= (t > a) & (t < b)
    fixes = levels.fixes(factors, withheld)
    positions = np.flatnonzero(np.isfinite(fixes.innovation[:, :3]).all(axis=1))
    at = np.searchsorted(fixes.t[positions], [b for _, b in outages])
    k = positions[at[at < positions.size]]
    S, nu = fixes.S[k][:, :3, :3], fixes.innovation[k][:, :3]
    density = log_density(nu, S)
    nis = np.sum(nu * np.linalg.solve(S, nu[:, :, None])[:, :, 0], axis=1)
    return np.stack([density, nis, np.hypot(nu[:, 0], nu[:, 1])], axis=1)


def fitted(levels: Levels, spans: Spans, say: Callable[[str], None] = lambda _: None) -> tuple[Estimate, float]:
    """Factors from the fixes of some spans, and the interval between the fixes: the one whose factors predict outages there best.

    Parameters
    ----------
    levels : Levels
    spans : sequence of (from, to)
        s; outages are cut into them.
    say : callable, optional
        Told what is being done.
    """
    cuts = [cut for shift in SHIFTS if (cut := outages_of(levels, spans, shift))]
    best: tuple[float, Estimate, float] | None = None
    at = None
    for interval in INTERVALS if cuts else INTERVALS[:1]:
        say(f"factors from {len(spans)} stretches, " + (f"a fix every {interval:g} s" if interval else "all fixes"))
        found = estimated(levels.thinned(interval), spans, at)
        at = found.log
        factors = np.exp(found.log).tolist()
        score = sum(float(ends(levels, factors, cut)[:, 0].sum()) for cut in cuts)
        if best is None or score > best[0]:
            best = score, found, interval
    assert best is not None
    return best[1], best[2]


def judge(levels: Levels, say: Callable[[str], None] = lambda _: None) -> tuple[Judged, ...]:
    """The static belief, a hand factor on all noise of the IMU, and fitted factors in outages of stretches that they were not fitted on.

    Parameters
    ----------
    levels : Levels
        Constants of the IMU are carried with the fitted factors only.
    say : callable, optional
        Told what is being done.

    Raises
    ------
    InputError
        A drive too short for outages in two stretches, or none of them ends at a position.
    """
    t, alone = levels.gnss.t, replace(levels, extras=Extras())
    edges = np.append(np.arange(float(t[0]) + LEARNT_S, float(t[-1]), TURN_S), float(t[-1]) + 1.0).tolist()
    stretches = list(pairwise(edges))
    start = (float(t[0]), edges[0])
    rows: dict[str, list[Array]] = {"static": [], "by hand": [], "transferred": []}
    for own, other in ((stretches[::2], stretches[1::2]), (stretches[1::2], stretches[::2])):
        cuts = [cut for shift in SHIFTS if (cut := outages_of(levels, other, shift))]
        if not cuts:
            continue
        found, _ = fitted(levels, [start, *own], say)
        tried: Mapping[str, tuple[Levels, Sequence[float]]] = {
            "static": (alone, [1.0] * len(levels.names)),
            "by hand": (alone, [BY_HAND if not name.startswith("fixes") else 1.0 for name in levels.names]),
            "transferred": (levels, np.exp(found.log).tolist()),
        }
        for name, (carried, factors) in tried.items():
            rows[name] += [ends(carried, factors, cut) for cut in cuts]
    if not rows["static"]:
        raise InputError(
            f"the fixes last {t[-1] - t[0]:.0f} s, expected at least {LEARNT_S + 2 * OUTAGE_S:.0f} s to hold outages out"
        )
    static = np.concatenate(rows["static"])
    if not static.size:
        raise InputError(
            "no outage ends at a position that the filter takes, expected at least one; are nearly all fixes outliers by what is believed?"
        )
    return tuple(_judged(name, np.concatenate(found), static) for name, found in rows.items())


def _judged(name: str, own: Array, static: Array) -> Judged:
    gain = own[:, 0] - static[:, 0]
    n = gain.size
    sd = float(np.std(gain, ddof=1) / math.sqrt(n)) if n > 1 else math.nan
    inside = float(np.mean(own[:, 1] < scipy.special.chdtri(3, 0.05)))
    metres = float(np.sqrt(np.mean(own[:, 2] ** 2)))
    return Judged(name, n, float(own[:, 0].mean()), (float(gain.mean()), sd), metres, inside)
