"""How long one identification takes, in units of one run of the nominal filter in the same process."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np

from insemu.effects import EffectUse
from insemu.emulate import built_in, corrupt, gnss_fixes, ideal_imu
from insemu.formats import read_static
from insemu.gap import Nominal, find_gap, find_static_gap
from insemu.gap.drive.preparation import fast_parts, prepare
from insemu.noise import GM, RW, WN, NoiseModel
from insemu.records import AXES, Recording, Series
from insemu.scenario import Gnss, Initial

BELIEF = {a: NoiseModel((WN(1e-4), RW(1e-6)) if a.startswith("gyro") else (WN(1e-3), RW(1e-5))) for a in AXES}
#: A real log of the shared data folder, and a belief of the usual size of such a sensor.
REAL = "real/adis16405_static_run1.npz"
AT_REST = {a: NoiseModel((WN(6e-4), RW(1e-6)) if a.startswith("gyro") else (WN(2e-3), RW(3e-5))) for a in AXES}


def main() -> None:
    rng = np.random.default_rng(1)
    made = ideal_imu(built_in("helicopter_mapping"), 100.0)
    effect = EffectUse.from_mapping({"effect": "lever_arm", "value": [0.2, 0, 0]})
    imu = corrupt(made.imu, BELIEF, rng, reference=made.reference).imu
    fixes = gnss_fixes(made.reference, 1.0, 0.05, 0.05, rng=rng, effects=[effect])
    recording = Recording(imu, fixes, made.reference)
    nominal = Nominal(
        BELIEF,
        Gnss(position_sigma=(0.05,) * 3, velocity_sigma=(0.05,) * 3),
        Initial(tilt_sigma=0.005, heading_sigma=0.01),
    )
    prepared = prepare(recording, nominal, fast_parts(recording, nominal), {})  # compiles
    find_gap(recording, nominal, rng=rng, hold_out=False)
    filter_s = prepared.again().result.seconds
    rows = []
    for label, hold_out in (("drive, 20 min at 100 Hz", False), ("the same with held-out scoring", True)):
        start = time.perf_counter()
        find_gap(recording, nominal, rng=rng, hold_out=hold_out)
        rows.append((label, time.perf_counter() - start))
    log = [Series(WN(1e-3).simulate(72_000, 0.05, rng), 20.0, "rad/s", a) for a in AXES[:3]]
    start = time.perf_counter()
    find_static_gap(log, {a: NoiseModel((WN(1e-3),)) for a in AXES[:3]}, rng=rng, hold_out=False)
    rows.append(("static, 1 h at 20 Hz, three axes", time.perf_counter() - start))
    truth = WN(1e-3) + GM(2e-4, 0.01) + RW(1e-6)
    log = [
        Series(truth.simulate(1_000_000, 0.01, rng), 100.0, "rad/s" if a.startswith("gyro") else "m/s^2", a)
        for a in AXES
    ]
    start = time.perf_counter()
    find_static_gap(log, {a: NoiseModel((WN(1e-3),)) for a in AXES}, rng=rng)
    rows.append(("static, 2.8 h at 100 Hz, six axes, held out", time.perf_counter() - start))
    real = Path(os.environ.get("INSEMU_SHARED", Path(__file__).resolve().parents[2] / "shared")) / REAL
    if real.exists():
        log = list(read_static(real, columns=list(AXES)))
        start = time.perf_counter()
        find_static_gap(log, AT_REST, rng=rng)
        rows.append(("the same of an ADIS16405, coarse and drifting", time.perf_counter() - start))
    else:
        print(f"absent: {REAL} (set INSEMU_SHARED)")
    print(f"one run of the nominal filter: {filter_s:.3f} s\n")
    print(f"{'identification':46s} {'seconds':>8s} {'filter runs':>12s}")
    for label, seconds in rows:
        print(f"{label:46s} {seconds:8.2f} {seconds / filter_s:12.0f}")


if __name__ == "__main__":
    main()
