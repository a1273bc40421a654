"""The whole loop in ngspice against its independent integration in scipy."""

import dataclasses
import subprocess

import numpy as np
import pytest

from kc2spice.bodies.piezo_stack import piezo_stack, ring_radii
from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.parts.bench import loop_deck
from kc2spice.parts.experiments import scene_deck
from kc2spice.reference.loop import impact, kick_and_catch
from kc2spice.reference.statics import imprint
from kc2spice.rom.modal import resonators
from kc2spice.rom.reduce import reduce
from kc2spice.scene.schema import (
    Contact,
    EmForce,
    Harmonic,
    Impact,
    Imprint,
    Kick,
    Scene,
    Solver,
    Sphere,
)
from kc2spice.sim.log import classify
from kc2spice.sim.ngspice import find_ngspice, run_deck, write_deck

TICK = "Vtick tick base PWL(0 0 1e-12 0 2e-12 0)\nRtick tick base 1\n"


def launch(waves):
    """Velocity behind the last contact of the kick."""
    t, force = waves["time"], waves["contact.force"]
    (closed,) = np.nonzero((force > 1e-6) & (t > 0.5e-3) & (t < 0.6e-3))
    return waves["sphere.v"][closed[-1] + 1]


@pytest.fixture(scope="module")
def run(scene, header, model, radii, table, tmp_path_factory):
    directory = tmp_path_factory.mktemp("loop")
    shares = []
    deck = loop_deck(scene, header, model, radii, table)
    waves = run_deck(deck, directory, progress=shares.append)
    return deck, directory, waves, shares


def test_loop_agrees_with_scipy(run, scene, model, table):
    waves = run[2]
    exact = kick_and_catch(model, scene, table).waves
    assert launch(waves) == pytest.approx(launch(exact), rel=1e-4)
    height = np.interp(exact["time"], waves["time"], waves["sphere.y"])
    assert np.abs(height - exact["sphere.y"]).max() < 1e-6
    assert abs(waves["sphere.y"][-1] - scene.control.setpoint) < 1e-6  # it is caught
    late = waves["time"] > 4.5e-3
    weight = scene.sphere.mass * 9.81 / 0.65  # N over N/A
    assert waves["coil.upper.current"][late].mean() == pytest.approx(weight, rel=0.2)
    lower, upper = waves["coil.lower.current"], waves["coil.upper.current"]
    np.testing.assert_allclose(lower, -upper, rtol=1e-12)


def test_results_have_the_names_and_signs_of_the_contract(run):
    deck, _, waves, _ = run
    assert set(waves.data) == {"time", *deck.vectors}
    forces = sum(waves[f"contact.force.R{k}"] for k in range(6))
    np.testing.assert_allclose(waves["contact.force"], forces, rtol=1e-12)
    edge = (waves["time"] > 500.02e-6) & (waves["time"] < 500.08e-6)
    # the clamped capacitance at least is charged through the anode: C dV/dt = 28 A
    assert waves["kick.current"][edge].mean() > 20.0
    assert waves["kick.voltage"].max() == pytest.approx(80.0)
    np.testing.assert_allclose(waves["control.error"], 2.5e-3 - waves["sphere.y"], atol=1e-8)


def test_operating_point_is_silent_with_the_contact_closed(run, scene):
    _, directory, waves, _ = run
    report = classify((directory / "loop.log").read_text())
    assert not report.struggles
    assert not report.warnings
    assert waves["contact.force"][0] == pytest.approx(scene.sphere.mass * 9.81, rel=0.5)
    assert 0.0 < waves["contact.force.R0"][0] == waves["contact.force"][0]
    assert abs(waves["sphere.v"][0]) < 1e-12


def test_statistics_and_progress(run):
    _, directory, waves, shares = run
    assert waves.stats["accepted"] == waves["time"].size
    assert waves.stats["iterations"] > waves.stats["accepted"]
    assert waves.stats["cpu_s"] > 0
    assert all(0 <= share <= 1 for share in shares)
    assert (directory / "loop.raw").is_file()
    assert not (directory / "loop.raw.part").exists()


