"""Points of a sweep: combinations of ranges, joint ranges, or random samples.

A range is ``a:b:n`` (n equally spaced values from a to b), ``log:a:b:n``, ``x, y, z``,
``normal(mu, sigma, n)`` or ``uniform(a, b, n)``. Numbers are in SI units or have a unit. Any other
string is a single value.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import prod
from typing import Any

import numpy as np

from kc2spice.core.errors import UsageError, did_you_mean, list_candidates
from kc2spice.core.quantities import convert_quantity
from kc2spice.core.unit_spelling import find_range_ends
from kc2spice.core.units import NUMBER_WITH_UNIT, parse_unit
from kc2spice.core.user_warnings import warn_user
from kc2spice.netlist.scale_factors import read_user_number
from kc2spice.scene.keys import KeyDescription
from kc2spice.scene.overrides import parse_override_value

MAX_POINTS = 10_000_000
# Pattern of PART.NAME, a subcircuit parameter that is not a key of the scene.
PARAMETER_KEY = re.compile(r"param\.(\w+\.\w+)")
_ZERO_NUMBER = re.compile(r"[+-]?(0+\.?0*|\.0+)([eE][-+]?\d+)?(?![\d.])")
RANGE_GRAMMAR = "a:b:n, log:a:b:n, x,y,z, normal(mu,sigma,n) or uniform(a,b,n)"
_DISTRIBUTION = re.compile(r"(normal|uniform)\s*\((.*)\)", re.DOTALL)
# pattern of a distribution with any name, such as random(1,2,50)
_NAMED_DISTRIBUTION = re.compile(r"([A-Za-z]\w*)\s*\((.*)\)", re.DOTALL)
_NORMAL_NAMES = ("normal", "norm", "gauss", "gaussian")

Values = tuple[Any, ...]


@dataclass(frozen=True)
class RandomSample:
    """Random values of a key, distributed as ``normal(a, b)`` or ``uniform(a, b)``.

    ``n`` is the number of random values.
    """

    kind: str
    a: float
    b: float
    n: int

    def compute_quantiles(self, share: np.ndarray) -> Values:
        """Return the quantiles of the distribution at given probabilities.

        ``share`` contains the probabilities.
        """
        if self.kind == "uniform":
            return tuple((self.a + (self.b - self.a) * share).tolist())
        from scipy.special import ndtri

        # The normal distribution has infinite quantiles at the probabilities 0 and 1, so these
        # probabilities are replaced.
        share = np.clip(share, 2.0**-53, 1 - 2.0**-53)
        return tuple((self.a + self.b * ndtri(share)).tolist())


# --- one range ------------------------------------------------------------------------------------


class ProposedRangeError(UsageError):
    """Error for an invalid range, whose hint proposes another range.

    ``text`` is the invalid range, and ``proposal`` is the proposed range. By default, ``got`` is
    the invalid range, and ``hint`` is to write the proposed range.
    """

    def __init__(
        self,
        message: str,
        *,
        text: str,
        proposal: str,
        expected: str | None,
        where: str = "--set",
        got: object = None,
        hint: str | None = None,
    ) -> None:
        super().__init__(
            message,
            where=where,
            got=text if got is None else got,
            expected=expected,
            hint=hint or f"write {proposal}",
        )
        self.text, self.proposal = text, proposal


def _make_zero_crossing_error(text: str) -> UsageError:
    """Return the error about a logarithmic range that begins at, ends at or crosses 0."""
    return UsageError(
        "a log range cannot start at, end at or cross 0",
        where="--set",
        got=text,
        expected="log:FIRST:LAST:POINTS with two values above zero, or two below",
        hint="write a first and a last value of one sign",
    )


def split_range(text: str) -> tuple[str, list[str]]:
    """Return the kind of a range, and its fields as strings.

    The kinds are ``value``, ``list``, ``linear``, ``log``, ``normal`` and ``uniform``. For every
    kind of range, the first field is a possible value of the swept key, such as the mean of a
    normal distribution.

    Raises
    ------
    UsageError : the range needs exactly three fields, but has another number of fields.
    """
    if text[:1] in ('"', "'"):
        return "value", [text]
    if call := _DISTRIBUTION.fullmatch(text):
        words = _split_words(call[2], ",")
        if len(words) != 3:
            last = "MEAN,DEVIATION,POINTS" if call[1] == "normal" else "LOW,HIGH,POINTS"
            first, factor = words[0] or "1", 0.1 if call[1] == "normal" else 10
            known = words[:2] if len(words) >= 2 else [first, scale_quantity(first, factor)]
            raise ProposedRangeError(
                f"{call[1]} needs three values",
                text=text,
                expected=f"{call[1]}({last})",
                proposal=join_range(call[1], [*known, "50"]),
            )
        return call[1], words
    _require_known_distribution(text)
    _require_comma_separators(text)
    words = _split_words(text, ":")
    if len(words) > 1:
        kind, words = ("log", words[1:]) if words[0] == "log" else ("linear", words)
        if len(words) != 3 or not all(words):
            first = next((word for word in words if word and not _ZERO_NUMBER.match(word)), "1")
            stated = len(words) > 1 and all(words[:2])
            limits = words[:2] if stated else [first, scale_quantity(first, 10)]
            points = "".join(words[2:3]) or "5"
            raise ProposedRangeError(
                "a range needs a first value, a last value and a number of points",
                text=text,
                expected=join_range(kind, ["FIRST", "LAST", "POINTS"]),
                proposal=join_range(kind, [*limits, points]),
            )
        if kind == "log" and any(map(_ZERO_NUMBER.match, words[:2])):
            raise _make_zero_crossing_error(text)
        return kind, words
    if ends := find_range_ends(text, hyphen=False):
        raise ProposedRangeError(
            "this string is neither a value, nor a list of values, nor a range",
            text=text,
            got=repr(text),
            expected="a value, a list VALUE,VALUE or a range FIRST:LAST:POINTS",
            proposal=f"{':'.join(ends)}:5",
        )
    words = _split_words(text, ",")
    if len(words) > 1 and any(words) and not all(words):
        raise ProposedRangeError(
            "a value is missing beside a comma of this list",
            text=text,
            got=repr(text),
            expected="a list VALUE,VALUE without empty values",
            proposal=",".join(filter(None, words)),
        )
    return ("list", words) if len(words) > 1 else ("value", words)


def join_range(kind: str, words: Sequence[str]) -> str:
    """Return the text of a range from its kind and its fields.

    >>> join_range("log", ["1", "2", "5"]), join_range("normal", ["1", "0.1", "5"])
    ('log:1:2:5', 'normal(1,0.1,5)')
    """
    if kind in ("normal", "uniform"):
        return f"{kind}({','.join(words)})"
    prefix = "log:" if kind == "log" else ""
    return prefix + ("," if kind == "list" else ":").join(words)


def scale_quantity(word: str, factor: float) -> str:
    """Return a number with its unit, multiplied by a factor.

    A word that is not a number is returned unchanged.

    >>> scale_quantity("2 mm", 10)
    '20 mm'
    """
    number = NUMBER_WITH_UNIT.fullmatch(word)
    return f"{factor * float(number[1]):g} {number[2]}".strip() if number else word


def _require_known_distribution(text: str) -> None:
    """Reject a range with an unknown distribution, such as ``random(1,2,50)``.

    Raises
    ------
    UsageError : the text is an unknown name with three numbers in brackets.
    """
    call = _NAMED_DISTRIBUTION.fullmatch(text)
    words = _split_words(call[2], ",") if call else []
    if call and len(words) == 3 and all(map(NUMBER_WITH_UNIT.fullmatch, words)):
        kind = "normal" if call[1].lower() in _NORMAL_NAMES else "uniform"
        raise ProposedRangeError(
            f"the distribution {call[1]} does not exist",
            text=text,
            expected="normal(MEAN,DEVIATION,POINTS) or uniform(LOW,HIGH,POINTS)",
            proposal=join_range(kind, words),
        )


def _require_comma_separators(text: str) -> None:
    """Reject a list of numbers that are separated by semicolons.

    Raises
    ------
    UsageError : the text consists of numbers with semicolons between them.
    """
    words = _split_words(text, ";")
    if len(words) > 1 and all(map(NUMBER_WITH_UNIT.fullmatch, words)):
        raise ProposedRangeError(
            "this list has semicolons between its values, instead of commas",
            text=text,
            expected="a list VALUE,VALUE with commas",
            proposal=",".join(words),
        )


def require_equal_unit_use(words: Sequence[str], text: str, where: str, si_unit: str) -> None:
    """Reject numbers of which only some have a unit, such as ``10 mg:30``.

    ``text`` contains all the numbers in ``words``. Zero needs no unit.

    Raises
    ------
    UsageError : some of the numbers have a unit, and others are plain numbers other than zero.
    """
    problem = _find_unequal_unit_use(words, text, where, si_unit)
    if problem is not None:
        raise problem


def _find_unequal_unit_use(
    words: Sequence[str], text: str, where: str, si_unit: str, *, is_list: bool = False
) -> UsageError | None:
    """Find unequal use of units: return an error if only some numbers have a unit.

    The function returns None if it finds no error. A number without a unit is in the SI unit, so
    ``10 mg:30`` would be 10 mg to 30 kg. The hint repeats the typed unit, unless only the SI unit
    gives increasing values: ``100:1 kOhm`` probably means 100 Ohm to 1 kOhm. The values of a list
    (``is_list``) have no order. The other arguments are defined in :func:`require_equal_unit_use`.
    """
    numbers = list(map(NUMBER_WITH_UNIT.fullmatch, words))
    units = [number[2] for number in numbers if number and float(number[1])]
    if all(units) or not any(units):
        return None
    with_unit = next(number for number in numbers if number and number[2])
    dimension, required = parse_unit(with_unit[2]), parse_unit(si_unit)
    if dimension is None or required is None or dimension[1:] != required[1:]:
        return None  # the error about the wrong unit follows
    # the typed unit, with the blank before the unit if there is one
    unit = with_unit[0][with_unit.end(1) :]
    spellings = [f"{word}{unit}" if _lacks_unit(word) else word for word in words]
    in_si = [f"{word} {si_unit}" if _lacks_unit(word) else word for word in words]
    descending = text.startswith("normal")  # a mean is usually larger than its deviation
    if (
        si_unit
        and not is_list
        and not _are_sorted(spellings, si_unit, descending)
        and _are_sorted(in_si, si_unit, descending)
    ):
        spellings = in_si
    advice, end = "", 0
    for word, spelling in zip(words, spellings, strict=True):
        begin = text.index(word, end)
        advice, end = advice + text[end:begin] + spelling, begin + len(word)
    plain = f"a number without a unit is in {si_unit}" if si_unit else "or plain numbers only"
    return ProposedRangeError(
        "only some of these values have a unit",
        where=where,
        text=text,
        expected=f"a unit at every value; {plain}",
        proposal=f"{advice}{text[end:]}",
    )


def _lacks_unit(word: str) -> bool:
    """Return whether a word is a nonzero number without a unit."""
    number = NUMBER_WITH_UNIT.fullmatch(word)
    return number is not None and not number[2] and float(number[1]) != 0


def _are_sorted(words: Sequence[str], si_unit: str, descending: bool) -> bool:
    """Return whether quantities increase, or with ``descending`` decrease."""
    try:
        values = [parse_value(word, si_unit, word) for word in words]
    except UsageError:
        return False
    return values == sorted(values, reverse=descending)


def _split_words(text: str, separator: str) -> list[str]:
    """Split a string at separators outside of brackets, as in ``1 A/(m s),2 A/(m s)``."""
    parts, depth = [""], 0
    for character in text:
        depth += (character in "([{") - (character in ")]}")
        if character == separator and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return list(map(str.strip, parts))


def _require_absolute_deviation(words: Sequence[str], text: str, where: str) -> None:
    """Reject a normal distribution with a standard deviation in percent of the mean.

    ``words`` are the fields of the range ``text``. A mean in percent permits a deviation in
    percent.

    Raises
    ------
    UsageError : the standard deviation is in percent, but the mean is not.
    """
    mean, deviation = map(NUMBER_WITH_UNIT.fullmatch, words[:2])
    if mean and deviation and deviation[2] == "%" != mean[2] and float(mean[1]):
        absolute = scale_quantity(words[0].lstrip("+-"), abs(float(deviation[1])) / 100)
        raise ProposedRangeError(
            "the standard deviation cannot be in percent of the mean",
            where=where,
            text=text,
            got=repr(words[1]),
            expected="a standard deviation in the unit of the mean",
            proposal=join_range("normal", [words[0], absolute, words[2]]),
        )


def _convert_netlist_numbers(kind: str, words: list[str], text: str, where: str) -> list[str]:
    """Convert the values of a netlist parameter, such as ``3.3m``, to plain numbers.

    ``words`` are the fields of the range ``text``, whose ``kind`` :func:`split_range` returns.

    Raises
    ------
    UsageError : a value is not a number, or only one end of the range has a suffix.
    """
    count = len(words) if kind in ("list", "value") else 2
    plain = [repr(read_user_number(word, where)) for word in words[:count]]
    if kind == "normal":
        _require_absolute_deviation([plain[0], *words[1:]], text, where)
    numbers = list(map(NUMBER_WITH_UNIT.fullmatch, words[:count]))
    suffixes = [number[0].strip()[number.end(1) :] for number in numbers if number]
    is_range = kind not in ("list", "value")
    # zero needs no suffix
    if is_range and suffixes.count("") == 1 and all(map(float, plain)):
        common = "".join(suffixes)
        ends = [
            f"{word}{'' if suffix else common}"
            for word, suffix in zip(words[:2], suffixes, strict=True)
        ]
        raise ProposedRangeError(
            "only one of these two values has a suffix",
            where=where,
            text=text,
            expected="a suffix at both values, or two plain numbers",
            proposal=join_range(kind, [*ends, *words[2:]]),
        )
    return [*plain, *words[count:]]


def find_swept_key(name: str, keys: Mapping[str, KeyDescription]) -> KeyDescription:
    """Return the description of a swept key, or an empty one for any other name.

    ``name`` may also be the name of a list entry or of a table.
    """
    parameter = PARAMETER_KEY.fullmatch(name) is not None
    unit = "" if parameter else None
    plain = KeyDescription(name, unit, None, (), "", of_netlist=parameter)
    return keys.get(re.sub(r"\[-?\d+\]", "", name), plain)


def parse_range(name: str, text: str, keys: Mapping[str, KeyDescription]) -> Values | RandomSample:
    """Parse the range of a key, and return its values.

    ``text`` is the range, and ``name`` the name of the key.

    Raises
    ------
    UsageError : the range is not valid, or contains values that the key cannot have.
    """
    key, (kind, words) = find_swept_key(name, keys), split_range(text)
    where = f"--set '{name}={text}'"
    is_random = kind in ("normal", "uniform")
    if key.of_netlist:
        words = _convert_netlist_numbers(kind, words, text, where)

    def make_range_error(
        message: str, got: object, expected: str = RANGE_GRAMMAR, hint: str | None = None
    ) -> UsageError:
        """Return the error about an invalid range."""
        return UsageError(message, where=where, got=got, expected=expected, hint=hint)

    if key.unit is not None and not (key.choices or key.integer):
        if kind == "normal":
            _require_absolute_deviation(words, text, where)
        if kind not in ("list", "value"):
            require_equal_unit_use(words[:2], text, where, key.unit)
        # a list may contain SI numbers beside values with a unit on purpose
        elif problem := _find_unequal_unit_use(words, text, where, key.unit, is_list=True):
            warn_user(
                f"{where}: {problem.message}; numbers without a unit are "
                f"{f'in {key.unit}' if key.unit else 'not in percent'}; if all values have the "
                f"same unit, {problem.hint}"
            )
    if kind in ("list", "value"):
        values = list(map(partial(_parse_word, where, key), words))
    elif key.choices or (key.unit is None and (is_random or not key.integer)):
        hint = f"write {name}=VALUE,VALUE" if not key.choices else (
            f"write {name}={','.join(map(str, key.choices[:2]))}"
        )  # fmt: skip
        raise make_range_error(
            "this kind of range applies only to keys with numeric values", name, hint=hint
        )
    elif len(words) != 3:
        raise make_range_error(
            f"{kind} takes three values", ", ".join(words), hint=f"write the three values of {kind}"
        )
    else:
        count = words[2]
        if not count.isdecimal() or not 2 <= int(count) <= MAX_POINTS:
            expected = f"a whole number of points, 2 to {MAX_POINTS}"
            known = text.removesuffix(count) if text.endswith(count) else ""
            message = "not a number of points"
            if not known:
                raise make_range_error(message, repr(count), expected, "write 5 as last value")
            raise ProposedRangeError(
                message,
                where=where,
                text=text,
                got=repr(count),
                expected=expected,
                proposal=f"{known}5",
            )
        a, b = map(float, map(partial(_parse_word, where, key), words[:2]))
        if kind == "normal" and b < 0:
            raise make_range_error(
                "the standard deviation is negative",
                f"{b:g}",
                hint=f"write {words[1].lstrip('-')} in place of {words[1]}",
            )
        if kind == "uniform" and b < a:
            raise ProposedRangeError(
                "the range is empty",
                where=where,
                text=text,
                got=f"{a:g} … {b:g}",
                expected=RANGE_GRAMMAR,
                proposal=join_range(kind, [words[1], words[0], words[2]]),
            )
        if is_random:
            return RandomSample(kind, a, b, int(count))
        if kind == "log" and not a * b > 0:
            raise _make_zero_crossing_error(text)
        values = (np.geomspace if kind == "log" else np.linspace)(a, b, int(count)).tolist()
        if key.integer and not all(map(float.is_integer, values)):
            low, high = sorted((round(a), round(b)))
            hint = f"write {','.join(map(str, range(low, min(high, low + 4) + 1)))}"
            raise make_range_error(
                "not all values of this range are whole numbers", values[:5], hint=hint
            )
        values = list(map(int, values)) if key.integer else values
    if len(set(map(repr, values))) < len(values):
        unique_words = list(dict.fromkeys(words))
        hint = (
            f"write {name}={','.join(unique_words)}"
            if kind == "list"
            else "write two different ends"
        )
        raise make_range_error("a value occurs twice in this range", text, hint=hint)
    return tuple(values)


def _parse_word(where: str, key: KeyDescription, text: str) -> Any:
    """Return the value of a string: a number in SI units, a choice, or a TOML value."""
    if key.choices and text not in key.choices:
        hint = did_you_mean(text, key.choices) or f"for example {key.choices[0]}"
        raise UsageError(
            "this value is not one of the choices",
            where=where,
            got=repr(text),
            expected=f"one of {list_candidates(text, key.choices)}",
            hint=hint,
        )
    if key.integer and not re.fullmatch(r"[+-]?\d+", text):
        raise UsageError(
            "this value is not a whole number",
            where=where,
            got=repr(text),
            expected="a whole number, or a range of whole numbers",
            hint="write whole numbers, such as 10, or 2:10:5 for 5 values from 2 to 10",
        )
    if key.integer or key.choices or key.unit is None or text[:1] in ("[", "{"):
        return parse_override_value(text)
    return parse_value(text, key.unit, where)


def parse_value(text: str, unit: str, where: str) -> float:
    """Convert text to a value in an SI unit; a plain number already has this unit."""
    try:
        return convert_quantity(float(text), unit, where=where)
    except ValueError:
        return convert_quantity(text, unit, where=where)


# --- all ranges -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class SweepPoints:
    """Points of a sweep, with the swept ``keys`` in the order of the user.

    The points are all combinations of the steps of the ``blocks``; the last block varies fastest.
    The keys of one block vary together. ``random`` are the keys with random samples.
    """

    keys: tuple[str, ...]
    blocks: tuple[Mapping[str, Values], ...]
    random: tuple[str, ...] = ()

    @property
    def block_sizes(self) -> tuple[int, ...]:
        """Number of values in each block of keys that vary together."""
        return tuple(len(next(iter(block.values()))) for block in self.blocks)

    @property
    def size(self) -> int:
        """Number of points of the sweep."""
        return prod(self.block_sizes)

    def values(self, index: int) -> dict[str, Any]:
        """Return the value of each key at one point of the sweep.

        ``index`` is a number from 0 to size - 1.
        """
        result = dict[str, Any].fromkeys(self.keys)
        for block, step in zip(self.blocks, np.unravel_index(index, self.block_sizes), strict=True):
            for key, values in block.items():
                result[key] = values[step]
        return result

    def list_end_points(self) -> list[dict[str, Any]]:
        """List the first point, and points at which one key has an extreme value.

        A block contains keys that vary together. Each listed end point differs from the first point
        only in the keys of one block. A key with numbers has two end points, at its smallest and
        largest number. A key with strings has one end point for each different string.
        """
        indices = [0]
        for k, block in enumerate(self.blocks):
            stride = prod(self.block_sizes[k + 1 :])
            for values in block.values():
                numbers = all(isinstance(value, (int, float)) for value in values)
                extremes = (min(values), max(values)) if numbers else values
                steps = set(map(values.index, extremes))
                indices += [stride * step for step in sorted(steps)]
        return list(map(self.values, dict.fromkeys(indices)))

    def count_distinct(self, keys: Sequence[str]) -> int:
        """Return how many different combinations of values some keys have in the sweep.

        The combinations are the values of ``keys`` at each point of the sweep.
        """
        count = 1
        for block in self.blocks:
            values = [map(repr, block[key]) for key in block if key in keys]
            count *= len(set(zip(*values, strict=True))) or 1
        return count


def make_plan(
    ranges: Mapping[str, Values | RandomSample],
    *,
    zipped: bool = False,
    latin: bool = False,
    seed: int = 0,
) -> SweepPoints:
    """Plan the points of a sweep: by default, all combinations of the ranges.

    With ``zipped``, all keys vary together. Without ``zipped``, only the random keys vary together:
    each random sample contains one value of every random key. With ``latin``, each of n equally
    likely intervals of a key contains one value (McKay, Beckman, Conover 1979).

    Raises
    ------
    UsageError : there is no range, ranges have different lengths, or there are too many points.
    """
    if not ranges:
        raise UsageError(
            "the option --set is missing, so no key is swept",
            where="sweep",
            got="no --set",
            expected="--set KEY=RANGE",
            hint="add for example  --set KEY=FIRST:LAST:POINTS",
        )
    random = {key: item for key, item in ranges.items() if isinstance(item, RandomSample)}
    blocks = [{key: item} for key, item in ranges.items() if not isinstance(item, RandomSample)]
    if random:
        count = _require_common_length({key: item.n for key, item in random.items()}, "draws")
        generator = np.random.default_rng(seed)
        shares = generator.random((len(random), count))
        if latin:
            from scipy.stats.qmc import LatinHypercube

            shares = LatinHypercube(len(random), seed=generator).random(count).T
        blocks.append(
            dict(
                zip(
                    random,
                    map(RandomSample.compute_quantiles, random.values(), shares),
                    strict=True,
                )
            )
        )
    if zipped:
        together: dict[str, Values] = {}
        for block in blocks:
            together |= block
        _require_common_length({key: len(values) for key, values in together.items()}, "--zip")
        blocks = [together]
    plan = SweepPoints(tuple(ranges), tuple(blocks), tuple(random))
    if plan.size > MAX_POINTS:
        raise UsageError(
            "the sweep has too many points",
            got=plan.size,
            expected=f"at most {MAX_POINTS}",
            hint="lower the number of points of each key, or sweep fewer keys",
        )
    return plan


def _require_common_length(lengths: Mapping[str, int], where: str) -> int:
    """Return the number of values that all keys have; reject different numbers.

    Raises
    ------
    UsageError : keys have different numbers of values.
    """
    if len(set(lengths.values())) > 1:
        got = ", ".join(f"{key}: {length}" for key, length in lengths.items())
        raise UsageError(
            "the keys have different numbers of values",
            where=where,
            got=got,
            expected="the same number of values for each key",
            hint=f"write {min(lengths.values())} values for each key",
        )
    return next(iter(lengths.values()))
