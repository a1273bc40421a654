"""What single parts refuse, and the closed forms behind what they say."""

import numpy as np
import pytest

from kc2spice.core.errors import UsageError
from kc2spice.scene.load import load_scene

# --- throw and push -------------------------------------------------------------------------------


def test_a_push_needs_a_contact_and_stays_above_the_middle():
    load_scene("imprint", ["imprint.depth=0.99 mm"])
    with pytest.raises(UsageError, match="deeper than the sphere's radius"):
        load_scene("imprint", ["imprint.depth=1 mm"])
    with pytest.raises(UsageError, match="needs this part"):
        load_scene({"name": "none", "kick": {}, "sphere": {}, "imprint": {}})


# --- sphere and mass ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fits", "refused", "word"),
    [("radius=0.1", "radius=0.101", "adhesion"), ("density=1", "density=0.99", "aerogel"),
     ("density=22600", "density=22600.5", "osmium"), ("radius=1 um", "radius=0.99 um", "adhesion")],
)  # fmt: skip
def test_where_a_sphere_begins_to_be_refused(fits, refused, word):
    alone = {"name": "ball", "sphere": {"velocity": -1.0}}
    load_scene(alone, [f"sphere.{fits}"])
    with pytest.raises(UsageError, match=word):
        load_scene(alone, [f"sphere.{refused}"])
    with pytest.raises(UsageError, match="nothing touches the sphere"):
        load_scene({"name": "loose", "kick": {}, "sphere": {}})


# --- electrical parts -----------------------------------------------------------------------------

CELL = {"name": "cell", "cell": {"part": "source", "dc": 1.0, "pins": {"out": "load.a"}},
        "load": {"part": "resistor", "resistance": 5.0}}  # fmt: skip


@pytest.mark.parametrize(
    ("shape", "word"),
    [({"pulse": {"high": 1, "width": 1e-6, "edge": 1.1e-6}}, "longer than the pulse"),
     ({"pulse": {"high": 1, "width": 1e-6, "edge": 0}}, "longer than the pulse"),
     ({"pulse": {"high": 1, "width": 1e-6, "edge": 1e-7, "period": 1.09e-6}}, "overlap"),
     ({"pwl": [[0, 1]]}, "must rise"), ({"pwl": [[0, 1], [0, 2]]}, "must rise"),
     ({"dc": 1, "sine": {"amplitude": 1, "frequency": 1}}, "two shapes")],
)  # fmt: skip
def test_what_is_no_waveform_is_refused(shape, word):
    with pytest.raises(UsageError, match=word):
        load_scene(CELL | {"cell": {"part": "source", "pins": {"out": "load.a"}, **shape}})


@pytest.mark.parametrize(
    "shape",
    [{"pulse": {"high": 1, "width": 1e-6, "edge": 1e-6}},
     {"pulse": {"high": 1, "width": 1e-6, "edge": 1e-7, "period": 1.1e-6}},
     {"pwl": [[0, 1], [1e-9, 2]]}],
)  # fmt: skip
def test_waveforms_at_their_limits_are_taken(shape):
    load_scene(CELL | {"cell": {"part": "source", "pins": {"out": "load.a"}, **shape}})


def test_a_table_of_a_file_is_read_with_or_without_a_head(tmp_path):
    text = CELL | {"cell": {"part": "source", "file": "w.csv", "pins": {"out": "load.a"}}}
    toml = "[cell]\npart='source'\nfile='w.csv'\npins={out='load.a'}\n"
    toml += "[load]\npart='resistor'\nresistance=5\n"
    (tmp_path / "s.toml").write_text(toml)
    for rows in ("0,1\n2,3\n", "t,v\n0,1\n2,3\n"):
        (tmp_path / "w.csv").write_text(rows)
        scene = load_scene(tmp_path / "s.toml")
        source = scene.parts["cell"].keys.waveform(scene.home)
        np.testing.assert_allclose(source(np.array([0.0, 1.0, 2.0])), [1.0, 2.0, 3.0])
    for rows in ("0,1,2\n1,2,3\n", "0\n1\n", "0,1\nx,2\n"):
        (tmp_path / "w.csv").write_text(rows)
        with pytest.raises(UsageError, match=r"is no table|must rise|cannot be read"):
            load_scene(tmp_path / "s.toml")
    assert text["cell"]["file"] == "w.csv"


