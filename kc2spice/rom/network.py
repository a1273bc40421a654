"""Branches of resistors, inductors and capacitors in parallel: a passive one-port by its form.

Every branch is R, L and C in series, some of them absent. With the charge ``q_k`` of each branch
beside a capacitance ``C0``, a voltage u and the charge y of the port::

    L_k q_k'' + R_k q_k' + q_k / C_k = u        y = sum_k q_k + C0 u

is a linear model with diagonal matrices and a column B of ones, and is recognised by these.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kc2spice.core.domains import ELECTRICAL
from kc2spice.rom.linear_model import Certificate, LinearModel, Port

PORT = Port("anode", ELECTRICAL.port, pins=("anode", "cathode"))


@dataclass(frozen=True)
class Branch:
    """R [Ohm], L [H] and the elastance 1/C [1/F] of elements in series; 0 is an absent element."""

    resistance: float
    inductance: float = 0.0
    elastance: float = 0.0

    def admittance(self, s: np.ndarray) -> np.ndarray:
        """``s / (L s^2 + R s + 1/C)`` (n,) [S] at ``s`` (n,) [rad/s]."""
        return np.asarray(
            s / (self.inductance * s**2 + self.resistance * s + self.elastance), dtype=complex
        )


@dataclass(frozen=True)
class ParallelBranches:
    """A one-port of ``branches`` beside the ``capacitance`` C0 [F]."""

    capacitance: float
    branches: tuple[Branch, ...]

    @property
    def conductance(self) -> float:
        """Conductance [S] at zero frequency."""
        return sum(1 / b.resistance for b in self.branches if b.elastance == 0)

    def admittance(self, frequency: np.ndarray) -> np.ndarray:
        """Y (n,) [S] at ``frequency`` (n,) [Hz]."""
        s = 2j * np.pi * np.asarray(frequency)
        Y = s * self.capacitance
        for branch in self.branches:
            Y = Y + branch.admittance(s)
        return np.asarray(Y)

    def linear(self, certificate: Certificate | None = None) -> LinearModel:
        """The network as matrices; :func:`parallel_branches` takes it back to the bit."""
        values = np.array([(b.inductance, b.resistance, b.elastance) for b in self.branches])
        M, E, K = (np.diag(column) for column in values.reshape(-1, 3).T)
        return LinearModel(
            M=M,
            E=E,
            K=K,
            B=np.ones((len(self.branches), 1)),
            D=np.array([[self.capacitance]]),
            ports=(PORT,),
            certificate=certificate,
        )


def parallel_branches(model: LinearModel) -> ParallelBranches | None:
    """The network whose matrices ``model`` has; None where it is another model."""
    one_port = len(model.ports) == 1 and model.ports[0].electrical
    if model.first_order or not one_port or not (model.B == 1).all() or not (model.C == 1).all():
        return None
    K, E, M = model.pencil.dense().coefficients
    if any(not np.array_equal(P, np.diag(np.diag(P))) or (np.diag(P) < 0).any() for P in (K, E, M)):
        return None
    values = zip(np.diag(E), np.diag(M), np.diag(K), strict=True)
    branches = tuple(Branch(float(R), float(L), float(S)) for R, L, S in values)
    return ParallelBranches(float(model.D[0, 0]), branches)
