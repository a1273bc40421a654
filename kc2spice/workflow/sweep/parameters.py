"""Parameters of a deck's subcircuits, changed in the finished text; no netlist is made anew."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import replace

from kc2spice.core.errors import UsageError
from kc2spice.core.words import did_you_mean
from kc2spice.spice.cards import number
from kc2spice.spice.circuit import LEAST
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
    UsageError : no part of the deck declares that parameter, or the value is outside the range
        that the part's head gives it.
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
        _require_within(files[f"{part}.lib"], name, value)
        files[f"{part}.lib"] = _changed(files[f"{part}.lib"], name, number(value))
    parts = (replace(part, text=files[part.filename]) for part in deck.parts)
    return replace(deck, parts=tuple(parts))


def _require_within(library: str, name: str, value: float) -> None:
    """A mass of zero or a negative stiffness has no solution, or a wrong one."""
    found = re.search(rf"^\* @param {name}=\S+ unit=(\S+) range=(\S+?)\.\.(\S+)", library, re.M)
    if found is None:
        return
    unit, low, high = found[1], float(found[2]), float(found[3])
    if not low <= value <= high:
        expected = f"from {low:g} to {high:g}" if high < math.inf else f"at least {low:g}"
        if low == LEAST:
            expected = "above zero"
        raise UsageError(
            "outside the range of this parameter", where=f"param.{name}", got=f"{value:g} {unit}",
            expected=expected,
        )  # fmt: skip


def _changed(library: str, name: str, value: str) -> str:
    """Library text with ``name=value`` in its ``@param`` line and on its ``.subckt`` card."""
    lines = library.split("\n")
    for position, line in enumerate(lines):
        if line.startswith((f"* @param {name}=", ".subckt ")):
            lines[position] = re.sub(rf"(?<=\s){name}=\S+", f"{name}={value}", line)
        if line.startswith(".subckt "):
            break
    return "\n".join(lines)
