"""Rational Krylov basis to which one expansion point after another is added.

Points are chosen alternately by two criteria: where the residual is largest, and where the last
point has changed the response most. The residual is estimated with random combinations of the
equations (a sketch). At each point, the projected model is first compared with the solution of the
full model. After the comparison, the solution of the full model and its derivative with respect to
s are added to the basis. Real and imaginary parts are separate vectors, so that all matrices remain
real.
"""

from __future__ import annotations

from itertools import chain
from typing import Any

import numpy as np
import scipy

from kc2spice.core.errors import SimulationError
from kc2spice.rom.error_estimate import compute_relative_errors
from kc2spice.rom.pencil import Pencil, SchurComplement, compute_absolute_entries
from kc2spice.rom.reductors.block_krylov import DEFLATION_LIMIT
from kc2spice.rom.reductors.ill_conditioned_models import split_real_parts
from kc2spice.rom.response import Response, sample_band
from kc2spice.rom.rigid_body import ENERGY_FACTOR, estimate_energy_rounding, split_rigid_body
from kc2spice.rom.rounding import ZERO_ENTRY_FACTOR, find_zero_entries

# A model counts as supported if the residual of K x = B, relative to B, is at most this value.
# A model without supports can move as a rigid body, so its matrix K is singular.
SINGULAR_RESIDUAL = 1e-6
# the following numbers were found by trials
SKETCH_SIZE = 32  # number of random combinations of equations that represent all residuals
# number of candidate frequencies in the linear grid and in the logarithmic grid
CANDIDATE_FREQUENCIES = 101


class GreedyBasis:
    """Growing rational Krylov basis, with sketches that estimate residuals.

    If ``static`` is true, the basis begins with the static responses.
    """

    def __init__(self, pencil: Pencil, band: tuple[float, float], static: bool = True) -> None:
        self.pencil, self.band = pencil, band
        self.two_sided = not (pencil.is_symmetric and pencil.is_collocated)
        self.basis = np.empty((pencil.size, 0))
        self.points = 0
        self.change = np.inf
        sketch = np.random.default_rng(0).standard_normal((SKETCH_SIZE, pencil.size))
        self._sides = [_ResidualSketch(sketch, pencil.coefficients, pencil.B)]
        if self.two_sided:
            dual = pencil.make_dual()
            self._sides.append(_ResidualSketch(sketch, dual.coefficients, dual.B))
        self._used: list[complex] = []
        self.turn = np.empty((0, 0))
        self.response = Response(pencil.project(self.basis))
        self._previous = self.response
        self.static = False
        self.static = static and self._add_static_responses()

    def add_checked_point(self, s: complex) -> tuple[float, bool]:
        """Return the projected model's error at ``s``, and add the solution to the basis.

        The solution of the full model at ``s`` is added to the basis. The second result states
        whether the basis then has more vectors than before.
        """
        x, *others = self.solve(s)
        true = self.pencil.C @ x + self.pencil.D
        points = self._list_candidate_frequencies()
        grid_s = 2j * np.pi * points
        entries = self.response.compute_error_scales(points)
        error = compute_relative_errors(
            self.response.transfer(np.array([s]))[0] - true, true, entries
        )
        error[self.response.mask_cancelled_entries(np.r_[grid_s, s]) & ~entries.zero] = 0.0
        before = self.basis.shape[1]
        self.extend(s, x, *others)
        return float(error.max()), self.basis.shape[1] > before

    def choose_next_point(self) -> complex:
        """Choose the Laplace variable s [1/s] of the next expansion point.

        Candidates are chosen alternately by the largest residual, and by the largest change of the
        response that the last point caused.
        """
        points = self._list_candidate_frequencies()
        s = 2j * np.pi * points
        result = self.response.transfer(s)
        entries = self.response.compute_error_scales(points, result)
        size = compute_relative_errors(self._previous.transfer(s) - result, result, entries)
        size[:, self.response.mask_cancelled_entries(s) & ~entries.zero] = 0.0
        self.change = float(size.max()) if self.points > 2 else np.inf
        fresh = np.array([not np.isclose(item, self._used, rtol=1e-7).any() for item in s])
        if not fresh.any():
            raise SimulationError(
                "all frequencies of the band are sampled, and the error still "
                "exceeds the tolerance",
                where="reduction",
                hint="raise the tolerance",
            )
        measure = size.max(axis=(1, 2))
        if self.points % 2:
            measure = self._sides[0].estimate_residual(s, self.turn @ self.response.states(s))
            if self.two_sided:
                measure = measure * self._sides[1].estimate_residual(
                    s, self.response.dual_response.states(s)
                )
        return complex(s[np.argmax(np.where(fresh, measure, -1.0))])

    def _list_candidate_frequencies(self) -> np.ndarray:
        """Return candidate frequencies [Hz] for the next expansion point."""
        return sample_band(self.response, self.band, CANDIDATE_FREQUENCIES, self.static)

    def _add_static_responses(self) -> bool:
        """Add the static responses to the basis, or return False if none exist."""
        b = self.pencil.B
        try:
            answers = self.solve(0.0)
        except SimulationError:
            return False
        residual = self.pencil.coefficients[0] @ answers[0] - b
        if np.linalg.norm(residual) > SINGULAR_RESIDUAL * np.linalg.norm(b):
            return False
        self.extend(0.0, *answers)
        return True

    def solve(self, s: complex) -> tuple[np.ndarray, ...]:
        """Solve ``P(s) x = B`` for the pencil P; return x and the derivative ``-dx/ds``.

        If the model is not symmetric, or if C differs from ``B^T``, also return ``y = P(s)^-T C^T``
        and the derivative ``-dy/ds``.
        """
        forward, backward = self.pencil.factorise_polynomial(s)
        self.points += 1
        x = forward.solve(self.pencil.B)
        answers = [x, forward.solve(self.pencil.apply_derivative(s, x))]
        if self.two_sided:
            dual = self.pencil.make_dual()
            y = backward.solve(dual.B)
            answers += [y, backward.solve(dual.apply_derivative(s, y))]
        return tuple(answers)

    def extend(self, s: complex, *answers: np.ndarray) -> None:
        """Add the solutions at the expansion point ``s`` to the basis."""
        self._used.append(s)
        new = np.column_stack([*chain.from_iterable(map(split_real_parts, answers))])
        fresh = _find_independent_directions(self.basis, new)
        if not fresh.shape[1]:
            self._previous = self.response
            return
        self.basis = np.hstack([self.basis, fresh])
        for side in self._sides:
            side.extend(fresh)
        self.turn = _compute_modes(self.pencil.project(self.basis))
        small = self.projected = self.pencil.project(self.modal_basis)
        small, turn = self._split_rigid_body(small)
        self.turn = self.turn @ turn
        self._previous, self.response = self.response, Response(small)
        self.response.zero = find_zero_entries(
            self.pencil, self.basis @ self.turn, self.response, self.band
        )

    def _split_rigid_body(self, small: Pencil) -> tuple[Pencil, np.ndarray]:
        """Separate rigid-body motions from the other unknowns of a projected model.

        A motion is a rigid-body motion if its energy is within the rounding errors of the entries
        of the full model. In a model with a static response, no input excites a rigid-body motion,
        so rigid-body motions are omitted.
        """
        V, coefficients = self.modal_basis, self.pencil.coefficients
        sizes, eps = list(map(compute_absolute_entries, coefficients)), np.finfo(float).eps
        bound = ZERO_ENTRY_FACTOR * eps * (np.abs(V).T @ (sizes[0] @ np.abs(V)))
        energies = np.abs(np.diag(small.coefficients[0]))
        if (energies > np.diag(bound)).all():
            return small, np.eye(small.size)
        if not isinstance(coefficients[0], SchurComplement):
            bound = np.minimum(bound, ENERGY_FACTOR * estimate_energy_rounding(coefficients[0], V))
        others = [ZERO_ENTRY_FACTOR * eps * (np.abs(V).T @ (P @ np.abs(V))) for P in sizes[1:]]
        result = split_rigid_body(small, 2 * np.pi * self.band[1], (bound, *others))
        if result.pencil.degree != small.degree or (self.static and result.pencil.free):
            return small, np.eye(small.size)
        return result.pencil, result.columns

    @property
    def frequencies(self) -> tuple[float, ...]:
        """Frequencies [Hz] of the expansion points, in the order of addition."""
        return tuple(float(abs(s) / (2 * np.pi)) for s in self._used)

    @property
    def modal_basis(self) -> np.ndarray:
        """Basis of the Krylov subspace, with one mode of the projected model per column.

        Projected matrices of thin bodies are small differences of large numbers. In a projection on
        modes, fewer matrix entries are small differences of large numbers, so rounding errors are
        smaller.
        """
        return self.basis @ self.turn


