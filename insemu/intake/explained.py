"""How well a reading of an IMU explains the velocities of fixes, whatever the mounting, the heading and small errors of the sensors.

In windows of some seconds the gyroscope carries the attitude and the specific force is integrated in the axes in which the window begins. Up to one
rotation, which is free in each window, and gravity, that is the change of the velocity over the ground. Biases and the antenna's place are free for
all windows together. What is left, window by window with a scale of its own, is the log-likelihood of the reading: units, signs, order of axes and
delays of either sensor and of the fixes change it, a common mounting does not.

Rotations by Wahba's problem (Wahba 1965), solved by singular values (Markley 1988).
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from insemu import rotation
from insemu.compiled import njit
from insemu.intake.motion import Track
from insemu.records import ImuRecord

Array = NDArray[np.float64]

#: Length of a window and of the pieces that it is integrated by, s; most windows, spread over the record; fewest for any verdict.
WINDOW, PIECE, MOST, FEWEST = 16.0, 0.05, 36, 3
#: Velocities that a window needs; steps of the track that it spans at least.
ROWS, STEPS = 5, 8.0
#: Standard deviations before the data, of a bias of the gyroscope (rad/s) and the accelerometer (m/s^2) and of the antenna's place (m).
GYRO_BIAS, ACCEL_BIAS, ARM = 0.02, 0.3, 1.5
#: Velocities are no better than this, m/s: lever arms of a moving load, flexing, the pieces of the integration.
FLOOR = 0.05
#: Gravity that a window is given, m/s^2; its change with place is less than a bias.
GRAVITY = 9.8
#: Half of the time over which an antenna's velocity about the IMU is taken, s.
HALF = 0.25


@dataclass(frozen=True)
class Reading:
    """A reading of an IMU with fixes, relative to the declared one.

    Parameters
    ----------
    gyro, accel : (3, 3) arrays
        What the declared rates and forces are multiplied with.
    lag : float
        s that the accelerometer's stamps are moved by.
    shift : float
        s that the stamps of the fixes are moved by.
    east, down : float
        -1 where the fixes go the other way east, or up.
    """

    gyro: Array
    accel: Array
    lag: float = 0.0
    shift: float = 0.0
    east: float = 1.0
    down: float = 1.0


DECLARED = Reading(np.eye(3), np.eye(3))


@dataclass(frozen=True)
class Explained:
    """How well a reading explains the velocities.

    Parameters
    ----------
    reading : Reading
    nats : float
        Log-likelihood, with a scale of its own for every window.
    left : (w,) array
        Root mean square that is left in each window, m/s.
    scale : float
        What the specific force should be multiplied with.
    bias : (9,) array
        Of gyroscope (rad/s) and accelerometer (m/s^2), and the antenna's place (m).
    count : int
        Numbers that were held against each other.
    turned : float
        Log-likelihood of turns of the course, where they tell.
    """

    reading: Reading
    nats: float
    left: Array
    scale: float
    bias: Array
    count: int
    turned: float = 0.0

    @property
    def total(self) -> float:
        """All log-likelihood."""
        return self.nats + self.turned

    @property
    def rms(self) -> float:
        """Median over the windows of what is left, m/s."""
        return float(np.median(self.left))


class Windows:
    """Windows of an IMU and of velocities over the ground.

    Parameters
    ----------
    imu : ImuRecord
    track : Track
        Velocities, of the receiver or of positions.
    """

    def __init__(self, imu: ImuRecord, track: Track) -> None:
        spans = track.span
        self._imu, self._track, self._spans = imu, track, spans
        gap = float(np.median(np.diff(track.t))) if track.t.size > 1 else 1.0
        self.length = max(WINDOW, STEPS * max(gap, spans))
        self._piece = max(PIECE, imu.dt)
        self._starts = self._spread()
        self._latest: tuple[tuple[object, ...], tuple[Array, ...]] | None = None  # tables of a reading without biases

    def fewer(self, most: int) -> Windows:
        """Some of the windows, spread over the record."""
        out = copy(self)
        for name in ("_edges", "_turns"):
            out.__dict__.pop(name, None)
        out._latest = None
        out._piece = max(2.0 * PIECE, self._imu.dt)
        out._starts = self._starts[np.unique(np.linspace(0, self.count - 1, min(most, self.count)).astype(int))]
        return out

    @property
    def count(self) -> int:
        """How many windows there are."""
        return int(self._starts.size)

    def start(self, k: int) -> float:
        """Time at which a window begins, s from the start of the IMU."""
        return float(self._starts[k] - self._imu.t[0])

    @cached_property
    def floor(self) -> float:
        """What velocities of the fixes are good for, m/s: third differences hold no smooth motion."""
        third = np.diff(self._track.velocity, n=3, axis=0)
        spread = 1.4826 * float(np.median(np.abs(third))) / np.sqrt(20.0) if len(third) else 0.0
        return max(FLOOR, spread)

    def _spread(self) -> Array:
        """Starts of windows without a pause of the IMU and with enough velocities, at most :data:`MOST`."""
        imu, t = self._imu, self._track.t
        if not t.size:
            return np.empty(0)
        margin = 1.0 + self._spans
        first, last = max(imu.t[0], t[0]) + margin, min(imu.t[-1], t[-1]) - margin
        starts = np.arange(first, last - self.length, self.length)
        count = np.searchsorted(t, starts + self.length) - np.searchsorted(t, starts)
        pauses = imu.t[:-1][np.diff(imu.t) > max(0.3, 5.0 * imu.dt)]
        paused = np.searchsorted(pauses, starts + self.length + 1.0) - np.searchsorted(pauses, starts - 1.0)
        good = starts[(count >= ROWS) & (paused == 0)]
        return np.asarray(good if good.size <= MOST else good[np.linspace(0, good.size - 1, MOST).astype(int)])

    @cached_property
    def _sums(self) -> tuple[Array, Array]:
        """Integrals of rates and forces up to each stamp."""
        imu = self._imu
        dt = np.minimum(np.diff(imu.t, prepend=imu.t[0] - imu.dt), 10.0 * imu.dt)[:, None]
        width = 1.0 if imu.kind == "increment" else dt
        return np.cumsum(imu.gyro * width, axis=0), np.cumsum(imu.accel * width, axis=0)

    def _pieces(self, table: Array, delay: float) -> Array:
        """Increments (w, s, 3) of an integral over the pieces of each window."""
        edges = self._edges - delay
        at = np.stack([np.interp(edges.ravel(), self._imu.t, c) for c in table.T], axis=-1)
        return np.diff(at.reshape(*edges.shape, 3), axis=1)

    @cached_property
    def _turns(self) -> Array:
        """Increments of the integrated rates, of which no reading moves the stamps."""
        return self._pieces(self._sums[0], 0.0)

    @cached_property
    def _edges(self) -> Array:
        pieces = round((self.length + 2.0 * HALF + self._spans) / self._piece) + 1
        return (self._starts - HALF - 0.5 * self._spans)[:, None] + self._piece * np.arange(pieces + 1)

    def _rows(self, shift: float) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """Rows of the track in each window (w, k) and which of them are there."""
        t = self._track.t + shift
        low, high = np.searchsorted(t, self._starts), np.searchsorted(t, self._starts + self.length)
        step = np.maximum(1, np.ceil((high - low) / self.length)).astype(int)  # about one a second
        most = int(np.max(-(-(high - low) // step)))
        rows = low[:, None] + step[:, None] * np.arange(most)
        there = rows < high[:, None]
        return np.where(there, rows, low[:, None]), there

    def forces(self) -> tuple[Array, Array]:
        """Sizes of the change of the fixes' velocity less gravity and of the mean specific force between two rows, m/s^2, (n,) each."""
        rows, there = self._rows(0.0)
        when, v = self._track.t[rows], self._track.velocity[rows]
        both = there[:, 1:] & there[:, :-1]
        dt = np.where(both, np.diff(when, axis=1), 1.0)[..., None]
        wanted = np.diff(v, axis=1) / dt - np.array([0.0, 0.0, GRAVITY])
        sums = np.stack([np.interp(when.ravel(), self._imu.t, c) for c in self._sums[1].T], axis=-1).reshape(
            *when.shape, 3
        )
        have = np.diff(sums, axis=1) / dt
        return np.linalg.norm(wanted[both], axis=-1), np.linalg.norm(have[both], axis=-1)

    def explain(self, reading: Reading = DECLARED, passes: int = 2, other: int = 0) -> Explained:
        """Score a reading.

        Parameters
        ----------
        reading : Reading
        passes : int
            Corrections of the biases.
        other : int
            Windows that the velocities are moved by: what is left where IMU and fixes have nothing to do with each other.
        """
        bias = np.zeros(9)
        rows, there = self._rows(reading.shift)
        weight = there.astype(float)
        y = self._track.velocity[rows] * [1.0, reading.east, reading.down]
        when = self._track.t[rows] + reading.shift
        y = y - np.array([0.0, 0.0, GRAVITY]) * (when - self._starts[:, None])[..., None]
        if other:
            y, weight = np.roll(y, other, axis=0), weight * np.roll(weight, other, axis=0)
        y = _centred(y, weight)
        for done in range(passes + 1):
            q, columns = self._predicted(self._tables(reading, bias[:3]), when)
            q, columns = _centred(q + columns[..., 3:] @ bias[3:], weight), _centred(columns, weight)
            R, scale = _wahba(y, q, weight)
            rest = (y @ R - q) * weight[..., None]  # in the axes of the window's beginning
            if done == passes:
                break
            bias = bias + _step(rest, q, columns, weight, self.floor, bias)
        numbers = 3.0 * np.maximum(weight.sum(axis=1) - 2.0, 1.0)
        squares = (rest**2).sum(axis=(1, 2))
        nats = -0.5 * float(np.sum(numbers * np.log1p(squares / (numbers * self.floor**2))))
        return Explained(reading, nats, np.sqrt(squares / numbers), scale, bias, int(numbers.sum()))

    def _tables(self, reading: Reading, bias: Array) -> tuple[Array, ...]:
        """At the edges of the pieces: change of velocity, its derivatives by errors of forces and rates, and attitude, (w, s + 1, 3[, 3])."""
        key = (reading.gyro.tobytes(), reading.accel.tobytes(), reading.lag, bias.tobytes())
        if (
            self._latest is not None and self._latest[0] == key
        ):  # readings of other times of the fixes begin with the same
            return self._latest[1]
        h = self._piece
        turns = self._turns @ reading.gyro.T - bias * h
        V, bent, A, C = _carried(turns, self._pieces(self._sums[1], reading.lag) @ reading.accel.T, h)
        if self._spans:
            V, A, bent = (_sum(0.5 * h * (x[:, 1:] + x[:, :-1])) for x in (V, A, bent))
        if not bias.any():
            self._latest = key, (V, bent, A, C)
        return V, bent, A, C

    def _predicted(self, tables: tuple[Array, ...], when: Array) -> tuple[Array, Array]:
        """Changes of velocity (w, k, 3) at the times of the track, and their derivatives by the nine numbers (w, k, 3, 9)."""
        V, bent, A, C = tables
        h = self._piece
        half = 0.5 * self._spans or HALF

        def at(table: Array, t: Array) -> Array:
            place = np.clip((t - self._edges[:, :1]) / h, 0.0, table.shape[1] - 1.001)
            low = place.astype(int)
            share = (place - low).reshape(*place.shape, *([1] * (table.ndim - 2)))
            each = np.arange(len(table))[:, None]
            return np.asarray(table[each, low] * (1.0 - share) + table[each, low + 1] * share)

        def mean(table: Array) -> Array:
            return (at(table, when + half) - at(table, when - half)) / (2.0 * half) if self._spans else at(table, when)

        arm = (at(C, when + half) - at(C, when - half)) / (2.0 * half)
        return mean(V), np.concatenate([mean(bent), -mean(A), arm], axis=-1)


