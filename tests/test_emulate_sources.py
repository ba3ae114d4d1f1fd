"""Where motion comes from: built-in flights, waypoints, recorded tracks, motion commands; and input that cannot be
right.
"""

import json
import re

import numpy as np
import pytest

from benchmarks.emulate_accuracy import outage_windows
from insemu import earth, rotation
from insemu.emulate import (
    TRAJECTORIES,
    MotionSource,
    Mounting,
    SmoothPath,
    Track,
    Waypoints,
    built_in,
    gnss_fixes,
    ideal_imu,
    load_flight,
    navigation_error,
    random_outages,
    read_track,
    read_waypoints,
    route,
    smooth_track,
)
from insemu.emulate.commands import read_motion
from insemu.emulate.motion import Command, profile, smoothstep, smoothstep_integral, smoothstep_slope
from insemu.emulate.track import held_out_distance, turn_rate
from insemu.emulate.vehicle import VEHICLES
from insemu.errors import InputError
from insemu.formats import read_recording
from tests.shared_data import shared

ORIGIN = np.array([0.8, 0.1, 400.0])


# -- built-in
# --------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(TRAJECTORIES))
def test_built_in_flights_stay_within_their_vehicle(name):
    flight = built_in(name)
    path, v = flight.path, VEHICLES[flight.vehicle]
    t = np.arange(path.start, path.end, 0.1)
    k = path.kinematics(t)
    speed = np.hypot(k.vel_ned[:, 0], k.vel_ned[:, 1])
    assert speed.max() <= v.max_speed
    assert np.abs(k.vel_ned[:, 2]).max() <= v.max_climb
    assert np.abs(turn_rate(path, t)).max() <= v.max_turn_rate
    assert np.abs(k.rpy[:, :2]).max() < np.deg2rad(45)
    # what moves points ahead, give or take gusts
    moving = speed > 5.0
    course = np.arctan2(k.vel_ned[moving, 1], k.vel_ned[moving, 0])
    assert np.abs((course - k.rpy[moving, 2] + np.pi) % (2 * np.pi) - np.pi).max(initial=0.0) < np.deg2rad(8)


def test_urban_drives_have_the_printed_windows():
    drives = [built_in(name) for name in ("urban_drive_1", "urban_drive_2", "urban_motorway")]
    assert [d.path.duration for d in drives] == pytest.approx([17.3 * 60, 15.05 * 60, 1173.0])
    rows = outage_windows(drives)
    assert [r["outage"] for r in rows] == [1, 2, 3, 4, 5, 6, 7, 1, 2, 3, 4, 5, 6, 7]
    for r in rows:
        assert r["duration_s"] == r["printed_duration_s"]
        assert r["speed_kmh"] == pytest.approx(r["printed_speed_kmh"], rel=0.05)
    turns = {r["outage"]: r["turn_deg"] for r in rows[:7]}
    assert turns[1] == pytest.approx(90, abs=5) and turns[2] < 2 and turns[5] > 30 and 3 < turns[7] < 20


def test_survey_is_two_hours():
    assert built_in("survey").path.duration == 7200.0


# -- motion
# ----------------------------------------------------------------------------------------------------------------------


def test_smoothstep_and_its_relatives():
    u = np.linspace(-0.5, 1.5, 2001)
    np.testing.assert_allclose(np.gradient(smoothstep(u), u), smoothstep_slope(u), atol=1e-5)
    np.testing.assert_allclose(np.gradient(smoothstep_integral(u), u)[1:-1], smoothstep(u)[1:-1], atol=1e-5)


def test_profile_does_what_the_commands_say():
    p = profile(
        [Command(10.0, speed=8.0), Command(20.0, turn=np.pi / 2, climb=12.0), Command(5.0, speed=0.0)], heading=0.3
    )
    assert p.speed[-1] == pytest.approx(0.0, abs=1e-12) and p.speed.max() == pytest.approx(8.0)
    assert p.heading[-1] - p.heading[0] == pytest.approx(np.pi / 2)
    assert p.height[-1] == pytest.approx(12.0)
    for value, slope in ((p.speed, p.acceleration), (p.heading, p.turn_rate), (p.height, p.climb_rate)):
        np.testing.assert_allclose(np.gradient(value, p.t)[1:-1], slope[1:-1], atol=5e-3)
    with pytest.raises(InputError, match="positive duration"):
        Command(0.0)


