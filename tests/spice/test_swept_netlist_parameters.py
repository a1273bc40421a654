"""Sweeps over the parameters of a user's own subcircuit, compared with a voltage divider."""

import subprocess
import warnings
from concurrent.futures import Executor, Future
from contextlib import nullcontext

import pytest
from support import (
    PointResult,
    UsageError,
    find_ngspice,
    load_named_sweep,
    read_user_number,
    sweep_execution,
)
from sweeps import command, rows, sweep

DIVIDER = """* a divider
.subckt divider top out ref R=1k S=1k
Rtop top out {R}
Rbottom out ref {S}
.ends
"""
SCENE = """[half]
part = "netlist"
file = "half.lib"
subckt = "divider"
%s
pins = { top = "supply.out", out = "load.a" }
[load]
part = "resistor"
resistance = "1 GOhm"
[supply]
part = "source"
dc = "6 V"
[analysis]
type = "op"
[probes]
volts = { of = "load.v", take = "max" }
"""
TOP, BOTTOM = 1e3, 1e3  # defaults of the subcircuit [Ohm]


def divide(top, bottom=BOTTOM):
    """Voltage [V] of a divider at 6 V, loaded by 1 GOhm."""
    loaded = 1 / (1 / bottom + 1e-9)
    return 6.0 * loaded / (top + loaded)


@pytest.fixture
def scene(tmp_path):
    """Writes the scene with extra lines for its netlist part, and the library beside it."""

    def write(more="", library=DIVIDER, replaced=("", "")):
        (tmp_path / "half.lib").write_text(library)
        path = tmp_path / "half.toml"
        path.write_text((SCENE % more).replace(*replaced) if replaced[0] else SCENE % more)
        return path

    return write


@pytest.mark.parametrize(
    ("more", "key_range", "values"),
    [
        ("", "half.parameters.R=1k:3k:3", [1e3, 2e3, 3e3]),
        ("parameters = { R = 1e3 }", "half.parameters.R=log:1e2:1e4:3", [1e2, 1e3, 1e4]),
        ('parameters = { R = "1k" }', "half.parameters.R=2 kOhm,4kohm", [2e3, 4e3]),
        ("", "half.parameters.R=normal(2k,1m,3)", [2e3] * 3),
    ],
)
def test_parameters_of_a_subcircuit_take_every_kind_of_range(
    more, key_range, values, scene, tmp_path
):
    table = rows(sweep(scene(more), key_range, out=tmp_path / "o", more=("--workers", "1")))
    found = [float(row["volts"]) for row in table]
    assert found == pytest.approx(list(map(divide, values)), rel=1e-5)


@pytest.mark.parametrize("name", ["half.R", "divider.R"])
def test_a_parameter_is_named_by_its_part_or_its_library(name, scene, tmp_path):
    """The library file has another name than the part, and defaults with SPICE suffixes."""
    path = scene(replaced=("half.lib", "divider.lib"))
    (tmp_path / "half.lib").rename(tmp_path / "divider.lib")
    table = rows(sweep(path, f"param.{name}=2k,3k", out=tmp_path / "o", more=("--workers", "1")))
    assert [float(row["volts"]) for row in table] == pytest.approx(
        [divide(2e3), divide(3e3)], rel=1e-5
    )


def test_a_part_that_shares_its_library_gets_the_name_of_the_library(scene, tmp_path):
    other = '[other]\npart = "netlist"\nfile = "half.lib"\nsubckt = "divider"\n'
    other += 'pins = { top = "supply.out", out = "spare.a" }\n[spare]\npart = "resistor"\n'
    path = scene()
    path.write_text(path.read_text().replace("[load]", f'{other}resistance = "1 GOhm"\n[load]'))
    said = sweep(path, "param.other.R=2k,3k", out=tmp_path / "o", code=2)
    assert "half and other use the same library" in said
    assert "write param.half.R in place of param.other.R" in said
    table = rows(sweep(path, "param.half.R=2k,3k", out=tmp_path / "o", more=("--workers", "1")))
    assert float(table[1]["volts"]) == pytest.approx(divide(3e3), rel=1e-5)


def test_a_default_that_the_scene_overrides_is_not_swept_in_vain(scene, tmp_path):
    """The values of all points would be equal; the proposed key varies them."""
    path = scene("parameters = { R = 2e3 }")
    said = sweep(path, "param.half.R=1k,3k", out=tmp_path / "o", code=2)
    assert "the scene sets this parameter in half.parameters" in said
    assert "write half.parameters.R in place of param.half.R" in said
    said = sweep(path, "param.half.r=1k,3k", out=tmp_path / "o", code=2)
    assert "write half.parameters.R in place of param.half.r" in said
    table = rows(sweep(path, "half.parameters.R=1k,3k", out=tmp_path / "o"))
    assert float(table[0]["volts"]) == pytest.approx(divide(1e3), rel=1e-5)


