"""Every effect of the table, injected alone: deterministic ones come back by least squares, stochastic ones by
wavelet variance.
"""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, lfilter
from scipy.stats import binom

from insemu import earth, effects, rotation, units
from insemu.effects import CROSS, EFFECTS, EffectUse, join_of, lagged
from insemu.effects.stochastic import band_coefficients
from insemu.emulate import AreaOutage, built_in, corrupt, gnss_fixes, ideal_imu, random_outages
from insemu.emulate.sensor import TemperatureProfile
from insemu.errors import InputError
from insemu.noise import BI, GM, RW, WN
from insemu.records import ImuRecord, Trajectory
from insemu.variance import level1_autocovariance, model_edof, wavelet_variance
from tests.budget import binomial_power, chi_square_power, statistical

RNG = np.random.default_rng


def use(effect_id, sensor=None, **values):
    return EffectUse.from_mapping({"effect": effect_id, **({"sensor": sensor} if sensor else {}), **values})


# -- the table
# ----------------------------------------------------------------------------------------------------------------

ISSUE_IDS = (
    "white_noise random_walk gauss_markov quantization flicker ramp vibration_line vibration_band decimation_filter "
    "outliers telegraph turn_on_bias scale_factor scale_asymmetry misalignment mounting g_sensitivity temperature "
    "saturation dropped_samples imu_gnss_time_offset clock_drift gnss_noise_level gnss_correlated_noise "
    "gnss_velocity_noise lever_arm gnss_multipath_step gnss_outliers earth_rate gravity transport_rate"
).split()


def test_the_catalogue_is_complete_and_its_units_parse():
    assert set(ISSUE_IDS) <= set(EFFECTS)
    for effect in EFFECTS.values():
        assert effect.formula and effect.excitation and effect.in_filter
        for parameter in effect.parameters:
            for sensor in effect.sensors:
                units.parse_unit(effect.unit(parameter.name, sensor))
                assert effect.scale(parameter.name, sensor) > 0


def test_mappings_are_read_with_units_and_written_back():
    scale = use("scale_factor", "gyro", value=["500 ppm", 0, "0.1 %"])
    np.testing.assert_allclose(scale["value"], [5e-4, 0, 1e-3])
    assert EffectUse.from_mapping(scale.to_mapping()) == scale
    assert use("turn_on_bias", "gyro", value="1 deg/s", axes=["z"])["value"] == (0.0, 0.0, pytest.approx(np.pi / 180))
    assert use("g_sensitivity", value=2e-4)["value"] == (2e-4, 0, 0, 0, 2e-4, 0, 0, 0, 2e-4)
    assert use("imu_gnss_time_offset", offset="5 ms").sensor == "imu"


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        ({"effect": "scale_facter", "sensor": "gyro", "value": 1}, "scale_facter.*did you mean 'scale_factor'"),
        ({"sensor": "gyro"}, "key 'effect'"),
        ({"effect": "scale_factor", "value": 1e-3}, "needs the key 'sensor': gyro or accel"),
        ({"effect": "g_sensitivity", "sensor": "accel", "value": 1e-3}, "sensor 'accel', expected 'gyro'"),
        ({"effect": "scale_factor", "sensor": "gyro", "vlue": 1e-3}, "no parameter 'vlue'.*'value'"),
        ({"effect": "scale_factor", "sensor": "gyro"}, "misses its parameter 'value'"),
        ({"effect": "scale_factor", "sensor": "gyro", "value": [1, 2]}, r"found 2 value\(s\), expected one or three"),
        ({"effect": "white_noise", "sensor": "gyro", "N": -1.0}, "found -1, expected zero or more"),
        ({"effect": "turn_on_bias", "sensor": "gyro", "value": "3 mg"}, "'value': the unit 'mg' has another dimension"),
        ({"effect": "turn_on_bias", "sensor": "gyro", "value": 1.0, "axes": "u"}, "unknown axis 'u'"),
    ],
)
def test_wrong_mappings_are_named(mapping, message):
    with pytest.raises(InputError, match=message):
        EffectUse.from_mapping(mapping)


# -- deterministic effects, by least squares against their formula
# -----------------------------------------------------------------


@pytest.fixture(scope="module")
def rich():
    """Means over 10 ms of a motion that excites every term."""
    t = np.arange(20001) / 100.0
    w = 0.5 * np.stack([np.sin(0.9 * t), np.cos(1.3 * t + 1), np.sin(0.4 * t) * np.cos(2.1 * t)], axis=1)
    f = np.stack([4 * np.sin(0.7 * t), 3 * np.cos(0.5 * t), -9.8 + 5 * np.sin(1.1 * t)], axis=1)
    return ImuRecord(t, w, f, "mean")


