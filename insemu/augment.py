"""From noise models to named filter states.

The filter's states are position, velocity and attitude errors and then, axis by axis, the states of the belief's processes: gyroscope x,
y, z, accelerometer x, y, z. Sample k of an axis carries ``c x_k + v_k`` with ``x_k = Phi x_(k-1) + w_k``; nothing here knows how a filter
propagates them. Calibration states (scale factor, misalignment) belong to an axis too, and are driven by what the triad measures; a scale factor that
follows the temperature by that times the temperature. States of the GNSS installation (lever arm, latency) and of its receiver (clock) come last.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError, nearest
from insemu.noise import ARMA, DR, LARGEST_LOG_TIME, RC, Follows, NoiseModel, Process, StateBlock, shared_processes
from insemu.records import AXES, ImuRecord

if TYPE_CHECKING:
    from insemu.noise import Clock

Array = NDArray[np.float64]

#: Names of the nine navigation errors (metres, m/s, rad).
NAVIGATION = ("pos_n", "pos_e", "pos_d", "vel_n", "vel_e", "vel_d", "att_n", "att_e", "att_d")

Belief = Mapping[str, NoiseModel | Process]

#: Turn-on bias that is believed where a static model has none: a fit removes it. The largest of the MEMS cards short of the worst, rad/s, m/s^2.
TURN_ON = {"gyro": math.radians(0.5), "accel": 0.25}


@dataclass(frozen=True)
class StateLayout:
    """Names and places of a filter's states; the only place where offsets exist.

    Parameters
    ----------
    names : tuple of str
        All states in order, for example ``pos_n``, ``gyro_x.GM1``.
    slices : mapping
        Slices of ``position``, ``velocity``, ``attitude``, the six axes and, where they are carried, ``lever_arm`` and ``latency``.

    Examples
    --------
    >>> from insemu.noise import GM, WN
    >>> layout = augment({"gyro": WN(N=1e-4) + GM(sigma=1e-4, beta=0.1), "accel": WN(N=1e-3)}, 0.01).layout
    >>> layout.n, layout["gyro_y"], layout.names[9]
    (12, slice(10, 11, None), 'gyro_x.GM1')
    """

    names: tuple[str, ...]
    slices: Mapping[str, slice] = field(repr=False)

    def __post_init__(self) -> None:
        if len(set(self.names)) != len(self.names):
            twice = next(name for name in self.names if self.names.count(name) > 1)
            raise InputError(f"the state '{twice}' exists twice")

    @classmethod
    def of_navigation(cls) -> StateLayout:
        """The nine navigation errors alone."""
        groups = {name: slice(3 * k, 3 * k + 3) for k, name in enumerate(("position", "velocity", "attitude"))}
        return cls(NAVIGATION, groups | dict.fromkeys(AXES, slice(9, 9)))

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.names)

    @property
    def navigation(self) -> slice:
        """Position, velocity and attitude together."""
        return slice(0, 9)

    @property
    def position(self) -> slice:
        """Position error, metres north, east, down."""
        return self["position"]

    @property
    def velocity(self) -> slice:
        """Velocity error, m/s."""
        return self["velocity"]

    @property
    def attitude(self) -> slice:
        """Attitude error phi, rad about north, east, down."""
        return self["attitude"]

    @property
    def imu(self) -> slice:
        """All states of the inertial sensors."""
        return slice(9, self["accel_z"].stop)

    def __getitem__(self, name: str) -> slice:
        if name in self.slices:
            return self.slices[name]
        if name in self.names:
            at = self.names.index(name)
            return slice(at, at + 1)
        raise InputError(f"no state or group of states '{name}'" + nearest(name, [*self.slices, *self.names]))

    def index(self, name: str) -> int:
        """Place of one state."""
        if name not in self.names:
            raise InputError(f"no state '{name}'" + nearest(name, self.names))
        return self.names.index(name)


@dataclass(frozen=True)
class Extras:
    """States together with the noise of the axes, each a random constant given by its initial standard deviation; 0 leaves it out.

    Parameters
    ----------
    gyro_scale, accel_scale : float
        Scale-factor errors, one per axis, as a pure number (1e-3 = 1000 ppm).
    gyro_misalignment, accel_misalignment : float
        Cross-axis sensitivities, two per axis, rad.
    gyro_scale_temperature, accel_scale_temperature : float
        Change of the scale factors with the temperature that the IMU records, one per axis, 1/K.
    lever_arm : float
        Error of the lever arm, three components, m.
    latency : float
        Age of a fix at its stamp, s.
    reference_temperature : float
        Temperature at which the states per kelvin change nothing, degC.
    stationary_start : float
        Factor on the standard deviations with which the states of stationary processes of the axes begin: 1 as a sensor that has run for long, 0 as
        if they were known to be zero, which makes a filter learn them slowly.
    clock : Clock, optional
        Bias and drift of the receiver's clock, for raw observations.
    """

    gyro_scale: float = 0.0
    accel_scale: float = 0.0
    gyro_misalignment: float = 0.0
    accel_misalignment: float = 0.0
    lever_arm: float = 0.0
    latency: float = 0.0
    gyro_scale_temperature: float = 0.0
    accel_scale_temperature: float = 0.0
    reference_temperature: float = 25.0
    stationary_start: float = 1.0
    clock: Clock | None = None

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name != "clock" and not (np.isfinite(value) and (value >= 0 or name == "reference_temperature")):
                raise InputError(f"{name} is {value!r}, expected a standard deviation that is not negative")


@dataclass(frozen=True)
class Timed:
    """States whose correlation times follow a covariate.

    Parameters
    ----------
    first : int
        Place of the first of them among the augmented states.
    law : int
        Place of their law.
    process : Process
        At gain 1, with its rate.
    """

    first: int
    law: int
    process: Process


@dataclass(frozen=True)
class Augmentation:
    """The discrete model of the augmented states, after the nine of navigation.

    With m states: ``x_k = Phi x_(k-1) + w_k``, cov w = Q, x_0 ~ (0, P0). The error of axis a is ``sum_s c_s d_s x_s + v`` over its own states
    s, with var v = ``white[a]`` and d_s = 1, or column ``driver[s]`` of what :meth:`sensed` gives where that is not -1.

    Parameters
    ----------
    layout : StateLayout
        Of the whole filter, the navigation states included.
    dt : float
        Sampling interval, s.
    Phi, Q, P0 : (m, m) arrays
    axis : (m,) array of int
        Axis 0..5 of each state, -1 for states that no axis sees.
    c : (m,) array
    driver : (m,) array of int
    white : (6,) array
        Variance of the samples' own white noise, (rad/s)^2 and (m/s^2)^2, as far as it is constant.
    laws : tuple of Follows
        Laws by which levels or correlation times follow covariates; Phi, Q, P0 and ``white_of`` of what follows one are those at gain 1.
    law_of : (m,) array of int
        Law of the noise that drives each state, -1 where it is constant.
    white_of : (laws, 6) array
        White noise that follows each law.
    reference_temperature : float
        Of the states that follow the temperature, degC.
    timed : tuple of Timed
        States whose transition follows a law.
    """

    layout: StateLayout
    dt: float
    Phi: Array
    Q: Array
    P0: Array
    axis: NDArray[np.int64]
    c: Array
    driver: NDArray[np.int64]
    white: Array
    laws: tuple[Follows, ...] = ()
    law_of: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    white_of: Array = field(default_factory=lambda: np.zeros((0, 6)))
    reference_temperature: float = 25.0
    timed: tuple[Timed, ...] = ()

    def require_constant(self, what: str) -> None:
        """Raise ``InputError`` where a level or a correlation time follows a covariate, which ``what`` does not know."""
        if self.laws:
            law = self.laws[0]
            kind, found = ("level", "a level") if law.what == "level" else ("correlation time", "a correlation time")
            raise InputError(f"{what} takes noise of constant {kind}, found {found} that follows {law.covariate}")

    def moved(self, gain: Array) -> tuple[Array, Array]:
        """Transition and driving covariance, (m, m) each, of a step at gains (laws,) of the correlation times; levels stay at gain 1."""
        Phi, Q = self.Phi.copy(), self.Q.copy()
        for one in self.timed:
            F, drive, scale = one.process.timed(np.array([_within(gain[one.law])]), self.dt)
            at = slice(one.first, one.first + drive.size)
            Phi[at, at], Q[at, at] = F[0], scale[0] ** 2 * np.outer(drive, drive)
        return Phi, Q

    def started(self, gain: Array) -> Array:
        """Covariance (m, m) of the states at the start, at gains (laws,) of levels and correlation times."""
        P0 = self.P0.copy()
        for one in self.timed:
            own = one.process.slowed(_within(gain[one.law])).carried(self.dt).P0
            P0[one.first : one.first + len(own), one.first : one.first + len(own)] = own
        if not self.laws:
            return P0
        level = np.where(self.law_of >= 0, gain[self.law_of], 1.0)
        return np.asarray(P0 * np.outer(level, level))

    @property
    def thermal(self) -> bool:
        """Whether states follow the temperature."""
        return bool((self.driver >= 6).any())

    def sensed(self, imu: ImuRecord) -> tuple[Array, Array]:
        """Gyroscopes and accelerometers as compiled loops take them: (n, 3) and (n, 3), or (n, 9) where states follow the temperature.

        Behind the forces then stand rates and forces times the temperature above the reference: side by side the two have the columns
        that :attr:`driver` counts.

        Raises
        ------
        InputError
            An IMU without the temperature that states need.
        """
        if not self.thermal:
            return imu.gyro, imu.accel
        if imu.temperature is None:
            raise InputError(
                "states of the filter follow the temperature, but the IMU has none; expected a record with temperature"
            )
        above = (imu.temperature - self.reference_temperature)[:, None]
        wide = np.hstack([imu.accel, above * imu.gyro, above * imu.accel])
        wide.setflags(write=False)  # as the columns of a record: no other kernel is compiled
        return imu.gyro, wide

    @property
    def m(self) -> int:
        """Number of augmented states."""
        return self.axis.size

    def coefficients(self, measured: ArrayLike | None = None) -> Array:
        """How strongly each state is seen by its axis, ``c_s d_s``: (m,), or (..., m) for many measured rows.

        Parameters
        ----------
        measured : (..., 6) or (..., 12) array_like, optional
            Rows of :meth:`sensed`, needed only where calibration states are carried.
        """
        driven = self.driver >= 0
        if not driven.any():
            return self.c
        if measured is None:
            raise InputError("calibration states are carried; give the measured rate and specific force")
        return np.where(driven, self.c * np.asarray(measured, dtype=np.float64)[..., self.driver], self.c)

    def output(self, measured: ArrayLike | None = None) -> Array:
        """What the six axes see of the states, (6, m) or (..., 6, m); ``measured`` as in :meth:`coefficients`."""
        c = self.coefficients(measured)
        C = np.zeros((*c.shape[:-1], 6, self.m))
        seen = np.flatnonzero(self.axis >= 0)
        C[..., self.axis[seen], seen] = c[..., seen]
        return C

    def turn_on_sigma(self) -> Array:
        """Standard deviations of the constants with which the six axes begin, (6,), SI; NaN where the belief has none, as a fit to a log at rest."""
        constant = (self.axis >= 0) & (self.driver < 0) & (np.diag(self.Phi) == 1.0) & (np.diag(self.P0) > 0.0)
        out = np.full(6, np.nan)
        for axis in np.unique(self.axis[constant]):
            own = np.flatnonzero(constant & (self.axis == axis))
            out[axis] = np.sqrt(self.c[own] @ self.P0[np.ix_(own, own)] @ self.c[own])
        return out

    def power(self, count: int) -> tuple[Array, Array]:
        """Transition and driving covariance over ``count`` samples."""
        Phi, Q = np.eye(self.m), np.zeros((self.m, self.m))
        for _ in range(count):
            Phi, Q = self.Phi @ Phi, self.Phi @ Q @ self.Phi.T + self.Q
        return Phi, Q


def _within(gain: float) -> float:
    """A gain of correlation times within its limits."""
    return float(np.clip(gain, math.exp(-LARGEST_LOG_TIME), math.exp(LARGEST_LOG_TIME)))


def per_axis(belief: Belief) -> dict[str, NoiseModel]:
    """Spell a belief out: keys ``gyro`` and ``accel`` stand for their three axes; a single process is a model; an axis left out has no error.

    Raises
    ------
    InputError
        An unknown axis, or something that is not a noise model.
    """
    known = (*AXES, "gyro", "accel")
    out = {axis: NoiseModel() for axis in AXES}
    for key in sorted(belief, key=len):  # triads first, so that a single axis overrides them
        value = belief[key]
        if key not in known:
            raise InputError(f"unknown axis '{key}'" + nearest(str(key), known))
        if isinstance(value, Process):
            value = NoiseModel((value,))
        if not isinstance(value, NoiseModel):
            raise InputError(
                f"the model of {key} is {value!r}, expected a noise model such as WN(N=1e-4) + GM(sigma=1e-4, beta=0.01)"
            )
        for axis in AXES:
            if axis == key or axis.startswith(key + "_"):
                out[axis] = value
    return out


def with_turn_on(belief: Belief) -> dict[str, NoiseModel]:
    """A belief per axis, with a turn-on bias of :data:`TURN_ON` on every axis none of whose processes begins with an unknown constant.

    Parameters
    ----------
    belief : mapping
        As :func:`per_axis` takes it.
    """
    out = per_axis(belief)
    for axis, model in out.items():
        if not any(_begins_anywhere(p) for p in model):
            out[axis] = model + RC(sigma=TURN_ON[axis.partition("_")[0]])
    return out


def _begins_anywhere(process: Process) -> bool:
    block = process.block(1.0)  # the spread of a start is the same at any sampling interval
    return not process.stationary and float(block.c @ block.P0 @ block.c) > 0.0


def _blocks(model: NoiseModel, dt: float, stationary_start: float) -> list[StateBlock]:
    """State blocks of a model's processes, autoregressions of higher order in coordinates that keep their digits."""
    blocks = []
    for index, process in model.indexed():
        b = process.carried(dt)
        names = tuple(name.replace(process.symbol, f"{process.symbol}{index}", 1) for name in b.names)
        P0 = b.P0 * stationary_start**2 if process.stationary else b.P0
        blocks.append(StateBlock(names, b.Phi, b.Q, b.c, P0, b.white, dt))
    return blocks


