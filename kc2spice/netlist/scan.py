"""Third-party circuits are programs: reads them before a simulator does, refuses what could act.

Nothing is let through because it was not recognised: commands, element letters, options and file
names are allowed by name. The text that is checked is the one that is written, with every include
in its place: the simulator opens no file that was not written here. A circuit that needs more can
be trusted by its user, word for word.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from kc2spice.core.foreign import plain_name
from kc2spice.netlist.flat import Line, flatten, refusal
from kc2spice.netlist.statements import Statement, split_comment, statements

# fmt: off
COMMANDS = frozenset((
    ".subckt", ".ends", ".model", ".param", ".params", ".func", ".global", ".ic", ".nodeset",
    ".temp", ".options", ".option", ".opt", ".end", ".title", ".tran", ".ac", ".dc", ".op", ".tf",
    ".noise", ".four", ".meas", ".measure", ".save", ".print", ".plot", ".probe", ".width", ".if",
    ".elseif", ".else", ".endif",
))
_OPTION_CARDS = frozenset((".options", ".option", ".opt"))
OPTIONS = frozenset((
    "abstol", "acct", "autostop", "badmos3", "bypass", "chgtol", "convabsstep", "convstep",
    "cshunt", "defad", "defas", "defl", "defnrd", "defnrs", "defw", "ebdw", "gmin", "gminsteps",
    "interp", "itl1", "itl2", "itl3", "itl4", "itl5", "itl6", "keepopinfo", "list", "maxevtiter",
    "maxopalter", "maxord", "method", "minbreak", "mu", "noacct", "noinit", "node", "nomod",
    "nopage", "noopac", "noopalter", "noopiter", "numdgt", "opts", "oldlimit", "pivrel", "pivtol",
    "post", "probe", "ramptime", "reltol", "rseries", "rshunt", "savecurrents", "scale", "seed",
    "sparse", "srcsteps", "temp", "tnom", "trtol", "trytocompact", "vntol", "warn", "xmu",
))
_ELEMENTS = frozenset("bcdefghijklmqrstuvwxz")
_SHELL_WORDS = frozenset((
    "shell", "system", "codemodel", "source", "load", "exec", "alias", "osdi", "write", "wrdata",
    "hardcopy", "cd", "set", "unset", "pre_codemodel", "pre_osdi", "quit", "exit",
))
# fmt: on
_FILES = re.compile(
    r"(?i)\b(\w*file|simulation|lib|library|process)\s*=|\b\w*file\s*\(|"
    r"\b(table|spline|fasttable)\s*\(\s*[\"']"
)
_HIDDEN = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e]")
_STRANGE_BLANK = re.compile(r"[^\S \t]")
_DISGUISED = re.compile(r"(?i)^[\s+;$/#&]*\.(control|endc|exec|inc|lib|codemodel)")
_COMMAND_COMMENT = re.compile(r"(?i)^\s*\*(#|ng_script)")
_PROGRAMS = re.compile(r"(?i)\b(d_process|d_cosim|filesource|d_source|d_state|table[23]d)\b")


@dataclass(frozen=True)
class Threat:
    """A line that could act on the machine, and why."""

    where: str
    reason: str
    text: str


def third_party(path: Path, *, trust: bool = False, home: Path | None = None) -> dict[str, str]:
    """A circuit with all that it includes as one text, ``{file name of the deck: text}``.

    Parameters
    ----------
    trust : take the circuit as it is; its user answers for it.
    home : directory that the circuit and its includes are in; that of ``path`` unless given.

    Raises
    ------
    UsageError : not readable as text, too large, or a line that could run a program, read or
        write a file, or reach outside the circuit's own directory.
    """
    lines = checked_lines(path, trust=trust, home=home)
    return {plain_name(path.name): text_of_lines(lines)}


def checked_lines(path: Path, *, trust: bool = False, home: Path | None = None) -> list[Line]:
    """The lines of :func:`third_party`, which raises as this does."""
    lines = flatten(path, home or path.parent, trust=trust)
    if not trust:
        refuse(_threats(lines), str(path))
    return lines


def text_of_lines(lines: Sequence[Line]) -> str:
    """Lines as one text."""
    return "\n".join(line.text for line in lines)


def cards(lines: Sequence[Line], *, title: bool = False) -> Iterator[tuple[Statement, str]]:
    """Every card, its continuation lines joined, with ``file:line`` of where it begins."""
    for card in statements(text_of_lines(lines), "", title=title):
        if card.text:
            yield card, lines[card.line - 1].where


def refuse(threats: Iterable[Threat], path: str) -> None:
    """Raise the first threat, if there is one.

    Raises
    ------
    UsageError : there is.
    """
    for first in threats:
        raise refusal(first.reason, path, first.where, first.text)


def _threats(lines: Sequence[Line]) -> Iterator[Threat]:
    """First those of lines as they stood: cards are what they seem only if there is none."""
    for line in lines:
        yield from _raw_threats(line)
    yield from _card_threats(lines)


def _raw_threats(line: Line) -> Iterator[Threat]:
    """What is wrong with a line as it stood in its file, whatever it continues or comments on."""
    text = line.raw.rstrip("\r")
    if _HIDDEN.search(text) or "\r" in text:
        yield Threat(line.where, "has control characters that can hide text", repr(text))
    if _COMMAND_COMMENT.match(text):
        yield Threat(line.where, "has a comment that the simulator runs as a command", text)
    if text.lstrip(" \t").startswith("*"):
        return
    if match := _DISGUISED.match(text):
        yield Threat(line.where, f"has a {match[1].lower()} command", text)
    if _STRANGE_BLANK.search(split_comment(text)[0]):
        yield Threat(line.where, "has blanks that the simulator does not take for any", text)
    if "`" in text:
        yield Threat(line.where, "has a back quote, which runs a program", text)


def _card_threats(lines: Sequence[Line]) -> Iterator[Threat]:
    """What is wrong with a card once its continuation lines are joined."""
    for card, where in cards(lines):
        for reason in _reasons(card):
            yield Threat(where, reason, card.text)


def _reasons(card: Statement) -> Iterator[str]:
    key = card.keyword
    if key.startswith(".") or key in _SHELL_WORDS:
        if key not in COMMANDS:
            yield f"has the command {key}"
    elif key[0] not in _ELEMENTS:
        yield "has a card that is no element"
    if key in _OPTION_CARDS:
        names = (word.partition("=")[0].lower() for word in card.words[1:])
        for unknown in (name for name in names if name not in OPTIONS):
            yield f"sets the option {unknown[:40]}, which is more than one of accuracy"
    if _FILES.search(card.text):
        yield "reads or writes a file"
    if _PROGRAMS.search(card.text):
        yield "uses a code model that can run programs"
