"""Safe reading of untrusted files, whose sizes, names and types are checked.

The time of Python's TOML parser is proportional to the square of the length of a dotted key.
Python's TOML parser calls itself for every nested bracket, so that many brackets exceed the
recursion limit. An archive may be much larger after unpacking. Therefore the sizes in a file are
compared with limits before the file is parsed or unpacked.

Parsers written in C can crash, fill the memory, or execute commands in a file. Therefore these
parsers run in a child process with limited memory in a separate folder. The child process cannot
print, and on POSIX systems cannot start programs. If the child process returns no arrays, the
calling process raises an error.
"""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import re
import signal
import stat
import subprocess
import sys
import tempfile
import threading
import tomllib
import zipfile
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import IO, Any
from zipfile import BadZipFile

import numpy as np

from kc2spice.core import errors
from kc2spice.core.errors import Kc2spiceError, UsageError

# Pattern of one part of a safe path.
# The pattern rejects hidden files, parent folders, shell expansions and line breaks.
_PATH_PART = re.compile(r"\w[\w .+-]{0,127}(?<![ .])")
_UNSAFE_CHARACTER = re.compile(r"[^A-Za-z0-9_.+-]")
_MAX_ITEM_BYTES = 1_000_000  # largest size of one array element in bytes (number or text)
# Largest size of a text file in bytes, and largest length of a TOML text in characters. A scene
# has a few kilobytes, and larger files may be an attack.
MAX_TEXT_BYTES = 1_000_000
MAX_NESTING = 32  # largest nesting depth of tables and arrays
LONGEST_KEY = 200  # largest number of characters in one part of a dotted key
# Pattern of a TOML token: strings, comments, bare keys, brackets, dots, blanks, other characters.
_TOML_TOKEN = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*"*|\'\'\'(?:[^\']|\'(?!\'\'))*\'*'
    r'|"(?:[^"\\\n]|\\.)*"?|\'[^\'\n]*\'?|#[^\n]*|[\w-]+|[\[{]|[\]}]|\.|[ \t]+'
    r'|[^"\'#\w\-\[\]{}. \t]+',
    re.DOTALL,
)
_AFTER_KEY = re.compile(r"[ \t]{0,200}[.=\]]")


def reject_toml_file(path: Path, expected: str) -> None:
    """Raise an error if a path names a TOML file instead of a netlist.

    ``expected`` describes the netlist that is accepted.
    """
    if path.suffix.lower() == ".toml":
        raise UsageError(
            "this file is a TOML file, not a netlist",
            where=str(path),
            expected=expected,
            hint=f"kc2spice run {path} runs a scene",
        )


def read_bounded(path: Path, limit: int) -> bytes:
    """Read a regular file; reject pipes, devices and files above a size limit.

    ``limit`` is the largest permitted size in bytes. Pipes and devices are rejected, because a read
    from a pipe or device may never end.

    Raises
    ------
    OSError : the file is missing, not regular, too long or unreadable.
    ValueError : the path contains a null byte.
    """
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    handle = os.open(path, flags)
    with os.fdopen(handle, "rb") as file:
        mode = os.fstat(handle).st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        data = file.read(limit + 1)
    if len(data) > limit:
        raise OSError(errno.EFBIG, f"the file has more than {limit} bytes", str(path))
    return data


def decode_text(data: bytes) -> str:
    """Decode UTF-8 text with or without a byte order mark.

    Other encodings raise UnicodeDecodeError.
    """
    return data.decode("utf-8-sig")


def make_encoding_error(data: bytes, where: str) -> UsageError:
    """Make the error for a file that is not UTF-8 text.

    The error states the line and the likely encoding of the text.
    """
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding, got = "UTF-16", "a text in UTF-16"
    elif b"\0" in data:
        return UsageError(
            "this file is binary, not a text file",
            where=where,
            got=f"bytes {data[:8]!r}"[:60],
            expected="a text file in UTF-8",
            hint="give the path of a text file",
        )
    else:
        encoding = "Windows-1252"
        try:
            data.decode("utf-8")
            got = "a text in another encoding"
        except UnicodeDecodeError as error:
            line = data[: error.start].count(b"\n") + 1
            start = data.rfind(b"\n", 0, error.start) + 1
            excerpt = data[start:].splitlines()[0].decode("cp1252", "replace").strip()[:60]
            got = f"in line {line}: {excerpt}"
    return UsageError(
        "this text file is not encoded in UTF-8",
        where=where,
        got=got,
        expected="a text file in UTF-8",
        hint=f"in a text editor, save {where} with the encoding UTF-8, not {encoding}",
    )


def split_lines(text: str) -> list[str]:
    r"""Split a text into lines that end with ``\n``, ``\r\n`` or ``\r``.

    ``str.splitlines`` also breaks lines at form feeds and at U+0085, U+2028 and U+2029. If a
    character such as U+2028 also ended a line, the rest of a netlist comment could become a
    statement.

    >>> split_lines("* a comment\u2028that goes on\nR1 a b 1k\n")
    ['* a comment\u2028that goes on', 'R1 a b 1k']
    """
    lines = re.split(r"\r\n|\r|\n", text)
    return lines if lines[-1] else lines[:-1]


