"""Matrix Market files, read so that no damage in them can reach further than an error.

scipy's reader may crash the interpreter on a corrupt file; here every count is compared with what
the file holds, and every index with the size, before it is used.
Format: Boisvert, Pozo, Remington, NIST IR 5935 (1996).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import sparse

from kc2spice.rom.operators import Matrix

_FORMS = ("coordinate", "array")
_FIELDS = ("real", "double", "integer")
_SYMMETRIES = ("general", "symmetric", "skew-symmetric")


@dataclass(frozen=True)
class MarketHeader:
    """What stands before the numbers; ``numbers`` is how many must follow."""

    form: str
    symmetry: str
    rows: int
    columns: int
    entries: int
    offset: int

    @property
    def numbers(self) -> int:
        """Numbers in the body of the file."""
        return 3 * self.entries if self.form == "coordinate" else self.entries


def read_header(path: Path) -> MarketHeader:
    """Header of ``path``.

    Raises
    ------
    ValueError : not a real matrix in Matrix Market format, with the reason.
    """
    with path.open("rb") as stream:
        banner = stream.readline(1000).decode("ascii", "replace").lower().split()
        if banner[:2] != ["%%matrixmarket", "matrix"] or len(banner) != 5:
            raise ValueError("the first line is not that of a Matrix Market file")
        form, field, symmetry = banner[2:]
        if form not in _FORMS or symmetry not in _SYMMETRIES:
            raise ValueError(f"'{form} {symmetry}' is not read")
        if field not in _FIELDS:
            raise ValueError(f"it is a {field} matrix")
        line = stream.readline(100_000)
        while line.startswith(b"%") or (line and not line.strip()):
            line = stream.readline(100_000)
        sizes = [int(word) for word in line.split()]
        if len(sizes) != (3 if form == "coordinate" else 2) or min(sizes) < 0:
            raise ValueError("the line of sizes is damaged")
        rows, columns = sizes[:2]
        if symmetry != "general" and rows != columns:
            raise ValueError(f"{symmetry}, but {rows} x {columns}")
        entries = sizes[2] if form == "coordinate" else _stored(rows, columns, symmetry)
        return MarketHeader(form, symmetry, rows, columns, entries, stream.tell())


def read_body(path: Path, header: MarketHeader) -> Matrix:
    """The matrix behind ``header``: csc for 'coordinate', dense for 'array'.

    Raises
    ------
    ValueError : numbers are missing, too many or unreadable, or an index is outside the matrix.
    """
    with path.open("rb") as stream:
        stream.seek(header.offset)
        text = stream.read()
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # numpy stops at damage with a warning only
        try:
            numbers = np.fromstring(text, dtype=float, sep=" ") if text.strip() else np.empty(0)
        except (DeprecationWarning, ValueError):
            raise ValueError("something in it is not a number") from None
    if numbers.size != header.numbers:
        raise ValueError(f"{numbers.size} numbers instead of {header.numbers}: is it cut off?")
    return _coordinate(header, numbers) if header.form == "coordinate" else _array(header, numbers)


def _stored(rows: int, columns: int, symmetry: str) -> int:
    if symmetry == "general":
        return rows * columns
    return rows * (rows + 1) // 2 if symmetry == "symmetric" else rows * (rows - 1) // 2


def _coordinate(header: MarketHeader, numbers: np.ndarray) -> sparse.csc_array:
    place, value = numbers.reshape(-1, 3)[:, :2], numbers[2::3]
    limit = (header.rows, header.columns)
    if not ((place >= 1) & (place <= limit) & (place == np.floor(place))).all():
        raise ValueError("an index is outside the matrix")
    row, column = (place.T - 1).astype(np.int64)
    matrix = sparse.csc_array((value, (row, column)), shape=limit)
    if header.symmetry == "general":
        return matrix
    if (row < column).any() or (header.symmetry != "symmetric" and (row == column).any()):
        raise ValueError(f"{header.symmetry}, but an entry is not in the lower triangle")
    off = row != column
    sign = 1 if header.symmetry == "symmetric" else -1
    mirrored = (sign * value[off], (column[off], row[off]))
    return sparse.csc_array(matrix + sparse.csc_array(mirrored, shape=limit))


def _array(header: MarketHeader, numbers: np.ndarray) -> np.ndarray:
    if header.symmetry == "general":
        return numbers.reshape(header.columns, header.rows).T.copy()
    skew = header.symmetry != "symmetric"
    upper = np.zeros((header.rows, header.rows))
    upper[np.triu_indices(header.rows, k=int(skew))] = numbers  # columns of the lower triangle
    if skew:
        return upper.T - upper
    return upper.T + np.triu(upper, 1)
