"""Noise and what acts like it: random processes, vibration, quantization, filters, outliers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.effects import passes
from insemu.effects.base import BOTH, DEG, IN_SAMPLES, Effect, EffectUse, G, Stage
from insemu.effects.chain import Chain
from insemu.effects.hiding import DriveLot, Hidden, RestLot
from insemu.effects.parameters import EffectParameter
from insemu.errors import InputError
from insemu.noise import AR, BI, DR, GM, QN, RW, SIN, WN, Follows, Process
from insemu.noise.compiled import rational_filter, standard_normal

Array = NDArray[np.float64]
_P = EffectParameter
#: Highest order at which a Butterworth filter's coefficients still are the filter.
MOST_ORDER = 20.0

_RANDOM = "random: there is nothing that could be removed; it belongs in the noise model"
_NO_MEAN = "random: it changes the covariance of the innovations, not their mean"
_NOT_FOUND = "no candidate looks for it"


_REST = _P("rest_factor", "", 1, (1.0,), 1.0, "share of the noise that remains at standstill (0 to 1)", True, most=1.0)


class _Process(Effect):
    """An effect that is a process of the noise algebra."""

    family = "stochastic"
    sensors = BOTH
    stage = Stage.NOISE
    absent = {"compensate": _RANDOM, "signature": _NO_MEAN}

    def process_of(self, use: EffectUse, axis: int) -> Process:
        """The process of an axis."""
        raise NotImplementedError

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Add a draw of the process to every axis."""
        for axis, (row, child) in enumerate(zip(chain.rows(use.sensor), rng.spawn(3), strict=True)):
            process = self.process_of(use, axis)
            if any(v != 0.0 for name, v in process.parameters.items() if name not in ("beta", "Tc")):
                process.source(chain.work.size, chain.dt, child)(chain.work)
                row += chain.work


class WhiteNoise(_Process):
    """White noise."""

    id, name, formula = "white_noise", "white noise", "e_k ~ N(0, N^2 / dt)"
    parameters = (_P("N", "{s}/sqrt(Hz)", 3, (0.01 * DEG, 1e-4 * G), None, "root of the two-sided PSD", True),)
    excitation, in_filter = "any recording", "noise level of the mechanization"
    traits = frozenset({"fast", "noise"})
    process = WN

    def process_of(self, use: EffectUse, axis: int) -> Process:
        """The process of an axis."""
        return WN(use["N"][axis])

    def hidden(self, lot: DriveLot) -> Hidden:
        """A level well beyond the tolerance."""
        return Hidden(lot.axis, {"N": lot.on(lot.white * math.sqrt((1.0 + 0.45 * lot.loud) ** 2 - 1.0))}, lot.loud)

    def hidden_at_rest(self, lot: RestLot, strength: float) -> dict[str, Any]:
        """A level beyond the tolerance."""
        return {"N": lot.on(lot.white * math.sqrt((1.0 + 0.25 * strength) ** 2 - 1.0))}


class RandomWalk(_Process):
    """Random walk."""

    id, name, formula = "random_walk", "random walk", "e' = K w"
    parameters = (_P("K", "{s}*sqrt(Hz)", 3, (1e-4 * DEG, 1e-6 * G), None, "root of the driving PSD", True),)
    excitation, in_filter = "minutes to hours", "one state per axis"
    traits = frozenset({"slow", "process", "noise"})
    size, process = "K", RW

    def process_of(self, use: EffectUse, axis: int) -> Process:
        """The process of an axis."""
        return RW(use["K"][axis])

    def hidden(self, lot: DriveLot) -> Hidden:
        """On one axis."""
        return Hidden(lot.axis, {"K": lot.on(abs(lot.size(self, "K")))})

    def hidden_at_rest(self, lot: RestLot, strength: float) -> dict[str, Any]:
        """On one axis."""
        return {"K": lot.on(6.0 * strength * lot.slow / math.sqrt(lot.span))}


