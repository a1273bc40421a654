"""CalculiX' ``JOB.sti``, ``JOB.mas`` and ``JOB.dof`` from ``*FREQUENCY, SOLVER=MATRIXSTORAGE``.

``.sti`` and ``.mas`` hold ``row column value`` of one triangle, ``.dof`` one ``node.direction`` per
row; directions are 1 to 6, and 0 for temperature.
"""

from __future__ import annotations

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
from kc2spice.bodies.readers.raw import CODES, Dofs, Raw
from kc2spice.rom.matrix_market import indices, numbers
from kc2spice.rom.operators import Matrix

SUFFIXES = (".sti", ".mas", ".dof")


def read_calculix(path: Path) -> Raw:
    """Stiffness and mass of the job of which ``path`` is a ``.sti``, ``.mas`` or ``.dof`` file.

    Raises
    ------
    UsageError : a file is missing, damaged, too large, or they do not fit together.
    """
    files = {suffix: path.with_suffix(suffix) for suffix in SUFFIXES}
    for suffix, file in files.items():
        if not present(file):
            raise refused(
                path,
                f"no {file.name}",
                f"{', '.join(SUFFIXES)} side by side",
                hint=f"{suffix} is written by *FREQUENCY, SOLVER=MATRIXSTORAGE",
            )
    dofs = guarded(files[".dof"], "lines node.direction", lambda: _dofs(files[".dof"]))
    matrices: dict[str, Matrix] = {}
    for letter, suffix in (("K", ".sti"), ("M", ".mas")):
        expected = f"lines 'row column value' for {len(dofs)} rows"
        file = files[suffix]
        found = guarded(file, expected, lambda f=file: _triangle(f, len(dofs)))  # type: ignore[misc]
        matrices[letter] = checked(found, letter, file)
    return Raw(matrices, dofs)


def _dofs(path: Path) -> Dofs:
    words = content(path).split()
    if not 0 < len(words) <= MAX_SIZE:
        raise ValueError(f"{len(words)} rows")
    pairs = [word.partition(b".")[::2] for word in words]  # 12.3 is node 12, never a number
    node = np.array([int(a) for a, _ in pairs], dtype=np.int64)
    kind = np.array([int(b) for _, b in pairs], dtype=np.int64)
    if not ((kind >= 0) & (kind <= 6)).all():
        raise ValueError(f"direction {kind[(kind < 0) | (kind > 6)][0]}")
    return Dofs(node, np.where(kind == 0, CODES["temp"], kind))


def _triangle(path: Path, n: int) -> sparse.csc_array:
    values = numbers(content(path))
    if values.size == 0 or values.size % 3:
        raise ValueError(f"{values.size} numbers in 3 columns: is it cut off?")
    bounded(path, "K", (n, n), min(values.size // 3, n * n - 1))
    row, column = indices(values[0::3], n), indices(values[1::3], n)
    bare = np.setdiff1d(np.arange(n), row[row == column])
    if bare.size:  # CalculiX writes every diagonal entry, zeros too
        raise ValueError(f"row {bare[0] + 1} has no diagonal entry: is it cut off?")
    matrix = sparse.csc_array(sparse.coo_array((values[2::3], (row, column)), shape=(n, n)))
    return whole(matrix)
