"""The checks of fixes alone: place, rate, velocities against positions, heights, steps, standard deviations."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu import earth
from insemu.intake.card import Level, Line
from insemu.intake.checks import NEAR, G, near
from insemu.intake.motion import Track, every, positions_track, scatter, velocity_track
from insemu.records import GnssRecord

Array = NDArray[np.float64]

#: Nats by which the IMU decides about the sign of a vertical velocity.
SIGN_NATS = 25.0
#: Stretches over which heights are held against the vertical velocity, s: a climb of 0.3 m/s is 6 m there, and a receiver's slow errors are less.
CLIMB_S = 20.0
#: Correlation of changes of height with those that the vertical velocity says from which their ratio is believed; how near it must be to a known one.
OPPOSED, RATIO = 0.8, 0.15
#: Turn of the velocities against the positions that is said, rad (about grid north instead of true north).
TURNED = np.deg2rad(1.5)
#: Lags of the velocities behind the positions that are tried, s: all of the first, then those of the second about the best.
LAGS, NEARER = np.round(np.arange(-2.5, 2.55, 0.1), 1), 0.0125 * np.arange(-8, 9)
#: Gain in log-likelihood from which velocities lag, nats; shortest lag that is said, s; fewest steps of the positions. Right recordings and pieces of
#: them gain 9 nats at most (a real receiver 21); `python -m benchmarks.intake lags` counts what is found.
LAG_NATS, LATE_S, FEWEST_STEPS = 20.0, 0.1, 30
#: Decimals of a degree that are too few: four are steps of 11 m.
DECIMALS = range(2, 5)
#: Lowest dry land, m: heights below are negated, or of another unit.
LOWEST = -430.0
#: Held positions: shortest, s, and how far the velocities go meanwhile, m; a jump: m and times the scatter.
HELD_S, HELD_M, JUMP_M, JUMP_TIMES = 5.0, 10.0, 20.0, 15.0
#: Stretch over which positions are held against velocities for their scatter, s; stated standard deviations so many times that are said.
SLOW_S, TOO_LARGE, TOO_SMALL = 30.0, 20.0, 10.0


@dataclass(frozen=True)
class Agreement:
    """How velocities fit the motion of the positions: the best reading of both, and whether it is not the declared one.

    Parameters
    ----------
    scale, residual : float
        Of the declared reading: motion of the positions over the velocities, and the share of it that is left, as squares.
    best : str
    best_scale, best_residual : float
    climbing : float
        Changes of height over those that the velocities say; NaN where the heights hardly change otherwise than by their noise, or where the
        two do not go together.
    turn : float
        rad by which the velocities are turned clockwise against the positions; 0 where it is none that explains more.
    late : float
        s by which the velocities come late against the positions; 0 where no delay explains more.
    """

    scale: float
    residual: float
    best: str
    best_scale: float
    best_residual: float
    climbing: float = np.nan
    turn: float = 0.0
    late: float = 0.0


_READINGS: dict[str, Callable[[Array], Array]] = {
    "as declared": lambda v: v,
    "velocity=enu": lambda v: v[:, [1, 0, 2]] * [1.0, 1.0, -1.0],
    "latlon=west": lambda v: v * [1.0, -1.0, 1.0],
    "latlon=south": lambda v: v * [-1.0, 1.0, 1.0],
    "speed and course": lambda v: np.column_stack([v[:, 0] * np.cos(v[:, 1]), v[:, 0] * np.sin(v[:, 1]), v[:, 2]]),
    "speed and course in deg": lambda v: _READINGS["speed and course"](v * [1.0, np.pi / 180.0, 1.0]),
}


def agreement(gnss: GnssRecord) -> Agreement | None:
    """Hold the receiver's velocities against the motion of its positions; None where they hardly move."""
    own = velocity_track(gnss)
    if own is None:
        return None
    moved, swapped = positions_track(gnss), swapped_track(gnss)
    floor = 3.0 * float(scatter(gnss)[:2].max()) / moved.step
    out: dict[str, tuple[float, float]] = {}
    for name, read in _READINGS.items():
        out[name] = _fit(moved, own, read(own.velocity), floor)
    if swapped is not None:
        out["latlon=swapped"] = _fit(swapped, own, own.velocity, floor)
    if not out or not np.isfinite(out["as declared"][1]):
        return None
    # a reading and its negative leave the same: one that points backwards explains nothing
    best = min(out, key=lambda n: out[n][1] if out[n][0] > 0.0 else np.inf)
    declared = out["as declared"]
    turn, late = _turned(moved, own, declared[1]), velocity_lag(gnss)[0]
    return Agreement(*declared, best, *out[best], _climbing(gnss, own), turn, late)


