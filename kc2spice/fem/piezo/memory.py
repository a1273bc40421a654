"""Refuse a chip whose factors would not fit into memory, before any work is done on it."""

from __future__ import annotations

from kc2spice.fem.piezo.keys import Chip
from kc2spice.fem.piezo.mesh import cap_layers, level_spans
from kc2spice.linalg.memory import require_bytes

# Fill of sparse factors of a solid grows as n^(4/3); 152 000 unknowns took 5.8 GB.
SPARSE_BYTES = 700.0


def factor_bytes(kick: Chip) -> float:
    """Estimated memory [B] of the stiffness factor: sparse where potentials are free, or banded."""
    mesh = kick.mesh
    steps = mesh.refine * mesh.order
    plane = 1 + (mesh.rings + mesh.outer_rings) * steps * (mesh.sectors * steps + 1)
    caps = cap_layers(kick, kick.bottom_cap) + cap_layers(kick, kick.top_cap)
    spans = level_spans(kick)
    nodes = plane * ((len(spans) + caps) * steps + 1)
    inner = plane * int((spans == 1).sum()) * (steps - 1)
    sparse = SPARSE_BYTES * (3.0 * nodes + inner) ** (4 / 3)
    banded = 8.0 * 3 * nodes * 3 * plane
    return sparse if inner else min(sparse, banded)


def require_memory(kick: Chip) -> None:
    """Compare the estimate with the memory that is free now.

    Raises
    ------
    UsageError : the model is too large for this machine.
    """
    require_bytes(
        factor_bytes(kick),
        "the factorised stiffness",
        where="kick.mesh",
        hint="lower kick.mesh.refine, kick.mesh.order or the number of rings and sectors",
    )
