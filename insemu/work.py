"""Independent work items, on one core, on threads, processes or a cluster: finished ones are kept, so an interrupted run goes on where it stopped."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import platform
import signal
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from functools import partial
from multiprocessing import active_children, parent_process
from multiprocessing.connection import wait as wait_for
from pathlib import Path
from threading import Thread
from typing import Any, BinaryIO, Generic, ParamSpec, Protocol, TypeVar
from zipfile import BadZipFile

import portalocker

from insemu.errors import InputError

T = TypeVar("T")
R = TypeVar("R")
P = ParamSpec("P")


class Store(Protocol[R]):
    """Where finished items are kept."""

    def get(self, key: str) -> R | None:
        """Return a finished item, or None."""

    def put(self, key: str, result: R) -> None:
        """Keep a finished item."""


def stream_items(
    items: Mapping[str, T],
    work: Callable[[T], R],
    *,
    pool: Executor | None = None,
    store: Store[R] | None = None,
    done: Callable[[R], None] | None = None,
    window: int = 64,
) -> Iterator[tuple[str, R]]:
    """Work on every item that is not finished yet, and yield all of them in the order of ``items``, whoever finishes first.

    Parameters
    ----------
    items : mapping of str to item
        The key says everything that the result depends on, or the store belongs to the rest of it.
    work : callable
        Item to result; with a pool of processes, a function of a module.
    pool : Executor, optional
        Any of ``concurrent.futures``; none: here, one after the other.
    store : Store, optional
        Where finished items are looked for and kept.
    done : callable, optional
        Told of every result as it is finished, or found.
    window : int
        Items that are under way or wait for their turn: what bounds the memory.
    """
    coming = iter(items.items())
    order: deque[str] = deque()
    ready: dict[str, R] = {}
    futures: dict[Future[R], str] = {}

    def finish(key: str, result: R, *, keep: bool = True) -> None:
        ready[key] = result
        if store is not None and keep:
            store.put(key, result)
        if done is not None:
            done(result)

    try:
        while True:
            while len(order) < (window if pool is not None else 1) and (entry := next(coming, None)) is not None:
                key, item = entry
                order.append(key)
                if store is not None and (kept := store.get(key)) is not None:
                    finish(key, kept, keep=False)
                elif pool is not None:
                    futures[pool.submit(work, item)] = key
                else:
                    finish(key, work(item))
            if not order:
                return
            while order[0] not in ready:
                for future in wait(futures, return_when=FIRST_COMPLETED).done:
                    finish(futures.pop(future), future.result())
            yield order[0], ready.pop(order.popleft())
    finally:
        for future in futures:
            future.cancel()


def run_items(
    items: Mapping[str, T],
    work: Callable[[T], R],
    *,
    pool: Executor | None = None,
    store: Store[R] | None = None,
    done: Callable[[R], None] | None = None,
) -> dict[str, R]:
    """All results of :func:`stream_items` at once, in the order of ``items``.

    Parameters
    ----------
    items : mapping of str to item
    work : callable
    pool : Executor, optional
    store : Store, optional
    done : callable, optional
    """
    return dict(stream_items(items, work, pool=pool, store=store, done=done, window=max(1, len(items))))


def meanwhile(pool: Executor | None, work: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> Callable[[], R]:
    """Begin work together with this process, and return what waits for its result; without a pool it is done here once that is asked for.

    Parameters
    ----------
    pool : Executor or None
    work : callable
        With a pool of processes, a function of a module.
    *args, **kwargs
        Its arguments; with a pool, as they are now.
    """
    if pool is None:
        return partial(work, *args, **kwargs)
    # a pool packs them up while its caller goes on, and may change them
    return pool.submit(_unpacked, pickle.dumps((work, args, kwargs))).result


def _unpacked(call: bytes) -> Any:
    """What a call of :func:`meanwhile` returns, in the process that it was handed to."""
    work, args, kwargs = pickle.loads(call)
    return work(*args, **kwargs)


@contextmanager
def processes(workers: int) -> Iterator[Executor | None]:
    """Processes to work on items; none where one is enough.

    Ctrl-C ends them at once, for what they are at is lost in any case, and so does the end of the first process, however it comes.
    """
    if workers <= 1:
        yield None
        return
    others = set(active_children())
    with ProcessPoolExecutor(workers, initializer=_begin) as pool:
        try:
            yield pool
        except KeyboardInterrupt:
            for child in set(active_children()) - others:
                child.terminate()
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _begin() -> None:
    """Ctrl-C reaches every process of a terminal; only the first one answers it. A process whose parent was killed ends with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    # Without this it would wait for ever to hand on its result, and hold every file and lock that it was started with.
    parent = parent_process()
    if parent is not None:
        wait_for([parent.sentinel])
        os._exit(1)


