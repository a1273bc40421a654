"""Where points of a sweep run: processes of this machine, or a Dask scheduler's workers.

Both are an :class:`concurrent.futures.Executor`, and whatever else has that interface will do.
"""

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
from typing import Any

from kc2spice.core.errors import MissingToolError, needed

# Opens an executor, and again after it was lost; gives it with the number of its workers.
Workers = Callable[[], AbstractContextManager[tuple[Executor, int]]]
PATIENCE = 60.0  # s that a lost scheduler may take to come back
# Losses of workers and schedulers, told by name so that Dask need not be imported.
_LOST = {
    "KilledWorker",
    "FutureCancelledError",
    "FuturesCancelledError",
    "CommClosedError",
    "FutureLostError",
}


def cores() -> int:
    """Processors that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on Linux
        return os.cpu_count() or 1


def is_lost(error: BaseException) -> bool:
    """Whether a call failed with its worker or scheduler, not by itself."""
    kinds = {kind.__name__ for kind in type(error).__mro__}
    return isinstance(error, (BrokenExecutor, CancelledError, OSError)) or bool(_LOST & kinds)


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
        distributed = needed("distributed", "dask.distributed", "--dask", "dask")
        # A scheduler that comes back is no reason for the tracebacks that Dask would print.
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

    return opened


def _disconnect(client: Any) -> None:
    with suppress(Exception):  # the scheduler may be gone already
        client.close(timeout=5)
