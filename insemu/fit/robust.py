"""The curve that a robust fit uses: samples that the model cannot explain count as missing, and what that does to the curve is taken back.

An outlier touches one sample, but 2^j coefficients of scale 2^j: with one bad sample in a hundred no coefficient of 128 samples is clean,
and an M-estimator of a scale has nothing left to reject. So samples are rejected, each once: those whose residual, predicted by all other
samples under the fitted model (leave-one-out, by the row of the smoother), exceeds ``c`` standard deviations. The wavelet variance of the
others is that of a record with missing samples. ``c`` gives the estimate of the white noise the efficiency asked for with Gaussian data.

Two things bias that curve, both as white noise does: large values of clean samples are rejected too, and small outliers remain. How often outliers
of each size occur is estimated from the residuals (the nonparametric maximum likelihood of a mixture of amplitudes, Kiefer and Wolfowitz 1956);
a signal drawn from the fitted model, with outliers drawn from that, is treated in the same way, and what the treatment changes in its curve is
added (indirect inference, as in Stebler et al. 2014, equation (29)). Model, rejection and correction are renewed in turns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.fit.gmwm import fit_curve
from insemu.noise import NoiseModel
from insemu.records import Series
from insemu.statespace import smooth
from insemu.variance import WaveletVariance, wavelet_variance

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Efficiency of the estimate of white noise with Gaussian data, where none is asked for.
EFFICIENCY = 0.6
#: Samples from whose neighbours, half before and half behind, the one in the middle is predicted.
NEAR = 4097
#: Steps of conjugate gradients for the rejected samples at most, and the root mean square error, in standard deviations of the
#: residual, at which they end.
FILLING, CLOSE = 30, 0.01
#: Variance of the unknown begin of a state, and white noise of a model that has none, in variances of the shortest octave.
UNKNOWN, NO_WHITE = 1e4, 1e-3
#: Rejection ends where fewer than this share of samples change.
UNCHANGED = 2e-4
#: The longest signal that is drawn for the correction.
LONGEST = 1 << 16
#: Amplitudes of outliers, in standard deviations of the residual. Below the first an outlier cannot be distinguished from noise.
AMPLITUDES = 2.5 * 1.25 ** np.arange(16)
#: Octaves in which the correction is measured; in longer ones it is white noise and falls with the scale.
MEASURED = 5
#: Times that model, rejection and correction are renewed at most, and signals that are drawn each time. They end where the curve of the shortest
#: octaves stays to this share of its standard deviation.
ROUNDS, DRAWS, STAYS = 12, 2, 0.2
#: How far a round may be carried on in the direction of the last two, in their difference (a ratio of 0.75 from round to round).
FARTHEST = 3.0
#: Pieces of a drawn signal from which the slope of its control variate is read, and fewer than these give none.
PIECES, FEWEST = 64, 16
#: Before a model is known: samples further than this many standard deviations from the median of their nearest nine.
FAR = 4.5
#: How far the number of outliers too small to be seen may be from what the smallest visible ones suggest, as a share of it.
UNSEEN = 0.15
#: What remains of a scale after a correction is at least this share of it.
LEAST = 0.02


@dataclass(frozen=True)
class Outliers:
    """Outliers of a record, as its residuals under the fitted model show them.

    Parameters
    ----------
    share : float
        Estimated share of samples that are outliers of more than ``AMPLITUDES[0]`` standard deviations.
    rejected : (n,) bool array
        Samples that the curve leaves out.
    root_mean_square : float
        Of the estimated outliers, in the unit of the signal; 0 where there are none.
    expected : float
        Share of samples that would be rejected of a clean record.
    """

    share: float
    rejected: Mask
    root_mean_square: float
    expected: float

    def note(self, rate_hz: float) -> str:
        """The warning of a fit: what was rejected, where, and what a clean record would lose."""
        length = max(self.rejected.size // 20, 1)
        so_far = np.concatenate([[0], np.cumsum(self.rejected)])
        counts = so_far[length:] - so_far[:-length]
        start = int(np.argmax(counts))
        there = float(counts[start]) / length
        return (
            f"{self.rejected.mean():.2%} of the samples were rejected as outliers, {self.expected:.2%} would be of a clean record; most of them "
            f"({there:.2%}) lie from {start / rate_hz:.4g} to {(start + length) / rate_hz:.4g} s; the estimated share of outliers is "
            f"{self.share:.2%}, their root mean square {self.root_mean_square:.3g}"
        )


@dataclass(frozen=True)
class CleanedCurve:
    """A curve for fitting.

    Parameters
    ----------
    curve : WaveletVariance
        Of the samples that are kept, corrected; its ``white_scatter`` is what the rejection costs.
    outliers : Outliers
    """

    curve: WaveletVariance
    outliers: Outliers


def _efficiency(c: float) -> float:
    """Efficiency of the variance of Gaussian values within ``c`` standard deviations: Huber's formula for an M-estimator of scale."""
    density = math.exp(-0.5 * c * c) / math.sqrt(2.0 * math.pi)
    inside = 2.0 * float(scipy.special.ndtr(c)) - 1.0
    second = inside - 2.0 * c * density
    fourth = 3.0 * inside - 2.0 * (c**3 + 3.0 * c) * density
    k = second / inside
    slope = 2.0 * second - 2.0 * c * density * (c * c - k)
    return 0.5 * slope**2 / (fourth - 2.0 * k * second + k * k * inside)


