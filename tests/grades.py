"""Generic grades on emulated sensors that are better and worse than they say: does the filter know its error?

python -m tests.grades [SEEDS]      prints NIS per degree of freedom, expected between 0.3 and 3
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np

from insemu.emulate import built_in, gnss_fixes, ideal_imu
from insemu.noise import NoiseModel
from insemu.prepared import prepared
from insemu.records import AXES, ImuRecord, Recording
from insemu.solve import GRADES, Candidate, candidates

#: Standard deviations of the fixes' positions and velocities, m and m/s: a receiver alone, and with corrections.
RECEIVERS = {"receiver alone": (2.0, 0.1), "with corrections": (0.02, 0.02)}
#: How many times larger the errors are than those of the grade.
SIZES = (1.0 / 3.0, 1.0, 3.0)
RATE_HZ, MINUTES = 50.0, 10.0


@dataclass(frozen=True)
class Case:
    """A grade's filter on a drive whose sensor errs ``size`` times as much as the grade believes, turn-on bias included."""

    grade: Candidate
    size: float
    receiver: str
    seed: int

    def recording(self) -> Recording:
        """The drive with those errors."""
        rng = np.random.default_rng(self.seed)
        ideal = ideal_imu(built_in("urban_drive_1"), RATE_HZ, kind="mean", span=(0.0, 60.0 * MINUTES))
        imu = ideal.imu
        errors = {a: self.size * NoiseModel.simulate(self.grade.belief[a], len(imu), imu.dt, rng) for a in AXES}
        gyro, accel = (np.column_stack([errors[f"{s}_{a}"] for a in "xyz"]) for s in ("gyro", "accel"))
        position, velocity = RECEIVERS[self.receiver]
        sigma = ((position, position, 1.5 * position), (velocity, velocity, 1.5 * velocity))
        gnss = gnss_fixes(ideal.reference, 1.0, *sigma, (0.0, 0.0, 0.0), rng=rng)
        return Recording(ImuRecord(imu.t, imu.gyro + gyro, imu.accel + accel, "mean"), gnss)

    def nis(self) -> float:
        """NIS per degree of freedom from the start that the program finds."""
        drive = prepared(self.recording()).started()
        ekf = self.grade.filter(drive, output_every=100)
        imu, gnss = drive.flown(ekf)
        fixes = ekf.run(imu, self.grade.fixes(gnss), drive.aligned.state, drive.aligned.sigma).fixes
        kept = fixes.accepted
        return float(fixes.nis[kept].sum() / fixes.dof[kept].sum())


def grades() -> dict[str, Candidate]:
    """The generic grades by name."""
    return {c.name: c for c in candidates() if c.name in GRADES}


def main(seeds: int) -> None:
    """Print a line for every grade and receiver."""
    inside = total = 0
    for grade in grades().values():
        for receiver in RECEIVERS:
            cells = []
            for size in SIZES:
                found = [Case(grade, size, receiver, seed).nis() for seed in range(1, seeds + 1)]
                inside += sum(0.3 < f < 3.0 for f in found)
                total += len(found)
                cells.append(f"{size:.3g} times {' '.join(f'{f:.2f}' for f in sorted(found))}")
            print(f"{grade.name}, {receiver}: NIS per degree of freedom {', '.join(cells)}", flush=True)
    print(f"{inside} of {total} between 0.3 and 3")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1)
