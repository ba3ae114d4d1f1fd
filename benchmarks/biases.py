"""Large biases told in full: ``python benchmarks/biases.py [DRIVES]``.

Short emulated drives in a town, a turn or another speed every 20 s or so and half of them begun at rest. Their six axes have constant errors of up
to 5 deg/s and 0.3 m/s^2 beside the noise of a consumer MEMS, mounted anyhow, without any statement about them. As `insemu solve` does, the start is
found, a generic grade is chosen and adapted, and the bias of each axis is that of the smoother with what the start took off. Printed is how often it
is within three standard deviations of what was hidden.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from insemu.emulate import VEHICLES, Command, SmoothPath, gnss_fixes, ideal_imu, origin_at, path_of, profile
from insemu.errors import InputError
from insemu.filters import smooth
from insemu.noise import WN, NoiseModel
from insemu.prepared import prepared
from insemu.records import AXES, ImuRecord, Recording
from insemu.rotation import dcm_from_rpy
from insemu.solve import biases_of, candidates, flown
from insemu.solve.beliefs import adapted
from insemu.solve.solution import likeliest_grade

Array = NDArray[np.float64]

RATE, SECONDS = 50.0, 180.0
LARGEST = np.repeat([np.deg2rad(5.0), 0.3], 3)
#: Standard deviations of positions and velocities, m and m/s, north, east, down.
POSITION, VELOCITY = (1.0, 1.0, 1.5), (0.05, 0.05, 0.08)
#: Largest difference in standard deviations that is within.
SIGMAS = 3.0


def town(rng: np.random.Generator) -> SmoothPath:
    """A way through a town."""
    commands = [Command(10.0 + 1e-3) if rng.random() < 0.5 else Command(4.0, speed=8.0), Command(8.0, speed=8.0)]
    while sum(c.duration_s for c in commands) < SECONDS:
        commands.append(Command(rng.uniform(3.0, 15.0)))
        if rng.random() < 0.6:
            commands.append(Command(8.0, turn=rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.6)))
        else:
            commands.append(Command(8.0, speed=rng.uniform(4.0, 14.0)))
    return path_of(profile(commands), VEHICLES["car"], origin_at(46.5, 6.6, 400.0), "town")


def drive(seed: int) -> tuple[Recording, Array]:
    """A recording and its hidden biases (6,), rad/s and m/s^2, in its own axes."""
    rng = np.random.default_rng(seed)
    ideal = ideal_imu(town(rng), RATE, mode="continuous", kind="mean")
    C = dcm_from_rpy(rng.uniform(-np.pi, np.pi, 3) * [1.0, 0.5, 1.0])  # IMU to vehicle
    hidden = rng.uniform(-1.0, 1.0, 6) * LARGEST
    noise = next(c.belief for c in candidates() if c.name == "consumer MEMS")
    imu = ideal.imu
    lasting = {a: NoiseModel(tuple(p for p in noise[a] if isinstance(p, WN))) for a in AXES}
    errors = np.column_stack([lasting[a].simulate(len(imu), imu.dt, rng) for a in AXES]) + hidden
    fixes = gnss_fixes(ideal.reference, 1.0, POSITION, VELOCITY, (0.0, 0.0, 0.0), rng=rng)
    return Recording(
        ImuRecord(imu.t, imu.gyro @ C + errors[:, :3], imu.accel @ C + errors[:, 3:], "mean"), fixes
    ), hidden


def off(seed: int) -> Array | None:
    """Told less hidden in standard deviations (6,); None where no filter starts."""
    recording, hidden = drive(seed)
    try:
        ready = prepared(recording).started()
    except InputError:
        return None
    own = adapted(likeliest_grade(candidates(lever_arm_known=True), ready), ready)
    found = biases_of(ready, own, smooth(flown(own.filter(ready, store="fixes", node_every=1.0), ready, own)))
    return np.array([(found[a][0] - b) / found[a][1] for a, b in zip(AXES, hidden, strict=True)])


def main(count: int) -> None:
    """Print the shares."""
    began = time.process_time()
    found = [off(seed) for seed in range(1, count + 1)]
    told = np.array([f for f in found if f is not None])
    within = np.abs(told) <= SIGMAS
    print(
        f"{count} drives of {SECONDS:g} s, {count - len(told)} without a start; {time.process_time() - began:.0f} CPU s"
    )
    print(f"biases within {SIGMAS:g} sigma: {int(within.sum())} of {within.size} ({within.mean():.1%})")
    print(
        f"drives with all six within: {int(within.all(axis=1).sum())} of {len(told)}; a normal error would give {0.9973**6:.1%}"
    )
    for axis, one in zip(AXES, told.T, strict=True):
        print(f"  {axis:<8} rms {np.sqrt(np.mean(one**2)):.2f} sigma, largest {np.abs(one).max():.2f}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
