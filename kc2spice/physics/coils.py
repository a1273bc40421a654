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

_TABLES = tuple(f"int_{name}" for name in POWERS)  # over the height
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
def inductive() -> Declaration:
    """Both coils with resistance, inductance and back-EMF, between ``lp ln`` and ``up un``."""
    return Declaration(
        "coils",
        "two coils and the force that they put on a magnet",
        Section,
        (_PLACE, current("i1", "lp", "ln"), current("i2", "up", "un")),
        coenergy=_COENERGY,
        content="0.5*({}*i1^2 + {}*i2^2)".format(*_COILS),
        given=_parameters(*_RANGE, *_COILS),
        tables=_TABLES,
        limits=_LIMITS,
    )


@cache
def resistive() -> Declaration:
    """One current through both coils, the lower one reversed, between ``drive`` and ``ret``."""
    resistance = f"({' + '.join(_COILS)})"
    ends = (voltage("v", "drive", "ret"),)
    return _pull(
        f"-v/{resistance}", f"v/{resistance}", _COILS, ends, content=f"0.5*v^2/{resistance}"
    )


@cache
def prescribed() -> Declaration:
    """Constant currents ``lower`` and ``upper``."""
    return _pull("lower", "upper", ("lower", "upper"))


def _pull(
    i1: str, i2: str, names: tuple[str, ...], ends: tuple[Branch, ...] = (), content: str = "0"
) -> Declaration:
    """The force alone: what moves the magnet is not taken from what feeds the coils."""
    currents = {"i1": expression(i1), "i2": expression(i2)}
    pull = derivative(expression(_COENERGY, tables=_TABLES), "y")
    force = substitute(minus(ZERO, pull), currents)
    return Declaration(
        "coils",
        "force of two coils on a magnet",
        Section,
        (_PLACE, *ends),
        forces={"y": Writer().write(force)},
        given=_parameters(*_RANGE, *names),
        tables=(*_TABLES, *(p + SLOPE for p in _TABLES)),
        limits=_LIMITS,
        content=content,
    )


def force_text() -> str:
    """The force by nodes of the coefficients and of both currents, as nested products."""
    rows = {1: "", 2: ""}
    for name, (a, b) in POWERS.items():
        if a + b:
            more = "*V(i1)" * (a - 1) + "*V(i2)" * (b - (not a))
            rows[1 if a else 2] += f"+V({name}){more}"
    return "V(c0)" + "".join(f"+V(i{k})*({row[1:]})" for k, row in rows.items())


def _parameters(*names: str) -> tuple[Param, ...]:
    return tuple(Param(name, 0.0, "-", "") for name in names)


def law(
    name: str, declaration: Declaration, table: EMTable, raised: float = 0.0, **given: float
) -> DeclaredLaw:
    """Law of coils with this ``table``, on a magnet that is ``raised`` [m] above its coordinate."""
    known = dict(zip(_COILS, table.resistance.tolist(), strict=True)) | given
    known |= {"raised": raised, "y_min": float(table.y[0]), "y_max": float(table.y[-1])}
    values = tuple(known[param.name] for param in declaration.given)
    return DeclaredLaw(name, declaration, values, tables=_tables(table.coenergy))


def _tables(coenergy: Coenergy) -> Mapping[str, Callable[[float], float]]:
    """The functions that the declarations call; those of one height are looked up once."""
    result: dict[str, Callable[[float], float]] = {}
    for order, end in enumerate(_ENDS):
        values = lru_cache(maxsize=1)(coenergy.slopes[order])
        result |= {p + end: partial(_one, values, k) for k, p in enumerate(_TABLES)}
    return result


def _one(values: Callable[[float], Any], k: int, y: float) -> float:
    return float(values(y)[k])
