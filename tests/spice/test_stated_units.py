"""Units of values in decks: elements carry them, and every printer states them."""

import re

import pytest
from support import (
    CONSERVATIVE,
    SPICE_UNITS,
    Element,
    StageTimer,
    export_scene,
    prepare_deck,
    write_dialect_files,
)

import kc2spice as kc

HEATED = {
    "name": "heated",
    "drive": {"part": "source", "kind": "heat_flow", "dc": "2 W"},
    "path": {"part": "thermal_resistor", "resistance": 20.0, "pins": {"a": "drive.out"}},
    "store": {"part": "thermal_capacitor", "capacity": 0.5, "pins": {"a": "drive.out"}},
    "analysis": {"type": "transient", "stop": "1 s"},
}
PUSHED = {
    "name": "pushed",
    "drive": {"part": "source", "kind": "force", "dc": "2 mN"},
    "spring": {"part": "spring", "stiffness": 100.0, "pins": {"a": "drive.out"}},
    "damper": {"part": "damper", "damping": 0.5, "pins": {"a": "drive.out"}},
    "load": {"part": "source", "dc": "1 V"},
    "r": {"part": "resistor", "resistance": 50.0, "pins": {"a": "load.out"}},
    "analysis": {"type": "transient", "stop": "1 ms"},
}


def deck_of(scene):
    return prepare_deck(kc.load_scene(scene), StageTimer())[1]


def units(deck):
    """Units of elements by name."""
    return {item.name: item.unit for item in deck.items if isinstance(item, Element) and item.unit}


def test_elements_carry_the_unit_of_their_value():
    """A card of 1 um/N has a volt for a micrometre and an ampere for a newton."""
    heat = units(deck_of(HEATED))
    assert heat == {"Idrive": "W", "Rpath": "K/W", "Cstore": "W s/K"}
    force = units(deck_of(PUSHED))
    assert force == {"Idrive": "N", "Rspring": "um/N", "Cdamper": "N s/um"}
    values = {item.name: item.values[0] for item in deck_of(PUSHED).items}
    assert float(values["Rspring"]) == pytest.approx(1e6 / 100.0)  # um for 1 N
    assert float(values["Cdamper"]) == pytest.approx(0.5 * 1e-6)  # N for 1 um/s


@pytest.mark.parametrize("dialect", ["ngspice", "ltspice", "xyce"])
def test_decks_state_units_that_are_not_the_simulators_own(dialect):
    def lines(scene):
        deck = deck_of(scene)
        return write_dialect_files(deck, dialect)[deck.main_file_name].split("\n")

    heat = lines(HEATED)
    stated = "* Units of the nodes: 1 V = 1 K (temperatures), 1 A = 1 W (heat flows)."
    assert stated in heat
    assert any(line.endswith("; values in W s/K") for line in heat)
    force = lines(PUSHED)
    stated = "* Units of the nodes: 1 V = 1 um (displacements), 1 V = 1 m/s (velocities), "
    assert stated + "1 A = 1 N (forces)." in force
    assert "* r: ideal resistor" in force


def test_a_deck_of_volts_and_amperes_states_no_units():
    scene = {name: PUSHED[name] for name in ("load", "r", "analysis")}
    assert "Units of the nodes" not in deck_of({"name": "plain", **scene}).files["plain.cir"]


def test_kicad_shows_values_with_their_units(tmp_path):
    files = export_scene(kc.load_scene(HEATED), tmp_path)
    (sheet,) = (path for path in files if path.suffix == ".kicad_sch")
    text = sheet.read_text(encoding="utf-8")
    assert re.search(r'"Value" "[^"]*20 K/W"', text)
    assert "20 K/W" not in "".join(re.findall(r'"Sim.Params" "[^"]*"', text))


@pytest.mark.parametrize("domain", CONSERVATIVE, ids=lambda domain: domain.name)
def test_products_of_value_units_are_those_of_the_pins(domain):
    if domain.units == SPICE_UNITS:
        assert not any(domain.find_value_unit(letter) for letter in "VIRCL")
        return
    across, flow = domain.units
    assert (domain.find_value_unit("V"), domain.find_value_unit("I")) == (across, flow)
    assert re.sub(r"[()]", "", domain.find_value_unit("R")) == f"{across}/{flow}"
