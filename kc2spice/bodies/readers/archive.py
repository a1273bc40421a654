"""``.npz`` archives of matrices by letter; nothing is unpickled.

Dense arrays of the names ``M``, ``E``, ``K``, ``A``, ``B``, ``C``, ``D``, or the parts of a sparse
matrix as ``scipy.sparse.save_npz`` names them behind the letter and a dot (``K.format``,
``K.shape``, ``K.data``, ``K.indices``, ``K.indptr``; coo has ``K.row`` and ``K.col``). ``nodes``
(n,) and ``dofs`` (n,), integers, may name the rows. Readers in a process of their own hand their
matrices over in the same form.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

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
from kc2spice.core import archive
from kc2spice.core.child import in_child

_NAMES = ("nodes", "dofs")
_PLAIN = (
    "arrays of numbers; a scipy.sparse K as K.data, K.indices, K.indptr, K.shape and K.format, or "
    "in a file of its own, NAME.K.mtx, by scipy.io.mmwrite"
)


def read_archive(path: Path) -> Raw:
    """Matrices of the archive at ``path``.

    Raises
    ------
    UsageError : missing, damaged, too large, with Python objects, or parts that make no matrix.
    """
    existing(path)

    def wanted(name: str) -> bool:
        return name.split(".")[0] in (*LETTERS, *_NAMES)

    def largest(name: str) -> int:
        return MAX_DENSE if name in LETTERS else MAX_ENTRIES

    arrays = guarded(
        path,
        _PLAIN,
        lambda: archive.read_archive(path, wanted, entries=largest, total=MAX_BYTES),
    )
    return _raw(arrays, path)


def read_in_child(path: Path, expected: str, function: str, **request: Any) -> Raw:
    """What ``function(path, **request)`` packs in a process of its own.

    Raises
    ------
    UsageError : missing, too large, or anything else that goes wrong there.
    MissingToolError : it needs a package that is not installed.
    """
    request["path"] = str(existing(path).absolute())
    return _raw(guarded(path, expected, lambda: in_child(function, request)), path)


def packed(name: str, matrix: Any) -> dict[str, np.ndarray]:
    """A matrix, or the numbers of rows, as the arrays of an archive."""
    if not sparse.issparse(matrix):
        return {name: np.asarray(matrix)}
    csc = matrix.tocsc()
    parts = {f"{name}.{key}": getattr(csc, key) for key in ("data", "indices", "indptr")}
    return {**parts, f"{name}.shape": np.array(csc.shape), f"{name}.format": np.array("csc")}


def _raw(arrays: Mapping[str, np.ndarray], path: Path) -> Raw:
    found = {}
    for letter in LETTERS:
        parts = {k.partition(".")[2]: a for k, a in arrays.items() if k.split(".")[0] == letter}
        if parts:
            matrix = parts[""] if "" in parts else _sparse(path, letter, parts)
            found[letter] = checked(matrix, letter, path)
    return Raw(found, _dofs(arrays, path), arrays.get("held", np.empty(0, dtype=np.int64)))


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


def _dofs(arrays: Mapping[str, np.ndarray], path: Path) -> Dofs | None:
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
