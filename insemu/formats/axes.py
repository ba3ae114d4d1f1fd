"""Axes as text: where three axes point, and which columns they are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError

Array = NDArray[np.float64]

_LETTERS = {"F": (0, 1.0), "B": (0, -1.0), "R": (1, 1.0), "L": (1, -1.0), "D": (2, 1.0), "U": (2, -1.0)}
_NAMED = {"ENU": "RFU", "NED": "FRD", "NWU": "FLU", "SELF": "FRD"}


def axes_matrix(letters: str) -> Array:
    """Matrix that takes vectors of axes such as ``FLU`` to forward-right-down.

    Raises
    ------
    InputError
        Not three letters of three directions, or a left-handed set.

    Examples
    --------
    >>> axes_matrix("FLU").tolist()
    [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]
    """
    text = _NAMED.get(letters.upper(), letters.upper())
    if len(text) != 3 or any(c not in _LETTERS for c in text) or len({_LETTERS[c][0] for c in text}) != 3:
        raise InputError(f"axes are '{letters[:20]}', expected three letters such as FRD, FLU or RFU")
    matrix = np.zeros((3, 3))
    for column, letter in enumerate(text):
        row, sign = _LETTERS[letter]
        matrix[row, column] = sign
    if np.linalg.det(matrix) < 0:
        raise InputError(f"axes '{letters}' are left-handed; turn an axis round instead (--map 'gyro_axes=x y -z')")
    return matrix


def axis_order(text: str, where: str) -> Array:
    """Matrix that puts columns into an order such as ``y x -z``: row k picks the column of axis k.

    Parameters
    ----------
    text : str
    where : str
        Place, for the message.

    Raises
    ------
    InputError
        Not x, y and z once each, each with a sign or without.
    """
    words = text.split()
    if sorted(w.removeprefix("-") for w in words) != ["x", "y", "z"]:
        raise InputError(
            f"the order of axes is '{text[:40]}', expected x, y and z once each, such as y -x z", where=where
        )
    matrix = np.zeros((3, 3))
    for row, word in enumerate(words):
        matrix[row, "xyz".index(word[-1])] = -1.0 if word.startswith("-") else 1.0
    return matrix
