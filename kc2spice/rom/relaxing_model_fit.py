"""Fit of relaxing models, such as networks of R and C, to a frequency response.

A symmetric first-order model with ``E > 0`` and ``A <= 0`` has real poles and symmetric residues of
rank one (first Foster form),

    H(s) = D + sum_k g_k g_k' / (s + r_k),    r_k >= 0,

and is stable and passive for all rates ``r_k`` and gains ``g_k``. A model with optimal rates and
gains often needs one state fewer than a projection with the same error. The fit starts from the
rates and gains of a projection. The fit optimises ``log r_k`` and ``g_k`` by nonlinear least
squares with the weights of Lawson's minimax fit.

Source: C. L. Lawson, Contributions to the Theory of Linear Least Maximum Approximations (1961).
"""

from __future__ import annotations

import numpy as np
import scipy

MAX_ROUNDS = 25  # largest number of updates of the weights
ROUND_EVALUATIONS = 30  # largest number of evaluations of the residuals per update of the weights
# number of weight updates after which an error above HOPELESS_RATIO times ``enough`` ends the fit
CHECKED_ROUNDS = 4
HOPELESS_RATIO = 1.5
# An update multiplies the weight of each frequency by sqrt(error / largest error +
# MIN_WEIGHT_FACTOR).
MIN_WEIGHT_FACTOR = 0.02


def fit_minimax(
    rates: np.ndarray,
    gains: np.ndarray,
    s: np.ndarray,
    response: np.ndarray,
    base: np.ndarray,
    enough: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Refine the rates and gains of a relaxing model to minimise its largest error.

    Parameters
    ----------
    rates : (k,) array
        Positive start values of ``r_k`` [1/s].
    gains : (k, ports) array
        Start values of ``g_k``.
    s : (n,) array
        Values of the Laplace variable [1/s] at which the response is given.
    response : (n, ports, ports) array
        Symmetric response to be fitted, without the direct term D.
    base : (ports, ports) array
        Divisors of relative errors, one for each entry of the response.
    enough : float
        Error at which the fit ends. The fit also ends if the error exceeds ``HOPELESS_RATIO *
        enough`` after :data:`CHECKED_ROUNDS` updates of the weights.

    Returns
    -------
    rates, gains, error
        Rates and gains with the smallest error of all iterations, and their largest relative error.

    Examples
    --------
    >>> s = 1j * np.geomspace(0.1, 10, 20)
    >>> response = 4 / (s + 2)[:, None, None]
    >>> rates, gains, error = fit_minimax(np.ones(1), np.ones((1, 1)), s, response, np.ones((1, 1)))
    >>> round(rates[0], 6), round(abs(gains[0, 0]), 6), error < 1e-9
    (np.float64(2.0), np.float64(2.0), True)
    """
    count, ports = gains.shape
    upper = np.triu_indices(ports)
    target, scale = response[:, upper[0], upper[1]], base[upper]
    weight = np.ones(len(s))
    x = np.r_[np.log(rates), gains.ravel()]
    best = x, np.inf

    def residuals(x: np.ndarray) -> np.ndarray:
        """Return the weighted residuals of the fit."""
        return _stack_parts(
            weight[:, None] * (_evaluate_model(x, count, s, upper) - target) / scale
        )

    def slopes(x: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residuals with respect to the unknowns ``x``."""
        return _stack_parts(
            weight[:, None, None] * _compute_slopes(x, count, s, upper) / scale[:, None]
        )

    for k in range(MAX_ROUNDS):
        fit = scipy.optimize.least_squares(
            residuals, x, jac=slopes, method="lm", x_scale="jac", max_nfev=ROUND_EVALUATIONS
        )
        x = fit.x
        size = np.abs((_evaluate_model(x, count, s, upper) - target) / scale).max(axis=1)
        if size.max() < best[1]:
            best = x, float(size.max())
        if best[1] <= enough or (k >= CHECKED_ROUNDS and best[1] > HOPELESS_RATIO * enough > 0):
            break
        weight = weight * np.sqrt(size / max(size.max(), np.finfo(float).tiny) + MIN_WEIGHT_FACTOR)
        weight = weight / weight.max()
    x, error = best
    return np.exp(x[:count]), x[count:].reshape(count, ports), error


def _evaluate_model(
    x: np.ndarray, count: int, s: np.ndarray, upper: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Evaluate the upper triangle of the model ``sum_k g_k g_k' / (s + r_k)``.

    The gains are g, and the rates are r. The result has the shape (n, entries).
    """
    rates, gains = np.exp(x[:count]), x[count:].reshape(count, -1)
    products = gains[:, upper[0]] * gains[:, upper[1]]
    return np.asarray((1 / (s[:, None] + rates)) @ products)


def _compute_slopes(
    x: np.ndarray, count: int, s: np.ndarray, upper: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Return the derivatives of the model with respect to log rates and gains.

    The model is the result of :func:`_evaluate_model`. The derivatives have the shape (n, entries,
    unknowns).
    """
    rates, gains = np.exp(x[:count]), x[count:].reshape(count, -1)
    answer = 1 / (s[:, None] + rates)
    products = (gains[:, upper[0]] * gains[:, upper[1]]).T
    by_rate = (-rates * answer**2)[:, None, :] * products
    ports, entries = gains.shape[1], np.arange(len(upper[0]))
    partial = np.zeros((len(entries), count, ports))
    partial[entries, :, upper[0]] += gains[:, upper[1]].T
    partial[entries, :, upper[1]] += gains[:, upper[0]].T
    by_gain = answer[:, None, :, None] * partial
    return np.concatenate([by_rate, by_gain.reshape(len(s), len(entries), -1)], axis=2)


def _stack_parts(values: np.ndarray) -> np.ndarray:
    """Stack real and imaginary parts of ``values`` (n, entries, ...) along axis 0.

    The result has the shape (2 * n * entries, ...). Its first half contains the real parts, and its
    second half the imaginary parts.
    """
    flat = values.reshape(-1, *values.shape[2:])
    return np.concatenate([flat.real, flat.imag])
