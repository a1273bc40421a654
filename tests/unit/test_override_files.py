"""Overrides from files: paths are relative to the file, and replaced part types are explained."""

import re
import shlex
from ast import literal_eval

import pytest
from support import collect_warnings, load_scene

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


def warnings_of(*args):
    """The scene with overrides, and the texts of the warnings."""
    with collect_warnings() as texts:
        scene = load_scene(*args)
    return scene, list(texts)


@pytest.fixture
def files(tmp_path, monkeypatch):
    """A function that writes an override file of this name and text in the current folder."""
    monkeypatch.chdir(tmp_path)
    return lambda name, text: (tmp_path / name).write_text(text)


def test_a_table_of_an_override_file_replaces_a_text(cli, files):
    """The scene states support = "free"; a sweep accepts the same file as a run."""
    files("support.toml", '[disc]\nsupport = { node = "12 mm" }\n')
    keys = load_scene("buzzer_7bb_20_6", ["support.toml"]).get_part("disc").keys
    option = load_scene("buzzer_7bb_20_6", ['disc.support={ node = "12 mm" }'])
    assert keys.support == option.get_part("disc").keys.support != "free"
    sweep = ("sweep", "buzzer_7bb_20_6", "--set", "drive.ac=1,2", "--set", "support.toml")
    assert cli(*sweep, "--dry-run").exit_code == 0
    files("support.toml", '[disc]\nsupport = { node = "30 mm" }\n')
    for command in (("explain", *sweep[1:2], *sweep[4:]), (*sweep, "--dry-run")):
        found = cli(*command)
        assert found.exit_code == 2
        assert "the nodal circle is outside of the body" in found.stderr


def test_an_option_for_a_key_below_a_text_is_an_error():
    with pytest.raises(kc.errors.UsageError, match="is a value, not a table"):
        load_scene("buzzer_7bb_20_6", ["disc.support.node=12 mm"])


@pytest.mark.parametrize(
    "overrides",
    [
        {"disc": {"damping": {"ratio": 0.01}}},
        {"disc": {"damping.ratio": 0.01}},
        ["disc={ damping = { ratio = 0.01 } }"],
    ],
)
def test_a_table_of_a_part_changes_only_its_keys(overrides):
    before = load_scene("buzzer_7bb_20_6").get_part("disc")
    after = load_scene("buzzer_7bb_20_6", overrides).get_part("disc")
    assert (after.keys.damping.ratio, after.keys.damping.quality) == (0.01, None)
    assert after.keys.layers == before.keys.layers
    assert after.pins == before.pins


def test_a_table_with_a_part_type_replaces_the_part():
    table = {"part": "capacitor", "capacitance": 1e-7, "pins": {"a": "gate.out"}}
    series = load_scene("buzzer_square", {"series": table}).get_part("series")
    assert (series.type.name, series.keys.capacitance) == ("capacitor", 1e-7)


@pytest.mark.parametrize(
    ("scene", "text", "note"),
    [
        ("impact", "rom.tolerance=1e-5", "'rom.tolerance=1e-5' replaces rom.order = 30"),
        ("buzzer_7bb_20_6", "disc.damping.ratio=0.02",
         "'disc.damping.ratio=0.02' replaces disc.damping.quality = 50"),
        ("buzzer_7bb_20_6", "disc.damping.loss_factor=0.04",
         "'disc.damping.loss_factor=0.04' replaces disc.damping.quality = 50"),
    ],
)  # fmt: skip
def test_a_key_that_excludes_a_key_of_the_scene_replaces_it_with_a_note(scene, text, note):
    """A damping ratio of 0.02 is a loss factor of 0.04 and a Q factor of 25, not 50."""
    found, texts = warnings_of(scene, [text])
    assert texts == [f"{note} of the scene"]
    if scene == "impact":
        assert (found.rom.order, found.rom.tolerance) == (None, 1e-5)
    else:
        assert found.get_part("disc").keys.damping.zeta == 0.02


