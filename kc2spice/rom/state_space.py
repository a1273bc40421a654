"""State-space matrices A, B, C, D of linear models."""

from __future__ import annotations

import numpy as np
import scipy

from kc2spice.core.errors import UsageError
from kc2spice.rom.pencil import (
    Pencil,
    convert_to_first_order,
    find_largest_entry,
    make_explicit_pencil,
)
from kc2spice.rom.stability import is_semidefinite

ABCD = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
# An eigenvalue or singular value counts as zero up to this fraction of the largest one.
MASSLESS = 1e-13
# largest relative asymmetry, or coupling of modes by damping, that counts as a rounding error
COUPLING = 1e-10


def convert_to_state_space(pencil: Pencil, top_hz: float | None = None) -> ABCD:
    """Convert a model to ``x' = A x + B u``, ``y = C x + D u``; return A, B, C and D.

    If a stored energy is defined for the model, the square of each scaled state is an energy. With
    these states, ``A + A' <= 0`` for a dissipative model, ``A = -A'`` for a model without losses,
    and ``A = A'`` for a symmetric first-order model. For a decoupled second-order model, A contains
    one 2 x 2 block for each mode. Displacements of rigid-body modes, and of models with an
    unsymmetric K, are scaled by the angular frequency of ``top_hz`` [Hz], the end of the band.
    Without ``top_hz``, the ratio of stiffness to mass gives the scale factor.

    Raises
    ------
    UsageError : an output depends on derivatives of the input, or the equations do not determine
        the massless unknowns.
    """
    pencil = pencil.make_dense()
    if pencil.degree == 1:
        return _make_energy_state_space(pencil)
    K, _, M = pencil.coefficients
    top = (
        find_largest_entry(K) / find_largest_entry(M)
        if find_largest_entry(K) and find_largest_entry(M)
        else 1.0
    )
    omega = 2 * np.pi * top_hz if top_hz is not None else float(np.sqrt(top))
    if is_semidefinite(M):
        # without scaled unknowns, the inertia of a rigid-body mode may seem to be zero
        for item in (pencil, pencil.scale_unknowns(omega)):
            mass = np.linalg.eigvalsh(item.coefficients[2])
            if mass[0] > MASSLESS * mass[-1]:
                return _make_modal_state_space(item, omega)
        pencil = _eliminate_static(pencil)
    elif _is_singular(M, M):
        raise UsageError(
            "the mass matrix is singular and not symmetric",
            where="state space",
            expected="a regular or a symmetric positive semi-definite M",
        )
    else:
        return _make_modal_state_space(_normalise_mass(pencil), omega)
    A, B, C, D = _make_energy_state_space(convert_to_first_order(pencil, omega))
    return A, omega * B, C / omega, D


def _normalise_mass(pencil: Pencil) -> Pencil:
    """Multiply the equations of a model by the inverse of its regular mass matrix M."""
    K, E, M = pencil.coefficients
    solved = np.linalg.solve(M, np.hstack([K, E, pencil.B]))
    n = len(M)
    parts = solved[:, :n], solved[:, n : 2 * n], np.eye(n)
    return Pencil(parts, solved[:, 2 * n :], pencil.C, pencil.D)


def _make_modal_state_space(pencil: Pencil, omega: float) -> ABCD:
    """Compute a state-space model with states ``w z`` and ``z'`` for coordinates z.

    The coordinates z are mass-normalised, and they are modal coordinates if K is symmetric.
    """
    K, E, M = pencil.coefficients
    T, stiffness = normalise_modes(M, K)
    K, E, B, C = T.T @ K @ T, T.T @ E @ T, T.T @ pencil.B, pencil.C @ T
    w = np.full(len(M), omega)
    if stiffness is not None:
        moving = np.abs(stiffness) > MASSLESS * omega**2
        w[moving] = np.sqrt(np.abs(stiffness[moving]))
        K = np.diag(np.where(moving, stiffness, 0.0))
    damp = np.abs(np.diag(E))
    scale = np.sqrt(np.outer(damp, damp)) + np.finfo(float).tiny
    if (np.abs(E - np.diag(np.diag(E))) <= COUPLING * scale).all():
        E = np.diag(np.diag(E))
    A = np.block([[np.zeros_like(K), np.diag(w)], [-K / w, -E]])
    # order of states: z1, z1', z2, z2', ...
    pairs = np.arange(2 * len(M)).reshape(2, len(M)).T.ravel()
    drive, read = np.vstack([np.zeros_like(B), B]), np.hstack([C / w, np.zeros_like(C)])
    return A[np.ix_(pairs, pairs)], drive[pairs], read[:, pairs], pencil.D


