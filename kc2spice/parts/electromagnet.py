"""The catch actuator: force on the sphere from six functions of its height (paper 2.2.1, 2.4).

The law itself, in numpy, is :func:`kc2spice.fem.emtable.force`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kc2spice.fem.emtable import EMTable
from kc2spice.netlist.cards import number
from kc2spice.netlist.circuit import Param, Pin, Subcircuit
from kc2spice.netlist.header import Header, parameter_list, part_header
from kc2spice.netlist.render import render

POINTS = 201  # of each lookup: 6e-6 of the largest force between them
NEGLIGIBLE = 1e-6  # share of the largest force below which a coefficient is left out
# The force is the sum of these coefficients, each times its currents.
TERMS: dict[str, tuple[str, ...]] = {
    "c0": (), "c1": ("i1",), "c2": ("i2",),
    "c11": ("i1", "i1"), "c12": ("i1", "i2"), "c22": ("i2", "i2"),
}  # fmt: skip

PINS = (
    Pin("lp", "V", "A"), Pin("ln", "V", "A"), Pin("up", "V", "A"), Pin("un", "V", "A"),
    Pin("y", "um", "-"), Pin("v", "m/s", "N"), Pin("base", "um", "N"),
)  # fmt: skip


@dataclass(frozen=True)
class _Coefficient:
    """One B source: its name, the currents in front of it, the lines of its two lookups."""

    name: str
    factor: str
    values: list[str]
    bends: list[str]


def significant(table: EMTable, current: float) -> list[str]:
    """Names of the coefficients that matter up to ``current`` [A], in the order of ``TERMS``."""
    share = {
        name: float(np.max(np.abs(getattr(table, name)))) * current ** len(currents)
        for name, currents in TERMS.items()
    }
    largest = max(share.values())
    return [name for name, value in share.items() if value > NEGLIGIBLE * largest]


def catch_subcircuit(
    header: Header, table: EMTable, current: float, *, points: int = POINTS, name: str = "catch"
) -> Subcircuit:
    """Two coils ``lp ln`` and ``up un`` and the force they put on the sphere's node ``v``.

    Parameters
    ----------
    current : largest coil current [A] that the circuit drives; decides what is negligible.
    points : heights of the resampled lookups, equally spaced over the table.
    """
    params = coil_resistances(table)
    kept = significant(table, current)
    height = np.linspace(table.y[0], table.y[-1], points)
    splines = dict(zip(TERMS, table.splines(height).T, strict=True))
    text = render(
        "catch.j2",
        header=part_header(header, f"{name}: electromagnetic catch actuator", PINS, params),
        name=name,
        pins=[pin.name for pin in PINS],
        parameters=parameter_list(params),
        points=points,
        lowest=1e6 * height[0],
        spacing=1e6 * (height[1] - height[0]),
        law=" + ".join(" ".join((f"{name}(y)", *i)) for name, i in TERMS.items()),
        left_out=[name for name in TERMS if name not in kept],
        negligible=NEGLIGIBLE,
        coefficients=[
            _Coefficient(n, "".join(f"V({i})*" for i in TERMS[n]), *smooth(height, splines[n]))
            for n in kept
        ],
    )
    return Subcircuit(name, PINS, params, text)


def coil_resistances(table: EMTable) -> tuple[Param, ...]:
    """The resistances of both coils, which a deck may change."""
    return (
        Param("resistance_lower", float(table.resistance[0]), "Ohm", "of the lower coil"),
        Param("resistance_upper", float(table.resistance[1]), "Ohm", "of the upper coil"),
    )


def smooth(height: np.ndarray, values: np.ndarray) -> tuple[list[str], list[str]]:
    """Lines of the lookups ``f`` and ``b`` whose ``f(y) - w(y) b(y)`` has a continuous slope.

    ``b`` are the second differences of the values and ``w = t (1 - t) / 2`` with t the place
    within a cell, 0 to 1: the blend of the parabolas through three neighbours (Overhauser 1968),
    exact to third order, where a polyline's slope jumps at every height. One more cubic value on
    either side keeps that up to both ends; beyond, the function runs level.
    """
    step = height[1] - height[0]
    first, last = (np.array([4, -6, 4, -1]) @ end for end in (values[:4], values[:-5:-1]))
    f = np.concatenate([[first], values, [last]])
    x = np.concatenate([[height[0] - step], height, [height[-1] + step]])
    bends = np.diff(f[[0, *range(f.size), -1]], 2)
    return lookup(x, f), lookup(x, bends)


def lookup(height: np.ndarray, values: np.ndarray) -> list[str]:
    """Lines of a ``pwl()`` table over um, flat beyond both ends.

    ngspice extrapolates the outer segments, so each end gets a second point of equal value.
    """
    step = height[1] - height[0]
    x = 1e6 * np.concatenate([[height[0] - step], height, [height[-1] + step]])
    f = np.concatenate([values[:1], values, values[-1:]])
    return [f"{number(a)}, {number(b)}" for a, b in zip(x, f, strict=True)]
