"""A vehicle from a recording: what its body does about the path, by regime, with standard deviations, and what the recording cannot tell.

The motion below about half a hertz is the path's, made from the fixes as an emulation makes it. Above, the spectral matrix of the six axes less
that of the path and less the sensor's noise is the vehicle's. What is left follows from the same windows: how its loudness swings, sideslip by
holding the course against the gyroscope, and the jerk density with which it changes its mind.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from insemu.drives.sideslip import Sideslip, sideslip_of
from insemu.drives.windows import (
    CLIMBING,
    REGIMES,
    SPEEDS,
    STANDING,
    TURNING,
    USABLE,
    WINDOW_S,
    Signals,
    axis_name,
    regime_of,
    resting_noise,
    signals_of,
    spectra,
    within,
)
from insemu.emulate import MotionSpectrum, MovingVehicle, Regime, Slip, Track, ideal_imu, smooth_track
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
#: Time constants of a swing that windows of four seconds tell, s.
SWINGS = (1.0, 30.0)
#: Band of the path in which its jerk is looked at, Hz, and length of the pieces, s.
JERK_HZ, JERK_S = (0.1, 0.4), 20.0


@dataclass(frozen=True)
class LearnedVehicle:
    """What a recording tells of its vehicle.

    Parameters
    ----------
    vehicle : MovingVehicle
        As a scenario takes it; ``spectrum.unknown`` says what it cannot tell.
    sensor : mapping of axis to NoiseModel
        The noise that was taken off; with it the vehicle sounds as the recording does.
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
    jerk = jerk_density(s)
    x_path = path_signals(s, part.gnss, kind, jerk)
    length = round(WINDOW_S / s.dt)
    first = s.pieces(length, length // 2)
    f, z = spectra(s, first, length)
    z_path = spectra(replace(s, x=x_path), first, length)[1]
    noise, words = _noise(s, models, f)
    unknown += words
    if recording.imu.kind != "sample":  # what averages over an interval shows less than there is
        loss = np.sinc(f * s.dt)
        z, z_path, noise = z / loss[:, None], z_path / loss[:, None], noise / loss[:, None] ** 2
    regime = regime_of(*s.motion(s.t[first] + 0.5 * WINDOW_S))
    edges = cells(float(f[1]), USABLE * 0.5 / s.dt)
    found: list[Regime] = []
    seconds: dict[str, float] = {}
    for k, word in enumerate(REGIMES):
        rows = regime == k
        if not rows.any():
            continue
        if rows.sum() < FEWEST:
            unknown.append(f"{word}: {0.5 * WINDOW_S * rows.sum():.0f} s are too few, the nearest regime stands for it")
            continue
        seconds[word] = float(0.5 * WINDOW_S * rows.sum())
        made, hidden = _regime(k, f, edges, z[rows], z_path[rows], noise)
        found.append(made)
        unknown += hidden
    if not found:
        raise InputError("is too short to tell how its vehicle moves in any regime", where=recording.source)
    missing = [word for k, word in enumerate(REGIMES) if not (regime == k).any()]
    if missing:
        unknown.append(f"not seen, so taken as the nearest regime: {', '.join(missing)}")
    slip = sideslip_of(s)
    unknown += ["sideslip: too little turning at speed to tell it, so what is usual for its kind"] if slip is None else list(slip.unknown)
    centres = np.sqrt(edges[:-1] * edges[1:])
    spectrum = MotionSpectrum(centres, tuple(found), (), tuple(unknown))
    mean = {a: WN(float(np.sqrt(0.5 * np.median(noise[:, k])))) for k, a in enumerate(AXES)}
    sensor = {a: models[a] if models and a in models else NoiseModel([m]) for a, m in mean.items()}
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


def cells(bin_hz: float, top: float) -> Array:
    """Edges of the cells of the table, Hz: :data:`CELLS` an octave, each two ordinates wide at least."""
    edges = [LOWEST]
    while edges[-1] < 0.95 * top:
        edges.append(min(max(edges[-1] * 2.0 ** (1.0 / CELLS), edges[-1] + 1.5 * bin_hz), top))
    return np.array(edges)


def path_signals(s: Signals, gnss: GnssRecord, kind: str, jerk: float | None) -> Array:
    """What a perfect IMU feels on the path that an emulation makes of the fixes, (n, 6) at the rows of the signals.

    Parameters
    ----------
    s : Signals
    gnss : GnssRecord
    kind : str
    jerk : float, optional
        m/s^3 per sqrt(Hz).
    """
    path = smooth_track(track_for(gnss), kind, jerk=jerk, max_gap_s=np.inf).path
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
    level = resting_noise(s)
    if level is None:
        level = resting_noise(s, moving=True)
        words = ["the sensor's noise: it never stands, so what no other axis explains is taken for noise, which is too much"]
    else:
        words = ["the sensor's noise while it moves: taken as what standstills show that no other axis explains"]
    if level is None:
        return np.zeros((f.size, 6)), ["the sensor's noise: too few windows, so none is taken off"]
    return np.tile(level, (f.size, 1)), words


def _regime(
    k: int, f: Array, edges: Array, z: Complex, z_path: Complex, noise: Array
) -> tuple[Regime, list[str]]:
    """A regime from windows (w, f, 6) of it, and what is hidden in it."""
    density, sigma, coherence = [], [], []
    hidden = np.zeros((edges.size - 1, 6), dtype=bool)
    for c, (low, high) in enumerate(pairwise(edges)):
        inside = (f >= low - 0.25 * f[1]) & (f < high - 0.25 * f[1])
        own = z[:, inside]
        count = len(z) * int(inside.sum())
        S = np.einsum("wfi,wfj->ij", own, np.conj(own)) / count
        S_path = np.einsum("wfi,wfj->ij", z_path[:, inside], np.conj(z_path[:, inside])) / count
        whole = np.diag(S).real
        left = S - S_path - np.diag(noise[inside].mean(axis=0))
        power = np.diag(left).real
        hidden[c] = power < HIDDEN * whole
        power = np.maximum(power, HIDDEN * whole)
        root = np.sqrt(power)
        # no signals have the negative eigenvalues that chance leaves; few windows make coherence where none is
        value, vector = np.linalg.eigh(left / np.outer(root, root))
        mixed = (vector * np.maximum(value, 0.0)) @ np.conj(vector.T)
        scale = np.sqrt(np.maximum(np.diag(mixed).real, 1e-12))
        mixed = mixed / np.outer(scale, scale)
        share = 6.0 / (6.0 + 0.5 * count)
        mixed = (1.0 - share) * mixed
        np.fill_diagonal(mixed, 1.0)
        each = np.sum(np.abs(own) ** 2, axis=1) / inside.sum()
        # windows overlap by half and the loudness swings: half of them count
        sigma.append(each.std(axis=0) / np.sqrt(0.5 * len(z)) / power)
        density.append(power)
        coherence.append(0.5 * (mixed + np.conj(mixed.T)))
    swing, time = _swing(z, f, edges)
    words = [
        f"{REGIMES[k]}: {axis_name(a)} {' and '.join(f'{p:.3g} to {q:.3g}' for p, q in _stretches(edges, hidden[:, a]))} Hz is hidden by the path or the noise"
        for a in range(6)
        if hidden[:, a].any()
    ]
    made = Regime(
        REGIMES[k],
        np.array(density),
        np.array(coherence),
        swing_sigma=swing,
        swing_time=time,
        density_sigma=np.array(sigma),
        **ranges(k),
    )
    return made, words


def ranges(k: int) -> dict[str, tuple[float, float]]:
    """Speed, turn and climb of a regime of :data:`REGIMES`, as its file says them."""
    inf = float("inf")
    edges = (STANDING, *SPEEDS, inf)
    moving = {"speed": (STANDING, inf), "turn": (0.0, float(TURNING))}
    if k == 0:
        return {"speed": (0.0, STANDING)}
    if k == 1:
        return {"speed": (STANDING, inf), "turn": (float(TURNING), inf)}
    if k in (2, 3):
        return moving | {"climb": (CLIMBING, inf) if k == 2 else (-inf, -CLIMBING)}
    return moving | {"speed": (edges[k - 4], edges[k - 3]), "climb": (-CLIMBING, CLIMBING)}


def _stretches(edges: Array, inside: NDArray[np.bool_]) -> list[tuple[float, float]]:
    turns = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(np.int8), [0]]))).reshape(-1, 2)
    return [(float(edges[a]), float(edges[b])) for a, b in turns]


