"""Methods that read a curve: slopes of PSD, Hadamard and total variance, and the autocorrelation; on simulation, with their intervals."""

from __future__ import annotations

import numpy as np
import pytest

from insemu.errors import InputError
from insemu.fit import fit
from insemu.noise import BI, DR, GM, RW, WN, NoiseModel, Process
from tests.budget import binomial, binomial_power, statistical

WALK_RAMP = WN(0.2) + RW(0.02) + DR(0.003)  # figure 2 of Stebler et al. 2011, 6000 samples
HUMP = WN(0.1) + GM(0.3, 0.5) + RW(0.04)
DRAWS = 60


def readings(model: NoiseModel, method: str, n: int, rate: float, **options: object) -> tuple[np.ndarray, np.ndarray]:
    """Estimates over truth, and how many intervals hold the truth, per parameter of a fit with the model's structure."""
    truth = np.array([v for p in model for v in p.parameters.values()])
    structure = NoiseModel(tuple(type(p)() for p in model))
    found, inside = [], []
    for rng in np.random.default_rng(31).spawn(DRAWS):
        result = fit(model.simulate(n, 1.0 / rate, rng), structure, method, rate_hz=rate, **options)  # type: ignore[arg-type]
        found.append([e.value for e in result.parameters])
        inside.append([e.low <= t <= e.high for e, t in zip(result.parameters, truth, strict=True)])
    return np.array(found) / truth, np.sum(inside, axis=0)


@pytest.mark.parametrize(
    ("model", "method", "n", "rate", "options"),
    [
        (WALK_RAMP, "hadamard-slopes", 6000, 1.0, {}),
        (WALK_RAMP, "total-slopes", 6000, 1.0, {}),
        (WN(0.2) + RW(0.02), "psd-slopes", 6000, 1.0, {}),
        pytest.param(
            HUMP, "psd-slopes", 30_000, 5.0, {}, marks=pytest.mark.slow(reason="another case of a quick test")
        ),
        pytest.param(
            HUMP, "hadamard-slopes", 30_000, 5.0, {}, marks=pytest.mark.slow(reason="another case of a quick test")
        ),
        (NoiseModel((GM(0.3, 0.05),)), "autocorrelation", 60_000, 10.0, {}),
        pytest.param(
            GM(0.3, 0.05) + WN(0.1),
            "autocorrelation",
            60_000,
            10.0,
            {},
            marks=pytest.mark.slow(reason="another case of a quick test"),
        ),
        (
            GM(0.3, 0.05) + WN(0.3),
            "autocorrelation",
            60_000,
            10.0,
            {"denoise_levels": 5, "denoise_rule": "approximation"},
        ),
    ],
    ids=lambda v: str(v) if isinstance(v, str | NoiseModel) else "",
)
@statistical(2e-5, 4, power=binomial_power(DRAWS, 0.95, 2e-5, 4, 0.5))  # intervals that hold half of the times
def test_nothing_is_lost_and_intervals_hold_the_truth(model, method, n, rate, options):
    ratio, inside = readings(model, method, n, rate, **options)
    assert (ratio > 0).all()
    assert np.abs(np.log(np.median(ratio, axis=0))).max() < 0.15
    assert inside.min() >= binomial(DRAWS, 0.95, 2e-5, 4)[0]


def test_flicker_is_read_alike_off_psd_and_allan_variance():
    x = (WN(0.01) + BI(0.05)).simulate(200_000, 0.01, np.random.default_rng(32))
    by_psd, by_allan, by_hadamard = (
        fit(x, "WN() + BI()", method, rate_hz=100.0)["BI1.B"].value
        for method in ("psd-slopes", "slopes", "hadamard-slopes")
    )
    assert by_psd == pytest.approx(0.05, rel=0.1)
    assert by_allan == pytest.approx(0.05, rel=0.15)
    assert by_hadamard == pytest.approx(0.05, rel=0.1)


