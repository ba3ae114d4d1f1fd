"""Stochastic sensor errors: drawn from noise models, or pieces of a recorded signal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.augment import per_axis
from insemu.errors import InputError
from insemu.noise import CommonDraws, NoiseModel, Process
from insemu.records import AXES

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RecordedErrors:
    """Error signals of a real sensor at rest, to be cut into pieces that do not overlap.

    Parameters
    ----------
    values : (n, 6) array
        Recorded signal in rad/s and m/s^2, columns in the order of :data:`insemu.records.AXES`.
    rate_hz : float
        Its sampling rate; an IMU at another rate is refused, because a resampled error is another error.
    remove_mean : {"record", "piece", "none"} or (start_s, end_s)
        Over what the mean of every axis is removed: the whole record (as the 2014 paper did), every piece, nothing,
        or a span.
    offset_s : float
        What is skipped at the start (warm-up).
    order : tuple of int, optional
        Which piece each realization takes; the natural order where not given.
    name : str
        Appears in messages.
    """

    values: Array
    rate_hz: float
    remove_mean: str | tuple[float, float] = "record"
    offset_s: float = 0.0
    order: tuple[int, ...] | None = None
    name: str = "recorded errors"

    def __post_init__(self) -> None:
        values = np.array(self.values, dtype=np.float64)
        if values.ndim != 2 or values.shape[1] != 6:
            raise InputError(f"{self.name} has shape {values.shape}, expected (n, 6)")
        if not np.isfinite(values).all():
            row = int(np.argmax(~np.isfinite(values).all(axis=1)))
            raise InputError(f"{self.name} has values that are not finite, the first at row {row}")
        if not (np.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise InputError(f"{self.name} has a rate of {self.rate_hz} Hz, expected a positive number")
        skip = round(self.offset_s * self.rate_hz)
        if self.offset_s < 0 or skip >= values.shape[0]:
            raise InputError(
                f"{self.name}: an offset of {self.offset_s:g} s is outside the record of {values.shape[0] / self.rate_hz:g} s"
            )
        if isinstance(self.remove_mean, str):
            if self.remove_mean not in ("record", "piece", "none"):
                raise InputError(
                    f"{self.name}: remove_mean is '{self.remove_mean}', expected 'record', 'piece', 'none' or a span in s"
                )
            if self.remove_mean == "record":
                values -= values.mean(axis=0)
        else:
            a, b = (round(s * self.rate_hz) for s in self.remove_mean)
            if not 0 <= a < b <= values.shape[0]:
                raise InputError(
                    f"{self.name}: the span {self.remove_mean} s for the mean is not inside the record of "
                    f"{values.shape[0] / self.rate_hz:g} s"
                )
            values -= values[a:b].mean(axis=0)
        values = values[skip:]
        values.setflags(write=False)
        object.__setattr__(self, "values", values)

    def count(self, n: int) -> int:
        """How many pieces of ``n`` samples there are (row 0 of an IMU record counts)."""
        return int(self.values.shape[0] // n)

    def piece(self, index: int, n: int) -> Array:
        """Piece (n, 6) of a realization.

        Raises
        ------
        InputError
            There are fewer pieces than that.
        """
        available = self.count(n)
        if self.order is not None:
            if index >= len(self.order):
                raise InputError(
                    f"{self.name}: realization {index} asked for, but the order names {len(self.order)} pieces"
                )
            index = self.order[index]
        if not 0 <= index < available:
            raise InputError(
                f"{self.name} of {self.values.shape[0] / self.rate_hz:g} s gives {available} piece(s) of "
                f"{n / self.rate_hz:g} s that do not overlap; piece {index + 1} does not exist "
                "(a shorter flight, fewer realizations or a longer record)"
            )
        out = self.values[index * n : (index + 1) * n]
        return out - out.mean(axis=0) if self.remove_mean == "piece" else out


def draw_errors(
    truth: Mapping[str, NoiseModel | Process] | RecordedErrors | None,
    n: int,
    dt: float,
    rng: np.random.Generator,
    realization: int = 0,
    covariates: Mapping[str, Array] | None = None,
) -> tuple[Array, dict[str, Array]]:
    """Draw (n, 6) stochastic errors in rad/s and m/s^2 and the components per axis.

    Every axis has its own child of ``rng``, so a model changed on one axis leaves the others as they were.

    Parameters
    ----------
    truth : mapping, RecordedErrors or None
        Axes, or ``gyro`` and ``accel`` for all three of a sensor (an axis that is named besides has its own), to models; or a recorded signal.
    n : int
        Samples.
    dt : float
        s.
    rng : Generator
    realization : int
        Which piece of a recorded signal is taken.
    covariates : mapping of str to (n,) array, optional
        What levels follow.
    """
    components: dict[str, Array] = {}
    children = rng.spawn(6)
    if truth is None:
        return np.zeros((n, 6)), components
    if isinstance(truth, RecordedErrors):
        if abs(truth.rate_hz * dt - 1.0) > 1e-3:
            raise InputError(
                f"{truth.name} was recorded at {truth.rate_hz:g} Hz but the IMU runs at {1.0 / dt:g} Hz; "
                "recorded errors are not resampled (emulate at the recorded rate)"
            )
        return truth.piece(realization, n).copy(), components
    models = {axis: model for axis, model in per_axis(truth).items() if len(model)}
    # one block for everything, axis by axis: large blocks come in large pages, and a row is drawn where it stays
    block = np.empty((6 + sum(len(m) for m in models.values()), n))
    errors, used, common = block[:6], 6, CommonDraws(models)
    for row, child, axis in zip(errors, children, AXES, strict=True):
        row[:] = 0.0
        model = models.get(axis)
        if model is None:
            continue
        parts = model.simulate_components(n, dt, child, out=block[used : used + len(model)], covariates=covariates)
        common.share(axis, parts)
        used += len(model)
        components[axis] = parts
        for part in parts:
            row += part
    return errors.T, components
