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

from kc2spice.bodies.readers.limits import LETTERS, MAX_DENSE, MAX_ENTRIES, bounded, unpacked
from kc2spice.bodies.readers.raw import Dofs, Raw
from kc2spice.core import foreign
from kc2spice.core.child import in_child

_NAMES = ("nodes", "dofs")
_SECONDS = 8, 1_000_000  # of the processor for a small file; bytes a second of a large one
_MEMORY = 1_300_000_000  # bytes, libraries included, beside what the file may come to


def read_archive(path: Path) -> Raw:
    """Matrices of the archive at ``path``.

    Raises
    ------
    UsageError, ValueError : missing, damaged, too large, with Python objects, or parts that make
        no matrix.
    """

    def wanted(name: str) -> bool:
        return name.split(".")[0] in (*LETTERS, *_NAMES)

    def largest(name: str) -> int:
        return MAX_DENSE if name in LETTERS else MAX_ENTRIES

    total = unpacked(path)
    return _raw(foreign.read_archive(path, wanted, entries=largest, total=total), path)


def read_in_child(path: Path, function: str, wanted: Mapping[str, str]) -> Raw:
    """What ``function(path, wanted)`` packs in a process of its own, whose memory and time are
    bounded by the size of the file.

    Raises
    ------
    UsageError, ValueError : missing, too large, or anything else that goes wrong there.
    MissingToolError : it needs a package that is not installed.
    """
    memory = _MEMORY + 2 * unpacked(path)
    seconds = _SECONDS[0] + path.stat().st_size // _SECONDS[1]
    request = {"path": str(path.absolute()), "wanted": dict(wanted)}
    return _raw(in_child(function, request, memory=memory, seconds=seconds), path)


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
            found[letter] = parts[""] if "" in parts else _sparse(path, letter, parts)
    return Raw(found, _dofs(arrays), arrays.get("held", np.empty(0, dtype=np.int64)))


def _sparse(path: Path, letter: str, parts: dict[str, np.ndarray]) -> sparse.csc_array:
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


def _dofs(arrays: Mapping[str, np.ndarray]) -> Dofs | None:
    given = [np.asarray(arrays[name]).ravel() for name in _NAMES if name in arrays]
    if not given:
        return None
    if len(given) == 1 or any(array.dtype.kind not in "iu" for array in given):
        raise ValueError("nodes and dofs are not integers, one of each for every row")
    return Dofs(*given)
