"""Formatting of numbers with SI prefixes or in percent.

A ratio, or a value that is compared with a limit, is printed as 0 if it is only a rounding error.
"""

from __future__ import annotations

import math
import re

from kc2spice.core.units import parse_unit

PREFIXES = {-18: "a", -15: "f", -12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
# Units that contain a prefix, with the unit without prefix and the conversion factor.
_PREFIXED_UNITS = {"kg": ("g", 1e3), "mm": ("m", 1e-3), "um": ("m", 1e-6)}
# The unit A2 s is printed as s·A², because a prefix before A² would be squared: mA² means (mA)².
_SHOWN_UNITS = {"Ohm": "Ω", "A2 s": "s·A²", "um": "µm"}
# Units of area and volume, with the equivalent of 1 unit in m2 or m3.
_AREAS = {"m²": 1.0, "cm²": 1e-4, "mm²": 1e-6, "µm²": 1e-12}
_VOLUMES = {"m³": 1.0, "dm³": 1e-3, "cm³": 1e-6, "mm³": 1e-9, "µm³": 1e-18}
_POWERS_OF_LENGTH = {"m2": _AREAS, "m3": _VOLUMES}
# Smallest number that is printed in a unit of area or volume; below this limit, a smaller unit is
# used.
MIN_SHARE_OF_UNIT = 0.1
LARGEST_MASS = 1e3  # kg; masses from this value on are printed in kg, without another prefix
# A value is a ratio if its unit begins with "of " or "relative", such as "of the peak".
_RATIO_WORDS = "of ", "relative"
MIN_RATIO_IN_PERCENT = 1e-5  # smaller ratios are printed as < 0.001 %
ROUNDING_NOISE = 1e-12  # numbers below this fraction of their scale are rounding errors


def get_prefix_exponent(value: float) -> int:
    """Return the exponent of ten of a number's SI prefix; 0 for no prefix.

    Examples
    --------
    >>> get_prefix_exponent(4.7e-6)
    -6
    """
    power = 3 * math.floor(math.log10(abs(value)) / 3) if value else 0
    return power if power in PREFIXES else 0


def format_quantity(value: float | None, unit: str, digits: int = 4) -> str:
    """Format a number with an SI prefix, such as ``505.7 µs`` for 5.0573e-4 s.

    Examples
    --------
    >>> format_quantity(3.14e-4, "m2"), format_quantity(2.5e-6, "m3/s")
    ('3.14 cm²', '2.5 cm³/s')
    >>> format_quantity(9.81, "m/s2"), format_quantity(10.0, "W/(m2 K)")
    ('9.81 m/s²', '10 W/(m²·K)')
    """
    if value is None:
        return "—"
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g} {unit}".strip()
    if not _accepts_prefix(unit):
        return f"{value:.{digits}g} {show_unit(unit)}".strip()
    if unit.startswith("kg/"):  # a second prefix, as in kkg/m3, is no unit
        return f"{float(f'{value:.{digits}g}'):g} {show_unit(unit)}"
    if unit in _PREFIXED_UNITS:
        base_unit, factor = _PREFIXED_UNITS[unit]
        if unit == "kg" and abs(value) >= LARGEST_MASS:
            return f"{value:.{digits}g} kg"  # not Gg, which is an unusual unit
        return format_quantity(factor * value, base_unit, digits)
    if _is_power_of_length(unit):
        return _format_power_of_length(value, unit, digits)
    return _format_with_prefix(value, unit, digits, get_prefix_exponent(value))


def _is_power_of_length(unit: str) -> bool:
    """Return whether a unit begins with m2 or m3, as in m3/s."""
    return unit.partition("/")[0] in _POWERS_OF_LENGTH


def _format_power_of_length(value: float, unit: str, digits: int) -> str:
    """Format an area or a volume in the largest unit in which it is at least 0.1.

    A value that is too large for the smallest unit is printed in m2 or m3 with a power of ten.
    """
    base, slash, divisor = unit.partition("/")
    units = _POWERS_OF_LENGTH[base]
    large = [name for name, size in units.items() if abs(value) >= MIN_SHARE_OF_UNIT * size]
    name = large[0] if large else list(units)[-1]
    sign, number = "−" if value < 0.0 else "", f"{abs(value) / units[name]:.{digits}g}"
    if "e" in number:
        name = next(iter(units))
        number = f"{abs(value):.{digits}g}"
    return f"{sign}{number} {name}{slash}{divisor}"


def _accepts_prefix(unit: str) -> bool:
    """Return whether a unit accepts SI prefixes; a phrase used as a unit does not.

    A unit with spaces but without the word ``per``, such as ``of the peak``, is a phrase and
    accepts no prefix. A unit with the word ``per`` accepts prefixes. The unit ``A2 s``,
    ampere squared times second, also accepts prefixes.
    """
    return bool(unit) and (" " not in unit or " per " in unit or unit == "A2 s")


