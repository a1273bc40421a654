"""Fit of a Foster network with positive elements to a measured thermal transient.

If a power P is switched on or off at t = 0, the temperature is::

    T(t) = T_0 +- P Z(t)        Z(t) = sum_k R_k (1 - exp(-t / t_k)),   R_k >= 0

The fit has four steps:

1. The R_k for a logarithmic grid of time constants t_k are fitted by non-negative least squares
   (C. L. Lawson, R. J. Hanson, Solving Least Squares Problems, 1974, chapter 23). No other network
   with time constants on the grid describes the samples better. Most R_k are zero.
2. The noise of the samples is estimated from the differences between successive residuals. Slow
   deviations between samples and fitted sum cancel in differences of successive residuals.
3. Neighbouring time constants on the grid are merged into one. The logarithms of all R_k and t_k
   are refined by bounded least squares.
4. Two neighbouring time constants are merged, and all R_k and t_k are refined again. The merged
   pair is the pair whose mean describes the samples best. The merging is repeated until one time
   constant remains. The result is the sum with the smallest Bayesian information criterion,
   ``sum (residual / noise)^2 + parameters log(samples)`` (G. Schwarz, Ann. Statist. 6 (1978) 461).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter

import numpy as np
from scipy.optimize import least_squares, nnls

from kc2spice.core.equality import EqualByContent
from kc2spice.rom.heat_network import FosterNetwork, compute_step_basis

PER_DECADE = 8  # number of time constants per decade of the grid
# smallest permitted time constant, relative to the time of the first sample after the step
SHORTEST = 1 / 3
LONGEST = 10.0  # largest permitted time constant, relative to the time of the last sample
MOST_CONSTANTS = 12  # largest number of time constants of a network: two for each of six decades
POLISH = 200  # largest number of function evaluations in a refinement
# Tolerances of the sum of squares, the parameters and the gradient at which a refinement ends.
# With the tolerances EXACT, rounding errors of samples do not change the printed digits of a fit.
EXACT = {"ftol": 1e-14, "xtol": 1e-11, "gtol": 1e-14}
# Number of groups of samples per decade of time.
# The fit compares the mean of the samples in a group with the mean of the network's response.
# The response hardly changes within a group, because the time changes by only 5 %.
GROUPS_PER_DECADE = 50
# smallest noise relative to the largest temperature rise, for samples with nine digits
ROUNDING = 1e-9
EMPTY = 1e-9  # a resistance counts as zero up to this fraction of the largest resistance
# The fit keeps every resistance between exp(-SPREAD) and exp(SPREAD) times the total resistance.
SPREAD = 50.0
# Smallest distance of the start values of a refinement from their bounds.
# Start values and bounds are logarithms of thermal resistances and time constants.
INSIDE = 1e-9
NNLS_STEPS = 30  # largest number of iterations of the non-negative least squares per time constant
# A response has not settled if (time constant / time of the last sample) exceeds UNSETTLED.
UNSETTLED = 1 / 3


@dataclass(frozen=True, eq=False)
class StepSamples(EqualByContent):
    """Samples of a thermal transient: temperatures divided by the power [K/W].

    ``value`` (n,) contains the samples at the times ``time`` (n,) [s] after the power step.
    Residuals of a fit are multiplied by ``weight`` (n,). If ``offset`` is true, the temperature
    before the step is unknown.
    """

    time: np.ndarray
    value: np.ndarray
    weight: np.ndarray
    offset: bool

    @cached_property
    def _time_sample_groups(self) -> tuple[np.ndarray, np.ndarray]:
        """Groups of time samples: start index and scale factor of each group."""
        after = self.time > 0
        number = np.full(len(self.time), -1)
        logs = np.log10(self.time[after] / self.time[after].min())
        number[after] = np.floor(GROUPS_PER_DECADE * logs)
        first = np.flatnonzero(np.diff(number, prepend=-2))
        return first, 1 / np.sqrt(np.add.reduceat(self.weight**2, first))

    def average_groups(self, table: np.ndarray) -> np.ndarray:
        """Average the rows of a table over groups of samples, with weights.

        The table (n, columns) has one row for each sample. The result has the shape (groups,
        columns). Each mean is multiplied by the root of the sum of the squared weights in its
        group. With this scaling, a fit to the means gives the same parameters as a fit to all rows
        if the fitted function is constant within each group.
        """
        first, scale = self._time_sample_groups
        return np.asarray(
            scale[:, None] * np.add.reduceat(self.weight[:, None] ** 2 * table, first)
        )


@dataclass(frozen=True, eq=False)
class TransientFit(EqualByContent):
    """Foster network fitted to a thermal transient, and residuals of the fit.

    ``start`` [K/W] is the temperature before the step, divided by the power. ``residual`` (n,)
    contains the weighted residuals. ``noise`` is the standard deviation of the noise in the
    weighted samples.
    """

    network: FosterNetwork
    start: float
    residual: np.ndarray
    noise: float

    @property
    def rms_residual(self) -> float:
        """Rms value of the weighted residuals."""
        return float(np.sqrt(np.mean(self.residual**2)))


def fit_transient(samples: StepSamples) -> TransientFit:
    """Fit a Foster network to samples of a step response.

    The Bayesian information criterion determines the number of time constants.

    Examples
    --------
    >>> network = FosterNetwork(np.array([2.0, 1.0]), np.array([0.01, 1.0]))
    >>> time = np.geomspace(1e-3, 10.0, 60)
    >>> noise = 0.003 * np.random.default_rng(1).standard_normal(60)
    >>> value = network.compute_step_response(time) + noise
    >>> fit = fit_transient(StepSamples(time, value, np.ones(60), offset=False))
    >>> len(fit.network.resistance), round(fit.network.total_resistance, 1)
    (2, 3.0)
    """
    after = samples.time[samples.time > 0]
    low, high = SHORTEST * after.min(), LONGEST * after.max()
    grid = np.geomspace(low, high, int(np.ceil(PER_DECADE * np.log10(high / low))) + 1)
    resistance, start = _fit_resistances(samples, grid)
    residual = _compute_residual(samples, resistance, grid, start)
    size = float(np.max(np.abs(samples.weight * (samples.value - start)), initial=0.0))
    noise = max(float(np.sqrt(0.5 * np.mean(np.diff(residual) ** 2))), ROUNDING * size)
    constants = _merge_neighbours(grid, resistance)
    while len(constants) > MOST_CONSTANTS:
        constants = _merge_best_pair(samples, constants)
    fits = [_refine_network(samples, constants, (low, high), noise)]
    while len(fits[-1].network.resistance) > 1:
        constants = _merge_best_pair(samples, fits[-1].network.time_constant)
        fits.append(_refine_network(samples, constants, (low, high), noise))
    return min(fits, key=_compute_information_criterion)


def compute_unsettled_share(network: FosterNetwork, last: float) -> float:
    """Return the fraction of a network's resistance not yet settled at ``last`` [s].

    The temperature differences across resistances with long time constants have not yet reached
    their final values at ``last``.
    """
    slow = network.time_constant > UNSETTLED * last
    return float(network.resistance[slow].sum()) / network.total_resistance


def _compute_information_criterion(fit: TransientFit) -> float:
    """Return the Bayesian information criterion of a fit."""
    parameters = 2 * len(fit.network.resistance)
    excess = float(np.sum((fit.residual / fit.noise) ** 2))
    return excess + parameters * float(np.log(len(fit.residual)))


def _fit_resistances(samples: StepSamples, constants: np.ndarray) -> tuple[np.ndarray, float]:
    """Fit the start value and non-negative resistances, for given time constants."""
    columns = compute_step_basis(samples.time, constants)
    if samples.offset:
        one = np.ones((len(samples.time), 1))
        columns = np.hstack([columns, one, -one])
    table = samples.average_groups(np.column_stack([columns, samples.value]))
    size = np.linalg.norm(table[:, :-1], axis=0)
    solution, _ = nnls(table[:, :-1] / size, table[:, -1], maxiter=NNLS_STEPS * columns.shape[1])
    solution = solution / size
    n = len(constants)
    return solution[:n], float(solution[n] - solution[n + 1]) if samples.offset else 0.0


def _compute_residual(
    samples: StepSamples, resistance: np.ndarray, constants: np.ndarray, start: float
) -> np.ndarray:
    """Return the weighted differences of the network's step response to the samples."""
    value = start + compute_step_basis(samples.time, constants) @ resistance
    return np.asarray(samples.weight * (value - samples.value))


