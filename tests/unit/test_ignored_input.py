"""Sweeps, fits, exports and decks: no input is ignored, and the advice of errors is followed."""

import csv
import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from messages import rows
from small_scenes import DIVIDER
from support import load_scene, read_number_key

import kc2spice as kc

AMPLIFIED = """[drive]
part = "source"
pulse = { high = "1 V", start = "1 us", width = "50 us", edge = "1 us" }
[amp]
part = "netlist"
file = "amp.lib"
subckt = "amp"
pins = { in = "drive.out", out = "load.a" }
[load]
part = "resistor"
resistance = "1 kOhm"
[analysis]
stop = "20 us"
"""
AMPLIFIER = """* two resistors in series
.subckt amp in out ref
R1 in mid 5
R2 mid out 20
.ends
"""


@pytest.fixture
def sweep(cli):
    """Sweeps the load of a battery: the exit code, the message, and the rows of the table."""
    Path("own.toml").write_text(DIVIDER)

    def run(out, *words):
        done = cli("sweep", "own.toml", "-q", "--workers", "1", "--out", out, *words)
        table = Path(out, "sweep.csv")
        found = list(csv.DictReader(table.open())) if done.exit_code == 0 else []
        return done.exit_code, done.stderr, found

    return run


# --- sweeps -------------------------------------------------------------------------------------


def test_a_sweep_accepts_a_part_number(cli):
    done = cli("sweep", "7BB-20-6", "--set", "device.c_low=9e-9:12e-9:3", "--dry-run", "--json")
    assert done.exit_code == 0, done.stderr
    assert '"points": 3' in done.stdout


@pytest.mark.parametrize(
    ("text", "correct"),
    [
        ("1 kOhm:3:3", "1 kOhm:3 kOhm:3"),
        ("1:3 kOhm:3", "1 kOhm:3 kOhm:3"),
        ("log:1kOhm:4:3", "log:1kOhm:4kOhm:3"),
        ("uniform(1 kOhm,2,3)", "uniform(1 kOhm,2 kOhm,3)"),
        ("normal(1,10 Ohm,3)", "normal(1 Ohm,10 Ohm,3)"),
    ],
)
def test_a_range_has_a_unit_at_both_ends_or_at_none(cli, text, correct):
    Path("own.toml").write_text(DIVIDER)
    done = cli("sweep", "own.toml", "--dry-run", "--set", f"load.resistance={text}")
    found = rows(done.stderr)
    assert done.exit_code == 2
    assert "only some of these values have a unit" in found["head"]
    assert (found["got"], found["next"].partition(";")[0]) == (text, f"write {correct}")


def test_a_corrected_range_and_a_range_from_zero_have_the_typed_values(sweep):
    code, _, table = sweep("corrected", "--set", "load.resistance=1 kOhm:3 kOhm:2")
    assert code == 0
    # the current is 10 V divided by 1 and 3 kOhm
    assert [float(row["current"]) for row in table] == pytest.approx([10e-3, 10e-3 / 3])
    code, error, table = sweep("from_zero", "--set", "battery.dc=0:2 V:3")
    assert (code, error) == (0, "")
    assert [float(row["battery.dc"]) for row in table] == [0.0, 1.0, 2.0]


def test_a_list_with_si_numbers_and_units_causes_a_warning(cli):
    Path("own.toml").write_text(DIVIDER)
    word = ("sweep", "own.toml", "--dry-run", "--set")
    done = cli(*word, "load.resistance=1 kOhm,2")
    assert done.exit_code == 0
    assert "if all values have the same unit, write 1 kOhm,2 kOhm" in done.stderr
    assert "warning" not in cli(*word, "load.resistance=1 kOhm,2 kOhm").stderr


