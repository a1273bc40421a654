"""Decks from disk, to be linted or translated."""

from __future__ import annotations

import re
from pathlib import Path

from kc2spice.core.errors import UsageError
from kc2spice.core.foreign import read_bounded, text_of
from kc2spice.netlist.circuit import Param, Pin, Subcircuit
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.expression import literal
from kc2spice.netlist.statements import Statement, beside, statements

LARGEST = 100_000_000  # bytes of one file
_PIN = re.compile(r"\* @pin \d+ (\w+) unit=(\S+) flow=(\S+)")
_PARAM = re.compile(r"\* @param (\w+)=(\S+) unit=(\S+)(?: range=(\S+)\.\.(\S+))? ?(.*)")


def read_lib(path: str | Path) -> list[Subcircuit]:
    """The parts of a library file with the pins, units and parameters that its heads declare.

    A subcircuit without a head counts as a part if no other of the file instantiates it; its pins
    are electrical and its parameters have no unit.

    Raises
    ------
    UsageError : no such file, no text, no subcircuit in it, or a head that does not fit its card.
    """
    path = Path(path)
    try:
        text = text_of(read_bounded(path, LARGEST))
    except (OSError, ValueError) as error:
        raise UsageError("cannot read library", where=str(path), got=str(error)) from None
    parts = subcircuits(text, path.name)
    if not parts:
        raise UsageError("no subcircuit in this library", where=str(path), expected=".subckt")
    return parts


def subcircuits(text: str, file: str) -> list[Subcircuit]:
    """The parts in the ``text`` of a library ``file``, as :func:`read_lib` gives them."""
    cards = statements(text, file)
    depth, heads = 0, list[Statement]()
    called: set[str] = set()
    for s in cards:
        if s.keyword == ".subckt" and depth == 0 and len(s.words) > 1:
            heads.append(s)
        depth += (s.keyword == ".subckt") - (s.keyword == ".ends")
        if s.keyword.startswith("x"):
            plain = [w for w in s.words if "=" not in w and w.lower() != "params:"]
            called.add(plain[-1].lower())
    declared = [s for s in heads if any(map(_PIN.match, s.comments))]
    shown = declared or [s for s in heads if s.words[1].lower() not in called]
    return [_part(s, text, file) for s in shown]


def _part(s: Statement, text: str, file: str) -> Subcircuit:
    words = [w for w in s.words[2:] if w.lower() != "params:"]
    names = [w for w in words if "=" not in w]
    defaults = dict(w.split("=", 1) for w in words if "=" in w)
    pins = [Pin(*m.groups()) for m in map(_PIN.match, s.comments) if m]
    if pins and [p.name.lower() for p in pins] != [n.lower() for n in names]:
        raise UsageError(
            "the head does not list the pins of its subcircuit",
            where=s.where,
            got=" ".join(p.name for p in pins),
            expected=" ".join(names),
        )
    told = {m[1].lower(): m for m in map(_PARAM.match, s.comments) if m}
    params = tuple(_param(name, text, told.get(name.lower()), s) for name, text in defaults.items())
    return Subcircuit(
        s.words[1], tuple(pins or (Pin(n, "V", "A") for n in names)), params, text, file
    )


def _param(name: str, default: str, told: re.Match[str] | None, s: Statement) -> Param:
    given = literal(default, where=s.where)
    value = float("nan") if given is None else given
    if told is None:
        return Param(name, value, "-", "")
    low, high = (float(told[4] or "-inf"), float(told[5] or "inf"))
    return Param(name, value, told[3], told[6], low, high)


def read_deck(main: Path) -> Deck:
    """A deck from disk: ``main`` and the files in its directory that it includes.

    Raises
    ------
    UsageError : a file is missing or no text.
    """
    files: dict[str, str] = {}
    waiting = [main.name]
    while waiting:
        name = waiting.pop()
        try:
            text = text_of(read_bounded(main.parent / name, LARGEST))
            files[name] = text.replace("\r\n", "\n")
        except (OSError, ValueError) as error:
            if name == main.name:
                raise UsageError("cannot read netlist", where=str(main), got=str(error)) from None
            continue  # named with its line when the circuit is read
        for s in statements(files[name], name):
            named = s.text.split(None, 1)[1:]
            if s.keyword in (".include", ".inc") and named:
                target = beside(name, named[0].strip("\"' "))
                waiting += [target] if target not in files else []
    text = files.pop(main.name)
    return Deck(name=main.stem, text=text, more=files)
