"""What scenarios of one process share: results kept under the digest of what they depend on, the latest few."""

from __future__ import annotations

import hashlib
import json
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

T = TypeVar("T")

#: Most samples of a flight that is kept when nobody uses it.
ROWS = 1_000_000


class Held:
    """The results that were asked for last.

    Parameters
    ----------
    most : int
        How many are kept.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self._kept: OrderedDict[Hashable, Any] = OrderedDict()
        self._lock = Lock()

    def get(self, key: Hashable, make: Callable[[], T], rows: int = 0) -> T:
        """What is kept under a key, or made now.

        Parameters
        ----------
        key : hashable
            Says everything that the result depends on.
        make : callable
        rows : int
            Samples that it holds; above :data:`ROWS` it is not kept.
        """
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                found: T = self._kept[key]
                return found
        made = make()
        if rows <= ROWS:
            with self._lock:
                self._kept[key] = made
                while len(self._kept) > self.most:
                    self._kept.popitem(last=False)
        return made


#: Of this process: references, their intervals, fitted beliefs.
HELD = Held(9)


def key_of(content: Any, files: Sequence[Path]) -> str:
    """A digest of plain data and of files: their paths and what they hold.

    Parameters
    ----------
    content : plain data
    files : sequence of path
    """
    read = [(str(file), hashlib.sha256(file.read_bytes()).hexdigest()) for file in files if file.is_file()]
    return hashlib.sha256(json.dumps([content, read], sort_keys=True).encode()).hexdigest()
