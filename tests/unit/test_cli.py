"""The command line: what it prints, its exit codes, and that failures write nothing."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from support import (
    EXAMPLES,
    GateMissedError,
    MissingToolError,
    SimulationError,
    print_result,
    stage_directory,
)

import kc2spice as kc
from kc2spice import __version__


def test_help_and_version(cli):
    help_text = cli("--help").stdout
    for command in ("run", "export", "explain", "scenes", "doctor"):
        assert command in help_text
        assert cli(command, "--help").exit_code == 0
    assert __version__ in cli("--version").stdout


BUILDERS = {"scipy.sparse", "scipy.linalg", "skfem", "gmsh", "matplotlib", "PySpice"}
LATE = {"numpy", "scipy", "pydantic", "jinja2"}


@pytest.mark.parametrize(
    ("module", "heavy"),
    [
        ("cli.main", BUILDERS | LATE),
        ("workflow.run", BUILDERS),
        ("parts.bodies.piezo_stack", BUILDERS | {"scipy.stats"}),
    ],
    ids=["help", "run with cached models", "its body"],
)
def test_fast_commands_load_no_slow_modules(module, heavy):
    """Few imports keep ``--help`` and a run with another gain quick."""
    code = f"import sys, kc2spice.{module}; print(sorted({heavy!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_run_with_pictures_in_its_page_alone_never_loads_what_draws(tmp_path):
    """From the command line, whole."""
    code = (
        "import sys, kc2spice.cli.main as main\n"
        "try: main.run_command_line()\n"
        "except SystemExit as end: assert not end.code, end.code\n"
        "print(sorted({'matplotlib', 'skfem', 'PySpice'} & set(sys.modules)), file=sys.stderr)"
    )
    command = [sys.executable, "-c", code, "run", "newtons_cradle", "-o", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stderr == "[]\n"  # and no progress where nobody watches
    assert (tmp_path / "report.html").stat().st_size > 10_000
    assert not list(tmp_path.glob("*.png"))


def test_a_result_is_printed_as_tables(capsys):
    rom = {"order": 30, "band_hz": [0.0, 5e5], "error_estimate": 1e-3,
           "above_band_hz": [1e6], "above_band_compliance_error": [0.11]}  # fmt: skip
    result = {
        "model": {"kick": {"mass_kg": 1.386e-4, "unknowns": 16722}},
        "model_units": {"kick": {"mass_kg": "kg"}},
        "rom": rom,
        "metrics": {"caught": True, "launch_velocity_m_s": 1.02, "curve": [1, 2]},
        "metric_units": {"launch_velocity_m_s": "m/s"},
        "wall_s": {"mesh": 0.5},
        "files": ["result.json"],
    }
    print_result(result, Path("out"), verbose=True)
    text = capsys.readouterr().out
    for word in ("138.6 mg", "16 722", "launch velocity", "1.02 m/s", "yes", "result.json",
                 "compliance error above the band", "11 % at 1 MHz"):  # fmt: skip
        assert word in text


def test_a_result_begins_with_its_verdict(capsys):
    """Verdict, metrics with units and error estimate, and the path of the report in 15 lines."""
    passed = {"name": "energy", "passed": True, "value": 0.0, "limit": 1e-3, "unit": ""}
    band = {"name": "band of kick", "label": "highest analysis frequency, kick", "passed": False,
            "value": 4.06e5, "limit": 3e5, "unit": "Hz"}  # fmt: skip
    result = {
        "scene": "kick",
        "metrics": {f"x{k}_m": 1e-3 * k for k in range(1, 30)} | {"noise_m": 1e-17, "curve": [1]},
        "metric_units": {f"x{k}_m": "m" for k in range(1, 30)} | {"noise_m": "m"},
        "convergence": {"errors": {"x2_m": 4e-4}},
        "checks": [passed, {**band, "action": "warn", "advice": "", "coarse": False}],
        "rom": {"order": 30, "band_hz": [0.0, 5e5], "error_estimate": 4.1e-4},
        "files": ["result.json", "report.html"],
    }
    print_result(result, Path("out"))
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 15
    text = "\n".join(" ".join(line.split()) for line in lines)
    for words in (
        "checks 1 of 2 passed",
        "VIOLATED highest analysis frequency, kick: 406 kHz, limit 300 kHz",
        "x2 2 mm (error estimate 0.04 %)",
        "further metrics 21, printed with --verbose",
        "reduced model 30 states, error estimate 0.041 %, up to 500 kHz",
        "report out/report.html",
    ):
        assert words in text
    # rounding noise beside other lengths is zero
    few = {**result, "metrics": {"x_m": 1.0, "noise_m": 1e-17}, "checks": [passed]}
    few["metric_units"] = {"x_m": "m", "noise_m": "m"}
    print_result(few, Path("out"))
    text = capsys.readouterr().out
    assert "checks 1 passed" in " ".join(text.split())
    assert "noise 0 m" in " ".join(text.split())


def test_no_row_of_the_checks_wraps(capsys):
    """The labels of the scene coil_self_heating, with the longest values and limits."""
    units = {
        "height outside the force table": "m", "initial gap between sphere and kick": "m",
        "approach of kick to sphere at ring2": "m",
        "interpolation error, force of catch": "of the largest force",
        "time-step error of kick": "of the rms of charge of kick",
        "catch_driver, voltage beyond its rails": "V beyond",
        "waveform error of control_enable": "of its swing",
        "energy balance of contact": "of the energy exchanged",
        "error of the reduced model of kick": "of a response",
        "mesh error of kick, first resonance": "relative, estimated",
        "coil heating of catch, I²t": "A2 s", "band required by the contact, kick": "Hz",
        "contact events": "contact events",
    }  # fmt: skip
    common = {"value": 1.72e-6, "limit": 4.89e-3, "passed": True, "action": "warn", "advice": ""}
    checks = [{"name": "", "label": label, "unit": unit, **common} for label, unit in units.items()]
    print_result({"checks": checks, "files": []}, Path("out"), verbose=True)
    lines = capsys.readouterr().out.splitlines()
    first = next(k for k, line in enumerate(lines) if "if exceeded" in line) + 1
    rows = lines[first : lines.index("", first)]
    assert len(rows) == len(checks)
    assert all(row.startswith("ok") for row in rows)


def test_verbose_prints_each_metric_once_and_the_files_by_purpose(capsys):
    files = ["loop.cir", "loop_plot.sp", "a.lib", "b.lib", "waveforms.csv", "x.dat"]
    result = {
        "netlist": "loop.cir",
        "metrics": {f"x{k}_m": 1e-3 * k for k in range(1, 30)} | {"band_hz": [1.0, 2.0]},
        "metric_units": {f"x{k}_m": "m" for k in range(1, 30)} | {"band_hz": "Hz"},
        "files": files,
    }
    print_result(result, Path("out"), verbose=True)
    text = capsys.readouterr().out
    lines = [" ".join(line.split()) for line in text.splitlines()]
    for row in ("x7 7 mm", "x29 29 mm", "band 1 Hz, 2 Hz"):
        assert lines.count(row) == 1
    at = lines.index("Files in out")
    assert lines[at - 1] == ""
    assert lines[at + 1 :] == [
        "netlist of the scene loop.cir", "ngspice script for plots loop_plot.sp",
        "subcircuits a.lib, b.lib", "waveforms waveforms.csv", "other files x.dat",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (MissingToolError("ngspice is not installed"), 3),
        (GateMissedError("missed"), 4),
        (SimulationError("timestep too small"), 5),
        (KeyboardInterrupt(), 130),
        (ValueError("surprise\nsecond line"), 5),
    ],
)
def test_failures_have_a_code_one_message_and_no_files(cli, monkeypatch, tmp_path, error, code):
    def run(scene, out, progress, **_):
        with stage_directory(out) as work:
            (work / "result.json").write_text("{}")
            raise error

    monkeypatch.setattr("kc2spice.workflow.run.run_scene", run)
    done = cli("run", "kick_and_catch", "-o", "deep/out", "--quiet")
    assert done.exit_code == code
    assert done.stdout == ""
    assert done.stderr.startswith("kc2spice: error: ")
    assert "Traceback" not in done.stderr
    assert "second line" not in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["run", "kick_and_cach"], "did you mean 'kick_and_catch'"),
        (["export", "kick_and_catch", "--set", "kick.drive.volage=1"], "did you mean 'voltage'"),
        (["explain", "kick_and_catch", "--set", "oops"], "the value of the key is missing"),
        (["run"], "run: the argument SCENE is missing"),
        (["rum"], "did you mean 'run'?"),
        (["run", "kick_and_catch", "--nope"], "run: this option does not exist got: --nope"),
        (["export", "kick_and_catch", "--tolerance", "x"], "tolerance"),
    ],
)
def test_bad_usage_is_code_2_and_writes_nothing(cli, tmp_path, words, message):
    done = cli(*words)
    assert done.exit_code == 2
    assert message in " ".join(done.stderr.replace("│", " ").split())
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_scenes(cli):
    assert "kick_and_catch" in cli("scenes").stdout
    assert "kick_and_catch" in json.loads(cli("scenes", "--json").stdout)
    assert "kick.drive.voltage" in cli("scenes", "--keys").stdout
    keys = {key["name"]: key for key in json.loads(cli("scenes", "--keys", "--json").stdout)}
    assert keys["kick.drive.voltage"]["unit"] == "V"


def test_explain(cli):
    text = cli("explain", "impact").stdout
    assert "anode" in text
    assert max(map(len, text.splitlines())) <= 80
    blocks = ("Analysis: transient, 0 s to 15 µs", "Parts", "Numerical settings",
              "Neglected effects", "Connections", "Scene hash: ")  # fmt: skip
    places = [text.index(f"\n{block}") for block in blocks]
    assert places == sorted(places)
    assert "write error_budget = 0.01 at the top of the scene file" in " ".join(text.split())
    found = json.loads(cli("explain", "impact", "--json").stdout)
    (order,) = (row for row in found["settings"] if row["key"] == "rom.order")
    assert order["value"] == 30
    assert 0 < order["error"] < 0.01
    (row,) = (line for line in text.splitlines() if line.startswith("rom.order "))
    assert row.split()[:4] == ["rom.order", "30", f"{100 * order['error']:.2g}", "%"]
    assert [part["part"] for part in found["parts"]] == ["impact", "kick", "contact", "sphere"]


def test_exported_files_are_printed_by_purpose(cli):
    """Each file of the export is printed once, and no purpose is unknown."""
    done = cli("export", "newtons_cradle", "-o", "out")
    assert done.exit_code == 0, done.output
    title, *rows = done.stdout.splitlines()
    assert title.strip() == "Files in out"
    words = " ".join(rows).replace(",", " ").split()
    names = sorted(path.name for path in Path("out").glob("[!.]*"))
    assert sorted(set(words) & set(names)) == names
    assert all(words.count(name) == 1 for name in names)
    for purpose in ("netlist of the scene", "KiCad project", "subcircuits for LTspice"):
        assert sum(row.startswith(f"{purpose} ") for row in rows) == 1
    assert "other files" not in done.stdout


def test_doctor_lists_missing_programs(cli, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    done = cli("doctor")
    assert done.exit_code == 3
    assert "apt-get install ngspice" in done.stdout
    findings = json.loads(cli("doctor", "--json").stdout)["findings"]
    broken = [found["name"] for found in findings if found["needed"] and not found["ok"]]
    assert broken == ["ngspice", "ngspice runs a test netlist"]


def test_run_without_ngspice_is_code_3_before_any_work(tmp_path):
    """The real study in a process of its own, with a search path that has no ngspice."""
    package = Path(kc.__file__).parent.parent
    home = tmp_path / "home"  # where matplotlib lists its fonts
    environment = {"PATH": str(tmp_path), "PYTHONPATH": str(package), "HOME": str(home)}
    command = [sys.executable, "-m", "kc2spice", "run", "kick_and_catch", "-o", "out"]
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 3
    assert "ngspice" in done.stderr
    assert "apt-get install ngspice" in done.stderr
    assert "Traceback" not in done.stderr
    assert set(tmp_path.iterdir()) <= {home}


@pytest.mark.parametrize("command", EXAMPLES)
def test_help_ends_with_two_examples_and_fits_its_line(cli, command):
    text = cli(command, "--help").stdout.rstrip()
    first, second = text.splitlines()[-2:]
    assert first.strip().startswith(f"kc2spice {command}")
    assert second.strip().startswith(f"kc2spice {command}")
    assert "{" not in text.splitlines()[0]  # SCENE, not {SCENE}
    listing = cli("--help").stdout
    summary = next(line for line in listing.splitlines() if line.startswith(f"  {command} "))
    assert summary.endswith(".")
    assert not summary.endswith("..")


def test_scenes_prints_the_toml_text_of_a_scene(cli):
    printed = cli("scenes", "buzzer_square", "--quiet").stdout
    Path("my.toml").write_text(printed, encoding="utf-8")
    own, built_in = kc.load_scene("my.toml"), kc.load_scene("buzzer_square")
    assert {**own.tables, "name": "buzzer_square"} == built_in.tables
    assert json.loads(cli("scenes", "buzzer_square", "--json").stdout)["toml"] == printed
    Path("sold.toml").write_text(cli("scenes", "7BB-20-6").stdout, encoding="utf-8")
    sold = kc.load_scene("7BB-20-6").tables
    assert {**kc.load_scene("sold.toml").tables, "name": sold["name"]} == sold


def test_scenes_states_the_files_that_a_copied_scene_needs(cli):
    printed = cli("scenes", "bring_your_own").stdout
    Path("my.toml").write_text(printed, encoding="utf-8")
    (file,) = re.findall(r"# Copy this file into the folder of the scene: (.*)", printed)
    Path(Path(file).name).write_bytes(Path(file).read_bytes())
    assert cli("export", "my.toml", "--out", "copied").exit_code == 0


def test_scenes_rejects_a_wrong_name_and_a_second_word(cli):
    assert cli("scenes", "impac").stderr.rstrip().endswith("did you mean 'impact'?")
    assert cli("scenes", "disc", "impact").stderr.rstrip().endswith("write kc2spice scenes impact")
    both = cli("scenes", "impact", "--keys")
    assert both.exit_code == 2
    assert "impact cannot be combined with --keys" in both.stderr


def test_a_part_type_behind_scenes_is_an_option(cli):
    for word, line in {
        "disc": "scenes --part disc",
        "dis": "scenes --part disc",
        "parts": "scenes --parts",
        "keys": "scenes --keys",
    }.items():
        done = cli("scenes", word)
        assert done.exit_code == 2
        assert done.stderr.rstrip().endswith(f"write kc2spice {line}")
        assert cli(*line.split()).exit_code == 0
