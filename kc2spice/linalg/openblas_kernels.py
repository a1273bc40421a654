"""Choice of OpenBLAS kernels for processors that are newer than OpenBLAS.

The OpenBLAS in cvxopt supports processors up to 2021. On newer Intel processors, OpenBLAS selects
kernels from 2004. With the kernels from 2004, the Cholesky factorisation of 103 000 equations took
12.5 s of CPU time, compared with 4.4 s with the AVX-512 kernels.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# environment variable that OpenBLAS reads at import
CORE_TYPE_VARIABLE = "OPENBLAS_CORETYPE"
# processor instructions that the OpenBLAS kernels need, keyed by kernel name, fastest kernels first
KERNELS = {
    "SkylakeX": {"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl", "fma", "avx2"},
    "Haswell": {"fma", "avx2"},
}
# File with the processor flags. The file exists only on Linux, and OpenBLAS selects the kernels on
# other systems.
_CPU_INFO = Path("/proc/cpuinfo")


def select_kernels(flags: set[str]) -> str | None:
    """Return the name of the fastest OpenBLAS kernels for a processor's instructions.

    Return None if the processor supports none of the kernels.

    Examples
    --------
    >>> select_kernels({"sse2", "avx2", "fma"})
    'Haswell'
    """
    return next((name for name, needed in KERNELS.items() if needed <= flags), None)


def read_processor_flags() -> set[str]:
    """Return the names of the instructions that this processor supports.

    Both the processor and the operating system support the returned instructions. The set is empty
    if the operating system does not list the instructions.
    """
    try:
        lines = _CPU_INFO.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return set()
    return set(next((line for line in lines if line.startswith("flags")), "").split())


@contextmanager
def use_fast_kernels() -> Iterator[None]:
    """Select the fastest OpenBLAS kernels for libraries imported within this context.

    The environment variable ``OPENBLAS_CORETYPE`` has precedence if the user has set it.
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
