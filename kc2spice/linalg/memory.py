"""Refuse a model whose factors would not fit into memory, before they are begun."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee

from kc2spice.core.errors import UsageError

USABLE = 0.9
# Entries of the LU factors over n sqrt(bandwidth): 4 for chains, 9 for plates, 34 for solids.
FILL = 34.0
ENTRY_BYTES = 24.0  # one complex number, its index, and the work space around it


def require_bytes(need: float, purpose: str, *, where: str, hint: str) -> None:
    """Compare ``need`` [B] with the memory that is free now.

    Raises
    ------
    UsageError : it is more than this machine can give.
    """
    free = USABLE * available_bytes()
    if need > free:
        raise UsageError(
            "model too large for this machine's memory",
            where=where,
            got=f"about {need / 1e9:.1f} GB for {purpose}",
            expected=f"at most {free / 1e9:.1f} GB",
            hint=hint,
        )


def available_bytes() -> float:
    """Memory that can be had without swapping [B]; all of it where the system does not say."""
    table = Path("/proc/meminfo")
    if table.is_file():
        for line in table.read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return 1024.0 * float(line.split()[1])
    return float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")


def require_factors(matrix: sparse.sparray | np.ndarray) -> None:
    """Compare one complex factorisation, estimated up to five times too large for plates, with the
    memory that is free now.

    Raises
    ------
    UsageError : the model is too large for this machine.
    """
    pattern = sparse.csr_array(abs(matrix))
    order = reverse_cuthill_mckee(pattern + pattern.T, symmetric_mode=True)
    rows = pattern.shape[0]
    place = np.empty(rows, dtype=np.int64)
    place[order] = np.arange(rows)
    entries = pattern.tocoo()
    band = int(np.abs(place[entries.row] - place[entries.col]).max(initial=0)) + 1
    require_bytes(
        ENTRY_BYTES * max(FILL * rows * np.sqrt(band), pattern.nnz),
        f"{rows} factorised equations",
        where="reduction",
        hint="use a coarser mesh, or a machine with more memory",
    )
