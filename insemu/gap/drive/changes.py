"""Errors of the sensors from a time on: what each would explain from every start, by one pass backwards through the filter in the loop.

With ``e- = Phi e+ + D``, ``g = -H e-``, ``e+ = e- + K g``, what inputs ``D`` from a node on make of the innovations has the square ``E`` and the
product ``p`` with a vector ``v`` that follow from those of the node behind, so that no start needs a pass of its own: ``e' W e + 2 c' e + E`` is
the square of all that a state ``e`` and the later inputs make.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from insemu.effects import EFFECTS, XYZ, Column, Motion, equation, first_axis
from insemu.gap.drive.signatures import Loop, built_up

Array = NDArray[np.float64]
#: Sensor, the signals of all axes that each of its axes may follow from a time on, and the effect whose usual size that has.
_FOLLOWED = (("gyro", "rate", "scale_factor"), ("gyro", "force", "g_sensitivity"), ("accel", "force", "scale_factor"))


@dataclass(frozen=True)
class Changing:
    """Errors that an axis follows a signal by.

    Parameters
    ----------
    columns : tuple of Column
        Unit errors, as equations.
    built : (nodes, c, 9) array
        Navigation errors that they build up since the node before.
    """

    columns: tuple[Column, ...]
    built: Array

    @classmethod
    def of(cls, loop: Loop, motion: Motion) -> Changing:
        """Along a motion."""
        out = []
        for sensor, kind, effect in _FOLLOWED:
            scale = EFFECTS[effect].scale("value", sensor)
            for k in range(3):
                for j, other in enumerate(XYZ):
                    text = f"{XYZ[k]} = {kind}_{other}"
                    u = np.ascontiguousarray((motion.rate if kind == "rate" else motion.force)[:, j])
                    inputs = ((first_axis(sensor) + k, u),)
                    unit = equation(text, sensor).unit
                    out.append(Column("expression_step", sensor, "value", (text,), scale, unit, inputs))
        return cls(tuple(out), built_up(loop, motion, out)[0])

    def column(self, k: int, t: Array, start: float, end: float) -> Column:
        """One of them between two times.

        Parameters
        ----------
        k : int
            Which of the columns.
        t : (n,) array
            Of the motion, s.
        start, end : float
            s.
        """
        inside = (t > start) & (t <= end)
        c = self.columns[k]
        return replace(c, inputs=tuple((axis, u * inside) for axis, u in c.inputs))


def scanned(loop: Loop, D: Array, v: Array, count: int) -> tuple[Array, Array]:
    """Squares and products of whitened responses to inputs from each node on.

    Parameters
    ----------
    loop : Loop
        The nominal filter.
    D : (nodes, c, 9) array
        Navigation errors that unit inputs build up since the node before.
    v : (f, 6, q) array
        Whitened vectors, zero where a component is missing.
    count : int
        Fixes that count, the first ones.

    Returns
    -------
    squares : (nodes, c) array
        Of the response to the inputs up to each node and behind it: their first interval ends there.
    products : (nodes, c, q) array
        Of that response with each vector.
    """
    Phi, K, H, node = loop.machine
    nodes, columns, n = D.shape[0], D.shape[1], Phi.shape[1]
    W, c, E = np.zeros((n, n)), np.zeros((n, columns)), np.zeros(columns)
    lam, p = np.zeros((n, v.shape[2])), np.zeros((columns, v.shape[2]))
    squares, products = np.zeros((nodes, columns)), np.zeros((nodes, columns, v.shape[2]))
    k = count - 1
    for i in range(nodes - 1, -1, -1):
        while k >= 0 and node[k] == i:
            white = loop.white[k] @ H[k]
            F = np.eye(n) - K[k] @ H[k]
            W, c = white.T @ white + F.T @ W @ F, F.T @ c
            lam = F.T @ lam - white.T @ v[k]
            k -= 1
        d = D[i].T
        Wd = W[:, :9] @ d
        E = E + np.einsum("rc,rc->c", d, Wd[:9] + 2.0 * c[:9])
        p = p + d.T @ lam[:9]
        squares[i], products[i] = E, p
        W, c, lam = Phi[i].T @ W @ Phi[i], Phi[i].T @ (Wd + c), Phi[i].T @ lam
    return squares, products
