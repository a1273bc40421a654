"""Mistakes on the command line, in scenes, files and Python calls, with the advice for each."""

import ast
import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from messages import fails, rows
from small_scenes import DISC, DIVIDER, LAMP, RESISTOR
from support import (
    CAD,
    FILE_FORMATS,
    MESH_FORMAT,
    SURFACE,
    SURFACE_SUFFIXES,
    Check,
    did_you_mean,
    format_summary,
    identify_format,
    parse_toml,
    require_passed,
)

import kc2spice as kc

BUZZER_DISC, VARIED = "buzzer_7bb_20_6:disc", "--vary damping.quality=10:200"
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
        ("export impact --tolerance 5", "--tolerance: out of range", "5", "--tolerance 0.05"),
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
        ("run impact --set sphere.mass=1", "unknown key", "", "leave out --set 'sphere.mass=1'"),
        ("run buzzer_7bb_20_6 --set analysis.stop=20kHzz", "unknown unit 'kHzz'", "'20kHzz'",
         'write  "20 kHz"'),
        ("run buzzer_7bb_20_6 --set disc.support=glued", "not one of the choices", "'glued'",
         'support = "free"'),
        ("run buzzer_7bb_20_6 --set disc.damping={ratio=0.1,quality=5}",
         "stated twice, by ratio and quality", "", "delete the key `ratio`"),
        ("run impact --set rom={order=30,tolerance=1e-5}", "order and tolerance are both set", "",
         "delete the key `order`"),
        ("run impact --set over.tml", "this file does not exist", "",
         "write KEY=VALUE in place of over.tml"),
        ("run buzzer_7bb_20_6 --set disc.damping.quality=50%", "a Q factor has no unit %", "'50%'",
         "write  50"),
        ("reduce NAME --method foo", "--method: this reduction method does not exist", "'foo'",
         "leave out --method; for your own method, install its package as in docs/how-to/own_red"),
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
        ("run buzzer_square --set damping.quality=20", "this scene has no part 'damping'", "",
         "write disc.damping.quality"),
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
         'exchange the two values: start = "10 kHz"  and  stop = "20 kHz"'),
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
        (lambda: kc.LinearModel(M=np.eye(2), K=np.eye(2), B=None), "lacks matrices",
         "add B=INPUT_MATRIX"),
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
    own = "For your own method, call kc.register_reductor first"
    assert found["next"] == f"did you mean 'response POD'? {own}"


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
        ("rom.tolerance", "1e-13", ">= 1e-10", "write  --set rom.tolerance=0.0001"),
        ("rom.tolerance", "2", "< 1", "for 2 %, write  --set rom.tolerance=0.02"),
        ("rom.tolerance", "200", "< 1", "write  --set rom.tolerance=0.0001"),
        ("error_budget", "5", "< 1", "for 5 %, write  --set error_budget=0.05"),
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
    assert found["expected"] == "a pin of kind um/N: spring.a"
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


@pytest.mark.parametrize(
    ("key", "typed", "proposed"),
    [
        ("impact.velocity", "1:2", "-1:-2:5"),
        ("impact.velocity", "log:1", "log:-1:-10:5"),
        ("impact.velocity", "1 m/s:2", "-1 m/s:-2 m/s:5"),
        ("impact.velocity", "1:2:x", "-1:-2:5"),
        ("impact.velocity", "1::5", "-1:-10:5"),
        ("impact.velocity", "1;2", "-1,-2"),
        ("impact.velocity", "1 .. 2", "-1:-2:5"),
        ("impact.velocity", "0:1:5", "-0.5:-1:5"),
        ("impact.velocity", "-1:1:5", "-1:-0.5:5"),
        ("impact.velocity", "normal(1)", "normal(-1,0.1,50)"),
        ("impact.velocity", "random(1,2,5)", "uniform(-2,-1,5)"),
        ("impact.velocity", "uniform(2,1,5)", "uniform(-2,-1,5)"),
        ("sphere.radius", "-1 mm:-2 mm:5", "1 mm:2 mm:5"),
        ("sphere.radius", "0:1 mm:5", "0.5 mm:1 mm:5"),
        ("sphere.radius", "1 mm:2 mm", "1 mm:2 mm:5"),
    ],
)
def test_a_proposed_range_suits_the_swept_key(cli, key, typed, proposed):
    """Each proposal corrects all faults of the range, also the sign that the key requires."""
    failed = cli("sweep", "impact", "--dry-run", "--set", f"{key}={typed}")
    advice = " ".join(shlex.split(rows(failed.stderr)["next"].removeprefix("write ")))
    assert advice.removeprefix(f"--set {key}=") == proposed
    done = cli("sweep", "impact", "--dry-run", "--set", f"{key}={proposed}")
    assert done.exit_code == 0


