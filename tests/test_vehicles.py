"""Vehicles that move about their path: spectra, physics of the presets, sideslip, the sensor's sampling; against closed forms."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy.signal import csd, welch

from insemu import earth
from insemu.emulate import (
    VEHICLES,
    Mounting,
    Moving,
    SmoothPath,
    built_in,
    dynamics,
    ideal_imu,
    navigation_error,
    preset_file,
    presets,
    read_vehicle,
)
from insemu.emulate.dynamics import Levels, Line, MotionSpectrum, Regime, physics, slip
from insemu.emulate.flight import origin_at
from insemu.emulate.waypoints import Waypoints, route
from insemu.errors import InputError
from insemu.evaluate import Experiment, Resources, run_experiment
from insemu.records import Sampling
from insemu.scenario import load
from insemu.units import STANDARD_GRAVITY as G
from tests.budget import chi_square, chi_square_power, statistical

NONE = np.tile(np.eye(6, dtype=complex), (2, 1, 1))


def straight(speed=10.0, seconds=600.0, height=400.0):
    t = np.linspace(0.0, seconds, 9)
    velocity, rpy = np.zeros((2, 9, 3))
    velocity[:, 0] = speed
    return SmoothPath.from_velocity(t, velocity, rpy, origin_at(46.0, 7.0, height), "straight")


def lines(*rows, rate=1.0):
    """A spectrum of lines alone: amplitude, phase."""
    quiet = Regime("all", np.full((2, 6), 1e-30), NONE)
    made = tuple(Line(f"{k}", 1.0, {"*": a}, p, rate=rate) for k, (a, p) in enumerate(rows))
    return MotionSpectrum(np.array([0.2, 50.0]), (quiet,), made)


def felt(path, rate=200.0, **options):
    imu = ideal_imu(path, rate, mode="continuous", kind="sample", **options).imu
    return imu.t, np.hstack([imu.gyro, imu.accel])


@pytest.fixture(scope="module")
def coloured():
    """Coherent noise, six axes, six sources with their own phases."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(6, 6)) + 1j * rng.normal(size=(6, 6))
    full = root @ np.conj(root.T)
    size = np.sqrt(np.diag(full).real)
    coherence = np.tile(full / np.outer(size, size), (2, 1, 1))
    density = np.tile(np.r_[1.0, 1.2, 1.4, 1e3, 2e3, 3e3] * 1e-5, (2, 1))
    return Regime("all", density, coherence)


@pytest.fixture(scope="module")
def shaken(coloured):
    spectrum = MotionSpectrum(np.array([0.25, 60.0]), (coloured,))
    return felt(dynamics.shaken(straight(), spectrum, 3))


@statistical(1e-6, 24, power=1.0)  # twice a density is 50 standard deviations off
def test_densities_come_back_as_a_perfect_imu_feels_them(shaken, coloured):
    """600 s of a band of B Hz: B 600 pairs of squares, so five deviations of the mean are 5 / sqrt(600 B)."""
    _, x = shaken
    for k in range(6):
        f, found = welch(x[:, k], 200.0, nperseg=4096)
        for low, high in ((0.5, 2.0), (2.0, 8.0), (8.0, 30.0), (30.0, 55.0)):
            inside = (f > low) & (f < high)
            # Hann windows leak, splines' images add 1.2 per cent of the amplitude at the top
            allowed = 5.0 / np.sqrt(600.0 * (high - low)) + 0.02
            assert found[inside].mean() / coloured.density[0, k] == pytest.approx(1.0, abs=allowed)


@statistical(1e-6, 15, power=1.0)  # phases of the wrong sign are 0.5 off
def test_coherences_come_back_with_their_phases(shaken, coloured):
    _, x = shaken
    for i in range(6):
        for j in range(i + 1, 6):
            f, cross = csd(x[:, j], x[:, i], 200.0, nperseg=4096)
            own = welch(x[:, [i, j]], 200.0, nperseg=4096, axis=0)[1]
            inside = (f > 1.0) & (f < 50.0)
            found = (cross / np.sqrt(own.prod(axis=1)))[inside].mean()
            assert abs(found - coloured.coherence[0, i, j]) < 6.0 / np.sqrt(600.0 * 49.0) + 0.01


