"""The test of two signals having one model: its false alarms and its power."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom
from typer.testing import CliRunner

from insemu.cli import app
from insemu.errors import InputError
from insemu.noise import NoiseModel
from insemu.variance import same_model, wavelet_variance


def p_values(first: str, second: str, draws: int, *, lost: float = 0.0) -> NDArray[np.float64]:
    """p-values of pairs of signals of two models; of the second a share of samples is missing."""
    one, two = NoiseModel.parse(first, ""), NoiseModel.parse(second, "")
    out = []
    for child in np.random.default_rng(9).spawn(draws):
        x, y = one.simulate(4000, 0.01, child), two.simulate(3000, 0.01, child)
        y[child.random(y.size) < lost] = np.nan
        out.append(same_model(wavelet_variance(x, 100.0), wavelet_variance(y, 100.0, gaps=True)).p_value)
    return np.array(out)


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
@pytest.mark.parametrize("lost", [0.0, 0.3])
@pytest.mark.parametrize("model", ["WN(N=0.01)", "GM(sigma=0.02, Tc=0.2 s) + WN(N=0.001)"])
def test_false_alarms_are_as_stated(model: str, lost: float) -> None:
    alarms = int((p_values(model, model, 150, lost=lost) < 0.05).sum())
    assert binom.ppf(1e-3, 150, 0.03) <= alarms <= binom.ppf(1 - 1e-3, 150, 0.07)


def test_another_level_and_another_time_constant_are_found() -> None:
    assert (p_values("WN(N=0.01)", "WN(N=0.0115)", 20) < 0.05).mean() >= 0.9
    text = "GM(sigma=0.02, Tc={} s) + WN(N=0.001)"
    assert (p_values(text.format(0.2), text.format(0.5), 20) < 0.05).mean() >= 0.9


def test_the_command_compares_two_logs(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    for name, size in (("a", 1.0), ("b", 1.0), ("c", 1.3)):
        x = 0.01 * size * rng.normal(size=4000)
        np.savez(tmp_path / f"{name}.npz", data=x[:, None], fs=100.0, columns=["gx"], units=["rad/s"])
    said = {}
    for other in "bc":
        arguments = ["characterise", str(tmp_path / "a.npz"), "--same-as", str(tmp_path / f"{other}.npz"), "--json"]
        run = CliRunner().invoke(app, arguments)
        assert run.exit_code == 0, run.output
        said[other] = json.loads(run.stdout)["same_model"]["axes"]["gx"]
    assert said["b"]["p_value"] > 0.01 > said["c"]["p_value"]
    assert said["c"]["high"] < 1.0  # the first has the smaller variance


def test_curves_of_two_rates_are_refused() -> None:
    x = np.random.default_rng(1).normal(size=500)
    with pytest.raises(InputError, match="one rate"):
        same_model(wavelet_variance(x, 100.0), wavelet_variance(x, 50.0))
