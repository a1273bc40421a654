"""The catch actuator: force on the sphere from six functions of its height (paper 2.2.1, 2.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from kc2spice.fem.emtable import EMTable
from kc2spice.netlist.cards import number
from kc2spice.netlist.circuit import Param, Pin, Subcircuit
from kc2spice.netlist.header import Header, parameter_list, part_header
from kc2spice.netlist.render import render

POINTS = 401  # of each lookup: 7e-5 of the largest force between them
NEGLIGIBLE = 1e-6  # share of the largest force below which a coefficient is left out
# Coefficient, its factor in the force as text and as a function of the two currents.
TERMS = (
    ("c0", "", "1", lambda i1, i2: 1.0),
    ("c1", "V(i1)*", "i1", lambda i1, i2: i1),
    ("c2", "V(i2)*", "i2", lambda i1, i2: i2),
    ("c11", "V(i1)*V(i1)*", "i1^2", lambda i1, i2: i1 * i1),
    ("c12", "V(i1)*V(i2)*", "i1 i2", lambda i1, i2: i1 * i2),
    ("c22", "V(i2)*V(i2)*", "i2^2", lambda i1, i2: i2 * i2),
)  # fmt: skip


@dataclass(frozen=True)
class _Coefficient:
    name: str
    factor: str
    label: str
    table: list[str]


def electromagnetic_force(
    table: EMTable, y: np.ndarray, i1: np.ndarray, i2: np.ndarray
) -> np.ndarray:
    """Force [N] on the sphere, ``c0 + c1 i1 + c2 i2 + c11 i1^2 + c12 i1 i2 + c22 i2^2``.

    The coefficients are not-a-knot cubic splines of ``y`` [m], constant beyond the table's ends.
    """
    inside = np.clip(y, table.y[0], table.y[-1])
    return sum(
        CubicSpline(table.y, getattr(table, name))(inside) * factor(i1, i2)
        for name, _, _, factor in TERMS
    )


def significant(table: EMTable, current: float) -> list[str]:
    """Names of the coefficients that matter up to ``current`` [A], in the order of ``TERMS``."""
    share = {
        name: np.max(np.abs(getattr(table, name))) * abs(factor(current, current))
        for name, _, _, factor in TERMS
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
    pins = (
        Pin("lp", "V", "A"), Pin("ln", "V", "A"), Pin("up", "V", "A"), Pin("un", "V", "A"),
        Pin("y", "um", "-"), Pin("v", "m/s", "N"), Pin("base", "um", "N"),
    )  # fmt: skip
    params = (
        Param("resistance_lower", float(table.resistance[0]), "Ohm", "of the lower coil"),
        Param("resistance_upper", float(table.resistance[1]), "Ohm", "of the upper coil"),
    )
    kept = significant(table, current)
    height = np.linspace(table.y[0], table.y[-1], points)
    text = render(
        "catch.j2",
        header=part_header(header, f"{name}: electromagnetic catch actuator", pins, params),
        name=name,
        pins=[pin.name for pin in pins],
        parameters=parameter_list(params),
        points=points,
        law=" + ".join(f"{n}(y) {i}" if i != "1" else f"{n}(y)" for n, _, i, _ in TERMS),
        notes=[
            f"{n} is left out: it never reaches {NEGLIGIBLE:g} of the largest force"
            for n, _, _, _ in TERMS
            if n not in kept
        ],
        coefficients=[
            _Coefficient(
                n, factor, f"{n}(y): N over um", _lookup(table.y, getattr(table, n), height)
            )
            for n, factor, _, _ in TERMS
            if n in kept
        ],
    )
    return Subcircuit(name, pins, params, text)


def _lookup(y: np.ndarray, values: np.ndarray, height: np.ndarray) -> list[str]:
    """Lines of a ``pwl()`` table of the not-a-knot spline, in um, flat beyond both ends.

    ngspice extrapolates the outer segments, so each end gets a second point of equal value.
    """
    resampled = CubicSpline(y, values)(height)
    step = height[1] - height[0]
    x = 1e6 * np.concatenate([[height[0] - step], height, [height[-1] + step]])
    f = np.concatenate([resampled[:1], resampled, resampled[-1:]])
    lines = [f"{number(a)}, {number(b)}," for a, b in zip(x, f, strict=True)]
    lines[-1] = lines[-1].rstrip(",") + ")"
    return lines
