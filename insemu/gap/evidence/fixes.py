"""Effects that change covariances of the fixes: levels and colour of GNSS noise, weighed by a filter on the error of the nominal filter."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from insemu.filters import FilterResult
from insemu.gap.evidence import error_kernels
from insemu.gap.evidence.climb import Ridge, laplace_together
from insemu.gap.evidence.lanes import LANES
from insemu.gap.evidence.linear import log_mean_exp
from insemu.gap.evidence.merged import between_fixes, merged_states
from insemu.gap.evidence.modes import Free, Mode, level
from insemu.gap.policy import rules
from insemu.gap.verdict import Value

Array = NDArray[np.float64]
#: Standard deviations (6,) in m and m/s and correlation time in s of a Gauss-Markov part of the fixes.
Colour = tuple[Array, float]
NED = ("north", "east", "down")
#: Components of the fixes that share one level: horizontal and vertical position, horizontal and vertical velocity.
LEVEL_GROUPS = ((0, 1), (2,), (3, 4), (5,))
#: Levels by effect, with the first of the three components that they are about.
LEVEL_ROWS = {"gnss_noise_level": 0, "gnss_velocity_noise": 3}
#: Axes that may have a level or a colour of their own.
GROUPS = (NED, ("north", "east"), ("down",), ("north",), ("east",))
#: Share of its tolerance beyond which a level beside a colour is at the edge, and one of any size is tried.
AT_EDGE = 0.9
#: Gain of a step at which a climb of the noise of the fixes ends, nats: a hundredth of the 3 nats that decide; each step costs filter runs.
CLOSE_NATS = 0.03
#: A colour that loses more wherever its climb may start is not climbed to, nats; where one of all axes loses more, no part of it is looked at.
LEAST_NATS, HOPELESS_NATS = -2.0, -30.0


@dataclass(frozen=True)
class FixNoise:
    """Noise of the fixes beyond what the filter believed: levels (6,) as ratios to it, and a Gauss-Markov part, which stays where it is known."""

    factor: Array
    colour: Colour
    known: bool = False

    def loudness(self, sigma: Array) -> Array:
        """Standard deviations (6,) of the fixes, colour included, over those that the filter believed, ``sigma`` (m, m/s; 0 where unknown)."""
        known = sigma > 0.0
        return np.where(known, np.hypot(self.factor, self.colour[0] / np.where(known, sigma, 1.0)), 1.0)

    def apart(self, sigma: Array) -> tuple[Array, FixNoise]:
        """Ratios (6,) of standard deviations for a filter that does not follow the colour, and what this noise is to that filter.

        Parameters
        ----------
        sigma : (6,) array
            As in :meth:`loudness`.
        """
        loud = self.loudness(sigma)
        return loud, replace(self, factor=self.factor / loud)


#: No Gauss-Markov part.
PLAIN: Colour = (np.zeros(6), 1.0)


@dataclass(frozen=True)
class Gains:
    """What a filter on the error of another one does with its innovations, whatever these are.

    Parameters
    ----------
    phi, variance : (f, 6), (6,) arrays
        Transition to each fix and variance of a Gauss-Markov part of the fixes.
    gain, root : (f, 6, m), (f, 6) arrays
        What a standard deviation of a component moves the states by, and that standard deviation.
    done : int
        Fixes up to the first whose variance is not positive.
    volume : float
        Log density of innovations of zero, without the constant; minus infinity where not all fixes are done.
    """

    phi: Array
    variance: Array
    gain: Array
    root: Array
    done: int
    volume: float


@dataclass(frozen=True)
class Surrogate:
    """The nominal filter seen from outside: transitions, gains and noises per fix, ready for :func:`error_kernels.surrogate_gains`.

    The noise of a fix counts as independent between its components; what the gyros' noise on the lever arm correlates is left out. ``settled`` (6,)
    is the level of each component that is known, over the stated one; ``first`` (6,) are variances of the fix that the filter started on, whose
    error is that of the start, as it believed them.
    """

    t: Array
    Phi: Array
    Q: Array
    K: Array
    H: Array
    R: Array
    P0: Array
    nu: Array
    use: NDArray[np.int64]
    settled: Array = field(default_factory=lambda: np.ones(6))
    first: Array = field(default_factory=lambda: np.zeros(6))

    @classmethod
    def of(cls, result: FilterResult) -> Surrogate:
        """From a stored run; nodes without a fix are joined to the next one with a fix."""
        nodes, fixes = result.nodes, result.fixes
        assert nodes is not None and fixes.K is not None and fixes.H is not None
        use = np.isfinite(fixes.innovation) & fixes.accepted[:, None]
        H = np.where(use[:, :, None], np.nan_to_num(fixes.H), 0.0)
        K = np.where(use[:, None, :], np.nan_to_num(fixes.K), 0.0)
        sums = merged_states(nodes.Phi[1:], H)
        first = sums.argmax(axis=1)
        at = np.searchsorted(nodes.epoch, fixes.epoch)
        since = np.diff(at, prepend=0)
        Phi, Q = between_fixes(nodes.Phi, nodes.P_before, nodes.P_after, at, sums.argmax(axis=0), first)
        S, before = np.nan_to_num(fixes.S), nodes.P_before[at]
        for k in np.flatnonzero(since == 0):
            if k > 0:  # the second fix of an epoch: the filter had the first one by then
                before[k] = before[k - 1] - K[k - 1] @ S[k - 1] @ K[k - 1].T
        believed = np.einsum("kii->ki", S) - np.sum((H @ before) * H, axis=2)
        return cls(
            fixes.t, Phi, Q, np.ascontiguousarray(sums @ K), np.ascontiguousarray(H[:, :, first]), np.where(use, believed, 0.0),
            sums @ nodes.P_after[0] @ sums.T, np.where(use, np.nan_to_num(fixes.innovation), 0.0), use.astype(np.int64),
        )  # fmt: skip

    def until(self, cut: float) -> Surrogate:
        """The fixes up to a time."""
        k = int(np.searchsorted(self.t, cut, side="right"))
        arrays = {name: getattr(self, name)[:k] for name in ("t", "Phi", "Q", "K", "H", "R", "nu", "use")}
        return replace(self, **arrays)

    def sigma(self) -> Array:
        """Median believed standard deviation of each component, (6,); zero where there is none."""
        out = np.zeros(6)
        for i in range(6):
            if self.use[:, i].any():
                out[i] = math.sqrt(float(np.median(self.R[self.use[:, i] == 1, i])))
        return out

    def whiten(self, columns: Array, factor: Array | None = None, colour: Colour | None = None) -> tuple[Array, float]:
        """Columns (f, 6, c) whitened under other levels and a Gauss-Markov part of the fixes, and the first one's log-likelihood.

        Parameters
        ----------
        columns : (f, 6, c) array
            Innovations or responses of them, m and m/s.
        factor : (6,) array, optional
            Ratios of the standard deviations of the fixes to those that the filter used.
        colour : (sigma (6,), tau), optional
            Standard deviations (m, m/s) and correlation time (s) of a Gauss-Markov part of the fixes.

        Returns
        -------
        white : (f, 6, c) array
            Zero where a component is missing.
        log_likelihood : float
            Of the first column; minus infinity where it is not finite.
        """
        noise = FixNoise(np.ones(6) if factor is None else factor, PLAIN if colour is None else colour)
        gains = self.gains(noise)
        white = self.whitened(columns, gains)
        value = gains.volume - 0.5 * float(np.sum(white[:, :, 0] ** 2))
        return white, value if math.isfinite(value) else -math.inf

    def gains(self, noise: FixNoise, S: Array | None = None) -> Gains:
        """What a filter on the error of this one does with any innovations under a noise of the fixes.

        Parameters
        ----------
        noise : FixNoise
        S : (f, 6, 6) array, optional
            Overwritten with the covariances of the fixes given those before.
        """
        sigma, tau = noise.colour
        phi = np.exp(-np.diff(self.t, prepend=self.t[0]) / tau)[:, None] * np.ones(6)
        m = self.P0.shape[0] + np.count_nonzero(sigma)
        gain, root = np.zeros((self.t.size, 6, m)), np.zeros((self.t.size, 6))
        done = error_kernels.surrogate_gains(
            self.Phi, self.Q, self.H, self.R, self.P0, self.first, self.use, noise.factor,
            phi, (1.0 - phi**2) * sigma**2, sigma**2, gain, root, np.empty((0, 6, 6)) if S is None else S,
        )  # fmt: skip
        volume = -float(np.sum(np.log(root[root > 0.0]))) if done == self.t.size else -math.inf
        return Gains(phi, sigma**2, gain, root, done, volume)

    def whitened(self, columns: Array, gains: Gains, ahead: Array | None = None) -> Array:
        """Columns (f, 6, c), innovations or responses of them (m, m/s), whitened by a filter on the error of this one; zero where missing.

        Parameters
        ----------
        columns : (f, 6, c) array
        gains : Gains
            From :meth:`gains`.
        ahead : (f, 6) array, optional
            Overwritten with the first column less what the fixes before say of it.
        """
        white, own = np.zeros_like(columns), np.empty((0, 6)) if ahead is None else ahead
        error_kernels.surrogate_whitened(
            self.Phi, self.K, self.H, np.ascontiguousarray(columns[: gains.done]), self.use,
            gains.phi, gains.variance, gains.gain, gains.root, white, own,
        )  # fmt: skip
        return white

    def ahead(self, nu: Array, noise: FixNoise, more: Array) -> tuple[Array, Array]:
        """Innovations less what the fixes before say of them under a noise of the fixes, (f, 6), and their covariances, (f, 6, 6).

        Parameters
        ----------
        nu : (f, 6) array
            Innovations, m and m/s.
        noise : FixNoise
        more : (f, 6) array
            Added to the variances of fixes that say little of those behind them, m^2; their own covariances are those without it.
        """
        out, S = np.zeros((len(nu), 6)), np.zeros((len(nu), 6, 6))
        gains = replace(self, R=self.R + more / noise.factor**2).gains(noise, S)
        self.whitened(nu[:, :, None], gains, out)
        S -= more[:, :, None] * np.eye(6)
        return out, S

    def log_likelihood(self, factor: Array | None = None, colour: Colour | None = None) -> float:
        """Log-likelihood with other levels and a Gauss-Markov part of the fixes."""
        return self.whiten(self.nu[:, :, None], factor, colour)[1]

    def log_likelihoods(self, noises: Sequence[FixNoise]) -> Array:
        """Log-likelihoods of several noises of the fixes, eight in one pass; minus infinity where one is not finite."""
        sigma, rate = np.stack([n.colour[0] for n in noises]), np.array([1.0 / n.colour[1] for n in noises])
        factor = np.stack([n.factor for n in noises])
        # a pass carries a state for every component that one of its eight colours: like goes with like
        order = np.argsort(np.count_nonzero(sigma, axis=1), kind="stable")
        order = np.concatenate([order, np.repeat(order[-1:], -order.size % LANES)])
        blocks = (order.size // LANES, LANES)
        out = np.empty(blocks)
        ratio, variance = (
            np.ascontiguousarray(np.moveaxis(v[order].reshape(*blocks, 6) ** 2, 1, 2)) for v in (factor, sigma)
        )
        error_kernels.surrogate_likelihoods(
            self.Phi, self.Q, self.K, self.H, self.R, self.P0, self.first, self.nu, self.use, np.diff(self.t, prepend=self.t[0]),
            ratio, variance, rate[order].reshape(blocks), out,
        )  # fmt: skip
        values = np.empty(len(noises))
        values[order] = out.ravel()
        return np.where(np.isfinite(values), values, -math.inf)


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
    colours = [] if "gnss_correlated_noise" in skip else _colours(s)
    likely = _at_starts(s, [*problems, *colours[:1]])
    if colours and np.max(likely[-1]) - base > HOPELESS_NATS:
        problems += colours
        likely += _at_starts(s, colours[1:])
    going: list[_Weighed] = []
    starts: list[Array] = []
    for p, values in zip(problems, likely, strict=False):
        priors = [sum(f.log_density(z) for f, z in zip(p.free, x, strict=True)) for x in p.starts]
        top = int(np.argmax(values + np.array(priors) if p.is_level else values))
        if p.is_level or values[top] - base > LEAST_NATS:
            going.append(p)
            starts.append(p.starts[top])
    modes = laplace_together(
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
        sigma, tau = noise.colour
        values = [Value.positive(f"sigma_{a}", sigma[NED.index(a)], sd[0], "m") for a in self.axes]
        values.append(Value.positive("tau", tau, sd[1], "s"))
        return NoiseFit(self.effect, self.axes, mode.evidence - base, tuple(values), noise.factor, noise.colour)


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


def _colours(s: Surrogate) -> list[_Weighed]:
    """Gauss-Markov parts of the position fixes, in proportion to their believed standard deviations."""
    sigma0 = s.sigma()
    if not sigma0[:3].all():
        return []
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
            return FixNoise(np.ones(6), (sigma, math.exp(x[1])))

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
        Standard deviations of the logarithms of ``sigma_north`` ... and ``tau``; of those that are coloured; ``factor`` of a level of any size.
    evidence : float
        Log evidence, nats.
    intervals : callable
        95 % intervals of what the colour has of these, as ratios to the most likely: some passes of the filter.
    """

    noise: FixNoise
    sd: dict[str, float]
    evidence: float
    intervals: Callable[[], dict[str, tuple[float, float]]]


