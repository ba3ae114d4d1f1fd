"""Effects that change covariances of the fixes: levels and colour of GNSS noise, weighed by a filter on the error of the nominal filter."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu.gap.evidence.climb import Ridge, laplace_many
from insemu.gap.evidence.linear import log_mean_exp
from insemu.gap.evidence.modes import Free, Mode, level
from insemu.gap.evidence.surrogate import PLAIN, Colour, FixNoise, Surrogate
from insemu.gap.policy import rules
from insemu.gap.verdict import Value

Array = NDArray[np.float64]
NED = ("north", "east", "down")
#: Components of the fixes that share one level: horizontal and vertical position, horizontal and vertical velocity.
LEVEL_GROUPS = ((0, 1), (2,), (3, 4), (5,))
#: Levels by effect, with the first of the three components that they are about.
LEVEL_ROWS = {"gnss_noise_level": 0, "gnss_velocity_noise": 3}
#: Axes that may have a level or a colour of their own.
GROUPS = (NED, ("north", "east"), ("down",), ("north",), ("east",))
#: Share of its tolerance beyond which a level next to a colour is at the edge, and one of any size is tried.
AT_EDGE = 0.9
#: Gain of a step at which a climb of the noise of the fixes ends, nats: a hundredth of the 3 nats that decide; each step costs filter runs.
CLOSE_NATS = 0.03
#: A colour that loses more wherever its climb may start is not climbed to, nats; where one of all axes loses more, no part of it is looked at.
LEAST_NATS, HOPELESS_NATS = -2.0, -30.0


def level_derivatives(variance: Array, white: Array, groups: Sequence[Sequence[int]]) -> list[Array]:
    """Derivatives (k, 6, 6) of the whitened innovation covariances by the logarithm of the fixes' standard deviations, by groups of components.

    Parameters
    ----------
    variance : (k, 6) array
        Believed variances.
    white : (k, 6, 6) array
        Inverse Cholesky factors of the innovation covariances.
    """
    out = []
    for rows in groups:
        half = white[:, :, list(rows)] * np.sqrt(2.0 * variance[:, None, list(rows)])
        out.append(half @ np.transpose(half, (0, 2, 1)))
    return out


def level_scores(s: Surrogate, white: Array, y: Array, groups: Sequence[Sequence[int]]) -> tuple[Array, Array]:
    """Score and information of the logarithm of the fixes' standard deviations, by groups of components.

    Parameters
    ----------
    white : (f, 6, 6) array
        Inverse Cholesky factors of the innovation covariances.
    y : (f, 6) array
        Whitened innovations; zero where missing.
    groups : sequence of component lists

    Returns
    -------
    score (g,), information (g, g)
        To first order in the levels; fixes that are outlying in the position or the velocity are left out.
    """
    outlying = (np.sum(y[:, :3] ** 2, axis=1) > 25.0) | (np.sum(y[:, 3:] ** 2, axis=1) > 25.0)
    v = y[~outlying]
    parts = level_derivatives(s.R[~outlying], white[~outlying], groups)
    score = np.array([0.5 * float(np.einsum("ki,kij,kj->", v, d, v) - np.einsum("kii->", d)) for d in parts])
    information = np.array([[0.5 * float(np.einsum("kij,kij->", a, b)) for b in parts] for a in parts])
    return score, information


@dataclass(frozen=True)
class NoiseFit:
    """Evidence of one covariance effect with its best parameters and axes."""

    effect: str
    axes: tuple[str, ...]
    nats: float
    values: tuple[Value, ...]
    factor: Array
    colour: Colour | None


def gnss_noise_fits(
    s: Surrogate,
    base: float,
    white: Array,
    y: Array,
    *,
    trimmed: Array,
    skip: Sequence[str] = (),
    named: NDArray[np.bool_] | None = None,
) -> list[NoiseFit]:
    """Weigh other GNSS noise levels, other velocity noise and coloured position noise, where no colour was found yet.

    Parameters
    ----------
    s : Surrogate
        Of the innovations less what is explained already.
    base : float
        Its log-likelihood.
    white, y : arrays
        See :func:`level_scores`: levels that the score makes hopeless are not computed.
    trimmed : (6,) array
        By what the filter's standard deviations were trimmed already: the levels that count are relative to the nominal ones.
    skip : sequence of str
        Effects that are not weighed.
    named : (6,) array of bool, optional
        Components whose level was named already.
    """
    problems = _levels(s, white, y, trimmed, skip, np.zeros(6, dtype=bool) if named is None else named)
    kinds = [] if "gnss_correlated_noise" in skip else [c for c in _colours(s) if c]
    likely = _at_starts(s, [*problems, *(c[0] for c in kinds)])
    likely, first = likely[: len(problems)], likely[len(problems) :]
    # parts are looked at of whichever kind explains more from where it starts
    top = max(range(len(kinds)), key=lambda k: float(np.max(first[k])), default=None)
    if top is not None and np.max(first[top]) - base > HOPELESS_NATS:
        problems += [*(c[0] for c in kinds), *kinds[top][1:]]
        likely += [*first, *_at_starts(s, kinds[top][1:])]
    going: list[_Weighed] = []
    starts: list[Array] = []
    for p, values in zip(problems, likely, strict=False):
        priors = [sum(f.log_density(z) for f, z in zip(p.free, x, strict=True)) for x in p.starts]
        top = int(np.argmax(values + np.array(priors) if p.is_level else values))
        if p.is_level or values[top] - base > LEAST_NATS:
            going.append(p)
            starts.append(p.starts[top])
    modes = laplace_many(
        lambda points: s.log_likelihoods([going[k].noise(x) for k, x in points]),
        starts,
        [p.free for p in going],
        CLOSE_NATS,
        [p.effect for p in going],
    )
    fits = [p.fitted(mode, base) for p, mode in zip(going, modes, strict=True)]
    return [f for f in fits if f is not None]


def _at_starts(s: Surrogate, problems: Sequence[_Weighed]) -> list[Array]:
    """Log-likelihoods where the climb of each may start."""
    if not problems:
        return []
    values = s.log_likelihoods([p.noise(x) for p in problems for x in p.starts])
    return np.split(values, np.cumsum([len(p.starts) for p in problems])[:-1])


@dataclass(frozen=True)
class _Weighed:
    """One noise of the fixes with its free parameters: how they make levels and colours, and where its climb may start."""

    effect: str
    axes: tuple[str, ...]
    free: tuple[Free, ...]
    starts: Sequence[Array]
    noise: Callable[[Array], FixNoise]

    @property
    def is_level(self) -> bool:
        """Whether it is a level and no colour."""
        return len(self.free) == 1

    def fitted(self, mode: Mode, base: float) -> NoiseFit | None:
        """What it is worth at its best; ``None`` for a level within its tolerance."""
        noise, sd = self.noise(mode.x), np.sqrt(np.diag(mode.covariance))
        if self.is_level:
            if abs(mode.x[0]) < math.log1p(rules().tolerance):
                return None
            level = Value.positive("factor", math.exp(mode.x[0]), sd[0], "1")
            return NoiseFit(self.effect, self.axes, mode.evidence - base, (level,), noise.factor, None)
        values = colour_values(noise.colour, self.axes, {**{f"sigma_{a}": sd[0] for a in self.axes}, "tau": sd[1]})
        return NoiseFit(self.effect, self.axes, mode.evidence - base, values, noise.factor, noise.colour)


def colour_values(colour: Colour, axes: Sequence[str], sd: Mapping[str, float]) -> tuple[Value, ...]:
    """A colour as parameters of its effect.

    Parameters
    ----------
    colour : Colour
    axes : sequence of str
        Those that have it.
    sd : mapping of str to float
        Standard deviations of the logarithms of ``sigma_north`` ... and ``tau``.
    """
    given = {**{f"sigma_{a}": (float(colour.sigma[NED.index(a)]), "m") for a in axes}, "tau": (colour.tau, "s")}
    values = tuple(Value.positive(name, value, sd[name], unit) for name, (value, unit) in given.items())
    return (*values, Value("follows", 1.0, 1.0, 1.0, "1")) if colour.follows else values


def _any_size(settled: Array, rows: Sequence[int]) -> Free:
    """A level of some components over the known one, whose bounds are over the stated one."""
    known, edge = math.exp(float(np.mean(np.log(settled[list(rows)])))), 1.0 + rules().tolerance
    return Free("factor", min(rules().lowest_level / known, 1.0 / edge), max(rules().highest_level / known, edge))


def _levels(
    s: Surrogate, white: Array, y: Array, trimmed: Array, skip: Sequence[str], named: NDArray[np.bool_]
) -> list[_Weighed]:
    """Levels of the positions and velocities that are not named and that the score does not make hopeless."""
    out = []
    for effect, offset in LEVEL_ROWS.items():
        if effect in skip or not s.use[:, offset : offset + 3].any():
            continue
        for axes in GROUPS:
            rows = [offset + NED.index(a) for a in axes]
            if named[rows].any():
                continue
            score, information = level_scores(s, white, y, [rows])
            if 0.5 * float(score[0]) ** 2 / max(float(information[0, 0]), 1e-12) < 1.0:
                continue
            moved = float(np.mean(np.log(trimmed[rows])))

            def noise(x: Array, rows: list[int] = rows, moved: float = moved) -> FixNoise:
                factor = np.ones(6)
                factor[rows] = math.exp(x[0] - moved)
                return FixNoise(factor, PLAIN)

            # of the starts to either side the better one: the first step of a far level is a long one
            starts = [np.array([moved + sign * step]) for sign in (-1.0, 1.0) for step in (0.5, 1.5)]
            out.append(_Weighed(effect, axes, (_any_size(s.settled, rows),), starts, noise))
    return out


def _colours(s: Surrogate) -> list[list[_Weighed]]:
    """Gauss-Markov parts of the position fixes, in proportion to their believed standard deviations: as large throughout, and following these."""
    if not s.sigma()[:3].all():
        return []
    return [_of_kind(s, follows) for follows in ((False, True) if s.stated_vary(1.0 + rules().tolerance) else (False,))]


def _of_kind(s: Surrogate, follows: bool) -> list[_Weighed]:
    """Gauss-Markov parts of the position fixes of one kind."""
    sigma0 = s.sigma()
    span = float(s.t[-1] - s.t[0])
    step = float(np.median(np.diff(s.t)))
    free = (Free("ratio", *rules().colour_sizes), _times(s))
    grid = [np.log([r, t]) for r in (0.3, 0.8, 2.5, 8.0) for t in np.geomspace(4.0 * step, 0.25 * span, 4)]
    out = []
    for axes in GROUPS[:3]:
        rows = [NED.index(a) for a in axes]

        def noise(x: Array, rows: list[int] = rows) -> FixNoise:
            sigma = np.zeros(6)
            sigma[rows] = math.exp(x[0]) * sigma0[rows]
            return FixNoise(np.ones(6), Colour(sigma, math.exp(x[1]), follows))

        out.append(_Weighed("gnss_correlated_noise", axes, free, grid, noise))
    return out


@dataclass(frozen=True)
class JointNoise:
    """Colour and levels of the fixes together.

    Parameters
    ----------
    noise : FixNoise
        The most likely.
    sd : mapping of str to float
        Standard deviations of the logarithms of ``sigma_north`` ... and ``tau``; of those that are coloured; of levels of any size
        by :func:`level_name`.
    evidence : float
        Log evidence, nats.
    intervals : callable
        95 % intervals of what the colour has of these, as ratios to the most likely: some passes of the filter.
    """

    noise: FixNoise
    sd: dict[str, float]
    evidence: float
    intervals: Callable[[], dict[str, tuple[float, float]]]


def level_name(rows: Sequence[int]) -> str:
    """How a level of any size is called in :class:`JointNoise`.

    Parameters
    ----------
    rows : sequence of int
        Components of the fixes that have it.
    """
    return f"factor_{min(rows)}"


def joint_noise(s: Surrogate, begin: FixNoise, factors: Array, *, wide: Sequence[Sequence[int]] = ()) -> JointNoise:
    """Most likely colour together with the levels inside their tolerance: a level that was trimmed without the colour took some of it.

    The velocities' too: a filter that follows coloured positions is wrong about them.

    Parameters
    ----------
    s : Surrogate
        Of the innovations less what is explained.
    begin : FixNoise
        To begin with; the axes of its colour stay, horizontal and vertical standard deviation and the correlation time are refined.
    factors : (6,) array
        By what the filter's levels were moved already, as ratios to what was named or believed.
    wide : sequence of sequences of int
        Components with a common level each, which may have any size; without them each level stays within its tolerance.
    """
    colour, known = begin.colour, begin.known
    apart = {r for rows in wide for r in rows}
    groups = [rows for g in LEVEL_GROUPS if (rows := [r for r in g if r not in apart]) and s.use[:, rows].any()]
    within, groups = len(groups), groups + [list(rows) for rows in wide]
    parts = [rows for rows in groups if any(colour.sigma[r] > 0.0 for r in rows)] if not known else []
    count = len(parts) + (not known)
    usual = np.array([-float(np.mean(np.log(factors[rows]))) for rows in groups])
    # one level of several components is the same over what is stated of each; within their tolerance all move as they were trimmed
    even = [
        -u - np.log(factors[rows]) if k >= within else 0.0
        for k, (u, rows) in enumerate(zip(usual, groups, strict=True))
    ]
    levels = [level("factor", math.exp(u)) for u in usual[:within]]
    for u, rows in zip(usual[within:], groups[within:], strict=True):
        size = _any_size(s.settled, rows)
        levels.append(Free("factor", size.low * math.exp(u), size.high * math.exp(u)))
    free = (*(Free("ratio", 0.03, 30.0) for _ in parts), *(() if known else (_times(s, colour.tau),)), *levels)

    def unpack(x: Array) -> FixNoise:
        sigma, tau, factor = colour.sigma.copy(), colour.tau, np.ones(6)
        for k, rows in enumerate(parts):
            sigma[rows] *= math.exp(x[k])
        if not known:
            tau *= math.exp(x[len(parts)])
        for k, rows in enumerate(groups):
            factor[rows] = np.exp(x[count + k] + even[k])
        return replace(begin, factor=factor, colour=colour._replace(sigma=sigma, tau=tau))

    def likelihoods(points: Sequence[tuple[int, Array]]) -> Array:
        return s.log_likelihoods([unpack(x) for _, x in points])

    start = np.zeros(len(free))
    start[count:] = [float(np.mean(np.log(begin.factor[rows]))) for rows in groups]
    (mode,) = laplace_many(likelihoods, [start], [free], CLOSE_NATS)
    place = {f"sigma_{NED[r]}": k for k, rows in enumerate(parts) for r in rows if r < 3}
    if not known:
        place["tau"] = len(parts)
    place |= {level_name(rows): count + within + k for k, rows in enumerate(groups[within:])}

    def intervals() -> dict[str, tuple[float, float]]:
        # what a recording of few correlation times leaves open is how long and how large it is, together
        ridge = Ridge.along(likelihoods, mode, free, place["tau"])
        ends = {name: np.exp(np.array(ridge.interval(k)) - mode.x[k]) for name, k in place.items()}
        return {name: (float(low), float(high)) for name, (low, high) in ends.items()}

    sd = {name: math.sqrt(float(mode.covariance[k, k])) for name, k in place.items()}
    return JointNoise(unpack(mode.x), sd, mode.evidence, intervals)


def _times(s: Surrogate, tau: float = 1.0) -> Free:
    """Correlation times that fixes show, over ``tau``: from two intervals to half of their span."""
    return Free("tau", 2.0 * float(np.median(np.diff(s.t))) / tau, 0.5 * float(s.t[-1] - s.t[0]) / tau)


def levels_with_colour(
    s: Surrogate, noise: FixNoise, factors: Array, named: NDArray[np.bool_] | None = None
) -> list[NoiseFit]:
    """Other levels of the positions than the nominal ones next to a colour of the fixes, which is estimated again with them.

    Parameters
    ----------
    s, factors : Surrogate, (6,) array
        As :func:`joint_noise` takes them.
    noise : FixNoise
        Colour and levels as they are inside their tolerance.
    named : (6,) array of bool, optional
        Components whose level was named already.

    Returns
    -------
    list of NoiseFit
        None where the levels within their tolerance do not reach its edge; without a colour where the level leaves it nothing to explain.
    """
    edge = math.log1p(rules().tolerance)
    beyond = np.abs(np.log(noise.factor * factors)) > AT_EDGE * edge
    groups = [(axes, [NED.index(a) for a in axes]) for axes in GROUPS[:3]]
    tried = [
        (axes, rows) for axes, rows in groups if beyond[rows].any() and not (named is not None and named[rows].any())
    ]
    out: list[NoiseFit] = []
    within = joint_noise(s, noise, factors).evidence if tried else 0.0
    for axes, rows in tried:
        found, colour = joint_noise(s, noise, factors, wide=[rows]), True
        if not noise.known:
            plain = joint_noise(s, replace(noise, colour=PLAIN, known=True), factors, wide=[rows])
            if plain.evidence > found.evidence - rules().keep_nats:
                found, colour = plain, False
        ratio = float(found.noise.factor[rows[0]] * factors[rows[0]])
        if abs(math.log(ratio)) > edge:
            value = Value.positive("factor", ratio, found.sd[level_name(rows)], "1")
            gain, joint = found.evidence - within, found.noise
            out.append(
                NoiseFit("gnss_noise_level", axes, gain, (value,), joint.factor, joint.colour if colour else None)
            )
    return out


def pooled(fits: Sequence[NoiseFit]) -> float:
    """Evidence of an effect over the groups of axes that it may act on."""
    return log_mean_exp([f.nats for f in fits] + [-math.inf] * (len(GROUPS) - len(fits)))
