"""Tasks of reductors, and bases that define the reduced models of every order.

A reduction has two steps (Lehner and Eberhard, Multibody Syst. Dyn. 17 (2007) 157). The first step
makes an intermediate model that is far more accurate than the tolerance. The second step computes a
basis of the intermediate model. The projection on the first q vectors of the basis is the reduced
model of order q.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, TypeVar, cast

import numpy as np
import scipy

from kc2spice.core.errors import UsageError
from kc2spice.rom.error_estimate import ErrorEstimator
from kc2spice.rom.intermediate_model import IntermediateModel
from kc2spice.rom.linear_model import LinearModel, Norm, make_linear_model
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.reductors.basis_vectors import (
    improve_conditioning,
    require_vectors,
    scale_to_unit_norm,
)
from kc2spice.rom.response import Response
from kc2spice.rom.stability import StabilityProof, prove_stability
from kc2spice.rom.state_space import restore_time_unit, to_schur_form

# Smallest error estimate. The responses of direct solutions are hardly more accurate than this.
MIN_ERROR_ESTIMATE = 1e-11
# Safety factor of errors at sample frequencies, because errors between samples may be larger.
# With the factor 1.15, error estimates of 500 random models are one to three times the true errors.
# The test of SAFETY_FACTOR is in tests/physics/test_certificates.py.
SAFETY_FACTOR = 1.15

T = TypeVar("T")
Coordinates = Literal["intermediate", "first order", "full order"]
# largest distance of a linearly dependent vector from the span of earlier vectors, relative to its
# norm
DEPENDENT_VECTOR = 1e-10


@dataclass(frozen=True)
class ReductionTask:
    """Reduction task: full-order model, intermediate model, estimator and tolerance.

    ``fom`` is the full-order model to be reduced, and ``intermediate`` its intermediate model.
    ``pencil`` contains the matrices of the full-order model after constraints and infinite poles
    are eliminated. The ``estimator`` computes errors in a band and a norm. The ``tolerance`` is
    None if the order is prescribed. ``shared`` contains computed values that are the same for all
    tolerances; :meth:`get_shared_value` adds the values.

    Examples
    --------
    A reductor uses ``task.model`` and returns ``task.project(V)``; see :class:`Reductor`.
    """

    fom: LinearModel
    pencil: Pencil
    intermediate: IntermediateModel
    estimator: ErrorEstimator
    tolerance: float | None = None
    shared: dict[str, Any] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def from_models(
        cls,
        fom: LinearModel,
        pencil: Pencil,
        intermediate: IntermediateModel,
        band: tuple[float, float],
        norm: Norm,
        tolerance: float | None = None,
    ) -> ReductionTask:
        """Create a reduction task from the models, with a given band [Hz] and norm."""
        return cls(fom, pencil, intermediate, intermediate.make_estimator(band, norm), tolerance)

    @property
    def band(self) -> tuple[float, float]:
        """Lowest and highest frequency [Hz] of the band."""
        return self.estimator.band

    @property
    def norm(self) -> Norm:
        """Norm in which errors are measured."""
        return self.estimator.norm

    @property
    def response(self) -> Response:
        """Frequency response of the intermediate model."""
        return self.intermediate.response

    @property
    def pencil_without_rigid_modes(self) -> Pencil:
        """Pencil of the intermediate model after removal of the rigid-body modes.

        If damping couples rigid-body modes to other motions, the matrices include the rigid-body
        modes.
        """
        return self.response.core

    @property
    def is_collocated(self) -> bool:
        """Whether the matrices of the model are symmetric and ``C = B'``."""
        return self.pencil.is_symmetric and self.pencil.is_collocated

    @property
    def state_count(self) -> int:
        """Number of first-order states of the intermediate model."""
        return self.response.pencil.size * self.response.pencil.degree

    def get_shared_value(self, name: str, compute: Callable[[], T]) -> T:
        """Get the value ``name`` that several tasks share; compute it at the first call.

        Tasks of the same model that differ only in the tolerance share the value.
        """
        if name not in self.shared:
            self.shared[name] = compute()
        return cast(T, self.shared[name])

    @property
    def model(self) -> LinearModel:
        """Intermediate model as a ``LinearModel``, without rigid-body modes.

        The matrices are dense, and equal to :attr:`pencil_without_rigid_modes`: ``M E K B C D``, or
        ``A E B C D`` for a first-order model.
        """
        core, fom = self.pencil_without_rigid_modes, self.fom
        return self.get_shared_value(
            "model", lambda: make_linear_model(core, ports=fom.ports, name=fom.name)
        )

    @property
    def first_order_response(self) -> Response:
        """Response of the first-order form ``x' = A x + B u``, without rigid-body modes.

        All rates are divided by the angular frequency at the end of the band.
        """
        return self.get_shared_value(
            "first order",
            lambda: Response(to_schur_form(self.pencil_without_rigid_modes, self.band[1])),
        )

    @property
    def proof(self) -> StabilityProof:
        """Proof of stability and passivity of the intermediate model."""
        return self.get_shared_value(
            "proof", lambda: prove_stability(self.response.pencil, self.band)
        )

    def project(
        self, V: np.ndarray, W: np.ndarray | None = None, *, fixed: int = 0
    ) -> ReducedBasis:
        """Project the model on the basis V by a Galerkin or Petrov-Galerkin projection.

        Parameters
        ----------
        V : (n, k) array
            Real basis vectors, the most important vector first. The model of order q uses the first
            q vectors. The scale of the columns has no effect, because all columns are scaled to
            norms near one. Columns that are almost linearly dependent are orthogonalised one after
            another.
        W : (n, k) array, optional
            Real test vectors, by default V. With W = V, the projection is a congruence, which
            preserves symmetry, stability and passivity of definite matrices.
        fixed : int
            Number of leading vectors that every reduced model contains.

        Raises
        ------
        UsageError : V or W is not a real matrix of finite numbers, has a wrong number of rows, or
            has linearly dependent columns. The error also occurs if ``fixed`` exceeds the number of
            columns.
        """
        V = require_vectors(V, "V", (self.pencil_without_rigid_modes.size, None))
        W = None if W is None else require_vectors(W, "W", V.shape)
        if not isinstance(fixed, int | np.integer) or not 0 <= fixed <= V.shape[1]:
            raise UsageError(
                "the argument `fixed` is not a valid number of leading vectors",
                where="fixed",
                got=repr(fixed),
                expected=f"a whole number from 0 to {V.shape[1]}, the number of columns of V",
            )
        if (
            free := self.pencil_without_rigid_modes.free
        ):  # rigid-body modes that damping couples to other motions
            others = _mask_independent_columns(V, free)
            fixed = int(others[:fixed].sum())
            V = scipy.linalg.block_diag(np.eye(free), V[free:, others])
            W = None if W is None else scipy.linalg.block_diag(np.eye(free), W[free:, others])
        V = improve_conditioning(scale_to_unit_norm(V))
        if W is None:
            pencil = self.pencil_without_rigid_modes.project(V)
        else:
            W = improve_conditioning(scale_to_unit_norm(W))
            parts = tuple(W.T @ P @ V for P in self.pencil_without_rigid_modes.coefficients)
            pencil = Pencil(
                parts,
                W.T @ self.pencil_without_rigid_modes.B,
                self.pencil_without_rigid_modes.C @ V,
                self.pencil_without_rigid_modes.D,
                free=free,
            )
        pencil, vectors = self.prepend_rigid_modes(pencil), self.add_rigid_body_vectors(V)
        fixed += pencil.free
        return ReducedBasis(self, pencil, fixed, congruence=W is None, vectors=vectors)

    def prepend_rigid_modes(self, pencil: Pencil) -> Pencil:
        """Prepend the rigid-body modes to the unknowns of a model without these modes."""
        if self.pencil_without_rigid_modes is self.response.pencil:
            return pencil
        return pencil.prepend_rigid_body_modes(
            self.response.pencil.truncate_to_order(self.response.pencil.free)
        )

    def add_rigid_body_vectors(self, V: np.ndarray) -> np.ndarray:
        """Extend basis vectors V by the rigid-body modes of the intermediate model.

        The rigid-body modes are the first vectors in the result.
        """
        free = self.response.pencil.size - self.pencil_without_rigid_modes.size
        return np.asarray(scipy.linalg.block_diag(np.eye(free), V)) if free else V

    @cached_property
    def state_to_unknowns(self) -> np.ndarray | None:
        """Matrix that computes the unknowns of the intermediate model from its states.

        The states belong to the first-order equations of the intermediate model. In the first-order
        equations, time is multiplied by the angular frequency at the end of the band. The matrix is
        None if the unknowns also depend directly on the input.
        """
        pencil, free = (
            self.response.pencil,
            self.response.pencil.size - self.pencil_without_rigid_modes.size,
        )
        parts = (
            [pencil.truncate_to_order(free), self.pencil_without_rigid_modes]
            if free
            else [self.pencil_without_rigid_modes]
        )
        rows = []
        for part in parts:
            size = part.size
            observed = replace(part, C=np.eye(size), D=np.zeros((size, part.B.shape[1])))
            observed = to_schur_form(observed, self.band[1])
            if observed.D.any():
                return None
            rows.append(observed.C)
        return np.asarray(scipy.linalg.block_diag(*rows))

    def restore_units_and_rigid_modes(self, pencil: Pencil) -> Pencil:
        """Restore SI units and rigid-body modes in a projected first-order model."""
        if free := self.response.pencil.free:
            rigid = to_schur_form(self.response.pencil.truncate_to_order(free), self.band[1])
            pencil = pencil.prepend_rigid_body_modes(rigid)
        return restore_time_unit(pencil, self.band[1])


