"""Reader and writer of model files: reduced models, and Matrix Market files.

A reduced model is one ``.npz`` file, or several Matrix Market files. For a damaged Matrix Market
file of another program, the functions of this module raise an error.

The function ``mmread`` of scipy 1.17 does not detect some errors: ``mmread`` reads Fortran's
``1.5D+3`` as 1.5. If both triangles of a symmetric matrix are stored, ``mmread`` doubles the
entries. For a symmetric array that is not square, ``mmread`` returns numbers that the file does not
contain. Therefore, this module compares every count with the content of the file, and every index
with the size of the matrix. Format: Boisvert, Pozo, Remington, NIST IR 5935 (1996).
"""

from __future__ import annotations

import json
import warnings
import zipfile
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from scipy import io, sparse

from kc2spice.core.errors import UsageError
from kc2spice.core.mesh_error_descriptions import select_mesh_errors
from kc2spice.core.untrusted_files import decode_text, read_archive, read_bounded
from kc2spice.rom.linear_model import Certificate, LinearModel, Port
from kc2spice.rom.pencil import Matrix

MARKET_BANNER = b"%%matrixmarket"
_MARKET_LAYOUTS = ("coordinate", "array")
# how many numbers represent one entry of a Matrix Market file, keyed by the type of the entries
_MARKET_FIELDS = {"real": 1, "double": 1, "integer": 1, "complex": 2}
_SYMMETRIES = ("general", "symmetric", "skew-symmetric")
# translation of Fortran's exponents D and d to E, and of commas to blanks
_FORTRAN_TRANSLATION = bytes.maketrans(b"Dd,", b"EE ")


def parse_matrix_market(data: bytes, allowed: Callable[[tuple[int, int], int], None]) -> Matrix:
    """Convert the content of a Matrix Market file to a matrix.

    The matrix is in CSC format for the layout 'coordinate', and dense for 'array'. Before memory is
    allocated, ``allowed(shape, entries)`` is called, which raises an error if the declared size is
    too large.

    Raises
    ------
    ValueError : the content is not a valid matrix, for example because of missing numbers or wrong
        indices, or the matrix is Hermitian.
    """
    end = data.find(b"\n", 0, 1000)
    banner = data[: max(end, 0)].decode("ascii", "replace").lower().split()
    if banner[:2] != ["%%matrixmarket", "matrix"] or len(banner) != 5:
        raise ValueError("the first line is not the header of a Matrix Market file")
    form, field, symmetry = banner[2:]
    if form not in _MARKET_LAYOUTS or symmetry not in _SYMMETRIES:
        raise ValueError(f"a matrix of type '{form} {symmetry}' is not supported")
    if field not in _MARKET_FIELDS:
        raise ValueError(f"a matrix of type '{field}' is not supported")
    sizes, start = _read_matrix_size(data, end + 1)
    if len(sizes) != (3 if form == "coordinate" else 2) or min(sizes) < 0:
        raise ValueError("the line with the matrix size is damaged")
    rows, columns = sizes[:2]
    if symmetry != "general" and rows != columns:
        raise ValueError(f"the {symmetry} matrix is not square: {rows} x {columns}")
    entries = sizes[2] if form == "coordinate" else _count_stored_entries(rows, columns, symmetry)
    allowed((rows, columns), entries)
    width = _MARKET_FIELDS[field] + (2 if form == "coordinate" else 0)
    count = width * entries
    if 2 * count > len(data) - start + 2:
        raise ValueError(
            f"{len(data)} bytes are too few for {entries} entries; the file may be truncated"
        )
    values = parse_numbers(data[start:])
    if values.size != count:
        raise ValueError(
            f"the file contains {values.size} numbers, not {count}; the file may be truncated"
        )
    table = values.reshape(-1, width)
    value = table[:, -1] if field != "complex" else table[:, -2] + 1j * table[:, -1]
    if form == "array":
        return _read_array(rows, columns, symmetry, value)
    return _read_coordinates(rows, columns, symmetry, table, value)


def _read_matrix_size(data: bytes, start: int) -> tuple[list[int], int]:
    """Return the numbers in the size line of a file, and the next line's position."""
    while start < len(data):
        end = data.find(b"\n", start)
        end = len(data) if end < 0 else end
        line = data[start:end].strip()
        start = end + 1
        if line and not line.startswith(b"%"):
            return list(map(int, line[:200].split())), start
    raise ValueError("the line with the matrix size is missing")


