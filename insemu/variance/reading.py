"""Reading an Allan variance curve: N, B, K, Q, R and a correlation time, each with an interval and the range it was read from.

A straight part of the log-log curve is one kind of noise (Allan variance ~ tau^-2: Q, tau^-1: N, flat: B, tau: K, tau^2: R; IEEE Std 952,
Quinchia et al. 2013 section 4.4). Where a slope is not there, nothing is read.

* The straight parts are found on a smooth curve through the data (:func:`insemu.variance.edof.noise_type`), so that the scatter of
  the longest times makes no slopes.
* A coefficient is fitted over its part together with its neighbours' slopes, so that what leaks in from them is not counted; its interval
  uses the degrees of freedom of the curve, the correlation of its octaves, and how far the curve is from straight.
* B is the first flat value (lowest point, else flattest) over 0.664 = sqrt(2 ln 2 / pi). A Gauss-Markov noise of standard
  deviation s is at 0.617 s at most, so a model whose GM has s = 0.664 B does not read back as B but as 0.617 B, or as what white
  noise and random walk make of it.
* Tc comes from the hump of a Gauss-Markov noise (its highest point is at 1.89 Tc) where there is one, else it is the middle of
  the flat part, as Quinchia et al. 2013 takes it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.units import datasheet
from insemu.variance.allan import AllanVariance
from insemu.variance.edof import NoiseType, component_variance, noise_type, octave_correlation

Array = NDArray[np.float64]

#: Flat Allan deviation of flicker noise of unit B: sqrt(2 ln 2 / pi).
FLICKER = float(np.sqrt(2.0 * np.log(2.0) / np.pi))
#: Averaging time, in correlation times, at which the Allan deviation of a Gauss-Markov noise is highest, and that height in its sigma.
GM_PEAK_TIME, GM_PEAK = 1.8926, 0.6174

#: Most that a straight line may miss an octave by, relatively (filters, resonances). What it misses by is estimated: without that, a
#: million samples would pin the line to the first octaves, where real sensors roll off.
_MISFIT = 0.1

#: What a straight description may miss an octave by, relatively, before it counts as wrong (filters roll off at the first octaves).
_ROLL_OFF = 0.003

#: How much closer, in chi-square, a Markov noise must follow the curve than power laws alone to be believed: in place of the random
#: walk, whose limit it is, and next to it, where many time constants have their chance.
_INSTEAD, _BESIDE = 2.5, 9.0

#: Growth of chi-square at the end of a 95 % interval, and without a coefficient that is to count as visible (2.5 standard deviations).
_CHI_SQUARE, _VISIBLE = 3.84, 6.25

#: Slopes of the Allan variance and the factor that its coefficient has: A = factor * X^2 * tau^slope.
_TERMS: dict[str, tuple[float, float]] = {
    "Q": (-2.0, 3.0),
    "N": (-1.0, 1.0),
    "B": (0.0, FLICKER**2),
    "K": (1.0, 1.0 / 3.0),
    "R": (2.0, 0.5),
}

#: SI units of quantization and ramp, whose seconds cancel.
_CANCELLED = {"rad/s": {"Q": "rad", "R": "rad/s^2"}, "m/s^2": {"Q": "m/s", "R": "m/s^3"}}


@dataclass(frozen=True)
class Reading:
    """One coefficient read from a curve.

    Parameters
    ----------
    name : str
        ``"N"``, ``"B"``, ``"K"``, ``"Q"``, ``"R"`` or ``"Tc"``.
    value, low, high : float
        Coefficient and 95 % interval, in ``unit``.
    unit : str
        Datasheet unit (Tables 3-5 of Quinchia et al. 2013); SI where the signal's unit is unknown.
    si_value : float
        The coefficient in the signal's own unit and seconds.
    tau_from_s, tau_to_s : float
        Averaging times it was read from.
    note : str
        What to know about it, or nothing.
    """

    name: str
    value: float
    low: float
    high: float
    unit: str
    si_value: float
    tau_from_s: float
    tau_to_s: float
    note: str = ""


def _generic_unit(name: str, unit: str) -> str:
    u = unit or "1"
    return {"Q": f"{u}*s", "N": f"{u}/sqrt(Hz)", "B": u, "K": f"{u}*sqrt(Hz)", "R": f"{u}/s", "Tc": "s"}[name]


def _reading(name: str, triple: Array, signal_unit: str, span: tuple[float, float], note: str = "") -> Reading:
    """A reading from (value, low, high) in the signal's own unit."""
    si, known = _generic_unit(name, signal_unit), _CANCELLED.get(signal_unit)
    factor, shown = (1.0, si) if known is None else datasheet(1.0, known.get(name, si))
    value, low, high = (float(v) * factor for v in triple)
    return Reading(name, value, low, high, shown, float(triple[0]), *span, note)


