"""Interrupted, in shards, on a cluster: the same results to the bit."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from insemu.cli import main
from insemu.cluster import cluster
from insemu.compiled import compiled_beside, wait_for_kernels
from insemu.errors import InputError
from insemu.evaluate import Experiment, Resources, Shard, kernels, run_experiment, running
from insemu.evaluate import write as write_results
from insemu.evaluate.folder import TIMING, only_writer
from insemu.scenario import load
from tests.test_run import SCENARIO, run, write

pytestmark = pytest.mark.usefixtures("without_pictures")

SIX = {"realizations": 6, "variants": {}, "fits": None, "designs": {"full": SCENARIO["designs"]["full"]}}


def figures(folder: Path) -> bytes:
    return (folder / "summary.json").read_bytes()


def same(one: Path, other: Path) -> bool:
    """The same bytes in every file but the times and what is kept on the way."""
    names = [
        {p.relative_to(f) for p in f.rglob("*") if p.is_file() and "cache" not in p.parts and p.name != TIMING}
        for f in (one, other)
    ]
    return names[0] == names[1] and all((one / n).read_bytes() == (other / n).read_bytes() for n in names[0])


def groups_same(one: Path, other: Path) -> bool:
    """Values of every realization and statistics of all."""
    out = True
    for group in ("runs", "statistics"):
        with (
            xr.open_dataset(one / "errors.nc", group=group) as a,
            xr.open_dataset(other / "errors.nc", group=group) as b,
        ):
            out &= set(a) == set(b) and all(np.array_equal(a[n], b[n], equal_nan=True) for n in a)
    return out


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("plain")
    path = write(folder, **SIX, smoother=True)
    fly(path, folder / "out", workers=2)
    return path, folder / "out"


def fly(path: Path, out: Path, *, workers: int) -> None:
    write_results(
        run_experiment(Experiment(load(path), path), resources=Resources(workers=workers, cache=out / "cache")), out
    )


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Twenty realizations, all of whose epochs are kept."""
    folder = tmp_path_factory.mktemp("many")
    path = write(folder, **SIX | {"realizations": 20})
    fly(path, folder / "out", workers=2)
    return path, folder / "out"


