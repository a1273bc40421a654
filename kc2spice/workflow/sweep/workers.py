"""Calls on the workers of an executor, none of which is lost with the worker that runs it.

Everything here speaks the interface of :mod:`concurrent.futures`: processes of this machine, its
threads, a Dask cluster, or whatever else has an executor.
"""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from itertools import chain, islice, repeat
from typing import Any, TypeVar

from kc2spice.core.errors import MissingToolError

# Opens an executor, and again after it was lost; gives it with the number of its workers.
Workers = Callable[[], AbstractContextManager[tuple[Executor, int]]]
T = TypeVar("T")
Call = tuple[T, Callable[..., Any], tuple[Any, ...]]  # name, function, arguments
PATIENCE = 60.0  # s that a lost scheduler may take to come back
# Losses of workers and schedulers, told by name so that Dask need not be imported.
_LOST = {
    "KilledWorker",
    "FutureCancelledError",
    "FuturesCancelledError",
    "CommClosedError",
    "FutureLostError",
}


WORKER_DIED = object()  # result of a call whose worker died twice


def cores() -> int:
    """Processors that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on Linux
        return os.cpu_count() or 1


def completed(workers: Workers, calls: Iterable[Call[T]]) -> Iterator[tuple[T, Any]]:
    """Results of ``function(*arguments)`` as they come, for each call, with its name.

    No more calls are in flight than keeps all workers busy. Where a worker dies, the workers are
    opened again and every call that was in flight is run once more, alone: only the one that ends
    its worker again is given up; its result is ``WORKER_DIED``. Exceptions of the function itself
    are raised.
    """
    with ExitStack() as opened:

        def reopen() -> tuple[Executor, int]:
            opened.close()
            return opened.enter_context(workers())

        executor, count = reopen()
        calls, pending = iter(calls), dict[Future[Any], Call[T]]()
        while True:
            for call in islice(calls, max(0, 2 * count + 1 - len(pending))):
                pending[_submitted(executor, call)] = call
            if not pending:
                return
            lost: list[Call[T]] = []
            for future in wait(pending, return_when=FIRST_COMPLETED).done:
                call, result = pending.pop(future), _result(future)
                if result is WORKER_DIED:
                    lost.append(call)
                else:
                    yield call[0], result
            if not lost:
                continue
            lost, pending = [*lost, *pending.values()], {}
            executor, count = reopen()
            for call in lost:
                result = _result(_submitted(executor, call))
                if result is WORKER_DIED:
                    executor, count = reopen()
                yield call[0], result


def _submitted(executor: Executor, call: Call[T]) -> Future[Any]:
    try:
        return executor.submit(call[1], *call[2])
    except Exception as error:  # of an executor whose workers are gone
        failed = Future[Any]()
        failed.set_exception(error)
        return failed


def _result(future: Future[Any]) -> Any:
    """What the call returned; ``WORKER_DIED`` where it was lost with its worker."""
    try:
        return future.result()
    except Exception as error:
        kinds = {kind.__name__ for kind in type(error).__mro__}
        if isinstance(error, (BrokenExecutor, CancelledError, OSError)) or _LOST & kinds:
            return WORKER_DIED
        raise


def processes(count: int) -> Workers:
    """So many processes of this machine."""
    from multiprocessing import get_context

    @contextmanager
    def opened() -> Iterator[tuple[Executor, int]]:
        with tempfile.TemporaryDirectory(prefix="kc2spice-sweep-") as scratch:
            pool = ProcessPoolExecutor(count, get_context("spawn"), _worker_starts, (scratch,))
            try:
                yield pool, count
            finally:
                pool.shutdown(wait=True, cancel_futures=True)

    return opened


def _worker_starts(scratch: str) -> None:
    """Leave Ctrl-C to the parent; when that is killed, end with ngspice and leave no files."""
    from multiprocessing import connection, parent_process

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    tempfile.tempdir = scratch
    parent, group = parent_process(), hasattr(os, "setpgrp")
    if group:
        os.setpgrp()

    def watch() -> None:
        if parent is None:
            return
        connection.wait([parent.sentinel])
        if group:  # files go after all who might still write one, hence by another process
            clean = 'kill -9 "-$0"; sleep 0.1; rm -rf -- "$1"'
            words = ["sh", "-c", clean, str(os.getpgrp()), scratch]
            subprocess.Popen(words, start_new_session=True)
        else:
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def dask(address: str, count: int, patience: float = 10.0) -> Workers:
    """The workers of a Dask scheduler, or ``count`` on this machine for the address ``local``.

    A scheduler gets ``patience`` seconds for its first answer, and a minute to come back.
    """
    limits = chain([patience], repeat(PATIENCE))

    @contextmanager
    def opened() -> Iterator[tuple[Executor, int]]:
        try:
            from distributed import Client, LocalCluster
        except ImportError:
            hint = "pip install 'kc2spice[dask]'"
            message = "dask.distributed is not installed"
            raise MissingToolError(message, where="--dask", hint=hint) from None
        # A scheduler that comes back is no reason for the tracebacks that Dask would print.
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        limit = next(limits)
        with ExitStack() as stack:
            try:
                target: Any = address
                if address == "local":
                    target = LocalCluster(
                        n_workers=count, threads_per_worker=1, dashboard_address=None
                    )
                    stack.enter_context(target)
                client = Client(target, timeout=limit)
                stack.callback(_disconnect, client)
                client.wait_for_workers(1, timeout=limit)
            except (OSError, TimeoutError, ValueError) as error:
                raise MissingToolError(
                    "no Dask scheduler with workers answers",
                    where="--dask",
                    got=address,
                    expected="an address such as tcp://host:8786, or local",
                    hint=f"{type(error).__name__}: {error}".splitlines()[0][:200],
                ) from None
            yield client.get_executor(pure=False, retries=0), sum(client.nthreads().values())

    return opened


def _disconnect(client: Any) -> None:
    with suppress(Exception):  # the scheduler may be gone already
        client.close(timeout=5)
