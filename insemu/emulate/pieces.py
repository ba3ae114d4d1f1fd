"""True error signals, one piece per realization: cut from simulated records or from recorded static signals.

Pieces never overlap. The mean of the record they come from is removed, as a calibration over the record would (paper
of 2014, section VI).
"""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from threading import Lock
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from insemu.augment import augment, process_states
from insemu.emulate.errors import RecordedErrors
from insemu.errors import InputError
from insemu.noise import WN, CommonDraws, NoiseModel, Source, sources
from insemu.records import AXES

Array = NDArray[np.float64]
#: Samples that are drawn at a time and thrown away.
_DRAWN = 1 << 17


@dataclass(frozen=True)
class TrueStates:
    """What the sensors' errors really are at some epochs, apart from their white noise.

    Parameters
    ----------
    axes : (k, 6) array
        Error of every axis less its white noise, rad/s and m/s^2.
    states : (k, m) array or None
        States of the processes in the order of :func:`insemu.augment.augment`, NaN where values do not tell them; None where a mean was
        removed, which belongs to no single process, or a process has no finite states.
    names : tuple of str
        Of those states, for example ``gyro_x.GM1``.
    """

    axes: Array
    states: Array | None
    names: tuple[str, ...]


@dataclass(frozen=True)
class ErrorPieces:
    """Error signals by realization.

    Parameters
    ----------
    count : int or None
        Number of pieces there are; None: as many as asked for.
    draw : callable
        Takes the index of a realization and an array for the (n, 6) errors of the IMU rows after the first one, and returns its
        :class:`TrueStates`, None where errors are recorded. Several threads may call it.
    rows : int
        Rows of the IMU record.
    """

    count: int | None
    draw: Callable[[int, Array], TrueStates | None]
    rows: int

    def piece(self, realization: int) -> tuple[Array, TrueStates | None]:
        """The (n, 6) error signals of one realization, rad/s and m/s^2, columns in the order of
        :data:`insemu.records.AXES`, and what they are made of.

        Row 0 belongs to the interval before the start, which nothing integrates; it repeats row 1.

        Raises
        ------
        InputError
            There is no such piece.
        """
        if self.count is not None and realization >= self.count:
            raise InputError(f"realization {realization} asked for, but the recorded signals hold {self.count} pieces")
        errors = np.empty((self.rows, 6))
        states = self.draw(realization, errors[1:])
        errors[0] = errors[1]
        return errors, states


def simulated_pieces(
    models: Mapping[str, NoiseModel] | Callable[[int], Mapping[str, NoiseModel]],
    n: int,
    rate_hz: float,
    *,
    record_s: float | None,
    rng: Callable[[int, int], np.random.Generator],
    states_at: NDArray[np.intp] | None = None,
    covariates: Mapping[str, Array] | None = None,
) -> ErrorPieces:
    """Pieces of records simulated from a model per axis.

    Parameters
    ----------
    models : mapping or callable
        Axis to model, all six axes; or of every record, whose sensor is another each time, one structure in all.
    n : int
        Rows of the IMU record.
    rate_hz : float
        IMU rate.
    record_s : float or None
        Length of the records; every record is cut into as many pieces as fit and its mean is removed. None: every
        piece is drawn on its own and keeps its mean.
    rng : callable
        ``(record, axis) -> Generator``: a stream of its own for every record and axis.
    states_at : (k,) array of int, optional
        Rows of the IMU record at which true states are kept.
    covariates : mapping of str to (n,) array, optional
        What levels follow, at the rows of the IMU record; every piece of a record has them anew.

    Raises
    ------
    InputError
        A record shorter than the flight. Drawing raises it where there is no room for the temporary file of a record.
    """
    length = n - 1 if record_s is None else round(record_s * rate_hz)
    if length < n - 1:
        raise InputError(f"the record of {record_s:g} s is shorter than the flight of {(n - 1) / rate_hz:g} s")
    at = np.maximum((np.zeros(0, dtype=np.intp) if states_at is None else states_at) - 1, 0)
    followed = {name: np.resize(x[1:], length) for name, x in (covariates or {}).items()}
    return ErrorPieces(None, _Simulated(models, rng, rate_hz, n - 1, length, record_s is not None, at, followed), n)


