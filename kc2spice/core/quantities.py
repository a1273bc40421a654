"""Types of scene keys: numbers with units, and tables with a schema.

Error messages contain the name of the key in the user's spelling.

For example, the string ``"0.5 mm"`` becomes the number ``5e-4``. The factors of all units are
powers of ten, so a conversion only shifts the decimal exponent. The number is rounded only once, on
conversion to a float. For example, ``"50 um"`` equals ``50e-6`` exactly.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from numbers import Real
from typing import Annotated, ClassVar, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, PlainValidator, Strict
from pydantic_core import PydanticCustomError

from kc2spice.core.domains import QUANTITIES
from kc2spice.core.errors import UsageError, did_you_mean
from kc2spice.core.key_actions import Hint
from kc2spice.core.unit_spelling import give_example, is_range_or_list, suggest_spelling
from kc2spice.core.units import MAX_QUANTITY_LENGTH, parse_quantity, parse_unit

AIR_DENSITY = 1.204  # kg/m3 at 20 °C and 1013 hPa
SOUND_SPEED = 343.2  # m/s in dry air at 20 °C
EPSILON_0 = 8.8541878188e-12  # F/m, CODATA 2022 (scipy.constants is slow to load)
MU_0 = 4e-7 * math.pi  # H/m

BOLTZMANN = 1.380649e-23  # J/K, exact (SI, 2019)
DEFAULT_TEMPERATURE = 300.15  # K, default temperature of a simulation (27 °C in SPICE)
ELEMENTARY_CHARGE = 1.602176634e-19  # C, exact (SI, 2019)


_PERCENTAGE = re.compile(r"\s*([0-9.]+)\s*%\s*")
# message about several values in place of one value
ONE_VALUE = "this key accepts one value, not a range or a list"


def convert_quantity(value: object, si: str, *, where: str | None = None) -> float:
    """Convert a number, or a string with a unit, to a number in the SI unit ``si``.

    A number is returned unchanged. A string must contain a number with a unit, such as ``"100 V"``.
    For plain numbers, ``si`` is ``""``, and the only permitted unit in a string is ``%``.

    Raises
    ------
    UsageError : the value is not a finite number, or its unit has a wrong physical dimension.
    """
    expected = f'a number in {si}, or a string with a unit such as "{give_example(si)}"'
    try:
        if isinstance(value, str):
            result = parse_quantity(value, si)
        elif isinstance(value, Real) and not isinstance(value, bool):
            result = float(value)
        else:
            raise ValueError("not a quantity")
        if not math.isfinite(result):
            raise ValueError("this value is not a finite number")
    except (ValueError, OverflowError) as error:
        got = repr(value)
        if len(got) > MAX_QUANTITY_LENGTH:
            got = got[:MAX_QUANTITY_LENGTH] + " ..."
        message = (
            "this value is not a finite number" if isinstance(error, OverflowError) else str(error)
        )
        if is_range_or_list(value):
            message = ONE_VALUE
        expected = expected if si else "a plain number"
        hint = suggest_spelling(value, si)
        raise UsageError(message, where=where, got=got, expected=expected, hint=hint) from None
    return result


def make_invalid_value_error(
    reason: str, expected: str | None, key: str | None = None, hint: Hint | None = None
) -> PydanticCustomError:
    """Make the error that a validator raises for an invalid value of a key."""
    context = {"reason": reason, "expected": expected, "key": key, "hint": hint}
    return PydanticCustomError("quantity", "{reason}", context)


def _parse_number(si: str, value: object) -> float:
    """Convert a number, or a string with a unit, to a number in the unit ``si``."""
    try:
        return convert_quantity(value, si)
    except UsageError as error:
        raise make_invalid_value_error(error.message, error.expected, hint=error.hint) from None


def _parse_number_with_unit(si: str, value: object) -> float:
    """Convert a string with a unit to the unit ``si``, and reject plain numbers."""
    if not isinstance(value, str):
        hint = f'write for example  "{value} {si}"'
        expected = f'a string such as "1 {si}"'
        raise make_invalid_value_error("the unit of this value is missing", expected, hint=hint)
    return _parse_number(si, value)


def _convert_whole_number(value: object) -> object:
    """Convert a float without fraction, such as 1e3, to an integer."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _require_ring_choice(value: object) -> object:
    """Require a choice of contact rings: ``needed``, ``all`` or a number of rings.

    Any other value raises an error.
    """
    if value in ("needed", "all") or (type(value) is int and value >= 1):
        return value
    raise make_invalid_value_error(
        "this value is not one of the choices",
        '"needed", "all", or a whole number of at least 1',
        hint='write  "needed"',
    )


