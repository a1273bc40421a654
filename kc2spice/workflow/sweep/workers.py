"""Worker processes for the points of a sweep, local or of a Dask scheduler."""

from __future__ import annotations

import logging
import os
import re
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
from kc2spice.core.optional_libraries import import_optional

# Function that returns a context manager; the function is called again if an executor is lost.
# The context manager opens an executor, and yields the executor and the number of workers.
Workers = Callable[[], AbstractContextManager[tuple[Executor, int]]]
RECONNECT_TIME = 60.0  # time limit [s] for the reconnection to a lost scheduler
# Exceptions about lost workers are identified by name, so that Dask need not be imported.
_LOST_EXCEPTIONS = {
    "KilledWorker",
    "FutureCancelledError",
    "FuturesCancelledError",
    "CommClosedError",
    "FutureLostError",
}


_GROUP_SUFFIX = ".group"  # suffix of a file named after the process group of a worker


def count_available_cores() -> int:
    """Return the number of processors that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # only Linux has sched_getaffinity
        return os.cpu_count() or 1


def is_lost_worker(error: BaseException) -> bool:
    """Return whether a call failed because its worker or scheduler was lost."""
    kinds = {kind.__name__ for kind in type(error).__mro__}
    return isinstance(error, (BrokenExecutor, CancelledError, OSError)) or bool(
        _LOST_EXCEPTIONS & kinds
    )


def make_local_pool_opener(count: int) -> Workers:
    """Return a function that opens a pool of worker processes on this machine.

    The pool has ``count`` processes.
    """
    from multiprocessing import get_context

    @contextmanager
    def open_executor() -> Iterator[tuple[Executor, int]]:
        """Start a pool of ``count`` local worker processes, and yield the pool."""
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
    """Kill ngspice processes whose worker processes were killed.

    Orphaned ngspice processes would still write to ``scratch``.
    """
    for mark in scratch.glob("*" + _GROUP_SUFFIX):
        with suppress(ProcessLookupError, PermissionError):  # the process group has already ended
            os.killpg(int(mark.stem), signal.SIGKILL)


def _initialise_worker(scratch: str) -> None:
    """Initialise a worker: ignore Ctrl-C, and end if the parent process is killed.

    The worker's ngspice process ends together with the worker.
    """
    from multiprocessing import connection, parent_process

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    tempfile.tempdir = scratch
    parent, group = parent_process(), hasattr(os, "setpgrp")
    if group:
        os.setpgrp()
        Path(scratch, f"{os.getpid()}{_GROUP_SUFFIX}").touch()

    def watch_parent() -> None:
        """Wait for the end of the parent process, then end this worker."""
        if parent is None:
            return
        connection.wait([parent.sentinel])
        # Another process deletes the files after the end of all processes that might write files.
        if group:
            clean = 'kill -9 "-$0"; sleep 0.1; rm -rf -- "$1"'
            words = ["sh", "-c", clean, str(os.getpgrp()), scratch]
            subprocess.Popen(words, start_new_session=True)
        else:
            os._exit(1)

    threading.Thread(target=watch_parent, daemon=True).start()


def make_dask_connector(address: str, count: int, patience: float = 10.0) -> Workers:
    """Return a function that connects to the workers of a Dask scheduler.

    For the address ``local``, the function starts ``count`` workers on this machine. The scheduler
    must answer the first call within ``patience`` seconds, and later calls within a minute.
    """
    limits = chain([patience], repeat(RECONNECT_TIME))

    @contextmanager
    def open_executor() -> Iterator[tuple[Executor, int]]:
        """Connect to the Dask scheduler, and yield an executor and its worker count."""
        distributed = import_optional("distributed", "--dask")
        # Dask would print tracebacks even if it can reconnect to the scheduler.
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
                    "no Dask scheduler with workers replies at this address",
                    where="--dask",
                    got=f"{address}: {error}".splitlines()[0][:200],
                    expected="the address of a running scheduler, such as tcp://host:8786",
                    hint=f"write --dask tcp://{address}:8786"
                    if re.fullmatch(r"[\w.-]+", address)
                    else "start a scheduler and a worker, or write --dask local",
                ) from None
            yield client.get_executor(pure=False, retries=0), sum(client.nthreads().values())

    return open_executor


def _disconnect(client: Any) -> None:
    """Close the connection to the scheduler, which may have ended already."""
    with suppress(Exception):  # the scheduler may have ended already
        client.close(timeout=5)