MOTION = """ini lat (deg),ini lon (deg),ini alt (m),ini vx,ini vy,ini vz,ini yaw,ini pitch,ini roll
32,120,50,0,0,0,10,0,0
command type,yaw (deg),pitch (deg),roll (deg),vx (m/s),vy (m/s),vz (m/s),duration (s),GPS
1,0,0,0,0,0,0,20,1
5,0,0,0,10,0,0,25,1
3,90,0,0,0,0,0,25,0
1,-3,0,0,0,0,0,20,1
2,0,5,0,12,0,0,10,1
4,0,0,0,-12,0,0,10,1
"""


def test_motion_files_of_other_simulators_fly(tmp_path):
    file = tmp_path / "motion.csv"
    file.write_text(MOTION)
    flight = read_motion(file)
    assert flight.outages == ((45.0, 25.0),)
    r = flight.path.sample([19.0, 45.0, 70.0, 90.0, 100.0, 110.0])
    np.testing.assert_allclose(np.rad2deg(r.rpy[:, 2]), [10, 10, 100, 40, 0, 0], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(r.vel_ned, axis=1), [0, 10, 10, 10, 12, 0], atol=1e-3)
    assert np.rad2deg(r.rpy[4, 1]) == pytest.approx(5.0)
    assert r.vel_ned[4, 2] == pytest.approx(-12 * np.sin(np.deg2rad(5)), abs=1e-6)
    ideal = ideal_imu(flight)
    assert np.abs(navigation_error(ideal)).max() < 1e-9


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("5,0,0,0,10", "7,0,0,0,10", r"motion.csv:5: command type 7, expected 1, 2, 3, 4 or 5"),
        ("0,0,0,25,0", "0,0,0,-25,0", r"motion.csv:6: a duration of -25 s"),
        ("32,120", "132,20", "latitude and longitude swapped"),
        ("3,90", "3,ninety", r"motion.csv:6: found 'ninety' for yaw"),
        ("10,1\n4", "10\n4", r"motion.csv:8: 8 cells, expected 9"),
        ("2,0,5,0", "2,0,88,0", "pitch beyond 85 deg"),
    ],
)
def test_wrong_motion_files_are_named(tmp_path, old, new, message):
    file = tmp_path / "motion.csv"
    assert old in MOTION
    file.write_text(MOTION.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read_motion(file)


# -- waypoints
# -------------------------------------------------------------------------------------------------------------------

SHAPE = np.array([[0, 0, 0], [1, 0, -0.02], [1.2, 0.8, 0], [0.2, 1.0, -0.03], [-0.5, 0.4, 0]])


@pytest.mark.parametrize(
    ("vehicle", "speed", "size"), [("car", 12.0, 300.0), ("multirotor", 8.0, 100.0), ("fixed_wing", 25.0, 1500.0)]
)
def test_routes_keep_to_the_vehicle_and_pass_the_waypoints(vehicle, speed, size):
    places = earth.move(ORIGIN, SHAPE * size)
    made = route(Waypoints(places, speed), vehicle)
    assert made.warnings == ()
    path, v = made.flight.path, VEHICLES[vehicle]
    t = np.arange(path.start, path.end, 0.05)
    k = path.kinematics(t)
    horizontal = np.hypot(k.vel_ned[:, 0], k.vel_ned[:, 1])
    assert horizontal.max() <= speed * 1.001
    assert horizontal.min() >= v.min_speed * 0.999 if v.min_speed else horizontal[0] == 0.0
    assert np.hypot(k.acc_ned[:, 0], k.acc_ned[:, 1]).max() <= max(v.max_acceleration, v.max_lateral)
    assert np.abs(turn_rate(path, t)).max() <= v.max_turn_rate
    # ends where it should, and rounds the corners by less than their turns need
    end = earth.position_difference(path.llh([path.end]), places[-1])[0]
    assert np.abs(end).max() < 1e-3
    closest = [np.hypot(*earth.position_difference(k.llh, p)[:, :2].T).min() for p in places]
    assert max(closest) < 0.1 * size
    if vehicle == "fixed_wing":  # coordinated: no side force
        ideal = ideal_imu(path, 20.0, mode="continuous", kind="mean")
        assert np.abs(ideal.imu.accel[:, 1]).max() < 0.2


def test_waypoint_files(tmp_path):
    csv = tmp_path / "way.csv"
    csv.write_text(
        "lat, lon, height [ft], speed [km/h]\n# a comment\n46.0,7.0,1000,36\n46.01,7.0,1000,36\n46.01,7.01,1000,36\n"
    )
    w = read_waypoints(csv)
    np.testing.assert_allclose(w.llh[0], [np.deg2rad(46), np.deg2rad(7), 304.8])
    np.testing.assert_allclose(w.speed, 10.0)
    line = tmp_path / "way.geojson"
    coordinates = [[7.0, 46.0, 300], [7.0, 46.01, 300], [7.01, 46.01, 300]]
    line.write_text(json.dumps({"type": "LineString", "coordinates": coordinates}))
    np.testing.assert_allclose(read_waypoints(line, 10.0).llh[:, :2], w.llh[:, :2])
    points = [
        {"type": "Feature", "properties": {"speed": 10}, "geometry": {"type": "Point", "coordinates": c}}
        for c in coordinates
    ]
    line.write_text(json.dumps({"type": "FeatureCollection", "features": points}))
    np.testing.assert_allclose(read_waypoints(line).speed, 10.0)
    flight = load_flight(MotionSource(waypoints=csv, vehicle="car")).flight
    assert flight.path.duration > 150


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lat,lon,speed\n7.0,146.0,10\n", r"1 waypoint\(s\), expected at least two"),
        ("lat,lon,speed\n107.0,46.0,10\n107.1,46.0,10\n", "latitude of 107 deg; are latitude and longitude swapped"),
        ("lat,lon,speed\n46,7,10\n46.01,nan,10\n", r"way.csv:3: found 'nan' for lon"),
        ("lat,lon,speed\n46,7,10\n46.01,x,10\n", r"way.csv:3: found 'x' for lon, expected a number"),
        ("lat,lon,speed\n46,7,10\n46.01,7\n", r"way.csv:3: 2 cells, expected 3"),
        ("lat,lng,sped\n46,7,10\n", r"way.csv:1: unknown column 'sped'.*'speed'"),
        ("lat,lon,speed [kg]\n46,7,10\n46.1,7,10\n", "unknown unit 'kg'"),
        ("lat,lon\n46,7\n46.1,7\n", "no column 'speed'"),
        ("lat,lon,speed\n46,7,90\n46.01,7,90\n", "asks for 90 m/s, a car does 0.1 to 60 m/s"),
        ("lat,lon,speed\n46,7,20\n46,7,20\n46.1,7,20\n", "waypoints 1 and 2 are 0 m apart"),
        ("lat,lon,speed\n46,7,20\n46.01,7,20\n46.0,7,20\n", "turns by .*180 deg, expected at most 150 deg"),
        ("lat,lon,speed\n46,7,20\n7,46,20\n", "h at its speed; are latitude and longitude swapped"),
        ("lat,lon,height,speed\n46,7,1000,20\n46.01,7,2200,20\n", "heights in feet by the look of it"),
        ("lat,lon,height,speed\n46,7,0,20\n46.01,7,9000,20\n", r"climbs 9000 m at 162 m/s, a car does 8 m/s$"),
        ("lat,lon,speed\n46,7,20\n46.0001,7,20\n46.0001,7.0001,20\n46.0002,7.0001,20\n", None),
    ],
)
def test_wrong_waypoints_are_named(tmp_path, text, message):
    file = tmp_path / "way.csv"
    file.write_text(text)
    if message is None:  # legs of ten metres: slower than asked for, and said so
        made = route(read_waypoints(file), "car")
        assert "too short to reach it" in made.warnings[0]
        return
    with pytest.raises(InputError, match=message):
        route(read_waypoints(file), "car")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "lat,lon,speed\n-79.99,40.44,10\n-79.98,40.44,10\n",
            "latitude of -79.99 deg.*are latitude and longitude swapped",
        ),
        ("lat,lon,speed\n0.8395,0.2007,10\n0.8495,0.2007,10\n", "Gulf of Guinea: radians by the look of it"),
        ("lat,lon,height,speed\n39,-105,17000,10\n39.01,-105,17000,10\n", "a car at 17000 m: heights in feet"),
        (
            "lat,lon,height,speed\n47,11,1640,5\n47.001,11,1690,5\n",
            "rises 45 %, steeper than any road: heights in feet",
        ),
    ],
)
def test_waypoints_that_look_odd_are_warned_about(tmp_path, text, message):
    file = tmp_path / "way.csv"
    file.write_text(text)
    made = load_flight(MotionSource(waypoints=file))
    assert len(made.warnings) == 1
    assert re.search(message, made.warnings[0])


