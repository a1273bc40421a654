"""Netlist text to statements: continuation lines joined, comments set apart, words split."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import PurePosixPath

from kc2spice.core.errors import UsageError

OPTION_CARDS = frozenset((".options", ".option", ".opt"))
_OPEN, _CLOSE = "({[", ")}]"
_INLINE = re.compile(r";|(?<=\s)\$(?=\s)|//")  # what starts a comment behind a card


@dataclass(frozen=True)
class Statement:
    """One logical line.

    ``text`` has its continuation lines joined and no comments; ``comments`` are the raw comment
    and blank lines above it; ``line`` counts from 1 and is that of its first physical line.
    """

    file: str
    line: int
    text: str
    comments: tuple[str, ...] = ()

    @property
    def where(self) -> str:
        """``file:line`` for error messages."""
        return f"{self.file}:{self.line}"

    @property
    def keyword(self) -> str:
        """First word in lower case, ``""`` for trailing comments."""
        return self.text.split(None, 1)[0].lower() if self.text else ""

    def error(self, message: str, expected: str | None = None) -> UsageError:
        """That it is no card that can be read."""
        return UsageError(message, where=self.where, got=self.text[:120], expected=expected)

    @cached_property
    def words(self) -> list[str]:
        """Words; brackets and quotes hold together, ``a = b`` is one word ``a=b``."""
        return words(self.text)


def statements(text: str, file: str, *, title: bool = False) -> list[Statement]:
    """All statements of a file, in order; the last one may have comments only.

    ``title``: the first line is the deck's title, whatever it says, and counts as a comment.
    """
    heads: list[tuple[int, tuple[str, ...]]] = []  # first line and comments of each statement
    texts: list[list[str]] = []
    pending: list[str] = []  # comment lines behind the newest statement
    lines = text.splitlines()
    for number, raw in enumerate(lines, 1):
        line = raw.strip()
        if not line or line.startswith("*") or (title and number == 1):
            pending.append(raw.rstrip())
        elif line.startswith("+") and texts:
            texts[-1].append(split_comment(line[1:])[0])
        elif line := split_comment(line)[0]:
            heads.append((number, tuple(pending)))
            texts.append([line])
            pending = []
    if pending:
        heads.append((len(lines) + 1, tuple(pending)))
        texts.append([])
    return [
        Statement(file, number, " ".join(parts).rstrip(), notes)
        for (number, notes), parts in zip(heads, texts, strict=True)
    ]


def words(text: str) -> list[str]:
    """Split on blanks outside brackets and quotes; blanks around a bare ``=`` are dropped."""
    return list(_split(_tight(text)))


def beside(file: str, target: str) -> str:
    """Name of the file that ``file`` includes as ``target``: paths count from where they stand."""
    return str(PurePosixPath(file).parent / target)


def split_comment(line: str) -> tuple[str, str]:
    """A line without its comment, and the text of that."""
    match = _INLINE.search(line)
    if match is None:
        return line.strip(), ""
    return line[: match.start()].strip(), line[match.end() :].strip()


def _tight(text: str) -> str:
    # Only the first of several blanks can begin a match: a run of them is read once.
    return re.sub(r"(?<!\s)\s*(?<![=<>!])=(?!=)\s*", "=", text)


def _split(text: str) -> Iterator[str]:
    depth, quote, word = 0, "", ""
    for ch in text:
        if quote:
            quote = "" if ch == quote else quote
        elif ch in "\"'":
            quote = ch
        elif ch in _OPEN:
            depth += 1
        elif ch in _CLOSE:
            depth -= 1
        if ch.isspace() and depth <= 0 and not quote:
            if word:
                yield word
            word = ""
        else:
            word += ch
    if word:
        yield word
