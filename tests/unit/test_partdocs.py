"""The reference of part types: every type is there with its pins and keys, from live scenes."""

import json

import pytest

from kc2spice.core.toml import parse_toml
from kc2spice.scene.keys import model_keys
from kc2spice.scene.load import load_scene
from kc2spice.scene.partdocs import part_docs
from kc2spice.scene.parttype import part_types

BY_FILE = {"body", "matrices"}  # their pins stand in files of the user
NO_PINS = {"port_loads", "throw"}


# What 1 V and 1 A mean on each pin; ! must be joined, > gives a signal, = is joined to that unless
# told. Written a second time: users have these in their scenes.
PINS = """
amplifier: command V/-, out V/A!, ref V/A=gnd
bimorph: anode V/A, cathode V/A=gnd, tip um/N, base m/s2/N, ground um/N=gnd
capacitor: a V/A!, b V/A=gnd
charge_drive: command V/-, anode V/A!, cathode V/A!, ref V/A=gnd
contact: ring0 um/N, ring1 um/N, v m/s/N, bottom um/-, base um/N=gnd
controller: tip um/-!, out V/A!, ret V/A=gnd
current_cases: y um/->, v m/s/N=gnd
damper: a um/N!, b um/N=gnd
diode: anode V/A!, cathode V/A!
disc: anode V/A, cathode V/A=gnd, centre um/N, base um/N=gnd
elastic_sphere: patch um/N, base um/N=gnd
half_bridge: command V/-, out V/A!, ref V/A=gnd
inductor: a V/A!, b V/A=gnd
langevin: anode V/A, cathode V/A=gnd, front um/N, back um/N, base um/N=gnd
linear_drive: command V/-, drive V/A!, ret V/A!, ref V/A=gnd
mass: a um/N!, base um/N=gnd
netlist: command V/A!, out V/A!, ref V/A=gnd
pid: y um/-!, enable V/-, drive V/A, sense V/A, ref V/A=gnd
piezo_stack: anode V/A, cathode V/A=gnd, ring0 um/N, ring1 um/N, ring2 um/N, ring3 um/N,
    ring4 um/N, ring5 um/N, base um/N=gnd
push: bottom um/->, v m/s/N=gnd
pwm_drive: command V/-, drive V/A!, ret V/A!, ref V/A=gnd
resistor: a V/A!, b V/A=gnd
ring_magnet_coils: drive V/A, ret V/A, y um/-, v m/s/N, base um/N=gnd
sensor: of um/-!, out um/->, ref V/A=gnd
source: out V/A!, ret V/A=gnd
sphere: v m/s/N, bottom um/->, y um/->, base um/N=gnd
spring: a um/N!, b um/N=gnd
"""


@pytest.fixture(scope="module")
def docs():
    return {doc.name: doc for doc in part_docs()}


def test_every_type_is_there_with_pins_and_keys(docs):
    assert set(docs) >= set(part_types())
    for name, doc in docs.items():
        assert doc.title, name
        assert doc.doc, name
        assert bool(doc.pins) is (name not in BY_FILE | NO_PINS), name
    assert [key.unit for key in docs["resistor"].keys] == ["Ohm"]
    assert {pin.name for pin in docs["piezo_stack"].pins} >= {"anode", "cathode", "ring0", "ring5"}


def test_pins_are_those_of_the_table(docs):
    lines = PINS.replace("\n    ", " ").strip().splitlines()
    expected = {name: pins for name, _, pins in (line.partition(": ") for line in lines)}
    found = {
        name: ", ".join(
            f"{pin.name} {pin.unit}/{pin.flow}" + "!" * pin.required + ">" * pin.signal_out
            + (f"={pin.default}" if pin.default else "")
            for pin in doc.pins
        )
        for name, doc in docs.items() if doc.pins
    }  # fmt: skip
    assert {name: found[name] for name in expected} == expected


def test_examples_are_scenes_that_load():
    for name, kind in part_types().items():
        if kind.example:
            scene = load_scene({"name": "example", **parse_toml(kind.example)})
            assert scene.of(name), name


def test_command_line_lists_them(docs, cli):
    done = cli("scenes", "--parts", "--json")
    listed = {entry["name"]: entry for entry in json.loads(done.stdout)}
    assert list(listed) == list(docs)
    assert [pin["name"] for pin in listed["spring"]["pins"]] == ["a", "b"]


@pytest.mark.parametrize("name", [n for n, kind in part_types().items() if kind.reduced])
def test_every_key_of_every_body_is_described(name):
    assert [k.name for k in model_keys(part_types()[name].schema) if len(k.doc) < 5] == []
