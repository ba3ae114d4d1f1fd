"""Wavelet moments of records with missing samples."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom, norm, t
from typer.testing import CliRunner

from insemu.cli import app
from insemu.errors import InputError
from insemu.fit import fit
from insemu.formats import read_log
from insemu.noise import NoiseModel
from insemu.records import Series
from insemu.variance import allan_variance, wavelet_variance
from insemu.variance.gaps import haar_with_gaps
from tests.budget import statistical
from tests.missing_experiments import MODELS, RATE, coefficients, covariance, coverage, lost


def test_without_missing_samples_it_is_the_plain_estimate() -> None:
    x = np.random.default_rng(1).normal(size=4000).cumsum()
    found = haar_with_gaps(x, 0.0, 8)
    assert found is not None
    plain = wavelet_variance(x, levels=8)
    np.testing.assert_allclose(found.value[:4], plain.value[:4], rtol=1e-9)  # every coefficient
    np.testing.assert_allclose(found.value, plain.value, rtol=0.02)  # some positions
    np.testing.assert_allclose(found.inflation, 1.0, rtol=0.02)


#: Octaves that are looked at, share of false alarms of one case, and its records.
OCTAVES, SHARE, DRAWS = 7, 1e-5, 40
#: Bias that is allowed beside chance, in standard deviations of one record: the noise type is read off the curve itself.
BIAS = 0.2


@pytest.mark.parametrize("text", list(MODELS))
@statistical(
    SHARE, OCTAVES, power=float(norm.sf(norm.isf(0.5 * SHARE / OCTAVES) - (5.0 - BIAS) * np.sqrt(DRAWS)))
)  # an octave off by 5 standard deviations of a record: samples missing one by one make it 5 and more at 4 octaves
def test_it_is_unbiased(text: str) -> None:
    model = NoiseModel.parse(text, "")
    curves = []
    for child in np.random.default_rng(7).spawn(DRAWS):
        x = model.simulate(3000, 1.0 / RATE, child)
        x[lost("single", x.size, child)] = np.nan
        curves.append(wavelet_variance(x, RATE, gaps=True))
    scale = curves[0].scale_samples[:OCTAVES]
    value = np.array([c.value[:OCTAVES] for c in curves]) / model.wavelet_variance(scale, 1.0 / RATE)
    limit = t.isf(0.5 * SHARE / OCTAVES, DRAWS - 1) / np.sqrt(DRAWS) + BIAS
    assert (np.abs(value.mean(axis=0) - 1.0) < limit * value.std(axis=0, ddof=1)).all()


@pytest.mark.parametrize("kind", ["single", "stretches"])
@pytest.mark.parametrize("text", list(MODELS))
def test_mean_and_scatter_are_those_of_the_samples_that_are_there(text: str, kind: str) -> None:
    """Against exact mean and variance of the mean square y of the coefficients G of a known noise: tr G and 2 tr(G G).

    The factor of y is nearly the same for every record, which the noise type that is read off the curve changes. Of single missing samples the
    stated variance holds what that adds: there it is larger than the exact one, never smaller.
    """
    model = NoiseModel.parse(text, "")
    mean, scatter = [], []
    for child in np.random.default_rng(7).spawn(3):
        missing = lost(kind, 1500, child, mean=60.0)
        D = [coefficients(missing, j) for j in range(OCTAVES)]
        factor, stated = [], []
        for own in child.spawn(6):
            x = model.simulate(missing.size, 1.0 / RATE, own)
            curve = wavelet_variance(np.where(missing, np.nan, x), RATE, gaps=True)
            factor.append(curve.value[:OCTAVES] / [np.mean((d @ x) ** 2) for d in D])
            stated.append(2.0 / curve.edof[:OCTAVES])
        noise = covariance(model, missing.size)
        G = [d @ (d @ noise).T for d in D]
        exact = np.array([[np.trace(g) / len(g), 2.0 * np.sum(g * g) / np.trace(g) ** 2] for g in G])
        whole = model.wavelet_variance(curve.scale_samples[:OCTAVES], 1.0 / RATE)
        mean.append(np.mean(factor, axis=0) * exact[:, 0] / whole)
        scatter.append(exact[:, 1] / np.mean(stated, axis=0))
    if kind == "stretches":
        np.testing.assert_allclose(np.mean(mean, axis=0), 1.0, atol=0.025)  # a half is looked at by its eighths
        np.testing.assert_allclose(np.mean(scatter, axis=0), 1.0, atol=0.15)
    else:
        np.testing.assert_allclose(np.mean(mean, axis=0), 1.0, atol=0.1)
        assert ((0.5 < np.mean(scatter, axis=0)) & (np.mean(scatter, axis=0) < 1.05)).all()


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
@pytest.mark.parametrize("kind", ["single", "stretches"])
def test_intervals_hold_the_truth(kind: str) -> None:
    scales, n, parameters, m = coverage("GM(sigma=0.02, Tc=2 s) + WN(N=0.01)", kind, 40, 8000, 3)
    for share, number in ((scales, n), (parameters, m)):
        assert share * number >= binom.ppf(1e-4, number, 0.92)


def test_filters_with_missing_samples_agree_with_the_model() -> None:
    model = NoiseModel.parse("GM(sigma=0.02, Tc=2 s) + WN(N=0.01)", "")
    values = []
    for child in np.random.default_rng(5).spawn(30):
        x = model.simulate(6000, 1.0 / RATE, child)
        whole = wavelet_variance(x, RATE, filter="d4", levels=5)
        x[lost("single", x.size, child)] = np.nan
        values.append(wavelet_variance(x, RATE, filter="d4", gaps=True).value[:5] / whole.value)
    assert (np.abs(np.mean(values, axis=0) - 1.0) < 4.0 * np.std(values, axis=0) / np.sqrt(30)).all()


def test_the_allan_variance_is_twice_the_curve() -> None:
    x = np.random.default_rng(2).normal(size=2000)
    x[5::7] = np.nan
    curve, allan = wavelet_variance(x, RATE, gaps=True), allan_variance(x, RATE, gaps=True)
    np.testing.assert_allclose(allan.value, 2.0 * curve.value)
    with pytest.raises(InputError, match="overlapping"):
        allan_variance(x, RATE, kind="modified", gaps=True)


@pytest.mark.parametrize("period", [3, 7, 20])
def test_samples_lost_in_a_rhythm_do_not_bias_the_curve(period: int) -> None:
    """A walk against its own complete record, of lengths at which coefficients looked at evenly would meet the losses in step."""
    for n in (512 * period + 300, 1024 * period + 400):
        x = np.random.default_rng(4).normal(size=n).cumsum() + 1e3
        whole = wavelet_variance(x, RATE, levels=6)
        x[1::period] = np.nan
        np.testing.assert_allclose(wavelet_variance(x, RATE, gaps=True, levels=6).value, whole.value, rtol=0.06)


def test_a_beginning_that_is_lost_changes_nothing() -> None:
    x = np.random.default_rng(4).normal(size=4000).cumsum() + 1e3
    curve, late = (wavelet_variance(np.append(np.full(n, np.nan), x), RATE, gaps=True, levels=6) for n in (1, 2048))
    np.testing.assert_allclose(late.value, curve.value, rtol=0.01)


def test_gaps_are_never_taken_in_silence() -> None:
    x = np.random.default_rng(2).normal(size=2000)
    x[100] = np.nan
    for call in (
        lambda: wavelet_variance(x),
        lambda: Series(x, RATE),
        lambda: fit(Series(x, RATE, gaps=True), "WN()", method="em"),
        lambda: fit(Series(x, RATE, gaps=True), "WN()", robust=True),
    ):
        with pytest.raises(InputError, match=r"not finite|missing"):
            call()
    with pytest.raises(InputError, match="2 samples that are finite"):
        wavelet_variance([np.nan, 1.0, 2.0, np.nan], gaps=True)


def test_a_log_with_gaps_is_fitted_and_says_so(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    n = 6000
    x = NoiseModel.parse("WN(N=0.001)", "rad/s").simulate(n, 0.01, rng)
    keep = ~lost("stretches", n, rng)
    path = tmp_path / "log.csv"
    rows = np.column_stack([np.arange(n) / 100.0, x])[keep]
    np.savetxt(path, rows, fmt="%.9g", delimiter=",", header="t [s],gx [rad/s]", comments="")
    (series,) = read_log(path).series(gaps=True)
    assert len(series) == int(np.flatnonzero(keep)[-1] - np.flatnonzero(keep)[0]) + 1
    assert series.missing == len(series) - int(keep.sum())
    run = CliRunner().invoke(app, ["fit", str(path), "--model", "WN()", "--page", str(tmp_path / "p.html")])
    assert run.exit_code == 0, run.output
    assert "nothing is filled in" in run.output + run.stderr
    assert "Mend" not in run.output + run.stderr  # nor is the log to be cut: its fit takes gaps of any length
    run = CliRunner().invoke(app, ["characterise", str(path), "--output", str(tmp_path / "c")])
    assert run.exit_code == 0, run.output
    assert "missing: " in run.output
    with pytest.raises(InputError, match="gap"):
        read_log(path).series()


def test_a_clock_that_jumps_for_a_year_is_no_gap(tmp_path: Path) -> None:
    t = np.concatenate([np.arange(50), 3e7 + np.arange(50)]) / 100.0
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack([t, np.zeros(100)]), delimiter=",", header="t [s],gx [rad/s]", comments="")
    with pytest.raises(InputError, match="cut the file there"):
        read_log(path).series(gaps=True)
