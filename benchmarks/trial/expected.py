"""What an effect hidden in a log at rest is expected to add to the evidence: over the belief with its tolerances, its parameters paid for.

Only the maker of a recording can say this. The expectation of the log-likelihood under the truth needs no draw: above the block band it is Whittle's
with the true spectrum for the power, below it the Gaussian one with the trace of ``C^-1 C_true`` for the squares. Its optimum is weighed as every
explanation is, by Laplace's approximation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.effects import EffectUse
from insemu.gap import rules
from insemu.gap.candidates import bias_nats, mean_spread, paid_for_start, starts_at_rest, step_of_blocks
from insemu.gap.data import Reduced, block_differences, block_length, spectrum_bins
from insemu.gap.evidence import (
    DEPTH,
    Band,
    Component,
    Explanation,
    Free,
    Likelihood,
    Regressors,
    Rolloff,
    laplace,
    log_mean_exp,
    regression_evidence,
    toeplitz_whiten,
)
from insemu.noise import BI, GM, RW, WN, NoiseModel, Process

Array = NDArray[np.float64]

#: Effects that a spectrum, block means and known shapes describe; the rest is read off the samples and has its own formula, or none.
GAUSSIAN = (
    "white_noise", "random_walk", "gauss_markov", "telegraph", "flicker", "ramp", "bias_step", "temperature", "vibration_band",
    "decimation_filter",
)  # fmt: skip
#: Sizing stops within this share of the wanted evidence, after this many trials, or at this factor of the strength it began with.
CLOSE, TRIALS, MOST_STRENGTH = 0.03, 14, 1e3


@dataclass
class Expected(Likelihood):
    """Expectation of the log-likelihood of a reduced log under its truth.

    Parameters
    ----------
    data : Reduced
        With the true spectrum as ``power`` and the block differences of what is no noise as ``differences``.
    gamma : (blocks - 1,) array
        True autocovariance of the block differences.
    """

    gamma: Array = field(default_factory=lambda: np.zeros(0))

    def low_of(self, gamma: Array, regressors: Sequence[Regressors]) -> float:
        """Expected Gaussian log-likelihood of the block differences, regressors integrated out at their expected projections."""
        stacked = np.hstack([self.data.differences[:, None], *(r.columns for r in regressors)])
        white = np.empty_like(stacked)
        logdet = toeplitz_whiten(gamma, stacked, white)
        if not math.isfinite(logdet):
            return -math.inf
        e, G = white[:, 0], white[:, 1:]
        value = -0.5 * (logdet + trace_of_ratio(gamma, self.gamma) + float(e @ e))
        if G.shape[1]:
            scales = np.concatenate([r.scales for r in regressors])
            value += regression_evidence(G.T @ G, G.T @ e, scales)
        return value

    def score_of(self, gamma: Array, regressors: Sequence[Regressors] = ()) -> None:
        """Only values are known of an expectation: the derivatives of the likelihood of the data are not its own."""


def _evidence(likelihood: Expected, explanation: Explanation) -> float:
    """Log evidence at the optimum of an expectation, which is known by its values alone."""
    return laplace(likelihood.along(explanation), explanation.start(), explanation.free).evidence


def trace_of_ratio(gamma: Array, true: Array) -> float:
    """Return ``tr(C^-1 C_true)`` of two symmetric Toeplitz matrices, from the sums of the diagonals of the inverse (Gohberg and Semencul)."""
    n = gamma.size
    x = scipy.linalg.solve_toeplitz(gamma, np.eye(1, n)[0])
    a = x / x[0]
    size = 1 << (2 * n - 1).bit_length()
    spectrum, ramped = np.fft.rfft(a, size), np.fft.rfft(a * np.arange(n), size)
    lag = np.arange(n)
    plain = np.fft.irfft(np.conj(spectrum) * spectrum, size)[:n]
    moment = np.fft.irfft(np.conj(ramped) * spectrum, size)[:n]
    sums = x[0] * ((n - lag) * plain - 2.0 * moment)
    return float(sums[0] * true[0] + 2.0 * (sums[1:] @ true[1:]))


@dataclass(frozen=True)
class Log:
    """A log at rest as its maker knows it, one axis.

    Parameters
    ----------
    truth, belief : NoiseModel
        Processes in the same order.
    n, dt : int, float
        Samples and their interval (s).
    axis : int
        Which component of an effect's parameters is meant.
    temperature : (n,) array, optional
        degC.
    """

    truth: NoiseModel
    belief: NoiseModel
    n: int
    dt: float
    axis: int = 0
    temperature: Array | None = None

    @property
    def white(self) -> float:
        """Density of the true white noise."""
        return math.sqrt(sum(p.parameters["N"] ** 2 for p in self.truth if isinstance(p, WN)))

    def nominal(self) -> Explanation:
        """The belief with its tolerances."""
        return Explanation.nominal(self.belief)

    def explained(self, uses: Sequence[EffectUse]) -> tuple[Explanation, Array]:
        """The truth with the effects as an explanation at its true parameters, and block differences of what is no noise."""
        block = block_length(self.n, self.dt)
        count = self.n // block - 1
        mean = np.zeros(count)
        base = self.nominal()
        components = [
            replace(c, process=p) for c, p in zip(base.components, self.truth, strict=True)
        ]  # true levels in the belief's tolerances
        rolloff, regressors = None, []
        span = self.n * self.dt
        sigma = self.white / math.sqrt(block * self.dt)
        for u in uses:
            given = {k: v[self.axis if len(v) > 1 else 0] for k, v in u.values.items()}
            if u.id == "white_noise":
                k = next(i for i, c in enumerate(components) if isinstance(c.process, WN))
                n0 = components[k].process.parameters["N"]
                level = WN(math.hypot(n0, given["N"]))
                components[k] = Component(level, (Free("N", n0 / 30.0, n0 * 30.0),), u.id)
            elif u.id == "random_walk":
                components.append(component(RW(abs(given["K"])), "K", u.id))
            elif u.id == "flicker":
                components.append(component(BI(abs(given["B"])), "B", u.id))
            elif u.id in ("gauss_markov", "telegraph"):
                twice = u.id == "telegraph"
                size, beta = (given["amplitude"], 2.0 * given["rate"]) if twice else (given["sigma"], given["beta"])
                memory = Free("beta", 2.0 / span, 0.25 / self.dt)
                components.append(component(GM(abs(size), beta), "sigma", u.id, memory))
            elif u.id == "vibration_band":
                ratio = given["bandwidth"] / given["frequency"]
                shape = (Free("f", 0.01 / self.dt, 0.485 / self.dt), Free("ratio", 0.003, 0.6))
                components.append(component(Band(given["rms"], given["frequency"], ratio), "sigma", u.id, *shape))
            elif u.id == "decimation_filter":
                nyquist = 0.5 / self.dt
                free = (Free("corner", 0.03 * nyquist, 0.98 * nyquist), Free("order", 0.6, 12.0))
                rolloff = Rolloff("butterworth", (given["cutoff"], given["order"]), free, floor=DEPTH * self.white**2)
            elif u.id == "ramp":
                column = np.full((count, 1), block * self.dt)
                regressors.append(Regressors("ramp", ("R",), column, np.array([3.0 * sigma / span])))
                mean = mean + given["R"] * column[:, 0]
            elif u.id == "bias_step":
                still = Reduced("hidden", "", self.dt, np.zeros(self.n), block, mean, mean[:0], mean[:0], mean[:0])
                column = step_of_blocks(still, given["start"])
                regressors.append(Regressors("bias_step", ("value",), column, np.array([3.0 * sigma])))
                mean = mean + given["value"] * column[:, 0]
            elif u.id == "temperature":
                assert self.temperature is not None
                d = self.temperature - self.temperature.mean()
                column = block_differences(d[:, None], block)
                scale = np.array([3.0 * sigma / float(np.std(d))])
                regressors.append(Regressors("temperature", ("c1",), column, scale))
                mean = mean + given["c1"] * column[:, 0]
        return Explanation(tuple(components), rolloff, tuple(regressors)), mean

    def expected(self, truth: Explanation, mean: Array) -> Expected:
        """The expectation of the likelihood under an explanation and block differences of what is no noise."""
        block = block_length(self.n, self.dt)
        f, dof = spectrum_bins(self.n, self.dt, 0.5 / (block * self.dt))
        power = truth.psd(f, self.dt) - (truth.rolloff.floor if truth.rolloff else 0.0)
        data = Reduced("hidden", "", self.dt, np.zeros(self.n), block, mean, f, power, dof)
        return Expected(data, gamma=truth.covariance(block, self.dt, mean.size))

    def worth(self, use: EffectUse, beside: Sequence[EffectUse] = ()) -> float:
        """Nats that an effect is expected to add to the belief with the effects ``beside`` known of (their values free).

        Telegraph noise counts as what its second moments are worth; infinite for what is plain in single samples.
        """
        others = [u for u in beside if u.id in GAUSSIAN]
        if use.id == "outliers" and any(u.id == "saturation" for u in beside):
            return 0.0  # clipped away
        if use.id not in GAUSSIAN:
            return self._of_samples(use, self.explained(others)[0])
        full, mean = self.explained([*others, use])
        likelihood = self.expected(full, mean)
        with_it = _evidence(likelihood, full)
        less, _ = self.explained(others)
        if use.id == "white_noise":
            less = replace(less, components=(*self.nominal().components, *less.components[len(self.truth.processes) :]))
        without = max(_evidence(likelihood, e) for e in _starts(less))
        # the expectation of a maximum is half a nat above the maximum of the expectation for every parameter
        more = len(full.free) - len(less.free) + sum(len(r.names) for r in full.regressors if r.effect == use.id)
        rare = rules().telegraph_rarer if use.id == "telegraph" else 0.0
        if use.id == "bias_step":
            rare = paid_for_start(starts_at_rest(likelihood.data, less, float(full.regressors[-1].scales[0])))
        return with_it - without + 0.5 * more - rare

    def _of_samples(self, use: EffectUse, rest: Explanation) -> float:
        given = {k: v[self.axis if len(v) > 1 else 0] for k, v in use.values.items()}
        if use.id == "vibration_line":
            S = float(rest.psd(np.array([given["frequency"]]), self.dt)[0])
            peak = given["amplitude"] ** 2 * self.n * self.dt / (4.0 * S) + 1.0
            rho = np.geomspace(0.3, 1e6, 40)
            return log_mean_exp(peak * rho / (1.0 + rho) - np.log1p(rho)) - math.log(0.5 * self.n)
        if use.id == "outliers":
            sigma2 = float(np.mean(rest.psd(np.linspace(0.05, 0.45, 41) / self.dt, self.dt))) / self.dt
            return _outliers_worth(self.n, given["probability"], math.sqrt(1.0 + given["sigma"] ** 2 / sigma2))
        if use.id == "turn_on_bias":
            return bias_nats(given["value"], mean_spread(rest, self.white, self.n * self.dt, self.dt))
        return math.inf


def component(process: Process, amplitude: str, effect: str, *more: Free) -> Component:
    """A process with the priors of its candidate; where the amplitude's range ends does not matter, how wide it is does.

    Parameters
    ----------
    process : Process
        At its true parameters.
    amplitude : str
        Name of the parameter that is its amplitude.
    effect : str
        Catalogue id of the effect that brings it in.
    more : Free
        Other free parameters.
    """
    top = 30.0 * process.parameters[amplitude]
    return Component(process, (Free(amplitude, top / rules().amplitude_range, top), *more), effect)


def _starts(explanation: Explanation) -> list[Explanation]:
    """The explanation, and the same with slower and larger processes: what stands in for an effect that is left out."""
    out = [explanation]
    for k, c in enumerate(explanation.components):
        if isinstance(c.process, GM) and len(c.free) == 2:
            p = c.process.parameters
            for size, rate in ((2.0, 0.1), (1.5, 0.4)):
                slower = replace(c, process=GM(size * p["sigma"], rate * p["beta"]))
                out.append(
                    replace(
                        explanation, components=(*explanation.components[:k], slower, *explanation.components[k + 1 :])
                    )
                )
        elif isinstance(c.process, RW | BI) and c.effect != "nominal":
            name = c.free[0].name
            larger = replace(c, process=c.process.with_parameters({name: 3.0 * c.process.parameters[name]}))
            out.append(
                replace(explanation, components=(*explanation.components[:k], larger, *explanation.components[k + 1 :]))
            )
    return out


def _outliers_worth(n: int, share: float, ratio: float) -> float:
    """Expected gain of a mixture over a Gaussian of the best level, for samples of unit variance and a few ``ratio`` times as large."""
    x = np.concatenate([np.linspace(0.0, 8.0, 1601), np.geomspace(8.01, 10.0 * ratio + 9.0, 800)])
    narrow, wide = -0.5 * x**2, -0.5 * (x / ratio) ** 2 - math.log(ratio)
    mixed = np.logaddexp(math.log1p(-share) + narrow, math.log(share) + wide)
    density = 2.0 * np.exp(mixed) / math.sqrt(2.0 * math.pi)
    variance = 1.0 + share * (ratio**2 - 1.0)
    level = -0.5 * x**2 / variance - 0.5 * math.log(variance)
    kl = float(np.trapezoid(density * (mixed - level), x))
    count = max(share * n, 1.0)
    # share and ratio are known to about one over the root of the outliers' number, in priors of 12 and 5 nats' width in log
    paid = sum(math.log(w * math.sqrt(count / (2.0 * math.pi) * b)) for w, b in ((12.0, 1.0), (5.0, 2.0)))
    return n * kl - max(paid, 0.0) + 1.0


def sized(
    make: Callable[[float], EffectUse], worth: Callable[[EffectUse], float], target: float
) -> tuple[float, float]:
    """Strength at which an effect is worth so many nats.

    Parameters
    ----------
    make : callable
        Strength to effect.
    worth : callable
        Effect to expected nats, growing with the strength.
    target : float
        Nats.

    Returns
    -------
    strength : float
    nats : float
        What it is worth there; infinite where any strength is plain to see, less than wanted where no strength is worth that much.
    """
    s, low, high = 1.0, 1.0 / MOST_STRENGTH, MOST_STRENGTH
    for trial in range(TRIALS):
        got = worth(make(s))
        if not math.isfinite(got) or abs(got / target - 1.0) < CLOSE or high / low < 1.001 or trial == TRIALS - 1:
            break
        low, high = (s, high) if got < target else (low, s)
        # evidence grows with the square of most strengths; never leave the bracket
        guess = s * min(max(math.sqrt((target + 3.0) / max(got + 3.0, 0.5)), 0.25), 4.0)
        s = guess if low < guess < high else math.sqrt(low * high)
    return s, got