def _share(belief: Mapping[str, NoiseModel], first: Mapping[tuple[str, int], int], whole: StateBlock) -> StateBlock:
    """Let states of shared processes be driven and start as one: their covariance across axes follows from the levels.

    Every axis keeps the states that it sees, which the compiled filter carries side by side at no cost; fully correlated, they are one process.
    """
    Q, P0 = whole.Q.copy(), whole.P0.copy()
    for name, members in shared_processes(belief).items():
        for i, one in enumerate(members):
            for two in members[i + 1 :]:
                if one.weight == 0.0 or two.weight == 0.0:
                    continue
                a, b = first[one.axis, one.place], first[two.axis, two.place]
                n = one.process.block(whole.dt).n
                if n == 0 or one.process.block(whole.dt).white > 0:
                    raise InputError(
                        f"the shared process '{name}' is {one.process}: white noise that axes share has no state to carry it; expected GM, RW, ..."
                    )
                for matrix in (Q, P0):
                    matrix[a : a + n, b : b + n] = matrix[a : a + n, a : a + n] * (two.weight / one.weight)
                    matrix[b : b + n, a : a + n] = matrix[a : a + n, b : b + n].T
    return StateBlock(whole.names, whole.Phi, Q, whole.c, P0, whole.white, whole.dt)