def velocity_lag(gnss: GnssRecord) -> tuple[float, float]:
    """By how much velocities are late against the positions, s, and the share of their misfit that is left there; 0, 1 where nothing tells.

    The way between two positions is held against the integral of a spline through the velocities; the mean over the nearer nine tenths decides.
    """
    own, moved = velocity_track(gnss), positions_track(gnss)
    if own is None:
        return 0.0, 1.0
    edge = 0.5 * moved.span + LAGS[-1] + NEARER[-1]
    inside = (moved.t > own.t[0] + edge) & (moved.t < own.t[-1] - edge)
    if inside.sum() < FEWEST_STEPS:
        return 0.0, 1.0
    way = scipy.interpolate.CubicSpline(own.t, own.velocity[:, :2]).antiderivative()
    ends, there = moved.t[inside] + 0.5 * moved.span * np.array([[-1.0], [1.0]]), moved.velocity[inside, :2]

    def unexplained(lag: float) -> float:
        rest = np.sort(np.abs(there - np.diff(way(ends + lag), axis=0)[0] / moved.span), axis=None)
        return float(rest[: int(0.9 * rest.size)].mean())

    lag = min(min(LAGS, key=unexplained) + NEARER, key=unexplained)
    share = unexplained(lag) / max(unexplained(0.0), 1e-300)
    late = abs(lag) >= LATE_S and -there.size * np.log(max(share, 1e-300)) > LAG_NATS
    return (float(lag), share) if late else (0.0, 1.0)


def _turned(moved: Track, own: Track, unexplained: float) -> float:
    """Angle by which velocities are turned clockwise against the motion of the positions, rad; 0 where turning back explains little more."""
    a = moved.velocity[:, 0] + 1j * moved.velocity[:, 1]
    b = np.interp(moved.t, own.t, own.velocity[:, 0]) + 1j * np.interp(moved.t, own.t, own.velocity[:, 1])
    power = float(np.vdot(b, b).real)
    if power <= 0.0:
        return 0.0
    factor = complex(np.vdot(b, a)) / power
    rest = np.abs(a - factor * b) ** 2
    keep = rest <= np.quantile(rest, 0.95)
    turned = float(rest[keep].sum() / max(float((np.abs(a[keep]) ** 2).sum()), 1e-300))
    angle = -float(np.angle(factor))
    return angle if abs(angle) > TURNED and turned < 0.5 * unexplained else 0.0


def _climbing(gnss: GnssRecord, own: Track) -> float:
    """Correlation of changes of height over stretches with those that the velocities say, NaN where it tells nothing."""
    good = np.isfinite(gnss.llh).all(axis=1)
    t, h = gnss.t[good], gnss.llh[good, 2]
    if t.size < 9:
        return np.nan
    edges = t[every(t, CLIMB_S)]
    if edges.size < 9:
        return np.nan
    up = -own.velocity[:, 2]
    said = np.concatenate([[0.0], np.cumsum(0.5 * (up[1:] + up[:-1]) * np.diff(own.t))])
    seen, said = (np.diff(np.interp(edges, at, x)) for at, x in ((t, h), (own.t, said)))
    noise = max(1.0, 3.0 * float(scatter(gnss)[2]))
    if min(float(np.mean(seen**2)), float(np.mean(said**2))) < noise**2:
        return np.nan
    product, power = float(seen @ said), float(said @ said)
    both = product / float(np.sqrt(power * (seen @ seen)))
    return product / power if abs(both) > OPPOSED else np.nan


