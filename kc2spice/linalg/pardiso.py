"""MKL PARDISO as direct solver, through the optional library pypardiso.

Nested dissection and supernodes: on solids it needs far less memory and time than SuperLU, and it
runs on ``MKL_NUM_THREADS`` cores. Symmetric matrices are stored by their upper triangle.
"""

from __future__ import annotations

import weakref
from typing import Any

import numpy as np
import scipy

from kc2spice.core.errors import MissingToolError
from kc2spice.linalg.memory import require_bytes

# Matrix types of PARDISO: (symmetric, complex) -> mtype; a definite one has its own.
_TYPES = {(True, False): -2, (True, True): 6, (False, False): 11, (False, True): 13}
_DEFINITE = 2
_ANALYSIS, _FACTOR, _SOLVE = 11, 22, 33
_TRANSPOSED = 12  # iparm: 0 solves with A, 2 with A'
# iparm, in kB: peak of the analysis, what it keeps, and what factors and solution will take.
_PEAK, _KEPT, _NUMERIC = 15, 16, 17


class Pardiso:
    """Factors of one matrix, real or complex; its memory is released with the object.

    Raises
    ------
    MissingToolError : pypardiso is not installed.
    UsageError : the analysis shows that the factors will not fit into memory.
    RuntimeError : singular, or not positive definite where ``definite`` was promised.
    """

    def __init__(
        self, matrix: scipy.sparse.csc_array, *, symmetric: bool, definite: bool = False
    ) -> None:
        pypardiso = _library()
        kind = _TYPES[symmetric, matrix.dtype.kind == "c"]
        self._solver = pypardiso.PyPardisoSolver(mtype=_DEFINITE if definite else kind)
        weakref.finalize(self, self._solver.free_memory, everything=True).atexit = False
        self._error = pypardiso.pardiso_wrapper.PyPardisoError
        self._matrix = _upper(matrix) if symmetric else scipy.sparse.csr_array(matrix)
        self._matrix.sort_indices()
        unused = np.zeros((matrix.shape[0], 1), dtype=matrix.dtype)
        self._call(_ANALYSIS, unused)
        kilobytes = {key: int(self._solver.get_iparm(key)) for key in (_PEAK, _KEPT, _NUMERIC)}
        require_bytes(
            1024.0 * max(kilobytes[_PEAK], kilobytes[_KEPT] + kilobytes[_NUMERIC]),
            f"{matrix.shape[0]} factorised equations",
            where="pardiso",
            hint="use a coarser mesh, or a machine with more memory",
        )
        self._call(_FACTOR, unused)

    def solve(self, rhs: np.ndarray, *, transposed: bool = False) -> np.ndarray:
        """Solve with the matrix or its transpose for (n,) or (n, k) right-hand sides."""
        self._solver.set_iparm(_TRANSPOSED, 2 if transposed else 0)
        rhs = np.asarray(rhs).astype(self._matrix.dtype, order="F", casting="safe")
        return self._call(_SOLVE, rhs) if rhs.size else rhs

    def _call(self, phase: int, rhs: np.ndarray) -> np.ndarray:
        self._solver.set_phase(phase)
        try:
            return np.asarray(self._solver._call_pardiso(self._matrix, rhs))
        except self._error as error:
            raise RuntimeError(f"PARDISO error {error.value}") from error


def _library() -> Any:
    try:
        import pypardiso
    except ImportError:
        raise MissingToolError(
            "pypardiso is not installed",
            where="solver",
            got="pardiso",
            hint="pip install 'kc2spice[fast]', or use the solver 'scipy'",
        ) from None
    return pypardiso


def _upper(matrix: scipy.sparse.csc_array) -> scipy.sparse.csr_array:
    """Upper triangle with every diagonal entry stored, zero or not, as PARDISO demands."""
    n = np.arange(matrix.shape[0])
    part = scipy.sparse.coo_array(scipy.sparse.triu(matrix))
    row, column = np.r_[part.row, n], np.r_[part.col, n]
    data = np.r_[part.data, np.zeros(n.size, dtype=matrix.dtype)]
    return scipy.sparse.csr_array((data, (row, column)), shape=matrix.shape)
