"""A process that draws beside the simulator.

Loading matplotlib takes longer than most simulations, and drawing as long again. Both wait for
nothing but the waveforms, so they have a process of their own, started before anything else: this
module loads neither numpy nor what computes.
"""

from __future__ import annotations

import multiprocessing as mp
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from importlib.util import find_spec
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from kc2spice.core.errors import MissingToolError, SimulationError
from kc2spice.report.plots import load

T = TypeVar("T")

# A fork has all modules already and does not run the script again that uses this package.
_START = "fork" if "fork" in mp.get_all_start_methods() else None


class PlotWorker:
    """Draws in a process of its own, one thing after the other; leave it as a context."""

    def __enter__(self) -> PlotWorker:
        require_matplotlib()
        context: Any = mp.get_context(_START)  # which has no type for its processes
        self._ours, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(self._ours, theirs), daemon=True)
        self._process.start()
        theirs.close()
        self._thread = ThreadPoolExecutor(1)
        return self

    def draw(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Ask for ``function(*arguments)``; the future has what it returns or raises."""
        return self._thread.submit(self._carry, function, arguments)

    def _carry(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        try:
            self._ours.send((function, arguments))
            good, answer = self._ours.recv()
        except (EOFError, OSError):
            raise SimulationError(
                "the process that draws ended before its pictures were done",
                hint="was it killed, or is memory short?",
            ) from None
        if not good:
            raise answer
        return answer

    def __exit__(self, *_: object) -> None:
        self._process.kill()  # idle, or nobody wants what it draws any more
        self._thread.shutdown()
        self._process.join()
        self._ours.close()


def share(function: Callable[..., list[T]], directory: Path, items: Sequence[Any]) -> list[T]:
    """``function(directory, items)``, every second item in a fork of this process where it can.

    For the process of a :class:`PlotWorker`, which has no threads that a fork would break.
    """
    if _START != "fork" or len(items) < 2 or (os.cpu_count() or 1) < 2:
        return function(directory, items)
    ours, theirs = mp.Pipe(duplex=False)
    child = os.fork()
    if child == 0:
        try:
            theirs.send(_answer(function, (directory, items[1::2])))
        finally:  # an answer that cannot be sent must not send this process up the caller's stack
            os._exit(0)
    theirs.close()
    try:
        mine = function(directory, items[::2])
        good, rest = ours.recv()
    finally:
        ours.close()
        os.waitpid(child, 0)
    if not good:
        raise rest
    found: list[T] = [*mine, *rest]
    found[::2], found[1::2] = mine, rest
    return found


def require_matplotlib() -> None:
    """Before anything is computed.

    Raises
    ------
    MissingToolError : matplotlib is not installed.
    """
    if find_spec("matplotlib") is None:
        raise MissingToolError(
            "matplotlib is not installed", where="Python", expected="matplotlib, for the plots",
            hint="pip install matplotlib; kc2spice doctor lists what is missing",
        )  # fmt: skip


def _serve(parents: Connection, own: Connection) -> None:
    """Draw what is asked for until the other end is closed, be it by a kill."""
    parents.close()  # only the parent holds its end now
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever asked decides when to stop
    os.environ["MPLBACKEND"] = "agg"  # a notebook's, inherited, may not be here at all
    load()  # while there is nothing to draw
    while True:
        try:
            function, arguments = own.recv()
        except (EOFError, OSError):
            return
        answer = _answer(function, arguments)
        try:
            own.send(answer)
        except OSError:  # killed meanwhile: nobody is left to tell
            return


def _answer(function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[bool, Any]:
    """Whether it went well, and what it returned or raised."""
    try:
        return True, function(*arguments)
    except Exception as error:
        return False, error
