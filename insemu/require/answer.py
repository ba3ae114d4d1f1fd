"""The answer: which sensors keep the requirements, by how much, what limits them, and what would just do."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu import rotation, yamlfile
from insemu.errors import InputError
from insemu.evaluate import Experiment, input_files, run_experiment
from insemu.filters import AidUse
from insemu.require.asked import QUANTITIES, Requirement, asked
from insemu.require.sensors import FIGURES, Sensor, completed, shown
from insemu.require.track import LONGEST, aids_of, kept, prepared
from insemu.scenario import Scenario, Spoken, Wish, first_scenario, motion_of, validated
from insemu.sensors import card, names
from insemu.units import parse

Array = NDArray[np.float64]
Aids = Mapping[str, AidUse | None]

#: Share of the units of a type that has to keep the requirements where a card is said to meet them, and to miss them where it is not.
SURE = 0.9
#: Units that are drawn of each card, and the seed of the draws.
UNITS_DRAWN, SEED = 4000, 1
#: Attitude errors beyond which first-order errors are doubtful, rad (1 sigma, 10 deg).
DOUBTFUL = math.radians(10.0)
#: Values that are tried of a figure: from this share of the smallest of all cards to this multiple of the largest, in so many steps.
GRID_FROM, GRID_TO, GRID = 0.1, 10.0, 10
#: Frontier of two figures at a time, so many points of each, evenly along the quarter of an ellipse that it would be if variances added up.
PLANES = (("gyro in-run bias", "accel in-run bias"), ("gyro white noise", "accel white noise"))
PLANE = 8
_ANGLES = np.linspace(0.05, 0.49 * math.pi, PLANE)
#: Where a figure is printed by no card: values of good and of bad sensors, SI.
UNPRINTED = {
    "gyro walk": (1e-9, 1e-5),
    "accel walk": (1e-7, 1e-3),
    "gyro scale factor": (1e-5, 1e-2),
    "accel scale factor": (1e-5, 1e-2),
    "gyro turn-on bias": (1e-6, 0.1),
    "accel turn-on bias": (1e-4, 1.0),
}
#: Time between two outages of the scenario that flies the answer, in which the filter settles again, s.
AGAIN = 60.0
#: Levels that `insemu transfer` has factors for, and the figures they act on.
ROAD = {"white": ("white noise",), "slow": ("in-run bias", "walk"), "turn-on": ("turn-on bias",)}


@dataclass(frozen=True)
class Verdict:
    """What is said of one sensor.

    Parameters
    ----------
    sensor : Sensor
    errors : tuple of float
        That its typical unit keeps, one per requirement, SI.
    probability : float
        Share of its units that keep all requirements.
    margin : float
        Limit over error, the smallest of all requirements; below 1 the typical unit misses one.
    limits : str
        The figure whose halving brings most; empty where none brings anything.
    halved : float
        Margin with that figure halved.
    doubt : str
        Why the linear answer is doubtful; empty where it is not.
    flown : int
        Flights of the full filter that the errors come from; 0: the linear answer.
    """

    sensor: Sensor
    errors: tuple[float, ...]
    probability: float
    margin: float
    limits: str
    halved: float
    doubt: str
    flown: int = 0

    @property
    def word(self) -> str:
        """Meets, may meet or misses; doubtful where the linear answer is and no flight stands for it."""
        if self.doubt and not self.flown:
            return "doubtful"
        return "meets" if self.probability >= SURE else "misses" if self.probability <= 1.0 - SURE else "may meet"


@dataclass(frozen=True)
class Alternative:
    """The sensors with an aid, or without any.

    Parameters
    ----------
    name : str
        Aids, or ``none``.
    margins : mapping of str to float
        Limit over error of every sensor's typical unit.
    like : str
        The sensor that comes nearest, without aids, to what the least of all sensors reaches with them; empty for ``none``.
    """

    name: str
    margins: Mapping[str, float]
    like: str

    @property
    def meeting(self) -> list[str]:
        """Sensors whose typical unit keeps the requirements, the least first."""
        return sorted((n for n, m in self.margins.items() if m >= 1.0), key=lambda n: self.margins[n])


@dataclass(frozen=True)
class Place:
    """One outage of the track: its start and motion, and the errors of the answer's typical unit.

    Parameters
    ----------
    start, speed, turned, stands : float
        s, mean speed in m/s, change of heading in rad added up without sign, share of the time at rest.
    errors : tuple of float
        One per requirement, SI.
    """

    start: float
    speed: float
    turned: float
    stands: float
    errors: tuple[float, ...]


@dataclass(frozen=True)
class Answer:
    """Which IMU keeps some requirements on a track.

    Parameters
    ----------
    requirements : tuple of Requirement
    verdicts : tuple of Verdict
        All sensors, the largest margin first.
    alone : mapping of str to float
        Largest value of each figure that keeps the requirements where all others are zero, SI; infinite where no value that was tried misses.
    just : mapping of str to float
        Figures that just keep them together: the former times one factor.
    planes : mapping of (str, str) to (n, 2) array
        Frontier of two figures, the others as in ``just``.
    alternatives : tuple of Alternative
    places : tuple of Place
    road : mapping of str to float
        Factors between bench and vehicle that were used.
    scenario : str
        Text of the scenario that flies the answer.
    have : str
        Name of the user's own sensor.
    """

    requirements: tuple[Requirement, ...]
    verdicts: tuple[Verdict, ...]
    alone: Mapping[str, float]
    just: Mapping[str, float]
    planes: Mapping[tuple[str, str], Array]
    alternatives: tuple[Alternative, ...]
    places: tuple[Place, ...]
    road: Mapping[str, float]
    scenario: str
    have: str = ""

    def __getitem__(self, name: str) -> Verdict:
        """The verdict on a sensor."""
        found = next((v for v in self.verdicts if v.sensor.name == name), None)
        if found is None:
            raise InputError(f"no sensor '{name}', expected one of: {', '.join(v.sensor.name for v in self.verdicts)}")
        return found

    @property
    def chosen(self) -> Verdict:
        """The sensor that is flown: one's own, else the least of those that meet the requirements, else that of the largest margin."""
        decided = [v for v in self.verdicts if v.word != "doubtful"] or self.verdicts
        meeting = [v for v in decided if v.word == "meets"]
        return self[self.have] if self.have else min(meeting, key=lambda v: v.margin) if meeting else decided[0]

    @property
    def text(self) -> str:
        """The one sentence."""
        asked_for = " and ".join(r.text for r in self.requirements)
        decided = [v for v in self.verdicts if v.word != "doubtful"] or self.verdicts
        meeting = [v for v in decided if v.word == "meets"]
        if not meeting:
            best = decided[0]
            what = f"the best, {best.sensor.name}, errs {1.0 / best.margin:.3g} times as much as allowed"
            aided = next((a for a in self.alternatives[1:] if a.meeting), None)
            change = (
                f"{aided.name} would change it ({aided.meeting[0]} meets it then)" if aided
                else f"half its {best.limits} would allow {best.halved / best.margin:.2g} times less" if best.limits
                else "better fixes would change it"
            )  # fmt: skip
            return f"No card meets {asked_for}: {what}; {change}."
        least = min(meeting, key=lambda v: v.margin)
        if len(meeting) == len(decided):
            longer = min(self.requirements, key=lambda r: r.seconds)
            return (
                f"Every card meets {asked_for}, {least.sensor.name} with the least margin ({least.margin:.3g}): a limit {least.margin:.3g} times "
                f"smaller or an outage longer than {longer.seconds:g} s would distinguish them."
            )
        return f"{len(meeting)} of {len(self.verdicts)} cards meet {asked_for}; the least of them is {least.sensor.name} (margin {least.margin:.3g})."

    def __str__(self) -> str:
        rows = [f"{v.sensor.name:14} {v.word:9} {v.probability:4.0%} margin {v.margin:.3g}" for v in self.verdicts[:8]]
        return "\n".join([self.text, *rows])

    def to_json(self) -> dict[str, Any]:
        """As plain data, SI."""
        return {
            "answer": self.text,
            "requirements": [vars(r) | {"text": r.text} for r in self.requirements],
            "cards": [
                {
                    "name": v.sensor.name, "about": v.sensor.about, "verdict": v.word,
                    "flown": v.flown, "probability": v.probability, "margin": v.margin,
                    "errors": list(v.errors), "assumed": list(v.sensor.assumed), "limited_by": v.limits, "margin_if_halved": v.halved,
                    "doubt": v.doubt,
                    "figures": dict(zip(FIGURES, v.sensor.values.tolist(), strict=True)),
                }
                for v in self.verdicts
            ],
            "alone": {k: v if math.isfinite(v) else None for k, v in self.alone.items()},
            "just": {k: v if math.isfinite(v) else None for k, v in self.just.items()},
            "frontier": [{"x": x, "y": y, "points": curve.tolist()} for (x, y), curve in self.planes.items()],
            "aids": [{"aids": a.name, "meeting": a.meeting, "like": a.like, "margins": dict(a.margins)} for a in self.alternatives],
            "track": [vars(p) | {"errors": list(p.errors)} for p in self.places],
            "bench_to_road": dict(self.road),
            "chosen": self.chosen.sensor.name,
        }  # fmt: skip


