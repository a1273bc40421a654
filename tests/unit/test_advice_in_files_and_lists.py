"""Mistakes in netlists, lists and magnitudes whose advice is followed: the input then runs."""

import math
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from messages import fails, rows_of_error
from skfem.mesh import MeshHex
from small_scenes import AMPLIFIER, DISC, RESISTOR, SPEAKER
from support import (
    Solid,
    StageTimer,
    build_models,
    convert_quantity,
    did_you_mean,
    find_material,
    find_mesh_frequency_limit,
    list_gallery,
    parse_toml,
    reduce_file,
    solve_definite,
)

import kc2spice as kc

SCENE = """[drive]
part = "source"
ac = "1 V"
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
type = "ac"
stop = "10 kHz"
"""
CHARGED = """[s]
part = "source"
pwl = [[0, 0], ["1 ms", 5]]
pins = { out = "c.a" }
[c]
part = "capacitor"
capacitance = "1 uF"
[analysis]
type = "transient"
stop = "1 ms"
"""


@pytest.fixture
def refusal(cli):
    """Run ``own.toml`` beside ``amp.lib``; the rows of the error, which leaves no files."""

    def run(scene=SCENE, amplifier=AMPLIFIER):
        Path("own.toml").write_text(scene)
        data = amplifier if isinstance(amplifier, bytes) else amplifier.encode()
        Path("amp.lib").write_bytes(data)
        before = set(Path().iterdir())
        done = cli("run", "own.toml")
        assert done.exit_code == 2
        assert set(Path().iterdir()) == before
        return rows_of_error(done.stderr)

    return run


@pytest.mark.parametrize("law", [
    "Laplace=1/(1+0.001*s)", "LAPLACE {V(in)} = {1/(1+s)}", "laplace=1/(1+s)",
])  # fmt: skip
@pytest.mark.parametrize("source", ["E1 x ref in ref", "B1 x ref V=V(in)", "G1 x ref"])
def test_a_laplace_transform_is_rejected_before_the_simulation(refusal, source, law):
    found = refusal(amplifier=AMPLIFIER.replace("R2", f"{source} {law}\nR2"))
    assert found["head"].endswith("amp.lib:4: the netlist has a Laplace transform, which ngspice "
                                  "cannot simulate")  # fmt: skip
    assert found["next"].startswith("replace this source by R, L, C, E and G elements")


@pytest.mark.parametrize(
    ("line", "number", "advice"),
    [
        ("R3 out ref 1,5k", "1,5k", "1.5k"),
        ("V3 n ref DC 0,5", "0,5", "0.5"),
        (".param gain=2,5", "2,5", "2.5"),
        (".model DX D(IS=1e-14 N=1,8)", "1,8", "1.8"),
    ],
)
def test_a_decimal_comma_of_a_netlist(cli, refusal, line, number, advice):
    """ngspice reads 1,5k as 1 Ohm, without a warning."""
    found = refusal(amplifier=AMPLIFIER.replace("R2", f"R4 n ref 1k\n{line}\nR2", 1))
    assert found["head"].endswith(f"the netlist has a comma in the number {number}")
    assert found["next"] == f"write {advice} in place of {number}"


@pytest.mark.parametrize(
    "line",
    ["V3 n ref PWL 0,0 1m,5", "V3 n ref PULSE(0,5 0 1n)", "E3 n ref POLY(1) (in,ref) 0 1",
     "B3 n ref V=max(1,5)", ".model DX D(IS=1e-14,N=2)"],
)  # fmt: skip
def test_commas_that_separate_numbers_are_accepted(cli, line):
    Path("own.toml").write_text(SCENE)
    Path("amp.lib").write_text(AMPLIFIER.replace("R2", f"R4 n ref 1k\n{line}\nR2", 1))
    kc.load_scene("own.toml")


@pytest.mark.parametrize(
    ("content", "head", "advice"),
    [
        (b"%PDF-1.7\n%\xe2\xe3", "a PDF document", "the SPICE model (.lib or .cir)"),
        (b"PK\x03\x04\x14", "an archive", "unpack the archive"),
        (b"Version 4\nSHEET 1 880 680\n", "a schematic of LTspice", "View > SPICE Netlist"),
        (b"<!DOCTYPE html>\n<html>", "a web page", "download the netlist file"),
        (AMPLIFIER.encode("utf-16"), "not encoded in UTF-8", "with the encoding UTF-8"),
    ],
)
def test_a_file_of_another_program_as_netlist(refusal, content, head, advice):
    found = refusal(amplifier=content)
    assert "own.toml, line 7, key amp.file" in found["head"]
    assert head in found["head"]
    assert advice in found["next"]


def test_a_missing_netlist_of_a_part(cli, refusal):
    found = refusal(SCENE.replace("amp.lib", "ampl.lib"))
    assert found["got"] == "'ampl.lib'"
    name = re.fullmatch(r"did you mean '(.*)'\?", found["next"])[1]
    kc.load_scene(write_scene(SCENE.replace("amp.lib", name)))
    found = refusal(SCENE.replace("amp.lib", "opa2134.mod"))
    assert found["next"] == f"copy opa2134.mod into the folder {Path.cwd()}"


def write_scene(text):
    Path("right.toml").write_text(text)
    return "right.toml"


@pytest.mark.parametrize(
    ("line", "advice"),
    [
        (".paramm a=1", "did you mean '.param'?"),
        (".backanno", "delete this line"),
        (".step param R 1 2 1", "delete this line, and vary the value by kc2spice sweep"),
        (".lib other.lib", "write  .include other.lib"),
    ],
)
def test_a_misspelt_or_foreign_command_does_not_advise_trust(refusal, line, advice):
    found = refusal(amplifier=f"{AMPLIFIER}{line}\n")
    assert advice in found["next"]
    assert "--trust" not in found["next"]


