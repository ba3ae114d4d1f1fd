"""What the gap workflow is held against: a likelihood ratio per signature, the group lasso, and a classifier that is trained by simulation."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import RandomForestClassifier
from sklearn.feature_extraction import DictVectorizer

from insemu.gap import Nominal
from insemu.gap.drive.preparation import Flown
from insemu.gap.drive.scene import Scene
from insemu.gap.drive.signatures import Loop
from insemu.records import AXES, Recording

Array = NDArray[np.float64]
#: Effect and sensor.
Name = tuple[str, str]
METHODS = ("glr", "lasso", "forest")
#: Intervals between fixes over which the correlation of the innovations is a feature.
LAGS = (1, 3, 10, 30)
#: Quantiles of the squared innovations that are features: outliers stand above, what is stated too large below.
QUANTILES = (0.5, 0.9, 0.99, 1.0)
#: Parts of the band above the motion whose level is a feature.
PARTS = 4
#: Trees of a forest, examples in a leaf at least, and probability from which an effect counts as named.
TREES, LEAF, NAMED = 500, 2, 0.5


@dataclass(frozen=True)
class Signatures:
    """Normalised responses (r, c) of the innovations (r,) to every effect, with the columns of each."""

    y: Array
    G: Array
    groups: dict[Name, list[int]]

    @classmethod
    def of(cls, flown: Flown) -> Signatures:
        """Of the nominal filter on a recording."""
        scene = Scene.of(flown.prepared)
        G = scene.data.G[:, : scene.catalogue]
        groups: dict[Name, list[int]] = {}
        for i, c in enumerate(scene.columns[: scene.catalogue]):
            groups.setdefault((c.effect, c.sensor), []).append(i)
        return cls(scene.data.y, G / np.sqrt(np.maximum(np.sum(G * G, axis=0), 1e-300)), groups)

    def ratios(self) -> dict[Name, float]:
        """The best likelihood ratio of the columns of each effect, nats."""
        single = 0.5 * (self.G.T @ self.y) ** 2
        return {g: float(np.max(single[i])) for g, i in self.groups.items()}


def baselines(measured: Recording, nominal: Nominal, names: Sequence[Name]) -> dict[str, Any]:
    """What a likelihood ratio per signature and the group lasso name, held against what is hidden, and what a classifier sees of the recording."""
    flown = Flown.of(measured, nominal)
    signatures = Signatures.of(flown)
    limit = 0.5 * float(2.0 * math.log(signatures.G.shape[1]) + 2.0 * math.log(100.0))
    ratios = signatures.ratios()
    first = max(ratios, key=lambda g: ratios[g])
    found = {
        "glr": [first] if ratios[first] > limit else [],
        "lasso": _lasso(signatures.G, signatures.y, signatures.groups, math.sqrt(2.0 * limit)),
    }
    judged = {method: judgement(said, names) for method, said in found.items()}
    return {**judged, "features": features(flown, nominal, ratios)}


def judgement(said: Sequence[Name], names: Sequence[Name]) -> dict[str, bool]:
    """Whether a method flags a recording, names a hidden effect first, and names all of them and nothing else."""
    return {
        "flagged": bool(said),
        "first": bool(said) and said[0] in names,
        "all": bool(names) and set(names) == set(said),
    }


def _lasso(G: Array, y: Array, groups: dict[Name, list[int]], weight: float) -> list[Name]:
    """Groups that the group lasso keeps, largest first: block coordinate descent on normalised columns (Yuan and Lin 2006)."""
    A, b = G.T @ G, G.T @ y
    x = np.zeros(b.size)
    for _ in range(200):
        before = x.copy()
        for i in groups.values():
            z = b[i] - A[i] @ x + A[np.ix_(i, i)] @ x[i]
            size = float(np.linalg.norm(z))
            shrink = max(0.0, 1.0 - weight * math.sqrt(len(i)) / max(size, 1e-300))
            x[i] = shrink * z / max(float(np.linalg.norm(A[np.ix_(i, i)], 2)), 1e-12)
        if np.max(np.abs(x - before)) < 1e-6 * max(float(np.max(np.abs(x))), 1e-12):
            break
    size = {g: float(np.linalg.norm(x[i])) for g, i in groups.items()}
    return sorted((g for g in groups if size[g] > 0.0), key=lambda g: -size[g])


# -- a classifier ---------------------------------------------------------------------------------------------------------------------


def features(flown: Flown, nominal: Nominal, ratios: Mapping[Name, float]) -> dict[str, float]:
    """What a classifier sees: likelihood ratios, statistics of the whitened innovations, levels of the band above the motion over those believed."""
    out = {f"{effect} {sensor}": math.log1p(v) for (effect, sensor), v in ratios.items()}
    loop = Loop.of(flown.prepared.result)
    for i, (column, use) in enumerate(zip(loop.y.reshape(-1, 6).T, loop.use.T, strict=True)):
        z = column[use]
        if z.size <= 2 * max(LAGS):
            continue
        power = float(z @ z)
        out[f"mean {i}"] = float(z.mean())
        out |= {f"square {i} {q}": math.log(float(np.quantile(z * z, q)) + 1e-9) for q in QUANTILES}
        out |= {f"correlation {i} {k}": float(z[k:] @ z[:-k]) / power for k in LAGS}
    for name in AXES:
        data = flown.fast[name]
        if data.f.size >= PARTS:
            ratio = np.log(data.power / nominal.beliefs[name].psd(data.f, data.dt))
            out |= {f"band {name} {k}": float(np.mean(part)) for k, part in enumerate(np.array_split(ratio, PARTS))}
            out[f"band {name} peak"] = float(ratio.max())
    return out


@dataclass(frozen=True)
class Trained:
    """A random forest (Breiman 2001) that has learned which effects a recording holds from recordings in which they are known."""

    forest: RandomForestClassifier
    seen: DictVectorizer
    names: tuple[Name, ...]

    @classmethod
    def on(cls, examples: Sequence[tuple[Mapping[str, float], Sequence[Name]]]) -> Trained:
        """Learn from features and what is hidden.

        Parameters
        ----------
        examples : sequence of (features, names)
        """
        names = tuple(sorted({name for _, hidden in examples for name in hidden}))
        seen = DictVectorizer(sparse=False)
        X = seen.fit_transform([dict(x) for x, _ in examples])
        labels = np.array([[name in hidden for name in names] for _, hidden in examples], dtype=int)
        forest = RandomForestClassifier(TREES, min_samples_leaf=LEAF, random_state=1)
        return cls(forest.fit(X, labels), seen, names)

    def named(self, seen: Mapping[str, float]) -> list[Name]:
        """Effects that are more likely there than not, the likeliest first."""
        each = self.forest.predict_proba(self.seen.transform([dict(seen)]))
        says = {name: float(p[0, -1]) for name, p in zip(self.names, each, strict=True)}
        return sorted((name for name in says if says[name] > NAMED), key=lambda name: -says[name])
