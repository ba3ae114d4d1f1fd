"""A recording is solved without a scenario: clock, lever arm, mounting, automatic outages, and what is written."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
import yaml
from scipy import stats

from insemu import earth, intake, noise, rotation
from insemu.cli import main
from insemu.errors import InputError
from insemu.evaluate.emulated import EmulatedWorld
from insemu.filters import smooth
from insemu.formats import read_recording
from insemu.formats import write as write_recording
from insemu.gap import Nominal, session
from insemu.intake import velocity_lag
from insemu.noise import WN, NoiseModel
from insemu.prepared import prepared
from insemu.records import GnssRecord, ImuRecord, Recording
from insemu.report.solve import solve_answer
from insemu.scenario import load
from insemu.solve import Solution, candidates, cut_everywhere, solve, summary, way_of_solution, write
from insemu.solve.against import _at_the_same, compare_with
from insemu.solve.beliefs import adapted, clock_offset, likelihood_of
from insemu.solve.outages import Outages, gaps_of
from insemu.solve.outliers_of_fixes import outlying
from insemu.solve.solution import Scored, Track, flown
from tests.shared_data import shared

LATE, ARM = 0.12, np.array([0.6, -0.3, -1.1])
MOUNTING = np.deg2rad([170.0, -6.0, 20.0])
WORLD: dict[str, Any] = {
    "title": "drive",
    "seed": 11,
    "trajectory": {"builtin": "urban_drive_1", "rate": "25 Hz", "duration": "300 s"},
    "truth": {
        "gyro": "WN(N=0.02 deg/s/sqrt(Hz)) + RC(sigma=0.05 deg/s)",
        "accel": "WN(N=400 ug/sqrt(Hz)) + RC(sigma=2 mg)",
    },
    "gnss": {"position_sigma": "10 cm", "velocity_sigma": "5 cm/s", "lever_arm": [f"{v} m" for v in ARM]},
}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """An IMU that is turned, whose stamps are late, with an antenna elsewhere; the fixes state half of their error."""
    path = tmp_path_factory.mktemp("world") / "world.yaml"
    path.write_text(yaml.safe_dump(WORLD))
    data = EmulatedWorld(load(path), path).recording(0)
    C, imu = rotation.dcm_from_rpy(MOUNTING), data.imu
    assert data.gnss is not None
    turned = replace(imu, t=imu.t + LATE, gyro=imu.gyro @ C, accel=imu.accel @ C)
    n = (len(data.gnss), 3)
    stated = replace(data.gnss, pos_std_ned=np.full(n, 0.05), vel_std_ned=np.full(n, 0.025))
    return Recording(turned, stated, data.reference, "emulated")


@pytest.fixture(scope="module")
def solution(recording: Recording) -> Solution:
    return solve(recording, intake.examine(recording), [c for c in candidates() if c.name == "industrial MEMS"])


def test_what_was_changed_is_found(solution: Solution) -> None:
    late, sigma = solution.clock
    assert abs(late - LATE) < 5 * sigma + 1e-3 and sigma < 0.01
    found = {name: (value, sd) for name, value, sd, _ in solution.estimated}
    in_imu_axes = rotation.dcm_from_rpy(MOUNTING).T @ ARM
    for axis, true in zip("xyz", in_imu_axes, strict=True):
        value, sd = found[f"lever_arm_{axis}"]
        assert abs(value - true) < 5 * sd + 0.02
    assert solution.mounting is not None
    off = rotation.vector_from_dcm(rotation.dcm_from_rpy(solution.mounting.rpy) @ rotation.dcm_from_rpy(MOUNTING).T)
    assert np.rad2deg(np.abs(off)).max() < 1.5
    # the receiver states half of its error
    assert 1.6 < solution.taken.candidate.position < 2.5
    assert 0.8 < solution.taken.nis < 1.2


def test_the_smoothed_way_is_the_true_one(solution: Solution, recording: Recording) -> None:
    assert recording.reference is not None
    s, ref = solution.smoothed, recording.reference
    at = np.stack([np.interp(s.t, ref.t, c) for c in ref.llh.T], axis=1)
    error = earth.position_difference(s.nav[:, :3], at)
    share = np.abs(error / s.sigma[:, :3]) < 3.0
    assert share.mean() > 0.9 and np.sqrt((error**2).mean()) < 0.15


def test_a_trajectory_at_another_rate_is_that_of_a_smoother_with_as_many_nodes(
    solution: Solution, tmp_path: Path
) -> None:
    drive, candidate = solution.drive, solution.taken.candidate
    track = Track.of(candidate, drive, 12.0)  # of 25 Hz every second epoch
    assert np.diff(track.t) == pytest.approx(0.08, abs=0.041) and np.median(np.diff(track.t)) == pytest.approx(0.08)
    dense = smooth(flown(candidate.filter(drive, store="fixes", node_every=0.04), drive, candidate))
    at = np.searchsorted(dense.t, track.t - 1e-9)
    np.testing.assert_allclose(dense.t[at], track.t, atol=1e-9)
    away = earth.position_difference(track.nav[:, :3], dense.nav[at, :3])
    turn = rotation.quaternion_product(track.nav[:, 6:10], rotation.quaternion_conjugate(dense.nav[at, 6:10]))
    off = np.hstack([away, track.nav[:, 3:6] - dense.nav[at, 3:6], rotation.vector_from_quaternion(turn)])
    off = np.abs(off) / track.sigma[:, :9]
    assert np.quantile(off, 0.99) < 0.15 and off.max() < 1.0
    # variances are convex between two fixes: a straight line states a little more
    ratio = track.sigma[:, :9] / dense.sigma[at, :9]
    assert 0.97 < ratio.min() and ratio.max() < 1.1
    write(replace(solution, track=track), tmp_path)
    way = way_of_solution(tmp_path)
    np.testing.assert_array_equal(way.t, track.t)
    np.testing.assert_array_equal(way.sigma, track.sigma[:, :3])
    with pytest.raises(InputError, match="rate: is 100 Hz, expected a rate up to the 25 Hz of the IMU"):
        Track.of(candidate, drive, 100.0)


def test_an_outage_is_what_a_filter_without_fixes_does(solution: Solution) -> None:
    """From the middle of the drive the filter is run again, the fixes withheld: the same error, the same covariance."""
    drive, taken = solution.drive, solution.taken
    o, c = taken.outages, taken.candidate
    imu, gnss = drive.flown(c.filter(drive))
    k = int(np.searchsorted(o.start, o.start[0] + 60.0))
    begin = float(o.start[k])
    kept = c.fixes(gnss.rows(gnss.t <= begin + 0.5))
    ekf = c.filter(drive, covariance_at=(begin + o.horizons[1],))
    run = ekf.run(imu, kept, drive.aligned.state, c.start_sigma(drive))
    j = int(np.argmin(np.abs(gnss.t - begin - o.horizons[1])))
    row = int(np.searchsorted(run.t, gnss.t[j] - 1e-9))
    arm = run.imu_states[row, run.layout["lever_arm"].start - 9 :][:3]
    swing = rotation.dcm_from_quaternion(run.nav[row, 6:10]) @ arm
    away = earth.position_difference(earth.move(run.nav[row, :3], swing), gnss.llh[j])[:2]
    moved = float(np.hypot(*run.nav[row, 3:5])) * imu.dt
    assert np.hypot(*(away - o.error[k, 1])) < moved + 0.02 * np.hypot(*away)
    assert np.sqrt(np.diag(o.covariance[k, 1])) == pytest.approx(run.sigma[row, :2], rel=0.03)
    scatter = drive.scattered().pos_std_ned
    assert scatter is not None and o.fix_variance[k, 1] == pytest.approx(scatter[j, :2] ** 2)
    # the fix that ends it is far from what was predicted, so an outage is no filter with fixes
    assert o.stated(1) > 5 * float(np.hypot(*taken.run.sigma[-1, :2]))


def test_spread_counts_outages_that_overlap_once() -> None:
    rng = np.random.default_rng(3)
    start, horizons = np.arange(1200.0), np.array([30.0])
    slow = np.repeat(rng.standard_normal((40, 2)), 30, axis=0)
    fast = rng.standard_normal((1200, 2))

    def width(e: np.ndarray) -> float:
        o = Outages(start, horizons, e[:, None], np.tile(np.eye(2), (1200, 1, 1, 1)), np.zeros((1200, 1, 2)))
        low, high = o.interval(0)
        assert low < o.rms(0) < high
        return high - low

    assert width(slow) > 3 * width(fast)
    # what lies at the ends counts as often as the rest: the interval holds its value
    width(np.where(start < 10.0, 20.0, 1.0)[:, None] * slow)


def test_two_filters_are_compared_by_the_outages_that_they_share() -> None:
    rng = np.random.default_rng(5)
    start, horizons, size = np.arange(1200.0), np.array([30.0]), np.repeat(rng.exponential(1.0, (40, 1)), 30, axis=0)

    def of(e: np.ndarray) -> Outages:
        return Outages(start, horizons, e[:, None], np.tile(np.eye(2), (1200, 1, 1, 1)), np.zeros((1200, 1, 2)))

    error = size * rng.standard_normal((1200, 2))
    one = of(error)
    assert one.ratio(one, 0) == (1.0, 1.0, 1.0)
    worse = of(1.1 * error + 0.1 * rng.standard_normal((1200, 2)))
    ratio, low, high = worse.ratio(one, 0)
    assert 1.0 < low < ratio < high and ratio == pytest.approx(worse.rms(0) / one.rms(0))
    assert one.interval(0)[1] > worse.interval(0)[0]  # apart, their intervals overlap
    assert all(np.isnan(one.rows(start < 100).ratio(worse.rows(start < 100), 0)))  # fewer than two blocks


def test_designs_of_a_scenario_fly_with_what_they_compensate(
    solution: Solution, recording: Recording, tmp_path: Path
) -> None:
    write_recording(tmp_path / "drive.npz", replace(recording, reference=None))
    own = {"gyro": "WN(N=0.3 deg/sqrt(h)) + RC(sigma=0.05 deg/s)", "accel": "WN(N=0.1 m/s/sqrt(h)) + RC(sigma=5 mg)"}
    on_time = {"effect": "imu_gnss_time_offset", "offset": f"{LATE} s"}
    scenario = {
        "title": "drive",
        "recording": {"file": "drive.npz", "mounting": [f"{v} deg" for v in np.rad2deg(MOUNTING)]},
        "gnss": {"lever_arm": [f"{v} m" for v in ARM]},
        "designs": {"late": own, "on time": {**own, "options": {"compensate": [on_time]}}},
    }
    path = tmp_path / "scenario.yaml"
    path.write_text(yaml.safe_dump(scenario))
    found = compare_with(solution, path)
    late, better = (found.designs[d].rms(0) for d in ("late", "on time"))
    assert better < 0.7 * late


def test_metres_are_those_of_the_filter_not_of_the_fixes() -> None:
    """Errors of 2 m an axis, seen through fixes that scatter by 3 m: rms, median and 95 % are Rayleigh's of 2 m."""
    rng, n = np.random.default_rng(5), 40000
    e = 2.0 * rng.standard_normal((n, 1, 2)) + 3.0 * rng.standard_normal((n, 1, 2))
    o = Outages(
        np.arange(n, dtype=float), np.array([10.0]), e, np.tile(4.0 * np.eye(2), (n, 1, 1, 1)), np.full((n, 1, 2), 9.0)
    )
    assert o.rms(0) == pytest.approx(2.0 * np.sqrt(2.0), rel=0.03)
    assert o.quantiles(0) == pytest.approx(
        [2.0 * np.sqrt(2.0 * np.log(2.0)), 2.0 * np.sqrt(2.0 * np.log(20.0))], rel=0.03
    )
    assert o.nees(0) == pytest.approx(1.0, rel=0.03)