def _moving_average(process: ARMA, dt: float) -> tuple[StateBlock, Array]:
    """The chain of an autoregression, and the weights (n, n) of the present and past values that give its states.

    With ``y = w / A(z)`` and states ``B_i(z) w / A(z)`` the states are ``B_i(z) y``: the responses of the states to one innovation, times A.
    """
    b = process.carried(dt)
    drive = b.Q[:, 0] / process.parameters["sigma2"]  # the first state takes the innovation as it is
    response = np.empty((b.n, b.n))
    for k in range(b.n):
        response[:, k] = drive
        drive = b.Phi @ drive
    polynomial = np.concatenate([[1.0], -np.array(process.ar, dtype=np.float64)])
    return b, np.stack([np.convolve(row, polynomial)[: b.n] for row in response])


def true_states(model: NoiseModel, components: ArrayLike, dt: float) -> Array:
    """States that a filter believing ``model`` would carry for signals that were drawn from it.

    Parameters
    ----------
    model : NoiseModel
    components : (processes, n) array_like
        What each process drew, :meth:`~insemu.noise.NoiseModel.simulate_components`.
    dt : float
        s.

    Returns
    -------
    (states, n) array
        In the order of :func:`augment`. NaN where a process has states that its values do not tell (QN, SIN, MA, ARMA, an AR(p) whose correlation
        times follow a covariate) and in the first p - 1 samples of an AR(p).
    """
    parts = np.asarray(components, dtype=np.float64)
    rows = [process_states(p, values, dt) for p, values in zip(model.at_rate(1.0 / dt), parts, strict=True)]
    return np.concatenate([np.zeros((0, parts.shape[1])), *rows])


