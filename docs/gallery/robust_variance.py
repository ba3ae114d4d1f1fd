"""One outlier in a thousand lifts the wavelet variance; the robust one stays."""

import matplotlib.pyplot as plt
import numpy as np

from insemu.variance import robust_wavelet_variance, wavelet_variance

rng = np.random.default_rng(4)
x = rng.standard_normal(30_000)
x[rng.integers(0, x.size, 30)] += 20.0
for label, curve in (("plain", wavelet_variance(x, 100.0)), ("robust", robust_wavelet_variance(x, 100.0))):
    plt.loglog(curve.tau_s, curve.value, "o-", label=label)
plt.loglog(curve.tau_s, 1 / curve.scale_samples, "k--", label="without outliers")
plt.xlabel("scale (s)")
plt.ylabel("wavelet variance")
plt.legend()
