"""Processes that axes share: in the noise model, emulated, carried by filters, fitted, and named in a log at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from insemu.augment import augment, per_axis
from insemu.emulate import built_in, ideal_imu
from insemu.emulate.errors import draw_errors
from insemu.errors import InputError
from insemu.evaluate.covariance import analyse
from insemu.filters import InitialSigma, LooselyCoupledEKF
from insemu.fit import fit_together
from insemu.gap import find_static_gap
from insemu.noise import GM, RW, WN, NoiseModel, load, save, shared_processes
from insemu.records import GnssRecord
from insemu.strapdown import NavState
from insemu.variance import wavelet_covariance
from tests import together_experiments as experiments

BELIEF = {
    "gyro": WN(1e-4),
    "accel_x": WN(1e-3) + GM(2e-3, 0.02, shared="warmth"),
    "accel_y": WN(1e-3) + RW(1e-5) + GM(1e-3, 0.02, shared="-warmth"),
    "accel_z": WN(1e-3) + GM(1e-3, 0.02),
}


def test_the_name_survives_text_mappings_and_files(tmp_path) -> None:
    model = BELIEF["accel_y"]
    assert NoiseModel.parse(str(model), "m/s^2") == model
    assert NoiseModel.from_list(model.to_list("m/s^2"), "m/s^2") == model
    save({"accel_y": model}, tmp_path / "m.yaml")
    assert load(tmp_path / "m.yaml")["accel_y"] == model
    assert str(NoiseModel.parse("2*GM() + AR(2, shared=a)")) == "2*GM() + AR(2, shared=a)"
    assert model.scaled(2.0).processes[2].shared == "-warmth"


@pytest.mark.parametrize("text", ["GM(shared=--a)", "GM(shared=1)", "GM(shared=a b)", "GM(shared=[a, b])"])
def test_a_name_is_a_name(text: str) -> None:
    with pytest.raises(InputError, match="expected a name"):
        NoiseModel.parse(text)


def test_axes_with_one_name_have_one_process() -> None:
    wrong = {**BELIEF, "accel_z": WN(1e-3) + GM(1e-3, 0.03, shared="warmth")}
    with pytest.raises(InputError, match=r"warmth.*accel_x.*accel_z.*at different levels \(sigma\)"):
        augment(wrong, 0.01)
    with pytest.raises(InputError, match="stands twice"):
        augment({**BELIEF, "accel_z": 2 * GM(1e-3, 0.02, shared="warmth")}, 0.01)
    with pytest.raises(InputError, match="white noise that axes share"):
        augment({"gyro": WN(1e-4, shared="w"), "accel": WN(1e-3)}, 0.01)
    assert [m.weight for m in shared_processes(per_axis(BELIEF))["warmth"]] == [2e-3, -1e-3]


def test_states_of_a_shared_process_are_driven_as_one() -> None:
    a = augment(BELIEF, 0.01)
    x, y = a.layout.index("accel_x.GM1") - 9, a.layout.index("accel_y.GM1") - 9
    for M in (a.Q, a.P0):
        assert M[x, y] == M[y, x] == pytest.approx(-0.5 * M[x, x])
        assert M[x, y] ** 2 == pytest.approx(M[x, x] * M[y, y])
        off = M - np.diag(np.diag(M))
        off[x, y] = off[y, x] = 0.0
        assert not off.any()


def test_axes_get_one_draw_and_other_draws_stay() -> None:
    alone = {k: NoiseModel(tuple(replace(p, shared="") for p in NoiseModel() + m)) for k, m in BELIEF.items()}
    _, with_name = draw_errors(BELIEF, 500, 0.01, np.random.default_rng(1))
    _, without = draw_errors(alone, 500, 0.01, np.random.default_rng(1))
    assert np.allclose(with_name["accel_y"][2], -0.5 * with_name["accel_x"][1], rtol=1e-12)
    assert np.array_equal(with_name["accel_y"][:2], without["accel_y"][:2])
    assert np.array_equal(with_name["accel_z"], without["accel_z"])


def test_a_filter_that_carries_it_as_one_states_its_true_error() -> None:
    """Covariance analysis of the right belief returns the filter's own covariance, and the parts of the budget add up."""
    flight = ideal_imu(built_in("urban_drive_1").path, 20.0, span=(0.0, 120.0))
    ref = flight.reference
    gyro = WN(1e-4) + GM(1.4e-4, 1 / 300, shared="drift")
    truth = {"gyro": gyro, "accel_x": BELIEF["accel_x"], "accel_y": BELIEF["accel_y"], "accel_z": BELIEF["accel_z"]}
    t = np.arange(ref.t[0] + 1.0, ref.t[0] + 60.0)
    rows = np.searchsorted(ref.t, t)
    gnss = GnssRecord(
        ref.t[rows], ref.llh[rows], ref.vel_ned[rows], np.full((rows.size, 3), 0.2), np.full((rows.size, 3), 0.05)
    )
    sigma = InitialSigma((0.1,) * 3, (0.05,) * 3, (0.01, 0.01, 0.05))
    end = float(ref.t[0] + 119.0)

    def run(belief):
        ekf = LooselyCoupledEKF(belief, flight.imu.dt)
        return analyse(
            ekf,
            truth,
            flight.imu,
            gnss,
            NavState.of(ref),
            sigma,
            at=[end],
            budget_at=[end],
            budget_states=["pos_n", "pos_e"],
        )

    right = run(truth)
    assert np.allclose(right.rms, right.sigma, rtol=2e-3)
    budget = right.budgets[0]
    assert "shared drift" in budget.sources and "shared warmth" in budget.sources and "accel_z GM1" in budget.sources
    assert np.allclose(np.sqrt(budget.total), right.rms[0, :2], rtol=1e-3)
    apart = run({**truth, "gyro": WN(1e-4) + GM(1.4e-4, 1 / 300)})
    assert apart.rms[0, :2].max() > 1.02 * right.rms[0, :2].max()
    assert not np.allclose(apart.rms, apart.sigma, rtol=2e-2)


