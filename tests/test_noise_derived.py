"""Closed forms of every process against what follows from its state block, and the forms that estimators use against both."""

import math
from fractions import Fraction

import numpy as np
import pytest

from insemu.augment import augment
from insemu.errors import InputError
from insemu.fit import fit
from insemu.fit.structure import Structure, natural_jacobian
from insemu.noise import AR, AR1, ARMA, BI, DR, GM, MA, PROCESSES, QN, RC, RW, SIN, WN, NoiseModel, Process
from insemu.noise.parameters import LONGEST_RECORDS
from insemu.noise.shared import shared_processes

DT = 0.01
RATE = 100.0
#: Every registered process at least once; a process without a row fails the last test of this file.
ROWS = {
    "WN": WN(2e-3),
    "RW": RW(3e-4),
    "GM slow": GM(2e-3, 0.05),
    "GM fast": GM(2e-3, 60.0),
    "AR1": AR1(0.97, 1e-6, RATE),
    "AR1 negative": AR1(-0.6, 1e-6, RATE),
    "AR": AR((1.5, -0.6), sigma2=1e-6, rate_hz=RATE),
    "MA": MA(ma=(0.5, -0.2), sigma2=1e-6, rate_hz=RATE),
    "ARMA": ARMA((0.9, -0.3), (0.4,), 1e-6, RATE),
    "QN": QN(1e-5),
    "DR": DR(1e-3),
    "BI": BI(1e-3),
    "SIN": SIN(1e-3, 3.3),
    "RC": RC(1e-2),
    "GM2 slow": PROCESSES["GM2"](2e-3, 0.05),
    "GM2 fast": PROCESSES["GM2"](2e-3, 60.0),
    "PWC": PROCESSES["PWC"](2e-3, 0.20371),
    "PWC long": PROCESSES["PWC"](2e-3, 90.0037),
    "PWC samples": PROCESSES["PWC"](2e-3, 0.0151),
}
BLOCKS = {name: p for name, p in ROWS.items() if p.symbol not in ("BI", "PWC")}  # whose blocks are exact
FITTED = {name: p for name, p in ROWS.items() if name != "RC"}
each_block = pytest.mark.parametrize("process", BLOCKS.values(), ids=BLOCKS)
each_fitted = pytest.mark.parametrize("process", FITTED.values(), ids=FITTED)


def near(a: np.ndarray, b: np.ndarray, relative: float) -> None:
    np.testing.assert_allclose(a, b, rtol=relative, atol=relative * np.max(np.abs(b), initial=0.0) + 1e-300)


@each_block
def test_closed_forms_are_those_of_the_block(process: Process) -> None:
    block = process.block(DT)
    m = np.array([1, 2, 3, 7, 64, 1000])
    near(process.allan_variance(m, DT), block.allan_variance(m), 1e-9)
    f = np.geomspace(1e-3, 50.0, 30)
    near(process.psd(f, DT), block.psd(f), 1e-9)
    if process.stationary:
        near(process.autocovariance(np.arange(40), DT), block.autocovariance(np.arange(40)), 1e-9)
    for mean in (1, 2, 50):
        if not process.single_draw:
            near(process.difference_covariance(mean, DT, 8), block.difference_covariance(mean, 8), 1e-8)
            assert process.difference_covariance(mean, DT, 1).shape == (1,)


@pytest.mark.parametrize("process", ROWS.values(), ids=ROWS)
def test_allan_variance_is_half_the_variance_of_differences(process: Process) -> None:
    if process.single_draw:
        assert not process.difference_covariance(10, DT, 5).any()
        return
    for m in (1, 10, 100):
        first = process.difference_covariance(m, DT, 3)[0]
        assert 0.5 * first == pytest.approx(float(process.allan_variance(m, DT)), rel=1e-9)


@pytest.mark.parametrize("process", ROWS.values(), ids=ROWS)
def test_short_covariances_are_the_beginning_of_long_ones(process: Process) -> None:
    for m in (1, 7):
        whole = process.difference_covariance(m, DT, 12)
        for count in (0, 1, 2, 3):
            near(process.difference_covariance(m, DT, count), whole[:count], 1e-12)
            if process.own_block:
                near(
                    process.block(DT).difference_covariance(m, count),
                    process.block(DT).difference_covariance(m, 12)[:count],
                    1e-12,
                )
    for formula in (process.allan_variance, process.psd):
        assert formula(np.zeros(0), DT).shape == (0,)


