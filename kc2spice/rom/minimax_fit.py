"""Fits that reduce the largest error of reduced models in the norm *peak*.

The fitted parameters are the output matrix of a projected model, or the rates and gains of a model
with real poles. For the same tolerance, a fitted model needs fewer states than a projected model
without a fit. The fits are minimax fits with Lawson's weights: C. L. Lawson, Contributions to the
Theory of Linear Least Maximum Approximations (1961).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from kc2spice.rom.pencil import Pencil
from kc2spice.rom.reduced_basis import SAFETY_FACTOR, ReducedBasis
from kc2spice.rom.reductors.balanced_truncation import compute_balancing_factors
from kc2spice.rom.reductors.snapshots import choose_snapshots
from kc2spice.rom.relaxing_model_fit import fit_minimax
from kc2spice.rom.response import Response

# limits and factors of the fits, found by trials
MAX_ORDER = 150  # largest order for which the output matrix is fitted
MAX_FIT_PARAMETERS = 60  # largest number of fitted rates and gains of a relaxing model
MAX_ROUNDS = 12  # largest number of updates of the weights
# An update multiplies the weight of each frequency by sqrt(error / largest error + MIN_WEIGHT).
MIN_WEIGHT = 0.05
# Number of successive orders whose fit may fail before the search ends.
# Errors may increase with the order, so a fit of a lower order may succeed after a failure.
MAX_FAILURES = 4
HOPELESS_RATIO = 1.5  # ratio of error to tolerance above which a fit ends without success
# Ratio of error to tolerance below which a fit ends successfully. The error estimate may be
# slightly larger than the error of the fit.
SUFFICIENT_RATIO = 0.97


def find_lower_order(basis: ReducedBasis, order: int, tolerance: float) -> tuple[ReducedBasis, int]:
    """Return a fitted basis of lower order within the tolerance, and the order.

    If no fit succeeds, return ``basis`` and ``order``.
    """
    if basis.task.norm != "peak":
        return basis, order
    if basis.has_only_real_poles:
        return fit_relaxations(basis, order, tolerance)
    if not basis.congruence and order <= MAX_ORDER:
        return fit_output_matrix(basis, order, tolerance)
    return basis, order


def fit_output_matrix(
    basis: ReducedBasis, order: int, tolerance: float
) -> tuple[ReducedBasis, int]:
    """Fit the output matrix C by minimax, so that a basis of lower order suffices.

    Return a basis with the fitted output matrix, and its order, which is as low as possible. If no
    fit succeeds, the arguments are returned.
    """
    estimator = basis.task.estimator
    s = choose_snapshots(estimator, estimator.exact).s
    H, peak = estimator.exact.transfer(s), estimator.exact_response_and_scales[1].peak
    rows, columns = compute_balancing_factors(peak)
    target = (H - basis.pencil.D) / (rows[:, None] * columns)
    best, trial_order, sufficient = (
        (basis, order),
        order,
        SUFFICIENT_RATIO * tolerance / SAFETY_FACTOR,
    )
    while trial_order > max(1, basis.pencil.free, best[1] - MAX_FAILURES):
        trial_order -= 1
        response = basis.get_response_of_order(trial_order)
        pencil, x = response.pencil, response.states(s) / columns
        weight = np.ones((len(s), 1, x.shape[2]))
        for _ in range(MAX_ROUNDS):
            C = _solve_least_squares(x * weight, target * weight) * rows[:, None]
            error = np.abs(C @ (x * columns) + pencil.D - H) / (peak + np.finfo(float).tiny)
            if not sufficient < error.max() < HOPELESS_RATIO * tolerance:
                break
            ratio = error.max(axis=1, keepdims=True) / error.max()
            weight = weight * np.sqrt(ratio + MIN_WEIGHT)
        if error.max() <= sufficient:
            trial = replace(basis, pencil=replace(pencil, C=C))
            trial.responses[trial_order] = Response(trial.pencil, response.modes)
            if trial.is_acceptable(trial_order, tolerance):
                best = trial, trial_order
    return best


def fit_relaxations(basis: ReducedBasis, order: int, tolerance: float) -> tuple[ReducedBasis, int]:
    """Fit rates and gains of a model with real poles, so that a lower order suffices.

    Relaxing models, such as networks of R and C, are always passive. Return a basis with the fitted
    rates and gains, and its order, which is as low as possible. If no fit succeeds, the arguments
    are returned. Models with rigid-body modes or with fixed static responses of ports are not
    fitted.
    """
    estimator, ports = basis.task.estimator, basis.pencil.B.shape[1]
    if basis.fixed or basis.pencil.free:
        return basis, order
    s = choose_snapshots(estimator, estimator.exact).s
    H, base = (
        estimator.exact.transfer(s),
        estimator.exact_response_and_scales[1].peak + np.finfo(float).tiny,
    )
    best, sufficient = (basis, order), SUFFICIENT_RATIO * tolerance / SAFETY_FACTOR
    origin = f"{basis.origin}fitted rates and gains; "
    for trial_order in range(order - 1, 0, -1):
        if trial_order * (1 + ports) > MAX_FIT_PARAMETERS:
            break
        rates, T = scipy.linalg.eigh(*basis.pencil.truncate_to_order(trial_order).coefficients)
        if rates[0] <= 0:
            break
        start = rates, T.T @ basis.pencil.B[:trial_order]
        rates, gains, error = fit_minimax(*start, s, H - basis.pencil.D, base, sufficient)
        parts = np.diag(rates), np.eye(trial_order)
        pencil = Pencil(parts, gains, gains.T.copy(), basis.pencil.D)
        trial = replace(basis, pencil=pencil, origin=origin, vectors=None)
        if error > sufficient or not trial.is_acceptable(trial_order, tolerance):
            break
        best = trial, trial_order
    return best


def _solve_least_squares(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Compute the real matrix C that minimises the sum of the squares of ``C x - y``.

    The sum includes all frequencies, outputs and inputs.
    """
    left, right = (np.moveaxis(P, 1, 2).reshape(-1, P.shape[1]) for P in (x, y))
    both = [np.vstack([P.real, P.imag]) for P in (left, right)]
    size = np.linalg.norm(both[0], axis=0) + np.finfo(float).tiny
    return np.asarray(np.linalg.lstsq(both[0] / size, both[1], rcond=None)[0].T / size)
