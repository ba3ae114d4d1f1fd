"""An array of IMUs made one sensor: models of its units, weightings, metres at the ends of outages."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from insemu.array import weights as ways
from insemu.array.metres import Flight, Quadratic, Response, log_variance, quadratic
from insemu.errors import InputError
from insemu.fit import FitResult, fit, fit_together
from insemu.lost import FILLED_IN, MOST_LOST, filled, width_at_rest
from insemu.noise import NoiseModel, Process, Seen, shared_processes
from insemu.records import AXES, Series

Array = NDArray[np.float64]
Weights = dict[str, Array]

#: Names of the weightings, in the order of tables.
EQUAL, INVERSE, SCALE_WISE, METRES = "equal", "inverse variance", "scale-wise variance", "metres at outage end"
#: Weights have settled when none moves by more: the mean square then changes by less than a ten-thousandth.
SETTLED = 3e-3
#: Most beliefs that are tried.
ROUNDS = 8
#: Draws of what the units are worth, for intervals.
DRAWS = 2000
#: A pair of units is called dependent below this probability, over all pairs and axes.
DEPENDENT = 0.01


@dataclass(frozen=True)
class Weighting:
    """One way of weighing the units.

    Parameters
    ----------
    name : str
    weights : mapping of axis to (units,) array
    models : mapping of axis to NoiseModel
        What the filter of the virtual sensor believes.
    rms_m : float
        Horizontal error at the ends of the outages, root mean square.
    ratio, low, high : float
        Its mean square over that of equal weights, with the 95 % interval that the errors of the fits leave.
    """

    name: str
    weights: Mapping[str, Array]
    models: Mapping[str, NoiseModel]
    rms_m: float
    ratio: float
    low: float
    high: float


@dataclass(frozen=True)
class ArrayFit:
    """An array and its weightings.

    Parameters
    ----------
    units : tuple of str
    signals : mapping of axis to sequence of Series
        Of every unit.
    fits : mapping of axis to sequence of FitResult
        Of every unit.
    weightings : tuple of Weighting
        Equal, inverse variance, scale-wise variance, metres.
    shares : mapping of axis to (units,) array
        Part of the mean square of equal weights that comes from each unit's axis.
    dependent : tuple of (axis, unit, unit, p)
        Pairs that are not independent while the model says nothing of it.
    """

    units: tuple[str, ...]
    signals: Mapping[str, Sequence[Series]]
    fits: Mapping[str, Sequence[FitResult]]
    weightings: tuple[Weighting, ...]
    shares: Mapping[str, Array]
    dependent: tuple[tuple[str, str, str, float], ...]

    def __getitem__(self, name: str) -> Weighting:
        """The weighting of a name."""
        return next(w for w in self.weightings if w.name == name)

    def virtual(self, name: str = METRES) -> list[Series]:
        """The log of the virtual sensor of a weighting."""
        out = []
        for axis, signals in self.signals.items():
            values = sum(w * s.values for w, s in zip(self[name].weights[axis], signals, strict=True))
            out.append(replace(signals[0], values=np.asarray(values), name=axis))
        return out

    def fitted(self, model: str, name: str = METRES) -> dict[str, FitResult]:
        """Fits to the log of the virtual sensor; processes that the units share are its own."""
        out = {}
        for s in self.virtual(name):
            asked = NoiseModel(tuple(replace(p, shared="") for p in NoiseModel.parse(model, s.unit)))
            out[s.name] = fit(s, asked)
        return out

    def to_json(self) -> dict[str, Any]:
        """The stable machine-readable form."""
        return {
            "units": list(self.units),
            "weightings": [
                {
                    "name": w.name,
                    "rms_m": w.rms_m,
                    "mean_square_over_equal": w.ratio,
                    "interval": [w.low, w.high],
                    "weights": {a: v.tolist() for a, v in w.weights.items()},
                    "models": {a: m.to_list(self.signals[a][0].unit) for a, m in w.models.items()},
                }
                for w in self.weightings
            ],
            "dependent": [
                {"axis": a, "units": [one, two], "p_value": p} for a, one, two, p in self.dependent
            ],
        }  # fmt: skip


def weigh(
    logs: Mapping[str, Mapping[str, Series]],
    model: str,
    flight: Flight,
    *,
    plus: Mapping[str, NoiseModel] | None = None,
    say: Callable[[str], None] = lambda text: None,
    rng: np.random.Generator | None = None,
) -> ArrayFit:
    """Fit every unit and weigh them in all ways.

    Parameters
    ----------
    logs : mapping of unit to mapping of axis to Series
        Static logs, sampled together.
    model : str
        Structure of every axis; processes with a name (``shared=supply``) are one in all units.
    flight : Flight
        In whose outages metres count.
    plus : mapping of axis to NoiseModel, optional
        What every unit has next to its fit, each a draw of its own: a turn-on bias, which no static log shows.
    say : callable
        Told what is being done.
    rng : Generator, optional
        Of the draws behind intervals.

    Raises
    ------
    InputError
        Fewer than two units, units of different axes, lengths or rates; what a fit refuses.

    Notes
    -----
    The weights of least metres and the filter's belief take turns: each step lowers the mean square, for the gains of the best filter are
    those of least mean square under the weights (Gelb 1974), and the weights are the minimum of a quadratic form under the gains.
    """
    signals, units = gathered(logs, say)
    fits = {axis: _fitted(axis, list(of), model, say) for axis, of in signals.items()}
    array = _Array(flight, fits, {a: (plus or {}).get(a, NoiseModel()) for a in signals})
    say("wavelet covariances of the units")
    matrices = {axis: ways.wavelet_matrices(of) for axis, of in signals.items()}
    count = len(units)
    asked: dict[str, Weights] = {
        EQUAL: {a: ways.equal(count) for a in signals},
        INVERSE: {a: ways.inverse_variance(of) for a, of in signals.items()},
        SCALE_WISE: {a: ways.scale_wise(m) for a, (m, _) in matrices.items()},
    }
    say("a flight with equal weights")
    first = array.form(asked[EQUAL])
    spread = array.regressed(first[1])
    asked[METRES] = array.settled(asked[EQUAL], spread, say)
    generator = rng or np.random.default_rng(0)
    draws = np.exp(spread[0] + np.sqrt(spread[1]) * generator.standard_normal((DRAWS, spread[0].size)))
    known = np.diag(first[0].G)
    factors = np.sqrt(draws / np.maximum(known, 1e-300))
    equal = np.array([first[0].scaled(f).mean_square(asked[EQUAL]) for f in factors])
    weightings = []
    for name, w in asked.items():
        say(f"a flight by {name}")
        form = first[0] if name == EQUAL else array.form(w)[0]
        drawn = np.array([form.scaled(f).mean_square(w) for f in factors]) / equal
        low, high = np.quantile(drawn, [0.025, 0.975])
        square = form.mean_square(w)
        ratio = square / first[0].mean_square(asked[EQUAL])
        weightings.append(Weighting(name, w, array.belief(w), float(np.sqrt(square)), ratio, float(low), float(high)))
    part = np.diag(first[0].G) / count**2 / first[0].mean_square(asked[EQUAL])
    shares = dict(zip(first[0].axes, part.reshape(-1, count), strict=True))
    return ArrayFit(units, signals, fits, tuple(weightings), shares, _dependent(fits, matrices, units))


def gathered(
    logs: Mapping[str, Mapping[str, Series]], say: Callable[[str], None] = lambda text: None
) -> tuple[dict[str, list[Series]], tuple[str, ...]]:
    """Signals by axis, in the order of the units, cut to a common length, lost samples filled in; raises ``InputError`` where they make no array."""
    units = tuple(logs)
    if len(units) < 2:
        raise InputError(f"found {len(units)} IMU, expected two or more")
    axes = [a for a in AXES if a in logs[units[0]]]
    if not axes:
        raise InputError(f"found no axis of an IMU, expected some of {', '.join(AXES)}", where=units[0])
    rate = logs[units[0]][axes[0]].rate_hz
    for unit, of in logs.items():
        if sorted(of) != sorted(axes):
            raise InputError(f"has the axes {', '.join(of)}, expected {', '.join(axes)} as {units[0]}", where=unit)
        for s in of.values():
            if s.missing > MOST_LOST * len(s):
                s.complete("an array")
            if s.missing:
                say(f"{s.missing} samples of {s.name} of {unit} are lost: they {FILLED_IN}")
            if abs(s.rate_hz / rate - 1.0) > 1e-4:
                raise InputError(f"is sampled at {s.rate_hz:g} Hz, expected {rate:g} Hz as {units[0]}", where=unit)
    n = min(len(s) for of in logs.values() for s in of.values())
    return {
        a: [replace(logs[u][a], values=_whole(logs[u][a])[:n], rate_hz=rate, gaps=False) for u in units] for a in axes
    }, units


def _whole(s: Series) -> Array:
    """The values with lost samples drawn from what those around them leave open, so that noise stays as white as it is."""
    gone = ~np.isfinite(s.values)
    return filled(s.values[~gone, None], gone, width_at_rest(1.0 / s.rate_hz), np.random.default_rng(gone.size))[:, 0]


def _fitted(axis: str, signals: list[Series], model: str, say: Callable[[str], None]) -> list[FitResult]:
    """The fits of one axis of all units."""
    asked = NoiseModel.parse(model, signals[0].unit)
    named = [replace(s, name=f"{axis}@{k}") for k, s in enumerate(signals)]
    if any(p.shared for p in asked):
        say(f"{axis}: the units together")
        found = fit_together(named, {s.name: asked for s in named})
        return [found[s.name] for s in named]
    out = []
    for k, s in enumerate(named):
        say(f"{axis}: unit {k + 1} of {len(named)}")
        out.append(fit(s, asked))
    return out


@dataclass(frozen=True)
class _Array:
    """The models of the units, and what weights make of them."""

    flight: Flight
    fits: Mapping[str, Sequence[FitResult]]
    plus: Mapping[str, NoiseModel]

    @property
    def models(self) -> dict[str, list[NoiseModel]]:
        return {a: [r.model + self.plus[a] for r in of] for a, of in self.fits.items()}

    @property
    def shared(self) -> dict[str, Sequence[Seen]]:
        """Shared processes: a name is one process per axis."""
        out: dict[str, Sequence[Seen]] = {}
        for axis, of in self.fits.items():
            found = shared_processes({f"{axis}@{k}": r.model for k, r in enumerate(of)})
            out.update({f"{axis} {name}": members for name, members in found.items()})
        return out

    def belief(self, weights: Mapping[str, Array]) -> dict[str, NoiseModel]:
        """The virtual sensor's model: the structure of the units, nearest to the curve of the weighted sum."""
        out = {}
        for axis, of in self.fits.items():
            curve = of[0].curve
            assert curve is not None
            w, dt = weights[axis], 1.0 / curve.rate_hz
            whole = NoiseModel(tuple(_summed([r.model for r in of], w)))
            asked = NoiseModel(tuple(replace(p, shared="") for p in of[0].structure))
            expected = whole.wavelet_variance(curve.scale_samples, dt)
            found = fit(replace(curve, value=expected), asked, unit=of[0].unit, name=axis, weighting="intervals")
            size = float(np.sqrt(np.sum(w**2)))
            out[axis] = found.model + self.plus[axis].scaled(size) if len(self.plus[axis]) else found.model
        return out

    def form(self, weights: Mapping[str, Array]) -> tuple[Quadratic, Response]:
        response = self.flight.response(self.belief(weights))
        return quadratic(response, self.models, self.shared, self.flight.own), response

    def regressed(self, response: Response) -> tuple[Array, Array]:
        """Mean and variance of the logarithm of what every unit's axis is worth, (axes units,)."""
        axes = [a for a in AXES if a in self.fits]
        found: dict[str, tuple[Array, Array]] = {}
        for axis in axes:
            worth, variance = [], []
            for r in self.fits[axis]:

                def of(model: NoiseModel, axis: str = axis) -> float:
                    return response.of_model(model + self.plus[axis], axis)

                worth.append(np.log(max(of(r.model), 1e-300)))
                variance.append(log_variance(of, r.model, r.details["free"], r.covariance))
            found[axis] = np.array(worth), np.array(variance)
        for sensor in ("gyro", "accel"):
            mine = [a for a in axes if a.startswith(sensor)]
            found.update(zip(mine, ways.regressed([found[a] for a in mine]), strict=True))
        return np.concatenate([found[a][0] for a in axes]), np.concatenate([found[a][1] for a in axes])

    def settled(self, start: Weights, spread: tuple[Array, Array], say: Callable[[str], None]) -> Weights:
        """The weights of least expected mean square, the belief renewed until they stay."""
        now = start
        worth = spread[0] + 0.5 * spread[1]
        factor: Array | None = None
        for number in range(ROUNDS):
            form, _ = self.form(now)
            if (
                factor is None
            ):  # what the units are worth relative to their estimates, which hardly depends on the belief
                factor = np.exp(0.5 * worth) / np.sqrt(np.maximum(np.diag(form.G), 1e-300))
            better = form.scaled(factor).best()
            moved = max(float(np.abs(better[a] - now[a]).max()) for a in now)
            say(f"weights, round {number + 1}: the largest change is {moved:.2g}")
            now = better
            if moved < SETTLED:
                break
        return now


