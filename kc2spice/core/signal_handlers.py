"""Signal handlers that end the program even during a long numerical call.

Python handles a signal between two bytecode instructions, but the factorisation of a large matrix
is one instruction that takes minutes. Therefore a separate thread waits for each signal. This
thread ends the process and its children if the main thread does not begin to handle the signal.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType

GRACE_PERIOD = 0.5  # s, time within which the main thread must begin to handle a signal
END_SIGNALS = ("SIGTERM", "SIGHUP")
INTERRUPT_MESSAGE = b"kc2spice: interrupted; nothing was written\n"


@contextlib.contextmanager
def end_on_signals(grace: float = GRACE_PERIOD) -> Iterator[None]:
    """Convert signals such as Ctrl-C to exceptions, so that the program cleans up.

    Ctrl-C raises KeyboardInterrupt; SIGTERM and SIGHUP raise SystemExit. If the main thread does
    not begin to handle a signal within ``grace`` [s], the process ends. The exit code is 128 +
    number of the signal in all cases. Signal handlers that the caller has set are not replaced.

    A KeyboardInterrupt that leaves the block ends the program with the exit code 130. After the
    ``with`` block, the handled signals are ignored. Otherwise, a late signal could kill a program
    that has already written all results, and change the exit code of the program.
    """
    try:
        signals = _handle_signals(grace)
        try:
            yield
        finally:
            for number in signals:
                signal.signal(number, signal.SIG_IGN)
    except KeyboardInterrupt:
        with contextlib.suppress(OSError):
            os.write(2, INTERRUPT_MESSAGE)
        raise SystemExit(128 + signal.SIGINT) from None


def _handle_signals(grace: float) -> set[int]:
    """Set signal handlers, start the watching thread, and return the handled signals."""
    handled = threading.Semaphore(0)

    def raise_interrupt(number: int, frame: FrameType | None) -> None:
        """Notify the watching thread of the signal, and raise KeyboardInterrupt."""
        handled.release()
        raise KeyboardInterrupt

    def exit_on_signal(number: int, frame: FrameType | None) -> None:
        """Ignore further signals of this kind and raise SystemExit."""
        handled.release()
        signal.signal(number, signal.SIG_IGN)  # a second signal must not interrupt the clean-up
        raise SystemExit(128 + number)

    signals = set[int]()
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, raise_interrupt)
        signals.add(int(signal.SIGINT))
    for number in (getattr(signal, name, None) for name in END_SIGNALS):
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, exit_on_signal)
            signals.add(int(number))
    if not signals:
        return signals
    inlet, outlet = os.pipe()
    os.set_blocking(outlet, False)
    signal.set_wakeup_fd(outlet, warn_on_full_buffer=False)
    threading.Thread(
        target=_watch_signals, args=(inlet, signals, handled, grace), daemon=True
    ).start()
    return signals


def _watch_signals(
    inlet: int, signals: set[int], handled: threading.Semaphore, grace: float
) -> None:
    """End the process if the main thread has not handled a signal after ``grace`` [s]."""
    while arrived := os.read(inlet, 1):
        if arrived[0] in signals and not handled.acquire(timeout=grace):
            # multiprocessing is used only if already imported, because its import takes 7 ms
            processes = sys.modules.get("multiprocessing")
            for child in processes.active_children() if processes else ():
                child.kill()
            with contextlib.suppress(OSError):
                os.write(2, INTERRUPT_MESSAGE)
            os._exit(128 + arrived[0])
