"""Mounting angles by what a wheeled vehicle cannot do: move sideways or leave the road.

A filter without that knowledge hides a wrong mounting in the attitude: turning the IMU turns the estimated body with it, and no innovation
changes. The velocity in body axes changes: with the IMU's axes turned by ``C`` against the vehicle's, ``C v_b`` points forward. That residual
(the innovation of a non-holonomic update that is not fed back) is regressed on the mounting angles, with coloured noise of free level for slip, bumps
and the attitude's own errors, and with the way from the IMU to the axle that does not steer as a nuisance. Roll shows in the tilt alone: a vehicle
is level on average, as far as roads are, so that roll is left as it is unless the drive leans by more than roads do.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu import rotation
from insemu.effects import EFFECTS, EffectUse
from insemu.filters import TRACK_SPEED
from insemu.gap.beliefs.nominal import Nominal
from insemu.gap.drive.preparation import Prepared, fast_parts, prepare
from insemu.gap.evidence.linear import log_mean_exp
from insemu.gap.policy import rules
from insemu.gap.verdict import Finding, Member, Value, Where
from insemu.records import Recording

Array = NDArray[np.float64]
#: Most corrections of the mounting, and the one below which it is done, rad: each is a run of the filter about the one before.
TURNS, ENOUGH = 6, math.radians(0.1)


@dataclass(frozen=True)
class Sideways:
    """Velocity across the vehicle's axis at the fixes, in the IMU's axes turned by the nominal mounting.

    Parameters
    ----------
    t : (k,) array
    u : (k, 3) array
        Velocity, m/s.
    rate : (k, 3) array
        rad/s.
    roll : float
        Mean roll while driving, rad.
    """

    t: Array
    u: Array
    rate: Array
    roll: float

    @classmethod
    def of(cls, prepared: Prepared) -> Sideways:
        """From a stored filter run."""
        from scipy.signal import lfilter

        result = prepared.result
        k = result.fixes.epoch[result.fixes.accepted]
        C = rotation.dcm_from_quaternion(result.nav[k, 6:10])
        u = np.einsum("nji,nj->ni", C, result.nav[k, 3:6])
        keep = (np.linalg.norm(u, axis=1) > TRACK_SPEED) & (u[:, 0] > 0.5 * np.linalg.norm(u, axis=1))
        imu = prepared.imu.as_increments()
        dt = imu.dt
        width = max(1, round(0.2 / dt))
        smooth = lfilter(np.full(width, 1.0 / width), [1.0], imu.gyro / dt, axis=0)
        roll = rotation.rpy_from_dcm(C[keep])[:, 0]
        return cls(
            result.fixes.t[result.fixes.accepted][keep],
            u[keep],
            smooth[k][keep],
            float(np.median(roll)) if keep.any() else 0.0,
        )

    def part(self, keep: NDArray[np.bool_]) -> Sideways:
        """Some of the fixes."""
        return replace(self, t=self.t[keep], u=self.u[keep], rate=self.rate[keep])

    @property
    def residual(self) -> Array:
        """Sideways and downward velocity, (2, k)."""
        return np.asarray(self.u[:, 1:].T)

    def columns(self) -> Array:
        """Derivative of the residual by roll, pitch, yaw of the mounting that lacks, and by the way to the axle, (2, k, 5)."""
        out = np.zeros((2, self.t.size, 5))
        out[0, :, 0], out[0, :, 2] = self.u[:, 2], -self.u[:, 0]
        out[1, :, 0], out[1, :, 1] = -self.u[:, 1], self.u[:, 0]
        out[0, :, 3] = self.rate[:, 2]
        out[1, :, 4] = -self.rate[:, 1]
        return out


@dataclass(frozen=True)
class Colour:
    """Noise of the residual per component: first-order autoregression of standard deviation ``sigma`` and correlation ``phi``."""

    sigma: Array
    phi: Array

    def whiten(self, x: Array, t: Array) -> tuple[Array, float]:
        """Residuals (2, k, ...) with the noise's correlation between neighbours in time taken out; log determinant."""
        out = np.empty_like(x)
        logdet = 0.0
        gap = np.diff(t)
        step = float(np.median(gap))
        for c in range(2):
            phi = self.phi[c] ** (gap / step)
            spread = self.sigma[c] * np.sqrt(np.concatenate([[1.0], np.maximum(1.0 - phi**2, 1e-6)]))
            shape = (-1,) + (1,) * (x.ndim - 2)
            out[c, 0] = x[c, 0]
            out[c, 1:] = x[c, 1:] - phi.reshape(shape) * x[c, :-1]
            out[c] /= spread.reshape(shape)
            logdet += 2.0 * float(np.sum(np.log(spread)))
        return out, logdet

    @classmethod
    def of(cls, residual: Array, least: float) -> Colour:
        """From what is left over, (2, k); never less than ``least``."""
        sigma = np.maximum(residual.std(axis=1), least)
        centred = residual - residual.mean(axis=1, keepdims=True)
        rho = np.sum(centred[:, 1:] * centred[:, :-1], axis=1) / np.maximum(np.sum(centred**2, axis=1), 1e-30)
        return cls(sigma, np.clip(rho, 0.0, 0.995))


