"""States generated from beliefs."""

from dataclasses import replace

import numpy as np
import pytest

from insemu.augment import TURN_ON, Extras, StateLayout, augment, per_axis, true_states, with_turn_on
from insemu.errors import InputError
from insemu.noise import AR, AR1, DR, GM, QN, RC, RW, WN, Follows, NoiseModel
from insemu.records import AXES, ImuRecord
from tests import filter_cases as cases

DT = 0.01


def test_states_stand_axis_by_axis_after_the_navigation_states():
    a = augment({"gyro": WN(N=1e-4) + GM(sigma=1e-4, beta=0.1), "accel": 2 * GM(sigma=1e-3, beta=0.1) + WN(N=1e-3)}, DT)
    assert a.layout.n == 9 + 3 + 6
    assert a.layout["gyro_z"] == slice(11, 12)
    assert a.layout["accel_x"] == slice(12, 14)
    assert a.layout.names[12:14] == ("accel_x.GM1", "accel_x.GM2")
    assert a.layout.imu == slice(9, 18)
    assert a.layout.index("accel_z.GM2") == 17
    assert a.white == pytest.approx([1e-8 / DT] * 3 + [1e-6 / DT] * 3)


def test_one_axis_overrides_its_triad_and_absent_axes_are_free_of_error():
    models = per_axis({"gyro_y": WN(N=3.0), "gyro": WN(N=1.0)})
    assert models["gyro_x"] == NoiseModel((WN(N=1.0),))
    assert models["gyro_y"] == NoiseModel((WN(N=3.0),))
    assert len(models["accel_x"]) == 0


@pytest.mark.parametrize(
    "model",
    [
        GM(sigma=2.0, beta=0.3) + GM(sigma=1.0, beta=30.0),
        AR((2.564, -2.131, 0.567), sigma2=1.0, rate_hz=100.0).stabilised(0.9995) + GM(sigma=1.0, beta=1.0),
        AR((1.5, -0.8, 0.1), sigma2=1.0, rate_hz=100.0) + WN(N=0.1),
        AR((0.9, -0.95), sigma2=1.0, rate_hz=100.0) + AR((1.2, -0.9, 0.3, -0.2, 0.05), sigma2=0.5, rate_hz=100.0),
        AR((-0.5,), sigma2=1.0, rate_hz=100.0) + QN(Q=0.01),
    ],
    ids=str,
)
def test_the_states_of_an_axis_have_the_autocovariance_of_its_model(model):
    a = augment({"gyro_x": model}, DT)
    lags = np.array([0, 1, 2, 3, 7, 50, 400])
    got = [a.c @ np.linalg.matrix_power(a.Phi, lag) @ a.P0 @ a.c for lag in lags]
    got[0] += a.white[0]
    assert got == pytest.approx(model.autocovariance(lags, DT), rel=1e-6, abs=1e-9 * got[0])
    # and P0 is what the states settle at
    assert a.Phi @ a.P0 @ a.Phi.T + a.Q == pytest.approx(a.P0, rel=1e-6, abs=1e-9 * np.abs(a.P0).max())


def test_powers_of_the_step():
    a = augment({"gyro": RW(K=1.0, sigma0=0.5), "accel": DR(R=2.0) + GM(sigma=1.0, beta=3.0)}, DT)
    Phi, Q = a.power(3)
    assert np.linalg.matrix_power(a.Phi, 3) == pytest.approx(Phi)
    assert np.diag(Q)[:3] == pytest.approx(3 * DT)