@njit(cache=True, nogil=True)
def _carried(turns: Array, forces: Array, h: float) -> tuple[Array, Array, Array, Array]:
    """Carry the attitude through the pieces of each window, and sum the specific force in the axes of its beginning.

    Parameters
    ----------
    turns, forces : (w, s, 3) arrays
        Integrals of the rates, rad, and of the specific force, m/s, over each piece.
    h : float
        Length of a piece, s.

    Returns
    -------
    tuple of arrays
        At the edges of the pieces: change of velocity (w, s + 1, 3), its derivatives by a constant error of the rate and of the force, and the
        attitude, (w, s + 1, 3, 3).
    """
    windows, pieces = turns.shape[:2]
    V = np.zeros((windows, pieces + 1, 3))
    bent, A, C = np.zeros((3, windows, pieces + 1, 3, 3))
    middle = np.empty((3, 3))
    for w in range(windows):
        for i in range(3):
            C[w, 0, i, i] = 1.0
        for k in range(pieces):
            x, y, z = turns[w, k]
            cosine, half = rotation.scalar_half_trig(x * x + y * y + z * z)
            first, second = 2.0 * half * cosine, 2.0 * half * half  # of Rodrigues' formula
            for i in range(3):
                c = C[w, k, i]
                cross = (c[1] * z - c[2] * y, c[2] * x - c[0] * z, c[0] * y - c[1] * x)
                again = (cross[1] * z - cross[2] * y, cross[2] * x - cross[0] * z, cross[0] * y - cross[1] * x)
                moved = 0.0
                for j in range(3):
                    C[w, k + 1, i, j] = c[j] + first * cross[j] + second * again[j]
                    middle[i, j] = c[j] + 0.5 * cross[j]
                    A[w, k + 1, i, j] = A[w, k, i, j] + h * middle[i, j]
                    moved += middle[i, j] * forces[w, k, j]
                V[w, k + 1, i] = V[w, k, i] + moved
            a, b, c = V[w, k + 1] - V[w, k]
            for j in range(3):
                p, q, r = 0.5 * (A[w, k, :, j] + A[w, k + 1, :, j])
                bent[w, k + 1, 0, j] = bent[w, k, 0, j] + b * r - c * q
                bent[w, k + 1, 1, j] = bent[w, k, 1, j] + c * p - a * r
                bent[w, k + 1, 2, j] = bent[w, k, 2, j] + a * q - b * p
    return V, bent, A, C


