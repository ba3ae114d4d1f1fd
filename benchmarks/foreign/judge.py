"""One foreign recording through the gap workflow and its baselines, and the scores of many in the terms of fault diagnosis."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from benchmarks.foreign import motion, sensors
from benchmarks.foreign.aids import EVERY, AidRuler
from benchmarks.foreign.baselines import METHODS, baselines
from benchmarks.foreign.oracle import gained
from benchmarks.trial.score import interval
from insemu.filters import FixTable
from insemu.gap import Finding, GapReport, Nominal, find_gap, load_measured, load_nominal
from insemu.gap.drive.preparation import Flown, starting_state
from insemu.gap.evidence.surrogate import PLAIN, Colour, FixNoise, Surrogate
from insemu.gap.policy import rules
from insemu.gap.verdict import Member
from insemu.records import Recording

Array = NDArray[np.float64]
#: What is hidden in the recordings of each kind.
KINDS: dict[str, tuple[str, ...]] = {
    "none": (),
    "one": ("fixes",),
    "two": ("fixes", "fixes"),
    "three": ("fixes", "fixes", "fixes"),
    "band": ("band",),
    "outside": ("outside",),
    "outlier": ("outlier",),
    "outlier-two": ("outlier", "fixes"),
    "jump": ("jump",),
    "rarer": ("rarer",),
    "changed": ("changed",),
    "receiver": ("receiver", "receiver"),
    "aid-none": (),
    "aid": ("aid",),
    "aid-two": ("aid", "aid"),
}
#: Kinds with nothing, one, and more hidden, whose answers are counted alike.
NOTHING, ONE, MORE = (
    ("none", "aid-none"),
    ("one", "jump", "rarer", "changed", "outlier", "aid"),
    ("two", "three", "receiver", "outlier-two", "aid-two"),
)
#: Effects of one size are made so large that they are worth between these, nats.
WORTH = (25.0, 250.0)
#: Factor on the vibration of the world in which an effect's worth is measured: in the innovations of a shaken vehicle hardly two runs are alike
#: that sample the vibration a millisecond apart, which tells nobody anything.
CALM = 1e-4
#: Factor on its usual size beyond which the motion does not show an effect.
MOST_SCALE = 30.0
#: The same of an effect of an aid: a lag of more than half a second and a deviation of tens of degrees are other faults.
MOST_AID_SCALE = 5.0
#: Times that an effect is scaled to its worth, which is no square of its size everywhere, and how near is near enough.
MOST_SCALED, NEAR = 4, 0.05
#: A probability below this counts as this in the log score.
FLOOR = 1e-3


@dataclass(frozen=True)
class Job:
    """A recording to be drawn and looked at: what is hidden, seed, length in s, whether the vehicle shakes, how it is recorded, and of what."""

    kind: str
    seed: int
    seconds: float
    vibration: bool
    hold_out: bool = False
    baselines: bool = True
    logger: sensors.Logger = field(default_factory=sensors.Logger)
    vehicles: tuple[str, ...] = motion.VEHICLES

    @property
    def key(self) -> str:
        """Everything that the answer depends on."""
        usual = asdict(sensors.Logger())
        other = "".join(f"-{k}{v:g}" for k, v in asdict(self.logger).items() if v != usual[k])
        other += "" if self.vehicles == motion.VEHICLES else "-" + "-".join(self.vehicles)
        return (
            f"{self.kind}-{self.seed}-{self.seconds:g}-{self.vibration:d}-{self.hold_out:d}-{self.baselines:d}{other}"
        )

    def world(self, calm: float = 1.0) -> sensors.World:
        """What it is a recording of."""
        world = sensors.draw_world(self.seed, self.seconds, self.vibration, self.vehicles, calm, self.logger)
        return replace(world, aids=self.kind.startswith("aid"))


def drawn(job: Job) -> tuple[sensors.World, list[sensors.Hidden], list[float]]:
    """A world, what is hidden in it, and what each is worth by itself, beside the noise of the fixes that is hidden too: see :class:`Ruler`."""
    world = job.world()
    rng = np.random.default_rng([job.seed, 6])
    hidden: list[sensors.Hidden] = []
    worth: list[float] = []
    targets: list[float] = []
    if not KINDS[job.kind]:
        return world, hidden, worth
    if world.aids:
        return world, *_drawn_aids(job, world, rng)
    if job.kind == "receiver":
        return world, sensors.draw_receiver(rng, world), [math.nan, math.nan]
    ruler = Ruler.of(job, world)
    for what in KINDS[job.kind]:
        for _ in range(20):
            kind = str(rng.choice(["shaped", "shaped", "drawn"])) if what == "fixes" else what
            h = sensors.draw_hidden(rng, world, kind)
            target = float(np.exp(rng.uniform(*np.log(WORTH))))
            if any(o.effect == h.effect for o in hidden):
                continue
            half = ruler.half(h) if what != "band" else math.nan
            if kind in ("shaped", "outside", "jump", "rarer", "changed"):
                scaled, half = ruler.scaled(h, target)
                if abs(scaled.values["value"] / h.values["value"]) > MOST_SCALE:
                    continue  # the motion does not show it
                h = scaled
            hidden.append(h)
            worth.append(half)
            targets.append(target)
            break
    ruler = ruler.under(hidden)
    for k, target in enumerate(targets):
        if hidden[k].size is not None and KINDS[job.kind][k] != "band":
            worth[k] = ruler.half(hidden[k])
            if worth[k] < WORTH[0]:
                hidden[k], worth[k] = ruler.scaled(hidden[k], target)
    return world, hidden, worth


def _drawn_aids(job: Job, world: sensors.World, rng: np.random.Generator) -> tuple[list[sensors.Hidden], list[float]]:
    """What is hidden in aids, and what each is worth; drawn again where one would have to be too large to be seen beside the rest."""
    alone = AidRuler.of(*taken(world, ()))
    while True:
        hidden: list[sensors.Hidden] = []
        worth: list[float] = []
        targets: list[float] = []
        factors: list[float] = []
        while len(hidden) < len(KINDS[job.kind]):
            h, half, factor = sensors.draw_hidden(rng, world, "aid"), math.nan, 1.0
            target = float(np.exp(rng.uniform(*np.log(WORTH))))
            if any(o.effect == h.effect for o in hidden):
                continue
            if math.isfinite(alone.half(h)):
                h, half, factor = alone.scaled(h, target)
            if factor <= MOST_AID_SCALE:  # else the motion does not show it
                hidden.append(h)
                worth.append(half)
                targets.append(target)
                factors.append(factor)
        ruler = alone.under(hidden)
        for k, target in enumerate(targets):
            if math.isfinite(worth[k]) and ruler.half(hidden[k]) < WORTH[0]:
                hidden[k], worth[k], more = ruler.scaled(hidden[k], target)
                factors[k] *= more
        if max(factors, default=0.0) <= MOST_AID_SCALE:
            return hidden, worth


@dataclass(frozen=True)
class Ruler:
    """What an effect shifts the innovations of the nominal filter by, in nats.

    Parameters
    ----------
    flown : Flown
        The nominal filter on the ride with nothing hidden.
    calm : sensors.World
        The same ride with hardly any vibration.
    still : Recording
        That ride with nothing hidden.
    noise : FixNoise
        Noise of the fixes beyond what is believed.
    """

    flown: Flown
    calm: sensors.World
    still: Recording
    noise: FixNoise = field(default_factory=lambda: FixNoise(np.ones(6), PLAIN))

    @classmethod
    def of(cls, job: Job, world: sensors.World) -> Ruler:
        """The ruler of a recording."""
        # stamps that stray and rows that are lost shift innovations by more than an effect does
        calm = job.world(CALM)
        calm = replace(calm, logger=replace(calm.logger, lost=0.0, repeated=0.0, jitter=0.0))
        return cls(Flown.of(*taken(world, ())), calm, taken(calm, ())[0])

    def under(self, hidden: Sequence[sensors.Hidden]) -> Ruler:
        """The ruler under the noise of the fixes that is hidden too: behind a colour of ten standard deviations nothing else could be seen."""
        factor, colour = np.ones(6), PLAIN
        for h in hidden:
            if h.effect == "gnss_noise_level":
                factor[:3] = h.values["factor"]
            elif h.effect == "gnss_correlated_noise":
                sigma = h.values["sigma"] * self.calm.unit.position
                colour = Colour(np.concatenate([sigma, np.zeros(3)]), h.values["tau"])
        return replace(self, noise=FixNoise(factor, colour))

    def half(self, h: sensors.Hidden) -> float:
        """Half of the squared whitened difference of two runs of a calm ride, one with the effect, nats."""
        if h.effect == "imu_gnss_time_offset":
            # either sign is worth the same; stamps just before those of the reference would start between two of them
            h = h.scaled(math.copysign(1.0, h.values["value"]))
        without, seen = self._fixes(self.still), self._fixes(taken(self.calm, (h,))[0])
        _, here, there = np.intersect1d(without.t, seen.t, return_indices=True)
        moved = np.zeros((len(without), 6, 1))
        moved[here, :, 0] = np.nan_to_num(seen.innovation[there] - without.innovation[here])
        seen_by = Surrogate.of(self.flown.prepared.result)
        white, _ = seen_by.whiten(moved, self.noise.factor, self.noise.colour)
        return 0.5 * float(np.sum(white**2))

    def scaled(self, h: sensors.Hidden, target: float) -> tuple[sensors.Hidden, float]:
        """An effect at the size at which it is worth ``target``, and what it is worth; scaling ends beyond :data:`MOST_SCALE`."""
        total, half = 1.0, self.half(h)
        for _ in range(MOST_SCALED):
            factor = math.sqrt(target / max(half, 1e-9))
            if abs(math.log(factor)) < 0.5 * NEAR or total > MOST_SCALE:
                break
            h, total = h.scaled(factor), total * factor
            half = self.half(h)
        return h, half

    def _fixes(self, recording: Recording) -> FixTable:
        """Fixes of the filter as it was flown, on another recording of the same ride."""
        assert recording.gnss is not None
        own = self.flown.prepared
        imu, _, *start = starting_state(recording, own.nominal)
        own = replace(own, start=tuple(start))
        gnss = replace(own.gnss, llh=recording.gnss.llh, vel_ned=recording.gnss.vel_ned)
        return own.again(imu=imu, gnss=gnss).result.fixes


def taken(world: sensors.World, hidden: Sequence[sensors.Hidden]) -> tuple[Recording, Nominal]:
    """The recording and the belief, read from files as a user's are."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder) / "r", world, hidden, [])
        measured = load_measured(str(Path(folder) / "r.npz"))
        assert isinstance(measured, Recording)
        return measured, load_nominal(Path(folder) / "r.yaml")