def read_curve(curve: AllanVariance, signal_unit: str = "") -> dict[str, Reading]:
    """Return the coefficients that are visible in an overlapping Allan variance over octaves.

    Parameters
    ----------
    curve : AllanVariance
        With ``kind="overlapping"`` and ``grid="octave"``.
    signal_unit : str
        ``"rad/s"``, ``"m/s^2"`` or anything else.

    Returns
    -------
    dict
        Name to :class:`Reading`; a name that is missing is not visible in this record.
    """
    noise = noise_type(2 * curve.m, curve.value / 2.0, curve.n_samples, drift=True)
    if not noise.parts or len(curve) < 4:
        return {}
    fine = np.arange(0.0, np.log2(curve.m[-1]) + 1e-9, 0.125)
    laws = _power_laws(curve, noise)
    smooth = 2.0 * (laws or noise).variance(2.0**fine)
    edof = np.exp(np.interp(fine, np.log2(curve.m), np.log(curve.edof)))
    smoothed = _Smoothed(
        curve, signal_unit, noise, laws is not None, fine, smooth, np.gradient(np.log2(smooth), fine), edof
    )
    out: dict[str, Reading] = {}
    for name in ("Q", "N", "K", "R"):
        inside = np.abs(smoothed.slope - _TERMS[name][0]) < 0.35
        for span in _spans(inside & smoothed.known, 2.0 if name in "QR" else 1.0):
            found = _fit(smoothed, name, span)
            if found is not None:
                out[name] = found
                break
    out.update(_flat(smoothed))
    return {name: out[name] for name in ("Q", "N", "B", "K", "R", "Tc") if name in out}


