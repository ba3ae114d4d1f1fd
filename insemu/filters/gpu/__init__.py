"""The filter on a GPU (the extra ``gpu``): many realizations of a design flown at once, in double precision.

A flight is a chain of a hundred thousand steps that nothing shortens; a GPU flies thousands of them side by side. Whoever asks for a flight waits
(:meth:`Gpu.fly`); what waits for the same design is flown together. The numbers are those of the compiled loop to rounding.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.augment import Augmentation
from insemu.errors import InputError
from insemu.filters.events import FIX_ROWS, Events
from insemu.filters.measurements import FIX
from insemu.filters.options import FilterOptions

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Realizations that are asked for at a time unless told: a flight takes a GPU about a second, however many fly beside it.
GPU_THREADS = 64
#: Lists of flights that are on the GPU at a time: while one is copied another one flies.
STREAMS = 4
#: Largest share of the GPU's memory that one list of flights may take.
SHARE = 0.2
#: A list is closed when so long nobody has joined it, s: short beside the second that a flight takes.
GATHER_S = 0.05
#: How often is asked whether a list has been flown, s.
POLL_S = 0.005
#: Threads of a block: a warp, which needs no barrier.
WARP = 32
#: Epochs of the record that ``flight.cu`` reads at a time.
CHUNK = 32


@dataclass(frozen=True, eq=False)
class Design:
    """What all flights of one design share.

    Parameters
    ----------
    augmentation : Augmentation
    gravity : int
        One of :data:`insemu.earth.GRAVITY_CODES`.
    lever_arm : (3,) array
        m, body axes.
    lever_at : int
        Place of the first lever-arm state, -1 where there is none.
    around : int
        Steps on each side of a fix that its derivative by the lever arm is taken from.
    options : FilterOptions
    thresholds : (7,) array
        Largest accepted normalised innovation squared by the number of components.
    t : (N,) array
        Epochs, s.
    cov_epoch : (k,) array of int
        Epochs at which the whole covariance is kept.
    """

    augmentation: Augmentation
    gravity: int
    lever_arm: Array
    lever_at: int
    around: int
    options: FilterOptions
    thresholds: Array
    t: Array
    cov_epoch: Ints

    @property
    def n(self) -> int:
        """States."""
        return self.augmentation.layout.n

    @property
    def rows(self) -> int:
        """Rows of the output."""
        return self.options.rows(self.t.size).size

    @property
    def pool_size(self) -> int:
        """Doubles of working space of one flight, as ``flight.cu`` cuts it."""
        n = self.n
        side = n + 6
        return (
            side * (side | 1)
            + n * n
            + 25 * n
            + 3 * (n - 9)
            + 26
            + 6
            + 7 * 3
            + 6
            + 46
            + 6
            + 3 * 36
            + 6
            + 13 * CHUNK
            + 3 * (self.around + 4)
        )

    @cached_property
    def constants(self) -> list[NDArray[Any]]:
        """The arguments of ``flight.cu`` that are the same for all flights but for the first, in its order."""
        a = self.augmentation
        o, raw = self.options, 12 if a.thermal else 6
        powers = [a.power(p + 1) for p in range(o.covariance_every)]
        row, column = np.nonzero(np.any([Phi != 0 for Phi, _ in powers], axis=0))
        q_row, q_column = np.nonzero(np.any([Q != 0 for _, Q in powers], axis=0))
        first = np.searchsorted(row, np.arange(a.m + 1))
        diagonal = bool((row == column).all()) and row.size == a.m
        every = o.covariance_every, o.output_every
        numbers = [self.n, diagonal, self.gravity, self.lever_at, *every, row.size, q_row.size, raw, self.around]
        ints = [np.array(v, dtype=np.int32) for v in (a.axis, a.driver, first, column, q_row, q_column, self.cov_epoch)]
        reals = [a.c, [Phi[row, column] for Phi, _ in powers], [Q[q_row, q_column] for _, Q in powers]]
        doubles = [
            np.ascontiguousarray(v, dtype=np.float64)
            for v in (*reals, a.white, self.lever_arm, self.thresholds, [o.gate_timeout])
        ]
        return [np.array(numbers, dtype=np.int32), self.t, *ints, *doubles]

    @cached_property
    def key(self) -> bytes:
        """The same for flights that may be flown together."""
        return b"|".join(v.tobytes() for v in self.constants)


@dataclass(frozen=True, eq=False)
class Flight:
    """One flight of a design.

    Parameters
    ----------
    imu : (N, 6) or (N, 12) array
        What :meth:`insemu.augment.Augmentation.sensed` gives, gyroscopes first.
    nav : (10,) array
        Initial navigation state.
    x0, P0 : (m,), (n, n) arrays
        Initial estimates of the augmented states, and the covariance of all.
    events : Events
        Fixes only.
    """

    imu: Array
    nav: Array
    x0: Array
    P0: Array
    events: Events


@dataclass(frozen=True, eq=False)
class Flown:
    """What a flight gives; shapes and units as in :func:`insemu.filters.kernel.run`.

    Parameters
    ----------
    nav, var, x : (rows, 10), (rows, n), (rows, m) arrays
    nu, S, nis, dof, ok : (f, 6), (f, 6, 6), (f,), (f,), (f,) arrays
    covariance, last : (covariances, n, n), (n, n) arrays
    code, detail : int
    """

    nav: Array
    var: Array
    x: Array
    nu: Array
    S: Array
    nis: Array
    dof: Ints
    ok: Ints
    covariance: Array
    last: Array
    code: int
    detail: int


def refused(design: Design, latency_at: int, events: Events) -> str:
    """What of a flight no GPU can fly, in words; empty where there is nothing.

    Parameters
    ----------
    design : Design
    latency_at : int
        Place of the latency state, -1 where there is none.
    events : Events
    """
    if design.options.store != "none":
        return "a smoother"
    if latency_at >= 0:
        return "the latency as a state"
    if design.augmentation.laws:
        return "noise that follows a covariate"
    if (events.kind != FIX).any() or events.z.shape[1] != FIX_ROWS:
        return "measurements other than fixes"
    return ""


#: Place of the record among the inputs.
IMU = 16


def arguments(
    design: Design, flights: Sequence[Flight]
) -> tuple[list[NDArray[Any]], list[tuple[tuple[int, ...], float, type]]]:
    """Inputs of ``flight.cu`` in its order, and of its outputs shape, first value and kind.

    The place of the records (:data:`IMU`) is empty: put together on the way they would be copied once more.

    Parameters
    ----------
    design : Design
    flights : sequence of Flight
    """
    count, n, m, most = len(flights), design.n, design.n - 9, max(f.events.t.size for f in flights)

    def padded(name: str, *width: int) -> NDArray[Any]:
        out = np.zeros((count, most, *width))
        for row, flight in zip(out, flights, strict=True):
            values = getattr(flight.events, name)
            row[: len(values)] = values
        return out

    sizes = np.array([design.t.size, most, design.cov_epoch.size, design.rows], dtype=np.int32)
    inputs = [
        np.concatenate([sizes, design.constants[0]]),
        *design.constants[1:],
        np.empty(0),
        np.stack([np.concatenate([f.nav, np.zeros(3)]) for f in flights]),
        np.stack([f.x0 for f in flights]),
        np.stack([f.P0 for f in flights]),
        np.array([f.events.t.size for f in flights], dtype=np.int32),
        padded("epoch").astype(np.int32),
        padded("tau"),
        padded("z", FIX_ROWS),
        padded("var", FIX_ROWS),
    ]
    rows, covariances, w = design.rows, design.cov_epoch.size, FIX_ROWS
    reals = [(rows, 10), (rows, n), (rows, m), (most, w), (most, w, w), (most,)]
    whole = [(covariances, n, n), (n, n)]
    outputs: list[tuple[tuple[int, ...], float, type]] = [((count, *shape), np.nan, np.float64) for shape in reals]
    outputs += [((count, most), 0, np.int32) for _ in range(2)]
    outputs += [((count, *shape), 0.0, np.float64) for shape in whole]
    return inputs, [*outputs, ((count, 2), 0, np.int32)]


def results(flights: Sequence[Flight], outputs: Sequence[NDArray[Any]]) -> list[Flown]:
    """The filled outputs, flight by flight.

    Parameters
    ----------
    flights : sequence of Flight
    outputs : sequence of array
        As :func:`arguments` tells.
    """
    out = []
    for k, flight in enumerate(flights):
        f = flight.events.t.size
        nav, var, x, nu, S, nis, dof, ok, P, last, status = (v[k] for v in outputs)
        out.append(
            Flown(
                nav, var, x, nu[:f], S[:f], nis[:f], dof[:f].astype(np.int64), ok[:f].astype(np.int64), P, last,
                int(status[0]), int(status[1]),
            )
        )  # fmt: skip
    return out


def source() -> str:
    """The text of the kernel, with the constants of the Earth that the rest of the program has."""
    constants = earth.constants() | {"PI": np.pi}
    text = files(__package__).joinpath("flight.cu").read_text(encoding="utf-8")
    return (
        f"#define CHUNK {CHUNK}\n"
        + "".join(f"constexpr double {name} = {value!r};\n" for name, value in constants.items())
        + text
    )


class Gpu:
    """A GPU that flies what is asked of it from any number of threads.

    Raises
    ------
    InputError
        CuPy is not installed, or finds no GPU.

    Attributes
    ----------
    name : str
        Of the device.
    kernel_s : float
        Time that the last list of flights took on the GPU alone, s.
    left : Counter of str
        Flights that were not taken, by the reason.
    """

    def __init__(self) -> None:
        try:
            import cupy
        except ImportError:
            raise InputError(
                "CuPy is not installed; expected it for a GPU: pip install 'insemu[gpu]'", where="gpu"
            ) from None
        try:
            properties = cupy.cuda.runtime.getDeviceProperties(0)
        except cupy.cuda.runtime.CUDARuntimeError as error:
            raise InputError(f"no GPU was found ({error}); expected one that CUDA knows", where="gpu") from None
        self.name = properties["name"].decode()
        self._cupy = cupy
        self._kernel = cupy.RawModule(code=source(), options=("--std=c++14",)).get_function("fly")
        self._lock = threading.Lock()
        self._waiting: dict[bytes, list[tuple[Design, Flight, Future[Flown]]]] = {}
        self._pool = ThreadPoolExecutor(STREAMS, thread_name_prefix="gpu")
        self._own = threading.local()  # a stream for each thread, whose memory is used again
        self._room = SHARE * properties["totalGlobalMem"]
        self._shared = properties["sharedMemPerBlockOptin"]
        self.kernel_s = 0.0
        self.left: Counter[str] = Counter()

    def takes(self, design: Design, latency_at: int, events: Events) -> bool:
        """Whether a flight can be flown here; where not, the reason is counted.

        Parameters
        ----------
        design : Design
        latency_at : int
            Place of the latency state, -1 where there is none.
        events : Events
        """
        why = refused(design, latency_at, events)
        if not why and 8 * design.pool_size > self._shared:
            why = f"{design.n} states, more than find room in the GPU's shared memory"
        if why:
            with self._lock:
                self.left[why] += 1
        return not why

    def fly(self, design: Design, flight: Flight) -> Flown:
        """Fly one flight, together with others of the design that wait; returns when it has ended.

        Parameters
        ----------
        design : Design
        flight : Flight
        """
        asked: Future[Flown] = Future()
        with self._lock:
            waiting = self._waiting.setdefault(design.key, [])
            waiting.append((design, flight, asked))
            first = len(waiting) == 1
        if first:
            self._pool.submit(self._next, design.key)
        return asked.result()

    def _next(self, key: bytes) -> None:
        """Fly all that waits for a design, once no more comes."""
        before = 0
        while before < (now := len(self._waiting[key])):
            before = now
            time.sleep(GATHER_S)
        with self._lock:
            taken = self._waiting.pop(key)
        design, size = taken[0][0], self._most(*taken[0][:2])
        for first in range(0, len(taken), size):
            part = taken[first : first + size]
            try:
                flown = self.fly_all(design, [flight for _, flight, _ in part])
            except BaseException as error:
                for _, _, asked in taken[first:]:
                    asked.set_exception(error)
                return
            for (_, _, asked), one in zip(part, flown, strict=True):
                asked.set_result(one)

    def _most(self, design: Design, flight: Flight) -> int:
        """Flights like this one that find room at a time."""
        n = design.n
        each = 8 * (flight.imu.size + design.rows * (1 + 2 * n) + (design.cov_epoch.size + 2) * n * n)
        return max(1, int(self._room / each))

    def fly_all(self, design: Design, flights: Sequence[Flight]) -> list[Flown]:
        """Fly several flights of a design side by side.

        Parameters
        ----------
        design : Design
        flights : sequence of Flight
        """
        cupy = self._cupy
        inputs, empty = arguments(design, flights)
        if not hasattr(self._own, "stream"):
            self._own.stream = cupy.cuda.Stream(non_blocking=True)
        with self._own.stream as stream:
            there = [cupy.asarray(v) for v in inputs]
            there[IMU] = cupy.empty((len(flights), *flights[0].imu.shape))
            for place, flight in zip(there[IMU], flights, strict=True):
                place.set(flight.imu)
            back = [cupy.full(shape, fill, dtype=kind) for shape, fill, kind in empty]
            room = 8 * design.pool_size
            self._kernel.max_dynamic_shared_size_bytes = max(self._kernel.max_dynamic_shared_size_bytes, room)
            began = stream.record(cupy.cuda.Event())
            self._kernel((len(flights),), (WARP,), (*there, *back), shared_mem=room)
            ended = stream.record(cupy.cuda.Event())
            while not ended.done:  # a wait of CUDA's own would keep a core busy
                time.sleep(POLL_S)
            self.kernel_s = 1e-3 * cupy.cuda.get_elapsed_time(began, ended)
            got = [v.get() for v in back]
        return results(flights, got)
