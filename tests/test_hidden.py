"""Hidden quantities of Table III: mean lengths, likelihood and intervals against closed forms; settings are found again from cells made of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from benchmarks.papers import hidden
from benchmarks.papers.hidden import BESIDE, Reading, deviance, fitted, mean_length

BIASES = hidden.BIASES["gyro"]
READING = Reading("made", factors=tuple(np.linspace(1.0, 4.0, 13)), begins=tuple(np.linspace(0.0, 6.0, 7)))


def _cells(begin: float, factor: float, bias: float) -> np.ndarray:
    """A filter that learns a constant from zero: what is left of it falls by 1 / cosh."""
    learnt = np.cosh(factor * 4e-4 * (60.0 * np.array([7.0, 11.0, 15.0]) - 60.0 * begin))
    return 8000.0 * bias * np.stack([np.ones(3), np.full(3, 0.99), 1.0 / learnt])


def test_mean_lengths_of_gaussian_vectors_are_those_of_rayleigh_and_half_normal() -> None:
    found = mean_length(np.array([np.diag([4.0, 4.0]), np.diag([9.0, 0.0])]))
    assert found == pytest.approx([2.0 * math.sqrt(math.pi / 2), 3.0 * math.sqrt(2 / math.pi)], rel=1e-4)
    draws = np.random.default_rng(1).multivariate_normal([0, 0], [[5.0, 2.0], [2.0, 1.5]], 200_000)
    assert mean_length(np.array([[5.0, 2.0], [2.0, 1.5]])) == pytest.approx(
        np.linalg.norm(draws, axis=1).mean(), rel=5e-3
    )


def test_deviances_are_those_of_a_normal_distribution_at_the_best_error_beside_sampling() -> None:
    rng = np.random.default_rng(2)
    root = 0.1 * rng.standard_normal((9, 9))
    covariance, cells = root @ root.T, np.exp(rng.standard_normal((3, 3)))
    printed = cells * np.exp(0.2 * rng.standard_normal((3, 3)))
    off = np.log(printed / cells).ravel()
    every = [-2.0 * multivariate_normal(np.zeros(9), covariance + b**2 * np.eye(9)).logpdf(off) for b in BESIDE]
    assert deviance(cells, printed, covariance) == pytest.approx(min(every) - 9.0 * math.log(2.0 * math.pi))


def test_a_setting_is_found_again_from_cells_that_it_made() -> None:
    sampling = 0.01 * (0.95 + 0.05 * np.eye(9))
    table = np.array([[[_cells(b, f, s) for s in BIASES] for f in READING.factors] for b in READING.begins])
    truth = (READING.begins[5], READING.factors[8], float(BIASES[30]))
    printed = _cells(*truth) * np.exp(0.002 * np.random.default_rng(3).standard_normal((3, 3)))
    found = fitted(READING, printed, sampling, table)
    assert (found.begin, found.factor) == pytest.approx(truth[:2])
    assert found.rms < 0.1 and found.cells == pytest.approx(_cells(found.begin, found.factor, found.bias))
    for name, value in zip(("begin", "factor", "bias"), truth, strict=True):
        low, high = found.intervals[name]
        assert low < value < high
    # of 24 means that move together the level is known to a tenth, their ratios much better
    low, high = found.intervals["bias"]
    assert 0.15 < math.log(high / low) < 0.8
    assert found.correlation["begin", "factor"] > 0.5 > abs(found.correlation["factor", "bias"])
    assert [row[0] for row in found.estimates()] == [what for what, _, _ in found.values.values()]
    worse = fitted(Reading("r", factors=(1.0,)), printed, sampling, table[:1, :1])
    assert (
        worse.deviance > found.deviance + 10.0 and worse.reading.quantities == 1 and worse.row(found.deviance)[0] == "r"
    )


def test_intervals_are_open_where_the_likelihood_does_not_end() -> None:
    values, profile = np.arange(5.0), np.array([4.0, 2.0, 0.0, 1.0, 1.0])
    low, high = hidden._inside(values, profile, 3.0)
    assert low == pytest.approx(0.5) and high == math.inf


def test_rivals_change_what_they_are_named_for_and_leave_the_scenario_as_it_is() -> None:
    whole = hidden.base()
    assert not any(p["process"] == "RC" for p in whole["truth"]["gyro"]) and whole["trajectory"]["begin"] == "0 s"
    for reading in hidden.RIVALS:
        changed = hidden.base()
        reading.change(changed)
        hidden.experiment(changed)  # can be read
        default = [p["beta"] for p in changed["truth"]["gyro"] if "beta" in p]
        assert default == [p["beta"] for p in whole["truth"]["gyro"] if "beta" in p]
    hidden._slow(changed := hidden.base(), 2.0)
    assert changed["designs"]["model 3"]["gyro"][1]["sigma"] == "0.001728 deg/s"


def test_a_bias_adds_its_own_parabola_and_a_filter_from_the_scenario_learns_it() -> None:
    document = hidden.base()
    hidden._slow(document, 3.0)
    e = hidden.experiment(document)
    unit = {name: mean_length(hidden._horizontal(e, name, "gyro")[1]) for name in ("model 1", "model 3")}
    # g b t^3 / 6 in 60 s, and no less: model 1 cannot know of it, and its tilt lags behind
    ballistic = math.sqrt(math.pi / 2) * 9.81 * math.radians(1.0) * 60.0**3 / 6.0
    assert np.all(unit["model 1"] / ballistic < 1.2) and np.all(unit["model 1"] / ballistic > 1.0)
    left = unit["model 3"] / unit["model 1"]
    assert np.all(np.diff(left) < 0.0) and left[2] < 0.5 < left[0]