def injected(imu, *uses, reference=None, temperature=None):
    """What the effects add to a record, (n, 6)."""
    out = corrupt(imu, None, RNG(1), effects=uses, reference=reference, temperature=temperature).imu
    return np.concatenate([out.gyro - imu.gyro, out.accel - imu.accel], axis=1)


def recovered(change, *regressors):
    return np.linalg.lstsq(np.column_stack(regressors), change, rcond=None)[0]


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
@pytest.mark.parametrize(
    ("effect_id", "key", "formula"),
    [
        ("turn_on_bias", "value", lambda s, t: np.ones_like(t)),
        ("scale_factor", "value", lambda s, t: s),
        ("scale_asymmetry", "value", lambda s, t: np.abs(s)),
        ("ramp", "R", lambda s, t: t - t[0]),
    ],
)
def test_one_number_per_axis_is_recovered(rich, sensor, effect_id, key, formula):
    value = np.array([1.0, -0.4, 0.7]) * EFFECTS[effect_id].scale(key, sensor)
    change = injected(rich, use(effect_id, sensor, **{key: list(value)}))
    first = 0 if sensor == "gyro" else 3
    for axis in range(3):
        signal = (rich.gyro if sensor == "gyro" else rich.accel)[:, axis]
        estimate = recovered(change[:, first + axis], formula(signal, rich.t))
        np.testing.assert_allclose(estimate, value[axis], rtol=0.01)
        np.testing.assert_allclose(
            change[:, first + axis], formula(signal, rich.t) * value[axis], atol=2e-2 * abs(value).max()
        )
    assert not change[:, 3 - first : 6 - first].any()  # the other sensor is left alone


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_nonlinearity_is_recovered(rich, sensor):
    k2, k3 = [1e-3, -2e-3, 3e-3], [2e-4, 1e-4, -3e-4]
    change = injected(rich, use("scale_nonlinearity", sensor, K2=k2, K3=k3))
    first = 0 if sensor == "gyro" else 3
    for axis in range(3):
        s = (rich.gyro if sensor == "gyro" else rich.accel)[:, axis]
        np.testing.assert_allclose(recovered(change[:, first + axis], s**2, s**3), [k2[axis], k3[axis]], rtol=0.01)


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_misalignment_is_recovered(rich, sensor):
    value = [1e-3, -2e-3, 3e-3, 0.5e-3, -1.5e-3, 2.5e-3]
    change = injected(rich, use("misalignment", sensor, value=value))
    first = 0 if sensor == "gyro" else 3
    s = rich.gyro if sensor == "gyro" else rich.accel
    for axis, name in enumerate("xyz"):
        others = [p for p in CROSS if p[0] == name]
        estimate = recovered(change[:, first + axis], *(s[:, "xyz".index(p[1])] for p in others))
        np.testing.assert_allclose(estimate, [value[CROSS.index(p)] for p in others], rtol=0.01)


def test_g_sensitivity_is_recovered(rich):
    matrix = np.arange(1, 10) * 1e-5
    change = injected(rich, use("g_sensitivity", value=list(matrix)))
    for axis in range(3):
        np.testing.assert_allclose(
            recovered(change[:, axis], *rich.accel.T), matrix[3 * axis : 3 * axis + 3], rtol=0.01
        )


def test_functions_of_the_truth_do_not_see_each_other(rich):
    both = injected(rich, use("scale_factor", "gyro", value=0.01), use("misalignment", "gyro", value=[0.01] * 6))
    one = injected(rich, use("scale_factor", "gyro", value=0.01)) + injected(
        rich, use("misalignment", "gyro", value=[0.01] * 6)
    )
    np.testing.assert_allclose(both, one, atol=1e-15)


def test_mounting_is_recovered(rich):
    angles = np.deg2rad([1.0, -2.0, 3.0])
    out = corrupt(rich, None, RNG(1), effects=[use("mounting", rpy=list(angles))]).imu
    for before, after in ((rich.gyro, out.gyro), (rich.accel, out.accel)):
        transposed = np.linalg.lstsq(before, after, rcond=None)[0]  # after = before C
        np.testing.assert_allclose(rotation.rpy_from_dcm(transposed), angles, rtol=0.01)


