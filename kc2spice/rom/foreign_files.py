"""Matrix files of three formats to real, finite, bounded matrices; anything else is refused.

Nothing is unpickled and no object is built. Sizes that a file's header promises are compared with
limits and with the file's own length before memory is taken.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy import io, sparse

from kc2spice.errors import UsageError
from kc2spice.rom.pencil import Matrix

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
    listed = _guarded(path, "a MATLAB file of version 5 to 7.2", lambda: io.whosmat(str(path)))
    wanted = {}
    for letter, shape, kind in listed:
        if letter in LETTERS:
            if kind in ("cell", "struct", "object", "char", "function", "opaque"):
                raise _refused(path, f"variable {letter} is a {kind}", "a numeric matrix")
            _bounded(path, letter, shape, None if kind == "sparse" else int(np.prod(shape)))
            wanted[letter] = kind
    loaded = _guarded(
        path,
        "a MATLAB file of version 5 to 7.2",
        lambda: io.loadmat(str(path), variable_names=list(wanted)) if wanted else {},
    )
    return {letter: _checked(loaded.get(letter), letter, path) for letter in wanted}


def read_npz(path: Path) -> dict[str, Matrix]:
    """Matrices of a numpy archive by letter, dense or in sparse parts; nothing is unpickled.

    Raises
    ------
    UsageError : missing, damaged, with Python objects, or parts that make no matrix.
    """
    _existing(path)
    expected = "a numpy archive without Python objects"

    def load() -> dict[str, np.ndarray]:
        with zipfile.ZipFile(path) as archive:
            unpacked = sum(item.file_size for item in archive.infolist())
        if unpacked > MAX_BYTES:
            raise _refused(path, f"{unpacked:.3g} bytes unpacked", f"at most {MAX_BYTES:.3g}")
        with np.load(path, allow_pickle=False) as archive:
            return {key: archive[key] for key in archive.files if key.split(".")[0] in LETTERS}

    arrays = _guarded(path, expected, load)
    found = {}
    for letter in LETTERS:
        parts = {
            key.partition(".")[2]: a for key, a in arrays.items() if key.split(".")[0] == letter
        }
        if parts:
            matrix = parts[""] if "" in parts else _sparse(path, letter, parts)
            found[letter] = _checked(matrix, letter, path)
    return found


def _matrix_market(path: Path, letter: str) -> Matrix:
    expected = "a Matrix Market file, 'coordinate' or 'array', 'real' or 'integer'"
    rows, columns, entries, form, field, _ = _guarded(path, expected, lambda: io.mminfo(str(path)))
    if field not in ("real", "double", "integer", "unsigned-integer"):
        raise _refused(path, f"a {field} matrix", "a real one")
    _bounded(path, letter, (rows, columns), entries if form == "coordinate" else rows * columns)
    stored = entries if form == "coordinate" else rows * columns // 2
    if path.suffix == f".{letter}" and 2 * stored > path.stat().st_size:
        raise _refused(path, f"{path.stat().st_size} bytes", f"{stored} entries: it is cut off")
    return _checked(_guarded(path, expected, lambda: io.mmread(str(path))), letter, path)


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
