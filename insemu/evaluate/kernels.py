"""A program that compiles the filter and the covariance analysis for other processes to load (:func:`insemu.compiled.compiled_beside`)."""

from __future__ import annotations

import numpy as np

from insemu.errors import InputError
from insemu.evaluate.covariance import analyse
from insemu.filters import FilterOptions, InitialSigma, LooselyCoupledEKF, smooth
from insemu.noise import GM, WN
from insemu.records import AXES, GnssRecord, ImuRecord
from insemu.strapdown import NavState


def main() -> None:
    """Fly two seconds at rest with a smoother, say so, and analyse the same."""
    dt, n, llh = 0.01, 201, np.array([0.8, 0.1, 0.0])
    t = np.arange(n, dtype=np.float64) * dt
    imu = ImuRecord(t, np.zeros((n, 3)), np.tile([0.0, 0.0, -9.8], (n, 1)))
    fixes = GnssRecord(t[100:101], llh[None], np.zeros((1, 3)))
    models = {axis: WN(N=1e-3) + GM(sigma=1e-3, beta=0.1) for axis in AXES}
    ekf = LooselyCoupledEKF(models, dt, gnss_sigma=(1.0, 1.0), options=FilterOptions(store="fixes"))
    start, sigma = NavState(llh, np.zeros(3), np.zeros(3)), InitialSigma(1.0, 0.1, 0.01)
    (run,) = ekf.run_many([imu], [fixes], [start], sigma)
    assert not isinstance(run, InputError)
    smooth(run)
    print("filter", flush=True)
    analyse(ekf, models, imu, fixes, start, sigma, budget_at=(1.5,), budget_states=("pos_n",))


if __name__ == "__main__":
    main()