def test_wavelet_covariance_is_that_of_its_coefficients() -> None:
    rng = np.random.default_rng(3)
    x, y = rng.standard_normal((2, 4096))
    y = 1e6 * (0.3 * x + y)  # the size of neither matters
    curve = wavelet_covariance(x, y, 10.0, confidence=0.999)
    for j in (1, 3):
        m = 2 ** (j - 1)
        means = (np.convolve(v, np.ones(m), "valid") / m for v in (x, y))
        wx, wy = (0.5 * (v[m:] - v[:-m]) for v in means)
        assert curve.value[j - 1] == pytest.approx(float(np.mean(wx * wy)), rel=1e-9)
    assert curve.p_value < 1e-6
    assert (curve.correlation_low[:5] < 0.3 / np.hypot(1, 0.3)).all() and (
        curve.correlation_high[:5] > 0.3 / np.hypot(1, 0.3)
    ).all()
    with pytest.raises(InputError, match="4096 and 5"):
        wavelet_covariance(x, x[:5])


def test_axes_fitted_together_return_the_mixing_vector() -> None:
    truth = {
        a: NoiseModel(tuple(p for p in m if not isinstance(p, RW)))
        for a, m in experiments.TRUTH.items()
        if a != "accel_z"
    }
    log = experiments.drawn(truth, 60_000, 50.0, np.random.default_rng(5))
    found = fit_together(log, {a: experiments.structure_of(m) for a, m in truth.items()})
    assert [p.shared for p in found["accel_y"].model] == ["", "-a"]
    for axis, result in found.items():
        for p, q, at in zip(result.model, truth[axis], range(2), strict=True):
            for name, value in q.parameters.items():
                own = result[f"{p.symbol}1.{name}"]
                assert abs(own.value - value) < 4.0 * own.standard_error, (axis, at, name)
    assert found["accel_x"]["GM1.beta"].value == found["accel_y"]["GM1.beta"].value
    assert found["accel_x"].test is not None and found["accel_x"].test.p_value > 1e-3
    with pytest.raises(InputError, match="accel_x alone"):
        fit_together(log, {"accel_x": WN() + GM(shared="a"), "accel_y": WN() + GM()})


def test_a_shared_process_is_named_in_a_log_at_rest_and_then_believed() -> None:
    (white, slow), (_, other) = experiments.REST["accel_x"], experiments.REST["accel_y"]
    truth = {
        **experiments.REST,
        "accel_x": white + replace(slow, shared="a"),
        "accel_y": white + replace(other, shared="-a"),
    }
    log = experiments.drawn(truth, 36_000, 20.0, np.random.default_rng(7))
    report = find_static_gap(log, experiments.REST, rng=np.random.default_rng(1), hold_out=False)
    (finding,) = report.findings
    assert (report.verdict, finding.effect, finding.axes) == ("named", "shared_process", ("x", "y"))
    assert finding.parameters[0].name == "correlation_xy" and finding.parameters[0].high < -0.8
    assert report.where[0].statistic == "cross_axis slow accel_y"
    (one, two) = shared_processes(report.refined)["common1"]
    assert one.sign * two.sign == -1.0
    again = find_static_gap(log, report.refined, rng=np.random.default_rng(1), hold_out=False)
    assert not again.findings and again.where[0].p_value > 1e-3


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
def test_intervals_of_a_joint_fit_hold_the_truth() -> None:
    inside, rejected = experiments.coverage(200)
    share = np.array(list(inside.values()))
    assert 0.92 <= share.mean() <= 0.97
    assert share.min() > 0.88  # 3.5 binomial standard deviations below 95 %
    assert rejected < 0.12


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
def test_independence_is_rejected_as_often_as_said() -> None:
    size, power = experiments.independence(300)
    assert 0.015 < size < 0.09  # binomial, 99.9 %
    assert power > 0.9  # 99 of 100 when it was written


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
def test_a_shared_process_of_20_nats_is_named() -> None:
    at = experiments.naming(60, experiments.REST_SHARE)
    assert at["named"] >= 0.87 and at["covered"] >= 0.86  # 95 % less 2.8 binomial standard deviations
    assert experiments.naming(40, 0.0, seed=1604)["found"] <= 0.1


@pytest.mark.slow(reason="real recordings of hours")
def test_the_adis16405_is_predicted_better_with_its_shared_processes() -> None:
    for number, r, p, gain in experiments.adis():
        assert 0.7 < r < 0.85 and p < 1e-6
        assert gain > 100.0, number
