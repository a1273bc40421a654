"""Flux linkages as netlist states, for coils in the field of a moving body.

The coenergy of a declaration must be a quadratic function of the currents ``i``. The voltages of
the coils are ::

    v_k = dR/di_k + d(psi_k)/dt + phi_k'(x) x_rate,     psi_k = sum_l L_kl(x) i_l

Here ``R`` is the function of the currents whose derivative ``dR/di_k`` is the loss voltage of coil
k. ``psi_k`` is the flux linkage that the currents cause, which is a state of the netlist. ``phi_k``
is the flux linkage at zero current. The inductance matrix ``L`` is the second derivative of the
coenergy with respect to the currents. ``phi_k`` and ``L`` are functions of the displacements ``x``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.core.naming import list_names
from kc2spice.netlist.expression import Name, Tree, substitute_names
from kc2spice.physics.declaration import Branch, Declaration
from kc2spice.physics.lookup_tables import Lookups, has_tables
from kc2spice.physics.symbolic_algebra import (
    ZERO,
    add_trees,
    differentiate_tree,
    find_names,
    multiply_trees,
)


@dataclass(frozen=True)
class FluxLinkages:
    """Flux linkages of the current branches of a declaration."""

    declaration: Declaration
    branches: tuple[Branch, ...]

    @cached_property
    def inductances(self) -> tuple[tuple[Tree, ...], ...]:
        """Expressions of the inductance matrix [H], with one row for each branch.

        Raises
        ------
        UsageError : an inductance depends on a current.
        """
        flux, currents = (
            map(self.declaration.derive_stored_quantity, self.branches),
            self.current_names,
        )
        rows = [tuple(differentiate_tree(tree, name) for name in currents) for tree in flux]
        for tree in chain.from_iterable(rows):
            if saturating := sorted(find_names(tree).intersection(currents)):
                raise UsageError(
                    "a flux linkage uses a table of values, so inductances must not depend on a "
                    "current",
                    where=self.declaration.name,
                    got=f"an inductance that depends on {', '.join(saturating)}",
                    expected="inductances that do not depend on a current",
                )
        return tuple(rows)

    @property
    def current_names(self) -> list[str]:
        """Names of the currents in the order of the branches."""
        return list_names(self.branches)

    @cached_property
    def motion_voltages(self) -> tuple[Tree, ...]:
        """Expressions of the voltages [V] that motion induces at zero current."""
        still = dict.fromkeys(self.current_names, ZERO)
        result = []
        for branch in self.branches:
            flux = add_trees(
                substitute_names(self.declaration.derive_stored_quantity(branch), still)
            )
            moving = self.declaration.displacement_branches
            result.append(
                add_trees(
                    *(
                        multiply_trees(differentiate_tree(flux, b.name), Name(b.rate))
                        for b in moving
                    )
                )
            )
        return tuple(result)

    def invert_inductances(self, lookups: Lookups) -> tuple[float, np.ndarray]:
        """Return the mean self-inductance [H], and scaled inverse inductance matrices.

        At each point of the lookups, the array (points, n, n) contains the inverse inductance
        matrix, multiplied by the mean self-inductance.
        """
        rows = [
            [lookups.evaluate_at_table_points(tree) for tree in row] for row in self.inductances
        ]
        matrix = np.moveaxis(np.array(rows), 2, 0)
        mean = float(np.mean(np.diagonal(matrix, axis1=1, axis2=2)))
        return mean, mean * np.linalg.inv(matrix)


def find_flux_linkages(declaration: Declaration) -> FluxLinkages | None:
    """Return the flux linkages of a declaration.

    Return None if no flux linkage contains a table.
    """
    branches = tuple(b for b in declaration.acting_branches if b.is_flow)
    result = FluxLinkages(declaration, branches)
    for branch in branches:
        flux = declaration.derive_stored_quantity(branch)
        if has_tables(flux, declaration.tables):
            return result
    return None
