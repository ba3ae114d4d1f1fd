"""Every long command on a standing Dask cluster gives what it gives without one."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from insemu.cli import main
from tests.test_sweep import SCENARIO

pytestmark = pytest.mark.usefixtures("without_pictures")

#: Command line, and the file that it writes (none: it prints JSON).
COMMANDS = {
    "compare": ("compare s.yaml --json", ""),
    "regress": ("regress record s.yaml --baseline b.json", "b.json"),
    "sweep": ("sweep s.yaml --over outage=[5s] --json --output NAME", ""),
    "select": ("select log.npz --general GM()+WN() --json", ""),
    "bootstrap": ("fit log.npz --model WN() --bootstrap 20 --json", ""),
}
#: Commands that take more than ten seconds here.
LONG = ("compare", "regress", "sweep")


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """Two worker processes that only this machine can reach."""
    from distributed import LocalCluster

    given = {"host": "127.0.0.1", "dashboard_address": None, "silence_logs": 50}
    with LocalCluster(n_workers=2, threads_per_worker=1, **given) as cluster:
        yield str(cluster.scheduler_address)


@pytest.mark.filterwarnings("default")  # of the cluster's own
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=pytest.mark.slow(reason="another case of a quick test")) if n in LONG else n
        for n in COMMANDS
    ],
)
def test_a_command_says_the_same_on_a_cluster(
    name: str, address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.yaml").write_text(yaml.safe_dump(SCENARIO, sort_keys=False), encoding="utf-8")
    values = np.random.default_rng(1).standard_normal((6000, 1))
    np.savez("log.npz", data=values, fs=100.0, columns=np.array(["gx"]), units=np.array(["rad/s"]))
    asked: list[str] = []
    _counted(monkeypatch, asked)
    said = []
    line, written = COMMANDS[name]
    for k, more in enumerate(([], ["--cluster", address])):
        with pytest.raises(SystemExit) as end:
            main([word.replace("NAME", f"out{k}") for word in line.split()] + more)
        printed = capsys.readouterr().out
        assert end.value.code in (0, None)
        said.append(json.loads(Path(written).read_text() if written else printed))
        assert bool(asked) == bool(more), "work goes to the cluster when it is asked for, and only then"
    plain, spread = (without_times(document) for document in said)
    assert close(plain, spread) if name == "bootstrap" else plain == spread


def _counted(monkeypatch: pytest.MonkeyPatch, asked: list[str]) -> None:
    """Count what is given to the cluster."""
    from insemu.cluster import ClusterPool

    plain = ClusterPool.submit

    def submit(self: Any, fn: Any, /, *arguments: Any, **named: Any) -> Any:
        asked.append(getattr(fn, "__name__", "work"))
        return plain(self, fn, *arguments, **named)

    monkeypatch.setattr(ClusterPool, "submit", submit)


def close(one: Any, other: Any) -> bool:
    """Whether two documents agree to rounding: sums of a fit depend in their last bits on where its arrays lie in memory."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(close(v, other[k]) for k, v in one.items())
    if isinstance(one, list):
        return len(one) == len(other) and all(map(close, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=1e-9)
    return bool(one == other)


def without_times(document: Any) -> Any:
    """The document without what a clock measured; NaN as a word, which equals itself."""
    if isinstance(document, dict):
        return {k: without_times(v) for k, v in document.items() if "seconds" not in k}
    if isinstance(document, list):
        return [without_times(v) for v in document]
    return "nan" if document != document else document
