"""Tests whether a model has definite matrices and real modes."""

from __future__ import annotations

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.rom.pencil import Matrix, Pencil, SchurComplement, compute_absolute_entries
from kc2spice.rom.rigid_body import ENERGY_FACTOR, estimate_energy_rounding
from kc2spice.rom.rounding import ZERO_ENTRY_FACTOR


def is_symmetric_and_proportionally_damped(pencil: Pencil, *, undamped_too: bool = False) -> bool:
    """Return whether a model is symmetric and proportionally damped.

    The model must also be collocated and of second order. If ``undamped_too`` is true, the damping
    may also be zero.
    """
    proportional = pencil.rayleigh is not None or (undamped_too and pencil.is_undamped)
    return pencil.degree == 2 and proportional and pencil.is_symmetric and pencil.is_collocated


def allows_cholesky(pencil: Pencil) -> bool:
    """Return whether a model's form allows Cholesky factorisation of its stiffness.

    The model must be symmetric, collocated and undamped or proportionally damped. If the stiffness
    matrix K is a Schur complement, the result is true only if the model has at least
    ``QUASI_DEFINITE_UNKNOWNS`` unknowns. With fewer unknowns, factors with pivoting are faster. The
    function does not check whether K is positive definite.
    """
    K = pencil.coefficients[0]
    suitable = is_symmetric_and_proportionally_damped(pencil, undamped_too=True)
    return suitable and not (isinstance(K, SchurComplement) and not K.is_large)


def is_definite(pencil: Pencil, *, undamped_too: bool = False) -> bool:
    """Return whether a symmetric model has a positive definite stiffness matrix K.

    The result is also False if the model is not symmetric, not collocated or not proportionally
    damped (:func:`is_symmetric_and_proportionally_damped`).
    """
    if not is_symmetric_and_proportionally_damped(pencil, undamped_too=undamped_too):
        return False
    load = np.random.default_rng(0).standard_normal((pencil.size, 1))
    try:
        x, y = pencil.static_response, pencil.factorise_shifted_stiffness(0.0).solve(load)
    except SimulationError:
        return False
    positive = bool((np.einsum("ki,ki->i", x, pencil.B) >= 0).all())
    return positive and not _is_free_to_move(pencil.coefficients[0], y, load)


def _is_free_to_move(K: Matrix, y: np.ndarray, load: np.ndarray) -> bool:
    """Return whether the softest mode is a rigid-body mode, within rounding errors.

    The softest mode dominates ``y = K^-1 load`` for a random load. The check is necessary, because
    rounding errors can make the singular stiffness matrix of a free body positive definite.
    """
    size = compute_absolute_entries(K)
    rounding = ZERO_ENTRY_FACTOR * np.finfo(float).eps * np.sum(abs(y) * (size @ abs(y)))
    soft = bool(np.sum(y * load) < rounding)
    if not soft or isinstance(K, SchurComplement):
        return soft
    # The energy y'Ky is computed from the entries of K, not from the factorisation of K.
    # Rounding errors of the factorisation may exceed the stiffness of a soft support.
    y = y / np.linalg.norm(y)
    energy, noise = float(np.sum(y * (K @ y))), float(estimate_energy_rounding(K, y)[0, 0])
    return energy <= ENERGY_FACTOR * noise
