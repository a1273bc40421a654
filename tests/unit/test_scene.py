"""Scenes: the gallery, overrides, and an error that names the key for every sort of mistake."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support import (
    MAX_TEXT_BYTES,
    UsageError,
    compute_scene_hash,
    list_all_keys,
    list_gallery,
    load_scene,
)

import kc2spice as kc


def test_gallery_has_the_papers_experiments():
    assert set(list_gallery()) >= {"kick_and_catch", "impact", "imprint", "harmonic", "em_force"}
    for name in list_gallery():
        scene = load_scene(name)
        assert scene.name == name
        assert scene.title


def test_paper_values():
    scene = load_scene("kick_and_catch")
    assert scene.parts["kick"].keys.drive.width == 25e-6
    assert scene.parts["control"].keys.setpoint == 2.5e-3
    assert scene.parts["control"].keys.rolloff == 100e-9
    assert scene.parts["sphere"].keys.mass == pytest.approx(32.88e-6, rel=1e-3)  # paper: 32.88 mg
    # 1 % of critical damping at 250 kHz: beta omega / 2 = 0.01
    assert scene.parts["kick"].keys.damping.beta * 2 * math.pi * 250e3 / 2 == pytest.approx(
        0.01, rel=1e-14
    )
    assert load_scene("impact").gravity == 0.0
    assert load_scene("impact").parts["kick"].keys.electrical == "open"


@pytest.mark.parametrize(
    ("override", "value"),
    [
        ("kick.drive.voltage=80", 80.0),
        ("kick.drive.voltage = 80 V", 80.0),
        ("kick.drive.voltage='80 V'", 80.0),
        ("kick.drive.voltage=0.08 kV", 80.0),
        ("kick.drive={voltage=80}", 80.0),
    ],
)
def test_override_spellings(override, value):
    assert load_scene("kick_and_catch", [override]).parts["kick"].keys.drive.voltage == value


def test_overrides_apply_in_order_and_spare_the_rest():
    changed = load_scene("kick_and_catch", ["control.kp=1", "control.kp=2", "catch.mu_r=1.5"])
    original = load_scene("kick_and_catch")
    assert changed.parts["control"].keys.kp == 2
    assert changed.parts["catch"].keys.mu_r == 1.5
    assert changed.parts["kick"].keys == original.parts["kick"].keys


def test_order_and_tolerance_replace_each_other():
    rom = load_scene("kick_and_catch", ["rom.tolerance=1e-4"]).rom
    assert (rom.order, rom.tolerance) == (None, 1e-4)
    rom = load_scene("kick_and_catch", ["rom.tolerance=1e-4", "rom.order=12"]).rom
    assert (rom.order, rom.tolerance) == (12, None)
    assert load_scene("impact").rom.order == 30


# Every mistake: the overrides, what the message must contain besides the key that was set.
MISTAKES = [
    ("kick.drive.volage=3", ["unknown key", "did you mean 'voltage'"]),
    ("voltage=3", ["unknown key", "write  --set kick.drive.voltage=3"]),
    ("kik.drive.voltage=3", ["this scene has no part 'kik'", "did you mean 'kick'"]),
    ("kick.drive.voltage=80 m", ["wrong unit 'm'", "number in V"]),
    ("kick.drive.voltage.x=3", ["is a value, not a table"]),
    ("kick=3", ["is a part of this scene, not a key", "write 'kick.side=3 mm'"]),
    ("kick.layers=3.5", ["not a whole number"]),
    ("kick.layers=true", ["not a whole number"]),
    ("kick.layers=0", ["out of range", ">= 1"]),
    ("kick.poling=x", ['poling = "x" needs mounting']),
    ("contact.penalty=nan", ["not a finite number"]),
    ("sphere.density=-1 kg/m3", ["out of range", "> 0 kg/m3"]),
    ("catch.polarity=antiparalel", ["did you mean 'antiparallel'"]),
    ("catch.ring.y=1 mm", []),  # ring magnet and coil side by side are fine
    ("control.current_limit=0", ["out of range"]),
    ("rom.band=[5, 2]", ["the frequency band is empty"]),
    ("rom.band=[5]", ["too few entries", "write  band = [0, 5]"]),
    ("rom={order=3, tolerance=1e-4}", ["both set"]),
    ("rom.order=0", ["out of range"]),
    ("solver.max_step=1", ["longer than the simulation"]),
    ("gates.separation_time=1e-9", ["the unit of this value is missing"]),
    ("name=../evil", ["not allowed", "letters, digits"]),
    ('title="a\\n.control"', ["not allowed", "one line"]),
    ("title=a\n.control", ["not allowed", "one line"]),
    ("include=['a.lib']", ["no part uses these included netlists"]),
    ("catch.driver.linear.rail=48 A", ["wrong unit"]),
    ("kick.driver={}", ["exactly one driver", "half_bridge"]),
    ("kick.driver.user.subckt=amp", ["needs a netlist"]),
    ("catch.driver={}", ["exactly one driver", "linear"]),
    ("catch.driver.user.subckt=amp", ["needs a netlist"]),
    ("nothing", ["the value of the key is missing", "write nothing=VALUE"]),
    ("a..b=1", ["not the name of a key"]),
    ("kick.mesh.refine=1\nfoo=3", ["not a whole number"]),
]


@pytest.mark.parametrize(("override", "parts"), MISTAKES, ids=[text for text, _ in MISTAKES])
def test_mistakes_name_the_key(override, parts):
    if not parts:
        load_scene("kick_and_catch", [override])
        return
    with pytest.raises(UsageError) as error:
        load_scene("kick_and_catch", [override])
    text = str(error.value)
    assert all(part in text for part in parts), text
    assert override.partition("=")[0].split(".")[0] in text
    assert "pydantic" not in text
    assert "Value error" not in text


TEXT = "[kick]\n[contact]\n[sphere]\n[catch]\n[control]\n"


def test_a_file_takes_its_name_from_its_stem(scene_file):
    assert load_scene(scene_file(TEXT)).name == "my"


def test_errors_in_a_file_give_the_line(scene_file):
    path = scene_file(TEXT + "kp = 4\nkd = '3 m'\n")
    with pytest.raises(UsageError, match=r"my\.toml, line 7, key control\.kd: wrong unit"):
        load_scene(path)
    path = scene_file(TEXT + "[kick.drive]\nstart = 0.1\n")
    with pytest.raises(UsageError, match=r"line 7, key kick\.drive\.start: the kick starts"):
        load_scene(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            "[kick]\n[contact]\n[sphere]\n[control]\n",
            "key catch: control needs a part that the scene does not have",
        ),
        ("[sphere]\n[contact]\n", "key contact.a: the scene has no body with a flat surface"),
        ("[kick]\n[contact]\n", "key contact.b: the scene has no sphere that contact can touch"),
        ("[kick]\n[sphere]\n", "key contact: nothing touches the sphere"),
        ("[harmonic]\n", "key harmonic.of: harmonic does not state which piezo_stack it loads"),
        (
            '[disc]\npart = "disc"\nlayers = [{ material = "brass", diameter = "2 mm", '
            'thickness = "1 mm" }]\n'
            '[harmonic]\nof = "disc"\n',
            "key harmonic.of: this part has no rings to load",
        ),
        ("[imprint]\n[sphere]\n", "key contact: imprint needs a part that the scene does not have"),
        ("[em_force]\n[sphere]\n", "key catch: em_force needs a part that the scene does not have"),
        ("[impact]\n[kick]\n", "key sphere: impact needs a part that the scene does not have"),
        ("kick = 10 V", "this text has no quotes"),
        ("a = " + "[" * 50_000, "exceeds a limit"),
        ("a = " + "1" * 5000, "exceeds a limit"),
        ("x = 1\n" * (MAX_TEXT_BYTES // 5), "the file has more than"),
        (b"\xff\xfe\x00", "not encoded in UTF-8"),
        ("[analysis]\ntype = 'transiet'", "did you mean 'transient'"),
        ("# none\n", "the scene has no parts"),
        ("name = 3", "string"),
        (TEXT + "[rom]\norder = 3\ntolerance = 0.1", "both set"),
    ],
)
def test_bad_files(scene_file, content, message):
    with pytest.raises(UsageError) as error:
        load_scene(scene_file(content))
    assert message in str(error.value)
    assert "my.toml" in str(error.value)
    assert len(str(error.value)) < 1000


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("kick_and_cach", "did you mean 'kick_and_catch'"),
        ("no_such_file.toml", "this file does not exist"),
        (".", "is a directory"),
        ("a\0b", "cannot be read"),
    ],
)
def test_missing_scene(name, hint):
    with pytest.raises(UsageError) as error:
        load_scene(name)
    assert hint in str(error.value)


KEYS = [key.name for key in list_all_keys()]
VALUES = st.one_of(
    st.text(max_size=20),
    st.floats().map(repr),
    st.integers().map(repr),
    st.builds("{} {}".format, st.floats(), st.sampled_from(["m", "um", "V", "s", "kHz", "N/m"])),
    st.sampled_from(["{}", "[]", "[1, 2]", "true", "{a=1}", "2020-01-01", "'x'", "inf", "-nan"]),
)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(KEYS), VALUES), max_size=3))
def test_any_override_gives_a_scene_or_one_clear_error(overrides):
    try:
        scene = load_scene("kick_and_catch", [f"{key}={value}" for key, value in overrides])
    except UsageError as error:
        assert error.where  # most values are refused, a few are fine
        assert len(str(error)) < 1500
    else:
        assert len(compute_scene_hash(scene)) == 16


def test_ranges_with_steps_below_rounding_are_rejected():
    """Points that do not differ are refused; a decade has no more points than can be counted."""
    tables = {
        "name": "rc",
        "drive": {"part": "source", "ac": 1.0, "dc": 1.0},
        "r": {"part": "resistor", "resistance": 1e3, "pins": {"a": "drive.out", "b": "gnd"}},
    }
    ac = {"type": "ac", "start": 1e3, "points": 5}
    with pytest.raises(UsageError, match="frequency range is too narrow"):
        load_scene(tables | {"analysis": ac | {"stop": 1e3 * (1 + 1e-12)}})
    result = kc.run(tables | {"analysis": ac | {"stop": 1e3 + 1e-7}})
    assert len(result.frequency) == 5
    assert np.ptp(result.frequency) == pytest.approx(1e-7, rel=1e-3)
    dc = {"type": "dc", "sweep": "drive.dc", "from": 1, "to": 1, "points": 3}
    with pytest.raises(UsageError, match="range of the sweep is empty"):
        kc.deck(tables | {"analysis": dc})
    with pytest.raises(UsageError, match="steps of this dc sweep are too small"):
        kc.deck(tables | {"analysis": dc | {"from": 0, "to": 1e-13}})


def test_the_waveform_of_a_file_is_read_with_the_scene(tmp_path):
    table, toml = tmp_path / "drive.csv", tmp_path / "ramp.toml"
    table.write_text("0, 0\n1e-3, 2\n")
    toml.write_text('[drive]\npart = "source"\nfile = "drive.csv"\n\n'
                    '[load]\npart = "resistor"\nresistance = 1.0\npins = { a = "drive.out" }\n\n'
                    '[analysis]\nstop = 1e-3\n')  # fmt: skip
    scene = load_scene(toml)
    table.unlink()
    assert "Vdrive drive_out 0 PWL(0 0 1m 2)" in kc.deck(scene).files["ramp.cir"]