def _format_with_prefix(value: float, unit: str, digits: int, power: int) -> str:
    """Format a number with the SI prefix for 10^``power``."""
    sign = "−" if value < 0.0 else ""
    digits_text = f"{abs(value) / 10.0**power:.{digits}g}"
    return f"{sign}{digits_text} {PREFIXES[power]}{show_unit(unit)}"


def show_unit(unit: str) -> str:
    """Return a unit as printed, with superscripts and centred dots, such as ``W/(m²·K)``.

    A phrase in place of a unit is unchanged.
    """
    if unit in _SHOWN_UNITS:
        return _SHOWN_UNITS[unit]
    if parse_unit(unit) is None:
        return unit
    digits = re.sub(r"(?<=[A-Za-z])[2-9]", lambda match: "⁰¹²³⁴⁵⁶⁷⁸⁹"[int(match[0])], unit)
    return digits.replace(" ", "·")


def format_ratio(value: float | None) -> str:
    """Format a ratio with two digits; write ``0`` if it is only a rounding error.

    Examples
    --------
    >>> format_ratio(1.234e-5), format_ratio(1.2e-23), format_ratio(None)
    ('1.2e-05', '0', '—')
    """
    small = value is not None and abs(value) < ROUNDING_NOISE
    return format_quantity(0.0 if small else value, "", 2)


def format_percent(ratio: float, digits: int = 3) -> str:
    """Format a ratio in percent; write ``< 0.001 %`` for small nonzero ratios.

    Examples
    --------
    >>> format_percent(0.00411), format_percent(3.6e-12), format_percent(0.0)
    ('0.411 %', '< 0.001 %', '0 %')
    >>> format_percent(1.234, 2)
    '120 %'
    """
    if 0.0 < abs(ratio) < MIN_RATIO_IN_PERCENT:
        return f"< {100 * MIN_RATIO_IN_PERCENT:g} %"
    rounded = float(f"{100 * ratio:.{digits}g}")
    return f"{rounded:g} %"


def remove_unit_words(unit: str) -> str:
    """Remove explanatory words from a unit, such as ``beyond`` from ``V beyond``.

    Examples
    --------
    >>> remove_unit_words("V beyond"), remove_unit_words("contact events")
    ('V', '')

    A text that begins with ``of`` describes a ratio, so the result is ``relative``.

    >>> remove_unit_words("of the energy exchanged")
    'relative'
    """
    if unit.startswith(_RATIO_WORDS):
        return "relative"
    if unit == "1" or " " not in unit or " per " in unit or parse_unit(unit):
        return unit.removeprefix("1")
    first_word = unit.partition(" ")[0]
    return first_word if parse_unit(first_word) else ""


def format_value_and_limit(value: float, limit: float, unit: str) -> tuple[str, str]:
    """Format a value and its limit with the same prefix, such as 406 kHz and 500 kHz.

    If the limit would need more than three digits before the decimal point, or more than one zero
    behind it, value and limit have different prefixes. A value
    that is a rounding error relative to the limit, or to 1 for ratios, is printed as 0. Ratios,
    whose unit begins with ``of`` or ``relative``, are printed in percent.

    Examples
    --------
    >>> format_value_and_limit(4.06e5, 5e5, "Hz")
    ('406 kHz', '500 kHz')
    >>> format_value_and_limit(4.07e-8, 1.251e-6, "m")
    ('40.7 nm', '1.25 µm')
    >>> format_value_and_limit(2.93e-4, 0.1, "of the energy exchanged")
    ('0.0293 % of the energy exchanged', '10 %')
    """
    is_ratio = unit.startswith(_RATIO_WORDS)
    prefixed = _accepts_prefix(unit) and not is_ratio
    scalable = prefixed and unit not in _PREFIXED_UNITS and not _is_power_of_length(unit)
    if abs(value) < ROUNDING_NOISE * max(abs(limit), 0.0 if prefixed else 1.0):
        value = 0.0
    if is_ratio:
        words = unit.removeprefix("relative")
        joint = "" if words.startswith(",") else " "
        text = format_percent(value) if limit >= MIN_RATIO_IN_PERCENT else f"{100 * value:.3g} %"
        return f"{text}{joint}{words}".rstrip(), f"{100 * limit:.3g} %"
    if value == 0.0 and scalable and math.isfinite(limit):
        power = get_prefix_exponent(limit)
        return f"0 {PREFIXES[power]}{show_unit(unit)}", format_quantity(limit, unit, 3)
    power = get_prefix_exponent(value) if math.isfinite(value) else 0
    # with the prefix of the value, the limit has at most three digits before the decimal point
    comparable = value and 10.0 ** (power - 2) <= abs(limit) < 10.0 ** (power + 3)
    if not scalable or not comparable or not math.isfinite(value):
        return format_quantity(value, unit, 3), format_quantity(limit, unit, 3)
    return _format_with_prefix(value, unit, 3, power), _format_with_prefix(limit, unit, 3, power)
