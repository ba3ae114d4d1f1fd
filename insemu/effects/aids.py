"""Errors of measurements other than the fixes: an odometer, a barometer, a heading (:mod:`insemu.filters.aids`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from insemu import rotation
from insemu.effects.base import AID_KINDS, Effect, EffectUse, Stage
from insemu.effects.gnss import gauss_markov
from insemu.effects.parameters import EffectParameter
from insemu.effects.timing import stamped_back
from insemu.records import AidRecord

Array = NDArray[np.float64]
_P = EffectParameter
#: Rows of an odometer.
VEHICLE = ("forward", "sideways", "down")
#: The true heading is found from what was measured by repeated substitution; the error falls by the size of the deviation each time.
SUBSTITUTIONS = 6

_TRIAL = "the trials emulate no aids; benchmarks/foreign hides it (--aids)"
_NO_MEAN = "random: it changes the covariance of what the aid is off by, not its mean"


@dataclass
class AidErrors:
    """What an aid measures of a motion, on its way to be recorded; effects change it.

    Parameters
    ----------
    t : (n,) array
        Stamps, s.
    values : (n, rows) array
        Of a perfect instrument, SI.
    level, added : (n, rows) arrays
        Factor of the white noise, and what is added next to it, SI.
    """

    t: Array
    values: Array
    level: Array
    added: Array

    @classmethod
    def of(cls, t: Array, values: Array) -> AidErrors:
        """Of a perfect instrument with the white noise that is stated."""
        return cls(t, np.array(values), np.ones(values.shape), np.zeros(values.shape))


class _OfAid(Effect):
    """An error of a measurement other than the fixes."""

    family = "aids"
    axes: ClassVar[tuple[str, ...]] = ()
    absent = {"trial": _TRIAL}


class _Noise(_OfAid):
    """A random error of one."""

    stage = Stage.NOISE
    absent = {"signature": _NO_MEAN, "trial": _TRIAL}


# -- functions of what is measured ------------------------------------------------------------------------------------------------------


class OdometerScaleFactor(_OfAid):
    """A wheel that is larger or smaller than believed."""

    id, name = "odometer_scale_factor", "odometer scale factor"
    sensors = ("odometer",)
    formula = "e = value x forward velocity, on the forward row"
    parameters = (_P("value", "", 1, (0.01,), None, "relative error of the forward velocity", join="sum", most=0.5),)
    excitation, in_filter = "motion, with fixes", "compensation, or one constant"
    stage, size = Stage.RESPONSE, "value"

    def inject_aid(self, errors: AidErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Stretch the forward velocity."""
        errors.values[:, 0] *= 1.0 + use.scalar("value")

    def corrected_aid(self, use: EffectUse, aid: AidRecord) -> AidRecord:
        """Divide by it."""
        values = aid.values.copy()
        values[:, 0] /= 1.0 + use.scalar("value")
        return replace(aid, values=values)

    def aid_columns(self, values: Array, slope: Array) -> dict[str, Array]:
        """The forward velocity."""
        return {"value": values * np.array([1.0, 0.0, 0.0])}


