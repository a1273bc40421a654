"""Parameters of a deck's subcircuits, changed in the finished text; no netlist is made anew."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace

from kc2spice.core.errors import UsageError
from kc2spice.scene.keys import did_you_mean
from kc2spice.spice.cards import number
from kc2spice.spice.deck import Deck

_DECLARED = re.compile(r"^\* @param (\w+)=(\S+)", re.MULTILINE)


def declared(deck: Deck) -> dict[str, float]:
    """``PART.NAME`` and default of every parameter that the deck's libraries declare."""
    return {
        f"{filename.removesuffix('.lib')}.{name}": float(value)
        for filename, text in deck.files.items()
        if filename.endswith(".lib")
        for name, value in _DECLARED.findall(text)
    }


def with_parameters(deck: Deck, values: Iterable[tuple[str, float]]) -> Deck:
    """``deck`` with other defaults for ``("PART.NAME", value)``, in the card and in the header.

    Raises
    ------
    UsageError : no part of the deck declares that parameter.
    """
    files = dict(deck.files)
    known = declared(deck)
    for key, value in values:
        if key not in known:
            hint = did_you_mean(key, known)
            raise UsageError(
                "no part of this scene has such a parameter", where=f"param.{key}",
                expected=", ".join(known), hint=hint,
            )  # fmt: skip
        part, _, name = key.partition(".")
        files[f"{part}.lib"] = _changed(files[f"{part}.lib"], name, number(value))
    return replace(deck, files=files)


def _changed(library: str, name: str, value: str) -> str:
    """Library text with ``name=value`` in its ``@param`` line and on its ``.subckt`` card."""
    lines = library.split("\n")
    for position, line in enumerate(lines):
        if line.startswith((f"* @param {name}=", ".subckt ")):
            lines[position] = re.sub(rf"(?<=\s){name}=\S+", f"{name}={value}", line)
        if line.startswith(".subckt "):
            break
    return "\n".join(lines)