def write(stem: Path, world: sensors.World, hidden: Sequence[sensors.Hidden], worth: Sequence[float]) -> None:
    """Write recording (``.npz``), belief (``.yaml``) and what is hidden (``.truth.yaml``)."""
    np.savez(stem.with_suffix(".npz"), allow_pickle=False, **sensors.record(world, hidden))
    stem.with_suffix(".yaml").write_text(yaml.safe_dump(world.belief(), sort_keys=False))
    truth = {
        "vehicle": world.vehicle,
        "shaking": world.ride.shaking,
        "hidden": [{**h.plain(), "nats": float(w)} for h, w in zip(hidden, worth, strict=False)],
    }
    stem.with_name(f"{stem.name}.truth.yaml").write_text(yaml.safe_dump(truth, sort_keys=False))


def answer(job: Job) -> dict[str, Any]:
    """What is said of a recording, as plain data."""
    world, hidden, worth = drawn(job)
    measured, nominal = taken(world, hidden)
    begun = time.process_time()
    report = find_gap(measured, nominal, rng=np.random.default_rng(job.seed), hold_out=job.hold_out, pictures=False)
    seconds = time.process_time() - begun
    # lost samples are there, and said, beside what is hidden
    lost = [s for s in report.findings if job.logger.loses and s.effect == "dropped_samples"]
    findings = [s for s in report.findings if s not in lost]
    verdict = "nothing missing" if lost and not findings and report.verdict == "named" else report.verdict
    return {
        "kind": job.kind,
        "seed": job.seed,
        "vehicle": world.vehicle,
        "shaking": world.ride.shaking,
        "hidden": [{**h.plain(), "nats": w} for h, w in zip(hidden, worth, strict=True)],
        "truth": [truths(h, world) for h in hidden],
        "verdict": verdict,
        **({"lost": bool(lost)} if job.logger.loses else {}),
        "remainder": report.remainder,
        "findings": [s.to_json() for s in findings],
        "right": [[_is(s, h) for h in hidden] for s in findings],
        "held": [[_holds(s, h) for h in hidden] for s in findings],
        "index": [report.gap_before.value, report.gap_after.value],
        **(_held_out(measured, nominal, report, hidden, world) if job.hold_out else {}),
        "seconds": seconds,
        "baselines": baselines(measured, nominal, [(h.effect, h.sensor) for h in hidden]) if job.baselines else {},
    }


