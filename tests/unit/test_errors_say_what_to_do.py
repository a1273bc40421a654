"""Mistakes that new users make: each error names what was found and what to write instead."""

import re

import numpy as np
import pytest
from scipy import sparse
from support import _fit_power_series, find_material

import kc2spice as kc

LANGEVIN = """
name = "own"
analysis = { type = "ac", stop = "50 kHz" }
[horn]
part = "langevin"
"""
BIMORPH = """
name = "own"
analysis = { type = "ac", stop = "50 kHz" }
[beam]
part = "bimorph"
length = "20 mm"
width = "4 mm"
"""
CIRCUIT = """
name = "own"
analysis = { type = "transient", stop = "1 ms" }
[drive]
part = "source"
sine = { amplitude = "1 V", frequency = "1 kHz" }
pins = { out = "amp.in" }
[amp]
part = "netlist"
file = "amp.lib"
subckt = "amp"
pins = { out = "load.a" }
[load]
part = "resistor"
resistance = "1 kOhm"
"""
AMPLIFIER = """* filter
.subckt amp in out ref
R1 in mid 1k
L1 mid out 1u {more}
R2 out ref 1k
.ends
"""
CHAIN = {"M": np.eye(2), "K": 1e6 * np.array([[2.0, -1.0], [-1.0, 2.0]])}


@pytest.fixture
def said(tmp_path, cli):
    """Runs a scene on the command line; its exit code and the message as one line."""

    def run(text):
        (tmp_path / "own.toml").write_text(text)
        done = cli("run", "own.toml")
        return done.exit_code, " ".join(done.stderr.split())

    return run


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (LANGEVIN + 'front = { length = "20 mm" }', "expected: a list, front = [{ length = … }]"),
        (LANGEVIN + "front = [3]", "expected: a table, { KEY = VALUE, … }"),
        (BIMORPH + "layers = []", "too few entries got: [] expected: a list of at least 1 entry"),
        (BIMORPH + "rom = { band = [1, 2, 3] }", "expected: a list of at most 2 entries"),
        (BIMORPH + "rom = { band = 3 }", "expected: a list, band = [ … ]"),
    ],
)
def test_lists_of_a_scene(said, text, words):
    code, message = said(text)
    assert code == 2
    assert words in message
    assert "tuple" not in message.lower()


def test_parasitics_of_ltspice_are_named_with_the_line(said, tmp_path):
    (tmp_path / "amp.lib").write_text(AMPLIFIER.format(more="rser=0.5"))
    code, message = said(CIRCUIT)
    assert code == 2
    assert "amp.lib:4" in message
    assert "got: rser=0.5 of L1" in message
    assert "write the R in series as a separate element and delete rser" in message


def test_a_card_that_ngspice_cannot_read_is_quoted(said, tmp_path):
    (tmp_path / "amp.lib").write_text(AMPLIFIER.format(more="flavour=3"))
    code, message = said(CIRCUIT)
    assert code == 5
    assert "amp_out 1u flavour=3: unknown parameter (flavour)" in message
    assert "pages" not in message


def refused(call, *words):
    with pytest.raises(kc.errors.UsageError) as found:
        call()
    for word in words:
        assert word in str(found.value)


def test_sparse_matrices_saved_whole(tmp_path):
    np.savez(tmp_path / "chain.npz", **{k: sparse.csr_array(v) for k, v in CHAIN.items()})
    refused(
        lambda: kc.read_model(tmp_path / "chain.npz"),
        "chain.npz", "Python object", "K.data, K.indices, K.indptr", "scipy.io.mmwrite",
    )  # fmt: skip


def test_damping_called_d(tmp_path):
    np.savez(tmp_path / "chain.npz", **CHAIN, B=np.ones((2, 1)), D=1e-3 * np.eye(2))
    refused(lambda: kc.read_model(tmp_path / "chain.npz"), "matrix D", 'damping_matrix = "D"')


def model(**more):
    port = kc.Port("tip", "mechanical")
    return kc.LinearModel(**CHAIN, B=np.ones((2, 1)), ports=(port,), **more)


