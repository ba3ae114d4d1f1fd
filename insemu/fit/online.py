"""A noise model together with a stream: wavelet moments that are carried on, a fit from them now and then, and alarms where a window differs.

The moments of a stretch of the stream are running sums (:class:`insemu.variance.HaarAccumulator`), so that memory and work per sample do not
grow. Every window has a wavelet variance of its own; at every short scale its ratio to that of the stretches before has an F distribution
with the degrees of freedom of both curves. A window that alarms is left out of the moments: the stretch ends before it and another begins after it,
and sums and numbers of coefficients of all stretches are added.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from dataclasses import KW_ONLY, dataclass
from typing import Literal

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.fit.gmwm import fit_curve
from insemu.fit.result import FitResult
from insemu.noise import NoiseModel
from insemu.variance import (
    HaarAccumulator,
    WaveletVariance,
    curve_of_moments,
    robust_wavelet_variance,
    wavelet_variance,
)

Array = NDArray[np.float64]

#: Scales up to this part of a window are compared: longer ones have few degrees of freedom in it.
LONGEST = 1.0 / 16.0
#: So many windows in a row whose level differs are a change: what was known before is forgotten.
PERSISTS = 3
#: Fewest samples of a window.
LEAST_WINDOW = 256
#: Longest scale with a coefficient at every sample, samples; longer ones are taken on a grid.
OVERLAP = 1 << 14
#: Octaves at most.
LEVELS = 34


@dataclass(frozen=True)
class Update:
    """The noise model up to now.

    Parameters
    ----------
    t_s : float
        End of the last window.
    result : FitResult
    windows : int
        That it rests on.
    """

    t_s: float
    result: FitResult
    windows: int


@dataclass(frozen=True)
class Alarm:
    """A window that differs from those before it.

    Parameters
    ----------
    t_s : float
        Start of the window.
    kind : str
        ``level``: its noise is another; ``outliers``: only samples that stand out differ; ``missing``: it has samples that are not finite;
        ``change``: the level of several windows in a row, estimation begins anew.
    tau_s : float
        Scale that shows it best, NaN where samples are missing.
    ratio : float
        Wavelet variance of the window over that before, at this scale.
    p_value : float
        Of the largest difference of all scales.
    """

    t_s: float
    kind: Literal["level", "outliers", "missing", "change"]
    tau_s: float
    ratio: float
    p_value: float


@dataclass(eq=False)
class OnlineFit:
    """The noise of one signal, window by window.

    Parameters
    ----------
    model : NoiseModel
        Structure.
    rate_hz : float
    window_s : float
        Length of a window.
    false_alarms : float
        Probability that a window alarms whose noise is that of the windows before.
    learn : int
        Windows before the first comparison.
    every : int
        Windows from one fit to the next.
    unit, name : str
        Of the signal.

    Raises
    ------
    InputError
        A window of fewer than :data:`LEAST_WINDOW` samples, a probability that is none.

    Notes
    -----
    The p-values of the scales are two-sided F probabilities, the smallest of J scales counts J-fold (Bonferroni), so that the stated
    probability is not exceeded.
    """

    model: NoiseModel
    rate_hz: float
    _: KW_ONLY
    window_s: float = 60.0
    false_alarms: float = 1e-3
    learn: int = 10
    every: int = 10
    unit: str = ""
    name: str = "signal"

    def __post_init__(self) -> None:
        self.window = round(self.window_s * self.rate_hz)
        if self.window < LEAST_WINDOW:
            raise InputError(
                f"a window of {self.window_s:g} s has {self.window} samples, expected at least {LEAST_WINDOW}",
                where=self.name,
            )
        if not 0.0 < self.false_alarms < 0.5:
            raise InputError(f"the probability of a false alarm is {self.false_alarms}, expected one between 0 and 0.5")
        if min(self.learn, self.every) < 1:
            raise InputError(f"found {self.learn} windows to learn and {self.every} between fits, expected one or more")
        self.model = self.model.at_rate(self.rate_hz)
        self.levels = max(1, int(math.log2(self.window * LONGEST)))
        self._rest = np.empty(0)
        self._seen = 0
        self._forget()

    def _forget(self) -> None:
        self._sums, self._counts = np.zeros(LEVELS), np.zeros(LEVELS, dtype=np.int64)
        self._samples = self._windows = 0
        self._stretch: HaarAccumulator | None = None
        self._apart: list[Array] = []

    def push(self, values: Array) -> Iterator[Update | Alarm]:
        """Add samples, any number of them; yields what they show.

        Parameters
        ----------
        values : (k,) array
            NaN where a sample is missing.
        """
        whole = np.concatenate([self._rest, np.asarray(values, dtype=np.float64)])
        count = whole.size // self.window
        self._rest = whole[count * self.window :].copy()
        for k in range(count):
            yield from self._judge(whole[k * self.window : (k + 1) * self.window])

    def curve(self) -> WaveletVariance:
        """The curve of what was taken up to now."""
        value, used = self._pooled()
        return curve_of_moments(value, used, self._samples, self.rate_hz)

    def fitted(self) -> FitResult:
        """The noise model of what was taken up to now."""
        return fit_curve(self.curve(), self.model, unit=self.unit, name=self.name, weighting="asymptotic")

    def _judge(self, x: Array) -> Iterator[Update | Alarm]:
        start = self._seen / self.rate_hz
        self._seen += x.size
        if not np.isfinite(x).all():
            self._interrupt()
            self._apart.clear()
            yield Alarm(start, "missing", math.nan, math.nan, math.nan)
            return
        if self._windows >= self.learn:
            alarm = self._compared(x, start)
            if alarm is not None:
                self._interrupt()
                self._apart = [*self._apart, x] if alarm.kind == "level" else []
                yield alarm
                if len(self._apart) >= PERSISTS:
                    others = self._apart
                    self._forget()
                    for window in others:
                        self._take(window)
                    yield Alarm(start, "change", alarm.tau_s, alarm.ratio, alarm.p_value)
                return
            self._apart.clear()
        self._take(x)
        if self._windows >= self.learn and self._windows % self.every == 0:
            yield Update(self._seen / self.rate_hz, self.fitted(), self._windows)

    def _take(self, x: Array) -> None:
        if self._stretch is None:
            self._stretch = HaarAccumulator(LEVELS, OVERLAP)
        self._stretch.push(x)
        self._samples += x.size
        self._windows += 1

    def _interrupt(self) -> None:
        """End the stretch and keep its sums."""
        if self._stretch is not None:
            value, used = self._stretch.result()
            self._sums[: value.size] += value * used
            self._counts[: value.size] += used
            self._stretch = None

    def _pooled(self) -> tuple[Array, NDArray[np.int64]]:
        sums, counts = self._sums.copy(), self._counts.copy()
        if self._stretch is not None:
            value, used = copy.deepcopy(self._stretch).result()
            sums[: value.size] += value * used
            counts[: value.size] += used
        there = int(np.count_nonzero(counts))
        return sums[:there] / counts[:there], counts[:there]

    def _compared(self, x: Array, start: float) -> Alarm | None:
        """The alarm of a window, if it differs."""
        before, now = self.curve(), wavelet_variance(x, self.rate_hz, levels=self.levels)
        p, at = self._p_value(now, before)
        if p >= self.false_alarms:
            return None
        robust, _ = self._p_value(robust_wavelet_variance(x, self.rate_hz, levels=self.levels), before)
        ratio = float(now.value[at] / before.value[at])
        return Alarm(start, "level" if robust < self.false_alarms else "outliers", float(now.tau_s[at]), ratio, p)

    def _p_value(self, now: WaveletVariance, before: WaveletVariance) -> tuple[float, int]:
        J = self.levels
        f = now.value[:J] / before.value[:J]
        one, other = now.edof[:J], before.edof[:J]
        p = 2.0 * np.minimum(scipy.special.fdtr(one, other, f), scipy.special.fdtrc(one, other, f))
        at = int(np.argmin(p))
        return min(1.0, float(p[at]) * J), at
