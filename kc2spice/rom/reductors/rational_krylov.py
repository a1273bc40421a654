"""Rational Krylov subspaces: solutions and derivatives at several expansion points.

Points are chosen where the sketched residual, in turn with the last change, is largest. Each is
solved on the full model first as a *check* of the projection, and only then joins the basis with
its derivative by s, real and imaginary part apart so that everything stays real. Models with
definite matrices need real shifts only: the pencil ``K - w^2 M`` serves the pair of points +-j w.

Sources: rational interpolation, greedy or by oblique projection (Grimme 1997; Feng, Antoulas,
Benner 2017).
"""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import scipy

from kc2spice.core.errors import SimulationError
from kc2spice.rom.error_estimate import inexact, relative_size
from kc2spice.rom.intermediate import Subspace
from kc2spice.rom.pencil import Pencil, Schur, magnitudes
from kc2spice.rom.reductors.block_krylov import DEFLATION, extend
from kc2spice.rom.reductors.exact_samples import real_parts
from kc2spice.rom.response import GRID, Response, samples
from kc2spice.rom.rigid_body import RANDOM, apart, energy_rounding, hidden_support
from kc2spice.rom.rounding import FREE, _taken_out, _with_rounding, zero_entries

# K x = B solved to less than this of B: the model is free to move at zero frequency.
SINGULAR = 1e-6
# Krylov blocks at zero and at each other point before their gain is judged; less gain calls for a
# new point. A block costs a twentieth of the factorisation that a point costs.
START = 4
BLOCKS = 3
GAIN = 3.0
STATES = 600
MAX_POINTS = 180
CONFIRMATIONS = 2  # in a row that must be met
MANY = 20  # factorisations that need a word
COSTLY = 10_000  # unknowns from which on they do
SKETCH = 32  # random combinations of equations that stand for all residuals
CANDIDATES = 101


def _block_krylov(
    pencil: Pencil, band: tuple[float, float], target: float, limit: float
) -> Subspace:
    K, _, M = pencil.coefficients
    current = pencil.pencil_solver(0.0)
    V = images = np.empty((pencil.size, 0))
    candidates = current.solve(pencil.B)
    used, met, change, before = [0.0], 0, np.inf, np.inf
    blocks = START
    previous: Response | None = None
    while V.shape[1] < STATES:
        columns, column_images = extend(V, images, candidates, lambda v: K @ v)
        V, images = np.hstack([V, columns]), np.hstack([images, column_images])
        response = Response(pencil.project(V))
        response.zero = zero_entries(pencil, V, response, band)
        frequency = samples(response, band, GRID, True, (0.0, 1.0, 4.0))  # notches come last
        s = 2j * np.pi * frequency
        result = response.transfer(s)
        size = np.ones((len(s), 1, 1))
        if previous is not None:
            entries = response.entries(frequency, result)
            size = relative_size(previous.transfer(s) - result, result, entries)
        before, change = change, float(size.max())
        met = met + 1 if change <= target else 0
        if met == CONFIRMATIONS or (not columns.shape[1] and change <= limit):
            proof = f"settled to {change:.0e} of the full model's response"
            space = Subspace(response, change, True, proof)
            return _with_rounding(pencil, V, band, space)
        previous = response
        blocks -= 1
        if columns.shape[1] and (blocks >= 0 or change <= before / GAIN):
            candidates = current.solve(M @ columns)
            continue
        apart = np.abs(frequency[:, None] - np.array(used)).min(axis=1) > 1e-3 * band[1]
        if not apart.any():
            break
        worst = float(frequency[np.argmax(np.where(apart, size.max(axis=(1, 2)), -1.0))])
        used.append(worst)
        blocks = BLOCKS - 1
        current = pencil.pencil_solver((2 * np.pi * worst) ** 2)
        candidates = current.solve(pencil.B)
    raise _unsettled(response, band, change, limit)


def _unsettled(
    response: Response, band: tuple[float, float], error: float, limit: float
) -> SimulationError:
    modes = response.within(band)[0].size
    return inexact(
        "the reduced model does not settle",
        f"relative error {error:.1e} with {response.pencil.size} states; the band holds at least "
        f"{modes} resonances",
        limit,
        "narrow the band or ask for a looser tolerance",
    )


