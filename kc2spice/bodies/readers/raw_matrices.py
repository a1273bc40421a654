"""Content of matrix files: matrices keyed by letter, and the nodes of their rows.

The functions of this module read ``.npz`` archives and MATLAB files. Archives are read without
unpickling. Invalid sizes and indices are rejected before memory is allocated.

In an archive, each of the matrices M, E, K, A, B, C and D is a dense array or a sparse matrix. The
dense array of matrix K, for example, has the name ``K``. The sparse matrix K consists of the arrays
``K.format``, ``K.shape``, ``K.data``, ``K.indices`` and ``K.indptr``. In the sparse format coo, the
arrays ``K.row`` and ``K.col`` replace ``K.indices`` and ``K.indptr``. After the prefix ``K.``, the
array names are the names that ``scipy.sparse.save_npz`` writes. The integer arrays ``nodes`` (n,)
and ``dofs`` (n,) may contain the node and the degree of freedom of each row. A reader that runs in
a separate process returns its arrays under the names that are used in an ``.npz`` archive. MATLAB
files are read in a separate process, because scipy's reader may crash on a corrupt file.

A MATLAB file contains either variables with the same names as the arrays of an ``.npz`` archive, or
one struct that COMSOL's ``mphmatrix`` or ``mphstate`` returned. The equation of ``mphmatrix`` is
``E u'' + D u' + K u = L``: ``E`` is the mass, ``D`` the damping, and ``L`` the input matrix ``B``.
The matrices ``Ec``, ``Dc``, ``Kc`` and ``Lc``, from which constraints are eliminated, are
preferred. The state equation of ``mphstate`` is ``Mc x' = MA x + MB u`` or ``x' = A x + B u``. The
output equation of ``mphstate`` is ``y = C x + D u``.
"""

from __future__ import annotations

import re
import zipfile
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from scipy import io, sparse

from kc2spice.core import untrusted_files
from kc2spice.core.errors import Kc2spiceError, UsageError
from kc2spice.core.files import suggest_file
from kc2spice.core.untrusted_files import call_in_child
from kc2spice.rom.io import complete_triangle
from kc2spice.rom.pencil import Matrix

LETTERS = ("M", "E", "K", "A", "B", "C", "D")
# matrices of inputs and outputs, which have few rows or columns and are stored as dense arrays
NARROW_MATRICES = ("B", "C", "D")
MAX_ROWS = 5_000_000  # largest number of rows or columns of a matrix
MAX_ENTRIES = 200_000_000  # largest number of stored entries of one matrix
MAX_DENSE = 50_000_000  # largest number of entries of a dense matrix
MAX_NARROW_ENTRIES = 25_000_000  # largest number of entries of B, C or D as a dense matrix
MAX_BYTES = 4_000_000_000  # bytes, largest size of a packed or unpacked file
# Largest size of an unpacked file: a size [bytes] or a multiple of the packed size, whichever is
# larger.
UNPACKED_LIMITS = 100_000_000, 100
REDO_HINT = "export the file again; kc2spice reduce --help lists the formats"
# Messages of Python, numpy and zipfile as regular expressions, and what is wrong with the file.
_PARSER_MESSAGES = {
    r"could not convert string to (?:float|complex): (.+)": r"\1 is not a number",
    r"invalid literal for int\(\) with base \d+: b?(.+)": r"\1 is not a whole number",
    r"File is not a zip file": "its content is not an archive of numpy.savez",
}
_BOM = b"\xef\xbb\xbf"

# Names of degrees of freedom, keyed by number. The numbers 1 to 6 are the same in all programs.
# Abaqus or kc2spice defines the meaning of the degree-of-freedom numbers 0 and 7 to 43.
DOFS = {
    0: "scalar", 1: "ux", 2: "uy", 3: "uz", 4: "rx", 5: "ry", 6: "rz", 7: "warp", 8: "pres",
    9: "volt", 11: "temp", 12: "conc", 13: "mag", 14: "emf", 15: "curr", 21: "ax", 22: "ay",
    23: "az", 31: "vx", 32: "vy", 33: "vz", 41: "enke", 42: "ends", 43: "hdsp",
}  # fmt: skip
DOF_NUMBERS = {name: code for code, name in DOFS.items()}
TRANSLATIONS = (1, 2, 3)
ROTATIONS = (4, 5, 6)
VOLT = DOF_NUMBERS["volt"]
# The key of a matrix row is _KIND_COUNT times the node number, plus the number of the degree of
# freedom.
_KIND_COUNT = 64
_LARGEST_NODE = 2**40