def test_differences_of_a_sum_are_sums() -> None:
    model = WN(1e-3) + GM(1e-3, 0.3) + AR1(0.9, 1e-7, RATE) + BI(1e-4)
    total = sum(p.difference_covariance(20, DT, 6) for p in model)
    np.testing.assert_allclose(model.difference_covariance(20, DT, 6), total)
    near(model.difference_covariance(20, DT, 1)[0], 2.0 * model.allan_variance(20, DT), 1e-9)


def test_one_process_written_three_ways_is_one() -> None:
    gm = GM(2e-3, 0.5)
    phi, sigma2 = gm.discrete(DT)
    one, general = AR1(phi, sigma2, RATE), AR((phi,), sigma2=sigma2, rate_hz=RATE)
    for m in (1, 100, 1000):
        want = gm.difference_covariance(m, DT, 30)
        near(one.difference_covariance(m, DT, 30), want, 1e-9)
        near(general.difference_covariance(m, DT, 30), want, 1e-9)


@each_fitted
def test_an_estimator_sees_the_process(process: Process) -> None:
    """Coordinates lead back; compiled curves are the wavelet variance; derivatives are those of the parameters as written."""
    coefficient, shapes = process.coordinates(DT)
    assert coefficient is not None
    free = process.with_parameters(dict.fromkeys(process.given))
    back = free.of_coordinates(coefficient, [s for s in shapes if s is not None], DT)
    for name, value in process.parameters.items():
        assert back.parameters[name] == pytest.approx(abs(value), rel=1e-9) or value < 0
        assert process.with_parameters({name: value}) == process
    structure = Structure.of(NoiseModel((free,)), RATE)
    model = NoiseModel((process,))
    m = 2.0 ** np.arange(0, 12)
    c, s = structure.internal(model)
    near(c[0] * structure.columns(m, s)[0][:, 0], process.wavelet_variance(2 * m, DT), 1e-9)
    D, names = natural_jacobian(model, structure, m)
    assert [name for _, name in names] == list(process.parameters)
    for column, (_, name) in zip(D.T, names, strict=True):
        value = process.parameters[name]
        h = 1e-5 * abs(value) if name != "phi" else 1e-5 * (1.0 - abs(value))
        up, down = (process.with_parameters({name: value + d}).wavelet_variance(2 * m, DT) for d in (h, -h))
        near(column, (up - down) / (2.0 * h), 2e-5)


@pytest.mark.parametrize(
    "process",
    [GM(2e-3, 0.5), PROCESSES["GM2"](2e-3, 0.5), WN(1e-3), RW(1e-3), QN(1e-5), SIN(1e-3, 3.3)],
    ids=lambda p: p.symbol,
)
def test_a_derived_curve_is_the_compiled_one(process: Process) -> None:
    """A process without a compiled curve is searched through its block; both say the same, derivatives too."""
    other = type(
        f"{process.symbol}Derived", (type(process),), {"curve": None, "allan_variance": Process.allan_variance}
    )
    twin = other(**process.parameters)
    m = 2.0 ** np.arange(0, 10)
    free = [NoiseModel((p.with_parameters(dict.fromkeys(p.given)),)) for p in (process, twin)]
    structures = [Structure.of(f, RATE) for f in free]
    s = structures[0].internal(NoiseModel((process,)))[1]
    (B, dB), (C, dC) = (structure.columns(m, s) for structure in structures)
    near(C, B, 1e-8)
    near(dC, dB, 1e-5)


def test_a_block_is_drawn_as_it_says() -> None:
    """Draws through the state block have its autocovariance: 400 records of 200 samples, five standard errors."""
    process = ARMA((1.2, -0.5), (0.3,), 1.0, RATE)
    rng = np.random.default_rng(5)
    x = np.empty((400, 200))
    for row in x:
        Process.source(process, row.size, DT, rng)(row)
    gamma = process.autocovariance(np.arange(4), DT)
    for lag in range(4):
        means = np.mean(x[:, : 200 - lag] * x[:, lag:], axis=1)
        assert abs(means.mean() - gamma[lag]) < 5.0 * means.std() / math.sqrt(400)
    first = np.mean(x[:, 0] ** 2)
    assert abs(first - gamma[0]) < 5.0 * gamma[0] * math.sqrt(2.0 / 400)


