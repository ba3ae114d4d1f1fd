"""Raw GNSS observations: the receiver's clock, the rows of a satellite, masks, the fix, and the filter that takes them one by one."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from insemu import earth, rotation, strapdown
from insemu.augment import Extras
from insemu.emulate import (
    CONSTELLATIONS,
    AreaOutage,
    Multipath,
    Outage,
    Receiver,
    Sky,
    observed,
    seen,
    single_point,
    sky_over,
)
from insemu.errors import InputError
from insemu.evaluate import Experiment, outage_rows, run_experiment
from insemu.evaluate.consistency import nees
from insemu.filters import FilterOptions, InitialSigma, LooselyCoupledEKF
from insemu.filters.aids import SATELLITE, fill_rows
from insemu.filters.reference import reference_run
from insemu.filters.rows import Moment, Rows
from insemu.filters.unscented import UnscentedKalmanFilter
from insemu.noise import Clock
from insemu.scenario import load
from tests import filter_cases as cases
from tests.budget import chi_square, chi_square_power, statistical
from tests.filter_cases import DT, MODEL_15, START_SIGMA
from tests.test_filters import LEVER, random_state
from tests.test_filters_lanes import relative
from tests.test_filters_matched import halved
from tests.test_scenario_sections import read

#: Azimuth and elevation of satellites, deg: of the first four and of all eight a fix can be made.
ABOVE = np.deg2rad([[20, 75], [100, 40], [220, 30], [330, 20], [60, 15], [150, 60], [280, 50], [10, 35]])
CLOCK = Clock(bias=100.0, drift=10.0)
RANGE, RATE = 1.0, 0.05


def sky_of(t, llh, vel, above=ABOVE):
    """Satellites that fly by in straight lines, 3 km/s in Earth axes, at 22,000 km from where an antenna begins."""
    az, el = above.T
    frame = earth.dcm_en(*llh[0, :2])
    toward = np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), -np.sin(el)], axis=1) @ frame.T
    along = 3e3 * np.cross(toward, [0.3, -0.5, 0.8])
    place = earth.llh_to_ecef(llh[0]) + 2.2e7 * toward + t[:, None, None] * along
    away = place - earth.llh_to_ecef(llh)[:, None]
    distance = np.linalg.norm(away, axis=2)
    own = np.einsum("nij,nj->ni", earth.dcm_en(llh[:, 0], llh[:, 1]), vel)
    velocity = np.broadcast_to(along, place.shape)
    rate = np.einsum("nsi,nsi->ns", away / distance[:, :, None], velocity - own[:, None])
    ned = np.einsum("nji,nsj->nsi", earth.dcm_en(llh[:, 0], llh[:, 1]), away / distance[:, :, None])
    names = tuple(f"G{k:02d}" for k in range(1, len(above) + 1))
    azimuth = np.arctan2(ned[:, :, 1], ned[:, :, 0])
    return Sky(t, names, place, velocity, distance, rate, np.arcsin(-ned[:, :, 2]), azimuth)


def raw_of(road, rng, *, outages=(), lever_arm=(0.0, 0.0, 0.0), multipath=None, above=ABOVE):
    """Raw observations of a drive every second, and the true bias and drift (n, 2)."""
    true = cases.fixes(road, rng, sigma=(0.0, 0.0), lever_arm=lever_arm)
    sky = sky_of(true.t, true.llh, true.vel_ned, above)
    state = rng.bit_generator.state
    receiver = Receiver(range_sigma=RANGE, rate_sigma=RATE, clock=CLOCK, multipath=multipath)
    raw = observed(sky, seen(sky, true.llh, 0.0, outages), receiver, rng)
    assert state == rng.bit_generator.state  # only children drew
    return raw, sky


# -- the clock --------------------------------------------------------------------------------------------------------------------


def test_two_steps_of_a_clock_are_one():
    one, two, both = (Clock().block(dt) for dt in (0.3, 0.7, 1.0))
    np.testing.assert_allclose(two.Phi @ one.Phi, both.Phi, rtol=1e-15)
    np.testing.assert_allclose(two.Phi @ one.Q @ two.Phi.T + two.Q, both.Q, rtol=1e-14)


@statistical(1e-6, 3, power=chi_square_power(6000, 1e-6, 3, 1.3))
def test_a_simulated_clock_moves_as_its_block_says():
    """Increments of bias and drift over steps of two lengths, whitened by the block's covariance; one of them 30 % larger is seen."""
    t = np.concatenate([[0.0], np.cumsum(np.tile([0.5, 1.5], 3000))])
    bias, drift = CLOCK.simulate(t, np.random.default_rng(4))
    x = np.stack([bias, drift], axis=1)
    for first, dt in ((0, 0.5), (1, 1.5)):
        block = CLOCK.block(dt)
        w = (x[1:] - x[:-1] @ block.Phi.T)[first::2]
        white = np.linalg.solve(np.linalg.cholesky(block.Q), w.T)
        low, high = chi_square(2 * len(w), 1e-6, 3)
        assert low <= np.mean(white**2) <= high
    starts = np.array([CLOCK.simulate(t[:1], np.random.default_rng(k)) for k in range(3000)])[:, :, 0]
    low, high = chi_square(starts.size, 1e-6, 3)
    assert low <= np.mean((starts / [CLOCK.bias, CLOCK.drift]) ** 2) <= high


