"""A few of the kills and faults of ``python -m tests.crash``, on the command that is the quickest to run."""

from __future__ import annotations

import pytest

from tests import crash


@pytest.fixture(scope="module")
def whole() -> tuple[dict[str, str], float]:
    crash.warm(["regress record"])
    return crash.undisturbed("regress record")


@pytest.mark.parametrize("kind", ["kill", *(f.__name__ for f in crash.FAULTS if f.__name__ != "small_disk")])
def test_the_same_command_again_gives_the_same_bytes(kind: str, whole: tuple[dict[str, str], float]) -> None:
    assert crash.disturb(crash.Trial("regress record", kind, 3), *whole) == ""


@pytest.mark.slow(reason="whole commands, whose parts have quick tests")
@pytest.mark.parametrize("command", [c for c in crash.COMMANDS if c != "regress record"])
def test_other_commands(command: str) -> None:
    crash.warm([command])
    whole = crash.undisturbed(command)
    for number in range(4):
        assert crash.disturb(crash.Trial(command, "kill", number), *whole) == ""


def test_a_cut_off_baseline_is_seen(tmp_path: crash.Path) -> None:
    (tmp_path / "base.json").write_text('{"a": 1')
    assert crash.half_taken_for_whole(tmp_path, ("base.json",)) == "base.json is cut off"


def test_times_are_left_out_of_the_comparison_and_nothing_else(tmp_path: crash.Path) -> None:
    def of(crate: str, summary: str) -> dict[str, str]:
        (tmp_path / "out").mkdir(exist_ok=True)
        (tmp_path / "out" / "ro-crate-metadata.json").write_text(crate)
        (tmp_path / "out" / "summary.json").write_text(summary)
        return crash.content(tmp_path, ("out",))

    one = of('{"sha256": "00"}', '{"x": 1, "elapsed": 2.0}')
    assert of('{"sha256": "00"}', '{"x": 1, "elapsed": 3.0}') == one
    assert of('{"sha256": "ff"}', '{"x": 1, "elapsed": 2.0}') != one
    assert of('{"sha256": "00"}', '{"x": 2, "elapsed": 2.0}') != one
