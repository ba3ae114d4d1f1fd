"""Aids: every one against finite differences, against its perfect instrument, against the readable filter, and against chi-square bounds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from zlib import crc32

import numpy as np
import pytest

from insemu import rotation, scenario, strapdown
from insemu.errors import InputError
from insemu.evaluate.emulated import EmulatedWorld
from insemu.filters import AIDS, AidUse, FilterOptions, LooselyCoupledEKF, TrueMotion
from insemu.filters.aid import SETTINGS
from insemu.filters.aids import CODES, fill_rows
from insemu.filters.reference import reference_run
from insemu.filters.rows import Moment, Rows
from insemu.formats.recording import read_recording, write_recording
from insemu.yamlfile import Document
from tests import filter_cases as cases
from tests.budget import chi_square, chi_square_power, statistical
from tests.filter_cases import DT, MODEL_15, START_SIGMA
from tests.test_filters import BOUNDS, agreement, flown, random_state

EMULATED = sorted(name for name, aid in AIDS.items() if aid.truth is not None)
#: How good, and where mounted.
SIGMA = {
    "odometer": [0.1, 0.05, 0.05],
    "barometer": [0.3],
    "heading": [0.01],
    "nonholonomic": [0.05, 0.05],
    "magnetometer": [0.01],
    "dual_antenna": [0.02],
    "pose": [0.1] * 3 + [0.02] * 3,
}
MOUNTED = {
    "odometer": {"lever_arm": [1.5, -0.7, 1.2], "mounting": [0.02, -0.05, 0.1]},
    "barometer": {"lever_arm": [-1.0, 0.3, -2.0]},
    "heading": {"yaw": 0.4},
    "nonholonomic": {"lever_arm": [-1.5, 0.0, 0.5], "mounting": [0.01, 0.02, -0.03]},
    "magnetometer": {"declination": 0.05, "inclination": 1.1, "mounting": [0.1, -0.2, 2.0]},
    "dual_antenna": {"baseline": [1.0, 0.2, -0.1]},
    "pose": {"latitude": 0.79995, "longitude": 0.14995, "height": 290.0, "mounting": [0.02, 0.01, -1.5]},
}


def use(name: str, rate: float = 4.0) -> AidUse:
    sigma = SIGMA[name] if len(SIGMA[name]) > 1 else SIGMA[name] * len(AIDS[name].rows)
    return AidUse.from_mapping(AIDS[name], {"rate": rate, "sigma": sigma, **MOUNTED[name]})


def filled(name, nav, rate, *, settings=(), before=None, tau=0.0, z=None, count=1):
    """Innovation and Jacobian of an aid with the axes' rates among 12 states, and its noise for white noise of 1 on every axis."""
    w = len(AIDS[name].rows)
    at = np.zeros(SETTINGS)
    at[: len(settings)] = settings
    nu, H, R = np.empty(w), np.empty((w, 12)), np.empty((w, w))
    before = nav if before is None else before
    z = np.zeros(w) if z is None else z.copy()
    moment = Moment(
        nav, before, DT, tau, rate, rate, rate.copy(), count, np.ones(6), np.ones(3), np.arange(3), np.zeros(3), -1, -1, np.zeros(2), -1,
        np.zeros(12),
    )  # fmt: skip
    fill_rows(CODES[name], moment, z, at, Rows(nu, H, R))
    return nu, H, R


@pytest.mark.parametrize("name", sorted(AIDS))
def test_the_jacobian_of_an_aid_is_its_derivative(name):
    rng = np.random.default_rng(9)
    step = np.array([1e-2] * 3 + [1e-3] * 3 + [1e-5] * 3 + [1e-5] * 3)
    for _ in range(60):
        nav, rate = random_state(rng), rng.standard_normal(3) * 1e-2
        C = rotation.dcm_from_quaternion(nav[6:10])
        settings = use(name).settings if name in SIGMA else ()
        seen = C @ rotation.dcm_from_rpy(settings[3:6]).T if name == "pose" else C
        if name in ("heading", "pose") and np.hypot(seen[0, 0], seen[1, 0]) < 0.2:
            continue  # pointing up, it has none

        def innovation(error, nav=nav, rate=rate, settings=settings):
            moved = nav.copy()
            strapdown.correct(moved, -error[:9])
            return filled(name, moved, rate - error[9:], settings=settings)[0]

        numeric = np.stack(
            [(innovation(-d) - innovation(d)) / (2 * s) for s, d in zip(step, np.diag(step), strict=True)], axis=1
        )
        _, H, R = filled(name, nav, rate, settings=settings)
        # left out: the Earth's rate times the lever arm; of a standstill it is what is measured
        np.testing.assert_allclose(numeric, H, atol=3e-4 if name in ("odometer", "nonholonomic") else 1e-6)
        np.testing.assert_allclose(R, H[:, 9:] @ H[:, 9:].T, atol=1e-12)


