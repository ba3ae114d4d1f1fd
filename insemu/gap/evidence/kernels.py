"""Compiled loops of the room: Toeplitz whitening, likelihoods of spectra, the two-level switching one, as scalar code over plain arrays."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class Terms(NamedTuple):
    """How components and their parameters make a curve.

    Parameters
    ----------
    sizes, values : (c,) arrays
        What each component's row is multiplied by, and which row it is.
    once : (k, 4) array
        Parameter, row of the derivative, power, component.
    twice : (l, 5) array
        Two parameters, row of the second derivative, power, component.
    """

    sizes: Array
    values: Index
    once: Index
    twice: Index


class PowerGain(NamedTuple):
    """A low-pass: power gain, its derivatives by the ``last`` parameters and its second ones, (g, n); what is added to the density behind it."""

    values: Array
    last: int
    floor: float


class Slopes(NamedTuple):
    """Slope (p,), information and curvature (p, p) of the negative log-likelihood; changed by what adds to them."""

    gradient: Array
    expected: Array
    observed: Array


class BlockMeans(NamedTuple):
    """Block means (n,), the variance of their white noise, and a first-order background: transition, driving and initial variance."""

    y: Array
    white: float
    phi: float
    q: float
    p0: float


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _longer(
    t: int, kappa: float, phi: Array, mirror: Array, back: Array, past: Array
) -> tuple[float, float]:  # pragma: no cover - compiled
    """Take the predictor of Durbin and Levinson from ``t - 1`` to ``t`` coefficients, and what it predicts, in one pass over memory.

    Parameters
    ----------
    t : int
        At least 1.
    kappa : float
        The new coefficient (partial autocorrelation).
    phi, mirror : (n,) arrays
        The predictor at the beginning, and reversed at the end; updated.
    back, past : (n,) arrays
        Autocovariance and data, reversed.

    Returns
    -------
    float, float
        Predictions of sample t and of the autocovariance at lag t + 1 (which there is none of for the last t).
    """
    n = phi.size
    start = max(n - t - 1, 0)
    p, q, data, lags = phi[: t - 1], mirror[n - t + 1 :], past[n - t :], back[start:]
    sample, lag = 0.0, 0.0
    for j in range(t - 1):
        a, b = p[j], q[j]
        c = a - kappa * b
        q[j] = b - kappa * a
        p[j] = c
        sample += c * data[j]
        lag += c * lags[j]
    phi[t - 1] = kappa
    mirror[n - t] = kappa
    return sample + kappa * past[n - 1], lag + kappa * lags[t - 1]


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def toeplitz_whiten(gamma: Array, columns: Array, out: Array) -> float:  # pragma: no cover - compiled
    """Whiten the columns of a stationary Gaussian vector by the Durbin-Levinson recursion.

    Row k of ``out`` is the one-step prediction error over its standard deviation, so that ``out' out`` is ``columns' C^-1 columns``.

    Parameters
    ----------
    gamma : (n,) array
        Autocovariance at lags 0 to n - 1.
    columns : (n, k) array
        Data and regressors.
    out : (n, k) array
        Written to.

    Returns
    -------
    float
        ``log det C``, or NaN where the autocovariance is not positive definite.
    """
    n, k = columns.shape
    phi, mirror, back = np.zeros(n), np.zeros(n), gamma[::-1].copy()
    past = columns[::-1].T.copy()
    v, logdet, lag = gamma[0], 0.0, 0.0
    for t in range(n):
        first = 0.0
        if t > 0:
            kappa = (gamma[t] - lag) / v
            first, lag = _longer(t, kappa, phi, mirror, back, past[0])
            v *= (1.0 - kappa) * (1.0 + kappa)
        if not v > 0.0:
            return math.nan
        logdet += math.log(v)
        s = 1.0 / math.sqrt(v)
        out[t, 0] = (columns[t, 0] - first) * s
        for c in range(1, k):
            e, data = columns[t, c], past[c, n - t :]
            for j in range(t):
                e -= phi[j] * data[j]
            out[t, c] = e * s
    return logdet


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def toeplitz_solve(
    gamma: Array, columns: Array, solved: Array, diagonals: Array
) -> float:  # pragma: no cover - compiled
    """Solve a stationary covariance for some columns, and sum the diagonals of its inverse.

    The Durbin-Levinson recursion builds ``C^-1 columns`` and the first column ``x`` of the inverse, whose diagonals sum to
    ``s_k = sum_i (n - k - 2 i) x_i x_(i+k) / x_0`` (Gohberg and Semencul 1972).

    Parameters
    ----------
    gamma : (n,) array
        Autocovariance at lags 0 to n - 1.
    columns, solved : (k, n) arrays
        Data and regressors, one a row; what is written.
    diagonals : (n,) array
        Written to: sum of the k-th diagonal of the inverse.

    Returns
    -------
    float
        ``log det C``, or NaN where the autocovariance is not positive definite.
    """
    m, n = columns.shape
    phi, mirror, back = np.zeros(n), np.zeros(n), gamma[::-1].copy()
    past = columns[:, ::-1].copy()
    solved[:] = 0.0
    v, logdet, lag = gamma[0], 0.0, 0.0
    for t in range(n):
        first = 0.0
        if t > 0:
            kappa = (gamma[t] - lag) / v
            first, lag = _longer(t, kappa, phi, mirror, back, past[0])
            v *= (1.0 - kappa) * (1.0 + kappa)
        if not v > 0.0:
            return math.nan
        logdet += math.log(v)
        predictor = mirror[n - t :]
        for c in range(m):
            e = columns[c, t] - first
            if c > 0:
                e, data = columns[c, t], past[c, n - t :]
                for j in range(t):
                    e -= phi[j] * data[j]
            w, before = e / v, solved[c, :t]
            solved[c, t] = w
            for j in range(t):
                before[j] -= predictor[j] * w
    x, moment = np.empty(n), np.empty(n)
    x[0] = 1.0 / v
    for j in range(n - 1):
        x[1 + j] = -phi[j] / v
    for j in range(n):
        moment[j] = 2.0 * j * x[j]
    for k in range(n):
        later = x[k:]
        total, less = 0.0, 0.0
        for i in range(n - k):
            total += x[i] * later[i]
            less += moment[i] * later[i]
        diagonals[k] = ((n - k) * total - less) * v
    return logdet


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def lagged_products(rows: Array, out: Array) -> None:  # pragma: no cover - compiled
    """Sums of products at every lag, over all rows.

    Parameters
    ----------
    rows : (k, n) array
    out : (n,) array
        Written to.
    """
    m, n = rows.shape
    for k in range(n):
        total = 0.0
        for c in range(m):
            for i in range(n - k):
                total += rows[c, i] * rows[c, i + k]
        out[k] = total


@njit(cache=True, nogil=True, error_model="numpy")
def whittle(
    terms: Terms, rows: Array, gain: PowerGain, half: Array, seen: Array, slopes: Slopes
) -> float:  # pragma: no cover - compiled
    """Whittle's log-likelihood of a spectrum, a sum of rows times sizes under a gain; derivatives and curvatures are added to what is given.

    Parameters
    ----------
    terms : Terms
    rows : (r, n) array
        Densities of all components with their derivatives.
    gain : PowerGain
    half, seen : (n,) arrays
        Half the degrees of freedom, and the measured density.
    slopes : Slopes

    Returns
    -------
    float
        NaN where the density is not positive.
    """
    sizes, values, once, twice = terms
    gains, last, floor = gain
    gradient, expected, observed = slopes
    p, m, total = gradient.size, once.shape[0], 0.0
    slope, bent = np.zeros(p), np.zeros(rows.shape[0])
    info, loud, H = np.zeros((p, p)), np.zeros((p, p)), np.zeros((p, p))
    for b in range(half.size):
        psd = 0.0
        for c in range(sizes.size):
            psd += sizes[c] * rows[values[c], b]
        power = gains[0, b]
        S = psd * power + floor
        if not S > 0.0:
            return math.nan
        ratio = seen[b] / S
        weight = half[b] * (ratio - 1.0) / S
        total -= half[b] * (math.log(S) + ratio)
        for r in range(rows.shape[0]):
            bent[r] += rows[r, b] * weight * power
        for q in range(m):
            by = once[q, 2] * sizes[once[q, 3]] * rows[once[q, 1], b]
            for e in range(last):
                H[once[q, 0], p - last + e] += by * weight * gains[1 + e, b]
            slope[once[q, 0]] = by * power
        at = 1 + last
        for e in range(last):
            slope[p - last + e] = gains[1 + e, b] * psd
            for d in range(e, last):
                H[p - last + e, p - last + d] += gains[at, b] * weight * psd
                at += 1
        for i in range(p):
            gradient[i] += slope[i] * weight
            for j in range(i + 1):
                both = half[b] * (slope[i] / S) * (slope[j] / S)
                info[i, j] += both
                loud[i, j] += both * ratio
    for t in range(twice.shape[0]):
        H[min(twice[t, 0], twice[t, 1]), max(twice[t, 0], twice[t, 1])] = (
            twice[t, 3] * sizes[twice[t, 4]] * bent[twice[t, 2]]
        )
    for i in range(p):
        for j in range(i + 1):
            curved = 2.0 * loud[i, j] - info[i, j] - H[j, i]
            expected[i, j] += info[i, j]
            observed[i, j] += curved
            if i != j:
                expected[j, i] += info[i, j]
                observed[j, i] += curved
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def less_bent(
    sizes: Array, rows: Array, twice: Index, score: Array, curvature: Array
) -> None:  # pragma: no cover - compiled
    """Take what the second derivatives of a covariance make of its score off a curvature.

    Parameters
    ----------
    sizes, twice : as :func:`whittle` has them
    rows : (r, n) array
        Covariances with their derivatives.
    score : (n,) array
        Derivatives of the log-likelihood by the covariance.
    curvature : (p, p) array
        Changed.
    """
    for t in range(twice.shape[0]):
        total, row = 0.0, rows[twice[t, 2]]
        for k in range(score.size):
            total += row[k] * score[k]
        total *= twice[t, 3] * sizes[twice[t, 4]]
        i, j = twice[t, 0], twice[t, 1]
        curvature[i, j] -= total
        if i != j:
            curvature[j, i] -= total


@njit(cache=True, nogil=True, error_model="numpy")
def informed(
    terms: Terms, rows: Array, spectra: Array, score: Array, products: Array, least: float, slopes: Slopes
) -> None:  # pragma: no cover - compiled
    """Add the slope and curvatures of a stationary vector's log-likelihood, the curvatures those of its spectrum (Whittle 1953).

    Parameters
    ----------
    terms : Terms
    rows, spectra : (r, n), (r, f) arrays
        Covariances with their derivatives, and their spectra.
    score : (n,) array
        Derivatives of the log-likelihood by the covariance.
    products : (f,) array
        Spectrum of what the inverse covariance makes of the data.
    least : float
        Share of its largest value below which the density counts as that.
    slopes : Slopes
    """
    sizes, values, once, twice = terms
    gradient, expected, observed = slopes
    m, n, count = once.shape[0], score.size, products.size
    for q in range(m):
        total, row = 0.0, rows[once[q, 1]]
        for k in range(n):
            total += row[k] * score[k]
        gradient[once[q, 0]] += once[q, 2] * sizes[once[q, 3]] * total
    density = np.zeros(count)
    for c in range(sizes.size):
        row = spectra[values[c]]
        for k in range(count):
            density[k] += sizes[c] * row[k]
    floor, half = least * density.max(), 0.5 * n / count
    by = np.empty((m, count))
    for q in range(m):
        row, size = spectra[once[q, 1]], once[q, 2] * sizes[once[q, 3]]
        for k in range(count):
            by[q, k] = size * row[k] / max(density[k], floor)
    for q in range(m):
        for r in range(q + 1):
            info, loud = 0.0, 0.0
            for k in range(count):
                both = by[q, k] * by[r, k]
                info += both
                # the inverse covariance of the data times the density is one on average
                loud += both * products[k] * density[k]
            info *= half
            curved = 2.0 * half * loud / n - info
            i, j = once[q, 0], once[r, 0]
            expected[i, j] += info
            observed[i, j] += curved
            if i != j:
                expected[j, i] += info
                observed[j, i] += curved
    less_bent(sizes, rows, twice, score, observed)


@njit(cache=True, nogil=True)
def switching_log_likelihood(
    means: BlockMeans, amplitude: float, stay: float, path: Array
) -> float:  # pragma: no cover - compiled
    """Log-likelihood of ``y_k = b_k + a s_k + white noise``, ``b`` a first-order Gaussian background, ``s = +-1`` switching at random.

    Two-mode filter with moment matching (generalised pseudo-Bayes of first order): exact where the background is constant or the
    amplitude is zero.

    Parameters
    ----------
    means : BlockMeans
    amplitude, stay : float
        Half the distance of the two levels; probability of staying for one block.
    path : (n,) array
        Written to: probability of the upper level.
    """
    y, white, phi, q, p0 = means
    n = y.size
    total = 0.0
    m0, m1, v0, v1, w0 = 0.0, 0.0, p0, p0, 0.5
    for k in range(n):
        # mixing of the two hypotheses over a possible switch
        u0 = stay * w0 + (1.0 - stay) * (1.0 - w0)
        a = stay * w0 / u0
        b = stay * (1.0 - w0) / (1.0 - u0)
        x0 = a * m0 + (1.0 - a) * m1
        x1 = b * m1 + (1.0 - b) * m0
        s0 = a * (v0 + (m0 - x0) ** 2) + (1.0 - a) * (v1 + (m1 - x0) ** 2)
        s1 = b * (v1 + (m1 - x1) ** 2) + (1.0 - b) * (v0 + (m0 - x1) ** 2)
        if k > 0:
            x0 *= phi
            x1 *= phi
            s0 = phi * phi * s0 + q
            s1 = phi * phi * s1 + q
        e0 = y[k] - x0 + amplitude
        e1 = y[k] - x1 - amplitude
        d0 = s0 + white
        d1 = s1 + white
        l0 = -0.5 * (math.log(d0) + e0 * e0 / d0) + math.log(max(u0, 1e-300))
        l1 = -0.5 * (math.log(d1) + e1 * e1 / d1) + math.log(max(1.0 - u0, 1e-300))
        top = max(l0, l1)
        sum_ = math.exp(l0 - top) + math.exp(l1 - top)
        total += top + math.log(sum_) - 0.9189385332046727
        w0 = min(max(math.exp(l0 - top) / sum_, 1e-12), 1.0 - 1e-12)
        m0 = x0 + s0 / d0 * e0
        m1 = x1 + s1 / d1 * e1
        v0 = s0 * white / d0
        v1 = s1 * white / d1
        path[k] = 1.0 - w0
    return total


@njit(cache=True, nogil=True)
def gauss_markov_log_likelihood(
    means: BlockMeans, amplitude: float, stay: float
) -> float:  # pragma: no cover - compiled
    """Log-likelihood of the Gaussian process of the second moments that :func:`switching_log_likelihood` assumes (two-state Kalman filter).

    Parameters
    ----------
    means : BlockMeans
    amplitude, stay : float
        Standard deviation of the Gauss-Markov part; its correlation over one block is ``2 stay - 1``.
    """
    y, white, phi, q, p0 = means
    r = 2.0 * stay - 1.0
    g = amplitude * amplitude
    drive = g * (1.0 - r * r)
    b, x = 0.0, 0.0
    pbb, pbx, pxx = p0, 0.0, g
    total = 0.0
    for k in range(y.size):
        if k > 0:
            b *= phi
            x *= r
            pbb = phi * phi * pbb + q
            pbx = phi * r * pbx
            pxx = r * r * pxx + drive
        e = y[k] - b - x
        kb, kx = pbb + pbx, pbx + pxx
        d = kb + kx + white
        total += -0.5 * (math.log(d) + e * e / d) - 0.9189385332046727
        b += kb / d * e
        x += kx / d * e
        pbb -= kb * kb / d
        pbx -= kb * kx / d
        pxx -= kx * kx / d
    return total
