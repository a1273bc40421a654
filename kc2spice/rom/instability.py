"""Test whether a large model is unstable, with few matrix factorisations.

Computing all poles of a large model would take too long. However, one growing pole, which has a
positive real part, proves that the model is unstable.

* A symmetric model with a positive definite mass matrix is unstable if a displacement x has a
  negative energy ``x'Kx``. In this case, the matrix ``s^2 M + s E + K`` is not positive definite at
  s = 0, but positive definite for large real s. Therefore, the matrix is singular at a value s > 0,
  which is a growing pole.
* For other models, the Cayley transform ``(A + c E) (A - c E)^-1`` of the linear pencil is used.
  Growing poles become eigenvalues outside of the unit circle. Computing the largest eigenvalues of
  the Cayley transform requires one real factorisation (Y. Saad, Numerical Methods for Large
  Eigenvalue Problems, 2011, 8.1). Two values of c are tried: the angular frequency at the upper end
  of the band, and the median of the rates ``(k_ii / m_ii)^(1/degree)`` of all unknowns.

The test does not find a pole whose real part is below about a hundredth of the pole's magnitude.
"""

from __future__ import annotations

import numpy as np
import scipy
from scipy.sparse.linalg import ArpackError, ArpackNoConvergence, LinearOperator, eigs, eigsh

from kc2spice.core.errors import SimulationError
from kc2spice.linalg.factor import require_memory_for_factors
from kc2spice.rom.pencil import Matrix, Pencil, SchurComplement, compute_absolute_entries
from kc2spice.rom.stability import is_dissipative, is_semidefinite

# numbers of poles, vectors and restarts of the Arnoldi method
POLE_COUNT = 4
KRYLOV_VECTORS = 40
MAX_RESTARTS = 12
LANCZOS_RESTARTS = 6  # number of restarts of the Lanczos method, with twenty vectors each
MODE_ERROR = 1e-2  # relative tolerance of the eigenvalue of the softest mode
# an energy counts as zero if (energy / rounding error) is below this ratio
ZERO_ENERGY_FACTOR = 1e3
MIN_GROWTH = 1e-4  # smallest real part of a growing pole, relative to the magnitude of the pole
MAX_RESIDUAL = 1e-6  # largest residual of a pole, relative to the terms of the eigenvalue equation


def explain_instability(pencil: Pencil, band: tuple[float, float] | None) -> str | None:
    """Return a proof of instability for error messages, or None without a proof.

    Parameters
    ----------
    pencil : Pencil
        First-order or second-order model. For a symmetric model with proportional damping, no
        matrix is factorised.
    band : pair of float, optional
        Frequency band [Hz] of the reduction.

    Raises
    ------
    UsageError : the model is too large for the memory of the computer.

    Examples
    --------
    >>> K = scipy.sparse.diags_array([3.0, 2.0, -1.0, 4.0]).tocsc()
    >>> one, zero = scipy.sparse.eye_array(4, format="csc"), scipy.sparse.csc_array((4, 4))
    >>> B = np.ones((4, 1))
    >>> explain_instability(Pencil((K, zero, one), B, B.T, np.zeros((1, 1))), (0.0, 1.0))
    'a negative eigenvalue of the stiffness matrix'
    """
    if any(isinstance(P, SchurComplement) for P in pencil.coefficients):
        return None
    if pencil.degree == 2 and pencil.is_symmetric:
        if (pencil.coefficients[2].diagonal() <= 0).any():
            # models with potentials or multipliers are indefinite, even if they are stable
            return None
        if _has_negative_stiffness(pencil):
            return "a negative eigenvalue of the stiffness matrix"
        if pencil.is_undamped or (pencil.rayleigh is not None and min(pencil.rayleigh) >= 0):
            return None  # K is positive semi-definite, so there is no growing pole
    require_memory_for_factors(pencil.assemble_bordered_matrix(1.0, 1.0, 1.0))
    if is_dissipative(pencil):
        return None
    rates = [2 * np.pi * band[1]] if band else []
    for rate in [*rates, _compute_median_rate(pencil)]:
        try:
            poles = _find_growing_poles(pencil, rate)
        except (SimulationError, ArpackError):
            continue
        if poles.size:
            pole = poles[poles.real.argmax()]
            return f"a pole at {pole.real:.3g} {pole.imag:+.3g}j 1/s"
    return None