@pytest.mark.parametrize(
    ("words", "names"),
    [
        ("run buzzer", ["buzzer_7bb_12_9", "buzzer_7bb_15_6"]),
        ("explain buzzr", ["buzzer_7bb_12_9", "buzzer_7bb_15_6"]),
        ("verify kick", ["kick_and_catch", "kick_slew", "amplifier_kick"]),
        ("bench plate", ["plate_pull_in", "plate_switch"]),
        ("sweep speaker --set a=1:2:3", ["buzzer_and_speaker", "loudspeaker"]),
        ("fit buzzer:disk x.csv --vary a=1:2", ["buzzer_7bb_12_9"]),
    ],
)
def test_a_word_of_several_scenes_proposes_all_of_them(cli, words, names):
    Path("x.csv").write_text("frequency_hz,real_ohm,imag_ohm\n1,2,3\n")
    found = rows(cli(*words.split()).stderr)
    listed = found["expected"].partition(" such as ")[2].removesuffix(", …").split(", ")
    assert listed[: len(names)] == names
    assert len(listed) <= 5
    assert found["next"].startswith("write one of these names")
    for name in listed:
        kc.load_scene(name)


@pytest.mark.parametrize("word", ["gap", "harvest", "beam", "loudspeaker2", "buzzer_7bb_20_5"])
def test_a_word_of_one_scene_proposes_this_scene(cli, word):
    hint = rows(cli("explain", word).stderr)["next"]
    kc.load_scene(hint.removeprefix("did you mean '").removesuffix("'?"))


@pytest.mark.parametrize(
    ("scene", "kind", "rounds"),
    [("harvester", "dc", 1), ("stack_p882", "dc", 1), ("stack_p882", "op", 1),
     ("comb_resonator", "dc", 1), ("harmonic", "dc", 1), ("plate_pull_in", "ac", 2)],
)  # fmt: skip
def test_another_type_of_analysis_names_all_other_keys_as_overrides(cli, scene, kind, rounds):
    """The advice is an option, because the user changed an override and not the file."""
    words = ["explain", scene, "--set", f"analysis.type={kind}"]
    for _ in range(rounds):
        advice = rows(cli(*words).stderr)["next"].partition("  in place of")[0]
        verb, *added = shlex.split(advice.partition(", which")[0])
        words = [*words, *added] if verb == "add" else ["explain", scene, *added]
    assert cli(*words).exit_code == 0


@pytest.mark.parametrize(
    ("scene", "typed", "option"),
    [
        ("buzzer_7bb_20_6", "support=clampd", "disc.support=clamped"),
        ("buzzer_7bb_20_6", "thickness=1mm", "disc.layers[0].thickness=1mm"),
        ("buzzer_7bb_20_6", "quality=50", "disc.damping.quality=50"),
        ("impact", "velocity=-2", "impact.velocity=-2"),
        ("impact", "stop=1ms", "analysis.stop=1ms"),
        ("impact", "order=10", "rom.order=10"),
    ],
)
def test_an_override_without_its_table_proposes_the_whole_override(cli, scene, typed, option):
    advice = rows(cli("explain", scene, "--set", typed).stderr)["next"]
    words = shlex.split(advice)
    assert words == ["write", "--set", option, "in", "place", "of", "--set", typed]
    assert cli("explain", scene, *words[1:3]).exit_code == 0


def test_a_sweep_without_the_table_of_its_key_proposes_the_whole_range(cli):
    for typed in ("-1:-2:5", "normal(-1,0.1,5)"):
        failed = cli("sweep", "impact", "--dry-run", "--set", f"velocity={typed}")
        words = shlex.split(rows(failed.stderr)["next"])
        assert words[1:3] == ["--set", f"impact.velocity={typed}"]
        assert cli("sweep", "impact", "--dry-run", *words[1:3]).exit_code == 0


