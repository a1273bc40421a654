"""Computation of a circuit's unknowns from the values of its data sheet.

Each value is a function of the unknowns, and some values may be redundant. Unknowns and values are
positive, and the equations are solved for their logarithms: with ``x = ln(unknowns)`` and the
tolerance t of each value,

    minimise  sum_j (ln value_j(x) - ln stated_j)^2 / t_j^2.

Each redundant value must agree with all other values within the tolerances.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from kc2spice.core.errors import UsageError, join_first, join_words

VALUE_ROUNDING = 0.005  # largest relative rounding error of a value with three significant digits
# Step of the central differences of logarithms.
# The central differences have truncation errors of 1e-10 and rounding errors of 1e-11.
DIFFERENCE_STEP = 1e-5
# An unknown counts as undetermined if its relative singular value is below this tolerance.
# The tolerance is far above the errors of the central differences.
RANK_TOLERANCE = 1e-7
SOLUTION_TOLERANCE = 1e-6  # largest relative error of an equation that counts as solved
# factor by which one unknown changes at the start of the search for a second circuit
RESTART_FACTOR = 30.0
# Two circuits count as different if the logarithm of an unknown differs by more than this value.
DISTINCT_DIFFERENCE = 1e-3
# Smallest accepted value in SI units, far below all values of data sheets.
# The largest accepted value is the reciprocal of the smallest accepted value.
SMALLEST_VALUE = 1e-24
LARGEST_LOGARITHM = 150.0  # logarithm of the largest unknown, far inside the range of a float

Relation = Callable[[np.ndarray], float]


@dataclass(frozen=True, eq=False)
class StatedValues:
    """Values stated in a data sheet, as equations for the unknown circuit values.

    ``stated`` contains the stated values, keyed by name. ``relations`` contains a function for each
    value that a data sheet can state. The argument of each function is the vector of unknowns in SI
    units. ``start`` contains the unknowns at the start of the iteration. ``units`` contains the
    units of the values. ``tolerance`` contains relative tolerances of values. For values without a
    tolerance, ``rounding`` contains the relative rounding error. If values contradict each other,
    the error names a value of ``suspects`` first. ``assumptions`` contains advice for values that
    data sheets often omit, keyed by name. If exactly one value is missing, the error contains the
    advice for a value that would complete the stated values.
    """

    part: str
    stated: Mapping[str, float]
    relations: Mapping[str, Relation]
    start: np.ndarray
    units: Mapping[str, str]
    tolerance: Mapping[str, float]
    rounding: Mapping[str, float]
    suspects: frozenset[str] = frozenset()
    assumptions: Mapping[str, str] = field(default_factory=dict)

    def solve(self) -> np.ndarray:
        """Compute the unknowns in SI units from the values that the data sheet states.

        Raises
        ------
        UsageError : the values are too few, contradict each other, or match no circuit.
        """
        self._require_plausible_values()
        self._require_enough_values()
        result = self._fitted_logarithms
        self._require_solution(result)
        self._require_agreement(result)
        self._require_unique_circuit(result)
        return np.exp(result)

    def get_log_tolerance(self, key: str) -> float:
        """Return the tolerance of one stated value, as a difference of logarithms."""
        return math.log1p(self.tolerance.get(key, self.rounding.get(key, VALUE_ROUNDING)))

    def format_stated_value(self, key: str, value: float) -> str:
        """Return a data-sheet value as the text ``key = value unit``."""
        return f"{key} = {value:.5g} {self.units[key.partition('[')[0]]}".rstrip()

    # --- equations --------------------------------------------------------------------------------

    def _compute_logarithm(self, key: str, x: np.ndarray) -> float:
        """Compute the logarithm of a data-sheet value from the unknowns of the circuit.

        ``x`` contains the logarithms of the unknowns.
        """
        unknowns = np.exp(np.clip(x, -LARGEST_LOGARITHM, LARGEST_LOGARITHM))
        value = self.relations[key](unknowns)
        return math.log(value) if 0 < value < math.inf else -LARGEST_LOGARITHM

    def _compute_gradient(self, key: str, x: np.ndarray) -> np.ndarray:
        """Compute the gradient of the logarithm of one data-sheet value.

        The derivatives are taken with respect to the logarithms of the unknowns; their array has
        the shape (unknowns,).
        """
        steps = DIFFERENCE_STEP * np.eye(x.size)
        rows = [
            self._compute_logarithm(key, x + h) - self._compute_logarithm(key, x - h) for h in steps
        ]
        return np.array(rows) / (2 * DIFFERENCE_STEP)

    def _compute_residual(self, key: str, x: np.ndarray) -> float:
        """Return the log ratio of a computed value to its stated value."""
        return self._compute_logarithm(key, x) - math.log(self.stated[key])

    @cached_property
    def _fitted_logarithms(self) -> np.ndarray:
        """Logarithms of the unknowns that match the stated values best."""
        return self._fit_unknowns(np.log(self.start))

    def _fit_unknowns(self, start: np.ndarray) -> np.ndarray:
        """Return the logarithms of the unknowns, fitted to the stated values.

        ``start`` contains the logarithms at the start of the iteration.
        """
        from scipy.optimize import least_squares  # loads slowly

        weights = np.array([1 / self.get_log_tolerance(key) for key in self.stated])
        weights /= weights.max()

        def residuals(x: np.ndarray) -> np.ndarray:
            """Return the residuals of all stated values, divided by the tolerances."""
            return weights * [self._compute_residual(key, x) for key in self.stated]

        def slopes(x: np.ndarray) -> np.ndarray:
            """Return the derivatives of the residuals with respect to the unknowns ``x``."""
            return weights[:, None] * [self._compute_gradient(key, x) for key in self.stated]

        close = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
        result = least_squares(residuals, start, slopes, method="lm", **close)
        return np.asarray(result.x)

    def _drop_value(self, key: str) -> StatedValues:
        """Return a copy of the stated values without one value."""
        stated = {other: value for other, value in self.stated.items() if other != key}
        return replace(self, stated=stated)

    def _count_determined_unknowns(self, x: np.ndarray, *more: str) -> int:
        """Return the number of unknowns that the named values determine.

        The stated values and the values ``more`` are considered.
        """
        rows = [self._compute_gradient(key, x) for key in (*self.stated, *more)]
        return int(np.linalg.matrix_rank(np.array(rows), tol=RANK_TOLERANCE)) if rows else 0

    # --- faults -----------------------------------------------------------------------------------

    def _require_plausible_values(self) -> None:
        """Raise an error if a stated value is far too small or far too large."""
        for key, value in self.stated.items():
            if not SMALLEST_VALUE < value < 1 / SMALLEST_VALUE:
                unit = self.units[key.partition("[")[0]]
                raise UsageError(
                    "this value is too small or too large",
                    where=f"{self.part}.{key}",
                    got=self.format_stated_value(key, value),
                    expected=f"{SMALLEST_VALUE:g} to {1 / SMALLEST_VALUE:g} {unit}".rstrip(),
                    hint="check the value and its unit",
                )

    def _require_enough_values(self) -> None:
        """Raise an error if the stated values do not determine all unknowns."""
        x, rank = np.log(self.start), self._count_determined_unknowns(np.log(self.start))
        if rank == x.size:
            return
        useful = [key for key in self.relations if self._count_determined_unknowns(x, key) > rank]
        chosen: list[str] = []
        for key in useful:
            if self._count_determined_unknowns(x, *chosen, key) > rank + len(chosen):
                chosen.append(key)
        missing = x.size - rank
        hints = [self.assumptions[key] for key in useful if key in self.assumptions]
        raise UsageError(
            "the stated values do not fully determine the circuit",
            where=self.part,
            got=", ".join(self.stated) or "no value",
            expected=f"{missing} more value{'s' * (missing > 1)} of {join_first(useful)}",
            hint=hints[0] if hints and missing == 1 else f"add {join_words(chosen[:missing])}",
        )

    def _require_solution(self, x: np.ndarray) -> None:
        """Raise an error if just enough values are stated, but no circuit is a solution."""
        if len(self.stated) > x.size:
            return
        misses = {key: abs(self._compute_residual(key, x)) for key in self.stated}
        if max(misses.values()) > SOLUTION_TOLERANCE:
            self._raise_contradiction(x, misses)

    def _raise_contradiction(self, x: np.ndarray, misses: Mapping[str, float]) -> None:
        """Raise an error that names the two stated values with the largest misfits."""
        first, second = sorted(misses, key=lambda key: -misses[key] / self.get_log_tolerance(key))[
            :2
        ]
        nearest = (
            self.format_stated_value(key, math.exp(self._compute_logarithm(key, x)))
            for key in (first, second)
        )
        stated = (self.format_stated_value(key, self.stated[key]) for key in (first, second))
        raise UsageError(
            "no circuit has all stated values; a fitted circuit deviates most from these two",
            where=f"{self.part}.{first}",
            got=" and ".join(stated),
            expected=f"values that one circuit can have, such as {' and '.join(nearest)}",
            hint=f"check {first} and {second}, and their units",
        )

    def _require_agreement(self, x: np.ndarray) -> None:
        """Raise an error if a redundant value contradicts the other values.

        Each redundant value is compared with an implied value, which follows from all other stated
        values. ``S_k`` is the derivative of the implied value with respect to the other value k.
        The tolerances are t for the redundant value and ``t_k`` for the value k. The implied value
        may differ from the stated value by ``t + sum |S_k| t_k``.
        """
        redundant = {}
        for key in self.stated if len(self.stated) > x.size else ():
            others = self._drop_value(key)
            if others._count_determined_unknowns(x) == x.size:
                redundant[key] = others._compute_sensitivities(key, x)
        if not any(self._is_contradicted(key, shares, x) for key, shares in redundant.items()):
            return
        # Select the values whose removal leaves a realistic circuit with all other stated values.
        possible = {
            key: shares for key, shares in redundant.items() if self._has_implied_value(key)
        }
        suspects = set(filter(self._is_suspect, possible))
        key = max(suspects or possible or redundant, key=self._compute_deviation)
        shares = {name: share for name, share in redundant[key].items() if name in possible}
        shares = shares or redundant[key]
        other = max(shares, key=lambda name: abs(shares[name]) * self.get_log_tolerance(name))
        raise self._make_contradiction_error(key, other)

    def _has_implied_value(self, key: str) -> bool:
        """Return whether the stated values other than ``key`` imply a value of ``key``.

        The implied value must be realistic. The circuit that is fitted to all stated values except
        ``key`` must reproduce each fitted value within its tolerance.
        """
        others = self._drop_value(key)
        logarithms = others._fitted_logarithms
        value = math.exp(others._compute_logarithm(key, logarithms))
        misfits = (others._is_contradicted_at(name, logarithms) for name in others.stated)
        return SMALLEST_VALUE < value < 1 / SMALLEST_VALUE and not any(misfits)

    def _is_suspect(self, key: str) -> bool:
        """Return whether a value is a probable cause of contradictory values.

        A value is a probable cause if ``suspects`` contains the value, or the list to which the
        value belongs.
        """
        return key.partition("[")[0] in self.suspects

    def _is_contradicted_at(self, key: str, x: np.ndarray) -> bool:
        """Return whether the circuit with the unknowns ``x`` contradicts a stated value.

        ``x`` contains the logarithms of the unknowns.
        """
        return abs(self._compute_residual(key, x)) > self.get_log_tolerance(key)

    def _is_contradicted(self, key: str, shares: Mapping[str, float], x: np.ndarray) -> bool:
        """Return whether a stated value is contradicted by all other stated values."""
        implied = sum(share * self._compute_residual(name, x) for name, share in shares.items())
        allowed = sum(abs(share) * self.get_log_tolerance(name) for name, share in shares.items())
        return abs(implied - self._compute_residual(key, x)) > allowed + self.get_log_tolerance(key)

    def _compute_deviation(self, key: str) -> float:
        """Return how far a stated value deviates from the value that the others imply.

        The deviation is the absolute value of the logarithm of the ratio of both values.
        """
        return abs(self._compute_residual(key, self._drop_value(key)._fitted_logarithms))

    def _require_unique_circuit(self, x: np.ndarray) -> None:
        """Raise an error if two different circuits have the same stated values.

        For each unknown, the search for a second circuit runs twice: with the unknown multiplied by
        :data:`RESTART_FACTOR`, and with the unknown divided by :data:`RESTART_FACTOR`.
        """
        steps = math.log(RESTART_FACTOR) * np.eye(x.size)
        for start in (*(x + steps), *(x - steps)):
            other = self._fit_unknowns(start)
            if np.abs(other - x).max() < DISTINCT_DIFFERENCE:
                continue
            if all(
                abs(self._compute_residual(key, other)) < SOLUTION_TOLERANCE for key in self.stated
            ):
                implied = [key for key in self.relations if key not in self.stated]
                key = max(implied, key=lambda key: abs(self._compare_circuits(key, x, other)))
                values = [
                    self.format_stated_value(key, math.exp(self._compute_logarithm(key, y)))
                    for y in (x, other)
                ]
                raise UsageError(
                    "these values fit more than one circuit",
                    where=self.part,
                    got=", ".join(self.stated),
                    expected=f"one more value that selects a circuit: {' or '.join(values)}",
                    hint=f"add {key}",
                )

    def _compare_circuits(self, key: str, x: np.ndarray, y: np.ndarray) -> float:
        """Return the logarithm of the ratio of the values of ``key`` in two circuits."""
        return self._compute_logarithm(key, x) - self._compute_logarithm(key, y)

    def _compute_sensitivities(self, key: str, x: np.ndarray) -> dict[str, float]:
        """Return the sensitivity of the value of ``key`` to each stated value."""
        weights = np.array([1 / self.get_log_tolerance(name) for name in self.stated])
        slopes = np.array([self._compute_gradient(name, x) for name in self.stated])
        solution = np.linalg.pinv(weights[:, None] * slopes) * weights
        return dict(zip(self.stated, self._compute_gradient(key, x) @ solution, strict=True))

    def _make_contradiction_error(self, key: str, other: str) -> UsageError:
        """Return the error for two values that contradict each other."""
        implied = {name: self._drop_value(name) for name in (key, other)}
        texts = {
            name: self.format_stated_value(
                name, math.exp(rest._compute_logarithm(name, rest._fitted_logarithms))
            )
            for name, rest in implied.items()
        }
        changes = {
            name: abs(
                rest._compute_logarithm(name, rest._fitted_logarithms) - math.log(self.stated[name])
            )
            for name, rest in implied.items()
        }
        redundant = min(changes, key=changes.__getitem__)
        hint = f"delete {redundant}, which follows from the other values"
        if self._is_suspect(key):
            _, _, value = texts[key].partition(" = ")
            quoted = f'"{value}"' if " " in value else value  # a value with a unit is a string
            hint = f"write {key} = {quoted}, or delete {key}"
        stated = [self.format_stated_value(name, self.stated[name]) for name in (key, other)]
        return UsageError(
            f"{key} contradicts {other}",
            where=f"{self.part}.{key}",
            got=" and ".join(stated),
            expected=f"{texts[key]}, as computed from {other} and the other values; or "
            f"{texts[other]}, as computed from {key} and the other values",
            hint=hint,
        )