@pytest.mark.parametrize(
    ("words", "head", "advice"),
    [
        ("--set load.resistance=1:2:3 --set load.resistance=5",
         "two options --set state the same key", "delete one of the options --set load.resistance"),
        ("--set load.resistance=1:2:3 --latin", "--latin: the option has no effect",
         "leave out --latin"),
        ("--set load.resistance=1:2:3 --seed 4", "--seed: the option has no effect",
         "leave out --seed"),
        ("--set load.resistance=1:2:3 --zip", "--zip: the option has no effect",
         "leave out --zip"),
        ("--set load.resistance=5", "no option --set contains a range",
         "write --set load.resistance=FIRST:LAST:POINTS in place of --set load.resistance=5"),
        ("--set 'load.resistance=1 kOhm;2 kOhm'", "has semicolons between its values",
         "write 1 kOhm,2 kOhm"),
        ("--set load.resistance=random(1,2,3)", "the distribution random does not exist",
         "write uniform(1,2,3)"),
        ("--set load.resistance=gauss(10,1,3)", "the distribution gauss does not exist",
         "write normal(10,1,3)"),
        ("--set load.resistance=-1:3:2", "--set 'load.resistance=-1:3:2': out of range",
         "write --set load.resistance=1.5:3:2"),
        ("--set load.resistance=3:-1:2", "--set 'load.resistance=3:-1:2': out of range",
         "write --set load.resistance=3:1.5:2"),
        ("--set load.resistance=normal(1,2,20)",
         "--set 'load.resistance=normal(1,2,20)': out of range",
         "lower the standard deviation: write normal(1,0.1,20)"),
    ],
)  # fmt: skip
def test_an_error_about_the_options_of_a_sweep_advises_a_correction(cli, words, head, advice):
    Path("own.toml").write_text(DIVIDER)
    done = cli("sweep", "own.toml", "--dry-run", *shlex.split(words))
    found = rows(done.stderr)
    assert done.exit_code == 2
    assert head in found["head"]
    assert found["next"].startswith(advice) or found["next"].endswith(advice)
    corrected = found["next"].rpartition("write ")[2]
    if "(" in advice or "," in advice:
        key = f"load.resistance={corrected}"
        assert cli("sweep", "own.toml", "--dry-run", "--set", key).exit_code == 0


def test_options_with_an_effect_and_a_key_of_a_file_are_accepted(cli):
    Path("own.toml").write_text(DIVIDER)
    Path("keys.toml").write_text('"load.resistance" = 7.0\n"battery.dc" = 3.0\n')
    words = "sweep own.toml --dry-run --set keys.toml --set load.resistance=1,2 --json"
    done = cli(*words.split())
    assert (done.exit_code, done.stderr.count("warning")) == (0, 0)
    both = "--set battery.dc=1,2 --set load.resistance=uniform(1,2,2)"
    assert cli(*f"{words} --set battery.dc=1:2:2 --zip".split()).exit_code == 0
    done = cli(*f"sweep own.toml --dry-run {both} --zip --latin --seed 3".split())
    assert done.exit_code == 0, done.stderr


def test_a_replaced_override_causes_a_warning():
    overrides = ["impact.velocity=-2", "impact.velocity=-1"]
    with pytest.warns(UserWarning, match="'impact.velocity=-2' has no effect"):
        scene = load_scene("impact", overrides)
    assert scene.get_part("impact").keys.velocity == -1.0
    with pytest.warns(UserWarning, match="'rom.order=9' has no effect"):
        load_scene("impact", ["rom.order=9", "rom.tolerance=1e-3"])


@pytest.mark.parametrize(
    ("words", "head", "advice"),
    [
        ("impact --dense", "--dense applies only to a reduced model", "leave out --dense"),
        ("--rom x.npz --trust", "--rom cannot be combined with --trust",
         "kc2spice export --rom x.npz"),
    ],
)  # fmt: skip
def test_an_option_without_effect_on_an_export_is_an_error(cli, words, head, advice):
    done = cli("export", *words.split())
    found = rows(done.stderr)
    assert done.exit_code == 2
    assert head in found["head"]
    assert found["next"] == advice


# --- netlists -----------------------------------------------------------------------------------


@pytest.fixture
def deck(cli):
    """Runs commands in a folder with the scene ``own.toml`` and its netlist ``amp.lib``."""
    Path("own.toml").write_text(AMPLIFIED)
    Path("amp.lib").write_text(AMPLIFIER)
    return cli


@pytest.mark.parametrize(
    ("line", "warned"),
    [
        ("R1 in mid 5M", True),
        ("R1 in mid 5MOhm", True),
        ("R1 in mid {r1}\n.param r1=5M", True),
        ("R1 in mid 5m", False),
        ("R1 in mid 5MEG", False),
        ("R1 in mid 5meg", False),
    ],
)
def test_the_suffix_m_in_upper_case_causes_a_warning(deck, line, warned):
    Path("amp.lib").write_text(AMPLIFIER.replace("R1 in mid 5", line))
    done = deck("export", "own.toml", "--out", "out")
    assert done.exit_code == 0, done.stderr
    assert ("milli" in done.stderr) is warned
    if warned:
        assert "write 5meg if you mean mega, or 5m if you mean milli" in done.stderr


