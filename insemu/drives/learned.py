"""A vehicle from a recording: what its body does about the path, by regime, with standard deviations, and what the recording cannot tell.

The motion below about half a hertz is the path's, made from the fixes as an emulation makes it. Above, the spectral matrix of the six axes less
that of the path and less the sensor's noise is the vehicle's. What is left follows from the same windows: how its loudness swings, sideslip by
holding the course against the gyroscope, and the jerk density with which it changes its mind.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from insemu.drives.sideslip import Sideslip, sideslip_of
from insemu.drives.windows import (
    CLIMBING,
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
from insemu.emulate import VEHICLES, MotionSpectrum, Moving, MovingVehicle, Regime, Slip, Track, ideal_imu, smooth_track
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
#: Up to this frequency, Hz, a driver and the springs move a vehicle, above it the ground, the air and the engine do: each with a loudness of its own.
DRIVING_HZ = 3.0
#: Windows from which on each of them has two parts; steps of the climb to their likeliest sizes.
PARTS_FROM, ITERATIONS = 20, 60
#: Time constants of a swing that windows of four seconds tell, s, and the largest swing, nepers: beyond, a few windows are all of the power.
SWINGS, LARGEST_SWING = (3.0, 30.0), 1.0
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
    count = np.array([i.sum() for i in inside])
    Y, Y_path = (
        np.stack([np.einsum("wfi,wfj->wij", x[:, i], np.conj(x[:, i])) / i.sum() for i in inside], axis=1)
        for x in (z, z_path)
    )
    quiet = np.stack([noise[i].mean(axis=0) for i in inside])
    found: list[Regime] = []
    seconds: dict[str, float] = {}
    for word, rows, where in classes(regime, motion[0]):
        if rows.sum() < FEWEST:
            unknown.append(f"{word}: {0.5 * WINDOW_S * rows.sum():.0f} s are too few, the nearest regime stands for it")
            continue
        seconds[word] = float(0.5 * WINDOW_S * rows.sum())
        made, hidden = _regime(word, where, edges, Y[rows], Y_path[rows], quiet, count)
        found += made
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
    spectrum = MotionSpectrum(rows_of(edges)[0], tuple(found), (), tuple(unknown))
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
        return np.zeros((f.size, 6)), ["the sensor's noise: too few windows, so none is taken off"]
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
    name: str,
    where: Mapping[str, tuple[float, float]],
    edges: Array,
    Y: Complex,
    Y_path: Complex,
    noise: Array,
    count: NDArray[np.int64],
) -> tuple[list[Regime], list[str]]:
    """The parts of a regime from spectral matrices (w, c, 6, 6) of its windows and their path, and what is hidden in it."""
    many = len(Y)
    power = np.einsum("wcii->wci", Y).real
    known = np.einsum("wcii->wci", Y_path).real + noise
    parts = 1 if many < PARTS_FROM else 2
    driving = edges[1:] < DRIVING_HZ
    C = np.zeros((2 * parts, *Y.shape[1:]), dtype=complex)
    g, chance, rng = np.empty((many, 2 * parts)), np.empty((many, 2 * parts)), np.random.default_rng(1)
    for k, own in enumerate((driving, ~driving)):
        mine = slice(k * parts, (k + 1) * parts)
        g[:, mine] = loudness(power[:, own], known[:, own], count[own], parts)
        # what chance alone makes of a vehicle that is always as loud; ordinates under a Hann window count two thirds
        degrees = count[own][:, None] / 1.5
        steady = (np.maximum(power[:, own] - known[:, own], 0.0).mean(axis=0) + known[:, own]) * rng.gamma(
            degrees, 1.0 / degrees, power[:, own].shape
        )
        chance[:, mine] = loudness(steady, known[:, own], count[own], parts)
        C[mine, own] = matrices(Y[:, own], Y_path[:, own] + noise[own, :, None] * np.eye(6), g[:, mine])
    floor = HIDDEN * power.mean(axis=0)
    left = (power - known).mean(axis=0)
    hidden = left < floor
    # the likeliest matrices are those of the usual window; the mean power is that of all
    size = np.sqrt(np.maximum(left, floor) / np.maximum(np.einsum("pcii->ci", C).real, 1e-3 * floor))
    C = C * (size[:, :, None] * size[:, None, :])
    out, cell = [], rows_of(edges)[1]
    together, swings = _swings(g, chance)
    for p, (sigma, time) in enumerate(swings):
        density = np.einsum("cii->ci", C[p]).real
        root = np.sqrt(np.maximum(density, 1e-6 * floor))
        coherence = C[p] / (root[:, :, None] * root[:, None, :])
        coherence[:, range(6), range(6)] = 1.0
        # windows overlap by half, so half of them count; the loudness is one value a window
        spread = np.sqrt((1.0 / count + np.expm1(4.0 * (sigma**2 + together[0] ** 2))) / (0.5 * many))
        out.append(
            Regime(
                name + (f", part {p + 1}" if p else ""),
                table(edges, density),
                (0.5 * (coherence + np.conj(np.swapaxes(coherence, 1, 2))))[cell],
                swing_sigma=sigma,
                swing_time=time,
                common_sigma=together[0],
                common_time=together[1],
                density_sigma=np.repeat(spread[cell][:, None], 6, axis=1),
                **where,
            )
        )
    words = [
        f"{axis_name(a)} {' and '.join(f'{x:.2g} to {y:.2g}' for x, y in _stretches(edges, hidden[:, a]))} Hz"
        for a in range(6)
        if hidden[:, a].any()
    ]
    return out, [f"{name}, hidden by the path or the noise: {', '.join(words)}"] if words else []


def rows_of(edges: Array) -> tuple[Array, NDArray[np.intp]]:
    """Frequencies of the rows of a table, and the cell that each shows: middles, the outer edges, and both sides of :data:`DRIVING_HZ`."""
    centres = np.sqrt(edges[:-1] * edges[1:])
    cell = np.arange(centres.size)
    split = int(np.sum(edges[1:] < DRIVING_HZ))
    f = np.concatenate(
        [edges[:1], centres[:split], edges[split] * np.array([0.999, 1.001]), centres[split:], edges[-1:]]
    )
    at = np.concatenate([cell[:1], cell[:split], [max(split - 1, 0), split], cell[split:], cell[-1:]])
    return f, at


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


def loudness(power: Array, known: Array, count: NDArray[np.int64], parts: int) -> Array:
    """How loud each part is in each window (w, parts), mean 1, from powers (w, c, 6) beside known ones.

    Parts are spectra whose sum with own loudnesses explains the windows best: road and driving, engine and wind come and go each by itself.

    Parameters
    ----------
    power, known : (w, c, 6) arrays
    count : (c,) array
        Ordinates of each cell.
    parts : int

    Notes
    -----
    Factorization by the Itakura-Saito divergence, which is the likelihood of Gaussian signals (Fevotte, Bertin and Durrieu 2009), by
    multiplicative updates.
    """
    many, _, axes = power.shape
    V, K = power.reshape(many, -1), known.reshape(many, -1)
    weight = np.repeat(count, axes).astype(np.float64)
    mean = np.maximum(V - K, HIDDEN * V).mean(axis=0)
    logs = np.log(np.maximum(V - K, HIDDEN * V))
    shape = logs - logs.mean(axis=1, keepdims=True)
    shape -= shape.mean(axis=0)
    # they begin as the windows that differ most in shape, whatever their loudness
    along = np.linalg.svd(shape, full_matrices=False)[0][:, : max(parts - 1, 1)]
    start = (
        [along[:, 0].argsort(), (-along[:, 0]).argsort(), (-along[:, -1]).argsort()][:parts]
        if parts > 1
        else [np.arange(many)]
    )
    chosen = [x[: max(3, many // 5)] if parts > 1 else x for x in start]
    D = np.stack([mean * np.exp(shape[x].mean(axis=0)) for x in chosen]) / parts
    g = np.ones((many, parts))
    for _ in range(ITERATIONS):
        R = g @ D + K
        g *= np.sqrt(((weight * V / R**2) @ D.T) / ((weight / R) @ D.T))
        R = g @ D + K
        D *= np.sqrt((g.T @ (V / R**2)) / (g.T @ (1.0 / R)))
        scale = g.mean(axis=0)
        g, D = np.maximum(g / scale, 1e-4), D * scale[:, None]
    return np.asarray(g)


def matrices(Y: Complex, known: Complex, g: Array) -> Complex:
    """Spectral matrices (parts, c, 6, 6) of parts with loudnesses (w, parts) whose sum with known ones makes those (w, c, 6, 6) likeliest.

    Parameters
    ----------
    Y, known : (w, c, 6, 6) complex arrays
    g : (w, parts) array

    Notes
    -----
    Expectation and maximization for sums of Gaussian vectors with loudnesses of their own (Duong, Vincent and Gribonval 2010, section IV).
    """
    whole = Y.mean(axis=0)
    eye = np.eye(6)
    diagonal = np.einsum("cii->ci", whole).real[:, :, None] * eye
    C = np.repeat((0.9 * whole + 0.1 * diagonal)[None] / g.shape[1], g.shape[1], axis=0)
    for _ in range(ITERATIONS // 2):
        own = g.T[:, :, None, None, None] * C[:, None]
        inverse = np.linalg.inv(own.sum(axis=0) + known + 1e-6 * diagonal)
        new = []
        for p in range(g.shape[1]):
            W = own[p] @ inverse
            felt = W @ Y @ np.conj(np.swapaxes(W, -1, -2)) + (eye - W) @ own[p]
            new.append((felt / g[:, p, None, None, None]).mean(axis=0))
        C = np.stack(new)
        C = 0.5 * (C + np.conj(np.swapaxes(C, -1, -2)))
    return np.asarray(C)


def _stretches(edges: Array, inside: NDArray[np.bool_]) -> list[tuple[float, float]]:
    turns = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(np.int8), [0]]))).reshape(-1, 2)
    return [(float(edges[a]), float(edges[b])) for a, b in turns]


def _swings(g: Array, chance: Array) -> tuple[tuple[float, float], list[tuple[float, float]]]:
    """What all parts swing together, and each by itself: standard deviation (nepers of amplitude) and time (s), of loudnesses (w, parts) of mean 1.

    Windows overlap by half. Of a lognormal loudness the mean is above the median by ``exp(2 sigma^2)``, which gives the size: what a part does when
    it is all but away does not matter. ``chance`` is what loudnesses look like where there is no swing.
    """
    (y, size, shared), (_, own_size, own_shared) = (_sizes(x) for x in (g, chance))
    together, size = y.mean(axis=1), np.maximum(size - own_size, 0.0)
    shared = max(0.0, min(shared - own_shared, float(size.mean())))
    own = [_slow(y[:, p] - together, float(np.sqrt(max(size[p] - shared, 0.0)))) for p in range(y.shape[1])]
    return _slow(together, float(np.sqrt(shared))), own


def _sizes(g: Array) -> tuple[Array, Array, float]:
    """Logarithms of amplitudes about their medians (w, parts), squares of the standard deviations (parts,), and what parts share of them."""
    y = 0.5 * np.log(g)
    low, middle, high = np.quantile(y, [0.1, 0.5, 0.9], axis=0)
    y = np.clip(y, middle - 2.0 * (middle - low), middle + 2.0 * (high - middle)) - middle
    return y, np.maximum(-middle, 0.0), float(np.cov(y.T)[~np.eye(y.shape[1], dtype=bool)].mean())


def _slow(y: Array, sigma: float) -> tuple[float, float]:
    """Standard deviation and time of a slow process that shows this standard deviation in means over windows."""
    if sigma < 0.05 or y.size < 8:
        return 0.0, 5.0
    y = y - y.mean()
    # autocorrelation (1 + x) exp(-x), x = lag over time, two windows apart so that none overlap
    r = float(np.mean(y[2:] * y[:-2]) / np.mean(y**2))
    tried = np.geomspace(WINDOW_S / SWINGS[1], WINDOW_S / SWINGS[0], 200)
    x = float(tried[np.argmin(np.abs((1.0 + tried) * np.exp(-tried) - r))])
    # a window shows the mean over it, which swings less
    u = np.linspace(0.0, 1.0, 100)
    kept = 2.0 * float(np.mean((1.0 - u) * (1.0 + x * u) * np.exp(-x * u)))
    return min(sigma / float(np.sqrt(kept)), LARGEST_SWING), WINDOW_S / x
