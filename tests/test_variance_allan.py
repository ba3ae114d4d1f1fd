"""The Allan family against a peer, its own laws and its degrees of freedom."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from insemu.errors import InputError
from insemu.noise import WN
from insemu.variance import allan_variance, relative_error, wavelet_variance
from tests.test_variance_wavelet import fixture

PEERS = {
    "non-overlapping": "adev",
    "overlapping": "oadev",
    "modified": "mdev",
    "hadamard": "hdev",
    "overlapping-hadamard": "ohdev",
    "total": "totdev",
}


@pytest.mark.parametrize("kind", PEERS)
@pytest.mark.parametrize("grid", ["octave", "decade", "all"])
def test_every_kind_equals_allantools(kind: Any, grid: Any) -> None:
    allantools = pytest.importorskip("allantools")
    rng = np.random.default_rng(1)
    x = 9.8 + rng.standard_normal(1500) + 0.05 * rng.standard_normal(1500).cumsum()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tau, deviation, _, _ = getattr(allantools, PEERS[kind])(x, rate=10.0, data_type="freq", taus=grid)
    m = np.round(tau * 10).astype(int)
    mine = allan_variance(x, 10.0, kind=kind, grid=grid)
    common, theirs, ours = np.intersect1d(m, mine.m, return_indices=True)
    assert common.size >= m.size - 1  # the peer also prints a longest time of which there is one term only
    np.testing.assert_allclose(mine.deviation[ours], deviation[theirs], rtol=1e-9)


@pytest.mark.parametrize(
    ("peer", "kind", "span"),
    [("avar_mo_cluster", "overlapping", 2), ("hadamard_mo_cluster", "overlapping-hadamard", 3)],
)
def test_the_r_packages_leave_out_the_last_term_but_divide_by_all(peer: str, kind: Any, span: int) -> None:
    x, rows = fixture("wn", peer)
    s = np.concatenate([[0.0], np.cumsum(x)])
    for m, value in rows[:5, :2]:
        m = int(m)
        ours = allan_variance(x, kind=kind, grid=[m]).value[0]
        weights = {2: (1, -2, 1), 3: (-1, 3, -3, 1)}[span]
        last = sum(w * s[len(x) - (span - k) * m] for k, w in enumerate(weights))
        terms = len(x) + 1 - span * m
        np.testing.assert_allclose(ours - last**2 / (terms * m * m * {2: 2, 3: 6}[span]), value, rtol=1e-9)


def test_allan_variance_is_twice_the_haar_wavelet_variance() -> None:
    x = np.random.default_rng(2).standard_normal(3000).cumsum()
    a, w = allan_variance(x, 5.0), wavelet_variance(x, 5.0)
    np.testing.assert_allclose(a.value, 2.0 * w.value, rtol=1e-12)
    np.testing.assert_allclose(a.tau_s, w.tau_s / 2.0)
    np.testing.assert_allclose(allan_variance(x, 5.0, grid=a.m).value, a.value, rtol=1e-9)


def test_hadamard_does_not_see_a_drift() -> None:
    ramp = np.arange(2000) * 0.01
    assert allan_variance(ramp).value.max() > 1.0
    assert allan_variance(ramp, kind="overlapping-hadamard").value.max() < 1e-18


@pytest.mark.parametrize("kind", PEERS)
def test_degrees_of_freedom_describe_the_scatter(kind: Any) -> None:
    rng = np.random.default_rng(3)
    runs = [allan_variance(WN(N=1.0).simulate(512, 1.0, rng), kind=kind) for _ in range(500)]
    value = np.array([r.value for r in runs])
    drawn = 2.0 * value.mean(axis=0) ** 2 / value.var(axis=0)
    stated = np.median([r.edof for r in runs], axis=0)
    use = stated > 3
    # a variance of 500 draws of a chi-square with few degrees of freedom scatters by 10-15 %
    np.testing.assert_allclose(stated[use], drawn[use], rtol=0.45)


def test_relative_error_by_clusters() -> None:
    # the example of Quinchia et al. 2013: 360000 samples, clusters of 60000
    assert abs(float(relative_error(360_000, 60_000)) - 0.316) < 1e-3
    a = allan_variance(np.random.default_rng(4).standard_normal(1000), intervals="clusters")
    np.testing.assert_allclose(np.sqrt(a.high) / a.deviation - 1.0, relative_error(1000, a.m))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"kind": "parallel"}, "expected one of: overlapping"),
        ({"grid": "dense"}, "expected one of: octave, decade, all"),
        ({"grid": [400]}, "at most"),
        ({"grid": [0]}, "whole numbers"),
        ({"intervals": "bootstrap"}, "expected one of: edof"),
    ],
)
def test_bad_options_are_refused(arguments: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        allan_variance(np.arange(300.0) % 7, **arguments)