def test_outages_are_compared_second_by_second_also_where_two_begin_within_one() -> None:
    """Fixes that come a little more often than once a second begin two outages in some of them."""

    def of(start: np.ndarray) -> Outages:
        n = start.size
        return Outages(start, np.array([10.0]), np.zeros((n, 1, 2)), np.zeros((n, 1, 2, 2)), np.zeros((n, 1, 2)))

    one, two = _at_the_same(of(np.array([9.6, 10.6, 11.4, 12.2, 20.0])), of(np.array([10.1, 11.1, 12.1, 13.1])))
    assert one.start.tolist() == [9.6, 10.6, 12.2] and two.start.tolist() == [10.1, 11.1, 12.1]


def test_a_tunnel_is_a_gap_of_its_own_and_no_outage_begins_in_it(solution: Solution) -> None:
    drive, c = solution.drive, solution.taken.candidate
    inside = (drive.gnss.t > 150.2) & (drive.gnss.t < 190.1)
    tunnel = replace(drive, gnss=drive.gnss.rows(~inside))
    run = flown(c.filter(tunnel, store="fixes", node_every=1.0), tunnel, c)
    o = cut_everywhere(c.filter(tunnel), run, drive.flown(c.filter(drive))[0], tunnel.scattered(), workers=2)
    last = float(tunnel.gnss.t[tunnel.gnss.t < 160.0][-1])
    step = float(np.median(np.diff(drive.gnss.t)))
    assert o.start.size > 100 and not ((o.start > last + 1.5 * step + 1e-6) & (o.start < 190.0)).any()
    # those that are cut beside it cost what they cost without it
    usual = solution.taken.outages
    both = np.intersect1d(np.round(o.start), np.round(usual.start[usual.start < 140.0]))
    assert both.size > 30
    for which in (o, usual):
        assert which.rows(np.isin(np.round(which.start), both)).rms(0) == pytest.approx(
            usual.rows(np.isin(np.round(usual.start), both)).rms(0), rel=0.05
        )
    (gap,) = gaps_of(run)
    assert gap.start == pytest.approx(last) and gap.seconds == pytest.approx(40.0, abs=1.1)
    assert 0.05 * gap.stated < gap.error < 4.0 * gap.stated
    assert gaps_of(solution.taken.run) == []


