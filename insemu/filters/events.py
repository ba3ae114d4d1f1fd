"""What the filter measures, in order: fixes and aids laid on the epochs of an IMU record."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.compiled import njit
from insemu.errors import InputError, nearest
from insemu.filters.aid import SETTINGS
from insemu.filters.aids import AIDS, CODES, SATELLITE
from insemu.filters.measurements import FIX
from insemu.filters.options import three_sigmas
from insemu.records import AidRecord, GnssRecord, RawRecord

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
GnssSigma = tuple[ArrayLike | None, ArrayLike | None]

#: Components of a fix: position, then velocity. An aid with more rows makes every table wider.
FIX_ROWS = 6
#: Kinds of measurements: fixes, all aids and satellites.
KINDS = 1 + SATELLITE
#: Times this share of a sampling interval apart are the same.
SAME_TIME = 1e-6


class Events(NamedTuple):
    """Fixes and aids in the order of the epochs at which they are used, f of them with up to w components.

    Parameters
    ----------
    t : (f,) array
        Time of validity as stamped, s.
    epoch : (f,) array of int
        First IMU row at or after that time.
    kind : (f,) array of int
        0 for a fix, else the code of the aid or of a satellite.
    since : (f,) array of int
        IMU row after which a mean rate is taken (aids).
    tau : (f,) array
        Seconds from the time of validity to the epoch.
    z, var : (f, w) arrays
        Measured values, and their variances; NaN where there is none.
    settings : (f, SETTINGS) array
        Constants of the aids, motion of the satellites.
    """

    t: Array
    epoch: Ints
    kind: Ints
    since: Ints
    tau: Array
    z: Array
    var: Array
    settings: Array

    @classmethod
    def none(cls) -> Events:
        """No measurement at all."""
        none, nothing = np.zeros(0, dtype=np.int64), np.zeros(0)
        wide = np.zeros((0, FIX_ROWS))
        return cls(nothing, none, none, none, nothing, wide, wide, np.zeros((0, SETTINGS)))


@njit(cache=True, nogil=True)
def queues(kind: Ints) -> tuple[Ints, Ints]:
    """First event of every kind (:data:`KINDS`,) and the next of the same kind (f,), -1 where there is none.

    Parameters
    ----------
    kind : (f,) array of int
    """
    first, following = np.full(KINDS, -1), np.full(kind.size, -1)
    for e in range(kind.size - 1, -1, -1):
        following[e] = first[kind[e]]
        first[kind[e]] = e
    return first, following


def joined(parts: Sequence[Events]) -> Events:
    """Several lists of events as one, in the order of their epochs; narrow ones are filled up with NaN."""
    width = max(p.z.shape[1] for p in parts)

    def wide(values: Array) -> Array:
        return np.pad(values, ((0, 0), (0, width - values.shape[1])), constant_values=np.nan)

    columns = {name: [getattr(p, name) for p in parts] for name in Events._fields}
    for name in ("z", "var"):
        columns[name] = [wide(v) for v in columns[name]]
    together = {name: np.concatenate(values) for name, values in columns.items()}
    order = np.argsort(together["epoch"], kind="stable")
    return Events(**{name: np.ascontiguousarray(v[order]) for name, v in together.items()})


def side_by_side(lists: Sequence[Events]) -> tuple[list[Events], list[Ints]]:
    """The events of several flights at the same times, and the rows of each one's own: fixes that one has not are NaN in it.

    Parameters
    ----------
    lists : sequence of Events
        Of the same aids; no two fixes of one of the same time.
    """
    first = lists[0]
    if all(np.array_equal(e.t, first.t) and np.array_equal(e.epoch, first.epoch) for e in lists):
        return list(lists), [np.arange(first.t.size)] * len(lists)
    of_fix = [np.flatnonzero(e.kind == FIX) for e in lists]
    stamps = np.concatenate([np.stack([e.epoch[k], e.t[k]], axis=1) for e, k in zip(lists, of_fix, strict=True)])
    _, taken, place = np.unique(stamps, axis=0, return_index=True, return_inverse=True)
    aids = Events(*(v[first.kind != FIX] for v in first))
    found = zip(*([v[k] for v in e] for e, k in zip(lists, of_fix, strict=True)), strict=True)
    fixes = Events(*(np.concatenate(v)[taken] for v in found))
    fixes.z[:], fixes.var[:] = np.nan, np.nan
    order = np.argsort(np.concatenate([fixes.epoch, aids.epoch]), kind="stable")
    row_of = np.empty(order.size, dtype=np.int64)
    row_of[order] = np.arange(order.size)
    together = joined([fixes, aids])
    out, rows = [], []
    for e, own in zip(lists, np.split(place.reshape(-1), np.cumsum([k.size for k in of_fix])[:-1]), strict=True):
        at = np.empty(e.t.size, dtype=np.int64)
        at[e.kind == FIX], at[e.kind != FIX] = row_of[own], row_of[fixes.t.size :]
        z, var = np.full((2, *together.z.shape), np.nan)
        z[at], var[at] = e.z, e.var
        out.append(together._replace(z=z, var=var))
        rows.append(at)
    return out, rows


def _on_epochs(t: Array, dt: float, times: Array) -> tuple[Ints, Array]:
    """First row of ``t`` at or after each time, and the seconds from one to the other."""
    tolerance = SAME_TIME * dt
    epoch = np.searchsorted(t, times - tolerance).astype(np.int64)
    tau = t[epoch] - times
    tau[np.abs(tau) < tolerance] = 0.0
    return epoch, tau


def fix_events(t: Array, dt: float, gnss: GnssRecord, sigma: GnssSigma | None, *, imposed: bool) -> Events:
    """Fixes on the epochs of an IMU.

    Parameters
    ----------
    t : (n,) array
        Epochs, s.
    dt : float
        Nominal sampling interval, s.
    gnss : GnssRecord
    sigma : (position, velocity), optional
        Standard deviations, m and m/s, where the record states none.
    imposed : bool
        Use ``sigma`` even where the record states its own.

    Raises
    ------
    InputError
        A fix without a standard deviation.
    """
    inside = np.nonzero((gnss.t > t[0] + SAME_TIME * dt) & (gnss.t <= t[-1] + SAME_TIME * dt))[0]
    times = gnss.t[inside]
    z, var = np.full((2, inside.size, FIX_ROWS), np.nan)
    for at, values, stated in ((0, gnss.llh, gnss.pos_std_ned), (1, gnss.vel_ned, gnss.vel_std_ned)):
        if values is None:
            continue
        columns = slice(3 * at, 3 * at + 3)
        z[:, columns] = values[inside]
        if stated is not None and not (imposed and sigma is not None):
            var[:, columns] = stated[inside] ** 2
        elif sigma is not None:
            var[:, columns] = three_sigmas(sigma[at], "gnss_sigma", unknown=True) ** 2
    missing = np.isfinite(z) & ~(var > 0)
    if missing.any():
        k, i = np.argwhere(missing)[0]
        raise InputError(
            f"the fix at {times[k]:g} s has no positive standard deviation for {'position' if i < 3 else 'velocity'}; expected one in "
            "the record or gnss_sigma"
        )
    epoch, tau = _on_epochs(t, dt, times)
    kind = np.full(inside.size, FIX, dtype=np.int64)
    return Events(times, epoch, kind, epoch, tau, z, var, np.zeros((inside.size, SETTINGS)))


def raw_events(t: Array, dt: float, raw: RawRecord) -> Events:
    """Raw observations on the epochs of an IMU, one event for each satellite and epoch; see :func:`fix_events`.

    Parameters
    ----------
    t : (n,) array
        Epochs, s.
    dt : float
        Nominal sampling interval, s.
    raw : RawRecord
        Observations outside the epochs are left out.
    """
    inside = (raw.t > t[0] + SAME_TIME * dt) & (raw.t <= t[-1] + SAME_TIME * dt)
    row, satellite = np.nonzero(inside[:, None] & (np.isfinite(raw.range) | np.isfinite(raw.rate)))
    epoch, tau = _on_epochs(t, dt, raw.t[row])
    z, std = (
        np.stack([a[row, satellite], b[row, satellite]], axis=1)
        for a, b in ((raw.range, raw.rate), (raw.range_std, raw.rate_std))
    )
    settings = np.hstack([raw.place[row, satellite], raw.velocity[row, satellite]])
    kind = np.full(row.size, SATELLITE, dtype=np.int64)
    return Events(raw.t[row], epoch, kind, epoch - 1, tau, z, std**2, settings)


def aid_events(t: Array, dt: float, aid: AidRecord) -> Events:
    """An aid on the epochs of an IMU; see :func:`fix_events`.

    Parameters
    ----------
    t : (n,) array
        Epochs, s.
    dt : float
        Nominal sampling interval, s.
    aid : AidRecord
        Measurements outside the epochs are left out.

    Raises
    ------
    InputError
        An unknown kind, another number of components than that kind has, or too many settings.
    """
    if aid.kind not in AIDS:
        raise InputError(f"no aid '{aid.kind}'" + nearest(aid.kind, AIDS))
    known = AIDS[aid.kind]
    if aid.values.shape[1] != len(known.rows):
        raise InputError(f"{aid.kind} has {aid.values.shape[1]} components, expected {', '.join(known.rows)}")
    if len(aid.settings) > SETTINGS:
        raise InputError(f"{aid.kind} has {len(aid.settings)} settings, expected at most {SETTINGS}")
    inside = np.nonzero((aid.t > t[0] + SAME_TIME * dt) & (aid.t <= t[-1] + SAME_TIME * dt))[0]
    times = aid.t[inside]
    epoch, tau = _on_epochs(t, dt, times)
    since = epoch - 1
    if aid.since is not None:
        # a mean begins at the earliest where the one before it ended
        asked = np.searchsorted(t, aid.since[inside] - SAME_TIME * dt).astype(np.int64)
        since = np.minimum(np.maximum(asked, np.concatenate([[0], epoch[:-1]])), since)
    settings = np.zeros((inside.size, SETTINGS))
    settings[:, : len(aid.settings)] = aid.settings
    kind = np.full(inside.size, CODES[aid.kind], dtype=np.int64)
    return Events(times, epoch, kind, since, tau, aid.values[inside], aid.std[inside] ** 2, settings)