# -- rows -------------------------------------------------------------------------------------------------------------------------


def rows_at(nav, x, lever, place, velocity, z, tau=0.0):
    """Innovation and Jacobian of a satellite with three states of the gyroscopes and the clock ``x``."""
    rate = np.array([0.3, -0.2, 0.5]) - x[:3]
    moment = Moment(
        nav, nav, DT, tau, rate, rate, rate, 1, np.zeros(6), np.array([1.0, 1.0, 1.0, 0.0, 0.0]), np.array([0, 1, 2, -1, -1]), lever, -1, -1,
        x[3:].copy(), 12, np.zeros(12),
    )  # fmt: skip
    rows = Rows(np.empty(2), np.empty((2, 14)), np.empty((2, 2)))
    fill_rows(SATELLITE, moment, z, np.concatenate([place, velocity]), rows)
    return rows.nu, rows.H


def test_rows_of_a_satellite_are_the_geometry_and_their_jacobian_its_derivative():
    """Against positions in Earth axes by another formula; derivatives by central differences."""
    rng = np.random.default_rng(2)
    step = np.array([1.0] * 3 + [1e-2] * 3 + [1e-5] * 3 + [1e-5] * 3 + [1.0, 1e-2])
    for _ in range(100):
        nav, lever, x = random_state(rng), rng.standard_normal(3), rng.standard_normal(5) * [0.1, 0.1, 0.1, 50.0, 5.0]
        frame, C = earth.dcm_en(*nav[:2]), rotation.dcm_from_quaternion(nav[6:10])
        omega = np.array([0.3, -0.2, 0.5]) - x[:3] - C.T @ earth.earth_rate(nav[0])
        antenna = earth.llh_to_ecef(nav[:3]) + frame @ C @ lever
        speed = frame @ (nav[3:6] + C @ np.cross(omega, lever))
        toward = frame @ rng.standard_normal(3)
        place, velocity = antenna + 2.2e7 * toward / np.linalg.norm(toward), 3e3 * rng.standard_normal(3)
        sight = (place - antenna) / np.linalg.norm(place - antenna)
        z = np.array([np.linalg.norm(place - antenna) + x[3], sight @ (velocity - speed) + x[4]])
        nu, H = rows_at(nav, x, lever, place, velocity, z)
        # a distance has an eps of 4e-9 m, and is a root of sums of such; a place a digit of 2e-9 m
        assert abs(nu[0]) < 1e-7 and abs(nu[1]) < 1e-9

        def predicted(error, nav=nav, x=x, lever=lever, place=place, velocity=velocity):
            moved = nav.copy()
            strapdown.correct(moved, -error[:9])
            return -rows_at(moved, x + error[9:], lever, place, velocity, np.zeros(2))[0]

        numeric = np.stack(
            [(predicted(s * e) - predicted(-s * e)) / (2 * s) for s, e in zip(step, np.eye(14), strict=True)], axis=1
        )
        # rounding over the step; no row of a fix has that north and east, the arm and the velocity turn with a place that moves (a metre of
        # 6,400 km, times the tangent of the latitude), nor that the Earth's rate turns with the attitude
        turning = 5.0 * np.append(np.full(3, (1.0 + abs(np.tan(nav[0]))) / 6.3e6), np.full(11, 1e-7))
        np.testing.assert_array_less(np.abs(numeric - H)[0], 1e-7 / step + turning)
        turning = 5.0 * np.append(
            np.full(3, np.linalg.norm(nav[3:6]) * (1.0 + abs(np.tan(nav[0]))) / 6.3e6), np.full(11, 1e-4)
        )
        np.testing.assert_array_less(np.abs(numeric - H)[1], 1e-9 / step + turning + 1e-9)
        # half a millisecond ago the clock stood where its drift says
        np.testing.assert_allclose(rows_at(nav, x, lever, place, velocity, z, tau=5e-4)[1][0, 12:], [1.0, -5e-4])


