"""Processes: one generic oracle ties state block, closed forms and draws together."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from insemu.errors import InputError
from insemu.noise import (
    AR,
    AR1,
    ARMA,
    BI,
    DR,
    GM,
    MA,
    PROCESSES,
    QN,
    RC,
    RW,
    SIN,
    WN,
    NoiseModel,
    NotStationary,
    load,
    save,
)
from insemu.noise.block import StateBlock
from insemu.noise.compiled import draws
from insemu.noise.follow import Follows
from insemu.noise.grammar import whole

DT = 0.01
CASES = {
    "WN": WN(0.3) + WN(0.1),
    "RW": NoiseModel((RW(2.0),)),
    "GM fast": NoiseModel((GM(1.5, 25.8),)),
    "GM slow": NoiseModel((GM(1.5, 0.4),)),
    "AR1": NoiseModel((AR1(0.9, 0.5, 100.0),)),
    "AR1 negative": NoiseModel((AR1(-0.6, 0.5, 100.0),)),
    "AR(2)": NoiseModel((AR((1.6, -0.7), sigma2=0.3, rate_hz=100.0),)),
    "AR(3)": NoiseModel((AR((0.5, -0.2, 0.1), sigma2=0.3, rate_hz=100.0),)),
    "MA(2)": NoiseModel((MA(ma=(0.5, -0.3), sigma2=1.2, rate_hz=100.0),)),
    "ARMA(2,1)": NoiseModel((ARMA((1.2, -0.5), (0.4,), 0.7, 100.0),)),
    "QN": NoiseModel((QN(0.02),)),
    "DR": NoiseModel((DR(0.7),)),
    "SIN": NoiseModel((SIN(0.8, 3.3),)),
    "sum": 2 * GM(1.0, 2.0) + WN(0.05) + RW(0.4) + QN(1e-3) + DR(0.1),
}


def allan_by_propagation(block: StateBlock, m: int) -> float:
    """Second moment of (next m samples' sum - first m samples' sum), propagated exactly through the block, over 2 m^2."""
    n = block.n
    P = np.zeros((n + 1, n + 1))
    P[:n, :n] = block.P0
    for k in range(2 * m):
        sign = -1.0 if k < m else 1.0
        F = np.zeros((n + 1, n + 1))
        F[:n, :n] = block.Phi
        F[n, n] = 1.0
        F[n, :n] = sign * block.c @ block.Phi
        G = np.vstack([np.eye(n), sign * block.c[None, :]])
        P = F @ P @ F.T + G @ block.Q @ G.T
        P[n, n] += block.white
    return float(P[n, n] / (2.0 * m**2))


@pytest.mark.parametrize("m", [1, 2, 3, 4, 8, 13, 64])
@pytest.mark.parametrize("name", CASES)
def test_block_and_closed_form_tell_the_same_allan_variance(name: str, m: int) -> None:
    model = CASES[name]
    np.testing.assert_allclose(model.allan_variance(m, DT), allan_by_propagation(model.block(DT), m), rtol=1e-10)


def test_the_propagation_oracle_can_fail() -> None:
    wrong = GM(1.5, 25.8).block(DT)
    assert abs(allan_by_propagation(wrong, 8) / float(GM(1.5, 20.0).allan_variance(8, DT)) - 1) > 1e-2


@pytest.mark.parametrize("name", [k for k, v in CASES.items() if v.stationary])
def test_autocovariance_and_psd_and_allan_variance_agree(name: str) -> None:
    model = CASES[name]
    lags = np.arange(0, 12)
    gamma = model.autocovariance(lags, DT)
    np.testing.assert_array_equal(model.autocovariance(-lags, DT), gamma)
    for m in (1, 3, 5):
        weights = np.convolve(np.r_[-np.ones(m), np.ones(m)], np.r_[-np.ones(m), np.ones(m)][::-1])
        expected = (weights * model.autocovariance(np.arange(-2 * m + 1, 2 * m), DT)).sum() / (2 * m**2)
        np.testing.assert_allclose(model.allan_variance(m, DT), expected, rtol=1e-9, atol=1e-14 * gamma[0])
    if name == "SIN":
        return  # a line has no density
    f = (np.arange(2**18) + 0.5) / (2**18) / DT / 2
    for k in range(4):
        integral = 2 * np.mean(model.psd(f, DT) * np.cos(2 * np.pi * f * k * DT)) / DT / 2
        np.testing.assert_allclose(integral, gamma[k], rtol=1e-5, atol=1e-7 * gamma[0])


@pytest.mark.parametrize("name", [k for k in CASES if k not in ("SIN", "DR", "sum")])
def test_psd_gives_the_allan_variance(name: str) -> None:
    model = CASES[name]
    f = (np.arange(2**19) + 0.5) / 2**19 / DT / 2
    for m in (1, 4):
        response = np.sin(np.pi * f * m * DT) ** 4 / (m * np.sin(np.pi * f * DT)) ** 2
        value = 2 * 2 * np.mean(model.psd(f, DT) * response) / DT / 2
        np.testing.assert_allclose(model.allan_variance(m, DT), value, rtol=1e-5)


@given(phi=st.floats(-0.99, 0.9999), m=st.integers(1, 300))
def test_first_order_allan_variance_has_no_seam(phi: float, m: int) -> None:
    one = AR1(phi, 1.0, 100.0)
    r = phi ** np.arange(2 * m + 1.0)
    weights = np.where(np.arange(2 * m) < m, -1.0, 1.0)
    overlap = np.correlate(weights, weights, "full")[2 * m - 1 :]
    direct = (overlap[0] + 2 * (overlap[1:] * r[1 : 2 * m]).sum()) / (2 * m**2) * one.variance
    np.testing.assert_allclose(float(one.allan_variance(m, DT)), direct, rtol=1e-8)


def test_slow_gauss_markov_tends_to_a_random_walk() -> None:
    beta, q, m = 1e-9, 0.3, np.array([1, 16, 4096])
    slow = GM.of_driving_density(q, beta)
    np.testing.assert_allclose(slow.allan_variance(m, DT), RW(q).allan_variance(m, DT), rtol=1e-7)


def test_flicker_is_flat_and_its_psd_says_so() -> None:
    b = BI(0.3)
    np.testing.assert_allclose(np.sqrt(b.allan_variance([1, 10, 1000], DT)), 0.3 * 0.66428, rtol=1e-4)
    f = (np.arange(2**20) + 0.5) / 2**20 / DT / 2
    for m in (1, 4, 32):
        response = np.sin(np.pi * f * m * DT) ** 4 / (m * np.sin(np.pi * f * DT)) ** 2
        np.testing.assert_allclose(
            2 * 2 * np.mean(b.psd(f, DT) * response) / DT / 2, b.allan_variance(m, DT), rtol=1e-3
        )
    np.testing.assert_allclose(b.psd(1e-3, DT), 0.09 / (2 * np.pi * 1e-3), rtol=1e-3)


def test_flicker_approximation_states_its_error() -> None:
    model, error = BI(0.3).approximation(5, 1.0, 1000.0)
    m = np.round(np.geomspace(1.0, 1000.0, 60) / DT)
    worst = np.max(np.abs(model.allan_variance(m, DT) / float(BI(0.3).allan_variance(1, DT)) - 1))
    assert error < 0.05
    assert worst < error + 0.01


def test_the_state_block_of_flicker_has_its_allan_variance_inside_the_band_and_not_far_outside() -> None:
    """One state for every factor of 10; the error of the band is the stated 13 %, and beyond the band the floor is lost."""
    model = BI(0.3, tau_from=2.0, tau_to=2000.0)
    block = model.block(0.1)
    assert block.names == ("BI.1", "BI.2", "BI.3")
    flat = float(model.allan_variance(1, 0.1))
    diagonals = zip(np.diag(block.Phi), np.diag(block.Q), strict=True)
    parts = [GM.of_discrete(float(phi), float(q), 0.1) for phi, q in diagonals]
    m = np.round(np.geomspace(2.0, 2000.0, 40) / 0.1)
    ratio = sum(p.allan_variance(m, 0.1) for p in parts) / flat
    assert 0.05 < np.max(np.abs(ratio - 1.0)) < 0.135
    assert sum(float(p.allan_variance(600_000, 0.1)) for p in parts) / flat < 0.3
    with pytest.raises(InputError, match="band from 5 to 1 s is empty"):
        BI(0.3, tau_from=5.0, tau_to=1.0)


def test_the_names_of_the_field_are_read_as_the_processes_that_they_are() -> None:
    text = "ARW(N=0.34 deg/sqrt(h)) + RRW(K=3 deg/h/sqrt(h)) + BI(B=12 deg/h, tau_from=10 s, tau_to=100 s)"
    model = NoiseModel.parse(text, "rad/s")
    assert [p.symbol for p in model] == ["WN", "RW", "BI"]
    assert model == NoiseModel.from_list(model.to_list("rad/s"), "rad/s")
    assert NoiseModel.from_list([{"process": "VRW", "N": "0.06 m/s/sqrt(h)"}], "m/s^2") == NoiseModel((WN(1e-3),))


@pytest.mark.parametrize("name", CASES)
def test_a_scaled_model_has_scaled_variances(name: str) -> None:
    np.testing.assert_allclose(
        CASES[name].scaled(3.0).allan_variance([1, 8], DT), 9.0 * CASES[name].allan_variance([1, 8], DT), rtol=1e-12
    )
    assert RW(1.0, 2.0).scaled(3.0) == RW(3.0, 6.0)


def _allan_estimate(y: np.ndarray, m: int) -> np.ndarray:
    """Non-overlapping Allan variances of runs of a signal, one row a run."""
    means = y[:, : y.shape[1] // m * m].reshape(y.shape[0], -1, m).mean(axis=2)
    return 0.5 * np.mean(np.diff(means, axis=1) ** 2, axis=1)


@pytest.mark.parametrize("name", [*CASES, "BI"])
def test_draws_have_the_allan_variance_of_the_closed_form(name: str) -> None:
    """Two-sided z-test at 1e-6 per case over 200 runs, with the twin that 10 % in amplitude is seen."""
    model = CASES.get(name, NoiseModel((BI(0.5),)))
    rng = np.random.default_rng(20260101)
    runs = np.stack([model.simulate(4096, DT, r) for r in rng.spawn(200)])
    for m in (1, 8, 64):
        estimate = _allan_estimate(runs, m)
        truth = float(model.allan_variance(m, DT))
        standard_error = estimate.std(ddof=1) / np.sqrt(estimate.size)
        assert abs(estimate.mean() - truth) <= 4.9 * standard_error + 1e-9 * truth
        if m == 1 and name != "SIN":
            assert abs(estimate.mean() - 1.21 * truth) > 4.9 * standard_error


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
@pytest.mark.parametrize("name", [k for k, v in CASES.items() if v.stationary])
def test_draws_start_stationary(name: str) -> None:
    model = CASES[name]
    rng = np.random.default_rng(7)
    first = np.array([model.simulate(4, DT, r)[:2] for r in rng.spawn(2000)])
    gamma = model.autocovariance([0, 1], DT)
    # chi-square bounds at 1e-6 on a variance from 2,000 independent runs
    np.testing.assert_allclose((first**2).mean(axis=0), gamma[0], rtol=5 * np.sqrt(2 / 2000))
    assert abs((first[:, 0] * first[:, 1]).mean() - gamma[1]) < 5 * gamma[0] * np.sqrt(2 / 2000)


def test_random_constant_and_initial_spread() -> None:
    rng = np.random.default_rng(3)
    values = np.array([RC(2.0).simulate(5, DT, r) for r in rng.spawn(4000)])
    assert (values == values[:, :1]).all()
    assert abs(values[:, 0].std() / 2.0 - 1) < 5 / np.sqrt(8000)
    assert RC(2.0).block(DT).P0[0, 0] == 4.0
    assert RW(1.0, 3.0).block(DT).P0[0, 0] == 9.0


def test_a_process_added_last_leaves_the_others_as_they_were() -> None:
    few, more = 2 * GM(1.0, 2.0) + WN(0.1), 2 * GM(1.0, 2.0) + WN(0.1) + RW(0.3)
    a = few.simulate_components(100, DT, np.random.default_rng(5))
    b = more.simulate_components(100, DT, np.random.default_rng(5))
    np.testing.assert_array_equal(a, b[:3])


def test_discrete_view_goes_both_ways() -> None:
    gm = GM(0.3, 0.02)
    phi, s2 = gm.discrete(DT)
    back = GM.of_discrete(phi, s2, DT)
    assert back.sigma == pytest.approx(gm.sigma, rel=1e-9)
    assert back.beta == pytest.approx(gm.beta, rel=1e-9)
    np.testing.assert_allclose(
        AR1(phi, s2, 100.0).allan_variance([1, 64], DT), gm.allan_variance([1, 64], DT), rtol=1e-8
    )
    assert WN.of_variance(4.0, DT).N == pytest.approx(0.2)


def test_rates_do_not_mix() -> None:
    with pytest.raises(InputError, match="different rates"):
        AR1(0.5, 1.0, 100.0) + AR1(0.5, 1.0, 50.0)
    with pytest.raises(InputError, match="cannot be used at 50 Hz"):
        AR1(0.5, 1.0, 100.0).block(0.02)
    with pytest.raises(InputError, match="carries its rate"):
        AR1(0.5, 1.0).psd(1.0, DT)
    assert AR1(0.5, 1.0).at_rate(100.0).rate_hz == 100.0


def test_a_polynomial_that_is_not_stationary_is_refused_and_mended() -> None:
    ar = AR((2.582, -2.166, 0.585), sigma2=4.973e-13, rate_hz=100.0)
    with pytest.raises(NotStationary, match="nearest stable polynomial"):
        ar.block(DT)
    mended = ar.stabilised()
    assert mended.spectral_radius < 1
    moved = np.abs(np.sort_complex(mended.poles) - np.sort_complex(ar.poles))
    np.testing.assert_allclose(moved.max(), ar.spectral_radius - 1, atol=1e-4)
    with pytest.raises(NotStationary):
        RW(1.0).autocovariance(0, DT)
    with pytest.raises(NotStationary, match="RW"):
        (WN(1.0) + RW(1.0)).autocovariance(0, DT)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("2*GMM()", "did you mean 'GM'"),
        ("GM(sgma=1)", "did you mean 'sigma'"),
        ("0*WN()", "expected a whole number from 1 to 100"),
        ("WN(1", "cannot read"),
        ("WN(1)", "unnamed argument"),
        ("WN(N=-1)", "not negative"),
        ("WN(N=1 deg)", "another dimension"),
        ("AR()", "order"),
        ("GM(sigma=1, beta=0)", "positive"),
        ("GM(Tc=-1 s)", "positive"),
        ("GM(Tc=1 s, beta=2)", "both"),
        ("GM(q=1, sigma=2, Tc=1 s)", "without sigma"),
        ("GM(q=-1, Tc=1 s)", "positive"),
        ("", "cannot read"),
    ],
)
def test_bad_models_are_named(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        NoiseModel.parse(text, "rad/s")


def test_text_is_read_back() -> None:
    for text in ("2*GM() + WN()", "AR(3) + WN()", "ARMA(2, 1)", "MA(2)", "RW() + QN() + DR() + BI() + SIN() + RC()"):
        assert str(NoiseModel.parse(text)) == text
    one = NoiseModel.parse("WN(N=0.032 deg/s/sqrt(Hz)) + GM(sigma=10 deg/h, Tc=40 s)", "rad/s")
    assert one.processes[0].N == pytest.approx(np.deg2rad(0.032))
    assert one.processes[1].beta == pytest.approx(1 / 40)
    assert NoiseModel.parse(str(one)) == one
    two = NoiseModel.parse("GM(q=7.63e-4 deg/s*sqrt(Hz), beta=0.024 Hz)", "rad/s").processes[0]
    assert two.sigma == pytest.approx(np.deg2rad(7.63e-4) / np.sqrt(2 * 0.024))
    assert NoiseModel.parse("AR(p=2)") == NoiseModel.parse("AR(2)")


def _processes() -> st.SearchStrategy:
    value = st.floats(1e-12, 1e6)
    return st.one_of(
        st.builds(WN, value),
        st.builds(RW, value, st.one_of(st.just(0.0), value)),
        st.builds(GM, value, value),
        st.builds(QN, value),
        st.builds(DR, st.floats(-1e3, 1e3)),
        st.builds(BI, value),
        st.builds(SIN, value, value),
        st.builds(RC, value),
        st.builds(PROCESSES["PWC"], value, value),
        st.builds(AR1, st.floats(-0.999, 0.999), value, st.just(100.0)),
        st.builds(AR, st.tuples(st.floats(-2, 2), st.floats(-1, 1)), st.just(()), value, st.just(100.0)),
        st.builds(ARMA, st.tuples(st.floats(-2, 2)), st.tuples(st.floats(-1, 1)), value, st.just(100.0)),
        st.builds(MA, st.just(()), st.tuples(st.floats(-1, 1)), value, st.just(100.0)),
        st.sampled_from([GM(), WN(), RW(), QN(), AR.of_order(2), ARMA.of_order(1, 2), MA.of_order(0, 1)]),
    )


@settings(max_examples=60)
@given(st.lists(_processes(), max_size=4), st.sampled_from(["rad/s", "m/s^2", ""]))
def test_write_then_read_is_the_identity(tmp_path_factory: pytest.TempPathFactory, processes: list, unit: str) -> None:
    model = NoiseModel(tuple(processes))
    assert NoiseModel.from_list(model.to_list(unit), unit) == model
    path = tmp_path_factory.mktemp("noise") / "models.yaml"
    save({"axis": model}, path, {"axis": unit})
    assert load(path) == {"axis": model}


def test_a_model_file_that_is_not_one_is_named(tmp_path: pytest.TempPathFactory) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("axes: {gyro_x: {unit: rad/s, model: [{process: GM, sigma: 1 m}]}}")
    with pytest.raises(InputError, match=r"x\.yaml: axes\.gyro_x: GM\.sigma: the unit 'm'"):
        load(path)
    path.write_text("axes: [1, 2")
    with pytest.raises(InputError, match="not YAML"):
        load(path)


def test_every_process_is_registered_and_has_units() -> None:
    for name, cls in PROCESSES.items():
        structure = (
            cls.of_order(1, 1)
            if cls is ARMA
            else cls.of_order(1)
            if cls is AR
            else cls.of_order(0, 1)
            if cls is MA
            else cls()
        )
        assert structure.symbol == name
        assert not structure.specified
        assert all(p.unit_for("rad/s") and p.unit_for("m/s^2") for p in structure.parameters_meta())
        with pytest.raises(InputError, match="no value for"):
            _ = structure.parameters


# -- the kernels of simulation
# ---------------------------------------------------------------------------------------------------


def test_compiled_draws_are_the_numbers_of_numpy():
    """Tails of the ziggurat included, and the generator is left in the same state."""
    ours, theirs = np.random.default_rng(5), np.random.default_rng(5)
    out = np.empty(200_000)
    draws.standard_normal(out, ours)
    # the tails take a logarithm, which two libraries round within a unit of the last place each
    np.testing.assert_allclose(out, theirs.standard_normal(out.size), rtol=4.0 * np.spacing(1.0))
    assert np.abs(out).max() > 3.7  # beyond the last layer
    assert ours.bit_generator.state == theirs.bit_generator.state


@pytest.mark.parametrize("order", [1, 2, 4])
def test_filter_in_place_is_that_of_scipy(order):
    rng = np.random.default_rng(order)
    b, a = rng.normal(size=order + 1), np.poly(rng.uniform(-0.9, 0.9, order))
    x, start = rng.normal(size=500), rng.normal(size=order)
    expected, end = signal.lfilter(b, a, x, zi=start)
    draws.rational_filter(x, b, a, start)
    np.testing.assert_allclose(x, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(start, end, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("law", ["exp", "power"])
def test_a_covariate_that_is_no_number_is_refused_by_every_law(law: Any) -> None:
    follows = Follows("temperature", 0.5, at=20.0, law=law)
    for x in ([20.0, np.nan, 30.0, np.nan], np.nan):
        with pytest.raises(InputError, match="of temperature are no number, the first at row"):
            follows.gain(x)
    with pytest.raises(InputError, match=r"2 of 4 values of temperature are no number, the first at row 1; a level"):
        WN(1.0, follows=follows).under({"temperature": [20.0, np.nan, 30.0, np.nan]})
    gain = {"exp": np.exp(0.5 * np.array([-30.0, -20.0, 0.0, 4.0])), "power": np.sqrt([0.0, 0.0, 1.0, 1.2])}[law]
    np.testing.assert_allclose(follows.gain([-10.0, 0.0, 20.0, 24.0]), gain)
    np.testing.assert_array_equal(Follows("temperature", 0.0, at=20.0, law=law).gain([-10.0, 0.0, np.inf]), 1.0)


def test_a_first_order_process_has_a_coefficient_inside_its_bounds() -> None:
    for phi in (0.0, 1.0, -0.5, 1.5):
        with pytest.raises(InputError, match="expected a number between 0 and 1"):
            GM.of_discrete(phi, 1.0, DT)
    found = GM.of_discrete(0.5, 0.75, 2.0).parameters
    np.testing.assert_allclose([found["sigma"], found["beta"]], [1.0, np.log(2.0) / 2.0])
    for phi, kept in ((0.3, 0.3), (-2.0, -1.0), (2.0, 1.0)):
        back = AR1(0.5, 1.0, 100.0).of_transition(np.array([[phi]]), np.array([[0.2]]), DT).parameters
        assert abs(back["phi"]) < 1.0 and back["phi"] == pytest.approx(kept, abs=1e-11) and back["sigma2"] == 0.2


def test_whole_numbers_and_names_of_covariates() -> None:
    assert [whole(v) for v in (0, 7, "12", 10**9 - 1)] == [0, 7, 12, 10**9 - 1]
    assert [whole(v) for v in (-1, 10**9, True, 1.0, "1.5", "", None, "-1")] == [None] * 8
    for name in ("a b", "", "a-b", 3, None, ["a"]):
        with pytest.raises(InputError, match="expected a covariate"):
            Follows(name)  # type: ignore[arg-type]
    assert Follows("engine_1").covariate == "engine_1"
