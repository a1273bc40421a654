"""Names of subcircuits in libraries that need no other file."""

import pytest

from kc2spice.netlist.elements import circuit
from kc2spice.netlist.naming import renamed
from kc2spice.parts.amplifier import AmplifierKeys, amplifier_subcircuit
from kc2spice.parts.pid import Control, pid_subcircuit
from kc2spice.spice.header import Header

HERE = Header("one", "aaaa")


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
