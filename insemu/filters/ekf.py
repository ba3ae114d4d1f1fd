"""The closed-loop error-state filter, loosely or tightly coupled: the door to the compiled loop."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

from insemu import earth, lanes
from insemu.augment import Belief, StateLayout, augment
from insemu.errors import InputError
from insemu.filters import following, kernel
from insemu.filters.buffers import Buffers
from insemu.filters.events import FIX_ROWS, SAME_TIME, Events, GnssSigma, aid_events, fix_events, joined, raw_events
from insemu.filters.events import side_by_side as beside
from insemu.filters.families import Family
from insemu.filters.measurements import FIX
from insemu.filters.options import FilterOptions, InitialSigma, three_sigmas
from insemu.filters.packed import Plan, Samples, Start, pack
from insemu.filters.results import FilterResult
from insemu.records import AidRecord, GnssRecord, ImuRecord, RawRecord, Trajectory
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


DIVERGED = "navigation diverged (the states are not finite); is the IMU record in rad/s and m/s^2?"
#: Sampling intervals that differ by less than this share are one: the states of a belief change over many of them.
SAME_RATE = 0.01


class Flight(NamedTuple):
    """One record as the compiled loop takes it."""

    samples: Samples
    start: Start
    events: Events

    def times(self, fixes: bool) -> tuple[bytes, ...]:
        """The same for flights that can fly side by side; with ``fixes`` only where those have the same times, too."""
        e = self.events
        own = np.unique(e.t[e.kind == FIX]).size < np.count_nonzero(e.kind == FIX)
        rows = slice(None) if fixes or own else e.kind != FIX
        parts = [v[rows].tobytes() for v in (e.t, e.epoch, e.kind, e.since, e.tau, e.settings)]
        return self.samples.t.tobytes(), *parts


class LooselyCoupledEKF:
    """One design: a belief, generated states, options. Flies any number of records, from any number of threads.

    Parameters
    ----------
    belief : mapping of axis to NoiseModel
        See :func:`insemu.augment.augment`.
    dt : float
        Sampling interval that the belief is discretised at, s; a record of another one is flown by the same belief discretised at its own.
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

    #: Keyword arguments that a derived class was made with, beyond those below.
    settings: Mapping[str, Any] = {}

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
        if self.options.family.again and self.options.extras.latency > 0:
            raise InputError(
                "a filter that linearizes a measurement again carries no state of the latency, expected latency 0"
            )
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
        self._side_by_side = pack(self.augmentation, self.options.covariance_every, side_by_side=True)
        self._belief = belief

    def with_options(self, **changes: Any) -> LooselyCoupledEKF:
        """The same design with some options (fields of :class:`FilterOptions`) replaced."""
        return self.again(self.dt, replace(self.options, **changes))

    def at_rate_of(self, imu: ImuRecord) -> LooselyCoupledEKF:
        """The same design discretised at the sampling interval of a record; itself where that is within :data:`SAME_RATE` of its own."""
        return self if abs(imu.dt / self.dt - 1.0) <= SAME_RATE else self.again(imu.dt, self.options)

    def again(
        self, dt: float, options: FilterOptions, kind: type[LooselyCoupledEKF] | None = None
    ) -> LooselyCoupledEKF:
        """The same design with another sampling interval, other options, or flown by another kind of filter, without settings of its own."""
        return (kind or type(self))(
            self._belief,
            dt,
            lever_arm=self.lever_arm,
            gravity=self.gravity,
            gnss_sigma=self.gnss_sigma,
            options=options,
            **({} if kind else self.settings),
        )

    @property
    def first_order(self) -> bool:
        """Whether it is the extended Kalman filter itself, which linear analyses hold for."""
        return self.options.family == Family() and self.clock_at < 0

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
        gnss: GnssRecord | RawRecord | None,
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
        gnss : GnssRecord, RawRecord or None
            Fixes, or raw observations where the clock is a state (tightly coupled), at their own times: each is used at the first IMU epoch at
            or after it, taken back to its time. What comes before the second and after the last IMU stamp is left out. Where the latency is a
            state, a fix's own time is its stamp less the latency as estimated by then, so that fixes that come late are used in the order in
            which they were valid.
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
            No standard deviations for the fixes, navigation that diverges, or a covariance that is not positive
            semidefinite (the message names the state).
        """
        here = self.at_rate_of(imu)
        flight = here._prepared(imu, gnss, initial, initial_sigma, aids, initial_states)
        (out,) = here._fly([flight], side_by_side=False)
        if isinstance(out, InputError):
            raise out
        return out

    def run_many(
        self,
        imus: Sequence[ImuRecord],
        gnsses: Sequence[GnssRecord | RawRecord | None],
        initials: Sequence[NavState | Trajectory],
        initial_sigma: InitialSigma | ArrayLike,
        *,
        aids: Sequence[Sequence[AidRecord]] | None = None,
        initial_states: Sequence[ArrayLike | None] | None = None,
    ) -> list[FilterResult | InputError]:
        """Filter several records of the same times, :data:`~insemu.lanes.LANES` at a time in the lanes of the processor's vectors.

        A record's numbers are the same whichever others fly beside it, and those of :meth:`run` to rounding. Records of other times or with other
        aids fly apart, and so do fixes of other times where the covariance moves over several epochs or nodes are stored; where the latency is a
        state, each record flies by itself.

        Parameters
        ----------
        imus, gnsses, initials : sequences of ImuRecord, GnssRecord, RawRecord or None, NavState or Trajectory
            As in :meth:`run`, one for each realization.
        initial_sigma : InitialSigma or (n, n) covariance
            Of all.
        aids, initial_states : sequences, optional
            As in :meth:`run`, one for each realization.

        Returns
        -------
        list of FilterResult or InputError
            What went wrong with one is returned in its place; the others are not touched by it.
        """
        out: dict[int, FilterResult | InputError] = {}
        alike: dict[tuple[Any, ...], list[tuple[int, Flight]]] = {}
        # where every epoch moves the covariance and no node is stored, a fix of another lane changes nothing
        fixes = self.options.covariance_every > 1 or self.options.store != "none"
        for k, given in enumerate(zip(imus, gnsses, initials, strict=True)):
            beside = () if aids is None else aids[k], None if initial_states is None else initial_states[k]
            try:
                if self.at_rate_of(given[0]) is not self:
                    out[k] = self.run(*given, initial_sigma, aids=beside[0], initial_states=beside[1])
                    continue
                flight = self._prepared(*given, initial_sigma, *beside)
            except InputError as error:
                out[k] = error
                continue
            alike.setdefault((k,) if self.installation()[1] >= 0 else flight.times(fixes), []).append((k, flight))
        for same in alike.values():
            for first in range(0, len(same), lanes.LANES):
                part = same[first : first + lanes.LANES]
                flights = [flight for _, flight in part]
                flown = self._fly(flights, side_by_side=self.installation()[1] < 0)
                out |= dict(zip((k for k, _ in part), flown, strict=True))
        return [out[k] for k in range(len(imus))]

    def _prepared(
        self,
        imu: ImuRecord,
        gnss: GnssRecord | RawRecord | None,
        initial: NavState | Trajectory,
        initial_sigma: InitialSigma | ArrayLike,
        aids: Sequence[AidRecord],
        initial_states: ArrayLike | None,
    ) -> Flight:
        """A record as the compiled loop takes it; arguments as of :meth:`run`."""
        record, nav, x0 = self.checked(imu, initial, initial_states)
        P0 = self.initial_covariance(initial_sigma, imu, nav)
        gyro, accel = self.augmentation.sensed(record)
        samples = Samples(record.t, gyro, accel, following.powers(self.augmentation, imu))
        return Flight(samples, Start(nav, x0, P0), self.events(record.t, gnss, aids))

    def plan(self, t: Array, events: Events) -> Plan:
        """How a flight runs; ``t`` (n,) are the epochs, s."""
        o, (lever_at, latency_at), at = self.options, self.installation(), self.covariance_epochs(t)
        clock_at = self.clock_at
        return Plan(
            self._gravity, self.lever_arm, lever_at, latency_at, clock_at, self.thresholds(events.z.shape[1]), o.gate_timeout,
            o.covariance_every, o.output_every, trend_window(self.dt), steps_around(self.dt), SAME_TIME * self.dt, o.store == "fixes", at,
            self._node_epochs(t, at, events, moving=latency_at >= 0),
        )  # fmt: skip

    def _fly(self, flights: Sequence[Flight], *, side_by_side: bool) -> list[FilterResult | InputError]:
        """Flights of the same times through the compiled loop: one as numbers, or up to :data:`~insemu.lanes.LANES` in lanes."""
        started = time.perf_counter()
        t = flights[0].samples.t
        each, own_rows = beside([f.events for f in flights])
        events = each[0]
        plan = self.plan(t, events)
        b = Buffers.of(
            self.layout.n,
            t.size,
            self.options,
            events,
            plan.cov_epoch.size,
            plan.node_epoch.size,
            side_by_side=side_by_side,
        )
        status = np.zeros((2, lanes.LANES) if side_by_side else 2)
        filled = [*flights, *[flights[0]] * (lanes.LANES - len(flights))] if side_by_side else flights

        def stacked(values: Iterable[Array]) -> Any:
            return lanes.stacked(list(values)) if side_by_side else next(iter(values))

        def rows(values: Iterable[Array]) -> Any:
            return tuple(values) if side_by_side else next(iter(values))

        samples = Samples(t, *(rows(v) for v in list(zip(*(f.samples for f in filled), strict=True))[1:]))
        starts = (f.start._replace(nav=np.concatenate([f.start.nav, np.zeros(3)])) for f in filled)
        start = Start(*(stacked(v) for v in zip(*starts, strict=True)))
        measured = events._replace(z=stacked(e.z for e in each), var=stacked(e.var for e in each))
        try:
            stored = kernel.run(
                samples,
                start,
                self._side_by_side.in_lanes() if side_by_side else self._packed,
                measured,
                plan,
                self.options.family.carry,
                b.in_lanes() if side_by_side else b,
                lanes.lanes_of(status) if side_by_side else status,
            )
        except ZeroDivisionError:  # a divisor was lost against something huge
            return [InputError(DIVERGED)]
        seconds = (time.perf_counter() - started) / len(flights)
        out: list[FilterResult | InputError] = []
        for lane, flight in enumerate(flights):
            wrong = self._wrong(*(status[:, lane] if side_by_side else status).astype(int))
            own = b.of_lane(lane, own_rows[lane]) if side_by_side else b
            out.append(
                wrong or own.result(self.layout, t, self.options, flight.events, plan.cov_epoch, stored, seconds)
            )
        return out

    def _wrong(self, code: int, detail: int) -> InputError | None:
        """What the loop stopped at, if anything."""
        if code == 1:
            return InputError(f"the covariance is not positive semidefinite at the state '{self.layout.names[detail]}'")
        if code == 2:
            return InputError(f"the innovation covariance is not positive definite in component {detail}")
        if code == 3:
            return InputError(DIVERGED)
        return None

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
            Too short a record, a start that is not finite, or states of another number.
        """
        if len(imu) < 2:
            raise InputError(f"the IMU record has {len(imu)} row(s), expected at least two")
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

    @property
    def clock_at(self) -> int:
        """Place of the bias of the receiver's clock, -1 where it is not carried."""
        return self.layout.slices["clock"].start if "clock" in self.layout.slices else -1

    def events(self, t: Array, gnss: GnssRecord | RawRecord | None, aids: Sequence[AidRecord] = ()) -> Events:
        """Fixes, aids and standstill updates in the order of the epochs at which they are used.

        Parameters
        ----------
        t : (n,) array
            Epochs of the IMU, s.
        gnss : GnssRecord, RawRecord or None
            Fixes or raw observations at their own times.
        aids : sequence of AidRecord
            Further measurements.

        Raises
        ------
        InputError
            A fix without a standard deviation, raw observations without the states that they need, or an aid that
            :func:`~insemu.filters.events.aid_events` refuses.
        """
        parts: list[Events] = []
        if isinstance(gnss, RawRecord):
            if self.clock_at < 0 or max(self.installation()) >= 0:
                raise InputError(
                    "raw observations need the states of the clock, and no lever arm or latency as a state"
                )
            parts.append(raw_events(t, self.dt, gnss))
        elif gnss is not None:
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
