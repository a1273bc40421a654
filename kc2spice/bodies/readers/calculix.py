"""CalculiX' ``JOB.sti``, ``JOB.mas`` and ``JOB.dof`` from ``*FREQUENCY, SOLVER=MATRIXSTORAGE``.

``.sti`` and ``.mas`` hold ``row column value`` of one triangle, ``.dof`` one ``node.direction`` per
row; directions are 1 to 6, and 0 for temperature.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy import sparse

from kc2spice.bodies.readers.limits import MAX_SIZE, parsed, present, refused
from kc2spice.bodies.readers.raw import CODES, Dofs, Raw, whole
from kc2spice.rom.matrix_market import indices, numbers

SUFFIXES = (".sti", ".mas", ".dof")


def read_calculix(path: Path) -> Raw:
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
