"""The band to reduce for when nobody names one: up to the fifth lowest natural frequency."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse.linalg import ArpackError, LinearOperator, eigs

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.linalg.memory import require_factors
from kc2spice.rom.operators import dense, largest
from kc2spice.rom.pencil import Pencil, eliminated, proportional

MODES = 5
SMALL = 200  # equations up to which all poles are computed
BEYOND = 1.1  # the band ends a little past the mode, not on it
SHIFT = 1e-3  # of the band: below it nothing need be resolved
CLOSE = 1e-4  # of the rates, whose fifth is only rounded up to a band


def natural_band(pencil: Pencil) -> tuple[float, float]:
    """``(0, f)`` [Hz], f a little above the fifth lowest undamped natural frequency (second order)
    or corner frequency (first order) of the full model.

    Raises
    ------
    UsageError : the model is free to move or has no such frequency; a band must be given. Or it is
        too large for this machine.
    """
    try:
        rates = _small(pencil) if pencil.size <= SMALL else _lowest(pencil)
    except (SimulationError, ArpackError):
        rates = np.empty(0)
    rates = np.sort(rates[rates > 0])[:MODES]
    if not rates.size:
        raise UsageError(
            "no natural frequency suggests a band",
            where="band",
            hint="name the frequencies of interest: --band 0 2e4",
        )
    return 0.0, float(BEYOND * rates[-1] / (2 * np.pi))


def reach(pencil: Pencil, count: int, high: float) -> float:
    """Frequency [Hz] of the ``count``-th lowest natural motion, at most ``high``; ``high`` where
    there are not so many, or they are not to be had.

    A shift far below ``high`` lets the body be free to move.
    """
    pencil = proportional(eliminated(pencil))
    if pencil.degree != 2 or not pencil.symmetric or pencil.size <= count + 2:
        return high
    shift = 2 * np.pi * high * SHIFT
    M = pencil.coefficients[-1]
    try:
        solve = pencil.pencil_solver(-(shift**2)).solve
        inverse = LinearOperator((pencil.size,) * 2, matvec=lambda x: solve(M @ x), dtype=float)
        start = solve(pencil.B[:, 0])
        values = eigs(inverse, count, v0=start, tol=CLOSE, return_eigenvectors=False)
    except (SimulationError, UsageError, ArpackError):
        return high
    squares = 1 / np.abs(values) - shift**2
    return min(high, float(np.sqrt(max(squares.max(), 0.0)) / (2 * np.pi)))


def _small(pencil: Pencil) -> np.ndarray:
    rest, inertia = (dense(P) for P in (pencil.coefficients[0], pencil.coefficients[-1]))
    if largest(rest) == 0 or largest(inertia) == 0:
        return np.empty(0)
    rates = np.abs(Pencil((rest, inertia), pencil.B, pencil.C, pencil.D).poles())
    rates = rates[rates > 1e-12 * rates.max(initial=0.0)]
    return np.asarray(rates if pencil.degree == 1 else np.sqrt(rates))


def _lowest(pencil: Pencil) -> np.ndarray:
    """Reciprocals of the largest eigenvalues of ``P(0)^-1`` times the inertia."""
    require_factors(pencil.bordered(1.0, 1.0, 1.0))
    solve = _at_rest(pencil)
    inertia = pencil.coefficients[-1]
    n = pencil.size
    inverse = LinearOperator((n, n), matvec=lambda x: solve(inertia @ x), dtype=float)
    values = np.abs(
        eigs(inverse, MODES + 1, v0=solve(pencil.B[:, 0]), tol=CLOSE, return_eigenvectors=False)
    )
    rates = 1 / values[values > 0]
    return np.asarray(rates if pencil.degree == 1 else np.sqrt(rates))


def _at_rest(pencil: Pencil) -> Callable[[np.ndarray], np.ndarray]:
    """``P(0)^-1``, by the factors that the reduction will use where K is definite."""
    if pencil.degree == 2 and pencil.symmetric:
        try:
            return pencil.pencil_solver(0.0).solve
        except SimulationError:
            pass  # indefinite
    return pencil.solver(0.0)[0].solve