def _has_negative_stiffness(pencil: Pencil) -> bool:
    """Return whether a displacement of a symmetric model has negative energy.

    The result is False if the mass matrix is indefinite.
    """
    K, _, M = pencil.coefficients
    x = _find_highest_energy_vector(-K)
    if x is None:
        return False
    noise = (
        ZERO_ENERGY_FACTOR
        * np.finfo(float).eps
        * float(np.abs(x) @ (compute_absolute_entries(K) @ np.abs(x)))
    )
    return bool(x @ (K @ x) < -noise) and is_semidefinite(M)


def _find_highest_energy_vector(P: Matrix) -> np.ndarray | None:
    """Find the vector x of highest energy ``x'Px`` among vectors of weighted norm one.

    P is a symmetric matrix. The weighted norm of x is one if ``sum_i w_i x_i^2 = 1``. The weights
    w_i are the row sums of ``|P|``. Return None if the Lanczos method does not converge.
    """
    size = np.asarray(abs(P).sum(axis=1)).ravel()
    if not size.any():
        return None
    scale = scipy.sparse.diags_array(1 / np.sqrt(np.where(size > 0, size, size.max())))
    start = np.random.default_rng(0).standard_normal(len(size))
    try:
        vectors = eigsh(
            scale @ P @ scale, 1, which="LA", tol=MODE_ERROR, maxiter=LANCZOS_RESTARTS, v0=start
        )[1]
    except ArpackError:
        return None
    return np.asarray(scale @ vectors[:, 0])


def _compute_median_rate(pencil: Pencil) -> float:
    """Return the median rate ``(k_ii / m_ii)^(1/degree)`` [1/s] of all unknowns.

    Unknowns are ignored if their inertia, their stiffness or both are zero.
    """
    rest, inertia = (abs(P.diagonal()) for P in (pencil.coefficients[0], pencil.coefficients[-1]))
    moving = (rest > 0) & (inertia > 0)
    if not moving.any():
        return 1.0
    return float(np.median(rest[moving] / inertia[moving]) ** (1 / pencil.degree))


def _find_growing_poles(pencil: Pencil, rate: float) -> np.ndarray:
    """Find poles [1/s] with positive real part by a Cayley transform.

    The transform has the constant c = ``rate`` [1/s]. A pole is returned only if the residual of
    the eigenvector is small.
    """
    solve = pencil.factorise_polynomial(rate)[0].solve
    n, degree = pencil.size, pencil.degree
    inertia, *loss = pencil.coefficients[:0:-1]

    def apply_cayley_transform(z: np.ndarray) -> np.ndarray:
        """Return the Cayley transform ``z + 2 c (A - c E)^-1 E z`` of the state z."""
        if degree == 1:
            return np.asarray(z - 2 * rate * solve(inertia @ z))
        x = -solve(inertia @ (z[n:] + rate * z[:n]) + loss[0] @ z[:n])
        return np.asarray(z + 2 * rate * np.r_[x, z[:n] + rate * x])

    operator = LinearOperator((degree * n,) * 2, matvec=apply_cayley_transform, dtype=float)
    start = np.random.default_rng(0).standard_normal(degree * n)
    options = {"ncv": KRYLOV_VECTORS, "maxiter": MAX_RESTARTS, "tol": MAX_RESIDUAL, "v0": start}
    try:
        values, vectors = eigs(operator, POLE_COUNT, which="LM", **options)
    except ArpackNoConvergence as error:
        values, vectors = error.eigenvalues, error.eigenvectors
    unstable_poles = []
    for value, x in zip(values, vectors[:n].T, strict=True):
        pole = rate * (value + 1) / (value - 1)
        terms = [pole**k * (P @ x) for k, P in enumerate(pencil.coefficients)]
        size = sum(map(np.linalg.norm, terms))
        small = np.linalg.norm(np.sum(terms, axis=0)) <= MAX_RESIDUAL * size
        if small and pole.real > MIN_GROWTH * abs(pole):
            unstable_poles.append(pole)
    return np.array(unstable_poles, dtype=complex)
