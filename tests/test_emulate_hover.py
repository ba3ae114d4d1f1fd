"""Waypoints of an aircraft that hovers: waits, climbs on the spot, turns back, flies with any heading."""

from __future__ import annotations

import numpy as np
import pytest

from insemu import earth
from insemu.emulate import Waypoints, ideal_imu, navigation_error, read_waypoints, route
from insemu.emulate.vehicle import VEHICLES
from insemu.errors import InputError

ORIGIN = np.array([np.deg2rad(46.5), np.deg2rad(6.6), 400.0])
V = VEHICLES["multirotor"]


def flown(shape, speed=5.0, heading=None, hover=None):
    places = earth.move(ORIGIN, np.asarray(shape, dtype=float))
    degrees = None if heading is None else np.deg2rad(heading)
    made = route(Waypoints(places, speed, "way", degrees, None if hover is None else np.array(hover)), "multirotor")
    t = np.arange(made.flight.path.start, made.flight.path.end, 0.02)
    return made, places, t, made.flight.path.kinematics(t)


def leg(made, name):
    return next(x for x in made.flight.legs if x.name == name)


def test_it_climbs_on_the_spot_waits_and_turns_back():
    shape = [[0, 0, 0], [0, 0, -20], [60, 0, -20], [5, 0, -20], [5, 0, 0]]  # north, east, down
    made, places, _, k = flown(shape, hover=[0, 8, 0, 0, 0])
    path = made.flight.path
    assert made.warnings == ()
    up, wait = leg(made, "leg 1"), leg(made, "hover 2")
    middle = path.kinematics(np.linspace(up.start_s, up.end_s, 50))
    assert np.abs(middle.vel_ned[:, :2]).max() < 1e-9
    assert middle.vel_ned[:, 2].min() == pytest.approx(-5.0, abs=1e-3)
    assert wait.end_s - wait.start_s == pytest.approx(8.0)
    still = path.kinematics(np.linspace(wait.start_s + 0.1, wait.end_s - 0.1, 50))
    assert np.abs(still.vel_ned).max() < 1e-6
    assert np.ptp(still.rpy, axis=0).max() < 1e-6
    for place in places:
        assert np.linalg.norm(earth.position_difference(k.llh, place), axis=1).min() < 0.02
    assert np.abs(earth.position_difference(path.llh([path.end]), places[-1])).max() < 1e-3
    back = leg(made, "leg 3")  # the nose turned by half a circle on the spot
    assert abs(np.cos(path.rpy([0.5 * (back.start_s + back.end_s)])[0, 2]) + 1.0) < 1e-9


def test_the_heading_is_independent_of_the_course_and_the_tilt_is_not():
    made, _, t, k = flown([[0, 0, 0], [80, 0, 0]], heading=[90.0, 90.0])
    assert np.abs(k.rpy[:, 2] - np.pi / 2).max() < 1e-9
    assert np.abs(k.rpy[:, 1]).max() < 1e-6  # east is ahead, so the flight north is a roll to the left and nothing else
    start = leg(made, "leg 1").start_s
    early = (t > start + 0.5) & (t < start + 2.0)
    assert k.rpy[early, 0].max() < -0.05
    turning, _, _, kt = flown([[0, 0, 0], [80, 0, 0]], heading=[0.0, 180.0])
    assert kt.rpy[-1, 2] == pytest.approx(-np.pi) or kt.rpy[-1, 2] == pytest.approx(np.pi)
    straight = leg(turning, "leg 1")
    assert turning.flight.path.rpy([0.5 * (straight.start_s + straight.end_s)])[0, 2] % np.pi == pytest.approx(
        np.pi / 2
    )


@pytest.mark.parametrize("size", [0.5, 8.0, 300.0])
def test_every_leg_keeps_to_the_limits_of_the_vehicle(size):
    shape = size * np.array([[0, 0, 0], [1, 0, -0.3], [0, 0.02, -0.3], [0.6, 0.7, 0.1]])
    _, _, t, k = flown(shape, speed=20.0, heading=[0, 170, np.nan, -90])
    assert np.linalg.norm(k.vel_ned, axis=1).max() <= 20.0 * 1.001
    assert np.abs(k.vel_ned[:, 2]).max() <= V.max_climb * 1.001
    assert np.linalg.norm(k.acc_ned, axis=1).max() <= V.max_acceleration
    assert np.abs(np.gradient(np.unwrap(k.rpy[:, 2]), t)).max() <= V.max_turn_rate
    assert np.abs(np.diff(k.acc_ned, axis=0)).max() < 0.4  # no step of the acceleration


def test_a_turn_back_alone_makes_it_stop_and_a_plain_route_does_not():
    back, *_ = flown([[0, 0, 0], [60, 0, 0], [5, 1, 0]])
    at = leg(back, "leg 1").end_s
    assert np.abs(back.flight.path.vel_ned([at])).max() < 1e-6
    plain, *_ = flown([[0, 0, 0], [60, 0, 0], [60, 60, 0]])
    assert np.abs(plain.flight.path.vel_ned([leg(plain, "leg 1").end_s])).max() > 1.0


def test_a_steep_leg_is_slowed_down_and_says_so():
    made, *_ = flown([[0, 0, 0], [0, 0, -60]], speed=12.0)
    assert made.warnings == ("way: the leg from waypoint 1 is flown at 6 m/s, a multirotor climbs at 6 m/s",)


def test_its_ideal_imu_navigates_to_the_same_place():
    made, *_ = flown([[0, 0, 0], [0, 0, -15], [40, 0, -15], [4, 0, -15]], heading=[0, 90, 200, 10], hover=[2, 0, 3, 0])
    ideal = ideal_imu(made.flight.path, 100.0)
    assert np.abs(navigation_error(ideal)).max() < 1e-9


def test_columns_of_a_file_and_what_is_refused(tmp_path):
    file = tmp_path / "way.csv"
    file.write_text(
        "lat, lon, height [m], speed, heading [deg], hover [s]\n46.5,6.6,400,5,90,3\n46.5,6.6,420,5,nan,0\n"
    )
    read = read_waypoints(file)
    np.testing.assert_allclose(read.hover, [3.0, 0.0])
    np.testing.assert_allclose(read.heading, [np.pi / 2, np.nan])
    assert [x.name for x in route(read, "multirotor").flight.legs] == [
        "rest at the start", "hover 1", "leg 1", "rest at the end",
    ]  # fmt: skip
    with pytest.raises(InputError, match="heading and hover are for a multirotor or helicopter, found a car"):
        route(read, "car")
    places = earth.move(ORIGIN, np.zeros((2, 3)))
    with pytest.raises(InputError, match="neither a leg nor a hover"):
        route(Waypoints(places, 5.0, "way"), "multirotor")
    with pytest.raises(InputError, match="asks for 90 m/s"):
        route(Waypoints(places, 90.0, "way"), "multirotor")
    with pytest.raises(InputError, match="a hover is -1 s"):
        Waypoints(places, 5.0, "way", None, np.array([0.0, -1.0]))
