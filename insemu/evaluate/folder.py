"""Folders of results: one writer at a time, whole files only, and a marker that is written last."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import platform
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO

import portalocker
import yaml

from insemu.errors import InputError
from insemu.evaluate.netcdf import write_netcdf
from insemu.evaluate.provenance import CRATE, crate, sha256
from insemu.evaluate.results import Results, outage_rows, summary
from insemu.scenario import Scenario
from insemu.whole import clear_partials, put, replacing

#: Says that everything next to it is there: scenario, realizations and the sha256 of every file. Absent: the folder is not finished.
MARKER = "complete.json"
#: What is locked, and next to it who locked it.
LOCK, WRITER = ".lock", ".writer"
#: How long the run took: the one file that a repeated run does not write with the same bytes.
TIMING = "timing.json"
#: How long the processes that a killed writer leaves are waited for, s: they draw a picture or fly a realization.
LEFT = 20.0
CACHE = "cache"


@contextmanager
def only_writer(folder: Path, *, shared: bool = False) -> Iterator[None]:
    """Hold a folder of results; it is made where it does not exist, and what a killed writer left half written is removed.

    Input that is refused leaves no folder that was made for it.

    Parameters
    ----------
    folder : path
    shared : bool
        Hold it together with others who add items to what is kept, but write no results.

    Raises
    ------
    InputError
        Another process writes into it; names that process. Or the file system cannot lock. Those that a killed writer had started are waited
        for, at most :data:`LEFT` seconds.
    """
    made = [f for f in (folder, *folder.parents) if not f.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    path, writer = folder / LOCK, folder / WRITER
    refused, until = False, time.monotonic() + LEFT
    while (held := _held(path, shared)) is None:
        # a process that was killed leaves those that it had started, which end by themselves and hold the lock so long
        if not _ended(writer) or time.monotonic() > until:
            raise InputError(
                f"is being written by {_writer_text(writer)}; wait for it, or choose another folder (--output)",
                where=str(folder),
            )
        time.sleep(0.05)
    with held as handle:
        try:
            if not shared:
                clear_partials(folder)
            put(writer, f"process {os.getpid()} on {platform.node()} since {time.strftime('%Y-%m-%d %H:%M:%S')}\n")
            yield
        except InputError:
            refused = True
            raise
        finally:
            if not shared:  # others may hold it still
                for file in (writer, path):  # Windows removes no open file: there it goes below
                    with suppress(OSError):
                        file.unlink()
            portalocker.unlock(handle)
            if refused:
                with suppress(OSError):  # one that holds something stays
                    for empty in made:
                        empty.rmdir()
    if os.name == "nt" and not shared:  # refused where another process has opened it meanwhile
        with suppress(OSError):
            path.unlink()


def _held(path: Path, shared: bool) -> TextIO | None:
    """The lock, open and held, or None where another process holds it."""
    handle = path.open("a+", encoding="utf-8")
    try:
        portalocker.lock(handle, portalocker.LOCK_NB | (portalocker.LOCK_SH if shared else portalocker.LOCK_EX))
        if os.path.samestat(path.stat(), os.fstat(handle.fileno())):  # else the last holder removed it meanwhile
            return handle
    except (portalocker.AlreadyLocked, FileNotFoundError):
        pass
    except portalocker.LockException as error:
        handle.close()
        raise InputError(
            f"is on a file system that cannot lock files ({error}); choose another folder (--output)",
            where=str(path.parent),
        ) from None
    handle.close()
    return None


def _ended(writer: Path) -> bool:
    """Whether the process that is named as the writer was one of this machine and is no more."""
    found = re.match(r"process (\d+) on (\S+) since", _writer_text(writer))
    if found is None or found[2] != platform.node() or os.name == "nt":
        return False
    try:
        os.kill(int(found[1]), 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):
        pass
    return False


def _writer_text(writer: Path) -> str:
    """Who holds the folder, as the holder wrote it: together with the lock, because Windows lets nobody read a locked file."""
    try:
        return writer.read_text(encoding="utf-8").strip() or "another process"
    except (OSError, UnicodeDecodeError):
        return "another process"


def resolved(scenario: Scenario) -> str:
    """The scenario as YAML that loads again."""
    plain = scenario.model_dump(mode="json", exclude_none=True)
    return yaml.safe_dump(plain, sort_keys=False, allow_unicode=True)


def write(results: Results, folder: Path) -> None:
    """Write ``summary.json``, ``outages.csv``, ``errors.nc``, ``manifest.json`` and ``timing.json``; a mark of the folder as complete goes first.

    ``errors.nc`` holds all epochs of some realizations (of all where they are few), and in the groups ``runs`` and ``statistics`` values of every
    realization at the outages, and statistics over all of them at every epoch.

    Parameters
    ----------
    results : Results
    folder : path
        Made where it does not exist.
    """
    (folder / MARKER).unlink(missing_ok=True)
    write_summary(results, folder)
    put(folder / "manifest.json", json.dumps(results.manifest, indent=1, default=str))
    put(folder / TIMING, json.dumps(dict(results.timing), indent=1))
    rows = outage_rows(results)
    stream = io.StringIO(newline="")
    if rows:
        table = csv.DictWriter(stream, list(rows[0]))
        table.writeheader()
        table.writerows(rows)
    put(folder / "outages.csv", stream.getvalue())
    with replacing(folder / "errors.nc") as partial:
        write_netcdf(partial, {"": results.to_dataset(), "runs": results.runs, "statistics": results.statistics})


def write_summary(results: Results, folder: Path) -> None:
    """Write ``summary.json`` alone, which is all that error budgets are part of."""
    folder.mkdir(parents=True, exist_ok=True)
    with replacing(folder / "summary.json") as partial, partial.open("w", encoding="utf-8", newline="\n") as file:
        json.dump(summary(results), file, indent=1)  # piece by piece: with thousands of realizations the text is large


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
            "(--output) or --overwrite",
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
    hashes = {
        str(p.relative_to(folder)): sha256(p) for p in files if p.name not in (MARKER, LOCK, WRITER, CRATE, TIMING)
    }
    put(folder / CRATE, crate(results.title, results.manifest, hashes))
    hashes[CRATE] = sha256(folder / CRATE)
    document = {
        "scenario": _identity(scenario),
        "digest": results.digest,
        "realizations": results.realizations,
        "files": hashes,
    }
    put(folder / MARKER, json.dumps(document, indent=1))
