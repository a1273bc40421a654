"""``.npz`` archives of matrices by letter; nothing is unpickled.

Dense arrays of the names ``M``, ``E``, ``K``, ``A``, ``B``, ``C``, ``D``, or the parts of a sparse
matrix as ``scipy.sparse.save_npz`` names them behind the letter and a dot (``K.format``,
``K.shape``, ``K.data``, ``K.indices``, ``K.indptr``; coo has ``K.row`` and ``K.col``). ``nodes``
(n,) and ``dofs`` (n,), integers, may name the rows.
"""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import IO

import numpy as np
from scipy import sparse

from kc2spice.bodies.readers.limits import (
    LETTERS,
    MAX_BYTES,
    MAX_DENSE,
    MAX_ENTRIES,
    bounded,
    checked,
    existing,
    guarded,
    refused,
)
from kc2spice.bodies.readers.raw import DOFS, Dofs, Raw

_NAMES = ("nodes", "dofs")


def read_archive(archive: Path, path: Path | None = None) -> Raw:
    """Matrices of ``archive``; ``path`` is the file that the user knows.

    Raises
    ------
    UsageError : missing, damaged, too large, with Python objects, or parts that make no matrix.
    """
    path = path or archive
    existing(archive)
    arrays = guarded(path, "a numpy archive without Python objects", lambda: _load(archive, path))
    found = {}
    for letter in LETTERS:
        parts = {k.partition(".")[2]: a for k, a in arrays.items() if k.split(".")[0] == letter}
        if parts:
            matrix = parts[""] if "" in parts else _sparse(path, letter, parts)
            found[letter] = checked(matrix, letter, path)
    return Raw(found, _dofs(arrays, path))


def _load(archive: Path, path: Path) -> dict[str, np.ndarray]:
    with zipfile.ZipFile(archive) as members:
        wanted = [
            item for item in members.infolist()
            if item.filename.removesuffix(".npy").split(".")[0] in (*LETTERS, *_NAMES)
        ]  # fmt: skip
        unpacked = sum(item.file_size for item in wanted)
        if unpacked > MAX_BYTES:
            raise refused(path, f"{unpacked:.3g} bytes unpacked", f"at most {MAX_BYTES:.3g}")
        for item in wanted:
            with members.open(item) as stream:
                _bounded_header(stream, item, path)
    with np.load(archive, allow_pickle=False) as data:
        return {key: data[key] for key in data.files if key.split(".")[0] in (*LETTERS, *_NAMES)}


def _bounded_header(stream: IO[bytes], item: zipfile.ZipInfo, path: Path) -> None:
    """The header of one array says how much memory it wants: look before numpy takes it."""
    name = item.filename.removesuffix(".npy")
    version = np.lib.format.read_magic(stream)
    read = {
        (1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0
    }  # fmt: skip
    if version not in read:
        raise ValueError(f"array {name} is of version {version}")
    shape, _, dtype = read[version](stream)
    if dtype.hasobject:
        raise ValueError(f"array {name} holds Python objects")
    entries = int(np.prod([int(k) for k in shape], dtype=object)) if shape else 1
    limit = MAX_ENTRIES if "." in name or name in _NAMES else MAX_DENSE
    if entries > limit:
        size = " x ".join(map(str, shape))
        raise refused(path, f"array {name} of {size}", f"at most {limit} entries")
    if entries * dtype.itemsize > item.file_size:
        raise ValueError(f"array {name} is cut off")


def _sparse(path: Path, letter: str, parts: dict[str, np.ndarray]) -> sparse.csc_array:
    def build() -> sparse.csc_array:
        kind = str(parts["format"].item()) if "format" in parts else "coo"
        kind = kind.removeprefix("b'").removesuffix("'")
        rows, columns = (int(k) for k in parts["shape"])
        bounded(path, letter, (rows, columns), parts["data"].size)
        if kind == "coo":
            inner = (parts["data"], (parts["row"], parts["col"]))
            return sparse.csc_array(sparse.coo_array(inner, shape=(rows, columns)))
        maker = {"csc": sparse.csc_array, "csr": sparse.csr_array}[kind]
        matrix = maker((parts["data"], parts["indices"], parts["indptr"]), shape=(rows, columns))
        matrix.check_format(full_check=True)
        return sparse.csc_array(matrix)

    return guarded(path, f"csc, csr or coo parts of {letter}", build)


def _dofs(arrays: dict[str, np.ndarray], path: Path) -> Dofs | None:
    given = [name for name in _NAMES if name in arrays]
    if not given:
        return None
    if len(given) == 1:
        raise refused(path, f"array {given[0]} alone", "nodes and dofs, one entry per row each")
    node, kind = (np.asarray(arrays[name]).ravel() for name in _NAMES)
    sound = node.dtype.kind in "iu" and kind.dtype.kind in "iu" and node.shape == kind.shape
    if not sound or not np.isin(kind, list(DOFS)).all():
        raise refused(path, "arrays nodes, dofs", "integers; dofs 1 to 6, 9 volt, 11 temp")
    return Dofs(node.astype(np.int64), kind.astype(np.int64))
