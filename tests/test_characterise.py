"""The command: JSON, page, findings, long files, errors."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from insemu import formats
from insemu.cli import main
from insemu.logs import characterise_log
from insemu.noise import GM, RW, WN
from insemu.records import AXES, Series
from insemu.variance import findings as judge
from insemu.variance import wavelet_variance
from insemu.variance.characterise import characterise_stream
from tests.budget import binomial, binomial_power, statistical
from tests.shared_data import shared


def _static(n: int = 20_000, seed: int = 1) -> list[Series]:
    rng = np.random.default_rng(seed)
    gyro, accel = WN(N=5e-4) + RW(K=1e-5), WN(N=1e-3) + GM(sigma=5e-3, beta=0.02)
    out = [Series(1e-3 + gyro.simulate(n, 0.01, rng), 100.0, "rad/s", a) for a in AXES[:3]]
    offsets = (0.1, -0.2, -9.80)
    return out + [
        Series(o + accel.simulate(n, 0.01, rng), 100.0, "m/s^2", a) for a, o in zip(AXES[3:], offsets, strict=True)
    ]


def run(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as caught:
        main(["characterise", *arguments])
    out, err = capsys.readouterr()
    return int(caught.value.code or 0), out, err


def test_json_has_the_agreed_keys(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = formats.write(tmp_path / "log.npz", _static())
    code, out, _ = run([str(path), "--json"], capsys)
    assert code == 0
    axes = json.loads(out)["axes"]
    assert list(axes) == ["gx", "gy", "gz", "ax", "ay", "az"]
    for name, axis in axes.items():
        assert axis["rate_hz"] == 100.0 and axis["samples"] == 20_000 and isinstance(axis["findings"], list)
        for curve in ("wavelet_variance", "robust_wavelet_variance", "allan_variance"):
            assert {"tau_s", "value", "low", "high"} <= set(axis[curve])
            assert len(axis[curve]["tau_s"]) == len(axis[curve]["value"])
        assert axis["wavelet_variance"]["tau_s"][:2] == [0.02, 0.04] and axis["allan_variance"]["tau_s"][:2] == [
            0.01,
            0.02,
        ]
        reading = axis["readings"]["N"]
        assert {"value", "low", "high", "unit", "tau_from_s", "tau_to_s"} <= set(reading)
        assert reading["unit"] == ("deg/sqrt(h)" if name.startswith("g") else "ug/sqrt(Hz)")
        assert set(axis["readings"]) | set(axis["not_visible"]) == {"Q", "N", "B", "K", "R", "Tc"}
    truth = np.rad2deg(5e-4) * 60.0
    assert abs(axes["gx"]["readings"]["N"]["value"] / truth - 1.0) < 0.03
    assert not list(tmp_path.glob("results*"))  # nothing is written without --output


@pytest.mark.parametrize("header", ["rate of turn\n", "", "x [deg/s]\n"])
def test_a_one_column_csv_is_read_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str], header: str) -> None:
    x = np.random.default_rng(2).standard_normal(3000)
    path = tmp_path / "one.csv"
    path.write_text(header + "\n".join(map(repr, x.tolist())) + "\n")
    code, out, _ = run([str(path), "--rate", "50 Hz", "--json"], capsys)
    assert code == 0
    (axis,) = json.loads(out)["axes"].values()
    factor = np.deg2rad(1.0) ** 2 if "deg" in header else 1.0
    np.testing.assert_allclose(axis["wavelet_variance"]["value"], factor * wavelet_variance(x).value, rtol=1e-10)
    np.testing.assert_allclose(
        axis["allan_variance"]["value"], 2 * np.array(axis["wavelet_variance"]["value"]), rtol=1e-10
    )


def test_the_page_holds_figures_tables_and_escaped_text(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    series = [Series(s.values, s.rate_hz, "", "<b>odd</b>") for s in _static(4000)[:1]]
    path = formats.write(tmp_path / "log.npz", series)
    beside = tmp_path / "other.json"
    beside.write_text(json.dumps({"S": {"freq": [100.0], "wvar": {"Gyro. X": {"variance": [1e-6, 5e-7, 2e-7]}}}}))
    code, out, _ = run([str(path), "--output", str(tmp_path / "page"), "--beside", str(beside)], capsys)
    assert code == 0 and "Readings" in out
    html = (tmp_path / "page" / "index.html").read_text()
    assert html.count('<figure class="chart">') == 5 and "other sensors" in html
    assert "<b>odd</b>" not in html and "&lt;b&gt;odd&lt;/b&gt;" in html
    assert (tmp_path / "page" / "figures" / "allan_deviation_signal.png").stat().st_size > 10_000
    assert "axes" in json.loads((tmp_path / "page" / "characterise.json").read_text())


def _findings(data: list[Series] | Path) -> dict[str, list[str]]:
    if isinstance(data, Path):
        log = formats.read_log(data)
    else:
        short = {axis: column for column, axis in formats.AXIS_OF_COLUMN.items()}
        log = formats.Log(
            "log",
            tuple(short.get(s.name, s.name) for s in data),
            tuple(s.unit for s in data),
            tuple(s.unit for s in data),
            tuple(s.values for s in data),
            data[0].rate_hz,
        )
    return {a.name: a.findings for a in characterise_log(log)}


def test_a_clean_log_has_no_findings() -> None:
    assert _findings(_static()) == {name: [] for name in ("gx", "gy", "gz", "ax", "ay", "az")}


def _changed(change: Callable[[np.ndarray[Any, Any], int], Any]) -> list[Series]:
    return [Series(change(np.array(s.values), k), s.rate_hz, s.unit, s.name) for k, s in enumerate(_static())]


def _warm(x: np.ndarray[Any, Any], k: int) -> np.ndarray[Any, Any]:
    return x + (0.01 if k < 3 else 0.2) * np.exp(-np.arange(x.size) / 1500.0)


def _step(x: np.ndarray[Any, Any], k: int) -> np.ndarray[Any, Any]:
    return x + (0.01 if k < 3 else 0.2) * (np.arange(x.size) > 14_000)


def _louder(x: np.ndarray[Any, Any], k: int) -> np.ndarray[Any, Any]:
    noise = np.random.default_rng(5).standard_normal(x.size) * x[:1000].std()
    return x + noise * (np.arange(x.size) > 15_000)


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (_warm, "warm-up"),
        (_step, "level shift"),
        (_louder, "noise level"),
        (lambda x, k: np.clip(x, -np.inf, np.quantile(x, 0.99)), "saturation"),
        (lambda x, k: np.round(x / (2 * np.diff(x).std())) * 2 * np.diff(x).std(), "quantization"),
        (lambda x, k: np.where((np.arange(x.size) > 5000) & (np.arange(x.size) < 5200), x[5000], x), "stuck"),
        (lambda x, k: x + np.where(np.arange(x.size) % 100 == 7, 30 * np.diff(x).std(), 0.0), "outliers"),
    ],
)
def test_what_is_wrong_is_said(change: Callable[[np.ndarray[Any, Any], int], Any], kind: str) -> None:
    found = _findings(_changed(change))
    assert all(any(f.startswith(kind) for f in axis) for axis in found.values()), found


def test_a_value_that_is_stuck_to_the_end_is_counted_to_the_last_sample() -> None:
    x = np.random.default_rng(3).standard_normal(4000)
    for start in (0, 1000, 3900):
        stuck = np.where((np.arange(4000) >= start) & (np.arange(4000) < start + 100), 0.25, x)
        (said,) = [f for f in judge.resolution(stuck, "rad/s") if f.startswith("stuck")]
        assert said == f"stuck: the value stays the same for 100 samples from row {start} on"


def test_wrong_units_are_said() -> None:
    for size, unit in ((900.5, "mg"), (1099.5, "mg"), (0.9005, "g"), (1.0995, "g")):
        means = {"accel_x": 0.0, "accel_y": 0.0, "accel_z": size}
        assert any(
            f"the values are in {unit}" in f for f in judge.unit_report(means, {}, dict.fromkeys(means, ""))["accel_x"]
        )
    in_g = [Series(s.values / 9.80665, s.rate_hz, s.unit, s.name) if k > 2 else s for k, s in enumerate(_static())]
    assert any("gravity magnitude" in f and "in g" in f for f in _findings(in_g)["az"])
    in_degrees = [
        Series(np.rad2deg(s.values) + 0.5, s.rate_hz, s.unit, s.name) if k < 3 else s for k, s in enumerate(_static())
    ]
    assert any("may be in deg/s" in f for f in _findings(in_degrees)["gx"])
    assert judge.unit_report({"gyro_x": 1e-3}, {}, {"gyro_x": ""})["gyro_x"] == [
        "units: the file states none; rad/s is assumed"
    ]


def test_gaps_and_nan_are_said_and_every_sample_that_is_there_is_used(tmp_path: Path) -> None:
    series = _static(6000)
    block = np.column_stack([s.values for s in series])
    block[1000, 0] = np.nan
    t = np.arange(6000) / 100.0
    t[4000:] += 5.0
    np.savez(
        tmp_path / "log.npz",
        data=block,
        t=t,
        columns=["gx", "gy", "gz", "ax", "ay", "az"],
        units=["rad/s"] * 3 + ["m/s^2"] * 3,
    )
    log = formats.read_log(tmp_path / "log.npz")
    reports = {a.name: a for a in characterise_log(log)}
    assert reports["gx"].samples == 6500  # the span of the record
    assert reports["gx"].wavelet.n_coefficients[0] > 5000
    assert any(f.startswith("NaN: 1 value(s)") and "row 1000" in f for f in reports["gx"].findings)
    assert any(f.startswith("gap: 1 gap(s)") and "5.01 s" in f for f in reports["gy"].findings)
    assert any(f.startswith("missing: 501 of 6500 samples") for f in reports["gx"].findings)


@pytest.mark.parametrize("model", [WN(N=1.0), RW(K=1.0), GM(sigma=1.0, beta=0.01), WN(N=1.0) + RW(K=0.003)], ids=str)
def test_noise_with_stationary_increments_is_not_called_warm_up(model: Any) -> None:
    rng = np.random.default_rng(6)
    alarms = sum(bool(judge.stationarity(model.simulate(8000, 1.0, rng), 1.0, "")) for _ in range(60))
    assert alarms <= 2  # a few in a thousand


@pytest.mark.parametrize("model", [WN(N=1.0), RW(K=1.0), GM(sigma=20.0, beta=0.03) + WN(N=0.1)], ids=str)
@statistical(2e-6, power=binomial_power(40, judge.FALSE_ALARM, 2e-6, 1, 0.3))
def test_no_noise_is_a_line(model: Any) -> None:
    rng = np.random.default_rng(11)
    alarms = sum(bool(judge.lines(model.simulate(40_000, 100.0, rng), 100.0, "")) for _ in range(40))
    assert alarms <= binomial(40, judge.FALSE_ALARM, 2e-6)[1]


def test_a_line_is_named_with_its_amplitude() -> None:
    rng = np.random.default_rng(11)
    white = rng.standard_normal(40_000)
    t = np.arange(40_000) / 100.0
    (said,) = judge.lines(white + 0.2 * np.sin(2 * np.pi * 17.3 * t), 100.0, "m/s^2")
    found = re.search(r"amplitude (\S+) m/s\^2 at (\S+) Hz$", said)
    assert found is not None
    # five standard deviations behind a Hann window; a bin on either side
    assert float(found[1]) == pytest.approx(0.2, abs=5.0 * np.sqrt(2.0 * 1.5 / white.size))
    assert float(found[2]) == pytest.approx(17.3, abs=100.0 / white.size)
    wandering = 0.5 * np.sin(2 * np.pi * np.cumsum(17.3 + 0.05 * np.sin(0.1 * t)) / 100.0)
    assert judge.lines(white + wandering, 100.0, "")[0].count("Hz") == 1


def test_a_long_record_is_read_in_one_pass() -> None:
    x = np.random.default_rng(7).standard_normal(60_000)
    report = characterise_stream(lambda: np.array_split(x, 7), 100.0, name="x", keep=5000)
    np.testing.assert_allclose(report.wavelet.value, wavelet_variance(x).value, rtol=1e-12)
    assert report.samples == 60_000 and report.robust is None and report.findings[0].startswith("long record")
    json.dumps(report.to_json(), allow_nan=False)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["absent.npz"], "no such file"),
        (["log.npz", "--columns", "gw"], "has no column 'gw'"),
        (["log.npz", "--rate", "5 kg"], "unknown unit 'kg'"),
        (["log.npz", "--rate", "5 m"], "another dimension"),
        (["nan.csv", "--rate", "5"], "no octave has two coefficients"),
        (["bare.csv"], "--rate"),
        (["flight.npz"], "a recording that moves"),
        (["log.npz", "--beside", "log.npz"], "is not JSON"),
    ],
)
def test_bad_input_is_one_line_and_code_two(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, arguments: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    formats.write(Path("log.npz"), _static(100))
    Path("nan.csv").write_text("x\n" + "nan\n1\n" * 40)
    Path("bare.csv").write_text("x\n1\n2\n3\n")
    moving = np.column_stack([47.0 + 1e-4 * np.arange(5.0), np.full(5, 8.0), np.full(5, 400.0)])
    np.savez("flight.npz", imu_t=np.arange(5.0), imu=np.ones((5, 6)), gnss_t=np.arange(5.0), gnss_llh=moving)
    code, out, err = run(arguments, capsys)
    assert code == 2 and said in err and out == ""
    assert not Path("results").exists()


def test_a_recording_at_rest_is_a_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    t, rng = np.arange(2000) * 0.01, np.random.default_rng(5)
    imu = np.column_stack([1e-3 * rng.standard_normal((2000, 3)), np.tile([0.0, 0.0, -9.8], (2000, 1))])
    still = np.tile([47.0, 8.0, 400.0], (20, 1))
    np.savez("rest.npz", imu_t=t, imu=imu * 0.01, imu_kind="increment", gnss_t=np.arange(20.0), gnss_llh=still)
    code, out, _ = run(["rest.npz", "-c", "gyro_x", "--json"], capsys)
    axis = json.loads(out)["axes"]["gyro_x"]
    assert code == 0 and axis["rate_hz"] == 100.0
    # white noise of variance 1e-6: half of it at the first scale, whose 1,000 coefficients give it within 4.9 sqrt(2 / 1000)
    assert axis["wavelet_variance"]["value"][0] == pytest.approx(0.5e-6, rel=0.22)


def test_help_imports_nothing_heavy() -> None:
    text = "import sys; from insemu.cli import app; heavy = {'numpy', 'numba', 'matplotlib', 'scipy'} & set(sys.modules); assert not heavy, heavy"
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
    subprocess.run([sys.executable, "-c", text], check=True, env=environment)


@pytest.mark.slow(reason="real recordings of hours")
@pytest.mark.parametrize("name", ["adis16405_static_run1", "ch104_static"])
def test_real_logs(name: str) -> None:
    reports = {a.name: a for a in characterise_log(formats.read_log(shared(f"real/{name}.npz")))}
    assert list(reports) == ["gx", "gy", "gz", "ax", "ay", "az"]
    if name.startswith("adis"):
        assert any(f.startswith("warm-up") for axis in ("ax", "az") for f in reports[axis].findings)
        floor = [np.rad2deg(reports[g].readings["B"].si_value) * 0.664 for g in ("gx", "gy", "gz")]
        assert all(0.005 < f < 0.009 for f in floor)  # deg/s, as the data's notes say


def test_a_file_of_curves_without_a_rate_is_at_one_hertz_and_axes_are_told_by_their_names(tmp_path: Path) -> None:
    path = tmp_path / "curves.json"
    names = {"Gyro. X": True, "gz": True, "Accel. Y": False, "ax": False, "Temperature": None}
    entry = {"wvar": {name: {"variance": [3.0, 2.0, 1.0]} for name in names} | {"broken": 3}}
    path.write_text(json.dumps({"S": entry, "T": entry | {"freq": [100.0]}, "U": 3, "V": {"wvar": 3}}))
    found = formats.read_curves(path)
    assert [c.label for c in found] == [f"{sensor} {name}" for sensor in "ST" for name in names]
    assert [c.is_gyro for c in found] == list(names.values()) * 2
    for curve in found:
        np.testing.assert_array_equal(
            curve.tau_s, np.array([2.0, 4.0, 8.0]) / (1.0 if curve.label[0] == "S" else 100.0)
        )
        np.testing.assert_array_equal(curve.value, [3.0, 2.0, 1.0])
