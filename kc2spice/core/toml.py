"""TOML of others: bounded in size and depth before it is parsed, so that it ends and in time.

The parser of the standard library takes time with the square of the length of a dotted key, and
calls itself once for every bracket.
"""

from __future__ import annotations

import re
import tomllib
from typing import Any

MAX_BYTES = 1_000_000  # a scene is a page of text; more is a mistake or an attack
DEEPEST = 32  # tables and arrays within each other
LONGEST_KEY = 200  # characters of one part of a key
# Strings and comments first, whatever is in them; then what nests and what chains.
_TOKEN = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*"*|\'\'\'(?:[^\']|\'(?!\'\'))*\'*'
    r'|"(?:[^"\\\n]|\\.)*"?|\'[^\'\n]*\'?|#[^\n]*|[\w-]+|[\[{]|[\]}]|\.|[ \t]+'
    r'|[^"\'#\w\-\[\]{}. \t]+',
    re.DOTALL,
)


def parse_toml(text: str) -> dict[str, Any]:
    """``tomllib.loads`` in a time and at a depth that the text cannot choose.

    Raises
    ------
    ValueError : not TOML, or longer or deeper than any honest file.
    """
    if len(text) > MAX_BYTES:
        raise ValueError(f"longer than {MAX_BYTES} characters")
    _bounded(text)
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _bounded(text: str) -> None:
    """Refuse text with deep brackets, long chains of dots, or a long word where a key stands."""
    depth = dots = 0
    for token in _TOKEN.finditer(text):
        first = token[0][0]
        if first in "[{":
            depth, dots = depth + 1, 0
        elif first in "]}":
            depth, dots = max(0, depth - 1), 0
        elif first == ".":
            dots += 1
        elif not (first in " \t\"'_-" or first.isalnum()):
            dots = 0
        elif len(token[0]) > LONGEST_KEY and (dots or _is_key(text, token.end())):
            raise ValueError(f"a key of more than {LONGEST_KEY} characters")
        if depth > DEEPEST or dots > DEEPEST:
            raise ValueError(f"nested more than {DEEPEST} deep")


def _is_key(text: str, end: int) -> bool:
    """Whether a word that ends at ``end`` is followed by what follows a key."""
    return re.compile(r"[ \t]{0,200}[.=\]]").match(text, end) is not None