def _count_stored_entries(rows: int, columns: int, symmetry: str) -> int:
    """Return how many entries a Matrix Market file in 'array' format contains."""
    if symmetry == "general":
        return rows * columns
    return rows * (rows + 1) // 2 if symmetry == "symmetric" else rows * (rows - 1) // 2


def _read_coordinates(
    rows: int, columns: int, symmetry: str, table: np.ndarray, value: np.ndarray
) -> Matrix:
    """Return the matrix of a Matrix Market file in 'coordinate' format."""
    row, column = parse_indices(table[:, 0], rows), parse_indices(table[:, 1], columns)
    matrix = sparse.csc_array((value, (row, column)), shape=(rows, columns))
    if symmetry == "general":
        return matrix
    skew = symmetry != "symmetric"
    if (row < column).any() or (skew and (row == column).any()):
        raise ValueError(f"an entry of the {symmetry} matrix is not in the lower triangle")
    return complete_triangle(matrix, -1 if skew else 1)


def _read_array(rows: int, columns: int, symmetry: str, values: np.ndarray) -> Matrix:
    """Return the matrix of a Matrix Market file in 'array' format."""
    if symmetry == "general":
        return values.reshape(columns, rows).T.copy()
    skew = symmetry != "symmetric"
    upper = np.zeros((rows, rows), dtype=values.dtype)
    # the file contains the columns of the lower triangle
    upper[np.triu_indices(rows, k=int(skew))] = values
    return upper.T - upper if skew else upper.T + np.triu(upper, 1)


# --- functions for readers of other text formats -----------------------------------------------


