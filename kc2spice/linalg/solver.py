"""Direct solvers that users supply instead of the built-in solvers.

A solver is a function or class that factorises one sparse matrix. :func:`solving_with` selects it
for all factors within the context. :mod:`kc2spice.linalg.factor` obtains the solver here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Protocol, TypeAlias

import numpy as np

from kc2spice.core.errors import Kc2spiceError, SimulationError, UsageError, unknown

HOW = (
    "'pardiso', or a class with solve(rhs), made from one sparse matrix, such as "
    "scipy.sparse.linalg.splu"
)


class Factorisation(Protocol):
    """A factorised matrix A.

    An attribute ``negative_eigenvalues`` is optional. The number is the number of negative
    eigenvalues of a real symmetric matrix, which is the number of negative pivots of an LDL'
    factor.
    """

    def solve(self, rhs: np.ndarray, /) -> np.ndarray:
        """Return ``A^-1 rhs`` (n, k) of a dense ``rhs`` (n, k) of the type of the matrix."""
        ...


PARDISO = "pardiso"
SOLVERS = (PARDISO,)  # names of solvers
DirectSolver: TypeAlias = Callable[[Any], Factorisation]
_supplied: ContextVar[DirectSolver | None] = ContextVar("solver", default=None)


@contextmanager
def solving_with(solver: DirectSolver | str | None) -> Iterator[None]:
    """Use ``solver`` for all factors that are made meanwhile.

    The name ``"pardiso"`` selects :class:`kc2spice.linalg.pardiso.Pardiso`. With None, the
    solver of the surrounding context remains, by default the built-in solvers.

    Raises
    ------
    UsageError : the solver is not a function, a class or a known name.
    MissingToolError : the library of the solver is not installed.
    """
    if solver is None:
        yield
        return
    if solver == PARDISO:
        from kc2spice.linalg.pardiso import Pardiso, require_library  # an optional one

        require_library()
        solver = Pardiso
    if not callable(solver):
        got = repr(solver)[:120]
        raise UsageError(
            "this object is not a direct solver",
            where="solver",
            got=got,
            expected=HOW,
            hint="leave out solver: SuperLU then factorises the matrices",
        )
    token = _supplied.set(solver)
    try:
        yield
    finally:
        _supplied.reset(token)


def require_solver(name: str | None, where: str) -> str | None:
    """Check the name of a solver of the command line, and return the name.

    Raises
    ------
    UsageError : the solver does not exist; ``where`` is the option.
    """
    if name is not None and name not in SOLVERS:
        raise unknown("this direct solver does not exist", name, SOLVERS, where)
    return name


def supplied_solver() -> DirectSolver | None:
    """Return the solver that :func:`solving_with` selected, None for the built-in solvers."""
    return _supplied.get()


def factorise_by(solver: DirectSolver, matrix: Any) -> Factorisation:
    """Factorise a sparse matrix by a supplied solver.

    Raises
    ------
    SimulationError : the solver reports a numerical failure, such as a singular matrix.
    UsageError : any other error of the solver, or a result that does not solve the equations.
    """
    factor = _call(solver, matrix)
    if not callable(getattr(factor, "solve", None)):
        got = f"{type(factor).__name__} without a method solve"
        raise UsageError(
            "the solver did not return a factorised matrix", where="solver", got=got, expected=HOW
        )
    return factor


def solve_by(factor: Factorisation, matrix: Any, rhs: np.ndarray) -> np.ndarray:
    """Return the solution of a supplied factor for one (n,) or several (n, k) right-hand sides.

    Raises
    ------
    SimulationError, UsageError : as :func:`factorise_by`, or a solution of another shape.
    """
    columns = np.asarray(rhs).reshape(len(rhs), -1).astype(matrix.dtype, casting="safe")
    x = np.asarray(_call(factor.solve, columns))
    if x.shape != columns.shape or x.dtype.kind not in "fc":
        raise UsageError(
            "the solver returned an array of a wrong type or shape",
            where="solver",
            got=f"an array of {x.dtype} and shape {x.shape}",
            expected=f"an array of {columns.dtype} and shape {columns.shape}",
        )
    return x.reshape(rhs.shape)


def _call(function: Callable[[Any], Any], argument: Any) -> Any:
    """Return the result of a function of the user, and convert its exceptions to errors of
    kc2spice.
    """
    try:
        return function(argument)
    except Kc2spiceError:
        raise
    except (RuntimeError, ArithmeticError, np.linalg.LinAlgError, MemoryError) as error:
        raise SimulationError(
            "the direct solver cannot factorise the matrix",
            where="solver",
            got=f"{type(error).__name__}: {error}",
        ) from error
    except Exception as error:
        raise UsageError(
            "the direct solver ended with an error",
            where="solver",
            got=f"{type(error).__name__}: {error}",
            expected=HOW,
        ) from error