def test_a_misspelt_analysis_of_a_deck(cli):
    cli("export", "duffing", "--out", "d")
    deck = Path("d/duffing.cir")
    deck.write_text(deck.read_text().replace("\n.tran ", "\n.trn "))
    found = rows_of_error(cli("run", "duffing", "--deck", "d/duffing.cir").stderr)
    assert found["next"] == "did you mean '.tran'?"


@pytest.mark.parametrize(
    ("rows", "head", "advice"),
    [
        ('[0, 0, "1 ms", 5]', "not pairs of time and value", 'write  pwl = [[0, 0], ["1 ms", 5]]'),
        ('["0 s", "0 V", "1 ms", "5 V"]', "not pairs of time and value",
         'write  pwl = [["0 s", "0 V"], ["1 ms", "5 V"]]'),
        ('"0 0 1m 5"', "not a list", 'write for example  pwl = [[0, 0], ["1 ms", 1]]'),
    ],
)  # fmt: skip
def test_corners_that_are_not_pairs(refusal, rows, head, advice):
    found = refusal(CHARGED.replace('[[0, 0], ["1 ms", 5]]', rows))
    assert head in found["head"]
    assert found["next"] == advice
    corners = advice[advice.index("[") :]
    kc.load_scene(write_scene(CHARGED.replace('[[0, 0], ["1 ms", 5]]', corners)))


def test_a_corner_of_three_numbers(refusal):
    found = refusal(CHARGED.replace("[0, 0]", "[0, 0, 7]"))
    assert found["next"] == "write  [0, 0]  in place of  [0, 0, 7]"


@pytest.mark.parametrize(
    ("poling", "advice"),
    [
        ("[0, 1]", "write  pzt = [0, 1, 0]"),
        ("[0, 0, 1, 0]", "write for example  pzt = [0, 0, 1]"),
        ('"z"', "write  pzt = [0, 0, 1]"),
        ('"-z"', "write  pzt = [0, 0, -1]"),
        ('"radia"', "did you mean 'radial'?"),
        ("{ direction = [0, 1] }", "write  direction = [0, 1, 0]"),
    ],
)
def test_a_poling_that_is_no_vector(poling, advice):
    body = {"part": "body", "mesh": "u.msh", "unit": "mm", "materials": {"pzt": "PZT-5A"}}
    table = parse_toml(f"poling = {{ pzt = {poling} }}")
    with pytest.raises(kc.errors.UsageError) as caught:
        kc.load_scene({"u": body | table})
    assert caught.value.hint == advice


@pytest.mark.parametrize(
    ("output", "advice"),
    [("dsc.voltage", "did you mean 'disc.voltage'?"), ("load.x", 'write  output = "load.v"')],
)
def test_an_unknown_output_of_a_noise_analysis_precedes_the_models(output, advice, monkeypatch):
    scene = kc.load_scene("buzzer_noise", [f"analysis.output={output}"])
    monkeypatch.setattr(type(scene.get_part("disc").type), "build", lambda *_: pytest.fail("built"))
    with pytest.raises(kc.errors.UsageError) as caught:
        build_models(scene, StageTimer())
    assert caught.value.hint == advice


@pytest.mark.parametrize(
    ("value", "advice"), [("100 MF", '"100 uF"'), ("3e6", "micro, not mega"), ("2e5", "100 kF")]
)
def test_an_implausible_capacitance(refusal, value, advice):
    value = value if value[-1].isdigit() else f'"{value}"'
    found = refusal(CHARGED.replace('"1 uF"', value))
    assert "than plausible: the largest capacitors" in found["head"]
    assert advice in found["next"]


def test_a_density_in_another_unit():
    """Waves have the speed sqrt(c11 / density): 17.5 km/s in diamond, 124 km/s here."""
    ceramic = {"youngs_modulus": "60 GPa", "poisson_ratio": 0.3}
    for density in (7.75, 7.75e6):
        with pytest.raises(kc.errors.UsageError) as caught:
            find_material(ceramic | {"density": density})
        advised = re.match(r'write  density = "(.*)"  if', caught.value.hint)[1]
        assert find_material(ceramic | {"density": advised}).density == 7750
    diamond = {"youngs_modulus": "1143 GPa", "poisson_ratio": 0.07, "density": 3515}
    assert find_material(diamond).density == 3515


def test_a_source_of_small_signals_without_an_analysis(cli):
    Path("own.toml").write_text(CHARGED.partition("[analysis]")[0].replace("pwl", "ac = 1 # "))
    done = cli("run", "own.toml")
    assert "s: the key `ac` has no effect" in done.stderr
    assert 'type = "ac"  and  stop = "100 kHz"' in done.stderr
    advised = ("--set", "analysis.type=ac", "--set", "analysis.stop=100 kHz")
    assert "has no effect" not in cli("run", "own.toml", *advised).stderr


