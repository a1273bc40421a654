"""Iterative rational Krylov algorithm for locally H2-optimal models."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kc2spice.core.user_warnings import warn_user
from kc2spice.rom.pencil import Pencil, make_explicit_pencil
from kc2spice.rom.reduced_basis import ReducedBasis, ReductionTask
from kc2spice.rom.reductors.balanced_truncation import (
    MAX_UNSCALED_STATES,
    NOT_STABLE_TEXT,
    BalancedTruncation,
    explain_no_gramians,
    explain_too_large,
)
from kc2spice.rom.reductors.base import Reductor
from kc2spice.rom.response import Response

POLE_TOLERANCE = 1e-9  # relative change of the poles at which the iteration ends
MAX_ITERATIONS = 100  # largest number of iterations, found by trials
# largest error of a balanced model, relative to the tolerance, at which the iteration is tried
MAX_START_ERROR = 10.0


class Irka(Reductor):
    """Iterative rational Krylov algorithm (IRKA): interpolation at mirrored poles.

    A model of order q with poles ``l_i`` and residues ``c_i b_i^T`` gives the projection ``V
    = [(-l_i - A)^-1 B b_i]`` and ``W = [(-l_i - A)^-T C^T c_i]``. The iteration begins with a model
    of balanced truncation. The poles and residues of each projected model define the next
    projection. The iteration ends when the poles no longer change. The model H_q then meets the
    first-order conditions for the smallest error in the H2 norm::

        H(-l_i) b_i = H_q(-l_i) b_i     c_i^T H(-l_i) = c_i^T H_q(-l_i)
        c_i^T (dH/ds)(-l_i) b_i = c_i^T (dH_q/ds)(-l_i) b_i

    Each order has a separate basis, so a reduction to a tolerance takes longer than a reduction
    with nested bases. The H2 norm includes all frequencies.

    Examples
    --------
    At the mirror image ``-p`` of its pole ``p``, the reduced model with one state has the same
    response as the full model with three states.

    >>> import numpy as np
    >>> import kc2spice as kc
    >>> A, B = np.diag([-1.0, -3.0, -9.0]), np.array([[1.0], [1.0], [1.0]])
    >>> model = kc.LinearModel(A=A, B=B, C=B.T)
    >>> rom = kc.reduce(model, order=1, band=(0, 1), method="IRKA")
    >>> pole = rom.poles()[0].real
    >>> H = [(m.C @ np.linalg.solve(-pole * m.E - m.A, m.B))[0, 0] for m in (model, rom)]
    >>> bool(abs(H[1] / H[0] - 1) < 1e-9)
    True
    """

    name = "IRKA"
    reference = "Gugercin, Antoulas and Beattie, SIAM J. Matrix Anal. Appl. 30 (2008) 609"
    congruence = False
    no_basis = NOT_STABLE_TEXT

    def obstacle(self, task: ReductionTask) -> str:
        """Explain why the method does not apply to the model; return "" if it applies.

        The iteration starts from balanced truncation with unscaled inputs and outputs. Intermediate
        models with more than ``MAX_UNSCALED_STATES`` first-order states are refused, because
        balanced truncation and the iteration would take too long.
        """
        return explain_no_gramians(task) or explain_too_large(
            task.first_order_response.pencil.size, MAX_UNSCALED_STATES
        )

    def basis(self, task: ReductionTask) -> ReducedBasis | None:
        """Return H2-optimal models of all orders, or None if the full model is unstable.

        The returned ``OptimalModels`` object contains one locally H2-optimal reduced model for each
        order. Each reduced model is computed when the response of this model is first requested.
        The result is None if the full model is not strictly stable.
        """
        start = BalancedTruncation(scaled=False).basis(task)
        if start is None:
            return None
        return OptimalModels(task, start.pencil, start.fixed, congruence=False)


@dataclass(frozen=True)
class OptimalModels(ReducedBasis):
    """Reduced models of all orders that are locally optimal in the H2 norm.

    ``pencil`` is the balanced model. The iteration for an order starts from the balanced model that
    is truncated to the order.
    """

    def get_response_of_order(self, order: int) -> Response:
        """Return the response of the optimal model of a given order."""
        if order not in self.responses:
            self.responses[order] = Response(self._compute_optimal_model(order))
        return self.responses[order]

    def is_acceptable(self, order: int, tolerance: float) -> bool:
        """Return whether the model of a given order is stable and within the tolerance.

        If the balanced model of the same order has a large error, the iteration is skipped.
        """
        limit = MAX_START_ERROR * tolerance
        if not self.balanced_models.estimate_model_error(order, limit) <= limit:
            return False
        return super().is_acceptable(order, tolerance)

    @cached_property
    def balanced_models(self) -> ReducedBasis:
        """Reduced models of all orders by balanced truncation, from which IRKA starts."""
        return ReducedBasis(self.task, self.pencil, self.fixed, congruence=False)

    def expand_basis(self, order: int) -> np.ndarray | None:
        """Return None, because the basis is not stored."""
        return None

    def _compute_optimal_model(self, order: int) -> Pencil:
        """Compute the H2-optimal model of a given order from the balanced model."""
        count = order - self.pencil.free
        if count <= 0:
            return self.pencil.truncate_to_order(order)
        full, omega = self.task.first_order_response, 2 * np.pi * self.task.band[1]
        balanced = self.pencil.without_rigid_body_modes.truncate_to_order(count)
        rest, inertia = balanced.coefficients
        reduced = Pencil((rest / omega, inertia), balanced.B / omega, balanced.C, balanced.D)
        former, change = np.full(count, np.inf, dtype=complex), np.inf
        for _ in range(MAX_ITERATIONS):
            poles, left, right = compute_residues(reduced)
            change = float(np.abs(np.sort_complex(poles) / np.sort_complex(former) - 1).max())
            if change <= POLE_TOLERANCE:
                break
            former = poles
            reduced = interpolate_response(full, mirror_poles(poles), left, right)
        else:
            warn_user(
                f"IRKA of order {order} has not converged: the relative change of its poles in "
                f"the last iteration was {change:.1e}; the model is not optimal, but the error "
                f"estimate is valid"
            )
        return self.task.restore_units_and_rigid_modes(reduced)


def compute_residues(pencil: Pencil) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the poles (q,), and c and b of the residues ``c_i b_i'`` at the poles.

    The factors c have the shape (q, outputs), and the factors b have the shape (q, inputs).
    """
    poles, X = np.linalg.eig(-pencil.coefficients[0])
    return poles, (pencil.C @ X).T, np.linalg.solve(X, pencil.B.astype(complex))