def test_temperature_polynomial_and_lag_are_recovered(rich):
    profile = TemperatureProfile((0.0, 60.0, 120.0, 200.0), (-10.0, 50.0, 20.0, 70.0))
    c = {"c1": [1e-4, 2e-4, 3e-4], "c2": [1e-6, -2e-6, 3e-6], "c3": [1e-7, 2e-7, -1e-7]}
    change = injected(rich, use("temperature", "gyro", T0=20.0, lag=15.0, **c), temperature=profile)
    # the lag by an independent route: the differential equation in small steps
    fine = np.arange(200001) / 1000.0
    temperature, element = profile.at(fine), np.empty(200001)
    element[0] = temperature[0]
    for k in range(1, fine.size):
        middle = 0.5 * (temperature[k] + temperature[k - 1])
        element[k] = middle + (element[k - 1] - middle) * np.exp(-1e-3 / 15.0)
    d = element[::10] - 20.0
    np.testing.assert_allclose(lagged(profile.at(rich.t), 0.01, 15.0) - 20.0, d, atol=1e-3)
    for axis in range(3):
        estimate = recovered(change[:, axis], d, d**2, d**3)
        np.testing.assert_allclose(estimate, [c[k][axis] for k in ("c1", "c2", "c3")], rtol=0.01)
    out = corrupt(rich, None, RNG(0), temperature=profile).imu
    np.testing.assert_allclose(out.temperature, profile.at(rich.t))


def test_vibration_line_is_recovered_and_follows_the_motion(rich):
    line = use("vibration_line", "accel", amplitude=[0.1, 0.2, 0.3], frequency=17.0, phase=0.6, rest_factor=0.25)
    speed = np.where(rich.t < 100.0, 0.0, 10.0)
    rest = np.zeros((rich.t.size, 3))
    reference = Trajectory(rich.t, rest, np.column_stack([speed, 0 * speed, 0 * speed]), rest)
    change = injected(rich, line, reference=reference)[:, 3:]
    sine, cosine = np.sin(2 * np.pi * 17.0 * rich.t), np.cos(2 * np.pi * 17.0 * rich.t)
    for rows, factor in ((rich.t < 100.0, 0.25), (rich.t >= 100.0, 1.0)):
        for axis, amplitude in enumerate((0.1, 0.2, 0.3)):
            a, b = recovered(change[rows, axis], sine[rows], cosine[rows])
            assert np.hypot(a, b) == pytest.approx(factor * amplitude, rel=0.01)
            assert np.arctan2(b, a) == pytest.approx(0.6, rel=0.01)


def test_saturation_and_quantization(rich):
    out = corrupt(rich, None, RNG(1), effects=[use("saturation", "accel", limit=[2.0, 5.0, 12.0])]).imu
    np.testing.assert_array_equal(out.accel, np.clip(rich.accel, [-2, -5, -12], [2, 5, 12]))
    coarse = corrupt(rich, None, RNG(1), effects=[use("quantization", "gyro", lsb=0.01)]).imu
    steps = coarse.gyro / 0.01
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    error = coarse.gyro - rich.gyro
    assert np.abs(error).max() <= 0.005 + 1e-12
    assert error.var() == pytest.approx(0.01**2 / 12, rel=0.02)
    # the order of the chain: bias first, then the limits of the output
    biased = [
        use("quantization", "accel", lsb=0.5),
        use("saturation", "accel", limit=2.0),
        use("turn_on_bias", "accel", value=1.0),
    ]
    both = corrupt(rich, None, RNG(1), effects=biased).imu
    np.testing.assert_allclose(both.accel, np.round(np.clip(rich.accel + 1.0, -2, 2) / 0.5) * 0.5)


def test_decimation_filter_delays_and_attenuates(rich):
    t = rich.t
    w = np.sin(2 * np.pi * 2.0 * t)[:, None] * np.ones(3)
    record = ImuRecord(t, w, rich.accel, "mean")
    averaged = corrupt(record, None, RNG(0), effects=[use("decimation_filter", "gyro", taps=9)]).imu.gyro[1000:, 0]
    s, c = np.sin(4 * np.pi * t[1000:]), np.cos(4 * np.pi * t[1000:])
    a, b = recovered(averaged, s, c)
    assert -np.arctan2(b, a) / (4 * np.pi) == pytest.approx(0.04, rel=0.01)  # (9 - 1) / 2 samples
    gain = np.sin(9 * 2 * np.pi * 2 * 0.005) / (9 * np.sin(2 * np.pi * 2 * 0.005))
    assert np.hypot(a, b) == pytest.approx(gain, rel=0.01)
    low = use("decimation_filter", "gyro", cutoff=2.0, order=2)
    passed = corrupt(record, None, RNG(0), effects=[low]).imu.gyro[1000:, 0]
    assert np.hypot(*recovered(passed, s, c)) == pytest.approx(np.sqrt(0.5), rel=0.01)
    # at rest nothing happens, from the first sample on
    rest = ImuRecord(t, np.full((t.size, 3), 0.3), rich.accel, "mean")
    np.testing.assert_allclose(corrupt(rest, None, RNG(0), effects=[low]).imu.gyro, 0.3, atol=1e-12)