def test_keys_that_only_a_transient_uses_warn_in_other_analyses(tmp_path):
    """Time steps exist, and ratings are compared with voltages, only in a transient."""
    (tmp_path / "mine.lib").write_text(".subckt mine in\nR1 in 0 1k\n.ends\n")
    parts = {
        "s": {"part": "source", "ac": 1.0, "pins": {"out": "mine.in"}},
        "mine": {
            "part": "netlist", "file": str(tmp_path / "mine.lib"), "subckt": "mine",
            "ratings": {"in": {"high": 0.5}},
        },
        "solver": {"max_step": 1e-6, "stop": 1e-3, "reltol": 1e-5},
    }  # fmt: skip
    small_signal = {"type": "ac", "start": 1e3, "stop": 1e4}
    for analysis, wanted in ((small_signal, 3), ({"type": "transient", "stop": 1e-3}, 0)):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            kc.load_scene(parts | {"analysis": analysis})
        texts = {str(each.message) for each in caught}
        unused = [text for text in texts if "has no effect in the ac analysis" in text]
        assert len(unused) == wanted
        named = re.findall("the key `(.*?)`", " ".join(unused))
        assert sorted(named) == ["ratings", "solver.max_step", "solver.stop"][:wanted]


@pytest.mark.parametrize(
    ("scene", "overrides", "head", "advice"),
    [
        ("kick_and_catch", ["control.kp=0", "control.ki=0", "control.kd=0"], "all gains",
         'write for example  kp = "100 A/m"'),
        ("kick_and_catch", ["kick.mounting=free"], "mounting of the chip is free",
         'write  mounting = "glued"'),
        ("kick_and_catch", ["kick.mounting=glue"], "does not exist", "did you mean 'glued'?"),
        ("kick_and_catch", ["kick.material=steel"], "not a ceramic", 'write  material = "PZT-5A"'),
        ("kick_and_catch", ["contact.a=control"], "no surface for a contact", 'write  a = "kick"'),
        ("kick_and_catch", ["kick.drive.start=10 ms"], "the kick starts after",
         "lower drive.start below 0.005 s"),
        ("kick_and_catch", ["kick.mesh.ring_spacing=2 mm"], "does not fit on the chip",
         "lower mesh.ring_spacing to 0.00027 m"),
        ("impact", ['kick.fields=["1 ms"]'], "outside the simulated time range",
         "write a time from 0 to"),
        ("buzzer_noise", ["analysis.stop=20 kh"], "unknown unit", 'write  "20 kHz"'),
        ("buzzer_noise", ["disc.rom.parameters={thickness=[1,2]}"], "no numeric key",
         "did you mean 'layers[0].thickness'?"),
        ("duffing", ["probes.x.of=mass.x", "probes.x.at=46 khz"], "not a time or frequency",
         'write  "46 kHz"'),
    ],
)  # fmt: skip
def test_keys_of_scenes_with_one_action(scene, overrides, head, advice):
    with pytest.raises(kc.errors.UsageError, match=head) as caught:
        kc.load_scene(scene, overrides)
    assert advice in caught.value.hint


@pytest.mark.parametrize(
    ("table", "hint", "correction"),
    [
        ({"density": 8500}, 'add  youngs_modulus = "100 GPa"  and  poisson_ratio = 0.3',
         {"youngs_modulus": "100 GPa", "poisson_ratio": 0.3}),
        ({"density": 8500, "youngs_modulus": "100 GPa"}, "add  poisson_ratio = 0.3",
         {"poisson_ratio": 0.3}),
        ({"density": 8500, "youngs_modulus": "100 Gpa", "poisson_ratio": 0.3},
         'write  "100 GPa"', {"youngs_modulus": "100 GPa"}),
        ({"density": 8500, "youngs_modulus": 100, "poisson_ratio": 0.3},
         'write  youngs_modulus = "100 GPa"', {"youngs_modulus": "100 GPa"}),
        ({"like": "bras"}, "did you mean 'brass'?", {"like": "brass"}),
        ({"like": "PZT-5A", "stress_coupling": {"e31": 1.0}, "strain_coupling": {"d31": 1.0}},
         "delete the key `strain_coupling`, because both contain the same constants", None),
    ],
)  # fmt: skip
def test_a_table_of_a_material(table, hint, correction):
    with pytest.raises(kc.errors.UsageError) as caught:
        find_material(table)
    assert caught.value.hint == hint
    if correction is not None:
        assert find_material(table | correction).density > 0


def test_components_of_a_tensor_that_are_missing():
    """Six independent stiffnesses of a hexagonal crystal, one of which follows from two others."""
    table = {"density": 7750, "symmetry": "6mm", "stiffness": {"c11": "121 GPa", "c12": "75 GPa"}}
    with pytest.raises(kc.errors.UsageError) as caught:
        find_material(table)
    assert caught.value.hint == "add c13, c33, c44"
    table["stiffness"] |= {"c13": "75 GPa", "c33": "111 GPa", "c44": "21 GPa"}
    assert find_material(table).C[5, 5] == pytest.approx((121e9 - 75e9) / 2)


@pytest.mark.parametrize(
    ("line", "advice"),
    [
        ("R3 out", "write  R3 NODE1 NODE2 VALUE"),
        ("B1 out ref", "write  B1 NODE1 NODE2 V=EXPRESSION"),
        (".model DX", "write for example  .model DX D(IS=1e-14)"),
        (".param gain", "write gain=VALUE"),
        ("X1", "write  X1 NODE1 NODE2 SUBCIRCUIT"),
    ],
)
def test_an_incomplete_card(cli, refusal, line, advice):
    found = refusal(amplifier=AMPLIFIER.replace("R2", f"{line}\nR2", 1))
    assert found["next"] == advice


@pytest.mark.parametrize(
    ("values", "advice"),
    [
        ("mass.mass=1 g,1 g", "write mass.mass=1 g"),
        ("mass.mass=normal(1 g,-0.1 g,5)", "write 0.1 g in place of -0.1 g"),
        ("mass.mass=uniform(2 g,1 g,5)", "write uniform(1 g,2 g,5)"),
    ],
)
def test_values_of_a_sweep(cli, values, advice):
    done = cli("sweep", "duffing", "--set", values)
    assert done.exit_code == 2
    assert rows_of_error(done.stderr)["next"] == advice


