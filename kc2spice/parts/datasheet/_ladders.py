"""Ladder networks that approximate irrational frequency responses.

The networks consist of resistors and inductors, or of springs and dampers.

A response ``f(s)`` with losses at all frequencies, such as ``1/sqrt(s)`` or ``ln(1 + 1/s)``, is
approximated in a frequency band by ::

    f(s) = constant + integral / s + sum_k weight_k corner_k / (s + corner_k)

All coefficients are positive. Each term is therefore a passive two-terminal network, and the sum is
also passive (R. M. Foster, Bell System Technical Journal 3 (1924) 259).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

# Number of frequencies for the fit of a ladder, and for its error.
_FIT_POINTS, _CHECK_POINTS = 120, 2000
# Band [rad/s] of the ladder for semi-inductances: 5 Hz to 50 kHz, wider than the audio band.
SEMI_INDUCTANCE_BAND = 2 * np.pi * 5.0, 2 * np.pi * 50e3
# Number of branches of the ladder for semi-inductances.
# Each additional branch divides the error of the ladder by 2.3.
SEMI_INDUCTANCE_BRANCHES = 9
# Frequency band of the ladder for creep, divided by the creep frequency.
CREEP_BAND = 1e-3, 30.0
# Number of elements of the ladder for creep. Each additional element divides the error by 2.9.
CREEP_ELEMENTS = 6


@dataclass(frozen=True)
class RelaxationLadder:
    """Coefficients of a relaxation ladder, and its largest relative error in a band."""

    corners: tuple[float, ...]
    weights: tuple[float, ...]
    constant: float
    integral: float
    error: float

    def evaluate(self, s: np.ndarray) -> np.ndarray:
        """Return the response (n,) of the ladder at the complex frequencies ``s``."""
        corners, weights = np.array(self.corners), np.array(self.weights)
        terms = weights * corners / (s[:, None] + corners)
        return np.asarray(self.constant + self.integral / s + terms.sum(axis=1))


def fit_ladder(
    response: Callable[[np.ndarray], np.ndarray],
    band: tuple[float, float],
    count: int,
    ends: bool,
) -> RelaxationLadder:
    """Fit a relaxation ladder to a frequency response by least squares.

    The fit minimises the relative error of the response. The unknowns of the fit are the logarithms
    of the coefficients. Therefore, all coefficients are positive. The start values of the corners
    are a geometric sequence in the band.

    Parameters
    ----------
    response : callable
        Function that returns the response (n,) at the complex frequencies ``s`` (n,).
    band : pair of float
        Lowest and highest angular frequency of the fit.
    count : int
        Number of terms with a corner.
    ends : bool
        Whether the ladder has the terms ``constant`` and ``integral / s``.

    Returns
    -------
    RelaxationLadder
        Coefficients of the ladder, and its largest relative error in the band.

    Examples
    --------
    >>> ladder = fit_ladder(lambda s: s**-0.5, (1.0, 1e4), 9, ends=True)
    >>> print(f"{ladder.error:.4f}")
    0.0016
    """
    from scipy.optimize import least_squares  # loads slowly

    s = 1j * np.geomspace(*band, _FIT_POINTS)
    target, corners = response(s), np.geomspace(*band, count)
    start = [np.log(np.abs(response(1j * corners)) / 2), np.log(corners)]
    if ends:
        low, high = np.abs(response(1j * np.array(band)))
        start.append(np.log([high / 3, low * band[0] / 3]))

    def evaluate_terms(x: np.ndarray) -> np.ndarray:
        """Return the terms of the ladder, divided by the response that it approximates.

        ``x`` contains the logarithms of the coefficients.
        """
        weight, corner = np.exp(x[:count]), np.exp(x[count : 2 * count])
        columns = [weight * corner / (s[:, None] + corner)]
        if ends:
            constant, integral = np.exp(x[2 * count :])
            columns += [np.full((len(s), 1), constant), integral / s[:, None]]
        return np.hstack(columns) / target[:, None]

    def residuals(x: np.ndarray) -> np.ndarray:
        """Return the real and imaginary parts of the ladder's relative error."""
        error = evaluate_terms(x).sum(axis=1) - 1
        return np.concatenate([error.real, error.imag])

    def slopes(x: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residuals with respect to the unknowns ``x``."""
        columns, corner = evaluate_terms(x), np.exp(x[count : 2 * count])
        moved = columns[:, :count] * s[:, None] / (s[:, None] + corner)
        by_all = np.hstack([columns[:, :count], moved, columns[:, count:]])
        return np.concatenate([by_all.real, by_all.imag])

    x = least_squares(residuals, np.concatenate(start), slopes, xtol=1e-12, ftol=1e-12).x
    values = np.exp(x).tolist()
    constant, integral = values[2 * count :] if ends else (0.0, 0.0)
    ladder = RelaxationLadder(
        tuple(values[count : 2 * count]), tuple(values[:count]), constant, integral, 0.0
    )
    check = 1j * np.geomspace(*band, _CHECK_POINTS)
    error = float(np.abs(ladder.evaluate(check) / response(check) - 1).max())
    return RelaxationLadder(ladder.corners, ladder.weights, constant, integral, error)


@cache
def make_semi_inductance_ladder() -> RelaxationLadder:
    """Fit a relaxation ladder to ``1/sqrt(s)``, the admittance of a semi-inductance.

    The semi-inductance is 1 H s^(-1/2). It represents the eddy currents of a coil.
    """
    return fit_ladder(lambda s: s**-0.5, SEMI_INDUCTANCE_BAND, SEMI_INDUCTANCE_BRANCHES, ends=True)


@cache
def fit_creep_ladder() -> RelaxationLadder:
    """Fit a relaxation ladder to ``ln(1 + 1/s)``, the creep term of a suspension.

    The function ``ln(1 + 1/s)`` is the relative increase of a compliance by creep. Here ``s`` is
    the complex frequency, divided by the creep frequency.
    """
    return fit_ladder(lambda s: np.log(1 + 1 / s), CREEP_BAND, CREEP_ELEMENTS, ends=False)
