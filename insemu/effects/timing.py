"""Errors of the clock of the IMU."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from insemu.effects.base import IMU, Effect, EffectUse, Stage
from insemu.effects.chain import Chain
from insemu.effects.hiding import DriveLot, Hidden
from insemu.effects.motion import Column, FixGeometry, Motion, on_axes
from insemu.effects.parameters import EffectParameter
from insemu.errors import InputError

Array = NDArray[np.float64]
_P = EffectParameter


class TimeOffset(Effect):
    """The clocks of IMU and receiver differ by a constant."""

    id, name = "imu_gnss_time_offset", "time offset between IMU and GNSS"
    family, sensors, formula = "timing", IMU, "IMU stamp = true time + offset"
    parameters = (
        _P("offset", "s", 1, (0.005,), None, "positive: IMU stamps are late (or GNSS fixes early)", join="sum"),
    )
    excitation = "accelerations and turns"
    in_filter = "one constant; signature v (position), a (velocity)"
    axes = ()
    traits = frozenset({"once"})
    stage, size = Stage.STAMP, "offset"

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Shift the stamps."""
        chain.stamps = chain.stamps + use.scalar("offset")

    def true_time(self, use: EffectUse, t: Array) -> Array:
        """Shift them back."""
        return t - use.scalar("offset")

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """The fixes, and the start, which is known in their time, are ahead by velocity and acceleration."""
        return [Column.of(self, "imu", "offset", (), fixes=fixes.change_per_second, start=fixes.start)]

    def hidden(self, lot: DriveLot) -> Hidden:
        """A constant."""
        return Hidden((), {"offset": lot.size(self, "offset")})


class ClockDrift(Effect):
    """The clock of the IMU runs fast or slow."""

    id, name, family, sensors = "clock_drift", "clock drift", "timing", IMU
    formula = "IMU stamp = t_0 + (1 + drift) (t - t_0)"
    parameters = (_P("drift", "", 1, (2e-5,), None, "relative rate error of the IMU's clock", join="sum", most=0.5),)
    excitation, in_filter = "a long drive with accelerations", "one constant, growing time offset"
    axes = ()
    traits = frozenset({"once"})
    stage, size = Stage.CLOCK, "drift"

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Stretch the stamps."""
        t = chain.stamps
        chain.stamps = t[0] + (t - t[0]) * (1.0 + use.scalar("drift"))

    def true_time(self, use: EffectUse, t: Array) -> Array:
        """Stretch them back."""
        return np.asarray(t[0] + (t - t[0]) / (1.0 + use.scalar("drift")))

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """A growing time offset, and what is integrated over stretched intervals.

        Stamps that run fast: the fixes are ahead by drift (t - t_0), t_0 the first stamp of the recording, and what is integrated over stretched
        intervals is too much: velocity in any case, gravity where increments are summed, the whole acceleration and rate where means or samples are.
        """
        late, begun = (fixes.t - motion.began)[:, None], float(motion.t[0] - motion.began)
        a_b = np.einsum("nji,nj->ni", motion.C, motion.gravity if motion.summed else motion.acceleration)
        inputs = on_axes(a_b, 3) + (() if motion.summed else on_axes(motion.rate))
        start = begun * fixes.start if begun else None
        return [replace(Column.of(self, "imu", "drift", (), inputs, fixes.change_per_second * late, start), runs=True)]

    def hidden(self, lot: DriveLot) -> Hidden:
        """A constant."""
        return Hidden((), {"drift": lot.size(self, "drift")})


class TimeJitter(Effect):
    """Time stamps scatter."""

    id, name, family, sensors = "time_jitter", "time-stamp jitter", "timing", IMU
    formula = "IMU stamp = true time + N(0, sigma^2)"
    parameters = (_P("sigma", "s", 1, (2e-4,), None, "standard deviation", True),)
    excitation, in_filter = "fast motion", "constant-rate stamps by regression"
    axes = ()
    stage = Stage.STAMP
    absent = {
        "compensate": "stamps are put on a constant rate where the samples are searched; a table has no number for it",
        "signature": "random: it changes the covariance of the innovations, not their mean",
        "candidate": "read off the stamps, which say it without a search",
        "refine": "no candidate looks for it",
        "trial": "no candidate looks for it",
    }  # fmt: skip

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Scatter the stamps."""
        chain.stamps = chain.stamps + use.scalar("sigma") * rng.standard_normal(chain.stamps.size)
        if (np.diff(chain.stamps) <= 0).any():
            raise InputError(
                f"effect 'time_jitter': a sigma of {use.scalar('sigma'):g} s makes stamps go back at intervals of {chain.dt:g} s"
            )


def stamped_back(use: EffectUse, t: Array, first: float) -> Array:
    """True times (n,) of stamps of something else on the clock of an IMU, s.

    Parameters
    ----------
    use : EffectUse
        Of that clock.
    t : (n,) array
        s.
    first : float
        First stamp of the IMU, s.
    """
    return np.asarray(use.effect.true_time(use, np.concatenate([[first], t]))[1:])


EFFECTS: tuple[Effect, ...] = (TimeOffset(), ClockDrift(), TimeJitter())
