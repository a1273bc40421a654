"""A subspace that holds the answers of a full model over a band: multi-point rational Krylov.

Points are chosen where the residual of the present projection is largest. Each is solved on the
full model first as a *check* of the projection, at a frequency that it was not fitted on, and
only then joins the basis, real and imaginary part apart so that everything stays real. With it
joins its derivative by s, which costs another solution but no factorisation (Hermite).
Source: greedy rational interpolation (Grimme 1997; Feng, Antoulas, Benner 2017).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.linalg.factor import Solver
from kc2spice.rom.pencil import Pencil, factorise_at, response, states
from kc2spice.rom.response import FLOOR

# A candidate that keeps less than this of its length outside the basis brings rounding noise only.
DEFLATION = 1e-10
# K x = B solved to less than this of B: the model is free to move at zero frequency.
SINGULAR = 1e-6
# A response this far below the product of its factors is what their cancellation leaves: a zero.
CANCELLED = 1e-10
CONFIRMATIONS = 2  # checks in a row that must be met
MAX_POINTS = 180
SKETCH = 32  # random combinations of equations that stand for all residuals
CANDIDATES = 101


@dataclass(frozen=True)
class Sampled:
    """``basis`` (n, q), the largest error at the last checks, points solved, and whether the
    static answer exists (no rigid body motion, no free integrator).
    """

    basis: np.ndarray
    error: float
    points: int
    static: bool


def grid(band: tuple[float, float], count: int, static: bool) -> np.ndarray:
    """Frequencies [Hz] over the band, half linear, half logarithmic over four decades at most.

    Zero is one of them if the band starts there and the static answer exists.
    """
    low, high = band
    start = max(low, 1e-4 * high)
    frequency = np.r_[np.linspace(start, high, count), np.geomspace(start, high, count)]
    if low == 0 and static:
        frequency = np.r_[0.0, frequency]
    return np.unique(frequency)


def sample(
    pencil: Pencil,
    band: tuple[float, float],
    target: float,
    limit: float,
    solver: Solver = "scipy",
) -> Sampled:
    """Basis whose projection is within ``target`` of the full model wherever it was checked.

    Where rounding of the full model's solutions keeps it from that, ``limit`` must do.

    Raises
    ------
    SimulationError : not even ``limit`` is met within ``MAX_POINTS`` factorisations.
    """
    search = _Search(pencil, solver)
    static = search.add_static()
    frequency = grid(band, CANDIDATES, static)
    search.add(2j * np.pi * band[1])
    met, error = 0, np.inf
    recent: list[float] = []
    while search.points < MAX_POINTS:
        s = search.worst(2j * np.pi * frequency)
        error, grown = search.check(s, 2j * np.pi * frequency)
        met = met + 1 if error <= target else 0
        # An error that was found before the basis grew is no longer that of the projection.
        recent = [*recent[-1:], error] if grown else [error]
        if met == CONFIRMATIONS or not grown:
            break
    worst = max(recent)
    if worst > limit:
        raise SimulationError(
            "the reduced model does not settle",
            where="reduction",
            got=f"relative error {worst:.1e} with {search.basis.shape[1]} states",
            expected=f"at most {limit:.1e}",
            hint="narrow the band or ask for a looser tolerance",
        )
    return Sampled(search.basis, worst, search.points, static)


class _Search:
    """The basis as it grows, with what the residual estimate needs of it."""

    def __init__(self, pencil: Pencil, solver: Solver) -> None:
        self.pencil = pencil
        self.solver: Solver = solver
        self.symmetric = pencil.symmetric
        self.two_sided = not (self.symmetric and pencil.collocated)
        self.basis = np.empty((pencil.size, 0))
        self.points = 0
        sketch = np.random.default_rng(0).standard_normal((SKETCH, pencil.size))
        transposed = tuple(P.T for P in pencil.coefficients)
        self._sides = [_Sketch(sketch, pencil.coefficients, pencil.B)]
        if self.two_sided:
            self._sides.append(_Sketch(sketch, transposed, pencil.C.T))
        self._used: list[complex] = []
        self._reduced = pencil.project(self.basis)

    def add_static(self) -> bool:
        """Add the static answers if there are any; False for a model that is free to move."""
        b = self.pencil.B
        try:
            answers = self._solve(0.0)
        except SimulationError:
            return False
        residual = self.pencil.coefficients[0] @ answers[0] - b
        if np.linalg.norm(residual) > SINGULAR * np.linalg.norm(b):
            return False
        self._extend(0.0, *answers)
        return True

    def add(self, s: complex) -> None:
        """Add the answers at ``s``."""
        self._extend(s, *self._solve(s))

    def check(self, s: complex, candidates: np.ndarray) -> tuple[float, bool]:
        """Relative error of the present projection at ``s``, which then joins the basis.

        Also returns whether the basis grew.
        """
        x, *others = self._solve(s)
        true = self.pencil.C @ x + self.pencil.D
        peak = np.abs(response(self._reduced, candidates)).max(axis=0)
        difference = np.abs(response(self._reduced, np.array([s]))[0] - true)
        size = np.abs(true)
        factors = np.linalg.norm(self.pencil.C, axis=1)[:, None] * np.linalg.norm(x, axis=0)
        counted = (size > FLOOR * np.maximum(peak, size)) & (size > CANCELLED * factors)
        error = float((difference[counted] / size[counted]).max(initial=0.0))
        before = self.basis.shape[1]
        self._extend(s, x, *others)
        return error, self.basis.shape[1] > before

    def worst(self, candidates: np.ndarray) -> complex:
        """The candidate, not used before, whose residuals on both sides are the largest."""
        fresh = np.array([s for s in candidates if not np.isclose(s, self._used, rtol=1e-3).any()])
        if not fresh.size:
            raise SimulationError("no frequency is left to sample", where="reduction")
        right = states(self._reduced, fresh)
        size = self._sides[0].residual(fresh, right)
        if self.two_sided:
            size = size * self._sides[1].residual(fresh, states(_transposed(self._reduced), fresh))
        return complex(fresh[np.argmax(size)])

    def _solve(self, s: complex) -> tuple[np.ndarray, ...]:
        """``x = P(s)^-1 B`` and ``-x'(s)``; where the output side differs, ``P(s)^-T C'`` too."""
        forward, backward = factorise_at(self.pencil, s, self.solver)
        self.points += 1
        slope = self.pencil.slope(s)
        x = forward.solve(self.pencil.B)
        answers = [x, forward.solve(slope @ x)]
        if self.two_sided:
            y = backward.solve(self.pencil.C.T)
            answers += [y, backward.solve(slope.T @ y)]
        return tuple(answers)

    def _extend(self, s: complex, *answers: np.ndarray) -> None:
        self._used.append(s)
        new = np.column_stack([part for x in answers for part in _parts(x)])
        fresh = np.column_stack([np.empty((self.pencil.size, 0)), *_independent(self.basis, new)])
        if not fresh.shape[1]:
            return
        self.basis = np.hstack([self.basis, fresh])
        for side in self._sides:
            side.extend(fresh)
        self._reduced = self.pencil.project(self.basis)


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
        product = sum(
            s[:, None, None] ** k * (image @ x) for k, image in enumerate(self._images)
        )  # fmt: skip
        size = np.linalg.norm(self._b, axis=0) + np.finfo(float).tiny
        return np.asarray((np.linalg.norm(self._b - product, axis=1) / size).max(axis=1))


def _transposed(pencil: Pencil) -> Pencil:
    flipped = tuple(P.T for P in pencil.coefficients)
    return Pencil(flipped, pencil.C.T, pencil.B.T, pencil.D.T)


def _parts(x: np.ndarray) -> list[np.ndarray]:
    return [x.real, x.imag] if np.iscomplexobj(x) else [x]


def _independent(basis: np.ndarray, new: np.ndarray) -> Iterator[np.ndarray]:
    """Orthonormal directions of ``new`` outside ``basis``; what is dependent is deflated."""
    found = np.empty((basis.shape[0], 0))
    for column in new.T:
        length = np.linalg.norm(column)
        for _ in range(2):  # twice is enough (Kahan, Parlett)
            column = column - basis @ (basis.T @ column)
            column = column - found @ (found.T @ column)
        rest = np.linalg.norm(column)
        if rest <= DEFLATION * length or basis.shape[1] + found.shape[1] == basis.shape[0]:
            continue
        found = np.column_stack([found, column / rest])
        yield column / rest
