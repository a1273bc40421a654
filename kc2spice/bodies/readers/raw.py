"""What a file gives before ports are chosen: matrices by letter and the names of their rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from kc2spice.rom.operators import Matrix

# Degrees of freedom by number: 1 to 6 as every tool counts them, the others as Abaqus or ours.
DOFS = {
    0: "scalar", 1: "ux", 2: "uy", 3: "uz", 4: "rx", 5: "ry", 6: "rz", 7: "warp", 8: "pres",
    9: "volt", 11: "temp", 12: "conc", 13: "mag", 14: "emf", 15: "curr", 21: "ax", 22: "ay",
    23: "az", 31: "vx", 32: "vy", 33: "vz", 41: "enke", 42: "ends", 43: "hdsp",
}  # fmt: skip
CODES = {name: code for code, name in DOFS.items()}
TRANSLATIONS = (1, 2, 3)
ROTATIONS = (4, 5, 6)
VOLT = CODES["volt"]


@dataclass(frozen=True, eq=False)
class Dofs:
    """Node number and kind of freedom (a key of ``DOFS``) of each row; both (n,) integers."""

    node: np.ndarray
    kind: np.ndarray

    def __len__(self) -> int:
        return len(self.node)

    def keys(self) -> np.ndarray:
        """One integer per row, equal where node and kind are."""
        return np.asarray(self.node, dtype=np.int64) * 64 + self.kind

    @staticmethod
    def of_keys(keys: np.ndarray) -> Dofs:
        """The inverse of :meth:`keys`."""
        return Dofs(keys // 64, keys % 64)


@dataclass(frozen=True, eq=False)
class Raw:
    """Matrices by letter, the freedoms of their rows if the file names them, and which of the
    rows the tool itself holds fixed.
    """

    matrices: Mapping[str, Matrix]
    dofs: Dofs | None = None
    held: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int64))


def labelled(
    triples: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> tuple[dict[str, sparse.csc_array], Dofs]:
    """Matrices on one common set of rows from (row keys, column keys, values) by letter.

    Keys are those of :meth:`Dofs.keys`; rows are sorted by node, then by freedom, and gaps in the
    numbering leave no empty rows.
    """
    keys = np.unique(np.concatenate([side for t in triples.values() for side in t[:2]]))
    shape = (len(keys), len(keys))
    found = {}
    for letter, (row, column, value) in triples.items():
        place = (np.searchsorted(keys, row), np.searchsorted(keys, column))
        found[letter] = sparse.csc_array(sparse.coo_array((value, place), shape=shape))
    return found, Dofs.of_keys(keys)
