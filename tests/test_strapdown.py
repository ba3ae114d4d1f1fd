import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from insemu import earth, rotation, strapdown
from insemu.errors import InputError
from insemu.records import ImuRecord, Trajectory
from tests.shared_data import shared

ZERO = np.zeros(3)


def fixture(name):
    with np.load(shared(f"fixtures/inertial/{name}_100hz.npz")) as file:
        data = dict(file)
    llh = data["lla"].copy()
    llh[:, :2] = np.deg2rad(llh[:, :2])
    reference = Trajectory(data["time"], llh, data["vel_ned"], np.deg2rad(data["rph"]))
    return ImuRecord(data["time"], data["gyro_incr"], data["accel_incr"], "increment"), reference


@pytest.mark.parametrize(("name", "limit_m"), [("car", 0.020), ("uav", 0.065)])
def test_dead_reckoning_of_increments_made_by_others(name, limit_m):
    imu, reference = fixture(name)
    nav = strapdown.mechanize(imu, reference, gravity="free_air_first_order")
    error = earth.position_difference(nav.llh, reference.llh)
    assert np.linalg.norm(error, axis=1).max() <= limit_m
    assert np.abs(rotation.attitude_difference(nav.rpy, reference.rpy)).max() <= 1e-6
    # the wrong gravity model shows at once: the test can fail
    other = strapdown.mechanize(imu, reference, gravity="normal")
    assert np.linalg.norm(earth.position_difference(other.llh, reference.llh), axis=1).max() > 0.1


def static_record(hours, lat=0.8, h=200.0, rate=1.0):
    t = np.arange(int(hours * 3600 * rate) + 1) / rate
    rpy = np.array([0.02, -0.03, 0.7])
    c = rotation.dcm_from_rpy(rpy)
    gyro = np.tile(c.T @ earth.earth_rate(lat) / rate, (t.size, 1))
    accel = np.tile(c.T @ [0, 0, -float(earth.gravity(lat, h))] / rate, (t.size, 1))
    return ImuRecord(t, gyro, accel, "increment"), strapdown.NavState(np.array([lat, 0.1, h]), np.zeros(3), rpy)


@pytest.mark.parametrize("rate", [1.0, 10.0])
def test_static_day_stays_where_it_is(rate):
    """Neither truncation nor rounding (which repeats at every step of a vehicle at rest) adds up over 24 h."""
    imu, initial = static_record(24.0, rate=rate)
    nav = strapdown.mechanize(imu, initial, vertical="held")
    drift = earth.position_difference(nav.llh, initial.llh)
    assert np.hypot(drift[:, 0], drift[:, 1]).max() <= 1e-3
    assert np.abs(drift[:, 2]).max() == 0.0


@pytest.mark.parametrize("lat", [0.0, 0.3])
@pytest.mark.parametrize("axis", ["north", "east"])
def test_schuler_period(axis, lat):
    """After a tilt the velocity swings with the Schuler period, on top of the slow 24-h and Foucault motion that is
    fitted too.

    The characteristic polynomial is (s^2 + W^2) ((s^2 + w^2)^2 + 4 s^2 W^2 sin^2 L) (Britting 1971), so near the
    equator and over a few hours the north and the east channel keep their own radius.
    """
    imu, initial = static_record(3.0, lat=lat)
    phi = np.array([0.0, 1e-5, 0.0]) if axis == "north" else np.array([1e-5, 0.0, 0.0])
    c = rotation.dcm_from_vector(phi) @ rotation.dcm_from_rpy(initial.rpy)
    tilted = strapdown.NavState(initial.llh, initial.vel_ned, rotation.rpy_from_dcm(c))
    nav = strapdown.mechanize(imu, tilted, vertical="held")
    t, v = imu.t, nav.vel_ned[:, 0 if axis == "north" else 1]
    foucault = np.cos(earth.RATE * np.sin(lat) * t)
    slow = [np.ones_like(t), np.cos(earth.RATE * t), np.sin(earth.RATE * t)]

    def misfit(period):
        w = 2 * np.pi / period
        basis = np.column_stack([*slow, foucault * np.cos(w * t), foucault * np.sin(w * t)])
        return np.linalg.lstsq(basis, v, rcond=None)[1][0]

    radii = [r + initial.llh[2] for r in earth.radii(lat)]
    g = float(earth.gravity(lat, initial.llh[2]))
    north, east = (2 * np.pi * np.sqrt(r / g) for r in radii)
    period = minimize_scalar(misfit, bracket=(0.99 * north, 1.01 * north)).x
    own, other = (north, east) if axis == "north" else (east, north)
    assert period == pytest.approx(own, rel=1e-3)
    assert abs(period - own) < abs(period - other)


