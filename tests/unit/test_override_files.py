"""Overrides from files: paths are relative to the file, and replaced part types are explained."""

import re
import shlex
from ast import literal_eval

import pytest
from support import load_scene

import kc2spice as kc

LIBRARY = """* a divider of {ohms} Ohm
.subckt divider in out ref
R1 in out {ohms}
R2 out ref 1k
.ends
"""
TABLE = """
[amp]
part = "netlist"
file = "divider.lib"
subckt = "divider"
pins = { in = "drive.out" }
[analysis]
type = "op"
[probes.volts]
of = "amp.out"
take = "final"
[drive]
dc = 2.0
[load]
part = "resistor"
resistance = 1e12
pins = { a = "amp.out" }
"""
SCENE = '[drive]\npart = "source"\ndc = 1.0\n[solver]\nstop = "1 ms"\n'


@pytest.fixture
def override(tmp_path, monkeypatch):
    """An override file with a netlist beside it; another netlist of the name beside the scene."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "scenes").mkdir()
    (tmp_path / "mine" / "over.toml").write_text(TABLE)
    (tmp_path / "mine" / "divider.lib").write_text(LIBRARY.format(ohms="3k"))
    (tmp_path / "scenes" / "divider.lib").write_text(LIBRARY.format(ohms="1k"))
    (tmp_path / "scenes" / "scene.toml").write_text(SCENE)
    monkeypatch.chdir(tmp_path)
    return "mine/over.toml"


def test_a_file_of_an_override_file_is_beside_it(override):
    """2 V at 3 kOhm and 1 kOhm give 0.5 V; the netlist beside the scene would give 1 V."""
    result = kc.run("scenes/scene.toml", overrides=[override])
    assert result.metrics["volts"] == pytest.approx(0.5, rel=1e-6)
    again = load_scene(load_scene("scenes/scene.toml", [override]), {"drive.dc": 4.0})
    assert kc.run(again).metrics["volts"] == pytest.approx(1.0, rel=1e-6)


def test_a_file_of_a_single_override_is_beside_the_scene(override):
    result = kc.run("scenes/scene.toml", overrides=[override, "amp.file=divider.lib"])
    assert result.metrics["volts"] == pytest.approx(1.0, rel=1e-6)


def test_a_file_of_a_built_in_scene_is_in_the_working_directory(override, monkeypatch):
    texts = ["amp.part=netlist", "amp.subckt=divider", "amp.pins.in=drive.out",
             "load.part=resistor", "load.resistance=1e3", "load.pins.a=amp.out"]  # fmt: skip
    scene = load_scene("buzzer_7bb_20_6", [*texts, "amp.file=mine/divider.lib"])
    assert [pin.name for pin in scene.pins("amp")] == ["in", "out", "ref"]
    with pytest.raises(kc.errors.UsageError, match="absent"):
        load_scene("buzzer_7bb_20_6", [*texts, "amp.file=absent.lib"])


def test_a_file_outside_of_the_folder_of_an_override_file_is_rejected(override, tmp_path):
    path = tmp_path / override
    path.write_text(TABLE.replace("divider.lib", "../scenes/divider.lib"))
    with pytest.raises(kc.errors.UsageError):
        kc.run("scenes/scene.toml", overrides=[override])


@pytest.mark.parametrize("form", ["file", "text", "mapping"])
def test_a_replaced_part_type_is_explained_by_its_override(form, override, tmp_path):
    """The advised table replaces the whole part of a built-in scene, and the scene loads."""
    pins = {"a": "mass.a"}
    (tmp_path / "spring.toml").write_text(
        '[spring]\npart = "spring"\nstiffness = 5.0\npins = { a = "mass.a" }\n'
    )
    overrides = {
        "file": ["spring.toml"],
        "text": ["spring.part=spring", "spring.stiffness=5.0", 'spring.pins={ a = "mass.a" }'],
        "mapping": {"spring.part": "spring", "spring.stiffness": 5.0, "spring.pins": pins},
    }[form]
    with pytest.raises(kc.errors.UsageError, match="does not fit the new part type") as caught:
        load_scene("duffing", overrides)
    error = caught.value
    assert "spring.part" in error.where
    assert "line" not in error.where
    assert "scene duffing: unknown key" in error.got
    if form == "mapping":
        found = re.fullmatch(r".*add  '(\w+)': (\{.*\})  to the overrides", error.hint)
        more = overrides | {found[1]: literal_eval(found[2])}
    else:
        more = [*overrides, shlex.split(error.hint.partition("--set ")[2])[0]]
    assert load_scene("duffing", more).get_part("spring").keys.stiffness == 5.0
