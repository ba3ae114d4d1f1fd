"""Whether an emulated drive can be distinguished from a recorded one, and by what.

Gradient-boosted trees look at windows of both and are asked about windows in blocks of time that they have not seen. The area under their curve is
the chance that they find the emulated one of a pair: 0.5 where nothing tells, 1 where everything does. Regimes count alike in both drives, and
sensors are made equally noisy first, so that another share of standing or another sensor is no answer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.drives.windows import REGIMES, WINDOW_S, Windows, axis_name
from insemu.errors import InputError
from insemu.units import STANDARD_GRAVITY

Array = NDArray[np.float64]

#: Folds and how often they are drawn; blocks of time of a drive; number of the first block of the second one.
FOLDS, REPEATS, BLOCKS, SECOND = 5, 3, 20, 1000
#: Trees, their leaves, least windows in a leaf and step: few windows bear small trees only.
TREES: dict[str, Any] = {
    "max_iter": 60,
    "max_leaf_nodes": 8,
    "min_samples_leaf": 8,
    "learning_rate": 0.1,
    "early_stopping": False,
}
#: Levels of a feature that are held apart.
RANKS = 64
#: Resampled sets of blocks for the interval, and its level.
RESAMPLED, LEVEL = 400, 0.95
#: Fewest windows of each drive in a regime that is compared; bands are judged where it lasts so long, s.
LEAST, JUDGED_S = 2, 30.0
#: Bands of a regime are alike within so much, dB.
ALIKE_DB = 2.0


@dataclass(frozen=True)
class Area:
    """Area under the curve with its interval (95 %), by resampled blocks of time."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.2f} [{self.low:.2f}, {self.high:.2f}]"


@dataclass(frozen=True)
class Telling:
    """A single feature that tells the drives apart.

    Parameters
    ----------
    name : str
    area : float
        Under the curve of this feature alone; 0.5 tells nothing.
    recorded, emulated : float
        Root mean square of a band in ``unit``, mean of another feature.
    noise : float
        What the sensor's noise makes of it, as far as standstills tell; NaN where nothing does.
    unit : str
    """

    name: str
    area: float
    recorded: float
    emulated: float
    noise: float
    unit: str

    @property
    def words(self) -> str:
        """As an engineer says it."""
        noise = f" (noise of the sensor {self.noise:.2g} {self.unit} at most)" if np.isfinite(self.noise) else ""
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.name}: recorded {self.recorded:.3g}{unit}, emulated {self.emulated:.3g}{unit}{noise}"


@dataclass(frozen=True)
class Band:
    """A band of an axis in a regime: root mean squares in deg/s or mg, and the ratio of powers in dB (emulated over recorded)."""

    regime: str
    axis: str
    low: float
    high: float
    recorded: float
    emulated: float
    unit: str

    @property
    def db(self) -> float:
        """Emulated over recorded."""
        return float(20.0 * np.log10(max(self.emulated, 1e-12) / max(self.recorded, 1e-12)))


@dataclass(frozen=True)
class Comparison:
    """Two drives held against each other.

    Parameters
    ----------
    powers, everything : Area
        By powers of bands and axes alone, and with phases between axes, jerk and sideslip.
    telling : tuple of Telling
        The features that tell most by themselves, best first.
    bands : tuple of Band
        In regimes that last :data:`JUDGED_S` in both.
    seconds : mapping of regime to (recorded, emulated)
        How long each lasts, s.
    said : tuple of str
        What was assumed, done and left out.
    """

    powers: Area
    everything: Area
    telling: tuple[Telling, ...]
    bands: tuple[Band, ...]
    seconds: dict[str, tuple[float, float]]
    said: tuple[str, ...]

    @property
    def alike(self) -> int:
        """Bands within :data:`ALIKE_DB`."""
        return sum(abs(b.db) <= ALIKE_DB for b in self.bands)

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return {
            "area_powers": vars(self.powers),
            "area_everything": vars(self.everything),
            "telling": [vars(t) | {"words": t.words} for t in self.telling],
            "bands": [vars(b) | {"db": b.db} for b in self.bands],
            "bands_alike": self.alike,
            "seconds": {k: list(v) for k, v in self.seconds.items()},
            "said": list(self.said),
        }


