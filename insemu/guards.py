"""What arrays and numbers of a record must be."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.errors import InputError

Array = NDArray[np.float64]

#: Shortest usual step between two times, s: no sensor has a rate of 1 THz, and one over less has no number.
SHORTEST = 1e-12
#: Largest number in a record: beyond, its square is none.
LARGEST = 1e100
#: Largest time, s: stamps since 1970 in ps are not as far, and what is further away overflows with small steps.
FARTHEST = 1e24


def frozen(
    value: ArrayLike, name: str, shape: tuple[int | None, ...], *, finite: bool = True, largest: float = LARGEST
) -> Array:
    """Check and freeze an array.

    Parameters
    ----------
    value : array_like
    name : str
        For messages.
    shape : tuple of int or None
        None means any length.
    finite : bool
        Whether every number must be.
    largest : float
        Largest size of a number.

    Raises
    ------
    InputError
        Another type or shape, numbers that are not finite or too large.
    """
    given = np.asarray(value)
    if given.dtype.kind not in "fiu":
        raise InputError(f"{name} has type {given.dtype}, expected real numbers")
    array = np.asarray(given, dtype=np.float64, order="C")  # one layout: every other one has kernels compiled anew
    if array.ndim != len(shape) or any(
        want is not None and have != want for have, want in zip(array.shape, shape, strict=True)
    ):
        expected = "(" + ", ".join("n" if s is None else str(s) for s in shape) + ("," if len(shape) == 1 else "") + ")"
        raise InputError(f"{name} has shape {array.shape}, expected {expected}")
    # the smallest and the largest tell, without a flag per sample of a long record
    size = max(-float(array.min()), float(array.max())) if array.size else 0.0
    if not np.isfinite(size):
        good = np.isfinite(array)
        if finite:
            first = int(np.argmin(good.reshape(array.shape[0], -1).all(axis=1)))
            raise InputError(
                f"{name} has {int((~good).sum())} value(s) that are not finite, the first at row {first}; expected finite numbers"
            )
        size = float(np.abs(array).max(where=good, initial=0.0))
    if size > largest:
        raise InputError(f"{name} holds numbers beyond {largest:g}, expected smaller ones")
    if array is given:
        array = array.view()
    array.setflags(write=False)
    return array


def finite(value: object) -> bool:
    """Whether something is one finite real number."""
    return isinstance(value, int | float | np.integer | np.floating) and bool(np.isfinite(value))


def latitudes(llh: Array, name: str) -> None:
    """Refuse latitudes beyond the poles."""
    latitude = np.where(np.isfinite(llh[:, 0]), llh[:, 0], 0.0)
    k = int(np.argmax(np.abs(latitude)))
    if abs(latitude[k]) > np.pi / 2 + 1e-12:
        raise InputError(
            f"{name} row {k} has a latitude of {latitude[k]:.6g} rad ({np.degrees(latitude[k]):.6g} deg), expected -pi/2 to pi/2 rad; "
            "numpy.radians makes them of degrees"
        )


def frozen_times(value: ArrayLike, name: str) -> Array:
    """Check and freeze strictly increasing times (n,), s; raises ``InputError``."""
    t = frozen(value, name, (None,), largest=np.inf)
    if t.size == 0:
        raise InputError(f"{name} is empty, expected at least one time")
    if max(-t.min(), t.max()) > FARTHEST:
        raise InputError(f"{name} runs from {t[0]:g} to {t[-1]:g} s; expected times within {FARTHEST:g} s")
    step = np.diff(t)
    if (step <= 0).any():
        k = int(np.argmax(step <= 0)) + 1
        what = "repeats" if step[k - 1] == 0 else "goes back"
        raise InputError(f"{name} {what} at row {k} ({t[k - 1]!r} then {t[k]!r}); expected strictly increasing seconds")
    if step.size and step.min() < SHORTEST and np.median(step) < SHORTEST:  # a rate is one over it
        raise InputError(f"{name} has steps of {np.median(step):g} s; expected at least {SHORTEST:g} s")
    return t
