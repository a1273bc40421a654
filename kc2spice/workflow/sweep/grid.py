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

from kc2spice.core.errors import UsageError, candidates, did_you_mean
from kc2spice.core.quantities import quantity
from kc2spice.scene.keys import Key
from kc2spice.scene.overrides import parse_override_value

MAX_POINTS = 10_000_000
PARAMETER = re.compile(r"param\.(\w+\.\w+)")  # PART.NAME of a subcircuit, not a scene key
_ZERO = re.compile(r"[+-]?(0+\.?0*|\.0+)([eE][-+]?\d+)?(?![\d.])")
GRAMMAR = "a:b:n, log:a:b:n, x,y,z, normal(mu,sigma,n) or uniform(a,b,n)"
_CALL = re.compile(r"(normal|uniform)\s*\((.*)\)", re.DOTALL)

Values = tuple[Any, ...]


@dataclass(frozen=True)
class Draws:
    """``n`` draws of a key: ``normal(a, b)`` or ``uniform(a, b)``."""

    kind: str
    a: float
    b: float
    n: int

    def at(self, share: np.ndarray) -> Values:
        """The values below which the given shares (n,) of all draws lie."""
        if self.kind == "uniform":
            return tuple((self.a + (self.b - self.a) * share).tolist())
        from scipy.special import ndtri

        share = np.clip(share, 2.0**-53, 1 - 2.0**-53)  # the normal quantile of 0 is infinite
        return tuple((self.a + self.b * ndtri(share)).tolist())


# --- one range ----------------------------------------------------------------------------------


def _crosses_zero(text: str) -> UsageError:
    """The error of a logarithmic range whose ends have no common sign."""
    return UsageError(
        "a log range cannot start at, end at or cross 0",
        where="--set",
        got=text,
        expected="log:FIRST:LAST:POINTS with two values above zero, or two below",
        hint="write a first and a last value of one sign",
    )


def form(text: str) -> tuple[str, list[str]]:
    """Kind of a range (``value``, ``list``, ``linear``, ``log``, ``normal``, ``uniform``), words.

    The first word is a value that the key takes.

    Raises
    ------
    UsageError : a range that has other than three words.
    """
    if text[:1] in ('"', "'"):
        return "value", [text]
    if call := _CALL.fullmatch(text):
        words = _split(call[2], ",")
        if len(words) != 3:
            last = "MEAN,DEVIATION,POINTS" if call[1] == "normal" else "LOW,HIGH,POINTS"
            raise UsageError(
                f"{call[1]} takes three values",
                where="--set",
                got=text,
                expected=f"{call[1]}({last})",
                hint=f"write {call[1]}({','.join([*words[:2], '50'])}) for fifty points"
                if len(words) == 2
                else None,
            )
        return call[1], words
    words = _split(text, ":")
    if len(words) > 1:
        kind, words = ("log", words[1:]) if words[0] == "log" else ("linear", words)
        if len(words) != 3:
            prefix = "log:" if kind == "log" else ""
            raise UsageError(
                "a range needs a first value, a last value and a number of points",
                where="--set",
                got=text,
                expected=f"{prefix}FIRST:LAST:POINTS",
                hint=f"write {prefix}{':'.join([*words[:2], '5'])} for five points"
                if len(words) == 2
                else None,
            )
        if kind == "log" and any(map(_ZERO.match, words[:2])):
            raise _crosses_zero(text)
        return kind, words
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


def key_of(name: str, keys: Mapping[str, Key]) -> Key:
    """Unit, range and type of a key, list entry, table or subcircuit parameter."""
    plain = Key(name, "" if PARAMETER.fullmatch(name) else None, None, (), "")
    return keys.get(re.sub(r"\[-?\d+\]", "", name), plain)


def parse_range(name: str, text: str, keys: Mapping[str, Key]) -> Values | Draws:
    """The range ``text`` of the key ``name``.

    Raises
    ------
    UsageError : a range that cannot be, or with values that the key cannot take.
    """
    key, (kind, words) = key_of(name, keys), form(text)
    where = f"--set '{name}={text}'"
    drawn = kind in ("normal", "uniform")

    def refused(
        message: str, got: object, expected: str = GRAMMAR, hint: str | None = None
    ) -> UsageError:
        return UsageError(message, where=where, got=got, expected=expected, hint=hint)

    if kind in ("list", "value"):
        values = [_value(where, key, word) for word in words]
    elif key.choices or (key.unit is None and (drawn or not key.integer)):
        raise refused("only numbers have such a range", name)
    elif len(words) != 3:
        raise refused(f"{kind} takes three values", ", ".join(words))
    else:
        count = words[2]
        if not count.isdecimal() or not 2 <= int(count) <= MAX_POINTS:
            expected = f"a whole number of points, 2 to {MAX_POINTS}"
            known = text.removesuffix(count) if text.endswith(count) else ""
            hint = f"write {known}5 for five points" if known else None
            raise refused("not a number of points", repr(count), expected, hint)
        a, b = (float(_value(where, key, word)) for word in words[:2])
        if kind == "normal" and b < 0:
            raise refused("a standard deviation is not negative", f"{b:g}")
        if kind == "uniform" and b < a:
            raise refused("empty range", f"{a:g} … {b:g}")
        if drawn:
            return Draws(kind, a, b, int(count))
        if kind == "log" and not a * b > 0:
            raise _crosses_zero(text)
        values = (np.geomspace if kind == "log" else np.linspace)(a, b, int(count)).tolist()
        if key.integer and not all(value == round(value) for value in values):
            raise refused("not all values are whole numbers", values[:5])
        values = list(map(int, values)) if key.integer else values
    if len(set(map(repr, values))) < len(values):
        raise refused("a value occurs twice", words)
    return tuple(values)


