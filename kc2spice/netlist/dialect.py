"""The same netlist for other simulators: every construct is read and written anew, none by luck.

ngspice is the reference; ``spelling`` knows what Xyce and LTspice say instead, ``veriloga`` writes
the parts as modules.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import reduce

from kc2spice.core.errors import UsageError
from kc2spice.netlist.circuit import Subcircuit
from kc2spice.netlist.deck import Deck, terms
from kc2spice.netlist.elements import circuit
from kc2spice.netlist.lint import GROUND
from kc2spice.netlist.osdi import testbench
from kc2spice.netlist.spelling import ANALYSES, Dialect, LTspice, Setup, Xyce
from kc2spice.netlist.statements import Statement, statements
from kc2spice.netlist.veriloga import library

SPEAKERS: dict[str, type[Dialect]] = {"xyce": Xyce, "ltspice": LTspice}
DECKS = ("ngspice", *SPEAKERS)
DIALECTS = (*DECKS, "verilog-a")
_RUN_LINE = re.compile(r"(\* Run it with:\s+)ngspice -b (\S+).*")
_NGSPICE_COMMAND = re.compile(r"\*.*\bngspice (-\w|\w+_plot)")  # other commands of a deck's head
_REASON = re.compile(r"\* {8}\S")  # of an option, on the line behind it


def translate(deck: Deck, dialect: str) -> Deck:
    """``deck`` with all its files in the words of ``dialect``; ``ngspice`` leaves it alone.

    Raises
    ------
    UsageError : an unknown dialect, or a construct that it cannot say.
    """
    if dialect == "ngspice":
        return deck
    if dialect not in SPEAKERS:
        raise UsageError(
            "unknown dialect", where="--dialect", got=dialect, expected=", ".join(DIALECTS)
        )
    speaker = SPEAKERS[dialect](_setup(deck))
    files = {
        name: _translated(text, name, speaker, title=name == deck.main)
        for name, text in deck.files.items()
    }
    vectors = {
        key: (_sum((sign, speaker.vector(vector)) for sign, vector in terms(expression)), factor)
        for key, (expression, factor) in deck.vectors.items()
    }
    text = files.pop(deck.main)
    return replace(deck, text=text, more=files, parts=(), options=(), vectors=vectors)


def translate_text(text: str, name: str, dialect: str) -> str:
    """One library file in the words of ``dialect``.

    Raises
    ------
    UsageError : a construct that the dialect cannot say.
    """
    return _translated(text, name, SPEAKERS[dialect](Setup()), title=False)


def dialect_files(
    deck: Deck | None, subcircuits: Iterable[Subcircuit], dialect: str
) -> dict[str, str]:
    """``{file name: text}`` of ``deck`` in ``dialect``, or ``verilog-a`` modules of its parts.

    Verilog-A describes devices: a part that cannot be a module (pulse generators, transistors)
    comes along as the library that it is, and ``verilog-a.txt`` says which and why. A testbench
    ``NAME_osdi.cir`` runs the compiled modules in ngspice.

    Raises
    ------
    UsageError : an unknown dialect, a construct that it cannot say, or not one module.
    """
    if dialect != "verilog-a":
        return dict(translate(deck, dialect).files) if deck else {}
    parts = tuple(subcircuits)
    files: dict[str, str] = {}
    left_out: list[UsageError] = []
    modules: list[Subcircuit] = []
    for part in parts:
        try:
            files |= library([part], parts)
            modules.append(part)
        except UsageError as error:
            left_out.append(error)
    if left_out and not files:
        raise left_out[0]
    if left_out:
        files["verilog-a.txt"] = (
            "Not written as modules:\n\n" + "\n\n".join(map(str, left_out)) + "\n"
        )
    return files | (testbench(deck, modules) if deck else {})


def _sum(signed: Iterable[tuple[float, str]]) -> str:
    """Terms as one expression."""
    return "".join(("-" if sign < 0 else "+") + text for sign, text in signed).removeprefix("+")


def _setup(deck: Deck) -> Setup:
    cards = statements(deck.files[deck.main], deck.main)
    analysis = min({s.keyword for s in cards} & set(ANALYSES), default=".tran")
    uic = any(s.keyword == ".tran" and "uic" in map(str.lower, s.words) for s in cards)
    starting = () if uic or analysis != ".tran" else tuple(dict.fromkeys(_starting(deck)))
    return Setup(analysis, uic, deck.controlled, starting)


def _starting(deck: Deck) -> Iterator[str]:
    """Nodes of the deck at which a part within an instance has an initial state."""
    try:
        top = circuit(deck.main, deck.files)
    except UsageError:  # a deck that is not whole, which lint says better
        return
    for instance in (each for each in top.elements if each.kind == "x"):
        called = top.find(instance.model or "")
        for part in called.elements if called else ():
            if "ic" in part.params:
                joined = dict(zip(called.pins, instance.nodes, strict=False)) if called else {}
                yield from (joined[n] for n in part.nodes if joined.get(n, "0") not in GROUND)


def _translated(text: str, name: str, speaker: Dialect, *, title: bool) -> str:
    lines: list[str] = []
    for s in _merged(statements(text, name, title=title), speaker.joined):
        if s.keyword == ".print":  # ngspice's own; what .save names is what a dialect prints
            continue
        said = (_RUN_LINE.sub(rf"\g<1>{speaker.command} \2", line) for line in s.comments)
        lines += [line for line in said if not _dropped(line, speaker)]
        if s.text:
            lines.append(speaker.card(s))
    return "\n".join(lines) + "\n"


def _dropped(line: str, speaker: Dialect) -> bool:
    """Commands of another simulator, and reasons that stood behind options that are now one."""
    reason = _REASON.match(line) and ".options" in speaker.joined
    return bool(_NGSPICE_COMMAND.match(line) or reason)


def _merged(cards: list[Statement], joined: frozenset[str]) -> list[Statement]:
    """Neighbouring ``.save`` cards as one: Xyce writes one file per ``.print``.

    All cards of the commands ``joined`` become one where the first of them stands, with the
    comments of all: the deck's title may be among them.
    """
    merged: list[Statement] = []
    for s in cards:
        last = merged[-1] if merged else None
        if last and s.keyword == last.keyword == ".save" and not s.comments:
            merged[-1] = _with(last, s)
        else:
            merged.append(s)
    for key in joined:
        whole = [s for s in merged if s.keyword == key]
        if len(whole) > 1:
            together = reduce(_with, whole)
            merged[merged.index(whole[0])] = together
            merged = [s for s in merged if s.keyword != key or s is together]
    return merged


def _with(first: Statement, second: Statement) -> Statement:
    more = second.text.partition(" ")[2]
    comments = first.comments + second.comments
    return replace(first, text=f"{first.text} {more}", comments=comments)