class _Record:
    """Samples of a record, axis after axis in a temporary file: of six axes, four hours at 100 Hz are 69 MB.

    Parameters
    ----------
    length : int
        Samples of an axis.
    """

    def __init__(self, length: int) -> None:
        self._length, self._lock = length, Lock()
        self._file = tempfile.TemporaryFile(prefix="insemu-record-")
        weakref.finalize(self, _closed, self._file)
        #: True states of its pieces, in their order.
        self.states: list[TrueStates | None] = []

    def add(self, values: Array) -> None:
        """Write the samples of the next axis."""
        try:
            self._file.write(values.data)
            self._file.flush()
        except OSError as error:
            raise InputError(
                f"a simulated record of {6 * values.nbytes / 1e6:.3g} MB cannot be written ({error.strerror}); TMPDIR names another folder",
                where=tempfile.gettempdir(),
            ) from None

    def read(self, first: int, out: Array) -> None:
        """Samples of all axes from one on, into an (n, 6) array."""
        part = np.empty(len(out))
        for axis in range(6):
            with self._lock:
                self._file.seek((axis * self._length + first) * part.itemsize)
                self._file.readinto(part.data)
            out[:, axis] = part


def _closed(file: IO[bytes]) -> None:
    """Close a file whose last bytes may have found no room: that has been said."""
    with suppress(OSError):
        file.close()


class Following:
    """Errors of one realization sample after sample, the numbers that :func:`simulated_pieces` gives, however many are asked for at a time.

    Parameters
    ----------
    models : mapping
        Axis to model, with their rates; none follows a covariate.
    rng : callable
        ``axis -> Generator``, called once more where a mean is taken.
    dt : float
        Sampling interval, s.
    intervals, length, place : int
        Samples of a piece and of a record, and which piece of its record it is.
    centred : bool
        Whether the mean of the record is removed.
    """

    def __init__(
        self,
        models: Mapping[str, NoiseModel],
        rng: Callable[[int], np.random.Generator],
        dt: float,
        intervals: int,
        length: int,
        place: int,
        *,
        centred: bool,
    ) -> None:
        self._models = {axis: models[axis] for axis in AXES}
        self._mean = np.zeros(6)

        def begun() -> list[Sequence[Source]]:
            return [sources(model, length, dt, rng(k)) for k, model in enumerate(self._models.values())]

        if centred:
            self._sources = begun()
            self._mean = sum((part.sum(axis=0) for part in self._thrown(length)), np.zeros(6)) / length
        self._sources = begun()
        for _ in self._thrown(place * intervals):
            pass

    def _thrown(self, count: int) -> Iterator[Array]:
        for first in range(0, count, _DRAWN):
            yield self(min(_DRAWN, count - first))[0]

    def __call__(self, count: int) -> tuple[Array, Array]:
        """The next (count, 6) errors, and what they are apart from white noise."""
        errors, slow, common = np.zeros((count, 6)), np.zeros((count, 6)), CommonDraws(self._models)
        part = np.empty(count)
        for k, (axis, model) in enumerate(self._models.items()):
            for place, (process, source) in enumerate(zip(model, self._sources[k], strict=True)):
                source(part)
                common.share(axis, part[None], place)
                errors[:, k] += part
                if not isinstance(process, WN):
                    slow[:, k] += part
        return errors - self._mean, slow - self._mean


