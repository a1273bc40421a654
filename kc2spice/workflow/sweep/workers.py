"""Processes of this machine or of a Dask scheduler that run the points of a sweep."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, ProcessPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from itertools import chain, repeat
from pathlib import Path
from typing import Any

from kc2spice.core.errors import MissingToolError
from kc2spice.core.extras import import_optional

# Function that opens an executor, also after the loss of an earlier executor, and yields it with
# the number of workers.
Workers = Callable[[], AbstractContextManager[tuple[Executor, int]]]
RECONNECT_TIME = 60.0  # s, time limit for a lost scheduler to reconnect
# Names of exceptions for lost workers and schedulers, so that Dask need not be imported.
_LOST_EXCEPTIONS = {
    "KilledWorker",
    "FutureCancelledError",
    "FuturesCancelledError",
    "CommClosedError",
    "FutureLostError",
}


_GROUP_SUFFIX = ".group"  # suffix of a file named after the process group of a worker


def available_cores() -> int:
    """Return the number of processors that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on Linux
        return os.cpu_count() or 1


def is_lost_worker(error: BaseException) -> bool:
    """Return whether a call failed because its worker or scheduler was lost."""
    kinds = {kind.__name__ for kind in type(error).__mro__}
    return isinstance(error, (BrokenExecutor, CancelledError, OSError)) or bool(
        _LOST_EXCEPTIONS & kinds
    )


def local_workers(count: int) -> Workers:
    """Return the workers: ``count`` processes of this machine."""
    from multiprocessing import get_context

    @contextmanager
    def open_executor() -> Iterator[tuple[Executor, int]]:
        with tempfile.TemporaryDirectory(
            prefix="kc2spice-sweep-", ignore_cleanup_errors=True
        ) as scratch:
            pool = ProcessPoolExecutor(count, get_context("spawn"), _initialise_worker, (scratch,))
            try:
                yield pool, count
            finally:
                pool.shutdown(wait=True, cancel_futures=True)
                _end_orphaned_simulators(Path(scratch))

    return open_executor


def _end_orphaned_simulators(scratch: Path) -> None:
    """Kill ngspice processes of killed workers, which would still write to ``scratch``."""
    for mark in scratch.glob("*" + _GROUP_SUFFIX):
        with suppress(ProcessLookupError, PermissionError):  # the process group has already ended
            os.killpg(int(mark.stem), signal.SIGKILL)


def _initialise_worker(scratch: str) -> None:
    """Ignore Ctrl-C; if the parent is killed, end ngspice and delete files."""
    from multiprocessing import connection, parent_process

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    tempfile.tempdir = scratch
    parent, group = parent_process(), hasattr(os, "setpgrp")
    if group:
        os.setpgrp()
        Path(scratch, f"{os.getpid()}{_GROUP_SUFFIX}").touch()

    def watch_parent() -> None:
        """Wait for the end of the parent, then end this worker."""
        if parent is None:
            return
        connection.wait([parent.sentinel])
        # another process deletes the files after all processes that might write them have ended
        if group:
            clean = 'kill -9 "-$0"; sleep 0.1; rm -rf -- "$1"'
            words = ["sh", "-c", clean, str(os.getpgrp()), scratch]
            subprocess.Popen(words, start_new_session=True)
        else:
            os._exit(1)

    threading.Thread(target=watch_parent, daemon=True).start()


def dask_workers(address: str, count: int, patience: float = 10.0) -> Workers:
    """Return the workers of a Dask scheduler, or ``count`` on this machine for ``local``.

    A scheduler must answer first within ``patience`` seconds, and after a connection loss within a
    minute.
    """
    limits = chain([patience], repeat(RECONNECT_TIME))

    @contextmanager
    def open_executor() -> Iterator[tuple[Executor, int]]:
        distributed = import_optional("distributed", "--dask")
        # Dask would print tracebacks although the scheduler reconnects
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        limit, target = next(limits), address
        with ExitStack() as stack:
            try:
                if address == "local":
                    options = {"threads_per_worker": 1, "dashboard_address": None}
                    target = stack.enter_context(
                        distributed.LocalCluster(n_workers=count, **options)
                    )
                client = distributed.Client(target, timeout=limit)
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

    return open_executor


def _disconnect(client: Any) -> None:
    with suppress(Exception):  # the scheduler may have ended already
        client.close(timeout=5)
