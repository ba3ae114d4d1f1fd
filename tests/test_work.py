"""Work items that are kept and gone on with."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from insemu.errors import InputError
from insemu.work import Arrays, Lines, processes, run_items


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


def test_archives_come_back_and_a_half_written_one_counts_as_absent(tmp_path) -> None:
    store = Arrays(tmp_path / "folder")
    assert store.get("00001") is None
    store.put("00001", {"a": np.arange(3.0), "names": np.array(["x", "y"])})
    kept = store.get("00001")
    assert kept is not None
    np.testing.assert_array_equal(kept["a"], np.arange(3.0))
    assert list(kept["names"]) == ["x", "y"]
    path = tmp_path / "folder" / "00001.npz"
    path.write_bytes(path.read_bytes()[:100])
    assert store.get("00001") is None