def test_one_epoch_after_an_open_start_is_the_least_squares():
    """Satellites used one after the other from a start that is as good as unknown give the fix of all at once, and its deviations."""
    road, rng = cases.drive(1.5), np.random.default_rng(6)
    raw, _ = raw_of(road, rng)
    fix, _ = single_point(raw)
    extras = Extras(clock=Clock(bias=1e5, drift=1e3))
    ekf = LooselyCoupledEKF(MODEL_15, DT, options=FilterOptions(extras=extras, covariance_at=(1.0,)))
    run = ekf.run(road.imu, raw, _state(road), InitialSigma(1e4, 1e3, 1e-6))
    at = int(np.searchsorted(run.t, 1.0 - 1e-9))
    # rates say something of the place, 250 m well, and the start 10 km: together less than 1e-4 of the deviations squared
    off = earth.position_difference(run.nav[at, :3], fix.llh[0]) / fix.pos_std_ned[0]
    assert np.abs(off).max() < 1e-3
    assert np.abs((run.nav[at, 3:6] - fix.vel_ned[0]) / fix.vel_std_ned[0]).max() < 1e-2
    np.testing.assert_allclose(np.sqrt(np.diag(run.covariance[0])[:3]), fix.pos_std_ned[0], rtol=1e-3)
    np.testing.assert_allclose(np.sqrt(np.diag(run.covariance[0])[3:6]), fix.vel_std_ned[0], rtol=1e-2)


def _state(road):
    nav = road.nav[0]
    return strapdown.NavState(nav[:3], nav[3:6], rotation.rpy_from_quaternion(nav[6:10]))


# -- the filter -------------------------------------------------------------------------------------------------------------------


def tight(model=MODEL_15, clock=CLOCK, kind=LooselyCoupledEKF, **options):
    return kind(model, DT, lever_arm=LEVER, options=FilterOptions(extras=Extras(clock=clock), **options))


def flights(road, count, outages=()):
    made = []
    for k in range(count):
        rng = np.random.default_rng(700 + k)
        raw = raw_of(road, rng, outages=outages, lever_arm=LEVER)[0]
        made.append((cases.corrupt(road.imu, MODEL_15, rng), raw, cases.start(road, rng)))
    return [list(part) for part in zip(*made, strict=True)]


@pytest.mark.parametrize(
    "options", [{}, {"covariance_every": 5, "gate": 1e-3, "store": "fixes"}], ids=["plain", "rare"]
)
def test_raw_observations_fly_in_lanes(options):
    """The numbers of the single run: a range of 22,000 km is rounded to 4 nm, sums of its squares to a few of these, and the noise is a metre."""
    road = cases.drive(20.0)
    imus, raws, starts = flights(road, 3, (Outage(5.0, 6.0, satellites=2),))
    raws = [replace(r, t=r.t - 0.0037) for r in raws]
    ekf = tight(output_every=5, covariance_at=(3.0, 11.5), **options)
    for many, *given in zip(ekf.run_many(imus, raws, starts, START_SIGMA), imus, raws, starts, strict=True):
        assert isinstance(many.layout.index("clock_drift"), int) and set(many.fixes.kind) == {SATELLITE}
        assert relative(many, ekf.run(*given, START_SIGMA)) < 1e-7


