"""Readers of the matrix formats of finite-element programs.

The command ``*MATRIX GENERATE`` of Abaqus writes ``JOB_STIF2.mtx``, ``JOB_MASS2.mtx`` and similar
files. With ``FORMAT=MATRIX INPUT`` (or ``LABELS``), an Abaqus file contains lines ``node, dof,
node, dof, value`` for one triangle of a matrix. With ``FORMAT=COORDINATE``, an Abaqus file contains
lines ``row column value`` for both triangles, but not the nodes of the rows. In an Abaqus stiffness
matrix, the diagonal entry of a degree of freedom that a boundary condition fixes is 1e36.

The command ``*FREQUENCY, SOLVER=MATRIXSTORAGE`` of CalculiX writes ``JOB.sti``, ``JOB.mas`` and
``JOB.dof``. Matrix files of CalculiX contain lines ``row column value``. The file ``JOB.dof``
contains ``node.direction`` for each row; the direction is 1 to 6, or 0 for temperature.

Ansys writes binary ``.full`` files, which are read by the package ansys-mapdl-reader. The command
``HBMAT`` of Ansys writes Harwell-Boeing files, and a file that maps rows to nodes. This module
parses Harwell-Boeing files, because scipy's ``hb_read`` rejects symmetric matrices. The fields of a
Harwell-Boeing file need not be separated by blanks. The header of a Harwell-Boeing file states the
widths of its fields (Duff, Grimes, Lewis, Users' Guide for the Harwell-Boeing Sparse Matrix
Collection, 1992).

Nastran writes punch files with DMIG cards, and OUTPUT4 files. This module parses punch files; the
package pyyeti reads OUTPUT4 files. Matrix names in Nastran files begin with ``K`` (stiffness),
``K4`` (structural damping), ``M`` (mass) or ``B`` (viscous damping). The key ``matrices`` in the
TOML file may state other matrix names. DMIG cards may have large, small or free fields (MSC Nastran
Quick Reference Guide).

Structural damping is the imaginary part H of a complex stiffness matrix ``K + j H``. Matrix files
contain H as the imaginary part of a complex matrix, or as a separate matrix: ``K4...`` in Nastran
files, or ``JOB_DMPS2.mtx`` of Abaqus.
"""

from __future__ import annotations

import cmath
import math
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from kc2spice.bodies.readers import raw_matrices
from kc2spice.core.optional_libraries import import_optional
from kc2spice.core.other_file_formats import identify_mesh, make_other_format_error
from kc2spice.rom.io import complete_triangle, parse_indices, parse_numbers

LOSS_LETTER = "H"  # letter of the structural damping matrix H in the complex stiffness K + j H
ABAQUS_NAME = re.compile(r"(.*)_(STIF|MASS|DMPV|DMPS)(\d*)\.mtx", re.IGNORECASE)
_ABAQUS_LETTERS = {"STIF": "K", "MASS": "M", "DMPV": "E", "DMPS": LOSS_LETTER}
_FIXED_STIFFNESS = 1e35  # smallest diagonal stiffness of a fixed degree of freedom in Abaqus files
_COMMENT_LINE = re.compile(rb"^\*.*\n?", re.MULTILINE)
_EXPECTED = "an .mtx file of *MATRIX OUTPUT, FORMAT=MATRIX INPUT or COORDINATE"
SUFFIXES = (".sti", ".mas", ".dof")  # extensions of the stiffness, mass and row files of CalculiX


def find_abaqus_files(path: Path) -> dict[str, Path]:
    """Return the Abaqus matrix files of one job and step, keyed by matrix letter.

    The returned files are keyed by matrix letter. Return no files if ``path`` is not the name of an
    Abaqus matrix file.
    """
    match = ABAQUS_NAME.fullmatch(path.name)
    if match is None:
        return {}
    result = {}
    for word, letter in _ABAQUS_LETTERS.items():
        for spelled in (word, word.lower()):
            other = path.with_name(f"{match[1]}_{spelled}{match[3]}{path.suffix}")
            if raw_matrices.is_file(other):
                result[letter] = other
    return result


