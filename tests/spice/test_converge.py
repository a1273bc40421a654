"""Error budgets: refined runs estimate the error of each metric, and what does not hold says so."""

import warnings

import numpy as np
import pytest
from support import (
    ERROR_BUDGET,
    OutputRecipient,
    StageTimer,
    format_toml,
    list_mesh_errors,
    run_scene,
    settings_refinement,
)

import kc2spice as kc

# an RC low-pass
LOWPASS = {
    "name": "lowpass",
    "drive": {"part": "source", "pulse": {"high": "5 V", "width": "0.1 ms", "edge": "1 us"}},
    "r": {"part": "resistor", "resistance": "1 kOhm", "pins": {"a": "drive.out"}},
    "c": {"part": "capacitor", "capacitance": "20 nF", "pins": {"a": "r.b"}},
    "analysis": {"type": "transient", "stop": "0.2 ms"},
    "probes": {"late_v": {"of": "c.v", "take": "final"}},
}


def judged(tables, overrides, budget, name, exact):
    """True error, the record's convergence, and the warnings of a run with a budget."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        scene = kc.load_scene(tables, {**overrides, "error_budget": budget})
        result = kc.run(scene)
    error = abs(result.metrics[name] / exact - 1)
    return error, result.record["convergence"], [str(each.message) for each in said]


def test_a_budget_that_is_met_needs_one_refined_run():
    exact = 5 * (1 - np.exp(-99e-6 / 20e-6)) * np.exp(-1e-4 / 20e-6)  # edges of 1 us: 1e-3 of it
    error, found, said = judged(LOWPASS, {}, 0.05, "late_v", exact)
    assert found["held"]
    assert error < 0.05
    assert len(found["tried"]) == 1
    assert not any("error_budget" in each for each in said)


def test_a_coarse_scene_is_refined_until_its_budget_holds():
    """The axis with the largest share goes first: here the steps, as nothing else is there."""
    coarse = {"solver.reltol": 0.3, "solver.chgtol": 1e-5, "solver.trtol": 10}
    fine = kc.run(kc.load_scene(LOWPASS, {"solver.reltol": 1e-6, "solver.max_step": "20 ns"}))
    plain = kc.run(kc.load_scene(LOWPASS, {**coarse, "solver.max_step": "20 us"}))
    exact = fine.metrics["late_v"]
    before = abs(plain.metrics["late_v"] / exact - 1)
    error, found, said = judged(
        LOWPASS, {**coarse, "solver.max_step": "20 us"}, before / 5, "late_v", exact
    )
    assert "convergence" not in plain.record
    assert found["held"] is (found["errors"]["late_v"] <= before / 5)
    assert error <= before / 5 or any("error of late_v" in each for each in said)
    assert len(found["tried"]) > 1
    assert any("the run refined these settings: solver." in each for each in said)


def test_an_unreachable_budget_is_reported():
    coarse = {"solver.reltol": 0.3, "solver.max_step": "20 us"}
    _, found, said = judged(LOWPASS, coarse, 1e-13, "late_v", 1.0)
    assert not found["held"]
    assert any("limit 1e-11 %" in each for each in said)


SMALL = {
    "kick.layers": 2, "kick.height": "0.1 mm", "kick.mesh.sectors": 4, "kick.mesh.rings": 2,
    "kick.mesh.outer_rings": 2, "kick.mesh.ring_spacing": "100 um", "harmonic.steps": 20,
}  # fmt: skip


def test_curves_over_other_frequencies_are_judged_too():
    """The response of a small chip at 20 and at 40 frequencies: the finer ones have the coarser."""
    result = kc.run(kc.load_scene("harmonic", {"error_budget": 1e-3, **SMALL}))
    found = result.record["convergence"]
    assert found["held"]
    assert "amplitude.ring0.anode" in found["errors"]
    assert all(error < 1e-3 for error in found["errors"].values())


DISC = {
    "disc": {
        "part": "disc", "pins": {"anode": "g.out"},
        "layers": [
            {"material": "brass", "diameter": "20 mm", "thickness": "0.2 mm"},
            {"material": "PZT-5A", "diameter": "14 mm", "thickness": "0.22 mm"},
        ],
    },
    "g": {"part": "source", "ac": "1 V"},
    "analysis": {"type": "ac", "start": "4 kHz", "stop": "8 kHz", "points": 100},
}  # fmt: skip


def test_meshes_are_refined_within_limits_that_are_stated_first(monkeypatch):
    """A mesh beyond them stays, and its own error estimate counts for it."""
    monkeypatch.setattr(settings_refinement, "MAX_MESH_UNKNOWNS", 1000)
    said = []
    scene = kc.load_scene(DISC, {"error_budget": 0.2})
    own = settings_refinement.evaluate_scene(scene, StageTimer())
    done = settings_refinement.converge_to_budget(
        own, StageTimer(lambda stage, done, text: said.append((stage, text)))
    )
    facts = own.build.get_model_values(scene.parts["disc"])
    assert 250 < facts["unknowns"] < 1000  # four times as many are too many
    assert said[0][0] == "error budget"
    assert "up to 1 000 unknowns and" in said[0][1]
    assert done.make_record()["limits"]["unknowns"] == 1000
    assert done.final.unmoved == ("disc.mesh.refine",)
    mesh = max(value for name, value in facts.items() if name.startswith("mesh_error_"))
    assert min(done.final.errors.values()) >= mesh > 1e-3


def refined_disc(monkeypatch, most, budget):
    """The disc with a budget and a limit of unknowns, and on a mesh eight times as fine."""
    monkeypatch.setattr(settings_refinement, "MAX_MESH_UNKNOWNS", most)
    own = settings_refinement.evaluate_scene(
        kc.load_scene(DISC, {"error_budget": budget}), StageTimer()
    )
    exact = settings_refinement.evaluate_scene(
        kc.load_scene(DISC, {"disc.mesh.refine": 8, "analysis.points": 800}), StageTimer()
    )
    return settings_refinement.converge_to_budget(own, StageTimer()), exact


@pytest.mark.slow
def test_a_mesh_at_its_limit_ends_the_refinement_with_its_reason(monkeypatch):
    """Other settings do not help any more; no run is spent on them."""
    done, _ = refined_disc(monkeypatch, 1000, 1e-4)
    assert len(done.tried) == 1
    assert not done.check.passed
    assert (
        "disc.mesh.refine: the finer mesh for the error estimate is too large: "
        "about 1 632 unknowns" in done.check.advice
    )
    assert "at most 1 000 unknowns" in done.check.advice


@pytest.mark.slow
def test_the_error_at_the_limit_is_that_of_each_metric(monkeypatch):
    """A shifted resonance changes the curve at its flanks far more than the budget; the error of
    the curve permits the shift, so that it does not exceed the errors of the printed metrics."""
    done, exact = refined_disc(monkeypatch, 2500, 1e-4)
    assert done.final.settings["disc.mesh.refine"] == 2
    assert done.final.unmoved == ("disc.mesh.refine",)
    true = settings_refinement.compute_metric_changes(done.final.run, exact)
    for name, error in true.items():
        assert done.final.errors[name] >= error, name
    mesh = max(
        list_mesh_errors(
            done.final.run.build.get_model_values(exact.build.scene.parts["disc"])
        ).values()
    )
    f, z = (np.array(exact.metrics[name]) for name in ("frequency_hz", "impedance_ohm"))
    ours = np.interp(f, *map(done.final.run.metrics.get, ("frequency_hz", "impedance_ohm")))
    assert abs(ours - z).max() / z.max() > 5 * mesh
    assert true["impedance_ohm"] < done.final.errors["impedance_ohm"] < 2 * true["bvd.lm_h"]


def test_memory_of_a_factor_is_that_of_its_fill():
    """A chip of 152 000 unknowns took 5.8 GB, a disc of 145 000 a fraction of a gigabyte."""
    assert settings_refinement.estimate_factor_bytes(152e3, 3) == pytest.approx(5.8e9, rel=0.05)
    assert settings_refinement.estimate_factor_bytes(145e3, 2) < 0.5e9


@pytest.mark.parametrize(("as_json", "quiet"), [(False, False), (True, False), (False, True)])
def test_limits_of_meshes_are_printed_outside_of_a_terminal(capsys, as_json, quiet):
    with OutputRecipient(as_json, quiet).open_progress_display() as progress:
        progress(ERROR_BUDGET, None, "meshes are refined up to 1 000 unknowns")
        progress("reduce", 0.5, "reduction of disc")
    said = "error budget: meshes are refined up to 1 000 unknowns\n"
    assert capsys.readouterr().err == ("" if as_json or quiet else said)


@pytest.mark.parametrize(("limit", "printed"), [(0.0, True), (1e6, False)])
def test_a_long_refinement_is_stated_before_its_runs(tmp_path, monkeypatch, limit, printed):
    monkeypatch.setattr(settings_refinement, "LONG_REFINEMENT", limit)
    seen = []
    scene = kc.load_scene("duffing", {"error_budget": 0.1})
    run_scene(scene, tmp_path / "out", progress=lambda *item: seen.append(item))
    stages = [stage for stage, *_ in seen]
    assert (ERROR_BUDGET in stages) is printed
    if printed:
        assert stages.index(ERROR_BUDGET) < stages.index("refined run")
        text = seen[stages.index(ERROR_BUDGET)][2]
        assert text.startswith("at most 16 refined runs follow, which probably take more than")


# --- a pulse-width modulator in a user's netlist --------------------------------------------------

# The comparator is high for a share DUTY of each period of 20 us, at 10 V with 0.1 Ohm.
PWM = """.subckt pwm in out ref
Vtri tri ref PULSE(-1 1 0 9.9u 9.9u 0.2u 20u)
Bcmp p ref V={5*(1+tanh(GAIN*(V(in,ref)-V(tri,ref))))}
Rout p out 0.1
.ends
"""


@pytest.mark.parametrize(
    ("level", "gain", "henry", "step"), [(0.5, 200, 2e-3, "5 us"), (-0.8, 2000, 10e-3, "8 us")]
)
def test_a_budget_resolves_the_edges_of_a_netlist(tmp_path, monkeypatch, level, gain, henry, step):
    """The current in R and L at steady state is a sum of exponentials with the exact duty cycle.

    With steps of 8 us or of 4 us, all pulses of 2 us are between two time points.
    """
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pwm.lib").write_text("* modulator\n" + PWM.replace("GAIN", str(gain)))
    tables = {
        "signal": {"part": "source", "dc": level},
        "own": {"part": "netlist", "file": "pwm.lib", "subckt": "pwm",
                "pins": {"in": "signal.out", "ref": "gnd"}},
        "coil": {"part": "inductor", "inductance": henry,
                 "pins": {"a": "own.out", "b": "load.a"}},
        "load": {"part": "resistor", "resistance": "100 Ohm", "pins": {"b": "gnd"}},
        "analysis": {"type": "transient", "stop": "2 ms"},
        "probes": {name: {"of": "load.v", "take": take, "from": "1 ms"}
                   for name, take in (("mean", "mean"), ("ripple", "peak_to_peak"))},
        "solver": {"max_step": step},
    }  # fmt: skip
    path = tmp_path / "own.toml"
    path.write_text("".join(f'"{name}" = {format_toml(table)}\n' for name, table in tables.items()))
    period, high, rate = 20e-6, (level + 1) * 9.9e-6, 100.1 / henry
    fall = 1 - np.exp(-rate * (period - high))
    exact = {
        "mean": 10 * high / period * 100 / 100.1,
        "ripple": 1e3 / 100.1 * (1 - np.exp(-rate * high)) * fall / (1 - np.exp(-rate * period)),
    }
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        result = kc.run(kc.load_scene(path, {"error_budget": 0.3}))
    found = result.record["convergence"]
    assert found["held"]
    assert not any("edges lie between" in str(each.message) for each in said)
    for name, value in exact.items():
        assert abs(result.metrics[name] / value - 1) <= found["errors"][name]
