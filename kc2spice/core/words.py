"""Near misses of words, for error messages."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

LONGEST = 200  # characters of a word that is compared with others


def did_you_mean(word: str, choices: Iterable[str]) -> str | None:
    """``did you mean 'x'?`` for a near miss; of dotted keys only the last parts are compared."""
    if len(word) > LONGEST:
        return None  # comparing takes time with the square of the length
    leaves: dict[str, str] = {}
    for choice in choices:
        leaves.setdefault(choice.rpartition(".")[2], choice)
    near = difflib.get_close_matches(word.rpartition(".")[2], leaves, n=1, cutoff=0.7)
    return f"did you mean {leaves[near[0]]!r}?" if near else None