def _sum(steps: Array) -> Array:
    """Running sums along the second axis, from 0."""
    return np.concatenate([np.zeros_like(steps[:, :1]), np.cumsum(steps, axis=1)], axis=1)


def _centred(values: Array, weight: Array) -> Array:
    """Less the mean of each window: the velocity at its beginning is free."""
    w = weight.reshape(*weight.shape, *([1] * (values.ndim - 2)))
    return np.asarray(
        (values - (values * w).sum(axis=1, keepdims=True) / np.maximum(w.sum(axis=1, keepdims=True), 1.0)) * w
    )


def _wahba(y: Array, q: Array, weight: Array) -> tuple[Array, float]:
    """Rotation (w, 3, 3) of each window that takes ``q`` to ``y``, and the factor that all sizes together ask for."""
    u, s, vt = np.linalg.svd(np.einsum("wki,wkj->wij", y, q))
    sign = np.linalg.det(u @ vt)
    u[:, :, 2] *= sign[:, None]
    s[:, 2] *= sign
    power = (q**2).sum(axis=(1, 2))
    scales = s.sum(axis=1) / np.maximum(power, 1e-12)
    return u @ vt, float(np.median(scales))


def _step(rest: Array, q: Array, columns: Array, weight: Array, floor: float, bias: Array) -> Array:
    """Correction of the nine numbers, the rotations of the windows being free (Gauss and Newton)."""
    width = len(rest), -1
    r = rest.reshape(*width)
    turn = np.swapaxes(rotation.skew(q), -1, -2).reshape(len(rest), -1, 3)  # of the window's rotation
    X = columns.reshape(len(rest), -1, 9)
    power = np.swapaxes(turn, 1, 2) @ turn + 1e-6 * np.eye(3)
    onto = np.linalg.solve(power, np.swapaxes(turn, 1, 2))
    X = X - turn @ (onto @ X)
    r = r - (turn @ (onto @ r[..., None]))[..., 0]
    size = np.mean(r**2, axis=1) + floor**2
    prior = np.repeat([GYRO_BIAS, ACCEL_BIAS, ARM], 3) ** -2.0
    N = np.einsum("wni,wnj,w->ij", X, X, 1.0 / size) + np.diag(prior)
    return np.asarray(np.linalg.solve(N, np.einsum("wni,wn,w->i", X, r, 1.0 / size) - prior * bias))