def test_one_number_for_rayleigh_damping():
    for wrong in (0.01, (0.01,), "1 %"):
        refused(
            lambda w=wrong: model(rayleigh=w), repr(wrong), "(alpha, beta)", "(0, z / (pi * f))"
        )
    refused(lambda: model(E=0.01), "matrix E has 0 dimensions", "rayleigh=(alpha, beta)")
    refused(
        lambda: model(D=1e-3 * np.eye(2)), "matrix D", "if D is the damping matrix, pass it as E"
    )


def test_ports_of_a_model_are_ports():
    chain = {**CHAIN, "B": np.ones((2, 1))}
    refused(lambda: kc.LinearModel(**chain, ports=["tip"]), "'tip'", 'Port("tip", "mechanical")')


def test_an_order_that_a_model_does_not_have():
    definite = model(rayleigh=(0.0, 1e-6))
    # Its one port moves both masses alike: the other motion is no direction of any reduced model.
    refused(
        lambda: kc.reduce(definite, order=2, band=(0, 1e3)),
        "fewer states than this order",
        "1 to 1",
    )


def test_a_number_for_the_stiffness_of_a_material():
    table = {"density": 7800, "stiffness": 3.0}
    refused(lambda: find_material(table), "stiffness: not a table", "3.0")


def test_frequencies_of_a_band_may_have_units():
    found = kc.reduce(model(), tolerance=1e-3, band=(0, "20 kHz"))
    assert found.certificate.band_hz == (0.0, 20e3)
    refused(lambda: kc.reduce(model(), tolerance=1e-3, band=(0, "20 mm")), "band", "wrong unit")
    refused(lambda: kc.reduce(model(), tolerance="small", band=(0, 2e4)), "tolerance", "'small'")
    refused(lambda: kc.reduce(model(), tolerance=1e-3, band=20e3), "such as (0, 20e3)")


def test_overrides_of_a_run():
    divider = {
        "name": "divider",
        "drive": {"part": "source", "dc": "1 V"},
        "upper": {"part": "resistor", "resistance": "1 kOhm", "pins": {"a": "drive.out"}},
        "lower": {"part": "resistor", "resistance": "1 kOhm", "pins": {"a": "upper.b"}},
        "analysis": {"type": "op"},
        "probes": {"middle": {"of": "lower.v"}},
    }
    change = {"upper.resistance": "3 kOhm"}
    assert kc.run(divider, overrides=change).metrics["middle"] == pytest.approx(0.25, rel=1e-6)
    refused(lambda: kc.run(divider, change), "out", "overrides={")


MASS = '[m]\npart = "mass"\nmass = "1 g"\n[solver]\nstop = "1 s"\n'


def test_a_mass_with_an_open_pin_is_not_nailed_to_the_ground(said):
    code, text = said(MASS)
    assert code == 2
    assert "pin a of m is not connected" in text
    assert "gnd" not in text
    assert "spring" in text
    # a spring that waits for a partner is what the mass is meant for
    code, text = said(MASS + '[s]\npart = "spring"\nstiffness = "1 N/m"\n')
    assert (code, '"s.a"' in text) == (2, True)


def test_an_open_pin_is_not_joined_to_a_bias(said, tmp_path):
    """The bias is held by a source: the pin of the user's netlist must not short it."""
    (tmp_path / "tia.lib").write_text(
        ".subckt tia in out ref\nR1 in out 1Meg\nR2 out ref 1k\n.ends\n"
    )
    code, text = said(
        '[bias]\npart = "source"\ndc = "5 V"\npins = { out = "plate.a" }\n'
        '[plate]\npart = "resistor"\nresistance = "1 GOhm"\npins = { b = "tia.in" }\n'
        '[tia]\npart = "netlist"\nfile = "tia.lib"\nsubckt = "tia"\npins = { ref = "gnd" }\n'
        '[analysis]\ntype = "op"\n'
    )
    assert code == 2
    assert "pin out of tia is not connected" in text
    load = 'part = "resistor", resistance = "1 MOhm", pins = { a = "tia.out" }'
    assert f"next: add a part at this pin, such as [tia_load] with {load}" in text


def test_the_documented_form_of_coils_is_named(said):
    code, text = said(
        '[gen]\npart = "moving_magnet"\nradius = "3 mm"\nthickness = "4 mm"\n'
        'remanence = "1 T"\ny_min = "-1 mm"\ny_max = "1 mm"\n[[gen.coils]]\nradius = "4 mm"\n'
    )
    assert code == 2
    assert "[gen.coils.NAME]" in text