def _merge_neighbours(grid: np.ndarray, resistance: np.ndarray) -> np.ndarray:
    """Merge neighbouring time constants on the grid that have nonzero resistances.

    One time constant between two points of the grid appears as nonzero resistances at both points.
    """
    nonzero = np.flatnonzero(resistance > EMPTY * resistance.max(initial=0.0))
    if not nonzero.size:
        return np.asarray(np.sqrt(grid[:1] * grid[-1:]))
    logs = list[float]()
    for run in np.split(nonzero, np.flatnonzero(np.diff(nonzero) > 1) + 1):
        for pair in np.array_split(run, (len(run) + 1) // 2):
            logs.append(float(np.average(np.log(grid[pair]), weights=resistance[pair])))
    return np.asarray(np.exp(logs))


def _merge_best_pair(samples: StepSamples, constants: np.ndarray) -> np.ndarray:
    """Merge the two neighbouring time constants whose mean describes samples best.

    The mean is the geometric mean of both time constants.
    """
    logs = np.sort(np.log(constants))
    trials = list[tuple[float, np.ndarray]]()
    for k in range(len(logs) - 1):
        trial = np.exp(np.r_[logs[:k], 0.5 * (logs[k] + logs[k + 1]), logs[k + 2 :]])
        resistance, start = _fit_resistances(samples, trial)
        residual = _compute_residual(samples, resistance, trial, start)
        trials.append((float(residual @ residual), trial))
    return min(trials, key=itemgetter(0))[1]


def _refine_network(
    samples: StepSamples, constants: np.ndarray, limits: tuple[float, float], noise: float
) -> TransientFit:
    """Refine resistances and time constants by least squares.

    The refined time constants stay within ``limits`` [s].
    """
    resistance, start = _fit_resistances(samples, constants)
    nonzero = resistance > EMPTY * resistance.max(initial=0.0)
    if not nonzero.any():
        nonzero[0], resistance[0] = True, np.finfo(float).tiny
    logs = np.r_[np.log(resistance[nonzero]), np.log(constants[nonzero])]
    count = int(nonzero.sum())
    time = np.maximum(samples.time, 0.0)

    def split_parameters(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Return resistances, time constants and the start value for the parameters ``x``."""
        R, t = np.exp(x[:count]), np.exp(x[count : 2 * count])
        return R, t, float(x[-1]) if samples.offset else 0.0

    def residual(x: np.ndarray) -> np.ndarray:
        """Return the weighted residuals of the fit."""
        R, t, start = split_parameters(x)
        return samples.average_groups(
            (start + compute_step_basis(time, t) @ R - samples.value)[:, None]
        )[:, 0]

    def slopes(x: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residuals with respect to the unknowns ``x``."""
        R, t, _ = split_parameters(x)
        ratio = time[:, None] / t
        # derivatives: d/d(log R) = R (1 - exp(-t/t_k)), d/d(log t_k) = -R (t/t_k) exp(-t/t_k)
        table = [-R * np.expm1(-ratio), -R * ratio * np.exp(-ratio)]
        table += [np.ones((len(time), 1))] if samples.offset else []
        return samples.average_groups(np.hstack(table))

    total = float(np.log(resistance.sum()))
    low = np.r_[np.full(count, total - SPREAD), np.full(count, np.log(limits[0]))]
    high = np.r_[np.full(count, total + SPREAD), np.full(count, np.log(limits[1]))]
    x = np.clip(logs, low + INSIDE, high - INSIDE)
    if samples.offset:
        x, low, high = np.r_[x, start], np.r_[low, -np.inf], np.r_[high, np.inf]
    scale = np.linalg.norm(slopes(x), axis=0)
    x_scale = 1 / np.where(scale > 0, scale, 1.0)
    solution = least_squares(
        residual, x, slopes, bounds=(low, high), x_scale=x_scale, max_nfev=POLISH, **EXACT
    )
    R, t, start = split_parameters(solution.x)
    order = np.argsort(t)
    network = FosterNetwork(R[order], t[order])
    return TransientFit(network, start, _compute_residual(samples, R, t, start), noise)
