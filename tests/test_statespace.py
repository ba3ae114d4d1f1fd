"""Likelihood and smoother against dense Gaussian algebra."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from insemu.errors import InputError
from insemu.noise import AR, GM, QN, RW, WN, StateBlock
from insemu.statespace import log_likelihood, smooth

MODELS = [
    WN(0.1) + GM(0.5, 2.0),
    WN(0.1) + RW(0.4, sigma0=0.3),
    WN(0.05) + GM(0.5, 2.0) + RW(0.2) + QN(0.01),
    WN(0.05) + AR((0.5, 0.3), sigma2=0.2, rate_hz=10.0),
]


def dense(block, n, u):
    """Mean and covariance of all states and of the signal by stacking."""
    d = block.n
    mean, P = np.zeros(d), np.array(block.P0)
    means, covs = [], np.zeros((n * d, n * d))
    diagonal = []
    for _ in range(n):
        mean = block.Phi @ mean + u
        P = block.Phi @ P @ block.Phi.T + block.Q
        means.append(mean)
        diagonal.append(P)
    for i in range(n):
        C = diagonal[i]
        for j in range(i, n):
            covs[j * d : (j + 1) * d, i * d : (i + 1) * d] = C
            covs[i * d : (i + 1) * d, j * d : (j + 1) * d] = C.T
            C = block.Phi @ C
    H = np.kron(np.eye(n), block.c)
    return np.concatenate(means), covs, H


@pytest.mark.parametrize("model", MODELS, ids=str)
def test_filter_and_smoother_equal_dense_conditioning(model):
    rng = np.random.default_rng(2)
    n, dt = 40, 0.1
    block = model.block(dt)
    u = rng.normal(0, 0.05, block.n)
    y = model.simulate(n, dt, rng)
    mean, C, H = dense(block, n, u)
    S = H @ C @ H.T + np.eye(n) * block.white
    e = y - H @ mean
    expected = -0.5 * (np.linalg.slogdet(2 * np.pi * S)[1] + e @ np.linalg.solve(S, e))
    assert_allclose(log_likelihood(block, y, u=u), expected, rtol=1e-10)
    K = C @ H.T @ np.linalg.inv(S)
    posterior, after = mean + K @ e, C - K @ H @ C
    got = smooth(block, y, u=u)
    d = block.n
    assert_allclose(got.mean.ravel(), posterior, atol=1e-8 * np.abs(posterior).max())
    pieces = [[after[i * d : (i + 1) * d, j * d : (j + 1) * d] for j in range(n)] for i in range(n)]
    size = np.abs(after).max()
    assert_allclose(got.variance, [np.diag(pieces[i][i]) for i in range(n)], atol=1e-8 * size)
    assert_allclose(got.sum_now, sum(pieces[i][i] for i in range(1, n)), atol=1e-7 * size * n)
    assert_allclose(got.sum_cross, sum(pieces[i][i - 1] for i in range(1, n)), atol=1e-7 * size * n)
    assert_allclose(got.sum_before, sum(pieces[i][i] for i in range(n - 1)), atol=1e-7 * size * n)
    assert_allclose(got.log_likelihood, expected, rtol=1e-10)


def test_settled_covariances_change_nothing():
    # long enough to settle: the second half must equal a run that starts with the settled covariance
    rng = np.random.default_rng(3)
    model = WN(0.1) + GM(0.5, 2.0)
    block = model.block(0.1)
    y = model.simulate(3000, 0.1, rng)
    S = np.empty(0)
    # dense likelihood of a record of 1500 samples through a Cholesky factor
    from scipy.linalg import cho_factor, cho_solve

    lag = np.arange(1500)
    row = model.autocovariance(lag, 0.1)
    S = row[np.abs(lag[:, None] - lag[None, :])]
    factor = cho_factor(S)
    expected = (
        -np.log(np.diag(factor[0])).sum() - 0.5 * (y[:1500] @ cho_solve(factor, y[:1500])) - 750 * np.log(2 * np.pi)
    )
    assert_allclose(log_likelihood(block, y[:1500]), expected, rtol=1e-9)


def test_white_noise_alone_and_errors():
    y = np.array([1.0, -2.0, 0.5])
    block = StateBlock.empty(1.0, 2.0)
    assert_allclose(log_likelihood(block, y), -1.5 * np.log(4 * np.pi) - y @ y / 4)
    with pytest.raises(InputError, match="smooth"):
        smooth(block, y)
    with pytest.raises(InputError, match="sample 1"):
        log_likelihood(block, [1.0, np.nan])
