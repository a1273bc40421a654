"""Frequency band of a reduction: prescribed, or chosen from natural frequencies."""

from __future__ import annotations

import numpy as np
from scipy.linalg import LinAlgError, eigh
from scipy.sparse.linalg import ArpackError, LinearOperator, eigs, eigsh

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.quantities import convert_quantity
from kc2spice.linalg.factor import require_memory_for_factors
from kc2spice.rom.constraints import eliminate_algebraic_unknowns
from kc2spice.rom.pencil import (
    Matrix,
    Pencil,
    SchurComplement,
    compute_absolute_entries,
    find_largest_entry,
    to_dense,
)
from kc2spice.rom.rigid_body import ENERGY_FACTOR, estimate_energy_rounding
from kc2spice.rom.rounding import ZERO_ENTRY_FACTOR

BAND_MODES = 5
MAX_DENSE_EQUATIONS = 200  # all poles are computed if a model has at most this size
BAND_MARGIN = 1.1  # ratio of the upper band limit to the highest natural frequency in the band
# Shift for models with massless unknowns, divided by the ratio largest stiffness / largest mass.
MASSLESS_SHIFT = 1e-6
# shift that separates rigid-body modes in the Lanczos method, relative to the largest K_ii / M_ii
RIGID_SHIFT = 1e-9
ZERO_MASS = 1e-13  # a mass counts as zero if (mass / largest mass) is below this ratio
RIGID_MODES_PLUS_ONE = 7  # one more than the number of rigid-body modes of one solid
EIGENVALUE_TOLERANCE = 1e-9  # largest permitted relative error of eigenvalues by ARPACK


def choose_natural_band(pencil: Pencil) -> tuple[float, float]:
    """Choose a band from 0 Hz to slightly above the fifth lowest natural frequency.

    The band ends a little above the fifth natural frequency of the full model. For second-order
    models, natural frequencies are undamped; for first-order models, natural frequencies are corner
    frequencies. Rigid-body modes do not count.

    Raises
    ------
    UsageError : the model has no natural frequency, or the model is too large for the memory of the
    computer.
    """
    try:
        if pencil.degree == 2 and pencil.is_symmetric:
            rates = compute_elastic_eigenvalues(pencil, BAND_MODES)
        else:
            rates = (
                _compute_all_rates(pencil)
                if pencil.size <= MAX_DENSE_EQUATIONS
                else _compute_lowest_rates(pencil)
            )
    except (SimulationError, ArpackError, LinAlgError):
        rates = np.empty(0)
    rates = np.sort(rates[rates > 0])[:BAND_MODES] ** (1 / pencil.degree)
    if not rates.size:
        if pencil.degree == 2 and (pencil.coefficients[2].diagonal() < 0).any():
            raise UsageError(
                "a mass is negative",
                where="matrix M",
                got="a negative number on the diagonal",
                expected="a mass matrix without negative eigenvalues",
                hint="change the sign of M",
            )
        stiffness = pencil.coefficients[0]
        if (
            pencil.degree == 2
            and not isinstance(stiffness, SchurComplement)
            and (stiffness.diagonal() < 0).any()
        ):
            raise UsageError(
                "a stiffness is negative",
                where="matrix K",
                got="a negative number on the diagonal",
                expected="a stiffness matrix without negative eigenvalues",
                hint="change the sign of K",
            )
        raise UsageError(
            "the frequency band is missing, and the model has no natural frequency",
            where="band",
            hint="add a frequency band, such as band=(0, 2e4)",
        )
    return 0.0, float(BAND_MARGIN * rates[-1] / (2 * np.pi))


def compute_elastic_eigenvalues(pencil: Pencil, count: int) -> np.ndarray:
    """Compute the ``count`` lowest squared natural frequencies [rad^2/s^2].

    The model must be symmetric and of second order. Rigid-body modes do not count. If the model has
    fewer than ``count`` elastic modes, the frequencies of all elastic modes are returned.

    The stiffness matrix K of an unsupported body is singular. Therefore, the eigenvalues are
    computed with ``K + sigma M`` and a small sigma > 0. A mode whose energy ``x'Kx`` is within the
    rounding error of the entries of K is a rigid-body mode.
    """
    K, M = pencil.coefficients[0], pencil.coefficients[-1]
    if pencil.size <= MAX_DENSE_EQUATIONS:
        K, M = to_dense(K), to_dense(M)
        mass = np.linalg.eigvalsh(M)
        if mass[0] > ZERO_MASS * mass[-1]:
            X = np.asarray(eigh(K, M)[1])
        else:  # massless unknowns have infinite natural frequencies
            inverse, T = eigh(M, K + MASSLESS_SHIFT * find_largest_entry(K) / mass[-1] * M)
            X = T[:, inverse > ZERO_MASS * inverse[-1]][:, ::-1]
        return _compute_rayleigh_quotients(K, M, X)[:count]
    require_memory_for_factors(
        pencil.assemble_bordered_matrix(1.0, 1.0, 1.0), definite=pencil.is_large
    )
    stiffness, inertia = (compute_absolute_entries(P).diagonal() for P in (K, M))
    top = float((stiffness[inertia > 0] / inertia[inertia > 0]).max(initial=0.0))
    shift = RIGID_SHIFT * top
    solve = pencil.factorise_shifted_stiffness(-shift).solve
    start = solve(np.random.default_rng(0).standard_normal(pencil.size))
    mode_count = count + RIGID_MODES_PLUS_ONE
    while True:
        mode_count = min(mode_count, pencil.size - 2)
        inverse = LinearOperator((pencil.size,) * 2, matvec=solve, dtype=float)
        result = eigsh(
            LinearOperator((pencil.size,) * 2, matvec=lambda x: K @ x, dtype=float),
            mode_count, M, sigma=-shift, OPinv=inverse, v0=start, tol=EIGENVALUE_TOLERANCE,
        )  # fmt: skip
        rates = _compute_rayleigh_quotients(K, M, result[1])
        if rates.size >= count or mode_count == pencil.size - 2:
            return rates[:count]
        mode_count *= 2