class ValueWithUnit(float):
    """Value of an independent variable or of a result, such as a time, with its SI unit.

    ``unit`` is empty for a number without a unit.
    """

    unit: str = ""


# Units of the independent variable of an analysis: frequency, time, or a swept quantity.
# A dc sweep can vary every quantity that a source can prescribe.
SCALE_UNITS = (
    "Hz",
    "s",
    *dict.fromkeys(d.get_quantity(side).unit for d, side in QUANTITIES.values()),
)


def _parse_in_first_fitting_unit(value: object, units: Iterable[str]) -> ValueWithUnit | None:
    """Parse a quantity in the first of several SI units that fits; None if no unit fits."""
    if isinstance(value, ValueWithUnit):
        return value
    for unit in units:
        try:
            result = ValueWithUnit(convert_quantity(value, unit))
        except UsageError:
            continue
        result.unit = unit if isinstance(value, str) else ""
        return result
    return None


def _parse_independent_value(value: object) -> ValueWithUnit:
    """Parse a value of an analysis's independent variable, such as a time."""
    if (result := _parse_in_first_fitting_unit(value, SCALE_UNITS)) is not None:
        return result
    hint = 'write a number with its unit, such as  "46 Hz"  or  "2 ms"'
    if isinstance(value, str):
        corrections = (suggest_spelling(value, unit) for unit in ("Hz", "s"))
        hint = next((item for item in corrections if item and "if the value" not in item), hint)
    raise make_invalid_value_error(
        "this value is not a time or frequency", 'such as "46 Hz" or "2 ms"', hint=hint
    )


# Units of results; the unit of a result without a unit is empty.
RESULT_UNITS = ("", *dict.fromkeys((*SCALE_UNITS, "m/s", "W", "J", "T", "Wb")))


def _parse_result_value(value: object) -> ValueWithUnit:
    """Parse a value of a result, such as a displacement of -1 um."""
    if (result := _parse_in_first_fitting_unit(value, RESULT_UNITS)) is not None:
        return result
    raise make_invalid_value_error(
        "this value is not a quantity with a known unit",
        'a number in the SI unit of the result, or a string with a unit such as "-1.2 um"',
        hint='write a number with the unit of the result, such as  "-1.2 um"  or  "5 V"',
    )


def _parse_mounting(value: object) -> object:
    """Parse the mounting of a body, which is a name or a stiffness per area [N/m^3]."""
    known = ("roller", "glued", "free")
    try:
        if value in known or 0 < convert_quantity(value, "N/m3") < float("inf"):
            return value if value in known else convert_quantity(value, "N/m3")
    except UsageError:
        pass
    above_zero = 'or a stiffness per area above zero such as "1e14 N/m3"'
    hint = did_you_mean(str(value), known) or 'write for example  "glued"'
    expected = f"{', '.join(known)}, {above_zero}"
    raise make_invalid_value_error("this mounting does not exist", expected, hint=hint)


def _reject_percent(value: object) -> object:
    """Reject a Q factor in percent, and return any other value unchanged."""
    if isinstance(value, str) and (percent := _PERCENTAGE.fullmatch(value)):
        raise make_invalid_value_error(
            "a Q factor has no unit %",
            "a plain number; a damping ratio of 1 % is a Q factor of 50",
            hint=f"write  {percent[1]}",
        )
    return value


def si(unit: str) -> BeforeValidator:
    """Return a pydantic validator for a scene key whose values have the given SI unit.

    A valid value is a number in ``unit``, or a string with a unit.

    Raises
    ------
    UsageError : the text ``unit`` is not a product or quotient of SI units.
    """
    if parse_unit(unit) is None:
        raise UsageError(
            "this text is not a unit",
            where="si",
            got=repr(unit),
            expected='products and quotients of SI units, such as "N s2/m2"',
        )
    return BeforeValidator(partial(_parse_number, unit))


@dataclass(frozen=True)
class PlausibleRange:
    """Range of plausible values of a scene key, which is metadata of the key's type.

    Plausible values are between ``low`` and ``high`` in ``unit``. ``why`` is the reason for these
    limits. Zero is also accepted, for example for a tip without mass.
    """

    unit: str
    low: float
    high: float
    why: str