def test_the_reference_and_the_unscented_filter_take_the_same_rows():
    """The filter in dense matrices to rounding; sigma points to what the curvature of attitude and arm is worth."""
    road = cases.drive(12.0)
    (imu,), (raw,), (start,) = flights(road, 1, (Outage(5.0, 4.0, satellites=1),))
    ekf = tight(covariance_at=(12.0,))
    run = ekf.run(imu, raw, start, START_SIGMA)
    for other, bound in (
        (reference_run(ekf, imu, raw, start, START_SIGMA), 1e-6),
        (tight(kind=UnscentedKalmanFilter, covariance_at=(12.0,)).run(imu, raw, start, START_SIGMA), 0.05),
    ):
        apart = np.append(
            strapdown.navigation_errors(run.nav[-1:], other.nav[-1:])[0], run.imu_states[-1] - other.imu_states[-1]
        )
        assert np.abs(apart / run.sigma[-1]).max() < bound
        np.testing.assert_allclose(other.sigma[-1], run.sigma[-1], rtol=bound)


@pytest.mark.parametrize("left", [1, 2, 3])
@statistical(1.5e-6, 2, power=chi_square_power(11 * 40, 1.5e-6, 2, 1.6))
def test_a_tight_filter_knows_its_error_with_few_satellites(left):
    """NEES of navigation and clock within chi-square bounds at the end of twenty seconds with few satellites; half the noise believed: outside."""
    road, runs = cases.drive(30.0), 40
    outage = Outage(9.5, 20.0, satellites=left)
    low, high = chi_square(11 * runs, 1.5e-6, 2)

    def mean_nees(model, clock, trust):
        sums = 0.0
        ekf = tight(model, clock, covariance_at=(29.0,), output_every=10)
        for first in range(0, runs, 8):
            made = []
            for k in range(first, first + 8):
                rng = np.random.default_rng([left, k])
                raw = raw_of(road, rng, outages=(outage,), lever_arm=LEVER)[0]
                raw = replace(raw, range_std=trust * raw.range_std, rate_std=trust * raw.rate_std)
                made.append(
                    (
                        cases.corrupt(road.imu, MODEL_15, rng),
                        raw,
                        cases.start(road, rng),
                        np.random.default_rng([left, k]),
                    )
                )
            imus, raws, starts, again = (list(part) for part in zip(*made, strict=True))
            flown = ekf.run_many(imus, raws, starts, START_SIGMA)
            for run, raw, rng in zip(flown, raws, again, strict=True):
                at, own = int(np.searchsorted(run.t, 29.0 - 1e-9)), run.layout["clock"]
                cases.fixes(road, rng, sigma=(0.0, 0.0), lever_arm=LEVER)
                bias, drift = CLOCK.simulate(raw.t, rng.spawn(4)[0])
                k = int(np.searchsorted(raw.t, 29.0 - 1e-9))
                clock_error = run.imu_states[at, own.start - 9 : own.stop - 9] - [bias[k], drift[k]]
                moved = strapdown.navigation_errors(run.nav[at : at + 1], road.nav[2900:2901])[0]
                rows = np.r_[0:9, own]
                sums += nees(np.append(moved, clock_error)[None], run.covariance[:1][:, rows[:, None], rows])[0]
        return sums / (11 * runs)

    assert low <= mean_nees(MODEL_15, CLOCK, 1.0) <= high
    small = Clock(CLOCK.bias, CLOCK.drift, CLOCK.white / 2, CLOCK.walk / 2)
    assert mean_nees(halved(MODEL_15), small, 0.5) > high


def test_tight_is_as_good_as_loose_with_eight_satellites():
    """Stated horizontal and vertical deviations within 5 %: what is left is the clock between epochs and the correlations of a fix."""
    road = cases.drive(30.0)
    (imu,), (raw,), (start,) = flights(road, 1)
    loose = LooselyCoupledEKF(MODEL_15, DT, lever_arm=LEVER, options=FilterOptions(covariance_at=(30.0,)))
    P, Q = (
        ekf.run(imu, gnss, start, START_SIGMA).covariance[0]
        for ekf, gnss in ((loose, single_point(raw)[0]), (tight(covariance_at=(30.0,)), raw))
    )
    assert np.isfinite(raw.range).sum(axis=1).min() == 8
    assert abs(np.sqrt((Q[0, 0] + Q[1, 1]) / (P[0, 0] + P[1, 1])) - 1.0) < 0.05
    assert abs(np.sqrt(Q[2, 2] / P[2, 2]) - 1.0) < 0.05


