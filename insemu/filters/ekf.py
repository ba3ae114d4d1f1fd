"""The loosely coupled, closed-loop error-state filter: the door to the compiled loop."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu import earth
from insemu.augment import Augmentation, Belief, StateLayout, augment
from insemu.errors import InputError
from insemu.filters import expanded, following, gpu, kernel
from insemu.filters.events import FIX_ROWS, SAME_TIME, Events, GnssSigma, aid_events, fix_events, joined
from insemu.filters.options import FilterOptions, InitialSigma, three_sigmas
from insemu.filters.results import FilterResult, FixTable, Nodes
from insemu.records import AidRecord, GnssRecord, ImuRecord, Trajectory
from insemu.strapdown import NavState

Array = NDArray[np.float64]

#: The derivative of a fix by its latency is taken from means over so many seconds: those of one step are mostly noise and vibration.
TREND_S = 0.3
#: The derivatives of a fix by lever arm and latency are taken from mean rates over so many seconds on each side of it; judged by
#: ``python -m tests.test_filters_latency``.
AROUND_S = 0.03


def trend_window(dt: float) -> int:
    """Steps of ``dt`` seconds that the derivative of a fix by its latency is taken from."""
    return 2 + max(3, round(TREND_S / dt))


def steps_around(dt: float) -> int:
    """Steps of ``dt`` seconds on each side of a fix that its derivative by the lever arm is taken from; fewer than those of the trend."""
    return max(1, round(AROUND_S / dt))


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
    q_law: NDArray[np.int64]
    time_at: NDArray[np.int64]
    time_law: NDArray[np.int64]
    time_of: Array


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
    extra = place[9:]
    coupled = (aug.Phi != 0) & (lanes[:, None] != lanes[None, :])
    if coupled.any():
        raise InputError("states of different axes are coupled in Phi, expected independent axes")
    diagonal = not (aug.Phi - np.diag(np.diag(aug.Phi))).any()
    d = np.ones((powers, expanded.LD))
    phi = np.zeros((powers, max(slots, 1), max(slots, 1), 8))
    Qs = np.zeros((powers, aug.m, aug.m))
    for p in range(powers):
        Phi, Qs[p] = aug.power(p + 1)
        d[p, extra] = np.diag(Phi)
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
        extra[rows] * expanded.LD + extra[columns],
        np.ascontiguousarray(Qs[:, rows, columns]),
        aug.law_of[rows] if aug.laws else np.zeros(0, dtype=np.int64),
        *_following_times(aug, powers, (slot, lanes, extra), phi[0].shape, offsets, (rows, columns)),
    )


def _following_times(
    aug: Augmentation,
    powers: int,
    lain: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]],
    shape: tuple[int, ...],
    offsets: NDArray[np.int64],
    driven: tuple[NDArray[np.intp], NDArray[np.intp]],
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Places in d, phi, mix and q one after the other of what follows correlation times, their laws and values: see :func:`kernel.run`.

    Parameters
    ----------
    aug, powers
        As of :func:`pack`.
    lain : tuple of (m,) arrays of int
        Slot, lane and row of the expanded covariance of every state.
    shape : tuple of int
        Of phi.
    offsets : (k,) array of int
        Distances of slots that mix.
    driven : tuple of (l,) arrays of int
        Rows and columns of the entries of q.
    """
    slot, lanes, row = lain
    mix_from = expanded.LD + math.prod(shape)
    q_from = mix_from + offsets.size * expanded.LD
    places: list[int] = []
    laws: list[int] = []
    values: list[Array] = []
    for first, law, F, V in following.tables(aug, powers):
        for i, j in np.ndindex(F.shape[2:]):
            a, b = first + i, first + j
            own = [q_from + int(k) for k in np.flatnonzero((driven[0] == a) & (driven[1] == b))]
            given = [V[:, :, i, j]] * len(own)
            offset = np.flatnonzero(offsets == slot[a] - slot[b])
            if offset.size and F[:, :, i, j].any():
                moved = [expanded.LD + int(np.ravel_multi_index((slot[a], slot[b], lanes[a]), shape))]
                moved += [mix_from + int(offset[0]) * expanded.LD + int(row[a])]
                moved += [int(row[a])] if i == j else []
                own, given = own + moved, given + [F[:, :, i, j]] * len(moved)
            places, laws, values = places + own, laws + [law] * len(own), values + given
    table = np.ascontiguousarray(np.stack(values, axis=2)) if values else np.zeros((1, 1, 0))
    return np.array(places, dtype=np.int64), np.array(laws, dtype=np.int64), table


