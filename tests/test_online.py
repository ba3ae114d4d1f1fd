"""A model beside a stream: the same as from the whole record, alarms at their rate, changes and faults told apart."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from insemu.cli import app
from insemu.errors import InputError
from insemu.fit import Alarm, OnlineFit, Update, fit
from insemu.formats import write
from insemu.noise import GM, WN, NoiseModel
from insemu.records import Series
from insemu.variance import wavelet_variance

MODEL = WN(N=1e-3) + GM(sigma=1e-3, Tc=20.0)
ASKED = NoiseModel.parse("WN() + GM()")
RATE_HZ = 10.0


def watched(**options: float) -> OnlineFit:
    return OnlineFit(ASKED, RATE_HZ, **{"window_s": 60.0, "unit": "rad/s", "name": "gyro_x", **options})  # type: ignore[arg-type]


def test_a_stream_in_odd_pieces_gives_the_fit_of_the_record() -> None:
    x = MODEL.simulate(24_000, 1.0 / RATE_HZ, np.random.default_rng(1))
    one = watched(false_alarms=1e-9)
    events = [e for piece in np.split(x, [7, 5000, 5001, 17_000]) for e in one.push(piece)]
    assert [e.windows for e in events if isinstance(e, Update)] == [10, 20, 30, 40]
    whole = wavelet_variance(x, RATE_HZ)
    np.testing.assert_allclose(one.curve().value, whole.value, rtol=1e-9)
    expected = fit(Series(x, RATE_HZ, "rad/s", "gyro_x"), ASKED, weighting="asymptotic")
    for e in expected.parameters:
        assert one.fitted()[e.label].value == pytest.approx(e.value, rel=1e-6)


def test_stretches_around_missing_samples_are_pooled() -> None:
    x = MODEL.simulate(12_000, 1.0 / RATE_HZ, np.random.default_rng(2))
    x[3100] = np.nan  # in the sixth window of 600
    one = watched(false_alarms=1e-9, learn=50)
    events = list(one.push(x))
    assert [(e.kind, e.t_s) for e in events if isinstance(e, Alarm)] == [("missing", 300.0)]
    parts = [wavelet_variance(p, RATE_HZ) for p in (x[:3000], x[3600:])]
    J = parts[0].value.size
    pooled = sum(p.value[:J] * p.n_coefficients[:J] for p in parts) / sum(p.n_coefficients[:J] for p in parts)
    np.testing.assert_allclose(one.curve().value[:J], pooled, rtol=1e-9)


def test_outliers_and_levels_are_told_apart() -> None:
    rng = np.random.default_rng(3)
    x = MODEL.simulate(18_000, 1.0 / RATE_HZ, rng)
    x[9000 + 100] += 0.2  # one sample in window 15
    x[10_800:11_400] *= 2.0  # window 18
    x[13_800:] *= 1.5  # from window 23 on
    alarms = [e for e in watched(false_alarms=1e-4).push(x) if isinstance(e, Alarm)]
    by = {round(a.t_s): a.kind for a in alarms if a.kind != "change"}
    assert by[900] == "outliers"
    assert by[1080] == "level"
    assert [by.get(t) for t in (1380, 1440, 1500)] == ["level"] * 3
    (change,) = [a for a in alarms if a.kind == "change"]
    assert change.t_s == 1500.0
    assert 1.5 < change.ratio < 3.0
    assert set(by) == {900, 1080, 1380, 1440, 1500}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"window_s": 10.0}, "expected at least 256"),
        ({"false_alarms": 0.7}, "between 0 and 0.5"),
        ({"learn": 0}, "one or more"),
    ],
)
def test_wrong_settings_are_said(options: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        watched(**options)


def test_the_command_watches_a_file_and_standard_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    x = WN(N=1e-3).simulate(8000, 1.0 / RATE_HZ, np.random.default_rng(4))
    x[7000:] *= 3.0
    log = tmp_path / "log.csv"
    write(log, [Series(x, RATE_HZ, "rad/s", "gyro_x")])
    options = ["-m", "WN()", "--window", "30 s", "--false-alarm", "1e-6", "--json"]
    told = CliRunner().invoke(app, ["watch", str(log), *options])
    assert told.exit_code == 0, told.output
    events = [json.loads(line) for line in told.stdout.splitlines()]
    assert [e["event"] for e in events] == ["fit", "fit", "level", "level", "level", "change"]
    assert events[0]["parameters"][0]["value"] == pytest.approx(1e-3, rel=0.1)
    typed = CliRunner().invoke(app, ["watch", "-", *options], input=log.read_text())
    assert typed.stdout == told.stdout
    for text, message in (
        ("1.0,2.0\n", "expected a header"),
        ("t [s],gx [rad/s]\n0,1\n0.1,x\n", "-:3"),
        ("gx\n1\n", "no sampling rate"),
    ):
        wrong = CliRunner().invoke(app, ["watch", "-", *options], input=io.StringIO(text).getvalue())
        assert isinstance(wrong.exception, InputError)
        assert message in str(wrong.exception)