def _mask_independent_columns(V: np.ndarray, free: int) -> np.ndarray:
    """Return a mask of the columns of V that do not depend on earlier columns.

    The first ``free`` rows are ignored.
    """
    distance = np.abs(np.diag(np.linalg.qr(V[free:], mode="r")))
    result = np.zeros(V.shape[1], dtype=bool)
    result[: distance.size] = (
        distance > DEPENDENT_VECTOR * np.linalg.norm(V, axis=0)[: distance.size]
    )
    return result


@dataclass(frozen=True, eq=False)
class ReducedBasis:
    """Projection of a model on a basis, with the most important basis vector first.

    The matrices of the reduced-order model of order q are the leading q x q blocks of the
    ``pencil``. Every reduced model contains the first ``fixed`` unknowns: rigid-body modes, and
    static responses of conservative ports. If ``congruence`` is true, the projection preserves the
    symmetry and definiteness of the matrices. The certificate's description of the method begins
    with the text ``origin``. ``method`` is the name of the reduction method. ``vectors`` contains
    the basis vectors as columns, or is None if the basis vectors are unknown. ``coordinates`` names
    the model in whose unknowns the basis vectors are expressed.
    """

    task: ReductionTask
    pencil: Pencil
    fixed: int = 0
    origin: str = ""
    congruence: bool = True
    vectors: np.ndarray | None = None
    coordinates: Coordinates = "intermediate"
    method: str = ""

    def copy_with_method(self, method: str) -> ReducedBasis:
        """Return a copy of the basis that contains the name of its reduction method.

        The copy also contains the responses that were already computed for the basis.
        """
        result = replace(self, method=method)
        result.responses.update(self.responses)
        return result

    @property
    def size(self) -> int:
        """Largest order of a reduced model: the number of basis vectors."""
        return self.pencil.size

    def count_states(self, order: int) -> int:
        """Count the first-order states of a reduced model with ``order`` unknowns."""
        return order * self.pencil.degree

    @property
    def has_only_real_poles(self) -> bool:
        """Whether all poles of the reduced models are known to be real.

        The poles are known to be real if the model is symmetric, collocated and of first order. A
        congruence preserves the real poles and the passivity of a symmetric, collocated model of
        first order.
        """
        return self.pencil.degree == 1 and self.pencil.is_symmetric and self.pencil.is_collocated

    def get_response_of_order(self, order: int) -> Response:
        """Return the frequency response of the reduced model of a given order."""
        if order not in self.responses:
            self.responses[order] = Response(self.pencil.truncate_to_order(order))
        return self.responses[order]

    @cached_property
    def responses(self) -> dict[int, Response]:
        """Responses computed so far, keyed by the order of the reduced model."""
        return {}

    def expand_basis(self, order: int) -> np.ndarray | None:
        """Express the first ``order`` basis vectors in unknowns of the full-order model.

        The result has the shape (n, order). The result is None if the vectors are unknown, or
        cannot be expressed in unknowns of the full-order model.
        """
        task, V = self.task, self.vectors
        if V is None or task.pencil.size != task.fom.order:
            return None
        V = V[:, :order]
        if self.coordinates == "full order":
            return V
        if self.coordinates == "first order":
            if task.state_to_unknowns is None:
                return None
            V = task.state_to_unknowns @ V
        frame = task.intermediate.basis
        return None if frame is None else np.asarray(frame @ V)

    def estimate_model_error(self, order: int, limit: float = np.inf) -> float:
        """Estimate the largest relative error of the model of a given order in the band.

        The result is the largest error of any transfer function. If this error exceeds ``limit``,
        the result may be any number above ``limit``.
        """
        exact = self.task.intermediate.error
        difference = self.task.estimator.estimate_model_error(
            self.get_response_of_order(order), (limit - exact) / SAFETY_FACTOR
        )
        return max(exact + SAFETY_FACTOR * difference, MIN_ERROR_ESTIMATE)

    def prove_order_stability(self, order: int) -> StabilityProof:
        """Prove the stability and passivity of the reduced model of a given order."""
        response = self.get_response_of_order(order)
        poles = None if response.has_decoupling_congruence else response.poles
        return prove_stability(response.pencil, self.task.band, poles)

    @cached_property
    def requires_stability(self) -> bool:
        """Whether the reduction basis requires every reduced model to be stable.

        Reduced models need not be stable if the projection is a congruence, and the reduced model
        of the largest order is unstable.
        """
        return not self.congruence or self.prove_order_stability(self.size).stable is not False

    def is_acceptable(self, order: int, tolerance: float) -> bool:
        """Return whether the reduced model of a given order is accurate enough and stable.

        A reduced model of a stable intermediate model must be stable. Only the result of a
        congruence may lack a proof of stability.
        """
        if not self.estimate_model_error(order, tolerance) <= tolerance:
            return False
        stable = self.prove_order_stability(order).stable
        if self.congruence:
            return stable is not False or not self.requires_stability
        return bool(stable)
