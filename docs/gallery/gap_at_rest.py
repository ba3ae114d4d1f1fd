"""A fan that the nominal model does not know, named from a log at rest."""

import matplotlib.pyplot as plt
import numpy as np

import insemu as ins
from insemu.gap import find_static_gap

white = ins.NoiseModel((ins.WN(N=1e-3),))
truth = ins.NoiseModel((ins.WN(N=1e-3), ins.SIN(alpha=2e-3, f=17.3)))
log = ins.Series(truth.simulate(20_000, 0.02, np.random.default_rng(1)), 50.0, "rad/s", "gyro_x")
report = find_static_gap([log], {"gyro_x": white}, rng=np.random.default_rng(2))
print(report)
figure, axes = plt.subplots()
report.plot(axes)
axes.legend()
