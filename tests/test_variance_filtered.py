"""Wavelet variances of filters other than Haar: expectation, covariance, intervals, and models fitted to them.

``python -m tests.test_variance_filtered [--draws 2000] [--filters d4,battle2]`` prints the coverage of the 95 % intervals of every filter.
"""

import argparse
import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from insemu.cli import app
from insemu.errors import InputError
from insemu.fit import fit
from insemu.noise import DR, GM, RW, SIN, WN, NoiseModel
from insemu.variance import level1_autocovariance, model_edof, wavelet_variance
from insemu.variance.filtered import _bins, expected_variance, filter_covariance
from insemu.variance.filters import FILTERS, modwt_filters
from tests.wavelet_oracles import model_covariance_of_filter

N = 20_000
MODELS = {"WN": NoiseModel((WN(1.0),)), "GM": NoiseModel((GM(1.0, 0.02),)), "RW": NoiseModel((RW(1.0),))}


@pytest.mark.parametrize("filter", ["d4", "d8", "d16", "la8", "mb16", "fk14", "bl14"])
@pytest.mark.parametrize("name", ["WN", "GM"])
def test_the_covariance_is_the_exact_sum(name: str, filter: str) -> None:
    """Against the sum over all pairs of coefficients by convolution, which needs an autocovariance."""
    model, levels = MODELS[name], 8
    exact = model_covariance_of_filter(lambda lag: model.autocovariance(lag, 1.0), N, filter=filter, levels=levels)
    found = filter_covariance(model, filter, 2 ** np.arange(1, levels + 1), N)
    sd = np.sqrt(np.diag(exact))
    np.testing.assert_allclose(np.diag(found), np.diag(exact), rtol=5e-3)
    assert np.abs((found - exact) / np.outer(sd, sd)).max() < 0.01  # correlations, in the limit of long records


def integrated(filter: str, j: int) -> np.ndarray:
    """What an octave does to the increments of a signal: the running sum of its own coefficients."""
    h, g = modwt_filters(filter)
    out = spread(h, 1 << (j - 1))
    for i in range(j - 1):
        out = np.convolve(out, spread(g, 1 << i))
    return np.asarray(np.cumsum(out))


def spread(taps: np.ndarray, step: int) -> np.ndarray:
    out = np.zeros((taps.size - 1) * step + 1)
    out[::step] = taps
    return out


@pytest.mark.parametrize("filter", FILTERS[1:])
def test_a_random_walk_through_a_filter_is_the_exact_sum(filter: str) -> None:
    """Filters of one vanishing moment let a share of it through at frequency zero: without it fk4 was 1.3 % low."""
    walk = NoiseModel((RW(1.0),))
    octaves = (1, 2, 4, 6)
    scale = [1 << j for j in octaves]
    own = [integrated(filter, j) for j in octaves]
    exact = np.array([a @ a for a in own])
    np.testing.assert_allclose(expected_variance(walk, filter, scale), exact, rtol=2e-4)
    for s, value in zip(scale, exact, strict=True):
        f, weight = _bins(filter, s)
        assert weight @ walk.psd(f, 1.0) == pytest.approx(value, rel=5e-4)
    n = 1_000_000  # long: off the diagonal the limit is stated
    found = filter_covariance(walk, filter, scale, n)
    for i, a in enumerate(own):
        for k, b in enumerate(own):
            together = 2.0 * np.sum(np.correlate(a, b, "full") ** 2) / (n - max(a.size, b.size))
            assert found[i, k] == pytest.approx(together, rel=0.01)