def read_abaqus(files: dict[str, Path]) -> raw_matrices.RawMatrices:
    """Read the matrices of an Abaqus job.

    ``files`` contains the file of each matrix, keyed by letter.

    Raises
    ------
    UsageError : a file is damaged or too large, the files have different formats, or the matrices
        do not match.
    """
    tables, formats, dofs = dict[str, raw_matrices.Triple](), set[bool](), None
    for letter, path in files.items():
        labelled, tables[letter] = raw_matrices.parse_file(path, _EXPECTED, _parse_entries)
        formats.add(labelled)
    if len(formats) > 1:
        one = next(iter(files.values()))
        raise raw_matrices.make_unusable_file_error(
            one, "MATRIX INPUT and COORDINATE", "one format for all matrices"
        )
    if True in formats:
        result, dofs = raw_matrices.make_matrices_by_letter(tables)
        result = {
            letter: raw_matrices.complete_triangles(matrix) for letter, matrix in result.items()
        }
    else:
        n = 1 + max(int(np.max(table[:2])) for table in tables.values())
        result = {k: sparse.csc_array((v, (i, j)), (n, n)) for k, (i, j, v) in tables.items()}
    fixed = result["K"].diagonal() >= _FIXED_STIFFNESS if "K" in result else np.empty(0, dtype=bool)
    result = add_structural_loss(result)
    return raw_matrices.RawMatrices(result, dofs, np.flatnonzero(fixed))


def add_structural_loss(matrices: Mapping[str, Any]) -> dict[str, Any]:
    """Add a structural damping matrix H to the stiffness as ``K + j H``, if H exists.

    H is the structural damping matrix. The returned mapping does not contain the matrix H.

    Raises
    ------
    ValueError : K is missing, has another size, or is already complex.
    """
    result = dict(matrices)
    loss = result.pop(LOSS_LETTER, None)
    if loss is None:
        return result
    K = result.get("K")
    if K is None or K.shape != loss.shape or np.iscomplexobj(K) or np.iscomplexobj(loss):
        raise ValueError(
            "a structural damping matrix needs a stiffness matrix of equal size, and both "
            "matrices must be real"
        )
    return result | {"K": sparse.csc_array(K + 1j * loss)}


def _parse_entries(data: bytes) -> tuple[bool, raw_matrices.Triple]:
    """Parse the entries of an Abaqus matrix file as rows, columns and values.

    Return whether the lines contain nodes and degrees of freedom, and return the matrix entries. If
    the lines contain node numbers, :func:`encode_entry_positions` returns the row and column
    numbers. In lines without node numbers, the row and column numbers are indices counted from 0.
    """
    if data.startswith(b"*") or b"\n*" in data:
        data = _COMMENT_LINE.sub(b"", data)
    width = len(data.lstrip().split(b"\n", 1)[0].replace(b",", b" ").split())
    values = parse_numbers(data)
    if width not in (3, 5) or values.size == 0 or values.size % width:
        raise ValueError(
            f"{values.size} numbers do not fill rows of {width}; the file may be truncated"
            if width in (3, 5)
            else f"the first row has {width} numbers instead of 3 or 5"
        )
    table = values.reshape(-1, width)
    if width == 5:
        return True, raw_matrices.encode_entry_positions(table)
    return False, (
        parse_indices(table[:, 0], raw_matrices.MAX_ROWS),
        parse_indices(table[:, 1], raw_matrices.MAX_ROWS),
        table[:, 2],
    )


