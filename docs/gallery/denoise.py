"""Wavelet de-noising shows the slow noise below the white one."""

import matplotlib.pyplot as plt
import numpy as np

import insemu as ins
from insemu.denoise import denoise

t = np.arange(2**14) * 0.1
slow = ins.GM(sigma=1.0, Tc="200 s").simulate(t.size, 0.1, np.random.default_rng(8))
x = slow + np.random.default_rng(9).standard_normal(t.size)
plt.plot(t, x, lw=0.3, color="0.7", label="measured")
plt.plot(t, denoise(x, 6), lw=1.0, label="de-noised, 6 octaves")
plt.plot(t, slow, "k--", lw=0.8, label="truth")
plt.xlabel("time (s)")
plt.legend()