def test_an_unknown_override_proposes_to_leave_it_out(cli):
    hint = rows(cli("explain", "impact", "--set", "foo=1").stderr)["next"]
    assert hint == "leave out --set 'foo=1'; kc2spice scenes --keys lists all keys"


def test_a_missing_list_of_layers_in_python_is_an_entry_of_a_dict():
    hint = fails(kc.load_scene, {"disc": {"part": "disc"}}).hint
    entry, _, place = hint.removeprefix("add  ").rpartition("  to the dict ")
    assert place == "disc"
    key, _, value = entry.partition(": ")
    assert ast.literal_eval(key) == "layers"
    kc.load_scene({"disc": {"part": "disc", "layers": ast.literal_eval(value)}})


def test_a_table_of_materials_proposes_the_key_of_a_layer(cli):
    constants = 'density = 8500\nyoungs_modulus = "100 GPa"\npoisson_ratio = 0.3\n'
    Path("own.toml").write_text(f"[materials.mybrass]\n{constants}{DISC}")
    found = rows(cli("explain", "own.toml").stderr)
    assert "own_material.md" in found["next"]
    material = found["next"].partition("  material = ")[2].partition("  in the layer")[0]
    layer = {"diameter": "10 mm", "thickness": "0.2 mm"}
    own = layer | {"material": parse_toml(f"m = {material}")["m"]}
    layers = [own, layer | {"material": "PZT-5A"}]
    scene = kc.load_scene({"disc": {"part": "disc", "layers": layers}})
    assert scene.get_part("disc").keys.layers[0].material["density"] == 8500


def test_another_type_of_analysis_in_python():
    error = fails(kc.load_scene, "harvester", {"analysis.type": "dc"})
    assert "`stop`, `start` and `scale` have no effect" in error.message
    table = {"type": "dc", "points": 401, "sweep": "shaker.dc"}
    assert error.hint == f"write  'analysis': {table}  in place of 'analysis.type': 'dc'"
    kc.load_scene("harvester", {"analysis": table})


def test_several_keys_without_effect_in_a_file(cli):
    text = 'type = "op"\nstart = 10\nstop = "1 kHz"\npoints = 5\n'
    Path("own.toml").write_text(DIVIDER.replace('type = "op"\n', text))
    found = rows(cli("run", "own.toml").stderr)
    assert found["next"] == "delete the keys `stop`, `start` and `points` of [analysis]"


@pytest.mark.parametrize("word", ["murata", "relay"])
def test_a_word_of_part_numbers_as_a_scene_proposes_a_search(cli, word):
    hint = rows(cli("run", word).stderr)["next"]
    assert hint == f"write one of the part numbers that  kc2spice parts {word}  lists"
    parts = json.loads(cli("parts", word, "--json").stdout)
    assert parts
    kc.load_scene(parts[0]["number"])


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


MESH_TEXTS = {
    "a.msh": (MESH.read_text(), "a mesh", 'mesh = "a.msh"'),
    "renamed.txt": (MESH.read_text(), "a mesh", "save a volume mesh as renamed.msh"),
    "a.inp": ("*HEADING\nbar\n*NODE\n1, 0., 0., 0.\n", "a mesh", 'mesh = "a.inp"'),
    "a.bdf": ("SOL 103\nBEGIN BULK\nGRID,1,,0.,0.,0.\n", "a mesh", 'mesh = "a.bdf"'),
    "a.unv": ("    -1\n  2411\n", "a mesh", 'mesh = "a.unv"'),
    "a.vtk": ("# vtk DataFile Version 3.0\nbar\nASCII\n", "a mesh", "save a volume mesh as a.msh"),
    "a.vtu": ('<?xml version="1.0"?>\n<VTKFile>\n', "a mesh", 'mesh = "a.vtu"'),
    "a.stl": ("solid a\nfacet normal 0 0 1\n", "a surface", "as .step in the CAD program"),
    "a.step": ("ISO-10303-21;\nHEADER;\n", "a CAD file", 'mesh = "a.step"'),
    "shape.txt": ("A part".ljust(72) + "S      1\n", "a CAD file", "volume mesh as shape.msh"),
    "a.igs": (" " * 72 + "S      1\n", "a CAD file", "save a volume mesh as a.msh"),
}


