"""Direct solvers that users supply instead of the built-in solvers.

A solver is a function or class that factorises a sparse matrix. :func:`use_solver` selects a solver
for all factorisations within a context, and :mod:`kc2spice.linalg.factor` uses the selected solver.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Protocol, TypeAlias

import numpy as np

from kc2spice.core.errors import Kc2spiceError, SimulationError, UsageError, unknown

_SUPPORTED_SOLVERS = (
    "'pardiso', or a function of one sparse matrix that returns an object with solve(rhs), such as "
    "scipy.sparse.linalg.splu"
)


class Factorisation(Protocol):
    """Interface of a factorised matrix A, which a direct solver returns.

    For a real symmetric matrix, the optional attribute ``negative_eigenvalues`` is the number of
    negative eigenvalues, or of negative pivots in the LDL' factorisation.
    """

    def solve(self, rhs: np.ndarray, /) -> np.ndarray:
        """Solve ``A x = rhs`` for right-hand sides (n, k).

        ``rhs`` is a dense array with the data type of A.
        """
        ...


PARDISO = "pardiso"
SOLVERS = (PARDISO,)  # names of direct solvers that users can select
DirectSolver: TypeAlias = Callable[[Any], Factorisation]
_supplied: ContextVar[DirectSolver | None] = ContextVar("solver", default=None)


@contextmanager
def use_solver(solver: DirectSolver | str | None) -> Iterator[None]:
    """Use a direct solver for all factorisations within this context.

    The name ``"pardiso"`` selects :class:`kc2spice.linalg.pardiso.Pardiso`. If ``solver`` is None,
    the solver of the enclosing context remains selected. If ``solver`` is None and there is no
    enclosing context, the built-in solver is used.

    Raises
    ------
    UsageError : raised if ``solver`` is neither a function or class nor the name of a direct
        solver.
    MissingToolError : the library of the solver is not installed.
    """
    if solver is None:
        yield
        return
    if solver == PARDISO:
        from kc2spice.linalg.pardiso import Pardiso, require_library  # an optional package

        require_library()
        solver = Pardiso
    if not callable(solver):
        got = repr(solver)[:120]
        raise UsageError(
            "this object is not a direct solver",
            where="solver",
            got=got,
            expected=_SUPPORTED_SOLVERS,
            hint="omit the argument solver to use the built-in solvers",
        )
    token = _supplied.set(solver)
    try:
        yield
    finally:
        _supplied.reset(token)


def require_solver(name: str | None, where: str) -> str | None:
    """Check that a direct solver with this name exists, and return the name.

    Raises
    ------
    UsageError : the solver does not exist; ``where`` is the command-line option that states the
        name.
    """
    if name is not None and name not in SOLVERS:
        raise unknown(
            "this direct solver does not exist",
            name,
            SOLVERS,
            where,
            advice=f"leave out {where}, so that the built-in solvers are used",
        )
    return name


def get_selected_solver() -> DirectSolver | None:
    """Return the direct solver that the user selected, or None for built-in solvers."""
    return _supplied.get()


def factorise_with_solver(solver: DirectSolver, matrix: Any) -> Factorisation:
    """Factorise a sparse matrix with the user's solver.

    Raises
    ------
    SimulationError : the solver reports a numerical failure, such as a singular matrix.
    UsageError : the solver raises any other error, or its result has no method ``solve``.
    """
    factor = _call_user_function(solver, matrix)
    if not callable(getattr(factor, "solve", None)):
        raise UsageError(
            "the solver did not return a factorised matrix",
            where="solver",
            got=f"{type(factor).__name__} without a method solve",
            expected=_SUPPORTED_SOLVERS,
        )
    return factor


def solve_with_factor(factor: Factorisation, matrix: Any, rhs: np.ndarray) -> np.ndarray:
    """Solve for right-hand sides (n,) or (n, k) with the user's factorised matrix.

    Raises
    ------
    SimulationError : the solver reports a numerical failure.
    UsageError : the solver raises any other error, or the solution has a wrong shape.
    """
    columns = np.asarray(rhs).reshape(len(rhs), -1).astype(matrix.dtype, casting="safe")
    x = np.asarray(_call_user_function(factor.solve, columns))
    if x.shape != columns.shape or x.dtype.kind not in "fc":
        raise UsageError(
            "the solver returned an array of a wrong type or shape",
            where="solver",
            got=f"an array of {x.dtype} and shape {x.shape}",
            expected=f"an array of {columns.dtype} and shape {columns.shape}",
        )
    return x.reshape(rhs.shape)


def _call_user_function(function: Callable[[Any], Any], argument: Any) -> Any:
    """Call a function of the user's solver, and convert exceptions to kc2spice errors."""
    try:
        return function(argument)
    except Kc2spiceError:
        raise
    except (RuntimeError, ArithmeticError, np.linalg.LinAlgError, MemoryError) as error:
        raise SimulationError(
            "the direct solver reports a numerical failure",
            where="solver",
            got=f"{type(error).__name__}: {error}",
        ) from error
    except Exception as error:
        raise UsageError(
            "the direct solver ended with an error",
            where="solver",
            got=f"{type(error).__name__}: {error}",
            expected=_SUPPORTED_SOLVERS,
        ) from error