@pytest.mark.parametrize(
    ("line", "otherwise", "advice"),
    [
        ('part = "resistor"', 'part = "R"', 'write  part = "resistor"'),
        ('{ a = "battery.out" }', '{ p = "battery.out" }', "write a in place of p"),
        ('dc = "10 V"', 'pulse = { v1 = 0, high = 5, width = "1 ms" }', "write low in place of v1"),
        ("[battery]", "temperature = 27\n[battery]", "delete the key `temperature`"),
    ],
)
def test_words_of_spice_in_a_scene(cli, line, otherwise, advice):
    Path("own.toml").write_text(RESISTOR.replace(line, otherwise))
    found = rows_of_error(cli("run", "own.toml").stderr)
    assert found["next"].startswith(advice)
    write_scene(RESISTOR.replace(line, otherwise))
    for wrong, right in (('"R"', '"resistor"'), ("{ p =", "{ a ="), ("v1", "low"),
                         ("temperature = 27\n", "")):  # fmt: skip
        write_scene(Path("right.toml").read_text().replace(wrong, right))
    kc.load_scene("right.toml")


@pytest.mark.parametrize(
    ("name", "text", "head", "advice"),
    [
        ("own.json", '{"battery": {"part": "source"}}', "this file is JSON", "[NAME]"),
        ("own.yaml", "battery:\n  part: source\n", "this file is YAML", "[NAME]"),
        ("amp.cir", "* t\nV1 a 0 1\n.op\n.end\n", "a SPICE netlist", 'file = "amp.cir"'),
        ("plot.py", "import kc2spice\n", "a Python program", "python plot.py"),
    ],
)
def test_a_file_of_another_format_as_scene(cli, name, text, head, advice):
    Path(name).write_text(text)
    found = rows_of_error(cli("run", name).stderr)
    assert head in found["head"]
    assert advice in found["next"]


@pytest.mark.parametrize(
    ("words", "advice"),
    [
        (("export", "duffing", "--format", "ltspice"), "write --dialect in place of --format"),
        (("run", "duffing", "--output", "d"), "write --out in place of --output"),
        (("sweep", "duffing", "--set", "mass.mass=1 g..2 g"), "write 1 g:2 g:5"),
        (("reduce", "m.npz", "--band", "0-20k"), "write --band 0 20000"),
        (("reduce", "duffing"), "kc2spice export duffing writes the netlists of all parts"),
        (("reduce", "buzzer_noise"), "kc2spice reduce buzzer_noise:disc"),
    ],
)
def test_words_of_other_programs_on_the_command_line(cli, words, advice):
    done = cli(*words)
    assert done.exit_code == 2
    assert rows_of_error(done.stderr)["next"] == advice
    if advice.startswith("write --") and "in place" in advice:
        right, wrong = advice.split()[1], advice.split()[-1]
        assert cli(*(right if word == wrong else word for word in words)).exit_code == 0


def test_a_measurement_without_rows(cli):
    Path("m.csv").write_text("frequency_hz,re_ohm,im_ohm\n1,2,3\n")
    found = rows_of_error(cli("reduce", "m.csv").stderr)
    assert found["next"].startswith("export one row of numbers for each point")


HEATED = """[s]
part = "source"
kind = "heat_flow"
dc = "1 W"
pins = { out = "r.a" }
[r]
part = "thermal_resistor"
resistance = "20 K/W"
[analysis]
type = "op"
"""


@pytest.mark.parametrize(
    ("right", "wrong", "advice"),
    [
        ('"20 K/W"', '"20 °C/W"', 'write  "20 K/W"'),
        ('kind = "heat_flow"', 'kind = "power"', 'write  kind = "heat_flow"'),
        ('kind = "heat_flow"\n', "", 'write  kind = "heat_flow"  in [s], with values in its unit'),
        ('kind = "heat_flow"\ndc = "1 W"', 'kind = "temperature"\ndc = "85 °C"',
         "write the difference from the ambient temperature in K"),
    ],
)  # fmt: skip
def test_heat_in_other_words(cli, right, wrong, advice):
    assert HEATED.count(right) == 1
    Path("own.toml").write_text(HEATED.replace(right, wrong).replace('"1 W"', "1"))
    assert rows_of_error(cli("run", "own.toml").stderr)["next"].startswith(advice)
    kc.load_scene(write_scene(HEATED))


def test_a_band_with_one_end():
    with pytest.raises(kc.errors.UsageError) as caught:
        kc.load_scene("buzzer_noise", ["disc.rom.band=10 kHz"])
    assert caught.value.hint == 'write  band = [0, "10 kHz"]'
    kc.load_scene("buzzer_noise", ['disc.rom.band=[0, "10 kHz"]'])


def test_a_longer_form_of_a_name():
    assert did_you_mean("topelectrode", ["topel", "root"]) == "did you mean 'topel'?"
    assert did_you_mean("rooster", ["top", "roo"]) is None
    types = ["piezo_stack", "disc", "spring", "cubic_spring", "linear_drive", "gap"]
    for word, meant in (
        ("piezo_disc", "disc"),
        ("PiezoDisc", "disc"),
        ("linear_spring", "spring"),
        ("cubick_spring", "cubic_spring"),  # a typing error in a longer name
        ("air-gap", "gap"),
        ("piezo_stak", "piezo_stack"),
    ):
        assert did_you_mean(word, types) == f"did you mean '{meant}'?"
    assert did_you_mean("layer_thickness", ["layers", "thickness"]) == "did you mean 'thickness'?"