def explain_unsafe_name(name: str) -> str | None:
    """Explain why a file name is unsafe as a path; return None for a safe name.

    A safe path consists of components that are separated by slashes. Each component contains only
    letters, digits, spaces and ``_ . + -``. Each component of a safe path begins with a letter, a
    digit or ``_``, and does not end with a space or a dot.
    """
    if not name:
        return "an empty name"
    if re.match(r"([A-Za-z]:|[/\\~]|\w+://)", name):
        return "an absolute path"
    parts = re.split(r"[/\\]", name)
    if ".." in parts:
        return "a parent directory"
    if "\\" in name or any(_PATH_PART.fullmatch(part) is None for part in parts if part != "."):
        return "a name with characters that are not allowed"
    return None


def locate_file_in_folder(home: Path, name: str, where: str) -> Path:
    """Return the path of a file in the scene's folder or in a subfolder.

    ``home`` is the folder of the scene. If the scene consists of tables from a Python program,
    ``home`` is ``Path()``, and any file is accepted.

    Raises
    ------
    UsageError : the path is absolute, contains ``..``, or leads out of the folder through a link.
    """
    path = home / name
    if home == Path():
        return path
    relative = Path(name)
    try:
        outside = not path.resolve().is_relative_to(home.resolve())
    # the path contains a null byte or circular links, or is too long
    except (OSError, ValueError, RuntimeError):
        outside = True
    if relative.is_absolute() or ".." in relative.parts or outside:
        raise UsageError(
            "the file is outside of the scene's folder",
            where=where,
            got=repr(name)[:200],
            expected="a file in the scene's folder or its subfolders",
            hint=f"copy the file into {home} and correct the path",
        )
    return path


def make_identifier(name: str, otherwise: str) -> str:
    """Replace all characters of a name except letters and digits by ``_``.

    If the name does not begin with a letter, the argument ``otherwise`` and an underscore are put
    before the name.
    """
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)[:48]
    return plain if plain[:1].isalpha() else f"{otherwise}_{plain}"


