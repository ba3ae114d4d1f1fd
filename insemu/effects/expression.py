"""An error without a name of its own: a number times a term of signals, such as ``east = -0.056 s * speed``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from insemu import earth, rotation
from insemu.effects import terms
from insemu.effects.base import NED, XYZ, Effect, EffectUse, Stage, Subset
from insemu.effects.chain import Chain, FixErrors
from insemu.effects.motion import AntennaMotion, Column, FixGeometry, Motion, first_axis
from insemu.effects.parameters import EffectParameter
from insemu.effects.terms import TARGETS, Equation, Signals, equation
from insemu.errors import InputError, shown
from insemu.records import GnssRecord, Trajectory

Array = NDArray[np.float64]
#: Signals that need no motion of the vehicle.
_ALONE = frozenset({"time", "temperature"})
#: Usual size of an unnamed error that varies: rad/s, m/s^2, m.
SIZES = {"gyro": 1e-4, "accel": 1e-2, "gnss": 0.05}
#: Log prior odds, nats, against each further signal or power in a term: the longer it may be, the more terms follow any recording by chance.
LONGER = 2.0
_RATES, _FORCES = (tuple(f"{kind}_{a}" for a in XYZ) for kind in ("rate", "force"))


def dictionary(sensor: str) -> list[str]:
    """Terms that a search tries for a sensor, less those that the catalogue has by name.

    Parameters
    ----------
    sensor : str
        ``gyro``, ``accel`` or ``gnss``.
    """
    if sensor == "gnss":
        around = ("cos(heading)", "sin(heading)")
        return [*around, "speed", "speed ** 2", "time", "rate_z", *(f"speed * {x}" for x in (*around, "rate_z"))]
    pairs = [*combinations_with_replacement(_RATES, 2), *combinations_with_replacement(_FORCES, 2)]
    pairs += [(r, f) for r in _RATES for f in _FORCES]
    alone = ("speed", "speed ** 2", *(_RATES if sensor == "accel" else ()))
    return [*alone, *(f"{a} ** 2" if a == b else f"{a} * {b}" for a, b in pairs)]


_VALUE = EffectParameter("value", "", 1, (1.0,), None, "in SI units of the target over the term", join="sum")


class _Equation(Effect):
    """An error that is a number times a term."""

    family = "model"
    sensors = ("gyro", "accel", "gnss")
    excitation, in_filter = "what stands in the term has to vary", "the term of the estimated signals is removed"
    axes, traits = (), frozenset({"equation"})
    stage, size = Stage.LAW, "value"

    def unit(self, parameter: str, sensor: str, equation: str = "") -> str:
        """That of the coefficient follows from the equation."""
        if equation and parameter == "value":
            return terms.equation(equation, sensor).unit
        return super().unit(parameter, sensor)

    def written(self, equation: str, sensor: str) -> str:
        """In the form of the grammar; ``InputError`` where it is none."""
        if not isinstance(equation, str) or not equation:
            raise InputError(
                f"effect '{self.id}' needs the key 'equation', such as 'east = speed'; found {shown(equation)}"
            )
        try:
            return terms.equation(equation, sensor).text
        except InputError as error:
            raise InputError(f"effect '{self.id}', 'equation': {error.message}") from None

    def error(self, use: EffectUse, signals: Signals) -> Array:
        """The error (n,) on its target."""
        return use.scalar("value") * equation(use.equation, use.sensor).of(signals)

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Add it to its axis."""
        r, e = chain.reference, equation(use.equation, use.sensor)
        if not e.names <= {*_ALONE, *_RATES, *_FORCES}:
            r = chain.need_reference(use)
        signals = Signals(chain.t, None, None, chain.signal[:3].T, chain.signal[3:].T, chain.temperature)
        if r is not None:
            signals = replace(signals, velocity=r.vel_ned, rpy=r.rpy)
        chain.rows(use.sensor)[XYZ.index(e.target)] += self.error(use, signals)

    def inject_fixes(self, fixes: FixErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Add it to the positions."""
        fixes.added[:, NED.index(equation(use.equation, "gnss").target)] += self.error(use, fixes.signals())

    def added(self, use: EffectUse, t: Array, temperature: Array | None) -> Array:
        """What needs no motion."""
        e = equation(use.equation, use.sensor)
        if use.sensor == "gnss" or not e.names <= _ALONE:
            return np.zeros((t.size, 3))
        return _on(e, self.error(use, Signals(t, temperature=temperature)))

    def omitted(
        self, use: EffectUse, trajectory: Trajectory, rows: NDArray[np.int64], signals: Signals
    ) -> tuple[Array | None, Array | None]:
        """Minus what goes with the motion."""
        e = equation(use.equation, use.sensor)
        if use.sensor == "gnss" or e.names <= _ALONE:
            return None, None
        here = replace(signals, velocity=trajectory.vel_ned[rows], rpy=trajectory.rpy[rows])
        less = _on(e, -self.error(use, here))
        return (less, None) if use.sensor == "gyro" else (None, less)

    def corrected_along(self, use: EffectUse, gnss: GnssRecord, way: AntennaMotion) -> GnssRecord:
        """Take it off the positions."""
        if use.sensor != "gnss":
            return gnss
        e, k = equation(use.equation, "gnss"), way.row(gnss.t)
        rate = None if way.rate is None else way.rate[k]
        here = Signals(gnss.t, way.velocity_at(gnss.t), rotation.rpy_from_dcm(way.C[k]), rate)
        error = np.zeros((len(gnss), 3))
        error[:, NED.index(e.target)] = -self.error(use, here)
        there = np.isfinite(gnss.llh).all(axis=1)
        llh = gnss.llh.copy()
        llh[there] = earth.move(llh[there], error[there])
        return replace(gnss, llh=llh)

    def merged(self, old: EffectUse, new: EffectUse) -> EffectUse | None:
        """The sum of two of one equation."""
        return super().merged(old, new) if old.equation == new.equation else None


class Expression(_Equation):
    """What has no name, as an equation."""

    id, name = "expression", "error that follows an equation"
    formula = "equation: target = term; e_target = value x term"
    parameters = (_VALUE,)
    absent = {"trial": "benchmarks.foreign hides equations that the search does not read"}

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """Every term of the dictionary on every axis and in every direction."""
        rpy = rotation.rpy_from_dcm(motion.C @ fixes.body_axes.T)
        along = Signals(motion.t, motion.vel, rpy, motion.rate, motion.force, motion.temperature)
        at = Signals(
            fixes.t, fixes.velocity, rotation.rpy_from_dcm(fixes.C @ fixes.body_axes.T), fixes.rate @ fixes.body_axes.T
        )
        out = []
        for sensor in self.sensors:
            signals = at if sensor == "gnss" else along
            for term in dictionary(sensor):
                e = [equation(f"{target} = {term}", sensor) for target in TARGETS[sensor]]
                u = e[0].of(signals)
                scale = SIZES[sensor] / max(float(np.std(u)), 1e-3 * float(np.abs(u).max()), 1e-12)
                for k, one in enumerate(e):
                    made = Column(self.id, sensor, "value", (one.text,), scale, one.unit)
                    if sensor == "gnss":
                        M = np.zeros((u.size, 6))
                        M[:, k] = u
                        out.append(replace(made, fixes=M))
                    else:
                        out.append(replace(made, inputs=((first_axis(sensor) + k, u),)))
        return out

    def odds(self, column: Column) -> float:
        """Rarer by each further signal or power."""
        return math.exp(-LONGER * (equation(column.axes[0], column.sensor).length - 1))

    def subsets(self, columns: Sequence[Column]) -> list[Subset]:
        """Each alone."""
        return super().subsets(columns)[: len(columns)]


class ExpressionStep(_Equation):
    """An error that follows an equation from a time on: a scale factor, or a misalignment, that changes."""

    id, name = "expression_step", "error that follows an equation from a time on"
    formula = "equation: target = term; e_target = value x term for t > start"
    parameters = (_VALUE, EffectParameter("start", "s", 1, (300.0,), None, "when it begins"))
    absent = {
        "signature": "one column for every start: the search scans them (errors of the sensors from a time on)",
        "trial": "not drawn: the recordings of earlier seeds would be others",
    }  # fmt: skip

    def error(self, use: EffectUse, signals: Signals) -> Array:
        """Zero up to the start."""
        return np.where(signals.t > use.scalar("start"), super().error(use, signals), 0.0)


def _on(e: Equation, error: Array) -> Array:
    """An error (n,) on its axis, (n, 3)."""
    out = np.zeros((error.size, 3))
    out[:, XYZ.index(e.target)] = error
    return out


EFFECTS: tuple[Effect, ...] = (Expression(), ExpressionStep())