@pytest.mark.parametrize("kind", ["increment", "mean"])
def test_models_that_are_left_out(kind):
    ideal = ideal_imu(built_in("helicopter_mapping"), 20.0, kind=kind, span=(100.0, 400.0))
    r = ideal.reference
    step = np.diff(ideal.imu.t, prepend=2 * ideal.imu.t[0] - ideal.imu.t[1])[:, None] if kind == "increment" else 1.0
    c = rotation.dcm_from_rpy(r.rpy)
    down = np.broadcast_to([0.0, 0.0, 1.0], r.llh.shape)
    for effect, key, value, first, ned in (
        ("earth_rate", "fraction", 0.8, 0, -earth.earth_rate(r.llh[:, 0])),
        ("transport_rate", "fraction", 0.5, 0, -earth.transport_rate(r.llh, r.vel_ned)),
        ("gravity", "offset", 2e-3, 3, -down),
    ):
        change = injected(ideal.imu, use(effect, **{key: value}), reference=r)[:, first : first + 3] / step
        regressor = np.einsum("nji,nj->ni", c, ned)
        np.testing.assert_allclose(recovered(change.ravel(), regressor.ravel()), value, rtol=0.01)
    with pytest.raises(InputError, match="'earth_rate' needs the reference"):
        corrupt(ideal.imu, None, RNG(0), effects=[use("earth_rate")])
    with pytest.raises(InputError, match="needs a temperature"):
        corrupt(ideal.imu, None, RNG(0), effects=[use("temperature", "gyro", c1=1e-4)])


# -- timing
# -------------------------------------------------------------------------------------------------------------------


def test_time_stamps(rich):
    def stamps(*uses):
        return corrupt(rich, None, RNG(4), effects=uses).imu.t

    offset = stamps(use("imu_gnss_time_offset", offset="5 ms"))
    np.testing.assert_allclose(offset - rich.t, 0.005, rtol=0.01)  # positive: stamps are late
    drift = stamps(use("clock_drift", drift="20 ppm"))
    np.testing.assert_allclose(recovered(drift - rich.t, rich.t - rich.t[0]), 20e-6, rtol=0.01)
    jitter = stamps(use("time_jitter", sigma="0.5 ms")) - rich.t
    assert jitter.std() == pytest.approx(5e-4, rel=5 / np.sqrt(2 * rich.t.size))
    with pytest.raises(InputError, match=r"time_jitter.*go back"):
        stamps(use("time_jitter", sigma="5 ms"))


def test_dropped_samples_leave_gaps_of_the_stated_size(rich):
    out = corrupt(rich, None, RNG(4), effects=[use("dropped_samples", probability=0.01, burst=3)])
    n = rich.t.size
    lost = 1 - len(out.imu) / n
    expected = 1 - 0.99**3
    assert abs(lost - expected) < 5 * np.sqrt(3 * expected / n)
    np.testing.assert_array_equal(out.imu.t, rich.t[out.kept])
    np.testing.assert_array_equal(out.imu.gyro, rich.gyro[out.kept])
    gaps = np.diff(out.imu.t)
    assert gaps.max() > 0.035 and (np.round(gaps[gaps > 0.015] / 0.01) >= 4).mean() > 0.9


def test_an_effect_added_last_leaves_the_others_alone(rich):
    noise = use("white_noise", "gyro", N=1e-3)
    one = injected(rich, noise)
    two = injected(rich, noise, use("white_noise", "accel", N=1e-3))
    np.testing.assert_array_equal(one[:, :3], two[:, :3])