def test_raw_observations_without_a_clock_are_refused():
    road = cases.drive(3.0)
    raw, _ = raw_of(road, np.random.default_rng(1))
    for extras in (Extras(), Extras(clock=CLOCK, lever_arm=0.1)):
        ekf = LooselyCoupledEKF(MODEL_15, DT, options=FilterOptions(extras=extras))
        with pytest.raises(InputError, match="raw observations need the states of the clock"):
            ekf.run(road.imu, raw, _state(road), START_SIGMA)


# -- masks, errors and the fix ----------------------------------------------------------------------------------------------------


def standing(t, above=ABOVE):
    llh = np.tile([0.8, 0.15, 300.0], (t.size, 1))
    return sky_of(t, llh, np.zeros((t.size, 3)), above), llh


def test_masks_leave_what_they_say():
    sky, llh = standing(np.arange(1.0, 31.0))
    deg = np.deg2rad
    whole = seen(sky, llh, deg(18.0), ())
    assert whole[:, [0, 1, 2, 3, 5, 6, 7]].all() and not whole[:, 4].any()
    few = seen(sky, llh, deg(18.0), [Outage(10.0, 5.0, satellites=3)])
    assert (
        set(np.flatnonzero(few[12])) == {0, 5, 6}
        and (few[10:15] == few[12]).all()
        and few[9].sum() == few[15].sum() == 7
    )
    assert not seen(sky, llh, 0.0, [Outage(10.0, 5.0)])[10:15].any()
    assert not seen(sky, llh, 0.0, [AreaOutage(0.8, 0.15, 10.0)]).any()
    low = seen(sky, llh, 0.0, [Outage(10.0, 5.0, elevation=deg(38.0))])
    assert set(np.flatnonzero(low[12])) == {0, 1, 5, 6}
    # from 320 deg over north to 120 deg houses, elsewhere none
    street = seen(sky, llh, 0.0, [Outage(10.0, 5.0, sectors=((deg(320.0), deg(120.0), deg(37.0)),))])
    assert set(np.flatnonzero(street[12])) == {0, 1, 2, 5, 6}
    with pytest.raises(InputError, match="leaves -1 satellites"):
        Outage(0.0, 1.0, satellites=-1)


def test_a_mask_changes_no_other_observation_and_perfect_ones_are_the_geometry():
    sky, llh = standing(np.arange(1.0, 31.0))
    receiver = Receiver(multipath=Multipath(2.0, 20.0))
    some = seen(sky, llh, 0.0, [Outage(10.0, 5.0, satellites=3)])
    all_of_them, masked = (
        observed(sky, mask, receiver, np.random.default_rng(3)) for mask in (np.ones_like(some), some)
    )
    np.testing.assert_array_equal(masked.range, np.where(some, all_of_them.range, np.nan))
    np.testing.assert_array_equal(masked.rate, np.where(some, all_of_them.rate, np.nan))
    perfect = observed(sky, np.ones_like(some), receiver, np.random.default_rng(3), ideal=True)
    np.testing.assert_array_equal(perfect.range, sky.range)
    np.testing.assert_allclose(perfect.range_std * np.sin(sky.elevation), np.hypot(1.0, 2.0), rtol=1e-12)


@statistical(1e-6, 3, power=chi_square_power(16_000, 1e-6, 3, 1.2))
def test_noise_goes_with_the_elevation_and_multipath_is_a_gauss_markov_process():
    """Ranges less the clock, which the mean rate of all satellites does not tell: by a receiver whose clock stands; 20 % more variance is seen."""
    sky, _ = standing(np.arange(1.0, 2001.0))
    still = Clock(0.0, 0.0, 0.0, 0.0)
    everything, scale = np.ones(sky.range.shape, dtype=bool), np.sin(sky.elevation)
    plain, reflected = (
        observed(
            sky,
            everything,
            Receiver(range_sigma=3.0, rate_sigma=0.2, clock=still, multipath=path),
            np.random.default_rng(8),
        )
        for path in (None, Multipath(2.0, 20.0))
    )
    low, high = chi_square(everything.size, 1e-6, 3)
    assert low <= np.mean(((plain.range - sky.range) * scale / 3.0) ** 2) <= high
    assert low <= np.mean(((plain.rate - sky.rate) * scale / 0.2) ** 2) <= high
    y, keep = (reflected.range - plain.range) * scale / 2.0, np.exp(-1.0 / 20.0)
    driven = (y[1:] - keep * y[:-1]) / np.sqrt(1.0 - keep**2)
    low, high = chi_square(driven.size, 1e-6, 3)
    assert low <= np.mean(driven**2) <= high


