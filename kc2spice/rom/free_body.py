"""Rigid-body modes and elastic part of the model of a large unsupported body.

A free body has a singular stiffness K. The shifted stiffness ``K + sigma M`` is positive definite
and is factorised once. Inverse iteration with the real factor of ``K + sigma M`` gives the
rigid-body modes. After the rigid-body modes are deflated, solutions with ``K + sigma M`` replace
solutions with K in Krylov subspaces near zero frequency.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from kc2spice.core.errors import SimulationError
from kc2spice.linalg.factor import Factor, factorise
from kc2spice.rom.definiteness import is_symmetric_and_proportionally_damped
from kc2spice.rom.pencil import Pencil, SchurComplement, compute_absolute_entries
from kc2spice.rom.rigid_body import estimate_energy_rounding, split_driven_modes
from kc2spice.rom.rounding import ZERO_ENTRY_FACTOR

# Usual shift of the eigenvalues, relative to the square of the upper band limit [rad/s].
# With a small shift, the Krylov subspace is accurate, and inverse iteration needs few steps.
SHIFT_RATIO = 1e-6
# smallest shift of the eigenvalues, relative to eps times the largest ratio K_ii / M_ii
MIN_SHIFT_ROUNDING = 100.0
# largest shift of the eigenvalues, relative to the square of the upper band limit [rad/s]
MAX_SHIFT_RATIO = 1e-2
MAX_STEPS = 12  # largest number of steps of inverse iteration
# Inverse iteration ends if the error of each mode is below this limit.
# Each step multiplies the error by shift / (shift + w^2), with the lowest elastic frequency w.
MODE_TOLERANCE = 1e-14
# A mode counts as rigid if its relative elastic energy is at most MAX_RIGID_ENERGY.
# The relative elastic energy of a mode is its elastic energy, divided by the error of this energy
# that random rounding of the stiffness matrix causes.
# The elastic energy of rigid-body modes of unsupported bodies is up to 0.02 times the error of this
# energy due to random rounding.
# A tested chain of 1 400 masses had a support with only 3e-14 of the chain's own stiffness.
# For the tested chain of 1 400 masses, the relative elastic energy was 1.5, so no mode counts as
# rigid.
# Bodies above the limit are reduced by other methods, which retain soft supports.
MAX_RIGID_ENERGY = 1.0
# Number of vectors in the first inverse iteration: more than the six rigid-body modes of one body.
BLOCK_VECTORS = 8
MAX_BLOCK_VECTORS = 64  # largest number of vectors in an inverse iteration


@dataclass(frozen=True, eq=False)
class FreeBody:
    """Model of an unsupported body: elastic part and separate rigid-body modes.

    ``modes`` X (n, r) are rigid-body modes with ``X'MX = 1``. ``momenta`` is M X. ``factor`` is the
    factorisation of the shifted stiffness ``K + shift M``.
    """

    pencil: Pencil
    shift: float
    factor: Factor
    modes: np.ndarray
    momenta: np.ndarray

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve ``(K + shift M) x = rhs``, and return the elastic part of x."""
        balanced = rhs - self.momenta @ (self.modes.T @ rhs)
        x = self.factor.solve(balanced)
        return np.asarray(x - self.modes @ (self.momenta.T @ x))

    def apply_shifted_stiffness(self, x: np.ndarray) -> np.ndarray:
        """Apply ``K + shift M`` to x, for the inner product of Krylov bases."""
        K, _, M = self.pencil.coefficients
        return np.asarray(K @ x + self.shift * (M @ x))

    @cached_property
    def vectors(self) -> np.ndarray:
        """Basis vectors (n, r) of the rigid-body modes, orthonormal in ``K + shift M``."""
        return np.asarray(self.modes / np.sqrt(self.shift))

    def separate_rigid_body_modes(
        self, projected: Pencil, V: np.ndarray
    ) -> tuple[Pencil, np.ndarray]:
        """Separate the rigid-body modes of a projected model from its elastic unknowns.

        The first columns of the basis ``V`` are :attr:`vectors`. Modes that no port drives are
        omitted. Return the corrected model, and a matrix whose columns express the unknowns of the
        corrected model in the unknowns of ``projected``.
        """
        rounding = tuple(self._bound_rounding(forces, V) for forces in self._absolute_forces)
        result = split_driven_modes(projected, self.modes.shape[1], rounding)
        return result.pencil, result.columns

    @cached_property
    def _absolute_forces(self) -> tuple[np.ndarray, ...]:
        """Absolute forces ``|P| |V|`` of rigid-body modes V, for each system matrix P.

        Each entry is the sum of the magnitudes of all terms of one force in ``P V``.
        """
        return tuple(
            compute_absolute_entries(P) @ np.abs(self.vectors) for P in self.pencil.coefficients
        )

    def _bound_rounding(self, forces: np.ndarray, V: np.ndarray) -> np.ndarray:
        """Return bounds of the rounding errors of a projected matrix.

        The bounds have the shape (k, k). Only the rows and columns of rigid-body modes have bounds
        above zero.
        """
        bounds = np.zeros((V.shape[1],) * 2)
        side, count = (
            ZERO_ENTRY_FACTOR * np.finfo(float).eps * (np.abs(V).T @ forces),
            forces.shape[1],
        )
        bounds[:, :count], bounds[:count] = side, side.T
        return bounds