class GaussMarkov(_Process):
    """Gauss-Markov process."""

    id, name = "gauss_markov", "Gauss-Markov process (bias instability)"
    formula = "e' = -beta e + sigma sqrt(2 beta) w"
    parameters = (
        _P("sigma", "{s}", 3, (0.01 * DEG, 1e-4 * G), None, "stationary standard deviation", True),
        _P("beta", "1/s", 3, (0.01,), None, "inverse correlation time", True),
    )
    excitation, in_filter = "several correlation times", "one state per axis"
    traits = frozenset({"slow", "process", "noise"})
    size, process = "sigma", GM

    def process_of(self, use: EffectUse, axis: int) -> Process:
        """The process of an axis."""
        return GM(use["sigma"][axis], use["beta"][axis])

    def hidden(self, lot: DriveLot) -> Hidden:
        """On one axis, correlation times from 20 s to a third of the recording."""
        beta = 1.0 / math.exp(lot.rng.uniform(math.log(20.0), math.log(0.3 * lot.span)))
        return Hidden(lot.axis, {"sigma": lot.on(abs(lot.size(self, "sigma"))), "beta": (beta,) * 3})

    def hidden_at_rest(self, lot: RestLot, strength: float) -> dict[str, Any]:
        """On one axis."""
        return {"sigma": lot.on(8.0 * strength * lot.slow), "beta": 1.0 / lot.memory}


class SharedProcess(_Process):
    """Gauss-Markov process that the axes of a sensor share."""

    id, name = "shared_process", "process that axes share (common drift)"
    formula = "e_a = sigma_a x, x' = -beta x + sqrt(2 beta) w, one x for all axes"
    parameters = (
        _P("sigma", "{s}", 3, (0.01 * DEG, 1e-4 * G), None, "level at which each axis sees it, with its sign"),
        _P("beta", "1/s", 1, (0.01,), None, "inverse correlation time", True),
    )
    excitation, in_filter = "several correlation times at rest", "one state that several axes see"
    traits = frozenset({"slow", "noise"})
    process = GM
    absent = {
        "compensate": _RANDOM,
        "signature": _NO_MEAN,
        "trial": "a recording of the trial hides what one axis shows; tests/together_experiments.py hides this one",
    }

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Add one draw to every axis at its level."""
        GM(1.0, use.scalar("beta")).source(chain.work.size, chain.dt, rng)(chain.work)
        for row, level in zip(chain.rows(use.sensor), use["sigma"], strict=True):
            row += level * chain.work


class Quantization(Effect):
    """Quantization of the output."""

    id, name, family, sensors = "quantization", "quantization", "stochastic", BOTH
    formula = "y = LSB round(s / LSB); error variance LSB^2 / 12"
    parameters = (
        _P("lsb", "{s}", 3, (0.05 * DEG, 3e-3 * G), None, "least significant bit of the output", True, join="larger"),
    )
    excitation = "any recording; steps are visible at rest"
    in_filter = "white noise of variance LSB^2 / 12 where the noise exceeds the LSB"
    traits = frozenset({"fast"})
    stage, process = Stage.ROUND, QN
    absent = {"compensate": "what was rounded off is lost", "signature": IN_SAMPLES}

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Round every axis that has an LSB."""
        for row, lsb in zip(chain.rows(use.sensor), use["lsb"], strict=True):
            if lsb > 0:
                row /= lsb
                np.rint(row, out=row)
                row *= lsb

    def hidden(self, lot: DriveLot) -> Hidden:
        """An LSB of half to two standard deviations of a sample."""
        return Hidden(lot.axis, {"lsb": lot.on(0.5 * lot.loud * lot.sample)}, lot.loud)

    def hidden_at_rest(self, lot: RestLot, strength: float) -> dict[str, Any]:
        """On one axis."""
        return {"lsb": lot.on(0.3 * strength * lot.sample)}