def process_states(process: Process, values: Array, dt: float) -> Array:
    """The states of one process; see :func:`true_states`.

    Parameters
    ----------
    process : Process
        With its rate.
    values : (n,) array
        What it drew.
    dt : float
        s.
    """
    from scipy.signal import lfilter

    n = process.block(dt).n
    moving = process.follows is not None and process.follows.what == "time"
    if isinstance(process, ARMA) and n > 1 and not process.ma and not moving:
        found = np.stack([lfilter(w, [1.0], values) for w in _moving_average(process, dt)[1]])
        found[:, : n - 1] = np.nan
        return found
    if isinstance(process, DR):
        return np.stack([values, np.full_like(values, process.parameters["R"])])
    return np.full((n, values.size), np.nan) if n > 1 else values[None][:n]


def augment(belief: Belief, dt: float, extras: Extras | None = None) -> Augmentation:
    """Generate a filter's states from what it believes about its sensors.

    Parameters
    ----------
    belief : mapping of axis to NoiseModel
        Axes ``gyro_x`` .. ``accel_z``, or ``gyro`` and ``accel`` for all three of a triad. Discrete processes without a rate take 1/dt.
    dt : float
        Sampling interval, s.
    extras : Extras, optional
        Calibration and installation states.

    Returns
    -------
    Augmentation

    Raises
    ------
    InputError
        An unknown axis, a polynomial that is not stationary (the message offers the nearest one that is), a parameter without a value.
    """
    if not (np.isfinite(dt) and dt > 0):
        raise InputError(f"the sampling interval is {dt!r}, expected a positive number of seconds")
    extras = extras or Extras()
    names: list[str] = list(NAVIGATION)
    slices = {"position": slice(0, 3), "velocity": slice(3, 6), "attitude": slice(6, 9)}
    blocks: list[StateBlock] = []
    axis_of: list[int] = []
    driver: list[int] = []
    white = np.zeros(6)

    def constants(count: int, sigma: float) -> None:
        eye = np.eye(count)
        blocks.append(StateBlock(("",) * count, eye, 0 * eye, np.ones(count), sigma**2 * eye, 0.0, dt))

    models = {axis: model.at_rate(1.0 / dt) for axis, model in per_axis(belief).items()}
    first: dict[tuple[str, int], int] = {}
    for a, (axis, model) in enumerate(models.items()):
        start = len(names)
        try:
            own = _blocks(model, dt, extras.stationary_start)
            block = StateBlock.stack(own, dt)
        except InputError as error:
            raise type(error)(str(error), where=f"belief of {axis}") from None
        for place, before in enumerate(np.cumsum([0, *(b.n for b in own)])[:-1]):
            first[axis, place] = start - len(NAVIGATION) + int(before)
        white[a] = block.white
        names += [f"{axis}.{name}" for name in block.names]
        blocks.append(block)
        axis_of += [a] * block.n
        driver += [-1] * block.n
        triad, letter = axis.split("_")
        if (scale := getattr(extras, f"{triad}_scale")) > 0:
            names.append(f"{axis}.scale")
            constants(1, scale)
            axis_of.append(a)
            driver.append(a)
        if (per_kelvin := getattr(extras, f"{triad}_scale_temperature")) > 0:
            names.append(f"{axis}.scale_temperature")
            constants(1, per_kelvin)
            axis_of.append(a)
            driver.append(6 + a)
        if (misalignment := getattr(extras, f"{triad}_misalignment")) > 0:
            for other in (o for o in "xyz" if o != letter):
                names.append(f"{axis}.from_{other}")
                axis_of.append(a)
                driver.append(AXES.index(f"{triad}_{other}"))
            constants(2, misalignment)
        slices[axis] = slice(start, len(names))
    for name, parts, sigma in (("lever_arm", "xyz", extras.lever_arm), ("latency", "", extras.latency)):
        if sigma > 0:
            count = len(parts) or 1
            slices[name] = slice(len(names), len(names) + count)
            names += [f"{name}_{part}" for part in parts] or [name]
            constants(count, sigma)
            axis_of += [-1] * count
            driver += [-1] * count
    if extras.clock is not None:
        slices["clock"] = slice(len(names), len(names) + 2)
        blocks.append(extras.clock.block(dt))
        names, axis_of, driver = [*names, "clock_bias", "clock_drift"], [*axis_of, -1, -1], [*driver, -1, -1]
    laws, law_of, white_of, timed = _laws(models, first, dt, len(axis_of))
    stacked = _share(models, first, StateBlock.stack(blocks, dt))
    return Augmentation(
        layout=StateLayout(tuple(names), slices),
        dt=dt,
        Phi=stacked.Phi,
        Q=stacked.Q,
        P0=stacked.P0,
        axis=np.array(axis_of, dtype=np.int64),
        c=np.where(np.array(axis_of, dtype=np.int64) >= 0, stacked.c, 0.0),
        driver=np.array(driver, dtype=np.int64),
        white=np.maximum(white - white_of.sum(axis=0), 0.0),
        laws=laws,
        law_of=law_of,
        white_of=white_of,
        reference_temperature=extras.reference_temperature,
        timed=timed,
    )


