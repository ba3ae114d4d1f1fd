"""The next experiment: which manoeuvre would tell the members of a class apart, and how surely, before it is driven.

Each member of the class is taken for the truth in turn, at the size at which it explains the measured recording. Along a manoeuvre the nominal
filter runs once; the noise is drawn again 300 times and every member is weighed on the result as it is on a recording. The promise of a manoeuvre
is, pair by pair, the share of repetitions in which the truth leads the other member by the nats that make a name. Some pairs no manoeuvre of a
vehicle parts, which is said. That the promise is kept is shown with the emulator, which knows nothing of signatures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from insemu import earth
from insemu.effects import AID_KINDS, EFFECTS, EffectUse
from insemu.emulate import VEHICLES, Mounting, Waypoints, corrupt, gnss_fixes, ideal_imu, route
from insemu.errors import InputError
from insemu.gap.beliefs.nominal import Nominal
from insemu.gap.beliefs.refined import plain, refined_nominal, uses_of
from insemu.gap.candidates.shapes import (
    PROCESSES,
    DriveHypothesis,
    Variant,
    bank,
    linear_evidence,
    linear_hypotheses,
    pooled_evidence,
)
from insemu.gap.confusion import Repetitions
from insemu.gap.data.sources import StaticLog
from insemu.gap.drive.preparation import Flown
from insemu.gap.drive.scene import Scene
from insemu.gap.drive.signatures import Loop
from insemu.gap.evidence.linear import flicker_root, gauss_markov_root, random_walk_root
from insemu.gap.policy import rules
from insemu.gap.problems.findings import with_process
from insemu.gap.problems.known_effects import drive_without, in_imu_axes
from insemu.gap.session import with_only
from insemu.gap.verdict import Finding, GapReport
from insemu.noise import NoiseModel, axis_unit
from insemu.records import Recording
from insemu.whole import put

Array = NDArray[np.float64]
Key = tuple[str, ...]
Pair = tuple[Key, Key]
Say = Callable[[str], None]

#: Time that a primitive takes, s, and the share of repetitions at which no longer experiment is looked for.
PRIMITIVE_S, ENOUGH = 150.0, 0.9
#: Sampling rate at which manoeuvres are emulated, Hz: their motion is slow.
RATE_HZ = 50.0


@dataclass(frozen=True)
class Manoeuvre:
    """Something to drive or fly: its name and its waypoints."""

    name: str
    waypoints: Waypoints
    vehicle: str


@dataclass(frozen=True)
class Promise:
    """What a manoeuvre would tell.

    Parameters
    ----------
    manoeuvre : Manoeuvre
    duration_s : float
    distinguished : mapping of (truth, other) to float
        Share of repetitions in which the truth, an effect and its sensor, is distinguished from another member of the class.
    leads : mapping of (truth, other) to float
        Its mean lead, nats.
    """

    manoeuvre: Manoeuvre
    duration_s: float
    distinguished: Mapping[Pair, float]
    leads: Mapping[Pair, float]

    @property
    def share(self) -> float:
        """Mean over the pairs."""
        return sum(self.distinguished.values()) / len(self.distinguished)

    @property
    def lead(self) -> float:
        """Mean over the pairs, nats."""
        return sum(self.leads.values()) / len(self.leads)


@dataclass(frozen=True)
class NextExperiment:
    """The experiment that would settle a finding.

    Parameters
    ----------
    finding : Finding
        The class.
    now : Promise
        What a repetition of the recording itself would tell.
    best : Promise
    tried : tuple of Promise
        Best first.
    truths : mapping of (effect, sensor), with the axes where a class has an effect twice, to Finding
        Each member as it would be, were it the truth.
    kept : mapping of (truth, other) to (int, int)
        Emulated recordings in which the truth was distinguished from the other, and how many there were.
    nominal : Nominal
        What is believed of the sensor, everything but the class taken off.
    fixes : Fixes
    """

    finding: Finding
    now: Promise
    best: Promise
    tried: tuple[Promise, ...]
    truths: Mapping[Key, Finding]
    kept: Mapping[Pair, tuple[int, int]]
    nominal: Nominal
    fixes: Fixes


@dataclass(frozen=True)
class Fixes:
    """How the receiver of the measured recording was: rate in Hz, standard deviations (3,) in m and m/s."""

    rate_hz: float
    sigma: Array
    sigma_v: Array | None

    @classmethod
    def of(cls, flown: Flown) -> Fixes:
        """As the fixes state, at the level that the nominal filter settled on."""
        gnss, factors = flown.prepared.gnss, flown.prepared.factors
        assert gnss.pos_std_ned is not None
        sigma_v = None if gnss.vel_std_ned is None else np.nanmedian(gnss.vel_std_ned, axis=0) * factors[3:]
        rate = min(1.0 / float(np.median(np.diff(gnss.t))), 0.2 * RATE_HZ)
        return cls(rate, np.nanmedian(gnss.pos_std_ned, axis=0) * factors[:3], sigma_v)


# -- things to drive ----------------------------------------------------------------------------------------------------------------


def primitives(origin: Array, vehicle: str) -> list[Manoeuvre]:
    """What a vehicle can do in some minutes: figures of eight, blocks, straight at speed, changes of speed, stops, hills.

    Parameters
    ----------
    origin : (3,) array
        Latitude, longitude (rad) and height (m) of the start.
    vehicle : str
        Key of :data:`insemu.emulate.VEHICLES`.
    """
    v = VEHICLES[vehicle]
    slow = min(max(8.0, 1.5 * v.min_speed), 0.5 * v.max_speed)
    fast = min(20.0 if v.min_speed == 0.0 else 2.5 * v.min_speed, 0.8 * v.max_speed)
    radius = max(40.0, slow**2 / (0.25 * v.max_lateral), 3.0 * slow)
    around = np.arange(0.0, 2.0 * math.pi, math.radians(30.0))[1:]
    right = [(radius * math.sin(a), radius * (1.0 - math.cos(a)), 0.0) for a in around]
    left = [(n, -e, 0.0) for n, e, _ in right]
    eight = [(0.0, 0.0, 0.0), *right, (0.0, 0.0, 0.0), *left]
    laps = max(1, round(PRIMITIVE_S * slow / (4.0 * math.pi * radius)))
    side = max(100.0, 4.0 * radius)
    block = [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side)]
    turns = max(1, round(PRIMITIVE_S * slow / (8.0 * side)))
    blocks = [*block * turns, *[(n, -e) for n, e in block] * turns]
    reach = fast * PRIMITIVE_S
    legs = max(2, round(reach / 600.0))
    uneven = np.linspace(0.0, 0.6 * reach, 2 * legs + 1)
    hill = 0.07 * uneven[1]
    out: dict[str, tuple[Sequence[Sequence[float]], float | Array]] = {
        "figures of eight": ([p for _ in range(laps) for p in eight], slow),
        "blocks, right and left": ([(n, e, 0.0) for n, e in blocks], slow),
        "straight at speed": ([(0.0, 0.0, 0.0), (reach, 0.0, 0.0)], fast),
        "straight, changing speed": ([(n, 0.0, 0.0) for n in uneven], np.tile([slow, fast], legs + 1)[: uneven.size]),
        "up and down hill": ([(n, 0.0, hill * (k % 2)) for k, n in enumerate(uneven)], 0.6 * fast),
    }
    if v.min_speed == 0.0:  # three metres in half a minute are a stop to an IMU
        stops = np.concatenate([[k * 203.0, k * 203.0 + 200.0] for k in range(3)])
        out["stops of 30 s"] = ([(n, 0.0, 0.0) for n in stops], np.tile([slow, 0.1], 3))
    return [
        Manoeuvre(
            name, Waypoints(_placed(origin, places), np.broadcast_to(np.asarray(speed), len(places)), name), vehicle
        )
        for name, (places, speed) in out.items()
    ]


def _placed(origin: Array, places: Sequence[Sequence[float]]) -> Array:
    """Places (north, east, up in m) on the Earth."""
    ned = np.array(places, dtype=float) * [1.0, 1.0, -1.0]
    return earth.move(np.broadcast_to(origin, ned.shape), ned)


def joined_up(first: Manoeuvre, then: Manoeuvre) -> Manoeuvre:
    """One manoeuvre after the other, the second beginning so far on that a vehicle which cannot stop has room to change its speed."""
    a, b = first.waypoints, then.waypoints
    ahead = earth.position_difference(a.llh[-1], a.llh[-2])
    ahead = (
        ahead / max(float(np.linalg.norm(ahead)), 1e-9) * (100.0 if VEHICLES[first.vehicle].min_speed == 0.0 else 600.0)
    )
    start = earth.move(a.llh[-1], ahead * [1.0, 1.0, 0.0])
    moved = earth.move(np.broadcast_to(start, b.llh.shape), earth.position_difference(b.llh, b.llh[:1]))
    name = f"twice {first.name}" if first.name == then.name else f"{first.name}, then {then.name}"
    return Manoeuvre(
        name, Waypoints(np.vstack([a.llh, moved]), np.concatenate([a.speed, b.speed]), name), first.vehicle
    )


# -- what they would tell ---------------------------------------------------------------------------------------------------------------


def design(
    measured: StaticLog | Recording,
    nominal: Nominal,
    report: GapReport,
    *,
    rng: np.random.Generator,
    vehicle: str = "car",
    recordings: int = 20,
    progress: Say | None = None,
) -> NextExperiment | None:
    """The manoeuvre that would tell the members of the report's most costly class apart; ``None`` where there is no such class.

    Parameters
    ----------
    measured : Recording
        A drive or flight; of a log at rest there is nothing to drive.
    nominal : Nominal
        What was believed.
    report : GapReport
        Of :func:`insemu.gap.find_gap`.
    rng : Generator
    vehicle : str
        What is there to drive or fly: a key of :data:`insemu.emulate.VEHICLES`.
    recordings : int
        Emulated recordings per member that show whether the promise is kept.
    progress : callable, optional
        Told what is being done.

    Raises
    ------
    InputError
        An unknown vehicle, or a recording on which the nominal filter cannot run.
    """
    say = progress or (lambda _: None)
    if vehicle not in VEHICLES:
        raise InputError(f"unknown vehicle '{vehicle}', expected one of {', '.join(VEHICLES)}", where="--vehicle")
    if isinstance(measured, StaticLog):
        return None
    say("the recording again, everything but the class taken off")
    for finding in _classes(report):
        rest = with_only(report, [f for f in report.findings if f is not finding])
        known = refined_nominal(nominal, rest, measured.imu.dt).parted()
        flown = Flown.of(*in_imu_axes(*drive_without(measured, known)))
        scene = Scene.of(flown.prepared)
        truths = _truths(scene, _keys(finding))
        if len(truths) > 1:
            break
    else:
        return None
    asked = _Asked(flown, measured, truths, Fixes.of(flown))
    here = Manoeuvre("the same again", Waypoints(measured.gnss.llh[:2], np.ones(2)), vehicle)  # type: ignore[union-attr]
    now = asked.promise(here, scene, rng)
    origin = flown.prepared.start[0].llh
    simple = asked.promises(primitives(np.asarray(origin), vehicle), rng, say)
    if not simple:
        return None
    tried = list(simple)
    if tried[0].share < ENOUGH:
        longer = [joined_up(tried[0].manoeuvre, p.manoeuvre) for p in simple]
        tried = _best_first([*tried, *asked.promises(longer, rng, say)])
    best = tried[0]
    kept = asked.kept(best, recordings, rng, say) if recordings else {}
    found = {k: _finding(h) for k, h in truths.items()}
    return NextExperiment(finding, now, best, tuple(tried), found, kept, flown.nominal, asked.fixes)


def _classes(report: GapReport) -> list[Finding]:
    """The classes that the innovations of a drive show, the most costly first."""
    return sorted(
        (f for f in report.findings if f.is_class and f.sensor not in AID_KINDS), key=lambda f: -np.nan_to_num(f.metres)
    )


def _keys(finding: Finding) -> list[Key]:
    """Effect and sensor of each member of a class, and its axes where the class has the effect on others too."""
    plain = [(m.effect, m.sensor) for m in finding.members]
    return [(*k, *m.axes) if plain.count(k) > 1 else k for k, m in zip(plain, finding.members, strict=True)]


def _of(variants: Sequence[Variant], key: Key) -> list[Variant]:
    """The variants of a member of a class."""
    return [v for v in variants if (v.effect, v.sensor) == key[:2] and (v.axes == key[2:] or not key[2:])]


def _truths(scene: Scene, keys: Sequence[Key]) -> dict[Key, DriveHypothesis]:
    """The best explanation of a recording by each of some effects; those that have one."""
    variants = bank(scene)
    each = {k: linear_hypotheses(scene, _of(variants, k), scene.data, scene.always, ()) for k in keys}
    return {k: found[0] for k, found in each.items() if found and found[0].values}


def _finding(h: DriveHypothesis) -> Finding:
    return Finding(h.effect, h.variant, h.sensor, h.axes, h.values, 1.0, h.nats, ())


def _best_first(promises: Sequence[Promise]) -> list[Promise]:
    """By the pairs that each tells apart; of two that tell as much to a twentieth the shorter, of those that tell nothing the larger lead."""
    return sorted(promises, key=lambda p: (-round(20.0 * p.share), p.duration_s if round(20.0 * p.share) else -p.lead))


@dataclass(frozen=True)
class _Asked:
    """What is asked of every manoeuvre.

    Parameters
    ----------
    flown : Flown
        The nominal filter on the measured recording.
    measured : Recording
    truths : mapping of (effect, sensor), with the axes where a class has an effect twice, to DriveHypothesis
        The members of the class at the size at which each explains that recording.
    fixes : Fixes
    """

    flown: Flown
    measured: Recording
    truths: Mapping[Key, DriveHypothesis]
    fixes: Fixes

    def promises(self, manoeuvres: Sequence[Manoeuvre], rng: np.random.Generator, say: Say) -> list[Promise]:
        """What each would tell, best first; what the vehicle cannot drive is left out."""
        out = []
        for m in manoeuvres:
            say(m.name)
            try:
                scene = self.scene(m, rng)
            except InputError:
                continue
            out.append(self.promise(m, scene, rng))
        return _best_first(out)

    def record(self, m: Manoeuvre, rng: np.random.Generator, truth: Finding | None = None) -> Recording:
        """A recording of a manoeuvre with the noise that is believed and, where one is given, the truth."""
        nominal, f = self.flown.nominal, self.fixes
        own = Mounting(rpy=nominal.mounting) if any(nominal.mounting) else None
        ideal = ideal_imu(route(m.waypoints, m.vehicle).flight, RATE_HZ, mounting=own)
        models, uses = (dict(nominal.beliefs), list[EffectUse]()) if truth is None else _with(nominal.beliefs, truth)
        imu_rng, gnss_rng = rng.spawn(2)
        imu = corrupt(
            ideal.imu, models, imu_rng, effects=[u for u in uses if u.inertial], reference=ideal.reference
        ).imu
        fixes = gnss_fixes(
            ideal.reference, f.rate_hz, f.sigma, f.sigma_v, nominal.gnss.lever_arm, rng=gnss_rng,
            effects=[u for u in uses if u.sensor == "gnss"],
        )  # fmt: skip
        return Recording(imu, fixes, ideal.reference if self.measured.reference is not None else None)

    def scene(self, m: Manoeuvre, rng: np.random.Generator) -> Scene:
        """The nominal filter along a manoeuvre."""
        return Scene.of(Flown.of(self.record(m, rng), self.flown.nominal).prepared)

    def promise(self, m: Manoeuvre, scene: Scene, rng: np.random.Generator) -> Promise:
        """What a manoeuvre would tell: the noise drawn again, every member weighed."""
        repeated = Repetitions.of(scene.data, rng)
        distinguished, leads = {}, {}
        for key in self.truths:
            index, coefficients = self._enters(scene, key, repeated.noise.shape[1], rng)
            for other, lead in self._leads(scene, repeated.noise, key, scene.data.A[:, index] @ coefficients).items():
                distinguished[key, other], leads[key, other] = float(np.mean(lead > rules().lead)), float(np.mean(lead))
        return Promise(m, float(scene.motion.t[-1] - scene.motion.t[0]), distinguished, leads)

    def _enters(self, scene: Scene, key: Key, draws: int, rng: np.random.Generator) -> tuple[NDArray[np.int64], Array]:
        """Columns of a truth in a scene and its coefficients (k, draws)."""
        h = self.truths[key]
        v = next(v for v in _of(bank(scene), key) if (v.axes, v.label) == (h.axes, h.variant))
        given = {x.name: x.value for x in h.values}
        t = scene.knots
        if h.effect in PROCESSES:
            root = {
                "random_walk": lambda: given["K"] * random_walk_root(t),
                "gauss_markov": lambda: given["sigma"] * gauss_markov_root(t, 1.0 / given["beta"]),
                "flicker": lambda: given["B"] * flicker_root(t),
            }[h.effect]()
            root = np.asarray(np.kron(np.eye(len(h.axes)), root), dtype=np.float64)
            return v.index, root @ rng.standard_normal((root.shape[1], draws))
        one = given["R"] * (t - t[0]) if h.effect == "ramp" else np.array([x.value for x in h.values])
        return v.index, np.tile(one[:, None], (1, draws))

    def _leads(self, scene: Scene, noise: Array, key: Key, moved: Array) -> dict[Key, Array]:
        """Lead of a truth that moves the right-hand sides over each other member, nats, repetition by repetition."""
        A, b = scene.data.conditioned(scene.always, noise + moved)
        # the first column decides what is worth a closer look
        b, every, gains = np.hstack([b[:, 1:2], b[:, 1:]]), bank(scene), dict[Key, Array]()
        for k in self.truths:
            variants = _of(every, k)
            gains[k] = pooled_evidence(variants, linear_evidence(variants, A, b))[k[0], k[1]][1:]
        return {k: gains[key] - g for k, g in gains.items() if k != key}

    def kept(
        self, promised: Promise, recordings: int, rng: np.random.Generator, say: Say
    ) -> dict[Pair, tuple[int, int]]:
        """How often emulated recordings of a manoeuvre tell a truth from the others: the emulator's effect and noise, the filter in the loop."""
        flown = Flown.of(self.record(promised.manoeuvre, rng), self.flown.nominal)
        scene, out = Scene.of(flown.prepared), dict[Pair, tuple[int, int]]()
        for key, h in self.truths.items():
            seen = []
            for k in range(recordings):
                say(f"{h.effect}, emulated recording {k + 1} of {recordings}")
                again = flown.prepared.on(self.record(promised.manoeuvre, rng, _finding(h)))
                loop = Loop.of(again.result)
                if np.array_equal(loop.use, scene.loop.use):
                    y = loop.y[loop.use.ravel()]
                    seen.append(scene.data.G.T @ y / scene.data.variance)
            if seen:
                leads = self._leads(scene, np.stack(seen, axis=1), key, np.zeros((seen[0].size, 1)))
                out |= {(key, k): (int(np.sum(x > rules().lead)), x.size) for k, x in leads.items()}
        return out


