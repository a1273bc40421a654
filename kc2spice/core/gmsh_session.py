"""Session of the mesh generator gmsh without output or threads; no other module imports gmsh."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

from kc2spice.core.errors import MissingToolError

# Signals whose handlers gmsh replaces. A broken pipe would then end the process silently.
REPLACED_SIGNALS = ("SIGTERM", "SIGHUP", "SIGPIPE")


@contextmanager
def gmsh_session() -> Iterator[ModuleType]:
    """Initialise gmsh with one empty model, yield the module, and finalise it.

    gmsh keeps global state, so sessions do not nest. The session neither reads the option files of
    the user nor replaces the signal handlers, so the same input always gives the same mesh.

    Raises
    ------
    MissingToolError : the wheel or a system library that it loads is not installed.
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
