"""Mistakes of users whose advice is followed literally: the corrected input then runs."""

import re
import shlex
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from messages import fails, rows, rows_of_error
from small_scenes import AMPLIFIER, DIVIDER
from support import (
    Check,
    LinearModel,
    Port,
    UsageError,
    collect_warnings,
    convert_quantity,
    did_you_mean,
    parse_toml,
    replace_arguments_by_options,
    replace_options_by_arguments,
    require_passed,
    ring_magnet_coils,
    subcircuit,
)

import kc2spice as kc

MESH = Path(__file__).parents[1] / "data" / "coarse_unimorph.msh"
BODY = """[u]
part = "body"
mesh = "u.msh"
unit = "mm"
materials = {{ steel = "steel", pzt = "{ceramic}" }}
fixed = ["root"]
[f]
part = "source"
{source}
[analysis]
type = "ac"
stop = "1 kHz"
"""
RELAY = {"part": "relay", "resistance": "70 Ohm", "voltage": "5 V", "operate_time": "10 ms",
         "pins": {"plus": "d.out", "no": "d.out", "com": "gnd"}}  # fmt: skip
DRIVE = {"part": "source", "dc": "5 V"}
AMPLIFIED = """[drive]
part = "source"
dc = "1 V"
pins = { out = "amp.in" }
[amp]
part = "netlist"
file = "amp.lib"
subckt = "amp"
pins = { out = "load.a" }
[load]
part = "resistor"
resistance = "1 kOhm"
[analysis]
type = "op"
"""
CHAIN = {
    "M": np.eye(3),
    "K": 2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1),
    "B": np.eye(3)[:, :1],
}


@pytest.mark.parametrize(
    ("ceramic", "advised", "source"),
    [
        ("steel", "ports", 'kind = "force"\nac = "1 N"\npins = { out = "u.tip" }'),
        ("PZT-5A", "electrodes", 'ac = "1 V"\npins = { out = "u.anode" }'),
    ],
)
def test_the_ports_that_a_body_without_ports_needs(cli, ceramic, advised, source):
    Path("u.msh").write_text(MESH.read_text())
    scene = BODY.format(ceramic=ceramic, source=source)
    Path("own.toml").write_text(scene)
    found = rows(cli("run", "own.toml").stderr)
    assert "a body needs electrodes or ports" in found["head"]
    advice = found["next"].removeprefix("add for example  ")
    assert advice.startswith(f"{advised} = ")
    Path("own.toml").write_text(scene.replace("fixed =", f"{advice}\nfixed ="))
    assert cli("run", "own.toml").exit_code == 0


def test_the_port_of_a_mesh_that_cannot_be_read_is_at_a_point(cli):
    Path("own.toml").write_text(BODY.format(ceramic="steel", source=""))
    assert "at = [0, 0, 0]" in rows(cli("run", "own.toml").stderr)["next"]


def test_a_misspelt_metric_of_a_sweep_keeps_the_first_point(cli):
    swept = ("duffing", "--set", "mass.mass=1 g,2 g", "--workers", "1")
    done = cli("sweep", *swept, "--metric", "mass_peak")
    found = rows_of_error(done.stderr)
    assert done.exit_code == 2
    assert found["expected"].count(",") <= 5
    name = re.fullmatch(r"did you mean '(.*)'\?", found["next"])[1]
    assert [item.name for item in Path("duffing_sweep").iterdir()] == ["rows.sqlite"]
    assert cli("sweep", *swept, "--metric", name).exit_code == 0


@pytest.mark.slow
@pytest.mark.parametrize("typed", ["300", "500"])
def test_a_sphere_beyond_the_table_names_the_voltage_and_leaves_no_files(cli, typed):
    done = cli("run", "kick_and_catch", "--set", f"kick.drive.voltage={typed}")
    found = rows_of_error(done.stderr)
    assert done.exit_code == 5
    assert found["expected"].startswith("heights from -2.5 mm to 7.5 mm")
    assert not list(Path().glob("kick_and_catch*"))
    advice = r'lower the drive voltage, such as (\S+) = "(.*)"'
    key, voltage = re.fullmatch(advice, found["next"]).groups()
    done = cli("run", "kick_and_catch", "--set", f"{key}={voltage}")
    assert (done.exit_code, "VIOLATED" in done.stdout) == (0, False)


def test_a_failed_check_describes_value_and_limit_of_the_input():
    advice = "the sphere moved outside the height range of the force table: raise catch.y_max"
    check = Check("table_left", 1e-3, 0.0, "m", advice, found="heights to 8 mm", accepted="7.5 mm")
    with pytest.raises(kc.errors.SimulationError) as caught:
        require_passed((check,), "scene")
    assert (caught.value.got, caught.value.expected) == ("heights to 8 mm", "7.5 mm")


@pytest.mark.parametrize(
    ("pins", "head", "advice"),
    [
        ('pins = ["battery.out", "gnd"]', "pins is not a table",
         'write  pins = { a = "battery.out", b = "gnd" }'),
        ('pins = "battery.out"', "pins is not a table", 'write  pins = { a = "battery.out" }'),
        ('pins = { a = ["battery.out"] }', "the pin a must be connected to exactly one pin",
         'write  a = "battery.out"'),
        ("pins = { a = 3 }", "the pin a must be connected to exactly one pin",
         'write  a = "battery.out"'),
        ("pins = 3", "pins is not a table", 'write  pins = { a = "battery.out" }'),
    ],
)  # fmt: skip
def test_pins_of_a_wrong_type(cli, pins, head, advice):
    text = DIVIDER.replace('pins = { a = "battery.out" }', pins)
    Path("own.toml").write_text(text)
    found = rows(cli("run", "own.toml").stderr)
    assert head in found["head"]
    assert found["next"] == advice
    stated = advice.removeprefix("write  ")
    stated = stated if stated.startswith("pins") else f"pins = {{ {stated} }}"
    kc.load_scene(parse(DIVIDER.replace('pins = { a = "battery.out" }', stated)))


def parse(text):
    Path("right.toml").write_text(text)
    return "right.toml"


def test_tolerance_and_order_in_the_words_of_each_interface(cli):
    np.savez("chain.npz", **CHAIN)
    words = ("reduce", "chain.npz", "--tolerance", "1e-3")
    found = rows(cli(*words, "--order", "1").stderr)
    assert found["next"] == "leave out --order"
    assert cli(*words).exit_code == 0
    with pytest.raises(kc.errors.UsageError) as caught:
        kc.reduce(kc.read_model("chain.npz"), tolerance=1e-3, order=1)
    assert caught.value.hint == "leave out order"
    found = rows(cli("reduce", "chain.npz", "--band", "10", "0").stderr)
    assert found["next"] == "write --band 0 10"
    with pytest.raises(kc.errors.UsageError) as caught:
        kc.fit("buzzer_7bb_20_6", "disc", kc.read_model("chain.npz"), [])
    assert "--" not in str(caught.value)


