"""Reduction to resonators whose coefficients are polynomials of the parameters.

The coefficients are natural frequencies, gains and capacitances over ranges of the parameters. The
input is a :class:`~kc2spice.rom.parametric_models.DenseParametricModel`, a model with small dense
matrices. At many points of the ranges, this module computes the modes of the dense model up to a
frequency a little above the band. Ritz vectors, which are orthogonal to these modes, represent the
remaining response to loads at the ports.

Modes whose frequencies are close to each other anywhere in the ranges form a block. A block is
represented by a basis of its modes. Of all bases of the modes of a block, the module uses the basis
that is nearest to the basis in the middle of the ranges. The basis therefore rotates smoothly with
the parameters, and the coefficients do not jump if natural frequencies cross or repel each other.
Modes outside of blocks are separate resonators. The stiffness of a block is ``L L^T`` with a
Cholesky factor L. Polynomials approximate the logarithms of three quantities: the diagonal of L,
the diagonal of the Cholesky factor of the clamped capacitances, and the damping. Stiffness, damping
and clamped capacitances are therefore positive everywhere in the ranges, which proves that the
model is passive. Sources: P. H. Schoenemann, Psychometrika 31 (1966) 1 (nearest basis); T. Kato,
Perturbation Theory for Linear Operators, II.4 (invariant subspaces are analytic as long as a gap
separates them).

If a port moves a body without a support, the port excites rigid-body modes. The stiffness of a
rigid-body mode is zero and has no logarithm. Therefore, the rigid-body modes get a soft support
with a resonance far below the band.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np
import scipy

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.rom.error_estimate import ErrorEstimator
from kc2spice.rom.intermediate_reduction import build_intermediate_model
from kc2spice.rom.linear_model import LinearModel, Norm
from kc2spice.rom.parametric_models import (
    DenseParametricModel,
    ParameterAxis,
    ParameterPolynomials,
    Values,
    choose_higher_degree,
    evaluate_polynomials,
    list_exponents,
    reduce_over_parameters,
)
from kc2spice.rom.range_reduction import (
    ModelOverRanges,
    RangeTask,
    certify_over_ranges,
    record_model_values,
)
from kc2spice.rom.response import Response
from kc2spice.rom.soft_support import SOFT_SUPPORT, SOFT_SUPPORT_RATIO, ZERO_FREQUENCY_RATIO
from kc2spice.rom.stability import prove_stability

# All modes below this multiple of the highest frequency of the band are retained.
MODE_BAND_RATIO = 1.2
# Largest number of additional modes above MODE_BAND_RATIO times the end of the band.
# The highest retained mode is the mode below the widest gap between natural frequencies.
EXTRA_MODES = 8
# A mode's gain at a port counts as zero up to this fraction of the largest gain at the port.
ZERO_GAIN = 1e-9
# number of grid points per axis, keyed by number of axes
GRID_POINTS = {0: 1, 1: 33, 2: 13, 3: 7, 4: 5}
# highest total degree of the polynomials, keyed by number of axes
MAX_DEGREES = {0: 0, 1: 16, 2: 10, 3: 6, 4: 4}
# Gaps between two blocks of modes, as differences of log(squared frequency); tried in this order.
# Adjacent modes form one block if log(squared frequency) differs by less than the gap.
MODE_GAPS = 0.03, 0.1, 0.3, 0.8, np.inf
# Largest number of blocks of Ritz vectors.
# The blocks are the static responses and their derivatives with respect to the squared frequency.
KRYLOV_BLOCKS = 4
# smallest accepted overlap of mode shapes with mode shapes in the middle of the parameter ranges
MIN_OVERLAP = 0.2
CHECK_POINTS = 16  # number of random points in the ranges for error estimates of the fit
# largest accepted error of the subspace of modes and Ritz vectors, divided by the tolerance
SUBSPACE_SHARE = 0.3
# A rigid-body mode's gain at a port counts as zero up to this fraction of the port's largest gain.
RIGID_ROUNDING = 1e-6
# The first mode that the dense model omits is assumed at sqrt(LAST_GAP) times the frequency of the
# highest mode in the dense model.
LAST_GAP = 8.0
# The number n of retained modes maximises log(w_omitted^2 / w_retained^2) - n MIN_GAP_GAIN.
# w_omitted is the frequency of the first omitted mode, and w_retained of the last retained mode.
MIN_GAP_GAIN = 0.02
# The squared norm of each Ritz vector is divided by the largest squared norm of all Ritz vectors.
# Ritz vectors with a relative squared norm below DEPENDENT_VECTOR count as linearly dependent.
DEPENDENT_VECTOR = 1e-9
# number of full models at random points of the ranges that check the resonators; one additional
# full model at a corner of the ranges also checks the resonators
FULL_CHECKS = 4
# permitted difference between the resonators and the dense model, relative to the tolerance
RESONATOR_SHARE = 0.4
SAFETY_FACTOR = 1.5  # safety factor of errors that are computed at points of the ranges
COEFFICIENT_RESOLUTION = 1e-3  # resolution of rounded coefficients, relative to tolerance
# Additional factor of the resolution of coefficients for models with several ports, because large
# terms cancel at notches of the response between two ports.
NOTCH_RESOLUTION = 1e-2


@dataclass(frozen=True, eq=False, kw_only=True)
class ResonatorsOverRanges(ParameterPolynomials, ModelOverRanges):
    """Resonators ``z'' + E z' + K z = g u`` whose matrices depend on parameters.

    ``z'`` is the time derivative of ``z``, and ``g^T`` the transpose of ``g``. The outputs are ``y
    = g^T z + D u``. The stiffness matrix is ``K = L L^T`` with a lower triangular matrix L. The
    damping matrix is ``E = alpha I + beta K``. For given values of the parameters, the vector ``T``
    (terms,) contains products of polynomials of the parameters. The fields contain coefficients of
    these products:

    * The diagonal of L, of shape (q,), is ``exp(T @ diagonal)``. The product ``T @ below``, of
      shape (q, q), contains the entries of L below the diagonal, in blocks of the sizes ``blocks``.
    * The product ``T @ gain``, of shape (q, ports), is the matrix g.
    * The diagonal of the Cholesky factor of D at the electrical ports is ``exp(T @ capacitance)``.
      The product ``T @ shared`` contains the entries of the Cholesky factor of D that are not on
      its diagonal.
    * The two entries of ``exp(T @ rayleigh)`` are alpha and beta for damping parameters in the
      middle of their ranges. Alpha and beta are then multiplied by powers of the damping
      parameters, which ``losses`` lists. If the corresponding item of ``damped`` is false, alpha or
      beta is zero.
    * ``facts`` contains the coefficients of polynomials for the characteristic values of the model.
    """

    blocks: tuple[int, ...]
    diagonal: np.ndarray
    below: np.ndarray
    gain: np.ndarray
    capacitance: np.ndarray
    shared: np.ndarray
    rayleigh: np.ndarray
    damped: tuple[bool, bool]
    facts: Mapping[str, np.ndarray]

    @property
    def order(self) -> int:
        """Number n of unknowns: one for each resonator; the model has 2 n states."""
        return int(self.diagonal.shape[1])

    @property
    def electrical_ports(self) -> list[int]:
        """Indices of the electrical ports."""
        return [k for k, port in enumerate(self.ports) if port.electrical]

    def evaluate(self, values: Values) -> LinearModel:
        """Return the resonators as a linear model, for given ``values`` of all parameters."""
        T = self.compute_products(values)
        L = np.tensordot(T, self.below, 1) + np.diag(np.exp(T @ self.diagonal))
        pair = np.where(self.damped, np.exp(T @ self.rayleigh), 0.0).tolist()
        alpha, beta = self.compute_damping(pair, values)
        D = np.zeros((len(self.ports),) * 2)
        if self.electrical_ports:
            factor = np.tensordot(T, self.shared, 1) + np.diag(np.exp(T @ self.capacitance))
            D[np.ix_(self.electrical_ports, self.electrical_ports)] = factor @ factor.T
        K = L @ L.T
        return LinearModel(
            M=np.eye(self.order),
            E=alpha * np.eye(self.order) + beta * K,
            K=K,
            B=np.tensordot(T, self.gain, 1),
            D=D,
            ports=self.ports,
            certificate=self.certificate,
            facts={name: float(T @ c) for name, c in self.facts.items()},
            name=self.name,
        )


def reduce_over_ranges(task: RangeTask) -> ResonatorsOverRanges:
    """Reduce the full models of a task to resonators over the parameter ranges.

    The certificate is valid for all values in the ranges. The error in the certificate is the
    largest relative difference between the resonators and more accurate models, in the norm of the
    task, times :data:`SAFETY_FACTOR`. At :data:`FULL_CHECKS` random points and at one corner of the
    parameter ranges, the resonators are compared with full models that the reduction does not use.
    At further points of the ranges, the resonators are compared with the dense parametric model
    that they replace. The result contains the ``facts`` of the full models.

    Raises
    ------
    UsageError : the model is not a symmetric second-order model with proportional damping and
        collocated ports; the number of mesh cells changes within the ranges; or the band begins at
        0 Hz and a port excites a rigid-body mode.
    SimulationError : the tolerance is not met.
    """
    full, facts = record_model_values(task.full)

    def build_full_model(values: Values) -> LinearModel:
        """Build the full model; reject losses other than Rayleigh damping."""
        model = full(values)
        if model.rayleigh is None:
            raise UsageError(
                "a model with parameters needs one Rayleigh damping for the whole body",
                where=model.name,
                expected="Rayleigh damping with the same alpha and beta for all materials",
            )
        return model

    result, error = _reduce_and_check(replace(task, full=build_full_model))
    middle = result.evaluate(_compute_values_at(result.parameter_axes, np.zeros(len(task.axes))))
    proof = prove_stability(middle.pencil.make_dense(), task.band)
    certificate = certify_over_ranges(task, error, FULL_CHECKS + 1, proof)
    known = interpolate_model_facts(result.axes, result.exponents, facts)
    if SOFT_SUPPORT in result.facts:
        known |= {SOFT_SUPPORT: result.facts[SOFT_SUPPORT]}
    return replace(result, certificate=certificate, facts=known)


def _reduce_and_check(task: RangeTask) -> tuple[ResonatorsOverRanges, float]:
    """Reduce full models to resonators; return the resonators and an error estimate.

    The error estimate is :data:`SAFETY_FACTOR` times the largest relative difference from full
    models. If this error is too large, the reduction is repeated with more full models and
    polynomials of a higher degree. For each polynomial degree, the resonators are compared with
    full models at new random points, which the fit has not used.
    """
    axes, band, tolerance = task.axes, task.band, task.tolerance
    sobol = scipy.stats.qmc.Sobol(len(axes), seed=11)
    degree: int | None = None
    while True:
        dense_model = reduce_over_parameters(
            task.full, axes, band, degree=degree, progress=task.progress
        )
        random_points = sobol.random(FULL_CHECKS) * 2 - 1
        points = [
            _compute_values_at(dense_model.parameter_axes, x)
            for x in (*random_points, np.sign(random_points[0]))
        ]
        checks = []
        for k, values in enumerate(points):
            task.progress(k, len(points))
            space = build_intermediate_model(
                task.full(values).pencil, band, 0.01 * tolerance, 0.3 * tolerance
            )
            checks.append((values, space.make_estimator(band, task.norm), space.error))
        degree = choose_higher_degree(dense_model)
        error = SAFETY_FACTOR * _compute_largest_difference(dense_model, checks)
        if error > tolerance and degree is not None:
            continue
        result, inner = make_resonators(dense_model, band, RESONATOR_SHARE * tolerance, task.norm)
        error = SAFETY_FACTOR * max(inner, _compute_largest_difference(result, checks))
        if error <= tolerance:
            return result, error
        if degree is None:
            problem = "the reduced model is inaccurate over the ranges of the parameters"
            got = f"{error:.2g} at a point that was not used for the reduction"
            raise make_range_error(problem, dense_model.frame.name, got, tolerance)


def _compute_largest_difference(
    model: DenseParametricModel | ResonatorsOverRanges,
    checks: Sequence[tuple[Values, ErrorEstimator, float]],
) -> float:
    """Return the largest relative difference between a reduced model and full models.

    Each item of ``checks`` contains parameter values, an error estimator, and an error. The
    estimator compares a model with the intermediate model that replaces the full model at the
    parameter values. The error in each item of ``checks`` is the estimated relative difference
    between the intermediate model and the full model.
    """
    return max(
        estimator.estimate_model_error(Response(model.evaluate(values).pencil)) + error
        for values, estimator, error in checks
    )


def interpolate_model_facts(
    axes: Sequence[ParameterAxis],
    exponents: np.ndarray,
    known: Sequence[tuple[Values, Mapping[str, float]]],
) -> dict[str, np.ndarray]:
    """Interpolate facts of full models, such as the mass, by fitted polynomials.

    The number of full models limits the degree of the polynomials. The attribute ``facts`` of each
    full model contains the numbers to which polynomials are fitted. The result contains
    coefficients (terms,) of each fact, for the products of polynomials with ``exponents`` (terms,
    axes).
    """
    x = [[axis.compute_coordinate(values[axis.name]) for axis in axes] for values, _ in known]
    total = exponents.sum(axis=1, initial=0)
    used = np.array([(total <= degree).sum() for degree in total]) <= max(1, len(known) // 2)
    T = evaluate_polynomials(np.reshape(x, (len(known), -1)), exponents[used])
    names = set.intersection(*(set(item) for _, item in known))
    facts = {name: np.zeros(len(total)) for name in sorted(names)}
    for name, c in facts.items():
        c[used] = np.linalg.lstsq(T, np.array([item[name] for _, item in known]), rcond=None)[0]
    return facts


def make_resonators(
    dense_model: DenseParametricModel,
    band: tuple[float, float],
    tolerance: float,
    norm: Norm = "pointwise",
) -> tuple[ResonatorsOverRanges, float]:
    """Convert a dense parametric model to resonators over the same ranges.

    The second result is the largest relative difference between the resonators and ``dense_model``
    at points of the ranges. The function selects the fewest Ritz vectors, the smallest blocks and
    the lowest degree of polynomials that meet the tolerance.

    Raises
    ------
    UsageError : the band begins at 0 Hz, and a port excites a rigid-body mode.
    SimulationError : no resonators meet the tolerance over the parameter ranges.
    """
    modes = _ModesOverRanges(dense_model, band)
    points = list(_yield_check_points(dense_model, band, norm))
    best = np.inf
    for moments in range(1, KRYLOV_BLOCKS + 1):
        space = _ReducedSpace(modes, moments)
        exact = max(
            estimator.estimate_model_error(Response(space.project_model(x).pencil))
            for x, estimator in points[:3]
        )
        if exact > SUBSPACE_SHARE * tolerance and moments < KRYLOV_BLOCKS:
            continue
        for gap in MODE_GAPS:
            for degree in range(min(2, MAX_DEGREES[modes.axes]), MAX_DEGREES[modes.axes] + 1, 2):
                result = space.fit_polynomials(gap, degree, tolerance)
                if result is None:
                    break
                error = 0.0
                for x, estimator in points:
                    model = result.evaluate(_compute_values_at(result.parameter_axes, x))
                    error = max(error, estimator.estimate_model_error(Response(model.pencil)))
                    if error > tolerance:
                        break
                best = min(best, max(error, exact))
                if error <= tolerance:
                    return result, error
    problem = "the parameter ranges are too wide for a polynomial approximation of the modes"
    raise make_range_error(problem, dense_model.frame.name, f"an error of {best:.2g}", tolerance)


def make_range_error(problem: str, name: str, got: str, tolerance: float) -> SimulationError:
    """Make the error for parameter ranges that are too wide for the tolerance."""
    return SimulationError(
        problem,
        where=name,
        got=got,
        expected=f"at most {tolerance:.2g}",
        hint="narrow the ranges in rom.parameters",
    )


def _compute_values_at(
    parameter_axes: Mapping[str, ParameterAxis], x: np.ndarray
) -> dict[str, float]:
    """Convert coordinates ``x`` to parameter values, keyed by parameter.

    A parameter without a coordinate in ``x`` has the value in the middle of its range.
    """
    known = {
        axis.name: axis.value(float(v)) for axis, v in zip(parameter_axes.values(), x, strict=False)
    }
    return {name: known.get(name, axis.middle_value) for name, axis in parameter_axes.items()}


def _yield_check_points(
    dense_model: DenseParametricModel, band: tuple[float, float], norm: Norm
) -> Iterator[tuple[np.ndarray, ErrorEstimator]]:
    """Yield check points in the ranges, each with an estimator of the model's error.

    The points are the middle of the ranges, all corners, and random points.
    """
    count = len(dense_model.parameter_axes)
    random_points = scipy.stats.qmc.Sobol(count, seed=3).random(CHECK_POINTS) * 2 - 1
    corners = sorted(product((1.0, -1.0), repeat=count), key=lambda x: abs(sum(x)), reverse=True)
    for x in (np.zeros(count), *map(np.array, corners), *random_points):
        response = Response(
            dense_model.evaluate(_compute_values_at(dense_model.parameter_axes, x)).pencil
        )
        yield x, ErrorEstimator(response, band, False, norm)


@dataclass(frozen=True, eq=False)
class _DenseModes:
    """Modes of a dense model: squared frequencies (n,) and mode shapes (n, n)."""

    model: LinearModel
    w2: np.ndarray
    V: np.ndarray


class _ModesOverRanges:
    """Modes of a dense model over the ranges of its parameters.

    ``count`` is the number of retained modes. All modes in the band are retained.
    """

    def __init__(self, dense_model: DenseParametricModel, band: tuple[float, float]) -> None:
        self.dense_model, self.band, self.axes = dense_model, band, len(dense_model.axes)
        self.free, self.moved = 0, False
        line = np.cos(np.pi * (np.arange(GRID_POINTS[self.axes]) + 0.5) / GRID_POINTS[self.axes])
        self.grid = np.array([np.zeros(self.axes), *product(line, repeat=self.axes)])
        points = list(map(self._compute_all_modes, self.grid))
        last = min(p.w2.size for p in points) - 1
        while self.free < last and any(
            p.w2[self.free] < ZERO_FREQUENCY_RATIO * p.w2[self.free + 1] for p in points
        ):
            self.free += 1
        # if a port excites a rigid-body mode, all rigid-body modes are retained
        self.moved = any(map(self._excites_rigid_body, points))
        if self.moved and band[0] <= 0:
            raise UsageError(
                "if a body has parameters but no support, its band must begin above 0 Hz",
                where=dense_model.frame.name,
                got="a port that moves the body as a rigid body, and a band from 0 Hz",
                expected="a band above 0 Hz, a body with a support, or electrical ports only",
                hint="state rom.band, such as [100, 10000]",
            )
        self.points = list(map(self._isolate_elastic_modes, points))
        w2 = np.array([p.w2 for p in self.points])
        least = max(1, int((w2 < (MODE_BAND_RATIO * 2 * np.pi * band[1]) ** 2).any(axis=0).sum()))
        counts = np.arange(least, min(least + EXTRA_MODES, w2.shape[1]) + 1)
        above = np.hstack([w2, LAST_GAP * w2[:, -1:]])
        gaps = np.log(above[:, counts] / w2[:, counts - 1]).min(axis=0)
        self.count = int(counts[np.argmax(gaps - MIN_GAP_GAIN * np.arange(len(counts)))])

    def compute_elastic_modes(self, x: np.ndarray) -> _DenseModes:
        """Compute the elastic modes at normalised parameter values ``x``.

        If a port excites a rigid-body mode, all rigid-body modes are retained on a soft support.
        If no port excites a rigid-body mode, all rigid-body modes are removed.
        """
        return self._isolate_elastic_modes(self._compute_all_modes(x))

    def _compute_all_modes(self, x: np.ndarray) -> _DenseModes:
        """Return all modes of the dense model at normalised parameter values ``x``."""
        model = self.dense_model.evaluate(_compute_values_at(self.dense_model.parameter_axes, x))
        return _DenseModes(model, *scipy.linalg.eigh(model.K, model.M))

    @property
    def soft_support_frequency(self) -> float:
        """Resonance frequency [Hz] of an unsupported body on the artificial soft support."""
        return SOFT_SUPPORT_RATIO * self.band[0]

    def _excites_rigid_body(self, p: _DenseModes) -> bool:
        """Return whether a port excites a rigid-body mode."""
        share = np.abs(p.V.T @ p.model.B)
        largest = share[: self.free].max(axis=0, initial=0.0)
        return bool((largest > RIGID_ROUNDING * share.max(axis=0)).any())

    def _isolate_elastic_modes(self, p: _DenseModes) -> _DenseModes:
        """Isolate elastic modes: remove rigid-body modes, or support these modes softly."""
        if self.moved:
            soft = np.full(self.free, (2 * np.pi * self.soft_support_frequency) ** 2)
            w2 = np.concatenate([soft, p.w2[self.free :]])
            return _DenseModes(p.model, w2, p.V)
        return _DenseModes(p.model, p.w2[self.free :], p.V[:, self.free :])


class _ReducedSpace:
    """Subspace of retained modes, with Ritz vectors in place of all other modes.

    The Ritz vectors span ``sum_i phi_i phi_i' B / (w_i^2 - s)^j`` over the other modes i, for j up
    to ``moments``. ``phi_i`` are the mode shapes and ``w_i`` the natural frequencies. The shift s
    is half of the squared angular frequency at the end of the band.
    """

    def __init__(self, modes: _ModesOverRanges, moments: int) -> None:
        self.modes, self.moments = modes, moments
        self.shift = 0.5 * (2 * np.pi * modes.band[1]) ** 2
        rest = modes.points[0].w2[modes.count :]
        self.unit = rest[0] - self.shift if rest.size else 1.0
        answers = list(map(self._project_responses, modes.points))
        size = np.linalg.norm(answers[0], axis=0)
        size[size == 0] = 1.0
        w, T = np.linalg.eigh(sum((a / size).T @ (a / size) for a in answers))
        large = w > max(DEPENDENT_VECTOR * w[-1], 0.0)
        # the number of vectors of the subspace is at most the number of unknowns of the dense model
        large[: max(0, len(w) - rest.size)] = False
        self.T = T[:, large] / size[:, None]
        pairs = list(map(self._compute_ritz_modes, modes.points))
        self.w2 = np.array([w2 for w2, _ in pairs])
        self.Z = [Z for _, Z in pairs]
        self._blocks_by_range: dict[tuple[int, int], tuple[np.ndarray, np.ndarray] | None] = {}

    def _project_responses(self, p: _DenseModes) -> np.ndarray:
        """Project the port-load responses onto the modes that are not retained."""
        k = self.modes.count
        load, share = p.V[:, k:].T @ p.model.B, self.unit / (p.w2[k:, None] - self.shift)
        return np.hstack([share**j * load for j in range(1, self.moments + 1)])

    def _compute_ritz_modes(self, p: _DenseModes) -> tuple[np.ndarray, np.ndarray]:
        """Return squared frequencies and shapes of retained modes and Ritz vectors."""
        k = self.modes.count
        U, _, R = np.linalg.svd(self._project_responses(p) @ self.T, full_matrices=False)
        W = U @ R
        ritz, Q = np.linalg.eigh(W.T @ (p.w2[k:, None] * W))
        return np.r_[p.w2[:k], ritz], np.hstack([p.V[:, :k], p.V[:, k:] @ (W @ Q)])

    def project_model(self, x: np.ndarray) -> LinearModel:
        """Project the model at normalised parameter values ``x`` on the reduced subspace."""
        p = self.modes.compute_elastic_modes(x)
        w2, Z = self._compute_ritz_modes(p)
        B = Z.T @ p.model.B
        return replace(p.model, M=np.eye(len(w2)), K=np.diag(w2), B=B, C=B.T)

    def _make_block(self, a: int, b: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Return stiffness and gain of a block of modes; None if the modes vary too much.

        The block contains the modes a to b - 1. The result consists of the stiffness (points, n, n)
        and the gain (points, n, ports) of the block at all grid points. At each grid point, the
        mode shapes of a block are rotated to the directions nearest to the mode shapes in the
        middle of the ranges. The result is None if the mode shapes at a grid point overlap too
        little with the mode shapes in the middle of the ranges.
        """
        if (a, b) not in self._blocks_by_range:
            M, first, rows = self.modes.points[0].model.M, self.Z[0][:, a:b], []
            for p, w2, Z in zip(self.modes.points, self.w2, self.Z, strict=True):
                U, near, R = np.linalg.svd(Z[:, a:b].T @ M @ first)
                if near.min() < MIN_OVERLAP:
                    self._blocks_by_range[a, b] = None
                    return None
                Q = U @ R
                rows.append(((Q.T * w2[a:b]) @ Q, Q.T @ (Z[:, a:b].T @ p.model.B)))
            self._blocks_by_range[a, b] = (
                np.array([k for k, _ in rows]),
                np.array([g for _, g in rows]),
            )
        return self._blocks_by_range[a, b]

    def fit_polynomials(
        self, gap: float, degree: int, tolerance: float
    ) -> ResonatorsOverRanges | None:
        """Fit polynomials of the parameters to the coefficients of mode blocks.

        Two adjacent modes belong to different blocks if log(squared frequency) differs by more than
        ``gap`` at all grid points. The result is None if the mode shapes of a block change too much
        within the ranges.
        """
        modes, dense_model = self.modes, self.modes.dense_model
        separated = np.log(self.w2[:, 1:] / self.w2[:, :-1]).min(axis=0) > gap
        ends = [0, *(np.flatnonzero(separated) + 1), self.w2.shape[1]]
        result = [self._make_block(int(a), int(b)) for a, b in pairwise(ends)]
        if any(block is None for block in result):
            return None
        port = np.max([np.abs(block[1]).max(axis=(0, 1)) for block in result if block], axis=0)
        port[port == 0] = 1.0
        blocks = [(K, g) for K, g in filter(None, result) if (np.abs(g) / port).max() > ZERO_GAIN]
        exponents = list_exponents(modes.axes, degree)
        fit = np.linalg.pinv(evaluate_polynomials(modes.grid, exponents))
        ratio = min(_find_least_damping_ratio(p, modes.band) for p in modes.points)
        resolution = (
            COEFFICIENT_RESOLUTION
            * tolerance
            * (NOTCH_RESOLUTION if len(dense_model.frame.ports) > 1 else 1.0)
        )

        def fit_rounded_coefficients(values: np.ndarray, grain: float | np.ndarray) -> np.ndarray:
            """Fit ``values`` (points, …), and round coefficients to multiples of ``grain``."""
            c = np.tensordot(fit, values, 1)
            return np.asarray(np.round(c / grain) * grain)

        count = sum(K.shape[1] for K, _ in blocks)
        below = np.zeros((len(exponents), count, count))
        diagonal, gain, at = [], [], 0
        for K, g in blocks:
            L = np.linalg.cholesky(K)
            pivots = np.diagonal(L, axis1=1, axis2=2)
            rows = slice(at, at + K.shape[1])
            at += K.shape[1]
            below[:, rows, rows] = fit_rounded_coefficients(
                np.tril(L, -1), resolution * ratio * pivots.min()
            )
            diagonal.append(fit_rounded_coefficients(np.log(pivots), resolution * ratio))
            gain.append(
                fit_rounded_coefficients(
                    g, resolution * np.minimum(np.abs(g).max(axis=(0, 1)) + ZERO_GAIN * port, port)
                )
            )
        electrical = [k for k, item in enumerate(dense_model.frame.ports) if item.electrical]
        D = np.array([p.model.D[np.ix_(electrical, electrical)] for p in modes.points])
        F = np.linalg.cholesky(D) if electrical else D
        pivots = np.diagonal(F, axis1=1, axis2=2)
        damping = np.array([p.model.rayleigh for p in modes.points])
        damped = damping > 0
        facts = dict[str, np.ndarray]()
        if modes.moved:
            facts[SOFT_SUPPORT] = modes.soft_support_frequency * (exponents.sum(axis=1) == 0)
        return ResonatorsOverRanges(
            axes=dense_model.axes,
            losses=dense_model.losses,
            ports=dense_model.frame.ports,
            exponents=exponents,
            blocks=tuple(K.shape[1] for K, _ in blocks),
            diagonal=np.hstack(diagonal),
            below=below,
            gain=np.concatenate(gain, axis=1),
            capacitance=fit_rounded_coefficients(np.log(pivots), resolution),
            shared=fit_rounded_coefficients(
                np.tril(F, -1), resolution * (pivots.min() if pivots.size else 1.0)
            ),
            rayleigh=fit_rounded_coefficients(np.log(np.where(damped, damping, 1.0)), resolution),
            damped=(bool(damped[:, 0].all()), bool(damped[:, 1].all())),
            facts=facts,
            name=dense_model.frame.name,
        )


def _find_least_damping_ratio(p: _DenseModes, band: tuple[float, float]) -> float:
    """Return the smallest damping ratio of the elastic modes in the band."""
    alpha, beta = p.model.rayleigh or (0.0, 0.0)
    w = np.sqrt(p.w2[p.w2 < (MODE_BAND_RATIO * 2 * np.pi * band[1]) ** 2])
    w = w[w > SOFT_SUPPORT_RATIO * 2 * np.pi * band[0] * (1 + ZERO_FREQUENCY_RATIO)]
    return float(np.clip((alpha / w + beta * w).min(initial=2.0) / 2, 1e-5, 1.0))
