"""A process of one's own, known by its name to text, fits and filters."""

from dataclasses import dataclass
from typing import ClassVar

import matplotlib.pyplot as plt
import numpy as np

import insemu as ins
from insemu.noise import Parameter, StateBlock


@ins.register_process
@dataclass(frozen=True)
class Slow(ins.Process):
    """A Gauss-Markov process of 100 s: only its size is free."""

    PARAMETERS: ClassVar = (Parameter("sigma", "{u}", "positive", "standard deviation"),)
    sigma: float | None = None

    def block(self, dt: float) -> StateBlock:
        """The block of the Gauss-Markov process that it is."""
        return ins.GM(sigma=self.sigma, Tc=100.0).block(dt)


model = ins.NoiseModel.parse("WN(N=0.1) + Slow(sigma=0.05)")
plt.plot(np.arange(20_000) * 0.1, model.simulate(20_000, 0.1, np.random.default_rng(1)), lw=0.4)
plt.xlabel("time (s)")
