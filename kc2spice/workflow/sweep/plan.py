"""The points of a sweep: ranges of keys, crossed, stepped through together or drawn.

A range is ``a:b:n`` (equally spaced, both ends), ``log:a:b:n``, ``x, y, z``,
``normal(mu, sigma, n)`` or ``uniform(a, b, n)``. Numbers are SI or carry a unit; anything else is
one plain value.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.core.units import quantity
from kc2spice.core.words import did_you_mean
from kc2spice.scene.keys import Key
from kc2spice.scene.load import override_value

MAX_POINTS = 10_000_000
PARAMETER = "param."  # param.PART.NAME is a parameter of a part's subcircuit, not a scene key
GRAMMAR = "a:b:n, log:a:b:n, x,y,z, normal(mu,sigma,n) or uniform(a,b,n)"
_CALL = re.compile(r"(normal|uniform)\s*\((.*)\)", re.DOTALL)
_PARAMETER = re.compile(rf"{re.escape(PARAMETER)}\w+\.\w+")


@dataclass(frozen=True)
class Grid:
    """A key with the values that it takes, in order."""

    key: str
    values: tuple[Any, ...]


@dataclass(frozen=True)
class Random:
    """A key that is drawn ``n`` times: ``normal(a, b)`` or ``uniform(a, b)``."""

    key: str
    kind: str
    a: float
    b: float
    n: int

    def drawn(self, share: np.ndarray) -> Grid:
        """The values below which the given shares (n,) of all draws lie."""
        if self.kind == "uniform":
            return Grid(self.key, tuple((self.a + (self.b - self.a) * share).tolist()))
        from scipy.special import ndtri

        share = np.clip(share, 2.0**-53, 1 - 2.0**-53)  # that of 0 would be infinite
        return Grid(self.key, tuple((self.a + self.b * ndtri(share)).tolist()))


# --- one range ----------------------------------------------------------------------------------


def form(text: str) -> tuple[str, list[str]]:
    """Kind of a range (``value``, ``list``, ``linear``, ``log``, ``normal``, ``uniform``), words.

    The first word is a value that the key takes.
    """
    if text[:1] in ('"', "'"):
        return "value", [text]
    if call := _CALL.fullmatch(text):
        return call[1], _split(call[2], ",")
    words = _split(text, ":")
    if len(words) > 1:
        return ("log", words[1:]) if words[0] == "log" else ("linear", words)
    words = _split(text, ",")
    return ("list", words) if len(words) > 1 else ("value", words)


def _split(text: str, separator: str) -> list[str]:
    """Parts between separators outside of brackets, as in ``1 A/(m s),2 A/(m s)``."""
    parts, depth = [""], 0
    for character in text:
        depth += (character in "([{") - (character in ")]}")
        if character == separator and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return [part.strip() for part in parts]


def find_key(name: str, keys: Mapping[str, Key]) -> Key:
    """What is known of a key, of an entry of a list or of ``param.PART.NAME``.

    Raises
    ------
    UsageError : there is no such key.
    """
    if _PARAMETER.fullmatch(name):
        return Key(name, "", None, (), "")
    plain = re.sub(r"\[-?\d+\]", "", name)
    if plain in keys:
        return keys[plain]
    if any(key.startswith(f"{plain}.") for key in keys):  # a table, or a name instead of one
        return Key(name, None, None, (), "")
    near = did_you_mean(plain, keys) or "'kc2spice scenes --keys' lists them"
    raise UsageError("unknown key", where="--set", got=name, hint=near)


def parse(name: str, text: str, keys: Mapping[str, Key]) -> Grid | Random:
    """The range ``text`` of the key ``name``.

    Raises
    ------
    UsageError : a range that cannot be, of an unknown key, or with values the key cannot take.
    """
    key, (kind, words) = find_key(name, keys), form(text)
    where = f"--set '{name}={text}'"

    def refused(message: str, got: object, expected: str = GRAMMAR) -> UsageError:
        return UsageError(message, where=where, got=got, expected=expected)

    if kind in ("list", "value"):
        values = [_value(where, key, word) for word in words]
    elif key.choices or (key.unit is None and (kind in ("normal", "uniform") or not key.whole)):
        raise refused("only numbers have such a range", name)
    elif len(words) != 3:
        raise refused(f"{kind} takes three values", ", ".join(words))
    else:
        count = words[2]
        if not count.isdecimal() or not 2 <= int(count) <= MAX_POINTS:
            raise refused("not a number of points", repr(count), f"2 … {MAX_POINTS}")
        a, b = (float(_value(where, key, word)) for word in words[:2])
        if kind == "normal" and b < 0:
            raise refused("a standard deviation is not negative", f"{b:g}")
        if kind == "uniform" and b < a:
            raise refused("empty range", f"{a:g} … {b:g}")
        if kind in ("normal", "uniform"):
            return Random(name, kind, a, b, int(count))
        if kind == "log" and not a * b > 0:
            raise refused("a logarithmic range does not pass zero", f"{a:g} … {b:g}")
        values = (np.geomspace if kind == "log" else np.linspace)(a, b, int(count)).tolist()
        if key.whole and not all(value == round(value) for value in values):
            raise refused("not all values are whole numbers", values[:5])
        values = [int(value) for value in values] if key.whole else values
    if len({repr(value) for value in values}) < len(values):
        raise refused("a value occurs twice", words)
    return Grid(name, tuple(values))


def number(where: str, key: Key, text: str) -> float:
    """``text`` in the SI unit of ``key``."""
    try:
        return quantity(float(text), key.unit or "", where=where)
    except ValueError:
        return quantity(text, key.unit or "", where=where)


def _value(where: str, key: Key, text: str) -> Any:
    """One value: a number in SI, a whole number, one of the choices, or what TOML says it is."""
    if key.choices and text not in key.choices:
        choices = ", ".join(key.choices)
        raise UsageError("no such choice", where=where, got=repr(text), expected=choices)
    if key.whole and not re.fullmatch(r"[+-]?\d+", text):
        raise UsageError("not a whole number", where=where, got=repr(text))
    plain = key.whole or key.choices or key.unit is None or text[:1] in ("[", "{")
    return override_value(text) if plain else number(where, key, text)


# --- all of them --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Plan:
    """Swept ``keys`` in the order in which they were given, and all points.

    ``blocks`` are crossed, the last one varies fastest; the keys of one block vary together.
    ``random`` names the keys that were drawn.
    """

    keys: tuple[str, ...]
    blocks: tuple[tuple[Grid, ...], ...]
    random: tuple[str, ...] = ()

    @property
    def lengths(self) -> tuple[int, ...]:
        """Number of steps of each block."""
        return tuple(len(block[0].values) for block in self.blocks)

    @property
    def size(self) -> int:
        """Number of points."""
        return prod(self.lengths)

    def values(self, index: int) -> dict[str, Any]:
        """Values of all keys at point ``index``, 0 … size - 1."""
        return self._at(np.unravel_index(index, self.lengths))

    def _at(self, steps: Sequence[Any]) -> dict[str, Any]:
        """Values of all keys where each block has reached its step."""
        pairs = zip(self.blocks, steps, strict=True)
        found = {grid.key: grid.values[step] for block, step in pairs for grid in block}
        return {key: found[key] for key in self.keys}

    def ends(self) -> list[dict[str, Any]]:
        """The first point, and those that differ from it in one block: where a number of that is
        least or largest, or where a word comes first."""
        found = [self.values(0)]
        for k, block in enumerate(self.blocks):
            steps: dict[int, None] = {}
            for values in (grid.values for grid in block):
                if all(isinstance(value, (int, float)) for value in values):
                    steps |= {values.index(min(values)): None, values.index(max(values)): None}
                else:
                    words = [repr(value) for value in values]
                    steps |= {words.index(word): None for word in dict.fromkeys(words)}
            found += [
                self._at([step * (b == k) for b in range(len(self.blocks))]) for step in steps
            ]
        return found

    def distinct(self, keys: Sequence[str]) -> int:
        """How many combinations of values the given keys take in all points."""
        columns = [[map(repr, g.values) for g in b if g.key in keys] for b in self.blocks]
        return prod(len(set(zip(*each, strict=True))) for each in columns if each)


def make_plan(
    ranges: Sequence[Grid | Random], *, zipped: bool = False, latin: bool = False, seed: int = 0
) -> Plan:
    """Cross the grids with each other and with the draws, or step through all together.

    One draw is a draw of all random keys, so these form one block. ``latin`` stratifies it: every
    key's n equally likely intervals are each hit once (McKay, Beckman, Conover 1979).

    Raises
    ------
    UsageError : nothing to sweep, a key twice, unequal lengths, too many points.
    """
    keys = tuple(item.key for item in ranges)
    if not keys:
        raise UsageError("nothing to sweep", where="--set", expected="--set KEY=a:b:n")
    if twice := [key for key in keys if keys.count(key) > 1]:
        raise UsageError("swept twice", where="--set", got=twice[0])
    random = [item for item in ranges if isinstance(item, Random)]
    blocks: list[tuple[Grid, ...]] = [(item,) for item in ranges if isinstance(item, Grid)]
    if random:
        _same_length({item.key: item.n for item in random}, "draws")
        shape, generator = (random[0].n, len(random)), np.random.default_rng(seed)
        share = generator.random(shape[::-1]).T
        if latin:
            from scipy.stats.qmc import LatinHypercube

            share = LatinHypercube(shape[1], seed=generator).random(shape[0])
        columns = zip(random, share.T, strict=True)
        blocks.append(tuple(item.drawn(column) for item, column in columns))
    if zipped:
        blocks = [tuple(grid for block in blocks for grid in block)]
        _same_length({grid.key: len(grid.values) for grid in blocks[0]}, "--zip")
    plan = Plan(keys, tuple(blocks), tuple(item.key for item in random))
    if plan.size > MAX_POINTS:
        raise UsageError("too many points", got=plan.size, expected=f"at most {MAX_POINTS}")
    return plan


def _same_length(lengths: dict[str, int], where: str) -> None:
    if len(set(lengths.values())) > 1:
        got = ", ".join(f"{key}: {length}" for key, length in lengths.items())
        raise UsageError("unequal numbers of values", where=where, got=got, expected="one number")