def compare_drives(recorded: Windows, emulated: Windows, *, seed: int = 1, shown: int = 8) -> Comparison:
    """Hold an emulated drive against a recorded one.

    Parameters
    ----------
    recorded, emulated : Windows
        With the same bands (``top_hz`` of :func:`insemu.drives.windows_of`).
    seed : int
        Of the folds and of the noise that makes sensors alike.
    shown : int
        Features that are named.

    Raises
    ------
    InputError
        Different bands; no regime in both; scikit-learn is not there.
    """
    if recorded.edges.shape != emulated.edges.shape or not np.allclose(recorded.edges, emulated.edges):
        raise InputError("the two drives are cut into different bands, expected the same top_hz for both")
    rng = np.random.default_rng(seed)
    said = [f"{w.source}: {text}" for w in (recorded, emulated) for text in w.said]
    recorded, emulated, words = _equally_noisy(recorded, emulated)
    said += words
    seconds = {}
    both = []
    for k, name in enumerate(REGIMES):
        counts = int((recorded.regime == k).sum()), int((emulated.regime == k).sum())
        if max(counts):
            seconds[name] = (WINDOW_S * counts[0], WINDOW_S * counts[1])
        if min(counts) >= LEAST:
            both.append(k)
        elif max(counts):
            said.append(f"'{name}' is left out: {counts[0]} windows recorded, {counts[1]} emulated")
    if not both:
        raise InputError(
            "the two drives share no regime: " + ", ".join(f"{k} {a:g} and {b:g} s" for k, (a, b) in seconds.items())
        )
    recorded, emulated = (w.rows(np.isin(w.regime, both)) for w in (recorded, emulated))
    bands = tuple(b for k in both for b in _bands(recorded, emulated, k))
    logs = np.concatenate([_logs(recorded), _logs(emulated)])
    more = np.concatenate([recorded.more, emulated.more])
    label = np.repeat([0, 1], [len(recorded.t), len(emulated.t)])
    regime = np.concatenate([recorded.regime, emulated.regime])
    weight = _weights(regime, label)
    block = np.concatenate([_blocks(len(recorded.t)), _blocks(len(emulated.t)) + SECOND])
    areas = [_area(x, label, weight, block, rng) for x in (logs, np.concatenate([logs, more], axis=1))]
    telling = _telling(recorded, emulated, np.concatenate([logs, more], axis=1), label, weight)
    return Comparison(areas[0], areas[1], tuple(telling[:shown]), bands, seconds, tuple(said))


def _logs(w: Windows) -> Array:
    return np.asarray(np.log(np.maximum(w.power, 1e-20)).reshape(len(w.t), -1))


def _blocks(count: int) -> NDArray[np.int64]:
    """Block of time of every window."""
    return np.arange(count) * BLOCKS // max(count, 1)


def _weights(regime: NDArray[np.int64], label: NDArray[np.int64]) -> Array:
    """Weights of windows by which both drives have the same share of every regime, the mean of theirs."""
    out = np.ones(label.size)
    share = {k: np.mean([np.mean(regime[label == c] == k) for c in (0, 1)]) for k in np.unique(regime)}
    for c in (0, 1):
        for k, s in share.items():
            mine = (label == c) & (regime == k)
            out[mine] = s * label.size / (2.0 * mine.sum())
    return out


def _equally_noisy(a: Windows, b: Windows) -> tuple[Windows, Windows, list[str]]:
    """Both drives with white noise as loud as that of the noisier sensor, axis by axis, and what was done."""
    if a.noise is None or b.noise is None:
        who = [w.source for w in (a, b) if w.noise is None]
        return (
            a,
            b,
            [
                f"{' and '.join(who)}: no standstill tells the noise of the sensor, so a louder sensor counts as a difference"
            ],
        )
    width = np.diff(a.edges)
    said, out = [], []
    for w, other in ((a, b), (b, a)):
        assert w.noise is not None and other.noise is not None
        missing = np.maximum(other.noise - w.noise, 0.0)
        out.append(replace(w, power=w.power + missing[:, None] * width, noise=np.maximum(w.noise, other.noise)))
        louder = [
            f"{axis_name(int(k))} {np.sqrt(w.noise[k] / 2) / unit:.2g} to {np.sqrt(other.noise[k] / 2) / unit:.2g} {name}"
            for k in np.flatnonzero(missing > 0.2 * w.noise)
            for unit, name in [_density_unit(int(k))]
        ]
        if louder:
            said.append(f"{w.source}: noise of the sensor raised to that of the other: {', '.join(louder)}")
    return out[0], out[1], said


def _density_unit(k: int) -> tuple[float, str]:
    return (np.deg2rad(1.0) / 60.0, "deg/sqrt(h)") if k < 3 else (1e-6 * STANDARD_GRAVITY, "ug/sqrt(Hz)")


