"""Files of others: regular, bounded, and called by names that lead nowhere else."""

from __future__ import annotations

import errno
import os
import re
import stat
from pathlib import Path

from kc2spice.core.errors import UsageError

# One part of a path: it cannot hide, climb, be expanded by a shell or break a line.
_PART = re.compile(r"\w[\w .+-]{0,127}(?<![ .])")
_UNSAFE = re.compile(r"[^A-Za-z0-9_.+-]")


def read_bounded(path: Path, limit: int) -> bytes:
    """Content of the regular file ``path``, of which more than ``limit`` bytes are never read.

    A pipe or a device, which could keep a reader waiting for ever, is refused.

    Raises
    ------
    OSError : it is not there, no regular file, longer, or cannot be read.
    ValueError : the name has a zero byte.
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
        raise OSError(errno.EFBIG, f"too long, more than {limit} bytes", str(path))
    return data


def text_of(data: bytes) -> str:
    """UTF-8 text with or without a byte order mark; UnicodeDecodeError for anything else."""
    return data.decode("utf-8-sig")


def name_threat(name: str) -> str | None:
    """Why ``name`` may not be joined to a directory to name a file below it; None if it may.

    A name is one or more parts between slashes. Parts are letters, digits and ``_ . + -`` with
    blanks between them; they begin with a letter, a digit or ``_``.
    """
    if not name:
        return "an empty name"
    if re.match(r"([A-Za-z]:|[/\\~]|\w+://)", name):
        return "an absolute path"
    parts = re.split(r"[/\\]", name)
    if ".." in parts:
        return "a parent directory"
    if "\\" in name or any(_PART.fullmatch(part) is None for part in parts if part != "."):
        return "a name with characters that are not allowed"
    return None


def beside(home: Path, name: str, where: str) -> Path:
    """The file ``name`` in the folder ``home`` of the scene that names it, or below.

    Tables that a Python program hands over have no folder (``Path()``): what they name is the
    program's own choice.

    Raises
    ------
    UsageError : an absolute path, one with ``..``, or behind a link that leads elsewhere.
    """
    path = home / name
    if home == Path():
        return path
    given = Path(name)
    try:
        outside = not path.resolve().is_relative_to(home.resolve())
    except (OSError, ValueError, RuntimeError):  # a zero byte, too long, a circle of links
        outside = True
    if given.is_absolute() or ".." in given.parts or outside:
        raise UsageError(
            "leads out of the scene's folder",
            where=where,
            got=repr(name)[:200],
            expected="a file beside the scene or below",
            hint="copy it there",
        )
    return path


def identifier(name: str, otherwise: str) -> str:
    """``name`` in letters, digits and ``_``; ``otherwise_`` stands before what is no letter."""
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)[:48]
    return plain if plain[:1].isalpha() else f"{otherwise}_{plain}"


def plain_name(name: str) -> str:
    """The last part of ``name`` in letters, digits and ``_ . + -``, as a netlist may spell it."""
    plain = _UNSAFE.sub("_", name.replace("\\", "/").rpartition("/")[2])
    return plain if plain[:1].isalnum() or plain[:1] == "_" else f"_{plain}"