def test_refusals_name_the_estimator_and_the_reason() -> None:
    for process, method, word in (
        (RC(), "gmwm", "trace"),
        (BI(), "mli", "block"),
        (PROCESSES["PWC"](), "mli", "block"),
        (SIN(), "mli", "phase"),
        (DR(), "mli", "slope"),
    ):
        with pytest.raises(InputError, match=f"{process.symbol} cannot be fitted by {method}.*{word}"):
            process.refuse(method)


@pytest.mark.parametrize("name", ["QN", "MA", "ARMA", "SIN", "BI", "RC", "GM2", "PWC"])
def test_em_refuses_by_name(name: str) -> None:
    free = ROWS.get(name, PROCESSES[name]())
    structure = WN() + free.with_parameters(dict.fromkeys(free.given))
    x = WN(1e-3).simulate(400, DT, np.random.default_rng(1))
    with pytest.raises(InputError, match=f"{name} cannot be fitted by em: it has no closed update"):
        fit(x, structure, "em", rate_hz=RATE)


@pytest.mark.parametrize("name", ["GM2 slow", "AR", "QN"])
def test_a_process_augments_a_filter(name: str) -> None:
    """The error that a filter believes on an axis has the autocovariance of the process."""
    found = augment({"gyro_x": WN(1e-3) + ROWS[name]}, DT)
    own = found.axis == 0
    state, row = found.P0[np.ix_(own, own)], found.c[own]
    for gamma in ROWS[name].autocovariance(np.arange(5), DT):
        near(row @ state @ row, gamma, 1e-8)
        state = found.Phi[np.ix_(own, own)] @ state
    assert found.white[0] == pytest.approx(1e-6 / DT)


@pytest.mark.parametrize("samples", [1.0, 1.51, 2.0, 7.0, 20.371, 300.0])
def test_a_held_value_has_the_variances_of_its_autocovariance(samples: float) -> None:
    """Closed forms against sums over the triangular autocovariance; lags in samples."""
    process = PROCESSES["PWC"](2.0, samples * DT)
    gamma = process.autocovariance(np.arange(1200), DT)
    near(gamma, 4.0 * np.maximum(0.0, 1.0 - np.arange(1200) / samples), 1e-12)
    for m in (1, 2, 5, 13, 20, 100, 400):
        whole = np.convolve(np.r_[-np.ones(m), np.ones(m)], np.r_[np.ones(m), -np.ones(m)])
        near(process.allan_variance(m, DT), whole @ gamma[np.abs(np.arange(1 - 2 * m, 2 * m))] / (2.0 * m**2), 1e-10)
        mean = m - np.abs(np.arange(1 - m, m))
        near(process.mean_variance(m, DT), mean @ gamma[np.abs(np.arange(1 - m, m))] / m**2, 1e-10)
        apart = [mean @ gamma[np.abs(k * m + np.arange(1 - m, m))] / m**2 for k in range(4)] if m < 300 else None
        if apart is not None:
            want = [
                2.0 * (apart[0] - apart[1]),
                2.0 * apart[1] - apart[0] - apart[2],
                2.0 * apart[2] - apart[1] - apart[3],
            ]
            near(process.difference_covariance(m, DT, 3), np.array(want), 1e-9)
    f = (np.arange(4096) + 0.5) / 4096 / DT / 2.0
    integral = np.mean(process.psd(f, DT) * np.cos(2.0 * np.pi * np.outer(np.arange(8), f) * DT), axis=1) / DT
    near(integral, gamma[:8], 1e-9)


def test_held_values_are_drawn_from_any_instant_of_a_holding_time() -> None:
    """4,000 short records: steps of exactly the holding time, and the autocovariance of the ensemble within five standard errors."""
    process = PROCESSES["PWC"](2.0, 0.08)
    one = process.simulate(81, DT, np.random.default_rng(1))
    changes = np.flatnonzero(np.diff(one))
    assert (np.diff(changes) == 8).all() and changes.size == 10
    x = np.array([process.simulate(20, DT, r) for r in np.random.default_rng(2).spawn(4000)])
    for lag in (0, 3, 7, 8, 12):
        products = x[:, 2] * x[:, 2 + lag]
        want = 4.0 * max(0.0, 1.0 - lag / 8.0)
        assert abs(products.mean() - want) < 5.0 * products.std() / math.sqrt(4000)