def test_increments_carry_the_effects_times_the_interval(rich):
    step = 0.01
    increments = ImuRecord(rich.t, rich.gyro * step, rich.accel * step, "increment")
    uses = [
        use("scale_factor", "gyro", value=0.01),
        use("white_noise", "accel", N=1e-3),
        use("quantization", "accel", lsb=0.1),
    ]
    mean = corrupt(rich, {"gyro_x": WN(1e-3)}, RNG(3), effects=uses).imu
    sums = corrupt(increments, {"gyro_x": WN(1e-3)}, RNG(3), effects=uses).imu
    np.testing.assert_allclose(sums.gyro / step, mean.gyro, atol=1e-11)
    assert np.mean(np.abs(sums.accel / step - mean.accel) > 1e-6) < 1e-3  # rounding ties may fall either way


# -- stochastic effects, by wavelet variance
# --------------------------------------------------------------------------------------

DT = 0.01
N_SAMPLES = 4096
DRAWS = 200
#: two-sided chance of a false alarm of the whole test of one effect
FALSE_ALARM = 1e-6


def draws(*uses, draws=DRAWS, speed=10.0, degc=45.0, truth=None):
    t = np.arange(N_SAMPLES) * DT
    zero = np.zeros((N_SAMPLES, 3))
    imu = ImuRecord(t, zero, zero, "mean")
    reference = Trajectory(t, zero, zero + np.array([speed, 0.0, 0.0]), zero)
    for seed in np.random.SeedSequence(20260).spawn(draws):
        out = corrupt(
            imu, truth, RNG(seed), effects=uses, reference=reference, temperature=np.full(N_SAMPLES, degc)
        ).imu
        yield out.gyro[:, 0]


def empirical(autocovariance, tau):
    """Haar wavelet variances of a stationary sequence from its autocovariance (n,), scales 2^j."""
    out = []
    for scale in tau:
        half = scale // 2
        weight = np.concatenate([np.ones(half), -np.ones(half)]) / scale
        acv = np.correlate(weight, weight, "full")[scale - 1 :]
        out.append(acv[0] * autocovariance[0] + 2 * acv[1:] @ autocovariance[1:scale])
    return np.array(out)


SCALES = 2 ** np.arange(1, 8)
A1, A2, _ = band_coefficients(20.0, 5.0, DT)
STATIONARY = {
    "white_noise": (use("white_noise", "gyro", N=1e-3), WN(1e-3)),
    "random_walk": (use("random_walk", "gyro", K=1e-3), RW(1e-3)),
    "gauss_markov": (use("gauss_markov", "gyro", sigma=1e-3, beta=2.0), GM(1e-3, 2.0)),
    "flicker": (use("flicker", "gyro", B=1e-3), BI(1e-3)),
    "vibration_band": (
        use("vibration_band", "gyro", rms=1e-2, frequency=20.0, bandwidth=5.0),
        None,
    ),
    "motion_noise": (use("motion_noise", "gyro", N=2e-3), WN(2e-3)),
    "temperature_noise": (use("temperature_noise", "gyro", N=1e-4, T0=25.0), WN(2e-3)),
}


def resonance(n):
    """Autocovariance (n,) of the coloured vibration: the Yule-Walker recursion of its two poles."""
    acv = np.empty(n)
    acv[0] = 1e-4
    acv[1] = acv[0] * A1 / (1 - A2)
    for k in range(2, n):
        acv[k] = A1 * acv[k - 1] + A2 * acv[k - 2]
    return acv


def theory(name):
    """Effect, wavelet variances, and the degrees of freedom where they are not those of a noise type."""
    effect, process = STATIONARY[name]
    if process is not None:
        return effect, process.wavelet_variance(SCALES, DT), None
    expected = empirical(resonance(SCALES[-1] + 1), SCALES)
    whole = resonance(3 * N_SAMPLES)
    edof = model_edof(level1_autocovariance(N_SAMPLES, autocovariance=lambda lag: whole[np.abs(lag)]), expected)
    return effect, expected, edof


def curves(signals, edof=None):
    return [wavelet_variance(x, 1 / DT, levels=len(SCALES), edof=edof) for x in signals]


