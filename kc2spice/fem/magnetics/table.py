"""Force and flux of the catch actuator as functions of the sphere's position."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.fem.magnetics.cubics import Piecewise, cubic_spline

FORCE = ("c0", "c1", "c2", "c11", "c12", "c22")


@dataclass(frozen=True)
class EMTable:
    """Result of the magnetostatic FE sweep; exact in the currents because materials are linear.

    With the currents ``i1`` (lower coil) and ``i2`` (upper coil) at position ``y``::

        F(y, i1, i2) = c0 + c1 i1 + c2 i2 + c11 i1^2 + c12 i1 i2 + c22 i2^2
        lambda_k(y, i1, i2) = flux0[:, k] + sum_l inductance[:, k, l] i_l

    ``y`` (n,) is the height of the sphere's centre above the kick actuator's top [m], forces in
    N, flux linkages in Wb, inductances in H, coil resistances in Ohm. A positive current gives
    B_y > 0 on the axis; the sphere's moment points to +y.
    """

    y: np.ndarray
    c0: np.ndarray
    c1: np.ndarray
    c2: np.ndarray
    c11: np.ndarray
    c12: np.ndarray
    c22: np.ndarray
    flux0: np.ndarray  # (n, 2)
    inductance: np.ndarray  # (n, 2, 2)
    resistance: np.ndarray  # (2,)
    unknowns: int

    @cached_property
    def splines(self) -> Piecewise:
        """Not-a-knot cubic splines of the six coefficients (..., 6) through the nodes.

        They keep the FE's accuracy between 41 nodes; other end conditions and monotone
        interpolants do not.
        """
        values = np.column_stack([getattr(self, name) for name in FORCE])
        return cubic_spline(self.y, values)

    @cached_property
    def potentials(self) -> Piecewise:
        """Integrals over y (..., 6) of the splines: U0, flux_1, flux_2, L11/2, L12, L22/2.

        Coenergy is ``U0 + flux_1 i1 + flux_2 i2 + L11 i1^2 / 2 + L12 i1 i2 + L22 i2^2 / 2``; its
        slope in y is the force, its slopes in the currents are the flux linkages. Integrating the
        force keeps both consistent exactly and smooths, where a differentiated flux would lose an
        order; the free constants put the mean over the nodes on the FE fluxes.
        """
        potentials = self.splines.integral()
        half = self.inductance / 2
        nodes = np.column_stack(
            [self.flux0, half[:, 0, 0], self.inductance[:, 0, 1], half[:, 1, 1]],
        )
        offset = np.mean(nodes - potentials(self.y)[:, 1:], axis=0)
        return potentials.raised(np.concatenate([[0.0], offset]))

    @cached_property
    def facts(self) -> dict[str, float]:
        """The numbers by which an engineer knows the actuator."""
        return {
            "unknowns": self.unknowns,
            "force_max_n": float(abs(em_cases(self, current_pairs())).max()),
            "coil_resistance_ohm": float(self.resistance[0]),
            "coil_inductance_h": float(self.inductance[:, 0, 0].mean()),
            "coil_mutual_h": float(self.inductance[:, 0, 1].mean()),
        }


def coefficients(table: EMTable, y: np.ndarray | float) -> np.ndarray:
    """``c0 c1 c2 c11 c12 c22`` (..., 6) at the heights ``y`` [m].

    Raises
    ------
    SimulationError : a height outside the table.
    """
    return table.splines(_inside(table, y))


def force(
    table: EMTable, y: np.ndarray | float, i1: np.ndarray | float, i2: np.ndarray | float
) -> np.ndarray:
    """Force on the sphere [N] at heights ``y`` [m] and coil currents [A]; arguments broadcast."""
    return _quadratic(np.moveaxis(coefficients(table, y), -1, 0), i1, i2)


def inductances(table: EMTable, y: np.ndarray | float) -> np.ndarray:
    """Symmetric L (..., 2, 2) [H] at the heights ``y`` [m], consistent with :func:`force`."""
    *_, l11, l12, l22 = np.moveaxis(table.potentials(_inside(table, y)), -1, 0)
    return np.stack([np.stack([2 * l11, l12], -1), np.stack([l12, 2 * l22], -1)], -1)


def em_cases(table: EMTable, currents: np.ndarray) -> np.ndarray:
    """Force (m, n) [N] at the nodes for ``currents`` (m, 2): the curves of the paper's Fig. 6."""
    nodes = np.array([getattr(table, name) for name in FORCE])
    return np.array([_quadratic(nodes, i1, i2) for i1, i2 in currents])


def current_pairs(limit: float = 0.1) -> np.ndarray:
    """The nine pairs (9, 2) of -limit, 0 and +limit [A] of the paper's section 2.2.1."""
    steps = (-limit, 0.0, limit)
    return np.array([(i1, i2) for i1 in steps for i2 in steps])


def _inside(table: EMTable, y: np.ndarray | float) -> np.ndarray:
    y = np.asarray(y, dtype=float)
    outside = ~((y >= table.y[0]) & (y <= table.y[-1]))
    if np.any(outside):
        raise SimulationError(
            "the sphere is outside the table of forces",
            where="catch",
            got=f"{float(y[outside].flat[0]):g} m",
            expected=f"{table.y[0]:g} m to {table.y[-1]:g} m",
            hint="widen catch.y_min, catch.y_max",
        )
    return y


def _quadratic(c: np.ndarray, i1: np.ndarray | float, i2: np.ndarray | float) -> np.ndarray:
    i1, i2 = np.asarray(i1), np.asarray(i2)
    return c[0] + c[1] * i1 + c[2] * i2 + c[3] * i1**2 + c[4] * i1 * i2 + c[5] * i2**2
