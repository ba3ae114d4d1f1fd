"""An effect injected into an ideal IMU: a scale factor shows in turns alone."""

import matplotlib.pyplot as plt
import numpy as np

import insemu as ins
from insemu.effects import EffectUse
from insemu.emulate import built_in

flight = built_in("urban_drive_1")
ideal = ins.ideal_imu(flight, 20.0)
use = EffectUse.from_mapping({"effect": "scale_factor", "sensor": "gyro", "value": "2000 ppm"})
out = ins.corrupt(ideal.imu, None, np.random.default_rng(1), effects=[use], reference=ideal.reference)
n = 6000
difference = np.rad2deg(out.imu.gyro[:n, 2] - ideal.imu.gyro[:n, 2]) * 20.0
plt.plot(ideal.imu.t[:n], difference)
plt.xlabel("time (s)")
plt.ylabel("error of the vertical gyroscope (deg/s)")