def test_a_key_that_is_false_excludes_no_key():
    found, texts = warnings_of("buzzer_7bb_20_6", ["disc.damping.per_material=false"])
    assert found.get_part("disc").keys.damping.quality == 50
    assert texts == []


def test_the_losses_of_materials_replace_a_stated_damping():
    found, texts = warnings_of("buzzer_7bb_20_6", ["disc.damping.per_material=true"])
    damping = found.get_part("disc").keys.damping
    assert (damping.per_material, damping.quality) == (True, None)
    assert texts == [
        "'disc.damping.per_material=true' replaces disc.damping.quality = 50 of the scene"
    ]


@pytest.mark.parametrize(
    ("texts", "quality", "warned"),
    [
        (["q30.toml", "q80.toml"], 80, True),
        (["disc.damping.quality=30", "q80.toml"], 80, True),
        (["q30.toml", "disc.damping.quality=80"], 80, False),
        (["disc.damping.quality=30", "disc.damping={ quality = 80 }"], 80, False),
        (["disc.damping.loss_tangent=0.1", "disc.damping={ quality = 80 }"], 80, True),
    ],
)
def test_a_replaced_override_is_warned_of(files, texts, quality, warned):
    """An option after a file may change a key of the file without a warning."""
    files("q30.toml", "[disc.damping]\nquality = 30\n")
    files("q80.toml", "[disc.damping]\nquality = 80\n")
    found, warnings = warnings_of("buzzer_7bb_20_6", texts)
    assert found.get_part("disc").keys.damping.quality == quality
    assert any("has no effect, because" in text for text in warnings) == warned


@pytest.mark.parametrize("keys", ["order = 20\ntolerance = 1e-5", "tolerance = 1e-5\norder = 20"])
def test_keys_of_a_file_that_exclude_each_other_are_warned_of(files, keys):
    files("rom.toml", f"[rom]\n{keys}\n")
    found, warnings = warnings_of("impact", ["rom.toml"])
    first, last = (line.partition(" ")[0] for line in keys.splitlines())
    assert getattr(found.rom, first) is None
    assert any(f"'rom.{first}=" in text and f"'rom.{last}=" in text for text in warnings)


def test_the_advised_table_of_a_new_part_type_keeps_the_pins(cli, files):
    files("series.toml", '[series]\npart = "capacitor"\ncapacitance = "100 nF"\n')
    typed = ("explain", "buzzer_square", "--set", "series.toml")
    advice = cli(*typed).stderr.partition("add  ")[2]
    assert cli(*typed, *shlex.split(advice)).exit_code == 0


def test_a_mistyped_name_of_an_override_file_is_corrected(cli, files):
    files("over.toml", "[impact]\nvelocity = -1\n")
    found = cli("explain", "impact", "--set", "over.tml").stderr
    assert "this file does not exist" in found
    name = re.search(r"did you mean '(.*)'\?", found)[1]
    assert cli("explain", "impact", "--set", name).exit_code == 0


@pytest.mark.parametrize("deleted", ["order", "tolerance"])
def test_one_of_two_excluding_keys_of_a_table_is_left_out(cli, deleted):
    keys = {"order": "30", "tolerance": "1e-5"}
    both = ", ".join(f"{key} = {value}" for key, value in keys.items())
    assert "delete the key `order`" in cli("explain", "impact", "--set", f"rom={{ {both} }}").stderr
    keys.pop(deleted)
    one = ", ".join(f"{key} = {value}" for key, value in keys.items())
    assert cli("explain", "impact", "--set", f"rom={{ {one} }}").exit_code == 0


def test_the_note_about_a_tolerance_names_the_option_of_the_user(cli, tmp_path):
    found = cli("export", "impact", "--tolerance", "0.01", "--out", str(tmp_path / "o"))
    assert found.exit_code == 0
    assert "warning: --tolerance 0.01 replaces rom.order = 30 of the scene" in found.stderr
