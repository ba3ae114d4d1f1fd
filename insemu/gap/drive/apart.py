"""Outliers among the positions or the velocities of a recording, told by a filter that hardly follows them.

A filter that follows an outlier takes the fixes after it for outliers too. So it looks at all again while it hardly follows those that were told,
until these stay the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from insemu.effects import EffectUse
from insemu.filters import FilterResult, log_density
from insemu.gap.evidence.surrogate import FixNoise, Surrogate
from insemu.gap.policy import rules
from insemu.records import GnssRecord

Array = NDArray[np.float64]
Run = Callable[[GnssRecord], FilterResult]
#: Times (f,) of positions (velocities), their innovations (f, 3), and the covariances (f, 3, 3) of these if they are no outliers: s, m (m/s), m^2.
Fixes = tuple[Array, Array, Array]
#: By effect: times (k,) of what is hardly followed, s, and standard deviations (3,) of an outlier.
Gone = Mapping[str, tuple[Array, Array]]
#: To all positions, or velocities, of each of these effects.
Seen = Callable[[Gone], dict[str, Fixes]]

#: First of the three components of a fix in which an effect makes outliers.
FIRST = {"gnss_outliers": 0, "gnss_velocity_outliers": 3}
#: Standard deviation of a fix that is hardly followed, over that of an outlier: the mean of a hundred such fixes is still as uncertain as a hundred
#: times an outlier, and taking its square off a covariance again rounds at 1e-10 of the variance of one.
LOOSE = 1e3
#: Most rounds in which outliers and filter are told apart; on rtkexp_drive, whose outliers come in runs of 20, one of the first three explains most.
MOST_ROUNDS = 10
#: Rounds in a row that explain less than an earlier one by what decides, after which none explained most in 14 searches on rtkexp_drive; answers of
#: ublox_mixed_nominal and of ``python -m tests.scoreboard`` are those of all rounds.
MOST_WORSE = 2


def log_odds(v: Array, S: Array, probability: float, sigma: Array) -> Array:
    """Log odds (k,) of positions or velocities to be outliers.

    Parameters
    ----------
    v, S : (k, 3), (k, 3, 3) arrays
        Innovations, and their covariances where they are none; m and m^2, or m/s.
    probability : float
        Share of outliers.
    sigma : (3,) array
        Their standard deviations, NED.
    """
    wide = log_density(v, S + np.diag(np.square(sigma)))
    return np.asarray(math.log(probability / (1.0 - probability)) + wide - log_density(v, S))


def log_mixture(v: Array, S: Array, probability: float, sigma: Array) -> Array:
    """Log densities (k,) of positions or velocities of which a share are outliers, without the constant.

    Parameters
    ----------
    v, S, probability, sigma : (k, 3), (k, 3, 3) arrays, float, (3,) array
        As :func:`log_odds` takes them.
    """
    plain = math.log1p(-probability) + log_density(v, S)
    return np.asarray(plain + np.logaddexp(0.0, log_odds(v, S, probability, sigma)))


def log_told(v: Array, S: Array, probability: float, sigma: Array, out: NDArray[np.bool_]) -> Array:
    """Log densities (k,) of positions or velocities of which it was told which are outliers, without the constant.

    Parameters
    ----------
    v, S, probability, sigma : (k, 3), (k, 3, 3) arrays, float, (3,) array
        As :func:`log_odds` takes them.
    out : (k,) array of bool
        Which are outliers.
    """
    plain = math.log1p(-probability) + log_density(v, S)
    return np.asarray(plain + np.where(out, log_odds(v, S, probability, sigma), 0.0))


def by_filter(run: Run, gnss: GnssRecord) -> Seen:
    """Positions and velocities as a filter sees them that hardly follows some.

    Parameters
    ----------
    run : callable
        The filter on fixes.
    gnss : GnssRecord
        With standard deviations.
    """

    def seen(gone: Gone) -> dict[str, Fixes]:
        more, loose = np.zeros((len(gnss), 6)), gnss
        for effect, (t, sigma) in gone.items():
            own, key = _rows(effect), ("pos_std_ned", "vel_std_ned")[FIRST[effect] // 3]
            more[np.isin(gnss.t, t), own] = (LOOSE * sigma) ** 2
            loose = replace(loose, **{key: np.sqrt(getattr(gnss, key) ** 2 + more[:, own])})
        fixes = run(loose).fixes
        S = fixes.S - more[np.searchsorted(gnss.t, fixes.t)][:, :, None] * np.eye(6)
        return {effect: _whole(fixes.t, fixes.innovation, S, effect) for effect in gone}

    return seen


def under_colour(s: Surrogate, noise: FixNoise, nu: Array | None = None) -> Seen:
    """Positions and velocities less what the fixes before say of a colour, which a filter on its error follows where the nominal filter cannot.

    Parameters
    ----------
    s : Surrogate
        Of a filter that does not follow the colour.
    noise : FixNoise
        Levels over that filter's, and the colour.
    nu : (f, 6) array, optional
        Innovations less what is explained, m and m/s; else all of them.
    """

    def seen(gone: Gone) -> dict[str, Fixes]:
        more = np.zeros((s.t.size, 6))
        for effect, (t, sigma) in gone.items():
            more[np.isin(s.t, t), _rows(effect)] = (LOOSE * sigma) ** 2
        v, S = s.ahead(s.nu if nu is None else nu, noise, more)
        there = np.where(s.use == 1, v, np.nan)
        return {effect: _whole(s.t, there, S, effect) for effect in gone}

    return seen


def less(seen: Seen, explained: Seen) -> Seen:
    """Positions and velocities as a filter sees them, less the part of them that is explained, as it sees that part."""

    def rest(gone: Gone) -> dict[str, Fixes]:
        out, known = seen(gone), explained(gone)
        for effect, (t, v, S) in out.items():
            _, own, at = np.intersect1d(t, known[effect][0], return_indices=True)
            v[own] -= known[effect][1][at]
            out[effect] = t, v, S
        return out

    return rest


def _rows(effect: str) -> slice:
    return slice(FIRST[effect], FIRST[effect] + 3)


def _whole(t: Array, v: Array, S: Array, effect: str) -> Fixes:
    """Those with all three components."""
    own = _rows(effect)
    there = np.isfinite(v[:, own]).all(axis=1)
    return t[there], v[there][:, own], S[there][:, own, own]


def led_away(values: Sequence[float]) -> bool:
    """Whether rounds that tell outliers explain so much less than an earlier one that those after them will, by what each explains in nats."""
    return len(values) > MOST_WORSE and max(values[-MOST_WORSE:]) < max(values) - rules().lead


def outlying(seen: Seen, known: Sequence[EffectUse], told: Mapping[str, Array]) -> dict[str, Array]:
    """By effect the times (k,) of the positions or velocities that are more likely outliers than not, s.

    All are told together: a filter that follows outliers among the velocities takes positions for outliers. One that leaves out fixes which are
    no outliers follows worse and takes more for outliers, so that of all rounds those count with which the fixes are most likely, those that
    were not told as no outliers however far off they are.

    Parameters
    ----------
    seen : callable
        From :func:`by_filter` or :func:`under_colour`.
    known : sequence of EffectUse
        Outliers of known share and size, each effect once.
    told : mapping of effect to (k,) array
        Times of those that were told before, s.
    """
    sigma = {use.id: np.array(use["sigma"]) for use in known}
    gone = best = {use.id: told.get(use.id, np.zeros(0)) for use in known}
    values: list[float] = []
    for _ in range(MOST_ROUNDS if known else 0):
        before, fixes = gone, seen({k: (t, sigma[k]) for k, t in gone.items()})
        gone, value = {}, 0.0
        for use in known:
            (t, v, S), share = fixes[use.id], use.scalar("probability")
            value += float(np.sum(log_told(v, S, share, sigma[use.id], np.isin(t, before[use.id])))) if t.size else 0.0
            gone[use.id] = t[log_odds(v, S, share, sigma[use.id]) > 0.0] if t.size else t
        if not values or value > max(values):
            best = before
        values.append(value)
        if all(np.array_equal(before[k], gone[k]) for k in gone) or led_away(values):
            break
    return best


def told_of(effects: Sequence[EffectUse], gnss: GnssRecord) -> list[EffectUse]:
    """The known outliers that fixes can have: those of velocities where there are any."""
    return [use for use in effects if use.id in FIRST and (FIRST[use.id] == 0 or gnss.vel_std_ned is not None)]


def without(gnss: GnssRecord, gone: Mapping[str, Array]) -> GnssRecord:
    """Fixes whose positions or velocities are missing at the times (k,) of outliers, s, by effect."""
    for effect, t in gone.items():
        gnss = gnss.without_positions(t) if FIRST[effect] == 0 else gnss.without_velocities(t)
    return gnss
