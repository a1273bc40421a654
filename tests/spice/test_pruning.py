"""What a scene leaves out, against the unpruned model: rings, parts, and the error budget."""

import dataclasses
import json
import re

import numpy as np
import pytest
from typer.testing import CliRunner

from kc2spice import reference
from kc2spice.cli.main import app
from kc2spice.core.progress import Clock
from kc2spice.report.metrics import compare
from kc2spice.scene.load import load_scene
from kc2spice.scene.rings import mesh_rings, reach, ring_gaps
from kc2spice.sim.ngspice import run_deck
from kc2spice.sim.truth import find_truth, require, ring_checks
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.models import build_models

ALL = ("contact.rings=all", "rom.order=84")  # within 3e-5 of any other order tried


def built(name, *overrides):
    scene = load_scene(name, overrides)
    return scene, build_models(scene, Clock())


def without_outer(chip, kept):
    """The same reduced model with ports for ``kept`` rings only."""
    rings = len(chip.ports) - 1
    return dataclasses.replace(
        chip,
        gain=np.delete(chip.gain, range(kept, rings), axis=1),
        D=np.delete(np.delete(chip.D, range(kept, rings), 0), range(kept, rings), 1),
        ports=(*chip.ports[:kept], chip.ports[-1]),
    )


@pytest.fixture(scope="module")
def unpruned():
    """Full scipy reference of the loop over 5 ms: all rings, 84 states."""
    scene, models = built("kick_and_catch", *ALL)
    chip = models.kick.resonators
    assert len(chip.ports) == 7
    return scene, chip, reference.kick_and_catch(chip, scene, models.table).waves


@pytest.fixture(scope="module")
def impacts():
    """Impacts on all rings, by speed [m/s]."""
    found = {}
    for speed in (0.3, 1.0, 3.0):
        scene, models = built("impact", *ALL, f"impact.velocity=-{speed}", "solver.stop=20 us")
        chip = models.kick.resonators
        found[speed] = scene, chip, reference.impact(chip, scene).waves
    return found


def test_rings_that_stay_open_change_nothing(unpruned):
    """Of one reduced model, without the ports of R2 to R5, over the whole 5 ms."""
    scene, chip, waves = unpruned
    table = build_models(scene, Clock()).table
    pruned = reference.kick_and_catch(without_outer(chip, 2), scene, table).waves
    error = compare(pruned, waves)
    # Steps of the integrator alone: its largest state is 5e-6 m at rtol 1e-9, times 1e3 steps.
    assert error["velocity_relative"] < 1e-7
    assert error["trajectory_m"] < 1e-10


@pytest.mark.parametrize("kept", [1, 2, 3, 4, 5])
def test_the_bound_lies_above_what_the_next_ring_does(kept, unpruned, impacts):
    """Its docstring's figures: at most 5 % of the gap below, here never below at all."""
    for scene, chip, waves in (unpruned, *impacts.values()):
        tip = waves["sphere.y"] - scene.sphere.radius
        true = float((waves[f"kick.u.R{kept}"] - tip).max())
        (check,) = ring_checks(waves, scene, without_outer(chip, kept))
        assert check.name == "ring_left_out"
        if not any(waves[f"contact.force.R{k}"].max() > 0 for k in range(kept, 6)):
            assert true <= check.value
        else:  # forces of the rings that were left out are missing from the bound
            assert not check.passed


def test_no_ring_that_closed_was_judged_out_of_reach(unpruned, impacts):
    for scene, _, waves in (unpruned, *impacts.values()):
        closed = [waves[f"contact.force.R{k}"].max() > 0 for k in range(6)]
        gaps = ring_gaps(mesh_rings(scene.kick), scene.sphere.radius)
        depth = reach(scene).depth
        assert all(gap < depth for gap, touches in zip(gaps, closed, strict=True) if touches)
        assert depth > -(waves["sphere.y"].min() - scene.sphere.radius)


def achieved(budget, unpruned, tmp_path):
    scene, models = built("kick_and_catch", f"error_budget={budget}")
    chip = models.kick.resonators
    assert len(chip.ports) == 3
    waves = run_deck(make_deck(scene, models), tmp_path)
    require(find_truth(waves, scene, models.table, chip).checks, scene.name)
    error = compare(waves, unpruned[2])
    return max(error["velocity_relative"], error["trajectory_relative"])


@pytest.mark.parametrize("budget", [5e-2, 1e-2, 1e-3])
def test_the_budget_is_kept(budget, unpruned, tmp_path):
    assert achieved(budget, unpruned, tmp_path) < budget


@pytest.mark.slow  # half a minute for the reduction up to 2 MHz
def test_a_tight_budget_is_kept(unpruned, tmp_path):
    assert achieved(1e-4, unpruned, tmp_path) < 1e-4