# -- on paper ---------------------------------------------------------------------------------------------------------------------------


def promise_text(x: NextExperiment) -> list[str]:
    """The promise in words, a line for the manoeuvre and one for each pair."""
    lines = [
        f"{x.best.manoeuvre.name}, {x.best.duration_s:.0f} s by {x.best.manoeuvre.vehicle.replace('_', ' ')}: "
        f"{100.0 * x.best.share:.0f} % of the pairs distinguished (the same drive again: {100.0 * x.now.share:.0f} %)"
    ]
    for (truth, other), share in x.best.distinguished.items():
        words = f"{_name(truth)} from {_name(other)}: {100.0 * share:.0f} %, lead {x.best.leads[truth, other]:.1f} nats"
        kept = x.kept.get((truth, other))
        lines.append(words + (f"; emulated {kept[0]} of {kept[1]}" if kept else ""))
    if any(max(p.distinguished[pair] for p in x.tried) < 0.5 for pair in x.best.distinguished):
        lines.append("pairs below a half are distinguished by none of the manoeuvres that were tried")
    return lines


def _name(key: Key) -> str:
    return " ".join([EFFECTS[key[0]].name, *((key[1], ", ".join(key[2:])) if key[2:] else ())])


def write_experiment(x: NextExperiment, path: str | Path) -> tuple[Path, Path]:
    """Write the experiment as a scenario that the emulator takes, and its waypoints next to it.

    The scenario's truth is the member that was named; ``insemu emulate`` makes the recording on which the analysis can be tried.

    Parameters
    ----------
    x : NextExperiment
    path : path
        Of the scenario; the waypoints are the same with ``.csv``.

    Returns
    -------
    scenario, waypoints : Path
    """
    path = Path(path)
    table = path.with_suffix(".csv")
    if table == path:
        raise InputError(f"found '{path.name}', expected a file .yaml; the waypoints go next to it", where="--next")
    w = x.best.manoeuvre.waypoints
    rows = ["lat [deg], lon [deg], height [m], speed [m/s]"]
    rows += [
        f"{math.degrees(lat):.9f}, {math.degrees(lon):.9f}, {h:.3f}, {v:.3f}"
        for (lat, lon, h), v in zip(w.llh, w.speed, strict=True)
    ]
    truth = x.truths[_keys(x.finding)[0]]
    models, uses = _with(x.nominal.beliefs, truth)
    f, designs = x.fixes, {a: m.to_list(axis_unit(a)) for a, m in x.nominal.beliefs.items()}
    true: dict[str, Any] = {a: m.to_list(axis_unit(a)) for a, m in models.items()}
    if uses:
        true["effects"] = [u.to_mapping() for u in uses]
    document = {
        "title": f"The next experiment: {x.best.manoeuvre.name}",
        "notes": "\n".join(promise_text(x)) + "\n",
        "seed": 1,
        "realizations": 1,
        "trajectory": {"waypoints": table.name, "vehicle": x.best.manoeuvre.vehicle},
        "truth": true,
        "gnss": {
            "rate": round(f.rate_hz, 6),
            "position_sigma": f.sigma.tolist(),
            "velocity_sigma": None if f.sigma_v is None else f.sigma_v.tolist(),
            "lever_arm": list(x.nominal.gnss.lever_arm),
        },
        "designs": {"believed": designs},
    }
    text = yaml.safe_dump(plain(document), sort_keys=False, allow_unicode=True, width=140)
    put(table, "\n".join(rows) + "\n")
    put(path, text)
    return path, table


def _with(beliefs: Mapping[str, NoiseModel], truth: Finding) -> tuple[dict[str, NoiseModel], list[EffectUse]]:
    """Noise and effects of a sensor of which a finding is true."""
    models = dict(beliefs)
    if truth.effect not in PROCESSES:
        return models, list(uses_of(truth, 1.0 / RATE_HZ))
    given = {v.name: v.value for v in truth.parameters}
    for axis in truth.axes:
        name = f"{truth.sensor}_{axis}"
        models[name] = with_process(models[name], truth.effect, given)
    return models, []
