"""How a sensor samples: its low-pass, its average over the interval or value at an instant, and where in the interval it puts the stamp.

The true signals of the continuous path go through a second-order Butterworth low-pass, are averaged over each interval or taken at the stamp, and
so have the aliases, the lost coning and the half sample of the real sensor. Nothing here is an error of the sensor that a model could take off.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from insemu.records import Sampling

Array = NDArray[np.float64]

#: Points per period of the highest frequency of the motion or of the sensor's band where a low-pass runs: Simpson's rule then averages to 1e-4.
PER_PERIOD = 12.0
#: Time constants of the low-pass before the first sample.
_WARM = 6.0
#: Rows of a stretch: its fine grid stays below 100 MB.
_ROWS = 20_000
_GAUSS = 4


def sampled(sampling: Sampling, t: Array, signal: Callable[[Array], Array], highest: float) -> Array:
    """What a sensor gives at stamps.

    Parameters
    ----------
    sampling : Sampling
    t : (n,) array
        Stamps at a constant rate, s.
    signal : callable
        Rates and specific force (k, 6) at times (k,), which may lie beyond both ends by an interval and the low-pass.
    highest : float
        Highest frequency of the motion, Hz.

    Returns
    -------
    (n, 6) array
    """
    step = float(np.median(np.diff(t)))
    begin = {"end": -1.0, "middle": -0.5, "start": 0.0}[sampling.stamp] * step
    out = np.empty((t.size, 6))
    for first in range(0, t.size, _ROWS):
        rows = slice(first, first + _ROWS)
        if sampling.bandwidth is not None:
            out[rows] = _filtered(sampling, t[rows], begin, step, signal, highest)
        elif sampling.average == "instant":
            out[rows] = signal(t[rows])
        else:
            # Gauss's rule of p points averages to rounding up to about p / 3 periods in an interval
            points = max(_GAUSS, math.ceil(3.0 * highest * step) + 3)
            x, weight = np.polynomial.legendre.leggauss(points)
            out[rows] = sum(
                0.5 * w * signal(t[rows] + begin + 0.5 * (1.0 + a) * step) for a, w in zip(x, weight, strict=True)
            )
    return out


def _filtered(
    sampling: Sampling, t: Array, begin: float, step: float, signal: Callable[[Array], Array], highest: float
) -> Array:
    """Averages or values behind the low-pass, on a grid that is even in every interval."""
    from scipy.signal import butter, sosfilt, sosfilt_zi

    assert sampling.bandwidth is not None
    fine = 2 * math.ceil(0.5 * PER_PERIOD * step * max(highest, sampling.bandwidth))
    before = math.ceil(_WARM / sampling.bandwidth / step)
    grid = (
        t[0]
        + (begin if sampling.average == "interval" else 0.0)
        + step / fine * np.arange(-before * fine, t.size * fine + 1)
    )
    values = signal(grid)
    sections = butter(2, sampling.bandwidth, fs=fine / step, output="sos")
    start = sosfilt_zi(sections)[:, :, None] * values[0]
    passed = sosfilt(sections, values, axis=0, zi=start)[0][before * fine :]
    if sampling.average == "instant":
        return np.asarray(passed[:-1:fine])
    weight = np.ones(fine + 1)
    weight[1:-1:2], weight[2:-1:2] = 4.0, 2.0  # Simpson
    parts = np.lib.stride_tricks.sliding_window_view(passed, fine + 1, axis=0)[::fine]
    return np.asarray(parts @ (weight / weight.sum()))
