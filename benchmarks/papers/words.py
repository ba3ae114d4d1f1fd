"""What a paper claims in words of its own printed numbers, computed from them: ``claims.yaml`` beside this file."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from insemu import units
from insemu.noise import GM, WN, NoiseModel

#: Sampling interval of the MTi-G, s, and levels of the wavelet variance of its four hours.
DT, LEVELS = 0.01, 20


@dataclass(frozen=True)
class Claim:
    """A claim, the figures that follow from the printed cells, and what its words allow.

    Parameters
    ----------
    says, where : str
        A short quotation, and where it stands.
    computed : array
    low, high : float
        What the words allow.
    any : bool
        Whether one of the figures is enough: they are readings of the same.
    unit, note : str
    """

    says: str
    where: str
    computed: NDArray[np.float64]
    low: float
    high: float
    any: bool = False
    unit: str = ""
    note: str = ""

    @property
    def follows(self) -> bool:
        """Whether what was computed is what the words say."""
        inside = (self.computed >= self.low) & (self.computed <= self.high)
        return bool(inside.any() if self.any else inside.all())

    @property
    def verdict(self) -> str:
        return "follows" if self.follows else "contradicts"

    @property
    def measured(self) -> str:
        """The figures, as they are printed."""
        values = np.unique([f"{v:.4g}" for v in self.computed.ravel()])
        shown = sorted(values, key=float)
        text = ", ".join(shown) if len(shown) < 5 else f"{shown[0]} to {shown[-1]}"
        return f"{text} {self.unit}".rstrip()


def cell(printed: Any, path: str) -> Any:
    """What stands at a path: keys and places divided by dots, ``*`` for every entry."""
    found, rest = printed, str(path)
    while rest:
        if isinstance(found, Mapping):
            names = [str(k) for k in found if rest == str(k) or rest.startswith(f"{k}.")]
            key = max(names, key=len, default=rest.partition(".")[0])  # keys may have dots themselves
        else:
            key = rest.partition(".")[0]
        rest = rest[len(key) + 1 :]
        if key == "*":
            return [cell(entry, rest) for entry in (found.values() if isinstance(found, Mapping) else found)]
        found = {str(k): v for k, v in found.items()}[key] if isinstance(found, Mapping) else found[int(key)]
    return found


def claims(paper: str, printed: Mapping[str, Any]) -> list[Claim]:
    """All claims of a paper, computed from its printed numbers.

    Parameters
    ----------
    paper : str
        Its short name.
    printed : mapping
        Its printed numbers, as in the shared data.
    """
    entries = yaml.safe_load(Path(__file__).with_name("claims.yaml").read_text(encoding="utf-8"))[paper]
    return [_computed(entry, printed) for entry in entries]


def _computed(entry: Mapping[str, Any], printed: Mapping[str, Any]) -> Claim:
    names = dict(entry.get("given", {}))
    for name, path in entry.get("cells", {}).items():
        found = cell(printed, path)
        names[name] = found if isinstance(found, Mapping) else np.array(found, dtype=float)
    code = compile(entry["computed"], "claims.yaml", "eval")
    value = eval(code, {"__builtins__": {}}, {**FUNCTIONS, **names})  # the expressions are of this repository
    low, high = entry["between"]
    return Claim(
        entry["says"],
        entry["where"],
        np.atleast_1d(np.asarray(value, dtype=float)),
        -math.inf if low is None else low,
        math.inf if high is None else high,
        entry.get("any", False),
        entry.get("unit", ""),
        entry.get("note", ""),
    )


def _white_alone(sensor: Mapping[str, Any]) -> list[float]:
    """Level of white noise alone by least squares on the wavelet variance of Table II: three readings of sigma_GM, three weights."""
    level, unit = sensor["sigma_wn"]
    one = units.parse(f"1 {unit}", "rad/s/sqrt(Hz)" if "deg" in unit else "m/s^2/sqrt(Hz)")
    scale = 2 ** np.arange(1, LEVELS + 1)
    unity = 1.0 / scale  # of white noise of unit variance per sample
    out = []
    for factor in (lambda beta: 1.0, lambda beta: 1.0 / math.sqrt(2.0 * beta), lambda beta: 1.0 / math.sqrt(DT)):
        parts = [GM(p["sigma"][0] * one * factor(p["beta"][0]), p["beta"][0]) for p in sensor["gm"]]
        curve = np.asarray(NoiseModel((WN(level * one), *parts)).wavelet_variance(scale, DT))
        for weight in (np.ones(LEVELS), 1.0 / (scale * curve**2), 1.0 / curve**2):
            out.append(math.sqrt(float(weight @ (curve * unity)) / float(weight @ unity**2) * DT) / one)
    return out


def _apart(one: Mapping[str, Any], two: Mapping[str, Any], third: bool) -> NDArray[np.float64]:
    """Absolute log ratios of two columns of Table I: of the third Gauss-Markov process, or of all other parameters."""
    logs = [
        (name, k, abs(math.log(b / a)))
        for name in one
        for k, (a, b) in enumerate(zip(*(np.atleast_1d(x[name]) for x in (one, two)), strict=True))
    ]
    return np.array([value for name, k, value in logs if (k == 2) == third])


def _unlike(one: Mapping[str, Any], two: Mapping[str, Any]) -> NDArray[np.float64]:
    """Relative differences of the figures that two tables have in common."""
    return np.array([abs(one[axis][name] / row[name][0] - 1.0) for axis, row in two.items() for name in row])


def _pole(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Largest modulus of the poles of every autoregression 1 + a_1 z^-1 + ..."""
    return np.array([np.abs(np.roots(np.concatenate([[1.0], row]))).max() for row in rows])


#: What expressions may call.
FUNCTIONS: dict[str, Callable[..., Any] | float] = {
    "mean": np.mean, "total": np.sum, "largest": np.max, "smallest": np.min, "sqrt": np.sqrt, "sin": np.sin, "pi": np.pi,
    "True": True, "False": False,
    "both": lambda one, two: np.array([one, two]), "white_alone": _white_alone, "apart": _apart, "unlike": _unlike, "pole": _pole,
}  # fmt: skip