def test_the_truth_is_one_motion(coloured):
    """Exact increments integrate to the reference to rounding; the motion is the same in any order, in pieces, in another process."""
    path = dynamics.shaken(straight(seconds=60.0), MotionSpectrum(np.array([0.5, 40.0]), (coloured,)), 7)
    ideal = ideal_imu(path, 200.0)
    assert np.abs(navigation_error(ideal)).max() < 1e-9
    # the mechanization adds velocities by the trapezoid: a relative (w dt)^2 / 12 of the displacement at the top of the band, 10 mm
    assert ideal.path_distance_m < 1e-4
    t = np.linspace(0.0, 60.0, 4001)
    whole = np.hstack([path.position(t), path.attitude(t)])
    other = pickle.loads(pickle.dumps(path))
    order = np.random.default_rng(0).permutation(t.size)
    assert np.array_equal(np.hstack([other.position(t[order]), other.attitude(t[order])]), whole[order])
    # derivatives are those of the same curve
    h = 1e-4
    at = t[100:-100]
    slope = (path.position(at + h) - path.position(at - h)) / (2.0 * h)
    assert np.abs(slope - path.position(at, 1)).max() < 1e-5
    assert not np.array_equal(
        dynamics.shaken(straight(seconds=60.0), path.position.motion.spectrum, 8).position(t), whole[:, :3]
    )


def test_a_sine_rectifies_cones_and_sculls_as_theory_says():
    """A square averages A^2/2; angles a, b a quarter turn apart give w a b / 2 about the third axis; force in phase with an angle gives F a / 2."""
    f, w = 5.0, 10.0 * np.pi
    t, x = felt(dynamics.shaken(straight(0.0, 30.0), lines(((0.0,) * 5 + (2.0,), (0.0,) * 6), rate=f), 1), 1000.0)
    inside = (t > 2.0) & (t <= 28.0)  # whole periods
    down = x[inside, 5] - x[inside, 5].mean()
    assert np.mean(down**2) == pytest.approx(2.0, rel=0.01)
    a, b = 0.05, 0.04  # rad
    cone = lines(((a * w, b * w, 0.0, 0.0, 0.0, 0.0), (0.0, 0.5 * np.pi, 0.0, 0.0, 0.0, 0.0)), rate=f)
    t, x = felt(dynamics.shaken(straight(0.0, 30.0), cone, 1), 1000.0)
    still = felt(straight(0.0, 30.0), 1000.0)[1]
    drift = (x - still)[inside, 2].mean()
    # roll a cos u, pitch a cos(u + pi/2), heading untouched: the body's z axis turns by the area
    assert abs(drift) == pytest.approx(0.5 * w * a * b, rel=0.01)
    force = 3.0
    scull = lines(((0.0, b * w, 0.0, force, 0.0, 0.0), (0.0, 0.5 * np.pi, 0.0, 0.0, 0.0, 0.0)), rate=f)
    t, x = felt(dynamics.shaken(straight(0.0, 30.0), scull, 1), 1000.0)
    # the specific force holds g times the pitch; what moves is the rest, and 1 - b^2/4 of gravity stays on z
    moved = force - G * b
    assert (x - still)[inside, 5].mean() == pytest.approx(0.5 * moved * b + 0.25 * G * b**2, rel=0.01)


def seen(loud, speed, bands=1):
    """Levels of rows that are loud (ten times) or not in every axis, at speeds m/s."""
    edges = np.geomspace(1.0, 16.0, bands + 1)
    motion = np.stack([speed, 0.0 * speed, 0.0 * speed], axis=1)
    log = np.log(1e-4) + np.log(10.0) * np.tile(loud[:, None, None], (1, 6, bands))
    return Levels(edges, 2.0, motion, log, np.arange(loud.size) == 0)


