"""What the vehicle itself does above the motion: estimated first, so that no sensor is blamed for it.

A sensor's own noise and lines sit on one axis. What several axes show together (coherent, or loud at the same times, or on most axes at
once) is the body moving, and so is a spectrum that falls from the edge of the band without a peak of its own. It reaches the navigation as motion,
and is no finding.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu import rotation
from insemu.filters import SAME_TIME, FilterResult
from insemu.gap.data.log import Reduced, moving_spectrum, unheard
from insemu.gap.data.samples import without_motion
from insemu.gap.policy import rules
from insemu.gap.verdict import InBand
from insemu.lost import STRAY
from insemu.noise import NoiseModel
from insemu.records import AXES, GnssRecord, ImuRecord

Array = NDArray[np.float64]

#: Length of the pieces in which axes are held against each other, s.
PIECE_S = 1.0
#: Shares of the changes of a rate from sample to sample by which the velocity of the antenna may be off, squared: more than one where most of the
#: shaking is faster than half of the samples (25 Hz of a machine's 22 to 135).
SHARES = (0.0, *np.geomspace(0.003, 10.0, 12))
#: Samples to either side of a fix through whose angles and velocities the motion goes there. At 8 Hz and 50 samples a second the rate of turn that
#: the polynomial gives is 3 % too small with two, which was answered with a lever arm of 1 %, and 0.2 % with four; judged by
#: ``python -m benchmarks.foreign --kinds none --recordings 100 --seed 530000 --imu-hz 50``.
BESIDE = 4


@dataclass(frozen=True)
class _Excess:
    """What an axis shows beyond its noise: what is believed of it, and no more than it shows in the quietest third of the record.

    A sensor is as noisy while the vehicle stands. What comes and goes hides below a belief that is too large and looks like a low-pass there.

    Parameters
    ----------
    noise : (k,) array
        PSD of the noise.
    ratio : (k,) array
        Spectrum over the highest level that the tolerance allows.
    loud : (k,) array of bool
        Bins that exceed it beyond doubt.
    nats : float
        What a spectrum of its own is worth there.
    """

    noise: Array
    ratio: Array
    loud: NDArray[np.bool_]
    nats: float

    @classmethod
    def of(cls, data: Reduced, belief: NoiseModel) -> _Excess:
        """Bin by bin."""
        noise = (
            belief.psd(data.f, data.dt) if data.quiet is None else np.minimum(belief.psd(data.f, data.dt), data.quiet)
        )
        ratio = data.power / (noise * (1.0 + rules().tolerance) ** 2)
        gain = 0.5 * data.dof * np.where(ratio > 1.0, ratio - 1.0 - np.log(ratio), 0.0)
        loud = gain > rules().shaking_bin
        return cls(noise, ratio, loud, float(gain[loud].sum()))


def without_shaking(parts: Mapping[str, Reduced], beliefs: Mapping[str, NoiseModel]) -> dict[str, Reduced]:
    """The band of every axis without what the vehicle does there; an axis on which that is everything is not heard.

    Parameters
    ----------
    parts : mapping of axis to Reduced
        The band above the motion as it was recorded.
    beliefs : mapping of axis to NoiseModel

    Returns
    -------
    dict of axis to Reduced
        Where something was taken for motion, ``shaking`` says what.
    """
    heard = {name: data for name, data in parts.items() if data.f.size and name in beliefs}
    excess = {name: _Excess.of(data, beliefs[name]) for name, data in heard.items()}
    shakes = [name for name, e in excess.items() if e.nats > rules().shaking_nats]
    together = _shared_excess({name: heard[name] for name in shakes}, excess)
    out = dict(parts)
    for name, data in heard.items():
        shared = max((together[name, o] for o in shakes if o != name), default=0.0) if name in shakes else 0.0
        if name in shakes and (len(shakes) >= rules().shaking_axes or shared > 0.0):
            out[name] = replace(unheard(data), shaking=_reported(data, excess[name], shared))
        elif (edge := _tail(data, beliefs[name])) > 0:
            out[name] = _above(data, edge)
    return out


def _shared_excess(loud: Mapping[str, Reduced], excess: Mapping[str, _Excess]) -> dict[tuple[str, str], float]:
    """Share of the excess of two axes that goes together, zero where that may be chance: coherence, or loudness that rises and falls alike."""
    spectra, levels = {}, {}
    for name, data in loud.items():
        length = max(16, round(PIECE_S / data.dt))
        count = data.values.size // length
        pieces = data.values[: count * length].reshape(count, length)
        z = np.fft.rfft((pieces - pieces.mean(axis=1, keepdims=True)) * np.hanning(length), axis=1)
        f = np.arange(z.shape[1]) / (length * data.dt)
        inside = (f >= data.f[0]) & (f <= data.f[-1])
        at = np.clip(np.searchsorted(data.f, f[inside]), 0, data.f.size - 1)
        spectra[name] = np.where(excess[name].loud[at], z[:, inside], 0.0)
        power = np.sum(np.abs(spectra[name]) ** 2, axis=1)
        levels[name] = np.log(np.maximum(power, 1e-300))
        spectra[name] = spectra[name] / np.sqrt(np.maximum(power, 1e-300))[:, None]
    out: dict[tuple[str, str], float] = {}
    names = list(loud)
    for i, a in enumerate(names):
        for b in names[i + 1 :]:
            count = min(levels[a].size, levels[b].size)
            share = 0.0
            if count > 20 and spectra[a].shape[1] == spectra[b].shape[1]:
                share = max(
                    _coherence(spectra[a][:count], spectra[b][:count]),
                    _loudness_correlation(levels[a][:count], levels[b][:count]),
                )
            out[a, b] = out[b, a] = share
    return out


def _coherence(a: Array, b: Array) -> float:
    """Mean squared coherence of two axes over the ordinates that both fill, weighed by their power; zero where it may be chance."""
    count = a.shape[0]
    cross = np.abs(np.sum(a * np.conj(b), axis=0)) ** 2
    own, other = np.sum(np.abs(a) ** 2, axis=0), np.sum(np.abs(b) ** 2, axis=0)
    both = (own > 0.0) & (other > 0.0)
    if both.sum() < 2:
        return 0.0
    squared = np.minimum(cross[both] / (own[both] * other[both]), 1.0 - 1e-12)
    # of independent noise each is beta distributed; neighbouring ordinates share a window, so half of them count
    statistic = -(count - 1.0) * float(np.sum(np.log1p(-squared)))
    if scipy.stats.gamma.sf(0.5 * statistic, 0.5 * both.sum()) > rules().shaking_p:
        return 0.0
    weight = own[both] * other[both]
    return float(np.sum(weight * squared) / np.sum(weight))


def _loudness_correlation(a: Array, b: Array) -> float:
    """Squared correlation of the loudness of two axes over time, less its slow part's luck; zero where it may be chance."""
    r = float(np.corrcoef(a, b)[0, 1])
    # loudness has a memory: as many independent values as its autocorrelation leaves
    memory = [float(np.corrcoef(x[:-1], x[1:])[0, 1]) for x in (a, b)]
    product = min(max(memory[0] * memory[1], 0.0), 0.98)
    free = max(a.size * (1.0 - product) / (1.0 + product), 4.0)
    return (
        r * r
        if r > 0.0 and scipy.stats.norm.sf(math.atanh(min(r, 1.0 - 1e-12)) * math.sqrt(free - 3.0)) < rules().shaking_p
        else 0.0
    )


