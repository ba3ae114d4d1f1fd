"""How the parameters of a sensor's noise change from switch-on to switch-on, or from unit to unit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu import yamlfile
from insemu.errors import InputError
from insemu.noise.process import NoiseModel

Array = NDArray[np.float64]


def process_label(symbol: str, index: int) -> str:
    """``GM2``; where the symbol ends in a digit, ``AR1#2``."""
    return f"{symbol}#{index}" if symbol[-1].isdigit() else f"{symbol}{index}"


def with_factors(model: NoiseModel, factors: Mapping[str, float]) -> NoiseModel:
    """The model with some parameters, by label such as ``GM1.sigma``, times a factor."""
    parts = []
    for index, p in model.indexed():
        own = {name: f"{process_label(p.symbol, index)}.{name}" for name in p.parameters}
        parts.append(p.with_parameters({n: p.parameters[n] * factors[at] for n, at in own.items() if at in factors}))
    return NoiseModel(tuple(parts))


@dataclass(frozen=True)
class Spread:
    """Normal logarithms of the parameters of one axis around those of its model.

    Parameters
    ----------
    parameters : tuple of str
        Labels such as ``GM1.sigma``.
    covariance : (p, p) array
        Of the logarithms, with what is not known of their mean.
    """

    parameters: tuple[str, ...]
    covariance: Array

    def drawn(self, model: NoiseModel, rng: np.random.Generator) -> NoiseModel:
        """One sensor's model."""
        values, vectors = np.linalg.eigh(self.covariance)
        moved = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(values.size))
        return with_factors(model, {k: float(np.exp(v)) for k, v in zip(self.parameters, moved, strict=True)})

    def to_mapping(self) -> dict[str, Any]:
        """As plain data for YAML."""
        return {"parameters": list(self.parameters), "log_covariance": self.covariance.tolist()}


def load_spread(path: str | Path) -> dict[str, Spread]:
    """The spread of every axis in a noise-model file that was fitted to several runs.

    Raises
    ------
    InputError
        A file without a spread, or one that is no covariance of parameters of the axis's model; names file and axis.
    """
    document = yamlfile.read(path).data
    axes = document.get("axes") if isinstance(document, dict) else None
    out = {}
    for axis, entry in axes.items() if isinstance(axes, dict) else ():
        given = entry.get("spread") if isinstance(entry, dict) else None
        if given is None:
            continue
        try:
            names = tuple(str(name) for name in given["parameters"])
            covariance = np.array(given["log_covariance"], dtype=np.float64)
        except (TypeError, KeyError, ValueError):
            raise InputError(
                "expected the keys 'parameters' and 'log_covariance'", where=f"{path}: axes.{axis}.spread"
            ) from None
        p = len(names)
        if (
            covariance.shape != (p, p)
            or not np.allclose(covariance, covariance.T)
            or np.linalg.eigvalsh(covariance).min(initial=0.0) < -1e-9
        ):
            raise InputError(
                f"found {covariance.shape} numbers, expected a covariance of {p} parameters",
                where=f"{path}: axes.{axis}.spread",
            )
        known = {
            f"{process_label(q.symbol, i)}.{name}"
            for i, q in NoiseModel.from_list(entry["model"], str(entry.get("unit", ""))).indexed()
            for name in q.parameters
        }
        if not set(names) <= known:
            raise InputError(
                f"found {sorted(set(names) - known)}, expected parameters of the model",
                where=f"{path}: axes.{axis}.spread",
            )
        out[str(axis)] = Spread(names, covariance)
    if not out:
        raise InputError("has no spread; expected a file written by insemu fit RUN1 RUN2 ...", where=str(path))
    return out