def make_plain_name(name: str) -> str:
    """Return the last part of a path, with unusual characters replaced by ``_``.

    The result is suitable for netlists. Letters, digits and ``_ . + -`` remain unchanged.
    """
    plain = _UNSAFE_CHARACTER.sub("_", name.replace("\\", "/").rpartition("/")[2])
    return plain if plain[:1].isalnum() or plain[:1] == "_" else f"_{plain}"


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML text with limits on its length and its nesting.

    Raises
    ------
    ValueError : the text is not TOML, too long, or nested too deeply.
    """
    if len(text) > MAX_TEXT_BYTES:
        raise ValueError(f"the text has more than {MAX_TEXT_BYTES} characters")
    _require_simple_syntax(text)
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _require_simple_syntax(text: str) -> None:
    """Reject TOML text with deeply nested tables, long keys or many dots in a key."""
    depth = dots = 0
    for token in _TOML_TOKEN.finditer(text):
        first = token[0][0]
        if first in "[{":
            depth, dots = depth + 1, 0
        elif first in "]}":
            depth, dots = max(0, depth - 1), 0
        elif first == ".":
            dots += 1
        elif not (first in " \t\"'_-" or first.isalnum()):
            dots = 0
        elif len(token[0]) > LONGEST_KEY and (dots or _AFTER_KEY.match(text, token.end())):
            raise ValueError(f"a key has more than {LONGEST_KEY} characters")
        if depth > MAX_NESTING or dots > MAX_NESTING:
            raise ValueError(f"the tables are nested more than {MAX_NESTING} deep")


def read_archive(
    path: Path, select: Callable[[str], bool], *, entries: Callable[[str], int], total: int
) -> dict[str, np.ndarray]:
    """Read selected arrays of an ``.npz`` file, with limits on their size.

    The function ``select`` returns whether the array with a name is to be read. No object is
    unpickled. Before an array is read, the size in its header is checked. An array must have at
    most ``entries(name)`` elements. The header of an array must not declare more bytes than its
    unpacked ``.npy`` file contains. All arrays together must have at most ``total`` bytes.

    Raises
    ------
    ValueError : the arrays are too large, or a file in the archive is not an array of numbers or
        text.
    """
    with zipfile.ZipFile(path) as archive:
        members = {item.filename.removesuffix(".npy"): item for item in archive.infolist()}
        selected = {name: item for name, item in members.items() if select(name)}
        declared = 0
        for name, item in selected.items():
            with archive.open(item) as stream:
                shape, kind = _read_header(stream)
            count = math.prod(shape)
            size = count * kind.itemsize
            if count > entries(name):
                raise ValueError(f"{name} has {count} entries, more than {entries(name)}")
            if kind.hasobject:
                raise ValueError(f"{name} is a Python object, not an array of numbers")
            if kind.itemsize > _MAX_ITEM_BYTES or size > item.file_size:
                raise ValueError(
                    f"the array {name} has elements of more than {_MAX_ITEM_BYTES} bytes, or the "
                    "file contains fewer bytes than the array's header declares"
                )
            declared += size
        if declared > total:
            raise ValueError(f"{declared:.3g} unpacked bytes exceed the limit of {total:.3g}")
        result = {}
        for name, item in selected.items():
            with archive.open(item) as stream:
                result[name] = np.lib.format.read_array(stream, allow_pickle=False)
        return result


def read_shapes(path: Path) -> dict[str, tuple[int, ...]]:
    """Read the shape of each numeric array in an ``.npz`` file, keyed by name.

    Other members of the file, and members with a damaged header, are omitted.
    """
    result = {}
    with zipfile.ZipFile(path) as archive:
        for item in archive.infolist():
            with contextlib.suppress(ValueError), archive.open(item) as stream:
                shape, kind = _read_header(stream)
                if kind.kind in "fiubc":
                    result[item.filename.removesuffix(".npy")] = shape
    return result


def _read_header(stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype]:
    """Read the shape and the element type of an array from its header."""
    version = np.lib.format.read_magic(stream)
    readers = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    if version not in readers:
        raise ValueError(f"array format {version} is not supported")
    shape, _, kind = readers[version](stream)
    if any(not isinstance(n, int) or n < 0 for n in shape):
        raise ValueError("a size is not a number")
    return shape, kind


RESULT_ARRAYS_FILE = "answer.npz"
ERROR_FILE = "reason.json"
MAX_CHILD_BYTES = 8_000_000_000  # memory limit [B] of the child process, including its libraries
MAX_RESULT_BYTES = 4_000_000_000  # largest total size [B] of all returned arrays
MAX_RESULT_ENTRIES = 200_000_000  # largest number of entries in one returned array


def call_in_child(
    function: str,
    request: Mapping[str, Any],
    prepare: Callable[[Path], None] = lambda folder: None,
    memory: int = MAX_CHILD_BYTES,
    seconds: int = 0,
) -> dict[str, np.ndarray]:
    """Call a function in a separate process, and return the arrays of the result.

    The text ``function`` has the form ``"package.module:name"``. ``request`` contains the keyword
    arguments of the function, which must be JSON values. The function must return a mapping of
    names to arrays. The child process runs in a new folder. Before the start, ``prepare`` may write
    files to this folder. The child process ends when the calling process ends.

    Raises
    ------
    Kc2spiceError : the function raised this error.
    NotImplementedError : the function raised this error.
    ValueError : the function raised another error, crashed, or exceeded ``memory`` bytes or
        ``seconds`` of processor time. With 0 seconds, the time is unlimited.
    """
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    paths = (str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH"))
    environment = {**os.environ, **threads, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    with tempfile.TemporaryDirectory(prefix="kc2spice-") as directory:
        folder = Path(directory)
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
                process.stdin.flush()  # the child process ends when this pipe closes
            code = process.wait()
        if code != 0:
            raise _explain_exit(folder / ERROR_FILE, code, memory)
        try:
            return read_archive(
                folder / RESULT_ARRAYS_FILE,
                lambda _: True,
                entries=lambda _: MAX_RESULT_ENTRIES,
                total=MAX_RESULT_BYTES,
            )
        except (OSError, BadZipFile) as error:
            raise ValueError(
                f"the process that imports this file wrote damaged data: {error}"
            ) from None


def _explain_exit(path: Path, code: int, memory: int) -> Exception:
    """Return the error that describes how the child process failed."""
    try:
        kind, attributes = json.loads(path.read_bytes())
    except (OSError, ValueError):
        name = signal.strsignal(-code) if code < 0 else f"exit code {code}"
        return ValueError(f"the process that imports this file crashed ({name})")
    if kind == "MemoryError":
        return ValueError(f"the file needs more than {memory / 1e9:.0f} GB of memory")
    error_class = getattr(errors, kind, None)
    if isinstance(error_class, type) and issubclass(error_class, Kc2spiceError):
        return error_class(**attributes)
    text = attributes["message"]
    return NotImplementedError(text) if kind == "NotImplementedError" else ValueError(text)


def _run_in_child(function: str, memory: str, seconds: str) -> None:
    """Call a function in this child process; write its arrays or error to a file."""
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
        _limit_resources(int(memory), int(seconds))
        np.savez(RESULT_ARRAYS_FILE, **call(**json.loads(line)))
    except Exception as error:  # a parser may raise any exception for a damaged file
        text = " ".join(str(error).split())[:300] or type(error).__name__
        attributes = error.text_arguments if isinstance(error, Kc2spiceError) else {"message": text}
        record = (type(error).__name__, attributes)
        Path(ERROR_FILE).write_text(json.dumps(record, default=str), encoding="utf-8")
        os._exit(1)
    os._exit(0)  # exits without calling the destructors of libraries


def _end_with_parent() -> None:
    """End this process when the pipe from the parent process closes."""
    while os.read(0, 1 << 16):
        pass
    os._exit(1)


def _limit_resources(memory: int, seconds: int) -> None:
    """Limit the memory and processor time of this process; forbid child processes."""
    with contextlib.suppress(ImportError):  # the module exists on POSIX systems only
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
    _run_in_child(*sys.argv[1:])
