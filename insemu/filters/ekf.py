"""The loosely coupled, closed-loop error-state filter: what it is told, what it returns, and the door to the compiled loop."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2

from insemu import earth
from insemu.augment import Augmentation, Belief, Extras, StateLayout, augment
from insemu.errors import InputError
from insemu.filters import expanded, kernel
from insemu.records import GnssRecord, ImuRecord, Trajectory
from insemu.strapdown import NavState, trajectory_of

Array = NDArray[np.float64]
Store = Literal["none", "fixes"]


def _three(value: ArrayLike | None, name: str, *, unknown: bool = False) -> Array:
    """Three standard deviations; where ``unknown`` is allowed, None or NaN stand for "not known"."""
    out = np.array(np.broadcast_to(np.asarray(np.nan if value is None else value, dtype=np.float64), (3,)))
    if not (((np.isfinite(out)) & (out >= 0)) | (np.isnan(out) & unknown)).all():
        raise InputError(
            f"{name} is {np.asarray(value).tolist()}, expected one or three standard deviations that are not negative"
        )
    return out


@dataclass(frozen=True)
class InitialSigma:
    """What is believed about the initial navigation state: standard deviations, each a scalar or north, east, down.

    Parameters
    ----------
    position : m
    velocity : m/s
    attitude : rad about north, east and down
    """

    position: ArrayLike = 1.0
    velocity: ArrayLike = 0.1
    attitude: ArrayLike = (0.01, 0.01, 0.03)

    def to_array(self) -> Array:
        """The nine standard deviations."""
        return np.concatenate(
            [_three(getattr(self, name), f"initial {name} sigma") for name in ("position", "velocity", "attitude")]
        )


@dataclass(frozen=True)
class Standstill:
    """Intervals in which the vehicle is known to stand still: zero velocity and zero angular rate are fed as measurements.

    Parameters
    ----------
    intervals : sequence of (start, end)
        s, on the IMU's clock.
    every : float
        Seconds between updates.
    velocity_sigma, rate_sigma : float
        m/s and rad/s; infinite leaves that part out.
    """

    intervals: Sequence[tuple[float, float]]
    every: float = 1.0
    velocity_sigma: float = 0.01
    rate_sigma: float = 1e-4


@dataclass(frozen=True)
class FilterOptions:
    """How the filter runs; what it believes is not here.

    Parameters
    ----------
    covariance_every : int
        Covariance propagated every n-th IMU epoch (and at every fix); 1 is full rate.
    output_every : int
        A row of the result every n-th IMU epoch; a multiple of ``covariance_every``.
    gate : float, optional
        Probability with which a good fix is rejected by the test of its normalised innovation squared; None: no gate.
    store : {"none", "fixes"}
        ``fixes`` keeps covariances, transition and gain at every node for the smoother and the gap room.
    node_every : float, optional
        With ``store="fixes"``: nodes also every so many seconds without a fix.
    covariance_at : sequence of float
        Times in s at which the whole covariance is kept; with ``store="fixes"`` these are nodes too.
    extras : Extras
        Calibration and installation states to be estimated.
    standstill : Standstill, optional
        Zero-velocity and zero-rate updates.
    imposed_gnss_sigma : bool
        Use the filter's ``gnss_sigma`` even where the record states its own.
    """

    covariance_every: int = 1
    output_every: int = 1
    gate: float | None = None
    store: Store = "none"
    node_every: float | None = None
    covariance_at: Sequence[float] = ()
    extras: Extras = field(default_factory=Extras)
    standstill: Standstill | None = None
    imposed_gnss_sigma: bool = False

    def __post_init__(self) -> None:
        for name in ("covariance_every", "output_every"):
            value = getattr(self, name)
            if not (isinstance(value, int) and value >= 1):
                raise InputError(f"{name} is {value!r}, expected a whole number of at least 1")
        if self.output_every % self.covariance_every:
            raise InputError(
                f"output_every is {self.output_every}, expected a multiple of covariance_every ({self.covariance_every})"
            )
        if self.gate is not None and not 0.0 < self.gate < 1.0:
            raise InputError(f"gate is {self.gate!r}, expected a probability between 0 and 1, for example 1e-4")
        if self.store not in get_args(Store):
            raise InputError(f"store is '{self.store}', expected one of: {', '.join(get_args(Store))}")
        if self.node_every is not None and not self.node_every > 0:
            raise InputError(f"node_every is {self.node_every!r}, expected a positive number of seconds")


@dataclass(frozen=True)
class FixTable:
    """What happened at every fix.

    Parameters
    ----------
    t : (f,) array
        Time of validity, s.
    epoch : (f,) array of int
        IMU row at which it was used.
    kind : (f,) array of int
        0: GNSS (components: position north, east, down, velocity); 1: standstill (velocity, angular rate x, y, z).
    innovation : (f, 6) array
        Measured minus predicted, m and m/s; NaN where a component is missing.
    S : (f, 6, 6) array
        Innovation covariance; NaN in rows and columns of missing components.
    nis : (f,) array
        Normalised innovation squared, chi-square with ``dof`` degrees of freedom.
    dof : (f,) array of int
        Components used; 0 for a fix of NaN.
    accepted : (f,) array of bool
    K : (f, n, 6) array, optional
        Gain: the states move by ``K innovation``.
    H : (f, 6, n) array, optional
        Derivative of the predicted fix by the errors.
    """

    t: Array
    epoch: NDArray[np.int64]
    kind: NDArray[np.int64]
    innovation: Array
    S: Array
    nis: Array
    dof: NDArray[np.int64]
    accepted: NDArray[np.bool_]
    K: Array | None = None
    H: Array | None = None

    def __len__(self) -> int:
        return self.t.size

    @property
    def rejected(self) -> NDArray[np.int64]:
        """Indices of the fixes that the gate kept out."""
        return np.nonzero(~self.accepted & (self.dof > 0))[0]


@dataclass(frozen=True)
class Nodes:
    """The filter at fixes and at regular times between them: what a smoother needs, and what the gap room reads.

    Parameters
    ----------
    t : (k,) array
    epoch : (k,) array of int
    nav : (k, 10) array
        Navigation state after the update.
    states : (k, n - 9) array
        Estimates of the states behind, after the update.
    P_before, P_after : (k, n, n) arrays
        Covariance before and after the update.
    Phi : (k, n, n) array
        Transition of the errors from the previous node (for the first, from the start) to this one.
    correction : (k, n) array
        Estimated error that the update took off.
    """

    t: Array
    epoch: NDArray[np.int64]
    nav: Array
    states: Array
    P_before: Array
    P_after: Array
    Phi: Array
    correction: Array

    def __len__(self) -> int:
        return self.t.size


@dataclass(frozen=True)
class FilterResult:
    """What a filter says about one record; see ``docs/filters.md``."""

    layout: StateLayout
    t: Array
    nav: Array
    sigma: Array
    imu_states: Array
    fixes: FixTable
    covariance_t: Array
    covariance: Array
    nodes: Nodes | None
    final_covariance: Array
    epochs: int
    seconds: float

    @cached_property
    def trajectory(self) -> Trajectory:
        """The estimated trajectory at the output times."""
        return trajectory_of(self.t, self.nav, "filter")


@dataclass(frozen=True)
class Packed:
    """The augmentation in the compiled loop's slots."""

    place: NDArray[np.int64]
    slots: int
    diagonal: bool
    d: Array
    phi: Array
    offsets: NDArray[np.int64]
    mix: Array
    q_at: NDArray[np.int64]
    q: Array


