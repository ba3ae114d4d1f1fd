"""Typed values of a YAML document, with messages that name file, line and key."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError, nearest, shown
from insemu.yamlfile import Document, Place

Array = NDArray[np.float64]
T = TypeVar("T")
#: Keys of a slow process.
_SLOW = ("sigma", "time")


class Reader:
    """Typed values of a document; messages name file, line and key."""

    def __init__(self, document: Document) -> None:
        self.document = document

    def fail(self, place: Place, message: str) -> InputError:
        """An error at a place."""
        return InputError(message, where=self.document.where(place))

    def mapping(self, value: Any, place: Place, keys: Sequence[str] | None = None) -> Mapping[str, Any]:
        """A mapping, whose keys are known where they are given.

        Parameters
        ----------
        value : plain data
        place : Place
        keys : sequence of str, optional
        """
        if not isinstance(value, Mapping):
            raise self.fail(place, f"found {shown(value)}, expected keys with values")
        for key in value:
            if keys is not None and key not in keys:
                raise self.fail((*place, key), f"unknown key '{key}'" + nearest(key, keys))
        return value

    def items(self, value: Any, place: Place) -> Sequence[Any]:
        """A list."""
        if not isinstance(value, list):
            raise self.fail(place, f"found {shown(value)}, expected a list")
        return value

    def number(self, value: Any, place: Place) -> float:
        """A number."""
        if isinstance(value, bool) or not isinstance(value, int | float) or np.isnan(value):
            raise self.fail(place, f"found {shown(value)}, expected a number")
        return float(value)

    def text(self, value: Any, place: Place) -> str:
        """A text."""
        if not isinstance(value, str):
            raise self.fail(place, f"found {shown(value)}, expected text")
        return value

    def numbers(self, value: Any, place: Place, count: int | None = None) -> tuple[float, ...]:
        """A list of numbers.

        Parameters
        ----------
        value : plain data
        place : Place
        count : int, optional
        """
        if not isinstance(value, list | tuple) or (count is not None and len(value) != count):
            raise self.fail(
                place, f"found {shown(value)}, expected {'' if count is None else f'{count} '}numbers in brackets"
            )
        return tuple(self.number(x, (*place, k)) for k, x in enumerate(value))

    def rows(self, value: Any, place: Place, shape: tuple[int, int]) -> Array:
        """A table of numbers."""
        if not isinstance(value, list) or len(value) != shape[0]:
            raise self.fail(place, f"expected {shape[0]} rows of {shape[1]} numbers, one row a frequency")
        return np.array([self.numbers(x, (*place, k), shape[1]) for k, x in enumerate(value)])

    def pair(self, value: Any, place: Place) -> tuple[float, float]:
        """A range."""
        low, high = self.numbers(value, place, 2)
        return low, high

    def slow(self, value: Any, place: Place) -> tuple[float, float]:
        """``{sigma, time}`` of a slow process."""
        got = self.mapping(value, place, _SLOW)
        if set(got) != set(_SLOW):
            raise self.fail(place, "expected the keys 'sigma' and 'time'")
        return self.number(got["sigma"], (*place, "sigma")), self.number(got["time"], (*place, "time"))

    def made(self, place: Place, make: Callable[[], T]) -> T:
        """What ``make`` gives; its complaint is that of the place."""
        try:
            return make()
        except InputError as error:
            raise self.fail(place, error.message) from None
