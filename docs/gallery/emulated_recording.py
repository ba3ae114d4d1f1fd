"""What an IMU records on a drive."""

import matplotlib.pyplot as plt
import numpy as np

import insemu as ins

drive = ins.emulate(
    {
        "title": "A drive",
        "trajectory": {"builtin": "urban_drive_1", "rate": "50 Hz", "duration": "2 min"},
        "truth": {"gyro": "WN(N=0.2 deg/sqrt(h))", "accel": "WN(N=100 ug/sqrt(Hz))"},
    }
)
imu = drive.imu
figure, (top, bottom) = plt.subplots(2, 1, sharex=True)
top.plot(imu.t[1:], np.rad2deg(imu.gyro[1:]) / imu.dt)
top.set(ylabel="increments as rates (deg/s)")
bottom.plot(imu.t[1:], imu.accel[1:] / imu.dt)
bottom.set(xlabel="time (s)", ylabel="specific force (m/s²)")
bottom.legend(["forward", "right", "down"])
