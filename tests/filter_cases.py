"""A small emulated drive for filter tests, built from the mechanization alone: a smooth truth, its increments, noise from a model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu import earth, rotation, strapdown
from insemu.augment import Belief, per_axis, true_states
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


def of_partial_correlations(correlations: ArrayLike, *, sigma2: float, rate_hz: float) -> AR:
    """The autoregression with these partial autocorrelations (Durbin's recursion), stationary where all lie between -1 and 1."""
    ar = np.zeros(0)
    for k in np.asarray(correlations, dtype=np.float64):
        ar = np.append(ar - k * ar[::-1], k)
    return AR(tuple(float(v) for v in ar), sigma2=sigma2, rate_hz=rate_hz)


def partial_correlations(coefficients: ArrayLike) -> NDArray[np.float64]:
    """Partial autocorrelations, (p,), of coefficients: the inverse; NaN below a value of exactly 1."""
    ar = np.array(coefficients, dtype=np.float64)
    out = np.empty(ar.size)
    for at in range(ar.size - 1, -1, -1):
        k = out[at] = ar[at]
        with np.errstate(divide="ignore", invalid="ignore"):
            ar = (ar[:at] + k * ar[:at][::-1]) / (1.0 - k**2)
    return out


def _printed_ar3(printed: tuple[float, float, float], sigma2: float, first_order: float) -> AR:
    """AR(3) of 004, Table 2, stable: the first partial autocorrelation is that of the AR(1) row, at most half a printed digit below 1.

    The printed coefficients of five of the six axes sum to exactly 1, which makes the first partial autocorrelation 1. Moving the pole at 1
    inwards instead (radius 0.9995) makes the standard deviation of the gyroscope error 0.0053 rad/s, 24 times that of the AR(1) row of the
    same signal, and attitude errors of half a radian within a minute, where no linearised filter knows its error.
    """
    k = partial_correlations(printed)
    k[0] = min(first_order, 0.9995)
    return of_partial_correlations(k, sigma2=sigma2, rate_hz=RATE)


MODEL_27: dict[str, NoiseModel] = {
    "gyro_x": _printed_ar3((2.564, -2.131, 0.567), 2.739e-13, 0.999) + WN(N=5e-4),
    "gyro_y": _printed_ar3((2.565, -2.133, 0.568), 1.905e-13, 0.999) + WN(N=5e-4),
    "gyro_z": _printed_ar3((2.562, -2.128, 0.566), 2.181e-13, 0.999) + WN(N=5e-4),
    "accel_x": _printed_ar3((2.582, -2.166, 0.585), 4.973e-13, 1.0) + WN(N=8e-4),
    "accel_y": _printed_ar3((2.564, -2.136, 0.572), 8.399e-12, 1.0) + WN(N=8e-4),
    "accel_z": _printed_ar3((2.564, -2.136, 0.572), 7.964e-12, 1.0) + WN(N=8e-4),
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


def drive(seconds: float, *, turn: float = 0.35, seed: int = 0, vibration: float = 0.0) -> Drive:
    """A vehicle that turns, speeds up and rocks, for ``seconds``; ``vibration`` is the amplitude (m/s^2) of a 17-Hz shake of all axes."""
    t = np.arange(round(seconds * RATE) + 1) * DT
    # the same road at fresh seeds of tests.budget: whether a state is excited is no matter of chance
    rng = np.random.Generator(np.random.PCG64(seed))
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
        force = force + vibration * np.sin(2 * np.pi * 17.0 * t[k] + phase[3:])
        dth[k], dv[k] = (gyro[k] + level) * DT, force * DT
        strapdown.step(nav, dth[k], dv[k], dth[max(k - 1, 1)], dv[max(k - 1, 1)], DT, DT, 0)
        out[k] = nav
    dth[0], dv[0] = dth[1], dv[1]
    return Drive(t, out, ImuRecord(t, dth, dv, kind="increment"))


def corrupt_with_states(ideal: ImuRecord, truth: Belief, rng: np.random.Generator) -> tuple[ImuRecord, Array]:
    """Add errors drawn from a model to ideal increments; beside them the true states (n, m) in the order of a filter that believes it."""
    models = per_axis(truth)
    errors, states = np.empty((len(ideal), 6)), []
    for a, (axis, child) in enumerate(zip(AXES, rng.spawn(6), strict=True)):
        model = models[axis].at_rate(RATE)
        parts = model.simulate_components(len(ideal), DT, child)
        errors[:, a] = parts.sum(axis=0)
        states.append(true_states(model, parts, DT))
    imu = ImuRecord(ideal.t, ideal.gyro + errors[:, :3] * DT, ideal.accel + errors[:, 3:] * DT, kind="increment")
    return imu, np.concatenate(states).T


def corrupt(ideal: ImuRecord, truth: Belief, rng: np.random.Generator) -> ImuRecord:
    """Add errors drawn from a model to ideal increments."""
    return corrupt_with_states(ideal, truth, rng)[0]


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


def late_fixes(
    truth: Drive,
    rng: np.random.Generator,
    *,
    latency: float,
    lever_arm: tuple[float, float, float],
    every: int = 20,
    sigma: tuple[float, float] = (0.05, 0.03),
) -> GnssRecord:
    """Fixes of the antenna every ``every`` epochs, stamped ``latency`` seconds after they were valid."""
    stamps = truth.t[2 * every :: every]
    stamps = stamps[
        (stamps - latency >= truth.t[0]) & (stamps - latency < truth.t[-1])
    ]  # negative: stamped before it is valid
    own = stamps - latency
    k = np.searchsorted(truth.t, own + 1e-9) - 1
    h = ((own - truth.t[k]) / DT)[:, None]
    a, b = truth.nav[k], truth.nav[k + 1]
    slope = (truth.nav[k + 1, 3:6] - truth.nav[k, 3:6]) / DT
    # cubic through places and velocities at both ends of the step
    moved = earth.position_difference(b[:, :3], a[:, :3])
    ned = (3 * h**2 - 2 * h**3) * moved + DT * ((h - 2 * h**2 + h**3) * a[:, 3:6] + (h**3 - h**2) * b[:, 3:6])
    llh, vel = earth.move(a[:, :3], ned), a[:, 3:6] + h * DT * slope
    gyro = truth.imu.gyro
    C = rotation.dcm_from_quaternion(a[:, 6:10]) @ rotation.dcm_from_quaternion(
        rotation.quaternion_from_vector(h * gyro[k + 1])
    )
    last = len(truth.imu) - 1
    middle = np.clip(k + 1, 1, last - 1)
    rate = (gyro[middle] + (h - 0.5) * 0.5 * (gyro[middle + 1] - gyro[middle - 1])) / DT
    rate = rate - np.einsum("kji,kj->ki", C, earth.earth_rate(llh[:, 0]))
    arm = np.array(lever_arm)
    llh = earth.move(llh, np.einsum("kij,j->ki", C, arm) + rng.standard_normal((k.size, 3)) * sigma[0])
    vel = vel + np.einsum("kij,kj->ki", C, np.cross(rate, arm)) + rng.standard_normal((k.size, 3)) * sigma[1]
    return GnssRecord(stamps, llh, vel, np.full((k.size, 3), sigma[0]), np.full((k.size, 3), sigma[1]))


def later(truth: Drive, seconds: float) -> Drive:
    """The drive without its first ``seconds``, in which it gathers speed at 1 g."""
    k = round(seconds * RATE)
    imu = ImuRecord(truth.t[k:] - truth.t[k], truth.imu.gyro[k:], truth.imu.accel[k:], kind="increment")
    return Drive(imu.t, truth.nav[k:], imu)


def start(truth: Drive, rng: np.random.Generator, sigma: InitialSigma = START_SIGMA) -> NavState:
    """The true start moved by a draw from ``sigma``."""
    nav = truth.nav[0].copy()
    strapdown.correct(nav, -rng.standard_normal(9) * sigma.to_array())
    return NavState(nav[:3], nav[3:6], rotation.rpy_from_quaternion(nav[6:10]))
