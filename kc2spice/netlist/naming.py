"""Libraries that need no other file: helpers go along under their part's name."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace

from kc2spice.netlist.circuit import Subcircuit

_ORIGIN = re.compile(r"\* (?:tool:|scene:|licence:|sign:|validity:|rating:|@)")
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
