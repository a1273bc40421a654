"""The reference of part types: every type is there with its pins and keys, from live scenes."""

import json

import pytest
from support import describe_part_types, list_schema_keys, load_part_types, load_scene, parse_toml

import kc2spice as kc

BY_FILE = {"body", "matrices"}  # their pins stand in files of the user
NO_PINS = {"port_loads", "throw"}


@pytest.fixture(scope="module")
def docs():
    return {doc.name: doc for doc in describe_part_types()}


def test_every_type_is_there_with_pins_and_keys(docs):
    assert set(docs) >= set(load_part_types())
    for name, doc in docs.items():
        assert doc.title, name
        assert doc.doc, name
        assert bool(doc.pins) is (name not in BY_FILE | NO_PINS), name
    assert [key.unit for key in docs["resistor"].keys] == ["Ohm", "1/K", "K"]
    assert {pin.name for pin in docs["piezo_stack"].pins} >= {"anode", "cathode", "ring0", "ring5"}
    assert (docs["piezo_stack"].short_for, docs["spring"].short_for) == (("kick",), ())


def test_examples_are_scenes_that_load():
    for name, kind in load_part_types().items():
        if kind.example:
            scene = load_scene({"name": "example", **parse_toml(kind.example)})
            assert scene.list_parts(name), name


def test_command_line_lists_them(docs, cli):
    done = cli("scenes", "--parts", "--json")
    listed = {entry["name"]: entry for entry in json.loads(done.stdout)}
    assert list(listed) == list(docs)
    assert [pin["name"] for pin in listed["spring"]["pins"]] == ["a", "b"]


def test_command_line_prints_one_part_type(docs, cli):
    shown = cli("scenes", "--part", "spring").stdout
    assert shown.startswith("spring: ")
    assert all(key.doc.split()[0] in shown for key in docs["spring"].keys)
    record = json.loads(cli("scenes", "--part", "relay", "--json").stdout)
    assert (record["name"], record["scene"]) == ("relay", docs["relay"].scene)
    lines = cli("scenes", "--parts").stdout.splitlines()
    assert {line.split()[0] for line in lines} >= set(docs)


def test_an_unknown_part_type_has_advice(cli):
    failed = cli("scenes", "--part", "sprin")
    assert failed.exit_code == 2
    assert "this part type does not exist" in failed.stderr
    assert "spring" in failed.stderr


@pytest.mark.parametrize(
    "name", [n for n, kind in load_part_types().items() if "rom" in kind.schema.model_fields]
)
def test_every_key_of_every_body_is_described(name):
    assert [
        k.name for k in list_schema_keys(load_part_types()[name].schema) if len(k.doc) < 5
    ] == []


def test_probes_read_each_listed_result_of_a_resistor(docs, cli):
    """The example of the resistor is 1 V across 50 Ohm: 20 mA and 20 mW."""
    expected = {"v": 1.0, "i": 0.02, "current": 0.02, "power": 0.02}
    assert set(docs["resistor"].results) == set(expected)
    shown = " ".join(cli("scenes", "--part", "resistor").stdout.split())
    assert all(f"PART.{result}" in shown for result in expected)
    tables = parse_toml(docs["resistor"].example) | {"analysis": {"stop": 1e-3}}
    probes = {f"{name}_x": {"of": f"resistor.{name}", "take": "final"} for name in expected}
    metrics = kc.run({"name": "example", **tables, "probes": probes}).metrics
    assert {name: metrics[f"{name}_x"] for name in expected} == pytest.approx(expected, rel=1e-6)


def test_an_unknown_result_leads_to_the_list_of_results(cli):
    failed = cli("explain", "loudspeaker_vented", "--set", "probes.stroke_m.of=woofer.nonsense")
    assert "the scene has no such result" in failed.stderr
    command = "kc2spice scenes --part loudspeaker"
    assert f"next:     see {command}, which lists all names" in failed.stderr
    assert "PART.cone.force" in cli(*command.split()[1:]).stdout


def test_every_key_has_a_description_that_stands_alone():
    """Three words or more, and none that begins as the end of another sentence."""
    prepositions = ("of ", "by ", "in ", "on ", "at ", "to ", "from ", "over ", "between ", "its ")
    for name, key in [(doc.name, key) for doc in describe_part_types() for key in doc.keys]:
        where = f"{name}.{key.name}: {key.doc!r}"
        assert len(key.doc.split()) > 2, where
        assert not key.doc.lower().startswith(prepositions), where


def test_pins_that_a_key_adds_are_listed_with_the_key(docs, cli):
    shown = cli("scenes", "--part", "disc").stdout
    pins = shown.partition("\nPins")[2].partition("\nKeys\n")[0].splitlines()
    rows = {line.split()[0]: " ".join(line.split()[1:]) for line in pins if line.strip()}
    assert rows["feedback"] == "layers.feedback"
    assert rows["pin"] == "added by the key"
    assert rows["centre"] == "displacement [µm] force [N] open"
    assert "feedback" in shown
    for name, doc in docs.items():
        assert not doc.optional_pins.keys() & {pin.name for pin in doc.pins}, name
    disc = docs["disc"].optional_pins
    scene = load_scene("alarm_3v")  # a disc with a feedback electrode and a radiating face
    pins = {pin.name for pin in scene.pins("disc")} - {pin.name for pin in docs["disc"].pins}
    assert pins == {"feedback", "front_face", "ambient"}
    assert pins <= disc.keys()
    assert disc["feedback"] == "layers.feedback"
    woofer = {pin.name for pin in load_scene("loudspeaker_vented").pins("woofer")}
    listed = {pin.name for pin in docs["loudspeaker"].pins} | docs[
        "loudspeaker"
    ].optional_pins.keys()
    assert woofer <= listed
