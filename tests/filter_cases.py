"""A small emulated drive for filter tests, built from the mechanization alone: a smooth truth, its increments, noise from a model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu import earth, rotation, strapdown
from insemu.augment import Belief, per_axis
from insemu.filters import InitialSigma
from insemu.noise import AR, GM, RW, WN, NoiseModel
from insemu.records import AXES, GnssRecord, ImuRecord
from insemu.strapdown import NavState

Array = NDArray[np.float64]
RATE = 100.0
DT = 1.0 / RATE

MODEL_15: dict[str, NoiseModel] = {
    "gyro": WN(N=5e-4) + GM(sigma=3e-4, beta=0.01),
    "accel": WN(N=1e-3) + GM(sigma=5e-3, beta=0.02),
}
MODEL_24: dict[str, NoiseModel] = {
    "gyro": WN(N=5e-4) + GM(sigma=3e-4, beta=0.024) + GM(sigma=2e-4, beta=9e-4),
    "accel": WN(N=8e-4) + GM(sigma=2e-3, beta=25.8) + GM(sigma=3e-3, beta=0.04) + GM(sigma=5e-3, beta=1e-3),
}
# The printed polynomials of 004, Table 2, moved inside the unit circle. The gyroscopes' variance is a hundredth of the printed: as printed,
# attitude errors reach half a radian in a minute without fixes, and no linearised filter knows its error there, whatever it believes.
MODEL_27: dict[str, NoiseModel] = {
    "gyro": AR((2.564, -2.131, 0.567), sigma2=2.7e-15, rate_hz=RATE).stabilised(0.9995) + WN(N=5e-4),
    "accel": AR((2.564, -2.136, 0.572), sigma2=8.0e-12, rate_hz=RATE).stabilised(0.9995) + WN(N=8e-4),
}
MODEL_RW: dict[str, NoiseModel] = {
    "gyro": WN(N=5e-4) + RW(K=1e-6, sigma0=3e-4),
    "accel": WN(N=1e-3) + RW(K=1e-5, sigma0=5e-3),
}
START_SIGMA = InitialSigma(position=0.5, velocity=0.1, attitude=(0.01, 0.01, 0.05))


@dataclass(frozen=True)
class Drive:
    """Truth nodes (n, 10) and the ideal increments that lead from one to the next through the mechanization."""

    t: Array
    nav: Array
    imu: ImuRecord


def drive(seconds: float, *, turn: float = 0.35, seed: int = 0) -> Drive:
    """A vehicle that turns, speeds up and rocks, for ``seconds``."""
    t = np.arange(round(seconds * RATE) + 1) * DT
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 2 * np.pi, 6)
    # rate and specific force are chosen; the mechanization says where they lead
    heading_rate = turn * np.sin(2 * np.pi * t / 47.0 + phase[0]) * np.sin(2 * np.pi * t / 171.0 + phase[1])
    gyro = np.stack(
        [0.05 * np.sin(2 * np.pi * t / 3.1 + phase[2]), 0.05 * np.sin(2 * np.pi * t / 2.3 + phase[3]), heading_rate],
        axis=1,
    )
    gyro -= gyro.mean(axis=0)
    nav = NavState(np.array([0.8, 0.15, 300.0]), np.array([10.0, 3.0, 0.0]), np.array([0.02, -0.01, 0.3])).to_array()
    out = np.empty((t.size, 10))
    out[0] = nav
    dth, dv = np.zeros((t.size, 3)), np.zeros((t.size, 3))
    for k in range(1, t.size):
        C = rotation.dcm_from_quaternion(nav[6:10])
        # hold speed and height loosely: a controller on the truth keeps the path bounded
        wanted = np.array([10.0 * np.sin(t[k] / 31.0), 10.0 * np.cos(t[k] / 23.0), 0.3 * np.sin(t[k] / 11.0)])
        level = np.array([-0.5 * C[2, 1], 0.5 * C[2, 0], 0.0])
        force = C.T @ (1.0 * (wanted - nav[3:6]) - np.array([0.0, 0.0, 9.81]))
        dth[k], dv[k] = (gyro[k] + level) * DT, force * DT
        strapdown.step(nav, dth[k], dv[k], dth[max(k - 1, 1)], dv[max(k - 1, 1)], DT, DT, 0)
        out[k] = nav
    dth[0], dv[0] = dth[1], dv[1]
    return Drive(t, out, ImuRecord(t, dth, dv, kind="increment"))


def corrupt(ideal: ImuRecord, truth: Belief, rng: np.random.Generator) -> ImuRecord:
    """Add errors drawn from a model to ideal increments."""
    models = per_axis(truth)
    errors = np.stack(
        [
            models[axis].at_rate(RATE).simulate(len(ideal), DT, child)
            for axis, child in zip(AXES, rng.spawn(6), strict=True)
        ],
        axis=1,
    )
    return ImuRecord(ideal.t, ideal.gyro + errors[:, :3] * DT, ideal.accel + errors[:, 3:] * DT, kind="increment")


def fixes(
    truth: Drive,
    rng: np.random.Generator,
    *,
    sigma: tuple[float, float] = (0.05, 0.03),
    outages: tuple[tuple[float, float], ...] = (),
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> GnssRecord:
    """Fixes of the antenna every second, none with ``start < t <= end`` of an outage."""
    every = round(RATE)
    rows = np.arange(every, truth.t.size, every)
    for start, end in outages:
        rows = rows[(truth.t[rows] <= start) | (truth.t[rows] > end)]
    C = rotation.dcm_from_quaternion(truth.nav[rows, 6:10])
    rate = 0.5 * (truth.imu.gyro[rows] + truth.imu.gyro[np.minimum(rows + 1, truth.t.size - 1)]) / DT
    rate = rate - np.einsum("kji,kj->ki", C, earth.earth_rate(truth.nav[rows, 0]))
    arm = np.einsum("kij,j->ki", C, np.array(lever_arm))
    swing = np.einsum("kij,kj->ki", C, np.cross(rate, np.array(lever_arm)))
    llh = earth.move(truth.nav[rows, :3], arm + rng.standard_normal((rows.size, 3)) * sigma[0])
    vel = truth.nav[rows, 3:6] + swing + rng.standard_normal((rows.size, 3)) * sigma[1]
    return GnssRecord(truth.t[rows], llh, vel, np.full((rows.size, 3), sigma[0]), np.full((rows.size, 3), sigma[1]))


def start(truth: Drive, rng: np.random.Generator, sigma: InitialSigma = START_SIGMA) -> NavState:
    """The true start moved by a draw from ``sigma``."""
    nav = truth.nav[0].copy()
    strapdown.correct(nav, -rng.standard_normal(9) * sigma.to_array())
    return NavState(nav[:3], nav[3:6], rotation.rpy_from_quaternion(nav[6:10]))
