"""An augmentation laid out in the slots of the compiled loop."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from insemu.augment import Augmentation
from insemu.errors import InputError
from insemu.filters import expanded, following

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Packed:
    """The augmentation in the compiled loop's slots."""

    place: NDArray[np.int64]
    slots: int
    diagonal: bool
    d: Array
    phi: Array
    offsets: NDArray[np.int64]
    mix: Array
    q_at: NDArray[np.int64]
    q: Array
    q_law: NDArray[np.int64]
    time_at: NDArray[np.int64]
    time_law: NDArray[np.int64]
    time_of: Array


def pack(aug: Augmentation, powers: int, *, side_by_side: bool = False) -> Packed:
    """Lay an augmentation out in slots, with the transitions over 1 to ``powers`` samples.

    Parameters
    ----------
    aug : Augmentation
    powers : int
    side_by_side : bool
        For realizations in lanes, whose expanded covariance has another grid.

    Raises
    ------
    InputError
        More states than the grid takes, or states of different axes that are coupled.
    """
    LD, FIRST, wide = expanded.LANES_GRID if side_by_side else expanded.GRID
    lanes = np.where(aug.axis >= 0, aug.axis, 0)
    slot = np.zeros(aug.m, dtype=np.int64)
    used = np.zeros(6, dtype=np.int64)
    for s in np.nonzero(aug.axis >= 0)[0]:
        slot[s] = used[lanes[s]]
        used[lanes[s]] += 1
    slots = int(used.max(initial=0))
    loose = np.nonzero(aug.axis < 0)[0]  # no axis sees them: one more slot, any lanes
    for i, s in enumerate(loose):
        slot[s], lanes[s] = slots + i // 6, i % 6
    slots += -(-loose.size // 6)
    if slots > expanded.MAX_SLOTS:
        raise InputError(f"an axis carries {slots} states, expected at most {expanded.MAX_SLOTS}")
    place = np.concatenate([np.arange(9), FIRST + wide * slot + lanes]).astype(np.int64)
    extra = place[9:]
    coupled = (aug.Phi != 0) & (lanes[:, None] != lanes[None, :])
    if coupled.any():
        raise InputError("states of different axes are coupled in Phi, expected independent axes")
    diagonal = not (aug.Phi - np.diag(np.diag(aug.Phi))).any()
    d = np.ones((powers, LD))
    phi = np.zeros((powers, max(slots, 1), max(slots, 1), wide))
    Qs = np.zeros((powers, aug.m, aug.m))
    for p in range(powers):
        Phi, Qs[p] = aug.power(p + 1)
        d[p, extra] = np.diag(Phi)
        for i, j in zip(*np.nonzero(Phi), strict=True):
            phi[p, slot[i], slot[j], lanes[i]] = Phi[i, j]
    far = {0} | {int(a - b) for a, b in np.argwhere((phi != 0).any(axis=(0, 3)))}
    offsets = np.array(sorted(far, key=lambda o: (o != 0, o)), dtype=np.int64)
    mix = np.zeros((powers, offsets.size, LD))
    for row, o in enumerate(sorted(far, key=lambda o: (o != 0, o))):
        for k in range(max(o, 0), min(slots, slots + o)):
            at = FIRST + wide * k
            mix[:, row, at : at + wide] = phi[:, k, k - o, :wide]
    rows, columns = np.nonzero((Qs != 0).any(axis=0))
    return Packed(
        place,
        slots,
        diagonal,
        d,
        phi,
        offsets,
        mix,
        extra[rows] * LD + extra[columns],
        np.ascontiguousarray(Qs[:, rows, columns]),
        aug.law_of[rows] if aug.laws else np.zeros(0, dtype=np.int64),
        *_following_times(aug, powers, (slot, lanes, extra), LD, phi[0].shape, offsets, (rows, columns)),
    )


def _following_times(
    aug: Augmentation,
    powers: int,
    lain: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]],
    LD: int,
    shape: tuple[int, ...],
    offsets: NDArray[np.int64],
    driven: tuple[NDArray[np.intp], NDArray[np.intp]],
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Places in d, phi, mix and q one after the other of what follows correlation times, their laws and values: see :func:`kernel.run`.

    Parameters
    ----------
    aug, powers
        As of :func:`pack`.
    lain : tuple of (m,) arrays of int
        Slot, lane and row of the expanded covariance of every state.
    LD : int
        Row length of the expanded covariance.
    shape : tuple of int
        Of phi.
    offsets : (k,) array of int
        Distances of slots that mix.
    driven : tuple of (l,) arrays of int
        Rows and columns of the entries of q.
    """
    slot, lanes, row = lain
    mix_from = LD + math.prod(shape)
    q_from = mix_from + offsets.size * LD
    places: list[int] = []
    laws: list[int] = []
    values: list[Array] = []
    for first, law, F, V in following.tables(aug, powers):
        for i, j in np.ndindex(F.shape[2:]):
            a, b = first + i, first + j
            own = [q_from + int(k) for k in np.flatnonzero((driven[0] == a) & (driven[1] == b))]
            given = [V[:, :, i, j]] * len(own)
            offset = np.flatnonzero(offsets == slot[a] - slot[b])
            if offset.size and F[:, :, i, j].any():
                moved = [LD + int(np.ravel_multi_index((slot[a], slot[b], lanes[a]), shape))]
                moved += [mix_from + int(offset[0]) * LD + int(row[a])]
                moved += [int(row[a])] if i == j else []
                own, given = own + moved, given + [F[:, :, i, j]] * len(moved)
            places, laws, values = places + own, laws + [law] * len(own), values + given
    table = np.ascontiguousarray(np.stack(values, axis=2)) if values else np.zeros((1, 1, 0))
    return np.array(places, dtype=np.int64), np.array(laws, dtype=np.int64), table