@pytest.mark.parametrize(
    ("line", "head", "advice"),
    [
        ("R3 in out 1 k", "a blank between a number and its unit", "write 1k in place of 1 k"),
        ('.include "C:/lib/opamp.lib"', "an absolute path",
         "copy the file into the folder of amp.lib, and write  .include opamp.lib"),
        ("$CDNENCSTART", "this netlist is encrypted", "ask the manufacturer"),
        ("** LTspice Encrypted File", "this netlist is encrypted", "ask the manufacturer"),
    ],
)  # fmt: skip
def test_lines_of_models_of_manufacturers(refusal, line, head, advice):
    found = refusal(amplifier=AMPLIFIER.replace("R1", f"{line}\nR1", 1))
    assert head in found["head"]
    assert found["next"].startswith(advice)


def test_a_resistor_with_a_model_is_accepted(cli):
    Path("own.toml").write_text(SCENE)
    Path("amp.lib").write_text(
        AMPLIFIER.replace("R2", ".model rm R(TC1=1e-3)\nR3 in out 1k rm\nR2")
    )
    kc.load_scene("own.toml")


def test_a_directory_as_netlist(refusal):
    Path("models").mkdir()
    Path("models/amp.lib").write_text(AMPLIFIER)
    found = refusal(SCENE.replace("amp.lib", "models"))
    assert "own.toml, line 7, key amp.file: this path is a directory" in found["head"]
    assert '"amp.lib"' in found["next"]


@pytest.mark.parametrize("values", ["1 g:2 g:3", "1 g,2 g"])
def test_several_values_of_a_run(cli, values):
    done = cli("run", "duffing", "--set", f"mass.mass={values}")
    assert rows_of_error(done.stderr)["next"].startswith('write one value, such as  "1 g"')
    swept = ("--set", f"mass.mass={values}", "--workers", "1")
    assert cli("sweep", "duffing", *swept).exit_code == 0


def test_a_deck_that_is_missing_or_of_another_scene(cli):
    found = rows_of_error(cli("run", "duffing", "--deck", "no.cir").stderr)
    assert found["next"] == "kc2spice export duffing  writes a deck of this scene to edit"
    Path("d.cir").write_text("* t\nV1 a 0 1\n.tran 1u 1m\n.end\n")
    found = rows_of_error(cli("run", "duffing", "--deck", "d.cir").stderr)
    assert found["next"] == "edit a copy of the deck that  kc2spice export duffing  writes"


def test_a_missing_model_file_has_a_similar_name(cli):
    Path("beam.npz").write_bytes(b"")
    found = rows_of_error(cli("reduce", "baem.npz").stderr)
    assert found["next"] == "did you mean 'beam.npz'?"
    assert rows_of_error(cli("reduce", "z.csv").stderr)["next"] == "copy z.csv into this folder"


BEAM = """[b]
part = "bimorph"
length = "20 mm"
width = "4 mm"
layers = [{ material = "PZT-5A", thickness = "1 mm" }, { material = "steel", thickness = "1 mm" }]
[s]
part = "source"
ac = "1 V"
pins = { out = "b.anode" }
[analysis]
type = "ac"
stop = "1 kHz"
"""
LAYERS = BEAM.splitlines()[4]


@pytest.mark.parametrize(
    ("right", "wrong", "advice"),
    [
        (LAYERS, 'layers = ["PZT-5A", "steel"]',
         'write  { material = "PZT-5A", thickness = "100 um" }  as entry 1 of layers'),
        (LAYERS, LAYERS.replace("[", "{\n").replace("]", "\n}"),
         "write  layers = [  in line 5, and  ]  in place of the last }"),
        ('width = "4 mm"', "width =", "write a value after width ="),
        ('width = "4 mm"', 'width = "4 mm"\nmesh = { refine = 1.6 }', "write  refine = 2"),
        ('type = "ac"', 'type = "modal"', 'write  type = "ac"'),
        ("[analysis]", '[probes.x]\nof = "b.current"\nat = "1 MHz"\n[analysis]',
         "write for example  at = 1000"),
    ],
)  # fmt: skip
def test_lists_values_and_choices_of_a_beam(cli, right, wrong, advice):
    assert BEAM.count(right) == 1
    Path("own.toml").write_text(BEAM.replace(right, wrong))
    assert rows_of_error(cli("run", "own.toml").stderr)["next"] == advice


def test_contradictory_values_name_the_value_to_delete():
    """1/qts = 1/qes + 1/qms: 0.9 would need a negative qms, 4 gives qts = 0.3636."""
    speaker = {"part": "loudspeaker", "re": "6 Ohm", "fs": "40 Hz", "qes": 0.4, "qms": 4,
               "vas": "40 l", "sd": "200 cm2", "pins": {"plus": "s.out"}}  # fmt: skip
    scene = {"s": {"part": "source", "ac": "1 V"}, "analysis": {"type": "ac", "stop": "1 kHz"}}
    with pytest.raises(kc.errors.UsageError) as caught:
        kc.load_scene(scene | {"m": speaker | {"qts": 0.9}})
    assert caught.value.hint == "delete qts, which follows from the other values"
    kc.load_scene(scene | {"m": speaker})


def test_a_command_of_another_program(cli):
    found = rows_of_error(cli("simulate", "duffing").stderr)
    assert found["next"] == "write kc2spice run in place of kc2spice simulate"