def test_levels_are_drawn_where_the_vehicle_moves_so_and_go_on_as_they_did():
    loud = np.repeat(np.tile([0.0, 1.0], 10), 5)
    loud[:50] = 0.5 * loud[:50]  # half as loud while it stands
    levels = seen(loud, np.repeat([0.0, 10.0], 50))
    motion = np.zeros((400, 3))
    motion[200:, 0] = 10.5
    drawn = np.log10(levels.drawn(motion, np.random.default_rng(1)) / 1e-4)
    assert np.ptp(drawn, axis=1).max() < 1e-9  # all axes together
    still, moving = drawn[:200, 0], drawn[200:, 0]
    assert set(np.round(still, 6)) == {0.0, 0.5} and set(np.round(moving, 6)) == {0.0, 1.0}
    for x in (still, moving):
        assert 0.35 < np.mean(x > 0.1) < 0.65  # rows are used evenly
        assert (
            np.mean(np.diff(x) == 0.0) > 0.65
        )  # loud and quiet last for five rows, of independent ones half would be equal


@statistical(1e-6, 12, power=1.0)  # ten times a density is hundreds of standard deviations off
def test_levels_say_how_loud_the_bands_are(coloured):
    speed = np.full(8, 10.0)
    levels = replace(
        seen(np.zeros(8), speed, 2), log=np.log(np.outer([1, 1, 1, 9, 9, 9], [1e-6, 1e-7]))[None] + np.zeros((8, 1, 1))
    )
    spectrum = MotionSpectrum(np.array([0.5, 40.0]), (coloured,), levels=levels)
    _, x = felt(dynamics.shaken(straight(), spectrum, 2))
    f, density = welch(x, 200.0, nperseg=4000, axis=0)
    for k, (low, high) in enumerate(((1.0, 4.0), (4.0, 16.0))):
        inside = (f >= low) & (f < high)
        # bins times averages, a share of them independent; densities fall by a factor of a few inside of a band
        sigma = np.sqrt(8.0 / (inside.sum() * 60))
        found = density[inside].mean(axis=0) / np.exp(levels.log[0, :, k])
        assert np.abs(found - 1.0).max() < 5.1 * sigma + 0.03, found


def test_a_tilt_shows_gravity_and_an_arm_its_lever():
    """A slow pitch alone: stated specific force zero means that the body moves so that gravity is not felt; another place feels the rigid body."""
    w = 2.0 * np.pi * 0.5
    pitching = dynamics.shaken(straight(0.0, 60.0), lines(((0.0, 0.01, 0.0, 0.0, 0.0, 0.0), (0.0,) * 6), rate=0.5), 2)
    _, x = felt(pitching, 100.0)
    inside = slice(500, -500)
    assert np.abs(x[inside, 3]).max() < 1e-3 * G * 0.01 / w + 2e-5
    moved = felt(pitching, 100.0, mounting=Mounting((2.0, 0.0, 0.0)))[1]
    # 2 m ahead: the nose goes up with w times the rate
    assert (moved - x)[inside, 5].std() * np.sqrt(2.0) == pytest.approx(2.0 * 0.01 * w, rel=0.01)


@pytest.mark.parametrize("average", ["interval", "instant"])
@pytest.mark.parametrize("bandwidth", [None, 20.0])
@pytest.mark.parametrize("rate", [100.0, 50.0])
def test_a_sensor_samples_as_it_says(average, bandwidth, rate):
    """A line of 30 Hz: the average is its sinc, the low-pass Butterworth's; at 50 Hz it shows at 20 Hz."""
    path = dynamics.shaken(straight(0.0, 20.0), lines(((0.0,) * 5 + (1.0,), (0.0,) * 6), rate=30.0), 1)
    sampling = Sampling(average, bandwidth)
    t, x = felt(path, rate, sampling=sampling)
    inside = slice(int(5 * rate), -int(5 * rate))
    seen = 30.0 if rate == 100.0 else 20.0
    wave = x[inside, 5] - x[inside, 5].mean()
    found = 2.0 * abs(np.mean(wave * np.exp(-2j * np.pi * seen * t[inside])))
    expected = (np.sinc(30.0 / rate) if average == "interval" else 1.0) / np.sqrt(
        1.0 + (30.0 / bandwidth) ** 4 if bandwidth else 1.0
    )
    assert found == pytest.approx(expected, rel=0.01)