def _value(where: str, key: Key, text: str) -> Any:
    """One value: a number in SI, a whole number, one of the choices, or what TOML says it is."""
    if key.choices and text not in key.choices:
        choices = f"one of {candidates(text, key.choices)}"
        hint = did_you_mean(text, key.choices)
        raise UsageError("no such choice", where=where, got=repr(text), expected=choices, hint=hint)
    if key.integer and not re.fullmatch(r"[+-]?\d+", text):
        expected = "a whole number, or a range of whole numbers"
        raise UsageError("not a whole number", where=where, got=repr(text), expected=expected)
    if key.integer or key.choices or key.unit is None or text[:1] in ("[", "{"):
        return parse_override_value(text)
    return parse_value(text, key.unit, where)


def parse_value(text: str, unit: str, where: str) -> float:
    """``text`` in the SI unit ``unit``; a plain number is in it already."""
    try:
        return quantity(float(text), unit, where=where)
    except ValueError:
        return quantity(text, unit, where=where)


# --- all of them --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Plan:
    """Swept ``keys`` in the order in which they were given, and all points.

    ``blocks`` are crossed, the last one varies fastest; the keys of one block vary together.
    ``random`` names the keys that were drawn.
    """

    keys: tuple[str, ...]
    blocks: tuple[Mapping[str, Values], ...]
    random: tuple[str, ...] = ()

    @property
    def lengths(self) -> tuple[int, ...]:
        """Number of steps of each block."""
        return tuple(len(next(iter(block.values()))) for block in self.blocks)

    @property
    def size(self) -> int:
        """Number of points."""
        return prod(self.lengths)

    def values(self, index: int) -> dict[str, Any]:
        """Values of all keys at point ``index``, 0 … size - 1."""
        steps = zip(self.blocks, np.unravel_index(index, self.lengths), strict=True)
        result = {key: item[step] for block, step in steps for key, item in block.items()}
        return {key: result[key] for key in self.keys}

    def ends(self) -> list[dict[str, Any]]:
        """The first point, and those that differ from it in one block: where a number of that is
        least or largest, or where a word comes first."""
        places = [0]
        for k, block in enumerate(self.blocks):
            for values in block.values():
                numbers = all(isinstance(value, (int, float)) for value in values)
                extremes = (min(values), max(values)) if numbers else values
                steps = set(map(values.index, extremes))
                places += [step * prod(self.lengths[k + 1 :]) for step in sorted(steps)]
        return list(map(self.values, dict.fromkeys(places)))

    def distinct(self, keys: Sequence[str]) -> int:
        """Number of combinations of values of the ``keys`` in all points."""
        blocks = (
            [map(repr, v) for key, v in block.items() if key in keys] for block in self.blocks
        )
        return prod(len(set(zip(*item, strict=True))) for item in blocks if item)


def make_plan(
    ranges: Mapping[str, Values | Draws],
    *,
    zipped: bool = False,
    latin: bool = False,
    seed: int = 0,
) -> Plan:
    """Cross the ranges with each other and with the draws, or step through all together.

    One draw is a draw of all random keys, so these form one block. ``latin`` stratifies it: every
    key's n equally likely intervals are each hit once (McKay, Beckman, Conover 1979).

    Raises
    ------
    UsageError : nothing to sweep, unequal lengths, too many points.
    """
    if not ranges:
        raise UsageError(
            "nothing to sweep",
            where="sweep",
            got="no --set",
            expected="--set KEY=RANGE",
            hint="add for example  --set KEY=FIRST:LAST:POINTS",
        )
    random = {key: item for key, item in ranges.items() if isinstance(item, Draws)}
    blocks = [{key: item} for key, item in ranges.items() if not isinstance(item, Draws)]
    if random:
        count = _common({key: item.n for key, item in random.items()}, "draws")
        generator = np.random.default_rng(seed)
        shares = generator.random((len(random), count))
        if latin:
            from scipy.stats.qmc import LatinHypercube

            shares = LatinHypercube(len(random), seed=generator).random(count).T
        columns = zip(random.items(), shares, strict=True)
        blocks.append({key: item.at(share) for (key, item), share in columns})
    if zipped:
        blocks = [{key: item for block in blocks for key, item in block.items()}]
        _common({key: len(item) for key, item in blocks[0].items()}, "--zip")
    plan = Plan(tuple(ranges), tuple(blocks), tuple(random))
    if plan.size > MAX_POINTS:
        raise UsageError("too many points", got=plan.size, expected=f"at most {MAX_POINTS}")
    return plan


def _common(lengths: Mapping[str, int], where: str) -> int:
    if len(set(lengths.values())) > 1:
        got = ", ".join(f"{key}: {length}" for key, length in lengths.items())
        raise UsageError("unequal numbers of values", where=where, got=got, expected="one number")
    return next(iter(lengths.values()))