def test_fixes_that_all_others_contradict_are_told(solution: Solution) -> None:
    drive, c, rng = solution.drive, solution.taken.candidate, np.random.default_rng(8)
    clean = outlying(flown(c.filter(drive, store="fixes"), drive, c))
    assert clean.positions.size <= 1 and clean.velocities.size <= 1
    hit = np.sort(rng.choice(np.arange(60, len(drive.gnss)), len(drive.gnss) // 20, replace=False))
    llh = drive.gnss.llh.copy()
    llh[hit] = earth.move(llh[hit], rng.choice([-1.0, 1.0], (hit.size, 3)) * [3.0, 2.0, 0.0])
    wrong = replace(drive, gnss=replace(drive.gnss, llh=llh))
    found = outlying(flown(c.filter(wrong, store="fixes"), wrong, c))
    assert set(drive.gnss.t[hit]) <= set(found.positions)
    assert found.positions.size <= hit.size + 3
    assert found.largest == pytest.approx(np.hypot(3.0, 2.0), rel=0.3)


def test_fixes_that_state_too_much_are_judged_by_their_scatter(solution: Solution) -> None:
    drive, c = solution.drive, solution.taken.candidate
    g = drive.gnss
    assert g.pos_std_ned is not None and g.vel_std_ned is not None
    large = replace(drive, gnss=replace(g, pos_std_ned=20.0 * g.pos_std_ned, vel_std_ned=20.0 * g.vel_std_ned))
    one = replace(c, position=1.0, velocity=1.0)
    assert adapted(one, large).position == pytest.approx(1.0)
    found = adapted(one, large, overstated=True)
    assert (found.position, found.velocity) == pytest.approx((0.1, 0.1), rel=0.15)
    judged = replace(large, scatter=(found.position, found.velocity)).scattered().pos_std_ned
    assert judged == pytest.approx(0.1, rel=0.15)


def test_biases_are_told_in_whole(recording: Recording, solution: Solution) -> None:
    """A constant that is added to the gyroscopes comes back, whatever the start took off."""
    c, added = solution.taken.candidate, np.deg2rad([0.3, -0.2, 0.4])
    imu = recording.imu
    late = replace(imu, t=imu.t - LATE, gyro=imu.gyro + added * imu.dt)
    drive = prepared(replace(recording, imu=late)).started()
    run = flown(c.filter(drive, store="fixes", node_every=1.0), drive, c)
    biased = replace(solution, drive=drive, smoothed=smooth(run), taken=Scored(c, run, solution.taken.outages))
    for k, axis in enumerate(("gyro_x", "gyro_y", "gyro_z")):
        value, sigma, _ = biased.biases[axis]
        assert value - solution.biases[axis][0] == pytest.approx(added[k], abs=4.0 * sigma)
        assert sigma < 0.1 * abs(added[k])
    assert any(abs(off) > 0.1 * abs(a) for (_, _, off), a in zip(biased.biases.values(), added, strict=False))


def test_a_dead_axis_is_the_suspect_and_a_right_recording_has_none(solution: Solution) -> None:
    assert solution.suspects == {}
    gyro = solution.drive.imu.gyro.copy()
    gyro[:, 2] = 0.0
    dead = replace(solution, drive=replace(solution.drive, imu=replace(solution.drive.imu, gyro=gyro)))
    assert dead.suspects == {"gyro_z": np.inf}
    assert solve_answer(dead).startswith(
        "Look at the recording first: gyro z errs by noise that its samples do not show."
    )


def test_the_verdict_is_that_of_all_outages_and_of_the_innovations(solution: Solution) -> None:
    taken, o = solution.taken, solution.taken.outages
    assert taken.factor == 1.0 and "and it knows its error." in solve_answer(solution)
    sure = replace(taken, outages=replace(o, covariance=o.covariance / 400.0, fix_variance=o.fix_variance / 400.0))
    assert sure.factor == pytest.approx(20.0 * np.sqrt(max(o.nees(k) for k in range(3))))
    assert "it is optimistic by a factor of" in solve_answer(replace(solution, taken=sure))
    fixes = replace(taken.run.fixes, nis=taken.run.fixes.nis / 100.0)
    shy = replace(taken, run=replace(taken.run, fixes=fixes))
    assert (
        shy.factor == pytest.approx(0.1 * np.sqrt(taken.nis))
        and summary(replace(solution, taken=shy))["knows_its_error"] is False
    )


def test_late_velocities_are_recognised(recording: Recording) -> None:
    assert recording.gnss is not None and velocity_lag(recording.gnss) == (0.0, 1.0)
    t = np.arange(0.0, 400.0, 0.25)
    way = np.stack([60 * np.sin(0.2 * t), 60 * np.cos(0.31 * t), 0 * t], axis=1)
    late = t - 0.125
    speed = np.stack([12 * np.cos(0.2 * late), -18.6 * np.sin(0.31 * late), 0 * t], axis=1)
    fixes = GnssRecord(t, earth.move(np.tile([0.8, 0.1, 200.0], (t.size, 1)), way), speed)
    lag, share = velocity_lag(fixes)
    assert lag == pytest.approx(0.125, abs=0.03) and share < 0.1
    rough = replace(fixes, llh=earth.move(fixes.llh, 2.0 * np.random.default_rng(1).standard_normal(fixes.llh.shape)))
    lag, share = velocity_lag(replace(rough, vel_ned=np.roll(rough.vel_ned, 4, axis=0)).rows(slice(4, None)))
    assert lag == pytest.approx(1.125, abs=0.2) and share > 0.1


def test_the_longest_stretch_without_a_gap_is_solved(recording: Recording) -> None:
    imu = recording.imu
    keep = (imu.t < 100.0) | (imu.t > 104.0)
    with_gap = replace(recording, imu=imu.rows(keep))
    drive = prepared(with_gap)
    assert drive.imu.t[0] > 103.9 and "4" not in drive.source and any("gap" in text for text in drive.said)
    with pytest.raises(InputError, match="no GNSS fixes"):
        prepared(replace(recording, gnss=None))
    with pytest.raises(InputError, match="60 s of IMU data"):
        prepared(replace(recording, imu=imu.rows(slice(0, 500))))


def test_rows_that_repeat_are_filled_in_and_said(recording: Recording) -> None:
    imu, last = recording.imu, np.arange(len(recording.imu))
    last[100::50] -= 1
    held = replace(imu, gyro=imu.gyro[last], accel=imu.accel[last])
    drive, lost = prepared(replace(recording, imu=held)), int(held.repeated().sum())
    assert lost > 100 and not drive.imu.repeated().any()
    assert sum(f"{lost} samples of the IMU are lost" in line for line in drive.said) == 1
    assert not any("lost" in line for line in prepared(recording).said)


def test_designs_that_need_a_fit_are_refused() -> None:
    with pytest.raises(InputError, match="insemu fit"):
        candidates(["GMWM"])
    with pytest.raises(InputError, match="no design 'pohne'"):
        candidates(["pohne"])
    with pytest.raises(InputError, match="--sensor: no sensor 'nan' comes with insemu"):
        candidates(sensor="nan")


def test_a_fitted_model_gets_a_turn_on_bias(tmp_path: Path) -> None:
    noise.save(
        {"gyro": noise.WN(N=1e-4) + noise.NoiseModel(), "accel": noise.WN(N=1e-3) + noise.RC(sigma=0.1)},
        tmp_path / "m.yaml",
    )
    one = candidates(model=str(tmp_path / "m.yaml"))[-1]
    assert str(one.belief["gyro_x"]).count("RC") == 1 and str(one.belief["accel_x"]).count("RC") == 1
    assert "turn-on" in one.about


def test_files_are_read_back(solution: Solution, tmp_path: Path) -> None:
    write(solution, tmp_path)
    with xr.open_dataset(tmp_path / "solution.nc", engine="h5netcdf") as held:
        assert np.array_equal(held["llh"].values, solution.smoothed.nav[:, :3])
        assert held["outage_error"].shape == solution.taken.outages.error.shape
    back = read_recording(tmp_path / "solved.npz")
    assert back.reference is not None and np.allclose(back.reference.llh, solution.smoothed.nav[:, :3], atol=1e-12)
    assert noise.load(str(tmp_path / "models.yaml")).keys() == dict(solution.taken.candidate.belief).keys()
    assert len((tmp_path / "outages.csv").read_text().splitlines()) == 1 + solution.taken.outages.start.size
    json.dumps(summary(solution), allow_nan=False)


def test_an_axis_that_is_shaken_more_is_found(recording: Recording) -> None:
    rng, imu = np.random.default_rng(4), recording.imu
    shaken = imu.gyro.copy()
    noise = np.deg2rad(0.2)  # per root hertz; the other axes have a tenth
    shaken[:, 1] += noise * np.sqrt(imu.dt) * rng.standard_normal(len(imu))  # increments
    late = replace(recording, imu=replace(imu, t=imu.t - LATE, gyro=shaken))
    drive = prepared(late).started()
    own = adapted(next(c for c in candidates() if c.name == "consumer MEMS"), drive)
    each = adapted(own, drive, by_axis=True)
    value = likelihood_of(drive)

    def worse(axis: str, density: float) -> float:
        """By how much twice the log-likelihood falls where an axis has another white noise, (deg/s)/sqrt(Hz)."""
        white, *rest = each.belief[axis]
        assert isinstance(white, WN)
        believed = each.belief | {axis: NoiseModel((WN(N=np.deg2rad(density)), *rest))}
        return 2.0 * (value(each) - value(replace(each, belief=believed)))

    # how much another axis has, the record tells within a factor of ten: its truth is not refused, that of the shaken one is told
    limit = stats.chi2.isf(1e-3, 1)
    assert worse("gyro_y", 0.2) < limit < worse("gyro_y", 0.02)
    assert max(worse("gyro_x", 0.02), worse("gyro_z", 0.02)) < limit
    assert min(each.position, each.velocity) >= 1.0
    assert each.about.count("likelihood") == 1 and "gyro_y white noise" in each.about


@pytest.mark.slow(reason="real recordings of hours")
@pytest.mark.parametrize(
    ("name", "grade"),
    [("rtkexp_drive", "phone"), ("ublox_mixed_nominal", "industrial MEMS"), ("thor75_uav_flight", "UAV MEMS")],
)
def test_a_generic_grade_knows_its_error_on_every_real_drive(name: str, grade: str) -> None:
    drive = prepared(read_recording(shared(f"real/{name}.npz"))).started()
    believed = next(c for c in candidates() if c.name == grade)
    drive = drive.shifted(clock_offset(believed, drive)[0]).started()
    if drive.assumed:  # standard deviations from the scatter of the fixes hold none of their slow errors
        believed = adapted(believed, drive)
    fixes = flown(believed.filter(drive, output_every=100), drive, believed).fixes
    assert 0.3 < float(fixes.nis[fixes.accepted].sum() / fixes.dof[fixes.accepted].sum()) < 3.0


def test_what_was_taken_off_stays_with_the_recording(
    solution: Solution, recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clock that is late, taken off by solve, was "nothing missing" for gap: it looks at the recording as it was measured."""
    write(solution, tmp_path)
    held = read_recording(tmp_path / "solved.npz")
    assert held.preparation is not None and held.preparation.said == solution.drive.said
    assert held.preparation.imu_late == pytest.approx(LATE, abs=0.01)
    looked: list[Recording] = []

    def find(measured: Recording, *_: object) -> None:
        looked.append(measured)
        raise InputError("enough")

    monkeypatch.setattr(session, "_find", find)
    for given in (held, held.as_measured()):
        with pytest.raises(InputError, match="enough"):
            session.find_gap(given, Nominal({}), rng=np.random.default_rng(1))
    for seen in looked:
        np.testing.assert_allclose(seen.imu.t, recording.imu.t, atol=1e-9)
        assert seen.gnss is not None and recording.gnss is not None
        np.testing.assert_allclose(seen.gnss.llh, recording.gnss.llh, atol=1e-12)
        assert seen.gnss.pos_std_ned is not None and (seen.gnss.pos_std_ned == 0.05).all()


def test_solved_tracks_are_exported(solution: Solution, tmp_path: Path) -> None:
    write(solution, tmp_path / "solved")
    for name in ("a.kml", "a.gpx", "a.pos", "a.tum"):
        with pytest.raises(SystemExit) as end:
            main(["export", str(tmp_path / "solved"), "--origin", "2024-05-01T12:00:00Z", "-o", str(tmp_path / name)])
        assert end.value.code in (0, None)
    assert (tmp_path / "a.kml").read_text().count("<LineString>") >= 1
    assert (tmp_path / "a.tum").with_suffix(".cov.csv").exists()


def test_a_short_record_and_a_lost_filter_are_told(recording: Recording) -> None:
    drive = prepared(recording).started()
    late = drive.aligned.t + 30.0  # no fix before it
    short = replace(recording, imu=recording.imu.rows(recording.imu.t < late + 35.0))
    assert recording.gnss is not None
    short = replace(short, gnss=recording.gnss.rows(recording.gnss.t > late))
    with pytest.raises(InputError, match=r"the filter can start at .* expected at least 40 s between"):
        solve(short, intake.examine(short), candidates()[2:3])
    good = candidates()[1]
    ekf = good.filter(drive, store="fixes", node_every=1.0)
    imu, gnss = drive.flown(ekf)
    few = imu.rows(imu.t < imu.t[0] + 20.0)
    run = ekf.run(few, good.fixes(gnss), drive.aligned.state, drive.aligned.sigma)
    with pytest.raises(InputError, match="room for an outage"):
        cut_everywhere(ekf, run, few, good.fixes(gnss))


def test_the_command_refuses_in_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t = np.arange(0.0, 100.0, 0.02)
    still = ImuRecord(t, np.zeros((t.size, 3)), np.tile([0.0, 0.0, -9.81], (t.size, 1)))
    write_recording(tmp_path / "r.npz", Recording(still))
    for argv, said in (
        (["solve", str(tmp_path / "r.npz")], "no GNSS fixes"),
        (["solve", str(tmp_path / "r.npz"), "--lever-arm", "1 2"], "three lengths"),
        (["solve", str(tmp_path / "absent.npz")], "no such file"),
    ):
        with pytest.raises(SystemExit) as end:
            main([*argv, "--output", str(tmp_path / "out")])
        assert end.value.code == 2 and said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
