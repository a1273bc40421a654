"""A deck of the scene that somebody edited by hand."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from kc2spice.core.errors import UsageError
from kc2spice.netlist.circuit import Element
from kc2spice.netlist.deck import Command, Deck
from kc2spice.netlist.expression import literal, vector
from kc2spice.netlist.foreign import ANALYSES, HARMLESS, accuracy, checked, refuse
from kc2spice.netlist.read import Statement, read
from kc2spice.netlist.scope import circuit, has_vector
from kc2spice.scene.parttype import Build


def edited_deck(build: Build, own: Deck, path: Path) -> tuple[Deck, Build]:
    """A netlist of the scene that somebody edited, with the results of the scene's ``own`` deck;
    and ``build`` without judgement of parts whose cards are others there, or joined otherwise.

    What it includes from its own directory is written into its place; it is refused if it could
    act on the machine, unless the build is trusted.

    Raises
    ------
    UsageError : no such file, a line that could act on the machine, a card that changes what the
        parts of the deck mean, another analysis than the scene's, vectors that the file no longer
        saves or that nothing in it has.

    Warns of options that are not the scene's: they decide how accurate its results are.
    """
    found = checked(path, trust=build.trust)
    text, cards = found.text, list(found.cards(title=True))
    refuse(cards, part=False)
    analyses = [s for s in cards if s.keyword in ANALYSES]
    if [s.keyword for s in analyses] != [f".{own.command.kind}"]:
        raise UsageError(
            "not the scene's analysis",
            where=str(path),
            got=" and ".join(s.written for s in analyses) or "none",
            expected=own.command.card,
            hint="one analysis of the same kind; its numbers are free",
        )
    saved = {vector(w.lower()) for s in cards if s.keyword == ".save" for w in s.words[1:]}
    missing = [v for v in own.saved if vector(v.lower()) not in saved]
    if saved and vector("all") not in saved and missing:
        raise UsageError(
            "the scene's metrics need vectors that this deck does not save",
            where=str(path),
            got=", ".join(missing),
            expected=".save " + " ".join(missing),
            hint="add this line; a node that was renamed needs its old name",
        )
    _require_results(own, text, path)
    _tell_options(own, cards, path)
    words = tuple(analyses[0].words[1:])
    stop = None if own.stop is None else _seconds(words, analyses[0].where)
    deck = replace(
        own,
        text=text,
        parts=(),
        blocks=(),
        options=(),
        initial={},
        stop=stop,
        command=Command(own.command.kind, words),
    )
    return deck, replace(build, unjudged=build.unjudged | _edits(own, deck))


def _edits(own: Deck, edited: Deck) -> set[str]:
    """Parts of the scene whose cards are others in the ``edited`` deck: their keys no longer say
    what is there. Also names of cards that it has besides, and of instances joined otherwise."""
    owner = {
        card.split()[0].lower(): block.title.partition(":")[0]
        for block in own.blocks
        for card in block.cards
    }
    before, now = ({e.key: e for e in deck.scope.elements} for deck in (own, edited))
    found = set()
    for key in before.keys() | now.keys():
        a, b = before.get(key), now.get(key)
        if a is None or b is None or _said(a) != _said(b):
            found.add(owner.get(key, key))
        elif a.ends != b.ends:  # an instance is still the part that its keys tell
            found.add(key if key.startswith("x") else owner.get(key, key))
    return found


def _said(card: Element) -> tuple[Any, ...]:
    return card.model, card.values, card.settings, card.expression


def _require_results(own: Deck, text: str, path: Path) -> None:
    """Refuse a deck without the nodes and devices that results are read from.

    Raises
    ------
    UsageError : names the vectors, and the card that brings back a current.
    """
    now, before = circuit(read(text, path.name, title=True)), own.scope
    missing = [v for v in own.saved if not has_vector(now, v) and has_vector(before, v)]
    if not missing:
        return
    hints = []
    sources = {f"i({e.key})": e for e in before.elements if e.kind == "v"}
    for source in (sources[v.lower()] for v in missing if v.lower() in sources):
        node = source.nodes[0]
        hints.append(
            f"a 0 V source of its name reads the current of whatever drives {node}: "
            f"{source.name} {node} NODE 0, with your driver's output at NODE"
        )
    if len(hints) < len(missing):
        hints.append("nodes and devices that were renamed need their old names")
    raise UsageError(
        "the scene's results are read from what this deck does not have",
        where=str(path),
        got=", ".join(missing),
        expected="nodes and devices of these names",
        hint="; ".join(hints),
    )


def _tell_options(own: Deck, cards: Iterable[Statement], path: Path) -> None:
    """Warn of options that decide the accuracy and are not those of the scene's own deck."""
    before, now = {o.key: o.value for o in own.options if o.key not in HARMLESS}, accuracy(cards)
    pairs = {key: (before.get(key), now.get(key)) for key in [*before, *now]}
    changed = [
        f"{key} = {b or 'default'} ({a or 'default'})"
        for key, (a, b) in pairs.items()
        if _value(a) != _value(b)
    ]
    if changed:
        told = ", ".join(changed)
        warnings.warn(f"{path}: options are not the scene's, in brackets: {told}", stacklevel=2)


def _value(text: str | None) -> float | str | None:
    """Of an option, as a number where it is one."""
    number = literal(text) if text else None
    return text if number is None else number


def _seconds(words: tuple[str, ...], where: str) -> float:
    """End of the transient whose card has these words."""
    stop = literal(words[1], where=where) if len(words) > 1 else None
    if stop is None:
        raise UsageError("the end of the transient is no number", where=where, got=" ".join(words))
    return stop