@dataclass(frozen=True)
class Turned:
    """Mounting angles that lack, with their covariance (3, 3), evidence in nats, and the noise of the residual."""

    angles: Array
    covariance: Array
    nats: float
    colour: Colour
    axle: Array


def estimate(s: Sideways, nominal: Nominal) -> Turned:
    """Regress the residual on the mounting angles, noise estimated along."""
    assert nominal.vehicle is not None
    G, r = s.columns(), s.residual
    scale = EFFECTS["mounting"].scale("rpy", "imu")
    left = r - r.mean(axis=1, keepdims=True)
    beta = np.zeros(5)
    leans = abs(s.roll) > 2.0 * rules().road_roll
    used = np.array([1.0 if leans else 1e-6, 1.0, 1.0, 1.0, 1.0])
    wide = used * np.array([max(nominal.vehicle.mounting_sigma, 10.0 * scale)] * 3 + [rules().axle_sigma] * 2)

    def solve(colour: Colour, prior: Array) -> tuple[Array, Array, float]:
        """Posterior and log Bayes factor against a mounting that is right, with a prior of the angles; the axle is free in both."""
        g, _ = colour.whiten(G, s.t)
        y, _ = colour.whiten(r, s.t)
        A = np.einsum("ckp,ckq->pq", g, g)
        b = np.einsum("ckp,ck->p", g, y)
        # the vehicle is level on average: its mean roll is the mounting's roll that lacks
        A[0, 0] += rules().road_roll ** -2
        b[0] += s.roll * rules().road_roll ** -2
        out = []
        for use in (slice(0, 5), slice(3, 5)):
            P = np.diag(prior[use] ** -2.0) + A[use, use]
            x = np.linalg.solve(P, b[use])
            out.append(
                (
                    x,
                    np.linalg.inv(P),
                    0.5 * float(b[use] @ x) - 0.5 * np.linalg.slogdet(P)[1] - float(np.sum(np.log(prior[use]))),
                )
            )
        return out[0][0], out[0][1], out[0][2] - out[1][2]

    colour = Colour.of(left, nominal.vehicle.sigma)
    for _ in range(4):
        beta, covariance, _ = solve(colour, wide)
        colour = Colour.of(r - G @ beta, nominal.vehicle.sigma)
    each = []
    for c in rules().prior_scales:
        prior = used * np.array([scale * c] * 3 + [rules().axle_sigma] * 2)
        each.append(solve(colour, prior)[2])
    beta, covariance, _ = solve(colour, wide)
    if not leans:
        covariance[0, 0] = rules().road_roll ** 2
    return Turned(beta[:3], covariance[:3, :3], log_mean_exp(each), colour, beta[3:])


@dataclass(frozen=True)
class Mounted:
    """What the vehicle's motion says about the mounting.

    Parameters
    ----------
    finding : Finding, optional
        The finding, where it is worth the threshold.
    rpy : (3,) array
        Mounting that lacks, rad.
    where, after : tuples of statistics
        Disagreement before and after.
    chi_square, dof : float
        Whitened residuals on the part that was not used, (before, after), and their number.
    gain : float
        Log score gained there, nats, and its standard deviation.
    """

    finding: Finding | None
    rpy: Array
    where: tuple[Where, ...]
    after: tuple[Where, ...]
    chi_square: tuple[float, float] = (0.0, 0.0)
    dof: int = 0
    gain: tuple[float, float] = (0.0, 0.0)


