"""Reduction of heat models over ranges of parameters, such as film coefficients.

The matrices of the full models are sums of terms with powers of the parameters as factors
(:mod:`kc2spice.rom.parametric_heat_matrix_terms`). One basis V reduces every term by a congruence:

    sum_t f_t(p) V'E_t V x' + sum_t f_t(p) V'K_t V x = V'B q.

Therefore, the dependence of the matrices on the parameters remains exact, even for wide ranges. If
no term has a negative eigenvalue, the model is passive for all values of the parameters. The basis
V contains the bases of reduced models at a few parameter values. Further bases are added at the
parameter sample with the largest error, until the errors at all samples are within the tolerance.
Finally, the basis vectors that contribute least to the responses are removed. Source: P. Benner, S.
Gugercin, K. Willcox, SIAM Review 57 (2015) 483, sections 3.4 and 4.1 (greedy sampling, global
basis).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import scipy

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.naming import list_names
from kc2spice.core.user_warnings import warn_user
from kc2spice.rom.error_estimate import ErrorEstimator
from kc2spice.rom.interface_reduction import (
    make_no_congruence_error,
    reduce_with_prescribed_temperatures,
)
from kc2spice.rom.intermediate_reduction import build_intermediate_model
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.parametric_heat_matrix_terms import MatrixTerms, find_matrix_terms
from kc2spice.rom.parametric_heat_models import HeatOverRanges
from kc2spice.rom.parametric_models import (
    Full,
    ParameterAxis,
    Values,
    list_exponents,
)
from kc2spice.rom.prescribed_flows import FlowReference, make_driven_model
from kc2spice.rom.prescribed_temperature_split import (
    DENSE,
    ROUNDING,
    SplitHeatModel,
    keeps_all_heat,
    remove_inactive_ports,
    split_prescribed_ports,
    transform_to_modal_coordinates,
)
from kc2spice.rom.range_reduction import RangeTask, certify_over_ranges, record_model_values
from kc2spice.rom.resonators_over_ranges import interpolate_model_facts, make_range_error
from kc2spice.rom.response import Response
from kc2spice.rom.stability import is_semidefinite, prove_stability
from kc2spice.rom.transfer_function_error_scales import get_min_relative_divisor

# permitted error of a reduced model that contributes to the basis, as a fraction of the tolerance
SAMPLE_SHARE = 0.05
# permitted error of the basis before vectors are removed, as a fraction of the tolerance
BASIS_SHARE = 0.2
# permitted error of the final model at the samples, as a fraction of the tolerance
FINAL_SHARE = 0.6
# safety factor by which the error estimate over the ranges exceeds the largest error at the samples
SAFETY = 1.5
SAMPLES = 8  # number of random samples per parameter, without the corners of the ranges
# number of full models at random parameter values with which the reduced model is compared; the
# reduced model is also compared with one full model at a corner of the parameter ranges
CHECKS = 4
# Largest number of tests of the reduced model. After a failed test, the tested parameter values
# become samples for the next reduction.
ROUNDS = 4
# largest number of parameter values at which reduced models are computed to extend the basis
MOST_VALUES = 40
# A basis vector counts as linearly independent if its part that is orthogonal to earlier vectors
# exceeds this fraction of the largest vector.
DEPENDENT = 1e-12
# Negative eigenvalues become zero if (magnitude / largest eigenvalue) is below this ratio.
CLIPPED = 1e-6
# highest degree of the polynomials that interpolate properties of the body, such as the mass
FACT_DEGREE = 6


class HeatReduction:
    """Reduction of heat models over parameter ranges, for one or more tolerances.

    All reductions use the same terms of the matrices of the full models.

    ``prescribed`` are the names of ports with prescribed temperatures, such as isothermal faces.

    Raises
    ------
    UsageError : the matrices are not sums of terms with powers of the parameters as factors.
    """

    def __init__(
        self, full: Full, axes: Sequence[ParameterAxis], prescribed: Collection[str] = ()
    ) -> None:
        self._compute_full, self._facts = record_model_values(full)
        self._frame = self._compute_full({axis.name: axis.middle_value for axis in axes})
        self._terms = find_matrix_terms(self._compute_full, axes, self._frame)
        self._term_facts = tuple(self._facts)
        self._prescribed = [name for name in list_names(self._frame.ports) if name in prescribed]

    def reduce(self, task: RangeTask) -> HeatOverRanges:
        """Reduce the heat models over the parameter ranges that ``task`` prescribes.

        The certificate is valid for all values in the ranges. The error estimate in the certificate
        is :data:`SAFETY` times the largest relative difference from reference models, in the norm
        of the task. The reference models are accurate reduced models at the samples of the ranges.
        In addition, the reduced model is compared with full models at :data:`CHECKS` parameter
        values and at a corner of the ranges. The full models of the final comparison are not used
        for the reduction.

        Raises
        ------
        SimulationError : the error exceeds the tolerance.
        """
        if not self._prescribed:
            return self._reduce(task, flows=False)[0]
        try:
            return self._reduce(task, flows=True)[0]
        except SimulationError:
            result, samples = self._reduce(task, flows=False)
        apart = max(item.compute_flow_error(result) for item in samples)
        warn_user(
            f"{result.name}: the error estimate covers only temperatures; within the parameter "
            "ranges and the frequency band, heat flows at pins with prescribed temperatures have a "
            f"relative error of up to {apart:.1g}"
        )
        return result

    def _reduce(
        self, task: RangeTask, *, flows: bool
    ) -> tuple[HeatOverRanges, Sequence[_ReferenceResponses]]:
        """Return the reduced model, and the reference responses for its error checks.

        If ``flows`` is true, the error includes heat flows into ports with prescribed temperatures.
        """
        axes, tolerance = task.axes, task.tolerance
        self._facts[:] = self._term_facts
        ranges = _FullModelsOverRanges(self._terms, self._frame, task, self._prescribed, flows)
        sobol = scipy.stats.qmc.Sobol(len(axes), seed=5)
        corners = [np.array(corner) for corner in product((-1.0, 1.0), repeat=len(axes))]
        points = [*corners, *(sobol.random(SAMPLES * len(axes)) * 2 - 1)]
        samples = []
        for number, x in enumerate(points):
            task.progress(number, len(points))
            samples.append(
                ranges.compute_reference(
                    ranges.sum_full_model(ranges.convert_coordinates(x)),
                    ranges.convert_coordinates(x),
                )
            )
        checks = scipy.stats.qmc.Sobol(len(axes), seed=11)
        basis = _TemperatureBasis(ranges, [np.zeros(len(axes)), *corners])
        for _ in range(ROUNDS):
            result, inner = _find_smallest_model(basis, samples, FINAL_SHARE * tolerance / SAFETY)
            draws = checks.random(CHECKS) * 2 - 1
            fresh = []
            for x in (*draws, np.sign(draws[0])):
                values = ranges.convert_coordinates(x)
                fresh.append(ranges.compute_reference(self._compute_full(values), values))
            error = SAFETY * max(inner, *(item.compute_error(result) for item in fresh))
            if error <= tolerance:
                return self._add_certificate_and_facts(ranges, result, error), samples
            samples += fresh
        problem = "the error cannot be estimated over the ranges of the parameters"
        got = f"{error:.2g} at a point that was not used for the reduction"
        raise make_range_error(problem, self._frame.name, got, tolerance)

    def _add_certificate_and_facts(
        self, ranges: _FullModelsOverRanges, result: HeatOverRanges, error: float
    ) -> HeatOverRanges:
        """Add a certificate of error and stability, and facts such as mass, to a model.

        ``error`` is the error estimate for the certificate. Facts of a model are properties of the
        body, such as its mass. A polynomial of the parameters approximates the logarithm of each
        fact, such as the mass of the body.
        """
        axes = ranges.terms.axes
        semidefinite = all(map(is_semidefinite, (*result.terms.E, *result.terms.K)))
        middle = result.evaluate(ranges.convert_coordinates(np.zeros(len(axes))))
        proof = prove_stability(middle.pencil, ranges.task.band)
        certificate = certify_over_ranges(
            ranges.task, error, CHECKS + 1, proof, passive=semidefinite
        )
        positive = []
        for values, item in self._facts:
            positive.append((values, {name: np.log(v) for name, v in item.items() if v > 0}))
        exponents = list_exponents(len(axes), FACT_DEGREE)
        known = interpolate_model_facts(axes, exponents, positive)
        return replace(result, certificate=certificate, exponents=exponents, facts=known)


class _FullModelsOverRanges:
    """Full models over parameter ranges, and the task to reduce these models."""

    def __init__(
        self,
        terms: MatrixTerms,
        frame: LinearModel,
        task: RangeTask,
        prescribed: Sequence[str],
        flows: bool,
    ) -> None:
        self.terms, self.frame, self.task, self.prescribed = terms, frame, task, prescribed
        self.flows = flows
        self.isolated = [bool(prescribed) and keeps_all_heat(K) for K in terms.K]

    def convert_coordinates(self, x: np.ndarray) -> dict[str, float]:
        """Return the parameter values, keyed by name, at positions ``x`` in their ranges.

        A position is -1 at the lower end of a range, and 1 at the upper end.
        """
        pairs = zip(self.terms.axes, x, strict=True)
        return {axis.name: axis.value(float(v)) for axis, v in pairs}

    def sum_full_model(self, values: Values) -> LinearModel:
        """Return the full model for parameter ``values``, computed as a sum of terms."""
        return LinearModel(
            **self.terms.evaluate_matrices(values),
            B=self.frame.B,
            ports=self.frame.ports,
            name=self.frame.name,
        )

    def compute_reference(self, model: LinearModel, values: Values) -> _ReferenceResponses:
        """Compute reference responses of a full model at parameter ``values``."""
        parts, task = split_prescribed_ports(model, self.prescribed), self.task
        inner, flows = remove_inactive_ports(parts.inner), None
        if self.prescribed:
            flows = FlowReference.from_full_model(
                model, parts, task.band, task.norm, task.tolerance
            )
        if self.flows:  # the basis already includes the responses to prescribed temperatures
            sources = list_names(parts.inner.ports[: len(parts.shares)])
            live = [name for name in list_names(inner.ports) if name in sources]
            inner = inner.select(live) if live else inner
        if inner.order <= DENSE:
            inner, _ = transform_to_modal_coordinates(inner)
        limits = 0.01 * self.task.tolerance, 0.3 * self.task.tolerance
        space = build_intermediate_model(inner.pencil, self.task.band, *limits)
        estimator = space.make_estimator(self.task.band, self.task.norm)
        return _ReferenceResponses(
            self, values, parts, flows, list_names(inner.ports), estimator, space.error
        )


@dataclass(frozen=True, eq=False)
class _ReferenceResponses:
    """Reference responses of a full model at one set of parameter values."""

    ranges: _FullModelsOverRanges
    values: Values
    parts: SplitHeatModel
    flows: FlowReference | None
    live: Sequence[str]
    estimator: ErrorEstimator
    uncertainty: float

    def compute_error(self, reduced: HeatOverRanges, limit: float = np.inf) -> float:
        """Return the largest relative error of a reduced model over the band and at 0 Hz.

        The search over frequencies ends at the first error above ``limit``.
        """
        ours = split_prescribed_ports(reduced.evaluate(self.values), self.ranges.prescribed)
        response = Response(ours.inner.select(self.live).pencil.make_dense())
        still = self._compute_static_error(ours)
        if self.ranges.flows:
            still = max(still, self.compute_flow_error(reduced))
        if still > limit:
            return still
        return max(still, self.estimator.estimate_model_error(response, limit) + self.uncertainty)

    def compute_flow_error(self, reduced: HeatOverRanges) -> float:
        """Return the largest relative error of heat flows at prescribed temperatures."""
        assert self.flows is not None
        model = reduced.evaluate(self.values)
        return self.flows.compute_error(
            model, split_prescribed_ports(model, self.ranges.prescribed)
        )

    def _compute_static_error(self, ours: SplitHeatModel) -> float:
        """Compute a reduced model's largest static error at prescribed temperatures.

        The error is relative to the static response of the full model.
        """
        share = get_min_relative_divisor(self.ranges.task.norm)
        size = float(self.parts.inner.pencil.coefficients[0].diagonal().max())
        result = 0.0
        pairs = (
            (ours.shares, self.parts.shares, ROUNDING),
            (ours.conductance, self.parts.conductance, ROUNDING * size),
        )
        for mine, exact, rounding in pairs:
            if exact.size:
                base = np.maximum(np.abs(exact), share * np.abs(exact).max())
                error = np.maximum(np.abs(mine - exact) - rounding, 0.0)
                result = max(result, float((error / (base + np.finfo(float).tiny)).max()))
        return result


class _TemperatureBasis:
    """Basis of temperature distributions from several reduced models.

    The reduced models have different values of the parameters.

    The unknown temperatures are ``psi T_i + W c``, where ``psi`` are the static responses at the
    middle of the ranges. A column of W is a mode of a reduced model, or the difference of a static
    response from ``psi``. Each mode is scaled by the mode's largest share in the static response of
    a port. If a term of the matrix K conducts no heat to the ambient, the static responses ``psi``
    are corrected so that each row of ``psi`` sums to one. With corrected responses ``psi``, a
    uniform temperature rise of 1 K has the coordinates ``T_i = 1`` and ``c = 0``.
    """

    def __init__(self, ranges: _FullModelsOverRanges, points: Sequence[np.ndarray]) -> None:
        self.ranges = ranges
        middle = ranges.sum_full_model(ranges.convert_coordinates(np.zeros(len(ranges.terms.axes))))
        self.middle = split_prescribed_ports(middle, ranges.prescribed)
        self.psi = self.middle.psi
        if any(ranges.isolated):
            missing = 1.0 - self.psi.sum(axis=1, keepdims=True)
            self.psi = self.psi + missing / self.psi.shape[1]
        self.conductance, stored = self.middle.inner.pencil.coefficients
        rates = self.conductance.diagonal() / np.maximum(stored.diagonal(), np.finfo(float).tiny)
        rate = float(rates[stored.diagonal() > 0].max(initial=2 * np.pi * ranges.task.band[1]))
        self.content = np.sqrt(stored.diagonal() + self.conductance.diagonal() / rate)
        self.columns: list[np.ndarray] = []
        self.count = 0
        for x in points:
            self.add_sample(ranges.convert_coordinates(x))

    def add_sample(self, values: Values) -> None:
        """Reduce the model at parameter ``values``, and add the resulting basis vectors."""
        ranges, n = self.ranges, len(self.middle.at)
        self.count += 1
        model = ranges.sum_full_model(values)
        aims: dict[str, Any] = {"tolerance": SAMPLE_SHARE * ranges.task.tolerance, "order": None}
        parts = split_prescribed_ports(model, ranges.prescribed)
        small = reduce_with_prescribed_temperatures(
            model,
            ranges.prescribed,
            parts,
            flows=ranges.flows,
            measured=False,
            band=ranges.task.band,
            norm=ranges.task.norm,
            **aims,
        )
        if small.basis is None:
            raise make_no_congruence_error(model)
        W = small.basis[parts.others][:, n:]
        K, E = (W.T @ (matrix @ W) for matrix in parts.inner.pencil.coefficients)
        driven = make_driven_model(model, parts) if ranges.flows else parts.inner
        _, shapes = transform_to_modal_coordinates(
            LinearModel(E=E, K=K, B=W.T @ driven.B, ports=driven.ports)
        )
        modes = W @ shapes
        gains = np.abs(driven.B.T @ modes)
        total = np.sqrt((gains**2).sum(axis=1, keepdims=True))
        share = (gains / np.where(total > 0, total, 1.0)).max(axis=0)
        self.columns.append(modes * share)
        change = parts.psi - self.psi
        size = self._compute_energy_norms(self.psi)
        self.columns.append(change / np.where(size > 0, size, 1.0))

    def _compute_energy_norms(self, columns: np.ndarray) -> np.ndarray:
        """Return the energy norm ``sqrt(x'K x)`` of each column x."""
        squares = np.einsum("ij,ij->j", columns, self.conductance @ columns)
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)))

    def make_orthonormal_basis(self) -> np.ndarray:
        """Return basis vectors W with ``W'K W = 1``, the most important vector first.

        The array W has one row for each temperature that is not prescribed, and one column for each
        basis vector.

        First, linearly dependent columns are removed. To find dependent columns, all columns are
        orthogonalised in the inner product of the diagonal of ``G = E + K / s``, where s is the
        largest ratio ``K_ii / E_ii``. With the inner product of K, slow modes would be inaccurate,
        because ``x'K x`` is then a small difference of large numbers.
        """
        X = np.hstack(self.columns)
        scaled = self.content[:, None] * X
        size = np.linalg.norm(scaled, axis=0)
        Q, R, _ = scipy.linalg.qr(
            scaled[:, size > 0] / size[size > 0], mode="economic", pivoting=True
        )
        independent = np.abs(np.diag(R)) > DEPENDENT * np.abs(R[0, 0])
        Q = Q[:, : int(independent.sum())] / self.content[:, None]
        stiff, shapes = np.linalg.eigh(Q.T @ (self.conductance @ Q))
        Q = Q @ (shapes / np.sqrt(np.maximum(stiff, np.finfo(float).eps * stiff[-1])))
        U, _, _ = np.linalg.svd(Q.T @ (self.conductance @ X), full_matrices=False)
        return np.asarray(Q @ U)

    def build_reduced_model(self, W: np.ndarray) -> HeatOverRanges:
        """Return the heat model for parameter ranges, reduced with basis vectors ``W``.

        ``W`` has one row for each temperature that is not prescribed, and one column for each basis
        vector.
        """
        middle, ranges = self.middle, self.ranges
        n = len(middle.at)
        V = np.zeros((ranges.frame.order, n + W.shape[1]))
        V[middle.at, :n], V[middle.others, :n] = np.eye(n), self.psi
        V[middle.others, n:] = W
        stiff = [_project_matrix(K, V) for K in ranges.terms.K]
        constant = np.zeros((V.shape[1], 1))
        constant[:n] = 1 / np.sqrt(max(n, 1))
        P = np.eye(V.shape[1]) - constant @ constant.T
        for t in np.flatnonzero(ranges.isolated):  # a uniform temperature causes no heat flow
            stiff[t] = P @ stiff[t] @ P
        stored = [_project_matrix(E, V) for E in ranges.terms.E]
        return HeatOverRanges(
            terms=replace(ranges.terms, E=tuple(stored), K=tuple(stiff)),
            B=V.T @ ranges.frame.B,
            ports=ranges.frame.ports,
            exponents=np.zeros((1, len(ranges.terms.axes)), int),
            name=ranges.frame.name,
        )