def read_calculix(path: Path, _: object) -> raw_matrices.RawMatrices:
    """Read the stiffness and mass matrices of a CalculiX job.

    ``path`` is any file of the job. The second argument of the function has no effect.

    Raises
    ------
    UsageError : a file is missing, damaged or too large, or the files do not match.
    """
    stiffness, mass, rows = map(path.with_suffix, SUFFIXES)
    for file in (stiffness, mass, rows):
        if not raw_matrices.is_file(file):
            hint = f"{file.suffix} is written by *FREQUENCY, SOLVER=MATRIXSTORAGE"
            raise raw_matrices.make_unusable_file_error(
                path, f"no {file.name}", f"{', '.join(SUFFIXES)} side by side", hint
            )
    dofs = raw_matrices.parse_file(rows, "lines node.direction", _parse_dofs)
    expected = f"lines 'row column value' for {len(dofs)} rows"
    files = {"K": stiffness, "M": mass}
    result = {
        letter: raw_matrices.parse_file(
            file, expected, lambda data: _parse_triangle(data, len(dofs))
        )
        for letter, file in files.items()
    }
    return raw_matrices.RawMatrices(result, dofs, files=files)


def _parse_dofs(data: bytes) -> raw_matrices.Dofs:
    """Parse the node and degree of freedom of each row in a ``.dof`` file of CalculiX."""
    words = data.split()
    if not 0 < len(words) <= raw_matrices.MAX_ROWS:
        raise ValueError(f"the file has {len(words)} rows; the limit is {raw_matrices.MAX_ROWS}")
    # 12.3 means direction 3 of node 12; it is not a decimal number
    pairs = [word.partition(b".")[::2] for word in words]
    node, kind = np.array(pairs).astype(np.int64).T
    if not ((kind >= 0) & (kind <= 6)).all():
        code = kind[(kind < 0) | (kind > 6)][0]
        raise ValueError(f"the direction code {code} is not a number from 0 to 6")
    return raw_matrices.Dofs(node, np.where(kind == 0, raw_matrices.DOF_NUMBERS["temp"], kind))


def _parse_triangle(data: bytes, n: int) -> sparse.csc_array:
    """Parse a symmetric matrix from a CalculiX file, which stores only one triangle.

    The file contains one triangle of the matrix.
    """
    values = parse_numbers(data)
    if values.size == 0 or values.size % 3:
        raise ValueError(f"{values.size} numbers do not fill 3 columns; the file may be truncated")
    row, column = parse_indices(values[0::3], n), parse_indices(values[1::3], n)
    bare = np.bincount(row[row == column], minlength=n) == 0
    if bare.any():  # CalculiX writes every diagonal entry, including zeros
        raise ValueError(
            f"row {bare.argmax() + 1} has no diagonal entry; the file may be truncated"
        )
    return raw_matrices.complete_triangles(
        sparse.csc_array((values[2::3], (row, column)), shape=(n, n))
    )


# names of the degrees of freedom in `.full` files of Ansys, keyed by number (counted from 0)
_ANSYS_DOF_NAMES = dict(enumerate((
    "ux", "uy", "uz", "rx", "ry", "rz", "ax", "ay", "az", "vx", "vy", "vz", "", "", "", "warp",
    "conc", "hdsp", "pres", "temp", "volt", "mag", "enke", "ends", "emf", "curr",
)))  # fmt: skip
HARWELL_BOEING_EXPECTED = (
    "an assembled Harwell-Boeing file in ASCII: type RSA, RUA, RZA, RRA, CSA, CUA"
)
_FORTRAN_FORMAT = re.compile(rb"\(?\s*(?:\d*P,?)?\s*(\d*)\s*[IFEDG](\d+)", re.IGNORECASE)
_MATRIX_TYPE = re.compile(rb"\s*([RCPrcp][SUHZRsuhzr][AEae])\s")
_MAX_LINE_LENGTH = 10_000  # largest number of characters in one line of a Harwell-Boeing file
_ANSYS_ROTATION_NAMES = {"ROTX": "rx", "ROTY": "ry", "ROTZ": "rz"}