def _rational(
    pencil: Pencil, band: tuple[float, float], target: float, limit: float, most: int
) -> Subspace:
    search = _Search(pencil, band)
    met, error, recent, idle = 0, np.inf, [np.inf], 0
    end = 2j * np.pi * band[1]
    search.extend(end, *search.solve(end))
    while search.points < most and search.basis.shape[1] < STATES:
        error, grown = search.check(search.next_point())
        met = met + 1 if max(error, search.change) <= target else 0
        if search.points == MANY + 1 and pencil.size >= COSTLY:
            modes = search.response.within(band)[0].size
            text = "a narrower band, a looser tolerance or proportional damping costs less"
            warnings.warn(
                f"the reduction takes more than {MANY} factorisations: the last frequency was "
                f"still {error:.0e} off, {target:.0e} is looked for, and the band holds at least "
                f"{modes} resonances; {text}",
                stacklevel=2,
            )
        # An error that was found before the basis grew is no longer that of the projection.
        # A point beside a former one adds nothing, and says nothing of the rest of the band.
        recent = [*recent[-1:], error] if grown or idle else [error]
        idle = 0 if grown else idle + 1
        if CONFIRMATIONS in (met, idle):
            break
    worst = max(recent)
    proof = f"checked against the full model at {search.points} frequencies"
    small = search.response.pencil
    floor = _taken_out(search.projected, small, band) if small.free else 0.0
    hidden = hidden_support(pencil, search.modal[:, : small.free], band[0])
    static = search.static or small.free > 0
    result = Subspace(search.response, worst, static, proof, floor, hidden=hidden)
    result = _with_rounding(pencil, search.modal, band, result)
    if worst > max(limit, result.floor) or not np.isfinite(worst):
        raise _unsettled(search.response, band, worst, limit)
    return replace(result, error=min(worst, limit))


class _Search:
    """The basis as it grows, with what the residual estimate needs of it."""

    def __init__(self, pencil: Pencil, band: tuple[float, float]) -> None:
        self.pencil, self.band = pencil, band
        self.two_sided = not (pencil.symmetric and pencil.collocated)
        self.basis = np.empty((pencil.size, 0))
        self.points = 0
        self.change = np.inf
        sketch = np.random.default_rng(0).standard_normal((SKETCH, pencil.size))
        self._sides = [_Sketch(sketch, pencil.coefficients, pencil.B)]
        if self.two_sided:
            dual = pencil.transposed()
            self._sides.append(_Sketch(sketch, dual.coefficients, dual.B))
        self._used: list[complex] = []
        self.turn = np.empty((0, 0))
        self.response = Response(pencil.project(self.basis))
        self._previous = self.response
        self.static = False
        self.static = self._add_static()

    def check(self, s: complex) -> tuple[float, bool]:
        """Relative error of the present projection at ``s``, which then joins the basis.

        Also returns whether the basis grew.
        """
        x, *others = self.solve(s)
        true = self.pencil.C @ x + self.pencil.D
        points = self._candidates()
        grid_s = 2j * np.pi * points
        entries = self.response.entries(points)
        error = relative_size(self.response.transfer(np.array([s]))[0] - true, true, entries)
        error[self.response.cancelled(np.r_[grid_s, s]) & ~entries.zero] = 0.0
        before = self.basis.shape[1]
        self.extend(s, x, *others)
        return float(error.max()), self.basis.shape[1] > before

    def next_point(self) -> complex:
        """The candidate, not used before, of the largest residual; every second time that where
        the last point changed the response most."""
        points = self._candidates()
        s = 2j * np.pi * points
        result = self.response.transfer(s)
        entries = self.response.entries(points, result)
        size = relative_size(self._previous.transfer(s) - result, result, entries)
        size[:, self.response.cancelled(s) & ~entries.zero] = 0.0
        self.change = float(size.max()) if self.points > 2 else np.inf
        fresh = np.array([not np.isclose(item, self._used, rtol=1e-7).any() for item in s])
        if not fresh.any():
            raise SimulationError("no frequency is left to sample", where="reduction")
        measure = size.max(axis=(1, 2))
        if self.points % 2:
            measure = self._sides[0].residual(s, self.turn @ self.response.states(s))
            if self.two_sided:
                measure = measure * self._sides[1].residual(s, self.response.dual.states(s))
        return complex(s[np.argmax(np.where(fresh, measure, -1.0))])

    def _candidates(self) -> np.ndarray:
        return samples(self.response, self.band, CANDIDATES, self.static)

    def _add_static(self) -> bool:
        """Add the static answers if there are any; False for a model that is free to move."""
        b = self.pencil.B
        try:
            answers = self.solve(0.0)
        except SimulationError:
            return False
        residual = self.pencil.coefficients[0] @ answers[0] - b
        if np.linalg.norm(residual) > SINGULAR * np.linalg.norm(b):
            return False
        self.extend(0.0, *answers)
        return True

    def solve(self, s: complex) -> tuple[np.ndarray, ...]:
        """``x = P(s)^-1 B`` and ``-x'(s)``; where the output side differs, ``P(s)^-T C'`` too."""
        forward, backward = self.pencil.solver(s)
        self.points += 1
        x = forward.solve(self.pencil.B)
        answers = [x, forward.solve(self.pencil.slope(s, x))]
        if self.two_sided:
            dual = self.pencil.transposed()
            y = backward.solve(dual.B)
            answers += [y, backward.solve(dual.slope(s, y))]
        return tuple(answers)

    def extend(self, s: complex, *answers: np.ndarray) -> None:
        """Add ``answers`` at ``s`` to the basis."""
        self._used.append(s)
        new = np.column_stack([part for x in answers for part in real_parts(x)])
        fresh = _independent(self.basis, new)
        if not fresh.shape[1]:
            self._previous = self.response
            return
        self.basis = np.hstack([self.basis, fresh])
        for side in self._sides:
            side.extend(fresh)
        self.turn = _modes(self.pencil.project(self.basis))
        small = self.projected = self.pencil.project(self.modal)
        small, turn = self._apart(small)
        self.turn = self.turn @ turn
        self._previous, self.response = self.response, Response(small)
        self.response.zero = zero_entries(
            self.pencil, self.basis @ self.turn, self.response, self.band
        )

    def _apart(self, small: Pencil) -> tuple[Pencil, np.ndarray]:
        """The rigid-body motion of the projected model, within rounding of the full one's entries;
        where the model has a static answer, no input moves it, and it is left out."""
        V, coefficients = self.modal, self.pencil.coefficients
        sizes, eps = [magnitudes(P) for P in coefficients], np.finfo(float).eps
        bound = FREE * eps * (np.abs(V).T @ (sizes[0] @ np.abs(V)))
        own = np.abs(np.diag(small.coefficients[0]))
        if (own > np.diag(bound)).all():
            return small, np.eye(small.size)
        if not isinstance(coefficients[0], Schur):
            bound = np.minimum(bound, RANDOM * energy_rounding(coefficients[0], V))
        others = [FREE * eps * (np.abs(V).T @ (P @ np.abs(V))) for P in sizes[1:]]
        result = apart(small, 2 * np.pi * self.band[1], (bound, *others))
        if result.pencil.degree != small.degree or (self.static and result.pencil.free):
            return small, np.eye(small.size)
        return result.pencil, result.columns

    @property
    def modal(self) -> np.ndarray:
        """Basis of the same subspace whose columns are the modes of the projected model.

        Projected matrices of thin bodies are small differences of large numbers. A projection on
        these columns has fewer such differences, and therefore smaller rounding errors.
        """
        return self.basis @ self.turn