def test_dilutions_of_a_known_geometry_and_a_fix_of_four():
    """One satellite at the zenith and three on the horizon: variances 2/3, 2/3, 4/3 and 1/3; four ranges are met exactly."""
    above = np.deg2rad([[0.0, 90.0], [0.0, 0.0], [120.0, 0.0], [240.0, 0.0]])
    sky, llh = standing(np.array([0.0, 1e-3]), above)
    raw = observed(sky, np.ones((2, 4), dtype=bool), Receiver(), np.random.default_rng(5))
    fix, dilution = single_point(raw)
    # noise of 12 m in 22,000 km and a millisecond of flight turn the lines of sight by 1e-6
    np.testing.assert_allclose(dilution[0] ** 2, [2 / 3, 2 / 3, 4 / 3, 1 / 3], rtol=1e-5)
    left = raw.range - np.linalg.norm(raw.place - earth.llh_to_ecef(fix.llh)[:, None], axis=2)
    assert np.ptp(left, axis=1).max() < 1e-6  # all that is left is the clock, to rounding of 22,000 km
    same = observed(sky, np.ones((2, 4), dtype=bool), Receiver(), np.random.default_rng(5), ideal=True)
    fix, _ = single_point(same)
    assert np.abs(earth.position_difference(fix.llh, llh)).max() < 1e-6 and np.abs(fix.vel_ned).max() < 1e-9
    few = replace(raw, range=np.where(np.arange(4) < 3, raw.range, np.nan))
    with pytest.raises(InputError, match="no epoch has a fix"):
        single_point(few)


# -- orbits -----------------------------------------------------------------------------------------------------------------------


def route(seconds=600.0):
    t = np.arange(1.0, seconds, 60.0)
    vel = np.tile([20.0, -10.0, 1.0], (t.size, 1))
    return t, earth.move(np.array([0.787, 0.133, 250.0]), t[:, None] * vel), vel


def test_places_and_fixes_are_those_of_the_library():
    """Satellites, ranges and elevations, and fixes of four with noise, to a millimetre."""
    sidereon = pytest.importorskip("sidereon")
    file = CONSTELLATIONS["gps"]
    t, llh, _ = route()
    sky = sky_over(file, t, llh, np.zeros_like(llh), 3600.0)
    orbits, begin = sidereon.parse_rinex_nav(file.read_text()), sidereon.j2000_seconds(1993, 7, 1, 1, 0, 0.0)
    assert len(sky.names) == 24 and (sky.elevation > np.deg2rad(10.0)).sum(axis=1).min() >= 5
    for k in range(t.size):
        place = earth.llh_to_ecef(llh[k])
        for s, name in enumerate(sky.names):
            known = sidereon.observe_broadcast(orbits, name, place, begin + t[k], 1.57542e9, True, True)
            assert abs(known.geometric_range_m - sky.range[k, s]) < 1e-3
            assert np.abs(known.sat_pos_ecef_m - sky.place[k, s]).max() < 1e-3
            # theirs leaves out that the travel time changes: rate times rate over the speed of light
            assert abs(known.range_rate_m_s - sky.rate[k, s]) < 1.1 * sky.rate[k, s] ** 2 / 3e8 + 1e-4 + 0.003
            assert abs(known.elevation_deg - np.rad2deg(sky.elevation[k, s])) < 1e-6
    best = np.argsort(-sky.elevation[0])[[0, 2, 3, 5]]
    visible = np.zeros(sky.range.shape, dtype=bool)
    visible[:, best] = True
    raw = observed(sky, visible, Receiver(clock=Clock(drift=0.0)), np.random.default_rng(2))
    fixes, _ = single_point(raw)
    assert len(fixes) == t.size
    for k in range(t.size):
        away = np.linalg.norm(raw.place[k, best] - earth.llh_to_ecef(fixes.llh[k]), axis=1)
        bias = float(np.mean(raw.range[k, best] - away)) / 299_792_458.0  # it stamps by the receiver's clock
        own = [sidereon.SppObservation(raw.names[s], raw.range[k, s]) for s in best]
        config = sidereon.SppConfig(
            own, begin + t[k] + bias, 3600.0 + t[k], 182.0, [*earth.llh_to_ecef(llh[k]), 0.0],
            corrections=sidereon.SppCorrections(ionosphere=False, troposphere=False),
        )  # fmt: skip
        theirs = sidereon.solve_broadcast(orbits, config).position
        assert np.abs(theirs - earth.llh_to_ecef(fixes.llh[k])).max() < 1e-3