def _held_out(
    measured: Recording, nominal: Nominal, report: GapReport, hidden: Sequence[sensors.Hidden], world: sensors.World
) -> dict[str, Any]:
    """The interval of the index after refinement, and what was gained on held-out fixes beside what the truth gains, nats per fix."""
    known = bool(hidden) and all((h.effect, h.sensor) in sensors.SHAPED or h.effect in sensors.DRAWN for h in hidden)
    known = known and not world.logger.loses  # of lost samples the truth has no model
    after = report.gap_after
    truth = [truths(h, world) for h in hidden]
    return {
        "interval": [after.low, after.high],
        "gained": report.held_out.value,
        "oracle": gained(measured, nominal, report, hidden, truth, rules().naming_share) if known else math.nan,
    }


def _is(s: Finding | Member, h: sensors.Hidden) -> bool:
    if h.equation:
        effect = "expression_step" if "start" in h.values else "expression"
        return (s.effect, s.sensor, s.axes) == (effect, h.sensor, (h.equation,))
    return (s.effect, s.sensor) == (h.effect, h.sensor) and _there(h.axis, s.axes)


def _there(axis: str, axes: Sequence[str]) -> bool:
    """Whether axes may be those of a hidden effect: of a cell of a matrix the row counts."""
    return not axis or not axes or axis[0] in axes or axis in axes


