"""Realizations in vector lanes: the numbers of the single run, whoever flies beside whom."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numba import njit

from insemu import lanes, rotation
from insemu.augment import Extras
from insemu.errors import InputError
from insemu.filters import FilterOptions, LooselyCoupledEKF, Standstill, TrueMotion
from insemu.filters.aids import AIDS
from insemu.noise import AR, GM, MA, QN, RW, WN, Follows
from insemu.records import AidRecord, GnssRecord
from insemu.strapdown import navigation_errors
from tests import filter_cases as cases
from tests.test_filters import LEVER
from tests.test_following import LAWS

SECONDS = 20.0
#: A digit of a latitude, m: what two places that are the same may differ by.
DIGIT = 2e-9
TIMES = {
    "gyro": WN(5e-4) + GM(3e-4, 0.5, follows=Follows("temperature", 0.05, 25.0, what="time")),
    "accel": WN(1e-3) + AR((1.6, -0.65), sigma2=1e-6, follows=Follows("speed", 0.1, 10.0, "exp", what="time")),
}
ROUGH = {
    "gyro": QN(1e-6) + WN(5e-4) + GM(3e-4, 0.1),
    "accel": MA(ma=(0.5, 0.2), sigma2=1e-5, rate_hz=cases.RATE) + RW(1e-4),
}


@pytest.fixture(scope="module")
def road():
    return cases.drive(SECONDS)


def flights(road, model, count, **fixes):
    """Records, fixes and starts of as many realizations; IMUs that warm up, each in its own way."""
    made = []
    for k in range(count):
        rng = np.random.default_rng(k)
        plain = {a: type(m)(tuple(replace(p, follows=None) for p in m)) for a, m in model.items()}
        imu = cases.corrupt(road.imu, plain, rng)
        imu = replace(imu, temperature=20.0 + (1.0 + k) * imu.t / SECONDS)
        made.append((imu, cases.fixes(road, rng, **fixes), cases.start(road, rng)))
    return [list(part) for part in zip(*made, strict=True)]


def aids_of(road, rng):
    """One record of every kind that means something on a drive; the odometer goes on between the epochs."""
    C = rotation.dcm_from_quaternion(road.nav[:, 6:10])
    t = np.arange(0.5, SECONDS - 0.5, 0.7)
    at = np.searchsorted(road.t, t)
    body = np.einsum("kji,kj->ki", C[at], road.nav[at, 3:6])
    heading = rotation.rpy_from_quaternion(road.nav[at, 6:10])[:, 2:]
    settings = {"odometer": (0.3, 0.1, -0.2, 0.01, -0.02, 0.03), "barometer": (0.1, 0.2, 0.3), "heading": (0.05,)}
    settings |= {
        "nonholonomic": settings["odometer"],
        "magnetometer": (0.05, 1.1, 0.1, -0.2, 2.0),
        "dual_antenna": (1.0, 0.2, -0.1),
    }
    settings |= {"pose": (*road.nav[0, :3], 0.02, 0.01, -1.5)}
    values = {"odometer": body, "barometer": road.nav[at, 2:3], "heading": heading, "nonholonomic": body[:, 1:]}
    motion = TrueMotion(road.nav[at, :3], road.nav[at, 3:6], C[at], road.imu.gyro[at])
    values |= {k: AIDS[k].truth(motion, np.array(settings[k])) for k in ("magnetometer", "dual_antenna", "pose")}
    noise = dict.fromkeys(values, 0.02) | {"odometer": 0.1, "nonholonomic": 0.1, "barometer": 0.5}
    return [
        AidRecord(
            kind,
            t - 0.003,
            v + noise[kind] * rng.standard_normal(v.shape),
            np.full(v.shape, noise[kind]),
            since=t - 0.2,
            settings=settings[kind],
        )
        for kind, v in values.items()
    ]


def relative(a, b):
    """Largest difference of two results: of estimates in their standard deviations, of everything else in its own scale."""
    sigma = np.maximum(b.sigma, 1e-300)
    moved = np.abs(navigation_errors(a.nav, b.nav))
    moved[:, :3] = np.maximum(moved[:, :3] - DIGIT, 0.0)
    parts = [moved / sigma[:, :9], (a.imu_states - b.imu_states) / sigma[:, 9:], (a.sigma - b.sigma) / sigma]

    def matrices(p, q):
        scale = np.sqrt(np.maximum(np.einsum("kii->ki", q), 1e-300))
        return (p - q) / (scale[:, :, None] * scale[:, None, :])

    parts += [matrices(a.covariance, b.covariance), matrices(a.final_covariance[None], b.final_covariance[None])]
    used = b.fixes.dof > 0
    np.testing.assert_array_equal(a.fixes.accepted, b.fixes.accepted)
    np.testing.assert_array_equal(a.fixes.dof, b.fixes.dof)
    np.testing.assert_array_equal(np.isnan(a.fixes.S), np.isnan(b.fixes.S))
    d = np.sqrt(np.einsum("kii->ki", b.fixes.complete[1]))
    parts += [
        a.fixes.nis[used] / b.fixes.nis[used] - 1.0,
        (a.fixes.complete[0] - b.fixes.complete[0]) / d,
        (a.fixes.complete[1] - b.fixes.complete[1]) / (d[:, :, None] * d[:, None, :]),
    ]
    if b.nodes is not None:
        np.testing.assert_array_equal(a.nodes.epoch, b.nodes.epoch)
        own = np.sqrt(np.maximum(np.einsum("kii->ki", b.nodes.P_after), 1e-300))
        parts += [matrices(a.nodes.P_before, b.nodes.P_before), matrices(a.nodes.P_after, b.nodes.P_after)]
        parts += [(a.nodes.Phi - b.nodes.Phi) / own[:, :, None] * np.roll(own, 1, axis=0)[:, None, :]]
        parts += [(a.nodes.correction - b.nodes.correction) / own]
        accepted = b.fixes.accepted
        known = np.isfinite(b.fixes.K[accepted])
        np.testing.assert_array_equal(np.isfinite(a.fixes.K[accepted]), known)
        parts += [(a.fixes.K[accepted] - b.fixes.K[accepted])[known], (a.fixes.H - b.fixes.H)[used]]
    return max(np.abs(p).max() for p in parts if p.size)


@pytest.mark.parametrize(
    ("model", "options"),
    [
        (cases.MODEL_15, {}),
        (cases.MODEL_24, {"covariance_every": 5, "output_every": 10}),
        (cases.MODEL_27, {"store": "fixes", "node_every": 0.5}),
        (ROUGH, {"covariance_every": 4, "store": "fixes"}),
        (cases.MODEL_RW, {"extras": Extras(gyro_scale=1e-3, accel_misalignment=2e-3, lever_arm=0.1)}),
        (cases.MODEL_15, {"extras": Extras(gyro_scale_temperature=1e-3, accel_scale=1e-3), "store": "fixes"}),
        (LAWS, {"covariance_every": 3}),
        (TIMES, {}),
        (TIMES, {"covariance_every": 3}),
    ],
    ids=["15", "24", "27", "rough", "extras", "warm", "laws", "times", "sparse times"],
)
def test_lanes_are_the_single_run(road, model, options):
    imus, gnsses, starts = flights(road, model, 3, lever_arm=LEVER)
    gnsses = [replace(g, t=g.t - 0.0037) for g in gnsses]
    asked = FilterOptions(covariance_at=(3.0, 11.5), gate=1e-3, **{"output_every": 7} | options)
    ekf = LooselyCoupledEKF(model, cases.DT, lever_arm=LEVER, options=asked)
    for many, imu, gnss, start in zip(
        ekf.run_many(imus, gnsses, starts, cases.START_SIGMA), imus, gnsses, starts, strict=True
    ):
        assert relative(many, ekf.run(imu, gnss, start, cases.START_SIGMA)) < 1e-12


def test_a_gate_and_missing_components_decide_lane_by_lane(road):
    """Of nine realizations every one has an outlier and a fix without velocities elsewhere; one has a run of rejected fixes until the gate opens."""
    imus, gnsses, starts = flights(road, cases.MODEL_15, 9)
    for k, gnss in enumerate(gnsses):
        llh, vel = gnss.llh.copy(), gnss.vel_ned.copy()
        llh[2 + k, 0] += 1e-6
        vel[(5 + k) % 19] = np.nan
        llh[(9 + k) % 19] = np.nan
        if k == 4:
            llh[8:, 1] += 1e-6
        gnsses[k] = replace(gnss, llh=llh, vel_ned=vel)
    asked = FilterOptions(gate=1e-3, gate_timeout=5.0)
    ekf = LooselyCoupledEKF(cases.MODEL_15, cases.DT, gnss_sigma=(0.05, 0.03), options=asked)
    out = ekf.run_many(imus, gnsses, starts, cases.START_SIGMA)
    for k, (many, imu, gnss, start) in enumerate(zip(out, imus, gnsses, starts, strict=True)):
        assert relative(many, ekf.run(imu, gnss, start, cases.START_SIGMA)) < 1e-12
        assert 2 + k in many.fixes.rejected and len(many.fixes.rejected) >= (5 if k == 4 else 1)
        assert {int(d) for d in many.fixes.dof} >= {3, 6}


def test_aids_fly_in_lanes(road):
    rng = np.random.default_rng(5)
    imus, gnsses, starts = flights(road, cases.MODEL_24, 3)
    aids = [aids_of(road, rng) for _ in imus]
    assert {a.kind for a in aids[0]} | {"standstill"} == set(AIDS)
    asked = FilterOptions(standstill=Standstill(((3.0, 6.0),), velocity_sigma=20.0, rate_sigma=1.0), store="fixes")
    ekf = LooselyCoupledEKF(cases.MODEL_24, cases.DT, options=asked)
    out = ekf.run_many(imus, gnsses, starts, cases.START_SIGMA, aids=aids)
    for many, *given in zip(out, imus, gnsses, starts, aids, strict=True):
        assert set(many.fixes.kind) == set(range(1 + len(AIDS)))
        # aids and standstill update hundreds of times beside the fixes, and every update rounds
        assert relative(many, ekf.run(*given[:3], cases.START_SIGMA, aids=given[3])) < 1e-11


def test_grouping_changes_no_bit_and_failures_stay_in_their_lane(road):
    imus, gnsses, starts = flights(road, cases.MODEL_15, 10)
    asked = FilterOptions(gate=0.05, output_every=50, covariance_at=(5.0,))
    ekf = LooselyCoupledEKF(cases.MODEL_15, cases.DT, options=asked)
    whole = ekf.run_many(imus, gnsses, starts, cases.START_SIGMA)

    def same(a, b):
        for name in ("nav", "sigma", "imu_states", "covariance", "final_covariance"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        np.testing.assert_array_equal(a.fixes.nis, b.fixes.nis)

    for k in (9, 3):
        (alone,) = ekf.run_many([imus[k]], [gnsses[k]], [starts[k]], cases.START_SIGMA)
        same(alone, whole[k])
    # one record that diverges, one with fixes of its own times, one whose attitude turns by half a turn in a step, one of another rate
    far, wild = imus[0].accel.copy(), imus[2].gyro.copy()
    far[700], wild[400] = 1e40, [2.5, 1.0, 0.3]
    wrong, apart = list(imus), list(gnsses)
    wrong[0], wrong[2] = replace(imus[0], accel=far), replace(imus[2], gyro=wild)
    wrong[5] = replace(imus[5], t=imus[5].t * 1.1)
    apart[1] = replace(gnsses[1], t=gnsses[1].t - 0.004)
    out = ekf.run_many(wrong, apart, starts, cases.START_SIGMA)
    # a division by zero ends the single run earlier than lanes, which say where it led
    with pytest.raises(InputError, match=r"diverged|not positive"):
        ekf.run(wrong[0], apart[0], starts[0], cases.START_SIGMA)
    assert isinstance(out[0], InputError)
    # after the turn corrections are thousands of standard deviations
    for k, bound in ((1, 1e-12), (5, 1e-12), (2, 1e-8)):
        assert relative(out[k], ekf.run(wrong[k], apart[k], starts[k], cases.START_SIGMA)) < bound
    for k in (3, 4, 6, 7, 8, 9):
        same(out[k], whole[k])


@pytest.mark.parametrize("model", [cases.MODEL_27, ROUGH], ids=["27", "rough"])
def test_fixes_of_other_times_fly_side_by_side(road, model):
    """Every realization has an outage of its own, and rejected fixes: a fix in another lane changes no bit."""
    imus, gnsses, starts = flights(road, model, 5)
    gnsses = [replace(g, t=g.t - 0.001 * (k % 2)) for k, g in enumerate(gnsses)]
    gnsses = [
        GnssRecord(*(getattr(g, name)[keep] for name in ("t", "llh", "vel_ned", "pos_std_ned", "vel_std_ned")))
        for k, g in enumerate(gnsses)
        for keep in [~((g.t > 3.5 + k) & (g.t < 7.2 + 2 * k))]
    ]
    rng = np.random.default_rng(5)
    aids = [aids_of(road, rng) for _ in imus]
    ekf = LooselyCoupledEKF(model, cases.DT, options=FilterOptions(gate=0.2))
    together = ekf.run_many(imus, gnsses, starts, cases.START_SIGMA, aids=aids)
    for k, (many, *given) in enumerate(zip(together, imus, gnsses, starts, aids, strict=True)):
        (alone,) = ekf.run_many(*([v] for v in given[:3]), cases.START_SIGMA, aids=[given[3]])
        for name in ("nav", "sigma", "imu_states", "final_covariance"):
            np.testing.assert_array_equal(getattr(many, name), getattr(alone, name))
        assert len(many.fixes) == len(alone.fixes) and 3 <= np.count_nonzero(many.fixes.kind == 0) < 19
        for name in ("t", "epoch", "kind", "nis", "S", "dof"):
            np.testing.assert_array_equal(getattr(many.fixes, name), getattr(alone.fixes, name))
        assert k != 1 or len(many.fixes.rejected)
        # the mounting of the odometer contradicts the fixes: corrections of many standard deviations
        assert relative(many, ekf.run(*given[:3], cases.START_SIGMA, aids=given[3])) < 1e-11


def test_a_covariance_that_is_none_fails_in_every_lane_with_the_words_of_the_single_run(road):
    imus, gnsses, starts = flights(road, cases.MODEL_15, 2)
    ekf = LooselyCoupledEKF(cases.MODEL_15, cases.DT)
    P = ekf.initial_covariance(cases.START_SIGMA)
    P[1, 2] = P[2, 1] = 2.0 * P[1, 1]
    with pytest.raises(InputError, match="not positive semidefinite at the state 'pos_d'") as single:
        ekf.run(imus[0], gnsses[0], starts[0], P)
    assert [str(e) for e in ekf.run_many(imus, gnsses, starts, P)] == [str(single.value)] * 2


def test_a_latency_as_a_state_flies_by_itself(road):
    imus, gnsses, starts = flights(road, cases.MODEL_15, 2)
    ekf = LooselyCoupledEKF(cases.MODEL_15, cases.DT, options=FilterOptions(extras=Extras(latency=0.01)))
    for many, *given in zip(ekf.run_many(imus, gnsses, starts, cases.START_SIGMA), imus, gnsses, starts, strict=True):
        np.testing.assert_array_equal(many.nav, ekf.run(*given, cases.START_SIGMA).nav)


@njit
def _everything(a, b, table, out):
    x, y = a[0], b[0]
    held = 1.0
    for _ in range(2):
        held += 2 * x - y / 3.0
    values = (
        -x + 1,
        abs(y) * 0.5,
        lanes.where(x > y, x, 7.0),
        lanes.where(x <= 0.3, y, x),
        min(x, y) + max(x, 0.25),
        lanes.where(x != y, 1.0, 0.0) + lanes.where(y >= x, 1.0, 0.0) + lanes.where(x < 2.0, 1.0, 0.0),
        lanes.between(table, max(min(10.0 * abs(x), 9.0), 0.0)),
        held,
    )
    for k, v in enumerate(values):
        out[k] = v
    room = lanes.zeros(a, (2, 3))
    room[1, 2] += x
    out[8] = room[1, 2] + room[0, 0] + lanes.zeros(a, 4)[3]
    out[9] = 1.0 if lanes.any_of(x > 5.0) else 0.0
    out[10] = math.expm1(x) * math.log(abs(y))


def test_lanes_do_what_numbers_do():
    rng = np.random.default_rng(1)
    a, b = rng.standard_normal((2, lanes.LANES))
    b[3], a[5] = a[3], np.nan
    table = np.cumsum(rng.standard_normal(11))
    out = lanes.empty((11, lanes.LANES))
    assert out.ctypes.data % (8 * lanes.LANES) == 0
    _everything(lanes.stacked([[v] for v in a]), lanes.stacked([[v] for v in b]), table, lanes.lanes_of(out))
    for k in range(lanes.LANES):
        one = np.empty(11)
        _everything(a[k : k + 1], b[k : k + 1], table, one)
        if np.isnan(a[k]):
            one[6] = out[6, k]  # a place in a table that is none
        np.testing.assert_allclose(out[:, k], one, rtol=1e-15)