Triple: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]
T = TypeVar("T")


# --- rejected files ---


def make_unusable_file_error(
    path: Path,
    got: object,
    expected: str,
    hint: str = REDO_HINT,
    problem: str = "the content of this file cannot be used",
) -> UsageError:
    """Make the error for a file whose content cannot be used.

    ``got`` describes the content of the file, and ``expected`` the content that is accepted.
    """
    return UsageError(problem, where=str(path), got=got, expected=expected, hint=hint)


def is_file(path: Path) -> bool:
    """Return whether ``path`` is an existing file.

    The function returns False for invalid paths, such as a path with a NUL character.
    """
    try:
        return path.is_file()
    except (ValueError, OSError):
        return False


def make_missing_error(path: Path, file_kind: str, suffixes: Sequence[str] = ()) -> UsageError:
    """Return the error for a missing file; the error names the expected kind of file.

    With ``suffixes``, the error suggests only existing files with one of these suffixes.
    """
    where = str(path).replace("\0", "\\0")
    folder = "this folder" if path.parent == Path() else f"the folder {path.parent}"
    hint = suggest_file(path, suffixes) or f"copy {path.name} into {folder}"
    return UsageError("this file does not exist", where=where, expected=file_kind, hint=hint)


def require_file(
    path: Path, what: str = "a model in this file", suffixes: Sequence[str] = ()
) -> Path:
    """Return the path of a model file; raise an error if it is missing or too large.

    ``what`` is the kind of file in the error message, and ``suffixes`` are its usual suffixes.

    Raises
    ------
    UsageError : the file does not exist, or has more than :data:`MAX_BYTES` bytes.
    """
    if not is_file(path):
        raise make_missing_error(path, what, suffixes)
    size = path.stat().st_size
    if size > MAX_BYTES:
        hint = "save the matrices as sparse matrices"
        raise make_unusable_file_error(path, f"{size} bytes", f"at most {MAX_BYTES:.3g}", hint)
    return path


def limit_unpacked_bytes(path: Path) -> int:
    """Return the largest permitted size [bytes] of the unpacked content of a file."""
    least, times = UNPACKED_LIMITS
    return min(MAX_BYTES, max(least, times * require_file(path).stat().st_size))


def parse_file(path: Path, expected: str, parse: Callable[[bytes], T]) -> T:
    """Read a file and parse its bytes; convert exceptions to errors about the file.

    A UTF-8 byte order mark is removed from the bytes. Exceptions of ``parse`` are converted by
    :func:`call_reader`.
    """
    data = require_file(path).read_bytes().removeprefix(_BOM)
    return call_reader(path, expected, lambda: parse(data))


def call_reader(path: Path, expected: str, read: Callable[[], T], advice: str = REDO_HINT) -> T:
    """Call a reader of a file, and convert its exceptions to errors about the file.

    ``expected`` describes the accepted content of the file, and ``advice`` is the hint for a
    damaged file. If an error contains no location, the path of the file is added.
    """
    try:
        return read()
    except Kc2spiceError as error:
        error.where = error.where or str(path)
        raise
    except NotImplementedError:
        message = "the format of this file is not supported"
        hint = "in MATLAB: save(..., '-v7')"
    except Exception as error:  # damaged bytes cause nearly any exception in the parsers
        reason = _explain_parser_message(" ".join(str(error).split()))[:160] or type(error).__name__
        message = f"this file cannot be read: {reason}"
        hint = getattr(error, "advice", advice)
    raise UsageError(message, where=str(path), expected=expected, hint=hint)


