"""The Allan deviation of a sum of noises and of its parts."""

import matplotlib.pyplot as plt
import numpy as np

import insemu as ins

parts = [ins.WN(N="0.3 deg/sqrt(h)"), ins.GM(sigma="20 deg/h", Tc="60 s"), ins.RW(K="5 deg/h/sqrt(h)")]
m = 2 ** np.arange(0, 18)
models: list[ins.NoiseModel | ins.Process] = [parts[0] + parts[1] + parts[2], *parts]
for model in models:
    plt.loglog(0.01 * m, np.rad2deg(np.sqrt(model.allan_variance(m, 0.01))) * 3600, label=str(model).split("(")[0])
plt.xlabel("averaging time (s)")
plt.ylabel("Allan deviation (deg/h)")
plt.legend(["sum", "WN", "GM", "RW"])
