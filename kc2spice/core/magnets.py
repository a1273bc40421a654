"""Magnetic coenergy of two coils and a moving magnet.

The coenergy depends on the height of the magnet and on both coil currents. The splines of the
coenergy use only numpy. An import of scipy's splines would dominate the start time of runs with
cached models.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import SimulationError
from kc2spice.core.mesh_error_descriptions import MESH_ERROR_PREFIX


@dataclass(frozen=True, eq=False)
class PiecewisePolynomial(EqualByContent):
    """Piecewise polynomials of one variable, with common knots for several functions.

    In cell j, the polynomials are ``p(x) = sum_k c[k, j] (x - knots[j])^k``. The n ``knots`` are in
    ascending order. The array ``c`` has the shape (degree + 1, n - 1, m) and contains the
    coefficients of m functions. Outside of the knots, the polynomial of the first or last cell is
    valid.
    """

    knots: np.ndarray
    c: np.ndarray

    def __call__(self, x: np.ndarray | float) -> np.ndarray:
        """Return the values of the m functions at ``x``, along an additional last axis."""
        x = np.asarray(x, dtype=float)
        cell = np.searchsorted(self.knots[1:-1], x, side="right")
        step = (x - self.knots[cell])[..., None]
        value = self.c[-1, cell]
        for power in self.c[-2::-1]:
            value = value * step + power[cell]
        return value

    def integral(self) -> PiecewisePolynomial:
        """Return the integral of the polynomials from the first knot to each position."""
        power = np.arange(1, self.c.shape[0] + 1)[:, None, None]
        rising = self.c / power
        cells = np.sum(rising * np.diff(self.knots)[:, None] ** power, axis=0)
        start = np.cumsum(cells, axis=0) - cells
        return PiecewisePolynomial(self.knots, np.concatenate([start[None], rising]))

    def derivative(self) -> PiecewisePolynomial:
        """Return the derivative of the piecewise polynomials.

        If the derivative jumps at a knot, the cell above the knot determines the value.
        """
        return PiecewisePolynomial(
            self.knots, self.c[1:] * np.arange(1, self.c.shape[0])[:, None, None]
        )

    def add_constant(self, by: np.ndarray) -> PiecewisePolynomial:
        """Return the piecewise polynomials with a separate constant added to each one.

        The constant of function k is ``by[k]``.
        """
        return PiecewisePolynomial(self.knots, np.concatenate([self.c[:1] + by, self.c[1:]]))


def interpolate_by_splines(x: np.ndarray, values: np.ndarray) -> PiecewisePolynomial:
    """Interpolate the values of m functions at n points by not-a-knot cubic splines.

    ``values`` is an array of shape (n, m). ``x`` contains the n points in ascending order. Two
    points give a straight line, and three points a parabola.

    The unknowns are the second derivatives s at the points. With ``h = diff(x)`` and ``d =
    diff(values) / h``, the first derivative is continuous at the points if ::

        h[j-1] s[j-1] + 2 (h[j-1] + h[j]) s[j] + h[j] s[j+1] = 6 (d[j] - d[j-1])

    The first two cells have the same cubic polynomial, so ``diff(s) / h`` is equal in both cells.
    The same condition applies to the last two cells (de Boor, A Practical Guide to Splines, ch.
    IV).
    """
    n, h = x.size, np.diff(x)
    d = np.diff(values, axis=0) / h[:, None]
    matrix, right = np.eye(n), np.zeros_like(values)
    inner = np.arange(1, n - 1)
    matrix[inner, inner - 1] = h[:-1]
    matrix[inner, inner] = 2 * (h[:-1] + h[1:])
    matrix[inner, inner + 1] = h[1:]
    right[1:-1] = 6 * np.diff(d, axis=0)
    if n == 3:
        matrix[[0, 2], 1] = -1.0
    for row, first in ((0, 0), (n - 1, n - 3)) if n > 3 else ():
        a, b = h[first : first + 2]
        matrix[row, first : first + 3] = b, -(a + b), a
    s = np.linalg.solve(matrix, right)
    h = h[:, None]
    slope = d - h * (2 * s[:-1] + s[1:]) / 6
    return PiecewisePolynomial(
        x, np.stack([values[:-1], slope, s[:-1] / 2, np.diff(s, axis=0) / (6 * h)])
    )


# nine pairs of currents [A] in the two coils, for which forces are computed
TEST_CURRENTS = np.array(list(product((-0.1, 0.0, 0.1), repeat=2)))
# largest difference between heights that count as equal, relative to the height range of the table
HEIGHT_TOLERANCE = 1e-6
# Order of convergence of the force with decreasing size of quadratic triangles.
# The order of convergence is 4 for smooth fields. The corners of magnets and coils reduce this
# order. The test tests/physics/test_mesh_statements.py compares estimated mesh errors with true
# errors.
FORCE_CONVERGENCE_ORDER = 3


# Exponents of the two currents in each term of the force, for linear magnetic materials.
CURRENT_EXPONENTS = {
    "c0": (0, 0),
    "c1": (1, 0),
    "c2": (0, 1),
    "c11": (2, 0),
    "c12": (1, 1),
    "c22": (0, 2),
}
FORCE_COEFFICIENTS = tuple(CURRENT_EXPONENTS)


def compute_current_products(i1: Any, i2: Any) -> np.ndarray:
    """Return the six products ``i1^a i2^b`` of the coil currents, along a new axis."""
    i1, i2 = np.broadcast_arrays(np.asarray(i1, dtype=float), i2)
    return np.stack([i1**a * i2**b for a, b in CURRENT_EXPONENTS.values()], axis=-1)


@dataclass(frozen=True)
class Coenergy:
    """Magnetic coenergy [J] as a function of sphere height and coil currents.

    The coenergy is ``W(y, i) = p(y) . products(i)`` at the height y for the currents i.
    ``products(i)`` are the six products ``i1^a i2^b`` of the currents, with the exponents a and b
    in :data:`CURRENT_EXPONENTS`. The derivative of W with respect to the height y [m] is the force
    [N]. The derivatives of W with respect to the currents i [A] are the flux linkages [Wb].
    """

    terms: PiecewisePolynomial  # coefficients p, shape (..., 6)

    @cached_property
    def coefficient_derivatives(
        self,
    ) -> tuple[PiecewisePolynomial, PiecewisePolynomial, PiecewisePolynomial]:
        """Coefficients of the coenergy, and their first and second derivatives by height."""
        first = self.terms.derivative()
        return self.terms, first, first.derivative()

    def require_height(self, y: Any, where: str) -> np.ndarray:
        """Return the height of the sphere; raise an error if it is outside of the table.

        Raises
        ------
        SimulationError : a height is outside of the range of the table.
        """
        y, (low, high) = np.asarray(y, dtype=float), self.terms.knots[[0, -1]]
        outside = ~((y >= low) & (y <= high))
        if np.any(outside):
            raise SimulationError(
                "the height of the sphere is outside of the force table",
                where=where,
                got=f"y = {float(y[outside].flat[0]):g} m",
                expected=f"{low:g} to {high:g} m",
                hint="lower y_min and raise y_max, or check gains and polarity of the controller",
            )
        return y

    def force(self, y: Any, i1: Any, i2: Any) -> np.ndarray:
        """Compute the magnetic force [N] on a sphere at a height, for two coil currents."""
        slopes = self.coefficient_derivatives[1](self.require_height(y, "catch"))
        return np.asarray((slopes * compute_current_products(i1, i2)).sum(axis=-1))

    def compute_inductances(self, y: Any) -> np.ndarray:
        """Return the symmetric inductance matrix [H] of the two coils.

        The height ``y`` [m] of the sphere's centre is measured from the surface on which the sphere
        rests. The inductance matrix has the shape (..., 2, 2).
        """
        return _compute_current_hessian(self.terms(self.require_height(y, "catch")))


def _compute_current_hessian(p: np.ndarray) -> np.ndarray:
    """Compute the second derivatives of the coenergy with respect to the currents.

    The returned array has the shape (..., 2, 2).
    """
    return np.stack([2 * p[..., 3], p[..., 4], p[..., 4], 2 * p[..., 5]], -1).reshape(
        *p.shape[:-1], 2, 2
    )


@dataclass(frozen=True, eq=False)
class MagnetostaticTable(EqualByContent):
    """Table of magnetostatic finite-element solutions at several heights of a sphere.

    The formulas for force and flux as functions of the currents are exact, because the materials
    are linear.

    With the currents ``i1`` (lower coil) and ``i2`` (upper coil) at the height ``y``::

        F(y, i1, i2) = c0 + c1 i1 + c2 i2 + c11 i1^2 + c12 i1 i2 + c22 i2^2
        lambda_k(y, i1, i2) = flux0[:, k] + sum_l inductance[:, k, l] i_l

    ``y``, an array of shape (n,), is the height [m] of the sphere's centre above the top of the
    kick actuator. The table contains forces in N, flux linkages in Wb, inductances in H and coil
    resistances in Ohm. A positive current gives
    B_y > 0 on the axis. The magnetic moment of the sphere points to +y.
    """

    def scale_magnets(self, remanence: float, shift: float) -> MagnetostaticTable:
        """Scale the magnetostatic table to magnets with a changed remanence and height.

        The remanence is multiplied by the factor ``remanence``, and the magnets are ``shift`` [m]
        higher. In linear materials, the force between the magnets is proportional to the square of
        the remanence. The force terms that are linear in a coil current are proportional to the
        remanence. The force terms that are quadratic in the coil currents do not depend on the
        remanence.
        """
        magnets = remanence ** np.array([2, 1, 1, 0, 0, 0])
        coarser = None if self.coarser is None else self.coarser.scale_magnets(remanence, shift)
        return replace(
            self,
            y=self.y + shift,
            coefficients=magnets * self.coefficients,
            flux0=remanence * self.flux0,
            coarser=coarser,
        )

    y: np.ndarray
    coefficients: np.ndarray  # (n, 6), named in :data:`FORCE_COEFFICIENTS`
    flux0: np.ndarray  # (n, 2)
    inductance: np.ndarray  # (n, 2, 2)
    resistance: np.ndarray  # (2,)
    unknowns: int
    # table for some of the heights, computed on a mesh with elements of twice the size
    coarser: MagnetostaticTable | None = None

    @cached_property
    def splines(self) -> PiecewisePolynomial:
        """Cubic splines (not-a-knot) of the six force coefficients over the height.

        With 41 heights, the splines are as accurate as the finite elements. Splines with other end
        conditions, and monotone interpolants, are less accurate.
        """
        return interpolate_by_splines(self.y, self.coefficients)

    @cached_property
    def coenergy(self) -> Coenergy:
        """Coenergy of the actuator, computed as the integral of the force over the height.

        As a result, the force is exactly the derivative of the coenergy. The force is not computed
        as the derivative of a flux spline, because this derivative has a lower order of accuracy.
        The integration constants make the mean flux over all heights equal to the mean flux of the
        finite-element solutions.
        """
        integrals = self.splines.integral()
        half = self.inductance / 2
        nodes = np.column_stack(
            [self.flux0, half[:, 0, 0], self.inductance[:, 0, 1], half[:, 1, 1]],
        )
        offset = np.mean(nodes - integrals(self.y)[:, 1:], axis=0)
        return Coenergy(integrals.add_constant(np.concatenate([[0.0], offset])))

    @cached_property
    def facts(self) -> dict[str, float]:
        """Values for reports, such as largest force and coil inductance, keyed by name.

        The force is the largest force for nine pairs of coil currents, each -0.1, 0 or 0.1 A.
        """
        forces = compute_test_forces(self, TEST_CURRENTS)
        return self.mesh_errors | {
            "unknowns": self.unknowns,
            "force_max_n": float(abs(forces).max()),
            "coil_resistance_ohm": float(self.resistance[0]),
            "coil_inductance_h": float(self.inductance[:, 0, 0].mean()),
            "coil_mutual_h": float(self.inductance[:, 0, 1].mean()),
        }

    @cached_property
    def mesh_errors(self) -> dict[str, float]:
        """Estimated relative mesh errors of force and inductance, keyed by name.

        The error of f is ``|f(2 h) - f(h)| / (2^p - 1)``; h is the element size, and p = 3 is the
        order of convergence. Errors of forces are relative to the largest force for
        :data:`TEST_CURRENTS`. Errors of inductances are relative to the largest inductance.
        """
        if self.coarser is None:
            return {}
        rows = np.searchsorted(self.y, self.coarser.y - HEIGHT_TOLERANCE * np.ptp(self.y))
        force = compute_test_forces(self, TEST_CURRENTS)
        pairs = {
            "force": (force, compute_test_forces(self.coarser, TEST_CURRENTS) - force[:, rows]),
            "inductance": (self.inductance, self.coarser.inductance - self.inductance[rows]),
        }
        return {
            f"{MESH_ERROR_PREFIX}{name}": float(
                abs(apart).max() / abs(fine).max() / (2**FORCE_CONVERGENCE_ORDER - 1)
            )
            for name, (fine, apart) in pairs.items()
            if fine.any()
        }


def compute_test_forces(table: MagnetostaticTable, currents: np.ndarray) -> np.ndarray:
    """Compute forces [N] at all heights of a force table for pairs of test currents.

    The argument ``currents`` has the shape (m, 2), and the result has the shape (m, n). The curves
    are comparable with Fig. 6 of Schütz et al. (2021).
    """
    return np.array(
        [compute_current_products(i1, i2) @ table.coefficients.T for i1, i2 in currents]
    )
