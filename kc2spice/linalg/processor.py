"""Choice of OpenBLAS kernels for processors that are newer than the OpenBLAS library.

The OpenBLAS in cvxopt supports processors up to 2021. On a newer Intel processor, OpenBLAS uses
kernels from 2004. With the kernels from 2004, a Cholesky factor of 103 000 unknowns took 12.5 s of
CPU time; with kernels for AVX-512, it took 4.4 s.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# environment variable that OpenBLAS reads when it is loaded
CORE_TYPE_VARIABLE = "OPENBLAS_CORETYPE"
# kernels of OpenBLAS and the processor instructions that they need, fastest kernels first
KERNELS = {
    "SkylakeX": {"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl", "fma", "avx2"},
    "Haswell": {"fma", "avx2"},
}
# File of processor flags, only on Linux. On other systems, OpenBLAS selects the kernels itself.
_CPU_INFO = Path("/proc/cpuinfo")


def select_kernels(flags: set[str]) -> str | None:
    """Return the name of the fastest kernels for a set of processor instructions.

    Return None if the processor lacks the instructions that the kernels need.

    Examples
    --------
    >>> select_kernels({"sse2", "avx2", "fma"})
    'Haswell'
    """
    return next((name for name, needed in KERNELS.items() if needed <= flags), None)


def read_processor_flags() -> set[str]:
    """Return the names of the instructions that the processor and the system support.

    The set is empty if the operating system does not list the instructions.
    """
    try:
        lines = _CPU_INFO.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return set()
    return set(next((line for line in lines if line.startswith("flags")), "").split())


@contextmanager
def use_fast_kernels() -> Iterator[None]:
    """Make a library that is imported within this context use the fastest OpenBLAS kernels.

    If the user has set the environment variable ``OPENBLAS_CORETYPE``, this variable selects the
    kernels instead.
    """
    kernels = None if CORE_TYPE_VARIABLE in os.environ else select_kernels(read_processor_flags())
    if kernels is None:
        yield
        return
    os.environ[CORE_TYPE_VARIABLE] = kernels
    try:
        yield
    finally:
        del os.environ[CORE_TYPE_VARIABLE]
