"""KiCad symbols: pins meet their drawings, marks stand at their pins, text is an S-expression."""

import re

import pytest

from kc2spice.netlist.box import layout
from kc2spice.netlist.circuit import Pin, Subcircuit
from kc2spice.netlist.kicad import GRID, Word, element_symbols, library, part_symbol, write

SYMBOLS = element_symbols()


def numbers(text, head):
    """Numbers of every ``(head …)``."""
    found = re.findall(rf"\({head} ([-0-9. ]+)\)", text)
    return [tuple(map(float, each.split())) for each in found]


def test_trees_become_text():
    tree = ("a", 1, 2.5, 1 / 3, 'x"y\\z\nw', Word("yes"), ("b", ("p", ("q", 0.5), Word("hide"))))
    lines = [
        '(a 1 2.5 0.333333 "x\\"y\\\\z\\nw" yes',
        "\t(b",
        "\t\t(p (q 0.5) hide)",
        "\t)",
        ")",
        "",
    ]
    assert write(tree) == "\n".join(lines)
    assert write(("a", "b")) == '(a "b")\n'
    assert write(("a", "b"), "\t") == '\t(a "b")'


@pytest.mark.parametrize("name", SYMBOLS)
def test_pins_of_an_element_are_numbered_and_drawn_where_they_end(name):
    symbol = SYMBOLS[name]
    pins = ["".join(map(write, [pin])) for pin in symbol.pins]
    angle = {"left": 0, "right": 180, "bottom": 90, "top": 270}
    for k, (pin, (x, y, side)) in enumerate(zip(pins, symbol.ends, strict=True), 1):
        assert numbers(pin, "at") == [(GRID * x, GRID * y, angle[side])]
        assert f'(number "{k}"' in pin
        assert set(numbers(pin, "size")) == {(1.27, 1.27)}
        length = 0 if name in ("GND", "PWR_FLAG") else GRID
        assert numbers(pin, "length") == [(length,)]
    if len(name) == 1:
        assert symbol.fields["Sim.Params"] == f'type="{name}" model="0" lib=""'
        pairs = [f"{k}={k}" for k in range(1, len(pins) + 1)]
        assert symbol.fields["Sim.Pins"].split() == pairs
        assert len(pins) == (4 if name in "EG" else 2)
    assert symbol.power == (name in ("GND", "PWR_FLAG"))
    assert symbol.simulated == (name != "PROBE")


@pytest.mark.parametrize("name", SYMBOLS)
def test_an_element_is_drawn_symmetrically_inside_its_pins(name):
    drawing = "".join(map(write, SYMBOLS[name].drawing))
    corners = numbers(drawing, "xy") + numbers(drawing, "start") + numbers(drawing, "end")
    assert {(-x, y) for x, y in corners} == set(corners) or "rectangle" in drawing
    assert all(abs(x) <= 2 * GRID and abs(y) <= 2 * GRID for x, y in corners)
    for (x0, y0), (x1, y1) in zip(numbers(drawing, "start"), numbers(drawing, "end"), strict=True):
        assert (x0, y0) == (-x1, -y1)
        assert y0 >= GRID
    for radius, centre in zip(numbers(drawing, "radius"), numbers(drawing, "center"), strict=True):
        assert centre[0] == 0
        assert radius[0] + abs(centre[1]) == pytest.approx(GRID if centre[1] == 0 else 4.062)
    if name in ("V", "H"):  # a plus above, a minus below: a cross, and a bar at its distance
        points = numbers(drawing, "xy")
        assert sum(x * 0 + y for x, y in points) == pytest.approx(2 * 1.3)
        assert {y for x, y in points if x} == {1.3, -1.3}
        assert sorted(y for x, y in points if not x) == pytest.approx([0.7, 1.9])
    if name in ("I", "F"):  # from plus to minus inside, as SPICE counts it
        assert numbers(drawing, "xy") == [(0, 1.6), (0, -1.6), (-0.6, -0.6), (0, -1.6), (0.6, -0.6)]
    if name == "C":
        points = numbers(drawing, "xy")
        assert {y for x, y in points if x} == {0.5, -0.5}
        assert {y for x, y in points if not x} == {0.5, -0.5, GRID, -GRID}


def amplifier():
    names = ("inp", "inn", "out", "vcc", "vee", "ref")
    cards = "E1 out ref inp inn 1\nR1 vcc vee 1"
    text = f"* amp: a title\n.subckt amp {' '.join(names)}\n{cards}\n.ends\n"
    return part_symbol(layout(Subcircuit("amp", tuple(Pin(n, "V", "A") for n in names), (), text)))