def _fit(moved: Track, own: Track, velocity: Array, floor: float) -> tuple[float, float]:
    """Scale of the positions' level motion on velocities, and the share of it that is left."""
    if moved.t.size < 8:
        return 1.0, np.nan
    b = np.column_stack([np.interp(moved.t, own.t, velocity[:, k]) for k in range(2)])
    a = moved.velocity[:, :2]
    power, have = float((a**2).sum()), float((b**2).sum())
    noise = max(1.0, floor)  # m/s: slower than that, noise is compared with noise
    if power < noise**2 * len(a):
        return 1.0, np.nan
    if have <= 0.0:
        return 0.0, 1.0
    scale = float((a * b).sum()) / have
    keep = np.abs(a - scale * b).max(axis=1)
    keep = keep <= max(float(np.quantile(keep, 0.95)), 1e-9)
    scale = float((a * b)[keep].sum()) / max(float((b**2)[keep].sum()), 1e-300)
    return scale, float(((a - scale * b)[keep] ** 2).sum() / max(float((a**2)[keep].sum()), 1e-300))


def swapped_track(gnss: GnssRecord) -> Track | None:
    """Velocities of positions whose latitude stands in the column of the longitude; None where it could not."""
    if not (np.abs(gnss.llh[:, 1][np.isfinite(gnss.llh[:, 1])]) <= np.pi / 2).all():
        return None
    return positions_track(GnssRecord(gnss.t, gnss.llh[:, [1, 0, 2]]))


_MEANT = {
    "velocity=enu": "the velocities are east, north, up",
    "latlon=swapped": "latitude and longitude are swapped",
    "latlon=west": "longitudes count west",
    "latlon=south": "latitudes count south",
    "speed and course": "the columns are speed and course (rad)",
    "speed and course in deg": "the columns are speed and course (deg)",
}
_SPEEDS = (
    (1852.0 / 3600.0, "knots"),
    (1.0 / 3.6, "km/h"),
    (0.44704, "mph"),
    (0.3048, "ft/s"),
    (1e-3, "mm/s"),
    (1e-2, "cm/s"),
)


