"""KiCad symbols: how a part is simulated, and where pins and words are."""

import re

from kc2spice.netlist.circuit import Pin, Subcircuit
from kc2spice.netlist.printers.box import layout
from kc2spice.netlist.printers.kicad import GRID, element_symbols, library, part_symbol, write

SYMBOLS = element_symbols()


def numbers(text, head):
    """Numbers of every ``(head …)``."""
    found = re.findall(rf"\({head} ([-0-9. ]+)\)", text)
    return [tuple(map(float, each.split())) for each in found]


def amplifier():
    names = ("inp", "inn", "out", "vcc", "vee", "ref")
    cards = "E1 out ref inp inn 1\nR1 vcc vee 1"
    text = f"* amp: a title\n.subckt amp {' '.join(names)}\n{cards}\n.ends\n"
    return part_symbol(layout(Subcircuit("amp", tuple(Pin(n, "V", "A") for n in names), (), text)))


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
