"""How likely what an aid is off by is: unit effects, levels and errors that last, beside errors of the navigation whose covariance is known."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.gap.policy import rules

Array = NDArray[np.float64]

#: Largest and smallest ratio of a level to what is stated.
LEVELS = (1.0 / 20.0, 20.0)
#: Standard deviations of an error that lasts, over the stated ones: as for fixes at the upper end; an aid may state a hundredth of it.
SIZES = (0.1, 300.0)
#: Score, over its standard deviation, below which no error that lasts is fitted, and at how many correlation times it is asked for.
LEAST_SCORE, TIMES = 2.0, 6
#: Share of the recording beyond which a correlation time stands for a constant as well.
LONG = 0.3
#: Places along a ridge in standard deviations, and the root of what the log likelihood falls by at the ends of an interval of 95 %.
RIDGE, FALL = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0), math.sqrt(0.5 * 1.96**2)
#: What a number at its bound is uncertain by, in its logarithm, where evidence is weighed: narrow, so that an error as long as the recording does
#: not stand for a constant offset (python -m benchmarks.foreign --kinds aid-two --seed 710000: 4 of 70 where it counts as free).
HELD = 0.01
#: Steps of the logarithms for second differences.
STEP = 0.05
#: Prior standard deviation of a coefficient that was named, in datasheet scales: so wide that it moves no estimate.
NAMED = 100.0


@dataclass(frozen=True)
class AidResiduals:
    """What an aid is off by, in blocks, with what a unit of every effect adds to it.

    Parameters
    ----------
    kind : str
    rows : tuple of str
        Components that are used.
    t : (m,) array
        Middle of each block, s.
    mean : (m, w) array
        Mean of what each row is off by, over the stated standard deviation.
    columns : (c, m, w) array
        The same of every unit effect.
    count : (m,) array
        Measurements in each block.
    within, crossed, squares : (w,), (w, c), (w, c, c) arrays
        Sums over all measurements of products of what is off from its block's mean: with itself, with the columns, of the columns.
    navigation : (m w, m w) array
        Covariance of the means that errors of the navigation have.
    labels : tuple of (effect, label)
        Of the columns.
    std : (w,) array
        Stated standard deviations, SI.
    settled : mapping of effect to mapping
        Numbers that go with an estimate of an effect.
    shaken : (w,) array
        Variance of what is faster than motion over the stated one: nobody knows how much of it the aid shows.
    """

    kind: str
    rows: tuple[str, ...]
    t: Array
    mean: Array
    columns: Array
    count: Array
    within: Array
    crossed: Array
    squares: Array
    navigation: Array
    labels: tuple[tuple[str, str], ...]
    std: Array
    settled: dict[str, dict[str, float]]
    shaken: Array

    @property
    def block_s(self) -> float:
        """Time from block to block, s."""
        return float(np.median(np.diff(self.t)))

    @cached_property
    def averaged_s(self) -> float:
        """Time over which a block averages, s: no longer than from any block to the next, else means could not have these covariances."""
        return float(np.diff(self.t).min()) * (1.0 - 1.0 / float(self.count.mean()))

    def mean_of_lasting(self, tau: float) -> tuple[float, float]:
        """Variance of the mean over a block of a Gauss-Markov process of variance one, and covariance of two means over exp(-distance / tau).

        Parameters
        ----------
        tau : float
            Correlation time, s.
        """
        x = max(self.averaged_s / tau, 1e-4)
        return 2.0 * (x - 1.0 + math.exp(-x)) / x**2, (math.sinh(0.5 * x) / (0.5 * x)) ** 2

    def lasting(self, tau: float) -> Array:
        """Covariance (m, m) of means over blocks of such a process."""
        own, between = self.mean_of_lasting(tau)
        out = between * np.exp(-np.abs(self.t[:, None] - self.t) / tau)
        np.fill_diagonal(out, own)
        return out


@dataclass(frozen=True)
class AidNoise:
    """Noise of an aid.

    Parameters
    ----------
    level : (w,) array
        Of each row, over the stated standard deviation.
    named : tuple of int
        Rows whose level was named, so that it is not held within the tolerance of a nominal one.
    lasting : mapping of int to (sigma, tau)
        By row: over the stated standard deviation; s.
    """

    level: Array
    named: tuple[int, ...] = ()
    lasting: Mapping[int, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class AidModel:
    """A model of what an aid is off by.

    Parameters
    ----------
    data : AidResiduals
    scales : (c,) array
        Datasheet scale of each unit effect.
    columns : tuple of int
        Those that were named.
    noise : AidNoise
    """

    data: AidResiduals
    scales: Array
    columns: tuple[int, ...]
    noise: AidNoise

    @classmethod
    def nominal(cls, data: AidResiduals, scales: Array, lasting: Mapping[int, tuple[float, float]]) -> AidModel:
        """Nothing beyond what is stated and known to last, its levels at their best within the tolerance.

        Parameters
        ----------
        data : AidResiduals
        scales : (c,) array
        lasting : mapping of int to (sigma, tau)
            See :class:`AidNoise`.
        """
        return cls(data, scales, (), AidNoise(np.ones(len(data.rows)), (), lasting)).fitted()

    def at_edge(self, row: int) -> bool:
        """Whether the level of a row is as far from what is stated as the tolerance allows."""
        x, bounds = self.place()
        low, high = bounds[row]
        return row not in self.noise.named and not low + 1e-3 < x[row] < high - 1e-3

    # -- likelihood ---------------------------------------------------------------------------------------------------------------

    def root(self) -> Array:
        """Cholesky factor (m w, m w) of the covariance of the means."""
        d, noise = self.data, self.noise
        m, w = d.mean.shape
        S = d.navigation.copy()
        S[np.diag_indices(m * w)] += (noise.level**2 / d.count[:, None]).ravel()
        for row, (sigma, tau) in noise.lasting.items():
            at = np.arange(m) * w + row
            S[np.ix_(at, at)] += sigma**2 * d.lasting(tau)
        return np.asarray(np.linalg.cholesky(S))

    def within(self) -> Array:
        """Variance (w,) of a measurement about the mean of its block: that of the white noise, and what changes of errors that last."""
        out = self.noise.level**2
        for row, (sigma, tau) in self.noise.lasting.items():
            more = float(self.data.count.mean())
            out[row] += sigma**2 * (1.0 - self.data.mean_of_lasting(tau)[0]) * more / max(more - 1.0, 1.0)
        return np.asarray(out)

    def sums(self, columns: Sequence[int]) -> tuple[float, Array, Array]:
        """Log likelihood of the means without any unit effect, normal matrix (k, k) and right-hand side (k,) of some.

        Means alone tell of shapes: within a block motion is fast, and an aid that counts or averages over a tenth of a second shows a part of it.
        """
        d = self.data
        L = self.root()
        G = d.columns[list(columns)].reshape(len(columns), d.mean.size)
        z = scipy.linalg.solve_triangular(L, np.vstack([d.mean.ravel()[None], G]).T, lower=True, check_finite=False)
        base = -0.5 * float(z[:, 0] @ z[:, 0]) - float(np.log(np.diag(L)).sum())
        return base, z[:, 1:].T @ z[:, 1:], z[:, 1:].T @ z[:, 0]

    def of_means(self) -> float:
        """Log likelihood of the means with the named effects integrated out."""
        base, A, b = self.sums(self.columns)
        return base + log_factor(A, b, NAMED * self.scales[list(self.columns)])

    def likelihood(self) -> float:
        """The same with that of what is left within the blocks beside the named effects at their best, which tells of levels."""
        d, own = self.data, list(self.columns)
        base, A, b = self.sums(own)
        sd = NAMED * self.scales[own]
        best = np.linalg.solve(A + np.diag(1.0 / sd**2), b)
        left = d.within - 2.0 * d.crossed[:, own] @ best + d.squares[:, own][:, :, own] @ best @ best
        within, free = self.within(), d.count.sum() - len(d.mean)
        return base + log_factor(A, b, sd) - 0.5 * float(np.sum(left / within + free * np.log(within)))

    def estimates(self) -> tuple[Array, Array]:
        """Mean (k,) and covariance (k, k) of the named coefficients, SI."""
        _, A, b = self.sums(self.columns)
        covariance = np.linalg.inv(A + np.diag(1.0 / (NAMED * self.scales[list(self.columns)]) ** 2))
        return np.asarray(covariance @ b), np.asarray(covariance)

    def whitened(self) -> Array:
        """Means (m, w) less the named effects at their best, whitened in order of time; of independent standard normal numbers."""
        return self._predicted(self.root(), self.estimates()[0])

    def scores(self, sizes: Array) -> Array:
        """Log score of each block's means given those before it, (m,), with the named effects at sizes (k,) and the noise as it is."""
        L = self.root()
        logs = np.log(np.diag(L)).reshape(self.data.mean.shape)
        return np.asarray(np.sum(-0.5 * self._predicted(L, sizes) ** 2 - logs, axis=1))

    def _predicted(self, L: Array, sizes: Array) -> Array:
        d = self.data
        left = d.mean - np.einsum("k,kmw->mw", sizes, d.columns[list(self.columns)])
        return np.asarray(
            scipy.linalg.solve_triangular(L, left.ravel(), lower=True, check_finite=False).reshape(d.mean.shape)
        )

    # -- noise --------------------------------------------------------------------------------------------------------------------

    def place(self) -> tuple[Array, list[tuple[float, float]]]:
        """Logarithms of the noise's numbers and their bounds: levels, then size and time of every error that lasts."""
        d, edge = self.data, math.log1p(rules().tolerance)
        x, bounds = list(np.log(self.noise.level)), []
        for row in range(len(d.rows)):
            high = 0.5 * math.log(math.exp(2.0 * edge) + d.shaken[row])
            bounds.append((math.log(LEVELS[0]), math.log(LEVELS[1])) if row in self.noise.named else (-edge, high))
        for sigma, tau in self.noise.lasting.values():
            x += [math.log(sigma), math.log(tau)]
            bounds += [(math.log(SIZES[0]), math.log(SIZES[1])), (math.log(self._shortest), math.log(self._longest))]
        return np.array(x), bounds

    def place_of_lasting(self, row: int) -> tuple[int, int]:
        """Where size and time of the error of a row that lasts stand in :meth:`place`."""
        at = len(self.data.rows) + 2 * list(self.noise.lasting).index(row)
        return at, at + 1

    @property
    def _shortest(self) -> float:
        return self.data.block_s

    @property
    def _longest(self) -> float:
        return float(self.data.t[-1] - self.data.t[0])

    def at(self, x: Array) -> AidModel:
        """The model with other numbers of its noise, as :meth:`place` has them."""
        w, noise = len(self.data.rows), self.noise
        sizes = np.exp(x[w:]).reshape(-1, 2)
        lasting = {row: (float(s), float(t)) for row, (s, t) in zip(noise.lasting, sizes, strict=True)}
        return replace(self, noise=replace(noise, level=np.exp(x[:w]), lasting=lasting))

    def fitted(self) -> AidModel:
        """The model with the numbers of its noise at their most likely values inside the bounds."""
        x, bounds = self.place()
        x = np.clip(x, *np.array(bounds).T)

        def loss(x: Array) -> float:
            try:
                return -self.at(x).likelihood()
            except np.linalg.LinAlgError:
                return math.inf

        found = scipy.optimize.minimize(
            loss, x, method="L-BFGS-B", bounds=bounds, options={"maxiter": 40, "ftol": 1e-7, "eps": 1e-4}
        )
        return self.at(np.asarray(found.x))

    def restarted(self) -> AidModel:
        """The same, where something lasts about as long as the recording, or from a tenth of that with the same growth at first."""
        long = {row for row, (_, tau) in self.noise.lasting.items() if tau > LONG * self._longest}
        if not long:
            return self
        shorter = {
            row: (sigma * math.sqrt(0.1), 0.1 * tau) if row in long else (sigma, tau)
            for row, (sigma, tau) in self.noise.lasting.items()
        }
        other = replace(self, noise=replace(self.noise, lasting=shorter)).fitted()
        return other if other.likelihood() > self.likelihood() else self

    def spread(self, inside: bool = False) -> Array:
        """Covariance of the logarithms of :meth:`place` about the mode, by second differences; those at a bound are held there.

        Parameters
        ----------
        inside : bool
            Whether size and time of an error that lasts, which go together, are taken a little inside of a bound instead.
        """
        x, bounds = self.place()
        low, high = (np.array([b[side] for b in bounds]) for side in (0, 1))
        own = inside & (np.arange(x.size) >= len(self.data.rows))
        x = np.where(own, np.clip(x, low + 3 * STEP, high - 3 * STEP), x)
        held = np.array([not low + 2 * STEP < v < high - 2 * STEP for v, (low, high) in zip(x, bounds, strict=True)])
        free = np.flatnonzero(~held)
        out = np.zeros((x.size, x.size))
        H = np.empty((free.size, free.size))
        centre = self.at(x).likelihood()
        ends = {}
        for i, k in enumerate(free):
            e = STEP * np.eye(x.size)[k]
            ends[i] = self.at(x + e).likelihood(), self.at(x - e).likelihood()
            H[i, i] = -(ends[i][0] + ends[i][1] - 2.0 * centre) / STEP**2
        for i in range(free.size):
            for j in range(i):
                e = STEP * (np.eye(x.size)[free[i]] + np.eye(x.size)[free[j]])
                both = self.at(x + e).likelihood() + self.at(x - e).likelihood() - 2.0 * centre
                H[i, j] = H[j, i] = 0.5 * (-both / STEP**2 - H[i, i] - H[j, j])
        values, vectors = np.linalg.eigh(H) if free.size else (np.zeros(0), np.zeros((0, 0)))
        # what the data do not bound, the prior does: a decade
        values = np.maximum(values, 1.0 / math.log(10.0) ** 2)
        out[np.ix_(free, free)] = (vectors / values) @ vectors.T
        return out

    def interval(self, k: int, spread: Array) -> tuple[float, float]:
        """Interval of 95 % of a number of :meth:`place`, in its logarithm, by the fall of the likelihood along the ridge through the mode.

        Of an error that lasts a good part of the recording the likelihood falls slowly to one side: a normal interval held four in five truths
        (tests/test_gap_aids.py).

        Parameters
        ----------
        k : int
        spread : (p, p) array
            From :meth:`spread`, ``inside``.
        """
        x, bounds = self.place()
        low, high = (np.array([b[side] for b in bounds]) for side in (0, 1))
        variance = float(spread[k, k])
        if variance <= 0.0:  # held at a bound
            return float(low[k]), float(high[k])
        ridge, centre = spread[:, k] / math.sqrt(variance), self.likelihood()
        ends = []
        for sign in (-1.0, 1.0):
            inside, fell = 0.0, 0.0
            for step in RIDGE:
                fall = math.sqrt(max(centre - self.at(np.clip(x + sign * step * ridge, low, high)).likelihood(), 0.0))
                if fall > FALL:
                    inside += (step - inside) * (FALL - fell) / (fall - fell)
                    break
                inside, fell = step, fall
            ends.append(float(np.clip(x[k] + sign * inside * ridge[k], low[k], high[k])))
        return ends[0], ends[1]

    # -- other models -------------------------------------------------------------------------------------------------------------

    def with_level(self, row: int) -> AidModel:
        """With the level of a row free."""
        noise = replace(self.noise, named=(*self.noise.named, row))
        return replace(self, noise=noise).fitted()

    def with_lasting(self, row: int) -> AidModel | None:
        """With an error of a row that lasts; None where its score says that there is none.

        The score of its variance at none, over its standard deviation, is asked for at a few correlation times; the fit starts at the best of them.
        """
        d, columns = self.data, list(self.columns)
        m, w = d.mean.shape
        inverse = np.linalg.inv(self.root())
        inverse = inverse.T @ inverse
        left = d.mean - np.einsum("k,kmw->mw", self.estimates()[0], d.columns[columns])
        at = np.arange(m) * w + row
        z, own = (inverse @ left.ravel())[at], inverse[np.ix_(at, at)]
        best, start = LEAST_SCORE, None
        for tau in np.geomspace(self._shortest, LONG * self._longest, TIMES):
            K = d.lasting(tau)
            spent = own @ K
            sd = math.sqrt(0.5 * float(np.sum(spent * spent.T)))
            score = 0.5 * (float(z @ K @ z) - float(np.trace(spent)))
            if score > best * sd:
                best, start = score / sd, (math.sqrt(max(score / sd**2, SIZES[0] ** 2)), float(tau))
        if start is None:
            return None
        return replace(self, noise=replace(self.noise, lasting={**self.noise.lasting, row: start})).fitted().restarted()

    def gain_of_noise(self, more: AidModel, new: Sequence[int]) -> float:
        """Log evidence of a model with more numbers of its noise over this one, by Laplace's approximation about their most likely values.

        Parameters
        ----------
        more : AidModel
        new : sequence of int
            Places of these numbers among :meth:`place` of it; each is as likely at any logarithm within its bounds.
        """
        _, bounds = more.place()
        gain = more.likelihood() - self.likelihood()
        covariance = more.spread()[np.ix_(new, new)]
        # one at a bound counts as a step: an error that lasts as long as the recording is a constant by another name
        held = np.diag(covariance) <= 0.0
        sd = np.sqrt(np.where(held, HELD**2, np.diag(covariance)))
        inside = covariance / np.outer(sd, sd) + np.diag(held.astype(np.float64))
        widths = [high - low for low, high in (bounds[k] for k in new)]
        volume = 0.5 * len(new) * math.log(2.0 * math.pi) + float(np.log(sd).sum())
        volume += 0.5 * float(np.linalg.slogdet(inside + 1e-9 * np.eye(len(new)))[1])
        return gain + min(volume - float(np.log(widths).sum()), 0.0)

    def gain_of_columns(self, new: Sequence[int]) -> float:
        """Log evidence of some more unit effects, averaged over the sizes that they may have."""
        own = list(self.columns)
        every = [*own, *new]
        _, A, b = self.sums(every)
        known = NAMED * self.scales[own]
        before = log_factor(A[: len(own), : len(own)], b[: len(own)], known)
        policy = rules()
        sizes = (*policy.prior_scales, *policy.wider_scales)
        gains = [log_factor(A, b, np.concatenate([known, size * self.scales[list(new)]])) - before for size in sizes]
        return float(np.logaddexp.reduce(gains)) - math.log(len(sizes))


def log_factor(A: Array, b: Array, sd: Array) -> float:
    """Log Bayes factor of coefficients with prior standard deviations (k,) against none.

    Parameters
    ----------
    A, b : (k, k), (k,) arrays
        Normal matrix and right-hand side.
    sd : (k,) array
    """
    if not sd.size:
        return 0.0
    L = np.linalg.cholesky(sd[:, None] * A * sd + np.eye(sd.size))
    z = scipy.linalg.solve_triangular(L, sd * b, lower=True, check_finite=False)
    return 0.5 * float(z @ z) - float(np.log(np.diag(L)).sum())
