"""Block Krylov subspace at one expansion point, s0 = 0.

Source: Schütz, Maeter and Bechtold, Actuators 10 (2021) 279, section 2.3, equations 6 and 7.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kc2spice.rom.intermediate import Subspace
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.response import Response

# A candidate that keeps less than this of its length outside the basis brings rounding noise only.
DEFLATION = 1e-10
Operator = Callable[[np.ndarray], np.ndarray]


def block_arnoldi(
    stiffness: Operator, solve: Operator, mass: Operator, B: np.ndarray, order: int
) -> np.ndarray:
    """Basis V (n, q) of ``span{X, AX, A^2 X, ...}``, ``X = K^-1 B``, ``A = K^-1 M``, ``V'KV = 1``.

    Column by column in port order, so bases are nested: the first q columns are the basis of
    order q, the last block being cut after the ports that still fit. The first block holds the
    static answers to all ports; a one-sided projection on it matches 2 moments per block.
    Fewer than ``order`` columns return when the Krylov space is exhausted.
    """
    basis = images = np.empty((B.shape[0], 0))
    candidates = solve(B)
    while basis.shape[1] < order:
        columns, column_images = extend(basis, images, candidates, stiffness)
        if not columns.shape[1]:
            break
        basis = np.hstack([basis, columns])
        images = np.hstack([images, column_images])
        candidates = solve(mass(columns))
    return basis[:, :order]


def extend(
    basis: np.ndarray, images: np.ndarray, candidates: np.ndarray, stiffness: Operator
) -> tuple[np.ndarray, np.ndarray]:
    """Columns (v, K v) that the candidates add to a K-orthonormal basis with images K V.

    The images make every inner product an ordinary one. Dependent candidates are deflated.
    """
    old = basis.shape[1]
    for vector in candidates.T:
        length = np.sqrt(vector @ stiffness(vector))
        for _ in range(2):  # twice is enough (Kahan, Parlett)
            vector = vector - basis @ (images.T @ vector)
        image = stiffness(vector)
        remaining = np.sqrt(max(vector @ image, 0.0))
        if remaining > DEFLATION * length:
            basis = np.column_stack([basis, vector / remaining])
            images = np.column_stack([images, image / remaining])
    return basis[:, old:], images[:, old:]


def _krylov(pencil: Pencil, order: int) -> Subspace:
    """The paper's model of ``order`` states and two blocks more, by which it is certified."""
    K, _, M = pencil.coefficients
    solve = pencil.pencil_solver(0.0).solve
    larger = order + 2 * pencil.B.shape[1]
    V = block_arnoldi(lambda v: K @ v, solve, lambda v: M @ v, pencil.B, larger)
    return Subspace(Response(pencil.project(V)), 0.0, True, "")
