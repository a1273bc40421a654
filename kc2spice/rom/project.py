"""Congruence of the condensed model with a basis, and what follows from its form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kc2spice.rom.model import Certificate, ReducedModel
from kc2spice.rom.schur import CondensedSystem

UNCERTIFIED = Certificate((0.0, 0.0), np.inf, "none", stable=False, passive=False)


def project(model: CondensedSystem, V: np.ndarray) -> ReducedModel:
    """``V'MV, V'EV, V'KV, V'B`` for V (n, q): symmetric as the model is; not yet certified."""
    system = model.system
    M = _symmetric(V.T @ (model.M @ V))
    K = _symmetric(V.T @ model.stiffness(V))
    B = V.T @ model.B
    E = system.alpha * M + system.beta * K
    return ReducedModel(M, E, K, B, B.T, model.D, system.ports, UNCERTIFIED)


def project_again(model: ReducedModel, T: np.ndarray) -> ReducedModel:
    """The same congruence within a reduced model, T (q, r)."""
    M, E, K = (_symmetric(T.T @ matrix @ T) for matrix in (model.M, model.E, model.K))
    B = T.T @ model.B
    return ReducedModel(M, E, K, B, B.T, model.D, model.ports, UNCERTIFIED)


def certify(
    model: ReducedModel, band: tuple[float, float], error_estimate: float, method: str
) -> ReducedModel:
    """Attach the certificate; stability and passivity are read from the matrices' form.

    M, K positive definite and E semi-definite make every pole stable; C = B' and D positive
    semi-definite make the model a passive network.
    """
    stable = all(np.linalg.eigvalsh(matrix)[0] > 0 for matrix in (model.M, model.K))
    stable = stable and _semidefinite(model.E)
    passive = stable and np.array_equal(model.C, model.B.T) and _semidefinite(model.D)
    certificate = Certificate(band, error_estimate, method, stable, passive)
    return replace(model, certificate=certificate)


def _semidefinite(matrix: np.ndarray) -> bool:
    values = np.linalg.eigvalsh(matrix)
    return bool(values[0] >= -1e-14 * max(values[-1], 0.0))


def _symmetric(matrix: np.ndarray) -> np.ndarray:
    return 0.5 * (matrix + matrix.T)