def test_part_numbers_suggest_a_scene(cli):
    done = cli("export", "7BB-20")
    assert done.exit_code == 2
    assert "such as buzzer_7bb_20_3, buzzer_7bb_20_6" in done.stderr


def test_couplings_that_change_too_fast_name_the_key_that_helps():
    nodes = np.cos(np.pi * (np.arange(17) + 0.5) / 17)
    values = np.sign(nodes)[None, :, None]  # a step: no polynomial follows it
    refused(lambda: _fit_power_series(nodes, values, 1e-5), "raise the key `tolerance`, now 1e-05")


def test_a_file_that_does_not_exist(cli, tmp_path):
    (tmp_path / "my_buzzer.toml").write_text("")
    done = cli("run", "my_buzer.toml")
    assert done.exit_code == 2
    assert "my_buzer.toml: this file does not exist" in done.stderr
    assert "did you mean 'my_buzzer.toml'?" in done.stderr
    assert "loudspeaker" not in done.stderr


def test_at_most_five_candidates_are_listed(cli):
    done = cli("run", "buzer_7bb")
    listed = next(line for line in done.stderr.splitlines() if "expected" in line)
    assert listed.count("buzzer_7bb") == 5
    assert re.search(r"\(\d+ in all: kc2spice scenes\)", listed)


def test_a_key_of_a_part_that_the_scene_lacks(cli):
    done = cli("run", "kick_and_catch", "--set", "disc.layers=3")
    assert done.exit_code == 2
    assert "--set 'disc.layers=3': this scene has no part 'disc'" in done.stderr
    assert "kick, contact, sphere, catch, control" in done.stderr


DIVIDER = """
title = "Divider"
[battery]
part = "source"
dc = "10 V"
[r1]
part = "resistor"
resistance = "1 kOhm"
pins = { a = "battery.out" }
[r2]
part = "resistor"
resistance = "1 kOhm"
pins = { a = "r1.b" }
[analysis]
type = "op"
[probes.middle]
of = "r2.v"
take = "final"
"""


@pytest.fixture
def divider(tmp_path, cli):
    """Runs the divider with one line replaced: exit code, and the rows of the message by name."""

    def run(line, otherwise, *words, command="run"):
        assert DIVIDER.count(f"\n{line}\n") >= 1
        text = DIVIDER.replace(f"\n{line}\n", f"\n{otherwise}\n", 1)
        (tmp_path / "own.toml").write_text(text)
        done = cli(command, "own.toml", *words)
        head, *rows = done.stderr.splitlines() or [""]
        names = ("got", "expected", "next")
        found = {n: r.split(":", 1)[1].strip() for n in names for r in rows if f"  {n}:" in r}
        return done.exit_code, {"head": head, **found}

    return run


@pytest.mark.parametrize(
    ("line", "otherwise", "problem"),
    [
        ('title = "Divider"', "title = Divider", "this text has no quotes"),
        ('title = "Divider"', 'title = "Divider', "missing closing quote"),
        ('title = "Divider"', "title = 'Divider", "missing closing quote"),
        ('title = "Divider"', 'title = Divider"', "missing opening quote"),
        ('title = "Divider"', r'title = "C:\data"', "a backslash between double quotes"),
        ('title = "Divider"', "gravity = .5", "this value is not valid TOML"),
        ('resistance = "1 kOhm"', "resistance = 1 kOhm", "this text has no quotes"),
        ('pins = { a = "r1.b" }', "pins = { a = r1.b } # to r1", "this text has no quotes"),
        ('pins = { a = "r1.b" }', 'pins = { a = "r1.b }', "missing closing quote"),
        ('pins = { a = "r1.b" }', 'pins = { a = "r1.b"', "{ without its }"),
        ('pins = { a = "r1.b" }', 'pins = {\na = "r1.b",\n}', "must be on one line"),
        ("[r1]", "[[r1]", "the brackets of a table do not match"),
        ("[r1]", "[r1", "the brackets of a table do not match"),
        ("[r1]", "[r1]]", "the brackets of a table do not match"),
    ],
)
def test_a_line_that_is_not_toml_is_quoted_and_repaired(divider, line, otherwise, problem):
    code, said = divider(line, otherwise)
    first = DIVIDER.split("\n").index(line) + 1
    assert code == 2
    assert f"own.toml, line {first}: " in said["head"]
    assert problem in said["head"]
    assert said["got"] == otherwise.split("\n")[0]
    repaired = said["next"].split("write  ")[-1].split(f"line {first}: ")[-1]
    assert divider(line, repaired)[0] == 0