def _explain_parser_message(reason: str) -> str:
    """Replace the error message of a Python parser by a statement about the file."""
    for pattern, text in _PARSER_MESSAGES.items():
        reason = re.sub(pattern, text, reason)
    return reason


def require_size(path: Path, letter: str, shape: tuple[int, ...], entries: int | None) -> None:
    """Reject a matrix whose declared size is too large, before memory is allocated.

    ``entries`` is the number of stored entries, or None if the number is unknown.

    Raises
    ------
    UsageError : the matrix is not two-dimensional, or has more rows or entries than the limits of
        this module permit.
    """
    shape = tuple(map(int, shape))
    what = f"matrix {letter} of {' x '.join(map(str, shape))}"
    if len(shape) != 2:
        hint = f"save matrix {letter} as an array of rows and columns"
        raise make_unusable_file_error(path, what, "2 dimensions", hint)
    if max(shape) > MAX_ROWS or min(shape) < 0:
        raise make_unusable_file_error(path, what, f"at most {MAX_ROWS} rows and columns")
    square = letter in "CD" and shape[0] == shape[1]  # the damping matrix is often named C or D
    if letter in NARROW_MATRICES and not square and shape[0] * shape[1] > MAX_NARROW_ENTRIES:
        raise make_unusable_file_error(
            path,
            what,
            f"few inputs or outputs, at most {MAX_NARROW_ENTRIES} numbers",
            f"save only the {'columns' if letter == 'B' else 'rows'} of {letter} that you need",
        )
    limit = MAX_DENSE if entries == shape[0] * shape[1] else MAX_ENTRIES
    if entries is not None and not 0 <= entries <= limit:
        raise make_unusable_file_error(
            path, f"{entries} entries in matrix {letter}", f"at most {limit}"
        )


def require_matrix(matrix: Any, letter: str, path: Path) -> Matrix:
    """Convert a matrix to double precision, and raise an error if it is invalid.

    B, C and D become dense arrays of at most :data:`MAX_NARROW_ENTRIES` entries, and all other
    matrices become sparse csc arrays. Only the stiffness matrix K may be complex.

    Raises
    ------
    UsageError : the matrix is too large or not numeric, contains numbers that are not finite, or
        contains complex numbers although it is not K.
    """
    # indices of the coo format need no check, because the constructor of coo arrays checks them
    if sparse.issparse(matrix) and matrix.format in ("csc", "csr"):
        call_reader(path, f"a valid matrix {letter}", lambda: matrix.check_format(True))
    matrix = drop_zero_imaginary(matrix)
    data = matrix.data if sparse.issparse(matrix) else matrix
    if data.dtype.kind not in ("fiubc" if letter == "K" else "fiub"):
        what = "complex" if data.dtype.kind == "c" else f"of type {data.dtype}"
        hint = (
            "only a stiffness may be complex, K (1 + j eta)"
            if data.dtype.kind == "c"
            else REDO_HINT
        )
        raise make_unusable_file_error(
            path, f"matrix {letter} is {what}", "a real numeric matrix", hint
        )
    require_size(path, letter, matrix.shape, data.size)
    if not np.isfinite(data).all():
        raise make_unusable_file_error(
            path, f"matrix {letter} contains NaN or infinity", "finite numbers"
        )
    # a larger square C or D can only be a damping matrix, and stays sparse
    if letter in NARROW_MATRICES and matrix.shape[0] * matrix.shape[1] <= MAX_NARROW_ENTRIES:
        plain = matrix.toarray() if sparse.issparse(matrix) else matrix
        return np.asarray(plain, dtype=float)
    matrix = sparse.csc_array(matrix, dtype=complex if data.dtype.kind == "c" else float)
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    return matrix


# --- accepted files ---


