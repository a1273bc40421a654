"""Declarations and laws of two coils around a moving magnet.

The field of fixed magnets is included. The coenergy is a function of the height of the moving
magnet and of both coil currents. Because the magnetic materials are linear, the coenergy at each
height is a quadratic polynomial of the currents. The derivatives of the coenergy are the force and
the flux linkages.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, lru_cache, partial
from typing import Any

import numpy as np

from kc2spice.core.magnets import (
    CURRENT_EXPONENTS,
    Coenergy,
    MagnetostaticTable,
    PiecewisePolynomial,
)
from kc2spice.core.quantities import Section
from kc2spice.netlist.circuit import Param
from kc2spice.netlist.expression import ExpressionWriter, substitute_names
from kc2spice.physics.declaration import (
    HEAT_BRANCH,
    Branch,
    Declaration,
    current,
    displacement,
    measured,
    voltage,
    write_resistance_ratio,
)
from kc2spice.physics.law import DeclaredLaw
from kc2spice.physics.lookup_tables import TableFunction
from kc2spice.physics.symbolic_algebra import (
    SLOPE_SUFFIX,
    ZERO,
    differentiate_tree,
    parse_simplified,
    subtract_trees,
)

# names of the tables: coefficients of the coenergy versus height
_TABLE_NAMES = tuple(map("w{}".format, range(len(CURRENT_EXPONENTS))))
_TABLE_UNITS = ("J", "Wb", "Wb", "H", "H", "H")
_COIL_RESISTANCES = ("resistance_lower", "resistance_upper")
_HEIGHT_PARAMETERS = ("raised", "y_min", "y_max")
_TABLE_SUFFIXES = ("", SLOPE_SUFFIX, 2 * SLOPE_SUFFIX)
_HEIGHT_BRANCH = displacement("y", "y", "base")
_RAISED_HEIGHT = "y + raised"
_HEIGHT_LIMITS = {
    "the upper end of the force table": f"y_max - ({_RAISED_HEIGHT})",
    "the lower end of the force table": f"{_RAISED_HEIGHT} - y_min",
}


def _write_coenergy(height: str) -> str:
    """Return the coenergy [J] as an expression of the two currents and the height."""
    terms = []
    for table, (a, b) in zip(_TABLE_NAMES, CURRENT_EXPONENTS.values(), strict=True):
        terms.append(f"{table}({height})*i1^{a}*i2^{b}")
    return " + ".join(terms)


@cache
def declare_coils(height: str = _RAISED_HEIGHT) -> Declaration:
    """Declare the two coils around a moving magnet, with inductance and back-EMF.

    The pins of the lower coil are ``lp`` and ``ln``, the pins of the upper coil ``up`` and ``un``.
    In a netlist, ``height`` must be the coordinate ``y``.
    """
    return Declaration(
        "coils",
        "catch actuator with real coils",
        Section,
        (_HEIGHT_BRANCH, current("i1", "lp", "ln"), current("i2", "up", "un")),
        coenergy=_write_coenergy(height),
        content="0.5*({}*i1^2 + {}*i2^2)".format(*_COIL_RESISTANCES),
        tables=_TABLE_NAMES,
        conductors=("i1", "i2"),
        **_choose_declaration_options(height, _COIL_RESISTANCES),
    )


@cache
def declare_resistive_coils(height: str = _RAISED_HEIGHT) -> Declaration:
    """Declare the two coils around a moving magnet as resistors in series.

    The declaration contains no inductance and no back-EMF. The series connection reverses the
    current in the lower coil.
    """
    resistance = f"({' + '.join(_COIL_RESISTANCES)})"
    ends = voltage("v", "drive", "ret"), measured(voltage("across", "drive", "ret"))
    physics = {"signals": {"i": f"across/{resistance}"}, "content": f"0.5*v^2/{resistance}"}
    return _declare_force("-i", "i", _COIL_RESISTANCES, height, ends, **physics, conductors=("v",))


def add_heat_pin(declared: Declaration, coefficient: float, reference: float) -> Declaration:
    """Add a heat pin to the declaration of the two coils around a moving magnet.

    The temperature of the heat pin sets the resistances of the coils. Each signal of ``declared``
    is the coil current at the reference temperature: the voltage across both coils, divided by
    their resistance at the reference temperature. Each signal is therefore divided by the ratio of
    the resistances at the temperature of the heat pin and at the reference temperature.
    """
    result = declared.with_heat_pin(coefficient, reference)
    if not declared.signals:
        return result
    rise = measured(replace(HEAT_BRANCH, name="rise"))
    ratio = write_resistance_ratio("rise")
    signals = {name: f"({text})/({ratio})" for name, text in declared.signals.items()}
    return replace(result, branches=(*result.branches, rise), signals=signals)


@cache
def declare_prescribed_currents() -> Declaration:
    """Declare the two coils around a moving magnet with prescribed currents.

    The currents are the parameters ``lower`` and ``upper``.
    """
    return _declare_force("lower", "upper", ("lower", "upper"), _RAISED_HEIGHT)


def _declare_force(
    i1: str,
    i2: str,
    names: tuple[str, ...],
    height: str,
    branches: tuple[Branch, ...] = (),
    **physics: Any,
) -> Declaration:
    """Return the declaration of the force on the magnet, without back-EMF.

    ``i1`` and ``i2`` are expressions of the coil currents.
    """
    currents = {"i1": parse_simplified(i1), "i2": parse_simplified(i2)}
    pull = differentiate_tree(parse_simplified(_write_coenergy(height), tables=_TABLE_NAMES), "y")
    force = substitute_names(subtract_trees(ZERO, pull), currents)
    return Declaration(
        "coils",
        "electromagnetic catch actuator",
        Section,
        (_HEIGHT_BRANCH, *branches),
        forces={"y": ExpressionWriter().write_tree(force)},
        ideal_work=True,
        tables=(*_TABLE_NAMES, *(p + SLOPE_SUFFIX for p in _TABLE_NAMES)),
        **_choose_declaration_options(height, names),
        **physics,
    )


def _choose_declaration_options(height: str, names: tuple[str, ...]) -> dict[str, Any]:
    """Choose declaration options for the integrator's equations or for the netlist.

    The declaration for the integrator's equations has the additional parameters ``raised``,
    ``y_min`` and ``y_max``. In the declaration for the integrator, the field ``limits`` keeps the
    height between ``y_min`` and ``y_max``, the ends of the force table. The declaration for the
    netlist has a velocity pin and the option ``metered=False``.
    """
    if height == _RAISED_HEIGHT:
        return {
            "given": _make_unset_parameters(*_HEIGHT_PARAMETERS, *names),
            "limits": _HEIGHT_LIMITS,
        }
    return {"given": _make_unset_parameters(*names), "speeds": {"y": "v"}, "metered": False}


def _make_unset_parameters(*names: str) -> tuple[Param, ...]:
    """Return netlist parameters with the passed names, without values or units."""
    return tuple(Param(name, 0.0, "-", "") for name in names)


def tabulate_coenergy(table: MagnetostaticTable, points: int) -> dict[str, TableFunction]:
    """Return tables of the coenergy and its slopes versus height, keyed by name.

    ``points`` is the number of equally spaced heights in each table.
    """
    result = {}
    low, high = float(table.y[0]), float(table.y[-1])
    for order, end in enumerate(("", SLOPE_SUFFIX)):
        per = "/m" * order
        for k, (name, unit) in enumerate(zip(_TABLE_NAMES, _TABLE_UNITS, strict=True)):
            function = partial(_evaluate_column, table.coenergy.coefficient_derivatives[order], k)
            result[name + end] = TableFunction(low, high, points, function, unit + per)
    return result


def _evaluate_column(functions: PiecewisePolynomial, k: int, y: np.ndarray) -> np.ndarray:
    """Evaluate column ``k`` of a piecewise polynomial matrix at the positions ``y``."""
    return functions(y)[..., k]


def make_law(
    name: str,
    declaration: Declaration,
    table: MagnetostaticTable,
    raised: float = 0.0,
    **given: float,
) -> DeclaredLaw:
    """Return the law of the coils, from a table of finite-element solutions.

    The height of the magnet is its displacement plus ``raised`` [m]. ``given`` contains the values
    of further parameters.
    """
    known = dict(declaration.defaults)
    known |= dict(zip(_COIL_RESISTANCES, table.resistance.tolist(), strict=True)) | given
    known |= {"raised": raised, "y_min": float(table.y[0]), "y_max": float(table.y[-1])}
    values = tuple(known[param.name] for param in declaration.given)
    return DeclaredLaw(name, declaration, values, tables=_make_table_functions(table.coenergy))


def _make_table_functions(coenergy: Coenergy) -> Mapping[str, Callable[[float], float]]:
    """Return the functions that evaluate the declared lookup tables, keyed by name.

    The functions have a common cache, so that each height is evaluated only once.
    """
    result: dict[str, Callable[[float], float]] = {}
    for order, end in enumerate(_TABLE_SUFFIXES):
        values = lru_cache(maxsize=1)(coenergy.coefficient_derivatives[order])
        for k, table in enumerate(_TABLE_NAMES):
            result[table + end] = partial(_evaluate_at_height, values, k)
    return result


def _evaluate_at_height(values: Callable[[float], Any], k: int, y: float) -> float:
    """Return entry ``k`` of the tabulated values at the height ``y`` [m]."""
    return float(values(y)[k])