@dataclass(frozen=True)
class UsualRange:
    """Range of usual values of a key or result; unusual values print a warning.

    Usual values are at least ``low`` and below ``high``, in ``unit``. Unlike values outside of a
    :class:`PlausibleRange`, unusual values are accepted. ``why`` is the reason for the limits. Zero
    is always accepted.
    """

    unit: str
    low: float
    high: float
    why: str


Length = Annotated[float, si("m")]
# Plausible dimensions of manufactured parts: thickness of layers and plates, width, and length.
Thickness = Annotated[
    Length, PlausibleRange("m", 1e-7, 0.03, "films are at least 0.1 um thick, plates at most 3 cm")
]
Width = Annotated[
    Length, PlausibleRange("m", 1e-6, 0.5, "transducers are 1 um to half a metre wide")
]
Extent = Annotated[Length, PlausibleRange("m", 1e-6, 1.0, "transducers are 1 um to a metre long")]
# Usual dimensions of other parts. A coordinate or a displacement may be negative.
Dimension = Annotated[
    Length, UsualRange("m", -1.0, 1.0, "parts of transducers are usually smaller than a metre")
]
DuctLength = Annotated[
    Length, UsualRange("m", 0.0, 10.0, "ducts of transducers are usually shorter than 10 m")
]
ListenerDistance = Annotated[
    Length,
    UsualRange("m", 1e-3, 50.0, "sound pressures are usually stated at distances of 1 mm to 50 m"),
]
Time = Annotated[float, si("s")]
Frequency = Annotated[float, si("Hz")]
Voltage = Annotated[float, si("V")]
Current = Annotated[float, si("A")]
Velocity = Annotated[float, si("m/s")]
Acceleration = Annotated[float, si("m/s2")]
USUAL_GRAVITY = UsualRange("m/s2", -100.0, 100.0, "even the gravity of Jupiter is only 25 m/s2")
Gravity = Annotated[Acceleration, USUAL_GRAVITY]
# A steel cube with edges of 1 m has a stiffness of 2e11 N/m.
USUAL_STIFFNESS = UsualRange(
    "N/m", 0.0, 1e11, "a steel block of transducer size has a stiffness below 1e11 N/m"
)
Stiffness = Annotated[float, si("N/m"), USUAL_STIFFNESS]
Density = Annotated[float, si("kg/m3")]
PLAUSIBLE_SOLID_DENSITY = PlausibleRange(
    "kg/m3", 1.0, 22_600.0, "no solid is lighter than an aerogel or heavier than osmium"
)
# The lower limit exceeds the density of every solid in g/cm3, such as 22.6 g/cm3 for osmium.
USUAL_SOLID_DENSITY = UsualRange(
    "kg/m3", 25.0, math.inf, "only gases, foams and aerogels are lighter than 25 kg/m3"
)
SolidDensity = Annotated[Density, PLAUSIBLE_SOLID_DENSITY, USUAL_SOLID_DENSITY]
Pressure = Annotated[float, si("Pa")]
FluxDensity = Annotated[float, si("T")]
Resistivity = Annotated[float, si("Ohm m")]
Rate = Annotated[float, si("1/s")]
Resistance = Annotated[float, si("Ohm")]
PLAUSIBLE_CAPACITANCE = PlausibleRange(
    "F", 1e-21, 1e5, "the largest capacitors have thousands of farads"
)
PLAUSIBLE_INDUCTANCE = PlausibleRange(
    "H", 1e-15, 1e5, "the largest coils have thousands of henries"
)
USUAL_CAPACITANCE = UsualRange("F", 0.0, 1.0, "only supercapacitors have 1 F or more")
USUAL_COIL_INDUCTANCE = UsualRange("H", 0.0, 100.0, "coils usually have less than 100 H")
Capacitance = Annotated[float, si("F"), PLAUSIBLE_CAPACITANCE, USUAL_CAPACITANCE]
Inductance = Annotated[float, si("H"), PLAUSIBLE_INDUCTANCE]
# The motional inductances of crystals can be thousands of henries.
CoilInductance = Annotated[Inductance, USUAL_COIL_INDUCTANCE]
PLAUSIBLE_MASS = PlausibleRange(
    "kg", 1e-18, 1e3, "no transducer has a moving mass below a femtogram or above a tonne"
)
USUAL_MASS = UsualRange(
    "kg", 0.0, 10.0, "moving parts of transducers usually weigh less than 10 kg"
)
Mass = Annotated[float, si("kg"), PLAUSIBLE_MASS, USUAL_MASS]
MechanicalDamping = Annotated[float, si("N s/m")]
Charge = Annotated[float, si("C")]
Slew = Annotated[float, si("V/s")]
Ratio = Annotated[float, si("")]
_HIGHEST_Q = 1e6
_REASON_OF_Q = "only crystals in vacuum reach a Q factor of 1e6, a loss factor of 1e-6"
USUAL_Q_FACTOR = UsualRange("", 0.0, _HIGHEST_Q, _REASON_OF_Q)
UnlimitedQFactor = Annotated[Ratio, BeforeValidator(_reject_percent)]
QFactor = Annotated[UnlimitedQFactor, USUAL_Q_FACTOR]
LossFactor = Annotated[Ratio, UsualRange("", 1 / _HIGHEST_Q, math.inf, _REASON_OF_Q)]
# The damping ratio is half of the loss factor.
DampingRatio = Annotated[Ratio, UsualRange("", 0.5 / _HIGHEST_Q, math.inf, _REASON_OF_Q)]
Count = Annotated[int, BeforeValidator(_convert_whole_number), Strict()]
Place = Annotated[float, PlainValidator(_parse_independent_value)]
ResultValue = Annotated[float, PlainValidator(_parse_result_value)]
Rings = Annotated[Literal["needed", "all"] | int, BeforeValidator(_require_ring_choice)]
Mounting = Annotated[Literal["roller", "glued", "free"] | float, BeforeValidator(_parse_mounting)]
GateLength = Annotated[float, BeforeValidator(partial(_parse_number_with_unit, "m"))]
GateTime = Annotated[float, BeforeValidator(partial(_parse_number_with_unit, "s"))]


