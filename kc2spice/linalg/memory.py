"""Refuse a mesh whose factors would not fit into memory, before any work is done on it."""

from __future__ import annotations

import os
from pathlib import Path

from kc2spice.core.errors import UsageError
from kc2spice.scene.schema import Kick

# Fill of sparse factors of a solid grows as n^(4/3); 152 000 unknowns took 5.8 GB.
SPARSE_BYTES = 700.0
USABLE = 0.9


def factor_bytes(kick: Kick) -> float:
    """Estimated memory [B] of the stiffness factor: sparse where potentials are free, or banded."""
    mesh = kick.mesh
    steps = mesh.refine * mesh.order
    plane = 1 + (mesh.rings + mesh.outer_rings) * steps * (mesh.sectors * steps + 1)
    nodes = plane * (kick.layers * steps + 1)
    inner = plane * kick.layers * (steps - 1)
    sparse = SPARSE_BYTES * (3.0 * nodes + inner) ** (4 / 3)
    banded = 8.0 * 3 * nodes * 3 * plane
    return sparse if inner else min(sparse, banded)


def require_memory(kick: Kick) -> None:
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
