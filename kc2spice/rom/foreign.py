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

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import sparse

from kc2spice.core.errors import UsageError
from kc2spice.rom.foreign_files import LETTERS, read_mat, read_matrix_market, read_npz
from kc2spice.rom.foreign_ports import PortTable, read_ports
from kc2spice.rom.linear import LinearModel, half_stored
from kc2spice.rom.operators import Matrix


def read_model(path: Path | str, *, triangular: bool = False) -> LinearModel:
    """Read the model at ``path``: a ``.mat`` or ``.npz`` file, or ``NAME`` or any ``NAME.X`` of a
    Matrix Market family. ``triangular`` says that matrices with one triangle are meant so.

    Raises
    ------
    UsageError : no such model; a file that is damaged, too large, or not real and finite; matrices
        that do not fit together, or of which one half seems to be missing. The message names the
        file and what was expected in it.
    """
    path = Path(path)
    if path.suffix == ".mat":
        base, found = path.with_suffix(""), read_mat(path)
    elif path.suffix == ".npz":
        base, found = path.with_suffix(""), read_npz(path)
    else:
        base = path.with_suffix("") if path.suffix[1:] in LETTERS and path.is_file() else path
        found = read_matrix_market(base)
    table = read_ports(base.with_name(f"{base.name}.toml"))
    return make_model(found, table, base.name, str(path), triangular=triangular)


def make_model(
    found: dict[str, Matrix], ports: PortTable | None, name: str, where: str, *,
    triangular: bool = False,
) -> LinearModel:  # fmt: skip
    """A model from its matrices by letter, checked for shapes, in the units of its pins.

    ``E`` and ``K`` without ``M`` (heat conduction) are first order with ``A = -K``.

    Raises
    ------
    UsageError : letters missing or too many, shapes that do not fit, a port table that does not,
        a half-stored matrix.
    """
    found = dict(found)
    if {"E", "K"} <= set(found) and not {"M", "A"} & set(found):
        found["A"] = -found.pop("K")
    required = ("A", "B") if "A" in found else ("M", "K", "B")
    missing = [letter for letter in required if letter not in found]
    if missing or ("A" in found and {"M", "K"} & set(found)):
        raise UsageError(
            "is not a complete model", where=where,
            got="matrices " + ", ".join(sorted(found)) if found else "no matrix",
            expected="M, K, B and as needed E, C, D; or A, B and as needed C, D, E",
        )  # fmt: skip
    if not triangular:
        _refuse_halves(found, where)
    matrices = {
        letter: _dense(P) if letter in "BCD" else sparse.csc_array(P) for letter, P in found.items()
    }
    model = replace(LinearModel(**matrices, name=where), name=name)
    if not model.B.any() or not model.C.any():
        raise UsageError("has no effective input or output", where=where, expected="B, C not zero")
    return (ports or PortTable()).apply(model)


def _refuse_halves(found: dict[str, Matrix], where: str) -> None:
    """Only the triangle of every second-order matrix is what half-stored files hold; one matrix
    of that form may be a model's own."""
    square = [letter for letter in ("M", "E", "K", "A") if letter in found]
    halves = [k for k in square if half_stored(found[k])]
    if halves and ("K" in halves or ("A" in found and len(halves) == len(square))):
        raise UsageError(
            "only one triangle of a matrix is stored", where=where, got=", ".join(halves),
            expected="whole matrices, or files that say 'symmetric'",
            hint="write both halves, or say --triangular if the matrix is triangular indeed",
        )  # fmt: skip


def _dense(matrix: Matrix) -> np.ndarray:
    return np.asarray(matrix.toarray() if sparse.issparse(matrix) else matrix, dtype=float)
