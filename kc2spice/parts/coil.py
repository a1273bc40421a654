"""The catch actuator with real coils: inductance and back-EMF from the table of the force.

Use :mod:`kc2spice.parts.electromagnet` where ideal sources drive the coils.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kc2spice.fem.magnetics.table import EMTable, inductances
from kc2spice.parts.electromagnet import COEFFICIENTS, PINS, POINTS, coil_resistances, smooth
from kc2spice.spice.circuit import Subcircuit
from kc2spice.spice.header import Header, parameter_list, part_header
from kc2spice.spice.render import render

_MEANING = {
    "c0": "N", "c1": "N/A and V s/m", "c2": "N/A and V s/m",
    "c11": "N/A^2", "c12": "N/A^2", "c22": "N/A^2",
}  # fmt: skip


@dataclass(frozen=True)
class _Coil:
    k: int
    name: str
    plus: str
    minus: str
    own: float  # mean of henry times the inverse of L on the diagonal


@dataclass(frozen=True)
class _Function:
    """A function of the height on its own node, so that force and back-EMF share it."""

    name: str
    doc: str
    values: list[str]
    bends: list[str]


def coil_subcircuit(
    header: Header, table: EMTable, *, points: int = POINTS, name: str = "coil"
) -> Subcircuit:
    """Two coils ``lp ln`` and ``up un`` with ``v = R i + d(lambda)/dt`` and the sphere's force.

    The state of coil k is its inductive flux linkage ``psi_k = sum_l L_kl(y) i_l`` on a capacitor;
    the magnets' part of the flux enters as ``c_k(y) v`` with the force's own coefficient, which
    closes the energy balance whatever the lookup's error. Pins as those of the ideal catch.
    """
    params = coil_resistances(table)
    height = np.linspace(table.y[0], table.y[-1], points)
    henry = float(np.mean(table.inductance[:, (0, 1), (0, 1)]))
    inverse = henry * np.linalg.inv(inductances(table, height))
    splines = dict(zip(COEFFICIENTS, table.splines(height).T, strict=True))
    functions = [_Function(n, f"{n}(y): {_MEANING[n]}", *smooth(splines[n])) for n in COEFFICIENTS]
    usual = inverse.mean(axis=0)
    functions += [
        _Function(f"g{k}{l}", f"g{k}{l}(y): {henry:.6g} H times the inverse of L, less its mean",
                  *smooth((inverse - usual)[:, k - 1, l - 1]))
        for k, l in ((1, 1), (1, 2), (2, 2))
    ]  # fmt: skip
    text = render(
        "coil.j2",
        header=part_header(header, f"{name}: catch actuator with real coils", PINS, params),
        name=name,
        pins=[pin.name for pin in PINS],
        parameters=parameter_list(params),
        points=points,
        lowest=1e6 * height[0],
        spacing=1e6 * (height[1] - height[0]),
        henry=henry,
        coils=[
            _Coil(1, "lower", "lp", "ln", usual[0, 0]),
            _Coil(2, "upper", "up", "un", usual[1, 1]),
        ],
        mutual=usual[0, 1],
        functions=functions,
    )
    return Subcircuit(name, PINS, params, text)
