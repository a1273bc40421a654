"""Matrix files of three formats to real, finite, bounded matrices; anything else is refused.

Nothing is unpickled and no object is built. Sizes that a file's header promises are compared with
limits and with the file's own length before memory is taken.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy import sparse

from kc2spice.core.errors import UsageError
from kc2spice.rom.archive import read_archive
from kc2spice.rom.matlab import unpack
from kc2spice.rom.matrix_market import read_body, read_header
from kc2spice.rom.operators import Matrix

LETTERS = ("M", "E", "K", "A", "B", "C", "D")
WIDE = ("B", "C", "D")  # few rows or columns, kept dense
MAX_SIZE = 5_000_000  # rows or columns
MAX_ENTRIES = 200_000_000  # stored numbers of one matrix
MAX_DENSE = 50_000_000  # entries of a full matrix
MAX_BYTES = 8_000_000_000  # one file, unpacked

T = TypeVar("T")


def read_matrix_market(base: Path) -> dict[str, Matrix]:
    """Matrices of the family ``base.M``, ``base.K`` and so on that exist, by letter.

    Raises
    ------
    UsageError : none of them exists, or one is not a real Matrix Market file of sane size.
    """
    files = {letter: base.with_name(f"{base.name}.{letter}") for letter in LETTERS}
    present = {letter: path for letter, path in files.items() if path.is_file()}
    if not present:
        raise UsageError(
            "no such model",
            where=str(base),
            expected=f"{base.name}.M .E .K .B .C, or {base.name}.A .B .C .D .E, .mat or .npz",
        )
    return {letter: _matrix_market(path, letter) for letter, path in present.items()}


def read_mat(path: Path) -> dict[str, Matrix]:
    """Matrices of a MATLAB file by letter; other variables are not looked at.

    Raises
    ------
    UsageError : missing, damaged, of version 7.3, or one of the matrices is not numeric.
    """
    _existing(path)
    expected = "a MATLAB file of version 5 to 7.2 with numeric matrices"
    with tempfile.TemporaryDirectory() as place:
        archive = Path(place) / "matrices.npz"
        absolute = path.absolute()
        _guarded(path, expected, lambda: unpack(absolute, archive, LETTERS, MAX_DENSE))
        return _from_archive(archive, path)


def read_npz(path: Path) -> dict[str, Matrix]:
    """Matrices of a numpy archive by letter, dense or in sparse parts; nothing is unpickled.

    Raises
    ------
    UsageError : missing, damaged, with Python objects, or parts that make no matrix.
    """
    _existing(path)
    return _from_archive(path, path)


def _from_archive(archive: Path, path: Path) -> dict[str, Matrix]:
    """Matrices of ``archive``; ``path`` is the file that the user knows."""

    def load() -> dict[str, np.ndarray]:
        return {
            # a dense matrix is one member, a sparse one has its numbers in several
            **read_archive(archive, LETTERS.__contains__, entries=MAX_DENSE, total=MAX_BYTES),
            **read_archive(archive, _is_part, entries=MAX_ENTRIES, total=MAX_BYTES),
        }

    arrays = _guarded(path, "a numpy archive without Python objects", load)
    found = {}
    for letter in LETTERS:
        parts = {
            key.partition(".")[2]: a for key, a in arrays.items() if key.split(".")[0] == letter
        }
        if parts:
            matrix = parts[""] if "" in parts else _sparse(path, letter, parts)
            found[letter] = _checked(matrix, letter, path)
    return found


def _is_part(name: str) -> bool:
    return name.partition(".")[0] in LETTERS and "." in name


def _matrix_market(path: Path, letter: str) -> Matrix:
    expected = "a Matrix Market file, 'coordinate' or 'array', 'real' or 'integer'"
    header = _guarded(path, expected, lambda: read_header(path))
    _bounded(path, letter, (header.rows, header.columns), header.entries)
    if 2 * header.numbers > path.stat().st_size + 2:
        got = f"{path.stat().st_size} bytes"
        raise _refused(path, got, f"{header.entries} entries: it is cut off")
    return _checked(_guarded(path, expected, lambda: read_body(path, header)), letter, path)


def _sparse(path: Path, letter: str, parts: dict[str, np.ndarray]) -> sparse.csc_array:
    def build() -> sparse.csc_array:
        kind = str(parts["format"].item()) if "format" in parts else "coo"
        kind = kind.removeprefix("b'").removesuffix("'")
        rows, columns = (int(k) for k in parts["shape"])
        _bounded(path, letter, (rows, columns), parts["data"].size)
        if kind == "coo":
            inner = (parts["data"], (parts["row"], parts["col"]))
            return sparse.csc_array(sparse.coo_array(inner, shape=(rows, columns)))
        maker = {"csc": sparse.csc_array, "csr": sparse.csr_array}[kind]
        matrix = maker((parts["data"], parts["indices"], parts["indptr"]), shape=(rows, columns))
        matrix.check_format(full_check=True)
        return sparse.csc_array(matrix)

    return _guarded(path, f"csc, csr or coo parts of {letter}", build)


def _checked(matrix: Any, letter: str, path: Path) -> Matrix:
    """``matrix`` as float64, two-dimensional, real and finite; csc unless few columns."""
    if sparse.issparse(matrix):
        if matrix.format in ("csc", "csr"):  # indices out of range would be followed unseen
            _guarded(path, f"a sound matrix {letter}", lambda: matrix.check_format(True))
        data = matrix.data
    elif isinstance(matrix, np.ndarray):
        data = matrix
    else:
        raise _refused(path, f"matrix {letter} is a {type(matrix).__name__}", "a numeric matrix")
    if data.dtype.kind not in "fiub":
        what = "complex" if data.dtype.kind == "c" else f"of type {data.dtype}"
        raise _refused(path, f"matrix {letter} is {what}", "a real numeric matrix")
    if matrix.ndim != 2:
        raise _refused(path, f"matrix {letter} has {matrix.ndim} dimensions", "2 dimensions")
    entries = matrix.nnz if sparse.issparse(matrix) else matrix.size
    _bounded(path, letter, matrix.shape, entries)
    if not np.isfinite(data).all():
        raise _refused(path, f"matrix {letter} holds NaN or infinity", "finite numbers")
    if sparse.issparse(matrix) or letter not in WIDE:
        matrix = sparse.csc_array(matrix, dtype=float)
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
    return matrix if sparse.issparse(matrix) else np.asarray(matrix, dtype=float)


def _bounded(path: Path, letter: str, shape: Iterable[int], entries: int | None) -> None:
    shape = tuple(int(k) for k in shape)
    if len(shape) != 2 or max(shape) > MAX_SIZE or min(shape) < 0:
        got = f"matrix {letter} of {' x '.join(map(str, shape))}"
        raise _refused(path, got, f"at most {MAX_SIZE} rows and columns")
    limit = MAX_DENSE if entries == shape[0] * shape[1] else MAX_ENTRIES
    if letter in WIDE and shape[0] * shape[1] > MAX_DENSE:
        raise _refused(path, f"matrix {letter} of {shape[0]} x {shape[1]}", "few inputs or outputs")
    if entries is not None and entries > limit:
        raise _refused(path, f"{entries} entries in matrix {letter}", f"at most {limit}")


def _existing(path: Path) -> None:
    if not path.is_file():
        raise UsageError("no such file", where=str(path), expected="a model in this file")
    if path.stat().st_size > MAX_BYTES:
        raise _refused(path, f"{path.stat().st_size} bytes", f"at most {MAX_BYTES:.3g}")


def _guarded(path: Path, expected: str, read: Callable[[], T]) -> T:
    """``read()``; whatever a damaged file makes the parser raise becomes one clear error."""
    try:
        return read()
    except UsageError:
        raise
    except NotImplementedError:
        raise UsageError(
            "is in a format that is not read",
            where=str(path),
            expected=expected,
            hint="in MATLAB: save(..., '-v7')",
        ) from None
    except Exception as error:  # parsers of hostile bytes raise nearly anything
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise UsageError("cannot be read", where=str(path), got=reason, expected=expected) from None


def _refused(path: Path, got: str, expected: str) -> UsageError:
    return UsageError("cannot be used", where=str(path), got=got, expected=expected)
