"""The grammar of scenes: parts, pins, joins, probes; each mistake is named with line and key."""

import re

import pytest
from support import UsageError, describe_nets, load_scene

DIVIDER = """\
[supply]
part = "source"
dc = 10.0
pins = { out = "upper.a" }

[upper]
part = "resistor"
resistance = "1 kOhm"
pins = { b = "lower.a" }

[lower]
part = "resistor"
resistance = 3e3

[analysis]
type = "op"
"""


def test_joined_pins_share_a_net(scene_file):
    scene = load_scene(scene_file(DIVIDER))
    assert scene.get_net("supply", "out") == scene.get_net("upper", "a")
    assert scene.get_net("upper", "b") == scene.get_net("lower", "a") != scene.get_net("upper", "a")
    assert scene.get_net("lower", "b") == scene.get_net("supply", "ret") == "0"
    assert describe_nets(scene) == (
        "voltage: supply.out, upper.a",
        "gnd: supply.ret, lower.b",
        "voltage: upper.b, lower.a",
    )
    nets = describe_nets(load_scene("kick_and_catch"))
    assert "velocity: contact.v, sphere.v, catch.v" in nets
    assert "displacement: kick.ring0, contact.ring0" in nets


def test_connections_apply_in_both_directions_and_through_other_pins():
    """a to b and c to b is one net of three, whoever says so."""
    tables = {
        "a": {"part": "resistor", "resistance": 1.0, "pins": {"a": "b.a"}},
        "b": {"part": "resistor", "resistance": 1.0},
        "c": {"part": "resistor", "resistance": 1.0, "pins": {"a": "b.a"}},
    }
    scene = load_scene(tables | {"analysis": {"type": "op"}})
    assert set(scene.list_joined_pins("b", "a")) == {("a", "a"), ("c", "a")}


def test_a_pin_that_is_named_leaves_its_default():
    """Else the resistor in front would be shorted to ground without a word."""
    tables = {
        "v": {"part": "source", "dc": 1.0},
        "one": {"part": "resistor", "resistance": 1.0, "pins": {"a": "v.out"}},
        "two": {"part": "resistor", "resistance": 1.0, "pins": {"a": "one.b"}},
    }
    scene = load_scene(tables | {"analysis": {"type": "op"}})
    assert scene.get_net("one", "b") == scene.get_net("two", "a") != "0"
    assert scene.get_net("two", "b") == "0"


def _changed(old, new):
    assert old in DIVIDER
    return DIVIDER.replace(old, new)


