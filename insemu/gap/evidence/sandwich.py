"""What evidence is worth under a model that is wrong: how much more the score of a coefficient varies than independent innovations would let it.

Under the model the score of a coefficient, the sum of its shape times what is left, varies as much as its information says. Where what is left is
not independent, or louder in places, the scores of stretches of time vary more: by that factor the variance of the coefficient is larger, and the
square of its size over its standard deviation, which its evidence goes with, is smaller.

References
----------
White 1982, Econometrica 50: variance of an estimate under a wrong model. Kent 1982, Biometrika 69: the likelihood ratio under it.
"""

from __future__ import annotations

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu.gap.policy import rules

Array = NDArray[np.float64]

#: Stretches that a recording is divided into, in turns: what is left may hang together for seconds or for minutes.
STRETCHES = (200, 60, 20)


def excess(shape: Array, left: Array, t: Array, variance: float) -> float:
    """Factor by which the variance of a coefficient is larger, at the least, than independent innovations make it; 1 where nothing shows that.

    Of few stretches with anything of a shape it may be large by chance; how rarely that may decide is the policy's ``doubt``.

    Parameters
    ----------
    shape : (r,) array
        What the coefficient explains of the innovations, less what the rest can explain of that.
    left : (r,) array
        Innovations less everything that is explained, the coefficient's part included.
    t : (r,) array
        Their times, s.
    variance : float
        Of independent innovations.
    """
    out, since = 1.0, (t - t[0]) / max(float(t[-1] - t[0]), np.finfo(float).tiny)
    for count in STRETCHES:
        place = np.minimum((count * since).astype(np.int64), count - 1)
        score = np.bincount(place, shape * left, count)
        information = variance * np.bincount(place, shape**2, count)
        total = float(information.sum())
        if not total > 0.0:
            continue
        # as many stretches alike would vary as much
        alike = total**2 / float(information @ information)
        out = max(out, float(score @ score) / total * alike / float(scipy.stats.chi2.isf(rules().doubt, alike)))
    return out
