"""Parallel branches of resistors, inductors and capacitors: a passive one-port.

Every branch is a series circuit of one, two or three of the elements R, L and C. All branches and
the capacitance ``C0`` are in parallel. The charge of branch k is ``q_k``. The voltage u and the
charge y of the port follow from ``L_k q_k'' + R_k q_k' + q_k / C_k = u`` and
``y = sum_k q_k + C0 u``.

The network is a linear model with diagonal matrices and a column B of ones. Every linear model of
this form is recognised as a network. The current of all branches may flow through leads with a
resistance R and an inductance L. In a network with leads, ``C0`` is also a branch. The lead
resistance R is added to all entries of the damping matrix, and the lead inductance L to all entries
of the inertia matrix::

    L y'' + R y' + L_k q_k'' + R_k q_k' + q_k / C_k = u        y = sum_k q_k
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kc2spice.core.domains import ELECTRICAL
from kc2spice.rom.linear_model import Certificate, LinearModel, Port

NETWORK_PORT = Port("anode", ELECTRICAL.port, pins=("anode", "cathode"))


@dataclass(frozen=True)
class CircuitBranch:
    """Series branch of R [Ohm], L [H] and C; the elastance is 1/C [1/F].

    The value of a missing element is 0.
    """

    resistance: float
    inductance: float = 0.0
    elastance: float = 0.0

    def admittance(self, s: np.ndarray) -> np.ndarray:
        """Return the admittance ``s / (L s^2 + R s + 1/C)`` (n,) [S] for ``s`` (n,) [1/s]."""
        return np.asarray(
            s / (self.inductance * s**2 + self.resistance * s + self.elastance), dtype=complex
        )


IDEAL_LEAD = CircuitBranch(0.0)


@dataclass(frozen=True)
class ParallelBranches:
    """One-port network of parallel branches and a parallel capacitance C0 [F].

    The ``lead`` consists of R and L in series with the parallel branches, and carries the total
    current.
    """

    capacitance: float
    branches: tuple[CircuitBranch, ...]
    lead: CircuitBranch = IDEAL_LEAD

    @property
    def conductance(self) -> float:
        """Conductance [S] of the network at zero frequency."""
        conductance = sum(1 / b.resistance for b in self.branches if b.elastance == 0)
        return conductance / (1 + self.lead.resistance * conductance)

    def admittance(self, frequency: np.ndarray) -> np.ndarray:
        """Return the admittance (n,) [S] of the network at ``frequency`` (n,) [Hz]."""
        s = 2j * np.pi * np.asarray(frequency)
        Y = s * self.capacitance
        for branch in self.branches:
            Y = Y + branch.admittance(s)
        return np.asarray(Y / (1 + (self.lead.resistance + s * self.lead.inductance) * Y))

    def to_linear_model(self, certificate: Certificate | None = None) -> LinearModel:
        """Convert the network to a linear model.

        The inverse conversion by :func:`recognise_parallel_branches` is exact if ``lead``, the
        impedance in series with all branches, is zero.
        """
        branches, capacitance = self.branches, self.capacitance
        if self.lead != IDEAL_LEAD and capacitance > 0:
            branches, capacitance = (*branches, CircuitBranch(0.0, elastance=1 / capacitance)), 0.0
        values = np.array([(b.inductance, b.resistance, b.elastance) for b in branches])
        M, E, K = map(np.diag, values.reshape(-1, 3).T)
        return LinearModel(
            M=M + self.lead.inductance,
            E=E + self.lead.resistance,
            K=K,
            B=np.ones((len(branches), 1)),
            D=np.array([[capacitance]]),
            ports=(NETWORK_PORT,),
            certificate=certificate,
        )


def recognise_parallel_branches(model: LinearModel) -> ParallelBranches | None:
    """Return the parallel R-L-C branches that a linear model represents, or None.

    The result is None if the matrices of the model do not have the form of a network.
    """
    fit_one_port = len(model.ports) == 1 and model.ports[0].electrical
    if (
        model.first_order
        or not fit_one_port
        or not (model.B == 1).all()
        or not (model.C == 1).all()
    ):
        return None
    matrices = model.pencil.make_dense().coefficients
    elastance, resistance, inductance = map(_find_common_value, matrices)
    if elastance != 0 or resistance is None or inductance is None:
        return None
    capacitance, lead = float(model.D[0, 0]), CircuitBranch(resistance, inductance)
    K, E, M = (np.diag(P) - c for P, c in zip(matrices, (0.0, resistance, inductance), strict=True))
    branches = tuple(
        CircuitBranch(float(R), float(L), float(S)) for R, L, S in zip(E, M, K, strict=True)
    )
    if lead != IDEAL_LEAD:
        if capacitance != 0:
            return None
        *others, last = branches
        if last.resistance == last.inductance == 0 < last.elastance:
            branches, capacitance = tuple(others), 1 / last.elastance
    return ParallelBranches(capacitance, branches, lead)


def _find_common_value(matrix: np.ndarray) -> float | None:
    """Return the common value of all off-diagonal entries, None if entries differ.

    The result is None if the off-diagonal entries differ, are negative, or exceed a diagonal entry.
    Without off-diagonal entries, the result is 0.
    """
    off_diagonal = matrix[~np.eye(len(matrix), dtype=bool)]
    shared = float(off_diagonal[0]) if off_diagonal.size else 0.0
    if shared < 0 or (off_diagonal != shared).any() or (np.diag(matrix) < shared).any():
        return None
    return shared
