"""Sensor cards: what is read from a datasheet, which process each figure becomes, and that every card cites its source."""

from __future__ import annotations

import contextlib
import math
import re
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from insemu import noise, units
from insemu.augment import augment
from insemu.cli import app
from insemu.errors import InputError
from insemu.records import AXES
from insemu.sensors import CASES, Assumptions, axis_models, card, models, names, of_text, read_figures, save, spelled

DEG = math.pi / 180.0
UG = 9.80665e-6
#: ADIS16470 Data Sheet Rev. C, Features.
PASTED = """\
Triaxial, digital gyroscope, ±2000°/sec dynamic range
8°/hr in run bias stability
0.008°/sec/√Hz rms rate noise density
Triaxial, digital accelerometer dynamic range: ±40 g
13 μg in run bias stability
Calibration temperature range: −10°C to +75°C
"""


@pytest.mark.parametrize(
    ("text", "sensor", "kind", "value"),
    [
        ("ARW 0.34 deg/sqrt(h)", "gyro", "random_walk", 0.34 * DEG / 60),
        ("Angular random walk: 0.15 °/√h", "gyro", "random_walk", 0.15 * DEG / 60),
        ("VRW 0.037 m/s/sqrt(h)", "accel", "random_walk", 0.037 / 60),
        ("velocity random walk (0.06 m/s/√hr)", "accel", "random_walk", 1e-3),
        ("rate noise density 0.0035 dps/rtHz", "gyro", "noise_density", 0.0035 * DEG),
        ("accelerometer noise density 0.14 mg/√Hz typ", "accel", "noise_density", 140 * UG),
        ("in-run bias stability 8 deg/h", "gyro", "bias_stability", 8 * DEG / 3600),
        ("bias instability: 0.5 °/h", "gyro", "bias_stability", 0.5 * DEG / 3600),
        ("13 μg in run bias stability", "accel", "bias_stability", 13 * UG),
        ("B = 12 deg/h", "gyro", "bias_coefficient", 12 * DEG / 3600),
        ("RRW 3 deg/h/sqrt(h)", "gyro", "rate_random_walk", 3 * DEG / 3600 / 60),
        ("turn-on bias 0.2 deg/s", "gyro", "turn_on_bias", 0.2 * DEG),
        ("bias repeatability 3 mg (1 sigma)", "accel", "turn_on_bias", 3000 * UG),
        ("zero-rate offset ±1 deg/s", "gyro", "turn_on_bias", DEG),
        ("Zero-g level ±20 mg", "accel", "turn_on_bias", 20_000 * UG),
        ("Initial bias error: ±0.2 °/s", "gyro", "turn_on_bias", 0.2 * DEG),
    ],
)
def test_a_figure_is_read_in_the_units_of_datasheets(text: str, sensor: str, kind: str, value: float) -> None:
    figures = read_figures(text)
    assert {s: list(f) for s, f in figures.items()} == {sensor: [kind]}
    assert figures[sensor][kind].value == pytest.approx(value, rel=1e-9)
    assert figures[sensor][kind].worst is None


def test_limits_are_worst_cases_and_a_correlation_time_belongs_to_the_figures_before_it() -> None:
    figures = read_figures("in-run bias stability < 6 deg/h, Tc 500 s, VRW 0.05 m/s/sqrt(h) max, Tc = 200 s")
    assert figures["gyro"]["bias_stability"].worst == pytest.approx(6 * DEG / 3600)
    assert figures["accel"]["random_walk"].worst == pytest.approx(0.05 / 60)
    assert (figures["gyro"]["correlation_time"].value, figures["accel"]["correlation_time"].value) == (500.0, 200.0)