def unpack_ansys_full(path: str, requested: dict[str, str]) -> dict[str, np.ndarray]:
    """Return the matrices in an Ansys ``.full`` file as arrays for a ``.npz`` archive.

    The names of the arrays are the same as in an ``.npz`` archive. The array ``fixed`` contains the
    indices of the rows that Ansys constrains. The argument ``requested`` has no effect.

    Raises
    ------
    MissingToolError : ansys-mapdl-reader is not installed.
    """
    file = import_optional("ansys.mapdl.reader.full", path).FullFile(path)
    place, stiffness, mass = file.load_km()
    place = np.asarray(place, dtype=np.int64)
    kind = np.array([raw_matrices.DOF_NUMBERS[_ANSYS_DOF_NAMES[int(k)]] for k in place[:, 1]])
    # the rows of constrained degrees of freedom are empty
    const = np.asarray(file.const, dtype=np.int64).reshape(-1, 2)
    key = np.array([64, 1])
    fixed = np.flatnonzero(np.isin(place[:, :2] @ key, const @ key))
    result = {"nodes": place[:, 0], "dofs": kind, "fixed": fixed}
    for letter, matrix in (("K", stiffness), ("M", mass)):  # upper triangle only
        result |= raw_matrices.pack_matrix(letter, complete_triangle(sparse.csc_array(matrix)))
    return result


def is_harwell_boeing(head: bytes) -> bool:
    """Return whether the first lines of a file are a Harwell-Boeing header."""
    lines = head.split(b"\n", 4)
    return len(lines) > 3 and _MATRIX_TYPE.match(lines[2] + b" ") is not None


def read_harwell_boeing(
    data: bytes, allowed: Callable[[tuple[int, int], int], None]
) -> sparse.csc_array:
    """Return the matrix in a Harwell-Boeing file, with both triangles.

    ``data`` is the content of the file. Before memory is allocated, the function ``allowed(shape,
    entries)`` raises an error if the declared size of the matrix is too large.

    Raises
    ------
    ValueError : the file is binary or damaged, or the matrix is elemental, Hermitian or a pattern.
    """
    lines = data.splitlines()
    if len(lines) < 5:
        raise ValueError("the header is cut off")
    match = _MATRIX_TYPE.match(lines[2] + b" ")
    if match is None:
        raise ValueError(f"the third line cannot be read: {lines[2][:40]!r}")
    kind = match[1].decode().upper()
    if kind not in ("RSA", "RUA", "RZA", "RRA", "CSA", "CUA"):
        raise ValueError(f"a matrix of type {kind} is not supported")
    counts = list(map(int, lines[1].split()[:4]))
    rows, columns, entries = map(int, lines[2].split()[1:4])
    allowed((rows, columns), entries)
    if min(counts) < 0 or (kind[1] in "SZ" and rows != columns):
        raise ValueError("the header is damaged")
    formats = _FORTRAN_FORMAT.findall(lines[3])
    if len(formats) < 3:
        raise ValueError("the line with the number formats cannot be read")
    sides = lines[1].split()[4:]  # right-hand sides have a separate line in the header
    parts, start = [], 5 if sides and int(sides[0]) > 0 else 4
    numbers_of = (columns + 1, entries, 2 * entries if kind[0] == "C" else entries)
    for (repeat, width), length, number in zip(formats, counts[1:], numbers_of, strict=False):
        section = lines[start : start + length]
        parts.append(_parse_fixed_width(section, int(repeat or 1), int(width), number))
        start += length
    pointer, row = parts[0], parse_indices(parts[1], rows)
    sound = pointer[0] == 1 and pointer[-1] == entries + 1 and (np.diff(pointer) >= 0).all()
    if not sound:
        raise ValueError(
            "the column pointers do not increase from 1 to the number of entries plus 1"
        )
    value = parts[2][0::2] + 1j * parts[2][1::2] if kind[0] == "C" else parts[2]
    inner = (value, row, pointer.astype(np.int64) - 1)
    matrix = sparse.csc_array(inner, shape=(rows, columns))
    if kind[1] in "UR":
        return matrix
    triangle = sparse.coo_array(matrix)
    if (triangle.row < triangle.col).any() and (triangle.row > triangle.col).any():
        raise ValueError(
            f"a file with a matrix of type {kind} must contain only one triangle, but this file "
            "contains entries above and below the diagonal"
        )
    return complete_triangle(matrix, 1 if kind[1] == "S" else -1)