def test_what_stands_for_held_values_in_a_filter_resembles_them_as_stated() -> None:
    process, m = PROCESSES["PWC"](2.0, 10.0), np.unique(np.geomspace(1.0, 1e5, 400).astype(int))
    ratio = process.block(DT).allan_variance(m) / process.allan_variance(m, DT)
    assert 0.83 < ratio.min() < 0.84 and 1.2 < ratio.max() < 1.21
    far = (m * DT < 1.8) | (m * DT > 250.0)
    assert np.abs(ratio[far] - 1.0).max() < 0.021
    found = augment({"gyro_x": WN(1e-3) + process}, DT)
    assert found.layout.names[9:] == ("gyro_x.PWC1", "gyro_x.PWC1.quadrature")


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
def test_the_moments_of_held_values_give_them_back() -> None:
    """Three records of 200 holding times: each of the parameters lies within four standard errors."""
    truth = WN(0.1) + PROCESSES["PWC"](0.05, 4.0)
    for rng in np.random.default_rng(3).spawn(3):
        found = fit(truth.simulate(16_000, 0.05, rng), "WN() + PWC()", rate_hz=20.0)
        assert found.converged
        for label, value in (("WN1.N", 0.1), ("PWC1.sigma", 0.05), ("PWC1.T", 4.0)):
            assert abs(found[label].value - value) < 4.0 * found[label].standard_error


def test_every_process_has_a_row() -> None:
    assert {p.symbol for p in ROWS.values()} >= {
        c.__name__ for c in PROCESSES.values() if c.__module__.startswith("insemu.")
    }


def test_rates_that_differ_by_rounding_are_one() -> None:
    assert len(AR1(0.9, 1e-6, 20.0) + AR1(0.5, 1e-6, 20.0 * (1.0 + 1e-12))) == 2
    with pytest.raises(InputError, match="different rates"):
        AR1(0.9, 1e-6, 20.0) + AR1(0.5, 1e-6, 20.001)


def test_the_mixing_vector_holds_levels_with_their_signs_and_roots_of_variances() -> None:
    models = {
        "x": NoiseModel.parse("GM(sigma=0.2, Tc=10 s, shared=warmth) + WN(N=0.1)", "rad/s"),
        "y": NoiseModel.parse("WN(N=0.1) + GM(sigma=0.3, Tc=10 s, shared=-warmth)", "rad/s"),
        "z": NoiseModel((AR((0.5,), sigma2=4.0, rate_hz=RATE, shared="-own"),)),
    }
    found = shared_processes(models)
    assert {name: [(m.axis, m.place, round(m.weight, 12)) for m in members] for name, members in found.items()} == {
        "warmth": [("x", 0, 0.2), ("y", 1, -0.3)],
        "own": [("z", 0, -2.0)],
    }


@pytest.mark.parametrize(
    ("y", "message"),
    [
        (
            "GM(sigma=0.3, Tc=10 s, shared=a) + GM(sigma=0.1, Tc=10 s, shared=-a)",
            "'a' stands twice in the model .* of y",
        ),
        (
            "GM(sigma=0.3, Tc=11 s, shared=a)",
            r"'a' is .* on x and .* on y, expected one process at different levels \(sigma\)",
        ),
        ("RW(K=0.3, shared=a)", "expected one process at different levels"),
    ],
)
def test_a_shared_process_is_one(y: str, message: str) -> None:
    models = {a: NoiseModel.parse(t, "rad/s") for a, t in (("x", "GM(sigma=0.2, Tc=10 s, shared=a)"), ("y", y))}
    with pytest.raises(InputError, match=message):
        shared_processes(models)


