"""A Dask cluster as one more pool for :func:`insemu.work.run_items`: one that stands somewhere, or processes of this machine."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import ExitStack, contextmanager
from threading import Lock
from typing import Any

from insemu.errors import InputError

#: Callables whose inputs stay on the cluster.
KEPT = 16
#: Workers that may be lost under one item before it is taken for the cause.
LOST = 20
#: Settings of Dask for the processes of ``local``. By its own ones every array above 128 KiB goes back to the system as it is freed and is asked for
#: again: thousands of page faults in a realization. Profiles, ticks and the use of disks, which nobody reads here, take time of every process.
#: The memory manager takes the inputs off a worker that waits for its next item, which then goes to another: two workers got three items and one.
LOCAL: dict[str, Any] = {
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
    "distributed.scheduler.active-memory-manager.start": False,
    "distributed.worker.profile.enabled": False,
    "distributed.worker.memory.monitor-interval": "1s",
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.tick.cycle": "10s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.admin.system-monitor.disk": False,
}


@contextmanager
def cluster(address: str, workers: int) -> Iterator[Executor | None]:
    """A pool on a cluster; None where none is asked for.

    Parameters
    ----------
    address : str
        ``tcp://HOST:PORT`` of a scheduler, ``local`` for processes of this machine that only this machine can reach, or empty.
    workers : int
        Processes of ``local``.

    Raises
    ------
    InputError
        ``distributed`` is not installed, another address, or nobody answers there.
    """
    if not address:
        yield None
        return
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError:
        raise InputError(
            "the package 'distributed' is not installed; expected insemu with its extra 'cluster'", where="--cluster"
        ) from None
    if address != "local" and not address.startswith(("tcp://", "tls://")):
        raise InputError(f"found '{address}', expected local or tcp://HOST:PORT", where="--cluster")
    with ExitStack() as stack:
        stack.enter_context(dask.config.set({"distributed.scheduler.allowed-failures": LOST}))
        if address == "local":
            stack.enter_context(dask.config.set(LOCAL))
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "Port .* is already in use", UserWarning)  # it takes another one
                started = LocalCluster(
                    n_workers=workers, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, silence_logs=50
                )
            engine: Any = stack.enter_context(started)
        else:
            engine = address
        try:
            client = stack.enter_context(Client(engine, timeout=20, set_as_default=False))
        except OSError as error:
            raise InputError(f"no scheduler answers at {address} ({error})", where="--cluster") from None
        yield ClusterPool(client)


class ClusterPool(Executor):
    """The items of a cluster: what they share (the callable with all that it holds) is shipped to a worker once and made again where it is lost.

    Parameters
    ----------
    client : distributed.Client
    """

    def __init__(self, client: Any) -> None:
        self._client = client
        self._shipped: list[tuple[Callable[..., Any], Any]] = []
        self._lock = Lock()

    @property
    def width(self) -> int:
        """Items that can be worked on at a time."""
        return max(1, sum(int(n) for n in self._client.nthreads().values()))

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Let a worker call ``fn``; a worker that is lost is replaced by another."""
        with self._lock:
            running = self._client.submit(_called, self._there(fn), args, kwargs, pure=False)
        out: Future[Any] = Future()
        out.set_running_or_notify_cancel()

        def settle(finished: Any) -> None:
            try:
                out.set_result(finished.result())
            except BaseException as error:  # a lost cluster raises CancelledError, which is no Exception
                lost = type(error).__name__ in ("CancelledError", "KilledWorker", "FutureCancelledError")
                said = f"workers or scheduler were lost ({error}); what was finished is kept, the same command goes on from there"
                out.set_exception(InputError(said, where="--cluster") if lost else error)
            finished.release()

        running.add_done_callback(settle)
        return out

    def _there(self, fn: Callable[..., Any]) -> Any:
        """The callable on the cluster, under the digest of its content."""
        from distributed.protocol.pickle import dumps

        for known, shipped in self._shipped:
            if known == fn:
                return shipped
        content = dumps(fn)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of a large graph: it is large once
            shipped = self._client.submit(_unpacked, content, key=f"inputs-{hashlib.sha256(content).hexdigest()}")
        self._shipped = [*self._shipped[-KEPT:], (fn, shipped)]
        return shipped


def _unpacked(content: bytes) -> Any:
    from distributed.protocol.pickle import loads

    return loads(content)


def _called(fn: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    return fn(*args, **kwargs)