class _ResidualSketch:
    """Estimator of the residuals of a projected model, from random sums of equations."""

    def __init__(self, sketch: np.ndarray, coefficients: tuple[Any, ...], b: np.ndarray) -> None:
        self._rows = [np.asarray((P.T @ sketch.T).T) for P in coefficients]
        self._images = [np.empty((SKETCH_SIZE, 0)) for _ in coefficients]
        self._b = sketch @ b

    def extend(self, columns: np.ndarray) -> None:
        """Store the products of the sketched matrices and new basis vectors ``columns``."""
        self._images = [
            np.hstack([image, rows @ columns])
            for image, rows in zip(self._images, self._rows, strict=True)
        ]

    def estimate_residual(self, s: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the largest relative residual of all right-hand sides at each ``s``."""
        product = sum(s[:, None, None] ** k * (image @ x) for k, image in enumerate(self._images))
        size = np.linalg.norm(self._b, axis=0) + np.finfo(float).tiny
        return np.asarray((np.linalg.norm(self._b - product, axis=1) / size).max(axis=1))


def _compute_modes(pencil: Pencil) -> np.ndarray:
    """Return the undamped modes of a small symmetric second-order pencil.

    Return the unit matrix if the pencil is not symmetric, not of second order, or has a mass matrix
    that is not positive definite.
    """
    if pencil.degree == 2 and pencil.is_symmetric:
        K, _, M = pencil.coefficients
        try:
            return np.asarray(scipy.linalg.eigh(K, M)[1])
        except np.linalg.LinAlgError:  # undamped modes need a positive definite mass matrix
            pass
    return np.eye(pencil.size)


def _find_independent_directions(basis: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Find independent directions: orthonormal vectors that ``new`` adds to ``basis``.

    Columns of ``new`` that depend linearly on ``basis`` or on earlier columns are omitted.
    """
    result = np.empty((basis.shape[0], 0))
    for column in new.T:
        length = np.linalg.norm(column)
        for _ in range(2):  # two orthogonalisation passes are enough (Kahan and Parlett)
            column = column - basis @ (basis.T @ column)
            column = column - result @ (result.T @ column)
        rest = np.linalg.norm(column)
        if rest > DEFLATION_LIMIT * length and basis.shape[1] + result.shape[1] < basis.shape[0]:
            result = np.column_stack([result, column / rest])
    return result
