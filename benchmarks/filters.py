"""Speed of the compiled filter: IMU epochs per second at full covariance rate, mechanization and 1 Hz updates included.

Run ``python benchmarks/filters.py``. Seconds are CPU time of this process on one core, warm, the best of several runs; the peer is the same
filter on filterpy (:mod:`insemu.filters.reference`) in the same run.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from insemu.filters import FilterOptions, LooselyCoupledEKF
from insemu.filters.reference import reference_run
from insemu.records import GnssRecord, ImuRecord
from tests import filter_cases as cases

MINIMUM = {15: 800_000, 24: 500_000}


def cpu(work: Callable[[], object], repeats: int) -> float:
    """Least CPU seconds of several calls."""
    best = np.inf
    for _ in range(repeats):
        started = time.process_time()
        work()
        best = min(best, time.process_time() - started)
    return best


def main() -> None:
    seconds, short = 300.0, 10.0
    road = cases.drive(seconds)
    print(f"{'states':>6}  {'epochs/s':>10}  {'asked':>10}  {'filterpy epochs/s':>17}  {'ratio':>7}")
    for model in (cases.MODEL_15, cases.MODEL_24, cases.MODEL_27):
        rng = np.random.default_rng(1)
        imu, start = cases.corrupt(road.imu, model, rng), cases.start(road, rng)
        gnss = cases.fixes(road, rng)
        ekf = LooselyCoupledEKF(model, cases.DT, options=FilterOptions(output_every=100))
        ekf.run(imu, gnss, start, cases.START_SIGMA)  # compiles
        ours = (len(imu) - 1) / cpu(lambda: ekf.run(imu, gnss, start, cases.START_SIGMA), 20)  # noqa: B023
        n = round(short * cases.RATE) + 1
        few = ImuRecord(imu.t[:n], imu.gyro[:n], imu.accel[:n], kind="increment")
        early = gnss.t <= short
        some = GnssRecord(*(getattr(gnss, k)[early] for k in ("t", "llh", "vel_ned", "pos_std_ned", "vel_std_ned")))
        peer = (n - 1) / cpu(lambda: reference_run(ekf, few, some, start, cases.START_SIGMA), 2)  # noqa: B023
        asked = MINIMUM.get(ekf.layout.n)
        print(f"{ekf.layout.n:>6}  {ours:>10,.0f}  {asked or '-':>10}  {peer:>17,.0f}  {ours / peer:>7.1f}")


if __name__ == "__main__":
    main()