def test_any_text_gives_positive_figures_or_a_clear_error() -> None:
    """5,000 texts of the words, numbers and signs of datasheets in any order; and long ones in a moment."""
    rng = np.random.default_rng(5)
    words = [
        *"ARW VRW RRW Tc B = < max ± -3 0 0.34 8 1e400 1e-320 deg/sqrt(h) °/√hr deg/h mg ug/sqrt(Hz) m/s/√h s ( ) , ; | √ ^ / and with % Hz".split(),
        *(
            "noise density",
            "bias instability",
            "in-run bias stability",
            "turn-on bias",
            "\n",
            "\0",
            "1" * 500,
            "(" * 30,
        ),
    ]
    read = 0
    for _ in range(5_000):
        text = " ".join(rng.choice(words, rng.integers(1, 14)))
        try:
            figures = read_figures(text)
        except InputError:
            continue
        read += 1
        assert all(0.0 < one.value < math.inf for kinds in figures.values() for one in kinds.values())
    assert read > 40
    for text in ("ARW " + "1" * 190_000, "ARW 1 " * 30_000, "ARW 0.3 deg/sqrt(h) " * 9_000):
        started = time.process_time()
        with contextlib.suppress(InputError):
            read_figures(text)
        assert time.process_time() - started < 5.0


def test_a_pasted_datasheet_gives_its_figures_and_nothing_else(tmp_path) -> None:
    (tmp_path / "features.txt").write_text(PASTED, encoding="utf-8")
    found = card(str(tmp_path / "features.txt"))
    assert {s: set(f) for s, f in found.figures.items()} == {
        "gyro": {"bias_stability", "noise_density"},
        "accel": {"bias_stability"},
    }
    with pytest.raises(InputError, match="no white noise is known of the accelerometers; give their VRW"):
        axis_models(found)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ARW 0.34 deg/h", "'ARW 0.34 deg/h' has no unit of angular or velocity random walk"),
        ("in-run bias stability 8 deg/sqrt(h)", "no unit of lowest point of the Allan deviation"),
        ("a gyroscope of 8 deg/h", "found no figure in"),
        ("ARW -0.3 deg/sqrt(h)", "found no figure in"),
        ("ARW 1e400 deg/sqrt(h)", "no unit of angular"),
        ("x" * 300_000, "has 300000 characters"),
    ],
)
def test_what_is_no_figure_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_figures(text)


def test_the_bias_stability_is_the_lowest_point_of_the_allan_deviation_of_the_model() -> None:
    """In an Allan plot of what the model draws, the figures of the datasheet are read off again."""
    found = axis_models(
        of_text("ARW 0.34 deg/sqrt(h), in-run bias stability 8 deg/h, VRW 0.037 m/s/sqrt(h), bias instability 13 ug")
    )
    model = found["gyro_z"].model
    assert [p.symbol for p in model] == ["WN", "BI"]
    assert float(np.sqrt(model.processes[0].allan_variance(100, 0.01))[()]) == pytest.approx(0.34 * DEG / 60)  # at 1 s
    assert float(np.sqrt(model.processes[1].allan_variance(100, 0.01))) == pytest.approx(8 * DEG / 3600)
    assert float(np.sqrt(found["accel_x"].model.processes[1].allan_variance(7, 0.01))) == pytest.approx(13 * UG)
    assert any("0.664 B (assumed flicker)" in line and "1 to 1000 s (assumed)" in line for line in found["gyro_z"].said)


def test_with_a_correlation_time_the_top_of_the_gauss_markov_process_is_the_bias_stability() -> None:
    model = axis_models(of_text("ARW 0.3 deg/sqrt(h), in-run bias stability 4.6 deg/h, Tc 500 s"))["gyro_x"].model
    assert [p.symbol for p in model] == ["WN", "GM"]
    m = np.unique(np.round(np.geomspace(1, 1e6, 400)))
    assert float(np.sqrt(model.processes[1].allan_variance(m, 0.1).max())) == pytest.approx(4.6 * DEG / 3600, rel=2e-3)


def test_the_coefficient_b_and_a_bias_sigma_are_taken_as_they_are() -> None:
    one = axis_models(of_text("ARW 0.3 deg/sqrt(h), B = 12 deg/h, RRW 3 deg/h/sqrt(h), turn-on bias 0.2 deg/s"))[
        "gyro_x"
    ].model
    assert (
        spelled(one, "rad/s")
        == "WN(N=0.3 deg/sqrt(h)) + BI(B=12 deg/h) + RW(K=0.05 deg/h*sqrt(Hz)) + RC(sigma=720 deg/h)"
    )
    assert noise.NoiseModel.parse(spelled(one, "rad/s"), "rad/s").processes[0].parameters["N"] == pytest.approx(
        0.3 * DEG / 60
    )
    other = axis_models(of_text("ARW 0.3 deg/sqrt(h), in-run bias sigma 5 deg/h, Tc 100 s"))["gyro_x"].model
    assert other.processes[1] == noise.GM(units.parse("5 deg/h", "rad/s"), 0.01)
    with pytest.raises(InputError, match="needs its correlation time"):
        axis_models(of_text("ARW 0.3 deg/sqrt(h), in-run bias sigma 5 deg/h"))


