"""Names of subcircuits: libraries that need no other file, and no two designs with one name."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace

from kc2spice.spice.circuit import Subcircuit
from kc2spice.spice.deck import Block, Deck
from kc2spice.spice.statements import statements

_NUMBER = re.compile(r"(?<![A-Za-z0-9_.])-?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![A-Za-z0-9_])")
_ORIGIN = re.compile(r"\* (?:tool:|scene:|licence:|sign:|validity:|rating:|@)")
_HASH = re.compile(r"(?m)^\* scene: .*\bhash=(\S+)")
_CARD = re.compile(r"(?im)^(?:x|\.subckt\b|\.ends\b).*(?:\n\+.*)*")


def self_contained(part: Subcircuit, helpers: Iterable[Subcircuit]) -> Subcircuit:
    """``part`` with the ``helpers`` that it instantiates behind it, as ``PART_HELPER``.

    One library file then is all that a user includes, and two of them never define one name twice.
    """
    text = part.text.rstrip("\n") + "\n"
    for helper in helpers:
        name = f"{part.name}_{helper.name}"
        kept = [line for line in helper.text.splitlines() if not _ORIGIN.match(line)]
        text = renamed(text, {helper.name: name})
        text += "\n" + renamed("\n".join(kept), {helper.name: name}) + "\n"
    return replace(part, text=text)


def renamed(text: str, names: Mapping[str, str]) -> str:
    """``text`` with other subcircuit names on ``.subckt``, ``.ends`` and X cards."""
    new = {old.lower(): name for old, name in names.items()}

    def card(match: re.Match[str]) -> str:
        words = list(re.finditer(r"[^\s+]\S*", match[0]))
        if match[0].startswith("."):
            at = words[1] if len(words) > 1 else None
        else:
            plain = [w for w in words if w[0].lower() != "params:"]
            given = next((k for k, w in enumerate(plain) if "=" in w[0]), len(plain))
            at = plain[given - 1]
        if at is None or at[0].lower() not in new:
            return match[0]
        return match[0][: at.start()] + new[at[0].lower()] + match[0][at.end() :]

    return _CARD.sub(card, text)


def design_name(part: Subcircuit) -> str:
    """``NAME_xxxxxx``: the name with a digest of scene and cards.

    Numbers enter by the hash of the scene that they follow from: the last digits of a finite
    element model are not the same on every processor, the name is.
    """
    cards = [s.text for s in statements(part.text, part.name) if s.text]
    scene = _HASH.search(part.text)
    told = "\n".join([scene[1] if scene else "", *(_NUMBER.sub("#", card) for card in cards)])
    return f"{part.name}_{hashlib.sha256(told.encode()).hexdigest()[:6]}"


def with_design_names(deck: Deck) -> Deck:
    """``deck`` whose parts have their design's name; the library files keep theirs.

    Libraries of different scenes can then stand in one deck: ngspice takes the first of two
    definitions with one name and says nothing.
    """
    new = {part.name: design_name(part) for part in deck.parts}
    parts = []
    for part in deck.parts:
        inner = re.findall(rf"(?im)^\.subckt\s+({re.escape(part.name)}\w*)", part.text)
        names = {name: new[part.name] + name[len(part.name) :] for name in inner}
        text = renamed(part.text, names)
        parts.append(replace(part, name=new[part.name], file=part.filename, text=text))
    blocks = tuple(
        Block(block.title, tuple(renamed(card, new) for card in block.cards))
        for block in deck.blocks
    )
    return replace(deck, parts=tuple(parts), blocks=blocks)