@pytest.mark.parametrize("budget", [1e-2, 1e-3])
def test_the_budget_of_an_impact_is_kept(budget, impacts, tmp_path):
    scene, models = built("impact", f"error_budget={budget}", "solver.stop=20 us")
    waves = run_deck(make_deck(scene, models), tmp_path)
    error = compare(waves, impacts[1.0][2])
    assert max(error["velocity_relative"], error["trajectory_relative"]) < budget


@pytest.mark.parametrize(
    ("scene", "key", "kept"),
    [("kick_and_catch", "solver.stop=0.6 ms", 1), ("impact", "solver.stop=10 us", 1),
     ("imprint", "imprint.steps=20", 4)],
)  # fmt: skip
def test_a_run_that_needed_more_rings_fails_and_says_so(scene, key, kept, tmp_path):
    out = tmp_path / "out"
    arguments = ["run", scene, "--set", f"contact.rings={kept}", "--set", key, "-o", str(out)]
    result = CliRunner().invoke(app, [*arguments, "--quiet"])
    assert result.exit_code == 5
    assert "ring_left_out" in result.output
    assert f"set contact.rings to more than {kept}, or to 'all'" in result.output
    assert not out.exists()


@pytest.mark.parametrize(
    ("lacking", "words"),
    [
        (("control",), ("pid", "opamp", "control", "enable", "setpoint")),
        (("control", "catch"), ("pid", "opamp", "catch", "coil", "drive", "bc0")),
        (("kick", "contact"), ("kick", "contact", "r0", "anode", "chip", "ring")),
    ],
)
def test_a_netlist_has_no_trace_of_what_the_scene_lacks(lacking, words):
    scene = load_scene("kick_and_catch").model_copy(update=dict.fromkeys(lacking))
    scene = scene.model_copy(update={"name": "bare", "title": ""})
    deck = make_deck(scene, build_models(scene, Clock()))
    for name, text in deck.files.items():
        cards = "\n".join(line for line in text.splitlines() if not line.startswith("*"))
        found = set(re.findall(r"[a-z]+[a-z0-9]*", f"{name}\n{cards}".lower()))
        assert not found & set(words), name
    assert not [vector for vector in deck.vectors if vector.split(".")[0] in (*lacking, *words)]


def ran(tmp_path, text):
    (tmp_path / "own.toml").write_text(text)
    out = tmp_path / "out"
    result = CliRunner().invoke(app, ["run", str(tmp_path / "own.toml"), "-o", str(out), "--quiet"])
    assert result.exit_code == 0, result.output
    return json.loads((out / "result.json").read_text())


def test_a_chip_alone_is_an_electrical_load(tmp_path):
    """No ring port is left; slowly charged it holds the free capacitance's 143.19 nF."""
    slow = "[kick]\n[kick.drive]\nwidth = 3e-4\nedge = 2.9e-4\n[solver]\nstop = 1.2e-3\n"
    result = ran(tmp_path, slow)
    assert result["rom"]["ports"] == ["anode"]
    assert set(result["metrics"]) == {
        "kick_voltage_peak_v", "kick_current_peak_a", "kick_charge_peak_c",
    }  # fmt: skip
    # 2 %: an edge of 290 us still makes the chip ring a little, at 270 kHz.
    charge = 100 * result["model"]["kick"]["capacitance_free_f"]
    assert charge == pytest.approx(100 * 143.19e-9, rel=1e-3)
    assert result["metrics"]["kick_charge_peak_c"] == pytest.approx(charge, rel=0.02)


def test_a_sphere_alone_falls(tmp_path):
    result = ran(tmp_path, "[sphere]\n[solver]\nstop = 2e-3\n")
    assert "rom" not in result
    told = CliRunner().invoke(app, ["explain", str(tmp_path / "own.toml"), "--json"])
    assert json.loads(told.stdout).items() >= result["plan"].items()  # one record, shown twice
    fallen = 1e-3 - 9.81 * 2e-3**2 / 2
    assert result["metrics"]["final_position_m"] == pytest.approx(fallen, rel=1e-5)


def test_ideal_currents_need_no_coil_voltage_and_drivers_do():
    """No inductance, no back-EMF and no driver where currents are ideal; explain lists it."""
    scene, models = built("kick_and_catch")
    files = make_deck(scene, models).files
    assert "coil.lib" not in files
    assert not re.search(r"^L", files["catch.lib"], re.MULTILINE)
    told = CliRunner().invoke(app, ["explain", "kick_and_catch", "--json"]).output
    assert "coil voltage, inductance and self-heating" in told
    driven = CliRunner().invoke(app, ["explain", "coil_rails", "--json"]).output
    assert "back-EMF" in driven
    assert "coil voltage, inductance" not in driven
