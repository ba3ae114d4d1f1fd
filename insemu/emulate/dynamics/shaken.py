"""A realization of a vehicle's own motion as part of the truth: displacement and turn of the body, added to a path.

The motion is a quintic spline on uniform knots whose coefficients are drawn block by block, each block by its own stream, with windows whose
squares sum to one (overlap-add of stationary noise). So it is smooth, the same at whatever times it is asked, and takes the memory of a few
blocks. Displacement and turn follow from the stated specific force and rate: ``turn = rate / (i w)``, ``displacement = -(force - turn x g) / w^2``.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.compiled import njit
from insemu.emulate.dynamics.blocks import STREAMS, Blocks, Mount
from insemu.emulate.dynamics.files import MovingVehicle
from insemu.emulate.dynamics.levels import between
from insemu.emulate.dynamics.slip import SlipMotion
from insemu.emulate.dynamics.slow import SlowProcess
from insemu.emulate.dynamics.spectrum import Line, MotionSpectrum, weights
from insemu.emulate.hover import plane_of
from insemu.emulate.motion import smoothstep
from insemu.emulate.path import Curve, SmoothPath
from insemu.emulate.vehicle import vehicle as vehicle_of

Array = NDArray[np.float64]

#: Knots per period of the highest frequency: the spline's images then stay below 1.2 per cent of the acceleration.
KNOTS_PER_PERIOD = 4.0
#: Periods of the lowest frequency in a hop from block to block, and least length of it in s.
PERIODS, SHORTEST_HOP = 4.0, 8.0
#: Share below which a regime is not drawn; up to ten times as much its level rises smoothly from nothing.
_NO_SHARE = 1e-3
#: What changes slowly (speed, attitude, levels) is asked for so often, Hz at least, and is cubic between; shares of regimes blend over so many s.
_SLOW_HZ, _BLEND = 15.0, 1.0
#: Blocks that are kept: 25 MB.
_KEPT = 128
#: Page of the knots just before the start of a path.
FIRST_PAGE = -1


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
        self.path, self.spectrum, self.slip, self.seed = path, spectrum, slip, seed
        self.rate = KNOTS_PER_PERIOD * spectrum.highest
        hop = max(SHORTEST_HOP, PERIODS / float(spectrum.frequencies[0]))
        self.hop = 1 << int(np.ceil(np.log2(hop * self.rate)))
        self.every = 1 << max(0, int(np.log2(self.rate / _SLOW_HZ)))
        self.start = path.start
        self.blocks = Blocks(spectrum, self.hop, self.rate, seed, mount)
        self._pages: OrderedDict[int, Array] = OrderedDict()
        self._periods: dict[int, Array] = {}
        self._noses: Array | None = None
        self._powers: Array | None = None

        # regimes that swing alike swing together
        self._swings = {
            x: SlowProcess(*x, (seed, STREAMS["swing"]))
            for x in sorted({(r.swing_sigma, r.swing_time) for r in spectrum.regimes})
        }
        self._wanders = [
            SlowProcess(x.wander_sigma, x.wander_time, (seed, STREAMS["wander"], k))
            for k, x in enumerate(spectrum.lines)
        ]
        rng = np.random.default_rng((seed, STREAMS["phase"]))
        self._phases = rng.uniform(0.0, 2.0 * np.pi, len(spectrum.lines))

    def __getstate__(self) -> dict[str, Any]:
        """For another process: what was drawn is drawn there again."""
        return self.__dict__ | {"_pages": OrderedDict()}

    @property
    def _last_page(self) -> int:
        return int((self.path.end - self.start) * self.rate) // self.hop + 1

    def _slowly(self, number: int, more: int = 0) -> Array:
        """Times of the slow samples of a page, one before it and two (and ``more`` on both sides) behind it."""
        first, count = number * (self.hop // self.every), self.hop // self.every
        return np.asarray(self.start + np.arange(first - 1 - more, first + count + 2 + more) * (self.every / self.rate))

    def _finely(self, slow: Array) -> Array:
        """Rows (hop, k) at the knots of a page, from slow samples (n, k)."""
        out = np.empty((self.hop, slow.shape[1]))
        _cubic(np.ascontiguousarray(slow), self.every, out)
        return out

    # -- coefficients in map axes -------------------------------------------------------------------------------------------------------

    def _page(self, number: int) -> Array:
        """Coefficients (hop, 6) of the knots from ``number * hop`` on: metres north, east, up and rad of roll, pitch, heading."""
        if number in self._pages:
            return self._pages[number]
        t = self._slowly(number)
        inside = np.clip(t, self.path.start, self.path.end)
        rpy, shares = self.path.attitude(inside), self._shares(number)
        body = np.zeros((self.hop, 6))
        drawn = [k for k in range(shares.shape[1]) if shares[:, k].max() > _NO_SHARE]
        if drawn:
            levels = np.empty((t.size, len(drawn)))
            swung = {x: np.exp(process(t) - process.sigma**2) for x, process in self._swings.items()}
            for column, k in enumerate(drawn):
                share, r = shares[:, k], self.spectrum.regimes[k]
                rises = smoothstep((share - _NO_SHARE) / (9.0 * _NO_SHARE))
                levels[:, column] = share * rises * swung[r.swing_sigma, r.swing_time]
            levels, gains = self._finely(levels), self._finely(self._gains(t))
            own, adds, window = self.blocks.own, self.blocks.adds, self.blocks.window
            for column, k in enumerate(drawn):
                late, early = self.blocks.half(number - 1, k, 1), self.blocks.half(number, k, 0)
                _add_noise(body, levels[:, column, None] * gains, own, adds, window, late, early)
        for k, line in enumerate(self.spectrum.lines):
            self._add(line, k, number, shares, body)
        slipped = self._slipped(number, t, inside, rpy)
        attitude = self._finely(np.hstack([rpy + slipped, slipped]))
        out = np.empty_like(body)
        _into_map(attitude, body, out)
        self._pages[number] = out
        while len(self._pages) > _KEPT:
            self._pages.popitem(last=False)
        return out

    def _gains(self, t: Array) -> Array:
        """Amplitudes (n, channels' levels) at times over those of the densities."""
        levels = self.spectrum.levels
        if levels is None:
            return np.ones((t.size, 6))
        start = float(self._slowly(FIRST_PAGE)[0]) - levels.step
        if self._powers is None:
            at = np.clip(
                np.arange(start, float(self._slowly(self._last_page)[-1]) + 2.0 * levels.step, levels.step),
                self.path.start,
                self.path.end,
            )
            self._powers = levels.drawn(self._motion(at), np.random.default_rng((self.seed, STREAMS["level"])))
        return np.sqrt(between((t - start) / levels.step, self._powers))

    def _motion(self, t: Array) -> Array:
        """Horizontal speed, magnitude of the turn rate and rate of climb (n, 3) of the path."""
        velocity, turn = self.path.position(t, 1), self.path.attitude(t, 1)[:, 2]
        return np.stack([np.hypot(velocity[:, 0], velocity[:, 1]), np.abs(turn), velocity[:, 2]], axis=1)

    def _shares(self, number: int) -> Array:
        """Shares (n, regimes) at the slow samples of a page, blended over time."""
        more = int(np.ceil(_BLEND * self.rate / self.every))
        t = np.clip(self._slowly(number, more), self.path.start, self.path.end)
        shares = weights(self.spectrum.regimes, *self._motion(t).T)
        window = np.sin(np.pi * (np.arange(2 * more + 1) + 1.0) / (2 * more + 2)) ** 2
        window /= window.sum()
        return np.stack([np.convolve(s, window, mode="valid") for s in shares.T], axis=1)

    def _slipped(self, number: int, t: Array, inside: Array, rpy: Array) -> Array:
        """Changes of roll, pitch and heading at the slow samples of a page."""
        if self.slip is None:
            return np.zeros((t.size, 3))
        last = 0.0 if self.slip.slip.nose == "course" else self._nose()[number - FIRST_PAGE]
        velocity, turn = self.path.position(inside, 1), self.path.attitude(inside, 1)[:, 2]
        return self.slip.turned(t, self.path.position(inside), velocity, rpy, turn, last)

    def _nose(self) -> Array:
        """Where a free nose points just before every page (rad, counted through whole turns)."""
        if self._noses is None:
            last, found = 0.0, [0.0]
            assert self.slip is not None
            for number in range(FIRST_PAGE, self._last_page + 1):
                t = np.clip(self._slowly(number), self.path.start, self.path.end)
                free = self.slip.free(self._slowly(number), self.path.position(t), self.path.attitude(t)[:, 2], last)
                last = float(free[self.hop // self.every - 1])
                found.append(last)
            self._noses = np.array(found)
        return self._noses

    def _add(self, line: Line, k: int, number: int, shares: Array, body: Array) -> None:
        """Add a line to the coefficients of a page."""
        t, wander = self._slowly(number), self._wanders[k]
        amplitude = np.zeros((t.size, 6))
        for j, regime in enumerate(self.spectrum.regimes):
            own = line.amplitude.get(regime.name, line.amplitude.get("*"))
            if own is not None:
                amplitude += shares[:, j, None] * np.asarray(own)
        if line.rate is not None:
            rate = line.order * line.rate * (1.0 + wander(t))
            turned = self._finely(line.order * line.rate * wander.integral(t)[:, None])[:, 0]
            turned += line.order * line.rate / self.rate * (number * self.hop + np.arange(self.hop))
        else:
            rate = self._followed(k, number)
            fine = self._finely(rate[:, None])[:, 0]
            turned = self._turned(k)[number - FIRST_PAGE] + np.concatenate([[0.0], np.cumsum(fine[:-1])]) / self.rate
        low, high = float(self.spectrum.frequencies[0]), self.spectrum.highest
        amplitude *= (smoothstep(rate / low - 1.0) * smoothstep(3.0 - 2.0 * rate / high))[:, None]
        if amplitude.any():
            felt = amplitude * np.exp(1j * (self._phases[k] + np.asarray(line.phase)))
            moved = self.blocks.moved(felt, np.clip(rate, low, 1.5 * high))
            _add_line(body, turned, self._finely(np.hstack([moved.real, moved.imag])))

    def _followed(self, k: int, number: int) -> Array:
        """Periods per s of a line that follows the way, at the slow samples of a page."""
        line, t = self.spectrum.lines[k], self._slowly(number)
        velocity = self.path.position(np.clip(t, self.path.start, self.path.end), 1)
        return np.asarray(
            line.order
            * (line.per_metre or 0.0)
            * np.hypot(velocity[:, 0], velocity[:, 1])
            * (1.0 + self._wanders[k](t))
        )

    def _turned(self, k: int) -> Array:
        """Periods (pages,) of a line that follows the way, at the first knot of every page."""
        if k not in self._periods:
            pages = range(FIRST_PAGE, self._last_page + 1)
            made = [float(self._finely(self._followed(k, number)[:, None]).sum()) / self.rate for number in pages]
            self._periods[k] = np.concatenate([[0.0], np.cumsum(made)])
        return self._periods[k]

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
def _cubic(slow: Array, every: int, out: Array) -> None:
    """Rows between slow ones, cubic with the slopes of neighbours; the first row out is the second of the slow ones."""
    for i in range(len(out)):
        k, u = i // every, (i % every) / every
        a = u * (-0.5 + u * (1.0 - 0.5 * u))
        b = 1.0 + u * u * (-2.5 + 1.5 * u)
        c = u * (0.5 + u * (2.0 - 1.5 * u))
        d = u * u * (-0.5 + 0.5 * u)
        for j in range(out.shape[1]):
            out[i, j] = a * slow[k, j] + b * slow[k + 1, j] + c * slow[k + 2, j] + d * slow[k + 3, j]


@njit(cache=True, nogil=True)
def _add_noise(
    body: Array, gains: Array, own: NDArray[np.int64], adds: NDArray[np.int64], window: Array, late: Array, early: Array
) -> None:
    """Add the second half of one block and the first of the next, (channels, n) each: gain of its ``own``, column to which it ``adds``."""
    for i in range(len(body)):
        for j in range(len(adds)):
            both = window[i] * early[j, i] + window[len(body) + i] * late[j, i]
            body[i, adds[j]] += gains[i, own[j]] * both


@njit(cache=True, nogil=True)
def _add_line(body: Array, turned: Array, moved: Array) -> None:
    """Add a line of complex amplitudes (n, 12: real and imaginary parts) at so many periods."""
    for i in range(len(body)):
        c, s = np.cos(2.0 * np.pi * turned[i]), np.sin(2.0 * np.pi * turned[i])
        for j in range(6):
            body[i, j] += moved[i, j] * c - moved[i, 6 + j] * s


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
    """Displacements and small turns in body axes to metres north, east, up and changes of Euler angles, to which the last columns of ``rpy`` add."""
    for i in range(len(rpy)):
        sr, cr = np.sin(rpy[i, 0]), np.cos(rpy[i, 0])
        sp, cp = np.sin(rpy[i, 1]), np.cos(rpy[i, 1])
        sh, ch = np.sin(rpy[i, 2]), np.cos(rpy[i, 2])
        x, y, z = body[i, 0], body[i, 1], body[i, 2]
        across, down = cr * y - sr * z, sr * y + cr * z
        ahead = cp * x + sp * down
        out[i, 0], out[i, 1], out[i, 2] = ch * ahead - sh * across, sh * ahead + ch * across, sp * x - cp * down
        across, down = cr * body[i, 4] - sr * body[i, 5], sr * body[i, 4] + cr * body[i, 5]
        out[i, 3] = body[i, 3] + down * sp / cp + rpy[i, 3]
        out[i, 4], out[i, 5] = across + rpy[i, 4], down / cp + rpy[i, 5]


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
        moved = None if slip.none else SlipMotion(slip, kind, (self.seed, STREAMS["slip"]), place)
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