def _swing(z: Complex, f: Array, edges: Array) -> tuple[float, float]:
    """Standard deviation (nepers of amplitude) and time (s) of the loudness that all axes share, from windows half overlapping."""
    logs = []
    for low, high in pairwise(edges[::CELLS]):
        inside = (f >= low) & (f < high)
        if inside.sum() > 2:
            logs.append(np.log(np.mean(np.abs(z[:, inside]) ** 2, axis=1)))
    if not logs:
        return 0.0, 5.0
    y = 0.5 * np.concatenate(logs, axis=1)
    y = y - y.mean(axis=0)
    common = y.mean(axis=1)
    # what axes and bands do not share scatters the mean of all by its own size over their number
    own = float(np.mean((y - common[:, None]) ** 2)) / y.shape[1]
    variance = float(common.var()) - own
    if variance <= 1e-4:
        return 0.0, 5.0
    # autocorrelation (1 + x) exp(-x), x = lag over time, two windows apart so that none overlap
    lag = WINDOW_S
    r = float(np.mean(common[2:] * common[:-2])) / variance if common.size > 4 else 0.0
    x = np.geomspace(lag / SWINGS[1], lag / SWINGS[0], 200)
    at = int(np.argmin(np.abs((1.0 + x) * np.exp(-x) - r)))
    return float(np.sqrt(variance)), float(lag / x[at])


def jerk_density(s: Signals) -> float | None:
    """Density of the jerk (m/s^3 per sqrt(Hz)) along and across the track while it moves; None where the recording is too short."""
    length = round(JERK_S / s.dt)
    first = s.pieces(length, length // 2)
    if not first.size:
        return None
    first = first[s.motion(s.t[first] + 0.5 * JERK_S)[0] > STANDING]
    if first.size < 4:
        return None
    f, z = spectra(s, first, length)
    inside = (f >= JERK_HZ[0]) & (f <= JERK_HZ[1])
    density = np.mean(np.abs(z[:, inside, 3:5] * (2.0 * np.pi * f[inside])[:, None]) ** 2)
    return float(np.sqrt(0.5 * density))