@dataclass(frozen=True)
class _Smoothed:
    """A curve, and on a fine grid of octaves of the averaging time the sum of noises that follows it.

    Parameters
    ----------
    curve : AllanVariance
    unit : str
        Of the signal.
    noise : NoiseType
    lawful : bool
        Whether the smooth curve is a sum of power laws alone.
    fine : (f,) array
        Octaves.
    smooth, slope, edof : (f,) arrays
        Variance, slope on logarithmic axes, and degrees of freedom of the curve there.
    """

    curve: AllanVariance
    unit: str
    noise: NoiseType
    lawful: bool
    fine: Array
    smooth: Array
    slope: Array
    edof: Array

    @property
    def tau(self) -> Array:
        """Averaging times, s."""
        return np.asarray(2.0**self.fine / self.curve.rate_hz)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Where the slope is more than one or two values."""
        return np.asarray(self.edof >= 2.0)


def _spans(inside: NDArray[np.bool_], octaves: float) -> list[tuple[int, int]]:
    """Runs of ``inside`` that are at least so many octaves long, in order of time (indices of the fine grid, 8 per octave)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
    runs = [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [r for r in runs if r[1] - r[0] >= 8 * octaves]


def _power_laws(curve: AllanVariance, noise: NoiseType) -> NoiseType | None:
    """The simplest description, power laws alone, where nothing speaks against it; else None.

    A comb of Markov noises follows every chance bend of the longest times, so that a straight part has no straight slope any more. Power laws
    must follow the curve within its scatter (1 % level), and one Markov noise in place of the random walk or next to it must not do so
    clearly better.
    """
    use = curve.edof >= 1.2
    m, value, edof = curve.m[use].astype(float), curve.value[use], curve.edof[use]
    together = octave_correlation(noise, m)

    def best(kinds: list[tuple[str, float]], level: Array) -> tuple[float, Array]:
        basis = 2.0 * np.column_stack([component_variance(kind, tc, m) for kind, tc in kinds])
        spread = np.sqrt(2.0 / edof + _ROLL_OFF**2) * level
        root = np.linalg.cholesky(together * np.outer(spread, spread) + 1e-6 * np.diag(spread**2))
        white = np.linalg.solve(root, np.column_stack([basis, value]))
        norm = np.linalg.norm(white[:, :-1], axis=0)
        solution, rest = scipy.optimize.nnls(white[:, :-1] / norm, white[:, -1])
        return float(rest**2), solution / norm

    laws = [("QN", 0.0), ("WN", 0.0), ("RW", 0.0), ("DR", 0.0)]
    level = np.maximum(2.0 * noise.variance(m), 1e-3 * value)
    for _ in range(4):
        distance, weights = best(laws, level)
        level = np.maximum(
            sum(w * 2.0 * component_variance(kind, tc, m) for (kind, tc), w in zip(laws, weights, strict=True)),
            1e-3 * value,
        )
    freedom = value.size - np.count_nonzero(weights)
    if freedom < 3 or distance > scipy.special.chdtri(freedom, 0.01):
        return None
    walkless = [law for law in laws if law[0] != "RW"]
    for tc in 2.0 ** np.arange(0.0, np.log2(m[-1]) + 1.0):
        markov = ("GM", float(tc))
        if (
            best([*walkless, markov], level)[0] < distance - _INSTEAD
            or best([*laws, markov], level)[0] < distance - _BESIDE
        ):
            return None
    parts = [(*law, float(w)) for law, w in zip(laws, weights, strict=True) if w > 0]
    return NoiseType(parts, np.zeros((len(parts), 0)))


def _fit(of: _Smoothed, name: str, span: tuple[int, int]) -> Reading | None:
    """Weighted non-negative fit of the slope and of its neighbours, over the part and one octave on either side or everywhere."""
    curve, everywhere = of.curve, of.lawful
    tau_from, tau_to = (float(of.tau[k]) for k in span)
    drifts = bool(of.slope[span[0] :].max() > 1.2)
    exponent, factor = _TERMS[name]
    near = (curve.tau_s >= tau_from / 2.1) & (curve.tau_s <= tau_to * 2.1)
    use = np.flatnonzero((near | everywhere) & (curve.edof >= 1.2))
    if use.size < 2:
        return None
    tau, value, edof = curve.tau_s[use], curve.value[use], curve.edof[use]
    exponents = [e for e, _ in _TERMS.values() if (everywhere or abs(e - exponent) <= 2.0) and (drifts or e < 2.0)]
    if use.size < len(exponents) + 1:
        exponents = [e for e in exponents if abs(e - exponent) <= 1.0]
    if use.size < len(exponents) + 1:
        exponents = [exponent]
    pivot = float(np.sqrt(tau[0] * tau[-1]))
    basis = (tau[:, None] / pivot) ** np.array(exponents)
    if 1.0 in exponents:
        # averages of a sampled random walk
        basis[:, exponents.index(1.0)] *= 1.0 + 0.5 / curve.m[use].astype(float) ** 2
    level = value
    solution = np.zeros(len(exponents))
    misfit = _MISFIT**2
    for _ in range(5):
        scale = 1.0 / (np.sqrt(2.0 / edof + misfit) * level)
        solution, _ = scipy.optimize.nnls(basis * scale[:, None], value * scale)
        level = np.maximum(basis @ solution, 1e-3 * value)
        misfit = float(np.clip(np.mean((1.0 - value / level) ** 2 - 2.0 / edof), 0.0, _MISFIT**2))
    at = exponents.index(exponent)
    if solution[at] <= 0:
        return None
    # a drift is not random: only what it leaves of the curve scatters, and its product with that
    certain = solution[-1] * basis[:, -1] if exponents[-1] == 2.0 else np.zeros_like(level)
    chance = np.maximum(level - certain, 1e-3 * level)
    spread = np.sqrt(2.0 / edof * (chance**2 + 2.0 * chance * certain))
    covariance = octave_correlation(of.noise, curve.m[use].astype(float)) * np.outer(spread, spread)
    covariance += np.diag((misfit + 1e-8) * level**2)
    white = np.linalg.solve(
        np.linalg.cholesky(covariance), np.column_stack([basis[:, at], np.delete(basis, at, axis=1), value])
    )
    without = (
        scipy.optimize.nnls(white[:, 1:-1], white[:, -1])[1] if len(exponents) > 1 else np.linalg.norm(white[:, -1])
    )
    if without**2 - scipy.optimize.nnls(white[:, :-1], white[:, -1])[1] ** 2 < _VISIBLE:
        return None
    if everywhere:
        triple = _likely(white[:, 0], white[:, 1:-1], white[:, -1])
    else:
        # the neighbours stand for what is no power law: they count as free also where the fit put them at zero
        weighted = basis.T / np.diag(covariance)
        row = np.linalg.solve(weighted @ basis, weighted)[at]
        freedom = 2.0 * solution[at] ** 2 / float(row @ covariance @ row)
        triple = solution[at] * np.array(
            [1.0, freedom / scipy.special.chdtri(freedom, 0.025), freedom / scipy.special.chdtri(freedom, 0.975)]
        )
    return _reading(name, np.sqrt(triple * pivot**-exponent / factor), of.unit, (tau_from, tau_to))


def _likely(target: Array, neighbours: Array, aim: Array) -> Array:
    """Coefficient of ``target`` in ``aim`` (unit scatter) together with non-negative neighbours, and its interval.

    Neighbours that the data do not ask for would only take their share of the scatter: the estimate and the upper end are without them, the lower end
    goes down to what they could explain.
    """

    def distance(a: float, beside: list[int]) -> float:
        left = aim - a * target
        return float(scipy.optimize.nnls(neighbours[:, beside], left)[1] ** 2) if beside else float(left @ left)

    def nearest(beside: list[int]) -> tuple[float, float]:
        solution, rest = scipy.optimize.nnls(np.column_stack([target, neighbours[:, beside]]), aim)
        return float(solution[0]), float(rest**2)

    everything = list(range(neighbours.shape[1]))
    beside = everything
    while beside:
        rest, gone = min((nearest([k for k in beside if k != out])[1], out) for out in beside)
        if rest - nearest(beside)[1] > _CHI_SQUARE:
            break
        beside = [k for k in beside if k != gone]
    lowest, least = nearest(everything)
    value, rest = nearest(beside)
    low = _end(lambda x: distance(lowest - x, everything) - least, lowest, lowest, 0.025)
    high = _end(lambda x: distance(value + x, beside) - rest, value, 64.0 * value, 0.975)
    return np.array([value, min(low, value), max(high, value)])


def _end(growth: Callable[[float], float], value: float, reach: float, tail: float) -> float:
    """The end of a chi-square interval whose standard deviation is where the distance has grown as for one."""
    far = growth(reach) - _CHI_SQUARE
    # as a share of the reach: the solver's tolerance is absolute, and squares of quiet sensors are below it
    share = (
        float(scipy.optimize.brentq(lambda u: growth(u * reach) - _CHI_SQUARE, 0.0, 1.0, rtol=1e-4)) if far > 0 else 1.0
    )
    sigma = share * reach / 1.96
    freedom = 2.0 * value**2 / sigma**2
    return float(value * freedom / scipy.special.chdtri(freedom, tail))


def _flat(of: _Smoothed) -> dict[str, Reading]:
    """B from the lowest point of the flat part, Tc from the hump after it or from the part's middle."""
    fine, tau, smooth, slope, edof, known = of.fine, of.tau, of.smooth, of.slope, of.edof, of.known
    out: dict[str, Reading] = {}
    flat = (np.abs(slope) < 0.5) & known
    runs = [r for r in _spans(flat, 0.5) if r[0] > 0]  # a curve that begins flat has no white noise to come down from
    runs = [r for r in runs if slope[r[0] : r[1] + 1].max() > -0.25]
    if not runs:
        runs = [r for r in _spans(flat, 3.0)]
        if not runs:
            return out
    first, last = runs[0]
    within = slope[first : last + 1]
    turns = np.flatnonzero((within[1:] >= 0.0) & (within[:-1] < 0.0))
    low_at = first + (int(turns[0]) + 1 if turns.size else int(np.argmin(np.abs(within))))
    if not _above_white(of.curve, tau[low_at], smooth[low_at]):
        return out
    span = (float(tau[first]), float(tau[last]))
    freedom = float(edof[low_at])
    level = float(smooth[low_at])
    bounds = [
        level * freedom / scipy.special.chdtri(freedom, 0.025),
        level * freedom / scipy.special.chdtri(freedom, 0.975),
    ]
    octaves = float(fine[last] - fine[first])
    note = ""
    if octaves < 2.0:
        note = "upper bound: the flat part is no wider than where a falling and a rising slope meet"
    out["B"] = _reading("B", np.sqrt(np.array([level, *bounds])) / FLICKER, of.unit, span, note)
    # a hump: rising, then falling again
    top = next((k for k in range(low_at + 1, fine.size - 1) if slope[k] >= 0.0 > slope[k + 1] and known[k]), None)
    if top is not None and slope[low_at : top + 1].max() > 0.1:
        near = np.flatnonzero((smooth > 0.9 * smooth[top]) & (np.arange(fine.size) >= low_at))
        tc = float(tau[top]) / GM_PEAK_TIME
        ends = [float(tau[k]) / GM_PEAK_TIME for k in (near[0], near[-1])]
        out["Tc"] = _reading("Tc", np.array([tc, *ends]), "", span, "from the hump at 1.89 Tc")
    elif octaves >= 1.0:
        out["Tc"] = _reading("Tc", np.array([np.sqrt(span[0] * span[1]), *span]), "", span, "middle of the flat part")
    return out


def _above_white(curve: AllanVariance, tau: float, level: float) -> bool:
    """Whether the flat level stands above the line on which the shortest times would put it, at the 0.1 % level."""
    at = int(np.argmin(np.abs(np.log(curve.tau_s / tau))))
    earlier = curve.value[: at + 1] * curve.tau_s[: at + 1]
    if at == 0 or earlier.size == 0:
        return True
    white = float(earlier.min() / curve.tau_s[at])
    freedom = float(curve.edof[at])
    return (
        bool(curve.value[at] * freedom / scipy.special.chdtri(freedom, 0.001) > white)
        if white < curve.value[at]
        else level > white
    )
