"""An Allan deviation does not see a mean: two logs with and without a turn-on bias look the same."""

import matplotlib.pyplot as plt
import numpy as np

from insemu.variance import allan_variance

x = 1e-3 * np.random.default_rng(10).standard_normal(20_000)
for bias, mark in ((0.0, "o"), (0.01, "x")):
    curve = allan_variance(x + bias, 100.0)
    plt.loglog(curve.tau_s, np.sqrt(curve.value), mark, label=f"mean {bias} rad/s")
plt.xlabel("averaging time (s)")
plt.ylabel("Allan deviation (rad/s)")
plt.legend()