LINE = {"type": "LineString", "coordinates": [[11.5, 48.1], [11.5, 48.105], [11.51, 48.105]]}


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ([1, 2], "not GeoJSON"),
        ({"type": "LineString"}, "a LineString without 'coordinates'"),
        ({"type": "Polygon", "coordinates": []}, "geometry of type 'Polygon'"),
        ({"features": [{"type": "Feature", "geometry": None}]}, "expected a feature with a geometry"),
        (LINE | {"coordinates": [["a", 1], [2, 3]]}, "point 1 is .*, expected .longitude, latitude"),
        ({"geometry": LINE, "properties": {"speed": "36 kg"}}, "speed of point 1: .*kg"),
        (LINE | {"bbox": [48, 11, 49, 12]}, r"outside of the file's bbox .*swapped all points fit"),
        (LINE | {"bbox": [11, 48.2, 12, 49]}, r"point 1 \[11.5, 48.1\] is outside of the file's bbox .*\]$"),
        (LINE | {"bbox": [11, 48]}, "expected .west, south, east, north"),
    ],
)
def test_wrong_geojson_is_named(tmp_path, document, message):
    file = tmp_path / "way.geojson"
    file.write_text(json.dumps(document))
    with pytest.raises(InputError, match=message):
        read_waypoints(file, 10.0)


