"""GTSAM's preintegrated IMU factors (Forster et al. 2017) as a filter: a factor graph that grows by a node at every fix and asked-for epoch.

What is stated at a node are estimate and marginal covariance given all that was measured up to it. The world of GTSAM is a tangent plane with
constant gravity, which turns with the Earth.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X
from numpy.typing import ArrayLike, NDArray

from insemu import earth, rotation
from insemu.errors import InputError
from insemu.filters.options import FilterOptions, InitialSigma
from insemu.filters.results import FilterResult
from insemu.noise import RW, WN, NoiseModel
from insemu.records import AXES, GnssRecord, ImuRecord, Trajectory
from insemu.strapdown import NavState

Array = NDArray[np.float64]
#: Variance rate of what integration itself errs by, m^2/s: GTSAM needs a number, and this one is of no size.
INTEGRATION = 1e-10


class Adapter:
    """GTSAM under :class:`~insemu.filters.protocol.NavigationFilter`, which says what the arguments are.

    ``factor`` is ``combined`` (``CombinedImuFactor``, whose preintegration carries the walk of the bias) or ``imu`` (``ImuFactor``, and a walk
    between nodes). Raises ``InputError`` for another one, and for a process other than white noise and random walks.
    """

    def __init__(
        self, belief: Mapping[str, NoiseModel], dt: float, *, lever_arm: ArrayLike, gravity: str, gnss_sigma: tuple[Array, Array],
        options: FilterOptions, factor: str = "combined",
    ) -> None:  # fmt: skip
        if factor not in ("combined", "imu"):
            raise InputError(f"factor is {factor!r}, expected combined or imu")
        if other := {p.symbol for m in belief.values() for p in m} - {"WN", "RW"}:
            raise InputError(
                f"found {', '.join(sorted(other))}, expected white noise and random walks, of which GTSAM has factors"
            )
        self.factor, self.gravity, self.options, self.gnss_sigma = factor, gravity, options, gnss_sigma
        self.lever_arm = np.asarray(lever_arm, dtype=np.float64)
        self.white, self.walk, self.begun = (
            np.array([sum(getattr(p, name) ** 2 for p in belief[a] if isinstance(p, kind)) for a in AXES])
            for kind, name in ((WN, "N"), (RW, "K"), (RW, "sigma0"))
        )

    def _params(self, llh: Array) -> Any:
        make = gtsam.PreintegrationCombinedParams if self.factor == "combined" else gtsam.PreintegrationParams
        p = make.MakeSharedD(float(earth.gravity(llh[0], llh[2], self.gravity)))
        p.setGyroscopeCovariance(np.diag(self.white[:3]))
        p.setAccelerometerCovariance(np.diag(self.white[3:]))
        p.setIntegrationCovariance(INTEGRATION * np.eye(3))
        p.setOmegaCoriolis(earth.earth_rate(llh[0]))
        if self.factor == "combined":
            p.setBiasOmegaCovariance(np.diag(self.walk[:3]))
            p.setBiasAccCovariance(np.diag(self.walk[3:]))
        return p

    def run(
        self, imu: ImuRecord, gnss: GnssRecord | None, initial: NavState | Trajectory, initial_sigma: InitialSigma | ArrayLike, **_: Any
    ) -> FilterResult:  # fmt: skip
        """Filter one record."""
        assert isinstance(initial_sigma, InitialSigma)
        begun, whole, normal = time.perf_counter(), imu.as_increments(), gtsam.noiseModel.Gaussian.Covariance
        start = NavState.of(initial) if isinstance(initial, Trajectory) else initial
        t, rates = whole.t, np.hstack([whole.gyro, whole.accel]) / whole.widths(0.0)
        origin, frame = start.llh, earth.dcm_en(*start.llh[:2])
        wanted = np.searchsorted(t, np.asarray(self.options.covariance_at) - 1e-6).clip(0, t.size - 1)
        good = (
            ()
            if gnss is None
            else np.flatnonzero(np.isfinite(gnss.llh).all(axis=1) & (gnss.t > t[0]) & (gnss.t <= t[-1]))
        )
        fixes = {int(np.searchsorted(t, gnss.t[k] - 1e-6)): k for k in good} if gnss is not None else {}
        combined, C = self.factor == "combined", rotation.dcm_from_rpy(start.rpy)
        pose, velocity, bias = gtsam.Pose3(gtsam.Rot3(C), np.zeros(3)), start.vel_ned, gtsam.imuBias.ConstantBias()
        made = gtsam.PreintegratedCombinedMeasurements if combined else gtsam.PreintegratedImuMeasurements
        pim = made(self._params(origin), bias)
        graph, values, isam = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.ISAM2()
        sigma, turn = initial_sigma.to_array() ** 2, np.zeros((6, 6))
        turn[:3, :3] = turn[3:, 3:] = C.T
        graph.add(gtsam.PriorFactorPose3(X(0), pose, normal(turn @ np.diag(np.r_[sigma[6:], sigma[:3]]) @ turn.T)))
        graph.add(gtsam.PriorFactorVector(V(0), velocity, normal(np.diag(sigma[3:6]))))
        graph.add(gtsam.PriorFactorConstantBias(B(0), bias, normal(np.diag(np.r_[self.begun[3:], self.begun[:3]]))))
        nodes, last, out = sorted({0, *wanted.tolist(), *fixes}), 0, []
        for n, row in enumerate(nodes):
            if n:
                pim.resetIntegrationAndSetBias(bias)
                for k in range(last + 1, row + 1):
                    pim.integrateMeasurement(rates[k, 3:], rates[k, :3], t[k] - t[k - 1])
                state = pim.predict(gtsam.NavState(pose, velocity), bias)
                pose, velocity = state.pose(), state.velocity()
                if combined:
                    graph.add(gtsam.CombinedImuFactor(X(n - 1), V(n - 1), X(n), V(n), B(n - 1), B(n), pim))
                else:
                    graph.add(gtsam.ImuFactor(X(n - 1), V(n - 1), X(n), V(n), B(n - 1), pim))
                    walk = normal(np.diag(np.r_[self.walk[3:], self.walk[:3]]) * (t[row] - t[last]))
                    graph.add(gtsam.BetweenFactorConstantBias(B(n - 1), B(n), gtsam.imuBias.ConstantBias(), walk))
                if gnss is not None and (at := fixes.get(row)) is not None:
                    arm = pose.rotation().matrix() @ np.c_[self.lever_arm, np.cross(rates[row, :3], self.lever_arm)]
                    place = earth.llh_to_ned(gnss.llh[at], origin) - arm[:, 0]
                    graph.add(gtsam.GPSFactor(X(n), place, normal(np.diag(self.gnss_sigma[0] ** 2))))
                    if gnss.vel_ned is not None and np.isfinite(gnss.vel_ned[at]).all():
                        moving = frame.T @ earth.dcm_en(*gnss.llh[at, :2]) @ gnss.vel_ned[at] - arm[:, 1]
                        graph.add(gtsam.PriorFactorVector(V(n), moving, normal(np.diag(self.gnss_sigma[1] ** 2))))
            for key, value in ((X(n), pose), (V(n), velocity), (B(n), bias)):
                values.insert(key, value)
            isam.update(graph, values)
            isam.update()
            found, last = isam.calculateEstimate(), row
            pose, velocity, bias = found.atPose3(X(n)), found.atVector(V(n)), found.atConstantBias(B(n))
            graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            out.append(_stated(isam, found, n, origin, frame))
        nav, P = (np.stack(part) for part in zip(*out, strict=True))
        seconds = time.perf_counter() - begun
        return FilterResult.stated(t[nodes], nav, P, self.options.covariance_at, seconds=seconds, epochs=t.size - 1)


def _stated(isam: Any, found: Any, n: int, origin: Array, frame: Array) -> tuple[Array, Array]:
    """Navigation state (10,) and covariance (9, 9) of the last node, in axes of its own place."""
    pose, keys = found.atPose3(X(n)), [X(n), V(n)]
    joint = gtsam.Marginals(isam.getFactorsUnsafe(), found).jointMarginalCovariance(keys)
    llh = earth.ned_to_llh(pose.translation(), origin)
    turn = earth.dcm_en(*llh[:2]).T @ frame
    C = turn @ pose.rotation().matrix()
    P = np.block([[joint.at(a, b) for b in keys] for a in keys])  # rotation and translation in body axes, velocity
    J = np.zeros((9, 9))
    J[:3, 3:6], J[3:6, 6:], J[6:, :3] = C, turn, C
    return np.concatenate([llh, turn @ found.atVector(V(n)), rotation.quaternion_from_dcm(C)]), J @ P @ J.T
