"""Two coils and fixed magnets around a moving magnet: one coenergy of height and currents.

Magnetic materials are linear, so at each height it is a quadratic function of the currents, of the
powers in :data:`kc2spice.core.magnets.POWERS`. Its slopes are the force and the flux linkages.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, lru_cache, partial
from typing import Any

from kc2spice.core.magnets import POWERS, Coenergy, EMTable
from kc2spice.core.quantities import Section
from kc2spice.netlist.circuit import Param
from kc2spice.netlist.expression import Writer, substitute
from kc2spice.physics.declaration import Branch, Declaration, current, displacement, voltage
from kc2spice.physics.law import DeclaredLaw
from kc2spice.physics.symbolic import SLOPE, ZERO, derivative, expression, minus

_TABLES = tuple(map("int_{}".format, POWERS))  # integrals over the height
_COILS = ("resistance_lower", "resistance_upper")
_RANGE = ("raised", "y_min", "y_max")
_ENDS = ("", SLOPE, 2 * SLOPE)
_PLACE = displacement("y", "y", "base")
_HEIGHT = "y + raised"
_COENERGY = " + ".join(
    f"{table}({_HEIGHT})*i1^{a}*i2^{b}"
    for table, (a, b) in zip(_TABLES, POWERS.values(), strict=True)
)
_LIMITS = {
    "the upper end of the force table": f"y_max - ({_HEIGHT})",
    "the lower end of the force table": f"{_HEIGHT} - y_min",
}


@cache
def declare_coils() -> Declaration:
    """Declare both coils with resistance, inductance and back-EMF.

    The pins are ``lp`` and ``ln`` of the lower coil, ``up`` and ``un`` of the upper one.
    """
    return Declaration(
        "coils",
        "two coils and the force that they put on a magnet",
        Section,
        (_PLACE, current("i1", "lp", "ln"), current("i2", "up", "un")),
        coenergy=_COENERGY,
        content="0.5*({}*i1^2 + {}*i2^2)".format(*_COILS),
        given=_unset_parameters(*_RANGE, *_COILS),
        tables=_TABLES,
        limits=_LIMITS,
    )


@cache
def declare_resistive_coils() -> Declaration:
    """Declare one current through both coils, reversed in the lower one."""
    resistance = f"({' + '.join(_COILS)})"
    ends = (voltage("v", "drive", "ret"),)
    return _declare_force(
        f"-v/{resistance}", f"v/{resistance}", _COILS, ends, content=f"0.5*v^2/{resistance}"
    )


@cache
def declare_prescribed_currents() -> Declaration:
    """Declare constant currents ``lower`` and ``upper``."""
    return _declare_force("lower", "upper", ("lower", "upper"))


def _declare_force(
    i1: str, i2: str, names: tuple[str, ...], ends: tuple[Branch, ...] = (), content: str = "0"
) -> Declaration:
    """Declare the force alone, without the back-EMF in the coils."""
    currents = {"i1": expression(i1), "i2": expression(i2)}
    pull = derivative(expression(_COENERGY, tables=_TABLES), "y")
    force = substitute(minus(ZERO, pull), currents)
    return Declaration(
        "coils",
        "force of two coils on a magnet",
        Section,
        (_PLACE, *ends),
        forces={"y": Writer().write(force)},
        given=_unset_parameters(*_RANGE, *names),
        tables=(*_TABLES, *(p + SLOPE for p in _TABLES)),
        limits=_LIMITS,
        content=content,
    )


def write_force() -> str:
    """Write the force as nested products of the nodes of coefficients and currents."""
    first, second = [], []
    for name, (a, b) in POWERS.items():
        if a:
            first.append(f"V({name})" + "*V(i1)" * (a - 1) + "*V(i2)" * b)
        elif b:
            second.append(f"V({name})" + "*V(i2)" * (b - 1))
    return f"V(c0)+V(i1)*({'+'.join(first)})+V(i2)*({'+'.join(second)})"


def _unset_parameters(*names: str) -> tuple[Param, ...]:
    return tuple(Param(name, 0.0, "-", "") for name in names)


def make_law(
    name: str, declaration: Declaration, table: EMTable, raised: float = 0.0, **given: float
) -> DeclaredLaw:
    """Make the law of coils with this ``table``.

    The magnet is ``raised`` [m] above its coordinate.
    """
    known = dict(zip(_COILS, table.resistance.tolist(), strict=True)) | given
    known |= {"raised": raised, "y_min": float(table.y[0]), "y_max": float(table.y[-1])}
    values = tuple(known[param.name] for param in declaration.given)
    return DeclaredLaw(name, declaration, values, tables=_table_functions(table.coenergy))


def _table_functions(coenergy: Coenergy) -> Mapping[str, Callable[[float], float]]:
    """Functions that the declarations call; all values of one height are calculated once."""
    result: dict[str, Callable[[float], float]] = {}
    for order, end in enumerate(_ENDS):
        values = lru_cache(maxsize=1)(coenergy.slopes[order])
        for k, table in enumerate(_TABLES):
            result[table + end] = partial(_value_at, values, k)
    return result


def _value_at(values: Callable[[float], Any], k: int, y: float) -> float:
    return float(values(y)[k])