@dataclass(frozen=True)
class _Buffers:
    """Arrays that the compiled loop fills."""

    nav: Array
    var: Array
    x: Array
    nu: Array
    S: Array
    nis: Array
    dof: NDArray[np.int64]
    ok: NDArray[np.int64]
    epoch: NDArray[np.int64]
    K: Array
    H: Array
    P: Array
    node_at: NDArray[np.int64]
    node_nav: Array
    node_x: Array
    node_dx: Array
    before: Array
    after: Array
    phi: Array
    last: Array

    @classmethod
    def of(cls, n: int, epochs: int, o: FilterOptions, events: Events, covariances: int, nodes: int) -> _Buffers:
        """Arrays for ``n`` states, so many epochs, whole covariances and nodes beside those of fixes."""
        f, w = events.z.shape
        stored = o.store == "fixes"
        rows = o.rows(epochs).size
        kept, g = (nodes + f, f) if stored else (0, 1)
        m = n - 9
        before, after, phi = (np.empty((kept, n, n)) for _ in range(3))
        return cls(
            np.empty((rows, 10)), np.empty((rows, n)), np.empty((rows, m)), np.full((f, w), np.nan), np.full((f, w, w), np.nan),
            np.full(f, np.nan), np.zeros(f, dtype=np.int64), np.zeros(f, dtype=np.int64), events.epoch.copy(), np.full((g, n, w), np.nan),
            np.full((g, w, n), np.nan), np.empty((covariances, n, n)), np.zeros(kept, dtype=np.int64), np.empty((kept, 10)),
            np.empty((kept, m)), np.empty((kept, n)), before, after, phi, np.empty((n, n)),
        )  # fmt: skip

    @classmethod
    def flown(cls, f: gpu.Flown, events: Events) -> _Buffers:
        """Those of a flight on a GPU, which stores no nodes."""
        none = np.zeros((0, 0))
        return cls(
            f.nav, f.var, f.x, f.nu, f.S, f.nis, f.dof, f.ok, events.epoch.copy(), none, none, f.covariance,
            np.zeros(0, dtype=np.int64), none, none, none, none, none, none, f.last,
        )  # fmt: skip

    def result(
        self,
        layout: StateLayout,
        t: Array,
        o: FilterOptions,
        events: Events,
        cov_epoch: NDArray[np.int64],
        nodes: int,
        seconds: float,
    ) -> FilterResult:
        """What the filter returns; ``nodes`` is how many were stored."""
        stored = o.store == "fixes"
        K, H = (self.K, self.H) if stored else (None, None)
        fixes = FixTable(
            events.t, self.epoch, events.kind, self.nu, self.S, self.nis, self.dof, self.ok.astype(bool), K, H
        )
        at = self.node_at[:nodes]
        kept = (v[:nodes] for v in (self.node_nav, self.node_x, self.before, self.after, self.phi, self.node_dx))
        return FilterResult(
            layout=layout,
            t=t[o.rows(t.size)],
            nav=self.nav,
            sigma=np.sqrt(np.maximum(self.var, 0.0, out=self.var), out=self.var),
            imu_states=self.x,
            fixes=fixes,
            covariance_t=t[cov_epoch],
            covariance=self.P,
            nodes=Nodes(t[at], at, *kept) if stored else None,
            final_covariance=self.last,
            epochs=t.size - 1,
            seconds=seconds,
        )


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
                three_sigmas(gnss_sigma[0], "gnss_sigma", unknown=True),
                three_sigmas(gnss_sigma[1], "gnss_sigma", unknown=True),
            )
        )
        self._packed = pack(self.augmentation, self.options.covariance_every)
        self._belief = belief
        #: Where flights are flown that it can fly; None: here.
        self.gpu: gpu.Gpu | None = None

    def with_options(self, **changes: Any) -> LooselyCoupledEKF:
        """The same design with some options (fields of :class:`FilterOptions`) replaced."""
        made = LooselyCoupledEKF(
            self._belief,
            self.dt,
            lever_arm=self.lever_arm,
            gravity=self.gravity,
            gnss_sigma=self.gnss_sigma,
            options=replace(self.options, **changes),
        )
        made.gpu = self.gpu
        return made

    @property
    def layout(self) -> StateLayout:
        """Names and places of the states."""
        return self.augmentation.layout

    def initial_covariance(
        self, initial_sigma: InitialSigma | ArrayLike, imu: ImuRecord | None = None, nav: Array | None = None
    ) -> Array:
        """The (n, n) covariance at the start; a full (n, n) array passes through.

        Parameters
        ----------
        initial_sigma : InitialSigma or (n, n) covariance
        imu, nav : ImuRecord, (10,) array, optional
            Record and state at the start, from which what follows a covariate begins; without them as at gain 1.
        """
        n = self.layout.n
        if not isinstance(initial_sigma, InitialSigma):
            P = np.array(initial_sigma, dtype=np.float64)
            if P.shape != (n, n) or not np.isfinite(P).all():
                raise InputError(f"the initial covariance has shape {P.shape}, expected ({n}, {n}) finite numbers")
            return 0.5 * (P + P.T)
        P = np.zeros((n, n))
        P[:9, :9] = np.diag(initial_sigma.to_array() ** 2)
        P[9:, 9:] = self.augmentation.P0
        if imu is not None and nav is not None:
            P[9:, 9:] = following.started(self.augmentation, imu, float(np.linalg.norm(nav[3:6])))
        return P

    def run(
        self,
        imu: ImuRecord,
        gnss: GnssRecord | None,
        initial: NavState | Trajectory,
        initial_sigma: InitialSigma | ArrayLike,
        *,
        aids: Sequence[AidRecord] = (),
        initial_states: ArrayLike | None = None,
    ) -> FilterResult:
        """Filter one record.

        Parameters
        ----------
        imu : ImuRecord
            Of any kind; see :meth:`~insemu.records.ImuRecord.as_increments`.
        gnss : GnssRecord or None
            Fixes at their own times: each is used at the first IMU epoch at or after it, taken back to its time. Fixes before the second
            and after the last IMU stamp are left out. Where the latency is a state, a fix's own time is its stamp less the latency as
            estimated by then, so that fixes that come late are used in the order in which they were valid.
        initial : NavState or Trajectory
            At ``imu.t[0]``; of a trajectory its first row.
        initial_sigma : InitialSigma or (n, n) covariance
        aids : sequence of AidRecord
            Further measurements, for example ``recording.aids``.
        initial_states : (n - 9,) array_like, optional
            Initial estimates of the states after the nine of navigation; zero unless given.

        Returns
        -------
        FilterResult

        Raises
        ------
        InputError
            A record with another rate, no standard deviations for the fixes, navigation that diverges, or a covariance that is not positive
            semidefinite (the message names the state).
        """
        record, nav, x0 = self.checked(imu, initial, initial_states)
        o, a, p, t = self.options, self.augmentation, self._packed, record.t
        P0 = self.initial_covariance(initial_sigma, imu, nav)
        events = self.events(t, gnss, aids)
        lever_at, latency_at = self.installation()
        cov_epoch = self.covariance_epochs(t)
        node_epoch = self._node_epochs(t, cov_epoch, events, moving=latency_at >= 0)
        gyro, accel = a.sensed(record)
        started = time.perf_counter()
        if self.gpu is not None:
            around = steps_around(self.dt) if lever_at >= 0 else 0
            design = gpu.Design(a, self._gravity, self.lever_arm, lever_at, around, o, self.thresholds(), t, cov_epoch)
            if self.gpu.takes(design, latency_at, events):
                flown = self.gpu.fly(design, gpu.Flight(np.hstack([gyro, accel]), nav, x0, P0, events))
                self._check(flown.code, flown.detail)
                b = _Buffers.flown(flown, events)
                return b.result(self.layout, t, o, events, cov_epoch, 0, time.perf_counter() - started)
        b = _Buffers.of(self.layout.n, t.size, o, events, cov_epoch.size, node_epoch.size)
        code, detail = kernel.run(
            t, gyro, accel, np.concatenate([nav, np.zeros(3)]), x0, P0, p.place, a.axis, a.c, a.driver, p.slots, p.diagonal,
            p.d, p.phi, p.offsets, p.mix, p.q_at, p.q, p.q_law, p.time_at, p.time_law, p.time_of,
            following.powers(a, imu),
            following.of_speed(a), a.white_of, a.white, self._gravity, self.lever_arm, lever_at, latency_at,
            self.thresholds(events.z.shape[1]), o.gate_timeout, o.covariance_every, o.output_every, trend_window(self.dt), steps_around(self.dt),
            SAME_TIME * self.dt,
            events.first_of, events.next_alike, events.t, events.epoch, events.kind, events.since, events.tau, events.z, events.var,
            events.settings, cov_epoch, node_epoch, o.store == "fixes", b.nav, b.var, b.x, b.nu, b.S, b.nis, b.dof, b.ok, b.epoch, b.K, b.H,
            b.P, b.node_at, b.node_nav, b.node_x, b.before, b.after, b.phi, b.node_dx, b.last,
        )  # fmt: skip
        seconds = time.perf_counter() - started
        self._check(code, detail)
        return b.result(self.layout, t, o, events, cov_epoch, detail, seconds)

    def _check(self, code: int, detail: int) -> None:
        """Say what the loop stopped at."""
        if code == 1:
            raise InputError(f"the covariance is not positive semidefinite at the state '{self.layout.names[detail]}'")
        if code == 2:
            raise InputError(f"the innovation covariance is not positive definite in component {detail}")
        if code == 3:
            raise InputError("navigation diverged (the states are not finite); is the IMU record in rad/s and m/s^2?")

    def checked(
        self, imu: ImuRecord, initial: NavState | Trajectory, initial_states: ArrayLike | None
    ) -> tuple[ImuRecord, Array, Array]:
        """The record as increments, the initial navigation state (10,) and the initial estimates of the augmented states (m,).

        Parameters
        ----------
        imu : ImuRecord
            Of any kind.
        initial : NavState or Trajectory
            At ``imu.t[0]``; of a trajectory its first row.
        initial_states : (m,) array_like, optional
            Initial estimates of the augmented states; zero unless given.

        Raises
        ------
        InputError
            Too short a record, another rate than the belief was discretised at, a start that is not finite, or states of another number.
        """
        if len(imu) < 2:
            raise InputError(f"the IMU record has {len(imu)} row(s), expected at least two")
        if abs(imu.dt / self.dt - 1.0) > 0.01:
            raise InputError(
                f"the IMU record is sampled at {1 / imu.dt:.6g} Hz, expected {1 / self.dt:.6g} Hz as the belief was discretised"
            )
        nav = (NavState.of(initial) if isinstance(initial, Trajectory) else initial).to_array()
        if not np.isfinite(nav).all() or abs(nav[0]) > np.deg2rad(89.9):
            raise InputError("the initial navigation state is not finite or within 0.1 deg of a pole")
        m = self.augmentation.m
        x0 = np.zeros(m) if initial_states is None else np.array(initial_states, dtype=np.float64)
        if x0.shape != (m,):
            raise InputError(f"initial_states has shape {x0.shape}, expected ({m},)")
        return imu.as_increments(), nav, x0

    def covariance_epochs(self, t: Array) -> NDArray[np.int64]:
        """Rows of ``t`` (n,) nearest after ``options.covariance_at``."""
        asked = np.asarray(self.options.covariance_at, dtype=np.float64)
        return np.unique(np.searchsorted(t, asked - 1e-9).clip(0, t.size - 1)).astype(np.int64)

    def _node_epochs(
        self, t: Array, cov_epoch: NDArray[np.int64], events: Events, *, moving: bool
    ) -> NDArray[np.int64]:
        """Rows at which nodes are stored whatever is measured; where fixes do not move with an estimated latency, theirs too."""
        o = self.options
        if o.store != "fixes":
            return np.zeros(0, dtype=np.int64)
        every = np.arange(t[0], t[-1], o.node_every) if o.node_every is not None else np.zeros(0)
        measured = events.epoch[:0] if moving else events.epoch
        regular = np.searchsorted(t, every - 1e-9)
        return np.unique(np.concatenate([[0], measured, regular, cov_epoch, [t.size - 1]])).astype(np.int64)

    def thresholds(self, rows: int = FIX_ROWS) -> Array:
        """Largest accepted normalised innovation squared by the number of components, (rows + 1,)."""
        out = np.full(rows + 1, np.inf)
        if self.options.gate is not None:
            out[1:] = scipy.special.chdtri(np.arange(1, rows + 1), self.options.gate)
        return out

    def installation(self) -> tuple[int, int]:
        """Place of the first lever-arm state and of the latency state, -1 where they are not carried."""
        slices = self.layout.slices
        lever, latency = (slices[name].start if name in slices else -1 for name in ("lever_arm", "latency"))
        return lever, latency

    def events(self, t: Array, gnss: GnssRecord | None, aids: Sequence[AidRecord] = ()) -> Events:
        """Fixes, aids and standstill updates in the order of the epochs at which they are used.

        Parameters
        ----------
        t : (n,) array
            Epochs of the IMU, s.
        gnss : GnssRecord or None
            Fixes at their own times.
        aids : sequence of AidRecord
            Further measurements.

        Raises
        ------
        InputError
            A fix without a standard deviation, or an aid that :func:`~insemu.filters.events.aid_events` refuses.
        """
        parts: list[Events] = []
        if gnss is not None:
            parts.append(fix_events(t, self.dt, gnss, self.gnss_sigma, imposed=self.options.imposed_gnss_sigma))
        still = None if self.options.standstill is None else self.options.standstill.record(t)
        parts += [aid_events(t, self.dt, aid) for aid in (*aids, still) if aid is not None]
        return joined(parts) if parts else Events.none()


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
    aids: Sequence[AidRecord] = (),
    initial_states: ArrayLike | None = None,
) -> FilterResult:
    """Filter one record with one belief: :class:`LooselyCoupledEKF` made and run once, at the record's own rate.

    Parameters
    ----------
    imu : ImuRecord
    gnss : GnssRecord or None
    initial : NavState or Trajectory
        At ``imu.t[0]``; of a trajectory its first row.
    initial_sigma : InitialSigma or (n, n) covariance
    belief : mapping of axis to NoiseModel
        See :func:`insemu.augment.augment`.
    lever_arm : (3,) array_like
        From IMU to antenna, m, body axes.
    gravity : {"normal", "free_air_first_order"}
    gnss_sigma : (position, velocity), optional
        Standard deviations, m and m/s, used where the record carries none.
    options : FilterOptions, optional
    aids : sequence of AidRecord
        Further measurements.
    initial_states : (n - 9,) array_like, optional
        Initial estimates of the augmented states; zero unless given.

    Raises
    ------
    InputError
        As :class:`LooselyCoupledEKF` and :meth:`LooselyCoupledEKF.run`.
    """
    ekf = LooselyCoupledEKF(
        belief, imu.dt, lever_arm=lever_arm, gravity=gravity, gnss_sigma=gnss_sigma, options=options
    )
    return ekf.run(imu, gnss, initial, initial_sigma, aids=aids, initial_states=initial_states)
