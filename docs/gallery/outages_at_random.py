"""Outages drawn at random, each realization its own."""

import matplotlib.pyplot as plt
import numpy as np

from insemu.emulate import random_outages

for k, rng in enumerate(np.random.default_rng(11).spawn(12)):
    for outage in random_outages(0.0, 3600.0, per_hour=8.0, mean_s=90.0, clear_s=300.0, rng=rng):
        plt.plot([outage.start_s / 60, outage.end_s / 60], [k, k], lw=6, color="C3", solid_capstyle="butt")
plt.xlabel("time (min)")
plt.ylabel("realization")
