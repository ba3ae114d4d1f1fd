"""Errors of the sensors from a time on: what each would explain from every start, by one pass backwards through the filter in the loop.

With ``e- = Phi e+ + D``, ``g = -H e-``, ``e+ = e- + K g``, what inputs ``D`` from a node on make of the innovations has the square ``E`` and the
product ``p`` with a vector ``v`` that follow from those of the node behind, so that no start needs a pass of its own: ``e' W e + 2 c' e + E`` is
the square of all that a state ``e`` and the later inputs make.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from insemu.effects import EFFECTS, Column, Motion, first_axis
from insemu.effects.terms import equation
from insemu.gap.drive.signatures import Loop

Array = NDArray[np.float64]
#: Signals that an axis may follow from a time on: its own and those of the other two (scale factor, misalignment), and what a gyroscope
#: follows of the specific force.
_SIGNALS = {"gyro": ("rate", "force"), "accel": ("force",)}
_SCALES = {"rate": "scale_factor", "force": "g_sensitivity"}


def changing_terms(motion: Motion) -> list[Column]:
    """Unit columns of errors that an axis follows a signal by, as equations.

    Parameters
    ----------
    motion : Motion
    """
    out = []
    for sensor, kinds in _SIGNALS.items():
        for axis in range(3):
            for kind in kinds:
                own = kind == "rate" or sensor == "accel"
                scale = EFFECTS["scale_factor" if own else _SCALES[kind]].scale("value", sensor)
                for j, other in enumerate("xyz"):
                    u = np.ascontiguousarray((motion.rate if kind == "rate" else motion.force)[:, j])
                    text = f"{'xyz'[axis]} = {kind}_{other}"
                    unit = equation(text, sensor).unit
                    inputs = ((first_axis(sensor) + axis, u),)
                    out.append(Column("expression_step", sensor, "value", (text,), scale, unit, inputs))
    return out


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