def test_geojson_within_its_box(tmp_path):
    file = tmp_path / "way.geojson"
    feature = {"geometry": LINE, "properties": {"speed": "36 km/h"}, "bbox": [11, 48, 12, 49]}
    file.write_text(json.dumps({"features": [feature], "bbox": [170, 48, 12, 49]}))  # across the antimeridian
    np.testing.assert_allclose(read_waypoints(file).speed, 10.0)


def test_legs_too_short_for_a_wing_are_refused():
    with pytest.raises(InputError, match="too short for a fixed_wing to turn"):
        route(Waypoints(earth.move(ORIGIN, SHAPE * 40.0), 20.0), "fixed_wing")


def test_sources_are_one_at_a_time(tmp_path):
    with pytest.raises(InputError, match="found 'builtin' and 'track'"):
        load_flight(MotionSource(builtin="static", track=tmp_path / "x.csv"))
    with pytest.raises(InputError, match="found none"):
        load_flight(MotionSource())
    with pytest.raises(InputError, match="no such waypoint file"):
        load_flight(MotionSource(waypoints=tmp_path / "absent.csv"))
    with pytest.raises(InputError, match=r"unknown vehicle 'kar'.*did you mean 'car'"):
        smooth_track(some_track(), "kar")


# -- recorded tracks
# ---------------------------------------------------------------------------------------------------------------


def some_track(rate=2.0, sigma=0.05, velocity=True, seed=0, name="urban_drive_1"):
    path = built_in(name).path
    t = np.arange(60.0, 360.0, 1.0 / rate)
    rng = np.random.default_rng(seed)
    llh = earth.move(path.llh(t), sigma * rng.standard_normal((t.size, 3)))
    vel = path.vel_ned(t) + 0.05 * rng.standard_normal((t.size, 3)) if velocity else None
    return Track(t, llh, vel, None, sigma, 0.05)


