"""What is wrong or worth knowing about a static log: each finding is one sentence that begins with its kind.

Kinds: ``NaN``, ``gap``, ``missing``, ``units``,
``warm-up``, ``level shift``, ``noise level``, ``quantization``, ``saturation``, ``stuck``, ``outliers``,
``line``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.variance.spectrum import psd
from insemu.variance.wavelet import wavelet_variance

Array = NDArray[np.float64]

#: One false alarm in this many clean records for each test below.
FALSE_ALARM = 1e-3
_GRAVITY = 9.80665
#: Resolutions in which lines are looked for: parts of the record. One part finds what keeps its frequency, many what wanders.
PARTS = (1, 16, 256)
#: Bins over which the spectrum around a line is taken: their median is known to 8 %. Blocks at the lowest frequencies that are left out: in
#: the next one a density that falls with f^-2 changes by a third, which the straight line follows.
AROUND, STEEP = 256, 4
#: Share of its frequency by which a source (a fan, a supply) may wander and still be one.
WANDER = 0.02
#: Lines that are said one by one.
SAID = 3


def longest_good_part(columns: Sequence[Array], breaks: Sequence[int]) -> tuple[int, int]:
    """Return ``(start, stop)`` rows of the longest stretch without NaN in any column and without a gap (rows in ``breaks`` follow one)."""
    n = columns[0].shape[0]
    good = np.ones(n, dtype=bool)
    for column in columns:
        good &= np.isfinite(column)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(np.int8), [0]])))
    best = (0, 0)
    cuts = np.asarray(sorted(breaks), dtype=int)
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        marks = [int(a), *cuts[(cuts > a) & (cuts < b)].tolist(), int(b)]
        for start, stop in pairwise(marks):
            if stop - start > best[1] - best[0]:
                best = (start, stop)
    return best


def missing_values(x: Array, rate_hz: float) -> list[str]:
    """Say how many values are not finite and where the first is."""
    bad = ~np.isfinite(x)
    count = int(bad.sum())
    if not count:
        return []
    first = int(np.argmax(bad))
    return [f"NaN: {count} value(s) are not finite, the first at row {first} ({first / rate_hz:.6g} s)"]


def gap_report(gaps: Sequence[tuple[int, float]], rate_hz: float) -> list[str]:
    """Say how many gaps a time column has (rows and durations as :meth:`insemu.formats.Log.gaps` gives them)."""
    if not gaps:
        return []
    row, duration = max(gaps, key=lambda g: g[1])
    return [
        f"gap: {len(gaps)} gap(s) in time, the longest {duration:.4g} s before row {row} (samples are {1 / rate_hz:.4g} s apart)"
    ]


def unit_report(
    means: Mapping[str, float], white: Mapping[str, float], stated: Mapping[str, str]
) -> dict[str, list[str]]:
    """Judge units by physics: gravity's magnitude at rest, and rates or noise no gyroscope has.

    Parameters
    ----------
    means : mapping
        Mean of each axis (``gyro_x`` .. ``accel_z``) in what is believed to be SI.
    white : mapping
        White noise density of each axis, unit/sqrt(Hz), where known.
    stated : mapping
        Unit of each axis as written in the file.

    Returns
    -------
    dict
        Axis to findings.
    """
    out: dict[str, list[str]] = {axis: [] for axis in means}
    for axis in means:
        if axis.startswith(("gyro", "accel")) and stated.get(axis, "").strip() in ("", "-"):
            si = "rad/s" if axis.startswith("gyro") else "m/s^2"
            out[axis].append(f"units: the file states none; {si} is assumed")
        elif stated.get(axis, "").lower() in ("counts", "count", "lsb", "raw"):
            out[axis].append("units: raw counts, no physical unit")
    raw = any("raw counts" in f for found in out.values() for f in found)
    accel = [a for a in ("accel_x", "accel_y", "accel_z") if a in means]
    if len(accel) == 3 and not raw:
        magnitude = float(np.sqrt(sum(means[a] ** 2 for a in accel)))
        if not 0.98 * _GRAVITY < magnitude < 1.02 * _GRAVITY:
            reason = "expected 9.8 m/s^2"
            if 0.9 < magnitude < 1.1:
                reason = "expected 9.8 m/s^2; the values are in g"
            elif 0.9 * _GRAVITY**2 < magnitude < 1.1 * _GRAVITY**2:
                reason = "expected 9.8 m/s^2; the values were m/s^2 already, not g"
            elif 900 < magnitude < 1100:
                reason = "expected 9.8 m/s^2; the values are in mg"
            elif magnitude < 0.5:
                reason = "expected 9.8 m/s^2; gravity was removed or the sensor fell"
            for a in accel:
                out[a].append(f"units: gravity magnitude at rest is {magnitude:.4g}, {reason}")
    for axis, mean in means.items():
        if not axis.startswith("gyro") or raw:
            continue
        noise = np.rad2deg(white.get(axis, 0.0)) * 60.0
        if abs(mean) > 0.2:
            out[axis].append(
                f"units: mean rate at rest is {mean:.3g} rad/s ({np.rad2deg(mean):.3g} deg/s); the values may be in deg/s"
            )
        elif noise > 20.0:
            out[axis].append(
                f"units: white noise of {noise:.3g} deg/sqrt(h) is more than any gyroscope has; the values may be in deg/s"
            )
    return out


def stationarity(x: Array, rate_hz: float, unit: str) -> list[str]:
    """Detect warm-up, level shifts and changes of the noise level.

    Averages over adjacent windows differ by twice the Allan variance on average, for every noise with stationary increments. The
    differences of the first half are held against those of the second (warm-up), and the largest of the second half against the
    typical one (level shift), by F and t tests at a false-alarm rate of 1e-3 shared over windows.

    Parameters
    ----------
    x : (n,) array
        Signal.
    rate_hz : float
        Sampling rate.
    unit : str
        SI unit of the signal.
    """
    out: list[str] = []
    n = x.size
    if n < 2048:
        return out
    running = np.concatenate([[0.0], np.cumsum(x - x[0])])
    windows = [16, 32, 64, 128, 256]
    early: list[tuple[float, float, float]] = []
    late: list[tuple[float, float, float, float]] = []
    for count in windows:
        width = n // count
        steps = np.diff(np.diff(running[: width * count + 1 : width]) / width)
        half = steps.size // 2
        size = float(np.sqrt(np.mean(steps[half:] ** 2)))
        spread = float(np.median(np.abs(steps)) / 0.6745)
        if size == 0.0 or spread == 0.0:
            continue
        # adjacent differences share a window: 2/3 of a degree of freedom each
        freedom = steps[half:].size / 1.5
        share = FALSE_ALARM / (len(windows) * half)
        ratio = np.abs(steps[:half]) / size / np.sqrt(_f_isf(share, 1, freedom))
        if ratio.max() > 1.0:
            last = int(np.flatnonzero(ratio > 1.0)[-1]) + 1
            early.append((last * width / rate_hz, float(np.abs(steps[:half]).max() / size), width / rate_hz))
        at = half + int(np.argmax(np.abs(steps[half:])))
        beyond = abs(float(steps[at])) / spread / -float(scipy.special.stdtrit(freedom, 0.5 * share))
        if beyond > 1.0:
            late.append((beyond, float(steps[at]), (at + 1) * width / rate_hz, width / rate_hz))
    if early:
        settled_s = max(e[0] for e in early)
        _, times, window_s = max(early, key=lambda e: e[1])
        moved = _range(running, rate_hz, settled_s)
        out.append(
            f"warm-up: the mean wanders over {moved:.3g} {unit} in the first {settled_s / 60:.3g} min and settles then; averages over "
            f"{window_s:.3g} s change up to {times:.2g} times as fast there as in the second half. Leave that part out before fitting"
        )
    if late:
        _, jump, at_s, window_s = max(late)
        out.append(f"level shift: the mean over {window_s:.3g} s jumps by {jump:.3g} {unit} at about {at_s:.4g} s")
    out.extend(_noise_level(x, rate_hz))
    return out


def _f_isf(share: float, above: float, below: float) -> float:
    """What an F variable with these degrees of freedom exceeds with a probability of ``share``, however small."""
    return 1.0 / float(scipy.special.fdtri(below, above, share))


def _range(running: Array, rate_hz: float, until_s: float) -> float:
    """Range of the block means (256 per record) up to a time."""
    width = (running.size - 1) // 256
    count = max(2, round(until_s * rate_hz / width) + 1)
    means = np.diff(running[: width * count + 1 : width]) / width
    return float(means.max() - means.min())


def _noise_level(x: Array, rate_hz: float) -> list[str]:
    """Compare the variance of the first octave between eighths of the record."""
    width = x.size // 8
    first = [wavelet_variance(x[k * width : (k + 1) * width], levels=1, intervals="eta3").value[0] for k in range(8)]
    low, high = float(min(first)), float(max(first))
    if low <= 0.0:
        return []
    # a first octave of `width` samples has at least half as many degrees of freedom
    limit = _f_isf(FALSE_ALARM / 28.0, width / 2.0, width / 2.0)
    if high / low > max(limit, 1.1):
        where = int(np.argmax(first))
        return [
            f"noise level: the fast noise is {np.sqrt(high / low):.3g} times larger from {where * width / rate_hz:.4g} to "
            f"{(where + 1) * width / rate_hz:.4g} s than at its quietest"
        ]
    return []


def resolution(x: Array, unit: str) -> list[str]:
    """Detect coarse counts, saturation and stuck values."""
    out: list[str] = []
    some = x if x.size <= 200_000 else x[:: x.size // 200_000]
    levels = np.unique(some)
    step = float(np.diff(levels).min()) if levels.size > 1 else 0.0
    if levels.size == 1:
        return [f"stuck: every value is {levels[0]:.6g} {unit}".rstrip()]
    counted = levels.size < 0.02 * some.size or levels.size < 64
    if counted:
        # unit steps may be missed by rounding of the scale: take the typical smallest one
        gaps = np.diff(levels)
        step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
        noise = float(np.sqrt(np.mean(np.diff(x[: min(x.size, 1_000_000)]) ** 2) / 2.0))
        if noise < 1.5 * step:
            share = step**2 / 12.0 / max(noise**2, 1e-300)
            out.append(
                f"quantization: one count is {step:.4g} {unit} and the fast noise only {noise / step:.2g} counts; rounding alone makes about "
                f"{100 * min(share, 1.0):.2g} % of its variance"
            )
    for extreme, name in ((x.max(), "highest"), (x.min(), "lowest")):
        count = int(np.count_nonzero(x == extreme))
        # a continuous signal never repeats its extreme; counts do, but less often than the counts next to it
        beside = int(np.count_nonzero(np.abs(x - extreme) <= 2.5 * step)) - count if counted else 0
        if count >= (10 if counted else 4) and count > 3 * beside:
            out.append(f"saturation: {count} values sit at the {name} value, {extreme:.6g} {unit}")
    same = np.flatnonzero(np.diff(x) != 0)
    runs = np.diff(np.concatenate([[-1], same, [x.size - 1]]))
    longest = int(runs.max())
    # with coarse counts long runs are natural; expected longest run of a value taken with probability p
    p = max(float(np.mean(np.diff(x[: min(x.size, 1_000_000)]) == 0)), 1e-6)
    natural = 30.0 if p >= 0.999 else max(30.0, 4.0 * np.log(x.size) / -np.log(p))
    if longest > natural and p < 0.999:
        where = int(np.argmax(runs))
        start = int(same[where - 1]) + 1 if where > 0 else 0
        out.append(f"stuck: the value stays the same for {longest} samples from row {start} on")
    return out


def lines(x: Array, rate_hz: float, unit: str) -> list[str]:
    """Detect sinusoids: bins of the spectrum far above those around them, at :data:`FALSE_ALARM` shared over bins and resolutions.

    What is around is the median of :data:`AROUND` bins, between such blocks on a straight line in log density. Its own error is given away
    four times over, so that the rate of false alarms holds.

    Parameters
    ----------
    x : (n,) array
        Signal.
    rate_hz : float
        Sampling rate.
    unit : str
        SI unit of the signal.
    """
    found: list[tuple[float, float]] = []  # amplitude, frequency
    for parts in PARTS:
        if x.size < 4 * (STEEP + 2) * AROUND * parts:
            break
        for line in _lines(x, rate_hz, x.size // parts):
            same = [other for other in found if abs(other[1] - line[1]) < WANDER * other[1]]
            found = [*(other for other in found if other not in same), max([line, *same])]
    if not found:
        return []
    found.sort(reverse=True)
    said = ", ".join(f"{amplitude:.3g} {unit}".rstrip() + f" at {f:.4g} Hz" for amplitude, f in found[:SAID])
    more = f" and {len(found) - SAID} weaker" if len(found) > SAID else ""
    return [f"line: vibration or electrical disturbance, amplitude {said}{more}"]


def _lines(x: Array, rate_hz: float, segment: int) -> list[tuple[float, float]]:
    """Amplitude and frequency of what stands out in the spectrum of segments, what wanders as one."""
    spectrum = psd(x, rate_hz, segment=segment)
    f, density, freedom = spectrum.f_hz, spectrum.psd, float(spectrum.edof[0])
    count = density.size // AROUND
    # a median of chi-square variables tells their mean
    median = np.median(density[: count * AROUND].reshape(count, AROUND), axis=1)
    middle = median * freedom / float(scipy.special.chdtri(freedom, 0.5))
    if middle.min() <= 0.0:
        return []
    level = np.exp(np.interp(np.arange(density.size), (np.arange(count) + 0.5) * AROUND - 0.5, np.log(middle)))
    share = FALSE_ALARM / (len(PARTS) * density.size)
    uncertain = 1.25 * np.sqrt(2.0 / freedom / AROUND)
    high = density > level * float(scipy.special.chdtri(freedom, share)) / freedom * (1.0 + 4.0 * uncertain)
    high[: STEEP * AROUND] = False
    bins = np.flatnonzero(high)
    out = []
    for group in np.split(bins, np.flatnonzero(f[bins[1:]] > f[bins[:-1]] * (1.0 + WANDER)) + 1) if bins.size else []:
        # the main lobe of a Hann window is four bins wide
        lobe = np.unique(np.clip(group[:, None] + np.arange(-2, 3), 0, density.size - 1))
        power = 2.0 * rate_hz / segment * float(np.sum(density[lobe] - level[lobe]))
        out.append((float(np.sqrt(2.0 * max(power, 0.0))), float(f[group[np.argmax(density[group])]])))
    return out