@pytest.mark.parametrize("filter", ["d4", "la8", "battle4"])
def test_the_expectation_is_the_mean_of_draws(filter: str) -> None:
    dt = 0.01
    model = WN(1e-3) + GM(3e-3, 2.0) + RW(1e-3)
    scale = 2 ** np.arange(1, 7)
    values = np.array(
        [
            wavelet_variance(model.simulate(4096, dt, np.random.default_rng(k)), 1 / dt, filter=filter, levels=6).value
            for k in range(100)
        ]
    )
    z = (values.mean(axis=0) - expected_variance(model, filter, scale, dt)) / (values.std(axis=0) / math.sqrt(100))
    assert np.abs(z).max() < 4.0
    assert not np.allclose(
        expected_variance(model, filter, scale, dt), expected_variance(model, "haar", scale, dt), rtol=0.02
    )


@pytest.mark.parametrize("filter", ["d8", "mb16"])
def test_the_quadrature_of_a_search_is_the_integral(filter: str) -> None:
    for model in (GM(1.0, 0.05), RW(1.0), WN(1.0)):
        for j in (1, 4, 9):
            f, weight = _bins(filter, 1 << j)
            assert weight @ model.psd(f, 1.0) == pytest.approx(expected_variance(model, filter, [1 << j])[0], rel=2e-3)


@pytest.mark.parametrize(
    "filter",
    [
        "d16",
        "fk14",
        *(pytest.param(f, marks=pytest.mark.slow(reason="another case of a quick test")) for f in ("d8", "mb16")),
    ],
)
def test_stated_degrees_of_freedom_are_the_true_ones(filter: str) -> None:
    """They were up to 2.7 times the true ones. Mean of 40 records against 2 v^2 / var, within 8 % above 8."""
    for model in MODELS.values():
        curves = [wavelet_variance(model.simulate(N, 1.0, np.random.default_rng(k)), filter=filter) for k in range(40)]
        scale = curves[0].scale_samples
        true = 2.0 * expected_variance(model, filter, scale) ** 2 / np.diag(filter_covariance(model, filter, scale, N))
        stated = np.mean([c.edof for c in curves], axis=0)
        enough = true > 8.0
        np.testing.assert_allclose(stated[enough], true[enough], rtol=0.08)


@pytest.mark.parametrize("filter", FILTERS)
def test_a_signal_that_long_octaves_see_nothing_of_has_a_curve(filter: str) -> None:
    """Alternating samples, all of whose power is at half the rate: a division by zero for filters of six taps and more."""
    curve = wavelet_variance(np.arange(N) % 2.0, filter=filter)
    assert (curve.edof >= 1.0).all() and (curve.low <= curve.value).all() and (curve.value <= curve.high).all()


def coverage(filter: str, model: NoiseModel, draws: int) -> tuple[np.ndarray, np.ndarray]:
    """Degrees of freedom under the model, and the share of draws whose 95 % interval holds the truth, scales of more than 8 of them."""
    scale = wavelet_variance(np.arange(N) % 2.0, filter=filter).scale_samples
    true = expected_variance(model, filter, scale)
    if filter == "haar":
        dof = model_edof(level1_autocovariance(N, psd=lambda f: model.psd(f, 1.0)), true)
    else:
        dof = 2.0 * true**2 / np.diag(filter_covariance(model, filter, scale, N))
    hits = np.zeros(true.size)
    for k in range(draws):
        curve = wavelet_variance(model.simulate(N, 1.0, np.random.default_rng([k, 1])), filter=filter)
        hits += (curve.low <= true) & (true <= curve.high)
    return dof[dof > 8.0], hits[dof > 8.0] / draws


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
@pytest.mark.parametrize("filter", ["d4", "d8", "d16", "la8", "mb16", "fk14", "bl14", "battle4"])
def test_intervals_hold_the_truth(filter: str) -> None:
    """95 % intervals hold it in 93 to 97 % of 2,000 draws at every scale of more than 8 degrees of freedom."""
    for model in MODELS.values():
        share = coverage(filter, model, 2000)[1]
        assert share.min() >= 0.93 and share.max() <= 0.97, share


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
def test_a_model_is_fitted_to_any_filter() -> None:
    truth = WN(1e-3) + GM(2e-3, 0.2)
    x = truth.simulate(100_000, 0.01, np.random.default_rng(3))
    for filter in ("d4", "la8"):
        result = fit(x, "WN() + GM()", rate_hz=100.0, wavelet=filter)
        assert result.converged and result.curve is not None and result.curve.filter == filter
        assert result.test is not None and result.test.p_value > 1e-3
        for e, value in zip(result.parameters, (1e-3, 2e-3, 0.2), strict=True):
            assert abs(math.log(e.value / value)) < 4.0 * e.standard_error / e.value
        np.testing.assert_allclose(
            result.fitted, expected_variance(result.model, filter, result.curve.scale_samples, 0.01)
        )


