"""True error signals, one piece per realization: cut from simulated records or from recorded static signals.

Pieces never overlap. The mean of the record they come from is removed, as a calibration over the record would (paper
of 2014, section VI).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.augment import augment, true_states
from insemu.emulate.errors import RecordedErrors
from insemu.errors import InputError
from insemu.noise import WN, CommonDraws, NoiseModel
from insemu.records import AXES

Array = NDArray[np.float64]


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
        Takes the index of a realization and returns the (n, 6) errors of the IMU rows.
    tell : callable
        Takes the index of a realization and returns its :class:`TrueStates`; None where errors are recorded.
    """

    count: int | None
    draw: Callable[[int], Array]
    tell: Callable[[int], TrueStates] | None = None

    def piece(self, realization: int) -> Array:
        """The (n, 6) error signals of one realization, rad/s and m/s^2, columns in the order of
        :data:`insemu.records.AXES`.

        Row 0 belongs to the interval before the start, which nothing integrates; it repeats row 1.

        Raises
        ------
        InputError
            There is no such piece.
        """
        if self.count is not None and realization >= self.count:
            raise InputError(f"realization {realization} asked for, but the recorded signals hold {self.count} pieces")
        drawn = self.draw(realization)
        return np.concatenate([drawn[:1], drawn])


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
        A record shorter than the flight.
    """
    intervals = n - 1

    def ready_for(record: int) -> list[NoiseModel]:
        own = models(record) if callable(models) else models
        return [own[axis].at_rate(rate_hz) for axis in AXES]

    ready = ready_for(0)
    length = intervals if record_s is None else round(record_s * rate_hz)
    if length < intervals:
        raise InputError(f"the record of {record_s:g} s is shorter than the flight of {intervals / rate_hz:g} s")
    per_record = length // intervals
    at = np.maximum((np.zeros(0, dtype=np.intp) if states_at is None else states_at) - 1, 0)
    # within a record: piece by piece, row 0 of the IMU takes the first sample of the piece
    places = (np.arange(per_record)[:, None] * intervals + at).ravel()
    # some processes have no finite states; a removed mean belongs to no single process
    single = at.size > 0 and record_s is None and all(p.own_block for model in ready for p in model)
    names = augment(dict(zip(AXES, ready, strict=True)), 1.0 / rate_hz).layout.names[9:] if single else ()
    followed = {name: np.resize(x[1:], length) for name, x in (covariates or {}).items()}
    kept: dict[int, tuple[RecordedErrors, Array, Array]] = {}

    def record_of(record: int) -> tuple[RecordedErrors, Array, Array]:
        if record not in kept:
            # neighbours are asked for together; an older record is drawn again if ever needed
            while len(kept) >= (2 if record_s is not None else 16):
                kept.pop(next(iter(kept)))
            sensor = ready_for(record)
            kept[record] = _recorded(
                sensor,
                lambda axis: sensor[axis].simulate_components(
                    length, 1.0 / rate_hz, rng(record, axis), covariates=followed
                ),
                rate_hz, places, single, record, record_s is not None,
            )  # fmt: skip
        return kept[record]

    def draw(realization: int) -> Array:
        record, place = divmod(realization, per_record)
        return record_of(record)[0].piece(place, intervals)

    def tell(realization: int) -> TrueStates:
        record, place = divmod(realization, per_record)
        _, axes, states = record_of(record)
        own = slice(place * at.size, (place + 1) * at.size)
        return TrueStates(axes[own], states[own] if single else None, names)

    return ErrorPieces(None, draw, tell if at.size else None)


def _recorded(
    models: Sequence[NoiseModel],
    components: Callable[[int], Array],
    rate_hz: float,
    places: NDArray[np.intp],
    single: bool,
    record: int,
    centred: bool,
) -> tuple[RecordedErrors, Array, Array]:
    """A simulated record, the errors of its axes without white noise at some places, and the states of its processes there."""
    columns, states = [], []
    common = CommonDraws(dict(zip(AXES, models, strict=True)))
    axes = np.zeros((places.size, 6))
    for axis, model in enumerate(models):
        parts = components(axis)  # of one axis at a time: a record of hours is large
        common.share(AXES[axis], parts)
        columns.append(parts.sum(axis=0))
        for process, part in zip(model, parts, strict=True):
            if places.size and not isinstance(process, WN):
                axes[:, axis] += part[places]
        if single:
            states.append(true_states(model, parts, 1.0 / rate_hz)[:, places])
    values = np.column_stack(columns)
    if centred:
        axes -= values.mean(axis=0)
    name = f"simulated record {record + 1}"
    errors = RecordedErrors(values, rate_hz, "record" if centred else "none", name=name)
    return errors, axes, np.concatenate(states).T if states else np.zeros((0, 0))


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

    def draw(realization: int) -> Array:
        record, k = places[realization]
        return record.piece(k, n - 1)

    return ErrorPieces(len(places), draw)