def test_an_average_lies_before_at_or_behind_its_stamp():
    path = dynamics.shaken(straight(0.0, 20.0), lines(((0.0,) * 5 + (1.0,), (0.0,) * 6), rate=2.0), 1)
    phase = {}
    for stamp in ("start", "middle", "end"):
        t, x = felt(path, 100.0, sampling=Sampling("interval", None, stamp))
        wave = x[500:-500, 5]
        phase[stamp] = np.angle(np.mean((wave - wave.mean()) * np.exp(-4j * np.pi * t[500:-500])))
    late = {k: (phase["middle"] - v) / (4.0 * np.pi) for k, v in phase.items()}
    assert late["end"] == pytest.approx(0.005, abs=5e-5)
    assert late["start"] == pytest.approx(-0.005, abs=5e-5)


def test_a_road_is_what_its_class_says_and_pitch_follows_heave():
    """Rigid axles repeat the road: heave has no power where the axles go against each other, f = v / (2 L); the density is Gd(n) / v."""
    numbers = {
        "roughness": "C", "body": (2000.0, 0.5), "wheel": (5000.0, 0.1), "roll": (2000.0, 0.5), "wheelbase": 3.0, "track": 1e-6,
        "height": 0.0, "through": (0.0,) * 3, "twist": (0.0,) * 3,
    }  # fmt: skip
    v = 15.0
    f = np.array([0.5, 1.0, v / 6.0, 4.0])
    terms = physics.road(f, v, numbers)
    heave = sum(d * np.abs(r[:, 5]) ** 2 for d, r in terms)
    gd = 256e-6 * (0.1 / (f / v)) ** 2 / v * np.sinc(f / v * physics.PATCH) ** 2
    assert heave == pytest.approx((2 * np.pi * f) ** 4 * gd * np.cos(np.pi * f * 3.0 / v) ** 2, rel=1e-3, abs=1e-9)
    pitch = sum(d * np.abs(r[:, 1]) ** 2 for d, r in terms)
    assert pitch == pytest.approx((2 * np.pi * f) ** 2 * gd * (2.0 / 3.0 * np.sin(np.pi * f * 3.0 / v)) ** 2, rel=1e-3)
    # a class is twice the one before in amplitude
    assert physics.ROADS["D"] / physics.ROADS["C"] == 4.0


def test_gusts_and_waves_have_the_power_that_they_are_named_for():
    f = np.geomspace(1e-5, 1e3, 200_001)
    u, across, up, _ = physics._gusts(f, 20.0, {"wind": 10.0, "height": 100.0, "span": 2.0})
    sigma_w = 1.0  # a tenth of the wind
    assert np.trapezoid(up, f) == pytest.approx(sigma_w**2, rel=1e-3)
    sigma_u = sigma_w / (0.177 + 0.000823 * 100.0 / 0.3048) ** 0.4
    assert np.trapezoid(u, f) == pytest.approx(sigma_u**2, rel=1e-3)
    assert np.trapezoid(across, f) == pytest.approx(sigma_u**2, rel=1e-3)
    f = np.linspace(1e-3, 10.0, 100_001)
    for v in (0.0, 8.0):  # the density of encounter keeps the power
        hull = {"waves": (1.2, 6.0), "length": 0.0, "heave": (1e4, 0.5), "roll": (1.0, 0.5), "wind": 0.0}
        ((density, response),) = physics.hull(f, v, hull)
        height = response[:, 5] / (2.0 * np.pi * f) ** 2
        assert 4.0 * np.sqrt(np.trapezoid(density * np.abs(height) ** 2, f)) == pytest.approx(1.2, rel=5e-3)


def test_a_wing_crabs_and_a_boat_drifts_by_the_triangle_of_velocities(monkeypatch):
    monkeypatch.setattr(slip, "AIR_SWING", 0.0)
    for kind, given, expected in (
        ("fixed_wing", slip.Slip(wind=6.0, wind_from=-0.5 * np.pi), -np.arcsin(6.0 / 25.0)),
        ("boat", slip.Slip(current=(3.0, 0.5 * np.pi)), -np.arctan(3.0 / 25.0)),
    ):
        made = dynamics.MovingVehicle("one", kind, lines(((0.0,) * 6, (0.0,) * 6)), slip=given)
        path = Moving(made, 1).on(straight(25.0, 60.0))
        found = path.rpy(np.linspace(20.0, 40.0, 50))[:, 2]
        if kind == "fixed_wing":  # over the ground it goes north at 25 m/s: through the air atan(6 / 25) to the left
            expected = -np.arctan(6.0 / 25.0)
        assert found == pytest.approx(np.full(50, expected), abs=2e-3)