def test_what_cannot_be_fitted_is_refused_by_name() -> None:
    x = WN(1.0).simulate(4096, 1.0, np.random.default_rng(1))
    for structure, word in ((WN() + SIN(), "SIN"), (WN() + DR(), "DR")):
        with pytest.raises(InputError, match=f"{word}.*filter 'd8'"):
            fit(x, structure, rate_hz=1.0, wavelet="d8")
    with pytest.raises(InputError, match="belongs to gmwm"):
        fit(x, "WN()", "mli", rate_hz=1.0, wavelet="d8")


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
def test_a_robust_fit_has_the_efficiency_that_is_asked_for() -> None:
    rng = np.random.default_rng(4)
    x = WN(1.0).simulate(20_000, 1.0, rng)
    x[rng.random(x.size) < 0.01] *= 12.0
    low, high = (fit(x, "WN()", rate_hz=1.0, robust=True, efficiency=e) for e in (0.5, 0.9))
    assert low.details["robust_efficiency"] == 0.5 and high.details["robust_efficiency"] == 0.9
    assert low["WN1.N"].value != high["WN1.N"].value  # it was the same, and only the standard errors were rescaled


def test_the_commands_take_a_filter_and_columns_alike(tmp_path) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(6)
    rows = np.column_stack([np.arange(4000) / 100.0, *(WN(1e-3).simulate(4000, 0.01, rng) for _ in range(3))])
    log = tmp_path / "log.csv"
    np.savetxt(log, rows, delimiter=",", header="t [s],gx [rad/s],gy [rad/s],gz [rad/s]", comments="")
    for command in (
        ["fit", str(log), "--model", "WN()", "--wavelet", "d6", "-c", "gx,gy"],
        ["characterise", str(log), "--wavelet", "d6", "-c", "gx,gy"],
        ["select", str(log), "--general", "WN() + RW()", "-c", "gx,gy"],
    ):
        result = CliRunner().invoke(app, [*command, "--json"])
        assert result.exit_code == 0, result.output
        content = json.loads(result.stdout)
        assert len(content["axes"]) == 2
    refused = CliRunner().invoke(app, ["fit", str(log), "--model", "WN()", "--wavelet", "d5"])
    assert refused.exit_code != 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--draws", type=int, default=2000)
    parser.add_argument("--filters", default=",".join(FILTERS))
    asked = parser.parse_args()
    print(
        f"{N} samples, {asked.draws} draws; share of 95 % intervals that hold the truth, %, scales of more than 8 degrees of freedom"
    )
    print("bounds asked: 93 to 97 at every scale", flush=True)
    outside: list[str] = []
    for filter in asked.filters.split(","):
        for name, model in MODELS.items():
            dof, share = coverage(filter, model, asked.draws)
            bad = bool(share.min() < 0.93 or share.max() > 0.97)
            outside += [f"{filter} {name}"] * bad
            print(
                f"{filter:8} {name:3} {100 * share.mean():5.1f}  " + " ".join(f"{100 * c:5.1f}" for c in share)
                + f"  (longest: {dof[-1]:.0f} degrees of freedom)" + "  OUTSIDE" * bad,
                flush=True,
            )  # fmt: skip
    print(f"outside: {', '.join(outside) or 'none'}")