def test_stiff_contact_fails_without_the_breakpoints_at_a_picosecond(
    scene, header, table, tmp_path
):
    """The pivot defect is real and our cure is what cures it; three loops that show it."""
    device = piezo_stack(Kick())
    chip = resonators(reduce(device, order=30, band=(0.0, 500e3)))
    outcomes = []
    for voltage, edge, penalty in ((120, 2e-8, 2e10), (140, 2e-7, 2e10), (160, 1e-7, 2e10)):
        varied = scene.model_copy(
            update={
                "kick": Kick.model_validate({"drive": {"voltage": voltage, "edge": edge}}),
                "contact": Contact(penalty=penalty),
                "solver": Solver(stop=0.51e-3),
            }
        )
        deck = loop_deck(varied, header, chip, ring_radii(Kick()), table)
        assert TICK in deck.files["kick.lib"]
        run_deck(deck, tmp_path, timeout=120)
        sick = deck.files | {"kick.lib": deck.files["kick.lib"].replace(TICK, "")}
        try:
            run_deck(dataclasses.replace(deck, files=sick), tmp_path, timeout=120)
        except SimulationError as error:
            outcomes.append(error.message)
            break
        outcomes.append("passed")
    assert any("Timestep too small" in outcome for outcome in outcomes), outcomes


@pytest.mark.parametrize("electrical", ["open", "short"])
def test_impact_agrees_with_scipy(header, model, radii, electrical, tmp_path):
    scene = Scene(
        name="impact", experiment="impact", gravity=0.0, kick=Kick(electrical=electrical),
        contact=Contact(), sphere=Sphere(), impact=Impact(),
        solver=Solver(stop=15e-6, max_step=50e-9),
    )  # fmt: skip
    waves = run_deck(scene_deck(scene, header, model, radii), tmp_path)
    exact = impact(model, scene).waves
    height = np.interp(exact["time"], waves["time"], waves["sphere.y"])
    travel = np.ptp(exact["sphere.y"])
    assert np.abs(height - exact["sphere.y"]).max() < 1e-4 * travel
    assert waves["sphere.v"][-1] == pytest.approx(exact["sphere.v"][-1], rel=1e-4)


@pytest.mark.parametrize("speed", [1.0, 0.01])
def test_slow_impacts_are_as_exact_as_fast_ones(header, model, radii, speed, tmp_path):
    """Displacements shrink with the speed; steps of error control alone must follow them."""
    scene = Scene(
        name="impact", experiment="impact", gravity=0.0, kick=Kick(electrical="short"),
        contact=Contact(), sphere=Sphere(), impact=Impact(velocity=-speed, gap=speed * 1e-6),
        solver=Solver(stop=15e-6, max_step=1e-6),
    )  # fmt: skip
    waves = run_deck(scene_deck(scene, header, model, radii), tmp_path)
    exact = impact(model, scene).waves
    assert waves["sphere.v"][-1] == pytest.approx(exact["sphere.v"][-1], rel=1e-4)


@pytest.mark.parametrize("electrical", ["open", "short"])
def test_imprint_agrees_with_the_static_solution(header, model, radii, electrical, tmp_path):
    scene = Scene(
        name="imprint", experiment="imprint", kick=Kick(electrical=electrical),
        contact=Contact(), sphere=Sphere(), imprint=Imprint(steps=50),
    )  # fmt: skip
    waves = run_deck(scene_deck(scene, header, model, radii), tmp_path, timeout=60)
    exact = imprint(model, scene)
    np.testing.assert_allclose(waves["imprint.depth"], exact["imprint.depth"], atol=1e-18)
    np.testing.assert_allclose(waves["contact.force"], exact["contact.force"], rtol=1e-9)


def test_absent_parts_leave_no_trace(header, model, scene):
    alone = scene.model_copy(
        update={"contact": None, "sphere": None, "catch": None, "control": None}
    )
    deck = loop_deck(alone, header, model)
    assert set(deck.files) == {"loop.cir", "kick.lib"}
    for word in ("xsphere", "xcatch", "xcontact", "xpid", "bottom"):
        assert word not in deck.files["loop.cir"].lower()
    assert "sphere.y" not in deck.vectors


def test_missing_model_is_named(scene, header):
    with pytest.raises(UsageError, match="kick model"):
        loop_deck(scene, header)


def test_ngspice_is_found():
    assert find_ngspice().name == "ngspice"


@pytest.mark.parametrize("experiment", ["loop", "imprint", "harmonic", "em_force"])
def test_decks_run_as_they_stand(experiment, scene, header, model, radii, table, tmp_path):
    """``ngspice -b`` without any further word simulates and prints."""
    update = {"experiment": experiment, "name": experiment, "solver": Solver(stop=0.1e-3)}
    update |= {"imprint": Imprint(steps=5), "harmonic": Harmonic(steps=5), "em_force": EmForce()}
    deck = scene_deck(scene.model_copy(update=update), header, model, radii, table)
    main = write_deck(deck, tmp_path)
    done = subprocess.run(
        [find_ngspice().path, "-b", main.name], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0
    assert "Index" in done.stdout
    assert not classify(done.stdout + done.stderr).errors