def _parse_fixed_width(lines: list[bytes], repeat: int, width: int, number: int) -> np.ndarray:
    """Parse numbers from lines that have fields of fixed width.

    Each field has ``width`` characters, and each line has ``repeat`` fields.
    """
    if len(lines) * repeat < number:
        raise ValueError(
            f"the file ends after {len(lines)} lines, but {number} numbers need "
            f"{math.ceil(number / repeat)} lines; the file may be truncated"
        )
    if not 0 < repeat * width <= _MAX_LINE_LENGTH:
        raise ValueError(f"the line format is not supported: {repeat} fields of {width} characters")
    text = b"".join(line[: repeat * width].ljust(repeat * width) for line in lines)
    text = text.translate(bytes.maketrans(b"Dd", b"EE"))
    values = np.frombuffer(text, dtype=f"S{width}")[:number]
    return np.char.strip(values).astype(float)


def read_mapping(data: bytes, size: int) -> raw_matrices.Dofs:
    """Read the node and the degree of freedom of each row from an Ansys mapping file.

    ``size`` is the number of rows. A row is called an equation in the file.

    Raises
    ------
    ValueError : the file is damaged, an equation is missing or repeated, or a degree of freedom is
        unknown.
    """
    lines = map(str.split, data.decode("ascii", "replace").splitlines())
    rows = [words for words in lines if words and words[0].isdigit()]
    if len(rows) != size or set(map(len, rows)) != {3}:
        raise ValueError(
            f"the file has {len(rows)} rows of equations; it needs {size} rows, each with the "
            "number of the equation, a node and a degree of freedom"
        )
    equations, nodes, freedoms = zip(*rows, strict=True)
    names = [_ANSYS_ROTATION_NAMES.get(name.upper(), name.lower()) for name in freedoms]
    unknown = sorted(set(names) - set(raw_matrices.DOF_NUMBERS))
    if unknown:
        raise ValueError(f"the file has the unknown degree of freedom {unknown[0]}")
    place = parse_indices(np.array(list(map(float, equations))), size)
    if len(np.unique(place)) < size:
        raise ValueError("an equation number occurs twice")
    node, kind = np.empty(size, dtype=np.int64), np.empty(size, dtype=np.int64)
    node[place] = list(map(int, nodes))
    kind[place] = list(map(raw_matrices.DOF_NUMBERS.__getitem__, names))
    return raw_matrices.Dofs(node, kind)


# matrix letters, keyed by the first letters of matrix names in Nastran files
_NASTRAN_PREFIXES = {"K": "K", "K4": LOSS_LETTER, "M": "M", "B": "E"}
_SHORT_EXPONENT = re.compile(r"(?<=[0-9.])([+-]\d+)$")  # 1.5+7 means 1.5e+7
# integer codes of the matrix forms in Nastran files
_SQUARE_FORM = 1
_SYMMETRIC_FORM = 6


