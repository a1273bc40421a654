"""Session of the mesh generator gmsh; no other module imports gmsh."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

from kc2spice.core.errors import MissingToolError

# Signals whose handlers gmsh replaces.
# With the handler that gmsh sets, a broken pipe would end the process silently.
REPLACED_SIGNALS = ("SIGTERM", "SIGHUP", "SIGPIPE")


@contextmanager
def gmsh_session() -> Iterator[ModuleType]:
    """Open a gmsh session with one empty model, and close it after the ``with`` block.

    gmsh has global variables, so sessions cannot be nested. The session prints nothing, runs in one
    thread, and does not read option files of the user: the same input always gives the same mesh.
    The signal handlers of Python remain in effect.

    Raises
    ------
    MissingToolError : the package gmsh, or a system library that gmsh loads, is not installed.
    """
    try:
        import gmsh
    except (ImportError, OSError) as error:
        raise MissingToolError(
            "gmsh cannot be loaded",
            where="mesh generation",
            got=str(error),
            expected="the Python package gmsh and its system libraries",
            hint="run kc2spice doctor, which lists the missing packages",
        ) from error
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    if threading.current_thread() is threading.main_thread():
        for number in (getattr(signal, name, signal.SIGTERM) for name in REPLACED_SIGNALS):
            signal.signal(number, signal.getsignal(number))
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        yield gmsh
    finally:
        gmsh.finalize()