def test_the_nose_of_a_multirotor_stays_on_its_target_and_its_thrust_where_it_was():
    flight = built_in("lemniscate")
    target = (flight.path.origin[0] + 4e-5, flight.path.origin[1] + 1e-4)
    made = read_vehicle(preset_file("multirotor"), {"nose": "target", "target": target, "wind": 0.0, "sigma": 0.0})
    path = Moving(replace(made, spectrum=lines(((0.0,) * 6, (0.0,) * 6))), 1).on(flight.path)
    t = np.linspace(100.0, 1000.0, 500)
    off = earth.position_difference(np.tile([*target, flight.path.origin[2]], (t.size, 1)), path.llh(t))
    turn = path.rpy(t)[:, 2] - np.arctan2(off[:, 1], off[:, 0])
    assert np.abs((turn + np.pi) % (2.0 * np.pi) - np.pi).max() < np.deg2rad(0.5)

    def down(p):
        return np.stack([np.cos(p.rpy(t)[:, 0]) * np.cos(p.rpy(t)[:, 1]), np.sin(p.rpy(t)[:, 1])], axis=1)[:, 0]

    assert down(path) == pytest.approx(down(flight.path), abs=2e-3)
    near = read_vehicle(preset_file("multirotor"), {"nose": "target", "target": tuple(flight.path.origin[:2])})
    with pytest.raises(InputError, match="m from the target of the nose"):
        Moving(near, 1).on(flight.path).rpy(np.array([500.0]))


def places(*xy):
    p = np.array(xy, dtype=float)
    return np.column_stack([0.8 + p[:, 0] / 6.37e6, 0.1 + p[:, 1] / (6.38e6 * np.cos(0.8)), np.full(len(p), 300.0)])


def test_a_car_backs_out_and_waits():
    way = Waypoints(
        places((0, 0), (60, 0), (30, 0), (130, 0), (130, 80)),
        np.array([8, -2, 8, 8, 8.0]),
        hover=np.array([0, 0, 3, 0, 0.0]),
    )
    path = route(way, "car").flight.path
    t = np.arange(path.start, path.end, 0.1)
    velocity, heading = path.vel_ned(t), path.rpy(t)[:, 2]
    ahead = velocity[:, 0] * np.cos(heading) + velocity[:, 1] * np.sin(heading)
    across = -velocity[:, 0] * np.sin(heading) + velocity[:, 1] * np.cos(heading)
    assert ahead.min() == pytest.approx(-2.0, abs=1e-3)
    assert np.abs(across).max() < 1e-3
    assert path.position(path.end)[:2] == pytest.approx([130.0, 80.0], rel=2e-3)
    stands = np.abs(ahead) < 1e-6
    assert stands[(t > 50.5) & (t < 52.5)].all()
    with pytest.raises(InputError, match=r"in reverse gear -0\.1 to -8"):
        route(replace(way, speed=np.array([8, -9, 8, 8, 8.0])), "car")
    with pytest.raises(InputError, match="would change by 90 deg on the spot"):
        route(replace(way, hover=np.array([0, 0, 0, 4, 0.0])), "car")