# --- pid ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "word"),
    [
        (["control.setpoint=7.49 mm"], None), (["control.setpoint=7.5 mm"], "outside the force"),
        (["control.setpoint=-2.5 mm"], "outside the force"),
        (["control.enable_at=[1e-3, 3e-3]", "control.disable_at=[2e-3]"], None),
        (["control.enable_at=[1e-3]", "control.disable_at=[2e-3]"], None),
        (["control.enable_at=[1e-3, 2e-3]"], "do not alternate"),
        (["control.disable_at=[1e-4]"], "do not alternate"),
        (["control.enable_at=-1e-6"], "do not alternate"),
        (["control.enable_at=0"], None),
        (["control.enable_at=4.9 ms"], None), (["control.enable_at=5 ms"], "after the simulation"),
    ],
)  # fmt: skip
def test_when_a_controller_may_be_on(keys, word):
    if word is None:
        load_scene("kick_and_catch", keys)
        return
    with pytest.raises(UsageError, match=word):
        load_scene("kick_and_catch", keys)


CAUGHT = {"name": "caught", "kick": {}, "contact": {}, "sphere": {}, "catch": {}, "control": {}}


# --- drivers --------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["user", "netlist"])
def test_a_driver_of_the_user_is_in_the_file_that_it_names_or_the_first_included(kind, tmp_path):
    body = "R1 {0} ref 1\nR2 {1} ref 1\nR3 command ref 1\n.ends mine\n"
    chip = ".subckt mine command out ref\n" + body.format("out", "out")
    coils = ".subckt mine command drive ret ref\n" + body.format("drive", "ret")
    for part, text, ends, asks in (
        ("kick", chip, {"out": "kick.anode"}, "kick_drive.out"),
        ("catch", coils, {"drive": "catch.up", "ret": "catch.lp"}, "control.command"),
    ):  # fmt: skip
        for name in ("one.lib", "two.lib", "own.lib"):
            (tmp_path / name).write_text(text)
        for include, own, file in (
            (["one.lib", "two.lib"], "", "one.lib"), (["two.lib"], "file='own.lib'\n", "own.lib"),
            ([], "file='own.lib'\n", "own.lib"),
        ):  # fmt: skip
            (tmp_path / "s.toml").write_text(
                f"include = {include}\n[kick]\n[contact]\n[sphere]\n[catch]\n[control]\n"
                f"[{part}.driver.{kind}]\nsubckt='mine'\n{own}"
            )
            scene = load_scene(tmp_path / "s.toml")
            driver = scene.parts[f"{part}_driver"]
            assert (driver.type.name, driver.keys.file) == ("netlist", file)
            assert driver.pins == ends
            assert scene.net(driver.name, "ref") == "0"
            assert tuple(asks.split(".")) in scene.joined(driver.name, "command")


@pytest.mark.parametrize(("pins", "lacks"), [("command drive back ref", "ret"), ("a b", "drive")])
def test_a_driver_of_coils_without_its_pins_is_refused_by_its_file(pins, lacks, tmp_path):
    (tmp_path / "d.lib").write_text(f".subckt d {pins}\nR1 {pins.split()[1]} 0 1\n.ends\n")
    (tmp_path / "s.toml").write_text(
        "[kick]\n[contact]\n[sphere]\n[catch]\n[control]\n"
        "[catch.driver.user]\nfile='d.lib'\nsubckt='d'\n"
    )
    with pytest.raises(UsageError) as found:
        load_scene(tmp_path / "s.toml")
    assert found.value.where == f"{tmp_path / 's.toml'}, line 8, key catch.driver.user.subckt"
    assert lacks in found.value.message


@pytest.mark.parametrize(
    ("part", "kind", "name", "ends"),
    [
        ("kick", "charge", "charge_drive", {"anode": "kick.anode", "cathode": "kick.cathode"}),
        ("kick", "amplifier", "amplifier", {"out": "kick.anode"}),
        ("kick", "half_bridge", "half_bridge", {"out": "kick.anode"}),
        ("catch", "linear", "linear_drive", {"drive": "catch.up", "ret": "catch.lp"}),
        ("catch", "pwm", "pwm_drive", {"drive": "catch.up", "ret": "catch.lp"}),
        ("catch", "linear_drive", "linear_drive", {"drive": "catch.up", "ret": "catch.lp"}),
    ],
)  # fmt: skip
def test_a_driver_is_joined_to_what_it_drives(part, kind, name, ends):
    loaded = load_scene({**CAUGHT, part: {"driver": {kind: {}}}})
    driver = loaded.parts[f"{part}_driver"]
    assert (driver.type.name, driver.pins) == (name, ends)
    if part == "catch":
        assert driver.type.links(driver, loaded) == {"command": "control.command"}
    for other in ({}, {kind: {}, "second": {}}, {"tube": {}}):
        with pytest.raises(UsageError, match="driver"):
            load_scene({**CAUGHT, part: {"driver": other}})
