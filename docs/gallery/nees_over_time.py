"""NEES tells whether a filter knows its error."""

import matplotlib.pyplot as plt
import numpy as np

import insemu as ins

belief = {"right": "WN(N=0.03 deg/s/sqrt(Hz))", "too sure": "WN(N=0.01 deg/s/sqrt(Hz))"}
results = ins.run(
    {
        "title": "NEES",
        "trajectory": {"builtin": "helicopter_mapping", "rate": "50 Hz", "duration": "90 s"},
        "truth": {"gyro": belief["right"], "accel": "WN(N=90 ug/sqrt(Hz))"},
        "gnss": {"position_sigma": "5 cm"},
        "designs": {name: {"gyro": model, "accel": {"truth": True}} for name, model in belief.items()},
    },
    realizations=4,
)
for name, nees in zip(results.names, results.to_xarray()["nees"].to_numpy(), strict=True):
    plt.semilogy(results.t, nees.mean(axis=0) / 9.0, label=name)
plt.axhline(1.0, color="k", ls="--")
plt.xlabel("time (s)")
plt.ylabel("NEES per degree of freedom")
plt.legend()
print({name: round(float(np.mean(n)) / 9, 2) for name, n in zip(results.names, results.nees, strict=True)})