def test_calibration_states_are_driven_by_what_is_measured():
    a = augment(
        {"gyro": RC(sigma=0.1)}, DT, Extras(gyro_scale=1e-3, accel_misalignment=1e-2, lever_arm=0.1, latency=0.02)
    )
    names = a.layout.names
    assert names[9:11] == ("gyro_x.RC1", "gyro_x.scale")
    assert ("accel_y.from_x" in names, "accel_y.from_z" in names, "accel_y.from_y" in names) == (True, True, False)
    assert names[-4:] == ("lever_arm_x", "lever_arm_y", "lever_arm_z", "latency")
    C = a.output([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    assert C[1, a.layout.index("gyro_y.scale") - 9] == 2.0
    assert C[4, a.layout.index("accel_y.from_z") - 9] == 6.0
    assert not C[:, -4:].any()
    with pytest.raises(InputError, match="give the measured"):
        a.output()


@pytest.mark.parametrize(
    ("belief", "message"),
    [
        ({"gyro_w": WN(N=1.0)}, "unknown axis 'gyro_w'.*did you mean"),
        ({"gyro": 3.0}, "expected a noise model"),
        ({"accel": GM()}, "no value for sigma"),
        ({"accel": AR((2.582, -2.166, 0.585), sigma2=1e-9)}, "nearest stable polynomial"),
        ({"accel": AR1(0.9, 1.0, rate_hz=50.0)}, "50 Hz"),
    ],
)
def test_what_cannot_be_carried_is_refused_with_the_reason(belief, message):
    with pytest.raises(InputError, match=message):
        augment(belief, DT)


def test_bad_sizes_are_refused():
    with pytest.raises(InputError, match="positive number of seconds"):
        augment({}, 0.0)
    with pytest.raises(InputError, match="standard deviation"):
        Extras(lever_arm=-1.0)
    with pytest.raises(InputError, match="exists twice"):
        StateLayout(("a", "a"), {})
    with pytest.raises(InputError, match="did you mean 'velocity'"):
        augment({}, DT).layout["velocty"]


@pytest.mark.parametrize(
    "model",
    [
        2 * GM(sigma=1.0, beta=2.0) + WN(N=0.1) + RW(K=0.3) + RC(sigma=2.0),
        AR((2.5, -2.09, 0.58), sigma2=1.0, rate_hz=100.0).stabilised(0.99) + WN(N=1.0),
        cases.of_partial_correlations((0.999, -0.998, 0.567), sigma2=1e-6, rate_hz=100.0) + GM(sigma=1.0, beta=1.0),
        AR((1.2, -0.5, 0.1, -0.2), sigma2=2.0, rate_hz=100.0) + DR(R=0.1),
    ],
    ids=["first order", "three poles", "complex poles", "AR(4)"],
)
def test_true_states_obey_the_filters_model_and_make_the_signal(model):
    """States told from what was drawn: seen through c they are the signal, and what drives them is white with the filter's Q."""
    n = 20_000
    parts = model.simulate_components(n, DT, np.random.default_rng(1))
    x, a = true_states(model, parts, DT), augment({"gyro_x": model}, DT)
    assert len(x) == a.m
    signal = sum(p for process, p in zip(model, parts, strict=True) if not isinstance(process, WN))
    start = 4  # an AR(p) is told from p values
    np.testing.assert_allclose((a.c @ x)[start:], signal[start:], atol=1e-9 * np.abs(signal).max())
    driven = (x[:, start + 1 :] - a.Phi @ x[:, start:-1])[np.diag(a.Q) > 0]
    Q = a.Q[np.ix_(np.diag(a.Q) > 0, np.diag(a.Q) > 0)]
    sd = np.sqrt(np.diag(Q))
    assert np.abs(np.cov(driven) / np.outer(sd, sd) - Q / np.outer(sd, sd)).max() < 5 * np.sqrt(2 / n)
    quiet = (x[:, start + 1 :] - a.Phi @ x[:, start:-1])[np.diag(a.Q) == 0]
    assert np.abs(quiet).max(initial=0.0) < 1e-9 * np.abs(x[:, start:]).max()


def test_states_that_values_do_not_tell_are_not_made_up():
    model = QN(Q=1e-3) + GM(sigma=1.0, beta=1.0)
    x = true_states(model, model.simulate_components(50, DT, np.random.default_rng(1)), DT)
    assert np.isnan(x[:2]).all() and np.isfinite(x[2]).all()


def test_fits_of_several_orders_to_one_signal_are_tied_by_partial_correlations():
    """Table 2 of Quinchia et al. (2013): the AR(3) rows follow from the AR(1) rows, so their variances are of one unit and one rate."""
    for ar, sigma2, first in (
        ((2.564, -2.131, 0.567), 2.739e-13, 1.014e-10),
        ((2.565, -2.133, 0.568), 1.905e-13, 7.04e-11),
        ((2.564, -2.136, 0.572), 8.399e-12, 1.148e-9),
    ):
        k = cases.partial_correlations(ar)
        assert k[0] == pytest.approx(1.0, abs=1e-12)  # the coefficients sum to 1 as printed
        assert sigma2 == pytest.approx(first * (1 - k[1] ** 2) * (1 - k[2] ** 2), rel=0.08)
    # moved straight inwards the pole at 1 makes another sensor of it: docs/designs.md, "27AR as printed"
    moved = AR((2.564, -2.131, 0.567), sigma2=2.739e-13, rate_hz=100.0).stabilised(0.9995).block(DT).P0[0, 0]
    first = AR1(0.999, 1.014e-10, rate_hz=100.0).block(DT).P0[0, 0]
    assert np.sqrt([moved, first]) == pytest.approx([5.33e-3, 2.27e-4], rel=0.02)
    k = (0.999, -0.998, 0.567)
    process = cases.of_partial_correlations(k, sigma2=1.0, rate_hz=100.0)
    assert cases.partial_correlations(process.ar) == pytest.approx(k, rel=1e-9)
    assert process.block(DT).P0[0, 0] == pytest.approx(1.0 / np.prod(1.0 - np.array(k) ** 2), rel=1e-6)


def test_scale_factors_per_kelvin_are_driven_by_signal_and_temperature():
    extras = Extras(gyro_scale_temperature=1e-4, accel_scale_temperature=2e-4, reference_temperature=20.0)
    a = augment({"gyro": RC(sigma=0.1)}, DT, extras)
    assert a.thermal and a.layout.names[9:11] == ("gyro_x.RC1", "gyro_x.scale_temperature")
    t, gyro, accel = np.arange(3) * DT, np.arange(9.0).reshape(3, 3), 10.0 + np.arange(9.0).reshape(3, 3)
    imu = ImuRecord(t, gyro, accel, "increment", np.array([20.0, 25.0, 10.0]))
    sensed = np.hstack(a.sensed(imu))
    C = a.output(sensed[1])
    assert C[1, a.layout.index("gyro_y.scale_temperature") - 9] == 5.0 * gyro[1, 1]
    assert C[5, a.layout.index("accel_z.scale_temperature") - 9] == 5.0 * accel[1, 2]
    assert a.output(sensed[2])[0, a.layout.index("gyro_x.scale_temperature") - 9] == -10.0 * gyro[2, 0]
    with pytest.raises(InputError, match="states of the filter follow the temperature, but the IMU has none"):
        a.sensed(ImuRecord(t, gyro, accel))
    with pytest.raises(InputError, match="gyro_scale_temperature is -1"):
        Extras(gyro_scale_temperature=-1.0)


def test_places_of_states_are_found_by_name():
    layout = augment({"gyro": WN(N=1.0) + RC(sigma=1.0)}, DT, Extras(lever_arm=1.0)).layout
    assert layout.navigation == slice(0, 9)
    assert (layout.position, layout.velocity, layout.attitude) == (slice(0, 3), slice(3, 6), slice(6, 9))
    assert layout["gyro_x.RC1"] == slice(9, 10) == layout["gyro_x"]
    assert layout["lever_arm"] == slice(12, 15) and layout["lever_arm_y"] == slice(13, 14)
    assert (layout.index("pos_n"), layout.index("lever_arm_z"), layout.n) == (0, 14, 15)
    with pytest.raises(InputError, match=r"no state 'gyro_x\.RC2'.*did you mean 'gyro_x\.RC1'"):
        layout.index("gyro_x.RC2")
    with pytest.raises(InputError, match="no state or group of states 'lever'"):
        layout["lever"]
    with pytest.raises(InputError, match="the state 'b' exists twice"):
        StateLayout(("a", "b", "b"), {})


def test_a_turn_on_bias_is_a_constant_that_an_axis_begins_with():
    belief = {
        "gyro": WN(N=1.0) + RC(sigma=3.0) + GM(sigma=7.0, beta=0.1),
        "gyro_z": RC(sigma=3.0) + RW(K=1.0, sigma0=4.0),
        "accel": GM(sigma=2.0, beta=0.1),
        "accel_y": 2 * RC(sigma=1.0) + RW(K=1.0),
    }
    a = augment(belief, DT, Extras(accel_scale=1e-3, lever_arm=5.0))
    found = a.turn_on_sigma()
    assert found[[0, 1, 2, 4]] == pytest.approx([3.0, 3.0, 5.0, np.sqrt(2.0)])
    assert np.isnan(found[[3, 5]]).all()  # neither a walk from zero, nor a scale factor, nor a lever arm is one
    assert np.isnan(augment({"gyro": WN(N=1.0)}, DT).turn_on_sigma()).all()


def test_every_axis_without_an_unknown_start_gets_one():
    found = with_turn_on({"gyro": WN(N=1.0), "gyro_x": WN(N=1.0) + RC(sigma=2.0), "accel": RW(K=1.0, sigma0=1.0)})
    assert [len(found[axis]) for axis in AXES] == [2, 2, 2, 1, 1, 1]
    assert augment(found, DT).turn_on_sigma() == pytest.approx([2.0, TURN_ON["gyro"], TURN_ON["gyro"], 1.0, 1.0, 1.0])
    # a process that settles begins where it will be
    assert len(with_turn_on({"accel": GM(sigma=1.0, beta=1.0)})["accel_x"]) == 2


def test_extras_are_deviations_that_are_not_negative():
    assert Extras(reference_temperature=-40.0).reference_temperature == -40.0
    for name in ("gyro_scale", "latency", "accel_misalignment"):
        for value in (-1e-9, np.nan, np.inf):
            with pytest.raises(InputError, match=name):
                Extras(**{name: value})
    with pytest.raises(InputError, match="reference_temperature"):
        Extras(reference_temperature=np.nan)
    for dt in (-0.01, np.nan, np.inf):
        with pytest.raises(InputError, match="positive number of seconds"):
            augment({}, dt)


def test_every_calibration_state_has_its_place_driver_and_start():
    extras = Extras(1e-3, 2e-3, 3e-3, 4e-3, 5.0, 0.06, 7e-5, 8e-5)
    a = augment({"gyro": RC(sigma=0.1)}, DT, extras)
    place = {name: k for k, name in enumerate(a.layout.names[9:])}
    for k, axis in enumerate(AXES):
        triad, letter = axis.split("_")
        others = [o for o in "xyz" if o != letter]
        for state, driver, sigma in (
            (f"{axis}.scale", k, getattr(extras, f"{triad}_scale")),
            (f"{axis}.scale_temperature", 6 + k, getattr(extras, f"{triad}_scale_temperature")),
            (f"{axis}.from_{others[0]}", AXES.index(f"{triad}_{others[0]}"), getattr(extras, f"{triad}_misalignment")),
            (f"{axis}.from_{others[1]}", AXES.index(f"{triad}_{others[1]}"), getattr(extras, f"{triad}_misalignment")),
        ):
            at = place[state]
            assert (a.axis[at], a.driver[at], a.c[at]) == (k, driver, 1.0)
            assert np.sqrt(a.P0[at, at]) == pytest.approx(sigma) and a.Phi[at, at] == 1.0 and a.Q[at, at] == 0.0
        own = [n for n in a.layout.names if n.startswith(axis)]
        assert a.layout.names[a.layout[axis]] == tuple(own)
    for name, sigma in (("lever_arm_x", 5.0), ("lever_arm_z", 5.0), ("latency", 0.06)):
        at = place[name]
        assert (a.axis[at], a.driver[at], a.c[at], a.P0[at, at]) == (-1, -1, 0.0, pytest.approx(sigma**2))
    assert a.layout["latency"] == slice(a.layout.n - 1, a.layout.n)
    assert place["gyro_x.RC1"] == 0 and a.driver[0] == -1
    assert a.layout.n == 9 + a.m == 9 + 3 + 6 * 4 + 4
    # many rows at once, each with its own signal
    rows = np.arange(24.0).reshape(2, 12)
    assert a.output(rows).shape == (2, 6, a.m)
    np.testing.assert_allclose(a.output(rows)[1], a.output(rows[1]), rtol=1e-14)
    assert augment({"gyro": RC(sigma=0.1)}, DT).coefficients().tolist() == [1.0, 1.0, 1.0]


def test_axes_share_a_process_by_their_weights():
    def seen(sigma, name):
        return replace(GM(sigma=sigma, beta=0.5), shared=name)

    belief = {
        "gyro_x": WN(N=1.0) + seen(2.0, "g"),
        "gyro_y": RC(sigma=1.0) + seen(1.0, "-g"),
        "gyro_z": seen(0.0, "g"),
        "accel_x": seen(3.0, "a"),
    }
    a = augment(belief, DT)
    at = {name: k for k, name in enumerate(a.layout.names[9:])}
    x, y = at["gyro_x.GM1"], at["gyro_y.GM1"]
    for matrix in (a.P0, a.Q):
        assert matrix[x, y] == pytest.approx(-0.5 * matrix[x, x]) and matrix[y, x] == matrix[x, y]
        assert matrix[y, y] == pytest.approx(0.25 * matrix[x, x])
        assert np.count_nonzero(matrix - np.diag(np.diag(matrix))) == 2
    with pytest.raises(InputError, match="white noise that axes share has no state to carry it"):
        augment({"gyro": replace(WN(N=1.0), shared="w")}, DT)


def test_levels_that_follow_a_covariate_are_told_apart():
    law = Follows("temperature", 0.02)
    other = Follows("temperature", 0.05)
    belief = {
        "gyro_x": WN(N=1.0) + replace(WN(N=2.0), follows=law) + replace(GM(sigma=1.0, beta=1.0), follows=other),
        "accel_z": replace(GM(sigma=1.0, beta=1.0), follows=law) + RC(sigma=1.0),
    }
    a = augment(belief, DT)
    assert a.laws == (law, other)
    assert dict(zip(a.layout.names[9:], a.law_of.tolist(), strict=True)) == {
        "gyro_x.GM1": 1, "accel_z.GM1": 0, "accel_z.RC1": -1,
    }  # fmt: skip
    assert a.white_of[0] == pytest.approx([4.0 / DT, 0, 0, 0, 0, 0]) and not a.white_of[1].any()
    assert a.white == pytest.approx([1.0 / DT, 0, 0, 0, 0, 0])
    with pytest.raises(InputError, match="the budget takes noise of constant level, found a level that follows temp"):
        a.require_constant("the budget")
    plain = augment({"gyro": WN(N=1.0)}, DT)
    plain.require_constant("the budget")
    assert plain.laws == () and plain.white_of.shape == (0, 6)


def test_true_states_of_a_process_without_a_rate_are_at_the_interval():
    values = np.array([[1.0, 0.4, -0.3]])
    np.testing.assert_array_equal(true_states(NoiseModel((AR1(0.5, 1.0),)), values, 0.01), values)


def test_stationary_processes_may_begin_known_and_constants_stay_unknown() -> None:
    belief = {
        "gyro": GM(sigma=2.0, beta=0.1) + RC(sigma=3.0) + RW(K=1.0, sigma0=0.5),
        "accel": WN(N=1.0) + GM(sigma=1.0, beta=3.0),
    }
    whole, half = (augment(belief, DT, Extras(stationary_start=x)) for x in (1.0, 0.5))
    stationary = np.array([".GM" in n for n in whole.layout.names[9:]])
    assert half.P0[~stationary] == pytest.approx(whole.P0[~stationary])
    assert np.diag(half.P0)[stationary] == pytest.approx(0.25 * np.diag(whole.P0)[stationary])
    assert whole.P0[0, 0] == pytest.approx(4.0)
    assert (half.Phi == whole.Phi).all() and (half.Q == whole.Q).all()
    assert not np.diag(augment(belief, DT, Extras(stationary_start=0.0)).P0)[stationary].any()
