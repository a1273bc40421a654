"""Numbers with units at the TOML edge: ``"0.5 mm"`` becomes ``5e-4`` in SI."""

from __future__ import annotations

import math
import re

from kc2spice.errors import UsageError

_PREFIX = {
    "": 1.0, "p": 1e-12, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "c": 1e-2,
    "k": 1e3, "M": 1e6, "G": 1e9, "T": 1e12,
}  # fmt: skip
_BASE = (
    "m", "s", "Hz", "V", "A", "N", "kg", "g", "F", "H", "Ohm", "Pa", "T", "C/m2", "N/m", "kg/m3",
    "m/s", "m/s2", "A/m", "A/(m s)", "A s/m", "s/m", "1/s", "K",
)  # fmt: skip
_NUMBER = re.compile(r"^\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*$")


def _scale(unit: str, si: str) -> float | None:
    """Factor from ``unit`` to ``si``, or None where the two do not have one dimension."""
    unit = unit.replace("Ω", "Ohm").replace("²", "2").replace("³", "3")
    if unit == "%" and si == "":
        return 1e-2
    if si == "kg" and unit.endswith("g"):
        prefix = _PREFIX.get(unit[:-1])
        return None if prefix is None else prefix * 1e-3
    if unit == si:
        return 1.0
    if si in ("N/m", "m/s", "A/m", "kg/m3", "m/s2"):  # quotients: scale both sides
        num, _, den = unit.partition("/")
        snum, _, sden = si.partition("/")
        power = 1
        if sden[-1:].isdigit():
            power = int(sden[-1])
            if not den.endswith(sden[-1]):
                return None
            den, sden = den[:-1], sden[:-1]
        top, bottom = _scale(num, snum), _scale(den, sden)
        return None if top is None or bottom is None else top / bottom**power
    if si and unit.endswith(si):
        return _PREFIX.get(unit[: -len(si)])
    return None


def quantity(value: object, si: str, *, where: str | None = None) -> float:
    """Return ``value`` in the SI unit ``si``.

    A number is taken as SI already; a string is a number with a unit (``"100 V"``, ``"25 us"``).

    Raises
    ------
    UsageError : not a finite number, or a unit of another dimension.
    """
    expected = f'a number in {si or "1"}, or a string such as "1 {si}"' if si else "a plain number"
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise UsageError("not a quantity", where=where, got=repr(value), expected=expected)
    if isinstance(value, str):
        match = _NUMBER.match(value)
        if match is None:
            raise UsageError("not a quantity", where=where, got=repr(value), expected=expected)
        number, unit = float(match.group(1)), match.group(2)
        scale = _scale(unit, si) if unit else 1.0
        if scale is None:
            raise UsageError(f"wrong unit {unit!r}", where=where, got=repr(value), expected=expected)
        result = number * scale
    else:
        result = float(value)
    if not math.isfinite(result):
        raise UsageError("not a finite number", where=where, got=repr(value), expected=expected)
    return result
