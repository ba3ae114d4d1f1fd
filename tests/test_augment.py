"""States generated from beliefs."""

import numpy as np
import pytest

from insemu.augment import Extras, StateLayout, augment, per_axis
from insemu.errors import InputError
from insemu.noise import AR, AR1, BI, DR, GM, QN, RC, RW, WN, NoiseModel

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
        ({"gyro": BI(B=1.0)}, "BI.approximation"),
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
