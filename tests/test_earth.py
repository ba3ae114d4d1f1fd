import decimal

import numpy as np
import pymap3d
import pytest

from insemu import earth
from insemu.errors import InputError

rng = np.random.default_rng(11)
PLACES = np.column_stack(
    [np.arcsin(rng.uniform(-1, 1, 300)), rng.uniform(-np.pi, np.pi, 300), rng.uniform(-1e3, 2e4, 300)]
)


def test_ecef_agrees_with_pymap3d():
    theirs = np.column_stack(pymap3d.geodetic2ecef(*PLACES.T, deg=False))
    np.testing.assert_allclose(earth.llh_to_ecef(PLACES), theirs, rtol=0, atol=1e-9)


def test_ecef_and_back_is_the_identity():
    edge = np.array([[np.pi / 2, 0, 10.0], [-np.pi / 2, 0, 5.0], [0, np.pi, 0], [0, -1, 4e5], [1e-9, 2, -50.0]])
    for llh in (PLACES, edge):
        back = earth.ecef_to_llh(earth.llh_to_ecef(llh))
        np.testing.assert_allclose(earth.llh_to_ecef(back), earth.llh_to_ecef(llh), rtol=0, atol=5e-9)
        np.testing.assert_allclose(back[:, 2], llh[:, 2], rtol=0, atol=3e-9)


def exact_ecef(llh):
    """Earth-fixed coordinates with 40 digits, from the defining a = 6378137 m and 1/f = 298.257223563."""
    context = decimal.Context(prec=40)

    def sine(x):
        term, total, k = x, x, 1
        while abs(term) > decimal.Decimal("1e-38"):
            k += 2
            term = -term * x * x / ((k - 1) * k)
            total += term
        return total

    with decimal.localcontext(context):
        pi = decimal.Decimal("3.141592653589793238462643383279502884197169")
        lat, lon, h = (decimal.Decimal(float(v)) for v in llh)
        a, f = decimal.Decimal(6378137), 1 / decimal.Decimal("298.257223563")
        s, c = sine(lat), sine(pi / 2 - lat)
        e2 = f * (2 - f)
        rn = a / (1 - e2 * s * s).sqrt()
        return [(rn + h) * c * sine(pi / 2 - lon), (rn + h) * c * sine(lon), (rn * (1 - e2) + h) * s]


def beyond_rounding(llh, ecef):
    """Distance in m of a place from ``ecef`` beyond half of the spacing of its angles."""
    distance = sum((a - decimal.Decimal(float(b))) ** 2 for a, b in zip(exact_ecef(llh), ecef, strict=True)).sqrt()
    half = 0.5 * earth.A * np.spacing(np.abs(llh[:2])) * [1.0, np.cos(llh[0])]
    return float(distance) - np.hypot(*half)


def test_inverse_is_right_to_a_nanometre():
    """40 digits are the judge, because pymap3d is not right to a nanometre."""
    places = earth.llh_to_ecef(PLACES[:100]) + rng.uniform(-1e-3, 1e-3, (100, 3))
    extended = np.finfo(np.longdouble).eps < 1e-18
    assert max(map(beyond_rounding, earth.ecef_to_llh(places), places)) < (1e-10 if extended else 4e-9)
    theirs = np.column_stack(pymap3d.ecef2geodetic(*places.T, deg=False))
    assert max(map(beyond_rounding, theirs, places)) > 1e-9
    np.testing.assert_allclose(earth.ecef_to_llh(places), theirs, rtol=0, atol=5e-9)


def test_local_frame_agrees_with_pymap3d():
    origin = np.array([0.8, 0.2, 350.0])
    ned = rng.uniform(-5e3, 5e3, (100, 3))
    ecef = np.column_stack(pymap3d.enu2ecef(ned[:, 1], ned[:, 0], -ned[:, 2], *origin, deg=False))
    np.testing.assert_allclose(earth.ned_to_ecef(ned, origin), ecef, rtol=0, atol=1e-9)
    llh = earth.ned_to_llh(ned, origin)
    east, north, up = pymap3d.geodetic2enu(*llh.T, *origin, deg=False)
    np.testing.assert_allclose(earth.llh_to_ned(llh, origin), np.column_stack([north, east, -up]), rtol=0, atol=1e-9)
    np.testing.assert_allclose(earth.llh_to_ned(llh, origin), ned, rtol=0, atol=5e-9)  # forward in double precision


