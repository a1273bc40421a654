"""Standard errors of a fitted model, and the likely cause of a misfit.

The input is the residuals ``r`` of a fit in units of the noise, real parts before imaginary parts,
and their Jacobian J. With n values, k keys and the misfit ``m = sqrt(r'r / (n - k))``:

- If the residuals are only noise, m is near 1. The covariance is ``max(1, m)^2 (J'J)^-1``.
- If the model does not describe the data, the residuals at neighbouring frequencies are correlated,
  and they are largest where the keys have the largest effect. This formula then does not apply.
  If m exceeds :data:`MODEL_ERROR_MISFIT`, the block jackknife is added: the values are fitted
  again without each of :data:`BAND_COUNT` contiguous frequency bands. For g bands, its covariance
  is ``(g - 1) / g sum (x_b - mean x)(x_b - mean x)'`` (H. R. Kuensch, Annals of Statistics 17
  (1989) 1217).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

# Misfit above which the model has errors; the misfit of pure noise scatters by 10 % with 50 points.
MODEL_ERROR_MISFIT = 1.5
BAND_COUNT = 8
WARNING_MISFIT = 3.0  # smallest misfit at which a fit prints a warning
# Ratio of a cause's remaining sum of squares to the smallest one; below this ratio, both causes are
# equally likely.
EQUAL_LIKELIHOOD_RATIO = 1.1
EXPLAINED_SHARE = 0.5  # smallest fraction of the sum of squares that a likely cause removes


def rms_misfit(residuals: np.ndarray, keys: int) -> float:
    """Return the rms residual in units of the noise.

    Parameters
    ----------
    residuals : (n,) array
        Differences to the data by the standard deviation of the noise.
    keys : int
        Number of fitted values.

    Examples
    --------
    >>> rms_misfit(np.array([3.0, -3.0, 3.0, -3.0]), 2)
    4.242640687119285
    """
    return float(np.sqrt(residuals @ residuals / max(len(residuals) - keys, 1)))


def noise_ratio(residuals: np.ndarray, keys: int) -> float:
    """Return the ratio of the residuals to the noise, at least 1; arguments as :func:`rms_misfit`.

    Examples
    --------
    >>> noise_ratio(np.array([0.5, -0.5, 0.5, -0.5]), 2)
    1.0
    """
    return max(1.0, rms_misfit(residuals, keys))


def estimate_covariance(J: np.ndarray, residuals: np.ndarray, widest: np.ndarray) -> np.ndarray:
    """Return the covariance (k, k) of the fitted values, or of their logarithms as in J.

    Parameters
    ----------
    J : (2 n, k) array
        Derivatives of the residuals with respect to the values.
    residuals : (2 n,) array
        Residuals at the end of the fit, real parts of n frequencies before imaginary parts.
    widest : (k,) array
        Ranges of the values; no standard error of the jackknife is larger.
    """
    _, s, Vt = np.linalg.svd(J, full_matrices=False)
    more = rms_misfit(residuals, J.shape[1])
    noise = noise_ratio(residuals, J.shape[1]) ** 2 * (Vt.T / np.maximum(s, 1e-12) ** 2) @ Vt
    if more < MODEL_ERROR_MISFIT:
        return np.asarray(noise)
    bands = np.array_split(np.arange(len(residuals) // 2), BAND_COUNT)
    moves = np.array([_change_without_band(J, residuals, band) for band in bands])
    moves -= moves.mean(axis=0)
    scatter = (BAND_COUNT - 1) / BAND_COUNT * moves.T @ moves
    size = np.sqrt(np.diag(scatter))
    limit = np.minimum(1.0, np.divide(widest, size, out=np.ones_like(size), where=size > 0))
    return np.asarray(noise + scatter * np.outer(limit, limit))


def _change_without_band(J: np.ndarray, residuals: np.ndarray, band: np.ndarray) -> np.ndarray:
    """Return the change (k,) of the values if the fit omits the frequencies in ``band``."""
    used = np.ones(len(residuals), dtype=bool)
    used[band] = used[band + len(residuals) // 2] = False
    return np.asarray(-np.linalg.lstsq(J[used], residuals[used], rcond=None)[0])


def find_likely_cause(
    J: np.ndarray, residuals: np.ndarray, causes: Mapping[str, np.ndarray]
) -> str | None:
    """Return the most frequent of the causes that best explain the residuals.

    The amount of each cause is fitted together with the values.

    Parameters
    ----------
    J : (2 n, k) array
        Derivatives of the residuals with respect to the values.
    residuals : (2 n,) array
        Residuals at the end of the fit.
    causes : mapping
        For each cause, the change (n,) of the logarithm of the admittance for the amount 1. The
        most frequent cause is first. Amounts are positive.

    Returns
    -------
    str or None
        None if no cause removes more than half of the sum of squares.
    """
    total = float(residuals @ residuals)
    left = {name: _residual_with_cause(J, residuals, column) for name, column in causes.items()}
    least = min(left.values(), default=total)
    if least >= (1 - EXPLAINED_SHARE) * total:
        return None
    return next(name for name, squares in left.items() if squares <= EQUAL_LIKELIHOOD_RATIO * least)


def _residual_with_cause(J: np.ndarray, residuals: np.ndarray, cause: np.ndarray) -> float:
    """Return the sum of squared residuals after a fit with a positive amount of a cause."""
    column = np.concatenate([cause.real, cause.imag])
    Q, _ = np.linalg.qr(J)
    column = column - Q @ (Q.T @ column)
    left = residuals - Q @ (Q.T @ residuals)
    amount = max(0.0, -float(column @ left) / max(float(column @ column), 1e-300))
    left = left + amount * column
    return float(left @ left)