@pytest.mark.parametrize("command", ["run {}", "reduce {}", f"fit {BUZZER_DISC} {{}} {VARIED}"])
@pytest.mark.parametrize("name", MESH_TEXTS)
def test_a_mesh_in_place_of_another_file_is_named(cli, command, name):
    text, kind, advice = MESH_TEXTS[name]
    Path(name).write_text(text)
    done = cli(*command.format(name).split())
    found = rows(done.stderr)
    assert done.exit_code == 2
    assert f"this file is {kind}" in found["head"]
    assert advice in found["next"]


def test_every_format_of_meshes_is_recognised_by_its_extension():
    for suffix in (*FILE_FORMATS, *SURFACE_SUFFIXES):
        assert identify_format(b"", suffix) in (MESH_FORMAT, SURFACE, CAD), suffix


def test_a_mesh_proposes_keys_of_a_part_that_exists(cli):
    Path("u.msh").write_bytes(MESH.read_bytes())
    advice = rows(cli("run", "u.msh").stderr)["next"]
    for text in ('part = "body"', 'mesh = "u.msh"'):
        assert text in advice
        assert text in BAR
    Path("bar.toml").write_text(BAR)
    assert cli("explain", "bar.toml").exit_code == 0
    assert cli(*advice.partition("; kc2spice ")[2].partition("  lists")[0].split()).exit_code == 0


@pytest.mark.parametrize(
    "text", ["frequency_hz,real_ohm\n", "grid voltage 5 V\n", "solid copper\n"]
)
def test_a_table_is_not_a_mesh(text):
    assert identify_format(text.encode(), ".csv") is None


def test_a_file_of_matrices_with_grid_points_is_not_a_mesh(tmp_path):
    path = tmp_path / "a.bdf"
    path.write_text("GRID,1,,0.,0.,0.\nDMIG,KAAX,0,6\n")
    assert "a mesh" not in fails(kc.read_model, path).message


@pytest.mark.parametrize("typed", ["disc.u.centre", "disc.centr"])
def test_a_missing_port_is_reported_at_the_key_that_refers_to_it(cli, typed):
    scene = BUZZER + '[series]\npart = "resistor"\nresistance = "1 kOhm"\n'
    Path("my.toml").write_text(scene + f'pins = {{ a = "{typed}" }}\n')
    found = rows(cli("explain", "my.toml").stderr)
    assert "key series.pins.a: disc has no such port" in found["head"]
    assert found["got"] == repr(typed)
    assert found["expected"] == "one of disc.anode, disc.cathode"
    pins = f"pins = {{ {found['next'].removeprefix('write').strip()} }}\n"
    Path("my.toml").write_text(scene + pins)
    assert "no such port" not in cli("explain", "my.toml").stderr
    assert "different kinds" not in cli("explain", "my.toml").stderr


def test_a_missing_port_of_a_probe_is_reported_at_the_probe(cli):
    Path("my.toml").write_text(BUZZER + '[probes]\nx_m = { of = "disc.u.centr", take = "max" }\n')
    found = rows(cli("explain", "my.toml").stderr)
    assert "key probes.x_m.of" in found["head"]


def test_a_short_simulation_is_reported_at_the_override(cli):
    found = rows(cli("explain", "buzzer_square", "--set", "analysis.stop=1 ns").stderr)
    assert "--set 'analysis.stop=1 ns': the simulation is shorter" in found["head"]
    assert found["got"] == "1 ns"
    words = shlex.split(found["next"])[1:]
    assert words[1].startswith("analysis.stop=")
    assert cli("explain", "buzzer_square", *words).exit_code == 0
    found = rows(cli("explain", "buzzer_square", "--set", "solver.max_step=1 s").stderr)
    assert found["next"] == "leave out --set 'solver.max_step=1 s'"
    found = rows(cli("explain", "buzzer_square", "--set", "analysis.stop=1000 s").stderr)
    assert "--set 'analysis.stop=1000 s': the run has too many" in found["head"]
    assert found["next"].startswith("lower analysis.stop")


