"""The values of one swept key as written on the command line.

``a:b:n`` (equally spaced, both ends), ``log:a:b:n``, ``x, y, z``, ``normal(mu, sigma, n)``,
``uniform(a, b, n)``. Numbers are SI or carry a unit; anything else is no range.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from kc2spice.core.errors import UsageError
from kc2spice.core.units import quantity
from kc2spice.scene.keys import Key, did_you_mean, scene_keys

MAX_POINTS = 10_000_000
PARAMETER = "param."  # param.PART.NAME is a parameter of a part's subcircuit, not a scene key
GRAMMAR = "a:b:n, log:a:b:n, x,y,z, normal(mu,sigma,n) or uniform(a,b,n)"
_CALL = re.compile(r"(normal|uniform)\s*\((.*)\)", re.DOTALL)

Value = float | int | str


@dataclass(frozen=True)
class Grid:
    """A key with the values that it takes, in order."""

    key: str
    values: tuple[Value, ...]


@dataclass(frozen=True)
class Random:
    """A key that is drawn ``n`` times: ``normal(a, b)`` or ``uniform(a, b)``."""

    key: str
    kind: str
    a: float
    b: float
    n: int

    def quantile(self, share: np.ndarray) -> np.ndarray:
        """Values below which the given shares of all draws lie."""
        return self.a + self.b * ndtri(share) if self.kind == "normal" else (
            self.a + (self.b - self.a) * share
        )  # fmt: skip


def parse(override: str) -> Grid | Random | None:
    """The range in ``key=RANGE``; None where the right-hand side is one plain value.

    Raises
    ------
    UsageError : a range that cannot be, of an unknown key, or with values the key cannot take.
    """
    name, equals, text = (part.strip() for part in override.partition("="))
    call = _CALL.fullmatch(text)
    items = _split(text, ",")
    spans = _split(text, ":")
    if not equals or text[:1] in "\"'[{" or (not call and len(items) == 1 and len(spans) == 1):
        return None
    key = find_key(name)
    if call:
        return _random(override, key, call[1], _split(call[2], ","))
    if len(spans) > 1:
        return _span(override, key, spans)
    return _grid(override, key, [_value(override, key, item) for item in items])


def parameter(override: str) -> tuple[str, float]:
    """``("PART.NAME", value)`` of ``param.PART.NAME=value``."""
    name, _, text = (part.strip() for part in override.partition("="))
    return name.removeprefix(PARAMETER), number(override, find_key(name), text)


def find_key(name: str) -> Key:
    """The scene key, or a key that stands for a subcircuit's parameter ``param.PART.NAME``.

    Raises
    ------
    UsageError : there is no such key.
    """
    if re.fullmatch(rf"{re.escape(PARAMETER)}\w+\.\w+", name):
        return Key(name, "", None, (), "")
    keys = {key.name: key for key in scene_keys()}
    if name not in keys:
        near = did_you_mean(name, keys) or "'kc2spice scenes --keys' lists them"
        raise UsageError("unknown key", where="--set", got=name, hint=near)
    return keys[name]


def _split(text: str, separator: str) -> list[str]:
    """Parts between separators that stand outside parentheses, as in ``1 A/(m s),2 A/(m s)``."""
    parts, depth = [""], 0
    for character in text:
        depth += {"(": 1, ")": -1}.get(character, 0)
        if character == separator and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return [part.strip() for part in parts]


def _bad(override: str, message: str, got: object = None, expected: str = GRAMMAR) -> UsageError:
    return UsageError(message, where=f"--set {override!r}", got=got, expected=expected)


def _value(override: str, key: Key, text: str) -> Value:
    """One value of ``key``: a number in its SI unit, a whole number, or one of its words."""
    if key.choices:
        if text not in key.choices:
            raise _bad(override, "no such choice", repr(text), ", ".join(key.choices))
        return text
    if key.unit is None:
        try:
            return int(text)
        except ValueError:
            raise _bad(override, "not a whole number", repr(text), "whole numbers") from None
    return number(override, key, text)


def number(override: str, key: Key, text: str) -> float:
    try:
        plain: object = float(text)
    except ValueError:
        plain = text
    return quantity(plain, key.unit or "", where=f"--set {override!r}")


def _count(override: str, text: str) -> int:
    if not text.isdecimal() or not 2 <= int(text) <= MAX_POINTS:
        raise _bad(override, "not a number of points", repr(text), f"2 … {MAX_POINTS}")
    return int(text)


def _random(override: str, key: Key, kind: str, arguments: Sequence[str]) -> Random:
    if key.unit is None:
        raise _bad(override, "only numbers with a unit or ratios can be drawn", key.name)
    if len(arguments) != 3:
        raise _bad(override, f"{kind} takes three values", ", ".join(arguments))
    a, b = (number(override, key, text) for text in arguments[:2])
    if kind == "normal" and b < 0:
        raise _bad(override, "a standard deviation is not negative", f"{b:g}")
    if kind == "uniform" and b < a:
        raise _bad(override, "empty range", f"{a:g} … {b:g}")
    return Random(key.name, kind, a, b, _count(override, arguments[2]))


def _span(override: str, key: Key, fields: Sequence[str]) -> Grid:
    logarithmic = fields[0] == "log"
    fields = fields[1:] if logarithmic else fields
    if len(fields) != 3 or key.choices:
        raise _bad(override, "not a range", ":".join(fields))
    a, b = (_value(override, key, text) for text in fields[:2])
    assert not isinstance(a, str)
    assert not isinstance(b, str)
    count = _count(override, fields[2])
    if logarithmic and not a * b > 0:
        raise _bad(override, "a logarithmic range does not pass zero", f"{a:g} … {b:g}")
    values = np.geomspace(a, b, count) if logarithmic else np.linspace(a, b, count)
    if key.unit is None:
        if not np.array_equal(values, np.round(values)):
            raise _bad(override, "not all values are whole numbers", values.tolist()[:5])
        return _grid(override, key, [int(value) for value in values])
    return _grid(override, key, values.tolist())


def _grid(override: str, key: Key, values: Sequence[Value]) -> Grid:
    if len(set(values)) < len(values):
        raise _bad(override, "a value occurs twice", str(values[0]) if len(values) < 3 else None)
    return Grid(key.name, tuple(values))


def overrides(keys: Sequence[str], values: Sequence[Value]) -> tuple[str, ...]:
    """``key=value`` texts that set a point's scene keys to the last bit, without parameters."""
    pairs = zip(keys, values, strict=True)
    return tuple(f"{key}={value}" for key, value in pairs if not key.startswith(PARAMETER))


def parameters(keys: Sequence[str], values: Sequence[Value]) -> tuple[tuple[str, float], ...]:
    """``("PART.NAME", value)`` of a point's subcircuit parameters."""
    pairs = zip(keys, values, strict=True)
    return tuple(
        (key.removeprefix(PARAMETER), float(value)) for key, value in pairs
        if key.startswith(PARAMETER)
    )  # fmt: skip
