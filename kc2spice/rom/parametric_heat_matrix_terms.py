"""Matrices of heat models as sums of terms that depend on parameters.

The factor of each term is a product of powers of the parameters.

Thermal conductances of a body are proportional to conductivities and film coefficients, and
inversely proportional to thicknesses and to the thermal resistances of joints. The heat capacities
of a body are proportional to densities. Therefore, the conductance matrix K is a sum of terms,

    K(p) = sum_t f_t(p) K_t,    f_t(p) = prod_k (p_k / s_k)^a_tk,    a_tk in {-1, 0, 1}

with constant scales s_k of the parameters p_k. The heat capacity matrix E has the same form. The
matrices K_t are computed from full models at a few values of the parameters.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any, TypeAlias

import numpy as np
import scipy

from kc2spice.core.errors import UsageError
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.parametric_models import Full, ParameterAxis, Values

# Sets of exponents of a parameter; the first set that represents the matrices is used.
# If the range of a parameter includes zero, only the exponent sets without -1 are tried.
POWERS: tuple[tuple[int, ...], ...] = ((0,), (0, 1), (0, -1), (0, 1, -1))
# Places at which full models are computed, in the logarithmic parameter range from -1 to 1.
# PLACES is keyed by the number of exponents of a parameter, such as 2 for the exponents 0 and 1.
# Coefficient matrices of k powers of a parameter follow from full models at k parameter values.
PLACES = {1: (0.0,), 2: (-1.0, 1.0), 3: (-1.0, 0.0, 1.0)}
CHECKED = (
    0.31,
    -0.47,
    0.62,
    -0.23,
)  # the sum of terms is compared with a full model at these coordinates
EXACT = 1e-9  # largest relative rounding error of a matrix entry
NEGLIGIBLE = (
    1e-12  # a term counts as a rounding error if its share in a matrix entry is below this limit
)
LETTERS = "EK"

_Matrices: TypeAlias = "Mapping[str, scipy.sparse.csc_array]"


@dataclass(frozen=True, eq=False)
class MatrixTerms:
    """Heat matrices E and K as sums of constant matrices times parameter factors.

    ``powers`` (terms, axes) are the exponents of the parameters in each factor. All factors are one
    if the parameters have the values ``scales`` (axes,). ``E`` and ``K`` contain one constant
    matrix for each term.
    """

    axes: tuple[ParameterAxis, ...]
    scales: np.ndarray
    powers: np.ndarray
    E: tuple[Any, ...]
    K: tuple[Any, ...]

    def evaluate_factors(self, values: Values) -> np.ndarray:
        """Return the factor of each matrix term (terms,) for ``values`` of all parameters."""
        return compute_factors(self.powers, [values[a.name] for a in self.axes] / self.scales)

    def evaluate_matrices(self, values: Values) -> dict[str, Any]:
        """Return the matrices E and K for ``values`` of all parameters, keyed by letter."""
        factors = self.evaluate_factors(values)
        return {letter: sum_products(factors, getattr(self, letter)) for letter in LETTERS}


def compute_factors(powers: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Compute the factor of each term: a product of powers of scaled parameters.

    ``shares`` (axes,) are the ratios of parameter and scale. Return an array of shape (terms,).
    """
    return np.asarray(np.prod(np.asarray(shares, dtype=float) ** powers, axis=1))


def sum_products(factors: Iterable[float], matrices: Iterable[Any]) -> Any:
    """Return the sum of the products ``factor * matrix``."""
    first, *others = (f * matrix for f, matrix in zip(factors, matrices, strict=True))
    return sum(others, start=first)