def _project_matrix(matrix: scipy.sparse.csc_array, V: np.ndarray) -> np.ndarray:
    """Project ``matrix`` on V, and set slightly negative eigenvalues to zero.

    The conductance matrix of an insulated body has an eigenvalue of zero. Because of rounding
    errors, the computed value of a zero eigenvalue may be negative.
    """
    result = V.T @ (matrix @ V)
    values, vectors = np.linalg.eigh(0.5 * (result + result.T))
    if values.size and -CLIPPED * values[-1] < values[0] < 0:
        values = np.maximum(values, 0.0)
    result = (vectors * values) @ vectors.T
    return np.asarray(0.5 * (result + result.T))


def _find_smallest_model(
    basis: _TemperatureBasis, samples: Sequence[_ReferenceResponses], limit: float
) -> tuple[HeatOverRanges, float]:
    """Return the smallest reduced heat model with acceptable errors at all samples.

    The second result is the largest error of this model at the samples.

    Raises
    ------
    SimulationError : the error exceeds ``limit`` even with all vectors of the basis.
    """
    while True:
        W = basis.make_orthonormal_basis()
        result = basis.build_reduced_model(W)
        errors = [item.compute_error(result) for item in samples]
        worst = int(np.argmax(errors))
        if errors[worst] <= limit * BASIS_SHARE / FINAL_SHARE or basis.count >= MOST_VALUES:
            break
        basis.add_sample(samples[worst].values)
    if errors[worst] > limit:
        problem = "the ranges of the parameters are too wide for one basis"
        got = f"an error of {errors[worst]:.2g}"
        raise make_range_error(problem, result.name, got, limit)
    best, error = result, errors[worst]
    low, high = 1, W.shape[1]
    while low < high:
        count = (low + high) // 2
        model = basis.build_reduced_model(W[:, :count])
        largest = _find_largest_error(model, samples, limit)
        if largest <= limit:
            high, best, error = count, model, largest
        else:
            low = count + 1
    return best, error


def _find_largest_error(
    model: HeatOverRanges, samples: Sequence[_ReferenceResponses], limit: float
) -> float:
    """Return the largest error of a reduced model at the samples.

    The search ends at the first error above ``limit``, and returns that error.
    """
    result = 0.0
    for item in samples:
        try:
            result = max(result, item.compute_error(model, limit))
        except (np.linalg.LinAlgError, UsageError):
            return np.inf
        if result > limit:
            break
    return result