def test_litres_in_words():
    with pytest.raises(kc.errors.UsageError) as caught:
        kc.load_scene("loudspeaker_vented", ["box.volume=40 liter"])
    assert caught.value.hint == 'write  "40 l"'


@pytest.mark.parametrize(
    ("typed", "unit", "advice"),
    [
        ("1 KOhm", "Ohm", "1 kOhm"),
        ("1 micro F", "F", "1 uF"),
        ("1 MHZ", "Hz", "1 MHz"),
        ("1 milli H", "H", "1 mH"),
        ("25 MG", "kg", "25 mg"),
        ("25 KG", "kg", "25 kg"),
    ],
)
def test_prefixes_in_words_and_in_another_letter_case(typed, unit, advice):
    assert fails(convert_quantity, typed, unit).hint == f'write  "{advice}"'
    convert_quantity(advice, unit)


@pytest.mark.parametrize(
    ("data", "advice"),
    [
        ("0,0,1\n1,1,1\n", "delete all columns except time and value"),
        ("RIFF1234WAVE", "export the waveform as a CSV file"),
        ("0;0\n1;1\n", "separate the numbers by a comma"),
    ],
)
def test_a_waveform_file_of_another_form(refusal, data, advice):
    Path("wave.csv").write_text(data)
    found = refusal(CHARGED.replace('pwl = [[0, 0], ["1 ms", 5]]', 'file = "wave.csv"'))
    assert found["next"].startswith(advice)


PLATES = (
    DISC
    + """electrodes = "12.8 mm"
[drive]
part = "source"
ac = "1 V"
pins = { out = "disc.anode" }
[analysis]
type = "ac"
start = "1 kHz"
stop = "14 kHz"
"""
)
DAMPED_PLATES = PLATES + "points = 20\n[disc.damping]\nquality = 50\n"
UNRESOLVED = "disc: 1 GHz, limit 3.88 MHz"


def test_a_band_beyond_the_mesh_gives_the_same_warning_in_reduce_and_run(cli):
    Path("own.toml").write_text(DAMPED_PLATES)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert kc.run("own.toml").checks
        reduce_file("own.toml:disc", Path("narrow"))
    assert not [item for item in caught if "limit 3.88 MHz" in str(item.message)]
    with pytest.warns(UserWarning, match=re.escape(UNRESOLVED)):
        reduce_file("own.toml:disc", Path("wide"), band=(0.0, 1e9))
    Path("own.toml").write_text(DAMPED_PLATES.replace("14 kHz", "1 GHz"))
    with pytest.warns(UserWarning, match=re.escape(UNRESOLVED)):
        kc.run("own.toml")


def test_the_frequency_limit_of_a_mesh_follows_from_the_diagonal_of_a_cell():
    """At the limit, shear waves are as long as the diagonal of a cell of 3, 4 and 12 mm: 13 mm."""
    mesh = MeshHex.init_tensor(*(np.linspace(0, 2 * side, 3) for side in (3e-3, 4e-3, 12e-3)))
    steel = find_material({"density": 7850, "youngs_modulus": 210e9, "poisson_ratio": 0.3})
    solid = Solid(mesh, (steel,), np.zeros(mesh.nelements, dtype=int))
    speed = np.sqrt(210e9 / (2 * 1.3) / 7850)
    assert find_mesh_frequency_limit(solid) == pytest.approx(speed / 13e-3)


@pytest.mark.parametrize(
    ("damping", "advice", "right"),
    [
        ("ratio = 5, at = 1e4", "write ratio = 0.01", "ratio = 0.01, at = 1e4"),
        ("ratio = 1, at = 1e4", "write ratio = 0.01", "ratio = 0, at = 1e4"),
        ("loss_factor = 2", "write loss_factor = 0.02", "loss_factor = 0.02"),
    ],
)
def test_overcritical_damping_of_matrices_is_refused_as_in_a_scene(
    tmp_path, damping, advice, right
):
    np.savez(tmp_path / "m.npz", M=np.eye(2), K=[[2e4, -1e4], [-1e4, 1e4]], B=[[0.0], [1.0]])
    port = '[[ports]]\nname = "tip"\nkind = "mechanical"\ncolumn = 1\n'
    (tmp_path / "m.toml").write_text(f"damping = {{ {damping} }}\n{port}")
    with pytest.raises(kc.errors.UsageError, match="overcritical") as caught:
        kc.read_model(tmp_path / "m.npz")
    assert advice in caught.value.hint
    (tmp_path / "m.toml").write_text(f"damping = {{ {right} }}\n{port}")
    assert kc.read_model(tmp_path / "m.npz").order == 2


def test_an_overcritical_loss_factor_of_a_body_is_refused(cli):
    Path("own.toml").write_text(DAMPED_PLATES.replace("quality = 50", "loss_factor = 2"))
    with pytest.raises(kc.errors.UsageError, match="overcritical"):
        kc.build("own.toml")
    Path("own.toml").write_text(DAMPED_PLATES.replace("quality = 50", "loss_factor = 1.9"))
    assert "disc" in kc.build("own.toml")


CHAIN = {"M": np.eye(3), "K": 1e4 * (2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)),
         "B": np.eye(3)[:, :1]}  # fmt: skip