MASS = '\n[weight]\npart = "mass"\nmass = 1e-3\n'
SECOND = '\n[second]\npart = "source"\ndc = 9.0\n'
# Text of the file, the line and the key that the message names, and what else it says.
MISTAKES = {
    "this part type does not exist": (
        _changed('"resistor"\nresistance = 3e3', '"resitor"\nresistance = 3e3'),
        12, "lower.part", ["this part type does not exist", "'resitor'", "did you mean 'resistor'"],
    ),
    "no key part": (
        _changed('part = "source"\n', ""), 1, "supply", ["key `part` is missing", "part = one of"],
    ),
    "unknown key": (
        _changed("resistance = 3e3", "resistence = 3e3"),
        13, "lower.resistence", ["unknown key", "did you mean 'resistance'"],
    ),
    "a key without which a part is none": (
        _changed("resistance = 3e3\n", ""), 11, "lower.resistance", ["lower.resistance is missing"],
    ),
    "a required pin that is not joined": (
        _changed('pins = { out = "upper.a" }\n', ""),
        1, "supply.pins.out", ["pin out of supply is not connected", "upper.a", "pins = { out ="],
    ),
    "no such pin": (
        _changed("{ b = ", "{ bb = "), 9, "upper.pins.bb",
        ["resistor has no such pin", "one of a, b"],
    ),
    "no such part to join": (
        _changed('"lower.a"', '"lowr.a"'),
        9, "upper.pins.b", ["this pin does not exist", "'lowr.a'", "did you mean 'lower.a'"],
    ),
    "no such pin of the other part": (
        _changed('"lower.a"', '"lower.c"'),
        9, "upper.pins.b", ["this pin does not exist", "a pin of lower: lower.a, lower.b"],
    ),
    "a part without its pin": (
        _changed('"lower.a"', '"lower"'),
        9, "upper.pins.b", ["this pin does not exist", "lower.a, lower.b"],
    ),
    "pins of different kinds": (
        DIVIDER + MASS + 'pins = { a = "upper.b" }\n',
        21, "weight.pins.a",
        ["different kinds", "weight.a is a pin of kind um/N, upper.b is of kind V/A"],
    ),
    "two ideal sources in parallel": (
        DIVIDER + SECOND + 'pins = { out = "upper.a" }\n',
        18, "second", ["loop of ideal sources", "second.out and second.ret"],
    ),
    "a loop of three ideal sources": (
        DIVIDER + SECOND + 'pins = { out = "lower.a", ret = "supply.out" }\n'
        + SECOND.replace("second", "third") + 'pins = { out = "lower.a" }\n',
        23, "third", ["loop of ideal sources"],
    ),
    "a source on itself": (
        '[supply]\npart = "source"\ndc = 1.0\npins = { out = "gnd" }\n',
        4, "supply.pins.out", ["connected to the same net"],
    ),
    "a circuit without ground": (
        _changed("resistance = 3e3", 'resistance = 3e3\npins = { b = "supply.ret" }'),
        1, "supply", ["no pin of this circuit is connected to ground",
                       "supply.out, supply.ret, upper.a"],
    ),
    "two bodies that say where they are": (
        '[one]\npart = "sphere"\n[two]\npart = "sphere"\npins = { y = "one.y" }\n',
        5, "two.pins.y", ["two signal outputs drive the same net"],
    ),
    "a body that says where ground is": (
        '[one]\npart = "sphere"\npins = { y = "gnd" }\n',
        3, "one.pins.y", ["two signal outputs drive the same net"],
    ),
    "names that differ in letter case only": (
        DIVIDER + '\n[Lower]\npart = "resistor"\nresistance = 1.0\npins = { a = "lower.a" }\n',
        18, "Lower", ["differ in letter case only", "lower and Lower"],
    ),
    "a name that another part brings along": (
        '[kick]\n[kick_drive]\npart = "resistor"\nresistance = 1.0\npins = { a = "kick.anode" }\n',
        2, "kick_drive", ["this name is already used", "kick_drive, which kick adds to the scene"],
    ),
    "a part called ground": (
        DIVIDER + '\n[gnd]\npart = "resistor"\n', 18, "gnd", ["name of a part is not valid"],
    ),
    "pins that are no table": (
        _changed('pins = { b = "lower.a" }', "pins = 3"),
        9, "upper.pins", ["pins is not a table", "pins = { a = "],
    ),
    "a dc sweep of nothing": (
        _changed('type = "op"', 'type = "dc"\nsweep = "suply.dc"\nto = 1.0'),
        17, "analysis.sweep", ["this scene has no part 'suply'", "'suply.dc'", "supply.dc"],
    ),
    "an ac range upside down": (
        _changed('type = "op"', 'type = "ac"\nstart = 100.0\nstop = 10.0'),
        18, "analysis.stop", ["frequency range is empty"],
    ),
    "a level without a crossing": (
        DIVIDER + '\n[probes]\ntop = { of = "lower.v", level = 1.0 }\n',
        19, "probes.top", ["level has no effect with take", "delete the key `level`"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_named_with_file_line_and_key(name, scene_file):
    text, line, key, words = MISTAKES[name]
    with pytest.raises(UsageError) as caught:
        load_scene(scene_file(text))
    said = str(caught.value)
    assert re.search(rf"my\.toml, line {line}, key {re.escape(key)}\b", said), said
    for word in words:
        assert word in said
