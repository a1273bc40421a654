"""Models from other tools: Matrix Market families, ``.mat`` and ``.npz`` files, read with distrust.

Second order ``M x'' + E x' + K x = B u``, ``y = C x + D u``, first order ``E x' = A x + B u``: a
model with a matrix A is first order. Missing E is zero (second order) or one (first order), a
missing C is ``B'``, a missing D zero.

- ``NAME.M``, ``NAME.E`` ... one Matrix Market file each; the model is called ``NAME``.
- ``NAME.mat``: variables of these names, MATLAB 5 to 7.2, full or sparse.
- ``NAME.npz``: arrays of these names, or the parts of a sparse matrix as ``scipy.sparse.save_npz``
  names them behind the matrix and a dot (``K.format``, ``K.shape``, ``K.data``, ``K.indices``,
  ``K.indptr``; coo has ``K.row`` and ``K.col``).

``NAME.toml`` beside it may name the ports, see :mod:`kc2spice.rom.foreign_ports`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import sparse

from kc2spice.core.errors import UsageError
from kc2spice.fem.piezo.system import Port
from kc2spice.rom.foreign_files import LETTERS, read_mat, read_matrix_market, read_npz
from kc2spice.rom.foreign_ports import PortTable, read_ports
from kc2spice.rom.pencil import Matrix, Pencil


@dataclass(frozen=True)
class ForeignModel:
    """A full model of any origin, its ports (inputs, then outputs; each once where they are
    collocated and conservative) and the band [Hz] that its TOML asks for, if any.
    """

    name: str
    pencil: Pencil
    ports: tuple[Port, ...]
    band: tuple[float, float] | None = None


def read_model(path: Path | str) -> ForeignModel:
    """Read the model at ``path``: a ``.mat`` or ``.npz`` file, or ``NAME`` or any ``NAME.X`` of a
    Matrix Market family.

    Raises
    ------
    UsageError : no such model; a file that is damaged, too large, or not real and finite; matrices
        that do not fit together. The message names the file and what was expected in it.
    """
    path = Path(path)
    if path.suffix == ".mat":
        base, found = path.with_suffix(""), read_mat(path)
    elif path.suffix == ".npz":
        base, found = path.with_suffix(""), read_npz(path)
    else:
        base = path.with_suffix("") if path.suffix[1:] in LETTERS and path.is_file() else path
        found = read_matrix_market(base)
    return make_model(found, read_ports(base.with_name(f"{base.name}.toml")), base.name, str(path))


def make_model(
    found: dict[str, Matrix], ports: PortTable | None, name: str, where: str
) -> ForeignModel:
    """A model from its matrices by letter, checked for shapes, in the units of its pins.

    Raises
    ------
    UsageError : letters missing or too many, shapes that do not fit, a port table that does not.
    """
    first_order = "A" in found
    required = ("A", "B") if first_order else ("M", "K", "B")
    missing = [letter for letter in required if letter not in found]
    if missing or (first_order and {"M", "K"} & set(found)):
        raise UsageError(
            "is not a complete model",
            where=where,
            got="matrices " + ", ".join(sorted(found)) if found else "no matrix",
            expected="M, K, B and as needed E, C, D; or A, B and as needed C, D, E",
        )
    n = found[required[0]].shape[0]
    for letter in sorted({"M", "K", "A", "E"} & set(found)):
        _expect(found[letter], (n, n), letter, where)
    B = _dense(found["B"])
    _expect(B, (n, B.shape[1]), "B", where)
    C = _dense(found["C"]) if "C" in found else B.T.copy()
    _expect(C, (C.shape[0], n), "C", where)
    D = _dense(found["D"]) if "D" in found else np.zeros((C.shape[0], B.shape[1]))
    _expect(D, (C.shape[0], B.shape[1]), "D", where)
    if not B.any() or not C.any():
        raise UsageError("has no effective input or output", where=where, expected="B, C not zero")
    E = found.get("E", sparse.eye_array(n, format="csc") if first_order else None)
    E = sparse.csc_array((n, n)) if E is None else E
    coefficients = (-found["A"], E) if first_order else (found["K"], E, found["M"])
    pencil = Pencil(tuple(sparse.csc_array(P) for P in coefficients), B, C, D)
    table = ports or PortTable()
    return ForeignModel(name, *table.apply(pencil), table.band)


def _dense(matrix: Matrix) -> np.ndarray:
    return np.asarray(matrix.toarray() if sparse.issparse(matrix) else matrix, dtype=float)


def _expect(matrix: Matrix, shape: tuple[int, int], letter: str, where: str) -> None:
    if matrix.shape != shape or 0 in shape:
        raise UsageError(
            f"matrix {letter} does not fit",
            where=where,
            got=" x ".join(map(str, matrix.shape)),
            expected=" x ".join(map(str, shape)) + ", at least one row and column",
        )
