"""True error signals, one piece per realization: cut from simulated records or from recorded static signals.

Pieces never overlap. The mean of the record they come from is removed, as a calibration over the record would (paper
of 2014, section VI).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.emulate.errors import RecordedErrors
from insemu.errors import InputError
from insemu.noise import NoiseModel
from insemu.records import AXES

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ErrorPieces:
    """Error signals by realization.

    Parameters
    ----------
    count : int or None
        Number of pieces there are; None: as many as asked for.
    draw : callable
        Takes the index of a realization and returns the (n, 6) errors of the IMU rows.
    """

    count: int | None
    draw: Callable[[int], Array]

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
    models: Mapping[str, NoiseModel],
    n: int,
    rate_hz: float,
    *,
    record_s: float | None,
    rng: Callable[[int, int], np.random.Generator],
) -> ErrorPieces:
    """Pieces of records simulated from a model per axis.

    Parameters
    ----------
    models : mapping
        Axis to model, all six axes.
    n : int
        Rows of the IMU record.
    rate_hz : float
        IMU rate.
    record_s : float or None
        Length of the records; every record is cut into as many pieces as fit and its mean is removed. None: every
        piece is drawn on its own and keeps its mean.
    rng : callable
        ``(record, axis) -> Generator``: a stream of its own for every record and axis.

    Raises
    ------
    InputError
        A record shorter than the flight.
    """
    intervals = n - 1
    ready = [models[axis].at_rate(rate_hz) for axis in AXES]
    length = intervals if record_s is None else round(record_s * rate_hz)
    if length < intervals:
        raise InputError(f"the record of {record_s:g} s is shorter than the flight of {intervals / rate_hz:g} s")
    per_record = length // intervals
    kept: dict[int, RecordedErrors] = {}

    def draw(realization: int) -> Array:
        record, place = divmod(realization, per_record)
        if record not in kept:
            while len(kept) >= 2:  # neighbours are asked for together; an older record is drawn again if ever needed
                kept.pop(next(iter(kept)))
            values = np.stack(
                [m.simulate(length, 1.0 / rate_hz, rng(record, axis)) for axis, m in enumerate(ready)], axis=1
            )
            kept[record] = RecordedErrors(
                values, rate_hz, "none" if record_s is None else "record", name=f"simulated record {record + 1}"
            )
        return kept[record].piece(place, intervals)

    return ErrorPieces(None, draw)


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
