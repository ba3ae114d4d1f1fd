"""Allan deviations of three axes with their intervals, and what can be read off them."""

import matplotlib.pyplot as plt
import numpy as np

import insemu as ins

rng = np.random.default_rng(3)
log = []
for axis, size in zip("xyz", (0.2, 0.3, 0.6), strict=True):
    model = ins.WN(N=f"{size} deg/sqrt(h)") + ins.RW(K="60 deg/h/sqrt(h)")
    log.append(ins.Series(model.simulate(40_000, 0.02, rng), 50.0, "rad/s", f"gyro_{axis}"))
reports = ins.characterise(log)
print(reports["gyro_x"])
figure, axes = plt.subplots()
reports.plot(axes)
axes.legend(fontsize=7)