@pytest.mark.parametrize("name", sorted(STATIONARY))
@statistical(
    FALSE_ALARM + 7 * 5.8e-7, 14, power=binomial_power(DRAWS, 0.95, FALSE_ALARM, 7, 0.45)
)  # 1.21 of the variance, 1st scale
def test_gaussian_effects_cover_their_wavelet_variance_at_the_nominal_rate(name):
    """Per scale, the 95 % intervals of 200 draws hold the closed form in as many draws as a binomial allows."""
    effect, expected, edof = theory(name)
    found = curves(draws(effect), edof)
    low, high = np.array([c.low for c in found]), np.array([c.high for c in found])
    hits = ((low <= expected) & (expected <= high)).sum(axis=0)
    alarm = FALSE_ALARM / len(SCALES)
    assert hits.min() >= binom.ppf(alarm, DRAWS, 0.95), hits
    # and the mean of the draws is the closed form within five standard errors
    values = np.array([c.value for c in found])
    error = values.std(axis=0, ddof=1) / np.sqrt(DRAWS)
    assert (np.abs(values.mean(axis=0) - expected) < 5 * error).all()
    # a tenth more than stated is found out
    wrong = ((low <= 1.21 * expected) & (1.21 * expected <= high)).sum(axis=0)
    assert wrong.min() < binom.ppf(alarm, DRAWS, 0.95)


NOT_GAUSSIAN = {
    "outliers": (
        use("outliers", "gyro", probability=0.02, sigma=0.1),
        lambda: WN(np.sqrt(0.02 * 0.1**2 * DT)).wavelet_variance(SCALES, DT),
    ),
    "telegraph": (
        use("telegraph", "gyro", amplitude=0.01, rate=1.5),
        lambda: GM(0.01, 3.0).wavelet_variance(SCALES, DT),
    ),
}


@pytest.mark.parametrize("name", sorted(NOT_GAUSSIAN))
def test_other_effects_have_their_wavelet_variance(name):
    """Chi-square intervals do not hold for heavy tails and jumps; the mean of 200 draws and its own scatter do."""
    effect, expected = NOT_GAUSSIAN[name][0], NOT_GAUSSIAN[name][1]()
    values = np.array([c.value for c in curves(draws(effect))])
    error = values.std(axis=0, ddof=1) / np.sqrt(DRAWS)
    assert (np.abs(values.mean(axis=0) - expected) < 5 * error).all()
    assert (np.abs(values.mean(axis=0) - 1.5 * expected) > 5 * error).any()


def test_filtered_and_quantized_noise():
    sigma, lsb = 0.01, 0.02
    noise = WN(sigma * np.sqrt(DT))
    values = np.array([c.value for c in curves(draws(use("quantization", "gyro", lsb=lsb), truth={"gyro_x": noise}))])
    error = values.std(axis=0, ddof=1) / np.sqrt(DRAWS)
    expected = noise.wavelet_variance(SCALES, DT) * (1 + (lsb / sigma) ** 2 / 12)
    assert (np.abs(values.mean(axis=0) - expected) < 5 * error + 0.02 * expected).all()

    low = use("decimation_filter", "gyro", cutoff=10.0, order=2)
    impulse = lfilter(*butter(2, 10.0 * 2 * DT), np.eye(1, 2000)[0])
    acv = sigma**2 * np.correlate(impulse, impulse, "full")[impulse.size - 1 :]
    values = np.array([c.value for c in curves(draws(low, truth={"gyro_x": noise}))])
    error = values.std(axis=0, ddof=1) / np.sqrt(DRAWS)
    assert (np.abs(values.mean(axis=0) - empirical(acv, SCALES)) < 5 * error).all()


def test_band_coefficients_have_unit_variance():
    white = RNG(1).standard_normal(400_000)
    a1, a2, gain = band_coefficients(12.0, 3.0, DT)
    x = lfilter([gain], [1.0, -a1, -a2], white)[2000:]
    assert x.std() == pytest.approx(1.0, rel=0.02)
    with pytest.raises(InputError, match="not below half of the rate"):
        band_coefficients(60.0, 3.0, DT)


# -- GNSS
# ---------------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def drive():
    t = np.arange(0.0, 2000.5, 0.5)
    heading = 0.02 * t
    n = np.column_stack([500 * np.sin(heading), 500 * (1 - np.cos(heading)), 0 * t])
    origin = np.array([0.8, 0.1, 300.0])
    vel = np.column_stack([10 * np.cos(heading), 10 * np.sin(heading), 0 * t])
    rpy = np.column_stack([0 * t, 0 * t, (heading + np.pi) % (2 * np.pi) - np.pi])
    return Trajectory(t, earth.move(origin, n), vel, rpy)


def gnss_errors(drive, *uses, sigma=0.0, rate=2.0, seed=3):
    fixes = gnss_fixes(drive, rate, sigma, sigma, effects=uses, rng=RNG(seed))
    rows = np.searchsorted(drive.t, fixes.t - 1e-6)
    return fixes, earth.position_difference(fixes.llh, drive.llh[rows]), fixes.vel_ned - drive.vel_ned[rows]


