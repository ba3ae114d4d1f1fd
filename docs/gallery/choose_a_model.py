"""Which of all models nested in a general one the data support."""

import matplotlib.pyplot as plt
import numpy as np

import insemu as ins

truth = ins.WN(N="0.3 deg/sqrt(h)") + ins.RW(K="100 deg/h/sqrt(h)")
x = truth.simulate(60_000, 0.02, np.random.default_rng(2))
ranking = ins.select(ins.Series(x, 50.0, "rad/s", "gyro_z"), "GM() + WN() + RW()")["gyro_z"]
print(ranking)
table = ranking.to_dataframe()
plt.barh(table.index[::-1], table["criterion"][::-1] - table["criterion"].min() + 1)
plt.xscale("log")
plt.xlabel("criterion above the best, plus 1")
plt.tight_layout()
