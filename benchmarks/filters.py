"""Speed of the compiled filter: IMU epochs per second at full covariance rate, mechanization and 1 Hz updates included.

Run ``python benchmarks/filters.py``. Seconds are CPU time of this process on one core, warm, the best of several runs that take turns: one
realization by itself, eight in vector lanes, and the same filter on filterpy (:mod:`insemu.filters.reference`).
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
from insemu.lanes import LANES
from insemu.records import GnssRecord, ImuRecord
from tests import filter_cases as cases

#: Epochs per second and core that are asked for: by itself, in lanes.
MINIMUM = {15: (800_000, 2_000_000), 24: (500_000, 1_500_000)}


def cpu(*works: Callable[[], object], repeats: int) -> list[float]:
    """Least CPU seconds of several calls of each."""
    best = [np.inf] * len(works)
    for _ in range(repeats):
        for k, work in enumerate(works):
            started = time.process_time()
            work()
            best[k] = min(best[k], time.process_time() - started)
    return best


def main() -> None:
    seconds, short = 300.0, 10.0
    road = cases.drive(seconds)
    print(
        f"{'states':>6}  {'epochs/s':>10}  {'asked':>9}  {'in lanes':>10}  {'asked':>9}  {'ratio':>5}  {'filterpy':>8}"
    )
    for model in (cases.MODEL_15, cases.MODEL_24, cases.MODEL_27):
        drawn = [np.random.default_rng(k) for k in range(LANES)]
        imus, starts = [cases.corrupt(road.imu, model, r) for r in drawn], [cases.start(road, r) for r in drawn]
        gnsses = [cases.fixes(road, r) for r in drawn]
        ekf = LooselyCoupledEKF(model, cases.DT, options=FilterOptions(output_every=100))

        def alone(ekf=ekf, imu=imus[0], gnss=gnsses[0], start=starts[0]):
            return ekf.run(imu, gnss, start, cases.START_SIGMA)

        def beside(ekf=ekf, imus=imus, gnsses=gnsses, starts=starts):
            return ekf.run_many(imus, gnsses, starts, cases.START_SIGMA)

        alone(), beside()  # compiles
        one, many = cpu(alone, beside, repeats=12)
        epochs = len(imus[0]) - 1
        n = round(short * cases.RATE) + 1
        few = ImuRecord(imus[0].t[:n], imus[0].gyro[:n], imus[0].accel[:n], kind="increment")
        early = gnsses[0].t <= short
        names = ("t", "llh", "vel_ned", "pos_std_ned", "vel_std_ned")
        some = GnssRecord(*(getattr(gnsses[0], k)[early] for k in names))
        (peer,) = cpu(lambda: reference_run(ekf, few, some, starts[0], cases.START_SIGMA), repeats=2)  # noqa: B023
        single, lanes, other = epochs / one, LANES * epochs / many, (n - 1) / peer
        asked = [f"{v:,}" for v in MINIMUM.get(ekf.layout.n, ())] or ["-", "-"]
        print(
            f"{ekf.layout.n:>6}  {single:>10,.0f}  {asked[0]:>9}  {lanes:>10,.0f}  {asked[1]:>9}  {lanes / single:>5.1f}  {other:>8,.0f}"
        )


if __name__ == "__main__":
    main()
