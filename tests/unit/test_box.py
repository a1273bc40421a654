"""Where pins sit on symbols: which side, how far apart, how large the symbol."""

import pytest

from kc2spice.netlist.box import inputs, layout
from kc2spice.netlist.circuit import Pin, Subcircuit


def part(cards, *pins, more=""):
    """``pins`` are ``name`` (electrical), ``name-`` (signal) or ``name:um`` (mechanical)."""
    table = []
    for text in pins:
        name, _, unit = text.rstrip("-").partition(":")
        table.append(Pin(name, unit or "V", "-" if text[-1] == "-" else "N" if unit else "A"))
    names = " ".join(pin.name for pin in table)
    text = f"* part: a title\n.subckt part {names}\n{cards}\n.ends part\n{more}"
    return Subcircuit("part", tuple(table), (), text)


def sides(*args, **more):
    found = {"left": "", "right": "", "bottom": ""}
    for place in layout(part(*args, **more)).places:
        found[place.side] += " " + place.pin.name
    return tuple(names.strip() for names in found.values())


@pytest.mark.parametrize(
    ("cards", "sensed"),
    [
        ("E1 b 0 a 0 2\nR1 b c 1", {"a"}),
        ("G1 b 0 A c 2\nR1 b 0 1", {"a", "c"}),
        ("E1 b 0 a 0 2\nR1 a c 1", set()),  # it is loaded, too
        ("S1 b 0 a c fast\n.model fast SW(VT=1)", {"a", "c"}),
        ("B1 b 0 I=V(a)*V(c,0)+I(V9)\nV9 b 0 0", {"a", "c"}),
        ("M1 b 0 a 0 nch\nR1 b 0 1", set()),
        ("E1 b 0 a 0 2\nZ1 a c 0 mes", set()),
        ("E1 b a 0 0 2\nE2 c 0 a 0 1", set()),
        ("B1 b 0 I=I(a)\nR1 b c 1", set()),  # a current, not a voltage
        ("E1 b 0 VALUE={2*V(a)}\nR1 a c 1", set()),
        ("R1 a b 1\nB1 c 0 V=V(a)*", set()),
        ("X1 b a inner\nR1 c 0 1", {"a"}),
        ("X1 a b inner\nR1 c 0 1", {"b"}),
        ("X1 b a inner\nX2 b c inner\nR1 a 0 1", {"c"}),
        ("X1 b a nowhere\nE1 b 0 c 0 1", {"c"}),
    ],
)
def test_pins_that_are_sensed_alone_are_inputs(cards, sensed):
    inner = ".subckt inner out in\nE1 out 0 in 0 1\n.ends inner\n"
    assert inputs(part(cards, "a", "b", "c", more=inner)) == sensed


@pytest.mark.parametrize(
    ("cards", "pins", "expected"),
    [
        ("E1 out 0 in 0 1", ("out", "in"), ("in", "out", "")),
        ("R1 a b 1", ("a", "b", "ref"), ("a", "b", "ref")),
        ("E1 out ref in ref 1\nR1 cmd 0 1", ("out", "in", "cmd-", "ref"), ("in cmd", "out", "ref")),
        ("R1 plus u 1", ("u:um", "plus", "minus", "v:m/s", "base"), ("plus minus", "u v", "base")),
        ("R1 a b 1", ("v:m/s", "y:um", "x:um", "base"), ("y x", "v", "base")),
        ("R1 v w 1", ("v:m/s", "w:m/s"), ("v w", "", "")),
        ("E1 y 0 u 0 1", ("y-", "u-", "ref"), ("u", "y", "ref")),
    ],
)
def test_inputs_are_left_outputs_right_and_references_below(cards, pins, expected):
    assert sides(cards, *pins) == expected


def test_an_operational_amplifier_is_a_triangle():
    names = ("inp", "inn", "out", "vcc", "vee", "ref")
    box = layout(part("E1 out ref inp inn 1\nR1 vcc vee 1", *names))
    assert box.triangle
    assert (box.width, box.height) == (2, 2)
    assert (box.name, box.library, box.title) == ("part", "part.lib", "part: a title")
    found = [(p.number, p.pin.name, p.side, p.x, p.y, p.length) for p in box.places]
    assert found == [
        (1, "inp", "left", -3, 1, 1.0), (2, "inn", "left", -3, -1, 1.0),
        (3, "out", "right", 3, 0, 1.0), (4, "vcc", "top", 0, 3, 2.0),
        (5, "vee", "bottom", 0, -3, 2.0), (6, "ref", "bottom", -1, -3, 1.5),
    ]  # fmt: skip
    for other in (names[:4], (*names, "more")):
        assert not layout(part("R1 inp inn 1", *other)).triangle


@pytest.mark.parametrize(
    ("pins", "size"),
    [
        (("a", "b"), (3, 1)),
        (("a", "b", "ref"), (3, 2)),  # three letters upright: 0.45 * 3 + 0.8 over two
        (("a", "b", "base"), (3, 2)),
        (("a", "b1", "b2", "b3", "b4", "b5"), (3, 3)),
        (("a", "b1", "b2", "b3", "b4", "base"), (3, 3)),
        (("tenletters", "b"), (6, 1)),  # 0.45 * 10 + 0.6
        (("a", "tenletters"), (6, 1)),
        (("tenletters", "b", "ref"), (6, 2)),  # and half a column: 5.6
        (("tenletters", "b", "ref", "base"), (7, 2)),
    ],
)
def test_names_of_pins_have_room(pins, size):
    box = layout(part("R1 a b 1", *pins))
    assert (box.width, box.height) == size
    assert not box.triangle


def test_pins_stand_in_rows_from_the_top_and_below_in_columns():
    cards = "E1 out 0 in1 in2 1\nE2 out 0 in3 in4 1"
    box = layout(part(cards, "in1", "in2", "out", "ref", "base", "in3", "in4"))
    width, height = box.width, box.height
    assert (width, height) == (3, 3)
    assert [(p.number, p.pin.name, p.x, p.y, p.length) for p in box.places] == [
        (1, "in1", -width - 1, height - 1, 1.0), (2, "in2", -width - 1, height - 2, 1.0),
        (3, "out", width + 1, height - 1, 1.0),
        (4, "ref", -1, -height - 1, 1.0), (5, "base", 0, -height - 1, 1.0),
        (6, "in3", -width - 1, height - 3, 1.0), (7, "in4", -width - 1, height - 4, 1.0),
    ]  # fmt: skip