@statistical(6 * 5.8e-7, 6, power=chi_square_power(4000, 6 * 5.8e-7, 6, 1.21))  # a level 10 % off
def test_gnss_levels(drive):
    uses = (use("gnss_noise_level", factor=[2.0, 3.0, 4.0]), use("gnss_velocity_noise", factor=2.0, sigma=0.0))
    fixes, position, velocity = gnss_errors(drive, *uses, sigma=0.1)
    np.testing.assert_allclose(position.std(axis=0), [0.2, 0.3, 0.4], rtol=5 / np.sqrt(2 * len(fixes)))
    np.testing.assert_allclose(velocity.std(axis=0), 0.2, rtol=5 / np.sqrt(2 * len(fixes)))
    np.testing.assert_allclose(fixes.pos_std_ned, 0.1)  # the receiver does not know


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
@statistical(
    FALSE_ALARM, 7, power=binomial_power(120, 0.95, FALSE_ALARM, 7, 0.5)
)  # a variance that intervals hold half of the times
def test_gnss_correlated_noise_covers_its_wavelet_variance(drive):
    hits, expected = [], GM(0.5, 1 / 5.0).wavelet_variance(SCALES, 0.5)
    for seed in range(60):
        for kind, which in (("gnss_correlated_noise", 1), ("gnss_velocity_noise", 2)):
            errors = gnss_errors(drive, use(kind, sigma=0.5, tau=5.0), seed=seed)[which][:, 0]
            c = wavelet_variance(errors, 2.0, levels=len(SCALES))
            hits.append((c.low <= expected) & (expected <= c.high))
    assert np.sum(hits, axis=0).min() >= binom.ppf(FALSE_ALARM / len(SCALES), len(hits), 0.95), np.mean(hits, axis=0)


def test_gnss_deterministic_effects_are_recovered(drive):
    step = use("gnss_multipath_step", value=[1.0, -2.0, 3.0], start=300.0, duration=60.0)
    fixes, position, _ = gnss_errors(drive, step)
    inside = (fixes.t > 300.0) & (fixes.t <= 360.0)
    np.testing.assert_allclose(position[inside], np.broadcast_to([1.0, -2.0, 3.0], (120, 3)), rtol=0.01, atol=1e-6)
    assert np.abs(position[~inside]).max() < 1e-6

    _, position, _ = gnss_errors(drive, use("lever_arm", value=[0.5, -0.3, 0.2]))
    rows = np.searchsorted(drive.t, fixes.t - 1e-6)
    c = rotation.dcm_from_rpy(drive.rpy[rows])
    estimate = np.linalg.lstsq(c.reshape(-1, 3), position.ravel(), rcond=None)[0]
    np.testing.assert_allclose(estimate, [0.5, -0.3, 0.2], rtol=0.01)

    late, position, _ = gnss_errors(drive, use("gnss_latency", latency="50 ms"))
    rows = np.searchsorted(drive.t, late.t - 1e-6)
    assert recovered(position.ravel(), drive.vel_ned[rows].ravel())[0] == pytest.approx(-0.05, rel=0.01)


def test_gnss_outliers_and_quality(drive):
    fixes, position, _ = gnss_errors(drive, use("gnss_outliers", probability=0.05, sigma=5.0))
    hit = np.abs(position).max(axis=1) > 1e-6
    n = len(fixes)
    assert abs(hit.mean() - 0.05) < 5 * np.sqrt(0.05 / n)
    np.testing.assert_allclose(position[hit].std(), 5.0, rtol=5 / np.sqrt(6 * hit.sum()))
    fixes, position, velocity = gnss_errors(drive, use("gnss_velocity_outliers", probability=0.05, sigma=0.5))
    hit = np.abs(velocity).max(axis=1) > 1e-6
    assert abs(hit.mean() - 0.05) < 5 * np.sqrt(0.05 / n) and np.abs(position).max() < 1e-6
    np.testing.assert_allclose(velocity[hit].std(), 0.5, rtol=5 / np.sqrt(6 * hit.sum()))

    quality = use("gnss_quality", factor=10.0, good=30.0, poor=10.0, stated=1)
    fixes, position, _ = gnss_errors(drive, quality, sigma=0.1)
    poor = fixes.pos_std_ned[:, 0] > 0.5
    assert 0.1 < poor.mean() < 0.45  # a quarter in the mean
    np.testing.assert_allclose(position[poor].std(), 1.0, rtol=5 / np.sqrt(6 * poor.sum()))
    np.testing.assert_allclose(position[~poor].std(), 0.1, rtol=5 / np.sqrt(6 * (~poor).sum()))
    blind, _, _ = gnss_errors(drive, use("gnss_quality", factor=10.0, stated=0), sigma=0.1)
    np.testing.assert_allclose(blind.pos_std_ned, 0.1)