def fixes(gnss: GnssRecord, found: Agreement | None, unstated: bool, opposite: float = 0.0) -> list[Line]:
    """Place, rate, order and unit of the positions; frame and unit of the velocities; standard deviations.

    Parameters
    ----------
    gnss : GnssRecord
    found : Agreement, optional
        Of :func:`agreement`.
    unstated : bool
        Whether the unit or the frame of the velocities was assumed because nobody states it.
    opposite : float
        As of :func:`heights`.
    """
    good = np.isfinite(gnss.llh).all(axis=1)
    llh = gnss.llh[good] * [180 / np.pi, 180 / np.pi, 1.0]
    if not len(llh):
        return [Line("fixes", "wrong", "no row holds a position")]
    lat, lon, h = np.median(llh, axis=0)
    dt = float(np.median(np.diff(gnss.t))) if len(gnss) > 1 else np.nan
    longest = float(np.diff(gnss.t).max()) if len(gnss) > 1 else 0.0
    text = f"{len(llh)} at {1 / dt:.3g} Hz about {abs(lat):.4f} {'NS'[int(lat < 0)]}, {abs(lon):.4f} {'EW'[int(lon < 0)]}, {h:.0f} m"
    text += f", the longest pause {longest:.3g} s" if longest > 3 * dt else ""
    out = [Line("fixes", "ok", text)]
    extent = np.abs(earth.position_difference(gnss.llh[good], np.median(gnss.llh[good], axis=0)))[:, :2].max()
    if abs(lat) < 1.58 and abs(lon) < 3.15 and (abs(lat) > 1e-3 or abs(lon) > 1e-3):
        if found is not None and near(found.scale, np.pi / 180, 0.1) and found.residual < 0.2:
            out.append(_radians(f"their motion is {1 / found.scale:.1f} times slower than their velocities"))
        else:
            where = f"all within {abs(lat):.2f}, {abs(lon):.2f} deg: radians read as degrees, or really off Ghana"
            out.append(Line("fixes", "odd", where, '--map "pos_unit=rad"'))
    elif not -500.0 < h < 2.0e4:
        out.append(Line("fixes", "odd", f"a height of {h:.4g} m; is it in mm or km?"))
    moved = positions_track(gnss)
    jumps = int((np.linalg.norm(moved.velocity[:, :2], axis=1) > 1000.0).sum())
    if jumps:
        out.append(Line("fixes", "odd", f"{jumps} step(s) faster than 1000 m/s over {extent / 1e3:.4g} km"))
    out.extend(_rounded(gnss, llh))
    out.extend(_velocities(gnss, found, unstated))
    out.extend(heights(gnss, found, opposite))
    out.extend(steps(gnss))
    out.extend(_spreads(gnss))
    return out


def _rounded(gnss: GnssRecord, llh: Array) -> list[Line]:
    """Latitudes and longitudes that are written with too few decimals for what the fixes are worth."""
    level = llh[:, :2]
    exact = (d for d in DECIMALS if np.abs(level * 10.0**d - np.round(level * 10.0**d)).max() < 1e-6)
    decimals = next(exact, None)
    if decimals is None or len(np.unique(level, axis=0)) == 1:
        return []
    step = float(np.deg2rad(10.0**-decimals)) * earth.A
    known = np.empty(0) if gnss.pos_std_ned is None else gnss.pos_std_ned[:, :2][np.isfinite(gnss.pos_std_ned[:, :2])]
    stated = float(np.median(known)) if known.size else 0.0
    if step / np.sqrt(12.0) < stated:
        return []
    return [Line("fixes", "odd", f"latitude and longitude have {decimals} decimals of a degree: steps of {step:.2g} m")]


def _radians(evidence: str) -> Line:
    return Line("fixes", "wrong", f"{evidence}: latitude and longitude are in rad, not deg", '--map "pos_unit=rad"')


def _velocities(gnss: GnssRecord, found: Agreement | None, unstated: bool) -> list[Line]:
    if gnss.vel_ned is None:
        return [Line("velocity", "ok", "the fixes have positions only")]
    if found is None:
        return [
            Line(
                "velocity",
                "assumed" if unstated else "ok",
                "north, east, down; too little motion to hold it against the positions",
            )
        ]
    off = f"they differ by {100 * np.sqrt(found.residual):.0f} % of the motion of the positions"
    if found.best != "as declared" and found.best_residual < 0.3 * found.residual and found.residual > 0.1:
        what = _MEANT[found.best]
        if near(found.best_scale, 1.0, NEAR):
            text = f"{off}, as declared, and by {100 * np.sqrt(found.best_residual):.0f} % if {what}"
            return [Line("velocity", "wrong", text, f'--map "{found.best}"' if "=" in found.best else "")]
    if found.residual < 0.2 and not near(found.scale, 1.0, NEAR):
        for factor, unit in _SPEEDS:
            if near(found.scale, factor, 0.08):
                text = f"the positions move {found.scale:.4g} times the velocities: they are in {unit}"
                return [Line("velocity", "wrong", text, f'--map "vel_unit={unit}"')]
        return [Line("velocity", "odd", f"the positions move {found.scale:.4g} times the velocities")]
    if found.turn:
        angle = f"{np.rad2deg(found.turn):+.1f} deg"
        text = f"the velocities are turned by {angle} against the motion of the positions: about another north (grid, magnetic)?"
        return [Line("velocity", "odd", text)]
    if found.late:
        word = "late" if found.late > 0.0 else "early"
        return [
            Line("velocity", "odd", f"the velocities come {abs(found.late):.2f} s {word} against the positions: {off}")
        ]
    if found.scale == 0.0:
        return [Line("velocity", "odd", "the velocities are zero while the positions move")]
    level: Level = "ok" if found.residual < 0.3 else "odd"
    word = "agrees" if level == "ok" else "does not agree"
    return [Line("velocity", level, f"it {word} with the positions: {off}")]