def test_the_basis_is_the_b_splines_of_scipy():
    from scipy.interpolate import BSpline

    from insemu.emulate.track import _Basis

    basis = _Basis.over(2.0, 7.0, 0.5)
    c = np.random.default_rng(1).normal(size=(basis.count, 2))
    theirs = BSpline(basis.knots, c, 5)
    t = np.random.default_rng(2).uniform(2.0, 7.0, 200)
    ours = basis.ppoly(c)
    for order in range(4):
        first, values = basis.design(t, order)
        direct = np.stack(
            [(values[:, :, None] * c[first[:, None] + np.arange(6)])[:, :, k].sum(1) for k in range(2)], axis=1
        )
        np.testing.assert_allclose(direct, theirs(t, nu=order), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(ours(t, order), theirs(t, nu=order), rtol=1e-9, atol=1e-8)


@pytest.mark.parametrize("velocity", [True, False], ids=["with velocity", "position only"])
def test_a_smoothed_track_is_near_the_truth(velocity):
    truth = built_in("urban_drive_1").path
    made = smooth_track(some_track(velocity=velocity))
    t = np.arange(70.0, 350.0, 0.1)
    off = earth.position_difference(made.path.llh(t), truth.llh(t))
    assert np.sqrt((off[:, :2] ** 2).mean()) < 0.1
    speed = np.linalg.norm(made.path.vel_ned(t) - truth.vel_ned(t), axis=1)
    assert np.sqrt((speed**2).mean()) < 0.15
    moving = np.linalg.norm(truth.vel_ned(t), axis=1) > 5
    turn = rotation.attitude_difference(made.path.rpy(t), truth.rpy(t))[moving]
    assert np.abs(turn[:, 2]).max() < np.deg2rad(6)
    ideal = ideal_imu(made.path)
    assert np.abs(navigation_error(ideal)).max() < 1e-6


def test_full_pose_and_gaps_are_followed():
    truth = built_in("turbulent_uav").path
    t = np.arange(100.0, 160.0, 0.05)
    t = t[(t < 120.0) | (t > 121.0)]
    pose = truth.sample(t)
    made = smooth_track(pose, "fixed_wing")
    assert isinstance(made.path, SmoothPath)
    inner = np.arange(105.0, 155.0, 0.1)
    inner = inner[(inner < 119.5) | (inner > 121.5)]
    off = earth.position_difference(made.path.llh(inner), truth.llh(inner))
    assert np.abs(off).max() < 0.05
    assert np.abs(rotation.attitude_difference(made.path.rpy(inner), truth.rpy(inner))).max() < np.deg2rad(0.5)


def test_outlying_fixes_lose_their_weight():
    track = some_track()
    llh = track.llh.copy()
    llh[200] = earth.move(llh[200], np.array([30.0, -20.0, 10.0]))
    spoiled = Track(track.t, llh, track.vel_ned, None, track.pos_std, track.vel_std)
    made = smooth_track(spoiled)
    assert made.weight[200] < 0.1
    clean = smooth_track(track).path
    t = np.array([track.t[200]])
    assert np.abs(earth.position_difference(made.path.llh(t), clean.llh(t))).max() < 0.3


def changed(track, **values):
    fields = {"t": track.t, "llh": track.llh, "vel_ned": track.vel_ned, "rpy": None, "pos_std": track.pos_std}
    return Track(**{**fields, **values})


def test_tracks_that_cannot_be_right_are_named():
    track = some_track()
    t, llh, vel = track.t, track.llh, track.vel_ned
    cases = [
        (changed(track, t=t[:2], llh=llh[:2], vel_ned=None), r"2 point\(s\), expected at least 5"),
        (changed(track, t=np.r_[t[:10], t[9], t[11:]]), r"time repeats at row 10 \(64\.5 s then 64\.5 s\)"),
        (changed(track, t=np.r_[t[:10], t[3], t[11:]]), r"time goes back at row 10"),
        (
            changed(track, t=np.delete(t, np.s_[20:60]), llh=np.delete(llh, np.s_[20:60], 0), vel_ned=None),
            r"a gap of 20.5 s after t = 69.5 s, longer than the 10 s",
        ),
        (
            changed(track, llh=np.where(np.arange(t.size)[:, None] == 7, np.nan, llh)),
            r"row 7 has a value that is not finite",
        ),
        (changed(track, llh=llh[:, [1, 0, 2]]), "only with latitude and longitude swapped"),
        (changed(track, t=t / 100, vel_ned=None), "beyond the 60 m/s of a car"),
        (changed(track, vel_ned=vel * 3.6), "positions and velocities disagree"),
        (changed(track, llh=llh + np.array([1.2, 0, 0])), "latitude of 1.* deg; are latitude and longitude swapped"),
    ]
    for bad, message in cases:
        with pytest.raises(InputError, match=message):
            smooth_track(bad)


def test_headings_tell_swapped_coordinates():
    truth = built_in("urban_drive_1").path
    pose = truth.sample(np.arange(60.0, 360.0, 0.5))
    track = Track(pose.t, pose.llh, None, pose.rpy)
    assert smooth_track(track).warnings == ()
    with pytest.raises(InputError, match="headings fit the way only with latitude and longitude swapped"):
        smooth_track(Track(pose.t, pose.llh[:, [1, 0, 2]], None, pose.rpy))


def test_tracks_that_look_odd_are_warned_about():
    t = np.arange(0.0, 120.0)
    hill = earth.move(np.array([0.8, 0.2, 500.0]), np.stack([10 * t, 0 * t, -1.5 * t], axis=1))
    assert smooth_track(Track(t, hill)).warnings == ()
    steep = smooth_track(Track(t, hill * [1, 1, 1 / 0.3048])).warnings
    assert len(steep) == 1 and "steeper than any road: heights in feet by the look of it" in steep[0]
    track = some_track(name="helicopter_mapping", velocity=True)
    feet = track.llh * np.array([1, 1, 1 / 0.3048])
    assert "feet by the look of it" in smooth_track(changed(track, llh=feet), "helicopter").warnings[0]
    assert "wrong sign" in smooth_track(changed(track, vel_ned=track.vel_ned * [1, 1, -1]), "helicopter").warnings[0]
    high = track.llh + np.array([0, 0, 7000.0])
    assert "a car at" in smooth_track(changed(track, llh=high, vel_ned=None), "car").warnings[0]
    assert smooth_track(track, "helicopter").warnings == ()


def test_track_files(tmp_path):
    track = some_track()
    file = tmp_path / "track.csv"
    deg = np.rad2deg(track.llh[:, :2])
    rows = np.column_stack([track.t, deg, track.llh[:, 2] / 0.3048, track.vel_ned])
    header = "time [s],lat,lon,height [ft],vn,ve,vd"
    np.savetxt(file, rows, delimiter=",", header=header, comments="", fmt="%.12g")
    back = read_track(file)
    np.testing.assert_allclose(earth.position_difference(back.llh, track.llh), 0, atol=1e-3)
    np.testing.assert_allclose(back.vel_ned, track.vel_ned, atol=1e-9)
    made = load_flight(MotionSource(track=file))
    assert made.track is not None and made.flight.path.duration == pytest.approx(299.5)
    rows = [f"2026-05-03T08:00:{k:02d}Z;{46.5 + 1e-4 * k};7.25;{400 + k};9" for k in range(20)]
    file.write_text("\n".join(["UTC;Latitude;Longitude;Altitude MSL (m);Sats", *rows]))  # a logger's own names
    logged = read_track(file)
    np.testing.assert_allclose(logged.llh[:, 2], 400 + np.arange(20))
    np.testing.assert_allclose(np.diff(logged.t), 1.0)
    file.write_text("t,lat,lon,hight\n0,1,2,3\n")
    with pytest.raises(InputError, match=r"track.csv:1: unknown column 'hight'.*'height'"):
        read_track(file)
    file.write_text("t,lat,lon,height\n0,1,2,3\n1,1,two,3\n")
    with pytest.raises(InputError, match=r"track.csv:3: found 'two' for lon"):
        read_track(file)
    file.write_text("t,lat,lon,height\n0,1,2,3\n1,1,2,nan\n")
    with pytest.raises(InputError, match=r"track.csv:3: found 'nan' for height"):
        read_track(file)
    file.write_text("# made by hand\nt,lat,lon,height\n0,1,2,3\n0,1,2,3\n")
    with pytest.raises(InputError, match=r"track.csv:4: the time repeats"):
        read_track(file)


def test_recorded_drive_held_out_third():
    """Acceptance: a held-out third of the fixes lies within 0.1 m (median) of the path smoothed from the rest."""
    recording = read_recording(shared("real/rtkexp_drive.npz"))
    track = Track.of(recording.gnss, "rtkexp_drive")
    distance = held_out_distance(track)
    assert distance.size > 700
    assert np.median(distance) <= 0.1
    made = smooth_track(track)
    assert made.warnings == ()
    path = made.path
    t = np.arange(path.start, path.end, 0.05)
    k = path.kinematics(t)
    assert np.hypot(k.vel_ned[:, 0], k.vel_ned[:, 1]).max() < 20
    assert np.abs(turn_rate(path, t)).max() < np.deg2rad(60)
    assert np.abs(k.acc_ned).max() < 6
    ideal = ideal_imu(path)
    error = navigation_error(ideal)
    assert np.linalg.norm(error[:, :3], axis=1).max() <= 1e-6 and np.abs(error[:, 6:]).max() <= 1e-9


# -- limits of size
# ----------------------------------------------------------------------------------------------------------------------

START = "ini lat,lon,alt,vx,vy,vz,yaw,pitch,roll\n32,120,0,0,0,0,0,0,0\ncommand type,yaw,pitch,roll,vx,vy,vz,duration,visible\n"


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("1,0,0,0,1e-9,0,0,1e12,1", r"asks for 4e\+13 samples, about 6e\+07 GB"),
        ("3,0,0,0,1e300,0,0,10,1", "a velocity beyond 10000 m/s"),
        ("1,1e9,0,0,0,0,0,10,1", "more than 3183 revolutions"),
    ],
)
def test_motion_that_no_machine_holds_is_refused_with_an_estimate(tmp_path, row, message):
    file = tmp_path / "motion.csv"
    file.write_text(START + row + "\n")
    with pytest.raises(InputError, match=message):
        load_flight(MotionSource(motion=file))


