"""What a filter is told about how it runs, and about its initial navigation state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.augment import Extras
from insemu.errors import InputError
from insemu.filters.aids import Standstill
from insemu.filters.families import Family

Array = NDArray[np.float64]
Store = Literal["none", "fixes"]


def three_sigmas(value: ArrayLike | None, name: str, *, unknown: bool = False) -> Array:
    """Three standard deviations; where ``unknown`` is allowed, None or NaN stand for "not known".

    Parameters
    ----------
    value : scalar or (3,) array_like, or None
    name : str
        What the message calls it.
    unknown : bool
        Whether None and NaN are allowed.

    Returns
    -------
    (3,) array
        NaN where it is not known.

    Raises
    ------
    InputError
        A negative or infinite number, or NaN where it is not allowed.
    """
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
            [
                three_sigmas(getattr(self, name), f"initial {name} sigma")
                for name in ("position", "velocity", "attitude")
            ]
        )


@dataclass(frozen=True)
class FilterOptions:
    """How the filter runs; what it believes is not here.

    Parameters
    ----------
    covariance_every : int
        Covariance propagated every n-th IMU epoch (and at every fix); 1 is full rate.
    output_every : int
        A row of the result every n-th IMU epoch; one between two propagations of the covariance has the variances of the earlier one.
    gate : float, optional
        Probability with which a good fix is rejected by the test of its normalised innovation squared; None: no gate.
    gate_timeout : float
        Fixes are rejected for so long in a row, s; then one is taken whatever it says, for a filter that is off by more than it believes would
        reject all that could tell it. The EKF3 of ArduPilot waits 7 s for positions, 10 s with velocities (AP_NavEKF3.h, posRetryTime).
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
    family : Family
        How estimate and covariance are carried over a measurement.
    """

    covariance_every: int = 1
    output_every: int = 1
    gate: float | None = None
    gate_timeout: float = 10.0
    store: Store = "none"
    node_every: float | None = None
    covariance_at: Sequence[float] = ()
    extras: Extras = field(default_factory=Extras)
    standstill: Standstill | None = None
    imposed_gnss_sigma: bool = False
    family: Family = field(default_factory=Family)

    def rows(self, epochs: int) -> NDArray[np.int64]:
        """The IMU epochs of so many that have a row in the result: every ``output_every``-th and the last."""
        at = np.arange(0, epochs, self.output_every)
        return at if at[-1] == epochs - 1 else np.append(at, epochs - 1)

    def __post_init__(self) -> None:
        for name in ("covariance_every", "output_every"):
            value = getattr(self, name)
            if not (isinstance(value, int) and value >= 1):
                raise InputError(f"{name} is {value!r}, expected a whole number of at least 1")
        if self.gate is not None and not 0.0 < self.gate < 1.0:
            raise InputError(f"gate is {self.gate!r}, expected a probability between 0 and 1, for example 1e-4")
        if not self.gate_timeout > 0:
            raise InputError(f"gate_timeout is {self.gate_timeout!r}, expected a positive number of seconds")
        if self.store not in get_args(Store):
            raise InputError(f"store is '{self.store}', expected one of: {', '.join(get_args(Store))}")
        if self.node_every is not None and not self.node_every > 0:
            raise InputError(f"node_every is {self.node_every!r}, expected a positive number of seconds")