def test_outages_by_area_and_at_random(drive):
    centre = drive.llh[400]
    area = AreaOutage(centre[0], centre[1], 100.0)
    fixes = gnss_fixes(drive, 2.0, 0.0, 0.0, outages=[area], rng=RNG(0))
    distance = earth.position_difference(drive.llh, centre)
    near = np.hypot(distance[:, 0], distance[:, 1]) < 100.0
    np.testing.assert_array_equal(np.isin(drive.t[1:], fixes.t), ~near[1:])

    drawn = random_outages(0.0, 360000.0, per_hour=6.0, mean_s=30.0, rng=RNG(1), clear_s=100.0)
    assert drawn == random_outages(0.0, 360000.0, per_hour=6.0, mean_s=30.0, rng=RNG(1), clear_s=100.0)
    assert drawn[0].start_s >= 100.0
    assert all(a.end_s < b.start_s for a, b in pairwise(drawn))
    assert len(drawn) == pytest.approx(600, rel=0.2)
    assert np.mean([o.duration_s for o in drawn]) == pytest.approx(30.0, rel=0.3)
    with pytest.raises(InputError, match="no fix at all"):
        gnss_fixes(drive, 2.0, outages=[AreaOutage(centre[0], centre[1], 1e7)], rng=RNG(0))


def test_datasheet_scales_differ_by_sensor():
    assert effects.EFFECTS["turn_on_bias"].scale("value", "gyro") != effects.EFFECTS["turn_on_bias"].scale(
        "value", "accel"
    )


# -- hostile mappings
# ----------------------------------------------------------------------------------------------------------------------

ODD = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**400), 10**400) | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5) | st.integers(), inner, max_size=2),
    max_leaves=5,
)


@settings(max_examples=300)
@given(st.data())
def test_no_mapping_reaches_the_parser_unchecked(data):
    effect = EFFECTS[data.draw(st.sampled_from(sorted(EFFECTS)))]
    mapping = {"effect": effect.id, "sensor": effect.sensors[0]}
    mapping |= {p.name: p.scale[0] for p in effect.parameters}
    place = data.draw(st.sampled_from([*mapping, "axes", "vlue", 3]))
    mapping[place] = data.draw(ODD)
    try:
        made = EffectUse.from_mapping(mapping)
    except InputError as error:
        assert len(str(error)) < 1500
    else:
        assert EffectUse.from_mapping(made.to_mapping()) == made


@pytest.mark.parametrize("mapping", [None, [], "scale_factor", 3, {"effect": ["a"]}, {"effect": {}}, {3: 4}])
def test_what_is_no_mapping_is_said(mapping):
    with pytest.raises(InputError):
        EffectUse.from_mapping(mapping)


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        ({"effect": "lever_arm", "value": 1e5}, "found 100000, expected at most 1000"),
        (
            {"effect": "turn_on_bias", "sensor": "gyro", "value": 10**400},
            "an integer of 1329 bits, expected a finite number",
        ),
        ({"effect": "gnss_outliers", "probability": 2, "sigma": 1.0}, "found 2, expected at most 1"),
        (
            {"effect": "turn_on_bias", "sensor": "gyro", "value": {"x": 1}},
            "found {'x': 1}, expected a quantity in rad/s",
        ),
        ({"effect": "turn_on_bias", "sensor": ["gyro"], "value": 1}, r"has the sensor \['gyro'\]"),
    ],
)
def test_implausible_and_odd_values_are_named(mapping, message):
    with pytest.raises(InputError, match=message):
        EffectUse.from_mapping(mapping)


def test_every_number_of_a_finding_knows_how_two_finds_add_up() -> None:
    for effect in EFFECTS.values():
        for p in effect.parameters:
            for label in p.labels(effect.axes):
                assert join_of(effect.id, label) == p.join, (effect.id, label)
    assert join_of("lever_arm", "nothing") == join_of("no effect", "value_x") == ""
