"""All readings of an IMU weighed together: which of them explains the velocities of the fixes, and which differ at all.

Readings that differ from the declared one in a unit, a sign, the order of the axes of one sensor, increments for rates, a delay, or the side of the
globe are scored by :mod:`insemu.intake.explained`. The declared one is taken where none explains more. What is named is what explains the velocities
alone: where two readings do it equally well, both are said and no command is given.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.intake.card import Level, Line
from insemu.intake.explained import DECLARED, FEWEST, Explained, Reading, Windows
from insemu.units import scaled_unit

Array = NDArray[np.float64]

#: Gain that a reading must have over another one to be taken in its place: nats, and nats a number (a tenth less is left).
NATS, NATS_EACH = 20.0, 0.1
#: Gain from which the declared reading is refused even where it explains the velocities to some degree, nats.
PLAIN = 60.0
#: Log-likelihood a number from which nothing is explained, and share of what unrelated velocities leave, in the same measure.
WRONG_EACH, WRONG_SHARE = 0.9, 0.5
#: Nats a number by which unrelated velocities must be worse: less motion tells nothing.
MOVES = 0.15
#: Share by which a measured factor may differ from a unit's; from which a factor without a unit is said.
KNOWN, SCALE = 0.04, 0.05
#: How finely the factor is looked for.
SCALE_STEP = 1.02
#: Windows by which readings are screened, and how many of them are scored by all.
SCREENED, KEPT = 10, 8
#: Shortest shift of the fixes that is said, s; first step of the search and its end.
OFFSET, SHIFT, SHIFT_STEP = 0.1, 0.2, 0.02
#: Step of the shifts by which the parts of a record are compared, s.
DRIFT = 0.4
#: Course and heading differ so much at least, m/s across.
SLIP = 0.2
#: Delays of one sensor from the best of which the search begins, s, and the longest that a sensor has: fixes that are later, positions alone, are
#: as well explained by a late gyroscope (`python -m benchmarks.intake lags`).
DELAYS, LONGEST = (-0.5, -0.3, -0.1, 0.1, 0.3, 0.5), 1.0
#: Settings of fixes whose hemisphere was lost, and what they mean.
SIDES = {"west": "longitudes count west", "south": "latitudes count south"}
#: Settings' name of a sensor -> its name.
SENSORS = {"gyro": "gyroscope", "accel": "accelerometer"}
#: Units that gyroscopes and accelerometers are written in.
GYRO_UNITS = ("rad/s", "deg/s", "mrad/s", "mdps", "rpm", "rev/s", "deg/h", "rad/h", "57.29578 rad/s")
ACCEL_UNITS = ("m/s^2", "g", "mg", "ug", "mm/s^2", "cm/s^2", "ft/s^2", "0.1019716 m/s^2")
#: Counts of which 2048, 4096, ... are 1 g.
_COUNTS = tuple(f"{9.80665 / 2**k:.9g} m/s^2" for k in range(11, 17))


def orders() -> Iterator[tuple[str, Array]]:
    """All orders and signs of three axes, as text and as the matrix that columns are multiplied with."""
    for places, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        matrix = np.zeros((3, 3))
        for row, (place, sign) in enumerate(zip(places, signs, strict=True)):
            matrix[row, place] = sign
        yield " ".join(("-" if s < 0 else "") + "xyz"[p] for p, s in zip(places, signs, strict=True)), matrix


_ORDERS = dict(orders())
_PLAIN, _OPPOSITE = "x y z", "-x -y -z"
_MEANS = {"latlon=swapped": "latitude and longitude are swapped"}
_Order = tuple[dict[str, str], str, Array, Array]


@dataclass(frozen=True)
class Named:
    """A reading, with the settings that make the file so and what it means."""

    settings: Mapping[str, str]
    means: str
    found: Explained

    @property
    def effort(self) -> int:
        """How many declared facts it contradicts; a factor that is no unit counts double."""
        orders = [v for k, v in self.settings.items() if k.endswith("_axes")]
        changed = sum(
            1 if v == _OPPOSITE else sum(a != b for a, b in zip(v.split(), _PLAIN.split(), strict=True)) for v in orders
        )
        return changed + len(self.settings) - len(orders) + 2 * ("no unit" in self.means)

    @property
    def command(self) -> str:
        """What is added to the command."""
        return '--map "' + ", ".join(f"{k}={v}" for k, v in self.settings.items()) + '"' if self.settings else ""


def better(a: Explained, b: Explained) -> bool:
    """Whether a reading explains more than another one, beyond chance and models."""
    gain = a.nats - b.nats
    more = gain + a.turned - b.turned
    return more > NATS and (gain / max(a.count, 1) > NATS_EACH or a.turned - b.turned > NATS)


def units_of(factor: float, declared: str, units: Iterable[str]) -> list[str]:
    """The units whose size is the declared one's times a factor; none where the declared one is no unit.

    Parameters
    ----------
    factor : float
    declared : str
    units : iterable of str
        Those that are asked.
    """
    try:
        size = scaled_unit(declared).factor * factor
    except InputError:
        return []
    return [u for u in units if abs(np.log(scaled_unit(u).factor / size)) < np.log1p(KNOWN)]


def force_factor(windows: Windows) -> float:
    """What the specific force should be multiplied with: the change of the fixes' velocity less gravity by its size, whatever the attitude."""
    wanted, have = windows.forces()
    good = have > 0.0
    return float(np.median(wanted[good] / have[good])) if good.any() else np.nan


