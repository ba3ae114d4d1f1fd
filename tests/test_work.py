"""Work items that are kept and gone on with."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from insemu.errors import InputError
from insemu.work import Files, Lines, meanwhile, processes, run_items


def lines(path):
    return Lines(path, lambda r: {"square": r}, lambda plain: plain["square"], "squares")


def square(x: int) -> int:
    return x * x


@pytest.mark.parametrize("pool", ["none", "threads", "processes"])
def test_results_come_in_the_order_of_the_items_and_are_done_once(tmp_path, pool: str) -> None:
    items = {str(k): k for k in (3, 1, 2)}
    told: list[int] = []
    with {"none": lambda: processes(1), "threads": lambda: ThreadPoolExecutor(2), "processes": lambda: processes(2)}[
        pool
    ]() as executor:
        out = run_items(items, square, pool=executor, store=lines(tmp_path / "log"), done=told.append)
    assert list(out.items()) == [("3", 9), ("1", 1), ("2", 4)]
    assert sorted(told) == [1, 4, 9]

    def never(_: int) -> int:
        raise AssertionError

    again: list[int] = []
    assert run_items(items, never, store=lines(tmp_path / "log"), done=again.append) == out
    assert again == [9, 1, 4]


@pytest.mark.parametrize("pool", ["none", "processes"])
def test_work_meanwhile_takes_its_arguments_as_they_are(pool: str) -> None:
    """A pool packed up what its caller had changed in the meantime, or failed at it."""
    numbers = {"a": 1, "b": 2}
    with processes(1 if pool == "none" else 2) as executor:
        busy = [executor.submit(time.sleep, 0.2) for _ in range(6)] if executor is not None else []
        later = meanwhile(executor, len, numbers)
        if executor is not None:
            numbers["c"] = 3
        assert later() == 2
    assert all(b.done() for b in busy)


@pytest.mark.skipif(os.name == "nt", reason="signal 9 is of POSIX")
def test_processes_end_with_the_one_that_started_them_however_it_ends(tmp_path) -> None:
    # each hands on more than a pipe takes, so that none can end by itself once nobody reads
    code = """
import os, pathlib, signal, sys, time
from insemu.work import processes
begun = pathlib.Path(sys.argv[1])
def work(k):
    (begun / str(os.getpid())).touch()
    time.sleep(0.5)
    return bytes(10_000_000)
with processes(2) as pool:
    for k in range(4):
        pool.submit(work, k)
    while len(list(begun.iterdir())) < 2:
        time.sleep(0.01)
    os.kill(os.getpid(), signal.SIGKILL)
"""
    # standard output ends when the last process has ended
    ended = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, timeout=60, check=False)
    assert ended.returncode == -9, ended.stderr


def test_what_is_finished_is_kept_when_an_item_fails(tmp_path) -> None:
    def work(x: int) -> int:
        if x == 2:
            raise ValueError("two")
        return square(x)

    with pytest.raises(ValueError, match="two"):
        run_items({"1": 1, "2": 2, "3": 3}, work, store=lines(tmp_path / "log"))
    assert lines(tmp_path / "log").get("1") == 1
    assert lines(tmp_path / "log").get("2") is None


def test_a_line_that_was_cut_off_is_done_again_and_another_file_is_refused(tmp_path) -> None:
    path = tmp_path / "log"
    lines(path).put("a", 1)
    with path.open("a") as file:
        file.write('{"job": "b", "squ')
    store = lines(path)
    assert (store.get("a"), store.get("b")) == (1, None)
    store.put("b", 4)
    assert (lines(path).get("a"), lines(path).get("b")) == (1, 4)
    path.write_text('{"job": "a", "square": 1}\n{"other": 1}\n')
    with pytest.raises(InputError, match="log:2"):
        lines(path)


def test_a_file_of_lines_has_one_writer(tmp_path) -> None:
    path = tmp_path / "log"
    first, second, third = lines(path), lines(path), lines(path)
    first.put("a", 1)
    with pytest.raises(InputError, match="another process adds to this file"):
        second.put("a", 1)
    del first
    with pytest.raises(InputError, match="another process adds to this file"):
        third.put("a", 1)  # who wrote has ended, but what it wrote is not known here
    assert path.read_text() == '{"job": "a", "square": 1}\n'
    lines(path).put("b", 4)
    assert lines(path).get("b") == 4


def test_a_kept_item_that_does_not_match_is_said_and_made_again(tmp_path) -> None:
    said: list[str] = []

    def files(identity: str = "this") -> Files[str]:
        return Files(tmp_path / "folder", identity, str.encode, bytes.decode, said.append)

    store = files()
    assert store.get("00001") is None and not said
    store.put("00001", "one")
    store.put("00002", "two")
    assert (store.get("00001"), store.get("00002")) == ("one", "two")
    assert files("other").get("00001") is None  # of other work
    path = tmp_path / "folder" / "00001"
    whole = path.read_bytes()
    for wrong in (
        b"",
        whole[:-1],
        whole[:10],
        whole[:-1] + b"x",
        whole + b"x",
        (tmp_path / "folder" / "00002").read_bytes(),
    ):
        path.write_bytes(wrong)
        assert store.get("00001") is None
    path.unlink()
    path.mkdir()
    assert store.get("00001") is None
    assert len(said) == 8 and all("00001 is damaged" in text for text in said)
    store.put("00001", "one")
    assert store.get("00001") == "one"
