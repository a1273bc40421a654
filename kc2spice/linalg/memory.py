"""Refuse a mesh whose factors would not fit into memory, before any work is done on it."""

from __future__ import annotations

import os
from pathlib import Path

from kc2spice.core.errors import UsageError

USABLE = 0.9


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
