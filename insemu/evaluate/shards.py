"""Parts of a run made by processes that know nothing of each other, and put together afterwards."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from insemu.errors import InputError
from insemu.evaluate.experiment import Experiment
from insemu.evaluate.running import not_kept
from insemu.shown import count_of
from insemu.whole import put

#: Folder of the notes that shards leave: what they belong to.
SHARDS = "shards"


@dataclass(frozen=True)
class Shard:
    """Part ``number`` (from 1) of ``count`` equal ones: realizations that follow each other, so that what is finished can be added up.

    Parameters
    ----------
    number, count : int
    """

    number: int
    count: int

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Read ``3/40``.

        Raises
        ------
        InputError
            Anything else.
        """
        number, slash, count = text.partition("/")
        if not (slash and number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
            raise InputError(f"found '{text}', expected a shard such as 3/40", where="--shard")
        return cls(int(number), int(count))

    def realizations(self, total: int) -> range:
        """Those of ``total`` that belong to it."""
        return range(total * (self.number - 1) // self.count, total * self.number // self.count)

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"


def note(folder: Path, shard: Shard, run: Mapping[str, Any]) -> None:
    """Leave word of what a shard belongs to: the command's scenario, overrides and variants, and the digest.

    Parameters
    ----------
    folder : path
    shard : Shard
    run : mapping
    """
    put(folder / SHARDS / f"{shard.number}-of-{shard.count}.json", json.dumps(run, indent=1))


def noted(folder: Path) -> tuple[dict[str, Any], int]:
    """The run that all shards of a folder belong to, and how many parts it was last cut into.

    Raises
    ------
    InputError
        No shards, a note that is none, or shards of different runs.
    """
    found: dict[Path, dict[str, Any]] = {}
    for path in sorted((folder / SHARDS).glob("*-of-*.json")):
        try:
            found[path] = json.loads(path.read_text(encoding="utf-8"))
            _ = found[path]["scenario"], found[path]["overrides"], found[path]["variants"]
        except (ValueError, KeyError, TypeError):
            raise InputError("expected the note of a shard", where=str(path)) from None
    if not found:
        raise InputError("holds no shards; expected a folder that insemu run --shard wrote to", where=str(folder))
    first, *others = found
    for other in others:
        if found[other] != found[first]:
            raise InputError(f"belongs to another run than {first.name}", where=str(other))
    return found[first], int(max(found, key=lambda path: path.stat().st_mtime).stem.rpartition("-")[2])


def check_complete(experiments: Mapping[str, Experiment], folder: Path, cache: Path, count: int) -> None:
    """Raise ``InputError`` that names the shards whose realizations are not all kept.

    Parameters
    ----------
    experiments : mapping of variant to Experiment
    folder : path
        Named in the message.
    cache : path
        Where realizations are kept.
    count : int
        Number of shards that missing realizations are counted in.
    """
    missing: dict[int, int] = {}
    for experiment in experiments.values():
        gone = set(not_kept(experiment, cache))
        for number in range(1, count + 1) if gone else ():
            if left := len(gone & set(Shard(number, count).realizations(experiment.realizations))):
                missing[number] = missing.get(number, 0) + left
    if missing:
        names = ", ".join(
            f"{number}/{count} ({count_of(left, 'realization')})" for number, left in sorted(missing.items())
        )
        raise InputError(f"these shards are missing or not finished: {names}", where=str(folder))
