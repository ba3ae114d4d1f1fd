"""Levels that follow a covariate: what is written, drawn and fitted."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from insemu.cli import main
from insemu.emulate import corrupt
from insemu.errors import InputError
from insemu.filters import LooselyCoupledEKF
from insemu.filters.reference import reference_run
from insemu.fit import fit, fit_following
from insemu.fit.segments import Segments
from insemu.noise import GM, WN, Follows, NoiseModel, load, save
from insemu.records import Series, Trajectory
from tests import filter_cases as cases
from tests.following_experiments import EFFECTS, RATE, SLOPE, TEMPERATURE, TRUTH, N, coverage, recovered

TEXT = "WN(N=1 deg/s/sqrt(Hz), follows=temperature, slope=0.02, at=25 degC) + GM(sigma=1, Tc=10 s, follows=speed, slope=1, law=power, at=10)"


def test_text_and_files_hold_it(tmp_path):
    model = NoiseModel.parse(TEXT, "rad/s")
    assert NoiseModel.parse(str(model), "rad/s") == model
    save({"gyro_x": model}, tmp_path / "m.yaml")
    assert load(tmp_path / "m.yaml")["gyro_x"] == model
    at = model.under({"temperature": 60.0, "speed": 20.0})
    assert at.processes[0].N == pytest.approx(np.deg2rad(1.0) * np.exp(0.7))
    assert at.processes[1].sigma == pytest.approx(2.0) and at.processes[1].follows is None


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("WN(slope=1)", "without 'follows'"),
        ("WN(follows=speed, law=x)", "did you mean 'exp'"),
        ("WN(follows=speed, law=power, slope=1, at=3, above=5)", "above 5"),
        ("WN(follows=speed, above=5)", "law=power"),
    ],
)
def test_bad_laws_are_refused(text, says):
    with pytest.raises(InputError, match=says):
        NoiseModel.parse(text)


def test_other_estimators_and_draws_say_what_is_missing():
    model = WN(1.0, follows=Follows("speed", 0.1)) + GM(1.0, 0.1)
    with pytest.raises(InputError, match="follows speed, which is not given"):
        model.simulate(10, 0.1, np.random.default_rng(1))
    with pytest.raises(InputError, match="fit-covariate"):
        fit(np.random.default_rng(1).standard_normal(1000), "WN(follows=speed)", rate_hz=1.0)


@pytest.mark.parametrize("text", ["BI(B=1", "PWC(sigma=1, T=5", "DR(R=1", "RC(sigma=1"])
def test_what_has_no_driving_noise_of_its_own_is_not_drawn(text):
    model = NoiseModel.parse(f"WN(N=1) + {text}, follows=speed, slope=0.1)")
    with pytest.raises(InputError, match="cannot be drawn: it has no driving noise"):
        model.simulate(10, 0.1, np.random.default_rng(1), {"speed": np.zeros(10)})


def test_draws_have_the_gain():
    n = 40_000
    x = np.repeat([0.0, 2.0], n // 2)
    white = NoiseModel((WN(1.0, follows=Follows("x", 0.5)),)).simulate(n, 1.0, np.random.default_rng(1), {"x": x})
    ratio = white[n // 2 :].std() / white[: n // 2].std()
    assert abs(np.log(ratio) - 1.0) < 4.0 / np.sqrt(n / 2)
    slow = NoiseModel((GM(1.0, 0.5, follows=Follows("x", 0.5)),)).simulate(n, 1.0, np.random.default_rng(1), {"x": x})
    step = slow[1:] - np.exp(-0.5) * slow[:-1]
    assert abs(np.log(step[n // 2 :].std() / step[: n // 2 - 1].std()) - 1.0) < 4.0 / np.sqrt(n / 2)


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
def test_the_covariance_of_the_moments_is_that_of_the_record() -> None:
    """Against the exact one of a stationary signal (Isserlis over all pairs of coefficients): segments and the longer scales of the whole."""
    n, segments, dt = 512, 4, 1.0
    truth = NoiseModel.parse("WN(N=1, follows=x, slope=0, at=0) + GM(sigma=1, beta=0.05)")
    x = Series(np.random.default_rng(3).standard_normal(n), 1.0 / dt, "rad/s", "gyro_x")
    problem = Segments.of(x, {"x": np.linspace(-1.0, 1.0, n)}, truth, segments, 0.0, np.inf)
    a, length = np.exp(-0.05 * dt), n // segments
    signal = np.eye(n) + a ** np.abs(np.subtract.outer(np.arange(n), np.arange(n)))

    def coefficients(scale: int, begin: int, end: int) -> np.ndarray:
        step = np.repeat([-1.0, 1.0], scale // 2) / scale
        return np.array([np.pad(step, (k, n - scale - k)) for k in range(begin, end - scale + 1)])

    short, long = problem.curves[0].scale_samples[problem.keep], problem.whole.scale_samples[problem.rest]
    rows = [coefficients(j, s * length, (s + 1) * length) for s in range(segments) for j in short]
    rows += [coefficients(j, 0, n) for j in long]
    exact = np.array([[2.0 * np.mean((p @ signal @ q.T) ** 2) for q in rows] for p in rows])
    found = problem.covariance(truth)
    size = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
    assert short.size >= 4 and long.size >= 3
    np.testing.assert_allclose(np.diag(found) / np.diag(exact), 1.0, atol=1e-4)
    across = np.s_[: segments * short.size, segments * short.size :]
    assert (exact / size)[across].max() > 0.2  # the correlation that matters
    np.testing.assert_allclose((found / size)[across], (exact / size)[across], atol=0.07)
    assert np.linalg.eigvalsh(found / size).min() > 0.0


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
def test_intervals_hold_the_slope():
    inside, rejected = coverage(TRUTH["both follow"], SLOPE, 12)
    # below 7 of 12 (9 of 12) once in 10,000 where intervals hold 95 %
    assert min(inside.values()) >= 8 / 12 and rejected <= 4 / 12
    inside, _ = coverage(TRUTH["white noise follows"], 0.0, 12, seed=1802)
    assert inside["WN1.slope"] >= 8 / 12


def test_a_wrong_slope_is_seen():
    truth = NoiseModel.parse(TRUTH["white noise follows"].format(b=0.0))
    x = truth.simulate(N, 1.0 / RATE, np.random.default_rng(4), {"temperature": TEMPERATURE})
    found = fit_following(
        Series(x, RATE, "rad/s", "gyro_x"),
        {"temperature": TEMPERATURE},
        NoiseModel.parse("WN(follows=temperature, slope=0.01, at=25) + GM()"),
    )
    assert found.result.test.p_value < 1e-6 and not found.p_values


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
@pytest.mark.parametrize("effect", EFFECTS)
def test_effects_of_the_emulator_are_recovered(effect):
    # fewer than 6 of 12 once in 4e6 where intervals hold 95 %
    assert min(recovered(effect, 12).values()) >= 7 / 12


def test_the_command_says_what_follows(tmp_path, capsys):
    truth = NoiseModel.parse(TRUTH["white noise follows"].format(b=SLOPE))
    x = truth.simulate(N, 1.0 / RATE, np.random.default_rng(5), {"temperature": TEMPERATURE})
    log = tmp_path / "log.csv"
    table = np.column_stack([np.arange(N) / RATE, x, TEMPERATURE])
    np.savetxt(log, table, delimiter=",", header="t [s],gx [rad/s],temperature [degC]", comments="")
    page, out = tmp_path / "p.html", tmp_path / "m.yaml"
    asked = ["fit-covariate", str(log), "-m", "WN(follows=temperature) + GM()"]
    with pytest.raises(SystemExit) as end:
        main([*asked, "--page", str(page), "-o", str(out)])
    assert end.value.code in (0, None)
    said = " ".join(capsys.readouterr().out.split())
    assert "it follows temperature" in said and "changes by a factor of 2.4" in said
    assert "Level against covariate" in page.read_text()
    law = load(out)["gyro_x"].processes[0].follows
    assert law.covariate == "temperature" and abs(law.slope - SLOPE) < 0.002
    with pytest.raises(SystemExit):
        main([*asked[:3], "WN() + GM()", "--covariate", "temperature", "--segments", "8", "--json"])
    answer = json.loads(capsys.readouterr().out)["axes"]["gyro_x"]
    assert len(answer["segments"]) == 8 and set(answer["slope_p_values"]) == {"WN1", "GM1"}
    for wrong, says in (
        (["--covariate", "speed"], "no covariate 'speed'"),
        (["--covariate", "temperature", "--segments", "20000"], "segments"),
    ):
        with pytest.raises(SystemExit) as end:
            main([*asked[:3], "WN() + GM()", *wrong, "-o", str(tmp_path / "none.yaml")])
        assert end.value.code == 2 and says in capsys.readouterr().err
        assert not (tmp_path / "none.yaml").exists()


LAWS = {
    "gyro": WN(5e-4, follows=Follows("speed", 1.0, 10.0, "power"))
    + GM(3e-4, 0.05, follows=Follows("temperature", 0.05, 25.0)),
    "accel": WN(1e-3) + WN(2e-3, follows=Follows("vibration", 0.5)) + GM(5e-3, 0.02, follows=Follows("rate", 2.0)),
}


def a_drive(seconds: float = 20.0):
    """A drive whose IMU warms up by 40 K, drawn from laws, with its fixes."""
    rng = np.random.default_rng(11)
    road = cases.drive(seconds)
    t = road.imu.t
    imu = replace(road.imu, temperature=20.0 + 40.0 * (t - t[0]) / seconds)
    speed = np.linalg.norm(road.nav[:, 3:6], axis=1)
    reference = Trajectory(t, road.nav[:, :3], road.nav[:, 3:6], np.zeros((t.size, 3)))
    assert np.ptp(speed) > 1.0
    got = corrupt(imu, LAWS, rng, reference=reference, temperature=imu.temperature)
    return road, got.imu, cases.fixes(road, rng), cases.start(road, rng)


def test_the_compiled_filter_follows_as_the_reference_does():
    _, imu, gnss, start = a_drive()
    ekf = LooselyCoupledEKF(LAWS, cases.DT)
    a = ekf.run(imu, gnss, start, cases.START_SIGMA)
    b = reference_run(ekf, imu, gnss, start, cases.START_SIGMA)
    np.testing.assert_allclose(a.sigma, b.sigma, rtol=1e-6)
    np.testing.assert_allclose(a.nav[:, 3:6], b.nav[:, 3:6], atol=1e-7)
    plain = {axis: NoiseModel(tuple(replace(p, follows=None) for p in m)) for axis, m in LAWS.items()}
    other = LooselyCoupledEKF(plain, cases.DT).run(imu, gnss, start, cases.START_SIGMA)
    at = ekf.layout.index("gyro_x.GM1")
    assert a.sigma[0, at] == pytest.approx(3e-4 * np.exp(0.05 * (20.0 - 25.0)))
    assert a.sigma[-1, at] / other.sigma[-1, at] > 1.5
    sparse = ekf.with_options(covariance_every=5, output_every=5).run(imu, gnss, start, cases.START_SIGMA)
    np.testing.assert_allclose(sparse.sigma[-1], a.sigma[-1], rtol=0.02)


def test_a_constant_covariate_is_the_model_under_it():
    road = cases.drive(20.0)
    rng = np.random.default_rng(3)
    gnss, start = cases.fixes(road, rng), cases.start(road, rng)
    imu = replace(road.imu, temperature=np.full(len(road.imu), 60.0))
    warm = Follows("temperature", 0.02, 25.0)
    law = dict.fromkeys(("gyro", "accel"), WN(1e-3, follows=warm) + GM(1e-3, 0.1, follows=warm))
    under = {a: m.under({"temperature": 60.0}) for a, m in law.items()}
    a, b = (LooselyCoupledEKF(m, cases.DT).run(imu, gnss, start, cases.START_SIGMA) for m in (law, under))
    np.testing.assert_allclose(a.sigma, b.sigma, rtol=1e-9)


def test_a_filter_says_which_covariate_it_lacks():
    road, _, gnss, start = a_drive(5.0)
    with pytest.raises(InputError, match="no covariate 'temperature'"):
        LooselyCoupledEKF(LAWS, cases.DT).run(road.imu, gnss, start, cases.START_SIGMA)
    with pytest.raises(InputError, match="no covariate 'oil'"):
        LooselyCoupledEKF({"gyro": WN(1.0, follows=Follows("oil", 1.0)), "accel": WN(1.0)}, cases.DT).run(
            road.imu, gnss, start, cases.START_SIGMA
        )
    with pytest.raises(InputError, match="no slope"):
        LooselyCoupledEKF({"gyro": WN(1.0, follows=Follows("speed")), "accel": WN(1.0)}, cases.DT)