def test_a_vehicle_comes_back_from_its_file(tmp_path, coloured):
    made = dynamics.MovingVehicle(
        'a "car": 1', "car",
        MotionSpectrum(
            np.array([0.5, 40.0]),
            (
                replace(coloured, name="slow", speed=(0.0, 5.0), swing_sigma=0.3, density_sigma=0.1 * np.ones((2, 6))),
                replace(coloured, name="fast", speed=(5.0, np.inf), turn=(0.1, np.inf), climb=(-2.0, 2.0)),
            ),
            (Line("wheel", 1.0, {"fast": (1e-5,) * 6}, per_metre=0.5), Line("engine", 2.0, {"*": (1e-3,) * 6}, rate=13.0, wander_sigma=0.01)),
            ("yaw below 1 Hz",),
        ),
        "a recording", 1.5, slip.Slip(0.01, 3.0),
    )  # fmt: skip
    file = tmp_path / "car.yaml"
    file.write_text(dynamics.vehicle_text(made))
    back = dynamics.read_vehicle(file)
    for one, two in zip(made.spectrum.regimes, back.spectrum.regimes, strict=True):
        assert one.density == pytest.approx(two.density, rel=1e-4)
        assert np.abs(one.coherence - two.coherence).max() < 1e-4
        assert (one.name, one.speed, one.turn, one.climb, one.swing_sigma) == (
            two.name,
            two.speed,
            two.turn,
            two.climb,
            two.swing_sigma,
        )
    assert (back.name, back.spectrum.lines, back.spectrum.unknown, back.jerk) == (
        made.name,
        made.spectrum.lines,
        made.spectrum.unknown,
        1.5,
    )
    assert (back.slip.sigma, back.slip.time, back.slip.axle) == (0.01, 3.0, 0.0)
    assert dynamics.vehicle_text(back) == file.read_text()


def test_levels_come_back_from_a_file(tmp_path, coloured):
    levels = replace(
        seen(np.array([0.0, 1.0, 0.3]), np.array([0.0, 1.0, 2.5]), 2), begins=np.array([True, False, True])
    )
    spectrum = MotionSpectrum(np.array([0.5, 40.0]), (coloured,), levels=levels)
    (tmp_path / "car.yaml").write_text(dynamics.vehicle_text(dynamics.MovingVehicle("a car", "car", spectrum)))
    back = dynamics.read_vehicle(tmp_path / "car.yaml").spectrum.levels
    assert np.abs(back.log - levels.log).max() < 0.0051 * np.log(10.0)  # two digits behind the point
    assert (back.step, *back.begins) == (2.0, True, False, True)
    assert back.motion == pytest.approx(levels.motion, rel=5e-3) and back.edges == pytest.approx(levels.edges, rel=1e-4)


BROKEN = (
    ("regimes:", "regime:", ":6: regime: unknown key 'regime'"),
    ("kind: car", "kind: cart", ":2: kind: unknown vehicle 'cart'"),
    ("  - name: \"engine\"", "  - nam: \"engine\"", "unknown key 'nam'"),
    ("      gyro_x gyro_y", "      gyro_x gyro_q", "expected two of gyro_x"),
    ("    density:", "    density: 3\n    dens:", "regimes.all.dens: unknown key"),
    ("    rate: 13", "    rate: -13", "expected a positive order and one positive number"),
    ("  step: 2", "  step: 0", "levels: levels every 0.0 s, expected a positive number"),
    ("    - - [10, ", "    - - [", ":38: levels.stretches.0.0: found [0, 0, -4.0, -4.0, -4.0, -4.0, -4.0, -4.0], expected 9 numbers"),
    ("  edges: [1, 16]", "  edges: [16, 1]", "expected two or more positive numbers that increase"),
)  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), BROKEN, ids=[b[1].strip()[:12] for b in BROKEN])
def test_a_broken_file_is_refused_with_its_place(tmp_path, coloured, old, new, message):
    spectrum = MotionSpectrum(
        np.array([0.5, 40.0]),
        (coloured,),
        (Line("engine", 2.0, {"*": (1e-3,) * 6}, rate=13.0),),
        levels=seen(np.zeros(2), np.full(2, 10.0)),
    )
    text = dynamics.vehicle_text(dynamics.MovingVehicle("a car", "car", spectrum, "somewhere", 1.0, slip.SLIPS["car"]))
    assert old in text
    file = tmp_path / "car.yaml"
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        dynamics.read_vehicle(file)
    assert message in str(caught.value)
    assert "car.yaml:" in str(caught.value)


def numbers_in(value):
    if isinstance(value, dict):
        return sum(numbers_in(v) for v in value.values())
    if isinstance(value, list):
        return sum(map(numbers_in, value))
    return int(isinstance(value, int | float) or value in physics.ROADS or value in physics.RAILS)


