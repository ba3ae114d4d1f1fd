"""Faults of time too large for a linear signature, found by flying the nominal filter with other stamps.

A tenth of a second is too much for a linear signature, and what it leaves in the innovations is so strong and so slow that coloured noise seems
to explain it. The innovations' likelihood, their level free, needs no linear signature. Receivers whose velocities are means over the time before
the stamp have two faults at once: positions and velocities ask for different offsets. The lag of the velocities follows from its signature at
every offset that is flown.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import scipy  # whose parts are imported when they are used

from insemu.effects import EFFECTS, FixGeometry
from insemu.gap.drive.preparation import Flown, Prepared
from insemu.gap.drive.signatures import Loop, columns_response
from insemu.gap.policy import rules
from insemu.gap.verdict import Finding, Member, Value
from insemu.records import Recording

#: Time offset that is tried first, s; it is doubled as long as that helps.
FIRST_S = 0.06
#: Step of the parabola that tells how wide the likelihood's top is, s.
WIDTH_S = 0.01
#: How often what the signature of the lag leaves is looked for again, at the most.
MOST_LAGS = 4
OFFSET, LAG = "imu_gnss_time_offset", "gnss_velocity_lag"


@dataclass(frozen=True)
class _Tried:
    """One offset flown.

    Parameters
    ----------
    plain, lagged : float
        Log-likelihood with free level, without and with a lag of the velocities.
    square, square_lagged : float
        Mean square of the normalised innovations.
    lag, sd : float
        The lag that explains most there and its standard deviation, s.
    """

    plain: float
    lagged: float
    square: float
    square_lagged: float
    lag: float = 0.0
    sd: float = 0.0

    @property
    def has_lag(self) -> bool:
        """Whether the lag is worth what a large offset must be worth."""
        return self.lagged > self.plain + rules().offset_nats

    @property
    def score(self) -> float:
        """Log-likelihood, a lag paid for."""
        return max(self.plain, self.lagged - rules().offset_nats)

    @property
    def remaining(self) -> float:
        """Mean square that is left."""
        return self.square_lagged if self.has_lag else self.square


def find_times(
    start: Flown, without: Collection[str] = (), progress: Callable[[str], None] = lambda _: None
) -> list[Finding]:
    """Weigh a large time offset, and next to it a lag of the velocities; empty where there is none.

    Parameters
    ----------
    start : Flown
        The nominal filter on the recording as it is.
    without : collection of str
        Effects taken out of the catalogue.
    progress : callable
        Told what is being done.
    """
    known: dict[float, _Tried] = {}
    lags = LAG not in without

    def flown(offset: float) -> _Tried:
        if offset not in known:
            progress(f"time offset {1e3 * offset:.0f} ms")
            known[offset] = _tried(
                start.prepared.shifted(_with_stamps(start.recording, offset)) if offset else start.prepared, lags
            )
        return known[offset]

    base = flown(0.0)
    if OFFSET in without or base.square < rules().offset_nis:
        return []
    sides = {s: flown(s * FIRST_S).score for s in (-1.0, 1.0)}
    side = max(sides, key=lambda s: sides[s])
    if sides[side] < base.score + rules().offset_nats:
        return []
    at, top = side * FIRST_S, sides[side]
    while abs(at) < rules().offset_largest_s:  # uphill as long as it goes uphill
        further = flown(2.0 * at).score
        if further < top:
            break
        at, top = 2.0 * at, further
    low, high = sorted((0.25 * at, 2.0 * at))
    found = scipy.optimize.minimize_scalar(
        lambda x: -flown(float(x)).score, bounds=(low, high), method="bounded", options={"xatol": 4e-3}
    )
    offset = max(known, key=lambda k: known[k].score)
    best = known[offset]
    gain = best.score - base.score
    small = abs(offset) < rules().offset_least_s or gain < rules().offset_nats
    if small or best.remaining > rules().offset_share * base.square or not found.success:
        return []
    h = WIDTH_S
    bend = -(flown(offset + h).score - 2.0 * best.score + flown(offset - h).score) / h**2
    out = [_finding(OFFSET, "imu", "offset", (offset, 1.0 / math.sqrt(bend) if bend > 0.0 else h), gain)]
    if best.has_lag:
        lag, left = best.lag, best
        for _ in range(MOST_LAGS):  # the signature is linear: what it leaves is looked for again
            progress(f"lag of the velocities {1e3 * lag:.0f} ms")
            left = _tried(start.prepared.shifted(_with_stamps(start.recording, offset, lag)), lags)
            lag += left.lag
            if abs(left.lag) < left.sd:
                break
        out.append(_finding(LAG, "gnss", "lag", (lag, left.sd), best.lagged - best.plain))
    return out


def _with_stamps(recording: Recording, offset: float, lag: float = 0.0) -> Recording:
    """A recording with the stamps of the IMU and of the velocities put right, s."""
    gnss = recording.gnss
    assert gnss is not None
    imu = replace(recording.imu, t=recording.imu.t - offset)
    return replace(recording, imu=imu, gnss=gnss.with_velocities_at(gnss.t - lag) if lag else gnss)


def _finding(effect: str, sensor: str, name: str, estimate: tuple[float, float], gain: float) -> Finding:
    value = Value.normal(name, *estimate, "s")
    return Finding(
        effect, "", sensor, (), (value,), 1.0 - math.exp(-min(gain, 30.0)), gain, (Member(effect, sensor, (), gain),)
    )


def _tried(prepared: Prepared, with_lag: bool) -> _Tried:
    """The likelihood of a run with its level free, and what a lag of the velocities explains of it."""
    fixes = prepared.result.fixes
    loop = Loop.of(prepared.result)
    dof, total, volume = int(loop.use.sum()), float(loop.y @ loop.y), 2.0 * loop.half_log_det()
    plain = -0.5 * (dof * math.log(total / dof) + volume)
    if not with_lag or not loop.use[:, 3:].any():
        return _Tried(plain, -math.inf, total / dof, total / dof)
    motion = prepared.motion
    at = FixGeometry.of(motion, fixes.t, prepared.lever_arm, prepared.nominal.mounting)
    g = loop.whiten(columns_response(loop, motion, EFFECTS[LAG].columns(motion, at)))[:, 0]
    size = float(g @ g)
    if not size > 0.0:
        return _Tried(plain, -math.inf, total / dof, total / dof)
    lag = float(g @ loop.y) / size
    left = total - size * lag**2
    lagged = -0.5 * (dof * math.log(left / dof) + volume)
    return _Tried(plain, lagged, total / dof, left / dof, lag, math.sqrt(left / dof / size))