@pytest.mark.parametrize("a", [1e-6, 1e-3, 0.1, 1.0, 5.0])
def test_the_second_order_block_is_that_of_the_continuous_process(a: float) -> None:
    """Transition and driving covariance from the differential equation, by its power series in whole fractions."""
    step = Fraction(a)  # in units of the rate; the second state is the derivative over it
    F = np.array([[Fraction(0), step], [-step, -2 * step]], dtype=object)
    term = Phi = np.array([[Fraction(1), Fraction(0)], [Fraction(0), Fraction(1)]], dtype=object)
    for k in range(1, 60):
        term = term @ F / k
        Phi = Phi + term
    Q = np.eye(2, dtype=int) - Phi @ Phi.T
    block = PROCESSES["GM2"](2.0, a / DT).block(DT)
    np.testing.assert_allclose(block.Phi, Phi.astype(np.float64), rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(block.Q, 4.0 * Q.astype(np.float64), rtol=1e-11)
    np.testing.assert_array_equal(block.P0, 4.0 * np.eye(2))


@pytest.mark.parametrize(
    ("ar", "ma"),
    [
        ((0.6,), (0.5, -0.4, 0.3)),
        ((), (0.9, 0.5)),
        pytest.param((1.2, -0.5, 0.1), (0.4,), marks=pytest.mark.slow(reason="another case of a quick test")),
        pytest.param((0.8,), (), marks=pytest.mark.slow(reason="another case of a quick test")),
    ],
)
def test_the_first_samples_of_a_draw_have_the_autocovariance_already(
    ar: tuple[float, ...], ma: tuple[float, ...]
) -> None:
    """3,000 records of 6 samples: every product of two samples within five standard errors of the autocovariance."""
    process = ARMA(ar, ma, 1.5, RATE)
    x = np.array([process.simulate(6, DT, r) for r in np.random.default_rng(8).spawn(3000)])
    gamma = process.autocovariance(np.arange(6), DT)
    for i in range(6):
        for j in range(i + 1):
            products = x[:, i] * x[:, j]
            assert abs(products.mean() - gamma[i - j]) < 5.0 * products.std() / math.sqrt(3000)


def test_search_limits_hold_what_a_record_could_show() -> None:
    """From far beyond the record to below a sample, whatever the parameter is called."""
    n = 10_000

    def limits(process: Process, name: str) -> tuple[float, float]:
        meta = next(p for p in process.parameters_meta() if p.name == name)
        low, high = (meta.of_shape(v, DT) for v in meta.bounds(n))
        assert meta.bounds(10 * n)[1 if name in ("T", "phi") else 0] != meta.bounds(n)[1 if name in ("T", "phi") else 0]
        for value in (
            np.geomspace(low * 1.001, high * 0.999, 7) if low > 0 else np.linspace(low * 0.999, high * 0.999, 7)
        ):
            assert meta.of_shape(meta.shape(value, DT, "X"), DT) == pytest.approx(value, rel=1e-9)
        return low, high

    low, high = limits(GM(1.0, 1.0), "beta")
    assert 1.0 / low == pytest.approx(LONGEST_RECORDS * n * DT) and high * DT == pytest.approx(6.0)
    low, high = limits(PROCESSES["PWC"](1.0, 1.0), "T")
    assert (low, high) == pytest.approx((DT, n * DT))
    low, high = limits(AR1(0.5, 1.0, RATE), "phi")
    assert low == pytest.approx(-math.tanh(4.0)) and -1.0 / math.log(high) == pytest.approx(
        LONGEST_RECORDS * n, rel=1e-3
    )
    low, high = limits(SIN(1.0, 1.0), "f")
    assert low == pytest.approx(0.25 / (n * DT), rel=1e-4) and 0.99 * 0.5 * RATE < high < 0.5 * RATE
    for order in (1, 2, 4):
        free = ARMA((0.1,) * order, (0.2,), 1.0, RATE)
        assert len(free.shape_bounds(n)) == order + 1 == len(free.coordinates(DT)[1])
        assert all(len(point) == order + 1 for point in free.shape_grid(n, 1, np.random.default_rng(1)))


@pytest.mark.parametrize(
    "process", [AR1(0.5, 1.0, RATE), AR((0.5, 0.2), sigma2=1.0, rate_hz=RATE), GM(1.0, 2.0), RW(1.0)], ids=str
)
def test_what_moves_in_a_transition_is_what_the_parameters_move(process: Process) -> None:
    moving = process.moving()
    assert moving is not None
    here = process.block(DT)
    changed = [np.zeros_like(m) for m in moving]
    for name, value in process.parameters.items():
        there = process.with_parameters({name: 1.01 * value}).block(DT)
        changed[0] |= there.Phi != here.Phi
        changed[1] |= there.Q != here.Q
    for found, said in zip(changed, moving, strict=True):
        np.testing.assert_array_equal(found, said)
    back = process.of_transition(here.Phi, here.Q, DT)
    for name, value in process.parameters.items():
        assert back.parameters[name] == pytest.approx(value, rel=1e-9)


def test_a_discrete_process_keeps_the_rate_that_it_has() -> None:
    for process in (AR1(0.5, 1.0, 20.0), ARMA((0.5,), (0.2,), 1.0, 20.0)):
        assert process.at_rate(RATE).carried_rate_hz == 20.0
    assert ARMA((0.5,), (0.2,), 1.0).at_rate(RATE).carried_rate_hz == RATE