def parse_numbers(text: bytes) -> np.ndarray:
    """Parse numbers that are separated by blanks or commas, in linear time.

    Numbers may have Fortran's form ``1.5D+3``.

    Raises
    ------
    ValueError : an item is not a number.
    """
    if not text.strip():
        return np.empty(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # for a damaged text, numpy only prints a warning
        try:
            return np.fromstring(text.translate(_FORTRAN_TRANSLATION), dtype=float, sep=" ")
        except (DeprecationWarning, ValueError):
            raise ValueError("an entry of the matrix is not a number") from None


def parse_indices(values: np.ndarray, size: int) -> np.ndarray:
    """Convert indices that begin at 1 to integer indices that begin at 0.

    Raises
    ------
    ValueError : an index is not a whole number from 1 to ``size``.
    """
    sound = (values >= 1) & (values <= size) & (values == np.floor(values))
    if not sound.all():
        raise ValueError(f"the index {values[~sound][0]:g} is not a whole number from 1 to {size}")
    return values.astype(np.int64) - 1


def complete_triangle(matrix: sparse.csc_array, sign: int = 1) -> sparse.csc_array:
    """Complete a stored triangle to a symmetric matrix (``sign`` -1: skew-symmetric)."""
    diagonal = sparse.diags_array(matrix.diagonal(), format="csc")
    return sparse.csc_array(matrix + sign * matrix.T - sign * diagonal)


MAX_FILE_BYTES = 1_000_000_000
MAX_ENTRIES = 50_000_000  # largest number of entries of one matrix
MAX_TEXT_LENGTH = 64  # largest number of characters of a name or unit
_EXPECTED_FILE = "the .npz file that kc2spice reduce wrote, or the .json file beside its matrices"
REDUCE_HINT = "run kc2spice reduce MODEL, which writes NAME_rom/NAME_rom.npz"
_RECORD_NAME = "record"  # name of the JSON text in an archive


def write_rom(model: LinearModel, directory: Path, name: str) -> list[str]:
    """Write a reduced model to ``name.npz``, ``name.json`` and Matrix Market files.

    The Matrix Market files, such as ``name.M``, contain numbers with 17 digits. ``name.json``
    contains ports, certificate and error estimates of the mesh, for other programs that read the
    Matrix Market files. Return the file names, the ``.npz`` file first.
    """
    letters = _list_matrix_letters(model.first_order)
    matrices = {letter: getattr(model, letter) for letter in letters}
    content = {
        "ports": list(map(asdict, model.ports)),
        "certificate": asdict(require_certificate(model.certificate, model.name)),
        "facts": select_mesh_errors(model.facts),
    }
    files = write_archive(directory, name, matrices, content)
    for letter, matrix in matrices.items():
        with (directory / f"{name}.{letter}").open("wb") as stream:
            io.mmwrite(stream, matrix, precision=17, symmetry="general")
    return [*files, *(f"{name}.{letter}" for letter in letters)]


def require_rom_file(path: Path) -> None:
    """Raise an error if the ``path`` of a reduced model is not a file."""
    if not path.is_file():
        raise UsageError(
            "this path is a directory" if path.is_dir() else "this file does not exist",
            where=str(path),
            expected=_EXPECTED_FILE,
            hint=next((f"write {archive}" for archive in sorted(path.glob("*.npz"))), REDUCE_HINT),
        )


def read_rom(path: Path | str) -> LinearModel:
    """Read a reduced model that :func:`write_rom` wrote.

    ``path`` is the path of the ``.npz`` file, the ``.json`` file, or any matrix file of the model.

    Raises
    ------
    UsageError : the file is missing or damaged, contains no reduced model, or contains numbers that
    are not finite.
    """
    path = Path(path)
    require_rom_file(path)
    if path.suffix not in (".npz", ".json", ".M", ".E", ".K", ".A", ".B", ".C", ".D"):
        raise UsageError(
            "this file is not a reduced model",
            where=str(path),
            got=f"a file that ends with {path.suffix or 'no suffix'}",
            expected=_EXPECTED_FILE,
            hint=REDUCE_HINT,
        )
    try:
        if path.suffix == ".npz":
            return _build_model(*read_arrays(path, "MEKABCD"))
        matrices, record = _read_rom_arrays(path)
        return _build_model(matrices, json.loads(record))
    except Exception as error:  # parsers of a damaged file can raise any exception
        raise make_damage_error(path, error) from None


def _read_rom_arrays(path: Path) -> tuple[dict[str, np.ndarray], str]:
    """Read the matrix files and the record of a reduced model."""
    base = path.with_suffix("")
    record = Path(f"{base}.json")
    matrices = {}
    for letter in "MEKABCD":
        file = Path(f"{base}.{letter}")
        if file.is_file():
            matrices[letter] = parse_matrix_market(
                read_bounded(file, MAX_FILE_BYTES), _require_loadable_size
            )
    return matrices, decode_text(read_bounded(record, MAX_FILE_BYTES))


def _require_loadable_size(shape: tuple[int, int], entries: int) -> None:
    """Reject a matrix with more than :data:`MAX_ENTRIES` entries."""
    if max(shape[0] * shape[1], entries) > MAX_ENTRIES:
        raise ValueError(
            f"a matrix of {shape[0]} x {shape[1]} with {entries} entries exceeds the limit of "
            f"{MAX_ENTRIES} entries"
        )


# --- functions for archives of parametric models ------------------------------------------------


def require_certificate(certificate: Certificate | None, name: str) -> Certificate:
    """Return the certificate of a reduced model; reject a model without one.

    Raises
    ------
    UsageError : the certificate is missing, because the model is not reduced.
    """
    if certificate is None:
        raise UsageError(
            "this file is not a reduced model",
            where=name,
            expected="a model that 'kc2spice reduce' wrote",
        )
    return certificate


def write_archive(
    directory: Path, name: str, arrays: Mapping[str, Any], record: Mapping[str, Any]
) -> list[str]:
    """Write arrays and a record to ``name.npz``, and only the record to ``name.json``.

    Return the names of both files.
    """
    text = json.dumps(record, indent=2)
    content: dict[str, Any] = {**arrays, _RECORD_NAME: np.array(text)}
    np.savez(directory / f"{name}.npz", **content)
    (directory / f"{name}.json").write_text(text + "\n", encoding="utf-8")
    return [f"{name}.npz", f"{name}.json"]


def read_arrays(path: Path, names: Iterable[str]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read the arrays and the record that :func:`write_archive` wrote.

    Raises
    ------
    Exception : parsers of a damaged file can raise any exception.
    """
    known = {_RECORD_NAME, *names}
    arrays = read_archive(
        path, known.__contains__, entries=lambda _: MAX_ENTRIES, total=MAX_FILE_BYTES
    )
    return arrays, json.loads(str(arrays.pop(_RECORD_NAME).item()))


def make_damage_error(path: Path, error: Exception) -> UsageError:
    """Make the error for a damaged file, or for a file without a reduced model."""
    reason = " ".join(str(error).split())[:120] or type(error).__name__
    hint = "run kc2spice reduce again"
    if isinstance(error, KeyError):
        kind = "an archive" if path.suffix == ".npz" else "a file"
        reason, hint = f"{kind} without the record of a reduced model", REDUCE_HINT
        if _contains_matrices(path):
            hint = f"run kc2spice reduce {path}, which writes {path.stem}_rom/{path.stem}_rom.npz"
    return UsageError(
        "this file is not a reduced model",
        where=str(path),
        got=reason,
        expected="a file that 'kc2spice reduce' wrote",
        hint=hint,
    )


def _contains_matrices(path: Path) -> bool:
    """Return whether an archive contains a matrix K or A, which every model has."""
    with suppress(OSError, zipfile.BadZipFile), zipfile.ZipFile(path) as archive:
        return not {"K", "A"}.isdisjoint(name.partition(".")[0] for name in archive.namelist())
    return False


def require_single_line(text: str, longest: int) -> str:
    """Return ``text``; reject a text that is too long or contains a line break.

    In a netlist, a line break would begin a new card.
    """
    if not text.isprintable() or len(text) > longest:
        raise ValueError(
            f"a text has a line break, or more than {longest} characters: {text[:40]!r}"
        )
    return text


def parse_ports(records: object) -> tuple[Port, ...]:
    """Make ports from JSON records; reject names and units invalid in netlists.

    Raises
    ------
    ValueError : the records do not describe ports, or a name or unit contains a blank.
    """
    from pydantic import TypeAdapter  # imported here, because most commands read no reduced model

    ports = TypeAdapter(tuple[Port, ...]).validate_python(records)
    words = chain.from_iterable((p.name, p.across, p.flow, *p.pins) for p in ports)
    stated = [record[key] for record in records for key in ("across", "flow") if key in record]  # type: ignore[attr-defined]
    for text in (*words, *stated):  # the class Port replaces an empty unit by a default
        if len(require_single_line(text, MAX_TEXT_LENGTH).split()) != 1:
            raise ValueError(f"a name or unit is empty or contains a blank: {text!r}")
    return ports


def parse_certificate(record: object) -> Certificate:
    """Make a certificate from a JSON record.

    Raises
    ------
    ValueError : the record does not describe a certificate, or a number is not finite.
    """
    from pydantic import TypeAdapter

    certificate = TypeAdapter(Certificate).validate_python(record)
    require_single_line(certificate.method, 1000)
    require_single_line(certificate.reduction_method, 1000)
    low, high = certificate.band_hz
    if not 0 <= low <= high < np.inf:
        raise ValueError(f"band {low} … {high} Hz")
    errors = [
        certificate.error_estimate,
        *(certificate.pointwise or ()),
        *chain(*certificate.above),
    ]
    if not np.isfinite(errors).all():
        raise ValueError(
            "the error estimates in the model file contain a number that is not finite"
        )
    return certificate


def _build_model(matrices: dict[str, Any], record: dict[str, Any]) -> LinearModel:
    """Check the matrices and JSON record of a file, and build a model from both."""
    from pydantic import TypeAdapter  # imported here, because most commands read no reduced model

    ports, certificate = parse_ports(record["ports"]), parse_certificate(record["certificate"])
    letters = _list_matrix_letters("A" in matrices)
    arrays: dict[str, Any] = {letter: np.asarray(matrices[letter]) for letter in letters}
    if any(array.dtype.kind != "f" for array in arrays.values()):
        raise ValueError("a matrix contains values that are not real numbers")
    facts = select_mesh_errors(
        TypeAdapter(dict[str, float]).validate_python(record.get("facts", {}))
    )
    if not np.isfinite([*facts.values()]).all():
        raise ValueError("the error estimate of the mesh is not finite")
    return LinearModel(ports=ports, certificate=certificate, facts=facts, **arrays)


def _list_matrix_letters(first_order: bool) -> str:
    """Return the letters that name the matrices in a model file, in file order."""
    return "EABCD" if first_order else "MEKBCD"
