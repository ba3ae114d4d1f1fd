"""What the slow errors of two axes of a sensor have in common: the candidate "shared process" of a log at rest.

Each axis's block differences, whitened by its own explanation and turned to zero phase, are independent noise at every frequency. A process that
two axes share makes them coherent there, in proportion to the shares of the slow processes in both spectra. The coherence of two complex Gaussian
numbers is all that is left to weigh (Bendat and Piersol 2010, section 5.2), with the correlation of the slow processes anywhere between -1 and 1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.gap.candidates.axis import AxisState
from insemu.gap.data.log import difference_covariance, scale_of
from insemu.gap.verdict import Finding, Member, Value
from insemu.noise import GM, NoiseModel, shared_processes

Array = NDArray[np.float64]
Pair = tuple[str, str]

EFFECT = "shared_process"
#: Correlations that are weighed.
RHO = np.linspace(-1.0, 1.0, 403)[1:-1]
#: Largest coherence at a frequency: levels are known to a few percent only.
COHERENT = 0.999


@dataclass(frozen=True)
class Whitened:
    """Block differences of an axis as independent complex numbers, and what its slow processes make of them.

    Parameters
    ----------
    values : (f,) complex array
        Unit variance where the explanation is right.
    gain : (f,) array
        Root of the share of the slow processes in the spectrum.
    total : (f,) array
        Spectrum of the block differences, unit^2.
    """

    values: NDArray[np.complex128]
    gain: Array
    total: Array


@dataclass(frozen=True)
class Common:
    """The correlation of the slow processes of two axes.

    Parameters
    ----------
    axes : (str, str)
    nats : float
        Log evidence over none, less the logarithm of how many pairs were looked at.
    value, low, high : float
        Correlation and its 95 % interval.
    p_value : float
        Of the axes having no more in common than is believed.
    """

    axes: Pair
    nats: float
    value: float
    low: float
    high: float
    p_value: float


def _spectrum(covariance: Array) -> Array:
    """Spectrum at the frequencies of a real transform of as many values, from an autocovariance of that length."""
    n = covariance.size
    tapered = covariance * (1.0 - np.arange(n) / n)
    return np.asarray(np.maximum(2.0 * np.fft.rfft(tapered).real - covariance[0], 1e-12 * covariance[0]))


def whitened_blocks(state: AxisState, innovations: Array) -> Whitened:
    """The block innovations of an axis in frequency, at zero phase.

    Parameters
    ----------
    state : AxisState
    innovations : (blocks - 1,) array
        :func:`insemu.gap.checks.rest.block_innovations`.
    """
    data, n = state.data, innovations.size
    total = _spectrum(state.explanation.covariance(data.block, data.dt, n))
    slow = np.zeros(n)
    for c in state.explanation.components:
        if c.process.remembers(data.dt):
            slow += difference_covariance(c.process, data.block, data.dt, n)
    # the innovations are those of the minimum-phase filter of this spectrum; its phase follows from the cepstrum
    whole = np.concatenate([total, total[-2 if n % 2 == 0 else -1 : 0 : -1]])
    cepstrum = np.fft.ifft(0.5 * np.log(whole)).real
    fold = np.zeros(n)
    fold[0], fold[1 : (n + 1) // 2], fold[n // 2 : n // 2 + 1 - n % 2] = 1.0, 2.0, 1.0
    phase = np.fft.fft(cepstrum * fold)[: total.size].imag
    z = np.fft.rfft(innovations) / math.sqrt(n) * np.exp(1j * phase)
    inner = slice(1, total.size - (n % 2 == 0))  # the ends are real
    gain = np.sqrt(np.clip(_spectrum(slow) / total, 0.0, 1.0)) if slow[0] > 0 else np.zeros(total.size)
    return Whitened(z[inner], gain[inner], total[inner])


def believed_coherence(states: Mapping[str, AxisState], white: Mapping[str, Whitened]) -> dict[Pair, Array]:
    """Coherence of every pair of axes that follows from processes with a common name."""
    models = {a: NoiseModel(tuple(c.process for c in s.explanation.components)) for a, s in states.items()}
    out: dict[Pair, Array] = {}
    for members in shared_processes(models).values():
        for one, two in combinations(members, 2):
            data, n = states[one.axis].data, states[one.axis].data.differences.size
            shape = _spectrum(difference_covariance(one.process, data.block, data.dt, n))[
                1 : white[one.axis].values.size + 1
            ]
            cross = shape * two.weight / one.weight / np.sqrt(white[one.axis].total * white[two.axis].total)
            pair = (one.axis, two.axis)
            out[pair] = out.get(pair, 0.0) + cross
    return out


def common(states: Mapping[str, AxisState], white: Mapping[str, Whitened], known: Mapping[Pair, Array]) -> list[Common]:
    """Every pair of axes of one sensor, weighed.

    Parameters
    ----------
    states : mapping
        Axis to its state.
    white : mapping
        Axis to its whitened block differences.
    known : mapping
        Pair to the coherence that is believed.
    """
    sensors = {a: a.rpartition("_")[0] for a in states}
    pairs = [(a, b) for a, b in combinations(states, 2) if sensors[a] and sensors[a] == sensors[b]]
    pairs = [(a, b) for a, b in pairs if white[a].values.size == white[b].values.size]
    return [_weighed(pair, white[pair[0]], white[pair[1]], known.get(pair), len(pairs)) for pair in pairs]


def _weighed(pair: Pair, one: Whitened, two: Whitened, known: Array | None, looked_at: int) -> Common:
    base = np.zeros(one.values.size) if known is None else np.clip(known, -COHERENT, COHERENT)
    product, power = (one.values * two.values.conj()).real, np.abs(one.values) ** 2 + np.abs(two.values) ** 2
    weight = one.gain * two.gain

    def likelihood(coherence: Array) -> Array:
        g = np.clip(coherence, -COHERENT, COHERENT)
        return np.asarray(-np.log1p(-g * g) - (power - 2.0 * g * product) / (1.0 - g * g))

    logs = np.array([likelihood(base + rho * weight).sum() for rho in RHO]) - likelihood(base).sum()
    nats = float(scipy.special.logsumexp(logs) - math.log(RHO.size)) - math.log(looked_at)
    share = np.cumsum(np.exp(logs - scipy.special.logsumexp(logs)))
    low, value, high = (float(np.interp(q, share, RHO)) for q in (0.025, 0.5, 0.975))
    spread = math.sqrt(0.5 * float(np.sum(weight**2 * (1.0 + base**2))))
    z = float(weight @ (product - base)) / spread if spread > 0 else 0.0
    return Common(pair, nats, value, low, high, float(scipy.special.erfc(abs(z) / math.sqrt(2.0))))


# -- what a find changes ------------------------------------------------------------------------------------------------------------------


def finding_of(names: list[str], found: list[Common]) -> Finding:
    """The axes of a group as one finding, with the correlation of every pair that was found.

    Parameters
    ----------
    names : list of str
        Axes of one sensor.
    found : list of Common
        Pairs above the threshold.
    """
    sensor = names[0].rpartition("_")[0]
    pairs = [c for c in found if set(c.axes) <= set(names)]
    values = tuple(Value("correlation_" + "".join(a[-1] for a in c.axes), c.value, c.low, c.high, "1") for c in pairs)
    nats = max(c.nats for c in pairs)
    axes = tuple(a[-1] for a in names)
    own = Member(EFFECT, sensor, axes, nats)
    return Finding(EFFECT, "common drift", sensor, axes, values, 1.0 / (1.0 + math.exp(-nats)), nats, (own,))


def groups_of(found: list[Common]) -> list[tuple[list[str], dict[str, float]]]:
    """Axes that hang together, and the share of each axis's slow amplitude that is common, with its sign (one common factor)."""
    groups: list[set[str]] = []
    for c in found:
        touching = [g for g in groups if g & set(c.axes)]
        groups = [g for g in groups if g not in touching] + [set(c.axes).union(*touching)]
    out = []
    for group in groups:
        names = sorted(group)
        rho = {frozenset(c.axes): c.value for c in found if set(c.axes) <= group}
        sign = dict.fromkeys(names, 1.0)
        for a, b in combinations(names, 2):  # in order, so that a is settled before b
            if frozenset((a, b)) in rho and rho[frozenset((a, b))] < 0 and a == names[0]:
                sign[b] = -1.0
        rows = [[float(n in pair) for n in names] for pair in rho]
        solved = np.linalg.lstsq(np.array(rows), np.log(np.maximum(np.abs(list(rho.values())), 1e-6)), rcond=None)[0]
        out.append((names, {n: sign[n] * min(math.exp(v), 1.0) for n, v in zip(names, solved, strict=True)}))
    return out


