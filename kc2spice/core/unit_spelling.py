"""Suggested corrections of quantities with decimal commas or with wrong units."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Sequence
from typing import NamedTuple, TypeGuard

from kc2spice.core.units import (
    MAX_QUANTITY_LENGTH,
    NUMBER_WITH_UNIT,
    UNIT_PREFIXES,
    UNITS,
    parse_quantity,
    parse_unit,
)

# Unit symbols, keyed by the unit name in the singular.
_UNIT_WORDS = {
    "gram": "g", "kilogram": "kg", "metre": "m", "meter": "m", "millimetre": "mm",
    "millimeter": "mm", "micrometer": "um", "micron": "um", "second": "s", "sec": "s", "volt": "V",
    "ampere": "A", "amp": "A", "ohm": "Ohm", "farad": "F", "henry": "H", "newton": "N",
    "pascal": "Pa", "watt": "W", "joule": "J", "kelvin": "K", "tesla": "T", "hertz": "Hz",
    "percent": "%", "liter": "l", "litre": "l", "milliliter": "ml", "millilitre": "ml",
    "kilohm": "kOhm", "kiloohm": "kOhm", "megohm": "MOhm", "microfarad": "uF", "nanofarad": "nF",
    "picofarad": "pF", "kilohertz": "kHz", "megahertz": "MHz", "millisecond": "ms",
    "microsecond": "us", "millivolt": "mV", "kilovolt": "kV", "milliampere": "mA",
}  # fmt: skip
# Value and SI unit of each non-SI unit. The values are from NIST SP 811, appendix B.
_FOREIGN_UNITS = {
    "in": (0.0254, "m"), "inch": (0.0254, "m"), '"': (0.0254, "m"), "mil": (2.54e-5, "m"),
    "thou": (2.54e-5, "m"), "ft": (0.3048, "m"), "Å": (1e-10, "m"), "micron": (1e-6, "m"),
    "lb": (0.45359237, "kg"), "oz": (0.028349523125, "kg"), "t": (1e3, "kg"),
    "g": (9.80665, "m/s2"), "g0": (9.80665, "m/s2"), "G": (9.80665, "m/s2"),
    "gal": (0.01, "m/s2"), "lbf": (4.4482216152605, "N"), "kgf": (9.80665, "N"),
    "gf": (9.80665e-3, "N"), "dyn": (1e-5, "N"), "bar": (1e5, "Pa"), "mbar": (100.0, "Pa"),
    "atm": (101325.0, "Pa"), "psi": (6894.757293168, "Pa"), "torr": (133.322368, "Pa"),
    "mmHg": (133.322387, "Pa"), "gauss": (1e-4, "T"), "Gs": (1e-4, "T"),
    "min": (60.0, "s"), "h": (3600.0, "s"), "ms-1": (1.0, "m/s"), "km/h": (1 / 3.6, "m/s"),
    "mph": (0.44704, "m/s"), "rpm": (1 / 60, "Hz"), "u/min": (1 / 60, "Hz"),
    "Wh": (3600.0, "J"), "kWh": (3.6e6, "J"), "cal": (4.184, "J"), "eV": (1.602176634e-19, "J"),
    "hp": (745.699871582, "W"), "Ah": (3600.0, "C"), "mAh": (3.6, "C"),
    "g/cm3": (1e3, "kg/m3"), "g/cc": (1e3, "kg/m3"), "cc": (1e-6, "m3"), "ppm": (1e-6, ""),
}  # fmt: skip
# a range such as 1 g:2 g:5, or a list such as 1 g,2 g or 1 g;2 g
_SEVERAL_VALUES = re.compile(r"\s*([-+]?[\d.]+\s*[A-Za-z%/]*)\s*[:;]\s*[-+]?\d|"
                             r"\s*([-+]?[\d.]+\s*[A-Za-z%/]+)\s*,\s*[-+]?\d")  # fmt: skip
# a range such as 100 .. 1000, 1 g to 2 g or 100-1000; a hyphen after a letter belongs to a unit
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_TWO_ENDS = re.compile(
    rf"\s*({_NUMBER}[^.…]*?)\s*(\.\.+|…|\bto\b|(?<=[\d\s])[-–])\s*({_NUMBER}[^.…]*(?:\.\d[^.…]*)?)"
)

# Example quantities in error messages, keyed by SI unit.
# For an SI unit without an entry, the example quantity is 1 of this unit, such as 1 V.
_EXAMPLES = {
    "m": "1 mm", "kg": "1 g", "s": "1 ms", "Hz": "1 kHz", "F": "1 nF", "H": "1 mH", "m3": "1 cm3",
    "m2": "1 mm2", "A": "1 mA",
}  # fmt: skip


def is_range_or_list(value: object) -> bool:
    """Return whether a value is a range such as 1 g:2 g:5, or a list such as 1 g,2 g."""
    if isinstance(value, str):
        return _find_first_value(value) is not None
    return is_list_of_quantities(value)


def is_list_of_quantities(value: object) -> TypeGuard[Sequence[str | float]]:
    """Return whether a value is a list of at least two numbers, with or without units.

    >>> is_list_of_quantities([1, "2 Ohm"]), is_list_of_quantities([1]), is_list_of_quantities("1")
    (True, False, False)
    """
    return isinstance(value, (list, tuple)) and len(value) > 1 and all(map(_is_quantity, value))


def _is_quantity(value: object) -> bool:
    """Return whether a value is a number, or a text with a number and perhaps a unit."""
    if isinstance(value, str):
        return len(value) <= MAX_QUANTITY_LENGTH and bool(NUMBER_WITH_UNIT.fullmatch(value.strip()))
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _find_first_value(text: str) -> str | None:
    """Return the first value of a range or a list, or None for any other text."""
    # long texts are not compared, because the time of the comparison grows faster than the length
    if len(text) > MAX_QUANTITY_LENGTH:
        return None
    if several := _SEVERAL_VALUES.match(text):
        return (several[1] or several[2]).strip()
    ends = find_range_ends(text)
    return ends[0].strip() if ends else None


def find_range_ends(text: str, *, hyphen: bool = True) -> tuple[str, str] | None:
    """Find both ends of a range that is written with dots, ``to`` or a hyphen.

    Return None if the text is not a range. If only one end of an increasing range has a unit, the
    result contains this unit twice. Without ``hyphen``, a hyphen is no separator, because names can
    contain hyphens.

    >>> find_range_ends("100 .. 1000"), find_range_ends("1 to 2 mm"), find_range_ends("1e-3 m")
    (('100', '1000'), ('1 mm', '2 mm'), None)
    """
    match = _TWO_ENDS.fullmatch(text.rstrip()) if len(text) <= MAX_QUANTITY_LENGTH else None
    if match is None or (match[2] in "-–" and not hyphen):
        return None
    ends = NUMBER_WITH_UNIT.fullmatch(match[1]), NUMBER_WITH_UNIT.fullmatch(match[3])
    if ends[0] and ends[1] and float(ends[0][1]) < float(ends[1][1]):
        low, high = (
            f"{end[1]} {end[2] or ends[0][2] or ends[1][2]}".strip() for end in ends if end
        )
        return low, high
    return match[1], match[3]


def convert_percentage(value: object) -> float | None:
    """Return the fraction that the user probably meant by a number from 1 to 100.

    For any other value, the result is None.

    >>> convert_percentage(5), convert_percentage(0.05)
    (0.05, None)
    """
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) / 100 if is_number and 1 <= value <= 100 else None  # type: ignore


def give_example(si: str) -> str:
    """Return a quantity of usual size in a unit that belongs to the SI unit ``si``.

    >>> give_example("m"), give_example("V")
    ('1 mm', '1 V')
    """
    return _EXAMPLES.get(si, f"1 {si}")


class _TypedQuantity(NamedTuple):
    """Quantity as the user typed it: complete text, number and unit."""

    text: str
    number: str
    unit: str


def suggest_spelling(value: object, si: str) -> str | None:
    """Suggest a correction of a quantity with a decimal comma or a faulty unit.

    >>> suggest_spelling("1,5 mm", "m")
    'write  "1.5 mm"'
    >>> suggest_spelling("2 inch", "m")
    'write  "0.0508 m"'
    """
    if isinstance(value, (list, tuple)) and len(value) == 1:
        inner = f'"{value[0]}"' if isinstance(value[0], str) else f"{value[0]}"
        return f"write the value without brackets: {inner}"
    if not isinstance(value, str):
        return _make_form_hint(si)
    if len(value) > MAX_QUANTITY_LENGTH:
        return f"write a number of at most {MAX_QUANTITY_LENGTH} characters"
    if (first := _find_first_value(value)) is not None:
        if re.fullmatch(_NUMBER, first) is None:  # a text between quotes needs a unit
            first = f'"{first}"'
        return f"write one value, such as  {first}; kc2spice sweep accepts a range or a list"
    match = NUMBER_WITH_UNIT.fullmatch(value.rstrip())
    typed = None if match is None else _TypedQuantity(value.strip(), match[1], match[2])
    if typed is not None and typed.unit == "%" and si:
        return _make_form_hint(si)  # "2 % m" would be 0.02 m
    if typed is not None:
        for correct in _CORRECTIONS:
            if advice := correct(typed, si):
                return advice
    return _suggest_point_or_unit(value, typed, si) or _suggest_unit(typed, si)


def _make_form_hint(si: str) -> str:
    """Return a hint that shows an example of a quantity in the required unit."""
    return f'write a number with its unit, such as "{give_example(si)}"' if si else "write a number"


def _suggest_if_valid(text: str, si: str) -> str | None:
    """Return the hint to write ``text`` if it is a valid quantity, otherwise None."""
    with contextlib.suppress(ValueError):
        parse_quantity(text, si)
        return f'write  "{text}"'
    return None


def _suggest_unit_symbol(typed: _TypedQuantity, si: str) -> str | None:
    """Suggest the symbol of a unit whose name was typed, as in ``5 volts``."""
    word = "" if parse_unit(typed.unit) else typed.unit.lower().removesuffix("s")
    symbol = _UNIT_WORDS.get(word)
    return symbol and _suggest_if_valid(f"{typed.number} {symbol}", si)


def _suggest_kelvin(typed: _TypedQuantity, si: str) -> str | None:
    """Suggest kelvin in place of degrees Celsius for a temperature difference."""
    celsius = re.search("°C|℃|degC", typed.unit)
    if celsius is None:
        return None
    if typed.unit == celsius[0]:
        rise = "the difference from the ambient temperature in K"
        number = typed.number
        return f'write {rise}, such as  "{number} K"  for a rise of {number} °C'
    return _suggest_if_valid(f"{typed.number} {typed.unit.replace(celsius[0], 'K')}", si)


def _expand_prefix_of_number(typed: _TypedQuantity, si: str) -> str | None:
    """Suggest ``2000`` in place of ``2k``, and ``4700`` in place of ``4k7``."""
    split = re.fullmatch(r"([\d.]+)\s*([kKMGnpu])(\d*)", typed.text)
    if si or split is None:
        return None
    prefix, digits = split[2].replace("K", "k"), f"{split[1]}{'.' * bool(split[3])}{split[3]}"
    with contextlib.suppress(ValueError):  # a number with two decimal points
        return f"write  {float(f'{digits}e{UNIT_PREFIXES[prefix]}'):.12g}"
    return None


def _suggest_prefix_before_unit(typed: _TypedQuantity, si: str) -> str | None:
    """Suggest ``4.7 kOhm`` in place of ``4k7``, where the prefix separates decimals."""
    split = re.fullmatch(r"(\d+)([pnumkMGRΩ])(\d+)", typed.text)
    if split is None:
        return None
    prefix = "" if split[2] in "RΩ" else split[2]
    return f'write  "{split[1]}.{split[3]} {prefix}{si}"'


def _correct_letter_case(typed: _TypedQuantity, si: str) -> str | None:
    """Suggest the unit with the correct letter case, such as ``MHz`` for ``mhz``."""
    if not si or not typed.unit.lower().endswith(si.lower()):
        return None
    prefix = typed.unit[: -len(si)]
    prefix = "M" if (prefix, si) == ("m", "Hz") else prefix  # mhz means megahertz
    return _suggest_if_valid(f"{typed.number} {prefix}{si}", si)


def _add_exponent(typed: _TypedQuantity, si: str) -> str | None:
    """Suggest the missing exponent in a unit of area or volume, such as ``mm2``."""
    power, length = re.fullmatch(r"(m)([23])", si), parse_unit(typed.unit)
    if power and length and length == parse_unit(f"{typed.unit[:-1]}m"):
        return f'write  "{typed.number} {typed.unit}{power[2]}"'
    return None


def _convert_foreign_unit(typed: _TypedQuantity, si: str) -> str | None:
    """Suggest the SI value of a quantity in another unit, such as inches."""
    factor, unit = _FOREIGN_UNITS.get(typed.unit, (0.0, ""))
    if not factor or unit != si:
        return None
    converted = float(f"{factor * float(typed.number):.6g}")
    return f'write  "{f"{converted:.12g} {si}".strip()}"'


def _complete_unit(typed: _TypedQuantity, si: str) -> str | None:
    """Suggest a compound unit of which only the first unit was typed: N/m for ``3 N``."""
    if typed.unit and si.startswith((f"{typed.unit}/", f"{typed.unit} ")):
        return f'write  "{typed.number} {si}"'
    return None


# Functions that suggest a correction of a text that begins with a number.
# ``suggest_spelling`` calls the functions in this order, until one of them returns a suggestion.
_CORRECTIONS = (
    _suggest_unit_symbol,
    _suggest_kelvin,
    _expand_prefix_of_number,
    _suggest_prefix_before_unit,
    _correct_letter_case,
    _add_exponent,
    _convert_foreign_unit,
    _complete_unit,
)


def _suggest_point_or_unit(value: str, typed: _TypedQuantity | None, si: str) -> str | None:
    """Suggest a decimal point in place of a comma, or a unit for a plain number."""
    for text in (value.replace(",", ".", 1), f"{value.rstrip()}{si}", f"{value.rstrip()} {si}"):
        with contextlib.suppress(ValueError):
            if not math.isfinite(parse_quantity(text, si)):
                return f"write a number of at most 1e300 {si}".rstrip()
            number, unit = NUMBER_WITH_UNIT.fullmatch(text).groups()  # type: ignore[union-attr]
            if typed is not None and not typed.unit:
                return _suggest_two_units(number, si)
            return f'write  "{f"{number} {unit}".strip()}"'
    return None


def _suggest_two_units(number: str, si: str) -> str:
    """Suggest a number with a usual unit and with the SI unit.

    >>> _suggest_two_units("20", "F")
    'write  "20 nF"  or, if the value is in F,  "20 F"'
    """
    usual = give_example(si).removeprefix("1 ")
    if si and _find_scale(usual) < _find_scale(si):
        return f'write  "{number} {usual}"  or, if the value is in {si},  "{number} {si}"'
    prefix = "k" if si in ("Hz", "Ohm", "Pa") else "m"
    has_prefix = si in UNITS and si not in ("1", "%", "K")
    more = f'  or, with a prefix,  "{number} {prefix}{si}"' if has_prefix else ""
    return f'write  "{f"{number} {si}".strip()}"{more}'


def _suggest_unit(typed: _TypedQuantity | None, si: str) -> str:
    """Suggest the SI unit with the prefix that is most similar to the typed unit."""
    from difflib import get_close_matches  # imported here, because few values need a correction

    if typed is None:
        return _make_form_hint(si)
    number, unit = typed.number, typed.unit
    base = "g" if si == "kg" else si  # unit without a prefix
    if parse_unit(unit) is not None:
        if not si:
            return f"write a plain number without {unit}, because this key is dimensionless"
        prefixed = unit not in UNITS and unit[:1] in UNIT_PREFIXES and unit[1:] in UNITS
        prefix = unit[:1] if prefixed and base in UNITS else ""
        usual = give_example(si).removeprefix("1 ")
        same = f"{prefix}{base}"
        # a large prefix is usual for ohms, but not for metres
        if not prefix or _find_scale(usual) < _find_scale(si) < _find_scale(same):
            same = usual
        return f'write  "{number} {same}"  if the value is in {same}'
    units = [f"{prefix}{base}" for prefix in ("", *UNIT_PREFIXES)]
    lower = {item.lower(): item for item in reversed(units)}
    # a prefix as a word or in the wrong letter case: 1 micro F, 1 KOhm
    word = re.sub(r"^(micro|milli|kilo|nano|pico)\s*", _abbreviate_prefix, unit).lower()
    similar = [lower[word]] if word in lower else get_close_matches(unit, units, 1, 0.7)
    if not similar:  # wrong letter case: kh for kHz
        similar = [lower[item] for item in get_close_matches(unit.lower(), lower, 1, 0.7)]
    if similar or not si:
        return f'write  "{number} {similar[0]}"' if similar else f"write {number}"
    return f'write  "{number} {si}"  if the value is in {si}'


def _find_scale(unit: str) -> int:
    """Return the power of ten of a unit relative to kilogram, metre, second and ampere."""
    scale = parse_unit(unit)
    assert scale is not None, f"{unit!r} is not a unit"
    return scale[0]


def _abbreviate_prefix(match: re.Match[str]) -> str:
    """Return the symbol of a prefix that is written as a word: ``u`` for ``micro``."""
    return "u" if match[1] == "micro" else match[1][0]