@pytest.mark.parametrize(
    ("wrong", "message", "hint"),
    [
        ({"K": -CHAIN["K"]}, "a stiffness is negative", "change the sign of K"),
        ({"M": -CHAIN["M"]}, "a mass is negative", "change the sign of M"),
        ({"B": 0 * CHAIN["B"]}, "no input acts on the model", "export the matrix B again"),
        ({"C": np.zeros((1, 3))}, "no output depends on the model", "export the matrix C again"),
        ({"K": 0 * CHAIN["K"]}, "matrix K is zero", "export the matrix K again"),
    ],
)
def test_a_wrong_matrix_is_named_with_an_action(tmp_path, wrong, message, hint):
    np.savez(tmp_path / "m.npz", **CHAIN | wrong)
    with pytest.raises(kc.errors.UsageError, match=message) as caught:
        reduce_file(tmp_path / "m.npz", tmp_path / "out")
    assert caught.value.hint == hint
    np.savez(tmp_path / "m.npz", **CHAIN)
    assert reduce_file(tmp_path / "m.npz", tmp_path / "out")["stable"]


@pytest.mark.parametrize(
    ("option", "typed", "hint"),
    [
        ("--solver", "mumps", "leave out --solver, so that the built-in solvers are used"),
        ("--network", "ring", "leave out --network, so that the form is foster"),
        ("--network", "caur", "did you mean 'cauer'?"),
    ],
)
def test_an_unknown_choice_of_an_option_of_reduce_advises_the_default(cli, option, typed, hint):
    np.savez("m.npz", **CHAIN)
    found = rows_of_error(cli("reduce", "m.npz", option, typed).stderr)
    assert found["got"] == repr(typed)
    assert found["next"] == hint
    assert cli("reduce", "m.npz", "-q").exit_code == 0


def test_indefinite_equations_of_a_body_are_an_error_of_the_program():
    matrix = np.diag([1.0, -1.0])
    with pytest.raises(kc.errors.SimulationError, match="cannot be factorised") as caught:
        solve_definite(matrix, np.ones(2))
    assert "check the units of the materials" in caught.value.hint


SPRING = """[spring]
part = "spring"
stiffness = "1 kN/m"
pins = { a = "mass.a" }
[mass]
part = "mass"
mass = "25 mg"
[push]
part = "source"
kind = "force"
pulse = { high = "10 mN", width = "1 ms", edge = "10 us" }
pins = { out = "mass.a" }
[analysis]
type = "transient"
stop = "3 ms"
"""


def test_a_file_name_with_blanks_needs_quotes(cli):
    Path("my scene.toml").write_text(SPRING)
    found = rows_of_error(cli("run", "my", "scene.toml").stderr)
    assert found["next"] == "put quotes around the name of the file: 'my scene.toml'"
    assert cli("run", "my scene.toml", "-o", "out").exit_code == 0
    found = rows_of_error(cli("run", "your", "scene.toml").stderr)
    assert found["next"] == "delete scene.toml"


@pytest.mark.parametrize(
    "text",
    [
        "frequency_hz,real_ohm,imag_ohm\n1e3,1,-10\n2e3,1,-5\n",
        "# HZ S RI R 50\n1 0.5 0.5\n2 .5 1\n",
    ],
)
def test_a_run_of_measured_values_advises_a_reduction(cli, text):
    Path("good.csv").write_text(text)
    output = cli("run", "good.csv").stderr
    assert "this file is a table of numbers, not a scene" in output
    assert rows_of_error(output)["next"].startswith("kc2spice reduce good.csv")


@pytest.mark.parametrize(
    ("typed", "unit", "advice"),
    [
        ("10 mV", "N", "10 mN"),
        ("3 kOhm", "Hz", "3 kHz"),
        ("25 mN", "kg", "25 mg"),
        ("5 V", "N", "5 N"),
    ],
)
def test_the_advice_about_a_wrong_unit_keeps_the_prefix(typed, unit, advice):
    condition = f"if the value is in {advice.split()[1]}"
    assert fails(convert_quantity, typed, unit).hint == f'write  "{advice}"  {condition}'
    convert_quantity(advice, unit)


def test_the_voltage_of_a_disc_is_a_key_of_its_source(refusal):
    wrong = PLATES.replace('part = "disc"', 'part = "disc"\nvoltage = "5 V"')
    advice = refusal(wrong)["next"]
    assert advice.startswith("delete voltage: rated_voltage is only a limit")
    assert 'part = "source"' in advice


def test_the_voltage_of_a_stack_is_a_key_of_its_drive():
    with pytest.raises(kc.errors.UsageError) as caught:
        kc.load_scene("impact", ["kick.voltage=50"])
    assert caught.value.hint == "did you mean 'drive.voltage'?"
    with pytest.warns(UserWarning, match="`drive` has no effect") as found:
        kc.load_scene("impact", ["kick.drive.voltage=50"])
    assert str(found[0].message).endswith('write  kick.electrical = "driven"')
    driven = ["kick.drive.voltage=50", "kick.drive.start=0", "kick.electrical=driven"]
    source = kc.load_scene("impact", driven).get_part("kick_drive")
    assert source.keys.waveform(10e-6) == 50


def test_a_drive_without_effect_does_not_change_the_results():
    """The drive of an open stack begins after the end of the run, and does not matter."""
    with pytest.warns(UserWarning, match="`drive` has no effect"):
        changed = kc.run("impact", overrides={"kick.drive.voltage": 50})
    usual = kc.run("impact").metrics["min_position_m"]
    assert changed.metrics["min_position_m"] == pytest.approx(usual, rel=1e-6)


