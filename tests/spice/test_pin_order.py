"""The order of the pins in help texts and documents: that of the exported subcircuits."""

import re
from pathlib import Path

import pytest
from support import describe_part_types, load_part_types, load_scene, parse_toml

import kc2spice as kc

ROOT = Path(__file__).parents[2]
DOCS = {doc.name: doc for doc in describe_part_types()}
EXAMPLES = [name for name, kind in load_part_types().items() if kind.example]
IN_SCENES = [name for name, doc in DOCS.items() if doc.scene]
# Pins that tables of documents list, keyed by part type.
ROW = re.compile(r"^\| `(\w+)` \|.*\| ((?:`\w+`[,;]? ?)+)\|$", re.M)
TABLES = {
    name: re.findall(r"\w+", pins)
    for page in sorted((ROOT / "docs").rglob("*.md"))
    for name, pins in ROW.findall(page.read_text(encoding="utf-8"))
    if name in DOCS
}


def pins_of(folder, name):
    """Pins on the line ``.subckt NAME`` of the libraries in a folder."""
    for file in sorted(Path(folder).glob("*.lib")):
        found = re.search(rf"^\.subckt (?:\w+_)?{name} (.*)$", file.read_text(), re.M | re.I)
        if found:
            return [word for word in found[1].split() if "=" not in word and word != "params:"]
    return None


def compare(listed, exported):
    """Both list the same pins in the same order, apart from pins that only one of them has."""
    assert exported
    common = [pin for pin in listed if pin in exported]
    assert common == [pin for pin in exported if pin in listed]
    assert len(common) >= min(2, len(exported))


@pytest.mark.parametrize("name", EXAMPLES)
def test_help_lists_the_pins_in_the_order_of_the_library(name, tmp_path):
    tables = {"name": "example", **parse_toml(load_part_types()[name].example)}
    scene = load_scene(tables)
    part = scene.list_parts(name)[0]
    if not scene.has_subcircuit(part):
        pytest.skip("the part has no subcircuit")
    kc.export(tables, tmp_path)
    compare([pin.name for pin in DOCS[name].pins],
            pins_of(tmp_path, part.type.subcircuit_name(part, scene)))  # fmt: skip


@pytest.mark.parametrize("name", IN_SCENES)
def test_help_lists_the_pins_of_committed_libraries_in_their_order(name):
    scene = load_scene(DOCS[name].scene)
    part = scene.list_parts(name)[0]
    if not scene.has_subcircuit(part):
        pytest.skip("the part has no subcircuit")
    (deck,) = (ROOT / "netlists").rglob(f"{scene.name}.cir")
    names = part.type.subcircuit_name(part, scene), name  # equal subcircuits are merged
    exported = pins_of(deck.parent, names[0]) or pins_of(deck.parent, names[1])
    compare([pin.name for pin in DOCS[name].pins], exported)


@pytest.mark.parametrize("name", sorted(TABLES))
def test_documents_list_the_pins_in_the_order_of_the_library(name):
    changed = {"relay": {"changeover": True}}
    tables = {"name": "example", **parse_toml(load_part_types()[name].example)}
    part = load_scene(tables).list_parts(name)[0]
    tables[part.name] = tables[part.name] | changed.get(name, {})
    scene = load_scene(tables)
    part = scene.get_part(part.name)
    exported = [pin.name for pin in part.type.pins(part, scene)]
    listed = [pin for pin in TABLES[name] if pin in exported]
    assert listed == [pin for pin in exported if pin in listed]
    assert set(exported) - set(listed) <= {"sound1", "ambient"}  # inputs that keys join