class Turning:
    """Turns of the course against rates, for vehicles whose course follows their heading.

    Parameters
    ----------
    rows : three arrays
        Of :func:`insemu.intake.motion.turns`.
    up : (3,) array
        Mean direction of the specific force.
    shift : float
        s that the stamps of the fixes were moved by.
    slope : float
        Course by gyroscope, which leaves the noise of the course times the speed; no less than :data:`SLIP`, m/s.
    """

    def __init__(self, rows: tuple[Array, Array, Array], up: Array, shift: float, slope: float) -> None:
        self.rows, self.up, self.shift = rows, up, shift
        self.noise = max(SLIP, 1.4826 * float(np.median(np.abs(self._rest(Reading(slope * np.eye(3), np.eye(3)))))))

    def nats(self, reading: Reading) -> float:
        """Log-likelihood of the turns in a reading: Student's with four degrees of freedom, for courses of slow fixes have heavy tails."""
        return -2.5 * float(np.sum(np.log1p(0.25 * (self._rest(reading) / self.noise) ** 2)))

    def _rest(self, reading: Reading) -> Array:
        """What a reading leaves of the turns, a constant drift apart, m/s."""
        y, angle, span = self.rows
        up = reading.accel @ self.up
        x = -(angle @ reading.gyro.T) @ (up / np.linalg.norm(up))
        rest = reading.east * y - x
        return np.asarray(rest - span * float(span @ rest) / max(float(span @ span), 1e-12))


