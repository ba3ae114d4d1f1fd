"""How far an IMU drifts on its own."""

import matplotlib.pyplot as plt

import insemu as ins
from insemu.emulate import dead_reckon

scenario = {
    "title": "Free inertial",
    "trajectory": {"builtin": "helicopter_mapping", "rate": "50 Hz", "duration": "60 s"},
    "truth": {"gyro": "WN(N=0.2 deg/sqrt(h)) + RC(sigma=5 deg/h)", "accel": "WN(N=60 ug/sqrt(Hz)) + RC(sigma=0.2 mg)"},
}
for realization in range(5):
    result = dead_reckon(ins.emulate(scenario, realization=realization))
    plt.plot(result.t, result.errors[:, 0])
print(f"{result.final_position_error_m:.1f} m after {result.end_s:.0f} s")
plt.xlabel("time (s)")
plt.ylabel("position error (m)")
