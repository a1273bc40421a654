"""Every shipped scene from the command line to its files, as a user runs it."""

import json
import re
import subprocess

import numpy as np
import pytest
from commands import run_command
from support import list_gallery, load_scene

CONTRACT = {
    "scene", "version", "netlist", "simulator", "model", "steps", "metrics", "wall_s", "files",
}  # fmt: skip
STAGES = {"mesh", "assemble", "reduce", "magnetics", "export", "simulate", "report"}


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Result of each scene with its directory, run once, in this process."""
    found = {}

    def result(name):
        if name not in found:
            out = tmp_path_factory.mktemp(name)
            found[name] = run_command("run", name, "-o", out, "--json"), out
        return found[name]

    return result


# More of the same parts: plain buzzers but two, long transients, what test_devices.py runs.
MORE = ("amplifier_kick", "buzzer_self", "buzzer_square", "coil_rails", "levitated_disc",
        "coil_self_heating", "loudspeaker_vented", "pwm_coil", "three_cycles")  # fmt: skip
ONE_OF = re.compile(r"buzzer_7bb_(?!20_6)|buzzer_ft_(?!39t)")
SCENES = [
    pytest.param(name, marks=pytest.mark.slow if name in MORE or ONE_OF.match(name) else ())
    for name in sorted(list_gallery())
]


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_runs_and_writes_its_documented_files(name, results):
    result, out = results(name)
    assert result.keys() >= CONTRACT
    assert result["scene"] == name
    assert result["wall_s"].keys() >= STAGES
    assert {path.name for path in out.iterdir() if path.is_file()} >= set(result["files"])
    assert {"result.json", "report.html", "waveforms.npz", "waveforms.csv"} <= set(result["files"])
    assert not any(file.endswith(".png") for file in result["files"])
    assert "<figure data-plot>" in (out / "report.html").read_text()
    assert (out / result["netlist"]).read_text().rstrip().endswith(".end")
    assert json.loads((out / "result.json").read_text())["metrics"] == result["metrics"]
    with np.load(out / "waveforms.npz", allow_pickle=False) as waves:
        assert all(np.isfinite(waves[key]).all() for key in waves.files)


def test_kick_and_catch_catches(results):
    metrics = results("kick_and_catch")[0]["metrics"]
    assert metrics["caught"] is True
    assert metrics["settling_time_s"] < 3.5e-3
    assert abs(metrics["final_error_m"]) < 1e-6
    assert 0.3e-3 < metrics["hold_current_a"] < 0.7e-3
    # 1.0210 m/s measured; the full model with catch and control left out gives 1.0202
    assert metrics["launch_velocity_m_s"] == pytest.approx(1.021, rel=2e-3)


def test_explain_lists_the_models_of_kick_and_catch(results):
    model = results("kick_and_catch")[0]["model"]
    kick, catch = model["kick"], model["catch"]
    assert kick["unknowns"] == 16722
    assert kick["mass_kg"] == pytest.approx(7700 * 3e-3 * 3e-3 * 2e-3, rel=1e-12)
    # Closed forms 33 V d33 and eps A 33^2 / h; the resonances are those of this mesh family.
    assert kick["free_stroke_ring0_m_per_100v"] == pytest.approx(2.3508e-6, rel=1e-4)
    assert kick["capacitance_free_f"] == pytest.approx(143.19e-9, rel=1e-4, abs=0)
    assert kick["capacitance_clamped_f"] == pytest.approx(34.87e-9, rel=5e-4, abs=0)
    assert kick["resonance_short_hz"] == pytest.approx(270.4e3, rel=5e-3)
    assert kick["resonance_open_hz"] == pytest.approx(365.7e3, rel=5e-3)
    assert catch["coil_resistance_ohm"] == pytest.approx(1596, rel=1e-3)


def test_an_emitted_deck_runs_without_changes(results, tmp_path):
    _, out = results("impact")
    run = subprocess.run(
        ["ngspice", "-b", "-n", "-r", str(tmp_path / "own.raw"), "impact.cir"],
        cwd=out, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "own.raw").stat().st_size > 10_000


def test_changed_gain_takes_the_models_from_the_cache(results, tmp_path):
    results("kick_and_catch")
    more = ("--set", "control.kp=4.5e4", "-o", tmp_path, "--json")
    result = run_command("run", "kick_and_catch", *more)
    spent = result["wall_s"]
    assert [spent[k] for k in ("mesh", "assemble", "reduce", "magnetics")] == [0, 0, 0, 0]
    assert result["metrics"]["caught"] is True


def test_imprint_is_verified_three_ways_and_a_missed_gate_is_exit_code_4(tmp_path):
    """On a third of the layers; one gate is below rounding, where no solution path can meet it."""
    words = ("kick.layers=12", "imprint.steps=60", "gates.imprint_ngspice=1e-15")
    changes = [part for word in words for part in ("--set", word)]
    run_command("verify", "imprint", "-o", tmp_path, "-q", *changes, code=4)
    found = json.loads((tmp_path / "verify.json").read_text())["scenes"]["imprint"]
    assert found["passed"] is False
    missed = {check["name"] for check in found["checks"] if not check["passed"]}
    assert missed == {"static force, ngspice versus ROM", "static force, ngspice versus full model"}
    assert found["errors"]["rom_vs_fom"] < 1e-9
    assert found["errors"]["ngspice_vs_fom"] < 1e-6
    assert (tmp_path / "verify.html").stat().st_size > 10_000


QUICK = {"comb_resonator"}  # a scene that the quick run verifies
# pwm_coil has thousands of switched cycles; three_cycles repeats the verified kick_and_catch
LONG = {"pwm_coil", "three_cycles"}


def choose_marks(name):
    """Marks of the verification of a scene."""
    if name in QUICK:
        return ()
    return (pytest.mark.slow, pytest.mark.campaign) if name in LONG else (pytest.mark.slow,)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=choose_marks(name)) for name in sorted(list_gallery())]
)
def test_scene_meets_its_gates(name, tmp_path):
    run_command("verify", name, "-o", tmp_path, "-q")  # exit code 4 where one is missed


def test_energies_are_those_at_the_end(results):
    """A sphere that bounces: its kinetic energy m v^2 / 2, and works that explain the change."""
    out = results("impact")[1]
    energies = json.loads((out / "result.json").read_text())["energy_j"]
    with np.load(out / "waveforms.npz", allow_pickle=False) as waves:
        speed = waves["sphere.v"]
    mass, sphere = load_scene("impact").parts["sphere"].keys.mass, energies["sphere"]
    assert sphere["kinetic"] == pytest.approx(mass * speed[-1] ** 2 / 2, rel=1e-9)
    assert sphere["kinetic at the start"] == pytest.approx(mass * speed[0] ** 2 / 2, rel=1e-9)
    work = sphere["work of the weight"] + sphere["work of the contact"]
    gained = sphere["kinetic"] - sphere["kinetic at the start"]
    assert gained == pytest.approx(work, abs=1e-4 * sphere["kinetic at the start"])
    stored = [v for entries in energies.values() for k, v in entries.items() if "stored" in k]
    assert stored
    assert min(stored) >= 0.0
