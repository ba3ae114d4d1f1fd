"""Sideslip of a recorded vehicle: the course of its fixes held against the turn of its gyroscope."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.drives.windows import Signals
from insemu.emulate import Slip
from insemu.intake import track_of

Array = NDArray[np.float64]

#: Slowest speed whose course is used, m/s; longest time constant that is looked for and time over which a gyroscope's drift is removed, s.
SLOWEST, DRIFT_S = 3.0, 30.0
#: Shortest time constant of the random part, s: what is quicker stands in the spectrum of the yaw rate.
QUICKEST_S = 3.0
#: Fewest fixes, least rate of turn (rms, rad/s).
FEWEST, TURNED = 60, 0.02
#: Largest standard deviations with which axle (m) and compliance (rad per m/s^2) are taken as found.
SURE_AXLE, SURE_COMPLIANCE = 0.7, 0.004


@dataclass(frozen=True)
class Sideslip:
    """Heading together with the course.

    Parameters
    ----------
    sigma, time : float
        Standard deviation (rad) and time constant (s) of what turns do not explain.
    axle, compliance : (value, sigma)
        m and rad per m/s^2, see :class:`insemu.emulate.Slip`.
    late : (value, sigma)
        Seconds by which the fixes' course is behind the gyroscope, removed.
    unknown : tuple of str
        What it does not tell.
    """

    sigma: float
    time: float
    axle: tuple[float, float]
    compliance: tuple[float, float]
    late: tuple[float, float]
    unknown: tuple[str, ...]

    def as_slip(self) -> Slip:
        """As an emulation takes it; what is not told is none."""
        axle = self.axle[0] if self.axle[1] < SURE_AXLE else 0.0
        compliance = self.compliance[0] if self.compliance[1] < SURE_COMPLIANCE else 0.0
        return Slip(self.sigma, self.time, axle=axle, compliance=compliance)


def sideslip_of(s: Signals) -> Sideslip | None:
    """Sideslip from signals; None where too few fixes are fast, or it hardly turns.

    Parameters
    ----------
    s : Signals

    Notes
    -----
    Heading less course is ``compliance v r - axle r / v`` of a turn ``r`` at a speed ``v``, the offset of the clocks adds ``late r``; the three are
    told by the speeds at which it turns. Drift of the gyroscope is removed by what is slower than :data:`DRIFT_S`.
    """
    track = track_of(s.fixes)
    speed = np.hypot(track.velocity[:, 0], track.velocity[:, 1])
    turned = np.cumsum(s.x[:, 2]) * s.dt
    inside = (track.t > s.t[0] + 1.0) & (track.t < s.t[-1] - 1.0)
    fast = inside & (speed > SLOWEST)
    if fast.sum() < FEWEST:
        return None
    t, v = track.t[fast], speed[fast]
    heading = np.interp(t, s.t, turned)
    r = (np.interp(t + 0.25, s.t, turned) - np.interp(t - 0.25, s.t, turned)) / 0.5
    if float(np.sqrt(np.mean(r**2))) < TURNED:
        return None
    course = np.unwrap(np.arctan2(track.velocity[fast, 1], track.velocity[fast, 0]))
    # a run is a stretch without a stop: each has a heading of its own
    run = np.cumsum(np.concatenate([[0], (np.diff(t) > 3.0 * np.median(np.diff(t))).astype(int)]))
    y = heading - course
    columns = np.stack([v * r, -r / v, r], axis=1)
    keep = np.zeros(t.size, dtype=bool)
    for k in np.unique(run):
        rows = run == k
        if t[rows][-1] - t[rows][0] < 0.5 * DRIFT_S:
            continue
        keep |= rows
        for x in (y, *columns.T):
            x[rows] -= _slow(t[rows], x[rows])
    if keep.sum() < FEWEST:
        return None
    y, columns, run = y[keep], columns[keep], run[keep]
    weight = np.ones(y.size)
    for _ in range(5):  # Huber's rule: a course that jumps at low speed
        normal = (columns * weight[:, None]).T @ columns
        beta = np.linalg.solve(normal, (columns * weight[:, None]).T @ y)
        left = y - columns @ beta
        scale = 1.4826 * float(np.median(np.abs(left)))
        weight = np.minimum(1.0, 2.0 * scale / np.maximum(np.abs(left), 1e-12))
    step = float(np.median(np.diff(t)))
    same = run[1:] == run[:-1]
    lagged = float(np.mean((left[1:] * left[:-1])[same]))
    variance = float(np.mean(np.minimum(np.abs(left), 3.0 * scale) ** 2))
    # the white part is the noise of the course
    smooth = float(np.clip(lagged, 0.0, variance))
    two = [k for k in (2, 3, 4) if k < left.size]
    r2 = float(np.mean([np.mean(left[k:] * left[:-k]) for k in two])) if two else 0.0
    ratio = float(np.clip(r2 / max(smooth, 1e-12), 0.05, 0.95))
    time = float(np.clip(-2.0 * step / np.log(ratio), QUICKEST_S, DRIFT_S / 3.0))
    # neighbours go together, so fewer of them count
    each = scale * np.sqrt(np.diag(np.linalg.inv(normal)) * max(1.0, 2.0 * time / step))
    found = [(float(b), float(e)) for b, e in zip(beta, each, strict=True)]
    unknown = []
    if each[1] >= SURE_AXLE:
        unknown.append(f"place of the rear axle: {each[1]:.1f} m is its standard deviation, none is taken")
    if each[0] >= SURE_COMPLIANCE:
        unknown.append(
            f"sideslip by side force: {np.rad2deg(each[0]):.2f} deg per m/s^2 is its standard deviation, none is taken"
        )
    return Sideslip(float(np.sqrt(smooth)), time, found[1], found[0], found[2], tuple(unknown))


def _slow(t: Array, x: Array) -> Array:
    """What is slower than :data:`DRIFT_S`: a polynomial with as many terms as that has periods."""
    u = 2.0 * (t - t[0]) / max(t[-1] - t[0], 1e-9) - 1.0
    order = int(np.clip((t[-1] - t[0]) / DRIFT_S, 1, 12))
    return np.asarray(np.polynomial.chebyshev.chebval(u, np.polynomial.chebyshev.chebfit(u, x, order)))
