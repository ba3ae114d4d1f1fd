"""The fix of a receiver: weighted least squares on the raw observations of one epoch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from insemu import earth
from insemu.errors import InputError
from insemu.records import GnssRecord, RawRecord

Array = NDArray[np.float64]

#: Steps of the least squares from the centre of the Earth, which divide what is wrong by more than thirty each.
_STEPS = 10
#: Largest dilution of the position with which a receiver gives a fix.
LARGEST_PDOP = 20.0


def single_point(raw: RawRecord) -> tuple[GnssRecord, Array]:
    """Fixes of the epochs with four satellites or more, and their dilutions of precision.

    Parameters
    ----------
    raw : RawRecord

    Returns
    -------
    fixes : GnssRecord
        With the standard deviations north, east, down of the least squares, in which stated ranges and rates are independent.
    dilution : (n, 4) array
        North, east, down and time: roots of the diagonal of the inverse normal matrix with unit weights.

    Raises
    ------
    InputError
        No epoch has a fix.
    """
    used = np.isfinite(raw.range) & np.isfinite(raw.rate)
    enough = used.sum(axis=1) >= 4
    if not enough.any():
        raise InputError("no epoch has a fix, expected four satellites at least")
    raw, used = raw.rows(enough), used[enough]
    weight = np.where(used, 1.0 / raw.range_std**2, 0.0)
    x = np.zeros((len(raw), 4))
    for _ in range(_STEPS):
        sight, distance = _sight(raw, x[:, :3])
        H = np.concatenate([-sight, np.ones_like(sight[:, :, :1])], axis=2)
        x += _least_squares(H, np.where(used, raw.range - distance - x[:, 3:], 0.0), weight)[0]
    rate_weight = np.where(used, 1.0 / raw.rate_std**2, 0.0)
    seen = np.where(used, raw.rate - np.einsum("nsi,nsi->ns", sight, raw.velocity), 0.0)
    v, of_velocity = _least_squares(H, seen, rate_weight)
    llh = earth.ecef_to_llh(x[:, :3])
    turn = np.zeros((len(raw), 4, 4))
    turn[:, :3, :3], turn[:, 3, 3] = np.swapaxes(earth.dcm_en(llh[:, 0], llh[:, 1]), 1, 2), 1.0

    def spread(Q: Array) -> Array:
        return np.asarray(np.sqrt(np.einsum("nij,njk,nik->ni", turn, Q, turn)))

    of_place, dilution = (spread(_inverse(H, w)) for w in (weight, used.astype(np.float64)))
    good = np.linalg.norm(dilution[:, :3], axis=1) <= LARGEST_PDOP
    if not good.any():
        raise InputError(f"no epoch has a fix, expected a dilution of at most {LARGEST_PDOP:g}")
    velocity = np.einsum("nij,nj->ni", turn, v)[:, :3]
    fixes = GnssRecord(raw.t, llh, velocity, of_place[:, :3], spread(of_velocity)[:, :3])
    return fixes.rows(good), dilution[good]


def _sight(raw: RawRecord, place: Array) -> tuple[Array, Array]:
    """Directions (n, s, 3) and distances (n, s) of the satellites from places (n, 3)."""
    away = raw.place - place[:, None]
    distance = np.linalg.norm(away, axis=2)
    return away / distance[:, :, None], distance


def _inverse(H: Array, weight: Array) -> Array:
    """Inverse normal matrices (n, 4, 4) of rows (n, s, 4) with weights (n, s)."""
    return np.asarray(np.linalg.inv(np.einsum("nsi,ns,nsj->nij", H, weight, H)), dtype=np.float64)


def _least_squares(H: Array, y: Array, weight: Array) -> tuple[Array, Array]:
    """Solutions (n, 4) of rows (n, s, 4) for values (n, s) with weights, and their covariances (n, 4, 4)."""
    Q = _inverse(H, weight)
    return np.asarray(np.einsum("nij,nsj,ns,ns->ni", Q, H, weight, y)), Q