class _Sketch:
    """Residual norms of ``P(s) V x(s) = b`` from a few random combinations of its rows."""

    def __init__(self, sketch: np.ndarray, coefficients: tuple, b: np.ndarray) -> None:
        self._rows = [np.asarray((P.T @ sketch.T).T) for P in coefficients]
        self._images = [np.empty((SKETCH, 0)) for _ in coefficients]
        self._b = sketch @ b

    def extend(self, columns: np.ndarray) -> None:
        self._images = [
            np.hstack([image, rows @ columns])
            for image, rows in zip(self._images, self._rows, strict=True)
        ]

    def residual(self, s: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Largest relative residual of all right-hand sides at each ``s``."""
        product = sum(s[:, None, None] ** k * (image @ x) for k, image in enumerate(self._images))
        size = np.linalg.norm(self._b, axis=0) + np.finfo(float).tiny
        return np.asarray((np.linalg.norm(self._b - product, axis=1) / size).max(axis=1))


def _modes(pencil: Pencil) -> np.ndarray:
    """Undamped modes of a small symmetric pencil of second order, the unit matrix of any other."""
    if pencil.degree == 2 and pencil.symmetric:
        K, _, M = pencil.coefficients
        try:
            return np.asarray(scipy.linalg.eigh(K, M)[1])
        except np.linalg.LinAlgError:  # no definite mass
            pass
    return np.eye(pencil.size)


def _independent(basis: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Orthonormal directions of ``new`` outside ``basis``; what is dependent is deflated."""
    result = np.empty((basis.shape[0], 0))
    for column in new.T:
        length = np.linalg.norm(column)
        for _ in range(2):  # twice is enough (Kahan, Parlett)
            column = column - basis @ (basis.T @ column)
            column = column - result @ (result.T @ column)
        rest = np.linalg.norm(column)
        if rest > DEFLATION * length and basis.shape[1] + result.shape[1] < basis.shape[0]:
            result = np.column_stack([result, column / rest])
    return result
