"""A fit handed on to another program: what is determined of it, in numbers whose use there gives the fitted Allan deviation, or not at all."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu import noise, yamlfile
from insemu.errors import InputError, nearest
from insemu.formats.programs import ENDLESS, PROGRAMS, Triad, reduce_models, spelled
from insemu.noise import GM, RW, WN, NoiseModel, process_label

Array = NDArray[np.float64]

#: Largest share by which an exported Allan deviation is off the fitted one, outside the interval of that.
CLOSE = 0.1
#: Shortest averaging time at which curves are held against each other, s, and the share of the record that is the longest.
FROM_S, SHARE = 1.0, 1.0 / 3.0
#: Range of times below which numbers are of no use to a filter, s: it is about what passes between two corrections of its biases.
LEAST_REACH_S = 10.0
#: Averaging times for each doubling.
_PER_OCTAVE = 3
#: Programs whose slow part is a Gauss-Markov process; that of others is a random walk.
_MARKOV = ("gazebo", "rotors", "px4", "kf-gins", "gnss-ins-sim")


def _none() -> Array:
    return np.zeros(0)


@dataclass(frozen=True)
class Fitted:
    """The model of one axis and what its fit says of it.

    Parameters
    ----------
    model : NoiseModel
    weak : tuple of int
        Places of the processes that are not determined.
    rate_hz, seconds : float, optional
        Sampling rate and length of the log.
    tau, low, high : (k,) arrays
        Averaging times (s) and the interval of the fitted Allan deviation there; empty where it is not known.
    """

    model: NoiseModel
    weak: tuple[int, ...] = ()
    rate_hz: float | None = None
    seconds: float | None = None
    tau: Array = field(default_factory=_none)
    low: Array = field(default_factory=_none)
    high: Array = field(default_factory=_none)


def read_fitted(path: str | Path) -> dict[str, Fitted]:
    """Models of a file with what their fits say.

    Raises
    ------
    InputError
        As :func:`insemu.noise.load`.
    """
    models = noise.load(path)
    axes = yamlfile.read(path).data.get("axes", {})
    return {axis: _fitted(model, (axes.get(axis) or {}).get("fit") or {}) for axis, model in models.items()}


def _fitted(model: NoiseModel, said: Mapping[str, Any]) -> Fitted:
    unsure = set(said.get("not_determined") or ())
    parts = enumerate(model.indexed())
    # white noise that another part cannot be distinguished from stays: its density is then that of the curve
    weak = tuple(k for k, (i, p) in parts if process_label(p.symbol, i) in unsure and p.symbol != "WN")
    rate, count, curve = said.get("rate_hz"), said.get("n_samples"), said.get("allan_deviation") or {}
    return Fitted(
        model,
        weak,
        rate,
        count / rate if rate and count else None,
        *(np.array(curve.get(k, ()), dtype=np.float64) for k in ("tau_s", "low", "high")),
    )


@dataclass(frozen=True)
class _Wanted:
    """What one sensor's numbers have to give: Allan variance at averaging times (s), and between what it may lie."""

    tau: Array
    value: Array
    low: Array
    high: Array
    dt: float

    def upto(self, longest: float) -> _Wanted:
        keep = self.tau <= longest * (1.0 + 1e-9)
        return replace(self, **{k: getattr(self, k)[keep] for k in ("tau", "value", "low", "high")})

    def of(self, model: NoiseModel) -> Array:
        return model.allan_variance(np.round(self.tau / self.dt), self.dt)

    def holds(self, model: NoiseModel) -> bool:
        there = self.of(model)
        return bool(((there >= self.low) & (there <= self.high)).all())


def hand_on(
    fits: Mapping[str, Fitted], program: str, *, rate_hz: float | None = None, record_s: float | None = None
) -> tuple[str, list[str]]:
    """Write fitted models in the words of another program, where its use of them gives the fitted Allan deviation.

    Parts that are not determined are left out. The numbers are those of :func:`~insemu.formats.programs.reduce_models`, or the nearest in
    least squares of the logarithm of the Allan variance; the axes of a sensor are one there, and their mean variance is meant.

    Parameters
    ----------
    fits : mapping of axis to Fitted
    program : str
        Key of :data:`~insemu.formats.programs.PROGRAMS`.
    rate_hz, record_s : float, optional
        Rate of the sensor there and length of the log; those of the fits where they are not given, else 100 Hz and 1 h.

    Returns
    -------
    str, list of str
        The text, and what has to be known.

    Raises
    ------
    InputError
        An unknown program; nothing that is determined; numbers that are more than 10 % off outside the interval of the fit between 1 s and a
        third of the log; models without a log are held as far as it goes, for at least 10 s, and that is said.
    """
    if program not in PROGRAMS:
        raise InputError(f"unknown program '{program}'" + nearest(program, PROGRAMS))
    notes: list[str] = []
    rates = [f.rate_hz for f in fits.values() if f.rate_hz]
    lengths = [f.seconds for f in fits.values() if f.seconds]
    if rate_hz is None:
        rate_hz = min(rates, default=100.0)
        notes += [] if rates else ["no rate is stated with the models: 100 Hz is assumed"]
    stated = record_s is not None or bool(lengths)  # models of a datasheet have no log: they are held as far as it goes
    record_s = record_s if record_s is not None else min(lengths, default=3600.0)
    kept: dict[str, NoiseModel] = {}
    for axis, f in fits.items():
        parts = tuple(p for k, p in enumerate(f.model) if k not in f.weak)
        labels = [process_label(p.symbol, i) for k, (i, p) in enumerate(f.model.indexed()) if k in f.weak]
        if not parts:
            raise InputError(
                f"{axis}: nothing is determined ({', '.join(labels)}: standard errors of several times the values)"
            )
        if labels:
            notes.append(
                f"{axis}: {', '.join(labels)} left out, not determined (standard error of several times the value)"
            )
        kept[axis] = NoiseModel(parts)
    triads, said = reduce_models(kept, rate_hz, record_s)
    out: dict[str, Triad] = {}
    for sensor, triad in triads.items():
        wanted = _wanted([f for axis, f in fits.items() if axis.startswith(sensor)], rate_hz, record_s)
        shared = out["gyro"].time if program == "kf-gins" and "gyro" in out else None
        found = _nearest(triad, wanted, program, shared)
        if found is None and not stated:
            longest, found = _reach(triad, wanted, program, shared)
            notes.append(f"{sensor}: the numbers give the Allan deviation of the model from 1 to {longest:.3g} s only")
        if found is None:
            raise InputError(_refusal(sensor, triad, wanted, program, shared))
        out[sensor] = found
    return spelled(program, out, rate_hz), [*said, *notes]