def split_free_body(pencil: Pencil, omega: float) -> FreeBody | None:
    """Split the model of a free body into its rigid-body modes and an elastic part.

    ``omega`` [rad/s] is the upper band limit. Return None if the model has no rigid-body modes, or
    if the function :func:`is_symmetric_and_proportionally_damped` returns false. Also return None
    if the stiffness of supports is as small as rounding errors.
    """
    if not is_symmetric_and_proportionally_damped(pencil, undamped_too=True):
        return None
    shift = _choose_shift(pencil, omega)
    if shift > MAX_SHIFT_RATIO * omega**2:
        return None
    K, _, M = pencil.coefficients
    elastic = K.uu if isinstance(K, SchurComplement) else K
    try:
        factor = factorise(scipy.sparse.csc_array(elastic + shift * M), definite=True)
        modes = _find_rigid_body_modes(pencil, factor, shift)
        if not modes.shape[1]:
            return None
        if isinstance(K, SchurComplement):
            factor = pencil.factorise_shifted_stiffness(-shift)
    except (SimulationError, np.linalg.LinAlgError):
        return None
    return FreeBody(pencil, shift, factor, modes, M @ modes)


def _choose_shift(pencil: Pencil, omega: float) -> float:
    """Choose a shift [rad^2/s^2] well above the rounding errors of the stiffness."""
    K, _, M = pencil.coefficients
    stiff = (K.uu if isinstance(K, SchurComplement) else K).diagonal()
    mass = M.diagonal()
    heavy = mass > 0
    highest = float((np.abs(stiff[heavy]) / mass[heavy]).max(initial=0.0))
    return max(SHIFT_RATIO * omega**2, MIN_SHIFT_ROUNDING * np.finfo(float).eps * highest)


def _find_rigid_body_modes(pencil: Pencil, factor: Factor, shift: float) -> np.ndarray:
    """Find the modes (n, r) without elastic energy by inverse iteration.

    The modes X are orthonormal with respect to the mass matrix M, so ``X'MX`` is the unit matrix.
    ``factor`` is the factorisation of the shifted elastic stiffness. A mode that changes electric
    potentials has energy, even without elastic forces. If the squared frequency of the lowest
    elastic mode is below the shift, no mode is returned.
    """
    K, _, M = pencil.coefficients
    rng, count = np.random.default_rng(0), BLOCK_VECTORS
    while count <= min(MAX_BLOCK_VECTORS, pencil.size):
        X = rng.standard_normal((pencil.size, count))
        for step in range(1, MAX_STEPS + 1):
            X = factor.solve(M @ X)
            values, turn = scipy.linalg.eigh(X.T @ (K @ X), X.T @ (M @ X))
            X = X @ turn
            rigid = np.abs(values) <= np.diag(_bound_elastic_energy(pencil, X))
            lowest = values[~rigid].min(initial=np.inf)
            if shift < lowest < np.inf and (shift / (shift + lowest)) ** step < MODE_TOLERANCE:
                return np.asarray(X[:, rigid])
        if not rigid.all():
            break
        count *= 2
    return np.empty((pencil.size, 0))


def _bound_elastic_energy(pencil: Pencil, V: np.ndarray) -> np.ndarray:
    """Bound the elastic energy ``V'K V`` that rounding errors of K can cause.

    The bounds have the shape (k, k).
    """
    K = pencil.coefficients[0]
    bound = (
        ZERO_ENTRY_FACTOR
        * np.finfo(float).eps
        * (np.abs(V).T @ (compute_absolute_entries(K) @ np.abs(V)))
    )
    if not isinstance(K, SchurComplement):
        bound = np.minimum(bound, MAX_RIGID_ENERGY * estimate_energy_rounding(K, V))
    return np.asarray(bound)