@pytest.mark.slow(reason="hours of flight or many realizations")
def test_sums_that_were_added_on_the_way_are_those_of_all_epochs(
    many: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only a chosen few are kept whole, and everything that is told is the same to the bit; also after an interruption, and in shards."""
    path, whole = many
    monkeypatch.setattr(running, "FULL", 4)
    fly(path, tmp_path / "one", workers=2)
    assert figures(tmp_path / "one") == figures(whole) and groups_same(tmp_path / "one", whole)
    with xr.open_dataset(tmp_path / "one" / "errors.nc") as few, xr.open_dataset(whole / "errors.nc") as full:
        numbers = few["realization"].to_numpy()
        ends = np.hypot(*np.moveaxis(full["error"].to_numpy()[0, :, -1, :2], -1, 0))
        assert 0 in numbers and numbers.size <= 3 < full.sizes["realization"] and ends.size == 20
        for name in ("error", "sigma", "nees", "axis_error"):
            np.testing.assert_array_equal(few[name], full[name].isel(realization=numbers))
    names = sorted(p.name for p in (tmp_path / "one" / "cache").glob("*/*"))
    assert {"00000+8", "00008+8", "00016", "00019"} <= set(names) and "00009" not in set(names) - {
        f"{n:05d}" for n in numbers
    }

    nodes = sorted((tmp_path / "one" / "cache").glob("*/*"))
    shutil.copytree(tmp_path / "one" / "cache", tmp_path / "two" / "cache")
    damaged = next((tmp_path / "two" / "cache").glob("*/00008+8"))
    damaged.write_bytes(damaged.read_bytes()[:-9])
    next((tmp_path / "two" / "cache").glob("*/00017")).unlink()
    fly(path, tmp_path / "two", workers=1)
    assert same(tmp_path / "one", tmp_path / "two") and groups_same(tmp_path / "one", tmp_path / "two") and nodes

    for k in (3, 1, 3, 2):
        assert run(str(path), "--shard", f"{k}/3", "--output", str(tmp_path / "three")) == 0
    assert merge(tmp_path / "three") == 0
    assert groups_same(tmp_path / "one", tmp_path / "three")


def merge(folder: Path) -> int:
    with pytest.raises(SystemExit) as stop:
        main(["merge", str(folder)])
    return int(stop.value.code or 0)


def test_a_run_that_goes_on_has_the_bytes_of_one_in_one_piece(plain: tuple[Path, Path], tmp_path: Path) -> None:
    path, whole = plain
    out = tmp_path / "out"
    shutil.copytree(whole / "cache", out / "cache")
    items = sorted((out / "cache").glob("*/*"))
    assert len(items) == 6
    for gone in items[1::2]:
        gone.unlink()
    fly(path, out, workers=1)
    assert same(whole, out)
    assert not same(whole, altered(out))


def altered(folder: Path) -> Path:
    """The same results but for the last bit of one error: the comparison is one."""
    other = folder.with_name("altered")
    shutil.copytree(folder, other)
    with xr.open_dataset(folder / "errors.nc") as data:
        loaded = data.load()
    loaded["error"][0, 3, 50, 0] = np.nextafter(float(loaded["error"][0, 3, 50, 0]), 1e9)
    loaded.to_netcdf(other / "errors.nc", engine="h5netcdf")
    for group in ("runs", "statistics"):
        with xr.open_dataset(folder / "errors.nc", group=group) as data:
            data.to_netcdf(other / "errors.nc", engine="h5netcdf", group=group, mode="a")
    return other


def test_shards_in_any_order_and_twice_make_the_run(
    plain: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, whole = plain
    out = tmp_path / "out"
    order = [1, 2, 4, 4]
    random.Random(1).shuffle(order)
    for k in order:
        assert run(str(path), "--shard", f"{k}/4", "--output", str(out)) == 0
    capsys.readouterr()
    assert merge(out) == 2
    assert "missing or not finished: 3/4 (1 realization)" in capsys.readouterr().err
    assert not (out / "summary.json").exists()
    assert run(str(path), "--shard", "2/2", "--output", str(out)) == 0
    assert run(str(path), "--shard", "1/2", "--output", str(out)) == 0
    assert merge(out) == 0
    # error budgets come with a command
    found, expected = (json.loads((f / "summary.json").read_text()) for f in (out, whole))
    assert found["designs"]["full"].pop("error_budget")
    assert found == expected
    # another run's shard in the same folder
    other = write(tmp_path, **SIX, smoother=True, seed=4)
    assert run(str(other), "--shard", "1/6", "--output", str(out)) == 0
    capsys.readouterr()
    assert merge(out) == 2
    assert "belongs to another run" in capsys.readouterr().err


def test_shards_share_a_folder_and_keep_a_run_out(tmp_path: Path) -> None:
    with only_writer(tmp_path, shared=True), only_writer(tmp_path, shared=True):
        with pytest.raises(InputError, match="is being written by process"), only_writer(tmp_path):
            pass
    with only_writer(tmp_path), pytest.raises(InputError), only_writer(tmp_path, shared=True):
        pass


@pytest.mark.parametrize("text", ["0/3", "4/3", "3", "a/b", "1/0", "-1/2"])
def test_what_is_no_shard_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="expected a shard such as 3/40"):
        Shard.parse(text)


def dies_once(item: tuple[str, int]) -> int:
    """Kill the worker at its first call."""
    path, value = item
    if value == 3 and not Path(path).exists():
        Path(path).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return value**2


@pytest.mark.slow(reason="whole commands, whose parts have quick tests")
@pytest.mark.filterwarnings("default")  # of the cluster's own
def test_a_lost_worker_of_a_cluster_is_survived(tmp_path: Path) -> None:
    from insemu.work import run_items

    items = {str(k): (str(tmp_path / "died"), k) for k in range(6)}
    with cluster("local", 2) as pool:
        assert list(run_items(items, dies_once, pool=pool).values()) == [0, 1, 4, 9, 16, 25]
    assert (tmp_path / "died").exists()


def test_what_is_no_cluster_is_refused() -> None:
    with pytest.raises(InputError, match="expected local or tcp"), cluster("here", 2):
        pass
    with cluster("", 2) as pool:
        assert pool is None


def test_the_program_that_compiles_runs(capsys: pytest.CaptureFixture[str]) -> None:
    kernels.main()
    assert capsys.readouterr().out == "filter\n"


def test_kernels_are_compiled_by_another_process_where_they_are_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    from insemu import compiled

    with monkeypatch.context() as patched, compiled_beside("this", "insemu.filters.kernel.run"):
        assert compiled._beside is None  # the runs above have compiled it
        patched.setattr(compiled, "kept", lambda kernel: False)
        with compiled_beside("this", "insemu.filters.kernel.run"):
            assert compiled._beside is not None
            wait_for_kernels()
        assert compiled._beside is None
