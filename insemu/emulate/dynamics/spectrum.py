"""How a vehicle's body moves about its path: cross-spectra of the six axes by regime, and lines that follow speed or a stated rate.

Axes are those of :data:`insemu.records.AXES`: angular rate (rad/s), then specific force (m/s^2), both as a perfect IMU at the vehicle's
reference point feels them, so a tilt shows gravity in the horizontal axes. Densities are one-sided, per Hz. The cross density of axes i and j is
``E[X_i conj(X_j)]`` with numpy's sign of the Fourier transform (``scipy.signal.csd(x_j, x_i)``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.emulate.dynamics.levels import Levels
from insemu.errors import InputError
from insemu.records import AXES

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: How far outside of a regime's ranges its weight is down to exp(-1/2): m/s and share of the speed, rad/s, m/s.
SOFT_SPEED, SOFT_SPEED_SHARE, SOFT_TURN, SOFT_CLIMB = 0.3, 0.05, 0.03, 0.3
#: Most negative eigenvalue of a coherence matrix that is taken for rounding.
_ROUNDING = -0.02


@dataclass(frozen=True)
class Regime:
    """One way of moving, and what the body does meanwhile.

    Parameters
    ----------
    name : str
    density : (m, 6) array
        One-sided, (rad/s)^2/Hz and (m/s^2)^2/Hz, at the frequencies of the spectrum.
    coherence : (m, 6, 6) complex array
        Cross densities over the roots of the two densities; Hermitian with a diagonal of ones.
    speed, turn, climb : (low, high)
        Where the path is in this regime: horizontal speed m/s, magnitude of the turn rate rad/s, rate of climb m/s.
    swing_sigma, swing_time : float
        The logarithm of the amplitude (all axes alike) is itself a slow process: standard deviation in nepers, and s.
        The densities are means over it.
    density_sigma : (m, 6) array, optional
        Standard deviations of the densities as shares of them; None where nobody says.
    """

    name: str
    density: Array
    coherence: Complex
    speed: tuple[float, float] = (0.0, np.inf)
    turn: tuple[float, float] = (0.0, np.inf)
    climb: tuple[float, float] = (-np.inf, np.inf)
    swing_sigma: float = 0.0
    swing_time: float = 5.0
    density_sigma: Array | None = None

    def __post_init__(self) -> None:
        m = len(self.density)
        for what, value, shape in (
            ("density", self.density, (m, 6)),
            ("coherence", self.coherence, (m, 6, 6)),
            ("density_sigma", self.density if self.density_sigma is None else self.density_sigma, (m, 6)),
        ):
            if np.shape(value) != shape:
                raise InputError(f"regime '{self.name}': {what} has shape {np.shape(value)}, expected {shape}")
            if not np.isfinite(value).all():
                raise InputError(f"regime '{self.name}': {what} has a value that is not finite")
        if (self.density < 0).any():
            raise InputError(f"regime '{self.name}': a density is negative")
        c = self.coherence
        if np.abs(c - np.conj(np.swapaxes(c, 1, 2))).max(initial=0.0) > 1e-9:
            raise InputError(f"regime '{self.name}': the coherence is not Hermitian")
        least = float(np.linalg.eigvalsh(c).min(initial=0.0))
        if least < _ROUNDING:
            raise InputError(
                f"regime '{self.name}': no signals have these coherences (an eigenvalue is {least:.3g}), expected a positive semidefinite matrix"
            )
        for what in ("speed", "turn", "climb"):
            low, high = getattr(self, what)
            if not low <= high:
                raise InputError(f"regime '{self.name}': {what} from {low:g} to {high:g}, expected a range")
        if not (self.swing_sigma >= 0.0 and self.swing_time > 0.0):
            raise InputError(
                f"regime '{self.name}': swing of {self.swing_sigma} within {self.swing_time} s, expected zero or more and a positive time"
            )

    def farness(self, speed: Array, turn: Array, climb: Array) -> Array:
        """Half the squared distance (n,) of motions from the regime's ranges, in units of the soft edges.

        Parameters
        ----------
        speed, turn, climb : (n,) arrays
            m/s, rad/s, m/s.
        """
        out = np.zeros(np.shape(speed))
        for (low, high), x, soft in (
            (self.speed, speed, SOFT_SPEED + SOFT_SPEED_SHARE * np.asarray(speed)),
            (self.turn, np.abs(turn), SOFT_TURN),
            (self.climb, climb, SOFT_CLIMB),
        ):
            out += 0.5 * (np.maximum(np.maximum(low - x, x - high), 0.0) / soft) ** 2
        return out


@dataclass(frozen=True)
class Line:
    """A periodic part: an order of a shaft, a wheel, a rotor, a step.

    Parameters
    ----------
    name : str
    order : float
        Periods in a revolution.
    rate : float or None
        Revolutions per second, where they do not follow the speed.
    per_metre : float or None
        Revolutions per metre of way; exactly one of the two is given.
    amplitude : mapping of regime's name to (6,) tuple
        rad/s and m/s^2; regimes that are not named have none. ``"*"`` stands for all others.
    phase : (6,) tuple
        rad; the axis is ``amplitude cos(revolutions 2 pi order + phase)``.
    wander_sigma, wander_time : float
        The rate is off by a slow process: standard deviation as a share of it, and s.
    """

    name: str
    order: float
    amplitude: Mapping[str, tuple[float, ...]]
    phase: tuple[float, ...] = (0.0,) * 6
    rate: float | None = None
    per_metre: float | None = None
    wander_sigma: float = 0.0
    wander_time: float = 10.0

    def __post_init__(self) -> None:
        given = [x for x in (self.rate, self.per_metre) if x is not None]
        if len(given) != 1 or not (given[0] > 0 and self.order > 0):
            raise InputError(
                f"line '{self.name}': expected a positive order and one positive number, 'rate' (Hz) or 'per_metre'"
            )
        for what, values in (*self.amplitude.items(), ("phase", self.phase)):
            if len(values) != 6 or not np.isfinite(values).all():
                raise InputError(f"line '{self.name}': {what} is {values}, expected six numbers ({', '.join(AXES)})")
        if not (self.wander_sigma >= 0.0 and self.wander_time > 0.0):
            raise InputError(
                f"line '{self.name}': wander of {self.wander_sigma} within {self.wander_time} s, expected zero or more and a positive time"
            )


@dataclass(frozen=True)
class MotionSpectrum:
    """Spectra by regime, and lines.

    Parameters
    ----------
    frequencies : (m,) array
        Hz, increasing, two at least; there is no motion below the first and above the last, and densities between are straight in logarithms.
    regimes : tuple of Regime
        One at least.
    lines : tuple of Line
    unknown : tuple of str
        What could not be determined, in words.
    levels : Levels, optional
        How loud bands and axes are from moment to moment. Densities then say the shape inside of the bands, and there is nothing outside of them.
    """

    frequencies: Array
    regimes: tuple[Regime, ...]
    lines: tuple[Line, ...] = ()
    unknown: tuple[str, ...] = field(default=())
    levels: Levels | None = None

    def __post_init__(self) -> None:
        f = np.asarray(self.frequencies, dtype=float)
        object.__setattr__(self, "frequencies", f)
        if f.ndim != 1 or f.size < 2 or not (np.isfinite(f).all() and f[0] > 0.0 and (np.diff(f) > 0.0).all()):
            raise InputError("frequencies of a spectrum of motion: expected two or more positive numbers that increase")
        if not self.regimes:
            raise InputError("a spectrum of motion has no regimes, expected one at least")
        names = [r.name for r in self.regimes]
        for r in self.regimes:
            if len(r.density) != f.size:
                raise InputError(
                    f"regime '{r.name}' has {len(r.density)} rows, expected one for each of the {f.size} frequencies"
                )
            if self.levels is not None and r.swing_sigma:
                raise InputError(f"regime '{r.name}' swings, expected none where levels say how loud it is")
            if names.count(r.name) > 1:
                raise InputError(f"regime '{r.name}' stands there twice")
        for line in self.lines:
            for name in line.amplitude:
                if name != "*" and name not in names:
                    raise InputError(
                        f"line '{line.name}' has an amplitude in the regime '{name}', expected one of {', '.join(names)}"
                    )

    @property
    def highest(self) -> float:
        """Highest frequency of spectra and of lines with a stated rate, Hz."""
        return max(float(self.frequencies[-1]), *(x.order * x.rate for x in self.lines if x.rate is not None), 0.0)

    def rms(self, regime: int, low: float, high: float) -> Array:
        """Root mean square (6,) of a regime, its lines at the middle of its speeds among it.

        Parameters
        ----------
        regime : int
        low, high : float
            Hz.
        """
        f = np.linspace(max(low, self.frequencies[0]), min(high, self.frequencies[-1]), 400)
        factor = self.factors(regime, f)
        power = np.trapezoid((np.abs(factor) ** 2).sum(axis=2), f, axis=0)
        r = self.regimes[regime]
        middle = (
            min(max(r.speed[0], 0.5 * sum(r.speed)), 1.1 * r.speed[0] + 1e-9)
            if np.isinf(r.speed[1])
            else 0.5 * sum(r.speed)
        )
        for line in self.lines:
            at = line.order * (line.rate if line.rate is not None else (line.per_metre or 0.0) * middle)
            if low <= at < high:
                power = power + 0.5 * np.square(line.amplitude.get(r.name, line.amplitude.get("*", (0.0,) * 6)))
        return np.asarray(np.sqrt(power))

    def factors(self, regime: int, f: Array) -> Complex:
        """Factors (k, 6, 6) at frequencies (k,) with ``factor factor^H`` the cross density; zero outside of the table."""
        r, table = self.regimes[regime], self.frequencies
        inside = (f >= table[0]) & (f <= table[-1])
        x, at = np.log(np.where(inside, np.maximum(f, table[0]), table[0])), np.log(table)
        place = np.clip(np.searchsorted(at, x, side="right") - 1, 0, at.size - 2)
        u = ((x - at[place]) / (at[place + 1] - at[place]))[:, None]
        tiny = 1e-300
        logs = np.log(np.maximum(r.density, tiny))
        root = np.exp(0.5 * ((1.0 - u) * logs[place] + u * logs[place + 1])) * inside[:, None]
        value, vector = np.linalg.eigh(r.coherence)
        each = (vector * np.maximum(value, 0.0)[:, None, :]) @ np.conj(
            np.swapaxes(vector, 1, 2)
        )  # nothing negative by rounding
        mixed = (1.0 - u[:, :, None]) * each[place] + u[:, :, None] * each[place + 1]
        return np.asarray(root[:, :, None] * np.linalg.cholesky(mixed + 1e-9 * np.eye(6)))


def weights(regimes: Sequence[Regime], speed: ArrayLike, turn: ArrayLike, climb: ArrayLike) -> Array:
    """Shares (n, regimes) of the power that regimes have at motions; they sum to one.

    Parameters
    ----------
    regimes : sequence of Regime
    speed, turn, climb : (n,) array_like
        m/s, rad/s, m/s.
    """
    speed, turn, climb = (np.atleast_1d(np.asarray(x, dtype=float)) for x in (speed, turn, climb))
    far = np.stack([r.farness(speed, turn, climb) for r in regimes], axis=1)
    near = np.exp(far.min(axis=1, keepdims=True) - far)
    return np.asarray(near / near.sum(axis=1, keepdims=True))