def _compute_rayleigh_quotients(K: Matrix, M: Matrix, X: np.ndarray) -> np.ndarray:
    """Return the ascending Rayleigh quotients ``x'Kx / x'Mx`` of elastic modes."""
    energy = np.einsum("ij,ij->j", X, K @ X)
    mass = np.einsum("ij,ij->j", X, M @ X)
    noise = (
        ZERO_ENTRY_FACTOR
        * np.finfo(float).eps
        * np.einsum("ij,ij->j", abs(X), compute_absolute_entries(K) @ abs(X))
    )
    if not isinstance(K, SchurComplement):
        noise = np.minimum(noise, ENERGY_FACTOR * np.diag(estimate_energy_rounding(K, X)))
    return np.asarray(np.sort(energy[energy > noise] / mass[energy > noise]))


def find_band_end(pencil: Pencil, count: int, high: float) -> float:
    """Return a band end [Hz]: the ``count``-th elastic frequency, at most ``high``.

    Return ``high`` if the model has fewer than ``count`` elastic modes, or if the modes cannot be
    computed.
    """
    pencil = eliminate_algebraic_unknowns(pencil)
    if pencil.degree != 2 or not pencil.is_symmetric or pencil.size <= count + 2:
        return high
    try:
        rates = compute_elastic_eigenvalues(pencil, count)
    except (SimulationError, UsageError, ArpackError, LinAlgError):
        return high
    if rates.size < count:
        return high
    return min(high, float(np.sqrt(rates[-1]) / (2 * np.pi)))


def _compute_all_rates(pencil: Pencil) -> np.ndarray:
    """Compute all rates of a pencil: the magnitudes of its nonzero eigenvalues.

    The eigenvalues are computed with a dense solver.
    """
    rest, inertia = map(to_dense, (pencil.coefficients[0], pencil.coefficients[-1]))
    if find_largest_entry(rest) == 0 or find_largest_entry(inertia) == 0:
        return np.empty(0)
    rates = np.abs(Pencil((rest, inertia), pencil.B, pencil.C, pencil.D).poles())
    return np.asarray(rates[rates > 1e-12 * rates.max(initial=0.0)])


def _compute_lowest_rates(pencil: Pencil) -> np.ndarray:
    """Compute the lowest rates of a pencil: the smallest eigenvalue magnitudes.

    The smallest eigenvalues of the pencil are the reciprocals of the largest eigenvalues of
    ``P(0)^-1`` times the inertia matrix.
    """
    require_memory_for_factors(pencil.assemble_bordered_matrix(1.0, 1.0, 1.0))
    solve, inertia = pencil.factorise_polynomial(0.0)[0].solve, pencil.coefficients[-1]
    inverse = LinearOperator((pencil.size,) * 2, matvec=lambda x: solve(inertia @ x), dtype=float)
    start = solve(pencil.B[:, 0])
    values = np.abs(
        eigs(inverse, BAND_MODES + 1, v0=start, tol=EIGENVALUE_TOLERANCE, return_eigenvectors=False)
    )
    return np.asarray(1 / values[values > 0])


def parse_band(
    band: tuple[float | str, float | str] | None,
) -> tuple[float, float] | None:
    """Convert a band such as ``(0, "20 kHz")`` to Hz; return None for None.

    Raises
    ------
    UsageError : the band does not consist of two frequencies.
    """
    if band is None:
        return None
    if isinstance(band, (str, float, int)) or len(band) != 2:
        raise UsageError(
            "this value is not a frequency band",
            where="band",
            got=repr(band),
            expected='two frequencies, such as (0, 20e3) or (0, "20 kHz")',
            hint="for example band=(0, 20e3)",
        )
    low, high = (convert_quantity(frequency, "Hz", where="band") for frequency in band)
    return low, high