class Question:
    """Requirements on a track, for any sensors and aids.

    Parameters
    ----------
    requirements : sequence of str or Requirement
    wish : Wish
        Track, vehicle and fixes.
    file : path
        Where the scenario that flies the answer will stand.

    Raises
    ------
    InputError
        A requirement or a track that cannot be read or flown.
    """

    def __init__(self, requirements: Sequence[str | Requirement], wish: Wish, file: str | Path) -> None:
        self.requirements = asked(requirements)
        self.file = Path(file)
        wish = replace(wish, longest=min(wish.longest, LONGEST))
        self.wish = replace(wish, motion=motion_of(self.file.parent, wish))
        document = yamlfile.parse(first_scenario(self.file, self.wish), str(self.file))
        scenario = validated(Scenario, document)
        self.track, self._key = prepared(scenario, self.file, input_files(scenario, self.file))
        self.seconds = sorted({r.seconds for r in self.requirements})

    def errors(self, sensors: Sequence[Sensor], aids: Aids | None = None) -> tuple[Array, Array, Array]:
        """Errors of sensors (requirements, sensors) in SI, covariances (sensors, lengths, starts, 9, 9) and largest attitude errors behind them."""
        measured = {name: use and use.to_mapping() for name, use in (aids or {}).items()}
        parts = (self._key, self.seconds, measured, [(s.values.tolist(), s.times) for s in sensors])

        def made() -> dict[str, Array]:
            return dict(zip(("C", "attitude"), self.track.covariances(sensors, self.seconds, aids), strict=True))

        found = kept("covariances", parts, made)
        C = found["C"]
        return np.stack([r.error(C[:, self.seconds.index(r.seconds)]) for r in self.requirements]), C, found["attitude"]

    def ratios(self, sensors: Sequence[Sensor], aids: Aids | None = None) -> Array:
        """Error over limit, the largest of all requirements, (sensors,)."""
        return np.asarray((self.errors(sensors, aids)[0] / self.limits[:, None]).max(axis=0))

    @property
    def limits(self) -> Array:
        """Of the requirements, SI."""
        return np.array([r.limit for r in self.requirements])

    def check(self, aids: Aids) -> None:
        """Raise ``InputError`` where not even a perfect sensor keeps the requirements: what is left then comes from the fixes."""
        (errors,) = self.errors([Sensor("perfect", np.zeros(len(FIGURES)), np.zeros(len(FIGURES)))], aids)[0].T
        for r, error in zip(self.requirements, errors, strict=True):
            if error > r.limit:
                raise InputError(
                    f"no inertial sensor keeps '{r.text}' here: without any error of its own it errs {r.shown(error)}, from the fixes and the start "
                    f"of the filter; expected a larger limit, better fixes (--fixes) or an aid (--aids)"
                )


