"""Outliers among the positions or the velocities of a recording, classified by what all other fixes say of each.

A filter that follows an outlier takes the fixes behind it for outliers too, and one that only looks ahead cannot tell an outlier from the fixes
before it. What those on both sides say of one is a smoother's, from one pass forward and one back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.effects import EffectUse
from insemu.filters import FilterResult, log_density
from insemu.gap.evidence.surrogate import WHITE, FixNoise, Surrogate
from insemu.records import GnssRecord

Array = NDArray[np.float64]
Run = Callable[[GnssRecord], FilterResult]
#: Times (k,) of positions (velocities), what is left of them (k, 3), and the covariances (k, 3, 3) of that if they are no outliers: s, m (m/s), m^2.
Fixes = tuple[Array, Array, Array]
#: By effect: times (k,) of outliers, s, and standard deviations (3,) of one.
Gone = Mapping[str, tuple[Array, Array]]
#: By effect: share of outliers, and standard deviations (3,) of one.
Known = Mapping[str, tuple[float, Array]]


class Seen(Protocol):
    """Positions and velocities as a filter sees them that expects outliers at some times."""

    def __call__(self, gone: Gone, until: float = math.inf, *, ahead: bool = False) -> dict[str, Fixes]:
        """All positions, or velocities, of each effect, less what others say of them.

        Parameters
        ----------
        gone : mapping of effect to (times, sigma)
            The outliers.
        until : float
            As if the recording ended then, s.
        ahead : bool
            Whether only the fixes before say something, else all others do.
        """


#: The filter on a recording, which hardly follows these outliers: what it sees is linear about where it was.
Look = Callable[[Gone], Seen]

#: First of the three components of a fix in which an effect makes outliers.
FIRST = {"gnss_outliers": 0, "gnss_velocity_outliers": 3}
#: Standard deviation of a fix that is hardly followed, over that of an outlier: the mean of a hundred such fixes is still as uncertain as a hundred
#: times an outlier, and taking its square off a variance again rounds at 1e-10 of the variance of one.
LOOSE = 1e3
#: Most that the variance of a fix is raised by, over its own, where a filter runs on it and where it is smoothed: beyond that the other fixes lose
#: their digits (outliers of 10 and 1,000 km: tests/test_gap_fixes.py).
MOST_LOOSE, MOST_WIDE = 1e12, 1e8
#: Fixes around one that is classified anew in which no other is: it says something of these. With 1 to 10 the outliers of ublox_mixed_nominal and
#: rtkexp_drive are the same, and those of thor75_uav_flight but for two; with none they went in turns.
APART = 5
#: Most times that all are looked at: 4 to 9 on real drives.
MOST_ROUNDS = 40
#: Most runs of the filter: where it flies without the outliers that it was led astray by, few others are classified.
MOST_RUNS = 4


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


def log_density_given(v: Array, S: Array, probability: float, sigma: Array, out: NDArray[np.bool_]) -> Array:
    """Log densities (k,) of positions or velocities of which it was classified which are outliers, without the constant.

    Parameters
    ----------
    v, S, probability, sigma : (k, 3), (k, 3, 3) arrays, float, (3,) array
        As :func:`log_odds` takes them.
    out : (k,) array of bool
        Which are outliers.
    """
    plain = math.log1p(-probability) + log_density(v, S)
    return np.asarray(plain + np.where(out, log_odds(v, S, probability, sigma), 0.0))


def under_colour(s: Surrogate, noise: FixNoise, nu: Array | None = None) -> Seen:
    """Positions and velocities as a filter on the error of the nominal filter sees them under a noise of the fixes.

    Parameters
    ----------
    s : Surrogate
        Of the nominal filter; under a colour of one that does not follow it.
    noise : FixNoise
        Levels over that filter's, and the colour.
    nu : (f, 6) array, optional
        Innovations less what is explained, m and m/s; else all of them.
    """
    whole = s.nu if nu is None else nu

    def seen(gone: Gone, until: float = math.inf, *, ahead: bool = False) -> dict[str, Fixes]:
        at = s if until == math.inf else s.until(until)
        more = np.zeros((at.t.size, 6))
        for effect, (t, sigma) in gone.items():
            own = _rows(effect)
            most = MOST_WIDE * at.R[:, own] * noise.factor[own] ** 2
            more[:, own] = np.where(np.isin(at.t, t)[:, None], np.minimum(sigma**2, most), 0.0)
        v, S = (at.ahead if ahead else at.leave_one_out)(whole[: at.t.size], noise, more)
        out = {}
        for effect in gone:
            own = _rows(effect)
            there = (at.use[:, own] == 1).all(axis=1)
            out[effect] = at.t[there], v[there][:, own], S[there][:, own, own]
        return out

    return seen


def always(seen: Seen) -> Look:
    """What is seen whatever outliers the nominal filter followed, as of a filter on its error."""
    return lambda _: seen


def by_filter(run: Run, gnss: GnssRecord) -> Look:
    """Positions and velocities as a filter sees them that hardly follows some.

    Parameters
    ----------
    run : callable
        The filter on fixes.
    gnss : GnssRecord
        With standard deviations.
    """

    def look(gone: Gone) -> Seen:
        more, loose = np.zeros((len(gnss), 6)), gnss
        for effect, (t, sigma) in gone.items():
            own, key = _rows(effect), ("pos_std_ned", "vel_std_ned")[FIRST[effect] // 3]
            variance = getattr(gnss, key) ** 2
            more[:, own] = np.where(np.isin(gnss.t, t)[:, None], hardly_followed(sigma, variance), 0.0)
            loose = replace(loose, **{key: np.sqrt(variance + more[:, own])})
        s = Surrogate.of(run(loose))
        return under_colour(replace(s, R=s.R - np.where(s.use == 1, more[np.searchsorted(gnss.t, s.t)], 0.0)), WHITE)

    return look


def hardly_followed(sigma: Array, variance: Array) -> Array:
    """What the variances (k, 3) of fixes are raised by so that a filter hardly follows outliers of standard deviations sigma (3,)."""
    return np.minimum((LOOSE * sigma) ** 2, MOST_LOOSE * variance)


def less(look: Look, explained: Seen) -> Look:
    """Positions and velocities as a filter sees them, less the part of them that is explained, as it sees that part."""

    def rest_of(seen: Seen) -> Seen:
        def rest(gone: Gone, until: float = math.inf, *, ahead: bool = False) -> dict[str, Fixes]:
            out, known = seen(gone, until, ahead=ahead), explained(gone, until, ahead=ahead)
            for effect, (t, v, S) in out.items():
                _, own, at = np.intersect1d(t, known[effect][0], return_indices=True)
                v[own] -= known[effect][1][at]
                out[effect] = t, v, S
            return out

        return rest

    return lambda gone: rest_of(look(gone))


def _rows(effect: str) -> slice:
    return slice(FIRST[effect], FIRST[effect] + 3)


def classified(
    seen: Seen, known: Known, gone: Mapping[str, Array], until: float = math.inf, since: float = -math.inf
) -> dict[str, Array]:
    """By effect the times (k,) of the positions or velocities that are more likely outliers than not, given all others, s.

    Each that is classified anew makes all of them more likely, so that it ends (iterated conditional modes, Besag 1986). From no outliers on,
    those that stand out most are classified first.

    Parameters
    ----------
    seen : callable
        From :func:`under_colour`, or what :func:`by_filter` returns sees.
    known : mapping of effect to (share, sigma)
    gone : mapping of effect to (k,) array
        Those that are taken for outliers at first, s.
    until : float
        As if the recording ended then, s.
    since : float
        Up to this time (s) it is settled which they are.
    """
    gone = {effect: np.asarray(gone.get(effect, np.zeros(0))) for effect in known}
    for _ in range(MOST_ROUNDS):
        fixes = seen({effect: (gone[effect], sigma) for effect, (_, sigma) in known.items()}, until)
        odds = {effect: log_odds(v, S, *known[effect]) if v.size else v[:, 0] for effect, (_, v, S) in fixes.items()}
        # by how much another answer is more likely, of each fix that of which this is more
        t = np.unique(np.concatenate([t for t, _, _ in fixes.values()]))
        gain, each = np.zeros(t.size), {}
        for effect, o in odds.items():
            at = fixes[effect][0]
            wrong = ((o > 0.0) != np.isin(at, gone[effect])) & (at > since)
            each[effect] = np.where(wrong, np.abs(o), 0.0)
            np.maximum.at(gain, np.searchsorted(t, at), each[effect])
        if not gain.any():
            break
        largest = scipy.ndimage.maximum_filter1d(gain, 2 * APART + 1, mode="constant")
        for effect, (at, _, _) in fixes.items():
            turn = (each[effect] > 0.0) & (each[effect] == largest[np.searchsorted(t, at)])
            gone[effect] = np.setxor1d(gone[effect], at[turn])
    return gone


def log_joint(seen: Seen, known: Known, gone: Mapping[str, Array], until: float = math.inf) -> float:
    """Log density of all positions and velocities of which it was classified which are outliers, without the constant.

    Parameters
    ----------
    seen, known, until
        As :func:`classified` takes them.
    gone : mapping of effect to (k,) array
        Times of the outliers, s.
    """
    fixes = seen({effect: (gone[effect], sigma) for effect, (_, sigma) in known.items()}, until, ahead=True)
    each = (log_density_given(v, S, *known[k], np.isin(t, gone[k])) for k, (t, v, S) in fixes.items() if t.size)
    return float(sum(np.sum(one) for one in each))


def outlying(look: Look, known: Sequence[EffectUse]) -> dict[str, Array]:
    """By effect the times (k,) of the positions or velocities that are more likely outliers than not, s.

    All are classified together: a filter that follows outliers among the velocities takes positions for outliers.

    Parameters
    ----------
    look : callable
        From :func:`by_filter`, or :func:`always` of what :func:`under_colour` returns.
    known : sequence of EffectUse
        Outliers of known share and size, each effect once.
    """
    given = {use.id: (use.scalar("probability"), np.array(use["sigma"])) for use in known}
    gone = {effect: np.zeros(0) for effect in given}
    for _ in range(MOST_RUNS if known else 0):
        before, seen = gone, look({effect: (gone[effect], sigma) for effect, (_, sigma) in given.items()})
        gone = classified(seen, given, gone)
        if all(np.array_equal(before[effect], gone[effect]) for effect in gone):
            break
    return gone


def known_outliers(effects: Sequence[EffectUse], gnss: GnssRecord) -> list[EffectUse]:
    """The known outliers that fixes can have: those of velocities where there are any."""
    return [use for use in effects if use.id in FIRST and (FIRST[use.id] == 0 or gnss.vel_std_ned is not None)]


def without(gnss: GnssRecord, gone: Mapping[str, Array]) -> GnssRecord:
    """Fixes whose positions or velocities are missing at the times (k,) of outliers, s, by effect."""
    for effect, t in gone.items():
        gnss = gnss.without_positions(t) if FIRST[effect] == 0 else gnss.without_velocities(t)
    return gnss