def test_a_range_rate_is_the_derivative_of_the_range():
    pytest.importorskip("sidereon")
    t, llh, vel = route()
    before, here, after = (
        sky_over(CONSTELLATIONS["gps"], t + s, earth.move(llh, s * vel), vel, 0.0) for s in (-0.5, 0.0, 0.5)
    )
    # the third derivative of a range is below 1e-4 m/s^3; the antenna's straight line bends with the Earth
    np.testing.assert_allclose(after.range - before.range, here.rate, rtol=0, atol=2e-4)


def test_what_cannot_be_flown_is_said(tmp_path, monkeypatch):
    t, llh, vel = route()
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "sidereon", None)
        with pytest.raises(InputError, match="need the package sidereon: pip install 'insemu\\[gnss\\]'"):
            sky_over(CONSTELLATIONS["gps"], t, llh, vel, 0.0)
    pytest.importorskip("sidereon")
    with pytest.raises(InputError, match=r"no valid ephemeris of G01 .* within two hours of an ephemeris"):
        sky_over(CONSTELLATIONS["gps"], t, llh, vel, 11 * 3600.0)
    (tmp_path / "no.rnx").write_text("1,2,3\n")
    with pytest.raises(InputError, match=r"no RINEX navigation file|no ephemeris"):
        sky_over(tmp_path / "no.rnx", t, llh, vel, 0.0)


# -- scenarios --------------------------------------------------------------------------------------------------------------------


def test_scenarios_say_what_raw_observations_need():
    tight_design = {"designs.a.options": {"states": {"clock": {"walk": "0.1 m/s/sqrt(s)"}}}}
    for changes, said in (
        (
            {"gnss.outages": [{"start": "1 s", "duration": "2 s", "satellites": 3}]},
            "outage 1 says which .* the key 'raw'",
        ),
        (tight_design, "the design 'a' has states of the receiver's clock, expected the key 'gnss.raw'"),
        ({"gnss.raw": {"constellation": "gsp"}}, "no constellation 'gsp'"),
        ({"gnss.raw": {"clock": {"bias": "-1 m"}}}, "greater than or equal to 0"),
        (
            {"gnss.raw": {}, "truth.effects": [{"effect": "gnss_noise_level", "factor": 2.0}]},
            "acts on fixes, which gnss.raw makes",
        ),
    ):
        with pytest.raises(InputError, match=said):
            read(changes)
    read_back = read({**tight_design, "gnss.raw": {"multipath": {"sigma": "2 m", "Tc": "30 s"}, "mask": "15 deg"}})
    assert read_back.gnss.raw == Receiver(mask=float(np.deg2rad(15.0)), multipath=Multipath(2.0, 30.0))
    assert read_back.designs["a"].options.states.clock == Clock(walk=0.1)
    again = type(read_back.gnss).model_validate(read_back.gnss.model_dump(mode="json"))
    assert again.raw == read_back.gnss.raw


@pytest.mark.slow(reason="whole experiments")
@pytest.mark.parametrize("variant", [None, "two", "one", "street", "drive_2"])
def test_the_shipped_experiment_drifts_less_and_knows_it(variant):
    """With three satellites a third of the loose drift over a minute at most, and every design's NEES inside its bounds."""
    pytest.importorskip("sidereon")
    results = run_experiment(Experiment(load("tight_coupling", variant=variant), "tight_coupling"))
    rows = outage_rows(results)
    assert all(row["verdict"] == "consistent" for row in rows), [(r["design"], r["outage"], r["verdict"]) for r in rows]
    end = {(row["design"], row["outage"]): row["planimetric_end_m"] for row in rows}
    for k, (_, duration) in enumerate(results.outages, start=1):
        if variant in (None, "drive_2") and duration == 60.0:
            assert end["tight", k] < end["loose", k] / 3.0
        assert variant == "one" or end["tight", k] < end["loose", k]  # one satellite says little in town