class Flicker(_Process):
    """Flicker noise."""

    id, name = "flicker", "flicker noise (1/f)"
    formula = "two-sided PSD B^2 / (2 pi |f|); Allan floor B sqrt(2 ln 2 / pi)"
    parameters = (_P("B", "{s}", 3, (0.005 * DEG, 5e-5 * G), None, "bias instability coefficient", True),)
    excitation, in_filter = "minutes to hours", "a few Gauss-Markov states with a stated error"
    traits = frozenset({"slow", "process", "noise"})
    size, process = "B", BI

    def process_of(self, use: EffectUse, axis: int) -> Process:
        """The process of an axis."""
        return BI(use["B"][axis])

    def hidden(self, lot: DriveLot) -> Hidden:
        """On one axis."""
        return Hidden(lot.axis, {"B": lot.on(abs(lot.size(self, "B")))})

    def hidden_at_rest(self, lot: RestLot, strength: float) -> dict[str, Any]:
        """On one axis."""
        return {"B": lot.on(6.0 * strength * lot.slow)}


class Ramp(_Process):
    """Drift at a constant rate."""

    id, name, formula = "ramp", "ramp (drift)", "e(t) = R (t - t_0)"
    parameters = (_P("R", "{s}/s", 3, (1e-5 * DEG, 1e-7 * G), None, "slope", join="sum"),)
    excitation, in_filter = "tens of minutes", "a constant-slope state pair per axis"
    traits = frozenset({"slow", "shape"})
    stage, size, process = Stage.LAW, "R", DR
    absent = {"signature": "the slow errors of an axis, linear between knots, hold it: a slope of the knots"}

    def process_of(self, use: EffectUse, axis: int) -> Process:
        """The process of an axis."""
        return DR(use["R"][axis])

    def added(self, use: EffectUse, t: Array, temperature: Array | None) -> Array:
        """A straight line; the emulator's first sample has moved by one interval."""
        return np.asarray((t - 2 * t[0] + t[1])[:, None] * np.array(use["R"]))

    def hidden(self, lot: DriveLot) -> Hidden:
        """On one axis."""
        return Hidden(lot.axis, {"R": lot.on(lot.size(self, "R"))})

    def hidden_at_rest(self, lot: RestLot, strength: float) -> dict[str, Any]:
        """On one axis."""
        return {"R": lot.on(12.0 * strength * lot.sign * lot.slow / lot.span)}


