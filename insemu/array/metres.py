"""Metres at the ends of outages as a quadratic form of the weights of an array.

With the gains of a filter held, the position error at the end of an outage is linear in the errors of the axes (Gelb 1974, chapter 7), and so
in the weights with which the units of an array make up each axis. One backward pass per outage end gives what an error of each axis at each
sample does there; a process of a unit then contributes through its own state block.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.evaluate import Experiment, LinearTwin
from insemu.filters import driven
from insemu.noise import NoiseModel, Process, Seen
from insemu.records import AXES
from insemu.scenario import Scenario

Array = NDArray[np.float64]
Models = Mapping[str, NoiseModel]

#: Steps of numerical derivatives: this share of a standard error, and at most this share of the value.
STEP_ERROR, STEP_VALUE = 0.05, 0.01


@dataclass(frozen=True)
class Response:
    """What errors of the axes do at the ends of the outages, for one belief of the filter.

    Parameters
    ----------
    gain : (n, k, 6) array
        Horizontal error (north and east at every outage end, divided by the root of the number of ends), m per unit of each axis's error.
    rest : float
        Mean square from start and fixes, m^2.
    dt : float
        Sampling interval, s.
    """

    gain: Array
    rest: float
    dt: float

    def of_process(self, process: Process, one: str, other: str | None = None) -> float:
        """Mean-square position error of a process that enters at one axis; with another axis the cross term of one draw at both, m^2.

        Parameters
        ----------
        process : Process
            Specified.
        one, other : str
            Axes.
        """
        block = process.block(self.dt)
        at = [AXES.index(a) for a in ((one,) if other is None else (one, other))]
        total = block.white * float(np.sum(self.gain[:, :, at[0]] * self.gain[:, :, at[-1]]))
        if not block.n:
            return total
        effects = []
        for a in at:
            C = np.zeros((6, block.n))
            C[a] = block.c
            effect = np.empty((self.gain.shape[0], self.gain.shape[1], block.n))
            driven(self.gain[1:], C, np.array(block.Phi), effect)
            effects.append(effect)
        first, second = effects[0], effects[-1]
        start = np.einsum("ki,ij,kj->", first[0], block.P0, second[0])
        # states at the first row are the start, which the errors of that row see as well
        moved = np.tensordot(first[1:].reshape(-1, block.n), second[1:].reshape(-1, block.n), axes=(0, 0))
        return total + float(start) + float(np.sum(moved * block.Q))

    def of_model(self, model: NoiseModel, axis: str) -> float:
        """Mean-square position error of one axis with this model, m^2."""
        return sum(self.of_process(p, axis) for p in model)


class Flight:
    """A flight with outages, of which a response is asked for one belief after the other.

    Parameters
    ----------
    scenario : Scenario
        Emulated; its first design says how the filter runs.
    file : path, optional
        Where it was read from.

    Raises
    ------
    InputError
        A recording, no outage, no truth.
    """

    def __init__(self, scenario: Scenario, file: str | Path | None = None) -> None:
        self.file = file
        if scenario.recording is not None or scenario.truth is None or not scenario.designs:
            raise InputError(
                "expected an emulated flight with truth and designs, found none", where=str(file or "scenario")
            )
        if not scenario.gnss.outages:
            raise InputError("the flight has no outage, expected one or more", where=str(file or "scenario"))
        self.own: Models = scenario.truth.models()
        self._scenario = scenario

    def response(self, beliefs: Models) -> Response:
        """The response of the filter that believes these models.

        Parameters
        ----------
        beliefs : mapping of axis to NoiseModel
            Axes without one are those of the scenario's truth.
        """
        models = {axis: beliefs.get(axis, self.own[axis]) for axis in AXES}
        assert self._scenario.truth is not None
        nothing = {"recorded": None, "record": None, "file": None, "sensor": None, "spread": False, "effects": ()}
        truth = self._scenario.truth.model_copy(update={**nothing, **models})
        design = next(iter(self._scenario.designs.values())).model_copy(update={**models, "filter": None})
        changed = self._scenario.model_copy(update={"truth": truth, "designs": {"array": design}, "fits": None})
        twin = LinearTwin(Experiment(changed, self.file))
        system, noise = twin.designs["array"], twin.noise["array"]
        sigma = changed.initial.sigma.to_array()
        rows, north_east = twin.ends, np.eye(2, 9)
        gain, rest = np.zeros((int(rows.max()) + 1, 2 * rows.size, 6)), 0.0
        for k, row in enumerate(rows):
            part, start, fixes = system.adjoint(int(row), north_east)
            gain[: part.shape[0], 2 * k : 2 * k + 2] = part
            rest += float(np.sum((start * sigma) ** 2) + np.einsum("fki,fij,fkj->", fixes, noise, fixes))
        return Response(gain / np.sqrt(rows.size), rest / rows.size, 1.0 / twin.world.rate_hz)


@dataclass(frozen=True)
class Quadratic:
    """Mean-square position error of an array: ``rest + w' G w`` over the weights of all axes and units.

    Parameters
    ----------
    axes : tuple of str
    units : int
        Units per axis; the weights of one axis stand together.
    G : (axes units, axes units) array
        m^2.
    rest : float
        Of start, fixes and axes that are no part of the array, m^2.
    """

    axes: tuple[str, ...]
    units: int
    G: Array
    rest: float

    def mean_square(self, weights: Mapping[str, Array]) -> float:
        """Of an array with these weights per axis, m^2."""
        w = np.concatenate([weights[a] for a in self.axes])
        return self.rest + float(w @ self.G @ w)

    def scaled(self, factor: Array) -> Quadratic:
        """With the error of every unit's axis times a factor, (axes units,)."""
        return Quadratic(self.axes, self.units, self.G * np.outer(factor, factor), self.rest)

    def best(self) -> dict[str, Array]:
        """The weights of least mean square, which add up to one on every axis."""
        A = np.kron(np.eye(len(self.axes)), np.ones((1, self.units)))
        scale = np.sqrt(np.maximum(np.diag(self.G), 1e-300))
        inverse = np.linalg.pinv(self.G / np.outer(scale, scale), rcond=1e-12) / np.outer(scale, scale)
        w = inverse @ A.T @ np.linalg.solve(A @ inverse @ A.T, np.ones(len(self.axes)))
        return dict(zip(self.axes, w.reshape(len(self.axes), self.units), strict=True))


