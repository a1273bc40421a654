"""Mistakes in netlists, lists and magnitudes whose advice is followed: the input then runs."""

import re
import warnings
from pathlib import Path

import pytest
from support import (
    StageTimer,
    build_models,
    convert_quantity,
    did_you_mean,
    find_material,
    parse_toml,
)

import kc2spice as kc

AMPLIFIER = "* amp\n.subckt amp in out ref\nR1 in out 1k\nR2 out ref 1k\n.ends\n"
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


def rows_of_error(text):
    """First line of a message, and the rows below it by their names."""
    text = text[text.index("kc2spice: error") :]
    head, *below = text.splitlines()
    pairs = (line.strip().partition(":") for line in below)
    return {"head": head} | {name: value.strip() for name, _, value in pairs}


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
        (b"PK\x03\x04\x14", "an archive", "unpack it"),
        (b"Version 4\nSHEET 1 880 680\n", "a schematic of LTspice", "View > SPICE Netlist"),
        (b"<!DOCTYPE html>\n<html>", "a web page", "download the netlist itself"),
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
        ('[0, 0, "1 ms", 5]', "not lists of two", 'write  pwl = [[0, 0], ["1 ms", 5]]'),
        ('["0 s", "0 V", "1 ms", "5 V"]', "not lists of two",
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
        ("impact", ['kick.fields=["1 ms"]'], "outside of the run", "write a time from 0 to"),
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
         "delete strain_coupling, because both contain the same constants", None),
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


RESISTOR = """[battery]
part = "source"
dc = "10 V"
[load]
part = "resistor"
resistance = "1 kOhm"
pins = { a = "battery.out" }
[analysis]
type = "op"
"""


@pytest.mark.parametrize(
    ("line", "otherwise", "advice"),
    [
        ('part = "resistor"', 'part = "R"', 'write  part = "resistor"'),
        ('{ a = "battery.out" }', '{ p = "battery.out" }', "write a in place of p"),
        ('dc = "10 V"', 'pulse = { v1 = 0, high = 5, width = "1 ms" }', "write low in place of v1"),
        ("[battery]", "temperature = 27\n[battery]", "delete temperature"),
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
    assert found["next"].startswith("export one line of numbers for each point")


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


@pytest.mark.parametrize(
    ("line", "head", "advice"),
    [
        ("R3 in out 1 k", "a blank between a number and its unit", "write 1k in place of 1 k"),
        ('.include "C:/lib/opamp.lib"', "an absolute path",
         "copy the file beside amp.lib, and write  .include opamp.lib"),
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
        ('width = "4 mm"', "width =", "write a value behind width ="),
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
    ],
)
def test_prefixes_in_words_and_in_another_letter_case(typed, unit, advice):
    with pytest.raises(kc.errors.UsageError) as caught:
        convert_quantity(typed, unit)
    assert caught.value.hint == f'write  "{advice}"'
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
