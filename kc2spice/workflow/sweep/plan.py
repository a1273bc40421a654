"""The points of a sweep: ranges of keys and how they combine, generated one by one.

A range is ``a:b:n`` (equally spaced, both ends), ``log:a:b:n``, ``x, y, z``,
``normal(mu, sigma, n)`` or ``uniform(a, b, n)``. Numbers are SI or carry a unit; anything else is
one plain value.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import prod

import numpy as np

from kc2spice import __version__
from kc2spice.core.errors import UsageError
from kc2spice.core.units import quantity
from kc2spice.core.words import did_you_mean
from kc2spice.scene.keys import Key

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
        if self.kind == "uniform":
            return self.a + (self.b - self.a) * share
        from scipy.special import ndtri

        return np.asarray(self.a + self.b * ndtri(share))


# --- one range ----------------------------------------------------------------------------------


def first_value(override: str) -> str | None:
    """``key=value`` of the first value in ``key=RANGE``, mu for draws; None for one plain value."""
    name, equals, text = (part.strip() for part in override.partition("="))
    call, spans, items = _CALL.fullmatch(text), _split(text, ":"), _split(text, ",")
    if not equals or text[:1] in "\"'[{" or (not call and len(items) == 1 and len(spans) == 1):
        return None
    if call:
        return f"{name}={_split(call[2], ',')[0]}"
    return f"{name}={spans[spans[0] == 'log'] if len(spans) > 1 else items[0]}"


def parse(override: str, keys: Mapping[str, Key]) -> Grid | Random:
    """The range in ``key=RANGE``.

    Raises
    ------
    UsageError : a range that cannot be, of an unknown key, or with values the key cannot take.
    """
    name, _, text = (part.strip() for part in override.partition("="))
    key, call, spans = find_key(name, keys), _CALL.fullmatch(text), _split(text, ":")
    if call:
        return _random(override, key, call[1], _split(call[2], ","))
    if len(spans) > 1:
        return _span(override, key, spans)
    return _grid(override, key, [_value(override, key, item) for item in _split(text, ",")])


def find_key(name: str, keys: Mapping[str, Key]) -> Key:
    """One of the scene's ``keys``, or one that stands for a parameter ``param.PART.NAME``.

    Raises
    ------
    UsageError : there is no such key.
    """
    if re.fullmatch(rf"{re.escape(PARAMETER)}\w+\.\w+", name):
        return Key(name, "", None, (), "")
    if name not in keys:
        near = did_you_mean(name, keys) or "'kc2spice scenes --keys' lists them"
        raise UsageError("unknown key", where="--set", got=name, hint=near)
    return keys[name]


def number(where: str, key: Key, text: str) -> float:
    """``text`` in the SI unit of ``key``."""
    try:
        plain: object = float(text)
    except ValueError:
        plain = text
    return quantity(plain, key.unit or "", where=where)


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
    """One value of ``key``: a number in its SI unit, a whole number, or a word."""
    if key.choices:
        if text not in key.choices:
            raise _bad(override, "no such choice", repr(text), ", ".join(key.choices))
        return text
    if key.whole:
        try:
            return int(text)
        except ValueError:
            raise _bad(override, "not a whole number", repr(text), "whole numbers") from None
    return text if key.unit is None else number(f"--set {override!r}", key, text)


def _count(override: str, text: str) -> int:
    if not text.isdecimal() or not 2 <= int(text) <= MAX_POINTS:
        raise _bad(override, "not a number of points", repr(text), f"2 … {MAX_POINTS}")
    return int(text)


def _random(override: str, key: Key, kind: str, arguments: Sequence[str]) -> Random:
    if key.unit is None:
        raise _bad(override, "only numbers with a unit or ratios can be drawn", key.name)
    if len(arguments) != 3:
        raise _bad(override, f"{kind} takes three values", ", ".join(arguments))
    a, b = (number(f"--set {override!r}", key, text) for text in arguments[:2])
    if kind == "normal" and b < 0:
        raise _bad(override, "a standard deviation is not negative", f"{b:g}")
    if kind == "uniform" and b < a:
        raise _bad(override, "empty range", f"{a:g} … {b:g}")
    return Random(key.name, kind, a, b, _count(override, arguments[2]))


def _span(override: str, key: Key, fields: Sequence[str]) -> Grid:
    logarithmic = fields[0] == "log"
    fields = fields[1:] if logarithmic else fields
    if len(fields) != 3 or key.choices or (key.unit is None and not key.whole):
        raise _bad(override, "not a range", ":".join(fields))
    a, b = (float(_value(override, key, text)) for text in fields[:2])
    count = _count(override, fields[2])
    if logarithmic and not a * b > 0:
        raise _bad(override, "a logarithmic range does not pass zero", f"{a:g} … {b:g}")
    values = np.geomspace(a, b, count) if logarithmic else np.linspace(a, b, count)
    if not key.whole:
        return _grid(override, key, values.tolist())
    if not np.array_equal(values, np.round(values)):
        raise _bad(override, "not all values are whole numbers", values.tolist()[:5])
    return _grid(override, key, [int(value) for value in values])


def _grid(override: str, key: Key, values: Sequence[Value]) -> Grid:
    if len(set(values)) < len(values):
        raise _bad(override, "a value occurs twice", str(values[0]) if len(values) < 3 else None)
    return Grid(key.name, tuple(values))


# --- all of them --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Plan:
    """Swept ``keys`` in the order of the command line and the values that they take.

    ``blocks`` are crossed, the last one varies fastest; within a block the columns (one for each
    key named by ``members``, as positions in ``keys``) vary together. ``random`` names the keys
    that were drawn.
    """

    keys: tuple[str, ...]
    members: tuple[tuple[int, ...], ...]
    blocks: tuple[tuple[tuple[Value, ...], ...], ...]
    random: tuple[str, ...]

    @cached_property
    def lengths(self) -> tuple[int, ...]:
        """Number of steps of each block."""
        return tuple(len(block[0]) for block in self.blocks)

    @property
    def size(self) -> int:
        """Number of points."""
        return prod(self.lengths)

    def values(self, index: int) -> tuple[Value, ...]:
        """Values of all keys at point ``index``, 0 … size - 1."""
        found: list[Value] = [0.0] * len(self.keys)
        for members, block in zip(reversed(self.members), reversed(self.blocks), strict=True):
            index, step = divmod(index, len(block[0]))
            for member, column in zip(members, block, strict=True):
                found[member] = column[step]
        return tuple(found)

    def column(self, key: str) -> tuple[Value, ...]:
        """All values that ``key`` takes in its block."""
        block = self.block(key)
        return self.blocks[block][self.members[block].index(self.keys.index(key))]

    def block(self, key: str) -> int:
        """Number of the block that ``key`` is in."""
        position = self.keys.index(key)
        return next(i for i, members in enumerate(self.members) if position in members)

    def order(self, slow: Sequence[int], step: int = 1) -> Iterator[int]:
        """Every ``step``-th of all points in an order in which the blocks ``slow`` vary slowest."""
        fast = [block for block in range(len(self.blocks)) if block not in slow]
        ranking = [*slow, *fast]
        strides = [prod(self.lengths[block + 1 :]) for block in ranking]
        counts = [self.lengths[block] for block in ranking]
        for number in range(0, self.size, step):
            index = 0
            for count, stride in zip(reversed(counts), reversed(strides), strict=True):
                number, step = divmod(number, count)
                index += step * stride
            yield index

    def distinct(self, keys: Sequence[str]) -> int:
        """How many combinations of values the given keys take in all points."""
        wanted = {self.keys.index(key) for key in keys}
        total = 1
        for members, block in zip(self.members, self.blocks, strict=True):
            columns = [c for m, c in zip(members, block, strict=True) if m in wanted]
            total *= len(set(zip(*columns, strict=True))) if columns else 1
        return total

    def representatives(self, keys: Sequence[str]) -> Iterator[int]:
        """One point for each combination of values of ``keys``, the first of them slowest."""
        slow = list(dict.fromkeys(self.block(key) for key in keys))
        step, seen = self.size // prod(self.lengths[block] for block in slow), set()
        for index in self.order(slow, step):
            values = dict(zip(self.keys, self.values(index), strict=True))
            chosen = tuple(values[key] for key in keys)
            if chosen not in seen:
                seen.add(chosen)
                yield index

    def digest(self, context: object) -> str:
        """Hash of ``context`` (whatever else decides the results) and of every value."""
        digest = hashlib.sha256(json.dumps([__version__, context], sort_keys=True).encode())
        digest.update(repr((self.keys, self.members)).encode())
        for block in self.blocks:
            for column in block:
                digest.update(repr(column).encode())
        return digest.hexdigest()[:16]


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
    for key in keys:
        if keys.count(key) > 1:
            raise UsageError("swept twice", where="--set", got=key)
    if not ranges:
        raise UsageError("nothing to sweep", where="--set", expected="--set KEY=a:b:n")
    columns = {i: item.values for i, item in enumerate(ranges) if isinstance(item, Grid)}
    grids, random = list(columns), [item for item in ranges if isinstance(item, Random)]
    draws = tuple(i for i in range(len(keys)) if i not in columns)
    _same_length({item.key: item.n for item in random}, "draws")
    columns |= dict(zip(draws, _drawn(random, latin, seed), strict=True))
    if zipped:
        _same_length({keys[i]: len(column) for i, column in columns.items()}, "--zip")
        members = (tuple(range(len(keys))),)
    else:
        members = (*((i,) for i in grids), *((draws,) if draws else ()))
    blocks = tuple(tuple(columns[i] for i in member) for member in members)
    plan = Plan(keys, members, blocks, tuple(item.key for item in random))
    if plan.size > MAX_POINTS:
        raise UsageError("too many points", got=plan.size, expected=f"at most {MAX_POINTS}")
    return plan


def _same_length(lengths: dict[str, int], where: str) -> None:
    if len(set(lengths.values())) > 1:
        got = ", ".join(f"{key}: {length}" for key, length in lengths.items())
        raise UsageError("unequal numbers of values", where=where, got=got, expected="one number")


def _drawn(random: Sequence[Random], latin: bool, seed: int) -> list[tuple[Value, ...]]:
    if not random:
        return []
    generator = np.random.default_rng(seed)
    n, keys = random[0].n, len(random)
    share = generator.random((keys, n))
    if latin:
        from scipy.stats.qmc import LatinHypercube

        share = LatinHypercube(keys, seed=generator).random(n).T
    share = np.clip(share, 2.0**-53, 1 - 2.0**-53)  # a normal quantile of 0 would be infinite
    return [tuple(item.quantile(u).tolist()) for item, u in zip(random, share, strict=True)]


def deck_keys(keys: Sequence[str]) -> tuple[str, ...]:
    """Those of ``keys`` that change the netlist and not only its parameters."""
    return tuple(key for key in keys if not key.startswith(PARAMETER))


def overrides(keys: Sequence[str], values: Sequence[Value]) -> tuple[str, ...]:
    """``key=value`` texts that set a point's scene keys to the last bit, without parameters."""
    pairs = zip(keys, values, strict=True)
    return tuple(f"{key}={value}" for key, value in pairs if not key.startswith(PARAMETER))


def parameters(keys: Sequence[str], values: Sequence[Value]) -> tuple[tuple[str, float], ...]:
    """``("PART.NAME", value)`` of a point's subcircuit parameters."""
    pairs = zip(keys, values, strict=True)
    return tuple(
        (key.removeprefix(PARAMETER), float(value))
        for key, value in pairs
        if key.startswith(PARAMETER)
    )
