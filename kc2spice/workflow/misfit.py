"""Standard errors of a fitted model, and the likely cause of a misfit.

The input is the residuals ``r`` of a fit in units of the noise, real parts before imaginary parts,
and their Jacobian J. With n values, k keys and the misfit ``m = sqrt(r'r / (n - k))``:

- If the residuals are only noise, m is near 1. The covariance is ``max(1, m)^2 (J'J)^-1``.
- If the model does not describe the data, the residuals at neighbouring frequencies are correlated.
  Residuals of a wrong model are largest at frequencies where the fitted keys have the largest
  effect. Therefore, the covariance formula for pure noise does not apply to a wrong model. If m
  exceeds :data:`MODEL_ERROR_MISFIT`, the covariance of the block jackknife is added. For each of
  :data:`BAND_COUNT` contiguous bands b, the values x_b are fitted again without this band. For g
  bands, the jackknife covariance is ``(g - 1) / g * sum((x_b - mean x) * (x_b - mean x)')``
  (H. R. Kuensch, Annals of Statistics 17 (1989) 1217).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

# Misfit above which errors of the model are assumed.
# With 50 points, the misfit of pure noise scatters by 10 %.
MODEL_ERROR_MISFIT = 1.5
BAND_COUNT = 8
WARNING_MISFIT = 3.0  # smallest misfit at which a fit prints a warning
# Two causes of a misfit count as equally likely if the sums of squared residuals that remain with
# each cause differ by at most this factor.
EQUAL_LIKELIHOOD_RATIO = 1.1
# A cause of a misfit is likely if adding the cause to the model, with a fitted size, reduces the
# sum of squared residuals by more than this fraction.
EXPLAINED_SHARE = 0.5


def compute_rms_misfit(residuals: np.ndarray, keys: int) -> float:
    """Return the rms residual, relative to the standard deviation of the noise.

    Parameters
    ----------
    residuals : (n,) array
        Differences between model and data, divided by the standard deviation of the noise.
    keys : int
        Number of keys that the fit varied.

    Examples
    --------
    >>> compute_rms_misfit(np.array([3.0, -3.0, 3.0, -3.0]), keys=2)
    4.242640687119285
    """
    return float(np.sqrt(residuals @ residuals / max(len(residuals) - keys, 1)))


def compute_error_scale(residuals: np.ndarray, keys: int) -> float:
    """Return the factor for the standard errors: the rms residual, but at least 1.

    Residuals are divided by the standard deviation of the noise, so noise alone gives an rms
    residual of about 1. The arguments are defined in :func:`compute_rms_misfit`.

    Examples
    --------
    Four residuals of size 0.5 and two fitted keys give an rms residual of ``sqrt(4 * 0.5^2 / (4 -
    2)) = 0.71``. A value of 0.71 is below the lower limit 1 of the factor, so the factor is 1.

    >>> compute_error_scale(np.array([0.5, -0.5, 0.5, -0.5]), keys=2)
    1.0
    """
    return max(1.0, compute_rms_misfit(residuals, keys))


def estimate_covariance(J: np.ndarray, residuals: np.ndarray, widest: np.ndarray) -> np.ndarray:
    """Return the covariance of the fitted values, an array of shape (k, k).

    If J contains derivatives with respect to logarithms, the result is the covariance of the
    logarithms.

    Parameters
    ----------
    J : (2 * n, k) array
        Derivatives of the residuals with respect to the values.
    residuals : (2 * n,) array
        Residuals at the end of the fit, real parts of n frequencies before imaginary parts.
    widest : (k,) array
        Widths of the ranges of the values. A jackknife standard error of a value is limited to the
        width of the range of this value.
    """
    _, s, Vt = np.linalg.svd(J, full_matrices=False)
    more = compute_rms_misfit(residuals, J.shape[1])
    noise = (
        compute_error_scale(residuals, J.shape[1]) ** 2 * (Vt.T / np.maximum(s, 1e-12) ** 2) @ Vt
    )
    if more < MODEL_ERROR_MISFIT:
        return np.asarray(noise)
    bands = np.array_split(np.arange(len(residuals) // 2), BAND_COUNT)
    moves = np.array([_refit_without_band(J, residuals, band) for band in bands])
    moves -= moves.mean(axis=0)
    scatter = (BAND_COUNT - 1) / BAND_COUNT * moves.T @ moves
    size = np.sqrt(np.diag(scatter))
    limit = np.minimum(1.0, np.divide(widest, size, out=np.ones_like(size), where=size > 0))
    return np.asarray(noise + scatter * np.outer(limit, limit))


def _refit_without_band(J: np.ndarray, residuals: np.ndarray, band: np.ndarray) -> np.ndarray:
    """Return the changes of the fitted values if the fit omits a frequency band.

    ``band`` contains the indices of the omitted frequencies.
    """
    used = np.ones(len(residuals), dtype=bool)
    used[band] = used[band + len(residuals) // 2] = False
    return np.asarray(-np.linalg.lstsq(J[used], residuals[used], rcond=None)[0])


def find_likely_cause(
    J: np.ndarray, residuals: np.ndarray, causes: Mapping[str, np.ndarray]
) -> str | None:
    """Return the cause that best explains the residuals of a fit.

    Of several equally likely causes, the cause that is most frequent in practice is returned. For
    each cause, a linear fit determines the amount of the cause together with changes of the fitted
    values.

    Parameters
    ----------
    J : (2 * n, k) array
        Derivatives of the residuals with respect to the values.
    residuals : (2 * n,) array
        Residuals at the end of the fit.
    causes : mapping
        For each cause, the change of the logarithm of the admittance at n frequencies, if the cause
        has the amount 1. Causes that are common in practice are listed before rare causes. Amounts
        are positive.

    Returns
    -------
    str or None
        Name of the cause; None if no cause removes more than half of the sum of squared residuals.
    """
    total = float(residuals @ residuals)
    left = {
        name: _compute_residual_with_cause(J, residuals, column) for name, column in causes.items()
    }
    least = min(left.values(), default=total)
    if least >= (1 - EXPLAINED_SHARE) * total:
        return None
    return next(name for name, squares in left.items() if squares <= EQUAL_LIKELIHOOD_RATIO * least)


def _compute_residual_with_cause(J: np.ndarray, residuals: np.ndarray, cause: np.ndarray) -> float:
    """Return the sum of squared residuals of a fit that includes a cause of misfit."""
    column = np.concatenate([cause.real, cause.imag])
    Q, _ = np.linalg.qr(J)
    column = column - Q @ (Q.T @ column)
    left = residuals - Q @ (Q.T @ residuals)
    amount = max(0.0, -float(column @ left) / max(float(column @ column), 1e-300))
    left = left + amount * column
    return float(left @ left)
