"""A realization of a vehicle's own motion as part of the truth: displacement and turn of the body, added to a path.

The motion is a quintic spline on uniform knots whose coefficients are drawn block by block, each block by its own stream, with windows whose
squares sum to one (overlap-add of stationary noise). So it is smooth, the same at whatever times it is asked, and takes the memory of a few
blocks. Displacement and turn follow from the stated specific force and rate: ``turn = rate / (i w)``, ``displacement = -(force - turn x g) / w^2``.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.compiled import njit
from insemu.emulate.dynamics.files import MovingVehicle
from insemu.emulate.dynamics.slip import SlipMotion
from insemu.emulate.dynamics.slow import SlowProcess
from insemu.emulate.dynamics.spectrum import Line, MotionSpectrum, weights
from insemu.emulate.hover import plane_of
from insemu.emulate.path import Curve, SmoothPath
from insemu.emulate.vehicle import vehicle as vehicle_of
from insemu.errors import InputError
from insemu.units import STANDARD_GRAVITY

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Knots per period of the highest frequency: the spline's images then stay below 1.2 per cent of the acceleration.
KNOTS_PER_PERIOD = 4.0
#: Periods of the lowest frequency in a hop from block to block, and least length of it in s.
PERIODS, SHORTEST_HOP = 4.0, 8.0
#: Time within which one regime passes into the next, s: displacements are large where they are slow, and a sudden share of one is a blow.
CHANGE_S = 4.0
#: Shares of the power below which a regime is not drawn.
_NO_SHARE = 1e-6
#: Blocks that are kept: 25 MB.
_KEPT = 128
#: Page of the knots just before the start of a path.
FIRST_PAGE = -1
_STREAMS = {"block": 0, "swing": 1, "wander": 2, "phase": 3, "slip": 4}


@dataclass(frozen=True)
class Mount:
    """A mount that is not rigid: the IMU follows the body as a mass on a spring.

    Parameters
    ----------
    frequency : float
        Of its resonance, Hz.
    damping : float
        Share of the critical one.
    """

    frequency: float
    damping: float = 0.1

    def __post_init__(self) -> None:
        if not (self.frequency > 0 and 0 < self.damping <= 2 and np.isfinite(self.frequency)):
            raise InputError(
                f"a mount of {self.frequency} Hz and damping {self.damping}, expected a positive frequency and a damping up to 2"
            )

    def response(self, f: Array) -> Complex:
        """Motion of the IMU over that of the body (transmissibility) at frequencies (n,)."""
        r = f / self.frequency
        damped = 2j * self.damping * r
        return np.asarray((1.0 + damped) / (1.0 - r * r + damped))


class BodyMotion:
    """Displacement (metres north, east, up) and change of roll, pitch and heading (rad) of a vehicle about a path.

    Parameters
    ----------
    path : SmoothPath
        Gives speed, turn and climb, by which regimes and lines go, and the attitude in which the body shakes.
    spectrum : MotionSpectrum
    seed : int
        The same seed is the same motion.
    mount : Mount, optional
    slip : SlipMotion, optional
        How the nose leaves the course.
    """

    def __init__(
        self,
        path: SmoothPath,
        spectrum: MotionSpectrum,
        seed: int = 0,
        mount: Mount | None = None,
        slip: SlipMotion | None = None,
    ) -> None:
        self.path, self.spectrum, self.seed, self.mount, self.slip = path, spectrum, seed, mount, slip
        self.rate = KNOTS_PER_PERIOD * spectrum.highest
        hop = max(SHORTEST_HOP, PERIODS / float(spectrum.frequencies[0]))
        self.hop = 1 << int(np.ceil(np.log2(hop * self.rate)))
        self.start = path.start
        self._pages: OrderedDict[int, Array] = OrderedDict()
        self._blocks: OrderedDict[int, dict[int, Array]] = OrderedDict()
        self._periods: dict[int, Array] = {}
        self._noses: Array | None = None
        self._swings = [
            SlowProcess(r.swing_sigma, r.swing_time, (seed, _STREAMS["swing"], k))
            for k, r in enumerate(spectrum.regimes)
        ]
        self._wanders = [
            SlowProcess(x.wander_sigma, x.wander_time, (seed, _STREAMS["wander"], k))
            for k, x in enumerate(spectrum.lines)
        ]
        rng = np.random.default_rng((seed, _STREAMS["phase"]))
        self._phases = rng.uniform(0.0, 2.0 * np.pi, len(spectrum.lines))

    def __getstate__(self) -> dict[str, Any]:
        """For another process: what was drawn is drawn there again."""
        return self.__dict__ | {"_pages": OrderedDict(), "_blocks": OrderedDict()}

    # -- one block ------------------------------------------------------------------------------------------------------------------

    @cached_property
    def _frequencies(self) -> Array:
        return np.asarray(np.fft.rfftfreq(2 * self.hop, 1.0 / self.rate), dtype=float)

    def _to_spline(self, f: Array) -> tuple[Complex, Complex]:
        """What makes coefficients of turns of rates, and of displacements of accelerations, at frequencies (k,)."""
        w = 2.0 * np.pi * np.maximum(f, 1e-9)
        spline = np.sinc(f / self.rate) ** 6
        mount = np.ones(f.shape) if self.mount is None else self.mount.response(f)
        return np.asarray(1.0 / (1j * w * spline)), np.asarray(-mount / (w * w * spline))

    def _moved(self, felt: Complex, f: Array) -> Complex:
        """Coefficients (k, 6) of displacement and turn in body axes of rates and specific forces (k, 6)."""
        angle, place = self._to_spline(f)
        tilt = felt[:, :3] / (2j * np.pi * np.maximum(f, 1e-9))[:, None]
        force = felt[:, 3:].copy()
        force[:, 0] -= STANDARD_GRAVITY * tilt[:, 1]
        force[:, 1] += STANDARD_GRAVITY * tilt[:, 0]
        return np.concatenate([force * place[:, None], felt[:, :3] * angle[:, None]], axis=1)

    @cached_property
    def _factors(self) -> list[Complex]:
        """From white numbers to coefficients, (bins, 6, 6) of every regime, in the band of the table."""
        f = self._frequencies[self._band]
        scale = np.sqrt(0.5 * 2 * self.hop * self.rate)  # of one-sided densities
        out = []
        for k in range(len(self.spectrum.regimes)):
            factor = self.spectrum.factors(k, f) * scale
            out.append(np.stack([self._moved(factor[:, :, j], f) for j in range(6)], axis=2))
        return out

    @cached_property
    def _band(self) -> slice:
        low, high = np.searchsorted(self._frequencies, self.spectrum.frequencies[[0, -1]])
        return slice(max(int(low), 1), int(high) + 1)

    def _block(self, number: int, regime: int) -> Array:
        """Coefficients (2 hop, 6) in body axes of one regime over one block, windowed."""
        held = self._blocks.setdefault(number, {})
        while len(self._blocks) > 3:
            self._blocks.popitem(last=False)
        if regime not in held:
            factor = self._factors[regime]
            rng = np.random.default_rng((self.seed, _STREAMS["block"], regime, number - 2 * FIRST_PAGE))
            white = rng.standard_normal((len(factor), 6, 2)) @ np.array([1.0, 1j]) / np.sqrt(2.0)
            bins = np.zeros((self.hop + 1, 6), complex)
            bins[self._band] = np.matmul(factor, white[:, :, None])[:, :, 0]
            window = np.sin(np.pi * (np.arange(2 * self.hop) + 0.5) / (2 * self.hop))
            held[regime] = np.fft.irfft(bins, 2 * self.hop, axis=0) * window[:, None]
        return held[regime]

    # -- coefficients in map axes -------------------------------------------------------------------------------------------------------

    def _page(self, number: int) -> Array:
        """Coefficients (hop, 6) of the knots from ``number * hop`` on: metres north, east, up and rad of roll, pitch, heading."""
        if number in self._pages:
            return self._pages[number]
        t = self._times(number)
        inside = np.clip(t, self.path.start, self.path.end)
        velocity, rpy = self.path.position(inside, 1), self.path.attitude(inside)
        turn = self.path.attitude(inside, 1)[:, 2]
        speed = np.hypot(velocity[:, 0], velocity[:, 1])
        shares = self._shares(t)
        body = np.zeros((self.hop, 6))
        for k, swing in enumerate(self._swings):
            if shares[:, k].max() < _NO_SHARE:
                continue
            level = np.sqrt(shares[:, k])
            if swing.sigma > 0.0:
                level = level * np.exp(swing(t) - swing.sigma**2)
            body += level[:, None] * (self._block(number - 1, k)[self.hop :] + self._block(number, k)[: self.hop])
        for k, line in enumerate(self.spectrum.lines):
            body += self._line(line, k, number, t, speed, shares)
        slipped = self._slipped(number, t, inside, velocity, rpy, turn)
        out = np.empty_like(body)
        _into_map(rpy + slipped, body, out)
        out[:, 3:] += slipped
        self._pages[number] = out
        while len(self._pages) > _KEPT:
            self._pages.popitem(last=False)
        return out

    def _shares(self, t: Array) -> Array:
        """Shares of the regimes (n, regimes) at times on a uniform grid, changing within :data:`CHANGE_S`."""
        window = np.hanning(23)[1:-1]
        step = CHANGE_S / (window.size + 1)
        grid = np.arange(t[0] - CHANGE_S, t[-1] + CHANGE_S + step, step)
        inside = np.clip(grid, self.path.start, self.path.end)
        velocity, turn = self.path.position(inside, 1), self.path.attitude(inside, 1)[:, 2]
        speed = np.hypot(velocity[:, 0], velocity[:, 1])
        now = weights(self.spectrum.regimes, speed, turn, velocity[:, 2])
        smooth = [np.convolve(column, window / window.sum(), "same") for column in now.T]
        return np.stack([np.interp(t, grid, column) for column in smooth], axis=1)

    def _slipped(self, number: int, t: Array, inside: Array, velocity: Array, rpy: Array, turn: Array) -> Array:
        """Changes of roll, pitch and heading (hop, 3) at the knots of a page."""
        if self.slip is None:
            return np.zeros((t.size, 3))
        if self.slip.slip.nose == "course":
            last = 0.0
        else:
            last = self._nose()[number - FIRST_PAGE]
        return self.slip.turned(t, self.path.position(inside), velocity, rpy, turn, last)[0]

    def _nose(self) -> Array:
        """Where a free nose points just before every page (rad, counted through whole turns)."""
        if self._noses is None:
            last, found = 0.0, [0.0]
            assert self.slip is not None
            for number in range(FIRST_PAGE, self._last_page + 1):
                t = self._times(number)[:: max(1, int(self.rate / 20.0))]
                inside = np.clip(t, self.path.start, self.path.end)
                rpy, velocity = self.path.attitude(inside), self.path.position(inside, 1)
                last = self.slip.turned(t, self.path.position(inside), velocity, rpy, np.zeros(t.size), last)[1]
                found.append(last)
            self._noses = np.array(found)
        return self._noses

    @property
    def _last_page(self) -> int:
        return int((self.path.end - self.start) * self.rate) // self.hop + 1

    def _line(self, line: Line, k: int, number: int, t: Array, speed: Array, shares: Array) -> Array:
        off = self._wanders[k](t)
        if line.rate is not None:
            rate = line.order * line.rate * (1.0 + off)
            turned = line.order * line.rate * (t - self.start + self._wanders[k].integral(t))
        else:
            rate = line.order * (line.per_metre or 0.0) * speed * (1.0 + off)
            turned = self._turned(k)[number - FIRST_PAGE] + np.concatenate([[0.0], np.cumsum(rate[:-1])]) / self.rate
        low, high = float(self.spectrum.frequencies[0]), self.rate / KNOTS_PER_PERIOD
        there = np.clip(rate / low - 1.0, 0.0, 1.0) * np.clip(3.0 - 2.0 * rate / high, 0.0, 1.0)
        amplitude = np.zeros((t.size, 6))
        for j, regime in enumerate(self.spectrum.regimes):
            own = line.amplitude.get(regime.name, line.amplitude.get("*"))
            if own is not None:
                amplitude += shares[:, j, None] * np.asarray(own)
        if not (there.any() and amplitude.any()):
            return np.zeros((t.size, 6))
        phase = 2.0 * np.pi * turned + self._phases[k]
        felt = amplitude * there[:, None] * np.exp(1j * (phase[:, None] + np.asarray(line.phase)))
        return np.asarray(self._moved(felt, np.clip(rate, low, high)).real)

    def _turned(self, k: int) -> Array:
        """Periods (pages,) of a line that follows the way, at the first knot of every page."""
        if k not in self._periods:
            line, made = self.spectrum.lines[k], []
            for number in range(FIRST_PAGE, self._last_page + 1):
                t = self._times(number)
                velocity = self.path.position(np.clip(t, self.path.start, self.path.end), 1)
                speed = np.hypot(velocity[:, 0], velocity[:, 1])
                made.append(
                    line.order
                    * (line.per_metre or 0.0)
                    * float((speed * (1.0 + self._wanders[k](t))).sum())
                    / self.rate
                )
            self._periods[k] = np.concatenate([[0.0], np.cumsum(made)])
        return self._periods[k]

    def _times(self, number: int) -> Array:
        """Of the knots of a page, s."""
        return np.asarray(self.start + np.arange(number * self.hop, (number + 1) * self.hop) / self.rate)

    # -- the curve ---------------------------------------------------------------------------------------------------------------------

    def __call__(self, t: ArrayLike, nu: int = 0, first: int = 0) -> Array:
        """Three columns from ``first`` on (0 displacement, 3 turn), or their derivatives of an order up to 4, at times (n,)."""
        t = np.asarray(t, dtype=float)
        at = np.atleast_1d(t)
        place = (at - self.start) * self.rate
        knot = np.floor(place).astype(np.int64)
        out = np.empty((at.size, 3))
        page = (knot - 2) // self.hop
        for number in np.unique(page):
            rows = np.flatnonzero(page == number)
            held = np.concatenate([self._page(int(number)), self._page(int(number) + 1)[:5]])[:, first : first + 3]
            part = np.empty((rows.size, 3))
            _spline(knot[rows] - 2 - number * self.hop, place[rows] - knot[rows], np.ascontiguousarray(held), nu, part)
            out[rows] = part * self.rate**nu
        return out[0] if t.ndim == 0 else out


@njit(cache=True, nogil=True)
def _spline(first: NDArray[np.int64], u: Array, c: Array, nu: int, out: Array) -> None:
    """Quintic splines with coefficients ``c`` on whole numbers, at ``u`` behind the third of six knots from ``first`` on."""
    low = np.zeros(6)
    for i in range(u.size):
        x = u[i]
        low[:] = 0.0
        low[0] = 1.0
        for d in range(1, 6):
            keep = 0.0
            for j in range(d):
                part = low[j]
                if d <= 5 - nu:  # Cox and de Boor on uniform knots
                    right = (j + 1 - x) / d
                    low[j] = keep + part * right
                    keep = part * (1.0 - right)
                else:
                    low[j] = keep - part
                    keep = part
            low[d] = keep
        for k in range(3):
            s = 0.0
            for j in range(6):
                s += low[j] * c[first[i] + j, k]
            out[i, k] = s


@njit(cache=True, nogil=True)
def _into_map(rpy: Array, body: Array, out: Array) -> None:
    """Displacements and small turns in body axes to metres north, east, up and changes of Euler angles."""
    for i in range(len(rpy)):
        sr, cr = np.sin(rpy[i, 0]), np.cos(rpy[i, 0])
        sp, cp = np.sin(rpy[i, 1]), np.cos(rpy[i, 1])
        sh, ch = np.sin(rpy[i, 2]), np.cos(rpy[i, 2])
        x, y, z = body[i, 0], body[i, 1], body[i, 2]
        across, down = cr * y - sr * z, sr * y + cr * z
        ahead = cp * x + sp * down
        out[i, 0], out[i, 1], out[i, 2] = ch * ahead - sh * across, sh * ahead + ch * across, sp * x - cp * down
        across, down = cr * body[i, 4] - sr * body[i, 5], sr * body[i, 4] + cr * body[i, 5]
        out[i, 3], out[i, 4], out[i, 5] = body[i, 3] + down * sp / cp, across, down / cp


@dataclass(frozen=True)
class _Sum:
    """A curve with three columns of a body's motion on top."""

    base: Curve
    motion: BodyMotion = field(repr=False)
    first: int

    @property
    def x(self) -> Array:
        return self.base.x

    def __call__(self, t: ArrayLike, nu: int = 0) -> Array:
        return np.asarray(self.base(t, nu) + self.motion(t, nu, self.first))