def _laws(
    models: Mapping[str, NoiseModel], first: Mapping[tuple[str, int], int], dt: float, m: int
) -> tuple[tuple[Follows, ...], NDArray[np.int64], Array, tuple[Timed, ...]]:
    """Laws of a belief, the law of the level of what drives each of its ``m`` states (-1: none), the white noise (laws, 6) that follows each, and
    the states whose correlation times follow one.
    """
    laws: list[Follows] = []
    timed: list[Timed] = []
    law_of, white_of = np.full(m, -1, dtype=np.int64), []
    for a, (axis, model) in enumerate(models.items()):
        for place, process in enumerate(model):
            law = process.follows
            if law is None:
                continue
            law.gain(0.0)  # refuses an unknown slope
            if law not in laws:
                laws.append(law)
                white_of.append(np.zeros(6))
            block, at = process.block(dt), first[axis, place]
            if law.what == "time":
                if process.shared:
                    raise InputError(
                        f"{process} is shared, and its correlation times follow {law.covariate}: the filter takes one or the other",
                        where=f"belief of {axis}",
                    )
                timed.append(Timed(at, laws.index(law), process))
                continue
            law_of[at : at + block.n] = laws.index(law)
            white_of[laws.index(law)][a] += block.white
    return tuple(laws), law_of, np.array(white_of).reshape(len(laws), 6), tuple(timed)
