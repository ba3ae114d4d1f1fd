"""Quantiles of errors of any number of realizations: counts in buckets whose bounds grow by a constant factor.

Counts are whole numbers, so that sketches that are put together in any order are the same to the bit.

Source: Masson, Rim and Lee (2019), DDSketch: a fast and fully-mergeable quantile sketch with relative-error guarantees, section 2.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

#: Largest relative error of a quantile: that of the 95 % quantile of 10,000 errors by chance is about as large.
ACCURACY = 0.01
#: What is distinguished, m: smaller values count as the smallest one, larger ones as the largest.
SMALLEST, LARGEST = 1e-6, 1e9
_GROWTH = (1.0 + ACCURACY) / (1.0 - ACCURACY)
_BUCKETS = int(np.ceil(np.log(LARGEST / SMALLEST) / np.log(_GROWTH)))
_BOUNDS = SMALLEST * _GROWTH ** np.arange(_BUCKETS)
#: The value that stands for a bucket; the last one counts values that are not known.
_VALUES = np.append(2.0 * _BOUNDS / (_GROWTH + 1.0), np.nan)


def sketched(values: ArrayLike) -> scipy.sparse.csr_array:
    """One value (n,) each, not negative, as a sketch of n rows."""
    v = np.asarray(values, dtype=np.float64).ravel()
    bucket = np.where(np.isfinite(v), np.searchsorted(_BOUNDS[:-1], v), _BUCKETS).astype(np.int32)
    counts = np.ones(v.size, dtype=np.uint32)
    return scipy.sparse.csr_array((counts, bucket, np.arange(v.size + 1, dtype=np.int32)), shape=(v.size, _BUCKETS + 1))


def quantiles(sketch: scipy.sparse.csr_array, levels: Sequence[float]) -> Array:
    """Quantiles of every row.

    Parameters
    ----------
    sketch : (n, buckets) sparse array
        Of the same number of values in every row.
    levels : sequence of float
        Between 0 and 1.

    Returns
    -------
    (levels, n) array
        Each off by at most the share :data:`ACCURACY`; NaN where a value of the row is not known.
    """
    out = np.empty((len(levels), sketch.shape[0]))
    for first in range(0, sketch.shape[0], 500):
        counts = np.cumsum(sketch[first : first + 500].toarray(), axis=1, dtype=np.int64)
        known = counts[:, -1] == counts[:, -2]
        for k, level in enumerate(levels):
            at = (counts > level * (counts[:, -1:] - 1)).argmax(axis=1)
            out[k, first : first + 500] = np.where(known, _VALUES[at], np.nan)
    return out