@pytest.mark.parametrize(
    ("option", "argument"),
    [
        ("add --band 0 2e4", "add band=(0, 2e4)"),
        ("add  --shunt '100 Ohm'", "add  shunt='100 Ohm'"),
        ("leave out --order", "leave out order"),
        ("the option --vary is missing", "the argument vary is missing"),
        ("add --vary damping.quality=10:200", "add vary=['damping.quality=10:200']"),
        ("add --tolerance 1e-4, or a band", "add tolerance=1e-4, or a band"),
    ],
)
def test_options_and_arguments_translate_into_each_other(option, argument):
    error = kc.errors.UsageError(option, hint=option)
    replace_options_by_arguments(error)
    assert (error.message, error.hint) == (argument, argument)
    replace_arguments_by_options(error, ("band", "shunt", "order", "vary", "tolerance"))
    assert (error.message, error.hint) == (option, option)


@pytest.mark.parametrize(
    ("line", "otherwise", "head", "advice"),
    [
        ('of = "load.i"', 'take = "max"', "probes.current.of is missing", r'add  of = "\w+\.\w+"'),
        ('of = "load.i"', 'of = "load.i"\ntake = "average"', "not one of the choices",
         r'write  take = "mean"'),
        ('resistance = "1 kOhm"', 'R = "1 kOhm"', "unknown key", "write resistance in place of R"),
        ('resistance = "1 kOhm"', 'ohmic = "1 kOhm"', "unknown key",
         "write resistance in place of ohmic"),
        ('part = "resistor"', 'type = "resistor"', "the key `part` is missing",
         r'write  part = "resistor"  in place of type'),
        ('resistance = "1 kOhm"', 'resistance = ["1 kOhm"]', "not a quantity",
         'without brackets: "1 kOhm"'),
        ('dc = "10 V"', 'file = "C:\\Users\\me\\w.csv"', "not in the folder of this file",
         'copy w.csv into the folder of this file, and write  file = "w.csv"'),
    ],
)  # fmt: skip
def test_a_key_in_words_of_another_program(cli, line, otherwise, head, advice):
    Path("own.toml").write_text(DIVIDER.replace(line, otherwise))
    found = rows(cli("run", "own.toml").stderr)
    assert head in found["head"]
    assert re.search(advice, found["next"])


@pytest.mark.parametrize(
    ("data", "got"),
    [
        (b"# 5 \xb5F\n", "in line 1: # 5 \u00b5F"),
        ("# text".encode("utf-16"), "UTF-16"),
    ],
)
def test_a_scene_in_another_encoding(cli, data, got):
    Path("own.toml").write_bytes(data)
    found = rows(cli("run", "own.toml").stderr)
    assert found["head"].endswith("this text file is not encoded in UTF-8")
    assert got in found["got"]
    assert "with the encoding UTF-8" in found["next"]


@pytest.mark.parametrize(
    ("name", "content", "head", "advice"),
    [
        ("u.msh", "", "this file is empty", "export u.msh again"),
        ("u.stl", "solid x\nendsolid\n", "not a mesh or CAD file", "save the CAD model as .step"),
        ("u.msh", MESH.read_text()[:3000], "gmsh cannot read", "export u.msh again"),
    ],
)
def test_a_mesh_file_that_is_no_mesh(cli, name, content, head, advice):
    Path(name).write_text(content)
    scene = BODY.format(
        ceramic="steel", source='kind = "force"\nac = "1 N"\npins = { out = "u.tip" }'
    )
    port = 'ports = [{ name = "tip", group = "topel", axis = "z" }]\n'
    Path("own.toml").write_text(scene.replace("u.msh", name).replace("fixed", f"{port}fixed"))
    found = rows(cli("run", "own.toml").stderr)
    assert head in found["head"]
    assert str(Path.cwd()) not in found["head"]
    assert advice in found["next"]
    assert found["expected"].count(",") <= 5


def test_matrices_in_lower_case_and_matrices_that_are_missing(cli):
    np.savez("chain.npz", **{name.lower(): matrix for name, matrix in CHAIN.items()})
    found = rows(cli("reduce", "chain.npz").stderr)
    assert found["got"] == "m, k, b"
    line = re.fullmatch(r"write  (.*)  into chain.toml", found["next"])[1]
    Path("chain.toml").write_text(line + "\n")
    assert cli("reduce", "chain.npz").exit_code == 0
    Path("beam.K").write_text("%%MatrixMarket matrix coordinate real symmetric\n1 1 1\n1 1 5.0\n")
    found = rows(cli("reduce", "beam.K").stderr)
    assert found["next"] == "add the files beam.B and beam.M"
    Path("beam.B").write_text("%%MatrixMarket matrix coordinate real general\n1 1 1\n1 1 1.0\n")
    found = rows(cli("reduce", "beam.K").stderr)
    assert "the model has no matrix M" in found["head"]
    assert found["next"] == "add the file beam.M"
    Path("beam.M").write_text("%%MatrixMarket matrix coordinate real symmetric\n1 1 1\n1 1 2.0\n")
    assert cli("reduce", "beam.K", "-o", "out").exit_code == 0


@pytest.mark.parametrize(
    ("change", "head", "advice"),
    [
        ((".ends\n", ""), "this subcircuit has no end", "add the line  .ends amp"),
        (("R2 out ref 1k", "R2 out ref 1k\nS1 out ref in ref SX"), "no such model",
         "add the line  .model SX SW(vt=1 vh=0 ron=1 roff=1meg)"),
        (("R2 out ref 1k", "R2 out ref 1k\nX1 out ref sub"), "no such subcircuit", ".subckt sub"),
        (("R2 out ref 1k", "R2 out ref {gain}"), "no such parameter", ".param gain="),
    ],
)  # fmt: skip
def test_a_mistake_in_a_netlist(cli, change, head, advice):
    Path("amp.lib").write_text(AMPLIFIER.replace(*change))
    Path("own.toml").write_text(AMPLIFIED)
    found = rows(cli("run", "own.toml").stderr)
    assert head in found["head"]
    assert advice in found["next"]


def test_a_deck_without_a_subcircuit_becomes_a_part(cli):
    """The first error states all changes: card, end and key of the scene."""
    deck = "low pass\nR1 in out 1k\nR2 out ref 1k\n.op\n.end\n"
    Path("amp.lib").write_text(deck)
    Path("own.toml").write_text(AMPLIFIED)
    found = rows(cli("run", "own.toml").stderr)["next"]
    assert (
        ".subckt NAME NODE1 NODE2 ref  and  .ends, without title, analysis and .end lines" in found
    )
    assert found.endswith('write  subckt = "NAME"  in the scene')
    Path("amp.lib").write_text(".subckt NAME in out ref\nR1 in out 1k\nR2 out ref 1k\n.ends\n")
    Path("own.toml").write_text(AMPLIFIED.replace('subckt = "amp"', 'subckt = "NAME"'))
    assert cli("run", "own.toml").exit_code == 0


