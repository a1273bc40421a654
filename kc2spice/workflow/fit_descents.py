"""Fits of body keys with reduced models; full models correct the fitted values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.stats import qmc

from kc2spice.core.errors import UsageError
from kc2spice.parts.bodies._varied_keys import VariedKey, read_key_values
from kc2spice.rom.parametric_models import DenseParametricModel, ParameterAxis
from kc2spice.scene.load import load_scene
from kc2spice.workflow.body_fit import (
    DIFFERENCE_STEP,
    BodyFit,
    FitLimitError,
    ParameterAxes,
)
from kc2spice.workflow.fit_keys import compute_log_widths, is_at_bound
from kc2spice.workflow.misfit import compute_error_scale

# Number of random samples of the parameter ranges, and number of least-squares runs of a fit.
# The first least-squares run begins at the values of the scene.
RANDOM_SAMPLES = 64
DESCENT_COUNT = 4
# Width of a key's parameter range in a repeated fit, divided by its width in the previous fit.
RANGE_RATIO = 0.25
# Smallest half-width of a key's narrowed range, measured in the natural logarithm of the value.
MIN_LOG_WIDTH = 0.01
POLYNOMIAL_DEGREE = 3  # degree of the polynomials over a narrow parameter range
# largest number of times that the fit is repeated with new, usually narrower ranges of the keys
RANGE_COUNT = 8
# largest number of steps, in one parameter range, by which the full model corrects a fit
MESH_CORRECTIONS = 4
# Corrections end when a correction changes all values by less than CONVERGED_CHANGE standard
# errors.
CONVERGED_CHANGE = 0.1


@dataclass(frozen=True, eq=False)
class DescentResult:
    """Result of a least-squares run: key values, parameter ranges and solution.

    ``exact`` is the admittance [S] of the full model at the fitted ``values``. The array ``exact``
    is empty until the full model has corrected the fit.
    """

    values: dict[str, float]
    solved: OptimizeResult
    parameter_axes: ParameterAxes
    exact: np.ndarray = field(default_factory=lambda: np.empty(0))

    @property
    def cost(self) -> float:
        """Half of the sum of squared residuals."""
        return float(self.solved.cost)


@dataclass(frozen=True, eq=False)
class Descent:
    """Descent from start values to a local least-squares fit, with a reduced model.

    The fit varies scene keys. The reduced model is valid in the ranges of the keys. The variables
    are the logarithms of the key values. ``degree`` is the degree of the polynomials in the
    parameters; by default the reduction chooses the degree.
    """

    body: BodyFit
    parameter_axes: ParameterAxes
    degree: int | None = None

    @cached_property
    def reduced_model(self) -> DenseParametricModel:
        """Reduced model that is valid in the parameter ranges."""
        return self.body.reduce(self.parameter_axes, self.degree)

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper limits of the logarithm of the absolute value of each key."""
        ends = np.log(np.abs([[axis.low, axis.high] for axis in self.parameter_axes.values()]))
        return ends.min(axis=1), ends.max(axis=1)

    def compute_key_values(self, x: np.ndarray) -> dict[str, float]:
        """Convert logarithms to the values of the keys, limited to their ranges."""
        signs = np.sign(list(map(attrgetter("low"), self.parameter_axes.values())))
        values = signs * np.exp(np.clip(x, *self.bounds))
        return dict(zip(self.parameter_axes, values.tolist(), strict=True))

    def compute_fit_residuals(self, x: np.ndarray) -> np.ndarray:
        """Compute the fit residuals at ``x``, the logarithms of the values of fitted keys."""
        return self.compute_log_ratio(
            self.body.compute_reduced_admittance(self.reduced_model, self.compute_key_values(x))
        )

    def compute_log_ratio(self, Y: np.ndarray) -> np.ndarray:
        """Return the noise-weighted real and imaginary parts of log(Y / measured Y).

        The real parts come before the imaginary parts.
        """
        ratio = np.log(Y / self.body.Y)
        return np.concatenate([ratio.real, ratio.imag]) / self.body.noise_of_log_admittance

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residuals with respect to logarithms of the keys.

        The result is an array of shape (2 * n, keys). The derivatives are central differences, or
        one-sided differences at a bound.
        """
        low, high = self.bounds
        columns = []
        for k in range(len(x)):
            ends = np.tile(x, (2, 1))
            ends[:, k] = np.clip(
                x[k] + np.array([-DIFFERENCE_STEP, DIFFERENCE_STEP]), low[k], high[k]
            )
            change = self.compute_fit_residuals(ends[1]) - self.compute_fit_residuals(ends[0])
            columns.append(change / (ends[1, k] - ends[0, k]))
        return np.column_stack(columns)

    def compute_start_logarithms(self, values: Mapping[str, float]) -> np.ndarray:
        """Return the logarithms of the start values of all keys, limited to their ranges."""
        return np.clip(
            np.log(np.abs(list(map(values.__getitem__, self.parameter_axes)))), *self.bounds
        )

    def solve(self, values: Mapping[str, float]) -> DescentResult:
        """Fit the keys by least squares, starting at the argument ``values``."""
        solved = least_squares(
            self.compute_fit_residuals, self.compute_start_logarithms(values),
            jac=self.jacobian, bounds=self.bounds, x_scale="jac",
            xtol=1e-10, ftol=1e-10, max_nfev=60,
        )  # fmt: skip
        return DescentResult(self.compute_key_values(solved.x), solved, self.parameter_axes)


def run_descents(descent: Descent) -> list[DescentResult]:
    """Run least-squares fits from several start values; return all, best fit first.

    In every least-squares fit, each key may take all values of its full range.

    Raises
    ------
    UsageError : the fit needs too many finite-element models, or too many admittances.
    """
    keys = [item.key for item in descent.body.keys]
    try:
        _ = descent.reduced_model
    except FitLimitError as limit:
        raise UsageError(
            "the fit varies too many keys",
            where=descent.body.data.where,
            got=f"{len(keys)} keys",
            expected=f"fewer keys, because a fit is limited to {limit}",
            hint=f"vary fewer keys: leave out --vary {keys[-1]}",
        ) from None
    low, high = descent.bounds
    samples = qmc.scale(qmc.Sobol(len(low), seed=1).random(RANDOM_SAMPLES), low, high)
    costs = [float(np.sum(descent.compute_fit_residuals(x) ** 2)) for x in samples]
    best = map(descent.compute_key_values, samples[np.argsort(costs)[: DESCENT_COUNT - 1]])
    starts, results = [read_key_values(descent.body.keys), *best], list[DescentResult]()
    for start in starts:
        try:
            results.append(descent.solve(start))
        except FitLimitError as limit:
            values = min(results, key=attrgetter("cost")).values if results else starts[1]
            raise _make_limit_error(descent.body, values, limit) from None
    return sorted(results, key=attrgetter("cost"))


def _correct_end(descent: Descent, end: DescentResult) -> DescentResult | None:
    """Correct the end point of a fit by the full model; None without convergence.

    Each correction step uses the derivatives of the reduced model. The steps end when a step
    changes each linear combination of the keys' logarithms by less than :data:`CONVERGED_CHANGE`
    times the standard error of the combination. The result is None if the steps do not converge
    within the range.
    """
    body, (low, high) = descent.body, descent.bounds
    x = descent.compute_start_logarithms(end.values)
    for _ in range(MESH_CORRECTIONS):
        values = descent.compute_key_values(x)
        exact = body.compute_full_admittance(values)
        left, J = descent.compute_log_ratio(exact), descent.jacobian(x)
        result = OptimizeResult(fun=left, jac=J, cost=0.5 * float(left @ left))
        free = np.array([not is_at_bound(item, values[item.key]) for item in body.keys])
        U, s, Vt = np.linalg.svd(J[:, free], full_matrices=False)
        excess = compute_error_scale(left, J.shape[1])
        pull = np.where(s * max(compute_log_widths(body.keys)) > 4 * excess, U.T @ left, 0.0)
        if np.abs(pull).max(initial=0.0) < CONVERGED_CHANGE * excess:
            return DescentResult(values, result, end.parameter_axes, exact)
        x[free] -= Vt.T @ (pull / np.maximum(s, 1e-12))
        if (x < low).any() or (x > high).any():
            break
    return None


def refine_descent_result(descent: Descent, end: DescentResult) -> DescentResult:
    """Refine the result of a descent until the full model matches the data best.

    If steps with the derivatives of the reduced model do not converge, reduced models of narrower
    ranges are used.

    Raises
    ------
    UsageError : the values do not converge, or the fit needs too many models.
    """
    body = descent.body
    try:
        for improved in _improve_result(descent, end):
            end = improved
    except FitLimitError as limit:
        raise _make_limit_error(body, end.values, limit) from None
    if end.exact.size:
        return end
    raise _make_convergence_error(
        body,
        end.values,
        "the fit does not converge",
        f"changes of the keys below {CONVERGED_CHANGE:g} standard errors after {RANGE_COUNT} "
        "iterations",
    )


def _make_limit_error(
    body: BodyFit, values: Mapping[str, float], limit: FitLimitError
) -> UsageError:
    """Return the error of a fit that reached a limit, with the best values."""
    message = f"the fit did not converge within its limit of {limit}"
    return _make_convergence_error(body, values, message, f"a fit with at most {limit}")


def _make_convergence_error(
    body: BodyFit, values: Mapping[str, float], message: str, expected: str
) -> UsageError:
    """Return the error of a fit without convergence, with the best values."""
    listed = ", ".join(f"{key} = {value:.5g}" for key, value in values.items())
    hint = "give a narrower range around the best value"
    if len(values) > 1:
        hint = f"vary fewer keys: leave out --vary {list(values)[-1]}, or give narrower ranges"
    return UsageError(
        message,
        where=body.data.where,
        got=f"best values so far, in SI units: {listed}",
        expected=expected,
        hint=hint,
    )


def _improve_result(descent: Descent, end: DescentResult) -> Iterator[DescentResult]:
    """Yield improved results; at convergence, the full model confirms the last result.

    The field ``exact`` of a result is empty until the full model confirms the result.
    """
    body = descent.body
    widths = 0.5 * np.array(compute_log_widths(body.keys)) * RANGE_RATIO
    for _ in range(RANGE_COUNT):
        result = _correct_end(descent, end)
        if result is not None:
            yield result
            return
        # The scene ``like`` defines the mesh of the fit. ``like`` is loaded again with the latest
        # key values, so that no nodes of the mesh are displaced.
        body = replace(body, like=load_scene(body.scene, body.name_scene_keys(end.values)))
        parameter_axes = {}
        for item, half in zip(body.keys, widths.tolist(), strict=True):
            parameter_axes[item.key] = _narrow_range(item, end.values[item.key], half)
        descent = Descent(body, parameter_axes, POLYNOMIAL_DEGREE)
        end = descent.solve(end.values)
        yield end
        if not any(
            _is_at_narrow_range_limit(item, parameter_axes[item.key], end.values[item.key])
            for item in body.keys
        ):
            widths = np.maximum(RANGE_RATIO * widths, MIN_LOG_WIDTH)


def _narrow_range(item: VariedKey, value: float, half: float) -> ParameterAxis:
    """Narrow a key's range to a factor around a value, within the full range.

    The factor is ``exp(half)``.
    """
    ends = sorted((value * np.exp(-half), value * np.exp(half)))
    return ParameterAxis(item.key, max(item.low, ends[0]), min(item.high, ends[1]))


def _is_at_narrow_range_limit(item: VariedKey, axis: ParameterAxis, value: float) -> bool:
    """Return whether a value is at a limit of the narrow but not of the full range."""
    x = axis.compute_coordinate(value)
    end = axis.high if x > 0 else axis.low
    return abs(x) > 1 - 1e-3 and not np.isclose([item.low, item.high], end).any()