def test_the_worst_case_is_the_printed_limit_or_a_stated_multiple() -> None:
    text = "ARW 0.3 deg/sqrt(h), in-run bias stability < 6 deg/h"
    typical = axis_models(of_text(text))["gyro_x"]
    worst = axis_models(of_text(text), "worst", Assumptions(worst_factor=3.0))["gyro_x"]
    ratios = [b.parameters[k] / a.parameters[k] for a, b, k in zip(typical.model, worst.model, "NB", strict=True)]
    assert ratios == pytest.approx([3.0, 1.0])
    assert "worst case of the random walk: assumed 3 times the typical figure" in worst.said
    with pytest.raises(InputError, match="unknown case 'best'"):
        models("ADIS16470", "best")


@pytest.mark.parametrize("name", names())
def test_every_card_cites_its_figures_and_makes_a_truth_and_a_filter(name: str, tmp_path) -> None:
    one = card(name)
    for figures in one.figures.values():
        for kind, figure in figures.items():
            label = figure.source.split(",")[0]
            assert label in one.sources, f"{kind} has no source"
            assert one.sources[label]["kind"] in ("datasheet", "quoted datasheet", "published model")
    for case in CASES:
        save(one, tmp_path / "models.yaml", case)
        found = noise.load(tmp_path / "models.yaml")
        assert list(found) == list(AXES)
        assert found == models(name, case)
        assert augment(found, 0.01).layout.names[:9]
    typical, worst = (models(name, case)["gyro_x"].processes[0].parameters["N"] for case in CASES)
    assert worst >= typical


@pytest.mark.parametrize("name", names())
def test_the_figures_of_a_card_have_addresses_and_the_sizes_of_inertial_sensors(name: str) -> None:
    """From a navigation-grade ring laser to a consumer chip: a wrong unit or a lost power of ten is outside."""
    one = card(name)
    assert all(source.get("url", "").startswith("https://") for source in one.sources.values())
    lowest, highest = {"gyro": 5e-4 * DEG / 60, "accel": UG}, {"gyro": 5 * DEG / 60, "accel": 1000 * UG}
    for axis in AXES:
        sensor, figures = axis.split("_")[0], one.of_axis(axis)
        assert all(figure.worst is None or figure.worst >= figure.value for figure in figures.values())
        white = figures.get("random_walk") or figures["noise_density"]
        assert lowest[sensor] <= white.value <= highest[sensor]
        in_run = [figures[kind] for kind in ("bias_coefficient", "bias_sigma", "bias_stability") if kind in figures]
        start = figures.get("turn_on_bias")
        limit = {"gyro": 20 * DEG, "accel": 100_000 * UG}[sensor]
        assert all(figure.value <= limit for figure in [*in_run, *([start] if start else [])])
        # a bias changes less within a run than from one start to the next; a published model may halve that
        if start and in_run:
            assert in_run[0].value <= 2.0 * start.value


def test_zero_offsets_of_a_sheet_are_turn_on_biases_axis_by_axis() -> None:
    """MPU-9250 Product Specification, revision 1.0, pages 8 and 9: ±5 deg/s; ±60 mg on x and y, ±80 mg on z."""
    found = {axis: one.model.processes[-1] for axis, one in axis_models(card("MPU-9250")).items()}
    assert {process.symbol for process in found.values()} == {"RC"}
    shown = [process.parameters["sigma"] for process in found.values()]
    assert shown == pytest.approx([5 * DEG] * 3 + [60_000 * UG, 60_000 * UG, 80_000 * UG])