@pytest.mark.parametrize(
    "text", ["3.3m", "4.7meg", "4.7MEG", "10u", "10U", "2.8k", "2.8kHz", "100n", "5p", "7f", "1G"]
)
def test_a_number_of_the_user_has_the_value_that_ngspice_reads(text, tmp_path):
    deck = f"a number\n.subckt s a R=1\nRx a 0 {{R}}\n.ends\nV1 a 0 1\nX1 a s R={text}\n"
    deck += ".control\nop\nprint @r.x1.rx[resistance]\n.endc\n.end\n"
    (tmp_path / "n.cir").write_text(deck)
    command = [find_ngspice().path, "-b", "n.cir"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    line = next(line for line in done.stdout.splitlines() if "[resistance] =" in line)
    assert read_user_number(text) == pytest.approx(float(line.rpartition("=")[2]), rel=1e-6)


@pytest.mark.parametrize(
    ("text", "value"),
    [("3.3 mH", 3.3e-3), ("1 MHz", 1e6), ("10 µF", 1e-5), ("5 %", 0.05), ("4.7Megohm", 4.7e6),
     ("100 us", 1e-4), ("-2.5k", -2500.0), ("3 V/us", 3e6)],
)  # fmt: skip
def test_a_unit_gives_the_number_in_si_units(text, value):
    assert read_user_number(text) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "choices"),
    [("4.7M", (4.7e-3, 4.7e6)), ("1F", (1e-15, 1.0)), ("100N", (1e-7, 100.0)),
     ("1MHz", (1e-3, 1e6)), ("4.7 m", (4.7e-3, 4.7)), ("1g", (1e9, 1e-3)),
     ("1K", (1e3, 1.0)), ("4.7 M", (4.7e-3, 4.7e6))],
)  # fmt: skip
def test_an_ambiguous_number_gets_both_numbers_to_choose_from(text, choices, scene):
    """Each proposed number is accepted literally."""
    with pytest.raises(UsageError, match="different values in SPICE and in SI") as caught:
        read_user_number(text)
    proposed = [float(part.split()[0]) for part in
                caught.value.hint.removeprefix("write ").split(" or ")]  # fmt: skip
    assert proposed == pytest.approx(choices)
    with pytest.raises(UsageError, match="different values"):
        load_named_sweep(str(scene(f'parameters = {{ R = "{text}" }}')), ["supply.dc=1,2"])
    load_named_sweep(str(scene(f"parameters = {{ R = {proposed[0]} }}")), ["supply.dc=1,2"])


@pytest.mark.parametrize(
    "text", ["", "abc", "3mil", "2h", "25 degC", "1x", "1e400", "1e308k", "nan", "{R}"]
)
def test_a_text_without_a_known_suffix_is_no_number(text):
    with pytest.raises(UsageError):
        read_user_number(text)


def test_a_range_with_one_suffix_proposes_the_suffix_for_both_ends(scene):
    path = str(scene())
    with pytest.raises(UsageError, match="only one of these two values has a suffix") as caught:
        load_named_sweep(path, ["half.parameters.R=1k:3:5"])
    assert caught.value.hint == "write 1k:3k:5"
    load_named_sweep(path, ["half.parameters.R=1k:3k:5"])


def test_workers_print_no_lines_of_python(scene, tmp_path):
    """Each point issues the warning that the key ratings has no effect, but only one is printed."""
    path = scene("ratings = { out = { high = 100 } }")
    words = command(path, "half.parameters.R=1k,2k,3k", out=tmp_path / "o",
                    more=("-q", "--workers", "2"))  # fmt: skip
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    (line,) = done.stderr.splitlines()
    assert line.startswith("kc2spice: warning: half: the key `ratings` has no effect")


def test_warnings_of_points_are_issued_once_with_their_number(scene, tmp_path):
    texts = iter([("at 2 Hz: steep", "odd"), ("at 3 Hz: steep",), ()])

    class Done(Executor):
        def submit(self, *_):
            future = Future()
            future.set_result(PointResult({"volts": 1.0}, warnings=next(texts)))
            return future

    definition = load_named_sweep(str(scene()), ["supply.dc=1,2,3"])
    with warnings.catch_warnings(record=True) as issued:
        warnings.simplefilter("always")
        sweep_execution.run_sweep(definition, tmp_path / "o", lambda: nullcontext((Done(), 1)))
    assert [str(item.message) for item in issued] == [
        "2 of 3 points, with different numbers, for example: at 2 Hz: steep",
        "1 of 3 points: odd",
    ]


def test_random_keys_with_zip_cause_a_warning_only(scene):
    """Random keys vary together in any case, so the plan is the same."""
    sets = ["half.parameters.R=uniform(1k,2k,4)", "supply.dc=normal(6,1,4)"]
    plain = load_named_sweep(str(scene()), sets, seed=1)
    with pytest.warns(UserWarning, match="--zip has no effect: the random values of"):
        zipped = load_named_sweep(str(scene()), sets, seed=1, zipped=True)
    assert [zipped.plan.values(k) for k in range(4)] == [plain.plan.values(k) for k in range(4)]
