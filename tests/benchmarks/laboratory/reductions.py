"""Methods to choose few states, side by side; :mod:`kc2spice.rom.reduce` ships one.

All are congruences ``V'MV, V'EV, V'KV, V'B`` with a real V, so each keeps symmetry, definiteness
and passivity at any order.

Second-order balanced truncation (Reis and Stykel 2008; free velocity: Meyer and Srinivasan 1996)
works on the large Krylov model. For M, E, K symmetric and C = B' the velocity observability
Gramian equals the position controllability Gramian, so position-velocity balancing is a congruence
by itself; of the other variants the trial space is taken on both sides. Ports count alike: each is
scaled to a static compliance of one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import eigh, solve_continuous_lyapunov
from scipy.sparse.linalg import LinearOperator, eigsh

from kc2spice.rom.krylov import block_arnoldi, extend
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.pencil import Pencil

Candidate = Callable[[int], LinearModel]
Variant = Literal["position-velocity", "velocity", "free velocity"]
VARIANTS: tuple[Variant, ...] = ("position-velocity", "velocity", "free velocity")
POINTS = (0.0, 0.6, 0.96)  # of the band's upper edge: plain multi-point Krylov


@dataclass(frozen=True)
class Gramians:
    """Gramians (n, n) of ``M x'' + E x' + K x = B u``, ``y = C x``.

    ``Pp`` and ``Pv`` of the displacements and velocities after impulses at all inputs; ``Qp`` and
    ``Qv`` give the output energy ``x'Qp x`` and ``p'Qv p`` of an initial displacement x and an
    initial momentum p.
    """

    Pp: np.ndarray
    Pv: np.ndarray
    Qp: np.ndarray
    Qv: np.ndarray


def gramians(M: np.ndarray, E: np.ndarray, K: np.ndarray, B: np.ndarray, C: np.ndarray) -> Gramians:
    """Two Lyapunov equations of the first-order form in the states ``w z``, ``z'`` of modes z."""
    stiffness, T = eigh(K, M)
    w, n = np.sqrt(stiffness), len(stiffness)
    zero = np.zeros((n, n))
    A = np.block([[zero, np.diag(w)], [-np.diag(w), -T.T @ E @ T]])
    drive = np.vstack([np.zeros_like(B), T.T @ B])
    read = np.hstack([C @ T / w, np.zeros_like(C)])
    P = solve_continuous_lyapunov(A, -drive @ drive.T)
    Q = solve_continuous_lyapunov(A.T, -read.T @ read)
    scale, back = np.outer(w, w), M @ T
    return Gramians(
        Pp=T @ (P[:n, :n] / scale) @ T.T,
        Pv=T @ P[n:, n:] @ T.T,
        Qp=back @ (Q[:n, :n] * scale) @ back.T,
        Qv=T @ Q[n:, n:] @ T.T,
    )


def balanced(model: LinearModel, variant: Variant, kept: np.ndarray) -> np.ndarray:
    """Directions by falling importance; those of ``kept`` (n, k) are in the model already."""
    B = model.B / np.sqrt(np.einsum("ki,ki->i", model.B, np.linalg.solve(model.K, model.B)))
    found = gramians(model.M, model.E, model.K, B, B.T)
    reach = _root(found.Pv if variant == "velocity" else found.Pp)
    weight = found.Qp if variant == "free velocity" else model.M @ found.Qv @ model.M
    if kept.shape[1]:
        reach = reach - kept @ np.linalg.solve(kept.T @ model.K @ kept, kept.T @ model.K @ reach)
    return np.asarray(reach @ np.linalg.svd(_root(weight).T @ reach)[2].T)


def candidates(
    model: LinearModel, large: LinearModel, band: tuple[float, float], most: int
) -> dict[str, Candidate]:
    """Models as functions of the order, up to ``most``; ``large`` is that of the first stage."""
    static = np.linalg.solve(large.K, large.B)
    nothing = static[:, :0]
    lowest = _modes(model, most)
    K, _, M = model.pencil.coefficients
    solve = model.pencil.pencil_solver(0.0).solve
    krylov = block_arnoldi(lambda v: K @ v, solve, lambda v: M @ v, model.B, most)
    found = {
        "Krylov at 0 (the paper's)": _of_full(model, krylov),
        "Krylov at three points": _of_full(model, _multi_point(model, band, most)),
        "modes": _of_full(model, lowest),
        "static vectors, modes": _of_full(model, np.hstack([solve(model.B), lowest])),
    }
    for variant in VARIANTS:
        found[f"balanced, {variant}"] = _of_large(large, balanced(large, variant, nothing))
        directions = np.hstack([static, balanced(large, variant, static)])
        found[f"static vectors, balanced, {variant}"] = _of_large(large, directions)
    return found


def projected(model: LinearModel, V: np.ndarray) -> LinearModel:
    """The congruence of a second-order model with C = B' on the columns of ``V``."""
    return of_pencil(model, model.pencil.project(V))


def leading(model: LinearModel, order: int) -> LinearModel:
    """The model of the first ``order`` states."""
    return of_pencil(model, model.pencil.leading(order))


def of_pencil(model: LinearModel, pencil: Pencil) -> LinearModel:
    """A reduced pencil with the ports of the model that it was made from."""
    K, E, M = pencil.coefficients
    return LinearModel(M=M, E=E, K=K, B=pencil.B, D=pencil.D, ports=model.ports, name=model.name)


def _of_full(model: LinearModel, directions: np.ndarray) -> Candidate:
    """Leading columns, made orthonormal in K so that their scales do not matter."""
    empty = np.empty((len(directions), 0))
    K = model.pencil.coefficients[0]
    basis, _ = extend(empty, empty, directions, lambda v: K @ v)
    whole = projected(model, basis)
    return lambda order: leading(whole, order)


def _of_large(large: LinearModel, directions: np.ndarray) -> Candidate:
    empty = np.empty((len(directions), 0))
    basis, _ = extend(empty, empty, directions, lambda v: large.K @ v)
    return lambda order: projected(large, basis[:, :order])


def _multi_point(model: LinearModel, band: tuple[float, float], most: int) -> np.ndarray:
    """One Krylov block at each of the points in turn, then the second of each, and so on."""
    squares = [(2 * np.pi * share * band[1]) ** 2 for share in POINTS]
    K, _, M = model.pencil.coefficients
    solvers = [model.pencil.pencil_solver(w2) for w2 in squares]
    blocks = [solver.solve(model.B) for solver in solvers]
    basis = images = np.empty((len(model.B), 0))
    while basis.shape[1] < most:
        for i, solver in enumerate(solvers):
            columns, column_images = extend(basis, images, blocks[i], lambda v: K @ v)
            basis, images = np.hstack([basis, columns]), np.hstack([images, column_images])
            blocks[i] = solver.solve(M @ columns)
    return basis[:, :most]


def _modes(model: LinearModel, count: int) -> np.ndarray:
    """Lowest modes that a port can excite, by Lanczos from a static answer, which sees no other."""
    n = len(model.B)
    solve = model.pencil.pencil_solver(0.0).solve
    inverse = LinearOperator((n, n), matvec=solve, dtype=float)
    start = solve(model.B.sum(axis=1))
    _, modes = eigsh(inverse, count, M=model.M, sigma=0.0, OPinv=inverse, v0=start)
    return np.asarray(modes)


def _root(gramian: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(0.5 * (gramian + gramian.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
