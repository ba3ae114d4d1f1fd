"""True error signals, one piece per realization: cut from simulated records or from recorded static signals.

Pieces never overlap. The mean of the record they come from is removed, as a calibration over the record would (paper of 2014, section VI).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.noise import NoiseModel
from insemu.records import AXES, Series

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ErrorPieces:
    """Error signals by realization.

    Parameters
    ----------
    count : int or None
        Number of pieces there are; None: as many as asked for.
    draw : callable
        Takes the index of a realization and returns the (n, 6) error of every IMU sample, rad/s and m/s^2 in the order of
        :data:`insemu.records.AXES`.
    """

    count: int | None
    draw: Callable[[int], Array]

    def piece(self, realization: int) -> Array:
        """The (n, 6) error signals of one realization, rad/s and m/s^2.

        Raises
        ------
        InputError
            There is no such piece.
        """
        if self.count is not None and realization >= self.count:
            raise InputError(f"realization {realization} asked for, but the recorded signals hold {self.count} pieces")
        return self.draw(realization)


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
        Samples per piece.
    rate_hz : float
        IMU rate.
    record_s : float or None
        Length of the records; every record is cut into as many pieces as fit and its mean is removed. None: every piece is drawn on
        its own and keeps its mean.
    rng : callable
        ``(record, axis) -> Generator``: a stream of its own for every record and axis.

    Raises
    ------
    InputError
        A record shorter than a piece.
    """
    dt = 1.0 / rate_hz
    ready = [models[axis].at_rate(rate_hz) for axis in AXES]
    length = n if record_s is None else round(record_s * rate_hz)
    if length < n:
        raise InputError(
            f"the record of {record_s:g} s is shorter than the flight of {n * dt:g} s; expected at least that"
        )
    per_record = length // n
    kept: dict[int, Array] = {}

    def draw(realization: int) -> Array:
        record, place = divmod(realization, per_record)
        if record not in kept:
            columns = [model.simulate(length, dt, rng(record, axis)) for axis, model in enumerate(ready)]
            if record_s is not None:
                columns = [c - c.mean() for c in columns]
            while len(kept) >= 2:  # neighbours are asked for together; older records are drawn again if ever needed
                kept.pop(next(iter(kept)))
            kept[record] = np.stack([c[: per_record * n] for c in columns], axis=1)
        return kept[record][place * n : (place + 1) * n]

    return ErrorPieces(None, draw)


def recorded_pieces(
    logs: Sequence[Mapping[str, Series]],
    n: int,
    rate_hz: float,
    *,
    remove_mean: Literal["record", "piece", "none"] = "record",
) -> ErrorPieces:
    """Non-overlapping pieces of recorded static signals, record after record.

    Parameters
    ----------
    logs : sequence of mappings
        Per record, axis to :class:`~insemu.records.Series` in SI.
    n : int
        Samples per piece.
    rate_hz : float
        IMU rate; records at another rate are refused, since resampling would change their noise.
    remove_mean : {"record", "piece", "none"}
        Gravity and Earth rate are part of a static signal's mean, so "none" is for signals that are errors already.

    Raises
    ------
    InputError
        Another rate, or no record as long as a piece.
    """
    places: list[tuple[int, int]] = []
    columns: list[Array] = []
    for k, log in enumerate(logs):
        for axis in AXES:
            if abs(log[axis].rate_hz / rate_hz - 1.0) > 1e-6:
                raise InputError(
                    f"record {k + 1}, {axis} is sampled at {log[axis].rate_hz:g} Hz, expected the IMU rate of {rate_hz:g} Hz; "
                    "resampling would change its noise"
                )
        length = min(len(log[axis]) for axis in AXES)
        block = np.stack([log[axis].values[:length] for axis in AXES], axis=1)
        if remove_mean == "record":
            block = block - block.mean(axis=0)
        columns.append(block)
        places += [(k, start) for start in range(0, length - n + 1, n)]
    if not places:
        longest = max(len(c) for c in columns) / rate_hz
        raise InputError(f"the longest recorded signal has {longest:g} s, shorter than the flight of {n / rate_hz:g} s")

    def draw(realization: int) -> Array:
        record, start = places[realization]
        piece = columns[record][start : start + n]
        return piece - piece.mean(axis=0) if remove_mean == "piece" else piece

    return ErrorPieces(len(places), draw)
