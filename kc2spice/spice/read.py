"""Decks from disk, to be linted or translated."""

from __future__ import annotations

from pathlib import Path

from kc2spice.core.errors import UsageError
from kc2spice.core.foreign import read_bounded, text_of
from kc2spice.spice.circuit import Deck
from kc2spice.spice.statements import beside, statements

LARGEST = 100_000_000  # bytes of one file


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
            if s.keyword in (".include", ".inc") and " " in s.text:
                target = beside(name, s.text.split(None, 1)[1].strip("\"' "))
                waiting += [target] if target not in files else []
    return Deck(main.stem, main.name, files, {}, None)
