"""Sensors as a row of figures: those of a card with their spread, or any other; and the states that a filter carries for them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.noise import BI, GM, RC, RW, WN, NoiseModel, Process
from insemu.records import AXES
from insemu.sensors import Assumptions, Card, axis_models
from insemu.units import datasheet

Array = NDArray[np.float64]

#: Figures of a triad: what they are called, processes of a card's model that hold them, and the unit in terms of the signal's.
KINDS: tuple[tuple[str, tuple[type[Process], ...], str], ...] = (
    ("white noise", (WN,), "{u}/sqrt(Hz)"),
    ("in-run bias", (BI, GM), "{u}"),
    ("walk", (RW,), "{u}*sqrt(Hz)"),
    ("turn-on bias", (RC,), "{u}"),
    ("scale factor", (), ""),
)
SIGNALS = {"gyro": "rad/s", "accel": "m/s^2"}
#: All figures, and their SI units.
FIGURES = tuple(f"{triad} {kind}" for triad in SIGNALS for kind, _, _ in KINDS)
UNITS = tuple(unit.format(u=u) for u in SIGNALS.values() for _, _, unit in KINDS)
#: Grades, as cards name them.
GRADES = ("navigation", "tactical", "industrial", "consumer")
#: A state that forgets within so many seconds is white noise of the same density, for outages of ten seconds or more.
FAST = 1.0
#: Normal quantile of the share of units that a printed maximum holds.
WORST_QUANTILE = 1.645


@dataclass(frozen=True, eq=False)
class Sensor:
    """The figures of a sensor, alike on the three axes of a triad.

    Parameters
    ----------
    name : str
    values : (10,) array
        In the order of :data:`FIGURES`, SI; zero where there is none.
    spread : (10,) array
        Standard deviation of the logarithm of each figure over the units of a type.
    times : (float, float)
        Correlation times of the in-run biases of gyroscopes and accelerometers, s; infinite for flicker.
    about : str
        What the card says of it.
    assumed : tuple of str
        Figures that are not printed and were taken from sensors of the same grade.
    """

    name: str
    values: Array
    spread: Array
    times: tuple[float, float] = (math.inf, math.inf)
    about: str = ""
    assumed: tuple[str, ...] = ()

    @classmethod
    def of_card(cls, card: Card, assumptions: Assumptions | None = None) -> Sensor:
        """The figures that a card's models hold; where axes differ their root mean square.

        A printed maximum (else ``worst_factor`` times the typical figure) is taken for what 95 % of the units keep, with a log-normal spread.

        Raises
        ------
        InputError
            As :func:`insemu.sensors.axis_models`, or a card of one triad only.
        """
        typical, worst = (axis_models(card, case, assumptions) for case in ("typical", "worst"))
        if missing := [t for t in SIGNALS if not any(a.startswith(t) for a in typical)]:
            raise InputError(
                f"{card.name} has no figures of its {missing[0]} triad, expected gyroscopes and accelerometers"
            )
        (values, times), (most, _) = (_figures({a: m.model for a, m in c.items()}) for c in (typical, worst))
        scale = [card.of_axis(f"{triad}_x").get("scale_factor") for triad in SIGNALS]
        at = [i for i, name in enumerate(FIGURES) if name.endswith("scale factor")]
        for i, figure in zip(at, scale, strict=True):
            if figure is not None:
                values[i] = figure.value
                most[i] = figure.worst or (assumptions or Assumptions()).worst_factor * figure.value
        spread = np.log(np.where(values > 0, np.maximum(most, values) / np.where(values > 0, values, 1.0), 1.0))
        return cls(card.name, values, spread / WORST_QUANTILE, times, card.about)

    def times_factor(self, figure: int, factor: float) -> Sensor:
        """The same with one figure changed."""
        values = self.values.copy()
        values[figure] *= factor
        return replace(self, values=values)

    def models(self) -> dict[str, NoiseModel]:
        """Noise models of the two triads; scale factors are no part of them."""
        out = {}
        for triad, name in enumerate(SIGNALS):
            levels = [(p, self.values[f]) for t, f, p in self._parts() if t == triad]
            out[name] = NoiseModel(tuple(p.with_parameters({p.level.name: float(v)}) for p, v in levels if v > 0))
        return out

    def _parts(self) -> list[tuple[int, int, Process]]:
        """Triad, figure and process at level 1 of every figure that has one."""
        out: list[tuple[int, int, Process]] = []
        for triad in range(2):
            bias: Process = BI(1.0) if math.isinf(self.times[triad]) else GM(1.0, 1.0 / self.times[triad])
            for j, unit in enumerate((WN(1.0), bias, RW(1.0), RC(1.0))):
                out.append((triad, triad * len(KINDS) + j, unit))
        return out

    def kind(self, dt: float) -> tuple[tuple[float, ...], bool]:
        """What sensors share that can be carried side by side: the decay of their states over a step, and whether scale factors count."""
        decays = {float(a) for _, _, p in self._parts() for a in np.diag(p.block(dt).Phi) if a > math.exp(-dt / FAST)}
        return tuple(sorted(decays)), bool(self.values[[4, 9]].any())


def completed(sensors: Sequence[Sensor]) -> list[Sensor]:
    """The sensors with the in-run biases that no source prints: the geometric mean of those of the same grade, with their spread.

    A grade is that of :data:`GRADES` which a card names first; a card that names none is of the grade whose white noise of the gyroscopes is
    nearest.
    """
    levels = np.log([max(s.values[0], 1e-300) for s in sensors])
    said = [s.about.lower() for s in sensors]
    named = [min((g for g in GRADES if g in text), key=text.find, default="") for text in said]
    middle = {
        g: float(np.median([x for x, n in zip(levels, named, strict=True) if n == g])) for g in GRADES if g in named
    }
    out = []
    for s, x, name in zip(sensors, levels, named, strict=True):
        grade = name or min(middle, key=lambda g: abs(middle[g] - x))
        values, spread, assumed = s.values.copy(), s.spread.copy(), []
        for f in (i for i, figure in enumerate(FIGURES) if figure.endswith("in-run bias") and not values[i]):
            known = np.log([o.values[f] for o, n in zip(sensors, named, strict=True) if n == grade and o.values[f] > 0])
            if known.size > 1:
                values[f], spread[f] = float(np.exp(known.mean())), float(known.std(ddof=1))
                assumed.append(f"{FIGURES[f]} {shown(f, values[f])}, of {known.size} cards of {grade} grade")
        out.append(replace(s, values=values, spread=spread, assumed=tuple(assumed)))
    return out


@dataclass(frozen=True)
class States:
    """States of sensors side by side; state ``6 g + a`` is that of group g on axis a.

    Parameters
    ----------
    decay : (groups,) array
        Over one step of the IMU.
    scaled : bool
        Whether six scale factors stand behind the groups.
    P0, q : (m, sensors) arrays
        Variances at the start, and of the driving noise of a step.
    white : (6, sensors) array
        Variance of the white noise of a sample.
    """

    decay: Array
    scaled: bool
    P0: Array
    q: Array
    white: Array


def states_of(sensors: Sequence[Sensor], dt: float) -> States:
    """The states of sensors of one kind.

    Parameters
    ----------
    sensors : sequence of Sensor
        Of the same :meth:`Sensor.kind`.
    dt : float
        Sampling interval, s.
    """
    decay, scaled = sensors[0].kind(dt)
    values = np.stack([s.values for s in sensors], axis=1)
    P0, q, white = (np.zeros((rows, len(sensors))) for rows in (6 * (len(decay) + scaled),) * 2 + (6,))
    for triad, figure, process in sensors[0]._parts():
        block, square = process.block(dt), values[figure] ** 2
        axes = slice(3 * triad, 3 * triad + 3)
        white[axes] += block.white * square
        for a, first, drive in zip(np.diag(block.Phi), np.diag(block.P0), np.diag(block.Q), strict=True):
            if a in decay:
                at = 6 * decay.index(float(a)) + 3 * triad
                P0[at : at + 3] += first * square
                q[at : at + 3] += drive * square
            else:  # 2 sigma^2 T as a density, T the correlation time
                white[axes] += first * square * (1.0 + a) / (1.0 - a)
    if scaled:
        P0[-6:-3], P0[-3:] = values[4] ** 2, values[9] ** 2
    return States(np.array(decay), scaled, P0, q, white)


def _figures(models: Mapping[str, NoiseModel]) -> tuple[Array, tuple[float, float]]:
    """The figures behind the models of the axes, and correlation times of the in-run biases."""
    values, times = np.zeros(len(FIGURES)), [math.inf, math.inf]
    for triad, name in enumerate(SIGNALS):
        axes = [m for a, m in models.items() if a in AXES and a.startswith(name)]
        for j, (_, kinds, _) in enumerate(KINDS):
            found = [p for m in axes for p in m if isinstance(p, kinds)]
            if found:
                values[triad * len(KINDS) + j] = math.sqrt(
                    sum(p.parameters[p.level.name] ** 2 for p in found) / len(axes)
                )
            times[triad] = next((1.0 / p.parameters["beta"] for p in found if isinstance(p, GM)), times[triad])
    return values, (times[0], times[1])


def shown(figure: int, value: float) -> str:
    """A figure in the unit of datasheets."""
    if not UNITS[figure]:
        return f"{1e6 * value:.3g} ppm"
    number, unit = datasheet(value, UNITS[figure])
    return f"{number:.3g} {unit}"