def test_marks_of_an_amplifier_stand_inside_at_their_pins():
    symbol = amplifier()
    text = "".join(map(write, symbol.drawing))
    corners = [(-2.0, 2.0), (-2.0, -2.0), (2.0, 0.0), (-2.0, 2.0)]
    assert [(x / GRID, y / GRID) for x, y in numbers(text, "xy")] == corners
    marks = re.findall(r'\(text "(\S+)"\s+\(at (\S+) (\S+) 0\)', text)
    at = {mark: (float(x) / GRID, float(y) / GRID) for mark, x, y in marks}
    assert at["+"] == (-1.5, 1)
    assert at["-"] == (-1.5, -1)
    assert at["vcc"] == pytest.approx((0.5, 1.3))
    assert at["vee"] == pytest.approx((0.5, -1.3))
    assert at["ref"] == pytest.approx((-1.35, -2.3))
    assert numbers(text, "size") == [(1.27, 1.27)] * 2 + [(0.8, 0.8)] * 3


def test_a_library_says_how_a_part_is_simulated():
    text = library([amplifier()])
    assert text.startswith("(kicad_symbol_lib\n\t(version 20231120)\n")
    fields = dict(re.findall(r'\(property "(\S+)" "(.*)"', text))
    assert fields == {
        "Reference": "X", "Value": "amp", "Footprint": "", "Datasheet": "",
        "Description": "amp: a title", "Sim.Device": "SUBCKT", "Sim.Library": "amp.lib",
        "Sim.Name": "amp", "Sim.Pins": "1=inp 2=inn 3=out 4=vcc 5=vee 6=ref",
    }  # fmt: skip
    shown = re.findall(r'\(property "(\w+)" "\w+"\n\t+\(at (\S+) (\S+) 0\)', text)[:2]
    assert shown == [("Reference", "2.54", "7.58"), ("Value", "2.54", "5.58")]
    assert text.count("(hide yes)") == 7
    assert "(pin_names (offset 0.508) hide)" in text
    assert [line.strip() for line in text.splitlines() if "no)" in line] == [
        "(exclude_from_sim no)", "(in_bom no)", "(on_board no)",
    ]  # fmt: skip
    assert "(exclude_from_sim yes)" in library([SYMBOLS["PROBE"]])
    assert "(power)" in library([SYMBOLS["GND"]])
    assert library([SYMBOLS["GND"]]).count("(hide yes)") == 5


def test_fields_stand_above_their_place_on_a_sheet_too():
    symbol = SYMBOLS["R"]
    placed = {tree[1]: tree[3][1:3] for tree in symbol.properties(symbol.fields, 10.0, 20.0, up=-1)}
    left, top = symbol.text
    assert placed["Value"] == (10 + left, 20 - top)
    assert placed["Reference"] == (10 + left, 20 - top - 2)
    assert placed["Description"] == (10, 20)


TWO_POLE = (((0, 2, "top"), (0, -2, "bottom")), (GRID + 0.8, -0.9), False)
CONTROLLED = (
    ((3, 1, "right"), (3, -1, "right"), (-3, 1, "left"), (-3, -1, "left")),
    (-2 * GRID, 2 * GRID + 1.3), True,
)  # fmt: skip
PLACES = dict.fromkeys("VIRCLFHB", TWO_POLE) | dict.fromkeys("EG", CONTROLLED)
PLACES |= {
    "GND": (((0, 0, "top"),), (0.0, -4.0), False),
    "PWR_FLAG": (((0, 0, "bottom"),), (0.0, 3.0), False),
    "PROBE": (((0, 0, "bottom"),), (1.5, 2.4), False),
}


def test_sheets_of_users_find_pins_and_words_where_they_were():
    """A moved pin would tear the wires off sheets that stand."""
    assert {k: (s.ends, s.text, s.named_pins) for k, s in SYMBOLS.items()} == PLACES
    drawn = {name: numbers("".join(map(write, SYMBOLS[name].drawing)), "xy") for name in SYMBOLS}
    assert drawn["L"] == [(0, GRID), (0, -GRID)]
    low, side, tip = (0, -1.27), (0.9, -1.27), (0, -2.2)
    assert drawn["GND"] == [(0, 0), low, side, tip, (-0.9, -1.27), low]
    low, side, tip = (0, 1.27), (-1.0, 1.9), (0, 2.54)
    assert drawn["PWR_FLAG"] == [(0, 0), low, side, tip, (1.0, 1.9), low]


def test_a_part_is_a_box_with_its_words_above():
    pins = (Pin("a", "V", "A"), Pin("b", "V", "A"))
    symbol = part_symbol(
        layout(Subcircuit("part", pins, (), "* part\n.subckt part a b\nR1 a b 1\n.ends\n"))
    )
    drawing = "".join(map(write, symbol.drawing))
    assert numbers(drawing, "start") == [(-3 * GRID, GRID)]
    assert numbers(drawing, "end") == [(3 * GRID, -GRID)]
    assert symbol.text == (-3 * GRID, GRID + 1.3)
    assert symbol.ends == ((-4, 0, "left"), (4, 0, "right"))
    assert symbol.named_pins