def joint_noise(s: Surrogate, begin: FixNoise, factors: Array, *, wide: Sequence[int] = ()) -> JointNoise:
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
    wide : sequence of int
        Components with a common level, which may have any size; without them each level stays within its tolerance.
    """
    colour, known = begin.colour, begin.known
    groups = [list(g) for g in LEVEL_GROUPS if s.use[:, list(g)].any() and not set(g) & set(wide)]
    groups += [list(wide)] if wide else []
    parts = [rows for rows in groups if any(colour[0][r] > 0.0 for r in rows)] if not known else []
    count = len(parts) + (not known)
    usual = np.array([-float(np.mean(np.log(factors[rows]))) for rows in groups])
    levels = [level("factor", math.exp(u)) for u in usual]
    if wide:
        free_level = _any_size(s.settled, wide)
        levels[-1] = Free("factor", free_level.low * math.exp(usual[-1]), free_level.high * math.exp(usual[-1]))
    free = (*(Free("ratio", 0.03, 30.0) for _ in parts), *(() if known else (_times(s, colour[1]),)), *levels)

    def unpack(x: Array) -> FixNoise:
        sigma, tau, factor = colour[0].copy(), colour[1], np.ones(6)
        for k, rows in enumerate(parts):
            sigma[rows] *= math.exp(x[k])
        if not known:
            tau *= math.exp(x[len(parts)])
        for k, rows in enumerate(groups):
            factor[rows] = math.exp(x[count + k])
        return replace(begin, factor=factor, colour=(sigma, tau))

    def likelihoods(points: Sequence[tuple[int, Array]]) -> Array:
        return s.log_likelihoods([unpack(x) for _, x in points])

    start = np.zeros(len(free))
    start[count:] = [float(np.mean(np.log(begin.factor[rows]))) for rows in groups]
    (mode,) = laplace_together(likelihoods, [start], [free], CLOSE_NATS)
    place = {f"sigma_{NED[r]}": k for k, rows in enumerate(parts) for r in rows if r < 3}
    if not known:
        place["tau"] = len(parts)
    if wide:
        place["factor"] = len(free) - 1

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


def level_beside(s: Surrogate, noise: FixNoise, factors: Array) -> list[NoiseFit]:
    """Other levels of the positions than the nominal ones beside a colour of the fixes, which is estimated again with them.

    Parameters
    ----------
    s, factors : Surrogate, (6,) array
        As :func:`joint_noise` takes them.
    noise : FixNoise
        Colour and levels as they are inside their tolerance.

    Returns
    -------
    list of NoiseFit
        None where the levels within their tolerance do not reach its edge; without a colour where the level leaves it nothing to explain.
    """
    edge = math.log1p(rules().tolerance)
    beyond = np.abs(np.log(noise.factor * factors)) > AT_EDGE * edge
    tried = [axes for axes in GROUPS[:3] if beyond[[NED.index(a) for a in axes]].any()]
    out: list[NoiseFit] = []
    within = joint_noise(s, noise, factors).evidence if tried else 0.0
    for axes in tried:
        rows = [NED.index(a) for a in axes]
        found, colour = joint_noise(s, noise, factors, wide=rows), True
        if not noise.known:
            plain = joint_noise(s, replace(noise, colour=PLAIN, known=True), factors, wide=rows)
            if plain.evidence > found.evidence - rules().keep_nats:
                found, colour = plain, False
        ratio = float(found.noise.factor[rows[0]] * np.exp(np.mean(np.log(factors[rows]))))
        if abs(math.log(ratio)) > edge:
            value = Value.positive("factor", ratio, found.sd["factor"], "1")
            gain, joint = found.evidence - within, found.noise
            out.append(
                NoiseFit("gnss_noise_level", axes, gain, (value,), joint.factor, joint.colour if colour else None)
            )
    return out


def pooled(fits: Sequence[NoiseFit]) -> float:
    """Evidence of an effect over the groups of axes that it may act on."""
    return log_mean_exp([f.nats for f in fits] + [-math.inf] * (len(GROUPS) - len(fits)))