def test_a_law_that_is_not_there_is_zero_and_said():
    result = fit(
        WN(0.1).simulate(20_000, 0.1, np.random.default_rng(33)), "WN() + RW() + GM()", "psd-slopes", rate_hz=10.0
    )
    assert result["RW1.K"].value == 0.0 and result["GM1.sigma"].value == 0.0
    assert not result.converged and sum("set to zero" in w for w in result.warnings) == 2
    alone = WN(0.1).simulate(20_000, 0.1, np.random.default_rng(34))
    with pytest.raises(InputError, match="white noise hides"):
        fit(alone, "GM()", "autocorrelation", rate_hz=10.0, denoise_levels=6)


def test_an_autocorrelation_that_white_noise_hides_is_refused_or_zero():
    """Of 2^17 samples at 100 Hz: beta was 1000 times off and stated; where there was no line, white noise was zero, too."""
    truth = WN(0.1) + GM(0.1, 0.1)
    for seed in range(6):
        x = truth.simulate(2**17, 0.01, np.random.default_rng(seed))
        try:
            result = fit(x, "GM() + WN()", "autocorrelation", rate_hz=100.0)
        except InputError as error:
            assert "white noise hides the autocorrelation" in str(error)
            continue
        assert result["WN1.N"].value == pytest.approx(0.1, rel=0.02)
        assert not result.converged or 0.05 < result["GM1.beta"].value < 0.2
    with pytest.raises(InputError, match="white noise hides"):
        fit(truth.simulate(2**17, 0.01, np.random.default_rng(1)), "GM() + WN()", "autocorrelation", rate_hz=100.0)


def test_given_values_are_held():
    x = HUMP.simulate(30_000, 0.2, np.random.default_rng(35))
    result = fit(x, "WN(N=0.1) + GM(Tc=2 s) + RW()", "psd-slopes", rate_hz=5.0)
    assert result["WN1.N"].value == 0.1 and not result["WN1.N"].free
    assert result["GM1.beta"].value == pytest.approx(0.5)
    assert result["GM1.sigma"].value == pytest.approx(0.3, rel=0.1)
    assert [e.label for e in result.parameters if e.free] == ["GM1.sigma", "RW1.K"]
    result = fit(x, "WN() + GM(Tc=3 s)", "slopes", rate_hz=5.0)
    assert result["GM1.beta"].value == pytest.approx(1.0 / 3.0) and not result["GM1.beta"].free
    assert result["GM1.sigma"].value > 0.0


@pytest.mark.parametrize(
    ("model", "method", "said"),
    [
        ("WN() + DR()", "psd-slopes", "DR cannot be read off the psd curve"),
        ("WN() + GM()", "total-slopes", "GM cannot be read off the total curve"),
        ("AR(2)", "hadamard-slopes", "AR cannot be read"),
        ("2*GM() + WN()", "psd-slopes", "cannot separate 2 GM"),
        ("WN() + GM(sigma=0.1)", "hadamard-slopes", "a correlation time alone is not read"),
        ("WN() + RW()", "autocorrelation", "expected GM\\(\\) or GM\\(\\) \\+ WN\\(\\)"),
        ("GM(Tc=3 s)", "autocorrelation", "gives one Gauss-Markov noise"),
    ],
)
def test_what_a_curve_does_not_show_is_refused(model, method, said):
    x = WN(0.1).simulate(4096, 1.0, np.random.default_rng(36))
    with pytest.raises(InputError, match=said):
        fit(x, model, method, rate_hz=1.0)


def expected_hadamard(p: Process, m: int) -> float:
    gamma = p.difference_covariance(m, 1.0, 2)
    return float(gamma[0] - gamma[1]) / 3.0


def test_the_law_of_the_hadamard_variance_is_that_of_many_records():
    """N^2 / tau of white noise and K^2 tau / 6 (1 + 1/m^2) of a random walk (NIST SP 1065)."""
    for m in (1, 2, 8, 64):
        assert expected_hadamard(WN(2.0), m) == pytest.approx(4.0 / m, rel=1e-9)
        assert expected_hadamard(RW(2.0), m) == pytest.approx(4.0 * m / 6.0 * (1.0 + 1.0 / m**2), rel=1e-9)
