"""Emulated starts: at rest, in a turn, a slow rover, a boat in swell, an IMU in the hand; and whether what an alignment states holds.

``python -m tests.start_cases [N]`` prints the table for N starts of each kind (40 unless given).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu import earth, rotation, strapdown
from insemu.errors import InputError
from insemu.filters.alignment import Alignment, align
from insemu.filters.motion import align_in_motion
from insemu.noise import RC, WN
from insemu.records import GnssRecord, ImuRecord
from insemu.strapdown import NavState
from tests import filter_cases as cases

Array = NDArray[np.float64]
RATE = 100.0
KINDS = ("rest", "turn", "rover", "boat", "hand")
#: Two-sided 99 % of a normal distribution.
K99 = 2.576


@dataclass(frozen=True)
class Start:
    """A recording, the truth behind it (n, 10), and the gyroscopes' constant errors (3,)."""

    imu: ImuRecord
    gnss: GnssRecord
    nav: Array
    bias: Array
    lever_arm: Array


def smooth(t: Array, rng: np.random.Generator, seconds: float, sigma: float) -> Array:
    """A slowly wandering signal."""
    phases, out = rng.uniform(0, 2 * np.pi, 6), np.zeros(t.size)
    for j, phase in enumerate(phases):
        out += np.sin(2 * np.pi * t * (0.4 + 0.3 * j) / seconds + phase)
    return out * sigma / np.sqrt(3.0)


def ramp(t: Array, start: float, seconds: float) -> Array:
    """From 0 to 1, without jerks."""
    h = np.clip((t - start) / seconds, 0.0, 1.0)
    return np.asarray(h * h * h * (10 - 15 * h + 6 * h * h))


