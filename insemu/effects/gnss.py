"""Errors of the fixes and of the antenna's place."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu import earth
from insemu.effects.base import GNSS, NED, XYZ, Effect, EffectUse, Stage, Subset
from insemu.effects.chain import FixErrors
from insemu.effects.hiding import DriveLot, Hidden, at
from insemu.effects.motion import (
    AntennaMotion,
    Column,
    FixGeometry,
    Motion,
    behind_low_pass,
    smoothed_slope,
    swing_along,
)
from insemu.effects.parameters import EffectParameter
from insemu.errors import InputError
from insemu.records import GnssRecord
from insemu.sample_times import beat

Array = NDArray[np.float64]
_P = EffectParameter
#: Longest lever arm that is plausible, m: the longest ships are half as long.
LONGEST_ARM = 1000.0

#: Time constant of the long one of two shapes of a smoothed velocity, s: three real receivers smooth over 0.1 to 1.2 s (`python -m tests.real_gaps`).
LONG_S = 1.0
#: Time constants of the shapes of a filtered position, s: what a short tracker is behind follows gusts that one of 1 s smooths away.
TRACKED_S = (0.03, 0.1, 0.3, 1.0)

_NO_MEAN = "random: it changes the covariance of the innovations, not their mean"


class _OfFixes(Effect):
    """An error of the fixes."""

    family = "gnss"
    sensors = GNSS
    axes: ClassVar[tuple[str, ...]] = NED
    stage = Stage.NOISE


def gauss_markov(
    t: Array, sigma: ArrayLike, tau: float, rng: np.random.Generator, stated: Array | None = None
) -> Array:
    """First-order Gauss-Markov processes (n, 3) at times that need not be regular, stationary or of the variances that a receiver states.

    Parameters
    ----------
    t : (n,) array
        s.
    sigma : float or (3,)
        Standard deviations.
    tau : float
        Correlation time, s.
    rng : Generator
    stated : (n, 3) array, optional
        Standard deviations with which those of the processes go; ``sigma`` is that at their medians.

    Raises
    ------
    InputError
        A correlation time that is not positive, or a stated standard deviation that is not.
    """
    if not tau > 0:
        raise InputError(f"a correlation time is {tau:g} s, expected a positive number")
    P = np.ones((t.size, 3)) if stated is None else np.square(stated)
    if not (P > 0.0).all():
        raise InputError("an error follows stated standard deviations of zero, expected positive ones")
    P = P / np.median(P, axis=0)
    a = filter_memory(np.diff(t), P, tau)
    white = rng.standard_normal((t.size, 3))
    out = np.sqrt(P) * white
    drive = np.sqrt(P[1:] - a**2 * P[:-1])
    for k in range(1, t.size):
        out[k] = a[k - 1] * out[k - 1] + drive[k - 1] * white[k]
    return np.asarray(out * np.asarray(sigma))


def filter_memory(gaps: Array, P: Array, tau: float) -> Array:
    """The share of a Kalman filter's error that is left at the next fix, for errors of the variances P that the filter states, (n - 1, k).

    Between two fixes the variance grows from P1 by the least that lets an error of the variance 1 last for ``tau``, or by what P2 shows that is more;
    measurements make it P2. What is left of the error is then P2 / (P1 + growth): what a better estimate is off by has nothing to do with by how
    much it changed (Kalman 1960). Of a constant P of 1 this is the memory of a stationary Gauss-Markov process, ``exp(-gap / tau)``.

    Parameters
    ----------
    gaps : (n - 1,) array
        Between the fixes, s.
    P : (n, k) array
        Variances over that at which the correlation time is ``tau``.
    tau : float
        s.
    """
    with np.errstate(over="ignore"):  # nothing is left after a thousand correlation times
        growth = np.expm1(gaps / tau)[:, None]
    return np.asarray(np.minimum(1.0, P[1:] / (P[:-1] + growth)))


class NoiseLevel(_OfFixes):
    """The receiver's standard deviations are wrong."""

    id, name = "gnss_noise_level", "GNSS position noise level"
    formula = "true sigma = factor x stated sigma"
    parameters = (_P("factor", "", 3, (2.0,), None, "north, east, down", True, join="product", nothing=1.0),)
    excitation, in_filter = "fixes", "R"
    traits = frozenset({"level"})
    absent = {"signature": _NO_MEAN}

    def inject_fixes(self, fixes: FixErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Raise the level."""
        fixes.level *= np.array(use["factor"])

    def corrected_fixes(self, use: EffectUse, gnss: GnssRecord) -> GnssRecord:
        """State what is true."""
        if gnss.pos_std_ned is None:
            return gnss
        return replace(gnss, pos_std_ned=self.true_sigma(use, "position", gnss.pos_std_ned))

    def true_sigma(self, use: EffectUse, what: str, stated: Array) -> Array:
        """The factor times what is stated of the positions."""
        return stated * np.array(use["factor"]) if what == "position" else stated

    def hidden(self, lot: DriveLot) -> Hidden:
        """In some directions."""
        return Hidden(lot.group, {"factor": _raised(lot)}, lot.loud)


def _raised(lot: DriveLot) -> tuple[float, ...]:
    return tuple(1.0 + float(a in lot.group) * (0.4 + 0.4 * lot.loud) for a in NED)


class CorrelatedNoise(_OfFixes):
    """Errors of positions that last."""

    id, name = "gnss_correlated_noise", "correlated GNSS noise"
    formula = "position error has a Gauss-Markov part (sigma, tau), as large throughout or (follows = 1) as the receiver states its errors to be"
    parameters = (
        _P("sigma", "m", 3, (0.05,), None, "stationary standard deviation north, east, down", True),
        _P("tau", "s", 1, (30.0,), None, "correlation time", True),
        _P(
            "follows",
            "",
            1,
            (1.0,),
            0.0,
            "1: sigma, at the median of what the receiver states, goes with that",
            True,
            most=1.0,
        ),
    )
    excitation, in_filter = "fixes over several correlation times", "three states"
    absent = {
        "compensate": "random: a filter without states for it widens what it believes of the fixes (gnss_noise_level)",
        "signature": _NO_MEAN,
    }  # fmt: skip

    def inject_fixes(self, fixes: FixErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Add it to the positions."""
        stated = np.broadcast_to(fixes.sigma, fixes.added.shape) if use.scalar("follows") > 0.5 else None
        fixes.added += gauss_markov(fixes.t, use["sigma"], use.scalar("tau"), rng, stated)

    def hidden(self, lot: DriveLot) -> Hidden:
        """In every direction, correlation times from 10 to 100 s."""
        tau = float(math.exp(lot.rng.uniform(math.log(10.0), math.log(100.0))))
        return Hidden(NED, {"sigma": tuple(0.7 * lot.loud * lot.sigma), "tau": tau}, lot.loud)


class VelocityNoise(_OfFixes):
    """The receiver's standard deviations of the velocity are wrong."""

    id, name = "gnss_velocity_noise", "GNSS velocity noise level"
    formula = "true velocity sigma = factor x stated sigma, plus a Gauss-Markov part"
    parameters = (
        _P("factor", "", 3, (2.0,), 1.0, "north, east, down", True, join="product", nothing=1.0),
        _P("sigma", "m/s", 3, (0.05,), 0.0, "Gauss-Markov part", True, join="root_sum_square"),
        _P("tau", "s", 1, (10.0,), 10.0, "its correlation time", True, join="later"),
    )
    excitation, in_filter = "velocity fixes", "R"
    traits = frozenset({"level"})
    absent = {"signature": _NO_MEAN}

    def inject_fixes(self, fixes: FixErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Raise the level and add the part with memory."""
        fixes.level_v *= np.array(use["factor"])
        fixes.added_v += gauss_markov(fixes.t, use["sigma"], use.scalar("tau"), rng)

    def corrected_fixes(self, use: EffectUse, gnss: GnssRecord) -> GnssRecord:
        """State what is true."""
        if gnss.vel_std_ned is None:
            return gnss
        return replace(gnss, vel_std_ned=self.true_sigma(use, "velocity", gnss.vel_std_ned))

    def true_sigma(self, use: EffectUse, what: str, stated: Array) -> Array:
        """The factor times what is stated of the velocities, and the part with memory."""
        return np.hypot(stated * np.array(use["factor"]), np.array(use["sigma"])) if what == "velocity" else stated

    def hidden(self, lot: DriveLot) -> Hidden:
        """In some directions."""
        return Hidden(lot.group, {"factor": _raised(lot)}, lot.loud)


class LeverArm(_OfFixes):
    """The antenna is not where it is believed."""

    id, name, formula = "lever_arm", "lever-arm error", "p_ant = p + C_nb (l + value)"
    parameters = (
        _P("value", "m", 3, (0.05,), None, "true minus assumed lever arm, body axes", join="sum", most=LONGEST_ARM),
    )
    excitation, in_filter = "turns", "three constants"
    axes = XYZ
    stage, size = Stage.MODEL, "value"

    def inject_fixes(self, fixes: FixErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Move the antenna."""
        fixes.arm = fixes.arm + np.array(use["value"])

    def arm(self, use: EffectUse) -> Array:
        """What is missing."""
        return np.array(use["value"])

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """The fixes are ahead along each axis of the body, and swing about it."""
        out = []
        for name, axis in zip(XYZ, fixes.body_axes, strict=True):
            M = np.hstack([fixes.C @ axis, np.einsum("nij,nj->ni", fixes.C, np.cross(fixes.rate, axis))])
            out.append(Column.of(self, "gnss", f"value_{name}", (name,), fixes=M))
        return out

    def hidden(self, lot: DriveLot) -> Hidden:
        """Along one axis."""
        return Hidden(lot.axis, {"value": lot.on(lot.size(self, "value"))})


class LeverArmStep(_OfFixes):
    """An antenna, or an IMU, that moves on the vehicle once and stays: a mount that slips, a second antenna that takes over."""

    id, name = "lever_arm_step", "lever-arm change"
    formula = "p_ant = p + C_nb (l + value) for t > start"
    parameters = (
        _P("value", "m", 3, (0.05,), None, "what the lever arm changes by, body axes", join="sum", most=LONGEST_ARM),
        _P("start", "s", 1, (300.0,), None, "when it changes"),
    )
    excitation, in_filter = "turns after the change", "three constants that are made uncertain again"
    axes = XYZ
    traits = frozenset({"once"})
    stage, size = Stage.MODEL, "value"
    absent = {
        "signature": "one column for every start: the search scans them (changes of the lever arm)",
        "trial": "not drawn: the recordings of earlier seeds would be others",
    }  # fmt: skip

    def inject_fixes(self, fixes: FixErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Move the antenna from then on."""
        fixes.arm_steps.append((use.scalar("start"), np.array(use["value"])))

    def corrected_along(self, use: EffectUse, gnss: GnssRecord, way: AntennaMotion) -> GnssRecord:
        """Move the fixes behind it back."""
        k, behind = way.row(gnss.t), (gnss.t > use.scalar("start"))[:, None]
        value = np.array(use["value"])
        llh = np.where(behind, earth.move(gnss.llh, -way.C[k] @ value), gnss.llh)
        if gnss.vel_ned is None:
            return replace(gnss, llh=llh)
        return replace(gnss, llh=llh, vel_ned=gnss.vel_ned - behind * swing_along(way.C[k], way.rate[k], value))


class MultipathStep(_OfFixes):
    """Positions that are off for a while."""

    id, name = "gnss_multipath_step", "multipath step"
    formula = "position error = value for start < t <= start + duration"
    parameters = (
        _P("value", "m", 3, (1.0,), None, "north, east, down", join="sum"),
        _P("start", "s", 1, (300.0,), None, "start"),
        _P("duration", "s", 1, (60.0,), None, "duration", True),
    )
    excitation, in_filter = "fixes", "gating, or a step state"
    size = "value"
    absent = {"signature": "one column for every start and end: the search scans them (steps in the fixes)"}

    def _inside(self, use: EffectUse, t: Array) -> NDArray[np.bool_]:
        start = use.scalar("start")  # a microsecond of slack: fix times are sums of rounded periods
        return np.asarray((t > start + 1e-6) & (t <= start + use.scalar("duration") + 1e-6))

    def inject_fixes(self, fixes: FixErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Add it to the positions inside."""
        fixes.added[self._inside(use, fixes.t)] += np.array(use["value"])

    def corrected_fixes(self, use: EffectUse, gnss: GnssRecord) -> GnssRecord:
        """Move the positions inside back."""
        inside = self._inside(use, gnss.t)[:, None]
        return replace(gnss, llh=np.where(inside, earth.move(gnss.llh, inside * -np.array(use["value"])), gnss.llh))

    def hidden(self, lot: DriveLot) -> Hidden:
        """In one direction, 20 to 90 s long."""
        start, duration = float(lot.rng.uniform(0.15, 0.7) * lot.span), float(lot.rng.uniform(20.0, 90.0))
        value = at(lot.place, lot.size(self, "value"))
        return Hidden((NED[lot.place],), {"value": value, "start": start, "duration": duration})


def _drawn_outliers(n: int, use: EffectUse, rng: np.random.Generator) -> Array:
    """Normal numbers (n, 3) at a share of n fixes, zero at the others."""
    hit = rng.random(n) < use.scalar("probability")
    return np.asarray(hit[:, None] * np.array(use["sigma"]) * rng.standard_normal((n, 3)))


class GnssOutliers(_OfFixes):
    """Fixes that are far off."""

    id, name = "gnss_outliers", "GNSS outliers"
    formula = "with probability p: error ~ N(0, sigma^2) added"
    parameters = (
        _P("probability", "", 1, (0.01,), None, "share of fixes", True, most=1.0),
        _P("sigma", "m", 3, (5.0,), None, "standard deviation of an outlier", True),
    )
    excitation, in_filter = "fixes", "gating"
    traits = frozenset({"outlying"})
    absent = {"compensate": "which fixes they are is known only once they are found", "signature": _NO_MEAN}

    def inject_fixes(self, fixes: FixErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Add normal numbers at a share of the fixes."""
        fixes.added += _drawn_outliers(fixes.t.size, use, rng)

    def hidden(self, lot: DriveLot) -> Hidden:
        """One to five fixes in a hundred."""
        share = float(lot.rng.uniform(0.01, 0.05))
        return Hidden(NED, {"probability": share, "sigma": tuple(5.0 * lot.loud * lot.sigma)}, lot.loud)


class VelocityOutliers(_OfFixes):
    """Velocities that are far off."""

    id, name = "gnss_velocity_outliers", "GNSS velocity outliers"
    formula = "with probability p: velocity error ~ N(0, sigma^2) added"
    parameters = (
        _P("probability", "", 1, (0.01,), None, "share of velocities", True, most=1.0),
        _P("sigma", "m/s", 3, (0.5,), None, "standard deviation of an outlier", True),
    )
    excitation, in_filter = "velocity fixes", "gating"
    traits = frozenset({"outlying"})
    absent = {
        "compensate": "which velocities they are is known only once they are found", "signature": _NO_MEAN,
        "trial": "not drawn: the recordings of earlier seeds would be others",
    }  # fmt: skip

    def inject_fixes(self, fixes: FixErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Add normal numbers at a share of the velocities."""
        fixes.added_v += _drawn_outliers(fixes.t.size, use, rng)


class Quality(_OfFixes):
    """Noise of two levels."""

    id, name = "gnss_quality", "quality-dependent GNSS noise"
    formula = "a two-state Markov chain: in the poor state sigma is `factor` times larger, stated or not"
    parameters = (
        _P("factor", "", 1, (10.0,), None, "ratio of the standard deviations", True),
        _P("good", "s", 1, (120.0,), 120.0, "mean duration of the good state", True),
        _P("poor", "s", 1, (20.0,), 20.0, "mean duration of the poor state", True),
        _P("stated", "", 1, (1.0,), 1.0, "1: the receiver states the larger sigma, 0: it does not", True, most=1.0),
    )
    excitation, in_filter = "fixes", "R from the receiver"
    absent = {
        "compensate": "a receiver that states its quality has nothing that could be removed", "signature": _NO_MEAN,
        "candidate": "levels that change are seen as outliers or as a level; no candidate names two states yet",
        "refine": "no candidate looks for it", "trial": "no candidate looks for it",
    }  # fmt: skip

    def inject_fixes(self, fixes: FixErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """A two-state Markov chain at the fix epochs, started in the good state."""
        step = np.diff(fixes.t, prepend=fixes.t[0])
        leave_good, leave_poor = 1 - np.exp(-step / use.scalar("good")), 1 - np.exp(-step / use.scalar("poor"))
        u = rng.random(fixes.t.size)
        poor = np.zeros(fixes.t.size, bool)
        for k in range(1, fixes.t.size):
            poor[k] = u[k] >= leave_poor[k] if poor[k - 1] else u[k] < leave_good[k]
        factor = np.where(poor, use.scalar("factor"), 1.0)[:, None]
        fixes.level *= factor
        fixes.level_v *= factor
        if use.scalar("stated"):
            fixes.said *= factor


class Latency(_OfFixes):
    """Fixes that come late."""

    id, name, formula = "gnss_latency", "GNSS latency", "a fix stamped t is valid at t - latency"
    parameters = (_P("latency", "s", 1, (0.02,), None, "age of the fix at its stamp", join="sum"),)
    excitation = "motion"
    in_filter = "as imu_gnss_time_offset: without a third clock the two are one effect"
    axes = ()
    stage, size = Stage.STAMP, "latency"
    absent = {
        "signature": "that of imu_gnss_time_offset: without a third clock the two are one effect",
        "candidate": "found as imu_gnss_time_offset", "trial": "hidden as imu_gnss_time_offset",
        "refine": "found as imu_gnss_time_offset",
    }  # fmt: skip

    def inject_fixes(self, fixes: FixErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Note the age."""
        fixes.latency += use.scalar("latency")

    def corrected_fixes(self, use: EffectUse, gnss: GnssRecord) -> GnssRecord:
        """Stamp the fixes with the time at which they were valid."""
        return replace(gnss, t=gnss.t - use.scalar("latency"))


class VelocityLag(_OfFixes):
    """Velocities that are older than the positions next to them, as those of position differences or of a smoothing receiver are."""

    id, name = "gnss_velocity_lag", "velocity lag of the fixes"
    formula = (
        "velocity stamped t is the mean over t - lag -+ window / 2; of position differences over T: lag T / 2, window T"
    )
    parameters = (
        _P("lag", "s", 1, (0.05,), None, "age of the velocity at the stamp of its fix", join="sum", most=5.0),
        _P("window", "s", 1, (0.1,), 0.0, "time over which it is a mean; not undone", True, join="later", most=10.0),
    )
    excitation, in_filter = (
        "accelerations and turns",
        "velocities used at stamp - lag; one constant; signature -a (velocity)",
    )
    axes = ()
    traits = frozenset({"once", "second_order"})
    stage, size = Stage.STAMP, "lag"

    def inject_fixes(self, fixes: FixErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Note age and window."""
        fixes.velocity_lag += use.scalar("lag")
        fixes.velocity_window = max(fixes.velocity_window, use.scalar("window"))

    def corrected_fixes(self, use: EffectUse, gnss: GnssRecord) -> GnssRecord:
        """Velocities as fixes of their own, stamped with the time at which they were valid."""
        lag = use.scalar("lag")
        return gnss if gnss.vel_ned is None or lag == 0.0 else gnss.with_velocities_at(gnss.t - lag)

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """The velocities are behind by the acceleration of the antenna."""
        M = -fixes.change_per_second
        M[:, :3] = 0.0
        return [Column.of(self, "gnss", "lag", (), fixes=M)]

    def hidden(self, lot: DriveLot) -> Hidden:
        """A constant; velocities are late, not early."""
        return Hidden((), {"lag": abs(lot.size(self, "lag"))})


class VelocityFilter(_OfFixes):
    """Velocities that a receiver smooths, most often the vertical one."""

    id, name = "gnss_velocity_filter", "smoothed velocities of the fixes"
    formula = "velocity y + noise, tau y' = v - y: a low-pass of first order"
    parameters = (_P("tau", "s", 3, (0.1,), None, "time constant, north, east, down", True, "sum", most=60.0),)
    excitation = "climbs, slopes"
    in_filter = "tau y' added to the velocities, y' from the IMU; one constant; signature -y' (vertical velocity)"
    traits = frozenset({"once", "second_order"})
    stage, size = Stage.FILTER, "tau"
    absent = {"trial": "not drawn: the recordings of earlier seeds would be others"}

    def inject_fixes(self, fixes: FixErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Note the time constants: filters one behind the other are about one with their sum."""
        fixes.velocity_tau = fixes.velocity_tau + np.array(use["tau"])

    def corrected_along(self, use: EffectUse, gnss: GnssRecord, way: AntennaMotion) -> GnssRecord:
        """Add what the velocities are behind."""
        if gnss.vel_ned is None:
            return gnss
        a, swing = way.acceleration, way.swing
        behind = [
            tau * smoothed_slope(gnss.t, way.t, a[:, k], swing[:, k], tau) if tau > 0.0 else np.zeros(len(gnss))
            for k, tau in enumerate(use["tau"])
        ]
        return replace(gnss, vel_ned=gnss.vel_ned + np.column_stack(behind))

    def smoothing(self, use: EffectUse) -> Array:
        """The time constants."""
        return np.array(use["tau"])

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """The vertical velocity is behind by the slope of the smoothed one: smoothed shortly, then long.

        Smoothing of the horizontal ones is nearly a lag of the velocities, and looked for as that.
        """
        return [self._behind(motion, fixes, tau) for tau in (0.0, LONG_S)]

    def subsets(self, columns: Sequence[Column]) -> list[Subset]:
        """Short or long."""
        return [(c.axes, "", [k]) for k, c in enumerate(columns)]

    def about(self, column: Column, value: float, motion: Motion, fixes: FixGeometry) -> Column:
        """The slope of the velocity smoothed by that much."""
        return self._behind(motion, fixes, value)

    def _behind(self, motion: Motion, fixes: FixGeometry, tau: float) -> Column:
        M = np.zeros((fixes.t.size, 6))
        swing = swing_along(motion.C, motion.rate, fixes.lever_arm)
        M[:, 5] = -smoothed_slope(fixes.t, motion.t, motion.steady_acceleration[:, 2], swing[:, 2], tau)
        return Column.of(self, "gnss", "tau_down", ("down",), fixes=M)


class PositionFilter(_OfFixes):
    """Positions of a receiver that tracks them as if the velocity were constant: behind where the vehicle accelerates or turns.

    A Kalman filter of constant velocity settles to this tracker (Kalata 1984); critically damped it has one time constant.
    """

    id, name = "gnss_position_filter", "filtered positions of the fixes"
    formula = "position y + noise, (1 + tau d/dt)^2 y = (1 + 2 tau d/dt) p: a critically damped tracker"
    parameters = (_P("tau", "s", 3, (0.2,), None, "time constant, north, east, down", True, "sum", most=60.0),)
    excitation = "accelerations and turns"
    in_filter = "tau^2 times the smoothed acceleration added to the positions; one constant; signature - of that"
    traits = frozenset({"second_order"})
    stage, size = Stage.FILTER, "tau"
    absent = {"trial": "not drawn: the recordings of earlier seeds would be others"}

    def inject_fixes(self, fixes: FixErrors, use: EffectUse, rng: np.random.Generator) -> None:
        """Note the time constants."""
        fixes.position_tau = fixes.position_tau + np.array(use["tau"])

    def corrected_along(self, use: EffectUse, gnss: GnssRecord, way: AntennaMotion) -> GnssRecord:
        """Add what the positions are behind."""
        a, swing = way.acceleration, way.swing
        behind = [_behind_tracker(gnss.t, way.t, a[:, k], swing[:, k], tau) for k, tau in enumerate(use["tau"])]
        return replace(gnss, llh=earth.move(gnss.llh, np.column_stack(behind)))

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """What the horizontal positions are behind, and the height: smoothed shortly, then longer."""
        swing = swing_along(motion.C, motion.rate, fixes.lever_arm)
        return [self._behind(motion, fixes, swing, tau, axes) for axes in (NED[:2], NED[2:]) for tau in TRACKED_S]

    def subsets(self, columns: Sequence[Column]) -> list[Subset]:
        """Each alone."""
        return [(c.axes, "", [k]) for k, c in enumerate(columns)]

    def about(self, column: Column, value: float, motion: Motion, fixes: FixGeometry) -> Column:
        """What positions are behind that are smoothed by the root of that."""
        swing = swing_along(motion.C, motion.rate, fixes.lever_arm)
        return self._behind(motion, fixes, swing, math.sqrt(value), column.axes)

    def _behind(self, motion: Motion, fixes: FixGeometry, swing: Array, tau: float, axes: tuple[str, ...]) -> Column:
        M = np.zeros((fixes.t.size, 6))
        for k in map(NED.index, axes):
            a = motion.steady_acceleration[:, k]
            M[:, k] = -_behind_tracker(fixes.t, motion.t, a, swing[:, k], tau) / tau**2
        label = "tau" if len(axes) > 1 else f"tau_{axes[0]}"
        return Column.of(self, "gnss", label, axes, fixes=M).raised(2.0)


def _behind_tracker(at: Array, t: Array, acceleration: Array, swing: Array, tau: float) -> Array:
    """What a tracked position is behind at times (f,), m: motion over intervals up to times (n,) as :func:`smoothed_slope` takes it."""
    if not tau > 0.0:
        return np.zeros(at.size)
    dt = beat(t)
    # it begins with its velocity right: how it had been behind nobody knows
    vel = np.cumsum(acceleration) * dt + swing
    ahead = vel - behind_low_pass(vel, dt, tau)
    return np.asarray(tau * np.interp(at, t, behind_low_pass(ahead, dt, tau)))


EFFECTS: tuple[Effect, ...] = (
    NoiseLevel(), CorrelatedNoise(), VelocityNoise(), LeverArm(), MultipathStep(), GnssOutliers(), Quality(), Latency(),
    VelocityLag(), VelocityOutliers(), VelocityFilter(), PositionFilter(), LeverArmStep(),
)  # fmt: skip
