"""A spectrum with its interval beside the model that made it."""

import matplotlib.pyplot as plt
import numpy as np

import insemu as ins
from insemu.variance import average_frequencies, psd

model = ins.WN(N=1e-3) + ins.SIN(alpha=5e-3, f=17.3)
x = model.simulate(20_000, 0.01, np.random.default_rng(5))
found = average_frequencies(psd(x, 100.0))
plt.fill_between(found.f_hz, np.sqrt(found.low), np.sqrt(found.high), alpha=0.3, label="95 %")
plt.loglog(found.f_hz, np.sqrt(found.psd), label="Welch")
plt.axhline(1e-3, color="k", ls="--", label="white noise of the model")
plt.xlabel("frequency (Hz)")
plt.ylabel("root PSD (rad/s/√Hz)")
plt.legend()