def test_an_error_about_two_keys_names_the_override(cli):
    override = "gate.pulse.width=200 us"
    found = rows(cli("explain", "buzzer_square", "--set", override).stderr)
    assert found["next"].startswith(f"change --set '{override}', or raise pulse.period")
    error = fails(kc.load_scene, "buzzer_square", {"gate.pulse.width": "200 us"})
    assert error.hint.startswith(f"change '{override}' in the overrides, or raise pulse.period")
    Path("my.toml").write_text(
        '[coil]\npart = "relay"\nresistance = "100 Ohm"\nvoltage = "12 V"\npick_up = "8 V"\n'
        'release = "2 V"\noperate_time = "10 ms"\n'
    )
    found = rows(cli("explain", "my.toml", "--set", "coil.voltage=5 V").stderr)
    assert found["next"].startswith("change --set 'coil.voltage=5 V', or raise voltage")


@pytest.mark.parametrize(
    ("sizes", "letter", "expected"),
    [((3, 2, 3), "K", "3 x 3"), ((2, 3, 3), "M", "3 x 3"), ((3, 2, 2), "M", "2 x 2")],
)
def test_the_matrix_with_another_size_than_most_is_wrong(sizes, letter, expected):
    m, k, b = sizes
    error = fails(kc.LinearModel, M=np.eye(m), K=np.eye(k), B=np.ones((b, 1)))
    assert error.message == f"matrix {letter} has a wrong size"
    assert error.expected == expected


@pytest.mark.parametrize("text", ["-1,,-0.5", "-1,-0.5,", ",-1,-0.5"])
def test_an_empty_value_of_a_list_is_named(cli, text):
    found = rows(cli("sweep", "impact", "--set", f"impact.velocity={text}").stderr)
    assert "a value is missing beside a comma" in found["head"]
    assert found["got"] == repr(text)
    assert found["next"].endswith("-1,-0.5")


@pytest.mark.parametrize(
    ("word", "choice"),
    [("dB", "spl"), ("decibel", "spl"), ("average", "mean"), ("amplitude", "max"), ("avg", "mean")],
)
def test_a_word_for_a_choice_proposes_the_choice_and_lists_it(cli, word, choice):
    probe = f'[probes]\nx = {{ of = "disc.u.centre", take = "{word}" }}\n'
    Path("my.toml").write_text(BUZZER + probe)
    found = rows(cli("explain", "my.toml").stderr)
    assert found["next"] == f'write  take = "{choice}"'
    assert f" {choice}," in found["expected"]


def test_a_fit_to_phases_in_radians_proposes_the_unit(cli):
    """The impedance of 20 nF parallel to 1 kOhm, with phases [rad] below a title in degrees."""
    f = np.linspace(1e3, 4e4, 200)
    z = 1e3 / (1 + 2j * np.pi * f * 2e-5)
    lines = [f"{a},{b},{c}" for a, b, c in zip(f, abs(z), np.angle(z), strict=True)]
    Path("z.csv").write_text("\n".join(["frequency_hz,z_abs_ohm,phase_deg", *lines]) + "\n")
    done = cli("fit", BUZZER_DISC, "z.csv", *VARIED.split())
    assert "no values in the ranges" in done.stderr
    assert "write rad in the title" in done.stderr


def test_a_tolerance_of_zero_proposes_a_tolerance_that_works(cli):
    found = rows(cli("export", "impact", "--tolerance", "0").stderr)
    words = found["next"].split()[1:]
    assert words[0] == "--tolerance"
    assert cli("export", "impact", *words, "--out", "out").exit_code == 0


def test_a_measurement_names_all_options_that_do_not_apply(cli):
    Path("z.csv").write_text("frequency_hz,real_ohm,imag_ohm\n1,2,3\n")
    found = rows(cli("reduce", "z.csv", "--order", "4", "--tolerance", "1e-3").stderr)
    assert found["next"] == "leave out --tolerance and --order"


def test_an_index_of_a_scene_or_a_result_proposes_the_mapping(tmp_path):
    scene = kc.load_scene("impact")
    with pytest.raises(TypeError, match=r"SCENE\.parts\['sphere'\] returns a part"):
        scene["sphere"]
    assert scene.parts["sphere"].name == "sphere"
    path = tmp_path / "my.toml"
    path.write_text(RESISTOR)
    result = kc.run(path)
    with pytest.raises(TypeError, match=r"RESULT\.waves\["):
        result[next(iter(result.waves))]


