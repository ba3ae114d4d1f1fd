"""Compiled loops over signals of this room: the Haar pyramid over chunks, and sums of squared differences.

Scalar code over plain arrays. ``reassoc`` lets the compiler vectorise sums; NaN still propagate.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from insemu.compiled import njit

Array = NDArray[np.float64]

#: Samples worked on at a time: with as many of history they fit the first-level cache.
CHUNK = 2048
_INSIDE = 11  # octaves whose scale is at most a chunk
_HISTORY = 48  # sums kept in front of a chunk for the first six octaves
#: Scales up to this many samples are computed at every sample; above it, coefficients are taken on a grid of at least half as many
#: positions per scale, so that memory does not grow with the record.
FULL_OVERLAP = 1 << 20


def haar_state(levels: int, full: int = FULL_OVERLAP) -> tuple[Array, Array, Array]:
    """Return what :func:`haar_push` keeps between calls.

    Running sums at the last samples of the longest scale at most ``full`` samples long; running sums on the grids of the longer scales;
    the chunk being worked on with what came before it.
    """
    reach = min(levels, full.bit_length() - 1)
    ring = _aligned(((1 << reach) // CHUNK + 1) * CHUNK if levels > _INSIDE else 0)
    grids = np.empty((max(levels - reach, 0), full // 2 if levels > reach else 0))
    work = _aligned(5 * CHUNK + 3 * _HISTORY + 8)
    work[:] = 0.0
    return ring, grids, work


def _aligned(size: int) -> Array:
    """Uninitialised numbers that begin at a cache line: vector loads then never straddle two."""
    room = np.empty(size + 8)
    first = -(room.ctypes.data // 8) % 8
    return room[first : first + size]


# Plain loops over slices that start at 0: an index such as ``i - m`` could be negative, and the check for that would keep the compiler
# from vectorising. A coefficient times 2 m is a second difference T[k] - 2 T[k - m] + T[k - 2 m] of the running sum; what is
# T[k - 2 m] for one octave is T[k - m] for the next, so that octaves taken together share their loads. Powers of two are divided out at
# the end, exactly.
@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _two_octaves(
    a: Array, b: Array, c: Array, d: Array, out: Array
) -> tuple[float, float]:  # pragma: no cover - compiled
    """From sums over m samples, now and m, 2 m, 3 m ago: sums of squares of this and the next octave, and sums over 4 m samples."""
    one = 0.0
    two = 0.0
    for i in range(out.size):
        near = a[i] + b[i]
        far = c[i] + d[i]
        x = a[i] - b[i]
        y = near - far
        one += x * x
        two += y * y
        out[i] = near + far
    return one, two


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _four_octaves(
    a: Array, b: Array, c: Array, d: Array, e: Array, f: Array
) -> tuple[float, float, float, float]:  # pragma: no cover - compiled
    """Sums of squares of four octaves from running sums now and m, 2 m, 4 m, 8 m, 16 m ago."""
    one = 0.0
    two = 0.0
    three = 0.0
    four = 0.0
    for i in range(a.size):
        x = a[i] + c[i] - 2.0 * b[i]
        one += x * x
        x = a[i] + d[i] - 2.0 * c[i]
        two += x * x
        x = a[i] + e[i] - 2.0 * d[i]
        three += x * x
        x = a[i] + f[i] - 2.0 * e[i]
        four += x * x
    return one, two, three, four


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _one_octave(a: Array, b: Array, c: Array) -> float:  # pragma: no cover - compiled
    """Sum of squares of one octave from running sums now and m, 2 m ago."""
    total = 0.0
    for i in range(a.size):
        x = a[i] + c[i] - 2.0 * b[i]
        total += x * x
    return total


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _run_on(sums: Array, out: Array) -> None:  # pragma: no cover - compiled
    """Running sums in ``out[64:]`` from sums over 64 samples and the 64 running sums before."""
    for i in range(sums.size):
        out[i + 64] = out[i] + sums[i]


@njit(cache=True, nogil=True)
def _plus(values: Array, by: float, out: Array) -> None:  # pragma: no cover - compiled
    """Values with a constant added."""
    for i in range(values.size):
        out[i] = values[i] + by


@njit(cache=True, nogil=True)
def haar_push(
    x: Array,
    origin: float,
    start: int,
    state: tuple[Array, Array, Array],
    sums: Array,
    full: int,
) -> None:  # pragma: no cover - compiled
    """Add samples ``x`` to the sums of squares of Haar MODWT coefficients (times 4).

    The first sample of a record has number 1 (before it the running sum is 0), and ``start`` is the number of ``x[0]``. Every call but the
    last must end with the number before a multiple of ``CHUNK``. ``origin`` is subtracted, so that an offset such as gravity costs no digits.

    Parameters
    ----------
    x : (k,) array
        Samples.
    origin : float
        In the unit of the signal.
    start : int
        Number of the first of these samples.
    state : (ring, grids, work), arrays
        Of :func:`haar_state`; overwritten.
    sums : (levels,) array
        Added to, unit^2.
    full : int
        Longest scale at which every sample has a coefficient; a power of two, the same as for :func:`haar_state`.
    """
    ring, grids, work = state
    levels = sums.size
    inside = min(levels, _INSIDE)
    reach = levels - grids.shape[0]
    slots = ring.size // CHUNK
    h, c = _HISTORY, CHUNK
    run = work[: 2 * c]  # running sum over two chunks, relative to the end of the first
    fresh = work[2 * c : 3 * c + h]  # samples
    fours = work[3 * c + h : 4 * c + 2 * h]  # sums over 4
    sixteens = work[4 * c + 2 * h : 5 * c + 3 * h]
    base = work[5 * c + 3 * h]
    sums64 = fresh  # made when the samples are not needed any more
    done = 0
    while done < x.size:
        number = start + done
        lead = number % c
        chunk = number // c
        fresh[h : h + lead] = 0.0
        taken = min(c - lead, x.size - done)
        _plus(x[done : done + taken], -origin, fresh[h + lead : h + lead + taken])
        n = lead + taken
        s1, s2 = _two_octaves(
            fresh[h : h + n],
            fresh[h - 1 : h - 1 + n],
            fresh[h - 2 : h - 2 + n],
            fresh[h - 3 : h - 3 + n],
            fours[h : h + n],
        )
        s3, s4 = _two_octaves(
            fours[h : h + n],
            fours[h - 4 : h - 4 + n],
            fours[h - 8 : h - 8 + n],
            fours[h - 12 : h - 12 + n],
            sixteens[h : h + n],
        )
        s5, s6 = _two_octaves(
            sixteens[h : h + n], sixteens[h - 16 : h - 16 + n], sixteens[h - 32 : h - 32 + n], sixteens[:n], sums64[:n]
        )
        _run_on(sums64[:n], run[c - 64 : c + n])
        now = run[c : c + n]
        if chunk == 0:
            # coefficients that would begin before the record are left out
            for level in range(inside):
                m = 1 << level
                if n > 2 * m:
                    total = _one_octave(now[2 * m :], now[m : n - m], now[: n - 2 * m])
                    sums[level] += total * 0.25**level
        else:
            s7, s8, s9, s10 = _four_octaves(
                now, run[c - 64 : c - 64 + n], run[c - 128 : c - 128 + n], run[c - 256 : c - 256 + n], run[c - 512 : c - 512 + n],
                run[c - 1024 : c - 1024 + n],
            )  # fmt: skip
            s11 = _one_octave(now, run[c - 1024 : c - 1024 + n], run[c - 2048 : c - 2048 + n])
            for level, total in enumerate((s1, s2, s3, s4, s5, s6, s7, s8, s9, s10, s11)):
                if level < levels:
                    sums[level] += total * 0.25**level
        if levels > _INSIDE:
            at = (chunk % slots) * c
            here = ring[at : at + n]
            _plus(now, base, here)
            level = _INSIDE
            while level < reach and chunk >= 2 << (level - _INSIDE):
                back = 1 << (level - _INSIDE)  # m in chunks
                r1 = ((chunk - back) % slots) * c
                r2 = ((chunk - 2 * back) % slots) * c
                if level + 3 < reach and chunk >= 16 * back:
                    r4 = ((chunk - 4 * back) % slots) * c
                    r8 = ((chunk - 8 * back) % slots) * c
                    r16 = ((chunk - 16 * back) % slots) * c
                    totals = _four_octaves(
                        here,
                        ring[r1 : r1 + n],
                        ring[r2 : r2 + n],
                        ring[r4 : r4 + n],
                        ring[r8 : r8 + n],
                        ring[r16 : r16 + n],
                    )
                    for k in range(4):
                        sums[level + k] += totals[k] * 0.25 ** (level + k)
                    level += 4
                else:
                    sums[level] += _one_octave(here, ring[r1 : r1 + n], ring[r2 : r2 + n]) * 0.25**level
                    level += 1
            for g in range(grids.shape[0]):
                # running sums at every so many samples, half a window of `full` of them to a scale
                grid = grids[g]
                every = 4 << g
                first = (every - chunk * c % every) % every
                total = 0.0
                for i in range(first, n, every):
                    k = (chunk * c + i) // every
                    slot = k % grid.size
                    value = here[i]
                    if k >= grid.size:
                        d = value + grid[slot] - 2.0 * grid[(k + grid.size // 2) % grid.size]
                        total += d * d
                    grid[slot] = value
                sums[reach + g] += total * 0.25 ** (reach + g)
        last = run[c + n - 1]
        _plus(run[c:], -last, run[:c])
        base += last
        for i in range(h):
            fresh[i] = fresh[c + i]
            fours[i] = fours[c + i]
            sixteens[i] = sixteens[c + i]
        done += taken
    work[5 * c + 3 * h] = base


def haar_counts(n_samples: int, levels: int, full: int) -> NDArray[np.int64]:
    """How many coefficients :func:`haar_push` has summed of each octave.

    Parameters
    ----------
    n_samples : int
        Length of the record.
    levels : int
        Number of octaves.
    full : int
        Longest scale at which every sample has a coefficient; a power of two.

    Returns
    -------
    (levels,) array of int
    """
    scale = 1 << np.arange(1, levels + 1, dtype=np.int64)
    every = np.where(scale <= full, 1, scale // (full // 2))
    return np.asarray((n_samples - scale) // every + 1)


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def haar_coefficients_level(a: Array, m: int, w: Array, v: Array) -> None:  # pragma: no cover - compiled
    """One octave of a whole record without boundary: differences to ``w`` and averages to ``v``, both ``a.size - m`` long.

    Parameters
    ----------
    a : (n,) array
        Averages of the octave before; of the first octave the signal.
    m : int
        Samples per average.
    w, v : (n - m,) arrays
        Overwritten.
    """
    for i in range(a.size - m):
        w[i] = 0.5 * (a[i + m] - a[i])
        v[i] = 0.5 * (a[i + m] + a[i])


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def biweight_sums(w: Array, inverse_square: float) -> tuple[float, float]:  # pragma: no cover - compiled
    """Sums of the biweight and of the biweight times the square, cut at ``w^2 = 1 / inverse_square``."""
    weights = 0.0
    squares = 0.0
    for i in range(w.size):
        s = w[i] * w[i]
        d = max(1.0 - s * inverse_square, 0.0)
        d *= d
        weights += d
        squares += d * s
    return weights, squares


@njit(cache=True, nogil=True)
def untouched(
    w: Array, seen: NDArray[np.int64], scale: int, stride: int, out: Array
) -> int:  # pragma: no cover - compiled
    """Copy every ``stride``-th coefficient whose ``scale`` samples hold no flagged step; returns how many.

    ``seen[k]`` counts flagged steps before sample k (a step k joins samples k and k + 1).

    Parameters
    ----------
    w : (n,) array
        Coefficients.
    seen : (n + scale - 1,) array of int
        One number per sample of the record.
    scale : int
        Samples that a coefficient reaches over.
    stride : int
        Coefficients from one to the next.
    out : array
        Overwritten; as long as ``w[::stride]``.
    """
    kept = 0
    for i in range(0, w.size, stride):
        if seen[i + scale - 1] == seen[i]:
            out[kept] = w[i]
            kept += 1
    return kept


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def second_differences(s: Array, m: int, stride: int) -> float:  # pragma: no cover - compiled
    """Sum of squares of s[k + 2m] - 2 s[k + m] + s[k].

    Parameters
    ----------
    s : (n,) array
        Running sum of the signal.
    m : int
        Step of the differences, samples.
    stride : int
        Samples from one difference to the next.

    Returns
    -------
    float
        In the unit of ``s`` squared.
    """
    total = 0.0
    for k in range(0, s.size - 2 * m, stride):
        d = s[k + 2 * m] - 2.0 * s[k + m] + s[k]
        total += d * d
    return total
