"""Compiled kernels of simulation: they fill and filter one row in place, so that drawing noise costs little more than its numbers.

The numbers are those of numpy's own ``Generator``, bit by bit: numba draws from the same stream and leaves the generator in the same
state, in less than half of the time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def standard_normal(out: Array, rng: np.random.Generator) -> None:
    """Fill ``out`` (n,) with what ``rng.standard_normal(n)`` returns."""
    for k in range(out.size):
        out[k] = rng.standard_normal()


@njit(cache=True, nogil=True)
def first_order(out: Array, phi: float, first: float, rest: float, before: float) -> None:
    """Turn white numbers (n,) into ``y_k = phi y_(k-1) + rest w_k`` with ``y_0 = first w_0 + phi before``, in place.

    Parameters
    ----------
    out : (n,) array
        White numbers of unit variance, overwritten.
    phi : float
        Coefficient of the recursion.
    first, rest : float
        Standard deviation of what drives the first sample, and of the innovations after it.
    before : float
        Sample before the first; 0 where the process begins.
    """
    y = before
    scale = first
    for k in range(out.size):
        y = out[k] * scale + phi * y
        out[k] = y
        scale = rest


@njit(cache=True, nogil=True)
def running_sum(out: Array, start: float, scale: float, total: float) -> float:
    """Turn white numbers (n,) into ``start + scale (total + w_0 + ... + w_k)``, in place.

    Parameters
    ----------
    out : (n,) array
        Numbers that are summed, overwritten.
    start : float
        Added to every sum.
    scale : float
        Factor of the sums: of white numbers of unit variance the standard deviation of a step.
    total : float
        Sum of the numbers before the first; 0 where it begins.

    Returns
    -------
    float
        Sum of the numbers up to the last.
    """
    for k in range(out.size):
        total += out[k]
        out[k] = start + total * scale
    return total


@njit(cache=True, nogil=True)
def rational_filter(out: Array, b: Array, a: Array, memory: Array) -> None:
    """Filter (n,) in place with numerator ``b`` and denominator ``a`` of one length m and ``a[0] = 1``.

    Direct form II transposed, as ``scipy.signal.lfilter``; ``memory`` (m - 1,) is its state and is left at the end of the signal.

    Parameters
    ----------
    out : (n,) array
        Signal, overwritten.
    b, a : (m,) arrays
        Numerator and denominator, m at least 2.
    memory : (m - 1,) array
        State before the first sample, overwritten by that after the last.
    """
    last = memory.size - 1
    if last == 1:  # two poles, the usual case, with the state in registers
        z0, z1 = memory[0], memory[1]
        for k in range(out.size):
            x = out[k]
            y = z0 + b[0] * x
            z0 = z1 + x * b[1] - y * a[1]
            z1 = x * b[2] - y * a[2]
            out[k] = y
        memory[0], memory[1] = z0, z1
        return
    for k in range(out.size):
        x = out[k]
        y = memory[0] + b[0] * x
        for i in range(last):
            memory[i] = memory[i + 1] + x * b[i + 1] - y * a[i + 1]
        memory[last] = x * b[last + 1] - y * a[last + 1]
        out[k] = y


@njit(cache=True, nogil=True)
def moved(out: Array, Phi: Array, drive: Array, scale: Array, c: Array, state: Array, rng: np.random.Generator) -> None:
    """Fill (n,) with ``c x_k``, where ``x_k = Phi_k x_(k-1) + scale_k drive w_k``.

    Parameters
    ----------
    out : (n,) array
        Overwritten.
    Phi : (n, states, states) array
        Transition to every sample.
    drive : (states,) array
        How one white number enters the states.
    scale : (n,) array
        Its standard deviation at every sample.
    c : (states,) array
        What a sample sees of the state.
    state : (states,) array
        State before the first sample, overwritten by that at the last.
    rng : Generator
    """
    n = state.size
    old = np.empty(n)
    for k in range(out.size):
        w = scale[k] * rng.standard_normal()
        for i in range(n):
            old[i] = state[i]
        seen = 0.0
        for i in range(n):
            total = drive[i] * w
            for j in range(n):
                total += Phi[k, i, j] * old[j]
            state[i] = total
            seen += c[i] * total
        out[k] = seen


@njit(cache=True, nogil=True)
def driven(out: Array, Phi: Array, root: Array, c: Array, state: Array, gain: Array, rng: np.random.Generator) -> None:
    """Add ``c x_k`` to (n,), where ``x_k = Phi x_(k-1) + g_k root w_k``; ``state`` holds ``x_0`` and is left at the last sample.

    Parameters
    ----------
    out : (n,) array
        Signal that is added to.
    Phi : (states, states) array
        Transition per sample.
    root : (states, states) array
        Root of the driving covariance, ``root root' = Q``.
    c : (states,) array
        What a sample sees of the state.
    state : (states,) array
        State at the first sample, overwritten.
    gain : (n,) or (1,) array
        Factor of the noise that drives every sample, or of all.
    rng : Generator
    """
    n = state.size
    old, w = np.empty(n), np.empty(n)
    for k in range(out.size):
        if k > 0:
            level = gain[k] if gain.size > 1 else gain[0]
            for i in range(n):
                old[i] = state[i]
                w[i] = level * rng.standard_normal()
            for i in range(n):
                total = 0.0
                for j in range(n):
                    total += Phi[i, j] * old[j] + root[i, j] * w[j]
                state[i] = total
        for i in range(n):
            out[k] += c[i] * state[i]
