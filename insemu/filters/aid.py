"""What an aid is: a measurement beside the fixes, with its own time and as many rows as it has."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.effects import EffectUse, aid_errors
from insemu.errors import InputError, nearest
from insemu.records import AidRecord
from insemu.units import parse

Array = NDArray[np.float64]

#: Most constants that an aid can carry (``AidRecord.settings``).
SETTINGS = 6
#: Times are sums of rounded periods, s.
SLACK = 1e-6


@dataclass(frozen=True)
class TrueMotion:
    """What an emulated aid measures: position (n, 3), velocity NED (n, 3), body to NED (n, 3, 3), rate against NED in body axes (n, 3)."""

    llh: Array
    velocity: Array
    C: Array
    rate: Array


@dataclass(frozen=True)
class Aid:
    """One kind of aid; a file in ``insemu/filters/aids`` defines it as ``AID``, and nothing else names it.

    Parameters
    ----------
    name : str
    rows : mapping of str to str
        Its components with their SI units.
    fill : compiled function
        ``fill(moment, z, settings, rows)``; see :mod:`insemu.filters.rows`.
    truth : callable, optional
        True motion and settings (SETTINGS,) to the values (n, rows) of a perfect instrument; None: it is not emulated.
    settings : mapping of str to (unit, size)
        Its constants in their order in ``AidRecord.settings``; all are zero where nothing is said.
    constraint : bool
        What it says is zero whatever the vehicle does: no instrument, whose noise and errors it would have.
    """

    name: str
    rows: Mapping[str, str]
    fill: Callable[..., None]
    truth: Callable[[TrueMotion, Array], Array] | None = None
    settings: Mapping[str, tuple[str, int]] | None = None
    constraint: bool = False


@dataclass(frozen=True)
class AidUse:
    """An aid of an emulated flight: which, how often, how good, where mounted.

    Parameters
    ----------
    aid : Aid
    rate : float
        Hz.
    sigma : tuple of float
        Standard deviations of its rows, SI.
    settings : tuple of float
        SI.
    outages : tuple of (start, duration)
        s; it measures nothing from just after the start to the end.
    """

    aid: Aid
    rate: float
    sigma: tuple[float, ...]
    settings: tuple[float, ...] = ()
    outages: tuple[tuple[float, float], ...] = ()

    @classmethod
    def from_mapping(cls, aid: Aid, given: Mapping[str, Any]) -> AidUse:
        """As a scenario says it: ``rate``, ``sigma`` (one value, or one per row), ``outages`` (pairs of start and duration), and the aid's settings.

        Raises
        ------
        InputError
            An unknown or missing key, another number of values, a standard deviation or rate that is not positive.
        """
        constants = aid.settings or {}
        known = ("rate", "sigma", "outages", *constants)
        for key in given:
            if key not in known:
                raise InputError(f"unknown key '{key}'" + nearest(str(key), known))
        if "sigma" not in given:
            raise InputError(
                f"the key 'sigma' is missing, expected one value or {len(aid.rows)}: {', '.join(aid.rows)}"
            )
        sigma = _numbers(given["sigma"], list(aid.rows.values()), "sigma")
        (rate,) = _numbers(given.get("rate", 1.0), ["Hz"], "rate")
        if min(*sigma, rate) <= 0.0:
            raise InputError(f"found {min(*sigma, rate)!r}, expected a positive rate and positive standard deviations")
        settings = [
            v
            for key, (unit, size) in constants.items()
            for v in _numbers(given.get(key, [0.0] * size), [unit] * size, key)
        ]
        spans = given.get("outages", [])
        if not isinstance(spans, list | tuple) or not all(isinstance(v, list | tuple) and len(v) == 2 for v in spans):
            raise InputError(f"found {spans!r} under 'outages', expected a list of pairs of start and duration")
        outages = [_numbers(span, ["s", "s"], "outages") for span in spans]
        if any(not (math.isfinite(start) and 0.0 <= duration < math.inf) for start, duration in outages):
            raise InputError(
                f"found {spans!r} under 'outages', expected finite starts and durations that are not negative"
            )
        return cls(aid, rate, sigma, tuple(settings), tuple((start, duration) for start, duration in outages))

    def to_mapping(self) -> dict[str, Any]:
        """Inverse of :meth:`from_mapping`, in SI."""
        out: dict[str, Any] = {"rate": self.rate, "sigma": list(self.sigma)}
        at = 0
        for key, (_, size) in (self.aid.settings or {}).items():
            out[key] = list(self.settings[at : at + size])
            at += size
        return out | ({"outages": [list(span) for span in self.outages]} if self.outages else {})

    def times(self, t: Array) -> Array:
        """When it measures within the epochs ``t`` (n,) of an IMU, s."""
        out = np.arange(t[0] + 1.0 / self.rate, t[-1], 1.0 / self.rate)
        for start, duration in self.outages:
            out = out[(out <= start + SLACK) | (out > start + duration + SLACK)]
        return out

    def record(
        self, t: Array, motion: TrueMotion, rng: np.random.Generator | None, effects: Sequence[EffectUse] = ()
    ) -> AidRecord:
        """What it measures of a motion, with white noise; without a generator, perfectly.

        Parameters
        ----------
        t : (n,) array
            Stamps, s.
        motion : TrueMotion
            When it measured.
        rng : Generator or None
        effects : sequence of EffectUse
            What it errs by; those of other sensors are passed over.
        """
        assert self.aid.truth is not None
        settings = np.zeros(SETTINGS)
        settings[: len(self.settings)] = self.settings
        values = self.aid.truth(motion, settings)
        std = np.broadcast_to(self.sigma, values.shape)
        if self.aid.constraint:
            values = np.zeros_like(values)
        if rng is None or self.aid.constraint:
            return AidRecord(self.aid.name, t, values, std, self.settings)
        noise = std * rng.standard_normal(values.shape)
        errors = aid_errors(self.aid.name, t, values, effects, rng)
        return AidRecord(self.aid.name, t, errors.values + errors.level * noise + errors.added, std, self.settings)


def _numbers(given: Any, wanted: list[str], key: str) -> tuple[float, ...]:
    items = list(given) if isinstance(given, list | tuple) else [given] * len(wanted)
    if len(items) != len(wanted) or any(isinstance(v, bool) or not isinstance(v, str | int | float) for v in items):
        raise InputError(
            f"found {given!r} under '{key}', expected {'one value or ' if len(wanted) > 1 else ''}{len(wanted)} in {', '.join(wanted)}"
        )
    return tuple(float(parse(v, unit)) for v, unit in zip(items, wanted, strict=True))