def require(
    requirements: Sequence[str | Requirement],
    wish: Wish,
    file: str | Path,
    *,
    aids: str = "",
    have: str = "",
    road: str | Path = "",
    realizations: int = 0,
) -> Answer:
    """Which sensor cards keep some requirements on a track, and what would just do.

    Every sensor flies with the filter that knows its figures, to first order (Gelb 1974, chapter 7): its covariance is carried along the track
    and through outages that begin at several places.

    Parameters
    ----------
    requirements : sequence of str or Requirement
        ``planimetric < 1 m at 95 % after 30 s``; all have to hold.
    wish : Wish
        Track, vehicle and fixes.
    file : path
        Where the scenario that flies the answer will stand; nothing is written.
    aids : str
        Alternatives: ``odometer=0.05 m/s, heading=0.5 deg``, each alone and all together.
    have : str
        One's own sensor: a card's name or file.
    road : path
        What ``insemu transfer --json`` printed: factors between bench and vehicle, which are put on the figures of all cards.
    realizations : int
        Flights of the full filter for every sensor of which the linear answer is doubtful; 0: none.

    Raises
    ------
    InputError
        What cannot be read, what contradicts itself, and what no sensor can keep.
    """
    question = Question(requirements, wish, file)
    used = aids_of(aids)
    question.check(used)
    factors = _road(road) if road else {}
    own = Sensor.of_card(card(have)) if have else None
    sensors = [Sensor.of_card(card(name)) for name in names()]
    sensors += [own] if own is not None and own.name not in {s.name for s in sensors} else []
    sensors = [_on_the_road(s, factors) for s in completed(sensors)]
    verdicts, C = _verdicts(question, sensors)
    verdicts = [_flown(question, v, realizations) if v.doubt and realizations else v for v in verdicts]
    alone, just, planes = _frontier(question, sensors)
    alternatives = _alternatives(question, sensors, used)
    found = Answer(
        question.requirements, tuple(sorted(verdicts, key=lambda v: -v.margin)), alone, just, planes, alternatives, (),
        {k: v for k, (v, _) in factors.items()}, "", own.name if own else "",
    )  # fmt: skip
    chosen = next(i for i, s in enumerate(sensors) if s is found.chosen.sensor)
    return replace(found, places=_places(question, C[chosen]), scenario=scenario_of(question, sensors[chosen]))


