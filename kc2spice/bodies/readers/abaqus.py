"""Matrices of Abaqus and CalculiX, each a text file of one triangle.

Abaqus' ``JOB_STIF2.mtx``, ``JOB_MASS2.mtx`` ... of ``*MATRIX GENERATE`` have, by ``FORMAT=MATRIX
INPUT`` (or ``LABELS``), ``node, dof, node, dof, value``; by ``FORMAT=COORDINATE`` ``row column
value`` of both triangles, without the names of the rows. A freedom that a boundary condition of the
step holds has 1e36 on the diagonal of the stiffness.

CalculiX' ``JOB.sti``, ``JOB.mas`` and ``JOB.dof`` of ``*FREQUENCY, SOLVER=MATRIXSTORAGE`` have
``row column value``, and one ``node.direction`` per row: 1 to 6, and 0 for temperature.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from scipy import sparse

from kc2spice.bodies.readers.raw import (
    CODES,
    MAX_SIZE,
    Dofs,
    Raw,
    Triple,
    keyed,
    labelled,
    parsed,
    present,
    refused,
    whole,
)
from kc2spice.rom.matrix_market import indices, numbers

NAME = re.compile(r"(.*)_(STIF|MASS|DMPV)(\d*)\.mtx", re.IGNORECASE)
_LETTER = {"STIF": "K", "MASS": "M", "DMPV": "E"}
_HELD = 1e35
_EXPECTED = "an .mtx file of *MATRIX OUTPUT, FORMAT=MATRIX INPUT or COORDINATE"
SUFFIXES = (".sti", ".mas", ".dof")


def siblings(path: Path) -> dict[str, Path]:
    """Stiffness, mass and viscous damping of the job and step that ``path`` belongs to."""
    match = NAME.fullmatch(path.name)
    if match is None:
        return {}
    found = {}
    for word, letter in _LETTER.items():
        for spelled in (word, word.lower()):
            other = path.with_name(f"{match[1]}_{spelled}{match[3]}{path.suffix}")
            if present(other):
                found[letter] = other
    return found


def read_abaqus(files: dict[str, Path]) -> Raw:
    """Matrices by letter from the files of one job.

    Raises
    ------
    UsageError : damaged, formats mixed, too large, or entries that are not those of one matrix.
    """
    read = {letter: parsed(path, _EXPECTED, _entries) for letter, path in files.items()}
    tables, dofs = {letter: table for letter, (_, table) in read.items()}, None
    if len({named for named, _ in read.values()}) > 1:
        one = next(iter(files.values()))
        raise refused(one, "MATRIX INPUT and COORDINATE", "one format for all matrices")
    if all(named for named, _ in read.values()):
        found, dofs = labelled(tables)
        found = {letter: whole(matrix) for letter, matrix in found.items()}
    else:
        n = 1 + max(int(side.max()) for row, column, _ in tables.values() for side in (row, column))
        found = {k: sparse.csc_array((v, (i, j)), (n, n)) for k, (i, j, v) in tables.items()}
    held = found["K"].diagonal() >= _HELD if "K" in found else np.empty(0, dtype=bool)
    return Raw(found, dofs, np.flatnonzero(held))


def _entries(data: bytes) -> tuple[bool, Triple]:
    """Whether lines name nodes and freedoms; rows and columns, by key or from 0, and values."""
    if data.startswith(b"*") or b"\n*" in data:
        lines = data.split(b"\n")
        data = b"\n".join(line for line in lines if not line.startswith(b"*"))
    width = len(data.lstrip().split(b"\n", 1)[0].replace(b",", b" ").split())
    values = numbers(data)
    if width not in (3, 5) or values.size == 0 or values.size % width:
        raise ValueError(f"{values.size} numbers in {width} columns: is it cut off?")
    table = values.reshape(-1, width)
    if width == 5:
        return True, keyed(table)
    return False, (indices(table[:, 0], MAX_SIZE), indices(table[:, 1], MAX_SIZE), table[:, 2])


def read_calculix(path: Path, _: object) -> Raw:
    """Stiffness and mass of the job of which ``path`` is a ``.sti``, ``.mas`` or ``.dof`` file.

    Raises
    ------
    UsageError : a file is missing, damaged, too large, or they do not fit together.
    """
    stiffness, mass, rows = (path.with_suffix(suffix) for suffix in SUFFIXES)
    for file in (stiffness, mass, rows):
        if not present(file):
            hint = f"{file.suffix} is written by *FREQUENCY, SOLVER=MATRIXSTORAGE"
            expected = f"{', '.join(SUFFIXES)} side by side"
            raise refused(path, f"no {file.name}", expected, hint=hint)
    dofs = parsed(rows, "lines node.direction", _dofs)
    expected = f"lines 'row column value' for {len(dofs)} rows"
    files = {"K": stiffness, "M": mass}
    found = {
        letter: parsed(file, expected, lambda data: _triangle(data, len(dofs)))
        for letter, file in files.items()
    }
    return Raw(found, dofs, files=files)


def _dofs(data: bytes) -> Dofs:
    words = data.split()
    if not 0 < len(words) <= MAX_SIZE:
        raise ValueError(f"{len(words)} rows")
    pairs = [word.partition(b".")[::2] for word in words]  # 12.3 is node 12, never a number
    node, kind = np.array([[int(a), int(b)] for a, b in pairs], dtype=np.int64).T
    if not ((kind >= 0) & (kind <= 6)).all():
        raise ValueError(f"direction {kind[(kind < 0) | (kind > 6)][0]}")
    return Dofs(node, np.where(kind == 0, CODES["temp"], kind))


def _triangle(data: bytes, n: int) -> sparse.csc_array:
    values = numbers(data)
    if values.size == 0 or values.size % 3:
        raise ValueError(f"{values.size} numbers in 3 columns: is it cut off?")
    row, column = indices(values[0::3], n), indices(values[1::3], n)
    bare = np.bincount(row[row == column], minlength=n) == 0
    if bare.any():  # CalculiX writes every diagonal entry, zeros too
        raise ValueError(f"row {bare.argmax() + 1} has no diagonal entry: is it cut off?")
    return whole(sparse.csc_array((values[2::3], (row, column)), shape=(n, n)))
