"""Filters that are wrong on purpose, for the referee: ``insemu referee tests/wrong_filters.py:Small``."""

from dataclasses import replace

import numpy as np

from insemu.filters import LooselyCoupledEKF

#: What sigmas are multiplied with.
FACTOR = 0.8


class Small:
    """The extended Kalman filter whose sigmas, all of them, are 20 % too small: the same estimates and gains."""

    def __init__(self, belief, dt, *, gnss_sigma, options, **parts):
        small = {axis: model.scaled(FACTOR) for axis, model in belief.items()}
        options = replace(options, imposed_gnss_sigma=True)
        self.inner = LooselyCoupledEKF(
            small, dt, gnss_sigma=tuple(FACTOR * s for s in gnss_sigma), options=options, **parts
        )

    def run(self, imu, gnss, initial, initial_sigma):
        scaled = type(initial_sigma)(
            **{name: FACTOR * np.asarray(getattr(initial_sigma, name)) for name in ("position", "velocity", "attitude")}
        )
        return self.inner.run(imu, gnss, initial, scaled)


class SmallAttitude:
    """Estimates of the extended Kalman filter, and sigmas of the attitude that are half of its own."""

    def __init__(self, belief, dt, **parts):
        self.inner = LooselyCoupledEKF(belief, dt, **parts)

    def run(self, imu, gnss, initial, initial_sigma):
        run = self.inner.run(imu, gnss, initial, initial_sigma)
        factor = np.ones(run.layout.n)
        factor[6:9] = 0.5
        return replace(run, covariance=run.covariance * factor[:, None] * factor)
