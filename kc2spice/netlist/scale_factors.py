"""Spelling of numbers with scale factors, such as ``24.9u``, for ngspice.

ngspice reads the digits of a number as one integer, and multiplies the integer by a power of ten.
In ngspice, ``100n`` is not the same double as ``1e-07``, because of rounding, but ``100.00n`` is.
For the value of a parameter, ngspice prints the product of number and scale factor with 16 digits,
and then reads the printed text. For 1500 random numbers, :func:`read_value` and
:func:`read_parameter` returned the same doubles as ngspice 39.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from decimal import Decimal
from itertools import chain

from kc2spice.core.errors import UsageError
from kc2spice.core.units import NUMBER_WITH_UNIT, UNIT_PREFIXES, parse_unit
from kc2spice.netlist.expression import PREFIXES

# smallest and largest magnitude of a number without a scale factor
SMALLEST_PLAIN = Decimal("0.1")
LARGEST_PLAIN = 1000
_FLOAT = re.compile(r"[-+]?(?:\d+\.\d*|\.\d+|\d+(?=[eE]))(?:[eE][-+]?\d+)?")
_EMBEDDED_FLOAT = re.compile(rf"(?<![\w.+-]){_FLOAT.pattern}(?![\w.])")
_DIGIT_PARTS = re.compile(r"([-+]?)(\d*)\.?(\d*)(?:[eE]([-+]?\d+))?([a-z]*)")
_MICRO_SIGNS = str.maketrans("µμ", "uu")
_OHM = re.compile(r"(?i)ohms?$")
_PREFIX_LETTERS = {power: key for key, power in PREFIXES.items()}


def read_value(text: str) -> float:
    """Return the double that ngspice reads from a number on a card."""
    match = _DIGIT_PARTS.fullmatch(text)
    assert match is not None
    sign, integer, decimals, exponent, letters = match.groups()
    mantissa = 0.0
    for digit in integer + decimals:
        mantissa = 10 * mantissa + int(digit)
    power = int(exponent or 0) - len(decimals) + PREFIXES[letters]
    return (-1.0 if sign == "-" else 1.0) * mantissa * 10.0**power


def read_parameter(text: str) -> float:
    """Return the double that ngspice reads from the value of a parameter."""
    match = _DIGIT_PARTS.fullmatch(text)
    assert match is not None
    plain = float(text.removesuffix(match[5])) * float(f"1e{PREFIXES[match[5]]}")
    return read_value(f"{plain:.15e}")


def read_user_number(text: str, where: str | None = None) -> float:
    """Return the value of a number with a SPICE scale factor or an SI unit.

    A SPICE scale factor stands directly after the number, as in ``3.3m``. A unit gives the number
    in SI units without prefixes, so ``3.3 mH`` is the number 0.0033.

    Raises
    ------
    UsageError : the text is not a number, or SPICE and SI give it different values, as for ``4.7M``
        and ``1F``.

    Examples
    --------
    >>> [read_user_number(text) for text in ("3.3m", "3.3 mH", "2.8kHz", "1meg", "4700")]
    [0.0033, 0.0033, 2800.0, 1000000.0, 4700.0]
    """
    match = NUMBER_WITH_UNIT.fullmatch(text)
    suffix = _OHM.sub("Ohm", match[2].translate(_MICRO_SIGNS)) if match else ""
    expected = 'a number such as 0.0033, "3.3m" as in SPICE, or "3.3 mH" with a unit'
    powers = dict[str, int]()  # power of ten of each meaning of the suffix
    separate = match is not None and text.strip() != match[1] + match[2]
    factor = next(key for key in PREFIXES if suffix.lower().startswith(key))
    # mil is omitted: ngspice reads 3mil as 76 um on cards, but as 0.003 in parameters
    if (
        (not separate or len(suffix) == 1)
        and (not suffix or suffix.isalpha())
        and not suffix.lower().startswith("mil")
    ):
        powers["in SPICE"] = PREFIXES[factor]
    exact = suffix.lower() == factor
    unit = parse_unit(suffix[3:] if factor == "meg" and not exact else suffix)
    # after a blank, a letter such as m is a unit rather than a prefix
    if exact and suffix in UNIT_PREFIXES and (unit is None or not separate):
        powers["as an SI prefix"] = UNIT_PREFIXES[suffix]
    elif unit is not None and suffix:
        powers["as a unit"] = unit[0] + 6 * (factor == "meg")
    elif not exact:
        powers.clear()
    values = dict[str, float]()
    if match is not None:
        values = {key: float(Decimal(match[1]).scaleb(power)) for key, power in powers.items()}
    if not values or not all(map(math.isfinite, values.values())):
        raise UsageError(
            "this text is not a number with a known suffix",
            where=where,
            got=repr(text)[:200],
            expected=expected,
            hint="write the number without a suffix, such as 3.3e-3",
        )
    if len(set(values.values())) > 1:
        raise UsageError(
            "this number has different values in SPICE and in SI",
            where=where,
            got=repr(text),
            expected=expected,
            hint="write " + " or ".join(f"{v:g} ({text} {key})" for key, v in values.items()),
        )
    return next(iter(values.values()))


def format_with_prefix(text: str) -> str:
    """Write a number with a prefix such as ``u`` if the prefix keeps the exact value.

    If ngspice reads different values with and without the prefix, the number is returned unchanged.
    Names, plain integers and other texts, such as ``V1`` and ``12``, are returned unchanged.

    Examples
    --------
    >>> texts = ("2.49e-05", "400000000.0", "1e-07", "0.99", "1e-18", "V1")
    >>> [format_with_prefix(text) for text in texts]
    ['24.9u', '400meg', '100.00n', '0.99', '1e-18', 'V1']
    """
    if not _FLOAT.fullmatch(text):
        return text
    number = Decimal(text)
    if not number:
        return "0"
    power = number.adjusted() // 3 * 3
    is_plain = SMALLEST_PLAIN <= abs(number) < LARGEST_PLAIN
    powers = [k for k in ((0,) if is_plain else (power, power + 3)) if k in _PREFIX_LETTERS]
    if not powers:
        return text
    expected = read_value(text), read_parameter(text)
    for spelled in chain.from_iterable(_spell_number(number, k) for k in powers):
        if (read_value(spelled), read_parameter(spelled)) == expected:
            return spelled
    return text


def abbreviate_number(value: float, digits: int = 4) -> str:
    """Return a rounded number with a scale factor, for comments.

    Examples
    --------
    >>> [abbreviate_number(x) for x in (8.4153e-8, 41.2e6, 0.0, 12.0, 3e-20)]
    ['84.15n', '41.2meg', '0', '12', '3e-20']
    """
    number = Decimal(f"{value:.{digits - 1}e}")
    power = number.adjusted() // 3 * 3
    if not number or power not in _PREFIX_LETTERS:
        return f"{value:.{digits}g}"
    return f"{number.scaleb(-power).normalize():f}{_PREFIX_LETTERS[power]}"


def _spell_number(number: Decimal, power: int) -> Iterator[str]:
    """Yield spellings of a number with the scale factor for ``10**power``.

    The spellings differ in trailing zeros, and ngspice can read different doubles from them.
    """
    mantissa = number.scaleb(-power).normalize()
    if abs(mantissa) >= SMALLEST_PLAIN:
        text = f"{mantissa:f}"
        point = "" if "." in text else "."
        yield from (
            text + zeros + _PREFIX_LETTERS[power] for zeros in ("", f"{point}0", f"{point}00")
        )


def write_numbers_with_prefixes(text: str) -> str:
    """Write the numbers in a text with SPICE prefixes, such as ``24.9u``."""
    return _EMBEDDED_FLOAT.sub(lambda match: format_with_prefix(match[0]), text)
