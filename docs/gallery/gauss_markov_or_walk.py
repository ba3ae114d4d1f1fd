"""A random walk wanders off, a Gauss-Markov process stays at its level."""

import matplotlib.pyplot as plt
import numpy as np

import insemu as ins

t = np.arange(5000) * 0.1
rng = np.random.default_rng(6)
figure, panels = plt.subplots(1, 2, sharey=True, figsize=(8, 3))
for panel, process in zip(panels, (ins.RW(K=0.2), ins.GM(sigma=1.0, Tc="50 s")), strict=True):
    for _ in range(8):
        panel.plot(t, process.simulate(t.size, 0.1, rng), lw=0.7)
    panel.set(title=process.symbol, xlabel="time (s)")