def wish_of(track: str = "", vehicle: str = "car", fixes: str = "") -> Wish:
    """What is flown.

    Parameters
    ----------
    track, vehicle : str
        See :class:`~insemu.scenario.Wish`.
    fixes : str
        Standard deviations such as ``2 cm, 3 cm/s``: horizontal position and velocity; twice as much down.

    Raises
    ------
    InputError
        Fixes that cannot be read or are not positive.
    """
    wish = Wish(track=track, vehicle=vehicle)
    if not fixes:
        return wish
    position, _, velocity = (part.strip() for part in fixes.partition(","))
    if not velocity:
        raise InputError(
            f"found '{fixes}', expected standard deviations of position and velocity such as '2 cm, 3 cm/s'",
            where="--fixes",
        )
    sigma = parse(position, "m"), parse(velocity, "m/s")
    if min(sigma) <= 0.0:
        raise InputError(f"found '{fixes}', expected positive standard deviations", where="--fixes")
    spelled = [f"{s:.12g} {u}, {s:.12g} {u}, {2 * s:.12g} {u}" for s, u in zip(sigma, ("m", "m/s"), strict=True)]
    return replace(wish, position=spelled[0], velocity=spelled[1])


def _verdicts(question: Question, sensors: Sequence[Sensor]) -> tuple[list[Verdict], Array]:
    """One verdict per sensor: errors go with each figure as a power between its value and half of it."""
    halves = [(i, f) for i, s in enumerate(sensors) for f in np.flatnonzero(s.values).tolist()]
    errors, C, attitude = question.errors([*sensors, *(sensors[i].times_factor(f, 0.5) for i, f in halves)])
    power = np.zeros((len(question.requirements), len(sensors), len(FIGURES)))
    halved = np.full((len(sensors), len(FIGURES)), -np.inf)
    limits = question.limits[:, None]
    for k, (i, f) in enumerate(halves):
        power[:, i, f] = np.log2(errors[:, i] / errors[:, len(sensors) + k])
        halved[i, f] = (limits[:, 0] / errors[:, len(sensors) + k]).min()
    z = np.random.default_rng(SEED).standard_normal((UNITS_DRAWN, len(FIGURES)))
    out = []
    for i, s in enumerate(sensors):
        units = np.log(errors[:, i]) + (z * s.spread) @ power[:, i].T
        f = int(halved[i].argmax())
        margin = float((limits[:, 0] / errors[:, i]).min())
        better = bool(halved[i, f] > margin)
        out.append(
            Verdict(
                s, tuple(errors[:, i].tolist()), float((units <= np.log(limits[:, 0])).all(axis=1).mean()), margin, FIGURES[f] if better else "",
                float(halved[i, f]) if better else margin,
                f"on the way the attitude is known to {math.degrees(attitude[i]):.0f} deg only" if attitude[i] > DOUBTFUL else "",
            )
        )  # fmt: skip
    return out, C[: len(sensors)]


