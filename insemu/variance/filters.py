"""Wavelet filters by name, in MODWT scaling, which satisfy equation (3) of Stebler et al. 2014 to rounding but for the cut splines.

Families: ``haar``; Daubechies ``d4``..``d20``; least asymmetric ``la8``..``la20``; Fejer-Korovkin ``fk4``..``fk22`` (Nielsen
2001; published tables, ``fk18`` computed by the construction that gives the others); best localized ``bl14``, ``bl20`` (published
tables; some programs print them under the name Battle-Lemarie); Battle-Lemarie spline wavelets ``battle2`` (linear) and ``battle4``
(cubic), computed and truncated; minimum bandwidth ``mb4``..``mb24`` (Morris and Peravali 1999; published tables).

Tables of few digits are moved to the nearest filter that satisfies the conditions exactly; of the truncated splines the even shifts are
orthogonal to 5e-5.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pywt
from numpy.typing import NDArray

from insemu.errors import InputError, nearest

Array = NDArray[np.float64]

#: Published scaling filters in unit-energy scaling.
_TABLES: dict[str, tuple[float, ...]] = {
    "mb4": (0.4801755, 0.8372545, 0.2269312, -0.1301477),
    "mb8": (-1.673619e-01, 1.847751e-02, 5.725771e-01, 7.351331e-01, 2.947855e-01, -1.108673e-01, 7.106015e-03, 6.436345e-02),
    "mb16": (
        -1.302770e-02, 2.173677e-02, 1.136116e-01, -5.776570e-02, -2.278359e-01, 1.188725e-01, 6.349228e-01, 6.701646e-01,
        2.345342e-01, -5.656657e-02, -1.987986e-02, 5.474628e-02, -2.483876e-02, -4.984698e-02, 9.620427e-03, 5.765899e-03,
    ),
    "mb24": (
        -2.132706e-05, 4.745736e-04, 7.456041e-04, -4.879053e-03, -1.482995e-03, 4.199576e-02, -2.658282e-03, -6.559513e-03,
        1.019512e-01, 1.689456e-01, 1.243531e-01, 1.949147e-01, 4.581101e-01, 6.176385e-01, 2.556731e-01, -3.091111e-01,
        -3.622424e-01, -4.575448e-03, 1.479342e-01, 1.027154e-02, -1.644859e-02, -2.062335e-03, 1.193006e-03, 5.361301e-05,
    ),
    "fk4": (0.6539275555697651, 0.7532724928394872, 0.05317922877905981, -0.04616571481521770),
    "fk6": (
        0.4279150324223103, 0.8129196431369074, 0.3563695110701871, -0.1464386812725773, -0.07717775740697006, 0.04062581442323794,
    ),
    "fk8": (
        0.3492381118637999, 0.7826836203840648, 0.4752651350794712, -0.09968332845057319, -0.1599780974340301, 0.04310666810651625,
        0.04258163167758178, -0.01900017885373592,
    ),
    "fk14": (
        0.2603717692913964, 0.6868914772395985, 0.6115546539595115, 0.05142165414211914, -0.2456139281621916, -0.04857533908585527,
        0.1242825609215128, 0.02222673962246313, -0.06399737303914167, -0.005074372549972850, 0.02977971159037902,
        -0.003297479152708717, -0.009270613374448239, 0.003514100970435962,
    ),
    "fk22": (
        0.1938961077599566, 0.5894521909294277, 0.6700849629420265, 0.2156298491347700, -0.2280288557715772, -0.1644657152688429,
        0.1115491437220700, 0.1101552649340661, -0.06608451679377920, -0.07184168192312605, 0.04354236762555708, 0.04477521218440976,
        -0.02974288074927414, -0.02597087308902119, 0.02028448606667798, 0.01296424941108978, -0.01288599056244363,
        -0.004838432636440189, 0.007173803165271690, 0.0003612855622194901, -0.002676991638581043, 0.0008805773686384639,
    ),
    "bl14": (
        0.0120154192834842, 0.0172133762994439, -0.0649080035533744, -0.0641312898189170, 0.3602184608985549, 0.7819215932965554,
        0.4836109156937821, -0.0568044768822707, -0.1010109208664125, 0.0447423494687405, 0.0204642075778225, -0.0181266051311065,
        -0.0032832978473081, 0.0022918339541009,
    ),
    "bl20": (
        0.0008625782242896, 0.0007154205305517, -0.0070567640909701, 0.0005956827305406, 0.0496861265075979, 0.0262403647054251,
        -0.1215521061578162, -0.0150192395413644, 0.5137098728334054, 0.7669548365010849, 0.3402160135110789, -0.0878787107378667,
        -0.0670899071680668, 0.0338423550064691, -0.0008687519578684, -0.0230054612862905, -0.0011404297773324, 0.0050716491945793,
        0.0003401492622332, -0.0004101159165852,
    ),
}  # fmt: skip

#: Names of all filters.
FILTERS: tuple[str, ...] = (
    "haar",
    *(f"d{k}" for k in range(4, 21, 2)),
    *(f"la{k}" for k in range(8, 21, 2)),
    *(f"fk{k}" for k in (4, 6, 8, 14, 18, 22)),
    "bl14",
    "bl20",
    "battle2",
    "battle4",
    "mb4",
    "mb8",
    "mb16",
    "mb24",
)


@lru_cache(maxsize=64)
def _scaling(name: str) -> tuple[float, ...]:
    """Scaling filter of unit energy."""
    if name == "haar":
        g = np.full(2, np.sqrt(0.5))
    elif name in _TABLES:
        g = np.array(_TABLES[name])
    elif name.startswith("fk"):
        g = fejer_korovkin(int(name.removeprefix("fk")))
    elif name.startswith("battle"):
        g = _battle_lemarie(int(name.removeprefix("battle")))
    else:
        family, length = ("sym", name.removeprefix("la")) if name.startswith("la") else ("db", name.removeprefix("d"))
        g = np.array(pywt.Wavelet(f"{family}{int(length) // 2}").dec_lo[::-1])
    # what a cut spline lacks, its ends would have to make up for, which are too small for it
    shifts = 1 if name.startswith("battle") else g.size // 2
    return tuple(_nearest_orthonormal(g, shifts).tolist())


def _nearest_orthonormal(g: Array, shifts: int) -> Array:
    """Move a filter to the nearest one of unit energy whose first even shifts are orthonormal and whose halves sum alike.

    Gauss-Newton, least change.
    """
    g = g.astype(float).copy()
    for _ in range(50):
        # even and odd coefficients sum to the same: the sum and the zero at half the rate in one well-conditioned pair
        even = (np.arange(g.size) % 2 == 0).astype(float)
        rows = [even, 1.0 - even]
        residual = [float(np.dot(row, g)) - np.sqrt(0.5) for row in rows]
        for m in range(shifts):
            shift = 2 * m
            residual.append(np.dot(g[shift:], g[: g.size - shift]) - (m == 0))
            row = np.zeros(g.size)
            row[shift:] += g[: g.size - shift]
            row[: g.size - shift] += g[shift:]
            rows.append(row)
        if np.abs(residual).max() < 1e-15:
            break
        g -= np.linalg.lstsq(np.array(rows), np.array(residual), rcond=1e-12)[0]
    return g


def fejer_korovkin(length: int) -> Array:
    """Scaling filter of unit energy and even length (6 or more) from the ideal half band smoothed by the Fejer-Korovkin kernel.

    The squared magnitude has the ideal filter's odd cosine coefficients times the kernel's, scaled to vanish at half the rate; the filter is its
    factor of minimum phase (Nielsen 2001).
    """
    k = np.arange(1, length, 2)
    n = length + 2
    kernel = ((n - k + 1) * np.sin((k + 1) * np.pi / n) - (n - k - 1) * np.sin((k - 1) * np.pi / n)) / np.sin(np.pi / n)
    odd = kernel * np.sin(0.5 * np.pi * k) / k
    power = np.zeros(2 * length - 1)
    power[length - 1] = 1.0
    power[length - 1 + k] = power[length - 1 - k] = 0.5 * odd / odd.sum()
    # the double zero at half the rate is known; the others come in pairs inside and outside the unit circle
    roots = np.roots(np.polydiv(power, np.array([1.0, 2.0, 1.0]))[0])
    g = np.real(np.poly(np.append(np.sort_complex(roots[np.argsort(np.abs(roots))][: length - 2]), -1.0)))
    return np.asarray(g / np.sqrt(np.sum(g * g)))


def _battle_lemarie(order: int) -> Array:
    """Orthonormal spline filter of the given (even) order, cut where it falls below a ten-thousandth of its peak."""
    size = 1 << 14
    omega = 2.0 * np.pi * (np.arange(size) + 0.5) / size

    def bracket(w: Array) -> Array:
        # sum over k of 1 / (w + 2 pi k)^(2 order), times sin(w / 2)^(2 order) 2^(2 order): bounded
        k = np.arange(-60, 61)[:, None]
        return np.asarray(np.sum((2.0 * np.sin(0.5 * w) / (w + 2.0 * np.pi * k)) ** (2 * order), axis=0))

    transfer = np.sqrt(2.0) * np.cos(0.5 * omega) ** order * np.sqrt(bracket(omega) / bracket(2.0 * omega))
    reach = {2: 15, 4: 25}[order]
    lags = np.arange(-reach, reach + 1)
    g = np.array([np.mean(transfer * np.cos(omega * lag)) for lag in lags])
    return np.append(g, 0.0)  # an even length, as quadrature mirror pairs have


def modwt_filters(name: str) -> tuple[Array, Array]:
    """Return the first-octave MODWT wavelet and scaling filters ``(h, g)`` of a family member.

    Raises
    ------
    InputError
        An unknown name; the message gives the nearest.

    Examples
    --------
    >>> h, g = modwt_filters("haar")
    >>> h.tolist(), g.tolist()
    ([0.5, -0.5], [0.5, 0.5])
    """
    if name not in FILTERS:
        raise InputError(f"unknown wavelet filter '{name}'" + nearest(name, FILTERS))
    if name == "haar":
        return np.array([0.5, -0.5]), np.array([0.5, 0.5])
    g = np.array(_scaling(name)) / np.sqrt(2.0)
    # quadrature mirror: h_l = (-1)^l g_(L-1-l)
    h = g[::-1] * (-1.0) ** np.arange(g.size)
    return h, g