def _holds(s: Finding, h: sensors.Hidden) -> bool:
    return any(_is(m, h) for m in s.members)


def truths(h: sensors.Hidden, world: sensors.World) -> dict[str, float]:
    """True values by the names that a finding gives its parameters."""
    v, axis = h.values, h.axis
    if h.sensor in EVERY:
        return {f"{k}_{axis}" if axis and k != "tau" and h.effect != "aid_outliers" else k: x for k, x in v.items()}
    names = {"temperature": "c1", "imu_gnss_time_offset": "offset", "gnss_position_filter": "tau"}
    name = names.get(h.effect, "value")
    if "lag" in v:
        return {f"c1_{axis}": v["value"], f"lag_{axis}": v["lag"]}
    if h.equation:
        return dict(v)
    if "value" in v and "start" not in v:
        return {f"{name}_{axis}" if axis else name: v["value"]}
    if h.effect == "gnss_correlated_noise" and "begin" in v:
        return {"follows": 1.0}
    if h.effect == "gnss_correlated_noise":
        return {
            "tau": v["tau"],
            **{
                f"sigma_{a}": v["sigma"] * float(s)
                for a, s in zip(("north", "east", "down"), world.unit.position, strict=True)
            },
        }
    if h.effect == "gnss_outliers":
        return {"probability": v["probability"]}
    if h.effect == "white_noise":
        return {"N": v["factor"] * (world.unit.gyro_white if h.sensor == "gyro" else world.unit.accel_white)}
    return dict(v)


