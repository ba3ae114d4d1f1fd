"""Folders of results: one writer at a time, whole files only, and a marker that is written last."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from insemu.errors import InputError
from insemu.evaluate.provenance import CRATE, crate, sha256
from insemu.evaluate.results import Results, outage_rows, summary
from insemu.scenario import Scenario
from insemu.whole import put, replacing

#: Says that everything beside it is there: scenario, realizations and the sha256 of every file. Absent: the folder is not finished.
MARKER = "complete.json"
LOCK = ".lock"
CACHE = "cache"


@contextmanager
def only_writer(folder: Path, *, shared: bool = False) -> Iterator[None]:
    """Hold a folder of results; it is made where it does not exist.

    Parameters
    ----------
    folder : path
    shared : bool
        Hold it together with others who add items to what is kept, but write no results.

    Raises
    ------
    InputError
        Another process writes into it; names that process.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / LOCK
    with path.open("a+", encoding="utf-8") as handle:
        if (
            not _locked(handle.fileno(), shared)
            or not path.exists()
            or path.stat().st_ino != os.fstat(handle.fileno()).st_ino
        ):
            handle.seek(0)
            other = handle.read().strip() or "another process"
            raise InputError(
                f"is being written by {other}; wait for it, or choose another folder (--out)", where=str(folder)
            )
        handle.truncate(0)
        handle.write(f"process {os.getpid()} on {platform.node()} since {time.strftime('%Y-%m-%d %H:%M:%S')}\n")
        handle.flush()
        try:
            yield
        finally:
            if not shared:  # others may hold it still
                path.unlink(missing_ok=True)


def _locked(descriptor: int, shared: bool) -> bool:
    """Take the lock; a process that ends in any way gives it back."""
    try:
        import fcntl
    except ImportError:  # not a POSIX system: nothing keeps a second process out
        return True
    try:
        fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def resolved(scenario: Scenario) -> str:
    """The scenario as YAML that loads again."""
    plain = scenario.model_dump(mode="json", exclude_none=True)
    return yaml.safe_dump(plain, sort_keys=False, allow_unicode=True)


def write(results: Results, folder: Path) -> None:
    """Write ``summary.json``, ``outages.csv``, ``errors.nc`` and ``manifest.json``; whatever marked the folder as complete is taken away first.

    ``errors.nc`` holds all epochs of some realizations (of all where they are few), and in the groups ``runs`` and ``statistics`` values of every
    realization at the outages, and statistics over all of them at every epoch.

    Parameters
    ----------
    results : Results
    folder : path
        Made where it does not exist.
    """
    (folder / MARKER).unlink(missing_ok=True)
    put(folder / "summary.json", json.dumps(summary(results), indent=1))
    put(folder / "manifest.json", json.dumps(results.manifest, indent=1, default=str))
    rows = outage_rows(results)
    stream = io.StringIO(newline="")
    if rows:
        table = csv.DictWriter(stream, list(rows[0]))
        table.writeheader()
        table.writerows(rows)
    put(folder / "outages.csv", stream.getvalue())
    with replacing(folder / "errors.nc") as partial:
        results.to_dataset().to_netcdf(partial, engine="h5netcdf")
        results.runs.to_netcdf(partial, engine="h5netcdf", group="runs", mode="a")
        results.statistics.to_netcdf(partial, engine="h5netcdf", group="statistics", mode="a")


def _identity(scenario: Scenario) -> str:
    return hashlib.sha256(resolved(scenario.model_copy(update={"realizations": 1})).encode()).hexdigest()


def check_not_fewer(folder: Path, scenario: Scenario) -> None:
    """Raise ``InputError`` where the folder holds more realizations of the same scenario than would now be written."""
    try:
        held: dict[str, Any] = json.loads((folder / MARKER).read_text(encoding="utf-8"))
        more = held["scenario"] == _identity(scenario) and int(held["realizations"]) > scenario.realizations
    except (OSError, ValueError, KeyError, TypeError):
        return
    if more:
        raise InputError(
            f"holds {held['realizations']} realizations of this scenario, which {scenario.realizations} would replace; expected another folder "
            "(--out) or --overwrite",
            where=str(folder),
        )


def finish(folder: Path, scenario: Scenario, results: Results) -> None:
    """Write the RO-Crate and the marker: everything that is there now belongs to these results.

    Parameters
    ----------
    folder : path
    scenario : Scenario
    results : Results
        Of the scenario itself, not of a variant.
    """
    files = sorted(p for p in folder.rglob("*") if p.is_file() and CACHE not in p.relative_to(folder).parts)
    hashes = {str(p.relative_to(folder)): sha256(p) for p in files if p.name not in (MARKER, LOCK, CRATE)}
    put(folder / CRATE, crate(results.title, results.manifest, hashes))
    hashes[CRATE] = sha256(folder / CRATE)
    document = {
        "scenario": _identity(scenario),
        "digest": results.digest,
        "realizations": results.realizations,
        "files": hashes,
    }
    put(folder / MARKER, json.dumps(document, indent=1))
