"""Abaqus' ``JOB_STIF2.mtx``, ``JOB_MASS2.mtx`` ... from ``*MATRIX GENERATE``.

``FORMAT=MATRIX INPUT`` (or ``LABELS``): ``node, dof, node, dof, value`` of one triangle.
``FORMAT=COORDINATE``: ``row column value`` of both, without the names of the rows.
A freedom that a boundary condition of the step holds has 1e36 on the diagonal of the stiffness.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from scipy import sparse

from kc2spice.bodies.readers.limits import MAX_SIZE, parsed, present, refused
from kc2spice.bodies.readers.raw import Raw, keyed, labelled, whole
from kc2spice.rom.matrix_market import indices, numbers

NAME = re.compile(r"(.*)_(STIF|MASS|DMPV)(\d*)\.mtx", re.IGNORECASE)
_LETTER = {"STIF": "K", "MASS": "M", "DMPV": "E"}
_HELD = 1e35
_EXPECTED = "an .mtx file of *MATRIX OUTPUT, FORMAT=MATRIX INPUT or COORDINATE"


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
    tables = {letter: parsed(path, _EXPECTED, _table) for letter, path in files.items()}
    one = next(iter(files.values()))
    dofs = None
    if {table.shape[1] for table in tables.values()} == {5}:
        found, dofs = labelled({letter: keyed(table) for letter, table in tables.items()})
        found = {letter: whole(matrix) for letter, matrix in found.items()}
    elif {table.shape[1] for table in tables.values()} == {3}:
        n = int(max(table[:, :2].max() for table in tables.values()))
        places = {k: tuple(indices(side, n) for side in t.T[:2]) for k, t in tables.items()}
        found = {k: sparse.csc_array((t[:, 2], places[k]), (n, n)) for k, t in tables.items()}
    else:
        raise refused(one, "MATRIX INPUT and COORDINATE", "one format for all matrices")
    held = found["K"].diagonal() >= _HELD if "K" in found else np.empty(0, dtype=bool)
    return Raw(found, dofs, np.flatnonzero(held))


def _table(data: bytes) -> np.ndarray:
    """Lines (n, 5) or (n, 3), the numbers of nodes, freedoms, rows and columns sound."""
    if data.startswith(b"*") or b"\n*" in data:
        lines = data.split(b"\n")
        data = b"\n".join(line for line in lines if not line.startswith(b"*"))
    width = len(data.lstrip().split(b"\n", 1)[0].replace(b",", b" ").split())
    values = numbers(data)
    if width not in (3, 5) or values.size == 0 or values.size % width:
        raise ValueError(f"{values.size} numbers in {width} columns: is it cut off?")
    table = values.reshape(-1, width)
    if width == 5:
        keyed(table)
    else:
        indices(table[:, :2].ravel(), MAX_SIZE)
    return table