def test_whole_numbers_with_an_exponent_are_accepted_within_their_limit(cli):
    Path("my.toml").write_text(PLATES)
    assert kc.load_scene("my.toml", ["analysis.points=1e2"]).analysis.points == 100
    found = rows_of_error(cli("run", "my.toml", "--set", "analysis.points=1e9").stderr)
    assert found["next"] == "lower analysis.points to 200000"
    kc.load_scene("my.toml", ["analysis.points=200000"])
    found = rows_of_error(cli("run", "my.toml", "--set", "analysis.points=2.5").stderr)
    assert found["next"] == "write  points = 2"


def test_an_ac_analysis_without_amplitude_advises_an_existing_source(refusal):
    found = refusal(PLATES.replace('ac = "1 V"', 'dc = "1 V"'))
    assert found["next"] == 'write  ac = "1 V"  in [drive]'
    kc.load_scene(parse_toml(PLATES.replace('ac = "1 V"', 'dc = "1 V"\nac = "1 V"')))


def test_an_error_about_a_stated_order_advises_to_delete_it(cli):
    Path("my.toml").write_text(PLATES)
    found = cli("run", "my.toml", "--set", "disc.rom.order=1")
    assert found.exit_code == 5
    assert "the reduced model of order 1 is too inaccurate" in found.stderr
    assert rows_of_error(found.stderr)["next"].startswith("delete disc.rom.order, so that")
    assert cli("run", "my.toml", "-o", "out").exit_code == 0


@pytest.mark.slow
def test_an_error_about_short_steps_advises_an_earlier_end_and_no_longer_step(cli):
    """At 1e12 N/m, a mass of 25 mg has 95 000 undamped cycles in 3 ms: too many to follow."""
    Path("my.toml").write_text(SPRING)
    stiff = ("run", "my.toml", "--set", "spring.stiffness=1e12", "--set", "solver.retries=0")
    found = rows_of_error(cli(*stiff).stderr)
    assert "max_step" not in found["next"]
    reason = "reason for the short time steps: natural mode at 31.83 MHz"
    assert f"choose an earlier end time; {reason}" in found["next"]
    assert cli(*stiff, "--set", "analysis.stop=10 us").exit_code == 0


@pytest.mark.parametrize(
    ("right", "wrong", "advice"),
    [
        ('"1 kN/m"', "1,5", "write  stiffness = 1.5"),
        ('"1 kN/m"', "1,5 kN/m", 'write  stiffness = "1.5 kN/m"'),
        ('width = "1 ms"', "width = 0,001",
         'write  pulse = { high = "10 mN", width = 0.001, edge = "10 us" }'),
        ("[mass]", "[mass 1]", "write  [mass_1]"),
    ],
)  # fmt: skip
def test_errors_about_commas_and_blanks_in_toml_advise_a_valid_line(refusal, right, wrong, advice):
    typed = SPRING.replace(right, wrong)
    assert refusal(typed)["next"] == advice
    line = next(row for row in typed.splitlines() if wrong in row)
    corrected = typed.replace(line, advice.removeprefix("write  "))
    if "_1" in advice:
        corrected = corrected.replace("mass.a", "mass_1.a")
    kc.load_scene(parse_toml(corrected))


def test_a_disc_without_ceramic_is_named_before_its_electrodes(refusal):
    found = refusal(PLATES.replace("PZT-5A", "brass"))
    assert found["next"] == 'write  material = "PZT-5A"  in one of the layers'


def test_an_error_about_a_misspelt_mesh_file_names_the_similar_file(cli):
    Path("bar.msh").write_text("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n")
    Path("my.toml").write_text(
        '[bar]\npart = "body"\nmesh = "bra.msh"\nunit = "mm"\nmaterials = { s = "steel" }\n'
        'ports = [{ name = "tip", at = [0, 0, 0], axis = "z" }]\n'
    )
    output = cli("run", "my.toml").stderr
    assert "my.toml, line 3, key bar.mesh: this file does not exist" in output
    assert rows_of_error(output)["next"] == "did you mean 'bar.msh'?"


def test_an_override_that_contradicts_a_data_sheet_has_a_consistent_value_as_advice(cli):
    """With qes = 2 pi fs mms re / bl^2 and qms = 5.6, qts is 0.2237."""
    error = fails(kc.load_scene, SPEAKER, {"woofer.qts": 0.9})
    assert error.message.startswith("qts contradicts ")
    assert "e+" not in error.expected
    advice = re.fullmatch(r"write qts = ([\d.]+), or delete qts", error.hint)
    qes = 2 * math.pi * 37 * 109.5e-3 * 6 / 25.6**2
    assert float(advice[1]) == pytest.approx(5.6 * qes / (5.6 + qes), rel=1e-3)
    kc.load_scene(SPEAKER, {"woofer.qts": float(advice[1])})


@pytest.mark.parametrize("scene", ["duffing", "own.toml", "gone.toml"])
def test_an_exported_deck_as_scene(cli, scene):
    """The advised command runs the deck; a library of a part is still a netlist."""
    if scene != "duffing":
        Path(scene).write_text(list_gallery()["duffing"].read_text())
    assert cli("export", scene, "--out", "d").exit_code == 0
    name = scene.removesuffix(".toml")
    Path("gone.toml").unlink(missing_ok=True)
    found = rows_of_error(cli("run", f"d/{name}.cir").stderr)
    assert f"the exported deck of the scene {name}" in found["head"]
    advised = f"kc2spice run {'SCENE' if name == 'gone' else scene} --deck d/{name}.cir"
    assert found["next"].startswith(f"{advised}  runs")
    if name == "gone":
        assert found["next"].endswith("SCENE is the TOML file of the scene gone")
    else:
        assert cli(*advised.split()[1:]).exit_code == 0
    assert "a SPICE netlist" in cli("run", "d/mass.lib").stderr