# -- scores ---------------------------------------------------------------------------------------------------------------------------


def given_to_truth(a: dict[str, Any], k: int) -> float:
    """Probability that an answer gives to one of the hidden effects: that of its member in the class where it is the likeliest."""
    best = 0.0
    h = a["hidden"][k]
    for s in a["findings"]:
        named = s["class"][0]["gain_nats"] if s["class"] else s["gain_nats"]
        for m in (*s["class"], *s["runners_up"]):
            if (m["effect"], m["sensor"]) == (h["effect"], h["sensor"]) and _there(h["axis"], m["axes"]):
                best = max(best, min(s["confidence"] * math.exp(min(m["gain_nats"] - named, 50.0)), 1.0))
    return best


def scores(answers: Sequence[dict[str, Any]]) -> list[tuple[str, str]]:
    """Lines of the table: what was counted, and the figure with its exact 95 % interval where it is a share."""
    rows: list[tuple[str, str]] = []

    def share(label: str, hits: Sequence[bool]) -> None:
        if hits:
            low, high = interval(sum(hits), len(hits))
            rows.append((label, f"{sum(hits)} of {len(hits)} ({low:.3f} to {high:.3f})"))

    of = {kind: [a for a in answers if a["kind"] == kind] for kind in KINDS}
    share(
        "no effect: named, class or unexplained (false alarms)",
        [a["verdict"] != "nothing missing" for k in NOTHING for a in of[k]],
    )
    share("no effect: named or unexplained", [a["verdict"] in ("named", "unexplained") for k in NOTHING for a in of[k]])
    share(
        "detected, one effect or more",
        [a["verdict"] != "nothing missing" for k in (*ONE, *MORE, "band") for a in of[k]],
    )
    one = [a for k in ONE for a in of[k]]
    share(
        "one: named right, or in a class of at most three",
        [any(h[0] and len(s["class"]) <= 3 for h, s in zip(a["held"], a["findings"], strict=True)) for a in one],
    )
    share("one: first in the ranking", [bool(a["right"]) and a["right"][0][0] for a in one])
    share("one: verdict is not 'unexplained'", [a["verdict"] != "unexplained" for a in one])
    share("band: among the findings", [any(h[0] for h in a["held"]) for a in of["band"]])
    for kind in MORE:
        n = len(KINDS[kind])
        exact = [
            sorted(k for r in a["right"] for k, v in enumerate(r) if v) == list(range(n)) and len(a["findings"]) == n
            for a in of[kind]
        ]
        held = [all(any(h[k] for h in a["held"]) for k in range(n)) and len(a["findings"]) == n for a in of[kind]]
        share(f"{kind}: all and only these, by name", exact)
        share(f"{kind}: the same, classes counted", held)
    share("lost samples: said", [a["lost"] for a in answers if "lost" in a])
    outside = of["outside"]
    share("outside: its equation, first", [bool(a["right"]) and a["right"][0][0] for a in outside])
    share("outside: an equation or 'unexplained'", [_strange(a) >= 1.0 for a in outside])
    held = [a for a in answers if "interval" in a]
    share("index after refinement: interval holds 1", [a["interval"][0] <= 1.0 <= a["interval"][1] for a in held])
    both = np.array([(a["gained"], a["oracle"]) for a in held if math.isfinite(a["oracle"])]).reshape(-1, 2)
    if both.size:
        ratios = both[:, 0].sum() / both[:, 1].sum(), np.median(both[:, 0] / both[:, 1])
        rows.append(
            (
                f"held-out gain over that of the truth, {len(both)} recordings: of all, median",
                "{:.3f}, {:.3f}".format(*ratios),
            )
        )
    probabilities = [given_to_truth(a, k) for kind in (*ONE, *MORE) for a in of[kind] for k in range(len(a["hidden"]))]
    if probabilities:
        rows.append(("isolation accuracy: mean probability given to the truth", f"{np.mean(probabilities):.3f}"))
        rows.append(
            ("log score: mean log of that probability", f"{np.mean(np.log(np.maximum(probabilities, FLOOR))):.3f}")
        )
    classes = [s for a in one for s in a["findings"]]
    if classes:
        rows.append(("class size, mean", f"{np.mean([len(s['class']) for s in classes]):.2f}"))
    if of["outside"] and one:
        rows.append(
            (
                "outside the catalogue against one effect, area under the curve",
                f"{_area([_strange(a) for a in of['outside']], [_strange(a) for a in one]):.3f}",
            )
        )
    inside = _intervals(answers)
    share("95 % intervals that hold the truth", [hit for hits in inside.values() for hit in hits])
    for name, hits in sorted(inside.items()):
        share(f"  {name}", hits)
    pairs = [(s["confidence"], any(r)) for a in answers for s, r in zip(a["findings"], a["right"], strict=True)]
    if pairs:
        rows.append(("calibration error of the confidences", f"{calibration(pairs):.3f}"))
    for method in METHODS:
        looked = [a for a in answers if method in a["baselines"]]
        share(f"{method}: false alarms", [a["baselines"][method]["flagged"] for a in looked if a["kind"] == "none"])
        share(
            f"{method}: one effect, first right",
            [a["baselines"][method]["first"] for a in looked if a["kind"] == "one"],
        )
        share(
            f"{method}: two or three, all and only these",
            [a["baselines"][method]["all"] for a in looked if a["kind"] in ("two", "three")],
        )
    spent = [a["seconds"] for a in answers]
    rows.append(("CPU s per recording, median, largest", f"{np.median(spent):.1f}, {max(spent):.1f}"))
    return rows


