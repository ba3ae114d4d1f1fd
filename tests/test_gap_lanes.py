"""Numbers side by side in compiled code."""

from __future__ import annotations

import numpy as np
from numba import njit

from insemu.gap.evidence.lanes import LANES, add, div, load, mul, spread, store, sub


@njit
def _through(a: np.ndarray, b: np.ndarray, out: np.ndarray) -> None:
    x, y = load(a, 1), load(b, LANES)
    store(out, 0, add(x, y))
    store(out, LANES, sub(x, y))
    store(out, 2 * LANES, mul(x, y))
    store(out, 3 * LANES, div(x, spread(4.0)))


def test_each_operation_is_that_of_eight_numbers_at_places_over_all_dimensions() -> None:
    rng = np.random.default_rng(3)
    a, b, out = rng.standard_normal(LANES + 1), rng.standard_normal((2, LANES)), np.zeros((4, LANES))
    _through(a, b, out)
    x, y = a[1:], b[1]
    np.testing.assert_allclose(out, [x + y, x - y, x * y, x / 4.0], rtol=1e-15)
