"""WGS-84: radii, conversions, normal gravity, Earth and transport rate.

Latitudes and longitudes are radians, heights are ellipsoidal and positive up, vectors of the local frame are north,
east, down. Public functions broadcast over leading axes; the functions whose names start with ``scalar_`` are
compiled and are what the mechanization and the filter call per epoch.

What stands here and not in a library
-------------------------------------
Conversions between geodetic, Earth-fixed and local coordinates are pymap3d's. Own are

* what compiled loops call per epoch (radii, gravity and its slopes), with array forms of the same formulas,
* the way back from Earth-fixed coordinates (:func:`ecef_to_llh`): pymap3d loses 3 nm in height, and the emulator's truth is held to 1 nm,
* gravity, rates and the metres of the filter's states (:func:`position_difference`, :func:`move`), which no geodesy library has.

Gravity models
--------------
``normal`` (default)
    Somigliana's closed form on the ellipsoid, continued upwards by the second-order expansion in height (NIMA
    TR8350.2, equations 4-1 and 4-3). It agrees with the exact closed form of the vertical component
    (:func:`normal_gravity_exact`) to better than 1e-6 m/s^2 at 10 km.
``free_air_first_order``
    Somigliana's closed form times ``1 - 2 h / a``.

Both act along the ellipsoid's normal; the northward component of normal gravity above the ellipsoid (8e-9 m/s^2 per
metre of height) is left out of the mechanization, as is usual, and therefore of everything that is emulated.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu.compiled import njit
from insemu.errors import InputError, nearest

Array = NDArray[np.float64]

#: Semi-major axis, m.
A = 6378137.0
#: Flattening.
F = 1.0 / 298.257223563
#: Gravitational constant times mass (atmosphere included), m^3/s^2.
GM = 3.986004418e14
#: Rotation rate with respect to inertial space, rad/s.
RATE = 7.292115e-5
#: Semi-minor axis, m, to the digits that geodesy libraries carry (the float next to ``A (1 - F)``, 1e-9 m above it).
B = 6356752.31424518
#: First eccentricity squared.
E2 = F * (2.0 - F)

_E = math.sqrt(A * A - B * B)  # linear eccentricity
_M = RATE**2 * A**2 * B / GM  # ratio of centrifugal to gravitational acceleration
_EP = _E / B


def _q(u: float) -> float:
    return 0.5 * ((1.0 + 3.0 * u * u / (_E * _E)) * math.atan(_E / u) - 3.0 * u / _E)


def _qp(u: float) -> float:
    return 3.0 * (1.0 + u * u / (_E * _E)) * (1.0 - u / _E * math.atan(_E / u)) - 1.0


#: Normal gravity at the equator and at the poles, m/s^2 (derived from the four defining constants; Moritz, Geodetic
#: Reference System).
GAMMA_EQUATOR = GM / (A * B) * (1.0 - _M - _M * _EP * _qp(B) / (6.0 * _q(B)))
GAMMA_POLE = GM / (A * A) * (1.0 + _M * _EP * _qp(B) / (3.0 * _q(B)))
_K = B * GAMMA_POLE / (A * GAMMA_EQUATOR) - 1.0

#: Gravity models by name; the numbers are what compiled code takes.
GRAVITY_CODES = {"normal": 0, "free_air_first_order": 1}


def gravity_code(name: str) -> int:
    """Return the number that compiled code takes for a gravity model.

    Raises
    ------
    InputError
        An unknown name.
    """
    if name not in GRAVITY_CODES:
        raise InputError(f"unknown gravity model '{name}'" + nearest(name, GRAVITY_CODES))
    return GRAVITY_CODES[name]


@njit(cache=True, nogil=True)
def scalar_radii(sin_lat: float) -> tuple[float, float]:
    """Radii of curvature ``(R_M, R_N)`` in m: along the meridian and in the prime vertical."""
    x = 1.0 - E2 * sin_lat * sin_lat
    rn = A / math.sqrt(x)
    return rn * (1.0 - E2) / x, rn


@njit(cache=True, nogil=True)
def scalar_gravity(sin_lat: float, h: float, code: int) -> float:
    """Gravity (down) in m/s^2 at a height in m; ``code`` is one of :data:`GRAVITY_CODES`.

    Parameters
    ----------
    sin_lat : float
        Sine of the geodetic latitude.
    h : float
        Ellipsoidal height, m.
    code : int
        One of :data:`GRAVITY_CODES`.
    """
    s2 = sin_lat * sin_lat
    gamma = GAMMA_EQUATOR * (1.0 + _K * s2) / math.sqrt(1.0 - E2 * s2)
    if code == 1:
        return gamma * (1.0 - 2.0 * h / A)
    return gamma * (1.0 - 2.0 * h / A * (1.0 + F + _M - 2.0 * F * s2) + 3.0 * h * h / (A * A))


@njit(cache=True, nogil=True)
def scalar_gravity_slopes(sin_lat: float, cos_lat: float, h: float, code: int) -> tuple[float, float]:
    """Derivatives of :func:`scalar_gravity` with respect to latitude (m/s^2 per rad) and height (1/s^2).

    Parameters
    ----------
    sin_lat, cos_lat : float
        Sine and cosine of the geodetic latitude.
    h : float
        Ellipsoidal height, m.
    code : int
        One of :data:`GRAVITY_CODES`.
    """
    s2 = sin_lat * sin_lat
    x = 1.0 - E2 * s2
    gamma = GAMMA_EQUATOR * (1.0 + _K * s2) / math.sqrt(x)
    d_gamma = gamma * (2.0 * _K / (1.0 + _K * s2) + E2 / x) * sin_lat * cos_lat
    if code == 1:
        return d_gamma * (1.0 - 2.0 * h / A), -2.0 * gamma / A
    p = 1.0 + F + _M - 2.0 * F * s2
    factor = 1.0 - 2.0 * h / A * p + 3.0 * h * h / (A * A)
    d_lat = d_gamma * factor + gamma * 8.0 * F * h / A * sin_lat * cos_lat
    return d_lat, gamma * (-2.0 / A * p + 6.0 * h / (A * A))


def radii(lat: ArrayLike) -> tuple[Array, Array]:
    """Radii of curvature of the ellipsoid.

    Parameters
    ----------
    lat : array_like
        Latitude, rad.

    Returns
    -------
    (R_M, R_N) : arrays of the same shape
        Meridian and prime-vertical radius, m.
    """
    x = 1.0 - E2 * np.sin(np.asarray(lat, dtype=float)) ** 2
    rn = A / np.sqrt(x)
    return rn * (1.0 - E2) / x, rn


def gravity(lat: ArrayLike, h: ArrayLike, model: str = "normal") -> Array:
    """Gravity along the ellipsoid's normal, positive down.

    Parameters
    ----------
    lat, h : array_like
        Latitude in rad and ellipsoidal height in m.
    model : {"normal", "free_air_first_order"}
        See the module.

    Returns
    -------
    array
        m/s^2.
    """
    code = gravity_code(model)
    s2 = np.sin(np.asarray(lat, dtype=float)) ** 2
    h = np.asarray(h, dtype=float)
    gamma = GAMMA_EQUATOR * (1.0 + _K * s2) / np.sqrt(1.0 - E2 * s2)
    if code == 1:
        return np.asarray(gamma * (1.0 - 2.0 * h / A))
    return np.asarray(gamma * (1.0 - 2.0 * h / A * (1.0 + F + _M - 2.0 * F * s2) + 3.0 * h * h / (A * A)))


def normal_gravity_exact(lat: ArrayLike, h: ArrayLike) -> Array:
    """Normal gravity vector in NED from the closed form in ellipsoidal coordinates, at any height.

    Parameters
    ----------
    lat, h : array_like
        Latitude in rad and ellipsoidal height in m.

    Returns
    -------
    (..., 3) array
        North, east (zero) and down component, m/s^2. Source: Heiskanen and Moritz, Physical Geodesy, section 6-2;
        NIMA TR8350.2, equations 4-5 to 4-15.
    """
    lat, h = np.broadcast_arrays(np.asarray(lat, dtype=float), np.asarray(h, dtype=float))
    rn = radii(lat)[1]
    p, z = (rn + h) * np.cos(lat), (rn * (1.0 - E2) + h) * np.sin(lat)
    d = p * p + z * z - _E * _E
    u = np.sqrt(0.5 * d * (1.0 + np.sqrt(1.0 + 4.0 * _E**2 * z * z / (d * d))))
    v2 = u * u + _E * _E
    beta = np.arctan2(z * np.sqrt(v2), u * p)
    sb, cb = np.sin(beta), np.cos(beta)
    w = np.sqrt((u * u + _E**2 * sb * sb) / v2)
    angle = np.arctan(_E / u)
    q = 0.5 * ((1.0 + 3.0 * u * u / _E**2) * angle - 3.0 * u / _E)
    qp = 3.0 * (1.0 + u * u / _E**2) * (1.0 - u / _E * angle) - 1.0
    q0 = _q(B)
    along_u = (
        -(GM / v2 + RATE**2 * A**2 * _E / v2 * qp / q0 * (0.5 * sb * sb - 1.0 / 6.0)) / w + RATE**2 * u * cb * cb / w
    )
    along_beta = (RATE**2 * A**2 / np.sqrt(v2) * q / q0 - RATE**2 * np.sqrt(v2)) * sb * cb / w
    # unit vectors of u and beta in the meridian plane (away from the axis, along the axis)
    up, uz = u * cb / (w * np.sqrt(v2)), sb / w
    bp, bz = -sb / w, u * cb / (w * np.sqrt(v2))
    gp, gz = along_u * up + along_beta * bp, along_u * uz + along_beta * bz
    north = -np.sin(lat) * gp + np.cos(lat) * gz
    down = -np.cos(lat) * gp - np.sin(lat) * gz
    return np.stack([north, np.zeros_like(north), down], axis=-1)


def earth_rate(lat: ArrayLike) -> Array:
    """Angular rate of the Earth with respect to inertial space, in NED, rad/s: shape (..., 3)."""
    lat = np.asarray(lat, dtype=float)
    return np.stack([RATE * np.cos(lat), np.zeros_like(lat), -RATE * np.sin(lat)], axis=-1)


def transport_rate(llh: ArrayLike, vel_ned: ArrayLike) -> Array:
    """Angular rate of the local NED frame with respect to the Earth, in NED, rad/s.

    Parameters
    ----------
    llh, vel_ned : (..., 3) array_like
        Position (rad, rad, m) and Earth-relative velocity in m/s.
    """
    llh, v = np.asarray(llh, dtype=float), np.asarray(vel_ned, dtype=float)
    rm, rn = radii(llh[..., 0])
    h = llh[..., 2]
    east = v[..., 1] / (rn + h)
    return np.stack([east, -v[..., 0] / (rm + h), -east * np.tan(llh[..., 0])], axis=-1)


def dcm_en(lat: ArrayLike, lon: ArrayLike) -> Array:
    """Rotation ``C_en`` from NED at a place to Earth-fixed axes, shape (..., 3, 3)."""
    lat, lon = np.broadcast_arrays(np.asarray(lat, dtype=float), np.asarray(lon, dtype=float))
    sl, cl, so, co = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    c = np.empty((*lat.shape, 3, 3))
    c[..., 0, 0], c[..., 0, 1], c[..., 0, 2] = -sl * co, -so, -cl * co
    c[..., 1, 0], c[..., 1, 1], c[..., 1, 2] = -sl * so, co, -cl * so
    c[..., 2, 0], c[..., 2, 1], c[..., 2, 2] = cl, 0.0, -sl
    return c


def llh_to_ecef(llh: ArrayLike) -> Array:
    """Earth-fixed coordinates in m of ``(..., 3)`` positions (lat rad, lon rad, height m)."""
    import pymap3d

    llh = np.asarray(llh, dtype=float)
    return np.stack(pymap3d.geodetic2ecef(llh[..., 0], llh[..., 1], llh[..., 2], deg=False), axis=-1)


def ecef_to_llh(ecef: ArrayLike) -> Array:
    """Inverse of :func:`llh_to_ecef`, right to the last digit of the angles; for points above -100 km.

    Bowring's fixed point. The last pass and the height are taken in the processor's extended precision: in double precision the terms
    of the height alone lose 2e-9 m. Where there is none (not x86, not Linux on ARM) that loss remains. What is left is the spacing of
    the angles themselves: 1.4e-9 m either way for longitudes beyond 2 rad at the equator.

    Parameters
    ----------
    ecef : (..., 3) array_like
        Earth-fixed coordinates, m.
    """
    ecef = np.asarray(ecef, dtype=float)
    x, y, z = ecef[..., 0], ecef[..., 1], ecef[..., 2]
    p = np.hypot(x, y)
    beta = np.arctan2(z * A, p * B)
    for _ in range(3):  # contracts by about 1e-4 near the surface
        lat = np.arctan2(z + _EP**2 * B * np.sin(beta) ** 3, p - E2 * A * np.cos(beta) ** 3)
        beta = np.arctan2((1.0 - F) * np.sin(lat), np.cos(lat))
    f = np.longdouble(1e9) / np.longdouble(298257223563)
    e2, b = f * (2 - f), A * (1 - f)
    x, y, z, beta = (np.asarray(v, dtype=np.longdouble) for v in (x, y, z, beta))
    p = np.hypot(x, y)
    lat = np.arctan2(z + e2 / (1 - e2) * b * np.sin(beta) ** 3, p - e2 * A * np.cos(beta) ** 3)
    s, c = np.sin(lat), np.cos(lat)
    # distance along the normal from the foot point
    rn = A**2 / np.hypot(A * c, b * s)
    h = (p - rn * c) * c + (z - rn * (b / A) ** 2 * s) * s
    return np.stack([lat, np.arctan2(y, x), h], axis=-1).astype(float)


def ecef_to_ned(ecef: ArrayLike, origin_llh: ArrayLike) -> Array:
    """Coordinates in m in the tangent NED frame at ``origin_llh`` (3,) of Earth-fixed points (..., 3)."""
    import pymap3d

    x, o = np.asarray(ecef, dtype=float), np.asarray(origin_llh, dtype=float)
    return np.stack(pymap3d.ecef2ned(x[..., 0], x[..., 1], x[..., 2], o[0], o[1], o[2], deg=False), axis=-1)


def ned_to_ecef(ned: ArrayLike, origin_llh: ArrayLike) -> Array:
    """Inverse of :func:`ecef_to_ned`."""
    import pymap3d

    x, o = np.asarray(ned, dtype=float), np.asarray(origin_llh, dtype=float)
    return np.stack(pymap3d.ned2ecef(x[..., 0], x[..., 1], x[..., 2], o[0], o[1], o[2], deg=False), axis=-1)


def llh_to_ned(llh: ArrayLike, origin_llh: ArrayLike) -> Array:
    """Coordinates in m in the tangent NED frame at ``origin_llh`` (3,) of positions (..., 3)."""
    return ecef_to_ned(llh_to_ecef(llh), origin_llh)


def ned_to_llh(ned: ArrayLike, origin_llh: ArrayLike) -> Array:
    """Inverse of :func:`llh_to_ned`."""
    return ecef_to_llh(ned_to_ecef(ned, origin_llh))


def position_difference(llh: ArrayLike, reference_llh: ArrayLike) -> Array:
    """Small difference ``llh - reference`` in metres north, east, down, by the radii at the reference.

    This is the position error of the filter's states: ``(dlat (R_M + h), dlon (R_N + h) cos(lat), -dh)``.
    """
    llh, reference = np.asarray(llh, dtype=float), np.asarray(reference_llh, dtype=float)
    rm, rn = radii(reference[..., 0])
    h = reference[..., 2]
    dlon = (llh[..., 1] - reference[..., 1] + np.pi) % (2.0 * np.pi) - np.pi
    # the fold above costs digits; where there is nothing to fold the plain difference is exact
    plain = llh[..., 1] - reference[..., 1]
    dlon = np.where(np.abs(plain) < np.pi, plain, dlon)
    return np.stack(
        [
            (llh[..., 0] - reference[..., 0]) * (rm + h),
            dlon * (rn + h) * np.cos(reference[..., 0]),
            -(llh[..., 2] - h),
        ],
        axis=-1,
    )


def move(llh: ArrayLike, ned: ArrayLike) -> Array:
    """Position moved by small metres north, east, down; inverse of :func:`position_difference`."""
    llh, ned = np.asarray(llh, dtype=float), np.asarray(ned, dtype=float)
    rm, rn = radii(llh[..., 0])
    h = llh[..., 2]
    return np.stack(
        [
            llh[..., 0] + ned[..., 0] / (rm + h),
            llh[..., 1] + ned[..., 1] / ((rn + h) * np.cos(llh[..., 0])),
            h - ned[..., 2],
        ],
        axis=-1,
    )
