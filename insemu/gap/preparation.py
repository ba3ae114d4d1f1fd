"""From a recording to the nominal filter's innovations: a starting state, noise levels trimmed inside their tolerance, the stored run."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.errors import InputError
from insemu.filters import FilterOptions, FilterResult, InitialSigma, run_filter
from insemu.gap.evidence import LEVEL_UNCERTAINTY, Explanation, Likelihood, fit
from insemu.gap.nominal import Nominal
from insemu.gap.reduced import Reduced, moving_spectrum
from insemu.gap.surrogate import Surrogate
from insemu.noise import WN, NoiseModel
from insemu.records import AXES, GnssRecord, ImuRecord, Recording
from insemu.strapdown import NavState

Array = NDArray[np.float64]

#: Lowest frequency in Hz at which a moving IMU shows its noise rather than its motion.
MOTION_HZ = 8.0
#: Knots of slow processes are this many seconds apart.
NODE_S = 10.0
#: Below this speed a track says nothing about the heading, m/s.
TRACK_SPEED = 3.0


@dataclass(frozen=True)
class Prepared:
    """The nominal filter on a recording.

    Parameters
    ----------
    imu, gnss : records, cut to where the filter could start
    result : FilterResult
        With every epoch and every fix stored.
    beliefs : mapping of axis to NoiseModel
        Levels trimmed inside their tolerance.
    fast : mapping of axis to Reduced
        The part of each axis above the motion.
    lever_arm : (3,) array
    factors : (6,) array
        By what the standard deviations of the fixes were trimmed.
    """

    imu: ImuRecord
    gnss: GnssRecord
    result: FilterResult
    beliefs: dict[str, NoiseModel]
    fast: dict[str, Reduced]
    lever_arm: Array
    factors: Array
    start: tuple[NavState, InitialSigma]

    def again(self, gnss: GnssRecord) -> Prepared:
        """The same filter on other fixes."""
        result = run_filter(
            self.imu,
            gnss,
            *self.start,
            self.beliefs,
            lever_arm=self.lever_arm,
            options=FilterOptions(store="fixes", node_every=NODE_S),
        )
        return replace(self, gnss=gnss, result=result)

    def with_levels(self, factors: Array) -> Prepared:
        """The same filter with other standard deviations of the fixes."""
        return self.again(scaled_fixes(self.gnss, factors))

    def without_positions(self, t: Array) -> Prepared:
        """The same filter without the positions of some fixes."""
        llh = self.gnss.llh.copy()
        llh[np.isin(self.gnss.t, t)] = np.nan
        return self.again(replace(self.gnss, llh=llh))


def fast_parts(recording: Recording) -> dict[str, Reduced]:
    """What each axis shows above the motion."""
    return {name: _fast_part(recording.imu, k, name) for k, name in enumerate(AXES)}


def prepare(recording: Recording, nominal: Nominal, fast: dict[str, Reduced], levels: dict[str, float]) -> Prepared:
    """Run the nominal filter, its white noise and GNSS levels trimmed by at most the tolerance of a nominal level.

    Parameters
    ----------
    fast : mapping of axis to Reduced
        From :func:`fast_parts`.
    levels : mapping of axis to float
        White-noise densities that were named as an effect and are used as they are.

    Raises
    ------
    InputError
        No fixes, a missing belief, too short a recording, or no way to start.
    """
    assert recording.gnss is not None
    imu, gnss, initial = starting_state(recording)
    if imu.t[-1] - imu.t[0] < 60.0:
        raise InputError(
            f"the recording has {imu.t[-1] - imu.t[0]:.0f} s that can be used, expected at least 60 s",
            where=recording.source,
        )
    gnss = with_sigma(gnss, nominal)
    beliefs = {name: _trimmed(nominal.beliefs[name], fast[name], levels.get(name)) for name in AXES}
    sigma = nominal.initial
    start = InitialSigma(
        sigma.position_sigma, sigma.velocity_sigma, (sigma.tilt_sigma, sigma.tilt_sigma, sigma.heading_sigma)
    )
    lever = np.array(nominal.gnss.lever_arm)
    options = FilterOptions(store="fixes", node_every=NODE_S)

    def run(fixes: GnssRecord) -> FilterResult:
        return run_filter(imu, fixes, initial, start, beliefs, lever_arm=lever, options=options)

    result = run(gnss)
    factors = _level_factors(Surrogate.of(result))
    if np.max(np.abs(np.log(factors))) > 0.02:
        gnss = scaled_fixes(gnss, factors)
        result = run(gnss)
    return Prepared(imu, gnss, result, beliefs, fast, lever, factors, (initial, start))


def starting_state(recording: Recording) -> tuple[ImuRecord, GnssRecord, NavState]:
    """Where the filter starts: on the reference where there is one, else levelled, on the fixes, headed along the track.

    Without a reference the recording is cut to begin where the speed over ground first tells the heading.
    """
    imu, gnss = recording.imu, recording.gnss
    assert gnss is not None
    if recording.reference is not None:
        ref = recording.reference
        first = int(np.searchsorted(imu.t, max(imu.t[0], ref.t[0])))
        imu = _cut(imu, first)
        columns = np.hstack([ref.llh, ref.vel_ned, np.unwrap(ref.rpy, axis=0)])
        at = np.array([np.interp(imu.t[0], ref.t, column) for column in columns.T])
        return imu, gnss, NavState(at[:3], at[3:6], at[6:])
    if gnss.vel_ned is None:
        raise InputError(
            "the recording has neither a reference nor GNSS velocities, expected one of them to start the filter",
            where=recording.source,
        )
    inside = (gnss.t > imu.t[0] + 1.0) & (gnss.t < imu.t[-1] - 60.0)
    good = inside & np.isfinite(gnss.vel_ned).all(axis=1) & np.isfinite(gnss.llh).all(axis=1)
    speed = np.hypot(gnss.vel_ned[:, 0], gnss.vel_ned[:, 1])
    moving = np.flatnonzero(good & (speed > TRACK_SPEED))
    if not moving.size:
        raise InputError(
            f"never moves faster than {TRACK_SPEED:g} m/s over ground, expected a stretch that tells the heading",
            where=recording.source,
        )
    k = int(moving[0])
    first = int(np.searchsorted(imu.t, gnss.t[k]))
    imu = _cut(imu, first)
    span = imu.as_increments()
    count = max(2, int(0.5 / imu.dt))
    near = np.flatnonzero(good & (np.abs(gnss.t - gnss.t[k]) < 1.1))
    slope = np.polyfit(gnss.t[near] - gnss.t[k], gnss.vel_ned[near], 1)[0] if near.size > 1 else np.zeros(3)
    force = span.accel[1:count].mean(axis=0) / imu.dt
    heading = float(np.arctan2(gnss.vel_ned[k, 1], gnss.vel_ned[k, 0]))
    along = float(slope[0] * np.cos(heading) + slope[1] * np.sin(heading))
    across = float(-slope[0] * np.sin(heading) + slope[1] * np.cos(heading))
    g = float(earth.gravity(gnss.llh[k, 0], gnss.llh[k, 2]))
    level = force - np.array([along, across, 0.0])
    roll, pitch = float(np.arctan2(-level[1], -level[2])), float(np.arcsin(np.clip(level[0] / g, -1.0, 1.0)))
    return imu, gnss, NavState(gnss.llh[k], gnss.vel_ned[k], np.array([roll, pitch, heading]))


def _cut(imu: ImuRecord, first: int) -> ImuRecord:
    if first == 0:
        return imu
    temperature = None if imu.temperature is None else imu.temperature[first:]
    return replace(imu, t=imu.t[first:], gyro=imu.gyro[first:], accel=imu.accel[first:], temperature=temperature)


def with_sigma(gnss: GnssRecord, nominal: Nominal) -> GnssRecord:
    """The fixes with the believed standard deviations where they state none; velocities that are not believed are left out."""
    n = len(gnss)
    out = gnss
    if nominal.gnss.velocity_sigma is None:
        out = replace(out, vel_ned=None, vel_std_ned=None)
    elif out.vel_ned is not None and out.vel_std_ned is None:
        out = replace(out, vel_std_ned=np.tile(nominal.gnss.velocity_sigma, (n, 1)))
    if out.pos_std_ned is None:
        out = replace(out, pos_std_ned=np.tile(nominal.gnss.position_sigma, (n, 1)))
    return out


def scaled_fixes(gnss: GnssRecord, factors: Array) -> GnssRecord:
    """Fixes with other standard deviations: position, then velocity, north, east, down."""
    assert gnss.pos_std_ned is not None
    out = replace(gnss, pos_std_ned=gnss.pos_std_ned * factors[:3])
    return replace(out, vel_std_ned=out.vel_std_ned * factors[3:]) if out.vel_std_ned is not None else out


def _fast_part(imu: ImuRecord, k: int, name: str) -> Reduced:
    values = np.hstack([imu.gyro, imu.accel])[:, k]
    dt = imu.dt
    if imu.kind == "increment":
        values = values / dt
    values = values[1:]
    lowest = min(MOTION_HZ, 0.5 * 0.5 / dt)
    f, power, dof = moving_spectrum(values, dt, lowest)
    return Reduced(name, "rad/s" if k < 3 else "m/s^2", dt, values, 1, np.zeros(0), f, power, dof)


def _trimmed(model: NoiseModel, fast: Reduced, named: float | None) -> NoiseModel:
    """White noise at the level of the fast part, inside the tolerance."""
    whites = [p for p in model if isinstance(p, WN)]
    if not whites or not fast.f.size:
        return model
    if named is not None:
        return NoiseModel(tuple(WN(named) if p is whites[0] else p for p in model))
    fitted = fit(Likelihood(fast), Explanation.nominal(model)).explanation.model
    seen = next(p for p in fitted if isinstance(p, WN)).parameters["N"]
    n0 = whites[0].parameters["N"]
    level = float(np.clip(seen, n0 / (1.0 + LEVEL_UNCERTAINTY), n0 * (1.0 + LEVEL_UNCERTAINTY)))
    return NoiseModel(tuple(WN(level) if p is whites[0] else p for p in model))


def _level_factors(surrogate: Surrogate) -> Array:
    """Most likely levels of the fixes inside the tolerance: horizontal and vertical position, horizontal and vertical velocity."""
    factors = np.ones(6)
    grid = np.exp(np.linspace(-1.0, 1.0, 5) * np.log(1.0 + LEVEL_UNCERTAINTY))
    for rows in ((0, 1), (2,), (3, 4), (5,)):
        if not surrogate.use[:, rows].any():
            continue
        logs = []
        for level in grid:
            trial = factors.copy()
            trial[list(rows)] = level
            logs.append(surrogate.log_likelihood(trial))
        curve = np.polyfit(np.log(grid), logs, 2)
        best = -0.5 * curve[1] / curve[0] if curve[0] < 0 else np.log(grid[int(np.argmax(logs))])
        factors[list(rows)] = np.exp(np.clip(best, np.log(grid[0]), np.log(grid[-1])))
    return factors