def choose_matrices(names: list[str], requested: Mapping[str, str], path: Path) -> dict[str, str]:
    """Choose a matrix of a Nastran file for each matrix letter, such as K or M.

    ``names`` are the names of the matrices in the file. ``requested`` maps matrix letters, such as
    K, to the names of matrices in the file. If ``requested`` is empty, the first letters of the
    names determine the matrix letter. Return the names of the chosen matrices, keyed by matrix
    letter.

    Raises
    ------
    UsageError : the file does not contain a requested matrix, or the names of two matrices fit the
        same letter.
    """
    known = {name.upper(): name for name in names}
    selected = {}
    for letter, name in requested.items():
        if name.upper() not in known:
            raise raw_matrices.make_unusable_file_error(
                path, f"no matrix {name}", f"one of {', '.join(names)}"
            )
        selected[letter] = known[name.upper()]
    for letter in _NASTRAN_PREFIXES.values():
        fits = [name for name in known.values() if _find_standard_letter(name) == letter]
        if letter in selected or not fits or requested:
            continue
        if len(fits) > 1:
            hint = f'matrices = {{ {letter} = "{fits[0]}" }} in the TOML file'
            raise raw_matrices.make_unusable_file_error(
                path, f"matrices {', '.join(fits)}", f"one matrix {letter}", hint
            )
        selected[letter] = fits[0]
    if not selected:
        raise raw_matrices.make_unusable_file_error(
            path, f"matrices {', '.join(names)}", "K..., M... and as needed B..."
        )
    return selected


def _find_standard_letter(name: str) -> str | None:
    """Return the matrix letter that the first letters of a Nastran matrix name denote.

    Return None if the first letters of the name are unknown.
    """
    return _NASTRAN_PREFIXES.get(name[:2].upper()) or _NASTRAN_PREFIXES.get(name[:1].upper())


def read_dmig(path: Path, requested: Mapping[str, str]) -> raw_matrices.RawMatrices:
    """Read the matrices in the DMIG cards of a Nastran file.

    ``requested`` maps matrix letters, such as K, to the names of matrices in the file. A grid point
    and a component identify each row.

    Raises
    ------
    UsageError : the file is damaged, contains no DMIG cards, or contains rectangular matrices.
    """
    expected = "square DMIG cards"

    def parse(data: bytes) -> tuple[dict[str, int], dict[str, raw_matrices.Triple]]:
        """Parse the matrices of the file; reject a mesh without matrices."""
        if (name := identify_mesh(data)) is not None and b"DMIG" not in data.upper():
            raise make_other_format_error(path, name, "matrices", expected)
        return _parse_dmig(data)

    forms, entries = raw_matrices.parse_file(path, expected, parse)
    selected = choose_matrices(
        [n for n, f in forms.items() if f in (_SQUARE_FORM, _SYMMETRIC_FORM)], requested, path
    )
    triples = {letter: entries[name] for letter, name in selected.items()}
    matrices, dofs = raw_matrices.make_matrices_by_letter(triples)
    for letter, name in selected.items():
        if forms[name] == _SYMMETRIC_FORM:
            matrices[letter] = raw_matrices.complete_triangles(matrices[letter])
    return raw_matrices.RawMatrices(add_structural_loss(matrices), dofs)


def _parse_dmig(data: bytes) -> tuple[dict[str, int], dict[str, raw_matrices.Triple]]:
    """Parse all matrices on the DMIG cards of a Nastran file.

    Return the form number of each matrix, and the row keys, column keys and values of all entries.
    Both returned mappings are keyed by the name of the matrix.
    """
    forms: dict[str, int] = {}
    values: dict[str, Callable[[str, str], complex]] = {}
    entries: dict[str, list[tuple[complex, ...]]] = {}
    if data and not data.endswith(b"\n"):
        raise ValueError("the last line is not complete; the file may be truncated")
    for cells in list_bulk_data_cards(data, "DMIG"):
        name = cells[0].strip().upper()
        if cells[1].strip() == "0":
            forms[name], entries[name] = int(cells[2]), []
            polar = len(cells) > 5 and cells[5].strip() not in ("", "0")
            values[name] = _make_value_converter(int(cells[3]), polar, name)
            continue
        if name not in forms:
            raise ValueError(f"matrix {name} has no header card")
        column = (int(cells[1]), _parse_component(cells[2]))
        for at in range(4, len(cells), 4):
            grid, component, first, second = [*cells[at : at + 4], "", "", ""][:4]
            if grid.strip():
                place = (int(grid), _parse_component(component), *column)
                entries[name].append((*place, values[name](first, second)))
    if not forms:
        raise ValueError("the file contains no DMIG card")
    return forms, {
        name: raw_matrices.encode_entry_positions(np.array(e).reshape(-1, 5))
        for name, e in entries.items()
    }


