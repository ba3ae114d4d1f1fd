"""What only experiments ask of the maker of a log at rest: how far an effect is expected to lead its rivals, and what it is worth in one draw."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.trial.expected import GAUSSIAN, Log, component
from insemu.effects import EffectUse, having
from insemu.gap.data.log import Reduced, block_differences, block_length
from insemu.gap.evidence.model import Explanation, Likelihood, Regressors, fit
from insemu.gap.evidence.modes import Free
from insemu.noise import BI, GM, RW, Process

Array = NDArray[np.float64]
#: Effects that stand in for one another at the longest averaging times.
SLOW = tuple(sorted(having("slow")))


def leads_of(log: Log, use: EffectUse, beside: Sequence[EffectUse] = ()) -> dict[str, float]:
    """Nats by which a slow effect is expected to lead every other slow effect in its place; empty for any other effect.

    Telegraph noise counts as the Gauss-Markov process of its spectrum, and is no rival.
    """
    if use.id not in SLOW:
        return {}
    others = [u for u in beside if u.id in GAUSSIAN]
    full, mean = log.explained([*others, use])
    likelihood = log.expected(full, mean)
    rest, _ = log.explained(others)
    own = fit(likelihood, full).evidence
    best: dict[str, float] = {}
    for name, rival in rivals(log, use, rest, full):
        best[name] = max(best.get(name, -math.inf), fit(likelihood, rival).evidence)
    return {name: own - value for name, value in best.items()}


def rivals(log: Log, use: EffectUse, rest: Explanation, full: Explanation) -> list[tuple[str, Explanation]]:
    """The explanation with another slow effect in the place of one, from a few starts each."""
    T, block = log.n * log.dt, block_length(log.n, log.dt)
    own = next((c.process for c in reversed(full.components) if c.effect == use.id), None)
    if own is not None:
        size = math.sqrt(float(own.allan_variance(max(1, round(0.1 * log.n)), log.dt)))
    else:
        size = abs(use.values["R"][log.axis]) * T / 4.0
    size = max(size, log.white / math.sqrt(T))
    memory = Free("beta", 2.0 / T, 0.25 / log.dt)
    processes: list[tuple[str, Process, str, tuple[Free, ...]]] = [
        *(("random_walk", RW(size * a / math.sqrt(T)), "K", ()) for a in (1.0, 5.0)),
        *(("flicker", BI(size * a), "B", ()) for a in (0.7, 2.0)),
        *(
            ("gauss_markov", GM(size * a, b / T), "sigma", (memory,))
            for a, b in ((1.5, 4.0), (1.0, 20.0), (1.5, 100.0))
        ),
    ]
    out = [(name, rest.withcomponent(component(p, free, "rival", *more))) for name, p, free, more in processes]
    sigma = log.white / math.sqrt(block * log.dt)
    shapes: list[tuple[str, Array, Array]] = [
        ("ramp", np.full((log.n // block - 1, 1), block * log.dt), np.array([3.0 * sigma / T]))
    ]
    if log.temperature is not None and not any(r.effect == "temperature" for r in rest.regressors):
        d = log.temperature - log.temperature.mean()
        spread = float(np.std(d)) ** np.arange(1, 4)
        powers = block_differences(np.stack([d, d * d, d * d * d], axis=1), block)
        scales = np.asarray(3.0 * max(sigma, 0.3 * size) / spread, dtype=np.float64)
        shapes += [("temperature", powers[:, :k], scales[:k]) for k in (1, 3)]
    for name, columns, scales in shapes:
        shape = Regressors(name, tuple(f"c{k}" for k in range(columns.shape[1])), columns, scales)
        out.append((name, replace(rest, regressors=(*rest.regressors, shape))))
    kind = "gauss_markov" if use.id == "telegraph" else use.id
    return [(name, e) for name, e in out if name != kind]


def seen(log: Log, use: EffectUse, data: Reduced) -> float:
    """Nats that a Gaussian effect is worth in one recording to somebody who knows the truth and has only its numbers to fit."""
    likelihood = Likelihood(data)
    full, _ = log.explained([use])
    return fit(likelihood, full).evidence - fit(likelihood, log.nominal()).evidence