@pytest.mark.parametrize(("value", "warned"), [("1F", True), ("1f", False), ("1pF", False)])
def test_a_capacitance_in_farad_causes_a_warning(deck, value, warned):
    Path("amp.lib").write_text(AMPLIFIER.replace("R1 in mid 5", f"R1 in mid 5\nC9 mid ref {value}"))
    done = deck("export", "own.toml", "--out", "out")
    assert done.exit_code == 0, done.stderr
    assert ("write 1 if you mean farad, or 1f if you mean femtofarad" in done.stderr) is warned


def test_a_netlist_in_upper_case_causes_no_warning(deck):
    Path("amp.lib").write_text(AMPLIFIER.upper().replace("MID 5", "MID 5M"))
    pins = '{ IN = "drive.out", OUT = "load.a", REF = "gnd" }'
    text = AMPLIFIED.replace('"amp"', '"AMP"')
    Path("own.toml").write_text(text.replace('{ in = "drive.out", out = "load.a" }', pins))
    done = deck("export", "own.toml", "--out", "out")
    assert (done.exit_code, done.stderr.count("milli")) == (0, 0), done.stderr


def test_an_error_about_a_mistyped_node_names_the_similar_node(deck):
    Path("amp.lib").write_text(AMPLIFIER.replace("in mid 5", "in midd 5"))
    found = rows(deck("export", "own.toml").stderr)
    assert found["next"].startswith("did you mean 'mid'?")
    Path("amp.lib").write_text(AMPLIFIER.replace(".ends", "R3 mid q 5\n.ends"))
    found = rows(deck("export", "own.toml").stderr)
    assert "rename q to nc_q if the node is intentionally unconnected" in found["next"]
    Path("amp.lib").write_text(AMPLIFIER.replace(".ends", "R3 mid nc_q 5\n.ends"))
    assert deck("export", "own.toml").exit_code == 0


def test_errors_about_an_unsuitable_deck_advise_a_correction(cli):
    scene = "newtons_cradle"
    assert cli("export", scene, "--out", "d", "-q").exit_code == 0
    found = rows(cli("run", scene, "--deck", "d/contact.lib").stderr)
    assert found["head"].endswith("this file is a library of subcircuits, not a deck")
    assert found["next"].endswith("--deck d/newtons_cradle.cir")
    text = Path("d/newtons_cradle.cir").read_text()
    own = Path("d/own.cir")
    own.write_text(text.replace("reltol=", "reltl="))
    assert rows(cli("run", scene, "--deck", "d/own.cir").stderr)["next"] == "did you mean 'reltol'?"
    lines = [line for line in text.splitlines() if not line.startswith(".save")]
    own.write_text("\n".join(lines))
    done = cli("run", scene, "--deck", "d/own.cir")
    found = rows(done.stderr)
    assert (done.exit_code, "own.cir" in found["head"]) == (2, True)
    advice = found["next"].removeprefix("add this line to the deck: ")
    own.write_text("\n".join([*lines[:-1], advice, ".end"]))
    assert cli("run", scene, "--deck", "d/own.cir", "-q").exit_code == 0


def test_an_override_beside_a_deck_with_another_value_causes_a_warning(cli):
    scene = "newtons_cradle"
    assert cli("export", scene, "--out", "d", "-q").exit_code == 0
    words = ("run", scene, "--deck", "d/newtons_cradle.cir", "-q", "--set")
    done = cli(*words, "sphere1.velocity=-2")
    assert "differ from --set 'sphere1.velocity=-2': velocity = 1 of sphere1" in done.stderr
    assert "'analysis.stop=100 us'" in cli(*words, "analysis.stop=100 us").stderr
    assert cli(*words, "title=other").stderr == ""
    # the same override in the export and in the run
    assert cli("export", scene, "--out", "e", "-q", "--set", "sphere1.velocity=-2").exit_code == 0
    words = ("run", scene, "--deck", "e/newtons_cradle.cir", "-q", "--set")
    assert "differ from" not in cli(*words, "sphere1.velocity=-2").stderr


# --- fits ---------------------------------------------------------------------------------------


@pytest.fixture
def fit(cli):
    """Fits a buzzer to the impedance of a capacitor; the rows of the message."""
    f = np.linspace(2e3, 6e3, 30)
    table = np.column_stack([f, 0 * f + 1, -1e7 / f])
    np.savetxt("z.csv", table, delimiter=",", header="frequency_hz,real_ohm,imag_ohm")
    return lambda target, vary: rows(cli("fit", target, "z.csv", "--vary", vary).stderr)


