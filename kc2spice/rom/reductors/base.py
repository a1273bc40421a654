"""Base class of model order reduction methods."""

from __future__ import annotations

import traceback
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from kc2spice.core.errors import Kc2spiceError, UsageError
from kc2spice.rom.reduced_basis import ReducedBasis, ReductionTask


class Reductor(ABC):
    """Reduction method: a basis whose leading vectors define reduced-order models.

    A subclass has a ``name``, a literature ``reference`` and the method :meth:`basis`. The choice
    of the order, the error estimate and the proofs of stability and passivity are the same for all
    methods. ``congruence`` (by default True) states that the projection is a Galerkin projection,
    which preserves the symmetry and definiteness of the matrices. ``no_basis`` is the reason in
    error messages if
    :meth:`basis` returns None.

    Examples
    --------
    Modal truncation retains the modes of lowest frequency. Three springs of 1 N/m in series have a
    compliance of 3 m/N at the end. The lowest mode alone has a compliance of 2.742 m/N.

    >>> import numpy as np
    >>> import kc2spice as kc
    >>> from scipy.linalg import eigh
    >>> class ModalTruncation(kc.Reductor):
    ...     name = "modal truncation"
    ...     reference = "Craig and Kurdila, Fundamentals of Structural Dynamics (2006), chapter 11"
    ...     def basis(self, task):
    ...         return task.project(eigh(task.model.K, task.model.M)[1])
    >>> K = np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
    >>> chain = kc.LinearModel(M=np.eye(3), K=K, B=np.eye(3)[:, 2:])
    >>> rom = kc.reduce(chain, order=1, band=(0, 0.1), method=ModalTruncation())
    >>> print(f"{rom.transfer([0.0])[0, 0, 0].real:.3f}")
    2.742
    """

    name: str = ""
    reference: str = ""
    congruence: bool = True
    no_basis: str = "its basis() returns None"

    def obstacle(self, task: ReductionTask) -> str:
        """Explain why the method does not apply to the model; return "" if it applies."""
        return ""

    def applies_to(self, task: ReductionTask) -> bool:
        """Return whether the method applies to the model of a task.

        By default, a method applies if :meth:`obstacle` returns "".
        """
        return not self.obstacle(task)

    @abstractmethod
    def basis(self, task: ReductionTask) -> ReducedBasis | None:
        """Return the reduction basis, or None if the method cannot compute a basis.

        The basis is usually ``task.project(V)`` with basis vectors V.

        Parameters
        ----------
        task : ReductionTask Model and required accuracy. ``task.model`` contains the dense matrices
            to be projected. The coordinates of these matrices may differ from the unknowns of the
            full-order model. ``task.band``, ``task.norm`` and ``task.tolerance`` are the required
            accuracy.
        """

    def shorten_basis(
        self, basis: ReducedBasis, order: int, tolerance: float
    ) -> tuple[ReducedBasis, int]:
        """Shorten a basis if the tolerance permits; return the basis and its order.

        By default, the method returns the arguments ``basis`` and ``order``.
        """
        return basis, order


@contextmanager
def describe_errors_in_method(reductor: Reductor) -> Iterator[None]:
    """Describe an exception in the code of a user's reduction method as UsageError.

    Errors of kc2spice and exhausted memory pass unchanged.

    Raises
    ------
    UsageError : the ``with`` block raises another exception.
    """
    try:
        yield
    except (Kc2spiceError, MemoryError):
        raise
    except Exception as error:
        # the third frame, below this function and the ``with`` block, is that of the user
        frames = traceback.extract_tb(error.__traceback__)[2:3]
        name = frames[0].name if frames else "the class"
        place = type(reductor).__name__
        if frames:
            place = f"line {frames[0].lineno} of {frames[0].filename}"
        raise UsageError(
            f"{name} of this reduction method raises {type(error).__name__}: {error}",
            where=f"method {reductor.name!r}",
            hint=f"correct {place}",
        ) from error


def require_basis(reductor: Reductor, result: Any) -> ReducedBasis | None:
    """Require that ``result`` of :meth:`Reductor.basis` is a reduced basis or None.

    Raises
    ------
    UsageError : the value is neither a basis nor None, or the method declares a congruence but the
        projection is not a congruence.
    """
    if result is None:
        return None
    if not isinstance(result, ReducedBasis):
        raise UsageError(
            "the method basis() does not return a basis",
            got=f"{type(result).__name__} of shape {np.shape(result)}"
            if isinstance(result, np.ndarray)
            else type(result).__name__,
            expected="what task.project(V) returns, or None",
            hint="end basis() with: return task.project(V)",
        )
    if reductor.congruence and not result.congruence:
        raise UsageError(
            "test vectors W cannot be combined with congruence = True",
            got="task.project(V, W) with congruence = True",
            expected="task.project(V), or congruence = False in the class",
            hint="write congruence = False below the name of the class",
        )
    return result
