"""What the compiled loops of filters take: samples, a start, a belief laid out in slots, and how a flight runs."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from insemu.augment import Augmentation
from insemu.errors import InputError
from insemu.filters import expanded, following
from insemu.lanes import spread

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class Samples(NamedTuple):
    """An IMU record.

    Parameters
    ----------
    t : (N,) array
        Epochs, s.
    gyro, accel : (N, 3 or more) arrays
        Increments over the interval that ends at the epoch, rad and m/s, body axes; further columns drive states.
    power : (N, g) array
        Squared gains of the laws that follow a covariate (:mod:`insemu.filters.following`).
    """

    t: Array
    gyro: Any
    accel: Any
    power: Any


class Start(NamedTuple):
    """What a filter begins with.

    Parameters
    ----------
    nav : (10,) array
        Navigation state; (13,) in the compiled loops, as :func:`insemu.strapdown.step` takes it.
    x, P : (m,), (n, n) arrays
        Estimates of the augmented states, and the covariance of all; n = 9 + m.
    """

    nav: Array
    x: Array
    P: Array


class Plan(NamedTuple):
    """How a flight runs.

    Parameters
    ----------
    gravity : int
        One of :data:`insemu.earth.GRAVITY_CODES`.
    lever : (3,) array
        Nominal lever arm from IMU to antenna, m, body axes.
    lever_at, latency_at, clock_at : int
        First lever-arm state, latency state and first state of the clock in the layout, -1 where they are not carried.
    thresholds : (w + 1,) array
        Largest accepted normalised innovation squared by the number of components.
    timeout : float
        Fixes are rejected for so long in a row, s.
    every, output_every : int
        Epochs from one propagation of the covariance, and from one row of the output, to the next.
    window, around : int
        Steps that the derivative of a fix by its latency is taken from, and on each side of a fix those of its derivatives by lever arm and latency.
    tolerance : float
        Times that are this close are the same, s.
    store : bool
        Whether nodes are stored: at ``node_epoch`` and wherever something is measured.
    cov_epoch, node_epoch : arrays of int
        Epochs at which the whole covariance is kept and a node is stored, ascending.
    """

    gravity: int
    lever: Array
    lever_at: int
    latency_at: int
    clock_at: int
    thresholds: Array
    timeout: float
    every: int
    output_every: int
    window: int
    around: int
    tolerance: float
    store: bool
    cov_epoch: Ints
    node_epoch: Ints


class Packed(NamedTuple):
    """A belief as the compiled loop takes it, n = 9 + m states in slots.

    Parameters
    ----------
    place : (n,) array of int
        Row of each state in the expanded covariance.
    axis, c, driver : (m,) arrays
        As in :class:`insemu.augment.Augmentation`.
    white : (6,) array
        Variances of the samples' own white noise, (rad/s)^2 and (m/s^2)^2.
    steps : Transition
        Over 1, 2, ... samples.
    q_law : (l,) array of int
        Law that each entry of ``steps.q`` follows, -1 for none; empty where nothing follows a covariate.
    time_at, time_law, time_of : (v,), (v,), (powers, nodes, v) arrays
        Places among d, phi, mix and q one after the other of what follows a correlation time, its law, its values at the nodes.
    laws, white_of : (g, 4), (g, 6) arrays
        Laws that follow the speed (:mod:`insemu.filters.following`), white noise that follows each law.
    """

    place: Ints
    axis: Ints
    c: Array
    driver: Ints
    white: Array
    steps: expanded.Transition
    q_law: Ints
    time_at: Ints
    time_law: Ints
    time_of: Array
    laws: Array
    white_of: Array

    def in_lanes(self) -> Packed:
        """For several realizations."""
        s = self.steps
        return self._replace(steps=s._replace(d=spread(s.d), phi=spread(s.phi), mix=spread(s.mix), q=spread(s.q)))


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
    loose = np.nonzero(aug.axis < 0)[0]  # no axis sees them: further slots, any lanes
    for i, s in enumerate(loose):
        chained = i > 0 and aug.Phi[s - 1, s] != 0.0  # into the lane of the state that it drives
        slot[s], lanes[s] = (slot[s - 1] + 1, lanes[s - 1]) if chained else (slots + i // 6, i % 6)
    slots = max(slots, int(slot[loose].max(initial=-1)) + 1)
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
    steps = expanded.Transition(
        slots, diagonal, d, phi, offsets, mix, extra[rows] * LD + extra[columns], np.ascontiguousarray(Qs[:, rows, columns])
    )  # fmt: skip
    law = aug.law_of[rows] if aug.laws else np.zeros(0, dtype=np.int64)
    timed = _following_times(aug, powers, (slot, lanes, extra), LD, phi[0].shape, offsets, (rows, columns))
    return Packed(
        place, aug.axis, aug.c, aug.driver, aug.white, steps, law, *timed, following.of_speed(aug), aug.white_of
    )


def _following_times(
    aug: Augmentation,
    powers: int,
    lain: tuple[Ints, Ints, Ints],
    LD: int,
    shape: tuple[int, ...],
    offsets: Ints,
    driven: tuple[NDArray[np.intp], NDArray[np.intp]],
) -> tuple[Ints, Ints, Array]:
    """Places in d, phi, mix and q one after the other of what follows correlation times, their laws and values: see :class:`Packed`.

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
