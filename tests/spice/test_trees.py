"""Libraries and decks are trees whose cards know their part; text is printed from them alone."""

import re

import pytest
from support import (
    Circuit,
    Element,
    Printer,
    StageTimer,
    normalise_element,
    prepare_deck,
    read_cards,
    read_edited_deck,
)
from support import deck as decks

import kc2spice as kc


def elements(circuit):
    for item in circuit.items:
        if isinstance(item, Circuit):
            yield from elements(item)
        elif isinstance(item, Element):
            yield item


def test_libraries_read_back_to_the_trees_they_are_printed_from(loop):
    for part in loop.parts:
        again = read_cards(part.text, part.filename)
        cards = list(elements(part.located_tree))
        assert list(map(normalise_element, elements(again))) == list(map(normalise_element, cards))
        assert [card.written for card in elements(again)] == [card.written for card in cards]
        assert [card.where for card in elements(again)] == [card.where for card in cards]


def test_decks_read_back_to_the_trees_they_are_printed_from(loop):
    again = read_cards(loop.files[loop.main_file_name], loop.main_file_name, title=True)
    cards = [Printer().card(item) for item in loop.circuit.items]
    assert [Printer().card(item) for item in again.items] == cards
    assert [item.notes for item in again.items] == [item.notes for item in loop.circuit.items]
    lines = [item.where for item in loop.located_trees[loop.main_file_name].items]
    assert lines == [item.where for item in again.items]


def test_every_element_of_a_deck_names_its_part(scene, loop):
    owners = {item.name: item.owner for item in loop.items}
    assert set(owners.values()) <= set(scene.parts)
    assert owners["Vkick_drive"] == "kick_drive"
    assert owners["Xsphere"] == "sphere"


def test_the_head_states_the_fields_of_a_library(loop):
    for part in loop.parts:
        assert part.text.replace("\n*   ", " ").startswith(f"* {part.title}\n")
    (kick,) = (part for part in loop.parts if part.reduction)
    assert f"* rom: {kick.reduction.summary}\n" in kick.text
    assert f"* {kick.name}, rom: {kick.reduction.summary}\n" in loop.files[loop.main_file_name]


@pytest.fixture
def duffing(tmp_path):
    """The deck and the path of a deck that somebody may edit."""
    _, deck = prepare_deck(kc.load_scene("duffing"), StageTimer())
    for name, text in deck.files.items():
        (tmp_path / name).write_text(text)
    return deck, tmp_path / deck.main_file_name


def test_an_edited_deck_is_read_once(duffing, monkeypatch):
    """Further changes are made in its tree."""
    deck, path = duffing
    path.write_text(path.read_text().replace("reltol=", "gmin=1e-13 reltol="))
    edits = read_edited_deck(deck, path)
    assert edits.options == {"gmin": (None, "1e-13")}
    edited = edits.deck

    def unread(*_, **__):
        raise AssertionError("read again")

    monkeypatch.setattr(decks, "read_cards", unread)
    assert edited.files[edited.main_file_name].count("gmin") == 1
    changed = edited.with_options({"gmin": "1e-14"}, "a test")
    changed = changed.with_results({"more": ("v(more)", 1.0)})
    assert edited.find_option_text("gmin") == "1e-13"
    assert changed.find_option_text("gmin") == "1e-14"
    text = changed.with_command(decks.AnalysisCommand("op", ())).files[edited.main_file_name]
    assert "\n.op\n" in text
    assert ".tran" not in text
    assert any(item.name == "Xspring" for item in changed.scope.elements)


def test_places_in_an_edited_deck_are_those_of_its_file(duffing):
    deck, path = duffing
    edited = read_edited_deck(deck, path).deck
    lines = path.read_text().splitlines()
    line = next(k for k, text in enumerate(lines, 1) if text.startswith("Xspring "))
    (spring,) = (item for item in edited.scope.elements if item.name == "Xspring")
    assert spring.where == f"{path.name}:{line}"


def test_the_times_of_an_edited_deck_are_those_of_its_card(duffing):
    """A deck of the scene has them as numbers."""
    deck, path = duffing
    words = deck.command.words
    assert (deck.stop, deck.max_step) == (float(words[1]), float(words[3]))
    path.write_text(re.sub(r"(?m)^\.tran .*", ".tran 1u 2m 0 3u", path.read_text()))
    edited = read_edited_deck(deck, path).deck
    assert (edited.stop, edited.max_step) == (2e-3, 3e-6)
    halved = deck.scale_max_step(0.5)
    assert halved.command.words[3] == repr(deck.max_step / 2)
    assert halved.scale_max_step(0.5).max_step == deck.max_step / 4