def test_a_warning_is_printed_once(cli):
    text = ".subckt load in ref\nR1 in mid 5M\nR2 mid ref 1k\n.ends\n"
    Path("load.lib").write_text(text)
    Path("my.toml").write_text(
        '[load]\npart = "netlist"\nfile = "load.lib"\nsubckt = "load"\n'
        'pins = { in = "drive.out" }\n'
        '[drive]\npart = "source"\ndc = "1 V"\n[analysis]\ntype = "op"\n'
        '[probes]\nv = { of = "drive.v", take = "max" }\n'
    )
    assert cli("run", "my.toml").stderr.count("ngspice reads 5M as 5 milli") == 1


def test_a_percentage_as_a_tolerance_proposes_the_fraction(cli):
    found = rows(cli("export", "impact", "--tolerance", "5").stderr)
    assert found["next"] == "for 5 %, write  --tolerance 0.05"
    assert cli("export", "impact", "--tolerance", "0.05", "--out", "out").exit_code == 0
    with pytest.raises(kc.errors.UsageError, match=r"for 5 %, write tolerance=0\.05"):
        kc.reduce(kc.build("impact")["kick"], tolerance=5)


def test_a_number_with_a_prefix_without_quotes_gets_the_unit_of_its_key(cli):
    text = (
        '[load]\npart = "resistor"\nresistance = 1k\npins = { a = "drive.out" }\n'
        '[drive]\npart = "source"\ndc = "1 V"\n[analysis]\ntype = "op"\n'
        '[probes]\nv = { of = "drive.v", take = "max" }\n'
    )
    Path("my.toml").write_text(text)
    found = rows(cli("run", "my.toml").stderr)
    assert found["next"] == 'write  resistance = "1 kOhm"'
    line = found["next"].removeprefix("write  ")
    Path("my.toml").write_text(text.replace("resistance = 1k", line))
    assert cli("run", "my.toml").exit_code == 0


def test_the_word_file_in_the_name_of_a_netlist_is_not_replaced(cli):
    Path("PROFILE.cir").write_text("a driver\nR1 a 0 1k\n.tran 1u 5m\n.end\n")
    found = rows(cli("run", "PROFILE.cir").stderr)
    assert found["next"].startswith("in PROFILE.cir, put the circuit between  .subckt PROFILE NODE")
    assert 'file = "PROFILE.cir"' in found["next"]


def test_a_deck_without_subcircuits_proposes_to_make_one(cli):
    circuit = "V1 in ref 5\nR1 in a 1k\nC1 a ref 10n\n"
    Path("driver.cir").write_text(f"a driver\n{circuit}.tran 1u 5m\n.end\n")
    found = rows(cli("run", "driver.cir").stderr)
    assert "without .subckt" in found["head"]
    assert ".subckt driver NODE1 NODE2 ref  and  .ends, without title, analysis" in found["next"]
    Path("my.toml").write_text(
        '[d]\npart = "netlist"\nfile = "driver.cir"\nsubckt = "driver"\n'
        'pins = { a = "load.a" }\n[load]\npart = "resistor"\nresistance = "1 kOhm"\n'
        '[analysis]\ntype = "op"\n[probes]\nv = { of = "load.i", take = "max" }\n'
    )
    found = rows(cli("run", "my.toml").stderr)
    assert "card" not in found["head"]
    assert ".subckt NAME NODE1 NODE2 ref  and  .ends" in found["next"]
    Path("driver.cir").write_text(f".subckt driver a ref\n{circuit}.ends\n")
    assert cli("run", "my.toml").exit_code == 0


def test_a_band_of_an_analysis_proposes_start_and_stop(cli):
    done = cli("run", "buzzer_7bb_20_6", "--set", "analysis.band=[1, 2]")
    assert "rom.band" not in done.stderr
    assert 'start = "10 Hz"  and  stop = "10 kHz"' in done.stderr


def test_a_sweep_with_a_misspelt_metric_keeps_its_first_point(cli):
    words = "sweep", "impact", "--set", "impact.velocity=-1,-0.5", "--out", "out", "--metric"
    assert "did you mean" in cli(*words, "rebound_velocty").stderr
    summary = json.loads(cli(*words, "rebound_velocity_m_s", "--json").stdout)
    assert summary["resumed"] >= 1


