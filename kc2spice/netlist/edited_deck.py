"""Decks that a user has edited, and their differences from the deck of a scene.

The inputs are the deck that kc2spice writes for a scene, and the user's edited copy of this deck.
The output is a list of the parameters, cards and options that differ between the deck and its
edited copy. The module :mod:`kc2spice.workflow.parts_from_edited_deck` applies these differences to
the parts of the scene.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

from kc2spice.core.errors import MAX_CANDIDATES, UsageError, join_first
from kc2spice.core.untrusted_files import reject_toml_file
from kc2spice.netlist.card_parser import Statement, build_tree
from kc2spice.netlist.circuit import Element
from kc2spice.netlist.deck import AnalysisCommand, Deck
from kc2spice.netlist.expression import Trace, parse_literal, parse_vector
from kc2spice.netlist.include_scan import (
    ANALYSES,
    PRINT_OPTIONS,
    read_accuracy_options,
    read_checked_circuit,
    reject_side_effects,
)
from kc2spice.netlist.name_scopes import Scope, has_vector
from kc2spice.netlist.printers.ngspice import Printer

# Smallest share of elements that an edited deck and the deck of the scene have in common, relative
# to the smaller of the two. An edited deck with a smaller share counts as a deck of another scene.
# The limit is low, because users may replace most elements of a deck.
MIN_COMMON_SHARE = 0.25


class ParameterEdit(NamedTuple):
    """Parameter of a subcircuit instance, with old and new value.

    A value that is an expression is stored as NaN.
    """

    name: str
    old: float
    new: float


@dataclass(frozen=True)
class InstanceEdit:
    """Differences of a subcircuit instance between original deck and edited deck.

    Attributes
    ----------
    subcircuit : str
        Name of the subcircuit in the edited deck.
    has_other_cards : bool
        Whether cards in the definition of the subcircuit, or of its inner subcircuits, differ.
    parameters : tuple of ParameterEdit
        Parameters whose values differ.
    """

    subcircuit: str
    has_other_cards: bool
    parameters: tuple[ParameterEdit, ...]


@dataclass(frozen=True)
class DeckEdits:
    """Edited deck, and its differences from the deck of the scene.

    Attributes
    ----------
    deck : Deck
        The edited deck with the results of the scene.
    analysis : str or None
        The analysis card of the edited deck if it differs from the analysis of the scene.
    missing_state : str or None
        The missing word or card without which a run ignores the initial state of the scene.
    options : mapping of str to tuple of two texts or None
        Old and new value of each accuracy option that differs. If a deck does not set an option,
        the option has the value None, which stands for the default value of the simulator.
    cards : mapping of str to str
        Description of each part whose cards differ, of each new card, and of each instance whose
        nodes differ from the deck of the scene. Each description is keyed by the name of its part,
        card or instance. For a part whose cards differ, the scene keys no longer describe the deck.
    instances : mapping of str to InstanceEdit
        Differences of each instance that exists in both decks, keyed by instance name in lower
        case.
    """

    deck: Deck
    analysis: str | None
    missing_state: str | None
    options: Mapping[str, tuple[str | None, str | None]]
    cards: Mapping[str, str]
    instances: Mapping[str, InstanceEdit]


def read_edited_deck(original: Deck, path: Path) -> DeckEdits:
    """Read a netlist that was edited after kc2spice exported the original deck.

    The content of included files replaces the include lines. Unless the original deck is trusted, a
    netlist that could execute programs or write files is rejected.

    Raises
    ------
    UsageError : the file is missing, a line could execute programs or write files, a card changes
        the meaning of the parts, the analysis differs from the scene's analysis, or a required
        vector is not saved or does not exist.
    """
    reject_toml_file(path, "a netlist that kc2spice export or kc2spice run wrote")
    if not path.exists():
        raise UsageError(
            "this file does not exist",
            where=str(path),
            expected="the path of a netlist",
            hint=f"kc2spice export {original.name}  writes a deck of this scene to edit",
        )
    result = read_checked_circuit(path, trust=original.trusted)
    cards = list(result.cards(title=True))
    reject_side_effects(cards, part=False)
    _require_top_level_elements(original, cards, path)
    _require_common_elements(original, cards, path)
    with _reject_title_of_other_scene(original, result.text, path):
        analysis = _require_analysis(original, cards, path)
        _require_saved_vectors(original, cards, path)
    deck = replace(
        original,
        text=result.text,
        tree=build_tree(cards),
        parts=(),
        items=(),
        options=(),
        initial_voltages={},
        stop=_read_stop(original, analysis),
        max_step=_read_max_step(original, analysis),
        command=AnalysisCommand(original.command.kind, tuple(analysis.words[1:])),
    )
    with _reject_title_of_other_scene(original, result.text, path):
        _require_results(original.scope, deck, path)
    instances = _compare_instances(original.scope, deck.scope)
    deck = replace(deck, edits=tuple(_describe_edits(original.scope, deck.scope, instances)))
    return DeckEdits(
        deck,
        None if _has_equal_words(original.command.card, analysis) else analysis.written,
        _find_missing_state(original, cards, analysis),
        _compare_options(original, cards),
        _compare_cards(original.scope, deck.scope),
        instances,
    )


def _list_top_level_elements(cards: Iterable[Statement]) -> Iterator[str]:
    """Yield the name of each element outside of subcircuits, in lower case."""
    depth = 0
    for card in cards:
        depth += (card.keyword == ".subckt") - (card.keyword == ".ends")
        if depth == 0 and not card.keyword.startswith("."):
            yield card.keyword


def _require_common_elements(original: Deck, cards: Iterable[Statement], path: Path) -> None:
    """Reject a deck that has few elements in common with the scene.

    A deck with few elements of a scene was written for another scene.

    Raises
    ------
    UsageError : the deck contains nearly no element of the scene.
    """
    before, now = original.scope.elements_by_key.keys(), set(_list_top_level_elements(cards))
    common = len(before & now)
    if not now or common >= MIN_COMMON_SHARE * min(len(before), len(now)):
        return
    got = f"a deck with {common} of the {len(before)} elements of {original.name}"
    raise _make_other_scene_error(original, path, got)


@contextmanager
def _reject_title_of_other_scene(original: Deck, text: str, path: Path) -> Iterator[None]:
    """Reject a deck whose title names another scene, if the deck has an error.

    Raises
    ------
    UsageError : the code in the ``with`` block raises a ``UsageError``. If the title of the deck
        names another scene, the message states that the deck belongs to another scene.
    """
    try:
        yield
    except UsageError:
        title = text.partition("\n")[0].removeprefix("* ")
        name, colon, _ = title.partition(": ")
        if not colon or name == original.name:
            raise
        raise _make_other_scene_error(original, path, f"a deck of {title[:100]}") from None


def _make_other_scene_error(original: Deck, path: Path, got: str) -> UsageError:
    """Return the error about a deck of another scene."""
    return UsageError(
        "this deck is not a deck of this scene",
        where=str(path),
        got=got,
        expected=f"the deck that  kc2spice export {original.name}  writes, with changes",
        hint=f"edit a copy of the deck that  kc2spice export {original.name}  writes",
    )


def _require_analysis(original: Deck, cards: Collection[Statement], path: Path) -> Statement:
    """Return the only analysis card of an edited deck; reject a changed analysis.

    Raises
    ------
    UsageError : the deck contains several analyses, or an analysis that differs from the
        ``original``.
    """
    analyses = [card for card in cards if card.keyword in ANALYSES]
    if list(map(attrgetter("keyword"), analyses)) != [f".{original.command.kind}"]:
        raise UsageError(
            "the analysis of this deck differs from that of the scene"
            if analyses
            else "this deck contains no analysis",
            where=str(path),
            got=" and ".join(map(attrgetter("written"), analyses)) or "none",
            expected=original.command.card,
            hint=f"write this line into the deck: {original.command.card}"
            if cards
            else "edit a copy of the deck that kc2spice export writes",
        )
    return analyses[0]


def _require_top_level_elements(original: Deck, cards: Collection[Statement], path: Path) -> None:
    """Reject a library: a file in which all elements are inside of subcircuits.

    Raises
    ------
    UsageError : the file has no element outside of its subcircuits.
    """
    is_deck = any(card.keyword in ANALYSES for card in cards)
    has_subcircuits = any(card.keyword == ".subckt" for card in cards)
    if is_deck or not has_subcircuits or any(_list_top_level_elements(cards)):
        return
    deck = path.with_name(original.main_file_name)
    raise UsageError(
        "this file is a library of subcircuits, not a deck",
        where=str(path),
        got="subcircuits only, without an analysis",
        expected=f"the netlist of the scene, such as {original.main_file_name}",
        hint=f"give the deck that includes this library: --deck {deck}"
        if deck.is_file()
        else f"kc2spice export {original.name}  writes a deck of this scene to edit",
    )


def _has_equal_words(card: str, analysis: Statement) -> bool:
    """Return whether two analysis cards have the same words and equal numbers."""
    return list(map(_parse_word, card.split())) == list(map(_parse_word, analysis.words))


def _parse_word(word: str) -> float | str:
    """Return a word of a card as a number, or otherwise in lower case."""
    number = None
    with suppress(UsageError):
        number = parse_literal(word)
    return word.lower() if number is None else number


def _find_missing_state(
    original: Deck, cards: Iterable[Statement], analysis: Statement
) -> str | None:
    """Return what an edited deck lacks of the initial state of the original deck, or None."""
    if "uic" in original.command.words and "uic" not in map(str.lower, analysis.words):
        return f"the word uic at the end of the card {analysis.written}"
    if original.initial_voltages and not any(card.keyword == ".ic" for card in cards):
        return "the card .ic of the exported deck"
    return None


def _require_saved_vectors(original: Deck, cards: Iterable[Statement], path: Path) -> None:
    """Reject a deck whose ``.save`` cards omit a vector of the scene's results.

    Raises
    ------
    UsageError : vectors are missing; the message lists the missing vectors.
    """
    saved: set[Trace | None] = set()
    for card in cards:
        if card.keyword == ".save":
            saved.update(map(parse_vector, map(str.lower, card.words[1:])))
    missing = [name for name in original.saved_vectors if parse_vector(name.lower()) not in saved]
    if not saved:  # without .save, ngspice saves only node voltages and currents of voltage sources
        devices = [name for name in missing if name.startswith("@")]
        if devices:
            raise UsageError(
                "this deck has no line .save, but the scene's metrics need currents of devices",
                where=str(path),
                got="no .save",
                expected=f"a line .save with {join_first(devices)}",
                hint=f"add this line to the deck: .save all {' '.join(devices)}",
            )
        return
    if parse_vector("all") not in saved and len(missing) == len(original.saved_vectors):
        got = f"a deck that saves none of the vectors of {original.name}"
        raise _make_other_scene_error(original, path, got)
    if parse_vector("all") not in saved and missing:
        raise UsageError(
            "the scene's metrics need vectors that this deck does not save",
            where=str(path),
            got=", ".join(missing),
            expected="these vectors on a line that begins with .save",
            hint="add this line to the deck: .save " + " ".join(missing),
        )


def _read_stop(original: Deck, analysis: Statement) -> float | None:
    """Return the end time [s] of a transient, or None for any other analysis.

    Raises
    ------
    UsageError : the end time is not a number.
    """
    if original.stop is None:
        return None
    words = analysis.words[1:]
    stop = parse_literal(words[1], where=analysis.where) if len(words) > 1 else None
    if stop is None:
        raise UsageError(
            "the second number of this card, the end of the transient, is missing or not a number",
            where=analysis.where,
            got=" ".join(analysis.words),
            expected=".tran STEP STOP, with two numbers such as 1u and 2m",
            hint=f"write for example  .tran {words[0] if words else '1u'} {original.stop:g}",
        )
    return stop


def _read_max_step(original: Deck, analysis: Statement) -> float | None:
    """Return the largest step [s] of a transient, or None if the card states no step."""
    words = analysis.words[1:]
    if original.stop is None or len(words) < 4:
        return None
    return parse_literal(words[3], where=analysis.where)


def _require_results(before: Scope, edited: Deck, path: Path) -> None:
    """Reject a deck without the nodes and devices that the scene's results need.

    Raises
    ------
    UsageError : nodes or devices are missing. The message lists the missing vectors, and for a
        missing current also the card to restore.
    """
    now = edited.scope
    _require_instances(before, now, path)
    missing = [v for v in edited.saved_vectors if not has_vector(now, v) and has_vector(before, v)]
    if not missing:
        return
    hint = f"edit a copy of the deck that  kc2spice export {edited.name}  writes"
    needed = sum(has_vector(before, vector) for vector in edited.saved_vectors)
    if len(missing) > max(MAX_CANDIDATES, needed / 2):
        got = f"a deck without {len(missing)} of the results of {edited.name}, such as {missing[0]}"
        raise _make_other_scene_error(edited, path, got)
    sources = {f"i({e.key})": e for e in before.elements if e.kind == "v"}
    missing_sources = list(filter(None, map(sources.get, map(str.lower, missing))))
    if missing_sources:
        node = missing_sources[0].nodes[0]
        hint = (
            f"measure the current into {node} by a source of 0 V between NODE, the output of your "
            f"driver, and {node}:  {missing_sources[0].name} {node} NODE 0"
        )
    listed = ", ".join(missing[:MAX_CANDIDATES])
    if len(missing) > MAX_CANDIDATES:
        listed += f", … ({len(missing)} in all)"
    raise UsageError(
        "the scene's results need nodes or devices that this deck does not have",
        where=str(path),
        got=f"no {listed}",
        expected="nodes and devices of these names",
        hint=hint,
    )


def _require_instances(before: Scope, now: Scope, path: Path) -> None:
    """Require the instance of each part in a deck, unless the deck has new cards.

    New cards, which the original deck does not contain, may replace a missing instance.

    Raises
    ------
    UsageError : a card is missing; the message states its name.
    """
    old, new = before.elements_by_key, now.elements_by_key
    if new.keys() - old.keys():
        return  # a missing card is no error, because the new cards may replace it
    for key in old.keys() - new.keys():
        if old[key].kind == "x":
            name = old[key].name
            raise UsageError(
                f"the deck has no card {name}",
                where=str(path),
                expected=f"{name} of the exported deck, or elements that replace it",
                hint=f"copy the line that begins with {name} from a new export",
            )


def _compare_options(
    original: Deck, cards: Iterable[Statement]
) -> dict[str, tuple[str | None, str | None]]:
    """Return the old and the new value of each accuracy option that differs."""
    before = {item.key: item.text for item in original.options if item.key not in PRINT_OPTIONS}
    now = read_accuracy_options(cards)

    def parse_value(text: str | None) -> float | str | None:
        """Return the value of an option as a number, or otherwise as text."""
        number = parse_literal(text) if text else None
        return text if number is None else number

    changes = {}
    for key in dict.fromkeys([*before, *now]):
        old, new = before.get(key), now.get(key)
        if parse_value(old) != parse_value(new):
            changes[key] = old, new
    return changes


def _compare_cards(before: Scope, now: Scope) -> dict[str, str]:
    """Return a description of each changed card, keyed by the part that owns the card.

    A card that belongs to no part is keyed by its own name. Edits of an instance's parameters or
    subcircuit are not described, because :func:`_compare_instances` returns them.
    """
    old, new = before.elements_by_key, now.elements_by_key
    result = {}
    for key in old.keys() | new.keys():
        a, b = old.get(key), new.get(key)
        owner = key if a is None else a.owner or key
        if b is None and a is not None:
            result[owner] = f"the deck has no card {a.name}"
        elif a is None or b is None or _format_without_nodes(a) != _format_without_nodes(b):
            result[owner] = f"its card {(a or b).name} is different"  # type: ignore[union-attr]
        elif (
            a.lower_case_nodes != b.lower_case_nodes
        ):  # the scene keys remain valid for an instance with other nodes
            name = key if key.startswith("x") else owner
            result[name] = f"its card {a.name} is connected to other nodes"
    return result


def _describe_edits(
    before: Scope, now: Scope, instances: Mapping[str, InstanceEdit]
) -> Iterator[str]:
    """Yield a short description of each element that differs between two circuits."""
    old, new = before.elements_by_key, now.elements_by_key
    for key, b in new.items():
        a, line = old.get(key), b.where.rpartition(":")[2]
        place = f"{b.name} in line {line}" if line else b.name
        if a is None:
            yield f"{place} (new)"
        elif a.lower_case_nodes != b.lower_case_nodes:
            yield f"{place} ({_describe_changed_nodes(a, b)})"
        elif normalise_element(a) != normalise_element(b):
            yield f"{place} (changed values)"
        elif key in instances and instances[key].has_other_cards:
            yield f"the subcircuit {instances[key].subcircuit} of {b.name} (changed cards)"
    for key in old.keys() - new.keys():
        yield f"{old[key].name} (missing)"


def _describe_changed_nodes(a: Element, b: Element) -> str:
    """Describe which nodes of an element changed between two circuits."""
    pairs = zip(a.lower_case_nodes, b.lower_case_nodes, strict=False)
    changed = [pair for pair in pairs if pair[0] != pair[1]]
    if len(changed) == 2 and changed[0] == changed[1][::-1]:
        return f"nodes {changed[0][0]} and {changed[0][1]} are exchanged"
    if not changed:
        return "another number of nodes"
    return ", ".join(f"node {now} in place of {before}" for before, now in changed)


def _format_without_nodes(card: Element) -> str:
    """Return the text of an element's card with the node names omitted.

    The parameters of a subcircuit instance are omitted, too.
    """
    plain = replace(card, nodes=())
    return normalise_element(replace(plain, parameters={}) if card.kind == "x" else plain)


def normalise_element(card: Element) -> str:
    """Return the text of an element in normal form.

    The normal form contains no redundant blanks and brackets, and names in lower case.
    """
    plain = replace(card, name=card.key, nodes=card.lower_case_nodes, parameters=card.settings)
    return Printer().format_element(plain)


def _compare_instances(before: Scope, now: Scope) -> dict[str, InstanceEdit]:
    """Return the differences of all subcircuit instances that exist in both circuits."""
    result = {}
    edited = now.select_elements("x")
    for key, card in before.select_elements("x").items():
        old = before.find_subcircuit(card.model)
        new = now.find_subcircuit(edited[key].model) if key in edited else None
        if old is not None and new is not None:
            parameters = _compare_parameters(
                old.defaults | card.settings, new.defaults | edited[key].settings
            )
            result[key] = InstanceEdit(
                new.name, _list_cards(old) != _list_cards(new), tuple(parameters)
            )
    return result


def _compare_parameters(
    before: Mapping[str, str], now: Mapping[str, str]
) -> Iterator[ParameterEdit]:
    """Yield the parameters whose values differ between two subcircuit instances."""

    def parse_number(text: str | None) -> float:
        """Return the numeric value of a parameter; NaN for an expression."""
        number = None if text is None else parse_literal(text)
        return math.nan if number is None else number

    for name in before.keys() | now.keys():
        if before.get(name) != now.get(name):
            old, new = parse_number(before.get(name)), parse_number(now.get(name))
            if old != new:
                yield ParameterEdit(name, old, new)


def _list_cards(scope: Scope, above: frozenset[str] = frozenset()) -> Any:
    """Return the texts of all cards of a subcircuit and of its inner subcircuits."""
    inside = []
    for item in scope.elements:
        called = scope.find_subcircuit(item.model) if item.kind == "x" else None
        if called is not None and called.name.lower() not in above:
            within = _list_cards(called, above | {called.name.lower()})
            defaults = {name: _parse_word(text) for name, text in called.defaults.items()}
            inside.append((item.model.lower(), defaults, within))
    printer = Printer()
    plain = list(map(printer.card, scope.commands))
    models = {name: printer.card(item) for name, item in scope.models.maps[0].items()}
    return scope.pins, list(map(normalise_element, scope.elements)), plain, models, inside