def test_a_list_without_its_end(divider):
    code, said = divider('type = "op"', 'type = "op"\n[rom]\nband = [0, 5e3')
    assert (code, said["got"]) == (2, "band = [0, 5e3")
    assert "[ without its ]" in said["head"]
    assert said["next"].endswith(": band = [0, 5e3 ]")


def test_a_table_that_a_file_has_twice(divider):
    code, said = divider("[r2]", "[battery]")
    assert code == 2
    assert "own.toml, line 10: line 3 already contains the table [battery]" in said["head"]
    assert said["next"].startswith("rename the second [battery] (line 10)")
    code, said = divider('dc = "10 V"', 'dc = "10 V"\ndc = "12 V"')
    assert (code, said["got"]) == (2, 'dc = "12 V"')
    assert said["next"] == "delete line 5 or 6"


def test_other_lines_that_are_not_toml(divider):
    code, said = divider('title = "Divider"', "title : Divider")
    assert (code, said["got"]) == (2, "title : Divider")
    assert "KEY = VALUE" in said["expected"]


@pytest.mark.parametrize(("words", "right"), [("-1:-2", "-1:-2:5"), ("log:-1:-2", "log:-1:-2:5")])
def test_a_range_without_its_number_of_points(cli, words, right):
    done = cli("sweep", "impact", "--set", f"impact.velocity={words}")
    assert done.exit_code == 2
    assert "a range needs a first value, a last value and a number of points" in done.stderr
    assert right in done.stderr


def test_a_deck_without_one_of_its_parts(cli, tmp_path):
    assert cli("export", "newtons_cradle", "-o", "d").exit_code == 0
    deck = tmp_path / "d" / "newtons_cradle.cir"
    lines = deck.read_text().splitlines(keepends=True)
    card = next(line for line in lines if line.startswith("X")).split()[0]
    deck.write_text("".join(line for line in lines if not line.startswith(f"{card} ")))
    done = cli("run", "newtons_cradle", "--deck", str(deck))
    assert done.exit_code == 2
    assert f"the deck has no card {card}" in done.stderr


def test_a_deck_that_does_not_exist(cli):
    done = cli("run", "newtons_cradle", "--deck", "nofile.cir")
    assert done.exit_code == 2
    assert "nofile.cir: this file does not exist" in done.stderr
    assert "include" not in done.stderr


def test_a_reduced_model_of_another_kind_of_file(cli, tmp_path):
    (tmp_path / "b.toml").write_text("a = 1\n")
    done = cli("export", "--rom", "b.toml")
    assert done.exit_code == 2
    assert "b.toml: this file is not a reduced model" in done.stderr
    assert "b.json" not in done.stderr


def test_a_number_instead_of_a_model():
    refused(lambda: kc.reduce(3), "not a linear model", "int 3", "kc.LinearModel(M=M")


def test_a_misspelt_part_comes_before_its_data(cli):
    done = cli("fit", "buzzer_7bb_20_6:disk", "nodata.csv", "--vary", "damping.quality")
    assert done.exit_code == 2
    assert "disk" in done.stderr
    assert "did you mean 'disc'?" in done.stderr


def test_damping_beyond_the_critical(cli):
    done = cli("run", "kick_and_catch", "--set", "kick.damping.ratio=2")
    assert done.exit_code == 2
    assert "for 1 % damping, write ratio = 0.01" in done.stderr


@pytest.mark.parametrize(
    ("line", "otherwise", "head", "got"),
    [
        ('resistance = "1 kOhm"', 'resistance = "-1 kOhm"', "key r1.resistance", "'-1 kOhm'"),
        ('resistance = "1 kOhm"', "resistance = -1e3", "key r1.resistance", "-1000.0"),
        ('dc = "10 V"', 'dc = "10V DC"', "key battery.dc: unknown unit 'V DC'", "'10V DC'"),
        ('dc = "10 V"', 'sine = { amplitude = "1 A", frequency = 50 }', "sine.amplitude", "'1 A'"),
        ('dc = "10 V"', 'pwl = [[0, 0], ["1 ms", "1 A"]]', "battery.pwl[1][1]", "'1 A'"),
    ],
)
def test_a_value_is_quoted_as_typed_with_its_key(divider, line, otherwise, head, got):
    code, said = divider(line, otherwise)
    assert (code, said["got"]) == (2, got)
    assert head in said["head"]