def test_figures_of_the_adis16470_are_those_of_its_datasheet() -> None:
    gyro, accel = (card("adis-16470").figures[s] for s in ("gyro", "accel"))
    assert gyro["bias_stability"].value == pytest.approx(units.parse("8 deg/h", "rad/s"))
    assert gyro["noise_density"].value == pytest.approx(units.parse("0.008 deg/s/sqrt(Hz)", "rad/s/sqrt(Hz)"))
    assert accel["bias_stability"].value == pytest.approx(units.parse("13 ug", "m/s^2"))
    # a noise density printed as rms in a bandwidth is sqrt(2) times N, which is what this datasheet's two figures say
    assert gyro["noise_density"].value / gyro["random_walk"].value == pytest.approx(math.sqrt(2.0), rel=0.01)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("maker: x", "expected a sensor card with the key 'name'"),
        ("name: x", "holds no figure"),
        ("name: x\ngyros: {}", "unknown key 'gyros'.*did you mean 'gyro'"),
        ("name: x\ngyro: 3", "found 3, expected a mapping"),
        ("name: x\ngyro: {arw: 1}", "card.yaml:2: gyro.arw: unknown figure 'arw'"),
        ("name: x\ngyro: {random_walk: 1 deg/h}", "gyro.random_walk.typical: the unit 'deg/h' has another dimension"),
        ("name: x\ngyro: {random_walk: {typical: 0 deg/sqrt(h)}}", "expected a positive quantity"),
        ("name: x\ngyro: {random_walk: {source: a}}", "expected a quantity or the keys typical"),
        ("name: x\ngyro: {random_walk: {typical: 1 deg/sqrt(h), source: a}}", "unknown source 'a'"),
        ("name: x\naccel: {random_walk: [1 m/s/sqrt(h), 2 m/s/sqrt(h)]}", "expected one quantity or, under 'gyro'"),
        ("name: x\naccel_z: {random_walk: {max: [1 m/s/sqrt(h)]}}", "accel_z.random_walk: found .*three .x, y, z"),
        ("name: x\naccel: {random_walk: [1 m/s/sqrt(h), 2 deg, 1 m/s/sqrt(h)]}", "random_walk.typical: the unit 'deg'"),
        ("name: x\nsources: {a: {url: b}}", "expected a source with the key 'title'"),
        ("name: x\nsources: {a: {title: [b]}}", "expected a source with the key 'title'"),
        (
            "name: x\nalso: 3\ngyro: {random_walk: 1 deg/sqrt(h)}",
            "card.yaml:2: also: found 3, expected a list of names",
        ),
    ],
)
def test_a_card_that_cannot_be_read_is_refused_with_its_place(text: str, message: str, tmp_path) -> None:
    (tmp_path / "card.yaml").write_text(text)
    with pytest.raises(InputError, match=message):
        card(str(tmp_path / "card.yaml"))


def test_the_command_lists_shows_and_writes(tmp_path) -> None:
    runner = CliRunner()
    listed = runner.invoke(app, ["sensor"])
    assert listed.exit_code == 0
    assert all(name in listed.output for name in names())
    page = (Path(__file__).parents[1] / "docs" / "howto" / "datasheet_values.md").read_text(encoding="utf-8")
    stated = re.search(r"(\d+) cards come with insemu", page)
    assert stated and f"\n{stated[1]} cards\n" in listed.output and int(stated[1]) == len(names())
    shown = runner.invoke(app, ["sensor", "ADIS16470", "--worst-factor", "3", "--band", "1 s", "100 s"])
    assert "WN(N=0.34 deg/sqrt(h)) + BI(B=12.04 deg/h, tau_to=100 s)" in shown.output
    assert "1.02 deg/sqrt(h) assumed" in shown.output
    assert "ADIS16470AMLZ.html" in shown.output
    out = tmp_path / "own.yaml"
    text = "ARW 0.2 deg/sqrt(h), VRW 0.03 m/s/sqrt(h)"
    assert runner.invoke(app, ["sensor", text, "-o", str(out), "--case", "worst"]).exit_code == 0
    assert noise.load(out)["gyro_y"].processes[0].parameters["N"] == pytest.approx(0.4 * DEG / 60)
    for words in (["ADIS9"], ["ADIS16470", "--case", "best", "-o", str(tmp_path / "no.yaml")]):
        refused = runner.invoke(app, ["sensor", *words])
        assert isinstance(refused.exception, InputError)
    assert not (tmp_path / "no.yaml").exists()
