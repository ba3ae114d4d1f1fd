"""What a record cannot tell, said in plain words with what it can support instead."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from insemu.fit.minimum import Problem, Solution
from insemu.noise import NoiseModel, process_label

Array = NDArray[np.float64]

#: A part below this share of the fitted curve at every scale leaves no trace.
TRACE = 1e-3
#: A GM that stands for the white noise with a correlation time of this many samples or more is coloured measurably.
COLOURED = 0.3


def warnings_of(
    problem: Problem, at: Solution, model: NoiseModel, free: list[tuple[int, str]], covariance: Array
) -> list[str]:
    """Warnings about a solution: parts that vanish, correlation times beyond the record or below a sample, parts that coincide.

    Parameters
    ----------
    problem : Problem
    at : Solution
    model : NoiseModel
        The solution, specified.
    free : list of (process number, parameter name)
    covariance : (p, p) array
        Of the free parameters.
    """
    out: list[str] = []
    structure, coefficients = problem.structure, at.coefficients
    columns, _ = structure.columns(problem.scale / 2.0, at.shapes)
    parts = columns * coefficients
    total = parts.sum(axis=1)
    labels = [process_label(p.symbol, index) for index, p in model.indexed()]
    shares = (parts / total[:, None]).max(axis=0)
    vanished = [k for k in range(len(labels)) if structure.fixed[k] < 0 and shares[k] < TRACE]
    for k in vanished:
        simpler = NoiseModel(tuple(p for i, p in enumerate(structure.model) if i != k))
        advice = f"; the data support {_shape(simpler)}" if len(simpler) else ""
        amount = "zero" if coefficients[k] == 0 else f"below {TRACE:.1%} of the curve at every scale"
        out.append(f"{labels[k]}: its variance is {amount}, so it is not identifiable{advice}")
    record = problem.n * structure.dt
    times: list[tuple[int, float]] = []
    for k, p in enumerate(model):
        time = p.correlation_time(structure.dt)
        if k in vanished or time is None:
            continue
        times.append((k, time))
        if not np.isnan(structure.held[structure.offsets[k]]):
            continue
        if time > record / 2.0:
            has_walk = any(q.symbol == "RW" for q in model)
            instead = "leave it out, the model has an RW already" if has_walk else "use RW() instead"
            what = "longer than" if time > record else "longer than half of"
            out.append(
                f"{labels[k]}: correlation time {time:.3g} s is {what} the record ({record:.3g} s) and cannot be distinguished from a "
                f"random walk; {instead}"
            )
        elif time < 0.7 * structure.dt:
            white = [i for i, q in enumerate(model) if q.symbol == "WN" and i not in vanished]
            below = f"{labels[k]}: correlation time {time:.3g} s is below the sampling interval ({structure.dt:.3g} s)"
            if not white and time > COLOURED * structure.dt:
                out.append(
                    f"{below}: it stands in for the white noise, coloured over a sample or two (an averaging filter in the sensor does that)"
                )
            else:
                instead = "leave it out, the model has a WN already" if white else "use WN() instead"
                out.append(f"{below} and can hardly be distinguished from white noise; {instead}")
    times.sort(key=lambda item: item[1])
    for (k, one), (h, two) in pairwise(times):
        if two / one < 1.3:
            out.append(
                f"{labels[k]} and {labels[h]} coincide (correlation times {one:.3g} s and {two:.3g} s); the data support one of them"
            )
    place = {key: i for i, key in enumerate(free)}
    for (k, name), i in place.items():
        if k in vanished:
            continue
        held = model.processes[k].parameters[name]
        error = math.sqrt(covariance[i, i]) if covariance[i, i] >= 0 else math.nan
        if not math.isfinite(error):
            out.append(f"{labels[k]}.{name} is not determined by these scales")
        elif name not in ("phi", "R") and not name.startswith(("ar_", "ma_")) and held > 0 and error > 1.5 * held:
            out.append(f"{labels[k]}.{name} is hardly determined: standard error {error / held:.1f} times the value")
    return out


def _shape(model: NoiseModel) -> str:
    return str(NoiseModel(tuple(p for p in model)))