@dataclass(frozen=True, eq=False)
class Dofs:
    """Node number and degree of freedom of each matrix row.

    ``node`` and ``kind`` are arrays of integers of shape (n,). ``kind`` identifies the degree of
    freedom of each matrix row by a number that is a key of :data:`DOFS`.

    Raises
    ------
    ValueError : a node number or the number of a degree of freedom is not an integer, or its
        magnitude is 2^40 or more.
    """

    node: np.ndarray
    kind: np.ndarray

    def __post_init__(self) -> None:
        for name in ("node", "kind"):
            labels = np.asarray(getattr(self, name))
            if not (labels == np.floor(labels)).all() or (abs(labels) >= _LARGEST_NODE).any():
                raise ValueError("the number of a node or of its degree of freedom is missing")
            object.__setattr__(self, name, labels.astype(np.int64))
        strange = ~np.isin(self.kind, list(DOFS))
        if self.node.shape != self.kind.shape or strange.any():
            raise ValueError(
                f"unknown degree of freedom {', '.join(map(str, self.kind[strange][:1]))}"
            )

    def __len__(self) -> int:
        return len(self.node)

    def encode_rows(self) -> np.ndarray:
        """Return one integer per matrix row that encodes node and degree of freedom."""
        return np.asarray(self.node * _KIND_COUNT + self.kind)


@dataclass(frozen=True, eq=False)
class RawMatrices:
    """Matrices of a model as read from its files, before any conversion.

    Parameters
    ----------
    matrices : matrices, keyed by letter
    dofs : node and degree of freedom of each row, or None if the files do not contain them
    fixed : indices of the rows that the exporting program fixed
    files : path of the file of each matrix, keyed by letter, if the matrices are in separate files
    unknown : shapes of the arrays in the file that have an unknown name, keyed by name
    """

    matrices: Mapping[str, Matrix]
    dofs: Dofs | None = None
    fixed: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    files: Mapping[str, Path] = field(default_factory=dict)
    unknown: Mapping[str, tuple[int, ...]] = field(default_factory=dict)


def encode_entry_positions(table: np.ndarray) -> Triple:
    """Encode each entry's row and column, given by node and dof, as two integers.

    ``table`` contains a line (node, dof, node, dof, value) for each entry. A ``dof`` is the number
    of a degree of freedom. Return the encoded rows, the encoded columns and the entry values.
    """
    place = table[:, :4].real
    row, column = Dofs(*place[:, :2].T), Dofs(*place[:, 2:].T)
    return row.encode_rows(), column.encode_rows(), table[:, 4]