class VibrationLine(Effect):
    """Vibration at one frequency."""

    id, name, family, sensors = "vibration_line", "vibration line", "stochastic", BOTH
    formula = "e(t) = p(v) A sin(2 pi f t + phase), p from rest_factor to 1 with speed"
    parameters = (
        _P("amplitude", "{s}", 3, (0.2 * DEG, 0.02 * G), None, "amplitude", True),
        _P("frequency", "Hz", 1, (20.0,), None, "frequency", True),
        _P("phase", "rad", 1, (1.0,), 0.0, "phase at the start of the record"),
        _REST,
    )
    excitation = "rate above twice the frequency, else an alias"
    in_filter = "white noise of the same power, or a filter in front"
    traits = frozenset({"fast", "drawn"})
    stage, process = Stage.NOISE, SIN
    absent = {"compensate": "its phase wanders, so that no table says it beforehand", "signature": IN_SAMPLES}

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Add the sine."""
        wave, profile = chain.work, chain.motion_profile(use)
        passes.half_angle(chain.t, use.scalar("frequency"), use.scalar("phase"), wave)
        np.tan(wave, out=wave)
        passes.sines(wave)
        chain.add_shaped(use, "amplitude", profile)

    def hidden(self, lot: DriveLot) -> Hidden:
        """In the upper half of the band."""
        amplitude = lot.on(12.0 * lot.loud * lot.white / math.sqrt(lot.span))
        return Hidden(
            lot.axis, {"amplitude": amplitude, "frequency": float(lot.rng.uniform(0.4, 0.9) * lot.nyquist)}, lot.loud
        )

    def hidden_at_rest(self, lot: RestLot, strength: float) -> dict[str, Any]:
        """On one axis."""
        return {"amplitude": lot.on(7.0 * strength * lot.slow), "frequency": lot.frequency}


def band_coefficients(frequency: float, bandwidth: float, dt: float) -> tuple[float, float, float]:
    """Resonance of unit variance for unit white noise.

    Parameters
    ----------
    frequency, bandwidth : float
        Centre and full width at half power, Hz.
    dt : float
        s.

    Returns
    -------
    ``(a1, a2, gain)`` of ``y_k = a1 y_(k-1) + a2 y_(k-2) + gain w_k``
    """
    if not 0 < frequency < 0.5 / dt:
        raise InputError(f"a vibration band at {frequency:g} Hz is not below half of the rate, {0.5 / dt:g} Hz")
    r = np.exp(-np.pi * bandwidth * dt)
    a1, a2 = 2.0 * r * np.cos(2.0 * np.pi * frequency * dt), -r * r
    variance = (1.0 - a2) / ((1.0 + a2) * ((1.0 - a2) ** 2 - a1 * a1))
    return float(a1), float(a2), float(1.0 / np.sqrt(variance))


class VibrationBand(Effect):
    """Vibration in a band."""

    id, name, family, sensors = "vibration_band", "coloured vibration", "stochastic", BOTH
    formula = "p(v) times white noise through a two-pole resonance"
    parameters = (
        _P("rms", "{s}", 3, (0.2 * DEG, 0.02 * G), None, "standard deviation in motion", True),
        _P("frequency", "Hz", 1, (20.0,), None, "centre of the band", True),
        _P("bandwidth", "Hz", 1, (5.0,), None, "width of the band (full width at half power)", True),
        _REST,
    )
    excitation, in_filter = "motion", "white noise of the same low-frequency power"
    traits = frozenset({"fast"})
    stage, process = Stage.NOISE, AR
    absent = {"compensate": _RANDOM, "signature": IN_SAMPLES}

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Add a resonance driven by white noise, drawn anew for every axis."""
        a1, a2, gain = band_coefficients(use.scalar("frequency"), use.scalar("bandwidth"), chain.dt)
        b, a = np.array([gain, 0.0, 0.0]), np.array([1.0, -a1, -a2])
        # until the start is forgotten to 1e-8
        settle = np.empty(min(int(np.ceil(20.0 / max(1e-9, 1.0 - np.sqrt(-a2)))), 1_000_000))

        def draw() -> None:
            memory = np.zeros(2)
            for part in (settle, chain.work):
                standard_normal(part, rng)
                rational_filter(part, b, a, memory)

        chain.add_shaped(use, "rms", chain.motion_profile(use), draw)

    def hidden(self, lot: DriveLot) -> Hidden:
        """Above half of the band."""
        frequency = float(lot.rng.uniform(0.5, 0.8) * lot.nyquist)
        rms = lot.on(0.25 * lot.loud * lot.sample)
        return Hidden(lot.axis, {"rms": rms, "frequency": frequency, "bandwidth": float(0.04 * lot.nyquist)}, lot.loud)

    def hidden_at_rest(self, lot: RestLot, strength: float) -> dict[str, Any]:
        """On one axis."""
        return {"rms": lot.on(0.1 * strength * lot.sample), "frequency": lot.frequency, "bandwidth": lot.bandwidth}


