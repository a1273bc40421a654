"""Matrix Market files, every count compared with the file before it is used.

scipy's reader may crash the interpreter on a corrupt file.
Format: Boisvert, Pozo, Remington, NIST IR 5935 (1996).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy import sparse

from kc2spice.bodies.readers.limits import (
    bounded,
    checked,
    content,
    guarded,
    indices,
    mirrored,
    numbers,
    refused,
)
from kc2spice.rom.operators import Matrix

BANNER = b"%%matrixmarket"
_FORMS = ("coordinate", "array")
_FIELDS = ("real", "double", "integer")
_SYMMETRIES = ("general", "symmetric", "skew-symmetric")
_EXPECTED = "a Matrix Market file, 'coordinate' or 'array', 'real' or 'integer'"


def read_market(path: Path, letter: str) -> Matrix:
    """The matrix in ``path``: csc, or dense for B, C and D.

    Raises
    ------
    UsageError : damaged, cut off, too large, complex, or not finite.
    """
    return checked(guarded(path, _EXPECTED, lambda: _read(path, letter)), letter, path)


def _read(path: Path, letter: str) -> Matrix:
    data = content(path)
    end = data.find(b"\n", 0, 1000)
    banner = data[: max(end, 0)].decode("ascii", "replace").lower().split()
    if banner[:2] != ["%%matrixmarket", "matrix"] or len(banner) != 5:
        raise ValueError("the first line is not that of a Matrix Market file")
    form, field, symmetry = banner[2:]
    if form not in _FORMS or symmetry not in _SYMMETRIES:
        raise ValueError(f"'{form} {symmetry}' is not read")
    if field not in _FIELDS:
        raise ValueError(f"it is a {field} matrix")
    sizes, start = _sizes(data, end + 1)
    if len(sizes) != (3 if form == "coordinate" else 2) or min(sizes) < 0:
        raise ValueError("the line of sizes is damaged")
    rows, columns = sizes[:2]
    if symmetry != "general" and rows != columns:
        raise ValueError(f"{symmetry}, but {rows} x {columns}")
    entries = sizes[2] if form == "coordinate" else _stored(rows, columns, symmetry)
    bounded(path, letter, (rows, columns), entries)
    count = 3 * entries if form == "coordinate" else entries
    if 2 * count > len(data) - start + 2:
        raise refused(path, f"{len(data)} bytes", f"{entries} entries: it is cut off")
    values = numbers(data[start:])
    if values.size != count:
        raise ValueError(f"{values.size} numbers instead of {count}: is it cut off?")
    make = _coordinate if form == "coordinate" else _array
    return make(rows, columns, symmetry, values)


def _sizes(data: bytes, start: int) -> tuple[list[int], int]:
    """The line of sizes behind the comments, and where the numbers begin."""
    while start < len(data):
        end = data.find(b"\n", start)
        end = len(data) if end < 0 else end
        line = data[start:end].strip()
        start = end + 1
        if line and not line.startswith(b"%"):
            return [int(word) for word in line[:200].split()], start
    raise ValueError("the line of sizes is missing")


def _stored(rows: int, columns: int, symmetry: str) -> int:
    if symmetry == "general":
        return rows * columns
    return rows * (rows + 1) // 2 if symmetry == "symmetric" else rows * (rows - 1) // 2


def _coordinate(rows: int, columns: int, symmetry: str, values: np.ndarray) -> Matrix:
    row, column = indices(values[0::3], rows), indices(values[1::3], columns)
    matrix = sparse.csc_array((values[2::3], (row, column)), shape=(rows, columns))
    if symmetry == "general":
        return matrix
    skew = symmetry != "symmetric"
    if (row < column).any() or (skew and (row == column).any()):
        raise ValueError(f"{symmetry}, but an entry is not in the lower triangle")
    return mirrored(matrix, -1 if skew else 1)


def _array(rows: int, columns: int, symmetry: str, values: np.ndarray) -> Matrix:
    if symmetry == "general":
        return values.reshape(columns, rows).T.copy()
    skew = symmetry != "symmetric"
    upper = np.zeros((rows, rows))
    upper[np.triu_indices(rows, k=int(skew))] = values  # columns of the lower triangle
    return upper.T - upper if skew else upper.T + np.triu(upper, 1)
