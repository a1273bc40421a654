"""Line breaks that limit cards and comments to lines of 100 characters."""

from __future__ import annotations

import re
import textwrap
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from itertools import chain

MAX_WIDTH = 100  # largest permitted number of characters in a line
# A line break after fewer characters is chosen only if no other permitted break exists.
MIN_WIDTH = 50
_EXPRESSION_START = re.compile(r"(?i)^[beg]\S*\s.*?=|=\{|^\+ ")
_SUM_BREAK = re.compile(r"(?<=[\w)}\]])(?<![\d.][eE])[-+]")
_PRODUCT_BREAK = re.compile(r"(?<=[\w)}\]])[*/]|(?<=,)(?=\S)")
_PROBE_TERM = re.compile(r"(?i)\b[vi]\([^()]*\)")


def wrap_card(card: str) -> Iterator[str]:
    """Yield the lines of a card; continuation lines begin with ``+``.

    When a simulator joins lines, it inserts a blank between them. A line therefore ends only
    between two words, before an operator, or after a comma of an expression.
    """
    for line in card.split("\n"):
        if line.startswith("*"):
            yield from _wrap_comment(line)
            continue
        begin, lead = 0, ""
        breaks = _list_possible_ends(line) if len(line) > MAX_WIDTH else ()
        while len(lead) + len(line) - begin > MAX_WIDTH:
            end = _choose_end(breaks, begin, MAX_WIDTH - len(lead))
            if not end:
                break
            yield lead + line[begin:end].rstrip()
            begin, lead = end + (line[end] == " "), "+ "
        yield lead + line[begin:]


def wrap_comments(text: str) -> Iterator[str]:
    """Yield the lines of comments; continuation lines are indented."""
    for line in text.split("\n"):
        yield from _wrap_comment(line)


def _wrap_comment(line: str) -> Iterator[str]:
    """Yield the lines of one comment; continuation lines are indented."""
    if len(line) <= MAX_WIDTH or not line.startswith("*"):
        yield line
        return
    lead = line[: len(line) - len(line.lstrip("* "))]
    further = "*   + " if line.startswith("* use: ") else "*" + " " * max(3, len(lead) + 1)
    yield from textwrap.wrap(
        _add_blanks(line[len(lead) :], MAX_WIDTH - len(further)),
        MAX_WIDTH,
        initial_indent=lead,
        subsequent_indent=further,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _add_blanks(text: str, width: int) -> str:
    """Insert blanks before operators in words that are longer than a line."""
    words = text.split(" ")
    for k, word in enumerate(words):
        if len(word) > width:
            words[k] = _SUM_BREAK.sub(r" \g<0>", word)
    return " ".join(words)


def _choose_end(breaks: Sequence[Sequence[int]], begin: int, width: int) -> int:
    """Choose the best position at which the next line may end; 0 if there is none.

    ``breaks`` contains groups of possible ends, in the order of preference.
    """
    for places in breaks:
        last = _find_last_between(places, begin + MIN_WIDTH, begin + width)
        if last:
            return last
    possible = sorted(chain.from_iterable(breaks))
    last = _find_last_between(possible, begin + 1, begin + width)
    return last or next((place for place in possible if place > begin), 0)


def _find_last_between(places: Sequence[int], low: int, high: int) -> int:
    """Return the last line-break position between two limits, or 0 if there is none.

    ``places`` are the possible positions, in increasing order.
    """
    count = bisect_right(places, high)
    return places[count - 1] if count and places[count - 1] >= low else 0


def _list_possible_ends(line: str) -> tuple[list[int], ...]:
    """Return possible positions of a line end, in groups in order of preference.

    The groups are: blanks between words, blanks inside brackets, plus and minus signs, and product
    operators or commas.
    """
    outer, inner, fixed, depth, quote = list[int](), list[int](), set[int](), 0, ""
    for place, ch in enumerate(line):
        if quote or ch in "\"'":
            fixed.add(place)
            quote = "" if ch == quote else quote or ch
        elif ch in "({[":
            depth += 1
        elif ch in ")}]":
            depth -= 1
        elif ch == " " and place > 1:
            (inner if depth > 0 else outer).append(place)
    for probe in _PROBE_TERM.finditer(line):
        fixed.update(range(*probe.span()))
    match = _EXPRESSION_START.search(line)
    begin = match.end() if match else len(line)
    signs = map(re.Match.start, _SUM_BREAK.finditer(line, begin))
    factors = map(re.Match.start, _PRODUCT_BREAK.finditer(line, begin))
    return outer, *(sorted(set(kind) - fixed) for kind in (inner, signs, factors))
