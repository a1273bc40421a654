"""Mistakes on the command line, in scenes, files and Python calls, with the advice for each."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from messages import fails, rows
from small_scenes import DISC, DIVIDER, LAMP, RESISTOR
from support import Check, did_you_mean, format_summary, parse_toml, require_passed

import kc2spice as kc

BUZZER = DISC + '[analysis]\ntype = "ac"\nstop = "10 kHz"\n'
MESH = Path(__file__).parents[1] / "data" / "coarse_unimorph.msh"
HEAT = """gravity = 0
[m]
part = "heat_body"
layers = [{ material = "silicon", thickness = "0.3 mm", area = "25 mm2" }]
sources = { j = "top" }
films = [{ group = "bottom", coefficient = "1 kW/(m2 K)" }]
pins = { j = "l.out" }
[l]
part = "source"
kind = "heat_flow"
dc = "20 W"
[analysis]
type = "op"
[probes]
r_k = { of = "m.temperature.j", take = "max" }
"""
BAR = """[bar]
part = "body"
mesh = "u.msh"
unit = "mm"
materials = { steel = "steel", pzt = "steel" }
fixed = ["root"]
ports = [{ name = "tip", group = "topel", axis = "z" }]
[push]
part = "source"
kind = "force"
ac = "1 N"
pins = { out = "bar.tip" }
[analysis]
type = "ac"
stop = "1 kHz"
"""


@pytest.mark.parametrize(
    ("words", "head", "got", "advice"),
    [
        ("run", "run: the argument SCENE is missing", "kc2spice run", "kc2spice run buzzer"),
        ("fit impact", "fit: the argument DATA is missing", "kc2spice fit impact", "DATA.csv"),
        ("rum", "this command does not exist", "'rum'", "did you mean 'run'?"),
        ("impact", "this command does not exist", "'impact'", "kc2spice run impact"),
        ("--nope", "this option does not exist", "--nope", "kc2spice --help"),
        ("run impact --verbos", "run: this option does not exist", "--verbos",
         "did you mean '--verbose'?"),
        ("run impact --nope=3", "run: this option does not exist", "--nope", "kc2spice run --help"),
        ("run impact --deck", "--deck: the value is missing", "--deck", "write FILE after --deck"),
        ("reduce x.K --band 1", "--band: this option needs 2 values", "--band 1",
         "write F0 F1 after --band"),
        ("run impact --json=yes", "--json: this option takes no", "--json=yes", "write --json"),
        ("run impact more", "run: the command line has one argument too many", "more",
         "delete more"),
        ("run impact a.b=3", "run: the command line has one argument too many", "a.b=3",
         "write --set a.b=3"),
        ("run impact --set a.b=3 A", "one argument too many", "A", "--set 'a.b=3 A'"),
        ("export", "export: a SCENE or --rom FILE is missing", "neither SCENE",
         "kc2spice export impact"),
        ("export impact --rom r.npz", "--rom cannot be combined with SCENE", "--rom r.npz",
         "kc2spice export --rom r.npz"),
        ("verify", "verify: the command needs either a SCENE or --all", "neither",
         "kc2spice verify impact"),
        ("scenes --keys --parts", "--keys cannot be combined with --parts", "--keys", "then"),
        ("fit impact x.csv", "the name of the part is missing", "impact", "impact:PART"),
        ("fit impact:sphere {table} --vary radius", "this part has no impedance", "sphere",
         "kc2spice explain"),
        ("fit buzzer_7bb_20_6:disc {table}", "the option --vary is missing", "",
         "add for example  --vary damping.quality=10:200"),
        ("fit buzzer_7bb_20_6:disc {table} --vary damping.qualty",
         "disc has no numeric key of this name",
         "damping.qualty", "did you mean 'damping.quality'?"),
        ("sweep impact", "sweep: the option --set is missing", "no --set",
         "--set KEY=FIRST:LAST:POINTS"),
        ("sweep impact --set impact.velocity=normal(-1,0.1)", "normal needs three values",
         "normal(-1,0.1)", "write normal(-1,0.1,50)"),
        ("sweep impact --set impact.velocity=normal(-1,0.1,5,6)", "normal needs three values",
         "normal(-1,0.1,5,6)", "write normal(-1,0.1,50)"),
        ("run harvester --set beam.fields=maybe", "not true or false", "'maybe'",
         "write  fields = true"),
        ("sweep impact --set impact.velocity=-1:-0.2:x", "not a number of points", "'x'",
         "write -1:-0.2:5"),
        ("sweep impact --set impact.velocity=-1:-0.2:5:6", "a range needs a first value",
         "-1:-0.2:5:6", "write -1:-0.2:5"),
        ("run impact --set sphere", "the value of the key is missing", "'sphere'",
         "write 'sphere.radius=1 mm'"),
        ("run impact --set sphere.radius=", "the value of the key is missing", "'sphere.radius='",
         "write 'sphere.radius=1 mm'"),
        ("run buzzer_7bb_20_6 --set disc.laiers[0].thickness=1mm", "disc.laiers is not a list", "",
         "did you mean 'layers'?"),
        ("run buzzer_7bb_20_6 --set disc.layers[9].thickness=1mm", "the list has no such entry",
         "disc.layers[9]", "disc.layers[1] for the last"),
        ("run buzzer_7bb_20_6 --set disc.layers.thickness=1mm", "disc.layers is a list", "",
         "disc.layers[0].thickness"),
        ("run impact --set sphere.radius=1micron", "unknown unit 'micron'", "'1micron'",
         'write  "1 um"'),
        ("run impact --set sphere.material=rubby", "this material does not exist", "'rubby'",
         "did you mean 'ruby'?"),
        ("run kick_and_catch --set control.setpoint=3", "outside of the force table", "height 3 m",
         'setpoint = "2.5 mm"'),
        ("parts Murrata", "no part matches", "'Murrata'", "did you mean 'Murata'?"),
        ("reduce harvester:load", "this part has no linear model", "resistor",
         "kc2spice reduce harvester:beam"),
        ("export impact --tolerance 5", "--tolerance: out of range", "5", "lower --tolerance"),
        ("export impact --count 0", "--count: the number of copies is not valid", "0",
         "--count 2"),
        ("run impact --set sphere.mas", "the value of the key is missing", "'sphere.mas'",
         "write sphere.radius=VALUE"),
        ("run buzzer_7bb_20_6 --set disc", "the value of the key is missing", "'disc'",
         "write disc.number=7BB-20-6"),
        ("run buzzer_7bb_20_6 --set disc.layers", "the value of the key is missing",
         "'disc.layers'", "write 'disc.layers[0].material=brass'"),
        ("run impact --set impact.velocity=fast", "not a quantity", "'fast'", '"1 m/s"'),
        ("run impact --set impact.velocity=1m", "wrong unit 'm'", "'1m'", '"1 m/s"'),
        ("run impact --set sphere.mass=1", "unknown key", "", "delete mass"),
        ("run buzzer_7bb_20_6 --set analysis.stop=20kHzz", "unknown unit 'kHzz'", "'20kHzz'",
         'write  "20 kHz"'),
        ("run buzzer_7bb_20_6 --set disc.support=glued", "not one of the choices", "'glued'",
         'support = "free"'),
        ("run buzzer_7bb_20_6 --set disc.damping.ratio=0.1", "stated twice, by ratio and quality",
         "", "damping={"),
        ("reduce NAME --method foo", "--method: this reduction method does not exist", "'foo'",
         "leave out --method"),
        ("reduce {table} --order x", "--order: this value is not a number", "x", "a whole number"),
        ("export --rom b.toml", "b.toml: this file does not exist", "", "kc2spice reduce MODEL"),
        ("run impact --set =3", "the key is missing", "'=3'", "write KEY=3"),
        ("run impact --deck no.cir", "no.cir: this file does not exist", "",
         "kc2spice export"),
        ("run impact --deck .", ".: this path is a directory", "", "kc2spice export"),
        ("reduce ..", "..: this path is a directory", "", "a file in this directory"),
        ("parts murata buzzer", "one argument too many", "buzzer",
         "write kc2spice parts 'murata buzzer'"),
        ("reduce {table} --band 5e5 0", "does not apply to a measured response", "500000 0",
         "leave out --band"),
        ("bench impact --error 1%", "this value is not a number", "1%", "write --error 0.01"),
        ("run kick_and_catch --set disc.layers=3", "this scene has no part 'disc'", "",
         "write kick.layers"),
        ("run impact.toml", "this file does not exist", "", "write impact for the built-in scene"),
        ("run impact --set sphere.radius:1mm", "the value of the key is missing",
         "'sphere.radius:1mm'", "write sphere.radius=1mm"),
    ],
)  # fmt: skip
def test_a_mistake_on_the_command_line(cli, tmp_path, words, head, got, advice):
    f = np.linspace(1e3, 1e5, 200)
    table = tmp_path / "z.csv"
    np.savetxt(table, np.column_stack([f, 0 * f + 1, -1e7 / f]), delimiter=",",
               header="frequency_hz,real_ohm,imag_ohm", comments="")  # fmt: skip
    parts = words.split()
    done = cli(*(str(table) if part == "{table}" else part for part in parts))
    found = rows(done.stderr)
    assert done.exit_code == 2
    assert head in found["head"]
    assert got in found.get("got", "")
    assert advice in found["next"]
    assert "Usage:" not in done.stderr


def test_a_sweep_into_a_file_advises_another_path(cli):
    done = cli("sweep", "impact", "--set", "impact.velocity=-1:-0.5:3", "--out", "/dev/null/x")
    assert done.exit_code == 2
    assert "this path cannot be written" in done.stderr
    assert "choose another --out" in done.stderr


@pytest.mark.parametrize(
    ("line", "otherwise", "place", "head", "advice"),
    [
        ('resistance = "1 kOhm"', 'resistance = "1k"', 6, "unknown unit 'k'", 'write  "1 kOhm"'),
        ('resistance = "1 kOhm"', 'resistance = "1,5 kOhm"', 6, "a comma", 'write  "1.5 kOhm"'),
        ('resistance = "1 kOhm"', 'resistance = "5"', 6, "needs a unit", 'write  "5 Ohm"  or'),
        ('type = "op"', 'type = "OP"', 9, "not one of the choices", "did you mean 'op'?"),
        ('a = "battery.out"', 'a = "battery"', 7, "pin does not exist", "battery.out"),
        ('a = "battery.out"', 'x = "battery.out"', 7, "resistor has no such pin", "one of these"),
        ("[load]", "[lo-ad]", 4, "name of a part is not valid", "such as [lo_ad]"),
        ('type = "op"', 'type = "ac"', 8, "the key `analysis.stop` of", 'stop = "100 kHz"'),
        ('type = "op"', 'type = "dc"', 8, "the key `analysis.sweep` of", 'sweep = "battery.dc"'),
        ('type = "op"', 'type = "noise"\nstop = "1 kHz"', 8, "the key `analysis.output` of",
         "add  output"),
        ('of = "load.i"', 'of = "load"', 11, "no such result", "did you mean 'load."),
        ('of = "load.i"', 'of = "load.curent"', 11, "no such result", "'load.current'"),
        ('of = "load.i"', 'of = "load.i"\ntake = "crossing"', 10, "level is missing", "add  level"),
        ('of = "load.i"', 'of = "load.i"\nat = "1 V"\ntake = "max"', 10, "at has no effect",
         "delete take"),
        ('pins = { a = "battery.out" }', 'pins = "battery.out"', 7, "not a table", "pins = {"),
        ('dc = "10 V"', 'file = "no.csv"', 3, "this file does not exist", "copy the file to"),
        ('dc = "10 V"', "pwl = [[0, 0], [0, 1]]", 3, "from row 1 to row 2", "sort the rows"),
        ('dc = "10 V"', 'sine = { amplitude = "1 V" }', 3, "sine.frequency is missing",
         'frequency = "1 Hz"'),
        ('type = "op"', 'type = "ac"\nstart = "20 kHz"\nstop = "10 kHz"', 11, "range is empty",
         'stop = "200 kHz"'),
        ('a = "battery.out"', 'a = "load.a"', 7, "joined to itself", 'a = "battery.out"'),
        ('pins = { a = "battery.out" }', 'pins = ["battery.out"]', 7, "not a table",
         'write  pins = { a = "battery.out" }'),
    ],
)  # fmt: skip
def test_a_mistake_in_a_scene(cli, line, otherwise, place, head, advice):
    assert DIVIDER.count(line) == 1
    Path("own.toml").write_text(DIVIDER.replace(line, otherwise))
    done = cli("run", "own.toml")
    found = rows(done.stderr)
    assert done.exit_code == 2
    assert f"own.toml, line {place}, key " in found["head"]
    assert head in found["head"]
    assert advice in found["next"]


@pytest.mark.parametrize(
    ("line", "otherwise", "place", "head", "advice"),
    [
        ('pins = { a = "battery.out" }', 'pins = { a = "battery.out"; b = "gnd" }', 7,
         "a comma separates keys", 'pins = { a = "battery.out", b = "gnd" }'),
        ('dc = "10 V"', "pwl = ([0, 0], [1, 1])", 3, "a list is between [ and ]",
         "pwl = [[0, 0], [1, 1]]"),
        ('dc = "10 V"', "dc = \u201c10 V\u201d", 3, "typographic quotes", 'dc = "10 V"'),
        ('dc = "10 V"', 'dc == "10 V"', 3, "'==' stands between key and value", 'dc = "10 V"'),
        ('dc = "10 V"', 'dc: "10 V"', 3, "':' stands between key and value", 'dc = "10 V"'),
        ('dc = "10 V"', 'dc = "10 V" // full', 3, "a comment begins with #", 'dc = "10 V" # full'),
        ('dc = "10 V"', 'dc = "10 V" ; full', 3, "a comment begins with #", 'dc = "10 V" # full'),
    ],
)  # fmt: skip
def test_a_mistake_in_the_syntax_of_a_scene(cli, line, otherwise, place, head, advice):
    Path("own.toml").write_text(DIVIDER.replace(line, otherwise))
    found = rows(cli("run", "own.toml").stderr)
    assert f"own.toml, line {place}: {head}" in found["head"]
    assert found["next"] == f"write  {advice}"


def test_a_scene_as_a_deck_and_a_misspelt_suffix(cli):
    Path("own.toml").write_text(DIVIDER)
    found = rows(cli("run", "own.toml", "--deck", "own.toml").stderr)
    assert "own.toml: this file is a TOML file, not a netlist" in found["head"]
    assert rows(cli("run", "own.tml").stderr)["next"] == "did you mean 'own.toml'?"


@pytest.mark.parametrize(
    ("line", "otherwise", "place", "advice"),
    [
        ('diameter = "14 mm"', 'radius = "7 mm"', 9, "use the key `diameter`"),
        ('material = "PZT-5A"', 'material = "PZT5A"', 8, "did you mean 'PZT-5A'?"),
        ('material = "PZT-5A"', 'material = "steel"', 1, 'material = "PZT-5A"'),
        ('thickness = "0.2 mm"\n[analysis]', 'thickness = "0.2 m"\n[analysis]', 10, '"200 um"'),
        ('thickness = "0.2 mm"\n[analysis]', "[analysis]", 7, 'thickness = "100 um"'),
    ],
)
def test_a_mistake_in_an_entry_of_a_list(cli, line, otherwise, place, advice):
    assert BUZZER.count(line) == 1
    Path("own.toml").write_text(BUZZER.replace(line, otherwise))
    done = cli("run", "own.toml")
    found = rows(done.stderr)
    assert done.exit_code == 2
    assert f"own.toml, line {place}, key disc.layers" in found["head"]
    assert found["expected"].count(",") <= 5
    assert advice in found["next"]


@pytest.mark.parametrize(
    ("text", "got", "advice"),
    [
        ("freq,a\n{}", "only one column of values", "the phase or the imaginary part"),
        ("frequency_hz,real_ohm,imag_ohm\n{}", "only one column of values", "a second column"),
        ("{}", "only one column of values", "the phase or the imaginary part"),
        ("frequency [Hz],|Z| [Ohm]\n{}", "only one half of a complex impedance", "column of phase"),
        ("", "the file is empty", "export the measurement again"),
        ("freq,a\n1,2\n", "below the first line 'freq,a'", "frequency_hz,real_ohm"),
    ],
)
def test_a_table_that_is_no_impedance(cli, text, got, advice):
    numbers = "\n".join(f"{k},1" for k in range(1, 50))
    Path("own.csv").write_text(text.format(numbers))
    found = rows(cli("reduce", "own.csv").stderr)
    assert got in found["head"]
    assert advice in found["next"]


@pytest.mark.parametrize(
    ("table", "head", "advice"),
    [
        ("", "this port has neither nodes nor a matrix column or row", "column = 1"),
        ('kind = "output"\ncolumn = 1', "the key `row`, not `column`", "row = 1"),
        ("node = 1", "this port has no direction", 'axis = "z"'),
        (
            'node = 1\ndof = "volts"',
            "this degree of freedom does not exist",
            "did you mean 'volt'?",
        ),
        ("column = 3", "there is no column 3", None),
    ],
)
def test_a_port_beside_matrices(cli, table, head, advice):
    np.savez("own.npz", M=np.eye(2), K=np.eye(2), B=np.ones((2, 1)))
    kind = "" if "kind" in table else 'kind = "mechanical"\n'
    Path("own.toml").write_text(f'[[ports]]\nname = "tip"\n{kind}{table}\n')
    found = rows(cli("reduce", "own.npz").stderr)
    assert head in found["head"]
    assert advice is None or advice in found["next"]


@pytest.mark.parametrize(
    ("call", "head", "advice"),
    [
        (lambda: kc.load_scene(3), "not a scene", 'kc.load_scene("impact")'),
        (lambda: kc.load_scene("impact", "a.b=3"), "overrides is a string", "['a.b=3']"),
        (lambda: kc.sweep("impact", {"impact.velocity": 3}), "are not a list", "[3]"),
        (lambda: kc.reduce(model()), "either a tolerance or an order", "tolerance=1e-4"),
        (lambda: kc.reduce(model(), tolerance=1, order=2), "either a tolerance",
         "leave out order"),
        (lambda: kc.LinearModel(M=np.eye(2), K=np.eye(2), B=np.ones(2)), "B has 1 dimensions",
         "np.reshape(B, (-1, 1))"),
        (lambda: kc.LinearModel(K=np.eye(2), B=np.ones((2, 1))), "lacks matrices", "M=MASS_MATRIX"),
        (lambda: kc.LinearModel(M=np.eye(3), K=np.eye(2), B=np.ones((2, 1))), "M has a wrong size",
         "from the same mesh"),
        (lambda: kc.LinearModel(M=np.eye(2), K=np.eye(2), B=np.ones((2, 1)), C=np.ones((2, 1))),
         "C has a wrong size", "transpose C"),
        (lambda: kc.LinearModel(M=np.eye(3), K=np.eye(3), B=np.ones((1, 3))), "B has a wrong size",
         "transpose B"),
        (lambda: model().transfer("1 kHz"), "the frequencies are not numbers", "1e3"),
        (lambda: kc.reduce(kc.LinearModel(M=-np.eye(2), K=np.eye(2), B=np.ones((2, 1))), order=1),
         "a mass is negative", "change the sign of M"),
        (lambda: kc.sweep("impact", {}), "no key has more than one value", "a list of values"),
        (lambda: kc.sweep("impact", ["a"]), "values: this object is not a mapping", "a mapping"),
        (lambda: kc.run("impact", overrides=["sphere.radius"]), "overrides: the value of the key",
         "sphere.radius=1 mm"),
        (lambda: kc.export("impact", "out", dialect="spice"), "dialect: this dialect", "ngspice"),
        (lambda: kc.reduce(model(), order=1.5), "not a positive whole number", "for example 1"),
        (lambda: kc.subcircuit(model(), "1 bad name"), "not a valid name", "n_1_bad_name"),
        (lambda: kc.load_scene({**LAMP, "probes": {"x": "lamp.i"}}), "not a table",
         'x = { of = "lamp.i" }'),
        (lambda: kc.load_scene({**LAMP, "analysis": "op"}), "not a table", "[analysis]"),
        (lambda: kc.load_scene({**LAMP, "drive": {"part": "source", "dc": [3]}}), "not a number",
         "dc = 1.0"),
        (lambda: kc.sweep("impact", {"impact.velcity": [1, 2]}), "values: 'impact.velcity=1'",
         "'velocity'"),
        (lambda: kc.sweep("impact", {"impact.velocity": [1, 2]}), "does not move towards",
         '"-1 m/s"'),
        (lambda: kc.run("impact", ["a.b=3"]), "out is not the path", "overrides="),
        (lambda: kc.export("impact", 5), "out is not the path", 'out="results"'),
        (lambda: kc.load_scene({"title": 3}), "not a text", 'title = "NAME"'),
        (lambda: kc.read_model(np.eye(2)), "not the path of a model", "kc.LinearModel"),
        (lambda: kc.AffineModel(3), "not a linear model", "kc.LinearModel"),
        (lambda: kc.reduce(model(), order=1, band=5), "not a frequency band", "band=(0, 20e3)"),
        (lambda: kc.reduce(model(), order=1, solver="foo"), "not a direct solver", "omit the arg"),
        (lambda: kc.reduce(model(), order=1, norm="max"), "norm does not exist", "one of these"),
        (lambda: kc.register_part(3), "not a part type", "own_part.md"),
        (lambda: kc.register_reductor(3), "not a reduction method", "own_reductor.md"),
    ],
)  # fmt: skip
def test_a_mistake_in_python(call, head, advice):
    with pytest.raises(kc.errors.UsageError) as caught:
        call()
    found = rows(str(caught.value))
    assert head in found["head"]
    assert advice in found["next"]
    assert "--" not in str(caught.value)


def model():
    return kc.LinearModel(M=np.eye(2), K=np.eye(2), B=np.ones((2, 1)))


def test_a_part_is_not_a_key(cli):
    done = cli("run", "duffing", "--set", "mass=3")
    found = rows(done.stderr)
    assert done.exit_code == 2
    assert found["head"].endswith("--set 'mass=3': mass is a part of this scene, not a key")
    assert "mass.mass" in found["expected"]
    assert found["next"].startswith("write 'mass.mass=")


def test_a_python_call_names_its_argument():
    with pytest.raises(kc.errors.UsageError) as caught:
        kc.load_scene("duffing", {"mass.mas": 1})
    assert str(caught.value).startswith("overrides 'mass.mas=1': unknown key")
    assert "did you mean 'mass'?" in str(caught.value)


def test_a_list_of_parts_becomes_tables_with_names():
    with pytest.raises(kc.errors.UsageError, match="unknown key") as caught:
        kc.load_scene({"name": "mine", "part": [{"type": "disc"}]})
    assert 'write a table for each part: [NAME] with part = "TYPE"' in str(caught.value)


def test_a_fit_of_a_rigid_part_fails_before_its_data_are_read(cli):
    done = cli("fit", "duffing:mass", "nodata.csv", "--vary", "mass")
    assert "this part has no impedance" in done.stderr
    assert "nodata.csv" not in done.stderr


def test_an_edited_deck_without_analysis_or_library(cli, tmp_path):
    deck = tmp_path / "deck.cir"
    deck.write_text("title\n.include gone.lib\n.end\n")
    done = cli("run", "impact", "--deck", str(deck))
    assert "gone.lib: No such file or directory" in done.stderr
    assert f"copy gone.lib to {tmp_path}" in done.stderr
    assert cli("export", "duffing", "--out", "d").exit_code == 0
    text = (tmp_path / "d" / "duffing.cir").read_text()
    deck.write_text("".join(x for x in text.splitlines(True) if not x.startswith(".tran")))
    (tmp_path / "d" / "deck.cir").write_text(deck.read_text())
    done = cli("run", "duffing", "--deck", "d/deck.cir")
    assert "this deck contains no analysis" in done.stderr


def test_an_unknown_method_has_five_candidates():
    chain = kc.LinearModel(M=np.eye(2), K=np.eye(2), B=np.ones((2, 1)))
    with pytest.raises(kc.errors.UsageError) as caught:
        kc.reduce(chain, tolerance=1e-3, band=(0, 1), method="response PD")
    found = rows(str(caught.value))
    assert found["expected"].count(",") == 5
    assert found["next"] == "did you mean 'response POD'?"


def test_a_failed_check_names_value_and_limit_with_prefixes():
    check = Check(
        "table_left",
        0.0316734,
        0.0,
        "m",
        "lower y_min",
        "fail",
        label="height outside the force table",
    )
    with pytest.raises(kc.errors.SimulationError) as caught:
        require_passed((check,), "kick_and_catch")
    assert "a check of the result failed: height outside the force table" in str(caught.value)
    assert "got:      31.7 mm" in str(caught.value)


@pytest.mark.parametrize(
    ("key", "value", "expected", "advice"),
    [
        ("rom.tolerance", "1e-13", ">= 1e-10", "raise rom.tolerance to 1e-10"),
        ("rom.tolerance", "2", "< 1", "lower rom.tolerance below 1"),
        ("disc.layers[1].diameter", "-1 mm", "> 0 m", "remove the minus sign"),
        ("solver.trtol", "0.5", ">= 1", "raise solver.trtol to 1"),
    ],
)
def test_a_value_out_of_range_names_the_key_and_a_value(cli, key, value, expected, advice):
    done = cli("run", "buzzer_7bb_20_6", "--set", f"{key}={value}")
    found = rows(done.stderr)
    assert done.exit_code == 2
    assert f"{key}={value}" in found["head"]
    assert found["expected"].startswith(expected)
    assert found["next"] == advice


@pytest.mark.parametrize("key", ["start", "stop"])
def test_an_empty_frequency_range_points_at_the_override(cli, key):
    value = {"start": "1e9", "stop": "1"}[key]
    done = cli("run", "buzzer_7bb_20_6", "--set", f"analysis.{key}={value}")
    assert done.exit_code == 2
    assert (
        f"--set 'analysis.{key}={value}': the frequency range is empty" in rows(done.stderr)["head"]
    )


def test_an_ac_analysis_of_springs_and_masses_names_a_source_to_add(cli):
    tables = '[mass]\npart = "mass"\nmass = "1 g"\n[spring]\npart = "spring"\n'
    tables += 'stiffness = "1 kN/m"\npins = { a = "mass.a" }\n'
    Path("own.toml").write_text(tables + '[analysis]\ntype = "ac"\nstop = "1 kHz"\n')
    found = rows(cli("run", "own.toml").stderr)
    assert "the ac analysis has no source" in found["head"]
    drive = '[drive]\npart = "source"\nkind = "force"\nac = "1 N"\npins = { out = "mass.a" }\n'
    assert found["next"] == (
        'add [drive] with part = "source", kind = "force", ac = "1 N" and pins = { out = "mass.a" }'
    )
    kc.load_scene({"name": "own", **parse_toml(Path("own.toml").read_text() + drive)})


def test_the_source_to_add_gets_an_unused_name():
    names = ("drive", "ac_drive", "drive_2")
    masses = {name: {"part": "mass", "mass": "1 g"} for name in names}
    with pytest.raises(kc.errors.UsageError, match="no source") as caught:
        kc.load_scene({"name": "own", **masses, "analysis": {"type": "ac", "stop": "1 kHz"}})
    assert 'add [drive_3] with part = "source"' in caught.value.hint


def test_an_export_of_matrices_names_the_reduction(cli):
    np.savez("own.npz", M=np.eye(2), K=np.eye(2), B=np.ones((2, 1)))
    found = rows(cli("export", "--rom", "own.npz").stderr)
    assert "own.npz: this file is not a reduced model" in found["head"]
    assert "kc2spice reduce own.npz" in found["next"]
    assert "the name of the scene is empty" in rows(cli("run", "").stderr)["head"]


def test_a_reduction_of_a_scene_file_names_the_part(cli):
    Path("own.toml").write_text(BUZZER)
    found = rows(cli("reduce", "own.toml").stderr)
    assert "own.toml: this file is a scene" in found["head"]
    assert "kc2spice reduce own.toml:disc" in found["next"]


def test_a_table_with_words_quotes_the_first_line_with_one(cli):
    Path("own.csv").write_text("frequency,real,imag\n1,2,3\n2,abc,4\n")
    found = rows(cli("reduce", "own.csv").stderr)
    assert "line 3, '2,abc,4': 'abc' is not a number" in found["head"]


def test_an_output_path_in_a_directory_without_files_is_named_as_typed(cli):
    Path("file").write_text("")
    found = rows(cli("run", "buzzer_7bb_20_6", "-o", "file/out").stderr)
    assert "file/out: this path cannot be written" in found["head"]
    assert "a file, not a directory" in found["got"]


@pytest.mark.parametrize("table", ["metrics", "waves", "units"])
def test_an_unknown_name_of_a_result_lists_similar_names(table):
    result = kc.run(LAMP)
    values = getattr(result, table)
    name = max(values, key=len)
    with pytest.raises(KeyError) as caught:
        values[f"{name}x"]
    assert isinstance(caught.value, kc.errors.UsageError)
    assert name in str(caught.value).split("expected:")[1]
    assert f"{name}x" not in values


def test_a_join_of_different_kinds_names_pins_that_fit(cli):
    Path("own.toml").write_text(
        DIVIDER
        + """[mass]
