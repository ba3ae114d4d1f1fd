"""Results: the outage table, its intervals, comparisons and files, on errors made by hand."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from insemu.errors import InputError
from insemu.evaluate import (
    Results,
    bootstrap_mean,
    consistency_words,
    navigation_error,
    outage_table,
    paired_ratio,
    published_cells,
    rank_agreement,
    single_run_agreement,
    summary,
    verdicts,
    within_outage,
    write,
)
from insemu.evaluate.dataset import labelled
from insemu.evaluate.results import DesignInfo
from insemu.records import Trajectory
from insemu.report.experiment_charts import error_chart, nees_chart
from insemu.report.tables import full_headline


def trajectory(t: np.ndarray) -> Trajectory:
    llh = np.column_stack([np.full(t.size, 0.8), 0.1 + 1e-6 * t, np.full(t.size, 100.0)])
    return Trajectory(t, llh, np.zeros((t.size, 3)), np.zeros((t.size, 3)))


def results(scale: float = 1.0, runs: int = 40, sigma: float = 1.0) -> Results:
    rng = np.random.default_rng(1)
    t = np.arange(101.0)
    error = rng.standard_normal((2, runs, t.size, 9))
    error[1] = scale * error[0]
    arrays = {
        "error": error,
        "sigma": np.full_like(error, sigma),
        "nees": (error**2).sum(axis=-1) / sigma**2,
        "nis": np.full((2, runs), 600.0),
        "dof": np.full((2, runs), 600),
        "lag_sum": np.zeros((2, runs, 5)),
        "lag_count": np.full((2, runs, 5), 600.0),
    }
    return Results(
        title="by hand",
        digest="d",
        seed=1,
        data=labelled(arrays, ("design", "realization"), {"design": ["one", "two"], "time": t}),
        designs={"one": DesignInfo(9, ("a",), {}), "two": DesignInfo(15, ("a", "b"), {})},
        outages=[(20.0, 10.0), (50.0, 0.0)],
        truth=trajectory(t),
        timing={"filter_epochs": 1, "filter_seconds": 1.0, "wall_seconds": 1.0},
    )


def test_an_outage_ends_at_its_last_withheld_fix() -> None:
    inside = within_outage(np.arange(101.0), 20.0, 10.0)
    assert np.flatnonzero(inside).tolist() == list(range(21, 31))
    assert not within_outage(np.arange(101.0), 20.0, 0.0).any()


def test_the_table_says_what_the_errors_are() -> None:
    r = results()
    row = outage_table(r)["one"][0]
    horizontal = np.hypot(r.error[0, :, 30, 0], r.error[0, :, 30, 1])
    assert row["planimetric_end_m"]["mean"] == pytest.approx(horizontal.mean())
    assert row["planimetric_end_m"]["per_realization"] == pytest.approx(horizontal.tolist())
    assert row["altimetric_end_m"] == pytest.approx(np.abs(r.error[0, :, 30, 2]).mean())
    assert row["predicted_sigma_end_m"] == pytest.approx(np.sqrt(2.0))
    assert row["attitude_end_deg"] == pytest.approx(np.rad2deg(np.linalg.norm(r.error[0, :, 30, 6:], axis=1)).mean())
    # 40 realizations x 10 epochs x 3 components: binomial bounds at 1e-6
    assert abs(row["coverage_3sigma"]["position"] - 0.9973) < 4.9 * np.sqrt(0.0027 / 1200)
    assert abs(row["nees_per_dof"] - 1.0) < 4.9 * np.sqrt(2 / 3600)


def test_overconfidence_shows() -> None:
    row = outage_table(results(sigma=0.5))["one"][0]
    assert row["nees_per_dof"] > 3
    assert row["coverage_3sigma"]["velocity"] < 0.9


def test_a_zero_length_outage_has_no_epochs() -> None:
    row = outage_table(results())["one"][1]
    assert row["planimetric_max_m"] == 0.0
    assert row["coverage_3sigma"]["position"] == 1.0


def test_paired_comparison_finds_a_difference_and_finds_none() -> None:
    better = results(scale=0.6)
    c = better.comparison("two", "one")
    assert c.ratio == pytest.approx(0.6)
    assert c.different
    assert c.p_value is not None and c.p_value < 0.001
    assert "40% smaller than one's" in verdicts(better)[0]
    r = results()
    other = r.with_data({"error": np.stack([r.error[0], r.error[0][::-1]])})  # the same errors in other realizations
    assert "no planimetric difference from one; one of" in verdicts(other)[0]
    assert paired_ratio([1.0], [2.0]).p_value is None
    assert "one realization cannot say" in verdicts(results(runs=1))[0]


def test_designs_that_are_the_same_within_little_are_called_that_without_a_p_value() -> None:
    base = np.linspace(4.0, 6.0, 40)
    near = paired_ratio(0.995 * base + 0.002 * np.sin(np.arange(40.0)), base)  # sure, but too small to matter
    assert near.p_value is not None and near.p_value < 0.001
    assert near.same and not near.different and near.within == pytest.approx(0.005, abs=5e-4)
    said = verdicts(results(scale=0.995))[0]
    assert "the same as one's within" in said and " p " not in said
    assert near.interval == "ratio 0.9950, 95 % 0.9949 to 0.9951"  # digits enough to see that it is no 1
    wide = paired_ratio(base, base[::-1])
    assert not wide.same and not wide.different
    assert not paired_ratio(0.9 * base, base).same


def test_the_order_of_designs_is_held_against_a_published_one() -> None:
    r = results(scale=0.6)
    arrays = {
        "error": np.concatenate([r.error, 2.0 * r.error[:1]]),
        "sigma": np.concatenate([r.sigma, r.sigma[:1]]),
        "nees": np.concatenate([r.nees, r.nees[:1]]),
    }
    three = replace(
        r.with_data(arrays, dict(r.designs) | {"three": r.designs["one"]}),
        outages=[(20.0, 10.0)],
        published={"planimetric_end_m": {"one": (5.0,), "two": (4.0,), "three": (9.0,)}},
    )
    assert rank_agreement(three) == [pytest.approx(1.0)]
    other = {"planimetric_end_m": {"one": (5.0,), "two": (9.0,), "three": (4.0,)}}
    assert rank_agreement(replace(three, published=other)) == [pytest.approx(-1.0)]
    assert rank_agreement(r) == []


def test_a_single_run_can_be_asked_for_the_order() -> None:
    """Three designs whose errors are multiples of each other: every run knows the order; independent ones know nothing of it."""
    r = results(runs=200)
    rng = np.random.default_rng(3)
    published = {"planimetric_end_m": {"one": (1.0,), "two": (2.0,), "three": (3.0,)}}

    def with_errors(error: np.ndarray) -> Results:
        three = r.with_data({"error": error}, dict(r.designs) | {"three": r.designs["one"]})
        return replace(three, outages=[(20.0, 10.0)], published=published)

    same = with_errors(np.stack([r.error[0], 2 * r.error[0], 3 * r.error[0]]))
    assert single_run_agreement(same).tolist() == [1.0] * 200
    noise = with_errors(rng.standard_normal((3, *r.error.shape[1:])))
    # the variance of tau of three unrelated items is 2 (2 n + 5) / (9 n (n - 1)) = 11 / 27: mean of 200 at five sigma
    assert abs(single_run_agreement(noise).mean()) < 5 * np.sqrt(11 / 27 / 200)
    assert single_run_agreement(replace(noise, published={})).size == 0


def test_published_figures_need_not_be_complete() -> None:
    r = replace(
        results(),
        outages=[(20.0, 10.0), (60.0, 20.0)],
        published={"planimetric_max_m": {"one": (None, 4.0)}, "north_max_m": {"one": (1.0, 2.0), "two": (1.0, None)}},
    )
    assert r.headline_figure == "planimetric_max_m"
    rows = outage_table(r)["one"]
    assert [c[:2] for c in published_cells(r, "planimetric_max_m")] == [("one", 1)]
    assert published_cells(r, "north_max_m")[1][2:] == (rows[1]["north_max_m"], 2.0)
    largest = np.abs(r.error[0][:, 61:81, 0]).max(axis=1).mean()
    assert rows[1]["north_max_m"] == pytest.approx(largest)


def test_verdicts_on_consistency_say_what_is_wrong() -> None:
    """The filter by hand is right; half its sigma is not; a smoother is judged by its own errors; correlated innovations are named."""
    good = results(runs=60)
    assert all(": consistent" in w or "white" in w for w in consistency_words(good, "one"))
    assert all(v["passed"] for v in summary(good)["designs"]["one"]["consistency"])
    small = results(runs=60, sigma=0.5)
    assert "overconfident at 3 of 3 epochs" in consistency_words(small, "one")[0]  # the second outage has no length
    smoothed = {
        "smoothed_error": 0.5 * good.error,
        "smoothed_sigma": 0.25 * good.sigma,
        "smoothed_nees": 4.0 * good.nees,
    }
    both = replace(good.with_data(smoothed), outages=[(20.0, 10.0)])
    words = consistency_words(both, "one")
    assert (
        words[0].endswith(": consistent")
        and words[1].startswith("NEES of the smoother")
        and words[1].endswith("overconfident")
    )
    row = outage_table(both)["one"][0]["smoothed"]
    assert row["middle_rms_m"] == pytest.approx(0.5 * row["filter_middle_rms_m"])
    assert row["coverage_3sigma"]["position"] < 0.9
    coloured = good.with_data({"lag_sum": good["lag_sum"] + 60.0})
    assert "correlated at 5 of 5 lags" in consistency_words(coloured, "one")[-1]


@pytest.mark.slow(reason="hundreds of draws for a coverage, a size or a bias")
def test_bootstrap_interval_covers() -> None:
    """95 % percentile intervals of 40 normal values: 500 repeats cover between 90 and 97 % (binomial, 1e-4,
    small-sample deficit known).
    """
    rng = np.random.default_rng(5)
    hits = 0
    for _ in range(500):
        i = bootstrap_mean(rng.standard_normal(40) + 3.0)
        assert i.low is not None and i.high is not None
        hits += i.low <= 3.0 <= i.high
    assert 450 <= hits <= 485
    assert bootstrap_mean([2.0]).low is None


def test_files_hold_the_same_numbers(tmp_path: Path) -> None:
    r = results(scale=0.6)
    write(r, tmp_path)
    s = json.loads((tmp_path / "summary.json").read_text())
    assert s == json.loads(json.dumps(summary(r)))
    assert list(s["designs"]) == ["one", "two"]
    assert s["designs"]["two"]["states"] == 15
    with xr.open_dataset(tmp_path / "errors.nc", engine="h5netcdf") as data:
        np.testing.assert_array_equal(data["error"].sel(design="two").values, r.error[1])
        assert data["time"].attrs["units"] == "s"
    lines = (tmp_path / "outages.csv").read_text().splitlines()
    assert len(lines) == 5
    assert lines[0].startswith("design,outage,start_s,duration_s,planimetric_end_m,")


def test_errors_are_estimate_minus_truth() -> None:
    t = np.arange(3.0)
    truth = trajectory(t)
    moved = Trajectory(
        t, truth.llh + np.array([1e-7, 0, -2.0]), truth.vel_ned + 0.1, truth.rpy + np.array([0, 0, 1e-3])
    )
    e = navigation_error(moved, truth)
    assert e[0, 0] == pytest.approx(1e-7 * 6.37e6, rel=1e-2)
    assert e[0, 2] == pytest.approx(2.0)
    assert e[0, 3] == pytest.approx(0.1)
    assert e[0, 8] == pytest.approx(1e-3)
    with pytest.raises(InputError, match="different epochs"):
        navigation_error(moved, trajectory(t + 0.5))


def test_a_table_has_no_column_without_a_value() -> None:
    """Of a recording whose reference has no attitude."""
    whole, bare = results(), results()
    bare.data["error"].values[..., 6:] = np.nan
    (header, _), (less, rows) = full_headline(whole), full_headline(bare)
    assert "attitude deg" in set(header) - set(less)
    assert {len(row) for row in rows} == {len(less)}
    views = [{v.name for v in error_chart(r).views} for r in (whole, bare)]
    assert views[0] - views[1] and all("ttitude" in name for name in views[0] - views[1])
    chart = nees_chart(whole)
    assert [line.label for line in chart.views[0].lines if not line.of] == ["one", "two", "99% bounds"]