def test_sizes_are_checked_before_work_begins(tmp_path):
    flight = load_flight(MotionSource(builtin="static")).flight
    with pytest.raises(InputError, match=r"1200 s at 1e\+09 Hz asks for 1.2e\+12 samples"):
        ideal_imu(flight, 1e9)
    ideal = ideal_imu(flight, 1.0)
    rng = np.random.default_rng(1)
    with pytest.raises(InputError, match="fixes at 1e\\+12 Hz asks for"):
        gnss_fixes(ideal.reference, 1e12, rng=rng)
    with pytest.raises(InputError, match="a lever arm of 1e\\+05 m is implausible"):
        gnss_fixes(ideal.reference, lever_arm=(1e5, 0, 0), rng=rng)
    with pytest.raises(InputError, match=r"lever_arm is .* implausible"):
        Mounting(lever_arm=(0, 2000.0, 0))
    with pytest.raises(InputError, match="outages per hour"):
        random_outages(0.0, 3600.0, per_hour=1e9, mean_s=1.0, rng=rng)
    t = np.arange(9.0)
    llh = np.column_stack([0.8 + 1e-7 * t, np.full(9, 0.1), np.full(9, 100.0)])
    with pytest.raises(InputError, match="asks for"):
        smooth_track(Track(t, llh), spacing_s=1e-12)


