"""numpy archives of others: what they declare is compared with limits before it is unpacked."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import IO

import numpy as np

_ITEM = 1_000_000  # bytes of one entry, which is a text where it is more than a number


def read_archive(
    path: Path, wanted: Callable[[str], bool], *, entries: Callable[[str], int], total: int
) -> dict[str, np.ndarray]:
    """The arrays of an ``.npz`` file whose names are ``wanted``; nothing is unpickled.

    Memory is taken only once every wanted member has declared at most ``entries(name)`` numbers,
    all of them at most ``total`` bytes, and no more than it holds.

    Raises
    ------
    ValueError : too large, or a member that is no plain array.
    """
    with zipfile.ZipFile(path) as archive:
        members = {item.filename.removesuffix(".npy"): item for item in archive.infolist()}
        chosen = {name: item for name, item in members.items() if wanted(name)}
        declared = 0
        for name, item in chosen.items():
            with archive.open(item) as stream:
                shape, kind = _declared(stream)
            count = math.prod(shape)
            size = count * kind.itemsize
            if count > entries(name):
                raise ValueError(f"{name} has {count} entries, more than {entries(name)}")
            if kind.hasobject:
                raise ValueError(f"{name} is a Python object, no array of numbers")
            if kind.itemsize > _ITEM or size > item.file_size:
                raise ValueError(f"{name} is not a plain array of its declared size")
            declared += size
        if declared > total:
            raise ValueError(f"{declared:.3g} bytes unpacked, more than {total:.3g}")
        found = {}
        for name, item in chosen.items():
            with archive.open(item) as stream:
                found[name] = np.lib.format.read_array(stream, allow_pickle=False)
        return found


def _declared(stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype]:
    version = np.lib.format.read_magic(stream)
    readers = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    if version not in readers:
        raise ValueError(f"array format {version} is not read")
    shape, _, kind = readers[version](stream)
    if any(not isinstance(n, int) or n < 0 for n in shape):
        raise ValueError("a size is not a number")
    return shape, kind