def _tail(data: Reduced, belief: NoiseModel) -> int:
    """Bins from the lower edge of the band that hold motion: together louder than the noise further up, and falling."""
    ratio = data.power / belief.psd(data.f, data.dt)
    # at least what is believed: a low-pass leaves less further up, which is no excess below
    level = max(float(np.median(ratio[ratio.size // 2 :])), 1.0)
    # what the bins from the edge on gather, each with a little taken off so that noise gathers nothing
    gathered = np.cumsum((ratio / level - 1.0) * np.sqrt(0.5 * data.dof) - 0.5)
    end = int(np.argmax(gathered)) + 1
    if gathered[end - 1] < rules().tail_sum or end > ratio.size - 8:
        return 0
    # a peak of its own stands clear of the edge
    low = data.f[:end] < rules().tail_peak * data.f[0]
    return end if low.all() or float(ratio[:end][low].max()) >= float(ratio[:end][~low].max()) else 0


def _above(data: Reduced, edge: int) -> Reduced:
    """The band from a bin on."""
    lowest = float(data.f[min(edge + 1, data.f.size - 1)])
    values = without_motion(data.values, data.dt, 0.6 * lowest, whole=True)
    f, power, dof = moving_spectrum(values, data.dt, lowest)
    return replace(data, values=values, f=f, power=power, dof=dof, quiet=None)


def _reported(data: Reduced, e: _Excess, shared: float) -> InBand:
    """An axis's motion above its noise, for the report."""
    width = np.gradient(data.f)
    power = np.maximum(data.power - e.noise, 0.0) * width * e.loud
    total = float(power.sum())
    low, high = (
        float(data.f[np.searchsorted(np.cumsum(power), q * total).clip(max=data.f.size - 1)]) for q in (0.05, 0.95)
    )
    return InBand(data.name, math.sqrt(2.0 * total), data.unit, low, high, shared)


# -- what shaking does to the integrals of the IMU ---------------------------------------------------------------------------------------


def rectified(imu: ImuRecord, fast: Mapping[str, Reduced]) -> Array | None:
    """What shaking may leave in the mean rate and specific force, (n, 2) in rad/s and m/s^2; None where the vehicle does not shake.

    Turns and accelerations of the same vibration rectify: coning and sculling. Of frequencies near half the sampling rate a strapdown algorithm
    takes off little, beyond it nothing. The size follows the loudness, the direction is fixed in the body: a column per axis at these scales.

    Parameters
    ----------
    imu : ImuRecord
    fast : mapping of axis to Reduced
        The band above the motion; ``shaking`` says which axes shake.

    References
    ----------
    .. [1] Savage (1998); Titterton and Weston (2004), sections 11.3.2 and 11.4.2.
    """
    corner = 0.6 * min(rules().motion_hz, 0.25 / imu.dt)
    half, power = max(1, round(PIECE_S / imu.dt)), np.zeros((len(imu), 2))
    for k, name in enumerate(AXES):
        if fast[name].shaking is not None:
            total = np.cumsum(without_motion(imu.rates()[:, k], imu.dt, corner, whole=True) ** 2)
            at = np.arange(len(imu))
            low, high = np.maximum(at - half, 0), np.minimum(at + half, len(imu) - 1)
            power[:, k // 3] += (total[high] - total[low]) / (high - low)
    if not power.any():
        return None
    gyro, accel = power.T
    # half the product of angle and acceleration, of angle and rate; the angle is at most the rate times a sampling interval or so up there
    return np.stack([imu.dt * gyro, imu.dt * np.sqrt(gyro * accel)], axis=1)


# -- what fast motion does to the velocity of the antenna ---------------------------------------------------------------------------------


def steadied(
    imu: ImuRecord, gnss: GnssRecord, used: GnssRecord, result: FilterResult, lever_arm: Array, arm: Array
) -> GnssRecord:
    """The fixes with velocities as the filter should have compared them, where the vehicle moves fast; the same object where it does not.

    The filter carries the rate of turn and its velocity from the last samples to the fix, which a shaking vehicle spoils; the samples that follow
    tell better. Where the antenna swings on its arm, noise of the velocity is left that goes with the shaking, its size chosen by the innovations.

    Parameters
    ----------
    imu : ImuRecord
    gnss, used : GnssRecord
        The fixes as they were recorded, and as they went into the filter: an earlier answer, or the same.
    result : FilterResult
    lever_arm, arm : (3,) arrays
        By which the filter takes the antenna back, and on which it swings; m, body axes.

    References
    ----------
    .. [1] Groves (2013), section 14.3.2.
    """
    fixes = result.fixes
    there = np.isfinite(fixes.innovation[:, 3:]).all(axis=1)
    there &= (fixes.epoch >= BESIDE) & (fixes.epoch < len(imu) - BESIDE)
    if gnss.vel_ned is None or gnss.vel_std_ned is None or there.sum() < 30:
        return gnss
    k, rate = fixes.epoch[there], _rates(imu)
    C = rotation.dcm_from_quaternion(result.nav[k, 6:10])
    missed = velocity_missed(imu, result.nav, fixes.t[there], lever_arm)
    # how much it shakes: changes from sample to sample over a second before and after
    change = np.diff(rate, axis=0, prepend=rate[:1]) ** 2
    half = max(1, round(PIECE_S / imu.dt))
    total = np.cumsum(np.vstack([np.zeros(3), change]), axis=0)
    low, high = np.maximum(k - half, 0), np.minimum(k + half, len(imu))
    mean = (total[high] - total[low]) / (high - low)[:, None]
    skew = np.array([[0.0, arm[2], -arm[1]], [-arm[2], 0.0, arm[0]], [arm[1], -arm[0], 0.0]])
    blurred = np.einsum("nij,nj->ni", (C @ skew) ** 2, mean)
    at = np.searchsorted(gnss.t, fixes.t[there])
    assert used.vel_ned is not None and used.vel_std_ned is not None
    plain = fixes.innovation[there, 3:] + (gnss.vel_ned - used.vel_ned)[at]
    S = fixes.S[there][:, 3:, 3:] - (used.vel_std_ned**2 - gnss.vel_std_ned**2)[at, :, None] * np.eye(3)
    # an arm that is another than believed swings as well, which must not decide
    swings = C @ np.swapaxes(np.cross(rate[k][:, None], np.eye(3)), 1, 2)
    best = start = _velocity_score(plain, S, swings)
    chosen, share = 0.0, np.zeros(3)
    for shifted in (0.0, 1.0):
        nu, tried = plain - shifted * missed, np.zeros(3)
        for component in (0, 1, 2, 0, 1, 2) if np.any(arm) else ():
            scores = {}
            for size in SHARES:
                tried[component] = size
                scores[size] = _velocity_score(nu, S + (tried * blurred)[:, :, None] * np.eye(3), swings)
            tried[component] = max(scores, key=lambda size: scores[size])
        score = _velocity_score(nu, S + (tried * blurred)[:, :, None] * np.eye(3), swings)
        if score > best:
            best, chosen, share = score, shifted, tried
    if best - start < rules().swing_nats:
        return gnss
    vel, sigma = gnss.vel_ned.copy(), gnss.vel_std_ned.copy()
    vel[at] -= chosen * missed
    sigma[at] = np.sqrt(sigma[at] ** 2 + share * blurred)
    return replace(gnss, vel_ned=vel, vel_std_ned=sigma)


def velocity_missed(imu: ImuRecord, nav: Array, t: Array, lever_arm: Array) -> Array:
    """What a filter misses of the antenna's velocity at fixes, (f, 3) NED in m/s: how fast it turns, and how it got from one sample to the next.

    The filter carries the rate of turn from the last two samples, and its velocity along the mean acceleration of the last interval. Here both are
    slopes and values of polynomials through the samples on both sides.

    Parameters
    ----------
    imu : ImuRecord
        n rows.
    nav : (n, 10) array
        Of the filter.
    t : (f,) array
        Times of the fixes, s; zero where fewer than :data:`BESIDE` samples are before or behind, or a gap is among them.
    lever_arm : (3,) array
        m, body axes.
    """
    k = np.searchsorted(imu.t, t - SAME_TIME * imu.dt)
    there = (k >= BESIDE) & (k < len(imu) - BESIDE)
    nodes = np.arange(-BESIDE, BESIDE + 1)
    stamps = imu.t[np.where(there, k, BESIDE)[:, None] + nodes]
    # a sensor samples evenly, whatever its stamps do; nothing is known of the motion within a gap
    middle = np.mean(stamps, axis=1)
    there &= (np.abs(stamps - middle[:, None] - imu.dt * nodes) < STRAY * imu.dt).all(axis=1)
    k, out = k[there], np.zeros((t.size, 3))
    near = k[:, None] + nodes
    # of the polynomials through the nodes
    of_nodes = np.linalg.inv(np.vander(nodes.astype(np.float64), increasing=True))
    powers = np.vander((t - middle)[there] / imu.dt, nodes.size, increasing=True)
    values, slopes = powers @ of_nodes, (powers[:, :-1] * np.arange(1, nodes.size)) @ of_nodes[1:] / imu.dt
    late = ((imu.t[k] - t[there]) / (imu.t[k] - imu.t[k - 1]))[:, None]
    grown = imu.as_increments()
    turned, gained = grown.gyro[near], grown.accel[near]
    C = rotation.dcm_from_quaternion(nav[near, 6:10])
    if np.any(lever_arm):
        rate = _rates(imu)
        carried = rate[k] + (0.5 - late) * (rate[k] - rate[k - 1])
        between = np.einsum("nj,nji->ni", slopes, np.cumsum(turned, axis=1))
        out[there] = np.einsum("nij,nj->ni", C[:, BESIDE], np.cross(between - carried, lever_arm))
    # from node to node, each increment turned as the body stood in its middle
    velocity = np.cumsum(np.einsum("njab,njb->nja", C, gained - 0.5 * np.cross(turned, gained)), axis=1)
    straight = velocity[:, BESIDE] - late * (velocity[:, BESIDE] - velocity[:, BESIDE - 1])
    out[there] += np.einsum("nj,nji->ni", values, velocity) - straight
    return out


def _rates(imu: ImuRecord) -> Array:
    """Mean rates (n, 3) over the intervals, rad/s."""
    return imu.as_increments().gyro / np.diff(imu.t, prepend=2.0 * imu.t[0] - imu.t[1])[:, None]


def _velocity_score(nu: Array, S: Array, beside: Array) -> float:
    """Log likelihood of velocity innovations (k, 3) with covariances (k, 3, 3), less its constant, beside columns (k, 3, c) at their best."""
    L = np.linalg.cholesky(S)
    white, own = np.linalg.solve(L, nu[:, :, None]).ravel(), np.linalg.solve(L, beside).reshape(nu.size, -1)
    left = white - own @ np.linalg.lstsq(own, white, rcond=None)[0]
    return -0.5 * float(left @ left) - float(np.sum(np.log(np.einsum("kii->ki", L))))
