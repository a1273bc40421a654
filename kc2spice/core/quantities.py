"""What the keys of a scene are made of: numbers in SI with their units, and frozen tables, checked
with errors that name the key.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Strict, ValidationError
from pydantic_core import PydanticCustomError

from kc2spice.core.errors import UsageError
from kc2spice.core.findings import dotted, told
from kc2spice.core.units import quantity


def refused(reason: str, expected: str | None) -> PydanticCustomError:
    """What a validator says of a value that it does not take."""
    return PydanticCustomError("quantity", "{reason}", {"reason": reason, "expected": expected})


def _number(si: str, value: object) -> float:
    try:
        return quantity(value, si)
    except UsageError as error:
        raise refused(error.message, error.expected) from None


def _number_with_unit(si: str, value: object) -> float:
    if not isinstance(value, str):
        raise refused("needs its unit", f'a string such as "1 {si}"')
    return _number(si, value)


def _rings(value: object) -> object:
    if value in ("needed", "all") or (type(value) is int and value >= 1):
        return value
    raise refused("no such choice", "needed, all, or a whole number from 1 on")


def _place(value: object) -> float:
    for unit in ("Hz", "s", "V", "A", "N", "m"):
        try:
            return quantity(value, unit)
        except UsageError:
            continue
    raise refused("no place on the scale", 'such as "46 Hz" or "2 ms"')


def _mounting(value: object) -> object:
    known = ("roller", "glued", "free")
    try:
        if value in known or 0 < quantity(value, "N/m3") < float("inf"):
            return value if value in known else quantity(value, "N/m3")
    except UsageError:
        pass
    above_zero = 'or a stiffness per area above zero such as "1e14 N/m3"'
    raise refused("no such mounting", f"{', '.join(known)}, {above_zero}")


def si(unit: str) -> BeforeValidator:
    """Marks a number that is kept in ``unit`` and may be written as a string with any other."""
    return BeforeValidator(partial(_number, unit))


Length = Annotated[float, si("m")]
Time = Annotated[float, si("s")]
Frequency = Annotated[float, si("Hz")]
Voltage = Annotated[float, si("V")]
Current = Annotated[float, si("A")]
Velocity = Annotated[float, si("m/s")]
Acceleration = Annotated[float, si("m/s2")]
Stiffness = Annotated[float, si("N/m")]
Density = Annotated[float, si("kg/m3")]
Pressure = Annotated[float, si("Pa")]
Polarisation = Annotated[float, si("C/m2")]
FluxDensity = Annotated[float, si("T")]
Resistivity = Annotated[float, si("Ohm m")]
Rate = Annotated[float, si("1/s")]
Resistance = Annotated[float, si("Ohm")]
Capacitance = Annotated[float, si("F")]
Inductance = Annotated[float, si("H")]
Mass = Annotated[float, si("kg")]
MechanicalDamping = Annotated[float, si("N s/m")]
Charge = Annotated[float, si("C")]
Slew = Annotated[float, si("V/s")]
Ratio = Annotated[float, si("")]
Count = Annotated[int, Strict()]
Place = Annotated[float, BeforeValidator(_place)]
Rings = Annotated[Literal["needed", "all"] | int, BeforeValidator(_rings)]
Mounting = Annotated[Literal["roller", "glued", "free"] | float, BeforeValidator(_mounting)]
GateLength = Annotated[float, BeforeValidator(partial(_number_with_unit, "m"))]
GateTime = Annotated[float, BeforeValidator(partial(_number_with_unit, "s"))]


@dataclass(frozen=True)
class Notch:
    """Marks a key that trades time for error: one notch finer multiplies it by ``factor``.

    ``spaces`` says that it counts points, whose spaces are multiplied; ``finest`` is a value below
    which rounding decides; ``model`` marks what costs no time of the simulator. It counts where the
    keys ``when`` of its table have these values.
    """

    factor: float
    spaces: bool = False
    finest: float = 0.0
    model: bool = False
    when: tuple[tuple[str, object], ...] = ()

    def moved(self, value: float, notches: float) -> float:
        """``value`` so many notches finer, rounded to six digits or a whole number."""
        factor = self.factor**notches
        if not isinstance(value, int):
            return float(f"{factor * value:.6g}")
        return round(factor * (value - 1)) + 1 if self.spaces else round(factor * value)

    def applies(self, keys: BaseModel) -> bool:
        """Whether the table ``keys`` uses it."""
        return all(getattr(keys, name) == value for name, value in self.when)


class Section(BaseModel):
    """A table of the scene file: no unknown keys, no later change."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True, defer_build=True)


Schema = TypeVar("Schema", bound=Section)


def validated(
    schema: type[Schema],
    table: Mapping[str, Any] | Schema,
    where: str,
    context: Mapping[str, Any] | None = None,
) -> Schema:
    """``table`` as a ``schema``; one that is already passes unchanged.

    ``where`` is a key, or ends in a colon and is a file; validators see the ``context``.

    Raises
    ------
    UsageError : a key is unknown, missing, of the wrong unit, or contradicts another.
    """
    if isinstance(table, schema):
        return table
    given = dict(table) if isinstance(table, Mapping) else table
    try:
        return schema.model_validate(given, context=context)
    except ValidationError as error:
        path, words = told(error, schema)
        inside = f"{where} " if where.endswith(":") else f"{where}."
        place = inside + dotted(path) if path else where.removesuffix(":")
        raise UsageError(where=place, **words) from None
