"""Work on files of others in a process of its own, where all that they can cause is an error.

Parsers written in C crash, fill the memory or act on what they read. Here they get a folder of
their own, no output, no programs to start and a limit of memory. They hand back arrays; whatever
else becomes of them is an error of the process that asked.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from kc2spice.core import errors
from kc2spice.core.errors import Kc2spiceError
from kc2spice.core.foreign import read_archive

ANSWER, REASON = "answer.npz", "reason.json"
LARGEST = 8_000_000_000  # bytes of memory, libraries included
MAX_BYTES = 4_000_000_000  # of what comes back
MAX_ENTRIES = 200_000_000  # of one array that comes back


def in_child(
    function: str,
    request: Mapping[str, Any],
    prepare: Callable[[Path], None] = lambda folder: None,
    memory: int = LARGEST,
    seconds: int = 0,
) -> dict[str, np.ndarray]:
    """The arrays that ``function`` (``"package.module:name"``) returns for keywords ``request``.

    ``request`` is JSON. The function runs with a new folder as its working directory, in which
    ``prepare`` may put files first, and ends with this process.

    Raises
    ------
    Kc2spiceError : the function raised one.
    NotImplementedError : the function raised it.
    ValueError : it raised anything else, crashed, or took more than ``memory`` bytes or
        ``seconds`` of the processor (0: any number).
    """
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    paths = (str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH"))
    environment = {**os.environ, **threads, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    with tempfile.TemporaryDirectory(prefix="kc2spice-") as place:
        folder = Path(place)
        prepare(folder)
        command = [sys.executable, "-m", __name__, function, str(memory), str(seconds)]
        with subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment,
        ) as process:
            assert process.stdin is not None
            with contextlib.suppress(BrokenPipeError):
                process.stdin.write(json.dumps(dict(request)).encode() + b"\n")
                process.stdin.flush()  # left open: its end is what tells the child that we ended
            code = process.wait()
        if code != 0:
            raise _reason(folder / REASON, code, memory)
        try:
            return read_archive(
                folder / ANSWER, lambda _: True, entries=lambda _: MAX_ENTRIES, total=MAX_BYTES
            )
        except (OSError, BadZipFile) as error:
            raise ValueError(f"its answer cannot be read: {error}") from None


def _reason(path: Path, code: int, memory: int) -> Exception:
    try:
        kind, own = json.loads(path.read_bytes())
    except (OSError, ValueError):
        name = signal.strsignal(-code) if code < 0 else f"exit code {code}"
        return ValueError(f"it makes the reader crash ({name})")
    if kind == "MemoryError":
        return ValueError(f"it needs more than {memory / 1e9:.0f} GB of memory")
    known = getattr(errors, kind, None)
    if isinstance(known, type) and issubclass(known, Kc2spiceError):
        return known(**own)
    told = own["message"]
    return NotImplementedError(told) if kind == "NotImplementedError" else ValueError(told)


def _main(function: str, memory: str, seconds: str) -> None:
    line = b""
    while not line.endswith(b"\n"):
        more = os.read(0, 1 << 16)
        if not more:
            return
        line += more
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        module, _, name = function.partition(":")
        call = getattr(import_module(module), name)
        _limit(int(memory), int(seconds))
        np.savez(ANSWER, **call(**json.loads(line)))
    except Exception as error:  # a damaged file makes a parser raise nearly anything
        text = " ".join(str(error).split())[:300] or type(error).__name__
        own = vars(error) if isinstance(error, Kc2spiceError) else {"message": text}
        record = (type(error).__name__, own)
        Path(REASON).write_text(json.dumps(record, default=str), encoding="utf-8")
        os._exit(1)
    os._exit(0)  # destructors of other people's libraries have nothing to add


def _end_with_parent() -> None:
    while os.read(0, 1 << 16):
        pass
    os._exit(1)


def _limit(memory: int, seconds: int) -> None:
    with contextlib.suppress(ImportError):  # not a POSIX system
        import resource

        limits = {"RLIMIT_AS": memory, "RLIMIT_NPROC": 0, "RLIMIT_CORE": 0}
        if seconds:
            limits["RLIMIT_CPU"] = seconds
        for name, value in limits.items():
            with contextlib.suppress(AttributeError, ValueError, OSError):
                number = getattr(resource, name)
                _, hard = resource.getrlimit(number)
                value = value if hard == resource.RLIM_INFINITY else min(value, hard)
                resource.setrlimit(number, (value, value))


if __name__ == "__main__":
    _main(*sys.argv[1:])
