"""Force and flux of the catch actuator as functions of the sphere's position."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kc2spice.core.magnets import Coenergy, products
from kc2spice.core.piecewise import Piecewise, cubic_spline

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
    def coefficients(self) -> np.ndarray:
        """The force's coefficients (n, 6) in the order of :data:`FORCE`."""
        return np.column_stack([getattr(self, name) for name in FORCE])

    @cached_property
    def splines(self) -> Piecewise:
        """Not-a-knot cubic splines of the six coefficients (..., 6) through the nodes.

        They keep the FE's accuracy between 41 nodes; other end conditions and monotone
        interpolants do not.
        """
        return cubic_spline(self.y, self.coefficients)

    @cached_property
    def coenergy(self) -> Coenergy:
        """Integrals over y of the splines.

        Integrating the force keeps force and flux consistent exactly and smooths, where a
        differentiated flux would lose an order; the free constants put the mean over the nodes on
        the FE fluxes.
        """
        integrals = self.splines.integral()
        half = self.inductance / 2
        nodes = np.column_stack(
            [self.flux0, half[:, 0, 0], self.inductance[:, 0, 1], half[:, 1, 1]],
        )
        offset = np.mean(nodes - integrals(self.y)[:, 1:], axis=0)
        return Coenergy(integrals.raised(np.concatenate([[0.0], offset])))

    @cached_property
    def facts(self) -> dict[str, float]:
        """The numbers by which an engineer knows the actuator: the force is the largest of the nine
        pairs of -0.1, 0 and 0.1 A in the coils."""
        steps = (-0.1, 0.0, 0.1)
        forces = em_cases(self, np.array([(i1, i2) for i1 in steps for i2 in steps]))
        return {
            "unknowns": self.unknowns,
            "force_max_n": float(abs(forces).max()),
            "coil_resistance_ohm": float(self.resistance[0]),
            "coil_inductance_h": float(self.inductance[:, 0, 0].mean()),
            "coil_mutual_h": float(self.inductance[:, 0, 1].mean()),
        }


def em_cases(table: EMTable, currents: np.ndarray) -> np.ndarray:
    """Force (m, n) [N] at the nodes for ``currents`` (m, 2): the curves of the paper's Fig. 6."""
    return np.array([products(i1, i2) @ table.coefficients.T for i1, i2 in currents])
