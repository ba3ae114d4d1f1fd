"""A large time offset between IMU and GNSS, found by flying the nominal filter with other stamps.

A tenth of a second is too much for a linear signature, and what it leaves in the innovations is so strong and so slow that coloured noise seems
to explain it. The innovations' likelihood, their level free, needs no linear signature.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from insemu.gap.drive.preparation import Flown, prepare
from insemu.gap.policy import rules
from insemu.gap.verdict import Finding, Member, Value

#: Time offset that is tried first, s; it is doubled as long as that helps.
FIRST_S = 0.06


def find_offset(start: Flown, progress: Callable[[str], None] = lambda _: None) -> Finding | None:
    """Weigh a large time offset; ``None`` where there is none."""
    recording = start.recording
    known: dict[float, tuple[float, float]] = {}

    def flown(offset: float) -> tuple[float, float]:
        """Log-likelihood with free level, and mean square of the normalised innovations."""
        if offset not in known:
            progress(f"time offset {1e3 * offset:.0f} ms")
            if offset:
                moved = replace(recording, imu=replace(recording.imu, t=recording.imu.t - offset))
                fixes = prepare(moved, start.nominal, start.fast, {}).result.fixes
            else:
                fixes = start.prepared.result.fixes
            use = fixes.accepted & np.isfinite(fixes.nis)
            mean = float(fixes.nis[use].sum() / max(1, fixes.dof[use].sum()))
            volume = 0.0
            for S, nu in zip(fixes.S[use], fixes.innovation[use], strict=True):
                rows = np.isfinite(nu)
                volume += float(np.linalg.slogdet(S[np.ix_(rows, rows)])[1])
            known[offset] = (-0.5 * (int(fixes.dof[use].sum()) * math.log(mean) + volume), mean)
        return known[offset]

    base, square = flown(0.0)
    if square < rules().offset_nis:
        return None
    step = FIRST_S
    sides = {s: flown(s * step)[0] for s in (-1.0, 1.0)}
    side = max(sides, key=lambda s: sides[s])
    if sides[side] < base + rules().offset_nats:
        return None
    at, top = side * step, sides[side]
    while abs(at) < rules().offset_largest_s:  # uphill as long as it goes uphill
        further = flown(2.0 * at)[0]
        if further < top:
            break
        at, top = 2.0 * at, further
    low, high = sorted((0.25 * at, 2.0 * at))
    found = minimize_scalar(
        lambda x: -flown(float(x))[0], bounds=(low, high), method="bounded", options={"xatol": 1e-3}
    )
    offset = max(known, key=lambda k: known[k][0])
    gain = known[offset][0] - base
    if (
        abs(offset) < rules().offset_least_s
        or gain < rules().offset_nats
        or known[offset][1] > rules().offset_share * square
        or not found.success
    ):
        return None
    # width of the likelihood's top, from the parabola through its neighbours
    h = 0.005
    bend = -(flown(offset + h)[0] - 2.0 * flown(offset)[0] + flown(offset - h)[0]) / h**2
    sd = 1.0 / math.sqrt(bend) if bend > 0.0 else h
    value = Value.normal("offset", offset, sd, "s")
    member = Member("imu_gnss_time_offset", "imu", (), gain)
    return Finding("imu_gnss_time_offset", "", "imu", (), (value,), 1.0 - math.exp(-min(gain, 30.0)), gain, (member,))
