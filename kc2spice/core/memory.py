"""Determination of the memory that this process can still allocate.

The memory of a process is limited by the machine, by control groups, and by resource limits of a
shell or batch system.

Sources: Linux, Documentation/admin-guide/cgroup-v2.rst and cgroup-v1/memory.rst; proc(5);
getrlimit(2).
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

PAGE_SIZE_NAME = "SC_PAGE_SIZE"
UNLIMITED_BYTES = 2**62  # B; control groups of version 1 report almost 2^63 B if there is no limit


def find_available_bytes(root: Path = Path("/")) -> float:
    """Determine the memory [bytes] that this process can use without swapping.

    The result is the smallest of several limits; without other limits, the free memory of the
    machine. The limits are read from files in ``root``, which is the root directory of the file
    system.
    """
    limits = [
        *_read_machine_memory(root),
        *_list_cgroup_memory(root),
        *_list_ulimit_memory(root),
    ]
    return max(min(limits), 0.0) if limits else _read_physical_memory()


def _read_physical_memory() -> float:
    """Return the physical memory of the machine [bytes]."""
    return float(os.sysconf(PAGE_SIZE_NAME)) * os.sysconf("SC_PHYS_PAGES")


def _read_machine_memory(root: Path) -> Iterator[float]:
    """Read the available memory [bytes] of the machine, if the system reports it."""
    free = _read_field(root / "proc/meminfo", "MemAvailable:")
    if free is not None:
        yield 1024.0 * free


def _list_cgroup_memory(root: Path) -> Iterator[float]:
    """Yield the free memory [bytes] of each control group of this process.

    Reclaimable pages of the file cache count as free memory.
    """
    for line in _read_text(root / "proc/self/cgroup").splitlines():
        number, _, fields = line.partition(":")
        controllers, _, path = fields.partition(":")
        if number == "0" and not controllers:
            mount, names = root / "sys/fs/cgroup", ("memory.max", "memory.current")
        elif "memory" in controllers.split(","):
            mount = root / "sys/fs/cgroup/memory"
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes")
        else:
            continue
        here = Path(path.lstrip("/"))
        # the directory of the control group may be invisible in a container
        for folder in (here, *here.parents):
            limit, used = (_read_number(mount / folder / name) for name in names)
            if limit is None or used is None or limit >= UNLIMITED_BYTES:
                continue
            stat = mount / folder / "memory.stat"
            files = (
                _read_field(stat, "inactive_file")
                or _read_field(stat, "total_inactive_file")
                or 0.0
            )
            yield limit - used + files


def _list_ulimit_memory(root: Path) -> Iterator[float]:
    """Yield the memory [bytes] that the limits of ``ulimit`` still permit.

    The limits apply to the address space and to the data segment.
    """
    try:
        import resource
    except ImportError:  # Windows has no such limits
        return
    status = root / "proc/self/status"
    for kind, field in (("RLIMIT_AS", "VmSize:"), ("RLIMIT_DATA", "VmData:")):
        limit = resource.getrlimit(getattr(resource, kind))[0]
        used = _read_field(status, field)
        if limit != resource.RLIM_INFINITY and used is not None:
            yield limit - 1024.0 * used


def _read_field(path: Path, name: str) -> float | None:
    """Return the number that follows the given name on a line of a file."""
    for line in _read_text(path).splitlines():
        words = line.split()
        if len(words) > 1 and words[0] == name:
            return float(words[1])
    return None


def _read_number(path: Path) -> float | None:
    """Return the whole number in a file; None if the file contains anything else."""
    text = _read_text(path).strip()
    return float(text) if text.isdigit() else None


def _read_text(path: Path) -> str:
    """Return the text of a file; return an empty text if the file is unreadable."""
    try:
        return path.read_text(encoding="ascii")
    except (OSError, UnicodeDecodeError):
        return ""