part = "mass"
mass = "1 g"
pins = { a = "battery.out" }
[spring]
part = "spring"
stiffness = "1 N/m"
"""
    )
    found = rows(cli("run", "own.toml").stderr)
    assert "joins pins of different kinds" in found["head"]
    assert found["expected"] == "gnd, or a pin of kind um/N: spring.a, spring.b"
    assert found["next"] == 'write  a = "spring.a"'


@pytest.mark.parametrize(
    ("name", "content", "head", "advice"),
    [
        ("own.s1p", "# MHz S RI R 50\n1 0.5 0.1\n2 O.5 0.1\n", "line 3 contains 'o.5'", "export"),
        ("own.npz", "text", "not an archive of numpy.savez", "export the file again"),
    ],
)
def test_a_damaged_file_of_data(cli, name, content, head, advice):
    Path(name).write_text(content)
    found = rows(cli("reduce", name).stderr)
    assert head in found["head"]
    assert advice in found["next"]


def test_a_failed_check_begins_with_its_cause():
    cause = "the sphere moved outside the height range of the force table"
    advice = f"{cause}: raise catch.y_max to 9 mm"
    check = Check(
        "table_left", 1e-3, 0.0, "m", advice, "fail", label="height outside the force table"
    )
    with pytest.raises(kc.errors.SimulationError) as caught:
        require_passed((check,), "kick_and_catch")
    found = rows(str(caught.value))
    assert found["head"] == f"kick_and_catch: {cause} (check: height outside the force table)"
    assert found["next"] == "raise catch.y_max to 9 mm"


def test_an_empty_scene_and_a_deck_without_cards(cli):
    Path("own.toml").write_text("")
    found = rows(cli("run", "own.toml").stderr)
    assert found["head"] == "kc2spice: error: own.toml: the scene has no parts"
    Path("own.cir").write_text("hello\n")
    found = rows(cli("run", "impact", "--deck", "own.cir").stderr)
    assert found["next"] == "edit a copy of the deck that kc2spice export writes"


def test_a_body_without_electrodes_and_ports(cli):
    Path("own.toml").write_text(
        '[b]\npart = "body"\nmesh = "b.msh"\nmaterials = { all = "steel" }\n'
    )
    found = rows(cli("run", "own.toml").stderr)
    assert "a body needs electrodes or ports" in found["head"]
    assert "ports = [{" in found["next"]


@pytest.mark.parametrize(
    ("name", "scene", "line", "key", "wrong", "right"),
    [
        ("heat", HEAT, 5, "m.sources.j", 'j = "tip"', 'j = "top"'),
        ("heat", HEAT, 6, "m.films[0].group", 'group = "under"', 'group = "bottom"'),
        ("bar", BAR, 7, "bar.ports[0]", 'group = "tips"', 'group = "topel"'),
        ("bar", BAR, 6, "bar.fixed", '"roots"', '"root"'),
    ],
)
def test_an_unknown_group_is_located_in_the_scene(cli, name, scene, line, key, wrong, right):
    Path("u.msh").write_text(MESH.read_text())
    assert scene.count(right) == 1
    Path(f"{name}.toml").write_text(scene.replace(right, wrong))
    found = rows(cli("run", f"{name}.toml").stderr)
    assert f" {name}.toml, line {line}, key {key}: the " in found["head"]
    assert "no such group" in found["head"]
    part = key.partition(".")[0]
    for call in (kc.build, kc.run):
        with pytest.raises(kc.errors.UsageError) as caught:
            call(f"{name}.toml")
        assert caught.value.where == f"{name}.toml, line {line}, key {key}"
    tables = {"name": name, **parse_toml(scene.replace(right, wrong))}
    if name == "heat":
        with pytest.raises(kc.errors.UsageError) as caught:
            kc.build(tables)
        assert caught.value.where == f"scene, key {key}"
    Path(f"{name}.toml").write_text(scene)
    assert part in kc.build(f"{name}.toml")


def test_an_error_about_the_resistance_of_the_last_layer_names_its_key(cli):
    Path("heat.toml").write_text(HEAT.replace('area = "25 mm2"', 'area = "25 mm2", resistance = 1'))
    assert "m.layers[0].resistance" in rows(cli("run", "heat.toml").stderr)["head"]


@pytest.mark.parametrize(
    ("typed", "advice"),
    [
        ("0", "for example --error 0.0001"),
        ("x", "for example --error 0.0001"),
        ("2", "for 2 %, write --error 0.02"),
    ],
)
def test_the_example_of_an_option_is_its_default_or_the_typed_percentage(cli, typed, advice):
    assert rows(cli("bench", "impact", "--error", typed).stderr)["next"] == advice


def test_the_directory_of_another_sweep_is_described_without_hashes(cli):
    Path("own.toml").write_text(DIVIDER)
    key = "load.resistance="
    assert cli("sweep", "own.toml", "--set", f"{key}1,2", "-o", "out", "-q").exit_code == 0
    found = rows(cli("sweep", "own.toml", "--set", f"{key}1,2,3", "-o", "out", "-q").stderr)
    assert "the results of another sweep" in found["head"]
    assert found["got"] == "results of another scene, or of other keys, values or options"
    assert found["expected"].startswith("a new directory")
    assert cli("sweep", "own.toml", "--set", f"{key}1,2", "-o", "out", "-q").exit_code == 0


def test_a_probe_window_without_extent_is_rejected_and_the_advice_works(cli, tmp_path):
    """A window at the end of the run has a single sample, whose peak-to-peak value would be 0."""
    Path("rc.toml").write_text(
        '[drive]\npart = "source"\nsine = { amplitude = "1 V", frequency = "10 kHz" }\n'
        'pins = { out = "load.a" }\n[load]\npart = "resistor"\nresistance = "1 kOhm"\n'
        '[probes]\nswing = { of = "load.v", take = "peak_to_peak", from = "5 ms" }\n'
        '[analysis]\ntype = "transient"\nstop = "2 ms"\n'
    )
    late = cli("run", "rc.toml")
    assert late.exit_code == 2
    assert "next:     write for example  from = 0.001" in late.stderr
    empty = cli("run", "rc.toml", "--set", "probes.swing.from=0.002")
    assert empty.exit_code == 2
    assert "the window of this probe ends where it begins" in empty.stderr
    done = cli("run", "rc.toml", "--set", "probes.swing.from=0.001", "--json")
    assert json.loads(done.stdout)["metrics"]["swing"] == pytest.approx(2.0, rel=2e-3)


def test_a_port_at_a_column_of_a_missing_matrix_is_an_error(cli):
    K = np.diag([2.0, 2.0, 1.0]) - np.diag([1.0, 1.0], 1) - np.diag([1.0, 1.0], -1)
    np.savez("bar.npz", K=1e6 * K, M=np.eye(3))
    Path("bar.toml").write_text('[[ports]]\nname = "tip"\nkind = "mechanical"\ncolumn = 1\n')
    told = cli("reduce", "bar.npz")
    assert told.exit_code == 2
    assert "a port with the key `column` needs the matrix B" in told.stderr
    assert "matrices K, M" in told.stderr


def test_a_check_without_a_finite_value_is_printed():
    """The record of a run contains null for an infinite error, as after a failed refinement."""
    check = {"name": "error of x", "value": None, "limit": 0.01, "unit": "of the metric",
             "passed": False, "action": "fail"}  # fmt: skip
    text = format_summary({"checks": [check], "metrics": {}})
    assert "inf" in str(text)


def test_the_advised_transient_card_has_an_end(cli):
    transient = 'type = "transient"\nstop = "2 ms"'
    scene = parse_toml(RESISTOR.replace('type = "op"', transient))
    deck = kc.deck(scene)
    text = deck.files[deck.main_file_name]
    card = next(line for line in text.splitlines() if line.startswith(".tran"))
    path = Path(deck.main_file_name)
    path.write_text(text.replace(card, ".tran 1u"))
    with pytest.raises(kc.errors.UsageError, match="is missing or not a number") as caught:
        kc.run(scene, deck=path)
    advised = caught.value.hint.rpartition("  ")[2]
    path.write_text(text.replace(card, advised))
    assert kc.run(scene, deck=path).metrics is not None


def test_colons_between_key_and_value_of_an_inline_table_are_replaced(cli):
    """Only colons between key and value are replaced, not the colon of a text."""
    text = BUZZER.replace("[analysis]", "[disc.damping]\nX\n[analysis]")
    line = 'pair = { first: "a:b", second : 50 }'
    Path("own.toml").write_text(text.replace("X", line))
    told = cli("explain", "own.toml").stderr
    assert "':' stands between key and value" in told
    assert 'pair = { first = "a:b", second = 50 }' in told


@pytest.mark.parametrize("folder", ["", "sub"])
def test_a_misspelled_scene_file_proposes_the_name_of_the_file(cli, folder):
    name = str(Path(folder) / "lamp.toml")
    Path(name).parent.mkdir(exist_ok=True)
    Path(name).write_text(DIVIDER)
    found = rows(cli("run", str(Path(folder) / "my_lamp.toml")).stderr)
    assert found["next"] == f"did you mean {name!r}?"
    assert cli("run", name).exit_code == 0


@pytest.mark.parametrize(
    ("typed", "proposed"),
    [
        ("1:2:5", "-1:-2:5"),
        ("log:1 m/s:2 m/s:3", "log:-1 m/s:-2 m/s:3"),
        ("1,2", "-1,-2"),
    ],
)
def test_a_positive_range_of_a_negative_key_proposes_the_negated_range(cli, typed, proposed):
    done = cli("sweep", "impact", "--dry-run", "--set", f"impact.velocity={typed}")
    advice = shlex.split(rows(done.stderr)["next"])
    assert advice == ["write", "--set", f"impact.velocity={proposed}"]
    assert cli("sweep", "impact", "--dry-run", *advice[1:]).exit_code == 0


def test_a_missing_model_file_proposes_only_files_that_reduce_reads(cli):
    Path("beam.lib").write_text("")
    assert "beam.lib" not in rows(cli("reduce", "beams.K").stderr)["next"]
    Path("beam.csv").write_text("")
    assert rows(cli("reduce", "beams.cvs").stderr)["next"] == "did you mean 'beam.csv'?"


def test_unclosed_brackets_of_a_list_of_tables(cli):
    np.savez("chain.npz", M=np.eye(2), K=[[2.0, -1.0], [-1.0, 2.0]], B=[[1.0], [0.0]])
    text = '[[ports\nname = "tip"\nkind = "mechanical"\ncolumn = 1\n'
    Path("chain.toml").write_text(text)
    found = rows(cli("reduce", "chain.npz").stderr)
    assert found["next"] == "write  [[ports]]"
    Path("chain.toml").write_text(text.replace("[[ports", "[[ports]]"))
    assert cli("reduce", "chain.npz").exit_code == 0


def test_a_length_unit_without_nodes_proposes_to_delete_the_key(cli):
    np.savez("chain.npz", M=np.eye(2), K=[[2.0, -1.0], [-1.0, 2.0]], B=[[1.0], [0.0]])
    port = 'ports = [{ name = "tip", kind = "mechanical", column = 1 }]\n'
    Path("chain.toml").write_text(f'length = "mm"\n{port}')
    found = rows(cli("reduce", "chain.npz").stderr)
    assert "column" not in found["next"]
    assert "delete length" in found["next"]
    Path("chain.toml").write_text(port)
    assert cli("reduce", "chain.npz").exit_code == 0


TETRAHEDRON = """$MeshFormat
2.2 0 8
$EndMeshFormat
{}$Nodes
4
1 0 0 0
2 1 0 0
3 0 1 0
4 0 0 1
$EndNodes
$Elements
1
1 4 2 TAG 1 1 2 3 4
$EndElements
"""


@pytest.mark.parametrize(
    ("groups", "head", "command"),
    [
        ("", "the mesh has no groups", 'addPhysicalGroup(3, [1], name="bar")'),
        ('$PhysicalNames\n1\n3 1 "bar"\n$EndPhysicalNames\n', "the mesh has no groups of faces",
         'addPhysicalGroup(2, [1], name="top")'),
    ],
)  # fmt: skip
def test_a_mesh_without_a_suitable_group_proposes_a_group_of_this_dimension(
    cli, groups, head, command
):
    Path("bar.msh").write_text(TETRAHEDRON.format(groups).replace("TAG", str(int(bool(groups)))))
    Path("bar.toml").write_text(
        '[bar]\npart = "body"\nmesh = "bar.msh"\nunit = "mm"\nmaterials = { bar = "PZT-5A" }\n'
        'poling = { bar = [0, 0, 1] }\nelectrodes = { anode = "top", cathode = "bottom" }\n'
        'pins = { anode = "drive.out" }\n[drive]\npart = "source"\nac = "1 V"\n'
        '[analysis]\ntype = "ac"\nstop = "1 kHz"\n'
    )
    found = rows(cli("run", "bar.toml").stderr)
    assert found["head"].endswith(head)
    assert found["next"].endswith(command)


def test_a_volume_is_not_proposed_as_the_group_of_a_port(cli):
    """A force on the whole volume is possible, but it is not the force on a missing face."""
    groups = '$PhysicalNames\n1\n3 1 "bar"\n$EndPhysicalNames\n'
    Path("bar.msh").write_text(TETRAHEDRON.format(groups).replace("TAG", "1"))
    Path("bar.toml").write_text(
        '[bar]\npart = "body"\nmesh = "bar.msh"\nunit = "mm"\n'
        'materials = { bar = { youngs_modulus = "70 GPa", poisson_ratio = 0.3, density = 2700 } }\n'
        'fixed = ["bar"]\nports = [{ name = "tip", group = "tip", axis = "z" }]\n'
        'pins = { tip = "push.out" }\n[push]\npart = "source"\nkind = "force"\nac = "1 N"\n'
        '[analysis]\ntype = "ac"\nstop = "1 kHz"\n'
    )
    found = rows(cli("run", "bar.toml").stderr)
    assert found["head"].endswith("the mesh has no groups of faces")
    assert found["next"].endswith(
        'of its surfaces in place of 1: gmsh.model.addPhysicalGroup(2, [1], name="tip")'
    )


def test_a_data_file_as_override_is_not_a_key(cli):
    Path("meas.csv").write_text("1,2\n")
    found = rows(cli("run", "impact", "--set", "meas.csv").stderr)
    assert "not a TOML file of keys" in found["head"]
    assert "meas.csv=" not in found["next"]


def test_result_files_as_input_propose_no_action_that_fails(cli):
    assert cli("run", "impact", "--out", "out").exit_code == 0
    found = rows(cli("run", "out/result.json").stderr)
    assert "the results of a run" in found["head"]
    assert "the scene impact in place" in found["next"]
    for name in ("waveforms.npz", "result.json"):
        found = rows(cli("export", "--rom", f"out/{name}").stderr)
        assert found["next"] == "run kc2spice reduce MODEL, which writes NAME_rom/NAME_rom.npz"
        assert "without the record of a reduced model" in found["got"]


def test_a_symbol_of_a_result_proposes_a_result_of_the_same_part():
    names = ["disc.voltage", "drive.v", "disc.current", "drive.i"]
    for word, meant in {"disc.v": "disc.voltage", "disc.i": "disc.current"}.items():
        assert did_you_mean(word, names) == f"did you mean {meant!r}?"


def test_a_ragged_stiffness_matrix_is_an_error():
    error = fails(kc.LinearModel, M=np.eye(2), K=[[1, 2], [3]], B=np.ones((2, 1)))
    assert error.message == "the rows of matrix K differ in length"
