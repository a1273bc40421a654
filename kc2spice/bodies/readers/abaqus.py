"""Abaqus' ``JOB_STIF2.mtx``, ``JOB_MASS2.mtx`` ... from ``*MATRIX GENERATE``.

``FORMAT=MATRIX INPUT`` (or ``LABELS``): ``node, dof, node, dof, value`` of one triangle.
``FORMAT=COORDINATE``: ``row column value`` of both, without the names of the rows.
A freedom that a boundary condition of the step holds has 1e36 on the diagonal of the stiffness.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy import sparse

from kc2spice.bodies.readers.limits import (
    MAX_SIZE,
    bounded,
    checked,
    content,
    guarded,
    present,
    refused,
    whole,
)
from kc2spice.bodies.readers.raw import DOFS, Raw, labelled
from kc2spice.rom.matrix_market import indices, numbers

NAME = re.compile(r"(.*)_(STIF|MASS|DMPV)(\d*)\.mtx", re.IGNORECASE)
_LETTER = {"STIF": "K", "MASS": "M", "DMPV": "E"}
_HELD = 1e35
_EXPECTED = "an .mtx file of *MATRIX OUTPUT, FORMAT=MATRIX INPUT or COORDINATE"

Triple = tuple[np.ndarray, np.ndarray, np.ndarray]


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
    tables = {letter: guarded(path, _EXPECTED, _table(path)) for letter, path in files.items()}
    widths = {table.shape[1] for table in tables.values()}
    if len(widths) > 1:
        raise refused(
            next(iter(files.values())), "MATRIX INPUT and COORDINATE", "one format for all matrices"
        )
    if widths == {3}:
        raw = _coordinate(tables, files)
    else:
        triples = {
            letter: guarded(files[letter], _EXPECTED, lambda t=table: _keys(t))  # type: ignore[misc]
            for letter, table in tables.items()
        }
        matrices, dofs = labelled(triples)
        raw = Raw({k: whole(m) for k, m in matrices.items()}, dofs)
    matrices = {k: checked(m, k, files[k]) for k, m in raw.matrices.items()}
    held = matrices["K"].diagonal() >= _HELD if "K" in matrices else np.empty(0, dtype=bool)
    return Raw(matrices, raw.dofs, np.flatnonzero(held))


def _table(path: Path) -> Callable[[], np.ndarray]:
    def read() -> np.ndarray:
        data = content(path)
        if data.startswith(b"*") or b"\n*" in data:
            lines = data.split(b"\n")
            data = b"\n".join(line for line in lines if not line.startswith(b"*"))
        first = data.lstrip().split(b"\n", 1)[0]
        width = len(first.replace(b",", b" ").split())
        if width not in (3, 5):
            raise ValueError(f"{width} columns")
        values = numbers(data)
        if values.size == 0 or values.size % width:
            raise ValueError(f"{values.size} numbers in {width} columns: is it cut off?")
        return values.reshape(-1, width)

    return read


def _keys(table: np.ndarray) -> Triple:
    label, kind = table[:, [0, 2]], table[:, [1, 3]]
    whole = (label == np.floor(label)) & (abs(label) < 2**40)
    if not whole.all() or not np.isin(kind, list(DOFS)).all():
        raise ValueError("a node or degree of freedom that is none")
    keys = label.astype(np.int64) * 64 + kind.astype(np.int64)
    return keys[:, 0], keys[:, 1], table[:, 4]


def _coordinate(tables: dict[str, np.ndarray], files: dict[str, Path]) -> Raw:
    size = max(float(table[:, :2].max()) for table in tables.values())
    if not size <= MAX_SIZE:
        raise refused(next(iter(files.values())), f"row {size:g}", f"at most {MAX_SIZE} rows")
    n = int(size)
    matrices = {}
    for letter, table in tables.items():
        bounded(files[letter], letter, (n, n), min(len(table), n * n - 1))

        def build(table: np.ndarray = table) -> sparse.csc_array:
            place = (indices(table[:, 0], n), indices(table[:, 1], n))
            return sparse.csc_array(sparse.coo_array((table[:, 2], place), shape=(n, n)))

        matrices[letter] = guarded(files[letter], _EXPECTED, build)
    return Raw(matrices)