class DecimationFilter(Effect):
    """Low-pass of the sensor."""

    id, name, family, sensors = "decimation_filter", "bandwidth and decimation filter", "stochastic", BOTH
    formula = "y = h * s: moving average over `taps` samples, or Butterworth low-pass of `order` at `cutoff`; delay (taps - 1) dt / 2"
    parameters = (
        _P("cutoff", "Hz", 1, (30.0,), 0.0, "-3 dB frequency; zero: moving average instead", True),
        _P("order", "", 1, (2.0,), 2.0, "order of the low-pass", True, most=MOST_ORDER),
        _P("taps", "", 1, (4.0,), 1.0, "length of the moving average in samples", True),
    )
    excitation = "any recording (colour of the noise); fast motion (delay)"
    in_filter = "coloured noise; the delay as a time offset"
    traits = frozenset({"fast"})
    stage = Stage.FILTER
    absent = {"compensate": "what a low-pass took away is below the noise", "signature": IN_SAMPLES}

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Filter the rows; the filter starts in equilibrium with the first sample."""
        from scipy.signal import butter, lfilter_zi

        cutoff = use.scalar("cutoff")
        if cutoff > 0:
            if cutoff >= 0.5 / chain.dt:
                raise InputError(
                    f"effect 'decimation_filter': a cutoff of {cutoff:g} Hz is not below half of the rate, {0.5 / chain.dt:g} Hz"
                )
            b, a = butter(max(1, round(use.scalar("order"))), cutoff * 2.0 * chain.dt)
        else:
            taps = round(use.scalar("taps"))
            if not 1 <= taps <= chain.t.size:
                raise InputError(
                    f"effect 'decimation_filter': {taps} taps, expected a cutoff, or 1 to {chain.t.size} taps for as many samples"
                )
            b = np.full(taps, 1.0 / taps)
            a = np.eye(1, taps)[0]
        if len(b) == 1:
            return
        state = lfilter_zi(b, a)
        for row in chain.rows(use.sensor):
            rational_filter(row, b, a, state * row[0])

    def hidden(self, lot: DriveLot) -> Hidden:
        """A Butterworth of second order on every axis of the sensor."""
        return Hidden((), {"cutoff": float(0.8 * lot.nyquist / (1.0 + 0.2 * lot.loud)), "order": 2.0}, lot.loud)

    def hidden_at_rest(self, lot: RestLot, strength: float) -> dict[str, Any]:
        """Closer to the middle of the band with strength."""
        return {"cutoff": 0.45 / lot.dt / (1.0 + 0.1 * strength), "order": lot.order}


class Outliers(Effect):
    """Outliers of single samples."""

    id, name, family, sensors = "outliers", "outliers (heavy tails)", "stochastic", BOTH
    formula = "with probability p: e_k ~ N(0, sigma^2), else 0"
    parameters = (
        _P("probability", "", 1, (0.001,), None, "share of samples", True, most=1.0),
        _P("sigma", "{s}", 3, (1.0 * DEG, 0.05 * G), None, "standard deviation of an outlier", True),
    )
    excitation, in_filter = "any recording", "robust update, or a check on the samples"
    traits = frozenset({"samples", "drawn"})
    stage = Stage.NOISE
    absent = {"compensate": "which samples they are is known only once they are found", "signature": IN_SAMPLES}

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Add normal numbers at a share of the samples."""
        for row, sigma, child in zip(chain.rows(use.sensor), use["sigma"], rng.spawn(3), strict=True):
            passes.add_outliers(row, use.scalar("probability"), sigma, child)

    def hidden(self, lot: DriveLot) -> Hidden:
        """One sample in a thousand."""
        return Hidden(lot.axis, {"probability": 1e-3, "sigma": lot.on(5.0 * lot.loud * lot.sample)}, lot.loud)

    def hidden_at_rest(self, lot: RestLot, strength: float) -> dict[str, Any]:
        """One sample in two thousand."""
        return {"probability": 5e-4, "sigma": lot.on(2.5 * strength * lot.sample)}


