"""Near misses of words, for error messages."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def did_you_mean(word: str, choices: Iterable[str]) -> str | None:
    """``did you mean 'x'?`` for a near miss; of dotted keys only the last parts are compared."""
    leaves: dict[str, str] = {}
    for choice in choices:
        leaves.setdefault(choice.rpartition(".")[2], choice)
    near = difflib.get_close_matches(word.rpartition(".")[2], leaves, n=1, cutoff=0.7)
    return f"did you mean {leaves[near[0]]!r}?" if near else None