@pytest.mark.parametrize(
    ("vary", "head", "advice"),
    [
        ("quality", "no numeric key of this name", "did you mean 'damping.quality'?"),
        ("layers[5].thickness", "the list layers of disc has 2 entries",
         "did you mean 'layers[0].thickness'?"),
        ("layers[-3].thickness", "the list layers of disc has 2 entries",
         "did you mean 'layers[0].thickness'?"),
        ("layers.thickness", "not a number", "did you mean 'layers[0].thickness'?"),
        ("layers[0].thickness=0.15mm:0.3", "only some of these values have a unit",
         "write 0.15mm:0.3mm"),
        ("layers[0].thickness=0.15:0.3", "not a valid range",
         "write for example  layers[0].thickness=0.00018:0.00022"),
    ],
)  # fmt: skip
def test_an_error_about_the_option_vary_advises_an_existing_key(fit, vary, head, advice):
    found = fit("buzzer_7bb_20_6:disc", vary)
    assert head in found["head"]
    assert found["next"] == advice
    part = load_scene("buzzer_7bb_20_6").get_part("disc")
    suggested = advice.split("'")[1] if "'" in advice else "layers[0].thickness"
    value, _ = read_number_key(part, suggested, "")
    assert value > 0


def test_a_fit_of_a_source_advises_a_part_with_an_impedance(fit):
    found = fit("buzzer_7bb_20_6:drive", "ac")
    assert "a source has no impedance that can be fitted" in found["head"]
    assert found["next"] == "fit the part disc in place of drive"


def test_a_negative_index_counts_from_the_end():
    part = load_scene("buzzer_7bb_20_6").get_part("disc")
    first = read_number_key(part, "layers[-2].diameter", "")
    assert first == read_number_key(part, "layers[0].diameter", "")
    assert first != read_number_key(part, "layers[-1].diameter", "")


def test_a_range_with_units_gives_the_same_fit_as_si_numbers(tmp_path):
    """The measured part is a capacitor of 10 nF in the middle of the range."""
    scene = {
        "name": "own",
        "drive": {"part": "source", "ac": "1 V"},
        "load": {"part": "capacitor", "capacitance": "8 nF", "pins": {"a": "drive.out"}},
        "analysis": {"type": "ac", "stop": "10 kHz"},
    }
    f = np.linspace(1e3, 1e4, 40)
    table = np.column_stack([f, 0 * f + 1e-3, -1 / (2 * np.pi * f * 10e-9)])
    path = tmp_path / "c.csv"
    np.savetxt(path, table, delimiter=",", header="frequency_hz,real_ohm,imag_ohm")
    for limits in ("5 nF:20 nF", "5e-9:20e-9"):
        fitted = kc.fit(scene, "load", path, [f"capacitance={limits}"])
        assert fitted["values"]["load.capacitance"] == pytest.approx(10e-9, rel=1e-3)


# --- warnings in JSON output ----------------------------------------------------------------------

RATED = """name = "rated"
[drive]
part = "source"
dc = "1 V"
[amp]
part = "netlist"
file = "amp.lib"
subckt = "amp"
pins = { in = "drive.out", out = "load.a" }
ratings = { out = { high = "2 V" } }
[load]
part = "resistor"
resistance = "1 kOhm"
[analysis]
type = "op"
[probes]
current = { of = "load.i" }
"""


@pytest.mark.parametrize(
    "words",
    [
        ("run", "rated.toml", "--out", "o"),
        ("export", "rated.toml", "--out", "o"),
        ("verify", "rated.toml", "--out", "o"),
        ("explain", "rated.toml"),
        ("sweep", "rated.toml", "--set", "load.resistance=1,2", "--workers", "1", "--out", "o"),
        ("reduce", "own.npz", "--out", "o"),
    ],
)
def test_json_output_contains_the_printed_warnings(cli, words):
    """The matrix H has no meaning, and an operating point is not compared with ratings."""
    Path("rated.toml").write_text(RATED)
    Path("amp.lib").write_text(AMPLIFIER)
    K, B = np.diag([1e6, 4e6, 9e6]), np.ones((3, 1))
    np.savez("own.npz", M=np.eye(3), E=np.diag([10.0, 20, 30]), K=K, B=B, C=B.T, H=np.eye(3))
    done = cli(*words, "--json", "--quiet")
    assert done.exit_code == 0, done.stderr
    found = json.loads(done.stdout)["warnings"]
    assert [f"kc2spice: warning: {text}" for text in found] == done.stderr.splitlines()
    assert any("H of 3 x 3 is not used" in text or "`ratings`" in text for text in found)