@pytest.mark.parametrize("name", presets())
def test_a_preset_is_one_file_of_twenty_numbers_with_its_source(name):
    data = yaml.safe_load(preset_file(name).read_text())
    assert 0 < numbers_in(data) <= 20
    made = read_vehicle(preset_file(name))
    assert len(made.source) > 10
    assert made.kind in VEHICLES
    spectrum = made.spectrum
    assert all(np.isfinite(r.density).all() for r in spectrum.regimes)
    with pytest.raises(InputError, match="no part of the vehicle has the condition"):
        read_vehicle(preset_file(name), {"nonsense": 1.0})


def test_conditions_change_what_they_name():
    plain, rough = (read_vehicle(preset_file("car"), c) for c in (None, {"roughness": "D"}))
    k = next(k for k, r in enumerate(plain.spectrum.regimes) if r.name == "18 m/s")
    assert rough.spectrum.rms(k, 0.5, 2.0)[5] / plain.spectrum.rms(k, 0.5, 2.0)[5] == pytest.approx(
        4.0, rel=0.02
    )  # two classes
    assert read_vehicle(preset_file("boat"), {"current": (1.0, 0.0)}).slip.current == (1.0, 0.0)


def scenario_of(tmp_path, preset, builtin, realizations):
    text = f"""
title: matched
question: does the filter know its error on a vehicle that moves?
seed: 11
realizations: {realizations}
trajectory: {{builtin: {builtin}, rate: 100 Hz, duration: 4 min, vehicle: {{preset: {preset}, seed: 3}}}}
truth:
  gyro: WN(N=0.05 deg/s/sqrt(Hz)) + GM(sigma=0.05 deg/s, Tc=100 s)
  accel: WN(N=1 mg/sqrt(Hz)) + GM(sigma=2 mg, Tc=100 s)
gnss: {{rate: 1 Hz, position_sigma: 5 cm, velocity_sigma: 5 cm/s, outages: [{{start: 150 s, duration: 30 s}}]}}
designs:
  matched: {{gyro: {{truth: true}}, accel: {{truth: true}}}}
"""
    file = tmp_path / f"{preset}.yaml"
    file.write_text(text)
    return file


#: Chance that a matched filter fails one of these tests.
MATCHED = 5e-6


def assert_matched(tmp_path, preset, builtin, runs):
    """NEES of the nine navigation errors at four times, one of them the end of an outage, and NIS of all fixes, inside exact bounds."""
    file = scenario_of(tmp_path, preset, builtin, runs)
    results = run_experiment(Experiment(load(file), file), resources=Resources(workers=1))
    at = np.searchsorted(results.t, [60.0, 120.0, 180.0, 238.0])
    assert results.total.count == runs  # means over all of them, of which results keep a few
    means = results.total.mean("nees", 0)[at] / 9.0
    low, high = chi_square(9 * runs, MATCHED, 5)
    assert ((low < means) & (means < high)).all(), means
    nis, dof = (float(results.total.runs[key][0].sum()) for key in ("nis", "dof"))
    low, high = chi_square(dof, MATCHED, 5)
    assert low < nis / dof < high, (nis / dof, dof)
    return results


@pytest.mark.parametrize(("preset", "builtin"), [("car", "urban_drive_1"), ("multirotor", "lemniscate")])
@statistical(MATCHED, 5, power=chi_square_power(54, MATCHED, 5, 4.0))  # twice the errors
def test_a_matched_filter_stays_matched(tmp_path, preset, builtin):
    assert_matched(tmp_path, preset, builtin, 6)


@pytest.mark.slow(reason="sixty runs of each of ten vehicles")
@pytest.mark.parametrize("preset", presets())
@statistical(MATCHED, 5, power=chi_square_power(540, MATCHED, 5, 1.69))  # 1.3 times the errors
def test_matched_filters_stay_matched_on_every_preset(tmp_path, preset):
    builtin = {"fixed_wing": "turbulent_uav", "multirotor": "lemniscate", "helicopter": "helicopter_mapping"}.get(
        preset, "urban_drive_1"
    )
    results = assert_matched(tmp_path, preset, builtin, 60)
    print(
        f"\n{preset}: NEES/9 {results.total.mean('nees', 0).mean() / 9.0:.3f}, NIS {float(results.nis[0].mean()):.4f}"
    )