class Lines(Generic[R]):
    """Finished items in one file, a line of JSON each; a line that was cut off while it was written is done again.

    Parameters
    ----------
    path : path
    encode, decode : callable
        Result to plain data and back.
    what : str
        What a line holds, for the message about a file that is something else.

    Raises
    ------
    InputError
        A line that is none of these; where an item is added, a file that another process adds to.
    """

    def __init__(
        self, path: Path, encode: Callable[[R], dict[str, Any]], decode: Callable[[dict[str, Any]], R], what: str
    ) -> None:
        self._path, self._encode = path, encode
        self._kept: dict[str, R] = {}
        self._file: BinaryIO | None = None  # once something is added
        text = path.read_bytes() if path.exists() else b""
        self._size = len(text)
        lines = text.split(b"\n")
        for number, line in enumerate(lines[:-1], start=1):
            try:
                plain = json.loads(line)
                self._kept[plain["job"]] = decode(plain)
            except (ValueError, KeyError, TypeError):
                raise InputError(f"expected a line of JSON of {what}", where=f"{path}:{number}") from None
        self._whole = len(text) - len(lines[-1])

    def get(self, key: str) -> R | None:
        """Return a finished item, or None."""
        return self._kept.get(key)

    def put(self, key: str, result: R) -> None:
        """Add a line."""
        if self._file is None:
            self._file = self._held()
        self._file.write(json.dumps({"job": key, **self._encode(result)}).encode() + b"\n")

    def __del__(self) -> None:
        """Let go of the file."""
        if (file := getattr(self, "_file", None)) is not None:
            file.close()

    def _held(self) -> BinaryIO:
        """The file, open and held as long as this object lives: two processes at the same items would each add them."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        file = self._path.open("ab", buffering=0)
        taken = False
        try:
            portalocker.lock(file, portalocker.LOCK_EX | portalocker.LOCK_NB)
        except portalocker.AlreadyLocked:
            taken = True
        except portalocker.LockException:  # a file system that cannot lock
            pass
        if taken or os.fstat(file.fileno()).st_size != self._size:
            file.close()
            raise InputError(
                "another process adds to this file; wait for it, or choose another file", where=str(self._path)
            )
        file.truncate(self._whole)
        return file


class Files(Generic[R]):
    """Finished items in a file each, with the identity of what they belong to and a checksum; what does not match is said and done again.

    Parameters
    ----------
    folder : path
    identity : str
        Of the whole work, for example an experiment's digest: an item of other work is never taken for one of this.
    encode, decode : callable
        Result to bytes and back; ``decode`` raises ``ValueError``, ``KeyError``, ``EOFError`` or ``BadZipFile`` where it cannot.
    say : callable
        Told in words of every file that is not taken.
    """

    def __init__(
        self,
        folder: Path,
        identity: str,
        encode: Callable[[R], bytes],
        decode: Callable[[bytes], R],
        say: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._folder, self._identity, self._encode, self._decode, self._say = folder, identity, encode, decode, say

    def get(self, key: str) -> R | None:
        """Return a finished item, or None."""
        path = self._folder / key
        try:
            head, _, content = path.read_bytes().partition(b"\n")
            if head != self._head(key, content):
                raise ValueError("another item's, cut off or changed")
            return self._decode(content)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, EOFError, KeyError, BadZipFile) as error:
            self._say(f"{path} is damaged ({error}); it is made again")
            return None

    def __contains__(self, key: str) -> bool:
        return (self._folder / key).is_file()

    def drop(self, key: str) -> None:
        """Forget an item, if it is there."""
        (self._folder / key).unlink(missing_ok=True)

    def put(self, key: str, result: R) -> None:
        """Write a file; a reader sees a whole one or none."""
        content = self._encode(result)
        self._folder.mkdir(parents=True, exist_ok=True)
        partial = (
            self._folder / f"{key}.partial-{platform.node()}-{os.getpid()}"
        )  # of this process, on whatever machine
        with partial.open("wb") as handle:
            handle.write(self._head(key, content) + b"\n")
            handle.write(content)
        if (self._folder / key).is_dir():  # whatever it is, it is no item
            (self._folder / key).rename(self._folder / f"{key}.not-an-item-{os.getpid()}")
        partial.replace(self._folder / key)

    def _head(self, key: str, content: bytes) -> bytes:
        said = {"item": key, "of": self._identity, "sha256": hashlib.sha256(content).hexdigest()}
        return json.dumps(said).encode()
