"""Do 95 % intervals hold the truth? Two hundred fits of white noise."""

import matplotlib.pyplot as plt
import numpy as np

import insemu as ins

rng = np.random.default_rng(7)
fits = [ins.fit(ins.WN(N=1.0).simulate(2048, 1.0, rng), "WN()", rate=1.0)["WN1.N"] for _ in range(200)]
order = np.argsort([e.value for e in fits])
inside = np.array([e.low <= 1.0 <= e.high for e in fits])
print(f"{inside.sum()} of {inside.size} intervals hold the truth")
for k, i in enumerate(order):
    plt.plot([k, k], [fits[i].low, fits[i].high], color="C0" if inside[i] else "C3", lw=1)
plt.axhline(1.0, color="k")
plt.ylabel("N")