def flights(question: Question, sensor: Sensor, realizations: int, seed: int = SEED) -> Array:
    """Navigation errors (realizations, outages, 9) of the full filter at the ends of the outages of :func:`scenario_of`.

    Parameters
    ----------
    question : Question
    sensor : Sensor
    realizations, seed : int
        Of the flights.
    """
    scenario = validated(Scenario, yamlfile.parse(scenario_of(question, sensor), str(question.file)))
    scenario = scenario.model_copy(update={"designs": {"complete": scenario.designs["complete"]}, "seed": seed})
    results = run_experiment(Experiment(scenario, question.file), realizations=realizations)
    errors: Array = np.asarray(results.total.runs["end_error"])[0]
    return errors


def _flown(question: Question, verdict: Verdict, realizations: int) -> Verdict:
    """A verdict with the errors of the full filter in place of the linear ones; units differ by the same factors.

    All outages of a flight are as long as the longest that is asked for, so that only requirements of that length are judged by flights.
    """
    errors = list(verdict.errors)
    ends = flights(question, verdict.sensor, realizations)
    for k, r in enumerate(question.requirements):
        if r.seconds == max(question.seconds):
            sizes = np.linalg.norm(ends[..., list(QUANTITIES[r.quantity][0])], axis=-1)
            errors[k] = float(np.quantile(sizes, r.share))
    margin = float(min(r.limit / e for r, e in zip(question.requirements, errors, strict=True)))
    spread = max(float(np.linalg.norm(verdict.sensor.spread)), 1e-12)
    within = float(scipy.special.ndtr(math.log(margin) / spread))
    return replace(
        verdict, errors=tuple(errors), margin=margin, probability=within, limits="", halved=margin, flown=realizations
    )


def _crossing(x: Array, ratio: Array) -> float:
    """Where a ratio (n,) that grows with x passes one, on logarithmic scales; infinite where it stays below, zero where it never is."""
    above = np.flatnonzero(ratio > 1.0)
    if not above.size:
        return math.inf
    k = int(above[0])
    if k == 0:
        return 0.0
    share = -np.log(ratio[k - 1]) / np.log(ratio[k] / ratio[k - 1])
    return float(x[k - 1] * (x[k] / x[k - 1]) ** share)


def _frontier(
    question: Question, sensors: Sequence[Sensor]
) -> tuple[dict[str, float], dict[str, float], dict[tuple[str, str], Array]]:
    """Figures that keep the requirements alone, that just keep them together, and curves of two of them."""
    values = np.stack([s.values for s in sensors])
    nothing = Sensor("", np.zeros(len(FIGURES)), np.zeros(len(FIGURES)))

    def grid(f: int, count: int) -> Array:
        known = values[:, f][values[:, f] > 0]
        low, high = (known.min(), known.max()) if known.size else UNPRINTED[FIGURES[f]]
        return np.geomspace(GRID_FROM * low, GRID_TO * high, count)

    def with_values(*given: tuple[int, float], of: Array = nothing.values) -> Sensor:
        changed = of.copy()
        for f, value in given:
            changed[f] = value
        return replace(nothing, values=changed)

    grids = [grid(f, GRID) for f in range(len(FIGURES))]
    ratio = question.ratios([with_values((f, v)) for f in range(len(FIGURES)) for v in grids[f]]).reshape(-1, GRID)
    alone = np.array([_crossing(x, r) for x, r in zip(grids, ratio, strict=True)])
    finite = np.where(np.isfinite(alone), alone, 0.0)
    shares = np.geomspace(0.02, 1.0, GRID)
    share = min(_crossing(shares, question.ratios([replace(nothing, values=s * finite) for s in shares])), 1.0)
    just = np.where(np.isfinite(alone), share * finite, math.inf)
    planes = {}
    for pair in PLANES:
        i, j = (FIGURES.index(name) for name in pair)
        ends = []  # of the frontier on both axes, the other figure zero
        for f, other in ((i, j), (j, i)):
            ratio = question.ratios([with_values((f, v), (other, 0.0), of=share * finite) for v in grids[f]])
            ends.append(min(_crossing(grids[f], ratio), float(grids[f][-1])))
        x, y = ends[0] * np.sin(_ANGLES), ends[1] * np.append(0.5 * np.cos(_ANGLES[-1]), np.cos(_ANGLES)[::-1])
        y = np.append(y, 1.5 * ends[1])
        tried = question.ratios([with_values((i, a), (j, b), of=share * finite) for a in x for b in y])
        curve = np.array([[a, _crossing(y, row)] for a, row in zip(x, tried.reshape(x.size, y.size), strict=True)])
        planes[pair] = curve[np.isfinite(curve[:, 1]) & (curve[:, 1] > 0.0)]
    return dict(zip(FIGURES, alone.tolist(), strict=True)), dict(zip(FIGURES, just.tolist(), strict=True)), planes