class Telegraph(Effect):
    """Random telegraph noise."""

    id, name, family, sensors = "telegraph", "telegraph noise (popcorn)", "stochastic", BOTH
    formula = "e = +-amplitude, switching at Poisson times of mean rate `rate`"
    parameters = (
        _P("amplitude", "{s}", 3, (0.01 * DEG, 2e-4 * G), None, "half of the distance between the levels", True),
        _P("rate", "1/s", 1, (0.02,), None, "switches per second", True),
    )
    excitation = "many switches at rest"
    in_filter = "a Gauss-Markov state with beta = 2 rate and the same variance"
    traits = frozenset({"slow", "samples", "drawn"})
    stage = Stage.NOISE
    absent = {"compensate": "when it switches is known only once it is found", "signature": _NO_MEAN}

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Switch where an odd number of Poisson events lies between two samples."""
        switch = 0.5 * (1.0 - np.exp(-2.0 * use.scalar("rate") * chain.dt))
        for row, amplitude, child in zip(chain.rows(use.sensor), use["amplitude"], rng.spawn(3), strict=True):
            passes.add_telegraph(row, switch, amplitude, child)

    def hidden_at_rest(self, lot: RestLot, strength: float) -> dict[str, Any]:
        """On one axis."""
        return {"amplitude": lot.on(9.0 * strength * lot.slow), "rate": lot.switching}


class _FollowingNoise(Effect):
    """White noise whose level follows a covariate by a law of the noise algebra."""

    family, sensors, stage = "stochastic", BOTH, Stage.NOISE

    def law(self, use: EffectUse) -> Follows:
        """How the level that is given follows."""
        raise NotImplementedError

    def covariate(self, chain: Chain, use: EffectUse) -> Array:
        """What it follows (n,)."""
        raise NotImplementedError

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Add white noise at the level of every sample."""
        np.divide(self.law(use).gain(self.covariate(chain, use)), np.sqrt(chain.dt), out=chain.profile)
        chain.add_shaped(use, "N", chain.profile, lambda: standard_normal(chain.work, rng))


class MotionNoise(_FollowingNoise):
    """Noise that grows with speed."""

    id, name = "motion_noise", "noise that grows with motion"
    formula = "e_k ~ N(0, (N v / v_0)^2 / dt), v speed, v_0 = 10 m/s"
    parameters = (_P("N", "{s}/sqrt(Hz)", 3, (0.05 * DEG, 5e-4 * G), None, "density at 10 m/s", True),)
    excitation, in_filter = "changing speed", "noise level scheduled with speed"
    absent = {
        "compensate": _RANDOM, "signature": _NO_MEAN, "candidate": "the map of a drive shows it against speed; no candidate names it yet",
        "refine": _NOT_FOUND, "trial": _NOT_FOUND,
    }  # fmt: skip

    def law(self, use: EffectUse) -> Follows:
        """In proportion to the speed."""
        return Follows("speed", 1.0, 10.0, "power")

    def covariate(self, chain: Chain, use: EffectUse) -> Array:
        """The true speed, m/s."""
        return chain.speed(use)


class TemperatureNoise(_FollowingNoise):
    """Noise that grows with temperature."""

    id, name = "temperature_noise", "noise that grows with temperature"
    formula = "e_k ~ N(0, (N max(0, T - T_0))^2 / dt)"
    parameters = (
        _P("N", "{s}/sqrt(Hz)", 3, (0.001 * DEG, 1e-5 * G), None, "density per kelvin", True),
        _P("T0", "degC", 1, (25.0,), 25.0, "temperature where it starts"),
    )
    excitation, in_filter = "a temperature sweep", "noise level scheduled with temperature"
    needs_temperature = True
    absent = {
        "compensate": _RANDOM, "signature": _NO_MEAN, "candidate": "no candidate schedules a level with temperature yet",
        "refine": _NOT_FOUND, "trial": _NOT_FOUND,
    }  # fmt: skip

    def law(self, use: EffectUse) -> Follows:
        """In proportion to the temperature above the threshold, the given level at one kelvin above it."""
        start = use.scalar("T0")
        return Follows("temperature", 1.0, start + 1.0, "power", above=start)

    def covariate(self, chain: Chain, use: EffectUse) -> Array:
        """The temperature, degC."""
        return chain.need_temperature(use)


EFFECTS: tuple[Effect, ...] = (
    WhiteNoise(), RandomWalk(), GaussMarkov(), SharedProcess(), Quantization(), Flicker(), Ramp(), VibrationLine(), VibrationBand(),
    DecimationFilter(), Outliers(), Telegraph(), MotionNoise(), TemperatureNoise(),
)  # fmt: skip