def make_matrices_by_letter(
    triples: Mapping[str, Triple],
) -> tuple[dict[str, sparse.csc_array], Dofs]:
    """Make a sparse matrix for each letter, such as M or K, from lists of entries.

    ``triples`` contains the entries of each matrix as returned by :func:`encode_entry_positions`,
    keyed by letter. Return the matrices, keyed by letter, and the node and degree of freedom of
    each row. The rows of all matrices are in the same order. Rows are sorted by node, then by
    degree of freedom. Nodes and degrees of freedom without entries have no rows.
    """
    rows, columns, _ = zip(*triples.values(), strict=True)
    keys = np.unique(np.concatenate([*rows, *columns]))
    shape = (len(keys), len(keys))
    result = {}
    for letter, (row, column, value) in triples.items():
        place = (np.searchsorted(keys, row), np.searchsorted(keys, column))
        result[letter] = sparse.csc_array((value, place), shape=shape)
    return result, Dofs(keys // _KIND_COUNT, keys % _KIND_COUNT)


def complete_triangles(matrix: sparse.csc_array) -> sparse.csc_array:
    """Complete a symmetric matrix of which one entry of each mirrored pair is stored.

    Of each pair of mirrored entries, ``matrix`` contains either the entry above or the entry below
    the diagonal. A matrix is returned unchanged if it contains both entries of at least one
    mirrored pair.
    """
    below = abs(sparse.tril(matrix, -1, format="csc")) > 0
    above = abs(sparse.triu(matrix, 1, format="csc")) > 0
    return matrix if below.multiply(above.T).nnz else complete_triangle(matrix)


_ROW_LABELS = ("nodes", "dofs")  # names of the arrays that identify the rows
_UNKNOWN = "unknown"  # prefix of the arrays that contain the shapes of unknown matrices
# Permitted CPU time of a separate process: a fixed time [s], plus file size / data rate [bytes/s].
_CPU_LIMITS = 8, 1_000_000
# permitted memory [bytes] of a separate process, in addition to the content of the file
_MEMORY_BYTES = 1_300_000_000
_NON_NUMERIC_CLASSES = ("cell", "object", "char", "function", "opaque")
# Fields of the structs of `mphstate` and of `mphmatrix`, keyed by letter.
# For each letter, the first existing field is used.
_STATE_FIELDS = {"E": ("Mc",), "A": ("MA", "A"), "B": ("MB", "B"), "C": ("C",), "D": ("D",)}
_SECOND_ORDER_FIELDS = {"M": ("Ec", "E"), "E": ("Dc", "D"), "K": ("Kc", "K"), "B": ("Lc", "L")}


def read_matrix_archive(path: Path, requested: Mapping[str, str]) -> RawMatrices:
    """Read the matrices in the ``.npz`` archive at ``path``.

    ``requested`` maps matrix letters, such as K, to the names of matrices in the archive, for
    matrices whose name is not the letter.

    Raises
    ------
    UsageError, ValueError : the file is missing, damaged or too large, contains Python objects, or
        lacks a part of a sparse matrix.
    """
    sources = _locate_matrices(requested, path)
    known = {*sources.values(), *_ROW_LABELS}

    def is_known(name: str) -> bool:
        """Return whether an array in the archive belongs to a matrix with a known name."""
        return name.partition(".")[0] in known

    def get_size_limit(name: str) -> int:
        """Return the largest permitted number of values in an archive array."""
        return MAX_DENSE if name in known else MAX_ENTRIES

    arrays = untrusted_files.read_archive(
        path, is_known, entries=get_size_limit, total=limit_unpacked_bytes(path)
    )
    present = {key.partition(".")[0] for key in arrays}
    _require_names(requested, present, _list_member_names(path), path)
    if not present & {*sources.values()}:
        raise _make_unknown_names_error(path)
    targets = defaultdict(list, {name: [name] for name in _ROW_LABELS})
    for letter, name in sources.items():
        targets[name].append(letter)
    result: dict[str, np.ndarray] = {}
    for key, array in arrays.items():
        name, dot, part = key.partition(".")
        result |= {f"{target}{dot}{part}": array for target in targets[name]}
    return replace(_unpack_raw(result, path), unknown=_list_unknown_shapes(path, known))


def _list_unknown_shapes(path: Path, known: Collection[str]) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the matrices in an ``.npz`` archive whose name is not known.

    The shape of a sparse matrix is the content of one of its arrays, such as ``G.shape``.
    """
    shapes = untrusted_files.read_shapes(path)
    result = {}
    for key, shape in shapes.items():
        name, _, part = key.partition(".")
        if name in known or name in LETTERS:
            continue
        if not part:
            result[name] = shape
        elif part == "shape" and shape == (2,):
            rows, columns = untrusted_files.read_archive(
                path, key.__eq__, entries=lambda _: 2, total=limit_unpacked_bytes(path)
            )[key]
            result[name] = int(rows), int(columns)
    return result


def _locate_matrices(requested: Mapping[str, str], path: Path) -> dict[str, str]:
    """Return the name of each matrix inside a file, keyed by letter.

    ``requested`` contains the names of the matrices whose name is not the letter.

    Raises
    ------
    UsageError : ``requested`` contains the letter H, which only Nastran files may contain.
    """
    if "H" in requested:
        raise UsageError(
            "the matrix H of structural damping is read only from OP4 and punch files",
            where=str(path),
            got=f'matrices = {{ H = "{requested["H"]}" }}',
            expected=f"the letters {', '.join(LETTERS)}",
            hint="save the complex matrix K + 1j * H as K, and delete H from `matrices`",
        )
    return {letter: requested.get(letter, letter) for letter in LETTERS}


def _require_names(
    requested: Mapping[str, str], present: Collection[str], contained: Collection[str], path: Path
) -> None:
    """Reject a requested name that belongs to no matrix of the file.

    Raises
    ------
    UsageError : a name in ``requested`` is not in ``present``.
    """
    for name in requested.values():
        if name not in present:
            listed = [item for item in contained if item not in _ROW_LABELS]
            raise UsageError(
                f"the file contains no matrix {name}",
                where=str(path),
                got=name,
                expected=f"one of {', '.join(listed[:5])}" if listed else "a file with matrices",
                hint="correct this name in the TOML file, or add the matrix to the file",
            )


def _make_unknown_names_error(path: Path) -> UsageError:
    """Make the error for an archive that contains no matrix with a known name."""
    contained = _list_member_names(path)
    lower = {name.lower(): name for name in contained}
    renamed = {letter: lower[letter.lower()] for letter in LETTERS if letter.lower() in lower}
    names = ", ".join(f'{letter} = "{name}"' for letter, name in renamed.items())
    hint = 'name the matrices in the TOML file, such as  matrices = { K = "stiffness" }'
    if names:
        hint = f"write  matrices = {{ {names} }}  into {path.stem}.toml"
    return UsageError(
        "this file contains no matrix with a known name",
        where=str(path),
        got=", ".join(contained[:5]) or "an empty archive",
        expected=f"matrices with the names {', '.join(LETTERS)}",
        hint=hint,
    )


def _list_member_names(path: Path) -> list[str]:
    """Return the names of the matrices in an ``.npz`` archive.

    The arrays of a sparse matrix count as one matrix.
    """
    with zipfile.ZipFile(path) as archive:
        members = (item.filename.removesuffix(".npy") for item in archive.infolist())
        return list(dict.fromkeys(name.partition(".")[0][:40] for name in members))


def call_in_process(
    function: Callable[..., object], path: Path, **options: object
) -> dict[str, np.ndarray]:
    """Call ``function`` in a process with limited memory and time; return its arrays.

    The call is ``function(path, **options)``. The permitted memory and CPU time of the separate
    process depend on the size of the file.

    Raises
    ------
    UsageError, ValueError : the file is missing or too large, or the process fails for another
        reason.
    MissingToolError : the function needs a package that is not installed.
    """
    memory = _MEMORY_BYTES + 2 * limit_unpacked_bytes(path)
    seconds = _CPU_LIMITS[0] + path.stat().st_size // _CPU_LIMITS[1]
    request = {"path": str(path.absolute()), **options}
    name = f"{function.__module__}:{function.__name__}"
    return call_in_child(name, request, memory=memory, seconds=seconds)


def make_isolated_reader(
    function: Callable[..., object],
) -> Callable[[Path, Mapping[str, str]], RawMatrices]:
    """Make a file reader that calls ``function`` in a separate process."""
    return lambda path, requested: _unpack_raw(
        call_in_process(function, path, requested=dict(requested)), path
    )


def pack_matrix(name: str, matrix: Any) -> dict[str, np.ndarray]:
    """Convert a matrix or an array of row labels to arrays for an ``.npz`` archive."""
    if not sparse.issparse(matrix):
        return {name: np.asarray(matrix)}
    csc = matrix.tocsc()
    parts = {f"{name}.{key}": getattr(csc, key) for key in ("data", "indices", "indptr")}
    return {**parts, f"{name}.shape": np.array(csc.shape), f"{name}.format": np.array("csc")}


def _unpack_raw(arrays: Mapping[str, np.ndarray], path: Path) -> RawMatrices:
    """Convert the arrays of an ``.npz`` archive to matrices and row labels."""
    parts: dict[str, dict[str, np.ndarray]] = defaultdict(dict)
    for key, array in arrays.items():
        name, _, part = key.partition(".")
        parts[name][part] = array
    result = {}
    for letter in LETTERS:
        if "" in parts[letter]:
            result[letter] = parts[letter][""]
        elif parts[letter]:
            result[letter] = _unpack_sparse(path, letter, parts[letter])
    return RawMatrices(
        result,
        _unpack_dofs(arrays),
        arrays.get("fixed", np.empty(0, dtype=np.int64)),
        unknown={name: tuple(map(int, shape)) for name, shape in parts[_UNKNOWN].items()},
    )


def _unpack_sparse(path: Path, letter: str, parts: dict[str, np.ndarray]) -> sparse.sparray:
    """Build a sparse matrix from its arrays in an archive."""
    kind = str(parts["format"].item()) if "format" in parts else "coo"
    kind = kind.removeprefix("b'").removesuffix("'")
    rows, columns = map(int, parts["shape"])
    require_size(path, letter, (rows, columns), parts["data"].size)
    if kind == "coo":
        inner = (parts["data"], (parts["row"], parts["col"]))
        return sparse.coo_array(inner, shape=(rows, columns))
    maker = {"csc": sparse.csc_array, "csr": sparse.csr_array}[kind]
    return maker((parts["data"], parts["indices"], parts["indptr"]), shape=(rows, columns))


def _unpack_dofs(arrays: Mapping[str, np.ndarray]) -> Dofs | None:
    """Return node and degree of freedom of each row, or None if both are missing."""
    present_arrays = [np.asarray(arrays[name]).ravel() for name in _ROW_LABELS if name in arrays]
    if not present_arrays:
        return None
    if len(present_arrays) == 1 or any(array.dtype.kind not in "iu" for array in present_arrays):
        raise ValueError("nodes and dofs do not contain one integer for each row")
    return Dofs(*present_arrays)


# --- MATLAB ---------------------------------------------------------------------------------------


def unpack_matlab(path: str, requested: dict[str, str]) -> dict[str, np.ndarray]:
    """Return the matrices in a MATLAB file as arrays for an ``.npz`` archive.

    ``requested`` maps matrix letters, such as K, to the names of variables in the file, for
    matrices whose name is not the letter. The shapes of the other numeric variables are also
    returned.

    Raises
    ------
    UsageError : the file does not contain a requested variable.
    ValueError, NotImplementedError : the file is damaged, or does not contain matrices.
    """
    sources = _locate_matrices(requested, Path(path)) | {name: name for name in _ROW_LABELS}
    kinds = _list_variables(path)
    _require_names(requested, kinds, kinds, Path(path))
    plain = list(filter(kinds.__contains__, dict.fromkeys(sources.values())))
    structs = [name for name, (_, kind) in kinds.items() if kind == "struct"]
    parts: dict[str, np.ndarray] = {}
    if not set(plain) - set(_ROW_LABELS) and len(structs) == 1:
        result = _select_fields(
            io.loadmat(path, appendmat=False, variable_names=structs)[structs[0]], structs[0]
        )
    else:
        for name in plain:
            if kinds[name][1] in (*_NON_NUMERIC_CLASSES, "struct"):
                raise ValueError(f"variable {name} is a {kinds[name][1]}, not a numeric matrix")
        full = [kinds[name][0] for name in plain if kinds[name][1] != "sparse"]
        loaded = _load_variables(path, plain, full)
        result = {key: loaded[name] for key, name in sources.items() if name in loaded}
        for name, (shape, kind) in kinds.items():
            numeric = kind not in (*_NON_NUMERIC_CLASSES, "struct")
            if numeric and name not in {*sources, *sources.values()}:
                parts[f"{_UNKNOWN}.{name}"] = np.array(shape)
    for name in sources:
        if name in result:
            parts |= pack_matrix(name, _convert_matlab_matrix(name, result[name]))
    return parts


def read_vectors(path: str) -> dict[str, np.ndarray]:
    """Read the dense numeric arrays in a MATLAB file with a measured response.

    Return the arrays, keyed by name. The returned mapping is empty if the file contains the
    matrices of a model.

    Raises
    ------
    ValueError, NotImplementedError : the file is damaged.
    """
    kinds = _list_variables(path)
    numbers = ("double", "single", "int8", "int16", "int32", "uint8", "uint16", "uint32")
    plain = [name for name, (_, kind) in kinds.items() if kind in numbers]
    if {"M", "K", "A"} & set(kinds):
        return {}
    result = _load_variables(path, plain, [kinds[name][0] for name in plain])
    return {name: np.asarray(result[name]) for name in plain if result[name].size}


def _list_variables(path: str) -> dict[str, tuple[tuple[int, ...], str]]:
    """Return the shape and class of each variable in a MATLAB file, keyed by name."""
    return {name: (shape, kind) for name, shape, kind in io.whosmat(path, appendmat=False)}


def _load_variables(path: str, names: list[str], full: list[tuple[int, ...]]) -> dict[str, Any]:
    """Load the variables ``names`` from a MATLAB file.

    ``full`` contains the shapes of the dense arrays among these variables.

    Raises
    ------
    ValueError : the dense arrays are too large.
    """
    size = sum(8 * np.prod(shape, dtype=float) for shape in full)
    limit = limit_unpacked_bytes(Path(path))
    if size > limit:
        raise ValueError(
            f"the variables of the file need {size:g} bytes; the limit is {limit:g} bytes"
        )
    return io.loadmat(path, appendmat=False, variable_names=names) if names else {}


def _convert_matlab_matrix(name: str, matrix: Any) -> Any:
    """Convert a MATLAB matrix to a sparse matrix or a dense array."""
    if sparse.issparse(matrix):
        return matrix.tocsc()
    matrix = drop_zero_imaginary(np.asarray(matrix))
    if name in _ROW_LABELS:  # by default, MATLAB saves integers as doubles
        if not (matrix == np.floor(matrix)).all():
            raise ValueError(f"variable {name} contains fractions instead of whole numbers")
        return matrix.astype(np.int64)
    return matrix


def drop_zero_imaginary(matrix: Any) -> Any:
    """Drop the imaginary part of a matrix if all its imaginary parts are zero."""
    data = matrix.data if sparse.issparse(matrix) else matrix
    return matrix.real if np.iscomplexobj(data) and not data.imag.any() else matrix


def _select_fields(value: Any, name: str) -> dict[str, Any]:
    """Return the matrices in the fields of a COMSOL struct, keyed by matrix letter."""
    if value.shape != (1, 1) or value.dtype.names is None:
        raise ValueError(f"struct {name} is an array of structs, not one struct")
    fields = {key: value[0, 0][key] for key in value.dtype.names}

    def select_matrices(table: Mapping[str, tuple[str, ...]]) -> dict[str, Any]:
        """Select for each matrix the first candidate field that the struct contains.

        ``table`` maps the letter of each matrix to the names of its candidate fields.
        """
        matrices = {}
        for letter, names in table.items():
            for first in filter(fields.__contains__, names):
                matrices[letter] = fields[first]
                break
        return matrices

    if "MA" in fields or ("A" in fields and "K" not in fields):
        return select_matrices(_STATE_FIELDS)
    if not {"K", "Kc"} & set(fields):
        raise ValueError(f"struct {name} has fields {', '.join(fields)}; K or Kc is needed")
    result = select_matrices(_SECOND_ORDER_FIELDS)
    if "Kc" not in fields and "N" in fields and _count_nonzeros(fields["N"]):
        raise ValueError(
            f"the constraints in the matrix N of struct {name} are not eliminated; export the "
            "eliminated matrices Kc and Ec"
        )
    if "Kc" in fields and "uscale" in fields and (np.asarray(fields["uscale"]) != 1).any():
        raise ValueError(
            f"struct {name} has scaled unknowns (uscale): set the scaling of the solver to None"
        )
    # A model without mass is a first-order model with the matrix E.
    # If a struct contains no loads, the TOML file defines the ports.
    empty = {letter for letter in {*"MEB"} & set(result) if not _count_nonzeros(result[letter])}
    if "M" not in result or "M" in empty:
        empty -= {"E"}
    for letter in empty:
        del result[letter]
    return result


def _count_nonzeros(matrix: Any) -> int:
    """Return the number of nonzero entries of a matrix."""
    return int(matrix.count_nonzero() if sparse.issparse(matrix) else np.count_nonzero(matrix))