def with_common(
    models: Mapping[str, NoiseModel], shares: Mapping[str, float], label: str, block_s: float, dt: float
) -> dict[str, NoiseModel]:
    """The models of some axes with their largest slow process split into a shared part and an own one.

    The shared part has one shape: of Gauss-Markov processes the geometric mean of the rates, else that of the axis that shares most.

    Parameters
    ----------
    models : mapping
        Axis to model.
    shares : mapping
        Axis to the share of its slow amplitude that is common, with its sign.
    label : str
        Name of the shared process.
    block_s, dt : float
        Length of a block and sampling interval, s.
    """
    m = max(round(block_s / dt), 1)
    largest = {
        a: max((p for p in models[a] if p.remembers(dt)), key=lambda p: float(p.difference_covariance(m, dt, 1)[0]))
        for a in shares
    }
    leader = largest[max(shares, key=lambda a: abs(shares[a]))]
    if all(isinstance(p, GM) for p in largest.values()):
        rates = [p.parameters["beta"] for p in largest.values()]
        leader = leader.with_parameters({"beta": math.exp(float(np.mean(np.log(rates))))})
    out = dict(models)
    for a, share in shares.items():
        mine = largest[a]
        wanted = share**2 * float(mine.difference_covariance(m, dt, 1)[0])
        unit = float(leader.difference_covariance(m, dt, 1)[0]) / scale_of(leader)
        level = (wanted / unit) ** (0.5 * leader.level.power)
        together = replace(
            leader.with_parameters({leader.level.name: level}), shared=("-" if share < 0 else "") + label
        )
        parts = [together if p is mine else p for p in models[a]]
        if share**2 < 0.98:
            parts.append(mine.scaled(math.sqrt(1.0 - share**2)))
        out[a] = NoiseModel(tuple(parts))
    return out
