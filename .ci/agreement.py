"""Whether kernels that were compiled elsewhere give the numbers of those that numba compiles here for this very processor.

python .ci/agreement.py            in the environment that has the wheel; compiles filter, smoother and a wavelet variance anew, apart
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

#: Of the largest value of an array.
TOLERANCE = 1e-12


def answers(out: Path) -> None:
    """Filter, smoother, wavelet variance and drawn noise of fixed data."""
    from insemu.filters import FilterOptions, InitialSigma, LooselyCoupledEKF, smooth
    from insemu.noise import GM, WN
    from insemu.records import AXES, GnssRecord, ImuRecord
    from insemu.strapdown import NavState
    from insemu.variance import wavelet_variance

    rng = np.random.default_rng(7)
    dt, n, llh = 0.01, 2001, np.array([0.8, 0.1, 0.0])
    t = np.arange(n) * dt
    gyro = 1e-3 * rng.standard_normal((n, 3)) + 0.05 * np.sin(t)[:, None]
    imu = ImuRecord(t, gyro, np.array([0.3, 0.1, -9.8]) + 1e-2 * rng.standard_normal((n, 3)))
    fixes = GnssRecord(t[100::100], llh + 1e-7 * rng.standard_normal((20, 3)), 0.1 * rng.standard_normal((20, 3)))
    models = {axis: WN(N=1e-3) + GM(sigma=1e-3, beta=0.1) for axis in AXES}
    ekf = LooselyCoupledEKF(models, dt, gnss_sigma=(1.0, 1.0), options=FilterOptions(store="fixes"))
    start, sigma = NavState(llh, np.zeros(3), np.zeros(3)), InitialSigma(1.0, 0.1, 0.01)
    smoothed = smooth(ekf.run(imu, fixes, start, sigma))
    curve = wavelet_variance(rng.standard_normal(100_000), 100.0)
    noise = models[AXES[0]].simulate(50_000, dt, rng=rng)
    np.savez(
        out,
        nav=smoothed.nav,
        sigma=smoothed.sigma,
        states=smoothed.imu_states,
        curve=curve.value,
        edof=curve.edof,
        noise=noise,
    )


def main() -> None:
    """Both in processes of their own; the largest disagreement of each array."""
    from llvmlite import binding

    here = {
        "NUMBA_CPU_NAME": binding.get_host_cpu_name(),
        "NUMBA_CPU_FEATURES": binding.get_host_cpu_features().flatten(),
    }
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / name for name in ("given.npz", "here.npz")]
        for file, more in zip(files, ({}, here), strict=True):
            environment = os.environ | more | {"NUMBA_CACHE_DIR": f"{folder}/{file.stem}"}
            subprocess.run([sys.executable, __file__, str(file)], check=True, env=environment)
        given, made = (np.load(file) for file in files)
        for name in given.files:
            apart = float(np.max(np.abs(given[name] - made[name])) / np.max(np.abs(made[name])))
            print(f"kernels: {name} of {here['NUMBA_CPU_NAME']} and as given: {apart:.1e} of the largest value apart")
            if not apart <= TOLERANCE:
                sys.exit(f"kernels: {name} differs by more than {TOLERANCE:g}")


if __name__ == "__main__":
    answers(Path(sys.argv[1])) if len(sys.argv) > 1 else main()