def motion(kind: str, t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Velocity NED (n, 3) and roll, pitch, heading (n, 3)."""
    heading = rng.uniform(-np.pi, np.pi) + np.zeros(t.size)
    rpy, v = np.zeros((t.size, 3)), np.zeros((t.size, 3))
    if kind == "rest":
        go = rng.uniform(8.0, 30.0)
        speed = rng.uniform(6.0, 15.0) * ramp(t, go, 8.0) * (1.0 + smooth(t, rng, 40.0, 0.15))
        heading = heading + np.cumsum(smooth(t, rng, 30.0, 0.12) * ramp(t, go, 4.0)) / RATE
        rpy[:, 1] = smooth(t, rng, 15.0, 0.01) * ramp(t, go, 4.0)
    elif kind == "turn":
        rate = np.deg2rad(rng.uniform(0.5, 30.0)) * rng.choice([-1.0, 1.0])
        stop = rng.uniform(10.0, 30.0)
        speed = rng.choice([0.0, 5.0]) * np.ones(t.size)
        speed = speed + 6.0 * ramp(t, stop, 6.0) * rng.integers(2)
        heading = (
            heading
            + np.cumsum(rate * (1.0 - ramp(t, stop, 2.0)) + smooth(t, rng, 30.0, 0.1) * ramp(t, stop, 2.0)) / RATE
        )
    elif kind == "rover":
        speed = 0.5 * np.clip(smooth(t, rng, 20.0, 1.0) + 0.8, 0.0, 1.2)
        heading = heading + np.cumsum(smooth(t, rng, 25.0, 0.3)) / RATE
        rpy[:, :2] = np.stack([smooth(t, rng, 3.0, 0.01), smooth(t, rng, 2.0, 0.01)], axis=1)
    elif kind == "boat":
        speed = rng.uniform(0.0, 4.0) * (1.0 + smooth(t, rng, 60.0, 0.2))
        heading = heading + smooth(t, rng, 40.0, 0.4)
        rpy[:, 0], rpy[:, 1] = smooth(t, rng, 9.0, 0.12), smooth(t, rng, 7.0, 0.06)
    else:
        speed = rng.uniform(0.9, 1.6) * (1.0 + smooth(t, rng, 30.0, 0.1))
        heading = heading + np.cumsum(smooth(t, rng, 20.0, 0.15)) / RATE
        rpy[:, 0] = rng.uniform(-2.0, 2.0) + smooth(t, rng, 2.5, 0.15)
        rpy[:, 1] = rng.uniform(-1.0, 1.0) + smooth(t, rng, 2.0, 0.15)
    v[:, 0], v[:, 1] = speed * np.cos(heading), speed * np.sin(heading)
    if kind == "boat":
        v[:, 2] = smooth(t, rng, 8.0, 0.4)
        v[:, :2] += np.stack([smooth(t, rng, 9.0, 0.2), smooth(t, rng, 9.0, 0.2)], axis=1)
    if kind == "hand":
        v[:, 2] = smooth(t, rng, 1.5, 0.2)
        heading = heading + rng.uniform(-np.pi, np.pi) + smooth(t, rng, 3.0, 0.2)
    rpy[:, 2] = heading
    return v, rpy


def emulate(kind: str, seed: int, seconds: float = 120.0) -> Start:
    """One start of a kind."""
    rng = np.random.default_rng([KINDS.index(kind), seed])
    t = np.arange(round(seconds * RATE) + 1) / RATE
    v, rpy = motion(kind, t, rng)
    C = rotation.dcm_from_rpy(rpy)
    q = rotation.quaternion_from_dcm(C)
    dq = rotation.quaternion_product(rotation.quaternion_conjugate(q[:-1]), q[1:])
    llh = np.array([0.8, 0.1, 200.0])
    mid = 0.5 * (C[1:] + C[:-1])
    w_n = earth.earth_rate(llh[0]) + 0 * v[1:]
    dth = rotation.vector_from_quaternion(dq) + np.einsum("kji,kj->ki", mid, w_n) / RATE
    g = np.array([0.0, 0.0, float(earth.gravity(llh[0], llh[2]))])
    dv = np.einsum("kji,kj->ki", mid, np.diff(v, axis=0) - (g - 2 * np.cross(w_n, v[1:])) / RATE)
    mounting = np.eye(3) if kind in ("rest", "turn") else rotation.dcm_from_rpy(rng.uniform(-1, 1, 3) * [3, 1, 3])
    first = NavState(llh, v[0], rpy[0])
    ideal = ImuRecord(t, np.concatenate([dth[:1], dth]), np.concatenate([dv[:1], dv]), kind="increment")
    nav = strapdown.mechanize_array(ideal, first)
    noise = {
        "gyro": WN(N=np.deg2rad(rng.uniform(0.004, 0.02))) + RC(sigma=np.deg2rad(rng.choice([0.05, 1.0]))),
        "accel": WN(N=rng.uniform(0.5e-3, 2e-3)) + RC(sigma=0.1),
    }
    turned = ImuRecord(t, ideal.gyro @ mounting, ideal.accel @ mounting, kind="increment")
    imu = cases.corrupt(turned, noise, rng)
    bias = (imu.gyro - turned.gyro).mean(axis=0) * RATE
    lever_b = rng.uniform(-0.5, 0.5, 3)
    gnss = fixes(t, nav, ideal, lever_b, kind, rng)
    truth = nav.copy()
    truth[:, 6:10] = rotation.quaternion_product(nav[:, 6:10], rotation.quaternion_from_dcm(mounting))
    return Start(imu, gnss, truth, bias, mounting.T @ lever_b)


def fixes(t: Array, nav: Array, imu: ImuRecord, lever: Array, kind: str, rng: np.random.Generator) -> GnssRecord:
    """Fixes of RTK or of a single receiver, half of them positions alone, a fifth without standard deviations."""
    every = int(rng.choice([20, 50, 100]))
    rows = np.arange(every, t.size - 1, every)
    place, speed = (0.02, 0.03) if rng.random() < 0.5 else (0.7, 0.08)
    C = rotation.dcm_from_quaternion(nav[rows, 6:10])
    rate = 0.5 * (imu.gyro[rows] + imu.gyro[rows + 1]) * RATE
    arm, swing = C @ lever, np.einsum("kij,kj->ki", C, np.cross(rate, lever))
    wander = np.stack([smooth(t[rows], rng, 120.0, place) for _ in range(3)], axis=1)
    llh = earth.move(nav[rows, :3], arm + wander + place * rng.standard_normal((rows.size, 3)))
    velocity = nav[rows, 3:6] + swing + speed * rng.standard_normal((rows.size, 3))
    n = rows.size
    with_velocity = rng.random() < 0.5
    stated = rng.random() < 0.8
    return GnssRecord(
        t[rows],
        llh,
        velocity if with_velocity else None,
        np.full((n, 3), place * np.sqrt(2.0)) if stated else None,
        np.full((n, 3), speed) if stated and with_velocity else None,
    )


@dataclass(frozen=True)
class Verdict:
    """One start: whether it was refused, and its errors in stated standard deviations: heading, and the largest of the biases told."""

    refused: bool
    heading: float = 0.0
    heading_sigma: float = 0.0
    bias: float = 0.0


def judged(s: Start, how: Callable[[Start], Alignment]) -> Verdict:
    """Align, and hold the result against the truth."""
    try:
        found = how(s)
    except InputError:
        return Verdict(True)
    C = rotation.dcm_from_quaternion(s.nav[found.row, 6:10])
    error = rotation.vector_from_dcm(rotation.dcm_from_rpy(found.state.rpy) @ C.T)
    sigma = float(np.asarray(found.sigma.attitude)[2])
    told = np.isfinite(found.bias[:3])
    off = np.abs(found.bias[:3] - s.bias)[told] / found.bias_sigma[:3][told]
    return Verdict(False, abs(float(error[2])) / sigma, sigma, float(off.max(initial=0.0)))


def in_motion(s: Start) -> Alignment:
    return align_in_motion(s.imu, s.gnss, lever_arm=s.lever_arm)


def on_course(s: Start) -> Alignment:
    return align(s.imu, s.gnss, lever_arm=s.lever_arm)


def main(runs: int) -> None:
    print(
        f"{'start':>6} {'way':>7} {'refused':>8} {'heading out':>12} {'bias out':>9} {'sigma heading deg':>18}   of {runs}, outside 99 %"
    )
    for kind in KINDS:
        for name, how in (("motion", in_motion), *((("course", on_course),) if kind in ("rest", "turn") else ())):
            all_of = [judged(emulate(kind, seed), how) for seed in range(runs)]
            out = [v for v in all_of if not v.refused]
            middle = np.rad2deg(np.median([v.heading_sigma for v in out])) if out else np.nan
            print(
                f"{kind:>6} {name:>7} {runs - len(out):>8} {sum(v.heading > K99 for v in out):>12} {sum(v.bias > K99 for v in out):>9} "
                f"{middle:>18.2f}   worst {max((v.heading for v in out), default=0):.1f} {max((v.bias for v in out), default=0):.1f}"
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40)
