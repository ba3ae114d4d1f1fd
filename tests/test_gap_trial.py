"""The blind trial and the commands: reproducible recordings, honest scores, files that the next command reads."""

from __future__ import annotations

import json

import numpy as np
import pytest

from insemu import formats
from insemu.cli import main
from insemu.errors import InputError
from insemu.gap import load_nominal
from insemu.gap.trial import STATIC_EFFECTS, Trial, known_effects, run_one, score_trials, static_recording
from insemu.noise import BI, WN
from insemu.records import Series


def trial(
    hidden: str, found: tuple[str, ...], members: tuple[str, ...], right: bool = True, verdict: str = "named"
) -> Trial:
    return Trial(1, hidden, "x", 1.0, verdict, found, members, 0.99, 10.0, right, (1.0, 0.9, 1.1), 0.1)


def test_scores_count_names_classes_and_false_alarms() -> None:
    scores = score_trials(
        [
            trial("none", (), (), verdict="nothing missing"),
            trial("none", ("ramp x",), ("ramp",)),
            trial("flicker", ("flicker x",), ("flicker",)),
            trial("flicker", ("flicker y",), ("flicker",), right=False),
            trial("flicker", ("ramp x",), ("ramp", "flicker"), verdict="class"),
            trial("telegraph", (), (), verdict="nothing missing"),
        ]
    )
    assert scores.false_alarms == (1, 2)
    assert scores.named_right == (1, 2)
    assert scores.in_class == (1, 1)
    assert scores.detected == (3, 4)
    assert scores.confusion["flicker"] == {"flicker": 2, "ramp": 1}
    assert scores.mean_class_size == 2.0


@pytest.mark.parametrize("effect", STATIC_EFFECTS)
def test_every_effect_can_be_hidden_and_changes_one_axis_or_the_sensor(effect: str) -> None:
    log, beliefs, temperature, axis = static_recording(effect, 4.0, 5, hours=0.05)
    again, *_ = static_recording(effect, 4.0, 5, hours=0.05)
    assert all(np.array_equal(a.values, b.values) for a, b in zip(log, again, strict=True))
    assert set(beliefs) == {"gyro_x", "gyro_y", "gyro_z"}
    assert temperature.shape == log[0].values.shape
    assert axis in (0, 1, 2)


def test_a_strong_line_is_found_and_nothing_in_a_clean_log() -> None:
    found = run_one("vibration_line", 4.0, 11, hours=0.3)
    assert found.found[0].split()[0] == "vibration_line"
    assert found.axis_right
    assert run_one("none", 1.0, 12, hours=0.3).verdict == "nothing missing"


def test_unknown_effects_are_refused() -> None:
    with pytest.raises(InputError, match="did you mean 'flicker'"):
        known_effects(["flickr"])
    with pytest.raises(InputError, match="at rest cannot show"):
        known_effects(["lever_arm"])


def test_the_command_writes_a_report_and_a_refined_belief(tmp_path, capsys) -> None:
    rng = np.random.default_rng(3)
    y = WN(1e-3).simulate(24_000, 0.05, rng) + BI(1e-3).simulate(24_000, 0.05, rng)
    formats.write(tmp_path / "log.npz", [Series(y, 20.0, "rad/s", "gyro_x")])
    (tmp_path / "belief.yaml").write_text("belief:\n  gyro_x: WN(N=1e-3 rad/s/sqrt(Hz))\n")
    arguments = [
        "gap",
        str(tmp_path / "belief.yaml"),
        "--measured",
        str(tmp_path / "log.npz"),
        "--out",
        str(tmp_path / "out"),
        "--json",
    ]
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 0
    face = json.loads(capsys.readouterr().out)
    assert face["steps"][0]["effect"] == "flicker"
    assert face["steps"][0]["axes"] == ["x"]
    refined = load_nominal(tmp_path / "out" / "refined.yaml")
    assert str(refined.beliefs["gyro_x"]).count("BI(") == 1
    assert "<img" in (tmp_path / "out" / "index.html").read_text()
    with pytest.raises(SystemExit) as stop:
        main([*arguments[:2], "--measured", str(tmp_path / "absent.npz")])
    assert stop.value.code == 2
