"""What a file gives before ports are chosen: matrices by letter and the names of their rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np
from scipy import sparse

from kc2spice.rom.matrix_market import mirrored
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
_KINDS = 64  # a row's key is its node times this and its kind of freedom
_LARGEST_NODE = 2**40

Triple: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Dofs:
    """Node number and kind of freedom (a key of ``DOFS``) of each row; both (n,) integers.

    Raises
    ------
    ValueError : something that is no node or freedom.
    """

    node: np.ndarray
    kind: np.ndarray

    def __post_init__(self) -> None:
        for name in ("node", "kind"):
            given = np.asarray(getattr(self, name))
            if not (given == np.floor(given)).all() or (abs(given) >= _LARGEST_NODE).any():
                raise ValueError("the number of a node or of its freedom is none")
            object.__setattr__(self, name, given.astype(np.int64))
        strange = ~np.isin(self.kind, list(DOFS))
        if self.node.shape != self.kind.shape or strange.any():
            raise ValueError(f"degree of freedom {', '.join(map(str, self.kind[strange][:1]))}")

    def __len__(self) -> int:
        return len(self.node)

    def keys(self) -> np.ndarray:
        """One integer per row, equal where node and kind are, sorted as nodes are."""
        return np.asarray(self.node * _KINDS + self.kind)


@dataclass(frozen=True, eq=False)
class Raw:
    """Matrices by letter, the freedoms of their rows if the file names them, which of the rows the
    tool itself holds fixed, and the file of each matrix where it has one of its own."""

    matrices: Mapping[str, Matrix]
    dofs: Dofs | None = None
    held: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    files: Mapping[str, Path] = field(default_factory=dict)


def keyed(table: np.ndarray) -> Triple:
    """Keys of rows and columns, and values, of lines (node, freedom, node, freedom, value)."""
    row, column = Dofs(*table[:, :2].T), Dofs(*table[:, 2:4].T)
    return row.keys(), column.keys(), table[:, 4]


def labelled(triples: Mapping[str, Triple]) -> tuple[dict[str, sparse.csc_array], Dofs]:
    """Matrices by letter, on one common set of rows, from what :func:`keyed` gives.

    Rows are sorted by node, then by freedom; gaps in the numbering leave no empty rows.
    """
    keys = np.unique(np.concatenate([side for t in triples.values() for side in t[:2]]))
    shape = (len(keys), len(keys))
    found = {}
    for letter, (row, column, value) in triples.items():
        place = (np.searchsorted(keys, row), np.searchsorted(keys, column))
        found[letter] = sparse.csc_array((value, place), shape=shape)
    return found, Dofs(keys // _KINDS, keys % _KINDS)


def whole(matrix: sparse.csc_array) -> sparse.csc_array:
    """A matrix whose pairs off the diagonal were stored once, on either side of it; as it is where
    any pair is stored twice.
    """
    below = abs(sparse.tril(matrix, -1, format="csc")) > 0
    above = abs(sparse.triu(matrix, 1, format="csc")) > 0
    return matrix if below.multiply(above.T).nnz else mirrored(matrix)
