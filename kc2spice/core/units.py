"""Numbers with units at the TOML edge: ``"0.5 mm"`` becomes ``5e-4`` in SI, exact to the last bit.

All factors are powers of ten, so a quantity is a decimal number with a shifted exponent and is
rounded once, when it becomes a float: ``"50 um"`` equals ``50e-6``.
"""

from __future__ import annotations

import math
import re
from decimal import Decimal
from numbers import Real

from kc2spice.core.errors import UsageError

EPSILON_0 = 8.8541878188e-12  # F/m, CODATA 2022; scipy.constants takes long to load
MU_0 = 4e-7 * math.pi  # H/m

BOLTZMANN = 1.380649e-23  # J/K, exact (SI, 2019)
TEMPERATURE = 300.15  # K, of a simulation unless told

_PREFIX = {
    "f": -15, "p": -12, "n": -9, "u": -6, "µ": -6, "μ": -6, "m": -3, "c": -2,
    "k": 3, "M": 6, "G": 9, "T": 12,
}  # fmt: skip


# Of each unit the power of ten and those of the base units kg, m, s, A, K.
_UNITS = {
    "g": (-3, 1, 0, 0, 0, 0), "m": (0, 0, 1, 0, 0, 0), "s": (0, 0, 0, 1, 0, 0),
    "A": (0, 0, 0, 0, 1, 0), "K": (0, 0, 0, 0, 0, 1), "1": (0, 0, 0, 0, 0, 0),
    "%": (-2, 0, 0, 0, 0, 0), "Hz": (0, 0, 0, -1, 0, 0), "N": (0, 1, 1, -2, 0, 0),
    "Pa": (0, 1, -1, -2, 0, 0), "J": (0, 1, 2, -2, 0, 0), "W": (0, 1, 2, -3, 0, 0),
    "C": (0, 0, 0, 1, 1, 0), "V": (0, 1, 2, -3, -1, 0), "Ohm": (0, 1, 2, -3, -2, 0),
    "F": (0, -1, -2, 4, 2, 0), "H": (0, 1, 2, -2, -2, 0), "Wb": (0, 1, 2, -2, -1, 0),
    "T": (0, 1, 0, -2, -1, 0),
}  # fmt: skip
_NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,4})?)\s*(.*?)\s*", re.DOTALL)
_FACTOR = re.compile(r"([A-Za-zµμ%]+|1)\^?(\d?)")
_SPELLINGS = str.maketrans({"\u2126": "Ohm", "Ω": "Ohm", "²": "2", "³": "3", "·": " ", "*": " "})
_LONGEST = 200  # characters; nothing sensible comes near it


def _symbol(text: str) -> tuple[int, ...] | None:
    """A unit with or without prefix; the unprefixed reading wins (``m`` is metre, ``T`` tesla)."""
    if text in _UNITS:
        return _UNITS[text]
    unit, shift = _UNITS.get(text[1:]), _PREFIX.get(text[:1])
    return None if unit is None or shift is None else (unit[0] + shift, *unit[1:])


def _parse_unit(text: str) -> tuple[int, ...] | None:
    """``"A/(m s)"``: one product over another one, of factors between blanks, each with an optional
    one-digit power; None where the text is no unit."""
    top, slash, bottom = text.translate(_SPELLINGS).partition("/")
    if slash and not bottom.strip():
        return None
    below = bottom.strip().removeprefix("(").removesuffix(")")
    found = [0] * 6
    for product, sign in ((top, 1), (below, -1)):
        for factor in product.split():
            match = _FACTOR.fullmatch(factor)
            unit = _symbol(match[1]) if match else None
            if match is None or unit is None or (factor == "1" and factor != product.strip()):
                return None
            power = sign * int(match[2] or 1)
            found = [a + power * b for a, b in zip(found, unit, strict=True)]
    return tuple(found)


def _from_text(text: str, si: str) -> float:
    """Value of a number with a unit; ValueError says in a few words what is wrong with it."""
    match = _NUMBER.fullmatch(text) if len(text) <= _LONGEST else None
    if match is None:
        raise ValueError("not a quantity")
    if not match[2] and si:
        raise ValueError("a quantity in quotes needs its unit")
    unit, target = _parse_unit(match[2]), _parse_unit(si)
    assert target is not None, f"{si!r} is not a unit"
    if unit is None:
        raise ValueError(f"unknown unit {match[2]!r}")
    if unit[1:] != target[1:]:
        raise ValueError(f"wrong unit {match[2]!r}")
    return float(Decimal(match[1]).scaleb(unit[0] - target[0]))


def quantity(value: object, si: str, *, where: str | None = None) -> float:
    """Return ``value`` in the SI unit ``si`` (``""`` for a plain number, where ``%`` is a unit).

    A number is taken as SI already; a string is a number with a unit (``"100 V"``, ``"25 us"``).

    Raises
    ------
    UsageError : not a finite number, or a unit of another dimension.
    """
    expected = f'a number in {si}, or a string with a unit such as "1 {si}"'
    if not si:
        expected = "a plain number"
    try:
        if isinstance(value, str):
            result = _from_text(value, si)
        elif isinstance(value, Real) and not isinstance(value, bool):
            result = float(value)
        else:
            raise ValueError("not a quantity")
        if not math.isfinite(result):
            raise ValueError("not a finite number")
    except (ValueError, OverflowError) as error:
        got = repr(value) if len(repr(value)) <= _LONGEST else repr(value)[:_LONGEST] + " ..."
        message = "not a finite number" if isinstance(error, OverflowError) else str(error)
        raise UsageError(message, where=where, got=got, expected=expected) from None
    return result