@pytest.mark.parametrize("name", EMULATED)
@pytest.mark.parametrize("late", [0.0, 0.4])
def test_a_perfect_instrument_on_the_truth_leaves_nothing(name, late):
    road, it = cases.drive(20.0), use(name)
    at = np.arange(200, 2000, 50)
    rates = road.imu.gyro[1:] / DT
    for k in at:
        a, b = np.pad(road.nav[k - 1 : k + 1], ((0, 0), (0, 3)))
        now = a + (1.0 - late) * (b - a)  # of 10 ms: its own interpolation is good to micrometres
        C = rotation.dcm_from_quaternion(now[None, 6:10] / np.linalg.norm(now[6:10]))
        omega = rates[k - 1] - C[0].T @ strapdown.earth.earth_rate(now[0])
        motion = TrueMotion(now[None, :3], now[None, 3:6], C, omega[None])
        z = it.aid.truth(motion, np.pad(it.settings, (0, SETTINGS - len(it.settings))))[0]
        nu, _, _ = filled(name, b, rates[k - 1], settings=it.settings, before=a, tau=late * DT, z=z)
        # of a late port the turn of its arm over the 4 ms is left out
        np.testing.assert_allclose(nu, 0.0, atol=5e-4 if late and name == "barometer" else 2e-5)


def motion_of(road, t):
    k = np.round(t / DT).astype(int)
    C = rotation.dcm_from_quaternion(road.nav[k, 6:10])
    spin = np.array([c.T @ strapdown.earth.earth_rate(lat) for c, lat in zip(C, road.nav[k, 0], strict=True)])
    return TrueMotion(road.nav[k, :3], road.nav[k, 3:6], C, road.imu.gyro[k] / DT - spin)


def record(road, name, seed):
    it = use(name)
    t = it.times(road.t)
    as_instrument = replace(it, aid=replace(it.aid, constraint=False))  # the drive of these tests goes sideways
    return as_instrument.record(t, motion_of(road, t), np.random.default_rng([seed, crc32(name.encode())]))


def test_every_aid_is_the_same_in_the_reference_filter():
    road = cases.drive(30.0)
    imu, gnss, start = flown(road, MODEL_15)
    extra = [record(road, name, 1) for name in EMULATED]
    late = replace(extra[0], t=extra[0].t - 0.3 * DT)
    ekf = LooselyCoupledEKF(MODEL_15, DT, options=FilterOptions(covariance_at=(5.0, 20.0)))
    a = ekf.run(imu, gnss, start, START_SIGMA, aids=(late, *extra[1:]))
    b = reference_run(ekf, imu, gnss, start, START_SIGMA, aids=(late, *extra[1:]))
    assert (np.array(agreement(a, b)) < BOUNDS).all()
    assert {CODES[name] for name in EMULATED} == set(np.unique(a.fixes.kind)) - {0}


@cache
def short_drive():
    return cases.drive(40.0)


@cache
def short_flight(seed):
    return flown(short_drive(), MODEL_15, seed=seed)


@pytest.mark.parametrize("name", EMULATED)
@statistical(5e-6, 3, power=chi_square_power(360, 5e-6, 3, 2.0))  # half the errors that happen believed
def test_a_filter_with_an_aid_knows_its_error_and_errs_less(name):
    """Mean NEES at the end of an outage inside the chi-square bounds; an aid trusted three times too much: outside."""
    road, runs, at = short_drive(), 40, (15.0, 21.9, 40.0)
    bounds = 9 * np.array(chi_square(9 * runs, 5e-6, len(at)))
    ekf = LooselyCoupledEKF(MODEL_15, DT, options=FilterOptions(covariance_at=at, output_every=10))
    rows = np.round(np.array(at) / DT).astype(int)

    def pooled(trust=1.0, *, aided=True):
        out, size = np.empty((runs, len(at))), np.empty((runs, 9))
        for i in range(runs):
            imu, gnss, start = short_flight(100 + i)
            aid = record(road, name, 100 + i)
            r = ekf.run(imu, gnss, start, START_SIGMA, aids=(replace(aid, std=aid.std / trust),) if aided else ())
            pick = np.searchsorted(r.t, np.array(at) - 1e-9)
            e = strapdown.navigation_errors(r.nav[pick], road.nav[rows])
            out[i] = np.einsum("ki,kij,kj->k", e, np.linalg.inv(r.covariance[:, :9, :9]), e)
            size[i] = e[1]
        return out.mean(axis=0), np.sqrt(np.mean(size**2, axis=0))

    nees, with_aid = pooled()
    assert ((bounds[0] < nees) & (nees < bounds[1])).all(), (bounds, nees)
    assert pooled(3.0)[0].max() > bounds[1]
    without = pooled(aided=False)[1]
    least = {"odometer": slice(0, 2), "nonholonomic": slice(0, 2), "barometer": slice(2, 3), "pose": slice(0, 9)}.get(
        name, slice(8, 9)
    )
    assert np.linalg.norm(with_aid[least]) < 0.8 * np.linalg.norm(without[least])