def find_matrix_terms(full: Full, axes: Sequence[ParameterAxis], frame: LinearModel) -> MatrixTerms:
    """Find terms whose sums are the matrices E and K of a parametric heat model.

    ``full(values)`` returns the full model at parameter values.

    ``frame`` is the model with each parameter in the middle of its range.

    Raises
    ------
    UsageError : E or K is not a sum of terms, or a parameter changes the input matrix B or the
    number of unknowns.
    """
    scales = np.array([axis.middle_value if axis.low else axis.high for axis in axes])

    @cache
    def compute_matrices(coordinates: tuple[float, ...]) -> _Matrices:
        """Return the matrices E and K of the full model at parameter ``coordinates``."""
        pairs = zip(axes, coordinates, strict=True)
        values = {axis.name: axis.value(x) for axis, x in pairs}
        model = full(values) if any(coordinates) else frame
        if model.order != frame.order:
            problem = "the number of mesh cells changes within the ranges"
            raise _make_unsupported_parameter_error(frame.name, problem)
        if np.abs(model.B - frame.B).max() > EXACT * np.abs(frame.B).max():
            raise _make_unsupported_parameter_error(
                frame.name, "the positions of its heat sources change"
            )
        K, E = map(scipy.sparse.csc_array, model.pencil.coefficients)
        return {"E": E, "K": K}

    def interpolate_terms(choice: Sequence[tuple[int, ...]]) -> MatrixTerms:
        """Compute the matrix of each term by interpolation between full models.

        The terms contain all products of the powers in ``choice``.
        """
        powers = np.array([*product(*choice)], dtype=int).reshape(-1, len(axes))
        places = [*product(*(PLACES[len(item)] for item in choice))]
        rows = []
        for place in places:
            values = [axis.value(x) for axis, x in zip(axes, place, strict=True)]
            rows.append(compute_factors(powers, values / scales))
        weights = np.linalg.inv(rows)
        samples = [compute_matrices(place) for place in places]
        largest = np.abs(rows).max(axis=0)
        terms = {}
        for letter in LETTERS:
            sample_matrices = [item[letter] for item in samples]
            terms[letter] = _drop_rounding(
                [sum_products(w, sample_matrices) for w in weights], largest
            )
        active = [bool(E.nnz or K.nnz) for E, K in zip(terms["E"], terms["K"], strict=True)]
        E, K = ([m for m, use in zip(terms[k], active, strict=True) if use] for k in LETTERS)
        return MatrixTerms(tuple(axes), scales, powers[active], tuple(E), tuple(K))

    def is_exact(terms: MatrixTerms, coordinates: tuple[float, ...]) -> bool:
        """Return whether the sum of ``terms`` equals the full model at ``coordinates``."""
        pairs = zip(axes, coordinates, strict=True)
        sum_of_terms = terms.evaluate_matrices({axis.name: axis.value(x) for axis, x in pairs})
        for letter, matrix in compute_matrices(coordinates).items():
            largest = sum_products(np.ones(len(terms.powers)), map(abs, getattr(terms, letter)))
            limit = EXACT * (largest + abs(matrix))
            excess = (abs(sum_of_terms[letter] - matrix) - limit).max()
            if excess > NEGLIGIBLE * abs(matrix).max():
                return False
        return True

    chosen: list[tuple[int, ...]] = []
    for k, axis in enumerate(axes):
        for powers in POWERS if axis.low else POWERS[:2]:
            trial_powers: list[tuple[int, ...]] = [(0,)] * len(axes)
            trial_powers[k] = powers
            place = tuple(CHECKED[0] * (n == k) for n in range(len(axes)))
            if is_exact(interpolate_terms(trial_powers), place):
                chosen.append(powers)
                break
        else:
            raise _make_unsupported_parameter_error(
                axis.name,
                "the matrices are not a sum of constant matrices times powers of this key",
            )
    result = interpolate_terms(chosen)
    if len(axes) > 1 and not is_exact(result, CHECKED[: len(axes)]):
        raise _make_unsupported_parameter_error(
            frame.name, "the matrices are not a sum of constant matrices times powers of the keys"
        )
    return result


def _drop_rounding(terms: Sequence[Any], largest: np.ndarray) -> list[Any]:
    """Set entries of terms to zero that are only rounding errors of larger terms."""
    size = sum_products(largest, map(abs, terms))
    result = []
    for matrix, factor in zip(terms, largest, strict=True):
        significant = matrix.multiply(factor * abs(matrix) > NEGLIGIBLE * size)
        significant = scipy.sparse.csc_array(significant)
        significant.eliminate_zeros()
        result.append(significant)
    return result


def _make_unsupported_parameter_error(where: str, problem: str) -> UsageError:
    """Make the error for a parameter that a heat netlist does not support."""
    return UsageError(
        f"unsupported parameter of a heat netlist: {problem}",
        where=where,
        expected="film coefficients, resistances, conductivities, densities, specific heats, and "
        "lengths and areas of layers",
        hint="remove this key from rom.parameters",
    )