@pytest.mark.parametrize("words", [(), ("--set", "amp.parameters.RL=2000")])
def test_parameters_of_a_netlist_that_differ_in_letter_case_only(cli, words):
    """SPICE ignores letter case, so one of the two values would have no effect."""
    Path("amp.lib").write_text(AMPLIFIER.replace("ref\n", "ref RL=1k\n", 1))
    values = "{ rl = 1e3 }" if words else "{ rl = 1e3, RL = 2e3 }"
    subckt = 'subckt = "amp"'
    assert subckt in AMPLIFIED
    Path("own.toml").write_text(AMPLIFIED.replace(subckt, f"{subckt}\nparameters = {values}"))
    found = rows(cli("run", "own.toml", *words).stderr)
    assert "the names of two parameters differ in letter case only" in found["head"]
    assert found["got"] == "rl and RL"
    assert found["next"] == "delete rl or RL; to override rl, write rl in place of RL"
    Path("own.toml").write_text(AMPLIFIED.replace(subckt, f"{subckt}\nparameters = {{ rl = 2e3 }}"))
    assert cli("run", "own.toml").exit_code == 0


def test_a_pin_that_the_subckt_line_lacks(cli):
    """Without the pin, no current flows, so the output would be wrong without an error."""
    circuit = "* amp\n.subckt amp in out\nE1 a ref in 0 2\nR1 a out 1k\nR2 a ref 1k\n.ends\n"
    Path("amp.lib").write_text(circuit)
    Path("own.toml").write_text(AMPLIFIED)
    ran = cli("run", "own.toml")
    assert "no current can flow through the pin out" in ran.stderr
    assert "add ref to the .subckt line" in " ".join(ran.stderr.split())
    Path("amp.lib").write_text(circuit.replace("amp in out", "amp in out ref"))
    ran = cli("run", "own.toml")
    assert ran.exit_code == 0
    assert "no current" not in ran.stderr


@pytest.mark.parametrize("card", ["D1 out ref MAKER", "Q1 out in ref MAKER"])
def test_a_missing_model_of_a_manufacturer(cli, card):
    """A default model would run with another characteristic, so the advice contains none."""
    amplifier = AMPLIFIER.replace(".ends", f"{card}\n.ends")
    Path("amp.lib").write_text(amplifier)
    Path("own.toml").write_text(AMPLIFIED)
    assert rows(cli("run", "own.toml").stderr)["next"] == (
        "copy the  .model MAKER  line of the manufacturer into this file, or include the file "
        "that contains this line"
    )
    kind = {"D": "D(Is=1e-12)", "Q": "NPN(Bf=50)"}[card[0]]
    Path("maker.lib").write_text(f".model MAKER {kind}\n")
    for more in (f".model MAKER {kind}\n", ".include maker.lib\n"):
        Path("amp.lib").write_text(amplifier + more)
        assert cli("run", "own.toml").exit_code == 0


def test_a_scene_without_parts_begins_with_a_built_in_scene(cli):
    Path("empty.toml").write_text('title = "nothing"\n')
    found = rows(cli("run", "empty.toml").stderr)
    assert "the scene has no parts" in found["head"]
    command = re.fullmatch(r"begin with a built-in scene:  kc2spice (.*) > my.toml", found["next"])
    Path("my.toml").write_text(cli(*command[1].split()).stdout)
    assert cli("explain", "my.toml").exit_code == 0


def test_a_deck_of_another_scene(cli):
    assert cli("export", "duffing", "--out", "d").exit_code == 0
    # gap_biased has an element with the same name, but another analysis
    for scene in ("impact", "gap_biased"):
        for command in ("run", "verify"):
            found = rows_of_error(cli(command, scene, "--deck", "d/duffing.cir").stderr)
            assert "this deck is not a deck of this scene" in found["head"]
            assert f"kc2spice export {scene}" in found["next"]


def test_names_of_other_programs(cli):
    found = rows(cli("export", "duffing", "--dialect", "pspice").stderr)
    assert found["next"].startswith("try ltspice")
    with pytest.raises(AttributeError, match="did you mean 'load_scene'"):
        kc.load  # noqa: B018
    with pytest.raises(kc.errors.UsageError, match=r"kc.reduce\(kc.read_model\('c.npz'\)"):
        kc.reduce("c.npz", order=1)


@pytest.mark.parametrize(
    ("typed", "unit", "advice"),
    [
        ("1 in", "m", "0.0254 m"),
        ("2 mil", "m", "5.08e-05 m"),
        ("2 g", "m/s2", "19.6133 m/s2"),
        ("1 g0", "m/s2", "9.80665 m/s2"),
        ("1 bar", "Pa", "100000 Pa"),
        ("60 rpm", "Hz", "1 Hz"),
        ("7.75 g/cc", "kg/m3", "7750 kg/m3"),
        ("0.8 cm", "m3", "0.8 cm3"),
        ("3 mm", "m2", "3 mm2"),
        ("4k7", "Ohm", "4.7 kOhm"),
        ("2R2", "Ohm", "2.2 Ohm"),
        ("100 nf", "F", "100 nF"),
        ("1 mhz", "Hz", "1 MHz"),
    ],
)
def test_units_outside_of_the_si_are_converted(typed, unit, advice):
    """Values of NIST SP 811, appendix B."""
    assert fails(convert_quantity, typed, unit).hint == f'write  "{advice}"'
    convert_quantity(advice, unit)


@pytest.mark.parametrize(
    ("scene", "override", "head", "advice"),
    [
        ("buzzer_noise", "analysis.start=0", "a noise analysis cannot begin at 0 Hz",
         "write  --set 'analysis.start=20 Hz'"),
        ("sounder_in_housing", "listener.angle=120", "behind the baffle",
         "lower the key `angle` to 90"),
        ("sounder_in_housing", "hole.area=7 mm2", "the duct has two sizes",
         "leave out --set 'hole.area=7 mm2'"),
        ("gap_biased", "gap.travel=9 um", "behind the fixed electrode",
         "lower travel below 1e-06 m"),
        ("gap_biased", "gap.side=over", "not one of the choices", 'write  side = "above"'),
        ("harvester_bridge", "d1.IS=1e-14", "unknown key",
         "write saturation_current in place of IS"),
        ("buzzer_noise", "disc.damping=50", "not a table", "write  damping = { quality = 50 }"),
        ("buzzer_noise", "disc.layers[1].electrodes=18 mm", "larger than their layer",
         "lower layers[1].electrodes to 14 mm"),
        ("buzzer_noise", "analysis.stop=1 ms", "wrong unit", 'stop = "100 kHz"'),
    ],
)  # fmt: skip
def test_the_value_or_key_to_write(cli, scene, override, head, advice):
    found = rows(cli("run", scene, "--set", override).stderr)
    assert head in found["head"]
    assert advice in found["next"]


