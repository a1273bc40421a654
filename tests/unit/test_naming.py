"""Names of subcircuits: unique for each design, in libraries that need no other file."""

import re
from dataclasses import replace

import pytest

from kc2spice.core.errors import UsageError
from kc2spice.parts.amplifier import AmplifierKeys, amplifier_subcircuit
from kc2spice.parts.pid import Control, pid_subcircuit
from kc2spice.spice.deck import Block, Deck
from kc2spice.spice.elements import circuit
from kc2spice.spice.header import Header
from kc2spice.spice.lint import problems
from kc2spice.spice.naming import design_name, renamed, with_design_names

HERE, THERE = Header("one", "aaaa"), Header("two", "bbbb")


def test_only_subcircuit_names_are_renamed():
    text = ".subckt kick a kick\nXkick a kick KICK eps=1\nXtwo a\n+ kick kick x={kick}\n"
    text += "R1 kick 0 1\n"
    assert renamed(text + ".ends kick\n", {"kick": "chip"}) == (
        ".subckt chip a kick\nXkick a kick chip eps=1\nXtwo a\n+ kick chip x={kick}\n"
        "R1 kick 0 1\n.ends chip\n"
    )


def test_cards_that_name_nothing_stay_and_a_word_before_parameters_is_no_name():
    text = ".subckt\nX1 a kick PARAMS: eps=1\n.ends\n"
    assert renamed(text, {"kick": "chip"}) == text.replace("kick", "chip")


@pytest.mark.parametrize(
    "part", [pid_subcircuit(HERE, Control()), amplifier_subcircuit(HERE, AmplifierKeys())]
)
def test_a_library_holds_all_that_it_calls(part):
    top = circuit("t", {"t": f"* t\n.include {part.filename}\n", part.filename: part.text})
    called = {e.model for e in top.subcircuits[part.name].elements if e.kind == "x"}
    assert called
    assert called < set(top.subcircuits)
    assert all(name.startswith(f"{part.name}_") for name in called)


def deck(*parts):
    calls = (
        f"X{k} {' '.join(p.name for p in part.pins)} {part.name}" for k, part in enumerate(parts)
    )
    own = tuple(replace(part, file=f"{k}.lib") for k, part in enumerate(parts))
    return Deck(name="t", parts=own, blocks=(Block("calls", tuple(calls)),))


def test_two_designs_in_one_deck_have_two_names():
    plain = pid_subcircuit(HERE, Control())
    other = pid_subcircuit(THERE, Control(), output=False)
    with pytest.raises(UsageError, match="two subcircuits have one name"):
        problems(deck(plain, other))
    names = [with_design_names(deck(part)).parts[0] for part in (plain, other)]
    assert names[0].name != names[1].name
    assert not [p for p in problems(deck(*names)) if "subcircuit" in p.message]


def test_the_name_follows_scene_and_circuit_but_not_the_last_digits():
    part = pid_subcircuit(HERE, Control())
    assert design_name(part) == design_name(replace(part, text=part.text.replace("400.0", "400.1")))
    assert design_name(part) != design_name(pid_subcircuit(THERE, Control()))
    assert design_name(part) != design_name(replace(part, text=part.text + "R9 a b 1\n"))
    assert re.fullmatch(r"pid_[0-9a-f]{6}", design_name(part))
    called_otherwise = pid_subcircuit(Header("three", HERE.scene_hash), Control())
    assert design_name(part) == design_name(called_otherwise)


def test_a_deck_with_design_names_is_wired_as_before():
    part = pid_subcircuit(HERE, Control())
    named = with_design_names(deck(part))
    (new,) = named.parts
    assert new.filename == "0.lib"
    assert named.files["0.lib"] == new.text
    top = circuit("t.cir", named.files)
    assert [e.model for e in top.elements] == [new.name]
    assert all(name.startswith(new.name) for name in top.subcircuits)
