"""Gauss-Markov states that stand for bias instability between two averaging times."""

import matplotlib.pyplot as plt
import numpy as np

import insemu as ins

flicker = ins.BI(B=1.0, tau_from=1.0, tau_to=1000.0)
m = np.unique(np.geomspace(1, 1e6, 120).astype(int))
plt.loglog(0.01 * m, np.sqrt(flicker.allan_variance(m, 0.01)), "k--", label="BI")
plt.loglog(0.01 * m, np.sqrt(flicker.block(0.01).allan_variance(m)), label="its states in a filter")
plt.ylim(0.1, 1.5)
plt.xlabel("averaging time (s)")
plt.ylabel("Allan deviation over B")
plt.legend()