def quadratic(
    response: Response, models: Mapping[str, Sequence[NoiseModel]], shared: Mapping[str, Sequence[Seen]], own: Models
) -> Quadratic:
    """The quadratic form of an array.

    Parameters
    ----------
    response : Response
    models : mapping of axis to sequence of NoiseModel
        Of every unit.
    shared : mapping of str to sequence of Seen
        Processes that units share; the axis of a member is ``AXIS@NUMBER`` of the unit.
    own : mapping
        Models of the axes that are no part of the array.
    """
    axes = tuple(a for a in AXES if a in models)
    units = len(models[axes[0]])
    G = np.zeros((len(axes) * units,) * 2)
    for i, axis in enumerate(axes):
        for k, model in enumerate(models[axis]):
            G[i * units + k, i * units + k] = sum(response.of_process(p, axis) for p in model if not p.shared)
    for members in shared.values():
        unit = members[0].process.with_parameters({members[0].process.level.name: 1.0})
        weight = np.zeros((len(axes), units))
        for seen in members:
            axis, _, number = seen.axis.partition("@")
            weight[axes.index(axis), int(number)] += seen.weight
        seen_by = [i for i in range(len(axes)) if weight[i].any()]
        for i in seen_by:
            for j in seen_by:
                term = response.of_process(unit, axes[i], axes[j])
                block = (slice(i * units, (i + 1) * units), slice(j * units, (j + 1) * units))
                G[block] += term * np.outer(weight[i], weight[j])
    rest = response.rest + sum(response.of_model(own[a], a) for a in AXES if a not in axes)
    return Quadratic(axes, units, 0.5 * (G + G.T), rest)


def log_variance(
    worth: Callable[[NoiseModel], float], model: NoiseModel, free: Sequence[tuple[int, str]], covariance: Array
) -> float:
    """Variance of the logarithm of what a fitted model is worth, to first order in the errors of its parameters.

    Parameters
    ----------
    worth : callable
        Of a model.
    model : NoiseModel
        Fitted.
    free : sequence of (place, name)
        Its free parameters.
    covariance : (p, p) array
        Of these.
    """
    here = worth(model)
    slope = np.zeros(len(free))
    known = np.nan_to_num(covariance, nan=0.0, posinf=0.0)
    for i, (place, name) in enumerate(free):
        value = model.processes[place].parameters[name]
        step = min(STEP_ERROR * np.sqrt(max(known[i, i], 0.0)), STEP_VALUE * abs(value))
        if step <= 0.0:
            continue
        parts = list(model.processes)
        parts[place] = parts[place].with_parameters({name: value - step})
        slope[i] = (here - worth(NoiseModel(tuple(parts)))) / step
    return max(float(slope @ known @ slope), 0.0) / max(here, 1e-300) ** 2