def _alternatives(question: Question, sensors: Sequence[Sensor], aids: Aids) -> tuple[Alternative, ...]:
    """All sensors without aids, with each and with all."""
    sets: dict[str, Aids] = {"none": {}} | {name: {name: use} for name, use in aids.items()}
    if len(aids) > 1:
        sets[" and ".join(aids)] = aids
    plain, out = question.ratios(sensors), []
    for name, used in sets.items():
        ratio = question.ratios(sensors, used) if used else plain
        nearest = int(np.abs(np.log(plain / ratio.max())).argmin())
        out.append(
            Alternative(
                name,
                {s.name: float(1.0 / r) for s, r in zip(sensors, ratio, strict=True)},
                sensors[nearest].name if used else "",
            )
        )
    return tuple(out)


def _places(question: Question, C: Array) -> tuple[Place, ...]:
    """What the chosen sensor errs at each place of the track, beside the motion there."""
    track, longest = question.track, max(question.seconds)
    out = []
    for k, node in enumerate(track.starts(longest)):
        inside = slice(int(node), int(np.searchsorted(track.t, track.t[node] + longest)) + 1)
        speed = np.linalg.norm(track.motion[inside, 3:5], axis=1)
        heading = np.unwrap(rotation.rpy_from_quaternion(track.motion[inside, 6:10])[:, 2])
        errors = [float(r.error(C[question.seconds.index(r.seconds), k : k + 1])) for r in question.requirements]
        out.append(
            Place(
                float(track.t[node]),
                float(speed.mean()),
                float(np.abs(np.diff(heading)).sum()),
                float((speed < 0.1).mean()),
                tuple(errors),
            )
        )
    return tuple(out)


def scenario_of(question: Question, sensor: Sensor) -> str:
    """Text of the scenario that flies a sensor through outages at these places, as many as leave the filter time to settle between them."""
    track, longest = question.track, max(question.seconds)
    outages: list[tuple[float, float]] = []
    for start in track.t[track.starts(longest)]:
        if not outages or start >= sum(outages[-1]) + AGAIN:
            outages.append((float(start), longest))
    said = [r.text for r in question.requirements] + [f"assumed: {name}" for name in sensor.assumed]
    spoken = Spoken(sensor.name, sensor.models(), said)
    return first_scenario(question.file, replace(question.wish, spoken=spoken, outages=outages))


def _road(file: str | Path) -> dict[str, tuple[float, float]]:
    """Factors between bench and vehicle on the figures, with the standard deviation of their logarithms; levels that the drive tells alone."""
    try:
        document = json.loads(Path(file).read_text(encoding="utf-8"))
        known = {
            str(f["name"]): (float(f["value"]), math.log(f["high"] / f["low"]) / 3.92)
            for f in document["factors"]
            if f["told"]
        }
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"holds no factors ({error}), expected what 'insemu transfer --json' prints", where=str(file)
        ) from None
    out: dict[str, tuple[float, float]] = {}
    for name, factor in known.items():
        triad, _, level = name.partition(" ")
        out |= {f"{triad} {kind}": factor for kind in ROAD.get(level, ()) if f"{triad} {kind}" in FIGURES}
    if not out:
        raise InputError(
            "tells no factor of gyroscopes or accelerometers, expected one whose interval is narrow", where=str(file)
        )
    return out


def _on_the_road(sensor: Sensor, factors: Mapping[str, tuple[float, float]]) -> Sensor:
    """A sensor with factors on its figures."""
    factor, more = (np.array([factors.get(name, (1.0, 0.0))[k] for name in FIGURES]) for k in (0, 1))
    return replace(sensor, values=sensor.values * factor, spread=np.hypot(sensor.spread, more))


def figures_text(values: Mapping[str, float]) -> dict[str, str]:
    """Figures in the units of datasheets."""
    return {
        name: shown(FIGURES.index(name), v) if math.isfinite(v) else "any that was tried" for name, v in values.items()
    }
