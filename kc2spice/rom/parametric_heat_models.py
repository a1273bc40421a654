"""Reduced heat models whose matrices depend on netlist parameters.

:mod:`kc2spice.rom.heat_model_reduction_over_ranges` computes these models.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.parametric_heat_matrix_terms import MatrixTerms
from kc2spice.rom.parametric_models import (
    ParameterAxis,
    Values,
    evaluate_polynomials,
    require_values_in_ranges,
)
from kc2spice.rom.range_reduction import ModelOverRanges


@dataclass(frozen=True, eq=False, kw_only=True)
class HeatOverRanges(ModelOverRanges):
    """Heat model over parameter ranges: ``E(p) dx/dt + K(p) x = B q``, ``T = B^T x``.

    ``terms`` are the terms of the reduced matrices E and K. The model has characteristic values,
    such as a thermal resistance, that depend on the parameters. A polynomial of the parameters
    approximates the logarithm of each characteristic value. ``facts`` contains the coefficients of
    the polynomials, and ``exponents`` the common exponents of all polynomials.
    """

    terms: MatrixTerms
    B: np.ndarray
    exponents: np.ndarray
    facts: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def order(self) -> int:
        """Order n of the model: the number of its unknowns, which are also its states."""
        return len(self.B)

    @property
    def parameter_axes(self) -> dict[str, ParameterAxis]:
        """Axes of the parameters, each with its range, keyed by the name of the parameter."""
        return {axis.name: axis for axis in self.terms.axes}

    def evaluate(self, values: Values) -> LinearModel:
        """Return the model for values of all parameters."""
        require_values_in_ranges(self.terms.axes, values)
        x = np.array([[axis.compute_coordinate(values[axis.name]) for axis in self.terms.axes]])
        products = evaluate_polynomials(x, self.exponents)[0]
        return LinearModel(
            **self.terms.evaluate_matrices(values),
            B=self.B,
            ports=self.ports,
            certificate=self.certificate,
            facts={name: float(f"{np.exp(products @ c):.10g}") for name, c in self.facts.items()},
            name=self.name,
        )
