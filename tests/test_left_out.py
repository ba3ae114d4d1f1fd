"""Slow tests state a reason, and what was left out is said with its reason."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace

import pytest

from tests.conftest import UNSTATED, left_out, why_slow


def marked(*args: object, **kwargs: object) -> SimpleNamespace:
    return SimpleNamespace(nodeid="a.py::b", get_closest_marker=lambda _: pytest.mark.slow(*args, **kwargs).mark)


def test_a_slow_test_states_its_reason() -> None:
    assert why_slow(marked(reason="hours of flight")) == "hours of flight"
    assert why_slow(SimpleNamespace(get_closest_marker=lambda _: None)) == ""
    for mark in (marked(), marked(reason=""), marked("hours of flight")):
        assert why_slow(mark) == UNSTATED


def test_every_slow_test_that_was_collected_states_a_reason(all_collected: list[pytest.Item]) -> None:
    assert [i.nodeid for i in all_collected if why_slow(i) == UNSTATED] == []


def test_what_was_left_out_is_counted_by_reason() -> None:
    lines = left_out(["no browser", "no Docker", "no browser"], Counter({"many draws": 3}))
    assert lines == [
        "3 skipped:",
        "     2  no browser",
        "     1  no Docker",
        "3 slow, left to `make test-slow`:",
        "     3  many draws",
    ]
    assert left_out([], Counter()) == []