STATES = [
    strapdown.NavState(np.array([0.8, 0.2, 300.0]), np.array([20.0, -35.0, 4.0]), np.array([0.3, -0.2, 2.0])),
    strapdown.NavState(np.array([-0.5, -2.2, 9000.0]), np.array([-230.0, 90.0, -12.0]), np.array([-0.8, 0.4, -1.0])),
    strapdown.NavState(np.array([1.2, 3.0, -20.0]), np.array([0.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.5])),
]


@pytest.mark.parametrize("gravity", ["normal", "free_air_first_order"])
@pytest.mark.parametrize("state", STATES, ids=["north", "south, fast", "rest"])
def test_error_dynamics_are_the_derivative_of_the_mechanization(state, gravity):
    """Every column of F, sensor inputs included, by central differences of runs of the mechanization itself."""
    dt, n = 1e-3, 40
    code = earth.gravity_code(gravity)
    w, f = np.array([0.2, -0.1, 0.3]), np.array([1.0, -2.0, -9.0])

    def run(error, dw=ZERO, df=ZERO):
        nav = state.to_array()
        strapdown.correct(nav, -error)
        for _ in range(n):
            dtheta, dvel = (w + dw) * dt, (f + df) * dt
            strapdown.step(nav, dtheta, dvel, dtheta, dvel, dt, dt, code)
        return nav

    def slope(size, inputs=None):
        columns = []
        for j in range(len(size)):
            e = np.zeros(len(size))
            e[j] = size[j]
            if inputs is None:
                plus, minus = run(e), run(-e)
            else:
                plus, minus = run(np.zeros(9), **{inputs: e}), run(np.zeros(9), **{inputs: -e})
            # both against the unperturbed run, whose radii define the metres
            above, below = (strapdown.navigation_errors(x[None], centre[None])[0] for x in (plus, minus))
            columns.append((above - below) / (2 * size[j]))
        return np.array(columns).T

    centre = run(np.zeros(9))

    transition = slope(np.array([1e3] * 3 + [1.0] * 3 + [1e-4] * 3))
    # the reference transition: products of the local ones along the unperturbed run
    nav = state.to_array()
    expected, gain_w, gain_f = np.eye(9), np.zeros((9, 3)), np.zeros((9, 3))
    for _ in range(n):
        before = nav.copy()
        strapdown.step(nav, w * dt, f * dt, w * dt, f * dt, dt, dt, code)
        middle = 0.5 * (before + nav)
        c = rotation.dcm_from_quaternion(middle[6:] / np.linalg.norm(middle[6:]))
        phi = strapdown.transition(strapdown.error_dynamics(middle, c @ f, gravity=gravity), dt)
        into = np.zeros((9, 6))
        into[6:, :3], into[3:6, 3:] = c, c
        step = 0.5 * (phi + np.eye(9)) @ into * dt
        expected, gain_w, gain_f = phi @ expected, phi @ gain_w + step[:, :3], phi @ gain_f + step[:, 3:]
    # what F says of the change over 40 ms, entry by entry, in units in which every state is of order one
    scale = np.array([1e3] * 3 + [1.0] * 3 + [1e-4] * 3)
    change = (transition - np.eye(9)) * scale / scale[:, None]
    predicted = (expected - np.eye(9)) * scale / scale[:, None]
    size = np.abs(predicted)
    floor = 3e-9 if np.abs(state.vel_ned).max() < 100 else 1e-8
    np.testing.assert_allclose(change, predicted, rtol=2e-4, atol=floor)
    assert (size > 30 * floor).sum() >= 24  # enough entries are pinned in sign and size
    np.testing.assert_allclose(slope(np.full(3, 0.1), "dw"), gain_w, rtol=1e-3, atol=2e-7)
    np.testing.assert_allclose(slope(np.full(3, 2.0), "df"), gain_f, rtol=1e-3, atol=2e-8)


