"""What a file gives before ports are chosen, matrices by letter and names of their rows, and what
every reader refuses before it takes memory or follows an index."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from scipy import sparse

from kc2spice.core.errors import Kc2spiceError, UsageError
from kc2spice.rom.matrix_market import mirrored
from kc2spice.rom.operators import Matrix

LETTERS = ("M", "E", "K", "A", "B", "C", "D")
WIDE = ("B", "C", "D")  # few rows or columns, kept dense
MAX_SIZE = 5_000_000  # rows or columns
MAX_ENTRIES = 200_000_000  # stored numbers of one matrix
MAX_DENSE = 50_000_000  # entries of a full matrix
MAX_WIDE = 25_000_000  # entries of B, C or D, which may be more than their file holds
MAX_BYTES = 4_000_000_000  # one file, unpacked
UNPACKED = 100_000_000, 100  # bytes of any packed file, and times its size of a large one
NEXT = "write it again with the tool that it comes from; formats: kc2spice reduce --help"
_BOM = b"\xef\xbb\xbf"

# Degrees of freedom by number: 1 to 6 as every tool counts them, the others as Abaqus or ours.
DOFS = {
    0: "scalar", 1: "ux", 2: "uy", 3: "uz", 4: "rx", 5: "ry", 6: "rz", 7: "warp", 8: "pres",
    9: "volt", 11: "temp", 12: "conc", 13: "mag", 14: "emf", 15: "curr", 21: "ax", 22: "ay",
    23: "az", 31: "vx", 32: "vy", 33: "vz", 41: "enke", 42: "ends", 43: "hdsp",
}  # fmt: skip
CODES = {name: code for code, name in DOFS.items()}
TRANSLATIONS = (1, 2, 3)
ROTATIONS = (4, 5, 6)
VOLT = CODES["volt"]
_KINDS = 64  # a row's key is its node times this and its kind of freedom
_LARGEST_NODE = 2**40

Triple: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]
T = TypeVar("T")


# --- what is refused ------------------------------------------------------------------------------


def refused(path: Path, got: object, expected: str, hint: str = NEXT) -> UsageError:
    """The error for a file that cannot be used."""
    return UsageError("cannot be used", where=str(path), got=got, expected=expected, hint=hint)


def present(path: Path) -> bool:
    """Whether ``path`` is a file; a name that no file can have (NUL, too long) is none."""
    try:
        return path.is_file()
    except (ValueError, OSError):
        return False


def existing(path: Path, what: str = "a model in this file") -> Path:
    """``path``, which is a file of a size that can be read.

    Raises
    ------
    UsageError : no such file, or one above ``MAX_BYTES``.
    """
    if not present(path):
        where = str(path).replace("\0", "\\0")
        raise UsageError("no such file", where=where, expected=what)
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise refused(path, f"{size} bytes", f"at most {MAX_BYTES:.3g}")
    return path


def unpacked(path: Path) -> int:
    """Bytes that a packed file may come to: a small one is never much."""
    least, times = UNPACKED
    return min(MAX_BYTES, max(least, times * existing(path).stat().st_size))


def parsed(path: Path, expected: str, parse: Callable[[bytes], T]) -> T:
    """What ``parse`` makes of the bytes of a text file without its UTF-8 byte order mark."""
    data = existing(path).read_bytes().removeprefix(_BOM)
    return guarded(path, expected, lambda: parse(data))


def guarded(path: Path, expected: str, read: Callable[[], T]) -> T:
    """``read()``; whatever a damaged file makes a parser raise becomes one clear error."""
    try:
        return read()
    except Kc2spiceError:
        raise
    except NotImplementedError:
        message, got, hint = "is in a format that is not read", None, "in MATLAB: save(..., '-v7')"
    except Exception as error:  # parsers of hostile bytes raise nearly anything
        got = " ".join(str(error).split())[:160] or type(error).__name__
        message, hint = "cannot be read", NEXT
    raise UsageError(message, where=str(path), got=got, expected=expected, hint=hint)


def bounded(path: Path, letter: str, shape: tuple[int, ...], entries: int | None) -> None:
    """Refuse a matrix by its declared size, before memory is taken for it.

    Raises
    ------
    UsageError : not two-dimensional, or above the limits of this module.
    """
    shape = tuple(int(k) for k in shape)
    what = f"matrix {letter} of {' x '.join(map(str, shape))}"
    if len(shape) != 2:
        raise refused(path, what, "2 dimensions")
    if max(shape) > MAX_SIZE or min(shape) < 0:
        raise refused(path, what, f"at most {MAX_SIZE} rows and columns")
    if letter in WIDE and shape[0] * shape[1] > MAX_WIDE:
        raise refused(path, what, f"few inputs or outputs, at most {MAX_WIDE} numbers")
    limit = MAX_DENSE if entries == shape[0] * shape[1] else MAX_ENTRIES
    if entries is not None and not 0 <= entries <= limit:
        raise refused(path, f"{entries} entries in matrix {letter}", f"at most {limit}")


def checked(matrix: Any, letter: str, path: Path) -> Matrix:
    """``matrix`` as float64, two-dimensional, real and finite; csc unless few columns.

    Raises
    ------
    UsageError : it is anything else; the message says what.
    """
    if sparse.issparse(matrix):
        if matrix.format in ("csc", "csr"):  # indices out of range would be followed unseen
            guarded(path, f"a sound matrix {letter}", lambda: matrix.check_format(True))
        data = matrix.data
    elif isinstance(matrix, np.ndarray):
        data = matrix
    else:
        raise refused(path, f"matrix {letter} is a {type(matrix).__name__}", "a numeric matrix")
    if data.dtype.kind not in "fiub":
        what = "complex" if data.dtype.kind == "c" else f"of type {data.dtype}"
        raise refused(path, f"matrix {letter} is {what}", "a real numeric matrix")
    bounded(path, letter, matrix.shape, matrix.nnz if sparse.issparse(matrix) else matrix.size)
    if not np.isfinite(data).all():
        raise refused(path, f"matrix {letter} holds NaN or infinity", "finite numbers")
    if letter in WIDE:
        plain = matrix.toarray() if sparse.issparse(matrix) else matrix
        return np.asarray(plain, dtype=float)
    matrix = sparse.csc_array(matrix, dtype=float)
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    return matrix


# --- what is read ---------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Dofs:
    """Node number and kind of freedom (a key of ``DOFS``) of each row; both (n,) integers.

    Raises
    ------
    ValueError : something that is no node or freedom.
    """

    node: np.ndarray
    kind: np.ndarray

    def __post_init__(self) -> None:
        for name in ("node", "kind"):
            given = np.asarray(getattr(self, name))
            if not (given == np.floor(given)).all() or (abs(given) >= _LARGEST_NODE).any():
                raise ValueError("the number of a node or of its freedom is none")
            object.__setattr__(self, name, given.astype(np.int64))
        strange = ~np.isin(self.kind, list(DOFS))
        if self.node.shape != self.kind.shape or strange.any():
            raise ValueError(f"degree of freedom {', '.join(map(str, self.kind[strange][:1]))}")

    def __len__(self) -> int:
        return len(self.node)

    def keys(self) -> np.ndarray:
        """One integer per row, equal where node and kind are, sorted as nodes are."""
        return np.asarray(self.node * _KINDS + self.kind)


@dataclass(frozen=True, eq=False)
class Raw:
    """Matrices by letter, the freedoms of their rows if the file names them, which of the rows the
    tool itself holds fixed, and the file of each matrix where it has one of its own."""

    matrices: Mapping[str, Matrix]
    dofs: Dofs | None = None
    held: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    files: Mapping[str, Path] = field(default_factory=dict)


def keyed(table: np.ndarray) -> Triple:
    """Keys of rows and columns, and values, of lines (node, freedom, node, freedom, value)."""
    row, column = Dofs(*table[:, :2].T), Dofs(*table[:, 2:4].T)
    return row.keys(), column.keys(), table[:, 4]


def labelled(triples: Mapping[str, Triple]) -> tuple[dict[str, sparse.csc_array], Dofs]:
    """Matrices by letter, on one common set of rows, from what :func:`keyed` gives.

    Rows are sorted by node, then by freedom; gaps in the numbering leave no empty rows.
    """
    keys = np.unique(np.concatenate([side for t in triples.values() for side in t[:2]]))
    shape = (len(keys), len(keys))
    found = {}
    for letter, (row, column, value) in triples.items():
        place = (np.searchsorted(keys, row), np.searchsorted(keys, column))
        found[letter] = sparse.csc_array((value, place), shape=shape)
    return found, Dofs(keys // _KINDS, keys % _KINDS)


def whole(matrix: sparse.csc_array) -> sparse.csc_array:
    """A matrix whose pairs off the diagonal were stored once, on either side of it; as it is where
    any pair is stored twice.
    """
    below = abs(sparse.tril(matrix, -1, format="csc")) > 0
    above = abs(sparse.triu(matrix, 1, format="csc")) > 0
    return matrix if below.multiply(above.T).nnz else mirrored(matrix)