def test_choices_of_a_key_are_five_and_the_nearest_is_named(divider):
    code, said = divider('take = "final"', 'take = "finel"')
    assert (code, said["next"]) == (2, "did you mean 'final'?")
    assert said["expected"].count(",") == 5
    assert "(11 in all: kc2spice scenes --keys)" in said["expected"]
    assert divider('take = "final"', 'take = "final"')[0] == 0


@pytest.mark.parametrize("line", ['stop = "1 ms"', "points = 5", "start = 10", "to = 2"])
def test_a_key_without_effect_in_the_analysis(divider, line):
    code, said = divider('type = "op"', f'type = "op"\n{line}')
    key = line.split()[0]
    assert code == 2
    assert f"analysis.{key}: the key `{key}` has no effect in the op analysis" in said["head"]
    assert said["next"] == f"delete the key `{key}` of [analysis]"


def test_measurements_and_models_that_do_not_exist(cli):
    done = cli("fit", "buzzer_7bb_20_6:disc", "none.csv", "--vary", "damping.quality")
    assert done.exit_code == 2
    assert "none.csv: this file does not exist" in done.stderr
    done = cli("reduce", "nothere.K")
    assert done.exit_code == 2
    assert "nothere.K: this file does not exist" in done.stderr
    assert "nothere.K.M" not in done.stderr


def test_a_probe_of_a_result_that_a_part_lacks(divider):
    code, said = divider('of = "r2.v"', 'of = "r2.voltage"')
    assert (code, said["got"]) == (2, "'r2.voltage'")
    assert "probes.middle.of: the scene has no such result" in said["head"]
    assert said["next"] == "did you mean 'r2.v'?"


def test_a_pin_that_a_part_lacks(divider):
    code, said = divider('pins = { a = "battery.out" }', 'pins = { a = "battery.ouput" }')
    assert (code, said["next"]) == (2, "did you mean 'battery.out'?")
    assert "battery.out" in said["expected"]


def test_an_override_of_a_part_that_the_scene_lacks(divider):
    code, said = divider("[r1]", "[r1]", "--set", "load.resistance=3")
    assert code == 2
    assert said["expected"] == "a key of one of its parts: battery, r1, r2"
    assert "part=" not in said["next"]


@pytest.mark.parametrize(
    ("words", "head", "got", "expected"),
    [
        (
            ("bench", "impact", "--error", "2"),
            "--error: this value is out of range",
            "2",
            "1e-12 to 1",
        ),
        (
            ("bench", "impact", "--error=x"),
            "--error: this value is not a number",
            "x",
            "a number, 1e-12 to 1",
        ),
        (
            ("bench", "impact", "--repeats", "0"),
            "--repeats: this value is out of range",
            "0",
            "at least 1",
        ),
        (("export", "impact", "--tolerance", "-1"), "--tolerance: out of range", "-1", ">= 1e-10"),
        (
            ("reduce", "x.K", "--band", "1k", "2k"),
            "--band: this value is not a number",
            "1k",
            "numbers in Hz",
        ),
    ],
)
def test_errors_of_options_quote_the_typed_text(cli, words, head, got, expected):
    done = cli(*words)
    assert done.exit_code == 2
    rows = [line.split() for line in done.stderr.splitlines()]
    assert head in done.stderr
    assert ["got:", got] in rows
    assert ["expected:", *expected.split()] in rows
    if "--band" in words:
        assert "--band 1000 2000" in done.stderr


def test_a_log_range_that_starts_at_zero(divider):
    for text in ("log:0:2:5", "log:0 Ohm:2 Ohm:5", "log:1:-2:5"):
        sets = ("--set", f"r1.resistance={text}", "--dry-run")
        code, said = divider("[r1]", "[r1]", *sets, command="sweep")
        assert (code, said["got"]) == (2, text)
    sets = ("--set", "r1.resistance=log:0.05:2:5", "--dry-run")
    assert divider("[r1]", "[r1]", *sets, command="sweep")[0] == 0
