"""What several test files ask for by name, and what is said at the end of tests that were left out."""

from __future__ import annotations

import gc
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import hypothesis
import pytest

from insemu.blas import one_thread_by_default

# before anything loads a BLAS: two processes with two threads each on two cores wait for each other, by spinning
one_thread_by_default()
# how long an example takes says how busy the machine is
hypothesis.settings.register_profile("here", deadline=None)
hypothesis.settings.load_profile("here")

#: All tests that were collected, also those that a choice of marks leaves out; why slow tests were left out, counted.
COLLECTED: pytest.StashKey[list[pytest.Item]] = pytest.StashKey()
SLOW: pytest.StashKey[Counter[str]] = pytest.StashKey()


#: Imports of a file whose tests need the compiled filter.
FLIES = re.compile(
    r"^(?:from|import) (?:insemu\b.*\b(?:filters|evaluate|gap|solve|cli|ins)\b|tests\.(?:filter_cases|test_filters|test_gap))",
    re.M,
)
#: Of a slow test without a reason, which a test refuses.
UNSTATED = "no reason, expected slow(reason='...')"


@pytest.fixture
def without_pictures(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages without the static pictures beside them, which are half of a small run's time; a test marked ``pictures`` has them."""
    if request.node.get_closest_marker("pictures") is None:
        monkeypatch.setattr("insemu.report.static.save", lambda *_, **__: [])


@pytest.fixture
def all_collected(request: pytest.FixtureRequest) -> list[pytest.Item]:
    """Every test that was collected, slow ones too."""
    return request.config.stash[COLLECTED]


def why_slow(item: pytest.Item) -> str:
    """The reason that a slow test states; empty for others."""
    mark = item.get_closest_marker("slow")
    if mark is None:
        return ""
    return str(mark.kwargs.get("reason", "")) or UNSTATED


@cache
def flies(path: Path) -> bool:
    """Whether a file of tests uses the filters, or a room above them."""
    return FLIES.search(path.read_text(encoding="utf-8")) is not None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    # of two processes the second one begins in the middle, and would wait for the filter that the first one compiles
    items.sort(key=lambda item: not flies(item.path))
    config.stash[COLLECTED] = list(items)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """What is imported and collected stays: looking through it for garbage again and again takes a fifth of the time of collecting."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_deselected(items: Sequence[pytest.Item]) -> None:
    for item in items:
        if reason := why_slow(item):
            item.config.stash.setdefault(SLOW, Counter())[reason] += 1


def pytest_sessionfinish(session: pytest.Session) -> None:
    output = getattr(session.config, "workeroutput", None)
    if output is not None:  # a process of pytest-xdist, each of which collects all tests
        output["slow"] = dict(session.config.stash.get(SLOW, Counter()))


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    if found := getattr(node, "workeroutput", {}).get("slow"):
        node.config.stash[SLOW] = Counter(found)


def left_out(skipped: Sequence[str], slow: Counter[str]) -> list[str]:
    """Lines that say how many tests were left out and why."""
    lines = []
    for what, counts in (("skipped", Counter(skipped)), ("slow, left to `make test-slow`", slow)):
        if counts:
            lines.append(f"{counts.total()} {what}:")
            lines += [f"  {n:4d}  {reason}" for reason, n in counts.most_common()]
    return lines


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    reports = terminalreporter.stats.get("skipped", [])
    reasons = [str(r.longrepr[2] if isinstance(r.longrepr, tuple) else r.longrepr) for r in reports]
    lines = left_out([r.removeprefix("Skipped: ") for r in reasons], config.stash.get(SLOW, Counter()))
    if lines:
        terminalreporter.section("left out")
        for line in lines:
            terminalreporter.write_line(line)
