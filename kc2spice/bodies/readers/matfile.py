"""MATLAB files, read in a process of their own: scipy's reader may crash on a corrupt one.

Variables ``M``, ``E``, ``K``, ``A``, ``B``, ``C``, ``D`` (and ``nodes``, ``dofs``), or one struct
as COMSOL's ``mphmatrix`` and ``mphstate`` return it. It writes ``E u'' + D u' + K u = L``, so its
``E`` is our mass, its ``D`` our damping, its ``L`` our ``B``; the eliminated ``Ec``, ``Dc``,
``Kc``, ``Lc`` are taken where they exist. ``mphstate`` gives ``Mc x' = MA x + MB u`` (or ``A``,
``B``) and ``y = C x + D u``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy import io, sparse

from kc2spice.bodies.readers.archive import packed, read_in_child
from kc2spice.bodies.readers.limits import LETTERS, MAX_DENSE
from kc2spice.bodies.readers.raw import Raw

_OTHER = ("cell", "object", "char", "function", "opaque")
_STATE: dict[str, tuple[str, ...]] = {
    "E": ("Mc",),
    "A": ("MA", "A"),
    "B": ("MB", "B"),
    "C": ("C",),
    "D": ("D",),
}
_SECOND: dict[str, tuple[str, ...]] = {
    "M": ("Ec", "E"),
    "E": ("Dc", "D"),
    "K": ("Kc", "K"),
    "B": ("Lc", "L"),
}


def read_mat(path: Path) -> Raw:
    """Matrices of a MATLAB file by letter; other variables are not looked at.

    Raises
    ------
    UsageError : missing, damaged, of version 7.3, or one of the matrices is not numeric.
    """
    expected = "a MATLAB file of version 5 to 7.2 with matrices, or with one mphmatrix struct"
    return read_in_child(path, expected, f"{__name__}:unpack")


def unpack(path: str) -> dict[str, np.ndarray]:
    """The matrices of a MATLAB file as arrays of an archive.

    Raises
    ------
    ValueError, NotImplementedError : nearly anything that is wrong with it.
    """
    names = (*LETTERS, "nodes", "dofs")
    kinds = {name: (shape, kind) for name, shape, kind in io.whosmat(path, appendmat=False)}
    wanted = [name for name in names if name in kinds]
    structs = [name for name, (_, kind) in kinds.items() if kind == "struct"]
    if not set(wanted) & set(LETTERS) and len(structs) == 1:
        found = _struct(
            io.loadmat(path, appendmat=False, variable_names=structs)[structs[0]], structs[0]
        )
    else:
        for name in wanted:
            shape, kind = kinds[name]
            if kind in (*_OTHER, "struct"):
                raise ValueError(f"variable {name} is a {kind}")
            if kind != "sparse" and np.prod(shape, dtype=float) > MAX_DENSE:
                raise ValueError(f"variable {name} of {shape} is too large")
        found = io.loadmat(path, appendmat=False, variable_names=wanted) if wanted else {}
    parts: dict[str, np.ndarray] = {}
    for name in names:
        if name in found:
            parts |= packed(name, _plain(name, found[name]))
    return parts


def _plain(name: str, matrix: Any) -> Any:
    if sparse.issparse(matrix):
        return _real(matrix.tocsc())
    matrix = _real(np.asarray(matrix))
    if name in ("nodes", "dofs"):  # MATLAB's numbers are doubles
        if not (matrix == np.floor(matrix)).all():
            raise ValueError(f"variable {name} holds fractions")
        return matrix.astype(np.int64)
    return matrix


def _real(matrix: Any) -> Any:
    """COMSOL marks real matrices as complex where a solver was complex."""
    data = matrix.data if sparse.issparse(matrix) else matrix
    return matrix.real if np.iscomplexobj(data) and not data.imag.any() else matrix


def _struct(value: Any, name: str) -> dict[str, Any]:
    if value.shape != (1, 1) or value.dtype.names is None:
        raise ValueError(f"struct {name} is an array of structs")
    fields = {key: value[0, 0][key] for key in value.dtype.names}

    def pick(table: dict[str, tuple[str, ...]]) -> dict[str, Any]:
        return {
            letter: next(fields[key] for key in keys if key in fields)
            for letter, keys in table.items()
            if any(key in fields for key in keys)
        }

    if "MA" in fields or ("A" in fields and "K" not in fields):
        return pick(_STATE)
    if not {"K", "Kc"} & set(fields):
        raise ValueError(f"struct {name} has fields {', '.join(fields)}; K or Kc is needed")
    found = pick(_SECOND)
    if "Kc" not in fields and "N" in fields and _entries(fields["N"]):
        raise ValueError(f"struct {name} has constraints N that are not eliminated: ask for Kc, Ec")
    if "Kc" in fields and "uscale" in fields and (np.asarray(fields["uscale"]) != 1).any():
        raise ValueError(f"struct {name} is in unknowns over uscale: scale by None in the solver")
    if "M" in found and not _entries(found["M"]):
        del found["M"]  # a first-order problem: E is D, the damping
    if "M" in found and "E" in found and not _entries(found["E"]):
        del found["E"]
    if "B" in found and not _entries(found["B"]):
        del found["B"]  # no load: ports come from the TOML file
    return found


def _entries(matrix: Any) -> int:
    return int(matrix.count_nonzero() if sparse.issparse(matrix) else np.count_nonzero(matrix))
