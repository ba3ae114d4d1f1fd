"""A noise model fitted to a signal, with its intervals and a test whether the data bear it."""

import matplotlib.pyplot as plt
import numpy as np

import insemu as ins

truth = ins.WN(N="0.3 deg/sqrt(h)") + ins.GM(sigma="20 deg/h", Tc="20 s")
x = truth.simulate(60_000, 0.02, np.random.default_rng(1))
result = ins.fit(ins.Series(x, 50.0, "rad/s", "gyro_z"), "WN() + GM()")
print(result)
figure, axes = plt.subplots()
result.plot(axes)
axes.legend(fontsize=7)