def test_error_dynamics_of_position_and_rates_pin_the_small_terms():
    """The terms of 1e-6 and below (moving radii, Earth and transport rate), from the kinematics at an instant."""
    state = STATES[1]
    f_n = np.array([0.5, -1.0, -9.7])

    def derivative(nav):
        llh, v, c = nav[:3], nav[3:6], rotation.dcm_from_quaternion(nav[6:])
        wie, wen = earth.earth_rate(llh[0]), earth.transport_rate(llh, v)
        rm, rn = earth.radii(llh[0])
        llh_dot = np.array([v[0] / (rm + llh[2]), v[1] / ((rn + llh[2]) * np.cos(llh[0])), -v[2]])
        f_b = rotation.dcm_from_quaternion(state.to_array()[6:]).T @ f_n
        v_dot = c @ f_b + [0, 0, float(earth.gravity(llh[0], llh[2]))] - np.cross(2 * wie + wen, v)
        return llh_dot, v_dot, wie + wen

    nav0 = state.to_array()
    f = strapdown.error_dynamics(state, f_n)
    base = derivative(nav0)
    numeric = np.zeros((9, 9))
    sizes = np.array([100.0] * 3 + [1.0] * 3 + [1e-4] * 3)  # 1e-5 rad would leave 3e-11 of rounding
    for j in range(9):
        out = []
        for sign in (1.0, -1.0):
            e = np.zeros(9)
            e[j] = sign * sizes[j]
            nav = nav0.copy()
            strapdown.correct(nav, -e)
            llh_dot, v_dot, w_in = derivative(nav)
            # metres by the radii of the moving truth: d/dt (x(estimate) - x(truth)) over a short time of both
            tau = 1e-2
            moved = [
                earth.position_difference(nav[:3] + s * tau * llh_dot, nav0[:3] + s * tau * base[0]) for s in (1, -1)
            ]
            phi = rotation.dcm_from_vector(e[6:])
            rate = phi @ base[2] - w_in  # C w_ib is common; seen in NED it turns with the attitude error
            out.append(np.concatenate([(moved[0] - moved[1]) / (2 * tau), v_dot - base[1], rate]))
        numeric[:, j] = (out[0] - out[1]) / (2 * sizes[j])
    # phi' = w_in(truth) seen in the turned frame - w_in(estimate) = -w_in x phi - dw_in
    np.testing.assert_allclose(f, numeric, rtol=1e-4, atol=2e-11)


def test_transition_is_second_order():
    f = strapdown.error_dynamics(STATES[0], [0.5, -1.0, -9.7])
    from scipy.linalg import expm

    errors = [np.abs(strapdown.transition(f, dt) - expm(f * dt)).max() for dt in (0.2, 0.1)]
    assert 7.0 < errors[0] / errors[1] < 9.0


def test_irregular_steps_keep_the_coning_correction():
    """Linear rate and specific force: uneven steps lose no more than even ones."""
    results = {}
    for name, t in {
        "even": np.linspace(0, 2.0, 201),
        "uneven": np.cumsum(np.r_[0, np.tile([0.004, 0.016], 100)]),
        "fine": np.linspace(0, 2.0, 20001),
    }.items():
        angle = np.stack([0.2 * np.sin(3 * t), 0.2 * np.cos(3 * t), 0.3 * t**2], 1)  # integral of the rate
        speed = np.stack([np.cos(3 * t), -np.sin(3 * t), -9.8 * t], 1)
        gyro, accel = np.diff(angle, axis=0), np.diff(speed, axis=0)
        imu = ImuRecord(t, np.vstack([gyro[:1], gyro]), np.vstack([accel[:1], accel]), "increment")
        results[name] = strapdown.mechanize_array(imu, STATES[2])[-1]
    error = {
        k: np.abs(strapdown.navigation_errors(results[k][None], results["fine"][None])[0]) for k in ("even", "uneven")
    }
    assert error["even"][6:].max() < 1e-6
    assert error["uneven"][6:].max() < 10 * error["even"][6:].max() + 1e-9
    assert error["uneven"][3:6].max() < 1e-4


def test_a_gap_does_not_amplify_the_noise_of_the_sample_before_it():
    assert strapdown.scalar_coning_factor(0.01, 0.01) == pytest.approx(1 / 12)
    assert strapdown.scalar_coning_factor(0.02, 0.01) == pytest.approx(4 / 18)
    assert strapdown.scalar_coning_factor(1.0, 0.01) == 0.0


def test_longitude_wraps_at_the_antimeridian():
    state = strapdown.NavState(np.array([0.1, np.pi - 1e-7, 0.0]), np.array([0.0, 100.0, 0.0]), np.zeros(3))
    nav = state.to_array()
    u = np.array([0.0, 0.0, -9.8])
    strapdown.step(nav, np.zeros(3), u, np.zeros(3), u, 1.0, 1.0, 0)
    assert -np.pi <= nav[1] < -3.1


def test_means_and_increments_navigate_alike():
    imu, initial = static_record(0.05)
    mean = ImuRecord(imu.t, imu.gyro * 1.0, imu.accel * 1.0, "mean")
    one, other = (strapdown.mechanize_array(record, initial)[-1] for record in (mean, imu))
    np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)  # 180 steps


def test_bad_input_is_named():
    imu, initial = static_record(0.01)
    with pytest.raises(InputError, match="1 sample"):
        strapdown.mechanize(ImuRecord([0.0], np.zeros((1, 3)), np.zeros((1, 3))), initial)
    with pytest.raises(InputError, match="vertical is 'fixed'"):
        strapdown.mechanize(imu, initial, vertical="fixed")
    with pytest.raises(InputError, match=r"latitude is 90"):
        strapdown.mechanize(imu, strapdown.NavState(np.array([np.pi / 2, 0, 0]), np.zeros(3), np.zeros(3)))
    with pytest.raises(InputError, match="diverged"):
        wild = ImuRecord(imu.t, imu.gyro, np.full_like(imu.accel, 1e99), "increment")
        strapdown.mechanize(wild, initial)