def test_a_poisson_ratio_of_a_liquid_is_named():
    metal = {"density": 7750, "youngs_modulus": "60 GPa", "poisson_ratio": 0.6}
    layer = {"diameter": "20 mm", "thickness": "0.5 mm"}
    disc = {"part": "disc", "layers": [layer | {"material": "PZT-4"}, layer | {"material": metal}]}
    with pytest.raises(kc.errors.UsageError, match="Poisson ratio"):
        kc.build({"plate": disc})


def test_objects_of_a_wrong_kind_in_python():
    constants = {"M": np.eye(2), "K": np.eye(2), "B": np.ones((2, 1))}
    cases = (
        (lambda: kc.LinearModel(**constants, ports=["tip"]), 'kc.Port("tip", "mechanical")'),
        (lambda: kc.LinearModel(**(constants | {"M": 1j * np.eye(2)})), "write M.real"),
        (lambda: kc.LinearModel(**constants).transfer([[1, 2], [3, 4]]), "numpy.ravel"),
        (lambda: kc.read_lib("amp.lib"), "copy amp.lib to"),
        (lambda: kc.load_scene("impact", ["values.toml"]), "in place of values.toml"),
    )
    for call, advice in cases:
        with pytest.raises(kc.errors.UsageError) as caught:
            call()
        assert advice in caught.value.hint


def test_the_output_of_a_noise_analysis_is_searched_in_its_part():
    names = ["disc.voltage", "load.v", "load.i"]
    assert did_you_mean("load.voltage", names) == "did you mean 'load.v'?"


def test_voltages_of_a_relay_in_the_wrong_order():
    with pytest.raises(kc.errors.UsageError) as caught:
        kc.load_scene({"k": RELAY | {"pick_up": "0.5 V", "release": "3 V"}, "d": DRIVE})
    assert 'pick_up = "3 V" and release = "0.5 V"' in caught.value.hint
    kc.load_scene({"k": RELAY | {"pick_up": "3 V", "release": "0.5 V"}, "d": DRIVE})


def test_keys_of_the_analysis_at_the_top_of_a_scene(cli):
    Path("own.toml").write_text('stop = "1 s"\n' + DIVIDER)
    assert rows(cli("run", "own.toml").stderr)["next"] == 'write  stop = "1 s"  in [analysis]'
    text = DIVIDER.replace('[analysis]\ntype = "op"\n', "")
    Path("own.toml").write_text('analysis = "op"\n' + text)
    found = rows(cli("run", "own.toml").stderr)
    assert found["next"] == 'write  [analysis]  and below it  type = "op"'


@pytest.mark.parametrize(
    ("typed", "moved"),
    [
        ("r.error_budget=0.02", "error_budget=0.02"),
        ("analysis.error_budget=0.02", "error_budget=0.02"),
        ("r.checks.energy=off", """'checks={ energy = "off" }'"""),
        ("r.gravity=0", "gravity=0"),
    ],
)
def test_a_key_of_the_scene_below_a_table(cli, typed, moved):
    text = '[r]\npart = "resistor"\nresistance = 1\n[v]\npart = "source"\ndc = 1\n'
    text += 'pins = { out = "r.a" }\n[analysis]\ntype = "op"\n'
    Path("own.toml").write_text(text)
    found = rows(cli("run", "own.toml", "--set", typed).stderr)["next"]
    assert found.startswith(f"move the key: write  --set {moved}  in place of --set ")
    done = cli("run", "own.toml", *shlex.split(found.partition("write ")[2].partition(" in ")[0]))
    assert done.exit_code == 0, done.stderr
    holder, _, key = typed.partition("=")[0].partition(".")
    if "." not in key:
        line = f"{key} = {typed.partition('=')[2]}\n"
        Path("own.toml").write_text(text.replace(f"[{holder}]\n", f"[{holder}]\n{line}"))
        found = rows(cli("run", "own.toml").stderr)["next"]
        assert found == (
            f"move the key: write  {line.strip()}  in the scene file above its first table"
        )
        Path("own.toml").write_text(line + text)
        assert cli("run", "own.toml").exit_code == 0


def test_a_missing_mesh_file_and_an_unknown_unit(cli):
    port = 'ports = [{ name = "tip", group = "topel", axis = "z" }]\n'
    source = 'kind = "force"\nac = "1 N"\npins = { out = "u.tip" }'
    scene = BODY.format(ceramic="steel", source=source).replace("fixed", f"{port}fixed")
    Path("own.toml").write_text(scene)
    found = rows(cli("run", "own.toml").stderr)
    assert found["next"].startswith("copy u.msh into the folder")
    Path("u.msh").write_text(MESH.read_text())
    Path("own.toml").write_text(scene.replace('"mm"', '"millimetre"'))
    assert rows(cli("run", "own.toml").stderr)["next"] == 'write  unit = "mm"'


@pytest.mark.parametrize(
    ("losses", "cause"),
    [([0.1, 0.1], "with an output whose rate jumps"), ([0.1, 0.0], "with an output that jumps")],
)
def test_an_acceleration_port_without_its_massless_states_has_a_netlist(losses, cause):
    """The second state has no mass. With the input u, it has ``d x2' + 2 x2 = x1 + u``."""
    ports = (Port("base", "acceleration"), Port("tip", "mechanical"))
    K, B = np.array([[2.0, -1.0], [-1.0, 2.0]]), np.array([[-1.0, 0.0], [-1.0, 1.0]])

    def write(B, C):
        matrices = {"M": np.diag([1.0, 0.0]), "E": np.diag(losses), "K": K}
        return subcircuit(LinearModel(**matrices, B=B, C=C, ports=ports), "frame")

    with pytest.raises(UsageError, match="netlists do not support an acceleration port") as caught:
        write(B, B.T)
    assert caught.value.got.startswith(f"an acceleration port {cause}")
    assert "set the rows of B and the columns of C" in caught.value.hint
    B[1] = 0.0
    write(B, B.T)


SWITCH = """.subckt switch a c
S1 a 0 c 0 SMOD
.model SMOD VSWITCH(Ron=50 Roff=1Meg Von=2 Voff=0.5)
.ends
"""
SWITCHED = {
    "drive": {"part": "source", "dc": "3 V"},
    "load": {"part": "resistor", "resistance": "50 Ohm",
             "pins": {"a": "drive.out", "b": "circuit.a"}},
    "circuit": {"part": "netlist", "file": "switch.lib", "subckt": "switch",
                "pins": {"a": "load.b", "c": "drive.out"}},
    "analysis": {"type": "op"},
    "probes": {"current_a": {"of": "load.i"}},
}  # fmt: skip