@lru_cache(maxsize=32)
def rejection_limit(efficiency: float) -> float:
    """Return the limit in standard deviations beyond which samples are rejected.

    Parameters
    ----------
    efficiency : float
        Of the estimated variance of white noise with Gaussian data, 0.4 (most robust) to 0.99.

    Raises
    ------
    InputError
        An efficiency outside that range.

    Examples
    --------
    >>> round(rejection_limit(0.6), 2)
    2.37
    """
    if not 0.4 <= efficiency <= 0.99:
        raise InputError(f"efficiency is {efficiency}, expected 0.4 to 0.99")
    return float(scipy.optimize.brentq(lambda c: _efficiency(c) - efficiency, 1.0, 6.0))


class _Prediction:
    """Every sample from its neighbours under a model: the row of the smoother for the sample in the middle of :data:`NEAR` samples."""

    def __init__(self, model: NoiseModel, dt: float, first: float) -> None:
        block = model.block(dt)
        self.exact = block.white > 0
        # a model without white noise predicts a sample by its neighbours exactly; a thousandth of its shortest scatter stands in
        white = block.white if block.white > 0 else NO_WHITE * first
        # where the state begins is not known, so that the row adds up to one
        block = replace(block, white=white, P0=block.P0 + UNKNOWN * first * np.eye(block.n))
        impulse = np.zeros(NEAR)
        impulse[NEAR // 2] = 1.0
        row = smooth(block, impulse).mean @ block.c if block.n else np.full(NEAR, 1.0 / NEAR)
        own = min(float(row[NEAR // 2]), 1.0 - 1e-9)
        self.row = row / (1.0 - own)
        self.row[NEAR // 2] = 0.0
        self.deviation = math.sqrt(white / (1.0 - own))

    def _of_neighbours(self, y: Array) -> Array:
        padded = np.pad(y, NEAR // 2, mode="reflect" if y.size > NEAR // 2 else "edge")
        return np.asarray(scipy.signal.oaconvolve(padded, self.row, mode="valid"))

    def residual(self, y: Array) -> Array:
        """What the neighbours do not predict, in standard deviations."""
        return (y - self._of_neighbours(y)) / self.deviation

    def filled(self, y: Array, out: Mask, begin: Array) -> Array:
        """The record with the rejected samples at their most likely values: conjugate gradients on its precision, from ``begin``."""
        whole = np.where(out, begin, y)
        left = np.where(out, self._of_neighbours(whole) - whole, 0.0)
        direction, size = left.copy(), float(left @ left)
        for _ in range(FILLING):
            if size <= (CLOSE * self.deviation) ** 2 * max(int(out.sum()), 1):
                break
            changed = np.where(out, direction - self._of_neighbours(direction), 0.0)
            step = size / float(direction @ changed)
            whole += step * direction
            left -= step * changed
            before, size = size, float(left @ left)
            direction = left + size / before * direction
        return whole

    def cleaned(self, y: Array, begin: Mask, limit: float) -> tuple[Array, Array, Mask]:
        """Residuals in standard deviations, the record with samples beyond a limit at their most likely values, and which these are."""
        out, whole = begin, np.where(begin, np.median(y), y)
        for _ in range(3):
            whole = self.filled(y, out, whole)
            residual = (y - self._of_neighbours(whole)) / self.deviation
            before, out = out, np.abs(residual) > limit
            if np.mean(out != before) < UNCHANGED:
                break
        return residual, self.filled(y, out, whole), out


def _amplitudes(residual: Array) -> tuple[Array, float]:
    """Shares of samples without outlier and with one of each of :data:`AMPLITUDES`, and the standard deviation of the former."""
    size = np.abs(residual)
    edges = np.concatenate([np.arange(0.0, 10.0, 0.05), np.geomspace(10.0, max(float(size.max()), 10.0) + 1.0, 60)])
    count = np.histogram(size, edges)[0].astype(float)
    squares = (edges[1:] ** 2 + edges[1:] * edges[:-1] + edges[:-1] ** 2) / 3.0
    amplitude = np.concatenate([[0.0], AMPLITUDES])
    shares = np.concatenate([[0.97], np.full(AMPLITUDES.size, 0.03 / AMPLITUDES.size)])
    deviation = float(np.median(size)) / 0.6744897501960817
    for _ in range(40):
        scaled, centre = edges[:, None] / deviation, amplitude[None, :]
        below = scipy.special.ndtr(scaled - centre) - scipy.special.ndtr(-scaled - centre)
        chance = np.diff(below, axis=0) + 1e-300
        for _ in range(5):
            parts = chance * shares
            parts *= (count / parts.sum(axis=1))[:, None]
            shares = parts.sum(axis=0) / count.sum()
        core, expected = parts[:, 0], chance[:, 0]
        deviation *= math.sqrt(float((core @ squares) / core.sum() / ((expected @ squares) / expected.sum())))
    return shares, deviation


def _unseen(shares: Array) -> float:
    """Share of outliers below the first amplitude: as many for each unit of size as among the smallest three that are seen."""
    width = AMPLITUDES[2] * math.sqrt(1.25) - AMPLITUDES[0] / math.sqrt(1.25)
    return float(shares[1:4].sum() / width * AMPLITUDES[0])


def _chances(shares: Array) -> tuple[Array, Array]:
    """Sizes of outliers and how often each occurs: none, :data:`AMPLITUDES`, and uniformly below the first of these."""
    chance = np.concatenate([shares, [_unseen(shares)]])
    chance[0] = max(chance[0] - chance[-1], 0.0)
    return np.concatenate([[0.0], AMPLITUDES, [AMPLITUDES[0]]]), chance / chance.sum()


def _drawn(shares: Array, deviation: float, n: int, rng: np.random.Generator) -> Array:
    """Outliers of ``n`` samples, most of them zero, in standard deviations of the residual."""
    size, chance = _chances(shares)
    which = rng.choice(size.size, n, p=chance)
    spread = np.where(which == size.size - 1, rng.random(n), 1.0)
    return np.asarray(size[which] * spread * deviation * np.sign(rng.standard_normal(n)))


def cleaned_curve(series: Series, model: NoiseModel, efficiency: float = EFFICIENCY) -> CleanedCurve:
    """Return the wavelet variance of a record without its outliers.

    Parameters
    ----------
    series : Series
        Complete.
    model : NoiseModel
        Structure whose fit predicts the samples; parameters that have a value are held.
    efficiency : float
        Of the estimate of white noise with Gaussian data, 0.4 (most robust) to 0.99.

    Raises
    ------
    InputError
        A record with missing samples; as :func:`insemu.fit.gmwm.fit_curve`; an efficiency outside its range.
    """
    limit = rejection_limit(float(efficiency))
    x, rate, dt = series.complete("the robust wavelet variance").values, series.rate_hz, 1.0 / series.rate_hz
    y = x - np.median(x)
    step = y - scipy.ndimage.median_filter(y, 9, mode="nearest")
    deviation = float(np.median(np.abs(step))) / 0.6744897501960817 or float(np.std(step))
    out = np.abs(step) > FAR * deviation
    curve = wavelet_variance(np.where(out, np.nan, y), rate, gaps=True)
    fitted = fit_curve(curve, model).model
    given: Array | None = None
    before: tuple[Array, Array] | None = None
    for _ in range(ROUNDS):
        prediction = _Prediction(fitted, dt, float(curve.value[0]))
        residual, whole, out = prediction.cleaned(y, out, limit)
        shares, core = _amplitudes(residual)
        kept = wavelet_variance(whole, rate)
        change, drawn = _change(prediction, fitted, shares, core, limit, min(y.size, LONGEST), dt)
        change = change[: len(kept)]
        scale = kept.scale_samples.astype(float)
        added = change[-1] * scale[change.size - 1] / scale
        added[: change.size] = change
        value = np.maximum(kept.value + added, LEAST * kept.value)
        ratio = value / kept.value
        unit = prediction.deviation**2
        scatter = (1.0 / efficiency - 1.0) * 2.0 * unit**2 / y.size + 4.0 * drawn
        scatter += (UNSEEN * _unseen(shares) * AMPLITUDES[0] ** 2 / 3.0 * unit) ** 2
        curve = replace(kept, value=value, low=kept.low * ratio, high=kept.high * ratio, white_scatter=scatter)
        found = np.log(value)
        moved = found[:MEASURED] - given[:MEASURED] if given is not None else np.full(MEASURED, np.inf)
        if np.abs(moved).max() < STAYS * math.sqrt(2.0 / efficiency / y.size):
            break
        given = found
        # towards where the last rounds lead (Anderson 1965)
        if before is not None:
            bend = moved - before[1]
            given = found - np.clip(moved @ bend / (bend @ bend), -FARTHEST, 0.0) * (found - before[0])
        before = (found, moved) if np.isfinite(moved).all() else None
        fitted = fit_curve(replace(curve, value=np.exp(given)), model, start=fitted).model
    seen = shares[1:]
    mean_square = float(seen @ AMPLITUDES**2 / seen.sum()) if seen.sum() > 0 else 0.0
    size = math.sqrt(mean_square) * core * prediction.deviation
    expected = 2.0 * float(scipy.special.ndtr(-limit))
    return CleanedCurve(curve, Outliers(float(seen.sum()), out, size, expected))


def _kept_square(a: Array, limit: float) -> Array:
    """Mean of the squares of normal values around ``a`` that lie within the limit, the others as zeros."""
    high, low = limit - a, -limit - a
    density = [np.exp(-0.5 * v * v) / math.sqrt(2.0 * math.pi) for v in (low, high)]
    inside = scipy.special.ndtr(high) - scipy.special.ndtr(low)
    return np.asarray((1.0 + a * a) * inside - (limit + a) * density[1] - (limit - a) * density[0])


def _change(
    prediction: _Prediction, model: NoiseModel, shares: Array, core: float, limit: float, n: int, dt: float
) -> tuple[Array, float]:
    """What the treatment takes from the curve of a signal drawn from the model, octave by octave, and the variance of the first.

    Most of the scatter of such a draw is that of the mean square which the limit takes from its residuals. Its expectation is known, so that it
    serves as a control variate (Ripley 1987), with its slope from pieces of the signal.
    """
    size, chance = _chances(shares)
    kept = _kept_square(core * size, limit)
    kept[-1] = _kept_square(core * size[-1] * np.linspace(0.0, 1.0, 65), limit).mean()
    found, pieces, controls = [], [], []
    count = min(PIECES, n >> (MEASURED + 3))
    for k in range(DRAWS):
        rng = np.random.default_rng(k)  # the same numbers each time, so that the rounds converge
        clean = model.simulate(n, dt, rng)
        outliers = _drawn(shares, core, n, rng) * prediction.deviation
        _, whole, _ = prediction.cleaned(clean + outliers, outliers != 0.0, limit)
        z = prediction.residual(clean)
        seen = z + outliers / prediction.deviation
        lost = z**2 - np.where(np.abs(seen) > limit, 0.0, seen) ** 2
        found.append(_difference(clean, whole, dt))
        controls.append(lost.mean())
        for part in np.array_split(np.arange(n), max(count, 1)):
            at = slice(part[0], part[-1] + 1)
            pieces.append([lost[at].mean(), *_difference(clean[at], whole[at], dt)])
    change = np.mean(found, axis=0)
    x, *y = np.transpose(np.array(pieces) - np.mean(pieces, axis=0))
    known = count >= FEWEST and prediction.exact
    slope = np.array([x @ v / (x @ x) if known else 0.0 for v in y])
    change -= slope * (np.mean(controls) - 1.0 + chance @ kept)
    return np.asarray(change), float(np.mean((y[0] - slope[0] * x) ** 2) / x.size)


def _difference(clean: Array, whole: Array, dt: float) -> Array:
    curves = [wavelet_variance(v, 1.0 / dt, intervals="eta3").value[:MEASURED] for v in (clean, whole)]
    return np.asarray(curves[0] - curves[1])
