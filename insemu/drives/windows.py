"""A drive in windows of four seconds: how strongly it shakes in which band and axis, how axes go together, and what the vehicle was doing.

Densities are one-sided, in (rad/s)^2/Hz and (m/s^2)^2/Hz. Axes are those of the vehicle (forward, right, down) where gravity and the fixes tell how
the IMU is mounted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from insemu import rotation
from insemu.errors import InputError
from insemu.intake import track_of, vehicle_axes
from insemu.lost import restored
from insemu.records import AXES, GnssRecord, Recording, Trajectory

Array = NDArray[np.float64]

#: Length of a window, s.
WINDOW_S = 4.0
#: Edges of the bands, Hz: below the first the path itself moves, the last ends at :data:`USABLE` of half the sampling rate where that is less.
EDGES = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 45.0)
USABLE = 0.9
#: Bands in which axes are held against each other, Hz.
PAIRED = ((2.0, 8.0), (8.0, 45.0))
#: Slower is standing, m/s; faster turns of the course are turning, rad/s; faster changes of height are climbing and descending, m/s.
STANDING, TURNING, CLIMBING = 0.5, np.deg2rad(4.0), 1.0
#: Upper edges of the speed classes, m/s.
SPEEDS = (5.0, 10.0, 20.0)
REGIMES = (
    "standing", "turning", "climbing", "descending", "below 5 m/s", "5 to 10 m/s", "10 to 20 m/s", "above 20 m/s",
)  # fmt: skip
#: Window over which the velocity of fixes is a straight line of time, to either side, s.
NEAR_S = 2.0
#: Segments of a second at rest that a noise level needs: a 6 by 6 spectral matrix and enough degrees of freedom beyond.
LEAST_RESTING = 14
#: Share of windows that are quieter than what is taken for the quietest of a drive.
QUIETEST = 0.03
#: Band in which the level of white noise is looked for, Hz: above the swaying of a vehicle that stands.
QUIET_HZ = 2.0


@dataclass(frozen=True)
class Windows:
    """A drive in windows.

    Parameters
    ----------
    t : (w,) array
        Middles, s.
    speed, turn, climb : (w,) arrays
        m/s, rad/s (course), m/s.
    power : (w, 6, b) array
        Mean squares in the bands, gyroscopes first, (rad/s)^2 and (m/s^2)^2.
    edges : (b + 1,) array
        Hz.
    more : (w, k) array
        Further features.
    names : tuple of str
        Theirs.
    noise : (6,) array, optional
        White density of the sensor, one-sided, as its standstills show it at most; None without standstills.
    source : str
    said : tuple of str
        What was assumed.
    """

    t: Array
    speed: Array
    turn: Array
    climb: Array
    power: Array
    edges: Array
    more: Array
    names: tuple[str, ...]
    noise: Array | None
    source: str
    said: tuple[str, ...] = ()

    @property
    def regime(self) -> NDArray[np.int64]:
        """(w,) Index into :data:`REGIMES`."""
        return regime_of(self.speed, self.turn, self.climb)

    def rows(self, keep: NDArray[np.bool_]) -> Windows:
        """Some of the windows."""
        mine = {name: getattr(self, name)[keep] for name in ("t", "speed", "turn", "climb", "power", "more")}
        return replace(self, **mine)


def regime_of(speed: Array, turn: Array, climb: Array) -> NDArray[np.int64]:
    """(n,) Index into :data:`REGIMES` of motions.

    Parameters
    ----------
    speed, turn, climb : (n,) arrays
        m/s, rad/s, m/s.
    """
    out = 4 + np.searchsorted(SPEEDS, speed, side="right")
    out[climb > CLIMBING] = 2
    out[climb < -CLIMBING] = 3
    out[np.abs(turn) > TURNING] = 1
    out[speed < STANDING] = 0
    return out.astype(np.int64)


@dataclass(frozen=True)
class Signals:
    """An IMU on an even clock in vehicle axes, with the motion of its vehicle.

    Parameters
    ----------
    t : (n,) array
        s.
    x : (n, 6) array
        Rates and specific forces, SI.
    dt : float
        s.
    fixes : GnssRecord or Trajectory
        That say how fast it goes.
    mounting : (3, 3) array
        IMU to vehicle axes.
    said : tuple of str
    """

    t: Array
    x: Array
    dt: float
    fixes: GnssRecord | Trajectory
    mounting: Array
    said: tuple[str, ...]

    def motion(self, t: Array) -> tuple[Array, Array, Array]:
        """Speed (m/s), rate of the course (rad/s) and of climb (m/s) at times (n,), each (n,)."""
        track = track_of(self.fixes)
        at, step = track.t, float(np.median(np.diff(track.t)))
        grid = np.arange(-NEAR_S, NEAR_S + 1e-9, min(step, 0.5))
        grid -= grid.mean()
        near = t[:, None] + grid
        v = np.stack([np.interp(near, at, track.velocity[:, k]) for k in range(3)], axis=-1)
        mean, slope = v.mean(axis=1), np.einsum("g,ngk->nk", grid, v) / float(grid @ grid)
        level = np.linalg.norm(v[..., :2], axis=2).mean(axis=1)
        square = np.maximum(mean[:, 0] ** 2 + mean[:, 1] ** 2, STANDING**2)
        turn = (mean[:, 0] * slope[:, 1] - mean[:, 1] * slope[:, 0]) / square
        return level, np.where(level >= STANDING, turn, 0.0), -mean[:, 2]

    def pieces(self, length: int, step: int) -> NDArray[np.intp]:
        """First rows of pieces without a gap, inside the fixes.

        Parameters
        ----------
        length, step : int
            Rows of a piece, and from the start of one to that of the next.
        """
        first = np.arange(0, self.t.size - length + 1, step)
        begin, stop = self.t[first], self.t[first + length - 1]
        whole = np.abs((stop - begin) / ((length - 1) * self.dt) - 1.0) < 0.02
        low, high = float(self.fixes.t[0]), float(self.fixes.t[-1])
        return first[whole & (begin >= low - 0.5 * self.dt) & (stop <= high + 0.5 * self.dt)]


def signals_of(recording: Recording) -> Signals:
    """The signals of a recording in vehicle axes, lost samples filled in.

    Raises
    ------
    InputError
        Neither fixes nor a reference.
    """
    fixes = recording.gnss if recording.gnss is not None else recording.reference
    if fixes is None:
        raise InputError("has neither fixes nor a reference, expected one that tells the speed", where=recording.source)
    imu, lost = restored(recording.imu)
    rpy, words = vehicle_axes(imu, recording.gnss)
    C = np.eye(3) if rpy is None else rotation.dcm_from_rpy(rpy)
    x = imu.rates() @ np.kron(np.eye(2), C).T
    said = [words]
    count = sum(int(each.rows.sum()) for each in lost)
    if count:
        said.append(f"{count} samples that the recorder lost are filled in")
    return Signals(imu.t, x, imu.dt, fixes, C, tuple(said))


def windows_of(recording: Recording, *, top_hz: float | None = None) -> Windows:
    """Cut a drive into windows.

    Parameters
    ----------
    recording : Recording
        With fixes, or a reference.
    top_hz : float, optional
        Upper edge of the last band; default :data:`USABLE` of half the sampling rate, at most the last of :data:`EDGES`.

    Raises
    ------
    InputError
        Nothing that tells the speed; a rate below 4 Hz; fewer than ten windows.
    """
    s = signals_of(recording)
    top = min(EDGES[-1], USABLE * 0.5 / s.dt) if top_hz is None else top_hz
    edges = np.array([e for e in EDGES if e < 0.8 * top] + [top])
    length = round(WINDOW_S / s.dt)
    first = s.pieces(length, length)
    if first.size < 10 or edges.size < 3:
        raise InputError(
            f"has {first.size} windows of {WINDOW_S:g} s without a gap, at {1 / s.dt:.4g} Hz, expected at least 10, and 5 Hz",
            where=recording.source,
        )
    f, z = spectra(s, first, length)
    density = np.abs(z) ** 2
    bin_hz = float(f[1])
    bands = [(f >= a) & (f < b) for a, b in pairwise(edges)]
    power = np.stack([density[:, b].sum(axis=1) * bin_hz for b in bands], axis=-1)
    t = s.t[first] + 0.5 * WINDOW_S
    speed, turn, climb = s.motion(t)
    more, names = _further(s, first, length, f, z, (speed, turn), top)
    noise = sensor_noise(s)
    return Windows(t, speed, turn, climb, power, edges, more, names, noise, recording.source, s.said)


def top_of(*recordings: Recording) -> float:
    """The highest frequency that all recordings show, Hz."""
    return min(EDGES[-1], *(USABLE * 0.5 / r.imu.dt for r in recordings))


def spectra(s: Signals, first: NDArray[np.intp], length: int) -> tuple[Array, NDArray[np.complex128]]:
    """Frequencies (f,) and transforms (w, f, 6) of pieces, scaled so that their squares are one-sided densities.

    Parameters
    ----------
    s : Signals
    first : (w,) array of int
        First rows.
    length : int
        Rows of a piece; its mean and slope are removed and a Hann window is laid over it.
    """
    x = s.x[first[:, None] + np.arange(length)]
    ramp = np.arange(length) - 0.5 * (length - 1)
    x = x - x.mean(axis=1, keepdims=True)
    x = x - ramp[:, None] * (np.einsum("t,wtk->wk", ramp, x) / float(ramp @ ramp))[:, None, :]
    window = np.hanning(length)
    z = np.fft.rfft(x * window[:, None], axis=1) * np.sqrt(2.0 * s.dt / float(window @ window))
    return np.asarray(np.fft.rfftfreq(length, s.dt), dtype=float), np.asarray(z, dtype=complex)


def within(recording: Recording, span: tuple[float, float] | None) -> Recording:
    """The part of a recording between two times in s, its IMU and fixes; all of it without them."""
    if span is None:
        return recording
    imu, gnss = recording.imu, recording.gnss
    if gnss is not None:
        gnss = gnss.rows((gnss.t >= span[0]) & (gnss.t <= span[1]))
    return replace(recording, imu=imu.rows((imu.t >= span[0]) & (imu.t <= span[1])), gnss=gnss)


def sensor_noise(s: Signals, *, moving: bool = False) -> Array | None:
    """White density of the sensor (6,), one-sided: the largest that its signals allow; None where it hardly stands.

    A rigid body moves all axes, noise of a sensor is its own. So while it stands the noise of an axis is at most what the five others do not explain,
    ``1 / [inv(S)]_ii`` of the spectral matrix, which an engine that runs raises less than its power; and never more than the quietest windows of
    the drive show. Of the octaves the quietest counts.

    Parameters
    ----------
    s : Signals
    moving : bool
        The quietest windows alone where it does not stand.

    Notes
    -----
    Of ``K`` segments the inverse of a complex Wishart matrix is too large by ``K / (K - 6)`` in mean (Brillinger 1981, section 7.3).
    """
    edges = np.geomspace(QUIET_HZ, USABLE * 0.5 / s.dt, 5)
    length = round(WINDOW_S / s.dt)
    f, z = spectra(s, s.pieces(length, length), length)
    power = np.abs(z) ** 2
    bands = [power[:, (f >= a) & (f < b)].mean(axis=1) for a, b in pairwise(edges)]
    quietest = np.min([np.quantile(x, QUIETEST, axis=0) for x in bands], axis=0)
    length = round(1.0 / s.dt)
    first = s.pieces(length, length)
    first = first[s.motion(s.t[first] + 0.5)[0] < STANDING]
    count = 0
    if first.size >= LEAST_RESTING:
        f, z = spectra(s, first, length)
        loud = np.abs(z[:, f > QUIET_HZ]).mean(axis=1)
        z = z[(loud / np.median(loud, axis=0)).max(axis=1) < 3.0]  # a door that is shut, a step on the brake
        count = len(z)
    if count < LEAST_RESTING:
        return np.asarray(quietest) if moving else None
    S = np.einsum("wfi,wfj->fij", z, np.conj(z)) / count
    own = 1.0 / np.einsum("fii->fi", np.linalg.inv(S)).real * (count / (count - 6.0))
    levels = [np.median(own[(f >= a) & (f < b)], axis=0) for a, b in pairwise(edges)]
    return np.asarray(np.minimum(np.min(levels, axis=0), quietest))


def _further(
    s: Signals,
    first: NDArray[np.intp],
    length: int,
    f: Array,
    z: NDArray[np.complex128],
    motion: tuple[Array, Array],
    top: float,
) -> tuple[Array, tuple[str, ...]]:
    """Features together with the powers (w, k) with names: axes that go together, jerk, sideslip."""
    columns: list[Array] = []
    names: list[str] = []
    for low, high in PAIRED:
        inside = (f >= low) & (f < min(high, top))
        if inside.sum() < 8:
            continue
        own = np.sum(np.abs(z[:, inside]) ** 2, axis=1)
        for i, j in combinations(range(6), 2):
            cross = np.sum(z[:, inside, i] * np.conj(z[:, inside, j]), axis=1) / np.sqrt(own[:, i] * own[:, j])
            for part, word in ((cross.real, "in phase"), (cross.imag, "a quarter behind")):
                columns.append(part)
                names.append(f"{axis_name(i)} and {axis_name(j)} {word}, {low:g} to {min(high, top):.3g} Hz")
    # jerk of the path: the specific force below 2 Hz, differentiated
    slow = (f > 0) & (f < 2.0)
    jerk = np.sum(np.abs(z[:, slow][:, :, 3:] * (2.0 * np.pi * f[slow])[:, None]) ** 2, axis=1) * f[1]
    columns += list(np.log(np.maximum(jerk, 1e-12)).T)
    names += [f"jerk {a} below 2 Hz" for a in "xyz"]
    # what the gyroscope turned and the course did not: the change of sideslip
    rate = s.x[first[:, None] + np.arange(length), 2].mean(axis=1)
    speed, turn = motion
    columns.append(np.where(speed > 3.0, np.log(np.abs(rate - turn) + 1e-3), np.log(1e-3)))
    names.append("change of sideslip (course against the gyroscope)")
    return np.stack(columns, axis=1), tuple(names)


def axis_name(k: int) -> str:
    """An axis in words: ``angular rate x`` to ``specific force z``."""
    return f"{'angular rate' if k < 3 else 'specific force'} {AXES[k][-1]}"
