"""A candidate of one's own: the wander that a thermostat of 45 s leaves. Run it: python docs/own_candidate.py."""

# --- example
import numpy as np

from insemu.gap import find_static_gap, register
from insemu.gap.candidates.axis import AxisHypothesis, AxisState, best_of
from insemu.gap.evidence.model import Component
from insemu.gap.evidence.modes import Free
from insemu.noise import GM, WN, NoiseModel
from insemu.records import Series


def thermostat(state: AxisState) -> list[AxisHypothesis]:
    """A Gauss-Markov process whose correlation time is known: only its size is free."""
    top = 100.0 * state.white
    free = (Free("sigma", 1e-5 * top, top),)
    starts = [
        state.explanation.with_component(Component(GM(top * size, 1.0 / 45.0), free, "thermostat"))
        for size in np.geomspace(1e-4, 1.0, 12)
    ]
    return best_of(state, "thermostat", "", starts)


def example() -> str:
    """Hide such a wander in an hour of a gyroscope at rest and look for it."""
    register("thermostat", thermostat)
    rng = np.random.default_rng(1)
    truth = NoiseModel((WN(1e-3), GM(1e-3, 1.0 / 45.0)))
    log = Series(truth.simulate(36_000, 0.1, rng), 10.0, "rad/s", "gyro_x")
    report = find_static_gap([log], {"gyro_x": NoiseModel((WN(1e-3),))}, rng=rng, hold_out=False)
    finding = report.findings[0]
    sigma = finding.parameters[0]
    others = ", ".join(m.effect for m in finding.members[1:]) or "nothing"
    return (
        f"{finding.effect}: sigma {sigma.value:.2e} [{sigma.low:.2e}, {sigma.high:.2e}] rad/s; {others} within 3 nats"
    )


if __name__ == "__main__":
    print(example())
# --- end