def turned_recording(recording: Recording, rpy: Array) -> Recording:
    """The recording of an IMU whose mounting ``rpy`` is taken off."""
    from insemu.effects import compensated

    a, b, c = (float(x) for x in rpy)
    return compensated(recording, [EffectUse("mounting", "imu", {"rpy": (a, b, c)})])


def find_mounting(
    recording: Recording, nominal: Nominal, progress: Callable[[str], None] = lambda _: None, *, known: bool = False
) -> Mounted:
    """Weigh the mounting angles of an IMU in a vehicle that moves where it points; large ones by turning and filtering again.

    Parameters
    ----------
    recording : Recording
        A drive with fixes.
    nominal : Nominal
        What is believed.
    progress : callable
        Told what is being done.
    known : bool
        Whether the mounting is known to be wrong: what it lacks is then estimated, however little it is.

    Raises
    ------
    InputError
        The nominal filter cannot run on the recording; see :func:`insemu.gap.drive.preparation.prepare`.
    """
    C = np.eye(3)
    first: Sideways | None = None
    found: Turned | None = None
    start: Turned | None = None
    for turn in range(TURNS):
        progress(f"mounting: filter {turn + 1}")
        now = turned_recording(recording, rotation.rpy_from_dcm(C)) if turn else recording
        s = Sideways.of(prepare(now, nominal, fast_parts(now, nominal), {}))
        if s.t.size < 60:
            return Mounted(None, np.zeros(3), (), ())
        found = estimate(s, nominal)
        if first is None:
            first, start = s, found
            if found.nats < rules().least_nats and not known:
                return Mounted(None, np.zeros(3), _tests(s, found), _tests(s, found))
        C = rotation.dcm_from_rpy(found.angles) @ C
        if np.max(np.abs(found.angles)) < ENOUGH:
            break
    assert first is not None and found is not None and start is not None
    rpy = np.asarray(rotation.rpy_from_dcm(C))
    sd = np.sqrt(np.diag(found.covariance))
    values = tuple(
        Value.normal(f"rpy_{name}", m, e, "rad") for name, m, e in zip(("roll", "pitch", "yaw"), rpy, sd, strict=True)
    )
    member = Member("mounting", "imu", ("roll", "pitch", "yaw"), start.nats)
    finding = Finding(
        "mounting", "", "imu", ("roll", "pitch", "yaw"), values, 1.0 - math.exp(-start.nats), start.nats, (member,)
    )
    chi, dof, gain = _held_out(first, nominal)
    return Mounted(finding, rpy, _tests(first, replace(start, angles=np.zeros(3))), _tests(s, found), chi, dof, gain)


def _held_out(s: Sideways, nominal: Nominal) -> tuple[tuple[float, float], int, tuple[float, float]]:
    """Score the last part of the drive with the mounting of the first."""
    cut = s.t[0] + rules().mounting_share * (s.t[-1] - s.t[0])
    early, late = s.part(s.t <= cut), s.part(s.t > cut)
    if min(early.t.size, late.t.size) < 30:
        return (0.0, 0.0), 0, (0.0, 0.0)
    fit = estimate(early, nominal)
    C = rotation.dcm_from_rpy(fit.angles)
    axle = np.concatenate([np.zeros(3), fit.axle])
    before = late.residual - late.columns() @ axle
    after = (late.u @ C.T)[:, 1:].T - late.columns() @ axle
    squares = [float(np.sum(fit.colour.whiten(x, late.t)[0] ** 2)) for x in (before, after)]
    gain = 0.5 * (squares[0] - squares[1])
    return (squares[0], squares[1]), 2 * late.t.size, (gain, math.sqrt(abs(gain) + 1.0))


def _tests(s: Sideways, found: Turned) -> tuple[Where, ...]:
    """Whether the mean velocity across is zero, its colour allowed for."""
    from scipy.stats import norm

    out = []
    left = s.residual - s.columns() @ np.concatenate([found.angles, found.axle])
    for c, (name, axis) in enumerate((("sideways velocity", "y"), ("vertical velocity", "z"))):
        phi = float(found.colour.phi[c])
        sd = float(found.colour.sigma[c]) * math.sqrt((1.0 + phi) / (1.0 - phi) / s.t.size)
        p = float(2.0 * norm.sf(abs(left[c].mean()) / sd))
        out.append(Where(name, "imu", axis, None, min(1.0, 2.0 * p)))
    return tuple(out)
