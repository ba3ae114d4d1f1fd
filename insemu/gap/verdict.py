"""What the gap workflow found, as frozen data, and its stable JSON."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

from insemu.effects import AID_KINDS
from insemu.gap.policy import Policy
from insemu.noise import NoiseModel
from insemu.shown import Shown, few

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd
    from numpy.typing import NDArray

    from insemu.records import ImuRecord

VerdictName = Literal["nothing missing", "named", "class", "unexplained"]
#: Share of the metres of the largest finding below which one hardly matters: squares add up, so that it moves the sum by a twenty-thousandth.
FEW = 0.01


@dataclass(frozen=True)
class Value:
    """A parameter with its 95 % interval, SI."""

    name: str
    value: float
    low: float
    high: float
    unit: str

    @classmethod
    def normal(cls, name: str, mean: float, sd: float, unit: str) -> Value:
        """A parameter whose error is normal.

        Parameters
        ----------
        name : str
        mean, sd : float
            Estimate and its standard deviation, in ``unit``.
        unit : str
        """
        return cls(name, float(mean), float(mean - 1.96 * sd), float(mean + 1.96 * sd), unit)

    @classmethod
    def positive(cls, name: str, value: float, sd: float, unit: str) -> Value:
        """A positive parameter whose logarithm has a normal error.

        Parameters
        ----------
        name : str
        value : float
            Estimate, in ``unit``.
        sd : float
            Standard deviation of its logarithm.
        unit : str
        """
        return cls(name, float(value), float(value * math.exp(-1.96 * sd)), float(value * math.exp(1.96 * sd)), unit)

    def scaled(self, factor: float) -> Value:
        """The parameter times a positive factor."""
        return replace(self, value=factor * self.value, low=factor * self.low, high=factor * self.high)

    def shifted(self, by: float) -> Value:
        """The parameter plus a number."""
        return replace(self, value=self.value + by, low=self.low + by, high=self.high + by)

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return {"name": self.name, "value": self.value, "low": self.low, "high": self.high, "unit": self.unit}


@dataclass(frozen=True)
class Member:
    """An effect that explains a finding nearly as well as the named one."""

    effect: str
    sensor: str
    axes: tuple[str, ...]
    nats: float

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return {"effect": self.effect, "sensor": self.sensor, "axes": list(self.axes), "gain_nats": self.nats}


@dataclass(frozen=True)
class Confusable:
    """An effect that would come within three nats of the first in this share of repetitions of the recording."""

    effect: str
    sensor: str
    share: float

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return {"effect": self.effect, "sensor": self.sensor, "share": self.share}


@dataclass(frozen=True)
class Finding:
    """One effect that was found.

    Parameters
    ----------
    effect, variant, sensor, axes
        Catalogue id, its shape, the sensor (``gyro``, ``accel``, ``gnss``, ``imu``, or an aid such as ``odometer``) and the axes.
    parameters : tuple of Value
        SI, with 95 % intervals.
    confidence : float
        Probability that this effect and no other of the catalogue is the reason.
    nats : float
        Evidence over the explanation without it.
    members : tuple of Member
        Effects within 3 nats of the best, the best first: more than one is a class.
    would_separate : str
        The recording that would tell the class apart; empty where one effect is named.
    doubtful : bool
        Whether something that no candidate explains sits in the same place.
    confusable : tuple of Confusable
        Effects that would stand next to it in a tenth or more of repetitions of the recording, most often first.
    metres : float
        Horizontal position error that it leaves at the end of a minute without fixes, m; NaN where nobody says.
    aided_nees : float
        Of a finding about an aid: NEES of the horizontal position per degree of freedom at the end of a minute without fixes, of a filter that has
        the aid and lacks this finding; NaN of others.
    white : tuple of float
        White noise that it adds to each of the six axes of a filter, squared, where it is none of the sensor: (rad/s)^2/Hz and (m/s^2)^2/Hz.
    """

    effect: str
    variant: str
    sensor: str
    axes: tuple[str, ...]
    parameters: tuple[Value, ...]
    confidence: float
    nats: float
    members: tuple[Member, ...]
    would_separate: str = ""
    runners_up: tuple[Member, ...] = ()
    doubtful: bool = False
    confusable: tuple[Confusable, ...] = ()
    metres: float = math.nan
    aided_nees: float = math.nan
    white: tuple[float, ...] = ()

    def doubted(self) -> Finding:
        """The finding where something unexplained sits in the same place: it is no more than as likely as not."""
        return replace(self, confidence=min(self.confidence, 0.5), doubtful=True)

    @property
    def is_class(self) -> bool:
        """Whether the recording leaves more than one effect standing."""
        return len(self.members) > 1

    @property
    def is_setting(self) -> bool:
        """Whether it is a level that was believed or stated too large or too small, and nothing else could stand for it: a number to set."""
        levels = self.effect in ("white_noise", f"{self.sensor}_noise_level") or (
            self.effect == "gnss_velocity_noise" and {v.name for v in self.parameters} == {"factor"}
        )
        return levels and not self.is_class and not self.doubtful

    @property
    def is_read_off(self) -> bool:
        """Whether the samples of a drive show it by themselves: lost samples, a full scale, output counts; the fixes are another matter."""
        return self.variant == "samples" or (self.variant == "held" and self.sensor == "imu")

    def to_json(self) -> dict[str, Any]:
        """As plain data; the keys of the issue first, then ours."""
        return {
            "effect": self.effect,
            "sensor": self.sensor,
            "axes": list(self.axes),
            "parameters": [p.to_json() for p in self.parameters],
            "confidence": self.confidence,
            "gain_nats": self.nats,
            "class": [m.to_json() for m in self.members],
            "would_separate": self.would_separate,
            "variant": self.variant,
            "runners_up": [m.to_json() for m in self.runners_up],
            "confusable": [c.to_json() for c in self.confusable],
            "setting": self.is_setting,
            "metres_60s": self.metres if math.isfinite(self.metres) else None,
        }


#: Variant of a time offset that is what values at the stamp would show of samples that are means over the interval before it.
HALF_SAMPLE = "half a sample"


def with_half_sample(finding: Finding, imu: ImuRecord) -> Finding:
    """A time offset that is half a sample said to be that, where samples were taken as values at their stamps.

    Parameters
    ----------
    finding : Finding
    imu : ImuRecord
        As it was measured.
    """
    half = 0.5 * imu.dt
    late = finding.effect == "imu_gnss_time_offset" and imu.kind == "sample"
    if late and any(v.name == "offset" and 0.0 < v.low <= half <= v.high for v in finding.parameters):
        return replace(finding, variant=HALF_SAMPLE)
    return finding


def judged(findings: Sequence[Finding], remainder: str, settled: Collection[str] = ()) -> VerdictName:
    """The verdict: names stand where the strongest finding is not doubtful, whatever else is left over.

    Effects that were ``settled`` on other data than the rest (the mounting on the motion across the vehicle) speak before all others: nats of what
    shakes a sensor do not compare with theirs. Levels are settings, which lead only where nothing else was found; what is read off the samples leads
    only where nothing is left over.

    Parameters
    ----------
    findings : sequence of Finding
        The strongest first.
    remainder : str
        What no candidate explains, in words; empty where nothing is left.
    settled : collection of str
        Effects found on other data.
    """
    named = [s for s in findings if not (remainder and s.is_read_off)]
    findings = [s for s in findings if s.effect in settled] or [s for s in named if not s.is_setting] or named
    if findings and not findings[0].doubtful:
        return "class" if findings[0].is_class else "named"
    return "unexplained" if findings or remainder else "nothing missing"


@dataclass(frozen=True)
class Where:
    """One entry of the map of disagreement: a statistic with its p-value, corrected for how many were looked at."""

    statistic: str
    sensor: str
    axis: str
    scale_s: float | None
    p_value: float

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return {
            "statistic": self.statistic,
            "sensor": self.sensor,
            "axis": self.axis,
            "scale_s": self.scale_s,
            "p_value": self.p_value,
        }


@dataclass(frozen=True)
class Interval:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float

    @classmethod
    def normal(cls, mean: float, sd: float) -> Interval:
        """Of a value whose error is normal."""
        return cls(mean, mean - 1.96 * sd, mean + 1.96 * sd)

    @classmethod
    def positive(cls, value: float, sd: float) -> Interval:
        """Of a positive value whose logarithm has a normal error; ``sd`` is its own standard deviation."""
        ratio = math.exp(1.96 * sd / value)
        return cls(value, value / ratio, value * ratio)

    @property
    def log_sd(self) -> float:
        """Standard deviation of the logarithm, of one made by :meth:`positive`."""
        return math.log(self.high / self.low) / (2.0 * 1.96)

    def to_json(self) -> dict[str, Any]:
        """As plain data; a value that is not finite becomes null."""
        return {
            k: (v if math.isfinite(v) else None)
            for k, v in (("value", self.value), ("low", self.low), ("high", self.high))
        }


@dataclass(frozen=True)
class Burst:
    """A short time of the fixes that were not used for naming on which a large part of the gap index stands.

    Parameters
    ----------
    start, end : float
        First and last fix of it, s.
    what : str
        Component of the fixes that is farthest off.
    largest : float
        How far, in standard deviations of its innovation.
    without : Interval
        Gap index without these fixes.
    """

    start: float
    end: float
    what: str
    largest: float
    without: Interval

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return {**asdict(self), "without": self.without.to_json()}


@dataclass(frozen=True)
class Step:
    """One step from the nominal to the refined model, on data that was not used for naming.

    Parameters
    ----------
    added : tuple of (effect, sensor, axes)
        What the model has from here on; empty of the nominal model.
    index : float
        Gap index with all that was added so far.
    spread : float
        Standard deviation of the gap index of a model that is right.
    """

    added: tuple[tuple[str, str, tuple[str, ...]], ...]
    index: float
    spread: float

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


@dataclass(frozen=True)
class InBand:
    """What an axis shows above its motion that is the vehicle's: no finding.

    Parameters
    ----------
    axis : str
        ``gyro_x`` ... ``accel_z``.
    rms : float
        Root mean square, in ``unit``.
    unit : str
    low, high : float
        Frequencies between which 90 % of its power lies, Hz.
    shared : float
        Share of it that goes together with another axis: squared coherence, or that of loudness over time.
    """

    axis: str
    rms: float
    unit: str
    low: float
    high: float
    shared: float

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


@dataclass(frozen=True, repr=False)
class GapReport(Shown):
    """The whole answer.

    Parameters
    ----------
    verdict : str
        ``nothing missing``, ``named``, ``class`` or ``unexplained``.
    findings : tuple of Finding
        Effects found, strongest first; those of aids behind the others.
    where, after : tuple of Where
        Disagreement of the nominal and of the refined model with the recording, most significant first.
    gap_before, gap_after : Interval
        Reduced chi-square of whitened innovations on data that was not used for naming; 1 is agreement.
    held_out : Interval
        Gain of log score there, nats per fix (per block of a static log).
    refined : mapping
        Noise model per axis with the stochastic effects added.
    nominal : mapping
        What was believed.
    threshold_nats : float
        Evidence that an effect had to exceed.
    remainder : str
        What is left unexplained beside the findings, in words; empty where nothing is.
    band : tuple of InBand
        How the vehicle shakes above its motion.
    stated_60s : float
        Horizontal standard deviation that the nominal filter states at the end of a minute without fixes, m; NaN of a log at rest.
    outliers : mapping of effect to (k,) array of int
        Which of the positions (velocities) of the recording are outliers: their numbers in order of time, from 0.
    unresolved : tuple of float
        White noise that shaking leaves between the samples of the six axes, squared: (rad/s)^2/Hz and (m/s^2)^2/Hz. The vehicle's, and no finding.
    aids_held_out : mapping of kind to Interval
        Gain of log score of each aid with findings on its last part, by what its first part names: nats per block.
    burst : Burst, optional
        The fixes on which a large part of ``gap_after`` stands, where there are such.
    shrink : tuple of Step
        From the nominal model to the refined one, effect by effect; of drives and flights.
    assumed : tuple of str
        What neither recording nor model states and was estimated from the recording, in words.
    """

    verdict: VerdictName
    findings: tuple[Finding, ...]
    where: tuple[Where, ...]
    after: tuple[Where, ...]
    gap_before: Interval
    gap_after: Interval
    held_out: Interval
    nominal: dict[str, NoiseModel] = field(default_factory=dict)
    refined: dict[str, NoiseModel] = field(default_factory=dict)
    threshold_nats: float = Policy.least_nats
    source: str = "recording"
    curves: dict[str, Any] = field(default_factory=dict, repr=False, compare=False)
    remainder: str = ""
    band: tuple[InBand, ...] = ()
    stated_60s: float = math.nan
    outliers: Mapping[str, NDArray[np.int64]] = field(default_factory=dict, repr=False, compare=False)
    unresolved: tuple[float, ...] = ()
    aids_held_out: Mapping[str, Interval] = field(default_factory=dict)
    burst: Burst | None = None
    shrink: tuple[Step, ...] = ()
    assumed: tuple[str, ...] = ()

    def nees(self, finding: Finding) -> float:
        """NEES of the horizontal position per degree of freedom at the end of a minute without fixes, of a filter that lacks this finding alone.

        One and what the finding is worth over what the filter states, as squares; NaN where either is not known. A finding about an aid has its
        own, of the filter that has the aid.
        """
        if math.isfinite(finding.aided_nees) or finding.sensor in AID_KINDS:
            return finding.aided_nees
        return 1.0 + (finding.metres / self.stated_60s) ** 2

    def numbered(self) -> list[tuple[int, Finding]]:
        """The findings with the numbers under which they are shown and applied, from 1: settings, then most metres, then no metres, then few.

        Metres count by how sure a name is: what is named at 2 nats, and is not believed, led with 600 m.
        """
        expected = [s.metres * s.confidence for s in self.findings]
        most = max((m for m in expected if math.isfinite(m)), default=0.0)
        worth = [m if m > FEW * most else -2.0 if math.isfinite(m) else -1.0 for m in expected]
        order = sorted(range(len(worth)), key=lambda n: (not self.findings[n].is_setting, -worth[n]))
        return [(k, self.findings[n]) for k, n in enumerate(order, 1)]

    def __str__(self) -> str:
        index = f"gap index {self.gap_before.value:.3f} to {self.gap_after.value:.3f}"
        names = (
            f"  {k}. {s.effect} {s.sensor} {','.join(s.axes)}: {s.nats:.1f} nats, {s.metres:.3g} m"
            for k, s in self.numbered()
        )
        return few(
            [
                f"{self.source}: {self.verdict}; {index}",
                *names,
                *([f"  left: {self.remainder}"] if self.remainder else []),
            ]
        )

    def to_dataframe(self) -> pd.DataFrame:
        """One row per parameter of every finding."""
        import pandas as pd

        rows = [
            (
                s.effect,
                s.sensor,
                ",".join(s.axes),
                s.nats,
                s.confidence,
                s.metres,
                v.name,
                v.value,
                v.low,
                v.high,
                v.unit,
            )
            for s in self.findings
            for v in s.parameters
        ]
        columns = [
            "effect",
            "sensor",
            "axes",
            "nats",
            "confidence",
            "metres",
            "parameter",
            "value",
            "low",
            "high",
            "unit",
        ]
        return pd.DataFrame(rows, columns=columns)

    def to_json(self) -> dict[str, Any]:
        """The stable machine-readable face."""
        held = self.held_out.to_json()
        number = {id(s): k for k, s in self.numbered()}
        return {
            "verdict": self.verdict,
            "steps": [
                {"number": number[id(s)], **s.to_json(), "nees_60s": n if math.isfinite(n := self.nees(s)) else None}
                for s in self.findings
            ],
            "stated_60s": self.stated_60s if math.isfinite(self.stated_60s) else None,
            "where": [w.to_json() for w in self.where],
            "gap_index": {"before": self.gap_before.to_json(), "after": self.gap_after.to_json()},
            "held_out": {"gain_nats_per_fix": held["value"], "low": held["low"], "high": held["high"]},
            "burst": None if self.burst is None else self.burst.to_json(),
            "shrink": [step.to_json() for step in self.shrink],
            "aids_held_out": {kind: gain.to_json() for kind, gain in self.aids_held_out.items()},
            "where_after": [w.to_json() for w in self.after],
            "threshold_nats": self.threshold_nats,
            "source": self.source,
            "remainder": self.remainder,
            "assumed": list(self.assumed),
            "band": [b.to_json() for b in self.band],
            "unresolved": list(self.unresolved),
            "outliers": {effect: at.tolist() for effect, at in self.outliers.items()},
        }


def with_held_out(report: GapReport) -> GapReport:
    """The report with a refined model that does worse on data not used for naming called so in its remainder."""
    before, after, gain = report.gap_before, report.gap_after, report.held_out
    said = ""
    if report.findings and gain.high < 0.0:
        said = f"data not used for naming are predicted worse by the refined model ({gain.value:.2g} nats per fix or block)"
    elif report.findings and _farther(before, after):
        said = (
            f"on data not used for naming the gap index moved away from 1 ({before.value:.2f} to {after.value:.2f}): "
            "what was named there does not hold throughout"
        )
    return replace(report, remainder="; ".join(filter(None, (said, report.remainder)))) if said else report


def _farther(before: Interval, after: Interval) -> bool:
    """Whether an index is farther from 1 than another, in proportion, beyond what both intervals leave open."""
    if not min(before.value, after.value) > 0.0:
        return False
    half = math.hypot(before.high - before.low, after.high - after.low) / 2.0
    apart = abs(after.value - before.value) > half
    return apart and not after.low <= 1.0 <= after.high and abs(math.log(after.value)) > abs(math.log(before.value))