def _wanted(fits: Sequence[Fitted], rate_hz: float, record_s: float) -> _Wanted:
    """The mean Allan variance of the axes with what it may be."""
    dt = 1.0 / (fits[0].rate_hz or rate_hz)
    last = max(SHARE * record_s, FROM_S)
    tau = np.geomspace(FROM_S, last, 1 + math.ceil(_PER_OCTAVE * math.log2(last / FROM_S)))
    tau = np.unique(np.maximum(np.round(tau / dt), 1.0)) * dt
    tau = tau[tau <= last * (1.0 + 1e-9)] if (tau <= last).any() else tau[:1]
    value, low, high = np.zeros((3, tau.size))
    for f in fits:
        one = f.model.allan_variance(np.round(tau / dt), dt)
        value += one
        for total, ends, outer in ((low, f.low, np.minimum), (high, f.high, np.maximum)):
            close = one * (1.0 + (CLOSE if outer is np.maximum else -CLOSE)) ** 2
            total += (
                outer(close, np.exp(np.interp(np.log(tau), np.log(f.tau), 2.0 * np.log(ends)))) if f.tau.size else close
            )
    return _Wanted(tau, value / len(fits), low / len(fits), high / len(fits), dt)


def _there(triad: Triad, program: str, shared: float | None) -> NoiseModel:
    """What a program makes of the numbers of a sensor, by its own formula."""
    white = WN(N=triad.white)
    if program not in _MARKOV:
        return white + RW(K=triad.walk)
    time = shared or triad.time
    return white + GM(sigma=triad.walk * math.sqrt(time / 2.0), beta=1.0 / time)


def _nearest(triad: Triad, wanted: _Wanted, program: str, shared: float | None) -> Triad | None:
    """The numbers as they were reduced, or the nearest that hold; None where none do."""
    if wanted.holds(_there(triad, program, shared)):
        return triad
    free = program in _MARKOV and shared is None
    white = math.sqrt(wanted.value[0] * wanted.tau[0])
    walk = math.sqrt(3.0 * wanted.value[-1] / wanted.tau[-1])
    for time in (triad.time, *(wanted.tau[-1] * f for f in (0.03, 0.3, 3.0))) if free else (triad.time,):
        begin = np.log([white, walk, time][: 3 if free else 2])

        def made(x: Array, time: float = time) -> Triad:
            n, k, t = (*np.exp(x), time)[:3]
            t = min(max(t, 10.0 * wanted.dt), ENDLESS)
            return replace(triad, white=n, walk=k, time=t, sigma=k * math.sqrt(t / 2.0))

        found = made(
            scipy.optimize.least_squares(
                lambda x: np.log(wanted.of(_there(made(x), program, shared)) / wanted.value), begin, max_nfev=200
            ).x
        )
        if wanted.holds(_there(found, program, shared)):
            return found
    return None


def _reach(triad: Triad, wanted: _Wanted, program: str, shared: float | None) -> tuple[float, Triad | None]:
    """The longest time up to which there are numbers that hold, s, and those."""
    for longest in wanted.tau[wanted.tau >= LEAST_REACH_S][::-1]:
        found = _nearest(triad, wanted.upto(longest), program, shared)
        if found is not None:
            return float(longest), found
    return 0.0, None


def _refusal(sensor: str, triad: Triad, wanted: _Wanted, program: str, shared: float | None) -> str:
    """Why nothing is written, and over which times it could be."""
    off = np.sqrt(wanted.of(_there(triad, program, shared)) / wanted.value)
    k = int(np.argmax(np.abs(np.log(off))))
    knows = "a Gauss-Markov process" if program in _MARKOV else "a random walk"
    text = (
        f"{sensor}: {program} knows white noise and {knows}, whose Allan deviation is {off[k]:.3g} times the fitted one at {wanted.tau[k]:.3g} s; "
        f"expected within {100 * CLOSE:g} % or the interval of the fit from {wanted.tau[0]:.3g} to {wanted.tau[-1]:.4g} s"
    )
    longest, found = _reach(triad, wanted, program, shared)
    if found is not None:
        return f"{text}; up to {longest:.3g} s it holds: --log-length '{math.ceil(longest / SHARE)} s'"
    return text
