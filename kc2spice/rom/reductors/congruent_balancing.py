"""Balanced truncation of symmetric first-order models, such as RC networks.

The controllability Gramian of a symmetric model equals the observability Gramian. Balanced
coordinates are therefore orthonormal in the inner product of E. Truncation preserves symmetry, real
poles and passivity.
"""

from __future__ import annotations

import numpy as np
import scipy

from kc2spice.rom.reduced_basis import ReducedBasis, ReductionTask
from kc2spice.rom.reductors.balanced_truncation import (
    HANKEL_ROUNDING,
    MIN_DECAY,
    NOT_STABLE_TEXT,
    compute_balancing_factors,
    explain_no_gramians,
)
from kc2spice.rom.reductors.base import Reductor


class CongruentBalancing(Reductor):
    """Balanced truncation of ``E x' = A x + B u``, ``y = B'x`` with symmetric E and A.

    The modes X satisfy ``X'EX = 1`` and ``-X'AX = diag(r)``. In modal coordinates, both Gramians
    are ``P_ij = b_i b_j' / (r_i + r_j)`` with the rows ``b_i`` of ``X'B``. The basis is ``V = X U``
    with the eigenvectors U of P. The eigenvalues of P are the Hankel singular values. The static
    responses of conservative ports come first in the basis.

    Examples
    --------
    Two states represent the response at the end of a chain of four relaxations within 4 %.

    >>> import numpy as np
    >>> import kc2spice as kc
    >>> A = np.eye(4, k=1) + np.eye(4, k=-1) - 2 * np.eye(4)
    >>> model = kc.LinearModel(A=A, B=np.eye(4)[:, :1], C=np.eye(4)[:1])
    >>> rom = kc.reduce(
    ...     model, order=2, band=(0, 10), norm="peak", method="balanced truncation by congruence"
    ... )
    >>> rom.certificate.passive, rom.certificate.error_estimate < 0.04
    (True, True)
    """

    name = "balanced truncation by congruence"
    reference = "Liu, Sreeram and Teo, Syst. Control Lett. 34 (1998) 209"
    no_basis = NOT_STABLE_TEXT

    def obstacle(self, task: ReductionTask) -> str:
        """Explain why the method does not apply to the model; return "" if it applies."""
        core = task.pencil_without_rigid_modes
        if core.degree == 2:
            return "the model is of second order"
        if not (core.is_symmetric and core.is_collocated):
            return "its matrices are not symmetric, or C is not the transpose of B"
        return explain_no_gramians(task)

    def basis(self, task: ReductionTask) -> ReducedBasis | None:
        """Return the balanced basis, or None if the model is not strictly stable."""
        return task.get_shared_value(self.name, lambda: self._balance(task))

    def _balance(self, task: ReductionTask) -> ReducedBasis | None:
        """Return a balanced basis, or None if E is singular or a mode hardly decays.

        The basis consists of static responses and of eigenvectors of a Gramian.
        """
        core = task.pencil_without_rigid_modes
        try:
            rates, X = scipy.linalg.eigh(*core.coefficients)
        except scipy.linalg.LinAlgError:  # E is singular: some unknowns store no energy
            return None
        if rates[0] <= MIN_DECAY * task.band[1]:
            return None
        loads = X.T @ core.B
        static = np.empty((len(rates), 0))
        if any(port.is_flow_driven for port in task.fom.ports):
            static = scipy.linalg.orth(loads / rates[:, None])
        _, columns = compute_balancing_factors(task.estimator.exact_response_and_scales[1].peak)
        scaled = loads / columns
        gramian = scaled @ scaled.T / (rates[:, None] + rates)
        others = np.eye(len(rates)) - static @ static.T
        hankel, U = np.linalg.eigh(others @ gramian @ others)
        count = int((hankel > HANKEL_ROUNDING * hankel[-1]).sum())
        # A model of ``len(rates)`` unknowns has at most ``len(rates)`` independent basis vectors.
        # The sum of the numbers of static responses and eigenvectors is at most ``len(rates)``.
        count = min(count, len(rates) - static.shape[1])
        directions = np.hstack([static, U[:, ::-1][:, :count]])
        return task.project(X @ directions, fixed=static.shape[1])