FLIGHT = {
    "title": "t", "trajectory": {"builtin": "lemniscate", "duration": "60 s", "rate": "50 Hz"},
    "truth": {"gyro": "WN(N=1e-4)", "accel": "WN(N=1e-3)"},
    "aids": {"odometer": {"rate": "5 Hz", "sigma": ["0.05 m/s", "0.1 m/s", "0.1 m/s"], "mounting": ["0 deg", "1 deg", 0.0]},
             "barometer": {"sigma": "50 cm"}},
}  # fmt: skip


def validated(plain):
    return scenario.validated(scenario.Scenario, Document("flight.yaml", plain, {}))


@statistical(
    2e-5, 2, power=chi_square_power(240, 2e-5, 2, 2.0)
)  # a barometer of 2 min at 2 Hz, noise 1.4 times too large
def test_a_scenario_emulates_aids_and_a_file_keeps_them(tmp_path):
    made = EmulatedWorld(validated(FLIGHT))
    seen, again, other = made.recording(0), made.recording(0), made.recording(1)
    assert [a.kind for a in seen.aids] == ["odometer", "barometer"]
    np.testing.assert_allclose(seen.aids[0].settings, [0, 0, 0, 0, np.deg2rad(1.0), 0])
    np.testing.assert_array_equal(seen.aids[1].values, again.aids[1].values)
    assert np.abs(seen.aids[1].values - other.aids[1].values).max() > 0.1
    perfect = made.recording(0, ideal=True).aids
    for a, b in zip(seen.aids, perfect, strict=True):
        z = ((a.values - b.values) / a.std).ravel()
        low, high = chi_square(z.size, 2e-5, 2)
        assert low < z @ z / z.size < high
    for path in (tmp_path / "flight.npz", tmp_path / "folder"):
        write_recording(path, seen)
        back = {a.kind: a for a in read_recording(path).aids}
        for a in seen.aids:
            for part in ("t", "values", "std", "settings"):
                np.testing.assert_array_equal(getattr(a, part), getattr(back[a.kind], part))


def test_an_aid_has_outages_and_a_constraint_is_zero_whatever_the_vehicle_does():
    aids = {
        "nonholonomic": {
            "rate": "2 Hz",
            "sigma": 0.1,
            "lever_arm": ["1 m", 0, 0],
            "outages": [["10 s", "5 s"], [30, 2.5]],
        },
        "pose": {"sigma": ["1 m", "1 m", "1 m", "1 deg", "1 deg", "1 deg"], "latitude": "46 deg", "longitude": "7 deg"},
    }
    made = EmulatedWorld(validated({**FLIGHT, "aids": aids}))
    constraint, pose = made.recording(0).aids
    assert (constraint.values == 0.0).all() and np.ptp(pose.values[:, 0]) > 1.0
    missing = np.setdiff1d(np.round(np.arange(1, 120) * 0.5, 6), np.round(constraint.t, 6))
    np.testing.assert_allclose(missing, [*np.arange(10.5, 15.1, 0.5), *np.arange(30.5, 32.6, 0.5)])
    again = [AidUse.from_mapping(u.aid, u.to_mapping()) for u in validated({**FLIGHT, "aids": aids}).aids]
    assert tuple(again) == validated({**FLIGHT, "aids": aids}).aids and again[0].outages == ((10.0, 5.0), (30.0, 2.5))


@pytest.mark.parametrize(
    ("aids", "words"),
    [
        ({"odometr": {"sigma": 1}}, "no aid 'odometr' to emulate"),
        ({"odometer": {"sigma": [1, 2]}}, "expected one value or 3"),
        ({"barometer": {"rate": 1}}, "'sigma' is missing"),
        ({"barometer": {"sigma": 0}}, "expected a positive rate"),
        ({"barometer": {"sigma": 1, "lever": [0, 0, 0]}}, "unknown key 'lever'"),
        ({"barometer": {"sigma": "1 deg"}}, "deg"),
        ({"barometer": {"sigma": 1, "outages": "10 s"}}, "expected a list of pairs of start and duration"),
        ({"barometer": {"sigma": 1, "outages": [[10, -5]]}}, "durations that are not negative"),
        ({"barometer": {"sigma": 1, "outages": [10, 20]}}, "expected a list of pairs of start and duration"),
        ({"standstill": {"sigma": 1}}, "no aid 'standstill' to emulate"),
        (["odometer"], "expected the name of an aid"),
    ],
)
def test_a_wrong_aid_is_named(aids, words):
    with pytest.raises(InputError, match=words):
        validated({**FLIGHT, "aids": aids})


def test_an_effect_of_an_aid_that_a_flight_does_not_have_is_refused():
    truth = {**FLIGHT["truth"], "effects": [{"effect": "heading_offset", "value": "1 deg"}]}
    with pytest.raises(InputError, match="acts on the heading, which this flight does not have"):
        validated({**FLIGHT, "truth": truth})
