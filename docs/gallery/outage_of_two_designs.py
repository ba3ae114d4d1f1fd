"""Two designs through one outage: error and what each states."""

import matplotlib.pyplot as plt

import insemu as ins

results = ins.run(
    {
        "title": "Two designs",
        "trajectory": {"builtin": "helicopter_mapping", "rate": "50 Hz", "duration": "2 min"},
        "truth": {"gyro": "WN(N=0.03 deg/s/sqrt(Hz)) + GM(sigma=60 deg/h, Tc=40 s)", "accel": "WN(N=90 ug/sqrt(Hz))"},
        "gnss": {"position_sigma": "5 cm", "outages": [{"start": "80 s", "duration": "20 s"}]},
        "designs": {
            "white": {"gyro": "WN(N=0.03 deg/s/sqrt(Hz))", "accel": {"truth": True}},
            "complete": {"gyro": {"truth": True}, "accel": {"truth": True}},
        },
    },
    realizations=4,
)
print(results)
figure, axes = plt.subplots()
results.plot(axes)
axes.legend()