def test_a_switch_of_pspice_in_an_own_circuit(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("switch.lib").write_text(SWITCH)
    error = fails(kc.run, SWITCHED)
    assert error.message == "model type VSWITCH exists in PSpice but not in ngspice"
    assert error.where == "switch.lib:3"
    assert error.hint == 'add  syntax = "pspice"  to the table of the netlist part'
    result = kc.run(SWITCHED | {"circuit": SWITCHED["circuit"] | {"syntax": "pspice"}})
    assert result.metrics["current_a"] == pytest.approx(3 / 100, rel=1e-3)


def test_a_card_that_ngspice_rejects_is_quoted(tmp_path, monkeypatch):
    """A transistor model at a diode, of which ngspice's first message is only 'Error on line'."""
    monkeypatch.chdir(tmp_path)
    Path("switch.lib").write_text(".subckt switch a c\nD1 a c N\n.model N NPN(Bf=50)\n.ends\n")
    with pytest.raises(kc.errors.SimulationError, match=r"in the card d.* incorrect model"):
        kc.run(SWITCHED)


@pytest.mark.parametrize(
    ("typed", "advised"),
    [
        ("100:1 kOhm:5", "100 Ohm:1 kOhm:5"),
        ("log:100:1 kOhm:5", "log:100 Ohm:1 kOhm:5"),
        ("100 Ohm:1000:5", "100 Ohm:1000 Ohm:5"),
        ("1 kOhm:3:3", "1 kOhm:3 kOhm:3"),
        ("2:1 kOhm:5", "2 Ohm:1 kOhm:5"),
        ("normal(1 kOhm,100,5)", "normal(1 kOhm,100 Ohm,5)"),
        ("normal(2,0.1 kOhm,5)", "normal(2 kOhm,0.1 kOhm,5)"),
        ("normal(1 kOhm,2 %,5)", "normal(1 kOhm,0.02 kOhm,5)"),
        ("normal(1e3,2 %,5)", "normal(1e3,20,5)"),
        ("100 .. 1000", "100:1000:5"),
        ("1 to 2 kOhm", "1 kOhm:2 kOhm:5"),
    ],
)
def test_a_range_with_one_unit_or_with_dots(cli, typed, advised):
    Path("divider.toml").write_text(DIVIDER)
    failed = cli("sweep", "divider.toml", "--set", f"load.resistance={typed}", "--dry-run")
    assert rows(failed.stderr)["next"] == f"write {advised}"
    done = cli("sweep", "divider.toml", "--set", f"load.resistance={advised}", "--dry-run")
    assert done.exit_code == 0, done.stderr


def test_a_constant_of_a_named_material(cli):
    key = "disc.layers[0].material.youngs_modulus=normal(100e9,2e9,3)"
    failed = cli("sweep", "buzzer_7bb_20_6", "--set", key, "--dry-run")
    advice = re.fullmatch(r"set (.*) before this key", rows(failed.stderr)["next"])[1]
    done = cli("sweep", "buzzer_7bb_20_6", "--set", advice, "--set", key, "--dry-run")
    assert done.exit_code == 0, done.stderr


def test_percent_at_a_key_with_a_unit(cli):
    Path("divider.toml").write_text(DIVIDER)
    failed = cli("run", "divider.toml", "--set", "load.resistance=2 %")
    assert rows(failed.stderr)["next"] == 'write a number with its unit, such as "1 Ohm"'
    done = cli("run", "divider.toml", "--set", "load.resistance=1 Ohm")
    assert done.exit_code == 0, done.stderr


def test_a_range_with_a_unit_of_another_quantity(cli):
    Path("divider.toml").write_text(DIVIDER)
    failed = cli("sweep", "divider.toml", "--set", "load.resistance=100:1 s:5", "--dry-run")
    assert "wrong unit 's'" in rows(failed.stderr)["head"]


@pytest.mark.parametrize("text", ["100 .. 1000", "100-1000", "100 to 1000", "100:1000:5"])
def test_a_range_as_text_in_python(text):
    scene = kc.load_scene(parse_toml(DIVIDER))
    error = fails(kc.sweep, scene, {"load.resistance": text})
    assert error.hint == "write numpy.linspace(100, 1000, 5)"
    table = kc.sweep(scene, {"load.resistance": np.linspace(100, 1000, 5)}, workers=1)
    assert table["status"] == ["ok"] * 5
    error = fails(kc.load_scene, scene, {"load.resistance": text})
    assert error.message.endswith("this key accepts one value, not a range or a list")
    assert error.hint == "write one value, such as  100; kc2spice sweep accepts a range or a list"
    kc.load_scene(scene, {"load.resistance": 100})


@pytest.mark.parametrize(
    ("typed", "unit", "advised"),
    [
        ("0.3 kg", "m", "0.3 mm"),
        ("2 kN", "m", "2 mm"),
        ("3 V", "F", "3 nF"),
        ("5 uF", "H", "5 uH"),
        ("5 kV", "Ohm", "5 kOhm"),
        ("5 MV", "Hz", "5 MHz"),
        ("5 mm", "kg", "5 mg"),
    ],
)
def test_a_wrong_unit_is_replaced_by_a_usual_unit(typed, unit, advised):
    hint = fails(convert_quantity, typed, unit).hint
    assert hint == f'write  "{advised}"  if the value is in {advised.split()[1]}'
    convert_quantity(advised, unit)


@pytest.mark.parametrize(
    ("unit", "first", "second"),
    [
        ("F", "20 nF", "20 F"),
        ("kg", "20 g", "20 kg"),
        ("m2", "20 mm2", "20 m2"),
        ("V", "20 V", "20 mV"),
        ("Ohm", "20 Ohm", "20 kOhm"),
        ("Hz", "20 Hz", "20 kHz"),
    ],
)
def test_a_text_without_a_unit_gets_a_usual_unit(unit, first, second):
    assert re.findall(r'"(.*?)"', fails(convert_quantity, "20", unit).hint) == [first, second]
    convert_quantity(first, unit)
    convert_quantity(second, unit)


@pytest.mark.parametrize(("typed", "value"), [("2k", 2000), ("4k7", 4700), ("1.5 M", 1.5e6)])
def test_a_plain_number_has_no_prefix(typed, value):
    hint = fails(convert_quantity, typed, "").hint
    assert convert_quantity(hint.removeprefix("write  "), "") == value


CERAMIC = {"density": 7750, "youngs_modulus": "66 GPa", "poisson_ratio": 0.35,
           "permittivity": {"eps11": 1730, "eps33": 1700}, "permittivity_at": "stress"}  # fmt: skip
METAL = {"density": 9000, "youngs_modulus": "105 GPa", "poisson_ratio": 0.34, "conductor": True}
BEAM = {"part": "bimorph", "length": "20 mm", "width": "3 mm", "pins": {"anode": "drive.out"}}
PLATE = {"part": "disc", "pins": {"anode": "drive.out"}}


@pytest.mark.parametrize(
    "body", [BEAM, {**BEAM, "wiring": "series"}, PLATE], ids=["beam", "wired beam", "disc"]
)
def test_an_own_ceramic_without_piezoelectric_constants(body):
    def load(**constants):
        layers = [{"material": item, "thickness": "0.2 mm"} for item in (METAL, CERAMIC)]
        layers[1]["material"] = CERAMIC | constants
        if body is PLATE:
            layers = [layer | {"diameter": "10 mm"} for layer in layers]
        drive = {"part": "source", "ac": "1 V"}
        return kc.load_scene({"body": {**body, "layers": layers}, "drive": drive})

    error = fails(load)
    lines = error.hint.removeprefix("add to layers[1].material:  ")
    lines = lines.removesuffix("  with the values of the data sheet")
    assert lines.startswith('symmetry = "6mm", strain_coupling = { d31 = ')
    assert "permittivity" not in lines
    missing = parse_toml(lines.replace(", strain_coupling", "\nstrain_coupling"))
    kc.build(load(**missing))


def test_a_clamp_of_a_beam_is_at_one_end_or_at_both():
    hint = fails(kc.load_scene, "harvester", {"beam.support": "clamp"}).hint
    assert (
        hint == 'write  support = "clamped"  for both ends, or  support = "cantilever"  for one end'
    )
    kc.load_scene("harvester", {"beam.support": "cantilever"})
    hint = fails(kc.load_scene, "buzzer_7bb_20_3", {"disc.support": "clamp"}).hint
    assert hint == 'write  support = "clamped"'


def test_a_sine_with_an_offset():
    sine = {"part": "source", "sine": {"amplitude": "1 V", "frequency": "1 kHz"}}
    load = {"part": "resistor", "resistance": "1 kOhm", "pins": {"a": "drive.out"}}
    scene = {"drive": sine, "load": load, "analysis": {"type": "transient", "stop": "2 ms"},
             "probes": {"top": {"of": "load.v", "take": "max"},
                        "bottom": {"of": "load.v", "take": "min"}}}  # fmt: skip
    advice = 'add  [bias]  with  part = "source"'
    assert advice in fails(kc.load_scene, scene, {"drive.sine.offset": 2}).hint
    assert advice in fails(kc.load_scene, scene, {"drive.dc": 2}).hint
    bias = {"part": "source", "dc": "2 V"}
    result = kc.run(scene | {"bias": bias, "drive": sine | {"pins": {"ret": "bias.out"}}})
    assert result.metrics["top"] == pytest.approx(3, abs=0.02)
    assert result.metrics["bottom"] == pytest.approx(1, abs=0.02)


def test_the_resistance_of_an_inductor():
    scene = {
        "drive": {"part": "source", "ac": "1 V"},
        "coil": {"part": "inductor", "inductance": "1 mH", "pins": {"a": "drive.out"}},
    }
    error = fails(kc.load_scene, scene, {"coil.series_resistance": "1 Ohm"})
    assert error.hint == (
        "delete the key, and connect a part of type resistor in series with the inductor"
    )


def test_a_pin_that_a_body_has_only_if_the_scene_joins_it():
    tables = {
        "disc": {
            "part": "disc",
            "layers": [
                {"material": "brass", "diameter": "20 mm", "thickness": "0.2 mm"},
                {"material": "PZT-5A", "diameter": "14 mm", "thickness": "0.22 mm"},
            ],
            "pins": {"anode": "drive.out"},
        },
        "tip": {"part": "mass", "mass": "1 mg"},
        "drive": {"part": "source", "ac": "1 V"},
        "analysis": {"type": "ac", "start": "1 kHz", "stop": "14 kHz"},
    }
    error = fails(kc.load_scene, tables)
    assert error.expected.startswith("a displacement pin: disc.centre")
    assert error.hint == "add  'pins': {'a': 'disc.centre'}  to the dict tip"
    kc.load_scene(tables | {"tip": tables["tip"] | {"pins": {"a": "disc.centre"}}})
    piston = {"part": "radiation", "radius": "5 mm"}
    joined = tables | {"air": piston, "tip": tables["tip"] | {"pins": {"a": "disc.centre"}}}
    hint = fails(kc.load_scene, joined).hint
    assert hint == "add  'pins': {'face': 'disc.front_face'}  to the dict air"
    wrong = joined | {"air": piston | {"pins": {"face": "tip.a"}}}
    assert fails(kc.load_scene, wrong).hint == 'write  face = "disc.front_face"'
    kc.load_scene(joined | {"air": piston | {"pins": {"face": "disc.front_face"}}})


@pytest.mark.parametrize(
    ("number", "kind"),
    [("7bb-20-6", "bvd"), ("12PR300", "loudspeaker"), ("G5LE-1 DC12", "relay"),
     ("ECS-.327-12.5-13X", "crystal"), ("7BB-35-3", "disc")],
)  # fmt: skip
def test_a_part_number_without_values_proposes_the_command_that_prints_them(cli, number, kind):
    Path("own.toml").write_text(f'[x]\npart = "{kind}"\nnumber = "{number}"\n')
    found = rows_of_error(cli("run", "own.toml").stderr)
    form = r'write  part = "(\w+)"  and the keys that the command  kc2spice (.*)  prints'
    advised, command = re.fullmatch(form, found["next"]).groups()
    assert advised == kind
    table = cli(*shlex.split(command)).stdout.partition("TOML table of this part in a scene:")[2]
    ((name, keys),) = parse_toml(table).items()
    tables = kc.load_scene(number).tables  # the test circuit, for the pins of the part
    keys |= {"pins": tables[name].get("pins", {})}
    assert kc.load_scene({**tables, "name": "own", name: keys}).parts[name].type.name == kind


def test_an_unknown_part_number_without_values_names_the_missing_keys():
    error = fails(kc.load_scene, {"x": {"part": "bvd", "number": "MINE-1"}})
    assert error.hint == "add fs, fp, cm and rm"


@pytest.mark.parametrize(
    ("voltage", "top", "advised"),
    [(300, 10e-3, 120), (-300, 10e-3, -120), (50, 10e-3, 36), (-50, 10e-3, -36), (-50, 30e-3, -21)],
)
def test_the_advised_drive_voltage_keeps_its_sign(recwarn, voltage, top, advised):
    """Heights are proportional to the square of the voltage; the stack withstands 121 V."""
    scene = kc.load_scene("kick_and_catch", {"kick.drive.voltage": voltage})
    table = SimpleNamespace(y=np.array([-2.5e-3, 7.5e-3]))
    advice = ring_magnet_coils._advise_less_energy(scene, np.array([0.0, top]), table)
    assert advice == f'lower the drive voltage, such as kick.drive.voltage = "{advised} V"'
    assert top * (advised / voltage) ** 2 < 7.5e-3


@pytest.mark.parametrize(
    ("speed", "shape"),
    [(50, "rings"), (1000, "rings"), pytest.param(30, "pressure", marks=pytest.mark.slow)],
)
def test_the_advised_rings_and_speed_let_a_fast_impact_run(recwarn, speed, shape):
    """At 50 m/s, more rings suffice; at 1 km/s, the sphere would enter the chip completely."""
    typed = {"impact.velocity": f"-{speed} m/s", "contact.shape": shape}
    with pytest.raises(kc.errors.SimulationError) as caught:
        kc.run("impact", overrides=typed)
    error = caught.value
    advised = dict(re.findall(r"([a-z.]+\.[a-z.]+) = \"?(-?[\d.]+(?: m/s)?)", error.hint))
    advised["kick.mesh.rings"] = int(advised["kick.mesh.rings"])
    assert ("impact.velocity" in advised) == (speed == 1000)
    if speed == 1000:
        assert error.got == "a speed of 1000 m/s, set by impact.velocity"
    run = kc.run("impact", overrides={**typed, **advised})
    assert run.metrics["rebound_velocity_m_s"] > 0


def test_a_ring_larger_than_half_of_the_sphere_has_too_large_a_spacing(recwarn):
    """No number of rings of this spacing fits, so the advice is neither rings nor a speed."""
    typed = {"impact.velocity": "-15 m/s", "sphere.radius": "0.5 mm", "solver.stop": "60 us",
             "contact.penalty": "1e4 N/m", "kick.mesh.rings": 1}  # fmt: skip
    with pytest.raises(kc.errors.SimulationError) as caught:
        kc.run("impact", overrides={**typed, "kick.mesh.ring_spacing": "0.3 mm"})
    assert caught.value.hint.endswith("lower kick.mesh.ring_spacing")


@pytest.mark.parametrize(
    ("layer", "key", "got", "advised"),
    [
        ({"diameter": "24 mm", "electrodes": "30 mm"}, "diameter", "'24 mm'",
         {"diameter": "20 mm", "electrodes": "20 mm"}),
        ({"diameter": "24 mm", "electrodes": "22 mm"}, "diameter", "24 mm",
         {"diameter": "20.4 mm", "electrodes": "20.4 mm"}),
        ({"electrodes": "15 mm"}, "electrodes", "'15 mm'", {"electrodes": "14 mm"}),
    ],
)  # fmt: skip
def test_the_advised_sizes_of_a_layer_and_its_electrodes_fit(layer, key, got, advised):
    ceramic = {"material": "PZT-5A", "diameter": "14 mm", "thickness": "0.2 mm"}
    plate = {"material": "brass", "diameter": "20 mm", "thickness": "0.2 mm"}

    def tables(changes):
        layers = [plate, ceramic | layer | changes]
        return {"disc": {"part": "disc", "layers": layers}, "analysis": {"type": "ac", "stop": 1e4}}

    error = fails(kc.load_scene, tables({}))
    assert error.where.endswith(f"disc.layers[1].{key}")
    assert error.got == got
    assert f"{advised[key]}" in error.hint
    assert "electrodes" in error.hint
    kc.load_scene(tables(advised))


def test_the_advised_name_of_a_port_with_the_name_of_an_inner_node_works(cli):
    """The names p1 and q1 belong to the modes of the body; the mesh is not solved before."""
    text = BODY.format(
        ceramic="steel", source='kind = "force"\nac = "1 N"\npins = { out = "u.p1" }'
    )
    port = 'ports = [{ name = "p1", group = "topel", axis = "z" }]\n'
    text = text.replace("[f]", f"{port}[f]")
    Path("u.msh").write_bytes(MESH.read_bytes())
    Path("named.toml").write_text(text)
    refused = cli("run", "named.toml")
    shown = rows_of_error(refused.output)
    assert "already contains this name, for an internal node" in shown["head"]
    assert shown["got"] == "p1"
    assert shown["next"] == "rename p1, for example to my_p1"
    Path("named.toml").write_text(text.replace('"p1"', '"my_p1"').replace("u.p1", "u.my_p1"))
    assert cli("run", "named.toml").exit_code == 0


SPRING = {
    "spring": {"part": "spring", "stiffness": 1e3},
    "push": {"part": "source", "kind": "force", "pins": {"out": "spring.a"},
             "sine": {"amplitude": 2e-3, "frequency": 10.0}},
    "analysis": {"type": "transient", "stop": 0.1},
}  # fmt: skip


@pytest.mark.parametrize("level", ["-1.2 um", "-1.2um", "\N{MINUS SIGN}1.2 um", -1.2e-6])
def test_the_level_of_a_crossing_accepts_a_negative_length(level):
    """x = 2 um sin(2 pi t / 100 ms) first falls to -1.2 um after half a period and an arc."""
    probe = {"of": "push.x", "take": "crossing", "level": level}
    found = kc.run({"name": "arc", **SPRING, "probes": {"fall_s": probe}}).metrics["fall_s"]
    assert found == pytest.approx(0.05 + np.arcsin(0.6) / (2 * np.pi * 10), rel=1e-3)


@pytest.mark.parametrize(
    ("level", "got", "hint"),
    [
        ("-1.2 V", "a value in V", "write a level in m"),
        ("1 nonsense", "'1 nonsense'", "write a number with the unit of the result"),
    ],
)
def test_a_level_in_the_unit_of_another_quantity_is_refused(level, got, hint):
    probe = {"of": "push.x", "take": "crossing", "level": level}
    error = fails(kc.run, {"name": "arc", **SPRING, "probes": {"fall_s": probe}})
    assert got in str(error.got)
    assert error.hint.startswith(hint)


def test_the_advice_for_a_plain_number_never_drops_a_unit():
    """A key without a unit: ``write -1.2`` would turn micrometres into metres."""
    assert fails(convert_quantity, "-1.2 um", "").hint.startswith("write a plain number")


# --- changes of keys in the form in which the user typed them -------------------------------------


def test_a_range_of_the_wrong_sign_is_corrected_beside_another_invalid_range(cli):
    """The error of the other range does not count as a rejection of the corrected range."""
    other = ("--set", "analysis.stop=1:2:3")
    found = rows(
        cli("sweep", "impact", *other, "--set", "impact.velocity=1:2:3", "--dry-run").stderr
    )
    words = shlex.split(found["next"])
    assert words == ["write", "--set", "impact.velocity=-1:-2:3"]
    assert cli("sweep", "impact", *words[1:], "--dry-run").exit_code == 0
    next_error = rows(cli("sweep", "impact", *other, *words[1:], "--dry-run").stderr)
    assert "impact.velocity" not in next_error["head"]


def test_an_override_in_another_table_is_named_as_the_cause(cli):
    """The sphere of 5 mm is larger than the hole of the ring, whose size the scene states."""
    typed = ("--set", "gravity=9.8", "--set", "sphere.radius=5 mm")
    found = rows(cli("explain", "kick_and_catch", *typed).stderr)
    assert "catch.ring.inner" in found["head"]
    assert found["next"] == "change --set 'sphere.radius=5 mm', or raise inner above 0.005 m"
    error = fails(kc.load_scene, "kick_and_catch", {"sphere.radius": "5 mm"})
    assert error.hint.startswith("change 'sphere.radius=5 mm' in the overrides, or raise inner")
    kc.load_scene("kick_and_catch", {"sphere.radius": "1.1 mm"})


def test_the_search_for_the_cause_issues_no_warnings():
    """Without the override of the radius, the keys of `solver` would have no effect."""
    overrides = {"sphere.radius": "5 mm", "analysis": {"type": "ac", "stop": "1 kHz"}}
    with collect_warnings() as texts:
        fails(kc.load_scene, "kick_and_catch", overrides)
    assert not texts


def test_an_error_that_no_override_causes_names_no_override(cli):
    Path("divider.toml").write_text(DIVIDER.replace('"1 kOhm"', '"1 kg"', 1))
    found = rows(cli("explain", "divider.toml", "--set", "title=a", "--set", "gravity=0").stderr)
    assert "--set" not in found.get("next", "")


def test_a_missing_amplitude_is_added_as_an_override(cli):
    Path("divider.toml").write_text(DIVIDER)
    typed = ("--set", 'analysis={type="ac", stop="1 kHz"}')
    hint = rows(cli("explain", "divider.toml", *typed).stderr)["next"]
    option = shlex.split(hint[hint.index("--set", 1) :].rpartition("add  ")[2] or hint)
    assert cli("explain", "divider.toml", *typed, *option).exit_code == 0


def test_the_unit_of_another_quantity_proposes_the_kind_of_the_source(cli):
    heat = (
        '[drive]\npart = "source"\ndc = "60 K"\npins = { out = "wall.a" }\n[wall]\n'
        'part = "thermal_resistor"\nresistance = "1 K/W"\n[analysis]\ntype = "op"\n'
    )
    Path("heat.toml").write_text(heat)
    found = rows(cli("explain", "heat.toml").stderr)
    assert found["next"] == 'add  kind = "temperature"  to [drive]'
    Path("heat.toml").write_text(heat.replace("[drive]", '[drive]\nkind = "temperature"'))
    assert cli("explain", "heat.toml").exit_code == 0
    Path("heat.toml").write_text(heat.replace("60 K", "60 V"))
    words = shlex.split(rows(cli("explain", "heat.toml", "--set", "drive.dc=60 K").stderr)["next"])
    assert words == ["add", "--set", "drive.kind=temperature"]
    assert cli("explain", "heat.toml", "--set", "drive.dc=60 K", *words[1:]).exit_code == 0
    error = fails(kc.load_scene, parse_toml(heat))
    assert error.hint == "add  'kind': 'temperature'  to the dict drive"
    row = fails(kc.load_scene, {"f": {"part": "source", "pwl": [[0, "0 N"], [1, "1 N"]]}})
    assert "force" in row.hint


@pytest.mark.parametrize("kind", ["force", "voltage"])
def test_a_stated_kind_of_a_source_is_not_changed(kind):
    keys = {"part": "source", "kind": kind, "dc": "60 K"}
    assert fails(kc.load_scene, {"f": keys}).hint.startswith('write  "60 ')


@pytest.mark.parametrize(
    ("scene", "key", "values"),
    [("divider.toml", "load.resistance", [1000, 2000]),
     ("divider.toml", "load.resistance", ["1 kOhm", "2 kOhm"]),
     ("divider.toml", "battery.dc", [1.5, 2]),
     ("impact", "rom.order", [10, 20])],
)  # fmt: skip
def test_a_list_for_one_value_proposes_a_sweep(cli, scene, key, values):
    Path("divider.toml").write_text(DIVIDER)
    typed = f"{key}={str(values).replace(chr(39), chr(34))}"
    found = rows(cli("explain", scene, "--set", typed).stderr)
    assert "accepts one value" in found["head"]
    command = shlex.split(found["next"].partition(":  ")[2])
    assert command[:3] == ["kc2spice", "sweep", scene]
    done = cli(*command[1:], "--dry-run")
    assert done.exit_code == 0
    assert "2 points" in done.stdout + done.stderr
    error = fails(kc.load_scene, scene, {key: values})
    assert error.hint.endswith(f"  kc.sweep({scene!r}, {{{key!r}: {values!r}}})")


def test_a_list_in_a_scene_file_proposes_a_sweep(cli):
    Path("divider.toml").write_text(
        DIVIDER.replace('resistance = "1 kOhm"', "resistance = [1, 2]", 1)
    )
    found = rows(cli("explain", "divider.toml").stderr)
    assert found["next"].endswith("  kc2spice sweep divider.toml --set load.resistance=1,2")
    error = fails(kc.load_scene, parse_toml(Path("divider.toml").read_text()))
    assert error.hint.endswith("  kc.sweep(SCENE, {'load.resistance': [1, 2]})")


def test_an_override_to_delete_is_named_in_the_form_of_the_user(cli):
    error = fails(kc.load_scene, "buzzer_square", {"solver.max_step": "1 s"})
    assert error.hint == "remove 'solver.max_step=1 s' from the overrides"
    Path("over.toml").write_text('[solver]\nmax_step = "1 s"\n')
    found = rows(cli("explain", "buzzer_square", "--set", "over.toml").stderr)
    assert found["next"] == "delete the key `solver.max_step` of over.toml"


@pytest.mark.parametrize("text", ['[analysis]\ntype = "op"\n', 'analysis.type = "op"\n'])
def test_a_type_of_analysis_in_an_override_file_moves_to_an_option(cli, text):
    """An option after the file sets the whole table, whatever form the file has."""
    Path("over.toml").write_text(text)
    typed = ("explain", "stack_p882", "--set", "over.toml")
    found = rows(cli(*typed).stderr)
    deletion, _, addition = found["next"].partition(", and add  ")
    assert deletion == "delete the key `analysis.type` of over.toml"
    Path("over.toml").write_text("")
    assert cli(*typed, *shlex.split(addition)).exit_code == 0


def test_an_unknown_key_in_python_overrides_is_replaced():
    error = fails(kc.load_scene, "impact", {"order": 10})
    assert error.hint == "write  'rom.order': 10  in the overrides  in place of 'order=10'"
    kc.load_scene("impact", {"rom.order": 10})
