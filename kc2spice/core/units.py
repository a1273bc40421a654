"""Units of quantities, and conversion of strings such as "5 mm" to SI units.

The factors of all units are powers of ten, so a conversion only shifts the decimal exponent of a
number.
"""

from __future__ import annotations

import re
from decimal import Decimal

UNIT_PREFIXES = {
    "f": -15, "p": -12, "n": -9, "u": -6, "µ": -6, "μ": -6, "m": -3, "c": -2,
    "k": 3, "M": 6, "G": 9, "T": 12,
}  # fmt: skip
# Power of ten of each unit, followed by the exponents of the base units kg, m, s, A and K.
UNITS = {
    "g": (-3, 1, 0, 0, 0, 0), "m": (0, 0, 1, 0, 0, 0), "s": (0, 0, 0, 1, 0, 0),
    "A": (0, 0, 0, 0, 1, 0), "K": (0, 0, 0, 0, 0, 1), "1": (0, 0, 0, 0, 0, 0),
    "rad": (0, 0, 0, 0, 0, 0),
    "%": (-2, 0, 0, 0, 0, 0), "Hz": (0, 0, 0, -1, 0, 0), "N": (0, 1, 1, -2, 0, 0),
    "Pa": (0, 1, -1, -2, 0, 0), "J": (0, 1, 2, -2, 0, 0), "W": (0, 1, 2, -3, 0, 0),
    "C": (0, 0, 0, 1, 1, 0), "V": (0, 1, 2, -3, -1, 0), "Ohm": (0, 1, 2, -3, -2, 0),
    "F": (0, -1, -2, 4, 2, 0), "H": (0, 1, 2, -2, -2, 0), "Wb": (0, 1, 2, -2, -1, 0),
    "T": (0, 1, 0, -2, -1, 0), "l": (-3, 0, 3, 0, 0, 0), "L": (-3, 0, 3, 0, 0, 0),
}  # fmt: skip
NUMBER_WITH_UNIT = re.compile(
    r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,4})?)\s*(.*?)\s*", re.DOTALL
)
_FACTOR = re.compile(r"([A-Za-zµμ%]+|1)\^?([1-9]?)")
_UNIT_SPELLINGS = str.maketrans(
    {"\u2126": "Ohm", "Ω": "Ohm", "²": "2", "³": "3", "·": " ", "*": " "}
)
# largest number of characters in a quantity, including the unit
MAX_QUANTITY_LENGTH = 200


def _look_up_unit(text: str) -> tuple[int, ...] | None:
    """Look up the dimension and scale of a unit with or without an SI prefix.

    Units take precedence over prefixes: ``m`` means metre, and ``T`` means tesla.
    """
    if text in UNITS:
        return UNITS[text]
    unit, shift = UNITS.get(text[1:]), UNIT_PREFIXES.get(text[:1])
    return None if unit is None or shift is None else (unit[0] + shift, *unit[1:])


def parse_unit(text: str) -> tuple[int, ...] | None:
    """Parse a unit such as ``"A/(m s)"`` to its scale and dimensions; None if invalid.

    A unit is a product of factors, or a quotient of two products. Blanks separate the factors. Each
    factor may have a one-digit exponent.
    """
    top, slash, bottom = text.translate(_UNIT_SPELLINGS).partition("/")
    if slash and not bottom.strip():
        return None
    below = bottom.strip().removeprefix("(").removesuffix(")")
    result = [0] * 6
    for product, sign in ((top, 1), (below, -1)):
        for factor in product.split():
            match = _FACTOR.fullmatch(factor)
            unit = _look_up_unit(match[1]) if match else None
            if match is None or unit is None or (factor == "1" and factor != product.strip()):
                return None
            power = sign * int(match[2] or 1)
            result = [a + power * b for a, b in zip(result, unit, strict=True)]
    return tuple(result)


def parse_quantity(text: str, si: str) -> float:
    """Convert a string with a number and a unit to a number in the unit ``si``.

    Any other string raises ValueError.
    """
    text = text.replace("\N{MINUS SIGN}", "-")
    match = NUMBER_WITH_UNIT.fullmatch(text) if len(text) <= MAX_QUANTITY_LENGTH else None
    if match is not None and match[2].startswith(","):
        raise ValueError("a comma in a number")
    if match is None:
        raise ValueError("not a quantity")
    if not match[2] and si:
        raise ValueError("a quantity between quotes needs a unit")
    unit, target = parse_unit(match[2]), parse_unit(si)
    assert target is not None, f"{si!r} is not a unit"
    if unit is None:
        raise ValueError(f"unknown unit {match[2]!r}")
    if unit[1:] != target[1:]:
        raise ValueError(f"wrong unit {match[2]!r}")
    return float(Decimal(match[1]).scaleb(unit[0] - target[0]))