def normalise_modes(M: np.ndarray, K: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Return mass-normalised modes: T, for which ``T'MT`` is the identity matrix.

    If K is symmetric, the columns of T are mode shapes, so that T also diagonalises K, and the
    second result contains the eigenvalues. If K is not symmetric, T is triangular, and the second
    result is None. For a definite K, the eigenvalue problem ``M phi = mu K phi`` gives accurate low
    modes.
    """
    if find_largest_entry(K - K.T) > COUPLING * find_largest_entry(K):
        return scipy.linalg.solve_triangular(scipy.linalg.cholesky(M), np.eye(len(M))), None
    values = np.linalg.eigvalsh(K)
    if values[0] > MASSLESS * values[-1]:
        inverse, T = scipy.linalg.eigh(M, K)
        return T / np.sqrt(inverse), 1 / inverse
    stiffness, T = scipy.linalg.eigh(K, M)
    return T, stiffness


def _eliminate_static(pencil: Pencil) -> Pencil:
    """Eliminate the coordinates of a model that have neither mass nor damping.

    The last coordinates of the result have damping, but no mass.
    """
    K, E, M = pencil.coefficients
    mass, V = scipy.linalg.eigh(M)
    none = mass <= MASSLESS * mass[-1]
    damping = V[:, none].T @ E @ V[:, none]
    size, U = scipy.linalg.eigh(0.5 * (damping + damping.T))
    undamped = np.abs(size) <= MASSLESS * max(find_largest_entry(E), np.finfo(float).tiny)
    light, static = V[:, none] @ U[:, ~undamped], V[:, none] @ U[:, undamped]
    if max(
        find_largest_entry(E @ static), find_largest_entry(E.T @ static)
    ) > COUPLING * find_largest_entry(E):
        raise _make_improper_error("massless coordinates are coupled by damping alone")
    T, r = np.hstack([V[:, ~none], light, static]), len(M) - static.shape[1]
    why = "massless, undamped coordinates without stiffness"
    K, B, C, D = _eliminate_last_unknowns(
        T.T @ K @ T, T.T @ pencil.B, pencil.C @ T, pencil.D, r, why
    )
    M = np.diag(np.r_[mass[~none], np.zeros(light.shape[1])])
    return Pencil((K, (T.T @ E @ T)[:r, :r], M), B, C, D)


def _eliminate_last_unknowns(
    P: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, r: int, why: str
) -> ABCD:
    """Eliminate all unknowns after the first r from ``P x = B u``, ``y = C x + D u``.

    If the equations do not determine the unknowns to be eliminated, the function raises an error
    with the reason ``why``.
    """
    if r == len(P):
        return P, B, C, D
    if _is_singular(P[r:, r:], P):
        raise _make_improper_error(why)
    elimination = scipy.linalg.solve(P[r:, r:], np.hstack([P[r:, :r], B[r:]]))
    B, D = B[:r] - P[:r, r:] @ elimination[:, r:], D + C[:, r:] @ elimination[:, r:]
    return (
        P[:r, :r] - P[:r, r:] @ elimination[:, :r],
        B,
        C[:, :r] - C[:, r:] @ elimination[:, :r],
        D,
    )


def _make_energy_state_space(pencil: Pencil) -> ABCD:
    """Convert a first-order model to a state space, in energy coordinates if possible.

    If E is symmetric positive definite, the squares of the states are energies. Algebraic equations
    are eliminated.
    """
    rest, E = pencil.coefficients
    A, B, C, D = -rest, pencil.B, pencil.C, pencil.D
    if is_semidefinite(E) and np.linalg.eigvalsh(E)[0] > MASSLESS * find_largest_entry(E):
        T = scipy.linalg.solve_triangular(scipy.linalg.cholesky(E), np.eye(len(E)))
        inner = T.T @ A @ T
        if find_largest_entry(A - A.T) <= COUPLING * find_largest_entry(A):
            inner = 0.5 * (inner + inner.T)
        return inner, T.T @ B, C @ T, D
    U, size, Vt = scipy.linalg.svd(E)
    r = int((size > MASSLESS * max(size[0], np.finfo(float).tiny)).sum())
    why = "its algebraic equations are singular"
    rest, B, C, D = _eliminate_last_unknowns(U.T @ rest @ Vt.T, U.T @ B, C @ Vt.T, D, r, why)
    return -rest / size[:r, None], B / size[:r, None], C, D


def _is_singular(matrix: np.ndarray, reference: np.ndarray) -> bool:
    """Return whether a matrix is singular, relative to the entries of ``reference``."""
    return bool(
        np.linalg.svd(matrix, compute_uv=False)[-1] <= MASSLESS * find_largest_entry(reference)
    )


def _make_improper_error(why: str) -> UsageError:
    """Make the error for a model without a state-space form."""
    return UsageError(
        f"the model has no state-space form: {why}",
        where="state space",
        expected="a model whose outputs depend on inputs, not on derivatives of inputs",
        hint="add a small mass to the coordinates without mass, or fix these coordinates",
    )


def to_schur_form(pencil: Pencil, top: float) -> Pencil:
    """Convert a model to ``x' = A x + B u`` with A in real Schur form.

    Rates are divided by the angular frequency of ``top`` [Hz]. The Schur form is used to compute
    Gramians and eigenvectors.
    """
    omega = 2 * np.pi * top
    A, B, C, D = convert_to_state_space(pencil, top)
    T, Z = scipy.linalg.schur(A / omega, output="real")
    return make_explicit_pencil(T, Z.T @ B / omega, C @ Z, D)


def restore_time_unit(pencil: Pencil, top: float) -> Pencil:
    """Convert a first-order model from scaled time to SI units.

    The scaled time is the time [s] multiplied by the angular frequency of ``top`` [Hz], as in
    :func:`to_schur_form`.
    """
    omega = 2 * np.pi * top
    rest, one = pencil.coefficients
    return Pencil((omega * rest, one), omega * pencil.B, pencil.C, pencil.D, free=pencil.free)