class OdometerMisalignment(_OfAid):
    """Axes of a wheel or log that are turned against those that are believed."""

    id, name = "odometer_misalignment", "odometer misalignment"
    sensors = ("odometer",)
    formula = "measured = R' v, R the turn by pitch and yaw from the believed axes to its own"
    parameters = (
        _P("pitch", "rad", 1, (math.radians(1.0),), 0.0, "nose up against the believed axes", join="sum", most=math.pi),
        _P("yaw", "rad", 1, (math.radians(1.0),), 0.0, "to the right of the believed axes", join="sum", most=math.pi),
    )
    excitation, in_filter = "motion forward, with fixes", "compensation, or two constants"
    stage = Stage.MOUNTING

    @staticmethod
    def _turn(use: EffectUse) -> Array:
        return rotation.dcm_from_rpy([0.0, use.scalar("pitch"), use.scalar("yaw")])

    def inject_aid(self, errors: AidErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Turn the velocity into its axes."""
        errors.values = errors.values @ self._turn(use)

    def corrected_aid(self, use: EffectUse, aid: AidRecord) -> AidRecord:
        """Turn it back; rows that are not used count as zero, as of a vehicle that moves where it points."""
        there = np.isfinite(aid.values)
        values = np.where(there, aid.values, 0.0) @ self._turn(use).T
        return replace(aid, values=np.where(there, values, aid.values))

    def aid_columns(self, values: Array, slope: Array) -> dict[str, Array]:
        """Small turns."""
        forward, sideways, down = values.T
        zero = np.zeros_like(forward)
        return {
            "pitch": np.column_stack([-down, zero, forward]),
            "yaw": np.column_stack([sideways, -forward, zero]),
        }


class _Offset(_OfAid):
    """A constant."""

    formula = "e = value"
    stage, size = Stage.LAW, "value"

    def inject_aid(self, errors: AidErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Add it."""
        errors.values += use.scalar("value")

    def corrected_aid(self, use: EffectUse, aid: AidRecord) -> AidRecord:
        """Subtract it."""
        return replace(aid, values=aid.values - use.scalar("value"))

    def aid_columns(self, values: Array, slope: Array) -> dict[str, Array]:
        """A constant."""
        return {"value": np.ones_like(values)}


class BarometerOffset(_Offset):
    """The pressure at sea level is not the believed one, or heights are above the sea and not above the ellipsoid."""

    id, name = "barometer_offset", "offset of the barometric height"
    sensors = ("barometer",)
    parameters = (_P("value", "m", 1, (10.0,), None, "measured minus true height", join="sum"),)
    excitation, in_filter = "fixes", "compensation, or one constant"


class BarometerScaleFactor(_OfAid):
    """Air that is colder or warmer than the standard atmosphere: 10 K are 3.5 %."""

    id, name = "barometer_scale_factor", "scale factor of the barometric height"
    sensors = ("barometer",)
    formula = "e = value x (height - h0)"
    parameters = (
        _P("value", "", 1, (0.02,), None, "relative error of differences of height", join="sum", most=0.5),
        _P("h0", "m", 1, (100.0,), 0.0, "height at which it is right", join="equal"),
    )
    excitation, in_filter = "climbs, with fixes", "compensation, or one constant"
    stage, size = Stage.RESPONSE, "value"

    def inject_aid(self, errors: AidErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Stretch heights about the one that is right."""
        errors.values += use.scalar("value") * (errors.values - use.scalar("h0"))

    def corrected_aid(self, use: EffectUse, aid: AidRecord) -> AidRecord:
        """Shrink them."""
        value, h0 = use.scalar("value"), use.scalar("h0")
        return replace(aid, values=(aid.values + value * h0) / (1.0 + value))

    def aid_columns(self, values: Array, slope: Array) -> dict[str, Array]:
        """Heights about their mean, which is the ``h0`` of the answer."""
        return {"value": values - values.mean()}

    def settled_with(self, values: Array) -> dict[str, float]:
        """The height about which it is estimated."""
        return {"h0": float(values.mean())}


class HeadingOffset(_Offset):
    """An antenna baseline or a compass that is turned against its believed axis, or a wrong declination."""

    id, name = "heading_offset", "offset of the heading"
    sensors = ("heading",)
    parameters = (
        _P("value", "rad", 1, (math.radians(2.0),), None, "measured minus true heading", join="sum", most=math.pi),
    )
    excitation, in_filter = "accelerations, with fixes", "compensation, or one constant"


class HeadingDeviation(_OfAid):
    """Iron of the vehicle together with a compass: the coefficients B to E of a compass card (A is the offset)."""

    id, name = "heading_deviation", "compass deviation"
    sensors = ("heading",)
    formula = "e = B sin(heading) + C cos(heading) + D sin(2 heading) + E cos(2 heading)"
    parameters = tuple(
        _P(name, "rad", 1, (math.radians(2.0),), 0.0, meaning, join="sum", most=1.0)
        for name, meaning in (
            ("B", "semicircular, hard iron fore and aft"),
            ("C", "semicircular, hard iron athwart"),
            ("D", "quadrantal, soft iron"),
            ("E", "quadrantal, soft iron at 45 degrees"),
        )
    )
    excitation, in_filter = "turns through all headings, with fixes", "compensation"
    stage = Stage.RESPONSE

    def _error(self, use: EffectUse, heading: Array) -> Array:
        columns = self.aid_columns(heading, heading)
        return np.asarray(sum(use.scalar(name) * column for name, column in columns.items()))

    def inject_aid(self, errors: AidErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Add the deviation at the true heading."""
        errors.values += self._error(use, errors.values)

    def corrected_aid(self, use: EffectUse, aid: AidRecord) -> AidRecord:
        """Subtract it at the heading that makes it what was measured."""
        true = aid.values
        for _ in range(SUBSTITUTIONS):
            true = aid.values - self._error(use, true)
        return replace(aid, values=true)

    def aid_columns(self, values: Array, slope: Array) -> dict[str, Array]:
        """One and two waves around the card."""
        return {"B": np.sin(values), "C": np.cos(values), "D": np.sin(2.0 * values), "E": np.cos(2.0 * values)}


class AidLag(_OfAid):
    """Measurements that are older than their stamps."""

    id, name = "aid_lag", "lag of the measurements"
    sensors = AID_KINDS
    formula = "what is stamped t was measured at t - lag"
    parameters = (_P("lag", "s", 1, (0.1,), None, "age of the measurement at its stamp", join="sum", most=5.0),)
    excitation, in_filter = "what it measures changes, with fixes", "compensation by the stamps"
    stage, size = Stage.STAMP, "lag"

    def age(self, use: EffectUse) -> float:
        """The lag."""
        return use.scalar("lag")

    def corrected_aid(self, use: EffectUse, aid: AidRecord) -> AidRecord:
        """Stamp them with the time at which they were measured."""
        lag = use.scalar("lag")
        return replace(aid, t=aid.t - lag, since=None if aid.since is None else aid.since - lag)

    def aid_columns(self, values: Array, slope: Array) -> dict[str, Array]:
        """What it measures changes meanwhile."""
        return {"lag": -slope}


# -- noise ------------------------------------------------------------------------------------------------------------------------------


class _NoiseLevel(_Noise):
    """The stated standard deviations are wrong."""

    formula = "true sigma = factor x stated sigma"
    excitation, in_filter = "fixes", "R"

    def inject_aid(self, errors: AidErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Raise the level."""
        errors.level *= np.array(use["factor"])

    def corrected_aid(self, use: EffectUse, aid: AidRecord) -> AidRecord:
        """State what is true."""
        return replace(aid, std=aid.std * np.array(use["factor"]))


def _factor(size: int) -> EffectParameter:
    return _P("factor", "", size, (2.0,), None, "for each row", True, join="product", nothing=1.0)


class OdometerNoiseLevel(_NoiseLevel):
    """The stated standard deviations of an odometer are wrong."""

    id, name, sensors, axes = "odometer_noise_level", "odometer noise level", ("odometer",), VEHICLE
    parameters = (_factor(3),)


class BarometerNoiseLevel(_NoiseLevel):
    """The stated standard deviation of a barometer is wrong."""

    id, name, sensors, parameters = "barometer_noise_level", "barometer noise level", ("barometer",), (_factor(1),)


class HeadingNoiseLevel(_NoiseLevel):
    """The stated standard deviation of a heading is wrong."""

    id, name, sensors, parameters = "heading_noise_level", "heading noise level", ("heading",), (_factor(1),)


class _CorrelatedNoise(_Noise):
    """An error that lasts."""

    formula = "the error has a Gauss-Markov part (sigma, tau)"
    traits = frozenset({"widened"})
    excitation, in_filter = "fixes over several correlation times", "R widened; the filter has no state for it"

    def inject_aid(self, errors: AidErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Add it."""
        rows = errors.values.shape[1]
        sigma = np.zeros(3)
        sigma[:rows] = use["sigma"]
        errors.added += gauss_markov(errors.t, sigma, use.scalar("tau"), rng)[:, :rows]

    def corrected_aid(self, use: EffectUse, aid: AidRecord) -> AidRecord:
        """Widen what is stated by the whole error, which is not white: a filter takes it for independent from one to the next.

        So many measurements as fall into two correlation times say as much as one.
        """
        step = float(np.median(np.diff(aid.t))) if len(aid) > 1 else math.inf
        alike = max(1.0, 2.0 * use.scalar("tau") / step)
        return replace(aid, std=np.hypot(aid.std, math.sqrt(alike) * np.array(use["sigma"])))


def _memory(size: int, sigma: float, unit: str, tau: float) -> tuple[EffectParameter, ...]:
    return (
        _P("sigma", unit, size, (sigma,), None, "stationary standard deviation", True, join="root_sum_square"),
        _P("tau", "s", 1, (tau,), None, "correlation time", True, join="later"),
    )


class OdometerCorrelatedNoise(_CorrelatedNoise):
    """Slip, and a radius that changes with load and pressure."""

    id, name, sensors = "odometer_correlated_noise", "correlated odometer noise", ("odometer",)
    axes, parameters = VEHICLE, _memory(3, 0.05, "m/s", 10.0)


class BarometerCorrelatedNoise(_CorrelatedNoise):
    """Weather, wind at the pressure port, and windows that are opened."""

    id, name, sensors = "barometer_correlated_noise", "correlated barometer noise", ("barometer",)
    parameters = _memory(1, 1.0, "m", 300.0)


class HeadingCorrelatedNoise(_CorrelatedNoise):
    """Iron next to the road, multipath of a baseline."""

    id, name, sensors = "heading_correlated_noise", "correlated heading noise", ("heading",)
    parameters = _memory(1, math.radians(1.0), "rad", 60.0)


class AidOutliers(_Noise):
    """Measurements that are far off: wheels that slip or lock, gusts at a pressure port."""

    id, name, sensors = "aid_outliers", "outliers of the measurements", AID_KINDS
    formula = "with probability p: error ~ N(0, sigma^2) added"
    parameters = (
        _P("probability", "", 1, (0.01,), None, "share of measurements", True, most=1.0),
        _P("sigma", "{s}", 1, (1.0, 5.0, math.radians(10.0)), None, "standard deviation of an outlier", True),
    )
    excitation, in_filter = "fixes", "gating"
    traits = frozenset({"outlying"})
    absent = {
        "compensate": "which measurements they are is known only once they are found", "signature": _NO_MEAN, "trial": _TRIAL,
    }  # fmt: skip

    def inject_aid(self, errors: AidErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Add normal numbers at a share of the measurements."""
        hit = rng.random(errors.t.size) < use.scalar("probability")
        errors.added += hit[:, None] * use.scalar("sigma") * rng.standard_normal(errors.values.shape)


def aid_errors(kind: str, t: Array, values: Array, uses: Sequence[EffectUse], rng: np.random.Generator) -> AidErrors:
    """What an aid makes of the values of a perfect instrument.

    Parameters
    ----------
    kind : str
        Which aid.
    t : (n,) array
        Stamps, s.
    values : (n, rows) array
        Of a perfect instrument at the age that the effects give the measurements (:func:`aid_age`), SI.
    uses : sequence of EffectUse
        Those of other sensors are passed over.
    rng : Generator
        Each effect draws from its own child.
    """
    errors = AidErrors.of(t, values)
    own = sorted((use for use in uses if use.sensor == kind), key=_place)
    for use, child in zip(own, rng.spawn(len(own)), strict=True):
        if use.effect.does("inject_aid"):
            use.effect.inject_aid(errors, use, child)
    return errors


def aid_age(kind: str, uses: Sequence[EffectUse]) -> float:
    """By what the measurements of an aid are older than their stamps, s."""
    return sum(use.effect.age(use) for use in uses if use.sensor == kind and use.effect.does("age"))


def aid_corrected(aid: AidRecord, uses: Sequence[EffectUse], first: float) -> AidRecord:
    """An aid put right: its own effects removed, and its stamps, which are the IMU's clock's, put right with that.

    Parameters
    ----------
    aid : AidRecord
    uses : sequence of EffectUse
        Those of the aid, and those of the clock of the IMU; others change nothing.
    first : float
        First stamp of the IMU, s.
    """
    for use in sorted(uses, key=_place, reverse=True):
        if use.sensor == aid.kind and use.effect.does("corrected_aid"):
            aid = use.effect.corrected_aid(use, aid)
        elif use.effect.does("true_time"):
            since = None if aid.since is None else stamped_back(use, aid.since, first)
            aid = replace(aid, t=stamped_back(use, aid.t, first), since=since)
    return aid


def _place(use: EffectUse) -> Stage:
    assert use.effect.stage is not None
    return use.effect.stage


EFFECTS: tuple[Effect, ...] = (
    OdometerScaleFactor(), OdometerMisalignment(), BarometerOffset(), BarometerScaleFactor(), HeadingOffset(), HeadingDeviation(), AidLag(),
    OdometerNoiseLevel(), BarometerNoiseLevel(), HeadingNoiseLevel(), OdometerCorrelatedNoise(), BarometerCorrelatedNoise(),
    HeadingCorrelatedNoise(), AidOutliers(),
)  # fmt: skip