def _summed(models: Sequence[NoiseModel], weights: Array) -> list[Process]:
    """The processes of a weighted sum of units; one that they share is one."""
    out: list[Process] = []
    for model, w in zip(models, weights, strict=True):
        out += [p.scaled(abs(float(w))) for p in model if not p.shared]
    for members in shared_processes({str(k): m for k, m in enumerate(models)}).values():
        total = abs(sum(float(weights[int(s.axis)]) * s.weight for s in members))
        level = members[0].process.level
        value = total if level.power == 1 else total**2
        out.append(replace(members[0].process.with_parameters({level.name: value}), shared=""))
    return out


def _dependent(
    fits: Mapping[str, Sequence[FitResult]], matrices: Mapping[str, tuple[Array, Array]], units: Sequence[str]
) -> tuple[tuple[str, str, str, float], ...]:
    """Pairs of units that are not independent, of axes whose model shares nothing."""
    pairs = [(i, k) for i in range(len(units)) for k in range(i)]
    out = []
    for axis, (_, p) in matrices.items():
        if any(q.shared for q in fits[axis][0].structure):
            continue
        out += [
            (axis, units[k], units[i], float(p[i, k]))
            for i, k in pairs
            if p[i, k] < DEPENDENT / (len(pairs) * len(matrices))
        ]
    return tuple(sorted(out, key=lambda row: row[-1]))
