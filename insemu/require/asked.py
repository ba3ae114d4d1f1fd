"""Requirements as people write them: ``planimetric < 1 m at 95 % after 30 s``."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.errors import InputError, nearest
from insemu.units import datasheet, parse

Array = NDArray[np.float64]

#: What may be required: rows of the navigation errors and unit.
QUANTITIES: dict[str, tuple[tuple[int, ...], str]] = {
    "planimetric": ((0, 1), "m"),
    "height": ((2,), "m"),
    "velocity": ((3, 4), "m/s"),
    "heading": ((8,), "rad"),
}
_SHORT = re.compile(r"^\s*([\d.]+\s*%)\s*<\s*(.+?)\s+after\s+(.+?)\s*$")
_TEXT = re.compile(r"^\s*(\w+)\s*<\s*(.+?)(?:\s+at\s+(.+?))?\s+after\s+(.+?)\s*$")
#: Share where none is given; outages outside of these limits (s) are no question of the noise of an IMU.
USUAL_SHARE, SHORTEST, LONGEST = 0.95, 1.0, 3600.0
#: Nodes of the quadrature, standard deviations that it reaches to, and halvings of the search for a quantile.
_NODES, _TAIL, _HALVINGS = 48, 8.0, 40


@dataclass(frozen=True)
class Requirement:
    """A limit of an error at the end of an outage.

    Parameters
    ----------
    quantity : str
        Of :data:`QUANTITIES`.
    limit : float
        SI.
    share : float
        Of outages that may not exceed it, between 0 and 1.
    seconds : float
        Length of the outage, s.
    """

    quantity: str
    limit: float
    share: float
    seconds: float

    @classmethod
    def parse(cls, text: str) -> Requirement:
        """Read a requirement; ``95 % < 1 m after 30 s`` is one of the horizontal position.

        Raises
        ------
        InputError
            Another form, an unknown quantity, a unit of another dimension, or a value that nothing can have.

        Examples
        --------
        >>> Requirement.parse("planimetric < 1 m at 95 % after 30 s").seconds
        30.0
        """
        if short := _SHORT.match(text):
            share, limit, after = short.groups()
            text = f"planimetric < {limit} at {share} after {after}"
        found = _TEXT.match(text)
        if found is None:
            raise InputError(f"found '{text}', expected a requirement such as 'planimetric < 1 m at 95 % after 30 s'")
        name, limit, share, after = found.groups()
        if name not in QUANTITIES:
            raise InputError(f"unknown quantity '{name}' in '{text}'" + nearest(name, QUANTITIES))
        own = cls(
            name,
            parse(limit, QUANTITIES[name][1]),
            round(parse(share, ""), 12) if share else USUAL_SHARE,
            parse(after, "s"),
        )
        if not own.limit > 0.0:
            raise InputError(f"no error is below {limit}, expected a positive limit in '{text}'")
        if not 0.0 < own.share < 1.0:
            raise InputError(f"no sensor keeps a limit at {share}, expected a share between 0 and 100 % in '{text}'")
        if not SHORTEST <= own.seconds <= LONGEST:
            raise InputError(f"an outage of {after} in '{text}', expected {SHORTEST:g} s to {LONGEST:g} s")
        return own

    @property
    def text(self) -> str:
        """As it is written."""
        return f"{self.quantity} < {self.shown(self.limit)} at {100 * self.share:g} % after {self.seconds:g} s"

    def shown(self, value: float) -> str:
        """A value in the unit that people use."""
        number, unit = datasheet(value, QUANTITIES[self.quantity][1])
        return f"{number:.3g} {unit}"

    def error(self, covariance: Array) -> Array:
        """The error that the share of all outages keeps, (...,) in SI.

        Parameters
        ----------
        covariance : (..., starts, 9, 9) array
            Of the navigation errors at the ends; all starts are equally likely.
        """
        rows = list(QUANTITIES[self.quantity][0])
        C = covariance[..., rows, :][..., rows]
        if len(rows) == 2:
            spread, mean = (
                np.hypot(0.5 * (C[..., 0, 0] - C[..., 1, 1]), C[..., 0, 1]),
                0.5 * (C[..., 0, 0] + C[..., 1, 1]),
            )
            return quantile(mean + spread, np.maximum(mean - spread, 0.0), self.share)
        return quantile(C[..., 0, 0], np.zeros_like(C[..., 0, 0]), self.share)


def quantile(large: Array, small: Array, share: float) -> Array:
    """Quantile of the length of a normal vector in the plane, mixed over the last axis in equal parts (a generalised chi-square).

    Parameters
    ----------
    large, small : (..., starts) arrays
        Variances along the principal axes; a small one of zero is the size of one normal number.
    share : float

    Returns
    -------
    (...,) array
    """
    x, w = np.polynomial.legendre.leggauss(_NODES)
    sine, cosine, w = np.sin(0.5 * math.pi * x), np.cos(0.5 * math.pi * x), 0.5 * math.pi * w
    one = np.sqrt(np.maximum(large, 1e-300))[..., None]
    two = np.sqrt(np.maximum(small, 1e-300))[..., None]
    low, high = np.zeros(large.shape[:-1]), 10.0 * np.sqrt(2.0 * large.max(axis=-1))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        ratio = middle[..., None, None] / one
        reach = np.minimum(ratio, _TAIL)
        z = reach * sine
        across = one * np.sqrt(np.maximum(ratio**2 - z**2, 0.0)) / (math.sqrt(2.0) * two)
        density = np.exp(-0.5 * z**2) * reach * cosine / math.sqrt(2.0 * math.pi)
        within = (density * scipy.special.erf(across) * w).sum(-1).mean(-1)
        low, high = np.where(within < share, middle, low), np.where(within < share, high, middle)
    return np.asarray(0.5 * (low + high))


def asked(texts: Sequence[str | Requirement]) -> tuple[Requirement, ...]:
    """Several requirements that have to hold together.

    Raises
    ------
    InputError
        None, one that cannot be read, or two that contradict each other.
    """
    found = tuple(t if isinstance(t, Requirement) else Requirement.parse(t) for t in texts)
    if not found:
        raise InputError("no requirement, expected one such as 'planimetric < 1 m at 95 % after 30 s'")
    for i, one in enumerate(found):
        for two in found[i + 1 :]:
            if one != two and replace(one, limit=two.limit) == two:
                raise InputError(
                    f"'{one.text}' contradicts '{two.text}': the same error has one limit, expected one of them"
                )
    return tuple(dict.fromkeys(found))