# Limit of voltages and currents. ngspice divides by 1e-32 in place of zero, so that a quotient of
# numbers above 1e-17 exceeds the limit. Signals and ideal circuits remain below the limit.
MAX_ELECTRICAL = 1e15
DIVERGENCE = (
    "no real circuit reaches 1e15 V or 1e15 A; the usual cause is a division by zero in a netlist "
    "expression"
)
# Usual ranges of results of a transient, an operating point or a dc sweep, one for each unit.
USUAL_RESULTS = (
    UsualRange(
        "K", -DEFAULT_TEMPERATURE, 3e3, "solids melt, and nothing is colder than absolute zero"
    ),
    UsualRange("m", -10.0, 10.0, "the parts of a transducer move by much less than 10 m"),
    UsualRange("m/s", -SOUND_SPEED, SOUND_SPEED, "this motion is faster than sound in air"),
    UsualRange("V", -MAX_ELECTRICAL, MAX_ELECTRICAL, DIVERGENCE),
    UsualRange("A", -MAX_ELECTRICAL, MAX_ELECTRICAL, DIVERGENCE),
)


@dataclass(frozen=True)
class RefinementRule:
    """Rule by which a numerical setting is refined for a more accurate, slower run.

    One refinement step multiplies the value of the key by ``factor``. If ``spaces`` is true, the
    key is a number of points, and ``factor`` multiplies the number of intervals between the points.
    Below the value ``finest``, rounding errors dominate. If ``model`` is true, the key affects the
    time to build a model, but not the time of the simulator. If ``mesh`` is true, the key sets the
    fineness of a mesh or of rings, and the part estimates the resulting error. The rule applies
    only if each key in ``when`` has the stated value.
    """

    factor: float
    spaces: bool = False
    finest: float = 0.0
    model: bool = False
    mesh: bool = False
    when: tuple[tuple[str, object], ...] = ()

    def refine(self, value: float, steps: float) -> float:
        """Return the value of a setting after a number of refinement steps.

        A real number is rounded to six digits, and a number of points or parts to an integer.
        """
        factor = self.factor**steps
        if not isinstance(value, int):
            return float(f"{factor * value:.6g}")
        return round(factor * (value - 1)) + 1 if self.spaces else round(factor * value)


class Section(BaseModel):
    """Base class of scene sections: immutable tables that reject unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True, defer_build=True)
    help_command: ClassVar[str] = "kc2spice scenes --keys"  # command that prints all keys
    unsupported_key_hints: ClassVar[Mapping[str, str]] = {}  # hint for each unsupported key