def pack(aug: Augmentation, powers: int) -> Packed:
    """Lay an augmentation out in slots, with the transitions over 1 to ``powers`` samples."""
    lanes = np.where(aug.axis >= 0, aug.axis, 0)
    slot = np.zeros(aug.m, dtype=np.int64)
    used = np.zeros(6, dtype=np.int64)
    for s in np.nonzero(aug.axis >= 0)[0]:
        slot[s] = used[lanes[s]]
        used[lanes[s]] += 1
    slots = int(used.max(initial=0))
    loose = np.nonzero(aug.axis < 0)[0]  # no axis sees them: one more slot, any lanes
    for i, s in enumerate(loose):
        slot[s], lanes[s] = slots + i // 6, i % 6
    slots += -(-loose.size // 6)
    if slots > expanded.MAX_SLOTS:
        raise InputError(f"an axis carries {slots} states, expected at most {expanded.MAX_SLOTS}")
    place = np.concatenate([np.arange(9), expanded.FIRST + 8 * slot + lanes]).astype(np.int64)
    behind = place[9:]
    coupled = (aug.Phi != 0) & (lanes[:, None] != lanes[None, :])
    if coupled.any():
        raise InputError("states of different axes are coupled in Phi, expected independent axes")
    diagonal = not (aug.Phi - np.diag(np.diag(aug.Phi))).any()
    d = np.ones((powers, expanded.LD))
    phi = np.zeros((powers, max(slots, 1), max(slots, 1), 8))
    Qs = np.zeros((powers, aug.m, aug.m))
    for p in range(powers):
        Phi, Qs[p] = aug.power(p + 1)
        d[p, behind] = np.diag(Phi)
        for i, j in zip(*np.nonzero(Phi), strict=True):
            phi[p, slot[i], slot[j], lanes[i]] = Phi[i, j]
    far = {0} | {int(a - b) for a, b in np.argwhere((phi != 0).any(axis=(0, 3)))}
    offsets = np.array(sorted(far, key=lambda o: (o != 0, o)), dtype=np.int64)
    mix = np.zeros((powers, offsets.size, expanded.LD))
    for row, o in enumerate(sorted(far, key=lambda o: (o != 0, o))):
        for k in range(max(o, 0), min(slots, slots + o)):
            at = expanded.FIRST + 8 * k
            mix[:, row, at : at + 8] = phi[:, k, k - o]
    rows, columns = np.nonzero((Qs != 0).any(axis=0))
    return Packed(
        place,
        slots,
        diagonal,
        d,
        phi,
        offsets,
        mix,
        behind[rows] * expanded.LD + behind[columns],
        np.ascontiguousarray(Qs[:, rows, columns]),
    )


GnssSigma = tuple[ArrayLike | None, ArrayLike | None]


class LooselyCoupledEKF:
    """One design: a belief, generated states, options. Flies any number of records, from any number of threads.

    Parameters
    ----------
    belief : mapping of axis to NoiseModel
        See :func:`insemu.augment.augment`.
    dt : float
        Nominal sampling interval, s; records must have it to 1 %.
    lever_arm : (3,) array_like
        From IMU to antenna, m, body axes.
    gravity : {"normal", "free_air_first_order"}
    gnss_sigma : (position, velocity), optional
        Standard deviations, m and m/s, scalars or north, east, down; used where the record carries none.
    options : FilterOptions

    Raises
    ------
    InputError
        See :func:`~insemu.augment.augment`.
    """

    def __init__(
        self,
        belief: Belief,
        dt: float,
        *,
        lever_arm: ArrayLike = (0.0, 0.0, 0.0),
        gravity: str = "normal",
        gnss_sigma: GnssSigma | None = None,
        options: FilterOptions | None = None,
    ) -> None:
        self.options = options or FilterOptions()
        self.augmentation = augment(belief, dt, self.options.extras)
        self.dt = dt
        self.gravity = gravity
        self._gravity = earth.gravity_code(gravity)
        self.lever_arm = np.array(np.broadcast_to(np.asarray(lever_arm, dtype=np.float64), (3,)))
        if not np.isfinite(self.lever_arm).all():
            raise InputError(f"lever_arm is {np.asarray(lever_arm).tolist()}, expected three finite numbers of metres")
        self.gnss_sigma = (
            None
            if gnss_sigma is None
            else (
                _three(gnss_sigma[0], "gnss_sigma", unknown=True),
                _three(gnss_sigma[1], "gnss_sigma", unknown=True),
            )
        )
        self._packed = pack(self.augmentation, self.options.covariance_every)

        self._belief = belief

    def with_options(self, **changes: Any) -> LooselyCoupledEKF:
        """The same design with some options (fields of :class:`FilterOptions`) replaced."""
        return LooselyCoupledEKF(
            self._belief,
            self.dt,
            lever_arm=self.lever_arm,
            gravity=self.gravity,
            gnss_sigma=self.gnss_sigma,
            options=replace(self.options, **changes),
        )

    @property
    def layout(self) -> StateLayout:
        """Names and places of the states."""
        return self.augmentation.layout

    def initial_covariance(self, initial_sigma: InitialSigma | ArrayLike) -> Array:
        """The (n, n) covariance at the start; a full (n, n) array passes through."""
        n = self.layout.n
        if not isinstance(initial_sigma, InitialSigma):
            P = np.array(initial_sigma, dtype=np.float64)
            if P.shape != (n, n) or not np.isfinite(P).all():
                raise InputError(f"the initial covariance has shape {P.shape}, expected ({n}, {n}) finite numbers")
            return 0.5 * (P + P.T)
        P = np.zeros((n, n))
        P[:9, :9] = np.diag(initial_sigma.to_array() ** 2)
        P[9:, 9:] = self.augmentation.P0
        return P

    def run(
        self,
        imu: ImuRecord,
        gnss: GnssRecord | None,
        initial: NavState | Trajectory,
        initial_sigma: InitialSigma | ArrayLike,
        *,
        initial_states: ArrayLike | None = None,
    ) -> FilterResult:
        """Filter one record.

        Parameters
        ----------
        imu : ImuRecord
            Of any kind; see :meth:`~insemu.records.ImuRecord.as_increments`.
        gnss : GnssRecord or None
            Fixes at their own times: each is used at the first IMU epoch at or after it, taken back to its time. Fixes before the second
            and after the last IMU stamp are left out.
        initial : NavState or Trajectory
            At ``imu.t[0]``; of a trajectory its first row.
        initial_sigma : InitialSigma or (n, n) covariance
        initial_states : (n - 9,) array_like, optional
            Initial estimates of the states behind; zero unless given.

        Returns
        -------
        FilterResult

        Raises
        ------
        InputError
            A record with another rate, no standard deviations for the fixes, navigation that diverges, or a covariance that is not positive
            semidefinite (the message names the state).
        """
        if len(imu) < 2:
            raise InputError(f"the IMU record has {len(imu)} row(s), expected at least two")
        if abs(imu.dt / self.dt - 1.0) > 0.01:
            raise InputError(
                f"the IMU record is sampled at {1 / imu.dt:.6g} Hz, expected {1 / self.dt:.6g} Hz as the belief was discretised"
            )
        record = imu.as_increments()
        if isinstance(initial, Trajectory):
            initial = NavState.of(initial)
        nav = initial.to_array()
        if not np.isfinite(nav).all() or abs(nav[0]) > np.deg2rad(89.9):
            raise InputError("the initial navigation state is not finite or within 0.1 deg of a pole")
        nav = np.concatenate([nav, np.zeros(3)])
        o, n, m = self.options, self.layout.n, self.augmentation.m
        P0 = self.initial_covariance(initial_sigma)
        x0 = np.zeros(m) if initial_states is None else np.array(initial_states, dtype=np.float64)
        if x0.shape != (m,):
            raise InputError(f"initial_states has shape {x0.shape}, expected ({m},)")
        t = record.t
        events = self.events(t, gnss)
        f = events.t.size
        cov_epoch = np.unique(
            np.searchsorted(t, np.asarray(o.covariance_at, dtype=np.float64) - 1e-9).clip(0, t.size - 1)
        )
        node_epoch = np.zeros(0, dtype=np.int64)
        if o.store == "fixes":
            regular = np.zeros(0, dtype=np.int64)
            if o.node_every is not None:
                regular = np.searchsorted(t, np.arange(t[0], t[-1], o.node_every) - 1e-9)
            node_epoch = np.unique(np.concatenate([[0], events.epoch, regular, cov_epoch, [t.size - 1]])).astype(
                np.int64
            )
        rows = (t.size - 1) // o.output_every + 1 + ((t.size - 1) % o.output_every != 0)
        stored = o.store == "fixes"
        kept, g = node_epoch.size, (f if stored else 1)
        out_nav, out_var, out_x = np.empty((rows, 10)), np.empty((rows, n)), np.empty((rows, m))
        nu, S, nis = np.full((f, 6), np.nan), np.full((f, 6, 6), np.nan), np.full(f, np.nan)
        dof, ok = np.zeros(f, dtype=np.int64), np.zeros(f, dtype=np.int64)
        K, H = np.full((g, n, 6), np.nan), np.full((g, 6, n), np.nan)
        out_P = np.empty((cov_epoch.size, n, n))
        node_nav, node_x, node_dx = np.empty((kept, 10)), np.empty((kept, m)), np.empty((kept, n))
        before, after, phi = (np.empty((kept, n, n)) for _ in range(3))
        P = np.empty((n, n))
        lever_at, latency_at = self.installation()
        a, p = self.augmentation, self._packed
        started = time.perf_counter()
        code, detail = kernel.run(
            t, record.gyro, record.accel, nav, x0, P0, p.place, a.axis, a.c, a.driver, p.slots, p.diagonal, p.d, p.phi, p.offsets, p.mix, p.q_at, p.q,
            a.white, self._gravity, self.lever_arm, lever_at, latency_at, self.thresholds(), o.covariance_every, o.output_every,
            events.epoch, events.kind, events.since, events.tau, events.z, events.var, cov_epoch, node_epoch, stored,
            out_nav, out_var, out_x, nu, S, nis, dof, ok, K, H, out_P, node_nav, node_x, before, after, phi, node_dx, P,
        )  # fmt: skip
        seconds = time.perf_counter() - started
        if code == 1:
            raise InputError(f"the covariance is not positive semidefinite at the state '{self.layout.names[detail]}'")
        if code == 2:
            raise InputError(f"the innovation covariance is not positive definite in component {detail}")
        if code == 3:
            raise InputError("navigation diverged (the states are not finite); is the IMU record in rad/s and m/s^2?")
        fixes = FixTable(
            events.t,
            events.epoch,
            events.kind,
            nu,
            S,
            nis,
            dof,
            ok.astype(bool),
            K if stored else None,
            H if stored else None,
        )
        nodes = Nodes(t[node_epoch], node_epoch, node_nav, node_x, before, after, phi, node_dx) if stored else None
        out_rows = np.unique(np.append(np.arange(0, t.size, o.output_every), t.size - 1))
        return FilterResult(
            self.layout,
            t[out_rows],
            out_nav,
            np.sqrt(np.maximum(out_var, 0.0)),
            out_x,
            fixes,
            t[cov_epoch],
            out_P,
            nodes,
            P,
            t.size - 1,
            seconds,
        )

    def thresholds(self) -> Array:
        """Largest accepted normalised innovation squared by the number of components, (7,)."""
        out = np.full(7, np.inf)
        if self.options.gate is not None:
            out[1:] = chi2.isf(self.options.gate, np.arange(1, 7))
        return out

    def installation(self) -> tuple[int, int]:
        """Place of the first lever-arm state and of the latency state, -1 where they are not carried."""
        slices = self.layout.slices
        lever, latency = (slices[name].start if name in slices else -1 for name in ("lever_arm", "latency"))
        return lever, latency

    def events(self, t: Array, gnss: GnssRecord | None) -> _Events:
        """Fixes and standstill updates in the order of the epochs at which they are used."""
        parts: list[_Events] = []
        if gnss is not None:
            tolerance = 1e-6 * self.dt
            inside = np.nonzero((gnss.t > t[0] + tolerance) & (gnss.t <= t[-1] + tolerance))[0]
            times = gnss.t[inside]
            epoch = np.searchsorted(t, times - tolerance).astype(np.int64)
            z = np.full((inside.size, 6), np.nan)
            var = np.full((inside.size, 6), np.nan)
            z[:, :3] = gnss.llh[inside]
            var[:, :3] = self._variance(gnss.pos_std_ned, inside, 0)
            if gnss.vel_ned is not None:
                z[:, 3:] = gnss.vel_ned[inside]
                var[:, 3:] = self._variance(gnss.vel_std_ned, inside, 1)
            missing = np.isfinite(z) & ~(var > 0)
            if missing.any():
                k, i = np.argwhere(missing)[0]
                raise InputError(
                    f"the fix at {times[k]:g} s has no positive standard deviation for {'position' if i < 3 else 'velocity'}; expected one in "
                    "the record or gnss_sigma"
                )
            tau = t[epoch] - times
            tau[np.abs(tau) < tolerance] = 0.0
            parts.append(_Events(times, epoch, np.zeros(inside.size, dtype=np.int64), epoch, tau, z, var))
        if self.options.standstill is not None:
            s = self.options.standstill
            times = np.unique(
                np.concatenate([np.arange(a + s.every, b, s.every) for a, b in s.intervals] or [np.zeros(0)])
            )
            times = times[(times > t[0]) & (times <= t[-1])]
            epoch = np.searchsorted(t, times - 1e-6 * self.dt).astype(np.int64)
            since = np.minimum(np.searchsorted(t, times - s.every - 1e-6 * self.dt).astype(np.int64), epoch - 1)
            var = np.tile(np.repeat([s.velocity_sigma**2, s.rate_sigma**2], 3), (times.size, 1))
            kind, none_late, zero = np.ones(times.size, dtype=np.int64), np.zeros(times.size), np.zeros_like(var)
            parts.append(_Events(t[epoch], epoch, kind, since, none_late, zero, var))
        if not parts:
            nothing, none = np.zeros(0), np.zeros(0, dtype=np.int64)
            return _Events(nothing, none, none, none, nothing, np.zeros((0, 6)), np.zeros((0, 6)))
        joined = [np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(_Events)]
        order = np.argsort(joined[1], kind="stable")
        return _Events(*(np.ascontiguousarray(v[order]) for v in joined))

    def _variance(self, stated: Array | None, rows: NDArray[np.int64], which: int) -> Array:
        if stated is not None and not (self.options.imposed_gnss_sigma and self.gnss_sigma is not None):
            return np.asarray(stated[rows] ** 2)
        if self.gnss_sigma is not None:
            return np.asarray(np.tile(self.gnss_sigma[which] ** 2, (rows.size, 1)))
        return np.full((rows.size, 3), np.nan)


@dataclass(frozen=True)
class _Events:
    t: Array
    epoch: NDArray[np.int64]
    kind: NDArray[np.int64]
    since: NDArray[np.int64]  # epoch after which the rate of a standstill is averaged
    tau: Array
    z: Array
    var: Array


def run_filter(
    imu: ImuRecord,
    gnss: GnssRecord | None,
    initial: NavState | Trajectory,
    initial_sigma: InitialSigma | ArrayLike,
    belief: Belief,
    *,
    lever_arm: ArrayLike = (0.0, 0.0, 0.0),
    gravity: str = "normal",
    gnss_sigma: GnssSigma | None = None,
    options: FilterOptions | None = None,
    initial_states: ArrayLike | None = None,
) -> FilterResult:
    """Filter one record with one belief: :class:`LooselyCoupledEKF` made and run once, at the record's own rate."""
    ekf = LooselyCoupledEKF(
        belief, imu.dt, lever_arm=lever_arm, gravity=gravity, gnss_sigma=gnss_sigma, options=options
    )
    return ekf.run(imu, gnss, initial, initial_sigma, initial_states=initial_states)
