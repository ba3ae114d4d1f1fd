"""A vehicle from a recording: what its body does about the path, by regime, with standard deviations, and what the recording cannot tell.

The motion below about half a hertz is the path's, made from the fixes as an emulation makes it. Above, the spectral matrix of the six axes less
that of the path and less the sensor's noise is the vehicle's. What is left follows from the same windows: how its loudness swings, sideslip by
holding the course against the gyroscope, and the jerk density with which it changes its mind.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.drives.loudness import levels_of
from insemu.drives.sideslip import Sideslip, sideslip_of
from insemu.drives.windows import (
    CLIMBING,
    EDGES,
    REGIMES,
    USABLE,
    WINDOW_S,
    Signals,
    axis_name,
    regime_of,
    sensor_noise,
    signals_of,
    spectra,
    within,
)
from insemu.emulate import (
    VEHICLES,
    MotionSpectrum,
    Moving,
    MovingVehicle,
    Regime,
    Slip,
    Track,
    ideal_imu,
    smooth_track,
)
from insemu.errors import InputError
from insemu.filters import with_standard_deviations
from insemu.noise import WN, NoiseModel
from insemu.records import AXES, GnssRecord, Recording

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Lowest frequency of the table, Hz, and its cells in an octave: below, the fixes tell the path; a cell holds two ordinates of a window at least.
LOWEST, CELLS = 0.4, 4
#: Fewest windows in a regime of its own (half overlapping, so 16 s).
FEWEST = 7
#: Least share of a density that is taken for the vehicle's; below it the sensor's noise hides it.
HIDDEN = 0.02
#: Windows in a class of speeds, and its least width, m/s: spectra follow the speed, by wheels, shafts and the lengths of waves of a road.
CLASS, NARROWEST = 30, 1.5
#: Speeds below which a vehicle stands and above which it moves, m/s, and turns below which it goes straight and above which it turns, rad/s: ranges
#: have soft edges, and what is louder by twenty to forty decibels must not reach through them. The classes of windows end between.
ROLLING, BENDING = (0.2, 1.5), (0.04, 0.11)
#: Jerk densities of paths, m/s^3 per sqrt(Hz), and axes that a level path moves: yaw, along and across.
JERKS, LEVEL, SHARE = (3.0, 1.5, 0.75, 0.4, 0.2, 0.1, 0.05), [2, 3, 4], 0.5


@dataclass(frozen=True)
class LearnedVehicle:
    """What a recording tells of its vehicle.

    Parameters
    ----------
    vehicle : MovingVehicle
        As a scenario takes it; ``spectrum.unknown`` says what it cannot tell.
    sensor : mapping of axis to NoiseModel
        The noise that was removed; with it the vehicle sounds as the recording does.
    seconds : mapping of regime to float
        How long it was seen, s.
    sideslip : Sideslip or None
        None where nothing tells it.
    said : tuple of str
        What was assumed and done.
    """

    vehicle: MovingVehicle
    sensor: dict[str, NoiseModel]
    seconds: dict[str, float]
    sideslip: Sideslip | None
    said: tuple[str, ...]


def learn_vehicle(
    recording: Recording,
    *,
    kind: str = "car",
    name: str = "",
    models: Mapping[str, NoiseModel] | None = None,
    span: tuple[float, float] | None = None,
) -> LearnedVehicle:
    """Learn a vehicle from a recording of it.

    Parameters
    ----------
    recording : Recording
        In motion, with fixes.
    kind : str
        Key of :data:`insemu.emulate.VEHICLES`: the attitude that its path asks for.
    name : str
        Of the vehicle.
    models : mapping of axis to NoiseModel, optional
        Noise of the sensor; from its standstills where it is not given.
    span : (start_s, end_s), optional
        A part of the recording.

    Raises
    ------
    InputError
        No fixes, or fewer than :data:`FEWEST` windows in every regime.
    """
    if recording.gnss is None:
        raise InputError("has no fixes, expected some that tell the path of the vehicle", where=recording.source)
    part = within(recording, span)
    assert part.gnss is not None
    s = signals_of(part)
    said, unknown = list(s.said), []
    length = round(WINDOW_S / s.dt)
    first = s.pieces(length, length // 2)
    f, z = spectra(s, first, length)
    # the yaw axis of what banks is not the vertical, along which a course turns
    slip = sideslip_of(s) if VEHICLES[kind].lean is not None else None
    jerk, z_path = _path(s, part.gnss, kind, first, length, None if slip is None else slip.as_slip())
    noise, words = _noise(s, models, f)
    unknown += words
    if recording.imu.kind != "sample":  # what averages over an interval shows less than there is
        loss = np.sinc(f * s.dt)
        z, z_path, noise = z / loss[:, None], z_path / loss[:, None], noise / loss[:, None] ** 2
    motion = s.motion(s.t[first] + 0.5 * WINDOW_S)
    regime = regime_of(*motion)
    edges = cells(float(f[1]), USABLE * 0.5 / s.dt)
    inside = [(f >= low - 0.25 * f[1]) & (f < high - 0.25 * f[1]) for low, high in pairwise(edges)]
    Y, known = (
        np.stack([np.einsum("wfi,wfj->wij", x[:, i], np.conj(x[:, i])) / i.sum() for i in inside], axis=1)
        for x in (z, z_path)
    )
    known = known + np.stack([noise[i].mean(axis=0) for i in inside])[:, :, None] * np.eye(6)
    found: list[Regime] = []
    seconds: dict[str, float] = {}
    of_class = list(classes(regime, motion[0]))
    bands = np.array([e for e in (LOWEST, *EDGES[1:]) if e < 0.8 * edges[-1]] + [edges[-1]])
    begins = np.diff(first, prepend=first[0] - length) != length // 2
    levels, power = levels_of(
        f, z, np.abs(z_path) ** 2 + noise, bands, motion, [rows for _, rows, _ in of_class], begins
    )
    band = np.clip(np.searchsorted(bands, np.sqrt(edges[:-1] * edges[1:])) - 1, 0, bands.size - 2)
    for word, rows, where in of_class:
        if rows.sum() < FEWEST:
            unknown.append(f"{word}: {0.5 * WINDOW_S * rows.sum():.0f} s are too few, the nearest regime stands for it")
            continue
        seconds[word] = float(0.5 * WINDOW_S * rows.sum())
        made, hidden = _regime(word, where, edges, Y[rows], known[rows], np.swapaxes(power[rows], 1, 2)[:, band])
        found.append(made)
        unknown += hidden
    if not found:
        raise InputError("is too short to tell how its vehicle moves in any regime", where=recording.source)
    missing = [word for k, word in enumerate(REGIMES[:4]) if not (regime == k).any()]
    fastest = float(motion[0].max())
    unknown.append(f"above {fastest:.0f} m/s it was not seen, so it is taken to move as there")
    if missing:
        unknown.append(f"not seen, so taken as the nearest regime: {', '.join(missing)}")
    unknown += (
        ["sideslip: it flies, or turns too little at speed, so none is taken"] if slip is None else list(slip.unknown)
    )
    spectrum = MotionSpectrum(rows_of(edges)[0], tuple(found), (), tuple(unknown), levels)
    mean = {a: WN(float(np.sqrt(0.5 * np.median(noise[:, k])))) for k, a in enumerate(AXES)}
    sensor = {a: models[a] if models and a in models else NoiseModel((m,)) for a, m in mean.items()}
    usual = Slip()
    vehicle = MovingVehicle(
        name or "learned",
        kind,
        spectrum,
        f"learned from {recording.source}",
        jerk,
        usual if slip is None else slip.as_slip(),
    )
    return LearnedVehicle(vehicle, sensor, seconds, slip, tuple(said))


def _path(
    s: Signals, gnss: GnssRecord, kind: str, first: NDArray[np.intp], length: int, slip: Slip | None
) -> tuple[float, Complex]:
    """Jerk density with which the fixes are smoothed, and transforms of what an IMU feels on the path that comes of it.

    The largest density with which the path turns and pushes no more than :data:`SHARE` of what the IMU felt just above :data:`LOWEST`: a path
    that follows the noise of its fixes moves more than its vehicle does.
    """
    f, z = spectra(s, first, length)
    inside = (f >= LOWEST) & (f < 2.5 * LOWEST)
    felt = np.mean(np.abs(z[:, inside][:, :, LEVEL]) ** 2, axis=(0, 1))
    for jerk in JERKS:
        z_path = spectra(replace(s, x=path_signals(s, gnss, kind, jerk, slip)), first, length)[1]
        if (np.mean(np.abs(z_path[:, inside][:, :, LEVEL]) ** 2, axis=(0, 1)) < SHARE * felt).all():
            break
    return jerk, z_path


def cells(bin_hz: float, top: float) -> Array:
    """Edges of the cells of the table, Hz: :data:`CELLS` an octave, each two ordinates wide at least."""
    edges = [LOWEST]
    while edges[-1] < 0.95 * top:
        edges.append(min(max(edges[-1] * 2.0 ** (1.0 / CELLS), edges[-1] + 1.5 * bin_hz), top))
    return np.array(edges)


def path_signals(s: Signals, gnss: GnssRecord, kind: str, jerk: float | None, slip: Slip | None = None) -> Array:
    """What a perfect IMU feels on the path that an emulation makes of the fixes, (n, 6) at the rows of the signals.

    Parameters
    ----------
    s : Signals
    gnss : GnssRecord
    kind : str
    jerk : float, optional
        m/s^3 per sqrt(Hz).
    slip : Slip, optional
        Turns the nose out of the course.
    """
    path = smooth_track(track_for(gnss), kind, jerk=jerk, max_gap_s=np.inf).path
    if slip is not None:
        nothing = Regime("none", np.zeros((2, 6)), np.tile(np.eye(6, dtype=complex), (2, 1, 1)))
        path = Moving(MovingVehicle("none", kind, MotionSpectrum(np.array([1.0, 5.0]), (nothing,)), slip=slip)).on(path)
    start, end = max(path.start, s.t[0]), min(path.end, s.t[-1])
    ideal = ideal_imu(path, 20.0, mode="continuous", kind="sample", span=(start, end)).imu
    return np.stack([np.interp(s.t, ideal.t, column) for column in ideal.rates().T], axis=1)


def track_for(gnss: GnssRecord) -> Track:
    """The fixes as a track, with standard deviations where nobody states them."""
    return Track.of(with_standard_deviations(gnss)[0], "fixes")


def _noise(s: Signals, models: Mapping[str, NoiseModel] | None, f: Array) -> tuple[Array, list[str]]:
    """One-sided densities (f, 6) of the sensor in vehicle axes, and what is not known of them."""
    if models:
        own = np.stack([2.0 * models[a].psd(np.maximum(f, f[1]), s.dt) for a in AXES], axis=1)
        return own @ np.kron(np.eye(2), np.asarray(s.mounting) ** 2).T, []
    level = sensor_noise(s)
    if level is None:
        level = sensor_noise(s, moving=True)
        words = [
            "the sensor's noise: it hardly stands, so what the quietest windows show is taken for it, which is too much"
        ]
    else:
        words = ["the sensor's noise while it moves: taken as what standstills show that no other axis explains"]
    if level is None:
        return np.zeros((f.size, 6)), ["the sensor's noise: too few windows, so none is removed"]
    return np.tile(level, (f.size, 1)), words


def classes(
    regime: NDArray[np.int64], speed: Array
) -> Iterator[tuple[str, NDArray[np.bool_], dict[str, tuple[float, float]]]]:
    """Regimes with their windows and ranges: standing, turning, climbing, descending, and speeds in classes with as many windows each as tell it.

    Parameters
    ----------
    regime : (w,) array
        Index into :data:`insemu.drives.windows.REGIMES`.
    speed : (w,) array
        m/s.
    """
    inf = float("inf")
    rolling = {"speed": (ROLLING[1], inf)}
    straight = {"turn": (0.0, BENDING[0])}
    special: list[dict[str, tuple[float, float]]] = [
        {"speed": (0.0, ROLLING[0])},
        rolling | {"turn": (BENDING[1], inf)},
        rolling | straight | {"climb": (CLIMBING, inf)},
        rolling | straight | {"climb": (-inf, -CLIMBING)},
    ]
    for k, where in enumerate(special):
        if (rows := regime == k).any():
            yield REGIMES[k], rows, where
    level = regime >= len(special)
    if not level.any():
        return
    edges = [0.0]
    for x in (
        np.quantile(speed[level], np.arange(1, level.sum() // CLASS) / (level.sum() // CLASS))
        if level.sum() > CLASS
        else []
    ):
        if x - edges[-1] > NARROWEST and speed[level].max() - x > 0.5 * NARROWEST:
            edges.append(float(x))
    for low, high in pairwise([*edges, inf]):
        word = f"{low:.1f} to {high:.1f} m/s" if high < inf else f"above {low:.1f} m/s"
        yield (
            word,
            level & (speed >= low) & (speed < high),
            {"speed": (max(low, ROLLING[1]), high), "climb": (-CLIMBING, CLIMBING)} | straight,
        )


def _regime(
    name: str, where: Mapping[str, tuple[float, float]], edges: Array, Y: Complex, known: Complex, scale: Array
) -> tuple[Regime, list[str]]:
    """A regime from matrices (w, c, 6, 6) of its windows and of path and noise, and powers (w, c, 6); and what is hidden in it.

    Coherences are means over windows divided by their powers, so loud windows count no more than others.
    """
    power = np.einsum("wcii->wci", Y).real
    left = power - np.einsum("wcii->wci", known).real
    floor = HIDDEN * power.mean(axis=0)
    hidden = left.mean(axis=0) < floor
    root = np.sqrt(scale)
    C = np.mean((Y - known) / (root[..., :, None] * root[..., None, :]), axis=0)
    value, vector = np.linalg.eigh(0.5 * (C + np.conj(np.swapaxes(C, 1, 2))))
    C = (vector * np.maximum(value, HIDDEN)[:, None, :]) @ np.conj(np.swapaxes(vector, 1, 2))
    shape = np.sqrt(np.einsum("cii->ci", C).real)
    coherence = C / (shape[:, :, None] * shape[:, None, :])
    coherence[:, range(6), range(6)] = 1.0
    density = np.maximum(left.mean(axis=0), floor)
    # windows overlap by half, so half of them count
    spread = np.maximum(power.std(axis=0) / density, 1e-3) / np.sqrt(0.5 * len(Y))
    cell = rows_of(edges)[1]
    regime = Regime(
        name,
        table(edges, density),
        (0.5 * (coherence + np.conj(np.swapaxes(coherence, 1, 2))))[cell],
        density_sigma=spread[cell],
        **dict[str, Any](where),
    )
    words = [
        f"{axis_name(a)} {' and '.join(f'{x:.2g} to {y:.2g}' for x, y in _stretches(edges, hidden[:, a]))} Hz"
        for a in range(6)
        if hidden[:, a].any()
    ]
    return regime, [f"{name}, hidden by the path or the noise: {', '.join(words)}"] if words else []


def rows_of(edges: Array) -> tuple[Array, NDArray[np.intp]]:
    """Frequencies of the rows of a table, and the cell that each shows: middles and the outer edges."""
    centres, cell = np.sqrt(edges[:-1] * edges[1:]), np.arange(edges.size - 1)
    return np.concatenate([edges[:1], centres, edges[-1:]]), np.concatenate([cell[:1], cell, cell[-1:]])


def table(edges: Array, density: Array) -> Array:
    """Densities (rows, k), straight in logarithms between the rows, that have the mean densities (c, k) in the cells.

    Parameters
    ----------
    edges : (c + 1,) array
        Hz.
    density : (c, k) array
        Zero where a part is not.
    """
    at, cell = rows_of(edges)
    u = (np.arange(16) + 0.5) / 16.0
    f = np.log(edges[:-1, None] + np.diff(edges)[:, None] * u)
    out, aim = np.maximum(density, 1e-30), np.maximum(density, 1e-30)
    for _ in range(8):
        mean = np.stack([np.exp(np.interp(f, np.log(at), y)).mean(axis=1) for y in np.log(out[cell]).T], axis=1)
        out = out * np.clip(aim / mean, 0.5, 2.0) ** 0.7
    return np.asarray(np.where(density > 0.0, out, 0.0)[cell])


def _stretches(edges: Array, inside: NDArray[np.bool_]) -> list[tuple[float, float]]:
    turns = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(np.int8), [0]]))).reshape(-1, 2)
    return [(float(edges[a]), float(edges[b])) for a, b in turns]