@dataclass(frozen=True)
class Moving:
    """A vehicle on its way: what a scenario's ``trajectory.vehicle`` makes.

    Parameters
    ----------
    vehicle : MovingVehicle
    seed : int
        The same seed is the same motion.
    mount : Mount, optional
    """

    vehicle: MovingVehicle
    seed: int = 0
    mount: Mount | None = None

    def on(self, path: SmoothPath) -> SmoothPath:
        """The path with the body's motion about it."""
        slip, place = self.vehicle.slip, np.zeros(2)
        if slip.target is not None:
            place = plane_of(np.array([path.origin, [*slip.target, path.origin[2]]]))[1, :2]
        kind = vehicle_of(self.vehicle.kind)
        moved = None if slip.none else SlipMotion(slip, kind, (self.seed, _STREAMS["slip"]), place)
        return shaken(path, self.vehicle.spectrum, self.seed, self.mount, moved)


def shaken(
    path: SmoothPath,
    spectrum: MotionSpectrum,
    seed: int = 0,
    mount: Mount | None = None,
    slip: SlipMotion | None = None,
) -> SmoothPath:
    """A path on which the body moves as a spectrum says: the truth of reference, antenna and IMU alike.

    Parameters
    ----------
    path : SmoothPath
        Of the vehicle's reference point.
    spectrum : MotionSpectrum
    seed : int
    mount : Mount, optional
    slip : SlipMotion, optional
    """
    motion = BodyMotion(path, spectrum, seed, mount, slip)
    return replace(
        path,
        position=_Sum(path.position, motion, 0),
        attitude=_Sum(path.attitude, motion, 3),
        highest=max(path.highest, spectrum.highest),
    )