class Weighing:
    """The readings of one recording.

    Parameters
    ----------
    windows : Windows
    kind : str
        Of the IMU's rows.
    dt : float
        Its interval, s.
    units : mapping of str to str
        Declared units of ``gyro`` and ``accel``.
    velocities : bool
        Whether velocities of the receiver agree with the positions, which then are not mirrored.
    turn : Turning, optional
        Turns of the fixes, where the course follows the heading.
    others : mapping of str to Explained, optional
        Readings of the fixes, by their setting.
    """

    def __init__(
        self,
        windows: Windows,
        kind: str,
        dt: float,
        units: Mapping[str, str],
        velocities: bool,
        turn: Turning | None = None,
        others: Mapping[str, Explained] | None = None,
    ) -> None:
        self.velocities, self.turn = velocities, turn
        # swapped, a way turns the other way round, as one that is mirrored east
        mirrored = turn.nats(replace(DECLARED, east=-1.0)) if turn is not None else 0.0
        self.others = {k: replace(e, turned=mirrored) for k, e in (others or {}).items()}
        self.hint = turn.shift if turn is not None else 0.0
        self.windows, self.kind, self.dt = windows, kind, dt
        self._few = windows.fewer(SCREENED)
        self._over = " s" if kind == "increment" else ""
        self.units = {"gyro": units.get("gyro") or "rad/s", "accel": units.get("accel") or "m/s^2"}
        self.declared = self._with_turn(windows.explain())
        self.unrelated = windows.explain(other=max(1, windows.count // 2))
        self._cache: dict[bytes, Explained] = {}

    def score(self, gyro: Array, accel: Array, **more: float) -> Explained:
        """Score of a reading, kept."""
        key = gyro.tobytes() + accel.tobytes() + repr(sorted(more.items())).encode()
        if key not in self._cache:
            self._cache[key] = self._with_turn(self.windows.explain(Reading(gyro, accel, **more)))
        return self._cache[key]

    def _with_turn(self, found: Explained) -> Explained:
        """What turns add; a shift of the fixes other than theirs is the windows' to judge."""
        return found if self.turn is None else replace(found, turned=self.turn.nats(found.reading))

    def explains(self, found: Explained) -> bool:
        """Whether what a reading leaves is the noise of the fixes rather than what unrelated velocities leave."""
        each, floor = -found.nats / found.count, 0.5 * np.log(2.0)
        worst = -self.unrelated.nats / self.unrelated.count
        return bool(each < WRONG_EACH or each - floor < WRONG_SHARE * (worst - floor))

    def moves(self, best: Explained) -> bool:
        """Whether unrelated velocities would be seen."""
        return bool(best.nats / best.count - self.unrelated.nats / self.unrelated.count > MOVES)

    # ------------------------------------------------------------------------------------------------------------- candidates

    def best(self) -> list[Named]:
        """Readings that explain more than the declared one, the best first and those that are as good; none where there is none."""
        found = [*self._shifts(), *self._units(), *self._delays()]
        if not any(self.fine(n.found) for n in found):
            top = max(found, key=lambda n: n.found.nats)
            found += self._orders(None)
            if better(top.found, max(self.declared, *(n.found for n in found if n is not top), key=lambda e: e.nats)):
                found += self._orders(top)
        if not any(self.fine(n.found) for n in found):
            found += self._other_sides() + self._scales()
        found += [Named({"latlon": "swapped"}, _MEANS[k], e) for k, e in self.others.items()]
        good = sorted((n for n in found if better(n.found, self.declared)), key=lambda n: -n.found.total)
        equal = [n for n in good if not better(good[0].found, n.found)] if good else []
        least = min((n.effort for n in equal), default=0)
        return [n for n in equal if n.effort == least]

    def _units(self) -> list[Named]:
        """Readings in other units, and increments for rates."""
        out = []
        for setting, size in self._forces():
            for unit in GYRO_UNITS:
                factor = scaled_unit(unit).factor / self._size("gyro")
                settings = {"gyro_unit": unit + self._over} if abs(factor - 1.0) > 1e-9 else {}
                settings |= {"accel_unit": setting + self._over} if setting else {}
                if settings or size != 1.0:
                    found = self.score(factor * np.eye(3), size * np.eye(3))
                    out.append(Named(settings if setting or size == 1.0 else {}, _means_units(settings, size), found))
        time = {"increment": self.dt}.get(self.kind, 1.0 / self.dt)
        word = "sample" if self.kind == "increment" else "increment"
        said = (
            "the rows are rates, not increments"
            if word == "sample"
            else f"the rows are increments of {self.dt:.4g} s, not rates"
        )
        out.append(Named({"kind": word}, said, self.score(time * np.eye(3), time * np.eye(3))))
        return out

    def _forces(self) -> list[tuple[str, float]]:
        """Units of the accelerometer that the size of the force allows, and what they multiply it with; "" for none that is known."""
        force = force_factor(self.windows)
        if not np.isfinite(force) or abs(np.log(force)) < KNOWN:
            return [("", 1.0)]
        units = units_of(force, self.units["accel"], (*ACCEL_UNITS, *_COUNTS))
        if (
            not units and abs(abs(np.log(force)) + np.log(self.dt)) < KNOWN
        ):  # increments for rates, or rates for increments
            return [("", 1.0)]
        return [(u, scaled_unit(u).factor / self._size("accel")) for u in units] or [("", force)]

    def _size(self, role: str) -> float:
        return scaled_unit(self.units[role]).factor

    def _orders(self, start: Named | None) -> list[Named]:
        """Readings with axes of one sensor in another order or turned round, in the declared units or in those of another reading."""
        gyro, accel = (start.found.reading.gyro, start.found.reading.accel) if start else (np.eye(3), np.eye(3))
        known = dict(start.settings) if start else {}
        out = []
        for text, matrix in _ORDERS.items():
            alone = [("gyro", matrix, np.eye(3)), ("accel", np.eye(3), matrix)] if text != _PLAIN else []
            for sensor, g, a in alone:
                out.append((known | {f"{sensor}_axes": text}, _means_order(sensor, text), g, a))
            if np.linalg.det(matrix) < 0.0:  # both: a common rotation makes the gyroscope's order plain or opposite
                means = f"{_means_order('gyro', _OPPOSITE)}, and {_means_order('accel', text)}"
                out.append((known | {"gyro_axes": _OPPOSITE, "accel_axes": text}, means, -np.eye(3), matrix))
        kept = _simplest(out)
        few = [self._few.explain(Reading(g @ gyro, a @ accel), 1) for _, _, g, a in kept]
        both = [f + self._with_turn(e).turned for f, e in zip((e.nats for e in few), few, strict=True)]
        first = [kept[k] for k in np.argsort(both)[::-1][:KEPT]]
        return [Named(settings, means, self.score(g @ gyro, a @ accel)) for settings, means, g, a in first]

    def _climbed(self, score: Callable[[float], Explained], start: float) -> tuple[float, Explained]:
        """The best shift or delay about a start, by steps that are halved where neither side is better; a second from the start at most."""
        at, best, step = start, score(start), SHIFT
        while step > SHIFT_STEP and abs(at - start) <= 1.0:
            further = max((at - step, at + step), key=lambda s: score(s).nats)
            if score(further).nats > best.nats:
                at, best = further, score(further)
            else:
                step *= 0.5
        return at, best

    def shift(self) -> Explained:
        """The best shift of the fixes near the declared clock or near what turns say."""
        eye = np.eye(3)
        tried = [self._climbed(lambda s: self.score(eye, eye, shift=s), start)[1] for start in {0.0, self.hint}]
        return max(self.declared, *tried, key=lambda e: e.nats)

    def _drift(self, shift: float) -> float:
        """How much more the last third of the windows wants the fixes shifted than the first, s; 0 where it is no more than a search tells."""
        eye, third = np.eye(3), max(1, self.windows.count // 3)
        grid = shift + DRIFT * np.arange(-4, 5)
        left = np.log1p(np.array([self.score(eye, eye, shift=float(s)).left for s in grid]) / self.windows.floor)
        first, last = (
            grid[int(np.argmin(left[:, part].sum(axis=1)))] for part in (slice(None, third), slice(-third, None))
        )
        return float(last - first) if abs(last - first) > 1.5 * DRIFT else 0.0

    def _shifts(self) -> list[Named]:
        best = self.shift()
        s = best.reading.shift
        if abs(s) < OFFSET:
            return []
        if (drift := self._drift(s)) != 0.0:
            return [
                Named(
                    {},
                    f"the clock of the fixes drifts against that of the IMU, by about {drift:+.1f} s over the record",
                    best,
                )
            ]
        leap = ", as many as the leap seconds of UTC" if abs(abs(s) - 18.0) < 0.6 else ""
        said = f"the fixes are {abs(s):.2f} s {'late' if s < 0 else 'early'} against the IMU{leap}"
        return [Named({"gnss_shift": f"{s:+.2f} s"}, said, best)]

    def _other_sides(self) -> list[Named]:
        """Readings with the fixes on the other side of Greenwich or the equator, where no velocities say on which they are: they move alike."""
        if self.velocities:
            return []
        found = self.score(np.eye(3), np.eye(3), east=-1.0)
        return [Named({"latlon": side}, means, found) for side, means in SIDES.items()]

    def _delayed(self, sensor: str, late: float) -> Explained:
        """Score with one sensor late; a late gyroscope is an early accelerometer and early fixes."""
        eye = np.eye(3)
        return self.score(eye, eye, lag=-late) if sensor == "accel" else self.score(eye, eye, lag=late, shift=late)

    def _delays(self) -> list[Named]:
        """Readings with one sensor late or early against the other one and the fixes."""
        out = []
        for sensor, name in SENSORS.items():
            score = partial(self._delayed, sensor)
            late, found = self._climbed(score, max(DELAYS, key=lambda d: score(d).nats))
            if abs(late) > LONGEST:
                continue
            said = f"the {name} comes {abs(late):.2f} s {'late' if late > 0 else 'early'}"
            out.append(Named({f"{sensor}_shift": f"{-late:+.2f} s"}, said, found))
        return out

    def _scales(self) -> list[Named]:
        """The factor of the rates that explains most, where it is no unit."""
        factor, step = 1.0, 2.0
        while step > SCALE_STEP:
            near = [factor / step, factor, factor * step]
            found = [self.score(f * np.eye(3), np.eye(3)) for f in near]
            k = int(np.argmax([e.nats for e in found]))
            factor, step = near[k], np.sqrt(step) if k == 1 else step
            if not 0.1 < factor < 10.0:
                return []
        said = f"the rates are multiplied by {factor:.3g}, a scale factor or another range of the sensor"
        return [Named({}, said, self.score(factor * np.eye(3), np.eye(3)))] if abs(np.log(factor)) > SCALE else []

    # ------------------------------------------------------------------------------------------------------------------- lines

    def lines(self) -> tuple[list[Line], bool]:
        """What is said, and whether the declared reading stands."""
        doubted = not self.fine(self.declared) or any(
            f.total - self.declared.total > PLAIN for f in self._simple().values()
        )
        best = self.best() if doubted else []
        w = self.windows
        fit = (
            f"the IMU predicts the velocities of the fixes to {self.declared.rms:.2g} m/s (median of {w.count} windows of "
            f"{w.length:.0f} s; {self.unrelated.rms:.2g} m/s for fixes of other windows)"
        )
        if best and self.explains(best[0].found):
            return [self._rival(best, fit)], False
        if not self.explains(self.declared):
            text = f"{fit}: gyroscope, accelerometer and fixes contradict each other, and no unit, order or sign that was tried makes them agree"
            return [Line("motion", "wrong", text), *self._part()], False
        if not self.moves(self.declared):
            text = f"not checkable: what the IMU says of the motion is no larger than the noise of the fixes ({fit})"
            return [Line("motion", "assumed", text)], True
        out = [
            Line("motion", "ok", f"gyroscope and specific force explain the motion of the fixes: {fit}"),
            *self._power(),
        ]
        return [*out, self._clock(), *self._part()], True

    def _part(self) -> list[Line]:
        """A part at the end or at the begin in which the fixes are not predicted, while they are in the rest."""
        left, n = self.declared.left, self.declared.left.size
        each, worst = (0.5 * np.log1p((x.left / self.windows.floor) ** 2) for x in (self.declared, self.unrelated))
        best: tuple[float, slice, slice, str] | None = None
        for k in range(FEWEST, n - FEWEST + 1):
            at = self.windows.start(k)
            first, last = slice(None, k), slice(k, None)
            for good, bad, when in ((first, last, f"from {at:.4g} s on"), (last, first, f"up to {at:.4g} s")):
                wrong = each[bad].mean() > max(WRONG_EACH, WRONG_SHARE * worst[bad].mean())
                gain = float(each[bad].mean() - each[good].mean())
                if wrong and each[good].mean() < 0.5 * WRONG_EACH and (best is None or gain > best[0]):
                    best = gain, good, bad, when
        if best is None:
            return []
        _, good, bad, when = best
        text = (
            f"{when} the IMU predicts the velocities of the fixes to {np.median(left[bad]):.2g} m/s, in the rest to "
            f"{np.median(left[good]):.2g} m/s: rows lost without stamps, a clock that jumped, or a mount that slipped"
        )
        return [Line("motion", "odd", text)]

    def _clock(self) -> Line:
        """Whether fixes and IMU share a clock: an antenna ahead of the IMU, which turns before it does, is allowed for."""
        best = self.shift()
        gain, shift = best.nats - self.declared.nats, best.reading.shift
        eye = np.eye(3)
        worst = min(best.nats - self.score(eye, eye, shift=shift + s).nats for s in (-0.5, 0.5))
        if gain > NATS and worst > NATS and abs(shift) >= OFFSET:
            (named,) = self._shifts()
            return Line("clock", "odd", f"{named.means} ({gain:.0f} nats)", named.command)
        if worst > NATS:
            return Line(
                "clock",
                "ok",
                f"IMU and fixes share one clock (best offset {shift:+.2f} s, half a second would cost {worst:.0f} nats)",
            )
        return Line("clock", "assumed", "not checkable: too little motion to see half a second between IMU and fixes")

    def fine(self, found: Explained) -> bool:
        """Whether a reading leaves no more than the noise of the fixes."""
        return bool(-found.nats / found.count < 0.5 * WRONG_EACH)

    def _rival(self, best: list[Named], fit: str) -> Line:
        means = [n.means for n in best]
        what = means[0] if len(best) == 1 else "one of these, which nothing here distinguishes: " + "; or ".join(means)
        plain = best[0].found.total - self.declared.total > PLAIN and "gnss_shift" not in best[0].settings
        level: Level = "wrong" if plain or not self.explains(self.declared) else "odd"
        text = f"{fit}, and to {best[0].found.rms:.2g} m/s if {what}"
        return Line("motion", level, text, best[0].command if len(best) == 1 else "")

    def _simple(self) -> dict[str, Explained]:
        """The plainest other readings."""
        eye = np.eye(3)
        return {
            "gyroscope opposite": self.score(-eye, eye),
            "gyroscope x and y swapped": self.score(_ORDERS["y x z"], eye),
            "gyroscope x and z swapped": self.score(_ORDERS["z y x"], eye),
            "accelerometer opposite": self.score(eye, -eye),
            "accelerometer x opposite": self.score(eye, _ORDERS["-x y z"]),
            "accelerometer y opposite": self.score(eye, _ORDERS["x -y z"]),
            **{
                f"{name} 0.3 s {word}": self._delayed(sensor, late)
                for sensor, name in SENSORS.items()
                for word, late in (("late", 0.3), ("early", -0.3))
            },
        }

    def _power(self) -> list[Line]:
        """What would have been seen, and what would not."""
        tried = self._simple()
        seen = [name for name, found in tried.items() if better(self.declared, found)]
        out = [Line("order", "ok", f"would have been seen: {', '.join(seen)}")] if seen else []
        hidden = [name for name in tried if name not in seen]
        if hidden:
            out.append(Line("order", "assumed", f"not checkable in this motion: {', '.join(hidden)}"))
        return out


def _simplest(orders: list[_Order]) -> list[_Order]:
    """Of orders that differ by a common rotation alone, the one with the fewest settings and the fewest changes."""
    out: dict[bytes, _Order] = {}
    for order in orders:
        _, _, gyro, accel = order
        key = np.append(np.round(gyro.T @ accel) + 0.0, np.sign(np.linalg.det(gyro))).tobytes()
        if key not in out or _effort(order) < _effort(out[key]):
            out[key] = order
    return [o for o in out.values() if not (np.linalg.det(o[2]) > 0.0 and np.allclose(o[2].T @ o[3], np.eye(3)))]


def _effort(order: _Order) -> tuple[int, int]:
    text = " ".join(v for k, v in order[0].items() if k.endswith("_axes"))
    return len(order[0]), sum(a != b for a, b in zip(text.split(), _PLAIN.split() * 2, strict=False)) + text.count("-")


def _means_units(settings: Mapping[str, str], size: float) -> str:
    names = {"gyro_unit": "the rates", "accel_unit": "the forces"}
    parts = [f"{names[k]} are in {v}" for k, v in settings.items()]
    if size != 1.0 and "accel_unit" not in settings:
        parts.append(f"the forces are multiplied by {size:.4g}, which is no unit")
    return " and ".join(parts)


def _means_order(sensor: str, text: str) -> str:
    name = SENSORS[sensor]
    if text == _OPPOSITE:
        return f"the {name} has the opposite sign on all axes"
    return f"x, y and z of the {name} are its columns {text}"
