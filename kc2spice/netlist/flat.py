"""A user's circuit as one text, with what it includes in its place.

The simulator is never left to find a file: names, continuation and comments are read here under its
own rules, and what is written has one spelling only. Lines end in a line feed, blanks are blanks, a
comment begins with ``*`` or behind ``;``, a line that goes on has a ``+`` in front, and no include
is left.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from kc2spice.core.errors import UsageError
from kc2spice.core.foreign import name_threat, read_bounded
from kc2spice.netlist.cards import comment
from kc2spice.netlist.statements import split_comment

LARGEST = 4_000_000  # bytes of one file, and characters of the whole text
MOST = 64  # files of one circuit
# The simulator takes any word that begins like this, behind blanks or not.
_INCLUDE = re.compile(r"(?i)\s*\.inc\S*(.*)", re.DOTALL)
_TARGET = re.compile(r"\"([^\"]*)\"|'([^']*)'|([^\s\"']+)")
_END = re.compile(r"(?i)\.end(?=\s|$)")
_GOES_ON = "\\\\"  # two backslashes at the end of a line


@dataclass(frozen=True)
class Line:
    """One line as it will be written, ``file:line`` of where it comes from, and how it stood."""

    text: str
    where: str
    raw: str


def flatten(path: Path, home: Path, *, trust: bool, inside: bool = False) -> list[Line]:
    """Lines of ``path`` and of what it includes from below ``home``, in their places.

    ``trust`` takes lines as they stand and includes from anywhere; an include that cannot be read
    is then left to the simulator. With ``inside`` as well lines are taken as they stand, but only
    files below ``home`` are opened: for a look at a circuit that nobody trusted yet.

    Raises
    ------
    UsageError : not readable as text, too large or too many, an include in a circle, or one that
        leads out of ``home``.
    """
    return list(_Reader(path, home, trust, inside).lines(path.name, path, str(path), ()))


def is_include(line: str) -> bool:
    """Whether the simulator takes the line ``line`` for an include."""
    return _INCLUDE.match(line) is not None


@dataclass
class _Reader:
    main: Path
    home: Path
    trust: bool
    inside: bool
    files: int = 0
    size: int = 0

    def lines(self, name: str, path: Path, where: str, chain: tuple[Path, ...]) -> Iterator[Line]:
        """Lines of the file ``path``, which is called ``name``, named at ``where``."""
        real = path.resolve()
        if real in chain:
            got = " -> ".join(file.name for file in (*chain, real))
            raise UsageError("include goes in a circle", where=where, got=got)
        goes_on = False
        for number, raw in enumerate(self._text(name, real, where).split("\n"), 1):
            place = f"{name}:{number}"
            if is_include(raw):
                if goes_on and not self.trust:
                    raise self._refused("goes on in an include", place, raw)
                yield from self._included(raw, name, path, place, (*chain, real))
            elif self.trust:
                yield Line(raw, place, raw)
            else:
                line, goes_on = _canonical(raw, goes_on)
                yield Line(line, place, raw)

    def _included(
        self, raw: str, name: str, path: Path, where: str, chain: tuple[Path, ...]
    ) -> Iterator[Line]:
        target = self._target(raw, where)
        file = path.parent / target
        if self.trust:
            if not target or not _readable(file) or (self.inside and self._outside(file)):
                yield Line(raw, where, raw)
                return
            inner = target
        else:
            inner = str(PurePosixPath(name).parent / target)
        begin, end = f"* begin of {comment(inner)}", f"* end of {comment(inner)}"
        yield Line(begin, where, begin)
        yield from self.lines(inner, file, where, chain)
        yield Line(end, where, end)

    def _outside(self, file: Path) -> bool:
        return not file.resolve().is_relative_to(self.home.resolve())

    def _target(self, raw: str, where: str) -> str:
        """The file that the include ``raw`` names: one word, or one text in quotes."""
        match = _INCLUDE.match(raw)
        rest = split_comment(match[1])[0].strip() if match else ""
        found = _TARGET.fullmatch(rest)
        target = next((text for text in found.groups() if text), "") if found else ""
        if not self.trust:
            reason = "more than one word" if rest and found is None else name_threat(target)
            if reason:
                raise self._refused(f"includes {reason}", where, raw)
        return target

    def _refused(self, reason: str, where: str, text: str) -> UsageError:
        return refusal(reason, str(self.main), where, text)

    def _text(self, name: str, real: Path, where: str) -> str:
        self.files += 1
        if self.files > MOST:
            expected = f"at most {MOST}"
            raise UsageError("includes too many files", where=str(self.main), expected=expected)
        if (self.inside or not self.trust) and self._outside(real):
            message = "the include leads out of the circuit's directory"
            raise UsageError(message, where=where, got=name)
        try:
            data = read_bounded(real, LARGEST - self.size)
            self.size += len(data)
            return _decoded(data).replace("\r\n", "\n").replace("\r", "\n")
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            expected = f"a text file, at most {LARGEST} bytes with all that it includes"
            raise UsageError(
                "cannot include this", where=where, got=f"{name}: {reason}", expected=expected
            ) from None


def refusal(reason: str, path: str, where: str, text: str) -> UsageError:
    """The error for a line ``text`` at ``where`` of the circuit ``path``."""
    return UsageError(
        f"the included circuit {reason}",
        where=f"{path} ({where})" if where not in path else path,
        got=text[:120],
        expected="subcircuits, models, parameters and elements only",
        hint="read the file; if you trust every line of it, repeat with --trust",
    )


def _canonical(raw: str, goes_on: bool) -> tuple[str, bool]:
    """A line in the one spelling that every reader understands alike, and whether it goes on."""
    line = raw.replace("\t", " ").strip(" ")
    if not line or line.startswith("*"):
        return line, goes_on
    card, note = split_comment(line)
    follows = card.endswith(_GOES_ON)
    if follows:
        card = card[: -len(_GOES_ON)].rstrip()
    if _END.match(card):
        card, note = "", f"{card} {note}".rstrip()  # the deck ends where we say
    if goes_on and card and not card.startswith("+"):
        card = f"+ {card}"
    if not card:
        return f"* {note}".rstrip(), follows or goes_on
    return f"{card} ; {note}" if note else card, follows


def _readable(path: Path) -> bool:
    try:
        return path.is_file() and path.stat().st_size <= LARGEST
    except OSError:  # a name too long, a directory that is closed
        return False


def _decoded(data: bytes) -> str:
    """UTF-8, else the Windows code page in which many vendors write their micro signs."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252")
