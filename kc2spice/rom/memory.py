"""Refuse a foreign model whose factors would not fit into memory, before they are begun."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee

from kc2spice.linalg.memory import require_bytes
from kc2spice.rom.pencil import Pencil

# Entries of the LU factors over n sqrt(bandwidth): 4 for chains, 9 for plates, 34 for solids.
FILL = 34.0
ENTRY_BYTES = 24.0  # one complex number, its index, and the work space around it


def factor_bytes(pencil: Pencil) -> float:
    """Estimated memory [B] of one complex factorisation, up to five times too much for plates."""
    pattern = sparse.csr_array(abs(pencil.bordered(1.0, 1.0, 1.0)))
    order = reverse_cuthill_mckee(pattern + pattern.T, symmetric_mode=True)
    rows = pattern.shape[0]
    place = np.empty(rows, dtype=np.int64)
    place[order] = np.arange(rows)
    entries = pattern.tocoo()
    band = int(np.abs(place[entries.row] - place[entries.col]).max(initial=0)) + 1
    return ENTRY_BYTES * max(FILL * rows * np.sqrt(band), pattern.nnz)


def require_memory(pencil: Pencil) -> None:
    """Compare the estimate for ``scipy`` with the memory that is free now.

    PARDISO needs none: it knows the size of its factors before it begins, and is asked then.

    Raises
    ------
    UsageError : the model is too large for this machine.
    """
    require_bytes(
        factor_bytes(pencil),
        f"{pencil.size} factorised equations",
        where="reduction",
        hint="use a coarser mesh, or a machine with more memory",
    )
