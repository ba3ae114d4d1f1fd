"""Figures of a datasheet as noise models."""

import matplotlib.pyplot as plt
import numpy as np

from insemu.sensors import models

m = 2 ** np.arange(0, 18)
for name in ("ADIS16405", "ADIS16470", "ADIS16488"):
    gyro = models(name)["gyro_x"]
    noise = [p for p in gyro if not p.single_draw]
    value = sum(p.allan_variance(m, 0.01) for p in noise)
    plt.loglog(0.01 * m, np.rad2deg(np.sqrt(value)) * 3600, label=name)
plt.xlabel("averaging time (s)")
plt.ylabel("Allan deviation of the gyroscope (deg/h)")
plt.legend()