def unit_of(k: int) -> tuple[float, str]:
    """Size in SI and name of the unit in which the motion of an axis is shown."""
    return (float(np.deg2rad(1.0)), "deg/s") if k < 3 else (1e-3 * STANDARD_GRAVITY, "mg")


def _bands(a: Windows, b: Windows, regime: int) -> list[Band]:
    rows = a.regime == regime, b.regime == regime
    if min(int(r.sum()) for r in rows) * WINDOW_S < JUDGED_S:
        return []
    rms = [np.sqrt(w.power[r].mean(axis=0)) for w, r in zip((a, b), rows, strict=True)]
    out = []
    for k in range(6):
        size, unit = unit_of(k)
        for j, (low, high) in enumerate(zip(a.edges[:-1], a.edges[1:], strict=True)):
            first, second = (float(r[k, j] / size) for r in rms)
            out.append(Band(REGIMES[regime], axis_name(k), float(low), float(high), first, second, unit))
    return out


# -- the trees -----------------------------------------------------------------------------------------------------------------------------


def _classifier() -> Any:
    try:
        from sklearn.ensemble import HistGradientBoostingClassifier
    except ImportError:
        raise InputError("comparing drives needs the package 'scikit-learn': pip install 'insemu[compare]'") from None
    return HistGradientBoostingClassifier


def _area(
    x: Array, label: NDArray[np.int64], weight: Array, block: NDArray[np.int64], rng: np.random.Generator
) -> Area:
    """Area under the curve of windows in blocks that the trees have not seen."""
    from threadpoolctl import threadpool_limits

    make = _classifier()
    # trees see the order alone; by ranks on a few levels, which they would make themselves more slowly
    x = np.floor(np.argsort(np.argsort(x, axis=0), axis=0) * (RANKS / len(x)))
    scores = np.zeros(label.size)
    blocks = np.unique(block)
    with threadpool_limits(limits=1):  # trees on few windows: threads would wait for each other
        for repeat in range(REPEATS):
            # windows of both at the same place of a road go together: nothing is learned of one from the other
            mine = (rng.permutation(BLOCKS) % FOLDS)[block % SECOND]
            for k in range(FOLDS):
                seen = mine != k
                trees = make(**TREES, random_state=repeat).fit(x[seen], label[seen], sample_weight=weight[seen])
                scores[~seen] += trees.decision_function(x[~seen])
    value = area_under(scores, label, weight)
    drawn = []
    for _ in range(RESAMPLED):
        count = np.zeros(blocks.size)
        for half in (blocks < SECOND, blocks >= SECOND):
            count[half] = rng.multinomial(half.sum(), np.full(half.sum(), 1.0 / half.sum()))
        drawn.append(area_under(scores, label, weight * count[np.searchsorted(blocks, block)]))
    low, high = np.quantile(drawn, [0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL)])
    return Area(value, float(low), float(high))


def area_under(score: Array, label: NDArray[np.int64], weight: Array) -> float:
    """Weighted chance that a score of label 1 is above one of label 0, ties half.

    Parameters
    ----------
    score : (n,) array
    label : (n,) array of 0 and 1
    weight : (n,) array
    """
    values, at = np.unique(score, return_inverse=True)
    zero, one = (np.bincount(at, weight * (label == c), values.size) for c in (0, 1))
    below = np.cumsum(zero) - 0.5 * zero
    total = float(zero.sum() * one.sum())
    return float((one * below).sum() / total) if total > 0.0 else 0.5


def _telling(a: Windows, b: Windows, x: Array, label: NDArray[np.int64], weight: Array) -> list[Telling]:
    """Features by how far each tells by itself."""
    names = [(k, j) for k in range(6) for j in range(a.edges.size - 1)]
    out = []
    for column in range(x.shape[1]):
        area = area_under(x[:, column], label, weight)
        means = [float(np.average(x[label == c, column], weights=weight[label == c])) for c in (0, 1)]
        if column < len(names):
            k, j = names[column]
            size, unit = unit_of(k)
            low, high = a.edges[j : j + 2]
            rms = [
                float(np.sqrt(np.average(w.power[:, k, j], weights=weight[label == c])) / size)
                for c, w in enumerate((a, b))
            ]
            noise = np.nan if a.noise is None else float(np.sqrt(a.noise[k] * (high - low)) / size)
            out.append(Telling(f"{axis_name(k)}, {low:g} to {high:.3g} Hz", area, rms[0], rms[1], noise, unit))
        else:
            out.append(Telling(a.names[column - len(names)], area, means[0], means[1], np.nan, ""))
    return sorted(out, key=lambda t: -abs(t.area - 0.5))