def test_headings_may_name_units_in_two_ways(tmp_path):
    for heading in ("speed [km/h]", "speed_kmh", "speed (km/h)", "SPEED_kph"):
        file = tmp_path / "way.csv"
        file.write_text(f"lat,lon,{heading}\n46,7,36\n46.01,7,36\n")
        np.testing.assert_allclose(read_waypoints(file).speed, 10.0)
    file.write_text("lat,lon," + "[(" * 5000 + "\n46,7,36\n")
    with pytest.raises(InputError, match=r"way.csv:1: unknown column"):
        read_waypoints(file)


def test_a_table_at_rest_lasts_as_long_as_asked_and_a_file_that_is_shorter_is_refused(tmp_path) -> None:
    assert load_flight(MotionSource(builtin="static", duration_s=2400.0)).flight.path.duration == 2400.0
    assert load_flight(MotionSource(builtin="helicopter_mapping", duration_s=1200.0)).flight.path.duration == 1200.0
    file = tmp_path / "motion.csv"
    file.write_text(START + "1,0,0,0,0,0,0,20,1\n")
    assert load_flight(MotionSource(motion=file, duration_s=20.0)).flight.path.duration == 20.0
    with pytest.raises(InputError, match=r"motion.csv: the motion ends after 20 s, but a duration of 40 s"):
        load_flight(MotionSource(motion=file, duration_s=40.0))
