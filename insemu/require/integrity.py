"""Does a filter keep a requirement, and does it know when it does not: protection levels from its covariance, and the Stanford diagram.

A protection level is a bound of the error that the filter states from its covariance at a risk ``p``: horizontally ``sqrt(-2 ln p)`` times the
standard deviation along the axis in which it is largest, for one component the normal quantile of ``1 - p / 2`` (RTCA DO-229E 2016, appendix J,
whose factors 6.18 and 5.33 are those of 5e-9 and 1e-7). The limit of a requirement is the alert limit and the share that may exceed it the risk. A
flight is hazardous where the error exceeds the limit and the protection level does not (Tossaint et al. 2007).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.evaluate import Results, share_interval
from insemu.require.asked import QUANTITIES, Requirement

Array = NDArray[np.float64]

#: Regions of the Stanford diagram: of error E, protection level P and alert limit A.
REGIONS = {
    "nominal": "E <= P <= A",
    "misleading": "P < E <= A",
    "hazardous": "P <= A < E",
    "unavailable": "P > A, E <= P",
    "unavailable and misleading": "P > A, E > P",
}
#: Outages whose length differs from the asked one by no more than this are those that are asked for, s.
SAME_S = 0.5


def protection_factor(components: int, risk: float) -> float:
    """Protection level in standard deviations: of one component, or of two along the axis in which they are largest."""
    return math.sqrt(-2.0 * math.log(risk)) if components == 2 else float(-scipy.special.ndtri(0.5 * risk))


@dataclass(frozen=True)
class Guard:
    """One requirement over independent flights of one filter.

    Parameters
    ----------
    requirement : Requirement
    subject : str
        What was flown.
    error, protection : (n,) arrays
        SI; the size of the errors, and what the filter states that they stay below at the risk of the requirement.
    """

    requirement: Requirement
    subject: str
    error: Array
    protection: Array

    @property
    def within(self) -> int:
        """Flights whose error is within the limit."""
        return int((self.error <= self.requirement.limit).sum())

    @property
    def regions(self) -> dict[str, int]:
        """Flights in every region of :data:`REGIONS`."""
        over, alert = self.error > self.protection, self.requirement.limit
        far, out = self.error > alert, self.protection > alert
        found = (~over & ~out, over & ~out & ~far, ~out & far, ~over & out, over & out)
        return {name: int(rows.sum()) for name, rows in zip(REGIONS, found, strict=True)}

    @property
    def exceeded(self) -> int:
        """Flights whose error is larger than the protection level."""
        return int((self.error > self.protection).sum())

    @property
    def kept(self) -> bool:
        """Whether as many flights as required are within the limit, and errors exceed protection levels no more often than the risk says.

        The second is broken where the exact 95 % interval of the share that exceeds them lies above the risk.
        """
        n, r = self.error.size, self.requirement
        return self.within >= r.share * n and share_interval(self.exceeded, n)[0] <= 1.0 - r.share

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        n, r = self.error.size, self.requirement
        hazardous = share_interval(self.regions["hazardous"], n)
        return {
            "subject": self.subject, "requirement": r.text, "kept": self.kept, "flights": n, "within": self.within,
            "within_interval95": share_interval(self.within, n), "protection_exceeded": self.exceeded,
            "regions": self.regions, "hazardous_interval95": hazardous,
        }  # fmt: skip

    def __str__(self) -> str:
        n, r = self.error.size, self.requirement
        low, high = (100 * x for x in share_interval(self.within, n))
        worst = [100 * x for x in share_interval(self.regions["hazardous"], n)]
        return (
            f"{self.subject}: {r.text} {'is kept' if self.kept else 'is broken'}: "
            f"{self.within} of {n} within the limit (95 %: {low:.1f} to {high:.1f} %), "
            f"{self.exceeded} above their protection level, {self.regions['hazardous']} hazardous (95 %: {worst[0]:.1f} to {worst[1]:.1f} %)"
        )


def guards(results: Results, requirements: Sequence[Requirement]) -> list[Guard]:
    """Requirements at the ends of an experiment's outages, design by design; realizations are independent.

    Raises
    ------
    InputError
        No outage of the length that is asked for, or a quantity whose protection level is not defined.
    """
    out = []
    for r in requirements:
        same = [k for k, (_, duration) in enumerate(results.outages) if abs(duration - r.seconds) <= SAME_S]
        if not same:
            lengths = ", ".join(f"{duration:g} s" for _, duration in results.outages) or "none"
            raise InputError(f"no outage lasts {r.seconds:g} s, expected one of: {lengths}", where="--require")
        rows = list(_rows(r))
        for d, name in enumerate(results.names):
            for k in same:
                error, sigma = (results.total.runs[what][d, :, k] for what in ("end_error", "end_sigma"))
                stated = results.total.runs["end_major"][d, :, k] if len(rows) == 2 else sigma[:, rows[0]]
                factor = protection_factor(len(rows), 1.0 - r.share)
                size = np.linalg.norm(error[:, rows], axis=1)
                out.append(Guard(r, f"{name}, outage {k + 1}", size, factor * stated))
    return out


def recorded_guard(requirement: Requirement, start: Array, horizons: Array, error: Array, covariance: Array) -> Guard:
    """A requirement over outages that were cut from a recording; those that overlap an earlier one are left out, so that the rest are independent.

    Parameters
    ----------
    requirement : Requirement
        Horizontal.
    start, horizons : (k,), (h,) arrays
        s.
    error, covariance : (k, h, 2), (k, h, 2, 2) arrays
        Against the fixes, NaN where there is none, and what is stated of them.

    Raises
    ------
    InputError
        Another quantity, a length that was not cut, or no outage of it.
    """
    r = requirement
    if r.quantity != "planimetric":
        raise InputError(f"found '{r.quantity}', expected planimetric: fixes tell nothing else", where="--require")
    at = np.flatnonzero(np.abs(horizons - r.seconds) <= SAME_S)
    if not at.size:
        raise InputError(
            f"no outage of {r.seconds:g} s was cut, expected one of: {', '.join(f'{h:g} s' for h in horizons)}",
            where="--require",
        )
    e, P, last, rows = error[:, at[0]], covariance[:, at[0]], -math.inf, []
    for k in np.flatnonzero(np.isfinite(e[:, 0])):
        if start[k] >= last + r.seconds:
            last = start[k]
            rows.append(k)
    if not rows:
        raise InputError(f"the recording has no outage of {r.seconds:g} s", where="--require")
    major = np.sqrt(np.linalg.eigvalsh(P[rows])[:, 1])
    return Guard(r, "the recording", np.linalg.norm(e[rows], axis=1), protection_factor(2, 1.0 - r.share) * major)


def _rows(r: Requirement) -> tuple[int, ...]:
    if r.quantity == "velocity":
        raise InputError(
            "found velocity, expected planimetric, height or heading: of these a protection level is stated",
            where="--require",
        )
    return QUANTITIES[r.quantity][0]