def _strange(a: dict[str, Any]) -> float:
    """How much an answer speaks for something outside the catalogue."""
    first = (
        a["findings"][0] if a["findings"] else {"effect": "", "confidence": float(a["verdict"] == "nothing missing")}
    )
    if first["effect"] == "expression":
        return 1.0 + float(first["confidence"])
    return float(a["verdict"] == "unexplained") + 1.0 - float(first["confidence"])


def _area(high: Sequence[float], low: Sequence[float]) -> float:
    """Share of pairs in the right order, ties counted half."""
    return float(np.mean([(h > v) + 0.5 * (h == v) for h in high for v in low]))


def _intervals(answers: Sequence[dict[str, Any]]) -> dict[str, list[bool]]:
    """By effect and parameter: whether the interval of each named effect holds the truth."""
    out: dict[str, list[bool]] = {}
    for a in answers:
        for s, right in zip(a["findings"], a["right"], strict=True):
            for k in (k for k, hit in enumerate(right) if hit):
                for p in s["parameters"]:
                    value = a["truth"][k].get(
                        p["name"], a["truth"][k].get(p["name"].partition("_")[0]) if len(s["axes"]) < 2 else None
                    )
                    if value is not None:
                        key = f"{s['effect']} {p['name'].partition('_')[0]}"
                        out.setdefault(key, []).append(bool(p["low"] <= value <= p["high"]))
    return out


def calibration(pairs: Sequence[tuple[float, bool]], bins: int = 5) -> float:
    """Expected calibration error: mean distance of confidence and share of right names over bins of equal count (Guo et al. 2017)."""
    ordered = sorted(pairs)
    parts = np.array_split(np.array(ordered, dtype=np.float64), min(bins, len(ordered)))
    return float(sum(len(p) * abs(p[:, 0].mean() - p[:, 1].mean()) for p in parts) / len(ordered))