def heights(gnss: GnssRecord, found: Agreement | None, opposite: float) -> list[Line]:
    """Sign and unit of the heights, against the vertical velocity.

    Parameters
    ----------
    gnss : GnssRecord
    found : Agreement, optional
        Of :func:`agreement`.
    opposite : float
        Nats that the IMU gives to the declared vertical velocity over its opposite.
    """
    h = float(np.nanmedian(gnss.llh[:, 2]))
    ratio = np.nan if found is None or found.residual > 0.3 else found.climbing
    if np.isnan(ratio):
        if h < LOWEST:
            return [Line("heights", "odd", f"a height of {h:.4g} m is below any land: negated, or in another unit?")]
        return [
            Line(
                "heights", "assumed", "not checkable: nothing climbs enough to hold heights against vertical velocities"
            )
        ]
    if near(ratio, 1.0, RATIO):
        return [Line("heights", "ok", f"they change by {ratio:.2f} of what the vertical velocities say")]
    if near(-ratio, 1.0, RATIO):
        text = "the heights rise where the declared velocities point down"
        if h < LOWEST or opposite > SIGN_NATS:
            return [Line("heights", "wrong", f"{text}: the heights are negated", '--map "height_unit=-1 m"')]
        if opposite < -SIGN_NATS:
            return [Line("heights", "wrong", f"{text}: the third component is up", '--map "velocity=neu"')]
        return [
            Line(
                "heights",
                "wrong",
                f"{text}: the third component is up, or the heights are negated",
                '--map "velocity=neu"' if h > 0.0 else "",
            )
        ]
    for factor, unit in ((1.0 / 0.3048, "ft"), (1e3, "mm"), (1e2, "cm"), (1e-3, "km")):
        if near(ratio, factor, RATIO):
            return [
                Line(
                    "heights",
                    "wrong",
                    f"they change {ratio:.3g} times as much as the vertical velocities say: they are in {unit}",
                    f'--map "height_unit={unit}"',
                )
            ]
    return [Line("heights", "odd", f"they change {ratio:.3g} times as much as the vertical velocities say")]


def steps(gnss: GnssRecord) -> list[Line]:
    """Positions that stay the same while the receiver's velocities go on, and jumps that no velocity explains."""
    own = velocity_track(gnss)
    good = np.isfinite(gnss.llh).all(axis=1)
    t, llh = gnss.t[good], gnss.llh[good]
    if t.size < 9:
        return []
    moved, dt = earth.position_difference(llh[1:], llh[:-1])[:, :2], np.diff(t)
    if own is not None:
        sums = np.vstack(
            [
                np.zeros(2),
                np.cumsum(0.5 * (own.velocity[1:, :2] + own.velocity[:-1, :2]) * np.diff(own.t)[:, None], axis=0),
            ]
        )
        said = np.diff(np.column_stack([np.interp(t, own.t, c) for c in sums.T]), axis=0)
    else:  # as fast as just before and after
        speed = moved / dt[:, None]
        said = np.median([np.roll(speed, k, axis=0) for k in (-3, -2, -1, 1, 2, 3)], axis=0) * dt[:, None]
    out = []
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (moved == 0.0).all(axis=1).astype(int), [0]])))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        far = float(np.linalg.norm(said[first:last].sum(axis=0)))
        if t[last] - t[first] > HELD_S and far > HELD_M:
            text = f"the positions stay the same for {t[last] - t[first]:.3g} s, {t[first]:.4g} s after the start, {far:.3g} m by the velocities"
            out.append(Line("fixes", "odd", text))
            break
    off = np.linalg.norm(moved - said, axis=1)
    usual = 1.4826 * float(np.median(off))
    # two velocities say where a vehicle of one g is between them to G dt^2 / 8: over a gap nothing
    off = np.maximum(off - 0.125 * G * dt**2, 0.0)
    k = int(np.argmax(off))
    if off[k] > max(JUMP_M, JUMP_TIMES * usual, 0.5 * float(np.linalg.norm(said[k]))) and not out:
        out.append(
            Line(
                "fixes",
                "odd",
                f"the positions jump by {off[k]:.4g} m, {t[k + 1]:.5g} s after the start, and no velocity explains it",
            )
        )
    return out