@dataclass(eq=False)
class _Simulated:
    """Pieces of simulated records, drawn record by record; see :func:`simulated_pieces`.

    Parameters
    ----------
    models, rng, rate_hz, covariates
        As in :func:`simulated_pieces`.
    intervals, length : int
        Samples of a piece and of a record.
    centred : bool
        Whether the mean of a record is subtracted from its pieces.
    at : (k,) array of int
        Samples of a piece at which true states are kept.
    """

    models: Mapping[str, NoiseModel] | Callable[[int], Mapping[str, NoiseModel]]
    rng: Callable[[int, int], np.random.Generator]
    rate_hz: float
    intervals: int
    length: int
    centred: bool
    at: NDArray[np.intp]
    covariates: Mapping[str, Array]

    def __post_init__(self) -> None:
        ready = self.sensor(0)
        # some processes have no finite states; a removed mean belongs to no single process
        self.single = self.at.size > 0 and not self.centred and all(p.own_block for model in ready for p in model)
        named = augment(dict(zip(AXES, ready, strict=True)), 1.0 / self.rate_hz).layout.names[9:] if self.single else ()
        self.names = tuple(named)
        self._kept: dict[int, Future[_Record]] = {}
        self._lock = Lock()

    def __getstate__(self) -> dict[str, Any]:
        """For another process, which draws its records itself."""
        return {k: v for k, v in self.__dict__.items() if k not in ("_kept", "_lock")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _kept={}, _lock=Lock())

    def sensor(self, record: int) -> list[NoiseModel]:
        """The models of the axes in one record."""
        own = self.models(record) if callable(self.models) else self.models
        return [own[axis].at_rate(self.rate_hz) for axis in AXES]

    def __call__(self, realization: int, out: Array) -> TrueStates | None:
        """One piece; threads that want pieces of one record wait for the one that draws it."""
        number, place = divmod(realization, self.length // self.intervals)
        with self._lock:
            there = self._kept.get(number)
            if mine := there is None:
                # realizations follow each other: what is older than the last record that is done is wanted no more
                for old in [k for k, v in self._kept.items() if v.done()][:-1]:
                    del self._kept[old]
                there = self._kept[number] = Future()
        if mine:
            try:
                there.set_result(self._drawn(number))
            except BaseException as error:
                with self._lock:
                    del self._kept[number]
                there.set_exception(error)
        record = there.result()
        record.read(place * self.intervals, out)
        return record.states[place]

    def _drawn(self, number: int) -> _Record:
        """A record, axis by axis and process by process: each of them is large."""
        models, n, k = self.sensor(number), self.intervals, self.at.size
        count, dt = self.length // n, 1.0 / self.rate_hz
        # row 0 of the IMU takes the first sample of the piece
        places = (np.arange(count)[:, None] * n + self.at).ravel()
        record, states, axes = _Record(self.length), [], np.zeros((places.size, 6))
        common = CommonDraws(dict(zip(AXES, models, strict=True)))
        for axis, model in enumerate(models):

            def each(place: int, part: Array, axis: int = axis, model: NoiseModel = model) -> None:
                common.share(AXES[axis], part[None], place)
                if k and not isinstance(model.processes[place], WN):
                    axes[:, axis] += part[places]
                if self.single:
                    states.append(process_states(model.processes[place], part, dt)[:, places])

            values = model.simulate(self.length, dt, self.rng(number, axis), self.covariates, each)
            if self.centred:
                mean = values.mean()
                values -= mean
                axes[:, axis] -= mean
            record.add(values)
        told = np.concatenate(states).T if states else None
        for place in range(count):
            own = slice(place * k, (place + 1) * k)
            record.states.append(TrueStates(axes[own], None if told is None else told[own], self.names) if k else None)
        return record


def recorded_pieces(
    records: Sequence[RecordedErrors], n: int, rate_hz: float, order: Sequence[int] | None = None
) -> ErrorPieces:
    """Non-overlapping pieces of recorded static signals, record after record.

    Parameters
    ----------
    records : sequence of RecordedErrors
    n : int
        Rows of the IMU record.
    rate_hz : float
        IMU rate; records at another rate are refused, since resampling would change their noise.
    order : sequence of int, optional
        Which piece each realization takes, counted from 0 over all records.

    Raises
    ------
    InputError
        Another rate, no record as long as the flight, or an order that names a piece twice or one that there is not.
    """
    for record in records:
        if abs(record.rate_hz / rate_hz - 1.0) > 1e-6:
            raise InputError(
                f"{record.name} is sampled at {record.rate_hz:g} Hz, expected the IMU rate of {rate_hz:g} Hz; "
                "resampling would change its noise"
            )
    places = [(record, k) for record in records for k in range(record.count(n - 1))]
    if not places:
        longest = max(len(record.values) / record.rate_hz for record in records)
        raise InputError(
            f"the longest recorded signal has {longest:g} s, shorter than the flight of {(n - 1) / rate_hz:g} s"
        )

    if order is not None:
        if len(set(order)) != len(order) or any(not 0 <= k < len(places) for k in order):
            raise InputError(
                f"the order {list(order)} of pieces must name each at most once, from 0 to {len(places) - 1}"
            )
        places = [places[k] for k in order]

    def draw(realization: int, out: Array) -> None:
        record, k = places[realization]
        out[:] = record.piece(k, n - 1)

    return ErrorPieces(len(places), draw, n)