def test_rotation_to_earth_axes_agrees_with_pymap3d():
    for lat, lon, _ in PLACES[:20]:
        v = rng.normal(size=3)
        u, w, x = pymap3d.enu2uvw(v[1], v[0], -v[2], lat, lon, deg=False)
        np.testing.assert_allclose(earth.dcm_en(lat, lon) @ v, [u, w, x], atol=1e-14)


def test_radii_agree_with_pymap3d():
    np.testing.assert_allclose(earth.radii(0.7)[0], pymap3d.rcurve.meridian(0.7, deg=False), atol=1e-9 * 6.4e6)
    np.testing.assert_allclose(earth.radii(0.7)[1], pymap3d.rcurve.transverse(0.7, deg=False), atol=1e-9 * 6.4e6)


def test_normal_gravity_constants_are_those_of_wgs84():
    assert earth.GAMMA_EQUATOR == pytest.approx(9.7803253359, abs=1e-10)
    assert earth.GAMMA_POLE == pytest.approx(9.8321849379, abs=1e-10)


def test_normal_gravity_matches_the_closed_form():
    lat = np.linspace(-np.pi / 2, np.pi / 2, 91)
    on_ellipsoid = earth.normal_gravity_exact(lat, 0.0)
    np.testing.assert_allclose(earth.gravity(lat, 0.0), on_ellipsoid[:, 2], rtol=0, atol=1e-9)
    np.testing.assert_allclose(on_ellipsoid[:, 0], 0.0, atol=1e-9)
    np.testing.assert_allclose(earth.gravity(lat, 1e4), earth.normal_gravity_exact(lat, 1e4)[:, 2], rtol=0, atol=1e-6)
    # the first-order model is measurably another one
    assert np.abs(earth.gravity(lat, 1e4, "free_air_first_order") - earth.gravity(lat, 1e4)).max() > 5e-5


@pytest.mark.parametrize("model", ["normal", "free_air_first_order"])
def test_compiled_gravity_and_its_slopes(model):
    code = earth.gravity_code(model)
    for lat, h in ((0.6, 300.0), (-1.2, 9000.0), (0.0, -50.0)):
        s, c = np.sin(lat), np.cos(lat)
        assert earth.scalar_gravity(s, h, code) == pytest.approx(float(earth.gravity(lat, h, model)), rel=1e-15)
        slopes = earth.scalar_gravity_slopes(s, c, h, code)
        d = 1e-4
        by_lat = (earth.gravity(lat + d, h, model) - earth.gravity(lat - d, h, model)) / (2 * d)
        by_h = (earth.gravity(lat, h + 1, model) - earth.gravity(lat, h - 1, model)) / 2
        np.testing.assert_allclose(slopes, [by_lat, by_h], rtol=1e-6, atol=1e-9)


def test_unknown_gravity_model_is_named():
    with pytest.raises(InputError, match=r"'norml'.*did you mean 'normal'"):
        earth.gravity_code("norml")


def test_small_moves_and_differences_are_inverse():
    llh = np.array([[0.8, np.pi - 1e-9, 100.0]])
    ned = np.array([[3.0, 0.004, -7.0]])
    np.testing.assert_allclose(earth.position_difference(earth.move(llh, ned), llh), ned, atol=1e-8)
    wrapped = np.array([[0.8, -np.pi + 1e-6, 100.0]])
    assert earth.position_difference(wrapped, llh)[0, 1] == pytest.approx(
        1.001e-6 * (earth.radii(0.8)[1] + 100) * np.cos(0.8), rel=1e-6
    )


def test_transport_rate_is_the_rotation_of_the_local_frame():
    llh, v, dt = np.array([0.9, 0.3, 500.0]), np.array([80.0, -40.0, 3.0]), 1e-2
    after = earth.move(llh, v * dt / 2), earth.move(llh, -v * dt / 2)
    d = earth.dcm_en(*llh[:2]).T @ (earth.dcm_en(*after[0][:2]) - earth.dcm_en(*after[1][:2])) / dt
    np.testing.assert_allclose(earth.transport_rate(llh, v), [d[2, 1], d[0, 2], d[1, 0]], atol=1e-12)