def test_a_fit_prints_the_assumed_unit_and_asks_for_kilohertz(cli):
    model = kc.build(kc.load_scene("buzzer_7bb_20_6"))["disc"].select(["anode"])
    f = np.linspace(4e3, 9e3, 80)
    Z = 1 / (2j * np.pi * f * model.transfer(f)[:, 0, 0])
    for name, title, scale in (("z.csv", "frequency", 1e-3), ("y.csv", "frequency_khz", 1e-3)):
        table = np.column_stack([scale * f, np.abs(Z), np.angle(Z, deg=True)])
        np.savetxt(name, table, delimiter=",", header=f"{title},impedance,phase", comments="")
    words = "fit", BUZZER_DISC, "--vary", "damping.quality", "--out", "out"
    found = rows(cli(*words, "z.csv").stderr)
    assert "Hz is assumed" in found["got"]
    assert "from 4 to 9 Hz" in found["got"]
    assert "write the title  frequency_khz" in found["next"]
    done = cli(*words, "y.csv")
    assert done.exit_code == 0
    assert "80 points from 4000 to 9000 Hz" in " ".join(done.stdout.split())
    assert "note: " in done.stdout


# --- a user's own circuit, and the material of a disc -----------------------------------------


@pytest.mark.parametrize(
    ("pins", "pin", "message", "name"),
    [
        ("in out gnd", "gnd", "is node 0, the global ground", "ref"),
        ("in out ref GND", "GND", "is node 0, the global ground", "vss"),
        ("in out temper", "temper", "has a reserved name of ngspice", "n_temper"),
        ("in out 3", "3", "has no valid name", "n_3"),
    ],
)
def test_a_pin_without_a_valid_name_is_located_in_its_file(pins, pin, message, name, tmp_path):
    """The error names the line of the .subckt card, and the proposed name is accepted."""
    library = f"* mine\n.subckt mine {pins}\nR1 in out 1k\nR2 out {pin} 1k\n.ends\n"
    scene = '[own]\npart = "netlist"\nfile = "own.lib"\nsubckt = "mine"\n'
    scene += 'pins = { in = "s.out", out = "r.a" PINS }\n[s]\npart = "source"\ndc = "1 V"\n'
    scene += '[r]\npart = "resistor"\nresistance = "1 kOhm"\n'
    (tmp_path / "own.lib").write_text(library)
    path = tmp_path / "own.toml"
    path.write_text(scene.replace("PINS", ""))
    error = fails(kc.load_scene, path)
    assert (error.where, error.got) == ("own.lib:2", pin)
    assert message in error.message
    assert error.hint == f"rename the node {pin} to {name} in all lines of .subckt mine"
    (tmp_path / "own.lib").write_text(library.replace(f" {pin}", f" {name}"))
    others = [item for item in pins.replace(pin, name).split() if item not in ("in", "out", "ref")]
    joined = "".join(f', {item} = "gnd"' for item in others)
    path.write_text(scene.replace("PINS", joined))
    assert kc.load_scene(path).get_net("own", name) == "0"


@pytest.mark.parametrize("word", ["base", "from", "material", "name"])
def test_a_material_with_another_word_for_like_gets_like(word):
    table = '{{ {} = "PZT-5A", permittivity = {{ eps33 = 2000.0 }} }}'
    change = "disc.layers[1].material="
    error = fails(kc.load_scene, "buzzer_7bb_20_6", [change + table.format(word)])
    assert error.hint == f"write `like` in place of `{word}`"
    scene = kc.load_scene("buzzer_7bb_20_6", [change + table.format("like")])
    assert scene.parts["disc"].keys.layers[1].material["permittivity"] == {"eps33": 2000.0}


@pytest.mark.parametrize(
    ("part_type", "origin"),
    [("netlist", "pins of its `.subckt`"), ("controller", "key `inputs`"),
     ("heat_body", "keys `isothermal`"), ("listener", "key `sources`")],
)  # fmt: skip
def test_pins_that_follow_from_a_file_or_a_key_are_called_pins_of_the_example(
    part_type, origin, cli
):
    text = " ".join(cli("scenes", "--part", part_type).output.split())
    assert "Pins of the example" in text
    assert origin in text
    assert "Pins of the example" not in cli("scenes", "--part", "resistor").output
