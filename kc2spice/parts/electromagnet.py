"""The catch actuator: force on the sphere from six functions of its height (paper 2.2.1, 2.4).

The law itself, in numpy, is :func:`kc2spice.fem.magnetics.table.force`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kc2spice.fem.magnetics.table import EMTable
from kc2spice.spice.cards import number
from kc2spice.spice.circuit import Param, Pin, Subcircuit
from kc2spice.spice.header import Header, parameter_list, part_header
from kc2spice.spice.render import render

POINTS = 201  # of each lookup: 6e-6 of the largest force between them
NEGLIGIBLE = 1e-6  # share of the largest force below which a coefficient is left out


@dataclass(frozen=True)
class Term:
    """One summand of the force: a function of height times ``currents``.

    The function is the sum of the table's coefficients, each times its entry in ``weights``.
    """

    name: str
    currents: tuple[str, ...]
    weights: dict[str, float]

    def of(self, values: np.ndarray) -> np.ndarray:
        """The function where the table's coefficients are ``values``, (positions, 6)."""
        return np.asarray(
            sum(w * values[:, COEFFICIENTS.index(k)] for k, w in self.weights.items())
        )


COEFFICIENTS = ("c0", "c1", "c2", "c11", "c12", "c22")
SEPARATE = (
    Term("c0", (), {"c0": 1.0}),
    Term("c1", ("i1",), {"c1": 1.0}),
    Term("c2", ("i2",), {"c2": 1.0}),
    Term("c11", ("i1", "i1"), {"c11": 1.0}),
    Term("c12", ("i1", "i2"), {"c12": 1.0}),
    Term("c22", ("i2", "i2"), {"c22": 1.0}),
)
# One current i through both coils, i2 = i and i1 = -i, as the control loop wires them.
SERIES = (
    Term("c0", (), {"c0": 1.0}),
    Term("d1", ("i",), {"c2": 1.0, "c1": -1.0}),
    Term("d2", ("i", "i"), {"c11": 1.0, "c12": -1.0, "c22": 1.0}),
)

PLACE = (Pin("y", "um", "-"), Pin("v", "m/s", "N"), Pin("base", "um", "N"))
PINS = (
    Pin("lp", "V", "A"), Pin("ln", "V", "A"), Pin("up", "V", "A"), Pin("un", "V", "A"), *PLACE,
)  # fmt: skip
SERIES_PINS = (Pin("drive", "V", "A"), Pin("ret", "V", "A"), *PLACE)


@dataclass(frozen=True)
class _Coefficient:
    """One B source: its name, the currents in front of it, the lines of its two lookups."""

    name: str
    factor: str
    values: list[str]
    bends: list[str]


def significant(table: EMTable, current: float, terms: tuple[Term, ...]) -> list[Term]:
    """The terms that matter up to ``current`` [A], in their order."""
    values = np.column_stack([getattr(table, name) for name in COEFFICIENTS])
    share = [float(np.abs(t.of(values)).max()) * current ** len(t.currents) for t in terms]
    return [t for t, size in zip(terms, share, strict=True) if size > NEGLIGIBLE * max(share)]


def catch_subcircuit(
    header: Header,
    table: EMTable,
    current: float,
    *,
    series: bool = False,
    points: int = POINTS,
    name: str = "catch",
) -> Subcircuit:
    """The coils and the force they put on the sphere's node ``v``.

    Two coils ``lp ln`` and ``up un``, or with ``series`` both between ``drive`` and ``ret``, the
    lower one reversed: three functions of height instead of six, and the same force.

    Parameters
    ----------
    current : largest coil current [A] that the circuit drives; decides what is negligible.
    points : heights of the resampled lookups, equally spaced over the table.
    """
    params, pins = coil_resistances(table), SERIES_PINS if series else PINS
    terms = SERIES if series else SEPARATE
    kept = significant(table, current, terms)
    height = np.linspace(table.y[0], table.y[-1], points)
    values = table.splines(height)
    text = render(
        "catch.j2",
        header=part_header(header, f"{name}: electromagnetic catch actuator", pins, params),
        name=name,
        pins=[pin.name for pin in pins],
        parameters=parameter_list(params),
        series=series,
        points=points,
        lowest=1e6 * height[0],
        spacing=1e6 * (height[1] - height[0]),
        law=" + ".join(" ".join((f"{term.name}(y)", *term.currents)) for term in terms),
        left_out=[term.name for term in terms if term not in kept],
        negligible=NEGLIGIBLE,
        coefficients=[
            _Coefficient(
                term.name,
                "".join(f"V({i})*" for i in term.currents),
                *smooth(term.of(values)),
            )
            for term in kept
        ],
    )
    return Subcircuit(name, pins, params, text)


def coil_resistances(table: EMTable) -> tuple[Param, ...]:
    """The resistances of both coils, which a deck may change."""
    return (
        Param("resistance_lower", float(table.resistance[0]), "Ohm", "of the lower coil"),
        Param("resistance_upper", float(table.resistance[1]), "Ohm", "of the upper coil"),
    )


def smooth(values: np.ndarray) -> tuple[list[str], list[str]]:
    """Lines of the lookups ``f`` and ``b`` whose ``f(s) - w(s) b(s)`` has a continuous slope.

    ``s`` counts cells from the first of the equally spaced ``values``, ``b`` are half the second
    differences and ``w = t (1 - t)`` with t the place within a cell, 0 to 1: the blend of the
    parabolas through three neighbours (Overhauser 1968), exact to third order, where a polyline's
    slope jumps at every height. One more cubic value on either side keeps that up to both ends;
    beyond, the function runs level.
    """
    first, last = (np.array([4, -6, 4, -1]) @ end for end in (values[:4], values[:-5:-1]))
    f = np.concatenate([[first], values, [last]])
    bends = np.diff(f[[0, *range(f.size), -1]], 2) / 2
    return lookup(f), lookup(bends)


def lookup(values: np.ndarray) -> list[str]:
    """Lines of a ``pwl()`` table of ``values`` at -1, 0, 1, ..., flat beyond both ends.

    ngspice extrapolates the outer segments, so each end gets a second point of equal value. Five
    points share a line: ngspice reads fewer lines faster.
    """
    f = np.concatenate([values[:1], values, values[-1:]])
    points = [f"{k - 2}, {number(value)}" for k, value in enumerate(f)]
    return [", ".join(points[k : k + 5]) for k in range(0, len(points), 5)]
