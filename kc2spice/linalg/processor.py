"""Choice of OpenBLAS kernels for processors that are newer than the library.

The OpenBLAS in cvxopt supports processors up to 2021. On a newer Intel processor it falls back to
kernels of 2004: a Cholesky factor of 103 000 unknowns took 12.5 s of CPU, and 4.4 s with kernels
for AVX-512.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# environment variable that OpenBLAS reads when it is loaded
CORE_TYPE_VARIABLE = "OPENBLAS_CORETYPE"
# processor families of OpenBLAS and the instructions that they need, fastest first
KERNELS = {
    "SkylakeX": {"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl", "fma", "avx2"},
    "Haswell": {"fma", "avx2"},
}
# exists on Linux only; other systems select the kernels themselves
_CPU_INFO = Path("/proc/cpuinfo")


def select_kernels(flags: set[str]) -> str | None:
    """Return the fastest kernels for these instructions, None without suitable kernels.

    Examples
    --------
    >>> select_kernels({"sse2", "avx2", "fma"})
    'Haswell'
    """
    return next((name for name, needed in KERNELS.items() if needed <= flags), None)


def processor_flags() -> set[str]:
    """Return the instructions that processor and system support, none if unknown."""
    try:
        lines = _CPU_INFO.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return set()
    return set(next((line for line in lines if line.startswith("flags")), "").split())


@contextmanager
def use_fast_kernels() -> Iterator[None]:
    """Let a library that is imported in this context use the kernels of the processor.

    A choice of the user in the environment has priority.
    """
    kernels = None if CORE_TYPE_VARIABLE in os.environ else select_kernels(processor_flags())
    if kernels is None:
        yield
        return
    os.environ[CORE_TYPE_VARIABLE] = kernels
    try:
        yield
    finally:
        del os.environ[CORE_TYPE_VARIABLE]