def mirror_poles(poles: np.ndarray) -> np.ndarray:
    """Replace each stable pole p by ``-p``, and each unstable pole p by ``conj(p)``."""
    return np.asarray(np.abs(poles.real) - 1j * poles.imag)


def interpolate_response(
    full: Response, shifts: np.ndarray, left: np.ndarray, right: np.ndarray
) -> Pencil:
    """Return the tangential interpolation of ``full`` at ``shifts``."""
    V = _compute_real_basis(shifts, full.states(shifts) @ right[:, :, None])
    W = _compute_real_basis(shifts, full.dual_response.states(shifts) @ left[:, :, None])
    pencil, inner = full.pencil, W.T @ V
    A = np.linalg.solve(inner, W.T @ -pencil.coefficients[0] @ V)
    return make_explicit_pencil(A, np.linalg.solve(inner, W.T @ pencil.B), pencil.C @ V, pencil.D)


def _compute_real_basis(shifts: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return a real orthonormal basis (n, q) of the space of complex ``vectors``."""
    real, pairs = shifts.imag == 0, shifts.imag > 0
    columns = [vectors[real, :, 0].real, vectors[pairs, :, 0].real, vectors[pairs, :, 0].imag]
    return np.asarray(np.linalg.qr(np.concatenate(columns).T)[0])