def slow_scatter(gnss: GnssRecord) -> float:
    """Scatter of the positions against the receiver's velocities over :data:`SLOW_S`, m; NaN without velocities."""
    own = velocity_track(gnss)
    good = np.isfinite(gnss.llh).all(axis=1)
    if own is None or good.sum() < 20:
        return np.nan
    t, llh = gnss.t[good], gnss.llh[good]
    place = earth.position_difference(llh, llh[0])[:, :2]
    sums = np.vstack(
        [np.zeros(2), np.cumsum(0.5 * (own.velocity[1:, :2] + own.velocity[:-1, :2]) * np.diff(own.t)[:, None], axis=0)]
    )
    rest = place - np.column_stack([np.interp(t, own.t, c) for c in sums.T])
    edges = every(t, SLOW_S)
    spread = [float(rest[a:b].std(axis=0).max()) for a, b in itertools.pairwise(edges) if b - a > 4]
    return float(np.median(spread)) if spread else np.nan


def _spreads(gnss: GnssRecord) -> list[Line]:
    if gnss.pos_std_ned is None:
        spread = scatter(gnss)
        if not spread.any():
            said = "the fixes state no standard deviations; the scenario's gnss.position_sigma is taken"
            return [Line("sigma", "assumed", said)]
        return [
            Line("sigma", "assumed",
                 f"the fixes state no standard deviations; from one to the next they scatter by {spread[:2].max():.2g} m level and "
                 f"{spread[2]:.2g} m in height, and slow errors come on top: give gnss.position_sigma, no less than that")
        ]  # fmt: skip
    spread = np.nanmedian(gnss.pos_std_ned, axis=0)
    said = f"stated standard deviations of {spread[:2].max():.3g} m level, {spread[2]:.3g} m in height (median)"
    slow, fast = slow_scatter(gnss), float(scatter(gnss)[:2].max())
    seen = max(slow, fast) if np.isfinite(slow) else fast
    if spread.max() > 200.0 or spread.min() < 5e-4:
        return [Line("sigma", "odd", said)]
    if np.isfinite(slow) and spread[:2].max() > TOO_LARGE * max(seen, 0.01):
        return [
            Line(
                "sigma",
                "odd",
                f"{said}, {spread[:2].max() / max(seen, 0.01):.0f} times what they scatter by against their velocities ({seen:.2g} m)",
            )
        ]
    if fast > TOO_SMALL * spread[:2].max():
        return [Line("sigma", "odd", f"{said}, and from one to the next they scatter by {fast:.2g} m")]
    if not np.isfinite(slow):
        said += "; not checkable whether they are too large: slow errors cannot be seen without velocities"
        return [Line("sigma", "assumed", said)]
    return [Line("sigma", "ok", f"{said}; they scatter by {seen:.2g} m against their velocities in {SLOW_S:.0f} s")]
