"""An autoregression as a chain of first-order (complex poles: second-order) sections, fast poles first.

The companion form hides small numbers in differences of large ones: with three poles near 1, as in error models of de-noised signals, its
covariance loses six digits. In the chain every state is a further smoothing of the one before, and nothing cancels. Where correlation times follow
a covariate, only the transition of the chain moves: what drives it and what a sample sees of it depend on the angles of the poles alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def slower(poles: ArrayLike, factor: ArrayLike) -> NDArray[np.complex128]:
    """Poles whose time constants are multiplied by a factor, their angles kept: (..., k) of (k,) poles and (...,) factors."""
    p = np.asarray(poles, dtype=np.complex128)
    power = 1.0 / np.asarray(factor, dtype=np.float64)[..., None]
    size = np.abs(p)
    direction = np.divide(p, size, out=np.ones_like(p), where=size > 0)
    return np.asarray(np.where(power == 1.0, p, direction * size**power))


def sections(poles: ArrayLike, factor: ArrayLike) -> tuple[Array, Array, Array]:
    """The chain ``x_k = Phi_k x_(k-1) + drive w_k``, ``y_k = c x_k``, of an autoregression ``y = w / A``.

    Parameters
    ----------
    poles : (k,) array
        Roots of the autoregressive polynomial, pairs side by side.
    factor : (n,) array
        Factors of the time constants of the poles, one per step.

    Returns
    -------
    Phi, drive, c : (n, k, k), (k,), (k,) arrays
    """
    given = np.array(sorted(np.asarray(poles, dtype=np.complex128), key=abs))
    moved = slower(given, factor)
    steps, n = moved.shape
    Phi, drive, c = np.zeros((steps, n, n)), np.zeros(n), np.zeros(n)
    row, gain = np.zeros((steps, n)), 1.0  # what enters the next section: of the old states, and of the innovation
    at = 0
    while at < n:
        pole, now = given[at], moved[:, at]
        if abs(pole.imag) <= 1e-12 * abs(pole):
            Phi[:, at] = row
            Phi[:, at, at] += now.real
            drive[at] = gain
            c = np.eye(n)[at]
            at += 1
        else:  # coupled form of a conjugate pair (adjacent, for their moduli are equal); p + cot(angle) q is the section's output
            re, im = now.real, np.abs(now.imag)
            Phi[:, at], Phi[:, at + 1] = row, 0.0
            Phi[:, at, at] += re
            Phi[:, at, at + 1] -= im
            Phi[:, at + 1, at] += im
            Phi[:, at + 1, at + 1] += re
            drive[at] = gain
            c = np.zeros(n)
            c[at : at + 2] = 1.0, pole.real / abs(pole.imag)
            at += 2
        row, gain = np.einsum("i,kij->kj", c, Phi), float(c @ drive)
    return Phi, drive, c