def _make_value_converter(kind: int, polar: bool, name: str) -> Callable[[str, str], complex]:
    """Return a function that converts the two fields of a DMIG value to one number.

    The two fields are the value of a matrix entry on a DMIG card. In a real matrix, the first field
    is the value. In a complex matrix, the fields are real and imaginary part, or magnitude and
    angle [degrees] if ``polar`` is true. ``kind`` is the type number on the header card of the
    matrix ``name``.
    """
    if kind not in (1, 2, 3, 4):
        raise ValueError(f"matrix {name} is of type {kind}, which does not exist")
    if kind < 3:
        return lambda first, _: parse_fortran_number(first)
    if polar:
        return lambda size, angle: cmath.rect(
            parse_fortran_number(size), math.radians(parse_fortran_number(angle or "0"))
        )
    return lambda first, second: complex(
        parse_fortran_number(first), parse_fortran_number(second.strip() or "0")
    )


def list_bulk_data_cards(data: bytes, name: str) -> Iterator[list[str]]:
    """Yield the fields of each Nastran bulk data card that has the given name.

    The fields of a card include the fields of its continuation lines. The fields of a card may be
    small, large or free.
    """
    cells: list[str] = []
    for line in data.decode("ascii", "replace").splitlines():
        line = line.split("$", 1)[0].rstrip()
        begins = line[: len(name)].upper() == name
        continues = line[:1] in ("*", "+", ",") or (line and not line[:8].strip())
        if cells and line and not (continues and not begins):
            yield cells
            cells = []
        if begins or (cells and continues):
            cells += _split_fields(line)
    if cells:
        yield cells


def _split_fields(line: str) -> list[str]:
    """Split a line of Nastran bulk data into its fields."""
    if "," in line:
        cells = line.split(",")[1:9]
        return cells + [""] * (8 - len(cells))
    width, count = (16, 4) if "*" in line[:8] else (8, 8)
    return [line[8 + k * width : 8 + (k + 1) * width] for k in range(count)]


def _parse_component(text: str) -> int:
    """Parse the degree-of-freedom number on a DMIG card; a blank field means 0."""
    value = int(text.strip() or 0)
    if not 0 <= value <= 6:
        raise ValueError(f"component {value} is not a number from 0 to 6")
    return value


def parse_fortran_number(text: str) -> float:
    """Parse a number in Fortran notation, such as 1.5D+7 or 1.5+7."""
    return float(_SHORT_EXPONENT.sub(r"E\1", text.strip().upper().replace("D", "E")))


def unpack_op4(path: str, requested: Mapping[str, str]) -> dict[str, np.ndarray]:
    """Return the matrices in an OUTPUT4 file as arrays for a ``.npz`` archive.

    The OUTPUT4 file may be a text file or a binary file. ``requested`` maps matrix letters, such as
    K, to the names of matrices in the file.

    Raises
    ------
    UsageError : the file is too large, or contains no stiffness.
    MissingToolError : pyyeti is not installed.
    """
    op4 = import_optional("pyyeti.nastran.op4", path)
    names, sizes, _, _ = op4.dir(path, verbose=False)
    selected = choose_matrices(list(names), requested, Path(path))
    for letter, name in selected.items():
        raw_matrices.require_size(Path(path), letter, sizes[names.index(name)], None)
    loaded = op4.load(path, list(selected.values()), sparse=True)
    matrices = {}
    for letter, name in selected.items():
        matrix, form = sparse.csc_array(loaded[name][0]), loaded[name][1]
        matrices[letter] = (
            raw_matrices.complete_triangles(matrix) if form == _SYMMETRIC_FORM else matrix
        )
    result: dict[str, np.ndarray] = {}
    for letter, matrix in add_structural_loss(matrices).items():
        result |= raw_matrices.pack_matrix(letter, matrix)
    return result
