"""Pools of workers behind the interface of ``concurrent.futures``, and how they lose no point."""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
import signal
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, Protocol

from kc2spice.core.errors import MissingToolError

PATIENCE = 60.0  # s that a lost scheduler may take to come back


def cores() -> int:
    """Processors that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on Linux
        return os.cpu_count() or 1


class Engine(Protocol):
    """A pool that can be opened again after it was lost."""

    @property
    def workers(self) -> int:
        """Points that run at a time."""

    def open(self) -> Executor:
        """A new pool; MissingToolError where there is none to be had."""

    def close(self) -> None:
        """Let the workers finish what they run, start nothing else, end them."""


@dataclass
class ThreadEngine:
    """Threads of this process: most of a point's time is spent in ngspice, another one."""

    workers: int
    _pool: ThreadPoolExecutor | None = field(default=None, init=False)

    def open(self) -> Executor:
        """New threads."""
        self.close()
        self._pool = ThreadPoolExecutor(self.workers)
        return self._pool

    def close(self) -> None:
        """End the threads after the points that they run."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None


@dataclass
class LocalEngine:
    """Processes of this machine, one thread each."""

    workers: int
    _pool: ProcessPoolExecutor | None = field(default=None, init=False)
    _scratch: tempfile.TemporaryDirectory[str] | None = field(default=None, init=False)

    def open(self) -> Executor:
        """Start the processes anew."""
        from multiprocessing import get_context

        self.close()
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
            os.environ.setdefault(name, "1")
        self._scratch = tempfile.TemporaryDirectory(prefix="kc2spice-sweep-")
        self._pool = ProcessPoolExecutor(
            self.workers, get_context("spawn"), _worker_starts, (self._scratch.name,)
        )
        return self._pool

    def close(self) -> None:
        """End the processes after the points that they run."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None
        if self._scratch is not None:
            self._scratch.cleanup()
            self._scratch = None


def _worker_starts(scratch: str) -> None:
    """Leave Ctrl-C to the parent; when that is killed, end with ngspice and leave no files."""
    from multiprocessing import connection, parent_process

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    tempfile.tempdir = scratch
    parent, group = parent_process(), hasattr(os, "setpgrp")
    if group:
        os.setpgrp()

    def watch() -> None:
        if parent is not None:
            connection.wait([parent.sentinel])
            if group:  # files go after all who might still write one, hence by another process
                clean = 'kill -9 "-$0"; sleep 0.1; rm -rf -- "$1"'
                words = ["sh", "-c", clean, str(os.getpgrp()), scratch]
                subprocess.Popen(words, start_new_session=True)
            else:
                shutil.rmtree(scratch, ignore_errors=True)
                os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@dataclass
class DaskEngine:
    """Workers of a Dask scheduler, or of a cluster on this machine for the address ``local``."""

    address: str
    local_workers: int
    patience: float = 10.0  # s for the first answer
    workers: int = field(default=1, init=False)
    _client: Any = field(default=None, init=False)
    _cluster: Any = field(default=None, init=False)

    def open(self) -> Executor:
        """Connect; a scheduler that went away gets a minute to come back.

        Raises
        ------
        MissingToolError : dask.distributed is not installed, or nobody answers at the address.
        """
        try:
            from distributed import Client, LocalCluster
        except ImportError:
            raise MissingToolError(
                "dask.distributed is not installed", where="--dask",
                hint="pip install 'kc2spice[dask]'",
            ) from None  # fmt: skip
        # A scheduler that comes back is no reason for the tracebacks that Dask would print.
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        patience = PATIENCE if self._client is not None else self.patience
        self.close()
        try:
            if self.address == "local":
                self._cluster = LocalCluster(
                    n_workers=self.local_workers, threads_per_worker=1, dashboard_address=None
                )
            self._client = Client(self._cluster or self.address, timeout=patience)
            self._client.wait_for_workers(1, timeout=patience)
        except (OSError, TimeoutError, ValueError) as error:
            self.close()
            raise MissingToolError(
                "no Dask scheduler with workers answers", where="--dask", got=self.address,
                expected="an address such as tcp://host:8786, or local",
                hint=f"{type(error).__name__}: {error}".splitlines()[0][:200],
            ) from None  # fmt: skip
        self.workers = sum(self._client.nthreads().values())
        return self._client.get_executor(pure=False, retries=0)

    def close(self) -> None:
        """Disconnect; end the cluster if it is ours."""
        for item in (self._client, self._cluster):
            if item is not None:
                with contextlib.suppress(Exception):  # it may be gone already
                    item.close(timeout=5)
        self._cluster = None


@dataclass(frozen=True)
class Call:
    """A function to run in a worker; ``name`` identifies it to whoever asked."""

    name: Any
    function: Callable[..., Any]
    arguments: tuple[Any, ...]


class WorkerDied:
    """Result of a call whose worker process died twice."""


class WorkerPool:
    """The workers of an engine, for any number of calls; leave it as a context.

    Where a worker dies, its pool is opened again and every call that was in flight is run once
    more, alone: only the one that ends its worker again is given up; its result is ``WorkerDied``.
    Exceptions of the functions themselves are raised.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._executor = engine.open()

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, *_: object) -> None:
        self._engine.close()

    def run(self, calls: Iterator[Call]) -> Iterator[tuple[Call, Any]]:
        """Results of ``calls`` as they come, with no more in flight than keeps all workers busy."""
        pending: dict[Future[Any], Call] = {}
        while True:
            suspects: list[Call] = []
            for call in islice(calls, max(0, 2 * self._engine.workers + 1 - len(pending))):
                if not self._submit(call, pending):
                    suspects.append(call)
                    break
            if not pending and not suspects:
                return
            done, _ = wait(pending, return_when=FIRST_COMPLETED) if not suspects else (set(), None)
            for future in done:
                call = pending.pop(future)
                try:
                    result = future.result()
                except Exception as error:
                    if not _is_loss(error):
                        raise
                    suspects.append(call)
                else:
                    yield call, result
            if suspects:
                suspects += pending.values()
                pending.clear()
                self._executor = self._engine.open()
                for call in suspects:
                    yield call, self._alone(call)

    def _submit(self, call: Call, pending: dict[Future[Any], Call]) -> bool:
        try:
            pending[self._executor.submit(call.function, *call.arguments)] = call
        except Exception as error:
            if not _is_loss(error):
                raise
            return False
        return True

    def _alone(self, call: Call) -> Any:
        try:
            return self._executor.submit(call.function, *call.arguments).result()
        except Exception as error:
            if not _is_loss(error):
                raise
            self._executor = self._engine.open()
            return WorkerDied()


def _is_loss(error: BaseException) -> bool:
    """Whether a worker, a pool or a scheduler went away, told without importing Dask."""
    if isinstance(error, (BrokenExecutor, CancelledError, OSError)):
        return True
    names = {kind.__name__ for kind in type(error).__mro__}
    return bool(names & {"KilledWorker", "FutureCancelledError", "FuturesCancelledError",
                         "CommClosedError", "FutureLostError"})  # fmt: skip
